"""Lookup tables: as piecewise polynomials with exact numbers, as SymPy functions, and as operations of programs.

    f(t) = c_k0 + c_k1 (t - s_k) + c_k2 (t - s_k)^2 + c_k3 (t - s_k)^3     in cell k of its axis
    f(t, r) = c_k00 + c_k01 (r - s_l) + (t - s_k) (c_k10 + c_k11 (r - s_l))     in cell (k, l) of its axes

s_k is the start of cell k. A table is clamped at the ends of its axes, so f has a kink there where its slope is not 0.
A derivative by t jumps at breakpoints of t only: across those of r it is as continuous as f. So smoothness is stored
for each axis. A cell, and the order of a derivative, has an index for each axis. The polynomials are

    linear     c_k1 = D_k = (y_k - y_(k-1))/(x_k - x_(k-1))
    monotone   cubics through the points with slopes d_k, which rise and fall with the points, without other extrema

The slopes d_k are Fritsch and Butland's, as in PCHIP: 0 where D_k D_(k+1) <= 0, else the weighted harmonic mean

    3 (h_k + h_(k+1))/d = (2 h_(k+1) + h_k)/D_k + (h_(k+1) + 2 h_k)/D_(k+1),    h_k = x_k - x_(k-1)

At the ends d is the slope of the parabola through three points, 0 where its sign is not D's, and 3 D at most where the
next D has another sign. Sources: F. N. Fritsch and R. E. Carlson, "Monotone piecewise cubic interpolation", SIAM J.
Numer. Anal. 17 (1980), for the slopes of monotone cubics; F. N. Fritsch and J. Butland, "A method for constructing
local monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5 (1984), for these slopes.

In expressions ocv(x) is a SymPy function whose class has the table as an attribute, and ocv(x, 1) its derivative; with
two arguments they are friction(v, T), friction(v, T, 1, 0) and friction(v, T, 0, 1). Where a derivative jumps, its
value is the interval between its limits (reason in `rigor.tape`), and SymPy leaves it unevaluated at an exact number.

Programs compute a table by one operation, a bounded search for the cell and a polynomial with rounded coefficients:

    k = how many breakpoints are <= x,    f(x) = c_k0 + d (c_k1 + d (c_k2 + d c_k3)),    d = x - s_k

with the cells above. For two arguments they search along each axis and compute, with e = y - s_l,

    f(x, y) = c_00 + e c_01 + d (c_10 + e c_11)        of the cell (k, l)

Beyond its breakpoints a table is clamped, and its slope is 0. Where the argument is proved to stay between them
(`Axis.clamped` is false), only clamped estimates and rounding put it beyond: there a derivative is that at the end.

For an argument that is NaN k is 0, and d and the value are NaN: a lookup needs no guard. In a CasADi graph a lookup is
a call of its `graph`, whose name identifies it.

CasADi differentiates a call by the function's own derivative, wrongly where that is structurally zero; so `graph`
depends on each of its arguments in any case. `jacobian` gives a graph whose partial derivatives are lookups as well.
"""

import hashlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property, lru_cache, reduce
from hashlib import sha256
from itertools import accumulate, pairwise, product
from math import comb, inf, nextafter, perm
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import sympy as sp
from flint import fmpq
from sympy.core.function import FunctionClass

from hgogen.rigor.definite import fraction, number

Number = Fraction | float  # a float is infinite, or an exact number
Ends = tuple[Number, Number]
Index = tuple[int, ...]
Spans = list[tuple[int, int]]  # the first and the last cell, for each axis
Side = tuple[Any, Any]
Polynomial = Any  # coefficients, an array with an axis for each argument, the constant first
NEVER = 1000  # larger than any order of a derivative
ZERO, _NOTHING = Fraction(0), fmpq(0)

# --- polynomials


def polynomial_value(coefficients: Polynomial, at: Sequence[Any], number: Callable[[Any], Any] = lambda c: c) -> Any:
    """Return the value of a polynomial at the point `at`, by Horner's scheme. `coefficients`: nested lists, the
    outermost by powers of the first argument, the constant first; `number`: the conversion of each coefficient."""
    if not at:
        return number(coefficients)
    first, *tail = at
    *others, total = (polynomial_value(c, tail, number) for c in coefficients)
    for c in reversed(others):
        total = total * first + c
    return total


def taylor(piece: Polynomial, a: Fraction) -> list[Any]:
    """Return the coefficients, by powers of t, of the polynomial p(a + t, ..) shifted in its first argument; `piece`:
    the nested coefficients of p."""
    shifted = list(piece)
    for i in range(len(piece) - 1):
        for j in range(len(piece) - 2, i - 1, -1):
            shifted[j] = shifted[j] + a * shifted[j + 1]
    return shifted


