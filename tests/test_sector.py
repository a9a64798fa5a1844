"""The quadratic forms of saturations and dead zones are what they bound: derivatives along the error equation."""

from dataclasses import replace
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
from hgogen.check import Verdict
from hgogen.estimators.integrators import companion, integrators
from hgogen.prove import inequality
from hgogen.prove.limited_injection import (
    DEAD_ZONE,
    SATURATION,
    Adaptation,
    LimitedInjection,
    Shape,
    core_check,
    decays,
    limited_injection,
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
    """The eigenvalues of the form with a P of scipy's."""
    adaptation, K = Adaptation(shape, Fraction(1), Fraction(r)), np.poly(poles)[1:]
    proofs = decays(adaptation, K)
    assert len(proofs) >= 2
    for one in proofs:
        S = np.diag(float(one.growth) ** np.arange(len(K)))
        N = S @ companion(K) @ np.linalg.inv(S)
        P = solve_continuous_lyapunov(N.T, -np.eye(len(K)))
        form = adaptation.form(N, S @ K, P, float(one.mu), float(one.tau))
        assert np.linalg.eigvalsh(form)[-1] < 0
        assert np.array(one.P, dtype=float) == pytest.approx(P, rel=1e-3)


def sought(form: hg.Form, shape: Shape, r: float, K: tuple[float, ...], theta: float) -> LimitedInjection:
    """What is sought of an observer of these gains on a form, with lambda = 1."""
    gains = np.array(K)
    proofs = decays(Adaptation(shape, Fraction(1), Fraction(r)), gains)
    known = limited_injection(integrators("x", form), theta, gains, proofs, {})
    assert isinstance(known, LimitedInjection), known
    return known


def chained() -> hg.Form:
    """a_2 = 2, a_3 = k: w_3 = 2 k z_3, and with w_i' = w_(i+1) + .. the slope of c_3 = -2 k sin z_1 is 2 k."""
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2, 3)]
    y, k = hg.Signal("y"), hg.Signal("k", nominal=0.5)
    flow = [2 * x[1], k * x[2], -sp.sin(x[0])]
    plant = hg.System("scaled", states=x, outputs=(y,), parameters=(k,), flow=flow, output=[x[0]])
    return hg.forms.triangular(plant)


def test_parameters_in_the_chain_have_their_values_in_the_slopes() -> None:
    known = sought(chained(), SATURATION, 10.0, (3.0, 3.0, 1.0), 20)
    (slope,) = known.error.varying
    assert float(slope.high) * float(known.error.units[0] / known.error.units[2]) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("corners", [True, False])
@pytest.mark.parametrize(("shape", "r"), [(DEAD_ZONE, 0.1), (SATURATION, 10.0)])
def test_the_form_is_negative_for_slopes_in_their_ranges(
    shape: Shape, r: float, corners: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the pendulum and of a chain of three, at the least theta, beyond it, and with the rate of the one at hand."""
    monkeypatch.setattr(inequality, "WORK", inequality.WORK if corners else 1)
    rng = np.random.default_rng(0)
    for form, K in ((swing.form(), (2.0, 1.0)), (chained(), (3.0, 3.0, 1.0))):
        known = sought(form, shape, r, K, 60)
        least, fastest, adaptation = known.least, known.fastest, Adaptation(shape, Fraction(1), Fraction(r))
        assert least is not None
        assert fastest is not None
        assert fastest.rate > 0
        assert bool(least.weights.S) is not corners
        u, n = np.array([float(unit) for unit in known.error.units]), len(K)
        for function, theta, alpha in ((least, 1, 0), (least, 3, 0), (fastest, 1, float(fastest.alpha))):
            level = float(function.theta) * theta
            P = np.array([[float(x) for x in row] for row in function.weights.P])
            mu = float(function.others["mu"])
            e = known.error.at(Fraction(level)).floats
            for _ in range(200):
                d = np.clip(rng.uniform(-2, 2, size=e.G.shape[1]), -1, 1)
                N = (e.M + (e.G * d) @ e.H) / level
                whole = adaptation.form(N, u * K, P, mu, float(function.others["tau"]))
                whole = whole + alpha / level * adaptation.value(P, mu)
                assert np.linalg.eigvalsh(whole)[-1] < 0
                assert np.linalg.eigvalsh(N.T @ P + P @ N + alpha / level * P)[-1] < 0
        assert n == len(least.weights.P)


def test_what_stands_in_the_way_is_told() -> None:
    """A slope that is unstable when held, or that no V serves all."""
    assert "held there, errors do not decay" in str(
        sought(swing.form(), SATURATION, 10.0, (2.0, 1.0), 4).obstacle("qw")
    )
    assert "no function is found" in str(sought(swing.form(), SATURATION, 10.0, (2.0, 1.0), 6).obstacle("qw"))
    nothing = replace(sought(swing.form(), SATURATION, 10.0, (2.0, 1.0), 6), decays=())
    assert nothing.least is nothing.fastest is None
    assert str(nothing.missing) == "the linear core is not shown to decay"


@pytest.mark.ordinary("stubborn-1.01", "stubborn-100.0", "dead_zone-100.0")
@pytest.mark.parametrize("factor", [1.01, 100.0])
@pytest.mark.parametrize("kind", ["stubborn", "dead_zone"])
def test_above_the_bound_the_lyapunov_function_falls_with_the_model_in_it(kind: str, factor: float) -> None:
    """d/dt of V along the error of the pendulum, anywhere in the box, at a theta above the bound: V' <= -2 rate V by
    finite differences of the equations, for the V and the rate that the proof has."""
    r = {"stubborn": 10.0, "dead_zone": 0.1}[kind]
    build = getattr(hg.observers, kind)
    checks = {c.id: c for c in build(swing.form(), theta=20, decay=1, r=r, poles=(-1, -1)).checks}
    assert checks[f"{kind}.convergence"].verdict is Verdict.PROVED
    theta = factor * float(checks[f"{kind}.convergence"].proofs[0].fact.theta)
    high = {c.id: c for c in build(swing.form(), theta=theta, decay=1, r=r, poles=(-1, -1)).checks}
    assert high[f"{kind}.theta"].verdict is Verdict.PROVED
    function, K = high[f"{kind}.theta"].proofs[0].fact.falls, np.array([2.0, 1.0])
    P, mu = np.array([[float(x) for x in row] for row in function.weights.P]), float(function.others["mu"])
    S = np.array([float(unit) for unit in high[f"{kind}.convergence"].proofs[0].fact.error.units])
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
        assert derivative < -2 * function.rate * V <= 0
