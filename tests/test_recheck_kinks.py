"""Slopes through kinks, verified again: known ranges, what jumps, and certificates of plants that have them."""

import json
import math
from fractions import Fraction
from functools import cache
from typing import Any

import pytest
import sympy as sp
from forger import sealed
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.certificates.certificate import certificate, stated
from hgogen.recheck.algebra import Algebra
from hgogen.recheck.arithmetic import Dual, Undefined, Unproved, dual, evaluate, fractions
from hgogen.recheck.box import Box, covered, demand_continuous, demand_jacobian, in_ranges, norm_at_most
from hgogen.recheck.interval import between, intervals, point
from hgogen.recheck.text import expression
from hgogen.recheck.verification import recheck

F = Fraction
BOX: Box = {"v": (F(-1), F(2)), "z": (F(1), F(3))}  # no bisection of the first has 0 among its ends
MARGIN = F(1, 10**6)


def shown(row: str, name: str, low: Fraction, high: Fraction, box: Box = BOX) -> bool:
    """Whether the slope of a row is shown to be in a range."""
    statement = in_ranges([expression(row, box)], [name], {(0, 0): (low, high)})
    try:
        return covered(box, ".", statement) > 0
    except Unproved:
        return False


# The row, the name, and the least and the largest of its slopes on the box; at a kink these are sets.
KNOWN: dict[str, tuple[str, str, Fraction, Fraction]] = {
    "a modulus": ("Abs(v)", "v", F(-1), F(1)),
    "a drag": ("v*Abs(v)", "v", F(0), F(4)),
    "a product with what is monotone": ("z*Abs(v)", "v", F(-3), F(3)),
    "its other slope": ("z*Abs(v)", "z", F(0), F(2)),
    "a quotient": ("Abs(v)/z**2", "v", F(-1), F(1)),
    "the other slope of a quotient": ("Abs(v)/z**2", "z", F(-4), F(0)),
    "a kink across the box": ("(v - z)*Abs(v - z) + 1/z**2", "z", F(-8) - F(2, 27), F(-1, 4)),
    "a kink of a kink": ("Abs(Abs(v) - 1/2)", "v", F(-1), F(1)),
    "a modulus of what has one sign": ("Abs(z)*v", "z", F(-1), F(2)),
    "a maximum": ("Max(v, 0)**2/z", "v", F(0), F(4)),
    "a minimum of both names": ("Min(v, z)", "v", F(0), F(1)),
    "a maximum that is known": ("Max(2*z, v)*v", "z", F(-2), F(4)),
    "a maximum of three": ("Max(v, 0, 3*v - 3)", "v", F(0), F(3)),
}


@pytest.mark.parametrize("known", KNOWN)
def test_a_slope_is_in_the_hull_of_those_beside_a_kink(known: str) -> None:
    row, name, low, high = KNOWN[known]
    assert shown(row, name, low - MARGIN, high + MARGIN)
    assert not shown(row, name, low + MARGIN, high + MARGIN)
    assert not shown(row, name, low - MARGIN, high - MARGIN)


def test_at_the_edge_of_a_range_a_slope_is_that_from_within() -> None:
    assert shown("Abs(v)", "v", F(1), F(1), {"v": (F(0), F(2))})
    assert shown("Abs(v)", "v", F(-1), F(-1), {"v": (F(-2), F(0))})
    assert not shown("Abs(v)", "v", F(1), F(1), {"v": (F(-1, 10**9), F(2))})


ROWS = (
    *("Abs(v)*z + v", "Abs(v - z)/z", "v*Abs(v)*z - Abs(z - 2)*v", "Max(v, z - 2)*z", "Min(v*z, 1) - Abs(v)"),
    *("Abs(v*z - 1)*Abs(v)", "Max(Abs(v), z/2)**3", "Min(v, z - 2, v*v)", "Abs(Max(v, 0) - z/3)/(z + Abs(v))"),
)
SHARE = st.fractions(0, 1, max_denominator=40)


