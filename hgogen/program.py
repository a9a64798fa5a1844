"""The program of a step: straight-line blocks, loops over member structs, and conditions.

Every reader (Python's machine, the C printer, the operation counter) walks this one program. Memory is named by places,
a struct and a field of it:

    input, output     arguments of a call             plant, gain, derived   parameters; derived by `tune`
    state             memory between calls            <group>                a member of an array of structs
    estimate          results of a call               work, status           values and flags of one section
    argument          a counter given to one section

An expression is an SX graph over the symbols of `sym`, so that a block knows its inputs.
"""

# Takes apart: the name of a symbol, which can carry nothing else.

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import casadi as ca

from hgogen.graph import Graph, dense, sx

INF = float("inf")


class Place(NamedTuple):
    """A place in memory: a field of a struct, by their names."""

    struct: str
    name: str

    def __str__(self) -> str:
        return f"{self.struct}.{self.name}"


def sym(struct: str, name: str, size: int = 1) -> Graph:
    """Return the SX column (size) of a place, empty for size 0; equal arguments give the same symbols."""
    return _column(Place(struct, name), size)


@cache
def _column(place: Place, size: int) -> Graph:
    return column(ca.SX.sym(":".join((*place, str(index), str(size)))) for index in range(size))


def address(symbol: Graph) -> tuple[Place, int, int]:
    """Return (place, index, size) of one scalar element of a column from `sym`; the name of the element encodes
    them."""
    struct, name, index, size = symbol.name().split(":")
    return Place(struct, name), int(index), int(size)


def column(values: Iterable[Graph]) -> Graph:
    """Return the SX scalars as one SX column; an empty column for none."""
    values = list(values)
    if len(values) == 1:
        return sx(values[0])
    return ca.vertcat(*values) if values else ca.SX(0, 1)


@dataclass(frozen=True)
class Field:
    """A named array of a step's memory; with one element, a scalar in the emitted code.

    `kind`: `real`, or `index` for a counter; `initial`: its values after a reset; `low`, `high`: the box to which the
    step clamps it; `outer`: whether that is the outer box of the estimate, outside of which the theorem is suspended;
    `lasting`: whether it survives a restart from the sample, as knowledge of the plant and not of its state; `labels`:
    the names of its elements in reports and in the emitted code; `entries`: row and column of each, for a triangle of a
    matrix; `periods`: of each angle its period, of which the box is one turn, None for other elements.
    """

    name: str
    initial: tuple[float, ...]
    kind: Literal["real", "index"] = "real"
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    outer: bool = False
    lasting: bool = False
    labels: tuple[str, ...] = ()
    entries: tuple[tuple[int, int], ...] = ()
    periods: tuple[float | None, ...] = ()
    unit: str = ""
    meaning: str = ""

    @property
    def size(self) -> int:
        """Number of elements of the array."""
        return len(self.initial)

    @property
    def box(self) -> tuple[tuple[float, float], ...]:
        """(low, high) of each element, infinite where no box was given."""
        return tuple(zip(self.low or (-INF,) * self.size, self.high or (INF,) * self.size, strict=True))

    @property
    def turns(self) -> tuple[float | None, ...]:
        """The period of each element that is an angle, None for another element; the box of an angle is one turn."""
        return self.periods or (None,) * self.size

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """The box without the turns of angles, which limit nothing."""
        pairs = zip(self.box, self.turns, strict=True)
        return tuple((-INF, INF) if period else ends for ends, period in pairs)

    def box_within(self, limit: float) -> tuple[tuple[float, float], ...]:
        """Return the box, cut at +-limit."""
        return tuple((max(low, -limit), min(high, limit)) for low, high in self.box)


def scalar(name: str, initial: float, **data: Any) -> Field:
    """Return a field of one element; `data`: further members of the `Field`."""
    low, high = data.pop("low", -INF), data.pop("high", INF)
    return Field(name, (float(initial),), low=(low,), high=(high,), **data)


def stacked(fields: Iterable[Field]) -> Graph:
    """Return the elements of fields of the state as one SX column."""
    return ca.vertcat(*(sym("state", field.name, field.size) for field in fields))


