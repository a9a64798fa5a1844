"""The step length from where on an error grows, and the one that is advised: matrices with known answers, a plant whose
own slope decides, and trials of shipped models at what is advised."""

import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import neuron
import numpy as np
import pytest
from scipy.linalg import expm
from step_lengths import pairs, row
from threadpoolctl import ThreadpoolController

import hgogen as hg
from hgogen.certificates.contraction import Admitted
from hgogen.commands.claims import checked
from hgogen.discretisation.runge_kutta import EULER, RK4
from hgogen.discretisation.stability import core_limit, growth, polynomial
from hgogen.estimators.step_lengths import closed_loops, first_unstable, frozen, longest_advised, stable
from hgogen.method import Method
from hgogen.model import load
from hgogen.step import StepMayFail, StepTooLong
from hgogen.stepping import discretise

MODELS = Path(__file__).resolve().parents[1] / "models"
WAYS = ("euler", "heun", "rk4", "exponential", "bilinear")
REGION = {"euler": 2.0, "heun": 2.0, "rk4": 2.785293563}  # of the real axis
OBSERVERS = ("high_gain", "low_power", "peaking_free", "filtered", "stubborn", "switched_gain")


def stiff() -> hg.Observer:
    """x1' = x2, x2' = -1e4 x2 - x1 with poles at -10: the plant's own decay is a thousand times faster."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    plant = hg.System("stiff", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -1e4 * x2 - x1], output=[x1])
    return hg.observers.high_gain(hg.forms.triangular(plant), theta=10, poles=(-1, -1))


def named(sentence: str) -> tuple[float, float]:
    """(refused above, take) of a sentence, of a refusal or a warning."""
    ((refused, take),) = re.findall(r"above ([0-9.e+-]+)[ ,].*take dt <= ([0-9.e+-]+) ", sentence)
    return float(refused), float(take)


@pytest.mark.parametrize("method", WAYS)
def test_a_plant_faster_than_the_observer_decides(method: str) -> None:
    """Its eigenvalue -1e4 leaves the region of the explicit methods; both sampled realisations take it by a rule of
    order 2 for x2' = -1e4 x2, whose factor 1 - x + x^2/2 passes 1 at x = 2."""
    with pytest.raises(StepTooLong) as caught:
        hg.sample(stiff(), getattr(hg.methods, method), dt=1e-3)
    refused, take = named(str(caught.value))
    assert refused == pytest.approx(REGION.get(method, 2.0) / 1e4, rel=0.01)
    assert refused / 16.1 <= take <= refused / 1.99
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hg.sample(stiff(), getattr(hg.methods, method), dt=take)


def test_at_what_is_named_the_fast_plant_is_followed() -> None:
    """At dt = 1e-3 the estimate stuck at 1.67 of a plant at rest."""
    observer = hg.observers.high_gain(stiff().form, theta=10, poles=(-1, -1), initial={"x1": 0.5, "x2": 0.5})
    with pytest.raises(StepTooLong) as caught:
        hg.sample(observer, hg.methods.rk4, dt=1e-3)
    step = hg.sample(observer, hg.methods.rk4, dt=named(str(caught.value))[1])
    run = step.run(y=np.zeros(5000))
    assert np.abs(run.x[-1]).max() < 0.01


def test_between_the_two_it_warns_with_both() -> None:
    step = load(MODELS / "pendulum.py").step("high_gain")
    with pytest.warns(
        StepMayFail, match=r"may fail in a part of the declared box by classical Runge-Kutta; above"
    ) as warned:
        between = hg.sample(step.observer, hg.methods.rk4, dt=0.08)
    (above,), (take,) = (
        re.findall(rf"{word} ([0-9.e+-]+) ", str(warned[0].message)) for word in ("above", "take dt <=")
    )
    assert float(take) < 0.08 < float(above) <= between.limit < 1.01 * float(above)


