"""Angles: values that differ by whole turns are equal, and every difference is taken the short way round."""

import pickle
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.graph import turned, wrapped
from hgogen.modelfiles.tuning import value
from hgogen.program import Place
from hgogen.reading.given import BadGain
from hgogen.reading.text_model import from_table, to_text
from hgogen.rigor.periodic import advance, exact_turn
from hgogen.rigor.shifts import hidden_shifts
from hgogen.run.prediction import forecasts
from hgogen.signal import BadRange
from hgogen.starting import gains_of, scale
from hgogen.step import GrowingAngle
from hgogen.system import BadSystem
from hgogen.trial import Trial, simulate

TURN = 2 * np.pi
DT = 0.01


def angle(name: str, **data: Any) -> hg.Signal:
    return hg.Signal(name, "rad", **{"period": TURN, **data})


def short_way(difference: np.ndarray, period: float = TURN) -> np.ndarray:
    """The difference in [-period/2, period/2), by numpy."""
    return np.asarray((difference + period / 2) % period - period / 2)


# --- the declaration ----------------------------------------------------------------------------------------


def test_a_turn_is_about_zero_or_as_declared() -> None:
    assert angle("a").interval == (-np.pi, np.pi)
    assert hg.Signal("a", period=360, low=0, high=360).interval == (0, 360)
    assert pickle.loads(pickle.dumps(angle("a", low=0, high=TURN))) == angle("a", low=0, high=TURN)
    assert angle("a") != hg.Signal("a", "rad", low=-np.pi, high=np.pi)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"period": 0}, "is no turn"),
        ({"period": -360}, "is no turn"),
        ({"period": float("nan")}, "period = nan is not finite"),
        ({"period": "once"}, "period = 'once' is not a number"),
        (
            {"period": 360, "low": -90, "high": 90},
            "low and high span 180, and period = 360 is one turn; leave them out",
        ),
        ({"period": 360, "low": 0}, "only one end of a range"),
        ({"period": 360, "nominal": 200}, "lies outside"),
    ],
)
def test_a_turn_that_is_none_is_refused(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadRange, match=said):
        hg.Signal("a", **data)


@pytest.mark.parametrize(
    ("period", "turn"), [(TURN, 2 * sp.pi), (np.pi, sp.pi), (360.0, 360), (0.1, sp.Rational(1, 10))]
)
def test_a_float_that_is_a_multiple_of_pi_is_meant_as_one(period: float, turn: sp.Expr) -> None:
    assert exact_turn(period) == turn


x, v = angle("x"), hg.Signal("v", low=-9, high=9)


@pytest.mark.parametrize(
    ("row", "change"),
    [
        (sp.sin(x), 0),
        (sp.sin(3 * x + 1) * v + sp.cos(x) ** 2, 0),
        (sp.atan2(sp.sin(x), sp.cos(x)), 0),
        (4 * x, 8 * sp.pi),
        (v - x, -2 * sp.pi),
        (v, 0),
    ],
)
def test_a_row_changes_by_whole_turns(row: sp.Expr, change: sp.Expr) -> None:
    assert advance(row, x, 2 * sp.pi) == change


def plant(flow: Any = 0, output: Any = x, period: float | None = TURN) -> hg.System:
    y = hg.Signal("y", period=period)
    return hg.System("p", states=(x, v), outputs=(y,), flow=[v, flow], output=[output])


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ({"flow": -x}, r"flow 2 changes by -2\*pi over one turn of x .*sines and cosines"),
        ({"flow": sp.sin(x / 2)}, "flow 2 changes by"),
        ({"period": None}, r"output 1 changes by 2\*pi .* declare the output with period = 6.28"),
        ({"output": x / 3}, "no multiple of the output's own"),
        ({"output": x * v}, "output 1 changes by"),
    ],
)
def test_a_plant_that_is_not_periodic_is_refused(rows: dict[str, Any], said: str) -> None:
    with pytest.raises(BadSystem, match=said):
        plant(**rows)


@pytest.mark.parametrize("output", [x, -x, 4 * x, sp.sin(x), 0 * x + v])
def test_an_output_goes_on_by_whole_turns_of_its_own(output: sp.Expr) -> None:
    assert plant(output=output).outputs[0].period == TURN


