"""What a method leaves of a plant with kinks, or in cells of its ranges: known answers, searches, forged evidence."""

import copy
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau
from hgogen.prove.method_error import StageDeviation, lipschitz_remainder
from hgogen.prove.plant_step import PlantStep
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.inequality import Tableau as Rechecked
from hgogen.recheck.inequality import tableau_of
from hgogen.recheck.local_error import _REALISATIONS, _by_steepness, _degree, demand_remainder, lipschitz_error
from hgogen.recheck.matrix import Matrix
from hgogen.recheck.text import expression
from hgogen.recheck.verification import recheck

TABLEAUS = (EULER, HEUN, RK4)
H = Fraction(1, 50)
NAMES = st.sampled_from(["Euler", "Heun", "classical Runge-Kutta"])
SIZES = st.fractions(0, 10, max_denominator=50)


def of(tableau: Rechecked) -> tuple[list[list[Fraction]], list[Fraction], list[Fraction]]:
    """a, its rows as long as b, b and c."""
    s = len(tableau.weights)
    return [[*row, *[Fraction(0)] * (s - len(row))] for row in tableau.rows], tableau.weights, tableau.nodes


@pytest.mark.parametrize(("name", "share"), [("Euler", "1/2"), ("Heun", "1/4"), ("classical Runge-Kutta", "5/36")])
def test_of_a_rate_that_turns_alone_the_kernel_of_the_weights_is_left(name: str, share: str) -> None:
    """x' = F(u), |dF/du| <= 3, |u'| <= 2: h 6 int|K|, by two codes."""
    tableau, steep, moving = tableau_of({"method": name}), [[Fraction(0), Fraction(3)]], [Fraction(0), Fraction(2)]
    known = lipschitz_remainder(H, *of(tableau), steep, moving, [False])
    assert known == (H * 6 * Fraction(share),)
    assert [*known] == lipschitz_error(tableau, H, Matrix(steep), moving, [False])


def test_a_linear_row_reads_what_the_others_leave() -> None:
    """x1' = x2, x2' = F of a rate of at most 4, by Heun: x1 is beside by h^2 4/6 and h^2 4/4, x2 by h 4/4."""
    steep = [[Fraction(0), Fraction(1), Fraction(0)], [Fraction(0), Fraction(0), Fraction(2)]]
    tableau, moving = tableau_of({"method": "Heun"}), [Fraction(9), Fraction(3), Fraction(2)]
    known = lipschitz_remainder(H, *of(tableau), steep, moving, [True, False])
    assert known == (H**2 * 4 * (Fraction(1, 6) + Fraction(1, 4)), H)
    assert [*known] == lipschitz_error(tableau, H, Matrix(steep), moving, [True, False])


@given(
    NAMES,
    st.sampled_from([H, Fraction(2)]),
    st.lists(SIZES, min_size=9, max_size=9),
    st.lists(st.booleans(), min_size=2, max_size=2),
)
def test_two_codes_leave_the_same(name: str, h: Fraction, sizes: list[Fraction], linear: list[bool]) -> None:
    """In short steps, and in long ones, where a linear row is bounded as others are."""
    tableau, steep, moving = tableau_of({"method": name}), [sizes[:3], sizes[3:6]], sizes[6:]
    known = lipschitz_remainder(h, *of(tableau), steep, moving, linear)
    assert known is not None
    assert [*known] == lipschitz_error(tableau, h, Matrix(steep), moving, linear)


def test_of_weights_that_are_not_exact_nothing_is_known() -> None:
    half, one = Fraction(1, 2), [Fraction(1)]
    assert lipschitz_remainder(H, [[Fraction(0)]], [half], [Fraction(0)], [one], one, [False]) is None
    with pytest.raises(Unproved, match="constant"):
        lipschitz_error(Rechecked([[]], [half], 1), H, Matrix([one]), one, [False])
    with pytest.raises(Unproved, match="negative"):
        lipschitz_error(Rechecked([[]], one, 1), H, Matrix([[-half]]), one, [False])


@pytest.mark.parametrize(
    ("text", "degree"),
    [
        ("2*x - y/3 + 1", 1),
        ("a*x + sin(a)", 1),
        ("a**2", 0),
        ("x*y", 2),
        ("1/x", 2),
        ("x**2", 2),
        ("Abs(x)", 2),
        ("-x/a", 1),
        ("x/y", 2),
    ],
)
def test_what_is_shown_to_be_linear(text: str, degree: int) -> None:
    assert _degree(expression(text, {"x", "y", "a"}), {"a"}) == degree


# --- beside the plant -------------------------------------------------------------------------------------------------

