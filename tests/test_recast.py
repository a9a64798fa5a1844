"""A change of coordinates is proved only where it is one: defined, smooth, inverse, into the declared ranges."""

import casadi as ca
import numpy as np
import pytest
import sympy as sp

from hgogen import dissipation, error_system, forms, observers, recast, singularity
from hgogen.check import Check, Refuted, Verdict, demand
from hgogen.signal import Signal
from hgogen.system import BadSystem, System

u, y = Signal("u", low=-1, high=1), Signal("y")
k, c = Signal("k", nominal=0.5, low=-1, high=1), Signal("c", nominal=2)
X1 = Signal("x1", low=0.25, high=10)


def plant(x: Signal) -> System:
    """x1' = x1 - x2, x2' = k + u + c for x2 = x: of everything."""
    first = Signal("first", low=-1, high=1)
    flow = [x - first, k + u + c]
    return System("two", states=(first, x), inputs=[u], outputs=[y], parameters=[k, c], flow=flow, output=[first])


def checks_of(x: Signal, w: Signal, forward: sp.Expr, inverse: sp.Expr) -> dict[str, Check]:
    return {check.id: check for check in recast(plant(x), {w: forward}, {x: inverse}).checks}


def ranged(name: str, low: float | None = None, high: float | None = None) -> Signal:
    return Signal(name, low=low, high=high)


def maps(text: str, low: float, high: float, inverse: str, *range_of_w: float) -> dict[str, Check]:
    """The checks of w = text of x1 in [low, high], x1 = inverse of w in its range (none: without one)."""
    x, w = ranged("x1", low, high), ranged("w", *range_of_w)
    names = {"x1": x, "w": w, "k": k, "c": c}
    return checks_of(x, w, sp.sympify(text, names), sp.sympify(inverse, names))


@pytest.mark.parametrize(
    ("text", "low", "high", "inverse", "range_of_w"),
    [
        ("sqrt(x1)", 0.25, 10, "w**2", (0.5, 3.1623)),  # sqrt(10) = 3.16227766
        ("log(x1)", 1, 5, "exp(w)", (0, 1.6095)),  # log(5) = 1.6094379
        ("exp(x1)", -1, 1, "log(w)", (0.3678, 2.7183)),
        ("1/x1", 0.5, 4, "1/w", (0.25, 2)),
        ("x1**3", 1, 2, "cbrt(w)", (1, 8)),
        ("2*x1 + 1", -1, 3, "(w - 1)/2", (-1, 7)),
        ("c*x1", -1, 3, "w/c", (-2, 6)),
        ("x1 + k", -1, 3, "w - k", (-2, 4)),
        ("Abs(x1)", 1, 2, "w", (1, 2)),
        ("2*x1", -1, 3, "w/2", ()),
        ("x1", 0, 0.3, "w", (0, 0.3)),  # the decimal 0.3, not the double below it
        ("-x1", 1, 3, "-w", (-3, -1)),
    ],
)
def test_a_change_of_coordinates_is_proved(
    text: str, low: float, high: float, inverse: str, range_of_w: tuple[float, ...]
) -> None:
    checks = maps(text, low, high, inverse, *range_of_w)
    assert {id: check.verdict.value for id, check in checks.items()} == {
        "recast.inverse": "proved",
        "recast.range": "proved",
    }


@pytest.mark.parametrize(
    ("text", "low", "high", "inverse", "range_of_w", "verdict", "witness"),
    [
        ("log(x1)", -5, 5, "exp(w)", (-3, 2), "refuted", {"x1": 0.0}),
        ("1/x1", -1, 1, "1/w", (-9, 9), "refuted", {"x1": 0.0}),
        ("x1**3", 0, 1, "cbrt(w)", (-3, 3), "refuted", {"w": -3.0}),  # complex
        ("k*x1", 1, 2, "w/k", (-2, 2), "refuted", {"k": 0.0}),
        ("x1**2", -1, 1, "sqrt(w)", (0, 1), "refuted", {"x1": -1.0}),
        ("2*x1", 1, 2, "w/3", (1, 5), "refuted", {}),
        ("sqrt(x1)", 0, 4, "w**2", (0, 2), "unknown", {}),  # defined, but with no slope at 0
        ("x1 + Min(x1, 0)", -1, 1, "Max(w, 0) + Min(w, 0)/2", (-2, 1), "unknown", {}),
        ("Abs(x1)", -1, 1, "w", (0, 1), "refuted", {"x1": -1.0}),
        ("log(x1)", None, None, "exp(w)", (-3, 2), "unknown", {}),
    ],
)
def test_an_inverse_that_fails_somewhere_is_not_proved(
    text: str,
    low: float,
    high: float,
    inverse: str,
    range_of_w: tuple[float, ...],
    verdict: str,
    witness: dict[str, float],
) -> None:
    check = maps(text, low, high, inverse, *range_of_w)["recast.inverse"]
    assert check.verdict == verdict
    assert {name: check.witness.get(name) for name in witness} == witness
    assert check.fix


