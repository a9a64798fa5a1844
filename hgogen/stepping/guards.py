"""Guards: no input, sample or parameter, however absurd, makes the state infinite or not a number.

A number of plausible size is accepted and clamped to its declared range. The state after a step is clamped to its box.
Each guard reports its action in the status. This module also defines the order of the bits in the status word.

Memory has a mark: a number that init and reset write to a state, and init to parameters, and that other memory is
unlikely to contain. Every public function tests it first. Memory without the mark (zeros, old stack contents, memory of
another program) is not used, and the status reports it: a state is reset; without valid parameters no sample is
accepted, and the state is reset. The number has 16 bits, which fit into the smallest `unsigned` of C, and two different
bytes other than 0x00 and 0xFF, so that memory filled with one byte has no mark. It is computed from a digest of the
program (`hgogen.emit.saved`): two programs have the same mark in one of 64262 cases.
"""

from collections import Counter
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import partial, reduce
from itertools import compress

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import HUGE, at_nearest_turn, inside, into_range, last_value, widened
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.graph import Graph, binary, dense, is_outside
from hgogen.observer import Observer
from hgogen.part import Clock
from hgogen.program import (
    INF,
    Bit,
    Block,
    Field,
    Kernel,
    Limit,
    Place,
    Program,
    When,
    address,
    column,
    scalar,
    stacked,
    sym,
    walk,
)
from hgogen.rigor.bounds import enclose
from hgogen.rigor.box import box
from hgogen.signal import LOST, TURNS, Signal
from hgogen.stepping import times

LARGEST_NUMBER = 3e38  # every finite float is within; what is not counts as "not a number"

STRUCTS = ("state", "input", "output", "plant", "gain", "derived", "work")  # others are members of groups
# fields of the state that remember signals and what a call made of them, not estimates
SIGNALS = ("u", "y", "y_valid", "innovation_e", "innovation_S", times.COUNT.name, times.REMAINDER.name)

SIGNAL_BITS: dict[str, tuple[str, str]] = {
    "MISSING": ("{} is not finite: predicted only", "none; watch for a sensor that stays silent"),
    "REJECTED": ("{} is implausible, {beyond}: predicted only", "check the sensor and the declared range"),
    "LATE": (
        "the sample of {} was taken in a period before this one: not used",
        "none if rare; a sensor that is always late is one for hg.delayed",
    ),
    "EARLY": (
        "the sample of {} is of a period to come, or comes before the first predict: not used",
        "call predict first; check the count of periods",
    ),
    "UNDATED": (
        "the age of the sample of {} is no whole number of periods, 0 or more: not used",
        "round the age to whole periods, 0 for a sample of now",
    ),
    "REPEATED": ("a second sample of {} in one period: not used", "give each sample once"),
    "REUSED": (
        "{} is not finite or absurd ({beyond}): the last valid one was used",
        "check the source of the input",
    ),
    "UNDEFINED": (
        "{} has no finite value at the estimate, or one beyond its range, or derivatives that are not finite: the "
        "sample was not used",
        "none if brief; if it stays, the region of operation is singular for this output",
    ),
    "HELD": (
        "the rate of {} has no finite value here, or one beyond its range: the last one was used; or one of its "
        "derivatives has none: 0 was used",
        "none if brief; if it stays, the estimate is driven by an old rate",
    ),
    "CLAMPED": ("{} was clamped to its range", "the proofs hold on the range only; widen it or limit the input"),
}
OR_LOWER = "{or_lower}"  # the place of `or_lower` in the advice of a bit
STEP_BITS: dict[str, tuple[str, str]] = {
    "OUTSIDE_BOX": (
        "the estimate, or a state of the plant before it is clamped to its range, is outside the declared ranges, "
        "where the model is evaluated at the edge",
        "normal while the estimate peaks, do not act on it then; if it stays, the declared ranges are too narrow",
    ),
    "SINGULAR": (
        "the outputs and their derivatives do not tell the state here: no correction, or no inverse",
        "none if brief; if it stays, the inputs or the region of operation hide the state",
    ),
    "STATE_LIMITED": (
        "the estimate was projected to its outer box; the convergence theorem, where it applies, is suspended",
        f"none if brief; if it stays, widen the ranges{OR_LOWER}",
    ),
    "RESTARTED": (
        "a value was lost (not finite, or beyond 1e30): all of the state restarted but the last input and samples, and "
        "the counters of calls",
        "treat the estimate as new; check parameters (tune was called?) and ranges",
    ),
    "RESTARTED_FROM_SAMPLE": (
        "good samples did not bring the estimate back, and the observer restarted from the sample",
        f"treat the estimate as new; if it comes again without a fault, widen the ranges{OR_LOWER} or check the model",
    ),
    "PROJECTED_ONTO_RANGES": (
        "the estimate was outside the declared ranges for long, and was projected onto them",
        f"none if rare; if it comes again without a fault, widen the ranges{OR_LOWER} or check the model",
    ),
    "TIME_LOST": (
        "the count of the time was no whole number of its range, as after a time that was not finite or too long for "
        "its precision: it began anew at 0",
        "set the time, and give a float a time in the first turns of its period",
    ),
    "OUT_OF_ORDER": (
        "an update was called again, or before the first predict, without a predict since: no second correction",
        "call predict once a period, then each update at most once",
    ),
    "ADAPTED": ("adapt was called again in one period: nothing done", "call it once, after the updates"),
    "PARAMETER_LIMITED": (
        "tune only: a parameter was out of its range and was limited, or not finite and took its nominal value",
        "correct the parameter and tune again",
    ),
}


