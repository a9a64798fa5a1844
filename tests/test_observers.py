"""Observers: theta's law, the innovation, and the filter against textbook ones in plain numpy."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import adaptive_ekf as oracle
from oracle import fitzhugh_nagumo as trial
from plants import chain, fitzhugh_nagumo, model, pendulum, two_outputs
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.check import Refuted, UnknownCheck, Verdict
from hgogen.emit.cost import cost
from hgogen.estimators.core import core_numbers, nominal
from hgogen.estimators.gains import BadPoles, coefficients
from hgogen.estimators.innovation import BadWindow, BadWindowSize
from hgogen.estimators.theta import rise
from hgogen.forms.uniform_chain import NoUniformChain
from hgogen.model import load
from hgogen.part import Clock
from hgogen.program import Place
from hgogen.prove.convergence import unknown_checks
from hgogen.reading.given import BadGain, BadNames
from hgogen.rigor.definite import NotHurwitz
from hgogen.sentence import because

NAN = float("nan")
MODELS = Path(__file__).resolve().parents[1] / "models"
EPS = np.finfo(float).eps

# --- theta --------------------------------------------------------------------------------------------------

thetas_1 = st.floats(1.0, 50.0)
shares = st.floats(0.0, 1.0)
times = st.floats(1e-4, 10.0)


def adaptive(theta_1: float = 4.0, **changes: Any) -> hg.theta.Adaptive:
    return hg.theta.adaptive(theta_1, **{"mu": (0.16, 0.32), "innovation": hg.innovation.staggered(1.0), **changes})


@cache
def law(theta: hg.theta.Adaptive, dt: float) -> Callable[[float, float], float]:
    """The law as the step has it: theta after a sample, of theta and the innovation. Where theta is said to rest, the
    law that is left out changes no bit."""
    share, rest, moving = theta.parts(None, None)[-1].build(Clock(dt, "line", 1, 1)).adapt
    gains = {Place("gain", g.name): g.initial[0] for g in theta.gains}

    def after(value: float, innovation: float) -> float:
        memory = {**gains, Place("state", "theta"): value, Place("state", "innovation"): innovation}
        for block in (share, rest, *moving.body):
            results = block.graph.call([memory[place] for place, _ in block.reads])
            memory |= {place: float(result) for (place, _), result in zip(block.written, results, strict=False)}
        assert memory[moving.flag] or memory[Place("state", "theta")] == value
        return memory[Place("state", "theta")]

    return after


@given(thetas_1, shares, times)
@settings(deadline=None, max_examples=60)
def test_the_rise_is_the_flow_of_its_law(theta_1: float, share: float, s: float) -> None:
    """Against a fine integration, stopped at theta_1 where the right-hand side has its kink."""
    start = 1 + share * (2 * theta_1 - 1)
    options = {"rtol": 1e-12, "atol": 1e-12, "method": "DOP853"}
    theta, left = start, s
    if start < theta_1:
        reached = lambda t, theta: theta[0] - theta_1  # noqa: E731
        reached.terminal = True
        below = solve_ivp(lambda t, theta: theta**2, (0, s), [start], events=reached, **options)
        theta, left = below.y[0, -1], s - below.t[-1]
    if left > 0:
        above = solve_ivp(lambda t, theta: (2 * theta_1 - theta) ** 2, (0, left), [theta], **options)
        theta = above.y[0, -1]
    assert float(rise(start, s, theta_1)) == pytest.approx(theta, rel=1e-8)


@given(thetas_1, shares, st.floats(1e-4, 100.0), st.lists(st.floats(0.0, 1e6), min_size=2, max_size=5))
@settings(deadline=None, max_examples=60)
def test_theta_stays_in_its_range_and_grows_with_the_innovation(
    theta_1: float, share: float, dt: float, innovations: list[float]
) -> None:
    after, start = law(adaptive(theta_1), dt), 1 + share * (2 * theta_1 - 1)
    thetas = [after(start, innovation) for innovation in sorted(innovations)]
    assert all(1 <= theta <= 2 * theta_1 for theta in thetas)
    assert all(b >= a * (1 - 8 * EPS) for a, b in pairwise(thetas))


@given(shares, st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=40)
def test_the_logistic_keeps_the_range_too(share: float, innovation: float) -> None:
    after = law(adaptive(mu=hg.theta.logistic(0.16, 500.0)), 0.01)
    assert 1 <= after(1 + 7 * share, innovation) <= 8


def test_a_logistic_that_is_never_0_holds_theta_above_1() -> None:
    """theta - 1 = mu/(lambda Delta T) at rest, to the share lambda dt/2 + 2 mu/(lambda Delta T) = .6%."""
    mu = 1 / (1 + np.exp(10))
    after, theta = law(adaptive(mu=hg.theta.logistic(0.2, 50.0), rise_time=0.1, rate=1.0), 0.01), 1.0
    for _ in range(1500):  # exp(-15) of the start is left
        theta = after(theta, 0.0)
    assert theta - 1 == pytest.approx(mu / (1.0 * 0.1), rel=0.006)


def test_a_sample_of_theta_by_hand() -> None:
    """Below gamma_0 theta decays by exp(-rate dt), above gamma_1 it only rises; half way mu = 1/2."""
    after = law(adaptive(rise_time=0.1, rate=1.0), 0.01)
    assert after(2.0, 0.1) == pytest.approx(1 + np.exp(-0.01), rel=1e-14)
    assert after(2.0, 0.5) == pytest.approx(1 / (1 / 2 - 0.1), rel=1e-14)
    assert after(3.0, 0.5) == pytest.approx(8 - 4 / (1 + 4 * (0.1 - 1 / 12)), rel=1e-14)  # 1/12 to reach theta_1
    assert after(5.0, 0.5) == pytest.approx(8 - 3 / (1 + 0.3), rel=1e-14)
    half = 1 / (1 / 2 - 0.05)
    assert after(2.0, 0.24) == pytest.approx(1 + (half - 1) * np.exp(-0.005), rel=1e-14)
    assert law(adaptive(mu=hg.theta.logistic(0.2, 10.0)), 0.01)(2.0, 0.2) == pytest.approx(after(2.0, 0.24), rel=1e-14)
    assert after(1.0, 0.0) == 1.0


def test_thresholds_as_a_pair_are_a_smoothstep() -> None:
    assert adaptive(mu=(0.16, 0.32)) == adaptive(mu=hg.theta.smoothstep(0.16, 0.32))


def test_a_decaying_theta_decays_exactly() -> None:
    step = hg.sample(fitzhugh_nagumo(theta=hg.theta.decaying(5.0, rate=0.7)), dt=0.1)
    run = step.run(u=np.zeros(30), y=np.zeros(30), engine="python")
    assert run.traces["theta"] == pytest.approx(1 + 4 * np.exp(-0.7 * run.t), rel=1e-13)


# --- innovation ---------------------------------------------------------------------------------------------


def smooth(dt: float, duration: float) -> dict[str, np.ndarray]:
    t = np.arange(round(duration / dt) + 1) * dt
    return {"u": 0.5 * np.sin(t), "y": 1.5 * np.cos(0.7 * t + 0.3)}


def innovations(innovation: object, dt: float, **record: np.ndarray) -> tuple[hg.Run, np.ndarray]:
    """With thresholds out of reach, so that theta rests at 1 and the estimates are the same for all."""
    step = hg.sample(fitzhugh_nagumo(theta=adaptive(mu=(1e3, 2e3), innovation=innovation)), dt=dt)
    run = step.run(**record, engine="python")
    assert (run.traces["theta"] == 1).all()
    return run, run.traces["innovation"]


def test_the_window_is_the_papers_integral() -> None:
    """Heun from the run's own estimate d ago, in plain numpy."""
    dt, N = 0.05, 10
    record = smooth(dt, 3.0)
    run, integrals = innovations(hg.innovation.window(0.5), dt, **record)
    f = trial.form().f
    for k in range(N + 1, len(run.t)):
        z, total = run.x[k - N] * [1, 1, -1], 0.0
        for i in range(k - N + 1, k + 1):
            k1 = f(z, record["u"][i - 1])
            k2 = f(z + dt * k1, record["u"][i])
            z = z + dt / 2 * (k1 + k2)
            total += dt * (record["y"][i] - z[0]) ** 2
        assert integrals[k] == pytest.approx(total, rel=1e-12)


