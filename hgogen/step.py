"""A step: observer + method + dt as one program that every reader (Python, C, the operation counter) walks.

One call is the sections in order: `predict` (guard the input, advance the estimate from the last call to now),
`update_Y` for each output (guard the sample, correct), `adapt` (theta and the like), then `estimate`. The call k
returns the estimate at t_k using y_k; the first call advances no time. A sample that is not a number is missing:
predict only; an input that is not a number reuses the last valid one; both are said in the status.
"""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, Literal

import casadi as ca

from hgogen.errors import HgogenError
from hgogen.method import Method
from hgogen.observer import HUGE, Clock, Observer, Pieces, resting, tunable
from hgogen.program import (
    INF,
    Bit,
    Block,
    Field,
    Group,
    Program,
    Section,
    Statement,
    When,
    column,
    places,
    pruned,
    scalar,
    scope,
    sym,
    walk,
)
from hgogen.signal import Signal

LARGEST_NUMBER = 3e38  # every finite float is within; what is not counts as "not a number"


@dataclass(frozen=True)
class BadStep(HgogenError):
    """A step length or option that cannot be used."""

    what: str
    reason: str

    def __str__(self) -> str:
        return f"{self.what} {self.reason}"


@dataclass(frozen=True)
class StepTooLong(HgogenError):
    """A step length at which the discretisation cannot be stable."""

    dt: float
    limit: float
    method: str
    why: str

    def __str__(self) -> str:
        return f"dt = {self.dt:g} is too long for {self.method}: {self.why}; take dt <= {self.limit:.3g}, or another method"


class StepMayFail(UserWarning):
    """A step length that is stable in a part of the declared box only."""


@dataclass(frozen=True, eq=False)
class Step:
    """The program of an observer at the sampling period `dt` (s).

    `plant`, `gains`, `derived`: fields of the parameters; `state`, `groups`: what a call remembers; `bits`: the status;
    `tuning`, `sections`, `estimate`: programs. `limit`: the largest dt that can be stable.
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

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The plant's inputs."""
        return self.observer.form.system.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The plant's outputs."""
        return self.observer.form.system.outputs

    @property
    def states(self) -> tuple[Signal, ...]:
        """The plant's states: what a call estimates."""
        return tuple(signal for signal, _ in self.observer.form.estimates)

    @cached_property
    def program(self) -> Program:
        """All sections and the estimate, one after the other."""
        return tuple(s for section in self.sections for s in section.program) + self.estimate


def plan(observer: Observer, method: Method, dt: float, between: str) -> Step:
    """The step of an observer; see `hgogen.call.sample`, which also makes it callable.

    Raises: `BadStep`, `StepTooLong`, `BadWindow`.
    """
    if not isinstance(dt, int | float) or not 0 < dt < INF:
        raise BadStep(f"dt = {dt!r}", "must be a positive time in seconds")
    if between not in ("line", "hold"):
        raise BadStep(f"between = {between!r}", 'must be "line" or "hold"')
    system = observer.form.system
    clock = Clock(float(dt), between, len(system.inputs), len(system.outputs))
    pieces = tuple(part.pieces(method, clock) for part in observer.parts)
    tightest = min(pieces, key=lambda piece: piece.limit)
    if dt > tightest.limit:
        raise StepTooLong(dt, tightest.limit, method.name, tightest.why)
    caution = min(piece.caution for piece in pieces)
    if dt > caution:
        warnings.warn(
            f"dt = {dt:g} is longer than {caution:.3g}, from where on {method.name} may fail in a part of the declared "
            "box; shorten it or take methods.continuous_discrete",
            StepMayFail,
            stacklevel=3,
        )
    return _assembled(observer, method, clock, pieces, tightest.limit)


