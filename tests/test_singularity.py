"""The singular set and the next jets, against determinants known in closed form."""

import random
import time
from dataclasses import replace

import pytest
import sympy as sp
from plants import model

import hgogen as hg
from hgogen.analysis.determinant import determinant, independent
from hgogen.analysis.maps import derivatives, input_derivatives, rates, time_derivative
from hgogen.analysis.singularity import singular_set, singularity
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.rigor.box import exact

X, Y, Z = sp.symbols("x y z", real=True)
SIGMA, RHO, BETA = sp.symbols("sigma rho beta", real=True)
LORENZ = [SIGMA * (Y - X), X * (RHO - Z) - Y, X * Y - BETA * Z]


def neuron() -> hg.System:
    return model("fitzhugh_nagumo")


# --- derivatives of inputs ----------------------------------------------------------------------------------


def test_a_derivative_is_a_signal_of_its_own() -> None:
    u = hg.Signal("u", "V", "drive", low=-1, high=1, rates=((-1, 1), (-2, 2)))
    first, second, third = (u.derivative(k) for k in (1, 2, 3))
    assert (first.name, first.unit, first.interval) == ("u_dot", "(V)/s", (-1, 1))
    assert (second.name, second.interval) == ("u_ddot", (-2, 2))
    assert not third.bounded
    assert "you supply it" in first.meaning
    assert u.derivative(0) is u
    assert u.derivative(1) == first


def test_the_time_derivative_moves_inputs_too() -> None:
    plant = neuron()
    flow = rates(plant, 2)
    x1, x2, _ = plant.states
    (u,) = plant.inputs
    chain = derivatives(x1, flow, 3)
    assert chain[1] == plant.flow[0]
    assert sp.expand(chain[2].diff(u.derivative(1)) + x2) == 0
    assert input_derivatives(chain, plant, 2) == (u.derivative(1),)
    assert time_derivative(sp.Integer(3), flow) == 0


# --- the neuron, as its paper has it ------------------------------------------------------------------------


def test_the_neuron_and_its_next_jets() -> None:
    analysis = singularity(neuron())
    (u,), (eps,) = neuron().inputs, neuron().parameters
    generic, first, second = analysis.jets
    assert sp.expand(generic.determinant + eps * u**2) == 0
    assert analysis.inputs == (u,)
    assert first.where == ((u, 0),)
    assert sp.expand(first.determinant + 2 * eps * u.derivative(1) ** 2) == 0
    assert first.rows == ((0, 0), (0, 2), (0, 3))
    assert second.where == ((u, 0), (u.derivative(1), 0))
    assert [check.verdict for check in analysis.checks] == [Verdict.WHERE] * 3
    assert "holds where u != 0" in str(analysis)
    assert r"- 2 eps \dot{u}^{2} && \text{at } u = 0" in analysis.latex()


def test_a_plant_without_singular_points_is_proved() -> None:
    (check,) = singularity(model("pendulum")).checks
    assert check.verdict is Verdict.PROVED


def tanks(low: float) -> hg.System:
    level, other = hg.Signal("x1", low=low, high=9), hg.Signal("x2", low=1, high=9)
    flow = [-sp.sqrt(level), sp.sqrt(level) - sp.sqrt(other)]
    return hg.System("tanks", states=(level, other), outputs=(hg.Signal("y"),), flow=flow, output=[other])


def test_a_pole_on_the_box_is_not_proved() -> None:
    """The determinant 1/(2 sqrt x1) has no zero, and no value at x1 = 0."""
    assert [singularity(tanks(low)).checks[0].verdict for low in (1, 0)] == [Verdict.PROVED, Verdict.WHERE]


@pytest.mark.parametrize("low", [-1, 0.5])
def test_a_pole_of_the_plant_that_a_derivative_loses_is_not_proved(low: float) -> None:
    """(x1 x3)' = x2 by x1' = x2/x3, x3' = 0, where x3 is not 0: no rate of x1 is there."""
    ranges = {"x1": (1, 2), "x2": (-1, 1), "x3": (low, 1)}
    x1, x2, x3 = x = [hg.Signal(name, low=least, high=most) for name, (least, most) in ranges.items()]
    plant = hg.System("hidden_pole", states=x, outputs=[hg.Signal("y")], flow=[x2 / x3, -x1, 0], output=[x1 * x3])
    (check, *_) = singularity(plant).checks
    assert check.verdict is (Verdict.WHERE if low < 0 else Verdict.PROVED)
    assert ("x3 != 0" in str(check.reason)) is (low < 0)


