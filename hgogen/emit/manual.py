"""What emitted code says at its head in every language: the mathematics, its claims, how a lost estimate restarts.

A claim is one line: its verdict, its id, and the number that its reason begins with.
"""

import numbers
from collections.abc import Container
from functools import lru_cache
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import NotCertifiable, fingerprint
from hgogen.check import Check, Verdict
from hgogen.emit.cost import cost
from hgogen.emit.naming import renaming_sentence
from hgogen.emit.promised import promised
from hgogen.emit.syntax import Real, Syntax
from hgogen.observer import Observer
from hgogen.reading.given import Misfit, field_text
from hgogen.recheck.file import DIGEST_DIGITS
from hgogen.registry import version
from hgogen.sentence import Down, Sentence, Up, same
from hgogen.signal import pace
from hgogen.step import Step
from hgogen.stepping.delays import MEMORY
from hgogen.stepping.guards import NO_PARAMETERS, UNINITIALISED
from hgogen.stepping.members import read_fields
from hgogen.stepping.sections import OLDEST


def document_name(step: Step) -> str:
    """The file that says what the head of the code leaves out: hypotheses, evidence, equations."""
    return f"{step.name}.md"


def in_short(check: Check, accepted: Container[str]) -> str:
    """The line; of a refuted claim that was accepted with what follows."""
    at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
    parts = [_clause(str(check.reason)) if _has_number(check.reason) else "", f"at {at}" if at else ""]
    taken = refuted_and_accepted(check, accepted)
    parts.append(f"so {consequence(check)}" if taken else "")
    said = "; ".join(filter(None, parts))
    return f"{verdict(check, accepted)}: {check.id}{f': {said}' if said else ''}"


def verdict(check: Check, accepted: Container[str]) -> str:
    """The verdict, and whether it was accepted."""
    return f"{check.verdict}{' (accepted by the user)' if refuted_and_accepted(check, accepted) else ''}"


def refuted_and_accepted(check: Check, accepted: Container[str]) -> bool:
    """Whether a user took a refuted claim on."""
    return check.id in accepted and check.verdict is Verdict.REFUTED


def consequence(check: Check) -> str:
    """The consequence for the reader."""
    return check.consequence or "no convergence theorem is in force"


def _has_number(value: Any) -> bool:
    """Whether a sentence names a number, or a sentence in it does."""
    if isinstance(value, Sentence):
        return any(_has_number(each) for name, each in value.values if name != "boxes")  # of a search
    if isinstance(value, tuple):
        return any(map(_has_number, value))
    return isinstance(value, numbers.Real | Up | Down) or (isinstance(value, sp.Expr) and value.is_number)


def _clause(text: str) -> str:
    """A sentence up to its first comma or semicolon outside of parentheses."""
    depth = 0
    for k, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if sign in ",;" and depth == 0:
            return text[:k]
    return text


