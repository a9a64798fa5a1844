"""A step: observer + method + dt as one program that every reader (Python, C, the operation counter) walks.

One call is the sections in order: `predict` (guard the input, advance the estimate from the last call to now),
`update_Y` for each output (guard the sample, correct), `adapt` (theta and the like), then `estimate`. The call k
returns the estimate at t_k using y_k; the first call advances no time. A sample that is not a number is missing, and
the step only predicts. For an input that is not a number the last valid one is used. The status reports both.
"""

import decimal
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from sys import float_info
from typing import Annotated, Any

import numpy as np

from hgogen.discretisation.stability import Lengths
from hgogen.errors import BadArgument, HgogenError, is_ignored
from hgogen.method import Method, ProvableMethod
from hgogen.observer import Observer, parameter_fields
from hgogen.part import SUBSTEPS, Clock, First, Guards, NeedsFixedStep, Pieces, Prefer, Varying, clock_of
from hgogen.program import INF, Bit, Element, Field, Group, Place, Program, Report, Section, in_capitals, places
from hgogen.prove.inclusion import Nothing
from hgogen.prove.questions import Signed
from hgogen.reading.given import among, has_expressions
from hgogen.rigor.definite import one_thread
from hgogen.sentence import same
from hgogen.signal import TURNS, Signal, of_time, pace, plural
from hgogen.stepping import discretise
from hgogen.stepping.guards import (
    MARK,
    OR_LOWER,
    UNMADE,
    certain_bits,
    implausible,
    limit_parameters,
    or_lower,
    possible_bits,
    readings,
    shortage,
    word,
)
from hgogen.stepping.recovery import Sign
from hgogen.stepping.reports import demand_reports
from hgogen.stepping.sections import Assembly, flat, multiples
from hgogen.stepping.substeps import ELAPSED, elapsed_bits, elapsed_signal
from hgogen.stepping.times import set_time
from hgogen.system import System


class BadStep(BadArgument):
    """The error for a step length or option that cannot be used."""


class NoStep(BadArgument):
    """The error for an argument of a target, or of a proof, that is no `Step`."""


def demand_choice(name: str, value: object, choices: tuple[str | None, ...]) -> None:
    """Raise `BadStep` unless the `value` of the option `name` is one of `choices`."""
    if not among(value, choices):
        *others, last = ("None" if each is None else f'"{each}"' for each in choices)
        raise BadStep(f"{name} = {value!r}", f"must be {', '.join(others)} or {last}")


def demand_step(step: object, what: str) -> None:
    """Raise `NoStep` for an argument of a target, or of a proof, that is no step."""
    if not isinstance(step, Step):
        raise NoStep(f"{type(step).__name__} given to {what}", "is no step; make one by hg.sample")


@dataclass(eq=False)
class StepTooLong(HgogenError):
    """The error for a step length `dt` at which the discretisation is unstable at a point of the declared ranges. A dt
    is refused above `limit` and advised up to `take`; `rule`: the method; `why`: the cause; `basis`: the basis of the
    advice; `unit`: of time; `certified`: how to find the dt up to which there is a proof."""

    dt: float
    limit: float
    take: float
    rule: str
    why: str
    basis: str
    unit: str = "s"
    certified: str = ""

    def __str__(self) -> str:
        return (
            f"dt = {self.dt:g} is too long for {self.rule}: refused above {_time(self.limit, self.unit)}, {self.why}; "
            f"{_advice(self.take, self.unit, self.basis)}{self.certified}"
        )


def _time(value: float, unit: str) -> str:
    return f"{_floor(value):g}" + f" {unit}" * (unit != "s")


def _floor(value: float) -> float:
    """Return a time to three digits, rounded down, so that a printed limit is admissible."""
    return float(decimal.Context(prec=3, rounding=decimal.ROUND_FLOOR).create_decimal(value))


def _advice(take: float, unit: str, basis: str) -> str:
    return f"take dt <= {_time(take, unit)} ({basis}), or another method"