@pytest.mark.full
def test_window_and_staggered_agree_on_smooth_data() -> None:
    """As many predictors as samples in the window: the oldest is one sample older than the window, an error of order 1.

    With few predictors its age is up to d (1 + 1/M), and on data that rise and fall once a window that is within 1/M.
    """
    differences = []
    for dt in (0.05, 0.025):
        record, N = smooth(dt, 6.0), round(0.5 / dt)
        _, window = innovations(hg.innovation.window(0.5), dt, **record)
        _, staggered = innovations(hg.innovation.staggered(0.5, predictors=N), dt, **record)
        differences.append(np.abs(staggered - window)[2 * N :].max())
        _, few = innovations(hg.innovation.staggered(0.5, predictors=5), dt, **record)
        assert np.abs(few - window)[2 * N :].max() < window.max() / 5
    assert np.log2(differences[0] / differences[1]) == pytest.approx(1, abs=0.3)


def test_what_each_costs() -> None:
    """The neuron has one sine, a Runge-Kutta step four: 400 for a window of N = 100 samples, 4 for each of M = 4
    predictors, beside the filter's own and an exponential of theta."""
    plain = cost(hg.sample(fitzhugh_nagumo(), dt=0.01)).functions
    for innovation, sines in (
        (hg.innovation.window(1.0, method=hg.methods.rk4), 400),
        (hg.innovation.staggered(1.0, predictors=4, method=hg.methods.rk4), 5 * 4),
    ):
        step = hg.sample(fitzhugh_nagumo(theta=adaptive(innovation=innovation)), dt=0.01)
        assert cost(step).functions - plain == sines + 1


