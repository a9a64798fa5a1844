"""The texts of emitted code in every language: title, mathematics, claims, proved error bounds, and how to call a step.

A claim is one line: its verdict, its id, and the number that its reason begins with. The functions on calls return
sentences, of which the targets make paragraphs or lists; code in them is between backquotes.

Numbers that a solver leads to have two digits, rounded to the safe side, so that another version of it seldom writes
others; what a user has given is printed unchanged.
"""

import numbers
from collections.abc import Callable, Container, Iterator, Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Any

import sympy as sp

from hgogen.certificates.certificate import NotCertifiable, fingerprint
from hgogen.check import Check, Verdict
from hgogen.emit.cost import cost, counted
from hgogen.emit.interface import FIRST_CALL
from hgogen.emit.naming import renaming_sentence
from hgogen.emit.syntax import Real, Syntax
from hgogen.estimators.factored import WAITS
from hgogen.estimators.noise import deviation_lines
from hgogen.observer import Observer
from hgogen.program import Place
from hgogen.prove.convergence import EXISTS
from hgogen.prove.questions import Each, Signed
from hgogen.reading.given import Misfit, field_text
from hgogen.recheck.file import DIGEST_DIGITS
from hgogen.registry import version
from hgogen.sentence import Down, Sentence, Up, down, same, up
from hgogen.signal import Signal, pace
from hgogen.step import Step
from hgogen.stepping.delays import MEMORY
from hgogen.stepping.guards import NO_PARAMETERS, STEP_BITS, UNINITIALISED
from hgogen.stepping.members import read_fields
from hgogen.stepping.sections import OLDEST
from hgogen.stepping.substeps import ELAPSED

# --- title, mathematics and claims


def document_name(step: Step) -> str:
    """Return the file name of a step's manual, with hypotheses, evidence and equations."""
    return f"{step.name}.md"


def claim_line(check: Check, accepted: Container[str]) -> str:
    """Return one line for a claim: its verdict and reason; for a refuted claim that the user accepted (its id is in
    `accepted`) also the consequence."""
    at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
    parts = [_first_clause(str(check.reason)) if _has_number(check.reason) else "", f"at {at}" if at else ""]
    parts.append(f"so {consequence(check)}" if refuted_and_accepted(check, accepted) else "")
    evidence = "; ".join(filter(None, parts))
    return f"{verdict(check, accepted)}: {check.id}{f': {evidence}' if evidence else ''}"


def verdict(check: Check, accepted: Container[str]) -> str:
    """Return the verdict of a claim as text, and whether the user accepted the claim (its id is in `accepted`)."""
    return f"{check.verdict}{' (accepted by the user)' if refuted_and_accepted(check, accepted) else ''}"


def refuted_and_accepted(check: Check, accepted: Container[str]) -> bool:
    """Return whether a claim is refuted and the user accepted it."""
    return check.id in accepted and check.verdict is Verdict.REFUTED


def consequence(check: Check) -> str:
    """Return what follows for the user from an accepted claim."""
    return check.consequence or "no convergence theorem is in force"


def _has_number(value: Any) -> bool:
    if isinstance(value, Sentence):
        return any(_has_number(each) for name, each in value.values if name != "boxes")  # of a search
    if isinstance(value, tuple):
        return any(map(_has_number, value))
    return isinstance(value, numbers.Real | Up | Down) or (isinstance(value, sp.Expr) and value.is_number)


def _first_clause(text: str) -> str:
    depth = 0
    for k, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if sign in ",;" and depth == 0:
            return text[:k]
    return text


_NO_CERTIFICATE = "no certificate can carry all of its functions"
BETWEEN = {
    False: {
        "hold": "Since the call before, the input is taken to have had the value of this call",
        "line": "Since the call before, the input is taken to have moved on a straight line from its last value to "
        "that of this call",
    },
    True: {  # of a discrete plant
        "hold": "The input of a call moved the plant from the call before to this one",
        "line": "The input of a call moves the plant from this call to the next",
    },
}


def between_calls(step: Step) -> str:
    """Return the sentence, without full stop, on the course of the input between two calls (line or hold); "" for a
    plant without inputs."""
    return BETWEEN[step.observer.form.system.discrete][step.clock.between] if step.inputs else ""


