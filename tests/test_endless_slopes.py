"""Slopes of one sign without an end: the argument for which there is a norm, by hand, and what a checker says of it."""

import copy
import itertools
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.prove.constant_gain import injected
from hgogen.prove.convergence import OneSided
from hgogen.prove.error_models import with_gains
from hgogen.prove.inclusion import Nothing
from hgogen.prove.quadratic import rational
from hgogen.recheck.verification import recheck


def drag(last: Any = lambda x: -(x[1] ** 3), n: int = 2) -> hg.Form:
    """y = x1, x1' = x2, .., x_n' = last, of which only x1 has a range."""
    x = [hg.Signal("x1", low=-2, high=2), *(hg.Signal(f"x{i}") for i in range(2, n + 1))]
    plant = hg.System(
        "drag", states=tuple(x), outputs=(hg.Signal("y"),), flow=[*x[1:], sp.sympify(last(x))], output=[x[0]]
    )
    return hg.forms.triangular(plant)


def observer(argument: Any, form: hg.Form | None = None, theta: float = 3.0) -> hg.Observer:
    form = form or drag()
    return hg.observers.circle_criterion(form, theta=theta, poles=(-1,) * form.n, argument=argument)


def verdict(made: hg.Observer, fact: str = "convergence") -> hg.Verdict:
    (check,) = (each for each in made.checks if each.id == f"circle_criterion.{fact}")
    return check.verdict


# --- by hand ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "known"),
    [(-0.5, "unknown"), (0.0, "unknown"), (0.05, "proved"), (1.0, "proved"), (1.9, "proved"), (2.1, "unknown")],
)
def test_two_states_by_hand(entry: float, known: str) -> None:
    """P = [p, -N; -N, 1], M'P + P M < 0 for K = (2, 1): (p - 5)^2 < 0 at N = 2, so that N is from 0 to 2 alone."""
    made = observer((1, entry))
    assert verdict(made).value == known
    assert verdict(made, "theta").value == known


def test_without_an_argument_there_is_none() -> None:
    made = hg.observers.high_gain(drag(), theta=3, poles=(-1, -1))
    (check,) = (each for each in made.checks if each.id == "high_gain.convergence")
    assert check.verdict is hg.Verdict.UNKNOWN


def test_a_slope_that_grows_asks_for_the_other_sign() -> None:
    """x2' = x2^3: no N has a norm, as the error grows; nor has the one that serves -x2^3."""
    form = drag(lambda x: x[1] ** 3)
    assert all(verdict(observer((1, entry), form)) is hg.Verdict.UNKNOWN for entry in (-1.0, 0.5, 1.0))


def test_a_slope_with_both_ends_open_is_none() -> None:
    made = observer((1, 0.5), drag(lambda x: x[1] * sp.sin(x[1])))
    (check,) = (each for each in made.checks if each.id == "circle_criterion.convergence")
    assert "has no finite range" in str(check.reason)


def test_a_jump_is_none() -> None:
    """Coulomb's friction beside -x2^3, whose slope is at most 0 wherever there is one."""
    made = observer((1, 0.5), drag(lambda x: -sp.sign(x[1]) - x[1] ** 3))
    (check,) = (each for each in made.checks if each.id == "circle_criterion.convergence")
    assert "may jump" in str(check.reason)


@pytest.mark.parametrize(
    "last",
    [
        lambda x: -x[1] * sp.Abs(x[1]),
        lambda x: -(x[1] ** 2) * sp.sign(x[1]),
        lambda x: -(x[1] ** 3) - sp.Piecewise((x[1], x[1] < 0), (2 * x[1], True)),
    ],
)
def test_a_kink_is_no_jump(last: Any) -> None:
    made = observer((1, 0.5), drag(last))
    assert verdict(made) is verdict(made, "theta") is hg.Verdict.PROVED


def test_a_jump_at_a_pole_is_none() -> None:
    """-atan(tan(x2)) has the slope -1 wherever it has one, and jumps by pi where the tangent has its poles."""
    made = observer((1, 0.5), drag(lambda x: -(x[1] ** 3) - sp.atan(sp.tan(x[1]))))
    assert verdict(made) is verdict(made, "theta") is hg.Verdict.UNKNOWN
    (check,) = (each for each in made.checks if each.id == "circle_criterion.convergence")
    assert str(check.reason) == "the bound rests on singular.x2, which is not proved"
    (singular,) = (each for each in made.checks if each.id == "singular.x2")
    assert str(singular.reason) == "x2' has no finite value at cos(x2) = 0; there is no declared range of x2"


