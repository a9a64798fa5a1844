"""Rigorous range of an expression on a closed box, and its sign there.

A single evaluation gives a range without bisection, in outward-rounded intervals or with rational ends. Rational ends
do not overflow or underflow. Sums, products and powers of exact ends are exact up to `_BITS` bits and are rounded
outward beyond; Arb gives exp and similar functions at the ends. Natural interval extension: R. E. Moore, R. B.
Kearfott, M. J. Cloud, "Introduction to interval analysis", SIAM 2009, chapter 5.

A table in a program may read another cell than in exact arithmetic, since its argument is rounded: v + 273.15 may be
rounded to a breakpoint that it does not reach, and the error of 1000 v - 1099 is far more than the rounding of its
value. Proofs therefore consider all cells within a running error bound in single precision: an operation multiplies the
errors of its operands by its partial derivatives and adds the share `UNIT` of its result (N. J. Higham, "Accuracy and
stability of numerical algorithms", 2nd edition, SIAM 2002, section 3.3).

Beyond its breakpoints a table is clamped and its slope is 0. Where the argument stays between them on the box, the
argument of a program leaves them by rounding alone. There the program's derivatives continue those of the last cell
(`rigor.lookup`), and proofs need no slope beyond. `clamped_cells` decides this for both. A program's derivatives also
continue where the box is larger by no more than the rounding of the argument, as for z = 0.3 x with ends rounded
outward; there proofs consider both slopes.

Proofs use outward-rounded intervals and bisection (`rigor.search`), rational ends where floats are too coarse, or the
factors found by exact algebra. Refutations are a point, or two points of opposite sign. Limits count boxes. Numbers are
exact: a float is its shortest decimal.

A witness, at which an expression vanishes or is not a finite real number, is exact. Candidates are corners, middles,
small rationals and the rational roots of polynomials; enclosures select possible zeros, exact arithmetic decides.

The generalised derivative at a kink is a set, and a set that contains 0 has no sign: an upper semicontinuous map with
convex values takes connected boxes to connected sets (J.-P. Aubin, A. Cellina, "Differential inclusions", 1984, ch. 1).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from fractions import Fraction
from functools import lru_cache, reduce
from itertools import islice, product
from typing import Annotated, Any, TypeAlias

import numpy as np
import sympy as sp
from flint import arb, ctx

from hgogen.check import Verdict
from hgogen.rigor import outward
from hgogen.rigor.box import (
    EVERYTHING,
    STEEP,
    STRANGE,
    Box,
    End,
    Point,
    Sides,
    exact,
    largest_exponent,
    sides,
    sign_at,
    substituted,
)
from hgogen.rigor.definite import number
from hgogen.rigor.enclosure import enclose as enclosures
from hgogen.rigor.factors import factors
from hgogen.rigor.lookup import Axis, Cells, Ends, Stepped, Table, replaced
from hgogen.rigor.outward import Array, Pair
from hgogen.rigor.search import AttainedValues, Bisection, Goal, Tree, is_defined, one_sign, regular, search, tight
from hgogen.rigor.series import ends as of_ball
from hgogen.rigor.series import values
from hgogen.rigor.tape import Norm, NoTape, Tape, jump, tape
from hgogen.sentence import NONE, Encoded, Reason, because, down, equations, up

# --- rounding errors of the arguments of tables

UNIT = 2.0**-21  # 8 times the unit roundoff of single precision
_TINY = 2.0**-120  # allowance for underflow


def rounded(expression: sp.Expr, around: Sides) -> sp.Expr:
    """Return the expression with each table lookup widened by a bound of the rounding error of its argument: a program
    that computes in single precision on the box `around` may read a neighbouring cell."""

    def shares(axis: Axis, argument: sp.Expr) -> Ends:
        # a signal by itself and the breakpoints are rounded alike: it can pass only a breakpoint that is the same
        # number in single precision as the end of its range
        error = _error(argument, around)
        most = Fraction(error) if math.isfinite(error) else math.inf
        if not argument.is_Symbol:
            return most, most
        high = around.ends[around.symbols.index(argument)][1]
        return Fraction(0), most if any(high < x <= high + most for x in axis.x) else Fraction(0)

    return replaced(expression, lambda node: node.cells.rounding(*map(shares, node.cells.axes, node.args)))


@lru_cache(maxsize=4096)
def _error(e: sp.Expr, around: Sides) -> float:
    """Return a bound of |computed - exact| for a program that computes the expression e on the box `around`; infinite
    where none is known."""
    if not e.args:
        return UNIT * _largest_size(e, around) + _TINY
    if isinstance(e, sp.Piecewise):  # one branch or another
        branches = [part for part, _ in e.args]
        ranges = [_range(part, around) for part in branches]
        width = max(high for _, high in ranges) - min(low for low, _ in ranges)
        return _inf_if_nan(width + max(_error(part, around) for part in branches))
    if not all(isinstance(part, sp.Expr) for part in e.args):
        return math.inf
    errors = [_error(part, around) for part in e.args]
    if isinstance(e, (sp.Add, sp.Mul)):
        sizes = [_largest_size(part, around) for part in e.args]
        whole = [size + error for size, error in zip(sizes, errors, strict=True)]
        inherited = sum(errors) if isinstance(e, sp.Add) else math.prod(whole) - math.prod(sizes)
        total = sum(whole) if isinstance(e, sp.Add) else math.prod(whole)
        return _inf_if_nan(inherited + len(whole) * UNIT * total + _TINY)
    return _function_error(e, errors, around)


def _function_error(e: sp.Expr, errors: Sequence[float], around: Sides) -> float:
    """Return a bound of the rounding error of a function value e = f(a_1, ..), from the `errors` of the arguments a_i:
    the smaller one of sum |df/da_i| errors_i and the width of the range of f, plus the rounding of the result."""
    varying = [(part, error) for part, error in zip(e.args, errors, strict=True) if part.free_symbols]
    dummies = {part: sp.Dummy(real=True) for part, _ in varying}
    ends = [(low - error, high + error) for (low, high), error in ((_range(part, around), d) for part, d in varying)]
    low, high = np.array(ends).reshape(len(varying), 2).T[:, :, None]
    try:
        program = tape([e.func(*(dummies.get(part, part) for part in e.args))], dummies.values())
    except NoTape:
        return math.inf
    (there,) = enclosures(program, low, high, slopes=True)
    least, most = float(there.value[0][0]), float(there.value[1][0])
    steep = np.maximum(np.abs(there.slope[0]), np.abs(there.slope[1]))[:, 0].tolist()
    inherited = sum(slope * error for slope, (_, error) in zip(steep, varying, strict=True))
    return min(_inf_if_nan(inherited), _inf_if_nan(most - least)) + UNIT * max(abs(least), abs(most)) + _TINY


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


def _inf_if_nan(number: float) -> float:
    return math.inf if math.isnan(number) else number


# --- ranges by a single evaluation

Interval: TypeAlias = tuple[End, End]


def enclose(expression: sp.Expr, box: Box) -> Interval:
    """Return an interval that encloses the expression on the box, where it and its parts are real: exact for a rational
    number and for a symbol, the real line for a function without a rule."""
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
    """Return whether zero lies in the closed interval (low, high)."""
    return interval[0] <= 0 <= interval[1]


def finite(interval: Interval) -> bool:
    """Return whether both ends of an interval are finite."""
    return abs(interval[0]) != math.inf and abs(interval[1]) != math.inf


# --- rational ends

_BITS = 512  # bits of a rational end, and of the value of a function
_PRECISIONS = (128, 512, 2048)  # bits tried in turn for a number, until its sign is known
_STEEPEST = 10**6  # largest argument of exp that is evaluated: more ends would have too many digits
_POWER = 64  # exponents beyond which ends are computed in floats
_RISING: dict[type, tuple[Callable[[Any], Any], End, End]] = {  # increasing functions, with bounds of all their values
    sp.exp: (arb.exp, Fraction(0), math.inf),
    sp.sinh: (arb.sinh, *EVERYTHING),
    sp.tanh: (arb.tanh, Fraction(-1), Fraction(1)),
    sp.atan: (arb.atan, Fraction(-2), Fraction(2)),
    sp.asinh: (arb.asinh, *EVERYTHING),
}


def rational(expression: sp.Expr, box: Box) -> Interval:
    """Return an interval with rational ends that encloses the expression on the box. A polynomial is also evaluated in
    factored form, and the tighter ends are taken."""
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
        return _number_ends(e)
    if e.is_Add:
        return reduce(_sum, (_ends(part, box) for part in e.args))
    if e.is_Mul:
        return reduce(multiplied, (_ends(part, box) for part in e.args))
    if e.is_Pow and e.exp.is_Integer and abs(e.exp) <= _POWER:
        return _rounded_outward(raised(_ends(e.base, box), int(e.exp)))
    if isinstance(e, sp.Abs) or (isinstance(e, Norm) and len(e.args) == 1):
        return _absolute(_ends(e.args[0], box))
    if type(e) in _RISING:
        low, high = _ends(e.args[0], box)
        function, least, most = _RISING[type(e)]
        return max(least, _applied(function, low)[0]), min(most, _applied(function, high)[1])
    if isinstance(e, sp.cosh):
        low, high = _absolute(_ends(e.args[0], box))
        return max(Fraction(1), _applied(arb.cosh, low)[0]), _applied(arb.cosh, high)[1]
    low, high = fractions(enclose(e, box))
    return (max(low, Fraction(0)), high) if e.is_Pow and e.exp.is_Rational and e.exp.q % 2 == 0 else (low, high)


def _number_ends(e: sp.Expr) -> Interval:
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
    return _rounded_outward(
        (-math.inf if -math.inf in (low, first) else low + first, math.inf if math.inf in (high, last) else high + last)
    )


def fractions(a: Interval) -> Interval:
    """Return an interval with its finite ends as fractions."""
    low, high = (end if end in (-math.inf, math.inf) else Fraction(end) for end in a)
    return low, high


def multiplied(a: Interval, b: Interval) -> Interval:
    """Return the product a b of intervals; an infinite end is a bound and no value, so 0 times it is 0."""

    def times(x: End, y: End) -> End:
        if math.inf in (abs(x), abs(y)):
            return Fraction(0) if x == 0 or y == 0 else math.inf if (x > 0) == (y > 0) else -math.inf
        return x * y

    ends = [times(x, y) for x in a for y in b]
    return _rounded_outward((min(ends), max(ends)))


def raised(a: Interval, n: int) -> Interval:
    """Return the interval a^n for an integer n, for n < 0 without the point 0; the real line if |n| > `STEEP`, as the
    power would have too many digits."""
    if abs(n) > STEEP:
        return EVERYTHING
    if n < 0:
        low, high = _rounded_outward(raised(a, -n))
        if low == 0 < high:
            return _over(high), math.inf
        if low < 0 == high:
            return -math.inf, _over(low)
        return EVERYTHING if low <= 0 <= high else (_over(high), _over(low))
    low, high = a if n % 2 else _absolute(a)
    return low**n, high**n


def _over(end: End) -> End:
    return Fraction(0) if abs(end) == math.inf else 1 / Fraction(end)


def _rounded_outward(a: Interval) -> Interval:
    def rounded(end: End, whole: Callable[[Fraction], int]) -> End:
        if isinstance(end, float) or max(end.numerator.bit_length(), end.denominator.bit_length()) <= 2 * _BITS:
            return end
        unit = Fraction(2) ** (_BITS - end.numerator.bit_length() + end.denominator.bit_length())
        return Fraction(whole(end * unit)) / unit

    return rounded(a[0], math.floor), rounded(a[1], math.ceil)


# --- the cells of tables that a program may read

_LARGE_ROUNDING = 2.0**-6  # share of a table's width beyond which a rounding error counts as leaving the table


def as_programmed(expression: sp.Expr, around: Sides) -> sp.Expr:
    """Return the expression as a program evaluates it on the box `around`: tables are constant beyond their breakpoints
    where their arguments may leave these, and may read a neighbouring cell because arguments are rounded."""
    return rounded(clamped(expression, around.box), around)


def clamped(expression: sp.Expr, box: Box) -> sp.Expr:
    """Return the expression with each table held constant beyond its breakpoints, along those axes where the argument
    may leave the breakpoints on the box."""
    return replaced(expression, lambda node: clamped_cells(node, node.args, box))


def _breakpoint_at_end(expression: sp.Expr, around: Sides) -> tuple[Fraction, str] | None:
    """Return a breakpoint at an end of the range of a table's argument, and the name of the table; None if there is
    none. By rounding a program may read the other cell at this breakpoint, where the table or its derivative jumps."""
    box = around.box
    for node in sorted(expression.atoms(Stepped), key=str):
        axes, jumps = rounded(clamped(node, box), around).cells.axes, node.cells.smooth
        for axis, argument, first, order in zip(axes, node.args, jumps, node.order, strict=True):
            side = rational(argument, box)
            (a, b), (c, d) = axis.overlapped(*side), axis.readable(*side)[1]
            at = next((k for k in (*range(c, a), *range(b, d)) if first[k] <= order), None)
            if at is not None:
                return axis.x[at], node.cells.name
    return None


def clamped_cells(node: Table, arguments: Sequence[sp.Expr], box: Box, *, program: bool = False) -> Cells:
    """Return the table of a lookup `node` with clamping removed along each axis whose argument, one of `arguments`,
    stays between the first and the last breakpoint on the box.

    `program`: clamping is also removed where the argument exceeds the breakpoints by at most its rounding error.
    """

    def within(axis: Axis, argument: sp.Expr) -> bool:
        (low, high), first, last = rational(argument, box), axis.x[0], axis.x[-1]
        inside = first <= low and high <= last
        if program and not inside and low < last and high > first:
            error = _error(*sides(exact(argument), box))
            inside = error < (last - first) * _LARGE_ROUNDING
            inside = inside and first - Fraction(error) <= low and high <= last + Fraction(error)
        return inside and is_defined(argument, box)

    pairs = zip(node.cells.axes, arguments, strict=True)
    return node.cells.clamping(*(axis.clamped and not within(axis, argument) for axis, argument in pairs))


# --- zeros

_CANDIDATES, _EXACT = 800, 16  # most points tested by enclosures, by exact arithmetic
_DENOMINATORS, _FEW_DIGITS = 12, (1, 2, 6, 12, 100, 1000)
_STEPS = 1100  # of a bisection: from the largest float down to the smallest


def special_point(
    expression: sp.Expr,
    program: Tape,
    sides: Sides,
    kinds: tuple[str, ...] = ("= 0", "undefined"),
    hints: Iterable[Point] = (),
) -> tuple[str, Point] | None:
    """Return a point of the box `sides` where the expression is 0 or undefined, as the pair ("= 0" or "undefined",
    point); None if no candidate point is one. `kinds`: the kinds that count; `program`: the expression as a tape;
    `hints`: points near which points with short rational coordinates are tried first."""
    if largest_exponent(expression) > STEEP:
        return None
    simple = ({s: x.limit_denominator(q) for s, x in point.items()} for point in hints for q in _FEW_DIGITS)
    candidates = [*filter(sides.contains, simple), *islice(_candidates(expression, sides), _CANDIDATES)]
    if not candidates:
        return None
    low, high = _around(candidates, sides)
    first = enclosures(program, low, high)[0]
    doubtful = ~first.defined
    if "= 0" in kinds:
        doubtful = doubtful | ((first.value[0] <= 0) & (first.value[1] >= 0))
    for index in np.nonzero(doubtful)[0][:_EXACT]:
        point = candidates[int(index)]
        value = sign_at(expression, _rational(point))
        if value in kinds:
            return value, point
    return None


def crossing(expression: sp.Expr, program: Tape, sides: Sides, below: Point, above: Point) -> Point:
    """Return a point where a continuous expression changes its sign, by bisection of the line from the point `below`,
    where it is negative, to `above`, where it is positive: an exact zero, a kink with a jump of sign, or a point next
    to one of these."""
    for _ in range(_STEPS):
        centre = {s: Fraction(outward.number((below[s] + above[s]) / 2)[0]) for s in sides.symbols}
        if centre in (below, above) or not sides.contains(centre):
            break
        value = enclosures(program, *_around([centre], sides))[0].value
        if value[0][0] > 0:
            above = centre
        elif value[1][0] < 0:
            below = centre
        else:
            break
    if largest_exponent(expression) > STEEP:
        return below
    simplest = {s: ((below[s] + above[s]) / 2).limit_denominator(10_000) for s in below}
    for point in filter(sides.contains, (simplest, centre)):
        at = _rational(point)
        if sign_at(expression, at) == "= 0" or jump(expression, at) is not None:
            return point
    return below


def _rational(point: Mapping[sp.Symbol, Fraction]) -> dict[sp.Symbol, sp.Rational]:
    return {s: sp.Rational(value) for s, value in point.items()}


def _around(points: list[Point], sides: Sides) -> Pair:
    ends = [[outward.number(point[s]) for point in points] for s in sides.symbols]
    table: Array = np.array(ends, dtype=float).reshape(len(sides.symbols), len(points), 2)
    return table[:, :, 0], table[:, :, 1]


def _candidates(expression: sp.Expr, sides: Sides) -> Iterator[Point]:
    values = [_simple_values(*ends) for ends in sides.ends]
    if len(values) != 1:
        few = values if len(values) < 5 else [side[:3] for side in values]
        yield from _solved(expression, sides, values)
        yield from _points(sides, few)
        return
    ((first, last),) = sides.ends
    low, high = (max(-20, min(20, end)) for end in (first, last))
    numerators = ((q, range(math.ceil(low * q), math.floor(high * q) + 1)) for q in range(1, _DENOMINATORS + 1))
    fractions = [Fraction(p, q) for q, each in numerators for p in each if first <= Fraction(p, q) <= last]
    yield from _points(sides, [[*_roots(expression, sides), *values[0], *fractions]])


def _points(sides: Sides, values: list[list[Fraction]]) -> Iterator[Point]:
    for coordinates in product(*values):
        yield dict(zip(sides.symbols, coordinates, strict=True))


def _simple_values(low: End, high: End) -> list[Fraction]:
    finite = [Fraction(end) for end in (low, high) if abs(end) != math.inf]
    middle = sum(finite, Fraction(0)) / 2 if len(finite) == 2 else Fraction(0)
    wanted = (*finite, Fraction(0), middle, Fraction(1), Fraction(-1))
    return list(dict.fromkeys(value for value in wanted if low <= value <= high)) or [Fraction(1)]


def _roots(expression: sp.Expr, sides: Sides) -> Iterable[Fraction]:
    (symbol,), ((low, high),) = sides.symbols, sides.ends
    if not expression.is_polynomial(symbol):
        return []
    try:
        roots = sp.Poly(expression, symbol).ground_roots()
    except sp.PolynomialError:
        return []
    exact = sorted(Fraction(root) for root in roots if root.is_Rational)  # x - pi has the root pi
    return [root for root in exact if low <= root <= high]


def _solved(expression: sp.Expr, sides: Sides, values: list[list[Fraction]]) -> Iterator[Point]:
    for k, symbol in enumerate(sides.symbols):
        slope = expression.diff(symbol)
        constant = None if slope == 0 or slope.has(symbol) else substituted(expression, {symbol: sp.S.Zero})
        if constant is None:
            continue
        others = [side if i != k else [Fraction(0)] for i, side in enumerate(values)]
        for point in islice(_points(sides, others), 8):
            at = _rational(point)
            steep, start = substituted(slope, at), substituted(constant, at)
            if not (steep and start is not None and steep.is_Rational and start.is_Rational):
                continue
            solution = point | {symbol: Fraction(-start / steep)}
            if sides.contains(solution):
                yield solution


# --- equivalent forms of an expression

_LARGE = 400  # operations beyond which rewriting would cost more than bisection
_DENSE = 20  # symbols beyond which it takes seconds, since SymPy's polynomials are dense
_REWRITTEN = 12  # exponents beyond which it would grow out of hand


def becomes_high_power(e: sp.exp) -> bool:
    """Return whether e is an exponential that SymPy would rewrite as a high power: exp(-8750/T) as exp(1/T)^-8750."""
    return any(abs(int(term.as_coeff_Mul(rational=True)[0].p)) > _REWRITTEN for term in sp.Add.make_args(e.args[0]))


def variants(expression: sp.Expr) -> tuple[sp.Expr, ...]:
    """Return equal forms of an expression: as written and, where it is rational in its symbols, factored and in Horner
    form. They have equal values wherever the first form is defined; the other forms may lack a removable pole."""
    symbols = sorted(expression.free_symbols, key=str)
    if not 0 < len(symbols) <= _DENSE or expression.count_ops() > _LARGE or largest_exponent(expression) > _REWRITTEN:
        return (expression,)
    if expression.has(sp.Piecewise, sp.floor, sp.ceiling):
        return (expression,)
    forms = [expression]
    try:
        dummies = {e: sp.Dummy() for e in sorted(expression.atoms(sp.exp), key=str) if becomes_high_power(e)}
        forms.append(sp.factor(expression.xreplace(dummies)).xreplace({d: e for e, d in dummies.items()}))
        if expression.is_polynomial(*symbols):
            whole = sp.expand(expression)
            forms += [whole, *(sp.horner(whole, wrt=wrt) for wrt in (symbols, symbols[::-1]))]
    except (sp.PolynomialError, NotImplementedError):
        pass
    return tuple(dict.fromkeys(form for form in forms if not form.has(*STRANGE)))


# --- proofs

_SLACK = Fraction(1, 2**40)  # relative, so that another arithmetic, or other roundings of a cut, can prove the bounds


@dataclass(frozen=True)
class Proof:
    """A proved bound on a closed box, with the data by which other code can verify it: low <= value <= high of a single
    expression or, with `low` None, a bound `high` of the spectral norm of the Jacobian of the `expressions`.

    Bounds are exact, None where there is none. `tree`: the bisection of the box, nested ("split", index, left, right)
    and "leaf", each side cut in its middle; `variables`: the symbols that the indices count.
    """

    expressions: tuple[sp.Expr, ...]
    low: Fraction | None
    high: Fraction | None
    variables: tuple[sp.Symbol, ...]
    tree: Any = field(hash=False, repr=False)


def ends(low: Fraction | float, high: Fraction | float) -> tuple[Fraction | None, Fraction | None]:
    """Return the bounds low and high as fractions, moved outward by 2^-40 of their size, so that other code with other
    roundings can prove them; the signs stay. None for an infinite bound."""
    below, above = (
        None if abs(end) == math.inf else Fraction(end) + way * abs(Fraction(end)) * _SLACK
        for end, way in ((low, -1), (high, 1))
    )
    return below, above


# --- ranges

LIMIT = 20_000
_FIRST = 500  # boxes before the search for a pole


@dataclass(frozen=True)
class Attained:
    """A point of the box at which an expression attains a small or a large value. `value`: an upper bound of a small
    value, a lower bound of a large one."""

    value: float
    point: Mapping[sp.Symbol, Fraction] = field(hash=False)


@dataclass(frozen=True)
class Range(Encoded):
    """The range of an expression on a box: low <= value <= high wherever the expression and its subexpressions are
    finite and real; -inf and inf where nothing is proved.

    `least`, `most`: points at which the expression is nearly smallest and largest, None if unknown. `tree`: the
    bisection of the box, nested ("split", index, left, right) and "leaf", sides cut at `search.middle`; `variables`:
    the symbols that the indices count.
    """

    json_keys = "low high defined boxes note"

    low: Annotated[float, "lower bound; null where there is none"]
    high: Annotated[float, "upper bound; null where there is none"]
    defined: Annotated[bool, "whether it is proved finite and real on the whole closed box"]
    least: Attained | None
    most: Attained | None
    boxes: Annotated[int, "number of boxes that were tried"]
    note: Annotated[Reason, "why the range is not tighter, or empty"]
    variables: tuple[sp.Symbol, ...]
    tree: Tree = field(repr=False)

    @property
    def finite(self) -> bool:
        """Return whether both ends of the range are finite."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def __str__(self) -> str:
        parts = [f"from {down(self.low, 9)} to {up(self.high, 9)}, by {counted(self.boxes)}"]
        ends = (("least", "at most", up, self.least), ("most", "at least", down, self.most))
        parts += [
            f"the {end} is {side} {rounded(one.value, 9)}{place(one.point)}"
            for end, side, rounded, one in ends
            if one is not None
        ]
        return "; ".join([*parts, *map(str, filter(None, [self.note]))])