def title(step: Step, command: str) -> list[str]:
    """Return the lines that head a manual: the step's purpose, and the version and `command` that generated it.

    Raises: `Misfit` for a command that is no text.
    """
    if not isinstance(command, str):
        raise Misfit("command=", command, "a text, what made the files")
    generator = f"hgogen {version()}" + (f": {command}" if command else "")
    digest = model_digest(step.observer)  # which ties the emitted code to a certificate of the same model
    certificate = f"{digest}, as `hgogen recheck` prints it for the model's certificate"
    lines = [f"{step.name}: {step.observer.name} observer, generated by {generator}"]
    none = "no certificate is made of a discrete plant" if step.observer.form.system.discrete else _NO_CERTIFICATE
    lines.append(f"Model: {certificate if digest else none}")
    if step.time != "s":
        lines.append(f"Time is counted in {step.time}: call it every {step.pace}")
    return lines


@lru_cache(maxsize=32)  # a header names it twice, and steps of one observer do
def model_digest(observer: Observer) -> str:
    """Return the digest that identifies an observer's model, as `hgogen recheck` prints it; "" where no certificate can
    contain the model."""
    if observer.form.system.discrete:
        return ""
    try:
        return fingerprint(observer.form, observer.checks, observer.name)[:DIGEST_DIGITS]
    except NotCertifiable:
        return ""


def mathematics(step: Step, syntax: Syntax) -> list[str]:
    """Return the lines on a step's equations and claims, and on names that the language of `syntax` changes."""
    observer, form = step.observer, step.observer.form
    origin = form.system.origin
    plant = form.system.declared
    lines = ["Plant", *(f"  {each}" for each in _equations(step))]
    fixed = [f"{p.name} = {same(float(value))}" for p, value in plant.nominal.items()]
    lines += ["  " + ", ".join(fixed)] if fixed else []
    recast = zip(form.system.states, origin.forward, strict=True) if origin else ()
    lines += ["In the states " + ", ".join(f"{w} = {e}" for w, e in recast)] if origin else []
    lines += [f"Form: {form.kind}, " + ", ".join(f"{z} = {e}" for z, e in zip(form.states, form.to_form, strict=True))]
    lines += ["Observer"] + [f"  {line}" for line in observer.equations]
    lines += [f"  {field_text(f)}" for f in step.layout.gains] + [f"  {line}" for line in sample_noise(step)]
    lines += _method(step)
    lines += [between_calls(step)] * bool(step.inputs and not step.observer.form.system.discrete)
    lines += [f"Reference: {observer.reference}", "Claims"]
    lines += [f"  {claim_line(check, observer.accepted)}" for check in observer.checks]
    return [*lines, *proved_bounds(step), *_references(step, syntax)]


FEW = 4  # equations of a plant that are in the head of C
LINE = 100  # columns of one


def summary(step: Step, syntax: Syntax) -> list[str]:
    """Return about ten lines on a step: its equations if they are short, and the claims that are not proved."""
    observer, plant = step.observer, step.observer.form.system.declared
    equations = _equations(step)
    counted = ((plant.states, "state"), (plant.inputs, "input"), (plant.outputs, "output"))
    sizes = ", ".join(f"{len(each)} {name}{'s' * (len(each) != 1)}" for each, name in counted)
    brief = len(equations) <= FEW and max(map(len, equations)) <= LINE
    lines = ["Plant", *(f"  {each}" for each in equations)] if brief else [f"Plant: {sizes}"]
    lines += [f"Form: {observer.form.kind}", f"Observer: {observer.name}"]
    laws = (*observer.equations, *(field_text(f) for f in step.layout.gains))
    lines += [f"  {each}" for each in laws if len(each) <= LINE][:FEW] + [f"  {line}" for line in sample_noise(step)]
    lines += _method(step)
    unproved = [check for check in observer.checks if check.verdict is not Verdict.PROVED]
    lines += [f"Claims: {len(observer.checks) - len(unproved)} proved"]
    lines += [f"  {claim_line(each, observer.accepted)}" for each in unproved]
    return [*lines, *proved_bounds(step)[:1], *_references(step, syntax)]


def _equations(step: Step) -> list[str]:
    plant = step.observer.form.system.declared
    equations = [f"{s}{plant.next_mark} = {e}" for s, e in zip(plant.states, plant.flow, strict=True)]
    return equations + [f"{y} = {e}" for y, e in zip(plant.outputs, plant.output, strict=True)]


def sample_noise(step: Step) -> tuple[str, ...]:
    """Return the declared noise of a sample as sentences, none where the noise was declared as a density."""
    return deviation_lines(step) if step.observer.at_period else ()


