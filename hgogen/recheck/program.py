"""A call's program as a certificate lists it: its statements against a step of a method on an observer's equation.

    x1, ..   the elements of the fields      y1_last, y1, ..   samples, of the last call and of this one
    v1, ..   the statements                  u1_last, u1, ..   inputs alike

A statement is an operation and what it takes, which is a name, a number, an expression of numbers, or a statement
before it. The equation in the observer's own fields is built from the plant of the certificate and its numbers:

    of a gain    z' = A z + b(clamped z + N v, u) + S^-1 theta B v,                v_j = theta^-late (y_j - h_j(z, u))
    of a core    e' = theta (N e + B v + sum over saturations of onto (sat e_j - e_j)) + s_i b_i(clamped z, u)

S is the diagonal of scale and powers of theta, e_k = r_k x_k of a field x_k of a chain of integrators, v = y - o(u). b
stands in the rows of the fields that estimate, of s_i theirs. What b reads is clamped to the ranges; a saturation
clamps a field to the range of the state that it estimates. The step

    X_i = x + h sum_j a_ij k_j,   k_i = f(X_i, y_i, u_i),   x+ = x + h sum_i b_i k_i

are identities of the program in exact arithmetic, stage by stage, but for what its constants are rounded: by how much a
statement is beside them is a quotient of what stands before it.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Arithmetic, Undefined, evaluate
from .box import End, NotShown
from .computed import Computed
from .context import Context, applied, inner
from .file import entries, part
from .inequality import Tableau
from .interval import Interval, intervals
from .text import HIGHEST, ONE_ARGUMENT, OPERATIONS, Expression, Unreadable, expression, is_number, number
from .uncertain import ErrorInclusion

_LONGEST = 5_000  # statements, of which a call of 8 states has some 500
_FUNCTIONS = 1_000  # of these: each is compared with those before it
_STATEMENT = re.compile(r"v[1-9][0-9]{0,5}\Z", re.ASCII)


@dataclass(frozen=True)
class Listed:
    """The `statements`, each an operation and its operands; by stage the operands that are the fields there (N) and
    their rates, and the fields `after` the call."""

    statements: list[tuple[str, list[str]]]
    stages: list[list[str]]
    rates: list[list[str]]
    after: list[str]


def is_statement(operand: str) -> bool:
    """Whether an operand is one, not a name or a number."""
    return bool(_STATEMENT.match(operand))


class Walk:
    """The values of a program in an arithmetic, from those of its names; statements are computed as they are read."""

    def __init__(
        self,
        program: Listed,
        values: Mapping[str, Any],
        arithmetic: Arithmetic,
        beside: Mapping[str, Callable[["Walk", Any], Any]] | None = None,
        constant: Callable[[Expression], Any] | None = None,
    ) -> None:
        """`beside`: of statements, what stands for their value; `constant`: what an expression without names is, by
        default what the arithmetic computes of it."""
        self.values, self.arithmetic, self.beside = dict(values), arithmetic, beside or {}
        self.constant = constant or partial(evaluate, values={}, arithmetic=arithmetic)
        self.computed = dict[str, Any]()  # of statements that are named otherwise
        self.rest: Iterator[tuple[int, tuple[str, list[str]]]] = enumerate(program.statements, 1)
        self.count = 0

    def value(self, operand: str) -> Any:
        """Of a name, a number or a statement. Raises: `NotShown`, and what the arithmetic raises."""
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
            raise NotShown(f"its program reads {operand!r}, which it has not") from None

    def rename(self, operand: str, value: Any) -> None:
        """Has a statement another value from now on, the first time; a name or a number keeps its own."""
        if is_statement(operand) and operand not in self.computed:
            self.computed[operand] = self.values[operand]
            self.values[operand] = value

    def _next(self) -> None:
        try:
            at, (word, operands) = next(self.rest)
        except StopIteration:
            raise NotShown("its program reads a statement that it has not") from None
        if any(is_statement(each) and int(each[1:]) >= at for each in operands):
            raise NotShown(f"statement {at} reads one that is not before it")
        name, value = f"v{at}", self._applied(word, operands)
        self.count = at
        self.values[name] = self.beside[name](self, value) if name in self.beside else value

    def _applied(self, word: str, operands: list[str]) -> Any:
        if word == "pow" and len(operands) == 2:
            x, exponent = self.value(operands[0]), _exponent(operands[1])
            whole = exponent.denominator == 1
            return self.arithmetic.power(x, int(exponent)) if whole else self.arithmetic.root(x, exponent)
        return _applied(word, [self.value(each) for each in operands], self.arithmetic)


def listed(holder: Mapping[str, Any], fields: int, stages: int) -> Listed:
    """The program of a share. Raises: `NotShown`."""
    texts = part(holder, "program", list)
    if len(texts) > _LONGEST or not all(isinstance(text, str) and text.split() for text in texts):
        raise NotShown(f"its program is no list of at most {_LONGEST} statements")
    statements = [(word, operands) for word, *operands in map(str.split, texts)]
    if sum(word not in _PLAIN for word, _ in statements) > _FUNCTIONS:
        raise NotShown(f"its program has more than {_FUNCTIONS} functions")
    rows = {key: [_operands({key: row}, key, fields) for row in entries(holder, key, stages)] for key in _STAGES}
    return Listed(statements, rows["stages"], rows["rates"], _operands(holder, "after", fields))


_STAGES = ("stages", "rates")


def _operands(holder: Mapping[str, Any], key: str, count: int) -> list[str]:
    texts = entries(holder, key, count)
    if not all(isinstance(text, str) for text in texts):
        raise NotShown(f"its {key} are no operands")
    return texts


def _exponent(text: str) -> Fraction:
    """An exponent other than 1/2, which is a square root. Raises: `NotShown`."""
    try:
        exponent = number(text)
    except Unreadable:
        raise NotShown(f"its program has the power {text!r}, which is no number") from None
    if abs(exponent) > HIGHEST or exponent == Fraction(1, 2):
        raise NotShown(f"its program has the power {text!r}, which is a square root or too large")
    return exponent


def _applied(word: str, values: Sequence[Any], arithmetic: Arithmetic) -> Any:
    """Raises: `NotShown` of an operation that is none."""
    count = _OPERANDS.get(word)
    if count is None:
        raise NotShown(f"its program has the operation {word!r}, whose rounding is not known")
    if len(values) != count:
        raise NotShown(f"its program takes {word!r} of {len(values)} values")
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
_NONE = Fraction(0)


@dataclass(frozen=True)
class Equation:
    """That of an observer at a theta, with the plant's `parameters` as the program has them."""

    context: Context
    error: ErrorInclusion
    theta: Fraction
    parameters: Mapping[str, Fraction]

    @cached_property
    def scales(self) -> list[Fraction]:
        """By field (N), its error e_k where that of its state of the form is 1. Raises: `NotShown`."""
        return self.error.scales(self.context, self.theta)

    @cached_property
    def units(self) -> list[Fraction]:
        """r (N), the error e_k where that of the field is 1. Raises: `NotShown`."""
        if not self.error.units:
            return self.scales
        own = self.error.units
        return [own[i] / self.theta**p for i, p in zip(self.error.index, self.error.power, strict=True)]

    def rates(self, algebra: Algebra, x: Row, y: Row, u: Row) -> list[Quotient]:
        """x' (N) of fields x (N), samples y (p) and inputs u (m). Raises: `NotShown`, `Undefined`, `TooLarge`."""
        context, error, number = self.context, self.error, algebra.number
        names = {name: number(value) for name, value in self.parameters.items()}
        names |= zip(context.file.inputs, u, strict=True)
        rates, reads = (self._of_core if error.units else self._of_gain)(algebra, names, x, y)
        clamped = {z: _clamp(algebra, each, *context.form.box[z]) for z, each in zip(context.z, reads, strict=True)}
        b = [algebra.read(row, {**names, **clamped}) for row in context.form.b]
        each = zip(rates, self.scales, self.units, error.fed, error.index, strict=True)
        return [rate + number(fed * s / r) * b[i] for rate, s, r, fed, i in each]

    def _of_gain(self, algebra: Algebra, names: Mapping[str, Quotient], z: Row, y: Row) -> tuple[Row, Row]:
        """z' but for b, and what b reads."""
        form, there = self.context.form, {**names, **dict(zip(self.context.z, z, strict=True))}
        v = self._missed(algebra, there, y)
        A = [[algebra.read(entry, names) for entry in row] for row in form.A]
        injected, taken = (applied(algebra, M, v) for M in (self.error.measured, self.error.takes))
        each = zip(A, injected, self.scales, strict=True)
        rates = [inner(algebra, row, z) + algebra.number(self.theta / s) * more for row, more, s in each]
        return rates, [a + algebra.number(1 / s) * b for a, b, s in zip(z, taken, self.scales, strict=True)]

    def _of_core(self, algebra: Algebra, names: Mapping[str, Quotient], x: Row, y: Row) -> tuple[Row, Row]:
        """x' but for b, and what b reads."""
        error, number, nothing = self.error, algebra.number, dict.fromkeys(self.context.z, algebra.zero)
        e = [number(r) * each for r, each in zip(self.units, x, strict=True)]
        v = self._missed(algebra, {**names, **nothing}, y)
        rates = [a + b for a, b in zip(applied(algebra, error.N, e), applied(algebra, error.measured, v), strict=True)]
        for slope in (slope for slope in error.slopes if slope.degree == -1):  # what a saturation takes away
            of, onto = slope.reads.index(Fraction(1)), slope.onto
            taken = number(self.units[of]) * (x[of] - self._saturated(algebra, x[of], of))
            rates = [rate + number(share) * taken for rate, share in zip(rates, onto, strict=True)]
        reads = [number(1 / self.scales[k]) * e[k] for k in error.picks]
        return [number(self.theta / r) * rate for rate, r in zip(rates, self.units, strict=True)], reads

    def _missed(self, algebra: Algebra, there: Mapping[str, Quotient], y: Row) -> list[Quotient]:
        """theta^-late (y - h) (p), 0 of an output that shows no state."""
        nothing, context = algebra.zero, self.context
        each = zip(y, context.form.output, context.seen, self.error.late, strict=True)
        return [
            algebra.number(self.theta**-late) * (sample - algebra.read(row, there)) if z else nothing
            for sample, row, z, late in each
        ]

    def _saturated(self, algebra: Algebra, x: Quotient, k: int) -> Quotient:
        share, box = self.scales[k] / self.units[k], self.context.form.box[self.context.z[self.error.index[k]]]
        low, high = (end * share if isinstance(end, Fraction) else end for end in box)
        return _clamp(algebra, x, *((low, high) if share > 0 else (high, low)))


