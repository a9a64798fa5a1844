"""A fit that was stopped goes on from its last iterate, and from that of the same fit only."""

import json
import math
import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest
from test_cli import hgogen
from test_fit import DT, PLANT, TRUE, here, log  # noqa: F401, the fixture

import hgogen as hg
from hgogen.commands import fitting
from hgogen.commands.output import json_text
from hgogen.logs.likelihood import SURE
from hgogen.logs.problem import ITERATIONS, CannotGoOn, Progress, Searches, Solution, Solver, digests, progress_of
from hgogen.run.prediction import predictions
from hgogen.system import valued


class Stopped(Exception):
    """By a test."""


def stopped(at: tuple[int, int], **options: Any) -> Progress:
    """The progress of a fit that ended at an iteration of a search."""
    seen: list[Progress] = []

    def each(progress: Progress) -> None:
        seen.append(progress)
        if (progress.start, progress.iteration) == at:
            raise Stopped

    with pytest.raises(Stopped):  # CasADi would have taken it for a model that has no value
        hg.fit(PLANT, log(1, count=60), each=each, **options)
    return progress_of(json.loads(json.dumps(seen[-1].as_dict())))


@pytest.mark.parametrize(
    ("at", "options"),
    [
        ((0, 3), {"starts": 1}),
        ((1, 2), {"starts": 2}),
        ((2, 1), {"starts": 1, "robust": True}),
        ((0, 5), {"starts": 1, "by": "prediction"}),
    ],
)
def test_it_ends_where_it_would_have(at: tuple[int, int], options: dict[str, Any]) -> None:
    """Searches that had ended are not done again; of the one that was stopped the last iterate is the first."""
    whole = hg.fit(PLANT, log(1, count=60), **options)
    progress = stopped(at, **options)
    assert (progress.start, progress.iteration) == at
    later: list[Progress] = []
    resumed = hg.fit(PLANT, log(1, count=60), each=later.append, resume=progress, **options)
    assert later[0].start == at[0]
    assert later[0].at == pytest.approx(progress.at, abs=1e-6)
    for one, other in zip(resumed.parameters, whole.parameters, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-5)
        assert one.deviation == pytest.approx(other.deviation, rel=1e-3)


@pytest.mark.full
def test_processes_find_the_same_fit() -> None:
    """From any number of processes, also where one of the starts is known."""
    whole, progress = hg.fit(PLANT, log(1, count=60)), list[Progress]()
    by_two = hg.fit(PLANT, log(1, count=60), jobs=2, each=progress.append)
    first = min(progress, key=lambda one: one.start)  # of two processes the later search may end first
    resumed = hg.fit(PLANT, log(1, count=60), jobs=2, resume=progress_of(json.loads(json_text(first))))
    for one in (by_two, resumed):
        assert one.values == whole.values
        assert one.ends == whole.ends
    assert len(progress) == 3


OTHERS: dict[str, tuple[Callable[[], Any], dict[str, Any], str]] = {
    "records": (lambda: (PLANT, log(2, count=60)), {}, "is of other records"),
    "plant": (lambda: (valued(PLANT, {"k": 7}), log(1, count=60)), {}, "is of another plant"),
    "options": (lambda: (PLANT, log(1, count=60)), {"between": "line"}, "is of other options"),
}


@pytest.mark.parametrize("what", OTHERS)
def test_it_does_not_go_on_with_something_else(what: str) -> None:
    made, options, sentence = OTHERS[what]
    progress = stopped((0, 1), starts=1)
    with pytest.raises(CannotGoOn, match=f"{sentence}; give it what it was begun with, or begin anew"):
        hg.fit(*made(), starts=1, resume=progress, **options)


@pytest.mark.parametrize(
    "table",
    [
        {},
        {"task": 1, "ended": [], "iteration": 0, "at": []},
        {"task": {}, "ended": [], "iteration": math.inf, "at": []},  # 1e400 in a file
        {"ended": [{}]},
    ],
)
def test_what_no_fit_left_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(CannotGoOn, match="is not as a fit leaves it; fit anew"):
        progress_of(table)