def or_lower(observer: Observer) -> str:
    """Return the advice " or lower theta" against peaking; "" without a high gain, or if a proof would be lost."""
    if any(check.id.fact == "theta" and check.verdict is Verdict.PROVED for check in observer.checks):
        return ""
    high = (gain.name for gain in observer.gains if gain.name in ("theta", "theta_1") and gain.initial[0] > 1)
    return "".join(f" or lower {name}" for name in high)


def outside(observer: Observer, margin: float = 0.0) -> Graph:
    """Return whether the estimate z, or the plant's state computed from z, is outside its declared range by more than
    `margin` times its width, where the model is evaluated at the edge of the range; SX."""
    z, dynamics = observer.z, observer.dynamics
    ends = [widened(*end, margin) for end in dynamics.box]
    tests = [is_outside(z[i], *end) for i, end in enumerate(ends) if end[0] > -INF]
    return any_of(tests + dynamics.beyond(z, sym("state", "u", len(observer.form.system.inputs)), margin))


def outside_bit(observer: Observer) -> Block:
    """Return the block that raises the status bit OUTSIDE_BOX for an estimate outside its declared range."""
    bit = {Place("status", "OUTSIDE_BOX"): outside(observer)}
    return Block("outside the declared box the model is evaluated at its edge", bit)


def report_unrecovered(observer: Observer) -> tuple[Block, ...]:
    """Return the block that raises the status bit SINGULAR if the plant's state cannot be computed from z; () if it
    always can."""
    form = observer.form
    if form.behind is None or observer.dynamics.recoverable:
        return ()
    _, usable = observer.dynamics.recovered(observer.z, sym("state", "u", len(form.system.inputs)))
    return (
        Block(
            "where the inverse has no value, each state is told at its nominal value, else 0",
            {Place("status", "SINGULAR"): ca.logic_not(usable)},
        ),
    )


def any_of(tests: Iterable[Graph]) -> Graph:
    """Return whether one of the SX truth values holds; 0 for none."""
    tests = list(tests)
    return reduce(partial(binary, ca.OP_OR), tests) if tests else ca.SX(0)


def _within(value: Graph, limit: float) -> Graph:
    return ca.fabs(value) <= limit


