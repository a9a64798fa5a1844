"""The statements of a program, and the functions of its routines, as text in a `Syntax`.

Memory: `in`, `measurement` (the arguments of a call), `p` (parameters), `s` (state), `x` (estimate), as the language
calls them; work values are locals at the top of a function; members of a group are reached through its name.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

from hgogen.discretisation.runge_kutta import MEANINGS
from hgogen.emit.code import NOTHING, TRUTH, Code, Uses, braced, code, joined
from hgogen.emit.interface import REACHED, entry, of_section, reached
from hgogen.emit.node import Subprogram, subprograms
from hgogen.emit.portable import passed
from hgogen.emit.printer import LEAST, NEVER, Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.syntax import Number, Real, Rows, Syntax
from hgogen.graph import sx
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
    Repeat,
    Section,
    When,
    blocks,
    lines_of,
    places,
    walk,
)
from hgogen.step import Step
from hgogen.stepping.guards import LARGEST_NUMBER
from hgogen.stepping.times import T


@dataclass(frozen=True, eq=False)
class Kinds:
    """The kind of each place (struct and field) of a step's memory: a field or group, a truth value, a counter."""

    step: Step

    @cached_property
    def fields(self) -> dict[Place, Field]:
        """The declared `Field` of each place in the state, the parameters, the groups and the reports."""
        layout = self.step.layout
        kinds = {"state": layout.state, "plant": layout.plant, "gain": layout.gains, "derived": layout.derived}
        kinds |= {name: line[-1].fields for name, line in self.groups.items()}
        kinds |= {report.struct: report.fields for report in self.step.code.reports}
        return {Place(kind, f.name): f for kind, fields in kinds.items() for f in fields}

    @cached_property
    def groups(self) -> dict[str, tuple[Group, ...]]:
        """The groups of memory (arrays of structs) by name, each after the groups around it, outermost first."""
        return {line[-1].name: line for line in lines_of(self.step.layout.groups)}

    @cached_property
    def flags(self) -> set[Place]:
        """The work variables that are truth values."""
        return {s.flag for s in walk(self._all) if isinstance(s, When)}

    @cached_property
    def indices(self) -> set[Place]:
        """The work variables that are counters or indices."""
        loops = [s for s in walk(self._all) if isinstance(s, Loop)]
        counters = {place for loop in loops for place in (loop.start, loop.active, loop.index) if place}
        counters = {place for place in counters if place.struct == "work"}
        while added := self.work - self.flags - counters - self._reals(counters):
            counters |= added
        return counters

    @cached_property
    def members(self) -> dict[Place, int]:
        """The number of members of a group, by each work variable whose only use is the index of a loop over these
        members."""
        written = {place for block in blocks(self._all) for place in block.writes}
        loops = [s for s in walk(self._all) if isinstance(s, Loop) and s.index]
        counts = [(s.index, self.groups[s.group][-1].count) for s in loops if s.index]
        return {p: max(n for q, n in counts if q == p) for p, _ in counts if p.struct == "work" and p not in written}

    @cached_property
    def work(self) -> set[Place]:
        """The work variables, which live during one call."""
        return {place for place, _ in places(self._all) if place.struct == "work"}

    def is_index(self, place: Place) -> bool:
        """Return whether a place of memory holds an unsigned integer."""
        known = self.fields.get(place)
        counts = known is not None and known.kind == "index"
        return counts or place in self.indices or place.struct == "argument"

    def counts(self, block: Block) -> bool:
        """Return whether a block reads and writes only counters and truth values, so that its arithmetic is
        unsigned."""
        touched = [place for place, _ in block.reads] + [p for p in block.writes if p.struct != "status"]
        return bool(touched) and all(self.is_index(place) or place in self.flags for place in touched)

    def _reals(self, indices: set[Place]) -> set[Place]:
        counters = {place for place, item in self.fields.items() if item.kind == "index"} | indices
        unwritten = self.work - {place for block in blocks(self._all) for place in block.writes}
        return unwritten | {
            place
            for block in blocks(self._all)
            for place in block.writes
            if place not in block.copies or not block.copies[place] <= counters
        }

    @cached_property
    def _all(self) -> Program:
        sections = (s for section in self.step.code.called for s in section.program)
        reports = (s for report in self.step.code.reports for s in report.program)
        return (*sections, *self.step.code.estimate, *reports, *self.step.code.tuning)


_SIGNALS = ("input", "output", "plant", "estimate", "deviations", "ages")  # structs whose members a user has named
ARGUMENTS = ("s", "p", "in", "measurement", "x", "status", "i", "k")