def bound(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, relative: float = 0.02) -> Range:
    """Return the range of the expression on the box, rounded outward. It is at most `relative` of its width too wide,
    else its `note` gives the reason. `boxes`: the largest number of boxes of the bisection.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _bound(sp.sympify(expression), tuple((x, tuple(ends)) for x, ends in box.items()), boxes, relative)


@lru_cache(maxsize=512)  # an observer and its hypotheses need the same ranges, as of the a_i
def _bound(expression: sp.Expr, ends: tuple[Any, ...], boxes: int, relative: float) -> Range:
    problem = problem_of(expression, dict(ends))
    if problem is None:
        return NOWHERE
    first = min(boxes, _FIRST)
    outcome = problem.search(tight(relative), first)
    if outcome.finished:
        return range_of(problem, outcome, relative)
    if not outcome.defined:
        special = special_point(problem.expression, problem.program, problem.sides, ("undefined",))
        if special:  # more boxes would not help
            note = because("it is not a finite real number at {point}", point=equations(special[1]))
            return replace(range_of(problem, outcome, relative), note=note)
    if first < boxes:
        outcome = problem.search(tight(relative), boxes, outcome.before)
    return range_of(problem, outcome, relative)


NOWHERE = Range(-math.inf, math.inf, False, None, None, 0, because("it is not a finite real number"), (), "leaf")


@dataclass(frozen=True)
class Problem:
    """An expression with exact numbers on a box `sides`. `program`: the tape that computes the equal forms of the
    expression."""

    expression: sp.Expr
    sides: Sides
    program: Tape

    def search(self, goal: Goal, boxes: int, begun: Bisection | None = None) -> Bisection:
        """Return a bisection of the box until the `goal` is reached or there are so many `boxes`; `begun`: an earlier
        bisection to continue."""
        return search(self.program, self.sides, goal, boxes, begun)


def problem_of(expression: sp.Expr, box: Box) -> Problem | None:
    """Return the expression on the box as a `Problem`; None for an expression that is finite and real nowhere."""
    fixed, around = sides(exact(sp.sympify(expression)), box)
    if fixed.has(*STRANGE):
        return None
    fixed = as_programmed(fixed, around)
    return Problem(fixed, around, tape(variants(fixed), around.symbols))


def range_of(problem: Problem, outcome: Bisection, relative: float) -> Range:
    """Return the `Range` that the bisection `outcome` of the problem's box proves. `relative`: the tolerance of the
    search, quoted in the note."""
    boxes = counted(outcome.boxes)
    note = because("it was not shown to be finite and real everywhere, with {boxes}", boxes=boxes)
    if outcome.defined:
        far = because(
            "it is not within {relative:.0%} of values that are attained, with {boxes}", relative=relative, boxes=boxes
        )
        note = NONE if outcome.finished else far
    ends, extremes = (outcome.low, outcome.high), attained(problem, outcome.inner)
    return Range(*ends, outcome.defined, *extremes, outcome.boxes, note, problem.sides.symbols, outcome.tree)


def attained(problem: Problem, inner: AttainedValues) -> tuple[Attained | None, Attained | None]:
    """Return the smallest and the largest value that a search evaluated, as `Attained`. None where no point was
    evaluated, or where a derivative of a table jumps at the point: its value may be that of a side outside the box."""

    def at(value: float, place: Array | None) -> Attained | None:
        if not problem.sides.symbols and math.isfinite(value):
            return Attained(value, {})
        if place is None:
            return None
        point = problem.sides.point(place.tolist())
        there = substituted(problem.expression, _rational(point)) if problem.expression.has(Stepped) else sp.S.Zero
        return None if there is None or there.has(Stepped) else Attained(value, point)

    return at(inner.least, inner.at_least), at(inner.most, inner.at_most)


def counted(count: int) -> Reason:
    """Return a number of boxes in words, "1 box" or "5 boxes"."""
    return because("{count} box" if count == 1 else "{count} boxes", count=count)


def place(point: Mapping[sp.Symbol, Fraction]) -> str:
    """Return a point as the end of a sentence: ", at x = 0.5, y = 2", or "" for a point without coordinates."""
    return ", at " + ", ".join(f"{s} = {float(value):g}" for s, value in point.items()) if point else ""


# --- signs

_GLANCE = 60  # boxes before the search for a zero


class Cause(Enum):
    """The reason why an expression does not have one sign on a box, at the witness of the refutation or next to it."""

    ZERO = "vanishes"
    UNDEFINED = "is not a finite real number"
    CROSSING = "changes sign"  # next to the witness
    JUMP = "jumps from one sign to the other"  # at a kink, where it is a set
    PART = "vanishes with a factor, or is not finite there"


@dataclass(frozen=True)
class Sign:
    """The verdict on whether an expression has one sign on a box.

    PROVED: `sign` is 1 or -1, and 0 < `margin` <= |value| < inf on the box. REFUTED: `witness` is a point where the
    expression is zero or undefined, next to a zero between two points of opposite sign, or at a kink where its sign
    jumps; `cause` says which. UNKNOWN: `reason` gives the number of boxes.

    `never`: whether it is proved that the expression has no zero on the box, although it may be undefined, or tend to 0
    on an unbounded box. `exact`: the rational bounds that prove the sign without bisection, else None.
    """

    verdict: Verdict
    sign: int
    margin: End
    witness: Mapping[sp.Symbol, Fraction] = field(hash=False)
    reason: Reason
    range: Range
    cause: Cause | None = None
    never: bool = False
    exact: Interval | None = field(default=None, hash=False)

    def __str__(self) -> str:
        if self.verdict is Verdict.PROVED:
            margin = f"at least {down(self.margin, 9)}" if self.sign > 0 else f"at most -{down(self.margin, 9)}"
            return f"{self.verdict}: {margin}, by {self.reason}"
        return f"{self.verdict}: {self.reason}{place(self.witness)}"


def nonzero(expression: sp.Expr, box: Box, *, boxes: int = LIMIT, refute: bool = True) -> Sign:
    """Return the verdict on whether the expression is finite and has one sign on the whole box. `boxes`: the largest
    number of boxes of the bisection; `refute`: whether to search for counterexamples, which may take long.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _nonzero(expression, tuple(box.items()), boxes, refute)