def test_a_kink_is_not_proved() -> None:
    x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
    plant = hg.System("kink", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[3 * x2 + sp.Abs(x2), 0], output=[x1])
    assert singularity(plant).checks[0].verdict is Verdict.UNKNOWN


ROUGH = [
    *(sp.sign(X), sp.Heaviside(X), sp.floor(X), sp.ceiling(X), sp.Abs(X), sp.Min(X, Y), sp.Max(X, Y)),
    sp.Piecewise((1, X > 0), (2, True)),
]


@pytest.mark.ordinary("2-rough0", "2-rough1", "3-rough1")
@pytest.mark.parametrize("rough", ROUGH)
@pytest.mark.parametrize("n", [2, 3])
def test_what_jumps_or_bends_is_not_known(rough: sp.Expr, n: int) -> None:
    """Its derivatives may be no functions; the question then has a sentence for an answer."""
    x = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, n + 1))
    slope = 2 + rough.subs({X: x[0], Y: x[1]})
    plant = hg.System("rough", states=x, outputs=(hg.Signal("y"),), flow=[slope * x[1], *x[2:], -x[0]], output=[x[0]])
    analysis = singularity(plant)
    (check,) = analysis.checks[:1]
    assert check.verdict is Verdict.UNKNOWN
    assert "has no derivative somewhere" in str(check.reason) or "may not be smooth" in str(check.reason)
    assert analysis.as_dict()["checks"][0]["verdict"] == "unknown"


def test_roots_that_depend_on_each_other_have_no_answer() -> None:
    """sqrt((x - 1)^2) is x - 1 on one side alone."""
    root = sp.sqrt(sp.expand((X - 1) ** 2))
    assert singular_set([Y * (root + X - 1), -X], [X], (X, Y)) is None
    assert singular_set([Y * sp.sqrt(2 - X), -X], [X], (X, Y)) == (X - 2,)


@pytest.mark.full
def test_long_sums_are_shown_short_and_kept_whole() -> None:
    analysis = singularity(load("induction_motor").plant)
    (check,) = analysis.checks
    assert "K**3*np*(M*al**3*ib + M*al*ib*np**2*w**2 + .., 13 terms)" in str(check.reason)
    assert len(str(check.reason)) < 250
    (whole,) = analysis.as_dict()["determinants"]
    assert whole.count(" + ") + whole.count(" - ") == 12
    assert sp.sympify(whole, locals={s.name: s for s in analysis.plant.signals}) == analysis.jets[0].determinant


@pytest.mark.parametrize(("low", "verdict"), [(1, Verdict.PROVED), (0, Verdict.WHERE)])
def test_a_power_that_is_a_symbol_is_its_own_factor(low: float, verdict: Verdict) -> None:
    x1, x2, a = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=low, high=2), hg.Signal("a", nominal=2.5)
    parts = {"states": (x1, x2), "outputs": (hg.Signal("y"),), "parameters": (a,)}
    plant = hg.System("power", **parts, flow=[x2**a, -x2], output=[x1])
    assert singularity(plant).checks[0].verdict is verdict


def test_too_large_a_matrix_is_left_alone() -> None:
    plant = neuron()
    first, second, _ = plant.states
    bent = replace(plant, output=[first + second**2])  # no chain, whose determinant needs no derivatives
    (check,) = singularity(bent, limit=20).checks
    assert check.verdict is Verdict.UNKNOWN
    assert "more than" in str(check.reason)


# --- expressions --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flow", "output", "zero_set"),
    [
        (LORENZ, [X], SIGMA * X),
        ([-Y - Z, X + BETA * Y, BETA + Z * (X - RHO)], [Y], "none"),
        ([-Y - Z, X + BETA * Y, BETA + Z * (X - RHO)], [X], X - RHO - BETA),
        ([Y, -sp.sin(X), Z], [X], "all"),
        ([-sp.sin(Y), sp.cos(X), sp.S.Zero], [X, Z], sp.cos(Y)),
        ([sp.sqrt(Y), -sp.sqrt(Y), sp.S.Zero], [X, Z], "none"),
        ([Y * sp.exp(-Y), -Y, sp.S.Zero], [X, Z], 1 - Y),
    ],
)
def test_known_singular_sets(flow: list[sp.Expr], output: list[sp.Expr], zero_set: sp.Expr | str) -> None:
    factors = singular_set(flow, output, (X, Y, Z))
    if isinstance(zero_set, str):
        assert factors == zero_set
    else:
        assert isinstance(factors, tuple)
        quotient = sp.simplify(sp.prod(factors) / zero_set)
        assert quotient.is_number
        assert quotient != 0


