"""Power series in t of a plant's states, outputs and variational equations at a random point.

    x' = f(x, u),  y = h(x, u),  p' = 0         u: power series with random coefficients, so all derivatives are free
    Phi' = df/dx Phi + [0 | df/dp],  Phi(0) = [I | 0]
    dy/d(x_0, p) = dh/dx Phi + [0 | dh/dp] = sum_k Y_k t^k

Y_k is the gradient of the k-th derivative of the output, over k!. The states' series is found by Newton's iteration,
which doubles the known order; the variational equations by recurrence. A. Sedoglavic, "A probabilistic algorithm to
test local algebraic observability in polynomial time", J. Symbolic Computation 33 (2002).

Numbers are balls, or of tapes of + - * / and whole powers modulo a prime (or a prime's square): a random point modulo a
prime of 61 bits tells a polynomial that is not zero from zero but for a chance of its degree over 2^61. A nonzero value
is certain: what is not zero modulo a prime is not zero.
"""

import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any

import flint

from hgogen.rigor.balls import Balls, draws
from hgogen.rigor.tape import Tape

# --- modulo a prime

OPERATIONS = frozenset({"symbol", "number", "constant", "add", "mul", "power"})


@dataclass(frozen=True)
class Modular:
    """Series with coefficients modulo `modulus`, of which `prime` is the one prime factor.

    A division by what is zero modulo the prime raises `ZeroDivisionError`: another point may do. A constant, pi or e,
    is a random number: it is transcendental, and an expression over the rationals vanishes at it only identically.
    """

    modulus: int
    prime: int
    seed: int

    def draw(self, source: random.Random) -> int:
        """A random number, not zero modulo the prime."""
        return source.randrange(1, self.prime)

    def series(self, coefficients: Sequence[int], order: int) -> Any:
        """c_0 + c_1 t + ... , known below t^order."""
        return flint.nmod_poly(list(coefficients[:order]), self.modulus)

    def number(self, value: Fraction, order: int) -> Any:
        """A rational as a series."""
        if value.denominator % self.prime == 0:
            raise ZeroDivisionError
        return self.series([value.numerator * pow(value.denominator, -1, self.modulus) % self.modulus], order)

    def constant(self, name: str, order: int) -> Any:
        """A transcendental constant as a series."""
        return self.series([self.draw(draws(self.seed, f"constant {name}"))], order)

    def mul(self, a: Any, b: Any, order: int) -> Any:
        """a b below t^order."""
        return a.mul_low(b, order)

    def cut(self, a: Any, order: int) -> Any:
        """a below t^order."""
        return a.truncate(order)

    def nothing(self, a: Any) -> bool:
        """Whether the series is known to be zero."""
        return bool(a.is_zero())

    def unary(self, op: str, a: Any, value: Any, order: int) -> tuple[Any, Any]:
        """(f(a), f'(a)) below t^order, for f the whole power `value`."""
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
        """The first `order` coefficients of a series, padded with zeros."""
        coefficients = [int(c) for c in a.coeffs()[:order]]
        return coefficients + [0] * (order - len(coefficients))

    def matrix(self, rows: int, columns: int, entries: Iterable[int]) -> Any:
        """A matrix from its entries, row by row."""
        return flint.nmod_mat(rows, columns, list(entries), self.modulus)

    def over(self, k: int) -> int:
        """1/k."""
        return pow(k, -1, self.modulus)

    @property
    def nudge(self) -> int:
        """A step d whose square is zero modulo prime^2, so that F(x + d v) - F(x) = d F'(x) v exactly."""
        return self.prime

    def slope(self, moved: Any, base: Any) -> int:
        """F'(x) v modulo the prime, from F(x + d v) and F(x) modulo prime^2."""
        return (int(moved) - int(base)) % self.modulus // self.prime

    def reduced(self, a: Any) -> int:
        """The number modulo the prime."""
        return int(a) % self.prime


# --- the plant

Arithmetic = Modular | Balls
Gradient = Mapping[int, Any]


@dataclass(frozen=True)
class Plant:
    """A tape of flow then output whose symbols are n states, q parameters, m inputs, then constants.

    `places`: values of the symbols near which real points are taken; without any they may be anywhere.
    """

    tape: Tape
    n: int
    q: int
    m: int
    places: tuple[tuple[Fraction, ...], ...] = ()

    @property
    def wide(self) -> int:
        """Directions of the variational equations: states and parameters."""
        return self.n + self.q

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.tape.outputs) - self.n


@dataclass(frozen=True)
class Point:
    """The point at which the series start: `states` and `constants` (parameters, then the rest) at t = 0, and the
    `inputs` as series."""

    states: tuple[Any, ...]
    constants: tuple[Any, ...]
    inputs: Callable[[int, int], list[Any]]


def random_point(plant: Plant, numbers: Arithmetic) -> Point:
    """A random point, of balls near one of the plant's places, with inputs whose derivatives are all random."""
    source = draws(numbers.seed, "point")
    if isinstance(numbers, Balls) and plant.places:
        point = [numbers.near(value, source) for value in source.choice(plant.places)]
    else:
        point = [numbers.draw(source) for _ in plant.tape.symbols]
    forced = point[plant.n : plant.n + plant.m]

    def inputs(j: int, order: int) -> list[Any]:
        source = draws(numbers.seed, f"input {j}")
        return [forced[j], *(numbers.draw(source) for _ in range(order - 1))]

    return Point(tuple(point[: plant.n]), tuple(point[plant.n + plant.m :]), inputs)


