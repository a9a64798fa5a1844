"""Lyapunov functions of a gain that moves: the paper's numbers, exact signs, and the inequality behind the theorems."""

from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle.adaptive_lmi import SIGMA, K, P

import hgogen as hg
from hgogen.check import Check, Verdict
from hgogen.prove.varying_gain import Assumptions, Candidate, candidate, disturbance, gain
from hgogen.prove.varying_gain import adaptive_checks as checks
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import exact, largest, nonnegative, positive, rationals, root, smallest

LAMBDA, ALPHAS, SLOPE = 0.1666, (3.2950, 3.4810), Fraction("0.71")
TORQUE = (((0, 0), (0, 0), (0, 1)), (1, 0))  # G_1, G_2 of (92)
D = np.diag([1.0, 2.0, 3.0])


def paper() -> Candidate:
    return candidate(K, P, SIGMA)


def core(K: np.ndarray) -> np.ndarray:
    return np.diag(np.ones(len(K) - 1), 1) - np.outer(K, np.eye(len(K))[0])


def lyapunov() -> np.ndarray:
    """P of (A - K C + sigma D)'P + P (A - K C + sigma D) = -I."""
    M, one = core(K) + SIGMA * D, np.eye(3)
    P = np.linalg.solve(np.kron(M.T, one) + np.kron(one, M.T), -one.ravel()).reshape(3, 3)
    return (P + P.T) / 2


def by_id(claims: tuple[Check, ...]) -> dict[str, Check]:
    return {check.id.fact: check for check in claims}


# --- signs --------------------------------------------------------------------------------------------------

entries = st.integers(-9, 9)
square = st.integers(1, 5).flatmap(
    lambda n: st.lists(st.lists(entries, min_size=n, max_size=n), min_size=n, max_size=n)
)


@given(square)
@settings(deadline=None, max_examples=60)
def test_signs_are_those_of_the_eigenvalues(rows: list[list[int]]) -> None:
    """B B' has a rank that numpy finds, of integers this small; B + B' any signs."""
    B = np.array(rows, dtype=float)
    gram, sum_ = exact(rationals(B @ B.T)), exact(rationals(B + B.T))
    assert nonnegative(gram)
    assert positive(gram) == (np.linalg.matrix_rank(B) == len(B))
    values = np.linalg.eigvalsh(B + B.T)
    if np.abs(values).min() > 1e-9:
        assert positive(sum_) == (values.min() > 0) == nonnegative(sum_)


@pytest.mark.parametrize("first", range(2, 9))
def test_a_sign_that_floats_do_not_see_is_proved(first: int) -> None:
    """v v' + w w' of three numbers is singular; of four of seven such matrices floats make a Cholesky factor."""
    v, w = ([Fraction(1, first + k + j * k) for k in range(3)] for j in (0, 1))
    singular = [[v[i] * v[j] + w[i] * w[j] for j in range(3)] for i in range(3)]
    for little in (Fraction(1, 2**200), Fraction(0), Fraction(-1, 2**200)):
        M = [[x + little * (i == j) for j, x in enumerate(row)] for i, row in enumerate(singular)]
        assert positive(exact(M)) == (little > 0)


@given(square)
@settings(deadline=None, max_examples=60)
def test_an_eigenvalue_lies_in_its_enclosure(rows: list[list[int]]) -> None:
    M = np.array(rows, dtype=float) + np.array(rows, dtype=float).T
    values, scale = np.linalg.eigvalsh(M), np.abs(M).max() + 1
    for (low, high), value in ((smallest(exact(rationals(M))), values[0]), (largest(exact(rationals(M))), values[-1])):
        assert low < high < low + scale * 1e-8
        assert value == pytest.approx(float(low), abs=scale * 1e-8)


def test_a_whole_eigenvalue_is_found_whole() -> None:
    assert largest(exact(rationals(np.diag([2.0, 1.0]))))[1] == 2


def test_an_eigenvalue_that_no_float_resolves_keeps_its_sign() -> None:
    """[[1, 1], [1, 1 + t]] has the smallest eigenvalue t/2 + ..: its float is 0 or below."""
    t = Fraction(1, 2**90)
    low, high = smallest(exact(((Fraction(1), Fraction(1)), (Fraction(1), 1 + t))))
    assert 0 < low < t < high
    low, high = smallest(exact(((Fraction(1), Fraction(1)), (Fraction(1), 1 - t))))
    assert low < -t / 4 < high
    assert largest(exact(((-Fraction(1), Fraction(1)), (Fraction(1), -1 - t))))[1] < 0


# --- the printed K and P ------------------------------------------------------------------------------------