FAULTS = (
    "An output that is not finite is missing: the step predicts. An input that is not finite reuses the last valid "
    "one. No input, however absurd, makes the state infinite or not a number. A sensor that sticks at a plausible "
    "value is not noticed."
)
UNGUARDED = (
    "This step has no guards. Every sample is used as it comes, the model is evaluated as it is written wherever the "
    "estimate goes, and nothing is clamped, capped or restarted: an input or a sample that is not a number, or absurd, "
    "spoils the state until reset is called. What is proved of the observer with guards rests on clamps and is not "
    "claimed here; the claims below are of the form alone, on the declared ranges."
)
MARKED = (
    "It begins with a mark, s.{mark}, that init and reset leave there. Memory without it (zeros, what a stack held, a "
    "page that was erased, a state of another program) is not used: the call that meets it begins as after a reset, "
    "and says {bit}. Parameters have a mark, p.{mark}, from init or PARAMS_INIT. A call that meets parameters without "
    "it takes no sample, leaves the state as after a reset, and says {none}; tune makes them nominal, and says it too. "
    "Only estimate, which has no status, does not ask: call it after a step. Parameters that nothing changes may be "
    "constant, and lie in flash: begin them with PARAMS_INIT, and call reset in place of init. The mark is no "
    "checksum: what is kept while the power is off goes through save and restore, which have one. What is saved are "
    "the bytes of the struct, for machines that have the same types in the same order of bytes."
)
_JUDGED = (
    "Whether dt is short enough was judged with gains and parameters at their nominal values, which proves nothing: "
    "others may ask for a shorter one."
)
RANGES = (
    "or the change is neither limited nor complete. Ranges are those of the model: to widen one, generate anew. "
    f"{_JUDGED} A gain whose largest value is its nominal one can only go down."
)
UNLIMITED = f"or the change is not complete; it limits nothing. {_JUDGED}"
ORDER = (
    "in this order, each once a period. Call them one by one, and or their statuses, where a sample comes later than "
    "the input. Without a sample leave its update out; with NaN it raises MISSING as well, and the last one the bits "
    "about the estimate. An update that comes again, or before a predict, does not correct, and says so."
)
ORDER_UNGUARDED = (
    "in this order, each once a period. Call them one by one where a sample comes later than the input. Without a "
    "sample leave its update out: NaN spoils the state. An update that comes again corrects again."
)
ORDER_OF_LATE = (
    "in this order. Call them one by one, and or their statuses, where several samples of an output come in one "
    "period, or none: predict once a period, an update for each sample, in any order; then adapt, once after them, "
    "raises the bits about the estimate. Until then no sample is used. Without a sample leave its update out; with NaN "
    "it raises MISSING."
)
CALL = (
    "The call at t_k uses the samples of t_k and leaves the estimate at t_k; the first call advances no time. The "
    "period is compiled in:"
)
SAMPLE = {True: "NaN for a sample that did not come", False: "a number for every sample"}
UNTIMELY = (
    f"A sample up to {OLDEST} periods older than the state is late, any other that is not of now is early; neither is "
    "used."
)
BETWEEN = {"hold": "be held at the value now", "line": "move on a straight line from the value before to that now"}


def title(step: Step, command: str) -> list[str]:
    """The title: what a step is, and what made it. Raises: `Misfit` for a command that is no text."""
    if not isinstance(command, str):
        raise Misfit("command=", command, "a text, what made the files")
    made = f"hgogen {version()}" + (f": {command}" if command else "")
    digest = model_digest(step.observer)  # which ties the emitted code to a certificate of the same model
    said = f"{digest}, as `hgogen recheck` prints it for the model's certificate"
    lines = [f"{step.name}: {step.observer.name} observer, generated by {made}"]
    lines.append(f"Model: {said if digest else 'no certificate can carry all of its functions'}")
    if step.time != "s":
        lines.append(f"Time is counted in {step.time}: call it every {pace(step.dt, step.time)}")
    return lines


def mathematics(step: Step, syntax: Syntax) -> list[str]:
    """The equations of a step and its claims, and what the language calls otherwise."""
    observer, form = step.observer, step.observer.form
    origin = form.system.origin
    plant = form.system.declared
    lines = ["Plant"] + [f"  {s}' = {e}" for s, e in zip(plant.states, plant.flow, strict=True)]
    lines += [f"  {y} = {e}" for y, e in zip(plant.outputs, plant.output, strict=True)]
    fixed = [f"{p.name} = {same(float(value))}" for p, value in plant.nominal.items()]
    lines += ["  " + ", ".join(fixed)] if fixed else []
    new = zip(form.system.states, origin.forward, strict=True) if origin else ()
    lines += ["In the states " + ", ".join(f"{w} = {e}" for w, e in new)] if origin else []
    lines += [f"Form: {form.kind}, " + ", ".join(f"{z} = {e}" for z, e in zip(form.states, form.to_form, strict=True))]
    lines += ["Observer"] + [f"  {line}" for line in observer.equations]
    lines += [f"  {field_text(f)}" for f in step.layout.gains]
    lines += [f"Method: {step.code.rule}, dt = {pace(step.dt, step.time)}"]
    lines += [f"Made for {step.clock.prefer}{f': {step.choice}' * bool(step.choice)}"] * said_what_for(step)
    lines += ["Guards: none"] * (not guarded(step))
    lines += [f"Between two calls the input is taken to {BETWEEN[step.clock.between]}"] * bool(step.inputs)
    lines += [f"Reference: {observer.reference}", "Claims"]
    lines += [f"  {in_short(check, observer.accepted)}" for check in observer.checks]
    lines += promised(step)
    lines += [f"Hypotheses of its theorem, and the evidence of the claims: {document_name(step)}"]
    names = renaming_sentence(step, syntax)
    return [*lines, f"{names[0].upper()}{names[1:]}"] if names else lines


SHORT = 4  # equations of a plant that are in the head of C
LINE = 100  # columns of one


