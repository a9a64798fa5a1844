"""Derivatives of elementary functions on intervals, from the argument and the function's value."""

from collections.abc import Callable

import numpy as np

from hgogen.intervals import endpoints, outward
from hgogen.intervals.outward import Pair, add, negate, power, reciprocal

DERIVATIVES: dict[str, Callable[[Pair, Pair], Pair]] = {  # of the argument a and the value f(a)
    "exp": lambda a, f: f,
    "log": lambda a, f: reciprocal((np.maximum(a[0], 0.0), a[1])),
    "sin": lambda a, f: endpoints.apply("cos", a)[0],
    "cos": lambda a, f: negate(endpoints.apply("sin", a)[0]),
    "tan": lambda a, f: add(_ones(a), power(f, 2)),
    "asin": lambda a, f: _inverse_root(a),
    "acos": lambda a, f: negate(_inverse_root(a)),
    "atan": lambda a, f: reciprocal(add(_ones(a), power(a, 2))),
    "sinh": lambda a, f: endpoints.apply("cosh", a)[0],
    "cosh": lambda a, f: endpoints.apply("sinh", a)[0],
    "tanh": lambda a, f: reciprocal(power(endpoints.apply("cosh", a)[0], 2)),
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
    return np.ones(like[0].shape), np.ones(like[0].shape)
