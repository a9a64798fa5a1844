"""The heads of emitted code: NAME.h of C, with the comments of Doxygen, and the documentation of a crate of Rust.

NAME.h has structs, prototypes, status bits, and a summary of the mathematics.
"""

# Takes apart: the mathematics, whose words end no comment.

import textwrap
from collections.abc import Iterable, Iterator

import numpy as np

from hgogen.emit import pystep, saved
from hgogen.emit.code import indented
from hgogen.emit.interface import MEANINGS, direction, entries, prototype, status_type
from hgogen.emit.manual import (
    UNTIMELY,
    calls,
    document_name,
    faults,
    gains,
    late,
    mathematics,
    model_digest,
    parts,
    proved_above,
    rates,
    reports,
    result,
    state,
    summary,
    title,
)
from hgogen.emit.structs import doc, structs, typedefs
from hgogen.emit.syntax import Real
from hgogen.emit.syntaxes import (
    RUST,
    TRAILING_DOC,
    C,
    comment_text,
    documented,
    doxygen_text,
    line,
    trailing_doc,
)
from hgogen.registry import version
from hgogen.signal import plural
from hgogen.step import Step
from hgogen.stepping.sections import ROUND

# --- NAME.h

_NONE, _NO_RANGE = f"unsigned char none; {TRAILING_DOC}there are none */", "of no declared range"
TURNS_OF_FLOAT = ": a float has 24 bits, so give it modulo the period of the functions of t"
_LISTED = ("OUTSIDE_BOX", "STATE_LIMITED")  # bits whose ranges are in the manual


def header(step: Step, real: Real, command: str) -> list[str]:
    """Return the lines of a step's C header: includes, period and structs, functions, status bits, constants,
    mathematics. `command`: the command line that generated it."""
    guard, every = f"{step.name.upper()}_H", step.pace
    first, *others = map(doxygen_text, title(step, command))
    lines = _block(
        [
            *(f"@file {step.name}.h", f"@brief {first}", "", *others),
            f"One init, then {'predict and updates' if step.code.timed else 'a step'} every {every} and an estimate.",
            f"Manual: {document_name(step)}. No heap, no recursion, no static data but constant tables.",
        ]
    )
    lines += [f"#ifndef {guard}", f"#define {guard}", "", "#include <stddef.h>"]
    lines += ["#include <stdint.h>"] if status_type(step) != "unsigned" or step.code.timed else []
    period, *constants = _constants(step, real)
    lines += ["", period, ""]
    if step.code.time:
        about = f"a time in {plural(step.time)}{TURNS_OF_FLOAT * (real == 'float')}"
        lines += [documented(about), f"typedef {real} {step.name}_time;", ""]
    for struct in typedefs(
        step.name, structs(step, C, real, marked=True, notes=proved_above(step)), _NONE, lambda text: text or _NO_RANGE
    ):
        lines += struct
    lines += ["", "#ifdef __cplusplus", 'extern "C" {', "#endif", "", *_prototypes(step)]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", *_status(step)]
    constant = "initial value of constant parameters, which may lie in flash: nominal ones, tuned"
    lines += [*constants, "", documented(constant + ", with their mark" * bool(step.layout.mark))]
    lines += [*_initialiser(step, real), ""]
    equations = (comment_text(line).replace("endverbatim", "end verbatim") for line in summary(step, C))
    verbatim = _block(["@file", "@verbatim", *equations, "@endverbatim"])  # which is no text for Doxygen
    return [*lines, *verbatim, "", f"#endif /* {guard} */"]


def _prototypes(step: Step) -> Iterator[str]:
    """Yield the lines of the documented prototypes of the public functions."""
    for entry in (each for each in entries(step).values() if each.public):
        parameters = [(direction(entry, name), name, MEANINGS[name]) for name in entry.parameters]
        returned = f"0{', or the bitwise OR of status bits' * bool(step.layout.bits)}" * entry.status
        yield from (*_doxygen(entry.meaning, parameters, returned), f"{prototype(step, entry)};", "")
    save, restore = saved.prototypes(step)
    meanings = {"s": MEANINGS["s"], **saved.meanings(step)}
    for each, written, returned in ((save, "saved", ""), (restore, "s", saved.RETURNS)):
        parameters = [("out" if p.name == written else "in", p.name, meanings[p.name]) for p in each.parameters]
        yield from (*_doxygen(each.meaning, parameters, returned), f"{each};", "")


def _block(lines: Iterable[str]) -> list[str]:
    return ["/**", *(f" * {line}".rstrip() for line in lines), " */"]


def _doxygen(meaning: str, parameters: Iterable[tuple[str, str, str]], returned: str) -> list[str]:
    lines = [
        f"@brief {doxygen_text(meaning)}",
        *(f"@param[{way}] {name} {text}" for way, name, text in parameters),
    ]
    first, *others = [*lines, *([f"@return {returned}"] if returned else [])]
    *others, last = (f"/** {first}", *(f" * {line}" for line in others))
    return [*others, f"{last} */"]