def _method(step: Step) -> list[str]:
    lines = [f"Method: {step.code.rule}, dt = {step.pace}"]
    if step.observer.form.system.discrete:  # libraries differ in both
        lines += [*filter(None, [between_calls(step)]), f"The first call {FIRST_CALL[step.clock.first]}"]
    lines += [f"Made for {step.clock.prefer}{f': {step.choice}' * bool(step.choice)}"] * names_preference(step)
    return lines + ["Guards: none"] * (not step.clock.guarded)


def _references(step: Step, syntax: Syntax) -> list[str]:
    lines = [f"Hypotheses of its theorem, and the evidence of the claims: {document_name(step)}"]
    names = renaming_sentence(step, syntax)
    return [*lines, f"{names[0].upper()}{names[1:]}"] if names else lines


def names_preference(step: Step) -> bool:
    """Return whether the manual states the user's preference (speed or flash): for flash, or if the covariance is
    computed in loops."""
    return step.clock.prefer == "flash" or any(group.name == "column" for group in step.layout.groups)


def proved_above(step: Step) -> dict[str, str]:
    """Return by the name of a gain (theta) a note on the bound above which convergence of the error is proved."""
    for check in step.observer.checks:
        if check.claim == EXISTS and check.verdict is Verdict.PROVED:
            values = dict(check.reason.values)
            bound: Up = values["bound"] if "bound" in values else values["why"].part("bound")  # while angles stay near
            return {"theta": f"; convergence is proved above {up(bound.value, _DIGITS, bound.below)}"}
    return {}


# --- how to call a step

_UNGUARDED = (
    "This step has no guards. Every sample is used as it comes, the model is evaluated wherever the estimate is, and "
    "nothing is clamped, capped or restarted.",
    "An input or a sample that is not a number, or absurd, spoils the state until reset is called.",
    "The proofs of the observer with guards assume clamps and are not claimed here: the claims below are of the form "
    "alone, on the declared ranges.",
)
_JUDGED = (
    "Whether dt is short enough was judged with gains and parameters at their nominal values, which proves nothing for "
    "others: they may need a shorter dt."
)
UNTIMELY = (
    f"A sample up to {OLDEST} periods older than the state is late, any other that is not of the state's period is "
    "early; "
    "neither is used."
)


def calls(step: Step, by_parts: bool = False) -> list[str]:
    """Return the sentences on how to call a step: which samples a call uses, and when to call; `by_parts`: for a caller
    of single sections (predict, correct ..)."""
    sample = "NaN for a missing sample" if step.clock.guarded else "a number for every sample"
    once = "predict for each" if by_parts and step.clock.guarded else f"call for each, with {sample}"
    return [
        f"The call at t_k uses the samples of t_k and leaves the estimate at t_k; the first call "
        f"{FIRST_CALL[step.clock.first]}.",
        *([f"The period is compiled in: one {once}."] if step.clock.varying is None else _elapsed(step)),
        *[_JITTER] * (step.clock.varying is None and not step.observer.form.system.discrete),
    ]


_JITTER = (
    "If a call is late by d, its samples are wrong by d times the rates of their outputs; if the period is wrong by "
    "10 %, "
    "so are estimated rates. No status bit shows this. A step whose dt is a pair, the shortest and the longest, takes "
    "the time since the last call."
)


def _elapsed(step: Step) -> list[str]:
    """Return the sentences on the time since the last call that each call is given."""
    assert step.clock.varying
    count = step.clock.varying.substeps
    longest, most = pace(step.dt, step.time), pace(count * step.dt, step.time)
    return [
        f"Each call is given the time since the last call as {ELAPSED}, a member of the input, and predicts over it: "
        f"over 0 it only corrects, over more than {longest} it predicts in up to {count} equal steps.",
        f"Beyond {most} it stops: the estimate lags by {ELAPSED} - {most}, and the status bit DT_LIMITED is set. A "
        "negative time, or one that is not a number, counts as 0, and DT_REFUSED is set.",
        f"A time below {same(step.shortest)} {step.time} is used as it is: that end is for the checks of the step "
        "length, and for the resolution of fault counts, which count times in place of calls.",
        *["The time t of the equations goes on by all of dt, also by what the prediction does not reach."]
        * bool(step.observer.form.system.times),
    ]