@lru_cache(maxsize=512)  # several forms, and several hypotheses of one, need the sign of the same gain
def _nonzero(
    expression: sp.Expr, ends: tuple[tuple[sp.Symbol, tuple[End, End]], ...], boxes: int, refute: bool
) -> Sign:
    problem = problem_of(expression, dict(ends))
    if problem is None:
        return Sign(Verdict.REFUTED, 0, 0.0, {}, NOWHERE.note, NOWHERE, Cause.UNDEFINED)
    never, cover = False, None
    for limit in dict.fromkeys((min(boxes, _GLANCE), boxes)):
        outcome = problem.search(one_sign, limit, cover)
        cover = outcome.before
        if outcome.defined and (outcome.low > 0 or outcome.high < 0):
            return _proof(problem, outcome)
        refuted = _refutation(problem, outcome, limit) if refute else None
        if refuted:
            cause, reason, witness = refuted
            return Sign(Verdict.REFUTED, 0, 0.0, witness, reason, range_of(problem, outcome, 0.0), cause)
        if limit <= _GLANCE and not outcome.inner.least < 0 < outcome.inner.most:
            never, low, high = _by_algebra(problem.expression, problem.sides.box)
            if outcome.defined and (low > 0 or high < 0):
                return _proof(problem, outcome, (low, high))
        if outcome.boxes + 2 <= limit:  # more boxes would change nothing
            break
    undecided = "{boxes} does not decide it" if outcome.boxes == 1 else "{boxes} do not decide it"
    reason = because(undecided, boxes=counted(outcome.boxes))
    if end := _breakpoint_at_end(problem.expression, problem.sides):
        pattern = "{why}; the ranges end on {point} of the table {table}, whose slope beyond is taken there: move one"
        reason = because(pattern, why=reason, point=float(end[0]), table=end[1])
    return Sign(Verdict.UNKNOWN, 0, 0.0, {}, reason, range_of(problem, outcome, 0.0), never=never)


