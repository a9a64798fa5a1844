"""What the errors of fields bring into the rates of others through the slopes of b, and where the fields lie."""

import math
import sys
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product

import sympy as sp

from hgogen.algebra.kinks import bent
from hgogen.evidence.grammar import outward
from hgogen.form import Form
from hgogen.guarantees.quadratic import Array, rational
from hgogen.guarantees.steepness import jacobian
from hgogen.intervals.bounds import Range
from hgogen.intervals.slope import JUMPS
from hgogen.sentence import Reason, because
from hgogen.structure.polytope import span
from hgogen.structure.scaling import exponents

_BOXES = 2_000  # for the range of one slope
_STEEPEST = sys.float_info.max / 4  # an end of a range, which is then widened
_LOOSE = 1e-9  # what a range with 0 is wider by, over its width, so that a weaker arithmetic reaches it


@dataclass(frozen=True)
class Layout:
    """The fields of an estimator in its core's order: `index` (N), i(k) from 0, by whose units a field is scaled;
    `power` (N), p(k); `fed` (N): whether c_i(k) enters; `picks` (n): the field that stands for w_i where c reads it."""

    index: tuple[int, ...]
    power: tuple[int, ...]
    fed: tuple[bool, ...]
    picks: tuple[int, ...]


@dataclass(frozen=True)
class Slope:
    """What `reads` (N) of e, and `takes` (p) of the samples' errors at theta = 1, bring into the rates by `onto` (N),
    over theta^`degree`: a number in [`low`, `high`]. `entry`: (i, j) where it is that of db_i/dz_j times units, which
    `range` shows; None of others. `endless`: 1 where it may be any number more than `low` = `high`, -1 any less, 0 of
    others (`endless_slopes`). `realised`: what of it is in the linear core that a method realises, as much as a
    saturation passes of what is in its range, 0 of b; None where that core moves."""

    reads: tuple[Fraction, ...]
    onto: tuple[Fraction, ...]
    low: Fraction
    high: Fraction
    degree: int
    takes: tuple[Fraction, ...] = ()
    endless: int = 0
    realised: Fraction | None = Fraction(0)
    entry: tuple[int, int] | None = None
    range: Range | None = field(default=None, hash=False, repr=False)

    @cached_property
    def exactly(self) -> tuple[Array, Array, Array]:
        """`onto`, `reads` and `takes`, of FLINT's rationals."""
        return rational(self.onto), rational(self.reads), rational(self.takes)

    @property
    def ends(self) -> dict[str, Fraction | None]:
        """As a certificate has them, None where there is none."""
        return {"low": None if self.endless < 0 else self.low, "high": None if self.endless > 0 else self.high}


def of_field(field: int, count: int) -> tuple[Fraction, ...]:
    """What reads the error of one field (N)."""
    return tuple(Fraction(int(k == field)) for k in range(count))


@lru_cache(maxsize=32)  # a search asks it of each gain
def slopes_of(form: Form, layout: Layout, scale: tuple[sp.Expr, ...], endless: bool) -> tuple[Slope, ...] | Reason:
    """Those of b, with 0 in each range; `endless`: whether one may have one end alone."""
    slopes, powers, J = [], exponents(form), jacobian(form)
    jumps = sorted(map(str, (part for row in form.b for part in bent(row).atoms(*JUMPS) if part.has(*form.states))))
    if endless and jumps:
        return because("{part} may jump", part=jumps[0])
    for i, (j, z) in product(range(form.n), enumerate(form.states)):
        slope = scale[i] / scale[j] * J[i, j]
        if slope == 0:
            continue
        known = span(slope, form, _BOXES)
        if not (known and known.defined and (known.finite or endless)) or known.low == -math.inf == -known.high:
            return because("db_{i}/d{z} = {slope} has no finite range on the box", i=i + 1, z=z, slope=slope)
        if any(_STEEPEST < abs(end) < math.inf for end in (known.low, known.high)):
            return because(
                "db_{i}/d{z} = {slope} is beyond the range of a double on the box", i=i + 1, z=z, slope=slope
            )
        onto = tuple(Fraction(int(fed and index == i)) for fed, index in zip(layout.fed, layout.index, strict=True))
        low, high, way = _ends(known)
        reads, degree = of_field(layout.picks[j], len(onto)), powers[i] - powers[j]
        slopes.append(Slope(reads, onto, low, high, degree, endless=way, entry=(i, j), range=known))
    return tuple(slopes)


def _ends(known: Range) -> tuple[Fraction, Fraction, int]:
    """The ends of the slope, 0 among them, and whether it goes on beyond one (`Slope.endless`)."""
    sides = [end for end in (known.low, known.high) if math.isfinite(end)]
    loose = _LOOSE * (max(*sides, 0.0) - min(*sides, 0.0))
    low, high = (min(outward(sides[0] - loose, -1), Fraction(0)), max(outward(sides[-1] + loose, 1), Fraction(0)))
    way = (known.high == math.inf) - (known.low == -math.inf)
    return (high, high, way) if way < 0 else (low, low, way) if way > 0 else (low, high, way)
