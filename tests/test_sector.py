"""The quadratic forms of saturations and dead zones are what they bound: derivatives along the error equation."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import swing
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle.swing import c
from scipy.linalg import solve_continuous_lyapunov

import hgogen as hg
from hgogen.chains.injection import companion
from hgogen.chains.integrators import integrators
from hgogen.check import Verdict
from hgogen.guarantees.sector import (
    DEAD_ZONE,
    SATURATION,
    Adaptation,
    SectorBound,
    Shape,
    core_check,
    decays,
    theta_bound,
)

seeds = st.integers(0, 2**32 - 1)


def setting(seed: int, shape: Shape) -> tuple[Any, ...]:
    """A random adaptation, K, P, mu, tau, and a random (eps, sigma)."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    K = np.poly(-rng.uniform(0.3, 3, n))[1:]
    P = solve_continuous_lyapunov(companion(K).T, -np.eye(n))
    decay, r, mu, tau = rng.uniform(0.01, 3, 4)
    adaptation = Adaptation(shape, Fraction(decay), Fraction(r))
    return adaptation, K, P, mu, tau, rng.standard_normal(n), rng.uniform(0, 2)


@given(seeds)
@settings(deadline=None)
def test_the_form_of_the_dead_zone_bounds_the_derivative(seed: int) -> None:
    """V = eps'P eps + mu sigma, at l = 1; equal where s^2 = sigma."""
    adaptation, K, P, mu, tau, eps, sigma = setting(seed, DEAD_ZONE)
    decay, r = float(adaptation.decay), float(adaptation.r)
    s = np.clip(eps[0], -np.sqrt(sigma), np.sqrt(sigma))
    rate = companion(K) @ eps + K * s
    derivative = 2 * eps @ P @ rate + mu * (r * eps[0] ** 2 - decay * sigma)
    z = np.append(eps, s)
    assert derivative <= z @ adaptation.form(companion(K), K, P, mu, tau) @ z + 1e-9
    slack = mu * decay * (sigma - s * s) + 2 * tau * s * (eps[0] - s)
    assert z @ adaptation.form(companion(K), K, P, mu, tau) @ z == pytest.approx(derivative + slack, abs=1e-9)


@given(seeds)
@settings(deadline=None)
def test_the_form_of_the_saturation_bounds_the_derivative(seed: int) -> None:
    """V = eps'P eps + mu (eps_1^2 - sigma) where eps_1^2 > sigma, at l = 1."""
    adaptation, K, P, mu, tau, eps, sigma = setting(seed, SATURATION)
    decay, r, e = float(adaptation.decay), float(adaptation.r), eps[0]
    sat = np.clip(e, -np.sqrt(sigma), np.sqrt(sigma))
    q = e - sat
    rate = np.append(eps[1:], 0) - K * sat
    derivative = 2 * eps @ P @ rate
    if e * e > sigma:
        derivative += mu * (2 * e * rate[0] - (r * e * e - decay * sigma))
        z = np.append(eps, q)
        form = z @ adaptation.form(companion(K), K, P, mu, tau) @ z
        assert form == pytest.approx(derivative + 2 * tau * q * sat, abs=1e-9)
        assert q * sat >= 0
    else:
        assert derivative == pytest.approx(-eps @ eps, abs=1e-9)


@pytest.mark.parametrize(("shape", "r"), [(DEAD_ZONE, 0.1), (SATURATION, 10.0)])
def test_the_form_that_is_proved_is_the_float_one(shape: Shape, r: float) -> None:
    """In rationals and in floats the same matrix; and its largest eigenvalue is negative."""
    adaptation, K = Adaptation(shape, Fraction(1), Fraction(r)), np.array([3.0, 3.0, 1.0])
    exactly = np.array([Fraction(k) for k in K])
    P = solve_continuous_lyapunov(companion(K).T, -np.eye(3))
    rational = np.array([[Fraction(value) for value in row] for row in P])
    exact = adaptation.form(companion(exactly), exactly, rational, Fraction(1, 2), Fraction(8)).astype(float)
    assert exact == pytest.approx(adaptation.form(companion(K), K, P, 0.5, 8.0), rel=1e-12)
    assert core_check("x.core", adaptation, decays(adaptation, K), {}).verdict is Verdict.PROVED


@pytest.mark.parametrize(("shape", "r"), [(DEAD_ZONE, 0.1), (SATURATION, 10.0)])
@pytest.mark.parametrize("poles", [(-1, -1), (-1, -2, -1.5)])
def test_every_proof_holds_in_its_coordinates(shape: Shape, r: float, poles: tuple[float, ...]) -> None:
    """The eigenvalues of the form with a P of scipy's; peak >= lambda_max(P), and not much larger."""
    adaptation, K = Adaptation(shape, Fraction(1), Fraction(r)), np.poly(poles)[1:]
    proofs = decays(adaptation, K)
    assert len(proofs) >= 2
    for one in proofs:
        S = np.diag(float(one.growth) ** np.arange(len(K)))
        N = S @ companion(K) @ np.linalg.inv(S)
        P = solve_continuous_lyapunov(N.T, -np.eye(len(K)))
        form = adaptation.form(N, S @ K, P, float(one.mu), float(one.tau))
        assert np.linalg.eigvalsh(form)[-1] < -float(one.margin) * (1 - 1e-3) < 0
        assert np.linalg.eigvalsh(P)[-1] == pytest.approx(float(one.peak), rel=1e-3)