def polynomial_range(piece: Polynomial, box: Sequence[Side]) -> Side:
    """Return an interval (low, high) that encloses a polynomial on a box; the degree must be at most 1 in every
    argument but the first, so that its extrema are at the ends of these sides.

    The interval is exact up to degree 2 in the first argument and where the derivative by this argument keeps its sign;
    else it is the hull of the Bernstein coefficients.
    """
    first, *tail = box
    corners = product(*(dict.fromkeys(side) for side in tail))
    ends = [_along([polynomial_value(c, corner) for c in piece], *first) for corner in corners]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _along(piece: Sequence[Any], a: Any, b: Any) -> Side:
    ends: tuple[Any, ...] = (polynomial_value(piece, (a,)), polynomial_value(piece, (b,)))
    slope = [k * c for k, c in enumerate(piece)][1:]
    if len(piece) > 3 and any(slope):
        low, high = _along(slope, a, b)
        if low < 0 < high:  # Bernstein coefficients on [a, b]: sum_j C(i, j)/C(n, j) p_j, p on [0, 1]
            n = len(piece) - 1
            scaled = [c * (b - a) ** j / comb(n, j) for j, c in enumerate(taylor(piece, a))]
            ends = tuple(sum(comb(i, j) * scaled[j] for j in range(i + 1)) for i in range(n + 1))
    elif len(piece) == 3 and piece[2] and a < (turn := -piece[1] / (2 * piece[2])) < b:
        ends = (*ends, polynomial_value(piece, (turn,)))
    return min(ends), max(ends)


# --- the polynomials between the points of one axis, of numbers or of arrays of them


def _rises(x: Sequence[Fraction], y: Any) -> list[Any]:
    return [(d - c) / (b - a) for a, b, c, d in zip(x, x[1:], y, y[1:], strict=False)]


def _monotone(x: Sequence[Fraction], y: Sequence[Fraction]) -> list[tuple[Any, ...]]:
    """Return the four coefficients of each cell's cubic, by powers of the distance from its start: monotone Hermite
    cubics through the values y at the breakpoints x."""
    h, D = [b - a for a, b in pairwise(x)], _rises(x, y)
    if len(h) == 1:
        d = [D[0], D[0]]
    else:
        pairs = list(zip(pairwise(h), pairwise(D), strict=True))
        means = (3 * (a + b) / ((2 * b + a) / C + (b + 2 * a) / E) if C * E > 0 else ZERO for (a, b), (C, E) in pairs)
        d = [_end(h[0], h[1], D[0], D[1]), *means, _end(h[-1], h[-2], D[-1], D[-2])]
    return [
        (y[k], d[k], (3 * D[k] - 2 * d[k] - d[k + 1]) / h[k], (d[k] + d[k + 1] - 2 * D[k]) / h[k] ** 2)
        for k in range(len(h))
    ]


def _end(h: Fraction, g: Fraction, D: Fraction, E: Fraction) -> Fraction:
    slope = ((2 * h + g) * D - h * E) / (h + g)
    if slope * D <= 0:
        return ZERO
    return 3 * D if D * E <= 0 and abs(slope) > 3 * abs(D) else slope


KINDS: Mapping[str, Callable[..., list[tuple[Any, ...]]]] = {
    "linear": lambda x, y: list(zip(y, _rises(x, y), strict=False)),
    "monotone": _monotone,
}
DEGREES = {"linear": 1, "monotone": 3}
SEVERAL = ("linear",)  # kinds for tables of several arguments

# --- one argument


