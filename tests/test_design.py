"""K and P from linear matrix inequalities: known answers, an independent look at what was found, what is refused."""

import re
import sys
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracle.adaptive_lmi import SIGMA, K

import hgogen as hg
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.prove.adaptive_design import Design, Infeasible, adaptive_gain, slope
from hgogen.prove.semidefinite import NoSolver
from hgogen.reading.given import BadGain, Misfit
from hgogen.rigor.definite import NotHurwitz

pytest.importorskip("clarabel")
pytest.importorskip("clarabel")

TORQUE = (((0, 0), (0, 0), (0, 1)), (1, 0))


MODELS = Path(__file__).resolve().parents[1] / "models"


@cache
def pendulum() -> hg.Form:
    return hg.forms.triangular(load(MODELS / "pendulum.py").plant)


def proved(design: Design, form: hg.Form, **more: Any) -> bool:
    """Whether the observer proves convergence from the design's gamma on."""
    low = np.nextafter(float(design.gamma), np.inf)
    observer = hg.observers.adaptive_lmi(
        form, gamma=(low, 2 * low), K=design.K, P=design.P, sigma=design.sigma, rise=50, threshold=0.01, **more
    )
    (check,) = (check for check in observer.checks if check.id == "adaptive_lmi.convergence")
    return check.verdict is Verdict.PROVED


def stands(design: Design, slope: float, largest: float = 10.0) -> None:
    """(54), D P + P D >= 0, |Y| and the bound (88), in floats and from their definitions."""
    K, P, n = np.array(design.K), np.array(design.P), len(design.K)
    N, D = np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0]), np.diag(np.arange(1.0, n + 1))
    shrink = D @ P + P @ D
    decay = -np.linalg.eigvalsh(N.T @ P + P @ N + design.sigma * shrink).max()
    assert decay > 0
    assert np.linalg.eigvalsh(shrink).min() >= 0
    rounding = 5e-6 * np.linalg.norm(P, 2) * np.linalg.norm(K)  # K has six digits
    assert np.linalg.norm(P @ K) <= largest * (1 + 1e-6) + rounding
    bound = (4 * slope * np.linalg.eigvalsh(P).max() + 1) / (2 * decay)
    assert float(design.gamma) >= max(1, bound) * (1 - 1e-9)
    assert {check.verdict for check in design.checks} == {Verdict.PROVED}


@pytest.mark.parametrize(("steep", "ratio"), [(0.0, 1.5), (1.0, 64)])
def test_the_gain_that_a_design_says_is_that_of_the_observer(steep: float, ratio: float) -> None:
    """However far gamma_sup is above gamma_inf: on two integrators the L2 gain from the noise of y to the error, where
    gamma stays at gamma_sup, is the largest over the frequencies. It is beyond the mu of gamma_sup = gamma_inf."""
    design = adaptive_gain(2, slope=steep, disturbance=(((0,), (0,)), (1,)))
    said = re.search(r"gamma_inf >= (\S+), mu <= (\S+) gamma_sup\^2$", str(design))
    assert said is not None
    assert design.mu is not None
    top = ratio * float(said[1])
    K = np.array(design.K) * top ** np.array([1, 2])
    N, omega = np.array([[-K[0], 1], [-K[1], 0]]), np.geomspace(1e-2, 1e4, 400)
    true = max(np.linalg.norm(np.linalg.solve(1j * w * np.eye(2) - N, K)) for w in omega)
    assert true <= float(said[2]) * top**2
    assert true > design.mu
    assert Fraction(said[2]) * design.gamma**2 == pytest.approx(design.mu, rel=1e-5)


def test_the_known_design() -> None:
    """The smallest bound (88) with |Y| <= 10, at the exact slope of the pendulum (91)."""
    design = adaptive_gain(3, slope=0.5**0.5)
    assert float(design.gamma) == pytest.approx(3.716, abs=5e-4)
    assert pytest.approx((9.78, 23.2, 12.1), rel=2e-3) == design.K
    stands(design, 0.5**0.5)
    assert str(design).startswith("K = (9.781")


