"""That what a realised core leaves follows from a plant: integrals, derivatives, known answers, and forged numbers."""

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from scipy.integrate import trapezoid
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Verdict
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.inequality import POLYNOMIAL_ERROR, REALISED
from hgogen.recheck.local_error import _REALISATIONS, CoreStep, _demand_chain
from hgogen.recheck.matrix import Matrix, core_integral, unit
from hgogen.recheck.plant_motion import Derivative, PlantMotion, demand_derivatives
from hgogen.recheck.text import expression
from hgogen.recheck.verification import recheck

BILINEAR, EXPONENTIAL = _REALISATIONS


def exactly(rows: Sequence[Sequence[float]]) -> Matrix:
    return Matrix([[Fraction(x) for x in row] for row in rows])


# --- the integral -----------------------------------------------------------------------------------------------------

CORES: Mapping[str, Any] = {
    "one pole": ([[-20]], 0.02),
    "slow": ([[-0.5]], 0.25),
    "fast": ([[-30]], 1),
    "a chain": ([[-2, 1, 0], [-3, 0, 1], [-1, 0, 0]], 1),
    "turning": ([[0, 5], [-5, 0]], 1),
    "in uneven units": ([[-1, 1e6], [-1e-6, -1]], 1),
    "growing": ([[1, 2], [0, 3]], 0.5),
}


@pytest.mark.parametrize("name", CORES)
def test_the_integral_is_from_above_and_not_far(name: str) -> None:
    rows, h = CORES[name]
    L, own = exactly(rows), unit(len(rows))
    known, core = core_integral(L, Fraction(h), own), np.array(rows, dtype=float)
    s = np.linspace(0, h, 4001)
    sizes = np.abs(expm(s[:, None, None] * core)) * (s * (h - s) / 2)[:, None, None]
    whole = trapezoid(sizes, s, axis=0)
    assert (whole * (1 - 1e-5) <= np.array(known.rows, dtype=float)).all()
    assert (np.array(known.rows, dtype=float) <= 1.02 * whole + 1e-5).all()


def test_of_no_core_it_is_a_twelfth() -> None:
    ((one,),) = core_integral(exactly([[0]]), Fraction(2), exactly([[-3]]))
    assert float(one) == pytest.approx(2, rel=1e-15)


def test_a_core_that_turns_too_far_is_not_shown() -> None:
    with pytest.raises(Unproved, match="too fast"):
        core_integral(exactly([[-65]]), Fraction(1), exactly([[1]]))


# --- sizes by hand ----------------------------------------------------------------------------------------------------


def at_core(method: str, slope: int, **beside: Any) -> CoreStep:
    """A step of length 1 of one field, L = -2 by the bilinear rule and 0 by the exponential."""
    L = exactly([[-2 if method == BILINEAR else 0]])
    parts: Any = SimpleNamespace(L=L, M=exactly([[L[0][0] + slope]]), G=exactly([[2]]), H=exactly([[-1]]))
    return CoreStep(
        parts, Fraction(1), REALISED[method](L), exactly([[-1]]), exactly([[5]]), exactly([[12]])[0], **beside
    )


def test_the_bilinear_rule_by_hand() -> None:
    """phi_1 = 1/2, phi_2 = 1/4: alpha = 12/24; a is beside by alpha + 8/4, and slopes of 1 + 2 make of it 3 of that."""
    step = at_core(BILINEAR, -1, nonlinear=exactly([[8]]))
    alpha = _REALISATIONS[BILINEAR].alpha(step)
    assert alpha == [[Fraction(1, 2)]]
    assert step.total(alpha) == [Fraction(1, 2) + Fraction(3, 4) * (Fraction(1, 2) + 2)]


def test_the_matrix_exponential_by_hand() -> None:
    """A twelfth of 5 * 12 + 24, and what the program's polynomials leave."""
    step = at_core(EXPONENTIAL, 0, nonlinear=exactly([[8], [24]]))
    ((alpha,),) = _REALISATIONS[EXPONENTIAL].alpha(step)
    assert 7 + 12 * POLYNOMIAL_ERROR <= alpha < 7 + 12 * POLYNOMIAL_ERROR + Fraction(1, 2**60)
    assert float(step.total(exactly([[alpha]]))[0]) == pytest.approx(7 + 2 / 2 * (7 + 8 / 2))