@dataclass(frozen=True)
class Group:
    """An array of `count` equal structs in the state; `groups`: arrays of structs in each of them."""

    name: str
    count: int
    fields: tuple[Field, ...]
    meaning: str = ""
    groups: tuple["Group", ...] = ()


def lines_of(groups: Iterable[Group], above: tuple[Group, ...] = ()) -> Iterator[tuple[Group, ...]]:
    """Yield, for each group, the nested groups that contain it, from the outermost to itself; a group comes after its
    inner groups. `above`: the groups around all of these."""
    for group in groups:
        yield from lines_of(group.groups, (*above, group))
        yield (*above, group)


@dataclass(frozen=True)
class Bit:
    """A bit of the status word: its `name` for callers, its `meaning`, and the `action` expected of the caller, which
    `Step.action_of` completes.

    `raised`: the name of the place in `status` to which a block writes, if it differs from `name`.
    """

    name: str
    meaning: str
    action: str
    raised: str = ""

    @property
    def place(self) -> Place:
        """The place in `status` that a block sets to raise the bit."""
        return Place("status", self.raised or self.name)


def in_capitals(bits: Iterable[Bit]) -> tuple[Bit, ...]:
    """Return the bits with names in capitals, as C constants have them.

    A name that has capitals already stays; a repeated name gets a number.
    """
    bits = tuple(bits)
    names = {bit.place.name: bit.place.name for bit in bits if bit.place.name.isupper()}
    for place in (bit.place.name for bit in bits if not bit.place.name.isupper()):
        name, k = place.upper(), 2
        while name in names.values():
            name, k = f"{place.upper()}_{k}", k + 1
        names[place] = name
    return tuple(replace(bit, name=names[bit.place.name], raised=bit.place.name) for bit in bits)


@dataclass(frozen=True)
class Limit:
    """A clamped number: element `index` of the place (`size`), its ends `low` and `high`, and the `nominal` value in
    the place of a value that is not a number."""

    place: Place
    index: int
    size: int
    low: float
    high: float
    nominal: float


Sized = tuple[tuple[Place, int], ...]  # places with their sizes


class _Statement:
    """The interface of every statement: the names of its members
    that are places read, places written, and programs."""

    _read: tuple[str, ...] = ()
    _write: tuple[str, ...] = ()
    _inner: tuple[str, ...] = ()

    @property
    def reads(self) -> Sized:
        return self._scalars(self._read)

    @property
    def written(self) -> Sized:
        return self._scalars(self._write)

    @property
    def bodies(self) -> dict[str, "Program"]:
        return {name: getattr(self, name) for name in self._inner}

    def _scalars(self, names: Iterable[str]) -> Sized:
        return tuple((place, 1) for place in (getattr(self, name) for name in names) if place)


@dataclass(frozen=True, eq=False)
class Block(_Statement):
    """Straight-line code: every right-hand side is evaluated before anything is written.

    `writes`: place to SX column; a write to a place of `status` raises the bit of its name when the value is not 0.
    `names`: values with a name of their own in the emitted code. `limits`: the clamped numbers of a block that only
    clamps, for a printer of tables. `part`: the name of the part that begins with it, which may become a function in
    the emitted code where it occurs several times, or in a function that is too long. `spelled`: whether it is printed
    without loops, because it runs too often. `notes`: comments.
    """

    title: str
    writes: Mapping[Place, Graph]
    names: Mapping[str, Graph] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    part: str = ""
    spelled: bool = False
    notes: tuple[str, ...] = ()

    @cached_property
    def reads(self) -> Sized:
        """The places read, with their sizes, sorted."""
        values = list(map(sx, (*self.writes.values(), *self.names.values())))
        symbols = ca.Function("reads", [], values, {"allow_free": True}).free_sx()
        return tuple(sorted({(place, size) for place, _, size in map(address, symbols)}))

    @cached_property
    def written(self) -> Sized:
        """The places written, with their sizes, in the order of `writes`."""
        return tuple((place, sx(value).numel()) for place, value in self.writes.items())

    @cached_property
    def copies(self) -> Mapping[Place, frozenset[Place]]:
        """The source places of each place whose elements are all copies."""
        elements = {place: dense(sx(value)).nonzeros() for place, value in self.writes.items()}
        return {
            place: frozenset(address(one)[0] for one in each)
            for place, each in elements.items()
            if all(one.is_symbolic() for one in each)
        }

    @cached_property
    def graph(self) -> ca.Function:
        """The SX function from the places read to the places written and, after these, the values in `names`."""
        inputs = [sym(*place, size) for place, size in self.reads]
        values = [dense(value) for value in (*self.writes.values(), *self.names.values())]
        return ca.Function("block", inputs, values, {"cse": True})


