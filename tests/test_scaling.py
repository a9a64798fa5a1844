"""How theta enters the noise: both scalings, one output and chains of several, by every view of the covariance."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import block_ekf as oracle
from plants import MODELS, fitzhugh_nagumo, model

import hgogen as hg
from hgogen.analysis.scaling import SCALED, Scaling
from hgogen.discretisation.explicit_covariance import covariance_limits
from hgogen.discretisation.runge_kutta import RK4
from hgogen.discretisation.stability import FrozenRiccati, Limit
from hgogen.estimators.innovation import BadWindowSize
from hgogen.model import load
from hgogen.reading.given import BadGain
from hgogen.theorem import rows

EPS = np.finfo(float).eps
P0 = np.array([0.5, 2.0, 1.0])
METHODS = ("continuous_discrete", "rk4", "rk4_covariance")


def smooth(dt: float, duration: float) -> dict[str, np.ndarray]:
    t = np.arange(round(duration / dt) + 1) * dt
    return {"u": 0.5 + 0.3 * np.sin(t), "y": 1.5 * np.cos(0.7 * t + 0.3)}


# --- two scalings, one output -------------------------------------------------------------------------------


def neuron(theta: Any, start: np.ndarray, method: str = "continuous_discrete") -> np.ndarray:
    """Estimates over 5 s; P(0) = diag(start)."""
    step = hg.sample(fitzhugh_nagumo(theta=theta, covariance=start), getattr(hg.methods, method), dt=0.01)
    run = step.run(**smooth(0.01, 5.0), engine="python")
    assert not run.status.any()
    return run.x


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the limit of dt by the covariance, which takes seconds to find."""
    monkeypatch.setattr("hgogen.method.covariance_limits", lambda *arguments: [Limit(np.inf, "not asked")])


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("method", METHODS)
def test_at_constant_theta_both_scalings_are_one_observer(method: str) -> None:
    """P of the slides is theta times P of the paper, so that the gain is the same: rounding only, some 1e3 operations
    in each of 500 steps, forgotten within 1 s."""
    paper = neuron(hg.theta.constant(3.0), P0, method)
    slides = neuron(hg.theta.constant(3.0, scaled="process"), 3.0 * P0, method)
    assert slides == pytest.approx(paper, abs=1e-10 * np.abs(paper).max())
    assert np.abs(neuron(hg.theta.constant(3.0, scaled="process"), P0, method) - paper).max() > 1e-3


@pytest.mark.full
def test_while_theta_decays_they_are_two() -> None:
    """S' of the paper's has rate (theta - 1)/theta S more: a difference that vanishes with the rate, not before."""

    def distance(rate: float) -> float:
        slides = neuron(hg.theta.decaying(3.0, rate), 3.0 * P0)
        return float(np.abs(slides - neuron(hg.theta.decaying(3.0, rate, scaled="both"), P0)).max())

    distances = [distance(rate) for rate in (0.5, 0.05, 0.005)]
    assert distances[0] > 0.02
    assert distances[1] / distances[2] == pytest.approx(10, rel=0.2)


