"""Logs whose rows have no period: they keep their times, in fits, filters and commands."""

import csv
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from test_cli import hgogen

import hgogen as hg
from hgogen.logs.judged import _last_two
from hgogen.logs.likelihood import Noise
from hgogen.logs.records import BadLog, step_limits
from hgogen.logs.tune import likelihood_of
from hgogen.reading.cells import BadRecord
from hgogen.reading.measured import difference
from hgogen.starting import per_sample

Array = np.ndarray
# minutes, and the insulin then, of an intravenous test: rows 2 to 20 min apart
T = np.array([0, 2, 4, 6, 8, 10, 12, 14, 16, 19, 22, 27, 32, 42, 52, 62, 72, 92, 112, 132.0])
INSULIN = np.array([11, 26, 130, 85, 51, 49, 45, 41, 35, 30, 30, 27, 30, 22, 15, 15, 11, 10, 8, 11.0])
TRUE = {"p1": 0.0265, "p2": 0.0205, "p3": 1.3e-5}
MODEL = """
name = "glucose"
time = "min"
inputs = {insulin = {low = 0, high = 200}}
outputs = {glucose = {equation = "G", low = 0, high = 600}}

[states]
G = {flow = "-(p1 + X)*G + 92*p1", low = 20, high = 500}
X = {flow = "-p2*X + p3*(insulin - 11)", low = -0.02, high = 0.1}

[parameters]
p1 = {value = 0.03, low = 0.001, high = 0.2}
p2 = {value = 0.02, low = 0.001, high = 0.2}
p3 = {value = 1e-5, low = 1e-7, high = 1e-4}

[observer]
kind = "riccati"
form = "original"
dt = [2, 4]
noise = {glucose = 1.0}
Q = {G = 0.1, X = 1e-7}
"""


def glucose() -> hg.System:
    G, X = hg.Signal("G", low=20, high=500), hg.Signal("X", low=-0.02, high=0.1)
    insulin, y = hg.Signal("insulin", low=0, high=200), hg.Signal("glucose", low=0, high=600)
    bounds = {"p1": (0.03, 0.001, 0.2), "p2": (0.02, 0.001, 0.2), "p3": (1e-5, 1e-7, 1e-4)}
    p = {name: hg.Signal(name, "", "", *each) for name, each in bounds.items()}
    flow = [-(p["p1"] + X) * G + 92 * p["p1"], -p["p2"] * X + p["p3"] * (insulin - 11)]
    return hg.System(
        "glucose", states=(G, X), inputs=(insulin,), outputs=(y,), parameters=p.values(), flow=flow, output=[G]
    )


def simulated(p: Array, start: Array, between: str) -> Array:
    """The glucose (20) at the rows by an adaptive method of order 8 from row to row."""
    rows = [start]
    for a, b, now, then in zip(T, T[1:], INSULIN, INSULIN[1:], strict=False):

        def slope(t: float, x: Array, a: float = a, b: float = b, now: float = now, then: float = then) -> list[float]:
            insulin = now + (then - now) * (t - a) / (b - a) * (between == "line")
            return [-(p[0] + x[1]) * x[0] + 92 * p[0], -p[1] * x[1] + p[2] * (insulin - 11)]

        rows.append(solve_ivp(slope, (a, b), rows[-1], method="DOP853", rtol=1e-8, atol=1e-10).y[:, -1])
    return np.array(rows)[:, 0]


@cache
def measured(between: str) -> Array:
    noise = np.random.default_rng(1).normal(0, 2, len(T))
    return simulated(np.array([*TRUE.values()]), np.array([290, 0.0]), between) + noise


