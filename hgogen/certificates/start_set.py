"""The initial errors from which an estimate never reaches its limits and no guard acts, and its largest errors.

The program keeps the estimate in an outer box, which no proof of contraction covers. From the starts of this file the
estimate never meets it: errors that begin in a box are always less than its distance from the declared ranges, which
hold the plant.

No proof of a step covers a sample that is rejected, or an estimate that restarts from a sample because it seems lost
(`stepping.recovery`). Noise above a tenth of the span of an output may cause both, however small the error.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import casadi as ca
import sympy as sp

from hgogen.certificates.contraction import contraction, method_phrase, proved_check
from hgogen.check import Check
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Ode
from hgogen.program import Field, sym
from hgogen.prove.inclusion import NO_SCALES, Inclusion, Nothing, state_row
from hgogen.prove.inequality import NOW, Contracts, Steps
from hgogen.prove.plant_step import Heads, PlantStep, Sizes
from hgogen.prove.quadratic import Array, rational
from hgogen.prove.questions import InputBound, confinement, peak_errors, step_input_bound
from hgogen.prove.region import no_corners
from hgogen.rigor.bounds import bound
from hgogen.rigor.outward import number
from hgogen.sentence import Down, Sentence, Up, because
from hgogen.signal import LOST
from hgogen.step import Step, demand_step
from hgogen.stepping.guards import readings
from hgogen.stepping.recovery import MARGIN, SHARE

NO_WAY = because("no bound is found of how far errors go on the way")
_ROUNDED = Fraction(1, 10**9)  # of a limit: more than its rounding errors


@dataclass(frozen=True)
class StartSet:
    """The initial errors from which an estimate is safe. `first`: by state of the form, the largest initial error that
    its range allows; `multiple`: the factor of these up to which the estimate never reaches its limits; `peaks`: the
    largest errors at any time, from initial errors of min(1, `multiple`) times `first`. `check`: OBSERVER.start."""

    first: Mapping[str, float]
    multiple: float
    peaks: Mapping[str, float]
    check: Check


def start_set(step: Step) -> StartSet | Nothing:
    """Return the initial errors from which the estimate never reaches its limits, and its largest errors, for a step
    that is proved to contract, without noise; or the reason why they are unknown: no contraction, more than 8 states,
    states without ranges, or a chain whose gains contain parameters. Raises: `NoSolver` without Clarabel; `NoStep`."""
    demand_step(step, "start_set")
    known = contraction(step)
    if known.proof is None:
        return Nothing(known.checks[0].reason)
    return _start_set(step.observer, step.code.rule, step.dt, known.proof)


@dataclass(frozen=True, eq=False)
class ContractingStep:
    """A `step` that is proved to contract, by `proof`, with its `plant` over one call. `scales` (N): e_k over the error
    of the state that e_k belongs to; `heads`: by output, the first state z_i of its chain and dy/dz_i."""

    step: Step
    proof: Contracts
    plant: PlantStep
    scales: Sequence[Fraction]
    heads: Heads

    @property
    def error(self) -> Inclusion:
        """The error dynamics of the observer."""
        return self.proof.steps.error

    @property
    def fields(self) -> list[int]:
        """The indices k of the components e_k that belong to an estimate of a state, not to a filter."""
        return [k for k, fed in enumerate(self.error.layout.fed) if fed]

    def bounds(self, sizes: Sizes) -> dict[int, InputBound] | None:
        """Return, by index k of `fields`, the proved bound of the error under inputs of these sizes divided by the
        largest of them; None where one is not proved. Raises: `NoSolver`."""
        inputs = sizes.over(sizes.largest).inputs(self.proof.step, self.error, self.scales, self.heads)
        rows = {k: state_row(self.scales, k) for k in self.fields}
        tried = {k: step_input_bound(self.proof, inputs, c) for k, c in rows.items()}
        known = {k: one for k, one in tried.items() if one}
        return known if len(known) == len(tried) else None

    def begins(self, start: "Start", fields: Iterable[int]) -> dict[int, Fraction]:
        """Return, by index k of `fields`, the largest error at any time of the state that e_k belongs to, after a
        `start`, since |e|_P never grows."""
        rows = {k: state_row(self.scales, k) for k in fields}
        return peak_errors(rational(self.proof.weights.P), start.corners, rows)


@dataclass(frozen=True, eq=False)
class Start:
    """The start of an estimate. `scales` (N): e_k over the error of its state; `first` (n): the largest initial errors;
    `corners` (k, N): those of the box of initial errors, in e, one of each opposite pair; `limits`: by index k, the
    distance from the range of the state to the outer box, at which the estimate is clamped, in the state's unit."""

    scales: Sequence[Fraction]
    first: Sequence[Fraction]
    corners: Array
    limits: Mapping[int, Fraction]