Flow = Callable[[Any, Any, Any], Any]
x_, z_, u_ = sp.symbols("x z u", real=True)
PLACES, VALUES = [-2, -1, 0, 1, 2], [-1, 0.5, 0, 1, -1]
CURVE = hg.table(x_, PLACES, VALUES)
FLOWS: Mapping[str, tuple[sp.Expr, ...]] = {
    "modulus": (z_, u_ - z_ * sp.Abs(z_) - 3 * sp.Abs(x_)),
    "saturation": (z_, u_ - sp.Max(-1, sp.Min(1, 5 * z_)) - x_),
    "dead zone": (z_, u_ - 3 * (sp.Max(x_ - sp.Rational(3, 10), 0) + sp.Min(x_ + sp.Rational(3, 10), 0))),
    "table": (z_, u_ - CURVE - z_),
    "pieces": (z_, u_ - sp.Piecewise((x_**2, x_ > 0), (-x_, True)) - z_),
    "saturating": (z_ - x_ / (sp.Abs(x_) + sp.Rational(1, 10)), u_ - z_),
    "rational": (z_ - x_, u_ - z_ / (x_**2 + sp.Rational(1, 5))),
    "exponential": (z_ - x_, u_ - sp.exp(3 * x_) / 20 - z_),
    "root": (z_ - sp.sqrt(x_ + sp.Rational(11, 5)), u_ - z_),
}

KINKED = ("modulus", "saturation", "dead zone", "table", "pieces", "saturating")


def plant_of(name: str) -> hg.System:
    x, z = (hg.Signal(each, low=-2, high=2) for each in ("x", "z"))
    u, known = hg.Signal("u", low=-1, high=1), {}
    known = {x_: x, z_: z, u_: u}
    flow = [row.xreplace(known) for row in FLOWS[name]]
    return hg.System("plant", states=(x, z), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x])


def stepped(flow: Callable[[Any, Any], Any], tableau: Tableau, x: Any, h: float, at: float = 0.0) -> Any:
    """One step of the method from states x (2, B) at a time."""
    slopes: list[Any] = []
    for row, c in zip(tableau.a, tableau.c, strict=True):
        here = x + h * sum(w * k for w, k in zip(row, slopes, strict=True)) if slopes else x
        slopes.append(flow(here, at + c * h))
    return x + h * sum(w * k for w, k in zip(tableau.b, slopes, strict=True))


@pytest.mark.ordinary("modulus-Euler", "modulus-Heun", "saturating-Heun")
@pytest.mark.parametrize("tableau", TABLEAUS, ids=lambda one: one.name)
@pytest.mark.parametrize("name", FLOWS)
def test_no_step_leaves_more_and_one_not_much_less(name: str, tableau: Tableau) -> None:
    """From 4000 points of the ranges, clear of their ends, beside 200 short steps."""
    h, rng, count = 0.05, np.random.default_rng(), 4000
    left = StageDeviation(PlantStep(hg.forms.triangular(plant_of(name)), Fraction(1, 20), (Fraction(2),)), tableau)
    bounds = np.array([[float(x)] for x in left.remainder()])
    clear = np.array([[float(x)] for x in left.plant.margins])
    read = [{CURVE.func.__name__: lambda x: np.interp(x, PLACES, VALUES)}, "numpy"]
    rows = [sp.lambdify((x_, z_, u_), row.rewrite(sp.Abs), read) for row in FLOWS[name]]  # Min and Max take arrays so
    x = rng.uniform(-1, 1, (2, count)) * np.maximum(2 - clear, 0)
    u, rate = rng.uniform(-1, 1, count), rng.choice([-2.0, 2.0], count)

    def flow(x: Any, t: float) -> Any:
        return np.array([row(*x, u + rate * t) + 0 * u for row in rows])

    exact, short = x, h / 200
    for k in range(200):
        exact = stepped(flow, RK4, exact, short, k * short)
    off = np.abs(exact - stepped(flow, tableau, x, h)) / h
    worst = off.max(axis=1, keepdims=True)
    assert (worst <= bounds * (1 + 1 / 100)).all()  # short steps across kinks leave a 200th of it
    if tableau is EULER and name in KINKED:
        assert (worst > bounds / 8).all()


# --- in a certificate -------------------------------------------------------------------------------------------------

METHODS = ("rk4", "heun", "euler", "bilinear", "exponential")


@cache
def certified(name: str, method: str) -> Any:
    form = hg.forms.triangular(plant_of(name))
    observer = hg.observers.high_gain(form, theta=40 if name == "rational" else 16, poles=(-1, -1))
    step = hg.sample(observer, getattr(hg.methods, method), dt=2e-3)
    known = hg.error_bound(step, noise={"y": 1e-3}, rates={"u": 2})
    assert known.check.verdict is Verdict.PROVED, known
    assert max(known.bounds.values()) < 1
    return hg.certificate(form, (*observer.checks, known.check), "high_gain")


