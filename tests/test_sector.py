"""The quadratic forms of saturations and dead zones are what they bound: derivatives along the error equation."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from hgogen.check import Verdict
from hgogen.injection import companion
from hgogen.sector import Adaptation, decays

seeds = st.integers(0, 2**32 - 1)


def setting(seed: int, shape: Any) -> tuple[Any, ...]:
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
    adaptation, K, P, mu, tau, eps, sigma = setting(seed, "dead zone")
    decay, r = float(adaptation.decay), float(adaptation.r)
    s = np.clip(eps[0], -np.sqrt(sigma), np.sqrt(sigma))
    rate = companion(K) @ eps + K * s
    derivative = 2 * eps @ P @ rate + mu * (r * eps[0] ** 2 - decay * sigma)
    z = np.append(eps, s)
    assert derivative <= z @ adaptation.form(K, P, mu, tau) @ z + 1e-9
    slack = mu * decay * (sigma - s * s) + 2 * tau * s * (eps[0] - s)
    assert z @ adaptation.form(K, P, mu, tau) @ z == pytest.approx(derivative + slack, abs=1e-9)


@given(seeds)
@settings(deadline=None)
def test_the_form_of_the_saturation_bounds_the_derivative(seed: int) -> None:
    """V = eps'P eps + mu (eps_1^2 - sigma) where eps_1^2 > sigma, at l = 1."""
    adaptation, K, P, mu, tau, eps, sigma = setting(seed, "saturation")
    decay, r, e = float(adaptation.decay), float(adaptation.r), eps[0]
    sat = np.clip(e, -np.sqrt(sigma), np.sqrt(sigma))
    q = e - sat
    rate = np.append(eps[1:], 0) - K * sat
    derivative = 2 * eps @ P @ rate
    if e * e > sigma:
        derivative += mu * (2 * e * rate[0] - (r * e * e - decay * sigma))
        z = np.append(eps, q)
        form = z @ adaptation.form(K, P, mu, tau) @ z
        assert form == pytest.approx(derivative + 2 * tau * q * sat, abs=1e-9)
        assert q * sat >= 0
    else:
        assert derivative == pytest.approx(-eps @ eps, abs=1e-9)


@pytest.mark.parametrize(("shape", "r"), [("dead zone", 0.1), ("saturation", 10.0)])
def test_the_form_that_is_proved_is_the_float_one(shape: Any, r: float) -> None:
    """In rationals and in floats the same matrix; and its largest eigenvalue is negative."""
    adaptation, K = Adaptation(shape, Fraction(1), Fraction(r)), np.array([3.0, 3.0, 1.0])
    exactly = np.array([Fraction(k) for k in K])
    P = solve_continuous_lyapunov(companion(K).T, -np.eye(3))
    rational = np.array([[Fraction(value) for value in row] for row in P])
    exact = adaptation.form(exactly, rational, Fraction(1, 2), Fraction(8)).astype(float)
    assert exact == pytest.approx(adaptation.form(K, P, 0.5, 8.0), rel=1e-12)
    check = decays("x.core", adaptation, K)
    assert check.verdict is Verdict.PROVED
    mu, tau = (float(word.rstrip(",")) for word in check.reason.split("mu = ")[1].replace("tau = ", "").split()[:2])
    assert np.linalg.eigvalsh(adaptation.form(K, P, mu, tau))[-1] < 0