def test_who_knows_of_a_proof_is_said_where_there_may_be_one() -> None:
    """Of a constant injection, with guards; in both sentences."""
    pendulum = load(MODELS / "pendulum.py")
    high, tells = (
        pendulum.step("high_gain").observer,
        r"up to which dt its errors are proved to decay, hgogen check tells",
    )
    with pytest.warns(StepMayFail, match=tells):
        hg.sample(high, hg.methods.rk4, dt=0.08)
    with pytest.raises(StepTooLong, match=tells):
        hg.sample(high, hg.methods.rk4, dt=0.2)
    others = (
        (high, "rk4", {"guards": "none"}),
        (pendulum.step("cascade").observer, "rk4", {}),
    )
    for observer, method, options in others:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises((StepTooLong, StepMayFail)) as caught:
                hg.sample(observer, getattr(hg.methods, method), dt=2.0, **options)
        assert "proved" not in str(caught.value)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ((0.1129, True, 0.0506, 0.1142), "certified up to 0.112; refused above 0.114"),
        (
            (0.1129, True, 0.1135, 0.1142),
            "certified up to 0.112; tried without failure up to 0.113; refused above 0.114",
        ),
        ((0.147, True, 0.0506, 0.1872), "certified up to 0.147; refused above 0.187"),  # the float is below 0.147
        ((0.01, False, 0.005, None), "certified at 0.01; tried without failure up to 0.005"),
        ((None, False, None, 0.1142), "certified at none; refused above 0.114"),
        ((None, False, None, None), "certified at none"),
    ],
)
def test_the_certified_length_comes_first(known: tuple[Any, ...], said: str) -> None:
    assert str(Admitted(0.01, "s", *known).sentence) == f"dt = 0.01 s: {said}"


@pytest.mark.full
def test_a_check_names_the_lengths_of_its_step() -> None:
    dt = checked(load(MODELS / "pendulum.py")).dt
    assert dt is not None
    assert str(dt.sentence) == "dt = 0.001 s: certified up to 0.112; refused above 0.114"
    step = load(MODELS / "pendulum.py").step("high_gain")
    assert dt.certified is not None
    with pytest.warns(StepMayFail):
        assert hg.contraction(hg.sample(step.observer, hg.methods.rk4, dt=dt.certified)).proved
    assert checked(load(MODELS / "pendulum.py"), name="cascade").dt is None


# --- matrices -----------------------------------------------------------------------------------------------


def jordan(n: int) -> np.ndarray:
    """A - K C with all its n poles at -1."""
    return np.diag(np.ones(n - 1), 1) - np.outer(np.poly(-np.ones(n))[1:], np.eye(n)[0])


@pytest.mark.parametrize(("n", "fold"), [(2, 7), (3, 98), (4, 1656)])
def test_a_multiple_pole_grows_far_before_it_decays(n: int, fold: float) -> None:
    """RK4 at 90 % of the limit of its spectrum; at what is advised hardly more than in continuous time."""
    M, zero = jordan(n)[None], np.zeros((n, n))
    limit = 2.785293563
    T = polynomial(0.9 * limit * M, RK4.polynomial)
    spectral = max(np.linalg.norm(np.linalg.matrix_power(T[0], k), 2) for k in range(1, 200))
    assert spectral == pytest.approx(fold, rel=0.07)
    assert fold / 3 < growth(T)[0] < 3 * fold  # in the norm of the largest row
    take = longest_advised(zero, M, hg.methods.rk4, limit)
    fine = growth(polynomial(1e-3 * M, RK4.polynomial))[0]
    assert growth(polynomial(2 * take * M, RK4.polynomial))[0] <= 1.51 * fine
    assert growth(polynomial(1.01 * 2 * take * M, RK4.polynomial))[0] > 1.49 * fine


def test_what_grows_late_counts_beside_what_decays_at_once() -> None:
    """|T^k| = rate^k + k shear rate^(k-1), which is largest near k = -1 / log(rate), beside what is gone at once."""
    gone = np.zeros((2, 2))
    for rate, shear in ((0.5, 9.0), (0.9, 3.0), (0.97, 1.0), (0.99, 0.5)):
        T = np.array([[rate, shear], [0.0, rate]])
        every = [np.abs(np.linalg.matrix_power(T, k)).sum(axis=1).max() for k in range(1, 49)]
        alone, beside = growth(T[None])[0], growth(np.array([gone, T, 0.5 * np.eye(2)]))
        assert alone >= max(every) * (1 - 1e-12)
        assert beside.tolist() == [1.0, alone, 1.0]
    for rate in (1.0, 1.0001):  # for ever
        assert growth(np.array([[[rate, 0.1], [0.0, rate]]]))[0] > 1e3
    assert growth(np.array([np.full((2, 2), np.nan), gone])).tolist() == [np.inf, 1.0]


