"""Kinks: slopes there are sets, sides that the box decides are taken, and the oracle of zeros; attacked by samples."""

import json
from fractions import Fraction
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from form_answers import check, verdicts
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen import forms
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.hypotheses import nonzero_slope, positive
from hgogen.certificates.certificate import certificate
from hgogen.check import ClaimId, Verdict
from hgogen.emit.pygraph import evaluated
from hgogen.emit.syntax import DTYPE
from hgogen.recheck.verification import recheck
from hgogen.rigor.bounds import Cause, bound, nonzero
from hgogen.rigor.field import is_zero
from hgogen.rigor.series import values
from hgogen.rigor.singular import as_computed, one_sided
from hgogen.rigor.slope import lipschitz_bound
from hgogen.rigor.tape import Direction, slope, tape, with_norms

x, y, z = sp.symbols("x y z", real=True)
ONE = (Fraction(-1), Fraction(1))
HALF = sp.Rational(1, 2)
SATURATED = sp.Piecewise((-HALF, x < -HALF), (HALF, x > HALF), (x, True))


def plant(row: Any, low: float = -1, high: float = 1) -> hg.System:
    """x1' = row(x1, x2, u), x2' = -x2, y = x1."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=low, high=high)
    u = hg.Signal("u", low=-1, high=1)
    flow = [row(x1, x2, u), -x2]
    return hg.System("kink", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])


# --- at the edge of the box only the inner side counts


@pytest.mark.parametrize(
    "row",
    [
        lambda v: sp.sqrt(v**2),
        sp.Abs,
        lambda v: sp.Max(v, -v),
        lambda v: v * sp.sign(v),
        lambda v: sp.Piecewise((v, v > 0), (-v, True)),
    ],
)
@pytest.mark.parametrize(("low", "high"), [(0, 1), (-1, 0)])
def test_a_side_that_the_box_decides_is_taken(row: Any, low: float, high: float) -> None:
    made = plant(lambda _, x2, u: row(x2), low, high)
    assert set(verdicts(forms.triangular(made)).values()) == {"proved"}
    assert set(verdicts(forms.uniform(made)).values()) == {"proved"}
    assert {one.verdict for one in hg.singularity(made).checks} == {Verdict.PROVED}


@pytest.mark.parametrize(
    ("row", "sides", "at"),
    [
        (sp.Abs, "from -1 to 1", 0),
        (lambda v: sp.Max(v, -v), "from -1 to 1", 0),
        (lambda v: sp.Min(v, 1 - 3 * v), "from 1 to -3", Fraction(1, 4)),
        (lambda v: sp.Piecewise((2 * v, v > 0), (-v, True)), "from -1 to 2", 0),
        (lambda v: 3 * v * sp.sign(v) + v, "from -2 to 4", 0),
    ],
)
def test_a_slope_that_jumps_over_zero_is_not_said_to_vanish(row: Any, sides: str, at: Fraction) -> None:
    claim = check(forms.uniform(plant(lambda _, x2, u: row(x2))), "slope_2")
    assert claim.verdict is Verdict.REFUTED
    assert "jumps" in str(claim.reason)
    assert "vanishes" not in str(claim.reason)
    one, other = sides.split()[1::2]
    assert f"{one} to {other}" in str(claim.reason) or f"{other} to {one}" in str(claim.reason)
    assert claim.witness == {"x2": float(at)}


@pytest.mark.parametrize(
    ("low", "verdict", "says"), [(0, "proved", "|det| >= 1"), (-1, "refuted", "jumps from -1 to 1")]
)
@pytest.mark.parametrize("row", [sp.Abs, lambda v: sp.Max(v, -v)])
def test_the_determinant_of_a_phase_form_knows_kinks(row: Any, low: float, verdict: str, says: str) -> None:
    made = forms.phase(plant(lambda _, x2, u: row(x2), low))
    (rank,) = (one for one in made.checks if one.id == "phase.rank")
    assert rank.verdict == verdict
    assert says in str(rank.reason)


def test_a_kink_between_slopes_of_one_sign_is_proved() -> None:
    sign = nonzero(slope(2 * y + sp.Abs(y) + sp.sqrt(x**2 + y**2) / 2, y), {x: ONE, y: ONE})
    assert (sign.verdict, sign.sign, sign.margin) == (Verdict.PROVED, 1, 0.5)


def test_a_slope_that_is_zero_beside_a_kink_vanishes() -> None:
    claim = check(forms.uniform(plant(lambda _, x2, u: sp.Max(x2, 0))), "slope_2")
    assert (claim.verdict, str(claim.reason)) == (Verdict.REFUTED, "dF_1/dz_2 vanishes")
    assert claim.witness["x2"] < 0


@pytest.mark.parametrize("row", [lambda v: v + sp.sign(v), lambda v: sp.Piecewise((v + 1, v > 0), (2 * v, True))])
def test_what_jumps_itself_stays_unknown(row: Any) -> None:
    made = plant(lambda _, x2, u: row(x2))
    assert check(forms.uniform(made), "slope_2").verdict is Verdict.UNKNOWN
    assert check(forms.uniform(made), "lipschitz").verdict is Verdict.UNKNOWN


@pytest.mark.parametrize("row", [sp.log, lambda v: sp.atanh(v - 1)])
def test_a_slope_of_what_is_real_nowhere_is_not_proved(row: Any) -> None:
    """d log(v)/dv = 1/v has a value where log(v) has none."""
    claim = check(forms.uniform(plant(lambda _, x2, u: row(x2), low=-2, high=-1)), "slope_2")
    assert claim.verdict is Verdict.UNKNOWN
    assert str(claim.reason).endswith("of the plant is not shown to have a value on the box")


def test_the_sides_of_a_kink_that_only_touches_zero_are_one() -> None:
    square = sp.Abs(x**2 - x + sp.Rational(1, 4))
    assert one_sided(square, {x: (Fraction(0), Fraction(1))}) == x**2 - x + sp.Rational(1, 4)
    assert nonzero(slope(sp.Abs(-(x**2)) + 3 * x, x), {x: ONE}).sign == 1


# --- certificates


def test_a_zero_of_a_slope_at_a_kink_is_not_verified() -> None:
    form = forms.uniform(plant(lambda _, x2, u: sp.Abs(x2)))
    content = certificate(form, form.checks)
    assert {row.id: row.found for row in recheck(json.dumps(content)).rows}["uniform.slope_2"] == "verified"
    claim = next(one for one in content["claims"] if one["id"] == "uniform.slope_2")
    claim["evidence"] = {"expression": "sign(z2)", "witness": {"z2": "0"}}
    from test_certificate import sealed

    assert {row.id: row.found for row in recheck(sealed(content)).rows}["uniform.slope_2"] == "fails"


# --- Lipschitz


@pytest.mark.parametrize(
    ("row", "bound"),
    [
        (sp.sqrt(x**2 + y**2), 1.415),
        (sp.sqrt(4 * x**2 + y**2 + 3), 2.3),
        (sp.sqrt(x**2 - 2 * x * y + y**2), 1.4143),
        ((x**2 + y**2) ** sp.Rational(3, 2), 6.13),
        (sp.Max(sp.sqrt(x**2 + y**2), sp.Abs(x) + y), 2.5),
        (SATURATED, 1.0001),
    ],
)
def test_norms_and_what_is_made_of_them_are_lipschitz(row: sp.Expr, bound: float) -> None:
    lipschitz = lipschitz_bound([row], [x, y], {x: ONE, y: ONE})
    assert lipschitz.verdict is Verdict.PROVED
    assert lipschitz.low <= lipschitz.high <= bound


def test_each_slope_of_a_norm_is_at_most_1() -> None:
    for symbol in (x, y):
        assert hg.bound(slope(sp.sqrt(x**2 + y**2), symbol), {x: (-1, 1), y: (-1, 1)}).high == 1


@pytest.mark.parametrize("row", [sp.sqrt(sp.Abs(x)), sp.sqrt(x**2 + y), sp.Max(x, 0) ** sp.Rational(1, 3)])
def test_a_root_that_is_no_norm_is_not(row: sp.Expr) -> None:
    assert lipschitz_bound([row], [x, y], {x: ONE, y: (Fraction(0), Fraction(1))}).verdict is not Verdict.PROVED


# --- one oracle of zeros


@pytest.mark.parametrize(
    "factor",
    [
        lambda u: sp.cosh(100 * u) ** 2 - sp.sinh(100 * u) ** 2,
        lambda u: sp.exp(-1000 * u),
        lambda u: 1 + sp.tanh(1000 * u),
        lambda u: sp.exp(sp.pi * sp.sqrt(163)) - 262537412640768744,
        lambda u: u**2 - u + sp.Rational(26, 100),
        lambda u: (u**2 - u + sp.Rational(26, 100)) * sp.exp(-1000 * u),
    ],
)
def test_forms_and_the_singular_set_know_the_same_zeros(factor: Any) -> None:
    made = plant(lambda _, x2, u: factor(u) * x2)
    (u,) = made.inputs
    assert positive(ClaimId("form", "a", 2), "a_2", sp.sign(factor(0)) * factor(u), made).verdict is Verdict.PROVED
    assert nonzero_slope(ClaimId("form", "slope", 2), "dF_1/dz_2", factor(u), made).verdict is Verdict.PROVED
    assert hg.singularity(made).open_factors == ()
    sign = nonzero(factor(u), {u: ONE})
    number = factor(u).subs(u, 1).evalf(1000)
    assert sign.never
    assert 0 < sign.margin <= abs(number)


def test_what_comes_as_near_to_zero_as_you_like_is_never_zero_and_not_proved() -> None:
    sign = nonzero(sp.exp(x), {x: (float("-inf"), float("inf"))})
    assert (sign.never, sign.verdict) == (True, Verdict.UNKNOWN)


@pytest.mark.parametrize("e", [sp.exp(x) - 2, sp.tanh(1000 * x), sp.exp(x) - sp.exp(-x), 1 + sp.tanh(x) - y])
def test_what_has_a_zero_is_never_said_to_have_none(e: sp.Expr) -> None:
    sign = nonzero(e, {x: ONE, y: (Fraction(0), Fraction(1))})
    assert not sign.never
    assert sign.verdict is not Verdict.PROVED


# --- random expressions with kinks: samples try to refute what is proved, exact points show what is refuted

KINKED = st.recursive(
    st.sampled_from((x, y, sp.Integer(1), HALF, -sp.Rational(1, 4))),
    lambda e: st.one_of(
        st.tuples(e, e).map(lambda p: p[0] + p[1]),
        st.tuples(e, e).map(lambda p: p[0] - p[1]),
        st.tuples(e, e).map(lambda p: p[0] * p[1]),
        e.map(sp.Abs),
        st.tuples(e, e).map(lambda p: sp.Max(*p)),
        st.tuples(e, e).map(lambda p: sp.Min(*p)),
        st.tuples(e, e).map(lambda p: sp.sqrt(p[0] ** 2 + p[1] ** 2)),
        st.tuples(e, e).map(lambda p: p[0] * p[1] * sp.sign(p[0])),
        st.tuples(e, e, e).map(lambda p: sp.Piecewise((p[0] + p[1] * p[2], p[1] > 0), (p[0], True))),
    ),
    max_leaves=6,
)
ENDS = st.sampled_from(((-1, 1), (0, 1), (-1, 0), (Fraction(1, 4), 1)))  # exact in balls


def grid(box: dict[sp.Symbol, tuple[Any, Any]], count: int) -> list[list[Fraction]]:
    """Points of a box, its faces among them, row by row along the first symbol."""
    sides = [
        [Fraction(low) + (Fraction(high) - low) * k / count for k in range(count + 1)] for low, high in box.values()
    ]
    return [[a, b] for b in sides[1] for a in sides[0]]


def sampled(e: sp.Expr, box: dict[sp.Symbol, tuple[Any, Any]], count: int = 16) -> np.ndarray:
    """Values on the grid, (count + 1, count + 1), rising x along a row; NaN where there is none."""
    program = tape([e], list(box))
    balls = [values(program, point, 128)[0] for point in grid(box, count)]
    return np.array([float(ball.mid()) if ball.is_finite() else np.nan for ball in balls]).reshape(count + 1, count + 1)


@pytest.mark.full
@settings(max_examples=60, deadline=None)
@given(KINKED, ENDS, ENDS)
def test_without_kinks_it_is_the_same_function(e: sp.Expr, first: Any, second: Any) -> None:
    box = {x: (Fraction(first[0]), Fraction(first[1])), y: (Fraction(second[0]), Fraction(second[1]))}
    want = sampled(e, box)
    for other in (with_norms(e), one_sided(e, box)):
        seen = sampled(other, box)
        assert np.isfinite(want).any()
        assert np.allclose(
            np.where(np.isnan(want), np.nan, seen), np.where(np.isnan(seen), np.nan, want), equal_nan=True
        )


@pytest.mark.parametrize(
    ("args", "text"),
    [((0, x, y), "x/sqrt(x**2 + y**2)"), ((1, 2, y), "y/sqrt(y**2 + 4)"), ((0, 0, 0), "0/0")],
)
def test_a_direction_can_be_read_wherever_it_is(args: tuple[Any, ...], text: str) -> None:
    """At points its arguments are numbers, and their size may be 0."""
    assert str(Direction(*map(sp.sympify, args))) == text


def test_a_direction_of_a_range_of_one_point_is_every_number_of_it() -> None:
    """y s with s = sign(x) at x = 0, a set: no side of the box is the inner one there."""
    box = {x: (Fraction(0), Fraction(0)), y: (Fraction(1), Fraction(2)), z: (Fraction(0), Fraction(0))}
    for e in (Direction(sp.S.Zero, x), Direction(sp.S.Zero, x, z)):
        enclosure = bound(y * e, box)
        assert (enclosure.low, enclosure.high) == (-2, 2)


@pytest.mark.parametrize("at", [0, 1])
def test_a_direction_at_a_face_leaves_the_other_factor_its_range(at: int) -> None:
    """Its slope is 0 within the box: of a box with both ends exchanged y + sign(x) would be 0."""
    box = {x: (Fraction(0), Fraction(1)), y: (Fraction(-1), Fraction(1))}
    direction = Direction(sp.Integer(0), x - at)
    product, total = bound(y * direction, box), bound(y + direction, box)
    assert (product.low, product.high) == (-1, 1)
    assert (total.low, total.high) == (-2 * at, 2 - 2 * at)
    assert nonzero(slope(x * y * sp.sign(x) + x, x), box).verdict is not Verdict.PROVED


@pytest.mark.full
@settings(max_examples=60, deadline=None)
@given(KINKED, ENDS, ENDS, st.integers(-4, 4))
def test_slopes_at_kinks_hold_for_chords(e: sp.Expr, first: Any, second: Any, tilt: int) -> None:
    """What is proved of the slope in x is true of every chord along x; a jump over zero shows in two of them."""
    box = {x: (Fraction(first[0]), Fraction(first[1])), y: (Fraction(second[0]), Fraction(second[1]))}
    row = e + tilt * x
    steep = slope(row, x)
    if steep.has(sp.Piecewise, sp.sign, sp.DiracDelta):
        return
    sign = nonzero(steep, box, boxes=200)
    chords = np.diff(sampled(row, box), axis=1) * 16 / float(box[x][1] - box[x][0])
    if sign.verdict is Verdict.PROVED:
        assert np.nanmin(sign.sign * chords) >= float(sign.margin) * (1 - 1e-9)
    if sign.cause in (Cause.JUMP, Cause.CROSSING):
        least, most = sign.range.least, sign.range.most
        assert least is not None
        assert most is not None
        assert least.value < 0 < most.value
        for one in (least, most):
            at = {s: sp.Rational(value) for s, value in one.point.items()}
            exactly = steep.xreplace(at)
            assert not exactly.has(Direction) or not exactly.free_symbols
    if sign.cause is Cause.ZERO:
        at = {s: sp.Rational(value) for s, value in sign.witness.items()}
        assert steep.xreplace(at).equals(0)


@settings(max_examples=40, deadline=None)
@given(KINKED, ENDS, ENDS)
def test_a_lipschitz_bound_holds_for_chords(e: sp.Expr, first: Any, second: Any) -> None:
    box = {x: (Fraction(first[0]), Fraction(first[1])), y: (Fraction(second[0]), Fraction(second[1]))}
    lipschitz = lipschitz_bound([e], [x, y], box, boxes=200)
    if lipschitz.verdict is not Verdict.PROVED:
        return
    table = sampled(e, box)
    width = [float(high - low) / 16 for low, high in box.values()]
    for axis, step in ((1, width[0]), (0, width[1])):
        assert np.nanmax(np.abs(np.diff(table, axis=axis))) <= float(lipschitz.high) * step * (1 + 1e-9) + 1e-12


# --- a chain


def test_a_chain_needs_no_long_derivatives() -> None:
    """x_i' = x_(i+1) + sin(x_i): its ninth derivative has some hundred thousand terms, its determinant is 1."""
    states = [hg.Signal(f"x{i}", low=-4, high=4) for i in range(1, 11)]
    flow = [b + sp.sin(a) for a, b in pairwise(states)] + [-sp.sin(states[0]) - states[-1]]
    made = hg.System("chain", states=states, outputs=(hg.Signal("y"),), flow=flow, output=[states[0]])
    (jet,) = hg.singularity(made).jets
    assert (jet.determinant, jet.factors) == (1, ())


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (0, 2, 1)])
def test_the_determinant_of_a_chain_is_that_of_its_jacobian(order: tuple[int, ...]) -> None:
    a, b, c = (hg.Signal(name, low=-1, high=1) for name in "abc")
    rows = {a: (2 + c) * b + a**2, c: 3 * a + c, b: a * b * c}  # y = c
    states = [(a, b, c)[k] for k in order]
    made = hg.System("abc", states=states, outputs=(hg.Signal("y"),), flow=[rows[s] for s in states], output=[c])
    y0, y1 = c, rows[c]
    y2 = sum(y1.diff(s) * rows[s] for s in rows)
    jacobian = sp.Matrix(3, 3, lambda i, j: (y0, y1, y2)[i].diff(states[j]))
    assert sp.expand(hg.singularity(made).jets[0].determinant - jacobian.det()) == 0


