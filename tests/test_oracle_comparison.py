"""The step against an oracle that shares nothing with it, and the float build against the double one.

The oracle (tests/oracle) is plain numpy, written from the paper's equations, with the full covariance where the step
has factors L D L'. In double precision both compute the same mathematics by different operations. The float build is
compared one step at a time, from recorded states, within the error that its own operations can make.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import exact
import neuron
import numpy as np
import pytest
import rounding
from native_step import NativeStep, pack_state, unpack_state
from oracle import adaptive_ekf as ekf
from oracle import fitzhugh_nagumo as fn

import hgogen as hg
from hgogen.emit import layout
from hgogen.emit.saved import mark
from hgogen.program import Place
from hgogen.run import native

REFERENCE = fn.Scenario(((50.0, -6.0),), 70.0)
SHORT = fn.Scenario(((12.0, -6.0),), 26.0)  # the same jump as soon as the first estimate has settled

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
ENGINES = [pytest.param("c", marks=needs_compiler), "python"]


def samples(scenario: fn.Scenario, seed: int, missing: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, truth (k, 3), measurement (k,), of which the share `missing` is NaN, and once all for a window d."""
    t, x = fn.times(scenario), fn.truth(scenario)
    y = x[:, 0] + fn.noise(range(seed, seed + 1), len(t))[0]
    if missing:
        y[np.random.default_rng(seed).random(len(y)) < missing] = np.nan
        y[900:1000] = np.nan
    return t, x, y


# --- double precision ---------------------------------------------------------------------------------------

# Relative to the peak of the trajectory: some 1e3 operations of 1e-16 a step, forgotten within 1e2 steps; the plain
# filter forgets more slowly, but there the errors add up as a random walk does.
ROUNDING = 1e-11


@dataclass(frozen=True)
class Variant:
    """A theta of ours, and the oracle's parts that mean the same; `missing`: the share of samples that is NaN."""

    theta: Any
    law: Any
    innovation: Any = None
    between: str = "line"
    missing: float = 0.0

    def step(self) -> Any:
        """As new; built once for both engines."""
        step = built(self)
        step.reset()
        return step

    def oracle(self) -> ekf.Observer:
        return replace(fn.observer(self.law, self.innovation), between=self.between)


@cache
def built(variant: Variant) -> Any:
    return neuron.step(variant.theta, between=variant.between)


LOGISTIC = replace(fn.adaptive(), mu=ekf.logistic(0.16, 500.0))
TWO = hg.innovation.staggered(1.0, predictors=2)
VARIANTS = {
    "plain": Variant(1.0, ekf.Constant(1.0)),
    "theta = 8": Variant(8.0, ekf.Constant(8.0)),
    "decaying": Variant(hg.theta.decaying(8.0, 0.3, scaled="both"), ekf.Decaying(8.0, 0.3)),
    "staggered, M = 4": Variant(neuron.adaptive(), fn.adaptive(), ekf.Staggered(1.0, 4)),
    "staggered, M = 2": Variant(neuron.adaptive(innovation=TWO), fn.adaptive(), ekf.Staggered(1.0, 2)),
    "window": Variant(neuron.adaptive(innovation=neuron.WINDOW), fn.adaptive(), ekf.Window(1.0)),
    "logistic": Variant(neuron.adaptive(neuron.LOGISTIC), LOGISTIC, ekf.Staggered(1.0, 4)),
    "hold": Variant(neuron.adaptive(), fn.adaptive(), ekf.Staggered(1.0, 4), between="hold"),
    "missing samples": Variant(neuron.adaptive(), fn.adaptive(), ekf.Staggered(1.0, 4), missing=0.2),
}