def _assembled(observer: Observer, method: Method, clock: Clock, pieces: tuple[Pieces, ...], limit: float) -> Step:
    system = observer.form.system
    plant, derived = tunable(system.parameters), _all(piece.derived for piece in pieces)
    state = _memory(observer, clock, pieces)
    keep = _Keeper(state)
    sections = [Section("predict", "advance the estimate to now", _predict(observer, clock, pieces, keep))]
    for j, output in enumerate(system.outputs):
        program = _all(piece.update[j] for piece in pieces if piece.update)
        if program:
            guarded = (_measure(observer, clock, j), When("work.valid", (*program, *keep(program))))
            sections.append(Section(f"update_{output}", f"correct with {output}", guarded))
    adapt = _all(piece.adapt for piece in pieces)
    if adapt:
        running = Block("no time has passed before the second call", {"work.running": sym("state.calls") >= 2})
        program = (running, When("work.running", (*adapt, *keep(adapt))))
        sections.append(Section("adapt", "adapt the gain; once after the updates", program))
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
        groups=_all(piece.groups for piece in pieces),
        bits=(),
        tuning=_tune(plant, observer.gains, _all(piece.tune for piece in pieces)),
        sections=tuple(replace(section, program=pruned(section.program)) for section in sections),
        estimate=_estimate(observer),
        limit=limit,
    )
    object.__setattr__(step, "bits", _bits(step, _all(piece.bits for piece in pieces)))
    return step


def _all(tuples: Iterable[tuple[Any, ...]]) -> tuple[Any, ...]:
    return tuple(item for items in tuples for item in items)


def _memory(observer: Observer, clock: Clock, pieces: tuple[Pieces, ...]) -> tuple[Field, ...]:
    """The parts' fields, then the clock's: calls, the last input, and the last sample where predict reads it."""
    system = observer.form.system
    fields = list(_all(piece.fields for piece in pieces))
    fields.append(scalar("calls", 0, kind="index", high=2, meaning="0 before the first call, 1 after it, then 2"))
    if system.inputs:
        start = tuple(resting(signal) for signal in system.inputs)
        fields.append(Field("u", start, labels=tuple(s.name for s in system.inputs), meaning="last valid input"))
    if any(piece.uses_output for piece in pieces):
        zeros, names = (0.0,) * len(system.outputs), tuple(s.name for s in system.outputs)
        fields.append(Field("y", zeros, labels=names, meaning="last valid sample"))
        fields.append(Field("y_valid", zeros, labels=names, meaning="1 where the last call had a valid sample"))
    return tuple(fields)


def _predict(observer: Observer, clock: Clock, pieces: tuple[Pieces, ...], keep: "_Keeper") -> Program:
    uses_output = any(piece.uses_output for piece in pieces)
    program: list[Statement] = [_guard_inputs(observer)] if clock.inputs else []
    if uses_output:
        program.append(_guard_outputs(observer, clock))
    calls = sym("state.calls")
    program.append(
        Block(
            "the first call advances no time",
            {"work.running": calls >= 1, "state.calls": ca.if_else(calls < 2, calls + 1, 2)},
        )
    )
    moves = _all(piece.predict for piece in pieces)
    outside = Block(
        "outside the declared box the model is evaluated at its edge",
        {"status.OUTSIDE_BOX": _outside(observer)},
    )
    program.append(When("work.running", (*moves, *keep(moves), outside)))
    if clock.inputs:
        program.append(Block("remember the input", {"state.u": sym("work.u", clock.inputs)}))
    if uses_output:
        remembered = {"state.y": sym("work.y", clock.outputs), "state.y_valid": clock.valid}
        program.append(Block("remember the sample", remembered))
    return tuple(program)


def _outside(observer: Observer) -> Any:
    z = observer.z
    tests = [ca.logic_or(z[i] < low, z[i] > high) for i, (low, high) in enumerate(observer.dynamics.box) if low > -INF]
    return _any(tests)


def _any(tests: Iterable[Any]) -> Any:
    """Whether one of the truth values holds; 0 for none."""
    tests = list(tests)
    return reduce(ca.logic_or, tests) if tests else ca.SX(0)