def test_the_numbers_of_the_printed_design() -> None:
    design, torque = paper(), disturbance(TORQUE, 3)
    assert float(design.peak) == pytest.approx(2.0552748, abs=5e-8)
    assert float(smallest(design.shrink)[0]) == pytest.approx(0.0570, abs=5e-5)
    assert torque.deltas == (2, 1)
    for slope, gamma, mu in ((SLOPE, 20.519, 31364), (Fraction(0.5**0.5), 20.448, 31038)):
        bound = design.least(slope, Fraction(LAMBDA))
        assert float(bound) == pytest.approx(gamma, abs=5e-4)
        worst = max(delta * Fraction(alpha) for delta, alpha in zip(torque.deltas, ALPHAS, strict=True))
        assert float(root(2 * worst) * bound**3) == pytest.approx(mu, abs=0.5)


def test_the_printed_design_is_proved() -> None:
    claims = by_id(hg.design.verified(K, P, SIGMA, LAMBDA, ALPHAS))
    assert set(claims) == {"definite", "shrink", "decay", "attenuation"}
    assert {check.verdict for check in claims.values()} == {Verdict.PROVED}
    assert "the largest eigenvalue is at most -0.1576" in str(claims["decay"].reason)
    assert "the largest eigenvalue is at most -0.09314" in str(claims["attenuation"].reason)
    assert by_id(hg.design.verified(K, P, SIGMA, alphas=ALPHAS))["attenuation"].verdict is Verdict.PROVED
    lines = str(hg.design.verified(K, P, SIGMA)).split("\n")
    assert len(lines) == len(hg.design.verified(K, P, SIGMA))
    assert all(line.startswith("proved   adaptive_gain.") for line in lines)


def test_what_fails_is_refuted_with_its_eigenvalue() -> None:
    """-0.1576 + 0.2 > 0 at lambda = 0.3666; the solution of the Lyapunov equation does not let gamma rise."""
    decay = by_id(hg.design.verified(K, P, SIGMA, LAMBDA + 0.2))["decay"]
    assert decay.verdict is Verdict.REFUTED
    assert decay.witness["eigenvalue"] == pytest.approx(0.0424, abs=1e-4)
    tight = by_id(hg.design.verified(K, P, SIGMA, LAMBDA, (1.0, 1.0)))["attenuation"]
    assert tight.verdict is Verdict.REFUTED
    assert tight.witness["eigenvalue"] > 0
    other = by_id(hg.design.verified(K, lyapunov(), SIGMA))
    assert [other[name].verdict for name in ("definite", "decay", "shrink")] == [
        Verdict.PROVED,
        Verdict.PROVED,
        Verdict.REFUTED,
    ]
    assert other["shrink"].witness["eigenvalue"] == pytest.approx(-0.0635, abs=1e-4)
    assert by_id(hg.design.verified(K, -P, SIGMA))["definite"].verdict is Verdict.REFUTED


def test_an_eigenvalue_of_0_is_enough_for_gamma_to_rise_and_not_for_decay() -> None:
    """P = [[1, x], [x, 1]]: D P + P D = [[2, 3x], [3x, 4]] is singular at x^2 = 8/9, as with P = [[9, 8], [8, 8]]."""
    claims = by_id(hg.design.verified((3.0, 1.0), ((9, 8), (8, 8)), 0))
    assert np.linalg.det(np.array([[18, 24], [24, 32]])) == pytest.approx(0)
    assert claims["shrink"].verdict is Verdict.PROVED
    assert by_id(hg.design.verified((3.0, 1.0), ((9, 8.0001), (8.0001, 8)), 0))["shrink"].verdict is Verdict.REFUTED


# --- what follows from them ---------------------------------------------------------------------------------


def adapted(low: float = 20.53, high: float = 80, slope: Fraction | None = SLOPE, **more: Any) -> Assumptions:
    return Assumptions(Fraction(low), Fraction(high), slope, disturbance=disturbance(TORQUE, 3), **more)


def test_the_checks_of_an_observer() -> None:
    """The largest lambda of (54) is 0.1666 + 0.1576: gamma_inf above (4 0.71 2.05527 + 1)/(2 0.32424) = 10.543."""
    claims = by_id(checks("it", paper(), adapted()))
    assert {check.verdict for check in claims.values()} == {Verdict.PROVED}
    assert claims["attenuation"].claim.startswith("in continuous time, the L2 gain from v in w' + G_1 v, y + G_2 v to ")
    assert str(claims["attenuation"].reason).endswith(f"; {disturbance(TORQUE, 3)}")
    low = by_id(checks("it", paper(), adapted(low=10.5)))["attenuation"]
    assert low.verdict is Verdict.UNKNOWN
    assert "(70) asks for gamma_inf above 10.55 at least" in str(low.reason)
    assert by_id(checks("it", paper(), adapted(low=10.56)))["attenuation"].verdict is Verdict.PROVED
    blind = by_id(checks("it", paper(), adapted(slope=None, reason="b may jump")))["attenuation"]
    assert blind.verdict is Verdict.UNKNOWN
    assert str(blind.reason) == "b may jump"
    wrong = by_id(checks("it", candidate(K, lyapunov(), SIGMA), adapted()))
    assert [wrong[name].verdict for name in ("decay", "shrink")] == [Verdict.PROVED, Verdict.REFUTED]
    assert wrong["attenuation"].verdict is Verdict.UNKNOWN