@pytest.mark.parametrize(
    ("text", "low", "high", "inverse", "range_of_w", "verdict", "fix"),
    [
        ("2*x1", 0.1, 10, "w/2", (5, 9), "refuted", "at least [0.2, 20]"),
        ("sqrt(x1)", 0.25, 10, "w**2", (0.5, 3.1622), "refuted", "at least [0.5, 3.1623]"),
        ("log(x1)", 1, 5, "exp(w)", (0.1, 2), "refuted", "at least [0, 1.6095]"),
        ("k + x1", 0, 1, "w - k", (-0.5, 2), "refuted", "at least [-1, 2]"),
        ("2*x1", None, None, "w/2", (5, 9), "unknown", "Declare low= and high= for x1."),
    ],
)
def test_an_image_outside_the_declared_range_is_found(
    text: str, low: float, high: float, inverse: str, range_of_w: tuple[float, ...], verdict: str, fix: str
) -> None:
    check = maps(text, low, high, inverse, *range_of_w)["recast.range"]
    assert check.verdict == verdict
    assert fix in check.fix
    assert bool(check.witness) == (verdict == "refuted")


def test_the_advice_on_the_range_is_good_advice() -> None:
    for low, high in ((0.5, 3.1622), (1, 2)):
        assert maps("sqrt(x1)", 0.25, 10, "w**2", low, high)["recast.range"].verdict == "refuted"
    assert maps("sqrt(x1)", 0.25, 10, "w**2", 0.5, 3.1623)["recast.range"].verdict == "proved"


def test_two_states_at_once() -> None:
    a, b = ranged("a", 1, 2), ranged("b", -1, 1)
    s, d = ranged("s", 0, 3), ranged("d", 0, 3)
    turn = System("turn", states=(a, b), outputs=[y], flow=[b, -a], output=[a])
    checks = recast(turn, {s: a + b, d: a - b}, {a: (s + d) / 2, b: (s - d) / 2}).checks
    assert [check.verdict.value for check in checks] == ["proved", "proved"]


def test_a_refuted_change_is_not_built_on() -> None:
    w = ranged("w", 5, 9)
    form = forms.triangular(recast(plant(X1), {w: 2 * X1}, {X1: w / 2}))
    with pytest.raises(Refuted, match=r"recast\.range"):
        demand(form.checks)
    demand(form.checks, accept="recast.range")


@pytest.mark.parametrize(
    ("inverse", "range_of_w", "claim"),
    [(2, (-2, 2), ""), (3, (-2, 2), "recast.inverse"), (2, (-1, 1), "recast.range")],
)
def test_nothing_is_concluded_of_a_plant_by_a_refuted_change(
    inverse: int, range_of_w: tuple[float, float], claim: str
) -> None:
    """x2 is 0.9 where w is 1.8, in no range of the new plant: a claim on its box says nothing of x2 there."""
    x, w = ranged("x2", -1, 1), ranged("w", *range_of_w)
    still = System("still", states=(X1, x), outputs=[y, c], flow=[-X1, -x], output=[X1, x])
    moved = recast(still, {w: 2 * x}, {x: w / inverse})
    dissipated = dissipation(error_system(moved, [[0, 0], [0, 0]]), [[2, 0], [0, 2]], mu=10, within=[1, 1])
    determined, *_ = singularity(moved).checks
    assert dissipated.proved is (determined.verdict is Verdict.PROVED) is (not claim)
    if claim:
        assert claim in str(dissipated.checks[1].reason)
        assert claim in str(determined.reason)


@pytest.mark.parametrize(
    ("forward", "inverse", "says"),
    [
        ((2 + u) * X1, Signal("w") / (2 + u), "w = x1*(u + 2) reads the input u"),
        (2 * X1, Signal("w") / 2 + u * 0 + sp.sin(u), "x1 = w/2 + sin(u) reads the input u"),
        (2 * X1 + Signal("stranger"), Signal("w") / 2, "reads stranger"),
        (2 * X1, X1, "x1 = x1 reads x1"),
        (X1 + sp.sign(X1 - 1), Signal("w"), "w = x1 + sign(x1 - 1) jumps, so that it has no rate there"),
        (sp.Heaviside(X1 - 1) + X1, Signal("w"), "jumps"),
        (sp.floor(X1), Signal("w"), "w = floor(x1) jumps"),
    ],
)
def test_coordinates_are_of_states_and_parameters(forward: sp.Expr, inverse: sp.Expr, says: str) -> None:
    with pytest.raises(BadSystem) as error:
        recast(plant(X1), {Signal("w"): forward}, {X1: inverse})
    assert says in str(error.value)