@pytest.mark.parametrize("way", ["window", "staggered"])
def test_missing_samples_are_not_counted(way: str) -> None:
    """A plant at rest, an observer that does not follow: each valid sample adds dt, missing ones nothing, and the
    staggered sum is scaled down to the window by its valid samples, never up."""
    x, y = hg.Signal("x", low=-2, high=2), hg.Signal("y", low=-2, high=2)
    plant = hg.System("rest", states=(x,), outputs=(y,), flow=[0], output=[x])
    innovation = hg.innovation.window(1.0) if way == "window" else hg.innovation.staggered(1.0, predictors=2)
    theta = adaptive(mu=(1e3, 2e3), innovation=innovation)
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=(1e-12,), R=1e12, covariance=(1e-12,), theta=theta)
    y_ = np.ones(100)
    y_[::2] = NAN
    step = hg.sample(observer, dt=0.1)
    run = step.run(y=y_, engine="python")
    innovation_ = run.traces["innovation"][20:]
    if way == "window":  # 10 samples, of which 5 count
        assert innovation_ == pytest.approx(0.5, abs=1e-9)
    else:  # the oldest has 11 to 15 samples, of which 5 to 8 count: fewer than 10
        assert innovation_.min() == pytest.approx(0.5, abs=1e-9)
        assert innovation_.max() == pytest.approx(0.8, abs=1e-9)
    step.reset()
    full = step.run(y=np.ones(100), engine="python").traces["innovation"][20:]
    assert full == pytest.approx(1.0, abs=1e-9)


@pytest.mark.full
def test_the_adaptive_filter_is_the_oracles() -> None:
    """Two thousand samples of the reference trial, noise included: rounding only, until theta falls from its peak."""
    t, x = trial.times(trial.FIRST)[:2000], trial.truth(trial.FIRST)[:2000]
    u, y = np.sin(t), x[:, 0] + trial.noise(range(1), 2000)[0]
    expected = oracle.run(trial.observer(trial.adaptive(), oracle.Staggered(1.0, 4)), u, y[None])
    step = hg.sample(fitzhugh_nagumo(theta=adaptive()), dt=0.01)
    run = step.run(u=u, y=y, engine="python")
    assert run.traces["theta"].max() > 7.9
    assert run.traces["theta"] == pytest.approx(expected.theta[0], abs=1e-11)
    assert run.traces["innovation"] == pytest.approx(expected.innovation[0], abs=1e-11)
    assert run.x * [1, 1, -1] == pytest.approx(expected.z[0], abs=1e-11)


# --- against textbook filters -------------------------------------------------------------------------------


def textbook(
    f: Callable[[np.ndarray, float], np.ndarray],
    F: Callable[[np.ndarray, float], np.ndarray],
    C: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    dt: float,
    u: np.ndarray,
    y: np.ndarray,
) -> np.ndarray:
    """The extended Kalman filter with all valid outputs at once, P in full; z(0) = 0, P(0) = 1."""
    z, P, estimates = np.zeros(len(Q)), np.eye(len(Q)), []
    for k in range(len(y)):
        if k:
            before, now, middle = u[k - 1], u[k], (u[k - 1] + u[k]) / 2
            k1 = f(z, before)
            k2 = f(z + dt / 2 * k1, middle)
            centre = z + dt / 2 * k2
            k3 = f(centre, middle)
            z = z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + dt * k3, now))
            Phi = np.eye(len(Q)) + dt * F(centre, middle) @ (np.eye(len(Q)) + dt / 2 * F(centre, middle))
            P = Phi @ P @ Phi.T + dt * Q
        valid = np.isfinite(y[k])
        c = C[valid]
        K = P @ c.T @ np.linalg.inv(c @ P @ c.T + np.diag(R[valid]) / dt)
        z, P = z + K @ (y[k][valid] - c @ z), P - K @ c @ P
        estimates.append(z)
    return np.array(estimates)


