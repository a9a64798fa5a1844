"""That what a method leaves follows from a plant: its series, known answers, and forged numbers."""

import copy
import json
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import cache, partial
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import model

import hgogen as hg
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import RK4
from hgogen.prove.method_error import StageDeviation
from hgogen.prove.plant_step import PlantStep
from hgogen.recheck.arithmetic import Dual, Undefined, dual, evaluate
from hgogen.recheck.inequality import Tableau, tableau_of
from hgogen.recheck.interval import Interval, Taylor, between, point, taylor
from hgogen.recheck.plant_motion import PlantSeries
from hgogen.recheck.text import expression
from hgogen.recheck.verification import recheck

ORDER = 6
AT = {"acosh": Fraction(3, 2), "log": Fraction(3, 2), "atan2": Fraction(3, 2)}
NAMES = (
    *("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)


def coefficients(text: str, start: Interval) -> tuple[Interval, ...]:
    """Those of a function of t = start + s."""
    none = point(Fraction(0))
    t = Taylor((start, point(Fraction(1)), *[none] * (ORDER - 2)))
    value: Taylor = evaluate(expression(text, {"t"}), {"t": t}, taylor(ORDER))
    return value.coefficients


def real(number: Fraction) -> Any:
    return mpmath.mpf(number.numerator) / number.denominator


def holds(interval: Interval, value: Any) -> bool:
    low, high = (real(Fraction(end)) for end in interval.exactly)
    return bool(low - mpmath.mpf(10) ** -18 <= value <= high + mpmath.mpf(10) ** -18)


def of_inner(function: Callable[[Any], Any], t: Any) -> Any:
    return function(t / 2 + t * t / 3)


INNER = "t/2 + t**2/3"
TEXTS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    **{name: (f"{name}({INNER})", partial(of_inner, getattr(mpmath, name))) for name in NAMES},
    "atan2": ("atan2(t**2, 1 - t)", lambda t: mpmath.atan2(t * t, 1 - t)),
    "Abs": ("Abs(-t**3)", lambda t: t**3),
    "sign": ("t*sign(-t)", lambda t: -t),
    "Max": ("Max(t - 9, t**2, 0)", lambda t: t * t),
    "Min": ("Min(t + 9, t**2)", lambda t: t * t),
    "power": (f"({INNER})**(-3)", lambda t: (t / 2 + t * t / 3) ** -3),
    "raise": ("(1 + t)**t", lambda t: (1 + t) ** t),
}


@pytest.mark.parametrize("name", TEXTS)
def test_series_of_functions_hold_those_of_mpmath(name: str) -> None:
    """Of mpmath's own Taylor coefficients, at a point and at points of an interval."""
    text, function = TEXTS[name]
    begin = AT.get(name, Fraction(1, 2))
    wide = coefficients(text, between(begin, begin + Fraction(1, 5)))
    with mpmath.workdps(40):
        for share in (Fraction(0), Fraction(1, 3), Fraction(1)):
            at = begin + share / 5
            wanted = mpmath.taylor(function, real(at), ORDER - 1)
            own = coefficients(text, point(at))
            assert all(map(holds, own, wanted))
            assert all(map(holds, wide, wanted))
            ends = [x.exactly for x in own]
            assert max(float(Fraction(high) - Fraction(low)) for low, high in ends) < 1e-15


@pytest.mark.parametrize("text", ["Abs(t)", "sign(t)", "Max(t, 0)", "sqrt(t)", "1/t", "atan2(t, t)", "asin(1 - t)"])
def test_where_there_may_be_no_series_there_is_none(text: str) -> None:
    with pytest.raises(Undefined):
        coefficients(text, between(0, 1))


CURVE = "0, 0, 1, 1, 2, 4"  # with slopes of 0, 3/2 and 4 by Fritsch and Butland
GRID = "3, -2, 0, 2, -3, -1, 1, 5, 5, 1, 1, 2, 1, 3, 6, 1"  # 1, 2, 3, 6 from 0 to 2 and from -3 to -1
PIECES = {
    "a line": ("Linear(x, 0, 0, 7, 1, 2, 3, 3)", "2 + (x - 1)/2", (1, 3)),
    "the slope of a line": ("Linear(x, 1, 0, 7, 1, 2, 3, 3)", "1/2 + 0*x", (1, 3)),
    "before a line": ("Linear(x, 0, 2, 7, 3, 9)", "7 + 0*x", (0, 2)),
    "beyond a cubic": (f"Monotone(x, 0, {CURVE})", "4 + 0*x", (2, 4)),
    "the first cubic": (f"Monotone(x, 0, {CURVE})", "x**2*3/2 - x**3/2", (0, 1)),
    "the last cubic": (f"Monotone(x, 0, {CURVE})", "1 + (x - 1)*3/2 + (x - 1)**2*2 - (x - 1)**3/2", (1, 2)),
    "the slope of a cubic": (f"Monotone(x, 1, {CURVE})", "3*x - x**2*3/2", (0, 1)),
    "a map": (f"Bilinear(x, 2*x - 3, 0, 0, {GRID})", "1 + 2*x + x**2", (0, 1)),
    "the slope of a map along x": (f"Bilinear(x, 2*x - 3, 1, 0, {GRID})", "1 + x", (0, 1)),
    "the slope of a map along y": (f"Bilinear(x, 2*x - 3, 0, 1, {GRID})", "1/2 + x/2", (0, 1)),
    "beside a map": (f"Bilinear(x, x/4 + 1, 0, 0, {GRID})", "1 + 0*x", (0, 1)),
}
MOVES = tuple(map(point, (Fraction(3, 4), Fraction(1, 20), Fraction(-1, 50), Fraction(0), Fraction(1, 7))))


def along(text: str, start: Interval) -> Dual:
    """That of x = start + 3 s/4 + .., with its slope in x."""
    x = Dual(Taylor((start, *MOVES)), {0: taylor(ORDER).number(Fraction(1))})
    value: Dual = evaluate(expression(text, {"x"}), {"x": x}, dual(taylor(ORDER)))
    return value


@pytest.mark.parametrize("name", PIECES)
def test_a_table_on_one_piece_has_the_series_of_its_polynomial(name: str) -> None:
    """At points of the piece, and in intervals that hold these."""
    table, polynomial, (low, high) = PIECES[name]
    first, *between_them, last = (low + (high - low) * Fraction(share, 8) for share in (1, 3, 7))
    wide = along(table, between(first, last))
    for at in (first, *between_them, last):
        own, wanted = along(table, point(at)), along(polynomial, point(at))
        pairs = [*zip(own.value.coefficients, wanted.value.coefficients, wide.value.coefficients, strict=True)]
        pairs += zip(*(x.slopes[0].coefficients for x in (own, wanted, wide)), strict=True)
        for each in pairs:
            (value, _), (exact, _), (least, most) = (x.exactly for x in each)
            assert float(value) == pytest.approx(float(exact), rel=1e-15, abs=1e-20)
            assert least <= value <= most


EDGES = {
    "Linear": ("Linear(t, {0}, 0, 0, 1, 1, 3, 0)", 1),
    "Monotone": (f"Monotone(t, {{0}}, {CURVE})", 1),
    "the end of Monotone": (f"Monotone(t, {{0}}, {CURVE})", 2),
    "along x": (f"Bilinear(t, 0, {{0}}, 0, {GRID})", 2),
    "along y": (f"Bilinear(-1, t, 0, {{0}}, {GRID})", -1),
}


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("name", EDGES)
def test_a_table_that_may_be_at_one_of_its_points_has_no_series(name: str, order: int) -> None:
    """Not on one side of it either, where a bisection may end: a jump there would be on neither box."""
    text, at = EDGES[name]
    text, little = text.format(order), Fraction(1, 10**9)
    for below, above in ((0, 1), (-1, 0), (0, 0), (-1, 1)):
        with pytest.raises(Undefined):
            coefficients(text, between(at + below * little, at + above * little))
    for below, above in ((1, 2), (-2, -1)):
        assert all(x.finite for x in coefficients(text, between(at + below * little, at + above * little)))


def test_an_even_power_of_what_may_be_zero_is_not_negative() -> None:
    assert [x.exactly for x in coefficients("t**2", between(-1, 2))][:3] == [(0, 4), (-2, 4), (1, 1)]


# --- of the flow and of a step ----------------------------------------------------------------------------------------


def plant(flow: Mapping[str, str], box: Mapping[str, tuple[Fraction, Fraction]], **rates: int) -> PlantSeries:
    rows = [expression(text, box) for text in flow.values()]
    whole = {name: (low - 2, high + 2) for name, (low, high) in box.items()}
    return PlantSeries(rows, tuple(flow), {u: Fraction(rate) for u, rate in rates.items()}, box, whole)


def at(*ends: int) -> tuple[Fraction, Fraction]:
    return Fraction(ends[0]), Fraction(ends[-1])


def test_a_parabola_has_no_third_coefficient_and_heuns_step_one() -> None:
    """x' = sqrt(x) from 1: 1 + s + s^2/4, and by Heun's method less s^3/16 ..."""
    root = plant({"x": "sqrt(x)"}, {"x": at(1)})
    assert [float(Fraction(x.exactly[1])) for x in root.flow(4)[0]] == pytest.approx([1, 1, 0.25, 0], abs=1e-20)
    last = root.step(tableau_of({"method": "Heun"}), Fraction(0), 4)[-1][0].coefficients
    assert [float(Fraction(x.exactly[0])) for x in last] == pytest.approx([1, 1, 0.25, -1 / 16])


def test_an_input_moves_at_up_to_its_rate_both_ways() -> None:
    """x'' = u' - x' = u' - u + x; a stage reads what the input has moved by then."""
    driven = plant({"x": "u - x"}, {"x": at(0), "u": at(3)}, u=5)
    assert [float(Fraction(end)) for end in driven.flow(3)[0][2].exactly] == [-4, 1]
    stages = driven.step(tableau_of({"method": "classical Runge-Kutta"}), Fraction(0), 3)
    second, fourth = ([float(Fraction(end)) for end in stages[i][0].coefficients[2].exactly] for i in (2, 3))
    assert second == [(-2.5 - 1.5) / 2, (2.5 - 1.5) / 2]  # k_2 = u + u' s/2 - s u/2 + ..
    assert fourth == [-2.5 - 1.5, 2.5 - 1.5]


def step_at(tableau: Tableau, x: Sequence[float], u: float, rate: float, length: Any) -> list[list[Any]]:
    """The stages of a step from x, and its end, of the pendulum q'' = u - 3 sin q - q'/5 whose input moves."""
    slopes, stages = list[list[Any]](), list[list[Any]]()
    for weights, node in zip((*tableau.rows, tableau.weights), (*tableau.nodes, Fraction(1)), strict=True):
        pairs = list(zip(weights, slopes, strict=False))
        q, w = (mpmath.mpf(x0) + length * sum(real(a) * k[i] for a, k in pairs) for i, x0 in enumerate(x))
        stages.append([q, w])
        slopes.append([w, u + rate * real(node) * length - 3 * mpmath.sin(q) - w / 5])
    return stages


@pytest.mark.parametrize("wide", [0, 1])
@pytest.mark.parametrize("method", ["Euler", "Heun", "classical Runge-Kutta"])
def test_coefficients_of_a_step_hold_those_of_every_point_and_length(method: str, wide: int) -> None:
    box = {"q": at(1, 1 + wide), "w": at(-1, wide - 1), "u": at(0, wide)}
    tableau, h, rng = tableau_of({"method": method}), Fraction(1, 4), np.random.default_rng(1)
    known = plant({"q": "w", "w": "u - 3*sin(q) - w/5"}, box, u=2).step(tableau, h, 5)
    with mpmath.workdps(30):
        for length in (0, 0.1, 0.2, 0.25):
            x, u = (1 + wide * rng.uniform(), wide * rng.uniform() - 1), wide * rng.uniform()
            for stage, series in enumerate(known):
                for i in (0, 1):
                    here = partial(_part, step_at, (tableau, x, u, rng.choice([-2, 2])), (stage, i))
                    assert all(map(holds, series[i].coefficients, mpmath.taylor(here, length, 4)))


def _part(step: Any, arguments: Any, place: tuple[int, int], length: Any) -> Any:
    return step(*arguments, length)[place[0]][place[1]]


def test_coefficients_of_the_flow_hold_those_of_every_point() -> None:
    """Of q'' = u - 3 sin q - q'/5 by SymPy."""
    q, w, u, r = sp.symbols("q w u r")
    box, rng = {"q": at(0, 1), "w": at(-1, 1), "u": at(0, 1)}, np.random.default_rng(2)
    known = plant({"q": "w", "w": "u - 3*sin(q) - w/5"}, box, u=2).flow(5)
    rate, x = {q: w, w: u - 3 * sp.sin(q) - w / 5, u: r}, {q: q, w: w}
    for k in range(5):
        for _ in range(5):
            place = {q: rng.uniform(0, 1), w: rng.uniform(-1, 1), u: rng.uniform(0, 1), r: rng.choice([-2, 2])}
            values = [mpmath.mpf(str(x[z].subs(place).evalf(20))) / math.factorial(k) for z in (q, w)]
            assert all(holds(series[k], value) for series, value in zip(known, values, strict=True))
        x = {z: sum(sp.diff(each, name) * moves for name, moves in rate.items()) for z, each in x.items()}


def test_an_input_stays_in_its_range() -> None:
    """x' = u, which is at 1 after any step up to 1/2 whatever it has moved."""
    rows, box = [expression("u", {"x", "u"})], {"x": at(0), "u": at(1)}
    still = PlantSeries(rows, ("x",), {"u": Fraction(5)}, box, box).step(
        tableau_of({"method": "Heun"}), Fraction(1, 2), 2
    )
    assert still[-1][0].coefficients[0].exactly == (0, Fraction(1, 2))


# --- in a certificate -------------------------------------------------------------------------------------------------

Content = dict[str, Any]


def of_pendulum(h: float) -> StageDeviation:
    return StageDeviation(PlantStep(hg.forms.triangular(model("pendulum")), Fraction(h), (Fraction(5),)), RK4)


def test_the_line_of_the_pendulum() -> None:
    """h^2 sup|y''|/4, y'' = u - 19.6 sin q - 0.1 w, at most 22.6."""
    for h, wanted in ((0.001, 5.65e-6), (0.02, 0.00226)):
        assert float(max(of_pendulum(h).line(0))) == pytest.approx(wanted, rel=2e-3)


@cache
def certified(method: str = "rk4", between: str = "line", shape: str = "swing") -> Content:
    """Of the high-gain observer of two states, half the first of which is measured; u moves at up to 5."""
    x1, x2, u = (hg.Signal(name, low=-most, high=most) for name, most in (("x1", 1), ("x2", 2), ("u", 1)))
    flow = {
        "swing": sp.sin(3 * x1),
        "round": sp.atan2(x1, 2) + sp.Abs(x1 + 2),
        "fall": 3 + x1**2,
        "line": hg.table(x1, [-5, 5], [-1, 1]),
        "curve": hg.table(x1, [-3, -1.5, 1.5, 3], [-2, -1, 1, 2.5], kind="monotone"),
        "map": hg.table((x1, x2), ([-5, -2, 2, 5], [-9, -6, 6]), [[0, 0, 0], [0, -2, 4], [0, 3, -1], [0, 9, 0]]),
    }
    plant = hg.System(
        "plant", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=[x2, u - flow[shape]], output=[x1 / 2]
    )
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=12, poles=(-1, -1))
    step = hg.sample(observer, getattr(hg.methods, method), dt=0.01, between=between)
    known = hg.error_bound(step, noise={"y": 1e-3}, rates={"u": 5})
    assert known.check.verdict is Verdict.PROVED, known
    return hg.certificate(observer.form, (*observer.checks, known.check), "high_gain")