a, b, q = angle("a"), angle("b"), hg.Signal("q", "m", low=-9, high=9)


HALF, QUARTER = sp.Rational(1, 2), sp.Rational(1, 4)
SHIFTS = [  # rows, next values, then single and joint shifts and states with others
    ([(4 * a, TURN), (sp.S.Zero, None)], [], {a: QUARTER}, [], []),
    ([(a, TURN), (b, TURN)], [], {}, [], []),
    ([(4 * a, TURN), (6 * a, TURN), (b, TURN)], [], {a: HALF}, [], []),
    ([(4 * a, TURN), (sp.sin(a), None), (b, TURN)], [], {}, [], []),  # gravity
    ([(24 * a, TURN), (sp.cos(6 * a), None), (b, TURN)], [], {a: sp.Rational(1, 6)}, [], []),
    ([(24 * a, TURN), (b, TURN)], [], {a: sp.Rational(1, 24)}, [], []),
    ([(4 * a - b, TURN), (sp.sin(2 * a), None), (b, TURN)], [], {a: HALF}, [], []),
    ([(2 * q, TURN), (b, TURN)], [], {q: sp.pi}, [], []),
    ([(2 * q, TURN), (3 * q, TURN)], [], {q: 2 * sp.pi}, [], []),
    ([(2 * q, TURN), (q, None)], [], {}, [], []),
    ([(q, TURN), (sp.sqrt(2) * q, TURN)], [], {}, [], [a, b]),  # no ratio of whole numbers
    ([(2 * a, TURN), (3 * a + b, TURN)], [], {}, [{a: HALF, b: HALF}], []),
    ([(a + b, TURN), (a - b, TURN)], [], {}, [{a: HALF, b: HALF}], []),
    ([(2 * a, TURN), (3 * a + b, TURN), (sp.sin(a), None)], [], {}, [], []),
    ([(sp.sin(2 * a) ** 2 + v * b, None)], [], {a: QUARTER}, [], []),
    ([(sp.tan(a), None), (sp.sqrt(2 + sp.cos(3 * b)), None)], [], {a: HALF, b: sp.Rational(1, 3)}, [], []),
    ([(sp.Abs(sp.sin(a)), None), (sp.atan2(sp.sin(4 * b), sp.cos(4 * b)), TURN)], [], {a: HALF, b: QUARTER}, [], []),
    ([(sp.sin(a) / sp.cos(a), None), (b, TURN)], [], {}, [], [a]),
    ([(sp.Max(sp.sin(2 * a), sp.cos(2 * a)), None), (b, TURN)], [], {a: HALF}, [], [a]),
    ([(sp.floor(3 * a / sp.pi) - 3 * a / sp.pi, None), (b, TURN)], [], {a: sp.Rational(1, 6)}, [], []),
    ([(4 * a, TURN)], [-a, b, q], {a: QUARTER}, [], []),
    ([(4 * a, TURN)], [5 * a + 1, b, q], {a: QUARTER}, [], []),
    ([(4 * a, TURN)], [a + b, b, q], {a: QUARTER, b: QUARTER}, [], []),
    ([(4 * a, TURN), (b, TURN)], [a + b / 2, b, q], {a: QUARTER}, [], []),
    ([(a, TURN), (b, TURN)], [a + q / 10, b, q], {q: 20 * sp.pi}, [], []),  # of a speed, between samples
    ([(a, TURN), (b, TURN)], [a + q / 10, b, 9 * q / 10], {}, [], []),
]


def test_all_shifts_that_change_no_row_are_found() -> None:
    for rows, following, single, joint, others in SHIFTS:
        shifts = hidden_shifts({a: TURN, b: TURN, q: None}, rows, following)
        assert (shifts.single, list(shifts.joint), list(shifts.open)) == (single, joint, others), (rows, following)