def gradients(plant: Plant, numbers: Arithmetic, point: Point) -> Iterator[list[Any]]:
    """The matrices Y_0, Y_1, ... (p x (n + q)), without end; the work for K of them is of order K^2.

    Raises: `ZeroDivisionError`, `Undecided` where the series do not exist at this point.
    """
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
        slopes = _split(output, plant, numbers, known)
        while len(phi) < known:
            phi.append(_row(phi, *rates, len(phi) - 1) * numbers.over(len(phi)))
        yield [_row(phi, *slopes, k) for k in range(known // 2 if known > 1 else 0, known)]
        states = _newton(states, flow, rates[0], numbers, known)
        known = order


def first_gradients(plant: Plant, numbers: Arithmetic, point: Point, count: int) -> list[Any]:
    """The first `count` gradients Y_0, .., Y_(count - 1) of the outputs' derivatives."""
    first: list[Any] = []
    for matrices in gradients(plant, numbers, point):
        first += matrices
        if len(first) >= count:
            break
    return first[:count]


def evaluate(
    plant: Plant, numbers: Arithmetic, values: Sequence[Any], order: int, slope_order: int
) -> list[tuple[Any, Gradient]]:
    """Each output of the tape as a series below t^order, its gradient by states and parameters below t^slope_order."""
    one = numbers.series([1], slope_order)
    wanted = {k: k for k in range(plant.n)} | {plant.n + plant.m + k: plant.n + k for k in range(plant.q)}
    done: list[Any] = []
    for instruction in plant.tape.instructions:
        op, args, value = instruction
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
    if not slopes or numbers.nothing(factor):
        return {}
    mul = numbers.mul
    return {k: mul(slope, factor, order) for k, slope in slopes.items()}


def _sum(a: Gradient, b: Gradient) -> Gradient:
    if not a or not b:
        return a or b
    total = dict(a)
    for k, slope in b.items():
        total[k] = total[k] + slope if k in total else slope
    return total


def _add(numbers: Arithmetic, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    (a, da), (b, db) = parts
    return a + b, _sum(da, db)


def _mul(numbers: Arithmetic, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    (a, da), (b, db) = parts
    slopes = _sum(_scaled(numbers, da, b, slope_order), _scaled(numbers, db, a, slope_order))
    return numbers.mul(a, b, order), slopes


def _two(method: str) -> Callable[..., Any]:
    def rule(numbers: Balls, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
        (a, _), (b, _) = parts
        result, *rates = getattr(numbers, method)(a, b, order)
        return result, _chain(numbers, parts, rates, slope_order)

    return rule


def _table(numbers: Balls, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    result, *rates = numbers.table([numbers.cut(a, order) for a, _ in parts], *value)
    return result, _chain(numbers, parts, rates, slope_order)


def _chain(numbers: Balls, parts: list[Any], rates: list[Any], order: int) -> Gradient:
    """The gradient by the derivatives by each part."""
    terms = (_scaled(numbers, slopes, rate, order) for (_, slopes), rate in zip(parts, rates, strict=True))
    return reduce(_sum, terms)


def _piecewise(numbers: Balls, parts: list[Any], value: Any, order: int, slope_order: int) -> Any:
    for result, (condition, _) in zip(parts[::2], parts[1::2], strict=True):
        if condition:
            return result
    raise ZeroDivisionError  # no piece holds here: undefined


_RULES: Mapping[str, Callable[..., Any]] = {
    "number": lambda numbers, parts, value, order, _: (numbers.number(value, order), {}),
    "constant": lambda numbers, parts, value, order, _: (numbers.constant(value, order), {}),
    "add": _add,
    "mul": _mul,
    "raise": _two("raised"),
    "atan2": _two("angle"),
    "table": _table,
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
    """Taylor coefficients of the gradient: by states (rows x n), and [0 | by parameters] (rows x (n + q))."""
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


def _row(phi: list[Any], slopes: list[Any], forced: list[Any], k: int) -> Any:
    """The coefficient k of slopes * phi + forced."""
    total = forced[k]
    for j in range(k + 1):
        total = total + slopes[j] * phi[k - j]
    return total


def _newton(
    states: list[list[Any]], flow: Sequence[Any], slopes: list[Any], numbers: Arithmetic, known: int
) -> list[list[Any]]:
    """The states to twice the order: x + d, d' = df/dx d + (f(x) - x'), d = 0 below t^known."""
    n = len(states)
    full = [numbers.coefficients(value, 2 * known - 1) for value, _ in flow]
    correction: dict[int, Any] = {}
    for k in range(known - 1, 2 * known - 1):
        residual = [full[i][k] - ((k + 1) * states[i][k + 1] if k + 1 < known else 0) for i in range(n)]
        total = numbers.matrix(n, 1, residual)
        for j in range(k - known + 1):
            total = total + slopes[j] * correction[k - j]
        correction[k + 1] = total * numbers.over(k + 1)
    tail = [correction[k].entries() for k in range(known, 2 * known)]
    return [row + [entries[i] for entries in tail] for i, row in enumerate(states)]
