"""Observers side by side, and what a call costs."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.commands import comparing
from hgogen.commands.app import app
from hgogen.emit.cost import cost
from hgogen.model import MissingPart, Model, load
from hgogen.program import Block, Kernel, Loop, Place, Statement, When, sym
from hgogen.run import figures as figure
from hgogen.run.comparison import error_rises, measured
from hgogen.run.metrics import SHARE, criterion
from hgogen.step import Step
from hgogen.trial import Jump, Trajectory, Trial, Truth, try_out

ROOT = Path(__file__).resolve().parents[1]
HYPERJERK = load(ROOT / "models" / "hyperjerk.py")
TRIAL = replace(HYPERJERK.trials()[0], duration=6.0, settled=None, seeds=(0,))


@cache
def step(name: str) -> CallableStep:
    return HYPERJERK.step(name, dt=0.005)


def priced(*program: Statement) -> tuple[int, int]:
    """Operations and functions of a program in the place of a step's own."""
    whole = step("high_gain")
    plain = Step(whole.name, whole.observer, whole.method, whole.clock, whole.layout, whole.code)
    price = cost(replace(plain, code=replace(plain.code, estimate=program, sections=())))
    return price.operations, price.functions


A, B = sym("work", "a"), sym("work", "b")
LONG = Block("three", {Place("work", "c"): (A + B) * A - B})
SHORT = Block("one", {Place("work", "c"): A + B})
SINE = Block("a product and a sine", {Place("work", "c"): A * ca.sin(B)})


@pytest.mark.parametrize(
    ("program", "counts"),
    [
        ((), (0, 0)),
        ((LONG, SHORT), (4, 0)),
        ((SINE,), (1, 1)),
        ((Block("a copy and a number", {Place("work", "c"): A, Place("work", "d"): ca.SX(3)}),), (0, 0)),
        ((Loop("member", 5, (SINE, SHORT)),), (10, 5)),
        ((When(Place("work", "flag"), (SHORT,), (LONG,)),), (3, 0)),
        # by hand, `kernels.correct` for two states: 5 for the second, 12 for the first, 2 for the gain
        (
            (
                Kernel(
                    "correct",
                    2,
                    "columns.l",
                    (
                        (Place("state", "d"), 2),
                        (Place("work", "c"), 2),
                        (Place("work", "r"), 1),
                        (Place("work", "gain"), 2),
                    ),
                    counts=(2,),
                ),
            ),
            (19, 0),
        ),
    ],
)
def test_operations_are_counted(program: tuple[Statement, ...], counts: tuple[int, int]) -> None:
    assert priced(*program) == counts


def test_bytes_are_those_of_the_structs() -> None:
    """The mark, z (4), fault count and limit of two signs and their checksum, calls, then y and whether it was valid:
    thirteen words of four bytes; in double the mark and calls are padded."""
    price = cost(step("high_gain"))
    assert price.state == 4 * (1 + 4 + 5 + 1 + 2)
    assert cost(step("high_gain"), "double").state == 8 * (1 + 4 + 5 + 1 + 2)
    assert cost(step("low_power")).state == price.state + 4 * 2  # 2n - 2 states in place of n


def test_observers_meet_the_same_noise() -> None:
    first, second = (
        measured(name, step(name), TRIAL, "python", (0,), lambda: None) for name in ("high_gain", "filtered")
    )
    assert np.array_equal(first.first.y, second.first.y)
    assert not np.array_equal(first.first.x, second.first.x)
    assert (first.name, first.observer, second.observer) == ("high_gain", "high_gain", "filtered")