FULL = np.array([[0.1, 0.01, 0.0], [0.01, 0.02, -0.001], [0.0, -0.001, 0.005]])


@pytest.mark.parametrize("Q", [np.diag([0.1, 0.01, 2.3e-4]), FULL], ids=["diagonal", "full"])
def test_theta_1_is_the_textbook_filter(Q: np.ndarray) -> None:
    """300 samples of some 100 operations: 1e-12 allows for a growth by 100."""
    form, record = trial.form(), smooth(0.05, 15.0)
    y = record["y"].copy()
    y[[3, 50, 51, 52]] = NAN
    C = np.eye(1, 3)
    expected = textbook(form.f, form.F, C, Q, np.ones(1), 0.05, record["u"], y[:, None])
    weight = np.diag(Q) if np.count_nonzero(Q) == 3 else Q
    run = hg.sample(fitzhugh_nagumo(Q=weight), dt=0.05).run(u=record["u"], y=y, engine="python")
    assert not run.status[4:50].any()
    assert run.x * [1, 1, -1] == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())


def test_two_outputs_one_after_the_other_are_both_at_once() -> None:
    """Scalar updates with independent noises are the joint one; either output may be missing."""

    def f(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], -np.sin(x[0]) - x[1] / 5 + x[2], -x[2] / 10 + u])

    def F(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([[0, 1, 0], [-np.cos(x[0]), -0.2, 1], [0, 0, -0.1]])

    record, rng = smooth(0.05, 15.0), np.random.default_rng(7)
    y = np.column_stack([record["y"], np.sin(0.2 * np.arange(301))]) + 0.1 * rng.standard_normal((301, 2))
    y[10:20, 0] = NAN
    y[15:30, 1] = NAN
    form = hg.forms.original(two_outputs())
    observer = hg.observers.riccati(form, Q=FULL, R=(0.5, 0.2))
    step = hg.sample(observer, dt=0.05)
    run = step.run(u=record["u"], y=y, engine="python")
    order = [str(expression) for expression in form.to_form]
    C = np.array([[float(name == wanted) for name in ("x1", "x2", "x3")] for wanted in ("x1", "x3")])
    turn = np.array([[float(name == wanted) for name in ("x1", "x2", "x3")] for wanted in order])
    expected = textbook(f, F, C, turn.T @ FULL @ turn, np.array([0.5, 0.2]), 0.05, record["u"], y)
    assert run.x == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    assert step.flags(run.status[12]) == ("MISSING_Y1",)
    assert step.flags(run.status[17]) == ("MISSING_Y1", "MISSING_Y2")


def test_a_high_theta_wants_one_output_or_aligned_chains() -> None:
    wanted = r"theta up to 2 wants a chain for each of the 2 outputs of two, .*block_triangular, align"
    for form in (hg.forms.original(two_outputs()), hg.forms.block_triangular(two_outputs(), "cascade")):
        with pytest.raises(BadGain, match=wanted):
            hg.observers.riccati(form, Q=(1, 1, 1), R=1, theta=2)


def test_high_gain_has_the_poles_it_was_given() -> None:
    """Near a fixed estimate the error moves with theta times the poles: d(z')/dz of the step's own right-hand side."""
    a2, a3 = hg.Signal("a2", "", "", 2.0), hg.Signal("a3", "", "", -0.5)
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2, 3)]
    y = hg.Signal("y")
    plant = hg.System(
        "gains", states=x, outputs=(y,), parameters=(a2, a3), flow=[a2 * x[1], a3 * x[2], 0], output=[3 * x[0]]
    )
    poles = (-1, -2 + 1j, -2 - 1j)
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=7.0, poles=poles)
    (part,) = observer.parts
    core = core_numbers(part, 1, nominal(observer))
    assert np.sort_complex(np.linalg.eigvals(core)) == pytest.approx(7 * np.sort_complex(poles), rel=1e-9)


def test_a_growing_mode_that_is_hidden_at_a_point_of_the_box() -> None:
    """x1' = u x2, x2' = x2: at u = 0 no covariance is steady; the filter is built, and its step."""
    u, x = hg.Signal("u", low=-1, high=1), [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2)]
    plant = hg.System("hidden", states=x, inputs=(u,), outputs=(hg.Signal("y"),), flow=[u * x[1], x[1]], output=[x[0]])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1, 1), R=1.0)
    assert np.isfinite(hg.sample(observer, hg.methods.rk4, dt=0.01).run(u=np.zeros(9), y=np.ones(9)).x).all()