PLANTS = [
    (LORENZ, X + Z),
    ([Y * Z, sp.sin(X) - Z, X**2 / (1 + Y**2)], X * Y),
    ([sp.exp(Y) - Z, X * Z, sp.sqrt(X) - Y], X),
    ([sp.tanh(Y) * Z, X - Z, RHO * X / (SIGMA + Y)], X + Y**2),
    ([sp.cos(Y) + Z, Z * sp.sin(X), X - Z], X),
    ([Z * sp.sin(sp.Rational(33, 20) * sp.atan(Y)), Z - Y, sp.S.Zero], X),  # the force of a tyre by its slip Y
    ([Z * sp.exp(-20 * Y), Z - Y, sp.S.Zero], X),
]


@pytest.mark.ordinary("flow5-output5", "flow6-output6")
@pytest.mark.parametrize(("flow", "output"), PLANTS)
def test_the_elimination_is_the_determinant(flow: list[sp.Expr], output: sp.Expr) -> None:
    """Of the Lie derivatives written out: another way to the same factors."""
    chain = derivatives(output, dict(zip((X, Y, Z), flow, strict=True)), 3)
    factors = singular_set(flow, [output], (X, Y, Z))
    assert isinstance(factors, tuple)
    assert factors == determinant([[e.diff(x) for x in (X, Y, Z)] for e in chain]).factors


def test_no_more_than_a_limit_is_tried() -> None:
    flow, output = PLANTS[1]
    assert singular_set(flow, [output], (X, Y, Z), limit=20) is None


def test_inputs_are_off() -> None:
    """x' = u y, y' = 0: with u = 0 nothing is seen of y."""
    assert singular_set([RHO * Y, sp.S.Zero], [X], (X, Y), (RHO,)) == "all"


def test_rows_that_could_be_taken_in_two_ways_have_no_answer() -> None:
    """(y1, y2, y1') = (x, z, y) is regular, (y1, y1', y1'') = (x, y, z^2) is not."""
    assert singular_set([Y, Z**2, X], [X, Z], (X, Y, Z)) is None


def test_kinks_have_no_answer() -> None:
    assert singular_set([sp.Abs(Y), -Y], [X], (X, Y)) is None


POINT = {X: sp.Rational(5, 7), Y: sp.Rational(3, 8), Z: sp.Rational(11, 9)}


@pytest.mark.ordinary(
    "X - X, X, Y, sin(Z), X/(1 + Y**2), 0.5-1",
    "X - X, X, Y, sin(Z), X/(1 + Y**2), 0.5-2",
    "X - X, X, Y, sin(Z), X/(1 + Y**2), 0.5-3",
    "X - X, X, Y, sin(Z), X/(1 + Y**2), 0.5-4",
)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "entries", ["X - X, X, Y, sin(Z), X/(1 + Y**2), 0.5", "X, sqrt(X + 1), exp(Y), cos(X)*Z, 1, 2"]
)
def test_the_determinant_is_sympys(entries: str, n: int) -> None:
    draw, known = random.Random(n), sp.sympify(f"[{entries}]", locals={"X": X, "Y": Y, "Z": Z})
    rows = [[draw.choice(known) for _ in range(n)] for _ in range(n)]
    there = sp.Matrix(rows).applyfunc(lambda e: exact(e).subs(POINT)).det(method="berkowitz")
    assert abs((determinant(rows).value.subs(POINT) - there).evalf(40, maxn=500)) < 1e-30


def test_sine_and_cosine_are_related() -> None:
    assert determinant([[sp.cos(X), -sp.sin(X)], [sp.sin(X), sp.cos(X)]]).value == 1