def faults(step: Step) -> list[str]:
    """Return the sentences on how a step treats missing or implausible signals, and an estimate that is lost."""
    if not step.clock.guarded:
        return list(_UNGUARDED)
    return [
        "An output that is not finite is missing: the step predicts. An input that is not finite is replaced by the "
        "last valid one.",
        "No input, however absurd, makes the state infinite or not a number.",
        "A sensor that sticks at a plausible value is not noticed.",
        *recovery(step),
    ]


def recovery(step: Step) -> list[str]:
    """Return the sentences on a step's fault counts, and on the restart of an estimate that is lost."""
    signs = step.code.signs
    if not signs:
        return ["No declared range says where y or the estimate can be, so nothing restarts an estimate that is lost."]
    counts = ", and ".join(f"samples at which {sign.meaning} in `s.{sign.count}`" for sign in signs)
    unit = step.dt / step.clock.longest  # 1 but for a discrete plant, whose signs count samples
    times = " or ".join(dict.fromkeys(pace(float(f"{unit * sign.time:.3g}"), step.time) for sign in signs))
    longest = pace(float(f"{unit * max(sign.longest for sign in signs):.2g}"), step.time)
    of_output = any(sign.output is not None for sign in signs)
    of_range = any(sign.output is None for sign in signs)
    causes = ["the count of an output reaches its limit"] * of_output
    causes += ["that of the range does while the estimate is outside by half of a range, or does so again"] * of_range
    memory = ["fault counts", "last input and samples", *(f"`s.{f.name}`" for f in step.layout.state if f.lasting)]
    projected = "When the count of the range first reaches its limit, the estimate is projected onto its ranges."
    return [
        f"The step counts {counts}. Any other sample decreases the count, and so does each change of sign of the "
        "error, "
        "so that noise does not accumulate.",
        *[f"A sample counts by the time since the last call over {pace(step.dt, step.time)}, at most as 1."]
        * bool(step.clock.varying),
        f"A guard acts when a count reaches its limit, which takes {times} of such samples or more.",
        "At a sample that is counted, counts and limits are set as after a reset if one is out of its range, or if "
        "their "
        "sum differs from `s.fault_checksum`. Other changes of them in memory are not noticed.",
        *[projected] * of_range,
        f"The observer restarts from the sample when {', and when '.join(causes)}. It keeps its {', '.join(memory)} "
        "and counters of calls.",
        f"After a guard has acted, its count stays and its limit doubles: the guard acts again when such samples have "
        f"come for twice as long in all, later every {longest}, until the count is 0 again. After a long fault a "
        "restart "
        "may take as long once more.",
    ]


def parts(step: Step, name: str) -> list[str]:
    """Return the sentences on calls of single sections (predict, correct ..), none for a step without such calls;
    `name`: the function that runs all sections."""
    if not step.code.separable:
        return []
    sections = ", ".join(f"`{section.name}`" for section in step.code.sections)
    if step.ages:
        return [
            f"`{name}` is {sections}: in this order. Call them one by one, and or their statuses, where several "
            "samples of an output come in one period, or none.",
            "Call predict once a period, an update for each sample, in any order, and adapt once after them. Until "
            "then no sample is used; adapt, once after them, raises the bits about the estimate.",
            "For a missing sample leave its update out; with NaN it raises MISSING.",
        ]
    order = f"`{name}` is {sections}: in this order, each once a period."
    if not step.clock.guarded:
        return [
            f"{order} Call them one by one where a sample comes later than the input.",
            "For a missing sample leave its update out: NaN spoils the state. An update that comes again corrects "
            "again.",
        ]
    together = "An update stores its sample. `adapt`, once after all updates, corrects the estimate by all of them."
    every = "`innovate` takes the samples of all outputs, NaN for a missing one."
    judged = "`gate` takes the samples of all outputs that have a gate, NaN for a missing one."
    return [
        f"{order} Call them one by one, and or their statuses, where a sample comes later than the input.",
        *[every] * any(section.name == "innovate" for section in step.code.sections),
        *[judged] * any(section.name == "gate" for section in step.code.sections),
        *[together] * any(field.name.startswith(WAITS) for field in step.layout.state),
        "For a missing sample leave its update out, or call it with NaN, which also raises MISSING. Only the last part "
        "raises OUTSIDE_BOX; any part raises the other bits.",
        "A second update of the same sample, or an update before a predict, does not correct, and raises a bit.",
    ]