def guard_inputs(observer: Observer, clock: Clock) -> Block:
    """Return the block that clamps each input to its range; a value that is not a number, or absurdly large, is
    replaced by the last valid one. Inputs that are times come from the step's own counts."""
    values, writes, names = [], {}, dict[str, Graph]()
    plant = observer.form.system
    last = sym("state", "u", len(plant.inputs))
    for i, signal in enumerate(plant.supplied):
        raw, (low, high) = sym("input", signal.name), signal.limits
        usable = _within(raw, HUGE if signal.period is None else TURNS * signal.period)
        accepted = ca.if_else(usable, raw, last[i])
        values.append(into_range(accepted, signal.interval, signal.period))
        writes[Place("status", f"REUSED_{signal.name}")] = ca.logic_not(usable)
        if low > -INF:
            writes[Place("status", f"CLAMPED_{signal.name}")] = is_outside(accepted, low, high)
        names |= {f"{signal.name}_usable": usable, f"{signal.name}_taken": accepted}
    values += times.current_times(plant.times, clock)
    return Block("guard the input", {Place("work", "u"): column(values), **writes}, names, part="guard_input")


def plausible(signal: Signal, reading: tuple[float, float], raw: Graph) -> Graph:
    """Return whether a sample is a number in the plausible range of its sensor."""
    low, high = plausible_range(signal, reading)
    return ca.logic_and(raw >= low, raw <= high) if high - low < INF else _within(raw, HUGE)


def plausible_range(signal: Signal, reading: tuple[float, float]) -> tuple[float, float]:
    """Return the range in which a sample is plausible: the range of its sensor widened by its width at both ends, or by
    `TURNS` turns for an angle, in the six digits of a status text."""
    low, high = widened(*reading, 1 if signal.period is None else TURNS)
    return float(f"{low:g}"), float(f"{high:g}")


def implausible(signal: Signal, reading: tuple[float, float], form: Form) -> str:
    """Return the text of a status bit that says which samples of an output are implausible; `reading`: the range of the
    sensor."""
    low, high = plausible_range(signal, reading)
    place = f"outside {low:g} .. {high:g}" if high - low < INF else f"beyond {HUGE:g}"
    bounded = high - low < INF and all(state.bounded for state in form.states)
    return place if bounded else f"{place}, or {10 * HUGE:g} off its estimate"


def _judged(signal: Signal, reading: tuple[float, float], raw: Graph, error: Graph) -> tuple[Graph, dict[Place, Graph]]:
    """Return whether a sample `raw` is usable, and its status bits: a usable sample is a number,
    within the sensor's widened range, and its error y - yhat is not absurdly large."""
    number = _within(raw, LARGEST_NUMBER)
    valid = ca.logic_and(plausible(signal, reading, raw), _within(error, 10 * HUGE))
    rejected = ca.logic_and(number, ca.logic_not(valid))
    return valid, {
        Place("status", f"MISSING_{signal.name}"): ca.logic_not(number),
        Place("status", f"REJECTED_{signal.name}"): rejected,
    }


def readings(form: Form) -> list[tuple[float, float]]:
    """Return the range of each sensor: the declared range of its output, or the range that follows from those of
    states, inputs and parameters."""
    signals = box((*form.states, *form.system.inputs, *form.system.parameters))
    signals |= {p: (Fraction(str(p.nominal)),) * 2 for p in form.system.parameters if not p.bounded}
    computed = [enclose(expression, signals) for expression in form.output]
    return [
        signal.interval if signal.bounded else (float(low), float(high))
        for signal, (low, high) in zip(form.system.outputs, computed, strict=True)
    ]


def store_finite_values(observer: Observer, clock: Clock) -> Program:
    """Return the block that stores, at the start of a call, the latest finite values of those rates and outputs that
    may have none. It raises the status bit of a rate without a finite value at the start, middle or end of the input's
    change."""
    dynamics, z = observer.dynamics, observer.z
    named = dynamics.fallback
    writes, bits = {}, {}
    on_the_way = [dynamics.rates_valid(z, clock.u(c)) for c in (0.0, 0.5, 1.0)]
    for i, (value, accepted) in on_the_way[0].items():
        place = last_value(named.rates[i])
        writes[address(place)[0]] = ca.if_else(accepted, value, place)
        bits[_bit(observer, i)] = any_of(ca.logic_not(each[i][1]) for each in on_the_way)
    for j, (value, accepted) in dynamics.outputs_valid(z, clock.u(0.0)).items():
        place = last_value(named.outputs[j])
        writes[address(place)[0]] = ca.if_else(accepted, value, place)
    return (Block("remember what has a finite value", writes | bits),) if writes else ()


