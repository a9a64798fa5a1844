"""The dead-zone observer: what is proved of its dead zone, against plain numpy, and what it is for."""

from typing import Any

import numpy as np
import pytest
import swing
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import dead_zone as oracle
from plants import chain
from quadratic import falls

import hgogen as hg
from hgogen.check import Verdict
from hgogen.reading.given import BadGain

GAINS: dict[str, Any] = {"theta": 20, "decay": 1, "r": 0.3, "poles": (-1, -1)}


def observer(**changes: Any) -> hg.Observer:
    return hg.observers.dead_zone(swing.form(), **{**GAINS, **changes})


def proved(built: hg.Observer) -> bool:
    (check,) = (check for check in built.checks if check.id == "dead_zone.core")
    return check.verdict is Verdict.PROVED


def test_it_is_the_oracles() -> None:
    """2200 samples of some 50 operations, of an error that decays: 1e-11."""
    run = swing.run(observer(), swing.gappy(), engine="python")
    expected = oracle.run(swing.truth().u, swing.gappy()[:, None], swing.DT, (2, 1), 20, 1, 0.3)
    assert run.traces["sigma"] == pytest.approx(expected[:, 2], abs=1e-11)
    assert run.x == pytest.approx(expected[:, :2], abs=1e-11)


@given(st.floats(-4, 4), st.floats(-20, 20))
@settings(deadline=None, max_examples=12)
def test_it_converges_from_any_initial_state(q: float, w: float) -> None:
    """Up to what the line between samples takes from y: dt^2/8 y'' = 2e-6, times the gain."""
    assert swing.last_error(observer, q, w) < 2e-4


def test_noise_is_injected_less() -> None:
    """Steady, the error of w is below that of the standard observer of the same gain."""
    y = swing.noisy(3e-3)
    standard = swing.error(hg.observers.high_gain(swing.form(), theta=20, poles=(-1, -1)), y)
    error = swing.error(observer(), y)
    assert np.sqrt((error[2000:, 1] ** 2).mean()) < 0.8 * np.sqrt((standard[2000:, 1] ** 2).mean())


@pytest.mark.parametrize(("n", "r"), [(1, 0.9), (2, 0.5), (3, 0.1), (4, 0.1)])
def test_r_that_is_small_enough_is_proved(n: int, r: float) -> None:
    form = hg.forms.triangular(chain(n))
    assert proved(hg.observers.dead_zone(form, theta=5, decay=1, r=r, poles=(-1,) * n))


def test_r_near_lambda_is_not_proved() -> None:
    assert proved(observer())
    assert not proved(observer(r=0.99))


@pytest.mark.full
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 2.0), st.floats(0.01, 0.3))
@settings(deadline=None, max_examples=8)
def test_what_is_proved_decays(seed: int, decay: float, share: float) -> None:
    """The linear error in scaled coordinates, integrated finely from any eps(0), sigma(0)."""
    poles, r = (-1.0, -1.5, -2.0), share * decay
    form = hg.forms.triangular(chain(3))
    if proved(hg.observers.dead_zone(form, theta=5, decay=decay, r=r, poles=poles)):
        assert falls(poles, decay, r, seed, lambda e, most: e - np.clip(e, -most, most))


def test_an_error_that_stays_within_its_dead_zone_is_never_corrected() -> None:
    """What r < lambda is for: at r = 1.2 lambda the level outgrows an integrator's error, which stays."""
    assert not falls((-1.0, -1.0), 1.0, 1.2, 3, lambda e, most: e - np.clip(e, -most, most))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"r": 1}, r"r = 1 must be below decay = 1, or nothing would ever be injected"),
        ({"r": 2}, r"r = 2 must be below decay = 1"),
        ({"decay": 0}, "decay = 0 must be a positive finite number"),
        ({"sigma": float("nan")}, "sigma = nan must be a finite number, not negative"),
        ({"gains": (2, 1)}, "dead_zone takes either the poles of A - K C or the gains K"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        observer(**changes)


def test_tuning_keeps_r_below_lambda() -> None:
    step = hg.sample(observer(), hg.methods.rk4, dt=swing.DT)
    ranges = {field.name: field.box[0] for field in step.layout.gains}
    assert ranges["r"][1] < ranges["decay"][0]
    assert step.flags(step.tune(r=5.0)) == ("PARAMETER_LIMITED",)
