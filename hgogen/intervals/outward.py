"""Interval arithmetic on arrays of boxes, rounded outward.

An interval is a pair (low, high) of float64 arrays of one shape, an entry for each box. Only the correctly rounded
operations + - * / sqrt of IEEE 754 are used; a result that is not exact moves outward by one float. An infinite end
is a bound and not a value, so 0 times an unbounded interval is 0. low is never +inf and high never -inf: beyond the
largest float the inner end is the largest float.

The rounding error of a sum (Knuth) or product (Dekker) is itself a float, barring overflow and underflow, so an exact
result is known to be exact and stays as it is: 4 - 2*2 is 0 and has a square root.
"""

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[Array, Array]

_SPLIT = 134217729.0  # 2^27 + 1
_SMALL, _LARGE = 1e-280, 1e290  # between them Dekker's and Newton's residuals neither underflow nor overflow


def number(value: Fraction | float) -> tuple[float, float]:
    """The neighbouring floats that enclose a number, equal where it is a float."""
    if isinstance(value, float):
        return value, value
    try:
        nearest = float(value)
    except OverflowError:
        nearest = math.inf if value > 0 else -math.inf
    if math.isinf(nearest):
        largest = math.nextafter(math.inf, 0.0)
        return (largest, math.inf) if value > 0 else (-math.inf, -largest)
    exact = Fraction(nearest)
    return (
        nearest if exact <= value else math.nextafter(nearest, -math.inf),
        nearest if exact >= value else math.nextafter(nearest, math.inf),
    )


def down(x: Array) -> Array:
    """The next float below."""
    return np.nextafter(x, -np.inf)


def up(x: Array) -> Array:
    """The next float above."""
    return np.nextafter(x, np.inf)


def add(a: Pair, b: Pair) -> Pair:
    """a + b."""
    low, below = _sum(a[0], b[0])
    high, above = _sum(a[1], b[1])
    return np.where(below >= 0.0, low, down(low)), np.where(above <= 0.0, high, up(high))


def negate(a: Pair) -> Pair:
    """-a."""
    return -a[1], -a[0]


def multiply(a: Pair, b: Pair) -> Pair:
    """a b; not negative where the signs say so, also after underflow."""
    x, y = np.empty((2, 4, *np.broadcast(a[0], b[0]).shape))
    x[0], x[2] = a
    y[0], y[1] = b
    x[1], x[3], y[2], y[3] = x[0], x[2], y[0], y[1]
    low, high = _product(x, y)
    least, most = low.min(axis=0), high.max(axis=0)
    return np.where(_same(a, b), np.maximum(least, 0.0), least), np.where(_other(a, b), np.minimum(most, 0.0), most)


def scale(a: Pair, b: Pair) -> Pair:
    """a b without a look for exact products: cheaper, and one float wider; not negative where the signs say so."""
    zeros, others = (a[0] == 0, a[1] == 0), (b[0] == 0, b[1] == 0)
    products = [
        np.where(p | q, 0.0, x * y) for x, p in zip(a, zeros, strict=True) for y, q in zip(b, others, strict=True)
    ]
    low, high = products[0], products[0]
    for product in products[1:]:
        low, high = np.minimum(low, product), np.maximum(high, product)
    least, most, edges = down(low), up(high), (low == 0, high == 0)
    if edges[0].any() or edges[1].any():
        none = (zeros[0] & zeros[1]) | (others[0] & others[1])  # a true 0 (both ends of one factor 0) stays
        least = np.where(edges[0] & (none | _same(a, b)), 0.0, least)
        most = np.where(edges[1] & (none | _other(a, b)), 0.0, most)
    return least, most


def _same(a: Pair, b: Pair) -> Flags:
    """No product is negative."""
    return np.asarray(((a[0] >= 0) & (b[0] >= 0)) | ((a[1] <= 0) & (b[1] <= 0)))


def _other(a: Pair, b: Pair) -> Flags:
    """No product is positive."""
    return np.asarray(((a[0] >= 0) & (b[1] <= 0)) | ((a[1] <= 0) & (b[0] >= 0)))


def reciprocal(a: Pair) -> Pair:
    """1/a where a is not 0."""
    low, high = a
    positive, negative = low > 0, high < 0
    clear = positive | negative
    safe_low, safe_high = np.where(clear, low, 1.0), np.where(clear, high, 1.0)
    least, most = _inverse(safe_high)[0], _inverse(safe_low)[1]
    least, most = np.where(positive, np.maximum(least, 0.0), least), np.where(negative, np.minimum(most, 0.0), most)
    one_sided_low = np.where((low == 0) & (high > 0), _inverse(np.where(high > 0, high, 1.0))[0], -np.inf)
    one_sided_high = np.where((high == 0) & (low < 0), _inverse(np.where(low < 0, low, 1.0))[1], np.inf)
    return np.where(clear, least, one_sided_low), np.where(clear, most, one_sided_high)