@dataclass(frozen=True)
class Axis:
    """One axis of a table with the breakpoints x_0 < .. < x_(n-1): cell 0 lies below x_0, cell k is [x_(k-1), x_k],
    cell n lies above x_(n-1).

    `clamped`: whether the table is constant beyond the breakpoints; else the first and the last polynomial continue.
    `rounded`: bounds (below, above) of the rounding error of a program's argument, None for exact arguments.
    """

    x: tuple[Fraction, ...]
    clamped: bool = True
    rounded: Ends | None = None

    @cached_property
    def starts(self) -> tuple[Fraction, ...]:
        """Return the start of each cell (n + 1), from which its polynomial counts: the breakpoint below the cell, x_0
        for the first."""
        return (self.x[0], *self.x)

    @cached_property
    def _floats(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        nearest = [(float(x), x) for x in self.x]
        below = tuple(f if f <= x else nextafter(f, -inf) for f, x in nearest)
        return below, tuple(f if f >= x else nextafter(f, inf) for f, x in nearest)

    def _before(self, end: Number) -> int:
        return bisect_left(self._floats[0] if isinstance(end, float) else self.x, end)

    def _until(self, end: Number) -> int:
        return bisect_right(self._floats[1] if isinstance(end, float) else self.x, end)

    def overlapped(self, low: Number, high: Number) -> tuple[int, int]:
        """Return the first and the last cell that share more than an end point with [low, high]; for low = high the
        cells that contain this point."""
        if low == high:
            return self._before(low), self._until(low)
        return self._until(low), self._before(high)

    def readable(self, low: Number, high: Number) -> tuple[Ends, tuple[int, int]]:
        """Return the interval of the computed arguments for exact arguments in [low, high], and the first and the last
        cell that a program may read for them; at a breakpoint it reads the cell above. On an axis without clamping the
        interval is cut to [x_0, x_(n-1)]."""
        if self.rounded is None:
            return (low, high), self.overlapped(low, high)
        low, high = low - self.rounded[0], high + self.rounded[1]
        cells = self._until(low), self._until(high)
        if self.clamped:
            return (low, high), cells
        return (low if cells[0] else self.x[0], high if cells[1] < len(self.x) else self.x[-1]), cells

    def part(self, k: int, span: tuple[int, int], low: Number, high: Number) -> tuple[Any, Any]:
        """Return the ends of the part of [low, high] in cell k, as distances from the start of the cell: FLINT numbers
        or infinity. `span`: the first and the last cell that [low, high] overlaps."""
        x, starts = self._rational
        a = low if k == span[0] else starts[k]
        b = high if k == span[1] else x[k]
        return _since(starts[k], a), _since(starts[k], b)

    @cached_property
    def _rational(self) -> tuple[list[Any], list[Any]]:
        return list(map(number, self.x)), list(map(number, self.starts))

    def pieces(self, kind: str, values: np.ndarray) -> np.ndarray:
        """Return the polynomial coefficients (n + 1, powers, ..) of all cells for the `values` (n, ..) at the
        breakpoints; `kind`: "linear" or "monotone"."""
        inner = KINDS[kind](self.x, values)
        if self.clamped:
            outer = [[end, *[0 * end] * (len(inner[0]) - 1)] for end in (values[0], values[-1])]
        else:
            outer = [list(inner[0]), taylor(inner[-1], self.x[-1] - self.x[-2])]
        return np.array([outer[0], *inner, outer[1]], dtype=object)

    def smooth(self, pieces: np.ndarray) -> tuple[int, ...]:
        """Return for each breakpoint the order of the lowest derivative that jumps there: 1 for a kink, `NEVER` for
        none; `pieces`: the polynomials of the cells."""
        widths = [b - a for a, b in zip(self.starts, self.x, strict=False)]
        jumps = []
        for width, below, above in zip(
            widths, pieces[:-1], pieces[1:], strict=True
        ):  # about the breakpoint between them
            sides = enumerate(zip(taylor(below, width), above, strict=True))
            jumps.append(next((order for order, (a, b) in sides if np.any(np.not_equal(a, b))), NEVER))
        return tuple(jumps)


def _since(start: Any, end: Any) -> Any:
    return end if end in (-inf, inf) else number(end) - start


# --- a table


@dataclass(frozen=True)
class Cells:
    """A lookup table as a piecewise polynomial. `kind`: "linear" or "monotone"; `values` at the breakpoints: numbers,
    or with two axes a tuple of tuples, the outer one by the first axis."""

    name: str
    kind: str
    axes: tuple[Axis, ...]
    values: tuple[Any, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.name, self.kind, self.axes, self.values))

    @property
    def points(self) -> tuple[Any, ...]:
        """Return the data that make two tables equal: kind, breakpoints and values."""
        return self.kind, tuple(axis.x for axis in self.axes), self.values

    @property
    def plain(self) -> Index:
        """Return the order of differentiation (0, .., 0), one number for each argument: that of the table itself."""
        return (0,) * len(self.axes)

    def clamping(self, *clamped: bool) -> "Cells":
        """Return the table with a flag `clamped` for each axis: whether it is constant beyond the breakpoints. Without
        flags it is constant along all axes."""
        return self._with("clamped", clamped or (True,) * len(self.axes))

    def rounding(self, *rounded: Ends) -> "Cells":
        """Return the table for computed arguments, with bounds (below, above) of the rounding error of each
        argument."""
        return self._with("rounded", rounded)

    def _with(self, name: str, values: Sequence[Any]) -> "Cells":
        pairs = zip(self.axes, values, strict=True)
        return replace(self, axes=tuple(replace(axis, **{name: value}) for axis, value in pairs))

    @cached_property
    def pieces(self) -> np.ndarray:
        """Return the polynomial coefficients of all cells, an array whose first axes count cells, one for each
        argument, and whose last axes count powers, one for each argument."""
        values, count = np.array(self.values, dtype=object), len(self.axes)
        for axis in self.axes:
            values = np.moveaxis(axis.pieces(self.kind, values), (0, 1), (-2, -1))
        return values.transpose(*range(0, 2 * count, 2), *range(1, 2 * count, 2))

    def of_order(self, order: Index) -> np.ndarray:
        """Return the polynomial coefficients of a partial derivative of the table, laid out as in `pieces`; `order`:
        the number of derivatives by each argument."""
        return _of_order(self, tuple(min(k, DEGREES[self.kind] + 1) for k in order))

    @property
    def orders(self) -> list[Index]:
        """Return the orders of all partial derivatives that are not 0 everywhere, as tuples with a number for each
        argument."""
        return list(product(range(DEGREES[self.kind] + 1), repeat=len(self.axes)))

    @cached_property
    def smooth(self) -> tuple[Index, ...]:
        """Return, for each axis and each breakpoint of it, the order of the lowest derivative that jumps there, `NEVER`
        for none."""
        values = np.array(self.values, dtype=object)
        return tuple(axis.smooth(axis.pieces(self.kind, np.moveaxis(values, k, 0))) for k, axis in enumerate(self.axes))

    @property
    def smoothness(self) -> Index:
        """Return, for each axis, the order up to which all derivatives by its argument are continuous everywhere."""
        return tuple(min(each) - 1 for each in self.smooth)

    def overlapped(self, box: Sequence[Ends]) -> Spans:
        """Return, for each axis, the first and the last cell that share more than an end with the side of a box."""
        return [axis.overlapped(*side) for axis, side in zip(self.axes, box, strict=True)]

    def cell(self, box: Sequence[Ends]) -> Index | None:
        """Return the index, one number for each argument, of the only cell that a box overlaps; None if it overlaps
        several."""
        spans = self.overlapped(box)
        return tuple(last for _, last in spans) if all(first == last for first, last in spans) else None

    def least_smooth(self, spans: Spans) -> Index:
        """Return, for each axis, the order of the lowest derivative by its argument that jumps between the cells of
        `spans`, pairs (first, last); `NEVER` where none does."""
        return tuple(
            min(each[first:last], default=NEVER) for each, (first, last) in zip(self.smooth, spans, strict=True)
        )

    def continuous(self, spans: Spans, order: Sequence[int]) -> tuple[bool, ...]:
        """Return, for each axis, whether a partial derivative of the table is continuous across the cells of `spans`,
        pairs (first, last); `order`: the number of derivatives by each argument."""
        return tuple(k < smooth for k, smooth in zip(order, self.least_smooth(spans), strict=True))

    def at(self, place: Sequence[Fraction], order: Index) -> Fraction | None:
        """Return the exact value of a partial derivative of the table at the point `place`; None where the derivative
        jumps."""
        spans = self.overlapped([(t, t) for t in place])
        if not all(self.continuous(spans, order)):
            return None
        cell = tuple(last for _, last in spans)
        d = [t - start for t, start in zip(place, self.starts(cell), strict=True)]
        exact: Fraction = polynomial_value(self.of_order(order)[cell], d)
        return exact

    def starts(self, cell: Index) -> list[Fraction]:
        """Return the start of a cell along each axis, from which its polynomial counts the argument."""
        return [axis.starts[k] for axis, k in zip(self.axes, cell, strict=True)]

    def readable(self, box: Sequence[Ends]) -> tuple[list[Ends], Spans]:
        """Return the ranges of the computed arguments for exact arguments in a box, and for each axis the first and the
        last cell that a program may read for them."""
        sides, spans = zip(*(axis.readable(*side) for axis, side in zip(self.axes, box, strict=True)), strict=True)
        return list(sides), list(spans)

    def limits(self, box: Sequence[Ends], order: Index) -> tuple[Ends | None, tuple[bool, ...]]:
        """Return bounds of a partial derivative of the table on a box, as a program may compute it, and for each axis
        whether the derivative is continuous. Where it jumps the bounds enclose all its limits; they are None where a
        derivative of lower order jumps."""
        wide, spans = self.readable(box)
        smooth = self.least_smooth(spans)
        continuous = tuple(k < jump for jump, k in zip(smooth, order, strict=True))
        if any(jump < k for jump, k in zip(smooth, order, strict=True)):
            return None, continuous
        if all(continuous) and any(axis.rounded is not None for axis in self.axes):
            exact = self.overlapped(box)
            if all(self.continuous(exact, order)):
                wide, spans = list(box), exact
        return self._range(wide, spans, order), continuous

    def _range(self, box: Sequence[Ends], spans: Spans, order: Index) -> Ends:
        whole, level, pieces = _whole(self, order)
        ends = [
            whole[cell]
            if cell in level or all(a < k < b for k, (a, b) in zip(cell, spans, strict=True))
            else self._over(pieces[cell], cell, spans, box)
            for cell in cells_in(spans)
        ]
        sides = [side for side in ends if side is not None]
        if len(sides) < len(ends):
            return -inf, inf
        return fraction(min(least for least, _ in sides)), fraction(max(most for _, most in sides))

    def _over(self, piece: np.ndarray, cell: Index, spans: Spans, box: Sequence[Ends]) -> Side | None:
        sides = [axis.part(k, span, *side) for axis, k, span, side in zip(self.axes, cell, spans, box, strict=True)]
        for k, side in enumerate(sides):
            if inf in (-side[0], side[1]):
                if np.take(piece, range(1, piece.shape[k]), axis=k).any():  # it varies with this argument
                    return None
                sides[k] = (_NOTHING, _NOTHING)
        return polynomial_range(piece, sides)


