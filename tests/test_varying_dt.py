"""A step that is given the time since the last call: exact filters, gaps, faults, refusals, and every target."""

import copy
import math
import pickle
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import emitted
import numpy as np
import pytest
import sympy as sp
from plants import chain
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.emit.cost import cost
from hgogen.emit.pystep import record_vectors
from hgogen.model import load
from hgogen.modelfiles.setting import Setting
from hgogen.part import SUBSTEPS
from hgogen.reading.text_model import BadModelFile
from hgogen.run import native
from hgogen.run.samples import BadShape
from hgogen.step import BadStep, NoVaryingStep
from hgogen.trial import rows_given, try_out

NAN = float("nan")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
DT = (0.01, 0.04)


def linear() -> hg.System:
    """x1' = x2, x2' = -x1 - x2/2 + u."""
    x1, x2 = (hg.Signal(name, low=-9, high=9) for name in ("x1", "x2"))
    u, y = hg.Signal("u", low=-4, high=4), hg.Signal("y", low=-9, high=9)
    flow = [x2, -x1 - x2 / sp.Integer(2) + u]
    return hg.System("linear", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=[x1])


def many() -> hg.System:
    """Fifteen tanks in a row, for which the covariance is in loops."""
    x = [hg.Signal(f"x{k}", low=-9, high=9) for k in range(15)]
    flow = [(b - a) for a, b in zip(x, [*x[1:], 0], strict=True)]
    return hg.System("many", states=tuple(x), outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])


def filtered(plant: hg.System, make: Any = hg.observers.riccati, **data: Any) -> hg.Observer:
    return make(hg.forms.original(plant), Q=[0.1] * len(plant.states), noise={"y": 0.2}, **data)


def injected() -> hg.Observer:
    return hg.observers.high_gain(hg.forms.triangular(chain(2)), theta=4, poles=(-1, -1))


STEPS: dict[str, tuple[Callable[[], hg.Observer], Any]] = {
    "factored": (lambda: filtered(linear()), hg.methods.continuous_discrete),
    "nonlinear": (lambda: filtered(chain(2)), hg.methods.continuous_discrete),
    "cholesky": (lambda: filtered(linear()), hg.methods.cholesky),
    "loops": (lambda: filtered(many()), hg.methods.continuous_discrete),
    "ukf": (lambda: filtered(chain(2), hg.observers.ukf), hg.methods.continuous_discrete),
    "iterated": (lambda: filtered(chain(2), hg.observers.iterated_ekf), hg.methods.cholesky),
    "rk4": (injected, hg.methods.rk4),
    "heun": (injected, hg.methods.heun),
    "euler": (injected, hg.methods.euler),
}
INTEGRATED = ("rk4", "heun", "euler")


@cache
def steps(name: str, real: Any = "double") -> tuple[Any, Any]:
    """A step at the longest dt, and one in which it varies."""
    make, method = {"adaptive": (lambda: adapting(1e-2, 1e-1, d=0.32), hg.methods.cholesky), **STEPS}[name]
    return tuple(hg.sample(make(), method, dt=dt, real=real, engine="python") for dt in (DT[1], DT))


