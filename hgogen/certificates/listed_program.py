"""A call's program as a certificate lists it: one operation a statement, of names, numbers and statements before it.

    x1, ..   the elements of the fields      y1_last, y1, ..   samples, of the last call and of this one
    v1, ..   the statements                  u1_last, u1, ..   inputs alike

A constant stands as the number of which a few roundings of a double make it: a gain of the observer, the end of a range
in the unit of a field, a number of the plant, else the simplest quotient, else as it is printed. What leaves a number
as it is, a product with 1 or a sum with 0, is no statement.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from numbers import Rational
from typing import Any

import casadi as ca
import sympy as sp

from hgogen.analysis.evidence import text
from hgogen.certificates.one_call import Columns, after_call
from hgogen.discretisation.routine import RATE
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.prove.inclusion import Inclusion
from hgogen.rigor.box import box
from hgogen.rigor.computed import FOLDED, Unsure
from hgogen.rigor.points import exact
from hgogen.step import Step

_SIMPLE = 10**6  # the largest denominator of a simple quotient, far from those of doubles
_DIGITS = 40  # of a number that is no quotient


@dataclass(frozen=True)
class Operand:
    """What a statement takes: by its `text`, and its value where it is a number."""

    text: str
    number: Fraction | None = None


@dataclass(frozen=True)
class Listing:
    """The statements; the elements of the fields (N) at which each stage has the observer's equation, what that gives
    there, and the fields after the call."""

    statements: tuple[str, ...]
    stages: tuple[tuple[str, ...], ...]
    rates: tuple[tuple[str, ...], ...]
    after: tuple[str, ...]


def listed(step: Step, error: Inclusion) -> Listing | None:
    """The program of a step whose observer has this error; None where a certificate cannot list it: of tables, loops
    over matrices, and tests that are not of numbers."""
    form, numbers = step.observer.form, _flat(error.numbers.values())
    gains = (Fraction(x) for x in numbers if isinstance(x, float | Rational))
    scales, units = error.scales(Fraction(1)), error.remembered(Fraction(1))
    ends = list[Fraction]()  # of the ranges of states, in the units of their fields
    for i, scale, unit in zip(error.layout.index, scales or (), units or (), strict=False):
        declared = box((form.states[i],))[form.states[i]]
        ends += [end * scale / unit for end in declared if isinstance(end, Fraction)]
    writer = _Writer((*map(_number, (*gains, *ends)), *_constants(form)))
    fields = [Operand(f"x{k + 1}") for k in range(len(error.N))]
    samples = [_named("y", end, len(form.output)) for end in ("_last", "")]
    inputs = [_named("u", end, len(step.inputs)) for end in ("_last", "")]
    try:
        after = after_call(writer, step, fields, samples, inputs)
    except Unsure:
        return None
    return _pruned(writer, after)


def _pruned(writer: "_Writer", after: Sequence[Operand]) -> Listing:
    """Without statements that nothing reads, in their numbers."""
    wanted = {each.text for row in (*writer.stages, *writer.rates, after) for each in row}
    statements = {operand.text: said for said, operand in writer.statements.items()}
    for name in reversed(statements):
        wanted |= {*statements[name].split()} if name in wanted else set()
    names = {name: f"v{i}" for i, name in enumerate((name for name in statements if name in wanted), 1)}

    def renamed(operands: Iterable[str]) -> tuple[str, ...]:
        return tuple(names.get(operand, operand) for operand in operands)

    listed = (" ".join(renamed(statements[name].split())) for name in names)
    stages, rates = (
        tuple(renamed(each.text for each in row) for row in rows) for rows in (writer.stages, writer.rates)
    )
    return Listing(tuple(listed), stages, rates, renamed(each.text for each in after))


def _named(name: str, end: str, count: int) -> list[Operand]:
    return [Operand(f"{name}{j + 1}{end}") for j in range(count)]


def _constants(form: Form) -> list[Operand]:
    """The numbers that stand in the plant, and what is a number of each sum and product: 2 pi of 2 pi f t."""
    nodes = {node for row in (*form.A, *form.b, *form.output) for node in sp.preorder_traversal(exact(row))}
    parts = {node.as_independent(*node.free_symbols)[0] for node in nodes if node.is_Add or node.is_Mul}
    numbers = {x for x in nodes | parts if x.is_number and x.is_real and x.is_finite}
    constants = []
    for x in sorted(numbers, key=sp.default_sort_key):
        value = Fraction(str(x)) if x.is_Rational else Fraction(str(x.evalf(_DIGITS)))
        constants.append(Operand(text(form, x).replace(" ", ""), value))
    return constants


def _flat(values: Iterable[Any]) -> Iterable[Any]:
    """The numbers in lists of lists."""
    for value in values:
        yield from _flat(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)


@dataclass(frozen=True)
class _Writer:
    """An arithmetic whose values are operands: what it computes it writes."""

    known: Sequence[Operand]
    statements: dict[str, Operand] = field(default_factory=dict)
    stages: list[list[Operand]] = field(default_factory=list)
    rates: list[list[Operand]] = field(default_factory=list)

    def held(self, number: float) -> Operand:
        return _number(Fraction(repr(number)))

    def constant(self, number: float) -> Operand:
        if not math.isfinite(number):
            raise Unsure("a constant that is no number")
        value = Fraction(number)
        candidates = [_number(value.limit_denominator(_SIMPLE)), _number(Fraction(repr(number)))]
        nearest = min(self.known, key=lambda known: _off(known, value), default=candidates[0])
        most = abs(value) * Fraction(FOLDED, 2**53)
        return next(known for known in (nearest, *candidates) if _off(known, value) <= most)

    def call(self, function: Graph, columns: Columns, body: Callable[[Columns], Columns]) -> Columns:
        results = body(columns)
        if function.name() == RATE:
            rates = [each for column in results for each in column]
            self.stages.append([each for column in columns for each in column][: len(rates)])
            self.rates.append(rates)
        return results

    def apply(self, op: int, values: list[Operand]) -> Operand:
        same = _unchanged(op, values)
        if same:
            return same
        if op not in _WORDS or (op in _POWERS and values[1].number is None):
            raise Unsure("an operation that is not listed")
        word, order = _WORDS[op]
        said = " ".join((word, *(each.text for each in order(values))))
        return self.statements.setdefault(said, Operand(f"v{len(self.statements) + 1}"))


def _off(known: Operand, value: Fraction) -> Fraction:
    assert known.number is not None
    return abs(known.number - value)


def _number(value: Fraction) -> Operand:
    return Operand(str(value), value)


def _unchanged(op: int, values: list[Operand]) -> Operand | None:
    """What an operation leaves as it is, or makes of numbers without rounding."""
    known = [each.number for each in values]
    if op in _TESTS and None not in known:
        return _number(Fraction(_TESTS[op](*known)))
    if op == ca.OP_IF_ELSE_ZERO and known[0] is not None:
        return values[1] if known[0] else values[0]
    for one, other in ((0, -1), (-1, 0)):
        if op == ca.OP_ADD and known[one] == 0:
            return values[other]
        if op == ca.OP_MUL and known[one] in (0, 1):
            return values[other] if known[one] else values[one]
    return None


_TESTS: Mapping[int, Callable[..., Any]] = {
    ca.OP_NEG: lambda a: -a,
    ca.OP_LT: lambda a, b: a < b,
    ca.OP_LE: lambda a, b: a <= b,
    ca.OP_NOT: lambda a: not a,
    ca.OP_AND: lambda a, b: a and b,
    ca.OP_OR: lambda a, b: a or b,
}
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)
Order = Callable[[list[Operand]], list[Operand]]


def _as_is(values: list[Operand]) -> list[Operand]:
    return values


def _sorted(values: list[Operand]) -> list[Operand]:
    """Numbers at the end, where the order is none of the operation's."""
    return sorted(values, key=lambda each: each.number is not None)


def _after(number: int) -> Order:
    """The values after a number."""
    return lambda values: [_number(Fraction(number)), *values]


_FUNCTIONS = (
    *("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
_WORDS: Mapping[int, tuple[str, Order]] = {
    ca.OP_ADD: ("add", _as_is),
    ca.OP_SUB: ("sub", _as_is),
    ca.OP_MUL: ("mul", _as_is),
    ca.OP_DIV: ("div", _as_is),
    ca.OP_NEG: ("neg", _as_is),
    ca.OP_SQ: ("square", _as_is),
    ca.OP_TWICE: ("mul", _after(2)),
    ca.OP_INV: ("div", _after(1)),
    ca.OP_FABS: ("Abs", _as_is),
    ca.OP_FMIN: ("Min", _sorted),
    ca.OP_FMAX: ("Max", _sorted),
    ca.OP_SQRT: ("sqrt", _as_is),
    **dict.fromkeys(_POWERS, ("pow", _as_is)),
    **{getattr(ca, f"OP_{name.upper()}"): (name, _as_is) for name in _FUNCTIONS},
}