@pytest.mark.full
def test_a_factor_that_is_the_expression_is_not_asked_about_again() -> None:
    """sqrt(1 + x^2) - cosh(x), rewritten in exponentials, is its own only factor: it called itself without end."""
    x = hg.Signal("x", low=-3, high=3)
    output = sp.sin(x) * sp.Max(sp.sqrt(1 + x**2), sp.cosh(x))
    plant = hg.System("plant", states=(x,), outputs=(hg.Signal("y"),), flow=[-x], output=[output])
    assert forms.uniform(plant).checks[1].verdict is Verdict.REFUTED


def test_the_logarithm_of_a_large_whole_number_ends() -> None:
    x, large = sp.Symbol("x", real=True), sp.Integer(10) ** 20
    assert is_zero(sp.log(x + 1 / large) - sp.log(large * x + 1) + sp.log(large, evaluate=False)) is True


def test_what_is_left_of_an_affine_row_is_read_as_its_slopes_are() -> None:
    """max(u, w) is (u + w + |u - w|)/2 in both."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2)]
    u, w = (hg.Signal(name, low=0, high=1) for name in "uw")
    output = sp.atan(1 + sp.log(1 + sp.Max(w, u) ** 2)) * x[1]
    plant = hg.System(
        "plant", states=x, inputs=(u, w), outputs=(hg.Signal("y"),), flow=[-x[0], x[0] + w], output=[output]
    )
    assert {check.verdict for check in forms.state_affine(plant).checks} == {Verdict.PROVED}


@pytest.mark.parametrize(
    "hidden",
    [
        lambda e: sp.Max(e, 5),
        lambda e: sp.Min(-5, sp.exp(e)),
        lambda e: sp.sign(5 - e),
        lambda e: sp.Heaviside(5 - e),
        lambda e: sp.Piecewise((e, e > 5), (1, True)),
    ],
)
def test_what_is_not_real_everywhere_is_not_left_out(hidden: Any) -> None:
    """max(sqrt(x - 1), 5) has no value where x < 1: to read it as 5 would prove forms of a plant that is not there."""
    x, z = hg.Signal("x", low=0, high=2), hg.Signal("z", low=-1, high=1)
    row = hidden(sp.sqrt(x - 1))
    assert one_sided(row, {x: (Fraction(0), Fraction(2))}).has(x)
    assert not one_sided(row, {x: (Fraction(1), Fraction(2))}).has(x)
    plant = hg.System("plant", states=(x, z), outputs=(hg.Signal("y"),), flow=[z + row, 0], output=[x])
    (check,) = (check for check in forms.triangular(plant).checks if check.id == "triangular.lipschitz")
    assert check.verdict is not Verdict.PROVED


@pytest.mark.parametrize(("power", "steepest"), [(3, 24), (1, 1), (-1, 0.5), (-3, 0.75)])
def test_a_power_of_a_root_of_squares_is_as_steep_as_it_is(power: int, steepest: float) -> None:
    """r^p with r^2 = x^2 + y^2 has the slope |p| r^(p-1), and 2 <= r^2 <= 8 here."""
    box = {x: (Fraction(1), Fraction(2)), y: (Fraction(1), Fraction(2))}
    lipschitz = lipschitz_bound([(x**2 + y**2) ** sp.Rational(power, 2)], (x, y), box)
    assert lipschitz.verdict is Verdict.PROVED
    assert steepest * (1 - 1e-12) <= lipschitz.high <= 1.03 * steepest


_X = hg.Signal("x", low=0, high=1)
_U = hg.Signal("u", low=-1, high=1)
_POSITIVE = hg.Signal("w", low=0, high=1)


@pytest.mark.ordinary(
    "rate-Abs(x)/x", "rate-w/(w + x) + x/(w + x)", "gain-(u*x + u)/u", "output-Abs(w)/w", "output-(u*x + u)/u"
)
@pytest.mark.parametrize(
    "part",
    [
        sp.Abs(_X) / _X,
        sp.sqrt(_POSITIVE**2) / _POSITIVE,
        sp.Max(sp.sqrt(_U), 0) - sp.sqrt(_U),
        (_U * _X + _U) / _U,
        sp.log(_U) - sp.log(2 * _U),
        _X / (_X + _POSITIVE) + _POSITIVE / (_X + _POSITIVE),
    ],
    ids=str,
)
@pytest.mark.parametrize("place", ["rate", "gain", "output"])
def test_no_form_is_proved_of_a_plant_that_has_no_value_where_a_part_cancels(part: sp.Expr, place: str) -> None:
    """|x|/x is 1 where x > 0, and no number at x = 0: the box holds a point where the plant has no value."""
    z, y = hg.Signal("z", low=0, high=1), hg.Signal("y")
    rate = {"rate": z + part, "gain": z * part, "output": z}[place]
    output = _X + part if place == "output" else _X
    states, inputs = (_X, z), (_U, _POSITIVE)
    plant = hg.System("plant", states=states, inputs=inputs, outputs=(y,), flow=[rate, -z], output=[output])
    for form in (forms.triangular, forms.uniform, forms.state_affine, forms.original, forms.block_triangular):
        checks = form(plant).checks
        assert {check.verdict for check in checks} - {Verdict.PROVED, Verdict.GENERIC}, form
    assert hg.singularity(plant).checks[0].verdict is not Verdict.PROVED


_HALF = hg.Signal("h", low=0, high=0.5)
_NIL = hg.Signal("k", nominal=0)


@pytest.mark.ordinary("(h*x + h)/h-Piecewise((1/h, h > 2), (x, True))", "(x*log(h) + log(h))/log(h)-k*log(h)")
@pytest.mark.parametrize(
    ("part", "beside"),
    [
        ((_HALF * _X + _HALF) / _HALF, sp.Piecewise((1 / _HALF, _HALF > 2), (_X, True))),
        ((_HALF * _X + _HALF) / _HALF, sp.Heaviside(_X + 2, 1 / _HALF)),
        ((_X * sp.log(_HALF) + sp.log(_HALF)) / sp.log(_HALF), sp.atan2(2, _HALF)),
        ((_X * sp.atanh(1 - _HALF) + sp.atanh(1 - _HALF)) / sp.atanh(1 - _HALF), sp.asin(1 - _HALF)),
        ((_X * sp.log(_HALF) + sp.log(_HALF)) / sp.log(_HALF), _NIL * sp.log(_HALF)),
    ],
    ids=str,
)
def test_what_cancels_is_not_asked_for_by_what_has_a_value_beside_it(part: sp.Expr, beside: sp.Expr) -> None:
    """1/h in a branch that is not taken, atan2(2, h) and asin(1 - h) at h = 0, 0 log(h) with its 0 put in: none of them
    shows that the part has a value at h = 0, where it has none."""
    z, y = hg.Signal("z", low=0, high=1), hg.Signal("y")
    states, inputs = (_X, z), (_HALF,)
    rows = {"flow": [z + part, beside - z], "output": [_X]}
    plant = hg.System("plant", states=states, inputs=inputs, outputs=(y,), parameters=(_NIL,), **rows)
    for form in (forms.triangular, forms.uniform, forms.state_affine, forms.original, forms.block_triangular):
        checks = form(plant).checks
        assert {check.verdict for check in checks} - {Verdict.PROVED, Verdict.GENERIC}, form


@pytest.mark.parametrize("low", [-1, 0.1])
def test_a_part_stays_where_the_same_branch_is_taken(low: float) -> None:
    """A Piecewise that keeps its poles out of the box asks for nothing."""
    x, z = (hg.Signal(name, low=low, high=1) for name in ("x", "z"))
    rest = sp.Piecewise((sp.log(x), x > 2), (x / (x + 2), True))
    plant = hg.System("plant", states=(x, z), outputs=(hg.Signal("y"),), flow=[z + rest, -z], output=[x])
    assert {check.verdict for check in forms.triangular(plant).checks} == {Verdict.PROVED}


V, X, Y = hg.Signal("v", low=0, high=3), hg.Signal("x", low=0, high=1), hg.Signal("y")


@pytest.mark.parametrize(
    ("expression", "steep"),
    [
        (sp.Abs(V), 1.0),
        (sp.Max(V, 0), 1.0),
        (sp.sqrt(V**2), 1.0),
        (sp.Piecewise((V, V > 0), (0, True)), 1.0),
        (sp.Min(V, 3), 1.0),
        (sp.Abs(V - 3) - V, -2.0),
        (hg.table(sp.Abs(V), [sp.Rational(-6, 5), 3], [0, sp.Rational(21, 5)], name="T"), 1.0),
    ],
)
def test_at_an_end_of_its_range_a_program_takes_the_slope_within(expression: sp.Expr, steep: float) -> None:
    """That of which the proofs are: where the kink lies at the end, CasADi's own is the mean of both sides."""
    form = hg.forms.uniform(hg.System("bent", states=(X, V), outputs=(Y,), flow=[expression, -V * X], output=[X]))
    z = ca.SX.sym("z", 2)
    jacobian = ca.Function("J", [z], [Dynamics(form).jacobian(z, ca.SX(0, 1))])
    (claim,) = [check for check in form.checks if str(check.id) == "uniform.slope_2"]
    assert claim.verdict is Verdict.PROVED
    for v in (-1.0, 0.0, 1.5, 3.0, 4.0):
        assert float(jacobian([0.0, v])[0, 1]) == pytest.approx(steep, rel=1e-15)


