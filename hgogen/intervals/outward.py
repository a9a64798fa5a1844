"""Interval arithmetic on arrays of boxes, rounded outward.

An interval is a pair (low, high) of float64 arrays of one shape, an entry for each box. Only the correctly rounded
operations + - * / sqrt of IEEE 754 are used; a result that is not exact moves outward by one float. An infinite end
is a bound and not a value, so 0 times an unbounded interval is 0. low is never +inf and high never -inf: beyond the
largest float the inner end is the largest float.

The rounding error of a sum (Knuth) or product (Dekker) is itself a float, barring overflow and underflow, so an exact
result is known to be exact and stays as it is: 4 - 2*2 is 0 and has a square root.
"""

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[Array, Array]

_SPLIT = 134217729.0  # 2^27 + 1
_LEAST = 5e-324
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
    return add_down(a[0], b[0]), add_up(a[1], b[1])


def add_down(x: Array, y: Array) -> Array:
    """A float below x + y, or the sum where it is exact."""
    return _below(*_sum(x, y))


def add_up(x: Array, y: Array) -> Array:
    """A float above x + y, or the sum where it is exact."""
    return _above(*_sum(x, y))


def negate(a: Pair) -> Pair:
    """-a."""
    return -a[1], -a[0]


def multiply(a: Pair, b: Pair) -> Pair:
    """a b; not negative where the signs say so, also after underflow."""
    x, y = np.empty((2, 4, *np.broadcast(a[0], b[0]).shape))
    x[0], x[2] = a
    y[0], y[1] = b
    x[1], x[3], y[2], y[3] = x[0], x[2], y[0], y[1]
    product, error = _product(x, y)
    least, most = _below(product, error).min(axis=0), _above(product, error).max(axis=0)
    if (least == -_LEAST).any():  # the next float below 0
        least = np.where(_same(a, b), np.maximum(least, 0.0), least)
    if (most == _LEAST).any():
        most = np.where(_other(a, b), np.minimum(most, 0.0), most)
    return least, most


def scale(a: Pair, b: Pair) -> Pair:
    """a b without a look for exact products: cheaper, and one float wider; not negative where the signs say so."""
    low, high = _ends([x * y for x in a for y in b])
    if np.isnan(low).any():  # 0 times an infinite end
        low, high = _ends([np.where((x == 0) | (y == 0), 0.0, x * y) for x in a for y in b])
    least, most, edges = down(low), up(high), (low == 0, high == 0)
    if edges[0].any() or edges[1].any():
        none = _zero(a) | _zero(b)  # a true 0 (both ends of one factor 0) stays
        least = np.where(edges[0] & (none | _same(a, b)), 0.0, least)
        most = np.where(edges[1] & (none | _other(a, b)), 0.0, most)
    return least, most


def _ends(products: list[Array]) -> Pair:
    """The least and the largest of four."""
    a, b, c, d = products
    return np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))


def _zero(a: Pair) -> Flags:
    return np.asarray((a[0] == 0) & (a[1] == 0))


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
    if clear.all():
        least, most = _inverse_down(high), _inverse_up(low)
        return np.where(positive, np.maximum(least, 0.0), least), np.where(negative, np.minimum(most, 0.0), most)
    safe_low, safe_high = np.where(clear, low, 1.0), np.where(clear, high, 1.0)
    least, most = _inverse_down(safe_high), _inverse_up(safe_low)
    least, most = np.where(positive, np.maximum(least, 0.0), least), np.where(negative, np.minimum(most, 0.0), most)
    one_sided_low = np.where((low == 0) & (high > 0), _inverse_down(np.where(high > 0, high, 1.0)), -np.inf)
    one_sided_high = np.where((high == 0) & (low < 0), _inverse_up(np.where(low < 0, low, 1.0)), np.inf)
    return np.where(clear, least, one_sided_low), np.where(clear, most, one_sided_high)