_CERTIFIED = (
    "; up to which dt its errors are proved to decay, hgogen check tells of a model, hg.contraction of any step of it"
)


class GrowingAngle(UserWarning):
    """The warning for a state that grows with each turn of an angle and loses its digits, since it is declared without
    a period."""


class StartsUncorrected(UserWarning):
    """The warning that no sample corrects the initial estimate: the plant is in equilibrium there, and no output
    depends on the state to first order."""


class StepMayFail(UserWarning):
    """The warning for a step length above the advised one, `take`, and below the refused one: the step may diverge."""

    def __init__(self, text: str, take: float = INF) -> None:
        super().__init__(text)
        self.take = take


_LAST = 32  # cached steps


@dataclass(frozen=True)
class Layout:
    """The memory of a step: `plant`, `gains`, `derived`, fields of the parameters; `state`, `groups`, the memory
    between calls; `bits` of the status; `mark`, a field whose value shows that stored state and parameters belong to
    this program, None without guards."""

    plant: tuple[Field, ...]
    gains: tuple[Field, ...]
    derived: tuple[Field, ...]
    state: tuple[Field, ...]
    groups: tuple[Group, ...]
    bits: tuple[Bit, ...]
    mark: Field | None

    @property
    def stored(self) -> tuple[Field, ...]:
        """The fields of the state structure in C: the mark, then the fields of the state."""
        return (self.mark, *self.state) if self.mark else self.state

    @property
    def raised(self) -> tuple[Bit, ...]:
        """The bits that the program raises: all but the last, which report memory that was not initialised."""
        return self.bits[: -len(UNMADE)] if self.mark else self.bits

    @property
    def word(self) -> np.dtype:
        """The numpy type of the status word, an unsigned whole number of 32 or 64 bits."""
        return word(self.bits)

    @property
    def limited(self) -> tuple[tuple[Field, ...], tuple[Field, ...]]:
        """The parameters of the plant, and the gains, that `tune` clamps to their ranges: none without guards."""
        return (self.plant, self.gains) if self.mark else ((), ())


@dataclass(frozen=True, eq=False)
class Code:
    """The programs of a step: `tuning`, `sections`, `estimate`.

    `timed`: the updates of `sections` for samples with their time, for sensors of different rates; `time`: the section
    that sets the time of functions of t; `inner`: sections that a step for late samples calls; `rule`: the method that
    integrates the observer, which may be another one than the step's; `choice`: the program of a part that was selected
    among two, and why; `signs`: the fault counters of the law of recovery, by which a lost estimate restarts;
    `reports`: functions that report on the estimate.
    """

    tuning: Program
    sections: tuple[Section, ...]
    estimate: Program
    timed: tuple[Section, ...]
    time: tuple[Section, ...]
    inner: tuple[Section, ...]
    rule: Annotated[str, "name of the method"]
    choice: str
    signs: tuple[Sign, ...]
    reports: tuple[Report, ...] = ()

    @property
    def called(self) -> tuple[Section, ...]:
        """Every section, each after the sections that it calls."""
        return (*self.inner, *self.sections, *self.timed, *self.time)

    @property
    def parts(self) -> tuple[Section, ...]:
        """The sections that are functions in the emitted code: all, where there are several."""
        return self.sections if len(self.sections) > 1 else ()

    @cached_property
    def program(self) -> Program:
        """The program of all sections and the estimate, one after the other."""
        return tuple(s for section in self.sections for s in section.program) + self.estimate

    @cached_property
    def separable(self) -> bool:
        """Whether prediction and correction can be separate calls: the section `predict` does not read the
        measurement."""
        reads = any(place.struct == "output" for place, _ in places(self.sections[0].program))
        return not reads and any(section.corrects for section in self.sections)