def cells_in(spans: Spans) -> Iterator[Index]:
    """Yield the index of each cell in `spans`, a pair (first, last) for each axis."""
    return product(*(range(first, last + 1) for first, last in spans))


@lru_cache(maxsize=256)
def _of_order(cells: Cells, order: Index) -> np.ndarray:
    pieces = cells.pieces
    for k, times in enumerate(order):
        powers = np.moveaxis(pieces, len(order) + k, -1)  # those of argument k
        factors = np.array([perm(n, times) for n in range(powers.shape[-1])], dtype=object)
        derivative = (powers * factors)[..., times:] if times < len(factors) else 0 * powers[..., :1]
        pieces = np.moveaxis(derivative, -1, len(order) + k)
    return pieces


@lru_cache(maxsize=256)
def _whole(cells: Cells, order: Index) -> tuple[Mapping[Index, Side], Set[Index], np.ndarray]:
    pieces = np.frompyfunc(number, 1, 1)(cells.of_order(order))
    count = len(order)
    varies = pieces.reshape(*pieces.shape[:count], -1)[..., 1:].astype(bool).any(axis=-1)
    level = {tuple(cell) for cell in np.argwhere(~varies).tolist()}
    whole = {cell: (pieces[cell].flat[0],) * 2 for cell in level}
    widths = [[number(b - a) for a, b in zip(axis.starts, axis.x, strict=False)] for axis in cells.axes]
    for cell in set(product(*(range(1, len(axis.x)) for axis in cells.axes))) - level:
        sides = [(_NOTHING, width[k]) for width, k in zip(widths, cell, strict=True)]
        whole[cell] = polynomial_range(pieces[cell], sides)
    return whole, level, pieces


