"""The alarm ratio: it tells the tuning from which theta comes back from the one from which it does not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli, model
from hgogen.commands import trial_runs
from hgogen.program import Place
from hgogen.run import consistency, native
from hgogen.run.metrics import Summary, alarm_complaints, alarm_ratio
from hgogen.trial import Jump, OrnsteinUhlenbeck, Trial, t

NEURON = model.load(Path(__file__).resolve().parents[1] / "models" / "fitzhugh_nagumo.py")
SIGMA, DT, D = 0.05, 0.01, 1.0
GAMMA_0 = SIGMA**2 * D * (1 + consistency.SPREADS * consistency.spread(round(D / DT), DT, 0.0))
TRIAL = Trial(
    "one_jump",
    60.0,
    start={"x1": 0.5, "x2": 0.2, "p": 0.7},
    inputs={"u": sp.sin(t)},
    noise={"y": OrnsteinUhlenbeck(SIGMA)},
    jumps=(Jump(30.0, "p", -0.5),),
    seeds=(0, 1, 2),
)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def step(theta: Any) -> Any:
    """x1' = (1.5 + u/2) x2 - x1, x2' = p - x2 - sin x1, p' = 0, y = x1, R and gamma_0 as docs/tuning.md advises."""
    x1, x2, p = (hg.Signal(name, low=-4, high=4) for name in ("x1", "x2", "p"))
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-6, high=6)
    flow = [(sp.Rational(3, 2) + u / 2) * x2 - x1, p - x2 - sp.sin(x1), 0]
    plant = hg.System("swing", states=(x1, x2, p), inputs=(u,), outputs=(y,), flow=flow, output=[x1])
    gains = {"Q": (1e-3, 1e-3, 1e-4), "R": SIGMA**2 * DT, "theta": theta}
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), **gains), hg.methods.continuous_discrete, dt=DT)


def adaptive(theta_1: float, mu: Any = (GAMMA_0, 2 * GAMMA_0), innovation: Any = None) -> Any:
    return hg.theta.adaptive(theta_1, mu=mu, innovation=innovation or hg.innovation.staggered(D))


def tried(theta: Any, trial: Trial = TRIAL) -> Summary:
    made = step(theta)
    done = trial_runs.tried(made, trial, "c", trial.seeds, lambda: None)
    (summary,) = trial_runs.summaries(made, [done], "c", lambda said: None)
    return summary


@pytest.mark.full
@needs_compiler
def test_the_neuron_has_about_a_half() -> None:
    """Alone, each of six seeds gives .39 to .65: over 50 s, some 50 windows, a mean varies by a seventh, and more where
    the input vanishes at theta = 8. The median of three lies well within. At theta = 1 it would be .25: sigma^2 d is a
    quarter of gamma_0."""
    ratio = alarm_ratio(NEURON.step(), NEURON.trials()[0], "c", range(3))
    assert ratio is not None
    assert 0.35 <= ratio <= 0.65


@pytest.mark.full
@needs_compiler
def test_a_theta_that_latches_has_a_large_ratio_and_a_sentence() -> None:
    summary = tried(adaptive(8.0))
    assert summary.alarm_ratio is not None
    assert summary.alarm_ratio > 5
    assert summary.latched == summary.seeds == 3
    assert summary.loud == (1.0, 1.0)
    (said,) = alarm_complaints([summary])
    assert said == (
        f"trial 'one_jump': theta does not come back in 3 of 3 seeds: alarm ratio {summary.alarm_ratio:.2g}; "
        "lower theta_1 or Q, or raise gamma_0"
    )


@needs_compiler
def test_a_theta_that_comes_back_has_a_small_ratio_and_no_sentence() -> None:
    """More than noise alone, sigma^2 d, would give: theta is held at 4."""
    summary = tried(adaptive(2.0))
    assert summary.alarm_ratio is not None
    assert 1.25 * SIGMA**2 * D / GAMMA_0 < summary.alarm_ratio <= 1.5
    assert summary.peak[1] is not None
    assert summary.peak[1][1] > 3  # there was an alarm to come back from
    assert (summary.latched, summary.loud) == (0, (0.0, 0.0))
    assert list(alarm_complaints([summary])) == []


