"""Evaluation of a tape in balls and power series: values at rational points, and Taylor series of a motion in t.

Each value, or coefficient, is an Arb ball: a midpoint with a proved radius. A value at a point that is undefined, or
undecided at this precision, is NaN; a finite ball proves that the value is defined. A series that is not finite, or a
branch that the balls cannot decide, raises `Undecided`: another point may succeed.

The series in t are those of a plant's states, outputs and variational equations at a random point:

    x' = f(x, u),  y = h(x, u),  p' = 0         u: power series with random coefficients, so all derivatives are free
    Phi' = df/dx Phi + [0 | df/dp],  Phi(0) = [I | 0]
    dy/d(x_0, p) = dh/dx Phi + [0 | dh/dp] = sum_k Y_k t^k

Y_k is the gradient of the k-th derivative of the output, over k!. Newton's iteration gives the states' series and
doubles the known order; a recurrence gives the variational equations. Source: A. Sedoglavic, "A probabilistic algorithm
to test local algebraic observability in polynomial time", J. Symbolic Computation 33 (2002).

Numbers are balls or, for tapes of + - * / and whole powers, numbers modulo a prime (or a prime's square). At a random
point modulo a prime of 61 bits a nonzero polynomial is zero with a probability of its degree over 2^61. A nonzero value
is certain: a number that is not zero modulo a prime is not zero.
"""

import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from itertools import count
from typing import Any

import flint
from flint import arb, arb_mat, arb_series, ctx, fmpq

from hgogen.rigor.definite import fraction, number
from hgogen.rigor.lookup import Cells, Index, cells_in, next_order, polynomial_value
from hgogen.rigor.tape import Tape

# --- series

BRANCHING = frozenset({"abs", "sign", "heaviside", "floor", "ceiling", "min", "max", "piecewise", "table"})
_BITS, _FINER = 60, 20  # bits of a random number; further bits of its distance to a given one
_SCALES = ((0.5, 2.0), (0.1, 1.0), (-2.0, 2.0), (-1.0, 1.0), (1.0, 10.0), (-10.0, 10.0), (0.001, 0.1), (-0.1, 0.1))


class Undecided(ArithmeticError):
    """The error that balls do not decide a value at a point, because of a pole, the edge of a domain, or a branch
    point."""


def between(low: Fraction, high: Fraction) -> Any:
    """Return the smallest ball that contains the interval [low, high]."""
    return arb(number(low)).union(arb(number(high)))


def magnitude(ball: Any) -> Fraction:
    """Return a rational upper bound of |x| for all x in a ball."""
    return fraction(ball.abs_upper().fmpq())


def random_source(seed: int, name: str) -> random.Random:
    """Return a random number generator for the purpose `name`, reproducible by seed and name."""
    return random.Random(f"{seed} {name}")


