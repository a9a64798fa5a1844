"""The rows held out: they judge, then the chosen gains and parameters are estimated once more from all rows."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen
from test_fit import MODEL as SPRING
from test_fit import log as spring_log
from typer import BadParameter

import hgogen as hg
from hgogen.commands import fitting
from hgogen.commands.calibrating import GainChange, numbers_in
from hgogen.commands.data import parts_of
from hgogen.model import load

PENDULUM = """
name = "pendulum"
states.q = {low = -9, high = 9, flow = "w"}
states.w = {low = -20, high = 20, flow = "-10*sin(q) - 0.3*w + u"}
inputs.u = {low = -9, high = 9}
outputs.y = {equation = "q"}
"""
DT = 0.02
ALONE = ("--jobs", "1")


def pendulum_rows(count: int, noisy_from: int) -> np.ndarray:
    """t, u, y and w of the pendulum; from row `noisy_from` on noise of the density 5 drives w, before it none."""
    draw, x, rows = np.random.default_rng(4), np.array([0.1, 0.0]), []
    for k in range(count):
        u = 2 * np.sign(np.sin(3 * k * DT))
        rows.append([k * DT, u, x[0] + 1e-2 * draw.normal(), x[1]])
        for _ in range(20):
            x = x + DT / 20 * np.array([x[1], -10 * np.sin(x[0]) - 0.3 * x[1] + u])
        x[1] += np.sqrt(DT * 5.0 * (k >= noisy_from)) * draw.normal()
    return np.array(rows)


def csv_of(path: Path, rows: np.ndarray) -> str:
    path.write_text("\n".join(["t,u,y,w", *(",".join(map(repr, row)) for row in rows.tolist()), ""]))
    return str(path)


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, ...]:
    """A model, and logs of 200 rows, the last 60 of them noisier, and of 100 others, all noisier."""
    (tmp_path / "pendulum.toml").write_text(PENDULUM)
    rows = pendulum_rows(300, 140)
    logs = csv_of(tmp_path / "log.csv", rows[:200]), csv_of(tmp_path / "other.csv", rows[200:])
    return str(tmp_path / "pendulum.toml"), *logs


@pytest.mark.full
def test_the_gains_to_take_come_from_all_rows(files: tuple[str, ...], tmp_path: Path) -> None:
    model, data, _ = files
    words = ("tune", model, "--data", data, "--time", "t", "--observers", "high_gain", "-o", str(tmp_path), *ALONE)
    report = json.loads(hgogen(*words, "--json")[0])
    plant, rows = load(model).plant, np.loadtxt(data, delimiter=",", skiprows=1)
    thetas = {
        count: hg.tune(plant, hg.Log(rows[:count, 1], rows[:count, 2], DT), observers=["high_gain"]).best.numbers.theta
        for count in (140, 200)
    }
    moved = {one["gain"]: (one["judged"], one["final"]) for one in report["changes"]}
    assert moved["theta"] == (thetas[140], thetas[200])
    assert report["tuning"]["high_gain"]["theta"] == thetas[200] != thetas[140]
    assert any("the file has its gains from all rows; theta changes most" in note for note in report["notes"])
    assert json.loads(hgogen(*words, "--held-out", "0", "--json")[0])["changes"] == []


@pytest.mark.full
def test_a_log_that_is_held_out_never_enters(files: tuple[str, ...], tmp_path: Path) -> None:
    model, data, other = files
    words = (
        "tune",
        model,
        "--data",
        data,
        "--time",
        "t",
        "--observers",
        "high_gain",
        "-o",
        str(tmp_path),
        "--json",
        *ALONE,
    )
    judged = json.loads(hgogen(*words, "--held-out", other, "--truth", "w=w")[0])
    plain = json.loads(hgogen(*words, "--held-out", "0", "--truth", "w=w")[0])
    assert judged["tuning"] == plain["tuning"]
    assert judged["changes"] == []
    assert judged["rows"][0]["hidden"]["w"] != plain["rows"][0]["hidden"]["w"]
    assert len(judged["records"]) == 2


@pytest.mark.full
def test_a_filter_is_as_good_as_one_that_knows_all_rows(files: tuple[str, ...], tmp_path: Path) -> None:
    """Gains from the first 140 rows trust the model too much: with them w errs several times as much."""
    model, data, other = files
    log = ("--time", "t", "--truth", "w=w")
    errors, moved = {}, {}
    for name, part in {"default": [], "all": ["--held-out", "0"]}.items():
        words = (
            "tune",
            model,
            "--data",
            data,
            *log,
            *part,
            "--observers",
            "riccati",
            "-o",
            str(tmp_path / name),
            *ALONE,
        )
        report = json.loads(hgogen(*words, "--json")[0])
        tuned = ("--tuning", f"{tmp_path}/{name}/tuned.json", "--observer", "riccati", "-o", str(tmp_path / name))
        ran = json.loads(hgogen("run", model, "--data", other, *log, *tuned, "--json")[0])
        errors[name] = ran["hidden"]["w"]
        moved = {one["gain"]: one["final"] / one["judged"] for one in report["changes"]} or moved
    assert errors["default"] == pytest.approx(errors["all"], rel=0.02)
    assert moved["Q w"] > 100


@pytest.mark.full
def test_a_fit_ends_on_all_rows(tmp_path: Path) -> None:
    """Its errors in the rows held out are those of the fit without them; a log held out never enters."""
    (tmp_path / "spring.toml").write_text(SPRING)
    for name, seed in {"log": 6, "other": 7}.items():
        record = spring_log(seed)
        rows = np.column_stack([0.05 * np.arange(len(record.y)), record.u, record.y, record.y])
        csv_of(tmp_path / f"{name}.csv", rows)
    words = ("fit", str(tmp_path / "spring.toml"), "--data", str(tmp_path / "log.csv"), "--time", "t", "--starts", "1")
    reports = {}
    for name, part in {
        "default": [],
        "all": ["--held-out", "0"],
        "file": ["--held-out", f"{tmp_path}/other.csv"],
    }.items():
        reports[name] = json.loads(hgogen(*words, *part, "-o", str(tmp_path / name), "--json")[0])
    default, whole, file = reports["default"], reports["all"], reports["file"]
    assert default["parameters"] == pytest.approx(whole["parameters"], rel=1e-4)
    assert default["changes"]["k"]["final"] == default["parameters"]["k"] != default["changes"]["k"]["judged"]
    assert any("the file has parameters fitted to all rows" in " ".join(note.split()) for note in default["notes"])
    assert file["parameters"] == whole["parameters"]
    assert {one["record"] for one in file["predictions"]} == {str(tmp_path / "other.csv")}
    assert file["changes"] == whole["changes"] == {}


def test_of_a_search_that_did_not_settle_nothing_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the second, on all rows: the parameters are those that the rows held out judged."""
    fits = list[hg.Fit]()

    def fit(*logs: object, **options: object) -> hg.Fit:
        one = hg.fit(*logs, **options)  # type: ignore[arg-type]
        fits.append(replace(one, starts=tuple(replace(each, settled=not fits) for each in one.starts)))
        return fits[-1]

    monkeypatch.setattr(fitting, "fit", fit)
    (tmp_path / "spring.toml").write_text(SPRING)
    record = spring_log(6)
    columns = (0.05 * np.arange(len(record.y)), record.u, record.y, record.y)
    data = csv_of(tmp_path / "log.csv", np.column_stack(columns))
    words = ("fit", str(tmp_path / "spring.toml"), "--data", data, "--time", "t", "--starts", "1", "--free", "k")
    report = json.loads(hgogen(*words, "-o", str(tmp_path), "--json")[0])
    assert report["parameters"] == fits[0].values != fits[1].values
    assert report["changes"] == {}
    assert any("since the search on all rows did not settle" in note for note in report["notes"])


