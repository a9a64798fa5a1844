"""Maps that are one to one by the signs of minors: by hand, against maps that come back, and certificates of them."""

import copy
import json
from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import strategies as st

import hgogen as hg
from hgogen.analysis.determinant import subsets, univalent
from hgogen.certificates.certificate import certificate
from hgogen.check import Check, Verdict
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.verification import recheck
from hgogen.rigor.box import box
from tests.sweep import sweep


def states(*ranges: tuple[float, float]) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=low, high=high) for i, (low, high) in enumerate(ranges, 1)]


def plant(x: list[hg.Signal], flow: list[Any], y: Any, inputs: tuple[hg.Signal, ...] = ()) -> hg.System:
    return hg.System("plant", states=x, inputs=inputs, outputs=(hg.Signal("y"),), flow=flow, output=[y])


def one_to_one(system: hg.System) -> Check:
    return next(check for check in hg.forms.phase(system).checks if check.id == "phase.inverse")


def weights(F: list[Any], x: list[hg.Signal], boxes: int = 2000) -> Any:
    """Those with which a map is shown to be one to one."""
    return univalent(sp.Matrix(F).jacobian(sp.Matrix(x)), x, box(x, {}), boxes)


def turning(low: float, high: float) -> hg.System:
    """Phi = exp(x1) (cos x2, sin x2), whose determinant is exp(2 x1): x2 comes back after 2 pi."""
    x = states((0, 1), (low, high))
    return plant(x, [0, -1], sp.exp(x[0]) * sp.cos(x[1]))


def wave() -> hg.System:
    """y = x1 + sin(x2)/2 of an oscillator, whose derivative reads both states again."""
    x = states((-1.5, 1.5), (-1.5, 1.5))
    return plant(x, [x[1], -x[0]], x[0] + sp.sin(x[1]) / 2)


# --- by hand ------------------------------------------------------------------------------------------------


def test_a_map_without_a_closed_inverse_is_one_to_one() -> None:
    """Its Jacobian is [1, cos(x2)/2; -cos(x2)/2, 1 + x1 sin(x2)/2]: no order or sign is needed."""
    check = one_to_one(wave())
    assert check.verdict is Verdict.PROVED
    assert "(Gale, Nikaido 1965), L = [(1, 0); (0, 1)]" in str(check.reason)
    lipschitz = next(check for check in hg.forms.phase(wave()).checks if check.id == "phase.lipschitz")
    assert lipschitz.verdict is Verdict.PROVED


@pytest.mark.ordinary("0.5-3.2", "0.0-3.0")
@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (0.5, 3.2), (-4.0, -1.5), (0.0, 3.0)])
def test_a_turn_of_less_than_half_is_one_to_one(low: float, high: float) -> None:
    """cos of the angle from the middle is above 0 there, of rows combined as the inverse at the middle does."""
    assert one_to_one(turning(low, high)).verdict is Verdict.PROVED


@pytest.mark.parametrize(("low", "high"), [(0.0, 7.0), (-4.0, 4.0), (0.0, 3.3)])
def test_full_rank_is_not_enough(low: float, high: float) -> None:
    """Of the first two boxes the map comes back to points that it has been at; of the last this is not shown."""
    check = one_to_one(turning(low, high))
    assert check.verdict is Verdict.UNKNOWN
    assert "the principal minors of dPhi/dx are not shown to be above 0" in str(check.reason)


def test_an_order_and_signs_of_the_rows() -> None:
    x = states((-1, 1), (-1, 1), (-1, 1))
    F = [x[0] + sp.sin(x[1]) / 3, -x[1] + sp.cos(x[2]) / 3, x[2] + sp.tanh(x[0]) / 3]
    assert weights(F, x) == ((1, 0, 0), (0, -1, 0), (0, 0, 1))
    assert weights([F[2], F[0], F[1]], x) == ((0, 1, 0), (0, 0, -1), (1, 0, 0))


# --- a map that fails between the points --------------------------------------------------------------------


def dipping(depth: float, place: float = 0.123457, width: float = 4000) -> tuple[list[Any], list[hg.Signal]]:
    """A map whose first slope dips at one place alone, 1 - depth there."""
    x = states((-2, 2), (-2, 2))
    bump = sp.Float(depth) * sp.tanh(width * (x[0] - sp.Float(place))) / width
    return [x[0] - bump + x[1] / 9, x[1] + sp.sin(x[0]) / 9], x


@pytest.mark.full
def test_minors_that_are_below_zero_between_all_sample_points_are_seen() -> None:
    """The slope is 1 - depth at .123457, and 1 a thousandth beside; F takes a value twice."""
    F, x = dipping(1.2)
    at = [sp.Float("0.123457") + d for d in (sp.Float("-1e-5"), sp.Float("1e-5"))]
    low, high = (F[0].subs({x[0]: value, x[1]: 0}) for value in at)
    assert high < low  # it falls there, and rises elsewhere
    assert weights(F, x) is None
    assert weights(*dipping(0.9), boxes=20_000) is not None


# --- against maps that are drawn ----------------------------------------------------------------------------


