"""C with the vector types of GNU compilers as a `Syntax`: every number is one of each of several runs, its lanes.

    numbers    real numbers, as many as a register of this machine holds
    counts     counters of the same width, which wrap round as the C's do
    truth      truth values of the same width, all of whose bits are set where they hold; whole numbers

An operation is that of each lane by itself, so its bits are those of the scalar C. A choice takes from both of its
branches; what a lane does not take is computed and dropped.
"""

from dataclasses import dataclass, fields, replace

import casadi as ca

from hgogen.emit.syntax import ATOM, BYTES, SELECT, Number, Real, Syntax
from hgogen.emit.syntaxes import C

_WRAPPED = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*"}


@dataclass(frozen=True)
class Lanes(Syntax):
    """The syntax for a file whose names begin with `prefix`; `alike`: where counts are the same in all lanes."""

    prefix: str = ""
    alike: bool = False

    def number(self, value: int) -> str:
        """A plain number: that of an element is the same in each lane."""
        return C.number(value)

    def marked(self, digits: str, kind: Number) -> str:
        """A number, the same in each lane."""
        if self.alike and kind == "unsigned":
            return C.marked(digits, kind)
        fill = "count" if kind == "unsigned" else "fill"
        return f"{own(self.prefix)}_{fill}({C.marked(digits, kind)})"


def own(prefix: str) -> str:
    """What the names begin with that are not of the step but of lanes."""
    return f"{prefix}_lanes"


def lanes(prefix: str, real: Real) -> Lanes:
    """The syntax in this precision."""
    p = own(prefix)
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
    return Lanes(**{each.name: getattr(inherited, each.name) for each in fields(Syntax)}, prefix=prefix)


def alike(prefix: str, real: Real) -> Lanes:
    """The syntax for functions whose counts are alike in all lanes: a test is one of counts, or holds in any lane."""
    syntax, condition = lanes(prefix, real), f"if ({own(prefix)}_holds({{}})) {{{{"
    return replace(
        syntax,
        types={**syntax.types, "unsigned": "unsigned", "index": "unsigned"},
        counted={},
        condition=condition,
        alike=True,
    )


def prelude(prefix: str, real: Real, word: int) -> list[str]:
    """The types, and what C has no sign for; `word`: the bits of a status, which is computed in numbers at least
    as wide as a real one, so that a truth value becomes a mask of them."""
    p, bits, width = own(prefix), 8 * BYTES[real], f"{prefix.upper()}_LANES"
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