@dataclass(frozen=True)
class BallSeries:
    """The arithmetic of power series in t whose coefficients are balls, in the precision of `flint.ctx`; `seed`:
    selects the range of random numbers and their sequence."""

    seed: int

    def draw(self, source: random.Random) -> Any:
        """Return a random ball from the range that the seed selects."""
        low, high = _SCALES[self.seed % len(_SCALES)]
        return low + (high - low) * arb(source.getrandbits(_BITS)) / (1 << _BITS)

    def series(self, coefficients: Sequence[Any], order: int) -> Any:
        """Return the series c_0 + c_1 t + .. of the coefficients, known below t^order."""
        return arb_series(list(coefficients[:order]), prec=order)

    def number(self, value: Fraction, order: int) -> Any:
        """Return a rational as a constant series, known below t^order."""
        return self.series([arb(number(value))], order)

    def constant(self, name: str, order: int) -> Any:
        """Return pi (`name` "pi") or e as a constant series, known below t^order."""
        return self.series([arb.pi() if name == "pi" else arb.const_e()], order)

    def mul(self, a: Any, b: Any, order: int) -> Any:
        """Return the product a b of series below t^order."""
        return a * b if min(a.prec, b.prec) <= order else self.cut(a, order) * self.cut(b, order)

    def cut(self, a: Any, order: int) -> Any:
        """Return the series a without the terms from t^order on."""
        return a if a.prec <= order else arb_series(a.coeffs()[:order], prec=order)

    def is_zero(self, a: Any) -> bool:
        """Return whether a series is exactly zero."""
        return all(c.is_zero() for c in a.coeffs())

    def unary(self, op: str, a: Any, value: Any, order: int) -> tuple[Any, Any]:
        """Return f(a) and f'(a) below t^order; `op`: the name of f, or "power" or "root" for the exponent `value`."""
        a = self.cut(a, order)
        if op == "power" and value < 0:
            inverse = _inverse(a)
            result = _whole(inverse, -value)
            return result, value * result * inverse
        if op == "power":
            less = _whole(a, value - 1) if value > 1 else self.series([1], order)
            return less * a, value * less
        if op == "root":
            inverse = _inverse(a)
            if value.denominator == 2 and value > 0:
                result = a.sqrt() ** value.numerator
            else:
                result = (self.number(value, a.prec) * _positive(a).log()).exp()
            return _finite(result), self.number(value, order) * result * inverse
        if op in _STEPS:
            level, slope = _STEPS[op](a[0])
            return (slope * a if slope else self.series([level], order)), self.series([slope], order)
        result, slope = _FUNCTIONS[op](a)
        return _finite(result), _finite(slope)

    def raised(self, a: Any, b: Any) -> tuple[Any, Any, Any]:
        """Return the series a^b = exp(b log a) and its derivatives by a and by b."""
        log = _positive(a).log()
        result = _finite((b * log).exp())
        return result, b * result * _inverse(a), result * log

    def angle(self, a: Any, b: Any) -> tuple[Any, Any, Any]:
        """Return the series atan2(a, b) and its derivatives by a and by b."""
        square = _inverse(a * a + b * b)
        if b[0].contains(0):
            raise Undecided
        turn = arb.atan2(a[0], b[0]) - (a[0] / b[0]).atan()
        return _finite((a * _inverse(b)).atan() + turn), b * square, -a * square

    def table(self, cells: Cells, order: Index, *arguments: Any) -> tuple[Any, ...]:
        """Return the series of a table's partial derivative of this order, and of its derivatives by each argument.
        Raises: `Undecided` where the arguments may be in several cells."""
        cell = cells.cell([ends(a[0]) for a in arguments])
        if cell is None:
            raise Undecided
        d = [a - arb(number(start)) for a, start in zip(arguments, cells.starts(cell), strict=True)]
        nothing = 0 * sum(d)  # a series of their length
        orders = [order, *(next_order(order, k) for k in range(len(order)))]
        pieces = (cells.of_order(each)[cell] for each in orders)
        return tuple(polynomial_value(piece, d, lambda c: nothing + arb(number(c))) for piece in pieces)

    def less(self, a: Any, b: Any) -> bool:
        """Return whether a < b at t = 0. Raises: `Undecided`."""
        if a[0] < b[0]:
            return True
        if a[0] > b[0] or (a - b)[0].is_zero():
            return False
        raise Undecided

    def equal(self, a: Any, b: Any) -> bool:
        """Return whether a = b at t = 0. Raises: `Undecided`."""
        if (a - b)[0].is_zero():
            return True
        if a[0] != b[0]:
            return False
        raise Undecided

    def coefficients(self, a: Any, order: int) -> list[Any]:
        """Return the first `order` coefficients of a series, padded with zeros. Raises: `Undecided` if not finite."""
        coefficients: list[Any] = a.coeffs()[:order]
        if not all(c.is_finite() for c in coefficients):
            raise Undecided
        return coefficients + [arb(0)] * (order - len(coefficients))

    def matrix(self, rows: int, columns: int, entries: Iterable[Any]) -> Any:
        """Return a FLINT matrix of balls from its entries, row by row."""
        return arb_mat(rows, columns, list(entries))

    @property
    def small_step(self) -> Any:
        """Return a small step d for finite differences: F(x + d v) - F(x) = d F'(x) v up to terms of d^2."""
        return arb(2) ** -(ctx.prec // 2)

    def slope(self, shifted: Any, base: Any) -> Any:
        """Return the ball of F'(x) v = (F(x + d v) - F(x))/d, from `shifted` = F(x + d v), `base` = F(x) and d =
        `small_step`. Its radius is far above the truncation error, unless F'' reaches 2^(bits/8)."""
        return (shifted - base) / self.small_step + arb(0, arb(2) ** -(ctx.prec * 3 // 8))

    def reduced(self, a: Any) -> Any:
        """Return the number unchanged, as balls have no modulus."""
        return a


def _finite(a: Any) -> Any:
    if not all(c.is_finite() for c in a.coeffs()):
        raise Undecided
    return a


def _inverse(a: Any) -> Any:
    if a[0].contains(0):
        raise ZeroDivisionError if a[0].is_zero() else Undecided
    return 1 / a


def _positive(a: Any) -> Any:
    if not a[0] > 0:
        raise Undecided
    return a


def _whole(a: Any, k: int) -> Any:
    result = None
    while k:
        if k & 1:
            result = a if result is None else result * a
        k >>= 1
        a = a * a if k else a
    return result


def _sign(x: Any) -> int:
    if x > 0:
        return 1
    if x < 0:
        return -1
    raise Undecided


def _level(x: Any) -> Any:
    level = x.floor()
    if not level.is_exact() or x.contains_integer():
        raise Undecided
    return level


def ends(a: Any) -> tuple[Fraction, Fraction]:
    """Return the ends of a finite ball as fractions."""
    return fraction(a.lower().fmpq()), fraction(a.upper().fmpq())


def rising(function: Callable[[Any], Any], a: Any) -> Any:
    """Return an increasing function of a ball, from the values at its ends: Arb's result for a wide ball may be far
    wider, or NaN."""
    return function(a.lower()).union(function(a.upper()))


def _hyperbolic(a: Any) -> tuple[Any, Any]:
    e = a.exp()
    return (e - 1 / e) / 2, (e + 1 / e) / 2


def _tanh(a: Any) -> tuple[Any, Any]:
    """Return the power series t = tanh(a) and 1 - t^2 by t' = (1 - t^2) a'. With wide balls a quotient of exponentials
    would fail."""
    x = a.coeffs() or [arb(0)]
    t, fall = [rising(arb.tanh, x[0])], list[Any]()
    for k in range(1, a.prec):
        fall.append(int(k == 1) - sum(t[i] * t[k - 1 - i] for i in range(k)))
        t.append(sum(j * x[j] * fall[k - j] for j in range(1, min(k, len(x) - 1) + 1)) / arb(k))
    series = arb_series(t, prec=a.prec)
    return series, 1 - series * series


def _area(a: Any, sign: int) -> tuple[Any, Any]:
    root = (a * a + sign).sqrt()
    return (a + root).log(), _inverse(root)


_FUNCTIONS: Mapping[str, Callable[[Any], tuple[Any, Any]]] = {
    "exp": lambda a: (a.exp(), a.exp()),
    "log": lambda a: (_positive(a).log(), _inverse(a)),
    "sin": lambda a: (a.sin(), a.cos()),
    "cos": lambda a: (a.cos(), -a.sin()),
    "tan": lambda a: (tan := a.sin() * _inverse(a.cos()), 1 + tan * tan),
    "asin": lambda a: (a.asin(), _inverse((1 - a * a).sqrt())),
    "acos": lambda a: (arb.pi() / 2 - a.asin(), -_inverse((1 - a * a).sqrt())),
    "atan": lambda a: (a.atan(), _inverse(1 + a * a)),
    "sinh": _hyperbolic,
    "cosh": lambda a: _hyperbolic(a)[::-1],
    "tanh": _tanh,
    "asinh": lambda a: _area(a, 1),
    "acosh": lambda a: _area(a, -1),
    "atanh": lambda a: (_positive((1 + a) * _inverse(1 - a)).log() / 2, _inverse(1 - a * a)),
}
# Piecewise constant or linear functions: (level, slope) at a value.
_STEPS: Mapping[str, Callable[[Any], tuple[Any, int]]] = {
    "abs": lambda x: (0, _sign(x)),
    "sign": lambda x: (_sign(x), 0),
    "heaviside": lambda x: ((1 + _sign(x)) // 2, 0),
    "floor": lambda x: (_level(x), 0),
    "ceiling": lambda x: (_level(x) + 1, 0),
}


# --- values at a point

Ball = Any
_NAN = arb("nan")


def values(tape: Tape, point: Sequence[Any], bits: int = 64) -> list[Ball]:
    """Return a tape's outputs as balls at `point`, a number or ball for each symbol; `bits`: the working precision. A
    ball is NaN where the value is undefined or undecided."""
    registers: list[Any] = []
    with ctx.workprec(bits):
        for op, places, value in tape.instructions:
            args = [registers[i] for i in places]
            if op == "symbol":
                result = point[value] if isinstance(point[value], arb) else _rational(point[value])
            elif value is not None:
                result = _NUMBERED[op](args, value)
            else:
                result = _BALL_RULES[op](*args) if op in _BALL_RULES else _NAN
            registers.append(_NAN if isinstance(result, arb) and not result.is_finite() else result)
    return [registers[i] if isinstance(registers[i], arb) else _NAN for i in tape.outputs]


def _rational(value: Fraction) -> Ball:
    return arb(number(value))


def _whole_power(base: Ball, exponent: int) -> Ball:
    if exponent > 0 and base.mid().is_zero():
        return _whole(base, exponent)  # FLINT's own power of a ball around exactly 0 is NaN
    return base**exponent if exponent >= 0 or not base.contains(0) else _NAN


def _ball_sign(a: Ball) -> Ball:
    return arb(1) if a > 0 else arb(-1) if a < 0 else arb(0) if a.is_zero() else _NAN


def _norm(*parts: Ball) -> Ball:
    return sum((a * a for a in parts), start=arb(0)).sqrt() if all(a.is_finite() for a in parts) else _NAN


def _ball_root(args: Sequence[Ball], exponent: Fraction) -> Ball:
    root = args[0].root(exponent.denominator) if args[0] >= 0 else _NAN
    return _whole_power(root, exponent.numerator)


def _ball_direction(parts: Sequence[Ball], index: int) -> Ball:
    """Return e_i/|e| for a vector of balls e (`parts`) and i = `index`; NaN where e may be 0."""
    if len(parts) == 1:
        return _NAN if parts[0].contains(0) else _ball_sign(parts[0])
    size = _norm(*parts)
    return parts[index] / size if size > 0 else _NAN


def _step(a: Ball, at_zero: Ball = None) -> Ball:
    """Return the unit step of a; its value at a = 0 is `at_zero`, by default SymPy's 1/2."""
    middle = arb(fmpq(1, 2)) if at_zero is None else at_zero
    return arb(1) if a > 0 else arb(0) if a < 0 else middle if a.is_zero() else _NAN


def _ball_table(place: Sequence[Ball], derivative: tuple[Cells, Index]) -> Ball:
    if not all(a.is_finite() for a in place):
        return _NAN
    cells, order = derivative
    spans = cells.overlapped(list(map(ends, place)))
    if not all(cells.continuous(spans, order)):
        return _NAN
    values, pieces = [], cells.of_order(order)
    for cell in cells_in(spans):
        d = [a - _rational(start) for a, start in zip(place, cells.starts(cell), strict=True)]
        values.append(polynomial_value(pieces[cell], d, _rational))
    return reduce(arb.union, values)


def _rounded(a: Ball, value: Ball) -> Ball:
    return value if a.is_finite() and value.is_exact() else _NAN


def _equal(a: Ball, b: Ball) -> bool | None:
    return False if a < b or a > b else True if a.is_exact() and b.is_exact() and a == b else None


def _not(a: bool | None) -> bool | None:
    return None if a is None else not a


def _both(a: bool | None, b: bool | None) -> bool | None:
    return False if a is False or b is False else None if a is None or b is None else True


def _first_piece(*parts: Any) -> Ball:
    for value, condition in zip(parts[::2], parts[1::2], strict=True):
        if condition is None:
            return _NAN
        if condition:
            return value
    return _NAN


_NUMBERED: dict[str, Callable[[Sequence[Ball], Any], Ball]] = {  # of arguments and the value of an instruction
    "number": lambda _, number: _rational(number),
    "constant": lambda _, name: arb.pi() if name == "pi" else arb(1).exp(),
    "power": lambda args, n: _whole_power(args[0], n),
    "root": _ball_root,
    "direction": _ball_direction,
    "table": _ball_table,
}
_BALL_RULES: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "mul": lambda a, b: a * b,
    "min": lambda a, b: a.min(b) if a.is_finite() and b.is_finite() else _NAN,
    "max": lambda a, b: a.max(b) if a.is_finite() and b.is_finite() else _NAN,
    "raise": lambda base, exponent: (exponent * base.log()).exp() if base > 0 else _NAN,
    "exp": arb.exp,
    "log": lambda a: a.log() if a > 0 else _NAN,
    "abs": abs,
    "norm": _norm,
    "sign": _ball_sign,
    "heaviside": _step,
    "atan2": lambda y, x: arb.atan2(y, x) if x > 0 or y > 0 or y < 0 else _NAN,
    "floor": lambda a: _rounded(a, a.floor()),
    "ceiling": lambda a: _rounded(a, a.ceil()),
    "less": lambda a, b: True if a < b else False if a >= b else None,
    "less_equal": lambda a, b: True if a <= b else False if a > b else None,
    "equal": _equal,
    "unequal": lambda a, b: _not(_equal(a, b)),
    "not": _not,
    "and": _both,
    "or": lambda a, b: _not(_both(_not(a), _not(b))),
    "true": lambda: True,
    "false": lambda: False,
    "piecewise": _first_piece,
    **{name: getattr(arb, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")},
    **{name: getattr(arb, name) for name in ("asinh", "acosh", "atanh")},
}


# --- modulo a prime

OPERATIONS = frozenset({"symbol", "number", "constant", "add", "mul", "power"})


@dataclass(frozen=True)
class ModularSeries:
    """The arithmetic of power series in t whose coefficients are integers modulo `modulus`, a power of `prime`.

    A division by zero modulo the prime raises `ZeroDivisionError`: another point may succeed. A constant, pi or e, is a
    random number: it is transcendental, and an expression over the rationals vanishes at it only identically.
    """

    modulus: int
    prime: int
    seed: int

    def draw(self, source: random.Random) -> int:
        """Return a random number from 1 to prime - 1."""
        return source.randrange(1, self.prime)

    def series(self, coefficients: Sequence[int], order: int) -> Any:
        """Return the series c_0 + c_1 t + .. of the coefficients, known below t^order."""
        return flint.nmod_poly(list(coefficients[:order]), self.modulus)

    def number(self, value: Fraction, order: int) -> Any:
        """Return a rational modulo `modulus` as a constant series. Raises: `ZeroDivisionError` for a denominator that
        is 0 modulo the prime."""
        if value.denominator % self.prime == 0:
            raise ZeroDivisionError
        return self.series([value.numerator * pow(value.denominator, -1, self.modulus) % self.modulus], order)

    def constant(self, name: str, order: int) -> Any:
        """Return a random constant series in place of pi or e, reproducible by the name."""
        return self.series([self.draw(random_source(self.seed, f"constant {name}"))], order)

    def mul(self, a: Any, b: Any, order: int) -> Any:
        """Return the product a b of series below t^order."""
        return a.mul_low(b, order)

    def is_zero(self, a: Any) -> bool:
        """Return whether a series is zero."""
        return bool(a.is_zero())

    def unary(self, op: str, a: Any, value: Any, order: int) -> tuple[Any, Any]:
        """Return the series a^value and its derivative by a below t^order; `op`: "power"."""
        assert op == "power"
        if value < 0:
            if a[0] == 0 or int(a[0]) % self.prime == 0:
                raise ZeroDivisionError
            inverse = a.inverse_series_trunc(order)
            result = inverse.pow_trunc(-value, order)
            return result, value * result.mul_low(inverse, order)
        less = a.pow_trunc(value - 1, order) if value > 1 else self.series([1], order)
        return less.mul_low(a, order), value * less

    def coefficients(self, a: Any, order: int) -> list[int]:
        """Return the first `order` coefficients of a series, padded with zeros."""
        coefficients = [int(c) for c in a.coeffs()[:order]]
        return coefficients + [0] * (order - len(coefficients))

    def matrix(self, rows: int, columns: int, entries: Iterable[int]) -> Any:
        """Return a FLINT matrix modulo `modulus` from its entries, row by row."""
        return flint.nmod_mat(rows, columns, list(entries), self.modulus)

    @property
    def small_step(self) -> int:
        """Return a step d with d^2 = 0 modulo prime^2, so that F(x + d v) - F(x) = d F'(x) v exactly."""
        return self.prime

    def slope(self, shifted: Any, base: Any) -> int:
        """Return F'(x) v modulo the prime, from F(x + d v) = `shifted` and F(x) = `base` modulo prime^2, d = prime."""
        return (int(shifted) - int(base)) % self.modulus // self.prime

    def reduced(self, a: Any) -> int:
        """Return the number a modulo the prime."""
        return int(a) % self.prime


# --- the plant

Arithmetic = ModularSeries | BallSeries
Gradient = Mapping[int, Any]


@dataclass(frozen=True)
class Plant:
    """A plant x' = f, y = h as a tape with the outputs f, then h; its symbols are n states, q parameters, m inputs,
    then constants.

    `places`: values of the symbols near which real points are drawn; without any they are drawn anywhere. `discrete`:
    the plant is x+ = f, and inputs at different samples are independent. `constraints`: a tape of functions that are 0
    along every motion and at every point. `times`: the indices of the inputs that are times; all have one value,
    between 0 and 1 for balls, and the rate 1.
    """

    tape: Tape
    n: int
    q: int
    m: int
    places: tuple[tuple[Fraction, ...], ...] = ()
    discrete: bool = False
    constraints: Tape | None = None
    times: tuple[int, ...] = ()

    @property
    def wide(self) -> int:
        """Return n + q, the number of columns of the sensitivities d/d(x_0, p), p the parameters."""
        return self.n + self.q

    @property
    def outputs(self) -> int:
        """Return the number of outputs of the tape after the n right-hand sides."""
        return len(self.tape.outputs) - self.n


@dataclass(frozen=True)
class Point:
    """An initial point of a plant's power series: `states` and `constants` (parameters first) at t = 0; `inputs(j,
    order)`: the coefficients of input j below t^order."""

    states: tuple[Any, ...]
    constants: tuple[Any, ...]
    inputs: Callable[[int, int], list[Any]]


def random_point(plant: Plant, numbers: Arithmetic) -> Point:
    """Return a random initial point with random input derivatives; for balls it is near one of the plant's `places`, if
    any."""
    source = random_source(numbers.seed, "point")
    if isinstance(numbers, BallSeries) and plant.places:
        # near each value, by less than a millionth of it
        place = source.choice(plant.places)
        point = [number(v) * (1 + arb(source.getrandbits(_BITS)) / (1 << _BITS + _FINER)) for v in place]
    else:
        point = [numbers.draw(source) for _ in plant.tape.symbols]
    forced = point[plant.n : plant.n + plant.m]
    for j in plant.times[1:]:
        forced[j] = forced[plant.times[0]]

    def inputs(j: int, order: int) -> list[Any]:
        source = random_source(numbers.seed, f"input {j}")
        if j in plant.times:
            return [forced[j], 1, *(0 for _ in range(order - 2))][:order]
        return [forced[j], *(numbers.draw(source) for _ in range(order - 1))]

    return Point(tuple(point[: plant.n]), tuple(point[plant.n + plant.m :]), inputs)


def gradients(plant: Plant, numbers: Arithmetic, point: Point) -> Iterator[list[Any]]:
    """Yield, without end, lists of the next matrices Y_0, Y_1, .. (p x (n + q)), Y_k = d(y^(k)/k!)/d(x_0, parameters);
    the first K of them cost about K^2. For a discrete plant Y_k is the gradient of y at sample k.

    Raises: `ZeroDivisionError`, `Undecided` where the series do not exist at this point.
    """
    if plant.discrete:
        yield from _sampled_gradients(plant, numbers, point)
        return
    known = 1
    states = [[value] for value in point.states]
    unit = (int(i == j) for i in range(plant.n) for j in range(plant.wide))
    phi = [numbers.matrix(plant.n, plant.wide, unit)]
    rates: tuple[list[Any], list[Any]] = ([], [])  # Taylor coefficients of [df/dx], [0 | df/dp]
    while True:
        order = 2 * known
        inputs = [point.inputs(j, order) for j in range(plant.m)]
        symbols = [*states, *inputs, *([value] for value in point.constants)]
        rows = evaluate(plant, numbers, [numbers.series(x, order) for x in symbols], order, known)
        flow, output = rows[: plant.n], rows[plant.n :]
        for target, new in zip(rates, _split(flow, plant, numbers, known), strict=True):
            target[:] = new
        slopes, forced = _split(output, plant, numbers, known)
        moving, read = _present(rates[0]), _present(slopes)
        while len(phi) < known:
            phi.append(_row(phi, moving, rates[1], len(phi) - 1) / len(phi))
        yield [_row(phi, read, forced, k) for k in range(known // 2 if known > 1 else 0, known)]
        states = _newton(states, flow, rates[0], numbers, known)
        known = order


def _sampled_gradients(plant: Plant, numbers: Arithmetic, point: Point) -> Iterator[list[Any]]:
    """Yield [d y_k/d(x_0, p)] for k = 0, 1, .., x_(k+1) = f(x_k, u_k, p), y_k = h(x_k, u_k, p)."""
    states = list(point.states)
    unit = (int(i == j) for i in range(plant.n) for j in range(plant.wide))
    phi = numbers.matrix(plant.n, plant.wide, unit)
    for k in count():
        inputs = [point.inputs(j, k + 1)[k] for j in range(plant.m)]
        at = [numbers.series([value], 1) for value in (*states, *inputs, *point.constants)]
        rows = evaluate(plant, numbers, at, 1, 1)
        flow, output = (_split(part, plant, numbers, 1) for part in (rows[: plant.n], rows[plant.n :]))
        (F,), (of_parameters,) = flow
        (C,), (read,) = output
        yield [C * phi + read]
        phi = F * phi + of_parameters
        states = [numbers.coefficients(value, 1)[0] for value, _ in rows[: plant.n]]


def first_gradients(plant: Plant, numbers: Arithmetic, point: Point, size: int) -> list[Any]:
    """Return the first `size` matrices Y_k = d(y^(k)/k!)/d(x_0, parameters) (p x (n + q)), y the outputs."""
    first: list[Any] = []
    for matrices in gradients(plant, numbers, point):
        first += matrices
        if len(first) >= size:
            break
    return first[:size]


def evaluate(
    plant: Plant, numbers: Arithmetic, values: Sequence[Any], order: int, slope_order: int
) -> list[tuple[Any, Gradient]]:
    """Return the outputs of the plant's tape for the series `values` of its symbols: for each output its series below
    t^order, and its gradient by states and parameters, a series below t^slope_order for each index."""
    one = numbers.series([1], slope_order)
    wanted = {k: k for k in range(plant.n)} | {plant.n + plant.m + k: plant.n + k for k in range(plant.q)}
    done: list[Any] = []
    for op, args, value in plant.tape.instructions:
        if op == "symbol":
            assert isinstance(value, int)
            done.append((values[value], {wanted[value]: one} if value in wanted else {}))
        elif op in _RULES:
            done.append(_RULES[op](numbers, [done[a] for a in args], value, order, slope_order))
        else:
            inner, slopes = done[args[0]]
            result, slope = numbers.unary(op, inner, value, order)
            done.append((result, _scaled(numbers, slopes, slope, slope_order)))
    return [done[k] for k in plant.tape.outputs]


def _scaled(numbers: Arithmetic, slopes: Gradient, factor: Any, order: int) -> Gradient:
    if not slopes or numbers.is_zero(factor):
        return {}
    return {k: numbers.mul(slope, factor, order) for k, slope in slopes.items()}


def _sum(a: Gradient, b: Gradient) -> Gradient:
    if not a or not b:
        return a or b
    total = dict(a)
    for k, slope in b.items():
        total[k] = total[k] + slope if k in total else slope
    return total


def _mul(numbers: Arithmetic, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    (a, da), (b, db) = parts
    slopes = _sum(_scaled(numbers, da, b, slope_order), _scaled(numbers, db, a, slope_order))
    return numbers.mul(a, b, order), slopes


def _several(method: str) -> Callable[..., Any]:
    def rule(numbers: BallSeries, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
        result, *rates = getattr(numbers, method)(*(value or ()), *(numbers.cut(a, order) for a, _ in parts))
        terms = (_scaled(numbers, slopes, rate, slope_order) for (_, slopes), rate in zip(parts, rates, strict=True))
        return result, reduce(_sum, terms)

    return rule


def _piecewise(numbers: BallSeries, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    for result, (condition, _) in zip(parts[::2], parts[1::2], strict=True):
        if condition:
            return result
    raise ZeroDivisionError  # no piece holds here: undefined


_RULES: Mapping[str, Callable[..., Any]] = {
    "number": lambda numbers, parts, value, order, _: (numbers.number(value, order), {}),
    "constant": lambda numbers, parts, value, order, _: (numbers.constant(value, order), {}),
    "add": lambda numbers, parts, *_: (parts[0][0] + parts[1][0], _sum(parts[0][1], parts[1][1])),
    "mul": _mul,
    "raise": _several("raised"),
    "atan2": _several("angle"),
    "table": _several("table"),
    "min": lambda numbers, parts, *_: parts[0 if numbers.less(parts[0][0], parts[1][0]) else 1],
    "max": lambda numbers, parts, *_: parts[1 if numbers.less(parts[0][0], parts[1][0]) else 0],
    "piecewise": _piecewise,
    "less": lambda numbers, parts, *_: (numbers.less(parts[0][0], parts[1][0]), {}),
    "less_equal": lambda numbers, parts, *_: (not numbers.less(parts[1][0], parts[0][0]), {}),
    "equal": lambda numbers, parts, *_: (numbers.equal(parts[0][0], parts[1][0]), {}),
    "unequal": lambda numbers, parts, *_: (not numbers.equal(parts[0][0], parts[1][0]), {}),
    "and": lambda numbers, parts, *_: (parts[0][0] and parts[1][0], {}),
    "or": lambda numbers, parts, *_: (parts[0][0] or parts[1][0], {}),
    "not": lambda numbers, parts, *_: (not parts[0][0], {}),
    "true": lambda *_: (True, {}),
    "false": lambda *_: (False, {}),
}


def _split(rows: Sequence[Any], plant: Plant, numbers: Arithmetic, order: int) -> tuple[list[Any], list[Any]]:
    by_states = [[0] * (len(rows) * plant.n) for _ in range(order)]
    by_parameters = [[0] * (len(rows) * plant.wide) for _ in range(order)]
    for i, (_, slopes) in enumerate(rows):
        for k, slope in slopes.items():
            matrices, at = (by_states, i * plant.n + k) if k < plant.n else (by_parameters, i * plant.wide + k)
            for matrix, coefficient in zip(matrices, numbers.coefficients(slope, order), strict=True):
                matrix[at] = coefficient
    return (
        [numbers.matrix(len(rows), plant.n, entries) for entries in by_states],
        [numbers.matrix(len(rows), plant.wide, entries) for entries in by_parameters],
    )


def _present(slopes: list[Any]) -> dict[int, Any]:
    """Return the coefficients that are not 0, by index; for a linear plant only the first one remains."""
    return {j: slope for j, slope in enumerate(slopes) if slope != 0 * slope}


def _row(phi: list[Any], slopes: dict[int, Any], forced: list[Any], k: int) -> Any:
    """Return coefficient k of the matrix power series slopes(t) phi(t) + forced(t)."""
    return sum((slope * phi[k - j] for j, slope in slopes.items() if j <= k), start=forced[k])


def _newton(
    states: list[list[Any]], flow: Sequence[Any], slopes: list[Any], numbers: Arithmetic, known: int
) -> list[list[Any]]:
    """Return the Taylor series of the states below t^(2 known), from `states` below t^known, by Newton's method: x + d
    with d' = df/dx d + (f(x) - x'), d = 0 below t^known."""
    n = len(states)
    full = [numbers.coefficients(value, 2 * known - 1) for value, _ in flow]
    correction: dict[int, Any] = {}
    for k in range(known - 1, 2 * known - 1):
        residual = [full[i][k] - ((k + 1) * states[i][k + 1] if k + 1 < known else 0) for i in range(n)]
        total = numbers.matrix(n, 1, residual)
        for j in range(k - known + 1):
            total = total + slopes[j] * correction[k - j]
        correction[k + 1] = total / (k + 1)
    tail = [correction[k].entries() for k in range(known, 2 * known)]
    return [row + [entries[i] for entries in tail] for i, row in enumerate(states)]