def samples(step: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(count) * DT[1]
    return np.sin(np.outer(t, np.arange(1, 1 + len(step.inputs)))), np.cos(
        np.outer(t, 1.0 + np.arange(len(step.outputs)))
    )


# --- the fixed step -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STEPS)
def test_at_a_constant_time_it_has_the_bits_of_the_fixed_step(name: str) -> None:
    fixed, varying = (copy.copy(step) for step in steps(name))
    u, y = samples(fixed, 40)
    y[7] = NAN
    one, other = fixed.run(u, y), varying.run(u, y, dt=DT[1])
    assert np.array_equal(one.x, other.x)
    assert one.t == pytest.approx(other.t)
    assert fixed.flags(int(one.status.max())) == varying.flags(int(other.status.max()))


@pytest.mark.parametrize("name", STEPS)
def test_a_long_call_is_its_sub_steps(name: str) -> None:
    """As three calls without a sample, with inputs on the line between; an observer that integrates the measurement
    has it on a line as well, so that its samples are given."""
    _, varying = steps(name)
    whole, parts = copy.copy(varying), copy.copy(varying)
    u, y = samples(whole, 6)
    for step in (whole, parts):
        step.run(u, y, dt=0.03)
    ends = u[-1] + np.outer([1 / 3, 2 / 3, 1], 0.3 - u[-1])
    read = y[-1] + np.outer([1 / 3, 2 / 3, 1], 0.2 - y[-1]) if name in INTEGRATED else [[NAN], [NAN], [0.2]]
    for inputs, sample in zip(ends, read, strict=True):
        last = parts(inputs, sample, dt=0.036)
    first = whole(ends[-1], [0.2], dt=0.108)
    assert first.x == pytest.approx(last.x, rel=1e-12)
    assert whole.save() != varying.save()


# --- exact filters ------------------------------------------------------------------------------------------


def exact(
    F: np.ndarray, B: np.ndarray, Q: np.ndarray, r: float, u: np.ndarray, y: np.ndarray, elapsed: np.ndarray
) -> np.ndarray:
    """The estimates (N, n) of the Kalman filter of x' = F x + B u, y = x_1, u held, P(0) = 1, discretised exactly over
    each time (Van Loan); NaN: no sample."""
    n = len(F)
    x, P, rows = np.zeros(n), np.eye(n), []
    for k, (sample, h) in enumerate(zip(y, elapsed, strict=True)):
        if k:
            block = expm(np.block([[-F, Q], [np.zeros((n, n)), F.T]]) * h)
            Phi = block[n:, n:].T
            noise = Phi @ block[:n, n:]
            affine = expm(np.block([[F, (B * u[k])[:, None]], [np.zeros((1, n + 1))]]) * h)
            x, P = affine[:n, :n] @ x + affine[:n, n], Phi @ P @ Phi.T + noise
        if np.isfinite(sample):
            K = P[:, 0] / (P[0, 0] + r)
            x, P = x + K * (sample - x[0]), P - np.outer(K, P[0])
        rows.append(x)
    return np.array(rows)


F2, B2 = np.array([[0, 1], [-1, -0.5]]), np.array([0.0, 1.0])


def jittered(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times since the last call with a jitter of 30 %, inputs, and noisy outputs of the linear plant."""
    draw = np.random.default_rng(seed)
    elapsed = 0.02 * draw.uniform(0.7, 1.3, count)
    u = np.sign(np.sin(np.cumsum(elapsed)))
    x, y = np.array([1.0, 0.0]), []
    for k, h in enumerate(elapsed):
        if k:
            x = (expm(np.block([[F2, (B2 * u[k])[:, None]], [np.zeros((1, 3))]]) * h) @ [*x, 1])[:2]
        y.append(x[0] + 0.2 * draw.normal())
    return elapsed, u, np.array(y)


@pytest.mark.full
def test_an_irregular_log_of_a_linear_plant_has_the_exact_filter() -> None:
    """The same filter at the median spacing is ten times as far off."""
    elapsed, u, y = jittered(400, 3)
    y[50:60] = NAN
    right = exact(F2, B2, 0.1 * np.eye(2), 0.04, u, y, elapsed)
    observer = filtered(linear(), covariance=[1, 1])
    varying = hg.sample(observer, dt=(0.014, 0.026), between="hold", engine="python")
    fixed = hg.sample(observer, dt=0.02, between="hold", engine="python")
    off = np.abs(varying.run(u, y, dt=elapsed).x - right).max()
    assert off < 2e-3
    assert np.abs(fixed.run(u, y).x - right).max() > 10 * off


def test_glucose_with_gaps_of_two_to_twenty_minutes() -> None:
    """A first-order decay with an input, sampled at random, and once after 70 minutes: sub-steps of 20 minutes at most,
    whose noise is that of the whole gap."""
    g, rate = hg.Signal("g", "mmol/l", low=-30, high=30), hg.Signal("u", low=-1, high=1)
    y = hg.Signal("y", "mmol/l", low=-30, high=30)
    decay = sp.Rational(1, 100)
    plant = hg.System(
        "glucose", states=(g,), inputs=(rate,), outputs=(y,), flow=[rate - decay * g], output=[g], time="min"
    )
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.02], noise={"y": 0.5}, covariance=[1])
    step, fine = (
        hg.sample(observer, dt=dt, substeps=count, between="hold", engine="python")
        for dt, count in (((2, 20), 4), ((0.5, 5), 16))
    )
    draw = np.random.default_rng(5)
    elapsed = draw.uniform(2, 20, 60)
    elapsed[30] = 70
    u, measured = draw.uniform(-0.1, 0.1, 60), 5 * np.exp(-np.cumsum(elapsed) / 100) + 0.5 * draw.normal(size=60)
    run = step.run(u, measured, dt=elapsed)
    right = exact(np.array([[-0.01]]), np.array([1.0]), np.array([[0.02]]), 0.25, u, measured, elapsed)
    assert np.abs(run.x - right).max() < 0.1  # h Q for the integral of noise over 20 minutes
    assert np.abs(fine.run(u, measured, dt=elapsed).x - right).max() < 0.03
    assert not run.status.any()
    assert run.t == pytest.approx(np.cumsum(elapsed) - elapsed[0])


def test_a_period_that_is_ten_percent_off_biases_the_rate() -> None:
    """A ramp: the fixed step finds a rate per period of its own clock, without a status bit; the other finds it."""
    p, v = hg.Signal("p", low=-90, high=90), hg.Signal("v", low=-9, high=9)
    plant = hg.System("ramp", states=(p, v), outputs=(hg.Signal("y", low=-90, high=90),), flow=[v, 0], output=[p])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0, 1e-3], noise={"y": 0.01})
    y = 2.0 * 0.022 * np.arange(900)
    fixed, varying = (
        hg.sample(observer, dt=0.02, engine="python"),
        hg.sample(observer, dt=(0.01, 0.03), engine="python"),
    )
    one, other = fixed.run(y=y), varying.run(y=y, dt=0.022)
    assert one["v"][-1] == pytest.approx(2.2, abs=1e-3)
    assert other["v"][-1] == pytest.approx(2.0, abs=1e-4)
    assert not one.status[-1]


# --- a theta that moves -------------------------------------------------------------------------------------


def moving(theta: Any) -> hg.Observer:
    """On the linear plant in its triangular form."""
    return hg.observers.riccati(hg.forms.triangular(linear()), Q=[0.1, 0.1], noise={"y": 0.2}, theta=theta)


def adapting(*mu: float, d: float = 0.4) -> hg.Observer:
    return moving(hg.theta.adaptive(3, mu=mu, innovation=hg.innovation.staggered(d, 4), rise_time=0.5, rate=0.3))


def test_a_moving_theta_is_that_of_the_fixed_step_at_a_constant_time() -> None:
    """Through an alarm, of a sample that jumps; of the first call no time is counted."""
    u = np.sin(0.02 * np.arange(300))
    y = np.where(u == 0, NAN, u + (np.arange(300) > 150))
    for make in (lambda: adapting(1e-2, 1e-1), lambda: moving(hg.theta.decaying(4, 2))):
        fixed = hg.sample(make(), dt=0.02, engine="python").run(u, y)
        varying = hg.sample(make(), dt=(0.01, 0.02), engine="python").run(u, y, dt=0.02)
        assert fixed.traces["theta"].max() > 2
        assert varying.x == pytest.approx(fixed.x, abs=1e-12)
        for name, course in fixed.traces.items():
            assert varying.traces[name] == pytest.approx(course, abs=1e-12)


def test_theta_follows_its_law_over_the_times_that_pass() -> None:
    """It falls, and it rises, by the solution of its law at these times, whatever they are."""
    elapsed = np.random.default_rng(2).uniform(0.005, 0.06, 80)
    elapsed[20] = 0.3
    passed, nothing = np.cumsum(elapsed) - elapsed[0], np.full(80, NAN)
    falling = hg.sample(moving(hg.theta.decaying(4, 2)), dt=DT, engine="python").run(nothing, nothing, dt=elapsed)
    assert falling.traces["theta"] == pytest.approx(1 + 3 * np.exp(-2 * passed), abs=1e-12)
    step = hg.sample(adapting(1e-12, 2e-12, d=0.04), dt=DT, engine="python")
    rising = step.run(np.zeros(80), 5 * (-1.0) ** np.arange(80), dt=elapsed).traces
    (begins, *_) = np.flatnonzero(rising["theta"] > 1) - 1
    law = solve_ivp(
        lambda t, x: np.where(x <= 3, x, x - 6) ** 2 / 0.5, (0, 9), [1.0], t_eval=passed[begins:] - passed[begins],
        rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    assert rising["theta"][begins:] == pytest.approx(law.y[0], abs=1e-6)
    assert rising["theta"][-1] > 5


def test_the_innovation_is_over_times() -> None:
    """In numpy: five copies of the model, the oldest of which restarts once d/4 has passed, with the times of samples
    as factors, at most the longest dt; over a gap, at sub-steps."""
    elapsed = np.random.default_rng(3).uniform(0.005, 0.04, 120)
    elapsed[50], elapsed[60] = 0.2, 0.0
    u, y = np.sin(np.cumsum(elapsed)), np.cos(np.cumsum(elapsed))
    y[::7] = NAN
    run = hg.sample(adapting(1e6, 2e6), dt=DT, between="hold", engine="python").run(u, y, dt=elapsed)
    copies, sums, valid, oldest, since, integrals = [np.zeros(2)] * 5, np.zeros(5), np.zeros(5), 0, 0.0, []
    for k, h in enumerate(elapsed * (np.arange(120) > 0)):
        count = max(1, math.ceil(h / DT[1] - 1e-12))
        for m, x in enumerate(copies):
            for _ in range(count):
                first = F2 @ x + B2 * u[k]
                x = x + h / count / 2 * (first + F2 @ (x + h / count * first) + B2 * u[k])
            copies[m] = x
        weight = min(h, DT[1])
        if np.isfinite(y[k]):
            sums, valid = sums + weight * (y[k] - np.array(copies)[:, 0]) ** 2, valid + weight
        if k:
            integrals.append(sums[oldest] * 0.4 / max(valid[oldest], 0.4))
            since += h
            if since >= 0.1 - 1e-4:
                copies[oldest], sums[oldest], valid[oldest] = run.x[k], 0, 0
                oldest, since = (oldest + 1) % 5, 0.0
    assert run.traces["innovation"][1:] == pytest.approx(integrals, abs=1e-12)


def test_a_window_remembers_samples_of_one_period() -> None:
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.window(0.4))
    with pytest.raises(hg.HgogenError, match=r"take innovation\.staggered, or a number for dt"):
        hg.sample(moving(theta), dt=DT)


def test_a_variance_by_an_expression_is_that_of_a_sample() -> None:
    noise = {"Q": [0.1, 0.1], "R": {"y": "0.04 + 0*x1"}}, {"Q": [0.1, 0.1], "noise": {"y": 0.2}}
    u, y = samples(steps("factored")[1], 30)
    one, other = (
        hg.sample(hg.observers.riccati(hg.forms.original(linear()), **each), dt=DT, engine="python").run(
            u, y, dt=np.linspace(0.005, 0.1, 30)
        )
        for each in noise
    )
    assert one.x == pytest.approx(other.x, abs=1e-12)


# --- times at the edge --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize(("time", "bit"), [(0.0, ()), (-0.01, ("DT_REFUSED",)), (NAN, ("DT_REFUSED",))])
def test_without_a_time_it_only_corrects(name: str, time: float, bit: tuple[str, ...]) -> None:
    step = copy.copy(steps(name)[1])
    u, y = samples(step, 9)
    step.run(u, y, dt=0.02)
    before = {place: array.copy() for place, array in step._kept.places.items()}
    if name not in INTEGRATED:
        predicted = step.predict(u[-1], dt=time)
        unchanged = [
            f.name for f in step.layout.state if f.name not in ("calls", "elapsed") and not f.name.startswith("used")
        ]
        for place, array in step._kept.places.items():
            if place.struct not in ("state", "column") or place.name in unchanged:
                assert place.name == "dt" or np.array_equal(array, before[place]), place
        assert predicted.flags == bit
        assert not np.array_equal(step.update(y=y[-1, 0] + 0.1).x, predicted.x)
    else:
        assert step(u[-1], y[-1] + 0.1, dt=time).flags == bit
        assert np.array_equal(step._kept.places[("state", "z")], before[("state", "z")])


@pytest.mark.parametrize("name", ["factored", "ukf", "rk4"])
@pytest.mark.parametrize("time", [0.33, 1e9, float("inf")])
def test_a_longer_time_than_the_sub_steps_reach_is_cut_and_reported(name: str, time: float) -> None:
    cut, longest = copy.copy(steps(name)[1]), copy.copy(steps(name)[1])
    u, y = samples(cut, 5)
    for step in (cut, longest):
        step.run(u, y, dt=0.02)
    assert longest(u[0], y[0], dt=SUBSTEPS * DT[1]).flags == ()
    result = cut(u[0], y[0], dt=time)
    assert result.flags == ("DT_LIMITED",)
    assert np.array_equal(result.x, longest(u[0], y[0], dt=0.0).x) or cut.save() == longest.save() or name != "rk4"
    assert cut._kept.places[("state", "elapsed")] == SUBSTEPS * DT[1]


def test_the_first_call_takes_no_time_and_reports_none() -> None:
    step = copy.copy(steps("factored")[1])
    step.reset()
    assert step(0.0, 0.5, dt=NAN).flags == ()
    assert step(0.0, 0.5, dt=NAN).flags == ("DT_REFUSED",)


def test_a_shorter_time_than_the_shortest_is_used() -> None:
    one, other = (copy.copy(steps("factored")[1]) for _ in range(2))
    for step in (one, other):
        step.run(np.zeros(3), np.ones(3), dt=0.02)
    assert not np.array_equal(one(0.0, NAN, dt=1e-4).x, other(0.0, NAN, dt=0.0).x)


# --- fault counts -------------------------------------------------------------------------------------------


def restarts(elapsed: float) -> float:
    """The time of the first restart while a sensor that was lost for long is off."""
    step = hg.sample(filtered(linear(), initial={"x1": 0}), dt=DT, engine="python")
    count = round(60 / elapsed)
    y = np.full(count, 8.5)
    y[::2] += 0.1
    step.tune(Q=(1e-8, 1e-8))
    run = step.run(np.zeros(count), y, dt=elapsed)
    where = [k for k, status in enumerate(run.status) if "RESTARTED_FROM_SAMPLE" in step.flags(int(status))]
    return float(run.t[where[0]])


def test_fault_counts_count_time_and_not_calls() -> None:
    slow, fast = restarts(0.04), restarts(0.01)
    assert fast == pytest.approx(slow, rel=0.05)


# --- the memory ---------------------------------------------------------------------------------------------


def test_it_is_saved_copied_pickled_and_rebuilt() -> None:
    step = copy.copy(steps("nonlinear")[1])
    u, y = samples(step, 20)
    step.run(u, y, dt=0.015)
    others = [copy.copy(step), pickle.loads(pickle.dumps(step)), hg.sample(step.observer, step.method, dt=DT)]
    others[2].restore(step.save())
    expected = step.run(u, y, dt=0.033)
    for other in others[:2]:
        assert np.array_equal(other.run(u, y, dt=0.033).t, expected.t)
    for other in (*others[:2], others[2]):
        assert other.clock == step.clock
    assert np.array_equal(others[2].run(u, y, dt=0.033).x[1:], expected.x[1:])
    assert step.rebuilt(dt=0.02).clock.varying is None
    assert step.rebuilt(real="float").limits == DT
    assert step.rebuilt(dt=(0.005, 0.02)).limits == (0.005, 0.02)
    assert step.started({}).limits == DT


def test_a_saved_state_of_the_fixed_step_is_refused() -> None:
    fixed, varying = steps("factored")
    with pytest.raises(hg.HgogenError):
        varying.restore(fixed.save())


def test_a_run_is_its_calls() -> None:
    step, again = copy.copy(steps("factored")[1]), copy.copy(steps("factored")[1])
    u, y = samples(step, 12)
    elapsed = np.linspace(0.005, 0.3, 12)
    run = step.run(u, y, dt=elapsed)
    each = [again(*row, dt=h).x for *row, h in zip(u, y, elapsed, strict=True)]
    assert np.array_equal(run.x, each)
    assert again._clock == pytest.approx(step._clock)


def test_times_of_refused_calls_do_not_pass() -> None:
    step = copy.copy(steps("factored")[1])
    run = step.run(np.zeros(4), np.zeros(4), dt=[NAN, 0.02, -1.0, 0.03])
    assert run.t == pytest.approx([0, 0.02, 0.02, 0.05])


@needs_compiler
@pytest.mark.parametrize("name", ["factored", "loops", "rk4", "adaptive"])
def test_many_runs_have_the_bits_of_each(name: str) -> None:
    step = steps(name)[1]
    u, y = samples(step, 30)
    elapsed = np.random.default_rng(1).uniform(0, 0.4, (5, 30))
    elapsed[2, 4], elapsed[3, 5] = NAN, -1.0
    batch = step.run_many(u, y, dt=elapsed, engine="c")
    for k, times in enumerate(elapsed):
        one = copy.copy(step).run(u, y, dt=times, engine="python")
        assert np.array_equal(batch.x[k], one.x)
        assert np.array_equal(batch.status[k], one.status)


@pytest.mark.parametrize("name", ["factored", "rk4"])
def test_innovations_of_a_run_are_those_of_its_predictions(name: str) -> None:
    step = copy.copy(steps(name)[1])
    u, y = samples(step, 12)
    run = step.run(u, y, dt=np.linspace(0.01, 0.08, 12))
    assert np.isfinite(run.innovations).all()
    assert np.abs(run.innovations[1:]).max() < 1
    assert run.covariance is None or np.isfinite(run.covariance).all()


# --- what is said of it -------------------------------------------------------------------------------------


def test_no_proof_of_one_dt_is_printed() -> None:
    fixed, varying = steps("rk4")
    assert hg.contraction(fixed).proved
    assert not hg.contraction(varying).proved
    assert "varies" in str(hg.contraction(varying))


@pytest.mark.parametrize("name", ["varying", "varying_integrated"])
def test_a_self_check_has_every_kind_of_time(name: str) -> None:
    step = emitted.step(name)
    vectors = record_vectors(step, "double")
    flags = {flag for status in vectors.status for flag in step.flags(int(status))}
    assert {"DT_REFUSED", "DT_LIMITED"} <= flags
    elapsed = vectors.u[:, -1]
    assert (elapsed == 0).any()
    assert (elapsed < 0).any()
    assert np.isnan(elapsed).any()
    assert ((elapsed > step.dt) & (elapsed < step.clock.varying.substeps * step.dt)).any()


def test_a_call_costs_its_sub_steps() -> None:
    """Each of them as much, in the worst case."""
    observer = filtered(linear())
    one, two, three = (cost(hg.sample(observer, dt=DT, substeps=k), "double").operations for k in (1, 2, 3))
    predicted = cost(steps("factored")[0], "double").operations
    assert predicted / 4 < two - one
    assert three - two == pytest.approx(two - one, abs=2)


def test_the_manual_names_the_times() -> None:
    text = emitted.manual(emitted.files("varying"))
    for words in ("every 0.01 to 0.03 s", "in up to 4 equal steps", "the estimate lags by dt - 0.12 s", "DT_REFUSED"):
        assert words in text


# --- models and trials --------------------------------------------------------------------------------------

MODEL = """
name = "swing"
[states]
q = {low = -4, high = 4, flow = "w"}
w = {low = -9, high = 9, flow = "-4*sin(q) - w/5"}
[outputs]
y = {equation = "q"}
[trial]
duration = 6
start = {q = 1, w = 0}
noise = {y = 0.01}
seeds = 2
[tuning.filter]
kind = "riccati"
form = "original"
Q = [0.001, 0.01]
noise = {y = 0.01}
dt = DT
substeps = 3
"""


def model(folder: Path, dt: str = "[0.01, 0.03]") -> Path:
    path = folder / "swing.toml"
    path.write_text(MODEL.replace("DT", dt))
    return path


def test_a_text_model_declares_it(tmp_path: Path) -> None:
    """A number as dt, as `--dt` gives it, overrides the pair and its sub-steps."""
    loaded = load(str(model(tmp_path)))
    step = loaded.step("filter")
    assert step.limits == (0.01, 0.03)
    assert step.clock.varying.substeps == 3
    assert loaded.set(Setting(dt=0.02)).step("filter").limits == 0.02


@pytest.mark.parametrize("dt", ["[0.01, 'a']", "[0.03, 0.01]", "[]", "[0.01]", "0.02"])
def test_a_text_model_with_another_pair_is_refused(tmp_path: Path, dt: str) -> None:
    with pytest.raises(BadModelFile, match="dt"):
        load(str(model(tmp_path, dt))).step("filter")


def test_a_trial_has_times_between_the_limits(tmp_path: Path) -> None:
    """The same estimates as a run on those times, which a step at their mean does not have."""
    step = load(str(model(tmp_path))).step("filter")
    trial = load(str(model(tmp_path))).trials()[0]
    first, second = try_out(step, trial, "python")
    between = np.diff(first.truth.t)
    assert 0.01 <= between.min() < 0.012
    assert 0.028 < between.max() <= 0.03
    assert np.array_equal(first.truth.t, second.truth.t)
    assert first.truth.t[-1] == pytest.approx(6, abs=0.03)
    late = np.abs(first.x - first.truth.x)[100:]
    assert late.max() < 0.05
    step.reset()
    again = step.run(first.truth.u, first.y, dt=np.diff(first.truth.t, prepend=0))
    assert np.array_equal(again.x, first.x)


@needs_compiler
def test_a_campaign_runs_on_those_times(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["simulate", str(model(tmp_path)), "--observer", "filter", "--runs", "20"])
    assert result.exit_code == 0, result.output
    assert "steady error of w" in result.output


def test_a_trial_on_a_target_has_the_times_as_a_column(tmp_path: Path) -> None:
    loaded = load(str(model(tmp_path)))
    rows = rows_given(loaded.step("filter"), loaded.trials()[0], 50)
    assert rows.shape == (50, 2)
    assert (rows[1:, 0] >= 0.01).all()


# --- refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (lambda: hg.observers.riccati(hg.forms.original(linear()), Q=[1, 1], R=1), {}, "noise of one sample, which R"),
        (
            lambda: hg.observers.riccati(hg.forms.original(linear()), Q_per_sample=[1, 1], noise={"y": 1}),
            {},
            "needs Q, the process noise per unit of time",
        ),
        (
            lambda: hg.observers.riccati(hg.forms.original(linear()), Q=[1, 1], noise={"y": 1, "u": 0.1}),
            {},
            "does not go with noise of inputs",
        ),
        (injected, {"method": hg.methods.rk4, "periods": {"y": 0.04}}, "has no periods"),
        (lambda: hg.delayed(filtered(linear()), y=3), {}, "has no delays"),
        (injected, {"dt": (0.04, 0.01)}, "a shorter and a longer time"),
        (injected, {"dt": (0.04, 0.04)}, "a shorter and a longer time"),
        (injected, {"dt": (0, 0.04)}, "the pair of the shortest and the longest"),
        (injected, {"dt": (0.01, NAN)}, "the pair of the shortest and the longest"),
        (injected, {"dt": (1e-5, 0.04)}, "at most 1000 times as long"),
        (injected, {"dt": (0.01, 0.02, 0.03)}, "the pair of the shortest and the longest"),
        (injected, {"dt": 0.01, "substeps": 3}, "for a dt that varies"),
        (injected, {"substeps": 0}, "a whole number from 1"),
        (injected, {"substeps": True}, "a whole number from 1"),
    ],
)
def test_what_it_cannot_be_is_refused(make: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(BadStep, match=message):
        hg.sample(make(), **{"dt": DT, "method": hg.methods.rk4 if make is injected else hg.methods.cholesky} | options)


@pytest.mark.parametrize(
    ("make", "method"),
    [
        (injected, hg.methods.exponential),
        (injected, hg.methods.bilinear),
        (lambda: filtered(linear()), hg.methods.rk4),
        (lambda: filtered(linear()), hg.methods.rk4_covariance),
        (lambda: hg.observers.bank(filtered(linear()), count=3, period=2), hg.methods.continuous_discrete),
    ],
)
def test_constants_of_one_step_length_are_refused(make: Any, method: Any) -> None:
    with pytest.raises(NoVaryingStep, match="give dt as a number, or take riccati"):
        hg.sample(make(), method, dt=DT)


def test_a_signal_of_the_name_of_the_time_is_refused() -> None:
    dt = hg.Signal("dt", low=-1, high=1)
    plant = hg.System("named", states=(dt,), outputs=(hg.Signal("y"),), flow=[-dt], output=[dt])
    with pytest.raises(BadStep, match="rename"):
        hg.sample(filtered(plant), dt=DT)


def test_times_of_a_wrong_kind_are_refused() -> None:
    fixed, varying = steps("factored")
    with pytest.raises(BadShape, match="dt is missing"):
        varying(0.0, 0.0)
    with pytest.raises(BadShape, match="dt is missing"):
        varying.run([0.0], [0.0])
    with pytest.raises(BadShape, match="in which it varies"):
        fixed(0.0, 0.0, dt=0.1)
    with pytest.raises(BadShape, match="in which it varies"):
        fixed.run([0.0], [0.0], dt=0.1)
    with pytest.raises(BadShape, match=re.escape("dt of shape (2,)")):
        varying.run([0.0], [0.0], dt=[0.1, 0.2])


def test_the_step_length_is_checked_at_the_longest_time() -> None:
    """And the precision at the shortest."""
    with pytest.raises(hg.HgogenError, match="is too long"):
        hg.sample(injected(), hg.methods.rk4, dt=(0.1, 5))
    with pytest.raises(hg.HgogenError, match="is too short"):
        hg.sample(filtered(linear()), dt=(1e-10, 1e-8), real="float")


@pytest.mark.parametrize("name", ["factored", "loops", "rk4"])
def test_without_a_time_a_spoiled_state_is_kept_in_its_box(name: str) -> None:
    step = copy.copy(steps(name)[1])
    u, y = samples(step, 3)
    step.run(u, y, dt=0.02)
    step._kept.places[("state", "z")][:] = 1e20
    x = step(u[0], y[0] + NAN, dt=0.0).x
    assert np.abs(x).max() < 1e3