@pytest.mark.parametrize("n", [2, 4, 5])
@pytest.mark.parametrize("sigma", [0.01, 0.3])
def test_designs_stand(n: int, sigma: float) -> None:
    stands(adaptive_gain(n, slope=1.5, sigma=sigma), 1.5)


def test_a_looser_bound_on_y_gives_a_smaller_gamma() -> None:
    bounds = [adaptive_gain(3, slope=0.71, largest=largest).gamma for largest in (1.0, 10.0, 100.0)]
    assert bounds[0] > bounds[1] > bounds[2]


def test_p_is_sought_for_a_given_gain() -> None:
    """For the printed K, whose printed P gives 20.519 and 31364."""
    design = adaptive_gain(3, slope=0.71, K=K)
    assert tuple(K) == design.K
    assert float(design.gamma) < 20.519
    stands(design, 0.71)
    assert adaptive_gain(3, slope=0.71, K=K, disturbance=TORQUE).mu < 31364


def test_the_smallest_l2_gain() -> None:
    """No bound on gamma alone reaches it, and a gamma a tenth larger or smaller is worse."""
    design = adaptive_gain(3, slope=0.71, disturbance=TORQUE)
    assert design.mu is not None
    stands(design, 0.71)
    assert design.gamma > adaptive_gain(3, slope=0.71).gamma
    capped = adaptive_gain(3, slope=0.71, disturbance=TORQUE, gamma=0.9 * float(design.gamma))
    assert capped.mu > design.mu
    assert capped.gamma <= 0.9 * float(design.gamma)


@pytest.mark.parametrize(
    ("asked", "ways"),
    [
        ({"gamma": 2.0}, {"gamma"}),
        ({"gamma": 3.5}, {"gamma", "sigma"}),
        ({"gamma": 3.7, "largest": 1.0}, {"gamma", "largest"}),
        ({"mu": 100.0, "disturbance": TORQUE}, {"mu"}),
    ],
)
def test_the_sentence_names_the_bound_to_relax_and_it_does(asked: dict[str, Any], ways: set[str]) -> None:
    with pytest.raises(Infeasible, match=r"no K and P were found for a chain of 3 integrators with sigma = 0\.05") as e:
        adaptive_gain(3, slope=0.71, **asked)
    assert set(e.value.enough) == ways
    for name, value in e.value.enough.items():
        assert f"{name} = {value}" in str(e.value)
        adaptive_gain(3, slope=0.71, **{**asked, name: float(value)})