def summary(step: Step, syntax: Syntax) -> list[str]:
    """Return what a step is in about ten lines: what of its equations is short, and the claims that are not proved."""
    observer, plant = step.observer, step.observer.form.system.declared
    equations = [f"{s}' = {e}" for s, e in zip(plant.states, plant.flow, strict=True)]
    equations += [f"{y} = {e}" for y, e in zip(plant.outputs, plant.output, strict=True)]
    counted = ((plant.states, "state"), (plant.inputs, "input"), (plant.outputs, "output"))
    sizes = ", ".join(f"{len(each)} {name}{'s' * (len(each) != 1)}" for each, name in counted)
    short = len(equations) <= SHORT and max(map(len, equations)) <= LINE
    lines = ["Plant", *(f"  {each}" for each in equations)] if short else [f"Plant: {sizes}"]
    lines += [f"Form: {observer.form.kind}", f"Observer: {observer.name}"]
    own = (*observer.equations, *(field_text(f) for f in step.layout.gains))
    lines += [f"  {each}" for each in own if len(each) <= LINE][:SHORT]
    lines += [f"Method: {step.code.rule}, dt = {pace(step.dt, step.time)}"]
    lines += [f"Made for {step.clock.prefer}{f': {step.choice}' * bool(step.choice)}"] * said_what_for(step)
    lines += ["Guards: none"] * (not guarded(step))
    left = [check for check in observer.checks if check.verdict is not Verdict.PROVED]
    lines += [f"Claims: {len(observer.checks) - len(left)} proved"]
    lines += [f"  {in_short(each, observer.accepted)}" for each in left]
    lines += promised(step)[:1]
    lines += [f"Hypotheses of its theorem, and the evidence of the claims: {document_name(step)}"]
    names = renaming_sentence(step, syntax)
    return [*lines, f"{names[0].upper()}{names[1:]}"] if names else lines


def said_what_for(step: Step) -> bool:
    """Whether the manual names what a step is made for: where that is flash, or where the covariance is in loops."""
    return step.clock.prefer == "flash" or any(group.name == "column" for group in step.layout.groups)


def guarded(step: Step) -> bool:
    """Whether it has guards."""
    return step.clock.guarded


def period(step: Step, by_parts: bool = False) -> str:
    """The paragraph on the call of a period: what it uses and leaves, and what it does with absurd signals and with an
    estimate that is lost; `by_parts`: a caller with guards calls its parts."""
    once = "predict for each" if by_parts and guarded(step) else f"call for each, with {SAMPLE[guarded(step)]}"
    return f"{CALL} one {once}. {f'{FAULTS} {recovery(step)}' if guarded(step) else UNGUARDED}"


def parts(step: Step, name: str, quoted: str = "{}") -> list[str]:
    """The paragraph on calls of single sections, where they can be called.

    Args: `name`, what calls all; `quoted`: {}, the name of a section in a text.
    """
    sections = ", ".join(quoted.format(section.name) for section in step.code.sections)
    order = ORDER_OF_LATE if step.ages else ORDER if guarded(step) else ORDER_UNGUARDED
    return [f"{name} is {sections}: {order}"] if step.code.apart else []


def gains(step: Step, members: str, call: str) -> str:
    """The paragraph on a change of gains, which are these members, and the call that completes it."""
    return f"Change gains in {members}, then call {call}, {RANGES if guarded(step) else UNLIMITED}"


def state(step: Step, made: str, before: str, quoted: str = "{}") -> str:
    """The paragraph on what may be done with a state; `made`: where it comes from, or ""; `before`: the call before
    which it may be written."""
    read = read_fields([step.observer.z])
    own = " and ".join(quoted.format(f"s.{field.name}") for field in step.layout.state if field.name in read)
    sentences = (
        "The state may be copied. What save gives of it is restored by the same program, and refused where the model, "
        "the observer, a default gain, dt, the precision or a bit is another.",
        made,
        f"To start from an estimate of yours write {own}, in the coordinates that the struct names, {before}, which "
        "takes the estimate as it stands; what else a step remembers of it starts there too.",
    )
    return " ".join(filter(None, sentences))


def result(step: Step, bits: str) -> str:
    """The sentence on what a call returns; `bits`: where the bits of a status are."""
    return f"is 0 for ok, else an or of {bits}" if guarded(step) else "is 0 in any case"


