"""A step, and its continuous observer, as CasADi functions of vectors with named elements.

step         (state, u, y, p) -> next, x, status    one call: the memory after it, the estimate, the status
derivative   (state, u, y, p) -> rate               of the observer's differential equations
estimate     (state, u, p) -> x                     from the state of these

`Symbolic` reads programs as one MX graph, from the values of places before a program to those after it. Blocks are
calls of their own graphs, which are not inlined: this preserves the order of operations, and so the bits. A condition
evaluates one of its two branches, so that a derivative is that of this branch. A loop calls its body for each member; a
member selected at run time is read and written by its index in the array.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import chain, product
from math import prod
from operator import add
from typing import Any, Literal

import casadi as ca
import numpy as np

from hgogen.discretisation.kernel_graphs import kernel_graph
from hgogen.graph import Graph
from hgogen.method import Explicit
from hgogen.part import Clock, Ode
from hgogen.program import (
    INF,
    Block,
    Call,
    Copy,
    Field,
    Group,
    Kernel,
    Loop,
    Place,
    Program,
    Reader,
    Statement,
    When,
    lines_of,
    places,
    sym,
)
from hgogen.reading.given import BadGain, BadNames, in_order, real, reals
from hgogen.signal import Signal, resting
from hgogen.step import Step
from hgogen.stepping.discretise import NoEquation, equation, tuned
from hgogen.stepping.guards import EXACT, LARGEST_NUMBER, limit_parameters
from hgogen.stepping.members import read_fields
from hgogen.stepping.times import T


@dataclass(frozen=True)
class Entry:
    """A named number in a `Vector`, with its unit and range; `array`: the name of its array, equal to `name` for a
    scalar; `label`: its name within the array."""

    name: str
    initial: float
    unit: str = ""
    low: float = -INF
    high: float = INF
    meaning: str = ""
    array: str = ""
    label: str = ""

    def __str__(self) -> str:
        return f"{self.name} = {self.initial:g} {self.unit}".rstrip() + f": {self.meaning}" * bool(self.meaning)


@dataclass(frozen=True, repr=False)
class Vector:
    """An argument or result of a CasADi function, as its named elements in order; `title` describes the vector."""

    title: str
    entries: tuple[Entry, ...]

    @property
    def names(self) -> list[str]:
        """The names of the elements, in their order."""
        return [entry.name for entry in self.entries]

    @property
    def initial(self) -> np.ndarray:
        """The initial values (n) of the elements."""
        return np.array([entry.initial for entry in self.entries])

    def filled(self, values: Mapping[str, Any]) -> np.ndarray:
        """Return the initial values (n) with replacements by name, of single elements or of arrays: {"theta": 30, "Q":
        [1, 2]} or, where elements have labels, {"Q": {"q": 1, "w": 2}}.

        Raises: `BadNames` for an unknown name; `BadGain` for values that are no real numbers, or for a wrong number of
        them.
        """
        elements: dict[str, float] = {}
        for name, value in values.items():
            entries = [entry for entry in self.entries if entry.array == name != entry.name]
            if not entries:
                elements[name] = value
                continue
            numbers = reals(name, in_order(name, value, (entry.label for entry in entries))).reshape(-1)
            if len(numbers) != len(entries):
                raise BadGain(f"{name} of {len(numbers)} numbers", f"must have {len(entries)}")
            elements |= {entry.name: float(number) for entry, number in zip(entries, numbers, strict=True)}
        default = dict(zip(self.names, self.initial, strict=True))
        ordered = in_order(f"the {self.title}", elements, self.names, default=default)
        return np.array([real(name, value) for name, value in zip(self.names, ordered, strict=True)])

    def index(self, name: str) -> int:
        """Return the index of an element. Raises: `BadNames`."""
        if any(entry.array == name != entry.name for entry in self.entries):
            raise BadNames(f"the {self.title}", f"names {name!r}, which is an array; name one of its elements")
        self.filled({name: 0.0})
        return self.names.index(name)

    def __len__(self) -> int:
        return len(self.entries)

    def __str__(self) -> str:
        return "\n".join([f"{self.title}:", *(f"  {entry}" for entry in self.entries)])

    def __repr__(self) -> str:
        return f"<{self.title}: {', '.join(self.names)}>"


def of_signals(title: str, signals: Iterable[Signal]) -> Vector:
    """Return the vector of signals; the initial value of each is its default value (`signal.resting`)."""
    return Vector(title, tuple(Entry(s.name, resting(s), s.unit, *s.interval, s.meaning, s.name) for s in signals))


def of_field(field: Field, unit: str, name: str = "") -> Iterator[Entry]:
    """Yield the elements of a field, in the unit `unit`; the elements of an array are called `name[0]`, `name[1]`,
    .."""
    name = name or field.name
    labels = field.labels or tuple(f"row {i}, column {j}" for i, j in field.entries) or ("",) * field.size
    for k, (value, (low, high), label) in enumerate(zip(field.initial, field.box, labels, strict=True)):
        several = field.size > 1
        meaning = f"{field.meaning} ({label})" if several and label else field.meaning
        yield Entry(f"{name}[{k}]" if several else name, float(value), unit, low, high, meaning, name, label)


def of_line(line: tuple[Group, ...], field: Field, unit: str) -> Iterator[Entry]:
    """Yield the elements, in memory order, of a field of nested groups; `line`: the groups from the outermost to the
    one with the field."""
    for members in product(*(range(group.count) for group in line)):
        path = ".".join(f"{group.name}[{k}]" for group, k in zip(line, members, strict=True))
        yield from of_field(field, unit, f"{path}.{field.name}")


def distinct(entries: Iterable[Entry], names: Iterable[str], prefix: str) -> tuple[Entry, ...]:
    """Return the entries, each renamed to `prefix.name` if the name of its array is among `names`."""
    names = set(names)
    return tuple(
        replace(e, name=f"{prefix}.{e.name}", array=f"{prefix}.{e.array}") if e.array in names else e for e in entries
    )


Memory = dict[Place, Graph]  # MX: a column (size); a table with a column for each member for a field of a group
Shape = tuple[int, int]


def shapes(fields: Iterable[Field], groups: Iterable[Group]) -> dict[Place, Shape]:
    """Return the shape of each place of a state, (size, 1) or (size, members); a group in a group has the inner members
    below one another in a column."""
    shape_by_place = {Place("state", field.name): (field.size, 1) for field in fields}
    for line in lines_of(groups):
        inner = prod(group.count for group in line[1:])
        shape_by_place |= {
            Place(line[-1].name, field.name): (field.size * inner, line[0].count) for field in line[-1].fields
        }
    return shape_by_place


@dataclass(frozen=True, eq=False)
class Symbolic(Reader[Memory]):
    """A translator of programs to CasADi MX expressions. `lines`: each group by its name, with its enclosing groups,
    the outermost first; `graph` returns the function of a block."""

    lines: Mapping[str, tuple[Group, ...]]
    graph: Callable[[Block], ca.Function]

    def section(self, program: Program, memory: Memory) -> Memory:
        """Return the values of all places after a program, as expressions of the values before; work values are 0
        before."""
        work = {place: ca.MX.zeros(size) for place, size in places(program) if place.struct == "work"}
        return self.program(program, {**memory, **work})

    def program(self, program: Iterable[Statement], *before: Memory) -> Memory:
        """Return the values of all places after statements, work places included, as expressions of the values
        before."""
        (memory,) = before
        for statement in program:
            memory = {**memory, **self.statement(statement, memory)}
        return memory

    def _block(self, block: Block, memory: Memory) -> Memory:
        results = self.graph(block).call([memory[place] for place, _ in block.reads])
        after = dict(zip(block.writes, results, strict=False))
        return after | {p: ca.logic_or(memory[p], value != 0) for p, value in after.items() if p.struct == "status"}

    def _when(self, when: When, memory: Memory) -> Memory:
        symbols = _symbols(memory)
        ends = self.program(when.body, symbols), self.program(when.otherwise, symbols)
        return _Choice(symbols, ends).at(memory[when.flag], memory)

    def _copy(self, copy: Copy, memory: Memory) -> Memory:
        total = self.lines[copy.group][-1].count
        source, target = (_number(memory[place], total) for place in (copy.source, copy.target))
        tables = {place: memory[place] for place in self._inside(copy.group, memory)}
        return {place: _with_column(table, target, _column(table, source)) for place, table in tables.items()}

    def _kernel(self, kernel: Kernel, memory: Memory) -> Memory:
        changed = [*([kernel.columns] if kernel.columns else []), *(place for place, _ in kernel.arguments)]
        graph = kernel_graph(kernel.name, kernel.size, tuple(size for _, size in kernel.arguments), kernel.counts)
        *values, returned = graph.call([memory[place] for place in changed])
        return dict(zip(changed, values, strict=True)) | ({kernel.result: returned} if kernel.result else {})

    def _call(self, call: Call, memory: Memory) -> Memory:
        return self.section(call.section.program, memory)

    def _loop(self, loop: Loop, memory: Memory) -> Memory:
        total = self.lines[loop.group][-1].count
        rows = {}
        for place in self._inside(loop.group, memory):  # the shape of one member's share
            line, size = self.lines[place.struct], memory[place].shape[0]
            deeper = line[[each.name for each in line].index(loop.group) + 1 :]
            rows[place] = (size // deeper[0].count, deeper[0].count) if deeper else (size, 1)
        symbols = _symbols(memory, rows)
        body = _Choice(symbols, (self.program(loop.body, symbols), symbols))
        first, memory = _number(memory[loop.start], total) if loop.start else None, dict(memory)
        for k in range(loop.count):
            member = k if first is None else ca.fmod(first + k, total)
            runs = memory[loop.active] > k if loop.active else ca.MX(1)
            if loop.index:
                memory[loop.index] = ca.if_else(runs, member, memory[loop.index])
            now = {**memory, **{place: ca.reshape(_column(memory[place], member), *rows[place]) for place in rows}}
            then = body.at(runs, now)
            memory |= {p: _with_column(memory[p], member, value) if p in rows else value for p, value in then.items()}
        return memory

    def _inside(self, group: str, memory: Memory) -> list[Place]:
        return [place for place in memory if any(each.name == group for each in self.lines.get(place.struct, ()))]


class _Choice:
    """The results of two branches of a condition, of which a
    flag selects one; a constant flag selects at once."""

    def __init__(self, symbols: Memory, ends: tuple[Memory, Memory]) -> None:
        self.written = [p for p in symbols if any(end[p] is not symbols[p] for end in ends)]
        results = [[end[place] for place in self.written] for end in ends]
        used = {symbol.name() for symbol in ca.symvar(ca.veccat(*results[0], *results[1]))}
        self.read = [place for place, symbol in symbols.items() if symbol.name() in used]
        arguments = [symbols[place] for place in self.read]
        self.yes, self.no = (ca.Function("branch", arguments, values) for values in results)

    def at(self, flag: Graph, memory: Memory) -> Memory:
        arguments = [memory[place] for place in self.read]
        if not self.written:
            return {}
        if flag.is_constant():
            results = (self.yes if float(flag) else self.no).call(arguments)
        else:
            results = ca.Function.if_else("choice", self.yes, self.no).call([flag, *arguments])
        return dict(zip(self.written, results, strict=True))


def _symbols(memory: Memory, rows: Mapping[Place, Shape] | None = None) -> Memory:
    shaped = {place: value.shape for place, value in memory.items()} | dict(rows or {})
    return {place: ca.MX.sym(f"m{k}", *shape) for k, (place, shape) in enumerate(shaped.items())}


def _number(place: Graph, total: int) -> Graph:
    """Return the index of a group's member, 0 if it is not below `total`, as the emitted C does."""
    return ca.if_else(place < total, place, 0)