@pytest.mark.parametrize("theta", [2.0, 5.0])
def test_errors_fall_by_the_norm_at_slopes_of_any_size(theta: float) -> None:
    """V' <= -2 rate V with slopes from 0 to -1e9 beside those of sin x1, in floats."""
    form = drag(lambda x: -(x[1] ** 3) - sp.sin(x[0]) + x[1] / 4)
    made = observer((0.2, 0.8), form, theta)
    (check,) = (each for each in made.checks if each.id == "circle_criterion.theta")
    assert check.verdict is hg.Verdict.PROVED
    proof = check.proofs[0].fact
    P, rate = np.array(proof.falls.weights.P, float), proof.falls.alpha / 2
    for steep, fast in itertools.product((-1.0, 0.42), (0.25, -1.0, -1e3, -1e9)):
        M = theta * np.array([[-2.0, 1], [-1, 0]])
        M[1] += steep / theta * np.array([0.8, 0]) + fast * np.array([-0.8, 1])
        form_ = M.T @ P + P @ M + 2 * float(rate) * P
        assert np.linalg.eigvalsh(form_).max() <= 1e-6 * np.abs(form_).max()


def test_a_norm_that_a_slope_adds_to_is_none() -> None:
    """The sum of the basis that takes from V, negated, has a lambda below 0."""
    (check,) = (each for each in observer((1, 0.5)).checks if each.id == "circle_criterion.theta")
    falls = check.proofs[0].fact.falls
    sought = OneSided(injected(with_gains(drag(), [2, 1], endless=True), drag(), (1, sp.Rational(1, 2))), falls.theta)
    P = rational(falls.weights.P)
    assert all(share >= 0 for share in sought._lambdas(P))
    assert not all(share >= 0 for share in sought._lambdas(-P))


@pytest.mark.ordinary("1")
@pytest.mark.parametrize("row", [1, 2])
def test_three_states_have_none(row: int) -> None:
    """P e_3 = lambda (-N, 0, 1)' leaves e_3 nothing to fall by; in the second row the response is 0 at s = 0."""
    x1, x2, x3 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2"), hg.Signal("x3")
    flow = [x2, x3 - (x2**3 if row == 1 else 0), -(x3**3) if row == 2 else sp.S.Zero]
    plant = hg.System("three", states=(x1, x2, x3), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    for argument in ((1, 1, 0), (1, 0.3, 0.8), (0, 1, 1)):
        made = observer(argument, hg.forms.triangular(plant))
        (check,) = (each for each in made.checks if each.id == "circle_criterion.convergence")
        assert "in the last of two states of a chain" in str(check.reason)


def test_one_that_grows_counts_by_its_least() -> None:
    """x' = x^3 - x, N = 2: e' = -(theta + d) e, d >= -1, whatever it is above."""
    x = hg.Signal("x")
    plant = hg.System("grows", states=(x,), outputs=(hg.Signal("y"),), flow=[x**3 - x], output=[x])
    made = observer((2,), hg.forms.triangular(plant))
    (check,) = (each for each in made.checks if each.id == "circle_criterion.convergence")
    assert check.verdict is hg.Verdict.PROVED
    assert 1 <= check.proofs[0].fact.theta < 1.05


def test_each_of_two_has_a_share_of_its_own() -> None:
    """x1' = -x1^3 + 10 x2 beside x2' = -x2^3, with half of each sample: e1' = -e1 + d e2, d in 0..5, asks for a P that
    weighs e2 by more than e1."""
    x1, x2 = hg.Signal("x1"), hg.Signal("x2")
    outputs, flow = (hg.Signal("y1"), hg.Signal("y2")), [-(x1**3) + 10 * x2, -(x2**3)]
    plant = hg.System("pair", states=(x1, x2), outputs=outputs, flow=flow, output=[x1, x2])
    form = hg.forms.block_triangular(plant)
    made = hg.observers.circle_criterion(form, theta=1, poles=((-1,), (-1,)), argument=((0.5,), (0.5,)))
    assert verdict(made, "theta") is hg.Verdict.PROVED


@pytest.mark.full
def test_of_two_chains_each_may_have_one() -> None:
    x1, x2, x3 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2"), hg.Signal("x3")
    flow, outputs = [x2, -(x2**3) - sp.sin(x1)], (hg.Signal("y1"), hg.Signal("y2"))
    plant = hg.System(
        "two", states=(x1, x2, x3), outputs=outputs, flow=[*flow, -(x3**3) - x3 + sp.sin(x1)], output=[x1, x3]
    )
    form = hg.forms.block_triangular(plant)
    made = hg.observers.circle_criterion(form, theta=3, poles=((-1, -1), (-1,)), argument=((1, 0.5), (0.5,)))
    assert verdict(made) is hg.Verdict.PROVED
    content = certificate(form, made.checks, made.name)
    assert finding(content, "convergence") == finding(content, "theta") == "verified"


@pytest.mark.full
def test_what_reads_nothing_asks_for_nothing() -> None:
    """x1 without a range, and its sample in its place: the slope of x1^3 is of any sign of e, and of none."""
    x1, x2 = hg.Signal("x1"), hg.Signal("x2", low=-1, high=1)
    plant = hg.System(
        "free", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2 + x1**3, -x2 - sp.sin(x2)], output=[x1]
    )
    made = observer(None, hg.forms.triangular(plant))
    assert verdict(made) is hg.Verdict.PROVED
    assert isinstance(made.error, Nothing)


