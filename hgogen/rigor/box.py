"""Boxes, the closed and perhaps unbounded ranges of symbols with exact ends, and exact rational sample points.

The value of an expression at a sample point can refute a claim and never prove one.
"""

import math
import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import islice, product
from typing import Any, Protocol, TypeAlias

import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.outward import Pair, number
from hgogen.rigor.periodic import whole_turn

RationalPoint = Mapping[sp.Symbol, sp.Rational]

STEEP = 2000  # exponents beyond which exact numbers would have too many digits
_CORNERS = 64
_RANDOM = 32
# An imaginary part that is larger than this, evaluated to 15 digits, is not zero.
_NOT_ZERO = 1e-9
# Functions that SymPy extends beyond the reals.
_PARTIAL = (sp.Pow, sp.log, sp.asin, sp.acos, sp.acosh, sp.atanh)
# Functions that jump or have no bounded slope at -1 or 1, or where an argument is 0.
_WITH_ENDS = (sp.asin, sp.acos, sp.acosh, sp.atanh)
_STEEP = (sp.log, sp.sign, sp.Heaviside, sp.atan2, sp.cot, sp.coth)
_CLOSE = 0.01  # distance to an end below which SymPy, which needs two digits for a sign, may round to the end
STRANGE = (sp.I, sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds)  # not finite real numbers


class Ranged(Protocol):
    """A symbol with an optional declared range, nominal value and period: a `Signal`."""

    low: float | None
    high: float | None
    nominal: float | None
    period: float | None

    @property
    def bounded(self) -> bool:
        """Return whether the symbol has a declared range."""


def points(signals: Sequence[Ranged]) -> Iterator[RationalPoint]:
    """Yield exact rational points of the box of the signals' ranges: the middle, points with zeros, corners, then
    random points with a fixed seed."""
    ends = [_range_of(s) for s in signals]
    yield {s: (low + high) / 2 for s, (low, high) in zip(signals, ends, strict=True)}
    for s, (low, high) in zip(signals, ends, strict=True):
        if low <= 0 <= high:  # the others off centre, so that a failure is due to s alone
            yield {t: (3 * a + 4 * b) / 7 for t, (a, b) in zip(signals, ends, strict=True)} | {s: sp.S.Zero}
    for corner in islice(product(*ends), _CORNERS):
        yield dict(zip(signals, corner, strict=True))
    draw = random.Random(1)
    for _ in range(_RANDOM if signals else 0):
        yield {
            s: low + (high - low) * sp.Rational(draw.randint(0, 1000), 1000)
            for s, (low, high) in zip(signals, ends, strict=True)
        }


def largest_exponent(expression: sp.Expr) -> int:
    """Return the largest |p| of the numerical exponents p/q in an expression."""
    return max((abs(int(node.exp.p)) for node in expression.atoms(sp.Pow) if node.exp.is_Rational), default=0)


def sign_at(expression: sp.Expr, point: RationalPoint) -> str:
    """Return the sign of an expression at a point: "> 0", "< 0", "= 0", "undefined", or "?" where it is not decided. It
    is decided by exact zero tests and by guaranteed digits; powers too large for exact numbers are not."""
    if largest_exponent(expression) > STEEP:
        return "?"
    at = dict(point)
    try:
        answer = _kind(expression.xreplace(at))
        rounded = answer in ("= 0", "undefined") and any(_by_an_end(e, at) for e in expression.atoms(*_WITH_ENDS))
    except (ValueError, TypeError, NotImplementedError, ArithmeticError):
        return "?"  # SymPy compares what is not real, or gives up
    return "?" if rounded else answer


def _by_an_end(node: sp.Expr, at: Mapping[Any, Any]) -> bool:
    """Return whether the argument of a function is so close to an end of the function's domain that SymPy may round it
    to that end: SymPy's acosh(1 + 10^-20) is 0, and 1/acosh(1 + 10^-20) infinite."""
    argument = node.args[0].xreplace(at)
    room = (argument - 1 if isinstance(node, sp.acosh) else 1 - argument**2).evalf(15)
    return argument not in (1, -1) and (_is_noise(room) or bool(room.is_Float and 0 < room < _CLOSE))


def _kind(value: sp.Expr) -> str:
    if value.is_zero:
        return "= 0"
    if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds) or value.is_real is False:
        return "undefined"
    if any(node.is_real is False for node in value.atoms(*_PARTIAL)):  # its digits would take minutes
        return "undefined"
    digits = _digits(value.evalf(15))
    return "?" if digits != "?" and any(_near_an_edge(node) for node in value.atoms(sp.Pow, sp.Function)) else digits