def share(content: Any) -> Any:
    """That of the method."""
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    (one,) = (each for each in claim["evidence"]["shares"] if each["inputs"] == "method")
    return one


def found(content: Any) -> str:
    (one,) = (each for each in recheck(sealed(content)).rows if each.id.endswith(".error"))
    return str(one.found)


NAMED = [name for name in FLOWS if name != "pieces"]  # which a certificate has no word for


QUICK = {("table", "exponential"), *(("saturation", method) for method in METHODS)}
EVERY = [
    pytest.param(name, method, marks=() if method == "rk4" or (name, method) in QUICK else pytest.mark.slow)
    for name in NAMED
    for method in METHODS
]


@pytest.mark.ordinary(
    "saturation-heun", "saturation-euler", "saturation-bilinear", "saturation-exponential", "table-rk4"
)
@pytest.mark.parametrize(("name", "method"), EVERY)
def test_what_is_left_is_verified_again(name: str, method: str) -> None:
    content = certified(name, method)
    assert found(content) == "verified"
    follows = share(content)["follows"]
    assert bool(follows["steepness"]) is (name in KINKED)
    if "orders" in follows:
        assert (min(follows["orders"]) == "0") is (name in KINKED)


@pytest.mark.full
def test_a_plant_in_pieces_has_bounds() -> None:
    form = hg.forms.triangular(plant_of("pieces"))
    observer = hg.observers.high_gain(form, theta=16, poles=(-1, -1))
    for method in METHODS:
        step = hg.sample(observer, getattr(hg.methods, method), dt=2e-3)
        assert max(hg.error_bound(step, noise={"y": 1e-3}, rates={"u": 2}).bounds.values()) < 1


@pytest.mark.parametrize("method", ["bilinear", "exponential"])
def test_pieces_that_meet_leave_what_a_maximum_does(method: str) -> None:
    """Whose derivatives are the same, piece by piece, but say nothing of where they meet."""
    left = []
    for kink in (sp.Max(x_, 0), sp.Piecewise((x_, x_ > 0), (0, True))):
        x, z, u = (hg.Signal(str(each), low=-2, high=2) for each in (x_, z_, u_))
        flow = [row.xreplace({x_: x, z_: z, u_: u}) for row in (z_, u_ - 3 * kink - z_)]
        plant = hg.System("plant", states=(x, z), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x])
        observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=12, poles=(-1, -1))
        known = hg.error_bound(hg.sample(observer, getattr(hg.methods, method), dt=1e-2), rates={"u": 2})
        left.append(known.shares["method"]["z"])
    assert left[0] == pytest.approx(left[1], rel=0.02)


def changed(content: Any, path: Sequence[Any], change: Callable[[Any], Any]) -> Any:
    """With another value at a place of the share of the method."""
    content = copy.deepcopy(content)
    holder = share(content)
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = change(holder[path[-1]])
    return content


def less(value: str) -> str:
    assert Fraction(value) > 0
    return str(Fraction(value) * Fraction(99, 100))


def tiny(value: str) -> str:
    assert Fraction(value) > 0
    return str(Fraction(value) / 10**6)


STEEP = ("follows", "steepness")


@pytest.mark.parametrize("method", METHODS)
def test_a_plant_that_is_steeper_than_its_evidence_fails(method: str) -> None:
    """Of x' = z, z' = u - sat(5 z) - x, by each of its slopes; of a realised core those of the rest as well."""
    content, explicit = certified("saturation", method), method in ("rk4", "heun", "euler")
    places = [(0, 1), (1, 0), (1, 1), (1, 2)] if explicit else [(0, 0, 1), (0, 1, 1), (0, 1, 2), (1, 1, 1), (1, 1, 0)]
    for place in places:
        forged = changed(content, (*STEEP, *place), less)
        assert found(forged) == "fails", place
        assert found(changed(forged, ("beside", 0) if explicit else ("fields", 0), lambda x: x)) == "fails"


@pytest.mark.parametrize(
    ("path", "change"),
    [
        (STEEP, lambda rows: []),
        (STEEP, lambda rows: rows[:1]),
        ((*STEEP, 0, 0), lambda x: "-1"),
        (("beside", 0), less),
        (("beside", 1), less),
        (("follows", "speeds", 0), less),
        (("follows", "orders", 0), lambda order: "1"),
        (("follows", "orders", 1), lambda order: "4"),
        (("follows", "orders"), lambda orders: orders[:1]),
        (("follows", "lines", 0), lambda row: ["0", "0"]),
    ],
)
def test_other_evidence_of_a_kink_fails(path: Sequence[Any], change: Callable[[Any], Any]) -> None:
    """By another order, less steepness or none, or a line whose third coefficients it has not."""
    assert found(changed(certified("saturation", "rk4"), path, change)) == "fails"


