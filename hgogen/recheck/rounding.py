"""That the sizes of what a program rounds follow from its statements, which are those of the step.

    X_i = x + h sum_j a_ij k_j,   k_i = f(X_i, y_i, u_i) of the observer's equation,   x+ = x + h sum_i b_i k_i

are identities of the program in exact arithmetic, stage by stage, but for what its constants are rounded. How far it is
from them in its precision is computed where the plant is in its ranges and the error of each field within a bound, in
pieces of the ranges of the states that outputs show; what is missing to an identity adds to the error of the statement.
All shares together are at most that bound: an error that inputs alone made never leaves it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial, reduce
from itertools import pairwise, product
from operator import add
from typing import Any

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Undefined, evaluate
from .box import End, NotShown, covered, ranged
from .computed import PRECISIONS, UNITS, Computed, precision
from .context import Context, narrowed
from .equation import Equation
from .file import part
from .interval import Interval, intervals, point
from .interval import between as from_to
from .listed import Listed, Walk, listed
from .matrix import column
from .stages import Tableau

KEYS = ("between", "parameters", "precision", "speeds", "within", "program", "stages", "rates", "after")
_BETWEEN = ("line", "hold")
_PIECES = 32  # of the ranges of the states that outputs show
_NONE, _ONE = Fraction(0), Fraction(1)
Side = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class Rounded:
    """A program of a tableau on an observer's equation with steps of `h`, its inputs `between` two samples; errors of
    samples at most `samples` (p), of fields in units of their states at most `within` (N), the plant moves by `moves`
    (n) in a call."""

    equation: Equation
    tableau: Tableau
    h: Fraction
    program: Listed
    between: str
    precision: str
    samples: Sequence[Fraction]
    within: Sequence[Fraction]
    moves: Sequence[Fraction]

    @property
    def context(self) -> Context:
        """That of the certificate."""
        return self.equation.context

    def besides(self) -> "Besides":
        """By how much its statements are beside the step, in exact arithmetic. Raises: `NotShown`."""
        try:
            return self._besides()
        except Undefined as error:
            raise NotShown(f"its program has no value: {error}") from None
        except TooLarge:
            raise NotShown("its program is too large to verify") from None

    def _besides(self) -> "Besides":
        stages, fields = len(self.tableau.weights), len(self.within)
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
        context, fields = self.context, range(1, len(self.within) + 1)
        many = {"y": len(context.form.output), "u": len(context.file.inputs)}
        ends = [f"{name}{j}{end}" for name, count in many.items() for j in range(1, count + 1) for end in ("_last", "")]
        return [*(f"x{k}" for k in fields), *ends]

    def _there(self, algebra: Algebra, walk: Walk, name: str, node: Fraction) -> list[Quotient]:
        """Samples or inputs at a part of the way between two."""
        count = len(self.context.form.output if name == "y" else self.context.file.inputs)
        share = _ONE if name == "u" and self.between == "hold" else node
        pairs = [(walk.value(f"{name}{j}_last"), walk.value(f"{name}{j}")) for j in range(1, count + 1)]
        return [algebra.number(1 - share) * last + algebra.number(share) * now for last, now in pairs]

    def demand_sizes(self, sizes: Sequence[Fraction]) -> int:
        """That a call rounds the error of each field by at most h times its size (N); with how many pieces.

        Raises: `NotShown`."""
        pieces, beside = self._pieces, self.besides().statements
        for ranges in pieces:
            try:
                walk = Walk(self.program, self._values(ranges), precision(self.precision), beside)
                errors = [walk.value(operand).error for operand in self.program.after]
            except Undefined as error:
                raise NotShown(f"how far its program rounds is not known: {error}") from None
            for beside_step, size, unit in zip(errors, sizes, self.equation.units, strict=True):
                if not (point(abs(unit)) * beside_step).at_most(size * self.h):
                    raise NotShown("a size of its rounding is less than what its program rounds")
        return len(pieces)

    @property
    def _pieces(self) -> list[tuple[Side, ...]]:
        """The ranges (n) of the states, those that outputs show in pieces."""
        context = self.context
        heads, sides = {z for z in context.seen if z}, list[list[Side]]()
        count = round(_PIECES ** (1 / max(1, len(heads))))
        for z in context.z:
            low, high = _finite(context.form.box[z])
            parts = count if z in heads else 1
            sides.append(list(pairwise(low + (high - low) * Fraction(part, parts) for part in range(parts + 1))))
        return list(product(*sides))

    def _values(self, ranges: Sequence[Side]) -> dict[str, Computed]:
        """What the program reads while the plant is in these ranges at the beginning of a call."""
        equation, context, values = self.equation, self.context, dict[str, Interval]()
        known = zip(equation.units, equation.scales, equation.error.index, equation.error.fed, self.within, strict=True)
        for k, (unit, scale, i, fed, error) in enumerate(known, 1):
            low, high = ranges[i] if fed else (_NONE, _NONE)
            values[f"x{k}"] = point(scale / unit) * from_to(low - error, high + error)
        for j, most in enumerate(self.samples):
            seen = self._sample(j, ranges) + from_to(-most, most)
            values |= dict.fromkeys((f"y{j + 1}_last", f"y{j + 1}"), seen)
        for j, name in enumerate(context.file.inputs, 1):
            values |= dict.fromkeys((f"u{j}_last", f"u{j}"), from_to(*_finite(context.form.box[name])))
        return {name: Computed(self.precision, value) for name, value in values.items()}

    def _sample(self, output: int, ranges: Sequence[Side]) -> Interval:
        """The range of an output, from the beginning of a call to its end."""
        context = self.context
        moved = zip(context.z, ranges, self.moves, strict=True)
        box = {**context.form.box, **{z: (low - move, high + move) for z, (low, high), move in moved}}
        text = context.form.output[output]
        value: Interval = evaluate(text, {name: from_to(*box[name]) for name in text.names}, intervals)
        return value


def demand_rounding(
    equation: Equation,
    tableau: Tableau,
    h: Fraction,
    share: Mapping[str, Any],
    shares: Mapping[str, Mapping[str, Any]],
    totals: Sequence[Fraction],
) -> tuple[str, int]:
    """That the sizes of a share are those of its program, beside all `shares` which come to `totals` (N) in the units
    of the fields' states; what it assumes, in words, and with how many boxes. Raises: `NotShown`."""
    follows, context, boxes = share["follows"], equation.context, 0
    n, count, p = len(context.z), len(totals), len(context.form.output)
    errors, speeds = column(follows, "within", count), column(follows, "speeds", n)
    if any(error < total for error, total in zip(errors, totals, strict=True)):
        raise NotShown("the errors within which its program rounds are less than what all shares come to")
    for row, speed in zip(context.rates, speeds, strict=True):
        boxes += covered(narrowed(context.form.box, row.names), ".", ranged(row, -speed, speed))
    beside = [column(each, "beside", n) for each in shares.values() if each["beside"] != []]
    moves = [h * (speed + sum(each, _NONE)) for speed, *each in zip(speeds, *beside, strict=True)]
    noisy = [column(each, "samples", p) for each in shares.values() if each["samples"] != []]
    samples = [sum(each, _NONE) for each in zip(*noisy, strict=True)] or [_NONE] * p
    stages = len(tableau.weights)
    rounded = Rounded(
        equation=equation,
        tableau=tableau,
        h=h,
        program=listed(follows, count, stages),
        between=_one_of(follows, "between", _BETWEEN),
        precision=_one_of(follows, "precision", PRECISIONS),
        samples=samples,
        within=errors,
        moves=moves,
    )
    boxes += rounded.demand_sizes(column(share, "fields", count))
    return _said(rounded), boxes


