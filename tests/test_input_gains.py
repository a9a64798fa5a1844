"""How far noise and disturbances drive an error in continuous time: known answers, responses of slopes that are held,
and forged numbers."""

import copy
import json
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from scipy.linalg import expm

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.prove.inclusion import Uncertain
from hgogen.prove.quadratic import identity, rational, verified
from hgogen.prove.questions import Driven
from hgogen.reading.given import BadGain, BadNames
from hgogen.recheck.rules import RULES
from hgogen.recheck.verification import recheck

MODELS = Path(__file__).resolve().parents[1] / "models"
DISTURBED, PENDULUM = load(MODELS / "disturbed_pendulum.py"), load(MODELS / "pendulum.py")
K = DISTURBED.module.tuning["adaptive_lmi"]["K"]
Matrices = tuple[np.ndarray, np.ndarray]
Gain = hg.L2Gain | hg.IssGain


@cache
def frozen(gamma: float) -> hg.Observer:
    """That of the disturbed pendulum at a gamma that rests."""
    return hg.observers.high_gain(hg.forms.triangular(DISTURBED.plant), theta=gamma, poles=np.roots([1, *K]))


@cache
def swinging(observer: str = "high_gain") -> hg.Observer:
    return PENDULUM.step(observer).observer


def held(gamma: float) -> Iterator[Matrices]:
    """A and B of e' = A e + B (noise, x3') with the slopes -0.5 cos x1, of which the clamp leaves a share, held."""
    powers = gamma ** np.arange(1, 4) * K
    for slope, friction in ((-0.5, -0.5), (0.5, -0.5), (0.0, 0.0), (0.5, 0.0), (-0.5, 0.0)):
        A = np.array([[-powers[0], 1, 0], [-powers[1] + slope, friction, 1], [-powers[2], 0, 0]])
        yield A, np.column_stack([powers, [0, 0, -1]])


def norm(A: np.ndarray, B: np.ndarray) -> float:
    """The largest response at any of many frequencies."""
    s = 1j * np.geomspace(1e-2, 1e4, 3000)[:, None, None]
    return float(
        np.linalg.norm(np.linalg.solve(s * np.eye(len(A)) - A, np.broadcast_to(B, (3000, *B.shape))), 2, (1, 2)).max()
    )


@pytest.mark.parametrize(("gamma", "known"), [(20.53, 463), (80, 7028)])
def test_at_a_gain_that_rests_it_is_that_of_the_slowest_slope(gamma: float, known: float) -> None:
    bound = hg.l2_gain(frozen(gamma), noise={"y": 1}, disturbance={"x3": 1})
    assert bound.check.verdict is Verdict.PROVED
    assert bound.gain is not None
    worst = max(norm(*each) for each in held(gamma))
    assert known == pytest.approx(worst, rel=0.02)
    assert worst <= bound.gain <= 1.01 * worst


def test_a_bound_is_that_of_what_is_counted() -> None:
    """Of e' = v - e its gain of e is 1, of 2 e it is 2, with V = e^2 and 4 e^2."""
    one = identity(1)
    e = Uncertain(-one, one[:, :0], one[:0], one, one[:0], -one, one)
    for counted, P, enough in ((1, 1, 1), (2, 4, 4)):
        driven = Driven(e, counted * one)
        for share, proved in ((Fraction(3, 4), False), (Fraction(101, 100) ** 2, True)):
            weights = rational([[Fraction(P)]]), rational([share * enough])
            assert verified([driven.form], *weights) is proved


def test_of_a_gain_that_moves_one_v_is_within_three_of_the_largest() -> None:
    (claim,) = (check for check in DISTURBED.step().observer.checks if check.id == "adaptive_lmi.attenuation")
    assert claim.verdict is Verdict.PROVED
    mu = float(claim.reason.part("mu").value)
    assert 7028 < mu < 3 * 7028


def test_errors_come_to_less_than_the_worst_input_of_a_held_slope_drives() -> None:
    known = hg.iss_gain(frozen(20.53), noise={"y": 1e-3}, disturbance={"x3": 0.2})
    assert known.check.verdict is Verdict.PROVED
    each = np.array([worst(A, B * [1e-3, 0.2]) for A, B in held(20.53)])
    bounds = np.array(list(known.bounds.values()))
    assert (each.max(axis=0) <= bounds).all()
    assert (bounds <= 3 * each.max(axis=0)).all()