def test_pole_pairs_give_an_angle_modulo_a_part_of_its_turn() -> None:
    def plant(output: sp.Expr) -> hg.System:
        w = hg.Signal("w", low=-20, high=20)
        return hg.System("geared", states=(a, w), outputs=(angle("y"),), flow=[w, -w], output=[output])

    assert plant(a).modulo == ""
    assert plant(2 * a).modulo == "a modulo half a turn"
    assert plant(3 * a).modulo == "a modulo a third of a turn"
    assert plant(7 * a).modulo == "a modulo 1/7 of a turn"
    four = plant(4 * a)
    answer = hg.observability(four)
    assert "the outputs give a modulo a quarter turn" in str(answer)
    assert "the outputs give a modulo a quarter turn" in str(answer.checks[0].reason)
    observer = hg.observers.high_gain(hg.forms.triangular(four), theta=5, poles=(-1, -1))
    ending = "converges exponentially from the initial errors of high_gain.region, a modulo a quarter turn"
    assert observer.theorem.conclusion == f"the estimate {ending}"
    counted = hg.System("counted", states=(q,), outputs=(angle("y"),), flow=[-1], output=[q / 2])
    assert counted.modulo == "q modulo 12.5664 m"
    stepped = hg.System("stepped", states=(a,), outputs=(angle("y"),), flow=[a + 1], output=[4 * a], discrete=True)
    assert stepped.modulo == "a modulo a quarter turn"


def test_shifts_of_several_angles_at_once_are_reported() -> None:
    outputs, flow = (angle("y"), angle("z")), [sp.S.Zero, sp.S.Zero]
    plant = hg.System("two", states=(a, b), outputs=outputs, flow=flow, output=[2 * a, 3 * a + b])
    said = "the outputs give a and b modulo a joint shift by half a turn of a and half a turn of b"
    assert said in str(hg.observability(plant).checks[0].reason)
    wide, narrow = hg.Signal("w", low=-9, high=9), hg.Signal("w", low=-3, high=3)
    for w, modulo in ((wide, "w modulo 12.5664"), (narrow, "")):  # a whole turn in a sample of 1/2
        sampled = hg.System("s", states=(a, w), outputs=outputs[:1], flow=[a + w / 2, w], output=[a], discrete=True)
        assert sampled.modulo == modulo
    most = hg.System("most", states=(a,), outputs=(hg.Signal("y"),), flow=[0], output=[sp.Max(sp.sin(a), sp.cos(a))])
    assert most.modulo == "a up to shifts that are not excluded"


def test_the_cut_of_an_angle_is_no_jump_of_an_output_with_its_period() -> None:
    """A bearing of a place: across the cut away from the origin, and with it; by half a period; in the flow as well."""
    u, w = hg.Signal("u", low=-2, high=2), hg.Signal("w", low=-2, high=2)
    py, any_side = hg.Signal("py", low=-5, high=5), hg.Signal("px", low=-5, high=5)
    left, right = hg.Signal("px", low=-5, high=-1), hg.Signal("px", low=1, high=5)

    def claims(px: hg.Signal, period: float | None, share: Any = 1, rate: sp.Expr = u) -> tuple[str, str]:
        output = [share * sp.atan2(py, px)]
        y = hg.Signal("y", period=period)
        plant = hg.System("b", states=(px, py), inputs=(u, w), outputs=(y,), flow=[rate, w], output=output)
        checks = {check.id.unqualified: check for check in hg.forms.original(plant).checks}
        regular = next(check for check in hg.singularity(plant).checks if check.id.unqualified == "regular")
        return str(checks["lipschitz"]), str(regular)

    cut = "atan2(py, px) may jump", "px > 0"
    degrees = 180 / sp.pi
    steep, regular = claims(left, TURN)
    assert "proved" in steep
    assert "the short way round" in steep
    assert "px > 0" not in regular
    assert "proved" in claims(left, 360, degrees)[0]
    assert "proved" in claims(right, TURN)[0]
    for each in (claims(left, None), claims(left, 360, degrees / 2), claims(left, TURN, rate=u + sp.atan2(py, left))):
        assert cut[0] in each[0]
        assert cut[1] in each[1]
    steep, regular = claims(any_side, TURN)
    assert "it may be singular at px**2 + py**2 = 0" in steep
    assert steep.startswith("unknown")
    assert "px**2 + py**2 != 0" in regular
    assert "px > 0" not in regular


