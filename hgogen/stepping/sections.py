"""The sections of a step: the statements of its parts in a call, in order, with guards, memory, and the law of
recovery.

    predict   guard the input, advance the estimate from the last call to now
    innovate  where it is reported: the joint innovations of all samples
    gate      where innovations have gates: which samples may correct
    update_Y  for each output that corrects: guard the sample, correct
    adapt     theta and the like, once after the updates

A notice describes the estimate of this call, and is at the end of the last section that can change it.

Sensors may have different rates. `state.now` counts the calls of `predict` modulo 65536, the first one is number 0. A
sample of output y may have the number of its measurement period as time stamp, `update_y_at`: a sample of an earlier
period is late, one of a period that `predict` has not reached is early. Neither is used, and the status reports which.
The difference is computed modulo 65536, so the count may wrap round: up to 32768 periods back count as late, more as
early. Before the first `predict` every sample is early. A second sample of y in one period and a second `adapt` only
raise a status bit. The noise R of an output refers to its own period, a whole multiple of dt.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from hgogen.analysis.dynamics import HUGE, at_nearest_turn
from hgogen.errors import BadArgument
from hgogen.graph import turned
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.program import (
    INF,
    Block,
    Call,
    Field,
    Place,
    Program,
    Report,
    Section,
    Statement,
    When,
    address,
    column,
    pruned,
    scalar,
    sym,
    walk,
    within,
)
from hgogen.signal import Signal, plural, resting
from hgogen.stepping import times
from hgogen.stepping.guards import (
    clamp_field,
    clamp_fields,
    finite_value_fields,
    guard_innovations,
    guard_inputs,
    guard_outputs,
    guard_state,
    innovation,
    measure,
    outside_bit,
    report_unrecovered,
    store_finite_values,
    undefined_rates,
    written_fields,
)
from hgogen.stepping.invariants import constrained
from hgogen.stepping.members import copy_estimate, joined
from hgogen.stepping.projection import estimate_fields
from hgogen.stepping.recovery import Recovery, Sampled
from hgogen.stepping.reports import (
    age_fields,
    increment_ages,
    innovation_fields,
    innovations,
    no_innovation,
    reports,
    reset_age,
    reset_ages_where,
)
from hgogen.stepping.substeps import elapsed_fields, in_substeps, since_last_call
from hgogen.system import System

ROUND = 1 << 16  # periods after which the count wraps: the range of the smallest `unsigned` of C
OLDEST = ROUND // 2  # the oldest period that counts as late
AT = Place("argument", "at")  # the number of a sample's measurement period


class BadRate(BadArgument):
    """The error for a sensor's sampling period that is no whole multiple of dt, or for a period of an unknown
    output."""


def multiples(periods: Any, plant: System, dt: float) -> tuple[int, ...]:
    """Return the number of steps dt between two samples of each output; `periods`: sampling periods by name, dt for an
    output without one. Raises: `BadRate`."""
    names = [signal.name for signal in plant.outputs]
    if not isinstance(periods, Mapping):
        fix = f"must name outputs with their sampling periods in {plural(plant.time)}"
        raise BadRate(f"periods = {periods!r}", fix)
    for name in periods:
        if name not in names:
            raise BadRate(f"periods names {name!r},", f"which is no output; the outputs are {', '.join(names)}")
    counts = []
    for name in names:
        period = periods.get(name, dt)
        what = f"the period {name} = {period!r}"
        if isinstance(period, bool) or not isinstance(period, int | float) or not 0 < period < float("inf"):
            raise BadRate(what, f"must be a positive time in {plural(plant.time)}")
        count = max(1, round(period / dt))
        if abs(count * dt - period) > 1e-9 * period:
            raise BadRate(what, f"is no whole multiple of dt = {dt:g}; take {count * dt:.6g}, or another dt")
        counts.append(count)
    return tuple(counts)


def period_fields(outputs: tuple[Signal, ...], adapts: bool) -> tuple[Field, ...]:
    """Return the state's fields that count periods and mark used samples; `adapts`: whether the step has an `adapt`."""
    adapted = scalar("adapted", 0, kind="index", high=1, meaning="1 when adapt was called now")
    used = (scalar(_used(s), 0, kind="index", high=1, meaning=f"1 when a sample of {s} was used now") for s in outputs)
    return (
        scalar("now", 0, kind="index", high=ROUND - 1, meaning=f"number of this period, modulo {ROUND}"),
        *([adapted] if adapts else ()),
        *used,
    )


