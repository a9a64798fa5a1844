"""Enclosures of a tape's values, and of their partial derivatives, on many boxes at once.

Forward differentiation in outward-rounded intervals. A slope encloses the derivative where there is one and Clarke's
gradient at a kink (Abs, Min, Max), so that the mean value theorem holds wherever the value is continuous and the slope
is finite. A function that may jump on a box (sign, floor, Heaviside, Piecewise) is not continuous there and has no
finite slope. A condition is a number, 1 for true and 0 for false.

Arb (python-flint) encloses each value of an elementary function at the ends of an interval in a ball, between the
function's extrema; the ball's ends become floats that are compared with it exactly. The value at an infinite end is the
function's limit. Boxes of a bisection share ends, so the values are cached.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial, reduce
from operator import and_
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq

from hgogen.rigor import outward
from hgogen.rigor.lookup import Cells, Ends, Index, next_order
from hgogen.rigor.outward import Array, Flags, Pair, add, hull, multiply, negate, number, power, reciprocal, scale
from hgogen.rigor.tape import Tape

# --- elementary functions

_PRECISION = 90  # bits, enough for ends within an ulp
_LARGEST = math.nextafter(math.inf, 0.0)
_STEEP = 1e4  # beyond it e^x and e^-x are out of the range of doubles, and far beyond it of balls
_STEEPER = {  # the values below -_STEEP, and above it
    "exp": ((0.0, 5e-324), (_LARGEST, math.inf)),
    "sinh": ((-math.inf, -_LARGEST), (_LARGEST, math.inf)),
    "cosh": ((_LARGEST, math.inf), (_LARGEST, math.inf)),
}
PI = (3.141592653589793, 3.1415926535897936)  # neighbouring floats
E = (2.718281828459045, 2.7182818284590455)
_HALF_PI = (PI[0] / 2, PI[1] / 2)


@dataclass(frozen=True)
class Monotone:
    """A monotone elementary function: its domain, with enclosures of its values at the ends; `closed`: the ends belong
    to it."""

    domain: tuple[float, float]
    closed: bool
    at_low: tuple[float, float]
    at_high: tuple[float, float]
    falls: bool = False


_INF = math.inf
_MONOTONE = {
    "exp": Monotone((-_INF, _INF), True, (0.0, 0.0), (_INF, _INF)),
    "log": Monotone((0.0, _INF), False, (-_INF, -_INF), (_INF, _INF)),
    "asin": Monotone((-1.0, 1.0), True, (-_HALF_PI[1], -_HALF_PI[0]), _HALF_PI),
    "acos": Monotone((-1.0, 1.0), True, PI, (0.0, 0.0), falls=True),
    "atan": Monotone((-_INF, _INF), True, (-_HALF_PI[1], -_HALF_PI[0]), _HALF_PI),
    "sinh": Monotone((-_INF, _INF), True, (-_INF, -_INF), (_INF, _INF)),
    "tanh": Monotone((-_INF, _INF), True, (-1.0, -1.0), (1.0, 1.0)),
    "asinh": Monotone((-_INF, _INF), True, (-_INF, -_INF), (_INF, _INF)),
    "acosh": Monotone((1.0, _INF), True, (0.0, 0.0), (_INF, _INF)),
    "atanh": Monotone((-1.0, 1.0), False, (-_INF, -_INF), (_INF, _INF)),
}
_BALLS: dict[str, Callable[[arb], arb]] = {
    name: getattr(arb, name) for name in (*_MONOTONE, "sin", "cos", "tan", "cosh")
}
FUNCTIONS = frozenset(_BALLS)


def elementary(name: str, a: Pair) -> tuple[Pair, Flags]:
    """Return the range of the function `name`, such as "exp", on the part of the intervals a inside its domain, and
    flags whether all of a is inside."""
    if name in _MONOTONE:
        return _monotone(name, _MONOTONE[name], a)
    everywhere: Flags = np.ones(a[0].shape, dtype=bool)
    if name == "cosh":
        size = outward.absolute(a)
        return (np.maximum(_at(name, size[0])[0], 1.0), _at(name, size[1])[1]), everywhere
    if name == "tan":
        return _tangent(a)
    return _wave(name, a), everywhere


def arctangent(y: Pair, x: Pair) -> tuple[Pair, Flags, Flags]:
    """Return the range of atan2(y, x), flags where it is defined, and where continuous: off the cut y = 0, x <= 0."""
    at_origin = (y[0] <= 0) & (y[1] >= 0) & (x[0] <= 0) & (x[1] >= 0)
    cut = (y[0] < 0) & (y[1] >= 0) & (x[0] <= 0)
    corners = [_each(_arctangent_at, end, other) for end in y for other in x]
    low = np.min([corner[0] for corner in corners], axis=0)
    high = np.max([corner[1] for corner in corners], axis=0)
    endless = ~np.isfinite(np.stack([*x, *y])).all(axis=0)
    right, upper, lower = x[0] > 0, y[0] >= 0, y[1] < 0
    coarse_low = np.where(upper, 0.0, np.where(right, -_HALF_PI[1], -PI[1]))
    coarse_high = np.where(lower, 0.0, np.where(right, _HALF_PI[1], PI[1]))
    wide = at_origin | cut | endless
    return (np.where(wide, coarse_low, low), np.where(wide, coarse_high, high)), ~at_origin, ~(cut | at_origin)


def _monotone(name: str, rule: Monotone, a: Pair) -> tuple[Pair, Flags]:
    first, last = rule.domain
    if rule.closed:
        inside, outside = (a[0] >= first) & (a[1] <= last), (a[1] < first) | (a[0] > last)
    else:  # an infinite end is no value
        inside, outside = (a[0] > first) & ((a[1] < last) | (last == _INF)), (a[1] <= first) | (a[0] >= last)
    low, high = np.clip(a[0], first, last), np.clip(a[1], first, last)
    below, above = _at(name, np.array((high, low) if rule.falls else (low, high)))
    return outward.where_known(~outside, (below[0], above[1])), inside


def _turns(a: Pair, phase: float) -> Flags:
    """Return whether phase + 2 pi k may lie in the intervals a for an integer k; the slack exceeds all rounding errors,
    so that False is proved."""
    slack = 1e-14 * (1.0 + np.maximum(np.abs(a[0]), np.abs(a[1])))
    first, last = (a[0] - slack - phase) / (2 * PI[0]), (a[1] + slack - phase) / (2 * PI[0])
    inside = np.floor(last) >= np.ceil(first)
    return np.asarray(inside | ~np.isfinite(first) | ~np.isfinite(last) | (slack > 1.0))


def _wave(name: str, a: Pair) -> Pair:
    top = 0.0 if name == "cos" else _HALF_PI[0]
    bounded = np.where(np.isfinite(a[0]), a[0], 0.0), np.where(np.isfinite(a[1]), a[1], 0.0)
    below, above = _at(name, np.array(bounded))
    low = np.where(_turns(a, top - PI[0]), -1.0, np.minimum(*below))
    high = np.where(_turns(a, top), 1.0, np.maximum(*above))
    return np.maximum(low, -1.0), np.minimum(high, 1.0)


def _tangent(a: Pair) -> tuple[Pair, Flags]:
    clear = ~(_turns(a, _HALF_PI[0]) | _turns(a, -_HALF_PI[0]))
    low, high = np.where(clear, a[0], 0.0), np.where(clear, a[1], 0.0)
    return outward.where_known(clear, (_at("tan", low)[0], _at("tan", high)[1])), clear


def _at(name: str, x: Array) -> Pair:
    return _each(partial(_value, name), x)


def _each(function: Callable[..., tuple[float, float]], *x: Array) -> Pair:
    pairs = [function(*each) for each in zip(*(part.ravel().tolist() for part in x), strict=True)]
    low, high = np.array(pairs, dtype=float).reshape(*x[0].shape, 2).T
    return low.T, high.T


@lru_cache(maxsize=1 << 17)
def _value(name: str, x: float) -> tuple[float, float]:
    rule = _MONOTONE.get(name)
    if rule is not None and x in rule.domain:
        return rule.at_low if x == rule.domain[0] else rule.at_high
    if x == 0.0 and "/" in name:
        return 0.0, 0.0
    if math.isinf(x):  # cosh and the powers
        return _LARGEST, math.inf
    if abs(x) > _STEEP and name in _STEEPER:
        return _STEEPER[name][x > 0]
    with ctx.workprec(_PRECISION):
        if "/" in name:
            p, q = name.split("/")
            return _outward(arb(x) ** arb(fmpq(int(p), int(q))))
        return _outward(_BALLS[name](arb(x)))


@lru_cache(maxsize=1 << 16)
def _arctangent_at(y: float, x: float) -> tuple[float, float]:
    if not (math.isfinite(x) and math.isfinite(y)) or x == y == 0.0:
        return -PI[1], PI[1]
    with ctx.workprec(_PRECISION):
        return _outward(arb.atan2(arb(y), arb(x)))


def _outward(ball: arb) -> tuple[float, float]:
    if not ball.is_finite():
        return -math.inf, math.inf
    below, above = ball.lower(), ball.upper()
    low, high = min(float(below), _LARGEST), max(float(above), -_LARGEST)
    while not arb(low) <= below:
        low = math.nextafter(low, -math.inf)
    while not arb(high) >= above:
        high = math.nextafter(high, math.inf)
    return low, high


# --- derivatives

DERIVATIVES: dict[str, Callable[[Pair, Pair], Pair]] = {  # of the argument a and the value f(a)
    "exp": lambda a, f: f,
    "log": lambda a, f: reciprocal((np.maximum(a[0], 0.0), a[1])),
    "sin": lambda a, f: elementary("cos", a)[0],
    "cos": lambda a, f: negate(elementary("sin", a)[0]),
    "tan": lambda a, f: add(_ones(a), power(f, 2)),
    "asin": lambda a, f: _inverse_root(a),
    "acos": lambda a, f: negate(_inverse_root(a)),
    "atan": lambda a, f: reciprocal(add(_ones(a), power(a, 2))),
    "sinh": lambda a, f: elementary("cosh", a)[0],
    "cosh": lambda a, f: elementary("sinh", a)[0],
    "tanh": lambda a, f: reciprocal(power(elementary("cosh", a)[0], 2)),
    "asinh": lambda a, f: reciprocal(outward.square_root(add(_ones(a), power(a, 2)))),
    "acosh": lambda a, f: reciprocal(
        outward.square_root(add(power((np.maximum(a[0], 1.0), a[1]), 2), negate(_ones(a))))
    ),
    "atanh": lambda a, f: reciprocal(_one_minus_square(a)),
}


def _one_minus_square(a: Pair) -> Pair:
    low, high = add(_ones(a), negate(power(a, 2)))
    return np.maximum(low, 0.0), high


def _inverse_root(a: Pair) -> Pair:
    return reciprocal(outward.square_root(_one_minus_square(a)))


def _ones(like: Pair) -> Pair:
    return _pair((1.0, 1.0), like)


def _pair(ends: tuple[float, float], like: Pair) -> Pair:
    return np.full(like[0].shape, ends[0]), np.full(like[0].shape, ends[1])


# --- tapes


@dataclass(frozen=True)
class Enclosure:
    """Proved bounds of an expression and of its partial derivatives on each of k boxes.

    `value`: (low, high), k each, of the values where the expression and its subexpressions are real; `defined`: whether
    it is finite and real on the whole closed box; `continuous`: whether it is continuous there; `slope`: (low, high) of
    the partial derivatives, a row for each requested symbol, k columns; `fixed`: whether it is a constant, whose slope
    is 0.
    """

    value: Pair
    defined: Flags
    continuous: Flags
    slope: Pair
    fixed: bool = False


def enclose(program: Tape, low: Array, high: Array, *, slopes: bool | Sequence[int] = False) -> list[Enclosure]:
    """Return the enclosure of each output of a tape, a straight-line program, on k boxes low <= x <= high (m x k).
    `slopes`: whether to enclose the partial derivatives by all symbols, or the indices of the symbols by which to."""
    by = (range(len(low)) if slopes else ()) if isinstance(slopes, bool) else slopes
    shape, level = low.shape[1:], np.zeros((len(by), *low.shape[1:]))
    everywhere, values = np.ones(shape, dtype=bool), list[Enclosure]()
    with np.errstate(all="ignore"):
        for op, places, number_of in program.instructions:
            args = [values[place] for place in places]
            if op == "symbol":
                unit = level if number_of not in by else level + (np.array(by) == number_of)[:, None]
                values.append(Enclosure((low[number_of], high[number_of]), everywhere, everywhere, (unit, unit)))
            elif op == "number" or op in _CONSTANTS or op == "constant":
                ends = number(number_of) if op == "number" else _CONSTANTS[op if op in _CONSTANTS else number_of]
                constant = np.full(shape, ends[0]), np.full(shape, ends[1])
                values.append(Enclosure(constant, everywhere, everywhere, (level, level), fixed=True))
            elif op == "direction":
                values.append(_direction(args, number_of, slopes is not False))
            elif op in FUNCTIONS:
                values.append(_elementary(op, args[0]))
            else:
                values.append(_RULES[op](args) if number_of is None else _NUMBERED[op](args, number_of))
        return [values[place] for place in program.outputs]


_CONSTANTS = {"pi": PI, "e": E, "true": (1.0, 1.0), "false": (0.0, 0.0)}


def _both(args: list[Enclosure]) -> tuple[Flags, Flags]:
    return reduce(and_, [a.defined for a in args]), reduce(and_, [a.continuous for a in args])


def _chain(a: Enclosure, slope: Callable[[], Pair]) -> Pair:
    """Return f'(a) a', the derivative of f(a), from a function that encloses f'(a)."""
    return a.slope if a.fixed or not len(a.slope[0]) else scale(slope(), a.slope)