def test_pole_pairs_may_be_a_parameter_of_one_value() -> None:
    pairs = {one: hg.Signal("k", "1", "pole pairs", nominal=one) for one in (4.0, 2.5)}

    def geared(k: hg.Signal, **data: Any) -> hg.System:
        rows = {"states": (a,), "flow": [sp.sin(k * a)], "outputs": (angle("y"),), "output": [k * a]}
        return hg.System("geared", parameters=(k,), **rows, **data)

    assert geared(pairs[4.0]).modulo == "a modulo a quarter turn"
    with pytest.raises(BadSystem, match="flow 1 changes by"):
        geared(pairs[2.5])
    with pytest.raises(BadSystem, match="parameter 'k' has no value"):
        geared(hg.Signal("k"))


def test_a_float_beside_an_angle_that_is_a_multiple_of_pi_is_meant_as_one() -> None:
    degrees = hg.Signal("d", "deg", period=360)
    rows: dict[str, Any] = {"states": (degrees, v), "outputs": (angle("y"), hg.Signal("s"))}
    turned_by = hg.System("p", **rows, flow=[v * (180 / np.pi), 0.5 * v], output=[np.pi / 180 * degrees, v])
    assert turned_by.output[0] == sp.pi * degrees / 180
    assert turned_by.flow == (180 * v / sp.pi, 0.5 * v)
    for wrong, period, said in (
        (sp.cos(degrees), 360, r"of radians: write pi\*d/180 in them"),
        (sp.cos(degrees), 6.2832, r"a turn in radians is 2\*pi: declare period = 2\*pi of d"),
    ):
        other = hg.Signal("d", "deg", period=period)
        with pytest.raises(BadSystem, match=said):
            hg.System("p", **rows | {"states": (other, v)}, flow=[v, 0], output=[wrong.subs(degrees, other), v])


def test_a_parameter_has_no_turns() -> None:
    a = hg.Signal("a", nominal=0, period=TURN)
    with pytest.raises(BadSystem, match="parameter 'a' has a period"):
        hg.System("p", states=(v,), outputs=(hg.Signal("y"),), parameters=(a,), flow=[a], output=[v])


@pytest.mark.parametrize("written", ["2*pi", 360])
def test_a_text_model_declares_a_period(written: Any) -> None:
    table = {
        "name": "p",
        "states": {"x": {"period": written, "flow": "0"}},
        "outputs": {"y": {"period": written, "equation": "x"}},
    }
    read = from_table(table).plant
    assert read.states[0].period == (TURN if written == "2*pi" else 360)
    assert "period = " in to_text(read)


# --- the difference -----------------------------------------------------------------------------------------

_ARGUMENT = ca.SX.sym("d")
_WRAPPED = ca.Function("wrapped", [_ARGUMENT], [wrapped(_ARGUMENT, TURN)])
_DEGREES = ca.Function("turned", [_ARGUMENT], [turned(_ARGUMENT, 0.0, 360.0)])


@given(st.floats(-0.499, 0.499), st.integers(-1024, 1024))
def test_whole_turns_leave_the_difference_as_it_was(share: float, turns: int) -> None:
    """To a rounding of the sum that was given: k P is taken off without one."""
    difference = share * TURN + turns * TURN
    exactly = Fraction(difference) - turns * Fraction(TURN)
    assert abs(Fraction(float(_WRAPPED(difference))) - exactly) <= Fraction(2) ** -50
    assert float(_WRAPPED(share * TURN)) == share * TURN


@given(st.floats(-360 * 1024, 360 * 1024))
def test_an_angle_is_in_its_turn(degrees: float) -> None:
    assert -1e-9 <= float(_DEGREES(degrees)) <= 360 + 1e-9
    assert np.isclose(short_way(float(_DEGREES(degrees)) - degrees, 360.0), 0, atol=1e-9)


def test_half_a_turn_has_one_sign() -> None:
    assert float(_WRAPPED(np.pi)) == float(_WRAPPED(-np.pi)) == -np.pi


PERIODS = (TURN, np.pi, 360.0, 1.0, 0.1, 2.0**40)


