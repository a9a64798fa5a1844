"""The switched-gain observer: its timer by hand, against plain numpy, and what it is for."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import swing
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import switched_gain as oracle
from plants import two_outputs

import hgogen as hg
from hgogen.estimators.gains import BadPoles
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz

GAINS: dict[str, Any] = {"theta": 40, "theta_low": 10, "threshold": 0.01, "hold": 0.2, "poles": (-1, -1)}
NAN = float("nan")


def observer(**changes: Any) -> hg.Observer:
    return hg.observers.switched_gain(swing.form(), **{**GAINS, **changes})


def test_the_linear_core_has_the_poles_of_the_high_gain() -> None:
    """Distinct ones: a double pole would be found to the root of rounding only."""
    poles = swing.core_poles(hg.observers.switched_gain, **{**GAINS, "poles": (-1, -2)})
    assert poles == pytest.approx([-80, -40], rel=1e-12)


@cache
def resting() -> hg.Step:
    """A plant at rest, hold = 3 samples: four in a row span it."""
    x, y = hg.Signal("x", low=-2, high=2), hg.Signal("y", low=-2, high=2)
    plant = hg.System("rest", states=(x,), outputs=(y,), flow=[0], output=[x])
    gains = {"theta": 4, "theta_low": 2, "threshold": 0.1, "hold": 0.3, "poles": (-1,)}
    return hg.sample(hg.observers.switched_gain(hg.forms.triangular(plant), **gains), hg.methods.rk4, dt=0.1)


def level(y: np.ndarray) -> tuple[list[float], np.ndarray]:
    """(gain in force, |y - yhat|) after each sample."""
    step = resting()
    step.reset()
    run = step.run(y=y, engine="python")
    return list(run.traces["level"]), np.abs(y - run.x[:, 0])


def test_the_gain_is_low_after_the_time_and_a_missing_sample_does_not_count() -> None:
    """The first call advances no time: samples 1, 2, 4, 5 count, sample 3 is missing."""
    y = np.zeros(8)
    y[3] = NAN
    assert level(y)[0] == [4] * 5 + [2] * 3


def test_the_gain_is_high_at_once() -> None:
    y = np.concatenate([np.zeros(10), np.ones(15)])
    gains, errors = level(y)
    back = 10 + int(np.flatnonzero(errors[10:] <= 0.1)[0])
    assert errors[10] > 0.1
    assert 11 < back < 20
    assert gains == [4] * 4 + [2] * 6 + [4] * (back + 3 - 10) + [2] * (25 - back - 3)


def test_it_is_the_oracles() -> None:
    """2200 samples of some 50 operations, of an error that decays: 1e-11."""
    run = swing.run(observer(), swing.gappy(), engine="python")
    expected = oracle.run(swing.truth().u, swing.gappy()[:, None], swing.DT, (2, 1), (40, 10), 0.01, 201)
    assert set(run.traces["level"]) == {10, 40}
    assert (run.traces["level"] == expected[:, 2]).all()
    assert run.x == pytest.approx(expected[:, :2], abs=1e-11)


@given(st.floats(-4, 4), st.floats(-20, 20))
@settings(deadline=None, max_examples=12)
def test_it_converges_from_any_initial_state(q: float, w: float) -> None:
    """Up to what the line between samples takes from y: dt^2/8 y'' = 2e-6, times the gain."""
    assert swing.last_error(observer, q, w) < 1e-4


def test_it_settles_like_the_high_gain_and_filters_like_the_low_one() -> None:
    """The errors of w: with the high gain 2.9 times the noise of the low one is seen."""
    y = swing.noisy(3e-3)
    steady = {name: np.sqrt((swing.error(one, y)[-1500:, 1] ** 2).mean()) for name, one in rivals().items()}
    settled = {name: np.flatnonzero(swing.error(one)[:, 1] > 0.5)[-1] for name, one in rivals().items()}
    assert steady["switched"] < 1.05 * steady["low"] < 0.3 * steady["high"]
    assert settled["switched"] < 1.1 * settled["high"] < 0.5 * settled["low"]


def rivals() -> dict[str, hg.Observer]:
    high = {
        name: hg.observers.high_gain(swing.form(), theta=theta, poles=(-1, -1))
        for name, theta in (("high", 40), ("low", 10))
    }
    return {**high, "switched": observer(threshold=0.02)}


def test_a_low_gain_that_was_tuned_is_taken() -> None:
    step = hg.sample(observer(), hg.methods.rk4, dt=swing.DT)
    step.tune(theta_low=5.0, theta=20.0)
    run = step.run(u=swing.truth().u, y=swing.truth().y, engine="python")
    assert set(run.traces["level"][1:]) == {5, 20}


def test_a_high_gain_tuned_below_the_low_one_is_both() -> None:
    step = hg.sample(observer(), hg.methods.rk4, dt=swing.DT)
    step.tune(theta=8.0)
    run = step.run(u=swing.truth().u, y=swing.truth().y, engine="python")
    assert set(run.traces["level"][1:]) == {8}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"theta": 0.5}, r"theta = 0\.5 must be a finite number, at least 1"),
        ({"theta_low": 40}, r"theta_low = 40 must be at least 1 and below theta = 40"),
        ({"theta_low": 0.5}, r"theta_low = 0\.5 must be at least 1"),
        ({"threshold": 0}, "threshold = 0 must be a positive finite number"),
        ({"hold": -1}, "hold = -1 must be a positive finite number"),
        ({"hold": NAN}, "hold = nan must be a positive"),
        ({"poles": None}, "switched_gain takes either the poles of A - K C or the gains K; give one of the two"),
        ({"gains": (2, 1)}, "switched_gain takes either the poles"),
        ({"poles": None, "gains": (2,)}, r"gains = \(2,\) must be 2 finite numbers, one for each state"),
        ({"poles": None, "gains": "ab"}, "gains = 'ab' must be a number or an array"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        observer(**changes)


def test_poles_and_gains_that_do_not_decay() -> None:
    with pytest.raises(BadPoles, match="not in the open left half plane"):
        observer(poles=(1, -1))
    with pytest.raises(NotHurwitz, match=r"^gains: the linear error core has the eigenvalues .* give poles"):
        observer(poles=None, gains=(1, -1))


def test_a_hold_of_too_many_samples_and_forms_that_are_no_chain() -> None:
    with pytest.raises(BadGain, match=r"hold = 2000 is more than 1000000 samples of dt = 0\.001; shorten it"):
        hg.sample(observer(hold=2000), hg.methods.rk4, dt=1e-3)
    with pytest.raises(BadGain, match=r"switched_gain takes one output, two has 2"):
        hg.observers.switched_gain(hg.forms.original(two_outputs()), **GAINS)
