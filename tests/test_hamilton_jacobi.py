"""The minimum-energy estimator against the extended Kalman filter of inverse weights, its own equations, and theory."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from native_step import NativeStep
from oracle.hamilton_jacobi import Estimator, Model
from plants import model, two_outputs

import hgogen as hg
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.reading.given import BadGain
from hgogen.step import StepTooLong
from tests.sweep import by_turns

NAN = float("nan")
METHODS = ("rk4", "rk4_covariance", "continuous_discrete", "heun", "euler")
Q = np.array([[2.0, 0.3, 0.1], [0.3, 1.5, -0.2], [0.1, -0.2, 3.0]])


@cache
def forms() -> dict[str, Form]:
    return {
        "triangular": hg.forms.triangular(model("fitzhugh_nagumo")),
        "several outputs": hg.forms.original(two_outputs()),
        "curved": hg.forms.original(curved()),
    }


def accept(form: Form) -> list[str]:
    return [check.id for check in form.checks if check.verdict is Verdict.REFUTED]


def curved() -> hg.System:
    """Two outputs, both nonlinear in the state: their second derivatives count."""
    x1, x2 = (hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2))
    y1, y2 = hg.Signal("y1"), hg.Signal("y2")
    return hg.System(
        "curved",
        states=(x1, x2),
        outputs=(y1, y2),
        flow=[x2, -sp.sin(x1) - x2 / 5],
        output=[x1 + x1 * x2 / 4 + x2**2 / 8, sp.cos(x1)],
    )


CURVED = Model(
    f=lambda x: np.array([x[1], -np.sin(x[0]) - x[1] / 5]),
    f_x=lambda x: np.array([[0, 1], [-np.cos(x[0]), -1 / 5]]),
    h=lambda x: np.array([x[0] + x[0] * x[1] / 4 + x[1] ** 2 / 8, np.cos(x[0])]),
    h_x=lambda x: np.array([[1 + x[1] / 4, x[0] / 4 + x[1] / 4], [-np.sin(x[0]), 0]]),
    h_xx=lambda x: np.array([[[0, 1 / 4], [1 / 4, 1 / 4]], [[-np.cos(x[0]), 0], [0, 0]]]),
)


def swing(count: int, dt: float) -> np.ndarray:
    """The outputs of `curved` from (1, 0), by small Euler steps: any smooth record would do."""
    x, rows = np.array([1.0, 0.0]), []
    for _ in range(count):
        rows.append(CURVED.h(x))
        for _ in range(20):
            x = x + dt / 20 * CURVED.f(x)
    return np.array(rows)


# --- an extended Kalman filter of inverse weights -----------------------------------------------------------


@pytest.mark.ordinary("euler-triangular")
@pytest.mark.parametrize(("method", "name"), by_turns(METHODS, ["triangular", "several outputs"]))
def test_for_linear_outputs_it_is_the_kalman_filter_of_inverse_weights(method: str, name: str) -> None:
    """To the rounding of two inverses (condition below 10) and of some hundred contracting steps."""
    form, P0 = forms()[name], np.diag([1.0, 2.0, 4.0])
    R = np.array([3.0] if len(form.output) == 1 else [3.0, 5.0])
    filters = [
        hg.observers.hamilton_jacobi(form, Q=Q, R=R, P0=P0, curvature=7.0, accept=accept(form)),
        hg.observers.riccati(form, Q=np.linalg.inv(Q), R=1 / R, covariance=np.linalg.inv(P0), accept=accept(form)),
    ]
    t = np.arange(300) * 0.01
    y = np.cos(t)[:, None] * np.ones(len(R))
    y[40:60] = NAN
    runs = [hg.sample(each, getattr(hg.methods, method), dt=0.01).run(u=np.sin(t), y=y) for each in filters]
    assert runs[0].x == pytest.approx(runs[1].x, rel=1e-11, abs=1e-12)
    assert np.ptp(runs[0].x[:, 2]) > 1e-2  # it moves


@cache
def line(dt: float) -> NativeStep:
    """x' = a x, y = x."""
    x, y = hg.Signal("x", low=-1000, high=1000), hg.Signal("y")
    a = hg.Signal("a", nominal=0, low=-3, high=3)
    plant = hg.System("line", states=(x,), outputs=(y,), parameters=(a,), flow=[a * x], output=[x])
    observer = hg.observers.hamilton_jacobi(hg.forms.original(plant), Q=[1.0], R=1.0, initial=[1.0])
    assert observer.checks[-1].verdict is Verdict.PROVED  # the model is linear
    return NativeStep(hg.sample(observer, hg.methods.rk4, dt=dt), "double")