def test_numbers_are_the_decimals_that_they_are_typed_as() -> None:
    """0.1 times 0.1 in floats is 0.010000000000000002: of another plant, as a certificate would say."""
    a, b = ranged("a", -1, 1), ranged("b", -1, 1)
    w, v = ranged("w", -0.1, 0.1), ranged("v", -0.01, 0.01)
    plant = System("plant", states=(a, b), outputs=[y], flow=[0.7 * b - a, 0.1 * sp.sin(3.3 * b)], output=[0.7 * b])
    moved = recast(plant, {w: 0.1 * b}, {b: 10.0 * w})
    assert moved.flow == (7 * w - a, sp.sin(33 * w) / 100)
    assert moved.output == (7 * w,)
    assert recast(moved, {v: 0.1 * w}, {w: 10.0 * v}).flow == (70 * v - a, sp.sin(330 * v) / 1000)


def test_a_new_state_has_a_name_of_its_own() -> None:
    """Of one called like a state that is reported a bound would go by the name of both, and of one that is that state
    itself the flow would mix the old one with the new."""
    a, b = ranged("a", -1, 1), ranged("b", -1, 1)
    turn = System("turn", states=(a, b), outputs=[y], flow=[b, -a - b**3], output=[a])
    other, w = ranged("b", -2, 2), ranged("w", -2, 2)
    moved = recast(turn, {w: 2 * b}, {b: w / 2})
    for one, coordinates, inverse in (
        (turn, {a: (a + b) / 2, b: (a - b) / 2}, {a: a + b, b: a - b}),
        (turn, {other: 2 * b}, {b: other / 2}),
        (moved, {other: w}, {w: other}),
    ):
        with pytest.raises(BadSystem, match="has the name of one of its states"):
            recast(one, coordinates, inverse)


def test_coordinates_of_a_form_are_not_called_as_a_state_that_is_reported() -> None:
    a, z2, w = ranged("a", -1, 1), ranged("z2", 1, 3), ranged("w", 0, 2)
    bent = System("bent", states=(a, z2), outputs=[y], flow=[z2 - a**3, -z2], output=[a])
    assert "z2" not in forms.phase(recast(bent, {w: z2 - 1}, {z2: w + 1})).names


def test_two_changes_are_one_of_the_plant_as_first_declared() -> None:
    """So that the first is claimed too, and estimates are of the first states; one that comes back is as it was."""
    a, b, c = ranged("a", -1, 1), ranged("b", -1, 1), ranged("c", 0, 1)
    w, v, s = ranged("w", -2, 2), ranged("v", -9, 9), ranged("s", 0, 2)
    turn = System("turn", states=(a, b, c), outputs=[y], flow=[b, -a - b**3, a * b], output=[a])
    once = recast(turn, {w: 3 * b}, {b: w / 3})
    twice = recast(once, {v: a + w, s: 2 * c}, {w: v - a, c: s / 2})
    both = recast(turn, {v: a + 3 * b, s: 2 * c}, {b: (v - a) / 3, c: s / 2})
    assert [sp.expand(row - other) for row, other in zip(twice.flow, both.flow, strict=True)] == [0, 0, 0]
    assert (twice.declared, twice.states, twice.origin.forward) == (turn, both.states, both.origin.forward)
    assert dict(twice.reported) == {a: a, b: (v - a) / 3, c: s / 2}
    wrong = recast(recast(turn, {w: 3 * b}, {b: w / 2}), {v: 2 * w}, {w: v / 2})
    assert [check.verdict.value for check in wrong.checks] == ["refuted", "proved"]


def test_beyond_the_range_the_map_back_does_not_turn_round() -> None:
    """x = w**2 on w in [0.5, 3.1623]: w = -3 is no level of 9, w = 4 is one of 16, and a kept state passes as it is."""
    v, x, w = ranged("v", -1, 1), ranged("x", 0.25, 10), ranged("w", 0.5, 3.1623)
    other = System("two", states=(v, x), outputs=[y], flow=[sp.sqrt(x) - v, -sp.sqrt(x)], output=[v])
    form = forms.triangular(recast(other, {w: sp.sqrt(x)}, {x: w**2}))
    dynamics = observers.high_gain(form, theta=5, poles=(-1, -1)).dynamics
    z = ca.SX.sym("z", 2)
    estimate = ca.Function("estimate", [z], [dynamics.estimate(z, ca.SX(0, 1))])
    for inside, reported in (((0.5, 2.0), (0.5, 4.0)), ((-7.0, -3.0), (-7.0, 0.25)), ((7.0, 4.0), (7.0, 16.0))):
        assert np.allclose(np.array(estimate(inside)).ravel(), reported, rtol=1e-12)


