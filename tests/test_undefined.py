"""Where a plant has no finite value: what `check` says, what is refused, and what a step does that was accepted."""

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.analysis.dynamics import HUGE
from hgogen.analysis.undefined import undefined_slopes, undefined_values
from hgogen.check import Refuted, UnknownCheck, Verdict
from hgogen.run.prediction import predictions

X, V = hg.Signal("x", low=-2, high=2), hg.Signal("v", low=-2, high=2)
H = hg.Signal("h", low=0, high=2)
W, FREE = hg.Signal("w", low=-1, high=1), hg.Signal("free", nominal=1)
K = hg.Signal("k", nominal=1, low=0.5, high=2)
Y = hg.Signal("y", low=-2, high=2)


def plant(rate: Any, output: Any = X, name: str = "hollow") -> hg.System:
    """A chain whose last rate is `rate` beside linear terms."""
    flow = [V, -X - V + rate, 1 - H]
    return hg.System(
        name, states=(X, V, H), inputs=(W, FREE), outputs=(Y,), parameters=(K,), flow=flow, output=[output]
    )


def oscillator(rate: Any, output: Any = X, v: hg.Signal = V) -> hg.System:
    return hg.System("oscillator", states=(X, v), inputs=(W,), outputs=(Y,), flow=[v, -X - v + rate], output=[output])


def said(system: hg.System) -> list[tuple[str, str]]:
    return [(str(check.verdict), str(check.reason)) for check in undefined_values(system)]


@pytest.mark.parametrize(
    ("rate", "place"),
    [
        (1 / W, "at w = 0"),
        (sp.log(W), "unless w > 0"),
        (sp.sqrt(W), "unless w >= 0"),
        (sp.tan(3 * W), "at cos(3*w) = 0"),
        (sp.asin(2 * W), "unless -1 <= 2*w <= 1"),
        (sp.acosh(W + 1), "unless w + 1 >= 1"),
        (sp.atanh(W), "unless -1 < w < 1"),
        (1 / (W - X), "at w - x = 0"),
        (1 / (W**2 + X**2), "at w**2 + x**2 = 0"),
        (1 / (sp.cos(X) - W), "at -w + cos(x) = 0"),
        (sp.atan2(V, X), "at v**2 + x**2 = 0"),
        (V / X, "at x = 0"),
        (1 / (K - 1), "at k - 1 = 0"),
        (sp.exp(1 / W), "at w = 0"),
        (X * sp.log(H + W), "unless h + w > 0"),
    ],
)
def test_a_place_without_a_value_is_named_with_a_point(rate: sp.Expr, place: str) -> None:
    system = plant(rate)
    (check,) = undefined_values(system)
    assert (check.id, check.verdict, str(check.reason)) == (
        "singular.v",
        Verdict.REFUTED,
        f"v' has no finite value {place}",
    )
    point = {s: sp.Rational(Fraction(value)) for s in rate.free_symbols for value in [check.witness.get(s.name, 1)]}
    value = rate.subs(point)
    assert value.has(sp.zoo, sp.nan, sp.oo) or value.is_real is False or abs(sp.N(value)) > 1e6


@pytest.mark.parametrize(
    "rate",
    [
        sp.tan(W),
        sp.asin(W),
        sp.acosh(W + 2),
        1 / (W**2 + K),
        1 / (K - 3),
        1 / (V**2 - V * X + X**2 + sp.Rational(1, 100)),
        sp.sqrt(X**2 + V**2),
        sp.atan2(V, X + 3),
        sp.log(3 + W + X / 2),
        sp.Piecewise((1 / W, sp.Rational(1, 2) < W), (0, True)),
        FREE,
    ],
)
def test_a_row_with_values_everywhere_says_nothing(rate: sp.Expr) -> None:
    assert undefined_values(plant(rate)) == undefined_slopes(plant(rate)) == ()
    assert not [check for check in hg.forms.triangular(plant(rate)).checks if check.id.maker == "singular"]


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        (sp.Piecewise((sp.sqrt(X), X > 0), (0, True)), []),
        (sp.Piecewise((sp.sqrt(X), X >= 0), (0, True)), []),
        (sp.Piecewise((sp.sqrt(X), X > -1), (0, True)), ["refuted"]),
        (sp.Piecewise((sp.sqrt(X), V > 0), (0, True)), ["refuted"]),
        (sp.Piecewise((sp.log(X), X > 0), (0, True)), ["unknown"]),
    ],
)
def test_a_root_where_it_is_chosen_only_of_what_is_not_negative_has_a_value(rate: sp.Expr, says: list[str]) -> None:
    assert [verdict for verdict, _ in said(plant(rate))] == says