@pytest.mark.full
@settings(deadline=None, max_examples=300)
@given(st.sampled_from(ROWS), st.sampled_from(("v", "z")), *[st.tuples(SHARE, SHARE).map(sorted)] * 2, *[SHARE] * 3)
def test_no_rise_of_a_row_is_beyond_what_is_shown_of_its_slope(
    row: str, name: str, v: list[Fraction], z: list[Fraction], at: Fraction, first: Fraction, last: Fraction
) -> None:
    """What the row rises by between two points, over the way, is a slope between them: a range without it is false."""
    box = {"v": (3 * v[0] - 1, 3 * v[1] - 1), "z": (1 + 2 * z[0], 1 + 2 * z[1])}
    inside = {key: [low + share * (high - low) for share in (at, first, last)] for key, (low, high) in box.items()}
    text, (rest, a, b) = expression(row, box), (0, 1, 2)
    assume(inside[name][a] != inside[name][b])
    ends = [
        evaluate(text, {key: x[k if key == name else rest] for key, x in inside.items()}, fractions) for k in (a, b)
    ]
    rise = (ends[1] - ends[0]) / (inside[name][b] - inside[name][a])
    for low, high in ((rise + MARGIN, math.inf), (-math.inf, rise - MARGIN)):
        assert not in_ranges([text], [name], {(0, 0): (low, high)})(box).holds


JUMPS = ("sign(v)", "z*sign(v)", "sign(v)**2", "sign(v - z)", "Abs(sign(v))", "Linear(v, 1, -2, 0, 0, 1, 2, 3)*z")


@pytest.mark.parametrize("row", JUMPS)
def test_no_bound_is_shown_of_what_jumps(row: str) -> None:
    with pytest.raises((Unproved, Undefined)):
        demand_jacobian([expression(row, BOX)], ["v"], [[F(10**9)]], [F(1)], BOX)


def test_what_jumps_with_another_name_bends_with_neither() -> None:
    row = expression("v*sign(z - 2)", BOX)
    assert demand_jacobian([row], ["v"], [[F(1)]], [F(1)], BOX)
    with pytest.raises(Unproved):
        demand_jacobian([row], ["v"], [[F(9, 10)]], [F(1)], BOX)
    with pytest.raises(Unproved):
        demand_jacobian([row], ["v"], [[F(9, 10)]], [F(1)], {**BOX, "z": (F(2), F(3))})


def test_a_breakpoint_at_an_edge_is_of_both_pieces() -> None:
    """The slope of a table is one number within a piece, and monotone there: not that of the piece before."""
    row = "Linear(v, 0, -1, 0, 0, 1, 2, 7)*z"
    box: Box = {"v": (F(0), F(2)), "z": (F(1), F(3))}
    demand_continuous([expression(row, box)], ["v"], box)
    assert shown(row, "v", F(1), F(9), box)
    assert not shown(row, "v", F(1), F(9) - MARGIN, box)


@pytest.mark.parametrize("drag", ["v*Abs(v)", "Max(v, 0)**2"])
def test_a_norm_is_shown_through_a_kink(drag: str) -> None:
    """|db/dz|^2 is largest at z = 1, v = 2: 16^2 + 1."""
    rows = [expression(text, BOX) for text in ("z/4", f"-({drag})/4 - 8/z**2")]
    for square, true in ((F(258), True), (F(256), False)):
        bound = F(math.isqrt(int(square * 10**8)), 10**4)
        try:
            assert (covered(BOX, ".", norm_at_most(rows, ["z", "v"], bound), 400) > 0) is true
        except Unproved:
            assert not true