def _within(value: Any, limit: float) -> Any:
    """|value| <= limit; 0 for what is not a number."""
    return ca.fabs(value) <= limit


def _guard_inputs(observer: Observer) -> Block:
    """Each input: the last valid one where it is no number or absurd, clamped to its range."""
    values, writes = [], {}
    last = sym("state.u", len(observer.form.system.inputs))
    for i, signal in enumerate(observer.form.system.inputs):
        raw, (low, high) = sym(f"input.{signal.name}"), signal.interval
        usable = _within(raw, HUGE)
        taken = ca.if_else(usable, raw, last[i])
        clamped = ca.fmin(ca.fmax(taken, low), high) if signal.bounded else taken
        values.append(clamped)
        writes[f"status.REUSED_{signal.name}"] = ca.logic_not(usable)
        if signal.bounded:
            writes[f"status.CLAMPED_{signal.name}"] = taken != clamped
    return Block("guard the input", {"work.u": column(values), **writes})


def _judged(signal: Signal, raw: Any, error: Any) -> tuple[Any, dict[str, Any]]:
    """(whether a sample can be used, its status writes): a number, plausible, and not absurdly far from the
    prediction."""
    low, high = signal.interval
    width = high - low
    number = _within(raw, LARGEST_NUMBER)
    if signal.bounded:
        plausible = ca.logic_and(raw >= low - width, raw <= high + width)
    else:
        plausible = _within(raw, HUGE)
    valid = ca.logic_and(number, ca.logic_and(plausible, _within(error, 10 * HUGE)))
    rejected = ca.logic_and(number, ca.logic_not(valid))
    return valid, {
        f"status.MISSING_{signal.name}": ca.logic_not(number),
        f"status.REJECTED_{signal.name}": rejected,
    }


def _measure(observer: Observer, clock: Clock, j: int) -> Block:
    """The sample of output j, its innovation, and whether it can be used."""
    signal = observer.form.system.outputs[j]
    raw = sym(f"output.{signal.name}")
    u = sym("state.u", clock.inputs) if clock.inputs else ca.SX(0, 1)
    error = raw - observer.dynamics.output(observer.z, u)[j]
    valid, status = _judged(signal, raw, error)
    return Block(f"guard the sample of {signal}", {"work.sample": raw, "work.e": error, "work.valid": valid, **status})


def _guard_outputs(observer: Observer, clock: Clock) -> Block:
    """All samples at once for a part that integrates with the measurement: y now, y at the last call, valid."""
    u = sym("state.u", clock.inputs) if clock.inputs else ca.SX(0, 1)
    predicted = observer.dynamics.output(observer.z, u)
    last, had = sym("state.y", clock.outputs), sym("state.y_valid", clock.outputs)
    now, before, valid, status = [], [], [], {}
    for j, signal in enumerate(observer.form.system.outputs):
        raw = sym(f"output.{signal.name}")
        usable, bits = _judged(signal, raw, raw - predicted[j])
        now.append(ca.if_else(usable, raw, predicted[j]))
        before.append(ca.if_else(ca.logic_and(usable, had[j]), last[j], now[-1]))
        valid.append(usable)
        status.update(bits)
    return Block(
        "guard the samples",
        {"work.y": column(now), "work.y_last": column(before), "work.valid": column(valid), **status},
    )


@dataclass(frozen=True)
class _Keeper:
    """Keeps what a program wrote to the state in its box; restarts a value that is lost."""

    state: tuple[Field, ...]

    def __call__(self, program: Program) -> Program:
        written = {place for place, _ in _written(program)}
        fields = [f for f in self.state if f"state.{f.name}" in written and f.kind == "real"]
        return tuple(_kept(field) for field in fields)


def _written(program: Program) -> set[tuple[str, int]]:
    return {(place, 0) for s in walk(program) if isinstance(s, Block) for place in s.writes}