def worst(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """By state, how far inputs of at most 1 drive it that follow the sign of its response."""
    h, moved, total = 2e-4, B, np.zeros(len(A))
    step = expm(h * A)
    for _ in range(6000):
        total += h * np.abs(moved).sum(axis=1)
        moved = step @ moved
    return total * 0.999  # the first terms of the sum are a little too large


def test_larger_inputs_drive_it_further_in_proportion() -> None:
    once, twice = (hg.iss_gain(swinging(), noise={"y": k}, disturbance={"w": k}).bounds for k in (1, 2))
    assert list(twice.values()) == pytest.approx([2 * x for x in once.values()], rel=1e-3)
    whole = hg.l2_gain(swinging(), noise={"y": 1}).gain
    of_rate = hg.l2_gain(swinging(), noise={"y": 1}, of={"q": 0}).gain
    assert whole is not None
    assert of_rate is not None
    assert of_rate < whole
    assert hg.l2_gain(swinging(), noise={"y": 1}, of={"q": 2, "w": 2}).gain == pytest.approx(2 * whole, rel=1e-3)


# --- certificates -------------------------------------------------------------------------------------------


@cache
def _gains(observer: str) -> tuple[Gain, Gain]:
    inputs: dict[str, Any] = {"noise": {"y": 1e-3}, "disturbance": {"w": 0.2}}
    return hg.l2_gain(swinging(observer), **inputs), hg.iss_gain(swinging(observer), **inputs)


@cache
def _written(observer: str) -> str:
    one, checks = swinging(observer), tuple(known.check for known in _gains(observer))
    return json.dumps(certificate(one.form, (*one.checks, *checks), observer))


def rows(content: dict[str, Any]) -> dict[str, str]:
    return {row.id.rpartition(".")[2]: row.found for row in recheck(sealed(content)).rows}


FIVE = ("high_gain", "filtered", "filtered_injection", "low_power", "peaking_free")


@pytest.mark.parametrize("observer", FIVE)
def test_both_are_verified_again(observer: str) -> None:
    seen = rows(json.loads(_written(observer)))
    assert (seen["l2_gain"], seen["iss_gain"]) == ("verified", "verified")


FORGED = {
    "mu": lambda x: x["l2_gain"].update(mu=less(x["l2_gain"]["mu"])),
    "P": lambda x: x["l2_gain"]["P"][0].__setitem__(0, less(x["l2_gain"]["P"][0][0])),
    "S": lambda x: x["l2_gain"]["S"].__setitem__(-1, less(x["l2_gain"]["S"][-1])),
    "noise": lambda x: x["l2_gain"].update(noise=["1/500"]),
    "beside": lambda x: x["l2_gain"].update(beside=[["0", "2"]]),
    "two": lambda x: x["l2_gain"].update(beside=[*x["l2_gain"]["beside"], ["0", "1"]]),
    "counts": lambda x: x["l2_gain"].update(counts=["1", "11/10"]),
    "bound": lambda x: x["iss_gain"]["bounds"][1].update(bound=less(x["iss_gain"]["bounds"][1]["bound"])),
    "alpha": lambda x: x["iss_gain"]["bounds"][0].update(alpha=less(x["iss_gain"]["bounds"][0]["alpha"])),
    "one": lambda x: x["iss_gain"]["bounds"].pop(),
    "louder": lambda x: x["iss_gain"].update(noise=["1/900"]),
    "another lambda": lambda x: x["l2_gain"]["S"].__setitem__(-1, str(2 * Fraction(x["l2_gain"]["mu"]) ** 2)),
}


def less(text: str) -> str:
    return str(Fraction(text) * Fraction(9, 10))


@pytest.mark.parametrize("forged", FORGED)
def test_a_forged_number_fails(forged: str) -> None:
    content = copy.deepcopy(json.loads(_written("high_gain")))
    FORGED[forged]({claim["id"].rpartition(".")[2]: claim["evidence"] for claim in content["claims"]})
    assert "fails" in {rows(content)[fact] for fact in ("l2_gain", "iss_gain")}


def test_only_of_a_constant_injection_bounds_are_verified() -> None:
    """Behind a saturation the error obeys another equation."""
    bounds = {"error", "l2_gain", "iss_gain", "step", "noise", "start"}
    makers = {maker for rule in RULES if bounds & {*rule.facts} for maker in rule.makers}
    assert makers == {*FIVE, "circle_criterion"}


# --- bad input ----------------------------------------------------------------------------------------------


def test_where_nothing_is_proved_it_says_why() -> None:
    riccati = PENDULUM.step("riccati").observer
    for known, said in (
        (hg.l2_gain(riccati, noise={"y": 1}), "the proof is for a constant injection"),
        (hg.iss_gain(swinging()), "nothing enters the error"),
        (hg.l2_gain(swinging(), noise={"y": 1}, of={"q": 0, "w": 0}), "nothing is counted of the error"),
        (hg.l2_gain(slow(), noise={"y": 1}), "held there, errors do not decay"),
    ):
        assert known.check.verdict is Verdict.UNKNOWN
        assert said in str(known.check.reason)
    assert hg.iss_gain(swinging()).bounds == {}


def slow() -> hg.Observer:
    return hg.observers.high_gain(hg.forms.triangular(PENDULUM.plant), theta=0.5, poles=(-1, -1))


def test_a_disturbance_that_enters_by_the_state_is_not_bounded() -> None:
    x, v, y = hg.Signal("x", low=1, high=2), hg.Signal("v", low=-1, high=1), hg.Signal("y")
    plant = hg.System("bent", states=(x, v), outputs=(y,), flow=[x * v, -v], output=[sp.log(x)])
    form = hg.forms.phase(plant)
    observer = hg.observers.high_gain(form, theta=5, poles=(-1, -1))
    known = hg.l2_gain(observer, disturbance={"x": 1})
    assert "x' enters the form's rows by slopes that are no numbers" in str(known.check.reason)
    assert hg.l2_gain(observer, disturbance={"v": 1}).check.verdict is Verdict.PROVED


def test_what_is_no_size_is_named() -> None:
    for arguments, error, said in (
        ({"noise": {"z": 1}}, BadNames, "noise names 'z'"),
        ({"disturbance": {"w": -1}}, BadGain, "disturbance of w = -1 must be"),
        ({"of": {"w": float("inf")}}, BadGain, "of of w = inf must be"),
    ):
        with pytest.raises(error, match=said):
            hg.l2_gain(swinging(), **arguments)