def _at(table: Graph, member: Graph) -> Graph:
    rows = table.shape[0]
    return rows * member + ca.DM(range(rows))


def _column(table: Graph, member: Graph | int) -> Graph:
    return table[:, member] if isinstance(member, int) else table.nz[_at(table, member)]


def _with_column(table: Graph, member: Graph | int, value: Graph) -> Graph:
    changed = ca.MX(table)
    if isinstance(member, int):
        changed[:, member] = ca.vec(value)
    else:
        elements: Graph = ca.vec(value)
        changed.nz[_at(table, member)] = elements
    return changed


@dataclass(frozen=True)
class Flow:
    """The observer as a differential equation: `derivative`, the function (state, u, y, p) -> rate; `estimate`, the
    function (state, u, p) -> x; `state`, the vector of stored values; `constant`, the names of fields whose rate is
    0."""

    derivative: ca.Function
    estimate: ca.Function
    state: Vector
    constant: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Graphs:
    """The CasADi functions of the step `source`: of one call, and of the observer's differential equation; `graph`
    returns the CasADi function of a block."""

    source: Step
    graph: Callable[[Block], ca.Function]

    @cached_property
    def memory(self) -> Vector:
        """All stored numbers of the step between two calls, as a vector with names."""
        step = self.source
        entries = [entry for field in step.layout.state for entry in self._of(field)]
        for line in lines_of(step.layout.groups):
            entries += [entry for field in line[-1].fields for entry in of_line(line, field, step.unit(field))]
        return Vector("memory", tuple(entries))

    @cached_property
    def inputs(self) -> tuple[Vector, Vector, Vector]:
        """Three vectors with names: u, y, and the parameters: the gains, then the plant's tunable parameters."""
        step = self.source
        layout = step.layout
        gains = [entry for field in layout.gains for entry in self._of(field)]
        plant = distinct((e for f in layout.plant for e in self._of(f)), (g.name for g in layout.gains), "plant")
        signals = of_signals("inputs", step.given), of_signals("outputs", step.samples)
        return *signals, Vector("parameters", (*gains, *plant))

    @cached_property
    def estimates(self) -> Vector:
        """The estimated states, as a vector with names."""
        return of_signals("estimates", self.source.states)

    @cached_property
    def reports(self) -> dict[str, Vector]:
        """The numbers of each report, as a vector with names."""
        vectors = {}
        for report in self.source.code.reports:
            pairs = zip(report.columns, (entry for field in report.fields for entry in self._of(field)), strict=True)
            entries = tuple(replace(entry, name=name, array=name) for name, entry in pairs)
            vectors[report.name] = Vector(report.name, entries)
        return vectors

    def step(self) -> ca.Function:
        """Return the function (state, u, y, p) -> next, x, status of one call, with the reports as further results; the
        status is one number for each 32 bits."""
        step, state, lies = (
            self.source,
            ca.MX.sym("state", len(self.memory)),
            shapes(self.source.layout.state, self.source.layout.groups),
        )
        (u, y, p), memory = self._symbols, {**self._tuned(step.code.tuning), **_parts(state, lies)}
        memory |= _scalars("input", step.given, u) | _scalars("output", step.samples, y)
        for section in step.code.sections:
            memory = self._symbolic.section(section.program, memory)
        x = self._estimated(memory)
        after = ca.veccat(*(memory[place] for place in lies))
        raised = [memory[bit.place] for bit in step.layout.raised] or [ca.MX(0)]
        words = [raised[k : k + EXACT] for k in range(0, len(raised), EXACT)]
        status = ca.vertcat(*(reduce(add, (2.0**k * each for k, each in enumerate(word))) for word in words))
        results = {"next": after, "x": x, "status": status} | self._reported(memory)
        arguments = ["state", "u", "y", "p"]
        return ca.Function(f"{step.name}_step", [state, u, y, p], [*results.values()], arguments, [*results])

    def begin(self) -> ca.Function | None:
        """Return the function t -> state, the memory before a call at the time t; None for a plant without functions of
        t."""
        lies, t = shapes(self.source.layout.state, self.source.layout.groups), ca.MX.sym("t")
        memory = {**_parts(ca.MX(self.memory.initial), lies), T: t}
        for section in self.source.code.time:
            memory = self._symbolic.section(section.program, memory)
            state = ca.veccat(*(memory[place] for place in lies))
            return ca.Function(f"{self.source.name}_begin", [t], [state], ["t"], ["state"])
        return None

    def flow(self) -> Flow:
        """Return the observer as x' = f(x, u, y, p). Raises: `NoEquation` for one that has no differential equation."""
        if self.source.ages:
            raise NoEquation("a delayed observer", "it goes back to samples of the past")
        if self.source.observer.form.system.discrete:
            raise NoEquation("an observer of a discrete plant", "the plant moves from sample to sample")
        if self.source.observer.form.system.times:
            raise NoEquation(
                "an observer with functions of t", "its rates read more than u and y, the t that the step counts"
            )
        elements = [field for ode in self._odes for field in ode.fields]
        others = read_fields([self.source.observer.z, *self._rates.values()]) | self._rates.keys()
        others -= {"u", *(field.name for field in elements)}
        (u, y, p), name, fields = (
            self._symbols,
            self.source.name,
            [*elements, *(f for f in self.source.layout.state if f.name in others)],
        )
        state = ca.MX.sym("state", sum(field.size for field in fields))
        derived = chain.from_iterable(tuned(part, self._clock) for part in self.source.observer.parts)
        tuning = limit_parameters(*self.source.layout.limited, tuple(derived))
        memory = {**self._tuned(tuning), **_parts(state, {Place("state", f.name): (f.size, 1) for f in fields})}
        inputs = len(self.source.inputs)
        memory |= {Place("state", "u"): u[:inputs], Place("work", "u"): u[:inputs]} if inputs else {}
        memory[Place("work", "valid")] = valid = ca.fabs(y) <= LARGEST_NUMBER
        memory[Place("work", "y")] = ca.if_else(valid, y, 0)  # without an effect, see `Ode`
        rates = [ca.SX(self._rates.get(field.name, ca.SX.zeros(field.size))) for field in fields]
        rates_written = {Place("work", "rate"): ca.vertcat(*rates)}
        rate = self._symbolic.program((Block("the rates", rates_written),), memory)[Place("work", "rate")]
        arguments = ["state", "u", "y", "p"]
        return Flow(
            ca.Function(f"{name}_derivative", [state, u, y, p], [rate], arguments, ["rate"]),
            ca.Function(f"{name}_estimate", [state, u, p], [self._estimated(memory)], ["state", "u", "p"], ["x"]),
            Vector("continuous state", tuple(entry for field in fields for entry in self._of(field))),
            tuple(field.name for field, rate in zip(fields, rates, strict=True) if rate.is_zero()),
        )

    # --- the continuous observer

    @property
    def _clock(self) -> Clock:
        return self.source.clock

    @cached_property
    def _odes(self) -> list[Ode]:
        method = self.source.method
        view: Literal["information", "covariance"] = method.view if isinstance(method, Explicit) else "covariance"
        return [ode for part in self.source.observer.parts if (ode := equation(part, view))]

    @cached_property
    def _rates(self) -> dict[str, Graph]:
        clock, rates = self._clock, dict[str, Graph]()
        u, y = sym("work", "u", clock.inputs), sym("work", "y", clock.outputs)
        for ode in self._odes:
            values = {field.name: sym("state", field.name, field.size) for field in ode.fields}
            rates |= ode.rhs(values, u, y, clock.valid)
        return rates

    # --- what both share

    @property
    def _symbolic(self) -> Symbolic:
        return Symbolic({line[-1].name: line for line in lines_of(self.source.layout.groups)}, self.graph)

    @cached_property
    def _symbols(self) -> list[Graph]:
        return [ca.MX.sym(name, len(vector)) for name, vector in zip("uyp", self.inputs, strict=True)]

    def _of(self, field: Field) -> Iterable[Entry]:
        return of_field(field, self.source.unit(field))

    def _tuned(self, tuning: Program) -> Memory:
        step = self.source
        lies = {
            Place(kind, f.name): (f.size, 1)
            for kind, fields in (("gain", step.layout.gains), ("plant", step.layout.plant))
            for f in fields
        }
        zeros = {Place("derived", f.name): ca.MX.zeros(f.size) for f in step.layout.derived}
        bits = {bit.place: ca.MX(0) for bit in step.layout.bits}
        return self._symbolic.section(tuning, {**zeros, **bits, **_parts(self._symbols[2], lies)})

    def _reported(self, memory: Memory) -> dict[str, Graph]:
        results = {}
        for report in self.source.code.reports:
            places = {Place(report.struct, field.name): ca.MX.zeros(field.size) for field in report.fields}
            values = self._symbolic.section(report.program, memory | places)
            results[report.name] = ca.veccat(*(values[place] for place in places))
        return results

    def _estimated(self, memory: Memory) -> Graph:
        values = self._symbolic.section(self.source.code.estimate, memory)
        return ca.vertcat(*(values[Place("estimate", signal.name)] for signal in self.source.states))


def _parts(vector: Graph, lies: dict[Place, Shape]) -> Memory:
    memory, start = Memory(), 0
    for place, shape in lies.items():
        memory[place] = ca.reshape(vector[start : start + prod(shape)], *shape)
        start += prod(shape)
    return memory


def _scalars(struct: str, signals: Iterable[Signal], vector: Graph) -> Memory:
    return {Place(struct, signal.name): vector[k] for k, signal in enumerate(signals)}