def _proof(problem: Problem, cover: Bisection, exact: Interval | None = None) -> Sign:
    (low, high), extent, reason = exact or (cover.low, cover.high), range_of(problem, cover, 0.0), counted(cover.boxes)
    if exact:
        extent = replace(extent, low=outward.number(low)[0], high=outward.number(high)[1], tree="leaf")
        reason = because("exact algebra and rational ends")
    sign = 1 if low > 0 else -1
    return Sign(Verdict.PROVED, sign, max(low, -high), {}, reason, extent, never=True, exact=exact)


def _by_algebra(expression: sp.Expr, box: Box) -> tuple[bool, End, End]:
    low, high = rational(expression, box)
    factored = factors(expression)
    if factored is None or (low > 0 or high < 0):
        return low > 0 or high < 0, low, high
    never, product = True, rational(factored.number, {})
    for one in factored.factors:
        least, most = rational(one.base, box)
        known = one.definite or least > 0 or most < 0
        again = len(factored.factors) == 1 and one.exponent == 1 and one.base.count_ops() >= expression.count_ops()
        other = not again and one.base not in (expression, -expression)  # not the expression itself, rewritten
        if least <= 0 <= most and one.base.free_symbols and other:
            sign = nonzero(one.base, box, boxes=_GLANCE, refute=False)
            known = known or sign.never
            if sign.verdict is Verdict.PROVED:  # the range of the proof is narrower
                ends = sign.exact or fractions((sign.range.low, sign.range.high))
                least, most = max(least, ends[0]), min(most, ends[1])
        never = never and (known or one.exponent < 0)
        product = multiplied(product, raised((least, most), one.exponent))
    return never, max(low, product[0]), min(high, product[1])


