"""A step: observer + method + dt as one program that every reader (Python, C, the operation counter) walks.

One call is the sections in order: `predict` (guard the input, advance the estimate from the last call to now),
`update_Y` for each output (guard the sample, correct), `adapt` (theta and the like), then `estimate`. The call k
returns the estimate at t_k using y_k; the first call advances no time. A sample that is not a number is missing:
predict only; an input that is not a number reuses the last valid one; both are said in the status.
"""

import decimal
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca

from hgogen.discretisation.lengths import Lengths
from hgogen.errors import BadArgument, HgogenError
from hgogen.method import Method
from hgogen.observer import Observer, tunable
from hgogen.part import Clock, Pieces
from hgogen.program import (
    INF,
    Bit,
    Block,
    Field,
    Group,
    Place,
    Program,
    Section,
    Statement,
    When,
    address,
    places,
    pruned,
    scalar,
    sym,
    walk,
)
from hgogen.reading.time_unit import of_time, plural
from hgogen.signal import Signal, resting
from hgogen.stepping import discretise, sensors
from hgogen.stepping.guards import (
    SIGNAL_BITS,
    STEP_BITS,
    guard_inputs,
    guard_outputs,
    implausible,
    kept,
    limit_parameters,
    measure,
    or_lower,
    outside_bit,
    readings,
    unrecovered,
)
from hgogen.stepping.members import following_groups, fresh, fresh_groups, joined
from hgogen.stepping.recovery import Recovery, Sampled, Sign
from hgogen.stepping.sensors import adapt_once, multiples, once, tick, timed, use
from hgogen.structure.dynamics import HUGE


class BadStep(BadArgument):
    """A step length or option that cannot be used."""


@dataclass(eq=False)
class StepTooLong(HgogenError):
    """A step length at which the discretisation is unstable at a point of the declared box: above `limit` it is
    refused, up to `take` advised, as `found` says."""

    dt: float
    limit: float
    take: float
    rule: str
    why: str
    found: str
    unit: str = "s"

    def __str__(self) -> str:
        return (
            f"dt = {self.dt:g} is too long for {self.rule}: refused above {_time(self.limit, self.unit)}, {self.why}; "
            f"{_advice(self.take, self.unit, self.found)}"
        )


def _time(value: float, unit: str) -> str:
    return rounded_down(value) + f" {unit}" * (unit != "s")


def _advice(take: float, unit: str, found: str) -> str:
    return f"take dt <= {_time(take, unit)} ({found}), or another method"


def rounded_down(value: float) -> str:
    """A number to three digits, never above it: what a sentence names as admissible is admitted."""
    return f"{float(decimal.Context(prec=3, rounding=decimal.ROUND_FLOOR).create_decimal(value)):g}"


class StepMayFail(UserWarning):
    """A step length that is not refused, and longer than is advised: it may fail."""


STATUS = 32  # bits of a status