@given(st.sampled_from(PERIODS), st.floats(-1000, 1000), st.floats(-1000, 1000))
def test_a_difference_is_the_short_way_round(period: float, a: float, b: float) -> None:
    """Within half a turn, its own negative the other way round but for the tie, exact, and that of a step's graph."""
    a, b, signal = a * period, b * period, hg.Signal("a", period=period)
    short, back = float(signal.difference(a, b)), float(signal.difference(b, a))
    assert -period / 2 <= short < period / 2
    assert short == -back or short == back == -period / 2
    turns = (Fraction(a - b) - Fraction(short)) / Fraction(period)
    assert turns == round(turns) or abs(turns - round(turns)) * 2**53 <= abs(turns) + 1
    off = abs(float(ca.evalf(wrapped(ca.SX(a - b), period))) - short) / period
    assert min(off, 1 - off) < 1e-12


@given(st.sampled_from(PERIODS), st.integers(-1000, 1000))
def test_whole_turns_are_no_difference_and_a_tie_has_one_sign(period: float, turns: int) -> None:
    signal = hg.Signal("a", period=period)
    assert abs(signal.difference(turns * period, 0.0)) <= 2.0**-53 * abs(turns * period)
    assert signal.difference(period / 2, 0) == signal.difference(-period / 2, 0) == -period / 2


# --- observers ----------------------------------------------------------------------------------------------


def rotor(turns: bool) -> hg.System:
    """A pendulum that is driven round; without turns its angle is a number in a range that is wide enough."""
    wide = {"low": -500, "high": 500}
    th, y = (hg.Signal(name, "rad", **({"period": TURN} if turns else wide)) for name in ("th", "y"))
    w, u = hg.Signal("w", "rad/s", low=-10, high=10), hg.Signal("u", low=-5, high=5)
    flow = [w, -2 * sp.sin(th) - 0.5 * w + u]
    return hg.System("rotor", states=(th, w), inputs=(u,), outputs=(y,), flow=flow, output=[th])


COUNT = 1500
TIMES = np.arange(COUNT) * DT


def driven() -> tuple[np.ndarray, np.ndarray]:
    """The input and the states (N, 2) of the rotor over 11 turns, by small steps."""
    states, z, h = [], np.array([0.5, 0.0]), DT / 20
    for k in range(COUNT):
        states.append(z)
        for i in range(20):
            t = k * DT + i * h
            slope = np.array([z[1], -2 * np.sin(z[0]) - 0.5 * z[1] + 3 + np.sin(t)])
            middle = z + h / 2 * slope
            z = z + h * np.array([middle[1], -2 * np.sin(middle[0]) - 0.5 * middle[1] + 3 + np.sin(t + h / 2)])
    return 3 + np.sin(TIMES)[:, None], np.array(states)


KALMAN = {"Q": (1e-3, 1.0), "R": 1e-4 * DT}
CHAIN = {"theta": 5, "poles": (-1, -1)}
INNOVATION = hg.innovation.staggered(0.1, 2)
WINDOW = hg.innovation.window(0.1)
OBSERVERS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "rk4": ("high_gain", CHAIN, {"method": hg.methods.rk4}),
    "bilinear": ("high_gain", CHAIN, {"method": hg.methods.bilinear}),
    "exponential": ("high_gain", CHAIN, {"method": hg.methods.exponential}),
    "covariance": ("riccati", KALMAN | {"covariance": (1e-4, 1e-2)}, {"method": hg.methods.rk4}),
    "cholesky": ("riccati", KALMAN, {"method": hg.methods.cholesky}),
    "adaptive": ("riccati", KALMAN | {"theta": hg.theta.adaptive(3, mu=(0.1, 0.2), innovation=INNOVATION)}, {}),
    "window": ("riccati", KALMAN | {"theta": hg.theta.adaptive(3, mu=(0.1, 0.2), innovation=WINDOW)}, {}),
    "no_guards": ("riccati", KALMAN, {"guards": "none"}),
    "no_guards_integrated": ("high_gain", CHAIN, {"guards": "none"}),
    "held_input": ("riccati", KALMAN, {"between": "hold"}),
}


def of_the_registry() -> dict[str, tuple[str, dict[str, Any], dict[str, Any]]]:
    """Each observer with the gains that it is begun with, of those that take the rotor."""
    form = hg.forms.triangular(rotor(True))
    numbers, every = scale(form, DT, {"y": 0.005}), {}
    for name in (each for each in dir(hg.observers) if not each.startswith("_")):
        gains = gains_of(getattr(hg.observers, name), numbers)
        with suppress(BadGain):
            gains = {} if isinstance(gains, str) else {key: value(key, entry) for key, entry in gains.items()}
            if gains:
                getattr(hg.observers, name)(form, **gains)
                every[name] = (name, gains, {})
    return every