W = hg.Signal("v", low=-1, high=1)
_SIZE = sp.Piecewise((-W, W < 0), (W, True))


@pytest.mark.ordinary(
    "-Piecewise((-v, v < 0), (v, True)) + 2*Max(0, v)-double",
    "Piecewise((0, v <= 0), (2*v, True)) - Piecewise((-v, v < 0), (v, True))-double",
    "v + Piecewise((-v + Abs(v), v < 0), (v + Abs(v), True)) - 2*Abs(v)-double",
    "v*sign(v) + v - Piecewise((-v, v < 0), (v, True))-float",
    "v*sign(v) + v - Piecewise((-v, v < 0), (v, True))-double",
)
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize(
    "expression",
    [
        2 * sp.Max(W, 0) - _SIZE,
        sp.Piecewise((0, W <= 0), (2 * W, True)) - _SIZE,
        sp.Piecewise((-W + sp.Abs(W), W < 0), (W + sp.Abs(W), True)) - 2 * sp.Abs(W) + W,
        W + 3 * (sp.Min(sp.Max(W, -HALF), HALF) - SATURATED.subs(x, W)),
        2 * sp.Max(W + 1000, 1000) - sp.Abs(W),
        W + W * sp.sign(W) - _SIZE,
    ],
    ids=str,
)
def test_of_kinks_at_one_place_a_program_takes_one_side(expression: sp.Expr, real: Any) -> None:
    """Each row is v, or v + 2000, and so is its slope proved to be 1. A choice takes one branch at its kink, a minimum
    the mean of both; and v + 1000 is rounded to 1000 where v is small."""
    form = forms.uniform(hg.System("bent", states=(X, W), outputs=(Y,), flow=[expression, -W * X], output=[X]))
    z = ca.SX.sym("z", 2)
    slope = evaluated(ca.Function("J", [z], [Dynamics(form).jacobian(z, ca.SX(0, 1))[0, 1]]), real)
    claim = check(form, "slope_2")
    assert (claim.verdict, str(claim.reason)) == (Verdict.PROVED, "it is at least 1")
    for v in (-1.5, -0.5, -1e-6, 0, 1e-20, 1e-6, 0.5, 0.7):
        assert float(slope([[DTYPE[real](0), DTYPE[real](v)]])[0][0]) == 1


