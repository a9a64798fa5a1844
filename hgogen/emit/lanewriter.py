"""C with the vector types of GNU compilers as a `Syntax`, and the statements of a program in it: every number is a
vector with one element for each of several runs, its lanes.

    numbers    real numbers, as many as a register of this machine holds
    counts     counters of the same width, which wrap around as those of C do
    truth      truth values of the same width, all of whose bits are set where they hold; whole numbers

An operation acts on each lane separately, so its bits are those of the scalar C. A choice computes both of its branches
and selects in each lane. Where lanes branch differently, a mask selects the active ones:

    When    the body runs if any lane needs it, and its results are blended into the active lanes
    Loop    the members in order; where lanes start at different members, every member in turn, for the lanes that are
            at it
    Kernel  in all lanes; the inactive ones are restored afterwards
    Copy, table     lane by lane

A work value that only one body uses is written without a blend: inactive lanes never read it.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain

import casadi as ca

from hgogen.discretisation import kernels
from hgogen.emit.code import Code, braced, code
from hgogen.emit.portable import functions_of, writes
from hgogen.emit.statements import Writer
from hgogen.emit.syntax import ATOM, BYTES, SELECT, Number, Real, Syntax
from hgogen.emit.syntaxes import C
from hgogen.errors import HgogenError
from hgogen.program import Call, Copy, Kernel, Loop, Place, Program, Repeat, When, walk
from hgogen.rigor.lookup import Lookup

_WRAPPED = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*"}


@dataclass(frozen=True)
class Lanes(Syntax):
    """The C syntax for SIMD code: element k of every vector (a lane) computes log number k. `prefix`: the beginning of
    all names in the file; `uniform`: whether loop counts are equal in all lanes."""

    prefix: str = ""
    uniform: bool = False

    def number(self, value: int) -> str:
        """Return the text of an integer that is equal in all lanes, such as an array index: a scalar."""
        return C.number(value)

    def marked(self, digits: str, kind: Number) -> str:
        """Return the text of a literal that is equal in all lanes; `kind`: its type."""
        if self.uniform and kind == "unsigned":
            return C.marked(digits, kind)
        fill = "count" if kind == "unsigned" else "fill"
        return f"{lane_prefix(self.prefix)}_{fill}({C.marked(digits, kind)})"


def lane_prefix(prefix: str) -> str:
    """Return the prefix of names that exist only in SIMD code, where each vector element (lane) computes another
    log."""
    return f"{prefix}_lanes"


def lanes(prefix: str, real: Real) -> Lanes:
    """Return the C syntax for SIMD code in the precision `real`: each vector element (lane) computes another log."""
    p = lane_prefix(prefix)
    number, counts, truth = f"{p}_numbers", f"{p}_counts", f"{p}_truth"
    sign = f"({truth}){p}_fill(-0.0{C.suffixes[real]})"
    absolute = f"({number})(({truth})v & ~{sign})"
    wrapped = "(({{}} {} {{}}) & {}_count(0xFFFFFFFFu))"
    inherited = replace(
        C,
        types={
            real: number,
            "unsigned": counts,
            "index": counts,
            "bool": truth,
            f"whole {real}": truth,
            "void": "void",
        },
        truth_is_number=False,
        choice=f"{p}_pick({{test}}, {{yes}}, {{no}})",
        chosen=(SELECT, SELECT),
        cast="__builtin_convertvector({value}, {type})",
        casted=ATOM,
        counted={op: wrapped.format(each, p) for op, each in _WRAPPED.items()},
        function=("static inline {type} {name}({parameters})", "{{"),
        both=" & ",
        either=" | ",
        opposite="~{}",
        analysed=False,
        equal=False,
        limited=None,
        fixed=C.gathered,
        around={},
        aligned=("{}", SELECT),
        instead={
            "abs": ("", f"return {absolute};"),
            "within": ("", f"return {absolute} <= limit;"),
            "power_of_two": ("", f"return ({number})(({counts})(x + {{BIASED}}) << {{SHIFT}});"),
        },
    )
    return Lanes(**vars(inherited), prefix=prefix)


def with_uniform_counts(prefix: str, real: Real) -> Lanes:
    """Return the C syntax for SIMD functions whose loop counts are equal in all lanes (one log in each vector element);
    a test there compares scalar counts, or holds if it holds in any lane."""
    syntax, condition = lanes(prefix, real), f"if ({lane_prefix(prefix)}_holds({{}})) {{{{"
    return replace(
        syntax,
        types={**syntax.types, "unsigned": "unsigned", "index": "unsigned"},
        counted={},
        condition=condition,
        uniform=True,
    )


def prelude(prefix: str, real: Real, word: int) -> list[str]:
    """Return the C lines that define the vector types, and vector operations without an operator in C. `word`: the bits
    of a status; statuses have elements at least as wide as a real number, so that truth values are masks."""
    p, bits, width = lane_prefix(prefix), 8 * BYTES[real], f"{prefix.upper()}_LANES"
    kinds = {"numbers": real, "counts": f"uint{bits}_t", "truth": f"int{bits}_t"}
    wide = max(bits, word)
    statuses = {"status": f"uint{wide}_t", "raised": f"int{wide}_t"}
    vectors = {"row": (real, BYTES[real]), "word": (f"uint{word}_t", word // 8)}
    return [
        *("#if defined(__AVX512DQ__)", f"#define {width} {512 // bits}"),
        *("#elif defined(__AVX__)", f"#define {width} {256 // bits}"),
        *("#else", f"#define {width} {128 // bits}", "#endif", ""),
        *(_typedef(f"{p}_{name}", kind, width) for name, kind in (kinds | statuses).items()),
        "/* numbers in an array, and the status of each lane in one */",
        *(
            _typedef(f"{p}_{name}", kind, width, f", aligned({size}), may_alias")
            for name, (kind, size) in vectors.items()
        ),
        "",
        *("#undef false", "#undef true"),
        f"#define false (({p}_truth){{0}})",
        "#define true (~false)",
        "",
        f"static inline {p}_numbers {p}_fill({real} v) {{ return v - ({p}_numbers){{0}}; }}",
        f"static inline {p}_counts {p}_count({kinds['counts']} v) {{ return v + ({p}_counts){{0}}; }}",
        *(line for kind in kinds for line in _pick(p, kind)),
        f"static inline {p}_numbers {p}_pick_alike(int test, {p}_numbers yes, {p}_numbers no)",
        *("{", "    return test ? yes : no;", "}"),
        f"#define {p}_pick(test, yes, no) _Generic((test), int: {p}_pick_alike, default: \\",
        f"    _Generic((no), {', '.join(f'{p}_{kind}: {p}_pick_{kind}' for kind in kinds)}))(test, yes, no)",
        f"static inline int {p}_any({p}_truth test)",
        "{",
        f"    {kinds['truth']} any = 0;",
        f"    for (int lane = 0; lane < {width}; ++lane) {{",
        "        any |= test[lane];",
        "    }",
        "    return any != 0;",
        "}",
        f"static inline int {p}_alike(int test) {{ return test; }}",
        f"#define {p}_holds(test) _Generic((test), int: {p}_alike, default: {p}_any)(test)",
        "",
    ]


def _typedef(name: str, kind: str, width: str, also: str = "") -> str:
    return f"typedef {kind} {name} __attribute__((vector_size({width} * sizeof({kind})){also}));"


def _pick(p: str, kind: str) -> list[str]:
    truth, head = f"{p}_truth", f"static inline {p}_{kind} {p}_pick_{kind}"
    chosen = f"(({truth})yes & test) | (({truth})no & ~test)"
    return [f"{head}({truth} test, {p}_{kind} yes, {p}_{kind} no)", "{", f"    return ({p}_{kind})({chosen});", "}"]


# kernels that branch on counts alone; where some lanes need a scaling, the others are scaled by ones
TOGETHER = frozenset({"expand", "triangularise", "add", "disturb", "correct", "cap", "renew", "project", "decouple"})


@dataclass(eq=False)
class NoLanes(HgogenError):
    """The error for a matrix kernel without code in lanes, since its branches depend on its numbers."""

    text = "the kernel {kernel} goes another way in each lane; call the scalar step"
    kernel: str


@dataclass(frozen=True)
class Mask:
    """The lanes (logs in one vector) in which statements take effect: `name` of the vector of truth values, "" for all
    lanes; `private`: the places of memory that only statements under this mask use."""

    name: str = ""
    private: frozenset[Place] = frozenset()


@dataclass(frozen=True, eq=False)
class LaneWriter(Writer):
    """A writer of a step's functions as SIMD code in C, where each vector element (lane) computes another log; the last
    of `masks` selects the lanes in which the current statements take effect."""

    masks: list[Mask] = field(default_factory=lambda: [Mask()])
    counted: list[Counter[Place]] = field(default_factory=list)

    @property
    def lane_prefix(self) -> str:
        """The prefix of names that exist only in SIMD code, where each vector element (lane) computes another log."""
        return lane_prefix(self.prefix)

    @property
    def width(self) -> str:
        """The C text of the number of lanes, the logs that one vector holds."""
        return f"{self.prefix.upper()}_LANES"

    def function(self, program: Program) -> Code:
        """Return the C body of a function for all lanes; for a section that another function calls, under that caller's
        mask."""
        self.counted.append(_counted(program))
        with self._masked(Mask(self.masks[-1].name, frozenset(self.kinds.work))):
            text = super().function(program)
        self.counted.pop()
        return text

    def _call(self, call: Call, reserved: frozenset[str]) -> Code:
        return braced("{", self.function(call.section.program))

    def _repeat(self, repeat: Repeat, reserved: frozenset[str]) -> Code:
        return self.program(repeat.unrolled, reserved)

    # --- masks of active lanes

    @contextmanager
    def _masked(self, mask: Mask) -> Iterator[None]:
        self.masks.append(mask)
        yield
        self.masks.pop()

    def _on(self, test: str) -> str:
        return " & ".join(filter(None, (self.masks[-1].name, test)))

    def _named(self) -> str:
        return f"{self.lane_prefix}_on{len(self.masks)}"

    def _declared(self, name: str, test: str) -> Code:
        return code(f"const {self.syntax.types['bool']} {name} = {self._on(test)};")

    def _any(self, name: str) -> str:
        return f"{self.lane_prefix}_any({name})"

    def _assigned(self, place: Place, target: str, text: str) -> str:
        mask = self.masks[-1]
        blended = mask.name and place not in mask.private
        return f"{target} = {self.syntax.choice.format(test=mask.name, yes=text, no=target) if blended else text};"

    def _raised(self, place: Place) -> str:
        return self._raised_where(place, "true")[0]

    def _raised_where(self, place: Place, test: str) -> Sequence[str]:
        bit = [each.place for each in self.step.layout.bits].index(place)
        raised = f"__builtin_convertvector({self._on(f'({test})')}, {self.lane_prefix}_raised)"
        return (f"status |= ({self.lane_prefix}_status){raised} & {1 << bit:#x}u;",)

    def _when(self, when: When, reserved: frozenset[str]) -> Code:
        flag, name, other = when.flag.name, self._named(), f"{self._named()}_not"
        text = self._declared(name, flag)
        text += self._declared(other, f"~{flag}") if when.otherwise else Code()
        text += self._where(name, when.body, reserved)
        text += self._where(other, when.otherwise, reserved) if when.otherwise else Code()
        return braced("{", text)

    def _where(self, name: str, body: Program, reserved: frozenset[str]) -> Code:
        everywhere = self.counted[-1]
        inner = frozenset(
            place for place, n in _counted(body).items() if everywhere[place] == n and place.struct == "work"
        )
        with self._masked(Mask(name, inner)):
            return braced(f"if ({self._any(name)}) {{", self.program(body, reserved))

    # --- members

    def _loop(self, loop: Loop, reserved: frozenset[str]) -> Code:
        depth = len(self.kinds.groups[loop.group])
        k, i = (letter if depth == 1 else f"{letter}{depth}" for letter in "ki")
        total, counts = self.kinds.groups[loop.group][-1].count, self.syntax.types["unsigned"]
        at, number = f"{self.lane_prefix}_at{len(self.masks)}", self._number(k)
        tests = [f"({number} < {self.place_text(loop.active)})"] if loop.active else []
        if loop.start is None:
            return self._members(loop, k, loop.count, tests, reserved)
        tests += [f"({at} == {self._number(i)})"]
        inside = self._members(loop, i, total, tests, reserved)
        once = code(f"{at} = {at} + {self._number('1')};", f"{at} = {self.within(at, total)};")
        start = code(f"{counts} {at} = {self.within(self.place_text(loop.start), total)};")
        turns = f"for (unsigned {k} = 0u; {k} < {loop.count}u; ++{k}) {{"
        return braced("{", start + braced(turns, inside + once))

    def _members(self, loop: Loop, k: str, count: int, tests: list[str], reserved: frozenset[str]) -> Code:
        array = self.place_text(self._array(loop.group))
        head = f"for (unsigned {k} = 0u; {k} < {count}u; ++{k}) {{"
        member = code(self._member(loop.group, array, k))
        uses = self.uses(self._array(loop.group), loop.start, loop.active, loop.index)
        with self._masked(Mask(name := self._named()) if tests else self.masks[-1]):
            if loop.index:
                member += code(self._assigned(loop.index, self.place_text(loop.index), self._number(k)))
            inner = member + self.program(loop.body, reserved)
        if tests:
            inner = self._declared(name, " & ".join(tests)) + braced(f"if ({self._any(name)}) {{", inner)
        return braced(head, inner) + Code((), uses)

    def _number(self, text: str) -> str:
        return f"{self.lane_prefix}_count({text})"

    # --- lane by lane

    def _copy(self, copy: Copy, reserved: frozenset[str]) -> Code:
        array, total = self._array(copy.group), self.kinds.groups[copy.group][-1].count
        numbers = [self.within(self.place_text(place), total) for place in (copy.target, copy.source)]
        counts, size = self.syntax.types["unsigned"], f"sizeof({self.real})"
        declared = code(*(f"const {counts} {name} = {n};" for name, n in zip(("into", "from"), numbers, strict=True)))
        ends = (f"(char *)&{self.place_text(array)}[{name}[lane]] + byte" for name in ("into", "from"))
        first, end = f"(size_t)lane * {size}", f"sizeof({self.syntax.struct(self.prefix, copy.group)})"
        head = f"for (size_t byte = {first}; byte < {end}; byte += {size} * {self.width}) {{"
        bytes_ = braced(head, code(f"__builtin_memcpy({', '.join(ends)}, {size});"))
        mask = self.masks[-1].name
        one = braced(f"if ({mask}[lane]) {{", bytes_) if mask else bytes_
        loop = braced(f"for (int lane = 0; lane < {self.width}; ++lane) {{", one)
        return braced("{", declared + loop) + Code((), self.uses(array, copy.target, copy.source))

    def _kernel(self, kernel: Kernel, reserved: frozenset[str]) -> Code:
        if kernel.name not in TOGETHER:
            raise NoLanes(kernel.name)
        before, after, mask = Code(), Code(), self.masks[-1]
        for k, each in enumerate(self._changed(kernel) if mask.name else ()):
            if each.place not in mask.private:
                kind = self.syntax.struct(self.prefix, "column") if each.columns else self.syntax.types[self.real]
                was = replace(each, text=f"{self.lane_prefix}_before{k}")
                back = self.syntax.choice.format(test=mask.name, yes=each.element, no=was.element)
                before += code(f"{kind} {was.text}[{each.size}];") + each.all(f"{was.element} = {each.element};")
                after += each.all(f"{each.element} = {back};")
        return braced("{", before + super()._kernel(kernel, reserved) + after)

    def _changed(self, kernel: Kernel) -> Iterator["_Array"]:
        operands = [*([(kernel.columns, kernel.size)] if kernel.columns else []), *kernel.arguments]
        parameters = functions_of(kernels)[kernel.name].args.args
        for parameter, (place, size) in zip(parameters, operands, strict=False):  # and counts
            if writes(parameter):
                columns = place == kernel.columns
                yield _Array(place, self.place_text(self._array(place.struct) if columns else place), size, columns)


@dataclass(frozen=True)
class _Array:
    """An array argument of a matrix kernel: its place of memory and C text,
    its number of elements, and whether it holds the columns of a matrix."""

    place: Place
    text: str
    size: int
    columns: bool

    @property
    def element(self) -> str:
        return f"{self.text}[j]{'.v[i]' * self.columns}"

    def all(self, line: str) -> Code:
        heads = (f"for (unsigned {k} = 0u; {k} < {self.size}u; ++{k})" for k in ("j", "i")[: 1 + self.columns])
        return code(f"{' '.join(heads)} {{ {line} }}")


def table(prefix: str, real: Real, lookup: Lookup) -> Code:
    """Return the C function that interpolates in a table of the model, lane by lane (log by log)."""
    names, p = [axis.name for axis in lookup.axes], lane_prefix(prefix)
    parameters = ", ".join(f"{p}_numbers {name}" for name in names)
    call = f"{p}_one_{lookup.name}({', '.join(f'{name}[lane]' for name in names)})"
    loop = braced(f"for (int lane = 0; lane < {prefix.upper()}_LANES; ++lane) {{", code(f"value[lane] = {call};"))
    inner = code(f"{p}_numbers value = {{0}};") + loop + code("return value;")
    return code(f"static {p}_numbers {prefix}_{lookup.name}({parameters})") + braced("{", inner) + code("")


def _counted(program: Program) -> Counter[Place]:
    known = ({place for place, _ in (*statement.reads, *statement.written)} for statement in walk(program))
    return Counter(chain.from_iterable(known))