@cache
def expected(name: str, scenario: fn.Scenario, seed: int) -> dict[str, np.ndarray]:
    """What the oracle makes of a record: x (k, 3) in the plant's coordinates, theta and innovation (k,)."""
    t, _, y = samples(scenario, seed, VARIANTS[name].missing)
    observer = VARIANTS[name].oracle()
    state, rows = ekf.start(observer, 1), []
    for k in range(len(y)):
        state = ekf.step(observer, state, float(np.sin(t[k])), y[k : k + 1])
        if k == 1 and isinstance(observer.innovation, ekf.Window) and state.predictors:
            # Before d has passed the paper defines no window. Ours starts at the second sample, the first after which
            # time has passed; the oracle at the first.
            started = state.predictors.renewed(slice(None), state.z)
            state = replace(state, predictors=started, innovation=np.zeros(1))
        rows.append([*(state.z[0] * [1, 1, -1]), state.theta[0], state.innovation[0]])
    table = np.array(rows)
    return {"x": table[:, :3], "theta": table[:, 3], "innovation": table[:, 4]}


def compare(name: str, engine: Any, scenario: fn.Scenario, seed: int) -> None:
    """Over the whole record, so before and after theta first rises; and that no clamp of ours was active."""
    variant, want = VARIANTS[name], expected(name, scenario, seed)
    t, x, y = samples(scenario, seed, variant.missing)
    step = variant.step()
    run = step.run(u=np.sin(t), y=y, engine=engine)
    for place, have in {"x": run.x, **run.traces}.items():
        peak = np.abs(want[place]).max(axis=0)
        assert (np.abs(have - want[place]) <= ROUNDING * peak).all(), place
    assert [step.flags(s) for s in run.status] == [("MISSING_Y",) if np.isnan(v) else () for v in y]
    if not isinstance(variant.law, ekf.Adaptive):
        return
    assert (run.traces["theta"] > 1.5).any()
    jump = scenario.jumps[0][0]
    ours, theirs = (fn.settling(t, (e[:, 2] - x[:, 2])[None], jump)[0] for e in (run.x, want["x"]))
    assert abs(ours - theirs) <= 1.5 * fn.DT  # an error that just touches the band may lie on either side of it


@pytest.mark.ordinary("theta = 8-python", "decaying-c", "staggered, M = 4-python")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", VARIANTS)
def test_step_is_the_oracles(name: str, engine: Any) -> None:
    compare(name, engine, SHORT, seed=0)


