"""Where a trial starts: every command's observer at the trial's estimate."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.model import load
from hgogen.reading.given import BadGain
from hgogen.trial import try_out

PENDULUM = str(Path(__file__).resolve().parents[1] / "models" / "pendulum.py")
MODEL = load(PENDULUM)
TRIAL = replace(MODEL.trials()[0], estimate={"q": 0.5, "w": -2.0})
NAMES = [None, "riccati", "bank", "cascade", "low_power"]
AWAY = f"""
import dataclasses, runpy
found = runpy.run_path({PENDULUM!r})
plant, step, tuning = found["plant"], found["step"], found["tuning"]
def trial():
    made = found["trial"]()
    return dataclasses.replace(made[0] if isinstance(made, tuple) else made, estimate={{"q": 0.5, "w": -2.0}})
"""


@pytest.mark.parametrize("name", NAMES)
def test_a_started_step_estimates_what_it_was_told(name: str | None) -> None:
    """Before any sample, whatever the observer keeps, and a bank in each of its members."""
    step = MODEL.step(name).started(TRIAL.first_estimate)
    sample = step(u=(0.0,) * len(step.inputs), y=np.nan)
    assert [sample[key] for key in TRIAL.estimate] == pytest.approx([*TRIAL.estimate.values()], rel=1e-12)


@pytest.mark.ordinary("None")
@pytest.mark.parametrize("name", [None, "riccati"])
def test_a_trial_starts_at_its_estimate(name: str | None) -> None:
    """The model's own step, and a tuning of it, as a comparison starts the same observer."""
    short = replace(TRIAL, duration=0.2, jumps=(), settled=None)
    own = next(try_out(MODEL.step(name), short, "python", (0,)))
    compared = next(try_out(MODEL.step(name or "high_gain", None, short.first_estimate), short, "python", (0,)))
    assert np.array_equal(own.x, compared.x)
    elsewhere = next(try_out(MODEL.step(name), replace(short, estimate={}), "python", (0,)))
    assert not np.array_equal(own.x[0], elsewhere.x[0])


@pytest.mark.full
def test_simulate_says_what_compare_says(tmp_path: Path) -> None:
    """When it has settled, after each event."""
    model = tmp_path / "away.py"
    model.write_text(AWAY)

    def said(*arguments: str) -> dict:
        return json.loads(CliRunner().invoke(app, [*arguments, "--seeds", "1", "--json"]).stdout)

    alone = said("simulate", str(model))["trials"][0]["settled"]
    compared = said("compare", str(model), "--observers", "high_gain", "--out", str(tmp_path))["trials"][0]
    assert alone == compared["observers"][0]["settled"]


def test_what_hg_observers_did_not_make_cannot_start_elsewhere() -> None:
    step = MODEL.step("riccati")
    strange = hg.sample(replace(step.observer, construction=None), step.method, step.dt)
    with pytest.raises(BadGain, match=r"riccati was not made by hg\.observers"):
        strange.started(TRIAL.first_estimate)
