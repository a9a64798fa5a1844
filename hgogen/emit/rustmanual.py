"""The documentation of an emitted crate: the banner, how to call it, what it promises, the status bits."""

from hgogen.emit.code import indented
from hgogen.emit.manual import UNTIMELY, gains, late, mathematics, parts, period, rates, result, state, title
from hgogen.emit.structs import doc
from hgogen.emit.syntax import Real
from hgogen.emit.syntaxes import RUST, line
from hgogen.reading.time_unit import pace
from hgogen.step import Step
from hgogen.stepping.sensors import ROUND

_TIMED = (
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
    timed = [_TIMED.format(rates=rates(step), function=step.code.timed[-1].name)] if step.code.timed else []
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
    """What a caller gives a step whose values are named as its parameters are."""
    return ", ".join(["&p", *(["&input"] if step.inputs else []), "&output"])


def rust_status_type(step: Step) -> str:
    """The type of a status."""
    return f"u{8 * step.layout.word.itemsize}"


def status(step: Step) -> list[str]:
    """The module of the status bits."""
    kind = rust_status_type(step)
    bits = [
        text
        for k, bit in enumerate(step.layout.raised)
        for text in (
            *doc(f"{bit.meaning}. To do: {step.asked(bit)}."),
            f"pub const {bit.name}: {kind} = 0x{1 << k:04X};",
        )
    ]
    if not bits:
        return []
    said = doc("Status bits: what happened, and what it asks of you.")
    return [*said, "pub mod status {", *indented(bits), "}", ""]
