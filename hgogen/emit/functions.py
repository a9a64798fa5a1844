"""The mathematical functions of emitted code: the graphs of `emit.elementary` in a `Syntax`, so that they give the same
bits wherever the arithmetic is that of IEEE 754 and rounds every operation to the working precision.
"""

from collections.abc import Collection

import casadi as ca

from hgogen.emit.body import Target, body
from hgogen.emit.code import Code, code, joined, spaced
from hgogen.emit.elementary import elementary
from hgogen.emit.operations import CALLS
from hgogen.emit.portable import called_by, small
from hgogen.emit.printer import Operand, Printer
from hgogen.emit.syntax import Real, Syntax


def needed(names: Collection[str], real: Real) -> list[str]:
    """Mathematical functions among `names`, in the order of `elementary`."""
    return [name for name in elementary(real) if name in names]


def helpers(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """The small functions among `names`, and those that they call."""
    return small(syntax, prefix, real, called_by(names), syntax.types[f"whole {real}"])


def functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
    """All functions that `used` names, and those that they call."""
    text = bundled(syntax, prefix, real, needed(used, real))
    return helpers(syntax, prefix, real, {*used, *text.uses.helpers}) + text


def bundled(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """Mathematical functions, one after the other."""
    return spaced(_bundled(syntax, prefix, real, name) for name in names) if names else Code()


def arguments(name: str) -> tuple[str, ...]:
    """What the arguments of a mathematical function are called."""
    return ("x", "y")[: elementary("double")[name].n_in()]


def head(syntax: Syntax, prefix: str, real: Real, name: str) -> list[str]:
    """The lines that open the function."""
    parameters = ", ".join(syntax.parameter.format(type=syntax.types[real], name=each) for each in arguments(name))
    words = {"type": syntax.types[real], "name": f"{prefix}_{name}", "parameters": parameters}
    return [line.format(**words) for line in syntax.function]


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
    constants, result = body(printer, elementary(real)[name], [Target(syntax.result.format)], [], [])
    return joined([code(*head(syntax, prefix, real, name)), (constants + result).indented(), code("}")])
