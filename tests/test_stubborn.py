"""The stubborn observer: what is proved of its saturation, against plain numpy, and what it is for."""

from typing import Any

import numpy as np
import pytest
import swing
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import stubborn as oracle
from plants import chain
from quadratic import falls

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.gains import BadPoles
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz

GAINS: dict[str, Any] = {"theta": 20, "decay": 0.5, "r": 3, "poles": (-1, -1)}
NAN = float("nan")


def observer(**changes: Any) -> hg.Observer:
    return hg.observers.stubborn(swing.form(), **{**GAINS, **changes})


def proved(built: hg.Observer) -> bool:
    (check,) = (check for check in built.checks if check.id == "stubborn.core")
    return check.verdict is Verdict.PROVED


def test_it_is_the_oracles() -> None:
    """2200 samples of some 50 operations, of an error that decays: 1e-11."""
    run = swing.run(observer(), swing.gappy(), engine="python")
    expected = oracle.run(swing.truth().u, swing.gappy()[:, None], swing.DT, (2, 1), 20, 0.5, 3)
    assert run.traces["sigma"] == pytest.approx(expected[:, 2], abs=1e-11)
    assert run.x == pytest.approx(expected[:, :2], abs=1e-11)


@given(st.floats(-4, 4), st.floats(-20, 20))
@settings(deadline=None, max_examples=12)
def test_it_converges_from_any_initial_state(q: float, w: float) -> None:
    """Up to what the line between samples takes from y: dt^2/8 y'' = 2e-6, times the gain."""
    assert swing.last_error(observer, q, w) < 2e-4


def test_an_outlier_that_is_not_saturated_in_high_gain() -> None:
    """Three radians too much in one sample, a tenth of a second and more later: 4.8 times smaller, 22.6/4.7, at least,
    at no loss before it."""
    y = swing.noisy()
    y[2000] += 3
    late, usual = slice(2100, None), slice(1500, 1990)
    standard = swing.error(hg.observers.high_gain(swing.form(), theta=20, poles=(-1, -1)), y)
    stubborn = swing.error(observer(), y)
    assert stubborn[late, 1].max() < 4.7 / 22.6 * standard[late, 1].max()
    assert stubborn[usual].max() < 1.05 * standard[usual].max()


def test_the_core_and_the_models_slope_limit_the_step() -> None:
    """Without a saturation the error has (s + 20)(s + 40) = a cos q, a = 19.6, but for friction: its fastest pole is up
    to 30 + sqrt(100 + a). sigma's is -theta lambda. 2.785 over them for RK4."""
    step = hg.sample(observer(poles=(-1, -2)), hg.methods.rk4, dt=1e-3)
    assert step.limit == pytest.approx(2.785 / (30 + np.sqrt(119.6)), rel=3e-3)
    assert hg.sample(observer(decay=8), hg.methods.rk4, dt=1e-3).limit == pytest.approx(2.785 / 160, rel=1e-3)


@pytest.mark.ordinary("line-rk4-0.6666666666666666", "line-euler-1", "hold-heun-1", "hold-euler-1")
@pytest.mark.parametrize(("method", "share"), [("rk4", 2 / 3), ("heun", 1), ("euler", 1)])
@pytest.mark.parametrize("between", ["line", "hold"])
def test_what_one_sample_adds_to_the_level(method: str, share: float, between: Any) -> None:
    """A share of theta r e^2 dt, from both its sides; the level of before is some 1e-5 times that, its decay 1%."""
    assert "by theta r e^2 dt under the root, two thirds of that by rk4" in observer().theorem.conclusion
    step = hg.sample(observer(), getattr(hg.methods, method), dt=swing.DT, between=between, engine="python")
    y = swing.noisy(0)
    quiet, y[2000] = step.run(u=np.zeros(len(y)), y=y).traces["sigma"][2001], y[2000] + 3
    step.reset()
    after = step.run(u=np.zeros(len(y)), y=y).traces["sigma"][2001]
    assert after - quiet == pytest.approx(share * 20 * 3 * 3**2 * swing.DT, rel=0.05)


def test_a_level_of_0_opens() -> None:
    """From sigma = 0 nothing is injected at first; sigma grows with e^2 and never becomes negative."""
    run = swing.run(observer(sigma=0), swing.truth().y, engine="python")
    sigma = run.traces["sigma"]
    assert sigma[0] == 0 < sigma[1]
    assert sigma.min() == 0
    assert sigma.max() > 0.5


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_r_that_is_large_enough_is_proved(n: int) -> None:
    form = hg.forms.triangular(chain(n))
    enough = hg.observers.stubborn(form, theta=5, decay=1, r=30, poles=(-1,) * n)
    assert proved(enough)


def test_r_that_is_too_small_is_not() -> None:
    assert proved(observer())
    assert not proved(observer(r=0.1))


@pytest.mark.full
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 2.0), st.floats(3.0, 50.0))
@settings(deadline=None, max_examples=8)
def test_what_is_proved_decays(seed: int, decay: float, r: float) -> None:
    """The linear error in scaled coordinates, integrated finely from any eps(0), sigma(0): gone after 60/l."""
    poles = (-1.0, -1.5, -2.0)
    form = hg.forms.triangular(chain(3))
    if proved(hg.observers.stubborn(form, theta=5, decay=decay, r=r, poles=poles)):
        assert falls(poles, decay, r, seed, lambda e, most: np.clip(e, -most, most))


def test_an_observer_of_more_states_than_can_be_proved() -> None:
    form = hg.forms.triangular(chain(13))
    assert not proved(hg.observers.stubborn(form, theta=2, decay=1, r=30, poles=(-1,) * 13))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"theta": 0.5}, r"theta = 0\.5 must be a finite number, at least 1"),
        ({"decay": 0}, "decay = 0 must be a positive finite number"),
        ({"r": -1}, "r = -1 must be a positive finite number"),
        ({"r": NAN}, "r = nan must be a positive"),
        ({"sigma": -1}, "sigma = -1 must be a finite number, not negative"),
        ({"poles": None}, "stubborn takes either the poles of A - K C or the gains K; give one of the two"),
        ({"poles": None, "gains": (2, 1, 1)}, "gains = .* must be 2 finite numbers"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        observer(**changes)


def test_poles_and_gains_that_do_not_decay() -> None:
    with pytest.raises(BadPoles):
        observer(poles=(-1, 0))
    with pytest.raises(NotHurwitz):
        observer(poles=None, gains=(0, 1))
