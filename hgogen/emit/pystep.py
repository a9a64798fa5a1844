"""A step as Python text, for single samples without a compiler, and the vectors recorded for the self-check.

The text is written and compiled once. It works on a record (`emit.layout`), as the C does, so the two can take turns on
one state; and it computes the same bits, by `emit.pygraph`. User-given names do not occur in it:

    D, I, B    the record as numbers, as counters, as bytes          V    numpy's views of places, for matrix kernels
    w, t       work values of a section, values of a block           m    number of the current member of a group

The self-check records an observer next to its plant, which is simulated inside its declared ranges, so that no clamp
hides an equation; its inputs are triangle waves. A missing, an infinite, an absurd, a lost and an excessive sample make
the guards run, and one is hardly plausible. Near the end the estimate is put out of its ranges, then far out, with
fault counts at their limits, so that the step recovers from both, and is lost at last. A step without guards gets none
of these, and its log ends where its estimate is lost. Late samples come with ages of every kind. No function of this
machine is used.

The tolerance is for other roundings, of libm or of contracted operations. Each changes a part of the operations by
about a rounding unit; going from float to double changes them all. So the tolerance is 16 times that distance, and in
double its share by rounding units.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import widened
from hgogen.discretisation.kernels import KERNELS
from hgogen.discretisation.runge_kutta import OpenLoop, open_loop
from hgogen.emit import layout, pygraph, saved
from hgogen.emit.code import indented
from hgogen.emit.node import Node, boolean
from hgogen.emit.printer import Operand
from hgogen.emit.statements import Kinds
from hgogen.emit.syntax import DTYPE, Number, Real
from hgogen.estimators.core import nominal, numbers
from hgogen.program import (
    Block,
    Call,
    Copy,
    Element,
    Group,
    Kernel,
    Loop,
    Place,
    Program,
    Reader,
    Section,
    When,
    address,
    places,
    walk,
)
from hgogen.signal import LOST, Signal, with_times
from hgogen.step import Step
from hgogen.stepping.guards import NO_PARAMETERS, UNINITIALISED, plausible_range, readings
from hgogen.stepping.recovery import MARGIN
from hgogen.stepping.reports import E
from hgogen.stepping.times import T

Entry = Callable[[], int]


def entries(step: Step, record: np.ndarray, real: Real) -> dict[str, Entry]:
    """Return Python functions of a step by name (`step`, `estimate`, `tune` and one for each section) with the results
    of the C, bit for bit. They change the `record` (1) of `kept_type` in place and return the status."""
    return _Writer(step, record, real).entries()


def tuned(step: Step, real: Real) -> np.ndarray:
    """Return a step's nominal parameters after `tune` as a record (1) of `params_type`, equal to those that `init`
    sets."""
    record = layout.initial_record(step, real)
    _Writer(step, record, real).tune()()
    return record["params"]


class _Writer(Reader[list[str]]):
    """A writer of a step's functions as Python text."""

    def __init__(self, step: Step, record: np.ndarray, real: Real) -> None:
        self.step, self.real, self.kinds, self.graphs = step, real, Kinds(step), pygraph.Writer(real)
        self.size = {"D": DTYPE[real]().itemsize, "I": 4}
        self.places = layout.places(step, record)
        self.parameters = record["params"].ctypes.data - record.ctypes.data
        self.groups = self.kinds.groups
        self.numbers = {name: number for number, name in enumerate(self.groups)}
        self.bits = {bit.place: 1 << k for k, bit in enumerate(step.layout.bits)}
        self.address = record.ctypes.data
        self.names = self.graphs.names
        self.number = "float" if real == "double" else "number"
        numbers = record.view(DTYPE[real])
        self.names |= {"D": numbers.data if real == "double" else numbers, "number": DTYPE[real]}
        self.names |= {"I": record.view(np.uint32).data}
        self.names |= {"B": record.view(np.uint8).data, "array": np.array, "V": list(self.places.values())}
        self.names |= {name: np.errstate(all="ignore")(kernel) for name, kernel in KERNELS.items()}
        self.work: dict[Place, int] = {}
        self.filled: set[Place] = set()
        self.sections: dict[str, int] = {}

    def tune(self) -> Entry:
        text = self._function("tune", self.step.code.tuning)
        pygraph.defined(text, self.names, "tune", "the tuning of a step in Python")
        tune: Entry = np.errstate(all="ignore")(self.names["tune"])
        return tune

    def entries(self) -> dict[str, Entry]:
        step, text = self.step, list[str]()
        last = self.names["D"].nbytes // self.size["D"] - len(step.traced)
        traces = (self._read(each.place, each.index, self.real) for each in step.traced)
        stores = [f"D[{last + k}] = {text}" for k, text in enumerate(traces)]
        reading = (*step.code.estimate, *(s for report in step.code.reports for s in report.program))
        estimate = self._function("shown", reading, stores)
        text += self._function("tune", step.code.tuning)
        for section in step.code.called:
            self.sections[section.name] = len(self.sections)
            text += self._function(self._called(section), section.program)
        calls = {each.name: [each] for each in (*step.code.sections, *step.code.timed, *step.code.time)}
        calls |= {"step": list(step.code.sections), "estimate": []}
        numbered = {name: f"entry{k}" for k, name in enumerate(calls)}
        for name, sections in calls.items():
            text += [f"def {numbered[name]}():", "    status = 0", *indented(self._ready() if sections else [])]
            text += [f"    status |= {self._called(section)}()" for section in sections]
            text += ["    shown()", "    return status"]
        pygraph.defined([*estimate, *text], self.names, "shown", "a step in Python")
        called = {name: self.names[local] for name, local in {"tune": "tune", **numbered}.items()}
        if self.real == "double":
            return called
        return {name: np.errstate(all="ignore")(call) for name, call in called.items()}  # numpy warns of overflow

    def _ready(self) -> list[str]:
        mark = self.step.layout.mark
        if not mark:
            return []
        self.names["fresh"] = fresh = layout.fresh(self.step, self.real)
        restart, ready = f"    B[:{len(fresh)}] = fresh", saved.mark(self.step, self.real)
        state, parameters = (f"I[{at // self.size['I']}]" for at in (0, self.parameters))
        unmade = [f"    status |= {self.bits[bit.place]}" for bit in (UNINITIALISED, NO_PARAMETERS)]
        return [
            *(f"if {state} != {ready}:", restart, unmade[0]),
            *(f"if {parameters} != {ready}:", restart, unmade[1], "    shown()", "    return status"),
        ]

    def _called(self, section: Section) -> str:
        return f"section{self.sections[section.name]}"

    def _function(self, name: str, program: Program, after: Sequence[str] = ()) -> list[str]:
        self.filled = {place for s in walk(program) if isinstance(s, Kernel) for place, _ in s.arguments}
        self.work = {place: k for k, (place, _) in enumerate(sorted(places(program))) if place.struct == "work"}
        start = ["status = 0"]
        for place, size in sorted(places(program)):
            if place in self.work and (size == 1 or place in self.filled):  # a kernel may be the first to write it
                elements = (self._local(place, element) for element in range(size))
                start.append(f"{' = '.join(elements)} = {'0' if self.kinds.is_index(place) else 'zero'}")
        return [f"def {name}():", *indented([*start, *self.program(program), *after, "return status"])]

    def joined(self, parts: Iterable[list[str]]) -> list[str]:
        return [line for part in parts for line in part]

    def _when(self, when: When) -> list[str]:
        lines = [f"if {self._read(when.flag, 0, 'double')}:", *indented(self.program(when.body) or ["pass"])]
        return [*lines, *(["else:", *indented(self.program(when.otherwise))] if when.otherwise else [])]

    def _call(self, call: Call) -> list[str]:
        return [f"status |= {self._called(call.section)}()"]

    # --- memory

    def _local(self, place: Place, element: int) -> str:
        return f"w{self.work[place]}_{element}"

    def _text(self, place: Place, element: int) -> str:
        if place in self.work:
            return self._local(place, element)
        array, line = self.places[place], self.groups.get(place.struct, ())
        kind = "I" if array.dtype == np.uint32 else "D"
        offset = (array.ctypes.data - self.address) // self.size[kind] + element
        steps = (
            f"{stride // self.size[kind]}*{self._at(group)}" for group, stride in zip(line, array.strides, strict=False)
        )
        return f"{kind}[{' + '.join((*steps, str(offset)))}]"

    def _at(self, group: Group) -> str:
        return f"m{self.numbers[group.name]}"

    def _read(self, place: Place, element: int, kind: Number) -> str:
        text = self._text(place, element)
        return f"{self.number}({text})" if self._converted(place, kind) else text

    def _converted(self, place: Place, kind: Number) -> bool:
        return kind != "unsigned" and self.kinds.is_index(place)

    def _member(self, index: Place, total: int) -> str:
        """Return the text of the index of a member of a group, 0 if the index is `total` or more, as in C."""
        number = self._read(index, 0, "unsigned")
        return f"int({number}) if {number} < {total} else 0"

    # --- statements

    def _loop(self, loop: Loop) -> list[str]:
        group = self.groups[loop.group][-1]
        number, member, total = self.numbers[group.name], self._at(group), group.count
        body = self.program(loop.body)
        if loop.index:
            body = [f"{self._text(loop.index, 0)} = {member}", *body]
        if loop.active:
            body = [f"if k{number} >= {self._read(loop.active, 0, 'unsigned')}:", "    break", *body]
        if loop.start is None:
            return [f"for k{number} in range({loop.count}):", *indented([f"{member} = k{number}", *body])]
        start = [f"n{number} = {self._member(loop.start, total)}"]
        wrapped = [f"{member} = (n{number} + k{number}) % {total}", *body]
        return [*start, f"for k{number} in range({loop.count}):", *indented(wrapped)]

    def _copy(self, copy: Copy) -> list[str]:
        line = self.groups[copy.group]
        arrays = [array for place, array in self.places.items() if place.struct == copy.group]
        stride = arrays[0].strides[len(line) - 1]
        first = min(array.ctypes.data for array in arrays) - self.address
        above = "".join(f" + {s}*{self._at(group)}" for group, s in zip(line[:-1], arrays[0].strides, strict=False))
        text = [
            f"{name} = {first} + {stride}*({self._member(place, line[-1].count)}){above}"
            for name, place in (("source", copy.source), ("target", copy.target))
        ]
        return [*text, f"B[target:target + {stride}] = bytes(B[source:source + {stride}])"]

    def _kernel(self, kernel: Kernel) -> list[str]:
        operands = [self._view(kernel.columns, 2)] if kernel.columns else []
        before, after = list[str](), list[str]()
        unpacked = ".tolist()" if self.real == "double" else ""
        for k, (place, size) in enumerate(kernel.arguments):
            if place in self.work:
                elements = [self._local(place, element) for element in range(size)]
                before.append(f"a{k} = array(({', '.join(elements)},), dtype={self.number})")
                after += [f"{', '.join(elements)} = a{k}{unpacked}"] if size > 1 else []
                operands.append(f"a{k}")
            else:
                operands.append(self._view(place, 1))
        call = f"{kernel.name}({', '.join([*operands, *map(str, kernel.counts)])})"
        return [*before, f"{self._text(kernel.result, 0)} = {call}" if kernel.result else call, *after]

    def _view(self, place: Place, dimensions: int) -> str:
        above = self.groups.get(place.struct, ())[: self.places[place].ndim - dimensions]
        return f"V[{list(self.places).index(place)}]{''.join(f'[{self._at(group)}]' for group in above)}"

    def _block(self, block: Block) -> list[str]:
        kind: Number = "unsigned" if self.kinds.counts(block) else self.real
        self.graphs.lines = lines = []

        def operand(argument: int, element: int) -> Operand:
            place, _ = block.reads[argument]
            local = place in self.work and place not in block.writes and not self._converted(place, kind)
            return Operand(self._read(place, element, kind), local=local)  # otherwise it is copied

        outputs = self.graphs.write(block.graph, operand, kind)
        for place, nodes in zip(block.writes, outputs, strict=False):
            for element, node in enumerate(nodes):
                lines += self._write(place, element, node, kind)
        return lines

    def _write(self, place: Place, element: int, node: Node, kind: Number) -> list[str]:
        if place.struct == "status":
            return [f"if {node.name}:", f"    status |= {self.bits[place]}"]
        value = self.graphs.number(node, kind)
        if place in self.kinds.flags:
            value = node.name if boolean(node) else f"{value} != 0"
        elif self._converted(place, kind):
            value = f"int({value})"
        return [f"{self._text(place, element)} = {value}"]


