"""The sections of a step: what its parts do in a call, in order, with guards, memory, and the law of recovery.

    predict   guard the input, advance the estimate from the last call to now
    update_Y  for each output that corrects: guard the sample, correct
    adapt     theta and the like, once after the updates

A notice tells of the estimate of this call: it stands at the end of the last section before which that still moves.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from hgogen.analysis.dynamics import HUGE
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.program import (
    Block,
    Call,
    Field,
    Loop,
    Place,
    Program,
    Repeat,
    Section,
    Statement,
    When,
    address,
    column,
    pruned,
    scalar,
    sym,
    walk,
)
from hgogen.signal import Signal, resting
from hgogen.stepping import sensors
from hgogen.stepping.guards import (
    boxed,
    guard_inputs,
    guard_outputs,
    guard_state,
    guarded,
    held_fields,
    held_now,
    hold,
    measure,
    outside_bit,
    unrecovered,
)
from hgogen.stepping.members import following_groups, joined
from hgogen.stepping.projection import estimate_fields
from hgogen.stepping.recovery import Recovery, Sampled
from hgogen.stepping.sensors import adapt_once, awaited, in_order, once, order_fields, tick, timed, use


@dataclass(frozen=True, eq=False)
class Assembly:
    """The parts of an observer as statements, put together by a clock."""

    observer: Observer
    clock: Clock
    pieces: tuple[Pieces, ...]

    @cached_property
    def whole(self) -> Pieces:
        """All parts as one."""
        return joined(self.pieces)

    @cached_property
    def law(self) -> Recovery:
        """The law by which an estimate that is lost restarts."""
        return Recovery(self.observer, self.clock, self.whole, max(1, len(self.correcting)))

    @cached_property
    def adapt(self) -> Program:
        """What the parts do once after the updates; a part that does anything asks whether time has passed."""
        return flat(piece.adapt for piece in self.pieces)

    @property
    def uses_output(self) -> bool:
        """Whether the last sample is remembered, which the parts integrate with."""
        return any(piece.uses_output for piece in self.pieces)

    @property
    def rated(self) -> bool:
        """Whether sensors have different rates."""
        return bool(self.clock.every)

    @cached_property
    def still(self) -> bool:
        """Whether the estimate of this call stands before `adapt`, which writes nothing to it."""
        shown = {place for place, _, _ in map(address, ca.symvar(self.observer.z))}
        return not any(shown & s.writes.keys() for s in walk(self.adapt) if isinstance(s, Block))

    @cached_property
    def correcting(self) -> tuple[int, ...]:
        """The outputs that correct, by their numbers."""
        count = range(self.clock.outputs)
        return tuple(j for j in count if any(piece.update and piece.update[j] for piece in self.pieces))

    @property
    def _ordered(self) -> tuple[Signal, ...]:
        """The outputs whose updates may be called one by one, without a count of the periods."""
        outputs = self.observer.form.system.outputs
        counted = self.rated or self.uses_output or not self.clock.guarded
        return () if counted else tuple(outputs[j] for j in self.correcting)

    @cached_property
    def state(self) -> tuple[Field, ...]:
        """The parts' fields, those of the law of recovery, then the clock's: calls, the last input, and the last sample
        where predict reads it."""
        system = self.observer.form.system
        counted = sensors.fields(system.outputs, bool(self.adapt)) if self.rated else order_fields(self._ordered)
        parts = flat(piece.fields for piece in self.pieces)
        most, later = (2, ", then 2") if self.adapt else (1, "")
        meaning = f"0 before the first call, 1 after it{later}"
        fields = [*parts, *held_fields(self.observer), *self.law.fields]
        fields += [scalar("calls", 0, kind="index", high=most, meaning=meaning), *counted]
        if system.inputs:
            start, names = tuple(map(resting, system.inputs)), tuple(s.name for s in system.inputs)
            low, high = (tuple(min(max(s.interval[end], -HUGE), HUGE) for s in system.inputs) for end in (0, 1))
            fields.append(Field("u", start, low=low, high=high, labels=names, meaning="last valid input"))
        if self.uses_output:
            zeros, names = (0.0,) * len(system.outputs), tuple(s.name for s in system.outputs)
            meaning = "sample of the last call" + ", or its estimate where there was none" * self.clock.guarded
            fields.append(Field("y", zeros, labels=names, meaning=meaning))
            valid = Field("y_valid", zeros, labels=names, meaning="1 where the last call had a valid sample")
            fields += [valid] if self.clock.guarded else []
        return tuple(fields if self.clock.guarded else (replace(field, low=(), high=()) for field in fields))

    @cached_property
    def sections(self) -> tuple[Section, ...]:
        """The sections in order, without what is written and never read."""
        sections = [self._predict, *map(self._update, self.correcting), *self._adapt]
        last = len(sections) - (2 if self.adapt and self.still else 1)  # after it the estimate of this call stands
        outside = () if self.still and not self.rated else (outside_bit(self.observer),)
        notices = (*outside, *unrecovered(self.observer), *self.observer.notices)
        finished = []
        for k, section in enumerate(sections):
            says = k == last or (self.rated and section.corrects)
            program = (*section.program, *notices) if says else section.program
            program = program if self.clock.guarded else silent(program)
            finished.append(replace(section, program=pruned(program)))
        return tuple(finished)

    @property
    def timed(self) -> tuple[Section, ...]:
        """The updates for samples that say when they were taken, of sensors of different rates."""
        updates = {section.corrects: section for section in self.sections}
        outputs = self.observer.form.system.outputs
        return tuple(timed(updates[y.name], y) for y in outputs if self.rated and y.name in updates)

    @property
    def estimate(self) -> Program:
        """The plant's state."""
        observer = self.observer
        values = observer.dynamics.estimate(observer.z, sym("state", "u", len(observer.form.system.inputs)))
        writes = {Place("estimate", s.name): values[i] for i, (s, _) in enumerate(observer.form.estimates)}
        return (Block("the plant's state", writes),)

    @cached_property
    def _fresh(self) -> Program:
        """What makes fault counts, and what is remembered beside the estimate, anew where the state is lost."""
        return (*self.law.cleared, *self.law.rest)

    def _guarded(self, program: Program, before: Program = ()) -> Program:
        """A program, and what keeps the state that it leaves behind in its box, or makes it anew; `before`: one that
        was guarded before it."""
        if not self.clock.guarded:
            return program
        keep = tuple(map(Call, self._keep))
        return (*program, *guard_state(program, self.state, self._fresh, before, keep))

    @property
    def inner(self) -> tuple[Section, ...]:
        """The sections that others call."""
        return (*self.whole.inner, *self._keep, *self.law.inner)

    @cached_property
    def _keep(self) -> tuple[Section, ...]:
        """The section that keeps the state in its box, which the first call and the guards behind programs ask for: the
        estimate, and what programs write."""
        if not self.clock.guarded:
            return ()
        programs = (self.whole.predict, *map(self._correct, self.correcting), self.adapt)
        guarded_fields = [*estimate_fields(self.observer, self.state)]
        guarded_fields += [field for program in programs for field in guarded(program, self.state)]
        program = boxed([field for field in self.state if field in guarded_fields], self.state, self._fresh)
        return (Section("keep_in_box", "keep the state in its box, or make it anew", program),)

    def _correct(self, j: int) -> Program:
        """What the parts do at a valid sample of output j."""
        return flat(piece.update[j] for piece in self.pieces if piece.update)

    @property
    def _predict(self) -> Section:
        """The section that predicts. In the first call the state is kept in its box, as memory may have been spoiled
        before it, and copies of the model start from the estimate, where it was written. Where no output corrects, the
        law of recovery is evaluated here."""
        observer, clock = self.observer, self.clock
        follow = following_groups("state", self.whole.fields, self.whole.groups, observer.z)
        taken, read = (guard_inputs, guard_outputs) if clock.guarded else (plain_inputs, plain_outputs)
        program: list[Statement] = [taken(observer)] if clock.inputs else []
        program += [read(observer, clock)] if self.uses_output else []
        program += [tick(observer.form.system.outputs, bool(self.adapt))] if self.rated else []
        calls = sym("state", "calls")
        counted = ca.if_else(calls < 2, calls + 1, 2) if self.adapt else ca.SX(1)
        running = {Place("work", "running"): calls >= 1, Place("state", "calls"): counted}
        program.append(Block("the first call advances no time", running))
        moves = (*hold(observer, clock), *self._guarded(self.whole.predict), *held_now(observer, clock))
        program.append(When(Place("work", "running"), moves, (*map(Call, self._keep), *follow)))
        program += awaited(self._ordered)
        if clock.inputs:
            program.append(Block("remember the input", {Place("state", "u"): sym("work", "u", clock.inputs)}))
        if self.uses_output:
            sample = {Place("state", "y"): sym("work", "y", clock.outputs)}
            valid = {Place("state", "y_valid"): clock.valid} if clock.guarded else {}
            program.append(Block("remember the sample", sample | valid))
        watch = () if self.correcting else self.law.watch(self._samples, says=self.still)
        return Section("predict", "advance the estimate to now", (*program, *watch))

    @property
    def _samples(self) -> dict[int, Sampled]:
        """What the law of recovery reads where no output corrects."""
        read = self.observer.dynamics.output(self.observer.z, self.clock.u_now)
        raw = [sym("output", output.name) for output in self.observer.form.system.outputs]
        return {j: Sampled(y, self.clock.valid[j] > 0, y - read[j]) for j, y in enumerate(raw)}

    def _update(self, j: int) -> Section:
        output = self.observer.form.system.outputs[j]
        program = self._guarded(self._correct(j), before=self.whole.predict)
        if not self.clock.guarded:
            plain = (plain_sample(self.observer, self.clock, j), *program)
            return Section(f"update_{output}", f"correct with {output}", plain, output.name)
        valid = (*program, *((use(output),) if self.rated or output in self._ordered else ()))
        sample = {j: Sampled(sym("work", "measurement"), sym("work", "valid"), sym("work", "output_error"))}
        says = self.still and not self.rated and j == self.correcting[-1]
        watch = self.law.watch(sample, says=says)
        guarded: Program = (*measure(self.observer, self.clock, j), When(Place("work", "valid"), valid), *watch)
        guarded = once(output, guarded) if self.rated else guarded
        guarded = in_order(output, guarded) if output in self._ordered else guarded
        return Section(f"update_{output}", f"correct with {output}", guarded, output.name)

    @property
    def _adapt(self) -> tuple[Section, ...]:
        if not self.adapt:
            return ()
        passed = {Place("work", "running"): sym("state", "calls") >= 2}
        running = Block("no time has passed before the second call", passed)
        program: Program = (running, When(Place("work", "running"), self._guarded(self.adapt)))
        program = adapt_once(program) if self.rated else program
        return (Section("adapt", "adapt the gain; once after the updates", program),)


