"""Angles in logs: read, fitted, tuned, judged and drawn across the end of a turn as on a line without one."""

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from test_cli import hgogen

import hgogen as hg
from hgogen.logs.fit import CannotFit, Task, lagged
from hgogen.logs.judged import ValidationLog, _without_a_model
from hgogen.logs.likelihood import Likelihood, Noise
from hgogen.logs.problem import digests
from hgogen.logs.records import (
    HiddenStateCriterion,
    Judge,
    Log,
    PredictionCriterion,
    range_warnings,
    readable,
    validated_log,
)
from hgogen.logs.tune import first_of
from hgogen.reading.jumps import JumpsByTurn, first_jump, jumps_by_turns, other_angle, turn_of, unwrapped_outputs
from hgogen.reading.measured import WINDOWS, read
from hgogen.run import figures
from hgogen.run.comparison import differences
from hgogen.run.consistency import suggest
from hgogen.run.metrics import leaving_signals
from hgogen.starting import scale
from hgogen.trial import OrnsteinUhlenbeck, Trial, try_out
from hgogen.which_forms import of

TURN = 2 * np.pi
DT = 0.05


def angle(name: str, unit: str = "rad", **data: Any) -> hg.Signal:
    return hg.Signal(name, unit, **({"period": TURN} | data))


def in_turn(values: Any, period: float = TURN) -> Any:
    return (np.asarray(values) + period / 2) % period - period / 2


# --- signals ------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=30), st.floats(-30, 30), st.sampled_from([TURN, 360.0]))
def test_a_course_has_no_jumps(shares: list[float], start: float, period: float) -> None:
    """It is the sum of its steps, from the first value in its turn on."""
    a = hg.Signal("a", period=period)
    course = a.turned(start * period) + period * np.cumsum([0.0, *shares])
    np.testing.assert_allclose(a.unwrapped(in_turn(course, period)), course, atol=1e-11 * period)


def test_a_course_keeps_what_is_missing_and_loses_what_is_no_angle() -> None:
    got = angle("a").unwrapped(np.array([3.0, np.nan, -3.0, 1e5, 3.0, np.inf]))
    np.testing.assert_allclose(got, [3.0, np.nan, TURN - 3, np.nan, 3.0, np.nan])


@pytest.mark.parametrize(("turns", "there"), [(3, True), (-1024, True), (1025, False), (-1e9, False)])
def test_a_sample_is_reduced_up_to_a_thousand_turns(turns: float, there: bool) -> None:
    assert angle("a").reduced(1.0 + TURN * turns) == (
        pytest.approx(1.0) if there else pytest.approx(nan_ok=True, expected=np.nan)
    )


def test_the_mean_of_angles_at_the_end_of_a_turn_is_that_end() -> None:
    assert abs(angle("a").mean(np.array([np.pi - 0.1, -np.pi + 0.1, np.nan]))) == pytest.approx(np.pi)
    assert hg.Signal("a", period=360, low=0, high=360).mean(np.array([350.0, 0.0, 40.0])) == pytest.approx(10.0)
    assert hg.Signal("a").mean(np.array([350.0, 0.0, 40.0])) == 130.0
    assert np.isnan(angle("a").mean(np.array([np.nan])))


# --- reading ------------------------------------------------------------------------------------------------


def course(count: int = 401) -> np.ndarray:
    """An angle over 3 turns and back."""
    return 10 * np.sin(np.arange(count) * 0.01)


def log(folder: Path, times: np.ndarray, **columns: np.ndarray) -> Path:
    rows = np.column_stack([times, *columns.values()])
    path = folder / "log.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *columns]), comments="", fmt="%.15g")
    return path


def test_an_input_is_averaged_over_rows_along_its_course(tmp_path: Path) -> None:
    """What is averaged of the angle on the line, in its turn."""
    times, a = np.arange(401) * 0.01, course()
    path = log(tmp_path, times, line=a, turn=in_turn(a))
    signals = {"line": hg.Signal("line"), "turn": angle("turn")}
    inputs = dict.fromkeys(signals, WINDOWS["line"])
    got = read(path, {name: name for name in signals}, dt=0.07, time="t", inputs=inputs, signals=signals).values
    assert np.abs(np.diff(got[:, 1])).max() > 5
    np.testing.assert_allclose(got[:, 1], in_turn(got[:, 0]), atol=1e-9)