SAMPLES = 64
MISSING, INFINITE, ABSURD, UNDATED, LOST_INPUT, EXCESSIVE = 20, 25, 30, 35, 40, 45  # samples that trigger a guard
FAR = 60  # a sample that is hardly plausible
AT_ONCE, LONG, BACKWARD = 10, 15, 18  # samples after no time, after a long one, and after a negative one
FARTHEST = 1e37  # a float, far beyond `LOST`
BEGUN = 0.3  # of a turn of the first time, at the start
SAVED = 32  # the sample before which the state is saved, reset and restored
# samples before which the estimate is put at a multiple of its ranges, and fault counts of the ranges and the outputs
# at a multiple of their limits
PLACED = {48: (1.2, 0, 0), 52: (1.2, 1, 0), 55: (1.7, 1, 1), 58: (1.7, 1, -1), 61: (FARTHEST, 0, 0)}
TRACE = 0.1  # of its range, at the start
INSIDE = 0.8  # of the samples before the estimate is put out of its ranges
BEGIN = 10  # samples, at the least, after which a plant that leaves its ranges begins anew
PLANT, ESTIMATES = 0.4, (0.45, 0.41, 0.401)  # of their ranges, at the start: the first whose course is inside them


@dataclass(frozen=True)
class Vectors:
    """The test vectors of a self-check over N samples: inputs `u` (N, m), outputs `y` (N, p), the expected `values` (N,
    n) with their `tolerance` (n), the expected `status` (N); `placed`: by sample number, the values written into the
    state before that sample."""

    placed: Mapping[int, Mapping[Place, Sequence[float]]]
    u: np.ndarray
    y: np.ndarray
    values: np.ndarray
    tolerance: np.ndarray
    status: np.ndarray


