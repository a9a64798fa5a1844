"""The gains by which an observer puts the output error into the argument of its nonlinear part.

    z' = A z + b(sat(z + N_theta (y - C z)), u) + ..,   N_theta = theta^(p(j) - p(k)) N_jk

p(j) is the power of theta that scales z_j, p(k) that of the first state of chain k. What b reads of z_j is then

    e_j - N_jk (a_(k,1) e_k - v_k),   e_k the error of the first state of chain k, v_k that of the sample

with the slopes of b as they are: with N_jk = 1/a_(k,1) in the row of that state, b reads the sample in its place.
Source: Arcak, Kokotovic, "Nonlinear observers: a circle criterion design and robustness analysis", Automatica 37
(2001).
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.polytope import chains, fixed
from hgogen.analysis.spare import entering, weighted
from hgogen.estimators.columns import as_matrix, columns
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.inclusion import Inclusion, Slope, of_field
from hgogen.rigor.points import exact
from hgogen.sentence import NONE, Reason, because


def no_argument(form: Form) -> Reason:
    """Why the b of a form takes no output error into its argument, or `NONE`."""
    if form.jacobian is not None:
        return because("it works in chains, and this form keeps the plant's coordinates")
    if any(a.free_symbols & {*form.system.inputs} for chain in form.gains for a in chain):
        return because("it is for a_i that do not move with an input")
    return NONE


def sample_in_place(form: Form) -> tuple[sp.Expr, ...]:
    """The entries N (n) with which b reads the sample in the place of the first state of each chain."""
    return tuple(1 / a if i == 0 else sp.S.Zero for chain in chains(form) for i, a in enumerate(chain))


def numbers_in_place(form: Form) -> list[float]:
    """The same at the nominal parameters."""
    return [float(sp.sympify(entry).subs(form.system.nominal)) for entry in sample_in_place(form)]


def injected(error: Inclusion | Nothing, form: Form, entries: Sequence[sp.Expr]) -> Inclusion | Nothing:
    """The inclusion of an observer of a constant gain whose b has an argument of these entries N (n, or n q: `columns`)
    beside, of numbers and parameters."""
    if isinstance(error, Nothing):
        return error
    read = _by_field(form, error, as_matrix(form, entries))
    if isinstance(read, Reason):
        return Nothing(read)
    placed = zip(columns(form, len(entries)), entries, strict=True)
    scaled = [_number(error.scale[at.row] * entry, form) for at, entry in placed]
    known = [value for value in scaled if value is not None]
    if len(known) < len(scaled) or not error.B.size:
        error, samples = error.deaf, np.zeros((form.n, 0))
    else:
        samples = as_matrix(form, known) @ entering(form, weighted(form, None))
    slopes = list[Slope]()
    for slope in error.slopes:  # those of b by what b reads, of the samples as well
        at = None if slope.entry is None else slope.reads.index(1)
        slopes.append(slope if at is None else replace(slope, reads=tuple(read[at]), takes=tuple(samples[at])))
    return replace(error, slopes=tuple(slopes), numbers={**error.numbers, "argument": tuple(entries)})


def bounded(error: Inclusion | Nothing, form: Form) -> Inclusion | Nothing:
    """The inclusion, or why there is none for a step: a slope without an end."""
    if isinstance(error, Nothing) or not error.endless:
        return error
    i, j = error.endless[0].entry or (0, 0)
    pattern = "db_{i}/d{z} has no bound on the ranges, for which a proof is in continuous time alone"
    return Nothing(because(pattern, i=i + 1, z=form.states[j]))


def _by_field(form: Form, error: Inclusion, N: np.ndarray) -> list[list[Fraction]] | Reason:
    """What stands in the place of the error of each field (n, n): of it and of the first states of the chains."""
    rows = [list(of_field(i, form.n)) for i in range(form.n)]
    for k, chain in ((k, chains(form)[k]) for k in form.leads):
        head = form.heads[k]
        for j, row in enumerate(rows):
            share = N[j, form.leads.index(k)] * chain[0] * error.scale[j] / error.scale[head]
            known = _number(share, form)
            if known is None:
                return because("what is injected into the argument of b is {share} of an error, no number", share=share)
            row[head] -= known
    return rows


def _number(value: Any, form: Form) -> Fraction | None:
    """The value where it is a rational number, whatever the parameters that have ranges."""
    known = sp.cancel(exact(sp.sympify(value).xreplace(fixed(form))))
    return Fraction(known.p, known.q) if known.is_Rational else None