def rates(step: Step) -> str:
    """Return the sentences on how often each output of a step has a sample."""
    each = (f"{y} every {pace(period, step.time)}" for y, period in zip(step.outputs, step.periods, strict=True))
    return (
        f"Sensors of different rates: {', '.join(each)}. The noise R of an output is taken for that period: give no "
        "sample more often."
    )


def late(step: Step, real: Real) -> list[str]:
    """Return the sentences on late samples and the cost of a late sample in the worst case, none if no sample may be
    late."""
    if step.plain is None:
        return []
    pairs = list(zip(step.late, step.ages, strict=True))
    ages = ", ".join(f"with a sample of {y.name} goes {age.name}" for y, age in pairs)
    most = ", ".join(f"{age.name} up to {age.interval[1]:g}" for _, age in pairs)
    slots = next(group.count for group in step.layout.groups if group.name == MEMORY)
    once, worst = cost(step.plain, real), cost(step, real)
    return [
        f"Late samples: {ages}, the number of periods ago in which it was taken, 0 for now, {most}.",
        "A late sample is fused in its period, and the step runs again from there, so that the estimate becomes what "
        "it would be had the sample come in time. The periods that run again use the present gains.",
        "Samples may come in any order, one of an output for each period. An older one, a second one of its period, "
        "and one whose age is no whole number are not used, and the status says so.",
        f"If adapt is left out in a period, the samples of this period wait. A predict after which a waiting sample is "
        f"more than {slots - 1} periods old drops this sample, and raises DROPPED.",
        "MISSING is about the samples of the call, any other bit about every period that the call ran or ran again.",
        f"A period takes {once.operations} operations and {once.functions} functions (root, sine, table, ..). A call "
        f"that runs all {slots} remembered periods again, as every call does if a sensor is always that late, takes no "
        f"more than {worst.operations} and {worst.functions}.",
        f"The state has {worst.state} bytes with them, {once.state} without delays.",
    ]


_TUNABLE = {"plant": "parameters of the plant", "gain": "gains"}


def tunable(step: Step) -> list[str]:
    """Return the members of the parameters that a caller may change."""
    kinds = {"plant": step.layout.plant, "gain": step.layout.gains}
    return [kind for kind, fields in kinds.items() if fields]


def gains(step: Step, tune: str) -> list[str]:
    """Return the sentences on changing gains and parameters at run time; `tune`: the text of the call that completes a
    change."""
    if not tunable(step):
        return ["There are no gains or parameters to change."]
    change = f"Change {' and '.join(f'{_TUNABLE[kind]} in `p.{kind}`' for kind in tunable(step))}, then call `{tune}`"
    judged = [] if step.observer.form.system.discrete else [_JUDGED]
    if not step.clock.guarded:
        return [f"{change}, or the change is not complete; it limits nothing.", *judged]
    return [
        f"{change}, or the change is neither limited nor complete.",
        "Ranges are those of the model: to widen one, generate anew. A gain whose largest value is its nominal one can "
        "only be lowered.",
        *judged,
    ]


def state(step: Step, before: str) -> list[str]:
    """Return the sentences on copying, saving and writing a step's state; `before`: when the state may be written."""
    read = read_fields([step.observer.z])
    estimate = " and ".join(f"`s.{field.name}`" for field in step.layout.state if field.name in read)
    corrects = ", and its updates correct the estimate at once" * step.code.separable
    limits = "If a restored number is beyond its range, the call that uses it limits it, or begins the state anew."
    return [
        "The state may be copied. `restore` takes the bytes that `save` of the same program wrote. It refuses those of "
        "another model, observer, default gain, dt or precision, and bytes that have changed.",
        "A restored state goes on as if no time had passed: call `reset` where the plant has moved on.",
        *[limits] * step.clock.guarded,
        f"To start from your own estimate, write {estimate}, in the coordinates that the struct names, {before}. "
        f"That call {FIRST_CALL[step.clock.first]}{corrects}; all else that the state stores of the estimate starts "
        "there too.",
    ]


def reports(step: Step, call: str) -> list[str]:
    """Return the sentences on the reports of a step; `call`: the text of a function, with {name}."""
    lines = []
    for report in step.code.reports:
        operations, functions = counted(report.program)
        lines += [f"`{call.format(name=report.name)}` gives the {report.meaning}.", *report.notes]
        lines.append(f"A call of it takes {operations} operations and {functions} functions (root, ..).")
    return lines