@pytest.mark.parametrize("scaled", SCALED)
def test_a_decaying_theta_is_the_oracles(scaled: str) -> None:
    """The slides' modified filter, r unscaled, and the paper's scaling."""
    h, theta_0, rate, eps = 0.01, 4.0, 0.7, 0.8
    record = smooth(h, 6.0)

    def f(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[0] - x[0] ** 3 / 3 - u * x[1], eps * (3 * np.sin(x[0]) - x[1] - x[2]), 0.0])

    def F(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([[1 - x[0] ** 2, -u, 0], [3 * eps * np.cos(x[0]), -eps, -eps], [0, 0, 0]])

    Q = np.diag([0.1, 0.01, 2.3e-4])
    expected = oracle.run(
        f,
        F,
        np.eye(3)[:1],
        lambda theta: oracle.noises(Q, np.ones(1), (3,), "top", theta, scaled == "process"),
        lambda k: 1 + (theta_0 - 1) * np.exp(-rate * h * max(k - 1, 0)),  # the first call advances no time
        np.diag(P0),
        h,
        record["u"],
        record["y"][:, None],
    )
    estimates = neuron_run(hg.theta.decaying(theta_0, rate, scaled=scaled), record, h)
    assert estimates == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def neuron_run(theta: Any, record: dict[str, np.ndarray], h: float) -> np.ndarray:
    return hg.sample(fitzhugh_nagumo(theta=theta, covariance=P0), dt=h).run(**record, engine="python").x


def test_what_theta_scales_is_one_of_two() -> None:
    for make in (lambda: hg.theta.constant(2.0, scaled="all"), lambda: hg.theta.decaying(2.0, 1.0, scaled="all")):
        with pytest.raises(BadGain, match="scaled = 'all' must be one of 'both', 'process'"):
            make()


# --- chains of several outputs ------------------------------------------------------------------------------


@cache
def form(align: str) -> hg.Form:
    """Two chains of 2 and 3: at their ends the short one's rows may read a level further than at their tops."""
    x = [hg.Signal(f"x{i}", low=-20, high=20) for i in range(1, 6)]
    u, y = hg.Signal("u", low=-1, high=1), [hg.Signal("y1"), hg.Signal("y2")]
    flow = [x[1] - 0.2 * x[0], -x[0] + (0.5 * x[4] if align == "end" else 0.3 * x[2])]
    flow += [2 * x[3], x[4] - 0.1 * x[3], -x[2] - 0.5 * x[4] + u]
    plant = hg.System("chains", states=x, inputs=(u,), outputs=y, flow=flow, output=[x[0], 3 * x[2]])
    return hg.forms.block_triangular(plant, align)


def matrices(align: str) -> tuple[np.ndarray, np.ndarray]:
    A = np.zeros((5, 5))
    A[0, :2], A[1, 0], A[2, 3], A[3, 3:], A[4, 2], A[4, 4] = (-0.2, 1), -1, 2, (-0.1, 1), -1, -0.5
    A[1, 4 if align == "end" else 2] = 0.5 if align == "end" else 0.3
    return A, np.array([[1.0, 0, 0, 0, 0], [0, 0, 3.0, 0, 0]])


Q5 = np.diag([0.1, 0.2, 0.3, 0.1, 0.2]) + 0.01
R2 = np.array([0.5, 0.2])


def two(align: str, theta: Any, method: str = "continuous_discrete", dt: float = 0.01) -> hg.Step:
    observer = hg.observers.riccati(form(align), Q=Q5, R=R2, theta=theta)
    return hg.sample(observer, getattr(hg.methods, method), dt=dt)


def record(dt: float, duration: float) -> dict[str, np.ndarray]:
    t = np.arange(round(duration / dt) + 1) * dt
    return {"u": 0.5 * np.sin(t), "y": np.column_stack([np.cos(0.7 * t), np.sin(0.4 * t)])}


@pytest.mark.ordinary("False-both-end", "False-process-top", "True-process-end")
@pytest.mark.parametrize("align", ["top", "end"])
@pytest.mark.parametrize("scaled", SCALED)
@pytest.mark.parametrize("decays", [False, True])
def test_blocks_are_the_oracles(align: str, scaled: str, decays: bool) -> None:
    """Delta and delta as the thesis prints them; products of numbers up to theta^5 R, rounding only."""
    theta, h, (A, C) = 3.0, 0.01, matrices(align)
    law = hg.theta.decaying(theta, 0.8, scaled=scaled) if decays else hg.theta.constant(theta, scaled=scaled)
    samples = record(h, 4.0)
    run = two(align, law).run(**samples, engine="python")
    b = np.array([0, 0, 0, 0, 1.0])
    expected = oracle.run(
        lambda z, u: A @ z + b * u,
        lambda z, u: A,
        C,
        lambda value: oracle.noises(Q5, R2, (2, 3), align, value, scaled == "process"),
        lambda k: 1 + (theta - 1) * np.exp(-0.8 * h * max(k - 1, 0)) if decays else theta,
        np.eye(5),
        h,
        samples["u"],
        samples["y"],
    )
    assert not run.status.any()
    assert run.x == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.full
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("align", [pytest.param("top", marks=pytest.mark.slow), "end"])
def test_every_view_of_blocks_follows_the_same_equation(align: str) -> None:
    """RK4 on S and on P converge to it with order 4, the continuous-discrete step with order 1."""
    errors: dict[str, list[float]] = {method: [] for method in METHODS}
    for dt in (0.005, 0.0025):
        samples = record(dt, 0.7)
        exact = hg.reference(two(align, 3.0, dt=dt), **samples).x
        for method, of_method in errors.items():
            of_method.append(float(np.abs(two(align, 3.0, method, dt).run(**samples, engine="python").x - exact).max()))
    orders = {method: np.log2(coarse / fine) for method, (coarse, fine) in errors.items()}
    assert orders["continuous_discrete"] == pytest.approx(1, abs=0.25)
    assert min(orders["rk4"], orders["rk4_covariance"]) > 3.4
    assert max(fine for _, fine in errors.values()) < 0.02


@pytest.mark.ordinary("end")
@pytest.mark.parametrize("align", ["top", "end"])
def test_many_states_by_loops_are_the_few_unrolled(align: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same equation with the same operations but for their order."""
    samples = record(0.01, 2.0)

    def estimates() -> np.ndarray:
        observer = hg.observers.riccati(form(align), Q=np.diag(Q5), R=R2, theta=hg.theta.decaying(3.0, 0.5))
        return hg.sample(observer, dt=0.01).run(**samples, engine="python").x

    unrolled = estimates()
    monkeypatch.setattr("hgogen.estimators.factored.LONGER", {"speed": -(10**9)})
    assert estimates() == pytest.approx(unrolled, abs=1e-9 * np.abs(unrolled).max())


chains = st.lists(st.integers(1, 3), min_size=1, max_size=3)


@pytest.mark.full
@given(chains, st.sampled_from(["top", "end"]), st.sampled_from([0, 1]), st.floats(1.5, 6.0), st.integers(0, 1000))
@settings(deadline=None, max_examples=15)
def test_theta_multiplies_the_poles_of_integrators(
    sizes: list[int], align: str, gauge: int, theta: float, seed: int
) -> None:
    """In Delta z the equation of chains of integrators is theta times that at 1: the eigenvalues of F - P C'R_theta^-1
    C are theta times those at theta = 1. Eigenvalues of a stable solve: some 1e-7 for clusters of up to 9."""
    n, longest, rng = sum(sizes), max(sizes), np.random.default_rng(seed)
    F, C, head, states = np.zeros((n, n)), np.zeros((len(sizes), n)), 0, []
    for i, size in enumerate(sizes):
        C[i, head] = 1
        F[range(head, head + size - 1), range(head + 1, head + size)] = 1
        head += size
        states += [level + (longest - size if align == "end" else 0) for level in range(size)]
    late = tuple(longest - size if align == "end" else 0 for size in sizes)
    scaling = Scaling(tuple(states), late, gauge)
    Q, R = np.diag(rng.uniform(0.5, 2, n)), rng.uniform(0.5, 2, len(sizes))

    def poles(value: float) -> np.ndarray:
        (P,) = FrozenRiccati.of(F[None], C[None], Q, R, scaling).steady(value)
        assert np.isfinite(P).all()
        return np.sort_complex(np.linalg.eigvals(F - P @ C.T @ np.diag(1 / scaling.variances(R, value)) @ C))

    assert np.poly(poles(theta) / theta) == pytest.approx(np.poly(poles(1.0)), rel=1e-6, abs=1e-7)
    limits = [
        covariance_limits(F[None], C[None], Q, R, start, value, RK4, "covariance", scaling=scaling)[0].dt * value
        for value in (1.0, theta)
        for start in [np.diag(np.array(scaling.spread(value)) ** 2) * value**gauge]
    ]
    assert limits[0] == pytest.approx(limits[1], rel=0.03)  # the scan's grain is 2%


# --- the motor: aligned at the ends -------------------------------------------------------------------------

MOTOR = load(MODELS / "geared_motor.py")


def test_the_motors_alignment() -> None:
    """Known answers of the model's docstring."""
    aligned = {align: hg.forms.block_triangular(MOTOR.plant, align) for align in ("top", "end", "cascade")}
    verdicts = {align: str(made.checks[0].verdict) for align, made in aligned.items()}
    assert verdicts == {"top": "refuted", "end": "proved", "cascade": "proved"}
    assert (aligned["end"].blocks, hg.forms.block_triangular(MOTOR.plant).alignment) == ((1, 3), "end")
    (part, *_) = MOTOR.step().observer.parts
    assert part.scaling == Scaling((2, 0, 1, 2), (2, 0), 0)
    assert part.scaling.variances(np.ones(2), 2.0) == pytest.approx([8.0, 0.5])
    gains = {"Q": (1,) * 4, "R": 1, "theta": 2.0}
    with pytest.raises(BadGain, match='align "top" or "end"'):
        hg.observers.riccati(aligned["cascade"], **gains)


def test_the_motors_theorem_asks_its_alignment() -> None:
    by_claim = {row.claim: row for row in rows(MOTOR.step().observer.theorem, MOTOR.step().observer.checks)}
    row = by_claim["b_(i,j) reads z_(k,l) for l <= j + n_k - n_i only (end)"]
    assert (row.standing, row.checks) == ("proved", ("block_triangular.structure",))
    assert by_claim["0 < a_m <= a_(i,j) <= a_M for every input and parameter in its range"].standing == "proved"
    plain = hg.observers.riccati(hg.forms.block_triangular(MOTOR.plant, "cascade"), Q=(1,) * 4, R=1)
    by_claim = {row.claim: row for row in rows(plain.theorem, plain.checks)}
    assert by_claim["b_(i,j) reads z_(k,l) for l <= j or j + n_k - n_i only"].standing == "unknown"


@pytest.mark.parametrize(("align", "standing"), [("top", "proved"), ("end", "unknown")])
def test_the_slides_theorem_knows_no_delta(align: str, standing: str) -> None:
    """R is not scaled where delta = 1 alone."""
    observer = hg.observers.riccati(form(align), Q=Q5, R=R2, theta=hg.theta.decaying(3.0, 1.0))
    standings = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert standings["R is not scaled, and Q_theta = theta^2 Delta^-1 Q Delta^-1"] == standing


@pytest.mark.full
def test_the_motors_load_is_found_sooner_where_theta_adapts() -> None:
    """Nor is the error larger by more than a tenth, once the load is found."""
    (trial,) = MOTOR.trials()
    table = {key: value for key, value in MOTOR.module.tuning["riccati"].items() if key not in ("form", "dt")}
    plain = hg.observers.riccati(hg.forms.block_triangular(MOTOR.plant, "end"), **{**table, "theta": 1.0})
    late, steady = [], []
    for step in (hg.sample(plain, dt=1e-3), MOTOR.step()):
        (trajectory,) = hg.trial.try_out(step, trial, engine="python", seeds=(0,))
        t, error = trajectory.truth.t, np.abs(trajectory.error[:, 3])
        late.append(max(t[(t < end) & (error > 0.01)].max() - end + 2 for end in (4.0, 6.0)))
        steady.append(np.sqrt((error[t > 5.5] ** 2).mean()))
    assert late[1] < late[0] / 2
    assert steady[1] < 1.1 * steady[0]


# --- the innovation of several outputs ----------------------------------------------------------------------


def resting(innovation: Any, y: np.ndarray) -> np.ndarray:
    """Two plants at rest and an observer that does not follow: each sample adds dt y^2 to its output's sum."""
    x = [hg.Signal(name, low=-9, high=9) for name in ("a", "b")]
    outputs = [hg.Signal(f"y_{name}", low=-9, high=9) for name in ("a", "b")]
    plant = hg.System("rest", states=x, outputs=outputs, flow=[0, 0], output=x)
    theta = hg.theta.adaptive(4.0, mu=(1e6, 2e6), innovation=innovation)
    observer = hg.observers.riccati(
        hg.forms.block_triangular(plant), Q=(1e-12, 1e-12), R=1e12, covariance=(1e-12, 1e-12), theta=theta
    )
    return hg.sample(observer, dt=0.1).run(y=y, engine="python").traces["innovation"]


@pytest.mark.ordinary("<lambda>")
@pytest.mark.parametrize("make", [hg.innovation.window, lambda d, **more: hg.innovation.staggered(d, 2, **more)])
def test_outputs_add_up_by_their_weights(make: Callable[..., Any]) -> None:
    """Over 1 s: 1^2 + 2^2, or 10 * 1^2 + 0.5 * 2^2."""
    y = np.tile([1.0, 2.0], (60, 1))
    assert resting(make(1.0), y)[20:] == pytest.approx(5.0, abs=1e-6)
    assert resting(make(1.0, weights=(10.0, 0.5)), y)[20:] == pytest.approx(12.0, abs=1e-6)


def test_each_output_counts_its_own_samples() -> None:
    """A sensor that is silent adds nothing, and does not change what the other counts for."""
    y = np.tile([1.0, 2.0], (60, 1))
    y[:, 0] = np.nan
    innovation = resting(hg.innovation.staggered(1.0, predictors=2), y)[20:]
    assert innovation == pytest.approx(4.0, abs=1e-6)


def test_weights_are_one_for_each_output() -> None:
    with pytest.raises(BadWindowSize, match="weights of length 3 must have one number for each of 2 outputs"):
        resting(hg.innovation.staggered(1.0, weights=(1, 2, 3)), np.zeros((2, 2)))
    for bad in ((1.0, -1.0), (), "x"):
        with pytest.raises((BadWindowSize, BadGain), match="weights"):
            hg.innovation.window(1.0, weights=bad)
    assert model("geared_motor").outputs == MOTOR.plant.outputs