@given(st.floats(-3.0, 3.0), st.floats(0.3, 3.0), st.floats(0.3, 3.0))
@settings(deadline=None, max_examples=25)
def test_of_a_scalar_model_the_weight_settles_where_its_equation_says(a: float, q: float, r: float) -> None:
    """0 = -2 a Pi - Pi^2/q + r, and the error decays with the rate a - r/Pi = -sqrt(a^2 + r/q)."""
    dt, rate = 1e-3, np.sqrt(a * a + r / q)
    step = line(dt)
    step.params["plant"]["a"], step.params["gain"]["Q"], step.params["gain"]["R"] = a, q, r
    assert not step.tune()
    step.reset()
    step.run(np.zeros((1, 0)), np.zeros((1, 1)))
    x = step.run(np.zeros((1, 0)), np.zeros((round(12 / rate / dt), 1))).x[:, 0]
    assert step.state["S"][0] == pytest.approx(-a * q + q * rate, rel=1e-6)  # e^-24 left of the start
    assert x[-1] / x[-2] == pytest.approx(np.exp(-rate * dt), rel=1e-6)  # RK4: (rate dt)^5/120 < 1e-12


# --- the second derivatives of the outputs ------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.0, 0.5, 50.0])
def test_its_equations_in_plain_numpy(rate: float) -> None:
    """The same Runge-Kutta steps, so to rounding; a rate that limits the term, and one that seldom does."""
    form, dt = forms()["curved"], 0.01
    weights = np.array([[1.0, 0.2], [0.2, 2.0]]), np.diag([3.0, 2.0]), np.diag([1.0, 0.5])
    R = np.diag(weights[1])
    observer = hg.observers.hamilton_jacobi(form, Q=weights[0], R=R, P0=weights[2], curvature=rate, initial=[0.2, 0.5])
    step, y = hg.sample(observer, hg.methods.rk4, dt=dt), swing(300, dt)
    x, Pi = Estimator(CURVED, weights[0], weights[1], rate).run(np.array([0.2, 0.5]), weights[2], y, dt)
    compiled = NativeStep(step, "double")
    assert compiled.run(np.zeros((300, 0)), y).x == pytest.approx(x, rel=1e-11, abs=1e-12)
    assert compiled.state["S"][0] == pytest.approx(Pi[-1][[0, 1, 1], [0, 0, 1]], rel=1e-10)


@pytest.mark.full
def test_the_term_counts() -> None:
    form, y = forms()["curved"], swing(300, 0.01)
    runs = [
        hg.sample(hg.observers.hamilton_jacobi(form, Q=[1, 2], R=3, curvature=rate), hg.methods.rk4, dt=0.01).run(y=y).x
        for rate in (0.0, 0.5, 50.0)
    ]
    assert np.abs(runs[0] - runs[1]).max() > 1e-3
    assert np.abs(runs[1] - runs[2]).max() > 1e-3


@pytest.mark.full
def test_it_is_the_same_in_both_views() -> None:
    """Pi and P = Pi^-1, to the error of the method, which falls by 16 with half the step."""
    observer, gaps = hg.observers.hamilton_jacobi(forms()["curved"], Q=[1, 2], R=3, curvature=50.0), []
    for dt in (8e-3, 4e-3):
        y = swing(round(2 / dt), dt)
        runs = [hg.sample(observer, m, dt=dt).run(y=y).x for m in (hg.methods.rk4, hg.methods.rk4_covariance)]
        gaps.append(np.abs(runs[0] - runs[1]).max())
    assert 1e-13 < gaps[1] < gaps[0] / 10 < 1e-6


