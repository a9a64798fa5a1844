"""What papers give by formula: their numbers, simulations that stay within the bounds, and what is refused."""

from fractions import Fraction
from itertools import cycle
from typing import Any

import numpy as np
import pytest
from oracle.adaptive_lmi import SIGMA, K, P

from hgogen import design
from hgogen.estimators.gains import BadPoles
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz

TORQUE = (((0, 0), (0, 0), (0, 1)), (1, 0))
PRINTED: dict[str, Any] = {"K": K, "P": P, "sigma": SIGMA, "slope": 0.71}
STABLE = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3, -1 + 0.2j, -1 - 0.2j, -0.1, -0.4)
UNSTABLE = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3, -1 + 0.6j, -1 - 0.6j, -0.1, -0.4)
A = np.array([[-2.0, 1.0], [-1.0, 0.0]])  # of (2, 1)


# --- Astolfi, Jungers, Zaccarian 2018 -----------------------------------------------------------------------


def test_the_gain_of_the_example() -> None:
    """Section V: poles -1 +- i, -2 +- i; alpha = 3, beta = 1."""
    L = design.gain_of_poles((-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j))
    assert pytest.approx((6, 15, 18, 10)) == L
    real = sorted({round(s.real, 6) for s in design.core_eigenvalues(L, 3, 1)})
    assert real == [-2.693897, -2.300243, -0.699757, -0.306103]
    poles = [complex(round(s.real, 9), round(s.imag, 9)) for s in design.core_eigenvalues(L)]
    assert poles == [-2 - 1j, -2 + 1j, -1 - 1j, -1 + 1j]


def test_the_numerical_examples() -> None:
    """Inside the parabola 16 eigenvalues decay, eight on the line -alpha/2; outside exactly 2 do not."""
    inside = np.array(design.core_eigenvalues(design.gain_of_poles(STABLE), 0.1, 0.1))
    assert inside.real.max() == pytest.approx(-0.0181398, abs=1e-6)
    assert inside.real.min() == pytest.approx(-0.0818602, abs=1e-6)
    assert sum(abs(inside.real + 0.05) < 1e-5) == 8
    outside = np.array(design.core_eigenvalues(design.gain_of_poles(UNSTABLE), 0.1, 0.1))
    (one, other) = outside[outside.real >= 0]
    assert one == pytest.approx(0.0421480641 - 0.3255630j, abs=1e-5)
    assert other == pytest.approx(one.conjugate())


def test_poles_inside_the_parabola() -> None:
    assert design.inside_parabola(STABLE, 0.1, 0.1) == (True,) * 8
    assert [p for p, in_ in zip(UNSTABLE, design.inside_parabola(UNSTABLE, 0.1, 0.1), strict=True) if not in_] == [
        -1 + 0.6j,
        -1 - 0.6j,
    ]
    assert design.inside_parabola((-1 + 2j, -1 + 1.999j, 1, 0), 2, 1) == (False, True, False, False)


# --- Alessandri 2020 ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("slope", "gamma", "mu"), [(0.71, 20.519, 31364), (0.5**0.5, 20.448, 31038)])
def test_the_printed_design(slope: float, gamma: float, mu: float) -> None:
    """lambda = .1666, alpha_1 = 3.2950, alpha_2 = 3.4810 of (87); the paper says 20.5219 for 20.519."""
    printed = {**PRINTED, "slope": slope}
    assert float(design.least_gamma(**printed, decay=0.1666)) == pytest.approx(gamma, abs=5e-4)
    assert float(design.least_gamma(**printed)) < gamma
    share = design.attenuation(**printed, alphas=(3.2950, 3.4810), disturbance=TORQUE, decay=0.1666)
    assert float(share) == pytest.approx(mu, abs=0.5)


def test_a_disturbance_keeps_the_error_small() -> None:
    """(69) with 2 lambda_max(P) and sqrt(cond P), from its definition in floats."""
    peaks = np.linalg.eigvalsh(P)
    net = 80 * 0.1666 - 2 * 0.71 * peaks[-1]
    level = 2 * peaks[-1] * (1 + np.linalg.norm(K)) / (0.75 * net)
    said = design.disturbed_error(**PRINTED, gamma=80, disturbance=TORQUE, share=0.25, decay=0.1666)
    assert float(said.level) == pytest.approx(level, rel=1e-6)
    assert float(said.ultimate) == pytest.approx(level * np.sqrt(peaks[-1] / peaks[0]), rel=1e-6)
    assert float(said.rate) == pytest.approx(0.25 * net / (2 * peaks[-1]), rel=1e-6)