def test_a_derivative_of_the_program_is_asked_at_points_where_no_proof_decides() -> None:
    """d/dx of an angle that is chosen for x >= 0 is not decided, and at x = 2 the program's is infinite."""
    x, y = hg.Signal("x", low=0, high=2), hg.Signal("y")
    flow = [1 - sp.Piecewise((sp.asin(x / 2), x >= 0), (0, True), evaluate=False) - sp.sqrt(x + 1)]
    chosen = hg.System("chosen", states=(x,), outputs=(y,), flow=flow, output=[x])
    with pytest.raises(Refuted, match=r"singular\.x"):
        hg.observers.riccati(hg.forms.original(chosen), Q=[1], R=1, accept=("original.lipschitz",))


def test_what_is_not_decided_is_unknown_and_refuses_nobody() -> None:
    """1/w over w > 0 is finite at each of its points, and has no bound."""
    system = plant(sp.Piecewise((1 / W, W > 0), (0, True)))
    ((verdict, reason),) = said(system)
    assert verdict == "unknown"
    assert reason.startswith("it is not decided whether v' has a finite value unless Piecewise(")


@pytest.mark.parametrize(
    ("rate", "verdict"), [(1 / FREE, "where"), (1 / (FREE + 1), "where"), (1 / (FREE - 1), "refuted")]
)
def test_of_an_input_without_a_range_only_its_resting_value_is_known_to_occur(rate: sp.Expr, verdict: str) -> None:
    (check,) = undefined_values(plant(rate))
    assert check.verdict == verdict
    assert "Declare low= and high= for free." in check.fix if verdict == "where" else "Narrow" in check.fix


@pytest.mark.full
@given(centre=st.fractions(-3, 3, max_denominator=50), power=st.integers(1, 3))
def test_a_pole_is_found_where_it_is(centre: Fraction, power: int) -> None:
    made = said(oscillator(1 / (W - sp.Rational(centre)) ** power))
    assert [verdict for verdict, _ in made] == (["refuted"] if abs(centre) <= 1 else [])


def test_a_derivative_without_a_value_is_asked_of_those_who_evaluate_it() -> None:
    """sqrt(h) at h = 0: a filter by sigma points is built, one that linearises is refused with a way out."""
    h, q, y = hg.Signal("h", low=0, high=2), hg.Signal("q", low=0, high=1), hg.Signal("y")
    tank = hg.System("tank", states=(h,), inputs=(q,), outputs=(y,), flow=[q - sp.sqrt(h)], output=[h])
    assert undefined_values(tank) == ()
    form, gains = hg.forms.original(tank), {"Q": [1], "R": 1}
    steep = ("original.lipschitz",)
    hg.observers.ukf(form, **gains, accept=steep)
    for observer in (hg.observers.riccati, hg.observers.iterated_ekf):
        with pytest.raises(
            Refuted, match=r"each derivative of h' by a state has no finite value unless h > 0"
        ) as refused:
            observer(form, **gains, accept=steep)
        assert "accept=('singular.h',)" in str(refused.value)
        accepted = observer(form, **gains, accept=(*steep, "singular.h"))
        assert "singular.h" in {check.id for check in accepted.checks}
        step = hg.sample(accepted, hg.methods.continuous_discrete, dt=0.01)
        run = step.run(np.zeros((50, 1)), np.zeros((50, 1)))
        assert np.isfinite(run.x).all()
        assert raised(step, run, "HELD_H").any()
        assert not raised(step, run, "RESTARTED").any()