@pytest.mark.parametrize("method", ["exponential", "bilinear"])
def test_a_sampled_core_is_refused_where_its_spectrum_leaves_the_circle(method: str) -> None:
    way, rng = getattr(hg.methods, method), np.random.default_rng(5)
    core = 3 * jordan(3)
    M = core + rng.normal(size=(40, 1, 3)) * np.array([[0], [0], [6.0]])
    M = M[stable(M)]
    limits = way.refused(core, M)
    limit, at = limits.min(), limits.argmin()

    def radius(h: float) -> np.ndarray:
        return np.abs(np.linalg.eigvals(way.transition(core, M, h))).max(axis=1)

    assert len(M) > 20
    assert np.isfinite(limits).sum() == 1
    assert radius(1.01 * limit)[at] > 1 > radius(0.99 * limit).max()


@pytest.mark.parametrize("method", ["exponential", "bilinear"])
def test_a_core_alone_is_admitted_at_any_step(method: str) -> None:
    """The exponential's is exact, the bilinear rule is stable; what is advised is no shorter than the core's time."""
    way, core = getattr(hg.methods, method), 5 * jordan(2)
    assert np.isinf(first_unstable(core, core[None], way)).all()
    assert longest_advised(core, core[None], way, np.inf) > 1 / 5


def test_what_does_not_move_limits_nothing() -> None:
    zero = np.zeros((2, 2))
    assert np.isinf(first_unstable(zero, np.zeros((1, 2, 2)), hg.methods.exponential)).all()
    assert np.isinf(longest_advised(zero, np.zeros((0, 2, 2)), hg.methods.euler, 1.0))
    assert hg.methods.euler.refused(zero, -np.eye(2)[None])[0] == pytest.approx(
        core_limit(-np.eye(2), EULER.polynomial)
    )


# --- the errors of shipped observers ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["high_gain", "stubborn", "dead_zone", "switched_gain", "adaptive_lmi"])
def test_the_error_of_the_pendulum_by_hand(name: str) -> None:
    """[[-K_1 l, 1], [-K_2 l^2 - a cos q, -b]] inside the box; clamped q and w leave the core."""
    observer = load(MODELS / "pendulum.py").step(name).observer
    (part,) = (part for part in observer.parts if hasattr(part, "residual"))
    errors, level = frozen(part, observer), {"switched_gain": 40, "adaptive_lmi": 60}.get(name, 20)
    q, w = errors.points[:, 0], errors.points[:, 1]
    slope = np.where(np.abs(q) < 4, -19.6 * np.cos(np.clip(q, -4, 4)), 0.0)
    friction = np.where(np.abs(w) < 20, -0.1, 0.0)
    assert errors.M[:, 0, 0] == pytest.approx(-2.0 * level)
    assert errors.M[:, 1, 0] == pytest.approx(slope - level**2, abs=1e-6)
    assert errors.M[:, 1, 1] == pytest.approx(friction)
    assert (np.abs(q) > 4).any()
    assert (np.abs(w) > 20).any()


def test_a_bank_has_the_step_lengths_of_its_members() -> None:
    observer = load(MODELS / "pendulum.py").step("high_gain").observer
    bank = hg.observers.bank(observer, count=2, period=1.0)
    with pytest.raises(StepTooLong) as one:
        hg.sample(observer, hg.methods.rk4, dt=0.25)
    with pytest.raises(StepTooLong) as many:
        hg.sample(bank, hg.methods.rk4, dt=0.25)
    assert (many.value.limit, many.value.take) == (one.value.limit, min(one.value.take, many.value.take))


# --- the closed loop of a filter -----------------------------------------------------------------------------


def linear(name: str, A: list[list[float]], outputs: tuple[int, ...] = (0,)) -> hg.System:
    """x' = A x, of which some states are measured."""
    x = [hg.Signal(f"x{i + 1}", low=-10, high=10) for i in range(len(A))]
    flow = [sum(a * state for a, state in zip(row, x, strict=True)) for row in A]
    y = [hg.Signal(f"y{j + 1}") for j in range(len(outputs))]
    return hg.System(name, states=x, outputs=y, flow=flow, output=[x[j] for j in outputs])


