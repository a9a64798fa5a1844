"""Ranges on a box without bisection: by one look in outward-rounded intervals, and with rational ends.

Of rational ends no number overflows, underflows or is rounded towards the wrong side. Sums, products and powers of
exact ends are exact, up to what is rounded outward beyond `_BITS` bits; exp and the like come from Arb at the ends, a
number from Arb whole. Natural interval extension: R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to interval
analysis", SIAM 2009, chapter 5.

Proofs count the cells of a table that a program may take. v + 273.15 is rounded to a breakpoint that it does not reach,
and 1000 v - 1099 by far more than a number of its size is. A running error bound, in single precision: an operation
adds a share of its result, `UNIT`, to the errors of its operands, which it multiplies by its slopes (N. J. Higham,
"Accuracy and stability of numerical algorithms", 2nd edition, SIAM 2002, section 3.3).

Beyond its points a table is held, and its slope 0. Where an argument keeps within them on the box, that of a program
lies beyond by rounding alone: the program's derivatives go on there (`algebra.lookup`), and those of proofs end there.
Else both have the slope 0 as well. `between` decides for either. A program's go on also where the box is larger by no
more than the argument may be rounded, as that of z = 0.3 x is, with its ends outward; there proofs count both.
"""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache, reduce
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from flint import arb, ctx

from hgogen.rigor.balls import ends as of_ball
from hgogen.rigor.balls import values
from hgogen.rigor.box import EVERYTHING, Box, End, Sides, sides
from hgogen.rigor.definite import number
from hgogen.rigor.enclosure import enclose as enclosures
from hgogen.rigor.interpolation import Axis, Cells, Ends, Stepped, Table, replaced
from hgogen.rigor.kinks import Norm
from hgogen.rigor.points import STEEP, STRANGE, exact
from hgogen.rigor.search import is_defined
from hgogen.rigor.tape import NoTape, tape

# --- how far a program may round the argument of a table

UNIT = 2.0**-21  # 8 times what a number is rounded by in single precision
_TINY = 2.0**-120  # what is smaller may be lost


def rounded(expression: sp.Expr, around: Sides) -> sp.Expr:
    """The expression with tables that know how far their arguments may be rounded on a box."""

    def cells(node: Table) -> Cells:
        pairs = zip(node.cells.axes, node.args, strict=True)
        return node.cells.rounding(*(_sides(axis, e, around) for axis, e in pairs))

    return replaced(expression, cells)


def rounding(argument: sp.Expr, box: Box) -> End:
    """How far an argument may be rounded on a box; infinite where that is not known."""
    error = _error(*sides(exact(argument), box))
    return Fraction(error) if math.isfinite(error) else math.inf


def _sides(axis: Axis, argument: sp.Expr, around: Sides) -> Ends:
    """How far below and above. A signal by itself is rounded as breakpoints are: past none but one that is the same
    number in single precision as the end of its range."""
    error = _error(argument, around)
    most = Fraction(error) if math.isfinite(error) else math.inf
    if not argument.is_Symbol:
        return most, most
    high = around.ends[around.symbols.index(argument)][1]
    return Fraction(0), most if any(high < x <= high + most for x in axis.x) else Fraction(0)


@lru_cache(maxsize=4096)
def _error(e: sp.Expr, around: Sides) -> float:
    """A bound of the error of an expression, infinite where none is known."""
    if not e.args:
        return UNIT * _largest_size(e, around) + _TINY
    if isinstance(e, sp.Piecewise):  # one branch or another
        branches = [part for part, _ in e.args]
        ranges = [_range(part, around) for part in branches]
        width = max(high for _, high in ranges) - min(low for low, _ in ranges)
        return _sure(width + max(_error(part, around) for part in branches))
    if not all(isinstance(part, sp.Expr) for part in e.args):
        return math.inf
    errors = [_error(part, around) for part in e.args]
    if isinstance(e, (sp.Add, sp.Mul)):
        sizes = [_largest_size(part, around) for part in e.args]
        whole = [size + error for size, error in zip(sizes, errors, strict=True)]
        moved = sum(errors) if isinstance(e, sp.Add) else math.prod(whole) - math.prod(sizes)
        total = sum(whole) if isinstance(e, sp.Add) else math.prod(whole)
        return _sure(moved + len(whole) * UNIT * total + _TINY)
    return _through(e, errors, around)