def test_metrics_are_those_of_the_errors() -> None:
    """Without a band of its own a trial is settled when every error keeps to a share of its range."""
    ticks: list[int] = []
    metrics = measured("filtered", step("filtered"), TRIAL, "python", (0,), lambda: ticks.append(1))
    assert ticks == [1]
    assert criterion(TRIAL) == "every error within 5% of its state's range until the next event"
    error, width = np.abs(metrics.first.error), np.array([s.high - s.low for s in step("filtered").states])
    risen = (error.max(axis=0) - error[0]) / width
    assert metrics.peak == pytest.approx(dict(zip(metrics.rms, risen, strict=True)))
    (when,) = metrics.settled
    assert when is not None
    k = round(when / 0.005)
    relative = (error / width).max(axis=1)
    assert relative[k - 1] > SHARE >= relative[k:].max()
    steady = error[metrics.first.truth.t >= 5.4 - 1e-9]
    assert list(metrics.rms.values()) == pytest.approx(list(np.sqrt((steady**2).mean(axis=0))))


def test_peaking_is_a_rise_after_an_event_not_the_event_itself() -> None:
    """e = 1 at the start, falling; 3 by a jump at 1 s, rising by 2 before it falls: the largest rise is 2."""
    t = np.arange(5) * 0.5
    error = np.array([[1.0], [0.5], [-3.0], [-5.0], [0.0]])
    jumps = (Jump(1.0, "x", 1.0),)
    truth = Truth(t, np.zeros((5, 1)), np.zeros((5, 0)), np.zeros((5, 1)))
    trial = Trial("two", 2.0, {"x": 0}, jumps=jumps)
    one = Trajectory(trial, 0, truth, truth.y, error, {}, np.zeros(5), "python")
    assert error_rises(one).tolist() == [2.0]


@pytest.mark.full
def test_every_observer_starts_from_the_trial_s_estimate() -> None:
    """In coordinates that read an input at its first value, with a start of its own, as member of a bank."""
    bioreactor = load(ROOT / "models" / "bioreactor.py")
    (trial,) = bioreactor.trials()
    wanted = {"m": 0.06, "s": 0.05}
    trial = replace(trial, estimate=wanted, duration=0.1, steady=None)
    for name in ("lambda_tracking", "low_power", "cascade", "high_gain", "riccati", "bank"):
        (one,) = try_out(bioreactor.step(name, 0.01, trial.first_estimate), trial, "python", (0,))
        assert one.x[0, 1] == pytest.approx(wanted["s"]), name  # the first sample corrects m, and no s, of a filter
        if name not in ("riccati", "bank"):
            assert one.x[0, 0] == pytest.approx(wanted["m"]), name
    (own,) = try_out(bioreactor.step("lambda_tracking"), trial, "python", (0,))  # by the trial, not by its own start
    assert own.x[0, 1] == pytest.approx(wanted["s"])


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_a_start_on_the_truth_is_said(tmp_path: Path) -> None:
    path, text = tmp_path / "hyperjerk.py", (ROOT / "models" / "hyperjerk.py").read_text()
    line = 'start={"x1": -0.9, "x2": 0, "x3": 0, "x4": 0},'
    path.write_text(text.replace(line, f'{line} estimate={{"x1": -0.9}},'))
    arguments = ["--observers", "high_gain", "--seeds", "1", "-o", str(tmp_path)]
    for model, on_truth in ((path, True), (ROOT / "models" / "hyperjerk.py", False)):
        done = CliRunner().invoke(app, ["compare", str(model), *arguments])
        assert ("every observer starts on the truth" in " ".join(done.stderr.split())) is on_truth
        begins = "-0.9" if on_truth else "0"
        sentence = f"every observer starts at x1 = {begins}, x2 = 0, x3 = 0, x4 = 0; the plant at x1 = -0.9"
        assert sentence in " ".join(done.stdout.split())  # however wide the terminal is


def test_no_error_rises_before_its_jump() -> None:
    """A jump between two cuts of the time: until its sample the line stays at what was there."""
    t, k = np.arange(10_000) * 1e-3, 5017
    error = np.where(np.arange(len(t)) < k, 0.01, 1.0)[:, None]
    (axis,) = figure.errors([hg.Signal("x")], t, {"one": error}, (0.0, t[k], t[-1] + 1)).axes
    (line,) = axis.get_lines()
    shown = np.column_stack(line.get_data())
    assert line.get_drawstyle() == "steps-post"
    assert shown[shown[:, 0] < t[k], 1].max() == 0.01
    assert shown[np.isclose(shown[:, 0], t[k]), 1].tolist() == [1.0]