@dataclass(frozen=True, eq=False, repr=False)
class Step:
    """The program of an observer at the sampling period `dt`. All its times are in the unit of the model's time.

    `clock`: the sampling, the course of the input between samples, the guards and the preference; `layout`: its memory;
    `code`: its programs; `plain`: for a step that accepts late samples, the same step without delays; `signed`: proofs
    about the error of this step, if they were requested; the emitted code states them.
    """

    name: str
    observer: Observer
    method: Method
    clock: Clock
    layout: Layout
    code: Code
    plain: "Step | None" = None
    signed: Signed | None = None

    def __repr__(self) -> str:
        varies = f"{self.shortest:g} .. " * bool(self.clock.varying)
        return f"<step of {self.name}: {self.observer.name} by {self.code.rule}, dt = {varies}{self.dt:g}>"

    @property
    def dt(self) -> float:
        """The sampling period; where the time between two calls varies, the longest."""
        return self.clock.sampling or self.clock.longest

    @property
    def periods(self) -> tuple[float, ...]:
        """The time between two samples of each output."""
        return tuple(self.dt * k for k in self.clock.every or (1,) * len(self.outputs))

    @property
    def shortest(self) -> float:
        """The shortest time between two calls, for which the step is checked: the sampling period where it is fixed."""
        return self.clock.varying.shortest if self.clock.varying else self.dt

    @property
    def pace(self) -> str:
        """The sampling period as text, with its unit; where it varies, from the shortest to the longest."""
        return f"{same(self.shortest)} to " * bool(self.clock.varying) + pace(self.dt, self.time)

    @property
    def choice(self) -> str:
        """The one of two programs for a part of the observer that is used, and why; "" where there was no choice."""
        return self.code.choice

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The plant's inputs that a call is given: all but times."""
        return self.observer.form.system.supplied

    @cached_property
    def given(self) -> tuple[Signal, ...]:
        """The signals of the inputs in a call: the plant's inputs, then the time since the last call where it
        varies."""
        return (*self.inputs, *elapsed_signal(self.clock, self.time))

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The plant's outputs."""
        return self.observer.form.system.outputs

    @property
    def late(self) -> tuple[Signal, ...]:
        """The outputs whose samples may come late, in the order of `ages`."""
        return tuple(output for output in self.outputs if output.name in dict(self.observer.delays))

    @property
    def ages(self) -> tuple[Signal, ...]:
        """The signals with the age of a sample, for a step that accepts late samples."""
        return self.observer.ages if self.plain else ()

    @property
    def samples(self) -> tuple[Signal, ...]:
        """The signals of the outputs in a call: a sample of each, then the ages of those that may come late."""
        return (*self.outputs, *self.ages)

    @cached_property
    def states(self) -> tuple[Signal, ...]:
        """The plant's states, which a call estimates."""
        return tuple(signal for signal, _ in self.observer.form.estimates)

    @cached_property
    def traced(self) -> tuple[Element, ...]:
        """The further numbers in the results of a log: the observer's traces and the numbers of the reports."""
        own = (Element(name, Place("state", name)) for name in self.observer.traces)
        return (*own, *(each for report in self.code.reports for each in report.elements))

    @property
    def traces(self) -> tuple[str, ...]:
        """The names of the further numbers in the results of a log."""
        return tuple(each.name for each in self.traced)

    @property
    def time(self) -> str:
        """The unit of time of `dt` and of every rate."""
        return self.observer.form.system.time

    def unit(self, item: Field) -> str:
        """Return the unit of a field; where the observer gave it, written with s, in the model's unit of time."""
        form = self.observer.form
        return of_time(item.unit, self.time, {s.unit for s in (*form.system.signals, *form.states)})

    def action_of(self, bit: Bit) -> str:
        """Return the action that a status bit recommends to the caller; it may depend on the proved claims of the
        observer."""
        return bit.action.format(or_lower=or_lower(self.observer)) if OR_LOWER in bit.action else bit.action

    @property
    def limit(self) -> float:
        """The dt above which the step is refused."""
        return min(each.refused for each in _lengths(self.observer, self.method, self.dt))

    @property
    def advised(self) -> float:
        """The dt up to which no failure is expected."""
        return min(each.take for each in _lengths(self.observer, self.method, self.dt))


