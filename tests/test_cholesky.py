"""The covariance as P = S S': its updates, and the step against the factored one and the continuous equations."""

from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from exact import machine
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import chain, fitzhugh_nagumo, kalman, two_outputs

import hgogen as hg
from hgogen.discretisation.stability import Limit
from hgogen.estimators.square_root import carlson, triangle
from hgogen.program import Place
from hgogen.reading.given import BadGain
from hgogen.run.native import run_check

EPS = np.finfo(float).eps
NAN = float("nan")


@cache
def updates(n: int) -> tuple[Any, Any]:
    """Of a stack (n, 2n), and of (S, c, r)."""
    stack, S, c, r = (ca.SX.sym(*name) for name in (("A", n, 2 * n), ("S", n, n), ("c", 1, n), ("r",)))
    lower = ca.tril(S)
    return (
        ca.Function("triangle", [stack], [triangle(stack)[0]]),
        ca.Function("carlson", [S, c, r], carlson(lower, lower.T @ c.T, r)),
    )


def assert_root(S: np.ndarray) -> None:
    assert np.array_equal(S, np.tril(S))
    assert (np.diag(S) > 0).all()


sizes, seeds = st.integers(1, 6), st.integers(0, 2**32 - 1)


@given(sizes, seeds)
@settings(deadline=None, max_examples=25)
def test_the_triangle_is_that_of_the_stack(n: int, seed: int) -> None:
    """Modified Gram-Schmidt is backward stable in its triangle: some n^2 eps of each row's size."""
    stack = np.random.default_rng(seed).standard_normal((n, 2 * n)) * 10 ** np.linspace(-2, 2, n)[:, None]
    S = np.array(updates(n)[0](stack))
    assert_root(S)
    size = np.linalg.norm(stack, axis=1)
    assert (np.abs(S @ S.T - stack @ stack.T) / np.outer(size, size)).max() < 100 * n**2 * EPS


@given(sizes, seeds)
@settings(deadline=None, max_examples=25)
def test_the_measurement_update_is_the_dense_one(n: int, seed: int) -> None:
    """P - K c P loses no more than some n^2 eps of P, and K as much of itself."""
    rng = np.random.default_rng(seed)
    S = np.tril(rng.standard_normal((n, n)), -1) + np.diag(10 ** rng.uniform(-2, 2, n))
    c, r = rng.standard_normal((1, n)), 10 ** rng.uniform(-2, 2)
    after, gain = (np.array(part) for part in updates(n)[1](S, c, r))
    assert_root(after)
    P = S @ S.T
    K = P @ c.T / (r + (c @ P @ c.T).item())
    scale = np.sqrt(np.diag(P))
    assert (np.abs(after @ after.T - (P - K @ c @ P)) / np.outer(scale, scale)).max() < 100 * n**2 * EPS
    assert gain == pytest.approx(K, abs=100 * n**2 * EPS * (np.abs(K).max() + scale.max() / np.sqrt(r)))


# --- the step -----------------------------------------------------------------------------------------------

FULL = np.diag([0.1, 0.01, 2.3e-4]) + 1e-4
OBSERVERS = {
    "kalman": partial(fitzhugh_nagumo, Q=FULL),
    "theta_8": partial(fitzhugh_nagumo, theta=8.0),
    "decaying": partial(fitzhugh_nagumo, theta=hg.theta.decaying(5.0, 0.4)),
    "adaptive": lambda: fitzhugh_nagumo(
        theta=hg.theta.adaptive(2.0, rise_time=0.3, mu=(0.01, 0.3), innovation=hg.innovation.staggered(0.4, 2))
    ),
    "two_outputs": lambda: hg.observers.riccati(hg.forms.original(two_outputs()), Q=(1, 1, 1), R=(0.1, 0.2)),
}


