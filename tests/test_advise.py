"""Gains without a record: known poles, what is certified, what settles, and bad input."""

import json
from dataclasses import replace
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import gamma
from test_cli import hgogen

import hgogen as hg
from hgogen.commands.calibrating import AdviceReport, AdvisedRow
from hgogen.logs.advise import Advised, advise, tau
from hgogen.model import load
from hgogen.modelfiles.setting import Setting
from hgogen.reading.given import BadGain
from hgogen.trial import run_feeds

MODEL = load("pendulum")


@pytest.fixture(scope="module")
def rows() -> tuple[tuple[Advised, ...], dict[str, str]]:
    """The pendulum's advice, with its trial, and the observers that there is none for."""
    (trial,) = MODEL.trials()
    observers = ["high_gain", "riccati", "bank"]
    return advise(MODEL.plant, dt=5e-3, noise={"y": 1e-3}, observers=observers, trial=trial)


@pytest.fixture
def high_gain(rows: tuple[tuple[Advised, ...], dict[str, str]]) -> Advised:
    """Of `rows`."""
    return rows[0][0]


@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_n_poles_leave_a_hundredth(n: int) -> None:
    """The tail of a gamma distribution of shape n."""
    assert tau(n) == pytest.approx(gamma.isf(0.01, n), abs=1e-8)


def test_a_wanted_time_gives_theta() -> None:
    (row,), _ = advise(MODEL.plant, dt=1e-3, settling=0.5, observers=["high_gain"])
    assert row.theta == float(f"{gamma.isf(0.01, 2) / 0.5:.1e}")
    assert row.first.starting.gains["theta"] == row.theta
    assert row.tried == ()


@pytest.mark.full
def test_it_settles_in_the_wanted_time() -> None:
    """A double integrator, whose error is that of two poles, down to 5 % of its range from all of it."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    plant = hg.System("chain", states=(x, v), outputs=(hg.Signal("y"),), flow=[v, 0 * v], output=[x])
    trial = hg.trial.Trial("rest", 3, start={"x": 0, "v": 0}, estimate={"x": 0, "v": 0.05}, seeds=(0,))
    (row,), _ = advise(plant, dt=1e-3, settling=0.5, observers=["high_gain"], trial=trial)
    assert row.own is not None
    assert row.own.settled == 0  # 0.05 of a range of 2 is within the band
    run = row.first.step.started(lambda form: {"x": 0, "v": 1.0})
    error = abs(run.run(y=np.zeros(1000)).x)
    theta = row.theta or 0.0
    assert error[:, 0].max() == pytest.approx(exp(-1) / theta, rel=0.05)  # of t exp(-theta t)
    assert error[500:, 1].max() == pytest.approx((1 + theta / 2) * exp(-theta / 2), rel=0.01)  # (1 + theta t) exp(..)


@pytest.mark.full
def test_what_is_certified_is_the_bound_of_the_check(rows: tuple[tuple[Advised, ...], dict[str, str]]) -> None:
    """Above it the claim is proved, below it not."""
    high_gain, riccati = rows[0]
    assert high_gain.certified is not None
    form = hg.forms.triangular(MODEL.plant)
    for factor, proved in ((1.05, True), (0.95, False)):
        observer = hg.observers.high_gain(form, theta=high_gain.certified * factor, poles=(-1, -1))
        (claim,) = (check for check in observer.checks if check.id == "high_gain.theta")
        assert (claim.verdict == "proved") is proved
    assert f"is certified, as it is above the smallest certified theta, {high_gain.certified:.3g}" in high_gain.sentence
    low = replace(high_gain, theta=high_gain.certified / 2)
    assert f"is not certified, 2 times below the smallest certified theta, {high_gain.certified:.3g}" in low.sentence
    assert riccati.certified is riccati.theta is None
    assert riccati.sentence == ""


@pytest.mark.full
def test_a_larger_theta_settles_sooner_and_takes_up_more_noise(high_gain: Advised) -> None:
    settled = [one.settled for one in high_gain.tried]
    assert len(settled) >= 8
    assert None not in settled
    assert settled == sorted(settled, reverse=True)
    noise = [one.noise["w"] for one in high_gain.tried if one.theta > 20]
    assert noise == sorted(noise)
    assert noise[-1] > 4 * noise[0]
    assert high_gain.own in high_gain.tried


def test_the_noise_is_that_of_the_linear_observer(high_gain: Advised) -> None:
    """At a large theta the error system is the core alone: of white noise, by its Gramian, sampled by what runs."""
    one = high_gain.tried[-2]
    theta, dt = one.theta, 5e-3
    decay = exp(-theta * dt)
    # x' = -theta 2 (x - y) + v, v' = -theta^2 (x - y): two poles at -theta, the noise held for dt
    A, B = np.array([[-2 * theta, 1.0], [-(theta**2), 0]]), np.array([2 * theta, theta**2])
    move = decay * (np.eye(2) + (A + theta * np.eye(2)) * dt)  # exp(A dt), A + theta I is nilpotent
    push = np.linalg.solve(A, (move - np.eye(2)) @ B)
    P = np.zeros((2, 2))
    for _ in range(4000):
        P = move @ P @ move.T + np.outer(push, push) * 1e-6
    assert one.noise["w"] == pytest.approx(np.sqrt(P[1, 1]), rel=0.25)  # 500 samples of the last tenth, and a line


def test_the_noise_is_that_of_the_steady_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors that noise makes before it are not counted, here a thousand more."""
    (trial,) = MODEL.trials()

    def worse_before(*runs: Any) -> Any:
        for one in run_feeds(*runs):
            before = 1e3 * bool(one.trial.noise) * (one.truth.t < one.trial.steady_from - 1e-9)
            yield replace(one, x=one.x + before[:, None])

    (row,), _ = advise(MODEL.plant, dt=5e-3, observers=["riccati"], trial=trial)
    monkeypatch.setattr("hgogen.logs.advise.run_feeds", worse_before)
    (other,), _ = advise(MODEL.plant, dt=5e-3, observers=["riccati"], trial=trial)
    assert row.own is not None
    assert other.own == row.own


