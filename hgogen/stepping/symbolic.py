"""CasADi's reading of programs, as one MX graph: what places hold after a program, of what they held before.

Blocks are calls of their own graphs, which are not written into one another: the order of operations stays, and so do
the bits. A condition runs one of its two branches, so that a derivative is that of the branch taken. A loop calls its
body for each member; a member that is chosen as the program runs is read and written at its place in the array.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import prod

import casadi as ca

from hgogen.discretisation.kernel_graphs import kernel_graph
from hgogen.graph import Graph
from hgogen.program import (
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
)

Memory = dict[Place, Graph]  # MX: a column (size), of a field of a group a table with a column for each member
Shape = tuple[int, int]


def shapes(fields: Iterable[Field], groups: Iterable[Group]) -> dict[Place, Shape]:
    """How a state lies in memory; of a group in a group, a column holds all its members, one after the other."""
    shape_by_place = {Place("state", field.name): (field.size, 1) for field in fields}
    for line in lines_of(groups):
        inner = prod(group.count for group in line[1:])
        shape_by_place |= {
            Place(line[-1].name, field.name): (field.size * inner, line[0].count) for field in line[-1].fields
        }
    return shape_by_place


@dataclass(frozen=True, eq=False)
class Symbolic(Reader[Memory]):
    """A reader of programs over groups, each by its name with those that it lies in, the outermost first; `graph` gives
    the function of a block."""

    lines: Mapping[str, tuple[Group, ...]]
    graph: Callable[[Block], ca.Function]

    def section(self, program: Program, memory: Memory) -> Memory:
        """The memory after a program whose work values are its own."""
        work = {place: ca.MX.zeros(size) for place, size in places(program) if place.struct == "work"}
        return self.program(program, {**memory, **work})

    def program(self, program: Iterable[Statement], *known: Memory) -> Memory:
        """The memory after statements, of that before them, which has their work values."""
        (memory,) = known
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
    """Two ends of the same beginning, of which one is taken; where the choice is known there is none."""

    def __init__(self, symbols: Memory, ends: tuple[Memory, Memory]) -> None:
        self.written = [p for p in symbols if any(end[p] is not symbols[p] for end in ends)]
        results = [[end[place] for place in self.written] for end in ends]
        used = {symbol.name() for symbol in ca.symvar(ca.veccat(*results[0], *results[1]))}
        self.read = [place for place, symbol in symbols.items() if symbol.name() in used]
        arguments = [symbols[place] for place in self.read]
        self.yes, self.no = (ca.Function("branch", arguments, values) for values in results)

    def at(self, flag: Graph, memory: Memory) -> Memory:
        """The places that the taken branch writes, with their values."""
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
    """The number of a member, 0 where it is beyond the last, as in C."""
    return ca.if_else(place < total, place, 0)


def _at(table: Graph, member: Graph) -> Graph:
    """Where the column of a member lies in a table."""
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
