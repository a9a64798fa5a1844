"""A call's program as a certificate lists it: its equality with a step of the observer, and bounds of its rounding
errors.

A running error analysis bounds the difference between a computed number and its value in exact arithmetic.

Each value v of exact arithmetic is in an interval, and |v~ - v| <= e for its computed value v~. Rounding to nearest
adds at most u |v~|, u = 2^-24 or 2^-53, and `tiny`, the smallest normal number, at an underflow:

    v = a +- b  e = e_a + e_b                           v = a b    e = |a| e_b + |b| e_a + e_a e_b
    v = a / b   e = (e_a + |v| e_b)/(|b| - e_b)         v = f(a)   e = sup|f'| e_a
    each        + k (u (|v| + e) + tiny)

k is 1 for these operations, 0 for exact ones: -a, |a|, min, max, products with 1 and 2, integers up to 2^24. Another
constant is rounded 8 times as a double, and once more. For functions k is twice the largest measured error of a
program's functions: no arithmetic here proves it. Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms,
2nd ed., 2002, section 3.3.

The statements of the program are compared with a step of a method on an observer's equation.

    x1, ..   the elements of the fields      y1_last, y1, ..   samples, of the last call and of this one
    v1, ..   the statements                  u1_last, u1, ..   inputs likewise

A statement is an operation with operands: a name, a number, an expression of numbers, or an earlier statement. The
equation in the observer's own fields is built from the plant of the certificate and its numbers:

    of a gain    z' = A z + b(clamped z + N v, u) + S^-1 theta B v,                v_j = theta^-late (y_j - h_j(z, u))
    of a core    e' = theta (N e + B v + sum over saturations of onto (sat e_j - e_j)) + s_i b_i(clamped z, u)

S is the diagonal of scale and powers of theta, e_k = r_k x_k for a field x_k of a chain of integrators, v = y - o(u). b
acts on the rows of the fields that estimate states, with their s_i. The argument of b is clamped to the ranges; a
saturation clamps a field to the range of the state that it estimates. The step

    X_i = x + h sum_j a_ij k_j,   k_i = f(X_i, y_i, u_i),   x+ = x + h sum_i b_i k_i

equals the program in exact arithmetic, stage by stage, up to the rounding of its constants: the deviation of a
statement is a quotient in earlier values.

The sizes of the rounding errors follow from these statements.

The error of the program in its precision is computed while the plant is in its ranges and the error of each field
within a bound, in pieces of the ranges of the measured states. All shares together are at most that bound: an error
caused by inputs only never exceeds it.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from itertools import pairwise, product
from typing import Any

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Arithmetic, Dual, Undefined, Unproved, dual, evaluate
from .box import End
from .context import Context, applied, inner, printed
from .file import column, entries, part
from .inclusion import ErrorInclusion
from .inequality import Tableau
from .interval import Interval, between, hull, intervals, point
from .plant_motion import demand_keys, demand_speeds
from .text import HIGHEST, ONE_ARGUMENT, OPERATIONS, Expression, Unreadable, expression, is_number, number

_NO_ERROR, _ONE = point(Fraction(0)), point(Fraction(1))
_WHOLE = 2**24
_FOLDED = Fraction(8, 2**53) * (
    1 + Fraction(1, 2**40)
)  # error of a folded constant before its rounding to the precision
_BITS = {"float": (24, 126), "double": (53, 1022)}  # of u and of the smallest normal number
_ANGLE = Fraction(200)  # largest angle of the measured sin, cos and tan
UNITS: Mapping[str, Fraction] = {  # error bound in u: twice the measured ulps, an ulp is at most 2 u
    **{name: Fraction(8) for name in ("sqrt", "exp", "log", "sin", "cos", "asin", "acos", "atan", "cosh")},
    **{name: Fraction(14) for name in ("tanh", "asinh", "acosh", "atanh")},
    "tan": Fraction(16),
    "sinh": Fraction(10),
}
POWER = Fraction(6), Fraction(8)  # the same for x^k: a constant, and a multiple of k |log x|
PRECISIONS = tuple(_BITS)


@dataclass(frozen=True)
class Computed:
    """A value of a program in the precision `real`, "float" or "double". `value`: an interval that contains the exact
    value; `error`: an interval whose upper end bounds |computed - exact|; `number`: the value if the program has it
    exactly, else None."""

    real: str
    value: Interval
    error: Interval = _NO_ERROR
    number: Fraction | None = None

    @property
    def around(self) -> Interval:
        """The interval of both the exact and the computed value: `value` widened by `error`."""
        return self.value + _both(self.error)

    def widened(self, size: Interval) -> "Computed":
        """Return the value with an additional error of at most `size`."""
        return Computed(self.real, self.value + _both(size), self.error + size)

    def __add__(self, other: "Computed") -> "Computed":
        if self.number == 0 or other.number == 0:
            return other if self.number == 0 else self
        return self.rounded(self.value + other.value, self.error + other.error)

    def __sub__(self, other: "Computed") -> "Computed":
        return self.rounded(self.value - other.value, self.error + other.error)

    def __neg__(self) -> "Computed":
        return Computed(self.real, -self.value, self.error, None if self.number is None else -self.number)

    def __mul__(self, other: "Computed") -> "Computed":
        for one, factor in ((self, other), (other, self)):
            if factor.number in (1, 2):
                return self.rounded(factor.value * one.value, factor.value * one.error, Fraction(0))
        a, b = _size(self.value), _size(other.value)
        value = intervals.power(self.value, 2) if self is other else self.value * other.value
        return self.rounded(value, a * other.error + b * self.error + self.error * other.error)

    def __truediv__(self, other: "Computed") -> "Computed":
        value = self.value / other.value
        return self.rounded(value, (self.error + _size(value) * other.error) / _size(other.around))

    def rounded(self, value: Interval, inherited: Interval, units: Fraction = Fraction(1)) -> "Computed":
        """Return the result of an operation from its exact `value`, the error `inherited` from the operands, and a
        rounding error of `units` times u = 2^-24 or 2^-53. Raises: `Undefined` if it may overflow."""
        bits, normal = _BITS[self.real]
        share, whole = units / 2**bits, _size(value) + inherited
        error = inherited + point(share * (1 + 2 * share * (units > 1))) * whole + point(units / 2**normal)
        if not (error.finite and (whole + error).at_most(Fraction(2) ** (normal + 1))):
            raise Undefined("a value that may overflow")
        return Computed(self.real, value, error)

    def through(self, name: str, units: Fraction) -> "Computed":
        """Return f(value) for the library function f = `name`, whose error is at most `units` times u."""
        slope = dual(intervals).function(name, (Dual(self.around, {0: _ONE}),)).slopes[0]
        return self.rounded(intervals.function(name, (self.value,)), _size(slope) * self.error, units)


def _size(value: Interval) -> Interval:
    size: Interval = intervals.function("Abs", (value,))
    return size


def _by_power(x: Interval, exponent: Fraction | int) -> Fraction:
    """Return a bound of the rounding error of x^exponent, in units of u = 2^-24 or 2^-53."""
    least, each = map(point, POWER)
    steep = least + each * point(abs(Fraction(exponent))) * _size(intervals.function("log", (x,)))
    high = steep.exactly[1]
    if not isinstance(high, Fraction):
        raise Undefined("a power whose error has no bound")
    return high


def _both(error: Interval) -> Interval:
    return hull(-error, error)


def constant(real: str, text: Expression) -> Computed:
    """Return an expression without names as a constant of a program in the precision `real`. Raises: `Undefined`."""
    value: Interval = evaluate(text, {}, intervals)
    return Computed(real, value).rounded(value, _size(value) * point(_FOLDED))


def precision(real: str) -> Arithmetic:
    """Return the arithmetic of a program in the precision `real`, one of `PRECISIONS`."""

    def number(value: Fraction) -> Computed:
        if value.denominator == 1 and abs(value) <= _WHOLE:
            return Computed(real, point(value), number=value)
        return Computed(real, point(value)).rounded(point(value), point(abs(value) * _FOLDED))

    def power(x: Computed, exponent: int) -> Computed:
        size = _size(x.around)
        slope = intervals.power(size, exponent - 1) * point(abs(Fraction(exponent)))
        return x.rounded(intervals.power(x.value, exponent), slope * x.error, _by_power(size, exponent))

    def root(x: Computed, exponent: Fraction) -> Computed:
        units = UNITS["sqrt"] if exponent == Fraction(1, 2) else _by_power(x.around, exponent)
        slope = intervals.root(x.around, exponent - 1) * point(abs(exponent))
        return x.rounded(intervals.root(x.value, exponent), slope * x.error, units)

    def no_hull(way: Computed, a: Computed, b: Computed) -> Computed:
        raise Undefined("no second slopes of Min and Max")

    return Arithmetic(number, power, root, partial(_function, real), no_hull)


def _function(real: str, name: str, args: tuple[Computed, ...]) -> Computed:
    if name in ("Min", "Max"):
        first, second = args
        value = intervals.function(name, (first.value, second.value))
        return Computed(real, value, intervals.function("Max", (first.error, second.error)))
    (x,) = args
    if name == "Abs":
        return Computed(real, _size(x.value), x.error)
    if name not in UNITS:
        raise Undefined(f"how far {name} errs is not known")
    if name in ("sin", "cos", "tan") and not _size(x.around).at_most(_ANGLE):
        raise Undefined("an angle beyond those of which the error is measured")
    return x.through(name, UNITS[name])


_LONGEST = 5_000  # statements, of which a call of 8 states has some 500
_FUNCTIONS = 1_000  # each is compared with those before it
_STATEMENT = re.compile(r"v[1-9][0-9]{0,5}\Z", re.ASCII)


@dataclass(frozen=True)
class ListedProgram:
    """A program that a certificate lists: `statements`, each an operation with its operands; `stages` and `rates` (s,
    N), the operands that hold the observer's N states (fields) and their rates at each stage; `after` (N), the operands
    that hold the states after the call."""

    statements: list[tuple[str, list[str]]]
    stages: list[list[str]]
    rates: list[list[str]]
    after: list[str]


def is_statement(operand: str) -> bool:
    """Return whether an operand is the result of a statement, not a name or a number."""
    return bool(_STATEMENT.match(operand))


class Walk:
    """A lazy evaluation of a program's statements in some arithmetic, from the values of its names: samples, inputs and
    the observer's states."""

    def __init__(
        self,
        program: ListedProgram,
        values: Mapping[str, Any],
        arithmetic: Arithmetic,
        deviations: Mapping[str, Callable[["Walk", Any], Any]] | None = None,
        constant: Callable[[Expression], Any] | None = None,
    ) -> None:
        """Store the program, of which nothing is evaluated yet. `deviations`: functions that change the values of
        certain statements; `constant`: the value of an expression without names, by default that in the arithmetic."""
        self.values, self.arithmetic, self.deviations = dict(values), arithmetic, deviations or {}
        self.constant = constant or partial(evaluate, values={}, arithmetic=arithmetic)
        self.computed = dict[str, Any]()  # values of renamed statements
        self.rest: Iterator[tuple[int, tuple[str, list[str]]]] = enumerate(program.statements, 1)
        self.count = 0

    def value(self, operand: str) -> Any:
        """Return the value of a name, a number or a statement. Raises: `Unproved`, and the arithmetic's errors."""
        if is_statement(operand):
            while int(operand[1:]) > self.count:
                self._next()
        if operand not in self.values:
            self.values[operand] = self._constant(operand)
        return self.values[operand]

    def _constant(self, operand: str) -> Any:
        if is_number(operand):
            return self.arithmetic.number(number(operand))
        try:
            return self.constant(expression(operand, ()))
        except Unreadable:
            raise Unproved(f"its program reads {operand!r}, which it has not") from None

    def rename(self, operand: str, value: Any) -> None:
        """Replace the value of a statement from now on, at most once; a name or a number keeps its value."""
        if is_statement(operand) and operand not in self.computed:
            self.computed[operand] = self.values[operand]
            self.values[operand] = value

    def _next(self) -> None:
        try:
            at, (word, operands) = next(self.rest)
        except StopIteration:
            raise Unproved("its program reads a statement that it has not") from None
        if any(is_statement(each) and int(each[1:]) >= at for each in operands):
            raise Unproved(f"statement {at} reads one that is not before it")
        name, value = f"v{at}", self._applied(word, operands)
        self.count = at
        self.values[name] = self.deviations[name](self, value) if name in self.deviations else value

    def _applied(self, word: str, operands: list[str]) -> Any:
        if word == "pow" and len(operands) == 2:
            x, exponent = self.value(operands[0]), _exponent(operands[1])
            whole = exponent.denominator == 1
            return self.arithmetic.power(x, int(exponent)) if whole else self.arithmetic.root(x, exponent)
        return _applied(word, [self.value(each) for each in operands], self.arithmetic)