def _used(output: Signal) -> str:
    return f"used_{output}"


def tick(outputs: tuple[Signal, ...], adapts: bool) -> Block:
    """Return the block that counts the next period, from 0 in the first call, and clears the marks of used samples."""
    now = sym("state", "now")
    after = ca.if_else(now >= ROUND - 1, 0, now + 1)
    fresh = {Place("state", name): ca.SX(0) for name in (*["adapted"] * adapts, *map(_used, outputs))}
    later = ca.if_else(sym("state", "calls") >= 1, after, now)
    return Block("the next period", {Place("state", "now"): later, **fresh})


def once_per_period(output: Signal, correct: Program) -> Program:
    """Return the update by an output with tests, so that it runs at most once per period, and not before the first
    `predict`; `correct`: the program for a valid sample."""
    used, begun = sym("state", _used(output)), sym("state", "calls") >= 1
    test = {
        Place("work", "fresh"): ca.logic_and(used < 1, begun),
        Place("status", f"REPEATED_{output}"): used >= 1,
        Place("status", f"EARLY_{output}"): ca.logic_not(begun),
    }
    return (Block(f"one sample of {output} a period", test), When(Place("work", "fresh"), correct))


def order_fields(outputs: Iterable[Signal]) -> tuple[Field, ...]:
    """Return the state's fields that mark, for each output, whether its sample was used since the last predict."""
    meaning = "0: an update with {} may come, 1: none before the next predict"
    return tuple(scalar(_used(s), 1, kind="index", high=1, meaning=meaning.format(s)) for s in outputs)


def clear_marks(outputs: Iterable[Signal]) -> tuple[Block, ...]:
    """Return the block after a predict that clears the marks of used samples, so that one sample of each output may
    correct."""
    fresh = {Place("state", _used(output)): ca.SX(0) for output in outputs}
    return (Block("samples may come", fresh),) if fresh else ()


def once_per_prediction(output: Signal, correct: Program) -> Program:
    """Return the update by an output with a test, so that it runs at most once after each `predict`; `correct`: the
    program for a valid sample."""
    fresh = {Place("work", "fresh"): sym("state", _used(output)) < 1}
    raised = Block("there was no predict since the last", {Place("status", "OUT_OF_ORDER"): ca.SX(1)})
    return (Block(f"is a sample of {output} awaited?", fresh), When(Place("work", "fresh"), correct, (raised,)))


def mark_used(output: Signal) -> Block:
    """Return the block that marks the sample of an output as used."""
    return Block(f"{output} is used", {Place("state", _used(output)): ca.SX(1)})


def verdict_fields(verdicts: Mapping[int, str]) -> tuple[Field, ...]:
    """Return the state's fields with the verdicts of gates on the samples of this period."""
    meaning = "verdict of the gate: 0 none yet, 1 the samples may correct, 2 rejected"
    return tuple(scalar(name, 0, kind="index", high=2, meaning=meaning) for name in dict.fromkeys(verdicts.values()))


def if_admitted(name: str, correct: Program) -> Program:
    """Return the update by an output with a test, so that it runs only if a gate accepts the sample; `name`: the field
    of the gate's verdict."""
    verdict = sym("state", name)
    admitted = ca.logic_and(verdict >= 1, verdict <= 1)
    test = {Place("work", "admitted"): admitted, Place("status", "OUT_OF_ORDER"): verdict < 1}
    return (Block("does the gate admit the sample?", test), When(Place("work", "admitted"), correct))


def adapt_once(program: Program) -> Program:
    """Return the adaptation `program` with a test, so that it runs at most once per period."""
    done = sym("state", "adapted")
    test = {Place("work", "fresh"): done < 1, Place("status", "ADAPTED"): done >= 1}
    mark = Block("adapted", {Place("state", "adapted"): ca.SX(1)})
    return (Block("one adaptation a period", test), When(Place("work", "fresh"), (*program, mark)))


def once_predicted(program: Program) -> Program:
    """Return the program with a test, so that it runs only after a predict."""
    begun = Block("was there a predict?", {Place("work", "begun"): sym("state", "calls") >= 1})
    return (begun, When(Place("work", "begun"), program))