def marks(step: Step) -> list[str]:
    """Return the sentences on the marks, numbers that tag initialised state and parameters; none for a step without
    guards."""
    if not step.layout.mark:
        return []
    name, unmade, none = step.layout.mark.name, UNINITIALISED.name, NO_PARAMETERS.name
    return [
        f"The state begins with a mark, `s.{name}`, that `init` and `reset` write. Memory without it (zeros, what a "
        "stack held, an erased page, a state of another program) is not used: the call begins as after a reset, and "
        f"raises `{unmade}`.",
        f"Parameters have a mark, `p.{name}`, from `init` or `PARAMS_INIT`. A call with parameters without it takes no "
        f"sample, leaves the state as after a reset, and raises `{none}`; `tune` makes them nominal and raises it too.",
        "`estimate` has no status and checks no mark: call it after a step.",
        "Constant parameters may lie in flash: begin them with `PARAMS_INIT`, and call `reset` in place of `init`.",
        "The mark is no checksum: a state that is kept while the power is off goes through `save` and `restore`, which "
        "have one.",
        "`save` copies the bytes of the struct: restore them on a machine with the same types in the same order of "
        "bytes.",
    ]


def result(step: Step, bits: str) -> str:
    """Return the sentence on what a call of a step returns; `bits`: the place where the status bits are documented."""
    return f"is 0 for ok, else the bitwise OR of {bits}" if step.clock.guarded else "is 0 in any case"


def remembered(step: Step) -> str:
    """Return the comment of the C struct of a step's state, on what the state remembers between calls."""
    limits = "; a call keeps what it computes in its box"
    return f"the memory of the observer between calls: yours to copy, save and restore{limits * step.clock.guarded}"


# --- the proved bounds of the error as it runs

_CLOSE = Fraction(11, 10)  # of the bound, at which an error counts as settled
_DIGITS = 2
_UNPROVED = "no bound of the error of its estimate is proved; `hgogen check` says why"
_EXPECTED = "OUTSIDE_BOX"  # a bit that a proof allows
_UNCOUNTED = "Not included: the rounding of floating-point numbers."
_COUNTED = (
    "Included: the rounding of the program compiled in {real}, for samples and inputs that are {real} numbers, if "
    "elementary functions err by at most twice what hgogen measured. Not included: the rounding of the map from z to "
    "the plant's states."
)
_OTHERS = "Not proved: these bounds at other gains, parameters or dt, or while a gain changes."
_AGAIN = (
    "This file was written from the proof itself. `hgogen check` with --certificate writes the evidence, and `hgogen "
    "recheck` prints which claims other code verifies."
)
_DERIVED = "The bound of {} follows from the others by outward-rounded intervals, which a certificate does not carry."
_ALONE = "nothing else enters: no other noise, disturbance or error of a parameter, and the plant is the model"


def proved_bounds(step: Step) -> list[str]:
    """Return the proved error bounds of a step with all their assumptions, as lines; none where the model requests no
    bounds."""
    known = step.signed
    if known is None:
        return []
    head = "As it runs"
    if not known.bounds:
        return [f"{head}: {_UNPROVED}"]
    lines = [f"{head}, proved: at every call, for ever, {_settled(step, known)}"]
    for name, most in known.bounds.items():
        bound = _with_unit(up(_CLOSE * Fraction(most), _DIGITS), _signal(step, name))
        lines.append(f"  |{name} - its estimate| <= {bound}")
    lines += [f"  of {name}: no bound below the width of its range;" for name in known.beyond]
    lines += ["  provided that", *(f"    {each};" for each in _assumptions(step, known)), f"    {_ALONE}."]
    more = [_DERIVED.format(", ".join(_derived_states(known)))] * bool(_derived_states(known))
    rounding = _COUNTED.format(real=known.real) if known.real else _UNCOUNTED
    return [*lines, *(f"  {each}" for each in (*_tuning_ranges(step, known), rounding, _OTHERS, _AGAIN, *more))]


def _settled(step: Step, known: Signed) -> str:
    if known.settles is None:
        decayed = "once what is left of the error at its start has decayed, for which no time is proved"
        return f"{decayed}: {known.unsettled}"
    after = f"from {up(known.settles, _DIGITS)} {step.time} after the first call on"
    if known.everywhere:
        return f"{after}, wherever in its ranges the plant is then, the estimate where this file starts it"
    most = ", ".join(f"{name} off by {down(most, _DIGITS)}" for name, most in known.begins.items())
    return f"{after}, from an estimate with at most {most} there, which a start alone does not ensure"