OBSERVERS |= of_the_registry()


def test_the_registry_is_there() -> None:
    assert len(OBSERVERS) >= 25


def estimated(case: str, turns: bool, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    name, gains, options = OBSERVERS[case]
    observer = getattr(hg.observers, name)(hg.forms.triangular(rotor(turns)), **gains)
    return np.asarray(hg.sample(observer, dt=DT, **options).run(u=u, y=y[:, None], engine="python").x)


@pytest.mark.parametrize("case", OBSERVERS)
def test_an_angle_that_turns_is_estimated_as_one_that_does_not(case: str) -> None:
    """The observer of the plant on the whole line is the oracle: to rounding, theirs is one estimate modulo turns."""
    u, states = driven()
    y = states[:, 0] + 0.005 * np.random.default_rng(0).standard_normal(COUNT)
    assert states[-1, 0] > 10 * TURN
    line, circle = estimated(case, False, u, y), estimated(case, True, u, short_way(y))
    assert np.abs(short_way(circle[:, 0] - line[:, 0])).max() < 1e-8
    assert np.abs(circle[:, 1] - line[:, 1]).max() < 1e-7
    assert np.abs(circle[:, 0]).max() <= np.pi + 1e-9
    assert np.sqrt((short_way(circle[500:, 0] - states[500:, 0]) ** 2).mean()) < 0.05


def test_a_compass_keeps_its_accuracy_over_a_hundred_turns() -> None:
    th, b, w, y = angle("th"), hg.Signal("b", low=-0.1, high=0.1), hg.Signal("w", low=-3, high=3), angle("y")
    heading = hg.System("heading", states=(th, b), inputs=(w,), outputs=(y,), flow=[w + b, 0], output=[th])
    dt, count, rng = 0.1, 12000, np.random.default_rng(1)
    truth = 0.53 * np.arange(count) * dt
    filter_ = hg.observers.riccati(hg.forms.triangular(heading), Q=(1e-3, 1e-6), R=1e-4 * dt)
    run = hg.sample(filter_, dt=dt).run(
        u=np.full((count, 1), 0.5), y=short_way(truth + 0.01 * rng.standard_normal(count))[:, None]
    )
    assert truth[-1] > 100 * TURN
    assert np.sqrt((short_way(run.x[300:, 0] - truth[300:]) ** 2).mean()) < 0.01


@pytest.mark.parametrize("sample", [1e30, TURN * 1100, np.inf, np.nan])
def test_a_sample_beyond_a_thousand_turns_is_not_used(sample: float) -> None:
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(rotor(True)), **KALMAN), dt=DT)
    before = step(u=0.0, y=0.1).x.copy()
    step.reset()
    step(u=0.0, y=0.1)
    after = step(u=0.0, y=sample)
    assert after.status != 0
    assert np.isfinite(after.x).all()
    assert np.abs(after.x - before).max() < 0.1


# --- what goes with observers -------------------------------------------------------------------------------


def with_compass(turns: bool) -> hg.System:
    """The rotor with a second sensor of its angle."""
    plant = rotor(turns)
    (y,) = plant.outputs
    other = hg.Signal("y2", y.unit, low=y.low, high=y.high, period=y.period)
    return replace(plant, outputs=(y, other), output=plant.output * 2)


def with_torque(turns: bool) -> hg.System:
    return hg.with_disturbance(rotor(turns), "w", signal=hg.Signal("d", low=-1, high=1))


def kalman(form: hg.Form, name: str = "riccati", **more: Any) -> hg.Observer:
    many = len(form.system.outputs)
    Q = (1e-3, 1.0, 0.1)[: form.n]
    made: hg.Observer = getattr(hg.observers, name)(form, Q=Q, R=(1e-4 * DT,) * many, **more)
    return made