def _total(first: Pair, second: Pair) -> Pair:
    return add(first, second) if len(first[0]) else first


def _joint(a: Enclosure, b: Enclosure, first: Pair, second: Pair) -> Pair:
    return second if a.fixed else first if b.fixed else _total(first, second)


def _nowhere(slope: Pair, wild: Flags) -> Pair:
    return outward.where_known(~wild, slope)


def _jumpy(slope: Pair, wild: Flags, reads: list[Enclosure]) -> Pair:
    if not len(slope[0]):
        return slope
    return _nowhere(slope, wild & np.logical_or.reduce([(a.slope[0] != 0) | (a.slope[1] != 0) for a in reads]))


def _flat(slope: Pair) -> Pair:
    return np.zeros(slope[0].shape), np.zeros(slope[0].shape)


def _add(args: list[Enclosure]) -> Enclosure:
    a, b = args
    return Enclosure(add(a.value, b.value), *_both(args), _joint(a, b, a.slope, b.slope))


def _multiply(args: list[Enclosure]) -> Enclosure:
    a, b = args
    if a is b:
        return _power(a, 2)
    slope = _joint(a, b, _chain(a, lambda: b.value), _chain(b, lambda: a.value))
    return Enclosure(multiply(a.value, b.value), *_both(args), slope)


