"""The mathematical functions of emitted code: the graphs of `emit.elementary` in a `Syntax`, so that they give the same
bits wherever the arithmetic is that of IEEE 754 and rounds every operation to the working precision; in C behind a
switch also those of the C library, or of CMSIS-DSP.
"""

from collections.abc import Collection

import casadi as ca

from hgogen.emit.code import Code, code, joined, spaced
from hgogen.emit.elementary import POWER_OF_TWO, elementary, power_of_two
from hgogen.emit.operations import CALLS
from hgogen.emit.portable import called_by, chosen, small
from hgogen.emit.printer import Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.syntax import Real, Syntax

_MEANINGS = {POWER_OF_TWO: "2^x for whole x, where that is a normal number"}


def needed(names: Collection[str], real: Real) -> list[str]:
    """Mathematical functions among `names`, in the order of `elementary`."""
    return [name for name in elementary(real) if name in names]


def helpers(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """The small functions among `names`, and those that they call."""
    return small(syntax, prefix, real, called_by(names), syntax.types[f"whole {real}"])


def functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
    """The functions that `used` names, and those that they call."""
    text = bundled(syntax, prefix, real, needed(used, real))
    below = helpers(syntax, prefix, real, {*used, *text.uses.helpers})
    return below + text + code("") if text.lines else below


def bundled(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """Mathematical functions, one after the other, after what they call."""
    texts = [_bundled(syntax, prefix, real, name) for name in names]
    if any(POWER_OF_TWO in text.uses.helpers for text in texts):
        texts.insert(0, _bundled(syntax, prefix, real, POWER_OF_TWO))
    return spaced(texts) if texts else Code()


def arguments(name: str) -> tuple[str, ...]:
    """The names of the arguments of a mathematical function."""
    return ("x", "y")[: _graph(name, "double").n_in()]


def _head(syntax: Syntax, prefix: str, real: Real, name: str) -> list[str]:
    """The lines that open the function."""
    parameters = ", ".join(syntax.parameter.format(type=syntax.types[real], name=each) for each in arguments(name))
    words = {"type": syntax.types[real], "name": f"{prefix}_{name}", "parameters": parameters}
    return [line.format(**words) for line in syntax.function]


def _graph(name: str, real: Real) -> ca.Function:
    return power_of_two(real) if name == POWER_OF_TWO else elementary(real)[name]


def _bundled(syntax: Syntax, prefix: str, real: Real, name: str) -> Code:
    names = arguments(name)
    printer = Printer(
        syntax,
        real=real,
        prefix=prefix,
        inputs=lambda argument, _: Operand(names[argument]),
        local=lambda argument, _: names[argument],
        calls=CALLS | {ca.OP_FLOOR: "whole"},  # their arguments are small
        taken=set(names),
    )
    constants, result = printer.body(_graph(name, real), [Target(syntax.result.format)])
    inner = chosen(syntax, real, name, constants + result)
    said = [syntax.comment(_MEANINGS[name])] if name in _MEANINGS else []
    return joined([code(*said, *_head(syntax, prefix, real, name)), inner, code("}")])


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


def c_functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
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
    ]
    libraries = {"LIBM": dict[str, str](), **({"CMSIS": _CMSIS} if real == "float" else {})}
    for test, (library, own) in zip(("#if", "#elif"), libraries.items(), strict=False):
        switch.append(f"{test} defined({upper}_USE_{library})")
        for name in names:
            whole = _WHOLE.get(name, name)
            call = f"{own.get(whole, f'{whole}{suffix}')}({', '.join(arguments(name))})"
            switch += [*_head(syntax, prefix, real, name), f"    return {call};", "}", ""]
    return joined([outside, code(*switch, "#else"), inside, texts, code("#endif", "")])
