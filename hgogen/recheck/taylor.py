"""Taylor series below an order, as an arithmetic on top of intervals: c_0 + c_1 s + .. + c_(N-1) s^(N-1)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, reduce
from operator import add

from .arithmetic import Arithmetic, Undefined
from .interval import Interval, intervals, point

_NONE = point(Fraction(0))


@dataclass(frozen=True)
class Taylor:
    """The coefficients of a series."""

    coefficients: tuple[Interval, ...]

    def __add__(self, other: "Taylor") -> "Taylor":
        return Taylor(tuple(_total(pair) for pair in zip(self.coefficients, other.coefficients, strict=True)))

    def __neg__(self) -> "Taylor":
        return Taylor(tuple(a if a is _NONE else -a for a in self.coefficients))

    def __sub__(self, other: "Taylor") -> "Taylor":
        return self + -other

    def __mul__(self, other: "Taylor") -> "Taylor":
        a, b = self.coefficients, other.coefficients
        return Taylor(tuple(_total(_product(a[i], b[k - i]) for i in range(k + 1)) for k in range(len(a))))

    def __truediv__(self, other: "Taylor") -> "Taylor":
        a, b, q = self.coefficients, other.coefficients, list[Interval]()
        for k in range(len(a)):
            q.append((a[k] - _total(_product(b[i], q[k - i]) for i in range(1, k + 1))) / b[0])
        return Taylor(tuple(q))


def _total(terms: Iterable[Interval]) -> Interval:
    """The sum; what is 0 for sure costs nothing."""
    there = [term for term in terms if term is not _NONE]
    return reduce(add, there) if there else _NONE


def _product(a: Interval, b: Interval) -> Interval:
    return _NONE if a is _NONE or b is _NONE else a * b


def taylor(order: int) -> Arithmetic:
    """Series below t^order."""

    def number(value: Fraction) -> Taylor:
        return Taylor((point(value), *[_NONE] * (order - 1)))

    def power(x: Taylor, exponent: int) -> Taylor:
        result = reduce(Taylor.__mul__, [x] * abs(exponent), number(Fraction(1)))
        return result if exponent >= 0 else number(Fraction(1)) / result

    def function(name: str, args: tuple[Taylor, ...]) -> Taylor:
        if not args:
            return Taylor((intervals.function(name, ()), *[_NONE] * (order - 1)))
        if name not in _FUNCTIONS:
            raise Undefined(f"no series of {name}")
        return Taylor(tuple(_FUNCTIONS[name](args[0].coefficients)))

    def no_hull(a: Taylor, b: Taylor) -> Taylor:
        raise Undefined("no series of Min and Max")

    return Arithmetic(number, power, _root, function, no_hull)


def _root(x: Taylor, exponent: Fraction) -> Taylor:
    """b = a^r by k a_0 b_k = sum (r i - (k - i)) a_i b_(k-i)."""
    a = x.coefficients
    b = [intervals.root(a[0], exponent)]
    for k in range(1, len(a)):
        terms = (_product(a[i], _share(exponent * i - (k - i), k) * b[k - i]) for i in range(1, k + 1))
        b.append(_total(terms) / a[0])
    return Taylor(tuple(b))


@lru_cache(maxsize=1 << 12)
def _share(i: Fraction | int, k: int) -> Interval:
    return point(Fraction(i) / k)


def _moved(a: Sequence[Interval], f: Sequence[Interval], k: int) -> Interval:
    """The coefficient k of the integral of a' f."""
    return _total(_product(a[i], _share(i, k) * f[k - i]) for i in range(1, k + 1) if a[i] is not _NONE)


def _exp(a: Sequence[Interval]) -> list[Interval]:
    e = [intervals.function("exp", (a[0],))]
    for k in range(1, len(a)):
        e.append(_moved(a, e, k))
    return e


def _turned(a: Sequence[Interval]) -> tuple[list[Interval], list[Interval]]:
    """sin and cos."""
    s, c = ([intervals.function(name, (a[0],))] for name in ("sin", "cos"))
    for k in range(1, len(a)):
        rise, fall = _moved(a, c, k), -_moved(a, s, k)
        s.append(rise)
        c.append(fall)
    return s, c


def _log(a: Sequence[Interval]) -> list[Interval]:
    value = [intervals.function("log", (a[0],))]
    for k in range(1, len(a)):
        terms = (_product(a[k - i], _share(i, k) * value[i]) for i in range(1, k))
        value.append((a[k] - _total(terms)) / a[0])
    return value


_FUNCTIONS: Mapping[str, Callable[[Sequence[Interval]], Sequence[Interval]]] = {
    "exp": _exp,
    "log": _log,
    "sin": lambda a: _turned(a)[0],
    "cos": lambda a: _turned(a)[1],
    "tan": lambda a: (Taylor(tuple(_turned(a)[0])) / Taylor(tuple(_turned(a)[1]))).coefficients,
}