def start_of(observer: Observer, steps: Steps) -> Start | Nothing:
    """Return the largest initial errors of an observer and the distance to its limits; or the reason why there is no
    proof: more than 8 states, states without ranges, ranges that touch the outer box, different initial values of one
    state, or a chain whose gains contain parameters."""
    error, form = steps.error, observer.form
    scales = error.scales(steps.theta)
    if scales is None:
        return Nothing(NO_SCALES)
    if endless := no_corners(form):
        return Nothing(endless)
    first = _first(observer, error)
    if isinstance(first, Nothing):
        return first
    limits = _limits(observer, error)
    if min(limits.values()) <= 0:
        return Nothing(because("the limits of the estimate do not hold the ranges with room around"))
    return Start(scales, first, error.corners(scales, first), limits)


@lru_cache(maxsize=32)
def _start_set(observer: Observer, rule: str, dt: float, proof: Contracts) -> StartSet | Nothing:
    start = start_of(observer, proof.steps)
    if isinstance(start, Nothing):
        return start
    rows = {k: state_row(start.scales, k) / rational(m) for k, m in start.limits.items()}
    falls, W = proof.step.falls(NOW), proof.steps.coordinates
    clear = confinement(falls, W, start.corners, rows)
    picks = proof.steps.error.layout.picks
    each = (confinement(falls, W, start.corners, {k: state_row(start.scales, k)}) for k in picks)
    peaks = tuple(one for one in each if one)
    if clear is None or len(peaks) < len(picks):
        return Nothing(NO_WAY)
    names, multiple = observer.form.names, 1 / max(clear.bounds.values())
    scale = min(multiple, Fraction(1))
    largest = {name: number(scale * max(one.bounds.values()))[1] for name, one in zip(names, peaks, strict=True)}
    begun = {name: number(value)[1] for name, value in zip(names, start.first, strict=True)}
    pattern = "{state} errs by at most {peak} from {first}"
    phrases = [Sentence.of(pattern, state=x, peak=Up(largest[x], 3), first=Up(begun[x] * scale, 3)) for x in names]
    at, most = method_phrase(observer, rule, dt), Down(multiple, 3)
    claim = f"{at}, first errors of up to {most} times what the ranges allow never touch the estimate's limits"
    limits = [{"field": k + 1, "limit": limit} for k, limit in start.limits.items()]
    facts = {
        "method": rule,
        "dt": Fraction(dt),
        "first": start.first,
        "clear": {"V": clear.weights, "multiple": multiple, "limits": limits},
        "peaks": [{"V": one.weights, "bound": max(one.bounds.values())} for one in peaks],
    }
    check = proved_check(
        observer, "start", claim, because("without noise {each}", each=phrases), proof.steps.error, facts
    )
    return StartSet(begun, number(multiple)[0], largest, check)


def _first(observer: Observer, error: Inclusion) -> list[Fraction] | Nothing:
    begins = _in_form(observer, error, [value for field in _fields(observer) for value in field.initial])
    first = []
    for i, state in enumerate(observer.form.states):
        (low, high), values = map(Fraction, state.interval), [begins[k] for k in _estimating(error, i)]
        rounded = _ROUNDED * max(map(abs, values))
        if max(values) - min(values) > rounded:
            return Nothing(because("the fields that estimate {state} do not begin alike", state=state))
        first.append(max(high - min(values), max(values) - low) + rounded)
    return first