def power(a: Pair, n: int) -> Pair:
    """a^n for whole n; for n < 0 where a is not 0."""
    if n < 0:
        return reciprocal(power(a, -n))
    low, high = a
    size_low, size_high = absolute(a)
    if n % 2 == 0:
        return _power_down(size_low, n), _power_up(size_high, n)
    least = np.where(low >= 0, _power_down(np.maximum(low, 0.0), n), -_power_up(np.maximum(-low, 0.0), n))
    most = np.where(high >= 0, _power_up(np.maximum(high, 0.0), n), -_power_down(np.maximum(-high, 0.0), n))
    return least, most


def square_root(a: Pair) -> Pair:
    """The square root of what of a is not negative."""
    return _root_ends(np.maximum(a[0], 0.0))[0], _root_ends(np.maximum(a[1], 0.0))[1]


def absolute(a: Pair) -> Pair:
    """|a|."""
    sizes = np.abs(a[0]), np.abs(a[1])
    across = (a[0] <= 0) & (a[1] >= 0)
    return np.where(across, 0.0, np.minimum(*sizes)), np.maximum(*sizes)


def hull(a: Pair, b: Pair) -> Pair:
    """The smallest interval that holds both."""
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def meet(a: Pair, b: Pair) -> Pair:
    """The intersection of two enclosures of one thing."""
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def _sum(x: Array, y: Array) -> Pair:
    """The rounded sum and its error; the error is NaN after overflow, which passes no comparison."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


def _residual(x: Array, y: Array, product: Array) -> Array:
    """x y - product, exact."""
    t = _SPLIT * x
    x_high = t - (t - x)
    t = _SPLIT * y
    y_high = t - (t - y)
    x_low, y_low = x - x_high, y - y_high
    return ((x_high * y_high - product) + x_high * y_low + x_low * y_high) + x_low * y_low


def _product(x: Array, y: Array) -> Pair:
    """Floats below and above x y, equal where it is exact."""
    zero = (x == 0) | (y == 0)
    product = np.where(zero, 0.0, x * y)
    size = np.abs(product)
    known = (size > _SMALL) & (size < _LARGE) & (np.abs(x) < _LARGE) & (np.abs(y) < _LARGE)
    error = np.where(known, _residual(x, y, product), np.nan)
    error = np.where(zero, 0.0, error)
    return np.where(error >= 0, product, down(product)), np.where(error <= 0, product, up(product))


def _inverse(x: Array) -> Pair:
    """Floats below and above 1/x, x not 0; 1/inf is 0, from the side that x says."""
    inverse = 1.0 / x
    size = np.abs(x)
    known = (size > _SMALL) & (size < 1.0 / _SMALL)
    product = inverse * x
    rest = np.where(known, (1.0 - product) - _residual(inverse, x, product), np.nan)
    rest = np.where(x > 0, rest, -rest)  # 1/x - inverse has the sign of rest / x
    low, high = np.where(rest >= 0, inverse, down(inverse)), np.where(rest <= 0, inverse, up(inverse))
    endless = np.isinf(x)
    return np.where(endless, np.minimum(inverse, 0.0), low), np.where(endless, np.maximum(inverse, 0.0), high)


def _root_ends(x: Array) -> Pair:
    root = np.sqrt(x)
    known = (x > _SMALL) & (x < _LARGE)
    product = root * root
    rest = np.where(known, (x - product) - _residual(root, root, product), np.nan)
    rest = np.where(x == 0, 0.0, rest)
    low, high = np.where(rest >= 0, root, down(root)), np.where(rest <= 0, root, up(root))
    return np.maximum(low, 0.0), np.maximum(high, 0.0)


def _power_down(x: Array, n: int) -> Array:
    return _repeated(x, n, 0)


def _power_up(x: Array, n: int) -> Array:
    return _repeated(x, n, 1)


def _repeated(x: Array, n: int, side: int) -> Array:
    """x^n, x >= 0, by squaring, each product rounded to one side (0: down, 1: up)."""
    result = None
    while n:
        if n & 1:
            result = x if result is None else np.maximum(_product(result, x)[side], 0.0)
        n >>= 1
        if n:
            x = np.maximum(_product(x, x)[side], 0.0)
    return np.ones_like(x) if result is None else result