def test_several_bounds_in_the_way() -> None:
    """No gain makes it, however large, and no sigma: gamma is above 3 without any of them."""
    with pytest.raises(Infeasible, match=r"relax several of them, none alone is in the way") as caught:
        adaptive_gain(3, slope=0.71, sigma=SIGMA, gamma=1.0, largest=1e-3, mu=1e-3, disturbance=TORQUE)
    assert caught.value.enough == {}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"n": 1}, r"n = 1 must be a whole number of integrators, at least 2"),
        ({"n": 2.0}, r"n = 2\.0 must be a whole number"),
        ({"slope": -1}, r"slope = -1 must be a finite number, at least 0"),
        ({"slope": float("nan")}, r"slope = nan must be"),
        ({"sigma": 0}, r"sigma = 0 must be a positive finite number"),
        ({"largest": 0}, r"largest = 0 must be a positive"),
        ({"gamma": float("nan")}, r"gamma = nan must be a positive"),
        ({"mu": 3.0}, r"mu = 3\.0 bounds the gain from a disturbance; give the disturbance"),
        ({"K": (1, 2)}, r"K = \(1, 2\) must be 3 finite numbers"),
        ({"disturbance": (np.eye(2), (1, 1))}, r"G_1 of shape \(2, 2\) and G_2 of shape \(2,\) must be \(3, m\)"),
    ],
)
def test_bad_questions(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        adaptive_gain(**{"n": 3, "slope": 0.71, **asked})


def test_a_gain_that_does_not_decay() -> None:
    with pytest.raises(NotHurwitz, match=r"^K: the linear error core has the eigenvalues"):
        adaptive_gain(3, slope=0.71, K=(1, 1, 2))


def test_without_a_solver_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(NoSolver, match=r"the design of an adaptive gain needs clarabel; install it"):
        adaptive_gain(3, slope=0.71)


# --- of a form ----------------------------------------------------------------------------------------------


@pytest.mark.full
def test_of_a_form_the_slope_is_taken_where_gamma_is() -> None:
    """The pendulum's slope from gamma = 1 on is 19.6, and asks gamma >= 45; near sqrt(45) it is 2.9, and asks that."""
    far = adaptive_gain(2, slope=slope(pendulum()))
    assert float(far.gamma) > 44
    design = adaptive_gain(pendulum())
    assert float(design.gamma) < 6.8
    stands(design, slope(pendulum(), float(design.gamma)))
    assert proved(design, pendulum())
    below = 0.99 * float(design.gamma)
    assert adaptive_gain(2, slope=slope(pendulum(), below)).gamma > below
    assert adaptive_gain(pendulum()) == design


@pytest.mark.full
def test_of_a_form_the_bounds_hold() -> None:
    """One on gamma that the slope from 1 on forbids is met; one that none meets is refused, with what would do."""
    assert adaptive_gain(pendulum(), gamma=10.0).gamma <= 10
    for bound in (5.0, 0.5):
        with pytest.raises(Infeasible) as caught:
            adaptive_gain(pendulum(), gamma=bound)
        assert adaptive_gain(pendulum(), gamma=float(caught.value.enough["gamma"])).gamma > 6


@pytest.mark.full
def test_of_a_form_with_a_disturbance() -> None:
    push = (((0,), (1,)), (1,))
    far = adaptive_gain(2, slope=slope(pendulum()), disturbance=push)
    design = adaptive_gain(pendulum(), disturbance=push)
    assert design.mu is not None
    assert 10 * design.mu < far.mu
    assert proved(design, pendulum(), disturbance=push)
    stands(design, slope(pendulum(), float(design.gamma)))
    with pytest.raises(Infeasible) as caught:
        adaptive_gain(pendulum(), disturbance=push, mu=float(design.mu) / 2)
    assert adaptive_gain(pendulum(), disturbance=push, mu=float(caught.value.enough["mu"])).mu <= design.mu * (1 + 1e-2)


@pytest.mark.parametrize(
    ("asked", "options", "said"),
    [
        (lambda: pendulum(), {"slope": 1.0}, r"slope is found of pendulum itself; leave it out"),
        (lambda: 2, {}, r"slope must be given with n; or give the form in place of n"),
        (lambda: 2, {"slope": None}, r"slope must be given with n"),
        (lambda: pendulum().system, {}, r"adaptive_gain was given .*, of type System; give a form, or a whole number"),
    ],
)
def test_neither_a_form_nor_n_with_its_slope(asked: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises((BadGain, Misfit), match=f"^{said}") as caught:
        adaptive_gain(asked(), **options)
    assert len(str(caught.value)) < 250


def test_an_error_names_a_form_in_short() -> None:
    with pytest.raises(
        BadGain, match=r"^slope = the form of pendulum must be a number; adaptive_gain\(form\) finds it"
    ):
        adaptive_gain(2, slope=pendulum())
    with pytest.raises(
        Misfit, match=r"^slope was given System.*give a form: hg\.forms\.triangular\(plant\)$"
    ) as caught:
        slope(pendulum().system)
    assert len(str(caught.value)) < 250


def test_a_constant_gain_is_asked_of_a_form() -> None:
    with pytest.raises(Misfit, match=r"^constant_gain was given 3.*give a form: hg\.forms\.triangular\(plant\)$"):
        hg.design.constant_gain(3)
    with pytest.raises(BadGain, match=r"^largest = 0 must be a positive finite number"):
        hg.design.constant_gain(pendulum(), largest=0)
