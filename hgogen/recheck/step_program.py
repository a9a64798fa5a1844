"""A program as a step of a method on the equation of an observer: its statements against what the step has.

    X_i = x + h sum_j a_ij k_j,   k_i = f(X_i, y_i, u_i),   x+ = x + h sum_i b_i k_i

are identities of the program in exact arithmetic, stage by stage, but for what its constants are rounded: by how much a
statement is beside them is a quotient of what stands before it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Undefined
from .box import NotShown
from .computed import Computed
from .equation import Equation
from .inequality import Tableau
from .interval import Interval, intervals
from .listed import Listed, Walk, is_statement

_ONE = Fraction(1)


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
        walk = Walk(self.program, {name: algebra.letter(name) for name in self._names}, algebra.arithmetic)
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
        """Those that the program reads."""
        context, fields = self.equation.context, range(1, len(self.equation.units) + 1)
        many = {"y": len(context.form.output), "u": len(context.file.inputs)}
        ends = [f"{name}{j}{end}" for name, count in many.items() for j in range(1, count + 1) for end in ("_last", "")]
        return [*(f"x{k}" for k in fields), *ends]

    def _there(self, algebra: Algebra, walk: Walk, name: str, node: Fraction) -> list[Quotient]:
        """Samples or inputs at a part of the way between two."""
        count = len(self.equation.context.form.output if name == "y" else self.equation.context.file.inputs)
        share = _ONE if name == "u" and self.between == "hold" else node
        pairs = [(walk.value(f"{name}{j}_last"), walk.value(f"{name}{j}")) for j in range(1, count + 1)]
        return [algebra.number(1 - share) * last + algebra.number(share) * now for last, now in pairs]


def _moved(
    algebra: Algebra, x: Sequence[Quotient], rates: Sequence[Sequence[Quotient]], by: Sequence[Fraction]
) -> list[Quotient]:
    """x and each of the rates times its number."""
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
            if not (self.algebra.is_zero(off) or self._computed(operand, value)):
                if not is_statement(operand) or operand in {*self.walk.computed, *self.beside}:
                    raise NotShown(f"{operand} of its program is not what the step has")
                self.beside[operand] = off
            if letters:
                self.walk.rename(operand, self.algebra.letter(f"{letters} {k}"))
        return [self.walk.value(operand) for operand in operands]

    def _computed(self, operand: str, value: Quotient) -> bool:
        """Whether a statement that stands for something else, exactly, was computed as this value."""
        exact = operand in self.walk.computed and operand not in self.beside
        return exact and self.algebra.is_zero(self.walk.computed[operand] - value)

    @property
    def statements(self) -> dict[str, Callable[[Walk, Computed], Computed]]:
        """By statement that is beside, what its value and its error are in the arithmetic of a precision."""
        return {operand: partial(self._moved, off) for operand, off in self.beside.items()}

    def _moved(self, off: Quotient, walk: Walk, value: Computed) -> Computed:
        size = self.algebra.value(off, _Letters(walk, self.marks), intervals)
        return value.beside(intervals.function("Abs", (size,)))


@dataclass(frozen=True)
class _Letters(Mapping[str, Interval]):
    """The intervals of a walk by the names of letters."""

    walk: Walk
    marks: Mapping[str, str]

    def __getitem__(self, name: str) -> Interval:
        value: Computed = self.walk.value(self.marks.get(name, name))
        return value.value

    def __iter__(self) -> Iterator[str]:
        return iter(self.marks)

    def __len__(self) -> int:
        return len(self.marks)