@pytest.mark.parametrize("poles", [(-1e-9 + 1j, -1e-9 - 1j) * 2, (-1e-200,) * 4])
def test_poles_that_decay_only_before_they_are_rounded(poles: tuple[complex, ...]) -> None:
    with pytest.raises(NotHurwitz, match=r"^poles, rounded to doubles: .* take them further to the left$"):
        hg.observers.high_gain(hg.forms.triangular(chain(4)), theta=2, poles=poles)


def test_coefficients_of_poles() -> None:
    """The paper's section V: poles -1 +- i, -2 +- i."""
    assert coefficients((-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j), 4) == pytest.approx([6, 15, 18, 10], rel=1e-14)


# --- parameters that can be tuned ---------------------------------------------------------------------------


def tunable(nominal: float) -> hg.System:
    """The pendulum with a gravity that can be tuned."""
    plant = model("pendulum")
    a, b = plant.parameters
    tuned = hg.Signal("a", "1/s2", "gravity over length", nominal, low=5, high=30)
    flow = [expression.subs(a, tuned) for expression in plant.flow]
    data = {"states": plant.states, "inputs": plant.inputs, "outputs": plant.outputs}
    return hg.System("pendulum", **data, parameters=(tuned, b), flow=flow, output=plant.output)


@pytest.mark.ordinary("high_gain")
@pytest.mark.parametrize("kind", ["riccati", "high_gain"])
def test_a_tuned_parameter_is_as_good_as_a_declared_one(kind: str) -> None:
    def build(nominal: float) -> Any:
        form = hg.forms.triangular(tunable(nominal))
        if kind == "riccati":
            return hg.sample(hg.observers.riccati(form, Q=(0.1, 1.0), R=0.01), dt=0.01)
        return hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1)), hg.methods.rk4, dt=0.01)

    record = smooth(0.01, 3.0)
    step, declared = build(19.6), build(12.0)
    assert [field.name for field in step.layout.plant] == ["a"]
    untouched = step.run(**record, engine="python").x
    step.reset()
    assert step.tune(a=12.0) == 0
    tuned = step.run(**record, engine="python").x
    assert np.array_equal(tuned, declared.run(**record, engine="python").x)
    assert np.abs(tuned - untouched).max() > 0.1


def test_a_gain_that_can_be_tuned_enters_a_high_gain_observer() -> None:
    """a_2 with a range: K_2 = p_2/a_2 follows it."""
    a2 = hg.Signal("a2", "", "", 2.0, low=1, high=4)
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2)]
    plant = hg.System("g", states=x, outputs=[hg.Signal("y")], parameters=(a2,), flow=[a2 * x[1], 0], output=[x[0]])
    step = hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=3.0, poles=(-1, -2)), dt=0.01)
    step.tune()
    K = step._kept.places[Place("derived", "K")]
    assert pytest.approx([9, 9], rel=1e-14) == K
    step.tune(a2=4.0)
    assert pytest.approx([9, 4.5], rel=1e-14) == K
    step.tune(theta=2.0)
    assert pytest.approx([6, 2], rel=1e-14) == K


def test_parameters_are_limited_and_it_is_said() -> None:
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(tunable(19.6)), Q=(0.1, 1.0), R=0.01), dt=0.01)
    memory = step._kept.places
    for value, limited in ((100.0, 30.0), (-1.0, 5.0), (NAN, 19.6), (float("inf"), 19.6)):
        assert step.flags(step.tune(a=value)) == ("PARAMETER_LIMITED",)
        assert memory[Place("plant", "a")][0] == limited
    assert step.flags(step.tune(a=7.0, R=-1.0)) == ("PARAMETER_LIMITED",)
    assert memory[Place("gain", "R")][0] == pytest.approx(1e-8)
    assert step.tune(R=0.02, Q=(0.2, 0.3)) == 0
    assert memory[Place("gain", "Q")] == pytest.approx([0.2, 0.3])


def test_theta_cannot_be_tuned_past_the_value_that_dt_was_admitted_for() -> None:
    step = hg.sample(pendulum(theta=20), hg.methods.rk4, dt=0.01)
    assert step.flags(step.tune(theta=21.0)) == ("PARAMETER_LIMITED",)
    assert step._kept.places[Place("gain", "theta")][0] == 20


# --- what is refused ----------------------------------------------------------------------------------------

