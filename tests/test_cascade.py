"""The cascade of high-gain differentiators: practical, an error of the order of mu = 1/theta."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import cascade as oracle
from oracle.sampled import run
from plants import chain, fitzhugh_nagumo, model, two_outputs
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.estimators.core import core_numbers, nominal
from hgogen.estimators.gains import BadPoles
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.theorem import rows

NAN = float("nan")


def mixed() -> hg.System:
    """a_1 = 3, a_2 = 2, a_3 = -1/2, an offset, an input, and b in every row."""
    x = [hg.Signal(f"x{i}", low=-3, high=4) for i in (1, 2, 3)]
    u = hg.Signal("u", low=-1, high=1)
    flow = [2 * x[1] + sp.sin(x[0] + u) / 2, -x[2] / 2 - x[1] / 4 + u, -sp.sin(x[2]) - x[1] / 3 - x[0]]
    return hg.System("mixed", states=x, inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[3 * x[0] + u])


@cache
def form(name: str) -> hg.Form:
    plants = {"hyperjerk": lambda: model("hyperjerk"), "pendulum": lambda: model("pendulum"), "mixed": mixed}
    return hg.forms.triangular(plants[name]() if name in plants else chain(int(name)))


def build(name: str = "hyperjerk", **changes: Any) -> hg.Observer:
    return hg.observers.cascade(form(name), **{"theta": 100, **changes})


def core(observer: hg.Observer) -> np.ndarray:
    return core_numbers(observer.parts[0], 1, nominal(observer))


@cache
def orbit(dt: float, duration: float) -> np.ndarray:
    """The hyperjerk's bounded orbit."""

    def rate(t: float, x: np.ndarray) -> list[float]:
        return [x[1], x[2], x[3], -x[3] - 5.2 * x[2] - 2.7 * x[1] + 4.5 * (x[0] ** 2 - 1)]

    t = np.arange(round(duration / dt) + 1) * dt
    return solve_ivp(rate, (0, t[-1]), [-0.9, 0, 0, 0], method="DOP853", t_eval=t, rtol=1e-12, atol=1e-12).y.T


# --- the linear error core ----------------------------------------------------------------------------------


@given(
    st.lists(st.floats(0.2, 4.0), min_size=0, max_size=3), st.floats(0.2, 3.0), st.floats(0.0, 3.0), st.floats(1, 50)
)
@settings(deadline=None, max_examples=25)
def test_the_core_has_the_poles_it_was_given(stages: list[float], x: float, y: float, theta: float) -> None:
    poles = [complex(-x, y), complex(-x, -y), *(-p for p in stages)]
    matrix = core(build(str(len(poles)), theta=theta, poles=poles))
    expected = np.poly(theta * np.array(poles)).real
    assert np.poly(matrix) == pytest.approx(expected, rel=1e-8, abs=1e-10 * np.abs(expected).max())


def test_the_default_puts_every_pole_at_minus_theta() -> None:
    """Block triangular, [[-2, 1], [-1, 0]] and ones: checked entry by entry, in powers of theta = 2."""
    expected = [[-4, 2 / 2, 0, 0], [-4, 0, 0, 0], [0, 2, -2, 0], [0, 4, -4, -2]]
    assert core(build("4", theta=2)) == pytest.approx(np.array(expected), rel=1e-15)


# --- the order of the error ---------------------------------------------------------------------------------


def errors(theta: float, **changes: Any) -> np.ndarray:
    """The largest errors from t = 2 on, when the start is forgotten."""
    dt = 0.1 / 800
    x = orbit(dt, 6.0)
    step = hg.sample(build(theta=theta, initial=(1, -2, 3, -4), **changes), hg.methods.rk4, dt=dt)
    return np.abs(step.run(y=x[:, 0]).x - x)[round(2 / dt) :].max(axis=0)


@pytest.mark.full
def test_the_error_halves_with_mu_and_is_i_mu_times_the_rate() -> None:
    """Unsaturated, xhat_i = s^(i-1)/(mu s + 1)^i y: a delay of i mu up to terms of mu^2; xhat_1 errs by mu^2 x_3."""
    dt = 0.1 / 800
    x = orbit(dt, 6.0)[round(2 / dt) :]
    phi = -x[:, 3] - 5.2 * x[:, 2] - 2.7 * x[:, 1] + 4.5 * (x[:, 0] ** 2 - 1)
    largest = np.abs(np.column_stack([x[:, 1:], phi])).max(axis=0)
    by_mu = {mu: errors(1 / mu) for mu in (0.02, 0.01, 0.005)}
    for mu, error in by_mu.items():
        assert error[1:] == pytest.approx(mu * np.array([2, 3, 4]) * largest[1:], rel=5 * mu)
        assert error[0] == pytest.approx(mu**2 * largest[1], rel=5 * mu)
    for coarse, fine in ((0.02, 0.01), (0.01, 0.005)):
        assert by_mu[coarse][1:] / by_mu[fine][1:] == pytest.approx(2, rel=0.05)


def test_no_estimate_leaves_its_range() -> None:
    """However far off the start is, and however large theta."""
    x = orbit(1e-4, 0.5)
    for theta in (50, 500):
        step = hg.sample(build(theta=theta, initial=(-3, 4, -6, 12)), hg.methods.rk4, dt=1e-4)
        estimates = step.run(y=x[:, 0]).x
        assert (np.abs(estimates[:, 1:]) <= [4, 6, 12]).all()
        assert np.abs(estimates[-1] - x[-1]).max() < 20 / theta


