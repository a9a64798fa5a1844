"""The statements of a program in the syntax of lanes: where these part ways, a mask says which of them go on.

    When    its body runs if any lane wants it, and what it writes is blended in where a lane does
    Loop    the members in order; of one that begins where each lane has it, every member in turn, for the lanes that
            are at it
    Kernel  in all lanes, of which those that do not want it have back what they had
    Copy, table     lane by lane

A work value that only one body knows is written without a blend: the lanes that do not want the body never read it.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain

from hgogen.algebra.lookup import Lookup
from hgogen.discretisation import kernels
from hgogen.emit.code import Code, braced, code
from hgogen.emit.lanesyntax import own
from hgogen.emit.portable import functions_of, writes
from hgogen.emit.statements import Writer
from hgogen.emit.syntax import Real
from hgogen.errors import HgogenError
from hgogen.program import Call, Copy, Kernel, Loop, Place, Program, Repeat, When, walk

# kernels whose way depends on counts alone, but for a scaling by ones in lanes that need none
TOGETHER = frozenset({"expand", "triangularise", "add", "correct", "cap", "renew"})


@dataclass(eq=False)
class NoLanes(HgogenError):
    """A matrix kernel whose way depends on its numbers."""

    kernel: str

    def __str__(self) -> str:
        return f"the kernel {self.kernel} goes another way in each lane; call the scalar step"


@dataclass(frozen=True)
class Mask:
    """Which lanes run: the name of their truth value, empty where all do; `own`: the places that nothing outside of
    what it is for knows."""

    name: str = ""
    own: frozenset[Place] = frozenset()


@dataclass(frozen=True, eq=False)
class LaneWriter(Writer):
    """The text of a step's programs in lanes; `masks`: that at hand is the last."""

    masks: list[Mask] = field(default_factory=lambda: [Mask()])
    counted: list[Counter[Place]] = field(default_factory=list)

    @property
    def own(self) -> str:
        """What its names begin with that are not of the step."""
        return own(self.prefix)

    @property
    def width(self) -> str:
        """The number of lanes."""
        return f"{self.prefix.upper()}_LANES"

    def function(self, program: Program) -> Code:
        """The body of a function, or of a section that another calls."""
        self.counted.append(_counted(program))
        with self._masked(Mask(self.masks[-1].name, frozenset(self.kinds.work))):
            text = super().function(program)
        self.counted.pop()
        return text

    def _call(self, call: Call, taken: frozenset[str]) -> Code:
        return braced("{", self.function(call.section.program))

    def _repeat(self, repeat: Repeat, taken: frozenset[str]) -> Code:
        return self.program(repeat.unrolled, taken)

    # --- where lanes part ways

    @contextmanager
    def _masked(self, mask: Mask) -> Iterator[None]:
        self.masks.append(mask)
        yield
        self.masks.pop()

    def _on(self, test: str) -> str:
        """The lanes that run and for which a test holds."""
        return " & ".join(filter(None, (self.masks[-1].name, test)))

    def _named(self) -> str:
        return f"{self.own}_on{len(self.masks)}"

    def _declared(self, name: str, test: str) -> Code:
        return code(f"const {self.syntax.types['bool']} {name} = {self._on(test)};")

    def _any(self, name: str) -> str:
        return f"{self.own}_any({name})"

    def _assigned(self, place: Place, target: str, text: str) -> str:
        mask = self.masks[-1]
        blended = mask.name and place not in mask.own
        return f"{target} = {self.syntax.choice.format(test=mask.name, yes=text, no=target) if blended else text};"

    def _raised(self, place: Place) -> str:
        return self._raised_where(place, "true")[0]

    def _raised_where(self, place: Place, test: str) -> Sequence[str]:
        bit = [each.place for each in self.step.layout.bits].index(place)
        raised = f"__builtin_convertvector({self._on(f'({test})')}, {self.own}_raised)"
        return (f"status |= ({self.own}_status){raised} & {1 << bit:#x}u;",)

    def _when(self, when: When, taken: frozenset[str]) -> Code:
        flag, name, other = when.flag.name, self._named(), f"{self._named()}_not"
        text = self._declared(name, flag)
        text += self._declared(other, f"~{flag}") if when.otherwise else Code()
        text += self._where(name, when.body, taken)
        text += self._where(other, when.otherwise, taken) if when.otherwise else Code()
        return braced("{", text)

    def _where(self, name: str, body: Program, taken: frozenset[str]) -> Code:
        everywhere = self.counted[-1]
        inner = frozenset(
            place for place, n in _counted(body).items() if everywhere[place] == n and place.struct == "work"
        )
        with self._masked(Mask(name, inner)):
            return braced(f"if ({self._any(name)}) {{", self.program(body, taken))

    # --- members

    def _loop(self, loop: Loop, taken: frozenset[str]) -> Code:
        depth = len(self.kinds.groups[loop.group])
        k, i = (letter if depth == 1 else f"{letter}{depth}" for letter in "ki")
        total, whole = self.kinds.groups[loop.group][-1].count, self.syntax.types["unsigned"]
        at, number = f"{self.own}_at{len(self.masks)}", self._number(k)
        tests = [f"({number} < {self.whole(loop.active)})"] if loop.active else []
        if loop.start is None:
            return self._members(loop, k, loop.count, tests, taken)
        tests += [f"({at} == {self._number(i)})"]
        inside = self._members(loop, i, total, tests, taken)
        once = code(f"{at} = {at} + {self._number('1')};", f"{at} = {self.within(at, total)};")
        start = code(f"{whole} {at} = {self.within(self.whole(loop.start), total)};")
        turns = f"for (unsigned {k} = 0u; {k} < {loop.count}u; ++{k}) {{"
        return braced("{", start + braced(turns, inside + once))

    def _members(self, loop: Loop, k: str, count: int, tests: list[str], taken: frozenset[str]) -> Code:
        """The body for each member, number `k`, for the lanes that pass the tests."""
        array = self.whole(self._array(loop.group))
        head = f"for (unsigned {k} = 0u; {k} < {count}u; ++{k}) {{"
        member = code(self._member(loop.group, array, k))
        uses = self.uses(self._array(loop.group), loop.start, loop.active, loop.index)
        with self._masked(Mask(name := self._named()) if tests else self.masks[-1]):
            if loop.index:
                member += code(self._assigned(loop.index, self.whole(loop.index), self._number(k)))
            inner = member + self.program(loop.body, taken)
        if tests:
            inner = self._declared(name, " & ".join(tests)) + braced(f"if ({self._any(name)}) {{", inner)
        return braced(head, inner) + Code((), uses)

    def _number(self, text: str) -> str:
        """A number that is the same in each lane."""
        return f"{self.own}_count({text})"

    # --- lane by lane

    def _copy(self, copy: Copy, taken: frozenset[str]) -> Code:
        array, total = self._array(copy.group), self.kinds.groups[copy.group][-1].count
        numbers = [self.within(self.whole(place), total) for place in (copy.target, copy.source)]
        whole, size = self.syntax.types["unsigned"], f"sizeof({self.real})"
        declared = code(*(f"const {whole} {name} = {n};" for name, n in zip(("into", "from"), numbers, strict=True)))
        ends = (f"(char *)&{self.whole(array)}[{name}[lane]] + byte" for name in ("into", "from"))
        first, end = f"(size_t)lane * {size}", f"sizeof({self.syntax.struct(self.prefix, copy.group)})"
        head = f"for (size_t byte = {first}; byte < {end}; byte += {size} * {self.width}) {{"
        bytes_ = braced(head, code(f"__builtin_memcpy({', '.join(ends)}, {size});"))
        mask = self.masks[-1].name
        one = braced(f"if ({mask}[lane]) {{", bytes_) if mask else bytes_
        every = braced(f"for (int lane = 0; lane < {self.width}; ++lane) {{", one)
        return braced("{", declared + every) + Code((), self.uses(array, copy.target, copy.source))

    def _kernel(self, kernel: Kernel, taken: frozenset[str]) -> Code:
        """A call for all lanes at once, after which those that do not run have back what they had."""
        if kernel.name not in TOGETHER:
            raise NoLanes(kernel.name)
        before, after, mask = Code(), Code(), self.masks[-1]
        for k, each in enumerate(self._changed(kernel) if mask.name else ()):
            if each.place not in mask.own:
                kind = self.syntax.struct(self.prefix, "column") if each.columns else self.syntax.types[self.real]
                was = replace(each, text=f"{self.own}_before{k}")
                back = self.syntax.choice.format(test=mask.name, yes=each.element, no=was.element)
                before += code(f"{kind} {was.text}[{each.size}];") + each.all(f"{was.element} = {each.element};")
                after += each.all(f"{each.element} = {back};")
        return braced("{", before + super()._kernel(kernel, taken) + after)

    def _changed(self, kernel: Kernel) -> Iterator["_Array"]:
        operands = [*([(kernel.columns, kernel.size)] if kernel.columns else []), *kernel.arguments]
        parameters = functions_of(kernels)[kernel.name].args.args
        for parameter, (place, size) in zip(parameters, operands, strict=False):  # and counts
            if writes(parameter):
                columns = place == kernel.columns
                yield _Array(place, self.whole(self._array(place.struct) if columns else place), size, columns)