# --- functions of SymPy


class Table(sp.Function):  # type: ignore[misc]
    """A lookup table, or a derivative of it, as a SymPy function; `order`: how many derivatives by each argument."""

    cells: ClassVar[Cells]
    order: ClassVar[Index]
    is_real = True

    @classmethod
    def eval(cls, *arguments: sp.Expr) -> sp.Expr | None:
        """Return the exact value for rational arguments; None for others, and where the derivative jumps."""
        if not all(isinstance(argument, (sp.Float, sp.Rational)) for argument in arguments):
            return None
        written = (repr(float(each)) if isinstance(each, sp.Float) else each for each in arguments)
        exact = cls.cells.at([Fraction(str(each)) for each in written], cls.order)
        return None if exact is None else sp.Rational(exact)

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the partial derivative by argument number `argindex`, from 1, as a `Table` at the same arguments."""
        return applied(self.cells, self.args, next_order(self.order, argindex - 1))

    def _eval_evalf(self, prec: int) -> sp.Expr | None:
        digits = int(prec / 3.32)
        place = [argument.evalf(n=digits + 5) for argument in self.args]
        if isinstance(self, Stepped) or not all(isinstance(each, sp.Float) for each in place):
            return None
        exactly = map(sp.Rational, place)
        exact = self.cells.at([Fraction(int(each.p), int(each.q)) for each in exactly], self.order)
        return None if exact is None else sp.Rational(exact).evalf(n=digits + 1)

    def _sympystr(self, printer: Any) -> str:
        if hasattr(printer, "table"):
            return str(printer.table(self))
        order = self.order if any(self.order) else ()
        return f"{self.cells.name}({', '.join([*map(printer.doprint, self.args), *map(str, order)])})"

    def _latex(self, printer: Any, exp: str | None = None) -> str:
        inner, name = ", ".join(map(printer.doprint, self.args)), rf"\mathrm{{{self.cells.name}}}".replace("_", r"\_")
        several = rf"^{{\left({','.join(map(str, self.order))}\right)}}" if any(self.order) else ""
        primes = chr(39) * self.order[0] if len(self.order) == 1 else several
        text = rf"{name}{primes}\left({inner}\right)"
        return text if exp is None else rf"\left({text}\right)^{{{exp}}}"

    def __reduce_ex__(self, protocol: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return applied, (self.cells, self.args, self.order)


class Kinked(Table):
    """A lookup table, or a derivative of it, that is continuous and has a slope that jumps."""


class Stepped(Table):
    """A lookup table, or a derivative of it, whose value jumps at a breakpoint."""


def applied(cells: Cells, arguments: Sequence[sp.Expr], order: Index = ()) -> sp.Expr:
    """Return f(arguments) as a SymPy expression, for a table f or its partial derivative with `order` derivatives by
    each argument."""
    return function(cells, order or cells.plain)(*arguments)


def replaced(expression: sp.Expr, cells: Callable[[Table], Cells]) -> sp.Expr:
    """Return the expression with other tables at the same arguments; `cells`: a function from a lookup node to its new
    table."""
    if not expression.has(Table):
        return expression
    return expression.replace(
        lambda node: isinstance(node, Table), lambda node: applied(cells(node), node.args, node.order)
    )


def all_clamped(expression: sp.Expr) -> sp.Expr:
    """Return the expression with every table constant beyond its breakpoints, for arguments that may leave them."""
    return replaced(expression, lambda node: node.cells.clamping())


def next_order(order: Index, k: int) -> Index:
    """Return the order of differentiation with one more derivative by argument k, from 0; `order`: the number by each
    argument."""
    return (*order[:k], order[k] + 1, *order[k + 1 :])


@cache
def function(cells: Cells, order: Index) -> FunctionClass:
    """Return the SymPy function class, a `Table`, of a table's partial derivative; equal tables have one class.
    `order`: the number of derivatives by each argument."""
    margin = min(smooth - k for smooth, k in zip(cells.smoothness, order, strict=True))
    kind = Stepped if margin < 0 else Kinked if margin == 0 else Table
    members = {"cells": cells, "order": order, "nargs": len(order), "__module__": __name__}
    members["_imp_"] = staticmethod(_floats(cells, order))
    within = (f"within_{k}" for k, axis in enumerate(cells.axes) if not axis.clamped)
    roundings = (f"near_{sha256(repr(axis.rounded).encode()).hexdigest()[:16]}" for axis in cells.axes if axis.rounded)
    parts = (cells.name, *within, *roundings, *(map(str, order) if any(order) else ()))
    return FunctionClass("__".join(parts), (kind,), members)  # a unique name, for lambdify


def _floats(cells: Cells, order: Index) -> Callable[..., Any]:
    breaks = [np.array(list(map(float, axis.x))) for axis in cells.axes]
    starts = [np.array(list(map(float, axis.starts))) for axis in cells.axes]
    coefficients = by_power(cells.of_order(order)).astype(float)

    def function(*place: Any) -> Any:
        cell = tuple(np.searchsorted(each, t, side="right") for each, t in zip(breaks, place, strict=True))
        d = [t - each[k] for each, k, t in zip(starts, cell, place, strict=True)]
        return polynomial_value(coefficients, d, lambda column: column[cell])

    return function


def by_power(pieces: np.ndarray) -> np.ndarray:
    """Return an array of polynomial coefficients with its axes of powers first; in `pieces` the axes of cells are
    first."""
    count = pieces.ndim // 2
    return np.moveaxis(pieces, range(count), range(-count, 0))


Graph = Any
_KNOWN: dict[str, "Lookup"] = {}  # by the names of their functions, all that a call in a graph tells
_TERMS = 2  # least number of terms of a polynomial in a graph
_NAMES = (("x", "start", "k", "d"), ("y", "start_y", "j", "e"))


@dataclass(frozen=True)
class Argument:
    """An argument of a table lookup in emitted code: the names of the argument, of the `array` of breakpoints, of the
    `cell` index and of the `distance` from the start of the cell; `starts` (n + 1): the start of each cell."""

    name: str
    array: str
    cell: str
    distance: str
    starts: tuple[float, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Return the breakpoints (n) of the argument, in rising order."""
        return self.starts[1:]

    @property
    def probes(self) -> tuple[int, ...]:
        """Return the steps of the binary search for the cell index among n breakpoints: the powers of two up to n,
        largest first."""
        return tuple(2**i for i in reversed(range(len(self.breaks).bit_length())))