def _power(a: Enclosure, n: int) -> Enclosure:
    value = power(a.value, n)
    clear = (a.value[0] > 0) | (a.value[1] < 0) | (n >= 0)
    factor = number(Fraction(n))
    slope = _chain(a, lambda: multiply(_pair(factor, a.value), power(a.value, n - 1)))
    return Enclosure(value, a.defined & clear, a.continuous & clear, _nowhere(slope, ~clear))


def _root(a: Enclosure, r: Fraction) -> Enclosure:
    """Return the power a^r, r rational and not an integer: real for a >= 0, for r < 0 for a > 0."""
    clear = (a.value[0] > 0) | ((a.value[0] >= 0) & (r > 0))
    factor = number(r)
    slope = _chain(a, lambda: multiply(_pair(factor, a.value), _fractional(a.value, r - 1)))
    value = _fractional(a.value, r)
    return Enclosure(value, a.defined & clear, a.continuous & clear, _nowhere(slope, ~clear))


def _fractional(a: Pair, r: Fraction) -> Pair:
    if r < 0:
        return reciprocal(_fractional(a, -r))
    if r == Fraction(1, 2):
        return outward.square_root(a)
    low, high = (_at(f"{r.numerator}/{r.denominator}", np.maximum(end, 0.0)) for end in a)
    return np.maximum(low[0], 0.0), high[1]