CHAIN = [[0, 1, 0], [0, 0, 1], [-6, -11, -6]]
STIFF = [[0, 1], [-1, -2000]]
TURNING = [[0, 1], [-900, -0.6]]
UNSTABLE = [[0, 1], [0.05, 0.1]]
COUPLED = [[0, 1, 0, 0], [-4, -0.1, 1, 0], [0, 0, 0, 1], [1, 0, -9, -0.1]]
TWELVE = (np.eye(12, k=1) - np.eye(12, k=-1) - 0.1 * np.eye(12)).tolist()


@pytest.mark.ordinary("0.02-4.0", "0.3-1.0")
@pytest.mark.parametrize("theta", [1.0, 4.0])
@pytest.mark.parametrize("h", [0.02, 0.3])
def test_the_closed_loop_is_that_of_the_step(theta: float, h: float) -> None:
    """Two estimates of the same samples differ by powers of T(h), whose eigenvalues they show."""
    form = hg.forms.triangular(linear("chain", CHAIN))
    states, y = [], np.sin(np.arange(30 + round(3 / h)))
    for start in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]):
        observer = hg.observers.riccati(form, Q=[0.1, 0.2, 0.3], R=0.05, theta=theta, initial=start)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepMayFail)
            states.append(hg.sample(observer, dt=h, engine="python").run(y=y).x)
    moved = np.array([x - states[-1] for x in states[:3]])  # (start, sample, state): powers of T, P settled
    k = round(2 / h)
    T = np.linalg.solve(moved[:, k], moved[:, k + 1]).T
    (part, *_) = observer.parts
    transition = closed_loops(part, *part.slopes(1), theta, theta).transition(h)
    assert np.sort_complex(np.linalg.eigvals(T)) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(transition[0])), rel=2e-3, abs=1e-4
    )


@pytest.mark.parametrize(
    ("method", "A", "outputs"),
    [
        ("cholesky", STIFF, (0,)),
        ("continuous_discrete", TURNING, (0,)),
        ("continuous_discrete", UNSTABLE, (0,)),
        ("continuous_discrete", COUPLED, (0, 2)),
        pytest.param("continuous_discrete", TWELVE, (0,), marks=pytest.mark.slow),
        pytest.param("rk4", TURNING, (0,), marks=pytest.mark.slow),
        pytest.param("rk4_covariance", UNSTABLE, (0,), marks=pytest.mark.slow),
    ],
)
def test_at_what_is_named_a_filter_follows(method: str, A: list[list[float]], outputs: tuple[int, ...]) -> None:
    """Without a warning, from a wrong estimate, of a plant that is integrated exactly."""
    n, way = len(A), getattr(hg.methods, method)
    observer = hg.observers.riccati(
        hg.forms.original(linear("plant", A, outputs)), Q=[0.1] * n, R=[0.01] * len(outputs)
    )
    take = _taken(observer, way)
    with warnings.catch_warnings():
        warnings.simplefilter("error", StepMayFail)
        step = hg.sample(observer, way, dt=take)
    assert take < 100
    x = np.empty((min(round(400 / take), 40000), n))
    x[0], over = 0.5, expm(np.array(A) * take)
    for k in range(1, len(x)):
        x[k] = over @ x[k - 1]
    x = x[np.abs(x).max(axis=1) <= 10]  # its ranges
    error = np.abs(step.run(y=x[:, outputs]).x - x).max(axis=1)
    assert error[-1] < 0.02 * np.abs(x).max(axis=1)[-1] + 0.02


def resonant() -> tuple[np.ndarray, hg.Observer]:
    """Q lets the variance of a grow by far more in a long step than its cap admits."""
    A = np.array([[0, 1, 0], [0, 0, 1], [-382.8, -89.5, -10.15]])
    x = [hg.Signal(name, low=-high, high=high) for name, high in (("a", 1.5), ("b", 36), ("c", 870))]
    flow = [sum(float(c) * state for c, state in zip(row, x, strict=True)) for row in A]
    plant = hg.System("resonant", states=x, outputs=(hg.Signal("y", low=-1.7, high=1.7),), flow=flow, output=[x[0]])
    form = hg.forms.original(plant)
    return A, hg.observers.riccati(form, Q={"a": 0.39, "b": 8420.0, "c": 8.19e6}, R=1.53e-3)