def _clamp(algebra: Algebra, x: Quotient, low: End, high: End) -> Quotient:
    """min(max(x, low), high), of ends that are numbers."""
    for name, end in (("Max", low), ("Min", high)):
        x = algebra.function(name, (x, algebra.number(end))) if isinstance(end, Fraction) else x
    return x


# --- the step


@dataclass(frozen=True)
class StepProgram:
    """A `program` of a tableau on an observer's equation with steps of `h`, its inputs `between` two samples on their
    "line", or on "hold" at the last one."""

    equation: Equation
    tableau: Tableau
    h: Fraction
    program: Listed
    between: str

    def besides(self) -> "Besides":
        """By how much its statements are beside the step, in exact arithmetic. Raises: `NotShown`."""
        try:
            return self._besides()
        except Undefined as error:
            raise NotShown(f"its program has no value: {error}") from None
        except TooLarge:
            raise NotShown("its program is too large to verify") from None

    def _besides(self) -> "Besides":
        stages, fields = len(self.tableau.weights), len(self.equation.units)
        marks = {
            f"{what} {i} {k}": operand
            for what, rows in (("field", self.program.stages), ("rate", self.program.rates))
            for i, row in zip(range(stages), rows, strict=True)
            for k, operand in enumerate(row)
        }
        algebra = Algebra([*self._names, *marks])
        walk = Walk(self.program, {name: algebra.names[name] for name in self._names}, algebra.arithmetic)
        besides = Besides(algebra, walk, marks)
        x, rates = [walk.value(f"x{k}") for k in range(1, fields + 1)], list[list[Quotient]]()
        for i, (row, node) in enumerate(zip(self.tableau.rows, self.tableau.nodes, strict=True)):
            wanted = _moved(algebra, x, rates, [self.h * a for a in row])
            there = besides.take(self.program.stages[i], wanted, f"field {i}")
            y, u = (self._there(algebra, walk, name, node) for name in ("y", "u"))
            rates.append(besides.take(self.program.rates[i], self.equation.rates(algebra, there, y, u), f"rate {i}"))
        besides.take(self.program.after, _moved(algebra, x, rates, [self.h * b for b in self.tableau.weights]))
        return besides

    @property
    def _names(self) -> list[str]:
        context, fields = self.equation.context, range(1, len(self.equation.units) + 1)
        many = {"y": len(context.form.output), "u": len(context.file.inputs)}
        ends = [f"{name}{j}{end}" for name, count in many.items() for j in range(1, count + 1) for end in ("_last", "")]
        return [*(f"x{k}" for k in fields), *ends]

    def _there(self, algebra: Algebra, walk: Walk, name: str, node: Fraction) -> list[Quotient]:
        """Samples or inputs at a part of the way between two."""
        count = len(self.equation.context.form.output if name == "y" else self.equation.context.file.inputs)
        share = Fraction(1) if name == "u" and self.between == "hold" else node
        pairs = [(walk.value(f"{name}{j}_last"), walk.value(f"{name}{j}")) for j in range(1, count + 1)]
        return [algebra.number(1 - share) * last + algebra.number(share) * now for last, now in pairs]