# --- norms ------------------------------------------------------------------------------------------------------


def drag() -> hg.System:
    """A mass in a plane under quadratic drag, whose position is measured."""
    p, q, v, w = (hg.Signal(name, low=-50, high=50) for name in ("p", "q", "v", "w"))
    forces = tuple(hg.Signal(name, low=-5, high=5) for name in ("f", "g"))
    size = sp.sqrt(v**2 + w**2)
    flow = [v, w, forces[0] - size * v / 10, forces[1] - size * w / 10]
    outputs = (hg.Signal("a"), hg.Signal("b"))
    return hg.System("drag", states=(p, q, v, w), inputs=forces, outputs=outputs, flow=flow, output=[p, q])


@pytest.mark.parametrize("engine", ["c", "python"])
def test_a_filter_at_rest_takes_a_norm_that_is_zero_there(engine: Any) -> None:
    """d|v|/dv would be 0/0: the estimate begins at rest and stays there, then the mass moves."""
    observer = hg.observers.riccati(forms.original(drag()), Q=[0.01] * 4, R=[0.01, 0.01])
    step = hg.sample(observer, dt=0.01, engine=engine)
    u, x, truth = np.zeros((300, 2)), np.zeros(4), []
    u[100:] = 1.0, 0.5
    for force in u:
        truth.append(x)
        for _ in range(10):
            x = x + 1e-3 * np.r_[x[2:], force - 0.1 * np.hypot(*x[2:]) * x[2:]]
    run = step.run(u, np.array(truth)[:, :2])
    assert not run.status.any()
    assert run.x[99].tolist() == [0.0] * 4
    assert np.abs(run.x[-1] - truth[-1]).max() < 2e-3  # the truth is Euler's, of which v is off by .1 v^2/2 h = 2e-4


