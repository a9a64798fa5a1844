"""The reference against an integration of its own, written from the papers in plain numpy."""

import numpy as np
import pytest
from plants import fitzhugh_nagumo, pendulum
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.run.continuous import CannotIntegrate
from hgogen.run.samples import BadShape
from hgogen.step import BadStep

DT, SAMPLES = 0.1, 21
T = DT * np.arange(SAMPLES)
U, Y = np.sin(T), 1.5 * np.cos(0.7 * T + 0.3)
THETA, EPSILON = 3.0, 0.8
Q = np.diag([0.1, 0.01, 2.3e-4])
DELTA = np.diag([1, THETA, THETA**2])  # Delta^-1


def continuous(u: np.ndarray, y: np.ndarray, between: str) -> np.ndarray:
    """FitzHugh-Nagumo, z = (x1, x2, -eta), P in place of S; a missing sample (NaN) switches the correction off."""

    def rate(c: float, state: np.ndarray, u: tuple[float, float], y: tuple[float, float], weight: float) -> np.ndarray:
        z, P = state[:3], state[3:].reshape(3, 3)
        now, seen = u[0] + c * (u[1] - u[0]), y[0] + c * (y[1] - y[0])
        f = [z[0] - z[0] ** 3 / 3 - z[1] * now, EPSILON * (3 * np.sin(z[0]) - z[1] + z[2]), 0]
        F = np.array([[1 - z[0] ** 2, -now, 0], [3 * EPSILON * np.cos(z[0]), -EPSILON, EPSILON], [0, 0, 0]])
        gain = weight * THETA * P[:, 0]
        slope = F @ P + P @ F.T + THETA * DELTA @ Q @ DELTA - np.outer(gain, P[0])
        return DT * np.concatenate([f + gain * (seen - z[0]), slope.ravel()])

    state, estimates = np.concatenate([np.zeros(3), np.eye(3).ravel()]), [np.zeros(3)]
    for k in range(1, len(y)):
        line = (u[k - 1] if between == "line" else u[k], u[k])
        there = np.isfinite(y[k])
        seen = (y[k - 1] if np.isfinite(y[k - 1]) else y[k], y[k]) if there else (0.0, 0.0)
        options = {"rtol": 1e-12, "atol": 1e-12, "method": "DOP853"}
        state = solve_ivp(rate, (0, 1), state, args=(line, seen, float(there)), **options).y[:, -1]
        estimates.append(state[:3])
    return np.array(estimates) * [1, 1, -1]


@pytest.mark.parametrize("between", ["line", "hold"])
def test_it_is_the_papers_observer(between: str) -> None:
    """20 restarts, each to 1e-12 in both, and errors that the observer forgets: 1e-9 leaves a factor of 50."""
    y = Y.copy()
    y[[7, 8, 15]] = np.nan
    run = hg.reference(fitzhugh_nagumo(theta=THETA), U, y, DT, between=between)
    assert run.x == pytest.approx(continuous(U, y, between), abs=1e-9)
    assert run.engine == "cvodes"
    assert run.names == ("x1", "x2", "eta")
    assert run.t == pytest.approx(T)
    assert np.array_equal(np.flatnonzero(run.status), [7, 8, 15])


def test_a_step_brings_its_own_dt() -> None:
    step = hg.sample(pendulum(), hg.methods.rk4, dt=0.01, between="hold")
    mine = hg.reference(step, U, Y)
    other = hg.reference(step.observer, U, Y, 0.01, between="hold")
    assert np.array_equal(mine.x, other.x)
    assert mine.t[1] == 0.01
    assert not np.array_equal(mine.x, hg.reference(step.observer, U, Y, 0.01).x)


def test_the_step_is_left_alone() -> None:
    step = hg.sample(pendulum(), hg.methods.rk4, dt=0.01)
    step(u=0.1, y=0.2)
    before = step.save()
    hg.reference(step, U, Y)
    assert step.save() == before


def test_a_decaying_theta_decays_between_samples() -> None:
    """theta of the trace is exact, and one sample of .4 s is four of .1 s where u and y are on one line."""
    observer = fitzhugh_nagumo(theta=hg.theta.decaying(4.0, rate=1.0))
    t = np.arange(9) * 0.1
    fine = hg.reference(observer, 0.1 + t, 1 - t, 0.1)
    coarse = hg.reference(observer, (0.1 + t)[::4], (1 - t)[::4], 0.4)
    assert coarse.x == pytest.approx(fine.x[::4], abs=1e-9)
    assert fine.traces["theta"] == pytest.approx(1 + 3 * np.exp(-t), rel=1e-12)


def test_what_escapes_is_a_sentence() -> None:
    x, y = hg.Signal("x", "", "state", 1.0), hg.Signal("y")
    plant = hg.System("escapes", states=(x,), outputs=(y,), flow=[x**2], output=[x])
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=(1.0,), R=1.0)
    with pytest.raises(CannotIntegrate, match=r"continuous equations of riccati cannot be .* sample of 0.4"):
        hg.reference(observer, y=[np.nan] * 4, dt=0.4)


def test_bad_input_is_a_sentence() -> None:
    with pytest.raises(BadStep, match=r"dt = 0\.0 must be a positive time"):
        hg.reference(pendulum(), U, Y)
    with pytest.raises(BadShape, match="u of shape"):
        hg.reference(pendulum(), U[:3], Y, DT)