def _listed_program(holder: Mapping[str, Any], fields: int, stages: int) -> ListedProgram:
    """Return the program in the evidence, with so many `fields` (states of the observer) and `stages`. Raises:
    `Unproved`."""
    texts = part(holder, "program", list)
    if len(texts) > _LONGEST or not all(isinstance(text, str) and text.split() for text in texts):
        raise Unproved(f"its program is no list of at most {_LONGEST} statements")
    statements = [(word, operands) for word, *operands in map(str.split, texts)]
    if sum(word not in _PLAIN for word, _ in statements) > _FUNCTIONS:
        raise Unproved(f"its program has more than {_FUNCTIONS} functions")
    rows = {key: [_operands({key: row}, key, fields) for row in entries(holder, key, stages)] for key in _STAGES}
    return ListedProgram(statements, rows["stages"], rows["rates"], _operands(holder, "after", fields))


_STAGES = ("stages", "rates")


def _operands(holder: Mapping[str, Any], key: str, count: int) -> list[str]:
    texts = entries(holder, key, count)
    if not all(isinstance(text, str) for text in texts):
        raise Unproved(f"its {key} are no operands")
    return texts


def _exponent(text: str) -> Fraction:
    try:
        exponent = number(text)
    except Unreadable:
        raise Unproved(f"its program has the power {text!r}, which is no number") from None
    if abs(exponent) > HIGHEST or exponent == Fraction(1, 2):
        raise Unproved(f"its program has the power {text!r}, which is a square root or too large")
    return exponent