@dataclass(eq=False)
class NoVaryingStep(HgogenError):
    """The error for a varying dt, requested of an observer or a method whose constants are computed for one step
    length."""

    text = (
        "{observer} by {method} has constants of one step length, so that dt cannot vary: give dt as a number, or take "
        "riccati, ukf or iterated_ekf by continuous_discrete or cholesky, or an observer without a covariance by rk4, "
        "heun or euler"
    )
    observer: str
    method: str


MOST_SUBSTEPS, MOST_UNEVEN = 64, 1000


@dataclass(eq=False)
class CannotUpdate(HgogenError):
    """The error for prediction and correction in separate calls, requested of an observer that integrates with the
    measurement."""

    text = (
        "{observer} by {rule} integrates with the measurement, so it cannot predict and update apart; call the step, "
        "or use riccati with the method continuous_discrete"
    )
    observer: str
    rule: str


def plan(
    observer: Observer,
    method: Method,
    dt: Any,
    between: str,
    periods: Any = None,
    guards: Guards = "all",
    prefer: Prefer = "speed",
    first: First = "update",
    report: Any = (),
    substeps: int | None = None,
) -> Step:
    """Return the step of an observer; see `hgogen.call.sample`, which also makes it callable. Raises: `BadStep`,
    `StepTooLong`, `BadWindow`, `BadRate`, `CannotUpdate`."""
    system = observer.form.system
    dt, varying = _limits_of(dt, substeps, system.time)
    demand_choice("between", between, ("line", "hold"))
    demand_choice("first", first, ("update", "predict"))
    every = () if periods is None else multiples(periods, system, float(dt))
    if first == "predict" and (every or not system.discrete):
        whose = "sensors that all have the period dt; leave out periods"
        why = whose if system.discrete else "discrete plants: no time passes before the first sample; leave it out"
        raise BadStep('first = "predict"', f"is for {why}")
    observer = _guarded(observer, guards, every)
    length, sampling = (1.0, dt) if system.discrete else (dt, None)
    options = {"every": every, "guards": guards, "prefer": prefer, "report": demand_reports(report)}
    clock = clock_of(system, length, between, **options, sampling=sampling, first=first, varying=varying)
    observer = observer.sampled(clock.longest, clock.periods)
    pieces = _pieces(observer, method, clock)  # its errors come before those of the step's length
    if varying:
        _demand_varying(observer, periods)
    _demand_sampled(system, pieces, method, guards, every)
    _demand_length(observer, method, float(dt))
    step = _assembled(observer, method, clock)
    if every and not step.code.separable:
        raise CannotUpdate(observer.name, step.code.rule)
    return step


def _guarded(observer: Observer, guards: Guards, every: Any) -> Observer:
    """Return the observer, its arguments clamped or not as `guards` requires. Raises: `BadStep`."""
    system, clamped = observer.form.system, guards == "all"
    if not clamped and (observer.delays or every):
        late = "samples that come late" if observer.delays else "sensors of different rates"
        raise BadStep('guards = "none"', f"is not for {late}, of which the status says whether they were used")
    guarded = observer if observer.form.clamped == clamped else observer.clamping(clamped)
    if clamped:
        dated = [str(y) for y in system.outputs] if every else dict(guarded.delays)
        _demand_room(system.name, certain_bits(system.outputs, system.supplied, dated))
    return guarded


def _demand_sampled(system: System, pieces: Sequence[Pieces], method: Method, guards: Guards, every: Any) -> None:
    """Raise `BadStep` for a gate without guards or with periods, and for a discrete plant with a method that has no
    updates."""
    if any(piece.gate for piece in pieces) and (every or guards == "none"):
        way = "without periods, with NaN for a missing sample" if every else 'with guards = "all"'
        raise BadStep(f"{system.name} with a gate", f"is sampled {way}")
    if system.discrete and not any(piece.update for piece in pieces):
        reason = f"integrates differential equations, and {system.name} is discrete in time; take"
        raise BadStep(f"method {method.name}", f"{reason} continuous_discrete or cholesky")