def _raise(args: list[Enclosure]) -> Enclosure:
    """Return the power a^b = exp(b log a), real for a > 0, and 0 at a = 0 for b > 0."""
    a, b = args
    logarithm, _ = elementary("log", (np.maximum(a.value[0], 0.0), a.value[1]))
    value, _ = elementary("exp", multiply(b.value, logarithm))
    clear = (a.value[0] > 0) | ((a.value[0] >= 0) & (b.value[0] > 0))
    defined, continuous = _both(args)
    positive = np.maximum(a.value[0], 0.0), a.value[1]
    rate = _chain(a, lambda: multiply(multiply(b.value, value), reciprocal(positive)))
    slope = _total(rate, _chain(b, lambda: multiply(value, logarithm)))
    return Enclosure(value, defined & clear, continuous & clear, _nowhere(slope, ~clear))


def _elementary(name: str, a: Enclosure) -> Enclosure:
    value, inside = elementary(name, a.value)
    slope = _nowhere(_chain(a, lambda: DERIVATIVES[name](a.value, value)), ~inside)
    return Enclosure(value, a.defined & inside, a.continuous & inside, slope)


def _angle(args: list[Enclosure]) -> Enclosure:
    y, x = args
    value, there, smooth = arctangent(y.value, x.value)
    defined, continuous = _both(args)
    norm = add(power(x.value, 2), power(y.value, 2))
    by_y = _chain(y, lambda: multiply(x.value, reciprocal(norm)))
    by_x = _chain(x, lambda: negate(multiply(y.value, reciprocal(norm))))
    return Enclosure(value, defined & there, continuous & smooth, _nowhere(_total(by_y, by_x), ~smooth))