@pytest.mark.parametrize(
    ("e", "value", "factors"),
    [
        (X**3 * sp.exp(Y) / (1 + Z), X**3 * sp.exp(Y) / (1 + Z), {X}),
        (sp.Integer(-5), -5, set()),
        (X**2 + 1, X**2 + 1, set()),
        (sp.sqrt(X) * (Y - Z) / 7, sp.sqrt(X) * (Y - Z) / 7, {X, Y - Z}),
        (X * sp.sqrt(X + 1), X * sp.sqrt(X + 1), {X, X + 1}),
        ((X - 1) / (sp.sqrt(X) - 1), sp.sqrt(X) + 1, set()),
        (sp.sin(X) / (1 + sp.cos(X)), sp.sin(X) / (1 + sp.cos(X)), {sp.cos(X) - 1}),
        (sp.tan(X), sp.sin(X) / sp.cos(X), {sp.sin(X)}),
        (sp.sin(X) ** 3 * sp.cos(Y), sp.sin(X) ** 3 * sp.cos(Y), {sp.sin(X), sp.cos(Y)}),
        (1 / sp.sin(X), 1 / sp.sin(X), set()),
        (sp.sin(X) ** 2 + sp.cos(X) ** 2 - 1, 0, {sp.S.Zero}),
        (sp.sin(X) + 2, sp.sin(X) + 2, set()),
        (sp.log(X) * Y, sp.log(X) * Y, {Y, sp.log(X)}),
        ((X * Y - Z) * sp.sqrt(X + 1), (X * Y - Z) * sp.sqrt(X + 1), {X * Y - Z, X + 1}),
    ],
)
def test_values_and_where_they_are_zero(e: sp.Expr, value: sp.Expr, factors: set[sp.Expr]) -> None:
    result = determinant([[e]])
    assert result.value == value
    assert result.factors is not None
    assert set(result.factors) == factors


G = sp.sqrt(X**2 + Y**2)


@pytest.mark.parametrize("e", [X**Y, (G - Y) / X, (X**2 + Y**2 - 1) / (G - 1)])
def test_where_a_value_is_zero_is_not_always_known(e: sp.Expr) -> None:
    """x^y may be 0 at x = 0; whether a root's zero cancels a pole is not asked: the last is g + 1, never 0."""
    assert determinant([[e]]).factors is None
    assert determinant([[G * Z]]).factors == (Z, X**2 + Y**2)


def test_half_a_turn_counts() -> None:
    """tan(x/2) is infinite where sin x and 1 + cos x are 0."""
    assert determinant([[1 + sp.cos(X)]]).factors == (sp.cos(X) + 1,)
    assert determinant([[sp.cos(X), sp.sin(X)], [sp.sin(X), -sp.cos(X)]]).value == -1


def test_rows_that_depend_on_others_are_left_out() -> None:
    rows = {
        "a": [X, Y],
        "b": [2 * X * Z, 2 * Y * Z],
        "c": [X - X, sp.sin(X) ** 2 + sp.cos(X) ** 2 - 1],
        "d": [Y, X],
    }
    assert independent(rows, 2) == ("a", "d")


@pytest.mark.full
def test_twenty_states_are_left_alone_in_time() -> None:
    """Few different nodes, but half a million as they are written out; 1.5 s of processor time. Of a chain,
    whose output reads one state, the determinant is known without them."""
    x = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in range(20))
    flow = [x[i + 1] + sp.sin(x[i]) * x[0] for i in range(19)] + [sum(map(sp.cos, x))]
    begin = time.process_time()
    for output, verdict in ((x[0], "proved"), (x[0] + x[1] ** 2, "unknown")):
        plant = hg.System("chain", states=x, outputs=(hg.Signal("y"),), flow=flow, output=[output])
        (check,) = hg.singularity(plant).checks
        assert check.verdict == verdict
    assert time.process_time() - begin < 30
    assert "too large" in str(check.reason)


@pytest.mark.full
def test_a_long_factor_is_not_asked_about_on_all_of_space() -> None:
    """Boxes without ends cost seconds a factor, and tell nothing of hundreds of terms."""
    draw, p = random.Random(4), sp.symbols("p1:25", real=True)
    long = sum(draw.randint(1, 9) * sp.Mul(*draw.choices(p, k=9)) for _ in range(400))
    began = time.process_time()
    assert singular_set([long * Y, sp.S.Zero], [X], [X, Y]) == (long,)
    assert time.process_time() - began < 8