@pytest.mark.full
def test_what_a_step_without_guards_asks_can_be_accepted() -> None:
    """The derivative of sqrt(x^2 + v^2) is 0/0 at 0; a form that clamps reads 0 there."""
    system = hg.System("p", states=(X, V), outputs=(Y,), flow=[V, -X - V], output=[sp.sqrt(X**2 + V**2)])
    form = hg.forms.original(system)
    with pytest.raises(Refuted, match=r"accept=\('singular\.y',\)"):
        hg.sample(hg.observers.riccati(form, **KALMAN), dt=0.01, guards="none")
    observer = hg.observers.riccati(form, accept=("singular.y",), initial=(1, 0), **KALMAN)
    plain, guarded = hg.sample(observer, dt=0.01, guards="none"), hg.sample(observer, dt=0.01)
    y = 1 + 0.1 * np.sin(np.arange(50) / 5)
    assert plain.run(y=y).x == pytest.approx(guarded.run(y=y).x, rel=1e-9)


def test_a_name_that_is_no_check_is_refused() -> None:
    with pytest.raises(UnknownCheck, match=r"singular\.z"):
        hg.observers.ukf(hg.forms.triangular(oscillator(W)), Q=[1, 1], R=1, accept=("singular.z",))


def raised(step: Any, run: Any, name: str) -> np.ndarray:
    """Where a bit of the status is raised."""
    index = [bit.name for bit in step.layout.bits].index(name)
    return (np.asarray(run.status) >> index) & 1 > 0


def observed(
    name: str, system: hg.System, accept: tuple[str, ...], gains: dict[str, Any], between: str = "hold"
) -> Any:
    method = hg.methods.rk4 if name == "high_gain" else hg.methods.continuous_discrete
    observer = getattr(hg.observers, name)(hg.forms.original(system), accept=accept, **gains)
    return hg.sample(observer, method, dt=0.01, between=between)


KALMAN: dict[str, Any] = {"Q": (1, 1), "R": 0.1}


@pytest.mark.ordinary("c-iterated_ekf", "python-riccati", "python-ukf", "python-iterated_ekf")
@pytest.mark.parametrize("name", ["riccati", "ukf", "iterated_ekf"])
@pytest.mark.parametrize("engine", ["c", "python"])
def test_an_accepted_pole_holds_the_last_rate_and_says_so(name: str, engine: str) -> None:
    """While w is 0 the step goes on as one whose input stayed where it was."""
    system = oscillator(1 / (20 * W))
    made, stayed = (observed(name, system, ("singular.v",), KALMAN) for _ in range(2))
    y, u = 0.2 * np.sin(np.arange(12) / 5), np.array([0.5] * 4 + [0.0] * 4 + [0.25] * 4)
    run = made.run(u, y, engine=engine)
    assert run.x == pytest.approx(stayed.run(np.where(u == 0, 0.5, u), y, engine=engine).x, rel=1e-12, abs=1e-15)
    assert raised(made, run, "HELD_V").tolist() == [False] * 4 + [True] * 4 + [False] * 4
    assert set(run.status[4:8]) == {run.status[4]}