@dataclass(frozen=True)
class _Array:
    """An array that a kernel is passed: its place and text, how many elements it has, whether they are the columns of a
    matrix."""

    place: Place
    text: str
    size: int
    columns: bool

    @property
    def element(self) -> str:
        """The text of an element, as `all` counts them."""
        return f"{self.text}[j]{'.v[i]' * self.columns}"

    def all(self, line: str) -> Code:
        """A line for each element."""
        heads = (f"for (unsigned {k} = 0u; {k} < {self.size}u; ++{k})" for k in ("j", "i")[: 1 + self.columns])
        return code(f"{' '.join(heads)} {{ {line} }}")


def table(prefix: str, real: Real, lookup: Lookup) -> Code:
    """The function of a table, lane by lane."""
    names = [axis.name for axis in lookup.axes]
    parameters = ", ".join(f"{own(prefix)}_numbers {name}" for name in names)
    call = f"{own(prefix)}_one_{lookup.name}({', '.join(f'{name}[lane]' for name in names)})"
    loop = braced(f"for (int lane = 0; lane < {prefix.upper()}_LANES; ++lane) {{", code(f"value[lane] = {call};"))
    inner = code(f"{own(prefix)}_numbers value = {{0}};") + loop + code("return value;")
    return code(f"static {own(prefix)}_numbers {prefix}_{lookup.name}({parameters})") + braced("{", inner) + code("")


def _counted(program: Program) -> Counter[Place]:
    """How many statements know each place."""
    known = ({place for place, _ in (*statement.reads, *statement.written)} for statement in walk(program))
    return Counter(chain.from_iterable(known))
