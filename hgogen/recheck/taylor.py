"""Taylor series below an order, as an arithmetic on top of intervals: c_0 + c_1 s + .. + c_(N-1) s^(N-1)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from operator import add

from .arithmetic import Arithmetic, Undefined
from .interval import Interval, intervals, point
from .tables import in_one_piece, is_table, next_of, table_of

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


def begin(coefficients: Sequence[Interval], order: int) -> Taylor:
    """The series below t^order that begins with these coefficients, and goes on with zeros."""
    return Taylor((*coefficients, *[_NONE] * order)[:order])


def taylor(order: int) -> Arithmetic:
    """Series below t^order."""

    def number(value: Fraction) -> Taylor:
        return begin((point(value),), order)

    def power(x: Taylor, exponent: int) -> Taylor:
        result = reduce(Taylor.__mul__, [x] * abs(exponent), number(Fraction(1)))
        result = result if exponent >= 0 else number(Fraction(1)) / result
        return Taylor((intervals.power(x.coefficients[0], exponent), *result.coefficients[1:]))

    def function(name: str, args: tuple[Taylor, ...]) -> Taylor:
        if not args:
            return begin((intervals.function(name, ()),), order)
        if is_table(name):
            return _table(name, args)
        if name in _RATIOS:
            return _integrated(name, args[0], _RATIOS[name](number(Fraction(1)), power(args[0], 2)))
        if name not in _FUNCTIONS:
            raise Undefined(f"no series of {name}")
        return Taylor(tuple(_FUNCTIONS[name](*(arg.coefficients for arg in args))))

    def both(way: Taylor, a: Taylor, b: Taylor) -> Taylor:
        return a if _way(way.coefficients[0]) > 0 else b

    return Arithmetic(number, power, _root, function, both)


def _table(name: str, args: tuple[Taylor, ...]) -> Taylor:
    """By the derivatives on the one piece in which all arguments begin, without its ends: a derivative that jumps where
    a bisection cuts would else be on neither side of it."""
    if not in_one_piece(name, [x.coefficients[0].exactly for x in args]):
        raise Undefined("no series where a table may be at one of its points")
    return _expanded(name, args, 0)


def _expanded(name: str, args: tuple[Taylor, ...], k: int) -> Taylor:
    """T + d (T' + d/2 (T'' + ..)) of d = x - x_0 from argument k on, whose derivatives T are series in those after."""
    if k == len(args):
        value = intervals.function(name, tuple(x.coefficients[0] for x in args))
        return begin((value,), len(args[0].coefficients))
    d, derivatives = Taylor((_NONE, *args[k].coefficients[1:])), [name]
    for _ in range(table_of(name)[0].degree):
        derivatives.append(next_of(derivatives[-1], k))
    *each, total = (_expanded(one, args, k + 1) for one in derivatives)
    for i, value in reversed([*enumerate(each, 1)]):
        total = value + d * Taylor(tuple(_product(_share(1, i), c) for c in total.coefficients))
    return total


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


def _integrated(name: str, x: Taylor, slope: Taylor) -> Taylor:
    """A function of x from the series of its slope there."""
    a, rate = x.coefficients, slope.coefficients
    return Taylor((intervals.function(name, (a[0],)), *(_moved(a, rate, k) for k in range(1, len(a)))))


def _turned(a: Sequence[Interval], names: tuple[str, str], way: int) -> tuple[list[Interval], list[Interval]]:
    """sin and cos, of whose slopes the second has the sign -1, or sinh and cosh, of 1."""
    s, c = ([intervals.function(name, (a[0],))] for name in names)
    for k in range(1, len(a)):
        rise, other = _moved(a, c, k), _moved(a, s, k)
        s.append(rise)
        c.append(other if way > 0 else -other)
    return s, c


_spread = partial(_turned, names=("sinh", "cosh"), way=1)
_round = partial(_turned, names=("sin", "cos"), way=-1)


def _tan(a: Sequence[Interval]) -> Sequence[Interval]:
    s, c = _round(a)
    return (Taylor(tuple(s)) / Taylor(tuple(c))).coefficients


def _tanh(a: Sequence[Interval]) -> list[Interval]:
    """t' = (1 - t^2) a'."""
    t, slope = [intervals.function("tanh", (a[0],))], list[Interval]()
    for k in range(1, len(a)):
        square = intervals.power(t[0], 2) if k == 1 else _total(_product(t[i], t[k - 1 - i]) for i in range(k))
        slope.append(point(Fraction(1)) - square if k == 1 else -square)
        t.append(_moved(a, slope, k))
    return t


def _log(a: Sequence[Interval]) -> list[Interval]:
    value = [intervals.function("log", (a[0],))]
    for k in range(1, len(a)):
        terms = (_product(a[k - i], _share(i, k) * value[i]) for i in range(1, k))
        value.append((a[k] - _total(terms)) / a[0])
    return value


def _angle(y: Sequence[Interval], x: Sequence[Interval]) -> list[Interval]:
    """(x^2 + y^2) a' = y' x - x' y."""
    angle, square = [intervals.function("atan2", (y[0], x[0]))], intervals.power(x[0], 2) + intervals.power(y[0], 2)
    around = (Taylor(tuple(x)) * Taylor(tuple(x)) + Taylor(tuple(y)) * Taylor(tuple(y))).coefficients
    for k in range(1, len(x)):
        before = _total(_product(around[k - i], _share(i, k) * angle[i]) for i in range(1, k))
        angle.append((_moved(y, x, k) - _moved(x, y, k) - before) / square)
    return angle


def _way(x: Interval) -> int:
    """The sign of what keeps it: at a kink there is no series."""
    if not x.sign:
        raise Undefined("no series at a kink")
    return x.sign


def _chosen(a: Sequence[Interval], b: Sequence[Interval], way: int) -> Sequence[Interval]:
    """The larger of two for `way` 1, the smaller for -1."""
    return a if _way(a[0] - b[0]) == way else b


_FUNCTIONS: Mapping[str, Callable[..., Sequence[Interval]]] = {
    "exp": _exp,
    "log": _log,
    "sin": lambda a: _round(a)[0],
    "cos": lambda a: _round(a)[1],
    "tan": _tan,
    "sinh": lambda a: _spread(a)[0],
    "cosh": lambda a: _spread(a)[1],
    "tanh": _tanh,
    "atan2": _angle,
    "Abs": lambda a: a if _way(a[0]) > 0 else [-x for x in a],
    **dict.fromkeys(("sign", "side"), lambda a: begin((point(Fraction(_way(a[0]))),), len(a)).coefficients),
    "Max": lambda *each: reduce(lambda a, b: _chosen(a, b, 1), each),
    "Min": lambda *each: reduce(lambda a, b: _chosen(a, b, -1), each),
}
_INVERSE_ROOT = Fraction(-1, 2)
# The slope of a function of x, from 1 and x^2.
_RATIOS: Mapping[str, Callable[[Taylor, Taylor], Taylor]] = {
    "atan": lambda one, xx: one / (one + xx),
    "atanh": lambda one, xx: one / (one - xx),
    "asin": lambda one, xx: _root(one - xx, _INVERSE_ROOT),
    "acos": lambda one, xx: -_root(one - xx, _INVERSE_ROOT),
    "asinh": lambda one, xx: _root(one + xx, _INVERSE_ROOT),
    "acosh": lambda one, xx: _root(xx - one, _INVERSE_ROOT),
}
