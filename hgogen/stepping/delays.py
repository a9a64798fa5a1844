"""Late samples: a step that restores the period of a late sample, and computes all periods up to now again.

A ring of K + 1 periods, with the current one at `state.period_at`, stores for each period its input, its samples, and
all memory of the step without delays after `predict`.

    predict     the next period replaces the oldest, whose samples are dropped if adapt was not called for them;
                predict, and store the memory
    update_y    the sample is stored in the period of its measurement, `age` periods ago
    adapt       the memory of the oldest incomplete period is restored; for each period from there up to now:
                predict (not for the first, whose memory is that after predict), update with its samples, adapt

The estimate is, bit for bit, that of the step without delays for the samples in the order of time. A period that is
computed again uses the current gains and parameters, from the correction in the first such period on. A missing value
is stored as `NONE`, which every guard treats as missing. The status covers all periods that a call computed. All memory
of a step is restored: fault counters, theta, predictors. A restart after the period of a late sample is decided again,
with that sample.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from hgogen.check import Verdict
from hgogen.graph import Graph
from hgogen.observer import Observer, age_of, cached_observers
from hgogen.program import (
    Bit,
    Block,
    Call,
    Field,
    Group,
    Loop,
    Place,
    Program,
    Section,
    Statement,
    When,
    column,
    pruned,
    scalar,
    sym,
)
from hgogen.reading.given import BadGain, count
from hgogen.signal import Signal
from hgogen.step import CannotUpdate, Step, with_bits
from hgogen.stepping.guards import LARGEST_NUMBER
from hgogen.stepping.members import Substitution
from hgogen.stepping.parallel import demand_one
from hgogen.theorem import Hypothesis

NONE = 3.2e38  # a finite float beyond LARGEST_NUMBER
PERIOD, MEMORY = "period", "memory"  # the two rings
AT, FILLED, DUE = (Place("state", name) for name in ("period_at", "period_filled", "period_due"))
DATED, SLOT, VACANT = (Place("work", name) for name in ("dated", "slot", "vacant"))
WAITED = Place("work", "waited")
RUNS, AGAIN, LATER = (Place("work", name) for name in ("runs", "again", "later"))
MOST = 1000  # largest delay in samples
IN_TIME = Hypothesis(
    "the model foretells the state over the time by which samples come late",
    verdict=Verdict.UNKNOWN,
    reason="the theorem is of the estimate at the newest sample; from there to now the model runs on without one",
)


def delayed(observer: Observer, /, **steps: int) -> Observer:
    """The observer for late samples, with delays up to `steps` periods for the named outputs: `delayed(observer, y=5)`.

    With each sample of such an output y the caller passes its age in periods, the signal y_age of the step's samples, 0
    for a current sample. The estimate is then as if the sample had been available at its time. The observer must
    predict and correct at samples. The step stores its memory of as many periods as the longest delay, and computes at
    most these again.

    Args: `steps` by output, from 1 to 1000; other outputs have no delay.

    Raises: `BadGain`; `CannotUpdate` from `sample` for an observer that integrates with the measurement.
    """
    demand_one(
        "delayed",
        observer,
        bank="goes around one observer, not around a bank; delay what would be its member",
        late="goes around an observer without delays; name all late outputs in one call",
    )
    outputs = [output.name for output in observer.form.system.outputs]
    if strangers := steps.keys() - set(outputs):
        raise BadGain(f"delayed({min(strangers)}=)", f"names no output; the outputs are {', '.join(outputs)}")
    if not steps:
        raise BadGain("delayed", f"delays nothing; name an output, such as {outputs[0]}=5 samples")
    late = tuple((name, count(name, steps[name], 1, MOST)) for name in outputs if name in steps)
    names = {signal.name for signal in observer.form.system.signals}
    for name, _ in late:
        if (age := age_of(name)) in names:
            raise BadGain(f"delayed({name}=)", f"adds a signal {age}, which the plant has already; rename that")
    return cached_observers(_delayed)(observer, late=late)


def _delayed(observer: Observer, *, late: tuple[tuple[str, int], ...]) -> Observer:
    says = ", ".join(f"{name} up to {most}" for name, most in late)
    line = f"samples come late, of {says} periods: fused in the period in which they were taken, then run to now again"
    return replace(
        observer, theorem=observer.theorem.under(IN_TIME), equations=(*observer.equations, line), delays=late
    )


def with_late_samples(step: Step) -> Step:
    """Return `step` extended by the memory of past periods, so that it accepts late samples of the outputs in its
    observer's `delays`; `step` itself if there are none. Raises: `CannotUpdate` for a step that integrates with the
    measurement, `BadStep` for more bits than a status has."""
    return _Delayed(step).step if step.observer.delays else step


@dataclass(frozen=True, eq=False)
class _Delayed:
    """A step that accepts late samples by a ring buffer of
    past periods, from the step `plain` without delays."""

    plain: Step

    @property
    def step(self) -> Step:
        plain, periods = self.plain, self._count
        if not plain.code.separable:
            raise CannotUpdate(plain.observer.name, plain.code.rule)
        clock = (
            scalar(AT.name, 0, kind="index", high=periods - 1, meaning="index of the period of now"),
            scalar(FILLED.name, 0, kind="index", high=periods, meaning="periods remembered since the last reset"),
            scalar(DUE.name, 0, kind="index", high=periods, meaning="periods, the last this one, that adapt completes"),
        )
        layout = replace(
            plain.layout,
            state=(*plain.layout.state, *clock, *self._signals),
            groups=(*plain.layout.groups, *self._rings),
        )
        code = replace(
            plain.code,
            sections=tuple(map(_pruned, (self._predict, *map(self._update, plain.outputs), self._adapt))),
            timed=(),
            inner=tuple(map(_pruned, (*plain.code.inner, *self._sections, self._remember, self._go_back))),
        )
        delayed_step = replace(plain, layout=layout, code=code, plain=plain)
        return with_bits(delayed_step, (*plain.layout.bits, *self._bits))

    @cached_property
    def _ages(self) -> Mapping[Signal, Signal]:
        return dict(zip(self.plain.late, self.plain.observer.ages, strict=True))

    @property
    def _count(self) -> int:
        return 1 + max(most for _, most in self.plain.observer.delays)

    # --- memory

    @cached_property
    def _signals(self) -> tuple[Field, ...]:
        named = (("u_given", self.plain.inputs, "input"), ("y_given", self.plain.outputs, "samples"))
        return tuple(_signals(name, signals, what) for name, signals, what in named if signals)

    @cached_property
    def _rings(self) -> tuple[Group, Group]:
        groups = tuple(replace(group, name=f"{MEMORY}_{group.name}") for group in self.plain.layout.groups)
        period = Group(PERIOD, self._count, self._signals, "a period: the input and the samples of it")
        meaning = "what the step remembered in a period after its prediction"
        return period, Group(MEMORY, self._count, self.plain.layout.state, meaning, groups)

    # --- the step without delays, on what a period was given

    @cached_property
    def _sections(self) -> tuple[Section, ...]:
        """The sections of the step without delays, which read the stored input and samples of a period. The updates
        that the caller calls raise the status bits for missing samples; samples in a wrong order cannot occur here."""
        signals = {"input": (self.plain.inputs, "u_given"), "output": (self.plain.outputs, "y_given")}
        reads: dict[Place, Graph] = {
            Place(struct, signal.name): sym("state", field, len(each))[k]
            for struct, (each, field) in signals.items()
            for k, signal in enumerate(each)
        }
        names = [*(f"MISSING_{output}" for output in self.plain.outputs), "OUT_OF_ORDER"]
        silent = {Place("status", name): Place("work", f"silent_{name}") for name in names}
        substitution = Substitution({**reads, **silent}, {})
        return tuple(
            Section(f"then_{each.name}", f"{each.meaning}, of a period", substitution.program(each.program))
            for each in self.plain.code.sections
        )

    @cached_property
    def _remember(self) -> Section:
        return Section("remember", "keep the memory of a period", self._copied("state", MEMORY))

    @cached_property
    def _go_back(self) -> Section:
        """The section that restores the memory of a past period. No stored period precedes the
        first call, even if memory was corrupted; the next prediction then detects the loss."""
        calls = sym("state", "calls")
        begun = Block("it was predicted", {Place("state", "calls"): ca.if_else(calls >= 1, calls, 1)})
        return Section("go_back", "take the memory of a period up again", (*self._copied(MEMORY, "state"), begun))

    def _copied(self, source: str, target: str) -> Program:
        plain, inner = self.plain, list[Statement](_copies(source, target, self.plain.layout.state))
        for group in plain.layout.groups:
            ends = {"state": group.name, MEMORY: f"{MEMORY}_{group.name}"}
            member = Place("work", f"which_{group.name}")
            copies = _copies(ends[source], ends[target], group.fields)
            copy = Loop(ends[MEMORY], 1, copies, start=member)
            inner.append(Loop(group.name, group.count, (copy,), index=member))
        return (Loop(MEMORY, 1, tuple(inner), start=AT),)

    # --- the sections of a caller

    @property
    def _predict(self) -> Section:
        plain, (predict, *_) = self.plain, self._sections
        (at, filled, due), most = self._clock, self._count
        after = {
            AT: ca.if_else(at >= most - 1, 0, at + 1),
            FILLED: ca.if_else(filled < most, filled + 1, most),
            DUE: ca.if_else(due < most, due + 1, most),
            WAITED: due >= most,
        }
        nothing = {Place(PERIOD, "y_given"): ca.SX(column([NONE] * len(plain.outputs)))}
        sampled = ca.mmin(ca.fabs(sym(PERIOD, "y_given", len(plain.outputs)))) <= LARGEST_NUMBER
        late = When(WAITED, (Block("its samples wait no longer", {Place("status", "DROPPED"): sampled}),))
        raw = (sym("input", signal.name) for signal in plain.inputs)
        input = column(ca.if_else(ca.fabs(u) <= LARGEST_NUMBER, u, NONE) for u in raw)
        begin = {Place("state", "u_given"): input} if plain.inputs else {}
        writes = {Place(PERIOD, "u_given"): sym("state", "u_given", len(plain.inputs))} if plain.inputs else {}
        program: Program = (
            Block("the next period takes the place of the oldest", after),
            *((Block("the input of this period", begin),) if begin else ()),
            Loop(PERIOD, 1, (late, Block("a period without samples", {**nothing, **writes})), start=AT),
            Call(predict),
            Call(self._remember),
        )
        return Section("predict", "begin a period, and advance the estimate to it", program)

    def _update(self, output: Signal) -> Section:
        j, size = self.plain.outputs.index(output), len(self.plain.outputs)
        samples, raw = sym(PERIOD, "y_given", size), sym("output", output.name)
        vacant = ca.fabs(samples[j]) > LARGEST_NUMBER
        first = {VACANT: vacant, Place("status", f"REPEATED_{output}"): ca.logic_not(vacant)}
        sample = {Place(PERIOD, "y_given"): column(raw if k == j else samples[k] for k in range(size))}
        dated, slot, due = self._dated(output, raw)
        put = (Block(f"one sample of {output} a period", first), When(VACANT, (Block("it is taken", sample), due)))
        program = (dated, When(DATED, (slot, Loop(PERIOD, 1, put, start=SLOT))))
        return Section(f"update_{output}", f"take a sample of {output}", program, output.name)

    def _dated(self, output: Signal, raw: Graph) -> tuple[Block, Block, Block]:
        at, filled, due = self._clock
        number, begun = ca.fabs(raw) <= LARGEST_NUMBER, filled >= 1
        status, available, age, slot = {Place("status", f"EARLY_{output}"): ca.logic_not(begun)}, begun, ca.SX(0), at
        if output in self._ages:
            age = sym("output", self._ages[output].name)
            slot, most = self._before(at, age), self._ages[output].interval[1]
            integral = ca.logic_and(age >= 0, ca.floor(age) >= age)
            recent = ca.logic_and(age <= most, age < filled)
            old = ca.logic_and(begun, ca.logic_and(integral, ca.logic_not(recent)))
            status |= {Place("status", f"LATE_{output}"): ca.logic_and(number, old)}
            status |= {Place("status", f"UNDATED_{output}"): ca.logic_and(number, ca.logic_not(integral))}
            available = ca.logic_and(integral, recent)
        status |= {Place("status", f"MISSING_{output}"): ca.logic_not(number)}
        runs = ca.if_else(due > age, due, age + 1)
        return (
            Block(f"in which period was {output} taken?", {DATED: ca.logic_and(number, available), **status}),
            Block("there", {SLOT: slot}),
            Block("that one is run again, and each after it", {DUE: runs}),
        )

    @property
    def _adapt(self) -> Section:
        at, _, due = self._clock
        predict, *others = self._sections
        signals = {Place("state", field.name): sym(PERIOD, field.name, field.size) for field in self._signals}
        again = (Call(predict), Call(self._remember))
        run: Program = (
            Block("what the period was given", signals),
            When(LATER, again),
            *map(Call, others),
            Block("a later period begins with its prediction", {LATER: ca.SX(1)}),
        )
        back = ca.if_else(due >= 1, due - 1, 0)
        first = {RUNS: due, AT: self._before(at, back), AGAIN: due >= 1}
        complete: Program = (
            Call(self._go_back),
            Block("the first period has its prediction", {LATER: ca.SX(0)}),
            Loop(PERIOD, self._count, run, start=AT, active=RUNS, index=AT),
            Block("every period is complete", {DUE: ca.SX(0)}),
        )
        program: Program = (Block("the first period that is not complete", first), When(AGAIN, complete))
        return Section("adapt", "go back to the first period with a new sample, and run to now again", program)

    # --- the clock

    @property
    def _clock(self) -> tuple[Graph, Graph, Graph]:
        """The index of the current period, the number of stored periods and the number of
        incomplete ones; 0 for a value out of its range, since memory may be corrupted."""
        most = self._count
        at, filled, due = (sym(*place) for place in (AT, FILLED, DUE))
        ends = ((at, most), (filled, most + 1), (due, most + 1))
        return tuple(ca.if_else(value < end, value, 0) for value, end in ends)

    def _before(self, at: Graph, age: Graph) -> Graph:
        return ca.if_else(at >= age, at - age, at + self._count - age)

    @property
    def _bits(self) -> tuple[Bit, ...]:
        oldest = self._count - 1
        dropped = f"a sample waited for adapt until it was more than {oldest} periods old: dropped, not used"
        bits = [Bit("DROPPED", dropped, "call adapt before predict makes a sample that waits older than that")]
        for output, age in self._ages.items():
            most = f"{age.interval[1]:g}"
            late = (
                f"the sample of {output.name} is more than {most} periods old, or older than the last reset: not used"
            )
            fix = f"none if rare; else let it come later: hg.delayed(.., {output.name}=..) of more than {most}"
            bits.append(Bit(f"LATE_{output.name}", late, fix))
        return tuple(bits)


def _signals(name: str, signals: tuple[Signal, ...], signal: str) -> Field:
    ends, names = (NONE,) * len(signals), tuple(map(str, signals))
    meaning = f"{signal} of a period, {NONE:g} for none"
    low = tuple(-end for end in ends)
    return Field(name, (0.0,) * len(signals), low=low, high=ends, labels=names, meaning=meaning)


def _copies(source: str, target: str, fields: Iterable[Field]) -> Program:
    blocks = []
    for kind, title in (("real", "memory"), ("index", "counters")):
        writes = {Place(target, f.name): sym(source, f.name, f.size) for f in fields if f.kind == kind}
        blocks += [Block(title, writes)] if writes else []
    return tuple(blocks)


def _pruned(section: Section) -> Section:
    return replace(section, program=pruned(section.program))
