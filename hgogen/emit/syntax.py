"""What a language is to the printers: one small description of how it writes a literal, a choice, a call, a loop.

The order of statements and of operations, what is named and how often, what is counted and laid out, does not differ
between languages and knows none of them. Texts with holes are those of `str.format`.
"""

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
    """An operation that no language here has."""

    operation: int

    def __str__(self) -> str:
        names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == self.operation]
        name = names[0] if names else self.operation
        return f"the operation {name} is one that no emitted language has; write the model without it"


@dataclass(eq=False)
class BeyondFloat(HgogenError):
    """A number that overflows to infinity, or underflows to 0, in the working precision."""

    value: float
    real: str

    def __str__(self) -> str:
        return f"{self.value:g} is beyond the range of {self.real}; choose other units, or real='double'"


@dataclass(eq=False)
class PointsMerge(HgogenError):
    """A table with two points that are one number in the working precision: it would jump there."""

    table: str
    points: tuple[float, float]
    real: str

    def __str__(self) -> str:
        a, b = self.points
        fix = 'take points further apart, or real="double"'
        return f"the table {self.table} has the points {a!r} and {b!r}, which are one number in {self.real}; {fix}"


def demand_apart(lookup: Lookup, real: Real) -> None:
    """Raise `PointsMerge` for a table whose points the working precision does not tell apart."""
    number = DTYPE[real]
    for axis in lookup.axes:
        for pair in pairwise(axis.breaks):
            if number(pair[0]) == number(pair[1]):
                raise PointsMerge(lookup.cells.name, pair, real)


@dataclass(eq=False)
class BadReal(HgogenError):
    """A working precision that is neither float nor double."""

    real: str

    def __str__(self) -> str:
        return f'real = {self.real!r} must be "float" or "double"'


def demand_real(real: str) -> None:
    """Raise `BadReal` for a precision that there is not."""
    if not among(real, ("float", "double")):
        raise BadReal(real)


@dataclass(frozen=True)
class Rows:
    """Numbers to be kept in their ranges: for each its place and its row, (low, high, nominal), as text; the text of
    the number of rows and of the largest number; the `type` of a number; what begins the names of our functions, and
    the statement that says so in the status."""

    places: tuple[str, ...]
    rows: tuple[tuple[str, str, str], ...]
    count: str
    largest: str
    type: str
    prefix: str
    raised: str


@dataclass(frozen=True)
class Syntax:
    """The syntax of a language.

    Meant are languages with braces, `;`, `==`, `true` and `false`, whose + - * / bind as those of C; those the printers
    write themselves. The names in braces are the holes of a text, and {} is the only one.

    - Numbers: `types` of each kind: float, double, unsigned (counters), index (a counter in the state), bool, void,
      and "whole float", "whole double" (a signed integer for the whole numbers of that precision), and where `instead`
      asks for them "word float", "word double";
      `truth_is_number`: whether a truth value is a number; `suffixes` of literals, by float, double, unsigned: a
      language that writes literals otherwise overrides `marked`; `cast`: {type}, {value}, toward zero from a real
      number to a whole one, of which 0 becomes +0; it binds as `casted`; `counted`: {}, {} of operations of counters
      that are not written as those of numbers; `rounded`, by float or double: {}, what is written around + - * / of
      real numbers where the language computes in more digits; the rest of its functions has to round by itself.
    - Names: `language`, its own; `name`, a user's as the language takes it: another one where that is `reserved`, which
      says by what; `parameters`: those that `emit.interface` calls otherwise; `reach`: {}, what leads from a parameter,
      or from a member at hand, to its own members.
    - Truth: `both` and `either`, the signs between two, which bind as && and || of C; `opposite`: {}.
    - Expressions: `choice`: {test}, {yes}, {no}, whose test and branches bind at least as tightly as `chosen` says;
      `index` into an array of structs.
    - Declarations: `constant`, `variable`: {type}, {name}, {value}; `fixed`, `gathered`: {type}, {name}, {size},
      {values}, an array in a function that is never written, of numbers or of what is computed; `array`: {type},
      {name}, {size}, {value}, which is written before it is read; `member`: {type}, {name}, {element}, the name of one
      of an array of structs.
    - Structs: `struct`, the type of one of each kind of `emit.structs`, of a prefix and that kind; `struct_member`:
      {type}, {name}, {size}, in its declaration, by whether it is an array.
    - Statements: `condition` and `repeated`: {}, open the block of a test; `loop` gives the head and the first lines of
      one of `k` from `first` to before `end` while `also` holds, and says whether k is used; `falling`: {k}, {first},
      {end}, opens one from `first` down to after `end`; `increment`: {}; `copied`: {target}, {source}, a member of an
      array of structs onto another, by value with all arrays and structs in it; `result`: {}; `raised`: {prefix},
      {bit}, a bit of the status; `called`, a section; `comment`.
    - Functions of a file's own: `function`, lines of {type}, {name}, {parameters}, with `parameter`: {type}, {name},
      and `array_parameter`: {type}, {name}, {size}, by whether it is written, or with `empty`; `params`: {prefix}, that
      of the struct of parameters, only read; `passed`: {}, an array as an argument, by whether it is written; `around`:
      lines before and after one of this name; `instead`, by its name: where the first holds, the other lines, with
      {type}, {suffix}, {word}, an unsigned number of as many bits, and numbers of `emit.elementary`, stand in the
      place of its body; where the first is empty, always.
    - Proofs: `analysed`, whether analysers read the language: of a `When` that is `idle` the test is a call of `acts`.
    - Vectors: `aligned`: {}, {upper}, where a loop of a kernel begins that may begin earlier, and how that binds.
    - Equality: `equal`, whether real numbers are compared by a function of ours in the place of ==.
    - Tables: `limited`, lines that keep numbers in their ranges by a loop over `Rows`; None where each is written out.
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
        """A number as the language writes it."""
        return self.marked(digits(value, kind), kind)

    def number(self, value: int) -> str:
        """A number by which a loop of its own counts, or an element of an array is named."""
        return self.literal(value, "unsigned")

    def marked(self, digits: str, kind: Number) -> str:
        """The digits of a number as a literal of its kind."""
        return f"{digits}{self.suffixes[kind]}"


def digits(value: float, kind: Number) -> str:
    """Shortest decimal that reads back as this number in the working precision; of a real number with a point or an
    exponent.

    Raises: `NotPrintable` for a counter that is not a whole number from 0; `BeyondFloat`.
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
    text = np.format_float_positional(number, trim="0") if 1e-4 <= abs(number) < 1e7 or number == 0 else f"{number!s}"
    return text if "." in text or "e" in text else f"{text}.0"