def _signal(step: Step, name: str) -> Signal:
    form = step.observer.form
    names = dict(zip(form.names, form.states, strict=True))
    return {**names, **{signal.name: signal for signal in step.states}}[name]


def _with_unit(value: str, signal: Signal, over: str = "") -> str:
    unit = signal.unit if signal.unit != "1" else ""
    if over:
        return f"{value} ({unit})/{over}" if unit else f"{value}/{over}"
    return f"{value} {unit}" if unit else value


def _assumptions(step: Step, known: Signed) -> Iterator[str]:
    read = "samples and the exact inputs" if step.inputs else "samples"
    yield f"a call comes every {step.pace}, with the {read} of that time"
    yield "gains and parameters are the nominal ones of this file"
    raised = any(bit.place == Place("status", _EXPECTED) for bit in step.layout.bits)
    expected = f" but {_EXPECTED}" * (raised and _EXPECTED in STEP_BITS)
    yield f"no call since the start or a reset has returned a status bit{expected}"
    system = step.observer.form.system
    signals = (*system.declared.states, *system.inputs, *system.outputs, *system.parameters)
    by_name = {signal.name: signal for signal in signals}
    for kind, each in known.assumed.items():
        yield from (_ASSUMED[kind](step, by_name[name], size) for name, size in each.items())
    yield from _constant_inputs(step, known.assumed.get("rates", {}))
    inner = [_inner_range(x, _signal(step, x), most) for x, most in known.inside.items()]
    declared = [_range(_signal(step, x)) for x in _derived_states(known) if _signal(step, x).bounded]
    yield f"at all times the plant stays in {', '.join([*inner, *declared])}"
    if step.inputs:
        yield f"and its inputs in {', '.join(map(_range, step.inputs))}"


def _derived_states(known: Signed) -> list[str]:
    return [x for x in known.bounds if x not in known.inside]


def _inner_range(name: str, state: Signal, most: float) -> str:
    (low, high), inner = map(Fraction, state.interval), Fraction(most)
    return f"{up(low + inner)} <= {name} <= {down(high - inner)}"


def _range(u: Signal) -> str:
    low, high = u.interval
    return f"{same(low)} <= {u} <= {same(high)}"


def _constant_inputs(step: Step, rates: Each) -> Iterator[str]:
    if step.clock.between == "hold" and step.inputs:
        yield f"between two calls {', '.join(u.name for u in step.inputs)} is held"
        return
    read = set().union(*(sp.sympify(row).free_symbols for row in step.observer.form.flow))
    for u in step.inputs:
        if u.name in rates:
            yield f"between two calls {u} moves on a straight line"
        elif u in read:
            yield f"{u} never moves"


_ASSUMED: Mapping[str, Callable[[Step, Signal, float], str]] = {
    "noise": lambda _, y, size: f"each sample of {y} errs by at most {_with_unit(same(size), y)}, whatever its course",
    "rounded": lambda _, y, size: f"a sample of {y} is rounded to steps of {_with_unit(same(size), y)}",
    "late": lambda step, y, size: f"{y} is sampled within {same(size)} {step.time} of the time of its call",
    "disturbance": lambda step, x, size: (
        f"{x}' is within {_with_unit(same(size), x, step.time)} of what the model says"
    ),
    "parameters": lambda _, p, size: (
        f"the plant's {p} is constant and within {_with_unit(same(size), p)} of its declared value"
    ),
    "rates": lambda step, u, size: f"{u} moves by at most {_with_unit(same(size), u, step.time)}",
}


def _tuning_ranges(step: Step, known: Signed) -> Iterator[str]:
    theta = next(gain.initial[0] for gain in step.layout.gains if gain.name == "theta")
    least = known.least and Fraction(up(known.least, _DIGITS))
    decays = "Without noise, disturbances, and errors of timing or parameters, the error decays"
    if least and least < theta:
        yield f"{decays} at every constant theta from {up(known.least or 0, _DIGITS)} to {same(theta)}."
    else:
        yield f"{decays} at theta = {same(theta)}; at any other theta nothing is proved."
    longest = known.longest and Fraction(down(known.longest, _DIGITS))
    if longest and longest > Fraction(step.dt):
        yield f"{decays} at every dt up to {down(known.longest or 0, _DIGITS)} {step.time}, for code generated with it."