def test_an_observer_around_another_says_so(rows: tuple[tuple[Advised, ...], dict[str, str]]) -> None:
    assert set(rows[1]) == {"bank"}
    assert "goes around another observer" in rows[1]["bank"]


def test_what_does_not_settle_is_said(high_gain: Advised) -> None:
    tried = tuple(
        type(high_gain.tried[0])(theta, settled, {}, 5 / theta)
        for theta, settled in ((2.0, None), (4.0, None), (8.0, 1.0))
    )
    row = Advised("high_gain", high_gain.first, 2.0, None, tried)
    assert row.sentence == (
        "theta 2 of high_gain does not settle in the trial, 8 is the first that does, by --settling 0.625 (settling=)"
    )
    none = Advised("high_gain", high_gain.first, 2.0, 1.0, tried[:2])
    assert none.sentence == (
        "theta 2 of high_gain is certified, as it is above the smallest certified theta, 1, and does not "
        "settle in the trial, nor does another that was tried"
    )


def test_a_row_that_noise_drowns_is_not_the_one_to_take(high_gain: Advised) -> None:
    """Where noise alone makes more than half of the declared range of a state, the advice says so."""
    assert high_gain.own is not None
    half = {x.name: (x.interval[1] - x.interval[0]) / 2 for x in MODEL.plant.states}
    assert half.keys() == high_gain.own.noise.keys()

    def row(share: float) -> AdvisedRow:
        first, *others = half
        noise = {first: share * half[first], **dict.fromkeys(others, 0.0)}
        return AdvisedRow(
            replace(high_gain, name=f"at_{share}", tried=tuple(replace(t, noise=noise) for t in high_gain.tried))
        )

    quiet, loud = row(0.99), row(1.01)
    assert (quiet.drowned, loud.drowned) == ((), (next(iter(half)),))
    report = AdviceReport("", [], None, (loud, quiet), {}, "s")
    assert report.take == "at_0.99"
    assert report.notes[0] == f"at_1.01: noise alone moves {next(iter(half))} by over half its range"


def test_each_theta_tried_is_had_by_its_time(high_gain: Advised) -> None:
    """With the digits of the sentence, which an observer without a gain of that name can be asked by as well."""
    for one in high_gain.tried:
        options = {"dt": 5e-3, "noise": {"y": 1e-3}, "settling": float(f"{one.settling:.4g}")}
        (asked,), _ = advise(MODEL.plant, observers=["high_gain"], **options)
        assert (asked.theta, asked.sigma) == (one.theta, {"y": 1e-3})


def test_the_command_writes_gains_that_others_take(tmp_path: Path) -> None:
    out = ("-o", str(tmp_path), "--observers", "high_gain,riccati", "--dt", "0.005")
    report = json.loads(hgogen("advise", "pendulum", "--noise", "y=1e-3", *out, "--json")[0])
    assert report["take"] == "high_gain_advised"  # proved for a larger theta, before one without a bound
    assert {Path(file).name for file in report["files"]} == {"advised.svg", "advised.png", "advised.json"}
    model = MODEL.set(Setting(tuning=tmp_path / "advised.json"))
    assert model.step().observer.name == "high_gain"
    assert model.step().dt == 0.005
    assert model.step("riccati_advised").layout.gains[1].initial == (float(f"{1e-3**2 * 0.005:.1e}"),)


OSCILLATOR = """name = "chain"
[states]
x = {low = -1, high = 1, flow = "v"}
v = {low = -1, high = 1, flow = "-x"}
[outputs]
y = {equation = "x"}
"""


