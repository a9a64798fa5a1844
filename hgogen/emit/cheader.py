"""NAME.h, the manual of emitted C: banner with the mathematics and its claims, structs, status bits, prototypes; its
comments are Doxygen's, too."""

# Takes apart: the manual, whose paragraphs it fills.

import re
from collections.abc import Iterable
from string import Template

from hgogen.emit.cfunction import address, prototype, prototypes, status_type, structs
from hgogen.emit.cnames import c_name
from hgogen.emit.cstruct import typedefs
from hgogen.emit.csyntax import BESIDE, C, documented, harmless, spoken
from hgogen.emit.interface import MEANINGS, Entry, direction, entries, of_section
from hgogen.emit.manual import (
    faults,
    guarded,
    late,
    marked,
    mathematics,
    model_digest,
    order,
    own,
    ranges,
    rates,
    result,
    title,
)
from hgogen.emit.structs import structs as of_memory
from hgogen.emit.syntax import Real
from hgogen.program import Section
from hgogen.reading.release import version
from hgogen.reading.time_unit import pace, plural
from hgogen.step import Step
from hgogen.stepping.sensors import OLDEST, ROUND

_NONE, _NO_RANGE = f"unsigned char none; {BESIDE}there are none */", "of no declared range"


def header(step: Step, real: Real, command: str) -> list[str]:
    """The header's lines."""
    guard = f"{step.name.upper()}_H"
    first, *others = map(spoken, title(step, command))
    lines = [*_block([f"@file {step.name}.h", f"@brief {first}", "", *others])]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", *_manual(step, real), ""]
    lines += ["#include <stdint.h>", ""] if status_type(step) == "uint32_t" or step.timed else []
    lines += [*_status(step), *_constants(step, real), *_mathematics(step), ""]
    for struct in typedefs(step.name, of_memory(step, C, real, step.stored), _NONE, lambda text: text or _NO_RANGE):
        lines += [*struct, ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for entry in (each for each in entries(step).values() if each.public):
        lines += [*_function(entry), f"{prototype(step, entry)};", ""]
    return [*lines, "#ifdef __cplusplus", "}", "#endif", "", f"#endif /* {guard} */"]


def _block(lines: Iterable[str]) -> list[str]:
    """A comment of several lines that Doxygen reads."""
    return ["/**", *(f" * {line}".rstrip() for line in lines), " */"]


def _function(entry: Entry) -> list[str]:
    """What a function does, what it is given and what it says."""
    parameters = [f"@param[{direction(entry, name)}] {name} {MEANINGS[name]}" for name in entry.parameters]
    returned = ["@return 0, or an or of the status bits"] if entry.status else []
    return _block([f"@brief {spoken(entry.meaning)}", *parameters, *returned])


def _mathematics(step: Step) -> list[str]:
    """The equations as they are, which are no text for Doxygen."""
    lines = map(harmless, mathematics(step, C))
    return _block(
        ["@file", "@verbatim", *(line.replace("endverbatim", "end verbatim") for line in lines), "@endverbatim"]
    )


_MANUAL = Template("""
How to use it: one init, then $what a sampling period of $dt.

@code
$structs
    ${name}_init(&s, &p);
    for (;;) {                      every $dt
$body
        ${name}_estimate(&s, &p, &x);
    }
@endcode

The call at t_k uses the samples of t_k and leaves the estimate at t_k; the first call advances no time.
$missing
$faults
The status $result.
$parts$timed$late
Change gains in p.gain, then call ${name}_tune,
$ranges
The state may be copied, saved and restored, by the same version of this file. $marked To start from an estimate of
yours write $own, in the coordinates that the struct names, after init or reset and before the first
call, which takes the estimate as it stands; what else a step remembers of it starts there too.

No heap, no static data$changes, no recursion: one set of structs for each instance, shared between threads only
under a lock of yours. Compile with -std=c99 -ffp-contract=off for the bits of the recorded self-check,
where FLT_EVAL_METHOD of `<float.h>` is 0: elsewhere intermediate results are rounded otherwise; never with
-ffast-math or -ffinite-math-only, which take the guards against NaN away and are refused, nor with
-funsafe-math-optimizations or -fassociative-math, which spoil the bundled functions and are refused by GCC 12 and
later. No macro tells of them in clang, nor of its -fno-honor-nans, with which the self-check fails: run it as you
compile.
""")


_MISSING = (
    "The period is compiled in: one call for each, with NaN for a sample that did not come.",
    "The period is compiled in: one predict for each.",
)
_USED = "The period is compiled in: one call for each, with a number for every sample."
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
        faults=faults(step),
        ranges=ranges(step),
        result=result(step, "the bits below"),
        marked=marked(step),
        missing=_MISSING[bool(step.timed)] if guarded(step) else _USED,
        structs="\n".join(f"    {each.local}" for each in structs(step)),
        changes=" that changes" * bool(step.observer.form.system.tables),
        parts=_PARTS.substitute(name=step.name, parts=parts, order=order(step)) if step.apart else "",
        timed=_timed(step) if step.timed else "",
        late=f"\n{late(step, real)}\n" if step.ages else "",
    )
    flowing = re.sub(r"(?<=\S)\n(?=[^\s@])", " ", text.strip("\n"))  # a paragraph is one line, which is filled later
    return _block(["@file", *flowing.split("\n")])


def _status(step: Step) -> list[str]:
    upper, digits = step.name.upper(), 4 if status_type(step) == "unsigned" else 8
    if not step.bits:
        return []
    width = max(len(bit.name) for bit in step.bits)
    lines = ["/** @name Status bits: what happened, and what it asks of you. */", "/** @{ */", ""]
    for k, bit in enumerate(step.bits):
        lines += [
            documented(f"{bit.meaning}. To do: {step.asked(bit)}."),
            f"#define {upper}_{bit.name:{width}} 0x{1 << k:0{digits}X}u",
            "",
        ]
    return [*lines, "/** @} */", ""]


def _constants(step: Step, real: Real) -> list[str]:
    """What firmware compares: the period of its timer, and of a state that it restores who wrote it."""
    period = f"the period that is compiled in, in {plural(step.time)}"
    rows = [("DT", C.literal(step.dt, real), period)]
    rows += [("VERSION", f'"{version()}"', "the version of hgogen that a restored state is of")]
    digest = model_digest(step.observer)
    rows += [("MODEL", f'"{digest}"', "the model that a restored state is of")] if digest else []
    if step.mark:
        rows += [("READY", f"0x{int(step.mark.initial[0]):04X}u", "what init and reset leave in `ready` of a state")]
    defined = ((f"#define {step.name.upper()}_{name:7} {value}", said) for name, value, said in rows)
    return [text for line, said in defined for text in (documented(said), line, "")]