@dataclass(frozen=True, eq=False, repr=False)
class Step:
    """The program of an observer at the sampling period `dt`, in the unit of the model's time as all times are.

    `plant`, `gains`, `derived`: fields of the parameters; `state`, `groups`: what a call remembers; `bits`: the status;
    `tuning`, `sections`, `estimate`: programs. `limit`: the dt above which it is refused. `timed`: the updates of
    `sections` for samples that say when they were taken, of a step for sensors of different rates; `periods`: the time
    between two samples of each output; `rule`: by what the observer's equations go, which a method may leave to
    another; `signs`: what the law of recovery counts, by which an estimate that is lost restarts.
    """

    name: str
    observer: Observer
    method: Method
    dt: float
    between: Literal["line", "hold"]
    plant: tuple[Field, ...]
    gains: tuple[Field, ...]
    derived: tuple[Field, ...]
    state: tuple[Field, ...]
    groups: tuple[Group, ...]
    bits: tuple[Bit, ...]
    tuning: Program
    sections: tuple[Section, ...]
    estimate: Program
    limit: float
    timed: tuple[Section, ...] = ()
    periods: tuple[float, ...] = ()
    rule: str = ""
    signs: tuple[Sign, ...] = ()

    def __repr__(self) -> str:
        return f"<step of {self.name}: {self.observer.name} by {self.rule}, dt = {self.dt:g}>"

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The plant's inputs."""
        return self.observer.form.system.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The plant's outputs."""
        return self.observer.form.system.outputs

    @cached_property
    def states(self) -> tuple[Signal, ...]:
        """The plant's states: what a call estimates."""
        return tuple(signal for signal, _ in self.observer.form.estimates)

    @property
    def time(self) -> str:
        """The unit of time of `dt` and of every rate."""
        return self.observer.form.system.time

    def unit(self, item: Field) -> str:
        """The unit of a field; one of the observer's own, which is written with s, in the model's time."""
        form = self.observer.form
        return of_time(item.unit, self.time, {s.unit for s in (*form.system.signals, *form.states)})

    @cached_property
    def apart(self) -> bool:
        """Whether prediction and correction can be called apart: `predict` does not integrate with the measurement."""
        reads = any(place.struct == "output" for place, _ in places(self.sections[0].program))
        return not reads and any(section.corrects for section in self.sections)

    @cached_property
    def program(self) -> Program:
        """All sections and the estimate, one after the other."""
        return tuple(s for section in self.sections for s in section.program) + self.estimate


@dataclass(eq=False)
class CannotUpdate(HgogenError):
    """Prediction and correction asked for apart, of an observer that integrates with the measurement."""

    observer: str
    rule: str

    def __str__(self) -> str:
        return (
            f"{self.observer} by {self.rule} integrates with the measurement, so it cannot predict and update apart; "
            "call the step, or use riccati with the method continuous_discrete"
        )


def plan(observer: Observer, method: Method, dt: float, between: str, periods: Any = None) -> Step:
    """The step of an observer; see `hgogen.call.sample`, which also makes it callable.

    Raises: `BadStep`, `StepTooLong`, `BadWindow`, `BadRate`, `CannotUpdate`.
    """
    if not isinstance(dt, int | float) or not 0 < dt < INF:
        raise BadStep(f"dt = {dt!r}", f"must be a positive time in {plural(observer.form.system.time)}")
    if between not in ("line", "hold"):
        raise BadStep(f"between = {between!r}", 'must be "line" or "hold"')
    system = observer.form.system
    every = () if periods is None else multiples(periods, system, float(dt))
    clock = Clock(float(dt), between, len(system.inputs), len(system.outputs), every)
    pieces = tuple(discretise.pieces(part, method, clock) for part in observer.parts)
    lengths = (Lengths(), *discretise.lengths(observer, method, dt))
    tightest, advised = min(lengths, key=lambda each: each.refused), min(lengths, key=lambda each: each.take)
    if dt > tightest.refused:
        rule, take = tightest.rule or method.name, min(tightest.refused, advised.take)
        why = "; ".join(filter(None, (tightest.why, tightest.other)))
        raise StepTooLong(dt, tightest.refused, take, rule, why, advised.basis, system.time)
    if dt > advised.take:
        rule, above = advised.rule or method.name, f"; above {_time(tightest.refused, system.time)} it is refused"
        warnings.warn(
            f"dt = {dt:g} may fail in a part of the declared box by {rule}{above * (tightest.refused < INF)}; "
            f"{_advice(advised.take, system.time, advised.basis)}",
            StepMayFail,
            stacklevel=3,
        )
    step = _assembled(observer, method, clock, pieces, tightest.refused)
    if every and not step.apart:
        raise CannotUpdate(observer.name, step.rule)
    return step


