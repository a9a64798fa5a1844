"""The syntax of a language for the printers: how it writes a literal, a choice, a call, a loop.

The order of statements and operations, names, counts and layout are the same in all languages. Texts with holes are
those of `str.format`.
"""

# Takes apart: a decimal, of which it leaves out a point and zero.

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import casadi as ca
import numpy as np

from hgogen.emit.interface import Entry
from hgogen.errors import HgogenError
from hgogen.reading.given import among
from hgogen.rigor.lookup import Lookup

Real = Literal["float", "double"]
Number = Literal["float", "double", "unsigned"]  # blocks of counters compute in unsigned

DTYPE: Mapping[str, Any] = {"float": np.float32, "double": np.float64}
BYTES: Mapping[Real, int] = {"float": 4, "double": 8}
SUM, PRODUCT, UNARY, ATOM = 4.0, 5.0, 6.0, 7.0  # how tightly an operation binds, loosest first
SELECT, OR, AND, EQUAL, ORDER = 0.0, 1.0, 2.0, 2.5, 3.0


@dataclass(eq=False)
class NotPrintable(HgogenError):
    """The error for an operation that no emitted language has."""

    operation: int

    def __str__(self) -> str:
        names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == self.operation]
        name = names[0] if names else self.operation
        return f"the operation {name} is one that no emitted language has; write the model without it"


@dataclass(eq=False)
class BeyondFloat(HgogenError):
    """The error for a number that overflows to infinity, or underflows to 0, in the working precision."""

    text = "{value:g} is beyond the range of {real}; choose other units, or real='double'"
    value: float
    real: str


@dataclass(eq=False)
class PointsMerge(HgogenError):
    """The error for a table in which two points are equal in the working precision, which would be a jump."""

    table: str
    points: tuple[float, float]
    real: str

    def __str__(self) -> str:
        a, b = self.points
        fix = 'take points further apart, or real="double"'
        return f"the table {self.table} has the points {a!r} and {b!r}, which are one number in {self.real}; {fix}"


def demand_apart(lookup: Lookup, real: Real) -> None:
    """Raise `PointsMerge` for a table with points that are equal in the working precision."""
    number = DTYPE[real]
    for axis in lookup.axes:
        for pair in pairwise(axis.breaks):
            if number(pair[0]) == number(pair[1]):
                raise PointsMerge(lookup.cells.name, pair, real)


@dataclass(eq=False)
class BadReal(HgogenError):
    """The error for a working precision that is neither float nor double."""

    text = 'real = {real!r} must be "float" or "double"'
    real: str


def demand_real(real: str) -> None:
    """Raise `BadReal` for a working precision other than "float" and "double"."""
    if not among(real, ("float", "double")):
        raise BadReal(real)


@dataclass(frozen=True)
class Rows:
    """The texts of a loop that limits numbers to their ranges: the place and the row (low, high, nominal) of each
    number; the count of rows, the largest number, the `type` of a number, the prefix of functions, and the statement
    that sets the status bit (`raised`)."""

    places: tuple[str, ...]
    rows: tuple[tuple[str, str, str], ...]
    count: str
    largest: str
    type: str
    prefix: str
    raised: str