def _abs(args: list[Enclosure]) -> Enclosure:
    (a,) = args
    positive = a.value[0] >= 0
    signs = np.where(positive, 1.0, -1.0), np.where(~positive & (a.value[1] <= 0), -1.0, 1.0)
    return replace(a, value=outward.absolute(a.value), slope=_chain(a, lambda: signs))


def _norm(args: list[Enclosure]) -> Enclosure:
    parts = [a.value for a in args]
    slopes = [_chain(a, lambda i=i: outward.direction(parts, i, True)) for i, a in enumerate(args)]  # type: ignore[misc]
    return Enclosure(outward.norm(parts), *_both(args), reduce(_total, slopes))


def _direction(args: list[Enclosure], index: int, wide: bool) -> Enclosure:
    """Return the enclosure of e_i/|e| for a vector e (`args`) and i = `index`; at e = 0 the set of its limits, which
    counts as continuous. `wide`: as in `outward.direction`."""
    value = outward.direction([a.value for a in args], index, wide)
    return Enclosure(value, *_both(args), _jumpy(_flat(args[0].slope), value[0] != value[1], args))


def _least(args: list[Enclosure]) -> Enclosure:
    a, b = args
    return _extreme(np.minimum, args, a.value[1] <= b.value[0], b.value[1] <= a.value[0])


def _most(args: list[Enclosure]) -> Enclosure:
    a, b = args
    return _extreme(np.maximum, args, a.value[0] >= b.value[1], b.value[0] >= a.value[1])


def _extreme(pick: np.ufunc, args: list[Enclosure], first: Flags, second: Flags) -> Enclosure:
    a, b = args
    value = pick(a.value[0], b.value[0]), pick(a.value[1], b.value[1])
    sides = zip(a.slope, b.slope, hull(a.slope, b.slope), strict=True)
    low, high = (np.where(first, x, np.where(second, y, either)) for x, y, either in sides)
    return Enclosure(value, *_both(args), (low, high))


def _steps(a: Enclosure, value: Pair) -> Enclosure:
    still = value[0] == value[1]
    return Enclosure(value, a.defined, a.continuous & still, _jumpy(_flat(a.slope), ~still, [a]))


def _heaviside(args: list[Enclosure]) -> Enclosure:
    """Return the unit step of the first argument: 0 below 0, 1 above, and the second argument at 0."""
    a, at_zero = args
    low, high = a.value
    below, above, there = low < 0, high > 0, (low <= 0) & (high >= 0)
    value = np.where(below, 0.0, np.where(above, 1.0, np.inf)), np.where(above, 1.0, np.where(below, 0.0, -np.inf))
    steps = _steps(a, _joined(value, at_zero.value, there))
    defined, continuous = steps.defined & (at_zero.defined | ~there), steps.continuous & (at_zero.continuous | ~there)
    slope = _joined(steps.slope, at_zero.slope, there)
    return replace(steps, defined=defined, continuous=continuous, slope=slope)


def _compare(verdicts: Callable[[Pair, Pair], tuple[Flags, Flags]]) -> Callable[[list[Enclosure]], Enclosure]:
    """Return the rule of a relation such as a < b. `verdicts`: a function of the intervals a, b that returns two flags
    for each box, whether the relation holds everywhere on it, and whether it may hold somewhere."""

    def rule(args: list[Enclosure]) -> Enclosure:
        must, may = verdicts(args[0].value, args[1].value)
        defined = args[0].defined & args[1].defined
        reads = _jumpy(_flat(args[0].slope), np.ones(must.shape, dtype=bool), args)  # infinite where it varies
        return Enclosure((must.astype(float), may.astype(float)), defined, must == may, reads)

    return rule


def _equal(a: Pair, b: Pair) -> tuple[Flags, Flags]:
    same = (a[0] == a[1]) & (b[0] == b[1]) & (a[0] == b[0])
    return same, (a[0] <= b[1]) & (b[0] <= a[1])


