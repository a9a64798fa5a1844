"""The statements of a program as C text, and the structs they work on.

Memory in C: `in`, `out` (what a call is given), `p` (parameters), `s` (state), `x` (estimate); work values are locals
at the top of a function; a member of a group is reached through a pointer named after the group.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from hgogen.emit.ccode import TRUTH, Code, Uses, braced, code, indented, joined
from hgogen.emit.cfunction import REACHED, of_section, own, reached
from hgogen.emit.cnames import c_name
from hgogen.emit.cprint import UNARY, Number, Operand, Printer, Real, Target, body, literal
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
    Section,
    Statement,
    When,
    address,
    lines_of,
    places,
    walk,
)
from hgogen.step import Step

_SIGNALS = ("input", "output", "plant", "estimate")  # structs whose members a user has named
ARGUMENTS = ("s", "p", "in", "out", "x", "status", "i", "k")
Member = tuple[str, str]  # the declaration of a struct's member, and what is said of it


@dataclass(frozen=True, eq=False)
class Writer:
    """C text of a step's programs."""

    step: Step
    real: Real

    @property
    def prefix(self) -> str:
        """What every C name begins with."""
        return self.step.name

    @cached_property
    def _fields(self) -> dict[Place, Field]:
        step = self.step
        kinds = {"state": step.state, "plant": step.plant, "gain": step.gains, "derived": step.derived}
        kinds |= {name: line[-1].fields for name, line in self._groups.items()}
        return {Place(kind, f.name): f for kind, fields in kinds.items() for f in fields}

    @cached_property
    def _groups(self) -> dict[str, tuple[Group, ...]]:
        return {line[-1].name: line for line in lines_of(self.step.groups)}

    def _array(self, group: str) -> Place:
        """The place of the array of a group: in the state, or in the member of the group around it."""
        above = self._groups[group][:-1]
        return Place(above[-1].name if above else "state", group)

    @cached_property
    def flags(self) -> set[Place]:
        """Work places that are truth values."""
        return {s.flag for s in walk(self._all) if isinstance(s, When)}

    @cached_property
    def _indices(self) -> set[Place]:
        """Work places that count or index."""
        loops = [s for s in walk(self._all) if isinstance(s, Loop)]
        found = {place for loop in loops for place in (loop.start, loop.active, loop.index) if place}
        found = {place for place in found if place.struct == "work"}
        while more := self._work - self.flags - found - self._reals(found):
            found |= more
        return found

    def _reals(self, indices: set[Place]) -> set[Place]:
        """Work places that take more than a copy of a counter, or of one of `indices`."""
        counters = {place for place, item in self._fields.items() if item.kind == "index"} | indices
        values = ((place, v) for s in walk(self._all) if isinstance(s, Block) for place, v in s.writes.items())
        written = self._work - {place for s in walk(self._all) if isinstance(s, Block) for place in s.writes}
        return written | {place for place, value in values if not _copied(value, counters)}

    @cached_property
    def _work(self) -> set[Place]:
        return {place for place, _ in places(self._all) if place.struct == "work"}

    @cached_property
    def _all(self) -> Program:
        timed = (s for section in self.step.timed for s in section.program)
        return (*self.step.program, *self.step.tuning, *timed)

    def is_index(self, place: Place) -> bool:
        """Whether C holds the place as `unsigned`."""
        known = self._fields.get(place)
        counts = known is not None and known.kind == "index"
        return counts or place in self._indices or place.struct == "argument"

    def lvalue(self, place: Place, index: int, size: int) -> str:
        """C text of one element of a place."""
        return self.whole(place) if size == 1 else f"{self.whole(place)}[{index}]"

    def whole(self, place: Place) -> str:
        """C text of a place, of an array its first element's address."""
        if place.struct in ("work", "argument"):
            return place.name
        parameter, member = REACHED.get(place.struct, (place.struct, ""))  # of a group: the pointer named after that
        return f"{parameter}->{member}{c_name(place.name) if place.struct in _SIGNALS else place.name}"

    def _uses(self, *places: Place | None) -> Uses:
        """The parameters that places are reached through."""
        return Uses(parameters=frozenset(reached(place for place in places if place)))

    def function(self, program: Program) -> Code:
        """The body of a function: its work values, then its statements."""
        work = sorted((p, n) for p, n in places(program) if p.struct == "work")
        declared = joined(self._declaration(place, size) for place, size in work)
        taken = {place.name for place, _ in work} | set(ARGUMENTS) | set(self._groups)
        taken |= {f"{letter}{depth}" for letter in "ik" for depth in range(2, self._depth(program) + 1)}
        return declared + self.statements(program, frozenset(taken))

    def _depth(self, program: Program) -> int:
        """How deep the loops lie in each other."""
        return max((len(self._groups[s.group]) for s in walk(program) if isinstance(s, Loop)), default=0)

    def _declaration(self, place: Place, size: int) -> Code:
        name = place.name
        if place in self.flags and size == 1:
            return Code((f"bool {name} = false;",), TRUTH)
        if place in self._indices:
            return code(f"unsigned {name} = 0u;")
        zero = literal(0, self.real)
        return code(f"{self.real} {name} = {zero};" if size == 1 else f"{self.real} {name}[{size}];")

    def statements(self, program: Iterable[Statement], taken: frozenset[str]) -> Code:
        """Every statement in order."""
        return joined(self._statement(statement, taken) for statement in program)

    def _statement(self, statement: Statement, taken: frozenset[str]) -> Code:
        match statement:
            case Block():
                return self._block(statement, taken)
            case Loop():
                return self._loop(statement, taken)
            case When():
                return self._when(statement, taken)
            case Copy():
                return self._copy(statement)
            case Call():
                return called(self.step, statement.section)
            case Kernel():
                return self._kernel(statement)

    def _when(self, when: When, taken: frozenset[str]) -> Code:
        name = when.flag.name
        lines = code(f"if ({name}) {{") + self.statements(when.body, taken).indented()
        if when.otherwise:
            lines += code("} else {") + self.statements(when.otherwise, taken).indented()
        return lines + code("}")

    def _loop(self, loop: Loop, taken: frozenset[str]) -> Code:
        group, array = loop.group, self.whole(self._array(loop.group))
        depth, total = len(self._groups[group]), self._groups[group][-1].count
        k, i = (letter if depth == 1 else f"{letter}{depth}" for letter in "ki")
        kind = f"{self.prefix}_{group} *const {group}"
        inner = self.statements(loop.body, taken)
        uses = self._uses(self._array(group), loop.start, loop.active, loop.index)
        uses |= Uses(widest=max(loop.count, total if loop.start else 0))
        test = f"{k} < {loop.count}u" + (f" && {k} < {self.whole(loop.active)}" if loop.active else "")
        head = f"for (unsigned {k} = 0u; {test}; ++{k}) {{"
        number = [f"{self.whole(loop.index)} = {k if loop.start is None else i};"] if loop.index else []
        if loop.start is None:
            before = Code((f"{kind} = &{array}[{k}];", *number), uses)
            return braced(head, before + inner)
        start = self.whole(loop.start)
        if loop.count == 1:
            return braced("{", Code((f"{kind} = &{array}[{within(start, total)}];",), uses) + inner)
        wrap = (f"if ({i} >= {total}u) {{", f"    {i} = 0u;", "}")
        before = Code((*wrap, f"{kind} = &{array}[{i}];", *number), uses)
        return braced("{", code(f"unsigned {i} = {start};") + braced(head, before + inner + code(f"++{i};")))

    def _copy(self, copy: Copy) -> Code:
        array, total = self._array(copy.group), self._groups[copy.group][-1].count
        numbers = (within(self.whole(place), total) for place in (copy.target, copy.source))
        target, source = (f"{self.whole(array)}[{number}]" for number in numbers)
        return Code((f"{target} = {source};",), self._uses(array, copy.target, copy.source) | Uses(widest=total))

    def _kernel(self, kernel: Kernel) -> Code:
        given = [self._array(kernel.columns.struct)] if kernel.columns else []
        given += [place for place, _ in kernel.arguments]
        call = f"{self.prefix}_{kernel.name}({', '.join(map(self.whole, given))})"
        uses = self._uses(*given) | Uses(kernels=frozenset({(kernel.name, kernel.size)}))
        return Code((f"{self.whole(kernel.result)} = {call};" if kernel.result else f"{call};",), uses)

    def _block(self, block: Block, taken: frozenset[str]) -> Code:
        reads, written = block.reads, set(block.writes)
        real: Number = "unsigned" if self.counts(block) else self.real
        printer = Printer(
            real=real,
            prefix=self.prefix,
            inputs=lambda argument, element: self._read(*reads[argument], element, real),
            local=lambda argument, element: self._local(*reads[argument], element),
            is_flag=lambda argument: reads[argument][0] in self.flags,
            taken=set(taken),
        )
        sources = {place: argument for argument, (place, _) in enumerate(reads)}
        targets = [
            self._target(place, element, size, sources.get(place), real)
            for place, size in ((place, ca.SX(value).numel()) for place, value in block.writes.items())
            for element in range(size)
        ]
        names = [
            name if size == 1 else f"{name}{element + 1}"
            for name, size in ((name, ca.SX(value).numel()) for name, value in block.names.items())
            for element in range(size)
        ]
        hoist = [argument for place, argument in sources.items() if place in written]
        constants, statements = body(printer, block.graph, targets, names, hoist)
        if not statements.lines:
            return Code()
        if constants.lines:
            return code(comment(block.title)) + braced("{", constants + statements)
        return code(comment(block.title)) + statements

    def counts(self, block: Block) -> bool:
        """Whether a block works on counters and flags only, and so computes in `unsigned`."""
        touched = [place for place, _ in block.reads] + [p for p in block.writes if p.struct != "status"]
        return bool(touched) and all(self.is_index(place) or place in self.flags for place in touched)

    def _read(self, place: Place, size: int, element: int, real: Number) -> Operand:
        text, uses = self.lvalue(place, element, size), self._uses(place)
        if place.struct == "argument" or (self.is_index(place) and real != "unsigned"):
            return Operand(f"({real}){text}", UNARY, local=False, uses=uses)
        return Operand(text, local=size == 1 and place.struct == "work", uses=uses)

    def _local(self, place: Place, size: int, element: int) -> str:
        """Name of an element as a local: z1, L21, or that of the scalar."""
        kind, name = place
        if kind == "argument":
            return f"{name}_given"
        if (
            kind != "work" and Place("work", name) in self._work
        ):  # u: the input now; u_given: as it came; u_before: at the last call
            name += {"input": "_given", "output": "_given", "state": "_before"}.get(kind, f"_{kind}")
        known = self._fields.get(place)
        if known and known.entries:
            return _entry(name, known.entries[element])
        return name if size == 1 else f"{name}{element + 1}"

    def _target(self, place: Place, element: int, size: int, argument: int | None, real: Number) -> Target:
        if place.struct == "status":
            return Target(lambda _: f"status |= {self.prefix.upper()}_{place.name};", condition=True)
        target, uses = self.lvalue(place, element, size), self._uses(place)
        source = None if argument is None else (argument, element)
        if self.is_index(place) and real != "unsigned":
            return Target(lambda text: f"{target} = (unsigned)({text});", source=source, uses=uses)
        flag = place in self.flags and size == 1
        return Target(lambda text: f"{target} = {text};", flag=flag, source=source, uses=uses)