def _limits(observer: Observer, error: Inclusion) -> dict[int, Fraction]:
    """Return, by index k of the error e_k, the distance from the range of its
    state to the limit at which the estimate is clamped, in the state's unit."""
    boxes = [ends for field in _fields(observer) for ends in field.box_within(LOST)]
    ends = [_in_form(observer, error, side) for side in zip(*boxes, strict=True)]
    limits = {}
    for i, state in enumerate(observer.form.states):
        low, high = map(Fraction, state.interval)
        for k in _estimating(error, i):
            bottom, top = sorted((ends[0][k], ends[1][k]))
            limits[k] = min(low - bottom, top - high) * (1 - _ROUNDED)
    return limits


def _estimating(error: Inclusion, state: int) -> list[int]:
    layout = error.layout
    return [k for k, (i, fed) in enumerate(zip(layout.index, layout.fed, strict=True)) if fed and i == state]


def _fields(observer: Observer) -> list[Field]:
    return [field for part in observer.parts if isinstance(part, Ode) for field in part.fields]


def _in_form(observer: Observer, error: Inclusion, values: Sequence[float]) -> list[Fraction]:
    fields = _fields(observer)
    places: list[Graph] = [sym("state", field.name, field.size) for field in fields]
    slopes = ca.Function("z", places, [ca.jacobian(observer.z, ca.vertcat(*places))])(*(0 for _ in places))
    picked = [float(slopes[i, k]) for i, k in enumerate(error.layout.picks)]
    return [Fraction(value) * Fraction(picked[i]) for value, i in zip(values, error.layout.index, strict=True)]


_CLOSE = 1 - Fraction(1, 10**9)  # of a limit, for a comparison in floats


def slack_before_guards(
    running: ContractingStep, samples: Sequence[Fraction], totals: Mapping[int, Fraction]
) -> dict[int, Fraction] | None:
    """Return, by index k of e_k, the additional error beyond its bound in `totals` up to which no guard of the step
    acts (such as a restart after large innovations); None where a guard may act within these bounds. `samples` (p): the
    largest errors of samples."""
    form, layout = running.step.observer.form, running.error.layout
    where = form.box
    for y, (low, high), size in zip(form.output, readings(form), samples, strict=True):
        known, width = bound(sp.sympify(y), where), high - low
        accepted = known.low - size >= low - width and known.high + size <= high + width
        if not accepted:
            return None
    slack = dict[int, Fraction]()
    for state, most in _undetected_errors(running, samples):
        k = layout.picks[state]
        slack[k] = min(most * _CLOSE - totals[k], slack.get(k, most))
    return slack if all(x > 0 for x in slack.values()) else None


def restart_calls(step: Step) -> int:
    """Return the smallest number of calls for which a sign of a lost estimate, such as large innovations, must last
    until the estimate restarts; 0 for a step that has no such sign."""
    return min((math.floor(sign.time / step.dt * (1 - 1e-9)) for sign in step.code.signs), default=0)


def _undetected_errors(running: ContractingStep, samples: Sequence[Fraction]) -> Iterator[tuple[int, Fraction]]:
    form, heads, inside = running.step.observer.form, running.heads, running.plant.margins
    spans = [high - low for low, high in readings(form)]
    for sign in running.step.code.signs:
        if sign.output is not None:
            if sign.output not in heads:  # the rest of such an output is not bounded
                yield 0, Fraction(0)
                continue
            head, slope = heads[sign.output]
            yield head, (Fraction(SHARE * spans[sign.output]) - samples[sign.output]) / abs(slope)
            continue
        identity = all(row.is_Symbol or (-row).is_Symbol for row in form.from_form)
        for i, (state, clear) in enumerate(zip(form.states, inside, strict=True)):
            low, high = map(Fraction, state.interval)
            yield i, clear + Fraction(MARGIN) * (high - low) if identity else Fraction(0)
