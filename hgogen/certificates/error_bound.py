"""Ultimate bounds of the estimate's errors in a discrete step, for the states of the form and of the plant, with the
share of each cause.

    e+ = Phi e + inputs,   V = |e|_P^2 of the contraction loses alpha h of itself without inputs

The parts of e from each input have a bound and a norm of their own, and add up; the part of the start decays.
`prove.plant_step` bounds the sizes of the inputs.

Errors of the plant's own states behind a change of coordinates follow from those of the form's states:

    |x_i - xhat_i| <= sum_j sup |dx_i/dz_j| |z_j - zhat_j|

The supremum, by outward-rounded intervals, is over the segments between a z of the plant, in its ranges, and an
estimate within the bounds, for a map that may have kinks but no jumps. The terms that are linear in z are taken at z,
the others where it is clamped. A clamp multiplies an error by a share in [0, 1], also at the ranges.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import Any, TypeVar

import sympy as sp

from hgogen.analysis.dynamics import linear_terms, reach, transformed
from hgogen.analysis.maps import sided
from hgogen.analysis.scaling import sizes_of_used
from hgogen.certificates.contraction import contraction, method_phrase, proved_check
from hgogen.certificates.rounding_share import rounding_share
from hgogen.certificates.start_set import NO_WAY, ContractingStep, Start, restart_calls, slack_before_guards, start_of
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.method import ProvableMethod
from hgogen.prove.inclusion import NO_SCALES, Nothing, state_row
from hgogen.prove.inequality import NOW, Contracts
from hgogen.prove.plant_step import ErrorInput, PlantStep, Share, Sizes, Unbounded, heads_of, steepness_in, times
from hgogen.prove.quadratic import rational
from hgogen.prove.questions import InputBound, Signed, confinement
from hgogen.reading.given import Each, each_by_name, names_of, size, sizes
from hgogen.rigor.box import Box
from hgogen.rigor.outward import number
from hgogen.rigor.rounding import REALS, Real
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, joined
from hgogen.step import Step, demand_choice, demand_step

Slopes = Mapping[str, tuple[Fraction, ...]]


def slopes_of_states(form: Form, errors: Sequence[Fraction]) -> Slopes:
    """Return sup|dx/dz_j| (n), by name, of each state x of the plant that is no state of the form, where the errors of
    the form's states z are at most `errors` (n). States without a bound are left out."""
    slopes = {}
    for state, expression in form.estimates:
        if state.name in form.names:
            continue
        try:
            slopes[state.name] = (
                _slopes_on_plant(form, state) if transformed(form) else _slopes_on_form(form, expression, errors)
            )
        except Unbounded:
            continue
    return slopes