def undefined_rates(observer: Observer, clock: Clock) -> Program:
    """Return the block that raises status bits for rates without a finite value or derivative at the end of a call."""
    accepted = observer.dynamics.rate_slopes_valid(observer.z, clock.u(1.0))
    bits = {_bit(observer, i): ca.logic_not(each) for i, each in accepted.items()}
    return (Block("has each rate a finite value now?", bits),) if bits else ()


def _bit(observer: Observer, i: int) -> Place:
    return Place("status", f"HELD_{observer.dynamics.fallback.rates[i].name}")


def finite_value_fields(observer: Observer) -> tuple[Field, ...]:
    """Return the state's fields that store the latest finite value, initially 0, of each rate and output that may have
    none."""
    holding = observer.dynamics.fallback
    meanings = {s.name: f"last finite value of b in {s.name}' = A z + b" for s in holding.rates.values()}
    meanings |= {y.name: f"last finite value of {y.name} at the estimate" for y in holding.outputs.values()}
    return tuple(
        scalar(f"last_{name}", 0.0, low=-HUGE, high=HUGE, meaning=meaning) for name, meaning in meanings.items()
    )


def sample(observer: Observer, u: Graph, j: int) -> tuple[Graph, dict[Place, Graph]]:
    """Return the measurement of output j, nan if the output function has no finite value at the estimate, and the
    status bits for an output that may have none."""
    name = observer.form.system.outputs[j].name
    raw, readable = sym("output", name), observer.dynamics.output_slopes_valid(observer.z, u)
    if j not in readable:
        return raw, {}
    bits = {"MISSING": _within(raw, LARGEST_NUMBER), "UNDEFINED": readable[j]}
    named = {Place("status", f"{kind}_{name}"): ca.logic_not(good) for kind, good in bits.items()}
    return ca.if_else(readable[j], raw, ca.SX.nan()), named


def innovation(observer: Observer, clock: Clock, j: int, y: Graph) -> Graph:
    """Return y - yhat of a sample `y` of output j, SX."""
    return observer.dynamics.output_error(j, y, observer.dynamics.output(observer.z, clock.u_now)[j])


def measure(observer: Observer, clock: Clock, j: int) -> Program:
    """Return the blocks that read output j, compute its innovation y - yhat, and test whether the sample is usable."""
    signal = observer.form.system.outputs[j]
    accepted, undefined_bits = sample(observer, clock.u_now, j)
    measurement = Block(f"the measurement of {signal}", {Place("work", "reading"): accepted})
    raw = sym("work", "reading")
    error = innovation(observer, clock, j, raw)
    valid, status = _judged(signal, readings(observer.form)[j], raw, error)
    status |= undefined_bits
    values = {Place("work", "e"): error, Place("work", "output_error"): error, Place("work", "valid"): valid}
    return (measurement, Block(f"guard the measurement of {signal}", {**values, **status}, part="guard_measurement"))


def guard_innovations(observer: Observer, clock: Clock, gated: Collection[int]) -> Program:
    """Return the blocks that compute the innovations of all outputs in `gated`, and which of their samples are usable,
    before any of them corrects."""
    predicted, readings_now = observer.dynamics.output(observer.z, clock.u_now), ca.SX.zeros(clock.outputs)
    errors, usable = ca.SX.zeros(clock.outputs), ca.SX.zeros(clock.outputs)
    raw = sym("work", "readings", clock.outputs)
    for j in gated:
        signal, (readings_now[j], _) = observer.form.system.outputs[j], sample(observer, clock.u_now, j)
        errors[j] = observer.dynamics.output_error(j, raw[j], predicted[j])
        usable[j], _ = _judged(signal, readings(observer.form)[j], raw[j], errors[j])
    writes = {Place("work", "prediction_errors"): errors, Place("work", "usable"): usable}
    return (
        Block("the measurements that have a gate", {Place("work", "readings"): readings_now}),
        Block("their errors before any of them is used", writes),
    )