def test_the_exponential_counts_what_its_polynomials_may_be_beside_it() -> None:
    step = at_core(EXPONENTIAL, 0, nonlinear=exactly([[8], [0]]))
    assert step.total(exactly([[0]]))[0] > 4


def test_a_core_that_is_not_the_plants_chain_is_not_shown() -> None:
    """L s + B C = s A of s = 1, A = 0, where B C = 2."""
    number: Any = SimpleNamespace(value=lambda entry: SimpleNamespace(number=entry))
    number.form = SimpleNamespace(A=[[Fraction(0)]])
    one, two = exactly([[1]]), exactly([[2]])

    def parts(L: int) -> Any:
        return SimpleNamespace(L=exactly([[L]]))

    _demand_chain(number, parts(-2), one, two)
    with pytest.raises(Unproved, match="is not the plant's chain"):
        _demand_chain(number, parts(-3), one, two)
    number.form.A = [[None]]
    with pytest.raises(Unproved, match="moves"):
        _demand_chain(number, parts(-2), one, two)


# --- derivatives ------------------------------------------------------------------------------------------------------


def motion(flow: Mapping[str, str], box: Mapping[str, tuple[int, int]], **rates: int) -> PlantMotion:
    rows = tuple(expression(text, box) for text in flow.values())
    ends = {name: (Fraction(low), Fraction(high)) for name, (low, high) in box.items()}
    context: Any = SimpleNamespace(
        rates=rows, z=tuple(flow), form=SimpleNamespace(box=ends), file=SimpleNamespace(inputs=tuple(rates))
    )
    return PlantMotion(context, Fraction(1), [Fraction(rate) for rate in rates.values()], [])


SWING = motion({"q": "w", "w": "u - 3*sin(q)"}, {"q": (-1, 1), "w": (-2, 2), "u": (-1, 1), "p": (3, 3)}, u=5)
AT = np.linspace(0, 1, 10**5)
# w' = u - 3 sin q, w'' = u' - 3 w cos q, w''' = 3 w^2 sin q - 3 cos q (u - 3 sin q)
LARGEST = {
    ("q", 1): 2,
    ("u - 3*sin(q)", 0): 1 + 3 * np.sin(1),
    ("u - 3*sin(q)", 1): 5 + 6,
    ("p*u", 1): 15,
    ("-(u**2)", 2): 50,
    ("q*w", 1): 4 + np.max(AT - 3 * AT * np.sin(AT)),  # w^2 + q (u - 3 sin q)
    ("sin(q)", 2): np.sin(1) * 4 + np.cos(1) * (1 + 3 * np.sin(1)),
    ("Max(-9 - q, q)", 1): 2,
    ("Abs(q + 2)", 1): 2,
}


@pytest.mark.parametrize(("text", "order"), LARGEST)
def test_the_largest_derivative_is_shown_and_no_less(text: str, order: int) -> None:
    row, most = expression(text, SWING.context.form.box), Fraction(LARGEST[text, order])
    demand_derivatives(SWING, [Derivative(row, order, most * Fraction(101, 100))])
    with pytest.raises(Unproved):
        demand_derivatives(SWING, [Derivative(row, order, most * Fraction(99, 100))])


def test_the_third_derivative_of_a_swing_is_its_largest_anywhere() -> None:
    rng = np.random.default_rng(0)
    q, w, u = rng.uniform(-1, 1, 10**6), rng.uniform(-2, 2, 10**6), rng.uniform(-1, 1, 10**6)
    most = float(np.abs(3 * w**2 * np.sin(q) - 3 * np.cos(q) * (u - 3 * np.sin(q))).max())
    row = SWING.context.rates[1]
    demand_derivatives(SWING, [Derivative(row, 2, Fraction(most * 1.01))])
    with pytest.raises(Unproved):
        demand_derivatives(SWING, [Derivative(row, 2, Fraction(most * 0.98))])


def test_an_input_moves_at_up_to_its_rate_both_ways() -> None:
    """(x - u)' = 1 - u' is 6 at u' = -5, and (x + u)' at 5."""
    plain = motion({"x": "u + 1 - u"}, {"x": (0, 1), "u": (0, 1)}, u=5)
    for text in ("x - u", "x + u"):
        one = Derivative(expression(text, {"x", "u"}), 1, Fraction("6.01"))
        demand_derivatives(plain, [one])
        with pytest.raises(Unproved):
            demand_derivatives(plain, [replace(one, most=Fraction("5.99"))])