def _status(step: Step) -> list[str]:
    if not step.layout.bits:
        return []
    upper, width, size = step.name.upper(), max(len(bit.name) for bit in step.layout.bits), step.layout.word.itemsize
    # in the type of the status: the complement of a narrower constant would mask the bits above it
    value = "0x{:04X}u" if status_type(step) == "unsigned" else f"UINT{8 * size}_C(0x{{:0{2 * size}X}})"
    lines = ["/** @name Status bits: what happened, and what it asks of you. */", "/** @{ */", ""]
    for k, bit in enumerate(step.layout.bits):
        ranges = f" The ranges are in {document_name(step)}." * (bit.place.name in _LISTED)
        lines += [
            documented(f"{bit.meaning}. To do: {step.action_of(bit)}.{ranges}"),
            f"#define {upper}_{bit.name:{width}} {value.format(1 << k)}",
            "",
        ]
    return [*lines, "/** @} */", ""]


def _constants(step: Step, real: Real) -> list[str]:
    length = "longest time between two calls" if step.clock.varying else "sampling period"
    rows = [("DT", C.literal(step.dt, real), f"{length} in {plural(step.time)}")]
    rows += [("VERSION", f'"{version()}"', "of hgogen, which generated this file")]
    digest = model_digest(step.observer)
    rows += [("MODEL", f'"{digest}"', "digest of the model, as in its certificate")] if digest else []
    rows += [("LAYOUT", f'"{saved.layout(step, real).hex()}"', "digest of what a saved state needs to be the same")]
    rows += (
        [("READY", f"0x{saved.mark(step, real):04X}u", "mark that init and reset write")] if step.layout.mark else []
    )
    rows += [("SAVED", f"(sizeof({step.name}_state) + {saved.ADDED}u)", "bytes of a saved state")]
    width = max(len(value) for _, value, _ in rows)
    return [f"#define {step.name.upper()}_{name:7} {value:{width}} {trailing_doc(text)}" for name, value, text in rows]


def _initialiser(step: Step, real: Real) -> list[str]:
    values = pystep.tuned(step, real)
    rows = ",\n".join(_row(step, real, values[kind]) for kind in values.dtype.names or ())
    return [f"#define {step.name.upper()}_PARAMS_INIT {{ \\", *(f"{line} \\" for line in rows.split("\n")), "}"]


def _row(step: Step, real: Real, values: np.ndarray) -> str:
    if not values.dtype.names:
        return f"    {step.name.upper()}_READY" if step.layout.mark else "    0u"
    members = []
    for name in values.dtype.names:
        texts = ", ".join(C.literal(float(value), real) for value in np.ravel(values[name]))
        members.append(texts if values.dtype[name].subdtype is None else f"{{{texts}}}")
    text = f"{{{', '.join(members)}}}"
    return textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False)


# --- the documentation of a crate

_TIMED = (
    "{rates} `{function}`, and the function of each other output, takes the number of the period in which the sample "
    "was "
    f"taken, `at`: 0 for that of the first `predict`, modulo {ROUND}. {UNTIMELY} Before the first `predict` every "
    "sample is early."
)
_ORIGIN = (
    "A state comes from `State::new`, from `State::restored`, or from you member by member: every member has a value, "
    "so no call checks a mark."
)
_BITS = "Bundled functions and IEEE 754 arithmetic give the same bits as the C of the same model; no fused operation."


def documentation(step: Step, real: Real, command: str) -> list[str]:
    """Return the documentation at the head of a step's Rust crate, as lines."""
    first, *others = title(step, command)
    every = step.pace
    new = f"State::new({'t' * len(step.code.time)})"
    begin = f"Begin with `let mut s = {new}` and `let p = Parameters::new()`. Every {every} say"
    timed = [_TIMED.format(rates=rates(step), function=step.code.timed[-1].name)] if step.code.timed else []
    lists = [
        [f"{begin} `let status = s.step({arguments(step)})`, and then `let x = s.estimate(&p)`."],
        calls(step),
        faults(step),
        [f"No input and no state panics. The result {result(step, 'the bits of `status`')}."],
        parts(step, "step"),
        timed,
        late(step, real),
        reports(step, "State::{name}"),
        gains(step, "p.tune()"),
        [*state(step, "before the first call"), _ORIGIN],
        [_BITS],
    ]
    text = [first, "", "```text", *others, "", *mathematics(step, RUST), "```"]
    for sentences in filter(None, lists):
        text += ["", *(f"- {each}" if len(sentences) > 1 else each for each in sentences)]
    return [f"//! {line(part)}".rstrip() for part in text]


def arguments(step: Step) -> str:
    """Return the argument list of a C call of a step, for a caller whose variables have the names of the parameters."""
    return ", ".join(["&p", *(["&input"] if step.given else []), "&measurement"])


def rust_status_type(step: Step) -> str:
    """Return the unsigned integer type of a step's status in Rust, which has a bit for each fault."""
    return f"u{8 * step.layout.word.itemsize}"


def rust_status(step: Step) -> list[str]:
    """Return the lines of the Rust module that defines the bits of a step's status."""
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
    return [*doc("Status bits: what happened, and what to do."), "pub mod status {", *indented(bits), "}", ""]
