"""NAME.h, the manual of emitted C: banner with the mathematics and its claims, structs, status bits, prototypes."""

# Takes apart: the manual, whose paragraphs it fills.

import re
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from string import Template

from hgogen.emit.cfunction import address, prototype, prototypes, status_type, structs
from hgogen.emit.cnames import c_name, renamed, says
from hgogen.emit.code import indented
from hgogen.emit.cstruct import Member, member, members, named, struct
from hgogen.emit.csyntax import C, comment, harmless
from hgogen.emit.described import of_signal, parameters
from hgogen.emit.interface import of_section
from hgogen.emit.manual import FAULTS, RANGES, late, mathematics, model_digest, order, own, rates, recovery, title
from hgogen.emit.syntax import Real
from hgogen.program import Field, Group, Section, lines_of
from hgogen.reading.time_unit import pace, plural
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.stepping.sensors import OLDEST, ROUND


def header(step: Step, real: Real, command: str) -> list[str]:
    """The header's lines."""
    guard = f"{step.name.upper()}_H"
    names = f"In C {says(step)}" if renamed(step) else ""
    lines = [*_comment(title(step, command)), f"#ifndef {guard}", f"#define {guard}", "", *_manual(step, real), ""]
    lines += ["#include <stdint.h>", ""] if status_type(step) == "uint32_t" or step.timed else []
    lines += [*_status(step), *_constants(step, real), *_comment(mathematics(step, names)), ""]
    lines += [*_structs(step, real), "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for each in (each for each in prototypes(step).values() if each.public):
        lines += [comment(each.meaning), f"{each};", ""]
    return [*lines, "#ifdef __cplusplus", "}", "#endif", "", f"#endif /* {guard} */"]


def _comment(lines: Iterable[str]) -> list[str]:
    return ["/*", *(f" * {harmless(line)}".rstrip() for line in lines), " */"]


_MANUAL = Template("""
How to use it: one init, then $what a sampling period of $dt.

$structs
    ${name}_init(&s, &p);
    for (;;) {                      every $dt
$body
        ${name}_estimate(&s, &p, &x);
    }

The call at t_k uses the samples of t_k and leaves the estimate at t_k; the first call advances no time.
$missing
$faults $recovery
The status is 0 for ok, else an or of the bits below.
$parts$timed$late
Change gains in p.gain, then call ${name}_tune,
$ranges
The state may be copied, saved and restored, by the same version of this file. To start from an estimate of
yours write $own, in the coordinates that the struct names, after init or reset and before the first
call, which takes the estimate as it stands; what else a step remembers of it starts there too.

No heap, no static data$changes, no recursion: one set of structs for each instance, shared between threads only
under a lock of yours. Compile with -std=c99 -ffp-contract=off for the bits of the recorded self-check,
where FLT_EVAL_METHOD of <float.h> is 0: elsewhere intermediate results are rounded otherwise; never with
-ffast-math or -ffinite-math-only, which take the guards against NaN away and are refused. No macro tells of
clang's -fno-honor-nans, which does the same: optimised with it, the self-check fails. Run it as you compile.
""")


_MISSING = (
    "The period is compiled in: one call for each, with NaN for a sample that did not come.",
    "The period is compiled in: one predict for each.",
)
_PARTS = Template("""
${name}_step is $parts:
$order
""")


_TIMED = Template("""
Sensors of different rates: $rates. The noise R of an output is taken for that
period: give no sample more often. ${name}_step is all of the calls above at once, for a period in which
every output has a sample; an output without one then needs NaN.

$call, and the like of other outputs, is told
the number of the period in which the sample was taken: 0 for that of the first predict after init or
reset, modulo $round, which is (uint16_t)k of a counter k of 16 bits or more. The counter may wrap
round: differences are taken modulo $round. A sample up to $oldest periods older than the state is
late, any other that is not of now is early; neither is used. A sample older by a multiple of $round
periods cannot be told from one of now. Before the first predict every sample is early.
""")


def _timed(step: Step) -> str:
    """How to call the sections of a step for sensors of different rates."""
    call = _call(step, step.timed[-1])
    return _TIMED.substitute(name=step.name, rates=rates(step), call=call, round=ROUND, oldest=OLDEST)


def _body(step: Step) -> list[str]:
    """What a caller does in a period."""
    assigned = [f"in.{c_name(s.name)} = ...;" for s in step.inputs]
    status = f"{status_type(step)} status"
    if not step.timed:
        assigned += [f"out.{c_name(s.name)} = ...;" for s in step.samples]
        return [" ".join(assigned), f"{status} = {prototypes(step)['step'].call(address)};"]
    first, *rest = step.sections
    lines = [*assigned, f"{status} = {_call(step, first)};"]
    for section in rest:
        call, y = f"status |= {_call(step, section)};", section.corrects
        lines += [f"if ({y} has a sample now) {{", f"    out.{c_name(y)} = ...;", f"    {call}", "}"] if y else [call]
    return lines


def _call(step: Step, section: Section) -> str:
    """The call of a section by a caller whose structs are named as its parameters are."""
    return prototype(step, of_section(step, section)).call(address)


def _manual(step: Step, real: Real) -> list[str]:
    parts = ", ".join(section.name for section in step.sections)
    text = _MANUAL.substitute(
        name=step.name,
        dt=pace(step.dt, step.time),
        own=" and ".join(own(step)),
        what="predict, and update where a sample came," if step.timed else "one step",
        body="\n".join(f"        {line}" for line in _body(step)),
        faults=FAULTS,
        ranges=RANGES,
        recovery=recovery(step),
        missing=_MISSING[bool(step.timed)],
        structs="\n".join(f"    {each.local}" for each in structs(step)),
        changes=" that changes" * bool(step.observer.form.system.tables),
        parts=_PARTS.substitute(name=step.name, parts=parts, order=order(step)) if step.apart else "",
        timed=_timed(step) if step.timed else "",
        late=f"\n{late(step, real)}\n" if step.ages else "",
    )
    flowing = re.sub(r"(?<=\S)\n(?=\S)", " ", text.strip("\n"))  # a paragraph is one line, which is filled later
    return _comment(flowing.split("\n"))


def _status(step: Step) -> list[str]:
    upper, digits = step.name.upper(), 4 if status_type(step) == "unsigned" else 8
    width = max(len(bit.name) for bit in step.bits)
    lines = ["/* Status bits: what happened, and what it asks of you. */", ""]
    for k, bit in enumerate(step.bits):
        lines += [
            comment(f"{bit.meaning}. To do: {bit.action}."),
            f"#define {upper}_{bit.name:{width}} 0x{1 << k:0{digits}X}u",
            "",
        ]
    return lines


def _constants(step: Step, real: Real) -> list[str]:
    """What firmware compares: the period of its timer, and of a state that it restores who wrote it."""
    upper = step.name.upper()
    values = {"DT": C.literal(step.dt, real), "VERSION": f'"{version("hgogen")}"'}
    values |= {"MODEL": f'"{digest}"'} if (digest := model_digest(step.observer)) else {}
    origin = f"version of hgogen{' and the model' * bool(digest)}"
    said = comment(f"the period that is compiled in, in {plural(step.time)}; the {origin} that a restored state is of")
    return [said, *(f"#define {upper}_{name:7} {value}" for name, value in values.items()), ""]


# ---------------------------------------------------------------- structs

_REMEMBERED = (
    "what a step remembers: yours to copy, save and restore; ranges are limits, which no call leaves; what was "
    "restored from beyond them is limited, or begins anew, where a call next computes with it"
)
_KIND = {
    "input": "the input now",
    "output": "the measurement now",
    "plant": "the estimate of the plant's state; ranges are the declared ones, beyond which it may peak",
}


def _structs(step: Step, real: Real) -> list[str]:
    name, lines = step.name, list[str]()
    for kind, signals in (("input", step.inputs), ("output", step.samples), ("plant", step.states)):
        if signals:
            inner = members(_signal(step, real, signal) for signal in signals)
            lines += [comment(_KIND[kind]), *struct(f"{name}_{kind}", inner), ""]
    lines += ["/* parameters: change plant or gain, then call tune */", *_params(step, real), ""]
    for *_, group in lines_of(step.groups):
        inner = _inner(step, real, group.fields, group.groups)
        lines += [comment(group.meaning), *struct(f"{name}_{group.name}", inner), ""]
    return [*lines, comment(_REMEMBERED), *struct(f"{name}_state", _inner(step, real, step.state, step.groups)), ""]


def _inner(step: Step, real: Real, fields: Iterable[Field], groups: Iterable[Group]) -> list[str]:
    arrays = ((f"{step.name}_{group.name} {group.name}[{group.count}];", group.meaning) for group in groups)
    return members([*(_member(step, real, field) for field in fields), *arrays])


def _signal(step: Step, real: Real, signal: Signal) -> Member:
    name = c_name(signal.name)
    return f"{real} {name};", of_signal(step, signal, name)


def _member(step: Step, real: Real, item: Field) -> Member:
    return member(real, replace(item, unit=step.unit(item)))


def _params(step: Step, real: Real) -> list[str]:
    inner: list[str] = []
    for kind, fields in parameters(step):
        items = map(named, fields) if kind == "plant" else fields
        inner += struct(kind, members(_member(step, real, f) for f in items), "struct {")
    return [
        "typedef struct {",
        *indented(inner or ["unsigned char none; /* there are none */"]),
        f"}} {step.name}_params;",
    ]