@pytest.mark.full
def test_the_error_stays_below_the_level() -> None:
    """Constant gamma, b = 0, a disturbance of the worst sign for a direction of e, from 0 and from far."""
    said = design.disturbed_error(**{**PRINTED, "slope": 0.0}, gamma=30, disturbance=TORQUE)
    N = np.diag(np.ones(2), 1) - np.outer(K, np.eye(3)[0])
    B = np.array(TORQUE[0]) / 30.0 ** np.arange(1, 4)[:, None] - np.outer(K, TORQUE[1])
    for start in (np.zeros(3), np.full(3, 1e3)):
        e, worst = start.astype(float), 0.0
        for k in range(40000):
            v = np.sign(B.T @ P @ e) if k % 7 else np.ones(2)
            e = e + 1e-4 * (30 * N @ e + B @ (v / np.sqrt(2)))
            worst = max(worst, float(np.linalg.norm(e))) if k > 35000 else 0.0
        assert 0 < worst < float(said.ultimate)


@pytest.mark.parametrize(
    ("call", "asked", "said"),
    [
        ("least_gamma", {"sigma": 5.0}, r"K and P do not satisfy \(A - K C\)'P \+ P \(A - K C\) \+ 5"),
        ("least_gamma", {"P": -np.eye(3)}, r"K and P do not satisfy P > 0"),
        ("least_gamma", {"decay": 0.33}, r"decay = 0\.33 is no lambda of \(54\), of which the largest is 0\.324"),
        ("least_gamma", {"decay": 0}, r"decay = 0 must be a positive finite number"),
        ("least_gamma", {"slope": -1}, r"slope = -1 must be a finite number, at least 0"),
        ("least_gamma", {"K": (1, 2)}, r"P of shape \(3, 3\) must be a 2 x 2 matrix"),
        ("attenuation", {"alphas": (1, 3)}, r"alphas = \(1, 3\) do not satisfy \(87\) with lambda = 0\.1666; raise"),
        ("attenuation", {"alphas": (1, 2, 3)}, r"alphas = \(1, 2, 3\) must be two numbers"),
        ("attenuation", {"disturbance": ((1,), (1,))}, r"G_1 of shape \(1,\) and G_2 of shape \(1,\) must be \(3, m\)"),
        ("disturbed_error", {"gamma": 5}, r"gamma = 5 must be above \d+\.\d+ = max\(1, 2 k lambda_max\(P\)/lambda\)"),
        ("disturbed_error", {"share": 1}, r"share = 1 must be between 0 and 1"),
    ],
)
def test_bad_questions_on_a_moving_gain(call: str, asked: dict[str, Any], said: str) -> None:
    more: dict[str, dict[str, Any]] = {
        "least_gamma": {},
        "attenuation": {"alphas": (3.295, 3.481), "disturbance": TORQUE, "decay": 0.1666},
        "disturbed_error": {"gamma": 80, "disturbance": TORQUE},
    }
    with pytest.raises(BadGain, match=f"^{said}"):
        getattr(design, call)(**{**PRINTED, **more[call], **asked})


# --- Bullinger, Ilchmann, Allgoewer 1998 --------------------------------------------------------------------


def test_the_corrected_bound_of_the_bioreactor() -> None:
    """p = (1, .2): (14) times sqrt(cond P) = 3.18."""
    P_ = np.linalg.solve(
        np.kron(np.array([[-1, -0.2], [1, 0]]), np.eye(2)) + np.kron(np.eye(2), np.array([[-1, -0.2], [1, 0]])),
        -np.eye(2).ravel(),
    ).reshape(2, 2)
    low, high = np.linalg.eigvalsh(P_)
    assert np.sqrt(high / low) == pytest.approx(3.18, abs=5e-3)
    bounds = design.error_bounds((1, 0.2), 0.55, 0.01)
    printed = [2 * 0.01 * high / 0.55**2, 2 * 0.01 * high / 0.55]
    assert [float(x) for x in bounds] == pytest.approx([np.sqrt(high / low) * x for x in printed], rel=1e-3)
    assert all(isinstance(x, Fraction) for x in bounds)