def _refutation(problem: Problem, outcome: Bisection, boxes: int) -> tuple[Cause, Reason, Point] | None:
    extremes = [
        problem.sides.point(at.tolist()) for at in (outcome.inner.at_least, outcome.inner.at_most) if at is not None
    ]
    special = special_point(problem.expression, problem.program, problem.sides, hints=extremes)
    if special:
        value, point = special
        cause = Cause.ZERO if value == "= 0" else Cause.UNDEFINED
        return cause, because(cause.value), point
    crossed = _crossed(problem, outcome, boxes)
    if crossed:
        sides = jump(problem.expression, _rational(crossed))
        if sides is None:
            return Cause.CROSSING, because(Cause.CROSSING.value), crossed
        jumps = because("jumps from {one} to {other}, not of one sign", one=sides[0], other=sides[1])
        return Cause.JUMP, jumps, crossed
    for part, pattern in _parts(problem.expression):
        inner = nonzero(part, problem.sides.box, boxes=boxes)
        if inner.verdict is Verdict.REFUTED and inner.cause is not Cause.JUMP:
            box = problem.sides.box.items()
            corner = {s: Fraction(next((end for end in ends if abs(end) != math.inf), 0)) for s, ends in box}
            return Cause.PART, because(pattern, part=part), corner | dict(inner.witness)
    return None


