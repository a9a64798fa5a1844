"""Recorded vectors for the self-check of emitted code: what goes in, and what must come out, bit for bit.

The inputs are triangle waves over the declared ranges, with a missing, an absurd, a lost and an excessive sample among
them, so that guards, correction and adaptation all run; a step without guards gets none of these, and its record ends
where its estimate is lost. Late samples come with ages of every kind. They use no function of this machine. The outputs
are those of `emit.pystep`.

The tolerance is for other roundings, of libm or of contracted operations. These touch a part of the operations by about
a rounding unit each, as going from float to double touches them all; so the tolerance is 16 times that distance, and in
double its share by rounding units.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from hgogen.emit import layout, pystep
from hgogen.emit.syntax import DTYPE, Real
from hgogen.estimators.core import nominal, numbers
from hgogen.program import Place, address
from hgogen.signal import LOST, Signal
from hgogen.step import Step

SAMPLES = 64
MISSING, ABSURD, UNDATED, LOST_INPUT, EXCESSIVE = 20, 30, 35, 40, 50  # samples at which a guard is exercised


@dataclass(frozen=True)
class Vectors:
    """Inputs u (N, m), outputs y (N, p), what is `seen` (N, n), its `tolerance` (n), status (N)."""

    u: np.ndarray
    y: np.ndarray
    seen: np.ndarray
    tolerance: np.ndarray
    status: np.ndarray


def places(step: Step) -> tuple[Place, ...]:
    """The values that the self-check compares: the estimate, and what the observer traces of its state."""
    traces = (Place("state", name) for name in step.observer.traces)
    return (*(Place("estimate", s.name) for s in step.states), *traces)


def record(step: Step, real: Real) -> Vectors:
    """Run the step from a reset over the test inputs."""
    u = np.array([[_wave(k / 37, s) for s in step.inputs] for k in range(SAMPLES)]).reshape(SAMPLES, -1)
    y = np.array([[_wave(k / 23, s) for s in step.outputs] for k in range(SAMPLES)])
    if step.clock.guarded:
        y[MISSING], y[ABSURD], u[LOST_INPUT] = np.nan, 1e30, np.nan
        u[EXCESSIVE] = [2 * s.interval[1] - s.interval[0] if s.bounded else 3.0 for s in step.inputs]
    y = np.hstack([y, _ages(step)])
    u, y = u.astype(DTYPE[real]), y.astype(DTYPE[real])
    runs = {"float": _run(step, "float", u, y), "double": _run(step, "double", u, y)}
    # without guards up to the first sample after which not every run sees plausible numbers
    sound = np.all([(np.abs(seen) <= LOST).all(axis=1) for seen, _ in runs.values()], axis=0)
    count = SAMPLES if step.clock.guarded or sound.all() else int(np.argmin(sound))
    u, y = u[:count], y[:count]
    runs = {kind: (seen[:count], status[:count]) for kind, (seen, status) in runs.items()}
    seen, status = runs[real]
    gap = np.abs(runs["float"][0] - runs["double"][0]).max(axis=0)
    unit = {kind: np.finfo(number).eps for kind, number in DTYPE.items()}
    distance = gap * (unit[real] / unit["float"]) + unit[real] * np.abs(seen).max(axis=0)
    return Vectors(u, y, seen, 16 * distance, status)


def lost(step: Step) -> tuple[int, int]:
    """The sample at which the inputs are no numbers, and that at which the outputs are none; `SAMPLES` for none."""
    return (LOST_INPUT, MISSING) if step.clock.guarded else (SAMPLES, SAMPLES)


def faults(step: Step) -> str:
    """The words for such samples, after their number."""
    return ", a missing, an absurd, a lost and an excessive one among them" if step.clock.guarded else ""


def start(step: Step) -> dict[Place, list[float]]:
    """The state at the first sample, by place: the estimate off its rest, where a plant may stand still and
    show nothing of its model, as far as an element of it is linear in one of the state's."""
    boxes = [s.interval if s.bounded else (-1.0, 1.0) for s in step.observer.form.states]
    wanted = [low + 0.7 * (high - low) for low, high in boxes]
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
    return {place: list(map(float, array)) for place, array in changed.items()}


def _run(step: Step, real: Real, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    memory = layout.made(step, real)
    views, calls = layout.places(step, memory), pystep.entries(step, memory, real)
    calls["tune"]()
    for place, values in start(step).items():
        views[place][:] = values
    kinds = (("input", step.inputs), ("output", step.samples))
    signals = [views[Place(kind, signal.name)] for kind, each in kinds for signal in each]
    results = [views[place] for place in places(step)]
    seen, status = np.zeros((SAMPLES, len(results)), DTYPE[real]), np.zeros(SAMPLES, step.layout.word)
    for k in range(SAMPLES):
        for array, value in zip(signals, (*u[k], *y[k]), strict=True):
            array[0] = value
        status[k] = calls["step"]()
        seen[k] = [result[0] for result in results]
    return seen, status


def _ages(step: Step) -> np.ndarray:
    """The ages of samples that may come late (N, ages): in time, too late, twice in a period, and one that is none."""
    ages = np.array([[k * k % (age.interval[1] + 1) for age in step.ages] for k in range(SAMPLES)], dtype=float)
    ages[UNDATED] = 0.5
    return ages.reshape(SAMPLES, -1)


def _wave(cycles: float, signal: Signal) -> float:
    """Half the declared range (or +-1) about its middle, in a triangle."""
    low, high = signal.interval if signal.bounded else (-1.0, 1.0)
    triangle = 1 - 4 * abs(cycles % 1 - 0.5)
    return (low + high) / 2 + (high - low) / 4 * triangle