def _applied(word: str, values: Sequence[Any], arithmetic: Arithmetic) -> Any:
    count = _OPERANDS.get(word)
    if count is None:
        raise Unproved(f"its program has the operation {word!r}, whose rounding is not known")
    if len(values) != count:
        raise Unproved(f"its program takes {word!r} of {len(values)} values")
    if word in OPERATIONS:
        return OPERATIONS[word](*values)
    if word == "square":
        return values[0] * values[0]
    if word == "sqrt":
        return arithmetic.root(values[0], Fraction(1, 2))
    return arithmetic.function(word, tuple(values))


_PLAIN = (*OPERATIONS, "square")
_OPERANDS = {
    **dict.fromkeys((*OPERATIONS, "Min", "Max"), 2),
    **dict.fromkeys(("neg", "square", "sqrt", *ONE_ARGUMENT), 1),
}

# --- the equation

Row = Sequence[Quotient]
_ZERO = Fraction(0)


@dataclass(frozen=True)
class Equation:
    """The equation x' = f(x, y, u) of an observer in the states x (N) of its program, at a gain theta, with the plant's
    `parameters` as in the program; `error`: the observer's error dynamics."""

    context: Context
    error: ErrorInclusion
    theta: Fraction
    parameters: Mapping[str, Fraction]

    @cached_property
    def scales(self) -> list[Fraction]:
        """The factors s (N): e_k = s_k times the error of the form's state that observer state k estimates. Raises:
        `Unproved`."""
        return self.error.scales(self.context, self.theta)

    @cached_property
    def units(self) -> list[Fraction]:
        """The factors r (N): e_k = r_k times the error of x_k, as the program stores it. Raises: `Unproved`."""
        if not self.error.units:
            return self.scales
        units = self.error.units
        return [units[i] / self.theta**p for i, p in zip(self.error.index, self.error.power, strict=True)]

    def rates(self, algebra: Algebra, x: Row, y: Row, u: Row) -> list[Quotient]:
        """Return x' (N) for observer states x (N), samples y (p) and inputs u (m). Raises: `Unproved`, `Undefined`,
        `TooLarge`."""
        context, error, number = self.context, self.error, algebra.number
        names = {name: number(value) for name, value in self.parameters.items()}
        names |= zip(context.file.inputs, u, strict=True)
        rates, reads = (self._core_rates if error.units else self._gain_rates)(algebra, names, x, y)
        clamped = {z: _clamp(algebra, each, *context.form.box[z]) for z, each in zip(context.z, reads, strict=True)}
        b = [algebra.read(row, {**names, **clamped}) for row in context.form.b]
        each = zip(rates, self.scales, self.units, error.fed, error.index, strict=True)
        return [rate + number(fed * s / r) * b[i] for rate, s, r, fed, i in each]

    def _gain_rates(self, algebra: Algebra, names: Mapping[str, Quotient], z: Row, y: Row) -> tuple[Row, Row]:
        """Return z' (n) without b, and z + N v (n), the argument of b, for an observer with a gain matrix."""
        form, there = self.context.form, {**names, **dict(zip(self.context.z, z, strict=True))}
        v = self._missed(algebra, there, y)
        A = [[algebra.read(entry, names) for entry in row] for row in form.A]
        injected, injection = (applied(algebra, M, v) for M in (self.error.measured, self.error.from_y))
        each = zip(A, injected, self.scales, strict=True)
        rates = [inner(algebra, row, z) + algebra.number(self.theta / s) * more for row, more, s in each]
        return rates, [a + algebra.number(1 / s) * b for a, b, s in zip(z, injection, self.scales, strict=True)]

    def _core_rates(self, algebra: Algebra, names: Mapping[str, Quotient], x: Row, y: Row) -> tuple[Row, Row]:
        error, number, nothing = self.error, algebra.number, dict.fromkeys(self.context.z, algebra.zero)
        e = [number(r) * each for r, each in zip(self.units, x, strict=True)]
        v = self._missed(algebra, {**names, **nothing}, y)
        rates = [a + b for a, b in zip(applied(algebra, error.N, e), applied(algebra, error.measured, v), strict=True)]
        for slope in (slope for slope in error.slopes if slope.degree == -1):  # effect of a saturation
            k, direction = slope.reads.index(Fraction(1)), slope.direction
            injection = number(self.units[k]) * (x[k] - self._saturated(algebra, x[k], k))
            rates = [rate + number(share) * injection for rate, share in zip(rates, direction, strict=True)]
        reads = [number(1 / self.scales[k]) * e[k] for k in error.picks]
        return [number(self.theta / r) * rate for rate, r in zip(rates, self.units, strict=True)], reads

    def _missed(self, algebra: Algebra, there: Mapping[str, Quotient], y: Row) -> list[Quotient]:
        """Return the output errors v = theta^-late (y - h) (p), h the outputs at the names' values `there`; 0 for an
        output that measures no state."""
        nothing, context = algebra.zero, self.context
        each = zip(y, context.form.output, context.observed, self.error.late, strict=True)
        return [
            algebra.number(self.theta**-late) * (sample - algebra.read(row, there)) if z else nothing
            for sample, row, z, late in each
        ]

    def _saturated(self, algebra: Algebra, x: Quotient, k: int) -> Quotient:
        share, box = self.scales[k] / self.units[k], self.context.form.box[self.context.z[self.error.index[k]]]
        low, high = (end * share if isinstance(end, Fraction) else end for end in box)
        return _clamp(algebra, x, *((low, high) if share > 0 else (high, low)))


