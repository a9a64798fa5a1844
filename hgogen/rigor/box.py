"""A box: the closed, perhaps unbounded, range of each symbol, with exact ends."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.outward import Pair, number
from hgogen.rigor.points import STEEP, Ranged, largest_exponent, settled

End: TypeAlias = Fraction | float
Box: TypeAlias = Mapping[sp.Symbol, tuple[End, End]]
Point: TypeAlias = dict[sp.Symbol, Fraction]

EVERYTHING = (-math.inf, math.inf)


@dataclass(eq=False)
class EmptyBox(HgogenError):
    """A range whose ends are no numbers or the wrong way round."""

    name: str
    low: End
    high: End

    def __str__(self) -> str:
        return f"the range [{self.low}, {self.high}] of {self.name} holds no number; give low <= high, not NaN"


def box(
    signals: Iterable[Ranged], nominal: Mapping[sp.Symbol, sp.Rational] | None = None
) -> dict[sp.Symbol, tuple[End, End]]:
    """The box of the declared ranges; one without a range is at its value in `nominal` (such as
    `system.nominal`, of the parameters), else unbounded. A float is the number that its shortest decimal says."""
    fixed = nominal or {}
    ends: dict[sp.Symbol, tuple[End, End]] = {}
    for signal in signals:
        if signal.low is not None and signal.high is not None:
            ends[signal] = _said(float(signal.low)), _said(float(signal.high))
        elif signal in fixed:
            ends[signal] = (Fraction(fixed[signal]),) * 2
        else:
            ends[signal] = EVERYTHING
    return ends


@lru_cache(maxsize=4096)
def _said(value: float) -> Fraction:
    return Fraction(repr(value))


@dataclass(frozen=True)
class Sides:
    """The sides of a box in the order of `symbols`: exact ends, and floats around (`outer`) and inside it."""

    symbols: tuple[sp.Symbol, ...]
    ends: tuple[tuple[End, End], ...]

    @property
    def box(self) -> dict[sp.Symbol, tuple[End, End]]:
        """The box that they are of."""
        return dict(zip(self.symbols, self.ends, strict=True))

    @property
    def outer(self) -> Pair:
        """The smallest box of floats around it."""
        lows, highs = [number(low)[0] for low, _ in self.ends], [number(high)[1] for _, high in self.ends]
        return np.array(lows, dtype=float), np.array(highs, dtype=float)

    @property
    def inner(self) -> Pair:
        """The largest box of floats inside it."""
        lows, highs = [number(low)[1] for low, _ in self.ends], [number(high)[0] for _, high in self.ends]
        return np.array(lows, dtype=float), np.array(highs, dtype=float)

    def point(self, x: Iterable[float]) -> Point:
        """The exact point that a vector of floats of the outer box stands for: at an end, the exact end."""
        coordinates = zip(self.symbols, x, self.ends, strict=True)
        return {s: Fraction(max(min(value, high), low)) for s, value, (low, high) in coordinates}

    def only(self, symbols: Iterable[sp.Symbol]) -> "Sides":
        """The sides of some of its symbols."""
        asked = set(symbols)
        some = {s: ends for s, ends in self.box.items() if s in asked}
        return Sides(tuple(some), tuple(some.values()))

    def spread(self) -> Iterator[Point]:
        """Some points inside, the first near the middle, no two coordinates at the same share of their sides."""
        for shift in (0, 3, 7, 11, 17, 23):
            shares = [Fraction(40 + (5 * k + shift) * 7 % 47, 127) for k in range(len(self.symbols))]
            yield {s: _inside(e, t) for s, e, t in zip(self.symbols, self.ends, shares, strict=True)}

    def contains(self, point: Point) -> bool:
        """Whether an exact point of these symbols lies in the box."""
        return all(low <= point[s] <= high for s, (low, high) in self.box.items())


def sides(expression: sp.Expr, box: Box) -> tuple[sp.Expr, Sides]:
    """The expression with every symbol that is a point at its value, and the sides of the others, sorted by name.

    A symbol that the box does not name is unbounded. A point stays a side where it makes a part not a real number, and
    among powers too large for exact numbers.
    Raises: `EmptyBox`.
    """
    steep = largest_exponent(expression) > STEEP
    ends = {}
    for symbol in sorted(expression.free_symbols, key=lambda s: (s.name, str(sp.srepr(s)))):
        low, high = box.get(symbol, EVERYTHING)
        if not low <= high or low == math.inf or high == -math.inf:
            raise EmptyBox(symbol.name, low, high)
        ends[symbol] = low, high
    points = {s: sp.Rational(Fraction(low)) for s, (low, high) in ends.items() if low == high and not steep}
    fixed = settled(expression, points) if points else expression
    left = tuple(s for s in ends if s not in points or s in fixed.free_symbols)
    return fixed, Sides(left, tuple(ends[s] for s in left))


def _inside(ends: tuple[End, End], share: Fraction) -> Fraction:
    low, high = ends
    if abs(low) == math.inf:
        return Fraction(min(high, Fraction(1)) if abs(high) != math.inf else 1) - share
    if abs(high) == math.inf:
        return Fraction(low) + share
    return Fraction(low) * (1 - share) + Fraction(high) * share