# --- agreement with the oracle ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["hyperjerk", "mixed"])
def test_the_step_is_the_oracles(name: str) -> None:
    """In the paper's coordinates, through saturations and missing samples: rounding only, some theta^3 eps."""
    if name == "hyperjerk":
        low, high, scale = np.array([-3.0, -4, -6, -12]), np.array([3.0, 4, 6, 12]), np.ones(4)
        c = lambda w, u: np.zeros(4)  # noqa: E731
    else:  # z = (x1, x2, -x3), w = (3 z1, 6 z2, 3 z3)
        low, high, scale = np.array([-9.0, -18, -12]), np.array([12.0, 24, 9]), np.array([3.0, 6, -3])

        def c(w: np.ndarray, u: np.ndarray) -> np.ndarray:
            x = np.clip(w, low, high) / scale
            return scale * [np.sin(x[0] + u[0]) / 2, -x[1] / 4 + u[0], 0]

    n, dt, theta, samples = len(scale), 2e-3, 40.0, 600
    alpha, at = np.array([2.5, 1.2, 1.5, 0.8])[:n], np.array([2.5, -2, 1, -4])[:n]
    y = (2 if n == 4 else 9) * np.sin(np.arange(samples) * dt * 4)[:, None]
    u = np.cos(np.arange(samples) * dt)[:, None] if n == 3 else np.zeros((samples, 0))
    y[[100, 101, 300], 0] = NAN
    step = hg.sample(build(name, theta=theta, gains=alpha, initial=tuple(at)), hg.methods.rk4, dt=dt)
    result = step.run(y=y[:, 0], **({"u": u[:, 0]} if n == 3 else {}), engine="python")
    rate = oracle.cascade(alpha, 1 / theta, c, low, high)
    begin = oracle.start(scale * at, alpha, 1 / theta, c, np.zeros(u.shape[1]))
    states = run(lambda z, y_, valid, u_: rate(z, y_ - u_.sum(), valid, u_), begin, y, dt, u)
    every = zip(states, u, strict=True)
    expected = np.array([oracle.estimate(z, alpha, 1 / theta, c, low, high, v) for z, v in every]) / scale
    assert not any("LIMITED" in flag for status in set(result.status.tolist()) for flag in step.flags(status))
    assert result.x == pytest.approx(expected, abs=1e-9)
    assert (expected * scale == high).any()
    if n == 4:  # the input of the other is not at rest at first
        assert result.x[0] == pytest.approx(at, abs=1e-9)


@pytest.mark.ordinary("double")
@pytest.mark.parametrize("real", ["float", "double"])
def test_the_c_is_the_program(real: Any) -> None:
    step = hg.sample(build("mixed", theta=10), hg.methods.rk4, dt=0.01)
    assert "64 samples as recorded" in native.run_check(hg.targets.c99(step, real=real))


def test_a_large_first_row_does_not_meet_the_outer_box() -> None:
    """x1' = x2 - 200 x1 + 200 u, where v_2 estimates x_1', far beyond the range of x2 times theta."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)
    u = hg.Signal("u", low=-1, high=1)
    data = {"states": (x1, x2), "inputs": (u,), "outputs": [hg.Signal("y")], "output": [x1]}
    plant = hg.System("stiff", **data, flow=[x2 - 200 * x1 + 200 * u, -x1])
    observer = hg.observers.cascade(hg.forms.triangular(plant), theta=2)
    (field,) = observer.parts[0].fields
    assert field.low[1] <= -403
    assert field.high[1] >= 403


# --- what is said, and what is refused ----------------------------------------------------------------------


def test_the_theorem_says_that_the_error_stays() -> None:
    observer = build()
    assert "never 0" in observer.theorem.conclusion
    standings = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert standings["every alpha_i is positive"] == "proved"


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"theta": 0.5}, BadGain, r"theta = 0\.5 must be a finite number, at least 1"),
        ({"gains": (2, 1, 1)}, BadGain, r"gains = \(2, 1, 1\) must be 4 positive numbers, one for each state"),
        ({"gains": (2, 1, 1, 0)}, BadGain, "must be 4 positive numbers"),
        ({"gains": (2, 1, 1, NAN)}, BadGain, "must be 4 positive numbers"),
        ({"gains": (2, 1, 1, 1), "poles": (-1,) * 4}, BadGain, "takes gains or poles, not both; leave one out"),
        ({"poles": (-1, -1, -1)}, BadPoles, "there are 3, the form has 4 states"),
        ({"poles": (-1, -1, -1, 1)}, BadPoles, "is not in the open left half plane"),
        ({"poles": (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)}, BadPoles, "one pair at most may be complex"),
        ({"poles": (-1, -1, -1, -1 + 1j)}, BadPoles, "complex poles must come in conjugate pairs"),
    ],
)
def test_bad_gains(changes: dict[str, Any], error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        build(**changes)


def test_forms_it_does_not_take() -> None:
    with pytest.raises(BadGain, match="cascade wants at least two states, chain1 has 1; use high_gain"):
        build("1")
    with pytest.raises(BadGain, match="takes one output, two has 2; use riccati"):
        hg.observers.cascade(hg.forms.original(two_outputs()), theta=2)
    with pytest.raises(BadGain, match=r"a_2 = -u depends on the input"):
        hg.observers.cascade(fitzhugh_nagumo().form, theta=2, accept="triangular.a_2")
    late = hg.forms.triangular(chain(2))
    late = replace(late, b=(late.states[1] ** 2, late.b[1]))
    with pytest.raises(BadGain, match=r"b_1 = z2\*\*2 reads a state after z1; use the form phase"):
        hg.observers.cascade(late, theta=2)
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2")
    plant = hg.System("loose", states=(x1, x2), outputs=[hg.Signal("y")], flow=[x2, -sp.sin(x1)], output=[x1])
    with pytest.raises(BadGain, match="cascade saturates the estimate of x2 which has no range; declare low and high"):
        hg.observers.cascade(hg.forms.triangular(plant), theta=2)