@pytest.mark.full
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2))
@example([2.0, 99.44961996426264])  # of which the library's power 2 is not the product
def test_a_norm_keeps_its_value_and_its_slope(at: list[float]) -> None:
    """But within 2^-60 of zero, where the slope is 0, as one of the directions' hull is."""
    v, w = hg.Signal("v", low=-1e3, high=1e3), hg.Signal("w", low=-1e3, high=1e3)
    y = hg.Signal("y")
    system = hg.System("norm", states=(v, w), outputs=(y,), flow=[sp.sqrt(v**2 + w**2), w], output=[v])
    dynamics, size = Dynamics(forms.original(system)), float(np.sqrt(at[0] * at[0] + at[1] * at[1]))
    z, none = ca.SX.sym("z", 2), ca.SX(0, 1)
    value, slopes = ca.Function("f", [z], [dynamics.flow(z, none)[0], dynamics.jacobian(z, none)[0, :]])(at)
    assert float(value) == max(size, 2.0**-60)
    wanted = np.array(at) / size if size > 2.0**-60 else np.zeros(2)
    assert np.abs(np.array(slopes.full()).ravel() - wanted).max() <= 4e-16


def test_a_root_that_is_no_norm_keeps_its_own_slope() -> None:
    """sqrt(v) has none at 0, 1/|v| no value, and sqrt(v^2 + 1) needs no help."""
    v, w = sp.symbols("v w", real=True)
    ends = {v: ONE, w: ONE}
    for row in (sp.sqrt(v), 1 / sp.sqrt(v**2 + w**2), sp.sqrt(v**2 + 1), sp.Abs(v)):
        assert as_computed(row, ends) == row
    assert as_computed(sp.sqrt(v**2 + w**2), ends) == sp.sqrt(sp.Max(v**2 + w**2, sp.Rational(1, 2**120)))
    assert as_computed(sp.sqrt(sp.expand((v - w) ** 2)), ends) == sp.Abs(v - w)