def parameters_of(context: Context, follows: Mapping[str, Any]) -> dict[str, Fraction]:
    """The plant's parameters as the program has them, each in its range. Raises: `NotShown`."""
    names = context.file.parameters
    values = dict(zip(names, column(follows, "parameters", len(names)), strict=True))
    for name, value in values.items():
        low, high = context.form.box[name]
        if not low <= value <= high:
            raise NotShown(f"its program has {name} = {value}, outside the model's range")
    return values


def _said(rounded: Rounded) -> str:
    """What it is of, in words."""
    words = {word for word, _ in rounded.program.statements}
    functions = [f"{name} within {units / 2} ulps" for name, units in UNITS.items() if name in words]
    taken = f", where {', '.join(functions)}" if functions else ""
    return f"what {len(rounded.program.statements)} operations in {rounded.precision} round{taken}"


def _one_of(follows: Mapping[str, Any], key: str, known: Sequence[str]) -> str:
    value: str = part(follows, key, str)
    if value not in known:
        raise NotShown(f"its {key} is none of {', '.join(known)}")
    return value


def _finite(side: tuple[End, End]) -> Side:
    low, high = side
    if not (isinstance(low, Fraction) and isinstance(high, Fraction)):
        raise NotShown("a state or an input has no range")
    return low, high


def _moved(
    algebra: Algebra, x: Sequence[Quotient], rates: Sequence[Sequence[Quotient]], by: Sequence[Fraction]
) -> list[Quotient]:
    """x and each of the rates times its number."""
    result = list(x)
    for weight, rate in zip(by, rates, strict=False):
        if weight:
            result = [a + algebra.number(weight) * b for a, b in zip(result, rate, strict=True)]
    return result


@dataclass
class Besides:
    """Statements that stand for what a step has, the `marks`: by how much each is `beside` that, where it is; from then
    on its value is a letter."""

    algebra: Algebra
    walk: Walk
    marks: Mapping[str, str]
    beside: dict[str, list[Quotient]] = field(default_factory=dict)

    def take(self, operands: Sequence[str], wanted: Sequence[Quotient], letters: str = "") -> list[Quotient]:
        """The values of operands that stand for what is wanted. Raises: `NotShown`, and as the arithmetic."""
        for operand, value in zip(operands, wanted, strict=True):
            off = self.walk.as_computed(operand) - value
            if not any(map(self.algebra.is_zero, (self.walk.value(operand) - value, off))):
                self.beside.setdefault(operand, []).append(off)
        for k, operand in enumerate(operands if letters else ()):
            self.walk.rename(operand, self.algebra.letter(f"{letters} {k}"))
        return [self.walk.value(operand) for operand in operands]

    @property
    def statements(self) -> dict[str, Callable[[Walk, Computed], Computed]]:
        """By statement that is beside, what its value and its error are in the arithmetic of a precision."""
        return {operand: partial(self._off, each) for operand, each in self.beside.items()}

    def _off(self, each: Sequence[Quotient], walk: Walk, value: Computed) -> Computed:
        sizes = [
            intervals.function("Abs", (self.algebra.value(off, _Letters(walk, self.marks), intervals),)) for off in each
        ]
        return value.beside(reduce(add, sizes))


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