def test_rows_on_both_sides_of_the_end_average_to_the_end(tmp_path: Path) -> None:
    times, values = np.arange(40) * 0.01, np.tile([np.pi - 0.1, -np.pi + 0.1], 20)
    signals, inputs = {"a": angle("a")}, {"a": (0.0, 1.0)}
    got = read(log(tmp_path, times, a=values), {"a": "a"}, dt=0.1, time="t", inputs=inputs, signals=signals).values
    np.testing.assert_allclose(np.abs(got[:-1, 0]), np.pi, atol=1e-12)


def test_samples_are_reduced_and_what_is_no_angle_is_left_to_the_step(tmp_path: Path) -> None:
    a = np.where(np.arange(401) == 7, 1e9, course())
    path = log(tmp_path, np.arange(401) * 0.01, **{"a [deg]": np.degrees(a)})
    record = read(path, {"a": "a [deg]"}, dt=0.01, time="t", signals={"a": angle("a")})
    assert record.values[7, 0] == pytest.approx(1e9)
    there = np.arange(401) != 7
    np.testing.assert_allclose(record.values[there, 0], in_turn(course())[there], atol=1e-9)
    (note,) = [note for note in record.report.notes if "outside of its turn" in note]
    assert note.endswith(f"taken in it: {np.count_nonzero(np.abs(a) > 1.02 * np.pi)}")


def test_the_rate_of_an_input_is_that_of_its_course(tmp_path: Path) -> None:
    path = log(tmp_path, np.arange(401) * 0.01, line=course(), turn=in_turn(course()))
    signals = {"line": hg.Signal("line"), "turn": angle("turn")}
    columns = {name: name for name in ("line", "turn", "line_dot", "turn_dot", "turn_ddot", "line_ddot")}
    rates = {f"{name}_{dots}": (name, order) for name in signals for order, dots in ((1, "dot"), (2, "ddot"))}
    record = read(path, columns, dt=0.01, time="t", signals=signals, rates=rates)
    one = dict(zip(record.names, record.values.T, strict=True))
    for dots in ("dot", "ddot"):
        np.testing.assert_allclose(one[f"turn_{dots}"], one[f"line_{dots}"], atol=1e-8)
    u = (angle("a"), angle("a").derivative(1))
    whole = Log(in_turn(course())[:, None], np.zeros((401, 0)), 0.01).of(u)
    np.testing.assert_allclose(whole.u[:, 1], one["line_dot"], atol=1e-9)


# --- jumps --------------------------------------------------------------------------------------------------


def plant(turns: bool, **wide: Any) -> hg.System:
    """A compass with a gyro that has a bias, and a field that pulls; without turns angles are numbers."""
    data = {"period": TURN} if turns else {"low": -500, "high": 500} | wide
    th, y = hg.Signal("th", "rad", **data), hg.Signal("y", "rad", **data)
    b, w = hg.Signal("b", "rad/s", low=-0.5, high=0.5), hg.Signal("w", "rad/s", low=-9, high=9)
    g, c = hg.Signal("g", nominal=1, low=0.5, high=2), hg.Signal("c", "1/s", nominal=0.3, low=0, high=2)
    flow = [g * w + b + c * sp.sin(th), 0]
    return hg.System("compass", states=(th, b), inputs=(w,), outputs=(y,), parameters=(g, c), flow=flow, output=[th])