def followed(observer: hg.Observer, A: np.ndarray, dt: float, start: np.ndarray) -> float:
    """The largest error in units of the ranges, late in 400 samples of a plant x' = A x."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        step = hg.sample(observer, dt=dt)
    x, over = np.empty((400, len(A))), expm(A * dt)
    x[0] = start
    for k in range(1, len(x)):
        x[k] = over @ x[k - 1]
    high = np.array([state.interval[1] for state in observer.form.states])
    return float((np.abs(step.run(y=x[:, :1]).x - x) / high)[100:].max())


def test_no_step_is_advised_at_which_the_covariance_meets_its_cap() -> None:
    """dt = 0.131 was advised, at which the error was .3 of the ranges for good, after 2.4 on the way."""
    A, observer = resonant()
    start = np.array([-0.036, 2.84, 20.0])
    with pytest.raises(StepTooLong, match="no error settles") as caught:
        hg.sample(observer, dt=0.131)
    refused, take = named(str(caught.value))
    assert followed(observer, A, take, start) < 1e-9
    assert followed(observer, A, 0.97 * refused, start) < 1e-6
    (part, *_) = observer.parts
    loop = closed_loops(part, *part.slopes(1), 1.0, 1.0)
    assert loop.largest_shares(0.98 * take).max() <= 1 < loop.largest_shares(1.03 * take).max()
    assert loop.settles(0.97 * refused).all()
    assert not loop.settles(1.05 * refused).any()


def test_the_way_of_the_covariance_is_that_of_the_recursion() -> None:
    """From P(0), sample by sample, in the plant's coordinates."""
    A, observer = resonant()
    (part, *_) = observer.parts
    F, C = part.slopes(1)
    (Q, R), h, n = part.nominal, 0.05, 3
    loop = closed_loops(part, F, C, 1.0, 1.0)
    Phi, P, largest = np.eye(n) + h * A + h * h / 2 * A @ A, np.eye(n), 0.0
    for _ in range(512):
        P = Phi @ (P - np.outer(P @ C[0][0], C[0][0] @ P) / (R[0] / h + P[0, 0])) @ Phi.T + h * Q
        largest = max(largest, float((np.diag(P) / part.cap).max()))
    assert loop.largest_shares(h)[0] == pytest.approx(largest, rel=0.02)


@pytest.mark.slow
def test_a_random_plant_is_followed_at_what_is_named() -> None:
    """Stable plants of three states with large Q, each from a start in its ranges."""
    rng = np.random.default_rng(11)
    failed = []
    for trial in range(40):
        poles = -rng.uniform(0.5, 8, 3) + 0j
        if trial % 2:
            poles[1:] = -rng.uniform(0.2, 3) + 1j * rng.uniform(2, 10) * np.array([1, -1])
        A = np.diag(np.ones(2), 1)
        A[-1] = -np.real(np.poly(poles))[:0:-1]
        fastest = np.abs(poles).max()
        high = np.array([1.0, fastest, fastest**2])
        x = [hg.Signal(f"x{i + 1}", low=-top, high=top) for i, top in enumerate(high)]
        flow = [sum(float(c) * state for c, state in zip(row, x, strict=True)) for row in A]
        plant = hg.System("plant", states=x, outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])
        Q = 10.0 ** rng.uniform(-1, 2) * high**2
        observer = hg.observers.riccati(hg.forms.original(plant), Q=Q.tolist(), R=10.0 ** rng.uniform(-4, -1))
        take = _taken(observer, hg.methods.continuous_discrete)
        if (error := followed(observer, A, take, 0.3 * high * rng.uniform(-1, 1, 3))) > 0.02:
            failed.append((trial, take, error))
    assert not failed