def _through(e: sp.Expr, errors: Sequence[float], around: Sides) -> float:
    """Through a function: by its slopes, where it has any, or by its whole range."""
    moving = [(part, error, sp.Dummy(real=True)) for part, error in zip(e.args, errors, strict=True)]
    moving = [each for each in moving if each[0].free_symbols]
    stands = {part: dummy for part, _, dummy in moving}
    ends = [(low - error, high + error) for (low, high), error in ((_range(part, around), d) for part, d, _ in moving)]
    low, high = np.array(ends).reshape(len(moving), 2).T[:, :, None]
    try:
        program = tape([e.func(*(stands.get(part, part) for part in e.args))], stands.values())
    except NoTape:
        return math.inf
    (there,) = enclosures(program, low, high, slopes=True)
    least, most = float(there.value[0][0]), float(there.value[1][0])
    assert there.slope is not None
    steep = np.maximum(np.abs(there.slope[0]), np.abs(there.slope[1]))[:, 0].tolist()
    moved = sum(slope * error for slope, (_, error, _) in zip(steep, moving, strict=True))
    return min(_sure(moved), _sure(most - least)) + UNIT * max(abs(least), abs(most)) + _TINY


def _largest_size(e: sp.Expr, around: Sides) -> float:
    return max(map(abs, _range(e, around)))


@lru_cache(maxsize=4096)
def _range(e: sp.Expr, around: Sides) -> tuple[float, float]:
    low, high = around.outer
    try:
        (there,) = enclosures(tape([e], around.symbols), low[:, None], high[:, None])
    except NoTape:
        return -math.inf, math.inf
    return float(there.value[0][0]), float(there.value[1][0])


def _sure(number: float) -> float:
    return math.inf if math.isnan(number) else number


# --- one look

Interval: TypeAlias = tuple[End, End]


def enclose(expression: sp.Expr, box: Box) -> Interval:
    """An interval that holds the values of the expression on the box, where it and its parts are real; it is exact for
    a rational number and for a symbol. A function without a rule may have any value."""
    fixed, around = sides(exact(expression), box)
    if fixed.is_Rational:
        value = Fraction(fixed)
        return value, value
    if fixed in around.symbols:
        return around.ends[around.symbols.index(fixed)]
    if fixed.has(*STRANGE):
        return EVERYTHING
    return _range(rounded(fixed, around), around)


def contains_zero(interval: Interval) -> bool:
    """Whether zero lies in the closed interval."""
    return interval[0] <= 0 <= interval[1]


def finite(interval: Interval) -> bool:
    """Whether both ends are finite."""
    return abs(interval[0]) != math.inf and abs(interval[1]) != math.inf


# --- rational ends

_BITS = 512  # of an end, of the ends of functions
_PRECISIONS = (128, 512, 2048)  # of a number, until its sign is known
_STEEPEST = 10**6  # beyond it exp is left alone: its ends would have too many digits
_POWER = 64  # exponents beyond which ends are left to floats
_RISING: dict[type, Callable[[Any], Any]] = {
    sp.exp: arb.exp,
    sp.sinh: arb.sinh,
    sp.tanh: arb.tanh,
    sp.atan: arb.atan,
    sp.asinh: arb.asinh,
}
_BOUNDS: dict[type, Interval] = {
    sp.exp: (Fraction(0), math.inf),
    sp.tanh: (Fraction(-1), Fraction(1)),
    sp.atan: (Fraction(-2), Fraction(2)),
}


def rational(expression: sp.Expr, box: Box) -> Interval:
    """An interval that holds the values of the expression on the box, where it and its parts are real; as written and,
    of a polynomial, in factors."""
    e = exact(expression)
    low, high = _ends(e, box)
    if low < 0 < high and isinstance(e, sp.Add) and e.is_polynomial(*e.free_symbols):
        other = _ends(sp.factor(e), box)
        return max(low, other[0]), min(high, other[1])
    return low, high


def _ends(e: sp.Expr, box: Box) -> Interval:
    if e.is_Rational:
        return Fraction(e), Fraction(e)
    if e.is_Symbol:
        return box.get(e, EVERYTHING)
    if e.is_number:
        return _number(e)
    if e.is_Add:
        return reduce(_sum, (_ends(part, box) for part in e.args))
    if e.is_Mul:
        return reduce(multiplied, (_ends(part, box) for part in e.args))
    if e.is_Pow and e.exp.is_Integer and abs(e.exp) <= _POWER:
        return _short(raised(_ends(e.base, box), int(e.exp)))
    if isinstance(e, sp.Abs) or (isinstance(e, Norm) and len(e.args) == 1):
        return _absolute(_ends(e.args[0], box))
    if type(e) in _RISING:
        low, high = _ends(e.args[0], box)
        least, most = _BOUNDS.get(type(e), EVERYTHING)
        return max(least, _applied(_RISING[type(e)], low)[0]), min(most, _applied(_RISING[type(e)], high)[1])
    if isinstance(e, sp.cosh):
        low, high = _absolute(_ends(e.args[0], box))
        return max(Fraction(1), _applied(arb.cosh, low)[0]), _applied(arb.cosh, high)[1]
    low, high = fractions(enclose(e, box))
    return (max(low, Fraction(0)), high) if e.is_Pow and e.exp.is_Rational and e.exp.q % 2 == 0 else (low, high)