@pytest.mark.full
@sweep(6, 60, st.integers(0, 2**32 - 1), st.floats(0.1, 1.2))
def test_what_is_shown_takes_no_value_twice(seed: int, size: float) -> None:
    """From pairs of points that Newton's method brings together where it can."""
    rng = np.random.default_rng(seed)
    x = states((-2, 2), (-2, 2))
    c = np.round(rng.uniform(-size, size, (2, 2)), 2)
    w = np.round(rng.uniform(0.5, 3, (2, 2)), 2)
    F = [x[i] + sum(float(c[i, j]) * sp.sin(float(w[i, j]) * x[j]) for j in range(2)) for i in range(2)]
    if weights(F, x) is None:
        return
    at = sp.lambdify(x, F, "numpy")
    jacobian = sp.lambdify(x, sp.Matrix(F).jacobian(sp.Matrix(x)), "numpy")
    for _ in range(20):
        here, other = rng.uniform(-2, 2, (2, 2))
        goal = np.array(at(*here))
        for _ in range(30):
            gap = np.array(at(*other)) - goal
            other = np.clip(other - np.linalg.lstsq(jacobian(*other), gap, rcond=None)[0], -2, 2)
        if np.abs(np.array(at(*other)) - goal).max() < 1e-9:
            assert np.abs(other - here).max() < 1e-6


def test_all_minors_are_asked() -> None:
    assert [*subsets(3)] == [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)]


# --- certificates -------------------------------------------------------------------------------------------


def written(system: hg.System) -> dict[str, Any]:
    form = hg.forms.phase(system)
    content: dict[str, Any] = json.loads(json.dumps(certificate(form, form.checks)))
    return content


def findings(content: dict[str, Any]) -> dict[str, str]:
    content = {**content, "model": model_digest(content)}
    return {row.id: row.found for row in recheck(json.dumps({**content, "digest": digest(content)})).rows}


def evidence(content: dict[str, Any]) -> dict[str, Any]:
    known: dict[str, Any] = next(c for c in content["claims"] if c["id"] == "phase.inverse")["evidence"]
    return known


def driven() -> hg.System:
    """With a parameter, an input and its derivative."""
    x, u = states((-1, 1), (-1, 1), (-1, 1)), hg.Signal("u", low=-1, high=1, rates=((-1, 1), (-1, 1)))
    flow = [x[1] + sp.sin(x[0]) / 9, x[2] + u * x[0] / 9, -x[0]]
    return plant(x, flow, x[0] + sp.sin(x[1]) / 12, (u,))


@pytest.mark.parametrize("system", [wave, lambda: turning(0.5, 3.2)])
def test_a_certificate_holds_it(system: Callable[[], hg.System]) -> None:
    content = written(system())
    assert findings(content)["phase.inverse"] == "verified"
    assert len(evidence(content)["minors"]) == 3


def _drop(proof: dict[str, Any]) -> None:
    del proof["minors"][-1]


def _twice(proof: dict[str, Any]) -> None:
    proof["minors"][-1] = proof["minors"][0]


def _part(proof: dict[str, Any]) -> None:
    proof["minors"][1] = {**proof["minors"][1], "places": ["3/2"]}


def _singular(proof: dict[str, Any]) -> None:
    proof["weights"][1] = proof["weights"][0]


def _negative(proof: dict[str, Any]) -> None:
    proof["minors"][0]["low"] = "-1"


def _other(proof: dict[str, Any]) -> None:
    proof["minors"][0]["expression"] = "7"


def _narrow(proof: dict[str, Any]) -> None:
    box_ = proof["minors"][-1]["box"]
    name = next(iter(box_))
    box_[name] = [box_[name][0], "1/2"]


def _reordered(proof: dict[str, Any]) -> None:
    proof["weights"] = proof["weights"][::-1]


@pytest.mark.parametrize("forge", [_drop, _twice, _part, _singular, _negative, _other, _narrow, _reordered])
@pytest.mark.parametrize("system", [wave, lambda: turning(0.5, 3.2)])
def test_a_forged_one_fails(system: Callable[[], hg.System], forge: Callable[[dict[str, Any]], None]) -> None:
    content = copy.deepcopy(written(system()))
    forge(evidence(content))
    assert findings(content)["phase.inverse"] == "fails"


def test_a_wider_box_of_the_plant_fails() -> None:
    """The proof of an angle up to 3.2, told of one up to 7."""
    content = written(turning(0.5, 3.2))
    text = json.dumps(content).replace('"16/5"', '"7"').replace('"3.2"', '"7"')
    assert text != json.dumps(content)
    assert findings(json.loads(text))["phase.inverse"] == "fails"


def test_a_map_with_kinks_fails() -> None:
    """A slope with a sign in it is a set at a kink, of which the theorem says nothing."""
    content = written(wave())
    chain = next(c for c in content["claims"] if c["id"] == "phase.chain")["evidence"]["chain"]
    chain[0] += " + Abs(x1) - Abs(x1)"
    assert findings(content)["phase.inverse"] == "fails"


@pytest.mark.full
def test_an_input_and_its_derivative_are_whatever_they_are() -> None:
    check = one_to_one(driven())
    assert check.verdict is Verdict.PROVED
    assert findings(written(driven()))["phase.inverse"] == "verified"


def test_more_states_than_are_tried_are_unknown() -> None:
    x = states(*[(-1.0, 1.0)] * 6)
    assert weights([x[i] + sp.sin(x[(i + 1) % 6]) / 9 for i in range(6)], x) is None
    assert len([s for s in subsets(6) if s in {*combinations(range(6), 2)}]) == 15
