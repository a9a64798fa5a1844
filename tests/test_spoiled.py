"""A run that loses its estimate says since when, by what, and what to do."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_cli import hgogen

from hgogen.model import load
from hgogen.run.metrics import before_loss, loss

PERIOD = 1e-3


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A second of a pendulum at rest, without a sample of y at 0.4 s."""
    monkeypatch.chdir(tmp_path)
    rows = [f"{k * PERIOD:.3f},0,{'' if k == 400 else 0.001 * (-1) ** k},0\n" for k in range(1000)]
    path = tmp_path / "log.csv"
    path.write_text("time,tau,y,true\n" + "".join(rows))
    return path


def run(log: Path, *options: str) -> tuple[dict[str, Any], str]:
    arguments = ("run", "pendulum", "--data", str(log), "--time", "time", "--truth", "w=true", "-o", "out", *options)
    return json.loads(hgogen(*arguments, "--json")[0]), " ".join(hgogen(*arguments)[0].split())


@pytest.mark.full
@pytest.mark.parametrize("observer", ["high_gain", "riccati"])
@pytest.mark.usefixtures("undrawn")
def test_a_missing_sample_loses_a_step_without_guards(log: Path, observer: str) -> None:
    answer, text = run(log, "--observer", observer, "--guards", "none", "--real", "float")
    said = answer["notes"][0]
    assert said.startswith("y has no number at 0.4 s, which a step without guards cannot leave out: from 0.4")
    assert said.endswith("; run it with --guards all, or fill in what the log lacks")
    assert said in text
    assert "status: none, of a step without guards" in text
    ahead = [one for one in answer["predictions"] if one["ahead"] is not None]
    assert [one["ahead"] for one in ahead] == [1, 5, 25]
    assert all(0 < one["model"] < 0.01 for one in answer["predictions"])
    assert all(one["count"] <= 400 for one in answer["predictions"])
    assert all(0 <= one["largest"] < 0.01 for one in answer["from_double"])


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_what_it_names_mends_it(log: Path) -> None:
    """Both: the guards leave the sample out, and a filled log loses nothing."""
    answer, text = run(log, "--guards", "all")
    assert not [note for note in answer["notes"] if "no number" in note]
    assert "MISSING_Y" in text
    log.write_text(log.read_text().replace("0.400,0,,0", "0.400,0,0,0"))
    answer, _ = run(log, "--guards", "none")
    assert not [note for note in answer["notes"] if "no number" in note]
    assert answer["predictions"][0]["count"] == 999


@pytest.mark.full
def test_a_first_sample_that_is_missing_loses_all(log: Path) -> None:
    log.write_text(log.read_text().replace("0.000,0,0.001,0", "0.000,0,,0"))
    answer, _ = run(log, "--guards", "none", "--real", "float")
    assert "from 0" in answer["notes"][0]
    assert [one for one in answer["predictions"] if one["ahead"] is not None] == []


@pytest.mark.usefixtures("undrawn")
def test_several_signals_have_no_number(log: Path) -> None:
    log.write_text(log.read_text().replace("0.400,0,,0", "0.400,,,0"))
    assert run(log, "--guards", "none")[0]["notes"][0].startswith("tau, y have no number at 0.4 s")


@pytest.mark.full
def test_nothing_is_clamped_without_guards(log: Path) -> None:
    log.write_text(log.read_text().replace(",0,0.001,", ",2,0.001,").replace(",0,-0.001,", ",2,-0.001,"))
    for guards, said in (("all", "and clamped there"), ("none", "and taken as it is, by a step without guards")):
        (note,) = (each for each in run(log, "--guards", guards)[0]["notes"] if each.startswith("tau is beyond"))
        assert said in note


def test_what_grows_beyond_every_number_has_no_sample_to_blame() -> None:
    step = load("pendulum").step("high_gain").rebuilt(guards="none")
    t, y = np.arange(4) * PERIOD, np.zeros((4, 1))
    done = step.run(u=np.zeros((4, 1)), y=y, engine="python")
    assert list(loss(step, done, t, np.zeros((4, 1)), y)) == []
    assert before_loss(done) == 4
    done.x[2:] = np.inf
    (said,) = loss(step, done, t, np.zeros((4, 1)), y)
    assert before_loss(done) == 2
    assert said.startswith(
        "from 0.002 s on the estimate is no number, and no error counts: it grew beyond every number"
    )
    assert "run it with --guards all" in said