@cache
def least(between: str) -> dict[str, float]:
    """The parameters of least squares from the true times, by another integrator and another search."""
    unit = np.array([1e-2, 1e-2, 1e-5, 1e2, 1e-2])

    def residuals(v: Array) -> Array:
        return simulated(unit[:3] * v[:3], unit[3:] * v[3:], between) - measured(between)

    best = least_squares(residuals, [2.6, 2, 1.3, 2.9, 0.0], xtol=1e-9, ftol=1e-12)
    return dict(zip(TRUE, (best.x * unit)[:3].tolist(), strict=True))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "glucose.toml").write_text(MODEL)
    rows = "".join(f"{t:g},{y:.10g},{u:g}\n" for t, y, u in zip(T, measured("hold"), INSULIN, strict=True))
    (tmp_path / "log.csv").write_text(f"minute,glucose,insulin\n{rows}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- fits -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("between", ["hold", "line"])
def test_a_fit_is_that_at_the_true_times(between: str) -> None:
    log = hg.Log(INSULIN[:, None], measured(between)[:, None], 3.0, times=T)
    fitted = hg.fit(glucose(), log, starts=1, between=between)
    assert fitted.values == pytest.approx(least(between), rel=1e-3)
    for name, value in TRUE.items():
        assert abs(fitted.values[name] - value) < 2 * fitted.deviation[name]


@pytest.mark.full
def test_the_command_fits_at_the_times_of_the_rows(folder: Path) -> None:
    plain = MODEL.partition("[observer]")[0]  # nothing in the model says that dt varies
    (folder / "glucose.toml").write_text(plain)
    words = ("fit", "glucose.toml", "--data", "log.csv", "--time", "minute", "--json")
    report = json.loads(hgogen(*words, "--held-out", "0")[0])
    assert report["parameters"] == pytest.approx(least("hold"), rel=1e-3)
    assert report["records"][0]["spacing"] == [2, 20]
    assert len(json.loads(hgogen(*words)[0])["predictions"]) >= 2  # of the rows held out, by steps from row to row
    printed = hgogen("fit", "glucose.toml", "--data", "log.csv", "--time", "minute", "--dt", "3", "--starts", "1")[0]
    assert "without a period" in printed
    assert "became 45 samples of 3 min" in printed


def test_a_prediction_error_grows_with_the_elapsed_time() -> None:
    """x' = -a x + w, sampled at random times; its variance is that of the exact discretisation."""
    rng, a = np.random.default_rng(3), 0.7
    t = np.cumsum(rng.choice([0.1, 0.25, 0.7], 150))
    x = [0.0]
    for h in np.diff(t):
        x.append(x[-1] * np.exp(-a * h) + rng.normal(0, np.sqrt((1 - np.exp(-2 * a * h)) / (2 * a))))
    X, rate = hg.Signal("x", low=-9, high=9), hg.Signal("a", "", "", 1.5, 0.1, 5)
    plant = hg.System("ou", states=(X,), outputs=(hg.Signal("y"),), parameters=(rate,), flow=[-rate * X], output=[X])
    log = hg.Log(np.zeros((150, 0)), (np.array(x) + rng.normal(0, 0.3, 150))[:, None], 0.4, times=t)
    fitted = hg.fit(plant, log, by="prediction", starts=1)
    assert abs(fitted.values["a"] - a) < 3 * fitted.deviation["a"]
    assert fitted.noise[0]["x"] == pytest.approx(1, rel=0.5)
    assert fitted.noise[1]["y"] == pytest.approx(0.3, rel=0.2)


# --- filters ----------------------------------------------------------------------------------------------------


def test_innovations_are_those_of_a_kalman_filter_from_row_to_row() -> None:
    """Of a random walk: P grows by q times the elapsed time, and the variance of a sample stays."""
    t = np.cumsum([0, 1, 3, 1, 7, 2, 2, 9, 1, 1, 4, 2.0])
    y = np.random.default_rng(0).normal(size=len(t))
    x = hg.Signal("x", low=-10, high=10)
    plant = hg.System("walk", states=(x,), outputs=(hg.Signal("y", low=-10, high=10),), flow=[0], output=[x])
    log = hg.Log(np.zeros((len(t), 0)), y[:, None], 2.0, times=t)
    q, r = 0.3, 0.5
    of_filter = likelihood_of(hg.forms.original(plant), [log], 2.0, "line", ())
    e, s = of_filter.innovations(Noise({"x": q}, {"y": np.sqrt(r)}, 0.0, True), log)
    estimate, P, wanted = y[0], 25.0, []
    for h, sample in zip(np.diff(t), y[1:], strict=True):
        P += q * h
        wanted.append((sample - estimate, P + r))
        estimate, P = estimate + P / (P + r) * (sample - estimate), P * r / (P + r)
    assert np.column_stack([e, s]) == pytest.approx(np.array(wanted), rel=1e-9)


def test_gains_are_tuned_from_row_to_row() -> None:
    """The Q and R of a random walk, and a step that is given the true times in at most its sub-steps."""
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.choice([1.0, 1.4, 2.7, 6.3], 400))
    walk = np.cumsum(rng.normal(0, np.sqrt(0.2 * np.diff(t, prepend=t[0]))))
    x = hg.Signal("x", low=-40, high=40)
    plant = hg.System("walk", states=(x,), outputs=(hg.Signal("y", low=-40, high=40),), flow=[0], output=[x])
    log = hg.Log(np.zeros((400, 0)), (walk + rng.normal(0, 0.5, 400))[:, None], 2.0, times=t)
    (row,) = (one for one in hg.tune(plant, log, observers=("riccati",)).rows if one.name == "riccati")
    assert row.noise is not None
    assert row.noise.process["x"] == pytest.approx(0.2, rel=0.3)
    assert row.noise.sample["y"] == pytest.approx(0.5, rel=0.2)
    step = row.first.step
    assert step.limits == step_limits([log])
    run = step.run(y=log.y, dt=log.elapsed)
    assert not any("DT_LIMITED" in step.flags(status) for status in run.status)
    assert run.variances is not None
    wide = log.elapsed[100:] > 6  # the innovations are larger after a longer time, and as large as they are taken to be
    assert run.variances[100:][wide].mean() > 1.5 * run.variances[100:][~wide].mean()
    for those in (wide, ~wide):
        assert np.mean((run.innovations[100:] ** 2 / run.variances[100:])[those]) == pytest.approx(1, abs=0.35)
    assert list(row.table["dt"]) == list(step.limits)


