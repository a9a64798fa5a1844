"""Interval arithmetic on arrays of boxes, rounded outward.

An interval is a pair (low, high) of float64 arrays of one shape, an entry for each box. Only the correctly rounded
operations + - * / sqrt of IEEE 754 are used; a result that is not exact moves outward by one float. An infinite end
is a bound and not a value, so 0 times an unbounded interval is 0. low is never +inf and high never -inf: beyond the
largest float the inner end is the largest float.

The rounding error of a sum (Knuth) or product (Dekker) is itself a float, barring overflow and underflow, so an exact
result is known to be exact and stays as it is: 4 - 2*2 is 0 and has a square root.
"""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache, reduce

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[Array, Array]

_SPLIT = 134217729.0  # 2^27 + 1
_SMALL, _LARGE = 1e-280, 1e290  # range of numbers whose Dekker and Newton residuals neither underflow nor overflow


@lru_cache(maxsize=1 << 12, typed=True)  # every batch of boxes needs the numbers of the tape
def number(value: Fraction | float) -> tuple[float, float]:
    """Return the neighbouring floats (below, above) that enclose a number; both are the number if it is a float."""
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
    """Return the next float below each x."""
    return np.nextafter(x, -np.inf)


def up(x: Array) -> Array:
    """Return the next float above each x."""
    return np.nextafter(x, np.inf)


def add(a: Pair, b: Pair) -> Pair:
    """Return the sum a + b of intervals, rounded outward."""
    return add_down(a[0], b[0]), add_up(a[1], b[1])


def add_down(x: Array, y: Array) -> Array:
    """Return a float below x + y, or the sum where it is exact."""
    return _below(*_sum(x, y))


def add_up(x: Array, y: Array) -> Array:
    """Return a float above x + y, or the sum where it is exact."""
    return _above(*_sum(x, y))


def negate(a: Pair) -> Pair:
    """Return the interval -a."""
    return -a[1], -a[0]


def multiply(a: Pair, b: Pair) -> Pair:
    """Return the product a b of intervals, rounded outward. The product of two intervals of equal (opposite) signs
    stays >= 0 (<= 0), also after underflow."""
    product, error = (part.reshape(4, *part.shape[2:]) for part in _product(np.array(a)[:, None], np.array(b)))
    least, most = np.minimum.reduce(product), np.maximum.reduce(product)
    least = np.where(((product == least) > (error >= 0.0)).any(axis=0), down(least), least)
    most = np.where(((product == most) > (error <= 0.0)).any(axis=0), up(most), most)
    if np.isnan(error).any():  # an end that underflows may move beyond 0
        same, other, _ = _signs(a, b)
        least = np.where(same, np.maximum(least, 0.0), least)
        most = np.where(other, np.minimum(most, 0.0), most)
    return least, most


def scale(a: Pair, b: Pair) -> Pair:
    """Return the product a b of intervals, always rounded outward: cheaper than `multiply`, and up to one float wider
    at each end."""
    low, high = _ends([x * y for x in a for y in b])
    if np.isnan(low).any():  # 0 times an infinite end
        low, high = _ends([np.where((x == 0) | (y == 0), 0.0, x * y) for x in a for y in b])
    least, most, edges = down(low), up(high), (low == 0, high == 0)
    if edges[0].any() or edges[1].any():
        same, other, none = _signs(a, b)  # a true 0 (both ends of one factor 0) stays
        least = np.where(edges[0] & (none | same), 0.0, least)
        most = np.where(edges[1] & (none | other), 0.0, most)
    return least, most


def _ends(products: list[Array]) -> Pair:
    a, b, c, d = products
    return np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))


def _signs(a: Pair, b: Pair) -> tuple[Flags, Flags, Flags]:
    (a_up, a_down), (b_up, b_down) = (((ends[0] >= 0), (ends[1] <= 0)) for ends in (a, b))
    return (a_up & b_up) | (a_down & b_down), (a_up & b_down) | (a_down & b_up), (a_up & a_down) | (b_up & b_down)