def _copied(value: Any, places: set[Place]) -> bool:
    """Whether each element of an SX is that of one of the places."""
    elements = (ca.SX(value)[i] for i in range(ca.SX(value).numel()))
    return all(element.is_symbolic() and address(element)[0] in places for element in elements)


def called(step: Step, section: Section) -> Code:
    """The call of a section, its status taken over."""
    function = of_section(step, section)
    return code(f"status |= {function.call(own)};", parameters=map(own, function.parameters))


def within(index: str, total: int) -> str:
    """C text of an index, the first member's where it is beyond the last."""
    return f"({index} < {total}u) ? {index} : 0u"


def member(real: str, item: Field) -> Member:
    """A struct's member; said of it are meaning, elements, range, unit."""
    kind = "unsigned" if item.kind == "index" else real
    size = "" if item.size == 1 else f"[{item.size}]"
    return f"{kind} {item.name}{size};", describe(item)


def named(item: Field) -> Field:
    """A field of the plant's parameters by its name in C, with its own beside it where that is another."""
    name = c_name(item.name)
    return item if name == item.name else replace(item, name=name, meaning=beside(item.name, item.meaning))


def beside(name: str, text: str) -> str:
    """What is said of a member that has another name in C: its own, then the rest."""
    return f"{name}: {text}" if text else name