def driven(count: int = 400, start: float = 0.3, sigma: float = 0.02) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The gyro, the heading and the samples (N) of the compass over some turns; g = 1.2, b = 0.1, c = 0.5."""
    w, x, h, headings = 0.8 + 0.6 * np.sin(0.7 * DT * np.arange(count)), start, DT / 20, []
    for u in w:
        headings.append(x)
        for _ in range(20):
            middle = x + h / 2 * (1.2 * u + 0.1 + 0.5 * np.sin(x))
            x = x + h * (1.2 * u + 0.1 + 0.5 * np.sin(middle))
    th = np.array(headings)
    return w, th, th + sigma * np.random.default_rng(1).standard_normal(count)


def both(**options: Any) -> tuple[tuple[hg.System, Log], tuple[hg.System, Log]]:
    """The plant and its log without turns and with them."""
    w, _, y = driven(**options)
    assert np.ptp(y) > 1.5 * TURN
    return (plant(False), Log(w[:, None], y[:, None], DT)), (plant(True), Log(w[:, None], in_turn(y)[:, None], DT))


def test_the_first_jump_of_an_angle_without_a_period_is_named() -> None:
    y = driven()[2]
    wrapped = in_turn(y)
    at = int(np.argmax(np.abs(np.diff(wrapped)) > np.pi)) + 1
    (said,) = jumps_by_turns(unwrapped_outputs(plant(False, low=-3.15, high=3.15)), wrapped[:, None], DT, "s")
    assert f"jumps by {wrapped[at] - wrapped[at - 1]:.4g} rad at sample {at} ({at * DT:.6g} s after the first)" in said
    assert "declare period = 2*pi of y and th, in place of low and high" in said
    assert not list(jumps_by_turns(unwrapped_outputs(plant(True)), wrapped[:, None], DT, "s"))
    assert not list(jumps_by_turns(unwrapped_outputs(plant(False)), y[:, None], DT, "s"))


def test_jumps_that_miss_the_other_end_by_far_count_against_an_angle() -> None:
    """Two of five are longer across the end than the steps around them: three such would be an angle's."""
    even = 0.02 * np.arange(260)
    assert first_jump(in_turn(TURN * even), TURN) == 25
    rough = even + 0.15 * (even >= 1.5) + 0.15 * (even + 0.15 >= 2.5)
    assert first_jump(in_turn(TURN * rough), TURN) is None


def test_a_run_in_python_says_it_too() -> None:
    w, _, y = driven()[:3]
    observer = hg.observers.high_gain(hg.forms.triangular(plant(False, low=-3.15, high=3.15)), theta=2, poles=(-1, -1))
    step = hg.sample(observer, dt=DT)
    with pytest.warns(JumpsByTurn, match="declare period = 2\\*pi of y and th, in place of low and high"):
        step.run(u=w[:, None], y=in_turn(y)[:, None])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        step.run(u=w[:, None], y=np.zeros((len(w), 1)))


@pytest.mark.parametrize(("turn", "unit"), [(TURN, "rad"), (360.0, "deg"), (360.0, ""), (4096.0, "counts")])
def test_a_turn_is_that_of_the_angle_or_of_the_range(turn: float, unit: str) -> None:
    x, y = hg.Signal("x"), hg.Signal("y", unit, low=-turn / 2, high=turn / 2)
    values = in_turn(turn / TURN * driven()[2], turn)
    values[::7] = np.nan
    rest = hg.System("rest", states=(x,), outputs=(y,), flow=[0 * x], output=[2 * x])
    (said,) = jumps_by_turns(unwrapped_outputs(rest), values[:, None], DT, "s")
    assert f"period = {'2*pi' if turn == TURN else f'{turn:g}'} of y and x" in said


SECONDS = np.arange(2000) * 0.01
NOISE = np.random.default_rng(3).standard_normal(2000)
HEALTHY = {
    "sine": np.pi * np.sin(3 * SECONDS),
    "noise": np.clip(np.pi * NOISE, -np.pi, np.pi),
    "relay": np.pi * np.sign(np.sin(3 * SECONDS)) * 0.9 + 0.1 * NOISE,
    "spikes": 2 * np.sin(SECONDS) + TURN * (np.abs(NOISE) > 2.9),
    "lost": np.where(np.abs(NOISE) > 2.5, 0.0, np.pi * (1 + 0.95 * np.sin(3 * SECONDS))),
    "course": 3 * SECONDS,
    "rest": np.full(2000, np.pi),
    "short": np.array([3.1, -3.1]),
}


@pytest.mark.parametrize("name", HEALTHY)
@pytest.mark.parametrize("through", [True, False])
def test_what_is_no_angle_has_no_jumps(name: str, through: bool) -> None:
    assert first_jump(HEALTHY[name], TURN, through) is None


def test_a_turn_of_another_unit_is_a_round_number_that_the_course_fills() -> None:
    course = driven()[2]
    for turn in (400.0, 1.0, 3600.0, 4000.0, 4096.0, 65536.0, 1000.0):
        known = turn_of(hg.Signal("y"), in_turn(turn / TURN * course, turn), ())
        assert known is not None, turn
        assert known[0] == turn
    assert {name for name, values in HEALTHY.items() if turn_of(hg.Signal("y"), 200 / np.pi * values, ())} == set()