def reciprocal(a: Pair) -> Pair:
    """Return the interval 1/a where a is not 0; the real line, or half of it, where a contains 0."""
    low, high = a
    positive, negative = low > 0, high < 0
    clear = positive | negative
    if clear.all():
        least, most = _inverted(low, high)
        return np.where(positive, np.maximum(least, 0.0), least), np.where(negative, np.minimum(most, 0.0), most)
    least, most = _inverted(np.where(clear, low, 1.0), np.where(clear, high, 1.0))
    least, most = np.where(positive, np.maximum(least, 0.0), least), np.where(negative, np.minimum(most, 0.0), most)
    below, above = _inverted(np.where(low < 0, low, 1.0), np.where(high > 0, high, 1.0))
    one_sided_low = np.where((low == 0) & (high > 0), below, -np.inf)
    one_sided_high = np.where((high == 0) & (low < 0), above, np.inf)
    return np.where(clear, least, one_sided_low), np.where(clear, most, one_sided_high)


def power(a: Pair, n: int) -> Pair:
    """Return the interval a^n for whole n, for n < 0 where a is not 0."""
    if n < 0:
        return reciprocal(power(a, -n))
    if n == 1:
        return a
    if n % 2 == 0:
        least, most = _repeated(np.array(absolute(a)), n, _outside)
        return least, most
    low, high = a
    least = np.where(low >= 0, power_down(np.maximum(low, 0.0), n), -power_up(np.maximum(-low, 0.0), n))
    most = np.where(high >= 0, power_up(np.maximum(high, 0.0), n), -power_down(np.maximum(-high, 0.0), n))
    return least, most


def power_down(x: Array, n: int) -> Array:
    """Return a float <= x^n for each x >= 0."""
    return _repeated(x, n, _below)


def power_up(x: Array, n: int) -> Array:
    """Return a float >= x^n for each x >= 0."""
    return _repeated(x, n, _above)


def square_root(a: Pair) -> Pair:
    """Return the square root of the part of the interval a that is not negative."""
    return root_down(a[0]), root_up(a[1])


def root_down(x: Array) -> Array:
    """Return a float <= sqrt(x) for each x; 0 for a negative number."""
    return np.maximum(_below(*_root(np.maximum(x, 0.0))), 0.0)


def root_up(x: Array) -> Array:
    """Return a float >= sqrt(x) for each x; 0 for a negative number."""
    return np.maximum(_above(*_root(np.maximum(x, 0.0))), 0.0)


def absolute(a: Pair) -> Pair:
    """Return the interval of |a|."""
    sizes = np.abs(a[0]), np.abs(a[1])
    across = (a[0] <= 0) & (a[1] >= 0)
    return np.where(across, 0.0, np.minimum(*sizes)), np.maximum(*sizes)


def norm(parts: Sequence[Pair]) -> Pair:
    """Return the interval of the Euclidean norm |e| of the intervals e_i, `parts`."""
    return square_root(reduce(add, (power(a, 2) for a in parts)))


def direction(parts: Sequence[Pair], index: int, wide: bool) -> Pair:
    """Return the range of e_i/|e|, i = `index`, for a vector of intervals e (`parts`). `wide`: where e may be 0, only
    the limits from inside the box count, and not the values on its faces, as for slopes.

    e_i/|e| increases with e_i. With the size of the other e_j it decreases where e_i > 0, and increases where e_i < 0.
    """
    low, high = parts[index]
    zero = np.zeros(low.shape)
    others = reduce(add, (power(a, 2) for i, a in enumerate(parts) if i != index), (zero, zero))
    alone = np.full(low.shape, len(parts) == 1)
    below, above = _share(np.stack((low, low, high, high)), np.stack((*others, *others)))
    least = np.where(low < 0, below[0], np.where(alone, 1.0, below[1]))
    most = np.where(high > 0, above[2], np.where(alone, -1.0, above[3]))
    free = (low <= 0) & (high >= 0) & (others[0] <= 0)  # e may be 0
    least = np.where(free, np.where(low < 0, -1.0, np.where(alone, 1.0, 0.0)), least)
    most = np.where(free, np.where(high > 0, 1.0, np.where(alone, -1.0, 0.0)), most)
    within = wide & (low < high)
    return np.where(free & ~within, -1.0, least), np.where(free & ~within, 1.0, most)