def _clamp(algebra: Algebra, x: Quotient, low: End, high: End) -> Quotient:
    for name, end in (("Max", low), ("Min", high)):
        x = algebra.function(name, (x, algebra.number(end))) if isinstance(end, Fraction) else x
    return x


# --- the step


@dataclass(frozen=True)
class StepProgram:
    """A listed `program` that is to realise a step of length `h` of an observer's equation by the Runge-Kutta method
    `tableau`; `between`: how inputs vary between two samples, "line" for linear, "hold" for the last value."""

    equation: Equation
    tableau: Tableau
    h: Fraction
    program: ListedProgram
    between: str

    def deviations(self) -> "Deviations":
        """Return the differences of the program's statements from the step in exact arithmetic. Raises: `Unproved`."""
        stages, fields = len(self.tableau.weights), len(self.equation.units)
        marks = {
            f"{what} {i} {k}": operand
            for what, rows in (("field", self.program.stages), ("rate", self.program.rates))
            for i, row in zip(range(stages), rows, strict=True)
            for k, operand in enumerate(row)
        }
        algebra = Algebra([*self._names, *marks])
        walk = Walk(self.program, {name: algebra.names[name] for name in self._names}, algebra.arithmetic)
        deviations, rates = Deviations(algebra, walk, marks), list[list[Quotient]]()
        try:
            x = [walk.value(f"x{k}") for k in range(1, fields + 1)]
            for i, (row, node) in enumerate(zip(self.tableau.rows, self.tableau.nodes, strict=True)):
                wanted = _stepped(algebra, x, rates, [self.h * a for a in row])
                there = deviations.match(self.program.stages[i], wanted, f"field {i}")
                y, u = (self._there(algebra, walk, name, node) for name in ("y", "u"))
                slope = self.equation.rates(algebra, there, y, u)
                rates.append(deviations.match(self.program.rates[i], slope, f"rate {i}"))
            deviations.match(
                self.program.after, _stepped(algebra, x, rates, [self.h * b for b in self.tableau.weights])
            )
        except Undefined as error:
            raise Unproved(f"its program has no value: {error}") from None
        except TooLarge:
            raise Unproved("its program is too large to verify") from None
        return deviations

    @property
    def _names(self) -> list[str]:
        context, fields = self.equation.context, range(1, len(self.equation.units) + 1)
        many = {"y": len(context.form.output), "u": len(context.file.inputs)}
        ends = [f"{name}{j}{end}" for name, count in many.items() for j in range(1, count + 1) for end in ("_last", "")]
        return [*(f"x{k}" for k in fields), *ends]

    def _there(self, algebra: Algebra, walk: Walk, name: str, node: Fraction) -> list[Quotient]:
        count = len(self.equation.context.form.output if name == "y" else self.equation.context.file.inputs)
        share = Fraction(1) if name == "u" and self.between == "hold" else node
        pairs = [(walk.value(f"{name}{j}_last"), walk.value(f"{name}{j}")) for j in range(1, count + 1)]
        return [algebra.number(1 - share) * last + algebra.number(share) * now for last, now in pairs]