@dataclass(frozen=True, eq=False)
class Loop(_Statement):
    """Run `body` for members `start`, `start` + 1, ... of `group`, `count` of them, wrapping round.

    `start` and `active` name index places: the first member (0 if none), and the number of wanted members (`count` if
    none); `index` is a place that receives each member's number.
    """

    group: str
    count: int
    body: tuple["Statement", ...]
    start: Place | None = None
    active: Place | None = None
    index: Place | None = None

    _read, _write, _inner = ("start", "active"), ("index",), ("body",)


@dataclass(frozen=True, eq=False)
class When(_Statement):
    """Run `body` if the scalar `flag` is not 0, else `otherwise`.

    `idle`: whether the body would change nothing where the flag is 0, and is skipped for its cost alone; a proof may
    then assume that it runs in any case. `part`: the name of the body, of which the emitted code may make a
    function.
    """

    flag: Place
    body: tuple["Statement", ...]
    otherwise: tuple["Statement", ...] = ()
    idle: bool = False
    part: str = ""

    _read, _inner = ("flag",), ("body", "otherwise")


@dataclass(frozen=True, eq=False)
class Repeat(_Statement):
    """A loop with numbers: run `body` once for each row k, after assigning the k-th numbers in `given` to its scalar
    places in `work`."""

    given: Mapping[Place, tuple[float, ...]]
    body: tuple["Statement", ...]

    _inner = ("body",)

    @property
    def written(self) -> Sized:
        """The places in `given`, which receive the numbers of a row."""
        return tuple((place, 1) for place in self.given)

    @cached_property
    def count(self) -> int:
        """The number of runs."""
        return len(next(iter(self.given.values())))

    @cached_property
    def unrolled(self) -> tuple["Statement", ...]:
        """The statements of all runs, one after the other: assignments of a row of numbers, then the body."""
        rows = zip(*self.given.values(), strict=True)
        starts = (Block("its numbers", dict(zip(self.given, map(ca.SX, row), strict=True))) for row in rows)
        return tuple(statement for start in starts for statement in (start, *self.body))


@dataclass(frozen=True, eq=False)
class Copy(_Statement):
    """Copy member number `source` of `group` to member number `target`; both name index places."""

    group: str
    source: Place
    target: Place

    _read = ("source", "target")


@dataclass(frozen=True, eq=False)
class Kernel(_Statement):
    """A matrix operation too large to unroll: `name` of `discretisation.kernels`, on places in its argument order.

    `columns`: a group's field of columns, None for a kernel without one; `arguments`: arrays, or numbers that are only
    read; `counts`: constants after them; `result`: the flag that receives the kernel's result.
    """

    name: str
    size: int
    columns: Place | None
    arguments: tuple[tuple[Place, int], ...] = ()
    result: Place | None = None
    counts: tuple[int, ...] = ()

    @property
    def reads(self) -> Sized:
        """The arguments."""
        return self.arguments

    @property
    def written(self) -> Sized:
        """The places that the kernel may write: all its arguments, and the place of its result."""
        return self.arguments + (((self.result, 1),) if self.result else ())


@dataclass(frozen=True, eq=False)
class Call(_Statement):
    """Run another section of the step, with work values of its own."""

    section: "Section"


Statement = Block | Loop | Repeat | When | Copy | Kernel | Call
Program = tuple[Statement, ...]


@dataclass(frozen=True, eq=False)
class Section:
    """A program that firmware can call as a function; `corrects`: the name of the output whose sample it uses, None for
    none."""

    name: str
    meaning: str
    program: Program
    corrects: str | None = None