def test_two_sensors_are_tuned_from_row_to_row() -> None:
    """Gains by the names of the outputs, one of which comes in every other row."""
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.choice([1.0, 1.4, 2.7], 200))
    walk = np.cumsum(rng.normal(0, np.sqrt(0.2 * np.diff(t, prepend=t[0]))))
    x = hg.Signal("x", low=-40, high=40)
    outputs = hg.Signal("y", low=-40, high=40), hg.Signal("z", low=-80, high=80)
    plant = hg.System("walk", states=(x,), outputs=outputs, flow=[0], output=[x, 2 * x])
    samples = np.column_stack([walk + rng.normal(0, 0.5, 200), 2 * walk + rng.normal(0, 0.2, 200)])
    samples[::2, 1] = np.nan
    log = hg.Log(np.zeros((200, 0)), samples, 2.0, times=t)
    row = hg.tune(plant, log, observers=("riccati",)).rows[0]
    assert row.noise is not None
    assert row.noise.sample["y"] == pytest.approx(0.5, rel=0.3)
    variances = {name: sigma**2 for name, sigma in row.noise.sample.items()}
    assert row.table["R_per_sample"] == pytest.approx(variances, rel=0.03)  # of two digits
    rule, gains = hg.observers.riccati, {"Q": {"x": 0.2}, "R": {"y": 0.4, "z": [0.2, 6.0]}}
    assert per_sample(rule, gains, 2.0) == {"Q": {"x": 0.2}, "R_per_sample": {"y": 0.2, "z": [0.1, 3.0]}}