@dataclass(frozen=True, eq=False)
class Writer(Reader[Code]):
    """A writer of a step's programs in the language of `syntax`; `interval_calls`: whether a test low <= v <= high is a
    function call."""

    syntax: Syntax
    step: Step
    real: Real
    interval_calls: bool = False

    @property
    def prefix(self) -> str:
        """The prefix of every name that an emitted file defines: the step's name."""
        return self.step.name

    @property
    def least(self) -> int:
        """The smallest number of passes for which statements are written as a loop."""
        return LEAST[self.step.clock.prefer]

    @cached_property
    def kinds(self) -> Kinds:
        """The kinds (field, truth value, counter) of the step's places of memory."""
        return Kinds(self.step)

    @cached_property
    def bits(self) -> dict[Place, str]:
        """The names of the status bits, by the places of memory that raise them."""
        return {bit.place: bit.name for bit in self.step.layout.bits}

    @cached_property
    def subprograms(self) -> dict[str, Subprogram]:
        """The routines that the step calls, by their keys."""
        return subprograms(self.step)

    def _array(self, group: str) -> Place:
        above = self.kinds.groups[group][:-1]
        return Place(above[-1].name if above else "state", group)

    def lvalue(self, place: Place, index: int, size: int) -> str:
        """Return the text of element `index` of a place of memory that has `size` elements."""
        return self.place_text(place) if size == 1 else f"{self.place_text(place)}[{index}]"

    def place_text(self, place: Place) -> str:
        """Return the text of a place of memory, such as `state->z`; for an array the text without an index."""
        if place.struct in ("work", "argument", "time"):
            return place.name
        name, member = REACHED.get(place.struct, (place.struct, ""))  # of a group: the name of the current member
        start = self.syntax.reach.format(self.syntax.parameters.get(name, name)) + (f"{member}." if member else "")
        return f"{start}{self.syntax.name(place.name) if place.struct in _SIGNALS else place.name}"

    def number(self, place: Place, index: int = 0, size: int = 1) -> str:
        """Return the text of element `index` of a place of memory (`size`); a counter is converted to a real number."""
        return self._read(place, size, index, self.real).text

    def uses(self, *places: Place | None) -> Uses:
        """Return as `Uses` the function parameters through which code reaches these places of memory."""
        return Uses(parameters=frozenset(reached(place for place in places if place)))

    def function(self, program: Program) -> Code:
        """Return the body of a function: declarations of its work variables, then the statements of the program."""
        work = sorted((p, n) for p, n in places(program) if p.struct == "work")
        declared = joined(self._declaration(place, size) for place, size in work)
        reserved = {place.name for place, _ in work} | set(ARGUMENTS) | set(self.kinds.groups)
        reserved |= {T.name} if self.step.code.time else set()
        reserved |= {*self.syntax.parameters.values(), *(report.name for report in self.step.code.reports)}
        depths = (len(self.kinds.groups[s.group]) for s in walk(program) if isinstance(s, Loop))
        reserved |= {f"{letter}{depth}" for depth in range(2, max(depths, default=0) + 1) for letter in "ik"}
        return declared + self.program(program, frozenset(reserved))

    def kind(self, place: Place, size: int) -> Number | Literal["bool"]:
        """Return the type of a work variable with `size` elements."""
        if place in self.kinds.flags and size == 1:
            return "bool"
        return "unsigned" if place in self.kinds.indices else self.real

    def _declaration(self, place: Place, size: int) -> Code:
        kind = self.kind(place, size)
        zero = "false" if kind == "bool" else self.syntax.literal(0, kind)
        text = self.syntax.variable if size == 1 or kind == "unsigned" else self.syntax.array
        count = self.syntax.literal(size, "unsigned")
        line = text.format(type=self.syntax.types[kind], name=place.name, value=zero, size=size, count=count)
        return Code((line,), TRUTH if kind == "bool" else NOTHING)

    def joined(self, parts: Iterable[Code]) -> Code:
        """Return the statements one after the other, as one `Code`."""
        return joined(parts)

    def _call(self, call: Call, reserved: frozenset[str]) -> Code:
        return called(self.syntax, self.step, call.section)

    def _when(self, when: When, reserved: frozenset[str]) -> Code:
        idle = when.idle and self.syntax.analysed
        flag = f"{self.prefix}_acts({self.place_text(when.flag)})" if idle else self.place_text(when.flag)
        head = Code((self.syntax.condition.format(flag),), Uses(helpers=frozenset({"acts"})) if idle else Uses())
        lines = head + self.program(when.body, reserved).indented()
        if when.otherwise:
            lines += code("} else {") + self.program(when.otherwise, reserved).indented()
        return lines + code("}")

    def _loop(self, loop: Loop, reserved: frozenset[str]) -> Code:
        group, array = loop.group, self.place_text(self._array(loop.group))
        depth, total = len(self.kinds.groups[group]), self.kinds.groups[group][-1].count
        k, i = (letter if depth == 1 else f"{letter}{depth}" for letter in "ki")
        inner = self.program(loop.body, reserved)
        uses = self.uses(self._array(group), loop.start, loop.active, loop.index)
        uses |= Uses(widest=max(loop.count, total if loop.start else 0))
        active = f"{k} < {self.place_text(loop.active)}" if loop.active else ""
        needs_k = bool(active) or loop.start is None
        zero, bound, end = (self.syntax.literal(number, "unsigned") for number in (0, loop.count, total))
        head, *first = self.syntax.loop(k, zero, bound, active, needs_k)
        number = [f"{self.place_text(loop.index)} = {k if loop.start is None else i};"] if loop.index else []
        if loop.start is None:
            before = Code((*first, self._member(group, f"{array}", k), *number), uses)
            return braced(head, before + inner)
        start = self.place_text(loop.start)
        if loop.count == 1:
            bounded = self.kinds.members.get(loop.start, total + 1) <= total
            member = self._member(group, array, start if bounded else self.within(start, total))
            return braced("{", Code((member,), uses) + inner)
        wrap = (self.syntax.condition.format(f"{i} >= {end}"), f"    {i} = {zero};", "}")
        before = Code((*first, *wrap, self._member(group, array, i), *number), uses)
        declared = self.syntax.variable.format(type=self.syntax.types["unsigned"], name=i, value=start)
        return braced("{", code(declared) + braced(head, before + inner + code(self.syntax.increment.format(i))))

    def _repeat(self, repeat: Repeat, reserved: frozenset[str]) -> Code:
        fixed, k = code(), next(name for name in ("r", "q") if name not in reserved)
        for place, row in repeat.given.items():
            values = ", ".join(self.syntax.literal(number, self.real) for number in row)
            named = {"type": self.syntax.types[self.real], "name": f"each_{place.name}", "size": repeat.count}
            fixed += code(self.syntax.fixed.format(**named, values=values))
        head, *first = self.syntax.loop(k, self.syntax.number(0), self.syntax.number(repeat.count), "", True)
        taking = [f"{self.place_text(place)} = each_{place.name}[{k}];" for place in repeat.given]
        inner = code(*first, *taking) + self.program(repeat.body, reserved | {k})
        return braced("{", fixed + braced(head, inner))

    def _member(self, group: str, array: str, k: str) -> str:
        element = self.syntax.index(array, k)
        return self.syntax.member.format(type=self.syntax.struct(self.prefix, group), name=group, element=element)

    def within(self, index: str, total: int) -> str:
        """Return the text of an index that is replaced by 0 where it is `total` or more."""
        texts = {"test": f"{index} < {self.syntax.literal(total, 'unsigned')}", "yes": index}
        if self.syntax.chosen[0]:
            texts["test"] = f"({texts['test']})"
        return self.syntax.choice.format(**texts, no=self.syntax.literal(0, "unsigned"))

    def _copy(self, copy: Copy, reserved: frozenset[str]) -> Code:
        array, total = self._array(copy.group), self.kinds.groups[copy.group][-1].count
        numbers = (self.within(self.place_text(place), total) for place in (copy.target, copy.source))
        target, source = (self.syntax.index(self.place_text(array), number) for number in numbers)
        text = self.syntax.copied.format(target=target, source=source)
        return Code((text,), self.uses(array, copy.target, copy.source) | Uses(widest=total))

    def _kernel(self, kernel: Kernel, reserved: frozenset[str]) -> Code:
        operands = [self._array(kernel.columns.struct)] if kernel.columns else []
        operands += [place for place, _ in kernel.arguments]
        values = [*map(self.place_text, operands), *map(self.syntax.number, kernel.counts)]
        forms = passed(self.syntax, kernel.name)
        texts = (form.format(value) for value, form in zip(values, forms, strict=True))
        call = f"{self.prefix}_{kernel.name}({', '.join(texts)})"
        uses = self.uses(*operands) | Uses(kernels=frozenset({(kernel.name, kernel.size)}))
        result = kernel.result and self._assigned(kernel.result, self.place_text(kernel.result), call)
        return Code((result or f"{call};",), uses)

    def _limited(self, block: Block, limited: Callable[[Rows], Sequence[str]]) -> Code:
        limits, text = block.limits, partial(self.syntax.literal, kind=self.real)
        (bit,) = (place for place in block.writes if place.struct == "status")
        rows = Rows(
            places=tuple(self.lvalue(each.place, each.index, each.size) for each in limits),
            rows=tuple((text(each.low), text(each.high), text(each.nominal)) for each in limits),
            count=self.syntax.literal(len(limits), "unsigned"),
            largest=text(LARGEST_NUMBER),
            type=self.syntax.types[self.real],
            prefix=self.prefix,
            raised=self._raised(bit),
        )
        uses = self.uses(*(each.place for each in limits)) | Uses(helpers=frozenset({"keep"}), widest=len(limits))
        return Code((self.syntax.comment(block.title), *limited(rows)), uses)

    def _raised(self, place: Place) -> str:
        return self.syntax.raised.format(prefix=self.prefix.upper(), bit=self.bits[place])

    def _raised_where(self, place: Place, test: str) -> Sequence[str]:
        return self.syntax.condition.format(test), f"    {self._raised(place)}", "}"

    def _block(self, block: Block, reserved: frozenset[str]) -> Code:
        written = self._written(block, reserved)
        if not block.limits or self.syntax.limited is None:
            return written
        return min(written, self._limited(block, self.syntax.limited), key=lambda code: sum(map(len, code.lines)))

    def _written(self, block: Block, reserved: frozenset[str]) -> Code:
        reads, written = block.reads, set(block.writes)
        real: Number = "unsigned" if self.kinds.counts(block) else self.real
        printer = Printer(
            self.syntax,
            real=real,
            prefix=self.prefix,
            inputs=lambda argument, element: self._read(*reads[argument], element, real),
            local=lambda argument, element: self._local(*reads[argument], element),
            is_flag=lambda argument: reads[argument][0] in self.kinds.flags,
            routines=self.subprograms,
            array_text=lambda argument: (self.place_text(reads[argument][0]), reads[argument][1]),
            indexed=lambda argument: self.indexed(*reads[argument]),
            least=NEVER if block.spelled else self.least,
            reserved=set(reserved),
            interval_calls=self.interval_calls and real != "unsigned",
        )
        sources = {place: argument for argument, (place, _) in enumerate(reads)}
        targets = [
            self._target(place, element, size, sources.get(place), real)
            for place, size in block.written
            for element in range(size)
        ]
        names = [(name, sx(value).numel()) for name, value in block.names.items()]
        hoist = [argument for place, argument in sources.items() if place in written]
        constants, statements = printer.body(block.graph, targets, names, hoist)
        if not statements.lines:
            return Code()
        if constants.lines:
            statements = braced("{", constants + statements)
        return code(*map(self.syntax.comment, (block.title, *block.notes))) + statements

    def _read(self, place: Place, size: int, element: int, real: Number) -> Operand:
        text, uses = self.lvalue(place, element, size), self.uses(place)
        if place.struct == "argument" or (self.kinds.is_index(place) and real != "unsigned"):
            cast = self.syntax.cast.format(type=self.syntax.types[real], value=text)
            return Operand(cast, self.syntax.casted, local=False, uses=uses)
        return Operand(text, local=size == 1 and place.struct == "work", uses=uses)

    def indexed(self, place: Place, size: int) -> str:
        """Return the text of an array of real numbers that a loop may index. It is "" for other places, and, if the
        step prefers speed, for the triangle of a matrix, which is written element by element."""
        if size == 1 or self.kinds.is_index(place) or place in self.kinds.flags:
            return ""
        known = self.kinds.fields.get(place)
        triangle = known is not None and bool(known.entries)
        return "" if triangle and self.step.clock.prefer == "speed" else self.place_text(place)

    def _local(self, place: Place, size: int, element: int) -> str:
        kind, name = place
        if kind in ("argument", "time"):
            return f"{name}_given"
        if kind == "output" and name in (outputs := [output.name for output in self.step.outputs]):
            return "reading" if len(outputs) == 1 else f"reading_{name}"
        if kind != "work" and Place("work", name) in self.kinds.work:  # u now, u_given, u_before at the last call
            name += {"input": "_given", "state": "_before"}.get(kind, f"_{kind}")
        known = self.kinds.fields.get(place)
        if known and known.entries:
            return entry(name, known.entries[element])
        return name if size == 1 else f"{name}{element + 1}"

    def _target(self, place: Place, element: int, size: int, argument: int | None, real: Number) -> Target:
        if place.struct == "status":
            return Target(lambda _: self._raised(place), raised=lambda test: self._raised_where(place, test))
        target, uses = self.lvalue(place, element, size), self.uses(place)
        source = None if argument is None else (argument, element)
        if self.kinds.is_index(place) and real != "unsigned":
            cast = self.syntax.cast.format(type=self.syntax.types["unsigned"], value="({})")
            return Target(lambda text: self._assigned(place, target, cast.format(text)), source=source, uses=uses)
        flag = place in self.kinds.flags and size == 1
        array = self.indexed(place, size)
        return Target(
            lambda text: self._assigned(place, target, text),
            flag=flag,
            array=array,
            element=element,
            each=(lambda number, text: self._assigned(place, f"{array}[{number}]", text)) if array else None,
            source=source,
            uses=uses,
        )

    def _assigned(self, place: Place, target: str, text: str) -> str:
        return f"{target} = {text};"