@pytest.mark.usefixtures("interruptible")
def test_the_command_goes_on_after_a_stop(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    """The file is there after Ctrl-C, serves once, and is gone at the end."""
    words = ("fit", "spring.toml", "--data", "log.csv", "--time", "t", "--free", "k,c,g", "--starts", "1", "-o", "out")
    words = (*words, "--held-out", "0")
    _, said = hgogen(*words, "--resume", status=2)
    assert "there is no fit to go on with" in " ".join(said.replace("│", " ").split())
    whole = fitting.fit

    def cut(*records: Any, each: Callable[[Progress], None], **options: Any) -> Any:
        def then(progress: Progress) -> None:
            each(progress)
            if progress.iteration == 3:
                os.kill(os.getpid(), signal.SIGINT)

        return whole(*records, each=then, **options)

    with monkeypatch.context() as patched:
        patched.setattr(fitting, "fit", cut)
        _, said = hgogen(*words, status=2)
    assert "the same command with --resume goes on from iteration 3 of search 1" in " ".join(said.split())
    begun = here / "out" / "fit_begun.json"
    assert progress_of(json.loads(begun.read_text())).iteration == 3
    _, said = hgogen(*words, "--resume", "--robust", status=2)
    assert "the stopped fit is of other options" in " ".join(said.split())
    hgogen(*words, "--resume")
    assert json.loads((here / "out" / "fitted.json").read_text())["parameters"] == pytest.approx(TRUE, rel=0.05)
    assert not begun.exists()


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_the_bar_goes_on_while_all_rows_are_fitted(
    here: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The iterations of one search more, which begins where the others end."""
    places: list[float] = []

    class Recorder(fitting.Bar):
        def update(self, *args: Any, **options: Any) -> None:
            super().update(*args, **options)
            if self.tasks[0].description == "iterations":
                places.append(self.tasks[0].completed)

    monkeypatch.setattr(fitting, "Bar", Recorder)
    hgogen("fit", "spring.toml", "--data", "log.csv", "--time", "t", "--free", "k", "--starts", "1", "-o", "out")
    assert places == sorted(places)
    assert ITERATIONS + 1 < places[-1] < 2 * ITERATIONS
    assert places.count(ITERATIONS) == 1


@pytest.mark.full
def test_the_command_fits_by_prediction_error(here: Path) -> None:  # noqa: F811
    words = ("fit", "spring.toml", "--data", "log.csv", "--time", "t", "--free", "k,c,g", "--starts", "1", "-o", "out")
    stdout, _ = hgogen(*words, "--by", "prediction", "--held-out", "0.7")
    assert "RMS error of predictions one sample ahead" in stdout
    assert "process noise of v" in stdout
    result = json.loads((here / "out" / "fitted.json").read_text())
    assert result["by"] == "prediction"
    process = result["noise"]["process"]
    assert process["x"] == pytest.approx(SURE * 10**2 / (400 * DT))  # next to nothing: x' = v is a definition
    assert result["noise"]["sample"]["y"] == pytest.approx(0.01, rel=0.4)  # of 120 samples
    assert result["whiteness"]["y"]["test"] == "Ljung-Box"
    for name, value in result["parameters"].items():
        assert abs(value - TRUE[name]) < 4 * result["deviation"][name]


@pytest.mark.full
def test_rows_held_out_are_predicted_with_the_noise_that_was_fitted(here: Path) -> None:  # noqa: F811
    """By the filter that has it as Q and R, of the fitted plant and of the plant as it was."""
    text, _, _ = (here / "spring.toml").read_text().partition("[observer]")
    (here / "bare.toml").write_text(text)
    words = ("fit", "bare.toml", "--data", "log.csv", "--time", "t", "--free", "k,c,g", "--starts", "1", "-o", "out")
    hgogen(*words, "--by", "prediction")
    result = json.loads((here / "out" / "fitted.json").read_text())
    _, u, y = np.loadtxt(here / "log.csv", delimiter=",", skiprows=1).T
    cut, plant = round(0.7 * len(y)), hg.load("bare.toml").plant
    u = np.append(u[0], u[:-1])  # held from its row to the next, while a step holds it since the call before
    first = (here / "log.csv").read_text().splitlines()[: cut + 1]
    (here / "first.csv").write_text("\n".join(first) + "\n")
    words = tuple({"log.csv": "first.csv", "out": "first"}.get(word, word) for word in words)
    hgogen(*words, "--by", "prediction", "--held-out", "0")  # of the rows that do not judge
    judged = json.loads((here / "first" / "fitted.json").read_text())
    Q, R = judged["noise"]["process"], {y: sigma**2 * DT for y, sigma in judged["noise"]["sample"].items()}
    for which, one in (("fitted", hg.load("bare.toml").valued(judged["parameters"]).plant), ("unfitted", plant)):
        step = hg.sample(hg.observers.riccati(hg.forms.original(one), Q=Q, R=R), dt=DT, between="hold")
        there = predictions(step, step.run(u=u, y=y).since(cut), u[cut:, None], y[cut:, None], (1, 5, 25))
        assert [row[which] for row in result["predictions"]] == pytest.approx([p.model for p in there], rel=1e-6)
    ahead = {row["ahead"]: row for row in result["predictions"]}
    assert ahead[5]["fitted"] < ahead[5]["unfitted"]
    assert ahead[25]["fitted"] < 0.1 * ahead[25]["copying"]


def solution(cost: float) -> Solution:
    """One that ended."""
    return Solution(np.array([cost]), cost, "", 1, True)


def test_searches_that_ended_keep_their_places_and_later_ones_begin_anew() -> None:
    """Of four starts two had ended, and the third was stopped at 7."""
    iterates: list[np.ndarray | None] = []

    def solve(begin: np.ndarray, at: np.ndarray | None, each: Any) -> Solution:
        iterates.append(at)
        return solution(9.0)

    before = (solution(1.0), solution(2.0))
    searches = Searches({}, lambda progress: None, Progress({}, before, 3, np.array([7.0])))
    ended: tuple[Solution, ...] = ()
    for _ in range(4):
        ended = searches.solved(cast(Any, SimpleNamespace(solve=solve)), np.zeros(1), ended)
    assert [one.cost for one in ended] == [1.0, 2.0, 9.0, 9.0]
    assert iterates == [np.array([7.0]), None]


def test_a_cost_that_was_no_number_is_none_again() -> None:
    """JSON has no other word for it."""
    ended = [{"unknowns": [0.0], "cost": None, "status": "", "iterations": 1, "settled": False}]
    progress = progress_of({"task": {}, "ended": ended, "iteration": 0, "at": [0.0]})
    assert math.isnan(progress.ended[0].cost)


def test_the_same_samples_at_another_period_are_other_records() -> None:
    record = log(1, count=20)
    one, other = (digests(PLANT, [hg.Log(record.u, record.y, dt)], {}) for dt in (DT, 2 * DT))
    assert one["records"] != other["records"]
    assert one["plant"] == other["plant"]


def test_what_goes_on_is_pulled_to_where_it_was_begun() -> None:
    """Of a cost that says nothing only the pull is left."""
    v = ca.MX.sym("v", 1)
    problem = cast(Any, SimpleNamespace(graph=(v, 0 * v, ca.MX(0, 1)), constants=1, size=1))
    end = Solver(problem, np.array([-9.0]), np.array([9.0]), np.ones(1)).solve(np.array([1.0]), np.array([3.0]))
    assert end.unknowns == pytest.approx([1.0], abs=0.05)