@dataclass(frozen=True)
class Element:
    """A number of a step's memory, element `index` of a place (`size`), with its `name` in the results of a log."""

    name: str
    place: Place
    index: int = 0
    size: int = 1


@dataclass(frozen=True, eq=False)
class Report:
    """A function `name` by which a caller reads numbers about the estimate: the `program` computes the `fields` of a
    struct, of the kind `struct`, from the state; `columns`: the names of their elements in the results of a log;
    `notes`: sentences for the manual."""

    name: str
    struct: str
    meaning: str
    fields: tuple[Field, ...]
    program: Program
    columns: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def elements(self) -> tuple[Element, ...]:
        """The elements of the fields, in order."""
        each = ((Place(self.struct, field.name), i, field.size) for field in self.fields for i in range(field.size))
        return tuple(Element(name, *element) for name, element in zip(self.columns, each, strict=True))


def walk(program: Sequence[Statement]) -> Iterator[Statement]:
    """Yield every statement of a program, and every statement within another one; an outer statement comes before its
    inner ones."""
    pending = list(reversed(program))
    while pending:
        yield (statement := pending.pop())
        for body in reversed(statement.bodies.values()):
            pending += reversed(body)


def blocks(program: Sequence[Statement]) -> Iterator[Block]:
    """Yield every `Block` of a program, also those within other statements."""
    return (statement for statement in walk(program) if isinstance(statement, Block))


def places(program: Sequence[Statement]) -> set[tuple[Place, int]]:
    """Return every (place, size) that a program reads or writes, without the sections that it calls."""
    return {each for statement in walk(program) for each in (*statement.reads, *statement.written)}


def read(program: Sequence[Statement]) -> set[Place]:
    """Return every place whose value some statement of the program uses."""
    return {place for statement in walk(program) for place, _ in statement.reads}


def dangling(program: Sequence[Statement]) -> set[Place]:
    """Return the work places that the program reads but never writes. They are faults: emitted functions do not share
    work places."""
    written = {place for statement in walk(program) for place, _ in statement.written}
    return {place for place in read(program) if place.struct == "work"} - written


def pruned(program: Sequence[Statement]) -> Program:
    """Return the program without work values that no statement reads."""
    needed = read(program)

    def below(statements: Sequence[Statement]) -> Program:
        return tuple(each for statement in statements for each in without_unused(statement))

    def without_unused(statement: Statement) -> Program:
        if not isinstance(statement, Block):
            return (within(statement, below),) if statement.bodies else (statement,)
        writes = {p: v for p, v in statement.writes.items() if p.struct != "work" or p in needed}
        if len(writes) == len(statement.writes):
            return (statement,)
        return (replace(statement, writes=writes),) if writes else ()

    result = below(program)
    return result if read(result) == needed else pruned(result)


def within(statement: Statement, change: Callable[[Program], Program]) -> Statement:
    """Return the statement with `change` applied to each program in it."""
    bodies: dict[str, Any] = {name: change(body) for name, body in statement.bodies.items()}
    return replace(statement, **bodies)


T = TypeVar("T")


class Reader(Generic[T]):
    """The base class of functions on programs: a subclass has a method for each kind of statement, which returns its
    result, and `joined`, which combines the results of successive statements.

    `known`: information from the enclosing statements. A `Repeat` is evaluated as its unrolled statements, unless a
    reader has a method for it.
    """

    def program(self, program: Iterable[Statement], *known: Any) -> T:
        """Return the reader's result for a program, from the results of its statements."""
        return self.joined(self.statement(statement, *known) for statement in program)

    def statement(self, statement: Statement, *known: Any) -> T:
        """Return the reader's result for a statement, by the method for its kind."""
        result: T = getattr(self, f"_{type(statement).__name__.lower()}")(statement, *known)
        return result

    def joined(self, parts: Iterable[T]) -> T:
        """Return the result of successive statements from the result of each."""
        raise NotImplementedError

    def _repeat(self, repeat: Repeat, *known: Any) -> T:
        return self.program(repeat.unrolled, *known)
