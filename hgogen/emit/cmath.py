"""The helper and mathematical functions of the emitted C: bundled, from the C library, or CMSIS-DSP, behind one switch.

Bundled functions are the graphs of `emit.elementary`, so they give the same bits on every IEEE 754 target whose
FLT_EVAL_METHOD is 0.
"""

from collections.abc import Collection
from dataclasses import replace
from string import Template

import casadi as ca

from hgogen.emit.ccode import Code, code, filled, joined, spaced
from hgogen.emit.cfunction import Parameter, Prototype, own
from hgogen.emit.cprint import CALLS, Operand, Printer, Real, Target, body, literal
from hgogen.emit.elementary import elementary

_WHOLE: dict[Real, str] = {"float": "int32_t", "double": "int64_t"}
_ALL_WHOLE: dict[Real, float] = {"float": 2.0**23, "double": 2.0**52}  # numbers from here on are whole
_LARGE: dict[Real, str] = {"float": "3e38f", "double": "1e308"}

# the small functions, in the order in which they call each other
_HELPERS = {
    "abs": Template("""
static $real ${prefix}_abs($real v)
{
    return (v < $zero) ? -v : v;
}
"""),
    "min": Template("""
static $real ${prefix}_min($real a, $real b)
{
    return (a < b) ? a : b;
}
"""),
    "max": Template("""
static $real ${prefix}_max($real a, $real b)
{
    return (a > b) ? a : b;
}
"""),
    "clamp": Template("""
static $real ${prefix}_clamp($real v, $real low, $real high)
{
    const $real raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}
"""),
    "within": Template("""
#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static $bool ${prefix}_within($real v, $real limit)
{
    return v == v && v >= -limit && v <= limit;
}
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif
"""),
    "keep": Template("""
/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static $real ${prefix}_keep($real v, $real low, $real high, $real otherwise, $real limit)
{
    return ${prefix}_within(v, limit) ? ${prefix}_clamp(v, low, high) : otherwise;
}
"""),
    "sign": Template("""
static $real ${prefix}_sign($real v)
{
    return ((v > $zero) ? $one : $zero) - ((v < $zero) ? $one : $zero);
}
"""),
    "whole": Template("""
/* largest whole number not above v, which an $whole can hold */
static $real ${prefix}_whole($real v)
{
    const $real whole = ($real)($whole)v;
    return whole - ((whole > v) ? $one : $zero);
}
"""),
    "floor": Template("""
/* largest whole number not above v; numbers from $all_whole on are whole */
static $real ${prefix}_floor($real v)
{
    return ${prefix}_within(v, $all_whole) ? ${prefix}_whole(v) : v;
}
"""),
    "inf": Template("""
static $real ${prefix}_inf(void)
{
    const $real large = $large;
    return large*large;
}
"""),
    "nan": Template("""
static $real ${prefix}_nan(void)
{
    const $real large = ${prefix}_inf();
    return large - large;
}
"""),
}
_CALLED = {"keep": {"clamp", "within"}, "floor": {"whole", "within"}, "nan": {"inf"}}

# what CMSIS-DSP has in single precision; the rest comes from the C library there
_CMSIS = {"sin": "arm_sin_f32", "cos": "arm_cos_f32"}


def needed(names: Collection[str], real: Real) -> list[str]:
    """Mathematical functions among `names`, in the order of `elementary`."""
    return [name for name in elementary(real) if name in names]


def includes(prefix: str, real: Real, used: Collection[str]) -> list[str]:
    """The headers of the library that was chosen, if `used` names a mathematical function."""
    if not needed(used, real):
        return []
    upper = prefix.upper()
    cmsis = [f"#elif defined({upper}_USE_CMSIS)", '#include "arm_math.h"', "#include <math.h>"]
    return [f"#if defined({upper}_USE_LIBM)", "#include <math.h>", *(cmsis if real == "float" else []), "#endif"]


def functions(prefix: str, real: Real, used: Collection[str]) -> Code:
    """The functions that `used` names: the small ones, then the mathematical ones behind their switch."""
    names, outside = needed(used, real), _called(used)
    helpers = _helpers(prefix, real, outside)
    if not names:
        return helpers
    bundled = spaced(_bundled(prefix, real, name) for name in names)
    inside = _helpers(prefix, real, _called(bundled.uses.helpers) - outside)
    upper, suffix = prefix.upper(), "f" if real == "float" else ""
    cmsis = f", or {upper}_USE_CMSIS for CMSIS-DSP" if real == "float" else ""
    switch = [
        "/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.",
        f" * Define {upper}_USE_LIBM for those of <math.h>{cmsis}. */",
        f"#if defined({upper}_USE_LIBM)",
        *(line for name in names for line in _library(prefix, real, name, f"{name}{suffix}")),
    ]
    if real == "float":
        switch += [f"#elif defined({upper}_USE_CMSIS)"]
        switch += [line for name in names for line in _library(prefix, real, name, _CMSIS.get(name, f"{name}f"))]
    return joined([helpers, code(*switch, "#else"), inside, bundled, code("#endif", "")])


def _called(names: Collection[str]) -> set[str]:
    return set(names).union(*(_CALLED.get(name, ()) for name in names))


def _helpers(prefix: str, real: Real, names: Collection[str]) -> Code:
    holes = {"prefix": prefix, "real": real, "bool": "bool", "whole": _WHOLE[real], "large": _LARGE[real]}
    holes |= {"zero": literal(0, real), "one": literal(1, real), "all_whole": literal(_ALL_WHOLE[real], real)}
    return joined(filled(text, holes) + code("") for name, text in _HELPERS.items() if name in names)


def _head(prefix: str, real: Real, name: str) -> Prototype:
    given = ["x", "y"][: elementary("double")[name].n_in()]
    return Prototype(real, f"{prefix}_{name}", tuple(Parameter(real, p, pointer=False) for p in given), public=False)


def _library(prefix: str, real: Real, name: str, target: str) -> list[str]:
    head = _head(prefix, real, name)
    return [str(head), "{", f"    return {replace(head, name=target).call(own)};", "}", ""]


def _bundled(prefix: str, real: Real, name: str) -> Code:
    graph, head = elementary(real)[name], _head(prefix, real, name)
    parameters = list(map(own, head.parameters))
    printer = Printer(
        real=real,
        prefix=prefix,
        inputs=lambda argument, _: Operand(parameters[argument]),
        local=lambda argument, _: parameters[argument],
        calls=CALLS | {ca.OP_FLOOR: "whole"},  # their arguments are small
        taken=set(parameters),
    )
    constants, result = body(printer, graph, [Target(lambda text: f"return {text};")], [], [])
    return code(str(head), "{") + (constants + result).indented() + code("}")