@pytest.mark.full
@needs_compiler
def test_the_advice_lowers_the_ratio() -> None:
    """A threshold k times as high divides it by k exactly: at the pinned theta the thresholds play no part."""
    ratios = [
        alarm_ratio(step(theta), TRIAL, "c", (0,))
        for theta in (adaptive(4.0), adaptive(3.0), adaptive(4.0, mu=(5 * GAMMA_0, 9 * GAMMA_0)))
    ]
    assert ratios[1] < ratios[0]
    assert ratios[2] == pytest.approx(ratios[0] / 5, rel=1e-12)


@pytest.mark.full
@needs_compiler
def test_other_laws() -> None:
    """The centre of a logistic is its threshold; the window of the paper judges the same prediction, at age d where
    the staggered predictors are aged d to 1.25 d and scaled down, so within a quarter; a theta without innovation has
    no ratio."""
    logistic = hg.theta.logistic(GAMMA_0, 50 / GAMMA_0)
    whole = adaptive(3.0, innovation=hg.innovation.window(D))
    reference = alarm_ratio(step(adaptive(3.0)), TRIAL, "c", (0,))
    assert alarm_ratio(step(adaptive(3.0, logistic)), TRIAL, "c", (0,)) == pytest.approx(reference, rel=1e-12)
    assert alarm_ratio(step(whole), TRIAL, "c", (0,)) == pytest.approx(reference, rel=0.25)
    for theta in (1.0, 3.0, hg.theta.decaying(4.0, 1.0)):
        assert alarm_ratio(step(theta), TRIAL, "c", (0,)) is None
    assert list(alarm_complaints([tried(hg.theta.decaying(4.0, 1e-3))])) == []


def test_it_starts_at_the_truth_and_leaves_the_step_alone() -> None:
    """Without noise the estimate stays at the truth whatever theta, so that the innovation of the first seconds is the
    predictors' error of integration, less than dt^2 for Heun; a start at 0 would leave an error of the order of x."""
    made, quiet = step(adaptive(8.0)), replace(TRIAL, duration=2 * D, noise={}, jumps=())
    made(u=0.1, y=0.2)
    before = made.save(), made._kept.places[Place("gain", "rate")].copy()
    ratio = alarm_ratio(made, quiet, "python", (0,))
    assert ratio is not None
    assert 0 < ratio < DT**4 * D / GAMMA_0
    assert made.save() == before[0]
    assert np.array_equal(made._kept.places[Place("gain", "rate")], before[1])


@needs_compiler
def test_too_little_time_is_told_from_an_alarm_that_feeds_itself() -> None:
    """A second after its start theta has had no time to come back, whatever the tuning."""
    summary = tried(adaptive(2.0, mu=(1.5 * GAMMA_0, 3 * GAMMA_0)), replace(TRIAL, jumps=(Jump(1.0, "p", -0.5),)))
    (said,) = alarm_complaints([summary])
    assert said.endswith("so it needs more time between the events")


@pytest.mark.full
@needs_compiler
def test_simulate_prints_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The neuron with a threshold a twentieth as high latches: its ratio is some 20 times .45."""
    monkeypatch.chdir(tmp_path)
    text = Path(NEURON.path).read_text().replace("mu=(0.16, 0.32)", "mu=(0.008, 0.016)")
    (tmp_path / "low.py").write_text(text)
    arguments = ["simulate", "low.py", "--trial", "one_jump", "--seeds", "1"]
    shown = CliRunner().invoke(cli.app, arguments)
    assert shown.exit_code == 0
    assert "alarm ratio: " in shown.stdout
    assert "theta does not come back in 1 of 1 seeds: alarm ratio" in shown.stderr
    (trial,) = json.loads(CliRunner().invoke(cli.app, [*arguments, "--json"]).stdout)["trials"]
    assert trial["alarm_ratio"] > 5
    assert trial["latched"] == 1
    assert trial["each"][0]["responses"][1]["loud"] == trial["loud"][1] == 1.0