def test_the_lines_of_sixteen_observers_differ_and_the_legend_has_room() -> None:
    """Each has a colour and dashes of its own; the legend lies within the figure, right of the panels."""
    t, names = np.arange(5) * 1.0, [f"a_filtered_injection_{k}" for k in range(16)]
    drawn = figure.errors([hg.Signal("x")], t, {name: np.ones((5, 1)) for name in names})
    looks = {(line.get_color(), line.get_linestyle()) for line in drawn.axes[0].get_lines()}
    assert len(looks) == len(names)
    figure.png(drawn)  # places the legend
    box, whole = drawn.legends[0].get_window_extent(), drawn.bbox
    assert drawn.axes[0].get_window_extent().x1 <= box.x0 < box.x1 <= whole.x1
    assert whole.y0 <= box.y0 < box.y1 <= whole.y1


def test_what_never_settles_is_none() -> None:
    short = replace(TRIAL, duration=0.2)
    metrics = measured("filtered", step("filtered"), short, "python", (0,), lambda: None)
    assert metrics.settled == (None,)


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_one_observer_is_settled_as_beside_others(tmp_path: Path) -> None:
    """Without a band of its own the trial has one criterion for both commands, and both print it."""
    path = tmp_path / "hyperjerk.py"
    text = (ROOT / "models" / "hyperjerk.py").read_text()
    path.write_text(text.replace('settled=Settled("x4", band=0.5, hold=3)', "settled=None"))
    common = ["--seeds", "1", "--engine", "python", "--json"]
    one = CliRunner().invoke(app, ["simulate", str(path), "--observer", "filtered", *common])
    beside = CliRunner().invoke(app, ["compare", str(path), "--observers", "filtered", "-o", str(tmp_path), *common])
    (alone,), (trial,) = json.loads(one.stdout)["trials"], json.loads(beside.stdout)["trials"]
    assert alone["settled"] == trial["observers"][0]["settled"] != [None]
    assert alone["criterion"] == trial["criterion"] == criterion(TRIAL)
    table = CliRunner().invoke(app, ["simulate", str(path), "--observer", "filtered", *common[:4]])
    assert criterion(TRIAL) in " ".join(table.stdout.split())
    assert "never" not in table.stdout


def test_the_command_prints_and_draws(tmp_path: Path) -> None:
    arguments = ["compare", str(ROOT / "models" / "hyperjerk.py"), "--seeds", "1", "-o", str(tmp_path)]
    printed = CliRunner().invoke(app, [*arguments, "--json", "--observers", "high_gain, low_power,high_gain"])
    assert printed.exit_code == 0
    answer = json.loads(printed.stdout)
    (trial,) = answer["trials"]
    assert [one["name"] for one in trial["observers"]] == ["high_gain", "low_power"]
    high, low = trial["observers"]
    assert low["rms"]["x4"] < high["rms"]["x4"] / 100  # a tone of frequency 100 goes through k^4 in the one
    assert low["operations"] > high["operations"] > 100
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tone_errors.png", "tone_errors.svg"]
    assert answer["files"] == [str(tmp_path / f"tone_errors.{ending}") for ending in ("svg", "png")]


def test_the_tables_say_what_their_columns_mean() -> None:
    """And by which method each is carried out, where there are several."""
    one = measured("high_gain", step("high_gain"), TRIAL, "python", (0,), lambda: None)
    text = said(comparing.comparison_tables("title", [one], "s", {"x": 1.0}, {"x": 2.0}))
    assert "steady: from 5.4 s on, the median of the seeds; peaking: of all seeds" in text
    assert "functions (sine, exponential, root, ..): of one call" in text
    assert "every observer starts at x = 1; the plant at x = 2" in text
    assert "by " not in text
    text = said(comparing.comparison_tables("title", [one, replace(one, name="other", method="bilinear")], "s", {}, {}))
    assert f"by {one.method}: high_gain; by bilinear: other" in text