def timed(section: Section, output: Signal) -> Section:
    """Return the update section of an output for samples with a time stamp; a late or an early sample only raises a
    status bit."""
    now, at = sym("state", "now"), sym(*AT)
    age = ca.if_else(now >= at, now - at, ROUND - 1 - at + now + 1)
    test = {
        Place("work", "timely"): age < 1,
        Place("status", f"LATE_{output}"): ca.logic_and(age >= 1, age <= OLDEST),
        Place("status", f"EARLY_{output}"): age > OLDEST,
    }
    program = (Block("is the sample of now?", test), When(Place("work", "timely"), (Call(section),)))
    return replace(section, name=f"{section.name}_at", meaning=f"{section.meaning} of period `at`", program=program)


def _input_field(inputs: Sequence[Signal], clock: Clock) -> Field:
    start, names = tuple(map(resting, inputs)), tuple(s.name for s in inputs)
    low, high = (tuple(min(max(s.interval[end], -HUGE), HUGE) for s in inputs) for end in (0, 1))
    turns = clock.turns if any(clock.turns) else ()
    return Field("u", start, low=low, high=high, periods=turns, labels=names, meaning="last valid input")


@dataclass(frozen=True, eq=False)
class Assembly:
    """The sections of a step, combined from the memory and statements `pieces` of an observer's parts."""

    observer: Observer
    clock: Clock
    pieces: tuple[Pieces, ...]

    @cached_property
    def combined(self) -> Pieces:
        """The memory and statements of all parts in sequence, as one `Pieces`."""
        return constrained(self.observer, joined(self.pieces))

    @cached_property
    def law(self) -> Recovery:
        """The law that restarts or projects a lost estimate."""
        return Recovery(self.observer, self.clock, self.combined, max(1, len(self.correcting)))

    @property
    def correct(self) -> Program:
        """The program that corrects by all samples together, after the updates of a call; () if each update
        corrects."""
        return self.combined.correct

    @cached_property
    def adapt(self) -> Program:
        """The program that runs once after the updates of a call, such as the law of theta."""
        return flat(piece.adapt for piece in self.pieces)

    @property
    def uses_output(self) -> bool:
        """Whether a part integrates with the last sample y, which is then stored in the state."""
        return any(piece.uses_output for piece in self.pieces)

    @property
    def rated(self) -> bool:
        """Whether a sensor has a sampling period other than dt."""
        return bool(self.clock.every)

    @cached_property
    def still(self) -> bool:
        """Whether the section after the updates, `adapt`, leaves the estimate unchanged."""
        read_places = {place for place, _, _ in map(address, ca.symvar(self.observer.z))}
        return not any(
            read_places & s.writes.keys() for s in walk((*self.correct, *self.adapt)) if isinstance(s, Block)
        )

    @cached_property
    def correcting(self) -> tuple[int, ...]:
        """The indices of the outputs whose samples correct the estimate."""
        count = range(self.clock.outputs)
        return tuple(j for j in count if any(piece.update and piece.update[j] for piece in self.pieces))

    @property
    def _ordered(self) -> tuple[Signal, ...]:
        outputs = self.observer.form.system.outputs
        counted = self.rated or self.uses_output or not self.clock.guarded
        return () if counted else tuple(outputs[j] for j in self.correcting)

    @property
    def _aging(self) -> tuple[Signal, ...]:
        """The outputs of which the step reports the age of the last used sample."""
        return self.observer.form.system.outputs if "age" in self.clock.report else ()

    @property
    def _innovates(self) -> bool:
        """Whether the step reports its joint innovations."""
        return "innovation" in self.clock.report

    @property
    def reports(self) -> tuple[Report, ...]:
        """The reports on the estimate that were requested."""
        return reports(self.observer, self.clock, self.combined)

    @cached_property
    def state(self) -> tuple[Field, ...]:
        """All fields of the step's state: the fields of the parts, of the law of recovery, and of the clock, which are
        the count of calls, the last input, and the last sample if `predict` reads it."""
        system = self.observer.form.system
        counted = period_fields(system.outputs, self.completes) if self.rated else order_fields(self._ordered)
        parts = self.combined.fields
        most, later = (2, ", then 2") if self.adapt else (1, "")
        predicts = self.clock.first == "predict"
        meaning = "always 1: the first call predicts" if predicts else f"0 before the first call, 1 after it{later}"
        fields = [*parts, *finite_value_fields(self.observer), *self.law.fields]
        fields += [scalar("calls", int(predicts), kind="index", high=most, meaning=meaning), *counted]
        fields += verdict_fields(self.combined.verdicts)
        fields += age_fields(self._aging)
        fields += innovation_fields(system.outputs) if self._innovates else ()
        fields += times.count_fields(system.times, self.clock)
        fields += [_input_field(system.inputs, self.clock)] if system.inputs else []
        fields += elapsed_fields(self.clock, system.time)
        if self.uses_output:
            zeros, names = (0.0,) * len(system.outputs), tuple(s.name for s in system.outputs)
            meaning = "last sample" + ", or its estimate" * self.clock.guarded
            fields.append(Field("y", zeros, labels=names, meaning=meaning))
            valid = Field("y_valid", zeros, labels=names, meaning="1 where the last call had a valid sample")
            fields += [valid] if self.clock.guarded else []
        return tuple(fields if self.clock.guarded else map(unlimited, fields))

    @cached_property
    def sections(self) -> tuple[Section, ...]:
        """The sections predict, update of each output, adapt, without statements whose results are never read."""
        sections = [self._predict, *self._innovate, *self._gate, *map(self._update, self.correcting), *self._adapt]
        last = len(sections) - (2 if self.completes and self.still else 1)  # the last one that can change the estimate
        outside = () if self._watched else (outside_bit(self.observer),)
        notices = (*outside, *report_unrecovered(self.observer), *self.observer.notices)
        finished = []
        for k, section in enumerate(sections):
            notice = k == last or (self.rated and section.corrects)
            program = (*section.program, *notices) if notice else section.program
            program = program if self.clock.guarded else without_status(program)
            finished.append(replace(section, program=pruned(program)))
        return tuple(finished)

    @property
    def timed(self) -> tuple[Section, ...]:
        """The update sections for samples with a time stamp; none where all sensors have the period dt."""
        updates = {section.corrects: section for section in self.sections}
        outputs = self.observer.form.system.outputs
        return tuple(timed(updates[y.name], y) for y in outputs if self.rated and y.name in updates)

    @property
    def estimate(self) -> Program:
        """The program that computes the estimate of the plant's state."""
        observer = self.observer
        values = observer.dynamics.estimate(observer.z, sym("state", "u", len(observer.form.system.inputs)))
        writes = {Place("estimate", s.name): values[i] for i, (s, _) in enumerate(observer.form.estimates)}
        return (Block("the plant's state", writes),)

    @cached_property
    def _fresh(self) -> Program:
        return (*self.law.cleared, *self.law.other_memory)

    def _guarded(self, program: Program, before: Program = ()) -> Program:
        if not self.clock.guarded:
            return (*program, *in_turn(program, self.state))
        keep = tuple(map(Call, self._keep))
        return (*program, *guard_state(program, self.state, self._fresh, before, keep))

    @property
    def inner(self) -> tuple[Section, ...]:
        """The sections that the sections predict, update and adapt call."""
        return (*self.combined.inner, *self._keep, *self.law.inner)

    @cached_property
    def _keep(self) -> tuple[Section, ...]:
        """The section that clamps the estimate and other observer
        states to their boxes; none without guards."""
        if not self.clock.guarded:
            return ()
        updates = map(self._correct, self.correcting)
        programs = (self.combined.predict, self.combined.gate, *updates, self.correct, self.adapt)
        guarded_fields = [*estimate_fields(self.observer, self.state)]
        guarded_fields += [field for program in programs for field in written_fields(program, self.state)]
        program = clamp_fields([field for field in self.state if field in guarded_fields], self.state, self._fresh)
        return (Section("keep_in_box", "keep the state in its box, or make it anew", program),)

    def _correct(self, j: int) -> Program:
        return self.combined.update[j]

    @property
    def _predict(self) -> Section:
        """The section that advances the estimate from the last call to now.
        The first call clamps the state to its box, in case its memory was
        corrupted, and starts copies of the model from the estimate."""
        observer, clock, plant = self.observer, self.clock, self.observer.form.system
        follow = copy_estimate("state", self.combined.fields, self.combined.groups, observer.z)
        program: list[Statement] = [*self._received]
        calls = sym("state", "calls")
        counted = ca.if_else(calls < 2, calls + 1, 2) if self.adapt else ca.SX(1)
        running = {Place("work", "running"): calls >= 1, Place("state", "calls"): counted}
        known = "the first call predicts" if clock.first == "predict" else "the first call advances no time"
        program.append(Block(known, running))
        advance = (
            *store_finite_values(observer, clock),
            *self._guarded(self.combined.predict),
            *undefined_rates(observer, clock),
        )
        if clock.varying:
            program += since_last_call(clock, plant.times)
            advance = in_substeps(advance, clock, plant.times, self.uses_output, tuple(map(Call, self._keep)))
        start = (*map(Call, self._keep), *self.combined.constrain, *follow)
        program.append(When(Place("work", "running"), advance, start, part="advance"))
        program += clear_marks(self._ordered)
        cleared = {Place("state", name): ca.SX(0) for name in self.combined.verdicts.values()}
        program += [Block("no gate has judged a sample", cleared)] if cleared else []
        program += [increment_ages(self._aging)] if self._aging else []
        program += no_innovation(clock.outputs) if self._innovates else ()
        watch = () if self.correcting else self.law.watch(self._samples, notice=self.still)
        return Section("predict", "advance the estimate to now", (*program, *self._stored, *watch))

    @property
    def _received(self) -> Iterator[Statement]:
        """The statements that read the time, the inputs, and those samples that `predict` needs."""
        observer, clock, plant = self.observer, self.clock, self.observer.form.system
        guard_input, read = (guard_inputs, guard_outputs) if clock.guarded else (plain_inputs, plain_outputs)
        if plant.times:
            yield times.advance_by_period(plant.times, clock)
        names = {"u", *(field.name for field in finite_value_fields(observer))} if clock.guarded else ()
        for field in (field for field in self.state if field.name in names):  # memory may have been corrupted
            yield clamp_field(field, each=HUGE in field.high)
        if clock.inputs:
            yield guard_input(observer, clock)
        if self.uses_output:
            yield read(observer, clock)
        if self.rated:
            yield tick(plant.outputs, self.completes)

    @property
    def _stored(self) -> Iterator[Statement]:
        """The statements that store the input and the sample for the next call."""
        clock = self.clock
        if clock.inputs:
            yield Block("remember the input", {Place("state", "u"): sym("work", "u", clock.inputs)})
        if self.uses_output:
            sample = {Place("state", "y"): sym("work", "y", clock.outputs)}
            valid = {Place("state", "y_valid"): clock.valid} if clock.guarded else {}
            yield Block("remember the sample", sample | valid)
            yield from reset_ages_where(self._aging, clock.valid > 0) if self._aging else ()

    @property
    def _innovate(self) -> tuple[Section, ...]:
        """The section that computes the innovations of all samples, before any is used; none unless requested."""
        if not self._innovates:
            return ()
        program = innovations(self.observer, self.clock, self.combined)
        meaning = "compute the innovations of all samples, before any of them corrects"
        return (Section("innovate", meaning, once_predicted(program)),)

    @property
    def _gate(self) -> tuple[Section, ...]:
        """The section that decides, before any sample is used, which samples may correct; none without gates."""
        gated = self.combined.verdicts
        if not gated:
            return ()
        judged = self._guarded(self.combined.gate, before=self.combined.predict)
        program = once_predicted((*guard_innovations(self.observer, self.clock, gated), *judged))
        return (Section("gate", "decide by the innovations which samples may correct", program),)

    @property
    def _watched(self) -> bool:
        """Whether the law of recovery, at the last output, always evaluates the bit OUTSIDE_BOX."""
        gated = any(j in self.combined.verdicts for j in self.correcting[-1:])
        return self.still and not self.rated and not gated

    @property
    def _samples(self) -> dict[int, Sampled]:
        read = self.observer.dynamics.output(self.observer.z, self.clock.u_now)
        raw = [sym("output", output.name) for output in self.observer.form.system.outputs]
        errors = self.observer.dynamics.error(raw, read)
        return {j: Sampled(y, self.clock.valid[j] > 0, errors[j]) for j, y in enumerate(raw)}

    def _update(self, j: int) -> Section:
        output = self.observer.form.system.outputs[j]
        program = self._guarded(self._correct(j), before=self.combined.predict)
        program = (*program, reset_age(output)) if self._aging else program
        if not self.clock.guarded:
            plain = (plain_sample(self.observer, self.clock, j), *program)
            return Section(f"update_{output}", f"correct with {output}", plain, output.name)
        valid = (*program, *((mark_used(output),) if self.rated or output in self._ordered else ()))
        sample = {j: Sampled(sym("work", "reading"), sym("work", "valid"), sym("work", "output_error"))}
        notice = self._watched and j == self.correcting[-1]
        watch = self.law.watch(sample, notice=notice)
        correct: Program = (When(Place("work", "valid"), valid, part="use_sample"), *watch)
        verdict = self.combined.verdicts.get(j)
        correct = correct if verdict is None else if_admitted(verdict, correct)
        guarded: Program = (*measure(self.observer, self.clock, j), *correct)
        guarded = once_per_period(output, guarded) if self.rated else guarded
        guarded = once_per_prediction(output, guarded) if output in self._ordered else guarded
        return Section(f"update_{output}", f"correct with {output}", guarded, output.name)

    @property
    def completes(self) -> bool:
        """Whether the step has a section after the updates."""
        return bool(self.correct or self.adapt)

    @property
    def _adapt(self) -> tuple[Section, ...]:
        if not self.completes:
            return ()
        program: Program = self._guarded(self.correct, before=self.combined.predict) if self.correct else ()
        passed = {Place("work", "running"): sym("state", "calls") >= 2}
        running = Block("no time has passed before the second call", passed)
        adapting = When(Place("work", "running"), self._guarded(self.adapt), part="adapt_gain")
        program = (*program, running, adapting) if self.adapt else program
        program = adapt_once(program) if self.rated else program
        what = " and ".join(["correct by all samples"] * bool(self.correct) + ["adapt the gain"] * bool(self.adapt))
        return (Section("adapt", f"{what}; once after the updates", program),)