def compared(step: Step) -> tuple[Element, ...]:
    """Return the elements that a self-check compares: those of the estimate, of the observer's traces and of its
    reports."""
    traced = (each for each in step.traced if each.place != E)  # which is no number where a sample is missing
    return (*(Element(s.name, Place("estimate", s.name)) for s in step.states), *traced)


def record_vectors(step: Step, real: Real) -> Vectors:
    """Return the test vectors of a self-check: the results of a step after a reset, run on the simulated outputs of its
    plant."""
    u = np.array([[_wave(k / 37, s) for s in step.inputs] for k in range(SAMPLES)]).reshape(SAMPLES, -1)
    times = step.observer.form.system.times
    begins, y = _motion(step, with_times(times, u, [begun(step, real)] * len(times), step.dt * np.arange(SAMPLES)))
    u = np.hstack([u, _elapsed(step)])
    if step.clock.guarded:
        _spoil(step, u, y)
    y = np.hstack([y, _ages(step)])
    u, y = u.astype(DTYPE[real]), y.astype(DTYPE[real])
    low, high = np.array([s.interval for s in step.states]).T
    for share in ESTIMATES:
        placed = placed_states(step, begins, share)
        runs: dict[Real, tuple[np.ndarray, np.ndarray]] = {"double": _run(step, "double", placed, u, y)}
        course = runs["double"][0][: min(PLACED), : len(low)]
        if ((course >= low) & (course <= high)).all(axis=1).mean() > INSIDE:
            break
    runs["float"] = _run(step, "float", placed, u, y)
    # without guards up to the first sample at which a run has implausible values
    sound = np.all([(np.abs(values) <= LOST).all(axis=1) for values, _ in runs.values()], axis=0)
    count = SAMPLES if step.clock.guarded or sound.all() else int(np.argmin(sound))
    u, y = u[:count], y[:count]
    runs = {kind: (values[:count], status[:count]) for kind, (values, status) in runs.items()}
    values, status = runs[real]
    gap = np.abs(runs["float"][0] - runs["double"][0]).max(axis=0)
    unit = {kind: np.finfo(number).eps for kind, number in DTYPE.items()}
    distance = gap * (unit[real] / unit["float"]) + unit[real] * np.abs(values).max(axis=0)
    return Vectors(placed, u, y, values, 16 * distance, status)