def power(a: Pair, n: int) -> Pair:
    """a^n for whole n; for n < 0 where a is not 0."""
    if n < 0:
        return reciprocal(power(a, -n))
    if n == 1:
        return a
    low, high = a
    size_low, size_high = absolute(a)
    if n % 2 == 0:
        return power_down(size_low, n), power_up(size_high, n)
    least = np.where(low >= 0, power_down(np.maximum(low, 0.0), n), -power_up(np.maximum(-low, 0.0), n))
    most = np.where(high >= 0, power_up(np.maximum(high, 0.0), n), -power_down(np.maximum(-high, 0.0), n))
    return least, most


def power_down(x: Array, n: int) -> Array:
    """A float below x^n or equal, x >= 0."""
    return _repeated(x, n, _below)


def power_up(x: Array, n: int) -> Array:
    """A float above x^n or equal, x >= 0."""
    return _repeated(x, n, _above)


def square_root(a: Pair) -> Pair:
    """The square root of what of a is not negative."""
    return root_down(a[0]), root_up(a[1])


def root_down(x: Array) -> Array:
    """A float below the square root or equal, of what is negative 0."""
    return np.maximum(_below(*_root(np.maximum(x, 0.0))), 0.0)


def root_up(x: Array) -> Array:
    """A float above the square root or equal, of what is negative 0."""
    return np.maximum(_above(*_root(np.maximum(x, 0.0))), 0.0)


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


def _below(value: Array, error: Array) -> Array:
    """A rounded result, or the float below it unless its error, the exact result less it, is known not to be
    negative."""
    return np.where(error >= 0.0, value, down(value))


def _above(value: Array, error: Array) -> Array:
    """A rounded result, or the float above it unless its error is known not to be positive."""
    return np.where(error <= 0.0, value, up(value))


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
    """The rounded product and its error, NaN where that is not known; 0 times infinity is 0."""
    zero = (x == 0) | (y == 0)
    product = np.where(zero, 0.0, x * y)
    size = np.abs(product)
    known = (size > _SMALL) & (size < _LARGE) & (np.abs(x) < _LARGE) & (np.abs(y) < _LARGE)
    error = np.where(known, _residual(x, y, product), np.nan)
    return product, np.where(zero, 0.0, error)


def _inverse_down(x: Array) -> Array:
    """A float below 1/x or equal, x not 0; 1/inf is 0, from the side that x says."""
    inverse, rest = _inverse(x)
    return np.where(np.isinf(x), np.minimum(inverse, 0.0), _below(inverse, rest))


def _inverse_up(x: Array) -> Array:
    inverse, rest = _inverse(x)
    return np.where(np.isinf(x), np.maximum(inverse, 0.0), _above(inverse, rest))


def _inverse(x: Array) -> Pair:
    """1/x rounded, and a number of the sign of its error."""
    inverse = 1.0 / x
    size = np.abs(x)
    known = (size > _SMALL) & (size < 1.0 / _SMALL)
    product = inverse * x
    rest = np.where(known, (1.0 - product) - _residual(inverse, x, product), np.nan)
    return inverse, np.where(x > 0, rest, -rest)  # 1/x - inverse has the sign of rest / x


def _root(x: Array) -> Pair:
    """The root rounded, and a number of the sign of its error."""
    root = np.sqrt(x)
    known = (x > _SMALL) & (x < _LARGE)
    product = root * root
    rest = np.where(known, (x - product) - _residual(root, root, product), np.nan)
    return root, np.where(x == 0, 0.0, rest)


def _repeated(x: Array, n: int, rounded: Callable[[Array, Array], Array]) -> Array:
    """x^n, x >= 0, by squaring, each product rounded to one side."""
    result = None
    while n:
        if n & 1:
            result = x if result is None else np.maximum(rounded(*_product(result, x)), 0.0)
        n >>= 1
        if n:
            x = np.maximum(rounded(*_product(x, x)), 0.0)
    return np.ones_like(x) if result is None else result