@pytest.mark.ordinary("9000-are not tried-False")
@pytest.mark.parametrize(
    ("row", "sentence", "many"),
    [("-x", "tried on one that stays in its ranges, over 2", True), ("9000", "are not tried", False)],
)
def test_a_model_without_a_trial_gets_one(row: str, sentence: str, many: bool, tmp_path: Path) -> None:
    (tmp_path / "chain.toml").write_text(OSCILLATOR.replace('"-x"', f'"{row}"'))
    words = ("--observers", "high_gain", "-o", str(tmp_path), "--dt", "0.02")
    printed, said = hgogen("advise", str(tmp_path / "chain.toml"), *words)
    assert sentence in " ".join(said.split())
    assert "high_gain" in printed
    assert (len(json.loads((tmp_path / "advised.json").read_text())["rows"][0]["tried"]) > 1) is many


@pytest.mark.parametrize("dt", [0.02, [0.01, 0.02]])
def test_gains_are_for_the_periods_of_the_model(dt: float | list[float], tmp_path: Path) -> None:
    path = tmp_path / "chain.toml"
    path.write_text(f'{OSCILLATOR}[observer]\nkind = "riccati"\nQ = [0.01, 1]\nnoise = {{y = 0.01}}\ndt = {dt}\n')
    words = ("--observers", "high_gain,riccati,switched_gain", "-o", str(tmp_path))
    report = json.loads(hgogen("advise", str(path), *words, "--json")[0])
    assert {str(each["dt"]) for each in report["tuning"].values()} == {str(dt)}
    assert ("switched_gain" in report["refused"]) is isinstance(dt, list)
    advised = load(path).set(Setting(tuning=tmp_path / "advised.json"))
    steps = [advised.step("high_gain"), advised.step("riccati_advised"), load(path).step("ukf")]
    assert {(step.shortest, step.dt) for step in steps} == {(min(np.atleast_1d(dt)), 0.02)}


@pytest.mark.full
def test_an_own_form_of_a_tuning_is_asked(tmp_path: Path) -> None:
    """Of a tuning that has the observer's name: the gains get another one, and the form is still found."""
    words = ("--observers", "high_gain,riccati", "-o", str(tmp_path))
    report = json.loads(hgogen("advise", "cascaded_tanks", *words, "--json")[0])
    assert set(report["tuning"]) == {"riccati_advised"}
    assert "dt = 4 is too long" in report["refused"]["high_gain"]  # of the model's own step
    tanks = load("cascaded_tanks").set(Setting(tuning=tmp_path / "advised.json"))
    assert tanks.step("riccati_advised").observer.form.system.origin is not None


@pytest.mark.full
def test_processes_give_the_same_advice(rows: tuple[tuple[Advised, ...], dict[str, str]]) -> None:
    (trial,) = MODEL.trials()
    asked = ["high_gain", "riccati", "bank"]
    again, refused = advise(MODEL.plant, dt=5e-3, noise={"y": 1e-3}, observers=asked, trial=trial, jobs=2)
    assert [(one.name, one.table, one.tried) for one in again] == [(one.name, one.table, one.tried) for one in rows[0]]
    assert refused == rows[1]


@pytest.mark.full
@pytest.mark.parametrize("dt", [5e-3, (1e-3, 5e-3)])
def test_a_truth_is_simulated_once_a_period(dt: float | tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    periods: list[float] = []

    def counted(plant: hg.System, trial: hg.trial.Trial, dt: float, times: np.ndarray | None) -> hg.trial.Truth:
        assert (times is not None) is varying
        periods.append(dt)
        return hg.trial.simulate(plant, trial, dt, times)

    varying = isinstance(dt, tuple)
    monkeypatch.setattr("hgogen.logs.advise.simulate", counted)
    advise(MODEL.plant, dt=dt, observers=["high_gain", "low_power"], trial=hg.proposed_trial(MODEL.plant))
    assert periods == [5e-3]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--noise", "y"), "must read NAME=NUMBER"),
        (("--noise", "z=1"), "noise of 'z' is of no output"),
        (("--noise", "y=0"), "noise of 'y'"),
        (("--settling", "0"), "settling"),
        (("--dt", "-1"), "dt"),
        (("--observers", "rickati"), "rickati"),
    ],
)
def test_bad_input_is_refused(words: tuple[str, str], reason: str, tmp_path: Path) -> None:
    _, said = hgogen("advise", "pendulum", *words, "-o", str(tmp_path), status=2)
    assert reason in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [{"dt": -1.0}, {"noise": {"z": 1.0}}, {"noise": {"y": 0.0}}, {"settling": 0.0}])
def test_bad_input_is_refused_before_a_process_is_started(
    words: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hgogen.run.campaign.Workers.results", lambda *_: pytest.fail("work began"))
    with pytest.raises(BadGain):
        advise(MODEL.plant, **words)


def test_a_plant_that_no_observer_takes_is_refused(tmp_path: Path) -> None:
    """Each reason once, and no file of gains that has none."""
    _, said = hgogen("advise", "sir", "-o", str(tmp_path), status=2)
    assert "admits none of these observers" in said
    assert said.count("the plant is in none of its forms") == 1
    assert not list(tmp_path.iterdir())


def test_a_time_must_be_positive() -> None:
    with pytest.raises(BadGain, match="settling"):
        advise(MODEL.plant, settling=-1.0)