def _limits_of(dt: Any, substeps: int | None, time: str) -> tuple[float, Varying | None]:
    """Return the longest step of `dt`, a number or a pair (shortest, longest), and the limits of a varying dt, else
    None. Raises: `BadStep`."""
    pair = isinstance(dt, tuple | list)
    ends = tuple(dt) if pair else (dt, dt)
    positive = (isinstance(each, int | float) and float_info.min <= each <= float_info.max for each in ends)
    if len(ends) != 2 or not all(positive):
        wanted = f"must be a positive time in {plural(time)}"
        raise BadStep(f"dt = {dt!r}", f"{wanted}, or the pair of the shortest and the longest one" if pair else wanted)
    shortest, longest = map(float, ends)
    if not pair:
        if substeps is not None:
            raise BadStep(f"substeps = {substeps!r}", "is for a dt that varies; give dt as a pair, or no substeps")
        return longest, None
    if shortest >= longest:
        raise BadStep(f"dt = {dt!r}", "must be a shorter and a longer time; give a number where both are equal")
    if longest > MOST_UNEVEN * shortest:
        few = f"may be at most {MOST_UNEVEN} times as long as the shortest; a shorter time is used all the same"
        raise BadStep(f"dt = {dt!r}", f"is uneven: the longest {few}")
    substeps = SUBSTEPS if substeps is None else substeps
    if isinstance(substeps, bool) or not isinstance(substeps, int) or not 1 <= substeps <= MOST_SUBSTEPS:
        raise BadStep(f"substeps = {substeps!r}", f"must be a whole number from 1 to {MOST_SUBSTEPS}")
    return longest, Varying(shortest, substeps)


def _demand_varying(observer: Observer, periods: Any) -> None:
    """Raise `BadStep` for an option that a step with a varying dt does not support."""
    what, form = "a dt that varies", observer.form
    if form.system.discrete:
        raise BadStep(what, "is not for discrete plants, whose equations count samples; give dt as a number")
    if periods is not None or observer.delays:
        other = "delays" if observer.delays else "periods"
        raise BadStep(what, f"has no {other}, which count steps of one length; give dt as a number, or no {other}")
    if ELAPSED in {signal.name for signal in form.system.signals}:
        raise BadStep(what, f"is given in each call as {ELAPSED!r}, the name of a signal of the plant; rename that one")
    declared = {key for key, value in observer.arguments.items() if value is not None}
    has_R = any(gain.name == "R" for gain in observer.gains) and not has_expressions(observer.arguments.get("R"))
    if has_R and ("R" in declared or not declared & {"noise", "R_per_sample"}):
        way = "the standard deviation of one sample as noise={..}, or its variance as R_per_sample"
        raise BadStep(what, f"needs the noise of one sample, which R, a density, gives for one dt only; give {way}")
    if noisy := ", ".join(u.name for u in form.system.inputs if u.name in (observer.arguments.get("noise") or ())):
        way = "give its density per unit of time as Q, or dt as a number"
        raise BadStep(what, f"does not go with noise of inputs ({noisy}), which is held over one dt; {way}")
    if "Q_per_sample" in declared:
        way = "in place of Q_per_sample, which is for one dt; ekf and kalman take it with density = True"
        raise BadStep(what, f"needs Q, the process noise per unit of time (Q_per_sample/dt), {way}")