UNIT = np.eye(3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"Q": (1, 2)}, r"Q of shape \(2,\) must be a diagonal of 3 numbers or a 3 x 3 matrix"),
        ({"Q": 1.0}, r"Q of shape \(\) must be"),
        ({"Q": (1, 2, -1)}, "Q must be positive semidefinite: symmetric, without a negative eigenvalue"),
        ({"Q": -np.ones((3, 3))}, "Q must be positive semidefinite"),
        ({"Q": [[1, 3, 0], [3, 8.9, 0], [0, 0, 1]]}, "Q must be positive semidefinite"),
        ({"Q": UNIT + np.eye(3, k=1)}, r"Q must be symmetric, to 1e-12 of its numbers; give \(Q \+ Q'\)/2"),
        ({"Q": (1, 2, NAN)}, "Q must be finite"),
        ({"Q": (1e300, 1, 1)}, "Q must be finite, none of its numbers beyond 1e"),
        ({"Q": "1"}, "Q = '1' must be a number or an array of numbers"),
        ({"Q": None}, "riccati has no process noise; give one of Q or Q_per_sample"),
        ({"R": 0}, r"R = 0 must be positive"),
        ({"R": -1.0}, r"R = -1\.0 must be positive"),
        ({"R": NAN}, r"R = nan must be positive"),
        ({"R": (1, 2)}, r"R of shape \(2,\) must have one number for each of 1 outputs"),
        ({"R": None}, r"riccati has no measurement noise; give one of R, R_per_sample or noise"),
        ({"theta": 0.5}, r"theta = 0\.5 must be a finite number, at least 1"),
        ({"theta": NAN}, r"theta = nan must be a finite number"),
        ({"theta": "high"}, r"theta = 'high' must be a number"),
        ({"theta": (1, 2)}, r"theta of shape \(2,\) must be a single number"),
        ({"covariance": (1, 1)}, r"covariance of shape \(2,\) must be"),
        ({"covariance": (1, 0, 1)}, "covariance must be positive definite"),
        ({"initial": (1, 2)}, "initial of length 2 must have one number for each of x1, x2, eta"),
        ({"initial": {"x9": 1}}, "initial names 'x9', which is none of the names; they are x1, x2, eta, u"),
        ({"initial": {"x1": 99}}, r"initial x1 = 99\.0 must be finite and in \[-3\.5, 3\.5\]"),
        ({"initial": (0, 0, NAN)}, r"initial eta = nan must be finite"),
        ({"initial": "zero"}, r"initial = 'zero' must be a number"),
    ],
)
def test_bad_gains_of_riccati(changes: dict[str, Any], said: str) -> None:
    with pytest.raises((BadGain, BadNames), match=f"^{said}"):
        fitzhugh_nagumo(**changes)