SEVERAL = {"poles": (-1, -1), "theta": 5, "weights": {"y": 1, "y2": 2}}
SIBLINGS: dict[str, Callable[[bool], hg.Step]] = {
    **{
        f"{form}": lambda turns, form=form: hg.sample(kalman(getattr(hg.forms, form)(rotor(turns))), dt=DT)
        for form in ("block_triangular", "original", "phase", "state_affine", "uniform", "uniform_chain")
    },
    "delayed": lambda turns: hg.sample(hg.delayed(kalman(hg.forms.triangular(rotor(turns))), y=5), dt=DT),
    "delayed_ukf": lambda turns: hg.sample(hg.delayed(kalman(hg.forms.triangular(rotor(turns)), "ukf"), y=5), dt=DT),
    "periods": lambda turns: hg.sample(kalman(hg.forms.triangular(rotor(turns))), dt=DT, periods={"y": 5 * DT}),
    "disturbed": lambda turns: hg.sample(kalman(hg.forms.original(with_torque(turns))), dt=DT),
    "weights": lambda turns: hg.sample(
        hg.observers.high_gain(hg.forms.block_triangular(with_compass(turns)), **SEVERAL), dt=DT
    ),
    **{
        f"two_{name}": lambda turns, name=name: hg.sample(
            kalman(hg.forms.original(with_compass(turns)), name), dt=DT, periods={"y": 3 * DT}
        )
        for name in ("riccati", "ukf", "iterated_ekf")
    },
    **{
        f"bank_{selection}": lambda turns, selection=selection: hg.sample(
            hg.observers.bank(kalman(hg.forms.triangular(rotor(turns))), count=3, period=2.0, selection=selection),
            dt=DT,
        )
        for selection in ("window", "newest")
    },
}


@pytest.mark.parametrize("case", SIBLINGS)
def test_what_goes_with_an_observer_goes_round(case: str) -> None:
    """Late samples, several rates, sensors, forms and members: again the plant on the whole line is the oracle."""
    u, states = driven()
    ages = np.where(np.arange(COUNT) % 7 == 0, 3, 0)
    line, circle = SIBLINGS[case](False), SIBLINGS[case](True)
    taken = np.maximum(np.arange(COUNT) - (ages if line.ages else 0), 0)
    noise = 0.005 * np.random.default_rng(0).standard_normal((COUNT, len(line.outputs)))
    y = states[taken, :1] + noise
    late = [ages[:, None]] if line.ages else []
    on_line = line.run(u=u, y=np.hstack([y, *late]), engine="python")
    on_circle = circle.run(u=u, y=np.hstack([short_way(y), *late]), engine="python")
    assert np.abs(short_way(on_circle.x[:, 0] - on_line.x[:, 0])).max() < 1e-8
    assert np.abs(on_circle.x[:, 1:] - on_line.x[:, 1:]).max() < 1e-7
    assert np.abs(on_circle.x[:, 0]).max() <= np.pi
    assert on_circle.status.tolist() == on_line.status.tolist()
    assert np.sqrt((short_way(on_circle.x[500:, 0] - states[500:, 0]) ** 2).mean()) < 0.05


def test_two_compasses_at_half_a_turn_average_to_half_a_turn() -> None:
    """Not to 0, which is their mean as numbers: of the errors to the estimate the mean is taken."""
    step = hg.sample(
        hg.observers.high_gain(hg.forms.block_triangular(with_compass(True)), initial={"th": 3.1}, **SEVERAL), dt=DT
    )
    for _ in range(500):
        x = step(u=0.0, y=(np.pi - 0.01, -np.pi + 0.01)).x
    assert abs(short_way(x[0] - np.pi)) < 0.05


def test_a_disturbance_is_no_angle() -> None:
    """It enters a flow as it is, which a turn of it would change."""
    with pytest.raises(BadSystem, match="flow 2 changes by"):
        hg.with_disturbance(rotor(True), "w", signal=angle("d"))


def test_a_saved_angle_is_restored() -> None:
    u, states = driven()
    y = short_way(states[:, :1])
    step = SIBLINGS["original"](True)
    step.run(u=u[:700], y=y[:700])
    saved, rest = step.save(), step.run(u=u[700:], y=y[700:])
    step.restore(saved)
    assert step.run(u=u[700:], y=y[700:]).x.tobytes() == rest.x.tobytes()