def _digits(value: sp.Expr) -> str:
    if value.is_Float:
        return "?" if _is_noise(value) else "> 0" if value > 0 else "< 0"
    imaginary = value.as_real_imag()[1]
    return "undefined" if imaginary.is_Float and abs(imaginary) > _NOT_ZERO else "?"


def _is_noise(value: sp.Expr) -> bool:
    """Return whether no digit of a SymPy number is certain; SymPy then gives it the precision 1."""
    return bool(value.is_Float and value._prec == 1)


def edges(node: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return the expressions whose zeros are the places where a power or function `node` jumps or has an unbounded
    slope."""
    (first, *_) = node.args
    if isinstance(node, sp.Pow):
        return () if node.exp.is_Integer and node.exp > 0 else (first,)
    if isinstance(node, _WITH_ENDS):
        return first - 1, first + 1
    if isinstance(node, sp.tan):
        return (sp.cos(first),)
    return tuple(node.args) if isinstance(node, _STEEP) else ()


def _near_an_edge(node: sp.Expr) -> bool:
    """Return whether an argument of the function may lie where the function has an unbounded slope, as 0 for a root.
    There SymPy's count of correct digits fails: it would give digits of |sin(1)**2 + cos(1)**2 - 1|**(1/2)."""
    return any(_is_noise(part) for e in edges(node) for part in e.evalf(15).as_real_imag())


def substituted(expression: sp.Expr, values: Mapping[Any, Any]) -> sp.Expr | None:
    """Return the expression with the `values` substituted for symbols; None where SymPy would have to compare complex
    numbers."""
    try:
        return expression.xreplace(dict(values))
    except (ValueError, TypeError):
        return None


def substituted_where_real(expression: sp.Expr, values: Mapping[sp.Symbol, sp.Rational]) -> sp.Expr:
    """Return the expression with the `values` substituted for symbols, except for symbols of a root, inverse or
    logarithm that would not be a finite real number: SymPy would continue with complex values, and |log(-1)| would be
    pi."""
    nodes = (node for node in expression.atoms(*_PARTIAL) if not values.keys().isdisjoint(node.free_symbols))
    stay = {s for node in nodes if not _is_real_at(node, values) for s in node.free_symbols}
    return expression.xreplace({s: value for s, value in values.items() if s not in stay})


def _is_real_at(node: sp.Expr, values: Mapping[sp.Symbol, sp.Rational]) -> bool:
    if node.is_Pow and node.exp.is_Integer and node.exp > 0:
        return True
    value = substituted(node, values)
    if value is None:
        return False
    return bool(value.is_real) if value.is_number else not value.has(*STRANGE)


def witness(point: RationalPoint) -> dict[str, float]:
    """Return the coordinates of a point as floats by the symbols' names, for a report."""
    return {s.name: float(value) for s, value in point.items()}


def exact(expression: sp.Expr) -> sp.Expr:
    """Return the expression with each float replaced by the rational of its shortest decimal; a float of more than 53
    bits is replaced by the rational number that it is."""
    rationals = {}
    for written in expression.atoms(sp.Float):
        nearest = float(written)
        exact = math.isfinite(nearest) and (nearest != 0.0 or written == 0)
        rationals[written] = sp.Rational(repr(nearest)) if exact else sp.Rational(written)
    return expression.xreplace(rationals)


def _range_of(signal: Ranged) -> tuple[sp.Rational, sp.Rational]:
    """Return the declared range of a signal, or without one a range around its nominal value."""
    if signal.bounded:
        return sp.Rational(str(signal.low)), sp.Rational(str(signal.high))
    centre = sp.Rational(str(signal.nominal or 0.0))
    return centre - 10, centre + 10


End: TypeAlias = Fraction | float
Box: TypeAlias = Mapping[sp.Symbol, tuple[End, End]]
Point: TypeAlias = dict[sp.Symbol, Fraction]

EVERYTHING = (-math.inf, math.inf)


@dataclass(eq=False)
class EmptyBox(HgogenError):
    """The error that the range [low, high] of a signal has ends that are NaN or in the wrong order."""

    text = "the range [{low}, {high}] of {name} holds no number; give low <= high, not NaN"
    name: str
    low: End
    high: End


def box(
    signals: Iterable[Ranged], nominal: Mapping[sp.Symbol, sp.Rational] | None = None
) -> dict[sp.Symbol, tuple[End, End]]:
    """Return the range (low, high) of each signal. A signal without a declared range has its value in `nominal` (such
    as `system.nominal`, of the parameters), else it is unbounded. A float is the rational of its shortest decimal; the
    ends of an angle are rounded outward to a whole turn."""
    fixed = nominal or {}
    ends: dict[sp.Symbol, tuple[End, End]] = {}
    for signal in signals:
        if signal.low is not None and signal.high is not None:
            low, high = _shortest_decimal(float(signal.low)), _shortest_decimal(float(signal.high))
            ends[signal] = (low, high) if signal.period is None else whole_turn(low, high, signal.period)
        elif signal in fixed:
            ends[signal] = (Fraction(fixed[signal]),) * 2
        else:
            ends[signal] = EVERYTHING
    return ends


@lru_cache(maxsize=4096)
def _shortest_decimal(value: float) -> Fraction:
    return Fraction(repr(value))


@dataclass(frozen=True)
class Sides:
    """A box with exact ends: the ranges `ends` (low, high) of the `symbols`, in their order."""

    symbols: tuple[sp.Symbol, ...]
    ends: tuple[tuple[End, End], ...]

    @property
    def box(self) -> dict[sp.Symbol, tuple[End, End]]:
        """Return the range of each symbol."""
        return dict(zip(self.symbols, self.ends, strict=True))

    @cached_property
    def outer(self) -> Pair:
        """Return the smallest box of floats around the exact one: its lower and its upper ends."""
        lows, highs = [number(low)[0] for low, _ in self.ends], [number(high)[1] for _, high in self.ends]
        return np.array(lows, dtype=float), np.array(highs, dtype=float)

    @cached_property
    def inner(self) -> Pair:
        """Return the largest box of floats inside the exact one: its lower and its upper ends."""
        lows, highs = [number(low)[1] for low, _ in self.ends], [number(high)[0] for _, high in self.ends]
        return np.array(lows, dtype=float), np.array(highs, dtype=float)

    def point(self, x: Iterable[float]) -> Point:
        """Return the exact point at the floats x, one for each symbol; an x beyond an end of its side becomes that
        end."""
        coordinates = zip(self.symbols, x, self.ends, strict=True)
        return {s: Fraction(max(min(value, high), low)) for s, value, (low, high) in coordinates}

    def only(self, symbols: Iterable[sp.Symbol]) -> "Sides":
        """Return the box of these symbols only; symbols that it does not have are ignored."""
        wanted = set(symbols)
        some = {s: ends for s, ends in self.box.items() if s in wanted}
        return Sides(tuple(some), tuple(some.values()))

    def spread(self) -> Iterator[Point]:
        """Yield six interior points, the first one near the middle; the coordinates of a point divide their sides in
        different ratios."""
        for shift in (0, 3, 7, 11, 17, 23):
            shares = [Fraction(40 + (5 * k + shift) * 7 % 47, 127) for k in range(len(self.symbols))]
            yield {s: _inside(e, t) for s, e, t in zip(self.symbols, self.ends, shares, strict=True)}

    def contains(self, point: Point) -> bool:
        """Return whether an exact point, a number for each symbol, lies in the box."""
        return all(low <= point[s] <= high for s, (low, high) in self.box.items())


def sides(expression: sp.Expr, box: Box) -> tuple[sp.Expr, Sides]:
    """Return the expression with each symbol of a one-point range replaced by its value, and the box of the remaining
    symbols, sorted by name.

    A symbol that the box does not name is unbounded. A one-point range is kept as a side where its value would make a
    subexpression not real, and where powers are too large for exact numbers. Raises: `EmptyBox`.
    """
    steep = largest_exponent(expression) > STEEP
    ends = {}
    for symbol in sorted(expression.free_symbols, key=lambda s: (s.name, str(sp.srepr(s)))):
        low, high = box.get(symbol, EVERYTHING)
        if not low <= high or low == math.inf or high == -math.inf:
            raise EmptyBox(symbol.name, low, high)
        ends[symbol] = low, high
    points = {s: sp.Rational(Fraction(low)) for s, (low, high) in ends.items() if low == high and not steep}
    fixed = substituted_where_real(expression, points) if points else expression
    remaining = {s: side for s, side in ends.items() if s not in points or s in fixed.free_symbols}
    return fixed, Sides(tuple(remaining), tuple(remaining.values()))


def _inside(ends: tuple[End, End], share: Fraction) -> Fraction:
    low, high = ends
    if abs(low) == math.inf:
        return Fraction(min(high, Fraction(1)) if abs(high) != math.inf else 1) - share
    if abs(high) == math.inf:
        return Fraction(low) + share
    return Fraction(low) * (1 - share) + Fraction(high) * share
