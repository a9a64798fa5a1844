"""C99 for firmware: NAME.h (the manual), NAME.c, and NAME_check.c with recorded vectors.

Caller-owned structs, no heap, no static data, no recursion, bounded loops; every call returns a status, a bit mask
with 0 for ok. Compile with `-ffp-contract=off` for the same bits
on every IEEE 754 target whose FLT_EVAL_METHOD is 0.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from hgogen.emit.ccheck import check as self_check
from hgogen.emit.cfold import folded
from hgogen.emit.cheader import Prototype, header, prototypes
from hgogen.emit.ckernels import kernels
from hgogen.emit.cmath import functions, includes
from hgogen.emit.cnames import demand_names
from hgogen.emit.cprint import Real, literal
from hgogen.emit.ctext import Writer, called, indented, named, status_type
from hgogen.errors import HgogenError
from hgogen.program import Field, Group
from hgogen.step import Step
from hgogen.target import Files


@dataclass(eq=False)
class BadReal(HgogenError):
    """A working precision that is neither float nor double."""

    real: str

    def __str__(self) -> str:
        return f'real = {self.real!r} must be "float" or "double"'


def c99(step: Step, *, real: Real = "float", command: str = "", check: bool = True) -> Files:
    """The step as C99 text: header, source and self-check, by file name.

    Args: `real` "float" or "double"; `command` what made it, for the banner; `check` whether to add the
    self-check, whose vectors take a while to compute.

    Raises: `BadReal`; `HidesHeader`, `SameInC` for names that C cannot carry; `BeyondFloat`, `NotPrintable` for a
    number, an operation that has no C.
    """
    if real not in ("float", "double"):
        raise BadReal(real)
    demand_names(step)
    files = {f"{step.name}.h": header(step, real, command), f"{step.name}.c": _source(step, real)}
    files |= {f"{step.name}_check.c": self_check(step, real)} if check else {}
    return Files(tuple((name, "\n".join(folded(lines)) + "\n") for name, lines in files.items()))


_IEEE = (
    "#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))",
    '#error "needs IEEE 754 comparisons: -ffast-math drops the guards against what is not a number"',
    "#endif",
    "",
)


def _source(step: Step, real: Real) -> list[str]:
    writer, name = Writer(step, real), step.name
    bodies = {section.name: writer.function(section.program) for section in step.sections}
    if len(step.sections) > 1:
        bodies["step"] = [called(step, section) for section in step.sections]
    else:
        bodies = {"step": bodies[step.sections[0].name]}
    bodies |= {section.name: writer.function(section.program) for section in step.timed}
    bodies["estimate"] = writer.function(step.estimate)
    bodies["tune"] = writer.function(step.tuning)
    bodies["reset"] = _reset(step, writer)
    bodies["init"] = _init(step, writer)
    declared = {prototype.name: prototype for prototype in prototypes(step)}
    interface = [line for key, body in bodies.items() for line in (*_function(step, declared[key], body), "")]
    text = [*functions(name, real, writer.used), *kernels(name, real, writer.kernels), *interface[:-1]]
    return [
        f"/* {name}: see {name}.h, which is the manual. */",
        f'#include "{name}.h"',
        "",
        *_includes(step, includes(name, real, writer.used), text),
        *_IEEE,
        *text,
    ]


def _includes(step: Step, chosen: list[str], text: list[str]) -> list[str]:
    """The standard headers that the text needs, and a guard where a counter needs more than 16 bits."""
    whole = "\n".join(text)
    wide = max((int(number) for number in re.findall(r"\b(\d+)u\b", whole)), default=0) > 0xFFFF
    lines = ["#include <limits.h>"] if wide else []
    lines += ["#include <stdbool.h>"] if re.search(r"\b(bool|true|false)\b", whole) else []
    lines += ["#include <stdint.h>"] if re.search(r"\bint(32|64)_t\b", whole) else []
    lines += chosen
    lines += [""] if lines else []
    guard = [
        "#if UINT_MAX <= 0xFFFF",
        f'#error "{step.name} counts beyond 65535: int has too few bits here"',
        "#endif",
        "",
    ]
    return lines + (guard if wide else [])


def _function(step: Step, prototype: Prototype, lines: list[str]) -> list[str]:
    kind = status_type(step)
    returns = prototype.text.removeprefix("static ").startswith(f"{kind} ")
    code = re.sub(r"/\*.*?\*/", "", "\n".join(lines))
    shorts = re.findall(r"\*(\w+)[,)]", prototype.text)
    idle = [short for short in shorts if not re.search(rf"(?<!->)(?<!\.)\b{short}\b", code)]
    inner = [f"(void){short};" for short in idle] + lines
    inner = [f"{kind} status = 0u;", *inner, "return status;"] if returns else inner
    return [prototype.text, "{", *indented(inner), "}"]


def _assign(start: str, item: Field, real: Real) -> list[str]:
    texts = [literal(value, "unsigned" if item.kind == "index" else real) for value in item.initial]
    return [f"{start}{item.name}{f'[{i}]' if item.size > 1 else ''} = {text};" for i, text in enumerate(texts)]


def _reset(step: Step, writer: Writer) -> list[str]:
    lines = [line for item in step.state for line in _assign("s->", item, writer.real)]
    return lines + _fresh("s->", step.groups, writer.real)


def _fresh(start: str, groups: Iterable[Group], real: Real, k: str = "k") -> list[str]:
    lines: list[str] = []
    for group in groups:
        one = f"{start}{group.name}[{k}]."
        inner = [line for f in group.fields for line in _assign(one, f, real)]
        inner += _fresh(one, group.groups, real, "k2")
        lines += [f"for (unsigned {k} = 0u; {k} < {group.count}u; ++{k}) {{", *indented(inner), "}"]
    return lines


def _init(step: Step, writer: Writer) -> list[str]:
    kinds = (("plant", map(named, step.plant)), ("gain", step.gains))
    lines = [line for kind, fields in kinds for f in fields for line in _assign(f"p->{kind}.", f, writer.real)]
    return [*lines, f"(void){step.name}_tune(p);", f"{step.name}_reset(s);"]