def test_two_levels_a_turn_apart_are_no_course_of_an_angle() -> None:
    """But an angle about the end of its turn jumps: only the unit tells them apart."""
    levels = np.where(np.sin(3 * SECONDS) > 0, np.pi, -np.pi)
    assert first_jump(levels, TURN) is None
    west = in_turn(np.pi + 0.02 * NOISE)
    assert first_jump(west, TURN, through=False) == int(np.argmax(np.abs(np.diff(west)) > np.pi)) + 1


def test_a_column_in_the_other_unit_of_angles_is_named(tmp_path: Path) -> None:
    degrees = np.degrees(in_turn(course()))
    assert other_angle(angle("a"), degrees) == "degrees"
    assert other_angle(hg.Signal("a", period=360), np.radians(degrees)) == "radians"
    assert other_angle(angle("a"), np.radians(degrees)) is None
    record = read(
        log(tmp_path, np.arange(401) * 0.01, d=degrees), {"a": "d"}, dt=None, time="t", signals={"a": angle("a")}
    )
    assert (
        "a jumps by a turn in degrees, and its period is 6.28319; if it is, say --map a='pi/180*d'"
        in record.report.notes
    )


# --- fit ----------------------------------------------------------------------------------------------------


def test_a_fit_across_turns_is_that_on_the_line() -> None:
    line, circle = (hg.fit(one, record, starts=1) for one, record in both())
    assert circle.values == pytest.approx(line.values, abs=1e-6)
    assert circle.values == pytest.approx({"g": 1.2, "c": 0.5}, abs=0.01)
    assert circle.error == pytest.approx(line.error, abs=1e-6)
    assert circle.deviation == pytest.approx(line.deviation, rel=1e-3)
    np.testing.assert_allclose(circle.fitted[0], in_turn(line.fitted[0]), atol=1e-5)
    assert circle.spread["y"] < np.pi
    assert not circle.confined


def test_the_first_state_of_a_fit_is_in_its_turn() -> None:
    """The samples begin in another turn; they are the same angles."""
    _, (one, record) = both(count=200)
    there, away = (hg.fit(one, Log(record.u, record.y + turns * TURN, DT), starts=1) for turns in (0, 3))
    assert away.first[0] == pytest.approx(there.first[0], abs=1e-7)
    assert away.first[0]["th"] == pytest.approx(0.3, abs=0.02)


def test_an_offset_of_half_a_turn_is_found() -> None:
    """With a heading from the field, of which the pull tells north."""
    _, (one, record) = both()
    fit = hg.fit(one, Log(record.u, in_turn(record.y + 3.0), DT), offset="y", starts=1, free=("g",))
    assert np.isfinite(fit.offsets[0].value)
    assert abs(fit.offsets[0].value) <= np.pi


@pytest.mark.full
def test_a_robust_fit_across_turns_is_that_on_the_line() -> None:
    pairs = []
    for one, record in both():
        y = record.y.copy()
        y[50] += 1.5
        pairs.append(hg.fit(one, Log(record.u, y, DT), starts=1, robust=True))
    line, circle = pairs
    assert circle.values == pytest.approx(line.values, abs=1e-5)


@pytest.mark.full
def test_a_fit_by_prediction_across_turns() -> None:
    """Noise moves the heading."""
    w, _, _ = driven(count=600)
    rng, th = np.random.default_rng(2), [0.3]
    for u in w[:-1]:
        th.append(th[-1] + DT * (1.2 * u + 0.1 + 0.5 * np.sin(th[-1])) + 0.03 * rng.standard_normal())
    y = in_turn(np.array(th) + 0.02 * rng.standard_normal(600))
    fit = hg.fit(plant(True), Log(w[:, None], y[:, None], DT), starts=1, by="prediction")
    assert fit.values == pytest.approx({"g": 1.2, "c": 0.5}, abs=0.03)
    assert fit.error["y"] < 0.05


def test_a_first_state_in_another_turn_changes_no_gap_and_no_residual() -> None:
    """Of one of the segments of multiple shooting, by three turns."""
    _, (one, record) = both()
    task = Task(one, one, one.parameters, (), (record,), (), "hold", "simulation")
    start, there = task.nominal, task.nominal
    there[task.problem.constants + 2 * 20] += 3 * TURN  # the heading of segment 20
    at = ca.Function("at", [task.problem.followed[0]], list(task.problem.followed[1:]))
    for here, away in zip(at(start), at(there), strict=True):
        np.testing.assert_allclose(away.full(), here.full(), atol=1e-9)
        assert np.abs(here.full()).max() < np.pi