def _crossed(problem: Problem, outcome: Bisection, boxes: int) -> Point | None:
    least, most = attained(problem, outcome.inner)
    if least is None or most is None or not least.value < 0 < most.value:
        return None
    if not outcome.continuous:
        a, b = least.point, most.point
        between = {s: (min(a[s], b[s]), max(a[s], b[s])) for s in problem.sides.symbols}
        part = problem_of(problem.expression, between)
        if part is None or not part.search(regular, boxes).continuous:
            return None
    return crossing(problem.expression, problem.program, problem.sides, dict(least.point), dict(most.point))


def _parts(expression: sp.Expr) -> Iterator[tuple[sp.Expr, str]]:
    powers = [] if expression.has(sp.Piecewise) else sorted(expression.atoms(sp.Pow), key=str)
    for node in powers:  # a Piecewise may not take the branch that is not finite
        if node.exp.is_Rational and node.exp < 0 and node.base != expression and not node.base.is_number:
            yield node.base, "is not finite: it divides by {part}, which vanishes"
    for factor in _irreducible(expression):
        if factor != expression and factor.free_symbols and not factor.is_Symbol:
            yield factor, "vanishes with its factor {part}, or is not finite there"


def _irreducible(expression: sp.Expr) -> list[sp.Expr]:
    """Return the irreducible factors of the expression, by exact algebra alone if it has an exponential that SymPy
    would rewrite as a high power; [] if it cannot be factored."""
    if any(becomes_high_power(e) for e in expression.atoms(sp.exp)):
        product = factors(expression)
        return [one.base for one in product.factors if one.exponent > 0 and not one.definite] if product else []
    try:
        return [factor for factor, _ in sp.factor_list(sp.together(expression))[1]]
    except (sp.PolynomialError, NotImplementedError):
        return []