@pytest.mark.full
def test_run_and_inspect_filter_from_row_to_row(folder: Path) -> None:
    words = ("glucose.toml", "--data", "log.csv", "--time", "minute")
    initial = f"G={measured('hold')[0]:.12g},X=0"  # else X begins where the first samples imply
    report = json.loads(hgogen("run", *words, "--initial", initial, "--out", "run", "--json")[0])
    with (folder / "run" / "log_estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["t"]) for row in rows] == T.tolist()
    from hgogen.model import load

    step = load(folder / "glucose.toml").step().started({"G": measured("hold")[0], "X": 0.0})
    wanted = step.run(u=INSULIN, y=measured("hold"), dt=np.diff(T, prepend=0))
    assert [float(row["G"]) for row in rows] == pytest.approx(wanted["G"], rel=1e-8)
    model = next(one["model"] for one in report["predictions"] if one["ahead"] == 1)
    assert model < 4  # 2 is the noise; a row is 12 from the one before
    inspected = json.loads(hgogen("inspect", *words, "--json")[0])
    assert inspected["findings"] == []
    assert [one for one in inspected["notes"] if one.startswith("the rows are not evenly spaced, so that no delay")]


@pytest.mark.full
def test_a_model_whose_dt_varies_is_tuned_at_its_limits(folder: Path) -> None:
    """A log with jitter has a period, and keeps the times of its rows all the same."""
    rng, x = np.random.default_rng(2), 0.0
    t, rows = np.arange(120) + np.random.default_rng(1).uniform(-0.2, 0.2, 120), []
    for h in np.diff(t, prepend=t[0]):
        x += rng.normal(0, np.sqrt(0.2 * h))
        rows.append(x + rng.normal(0, 0.5))
    text = "\n".join(f"{at:.10g},{y:.10g}" for at, y in zip(t, rows, strict=True))
    (folder / "jitter.csv").write_text(f"t,y\n{text}\n")
    (folder / "walk.toml").write_text(
        'name = "walk"\nstates = {x = {flow = "0", low = -40, high = 40}}\n'
        'outputs = {y = {equation = "x", low = -40, high = 40}}\n'
        'observer = {kind = "riccati", dt = [0.5, 1.5], noise = {y = 1.0}, Q = {x = 1.0}}\n'
    )
    words = ("tune", "walk.toml", "--data", "jitter.csv", "--time", "t", "--observers", "riccati", "--json")
    report = json.loads(hgogen(*words)[0])
    assert report["records"][0]["spacing"] is not None
    assert report["tuning"]["riccati_tuned"]["dt"] == [0.5, 1.5]
    assert {"riccati_tuned", "riccati, as declared"} <= {row["name"] for row in report["rows"]}
    assert json.loads(hgogen(*words, "--dt", "1")[0])["tuning"]["riccati_tuned"]["dt"] == 1


# --- reading ----------------------------------------------------------------------------------------------------


def read(tmp_path: Path, t: Array, **options: object) -> hg.Log:
    rows = "".join(f"{each:.10g},{k}\n" for k, each in enumerate(t))
    (tmp_path / "log.csv").write_text(f"t,y\n{rows}")
    x = hg.Signal("x")
    plant = hg.System("p", states=(x,), outputs=(hg.Signal("y"),), flow=[-x], output=[x])
    return hg.record(tmp_path / "log.csv", plant, time="t", **options)


def test_only_a_log_without_a_period_keeps_its_times(tmp_path: Path) -> None:
    irregular = read(tmp_path, T)
    assert irregular.times is not None
    assert irregular.times.tolist() == T.tolist()
    assert irregular.elapsed.tolist() == np.diff(T, prepend=0).tolist()
    assert irregular.ahead.tolist() == [*np.diff(T), irregular.dt]
    assert read(tmp_path, T, dt=2.0).times is None
    grid = np.arange(60) * 0.5
    for regular in (grid, np.delete(grid, np.arange(3, 50, 4)), grid + 0.1 * np.sin(np.arange(60))):
        assert read(tmp_path, regular).times is None
    twice = read(tmp_path, np.sort([*T, 42, 42]))
    assert twice.times is not None
    assert twice.times.tolist() == T.tolist()
    assert read(tmp_path, T[::-1]).y[:, 0].tolist() == list(range(19, -1, -1))


def test_a_step_takes_the_longest_time_in_its_substeps() -> None:
    logs = [hg.Log(np.zeros((5, 0)), np.ones((5, 1)), 1.0, times=np.array([0, 1, 2, 3, 23.0]))]
    assert step_limits(logs) == pytest.approx((1, 2.5))
    assert step_limits([hg.Log(np.zeros((5, 0)), np.ones((5, 1)), 1.0)]) is None


def test_what_counts_samples_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadRecord, match="counts samples of one period"):
        read(tmp_path, T, shift={"y": 1})
    (tmp_path / "held.csv").write_text("t,y,u\n" + "".join(f"{t},0,{k}\n" for k, t in enumerate(T)))
    x, y, u = hg.Signal("x"), hg.Signal("y"), hg.Signal("u")
    moved = hg.System("held", states=(x,), inputs=(u,), outputs=(y,), flow=[u - x], output=[x])
    log = hg.record(tmp_path / "held.csv", moved, time="t", shift={"u": 1})
    assert log.times is not None
    assert log.u[:, 0].tolist()[1:] == list(range(len(T) - 1))  # the input of each row is that of the row before
    x, y, none = hg.Signal("x"), hg.Signal("y"), np.zeros((20, 0))
    samples = np.arange(20.0)[:, None]
    held = hg.System("map", states=(x,), outputs=(y,), flow=[x / 2], output=[x], discrete=True)
    with pytest.raises(BadRecord, match="is discrete in time"):
        hg.record(tmp_path / "log.csv", held, time="t")
    for times in (T[:19], T[::-1], np.where(T == 8, np.nan, T)):
        with pytest.raises(BadLog, match="times of shape"):
            hg.fit(glucose(), hg.Log(INSULIN[:, None], samples, 1.0, times=times))
    assert none.size == 0


def test_differences_are_over_the_elapsed_time() -> None:
    elapsed = np.diff(T, prepend=0)
    assert difference(3 * T, 1, elapsed) == pytest.approx(np.full(20, 3.0))
    assert difference(T**2, 1, elapsed)[1:] == pytest.approx(T[1:] + T[:-1])
    y = np.array([[0.0], [np.nan], [4.0], [5.0]])
    last, at, rate = _last_two((hg.Signal("y"),), y, np.array([0, 1, 2, 4.0]))
    assert last.ravel().tolist() == [0, 0, 4, 5]
    assert at.ravel().tolist() == [0, 0, 2, 4]
    assert rate.ravel().tolist() == [0, 0, 2, 0.5]