@dataclass(frozen=True)
class Syntax:
    """The syntax of a language in which steps are emitted: its words, and texts with holes.

    The printers themselves write braces, `;`, `==`, `true`, `false` and + - * /, which bind as in C. Names in braces
    are the holes of a text, and {} is a single one.

    Numbers: `types` of each kind: float, double, unsigned (counters), index (a counter in the state), bool, void, and
    "whole float", "whole double" (a signed integer for the whole numbers of that precision), and where `instead` needs
    them "word float", "word double"; `truth_is_number`: whether a truth value is a number; `suffixes` of literals, by
    float, double, unsigned (a language with other literals overrides `marked`); `cast`: {type}, {value}, toward zero
    from a real number to a whole one, where 0 becomes +0; it binds as `casted`; `counted`: {}, {}, operations of
    counters that differ from those of numbers; `rounded`, by float or double: {}, the text around a result of + - * /
    where the language computes in more digits; its other functions must round by themselves.

    Names: `language`, its own; `name`: a user's name in the language, which differs where it is `reserved` (the reason
    in words); `parameters` that have another name than in `emit.interface`; `reach`: {}, from a parameter, or from the
    current member of a group, to its members.

    Truth: `both` and `either`, the operators between two, which bind as && and || of C; `opposite`: {}.

    Expressions: `choice`: {test}, {yes}, {no}, whose test and branches bind at least as tightly as `chosen` says;
    `index` into an array of structs.

    Declarations: `constant`, `variable`: {type}, {name}, {value}; `fixed`, `gathered`: {type}, {name}, {size},
    {values}, a constant array in a function, of numbers or of computed values; `array`: {type}, {name}, {size},
    {value}, which is written before it is read; `member`: {type}, {name}, {element}, a name for a member of an array of
    structs.

    Structs: `struct`: the type of a struct, from a prefix and its kind in `emit.structs`; `struct_member`: {type},
    {name}, {size}, a declaration in it, by whether that is an array.

    Statements: `condition` and `repeated`: {}, open the block of a test; `loop`: the head and the first lines of a loop
    of `k` from `first` to before `end` while `also` holds, given whether k is used; `falling`: {k}, {first}, {end},
    opens a loop from `first` down to after `end`; `increment`: {}; `copied`: {target}, {source}, a member of an array
    of structs onto another, by value with all arrays and structs in it; `result`: {}; `raised`: {prefix}, {bit}, a bit
    of the status; `called`, a section; `comment`.

    Static functions: `function`, lines of {type}, {name}, {parameters}, with `parameter`: {type}, {name}, and
    `array_parameter`: {type}, {name}, {size}, by whether it is written, or with `empty`; `params`: {prefix}, the struct
    of parameters, read only; `passed`: {}, an array as an argument, by whether it is written; `around`, by name: lines
    before and after a function; `instead`, by name: a preprocessor condition, under which the other lines replace the
    body, always if it is empty; these have {type}, {suffix}, {word}, an unsigned number of as many bits, and constants
    of `emit.elementary`.

    The others: `analysed`, whether static analysers read the language; then the test of an `idle` `When` is a call of
    `acts`. `aligned`: {}, {upper}, the first index of a kernel's loop that may start earlier, and how tightly it binds.
    `equal`, whether a function compares real numbers instead of ==. `limited`, lines that limit numbers to their ranges
    by a loop over `Rows`; None: each is written out.
    """

    language: str
    reserved: str
    types: Mapping[str, str]
    suffixes: Mapping[str, str]
    truth_is_number: bool
    name: Callable[[str], str]
    reach: str
    parameters: Mapping[str, str]
    choice: str
    chosen: tuple[float, float]
    cast: str
    casted: float
    constant: str
    variable: str
    array: str
    fixed: str
    gathered: str
    condition: str
    repeated: str
    loop: Callable[[str, str, str, str, bool], Sequence[str]]
    falling: str
    increment: str
    index: Callable[[str, str], str]
    member: str
    read_member: str
    struct: Callable[[str, str], str]
    struct_member: Mapping[bool, str]
    passed: Mapping[bool, str]
    parameter: str
    array_parameter: Mapping[bool, str]
    params: str
    function: Sequence[str]
    empty: str
    result: str
    raised: str
    called: Callable[[str, Entry], str]
    comment: Callable[[str], str]
    counted: Mapping[int, str] = field(default_factory=dict)
    around: Mapping[str, tuple[Sequence[str], Sequence[str]]] = field(default_factory=dict)
    instead: Mapping[str, Sequence[str]] = field(default_factory=dict)
    both: str = " && "
    either: str = " || "
    opposite: str = "!{}"
    analysed: bool = False
    copied: str = "{target} = {source};"
    equal: bool = False
    limited: "Callable[[Rows], Sequence[str]] | None" = None
    rounded: Mapping[str, str] = field(default_factory=dict)
    aligned: tuple[str, float] = ("{}", SELECT)

    def literal(self, value: float, kind: Number) -> str:
        """Return the literal of a number of the type `kind`."""
        return self.marked(digits(value, kind), kind)

    def number(self, value: int) -> str:
        """Return the text of an integer that a loop counts to, or that indexes an array."""
        return self.literal(value, "unsigned")

    def marked(self, digits: str, kind: Number) -> str:
        """Return the decimal `digits` as a literal of the type `kind`, such as 0.5f."""
        return f"{digits}{self.suffixes[kind]}"


def shortest(value: float, real: Real) -> str:
    """Return the shortest decimal text that reads back as `value` in the working precision, without a decimal point for
    a whole number."""
    return digits(value, real).removesuffix(".0")


def digits(value: float, kind: Number) -> str:
    """Return the shortest decimal text that reads back as `value` in the type `kind`; a real number has a decimal point
    or an exponent.

    Raises: `NotPrintable` for a counter that is no integer from 0 on; `BeyondFloat`.
    """
    if kind == "unsigned":
        if value < 0 or value != int(value):
            raise NotPrintable(ca.OP_CONST)
        return str(int(value))
    if kind == "double":
        return repr(float(value))
    with np.errstate(over="ignore", under="ignore"):
        number = np.float32(value)
    if np.isinf(number) or (number == 0 and value != 0):
        raise BeyondFloat(value, kind)
    positional = 1e-4 <= abs(number) < 1e7 or number == 0
    text = (np.format_float_positional if positional else np.format_float_scientific)(number, trim="-")
    return text if "." in text or "e" in text else f"{text}.0"