def evidence(content: Content) -> Any:
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    return claim["evidence"]


def row(content: Content) -> Any:
    (one,) = (each for each in recheck(sealed(content)).rows if each.id.endswith(".error"))
    return one


@pytest.mark.ordinary(
    "rk4-line-swing-what the method leaves as u moves at up to 5 move",
    "heun-line-swing-as u moves at up to 5 move",
    "euler-hold-swing-as u moves at up to 0 move",
    "rk4-line-round-as u moves at up to 5 move",
    "rk4-line-line-as u moves at up to 5 move",
    "rk4-line-curve-as u moves at up to 5 move",
    "euler-hold-map-as u moves at up to 0 move",
)
@pytest.mark.parametrize(
    ("method", "between", "shape", "said"),
    [
        ("rk4", "line", "swing", "what the method leaves as u moves at up to 5 move"),
        ("heun", "line", "swing", "as u moves at up to 5 move"),
        ("euler", "hold", "swing", "as u moves at up to 0 move"),
        ("rk4", "line", "round", "as u moves at up to 5 move"),
        ("rk4", "line", "line", "as u moves at up to 5 move"),
        ("heun", "line", "curve", "as u moves at up to 5 move"),
        ("rk4", "line", "curve", "as u moves at up to 5 move"),
        ("euler", "hold", "map", "as u moves at up to 0 move"),
        ("rk4", "line", "map", "as u moves at up to 5 move"),
    ],
)
def test_what_a_method_leaves_is_verified_again(method: str, between: str, shape: str, said: str) -> None:
    one = row(certified(method, between, shape))
    assert one.found == "verified", one.sentence
    assert said in one.sentence
    assert "while the plant keeps clear of the ends of its ranges by 0.0200001 in z1, 0.0" in one.sentence