@dataclass(frozen=True)
class Lookup:
    """A table or a partial derivative of it as one operation of a program; `order`: the number of derivatives by each
    argument.

    `computed`: the table as the program evaluates it, clamped along each axis without a derivative, along the others as
    `cells` is.
    """

    cells: Cells = field(compare=False)
    order: Index
    computed: Cells = field(init=False)

    def __post_init__(self) -> None:
        ways = zip(self.cells.axes, self.order, strict=True)
        object.__setattr__(self, "computed", self.cells.clamping(*(axis.clamped or not k for axis, k in ways)))

    @property
    def name(self) -> str:
        """Return the name in emitted code: table_ocv, and its derivatives slope_ocv, slope_2_ocv, ..; with two
        arguments slope_1_0_friction, slope_0_1_friction, ..; derivatives that are 0 beyond the breakpoints
        flat_slope_ocv, flat_x_slope_1_0_friction, .."""
        order = "" if self.order == (1,) else "".join(f"{k}_" for k in self.order)
        axes = "".join(f"{x}_" for x in self._flat) if len(self.order) > 1 else ""
        flat = f"flat_{axes}" if self._flat else ""
        return f"{flat}slope_{order}{self.cells.name}" if any(self.order) else f"table_{self.cells.name}"

    @property
    def comment(self) -> str:
        """Return the comment above the lookup in emitted code: the kind of table, its size, and its ends."""
        order = " and ".join(map(str, self.order))
        derivative = "slope" if self.order == (1,) else f"derivative of order {order}"
        prefix = f"the {derivative} of " if any(self.order) else ""
        points = " x ".join(str(len(axis.x)) for axis in self.cells.axes)
        kind = self.cells.kind if len(self.order) == 1 else "bilinear"
        ends = "held at its ends" if not any(self.order) or self._flat else "with its slopes held at its ends"
        return f"{prefix}the table {self.cells.name}: {kind}, {points} points, {ends}"

    @property
    def _flat(self) -> list[str]:
        ways = zip(self.computed.axes, self.order, _NAMES, strict=False)
        return [names[0] for axis, k, names in ways if k and axis.clamped]

    @cached_property
    def axes(self) -> tuple[Argument, ...]:
        """Return an `Argument`, with its names in emitted code and its breakpoints, for each axis of the table."""
        starts = (tuple(map(float, axis.starts)) for axis in self.cells.axes)
        return tuple(Argument(*names, each) for names, each in zip(_NAMES, starts, strict=False))

    @cached_property
    def coefficients(self) -> np.ndarray:
        """Return the coefficients of the cells' polynomials in the distances from the starts: an array whose first axes
        count powers, one for each argument, and whose last axes count cells."""
        pieces = self.computed.of_order(self.order).copy()
        for k, axis in enumerate(self.computed.axes):
            if not axis.clamped:  # beyond the breakpoints it is constant
                along = np.moveaxis(pieces, (k, k + len(self.axes)), (0, 1))
                along[[0, -1], 1:] = ZERO
        return by_power(pieces).astype(float)

    @cached_property
    def arrays(self) -> dict[str, list[float]]:
        """Return the constant arrays of emitted code by name: the starts of the cells, and the coefficients c0, c1, ..
        (c00, c01, .. with two arguments), numbered by their powers."""
        starts = {axis.array: list(axis.starts) for axis in self.axes}
        powers = np.ndindex(self.coefficients.shape[: len(self.axes)])
        return starts | {f"c{''.join(map(str, each))}": self.coefficients[each].ravel().tolist() for each in powers}

    @property
    def flattened(self) -> list[str]:
        """Return the statement of emitted code that combines the indices of cell (k, l) to k m + l, m the cells of the
        last axis; [] for one argument."""
        return [f"{b.cell} = {a.cell} * {len(b.starts)} + {b.cell}" for a, b in pairwise(self.axes)]

    def formula(self, zero: str) -> str:
        """Return the text of the cell's polynomial by Horner's scheme, with the order of operations of `graph`. `zero`:
        the text of a slope 0, which a constant polynomial is given so that a distance NaN makes its value NaN."""
        return _formula(self.coefficients.shape, "c", [axis.distance for axis in self.axes], self.axes[-1].cell, zero)

    def slopes(self, *arguments: Graph) -> Graph:
        """Return the row (1, number of arguments) of a table's partial derivatives at graphs of its arguments."""
        orders = (next_order(self.order, k) for k in range(len(arguments)))
        return ca.horzcat(*(Lookup(self.cells, order)(*arguments) for order in orders))

    def __call__(self, *arguments: Graph) -> Graph:
        """Return the table's value at CasADi graphs of its arguments, as a graph."""
        return self.graph(*arguments)

    @cached_property
    def graph(self) -> ca.Function:
        """Return the lookup as a CasADi function that is never inlined, so that a graph that uses it has one call."""
        text = repr((self.cells.name, self.cells.points, self.order, [axis.clamped for axis in self.cells.axes]))
        name = f"table_{hashlib.sha256(text.encode()).hexdigest()[:20]}"
        _KNOWN[name] = self
        names = [axis.name for axis in self.axes]
        arguments = [ca.MX.sym(each) for each in names]
        cells = [_searched(axis, x) for axis, x in zip(self.axes, arguments, strict=True)]
        d = [x - _element(axis.starts, k) for axis, x, k in zip(self.axes, arguments, cells, strict=True)]
        cell = reduce(lambda whole, part: whole * len(part[0].starts) + part[1], zip(self.axes, cells, strict=True), 0)
        missing = [(0, max(_TERMS - powers, 0)) for powers in self.coefficients.shape[: len(d)]]
        filled = np.pad(self.coefficients, [*missing, *[(0, 0)] * len(d)])
        result = polynomial_value(filled, d, lambda column: _element(column.ravel().tolist(), cell))
        return ca.Function(name, arguments, [result], names, ["value"], {"never_inline": True})