def test_a_jacobian_that_is_not_finite_is_met_at_the_door() -> None:
    """1 + sqrt x1 on x1 >= 0: its slope has no bound at the edge, to which an estimate is clamped."""
    x1, x2 = hg.Signal("x1", low=0, high=1), hg.Signal("x2", low=-1, high=1)
    flow = [(1 + sp.sqrt(x1)) * x2, -x1]
    plant = hg.System("rooted", states=(x1, x2), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    form = hg.forms.triangular(plant, measured=True)
    steep = "each derivative of x1' by a state has no finite value unless x1 > 0"
    with pytest.raises(Refuted, match=rf"{steep}; at x1 = 0.*accept=\('singular\.x1',\)"):
        hg.observers.riccati(form, Q=(1, 1), R=1, accept=("triangular.lipschitz",))
    with pytest.raises(Refuted, match=r"accept=\('triangular\.lipschitz', 'singular\.x1'\)"):
        hg.observers.riccati(form, Q=(1, 1), R=1)
    hg.observers.riccati(form, Q=(1, 1), R=1, accept=("triangular.lipschitz", "singular.x1"))
    x1 = hg.Signal("x1", low=1e-3, high=1)
    flow = [(1 + sp.sqrt(x1)) * x2, -x1]
    plant = hg.System("rooted", states=(x1, x2), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    hg.observers.riccati(hg.forms.triangular(plant, measured=True), Q=(1, 1), R=1)


@pytest.mark.parametrize("number", [np.float32(2), np.int64(2), np.array(2.0), sp.Rational(2), 2])
def test_numbers_of_any_kind_are_numbers(number: Any) -> None:
    assert fitzhugh_nagumo(R=number, theta=number).gains == fitzhugh_nagumo(R=2.0, theta=2.0).gains
    assert pendulum(theta=number).gains == pendulum(theta=2.0).gains


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: hg.theta.constant(0.5), r"theta = 0\.5 must be a finite number, at least 1"),
        (lambda: hg.theta.decaying(0.5, 1.0), r"theta_0 = 0\.5 must be"),
        (lambda: hg.theta.decaying(2.0, 0.0), r"rate = 0\.0 must be a positive finite number"),
        (lambda: hg.theta.smoothstep(0.0, 1.0), r"gamma_0 = 0\.0 must be a positive"),
        (lambda: hg.theta.smoothstep(2.0, 1.0), r"gamma_0 = 2 must be below gamma_1 = 1"),
        (lambda: hg.theta.logistic(0.0, 1.0), r"centre = 0\.0 must be a positive"),
        (lambda: hg.theta.logistic(1.0, NAN), r"slope = nan must be a positive"),
        (lambda: adaptive(0.9), r"theta_1 = 0\.9 must be"),
        (lambda: adaptive(rise_time=-1), r"rise_time = -1 must be a positive"),
        (lambda: adaptive(rate=0), r"rate = 0 must be a positive"),
        (lambda: adaptive(mu=0.3), r"mu = 0\.3 must be thresholds"),
        (lambda: adaptive(innovation=1.0), r"innovation = 1\.0 must be innovation\.staggered"),
        (lambda: pendulum(theta=0), r"theta = 0 must be a positive finite number"),
        (lambda: fitzhugh_nagumo_high_gain(), r"a_2 = -u depends on the input, .* use riccati"),
        (lambda: pendulum(initial={"q": 9}), r"initial q = 9\.0 must be finite and in \[-4, 4\]"),
    ],
)
def test_bad_gains(build: Callable[[], object], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        build()


def fitzhugh_nagumo_high_gain() -> hg.Observer:
    form = hg.forms.triangular(model("fitzhugh_nagumo"))
    return hg.observers.high_gain(form, theta=2, poles=(-1, -1, -1), accept="triangular.a_2")


def test_high_gain_wants_a_triangular_form() -> None:
    with pytest.raises(BadGain, match=r"no chains; use the form block_triangular if the plant is in it, else riccati"):
        hg.observers.high_gain(hg.forms.original(two_outputs()), theta=2, poles=(-1, -1, -1))
    with pytest.raises(BadGain, match=r"takes a triangular form, this one is original"):
        hg.observers.high_gain(hg.forms.original(chain(3)), theta=2, poles=(-1, -1, -1))


@pytest.mark.parametrize(
    ("poles", "said"),
    [
        ((-1,), "there are 1, the form has 2 states; give one for each"),
        ((-1, -1, -1), "there are 3, the form has 2 states"),
        ((-1, 1), r"1\+0j is not in the open left half plane; give it a negative real part"),
        ((-1, 0), r"0\+0j is not in the open left half plane"),
        ((-1 + 1j, -1), "complex poles must come in conjugate pairs"),
        ((-1 + 1j, -1 + 1j), "complex poles must come in conjugate pairs"),
        ((NAN, -1), "are not all finite numbers"),
        ((-1e200, -1e200), "their polynomial is beyond a double's range; give smaller ones, and a larger theta"),
        (-1, "-1 is no sequence of numbers"),
        ("ab", "'ab' is no sequence of numbers"),
    ],
)
def test_bad_poles(poles: Any, said: str) -> None:
    with pytest.raises(BadPoles, match=f"^poles .*: {said}"):
        pendulum(poles=poles)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: hg.innovation.staggered(0.0), r"the window d = 0\.0 must be a positive time"),
        (lambda: hg.innovation.window(NAN), r"the window d = nan must be a positive time"),
        (lambda: hg.innovation.staggered(1.0, predictors=0), "predictors = 0 must be a whole number"),
        (lambda: hg.innovation.staggered(1.0, predictors=2.5), r"predictors = 2\.5 must be a whole number"),
        (lambda: hg.innovation.window(1.0, method="rk4"), r"method = 'rk4' must be"),
        (lambda: hg.innovation.window(1.0, method=hg.methods.continuous_discrete), r"method = .* must be"),
    ],
)
def test_bad_windows(build: Callable[[], object], said: str) -> None:
    with pytest.raises(BadWindowSize, match=f"^{said}"):
        build()


@pytest.mark.parametrize(("dt", "fit"), [(0.03, 0.96), (0.15, 1.2), (0.1, 0.8)])
def test_a_window_that_does_not_fit_names_one_that_does(dt: float, fit: float) -> None:
    with pytest.raises(BadWindow, match=rf"take d = {fit:g}, or") as caught:
        hg.sample(fitzhugh_nagumo(theta=adaptive()), dt=dt)
    assert "between 4 predictors" in str(caught.value)
    hg.sample(fitzhugh_nagumo(theta=adaptive(innovation=hg.innovation.staggered(fit))), dt=dt)