def row_and_slopes(row: sp.Expr, *states: hg.Signal) -> ca.Function:
    """A row of a plant and its slopes, as programs compute them."""
    flow = [row] * len(states)
    system = hg.System("norm", states=states, outputs=(hg.Signal("y"),), flow=flow, output=[states[0]])
    dynamics, z, none = Dynamics(forms.original(system)), ca.SX.sym("z", len(states)), ca.SX(0, 1)
    return ca.Function("f", [z], [dynamics.flow(z, none)[0], dynamics.jacobian(z, none)[0, :]])


A, B = (hg.Signal(name, low=-1, high=1) for name in "ab")
SIZE = sp.sqrt(A**2 + B**2)


@pytest.mark.parametrize(
    "row",
    [
        sp.Piecewise((sp.sin(SIZE) / SIZE, SIZE > 0), (1, True)),
        sp.Piecewise((1, sp.Eq(SIZE, 0)), (sp.sin(SIZE) / SIZE, True)),
        sp.Piecewise((sp.sin(SIZE) / SIZE, A**2 + B**2 > 0), (1, True)),
        sp.Piecewise((SIZE + 1, SIZE > 0), (1 + B / 8, True)),
    ],
)
def test_what_a_model_chooses_where_a_norm_is_zero_is_taken(row: sp.Expr) -> None:
    """A norm that is no less than 2^-60 would be above 0 there, and its sine over the norm infinite."""
    (value, slopes), (beside, _) = row_and_slopes(row, A, B)([0, 0]), row_and_slopes(row, A, B)([1e-30, 1e-30])
    assert float(value) == float(beside) == 1
    assert slopes.full().ravel().tolist() == ([0, 0.125] if row.has(sp.Rational(1, 8)) else [0, 0])