@pytest.mark.ordinary(
    "c-triangular-refuted1", "python-original-refuted0", "python-triangular-refuted1", "python-state_affine-refuted2"
)
@pytest.mark.parametrize(
    ("form", "refuted"),
    [("original", ("original.lipschitz",)), ("triangular", ("triangular.a_2",)), ("state_affine", ())],
)
@pytest.mark.parametrize("engine", ["c", "python"])
def test_a_pole_in_the_slope_of_the_next_state_is_held_too(form: str, refuted: tuple[str, ...], engine: str) -> None:
    """x' = v/w - x: nothing is lost while w is 0, and no state restarts."""
    plant = hg.System("p", states=(X, V), inputs=(W,), outputs=(Y,), flow=[V / W - X, -V], output=[X])
    made = getattr(hg.forms, form)(plant)
    if form == "state_affine":
        accept = ("singular.x", "state_affine.lipschitz", "kalman_like.persistence")
        observer = hg.observers.kalman_like(made, rho=1, R=0.1, accept=accept)
    else:
        observer = hg.observers.riccati(made, accept=("singular.x", *refuted), **KALMAN)
    step = hg.sample(observer, dt=0.01, between="hold")
    u = np.array([0.5] * 100 + [0.0] * 4 + [0.5] * 4)
    run = step.run(u, np.full(108, 0.2), engine=engine)
    assert raised(step, run, "HELD_X").tolist() == [False] * 100 + [True] * 4 + [False] * 4
    assert not raised(step, run, "RESTARTED").any()
    assert np.abs(np.diff(run.x[99:105], axis=0)).max() < 0.02


@pytest.mark.parametrize(("rate", "output", "name"), [(1 / (20 * W), X, "v"), (0 * W, X + 1 / (20 * W), "y")])
def test_predictions_of_a_record_leave_out_where_there_is_no_value(rate: Any, output: Any, name: str) -> None:
    step = observed("riccati", oscillator(rate, output), (f"singular.{name}",), KALMAN)
    u, y = np.array([0.5] * 20 + [0.0] * 4 + [0.5] * 20)[:, None], np.full((44, 1), 0.2)
    one, alone = predictions(step, step.run(u, y), u, y, (1,))
    assert np.isfinite((one.model, alone.model)).all()
    assert 30 < one.count < 43


def test_a_stage_alone_that_meets_a_pole_is_held_and_said() -> None:
    """Between samples the input runs on a line: from -1/2 to 1/2 it is 0 in the middle."""
    step = observed("riccati", oscillator(1 / (20 * W)), ("singular.v",), KALMAN, between="line")
    run = step.run([-0.5, -0.5, 0.5, 0.5], np.zeros(4))
    assert raised(step, run, "HELD_V").tolist() == [False, False, True, False]
    assert np.isfinite(run.x).all()


def test_a_declared_rate_bounds_what_is_taken() -> None:
    """With v' in [-3, 3] a rate of 1/(20 w) beyond it is not taken, though it is finite."""
    v = hg.Signal("v", low=-2, high=2, rates=((-3, 3),))
    step = observed("riccati", oscillator(1 / (20 * W), v=v), ("singular.v",), KALMAN)
    run = step.run([0.5, 0.5, 0.02, 0.012, 0.5], np.zeros(5))
    assert raised(step, run, "HELD_V").tolist() == [False, False, False, True, False]


def test_a_bound_is_of_the_plants_state_whatever_the_sign_of_the_coordinate() -> None:
    """v' in [-3, 8], of z2 = -v: at w = 0.01 the rate of v is 5, at -0.01 it is -5."""
    v = hg.Signal("v", low=-2, high=2, rates=((-3, 8),))
    w = hg.Signal("w", low=-1, high=1)
    plant = hg.System("mirrored", states=(X, v), inputs=(w,), outputs=(Y,), flow=[-v, X + 1 / (20 * w)], output=[X])
    form = hg.forms.triangular(plant)
    assert form.signs == (1, -1)
    step = hg.sample(hg.observers.riccati(form, **KALMAN, accept=("singular.v",)), dt=0.01, between="hold")
    run = step.run([0.5, 0.5, 0.01, 0.5, -0.01, 0.5], np.zeros(6))
    assert raised(step, run, "HELD_V").tolist() == [False, False, False, False, True, False]