def _kept(field: Field) -> Block:
    value = sym(f"state.{field.name}", field.size)
    limit = HUGE * HUGE
    kept, usable, limited = [], [], []
    for i, (low, high) in enumerate(field.box):
        usable.append(_within(value[i], limit))
        clamped = ca.fmin(ca.fmax(value[i], max(low, -limit)), min(high, limit))
        kept.append(ca.if_else(usable[-1], clamped, field.initial[i]))
        limited.append(value[i] != kept[i])
    writes = {f"state.{field.name}": column(kept)}
    if field.name == "z":
        writes["status.STATE_LIMITED"] = _any(limited)
    writes["status.RESTARTED"] = ca.logic_not(reduce(ca.logic_and, usable))
    return Block(f"keep {field.name} in its box", writes)


def _tune(plant: tuple[Field, ...], gains: tuple[Field, ...], derived: Program) -> Program:
    """Each parameter in its range, its nominal value where it is no number; then the derived gains."""
    blocks = []
    for kind, fields in (("plant", plant), ("gain", gains)):
        for field in fields:
            value = sym(f"{kind}.{field.name}", field.size)
            kept, changed = [], []
            for i, (low, high) in enumerate(field.box):
                clamped = ca.fmin(ca.fmax(value[i], low), high)
                kept.append(ca.if_else(_within(value[i], LARGEST_NUMBER), clamped, field.initial[i]))
                changed.append(ca.logic_not(value[i] == kept[i]))
            writes = {f"{kind}.{field.name}": column(kept), "status.PARAMETER_LIMITED": _any(changed)}
            blocks.append(Block(f"{field.name} in its range", writes))
    return (*blocks, *derived)


def _estimate(observer: Observer) -> Program:
    values = observer.dynamics.estimate(observer.z)
    writes = {f"estimate.{s.name}": values[i] for i, (s, _) in enumerate(observer.form.estimates)}
    return (Block("the plant's state", writes),)


_SIGNAL_BITS: dict[str, tuple[str, str]] = {
    "MISSING": ("{} is not a number: predicted only", "none; watch for a sensor that stays silent"),
    "REJECTED": ("{} is implausible: predicted only", "check the sensor and the declared range"),
    "REUSED": ("{} is not a number or absurd: the last valid one was used", "check the source of the input"),
    "CLAMPED": (
        "{} was clamped to its range",
        "the proofs hold on the range only; widen it or limit the input",
    ),
}
_STEP_BITS: dict[str, tuple[str, str]] = {
    "OUTSIDE_BOX": (
        "the estimate is outside the declared box, where the model is evaluated at the edge",
        "normal while the estimate peaks; if it stays, the declared ranges are too narrow",
    ),
    "STATE_LIMITED": (
        "the estimate was projected to its outer box; the convergence theorem is suspended",
        "none if brief; if it stays, lower theta or widen the ranges",
    ),
    "RESTARTED": (
        "a value was lost (not a number) and restarted",
        "treat the estimate as new; check parameters and ranges",
    ),
    "PARAMETER_LIMITED": (
        "a parameter was out of its range and was limited",
        "correct the parameter and tune again",
    ),
}


def _bits(step: Step, extra: tuple[Bit, ...]) -> tuple[Bit, ...]:
    """The status bits that some block raises, in a fixed order."""
    raised = {place.split(".", 1)[1] for place, _ in places((*step.program, *step.tuning)) if scope(place) == "status"}
    bits = []
    for signals, kinds in ((step.outputs, ("MISSING", "REJECTED")), (step.inputs, ("REUSED", "CLAMPED"))):
        for signal in signals:
            for kind in kinds:
                meaning, action = _SIGNAL_BITS[kind]
                bits.append(Bit(f"{kind}_{signal.name}", meaning.format(signal.name), action))
    bits += [Bit(name, *texts) for name, texts in _STEP_BITS.items()] + list(extra)
    return tuple(bit for bit in dict.fromkeys(bits) if bit.name in raised)
