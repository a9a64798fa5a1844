"""Noise that is declared for one sample: the filter is that of the same numbers as densities, at any dt."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hgogen as hg
from hgogen.check import Verdict
from hgogen.cli import app
from hgogen.estimators.noise import sample_deviations
from hgogen.model import load
from hgogen.reading.given import BadGain, BadNames

DT = 2.0**-6  # products with it are exact
A = np.array([[0.0, 1], [-2, -0.3]])
q, w, y, s = (hg.Signal(name, low=-5, high=5) for name in ("q", "w", "y", "s"))
plant = hg.System("swing", states=(q, w), outputs=(y,), flow=[w, -2 * q - 0.3 * w], output=[q])
form = hg.forms.original(plant)
PROCESS, VARIANCE = np.array([[1e-4, 2e-5], [2e-5, 3e-4]]), 0.0144


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    samples = np.sin(np.arange(2000) * DT) + np.random.default_rng(1).normal(0, 0.12, 2000)
    samples[500:600] = np.nan
    return samples


@pytest.mark.parametrize("spelled", [{"R_per_sample": VARIANCE}, {"noise": {"y": VARIANCE**0.5}}])
def test_a_discrete_kalman_filter_has_the_same_numbers(spelled: dict[str, Any], measured: np.ndarray) -> None:
    """P <- Phi P Phi' + Q_d and r as they stand, in plain numpy; Phi = I + hA + (hA)^2/2, z by RK4."""
    step = DT * A
    Phi = np.eye(2) + step + step @ step / 2
    advance = Phi + step @ step @ step / 6 + step @ step @ step @ step / 24
    z, P, expected = np.zeros(2), np.eye(2), []
    for k, sample in enumerate(measured):
        z, P = (advance @ z, Phi @ P @ Phi.T + PROCESS) if k else (z, P)  # the first call only corrects
        if np.isfinite(sample):
            K = P[:, 0] / (P[0, 0] + VARIANCE)
            z, P = z + K * (sample - z[0]), P - np.outer(K, P[0])
        expected.append(z)
    observer = hg.observers.riccati(form, Q_per_sample=PROCESS, **spelled)
    run = hg.sample(observer, dt=DT).run(y=measured, engine="python")
    assert run.x == pytest.approx(np.array(expected), abs=1e-9)


def makers() -> dict[str, tuple[hg.Form, dict[str, Any], dict[str, Any]]]:
    """Each observer with R: its form, arguments as densities, and the same for one sample."""
    Q, R = {"q": 1e-3 / DT, "w": 1e-2 / DT}, {"y": 0.25 * DT}
    densities, samples = {"Q": Q, "R": R}, {"Q_per_sample": {"q": 1e-3, "w": 1e-2}, "noise": {"y": 0.5}}
    weights = {"Q": {name: 1 / value for name, value in Q.items()}, "R": 1 / (0.25 * DT)}
    own = hg.forms.state_affine(plant)
    rho = {"rho": 1.0}
    return {
        **dict.fromkeys(("riccati", "ukf", "iterated_ekf"), (form, densities, samples)),
        "kalman_like": (own, {"R": R, **rho}, {"noise": {"y": 0.5}, **rho}),
        "hamilton_jacobi": (form, weights, samples),
    }


def test_every_observer_with_noise_is_here() -> None:
    from inspect import signature

    with_noise = {name for name in hg.observers.__all__ if "R" in signature(getattr(hg.observers, name)).parameters}
    assert with_noise == makers().keys()
    assert all("noise" in signature(getattr(hg.observers, name)).parameters for name in with_noise)


@pytest.mark.parametrize("name", makers())
def test_each_spelling_is_the_same_step(name: str) -> None:
    own, densities, samples = makers()[name]
    make = getattr(hg.observers, name)
    plain = hg.sample(make(own, **densities), dt=DT)
    sampled = hg.sample(make(own, **samples), dt=DT)
    variance = {key: value for key, value in samples.items() if key != "noise"} | {"R_per_sample": 0.25}
    for step in (
        sampled,
        hg.sample(make(own, **variance), dt=DT),
        hg.sample(make(own, **densities, density=True), dt=DT),
    ):
        assert {key: pytest.approx(value, rel=1e-14) for key, value in plain.tuned.items()} == step.tuned
    assert str(sampled.observer.theorem) == str(plain.observer.theorem)
    assert [(str(one.id), one.verdict) for one in sampled.observer.checks] == [
        (str(one.id), one.verdict) for one in plain.observer.checks
    ]


