"""Copies of an observer in parallel, restarted in turn, and the selection of one of them, as a part.

The copies are the members of one group, run in loops. A member has the fields and groups of the single observer and
those of its score, by which the members are compared: `score`, the smaller the better, and `score_*`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from hgogen.analysis.dynamics import HUGE
from hgogen.discretisation.stability import Lengths
from hgogen.errors import HgogenError
from hgogen.estimators.core import nominal, numbers
from hgogen.estimators.innovation import Innovation, staggered
from hgogen.graph import Graph
from hgogen.observer import Observer, state_field
from hgogen.part import Clock, Part, Pieces
from hgogen.program import Bit, Block, Call, Copy, Field, Group, Loop, Place, Program, Section, When, scalar, sym
from hgogen.reading.given import BadGain
from hgogen.signal import LOST
from hgogen.stepping.guards import clamp_fields, guard_state, innovation, written_fields
from hgogen.stepping.members import Substitution, joined, read_fields, renamed, reset_fields, reset_groups
from hgogen.stepping.projection import projection

RESTARTED = Bit(
    "RESTARTED",
    "a value of a member was lost (not finite, or beyond 1e30), and all of that member restarted",
    "treat the estimate as new; check parameters (tune was called?) and ranges",
)
_OUTSIDE = Place("work", "left")
SHARE, PREDICTORS = 0.3, 4  # the default window, of the restart period, and its predictors


@dataclass(eq=False)
class BadPeriod(HgogenError):
    """The error for a bank's restart period that is no whole number of samples dt."""

    period: float
    dt: float

    def __str__(self) -> str:
        wrong = "is shorter than" if self.period < self.dt else "is no whole number of samples of"
        fit = max(1, round(self.period / self.dt)) * self.dt
        return f"the restart period {self.period:g} {wrong} dt = {self.dt:g}; take {fit:.6g}, or another dt"


def demand_one(name: str, observer: Any, bank: str, late: str) -> None:
    """Raise `BadGain` unless `observer` is a single observer without delays. `name`: the function that wraps it;
    `bank`, `late`: the messages for a bank and for an observer with delays."""
    if not isinstance(observer, Observer):
        kind = type(observer).__name__
        raise BadGain(name, f"goes around an observer, such as hg.observers.riccati(..), not a {kind}")
    if any(isinstance(part, Parallel) for part in observer.parts):
        raise BadGain(name, bank)
    if observer.delays:
        raise BadGain(name, late)


@dataclass(frozen=True, eq=False)
class Parallel(Part):
    """A bank of `count` copies of `member`, the oldest restarted every `period` (s). Copies are compared by the output
    error of the newest sample, or by `innovation`, by default over a share of the period."""

    member: Observer
    count: int
    period: float
    newest: bool
    innovation: Innovation | None

    @property
    def published(self) -> set[str]:
        """The names of the fields of the selected copy that the step outputs: its estimate, notices and traces."""
        notices = (value for block in self.member.notices for value in block.writes.values())
        return read_fields([self.member.z, *notices]) | set(self.member.traces)


