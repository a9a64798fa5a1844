"""An inverse x = Psi(z, u) as an observer evaluates it: no denominator of it leaves the side that it has on the image.

z = Phi(x, u) takes the plant's ranges to a part of the box of z. A denominator d(z, u) of Psi with d(Phi(x, u), u) >=
least > 0 on the plant's ranges may still be 0 elsewhere in the box of z: past that pole Psi has the other sign, and the
clamp to the ranges would take the far end. There Psi is evaluated with max(d, least), or min(d, -least): on the image
of the ranges it is unchanged, beyond it is continuous, and the clamp takes the near end.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.intervals.box import Box, box
from hgogen.intervals.digits import down
from hgogen.intervals.sign import nonzero
from hgogen.structure.inverse import tidy

_BOXES = 2000  # a bound away from 0 need not be the best


@dataclass(frozen=True)
class Sided:
    """The `rows` of Psi, with each denominator at its side where that is proved. `finite` tells for each row whether it
    is proved to be a number on the whole box of z; where it is not, an observer has to look."""

    rows: tuple[sp.Expr, ...]
    finite: tuple[bool, ...]


def sided(form: Form) -> Sided:
    """The form's `from_form`, x as expressions of z, with each denominator of a proved sign clamped to that sign.

    The least size of a denominator on the image is proved by outward-rounded intervals; half of it is taken, which
    leaves room for rounding.
    """
    plant = form.system
    around = box((*form.states, *plant.inputs, *plant.parameters), plant.nominal)
    ranges, images = box(plant.signals, plant.nominal), dict(zip(form.states, form.to_form, strict=True))
    denominators = sorted({d for row in form.from_form for d in _denominators(row)}, key=sp.default_sort_key)
    poles = [d for d in denominators if not _least(d, around)]
    leasts = {d: _least(tidy(d.xreplace(images)), ranges) for d in poles}
    leasts = {d: least for d, least in leasts.items() if least}
    doubtful = {d for d in poles if d not in leasts}
    finite = []  # a state with a sign, or a rational function of bounded signals without a denominator that may be 0
    for row in form.from_form:
        read = row.free_symbols
        bounded = all(s.bounded for s in (*form.states, *plant.inputs) if s in read)
        rational = bounded and bool(row.is_rational_function(*read)) and not doubtful & {*_denominators(row)}
        finite.append(rational or row in form.states or -row in form.states)
    return Sided(tuple(_bounded_away(row, leasts) for row in form.from_form), tuple(finite))


def _denominators(row: sp.Expr) -> list[sp.Expr]:
    powers = (p for p in row.atoms(sp.Pow) if p.exp.is_Integer and p.exp.is_negative)
    return [p.base for p in powers if not p.is_number]


def _least(denominator: sp.Expr, ranges: Box) -> sp.Rational:
    """Half of a bound away from 0, with the sign that the denominator has on the ranges; 0 where none is proved."""
    sign = nonzero(denominator, ranges, boxes=_BOXES, refute=False)
    if sign.verdict is not Verdict.PROVED:
        return sp.S.Zero
    return sign.sign * sp.Rational(down(sign.margin / 2))


def _bounded_away(row: sp.Expr, leasts: Mapping[sp.Expr, sp.Rational]) -> sp.Expr:
    """The row, each denominator d of `leasts` as max(d, least), or min(d, least) where least < 0."""
    powers = (p for p in row.atoms(sp.Pow) if p.exp.is_Integer and p.exp.is_negative and p.base in leasts)
    changed = {}
    for p in powers:
        least = leasts[p.base]
        keep = sp.Max if least > 0 else sp.Min
        changed[p] = keep(_bounded_away(p.base, leasts), least) ** p.exp
    return row.xreplace(changed)