def test_the_program_is_that_of_densities() -> None:
    plain = hg.sample(hg.observers.riccati(form, Q=(0.25 / DT, 1 / DT), R=0.25 * DT), dt=DT)
    sampled = hg.sample(hg.observers.riccati(form, Q_per_sample=(0.25, 1), noise={"y": 0.5}), dt=DT)
    said = "R as the standard deviation of one sample: y = 0.5"

    def without(text: str) -> list[str]:
        return [line for line in text.splitlines() if said not in line and line.strip(" *")]

    written, expected = dict(hg.targets.c99(sampled)), dict(hg.targets.c99(plain))
    assert {name: without(text) for name, text in written.items()} == {
        name: without(text) for name, text in expected.items()
    }
    assert {name for name, text in written.items() if said in text} >= {"swing.h", "swing.md"}
    assert not any(said in text for text in expected.values())
    assert plain.save() == sampled.save()


def test_reports_print_the_noise_of_a_sample(tmp_path: Path) -> None:
    """Of densities too: R = 0.25 dt is a standard deviation of 0.5."""
    path = tmp_path / "swing.toml"
    path.write_text(TEXT.replace("SPELLED", "Q = {q = 16, w = 64}\nR = 0.00390625"))
    log = tmp_path / "log.csv"
    log.write_text("t,y\n" + "\n".join(f"{k * DT},{np.sin(k * DT):.6f}" for k in range(400)))
    for arguments in (
        ["check", str(path), "--all"],
        ["run", str(path), "--data", str(log), "--time", "t", "--out", str(tmp_path / "out")],
    ):
        printed = CliRunner().invoke(app, arguments).output
        assert "R as the standard deviation of one sample: y = 0.5" in printed, printed
    weights = hg.observers.hamilton_jacobi(form, Q=(1, 1), R=1 / (0.25 * DT))
    assert sample_deviations(hg.sample(weights, dt=DT)) == {"y": pytest.approx(0.5)}
    slow = hg.sample(hg.observers.riccati(form, Q=(1, 1), noise={"y": 0.5}), dt=DT, periods={"y": 4 * DT})
    assert sample_deviations(slow) == {"y": 0.5}
    without_noise = hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=(-1, -1))
    assert sample_deviations(hg.sample(without_noise, dt=DT)) == {}


def test_a_slow_sensor_keeps_the_variance_of_its_sample() -> None:
    both = hg.System("swing", states=(q, w), outputs=(y, s), flow=[w, -2 * q - 0.3 * w], output=[q, w])
    observer = hg.observers.riccati(hg.forms.original(both), Q=(1, 1), noise={"y": 0.5, "s": 2.0})
    step = hg.sample(observer, dt=DT, periods={"s": 8 * DT})
    assert step.tuned["R"] == (0.25 * DT, 4 * 8 * DT)
    assert step.rebuilt(dt=DT / 2).tuned["R"] == (0.25 * DT, 4 * 8 * DT)  # the periods of the sensors stay


@pytest.mark.parametrize("around", ["", "delayed", "bank"])
def test_another_dt_changes_no_sample_and_no_density_of_the_process(around: str) -> None:
    """Process noise belongs to the dt of the first step: it grows with the time of a step."""
    observer = hg.observers.riccati(form, Q_per_sample=(0.25, 1), noise={"y": 0.5})
    if around == "delayed":
        observer = hg.delayed(observer, y=3)
    elif around == "bank":
        observer = hg.observers.bank(observer, count=3, period=1.0)
    step = hg.sample(observer, dt=DT)
    assert (step.tuned["Q"], step.tuned["R"]) == ((0.25 / DT, 1 / DT), (0.25 * DT,))
    twice = step.rebuilt(dt=2 * DT)
    for each in (twice, twice.started({"q": 0.1}), pickle.loads(pickle.dumps(twice)), twice.undelayed):
        assert (each.tuned["Q"], each.tuned["R"]) == ((0.25 / DT, 1 / DT), (0.25 * 2 * DT,))
    assert twice.undelayed.ages == ()


