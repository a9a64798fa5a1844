"""Removable singularities as programs compute them: within some ulp of the limit form, with the derivative there."""

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sp
from flint import arb, ctx
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.undefined import undefined_slopes, undefined_values
from hgogen.graph import to_casadi
from hgogen.rigor.box import exact
from hgogen.rigor.singular import _X, _enough, _numerator, _regular, _series, _Term, resolved, with_limits

W, V = hg.Signal("w", low=-20, high=20), hg.Signal("v", low=-20, high=20)
H = hg.Signal("h", low=0, high=20)
X, Y = hg.Signal("x", low=-1e6, high=1e6), hg.Signal("y", low=-1e6, high=1e6)
A = hg.Signal("a", nominal=1, low=-2, high=2)
DIGITS = {"float": 23, "double": 52}
ULPS = 8
QUOTIENTS = {
    "sinc": sp.sin(W) / W,
    "versine": (1 - sp.cos(W)) / W**2,
    "odd versine": (1 - sp.cos(W)) / W,
    "third": (W - sp.sin(W)) / W**3,
    "exponential": (sp.exp(W) - 1) / W,
    "second exponential": (sp.exp(-W) - 1 + W) / W**2,
    "scaled": sp.sin(2 * W) / W,
    "hyperbolic": sp.sinh(W) / W,
    "inverse": sp.atan(W) / W,
    "tanh": sp.tanh(W) / W,
    "square": sp.sin(W) ** 2 / W**2,
    "signed root": sp.sign(W) * sp.sqrt(sp.Abs(W)),
    "spread": sp.expand(3 * (1 - sp.cos(W)) / W**2),
}
FEW = ("sinc", "versine", "second exponential", "signed root")  # of which the others are kin


def evaluated(e: sp.Expr, real: str, points: np.ndarray, of: hg.Signal) -> np.ndarray:
    """The values that emitted code computes: one step of x' = e from 0 by 1 s, the input held."""
    plant = hg.System("rate", states=(X,), inputs=(of,), outputs=(Y,), flow=[e], output=[X])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1)
    step = hg.sample(observer, hg.methods.continuous_discrete, dt=1.0, between="hold", real=real)
    u = np.repeat(points[:, None, None], 2, axis=1)
    batch = step.run_many(u, np.full((len(points), 2, 1), np.nan))
    restarted = [bit.name for bit in step.layout.bits].index("RESTARTED")
    assert not (np.asarray(batch.status) >> restarted & 1).any()
    return np.asarray(batch.x[:, 1, 0])


def ulps(e: sp.Expr, real: str, points: np.ndarray, of: hg.Signal = W) -> float:
    """The largest error in ulp of the exact value; at 0 of the limit."""
    points = points.astype({"float": np.float32, "double": np.float64}[real]).astype(float)
    exact, errors = sp.lambdify(of, e, "mpmath"), []
    t = sp.Symbol("t", positive=True)
    with mpmath.workprec(900):  # (w - sin w)/w^3 at 1e-30 loses 300 of them
        for point, value in zip(points, evaluated(e, real, points, of), strict=True):
            wanted = (
                exact(mpmath.mpf(point)) if point else mpmath.mpf(str(sp.limit(e.xreplace({of: t}), t, 0).evalf(30)))
            )
            unit = mpmath.mpf(2) ** (mpmath.floor(mpmath.log(abs(wanted), 2)) - DIGITS[real]) if wanted else 1e-300
            errors.append(float(abs(mpmath.mpf(value) - wanted) / unit))
    return max(errors)