# --- what is proved -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["high_gain", "low_power", "switched_gain", "stubborn", "adaptive_lmi"])
def test_a_proof_is_sought_once_when_its_check_is_first_read(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Neither a build nor a step waits for it, and members of a bank have that of the observer alone."""
    sought: list[str] = []

    def counted(maker: str, *rest: Any) -> tuple[hg.Check, ...]:
        sought.append(maker)
        return unknown_checks(maker, 20.0, because("it is not sought here"))

    for user in ("convergence", "limited_injection", "region", "varying_gain"):
        monkeypatch.setattr(f"hgogen.prove.{user}.convergence_checks", counted)
    shipped = load(MODELS / "pendulum.py")
    observer = getattr(hg.observers, name)(hg.forms.triangular(shipped.plant), **shipped.module.tuning[name])
    bank = hg.observers.bank(observer, count=2, period=0.1)
    assert np.isfinite(hg.sample(bank, dt=1e-3).run(u=[[0.0]], y=[0.0]).x).all()
    assert sought == []
    assert observer.checks is observer.checks is bank.checks
    assert sought == [name]


# --- refuted and accepted -----------------------------------------------------------------------------------


def test_a_refuted_check_stops_unless_it_is_accepted() -> None:
    with pytest.raises(Refuted, match=r"triangular\.a_2.*at u = 0.*accept=\('triangular\.a_2',\)"):
        fitzhugh_nagumo(accept=())
    for accept in ("triangular.a_2", ("triangular.a_2",), ["triangular.a_2", "triangular.a_1"]):
        assert "triangular.a_2" in fitzhugh_nagumo(accept=accept).accepted


@pytest.mark.parametrize(
    ("name", "form", "never"),
    [
        ("lorenz", hg.forms.phase, "low_power works in chains of integrators, .*; use high_gain or riccati"),
        ("haldane", hg.forms.uniform, "low_power wants constant slopes"),
        ("battery", hg.forms.triangular, "low_power takes a form in chains, .* in triangular form; use riccati"),
    ],
)
def test_nothing_is_offered_to_accept_where_that_does_not_build(name: str, form: Any, never: str) -> None:
    made = form(load(MODELS / f"{name}.toml").plant)
    with pytest.raises(Refuted, match=f"To accept it does not help: {never}") as caught:
        hg.observers.low_power(made, theta=3)
    assert "accept=" not in str(caught.value)
    with pytest.raises(BadGain, match="low_power"):
        hg.observers.low_power(made, theta=3, accept=[check.id for check in caught.value.checks])


@pytest.mark.ordinary(
    "high_gain-pendulum",
    "circle_criterion-pendulum",
    "circle_criterion-lithium_cell",
    "low_power-cascaded_tanks",
    "low_power-pendulum",
    "filtered-cascaded_tanks",
)
@pytest.mark.parametrize("name", ["cascaded_tanks", "pendulum", "lithium_cell"])
@pytest.mark.parametrize("observer", ["high_gain", "circle_criterion", "low_power", "filtered"])
def test_what_is_named_in_the_place_of_a_uniform_form_builds(name: str, observer: str) -> None:
    """The slopes of a pendulum are 1, those of tanks vary, and the cell is in no chain of integrators."""
    plant, make = load(str(next(MODELS.glob(f"{name}.*")))).plant, getattr(hg.observers, observer)
    form = hg.forms.uniform(plant)
    message = f"{observer} wants constant slopes, which a uniform form need not have; use the form uniform_chain if"
    with pytest.raises(BadGain, match=f"^{message} the plant is in it, else riccati$"):
        make(form, **hg.starting_gains(form, make).gains)
    try:
        form, takes = hg.forms.uniform_chain(plant), make
    except NoUniformChain:
        takes = hg.observers.riccati
    built = takes(form, **hg.starting_gains(form, takes).gains)
    assert built.name == ("riccati" if name == "lithium_cell" else observer)


@pytest.mark.parametrize("name", ["haldane", "battery"])
def test_no_form_advises_one_that_is_refuted(name: str) -> None:
    survey = hg.survey(load(MODELS / f"{name}.toml").plant)
    refused = {row.name.partition(",")[0] for row in survey.answered if row.verdict is Verdict.REFUTED}
    assert {"triangular", "uniform", "state_affine"} <= refused
    for row in survey.rows:
        assert not [form for form in refused if f"the form {form}" in row.fix], row.fix


def test_accept_of_an_unknown_check_is_refused_even_where_nothing_is_refuted() -> None:
    with pytest.raises(UnknownCheck, match=r"accept names 'triangular\.a_7', which is no check here; did you mean tri"):
        pendulum(accept="triangular.a_7")
    with pytest.raises(UnknownCheck):
        fitzhugh_nagumo(accept=("triangular.a_2", "a_2"))


def test_what_was_accepted_stands_in_the_banner() -> None:
    files = hg.targets.c99(hg.sample(fitzhugh_nagumo(), dt=0.01), real="float", check=False)
    assert "triangular.a_2" in files["fitzhugh_nagumo.h"]
    assert "accepted" in files["fitzhugh_nagumo.h"]