def _spoil(step: Step, u: np.ndarray, y: np.ndarray) -> None:
    """Write the faulty samples and inputs that guards catch into test vectors u (N, m), y (N, p)."""
    sensors = zip(step.outputs, readings(step.observer.form), strict=True)
    low, high = np.array([plausible_range(*each) for each in sensors]).T
    edge = np.where(np.isfinite(high - low), 0.01 * (high - low), np.nan)
    y[MISSING], y[INFINITE], y[ABSURD], u[LOST_INPUT] = np.nan, 3.2e38, np.nan_to_num(high + edge, nan=1e30), np.nan
    y[FAR] = np.where(np.isfinite(edge), low + edge, y[FAR])
    u[EXCESSIVE] = [2 * s.interval[1] - s.interval[0] if s.bounded else 3.0 for s in step.given]


def begun(step: Step, real: Real) -> float:
    """Return the time t at the first sample of a self-check, 0 for a plant without functions of t."""
    return sum(float(DTYPE[real](BEGUN * float(time.turn))) for time in step.observer.form.system.times[:1])


def lost_samples(step: Step) -> tuple[int, int]:
    """Return the numbers of the samples in the test vectors that have no inputs, and no outputs; both are `SAMPLES` if
    there are none."""
    return (LOST_INPUT, MISSING) if step.clock.guarded else (SAMPLES, SAMPLES)