def flat(tuples: Iterable[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Return the entries of all tuples as one tuple."""
    return tuple(item for items in tuples for item in items)


# --- a step without guards: unchecked signals, every sample is used, and the status is 0 ------------------------


def plain_inputs(observer: Observer, clock: Clock) -> Block:
    """Return the block that reads the current input, unchecked, as the work value u."""
    plant = observer.form.system
    values = [sym("input", signal.name) for signal in plant.supplied]
    return Block("the input", {Place("work", "u"): column([*values, *times.current_times(plant.times, clock)])})


def plain_outputs(observer: Observer, clock: Clock) -> Block:
    """Return the block that reads all samples for a part that integrates with the measurement: y now, y at the last
    call."""
    outputs, last = observer.form.system.outputs, sym("state", "y", clock.outputs)
    predicted = observer.dynamics.output(observer.z, sym("state", "u", clock.inputs))
    before = column(at_nearest_turn(y, last[j], predicted[j]) for j, y in enumerate(outputs))
    now = column(at_nearest_turn(y, sym("output", y.name), before[j]) for j, y in enumerate(outputs))
    return Block("the samples", {Place("work", "y"): now, Place("work", "y_last"): before})


def plain_sample(observer: Observer, clock: Clock, j: int) -> Block:
    """Return the block that reads the sample of output j, unchecked, and computes its innovation y - yhat."""
    signal = observer.form.system.outputs[j]
    raw = sym("output", signal.name)
    values = {"reading": raw, "e": innovation(observer, clock, j, raw)}
    return Block(f"the sample of {signal}", {Place("work", name): value for name, value in values.items()})


def unlimited(field: Field) -> Field:
    """Return the field with an infinite box for every element that is no angle."""
    if not field.periods:
        return replace(field, low=(), high=())
    ends = (end if period else (-INF, INF) for end, period in zip(field.box, field.turns, strict=True))
    low, high = zip(*ends, strict=True)
    return replace(field, low=low, high=high)


def in_turn(program: Program, state: Iterable[Field]) -> Program:
    """Return the statements that wrap the angles that a program writes to their turn."""
    written = {place for block in walk(program) if isinstance(block, Block) for place, _ in block.written}
    blocks = []
    for field in (each for each in state if each.periods and Place("state", each.name) in written):
        value, angles = sym("state", field.name, field.size), enumerate(zip(field.box, field.turns, strict=True))
        in_their_turn = column(
            turned(value[i], low, period) if period else value[i] for i, ((low, _), period) in angles
        )
        blocks.append(Block(f"angles of {field.name} in their turn", {Place("state", field.name): in_their_turn}))
    return tuple(blocks)


def without_status(program: Sequence[Statement]) -> Program:
    """Return the program without assignments to the status, and without statements that then have no effect."""
    return tuple(statement for each in program for statement in _silent(each))


def _silent(statement: Statement) -> Program:
    if isinstance(statement, Block):
        writes = {place: value for place, value in statement.writes.items() if place.struct != "status"}
        if len(writes) == len(statement.writes):
            return (statement,)
        return (replace(statement, writes=writes),) * bool(writes)
    if not statement.bodies:
        return (statement,)
    changed = within(statement, without_status)
    return (changed,) * any(changed.bodies.values())
