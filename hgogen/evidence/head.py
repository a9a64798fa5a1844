"""The head of a certificate: plant, form and observer in its grammar, with their digest, which stands in the C too."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import sympy as sp

from hgogen.check import Check
from hgogen.errors import BadArgument
from hgogen.evidence.grammar import end, exactly, text
from hgogen.evidence.grounds import Grounds
from hgogen.form import Form
from hgogen.intervals.box import box
from hgogen.reading.optional import version
from hgogen.recheck.file import FORMAT, VERSION, digest, model_digest
from hgogen.recheck.rules import OBSERVERS
from hgogen.recheck.text import Unreadable
from hgogen.recheck.verification import read
from hgogen.signal import Signal


class NotCertifiable(BadArgument):
    """A model that a certificate cannot carry."""

    text = (
        "no certificate of {what!r}: {reason}; a certificate holds + - * / **, the elementary "
        "functions, Abs, sign, Min, Max and tables: write the model by them"
    )


class OtherNumbers(BadArgument):
    """An observer whose proofs are of other numbers than those its rules read."""

    text = (
        "the proofs of the observer {what!r} are of the numbers {reason}; write the same names in its Grounds and in "
        "that row"
    )


def head(form: Form, checks: Iterable[Check], observer: str) -> dict[str, Any]:
    """The head of a certificate, and what it is about."""
    system = form.system
    plant = system.declared
    about = {
        "plant": {
            "name": plant.name,
            "states": _ranges(plant.states),
            "inputs": _ranges(system.inputs),
            "parameters": _ranges(system.parameters, system.nominal),
            "outputs": [y.name for y in plant.outputs],
            "flow": _written(form, plant.flow),
            "output": _written(form, plant.output),
        },
        "form": {
            "kind": form.kind if form.behind is None else f"{form.kind}.recovered",
            "states": _ranges(form.states),
            "to_form": _written(form, form.entry),
            "from_form": _written(form, (expression for _, expression in form.estimates)),
            "A": [_written(form, form.A.row(i)) for i in range(form.n)],
            "b": _written(form, form.b),
            "output": _written(form, form.output),
            "blocks": list(map(str, form.blocks)),
            "alignment": form.alignment,
        },
        "observer": _observer(form, checks, observer),
    }
    return {"format": FORMAT, "version": VERSION, "hgogen": version(), **about, "model": model_digest(about)}


def _written(form: Form, rows: Iterable[sp.Expr]) -> list[str]:
    return [text(form, row) for row in rows]


def _observer(form: Form, checks: Iterable[Check], name: str) -> dict[str, Any] | None:
    """The observer's name, and the numbers that a proof of it is about; None where the certificate names no observer.

    What is claimed of a bank's member is no claim about the bank. Numbers that no rule reads are left out: nothing is
    verified of them. Raises: `OtherNumbers`.
    """
    if not name:
        return None
    own = (proof for check in checks if check.id.maker == name for proof in check.proofs)
    grounds = next((proof for proof in own if isinstance(proof, Grounds)), None)
    if grounds is None or name not in OBSERVERS:
        return {"name": name}
    wanted = sorted((*OBSERVERS[name].numbers, *OBSERVERS[name].expressions))
    if sorted(grounds.numbers.keys() - {*OBSERVERS[name].beside}) != wanted:
        row = f"its row in OBSERVERS of hgogen/recheck/rules says {', '.join(wanted)}"
        raise OtherNumbers(name, f"{', '.join(sorted(grounds.numbers))}; {row}")
    return {"name": name, **{key: exactly(form, value) for key, value in grounds.numbers.items()}}


def _ranges(signals: Iterable[Signal], nominal: Mapping[Signal, sp.Rational] | None = None) -> list[dict[str, Any]]:
    return [{"name": s.name, "low": end(low), "high": end(high)} for s, (low, high) in box(signals, nominal).items()]


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a certificate with its digest."""
    return {**content, "digest": digest(content)}


def fingerprint(form: Form, checks: Iterable[Check], observer: str) -> str:
    """The certificate's `model`, found without its evidence.

    Raises: `NotCertifiable`; `OtherNumbers`.
    """
    content = sealed({**head(form, checks, observer), "claims": []})
    try:
        return read(json.dumps(content)).model
    except Unreadable as error:
        raise NotCertifiable(form.system.name, error.fault) from None