def _assembled(observer: Observer, method: Method, clock: Clock, pieces: tuple[Pieces, ...], limit: float) -> Step:
    system = observer.form.system
    plant, derived = tunable(system.parameters), _all(piece.derived for piece in pieces)
    whole = joined(pieces)
    law = Recovery(observer, clock, whole)
    state = _memory(observer, clock, pieces, law)
    counters = fresh("state", [field for field in whole.fields if field.kind == "index"])
    adapt = _all(piece.adapt for piece in pieces)
    still = not adapt or not _moves(adapt, observer)  # whether the estimate of this call stands before `adapt`
    others = (*counters, *fresh_groups("state", whole.fields, whole.groups, observer.z))
    follow = following_groups("state", whole.fields, whole.groups, observer.z)
    advance = When(Place("work", "running"), (*whole.predict, *kept(whole.predict, state, others)), follow)
    sections = [Section("predict", "advance the estimate to now", _predict(observer, clock, pieces, advance))]
    correcting = [j for j in range(clock.outputs) if any(piece.update and piece.update[j] for piece in pieces)]
    for j in correcting:
        output = system.outputs[j]
        program = _all(piece.update[j] for piece in pieces if piece.update)
        valid = (*program, *kept(program, state, others), *((use(output),) if clock.every else ()))
        sample = {j: Sampled(sym("work", "sample"), sym("work", "valid"), sym("work", "innovation"))}
        watch = law.watch(sample, says=still and not clock.every and j == correcting[-1])
        guarded: Program = (measure(observer, clock, j), When(Place("work", "valid"), valid), *watch)
        guarded = once(output, guarded) if clock.every else guarded
        sections.append(Section(f"update_{output}", f"correct with {output}", guarded, output.name))
    if not correcting:
        read = observer.dynamics.output(observer.z, clock.u_now)
        raw = [sym("output", output.name) for output in system.outputs]
        samples = {j: Sampled(y, clock.valid[j] > 0, y - read[j]) for j, y in enumerate(raw)}
        watch = law.watch(samples, says=still)
        sections[0] = replace(sections[0], program=(*sections[0].program, *watch))
    if adapt:
        running = Block(
            "no time has passed before the second call", {Place("work", "running"): sym("state", "calls") >= 2}
        )
        program = (running, When(Place("work", "running"), (*adapt, *kept(adapt, state, others))))
        program = adapt_once(program) if clock.every else program
        sections.append(Section("adapt", "adapt the gain; once after the updates", program))
    last = -2 if adapt and still else -1  # after it the estimate of this call stands
    said = () if still and not clock.every else (outside_bit(observer),)
    notices = (*said, *unrecovered(observer), *observer.notices)
    for k, section in enumerate(sections):
        if k == len(sections) + last or (clock.every and section.corrects):
            sections[k] = replace(section, program=(*section.program, *notices))
    sections = [replace(section, program=pruned(section.program)) for section in sections]
    updates = {section.corrects: section for section in sections}
    timed_ = (timed(updates[y.name], y) for y in system.outputs if clock.every and y.name in updates)
    step = Step(
        name=system.name,
        observer=observer,
        method=method,
        dt=clock.dt,
        between="hold" if clock.between == "hold" else "line",
        plant=plant,
        gains=observer.gains,
        derived=derived,
        state=state,
        groups=whole.groups,
        bits=(),
        tuning=limit_parameters(plant, observer.gains, _all(piece.tune for piece in pieces)),
        sections=tuple(sections),
        estimate=_estimate(observer),
        limit=limit,
        timed=tuple(timed_),
        periods=tuple(map(clock.period, range(clock.outputs))),
        rule=next((piece.rule for piece in pieces if piece.rule), method.name),
        signs=law.signs,
    )
    object.__setattr__(step, "bits", _bits(step, _all(piece.bits for piece in pieces)))
    return step


def _moves(program: Program, observer: Observer) -> bool:
    """Whether a program writes to the estimate."""
    shown = {place for place, _, _ in map(address, ca.symvar(observer.z))}
    return any(shown & s.writes.keys() for s in walk(program) if isinstance(s, Block))


def _all(tuples: Iterable[tuple[Any, ...]]) -> tuple[Any, ...]:
    return tuple(item for items in tuples for item in items)


def _adapts(pieces: tuple[Pieces, ...]) -> bool:
    """Whether a part adapts, which asks whether time has passed between two calls."""
    return any(piece.adapt for piece in pieces)