@pytest.mark.ordinary("ukf")
@pytest.mark.parametrize("name", ["riccati", "ukf", "iterated_ekf"])
def test_a_sample_is_left_out_where_its_output_has_no_value(name: str) -> None:
    """Range and bearing from the place itself: the bearing is not used there, and nothing else is lost."""
    p, q = (hg.Signal(each, low=-50, high=50) for each in "pq")
    r, b = hg.Signal("r"), hg.Signal("b")
    output = [sp.sqrt(p**2 + q**2), sp.atan2(q, p)]
    place = hg.System("place", states=(p, q), outputs=(r, b), flow=[0 * p, 0 * q], output=output)
    gains: dict[str, Any] = {"Q": (1, 1), "R": (0.1, 0.1)}
    with pytest.raises(Refuted, match=r"b has no finite value at p\*\*2 \+ q\*\*2 = 0; at p = 0, q = 0"):
        observed(name, place, (), gains)
    step = observed(name, place, ("singular.b",), gains)
    run = step.run(y=[[0.0, 1.0]] * 3)
    assert raised(step, run, "UNDEFINED_B").all()
    assert not (raised(step, run, "MISSING_B") | raised(step, run, "RESTARTED")).any()
    assert np.abs(run.x).max() <= 1e-15  # of the range, by the least number that its root is taken of
    step = observed(name, place, ("singular.b",), {**gains, "initial": {"p": 1, "q": 1}})
    off = step.run(y=[[2.0, 0.5]] * 300)
    assert abs(np.arctan2(*off.x[-1][::-1]) - 0.5) < (np.pi / 4 - 0.5) / 4  # it is used: from pi/4 it comes to 0.5
    assert not raised(step, off, "UNDEFINED_B").any()


def test_an_output_beyond_its_declared_range_is_left_out() -> None:
    """y = v/10 + 1/(50 w) in [-2, 2]: a predicted output is taken up to once its width beyond, at 6."""
    step = observed("riccati", oscillator(0, X / 10 + 1 / (50 * W)), ("singular.y",), KALMAN)
    run = step.run([0.5, 0.004, 0.003, 0.0, 0.5], np.zeros(5))
    assert raised(step, run, "UNDEFINED_Y").tolist() == [False, False, True, True, False]
    assert np.isfinite(run.x).all()


@pytest.mark.parametrize("name", ["riccati", "ukf"])
def test_what_is_accepted_costs_nothing_where_every_value_is_finite(name: str) -> None:
    """Away from the pole the estimates are those of a plant whose range keeps off it."""
    away = hg.Signal("w", low=0.25, high=1)
    rate, y = 1 / (20 * W), 0.2 * np.sin(np.arange(200) / 5)
    u = 0.6 + 0.3 * np.cos(np.arange(200) / 7)
    close = hg.System(
        "oscillator", states=(X, V), inputs=(away,), outputs=(Y,), flow=[V, -X - V + 1 / (20 * away)], output=[X]
    )
    held, plain = observed(name, oscillator(rate), ("singular.v",), KALMAN), observed(name, close, (), KALMAN)
    run, wanted = held.run(u, y), plain.run(u, y)
    assert run.x == pytest.approx(wanted.x, rel=1e-12, abs=1e-15)
    assert not run.status.any()
    assert len(held.layout.state) == len(plain.layout.state) + 1


def test_an_entry_of_the_jacobian_that_is_a_number_is_no_choice() -> None:
    """Of v' = -x - v + 1/(20 w) no derivative has a pole, taken or not."""
    dynamics = observed("riccati", oscillator(1 / (20 * W)), ("singular.v",), KALMAN).observer.dynamics
    assert ca.DM(dynamics.jacobian(ca.SX.sym("z", 2), ca.SX.sym("w"))).full().tolist() == [[0, 1], [-1, -1]]


def test_values_beyond_any_unit_are_not_taken() -> None:
    """Without a declared rate, what is beyond 1e15 is not taken: 1/w at 1e-16, a finite number."""
    step = observed("riccati", oscillator(1 / W), ("singular.v",), KALMAN)
    run = step.run([1.0, 1.0, 0.5 / HUGE, 1.0], np.zeros(4))
    assert raised(step, run, "HELD_V").tolist() == [False, False, True, False]
