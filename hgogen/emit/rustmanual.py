"""The documentation of an emitted crate: the banner, how to call it, what it promises, the status bits."""

from hgogen.emit.code import indented
from hgogen.emit.manual import faults, guarded, late, mathematics, order, own, ranges, rates, result, title
from hgogen.emit.ruststruct import doc
from hgogen.emit.rustsyntax import RUST, line
from hgogen.emit.syntax import Real
from hgogen.reading.time_unit import pace
from hgogen.step import Step
from hgogen.stepping.sensors import OLDEST, ROUND

_TIMED = (
    "Sensors of different rates: {rates}. The noise R of an output is taken for that period: give no sample more "
    "often. `{function}` and the like of other outputs is told the number of the period in which the sample was "
    "taken, `at`: 0 for that of the first `predict`, modulo {round}. A sample up to {oldest} periods older than the "
    "state is late, any other that is not of now is early; neither is used. Before the first `predict` every sample "
    "is early."
)
_GAINS = "Change gains in `p.gain`, then call `p.tune()`, "
_STATE = (
    "The state may be copied, saved and restored, by the same version of this file. It comes from `State::new`, or "
    "from you member by member: none of it can be without a value, so no call asks whether it was made. To start from "
    "an estimate of yours write {own}, in the coordinates that the struct names, before the first call, which takes "
    "the estimate as it stands; what else a step remembers of it starts there too."
)
_SAMPLE = {True: "NaN for a sample that did not come", False: "a number for every sample"}
_BITS = "Bundled functions and IEEE 754 arithmetic give the same bits as the C of the same model; no fused operation."


def documentation(step: Step, real: Real, command: str) -> list[str]:
    """The lines at the head of the crate."""
    first, *others = title(step, command)
    text = [
        first,
        "",
        "```text",
        *others,
        "",
        *mathematics(step, RUST),
        "```",
        *(part for paragraph in _manual(step, real) for part in ("", paragraph)),
    ]
    return [f"//! {line(part)}".rstrip() for part in text]


def arguments(step: Step) -> str:
    """What a caller gives a step whose values are named as its parameters are."""
    return ", ".join(["&p", *(["&input"] if step.inputs else []), "&output"])


def status(step: Step) -> list[str]:
    """The module of the status bits."""
    bits = [
        text
        for k, bit in enumerate(step.raised)
        for text in (*doc(f"{bit.meaning}. To do: {step.asked(bit)}."), f"pub const {bit.name}: u32 = 0x{1 << k:04X};")
    ]
    if not bits:
        return []
    said = doc("Status bits: what happened, and what it asks of you.")
    return [*said, "pub mod status {", *indented(bits), "}", ""]


def _manual(step: Step, real: Real) -> list[str]:
    """Its paragraphs."""
    every = pace(step.dt, step.time)
    begin = f"Begin with `let mut s = State::new()` and `let p = Parameters::new()`. Every {every} say"
    sections = ", ".join(f"`{section.name}`" for section in step.sections)
    parts = [f"`step` is {sections}: {order(step)}"] if step.apart else []
    if step.timed:
        parts += [_TIMED.format(rates=rates(step), function=step.timed[-1].name, round=ROUND, oldest=OLDEST)]
    parts += [late(step, real)] if step.ages else []
    return [
        f"{begin} `let status = s.step({arguments(step)})`, and then `let x = s.estimate(&p)`.",
        "The call at t_k uses the samples of t_k and leaves the estimate at t_k; the first call advances no time. The "
        f"period is compiled in: one call for each, with {_SAMPLE[guarded(step)]}. {faults(step)} No input and no "
        f"state panics. The result {result(step, 'the bits of `status`')}.",
        *parts,
        _GAINS + ranges(step),
        _STATE.format(own=" and ".join(f"`{name}`" for name in own(step))),
        _BITS,
    ]