def _memory(observer: Observer, clock: Clock, pieces: tuple[Pieces, ...], law: Recovery) -> tuple[Field, ...]:
    """The parts' fields, those of the law of recovery, then the clock's: calls, the last input, and the last sample
    where predict reads it."""
    system = observer.form.system
    fields = [*_all(piece.fields for piece in pieces), *law.fields]
    adapts = _adapts(pieces)
    most, later = (2, ", then 2") if adapts else (1, "")
    fields.append(scalar("calls", 0, kind="index", high=most, meaning=f"0 before the first call, 1 after it{later}"))
    fields += sensors.fields(system.outputs, adapts) if clock.every else ()
    if system.inputs:
        start = tuple(resting(signal) for signal in system.inputs)
        low, high = (tuple(min(max(s.interval[end], -HUGE), HUGE) for s in system.inputs) for end in (0, 1))
        names = tuple(s.name for s in system.inputs)
        fields.append(Field("u", start, low=low, high=high, labels=names, meaning="last valid input"))
    if any(piece.uses_output for piece in pieces):
        zeros, names = (0.0,) * len(system.outputs), tuple(s.name for s in system.outputs)
        fields.append(
            Field("y", zeros, labels=names, meaning="sample of the last call, or its estimate where there was none")
        )
        fields.append(Field("y_valid", zeros, labels=names, meaning="1 where the last call had a valid sample"))
    return tuple(fields)


def _predict(observer: Observer, clock: Clock, pieces: tuple[Pieces, ...], advance: When) -> Program:
    """`advance`: what moves the estimate; in the first call copies of the model start from it, where it was written."""
    uses_output = any(piece.uses_output for piece in pieces)
    program: list[Statement] = [guard_inputs(observer)] if clock.inputs else []
    if uses_output:
        program.append(guard_outputs(observer, clock))
    adapts, calls = _adapts(pieces), sym("state", "calls")
    program += [tick(observer.form.system.outputs, adapts)] if clock.every else []
    counted = ca.if_else(calls < 2, calls + 1, 2) if adapts else ca.SX(1)
    program.append(
        Block(
            "the first call advances no time",
            {Place("work", "running"): calls >= 1, Place("state", "calls"): counted},
        )
    )
    program.append(advance)
    if clock.inputs:
        program.append(Block("remember the input", {Place("state", "u"): sym("work", "u", clock.inputs)}))
    if uses_output:
        remembered = {Place("state", "y"): sym("work", "y", clock.outputs), Place("state", "y_valid"): clock.valid}
        program.append(Block("remember the sample", remembered))
    return tuple(program)


def _estimate(observer: Observer) -> Program:
    values = observer.dynamics.estimate(observer.z, sym("state", "u", len(observer.form.system.inputs)))
    writes = {Place("estimate", s.name): values[i] for i, (s, _) in enumerate(observer.form.estimates)}
    return (Block("the plant's state", writes),)


def _bits(step: Step, extra: tuple[Bit, ...]) -> tuple[Bit, ...]:
    """The status bits that some block raises, in a fixed order; of one name the last, a part's own words for it."""
    programs = (*step.program, *step.tuning, *(s for section in step.timed for s in section.program))
    raised = {place.name for place, _ in places(programs) if place.struct == "status"}
    bits = []
    beyond = {y: implausible(read) for y, read in zip(step.outputs, readings(step.observer.form), strict=True)}
    for signals, kinds in (
        (step.outputs, ("MISSING", "REJECTED", "LATE", "EARLY", "REPEATED")),
        (step.inputs, ("REUSED", "CLAMPED")),
    ):
        for signal in signals:
            for kind in kinds:
                meaning, action = SIGNAL_BITS[kind]
                said = meaning.format(signal.name, beyond=beyond.get(signal))
                bits.append(Bit(f"{kind}_{signal.name}", said, action))
    lower = or_lower(step.observer)
    bits += [Bit(name, meaning, action.format(or_lower=lower)) for name, (meaning, action) in STEP_BITS.items()]
    bits += extra
    kept = tuple(bit for bit in {bit.name: bit for bit in bits}.values() if bit.name in raised)
    if len(kept) > STATUS:
        raise BadStep(f"{step.name} with {len(kept)} status bits", f"has more than {STATUS}; drop inputs or outputs")
    return kept