def parallel(part: Parallel, clock: Clock, pieces: Callable[[Part], Pieces]) -> Pieces:
    """Return the memory and statements of a bank: the copies in loops, with the `pieces` of each part of a copy."""
    period = round(part.period / clock.dt)
    if period < 1 or abs(period * clock.dt - part.period) > 1e-9 * part.period:
        raise BadPeriod(part.period, clock.dt)
    alone = _member(part, pieces)
    score = _score(part, clock, alone.fields, pieces)
    every = joined((alone, score))
    published = [field for field in alone.fields if field.name in part.published]
    writes = {Place("state", f.name): sym("member", f.name, f.size) for f in published}
    chosen = Block("the estimate is the selected member's", writes)
    publish = Loop("member", 1, (chosen,), start=Place("state", "selected"))
    substitution = Substitution({Place("state", f.name): Place("member", f.name) for f in every.fields}, {})

    both = zip(alone.update or [()] * clock.outputs, score.update, strict=True)
    updates = [_update(part, clock, j, *each) for j, each in enumerate(both)]
    keep = _keep(part.count, every, substitution, (every.predict, *updates, every.adapt))

    def loop(program: Program, before: Program = ()) -> Program:
        note = Block("a member has left its box", {_OUTSIDE: ca.SX(1)})
        guarded_program = substitution.program(
            (*program, *guard_state(program, every.fields, before=before, keep=(note,)))
        )
        members = Loop("member", part.count, guarded_program)
        if not written_fields(program, every.fields):
            return (members,)
        none = Block("no member has left its box yet", {_OUTSIDE: ca.SX(0)})
        return (none, members, When(_OUTSIDE, (Call(keep),), idle=True))

    copies = (replace(f, outer=False, meaning=f"{f.meaning} (the selected member's)") for f in published)
    return replace(
        every,
        fields=(
            *copies,  # whose box is also that of the member
            scalar("selected", 0, kind="index", high=part.count - 1, meaning="index of the selected member"),
            scalar("oldest", 0, kind="index", high=part.count - 1, meaning="index of the oldest member"),
            scalar("tick", 0, kind="index", high=period - 1, meaning="samples since the last restart"),
        ),
        bits=(*every.bits, RESTARTED),
        groups=(Group("member", part.count, every.fields, "the observers in parallel", every.groups),),
        predict=(*loop(every.predict), publish),
        update=tuple((*loop(update, every.predict), publish) for update in updates),
        adapt=(*(loop(every.adapt) if every.adapt else ()), *_choose(part, period), *_restart(part, alone), publish),
        inner=(keep,),
        covariance=None,
        inside=lambda program: (Loop("member", 1, substitution.program(program), start=Place("state", "selected")),),
        project=(Loop("member", part.count, substitution.program(projection(part.member, alone))), publish),
    )


def _member(part: Parallel, pieces: Callable[[Part], Pieces]) -> Pieces:
    alone = joined(map(pieces, part.member.parts))
    if alone.gate:
        raise BadGain("a bank", "compares its members on the same samples; leave the gate of its member out")
    if alone.correct:
        raise BadGain("a bank", "corrects its members by each sample; leave out update of its member")
    return alone


def _keep(count: int, every: Pieces, substitution: Substitution, programs: Iterable[Program]) -> Section:
    names = {field.name for program in programs for field in written_fields(program, every.fields)}
    boxes = clamp_fields([field for field in every.fields if field.name in names], every.fields, each=True)
    loop = Loop("member", count, substitution.program(boxes))
    return Section("keep_members", "keep each member in its box, or make it anew", (loop,))


def _update(part: Parallel, clock: Clock, j: int, correct: Program, score: Program) -> Program:
    error = innovation(part.member, clock, j, sym("work", "reading"))
    if not correct:
        return score
    writes = {Place("work", "e"): error, Place("work", "near"): ca.fabs(error) <= 10 * HUGE}
    judge = Block("the member's innovation", writes)
    return (judge, When(Place("work", "near"), correct), *score)


# --- the score


def _score(part: Parallel, clock: Clock, fields: Iterable[Field], pieces: Callable[[Part], Pieces]) -> Pieces:
    if part.newest:
        return _newest(part, clock)
    start = {Place("state", field.name): field.initial for field in fields}
    values = nominal(part.member) | {place: ca.DM(value).full()[:, 0] for place, value in start.items()}
    z = next((field for field in fields if field.name == "z"), None) or replace(
        state_field(part.member.form, None, 1.0),
        initial=tuple(float(value) for value in numbers(part.member.z, values)[:, 0]),
    )
    judged = pieces(_judge(part, clock.dt).part(part.member.dynamics, z))
    names = {"innovation": "score"}
    return renamed(judged, lambda name: names.get(name, f"score_{name}"), {Place("state", "z"): part.member.z})


def _judge(part: Parallel, dt: float) -> Innovation:
    share = PREDICTORS * dt
    return part.innovation or staggered(max(1, round(SHARE * part.period / share)) * share, PREDICTORS)