def _slopes_on_form(form: Form, expression: sp.Expr, errors: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Return sup|dx/dz_j| (n) of a state x given as an `expression` of z, where z
    may leave its range by `errors` up to where the expression is clamped."""
    where, (_, nonlinear) = form.box, linear_terms(expression, form.states)
    for z, error in zip(form.states, errors, strict=True):
        (low, high), (least, most) = map(Fraction, z.interval), reach([nonlinear], z, form.states)
        where[z] = max(low - error, _end(least, low - error)), min(high + error, _end(most, high + error))
    return _steepest(expression, form, where)


def _slopes_on_plant(form: Form, state: sp.Symbol) -> tuple[Fraction, ...]:
    """Return sup|d state/dz_j| (n) of a reported state. It is an expression of the plant's states,
    which are recovered from z, clamped to its ranges, and then clamped to their own."""
    system, inverse = form.system, sided(form)
    (reported,) = (expression for signal, expression in system.reported if signal == state)
    around = system.box_with(system.states)
    total = [Fraction(0)] * form.n
    for x, row, finite in zip(system.states, inverse.rows, inverse.finite, strict=True):
        share = steepness_in(reported, x, around)
        if not share:
            continue
        if not finite:
            raise Unbounded
        slopes = _steepest(row, form, form.box)
        total = [y + share * s for y, s in zip(total, slopes, strict=True)]
    return tuple(total)


def _steepest(expression: sp.Expr, form: Form, where: Box) -> tuple[Fraction, ...]:
    """Return sup|l_j + c r_j| (n) over c in [0, 1] on the box `where`: l_j are the partial derivatives
    of the expression's linear terms in z_j, r_j those of its other terms, which are clamped."""
    linear, _ = linear_terms(expression, form.states)
    return tuple(max(steepness_in(linear, z, where), steepness_in(expression, z, where)) for z in form.states)


def _end(end: float, otherwise: Fraction) -> Fraction:
    return Fraction(end) if abs(end) < float("inf") else otherwise


AnyStep = TypeVar("AnyStep", bound=Step)
_CLOSE = Fraction(1, 10)  # of the bound: the error from the start after it has settled
_ENDLESS = "no time is proved from which on the bounds of the errors hold: {why}"
_MET = "what enters may move the estimate of {states} to its limits; state less of it, or lower the gains"
_SHORTER = "Take a shorter dt."
_LESS = "State less of what enters, or take other gains."
_GUARDS = "while no sample is rejected, and the estimate does not restart from one"
_UP = 1 + 1e-9  # of a count of calls, for rounding errors


@dataclass(frozen=True)
class ErrorBound:
    """The proved ultimate bounds of the errors of a step's estimate.

    `shares`: by cause ("noise", "rounded", "late", "disturbance", "parameters", "method", "rounding") and by the name
    of a state of the form or the plant, the error from this cause; `bounds`: the sums of the shares, without states
    whose sum exceeds the width of their range; `inside`: the distance, by state, that the plant must keep from the ends
    of its ranges. `settles` (time): when errors are within 1.1 of their bounds, for initial errors of min(1,
    `multiple`) times those that the ranges allow; `multiple`: the largest factor of initial errors with which the
    estimate never reaches its limits; both None where unknown, for the reason `missing`. `check`: OBSERVER.error;
    `signed`: the statements for the step's code.
    """

    check: Check
    shares: Mapping[str, Mapping[str, float]]
    bounds: Mapping[str, float]
    inside: Mapping[str, float]
    settles: float | None = None
    multiple: float | None = None
    missing: Reason = NONE
    signed: Signed = field(default_factory=Signed, repr=False)

    def __str__(self) -> str:
        return str(self.check)


def error_bound(
    step: Step,
    *,
    noise: Each = None,
    rounded: Each = None,
    late: Each = None,
    disturbance: Each = None,
    parameters: Each = None,
    rates: Each = None,
    real: Real | None = None,
) -> ErrorBound:
    """Return proved bounds of the estimate's errors after they have settled, and the settling time, for a step that is
    proved to contract.

    Args: sizes by name, 0 by default: `noise`: the largest error in each sample of an output; `rounded`: the
    quantisation step of samples; `late`: the largest difference of a sample's time from its nominal time;
    `disturbance`: the largest disturbance in the rate of a state of the plant; `parameters`: the largest difference of
    the plant's parameter from the program's, a constant; `rates`: the largest speed of an input between two samples, by
    default its declared rates, 0 for an input that is constant there. Noise and disturbances vary arbitrarily. `real`:
    "float" or "double" includes rounding errors of the program in this precision; by default it computes with real
    numbers.

    Assumptions: the plant stays in its ranges, at the distance `inside` from their ends. Inputs stay in theirs, and
    vary between samples as the program assumes. No sample is missing; samples and inputs are numbers of the program's
    precision. The errors of elementary functions are at most twice those that were measured. Raises: `NoSolver` without
    Clarabel; `BadNames`, `BadGain` for an invalid size; `BadStep` for an unknown precision.
    """
    demand_choice("real", real, (None, *REALS))
    demand_step(step, "error_bound")
    form, outputs = step.observer.form, names_of(step.observer.form.system.outputs)
    most = {
        "noise": sizes_of_used(form, sizes("noise", noise, outputs)),
        "rounded": sizes_of_used(form, sizes("rounded", rounded, outputs)),
        "late": sizes_of_used(form, sizes("late", late, outputs)),
        "disturbance": sizes("disturbance", disturbance, names_of(form.system.declared.states)),
        "parameters": sizes("parameters", parameters, names_of(form.system.parameters)),
    }
    moving = _input_rates(step, rates)
    known = contraction(step)
    if known.proof is None or not known.proof.alpha:
        return _unknown(step, known.checks[0].reason)
    if why := _not_followed(form):
        return _unknown(step, *why)
    plant = PlantStep(form, known.proof.h, moving)
    try:
        bounded = _bounded(step, known.proof, plant, most, real)
    except Unbounded as unbounded:
        return _unknown(step, unbounded.args[0])
    requested = {"noise": noise, "rounded": rounded, "late": late, "disturbance": disturbance, "parameters": parameters}
    declared = {name: {key: float(x) for key, x in (each or {}).items() if x} for name, each in requested.items()}
    declared["rates"] = {u.name: float(x) for u, x in zip(form.system.inputs, moving, strict=True) if x}
    assumed = {name: each for name, each in declared.items() if each}
    far = known.reach
    least, longest = far.least if far.tuned else None, far.longest if far.pieces else None
    return replace(bounded, signed=replace(bounded.signed, assumed=assumed, real=real, least=least, longest=longest))


def _not_followed(form: Form) -> tuple[Reason, str] | None:
    """Return why the plant cannot be bounded between samples, and the fix; None where it can."""
    if times := form.system.times:
        why = because("functions of time, of {times}, are not followed between samples", times=times)
        return why, "Declare the plant with their values as inputs."
    read = [*zip(form.names, form.states, strict=True), *((u.name, u) for u in form.system.inputs)]
    if endless := [name for name, signal in read if not signal.bounded]:
        why = because("what a plant does beside a step is bounded on ranges, and {names} has none", names=endless)
        return why, f"Declare low and high of {', '.join(endless)}."
    return None


def signed(step: AnyStep, **bounds: Any) -> AnyStep:
    """Return the step with the bounds of `error_bound` in it, so that the code that targets generate states them with
    their assumptions. `bounds`: the arguments of `error_bound`, which says what it raises. Nothing else of the step
    changes."""
    return replace(step, signed=error_bound(step, **bounds).signed)


def _input_rates(step: Step, rates: Each) -> tuple[Fraction | None, ...]:
    inputs = step.observer.form.system.inputs
    declared = [max(map(abs, u.rates[0])) if u.rates else None for u in inputs]
    requested = each_by_name("rates", rates, names_of(inputs), None)
    known = [fallback if value is None else value for value, fallback in zip(requested, declared, strict=True)]
    most = [None if x is None else size(f"rates of {u.name}", x) for u, x in zip(inputs, known, strict=True)]
    return (Fraction(0),) * len(inputs) if step.clock.between == "hold" else tuple(most)


def _error_inputs(plant: PlantStep, most: Mapping[str, Sequence[Fraction]]) -> dict[str, ErrorInput]:
    outputs, wrong, pushed = range(len(plant.form.output)), most["parameters"], most["disturbance"]
    change, by_parameters = plant.change(pushed), plant.by_parameters(wrong)
    disturbance, mismatch = times(change, pushed), times(by_parameters, wrong)
    rate_errors = [x + y for x, y in zip(disturbance, mismatch, strict=True)]  # which a late sample shows as well
    speeds = [plant.output_rate(j) if tau else tau for j, tau in zip(outputs, most["late"], strict=True)]
    late = (
        tau * (v + plant.output_rate_deviation(j, rate_errors))
        for j, v, tau in zip(outputs, speeds, most["late"], strict=True)
    )
    flow = {"steepness": plant.steepness} if any(rate_errors) else {}
    each = {
        "noise": ErrorInput(Sizes(samples=tuple(most["noise"])), {"sizes": most["noise"]}),
        "rounded": ErrorInput(Sizes(samples=tuple(x / 2 for x in most["rounded"])), {"sizes": most["rounded"]}),
        "late": ErrorInput(Sizes(samples=tuple(late)), {"sizes": most["late"], "speeds": speeds}),
        "disturbance": ErrorInput(
            Sizes(deviation=plant.disturbed(disturbance)), {"sizes": pushed, "rows": change, **flow}
        ),
        "parameters": ErrorInput(
            Sizes(deviation=plant.disturbed(mismatch)), {"sizes": wrong, "rows": by_parameters, **flow}
        ),
    }
    return {name: one for name, one in each.items() if one.sizes.largest}


def _bounded(
    step: Step, proof: Contracts, plant: PlantStep, most: Mapping[str, Sequence[Fraction]], real: Real | None
) -> ErrorBound:
    error_inputs, error = _error_inputs(plant, most), proof.steps.error
    scales, heads = error.scales(proof.steps.theta), heads_of(plant.form)
    if scales is None or heads is None:
        raise Unbounded(NO_SCALES)
    error_inputs |= _method_input(step, proof, plant)
    if not (error_inputs or real):
        raise Unbounded(because("nothing enters the error: that of the start decays, to nothing"))
    running = ContractingStep(step, proof, plant, scales, heads)
    shares, fields = _shares(running, error_inputs), running.fields
    each_sample = zip(*(one.sizes.samples for one in error_inputs.values() if one.sizes.samples), strict=True)
    samples = [sum(each, Fraction(0)) for each in each_sample] or [Fraction(0)] * len(plant.form.output)
    start, early = start_of(step.observer, proof.steps), _totals(fields, shares)
    begun, calls = _start_multiple(running, start, early), 0
    start_residual = {k: _CLOSE * early[k] for k in error.layout.picks}
    if real:
        if isinstance(begun, Nothing):
            raise Unbounded(because("how much is rounded is not known: {why}", why=begun.reason))
        rounding = rounding_share(running, real, shares, *begun, samples)
        early = {k: early[k] + rounding.early[k] for k in fields}
        calls, start_residual = rounding.calls, {**rounding.start_residual}
        shares.append(rounding.share)
        begun = _start_multiple(running, start, early)
        if isinstance(begun, Nothing):
            raise Unbounded(because("with what is rounded at first, {why}", why=begun.reason))
    return _stated(running, shares, begun, slack_before_guards(running, samples, early), start_residual, calls)


def _method_input(step: Step, proof: Contracts, plant: PlantStep) -> dict[str, ErrorInput]:
    """Return the deviation of the method from the plant as an input of the error, by its name; empty where none."""
    assert isinstance(step.method, ProvableMethod)  # the contraction is proved
    method = step.method.plant_deviation(plant, proof.steps.error, proof.steps.theta)
    return {"method": method} if method.sizes.largest else {}


def _shares(running: ContractingStep, error_inputs: Mapping[str, ErrorInput]) -> list[Share]:
    shares, proofs = list[Share](), dict[Sizes, dict[int, InputBound] | None]()
    for name, one in error_inputs.items():
        relative = one.sizes.over(one.sizes.largest)
        if relative not in proofs:
            proofs[relative] = running.bounds(relative)
        known = proofs[relative]
        if known is None:
            raise Unbounded(because("no bound is found of what {name} does", name=name))
        shares.append(Share(name, one.sizes, one.sizes.largest, known, one.follows))
    return shares


def _totals(fields: Sequence[int], shares: Sequence[Share]) -> dict[int, Fraction]:
    return {k: sum((share.bound(k) for share in shares), Fraction(0)) for k in fields}


def _start_multiple(
    running: ContractingStep, start: Start | Nothing, totals: Mapping[int, Fraction]
) -> tuple[Start, Fraction] | Nothing:
    """Return the largest multiple of the initial errors from which the estimate, with
    further errors `totals` from inputs, reaches no limit; or why there is none."""
    if isinstance(start, Nothing):
        return start
    slack = {k: limit - totals[k] for k, limit in start.limits.items()}
    if min(slack.values()) <= 0:
        names, index = running.step.observer.form.names, running.error.layout.index
        return Nothing(because(_MET, states=dict.fromkeys(names[index[k]] for k, most in slack.items() if most <= 0)))
    rows = {k: state_row(start.scales, k) / rational(m) for k, m in slack.items()}
    proof = running.proof
    clear = confinement(proof.step.falls(NOW), proof.steps.coordinates, start.corners, rows)
    return (start, 1 / max(clear.bounds.values())) if clear else Nothing(NO_WAY)


def _calls(running: ContractingStep, start: Start, multiple: Fraction, residual: Mapping[int, Fraction]) -> int:
    """Return the number of calls after which the initial error times min(1, `multiple`) has decayed
    to `residual`, by component of e: V(0) at the corners decreases by (1 - alpha h)^k."""
    begins, proof = running.begins(start, residual), running.proof
    falls, calls = -math.log1p(-float(proof.alpha * proof.h)) / 2, 0
    for k, most in residual.items():
        ratio = number(begins[k] * min(multiple, Fraction(1)) / most)[1]
        calls = max(calls, math.ceil(math.log(max(ratio, 1.0)) / falls * _UP))
    return calls


def _stated(
    running: ContractingStep,
    shares: Sequence[Share],
    begun: tuple[Start, Fraction] | Nothing,
    room: Mapping[int, Fraction] | None,
    residual: Mapping[int, Fraction],
    calls: int,
) -> ErrorBound:
    """Return the error bound with its sentences, from the shares of its causes. `residual`: the
    initial error that remains after settling, by component of e; `calls`: further calls until
    rounding has settled; `room`: further errors at which no guard acts, None if one may."""
    settled, multiple, alone = _settled(running, begun, room, residual, calls)
    totals = _totals(running.fields, shares)
    step, form, picks = running.step, running.step.observer.form, running.error.layout.picks
    names, slopes = form.names, slopes_of_states(form, [(1 + _CLOSE) * totals[k] for k in picks])
    by_state = partial(_by_state, names, slopes, picks)
    bounds, parts = by_state(lambda k: totals[k]), {share.what: by_state(share.bound) for share in shares}
    states = [*zip(names, form.states, strict=True), *((x.name, x) for x, _ in form.estimates if x.bounded)]
    widths = {x: number(Fraction(z.interval[1]) - Fraction(z.interval[0]))[0] for x, z in reversed(states)}
    beyond = [x for x, most in bounds.items() if most > widths.get(x, math.inf)]
    vain = [_useless_bound(x, bounds[x], widths[x], {what: sizes[x] for what, sizes in parts.items()}) for x in beyond]
    bounds, *sizes = ({x: y for x, y in each.items() if x not in beyond} for each in (bounds, *parts.values()))
    if not bounds:
        by_method = all(max(parts, key=lambda what: parts[what][x]) == "method" for x in beyond)
        return _unknown(step, because("{each:; }", each=vain), _SHORTER if by_method else _LESS)
    parts = dict(zip(parts, sizes, strict=True))
    margins = {name: number(value)[1] for name, value in zip(names, running.plant.margins, strict=True)}
    pattern = "{each:; }; while the plant keeps {margins} clear of the ends of its ranges"
    each = [*_bound_sentences(bounds, parts), *vain]
    bounded_states = because(pattern, each=each, margins=[Up(value, 2) for value in margins.values()])
    reason = joined(bounded_states, _settling(step, settled, multiple), NONE if alone else because(_GUARDS))
    facts = {"method": step.code.rule, "dt": Fraction(step.dt), "shares": shares}
    check = proved_check(
        step.observer, "error", _claim(step, list(bounds) if vain else ()), reason, running.error, facts
    )
    return ErrorBound(
        check,
        parts,
        bounds,
        margins,
        settled.settles,
        None if multiple is None else number(multiple)[0],
        because(_ENDLESS, why=settled.unsettled) if settled.unsettled else NONE,
        replace(settled, bounds=bounds, inside=margins, beyond=tuple(beyond)),
    )


def _by_state(
    names: Sequence[str],
    slopes: Mapping[str, Sequence[Fraction]],
    picks: Sequence[int],
    bound: Callable[[int], Fraction],
) -> dict[str, float]:
    """Return the bounds of states by name, rounded up, from those of the components `picks` of e; `slopes`: the rows of
    other states in these."""
    errors = [bound(k) for k in picks]
    behind = {x: sum((s * e for s, e in zip(row, errors, strict=True)), Fraction(0)) for x, row in slopes.items()}
    return {name: number(value)[1] for name, value in (*zip(names, errors, strict=True), *behind.items())}


def _bound_sentences(bounds: Mapping[str, float], parts: Mapping[str, Mapping[str, float]]) -> Iterator[Sentence]:
    for x, bound in bounds.items():
        of = [Sentence.of("{what} {size}", what=what, size=Up(sizes[x], 3)) for what, sizes in parts.items()]
        yield Sentence.of("{state} within {bound}, of which {of}", state=x, bound=Up(bound, 3), of=of)


def _settled(
    running: ContractingStep,
    begun: tuple[Start, Fraction] | Nothing,
    room: Mapping[int, Fraction] | None,
    residual: Mapping[int, Fraction],
    calls: int,
) -> tuple[Signed, Fraction | None, bool]:
    if isinstance(begun, Nothing):
        return Signed(unsettled=begun.reason), None, room == {}
    start, multiple = begun
    alone = room is not None and _calls(running, start, multiple, room) < restart_calls(running.step)
    first = zip(running.plant.form.names, start.first, strict=True)
    signed_start = Signed(
        settles=running.step.dt * (_calls(running, start, multiple, residual) + calls),
        begins={x: number(min(multiple, Fraction(1)) * most)[0] for x, most in first},
        everywhere=multiple >= 1,
    )
    return signed_start, multiple, alone or room == {}


def _useless_bound(state: str, bound: float, width: float, parts: Mapping[str, float]) -> Sentence:
    what = max(parts, key=lambda each: parts[each])
    pattern = "{state} is unknown, as {bound} is more than its range is wide, {width}, and {what} alone has {size}"
    return Sentence.of(
        pattern, state=state, bound=Up(bound, 3), width=Down(width, 3), what=what, size=Up(parts[what], 3)
    )


def _settling(step: Step, settled: Signed, multiple: Fraction | None) -> Reason:
    if settled.settles is None or multiple is None:
        pattern = "once what is left of the start has decayed, for which no time is proved: {why}"
        return because(pattern, why=settled.unsettled)
    time = Sentence.of("{at} {unit}", at=Up(settled.settles, 3), unit=step.observer.form.system.time)
    if multiple >= 1:
        return because("after {time} to within a tenth, wherever in its ranges the plant starts", time=time)
    pattern = "after {time} to within a tenth, from errors of up to {multiple} times what the ranges allow"
    return because(pattern, time=time, multiple=Down(multiple, 3))


def _claim(step: Step, known: Sequence[str] = ()) -> str:
    subject = f"of the states {', '.join(known)}" if known else "every state"
    return f"{method_phrase(step.observer, step.code.rule, step.dt)}, {subject} is known within a bound, for ever"


def _unknown(step: Step, why: Reason, fix: str = "Validate by trials.") -> ErrorBound:
    check = Check(ClaimId(step.observer.name, "error"), _claim(step), Verdict.UNKNOWN, why, fix=fix)
    return ErrorBound(check, {}, {}, {}, missing=because("no bound of the errors is proved: {why}", why=why))