def test_a_search_may_begin_at_other_values() -> None:
    plant = load(Path(__file__).resolve().parents[1] / "models" / "pendulum.py").plant
    log = hg.Log(np.zeros(20), np.zeros(20), 0.01)
    with pytest.raises(hg.HgogenError, match="begin 'c' is unknown"):
        hg.fit(plant, log, free=["a"], begin={"c": 1.0})
    fit = hg.fit(plant, log, free=["a"], begin={"a": 7.0}, starts=1)  # a log at rest tells nothing of a
    assert fit.parameters[0].value == pytest.approx(7.0, rel=0.05)
    assert fit.parameters[0].nominal == 19.6


@pytest.mark.parametrize("text", ["1", "-0.1", "half", "nan", "no.csv"])
def test_a_part_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadParameter, match=r"is neither a part from 0 to 0\.9 of each log nor files of logs"):
        parts_of([text])


def test_numbers_of_gains_have_names_and_distances() -> None:
    gains = {"Q": {"q": 1.0, "w": 2}, "poles": [(-1, -2)], "R": 3.0, "initial": "x", "flag": None}
    assert dict(numbers_in(gains)) == {"Q q": 1.0, "Q w": 2.0, "poles 1 1": -1.0, "poles 1 2": -2.0, "R": 3.0}
    pairs = [(1.0, 4.0), (-4.0, -1.0), (0.0, 0.0), (1.0, -1.0), (0.0, 2.0)]
    assert [GainChange("", *pair).factor for pair in pairs] == [4.0, 4.0, 1.0, np.inf, np.inf]


@pytest.mark.parametrize("between", ["hold", "line"])
def test_rows_held_out_are_judged_with_inputs_as_fitted(between: str, tmp_path: Path) -> None:
    """A command that holds from its row to the next, or goes on along a line: the errors are the noise of a sample,
    also with an observer of the model that takes inputs otherwise."""
    draw, dt, at, rows = np.random.default_rng(3), 0.1, 0.0, []
    commands = draw.uniform(-1, 1, 401)
    for k, (u, after) in enumerate(itertools.pairwise(commands)):
        rows.append((dt * k, u, at + 0.002 * draw.normal()))
        for part in (np.arange(40) + 0.5) / 40:
            at += dt / 40 * 4 * ((u if between == "hold" else u + (after - u) * part) - at)
    csv_of(tmp_path / "log.csv", np.column_stack([rows, np.zeros(400)]))
    other = {"hold": "line", "line": "hold"}[between]
    (tmp_path / "lag.toml").write_text(f"""
name = "lag"
states.x = {{low = -2, high = 2, flow = "a*(u - x)"}}
inputs.u = {{low = -1, high = 1}}
parameters.a = {{value = 3, low = 1, high = 9}}
outputs.y = {{equation = "x"}}
observer = {{kind = "riccati", form = "original", dt = 0.1, between = "{other}", Q = [1e-4], noise = {{y = 0.002}}}}
""")
    words = ("fit", str(tmp_path / "lag.toml"), "--data", str(tmp_path / "log.csv"), "--time", "t", "--starts", "1")
    report = json.loads(hgogen(*words, "--between", between, "-o", str(tmp_path), "--json")[0])
    assert report["parameters"]["a"] == pytest.approx(4, rel=0.02)
    first = next(one for one in report["predictions"] if one["ahead"] == 1)
    assert first["fitted"] < 0.003 < 0.01 < first["copying"]