def _stepped(
    algebra: Algebra, x: Sequence[Quotient], rates: Sequence[Sequence[Quotient]], by: Sequence[Fraction]
) -> list[Quotient]:
    result = list(x)
    for weight, rate in zip(by, rates, strict=False):
        if weight:
            result = [a + algebra.number(weight) * b for a, b in zip(result, rate, strict=True)]
    return result


@dataclass(frozen=True)
class Deviations:
    """A comparison of a program with a step in exact arithmetic: `deviations` has the nonzero differences of statements
    from the step's values. A statement that was compared is replaced by a letter of the algebra; `marks`: the statement
    of each letter, a state or a rate of a stage."""

    algebra: Algebra
    walk: Walk
    marks: Mapping[str, str]
    deviations: dict[str, Quotient] = field(default_factory=dict)

    def match(self, operands: Sequence[str], wanted: Sequence[Quotient], letters: str = "") -> list[Quotient]:
        """Compare the values of operands with the step's values `wanted`, store the differences, and return the
        operands' values. `letters`: the beginning of the names of the letters that replace the operands from now on,
        none by default. Raises: `Unproved`, and the arithmetic's errors."""
        for k, (operand, value) in enumerate(zip(operands, wanted, strict=True)):
            off = self.walk.value(operand) - value
            exact = operand in self.walk.computed and operand not in self.deviations  # its value before the renaming
            if not (self.algebra.is_zero(off) or (exact and self.algebra.is_zero(self.walk.computed[operand] - value))):
                if not is_statement(operand) or operand in {*self.walk.computed, *self.deviations}:
                    raise Unproved(f"{operand} of its program is not what the step has")
                self.deviations[operand] = off
            if letters:
                self.walk.rename(operand, self.algebra.names[f"{letters} {k}"])
        return [self.walk.value(operand) for operand in operands]

    @property
    def statements(self) -> dict[str, Callable[[Walk, Computed], Computed]]:
        """For each statement with a deviation, the function that widens its value by the deviation."""
        return {operand: partial(self._stepped, off) for operand, off in self.deviations.items()}

    def _stepped(self, off: Quotient, walk: Walk, value: Computed) -> Computed:
        size = self.algebra.value(off, _Letters(walk, self.marks), intervals)
        return value.widened(intervals.function("Abs", (size,)))