def reading(syntax: Syntax, step: Step, real: Real) -> Writer:
    """Return a writer of functions that read the state without changing it."""
    return Writer(replace(syntax, member=syntax.read_member), step, real)


def called(syntax: Syntax, step: Step, section: Section) -> Code:
    """Return the call of a section (predict, correct ..), whose status is added to the caller's."""
    function = of_section(step, section)
    return code(syntax.called(step.name, function), parameters=function.parameters)


def routines(writer: Writer, keys: Collection[str]) -> Code:
    """Return the functions of the step's routines with these `keys`, in order, as one `Code`."""
    chosen = (subprogram for key, subprogram in writer.subprograms.items() if key in keys)
    return joined(_RoutineFunction(writer, subprogram).text() for subprogram in chosen)


@dataclass(frozen=True, eq=False)
class _RoutineFunction:
    """A printer of the function of a routine, which fills an array for each result."""

    writer: Writer
    subprogram: Subprogram

    def text(self) -> Code:
        syntax, routine = self.writer.syntax, self.subprogram.routine
        head = {"type": syntax.types["void"], "name": f"{self.writer.prefix}_{self.subprogram.name}"}
        parameters = ", ".join(self._parameters())
        lines = (line.format(**head, parameters=parameters) for line in syntax.function)
        names = (name for each in self.subprogram.passed for name in each.names)
        printer = Printer(
            syntax,
            real=self.writer.real,
            prefix=self.writer.prefix,
            inputs=self._read,
            local=lambda argument, element: routine.arguments[argument].local(element),
            indexed=self._indexed,
            least=self.writer.least,
            reserved={"p", *(name for name, _ in routine.results), *names},
        )
        places = [(name, k) for name, size in routine.results for k in range(size)]
        entries = [entry for k in range(len(routine.results)) for entry in routine.entries(k)]
        targets = [self._written(*place, entry) for place, entry in zip(places, entries, strict=True)]
        arrays = [each.number for each in self.subprogram.passed if not each.by_value]
        constants, statements = printer.body(routine.function, targets, hoist=arrays)
        heading = code(syntax.comment(MEANINGS[routine.name]), *lines)
        return heading + (constants + statements).indented() + code("}", "")

    def _written(self, name: str, k: int, entry: str) -> Target:
        heading = f" {self.writer.syntax.comment(entry)}" if entry else ""
        return Target(
            lambda text: f"{name}[{k}] = {text};{heading}",
            array=name,
            element=k,
            each=lambda number, text: f"{name}[{number}] = {text};",
        )

    def _indexed(self, number: int) -> str:
        argument = self.subprogram.routine.arguments[number]
        for each in self.subprogram.passed:
            if each.number == number:
                return "" if each.by_value else argument.label
        assert argument.place
        return self.writer.indexed(argument.place, argument.size)

    def _read(self, number: int, element: int) -> Operand:
        argument = self.subprogram.routine.arguments[number]
        for each in self.subprogram.passed:
            if each.number == number:
                text = argument.local(element) if each.by_value else f"{argument.label}[{element}]"
                return Operand(text, local=each.by_value)
        assert argument.place
        text, uses = self.writer.lvalue(argument.place, element, argument.size), self.writer.uses(argument.place)
        return Operand(text, local=False, uses=uses)

    def _parameters(self) -> Iterator[str]:
        syntax, real = self.writer.syntax, self.writer.syntax.types[self.writer.real]
        if self.subprogram.reads_parameters:
            yield syntax.params.format(prefix=self.writer.prefix)
        for each in self.subprogram.passed:
            template = syntax.parameter if each.by_value else syntax.array_parameter[False]
            yield from (template.format(type=real, name=name, size=each.argument.size) for name in each.names)
        for name, size in self.subprogram.routine.results:
            yield syntax.array_parameter[True].format(type=real, name=name, size=size)