def guard_outputs(observer: Observer, clock: Clock) -> Block:
    """Return the block that tests all samples for a part that integrates with the measurement, with the work values y
    now, y at the last call, and valid."""
    predicted, sensors = observer.dynamics.output(observer.z, sym("state", "u", clock.inputs)), readings(observer.form)
    last, known = sym("state", "y", clock.outputs), sym("state", "y_valid", clock.outputs) > 0
    now, before, valid, status = [], [], [], {}
    for j, signal in enumerate(observer.form.system.outputs):
        raw, undefined_bits = sample(observer, sym("state", "u", clock.inputs), j)
        error = observer.dynamics.output_error(j, raw, predicted[j])
        usable, bits = _judged(signal, sensors[j], raw, error)
        bits |= undefined_bits
        last_valid = ca.logic_and(known[j], plausible(signal, sensors[j], last[j]))  # memory may be corrupted
        # next to the prediction, whose error is below half a turn, however fast the plant turns
        last_near = at_nearest_turn(signal, last[j], predicted[j])
        previous = ca.if_else(last_valid, last_near, predicted[j])
        now.append(ca.if_else(usable, at_nearest_turn(signal, raw, previous), predicted[j]))
        before.append(ca.if_else(ca.logic_and(usable, last_valid), last_near, now[-1]))
        valid.append(usable)
        status.update(bits)
    return Block(
        "guard the measurements",
        {
            Place("work", "y"): column(now),
            Place("work", "y_last"): column(before),
            Place("work", "valid"): column(valid),
            **status,
        },
        part="guard_measurements",
    )


def guard_state(
    program: Program, state: tuple[Field, ...], others: Program = (), before: Program = (), keep: Program = ()
) -> Program:
    """Return the program that clamps the fields of `state` that `program` has written to their boxes.

    If a value is lost (not a number, or beyond `LOST`), all fields are reset, by the program `others` those that
    `others` writes. Values inside their boxes, the usual case, cost one test. `before`: a program with such a clamp
    earlier in this call, so that its unchanged values are not tested again. `keep`: a call that replaces the inline
    program `clamp_fields`.
    """
    fields = written_fields(program, state)
    if not fields:
        return ()
    written, earlier = _written(program), _written(before)
    values = stacked(fields)
    places = [(Place("state", field.name), field.size) for field in fields]
    tested = [k in written[place] or place not in earlier for place, size in places for k in range(size)]
    ends = [end for f in fields for end in f.box_within(LOST)]
    usual = inside(values[[k for k, ask in enumerate(tested) if ask]], [*compress(ends, tested)])
    writes = {Place("work", "beyond"): ca.logic_not(usual)}
    beyond = Block("is a value beyond its box, or lost?", writes, part="beyond_box")
    return (beyond, When(Place("work", "beyond"), keep or clamp_fields(fields, state, others), idle=True))


def written_fields(program: Program, state: tuple[Field, ...]) -> list[Field]:
    """Return the fields of real numbers of the `state` that a program writes; guards clamp these to their boxes."""
    written = _written(program)
    return [f for f in state if Place("state", f.name) in written and f.kind == "real"]


def clamp_fields(fields: list[Field], state: tuple[Field, ...], others: Program = (), each: bool = False) -> Program:
    """Return the program that clamps `fields` to their boxes. If a value is lost (not a number, or beyond `LOST`), it
    resets the whole `state`, by the program `others` for the fields that `others` writes. `each`: each value is tested
    again for being lost, because a static analyser cannot infer this from a loop over many."""
    values = stacked(fields)
    usable = inside(values, [(-LOST, LOST)] * values.numel())
    lost = Block("is a value lost?", {Place("work", "lost"): ca.logic_not(usable)}, part="value_lost")
    real = {Place("state", f.name): column(f.initial) for f in state if f.kind == "real" and f.name not in SIGNALS}
    by_others = _written(others)
    fresh = {place: value for place, value in real.items() if place not in by_others}
    restart = Block(
        "a value is lost: restart all but the last signals and the calls",
        {**fresh, Place("status", "RESTARTED"): ca.SX(1)},
    )
    return (lost, When(Place("work", "lost"), (restart, *others)), *(clamp_field(field, each) for field in fields))


