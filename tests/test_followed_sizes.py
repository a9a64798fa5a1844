"""That sizes of a certificate follow from what a user says: how disturbances go on, and other coordinates."""

import copy
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Verdict
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.matrix import Matrix
from hgogen.recheck.plant_motion import _accumulated
from hgogen.recheck.verification import recheck


@pytest.mark.parametrize("h", [1e-6, 1e-2, 0.5])
def test_what_moves_a_row_goes_on_to_the_others_as_by_the_exponential(h: float) -> None:
    """The integral is a column of the exponential of [h J, m; 0, 0], by SciPy."""
    rng = np.random.default_rng(4)
    for n in (1, 2, 4):
        J, m = rng.uniform(0, 8, (n, n)) * (rng.random((n, n)) < 0.6), rng.uniform(0, 1, n) * (rng.random(n) < 0.6)
        wide = np.zeros((n + 1, n + 1))
        wide[:n, :n], wide[:n, n] = h * J, m
        wanted = expm(wide)[:n, n]
        rows = Matrix([[Fraction(x) for x in row] for row in J])
        summed = _accumulated(Fraction(h), rows, [Fraction(x) for x in m])
        np.testing.assert_allclose([float(x) for x in summed], wanted, rtol=1e-12, atol=1e-300)
        assert all(x >= Fraction(size) for x, size in zip(summed, m, strict=True))


def test_the_sum_is_not_below_what_it_tends_to() -> None:
    """Of J = 1 and m = 1 it is (e^h - 1)/h."""
    h = Fraction(1, 2)
    (summed,) = _accumulated(h, Matrix([[Fraction(1)]]), [Fraction(1)])
    terms, total = Fraction(1), Fraction(1)
    for k in range(2, 200):
        terms *= h / k
        total += terms
    assert total < summed < total * (1 + Fraction(1, 10**60))


def test_a_plant_too_fast_for_its_dt_is_not_summed() -> None:
    with pytest.raises(Unproved, match="too fast"):
        _accumulated(Fraction(1), Matrix([[Fraction(21)]]), [Fraction(1)])
    with pytest.raises(Unproved, match="negative"):
        _accumulated(Fraction(1), Matrix([[Fraction(-1)]]), [Fraction(1)])


@cache
def certified() -> dict[str, Any]:
    """Of x1' = x2 + sin(x1)/2, x2' = -c x1 in the coordinates of its phase form, z2 = x2 + sin(x1)/2."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-2, high=2)
    c = hg.Signal("c", "", "", 2)
    flow = [x2 + sp.sin(x1) / 2, -c * x1]
    plant = hg.System("bent", states=(x1, x2), parameters=(c,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    observer = hg.observers.high_gain(hg.forms.phase(plant), theta=12, poles=(-1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
    known = hg.error_bound(step, disturbance={"x1": 0.1, "x2": 0.2}, late={"y": 1e-4}, parameters={"c": 0.1})
    assert known.check.verdict is Verdict.PROVED, known
    return hg.certificate(observer.form, (*observer.checks, known.check), "high_gain")


def row(content: dict[str, Any]) -> Any:
    (one,) = (each for each in recheck(sealed(content)).rows if each.id.endswith(".error"))
    return one


def share(content: dict[str, Any], kind: str) -> dict[str, Any]:
    (one,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    (each,) = (each for each in one["shares"] if each["inputs"] == kind)
    return each


@pytest.mark.full
def test_disturbances_are_of_the_plants_own_rows() -> None:
    """dz2/dx1 = cos(x1)/2 brings that of x1 into the row of z2."""
    content = certified()
    assert row(content).found == "verified"
    rows = share(content, "disturbance")["follows"]["rows"]
    assert [float(Fraction(x)) for x in rows[1]] == pytest.approx([0.5, 1], rel=2e-3)


@pytest.mark.parametrize("at", [(0, 0), (1, 0), (1, 1)])
def test_a_flatter_change_of_coordinates_fails(at: tuple[int, int]) -> None:
    content = copy.deepcopy(certified())
    rows = share(content, "disturbance")["follows"]["rows"]
    rows[at[0]][at[1]] = str(Fraction(rows[at[0]][at[1]]) * Fraction(99, 100))
    assert row(content).found == "fails"


def test_what_a_late_sample_shows_of_disturbances_counts() -> None:
    """y' is beside z2 by that of the first row."""
    content = copy.deepcopy(certified())
    late = share(content, "late")
    speed, tau = (Fraction(late["follows"][key][0]) for key in ("speeds", "sizes"))
    late["samples"] = [str(speed * tau)]
    assert row(content).found == "fails"


def test_a_steeper_plant_than_it_is_said_fails() -> None:
    for i, j in ((0, 1), (1, 0)):
        content = copy.deepcopy(certified())
        for kind in ("disturbance", "parameters"):
            J = share(content, kind)["follows"]["steepness"]
            J[i][j] = str(Fraction(J[i][j]) * Fraction(98, 100))
        assert row(content).found == "fails"


@pytest.mark.parametrize("end", ["upper", "lower"])
def test_slopes_in_a_parameter_are_those_of_all_its_values(end: str) -> None:
    """2 c |x1| is the largest at c = 2.1, 4 |x1|/c^2 at c = 1.9, of a program that has c = 2."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-2, high=2)
    c = hg.Signal("c", "", "", 2)
    flow = [x2, -(c**2) * x1 if end == "upper" else -4 * x1 / c]
    plant = hg.System("stiff", states=(x1, x2), parameters=(c,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=12, poles=(-1, -1))
    known = hg.error_bound(hg.sample(observer, hg.methods.rk4, dt=1e-3), parameters={"c": 0.1})
    content = hg.certificate(observer.form, (*observer.checks, known.check), "high_gain")
    assert row(content).found == "verified"
    rows = share(content, "parameters")["follows"]["rows"]
    rows[1][0] = str(Fraction(rows[1][0]) * Fraction(98, 100))
    assert row(content).found == "fails"