def test_poles_of_a_motor_give_its_angle() -> None:
    """An output that goes on by two turns where the state goes on by one."""
    _, (one, record) = both()
    poles = replace(one, output=(2 * one.states[0],))
    fit = hg.fit(poles, Log(record.u, in_turn(2 * record.y), DT), starts=1)
    assert fit.values == pytest.approx({"g": 1.2, "c": 0.5}, abs=0.01)


def test_innovations_of_a_fit_are_those_on_the_line() -> None:
    """At the same unknowns, in the same units."""
    line, circle = (Task(one, one, one.parameters, (), (record,), (), "hold", "prediction") for one, record in both())
    problem = replace(circle.problem, unit=np.ones(2))
    other = replace(line.problem, unit=np.ones(2), scale=problem.scale)
    start = circle.nominal
    np.testing.assert_allclose(other.residuals(start)[0], problem.residuals(start)[0], rtol=1e-6, atol=1e-6)


def test_the_lag_of_a_compass_is_found_across_turns() -> None:
    w, th, _ = driven(count=600)
    lag, now, shown, h = 0.4, th[0], [th[0]], DT / 50
    for k in range(599):
        for i in range(50):
            now += h * (th[k] + (i / 50) * (th[k + 1] - th[k]) - now) / lag
        shown.append(now)
    y = np.array(shown) + 0.005 * np.random.default_rng(0).standard_normal(600)
    fit = hg.fit(plant(True), Log(w[:, None], in_turn(y)[:, None], DT), lag="y", starts=1)
    assert fit.lag_values["y"] == pytest.approx(lag, abs=0.03)
    assert fit.values == pytest.approx({"g": 1.2, "c": 0.5}, abs=0.03)
    assert any("which the output is less by" in note for note in fit.notes())


def test_the_lag_of_an_angle_that_reads_an_input_is_refused() -> None:
    th, u, y = angle("th"), angle("u"), angle("y")
    one = hg.System("bearing", states=(th,), inputs=(u,), outputs=(y,), flow=[sp.sin(th)], output=[th - u])
    with pytest.raises(
        CannotFit, match="output 'y' is periodic and reads an input; its lag is not fitted, leave it out"
    ):
        lagged(one, one.outputs, 0.1, 10.0)


def test_a_stopped_fit_is_of_its_periods() -> None:
    half = {"low": -np.pi, "high": np.pi}
    plain, turning = (digests(one, (), {})["plant"] for one in (plant(False, **half), plant(True)))
    assert plain != turning


# --- tune ---------------------------------------------------------------------------------------------------


def test_steps_are_judged_across_turns_as_on_the_line() -> None:
    """By predictions, with gains that the plant on the line has; the scales are those of differences as well."""
    errors, rivals = [], []
    for one, record in both():
        row = of("original", one)
        step = first_of("riccati", row, {"Q": (1e-3, 1e-6), "R": (1e-4 * DT,)}, DT, {}).step
        records = (readable(one, record, 1),)
        yardstick = PredictionCriterion(1, one.outputs)
        rivals.append(yardstick.rival(records)[0])
        errors.append(Judge(records, yardstick, 5).errors(step))
    np.testing.assert_allclose(*rivals, atol=1e-12)
    np.testing.assert_allclose(*errors, rtol=1e-6)


def test_a_likelihood_across_turns_is_that_on_the_line() -> None:
    costs = []
    for one, record in both():
        form = of("original", one).form
        assert form is not None
        base = scale(form, DT)
        likelihood = Likelihood(form, (record,), base, "line", 2)
        e, s = likelihood.innovations(Noise({"th": 1e-3, "b": 1e-6}, {"y": 0.02}, 0.0, True), record)
        costs.append(e[50:] / np.sqrt(s[50:]))
    np.testing.assert_allclose(*costs, atol=1e-3)
    assert np.abs(costs[1]).max() < 10


def test_the_truth_of_an_angle_is_measured_the_short_way() -> None:
    """From its mean, half a turn away: 0.1 on both sides."""
    truth = {"th": np.array([np.pi - 0.1, -np.pi + 0.1, np.nan])}
    (squares,) = HiddenStateCriterion((truth,), plant(True).states[:1]).rival([])
    np.testing.assert_allclose(squares[:, 0], [0.01, 0.01, np.nan])


