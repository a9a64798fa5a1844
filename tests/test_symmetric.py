"""What counts as symmetric: what solvers leave is taken, in every place that takes a matrix; more is refused."""

from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import solve_continuous_lyapunov

import hgogen as hg
from hgogen.estimators.riccati_part import spd
from hgogen.prove.dissipation import BadErrorSystem
from hgogen.prove.varying_gain import candidate
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import symmetric


def fractions(M: np.ndarray) -> list[list[Fraction]]:
    return [list(map(Fraction, row)) for row in M.tolist()]


def test_a_lyapunov_solution_is_symmetric() -> None:
    """Many of a solver's are not to the last bit; what is taken is exactly half the sum."""
    draw, uneven = np.random.default_rng(1), 0
    for _ in range(60):
        A = draw.normal(size=(3, 3)) - 4 * np.eye(3)
        P = solve_continuous_lyapunov(A.T, -np.eye(3))
        uneven += bool((P != P.T).any())
        even = symmetric(fractions(P))
        assert even is not None
        assert all(even[i][j] == (Fraction(P[i, j]) + Fraction(P[j, i])) / 2 for i in range(3) for j in range(3))
        assert even == candidate((3.0, 3.0, 1.0), P, 0.1).P
        assert (spd("Q", P, 3) == spd("Q", P, 3).T).all()
    assert uneven > 10


def test_the_edge_moves_with_the_units() -> None:
    for scale in (1e-8, 1.0, 1e8):
        units = np.diag([1.0, scale])
        for share, taken in ((0.9e-12, True), (1.1e-12, False)):
            M = units @ np.array([[4.0, share * 2], [0.0, 1.0]]) @ units  # sqrt(4 * 1) = 2
            assert (symmetric(fractions(M)) is not None) == taken


def test_every_door_has_the_same_edge() -> None:
    e, f = sp.symbols("e f", real=True)
    system = hg.ErrorSystem("two", (e, f), (-e, -f), [[1], [1]], {})
    within_tolerance, far = (np.array([[2.0, 1.0], [1.0 + share, 2.0]]) for share in (1e-13, 1e-11))
    sentence = r"must be symmetric, to 1e-12 of its numbers; give \((.) \+ \1'\)/2"
    dissipation = hg.dissipation(system, within_tolerance, mu=9, within=[1, 1])
    assert dissipation.V.coeff(e * f) == sp.Rational("2.0000000000001")
    with pytest.raises(BadErrorSystem, match=f"V {sentence}"):
        hg.dissipation(system, far, mu=9, within=[1, 1])
    candidate((2.0, 1.0), within_tolerance, 0.1)
    with pytest.raises(BadGain, match=f"P {sentence}"):
        candidate((2.0, 1.0), far, 0.1)
    assert spd("Q", within_tolerance, 2)[0, 1] == spd("Q", within_tolerance, 2)[1, 0]
    with pytest.raises(BadGain, match=f"Q {sentence}"):
        spd("Q", far, 2)