@pytest.mark.ordinary("signed root-float")
@pytest.mark.parametrize("real", ["float", pytest.param("double", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in QUOTIENTS]
)
def test_a_quotient_is_near_its_limit_form_over_its_range(name: str, real: str) -> None:
    """Of a root and a quotient of functions of 2 ulp, whose terms are at most 4 times their sum."""
    draw = np.random.default_rng()
    small = 10.0 ** draw.uniform(-30, 0.8, 20)
    ends = np.array([r * (1 + s * 1e-7) for r in (0.25, 0.5, 0.75, 1, 1.5, 2, 2.5, 3) for s in (-1, 0, 1)])
    points = np.concatenate([[0.0], small, -small, draw.uniform(-6.2, 6.2, 30), ends, -ends])
    assert ulps(QUOTIENTS[name], real, points) <= ULPS


@pytest.mark.full
@pytest.mark.parametrize("real", ["float", "double"])
def test_x_log_x_is_near_its_limit_form(real: str) -> None:
    draw = np.random.default_rng()
    points = np.concatenate([[0.0], 10.0 ** draw.uniform(-37, 1.3, 50)])
    assert ulps(H * sp.log(H), real, points, H) <= ULPS
    assert ulps(H**2 * sp.log(H), real, np.concatenate([[0.0], 10.0 ** draw.uniform(-17, 1.3, 50)]), H) <= ULPS
    least = evaluated(H * sp.log(H), real, np.array([1e-40, 1e-310]), H)  # which a float has few digits for, or none
    assert np.abs(least).max() < 1e-36


@pytest.mark.ordinary("sinc", "versine")
@pytest.mark.parametrize("name", ["sinc", "versine", "third", "exponential"])
def test_the_derivative_is_that_of_the_limit_form(name: str) -> None:
    """By the program's own derivative, to 64 units of rounding of the size of the function's derivatives."""
    e = QUOTIENTS[name].xreplace({W: X})
    plant = hg.System("steep", states=(X,), outputs=(Y,), flow=[e], output=[X])
    z = ca.SX.sym("z", 1)
    slope = ca.Function("slope", [z], [Dynamics(hg.forms.original(plant)).jacobian(z, ca.SX(0, 1))])
    exact = sp.lambdify(X, e.diff(X), "mpmath")
    limit = float(sp.series(e, X, 0, 3).removeO().coeff(X, 1))
    points = np.random.default_rng().uniform(-3, 3, 40)
    with mpmath.workprec(300):
        wanted = [float(exact(mpmath.mpf(x))) for x in points]
    assert np.array([float(slope(x)) for x in points]) == pytest.approx(wanted, abs=64 * 2.0**-52)
    assert float(slope(0)) == pytest.approx(limit, abs=1e-16)
    assert float(slope(1e-12)) == pytest.approx(limit, abs=1e-11)


@pytest.mark.ordinary("e11", "e13", "e26")
@pytest.mark.parametrize(
    "e",
    [
        *QUOTIENTS.values(),
        sp.sinc(W),
        A * (1 - sp.cos(W)) / W**2 + V * sp.sin(W) / W,
        sp.sin(W - V) / (V - W),
        sp.sin(A * W) / W,
        (sp.exp(-A * W) - 1) / W,
        sp.sin(sp.sqrt(W**2 + V**2)) / sp.sqrt(W**2 + V**2),
        (1 - sp.cos(sp.sqrt(W**2 + V**2))) / (W**2 + V**2),
        sp.exp(sp.sin(W) / W),
        H * sp.log(H),
        *(e for e in (H * sp.log(H / 3), H * sp.log(H * (V + 30)), W * sp.log(W**2), (W + V) * sp.log(sp.Abs(W + V)))),
        sp.sqrt(sp.Max(W, 0)),
    ],
)
def test_a_row_with_a_limit_everywhere_is_refused_to_nobody(e: sp.Expr) -> None:
    plant = hg.System("limit", states=(X,), inputs=(W, V, H), outputs=(Y,), parameters=(A,), flow=[e - X], output=[X])
    assert undefined_values(plant) == ()
    hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1)


@pytest.mark.ordinary("e0", "e1", "e2")
@pytest.mark.parametrize(
    "e",
    [
        (1 + W) * sp.sin(V * W) / W,
        sp.exp(W) * sp.sin(V * W) / W,
        sp.sin(W) * sp.sin(V * W) / W,
        (1 - sp.cos(V * W)) * (1 + W) ** 2 / W**2,
        (sp.exp(-W / (3 + A)) - 1) / W,
        sp.sin(100 * W) / W,
        sp.sin(0.1 * W) / W,
        (0.5 - 0.5 * sp.cos(W)) / W**2,
        (1 - sp.exp(-20.0 * W)) / W,
        sp.sin(sp.pi * W) / (sp.pi * W),
        (1 - sp.cos(40 * sp.sqrt(W**2 + V**2))) / (W**2 + V**2),
    ],
)
def test_a_quotient_in_a_multiple_of_its_base_has_the_value_as_written(e: sp.Expr) -> None:
    """By symbols, decimals and large numbers, beside factors that read the base alone; it has one at 0 as well."""
    draw = np.random.default_rng()
    form = resolved(e)
    assert form != e
    for size in (1e-3, 0.3, 3.0):
        at = {s: sp.Rational(float(draw.uniform(size / 2, size) * draw.choice([-1, 1]))) for s in (W, V, A)}
        wanted, value = (sp.re(sp.N(each.xreplace(at), 40)) for each in (exact(e), exact(form)))
        assert abs(value - wanted) <= 2**-50 * abs(wanted)
    plant = hg.System("limit", states=(X,), inputs=(W, V), outputs=(Y,), parameters=(A,), flow=[e - X], output=[X])
    assert undefined_values(plant) == ()
    assert sp.sympify(form.xreplace({W: sp.S.Zero, V: sp.S.Zero, A: sp.S.One})).is_finite


