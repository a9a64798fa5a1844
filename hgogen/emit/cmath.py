"""The functions of emitted C: bundled, from the C library, or from CMSIS-DSP, behind one switch."""

from collections.abc import Collection

from hgogen.emit.code import Code, code, joined
from hgogen.emit.functions import arguments, bundled, head, helpers, needed
from hgogen.emit.portable import called_by, small
from hgogen.emit.syntax import Real, Syntax

# what CMSIS-DSP has in single precision; the rest comes from the C library there
_CMSIS = {"sin": "arm_sin_f32", "cos": "arm_cos_f32"}
_WHOLE = {
    f"{part}_{name}": name for part in ("small", "bounded") for name in ("sin", "cos")
}  # what libraries have for a part of a function


def includes(prefix: str, real: Real, used: Collection[str]) -> list[str]:
    """The headers of the library that was chosen, if `used` names a mathematical function."""
    if not needed(used, real):
        return []
    upper = prefix.upper()
    cmsis = [f"#elif defined({upper}_USE_CMSIS)", '#include "arm_math.h"', "#include <math.h>"]
    return [f"#if defined({upper}_USE_LIBM)", "#include <math.h>", *(cmsis if real == "float" else []), "#endif"]


def functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
    """The functions that `used` names: the small ones, then the mathematical ones behind their switch."""
    names, outside = needed(used, real), helpers(syntax, prefix, real, used)
    if not names:
        return outside
    texts = bundled(syntax, prefix, real, names)
    there = called_by(texts.uses.helpers) - called_by(used)
    inside = small(syntax, prefix, real, there, syntax.types[f"whole {real}"])
    upper, suffix = prefix.upper(), "f" if real == "float" else ""
    cmsis = f", or {upper}_USE_CMSIS for CMSIS-DSP" if real == "float" else ""
    switch = [
        "/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.",
        f" * Define {upper}_USE_LIBM for those of <math.h>{cmsis}. */",
        f"#if defined({upper}_USE_LIBM)",
        *(line for name in names for line in _library(syntax, prefix, real, name, f"{_WHOLE.get(name, name)}{suffix}")),
    ]
    if real == "float":
        switch += [f"#elif defined({upper}_USE_CMSIS)"]
        known = ((name, _WHOLE.get(name, name)) for name in names)
        switch += [
            line for name, of in known for line in _library(syntax, prefix, real, name, _CMSIS.get(of, f"{of}f"))
        ]
    return joined([outside, code(*switch, "#else"), inside, texts, code("#endif", "")])


def _library(syntax: Syntax, prefix: str, real: Real, name: str, target: str) -> list[str]:
    return [*head(syntax, prefix, real, name), f"    return {target}({', '.join(arguments(name))});", "}", ""]