def _number(e: sp.Expr) -> Interval:
    try:
        program = tape([e], ())
    except NoTape:
        return EVERYTHING
    enclosure: Interval = EVERYTHING
    for bits in _PRECISIONS:
        (ball,) = values(program, (), bits)
        if ball.is_finite():
            enclosure = of_ball(ball)
            if not ball.contains(0):
                break
    return enclosure


def _applied(function: Callable[[Any], Any], end: End) -> Interval:
    """A function's value at an end; the whole line where that has too many digits."""
    if not -_STEEPEST <= end <= _STEEPEST:
        return EVERYTHING
    with ctx.workprec(_BITS):
        ball = function(arb(number(Fraction(end))))
        return of_ball(ball) if ball.is_finite() else EVERYTHING


def _absolute(a: Interval) -> Interval:
    low, high = a
    return max(low, -high, Fraction(0)), max(-low, high)


def _sum(a: Interval, b: Interval) -> Interval:
    (low, high), (first, last) = a, b
    return _short(
        (-math.inf if -math.inf in (low, first) else low + first, math.inf if math.inf in (high, last) else high + last)
    )


def fractions(a: Interval) -> Interval:
    """The ends of an interval, the finite ones as fractions."""
    low, high = (end if end in (-math.inf, math.inf) else Fraction(end) for end in a)
    return low, high


def multiplied(a: Interval, b: Interval) -> Interval:
    """a b; an infinite end is a bound and no value, so 0 times it is 0."""
    ends = [_times(x, y) for x in a for y in b]
    return _short((min(ends), max(ends)))


def _times(x: End, y: End) -> End:
    if math.inf in (abs(x), abs(y)):
        return Fraction(0) if x == 0 or y == 0 else math.inf if (x > 0) == (y > 0) else -math.inf
    return x * y


def raised(a: Interval, n: int) -> Interval:
    """a^n for whole n; for n < 0 where a is not 0. The whole line for a power with too many digits."""
    if abs(n) > STEEP:
        return EVERYTHING
    if n < 0:
        low, high = _short(raised(a, -n))
        if low == 0 < high:
            return _over(high), math.inf
        if low < 0 == high:
            return -math.inf, _over(low)
        return EVERYTHING if low <= 0 <= high else (_over(high), _over(low))
    low, high = a if n % 2 else _absolute(a)
    return low**n, high**n


def _over(end: End) -> End:
    return Fraction(0) if abs(end) == math.inf else 1 / Fraction(end)


def _short(a: Interval) -> Interval:
    return _rounded(a[0], -1), _rounded(a[1], 1)


def _rounded(end: End, way: int) -> End:
    """The end in at most `_BITS` bits, outward."""
    if isinstance(end, float) or max(end.numerator.bit_length(), end.denominator.bit_length()) <= 2 * _BITS:
        return end
    shift = _BITS - end.numerator.bit_length() + end.denominator.bit_length()
    scaled = end * (Fraction(2) ** shift)
    return Fraction(math.ceil(scaled) if way > 0 else math.floor(scaled)) / (Fraction(2) ** shift)


# --- the cells that a program may take

_LARGE = 2.0**-6  # of a table: what is rounded by more keeps within nothing


def taken(expression: sp.Expr, around: Sides) -> sp.Expr:
    """The expression on a box with tables that know their ends there, and how far their arguments may be rounded."""
    return rounded(ended(expression, around.box), around)


def ended(expression: sp.Expr, box: Box) -> sp.Expr:
    """The expression on a box with tables that know their ends there."""
    return replaced(expression, lambda node: between(node, node.args, box))


def beyond(expression: sp.Expr, around: Sides) -> tuple[Fraction, str] | None:
    """A breakpoint on which the box ends, and its table, of which a program takes a derivative beyond; None without."""
    box = around.box
    for node in sorted(expression.atoms(Stepped), key=str):
        axes, jumps = rounded(ended(node, box), around).cells.axes, node.cells.smooth
        for axis, argument, first, order in zip(axes, node.args, jumps, node.order, strict=True):
            side = rational(argument, box)
            (a, b), (c, d) = axis.met(*side), axis.taken(*side)[1]
            at = next((k for k in (*range(c, a), *range(b, d)) if first[k] <= order), None)
            if at is not None:
                return axis.x[at], node.cells.name
    return None


def between(node: Table, arguments: Sequence[sp.Expr], box: Box, *, program: bool = False) -> Cells:
    """The table without its ends along the axes where its argument keeps within its points."""
    pairs = zip(node.cells.axes, arguments, strict=True)
    return node.cells.holding(*(axis.held and not _inside(axis, argument, box, program) for axis, argument in pairs))


def _inside(axis: Axis, argument: sp.Expr, box: Box, program: bool) -> bool:
    (low, high), first, last = rational(argument, box), axis.x[0], axis.x[-1]
    within = first <= low and high <= last
    if program and not within and low < last and high > first:
        error = rounding(argument, box)
        within = first - error <= low and high <= last + error and error < (last - first) * _LARGE
    return within and is_defined(argument, box)