def fault_words(step: Step) -> str:
    """Return the words on faulty samples, which the text of a self-check appends to the number of samples."""
    if not step.clock.guarded:
        return ""
    return ", a missing, an infinite, an absurd, a lost and an excessive one among them"


def placed_states(
    step: Step, begins: Iterable[int] = (0,), share: float = ESTIMATES[0]
) -> dict[int, dict[Place, list[float]]]:
    """Return by sample number the values that a self-check writes into a step's state before the sample, by place.
    `begins`: the samples at which the plant restarts; the estimate then starts at a `share` of the ranges.

    The estimate differs from its initial value, where a plant may be at an equilibrium at which the model has no
    effect. With guards it is also set outside of its ranges, with fault counters at their limits.
    """
    boxes, start = [_interval(s) for s in step.observer.form.states], _at(step, _start(step, share))
    ranges = {field.name: field.box[0] for field in step.layout.state}
    for name in step.observer.traces:  # such as theta, which moves from there
        low, high = ranges[name]
        start |= {Place("state", name): [low + TRACE * (high - low)]} if high - low < LOST else {}
    placed = dict.fromkeys(begins, start)
    for k, (where, *due) in PLACED.items() if step.clock.guarded else ():
        placed[k] = _at(step, [min(low + where * (high - low), FARTHEST) for low, high in boxes])
        counts = {sign: float(sign.wait * due[sign.output is not None]) for sign in step.code.signs}
        for sign, count in counts.items():
            placed[k] |= {Place("state", sign.count): [count], Place("state", sign.limit): [float(sign.wait)]}
        placed[k] |= {Place("state", "fault_checksum"): [sum(map(abs, counts.values()))]} if counts else {}
    return placed


def _start(step: Step, share: float) -> list[float]:
    """Return the point z of the step's form at which each state of the plant is at this share of its range."""
    x = [low + share * (high - low) for low, high in (_interval(s) for s in step.states)]
    u = [_wave(0.0, s) for s in step.inputs] + [0.0] * step.clock.times
    (z,) = pygraph.evaluated(_model(step).entry, "double")((x, u))
    return z


def _model(step: Step) -> OpenLoop:
    return open_loop(step.observer.form, step.dt, step.clock.between)