def hull(a: Pair, b: Pair) -> Pair:
    """Return the smallest interval that encloses a and b."""
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def meet(a: Pair, b: Pair) -> Pair:
    """Return the intersection of two enclosures a and b of one value."""
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def where_known(known: Flags, a: Pair) -> Pair:
    """Return the interval a where the flag `known` is set, else the real line."""
    return np.where(known, a[0], -np.inf), np.where(known, a[1], np.inf)


def _share(e: Array, others: Array) -> Pair:
    """Return the interval of e/sqrt(e^2 + others), which lies between -1 and 1; NaN for e = others = 0."""
    whole = square_root(add(power((e, e), 2), (others, others)))
    low, high = multiply((e, e), reciprocal(whole))
    far = np.isinf(e)
    return np.where(far, -1.0, np.maximum(low, -1.0)), np.where(far, 1.0, np.minimum(high, 1.0))


def _below(value: Array, error: Array) -> Array:
    """Return a rounded value if its rounding error, exact minus rounded, is known to be >= 0, else the next float
    below."""
    return np.where(error >= 0.0, value, down(value))


def _above(value: Array, error: Array) -> Array:
    """Return a rounded value if its rounding error, exact minus rounded, is known to be <= 0, else the next float
    above."""
    return np.where(error <= 0.0, value, up(value))


def _sum(x: Array, y: Array) -> Pair:
    """Return the rounded sum x + y and its rounding error, which is NaN after overflow, so that every comparison with
    it is false."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


def _outside(value: Array, error: Array) -> Array:
    return np.array((_below(value[0], error[0]), _above(value[1], error[1])))


def _split(x: Array) -> Pair:
    """Return two floats of half the digits of x whose sum is x (Dekker)."""
    t = _SPLIT * x
    high = t - (t - x)
    return high, x - high


def _residual(x: Array, y: Array, product: Array) -> Array:
    """Return the exact residual x y - product of a rounded product."""
    x_high, x_low = _split(x)
    y_high, y_low = (x_high, x_low) if y is x else _split(y)
    return ((x_high * y_high - product) + x_high * y_low + x_low * y_high) + x_low * y_low


def _product(x: Array, y: Array) -> Pair:
    """Return the rounded product x y and its error, NaN if unknown; 0 times infinity is 0."""
    product = x * y
    size = np.abs(product)
    known, error = (size > _SMALL) & (size < _LARGE), _residual(x, y, product)  # NaN of factors beyond _LARGE
    if known.all():
        return product, error
    zero = (x == 0) | (y == 0)
    return np.where(zero, 0.0, product), np.where(zero, 0.0, np.where(known, error, np.nan))


def _inverted(low: Array, high: Array) -> Pair:
    """Return a float <= 1/high and a float >= 1/low, for ends that are not 0; 1/inf is 0 with its sign."""
    x = np.array((high, low))
    inverse, size = 1.0 / x, np.abs(x)
    known = (size > _SMALL) & (size < 1.0 / _SMALL)
    product = inverse * x
    residual = np.where(known, (1.0 - product) - _residual(inverse, x, product), np.nan)
    error = np.where(x > 0, residual, -residual)  # of the sign of 1/x - inverse
    least = np.where(np.isinf(high), np.minimum(inverse[0], 0.0), _below(inverse[0], error[0]))
    return least, np.where(np.isinf(low), np.maximum(inverse[1], 0.0), _above(inverse[1], error[1]))


def _root(x: Array) -> Pair:
    """Return the rounded sqrt(x), and a number with the sign of its rounding error, NaN if unknown."""
    root = np.sqrt(x)
    known = (x > _SMALL) & (x < _LARGE)
    product = root * root
    error = np.where(known, (x - product) - _residual(root, root, product), np.nan)
    return root, np.where(x == 0, 0.0, error)


def _repeated(x: Array, n: int, rounded: Callable[[Array, Array], Array]) -> Array:
    """Return x^n, x >= 0, by squaring, each product rounded to one side by `rounded(value, error)`."""
    result = None
    while n:
        if n & 1:
            result = x if result is None else np.maximum(rounded(*_product(result, x)), 0.0)
        n >>= 1
        if n:
            x = np.maximum(rounded(*_product(x, x)), 0.0)
    return np.ones_like(x) if result is None else result