def _demand_length(observer: Observer, method: Method, dt: float) -> None:
    if is_ignored(StepMayFail) and dt <= min(each.refused for each in _lengths(observer, method, dt, advice=False)):
        return  # an advice takes as long as all else
    lengths, time = _lengths(observer, method, dt), observer.form.system.time
    tightest, advised = min(lengths, key=lambda each: each.refused), min(lengths, key=lambda each: each.take)
    error, proof = observer.error, ""
    if isinstance(method, ProvableMethod) and not (error is None or isinstance(error, Nothing)):
        proof = "" if method.obstacle(error) else _CERTIFIED
    if dt > tightest.refused:
        rule, take = tightest.rule or method.name, min(tightest.refused, advised.take)
        why = "; ".join(filter(None, (tightest.why, tightest.other)))
        raise StepTooLong(dt, tightest.refused, take, rule, why, advised.basis, time, proof)
    if dt > advised.take:
        rule, above = advised.rule or method.name, f"; above {_time(tightest.refused, time)} it is refused"
        text = (
            f"dt = {dt:g} may fail in a part of the declared box by {rule}{above * (tightest.refused < INF)}; "
            f"{_advice(advised.take, time, advised.basis)}{proof}"
        )
        warnings.warn(StepMayFail(text, _floor(advised.take)), stacklevel=4)


@lru_cache(maxsize=_LAST)
def _lengths(observer: Observer, method: Method, dt: float, advice: bool = True) -> tuple[Lengths, ...]:
    with one_thread():
        return (Lengths(), *discretise.lengths(observer, method, dt, advice))


@lru_cache(maxsize=_LAST)
def _pieces(observer: Observer, method: Method, clock: Clock) -> tuple[Pieces, ...]:
    try:
        return tuple(discretise.pieces(part, method, clock) for part in observer.parts)
    except NeedsFixedStep:
        raise NoVaryingStep(observer.name, method.name) from None


@lru_cache(maxsize=_LAST)
def _assembled(observer: Observer, method: Method, clock: Clock) -> Step:
    pieces, system = _pieces(observer, method, clock), observer.form.system
    assembly = Assembly(observer, clock, pieces)
    layout = Layout(
        plant=parameter_fields(system.parameters),
        gains=observer.gains,
        derived=flat(piece.derived for piece in pieces),
        state=assembly.state,
        groups=assembly.combined.groups,
        bits=(),
        mark=MARK if clock.guarded else None,
    )
    code = Code(
        tuning=limit_parameters(*layout.limited, flat(piece.tune for piece in pieces)),
        sections=assembly.sections,
        estimate=assembly.estimate,
        timed=assembly.timed,
        time=(set_time(system.times, clock),) if system.times else (),
        inner=assembly.inner,
        rule=next((piece.rule for piece in pieces if piece.rule), method.name),
        choice=next((piece.choice for piece in pieces if piece.choice), ""),
        signs=assembly.law.signs,
        reports=assembly.reports,
    )
    step = Step(system.name, observer, method, clock, layout, code)
    return with_bits(step, (*flat(piece.bits for piece in pieces), *elapsed_bits(clock, system.time)))


def with_bits(step: Step, extra: tuple[Bit, ...]) -> Step:
    """Return the step with those status bits that a block sets, in a fixed order, then the bits for memory that was not
    initialised. `extra`: bits of parts, whose texts replace those of the step for the same place.

    Raises: `BadStep` for more bits than a status has.
    """
    programs = (*step.code.tuning, *(s for section in step.code.called for s in section.program))
    raised = {place for place, _ in places(programs) if place.struct == "status"}
    sensors = zip(step.outputs, readings(step.observer.form), strict=True)
    beyond = {y: implausible(y, read, step.observer.form) for y, read in sensors}
    beyond |= {u: f"more than {TURNS} turns off" for u in step.inputs if u.period is not None}
    rates = step.observer.dynamics.fallback.rates.values()
    bits = (*possible_bits(step.outputs, step.inputs, rates, beyond), *extra)
    raisable = tuple(bit for place, bit in {bit.place: bit for bit in bits}.items() if place in raised)
    raisable += UNMADE if step.layout.mark else ()
    _demand_room(step.name, [bit.place.name for bit in raisable])
    return replace(step, layout=replace(step.layout, bits=in_capitals(raisable)))


def _demand_room(name: str, bits: Sequence[str]) -> None:
    if excess := shortage(bits):
        raise BadStep(f"{name} with {len(bits)} status bits or more", excess)