class _Letters(dict[str, Interval]):
    def __init__(self, walk: Walk, marks: Mapping[str, str]) -> None:
        super().__init__()
        self.walk, self.marks = walk, marks

    def __missing__(self, name: str) -> Interval:
        value: Computed = self.walk.value(self.marks.get(name, name))
        return value.value


_ROUNDING_KEYS = ("between", "parameters", "precision", "speeds", "within", "program", "stages", "rates", "after")
_BETWEEN = ("line", "hold")
_PIECES = 32  # of the ranges of the measured states
Side = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class Rounded:
    """The program of a `step` in a `precision`, with bounds of the errors of the `samples` (p), of the errors of the
    observer's states, `within` (N), in the units of the states that they estimate, and of the plant's movement in a
    call, `drifts` (n)."""

    step: StepProgram
    precision: str
    samples: Sequence[Fraction]
    within: Sequence[Fraction]
    drifts: Sequence[Fraction]

    def demand_sizes(self, sizes: Sequence[Fraction]) -> int:
        """Demand r_k |rounding error of observer state k in a call| <= h sizes_k, r its unit (`Equation.units`); return
        the number of pieces of the ranges. Raises: `Unproved`."""
        pieces, deviations = self._pieces, self.step.deviations().statements
        for ranges in pieces:
            try:
                inputs, known = self._values(ranges), partial(constant, self.precision)
                walk = Walk(self.step.program, inputs, precision(self.precision), deviations, known)
                errors = [walk.value(operand).error for operand in self.step.program.after]
            except Undefined as error:
                raise Unproved(f"how far its program rounds is not known: {error}") from None
            for deviation, size, unit in zip(errors, sizes, self.step.equation.units, strict=True):
                if not (point(abs(unit)) * deviation).at_most(size * self.step.h):
                    raise Unproved("a size of its rounding is less than how far its program is from the step")
        return len(pieces)

    @property
    def _pieces(self) -> list[tuple[Side, ...]]:
        context = self.step.equation.context
        heads, sides = {z for z in context.observed if z}, list[list[Side]]()
        count = round(_PIECES ** (1 / max(1, len(heads))))
        for z in context.z:
            low, high = _finite(context.form.box[z])
            parts = count if z in heads else 1
            sides.append(list(pairwise(low + (high - low) * Fraction(part, parts) for part in range(parts + 1))))
        return list(product(*sides))

    def _values(self, ranges: Sequence[Side]) -> dict[str, Computed]:
        equation, context, values = self.step.equation, self.step.equation.context, dict[str, Interval]()
        known = zip(equation.units, equation.scales, equation.error.index, equation.error.fed, self.within, strict=True)
        for k, (unit, scale, i, fed, error) in enumerate(known, 1):
            low, high = ranges[i] if fed else (_ZERO, _ZERO)
            values[f"x{k}"] = point(scale / unit) * between(low - error, high + error)
        for j, most in enumerate(self.samples):
            observed = self._sample(j, ranges) + between(-most, most)
            values |= dict.fromkeys((f"y{j + 1}_last", f"y{j + 1}"), observed)
        for j, name in enumerate(context.file.inputs, 1):
            values |= dict.fromkeys((f"u{j}_last", f"u{j}"), between(*_finite(context.form.box[name])))
        return {name: Computed(self.precision, value) for name, value in values.items()}

    def _sample(self, output: int, ranges: Sequence[Side]) -> Interval:
        context = self.step.equation.context
        shifted = zip(context.z, ranges, self.drifts, strict=True)
        box = {**context.form.box, **{z: (low - move, high + move) for z, (low, high), move in shifted}}
        text = context.form.output[output]
        value: Interval = evaluate(text, {name: between(*box[name]) for name in text.names}, intervals)
        return value


