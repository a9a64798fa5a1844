"""What stands at the head of emitted code. Of C it is NAME.h: the banner with the mathematics and its claims, the
manual, structs, status bits and prototypes, whose comments are Doxygen's, too. Of Rust it is the documentation of the
crate: the banner, how to call it, what it promises, and the status bits.
"""

# Takes apart: the mathematics, whose words end no comment.

import textwrap
from collections.abc import Iterable

from hgogen.emit import saving
from hgogen.emit.code import COLUMNS, indented
from hgogen.emit.formula import plain, table
from hgogen.emit.interface import (
    MEANINGS,
    address,
    direction,
    entries,
    of_section,
    prototype,
    prototypes,
    status_type,
    structs,
)
from hgogen.emit.manual import (
    UNTIMELY,
    document_name,
    gains,
    late,
    marked,
    mathematics,
    model_digest,
    parts,
    period,
    rates,
    result,
    state,
    summary,
    title,
)
from hgogen.emit.naming import c_name
from hgogen.emit.saved import ADDED, layout, mark
from hgogen.emit.structs import doc, typedefs
from hgogen.emit.structs import structs as of_memory
from hgogen.emit.syntax import Real
from hgogen.emit.syntaxes import RUST, TRAILING_DOC, C, documented, harmless, line, spoken, trailing_doc
from hgogen.program import Section
from hgogen.registry import version
from hgogen.signal import pace, plural
from hgogen.step import Step
from hgogen.stepping.sections import ROUND

_NONE, _NO_RANGE = f"unsigned char none; {TRAILING_DOC}there are none */", "of no declared range"