def test_the_gain_is_no_larger_than_the_papers() -> None:
    """At gamma_inf = gamma_sup = 20.519 (89) gives 31364 with the paper's alphas; the best for K and P is below."""
    mu = gain(paper(), adapted(20.53, 20.53))
    assert mu is not None
    assert mu < 31364
    doubled = gain(paper(), adapted(20.53, 41.06))
    assert doubled == pytest.approx(8 * mu, rel=1e-12)


@cache
def skewed() -> tuple[Candidate, Assumptions, float]:
    """A disturbance whose G_1 G_1' is not diagonal, for which (79) fails."""
    G = (np.array([[1.0, 0, 0], [2.0, 1.0, 0], [-1.0, 1.0, 0]]), np.array([0.5, 0, 1.0]))
    adaptation = Assumptions(Fraction(25), Fraction(30), SLOPE, disturbance=disturbance(G, 3))
    mu = gain(paper(), adaptation)
    assert mu is not None
    return paper(), adaptation, float(mu)


def test_79_fails_where_the_bound_by_the_norm_holds() -> None:
    """T^-1 M T^-1 <= gamma M: false already at gamma = 1 + for M of rank 1 that is not diagonal."""
    M, T = np.ones((2, 2)), np.diag([1 / 1.1, 1 / 1.1**2])
    assert np.linalg.eigvalsh(1.1 * M - T @ M @ T).min() < -1e-4
    assert np.linalg.eigvalsh(1.1 * 2 * np.eye(2) - T @ M @ T).min() > 0


@given(
    st.floats(0, 1),
    st.floats(-1, 20),
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
)
@settings(deadline=None, max_examples=200)
def test_the_dissipation_inequality_holds(share: float, speed: float, slopes: list[float]) -> None:
    """(84) at every e, v, with gamma in its range, gamma' >= -sigma gamma^2 and any slope of norm k: what is left of
    V' + |w - what|^2/2 - mu^2 |v|^2/2 after the worst v is a quadratic form, not above 0."""
    design, adaptation, mu = skewed()
    assert adaptation.disturbance is not None
    low, high = float(adaptation.low), float(adaptation.high)
    gamma = low + share * (high - low)
    J = np.zeros((3, 3))
    J[np.tril_indices(3)] = slopes
    J *= float(SLOPE) / max(np.linalg.norm(J, 2), 1e-9)
    T = np.diag([gamma, gamma**2, gamma**3])
    G = np.array([[float(x) for x in row] for row in adaptation.disturbance.plant])
    g = np.array([[float(x) for x in adaptation.disturbance.measurement]])
    moved = gamma * core(K) - speed * SIGMA * gamma * D + np.linalg.inv(T) @ J @ T
    B = np.linalg.inv(T) @ G - K[:, None] @ g
    weight = high**6
    form = weight * (moved.T @ P + P @ moved) + T @ T / 2 * 1.0 + 2 * weight**2 / mu**2 * P @ B @ B.T @ P
    assert np.linalg.eigvalsh(form).max() <= 0
    assert design.sigma == Fraction(SIGMA)


@given(st.lists(st.floats(-9, 9), min_size=10, max_size=10), st.floats(1, 50), st.floats(1, 10))
@settings(deadline=None, max_examples=100)
def test_the_slope_at_gamma_inf_serves_every_larger_gamma(slopes: list[float], low: float, more: float) -> None:
    J = np.zeros((4, 4))
    J[np.tril_indices(4)] = slopes

    def k(gamma: float) -> float:
        T = gamma ** np.arange(1.0, 5)
        return float(np.linalg.norm(J * T / T[:, None], 2))

    assert k(more * low) <= k(low) * (1 + 1e-12)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"K": (1, 2)}, r"P of shape \(3, 3\) must be a 2 x 2 matrix"),
        ({"K": ((1, 2, 3),)}, r"K of shape \(1, 3\) must have 3 numbers"),
        ({"K": (1, 2, float("nan"))}, "K must be finite"),
        ({"P": P + np.eye(3, k=1)}, r"P must be symmetric, to 1e-12 of its numbers; give \(P \+ P'\)/2"),
        ({"P": "one"}, "P = 'one' must be a number or an array of numbers"),
        ({"sigma": -0.1}, r"sigma = -0\.1 must be a number, at least 0"),
        ({"sigma": (1, 2)}, r"sigma = \(1, 2\) must be a number"),
        ({"alphas": (1.0, 0.0)}, r"alphas = \(1\.0, 0\.0\) must be positive"),
    ],
)
def test_bad_candidates(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        hg.design.verified(**{"K": K, "P": P, "sigma": SIGMA, **changes})


@pytest.mark.parametrize("matrices", [np.eye(3), (np.eye(2), (1, 1)), (np.eye(3), (1, 1)), (np.eye(3), (1, 1, np.inf))])
def test_bad_disturbances(matrices: Any) -> None:
    with pytest.raises(BadGain, match=r"^disturbance must be a pair|^G_1 of shape|^G_1 and G_2 must be finite"):
        disturbance(matrices, 3)