def _written(program: Program) -> dict[Place, set[int]]:
    changed: dict[Place, set[int]] = {}
    blocks = [statement for statement in walk(program) if isinstance(statement, Block)]
    for block, place, size in ((s, *item) for s in blocks for item in s.written if item[0].struct == "state"):
        values, symbols = dense(block.writes[place]).nonzeros(), sym(*place, size).nonzeros()
        elements = {k for k in range(size) if values[k].element_hash() != symbols[k].element_hash()}
        sources = block.copies.get(place, (place,))
        if elements and any(source.struct in STRUCTS for source in sources):  # else values of a member, in its box
            changed.setdefault(place, set()).update(elements)
    for kernel in (s for s in walk(program) if isinstance(s, Kernel)):
        for place, size in kernel.arguments:
            changed.get(place, set()).update(range(size))
    return changed


def clamp_field(field: Field, each: bool) -> Block:
    """Return the block that clamps a field of the state to its box, and raises STATE_LIMITED if the box is the outer
    box of an estimate. `each`: whether an element that is lost (not a number, or beyond `LOST`) gets its initial
    value."""
    value, ends = sym("state", field.name, field.size), field.box_within(LOST)
    values = [into_range(value[i], end, period) for i, (end, period) in enumerate(zip(ends, field.turns, strict=True))]
    if each:
        values = [ca.if_else(_within(value[i], LOST), v, field.initial[i]) for i, v in enumerate(values)]
    writes = {Place("state", field.name): column(values)}
    if field.outer:
        limited = (i for i, period in enumerate(field.turns) if period is None)
        writes[Place("status", "STATE_LIMITED")] = any_of(is_outside(value[i], *ends[i]) for i in limited)
    return Block(f"keep {field.name} in its box", writes)


FEWEST = 3  # rows from which on a table is shorter than statements
LIMITED = Place("status", "PARAMETER_LIMITED")


def limit_parameters(plant: tuple[Field, ...], gains: tuple[Field, ...], derived: Program) -> Program:
    """Return the program that clamps parameters `plant` and `gains` to their ranges, then runs `derived`, which
    computes the derived gains."""
    limits = list[tuple[Field, list[Limit]]]()
    for kind, fields in (("plant", plant), ("gain", gains)):
        for field in fields:
            place, ends = Place(kind, field.name), zip(field.box, field.initial, strict=True)
            each = [Limit(place, k, field.size, *end, nominal) for k, (end, nominal) in enumerate(ends)]
            limits.append((field, each))
    every = [limit for _, each in limits for limit in each]
    if len(every) >= FEWEST and all(limit.low > -INF and limit.high < INF for limit in every):
        return (_block("each parameter in its range", every, rows=True), *derived)
    blocks = (_block(f"{field.name} in its range", each) for field, each in limits)
    return (*blocks, *derived)


def _block(title: str, limits: Iterable[Limit], rows: bool = False) -> Block:
    values = dict[Place, list[Graph]]()
    changed = []
    limits = tuple(limits)
    for limit in limits:
        value = sym(*limit.place, limit.size)[limit.index]
        clamped = ca.fmin(ca.fmax(value, limit.low), limit.high)
        accepted = ca.if_else(ca.fabs(value) <= LARGEST_NUMBER, clamped, limit.nominal)
        values.setdefault(limit.place, []).append(accepted)
        changed.append(ca.logic_not(ca.logic_and(value >= limit.low, value <= limit.high)))
    writes = {place: column(each) for place, each in values.items()}
    return Block(title, {**writes, LIMITED: any_of(changed)}, limits=limits if rows else ())


