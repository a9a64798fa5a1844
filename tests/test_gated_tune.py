"""Outliers of a log are left out when gains are learned from it, by the gates with which the filters then run."""

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import typer
from scipy.linalg import expm
from scipy.stats import chi2

import hgogen as hg
from hgogen.commands.calibrating import gates_of
from hgogen.estimators.gate import gated_groups
from hgogen.logs.likelihood import STARTS, Likelihood, truncated_mean
from hgogen.logs.tune import likelihood_of

DT, N, SIGMA, Q = 0.1, 500, 0.1, 0.01


@cache
def body(unit: float = 1.0) -> hg.System:
    """A body on a spring, whose place is measured in so many units a metre."""
    place, rate = hg.Signal("place", "m", low=-9, high=9), hg.Signal("rate", "m/s", low=-9, high=9)
    flow = [rate, -place / 4 - rate / 10]
    return hg.System("body", states=(place, rate), outputs=(hg.Signal("y"),), flow=flow, output=[unit * place])


@cache
def measured() -> tuple[np.ndarray, np.ndarray]:
    """The places (N, 1) that noise moves, measured with noise, and which of them are outliers, one in twenty."""
    rng, z, places = np.random.default_rng(3), np.array([1.0, 0.0]), []
    motion = expm(DT * np.array([[0, 1], [-0.25, -0.1]]))
    for _ in range(N):
        places.append(z[:1])
        z = motion @ z + np.array([0, np.sqrt(DT * Q)]) * rng.standard_normal(2)
    wrong = rng.random((N, 1)) < 0.05
    wrong[0] = False
    return np.array(places) + SIGMA * rng.standard_normal((N, 1)), wrong


def likelihood(sigmas: float, gate: Any, unit: float = 1.0) -> Likelihood:
    """Of a log whose outliers are so many standard deviations off, to both sides."""
    y, wrong = measured()
    off = sigmas * SIGMA * wrong * np.where(np.arange(N) % 2, 1, -1)[:, None]
    log, plant = hg.Log(np.zeros((N, 0)), unit * (y + off), DT), body(unit)
    return likelihood_of(hg.forms.original(plant), (log,), DT, "line", gated_groups(gate, plant.outputs))


def noise(one: Likelihood) -> tuple[float, float]:
    """Sigma of the output and Q of the rate at the most likely noise without outliers."""
    left = replace(one, records=one.without_outliers())
    best = left.maxima([left.ended(STARTS[number]) for number in (0, 4)])[0]
    return best.sample["y"], best.process["rate"]


@pytest.mark.full
@pytest.mark.parametrize("sigmas", [10, 100])
def test_outliers_are_found_and_q_and_r_are_those_of_the_other_samples(sigmas: float) -> None:
    gated, plain = likelihood(sigmas, {"y": 0.999}), likelihood(sigmas, None)
    (log,) = gated.without_outliers()
    gone = np.isnan(log.y)
    assert gone[measured()[1]].all()
    assert gone.sum() <= measured()[1].sum() + 3
    sigma, q = noise(gated)
    assert sigma == pytest.approx(SIGMA, rel=0.06)
    assert q == pytest.approx(Q, rel=0.4)
    assert noise(plain)[0] > 1.5 * SIGMA


@pytest.mark.full
def test_a_tight_gate_leaves_the_noise_as_it_is() -> None:
    """By .9 a tenth of good samples is left out, those with the largest innovations: R is not less for that."""
    one = likelihood(0, {"y": 0.9})
    share = np.isnan(one.without_outliers()[0].y).mean()
    assert 0.06 < share < 0.2
    assert noise(one)[0] == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.full
def test_the_unit_of_an_output_does_not_decide_what_is_an_outlier() -> None:
    metres, millimetres, kilometres = (likelihood(7, {"y": 0.999}, unit) for unit in (1, 1000, 0.001))
    gone = [np.isnan(one.without_outliers()[0].y) for one in (metres, millimetres, kilometres)]
    assert gone[0].any()
    assert np.array_equal(gone[0], gone[1])
    assert np.array_equal(gone[0], gone[2])


@pytest.mark.parametrize("k", [1, 2, 5])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.999])
def test_squares_within_a_gate_have_a_smaller_mean(k: int, probability: float) -> None:
    limit = chi2.ppf(probability, k)
    assert truncated_mean(limit, k) == pytest.approx(chi2.expect(lambda d: d, (k,), ub=limit) / k / probability)


@pytest.mark.full
def test_tuned_filters_have_the_gate_and_are_judged_without_outliers() -> None:
    y, wrong = measured()
    log = hg.Log(np.zeros((N, 0)), y + 100 * SIGMA * wrong, DT)
    gate = {"y": hg.Gate(0.999, accept_after=5)}
    tuned = hg.tune(body(), log, observers=["riccati", "ukf", "high_gain"], gate=gate)
    assert tuned["riccati"].table["gate"] == {"y": {"probability": 0.999, "accept_after": 5, "inflate": False}}
    assert tuned["ukf"].table["gate"] == tuned["riccati"].table["gate"]
    assert "gate" not in tuned["high_gain"].table
    (share,) = tuned.gates
    assert (share.count, share.expected) == (N, 0.001)
    assert wrong.sum() <= share.beyond <= wrong.sum() + 3
    clean = hg.tune(body(), hg.Log(np.zeros((N, 0)), np.where(wrong, np.nan, y), DT), observers=["riccati"])
    assert tuned["riccati"].error == pytest.approx(clean["riccati"].error, rel=0.02)
    (e,) = tuned["riccati"].innovations([(log, 0)]).values()
    assert np.mean(e**2) == pytest.approx(1, abs=0.15)


@pytest.mark.full
def test_outliers_of_30_deviations_leave_q_and_r_as_they_are() -> None:
    """Without a gate in the filter: with --robust its gains are those of the log without outliers."""
    y, wrong = measured()
    outliers = 30 * SIGMA * wrong * np.where(np.arange(N) % 2, 1, -1)[:, None]
    logs = {name: hg.Log(np.zeros((N, 0)), y + added, DT) for name, added in {"clean": 0, "dirty": outliers}.items()}
    noises = {}
    for name, log in logs.items():
        tuned = hg.tune(body(), log, observers=["riccati"], robust=name == "dirty")["riccati"]
        assert tuned.noise is not None
        assert "gate" not in tuned.table
        noises[name] = (tuned.noise.process["rate"], tuned.noise.sample["y"] ** 2)
    assert noises["dirty"] == pytest.approx(noises["clean"], rel=0.15)


def test_gates_of_the_command_line() -> None:
    assert gates_of(["y=0.999", "px, py=.99"]) == {"y": 0.999, "px, py": 0.99}
    assert not gates_of(())
    for text in ("y", "y=often", ""):
        with pytest.raises(typer.BadParameter, match=re.escape("such as y=0.999")):
            gates_of([text])


def test_a_gate_of_no_output_is_refused() -> None:
    with pytest.raises(hg.HgogenError, match="names no output; the outputs are y"):
        hg.tune(body(), hg.Log(np.zeros((N, 0)), measured()[0], DT), gate={"z": 0.9})
