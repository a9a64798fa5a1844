"""The prediction over a time that varies from call to call, in at most K equal sub-steps.

With the time t since the last call, dt the longest step and K the number of sub-steps:

    t = 0                   no prediction, the samples correct the state, which is kept in its box
    t < 0 or not a number   as 0, and the status bit DT_REFUSED
    0 < t <= K dt           n steps of the length t/n, n the smallest whole number with n dt >= t
    t > K dt                K steps of the length dt, and the status bit DT_LIMITED: the estimate lags by t - K dt

An input that is taken to vary on a line between two calls does so from sub-step to sub-step, and so does a sample that
is integrated. A time of the plant's equations goes on by all of t, at first by what the sub-steps do not reach. The
first call advances no time, whatever t it is given.
"""

from collections.abc import Iterable

import casadi as ca

from hgogen.graph import Graph
from hgogen.part import Clock, on_line
from hgogen.program import Bit, Block, Field, Place, Program, Repeat, When, column, scalar, sym
from hgogen.signal import Signal, Time, pace
from hgogen.stepping import times

ELAPSED = "dt"  # the name of the argument
_STEP, _COUNT, _MORE, _PASSED, _LAGS = (
    Place("work", name) for name in ("substep", "substeps", "more", "passed", "lags")
)


def elapsed_signal(clock: Clock, time: str) -> tuple[Signal, ...]:
    """Return the signal of the time since the last call, in the unit `time`; none where dt is a constant."""
    if not clock.varying:
        return ()
    most = clock.longest * clock.varying.substeps
    return (Signal(ELAPSED, time, "time since the last call", low=0.0, high=most),)


def elapsed_fields(clock: Clock, time: str) -> tuple[Field, ...]:
    """Return the state's field of the time that the last call has predicted; none where dt is a constant."""
    signals = elapsed_signal(clock, time)
    return tuple(
        scalar("elapsed", 0.0, low=0.0, high=each.interval[1], unit=time, meaning="time that the last call predicted")
        for each in signals
    )


def elapsed_bits(clock: Clock, time: str) -> tuple[Bit, ...]:
    """Return the status bits of the time since the last call; none where dt is a constant."""
    if not clock.varying:
        return ()
    most = pace(clock.longest * clock.varying.substeps, time)
    lags = f"the time since the last call was longer than {most}: the prediction stopped there, and the estimate lags"
    return (
        Bit(
            "DT_REFUSED",
            "the time since the last call was negative or not a number: no prediction, as for 0",
            "check the source of the time stamps",
        ),
        Bit(
            "DT_LIMITED",
            f"{lags} by {ELAPSED} - {most}",
            "none if the plant was at rest; else allow more substeps, or reset after such a pause",
        ),
    )


def since_last_call(clock: Clock, plant_times: tuple[Time, ...]) -> Program:
    """Return the statements that read the time since the last call, and compute the number and the length of
    sub-steps."""
    assert clock.varying
    running, raw, most = sym("work", "running"), sym("input", ELAPSED), clock.varying.substeps
    ends = [k * clock.longest for k in range(1, most + 1)]
    accepted = ca.if_else(ca.logic_and(running, raw > 0), ca.fmin(raw, ends[-1]), 0)
    count = sum((accepted > end for end in ends[:-1]), ca.SX(1))
    known = Block(
        "the time since the last call, in equal steps",
        {
            Place("state", "elapsed"): accepted,
            _COUNT: ca.if_else(accepted > 0, count, 0),
            Place("work", "h"): accepted / count,
            Place("status", "DT_REFUSED"): ca.logic_and(running, ca.logic_not(raw >= 0)),
            Place("status", "DT_LIMITED"): ca.logic_and(running, raw > ends[-1]),
        },
        {"accepted": accepted},
    )
    if not plant_times:
        return (known,)
    lags = Block("does the estimate lag?", {_LAGS: ca.logic_and(running, raw > ends[-1])})
    unreached = ca.fmin(raw, times.LARGEST * clock.longest) - ends[-1]
    return (known, lags, When(_LAGS, (times.advance_by(plant_times, clock, unreached),)))


def in_substeps(
    predict: Program, clock: Clock, plant_times: tuple[Time, ...], uses_output: bool, keep: Program
) -> Program:
    """Return the program that runs `predict`, the prediction over one step, for each sub-step of a call, or `keep`,
    which clamps the state to its box, if no time has passed. `uses_output`: whether `predict` integrates with the
    sample; `plant_times`: the last inputs, the times in the plant's equations."""
    assert clock.varying
    pairs = []
    if clock.inputs and (clock.between == "line" or plant_times):
        pairs.append((Place("state", "u"), Place("work", "u"), clock.inputs, clock.turns))
    if uses_output:
        pairs.append((Place("work", "y_last"), Place("work", "y"), clock.outputs, ()))
    left = sym(*_COUNT) - sym(*_STEP)
    ends, advanced, begins = {}, {}, {}
    for last, now, size, turns in pairs:
        end = Place("work", f"{now.name}_end")
        ends[end], begins[last] = sym(*now, size), sym(*now, size)
        advanced[now] = ca.if_else(
            left <= 1, sym(*end, size), on_line(1 / left, sym(*last, size), sym(*end, size), turns)
        )
    if plant_times:
        u = Place("work", "u")
        course = advanced[u] if clock.between == "line" else sym(*u, clock.inputs)
        known = list[Graph](ca.vertsplit(course))[: -len(plant_times)]
        advanced[u] = column([*known, *times.current_times(plant_times, clock)])
    step: Program = (
        *((times.advance_by(plant_times, clock, sym("work", "h")),) if plant_times else ()),
        *_named("the signals at the end of the sub-step", advanced),
        *predict,
        *_named("the next sub-step begins where this one ends", begins),
    )
    numbers = tuple(float(k) for k in range(clock.varying.substeps))
    more = Block("is there one more sub-step?", {_MORE: sym(*_STEP) < sym(*_COUNT)})
    repeated = Repeat({_STEP: numbers}, (more, When(_MORE, step)))
    steps: Program = (*_named("the signals at the end of the call", ends), repeated)
    return (Block("has time passed?", {_PASSED: sym(*_COUNT) > 0}), When(_PASSED, steps, keep))


def _named(title: str, writes: dict[Place, Graph]) -> Iterable[Block]:
    return (Block(title, writes),) if writes else ()