FASTEST = 20.0


@cache
def square(method: str) -> NativeStep:
    """x' = 0, y = x^2."""
    x, y = hg.Signal("x", low=-4, high=4), hg.Signal("y", low=-100, high=100)
    plant = hg.System("square", states=(x,), outputs=(y,), flow=[0 * x], output=[x**2])
    observer = hg.observers.hamilton_jacobi(hg.forms.original(plant), Q=[1.0], R=1.0, curvature=FASTEST)
    return NativeStep(hg.sample(observer, getattr(hg.methods, method), dt=0.01), "double")


@pytest.mark.full
@given(st.floats(1e-3, FASTEST), st.floats(-4.0, 4.0), st.floats(-90.0, 90.0), st.sampled_from(["S", "P"]))
@settings(deadline=None, max_examples=50)
def test_it_stays_positive_definite_whatever_the_error(rate: float, start: float, y: float, view: str) -> None:
    step = square("rk4" if view == "S" else "rk4_covariance")
    step.params["gain"]["curvature"] = rate
    assert not step.tune()
    step.reset()
    step.state["z"] = start
    for _ in range(60):
        run = step.run(np.zeros((1, 0)), np.full((1, 1), y))
        assert 0 < step.state[view][0] < np.inf
        assert np.isfinite(run.x).all()


def test_a_covariance_that_a_step_loses_restarts() -> None:
    """At x = 0 nothing is seen and P grows like exp(7 t), x with it, until one step is too long for what is seen."""
    step = square("rk4_covariance")
    step.params["gain"]["curvature"] = 7.0
    step.tune()
    step.reset()
    step.state["z"] = 1e-38
    run = step.run(np.zeros((200, 0)), np.full((200, 1), 5.0))
    bit = next(1 << k for k, b in enumerate(step.step.layout.bits) if b.name == "COVARIANCE_RESTARTED")
    assert (run.status & bit).any()
    assert not (run.status[-50:] & bit).any()
    assert abs(run.x[-1, 0]) == pytest.approx(np.sqrt(5), rel=1e-3)


def test_without_the_limit_it_would_not() -> None:
    """Pi' = -Pi^2/Q + 4 x^2 R - 2 R (y - x^2) from Pi = 1, x = 0, y = 5: below zero at once."""
    scalar = Model(
        f=lambda x: 0 * x,
        f_x=lambda x: np.zeros((1, 1)),
        h=lambda x: x**2,
        h_x=lambda x: 2 * x.reshape(1, 1),
        h_xx=lambda x: np.full((1, 1, 1), 2.0),
    )
    one, y = np.ones((1, 1)), np.full((40, 1), 5.0)
    assert Estimator(scalar, one, one, None).run(np.zeros(1), one, y, 0.01)[1].min() < 0
    assert Estimator(scalar, one, one, 3.0).run(np.zeros(1), one, y, 0.01)[1].min() > 0


def test_a_step_that_could_take_all_is_refused() -> None:
    observer = hg.observers.hamilton_jacobi(forms()["curved"], Q=[1, 2], R=3, curvature=1000.0)
    with pytest.raises(StepTooLong, match=r"second derivatives of the output.*dt <= 0.001"):
        hg.sample(observer, hg.methods.rk4, dt=2e-3)
    slow = hg.observers.hamilton_jacobi(forms()["curved"], Q=[1, 2], R=3, curvature=1e-3)
    for method in (hg.methods.rk4_covariance, hg.methods.continuous_discrete):  # the latter is the former here
        with pytest.raises(StepTooLong, match=r"admits the longest, the covariance .*\(theta = 1\); take dt") as caught:
            hg.sample(slow, method, dt=50.0)
        assert "continuous_discrete" not in str(caught.value).partition(": ")[2]