def test_parameters_in_the_chain_have_their_values_in_the_bound() -> None:
    """a_2 = 2, a_3 = k: w_3 = 2 k z_3, and with w_i' = w_(i+1) + .. the slope of c_3 = -2 k sin z_1 is 2 k."""
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2, 3)]
    y, k = hg.Signal("y"), hg.Signal("k", nominal=0.5)
    flow = [2 * x[1], k * x[2], -sp.sin(x[0])]
    plant = hg.System("scaled", states=x, outputs=(y,), parameters=(k,), flow=flow, output=[x[0]])
    chain = integrators("x", hg.forms.triangular(plant))
    proofs = decays(Adaptation(SATURATION, Fraction(1), Fraction(10)), np.array([3.0, 3.0, 1.0]))
    bound = theta_bound(chain, proofs[:1], {})
    assert isinstance(bound, SectorBound)
    assert float(bound.lipschitz) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize(("shape", "r"), [(DEAD_ZONE, 0.1), (SATURATION, 10.0)])
def test_the_bound_is_the_formulas(shape: Shape, r: float) -> None:
    """Of the pendulum, in the coordinates g^(i-1) eps_i: L_b = |(19.6 g, .1)|."""
    chain, K = integrators("x", swing.form()), np.array([2.0, 1.0])
    proofs = decays(Adaptation(shape, Fraction(1), Fraction(r)), K)
    assert len({one.growth for one in proofs}) >= 2
    for one in proofs:
        bound = theta_bound(chain, [one], {})
        assert isinstance(bound, SectorBound)
        assert float(bound.lipschitz) == pytest.approx(np.hypot(19.6 * float(one.growth), 0.1), rel=1e-3)
        weight = float(one.peak + (one.mu if shape is SATURATION else 0))
        expected = 2 * float(bound.lipschitz) * max(weight / float(one.margin), float(one.peak))
        assert float(bound.theta) == pytest.approx(max(1.0, expected), rel=1e-12)
        assert bound.rate(float(bound.theta) * (1 - 1e-9)) <= 0 < bound.rate(float(bound.theta) * (1 + 1e-9))
        theta, lipschitz = 100 * float(bound.theta), float(bound.lipschitz)
        left = (theta * float(one.margin) - 2 * weight * lipschitz) / weight
        within = theta * min(float(one.margin / one.mu), 1.0)  # of mu sigma alone
        beyond = (theta - 2 * float(one.peak) * lipschitz) / float(one.peak)  # where all is injected
        rest = beyond if shape is SATURATION else within
        assert bound.rate(theta) == pytest.approx(min(left, rest) / 2, rel=1e-12)


@pytest.mark.parametrize("factor", [1.01, 100.0])
@pytest.mark.parametrize("kind", ["stubborn", "dead_zone"])
def test_above_the_bound_the_lyapunov_function_falls_with_the_model_in_it(kind: str, factor: float) -> None:
    """d/dt of V along the error of the pendulum, anywhere in the box, at a theta above the bound: V' <= -2 rate V by
    finite differences of the equations, for the V and the rate that the proof has."""
    r = {"stubborn": 10.0, "dead_zone": 0.1}[kind]
    build = getattr(hg.observers, kind)
    checks = {c.id: c for c in build(swing.form(), theta=20, decay=1, r=r, poles=(-1, -1)).checks}
    assert checks[f"{kind}.convergence"].verdict is Verdict.PROVED
    assert checks[f"{kind}.theta"].verdict is Verdict.UNKNOWN
    theta = factor * float(str(checks[f"{kind}.convergence"].reason.part("bound").part("theta")))
    high = {c.id: c for c in build(swing.form(), theta=theta, decay=1, r=r, poles=(-1, -1)).checks}
    assert high[f"{kind}.theta"].verdict is Verdict.PROVED
    shape = {"stubborn": SATURATION, "dead_zone": DEAD_ZONE}[kind]
    adaptation, K = Adaptation(shape, Fraction(1), Fraction(r)), np.array([2.0, 1.0])
    bound = theta_bound(integrators(kind, swing.form()), decays(adaptation, K), {})
    assert isinstance(bound, SectorBound)
    S, mu = np.array([1.0, float(bound.decay.growth)]), float(bound.decay.mu)
    P = solve_continuous_lyapunov((np.diag(S) @ companion(K) @ np.diag(1 / S)).T, -np.eye(2))
    rng = np.random.default_rng(0)
    for _ in range(2000):
        x, w = rng.uniform((-4, -20), (4, 20), (2, 2))
        x = w + (x - w) * 10.0 ** rng.uniform(-4, 0)
        error = x - w
        sigma = (error[0] * rng.uniform(0, 2)) ** 2
        sat = np.clip(error[0], -np.sqrt(sigma), np.sqrt(sigma))
        injected = sat if kind == "stubborn" else error[0] - sat
        rate = np.array([error[1], 0]) - np.array([theta, theta**2]) * K * injected + c(x, 0.0) - c(w, 0.0)
        eps, moved = S * error / [1, theta], S * rate / [1, theta]
        derivative = 2 * eps @ P @ moved
        growth, V = theta * (r * error[0] ** 2 - sigma), eps @ P @ eps
        if kind == "dead_zone":
            derivative, V = derivative + mu * growth, V + mu * sigma
        elif error[0] ** 2 > sigma:
            derivative, V = derivative + mu * (2 * error[0] * rate[0] - growth), V + mu * (error[0] ** 2 - sigma)
        assert derivative < -2 * bound.rate(theta) * V < 0