def _moved(
    algebra: Algebra, x: Sequence[Quotient], rates: Sequence[Sequence[Quotient]], by: Sequence[Fraction]
) -> list[Quotient]:
    result = list(x)
    for weight, rate in zip(by, rates, strict=False):
        if weight:
            result = [a + algebra.number(weight) * b for a, b in zip(result, rate, strict=True)]
    return result


@dataclass(frozen=True)
class Besides:
    """Statements that stand for what a step has, the `marks` by the names of letters: by how much each is `beside`
    that, where it is; from then on its value is a letter."""

    algebra: Algebra
    walk: Walk
    marks: Mapping[str, str]
    beside: dict[str, Quotient] = field(default_factory=dict)

    def take(self, operands: Sequence[str], wanted: Sequence[Quotient], letters: str = "") -> list[Quotient]:
        """The values of operands that stand for what is wanted. Raises: `NotShown`, and as the arithmetic."""
        for k, (operand, value) in enumerate(zip(operands, wanted, strict=True)):
            off = self.walk.value(operand) - value
            exact = operand in self.walk.computed and operand not in self.beside  # what it was before it was renamed
            if not (self.algebra.is_zero(off) or (exact and self.algebra.is_zero(self.walk.computed[operand] - value))):
                if not is_statement(operand) or operand in {*self.walk.computed, *self.beside}:
                    raise NotShown(f"{operand} of its program is not what the step has")
                self.beside[operand] = off
            if letters:
                self.walk.rename(operand, self.algebra.names[f"{letters} {k}"])
        return [self.walk.value(operand) for operand in operands]

    @property
    def statements(self) -> dict[str, Callable[[Walk, Computed], Computed]]:
        """By statement that is beside, what its value and its error are in the arithmetic of a precision."""
        return {operand: partial(self._moved, off) for operand, off in self.beside.items()}

    def _moved(self, off: Quotient, walk: Walk, value: Computed) -> Computed:
        size = self.algebra.value(off, _Letters(walk, self.marks), intervals)
        return value.beside(intervals.function("Abs", (size,)))


class _Letters(dict[str, Interval]):
    """The intervals of a walk by the names of letters."""

    def __init__(self, walk: Walk, marks: Mapping[str, str]) -> None:
        super().__init__()
        self.walk, self.marks = walk, marks

    def __missing__(self, name: str) -> Interval:
        value: Computed = self.walk.value(self.marks.get(name, name))
        return value.value