def demand_rounding(
    equation: Equation,
    tableau: Tableau,
    h: Fraction,
    share: Mapping[str, Any],
    shares: Mapping[str, Mapping[str, Any]],
    totals: Sequence[Fraction],
) -> tuple[str, int]:
    """Demand that the sizes stated in a `share` bound the rounding errors of the listed program, while the errors of
    the observer's states are at most `totals` (N), the effect of all `shares`, in the units of the states that they
    estimate. Return the assumptions in words, and the number of boxes. Raises: `Unproved`."""
    follows, context = share["follows"], equation.context
    n, count, p = len(context.z), len(totals), len(context.form.output)
    errors, speeds = column(follows, "within", count), column(follows, "speeds", n)
    if any(error < total for error, total in zip(errors, totals, strict=True)):
        raise Unproved("the errors within which its program rounds are less than what all shares come to")
    boxes = demand_speeds(context, speeds)
    deviations = [column(each, "beside", n) for each in shares.values() if each["beside"] != []]
    drifts = [h * (speed + sum(each, _ZERO)) for speed, *each in zip(speeds, *deviations, strict=True)]
    noisy = [column(each, "samples", p) for each in shares.values() if each["samples"] != []]
    samples = [sum(each, _ZERO) for each in zip(*noisy, strict=True)] or [_ZERO] * p
    program = _listed_program(follows, count, len(tableau.weights))
    step = StepProgram(equation, tableau, h, program, _between(context, follows, shares))
    rounded = Rounded(step, _one_of(follows, "precision", PRECISIONS), samples, errors, drifts)
    boxes += rounded.demand_sizes(column(share, "fields", count))
    return _phrase(rounded), boxes


