"""The helper and mathematical functions of the emitted C: bundled, from the C library, or CMSIS-DSP, behind one switch.

Bundled functions are the graphs of `hgogen.elementary`, so they give the same bits on every IEEE 754 target.
"""

from collections.abc import Collection

from hgogen.cprint import HELPERS, Printer, Real, Target, body, literal
from hgogen.ctext import indented
from hgogen.elementary import elementary

# what CMSIS-DSP has in single precision; the rest comes from the C library there
_CMSIS = {"sin": "arm_sin_f32", "cos": "arm_cos_f32"}


def needed(names: Collection[str], real: Real) -> list[str]:
    """Mathematical functions among `names`, in the order of `elementary`."""
    return [name for name in elementary(real) if name in names]


def helpers(prefix: str, real: Real, used: Collection[str]) -> list[str]:
    """The small static functions that `used` names, and those they use."""
    names = set(used)
    names |= {"clamp", "within"} if "keep" in names else set()
    lines: list[str] = []
    for name in (*HELPERS, "inf", "nan"):
        if name in names or (name == "inf" and "nan" in names):
            lines += [line.replace("REAL", real).replace("PREFIX", prefix) for line in _TEXT[name](real)] + [""]
    return lines


def mathematics(prefix: str, real: Real, used: Collection[str]) -> tuple[list[str], set[str]]:
    """The mathematical functions that `used` names, behind the switch; and the helpers that they use."""
    names = needed(used, real)
    if not names:
        return [], set()
    upper = prefix.upper()
    calls: set[str] = set()
    bundled: list[str] = []
    for name in names:
        bundled += [*_bundled(prefix, real, name, calls), ""]
    suffix = "f" if real == "float" else ""
    lines = [
        "/* Mathematical functions, in one place. Bundled by default: no library, the same bits on every target.",
        f" * Define {upper}_USE_LIBM for those of <math.h>" + (f", or {upper}_USE_CMSIS for CMSIS-DSP. */" if real == "float" else ". */"),
        f"#if defined({upper}_USE_LIBM)",
        "#include <math.h>",
        *(_macro(prefix, name, f"{name}{suffix}") for name in names),
    ]
    if real == "float":
        lines += [f"#elif defined({upper}_USE_CMSIS)", '#include "arm_math.h"']
        lines += [_macro(prefix, name, _CMSIS.get(name, f"{name}f")) for name in names]
    return [*lines, "#else", *bundled[:-1], "#endif", ""], calls


def _macro(prefix: str, name: str, target: str) -> str:
    parameters = "x, y" if elementary("double")[name].n_in() == 2 else "x"
    return f"#define {prefix}_{name}({parameters}) {target}({parameters})"


def _bundled(prefix: str, real: Real, name: str, calls: set[str]) -> list[str]:
    graph = elementary(real)[name]
    parameters = ["x", "y"][: graph.n_in()]
    printer = Printer(
        real=real,
        prefix=prefix,
        inputs=lambda argument, _: parameters[argument],
        local=lambda argument, _: parameters[argument],
        used=calls,
        taken=set(parameters),
    )
    lines = body(printer, graph, [Target(lambda text: [f"return {text};"])], [], [])
    head = f"static {real} {prefix}_{name}({', '.join(f'{real} {p}' for p in parameters)})"
    return [head, "{", *indented(lines), "}"]



def _floor(real: Real) -> list[str]:
    whole = "int32_t" if real == "float" else "int64_t"
    one, zero = literal(1, real), literal(0, real)
    return [
        "/* largest whole number not above v, for |v| < 2^31 (float) or 2^63 (double) */",
        "static REAL PREFIX_floor(REAL v)",
        "{",
        f"    const REAL whole = (REAL)({whole})v;",
        f"    return whole - ((whole > v) ? {one} : {zero});",
        "}",
    ]


_TEXT = {
    "abs": lambda real: [
        "static REAL PREFIX_abs(REAL v)",
        "{",
        f"    return (v < {literal(0, real)}) ? -v : v;",
        "}",
    ],
    "min": lambda real: ["static REAL PREFIX_min(REAL a, REAL b)", "{", "    return (a < b) ? a : b;", "}"],
    "max": lambda real: ["static REAL PREFIX_max(REAL a, REAL b)", "{", "    return (a > b) ? a : b;", "}"],
    "clamp": lambda real: [
        "static REAL PREFIX_clamp(REAL v, REAL low, REAL high)",
        "{",
        "    const REAL raised = (v > low) ? v : low;",
        "    return (raised < high) ? raised : high;",
        "}",
    ],
    "within": lambda real: [
        "/* whether v is a number with |v| <= limit; v == v fails for what is not a number */",
        "static int PREFIX_within(REAL v, REAL limit)",
        "{",
        "    return v == v && v >= -limit && v <= limit;",
        "}",
    ],
    "keep": lambda real: [
        "/* v in [low, high]; `otherwise` where v is not a number or beyond limit */",
        "static REAL PREFIX_keep(REAL v, REAL low, REAL high, REAL otherwise, REAL limit)",
        "{",
        "    return PREFIX_within(v, limit) ? PREFIX_clamp(v, low, high) : otherwise;",
        "}",
    ],
    "sign": lambda real: [
        "static REAL PREFIX_sign(REAL v)",
        "{",
        f"    const REAL positive = (v > {literal(0, real)}) ? {literal(1, real)} : {literal(0, real)};",
        f"    return positive - ((v < {literal(0, real)}) ? {literal(1, real)} : {literal(0, real)});",
        "}",
    ],
    "floor": _floor,
    "inf": lambda real: [
        "static REAL PREFIX_inf(void)",
        "{",
        f"    const REAL large = {'3e38f' if real == 'float' else '1e308'};",
        "    return large*large;",
        "}",
    ],
    "nan": lambda real: [
        "static REAL PREFIX_nan(void)",
        "{",
        "    const REAL large = PREFIX_inf();",
        "    return large - large;",
        "}",
    ],
}