def _formula(shape: Sequence[int], name: str, distances: Sequence[str], cell: str, zero: str) -> str:
    """Return the source text of Horner's scheme for a polynomial. `shape`: the number
    of powers of each distance; `name`: the prefix of the coefficient arrays;
    `cell`: the text of their index; `zero`: the derivative of a constant."""
    if not distances:
        return f"{name}[{cell}]"
    d, *tail = distances
    parts = [_formula(shape[1:], f"{name}{power}", tail, cell, zero) for power in range(shape[0])]
    *others, total = parts if len(parts) > 1 else (*parts, zero)
    for part in reversed(others):
        total = f"{part} + {d} * ({total})"
    return total


def _searched(axis: Argument, x: Graph) -> Graph:
    n, k = len(axis.breaks), ca.MX(0)
    for probe in axis.probes:
        there = k + probe
        within = there <= n
        at = ca.if_else(within, there, 1) - 1
        k = k + probe * ca.logic_and(within, _element(axis.breaks, at) <= x)
    return k


def _element(numbers: Sequence[float], k: Graph) -> Graph:
    return ca.MX(ca.DM(list(numbers)))[k]


def called(instruction: Graph) -> Lookup | ca.Function:
    """Return the `Lookup`, or the other CasADi function, that a call instruction of a graph calls."""
    function: ca.Function = instruction.which_function()
    return _KNOWN.get(function.name(), function)


Call = Callable[[ca.Function, Sequence[Graph]], Sequence[Graph]]


def walked(
    function: ca.Function,
    inputs: Sequence[Graph],
    apply: Callable[..., Graph],
    call: Call | None = None,
    operations: Sequence[int] = (),
) -> list[Graph]:
    """Return the outputs of an SX function evaluated at other inputs, instruction by instruction.

    `apply(operation, lookup or None, *arguments)`: the value of an operation; `call(function, arguments)`: the values
    of a called function, which is inlined by default; `operations`: the codes of the instructions, by default CasADi's.
    """

    def called_values(target: Lookup | ca.Function, elements: Sequence[Graph]) -> Sequence[Graph]:
        if isinstance(target, Lookup):
            return [apply(ca.OP_CALL, target, *elements)]
        ends = list(accumulate((target.numel_in(i) for i in range(target.n_in())), initial=0))
        columns = [ca.vertcat(*elements[a:b]) for a, b in pairwise(ends)]
        values = call(target, columns) if call else walked(target, columns, apply)
        return [each for value in values for each in value.nonzeros()]

    def operation(op: int, values: Sequence[Graph]) -> Graph:
        return apply(op, None, *values)

    outputs = folded(function, lambda k, i: inputs[k][i], ca.SX, operation, called_values, operations)
    results = [ca.SX(function.sparsity_out(k)) for k in range(function.n_out())]
    for result, elements in zip(results, outputs, strict=True):
        for k, element in enumerate(elements):
            result.nz[k] = element
    return results