def header(step: Step, real: Real, command: str) -> list[str]:
    """Return the header's lines: includes, constants and structs, then the functions, then what is looked up in it."""
    guard, every = f"{step.name.upper()}_H", pace(step.dt, step.time)
    first, *others = map(spoken, title(step, command))
    lines = _block(
        [
            *(f"@file {step.name}.h", f"@brief {first}", "", *others),
            f"One init, then {'predict and updates' if step.code.timed else 'a step'} every {every} and an estimate.",
            f"Manual: {document_name(step)}. No heap, no recursion, no static data but constant tables.",
        ]
    )
    lines += [f"#ifndef {guard}", f"#define {guard}", "", "#include <stddef.h>"]
    lines += ["#include <stdint.h>"] if status_type(step) != "unsigned" or step.code.timed else []
    (period, *compared), init = _constants(step, real), saving.initialiser(step, real)
    lines += [period, ""]
    for struct in typedefs(step.name, of_memory(step, C, real, marked=True), _NONE, lambda text: text or _NO_RANGE):
        lines += map(_one_line, struct)
    lines += ["", "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for entry in (each for each in entries(step).values() if each.public):
        parameters = [(direction(entry, name), name, MEANINGS[name]) for name in entry.parameters]
        returned = f"0{', or an or of the status bits' * bool(step.layout.bits)}" * entry.status
        lines += [*_said(entry.meaning, parameters, returned), f"{prototype(step, entry)};", ""]
    save, restore = saving.prototypes(step)
    means = {"s": MEANINGS["s"], **saving.MEANINGS}
    for each, written, returned in ((save, "saved", ""), (restore, "s", saving.RETURNS)):
        parameters = [("out" if p.name == written else "in", p.name, means[p.name]) for p in each.parameters]
        lines += [*_said(each.meaning, parameters, returned), f"{each};", ""]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", *_status(step)]
    lines += [*compared, "", documented(_CONSTANT + ", with their mark" * bool(step.layout.mark)), *init, ""]
    equations = (harmless(line).replace("endverbatim", "end verbatim") for line in summary(step, C))
    verbatim = _block(["@file", "@verbatim", *equations, "@endverbatim"])  # which is no text for Doxygen
    return [*lines, *verbatim, "", f"#endif /* {guard} */"]


def _one_line(text: str) -> str:
    """The line of a member, whose comment is cut where it is too long for one; the manual has all of it."""
    code, mark, said = text.partition("/**")
    if not mark or len(text) <= COLUMNS:
        return text
    start, said = ("/**< ", said[1:]) if said.startswith("<") else ("/** ", said)
    width = COLUMNS - len(code) - len(start) - len(" */")
    return f"{code}{start}{textwrap.shorten(said.removesuffix(' */'), width, placeholder=' ..')} */"


def _block(lines: Iterable[str]) -> list[str]:
    return ["/**", *(f" * {line}".rstrip() for line in lines), " */"]


def _said(meaning: str, parameters: Iterable[tuple[str, str, str]], returned: str) -> list[str]:
    """The comment of a function: what it does, its arguments, and what it returns."""
    lines = [f"@brief {spoken(meaning)}", *(f"@param[{way}] {name} {said}" for way, name, said in parameters)]
    first, *others = [*lines, *([f"@return {returned}"] if returned else [])]
    *others, last = (f"/** {first}", *(f" * {line}" for line in others))
    return [*others, f"{last} */"]


_COMPILED = (
    "No heap, no recursion, no static data that changes, for tables are constant: one set of structs for each "
    "instance, shared between threads only under a lock of yours. Compile with -std=c99 -ffp-contract=off for the bits "
    "of the recorded self-check, where FLT_EVAL_METHOD of `<float.h>` is 0: elsewhere intermediate results are rounded "
    "otherwise; never with -ffast-math or -ffinite-math-only, which take the guards against NaN away and are refused, "
    "nor with -funsafe-math-optimizations or -fassociative-math, which spoil the bundled functions and are refused by "
    "GCC 12 and later. No macro tells of them in clang, nor of its -fno-honor-nans, with which the self-check fails: "
    "run it as you compile."
)
_WHOLE = (
    "{rates} {name}_step is all of the calls above at once, for a period in which every output has a sample; an output "
    "without one then needs NaN."
)
_TIMED = (
    f"{{call}}, and the like of other outputs, is told the number of the period in which the sample was taken: 0 for "
    f"that of the first predict after init or reset, modulo {ROUND}, which is (uint16_t)k of a counter k of 16 bits or "
    f"more. The counter may wrap round: differences are taken modulo {ROUND}. {UNTIMELY} A sample older by a multiple "
    f"of {ROUND} periods cannot be told from one of now. Before the first predict every sample is early."
)


def manual(step: Step, real: Real) -> list[str]:
    """Return the manual in Markdown: how C calls a step, what it does with all that may come, and its members."""
    name = step.name
    called = f"{period(step, by_parts=bool(step.code.timed))} The status {result(step, 'the bits of the header')}."
    paragraphs = [called, *parts(step, f"{name}_step")]
    if step.code.timed:
        paragraphs += [_WHOLE.format(rates=rates(step), name=name)]
        paragraphs += [_TIMED.format(call=_call(step, step.code.timed[-1]))]
    changed = gains(step, "p.gain", f"{name}_tune")
    restored = state(step, marked(step), "after init or reset and before the first call")
    paragraphs += [*late(step, real), f"{changed} {restored}", _COMPILED]
    every = pace(step.dt, step.time)
    what = "predict, and update where a sample came," if step.code.timed else "one step"
    called_so = [f"How to use it: one init, then {what} a sampling period of {every}.", "", "```c"]
    called_so += [each.local for each in structs(step)]
    called_so += [f"{name}_init(&s, &p);", f"for (;;) {{                      /* every {every} */"]
    called_so += [*indented(_body(step)), f"    {name}_estimate(&s, &p, &x);", "}", "```"]
    members = [
        (f"`{C.struct(name, kind)}`", f"`{each.name}`", plain(each.said))
        for kind, struct in of_memory(step, C, real, marked=True).items()
        for each in struct.members
    ]
    return [
        "## Use from C",
        "",
        *called_so,
        *(line for each in paragraphs for line in ("", plain(each))),
        "",
        *table(("struct", "member", "meaning"), members),
    ]


def _body(step: Step) -> list[str]:
    assigned = [f"in.{c_name(s.name)} = ...;" for s in step.inputs]
    status = f"{status_type(step)} status"
    if not step.code.timed:
        assigned += [f"measurement.{c_name(s.name)} = ...;" for s in step.samples]
        return [" ".join(assigned), f"{status} = {prototypes(step)['step'].call(address)};"]
    first, *rest = step.code.sections
    lines = [*assigned, f"{status} = {_call(step, first)};"]
    for section in rest:
        call, y = f"status |= {_call(step, section)};", section.corrects
        lines += (
            [f"if ({y} has a sample now) {{", f"    measurement.{c_name(y)} = ...;", f"    {call}", "}"]
            if y
            else [call]
        )
    return lines


def _call(step: Step, section: Section) -> str:
    return prototype(step, of_section(step, section)).call(address)


def _status(step: Step) -> list[str]:
    if not step.layout.bits:
        return []
    upper, width, size = step.name.upper(), max(len(bit.name) for bit in step.layout.bits), step.layout.word.itemsize
    # in the type of the status: the complement of a narrower constant would mask the bits above it
    value = "0x{:04X}u" if status_type(step) == "unsigned" else f"UINT{8 * size}_C(0x{{:0{2 * size}X}})"
    lines = ["/** @name Status bits: what happened, and what it asks of you. */", "/** @{ */", ""]
    for k, bit in enumerate(step.layout.bits):
        lines += [
            documented(f"{bit.meaning}. To do: {step.action_of(bit)}."),
            f"#define {upper}_{bit.name:{width}} {value.format(1 << k)}",
            "",
        ]
    return [*lines, "/** @} */", ""]


_CONSTANT = "what constant parameters begin with, which may lie in flash: nominal ones, tuned"


def _constants(step: Step, real: Real) -> list[str]:
    """The constants that firmware compares: the period of its timer, and of a state that it restores who wrote it."""
    rows = [("DT", C.literal(step.dt, real), f"sampling period in {plural(step.time)}")]
    rows += [("VERSION", f'"{version()}"', "of hgogen that made this file")]
    digest = model_digest(step.observer)
    rows += [("MODEL", f'"{digest}"', "digest of the model, as in its certificate")] if digest else []
    rows += [("LAYOUT", f'"{layout(step, real).hex()}"', "digest of what a saved state needs to be the same")]
    rows += (
        [("READY", f"0x{mark(step, real):04X}u", "mark of what init and reset have made")] if step.layout.mark else []
    )
    rows += [("SAVED", f"(sizeof({step.name}_state) + {ADDED}u)", "bytes of a saved state")]
    width = max(len(value) for _, value, _ in rows)
    return [f"#define {step.name.upper()}_{name:7} {value:{width}} {trailing_doc(said)}" for name, value, said in rows]


_RUST_TIMED = (
    "{rates} `{function}` and the like of other outputs is told the number of the period in which the sample was "
    f"taken, `at`: 0 for that of the first `predict`, modulo {ROUND}. {UNTIMELY} Before the first `predict` every "
    "sample is early."
)
_MADE = (
    "It comes from `State::new`, from `State::restored`, or from you member by member: none of it can be without a "
    "value, so no call asks whether it was made."
)
_BITS = "Bundled functions and IEEE 754 arithmetic give the same bits as the C of the same model; no fused operation."


def documentation(step: Step, real: Real, command: str) -> list[str]:
    """The lines at the head of the crate."""
    first, *others = title(step, command)
    every = pace(step.dt, step.time)
    begin = f"Begin with `let mut s = State::new()` and `let p = Parameters::new()`. Every {every} say"
    timed = [_RUST_TIMED.format(rates=rates(step), function=step.code.timed[-1].name)] if step.code.timed else []
    manual = [
        f"{begin} `let status = s.step({arguments(step)})`, and then `let x = s.estimate(&p)`.",
        f"{period(step)} No input and no state panics. The result {result(step, 'the bits of `status`')}.",
        *parts(step, "`step`", "`{}`"),
        *timed,
        *late(step, real),
        gains(step, "`p.gain`", "`p.tune()`"),
        state(step, _MADE, "before the first call", "`{}`"),
        _BITS,
    ]
    text = [first, "", "```text", *others, "", *mathematics(step, RUST), "```"]
    text += [part for paragraph in manual for part in ("", paragraph)]
    return [f"//! {line(part)}".rstrip() for part in text]


def arguments(step: Step) -> str:
    """The arguments that a caller gives a step whose values are named as its parameters are."""
    return ", ".join(["&p", *(["&input"] if step.inputs else []), "&measurement"])


def rust_status_type(step: Step) -> str:
    """The type of a status."""
    return f"u{8 * step.layout.word.itemsize}"


def rust_status(step: Step) -> list[str]:
    """The module of the status bits."""
    kind = rust_status_type(step)
    bits = [
        text
        for k, bit in enumerate(step.layout.raised)
        for text in (
            *doc(f"{bit.meaning}. To do: {step.action_of(bit)}."),
            f"pub const {bit.name}: {kind} = 0x{1 << k:04X};",
        )
    ]
    if not bits:
        return []
    said = doc("Status bits: what happened, and what it asks of you.")
    return [*said, "pub mod status {", *indented(bits), "}", ""]
