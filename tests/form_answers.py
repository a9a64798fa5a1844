"""What tests ask of a form: its verdicts by name, and that it is the plant."""

import sympy as sp

from hgogen.check import Check
from hgogen.form import Form


def verdicts(form: Form) -> dict[str, str]:
    """Of the claims of the form itself, without those of rows of the plant that have no value somewhere."""
    return {check.id.unqualified: check.verdict.value for check in form.checks if check.id.maker != "singular"}


def check(form: Form, name: str) -> Check:
    (claim,) = (check for check in form.checks if check.id == f"{form.kind}.{name}")
    return claim


def assert_same_plant(form: Form) -> None:
    """Exactly: d/dt to_form = A z + b, the outputs agree, and from_form undoes to_form."""
    back = dict(zip(form.states, form.to_form, strict=True))
    rates = dict(zip(form.system.states, form.system.flow, strict=True))
    for z, rate in zip(form.to_form, form.flow, strict=True):
        true = sum(z.diff(state) * rates[state] for state in form.system.states)
        assert sp.simplify(true - rate.xreplace(back)) == 0
    for mine, theirs in zip(form.output, form.system.output, strict=True):
        assert sp.simplify(mine.xreplace(back) - theirs) == 0
    assert tuple(state.xreplace(back) for state in form.from_form) == form.system.states