@pytest.mark.ordinary("python")
@pytest.mark.parametrize("engine", ENGINES)
def test_reference_trial_is_the_oracles(engine: Any) -> None:
    compare("staggered, M = 4", engine, REFERENCE, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", VARIANTS)
def test_reference_trial_is_the_oracles_in_every_variant(name: str, engine: Any) -> None:
    for seed in (2, 3):
        compare(name, engine, REFERENCE, seed)


# --- float, one step at a time ------------------------------------------------------------------------------

# The bound is on the distance of the float program to exact arithmetic; the double program, whose own distance is by
# the same analysis 2^-29 of it, is the yardstick.
YARDSTICK = 1 + 2.0**-28
TIGHT = 1e-3  # of a state's peak: what the bound on z must stay below, or it says nothing
REACHED = 1e-3  # of the bound: what the largest error must be above, or the bound says nothing


def leaves(record: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The plain arrays of a struct by name."""
    for name in record.dtype.names or ():
        if record[name].dtype.names:
            yield from ((f"{name}.{inner}", values) for inner, values in leaves(record[name]))
        else:
            yield name, record[name].astype(float)


class Readers:
    """One step, read in float, in double, and with a bound on the float's error."""

    def __init__(self, step: Any) -> None:
        self.step = step
        self.float, self.bounded = exact.machine(step, "float"), rounding.machine(step)

    def after(self, state: np.ndarray, u: float, y: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The state after one call: in float, in double, and the bound. All that is given holds floats.

        Raises: `rounding.Uncertain`.
        """
        for machine in (self.float, self.bounded):
            unpack_state(self.step, state, machine.memory)
            machine.memory[Place("input", "u")][0], machine.memory[Place("output", "y")][0] = u, y
            machine.call()
        single, same = (pack_state(self.step, m.memory) for m in (self.float, self.bounded))
        assert single.tobytes() == same.tobytes()  # the bound is one on this very computation
        error = np.vectorize(lambda number: rounding.rounded(number).error, otypes=[float])
        bound = pack_state(self.step, {place: error(array) for place, array in self.bounded.memory.items()})
        self.step._kept.state[:] = state.tobytes()
        self.step(u=u, y=y)
        return single, np.frombuffer(bytes(self.step._kept.state), state.dtype), bound


def recorded(step: Any, u: np.ndarray, y: np.ndarray, at: np.ndarray) -> list[np.ndarray]:
    """The states before the samples `at`, rounded to float and held in double."""
    kinds, states = [layout.state_type(step, real) for real in ("double", "float")], []
    step.reset()
    for begin, end in zip([0, *at], at, strict=False):
        step.run(u=u[begin:end], y=y[begin:end], engine="python")
        states.append(np.frombuffer(bytes(step._kept.state), kinds[0]).astype(kinds[1]).astype(kinds[0]))
    return states


T, X, Y = samples(SHORT, seed=4)
U32, Y32 = (values.astype(np.float32).astype(float) for values in (np.sin(T), Y))
# the first samples, some of every phase, and every fifth while theta rises and falls after the jump
PHASES = np.unique([*range(30), *range(0, len(T), 61), *range(1195, 1500, 5)])
FLOATS = {
    "theta = 8": (8.0, PHASES[::3]),
    "decaying": (hg.theta.decaying(8.0, 0.3, scaled="both"), PHASES[::3]),
    "staggered": (neuron.adaptive(), PHASES),
    "logistic": (neuron.adaptive(neuron.LOGISTIC), PHASES[::3]),
    "window": (neuron.adaptive(innovation=neuron.WINDOW), PHASES[::20]),
}


@pytest.mark.ordinary("theta = 8", "decaying")
@pytest.mark.parametrize("name", FLOATS)
def test_a_float_step_errs_within_its_bound(name: str) -> None:
    theta, at = FLOATS[name]
    readers = Readers(neuron.step(theta))
    errors: dict[str, list[np.ndarray]] = {}
    bounds: dict[str, list[np.ndarray]] = {}
    skipped = 0
    for k, state in zip(at, recorded(readers.step, np.sin(T), Y, at), strict=True):
        try:
            after = readers.after(state, U32[k], Y32[k])
        except rounding.Uncertain:
            skipped += 1
            continue
        for (place, single), (_, double), (_, bound) in zip(*map(leaves, after), strict=True):
            error = np.abs(single - double)
            assert (error <= YARDSTICK * bound).all(), (k, place, error, bound)
            errors.setdefault(place, []).append(error)
            bounds.setdefault(place, []).append(bound)
    assert skipped < 0.12 * len(at)  # where theta comes to rest in one arithmetic before the other, most of all
    for place in ("z", "D", "L"):
        error, bound = np.array(errors[place])[:, 0], np.array(bounds[place])[:, 0]
        assert (error.max(axis=0) >= REACHED * bound.max(axis=0)).all(), place
    estimates = np.array(bounds["z"])[:, 0]
    assert (estimates.max(axis=0) < TIGHT * np.abs(X).max(axis=0)).all()


@pytest.mark.ordinary("theta = 8", "staggered")
@needs_compiler
@pytest.mark.parametrize("name", FLOATS)
def test_compiled_float_is_the_float_that_was_bounded(name: str) -> None:
    theta, at = FLOATS[name]
    step = neuron.step(theta)
    machine, compiled = exact.machine(step, "float"), NativeStep(step, "float")
    for k, state in zip(at, recorded(step, np.sin(T), Y, at), strict=True):
        compiled.state[:] = state.astype(compiled.state.dtype)
        compiled.state["ready"] = mark(step, "float")
        status = compiled.run(U32[k : k + 1], Y32[k : k + 1]).status[0]
        unpack_state(step, state, machine.memory)
        machine.memory[Place("input", "u")][0], machine.memory[Place("output", "y")][0] = U32[k], Y32[k]
        assert machine.call() == status
        for (place, mine), (_, its) in zip(
            leaves(pack_state(step, machine.memory)), leaves(compiled.state), strict=True
        ):
            assert (mine == its).all() or place == "ready", (k, place)
