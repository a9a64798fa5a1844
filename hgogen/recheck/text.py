"""Expressions of a certificate as straight-line programs, and the base class of the checker's errors.

The reader shares no code with the rest of hgogen, which writes certificates. Its grammar:

    sum: term (+ - term)*    term: factor (* / factor)*    factor: - factor | atom ** factor
    atom: number | name | function(sum, ...) | (sum)

A table is a function with its order and its points as further arguments (`tables`).

The certificate declares every name. A text that is too long or too deep is rejected, so that a hostile file costs
nothing.
"""

import re
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from operator import add, mul, neg, sub, truediv
from typing import Any, ClassVar, NamedTuple

from .tables import KINDS, is_table, name_of


class RecheckError(Exception):
    """The base class of errors of the verifier, whose text names the fault and the fix. `status`: the exit status of a
    command, 2 for a file that is no certificate, 1 for one that is not verified."""

    status: ClassVar[int] = 2


LONGEST = 100_000  # characters of one expression
DEEPEST = 60  # nested brackets, signs and powers
LARGEST = 300  # digits of a number, so that a float holds it
_BEYOND = 10**LARGEST
HIGHEST = 1000  # whole exponent

ONE_ARGUMENT = frozenset(
    (
        *("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "Abs", "sign"),
    )
)
KINKS = ("Abs", "sign", "Min", "Max")
MANY_ARGUMENTS = frozenset(("Min", "Max"))
TWO_ARGUMENTS = frozenset(("atan2",))

OPERATIONS: Mapping[str, Callable[..., Any]] = {"add": add, "sub": sub, "mul": mul, "div": truediv, "neg": neg}
_SIGNS = {"+": "add", "-": "sub"}, {"*": "mul", "/": "div"}
_TOKEN = re.compile(r"\s*(?:(\d+(?:\.\d+)?(?:[eE][+-]?\d{1,4})?)|([A-Za-z_][A-Za-z0-9_]*)|(\*\*|[-+*/(),]))", re.ASCII)
_NUMBER = re.compile(r"-?(?:\d+(?:\.\d+)?|\d+/0*[1-9]\d*)\Z", re.ASCII)


@dataclass(eq=False)
class Unreadable(RecheckError):
    """The error that a text of a certificate is no expression or number of its grammar."""

    text: str
    reason: str

    def __str__(self) -> str:
        return f"{self.fault}; write the certificate again with hgogen check --certificate"

    @property
    def fault(self) -> str:
        """The fault in words, without the fix."""
        printed = self.text if len(self.text) <= 80 else f"{self.text[:77]}..."
        return f"cannot read {printed!r}: {self.reason}"


class Instruction(NamedTuple):
    """An instruction that computes one value. `op`: "number" (`value`: a Fraction), "symbol" (`value`: its name),
    "add", "sub", "mul", "div", "neg", "power" (`value`: an integer exponent), "root" (`value`: a rational one),
    "raise", or a function's name; `args`: the indices of earlier instructions."""

    op: str
    args: tuple[int, ...] = ()
    value: Fraction | int | str | None = None


@dataclass(frozen=True)
class Expression:
    """An expression: its `instructions` in order, the index `result` of its value, and the `names` that it reads."""

    text: str
    instructions: tuple[Instruction, ...]
    result: int
    names: frozenset[str]

    @property
    def kinked(self) -> bool:
        """Return whether the expression has a modulus, a sign, a minimum, a maximum or a table."""
        return any(step.op in KINKS or is_table(step.op) for step in self.instructions)

    def __hash__(self) -> int:
        return hash((self.text, self.result))  # as fast as the hash of a text, which Python caches


def number(text: object) -> Fraction:
    """Return the exact number of a text such as "-7/2" or "0.05". Raises: `Unreadable`."""
    if not isinstance(text, str) or not _NUMBER.match(text):
        raise Unreadable(_quoted(text), 'a number is a text, "p/q" or a decimal')
    if len(text) <= 2 * LARGEST:
        value = Fraction(text)
        if max(abs(value.numerator), value.denominator) < _BEYOND:
            return value
    raise Unreadable(text, f"a number has more than {LARGEST} digits")


def is_number(text: str) -> bool:
    """Return whether a text is a number, not an expression."""
    return bool(_NUMBER.match(text))


def kind_of(value: object) -> str:
    """Return a description of a JSON value that is not a text."""
    names = {type(None): "null", list: "a list", dict: "an object", bool: "a truth value"}
    return names.get(type(value), "a number that is no text")


def _quoted(value: object) -> str:
    return value if isinstance(value, str) else kind_of(value)


def expression(text: object, declared: Container[str]) -> Expression:
    """Return a text as an `Expression` in the names `declared`; `pi` is the number unless it is declared. Raises:
    `Unreadable`."""
    if not isinstance(text, str):
        raise Unreadable(_quoted(text), "an expression is a text")
    if len(text) > LONGEST:
        raise Unreadable(text, f"it has more than {LONGEST} characters")
    reader = _Reader(text, declared)
    result = reader.sum(0)
    if reader.token:
        raise reader.fault(f"{reader.token!r} stands where it should end")
    places = tuple(reader.places)
    names = frozenset(str(place.value) for place in places if place.op == "symbol")
    return Expression(text, places, result, names)


class _Reader:
    """A parser with one token of look-ahead; equal subexpressions share one instruction."""

    def __init__(self, text: str, declared: Container[str]) -> None:
        self.text, self.declared = text, declared
        self.places: dict[Instruction, int] = {}
        self.numbers: dict[int, Fraction] = {}
        self.tokens = self._tokens()
        self.token, self.kind = "", ""
        self.next()

    def fault(self, reason: str) -> Unreadable:
        return Unreadable(self.text, reason)

    def _tokens(self) -> Iterator[tuple[str, str]]:
        at, text = 0, self.text.rstrip()
        while at < len(text):
            match = _TOKEN.match(text, at)
            if not match:
                raise self.fault(f"{text[at : at + 10]!r} is outside the grammar")
            at = match.end()
            yield match.group(match.lastindex or 0), ("number", "name", "sign")[(match.lastindex or 1) - 1]

    def next(self) -> str:
        passed = self.token
        self.token, self.kind = next(self.tokens, ("", ""))
        return passed

    def expect(self, token: str) -> None:
        if self.token != token:
            raise self.fault(f"{token!r} is missing")
        self.next()

    def put(self, op: str, args: tuple[int, ...] = (), value: Fraction | int | str | None = None) -> int:
        known = [self.numbers.get(arg) for arg in args]
        folded = value if op == "number" else self._fold(op, known)
        if isinstance(folded, Fraction):
            if max(abs(folded.numerator), folded.denominator) >= 10**LARGEST:
                raise self.fault(f"a number has more than {LARGEST} digits")
            op, args, value = "number", (), folded
        place = self.places.setdefault(Instruction(op, args, value), len(self.places))
        if isinstance(folded, Fraction):
            self.numbers[place] = folded
        return place

    def _fold(self, op: str, args: list[Fraction | None]) -> Fraction | None:
        numbers = [arg for arg in args if arg is not None]
        if not numbers or len(numbers) < len(args) or op not in OPERATIONS or (op == "div" and not numbers[1]):
            return None
        value: Fraction = OPERATIONS[op](*numbers)
        return value

    def sum(self, depth: int, signs: int = 0) -> int:
        """Parse a sum, term (+ - term)*; with `signs` 1 a term, factor (* / factor)*. Return the index of its
        instruction."""
        inner = self.factor if signs else partial(self.sum, signs=1)
        value = inner(depth)
        while self.token in _SIGNS[signs]:
            value = self.put(_SIGNS[signs][self.next()], (value, inner(depth)))
        return value

    def factor(self, depth: int) -> int:
        """Parse a factor, - factor | atom ** factor, and return the index of its instruction."""
        if depth > DEEPEST:
            raise self.fault(f"it is nested deeper than {DEEPEST}")
        if self.token == "-":
            self.next()
            return self.put("neg", (self.factor(depth + 1),))
        base = self.atom(depth)
        if self.token != "**":
            return base
        self.next()
        return self.power(base, self.factor(depth + 1))

    def power(self, base: int, exponent: int) -> int:
        known = self.numbers.get(exponent)
        if known is None:
            return self.put("raise", (base, exponent))
        if abs(known) > HIGHEST or known.denominator > HIGHEST:
            raise self.fault(f"the exponent {known} is too large")
        if known.denominator == 1:
            return self.put("power", (base,), int(known))
        return self.put("root", (base,), known)

    def atom(self, depth: int) -> int:
        """Parse an atom, number | name | function(sum, ...) | (sum), and return the index of its instruction."""
        kind, token = self.kind, self.next()
        if kind == "number":
            if len(token) > LARGEST or abs(int(token.lower().partition("e")[2] or 0)) > LARGEST:
                raise self.fault(f"a number has more than {LARGEST} digits")
            return self.put("number", value=Fraction(token))
        if kind == "name" and self.token == "(":
            return self.function(token, depth)
        if kind == "name" and (token in self.declared or token == "pi"):
            return self.put("symbol", value=token) if token in self.declared else self.put("pi")
        if kind == "name":
            raise self.fault(f"the name {token!r} is not declared")
        if token == "(":
            value = self.sum(depth + 1)
            self.expect(")")
            return value
        what = f"{token!r} stands" if token else "it ends"
        raise self.fault(f"{what} where a value should stand")

    def function(self, name: str, depth: int) -> int:
        """Parse function(sum, ...), and return the index of its instruction."""
        self.next()
        args = [self.sum(depth + 1)]
        while self.token == ",":
            self.next()
            args.append(self.sum(depth + 1))
        self.expect(")")
        if name in KINDS:
            return self.table(name, args)
        if name == "sqrt" and len(args) == 1:
            return self.put("root", (args[0],), Fraction(1, 2))
        if name in {1: ONE_ARGUMENT, 2: TWO_ARGUMENTS | MANY_ARGUMENTS}.get(len(args), MANY_ARGUMENTS):
            return self.put(name, tuple(args))
        raise self.fault(f"there is no rule for {name} of {len(args)}")

    def table(self, kind: str, args: list[int]) -> int:
        """Parse a table, kind(sum, .., order, .., x, y, x, y, ...): the arguments and orders of its kind, then numbers.
        Return the index of its instruction."""
        count, _ = KINDS[kind]
        numbers = [self.numbers.get(arg) for arg in args[count:]]
        known = [number for number in numbers if number is not None]
        if len(known) < len(numbers) or not known:
            raise self.fault(f"{kind} has an order and points that are numbers")
        try:
            return self.put(name_of(kind, known), tuple(args[:count]))
        except ValueError as error:
            raise self.fault(str(error)) from None