def test_claims_wait_for_dt() -> None:
    """The numbers of an observer that is not sampled yet are nobody's: a claim that needs them is not proved, one of
    ranks alone is, without the numbers."""
    make, (own, _, samples) = hg.observers.kalman_like, makers()["kalman_like"]
    (gramian,) = (each for each in make(own, **samples).checks if str(each.id) == "kalman_like.gramian")
    assert gramian.verdict is Verdict.UNKNOWN
    observer = hg.observers.riccati(form, Q_per_sample=(0.25, 1), noise={"y": 0.5})
    (convergence,) = (each for each in observer.checks if str(each.id) == "riccati.convergence")
    assert convergence.verdict is Verdict.PROVED
    assert str(convergence.reason).endswith("for every dt, since Q grows in proportion")
    assert convergence.proofs == ()
    sampled = {str(each.id): each.verdict for each in hg.sample(observer, dt=DT).observer.checks}
    assert sampled["riccati.convergence"] is Verdict.PROVED
    assert hg.sample(observer, dt=DT, guards="none").observer.checks == form.checks


TEXT = """
name = "swing"
states = {q = {low = -5, high = 5, flow = "w"}, w = {low = -5, high = 5, flow = "-2*q - .3*w"}}
outputs = {y = {equation = "q"}}
[tuning.riccati]
form = "original"
dt = 0.015625
SPELLED
"""


def test_a_text_model_takes_each_spelling(tmp_path: Path) -> None:
    spelled = {
        "plain": "Q = {q = 16, w = 64}\nR = 0.00390625",
        "density": "Q = {q = 16, w = 64}\nR = 0.00390625\ndensity = true",
        "noise": "Q_per_sample = {q = 0.25, w = 1}\nnoise = {y = 0.5}",
        "variance": "Q_per_sample = [0.25, 1]\nR_per_sample = {y = 0.25}",
    }
    for name, lines in spelled.items():
        path = tmp_path / f"{name}.toml"
        path.write_text(TEXT.replace("SPELLED", lines))
        model = hg.load(path)
        assert model.step("riccati").tuned == {"Q": (16.0, 64.0), "R": (0.00390625,)}
        resampled = model.step("riccati", 2 * DT).tuned
        assert resampled["Q"] == (16.0, 64.0)
        assert resampled["R"] == ((0.0078125,) if name in ("noise", "variance") else (0.00390625,))


def test_what_is_no_noise_is_met_at_the_door() -> None:
    for arguments, words in (
        ({}, "has neither process nor measurement noise; give Q, and noise or R"),
        ({"Q": 1}, "has no measurement noise; give one of R, R_per_sample or noise"),
        ({"R": 1}, "has no process noise; give one of Q or Q_per_sample"),
        ({"Q": (1, 1), "R": 1, "noise": {"y": 1}}, "twice, as R and noise"),
        ({"Q": (1, 1), "Q_per_sample": (1, 1), "R": 1}, "twice, as Q and Q_per_sample"),
        ({"Q": (1, 1), "noise": 0.1}, "must be standard deviations of one sample by name"),
        ({"Q": (1, 1), "noise": {"y": 0}}, "must be a positive finite number"),
        ({"Q": (1, 1), "noise": {"y": float("nan")}}, "must be a positive finite number"),
        ({"Q": (1, 1), "noise": {"y": 1e200}}, "the squares of noise"),
        ({"Q": (1, 1), "R_per_sample": -1}, "R_per_sample = -1"),
        ({"Q_per_sample": (1, -1), "R": 1}, "Q_per_sample must be positive semidefinite"),
        ({"Q_per_sample": (1, 1), "R_per_sample": 1, "density": True}, "and riccati has neither"),
    ):
        with pytest.raises(BadGain, match=words):
            hg.observers.riccati(form, **arguments)
    with pytest.raises(BadNames, match="'z', which is none of the names"):
        hg.observers.riccati(form, Q=(1, 1), noise={"z": 1})


def test_the_continuous_observer_has_the_densities_of_its_dt() -> None:
    observer = hg.observers.riccati(form, Q_per_sample=(1e-3, 1e-2), noise={"y": 0.5})
    plain = hg.observers.riccati(form, Q=(1e-3 / DT, 1e-2 / DT), R=0.25 * DT)
    samples = np.sin(np.arange(50) * DT)
    expected = hg.reference(plain, y=samples, dt=DT).x
    for source, dt in ((observer, DT), (hg.sample(observer, dt=DT), 0.0)):
        assert hg.reference(source, y=samples, dt=dt).x == pytest.approx(expected, abs=1e-12)


def test_thresholds_of_an_innovation_are_no_noise() -> None:
    """gamma_0 has the unit of R, and is of no output."""
    step = load("cascaded_tanks").step("riccati")
    assert {"gamma_0", "gamma_1"} <= {gain.name for gain in step.layout.gains}
    assert sample_deviations(step).keys() == {"y"}