def describe(item: Field) -> str:
    """Meaning, elements, unit and range of a field."""
    parts = [item.meaning] if item.meaning else []
    if elements := item.labels or tuple(_entry(item.name, entry) for entry in item.entries):
        parts.append(", ".join(elements))
    text = ": ".join(parts)
    ranges = {(low, high) for low, high in item.box if low > -INF and high < INF}
    if item.unit:
        text += f" [{item.unit}]"
    if item.kind == "real" and len(ranges) == 1 and all(low > -INF for low, _ in item.box):
        low, high = ranges.pop()
        text += f", {low:g} .. {high:g}" if low < high else f", fixed at {low:g}"
    return text


def _entry(name: str, entry: tuple[int, int]) -> str:
    """`L21` of row 2, column 1."""
    return f"{name}{entry[0]}{entry[1]}"


def comment(text: str) -> str:
    """A C comment that its text cannot end."""
    return f"/* {harmless(text)} */" if text else ""


def harmless(text: str) -> str:
    """Text that neither ends nor opens a comment, on one line and without trigraphs."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").splitlines())


def struct(name: str, lines: Iterable[str], head: str = "typedef struct {") -> list[str]:
    """typedef struct { ... } name;"""
    return [head, *indented(lines), f"}} {name};"]


def members(items: Iterable[Member]) -> list[str]:
    """Their lines, with the comments in one column."""
    items = list(items)
    width = max((len(declared) for declared, _ in items), default=0)
    return [f"{declared:{width}} {comment(text)}".rstrip() for declared, text in items]