@pytest.mark.parametrize(
    "e",
    [
        1 / W,
        sp.cos(W) / W,
        sp.sin(W) * sp.sin(V * W) / W**3,
        sp.sin(W) / W**2,
        sp.sin(W) / V,
        W * sp.log(W),
        (W + 1) / W,
    ],
)
def test_what_has_no_limit_stays_as_it_is_and_is_named(e: sp.Expr) -> None:
    assert resolved(e) == e
    plant = hg.System("limit", states=(X,), inputs=(W, V), outputs=(Y,), flow=[e - X], output=[X])
    assert [check.verdict for check in undefined_values(plant)] == ["refuted"]


def test_a_quotient_of_two_multiples_of_its_base_stays_as_it_is() -> None:
    """In v w for x the sine would read x as well."""
    for e in ((sp.exp(V * W) - 1 - sp.sin(W)) / W, sp.sin(W + sp.sin(V * W)) / W):
        assert resolved(e) == e


def test_an_endless_slope_is_named_of_those_that_linearise() -> None:
    """Signed roots and x log x have a value at 0, and no derivative."""
    for rate in (-sp.sign(X) * sp.sqrt(sp.Abs(X)), -sp.Abs(X) * sp.log(sp.Abs(X))):
        plant = hg.System("endless", states=(X,), outputs=(Y,), flow=[rate], output=[X])
        assert undefined_values(plant) == ()
        assert [check.id for check in undefined_slopes(plant)] == ["singular.x"]


@pytest.mark.full
def test_a_slope_that_the_program_takes_at_an_end_is_met_at_the_door() -> None:
    """sqrt(max(h, 0)) is flat at 0; sqrt(h), of which the program knows no less, is not."""
    for low in (0, -1):
        h, y = hg.Signal("h", low=low, high=2), hg.Signal("y")
        ramp = hg.System("ramp", states=(h,), outputs=(y,), flow=[1 - sp.sqrt(sp.Max(h, 0))], output=[h])
        form, accept = hg.forms.original(ramp), ("original.lipschitz",)
        assert undefined_values(ramp) == ()
        step = hg.sample(hg.observers.riccati(form, Q=[1], R=1, accept=accept), dt=0.01)
        run = step.run(y=np.zeros(50))
        assert np.isfinite(run.x).all()
        restarted = [k for k, bit in enumerate(step.layout.bits) if bit.name == "RESTARTED"]
        assert not any((run.status >> k & 1).any() for k in restarted)


def test_a_logarithm_below_0_has_no_value() -> None:
    for e in (H * sp.log(H), H * sp.log(2 * H), H * sp.log(3 / H), H * V * sp.log(H * V)):
        (value,) = to_casadi([with_limits(e)], {H: -1.0, V: 2.0})
        assert np.isnan(float(value))


MULTIPLES = {
    "square": (W * sp.log(W**2), 1),
    "size": (W * sp.log(sp.Abs(W)), 1),
    "square of itself": (W**2 * sp.log(W**2), 2),
    "multiple": (H * sp.log(2 * H), 1),
    "inverse": (H * sp.log(3 / H), 1),
}


@pytest.mark.ordinary("square of itself-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", MULTIPLES)
def test_the_logarithm_of_a_multiple_or_a_square_is_near_its_limit_form(name: str, real: str) -> None:
    e, p = MULTIPLES[name]
    points = np.concatenate([[0.0], 10.0 ** np.random.default_rng().uniform(-37 / p, 1.2, 40)])
    assert ulps(e, real, points if e.has(H) else np.concatenate([points, -points]), H if e.has(H) else W) <= ULPS


