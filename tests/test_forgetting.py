"""What a covariance that forgets does where nothing is seen: without samples, and with states that the input hides.

S' = -rho (S - S_0) - A'S - S A + C'R^-1 C, which is linear: S is what the samples show plus what S_0 leaves.
"""

from functools import cache

import numpy as np
import pytest
from native_step import NativeStep
from plants import chain, model
from scipy.linalg import solve_discrete_lyapunov

import hgogen as hg
from hgogen.emit import native
from hgogen.emit.cprint import Real
from hgogen.kalman.factored import largest
from hgogen.observer import Observer

NAN = float("nan")
EPS_NEURON = 0.8
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
reals = pytest.mark.parametrize("real", ["float", "double"])
VIEWS = [("pendulum", "continuous_discrete"), ("pendulum", "cholesky"), ("chain", "continuous_discrete")]


@cache
def observer(name: str) -> Observer:
    """The pendulum with its own tuning, or the chain of eight, whose covariance is in loops."""
    if name == "chain":
        return hg.observers.kalman_like(hg.forms.state_affine(chain(8)), rho=4.0, R=1e-3)
    return hg.observers.kalman_like(hg.forms.state_affine(model("pendulum")), rho=5, R=1e-9)


@cache
def sampled(name: str, method: str) -> hg.Step:
    return hg.sample(observer(name), getattr(hg.methods, method), dt=0.01 if name == "chain" else 1e-3)


def caps(of: Observer) -> np.ndarray:
    (part,) = of.parts
    return part.cap


def covariance(step: hg.Step, state: np.ndarray) -> np.ndarray:
    """P of L and D, of the columns of L in a group, or of its root."""
    n = len(step.states)
    lower, numbers = np.eye(n), {name: np.asarray(state[name][0], dtype=object) for name in state.dtype.names}
    if "root" in numbers:
        lower = np.zeros((n, n))
        lower.T[np.triu_indices(n)] = numbers["root"].astype(float)
        return lower @ lower.T
    if "column" in numbers:
        for k in range(n):
            lower[k + 1 :, k] = state["column"]["v"][0][k, k + 1 :]
    else:
        lower.T[np.triu_indices(n, 1)] = numbers["L"].astype(float)
    return lower @ np.diag(numbers["D"].astype(float)) @ lower.T


# --- without samples ----------------------------------------------------------------------------------------


@needs_compiler
@reals
@pytest.mark.parametrize(("name", "method"), VIEWS)
def test_in_silence_the_covariance_tends_to_its_limit(name: str, method: str, real: Real) -> None:
    """S = exp(-rho h) Phi'^-1 S Phi^-1 + (1 - exp(-rho h)) S_0, to which the start decays at rho less twice the plant's
    own rate (.1 or 1). A step rounds n^2 products, and 1/(rho h) of them count."""
    step, of = sampled(name, method), observer(name)
    rho, n, h = of.gains[0].initial[0], of.form.n, step.dt
    compiled, count = NativeStep(step, real), round(60 / (rho - (0.2 if name == "pendulum" else 2.0)) / h)
    found = compiled.run(np.zeros((count, 1)), np.full((count, 1), NAN))
    A = np.array([[0, 1], [0, -0.1]]) if name == "pendulum" else np.eye(n, k=1) - np.diag([0.0] * (n - 1) + [1])
    back = np.exp(-rho * h / 2) * np.linalg.inv(np.eye(n) + h * A + h * h / 2 * A @ A)
    S = solve_discrete_lyapunov(back.T, (1 - np.exp(-rho * h)) * np.diag(1 / caps(of)))
    P, unit = covariance(step, compiled.state), np.sqrt(caps(of))
    rounding = n * n / (rho * h) * np.finfo(np.float32 if real == "float" else float).eps
    scaled = S * np.outer(unit, unit)
    limits = np.linalg.cond(scaled) * rounding
    assert scaled @ (P / np.outer(unit, unit)) == pytest.approx(np.eye(n), abs=limits)
    assert (np.diag(P) < largest(of.parts[0])).all()
    assert all("COVARIANCE_LIMITED" in step.flags(status) for status in found.status[count // 2 :])