def _taken(observer: hg.Observer, way: Method) -> float:
    """What is named for a step that is far too long."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StepMayFail)
        try:
            hg.sample(observer, way, dt=100.0)
        except StepTooLong as error:
            said = str(error)
        else:
            (said,) = (str(warning.message) for warning in caught)
    (take,) = re.findall(r"take dt <= ([0-9.e+-]+) ", said)
    return float(take)


def test_every_theta_on_its_way_is_judged() -> None:
    """One that decays from 2 to 1 asks for a shorter step at 1: .42, which was not looked at, in place of .46."""
    form = hg.forms.triangular(linear("chain", CHAIN))
    decaying, rested, peaking = (
        _taken(hg.observers.riccati(form, Q=[1, 1, 1], R=0.01, theta=theta), hg.methods.continuous_discrete)
        for theta in (hg.theta.decaying(2.0, 0.1), 1.0, 2.0)
    )
    assert decaying == pytest.approx(rested, rel=0.02)
    assert decaying < 0.95 * peaking


def kalman_like() -> hg.Observer:
    return hg.observers.kalman_like(hg.forms.state_affine(linear("chain", CHAIN)), rho=0.1, R=0.01)


def riccati() -> hg.Observer:
    return hg.observers.riccati(hg.forms.original(linear("chain", CHAIN)), Q=[1, 1, 1], R=0.01)


def hamilton_jacobi() -> hg.Observer:
    return hg.observers.hamilton_jacobi(hg.forms.original(linear("chain", CHAIN)), Q=[1, 1, 1], R=100)


def said(observer: hg.Observer, dt: float) -> str:
    """The refusal of a step length, or its warning; empty where there is none."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StepMayFail)
        try:
            hg.sample(observer, hg.methods.continuous_discrete, dt=dt)
        except StepTooLong as error:
            return str(error)
    return "".join(str(warning.message) for warning in caught)


@pytest.mark.ordinary("riccati", "hamilton_jacobi")
@pytest.mark.parametrize("make", [kalman_like, riccati, hamilton_jacobi])
def test_one_step_length_is_advised_whatever_is_asked(make: Callable[[], hg.Observer]) -> None:
    """From just beyond it to where it is refused, with a warning, and beyond."""
    observer = make()
    refused, take = named(said(observer, 100.0))
    above = (share * take for share in (1.02, 1.05, 1.12))
    for dt in (*above, math.sqrt(take * refused), 0.98 * refused):
        assert named(said(observer, dt)) == (refused, take)
    assert not said(observer, take)


def test_gains_are_those_declared_and_it_is_said() -> None:
    with pytest.raises(StepTooLong, match=r"with the gains as declared, no proof"):
        hg.sample(stiff(), hg.methods.rk4, dt=1.0)


# --- trials -------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("pendulum-high_gain")
@pytest.mark.parametrize(("model", "name"), [("pendulum", "high_gain"), ("hyperjerk", "low_power")])
def test_at_what_is_advised_the_trial_settles(model: str, name: str) -> None:
    """Where it did not at the step that was named before, the limit of the core's spectrum."""
    (pair,) = (pair for pair in pairs(load(MODELS / f"{model}.py"), (name,)) if pair.tuning == name)
    refused, take = pair.lengths()
    assert take < refused
    assert pair.settles(take)
    assert not pair.settles(0.95 * refused)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["pendulum", "hyperjerk", "disturbed_pendulum"])
def test_what_is_advised_is_neither_too_long_nor_too_short(model: str) -> None:
    rows = [row(pair) for pair in pairs(load(MODELS / f"{model}.py"), OBSERVERS)]
    assert {verdict.pair.tuning for verdict in rows} >= {"high_gain", "filtered"}
    assert not [str(verdict) for verdict in rows if not verdict.holds]


def test_a_step_is_made_on_one_thread_of_the_linear_algebra(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it is made of; then there are as many as before."""
    threads: list[int] = []

    def counted() -> list[int]:
        return [each["num_threads"] for each in ThreadpoolController().info() if each["user_api"] == "blas"]

    def seen(name: str, module: Any) -> None:
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *args: (threads.extend(counted()), function(*args))[1])

    with ThreadpoolController().limit(limits=2, user_api="blas"):
        if not (before := counted()):
            pytest.skip("this numpy has a BLAS whose threads nobody counts")
        seen("lengths", discretise)
        seen("pieces", discretise)
        hg.sample(neuron.observer(1.0), dt=0.01)
        assert set(threads) == {1}
        assert counted() == before