def test_predictors_without_a_model_go_the_short_way() -> None:
    """A constant rate of 1 rad a sample: copying errs by 1, differencing by nothing."""
    y, w, v = angle("y"), hg.Signal("v"), angle("th")
    one = hg.System("turn", states=(v, w), outputs=(y,), flow=[w, 0], output=[v])
    record = Log(np.zeros((40, 0)), in_turn(np.arange(40.0))[:, None], 0.5)
    copying, differencing = _without_a_model(one, [ValidationLog(record, 10, {"v": np.full(40, 2.0)})], (1, 3))
    assert copying.errors == {1: {"y": pytest.approx(1.0)}, 3: {"y": pytest.approx(3.0)}}
    assert differencing.errors[3]["y"] == pytest.approx(0, abs=1e-9)
    assert differencing.hidden["v"] == pytest.approx(0, abs=1e-9)


@pytest.mark.full
def test_observers_are_ranked_across_turns_as_on_the_line() -> None:
    rows = []
    for one, record in both(count=300):
        result = hg.tune(one, record, observers=("high_gain", "riccati"), segments=3)
        rows.append([row.name for row in result.rows])
    assert rows[0] == rows[1]


def test_a_log_is_in_its_turn_and_what_no_step_takes_is_missing() -> None:
    _, (one, record) = both(count=200)
    y = record.y + TURN * np.arange(-100, 100)[:, None]
    y[3] = 1e9
    for got in (validated_log(one, Log(record.u, y, DT), 1).y, readable(one, Log(record.u, y, DT), 1).y):
        assert np.flatnonzero(np.isnan(got[:, 0])).tolist() == [3]
        np.testing.assert_allclose(np.delete(got, 3, 0), np.delete(record.y, 3, 0), atol=1e-10)


def test_a_periodic_state_leaves_no_range() -> None:
    _, (one, record) = both(count=200)
    assert not list(range_warnings(one, record))
    bounded = hg.Signal("th", low=2.0, high=4.0)
    held = hg.System("held", states=(bounded,), outputs=(angle("y"),), flow=[-bounded], output=[bounded])
    values = in_turn(np.linspace(2.1, 3.9, 20))[:, None]
    assert not list(range_warnings(held, Log(np.zeros((20, 0)), values, DT)))
    (said,) = range_warnings(held, Log(np.zeros((20, 0)), in_turn(values + 0.5), DT))
    assert "as far as 4.4" in said


# --- runs ---------------------------------------------------------------------------------------------------

MODEL = """
name = "heading"
states.th = {{ unit = "rad", {turn}, flow = "w + b" }}
states.b = {{ unit = "rad/s", low = -0.5, high = 0.5, flow = "0" }}
inputs.w = {{ unit = "rad/s", low = -3, high = 3 }}
outputs.y = {{ unit = "rad", {turn}, equation = "th" }}
observer = {{ kind = "riccati", Q = [1e-3, 1e-6], R = 2e-6, dt = 0.02 }}
"""


@pytest.fixture
def heading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log of 100 turns at 2.65 rad/s, of a gyro that measures 2.5."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(12000) * 0.02
    th = 2.65 * t
    y = in_turn(th + 0.01 * np.random.default_rng(1).standard_normal(12000))
    log(tmp_path, t, w=np.full(12000, 2.5), y=y, truth=in_turn(th))
    return tmp_path


def run(folder: Path, turn: str) -> dict[str, Any]:
    (folder / "heading.toml").write_text(MODEL.format(turn=turn))
    options = ("--time", "t", "--truth", "th=truth", "-o", "out", "--json")
    printed: dict[str, Any] = json.loads(hgogen("run", "heading.toml", "--data", "log.csv", *options)[0])
    return printed


@pytest.mark.full
def test_a_run_over_a_hundred_turns_keeps_its_accuracy(heading: Path) -> None:
    report = run(heading, 'period = "2*pi"')
    assert report["hidden"]["th"] < 0.006
    assert report["acted"]["restarts"] == []
    assert not any("jumps" in note for note in report["notes"])
    assert all(one["model"] < 0.02 for one in report["predictions"] if one["ahead"])
    columns = np.genfromtxt(heading / "out" / "log_estimates.csv", delimiter=",", names=True)
    for name in ("y", "th"):
        assert np.abs(columns[name]).max() <= np.pi + 1e-9
    assert report["nees"] is not None
    assert report["nees"]["nees"] < 2