def test_a_branch_has_a_slope_where_its_norm_is_zero() -> None:
    row = sp.Piecewise((A * SIZE, SIZE < HALF), (A / 2, True))
    assert np.abs(row_and_slopes(row, A, B)([0, 0])[1].full()).max() < 1e-18


@pytest.mark.parametrize(
    ("real", "scale", "power"),
    [("double", 1e-16, 1), ("double", 1e-20, 1), ("double", 1e-19, 3), ("float", 1e-16, 1)],
)
def test_a_norm_of_small_things_is_their_norm(real: Any, scale: float, power: int) -> None:
    """Charges in coulombs, say: 2^-60 would be a large part of them."""
    v, w = (hg.Signal(name, low=-scale, high=scale) for name in "vw")
    run = evaluated(row_and_slopes(sp.sqrt(v**2 + w**2) ** power, v, w), real)
    for at in ([1.0, -1.0], [0.25, 0.5], [1e-3, 0.0]):
        value, slopes = run([np.array(at, DTYPE[real]) * DTYPE[real](scale)])
        size, close = float(np.hypot(*at)), 1e-5 if real == "float" else 1e-13
        assert float(np.ravel(value)[0]) == pytest.approx((size * scale) ** power, rel=close)
        slope = power * (size * scale) ** (power - 1) * np.array(at) / size
        assert np.ravel(slopes) == pytest.approx(slope, rel=close, abs=0)
    assert np.ravel(run([np.zeros(2, DTYPE[real])])[1]).tolist() == [0, 0]


@pytest.mark.parametrize("kink", [sp.Abs, lambda u: sp.Max(u, 0), lambda u: sp.sqrt(u**2 + 1)])
def test_a_gain_that_bends_with_the_input_runs(kink: Any) -> None:
    """x1' = (1 + kink(u)/2) x2: what the form reads of it is what a program and a user write."""
    (x1, x2), u = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2")), hg.Signal("u", low=-1, high=1)
    gain = 1 + kink(u) / 2
    plant = hg.System(
        "bent", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=[gain * x2, -x1], output=[gain * x1]
    )
    form = forms.triangular(plant)
    assert [is_zero(a - gain) for (chain,) in [form.gains] for a in chain] == [True, True]
    step = hg.sample(hg.observers.high_gain(form, theta=3, gains=(3, 1)), dt=0.01, engine="python")
    assert np.isfinite(step.run(u=np.full(50, -0.5), y=np.zeros(50)).x).all()