def said(shown: Any) -> str:
    console = Console(width=120)
    with console.capture() as captured:
        console.print(shown)
    return captured.get()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("high_gain,wiener", "there is no observer 'wiener'"),
        ("high_gain,,low_power", "there is no observer to compare; give --observers A,B of its tuning"),
    ],
)
def test_what_cannot_be_compared_is_a_sentence(names: str, said: str, tmp_path: Path) -> None:
    arguments = ["compare", str(ROOT / "models" / "hyperjerk.py"), "--observers", names, "-o", str(tmp_path)]
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert said in refused.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_one_that_is_refused_does_not_stop_the_others(tmp_path: Path) -> None:
    """At its own period, or at the shortest; and where all are, the first refusal is the error."""
    text = (ROOT / "models" / "hyperjerk.py").read_text()
    path = tmp_path / "hyperjerk.py"
    path.write_text(
        text.replace('"low_power": {"theta": 4}', '"low_power": {"theta": -4}, "bad": {"kind": "high_gain"}')
    )
    arguments = ["compare", str(path), "-o", str(tmp_path), "--observers"]
    done = CliRunner().invoke(app, [*arguments, "low_power,high_gain,bad", "--seeds", "1", "--json"])
    assert done.exit_code == 0, done.stderr
    answer = json.loads(done.stdout)
    assert [one["name"] for one in answer["trials"][0]["observers"]] == ["high_gain"]
    assert {name: reason.partition("theta")[1] for name, reason in answer["refused"].items()} == {
        "low_power": "theta",
        "bad": "theta",
    }
    shown = " ".join(CliRunner().invoke(app, [*arguments, "low_power,high_gain", "--seeds", "1"]).stdout.split())
    assert "refused, and not compared" in shown
    runs = CliRunner().invoke(app, [*arguments, "low_power,high_gain", "--runs", "2", "--jobs", "1", "--json"])
    assert list(json.loads(runs.stdout)["refused"]) == ["low_power"]
    alone = CliRunner().invoke(app, [*arguments, "low_power,bad"])
    assert alone.exit_code == 2
    first, second = alone.stderr.split("hgogen: ")[1:]
    assert first.startswith("bad is refused as well: ")
    assert second.strip() == answer["refused"]["low_power"]


@pytest.mark.usefixtures("undrawn")
def test_one_that_is_refused_at_the_shortest_period_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / "models" / "hyperjerk.py").read_text()
    path, made = tmp_path / "hyperjerk.py", Model.step
    path.write_text(text.replace('"low_power": {"theta": 4}', '"low_power": {"theta": 4, "dt": 2e-3}'))

    def only_at_its_own(model: Model, observer: str | None, dt: float | None, *rest: Any) -> CallableStep:
        if dt is not None:
            raise MissingPart(model.path, "too short")
        return made(model, observer, dt, *rest)

    monkeypatch.setattr(Model, "step", only_at_its_own)
    arguments = ["compare", str(path), "--observers", "high_gain,low_power", "--seeds", "1", "-o", str(tmp_path)]
    answer = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert [one["name"] for one in answer["trials"][0]["observers"]] == ["high_gain"]
    assert answer["refused"] == {"low_power": f"{path}: too short"}


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_all_are_sampled_at_the_shortest_period(tmp_path: Path) -> None:
    text = (ROOT / "models" / "hyperjerk.py").read_text()
    path = tmp_path / "hyperjerk.py"
    path.write_text(text.replace('"low_power": {"theta": 4}', '"low_power": {"theta": 4, "dt": 2e-3}'))
    arguments = ["compare", str(path), "--observers", "high_gain,low_power", "--seeds", "1", "-o", str(tmp_path)]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert json.loads(done.stdout)["dt"] == 1e-3
    assert "all sampled at dt = 0.001 s, the shortest; low_power would be sampled more slowly" in done.stderr
    assert load(path).step("low_power").dt == 2e-3
    assert isinstance(load(path).step("low_power", 1e-3), hg.Step)