def equation_of(context: Context, error: ErrorInclusion, theta: Fraction, follows: Mapping[str, Any]) -> Equation:
    """Return the equation of the observer whose program the evidence `follows` lists. Raises: `Unproved`."""
    demand_keys(follows, _ROUNDING_KEYS, "its rounding")
    return Equation(context, error, theta, _parameters_of(context, follows))


def _parameters_of(context: Context, follows: Mapping[str, Any]) -> dict[str, Fraction]:
    """Return the values of the plant's parameters in the listed program, each inside its range. Raises: `Unproved`."""
    names = context.file.parameters
    values = dict(zip(names, column(follows, "parameters", len(names)), strict=True))
    for name, value in values.items():
        low, high = context.form.box[name]
        if not low <= value <= high:
            raise Unproved(f"its program has {name} = {value}, outside the model's range")
    return values


def _between(context: Context, follows: Mapping[str, Any], shares: Mapping[str, Mapping[str, Any]]) -> str:
    between, motion = _one_of(follows, "between", _BETWEEN), shares.get("method", {}).get("follows", {})
    rates = column(motion, "rates", len(context.file.inputs)) if "rates" in motion else []
    if between == "hold" and any(rates):
        raise Unproved("its program holds inputs that move")
    return between


def _phrase(rounded: Rounded) -> str:
    words = {word for word, _ in rounded.step.program.statements}
    functions = [f"{name} errs by at most {units / 2} ulps" for name, units in UNITS.items() if name in words]
    functions += [f"x^k by {POWER[0] / 2} and {POWER[1] / 2} more for each |k log x|"] if "pow" in words else []
    injection = f", where {', '.join(functions)}" if functions else ""
    equation, count = rounded.step.equation, len(rounded.step.program.statements)
    each = zip(equation.context.z, equation.error.picks, strict=True)
    errs = ", ".join(f"{printed(rounded.within[k], -1)} in {z}" for z, k in each)
    return f"what {count} operations in {rounded.precision} round while the estimate errs by at most {errs}{injection}"


def _one_of(follows: Mapping[str, Any], key: str, known: Sequence[str]) -> str:
    value: str = part(follows, key, str)
    if value not in known:
        raise Unproved(f"its {key} is none of {', '.join(known)}")
    return value


def _finite(side: tuple[End, End]) -> Side:
    low, high = side
    if not (isinstance(low, Fraction) and isinstance(high, Fraction)):
        raise Unproved("a state or an input has no range")
    return low, high