def test_a_table_that_is_read_across_a_point_fails() -> None:
    """Where its slope falls from 1/5 to 1/10, so that the plant is no steeper, but bends in no time."""
    text = json.dumps(certified(shape="line"))
    assert text.count("-5, -1, 5, 1)") == 2  # in the plant and in the form
    known = recheck(sealed(json.loads(text.replace("-5, -1, 5, 1)", "-5, -1, 0, 0, 5, 1/2)"))))
    assert {each.id for each in known.rows if each.found != "verified"} == {"high_gain.error"}


def test_without_its_share_the_sentence_says_so() -> None:
    content = copy.deepcopy(certified())
    evidence(content)["shares"].pop()
    one = row(content)
    assert one.found == "verified"
    assert one.sentence.endswith("in all, beside what the method leaves")


def test_what_is_said_of_a_plant_that_an_input_moves_more_slowly_is_of_that() -> None:
    content = copy.deepcopy(certified())
    evidence(content)["shares"][1]["follows"]["rates"] = ["4"]
    assert "as u moves at up to 4 move" in row(content).sentence


LIES = (
    *((("stages", 0, i), "999/1000") for i in (1, 2, 3)),
    *((("beside", i), "999/1000") for i in (0, 1)),
    *((("follows", "speeds", i), "99/100") for i in (0, 1)),
    (("follows", "speeds", 1), "11/10"),
    (("follows", "slopes", 0, 1), "999/1000"),
    (("follows", "slopes", 0, 1), "1001/1000"),
    *((("follows", "lines", 0, i), "1/4") for i in (0, 1)),
    *((("follows", key, i), factor) for key in ("flow", "step") for i in (0, 1) for factor in ("1/4", "1001/1000")),
    *((("follows", key, 0), "-1") for key in ("rates", "speeds", "flow", "step")),
    (("follows", "rates", 0), "2"),
)