@pytest.mark.parametrize("place", ["rate", "output"])
@pytest.mark.parametrize("low", [-1, 1])
def test_what_cancels_in_new_coordinates_stays_where_it_may_have_no_value(place: str, low: float) -> None:
    """(u x + u)/u, expanded, is x + 1: the recast plant would have a value where the plant has none."""
    x, z, w = (Signal(name, low=-1, high=1) for name in ("x", "z", "w"))
    u = Signal("u", low=low, high=2)
    part = (u * x + u) / u
    flow, output = ([z + part, -z], [x]) if place == "rate" else ([z, -z], [part])
    plant = System("plant", states=(x, z), inputs=(u,), outputs=(Signal("y"),), flow=flow, output=output)
    moved = recast(plant, {w: 2 * z}, {z: w / 2})
    assert any(row.has(u) for row in (*moved.flow, *moved.output)) is (low < 0)


@pytest.mark.parametrize("branched", [False, True])
@pytest.mark.parametrize("high", [-0.5, 1])
def test_no_form_is_proved_where_the_new_states_lose_what_has_no_value(high: float, branched: bool) -> None:
    """(a - b)/(2 a - 2 b) is 1/2 at once with a = w + b, and has no value where a = b; in a branch as well."""
    a, b, c = (Signal(name, low=low, high=top) for name, low, top in (("a", -1, high), ("b", 0, 1), ("c", -1, 1)))
    part, w = c * (a - b) / (2 * a - 2 * b), Signal("w", low=-2, high=1 if high > 0 else -0.5)
    part = sp.Piecewise((part, c > 0), (c / 2, True)) if branched else part
    flow, outputs = [b + part, part - b, -c], (Signal("y"),)
    plant = System("plant", states=(a, b, c), outputs=outputs, flow=flow, output=[a - b])
    moved = recast(plant, {w: a - b}, {a: w + b})
    assert moved.flow == (2 * b, c / 2 - b, -c)
    for form in (forms.triangular, forms.uniform, forms.state_affine, forms.block_triangular, forms.phase):
        verdicts = {check.verdict for check in form(moved).checks}
        assert (verdicts == {Verdict.PROVED}) is (high < 0), form
    assert (error_system(moved, [1, 1, 1]).lost is None) is (high < 0)
    assert (singularity(moved).checks[0].verdict is Verdict.PROVED) is (high < 0)


@pytest.mark.parametrize(
    ("text", "x", "inverse", "w", "verdict"),
    [
        ("Abs(x1)", (0, 1), "w", (-1, 1), "refuted"),  # |w| at w = -1
        ("x1", (-1, 1), "Abs(w)", (0, 1), "refuted"),  # |x1| at x1 = -1
        ("Max(x1, 0)", (0, 1), "w", (-1, 1), "refuted"),
        ("Abs(x1)", (0, 1), "w", (0, 1), "proved"),
        ("x1**2*sign(x1)", (0.5, 1), "sign(w)*sqrt(Abs(w))", (-1, 2), "unknown"),
    ],
)
def test_each_map_takes_what_the_other_gives_as_it_is_written(
    text: str, x: tuple[float, float], inverse: str, w: tuple[float, float], verdict: str
) -> None:
    """What a map is in its own ranges says nothing of a value outside of them: |x| is x for x >= 0. The last pair undo
    each other everywhere, and x |x| is not x**2."""
    assert maps(text, *x, inverse, *w)["recast.inverse"].verdict == verdict


def test_a_falling_map_leaves_its_range_at_the_other_end() -> None:
    """-x1 of x1 in [1, 3] goes to -3."""
    checks = maps("-x1", 1, 3, "-w", -1.5, 5)
    assert checks["recast.range"].verdict is Verdict.REFUTED
    assert checks["recast.range"].witness["x1"] > 1.5


def test_the_map_back_keeps_a_state_before_the_replaced_one() -> None:
    """In the order of the new plant's states: first, which stays, then w."""
    x, w = ranged("x1", 1, 3), ranged("w", 2, 6)
    moved = recast(plant(x), {w: 2 * x}, {x: w / 2})
    first = moved.states[0]
    assert moved.origin is not None
    assert moved.origin.forward == (first, 2 * x)
