"""A call's program as a certificate lists it, read and walked in any arithmetic.

    x1, ..   the elements of the fields      y1_last, y1, ..   samples, of the last call and of this one
    v1, ..   the statements                  u1_last, u1, ..   inputs alike

A statement is an operation and what it takes, which is a name, a number, an expression of numbers, or a statement
before it.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

from .arithmetic import Arithmetic, evaluate
from .box import NotShown
from .file import part
from .matrix import entries
from .text import HIGHEST, ONE_ARGUMENT, Expression, Unreadable, expression, is_number, number

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
    if sum(word not in _OPERATIONS for word, _ in statements) > _FUNCTIONS:
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
    if word in _OPERATIONS:
        count, operation = _OPERATIONS[word]
    elif word in ONE_ARGUMENT:
        count, operation = 1, lambda x: arithmetic.function(word, (x,))
    elif word in ("Min", "Max"):
        count, operation = 2, lambda x, y: arithmetic.function(word, (x, y))
    elif word == "sqrt":
        count, operation = 1, lambda x: arithmetic.root(x, Fraction(1, 2))
    else:
        raise NotShown(f"its program has the operation {word!r}, whose rounding is not known")
    if len(values) != count:
        raise NotShown(f"its program takes {word!r} of {len(values)} values")
    return operation(*values)


_OPERATIONS: Mapping[str, tuple[int, Callable[..., Any]]] = {
    "add": (2, lambda a, b: a + b),
    "sub": (2, lambda a, b: a - b),
    "mul": (2, lambda a, b: a * b),
    "div": (2, lambda a, b: a / b),
    "neg": (1, lambda a: -a),
    "square": (1, lambda a: a * a),
}
