"""Lyapunov inequalities: closed forms, scipy, tampering, vertices."""

import sys
from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from hgogen.prove.quadratic import Quadratic
from hgogen.prove.semidefinite import NoSolver, feasible_weights, gains, largest_margin, lyapunov, verified
from hgogen.rigor.definite import Matrix

try:
    import clarabel
except ImportError:
    clarabel = None
needs_solver = pytest.mark.skipif(clarabel is None, reason="clarabel is not installed")


def rational(M: np.ndarray) -> Matrix:
    return tuple(tuple(Fraction(float(x)) for x in row) for row in M)


def floats(M: Matrix) -> np.ndarray:
    return np.array([[float(x) for x in row] for row in M])


def companion(p: np.ndarray) -> np.ndarray:
    M = np.diag(np.ones(len(p) - 1), 1)
    M[:, 0] -= p
    return M


def test_one_state_by_hand() -> None:
    """-2 p P = -1."""
    for p in (0.5, 1.0, 7.0):
        certificate = lyapunov(rational(np.array([[-p]])))
        assert float(certificate.P[0][0]) == pytest.approx(1 / (2 * p), rel=1e-6)
        assert Fraction(1) / Fraction(2 * p) < certificate.P[0][0] < certificate.peak


@pytest.mark.parametrize("p", [(2.0, 1.0), (1.0, 3.0), (10.0, 0.25)])
def test_two_states_by_hand(p: tuple[float, float]) -> None:
    """P12 = -1/2, P11 = (1 + p2)/(2 p1), P22 = (P11 + p1/2)/p2."""
    first = (1 + p[1]) / (2 * p[0])
    second = (first + p[0] / 2) / p[1]
    peak = (first + second) / 2 + np.hypot((first - second) / 2, 0.5)
    certificate = lyapunov(rational(companion(np.array(p))))
    assert floats(certificate.P) == pytest.approx(np.array([[first, -0.5], [-0.5, second]]), rel=1e-6)
    assert peak < certificate.peak < peak * (1 + 1e-6)


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("spread", [0.0, 0.4])
def test_up_to_eight_states_against_scipy(n: int, spread: float) -> None:
    N = companion(np.poly([-1 - spread * i for i in range(n)])[1:])
    certificate = lyapunov(rational(N))
    P = solve_continuous_lyapunov(N.T, -np.eye(n))
    assert floats(certificate.P) == pytest.approx(P, rel=1e-5, abs=1e-6 * np.abs(P).max())
    assert np.linalg.eigvalsh(floats(certificate.P)).max() < certificate.peak < np.linalg.eigvalsh(P).max() * (1 + 1e-5)
    assert verified(certificate)


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 4).flatmap(lambda n: st.lists(st.integers(-20, 20), min_size=n * n, max_size=n * n)))
def test_there_is_a_solution_where_the_matrix_is_stable_only(entries: list[int]) -> None:
    n = int(len(entries) ** 0.5)
    N = np.array(entries, dtype=float).reshape(n, n) / 4
    slowest = np.linalg.eigvals(N).real.max()
    if abs(slowest) > 1e-3:
        assert (lyapunov(rational(N)) is not None) == (slowest < 0)


def test_a_changed_number_is_noticed() -> None:
    certificate = lyapunov(rational(companion(np.array([2.0, 1.0]))))
    assert verified(certificate)
    P = [list(row) for row in certificate.P]
    for i, j, factor in ((0, 0, 0.999), (1, 1, 1.001), (0, 1, 1.001), (1, 1, -1)):
        changed = [list(row) for row in P]
        changed[i][j] *= Fraction(factor)
        assert not verified(replace(certificate, P=tuple(map(tuple, changed))))
        changed[j][i] = changed[i][j]
        assert not verified(replace(certificate, P=tuple(map(tuple, changed)))), (i, j)
    assert not verified(replace(certificate, peak=certificate.peak * Fraction(0.999)))
    assert not verified(replace(certificate, N=rational(companion(np.array([2.0, -1.0])))))


def corners(n: int, low: Fraction, high: Fraction) -> list[tuple[Matrix, tuple[Fraction, ...]]]:
    zero, C = Fraction(0), (Fraction(1), *(Fraction(0),) * (n - 1))
    return [
        (tuple(tuple(a[i] if j == i + 1 else zero for j in range(n)) for i in range(n)), C)
        for a in product((low, high), repeat=n - 1)
    ]


def closed(A: Matrix, C: tuple[Fraction, ...], K: tuple[Fraction, ...]) -> Matrix:
    n = range(len(K))
    return tuple(tuple(A[i][j] - K[i] * C[j] for j in n) for i in n)


@needs_solver
@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_a_gain_and_one_lyapunov_function_for_a_range(n: int) -> None:
    low, high = Fraction(1), Fraction(3, 2)
    K = gains(corners(n, low, high), 50.0)
    assert K is not None
    assert np.linalg.norm([float(k) for k in K]) <= 50 * (1 + 1e-3)
    one = np.eye(n)
    ends = [Quadratic(((one, floats(closed(A, C, K))),), one[:0], one[:0]) for A, C in corners(n, low, high)]
    weights = feasible_weights(ends, "a test")
    assert weights is not None
    rng, P = np.random.default_rng(n), weights[0]
    for a in rng.uniform(1, 1.5, size=(200, n - 1)):
        N = np.diag(a, 1) - np.outer([float(k) for k in K], one[0])
        assert np.linalg.eigvalsh(N.T @ P + P @ N).max() < 0


@needs_solver
def test_no_lyapunov_function_where_a_vertex_is_unstable() -> None:
    """The margin says by how much there is none, and the prices, which vertex is to blame."""
    one = np.eye(2)
    ends = [Quadratic(((one, companion(np.array(p))),), one[:0], one[:0]) for p in ((2.0, 1.0), (2.0, -1.0))]
    assert feasible_weights(ends, "a test") is None
    best = largest_margin(ends, "a test", priced=True)
    assert best is not None
    assert best.margin < 0
    stable, not_stable = (float(np.trace(price)) for price in best.prices)
    assert stable + not_stable == pytest.approx(1, rel=1e-3)
    assert not_stable > stable


def test_what_needs_a_solver_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    one = np.eye(2)
    with pytest.raises(NoSolver, match=r"^a test needs clarabel; install it"):
        feasible_weights([Quadratic(((one, -one),), one[:0], one[:0])], "a test")
    with pytest.raises(NoSolver):
        gains(corners(2, Fraction(1), Fraction(2)), 10.0)
