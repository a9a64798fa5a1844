"""Process noise of a lower rank: the estimates are those of a Kalman filter in plain numpy, and P stays finite."""

import math

import numpy as np
import pytest

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.riccati_part import factor
from hgogen.reading.given import BadGain

DT, R = 0.02, 4e-4
A = np.array([[0.0, 1, 0], [-2, -0.3, 1], [0, 0, 0]])
q, w, bias, y = (hg.Signal(name, low=-5, high=5) for name in ("q", "w", "bias", "y"))
plant = hg.System("swing", states=(q, w, bias), outputs=(y,), flow=[w, -2 * q - 0.3 * w + bias, 0], output=[q])
form = hg.forms.original(plant)
direction = np.array([0.1, 0.3, 0.0])
NOISES = {
    "a constant state": np.diag([1e-4, 1e-2, 0]),
    "no noise at all": np.zeros((3, 3)),
    "rank one": np.outer(direction, direction),
    "rank one, on the last states": np.outer([0, 1, -3.0], [0, 1, -3.0]),
}


def filtered(Q: np.ndarray, measured: np.ndarray, order: int = 2) -> np.ndarray:
    """Return the estimates (N, 3) of P <- Phi P Phi' + h Q, r = R/h, Phi a Taylor polynomial of exp(hA), z by RK4."""
    step, z, P, rows = DT * A, np.zeros(3), np.eye(3), []
    terms = [np.linalg.matrix_power(step, k) / math.factorial(k) for k in range(5)]
    advance, Phi = sum(terms), sum(terms[: order + 1])
    for k, sample in enumerate(measured):
        z, P = (advance @ z, Phi @ P @ Phi.T + DT * Q) if k else (z, P)  # the first call only corrects
        if np.isfinite(sample):
            K = P[:, 0] / (P[0, 0] + R / DT)
            z, P = z + K * (sample - z[0]), P - np.outer(K, P[0])
        rows.append(z)
    return np.array(rows)


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    samples = np.sin(np.arange(3000) * DT) + np.random.default_rng(1).normal(0, 0.1, 3000)
    samples[500:600] = np.nan
    return samples


@pytest.mark.parametrize("make", ["riccati", "ukf", "iterated_ekf"])
@pytest.mark.parametrize("name", NOISES)
def test_the_estimates_are_those_of_a_kalman_filter(name: str, make: str, measured: np.ndarray) -> None:
    Q = NOISES[name]
    observer = getattr(hg.observers, make)(form, Q=Q, R=R)
    step = hg.sample(observer, dt=DT)
    run = step.run(y=measured, engine="python" if make != "riccati" else None)
    assert run.x == pytest.approx(filtered(Q, measured, 4 if make == "ukf" else 2), abs=1e-9)
    assert step.flags(int(np.bitwise_or.reduce(run.status))) == ("MISSING_Y",)


def test_a_matrix_with_a_negative_eigenvalue_is_refused() -> None:
    for Q in (np.diag([1, 1, -1e-9]), [[1, 2, 0], [2, 1, 0], [0, 0, 0]], [[0, 1, 0], [1, 0, 0], [0, 0, 1]]):
        with pytest.raises(BadGain, match="must be positive semidefinite"):
            hg.observers.riccati(form, Q=Q, R=R)


def test_the_factors_of_a_singular_matrix_are_those_of_its_numbers() -> None:
    """A product of rounded numbers may have a negative eigenvalue of 1e-17."""
    for Q in NOISES.values():
        L, d = factor(Q)
        assert (d >= 0).all()
        assert np.diag(L).tolist() == [1, 1, 1]
        assert L @ np.diag(d) @ L.T == pytest.approx(Q, abs=1e-15)


def test_what_no_noise_reaches_is_unknown_and_named() -> None:
    """The constant state is observable, and its gain tends to 0: an error of the model there is never corrected."""
    observer = hg.observers.riccati(form, Q=(1e-4, 1e-2, 0), R=R)
    check = next(each for each in observer.checks if str(each.id) == "riccati.convergence")
    assert check.verdict is Verdict.UNKNOWN
    assert "the gain may vanish" in str(check.reason)
    said = [str(each.reason) for each in observer.theorem.hypotheses]
    assert any("no noise reaches bias" in each for each in said)
    reached = hg.observers.riccati(form, Q=(0, 0, 1e-3), R=R).checks
    assert next(each for each in reached if str(each.id) == "riccati.convergence").verdict is Verdict.PROVED


def test_an_information_matrix_that_would_grow_without_bound_is_refused() -> None:
    observer = hg.observers.riccati(form, Q=(1e-4, 1e-2, 0), R=R)
    with pytest.raises(BadGain, match="take the method continuous_discrete, cholesky or rk4_covariance"):
        hg.sample(observer, hg.methods.rk4, dt=1e-3)
    hg.sample(observer, hg.methods.rk4_covariance, dt=5e-4)


@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("count", [2, 14])
def test_without_noise_the_covariance_of_a_decaying_state_stays_above_0(real: str, count: int) -> None:
    """x' = -x over 400 time constants: exp(-2t) leaves the numbers of a float, and D its floor, 1e-24 D(0)."""
    x = [hg.Signal(f"x{i}", low=-5, high=5) for i in range(count)]
    decays = hg.System("decay", states=x, outputs=(y,), flow=[-k * s for k, s in enumerate(x, 1)], output=[sum(x)])
    observer = hg.observers.riccati(hg.forms.original(decays), Q=(0,) * count, R=R)
    step = hg.sample(observer, dt=DT, real=real)
    (floor,) = (each.low for each in step.layout.state if each.name == "D")
    assert floor == pytest.approx([1e-24] * count)
    run = step.run(y=np.where(np.arange(20_000) < 100, 1.0, 0.0))
    assert np.isfinite(run.x).all()
    assert np.abs(run.x[-1]).max() < 1e-6
    assert not np.bitwise_or.reduce(run.status[1000:])