def _piecewise(args: list[Enclosure]) -> Enclosure:
    """Return the hull of the branches that apply somewhere on a box; continuous where only one branch applies."""
    values, conditions = args[::2], args[1::2]
    shape = values[0].value[0].shape
    undecided, count = np.ones(shape, dtype=bool), np.zeros(shape, dtype=int)
    defined, continuous = np.ones(shape, dtype=bool), np.ones(shape, dtype=bool)
    value = _pair((np.inf, -np.inf), values[0].value)
    slope = _pair((np.inf, -np.inf), values[0].slope)
    for branch, condition in zip(values, conditions, strict=True):
        here = undecided & (condition.value[1] > 0)
        value = _joined(value, branch.value, here)
        slope = _joined(slope, branch.slope, here)
        defined &= (branch.defined | ~here) & (condition.defined | ~undecided)
        continuous &= branch.continuous | ~here
        count += here
        undecided &= condition.value[0] <= 0
    lost = count == 0
    value = outward.where_known(~lost, value)
    continuous &= (count == 1) & ~undecided
    slope = _nowhere(_jumpy(slope, count != 1, conditions), lost)
    return Enclosure(value, defined & ~undecided, continuous, slope)


def _joined(a: Pair, b: Pair, where: Flags) -> Pair:
    low, high = hull(a, b)
    return np.where(where, low, a[0]), np.where(where, high, a[1])


def _table(args: list[Enclosure], table: tuple[Cells, Index]) -> Enclosure:
    (cells, order), place = table, [a.value for a in args]
    value, bounded, continuous = _cell_ranges(cells, order, place)
    slopes = [
        _jumpy(_chain(a, lambda k=k: _cell_ranges(cells, next_order(order, k), place)[0]), ~continuous[k], [a])  # type: ignore[misc]
        for k, a in enumerate(args)
    ]
    defined, smooth = _both(args)
    return Enclosure(value, defined & bounded, smooth & continuous.all(axis=0), reduce(_total, slopes))


def _cell_ranges(cells: Cells, order: Index, place: Sequence[Pair]) -> tuple[Pair, Flags, Flags]:
    """Return the range of a table's derivative of the given `order` on the intervals `place` of its arguments, flags
    whether it is bounded, and for each axis flags whether it is continuous. At a jump the range has both limits. A box
    that ends on a breakpoint reads the cell inside; with rounded arguments it reads the cell above as well."""
    sides = [zip(low.tolist(), high.tolist(), strict=True) for low, high in place]
    rows = [_on(cells, order, box) for box in zip(*sides, strict=True)]
    low, high, bounded, continuous = zip(*rows, strict=True)
    return (np.array(low), np.array(high)), np.array(bounded), np.array(continuous).T


@lru_cache(maxsize=1 << 16)  # boxes of a bisection share ends, and slopes read the same cells
def _on(cells: Cells, order: Index, box: tuple[Ends, ...]) -> tuple[float, float, bool, tuple[bool, ...]]:
    range, continuous = cells.limits(box, order)
    if range is None:
        return -np.inf, np.inf, False, (False,) * len(order)
    least, most = (end if isinstance(end, float) else number(end)[way] for way, end in enumerate(range))
    return least, most, True, continuous


def _whole(function: Callable[[Array], Array]) -> Callable[[list[Enclosure]], Enclosure]:
    return lambda args: _steps(args[0], (function(args[0].value[0]), function(args[0].value[1])))


_NUMBERED: dict[str, Callable[[list[Enclosure], Any], Enclosure]] = {
    "power": lambda args, n: _power(args[0], n),
    "root": lambda args, r: _root(args[0], r),
    "table": _table,
}
_RULES: dict[str, Callable[[list[Enclosure]], Enclosure]] = {
    "add": _add,
    "mul": _multiply,
    "raise": _raise,
    "min": _least,
    "max": _most,
    "and": _least,
    "or": _most,
    "not": lambda args: replace(args[0], value=(1.0 - args[0].value[1], 1.0 - args[0].value[0])),
    "abs": _abs,
    "norm": _norm,
    "sign": _whole(np.sign),
    "floor": _whole(np.floor),
    "ceiling": _whole(np.ceil),
    "heaviside": _heaviside,
    "atan2": _angle,
    "piecewise": _piecewise,
    "less": _compare(lambda a, b: (a[1] < b[0], a[0] < b[1])),
    "less_equal": _compare(lambda a, b: (a[1] <= b[0], a[0] <= b[1])),
    "equal": _compare(_equal),
    "unequal": _compare(lambda a, b: (~_equal(a, b)[1], ~_equal(a, b)[0])),
}