def marked(step: Step) -> str:
    """The paragraph on the mark of a state that init or reset has made; "" without guards."""
    mark = step.layout.mark
    return MARKED.format(mark=mark.name, bit=UNINITIALISED.name, none=NO_PARAMETERS.name) if mark else ""


def remembered(step: Step) -> str:
    """The meaning of the state to a caller."""
    limits = (
        "; ranges are limits, which no call leaves; what was restored from beyond them is limited, or begins anew, "
        "where a call next computes with it"
    )
    return f"what a step remembers: yours to copy, save and restore{limits * guarded(step)}"


def late(step: Step, real: Real) -> list[str]:
    """The paragraph on late samples and their worst cost, where samples may be late."""
    if step.plain is None:
        return []
    pairs = list(zip(step.late, step.ages, strict=True))
    ages = ", ".join(f"with a sample of {y.name} goes {age.name}" for y, age in pairs)
    most = ", ".join(f"{age.name} up to {age.interval[1]:g}" for _, age in pairs)
    slots = next(group.count for group in step.layout.groups if group.name == MEMORY)
    once, worst = cost(step.plain, real), cost(step, real)
    return [
        f"Late samples: {ages}, the number of periods ago in which it was taken, 0 for now, {most}. It is fused in "
        "that period, and what follows is run again, so that the estimate becomes what it would be had the sample come "
        "in time; what is run again has the gains of now. Samples may come in any order, one of an output for each "
        "period; an older one, a second one of its period, and one whose age is no whole number are not used, and the "
        "status says so. "
        "Where adapt is left out in a period, its samples wait; a predict that makes one that waits more than "
        f"{slots - 1} periods old drops it, and says DROPPED. MISSING is said of the call, any other bit of every "
        f"period that the call ran, those that it ran again among them. A period takes {once.operations} operations "
        f"and {once.functions} functions (root, sine, table, ..), a call that runs all of the {slots} that are "
        f"remembered, as each does of a sensor that is always so late, no more than {worst.operations} and "
        f"{worst.functions}. The state has {worst.state} bytes with them, {once.state} without delays."
    ]


def recovery(step: Step) -> str:
    """When an estimate that is lost restarts."""
    if not step.code.signs:
        return "No declared range says where y or the estimate can be, so nothing restarts an estimate that is lost."
    counts = ", and ".join(f"samples at which {sign.meaning} in s.{sign.count}" for sign in step.code.signs)
    times = " or ".join(dict.fromkeys(pace(float(f"{sign.time:.3g}"), step.time) for sign in step.code.signs))
    longest = pace(float(f"{max(sign.longest for sign in step.code.signs):.2g}"), step.time)
    guards = [
        "where that of y reaches its limit" if any(sign.output is not None for sign in step.code.signs) else "",
        "where that of the range does while the estimate is outside by half of a range, or does so again"
        if any(sign.output is None for sign in step.code.signs)
        else "",
    ]
    counted = ["the fault counts", *(f"s.{field.name}" for field in step.layout.state if field.lasting)]
    lasting = " and ".join(filter(None, (", ".join(counted[:-1]), counted[-1])))
    projected = "Where that of the range first reaches its limit, the estimate is projected onto the declared ranges. "
    return (
        f"The step counts {counts}; other samples count down, and so does each change of sign of the error, so that "
        f"noise does not add up. A guard acts where a count reaches its limit, after {times} of such samples at the "
        f"least. {projected * bool(guards[1])}All of the state but {lasting} restarts from the sample "
        f"{', and '.join(filter(None, guards))}. The count stays and its limit doubles, so that a guard acts again "
        f"when such samples have come for twice as long in all, later every {longest}, until the count is 0 again: "
        "after a fault that has lasted long, a restart may take as long once more."
    )


def rates(step: Step) -> str:
    """The paragraph on how often each output of a step has a sample."""
    each = (f"{y} every {pace(period, step.time)}" for y, period in zip(step.outputs, step.clock.periods, strict=True))
    return (
        f"Sensors of different rates: {', '.join(each)}. The noise R of an output is taken for that period: give no "
        "sample more often."
    )


@lru_cache(maxsize=32)  # a header names it twice, and steps of one observer do
def model_digest(observer: Observer) -> str:
    """The digest that `hgogen recheck` prints of the model; "" where no certificate can carry it."""
    try:
        return fingerprint(observer.form, observer.checks, observer.name)[:DIGEST_DIGITS]
    except NotCertifiable:
        return ""