# --- as a step ----------------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("method", ["rk4", "continuous_discrete"])
def test_c_is_python(method: str) -> None:
    """To the rounding of two libraries' sine; with samples missing, and one output alone."""
    observer = hg.observers.hamilton_jacobi(forms()["curved"], Q=[1, 2], R=3, curvature=5.0)
    step, y = hg.sample(observer, getattr(hg.methods, method), dt=5e-3), swing(200, 5e-3)
    y[50:80], y[100:120, 1] = NAN, NAN
    x = NativeStep(step, "double").run(np.zeros((200, 0)), y).x
    assert x == pytest.approx(step.run(y=y, engine="python").x, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize(
    "jumps", [lambda x: sp.Piecewise((1, x > 0), (-1, True)), lambda x: sp.atan(sp.tan(x))], ids=["piecewise", "pole"]
)
def test_a_model_that_jumps_is_not_affine(jumps: Callable[[Any], Any]) -> None:
    """The derivative of a Piecewise of constants is 0 wherever it is not asked, that of atan(tan(x1)) is 1."""
    x1, x2 = (hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2))
    flow = [x2, -x1 + jumps(x1)]
    form = hg.forms.original(hg.System("jumps", states=(x1, x2), outputs=(hg.Signal("y"),), flow=flow, output=[x1]))
    built = hg.observers.hamilton_jacobi(form, Q=(1, 1), R=1.0, accept=accept(form))
    assert {c.id: c.verdict for c in built.checks}["hamilton_jacobi.quadratic"] is Verdict.UNKNOWN


def test_a_bad_first_estimate_is_left_behind() -> None:
    y = swing(1500, 0.01)
    observer = hg.observers.hamilton_jacobi(forms()["curved"], Q=[1, 2], R=30, curvature=20.0, initial=[-0.5, 1.0])
    run = hg.sample(observer, hg.methods.rk4, dt=0.01).run(y=y)
    errors = np.abs(np.array([CURVED.h(x) for x in run.x]) - y).max(axis=1)
    assert errors[-200:].max() < 1e-2 * errors[0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"Q": [1, 2]}, "Q of shape .* diagonal of 3 numbers"),
        ({"Q": [1, 0, 1]}, "Q must be positive definite"),
        ({"R": 0}, "R = 0 must be positive"),
        ({"R": [1, 2]}, "R of shape .* one number for each of 1 outputs"),
        ({"P0": np.eye(2)}, "P0 of shape"),
        ({"P0": [1, 1, NAN]}, "P0 must be finite"),
        ({"curvature": -1}, "curvature = -1 must be a finite rate"),
        ({"curvature": NAN}, "curvature = nan must be a finite rate"),
        ({"curvature": "much"}, "curvature = 'much' must be a number"),
        ({"initial": [0, 0]}, "initial of length 2"),
    ],
)
def test_bad_weights_are_refused_with_a_sentence(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=said):
        hg.observers.hamilton_jacobi(
            forms()["triangular"], **{"Q": [1, 1, 1], "R": 1, "accept": "triangular.a_2", **changes}
        )


def test_what_is_no_form_is_refused() -> None:
    with pytest.raises(BadGain, match="takes a form"):
        hg.observers.hamilton_jacobi(two_outputs(), Q=[1, 1, 1], R=1)


def test_of_an_angle_and_of_a_projected_estimate_the_cost_is_not_known_to_be_least() -> None:
    turn = {"period": 2 * sp.pi}
    th, yt, u = hg.Signal("th", **turn), hg.Signal("yt", **turn), hg.Signal("u", low=-1, high=1)
    c, s = (hg.Signal(name, low=-2, high=2) for name in "cs")
    compass = hg.System("compass", states=(th,), inputs=(u,), outputs=(yt,), flow=[u], output=[th])
    circle = hg.System(
        "circle", states=(c, s), outputs=(hg.Signal("y"),), flow=[s, -c], output=[c], invariants=[c**2 + s**2 - 1]
    )
    for plant in (compass, circle):
        built = hg.observers.hamilton_jacobi(hg.forms.original(plant), Q=[1] * len(plant.states), R=1)
        assert {check.id: check.verdict for check in built.checks}["hamilton_jacobi.quadratic"] is Verdict.UNKNOWN