@pytest.mark.parametrize("value", [0.3 + 5 * TURN, 0.3 - TURN])
def test_an_angle_begins_some_turns_off(value: float) -> None:
    observer = kalman(hg.forms.triangular(rotor(True)), initial={"th": value})
    assert observer.parts[0].z.initial[0] == pytest.approx(0.3, abs=1e-14)
    step = hg.sample(observer, dt=DT)
    assert np.isclose(step(u=0.0, y=0.3).x[0], 0.3, atol=1e-14)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_an_angle_that_is_no_number_is_no_start(value: float) -> None:
    with pytest.raises(BadGain, match="must be"):
        kalman(hg.forms.triangular(rotor(True)), initial={"th": value})


@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("value", [30.0, 1e6, 1e20, 1e29, -1e29])
def test_a_spoiled_angle_is_in_its_turn_after_a_call(real: Any, value: float) -> None:
    step = SIBLINGS["original"](True).rebuilt(real=real)
    step(u=0.0, y=0.1)
    step._kept.places[Place("state", "z")][0] = value
    assert abs(step(u=0.0, y=np.nan).x[0]) <= np.float32(np.pi)


def test_a_first_coordinate_turns_with_the_state_that_it_is() -> None:
    """And is a number where the state counts its turns, though the sensor does not."""
    q, r, th = hg.Signal("q", low=-99, high=99), hg.Signal("r", low=1, high=2), angle("th", low=0, high=TURN)
    first = []
    for state, output, acceleration in ((q, q, 0), (th, -th, sp.sin(th))):
        plant = hg.System("p", states=(state, r), outputs=(angle("y"),), flow=[r, acceleration], output=[output])
        first.append(hg.forms.phase(plant).states[0])
    assert [(z.period, z.interval) for z in first] == [(None, (-99, 99)), (TURN, (-TURN, 0))]


def test_innovations_forecasts_and_truths_go_round() -> None:
    u, states = driven()
    y = states[:, :1] + 0.005 * np.random.default_rng(0).standard_normal((COUNT, 1))
    trial = Trial("turns", 10.0, {"th": 0.5, "w": 0.0}, {"u": 3.0}, estimate={"th": 0.5, "w": 0.0})
    innovations, errors, truths = [], [], []
    for turns, samples in ((False, y), (True, short_way(y))):
        step = SIBLINGS["original"](turns)
        run = step.run(u=u, y=samples)
        innovations.append(run.innovations)
        errors.append(np.concatenate([each.model for each in forecasts(step, run, u, samples, [10, 50])]))
        truths.append(simulate(rotor(turns), trial, DT).x)
    assert np.nanmax(np.abs(innovations[0] - innovations[1])) < 1e-9
    assert np.nanmax(np.abs(errors[0] - errors[1])) < 1e-9
    assert np.isfinite(errors[0]).sum() > COUNT
    assert truths[0][-1, 0] > 6 * TURN
    assert np.abs(short_way(truths[0][:, 0]) - truths[1][:, 0]).max() < 1e-9


def test_a_state_that_grows_with_its_turns_is_named() -> None:
    w, c, s = hg.Signal("w", low=-9, high=9), hg.Signal("c"), hg.Signal("s")

    def filtered(th: hg.Signal, rows: list[sp.Expr]) -> Any:
        plant = hg.System("resolver", states=(th, w), outputs=(c, s), flow=[w, 0], output=rows)
        observer = hg.observers.riccati(hg.forms.original(plant), Q=(1, 1), R=(1, 1), covariance=(1, 1))
        return hg.sample(observer, dt=0.01)

    growing, circular, straight = hg.Signal("th", "rad"), angle("th"), hg.Signal("th", low=-1, high=1)
    with pytest.warns(GrowingAngle, match=r"th has no range.*declare period=pi/2 of it"):
        step = filtered(growing, [sp.cos(4 * growing), sp.sin(4 * growing)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", GrowingAngle)
        pickle.loads(pickle.dumps(step))
        for th, rows in (
            (circular, [sp.cos(circular), sp.sin(circular)]),
            (straight, [sp.cos(straight), sp.sin(straight)]),
            (growing, [sp.cos(growing), growing]),
        ):
            filtered(th, rows)