def test_a_run_names_the_first_jump_of_a_heading_without_a_period(heading: Path) -> None:
    report = run(heading, "low = -3.2, high = 3.2")
    assert report["hidden"]["th"] > 0.1
    (said,) = [note for note in report["notes"] if "jumps" in note]
    assert "at sample 60 (1.2 s after the first), a whole turn" in said
    assert "declare period = 2*pi of y and th, in place of low and high" in said


def test_a_run_begins_at_the_first_sample_in_the_turn_of_the_state(heading: Path) -> None:
    """Of a compass in -pi..pi and a heading in 0..2 pi."""
    text = MODEL.format(turn='period = "2*pi"').replace(
        'period = "2*pi", flow', 'period = "2*pi", low = 0, high = "2*pi", flow'
    )
    assert "high" in text
    (heading / "heading.toml").write_text(text.replace('high = "2*pi"', f"high = {TURN!r}"))
    log(heading, np.arange(200) * 0.02, w=np.zeros(200), y=np.full(200, -1.0) + 1e-3 * NOISE[:200])
    report = json.loads(hgogen("run", "heading.toml", "--data", "log.csv", "--time", "t", "--json")[0])
    assert report["initial"]["th"] == pytest.approx(TURN - 1, abs=0.01)


def drawn(figure: Figure) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), dtype=float) for line in figure.axes[0].get_lines()]


@pytest.fixture(scope="module")
def turning() -> tuple[Any, hg.System, np.ndarray, np.ndarray]:
    _, th, y = driven()
    one = plant(True)
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(one), Q=(1e-3, 1e-3), R=4e-4 * DT), dt=DT)
    return step, one, th, in_turn(y)


def test_angles_are_drawn_without_jumps(turning: Any) -> None:
    step, one, th, y = turning
    w = driven()[0]
    done = step.run(u=w[:, None], y=y[:, None], engine="python")
    assert np.abs(np.diff(done["th"])).max() > 6
    t = DT * np.arange(len(y))
    lines = drawn(figures.record_states(step, t, done, y[:, None], {"th": in_turn(th)}))
    lines += drawn(figures.fitted(one, t, y[:, None], in_turn(y + 0.01)[:, None]))
    assert len(lines) == 5
    for line in lines:
        assert np.abs(np.diff(line)).max() < 0.5
        np.testing.assert_allclose(in_turn(line[50:] - th[50:]), 0, atol=0.2)
        assert abs(line[-1] - lines[0][-1]) < 0.2


def test_a_trial_of_an_angle_is_drawn_without_jumps_and_leaves_no_range(turning: Any) -> None:
    step, one, _, _ = turning
    trial = Trial("turns", 12, {"th": 3.0, "b": 0.1}, {"w": 1}, noise={"y": OrnsteinUhlenbeck(0.01)})
    trajectory = next(iter(try_out(step, trial, "python", (0,))))
    assert np.abs(np.diff(trajectory.truth.x[:, 0])).max() > 6
    for line in drawn(figures.states(step, trajectory)):
        assert np.abs(np.diff(line)).max() < 0.5
    assert not leaving_signals(one, trajectory)


def test_float_and_double_differ_the_short_way() -> None:
    single, double = (_Run(np.array([value])) for value in (np.pi - 1e-3, -np.pi + 1e-3))
    (one,) = differences((angle("th"),), single, double)  # type: ignore[arg-type]
    assert one.largest == pytest.approx(2e-3)


class _Run:
    """The estimate of one state."""

    def __init__(self, x: np.ndarray) -> None:
        self.x, self.t, self.status = x, np.zeros(len(x)), np.zeros(len(x))

    def __getitem__(self, name: str) -> np.ndarray:
        return self.x


def test_the_noise_of_a_compass_that_turns_steadily() -> None:
    y = 1.5 * SECONDS + 0.02 * NOISE
    line, circle = (suggest("y", course, 0.01, 0.1) for course in (y, angle("y").unwrapped(in_turn(y))))
    assert circle.sigma == pytest.approx(line.sigma, rel=1e-9)
    assert circle.sigma == pytest.approx(0.02, rel=0.1)