@pytest.mark.parametrize(("key", "value"), [("flow", ["0", "0"]), ("rest", [["0", "0"]])])
def test_of_a_realised_core_derivatives_or_steepness_are_said(key: str, value: Any) -> None:
    assert found(changed(certified("saturation", "bilinear"), ("follows", key), lambda empty: value)) == "fails"


def test_without_steepness_a_realised_core_has_no_derivatives_at_a_kink() -> None:
    content = changed(certified("saturation", "exponential"), STEEP, lambda rows: [])
    for key, value in (("flow", ["99", "99"]), ("rest", [["99", "99"], ["999", "999"]])):
        content = changed(content, ("follows", key), lambda empty, value=value: value)
    assert found(content) == "fails"


@pytest.mark.parametrize("order", ["-1", "3", "3/2"])
def test_an_order_is_one_of_the_method(order: str) -> None:
    tableau, n = tableau_of({"method": "Heun"}), 2
    context: Any = SimpleNamespace(z=["x"] * n, file=SimpleNamespace(inputs=[]), form=SimpleNamespace(output=[None]))
    follows = {"rates": [], "speeds": ["1"] * n, "slopes": [["1"] * n], "lines": [], "orders": ["1", order]}
    share = {"follows": {**follows, "flow": [], "step": [], "steepness": [], "tree": "."}}
    with pytest.raises(Unproved, match="its orders is none of 0 to 2"):
        demand_remainder(context, tableau, H, share)


@pytest.mark.parametrize(("name", "second"), [("the bilinear rule", True), ("the matrix exponential", False)])
def test_what_stands_for_a_second_derivative_of_a_realised_core(name: str, second: bool) -> None:
    """4/h times the first: of the flow by the bilinear rule, of the rest by the matrix exponential."""
    x, u = "x", "u"
    context: Any = SimpleNamespace(z=[x], file=SimpleNamespace(inputs=[u]), rates=(), form=SimpleNamespace(b=()))
    motion: Any = SimpleNamespace(context=context, h=H, speeds=[Fraction(3)], rates=[Fraction(2)])
    steep = [[["1", "2"]], [["0", "5"]]]
    flow, rest, _ = _by_steepness(motion, {"flow": [], "rest": [], "steepness": steep}, _REALISATIONS[name])
    assert flow == [7 * (4 / H if second else 1)]
    assert rest == [[10]] if second else [[10], [40 / H]]


# --- in cells ---------------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_the_ranges_of_a_rational_flow_are_cut() -> None:
    content = certified("rational", "rk4")
    tree = share(content)["follows"]["tree"].split()
    assert tree.count(".") > 2
    assert set(tree) <= {".", "z1", "z2", "u"}


@pytest.mark.ordinary("path0-<lambda>", "path12-tiny", "path14-less")
@pytest.mark.parametrize(
    ("path", "change"),
    [
        (("follows", "tree"), lambda tree: tree.removesuffix(" .")),
        (("follows", "tree"), lambda tree: f"{tree} ."),
        (("follows", "tree"), lambda tree: tree.replace("z1", "w", 1)),
        (("follows", "tree"), lambda tree: ""),
        (("follows", "tree"), lambda tree: None),
        (("follows", "orders", 1), lambda order: str(int(order) - 1)),
        (("follows", "orders", 1), lambda order: "5"),
        (("follows", "orders", 1), lambda order: "3/2"),
        (("follows", "orders", 1), lambda order: "0"),
        (("follows", "orders", 1), lambda order: "-1"),
        (("follows", "flow", 1), tiny),
        (("follows", "step", 1), tiny),
        (("follows", "lines", 0, 0), tiny),
        (STEEP, lambda none: [["9", "9", "9"], ["99", "99", "9"]]),
        (("beside", 1), less),
    ],
)
def test_other_evidence_of_cells_fails(path: Sequence[Any], change: Callable[[Any], Any]) -> None:
    """A cell that is missing, or one more, another order, or less than a coefficient is there."""
    assert found(changed(certified("rational", "rk4"), path, change)) == "fails"


def test_a_lower_order_whose_coefficients_are_said_to_be_small_fails() -> None:
    """As small as the sizes need: of x2'' as if it were the derivative of that order."""
    content = certified("rational", "rk4")
    order = int(share(content)["follows"]["orders"][1])
    forged = changed(content, ("follows", "orders", 1), lambda each: "1")
    for key in ("flow", "step"):
        forged = changed(forged, ("follows", key, 1), lambda most: str(Fraction(most) / 500 ** (order - 1)))
    assert found(forged) == "fails"