def judge_lengths(part: Parallel, dt: float) -> tuple[Lengths, ...]:
    """Return the step lengths admitted by the predictors whose output errors compare the copies of a bank; () for a
    bank that compares the newest sample."""
    if part.newest:
        return ()
    judge = _judge(part, dt).part(part.member.dynamics, state_field(part.member.form, None, 1.0))
    return (judge.predictor.lengths,)


def _newest(part: Parallel, clock: Clock) -> Pieces:
    worst = LOST  # the score of a member that restarts because it is lost

    def add(j: int) -> Program:
        error = innovation(part.member, clock, j, sym("work", "reading"))
        total = sym("state", "score") + ca.fmin(ca.fabs(error), HUGE) ** 2
        return (Block("its squared output error", {Place("state", "score"): ca.fmin(total, worst)}),)

    return Pieces(
        fields=(scalar("score", worst, low=0.0, high=worst, unit="y^2", meaning="squared output error"),),
        predict=(Block("no sample yet", {Place("state", "score"): ca.SX(0)}),),
        update=tuple(add(j) for j in range(clock.outputs)),
    )


# --- choice and restart


def _choose(part: Parallel, period: int) -> Program:
    """Return the program that selects the copy with the smallest score, if this score is below hysteresis times the
    score of the selected copy. A restart is due every `period` samples, and the copy that restarts is not selected."""
    tick, selected, score = sym("state", "tick") + 1, sym("state", "selected"), sym("member", "score")
    best, after = sym("work", "best"), _after_the_oldest(part)
    clock = {Place("work", "due"): tick >= period, Place("state", "tick"): ca.if_else(tick >= period, 0, tick)}
    every = {Place("work", "first"): ca.SX(0), Place("work", "staying"): ca.SX(part.count)}
    others = {
        Place("work", "first"): after,
        Place("work", "staying"): ca.SX(part.count - 1),
        Place("state", "selected"): ca.if_else(selected == sym("state", "oldest"), after, selected),
    }
    compare = (
        Block("is it better than the best so far?", {Place("work", "better"): score < best}),
        When(
            Place("work", "better"),
            (
                Block("its score", {Place("work", "best"): score}),
                Block("its number", {Place("work", "choice"): sym("work", "at")}),
            ),
        ),
    )
    clearly = Block("by the hysteresis", {Place("work", "clear"): best < sym("gain", "hysteresis") * score})
    return (
        Block(f"one member restarts every {period} samples", clock),
        Block("every member may be chosen", every),
        When(Place("work", "due"), (Block("but the one that restarts", others),)),
        Block("none is chosen yet", {Place("work", "choice"): selected}),
        Block("any score is better", {Place("work", "best"): ca.SX(2 * LOST)}),
        Loop("member", part.count, compare, Place("work", "first"), Place("work", "staying"), Place("work", "at")),
        Loop("member", 1, (clearly,), Place("state", "selected")),
        When(
            Place("work", "clear"),
            (Block("the better one is selected", {Place("state", "selected"): sym("work", "choice")}),),
        ),
    )


def _restart(part: Parallel, alone: Pieces) -> Program:
    """Return the program that restarts the oldest copy when due: its estimate and score become those of the selected
    copy, all its other memory is reset."""
    carried = read_fields([part.member.z])
    renewed = [field for field in alone.fields if not field.outer and field.name not in carried]
    begin = (*reset_fields("member", renewed), *reset_groups("member", alone.fields, alone.groups, part.member.z))
    restart = (
        Copy("member", Place("state", "selected"), Place("state", "oldest")),
        *((Loop("member", 1, begin, Place("state", "oldest")),) if begin else ()),
        Block("the next one is the oldest", {Place("state", "oldest"): _after_the_oldest(part)}),
    )
    return (When(Place("work", "due"), restart),)


def _after_the_oldest(part: Parallel) -> Graph:
    after = sym("state", "oldest") + 1
    return ca.if_else(after >= part.count, 0, after)