@pytest.mark.parametrize("shape", ["swing", "curve", "map"])
@pytest.mark.parametrize(("path", "factor"), LIES)
def test_a_forged_number_of_the_share_fails(path: Sequence[Any], factor: str, shape: str) -> None:
    content = copy.deepcopy(certified(shape=shape))
    holder: Any = evidence(content)["shares"][1]
    for key in path[:-1]:
        holder = holder[key]
    assert Fraction(holder[path[-1]]) > 0
    holder[path[-1]] = str(Fraction(holder[path[-1]]) * Fraction(factor))
    assert row(content).found == "fails"


def test_a_coefficient_that_is_below_zero_counts() -> None:
    """x1'' = u - 3 - x1^2 is never above -2."""
    content = copy.deepcopy(certified("euler", "hold", "fall"))
    assert row(content).found == "verified"
    flow = evidence(content)["shares"][1]["follows"]["flow"]
    flow[0] = str(Fraction(flow[0]) / 4)
    assert row(content).found == "fails"


@pytest.mark.parametrize("key", ["rates", "speeds", "slopes", "lines", "flow", "step"])
def test_what_is_left_out_fails(key: str) -> None:
    content = copy.deepcopy(certified())
    del evidence(content)["shares"][1]["follows"][key]
    assert row(content).found == "fails"


@pytest.mark.parametrize("nothing", [{}, None, ["rates", "speeds", "slopes", "lines", "flow", "step"]])
@pytest.mark.parametrize("shape", ["swing", "curve"])
def test_a_share_that_follows_from_nothing_fails(shape: str, nothing: Any) -> None:
    content = copy.deepcopy(certified(shape=shape))
    evidence(content)["shares"][1]["follows"] = nothing
    assert row(content).found == "fails"


def test_a_slope_that_is_said_below_zero_fails() -> None:
    content = copy.deepcopy(certified())
    evidence(content)["shares"][1]["follows"]["slopes"][0][2] = "-1/1000"
    assert row(content).found == "fails"


def test_a_smaller_share_and_what_it_follows_from_fail_together() -> None:
    """The sizes of the rest of the share are as they would follow."""
    content = copy.deepcopy(certified())
    share = evidence(content)["shares"][1]
    for rows in (share["follows"]["flow"], share["follows"]["step"], share["beside"]):
        rows[:] = [str(Fraction(x) / 4) for x in rows]
    assert row(content).found == "fails"