def error_after(k: float, time: float, phi: float, start: float) -> float:
    """The largest |e| from `time` on, over starts, of e' = A_k e + (0, phi) by the midpoint rule, phi of the sign that
    hurts P. A step is e -> M e + v, and the same 800 times, before phi changes its sign."""
    core, h = np.diag((1, k)) @ A @ np.diag((1, 1 / k)) * k, 1e-3 / k
    M, v = np.eye(2) + h * core + h**2 / 2 * core @ core, h * (np.eye(2) + h / 2 * core) @ (0, phi)
    moves, pushes = [M], [v]
    for _ in range(799):
        moves.append(M @ moves[-1])
        pushes.append(M @ pushes[-1] + v)
    steps, angles = int(1.3 * time / h), np.linspace(0, np.pi, 7)
    e, worst = start * np.array([np.cos(angles), np.sin(angles)]), 0.0
    for sign, done in zip(cycle((-1, 1)), range(0, steps, 800)):
        along = np.array(moves) @ e + sign * np.array(pushes)[:, :, None]
        late = h * np.arange(done + 1, min(done + 800, steps) + 1) > time
        worst = max(worst, float(np.linalg.norm(along[: len(late)][late], axis=1).max(initial=0.0)))
        e = along[-1]
    return worst


@pytest.mark.parametrize(("error", "time", "phi", "start"), [(0.5, 1, 0.5, 1), (0.2, 2, 0, 3), (5, 0.5, 20, 1)])
def test_the_error_is_met_in_time(error: float, time: float, phi: float, start: float) -> None:
    k = design.gain_in_time((2, 1), error=error, time=time, phi=phi, start=start)
    for larger in (k, 1.5 * k):
        assert error_after(larger, time, phi, start) <= error


def test_every_larger_gain_will_do_as_well() -> None:
    """At k = 1 a small first error stays small; at k = 60 it peaks, and is not yet gone."""
    asked: dict[str, Any] = {"error": 1, "time": 0.01, "phi": 0, "start": 0.2}
    assert error_after(1, 0.01, 0, 0.2) < 1 < error_after(60, 0.01, 0, 0.2)
    k = design.gain_in_time((2, 1), **asked)
    assert k > 60
    assert all(error_after(factor * k, 0.01, 0, 0.2) < 1 for factor in (1, 2))


def test_what_is_asked_moves_the_gain() -> None:
    asked: dict[str, Any] = {"error": 1, "time": 1, "phi": 1, "start": 1}
    k = design.gain_in_time((2, 1), **asked)
    for name, value in (("error", 0.1), ("time", 0.01), ("phi", 100), ("start", 1e6)):
        assert design.gain_in_time((2, 1), **{**asked, name: value}) > k
    assert design.gain_in_time((1,), error=2, time=1, phi=0, start=1) == 1.0


@pytest.mark.parametrize(
    ("gains", "asked", "error", "said"),
    [
        ((1, -1), {}, NotHurwitz, r"gains: the linear error core has the eigenvalues"),
        ((), {}, BadGain, r"gains = \(\) must be finite numbers"),
        ((2, 1), {"error": 0}, BadGain, r"error = 0 must be a positive finite number"),
        ((2, 1), {"phi": -1}, BadGain, r"phi = -1 must be a finite number, at least 0"),
        ((2, 1), {"time": 1e-308, "start": 1e9}, BadGain, r"the gain is beyond a double; ask for a larger error"),
    ],
)
def test_bad_questions_on_time(gains: Any, asked: dict[str, Any], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=f"^{said}"):
        design.gain_in_time(gains, **{"error": 1, "time": 1, "phi": 1, "start": 1, **asked})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: design.core_eigenvalues((1, 1), alpha=1), r"core_eigenvalues takes both alpha and beta"),
        (lambda: design.core_eigenvalues(((1,),)), r"L = \(\(1,\),\) must be finite numbers"),
        (lambda: design.core_eigenvalues((1, 1), 0, 1), r"alpha = 0 must be a positive finite number"),
        (lambda: design.inside_parabola((-1, float("nan")), 1, 1), r"poles = .* must be finite numbers"),
        (lambda: design.inside_parabola("ab", 1, 1), r"poles = 'ab' must be finite numbers"),
        (lambda: design.error_bounds((2, 1), 0, 1), r"k = 0 must be a positive finite number"),
    ],
)
def test_bad_questions(call: Any, said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        call()


@pytest.mark.parametrize("poles", [(1, -1), (-1 + 1j,), (), 3, "ab"])
def test_poles_that_are_none(poles: Any) -> None:
    with pytest.raises(BadPoles):
        design.gain_of_poles(poles)


def test_every_public_name_has_its_docstring() -> None:
    for name in design.__all__:
        assert getattr(design, name).__doc__, name
