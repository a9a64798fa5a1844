"""Poles inside the parabola of a filtered output injection: Astolfi, Jungers, Zaccarian, ECC 2018, section III."""

from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq, fmpq_mat, fmpq_poly
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle import filtered as oracle

from hgogen.estimators.gains import (
    OutsideParabola,
    coefficients,
    demand_parabola,
    filtered_core,
    filtered_spectrum,
    least_ratio,
    parabola_advice,
)
from hgogen.rigor.definite import hurwitz

REST = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3, -0.1, -0.4)
FIRST, SECOND = (*REST, -1 + 0.2j, -1 - 0.2j), (*REST, -1 + 0.6j, -1 - 0.6j)  # examples 1 and 2
SECTION_V = (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)


def spectrum(poles: tuple[complex, ...], alpha: float, beta: float) -> np.ndarray:
    """The eigenvalues of M, sorted by their real parts."""
    core = filtered_core(coefficients(poles, len(poles)), alpha, beta)
    assert np.array_equal(core, oracle.matrix(coefficients(poles, len(poles)), alpha, beta))
    values = np.linalg.eigvals(core)
    return values[np.argsort(values.real)]


def test_example_1() -> None:
    """16 decaying eigenvalues, eight of them at -.05."""
    eigenvalues = spectrum(FIRST, 0.1, 0.1).real
    assert [eigenvalues[0], eigenvalues[-1]] == pytest.approx([-0.0818602, -0.0181398], abs=5e-8)
    assert np.count_nonzero(np.abs(eigenvalues + 0.05) < 1e-9) == 8
    demand_parabola(FIRST, 0.1, 0.1)


def test_example_2() -> None:
    """Exactly two eigenvalues grow, those of the poles outside the parabola."""
    eigenvalues = spectrum(SECOND, 0.1, 0.1)
    growing = eigenvalues[eigenvalues.real > 0]
    assert sorted(growing, key=np.imag) == pytest.approx(
        [0.0421480641 - 0.3255630j, 0.0421480641 + 0.3255630j], abs=1e-7
    )
    with pytest.raises(
        OutsideParabola, match=r"^poles -1\+0\.6j, -1-0\.6j: .* = 0\.1 must be above 0\.36 to"
    ) as caught:
        demand_parabola(SECOND, 0.1, 0.1)
    assert caught.value.poles == SECOND[-2:]
    assert abs(caught.value.eigenvalue) == pytest.approx(abs(0.0421480641 + 0.3255630j), abs=1e-7)
    assert caught.value.eigenvalue.real == pytest.approx(0.0421480641, abs=1e-9)
    assert float(caught.value.least) == pytest.approx(0.36, rel=1e-15)


@pytest.mark.parametrize("poles", [FIRST, SECOND])
def test_eigenvalues_are_symmetric_about_half_of_alpha(poles: tuple[complex, ...]) -> None:
    """To 1e-12, by the matrix and by Lemma 1, whose roots are those of the matrix."""
    eigenvalues = spectrum(poles, 0.1, 0.1)
    assert eigenvalues.real + eigenvalues.real[::-1] == pytest.approx(-0.1, abs=1e-12)
    known = filtered_spectrum(poles, 0.1, 0.1)
    assert np.sort(known.real) + np.sort(known.real)[::-1] == pytest.approx(-0.1, abs=1e-15)
    assert max(np.abs(known - value).min() for value in eigenvalues) < 1e-11  # |M| eps over the gaps of 16 eigenvalues


def test_section_v() -> None:
    assert coefficients(SECTION_V, 4) == pytest.approx([6, 15, 18, 10], rel=1e-14)
    expected = np.repeat([-2.693897, -2.300243, -0.699757, -0.306103], 2)
    assert spectrum(SECTION_V, 3, 1).real == pytest.approx(expected, abs=5e-7)
    assert np.sort(filtered_spectrum(SECTION_V, 3, 1).real) == pytest.approx(expected, abs=5e-7)


numbers = st.integers(1, 40).map(lambda k: k / 8)


@given(st.lists(numbers, min_size=1, max_size=5), numbers, numbers)
@settings(deadline=None, max_examples=30)
def test_lemma_1_in_exact_arithmetic(L: list[float], alpha: float, beta: float) -> None:
    """p_M(s) = beta^n p_(A - L C)(s (s + alpha)/beta), with p_(A - L C) = s^n + L_1 s^(n-1) + .. + L_n."""
    core = filtered_core(np.array(L), alpha, beta)
    left = fmpq_mat([[fmpq(*float(v).as_integer_ratio()) for v in row] for row in core]).charpoly()
    a, b, *gains = (fmpq(*v.as_integer_ratio()) for v in (alpha, beta, *L))
    inner, right = fmpq_poly([0, a / b, 1 / b]), fmpq_poly([1])
    for gain in gains:
        right = right * inner + gain
    assert left == right * b ** len(L)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=3), numbers, numbers)
@settings(deadline=None, max_examples=60)
def test_the_parabola_is_where_m_decays(pairs: list[tuple[float, float]], alpha: float, beta: float) -> None:
    """Both ways, off its edge, where rounding of the gains decides."""
    poles = tuple(pole for x, y in pairs for pole in (complex(-x, y), complex(-x, -y)))
    ratio, least = Fraction(alpha) ** 2 / Fraction(beta), max(map(least_ratio, poles))
    assume(abs(float(ratio / least) - 1) > 1e-6)
    stable = hurwitz(filtered_core(coefficients(poles, len(poles)), alpha, beta))
    assert stable == (ratio > least)
    if stable:
        demand_parabola(poles, alpha, beta)
    else:
        with pytest.raises(OutsideParabola) as caught:
            demand_parabola(poles, alpha, beta)
        assert caught.value.least == least


def test_the_edge_is_outside_and_what_lies_just_inside_is_admitted() -> None:
    with pytest.raises(OutsideParabola, match=r"alpha\^2/beta = 9 must be above 9 to"):
        demand_parabola((-1 + 3j, -1 - 3j), 3, 1)
    demand_parabola((-1 + 3j, -1 - 3j), 3, np.nextafter(1, 0))


def test_advice_on_gains() -> None:
    assert parabola_advice(np.array([6.0, 15, 18, 10]), 1, 2).startswith("alpha^2/beta = 0.5 must be above about 1;")
    assert parabola_advice(np.array([1.0, -1]), 1, 1).startswith("A - L C itself has the pole 0.618034+0j;")