def test_where_it_is_too_large_is_on_the_face_towards_which_it_grows() -> None:
    """(3 u + q)' = 3 u' + w is 17 at most."""
    one = Derivative(expression("3*u + q", {"u", "q"}), 1, Fraction("16.9"))
    with pytest.raises(Unproved, match=r"it does not hold at .* w = -2, u' = -5"):
        demand_derivatives(SWING, [one])


def test_of_a_kink_there_is_none() -> None:
    with pytest.raises(Unproved):
        demand_derivatives(SWING, [Derivative(expression("Abs(q)", {"q"}), 1, Fraction(100))])


# --- in a certificate -------------------------------------------------------------------------------------------------

Content = dict[str, Any]
METHODS = ("bilinear", "exponential")


@cache
def _certified(method: str, tuning: str, shape: str) -> str:
    """Of two states, half the first of which is measured, and of two chains for the circle criterion; u moves at up to
    5."""
    x1, x2, u = (hg.Signal(name, low=-most, high=most) for name, most in (("x1", 1), ("x2", 2), ("u", 1)))
    pull = {
        "swing": sp.sin(3 * x1) + x2 / 4,
        "line": hg.table(x1, [-5, 5], [-1, 1]) + x2 / 4,
        "curve": hg.table(x1, [-3, -1.5, 1.5, 3], [-2, -1, 1, 2.5], kind="monotone") + x2 / 4,
        "map": hg.table((x1, x2), ([-5, -2, 2, 5], [-9, -6, 6]), [[0, 0, 0], [0, -2, 4], [0, 3, -1], [0, 9, 0]]),
    }
    flow, output = [x2, u - pull[shape]], [x1 / 2]
    plant = hg.System("plant", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=output)
    form = hg.forms.triangular(plant)
    poles = {} if tuning == "peaking_free" else {"poles": (-1, -1)}
    observer = getattr(hg.observers, tuning)(form, theta=12, **poles)
    known = hg.error_bound(hg.sample(observer, getattr(hg.methods, method), dt=0.01), noise={"y": 1e-3}, rates={"u": 5})
    assert known.check.verdict is Verdict.PROVED, known
    return json.dumps(hg.certificate(form, (*observer.checks, known.check), tuning))


def certified(method: str, tuning: str = "high_gain", shape: str = "swing") -> Content:
    content: Content = json.loads(_certified(method, tuning, shape))
    return content


def method_share(content: Content) -> Any:
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    (share,) = (each for each in claim["evidence"]["shares"] if each["inputs"] == "method")
    return share


def row(content: Content) -> Any:
    (one,) = (each for each in recheck(sealed(content)).rows if each.id.endswith(".error"))
    return one


@pytest.mark.ordinary(
    "circle_criterion-swing-0.02-bilinear",
    "peaking_free-swing-0.02-exponential",
    "high_gain-line-0.017-exponential",
    "high_gain-curve-0.02-exponential",
    "high_gain-map-0.02-exponential",
)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("tuning", "shape", "clear"),
    [
        *((tuning, "swing", "0.02") for tuning in ("high_gain", "circle_criterion", "peaking_free")),
        *(("high_gain", shape, clear) for shape, clear in (("line", "0.017"), ("curve", "0.02"), ("map", "0.02"))),
    ],
)
def test_what_a_realised_core_leaves_is_verified_again(method: str, tuning: str, shape: str, clear: str) -> None:
    one = row(certified(method, tuning, shape))
    assert one.found == "verified", one.sentence
    assert "what the method leaves as u moves at up to 5 move" in one.sentence
    assert f"while the plant keeps clear of the ends of its ranges by 0.0200001 in z1, {clear}" in one.sentence


LIES = (
    *((("fields", i), "9/10") for i in (0, 1)),
    *((("follows", "speeds", i), "99/100") for i in (0, 1)),
    *((("follows", key, 0), "-1") for key in ("rates", "speeds", "flow")),
    *((("follows", "flow", i), factor) for i, factor in ((0, "98/100"), (1, "98/100"), (0, "3/2"))),
    *((("follows", "rest", 0, 1), factor) for factor in ("98/100", "10")),
    (("follows", "rates", 0), "6"),
)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("path", "factor"), LIES)
def test_a_forged_number_of_the_share_fails(path: Sequence[Any], factor: str, method: str) -> None:
    content = certified(method)
    _forge(method_share(content), path, factor)
    assert row(content).found == "fails"