def flat(tuples: Iterable[tuple[Any, ...]]) -> tuple[Any, ...]:
    """All entries of all tuples."""
    return tuple(item for items in tuples for item in items)


# --- in the place of guards, in a step without: signals as they come, every sample used, and a status of 0 ------


def plain_inputs(observer: Observer) -> Block:
    """The input now."""
    values = column(sym("input", signal.name) for signal in observer.form.system.inputs)
    return Block("the input", {Place("work", "u"): values})


def plain_outputs(observer: Observer, clock: Clock) -> Block:
    """All samples at once for a part that integrates with the measurement: y now, y at the last call."""
    now = column(sym("output", signal.name) for signal in observer.form.system.outputs)
    return Block("the samples", {Place("work", "y"): now, Place("work", "y_last"): sym("state", "y", clock.outputs)})


def plain_sample(observer: Observer, clock: Clock, j: int) -> Block:
    """The sample of output j and its innovation."""
    signal = observer.form.system.outputs[j]
    raw = sym("output", signal.name)
    error = raw - observer.dynamics.output(observer.z, clock.u_now)[j]
    values = {"measurement": raw, "e": error}
    return Block(f"the sample of {signal}", {Place("work", name): value for name, value in values.items()})


def silent(program: Sequence[Statement]) -> Program:
    """The program without what it says in the status, and without statements that do nothing else."""
    return tuple(statement for each in program for statement in _silent(each))


def _silent(statement: Statement) -> Program:
    if isinstance(statement, Block):
        writes = {place: value for place, value in statement.writes.items() if place.struct != "status"}
        if len(writes) == len(statement.writes):
            return (statement,)
        return (replace(statement, writes=writes),) * bool(writes)
    if isinstance(statement, When):
        body, otherwise = silent(statement.body), silent(statement.otherwise)
        return (replace(statement, body=body, otherwise=otherwise),) * bool(body or otherwise)
    if isinstance(statement, Loop | Repeat):
        return (replace(statement, body=body),) if (body := silent(statement.body)) else ()
    return (statement,)