BOUNDED = """
import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Trial
import sympy as sp

q, w, y = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20), hg.Signal("y")
plant = hg.System("swing", states=(q, w), outputs=(y,), flow=[w, -19.6 * sp.sin(q)], output=[q])
tuning = {"high_gain": {"theta": 20, "poles": (-1, -1), "dt": 1e-3}, "cascade": {"theta": 100, "dt": 1e-3}}
bounds = {"noise": {"y": 1e-3}}

def trial():
    start, noise = {"q": 1, "w": 0}, {"y": OrnsteinUhlenbeck(sigma=1e-4, tau=0)}
    long = Trial("long", 2.5, start=start, noise=noise, seeds=(0, 1))
    return long, Trial("short", 0.1, start=start), Trial("begun", 0.1, start=start, estimate={"q": 0.5})
"""


@pytest.mark.full
def test_what_is_proved_stands_beside_what_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "swing.py"
    path.write_text(BOUNDED)
    arguments = ["compare", str(path), "-o", str(tmp_path), "--engine", "python"]
    answer = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    each = {trial["trial"]: {one["name"]: one for one in trial["observers"]} for trial in answer["trials"]}
    known = hg.error_bound(load(path).step("high_gain"), noise={"y": 1e-3})
    for trial in each.values():
        assert trial["high_gain"]["proved"] == dict(known.bounds)
        assert (trial["high_gain"]["unproved"], trial["cascade"]["proved"], trial["cascade"]["worst"]) == ("", {}, {})
        assert "the proof is for a constant injection" in trial["cascade"]["unproved"]
    assert each["short"]["high_gain"]["worst"] == {"q": None, "w": None}
    (long, *_), steps = load(path).trials(), load(path).step("high_gain")
    assert known.settles is not None
    errors = [np.abs(one.error[one.truth.t >= known.settles]).max(axis=0) for one in try_out(steps, long, "python")]
    assert list(each["long"]["high_gain"]["worst"].values()) == pytest.approx(np.max(errors, axis=0))
    assert 0 < each["long"]["high_gain"]["worst"]["w"] < known.bounds["w"]


@pytest.mark.usefixtures("undrawn")
def test_bounds_wider_than_their_ranges_say_why_there_are_none(tmp_path: Path) -> None:
    path = tmp_path / "swing.py"
    path.write_text(BOUNDED.replace('"noise": {"y": 1e-3}', '"noise": {"y": 10}'))
    arguments = ["--observers", "high_gain", "--engine", "python", "--seeds", "1", "--trial", "short"]
    done = CliRunner().invoke(app, ["compare", str(path), "-o", str(tmp_path), *arguments])
    text = " ".join(done.stdout.split())
    assert "high_gain: no bound of the errors is proved: q is unknown, as 14.9 is more than its range" in text


def test_the_table_of_what_is_proved_has_a_dash_for_what_is_not() -> None:
    one = measured("high_gain", step("high_gain"), TRIAL, "python", (0,), lambda: None)
    assert "proved" not in said(comparing.comparison_tables("title", [one], "s", {}, {}))
    bound = {"proved": {"x1": 0.00123451, "x2": 1.0}, "worst": {"x1": 0.001, "x2": None}}
    other = replace(one, name="other", unproved="no norm")
    text = said(comparing.comparison_tables("title", [replace(one, **bound), other], "s", {}, {}))
    rows = [line.split() for line in text.partition("proved: a bound of the error")[2].splitlines()]
    assert ["high_gain", "0.00124", "(0.001)", "1", "(-)", "-", "-"] in rows
    assert ["other", "-", "-", "-", "-"] in rows
    assert "other: no norm" in text


@pytest.mark.usefixtures("undrawn")
def test_what_begins_alike_is_proved_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked, path = list[Any](), tmp_path / "swing.py"
    path.write_text(BOUNDED)
    monkeypatch.setattr(comparing, "bound_of", lambda step, _: asked.append(step.observer.name))
    arguments = ["--observers", "high_gain", "--engine", "python", "--seeds", "1"]
    done = CliRunner().invoke(app, ["compare", str(path), "-o", str(tmp_path), *arguments])
    assert done.exit_code == 0, done.output
    assert asked == ["high_gain", "high_gain"]  # long and short, begun