@pytest.mark.parametrize(
    ("method", "key", "place"),
    [("exponential", "rest", (1, 1)), ("bilinear", "flow", (1,)), ("exponential", "flow", (0,))],
)
@pytest.mark.parametrize("factor", ["98/100", "10"])
def test_a_forged_derivative_of_the_method_fails(method: str, key: str, place: tuple[int, ...], factor: str) -> None:
    content = certified(method)
    _forge(method_share(content), ("follows", key, *place), factor)
    assert row(content).found == "fails"


def _forge(holder: Any, path: Sequence[Any], factor: str) -> None:
    for key in path[:-1]:
        holder = holder[key]
    assert Fraction(holder[path[-1]]) > 0
    holder[path[-1]] = str(Fraction(holder[path[-1]]) * Fraction(factor))


@pytest.mark.parametrize("method", METHODS)
def test_a_smaller_share_and_what_it_follows_from_fail_together(method: str) -> None:
    content = certified(method)
    share = method_share(content)
    follows = share["follows"]
    for rows in (share["fields"], follows["flow"], *follows["rest"]):
        rows[:] = [str(Fraction(x) * Fraction(97, 100)) for x in rows]
    assert row(content).found == "fails"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("key", ["rates", "speeds", "flow", "rest"])
def test_what_is_left_out_fails(method: str, key: str) -> None:
    content = certified(method)
    del method_share(content)["follows"][key]
    assert row(content).found == "fails"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("nothing", [{}, None])
def test_a_share_that_follows_from_nothing_fails(method: str, nothing: Any) -> None:
    content = certified(method)
    method_share(content)["follows"] = nothing
    assert row(content).found == "fails"


def test_one_method_does_not_pass_for_the_other() -> None:
    content, other = certified("exponential"), copy.deepcopy(method_share(certified("bilinear")))
    method_share(content)["follows"] = other["follows"]
    assert row(content).found == "fails"


# --- of a plant with a table ------------------------------------------------------------------------------------------

OF_TABLES = (
    *((("fields", i), "9/10") for i in (0, 1)),
    *((("follows", "speeds", i), "1/2") for i in (0, 1)),
    *((("follows", "flow", i), factor) for i, factor in ((0, "1/8"), (1, "1/8"), (0, "3/2"))),
    *((("follows", "rest", 0, 1), factor) for factor in ("1/8", "10")),
)


@pytest.mark.ordinary(
    "path0-9/10-map-bilinear",
    "path2-1/2-curve-bilinear",
    "path4-1/8-curve-exponential",
    "path6-3/2-map-bilinear",
    "path7-1/8-curve-bilinear",
    "path8-10-map-bilinear",
)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", ["curve", "map"])
@pytest.mark.parametrize(("path", "factor"), OF_TABLES)
def test_a_forged_number_fails_with_a_table_too(path: Sequence[Any], factor: str, shape: str, method: str) -> None:
    content = certified(method, shape=shape)
    _forge(method_share(content), path, factor)
    assert row(content).found == "fails"


@pytest.mark.ordinary("nothing-exponential", "another plant's-bilinear")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("follows", ["nothing", "another plant's"])
def test_with_a_table_a_share_follows_from_its_own_plant(method: str, follows: str) -> None:
    content = certified(method, shape="line")
    method_share(content)["follows"] = {} if follows == "nothing" else method_share(certified(method))["follows"]
    assert row(content).found == "fails"


@pytest.mark.parametrize("method", METHODS)
def test_a_table_that_is_read_across_a_point_fails(method: str) -> None:
    """Where its slope falls from 1/5 to 1/10, so that the plant is no steeper, but bends in no time."""
    text = _certified(method, "high_gain", "line")
    assert text.count("-5, -1, 5, 1)") == 2  # in the plant and in the form
    known = recheck(sealed(json.loads(text.replace("-5, -1, 5, 1)", "-5, -1, 0, 0, 5, 1/2)"))))
    assert {each.id for each in known.rows if each.found != "verified"} == {"high_gain.error"}