def record(outputs: int, dt: float, duration: float) -> dict[str, np.ndarray]:
    t = np.arange(round(duration / dt) + 1) * dt
    y = np.column_stack([1.5 * np.cos(0.7 * t + 0.3), np.sin(0.2 * t)])[:, :outputs]
    return {"u": 0.5 * np.sin(t), "y": y}


@pytest.mark.parametrize("name", OBSERVERS)
def test_it_is_the_factored_step_but_for_rounding(name: str) -> None:
    """With samples missing for 2 s; 1e3 operations in each of 600 steps, forgotten within 1 s."""
    observer = OBSERVERS[name]()
    samples = record(len(observer.form.output), 0.01, 6.0)
    samples["y"][200:400] = NAN
    runs = [
        hg.sample(observer, how, dt=0.01).run(**samples, engine="python")
        for how in (hg.methods.cholesky, hg.methods.continuous_discrete)
    ]
    assert runs[0].x == pytest.approx(runs[1].x, abs=1e-9 * np.abs(runs[1].x).max())
    assert (runs[0].status == runs[1].status).all()


def test_all_views_agree_at_constant_theta(monkeypatch: pytest.MonkeyPatch) -> None:
    """S, P, L D L' and S S' of one observer against its continuous equations: orders 4, 4, 1, 1 with one constant."""
    monkeypatch.setattr("hgogen.method.covariance_limits", lambda *arguments: [Limit(np.inf, "not asked")])
    observer, errors = fitzhugh_nagumo(theta=3.0), {}
    for dt in (0.02, 0.01):
        samples = record(1, dt, 1.0)
        exact = hg.reference(observer, **samples, dt=dt).x
        for how in ("rk4", "rk4_covariance", "continuous_discrete", "cholesky"):
            run = hg.sample(observer, getattr(hg.methods, how), dt=dt).run(**samples, engine="python")
            errors.setdefault(how, []).append(np.abs(run.x - exact).max())
    orders = {how: np.log2(coarse / fine) for how, (coarse, fine) in errors.items()}
    assert [round(orders[how]) for how in ("rk4", "rk4_covariance", "continuous_discrete", "cholesky")] == [4, 4, 1, 1]
    assert errors["cholesky"] == pytest.approx(errors["continuous_discrete"], rel=1e-6)
    assert max(errors["rk4"][1], errors["rk4_covariance"][1]) < 1e-4
    assert errors["cholesky"][1] < 0.1


@pytest.mark.slow
def test_a_long_loss_of_samples_is_capped_and_comes_back_in_float() -> None:
    """The chain's truth is its rest."""
    form = hg.forms.triangular(chain(3))
    observer = hg.observers.riccati(form, Q=(100.0,) * 3, R=0.01, initial={"x1": 1.0, "x3": -1.0})
    step = hg.sample(observer, hg.methods.cholesky, dt=0.01)
    reader, capped = machine(step, "float"), 0
    reader.memory[Place("output", "y")][0] = NAN
    for _ in range(500):
        capped += "COVARIANCE_LIMITED" in step.flags(reader.call())
        assert np.isfinite(reader.memory[Place("state", "root")]).all()
    assert capped
    reader.memory[Place("output", "y")][0] = 0.0
    for _ in range(500):
        reader.call()
    assert np.abs(reader.memory[Place("state", "z")]).max() < 0.1


@pytest.mark.full
@pytest.mark.parametrize("real", ["float", "double"])
def test_its_c_runs(real: Any) -> None:
    """The emitted self-check compares every recorded vector."""
    step = hg.sample(fitzhugh_nagumo(theta=hg.theta.decaying(5.0, 0.4)), hg.methods.cholesky, dt=0.01)
    run_check(hg.targets.c99(step, real=real))


def test_many_states_are_refused() -> None:
    with pytest.raises(BadGain, match="cholesky takes up to 7 states, there are 8; take continuous_discrete"):
        hg.sample(kalman(chain(8)), hg.methods.cholesky, dt=0.01)