CERTAIN_BITS, DATED_BITS = ("MISSING", "REJECTED"), ("LATE", "EARLY", "REPEATED")  # of each output; of a dated one
OUTPUT_BITS = (*CERTAIN_BITS, "UNDEFINED", *DATED_BITS, "UNDATED")  # in the order of the word
RATE_BITS = ("HELD",)
INPUT_BITS = ("REUSED", "CLAMPED")
WIDTHS = (32, 64)  # bits of a status word
EXACT = 32  # bits in each real number that reports a status, of its 53


def word(bits: Sequence[Bit]) -> np.dtype:
    """Return numpy's unsigned type of the narrowest status word that holds these bits."""
    return np.dtype(f"u{next(size for size in WIDTHS if len(bits) <= size) // 8}")


def possible_bits(
    outputs: Iterable[Signal], inputs: Iterable[Signal], rates: Iterable[Signal], beyond: Mapping[Signal, str]
) -> list[Bit]:
    """Return the bits that a status may have, in the order of the word: for each output, each state in `rates` whose
    rate may have no finite value, each input, and the step; `beyond`: the text of when a sample of an output is
    implausible, or an input that is an angle is absurd."""
    bits = []
    for signals, kinds in ((outputs, OUTPUT_BITS), (rates, RATE_BITS), (inputs, INPUT_BITS)):
        for signal in signals:
            for kind in kinds:
                meaning, action = SIGNAL_BITS[kind]
                bits.append(
                    Bit(
                        f"{kind}_{signal.name}",
                        meaning.format(signal.name, beyond=beyond.get(signal, "beyond 1e15")),
                        action,
                    )
                )
    return bits + [Bit(name, meaning, action) for name, (meaning, action) in STEP_BITS.items()]


def certain_bits(outputs: Iterable[Signal], inputs: Iterable[Signal], dated: Container[str] = ()) -> list[str]:
    """Return the names of the status bits of every guarded step with these signals; `dated`: the names of the outputs
    whose samples have a time stamp."""
    of_outputs = [
        f"{kind}_{each}" for each in outputs for kind in (*CERTAIN_BITS, *(DATED_BITS if each.name in dated else ()))
    ]
    return of_outputs + [f"{kind}_{each.name}" for each in inputs for kind in INPUT_BITS[: 1 + (each.limits[0] > -INF)]]


def shortage(names: Sequence[str]) -> str:
    """Return the error message that a status has too few bits for `names`, with their number by kind and a remedy; ""
    if they fit."""
    most, kinds = WIDTHS[-1], (*OUTPUT_BITS, *RATE_BITS, *INPUT_BITS)
    if len(names) <= most:
        return ""
    counts = Counter(next((kind for kind in kinds if name.startswith(f"{kind}_")), "") for name in names)
    accepted = [f"{kind} for {counts[kind]} signals" for kind in kinds if counts[kind]]
    accepted += [f"{counts['']} for the whole step"] * bool(counts[""])
    return (
        f"has more than {most}: {', '.join(accepted)}; drop outputs, inputs or ranges of inputs, or take "
        'guards="none", which has no status'
    )


UNINITIALISED = Bit(
    "UNINITIALISED",
    "the state has no mark of init or reset, or that of another program: it was not used and began as before the first "
    "call",
    "call init once before all else; of a state that was restored, check what was saved",
)
NO_PARAMETERS = Bit(
    "NO_PARAMETERS",
    "the parameters have no mark of init or PARAMS_INIT, or that of another program: tune took the nominal values, any "
    "other call took no sample and left the state as before the first call",
    "call init once before all else, or begin constant parameters with PARAMS_INIT",
)
UNMADE = (UNINITIALISED, NO_PARAMETERS)  # bits that public functions raise, and no block
MARK = scalar("ready", 0, kind="index", meaning="mark that init and reset write; a state without it begins anew")
OF_PARAMETERS = "mark that init and PARAMS_INIT write; parameters without it are not used"
_LEAST, _MOST = 0x01, 0xFE  # of a byte


def mark_number(digest: bytes) -> int:
    """Return the 16-bit mark that init writes to the memory of the program with this digest."""
    high, low = _LEAST + digest[0] % (_MOST - _LEAST + 1), _LEAST + digest[1] % (_MOST - _LEAST)
    return (high << 8) + low + (low >= high)  # so that the bytes differ