def test_steps_say_why_they_are_not_proved() -> None:
    step = hg.sample(observer((1, 0.5)), hg.methods.rk4, dt=1e-3)
    assert "continuous time alone" in str(hg.contraction(step).checks[0].reason)
    assert "continuous time alone" in str(hg.noise_gain(step))
    assert "continuous time alone" in str(hg.start_set(step))
    assert "continuous time alone" in str(hg.error_bound(step, noise={"y": 1e-3}).check.reason)
    assert hg.l2_gain(observer((1, 0.5)), noise={"y": 1}).gain is None
    assert isinstance(hg.design.noise_bounds(observer((1, 0.5))), Nothing)


# --- a certificate ----------------------------------------------------------------------------------------------------


@cache
def content() -> dict[str, Any]:
    made = observer((1, 0.5))
    return certificate(made.form, made.checks, made.name)


def evidence(changed: dict[str, Any], fact: str) -> dict[str, Any]:
    (one,) = (each for each in changed["claims"] if each["id"] == f"circle_criterion.{fact}")
    return one["evidence"]


def finding(changed: dict[str, Any], fact: str) -> str:
    rows = {row.id: row.found for row in recheck(sealed(changed)).rows}
    return rows[f"circle_criterion.{fact}"]


def test_both_claims_are_verified() -> None:
    assert finding(content(), "convergence") == finding(content(), "theta") == "verified"
    (slope,) = evidence(content(), "convergence")["slopes"]
    assert slope["low"] is None


@pytest.mark.parametrize("fact", ["convergence", "theta"])
@pytest.mark.parametrize("place", [(0, 1), (1, 1)])
def test_a_norm_beside_the_equations_fails(fact: str, place: tuple[int, int]) -> None:
    """As near to P as 1e-6: a slope that is large enough makes V grow."""
    changed = copy.deepcopy(content())
    P = evidence(changed, fact)["P"]
    i, j = place
    P[i][j] = P[j][i] = str(Fraction(P[i][j]) * Fraction(1000001, 1000000))
    assert finding(changed, fact) == "fails"


def test_another_argument_fails() -> None:
    changed = copy.deepcopy(content())
    changed["observer"]["argument"][1] = "49/100"
    assert finding(changed, "convergence") == "fails"


def test_a_plant_whose_slope_has_the_other_sign_fails() -> None:
    changed = copy.deepcopy(content())
    changed["plant"]["flow"][1], changed["form"]["b"][1] = "x2**3", "z2**3"
    assert finding(changed, "convergence") == "fails"


def test_a_slope_that_grows_and_is_said_to_fails() -> None:
    """Its range is that of the plant; but what is beyond its end makes V grow."""
    changed = copy.deepcopy(content())
    changed["plant"]["flow"][1], changed["form"]["b"][1] = "x2**3", "z2**3"
    (slope,) = evidence(changed, "convergence")["slopes"]
    slope["low"], slope["high"] = "0", None
    assert finding(changed, "convergence") == "fails"


def test_the_other_end_open_fails() -> None:
    changed = copy.deepcopy(content())
    (slope,) = evidence(changed, "convergence")["slopes"]
    slope["low"], slope["high"] = "0", None
    assert finding(changed, "convergence") == "fails"


def test_no_end_at_all_fails() -> None:
    changed = copy.deepcopy(content())
    (slope,) = evidence(changed, "convergence")["slopes"]
    slope["high"] = None
    assert finding(changed, "convergence") == "fails"


def test_a_step_is_not_verified_with_a_slope_without_an_end() -> None:
    """The certificate of a step on ranges, with a range of a slope left open: its inequality says nothing of that."""
    x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
    plant = hg.System("drag", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -(x2**3) / 9], output=[x1])
    made = observer((1, 0.5), hg.forms.triangular(plant))
    known = hg.contraction(hg.sample(made, hg.methods.rk4, dt=1e-3))
    changed = certificate(made.form, (*made.checks, *known.checks), made.name)
    assert finding(changed, "step") == "verified"
    (slope,) = evidence(changed, "step")["slopes"]
    slope["low"], evidence(changed, "step")["S"] = None, []  # its P shows that the core contracts, with no slope at all
    assert finding(changed, "step") == "fails"