@pytest.mark.parametrize("v", [2.0, -2.0])
def test_a_logarithm_of_a_product_has_its_limit_on_the_side_where_it_has_values(v: float) -> None:
    for h in (0.0, 1e-40 * v, v):
        (value,) = to_casadi([with_limits(H * sp.log(H * V))], {H: h, V: v})
        assert np.isfinite(float(value))
    (value,) = to_casadi([with_limits(-H * sp.log(-H))], {H: 0.0})
    assert float(value) == 0


@pytest.mark.parametrize(
    ("e", "place"),
    [
        (W * sp.log(V**2), "unless v**2 > 0"),
        (V * sp.log(W**2), "unless w**2 > 0"),
        (sp.log(W**2) / W, "at w = 0 or unless w**2 > 0"),
        (H * sp.log(H * V), "unless h*v >= 0 or unless v**2 > 0"),
        (H * sp.log(H / V), "at v = 0"),
        (W * sp.log(2 * W), "unless w >= 0"),
    ],
)
def test_a_logarithm_without_a_limit_is_named(e: sp.Expr, place: str) -> None:
    plant = hg.System("limit", states=(X,), inputs=(W, V, H), outputs=(Y,), flow=[e - X], output=[X])
    (check,) = undefined_values(plant)
    assert (check.verdict, place in str(check.reason)) == ("refuted", True)


def test_a_root_of_a_ramp_is_flat_where_the_ramp_is() -> None:
    h = ca.SX.sym("h")
    (value,) = to_casadi([sp.sqrt(sp.Max(H, 0))], {H: h})
    slope = ca.Function("slope", [h], [ca.jacobian(value, h), value])
    assert [float(slope(x)[0]) for x in (-1, 0, 4)] == [0, 0, 0.25]
    assert [float(slope(x)[1]) for x in (-1, 0, 4)] == [0, 0, 2]


@pytest.mark.full
@given(
    h=st.sampled_from(
        [sp.sin(_X), 1 - sp.cos(_X), sp.exp(_X) - 1, sp.atan(_X), sp.tan(_X), sp.log(1 + _X), sp.asin(_X)]
    ),
    factor=st.fractions(-2, 2, max_denominator=7).filter(bool),
    numerator=st.integers(1, 9),
)
def test_a_majorant_bounds_each_partial_sum_of_absolute_terms(h: sp.Expr, factor: float, numerator: int) -> None:
    """What the terms up to n leave of it is then a bound of what they leave of the series."""
    h, r = h.xreplace({_X: _X * sp.Rational(factor)}), sp.Rational(numerator, 21)
    terms = (_Term(sp.S.One, 0, h),)
    series = _series(terms, 0)
    with ctx.workprec(200):
        bound = _numerator(terms, 0, arb(int(r.p)) / int(r.q), majorant=True)
        partial = sum((abs(arb(series[k])) * (arb(int(r.p)) / int(r.q)) ** k for k in range(40)), arb(0))
        assert bound > partial * (1 - arb(2) ** -150) or bound.overlaps(partial)


def test_fewer_terms_than_the_bound_asks_for_are_not_enough() -> None:
    """Of sin x/x at 1 the term x^18/19! is 2^-56, and x^20/21! below 2^-65."""
    terms = (_Term(sp.S.One, 1, sp.sin(_X)),)
    series = _series(terms, 1)
    with ctx.workprec(200):
        assert _enough(terms, [series[k] for k in range(1, 50)], 1, sp.S.One) in (19, 20)
    regular = _regular(terms)
    assert regular is not None
    value = regular.at(W).args[0][0].xreplace({W: regular.radius})
    assert abs(sp.N(value - sp.sin(regular.radius) / regular.radius, 30)) <= 2**-57


@pytest.mark.parametrize(
    ("e", "place"),
    [(sp.tan(W) / W, "at cos(w) = 0"), (sp.log(1 + W) / W, "unless w + 1 > 0"), (W / sp.sin(W), "sin(w)")],
)
def test_a_pole_of_the_other_form_is_named(e: sp.Expr, place: str) -> None:
    plant = hg.System("limit", states=(X,), inputs=(W,), outputs=(Y,), flow=[e - X], output=[X])
    (check,) = undefined_values(plant)
    assert (check.verdict, place in str(check.reason)) == ("refuted", True)
    assert "w = 0" not in str(check.reason).replace("cos(w) = 0", "").replace("sin(w) = 0", "")
