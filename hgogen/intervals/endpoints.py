"""Elementary functions on intervals, and their derivatives: Arb at the ends, rounded outward, between the points where
they turn.

Arb (python-flint) encloses each value in a ball; the ball's ends become floats that are compared with it exactly. An
infinite end takes the function's limit. Boxes of a bisection share ends, so the values are cached.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from flint import arb, ctx, fmpq

from hgogen.intervals.outward import Array, Flags, Pair, absolute, add, negate, power, reciprocal, square_root

_PRECISION = 90  # bits, enough for the ends to be within an ulp
_LARGEST = math.nextafter(math.inf, 0.0)
_STEEP = 1e4  # beyond it e^x and e^-x are out of the range of doubles, and of the balls in the end
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
    """A monotone function: its domain (`closed`: with its ends), its values at the domain's ends, lower and upper."""

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


def apply(name: str, a: Pair) -> tuple[Pair, Flags]:
    """The function's range on a, as far as a is in its domain, and whether all of a is."""
    if name in _MONOTONE:
        return _monotone(name, _MONOTONE[name], a)
    everywhere: Flags = np.ones(a[0].shape, dtype=bool)
    if name == "cosh":
        size = absolute(a)
        return (np.maximum(_at(name, size[0])[0], 1.0), _at(name, size[1])[1]), everywhere
    if name == "tan":
        return _tangent(a)
    return _wave(name, a), everywhere


def real_power(a: Pair, exponent: tuple[int, int]) -> Pair:
    """a^(p/q) for p/q > 0, of what of a is not negative."""
    name = f"{exponent[0]}/{exponent[1]}"
    low, high = np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)
    return np.maximum(_at(name, low)[0], 0.0), _at(name, high)[1]


def angle(y: Pair, x: Pair) -> tuple[Pair, Flags, Flags]:
    """atan2(y, x), whether it is defined, and whether it is continuous, as it is off the cut y = 0, x <= 0."""
    at_origin = (y[0] <= 0) & (y[1] >= 0) & (x[0] <= 0) & (x[1] >= 0)
    cut = (y[0] < 0) & (y[1] >= 0) & (x[0] <= 0)
    corners = [_each(_angle, end, other) for end in y for other in x]
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
    least, most = below[0], above[1]
    return (np.where(outside, -np.inf, least), np.where(outside, np.inf, most)), inside


def _turns(a: Pair, phase: float) -> Flags:
    """Whether phase + 2 pi k may lie in a for a whole k, in floats, with more slack than their rounding errors."""
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
    least, most = _at("tan", low)[0], _at("tan", high)[1]
    return (np.where(clear, least, -np.inf), np.where(clear, most, np.inf)), clear


def _at(name: str, x: Array) -> Pair:
    """Floats below and above the function's value at each x."""
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
def _angle(y: float, x: float) -> tuple[float, float]:
    if not (math.isfinite(x) and math.isfinite(y)) or x == y == 0.0:
        return -PI[1], PI[1]
    with ctx.workprec(_PRECISION):
        return _outward(arb.atan2(arb(y), arb(x)))


def _outward(ball: arb) -> tuple[float, float]:
    """Floats that enclose the ball, equal where it is one float; compared with it exactly."""
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
    "sin": lambda a, f: apply("cos", a)[0],
    "cos": lambda a, f: negate(apply("sin", a)[0]),
    "tan": lambda a, f: add(_ones(a), power(f, 2)),
    "asin": lambda a, f: _inverse_root(a),
    "acos": lambda a, f: negate(_inverse_root(a)),
    "atan": lambda a, f: reciprocal(add(_ones(a), power(a, 2))),
    "sinh": lambda a, f: apply("cosh", a)[0],
    "cosh": lambda a, f: apply("sinh", a)[0],
    "tanh": lambda a, f: reciprocal(power(apply("cosh", a)[0], 2)),
    "asinh": lambda a, f: reciprocal(square_root(add(_ones(a), power(a, 2)))),
    "acosh": lambda a, f: reciprocal(square_root(add(power((np.maximum(a[0], 1.0), a[1]), 2), negate(_ones(a))))),
    "atanh": lambda a, f: reciprocal(_one_minus_square(a)),
}


def _one_minus_square(a: Pair) -> Pair:
    low, high = add(_ones(a), negate(power(a, 2)))
    return np.maximum(low, 0.0), high


def _inverse_root(a: Pair) -> Pair:
    return reciprocal(square_root(_one_minus_square(a)))


def _ones(like: Pair) -> Pair:
    return np.ones(like[0].shape), np.ones(like[0].shape)