def test_the_slope_of_a_side_is_nothing_or_anything() -> None:
    x = Dual(Dual(between(-1, 2), {0: point(F(1))}), {0: Dual(point(F(1)), {})})
    bent = dual(dual(intervals)).function("Abs", (x,)).slopes[0]
    assert bent.value == between(-1, 1)
    assert not bent.slopes[0].finite
    known = Dual(Dual(between(0, 2), {0: point(F(1))}), {0: Dual(point(F(1)), {})})
    assert dual(dual(intervals)).function("Abs", (known,)).slopes[0] == Dual(point(F(1)), {0: point(F(0))})


def test_a_side_has_no_slope_in_closed_form() -> None:
    algebra = Algebra(["x"])
    x = Dual(Dual(algebra.names["x"], {0: algebra.number(F(1))}), {0: Dual(algebra.number(F(1)), {})})
    with pytest.raises(Undefined):
        dual(dual(algebra.arithmetic)).function("Abs", (x,))


# --- certificates ---------------------------------------------------------------------------------------------------

DRAGS = {
    "a drag by the square": lambda v: v * sp.Abs(v),
    "a friction without a jump": lambda v: sp.Abs(v - sp.Rational(1, 3)),
    "a valve": lambda v: sp.Max(v, 0) ** 2,
}


@cache
def levitated(drag: str) -> str:
    """z' = v, v' = 9 - 8/z^2 - drag/4 + u, y = z, with a high gain."""
    z, v, u = (hg.Signal(name, low=low, high=high) for name, low, high in (("z", 1, 3), ("v", -2, 2), ("u", -1, 1)))
    flow = [v, 9 - 8 / z**2 - DRAGS[drag](v) / 4 + u]
    plant = hg.System("levitated", states=(z, v), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[z])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=60, poles=(-1, -1))
    return json.dumps(certificate(observer.form, observer.checks, observer.name))


def findings(content: dict[str, Any]) -> dict[str, str]:
    return {row.id: row.found for row in recheck(sealed(content)).rows}


@pytest.mark.parametrize("drag", DRAGS)
def test_what_is_proved_beside_a_pole_is_verified(drag: str) -> None:
    content = json.loads(levitated(drag))
    assert not stated(content)
    assert findings(content)["high_gain.theta"] == "verified"


@pytest.mark.parametrize("drag", DRAGS)
@pytest.mark.parametrize(("k", "end"), [(0, "high"), (1, "low"), (1, "high")], ids=str)
def test_a_narrower_range_of_a_slope_is_refused(drag: str, k: int, end: str) -> None:
    """db_2/dz is at most 16 in z, and in v at least -1, or from -1/4 to 1/4."""
    content = json.loads(levitated(drag))
    (claim,) = [claim for claim in content["claims"] if claim["id"] == "high_gain.convergence"]
    slope = claim["evidence"]["slopes"][k]
    ends = {key: F(slope[key]) for key in ("low", "high")}
    slope[end] = str(ends[end] + (ends["high"] - ends["low"]) / 100 * (1 if end == "low" else -1))
    assert findings(content)["high_gain.convergence"] == "fails"


@pytest.mark.parametrize("new", ["sign(z2)", "z1*sign(z2)", "sign(z2)**2", "Abs(z2)**(1/2)"])
def test_a_jump_or_a_steep_end_in_the_place_of_a_kink_is_refused(new: str) -> None:
    """In the plant as well, so that the form is the plant's."""
    content = json.loads(levitated("a drag by the square"))
    for part, name in (("plant", "v"), ("form", "z2")):
        row = {"plant": "flow", "form": "b"}[part]
        content[part][row] = [text.replace(f"{name}*Abs({name})", _renamed(new, part)) for text in content[part][row]]
    verdicts = findings(content)
    assert verdicts["triangular.structure"] == "verified"
    assert {verdicts[id] for id in ("triangular.lipschitz", "high_gain.convergence", "high_gain.theta")} == {"fails"}


def _renamed(text: str, part: str) -> str:
    return text if part == "form" else text.replace("z2", "v").replace("z1", "z")