def _motion(step: Step, u: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Return the samples at which the plant begins, and its outputs (N, p) at the inputs `u` (N, m). A plant that is
    about to leave its ranges begins anew, or is kept inside where it did so less than `BEGIN` samples before."""
    model, start, begins, rows = _model(step), _start(step, PLANT), [0], []
    move, read = (pygraph.evaluated(function, "double") for function in (model.move, model.read))
    low, high = np.array([widened(*s.limits, -MARGIN) for s in step.observer.form.states]).T
    z = start
    for k, (now, then) in enumerate(zip(u, [*u[1:], u[-1]], strict=True), 1):
        rows += read((z, now))
        (after,) = move((z, now, then))
        clamped = np.clip(np.where(np.abs(after) <= LOST, after, z), low, high).tolist()
        begins += [k] if clamped != after and k - begins[-1] >= BEGIN and k < min(PLACED) else []
        z = start if k == begins[-1] else clamped
    return begins, np.array(rows)


def _at(step: Step, wanted: Sequence[float]) -> dict[Place, list[float]]:
    """Return the values of the places of a step's state at which its estimate z is `wanted` (n), where an element of z
    is linear in one element of the state."""
    values = {Place("state", field.name): np.array(field.initial) for field in step.layout.state}
    known = nominal(step.observer) | values
    changed = {}
    for z, goal in zip(ca.vertsplit(ca.vertcat(step.observer.z)), wanted, strict=True):
        places = [(place, index) for place, index, _ in map(address, ca.symvar(z)) if place in values]
        slope = ca.jacobian(z, ca.vertcat(*(s for s in ca.symvar(z) if address(s)[0] in values)))
        if len(places) != 1 or any(address(s)[0] in values for s in ca.symvar(slope)):
            continue
        (place, index), (rise, now) = places[0], (numbers(graph, known).item() for graph in (slope, z))
        values[place][index] = goal if z.is_symbolic() else values[place][index] + (goal - now) / rise
        changed[place] = values[place]
    return {place: np.clip(array, -FARTHEST, FARTHEST).tolist() for place, array in changed.items()}


def _run(
    step: Step, real: Real, placed: Mapping[int, Mapping[Place, Sequence[float]]], u: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    memory = layout.initial_record(step, real)
    views, calls = layout.places(step, memory), entries(step, memory, real)
    calls["tune"]()
    for section in step.code.time:
        views[T][:] = begun(step, real)
        calls[section.name]()
    kinds = (("input", step.given), ("output", step.samples))
    signals = [views[Place(kind, signal.name)] for kind, each in kinds for signal in each]
    results = [(views[each.place], each.index) for each in compared(step)]
    values, status = np.zeros((SAMPLES, len(results)), DTYPE[real]), np.zeros(SAMPLES, step.layout.word)
    for k in range(SAMPLES):
        for place, elements in placed.get(k, {}).items():
            views[place][:] = elements
        for array, value in zip(signals, (*u[k], *y[k]), strict=True):
            array[0] = value
        status[k] = calls["step"]()
        values[k] = [array[index] for array, index in results]
    return values, status


def _ages(step: Step) -> np.ndarray:
    """Return the ages of late samples (N, number of ages) in a self-check:
    in time, too late, twice in a period, and one that is no integer."""
    ages = np.array([[k * k % (age.interval[1] + 1) for age in step.ages] for k in range(SAMPLES)], dtype=float)
    ages[UNDATED] = 0.5
    return ages.reshape(SAMPLES, -1)


def _elapsed(step: Step) -> np.ndarray:
    """Return the times since the last call (N, 1) in a self-check, 0, a long and a negative one among them; (N, 0)
    where dt is a constant."""
    if step.clock.varying is None:
        return np.zeros((SAMPLES, 0))
    shortest, longest = step.clock.varying.shortest, step.dt
    elapsed = shortest + (longest - shortest) * (np.arange(SAMPLES) * 7 % 11 / 10)
    elapsed[AT_ONCE], elapsed[LONG], elapsed[BACKWARD] = 0.0, 2.5 * longest, -longest
    return elapsed[:, None]


def _wave(cycles: float, signal: Signal) -> float:
    """Return a triangle wave at `cycles` periods: half the signal's declared range (or +-1) about its middle."""
    low, high = _interval(signal)
    triangle = 1 - 4 * abs(cycles % 1 - 0.5)
    return (low + high) / 2 + (high - low) / 4 * triangle


def _interval(signal: Signal) -> tuple[float, float]:
    return signal.interval if signal.bounded else (-1.0, 1.0)