def folded(
    function: ca.Function,
    inputs: Callable[[int, int], Any],
    constant: Callable[[float], Any],
    apply: Callable[[int, list[Any]], Any],
    call: Callable[[Any, list[Any]], Sequence[Any]],
    operations: Sequence[int] = (),
) -> list[list[Any]]:
    """Return the nonzeros of each output of an SX function, evaluated in any arithmetic.

    `inputs(k, i)`: element i of argument k; `constant(number)`: a constant; `apply(operation, values)`: the value of an
    operation; `call(function, values)`: the elements of the result of a lookup or a called function; `operations`: the
    codes of the instructions, by default CasADi's.
    """
    work: dict[int, Any] = {}
    outputs = [[constant(0.0)] * function.nnz_out(k) for k in range(function.n_out())]
    rows = _rows(function)
    for (code, read, wrote, more), op in zip(rows, operations or (row[0] for row in rows), strict=True):
        if code == ca.OP_INPUT:
            work[wrote[0]] = inputs(*read)
        elif code == ca.OP_OUTPUT:
            outputs[wrote[0]][wrote[1]] = work[read[0]]
        elif code == ca.OP_CONST:
            work[wrote[0]] = constant(more)
        elif code == ca.OP_CALL:
            work |= zip(wrote, call(more, [work[place] for place in read]), strict=True)
        else:
            work[wrote[0]] = apply(op, [work[place] for place in read])
    return outputs


@lru_cache(maxsize=256)  # a program is evaluated on many pieces of a plant's ranges
def _rows(function: ca.Function) -> list[tuple[int, list[int], list[int], Any]]:
    rows, texts = [], instructions(function)
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        number = function.instruction_constant(k) if op == ca.OP_CONST else None
        more = called(texts[k]) if op == ca.OP_CALL else number
        rows.append((op, list(function.instruction_input(k)), list(function.instruction_output(k)), more))
    return rows


def instructions(function: ca.Function) -> list[Graph]:
    """Return the instructions of an SX function as graphs, from which the called functions can be read; [] for a
    function without a call."""
    return ca.vertsplit(function.instructions_sx()) if calls(function) else []


def calls(function: ca.Function) -> bool:
    """Return whether an SX function calls a CasADi function, such as a lookup."""
    return bool(function.find_functions(0))


def jacobian(rows: Graph, x: Graph) -> Graph:
    """Return the Jacobian (p, n) of `rows` r (p) in symbols x (n); derivatives of tables in it are lookups.

    With a symbol c_i for the value of each call f_i(a_i), in the order of the program,

        dr/dx = r_x + sum_i r_(c_i) D_i,    D_i = f_i'(a_i) (a_(i,x) + sum_(j < i) a_(i,c_j) D_j)

    where f_i' is the row of partial derivatives of f_i, and a_(i,x) has a row for each of its arguments.
    """
    read = ca.symvar(rows)
    symbols = ca.vertcat(*read) if read else ca.SX(0, 1)
    program = ca.Function("rows", [symbols], [ca.densify(rows)])
    calls: list[tuple[Graph, Lookup, list[Graph]]] = []

    def apply(op: int, lookup: Lookup | None, *args: Graph) -> Graph:
        if lookup is None:
            return (ca.SX.unary if len(args) == 1 else ca.SX.binary)(op, *args)
        calls.append((ca.SX.sym(f"c{len(calls)}"), lookup, list(args)))
        return calls[-1][0]

    if not instructions(program):
        return ca.jacobian(rows, x)  # CasADi's own, on which the bytes of emitted code depend
    (whole,) = walked(program, [symbols], apply)
    placeholders, values, slopes = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0, x.numel())
    for symbol, lookup, args in calls:
        at, row = ca.vertcat(*args), lookup.slopes(*args)
        slopes = ca.vertcat(slopes, row @ (ca.jacobian(at, x) + ca.jacobian(at, placeholders) @ slopes))
        values = ca.vertcat(values, lookup(*ca.vertsplit(ca.substitute(at, placeholders, values))))
        placeholders = ca.vertcat(placeholders, symbol)
    total = ca.jacobian(whole, x) + ca.jacobian(whole, placeholders) @ slopes
    return ca.substitute(total, placeholders, values)


def hessian(value: Graph, x: Graph) -> Graph:
    """Return the Hessian (n, n) of a scalar `value` in symbols x (n); derivatives of tables in it are lookups."""
    first = jacobian(value, x)
    program = ca.Function("rows", [ca.vertcat(*ca.symvar(value))] if ca.symvar(value) else [], [value])
    return jacobian(first.T, x) if instructions(program) else ca.hessian(value, x)[0]
