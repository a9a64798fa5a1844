"""The limit of dt holds over the declared ranges while samples are missing, and the warning is monotone in dt."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest

import hgogen as hg
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau
from hgogen.discretisation.stability import Ranges, open_loop_limit
from hgogen.estimators.step_lengths import ClosedLoops
from hgogen.model import load
from hgogen.step import StepMayFail
from hgogen.stepping import discretise
from hgogen.stepping.discretise import unmeasured

MODELS = Path(__file__).parents[1] / "models"
REAL_EXIT = 2.785293563405282  # of classical Runge-Kutta on the negative real axis: x^3/24 - x^2/6 + x/2 - 1 = 0


def warned(observer: hg.Observer, dt: float) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StepMayFail)
        hg.sample(observer, dt=dt)
    return "".join(str(each.message) for each in caught)


def slow_and_fast(rate: float, low: float, power: int) -> hg.Observer:
    """A scheduled v that is measured, and w' = -rate w/v^power + 1, which is the fastest at the lowest v."""
    v, w = hg.Signal("v", low=low, high=40), hg.Signal("w", low=-1, high=1)
    outputs = (hg.Signal("a"), hg.Signal("b"))
    plant = hg.System("p", states=(v, w), outputs=outputs, flow=[0, 1 - rate * w / v**power], output=[v, w])
    form, h = hg.forms.original(plant), low**power / rate
    return hg.observers.riccati(
        form, Q=(0.01, 1e-6), R=(0.01 * h, 1e-6 * h), initial=(low + 1, 0), covariance=(0.01, 1e-6)
    )


@pytest.mark.parametrize(("rate", "low", "power"), [(60.0, 2.0, 1), (90.0, 3.0, 2)])
def test_the_limit_is_that_of_the_fastest_point(rate: float, low: float, power: int) -> None:
    limit = REAL_EXIT * low**power / rate
    observer = slow_and_fast(rate, low, power)
    assert math.isinf(unmeasured(observer, RK4, 0.99 * limit).take)
    searched = unmeasured(observer, RK4, 1.01 * limit)
    assert searched.take == pytest.approx(limit)
    assert searched.basis.startswith(f"beyond it w diverges while samples are missing, at v = {low:g}, w = ")
    assert f"eigenvalue {-rate / low**power:.3g} 1/s" in searched.basis
    assert all(warned(observer, factor * limit) for factor in (1.01, 2, 5))


def test_no_advice_is_computed_where_warnings_of_it_are_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal stays, with its advice."""
    monkeypatch.setattr(discretise, "unmeasured", None)
    observer = slow_and_fast(60, 2, 1)
    with warnings.catch_warnings(action="ignore", category=StepMayFail):
        step = hg.sample(observer, dt=0.01)
    assert step.dt == 0.01
    with pytest.raises(TypeError):
        hg.sample(slow_and_fast(60, 2, 1), dt=0.01)


def test_the_limit_is_that_of_every_value_that_can_be_tuned() -> None:
    """tau is 30 and may be set to 10, where v' = -v/tau is followed up to 10 times the exit."""
    s, v = hg.Signal("s", low=0, high=1), hg.Signal("v", low=-1, high=1)
    i, tau = hg.Signal("i", low=-1, high=1), hg.Signal("tau", "s", "time constant", 30, low=10, high=60)
    plant = hg.System(
        "p", states=(s, v), inputs=(i,), outputs=(hg.Signal("y"),), parameters=(tau,),
        flow=[i / 9000, i - v / tau], output=[3 * s + v],
    )  # fmt: skip
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1e-4, 1e-4), R=1e-3)
    assert not warned(observer, 9.99 * REAL_EXIT)
    assert "take dt <= 27.8 (beyond it v diverges" in warned(observer, 10.1 * REAL_EXIT)
    assert "tau = 10," in warned(observer, 20 * REAL_EXIT)


def test_it_warns_where_only_missing_samples_tell() -> None:
    """A filter whose closed loop is followed up to 0.39."""
    observer = load(MODELS / "fitzhugh_nagumo.py").step("kalman_like").observer
    assert not warned(observer, 0.24)
    assert "take dt <= 0.243 (beyond it x1 diverges while samples are missing, at " in warned(observer, 0.3)


def test_at_the_limit_the_step_begins_to_diverge() -> None:
    observer, limit = slow_and_fast(60.0, 2.0, 1), REAL_EXIT * 3 / 60
    for dt, stays in ((0.98 * limit, True), (1.05 * limit, False)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepMayFail)
            step = hg.sample(observer, dt=dt)
        w = step.run(y=np.tile([3.0, np.nan], (600, 1)), engine="python").x[-40:, 1]
        assert (abs(w - 3 / 60).max() < 1e-3) == stays


class Window(ClosedLoops):
    """Closed loops whose error grows at step lengths between 1 and 2 only."""

    def _transition(self, h: float, P: np.ndarray) -> np.ndarray:
        return np.eye(1)[None] * (2.0 if 1 < h < 2 else 0.5)


def test_what_grows_at_a_step_and_not_at_a_longer_one_limits_the_longer() -> None:
    one, none = np.ones((1, 1, 1)), np.zeros((1, 1, 1))
    loops = Window(-one, none, 2 * one, none[0], 0.0, one[None], one, np.array([np.inf]), np.array([1.5]))
    assert [loops.longest(end) for end in (0.5, 0.9)] == [math.inf] * 2
    (limit,) = {loops.longest(end) for end in (1.5, 3.0, 10.0)}
    assert limit == pytest.approx(1, rel=0.02)


@pytest.mark.parametrize("tableau", [RK4, HEUN])
def test_the_search_finds_an_extreme_inside_of_the_ranges(tableau: Tableau) -> None:
    """-1 - 20 exp(-100 (p - .37)^2) is the fastest at p = .37, between the points that are tried first."""
    ranges = Ranges(np.zeros(2), np.ones(2), ("p", "q"), 1)

    def slopes(points: np.ndarray) -> np.ndarray:
        return (-1 - 20 * np.exp(-100 * (points[:, 0] - 0.37) ** 2))[:, None, None]

    searched = open_loop_limit(slopes, ranges, tableau.polynomial)
    exits = {RK4: REAL_EXIT, HEUN: 2.0}
    assert searched.dt == pytest.approx(exits[tableau] / 21, rel=1e-4)
    assert searched.point[0] == pytest.approx(0.37, abs=2e-3)
    assert searched.state == "p"


@pytest.mark.parametrize("F", [np.diag([50.0, 0.0]), np.array([[0, 8], [-8, 0]])], ids=["grows", "turns"])
def test_a_mode_that_does_not_decay_in_the_plant_limits_nothing(F: np.ndarray) -> None:
    ranges = Ranges(np.zeros(2), np.ones(2), ("p", "q"), 2)
    assert math.isinf(open_loop_limit(lambda points: np.tile(F, (len(points), 1, 1)), ranges, RK4.polynomial).dt)


def test_where_damping_vanishes_the_limit_is_that_of_a_mode_that_decays() -> None:
    """-1 + 2 p +- 50i: Euler follows it up to 2 z/|lambda| at the damping ratio z, of which the least is .001."""
    ranges = Ranges(np.zeros(2), np.ones(2), ("p", "q"), 2)

    def slopes(points: np.ndarray) -> np.ndarray:
        return (2 * points[:, 0] - 1)[:, None, None] * np.eye(2) + np.array([[0, 50], [-50, 0]])

    searched = open_loop_limit(slopes, ranges, EULER.polynomial)
    assert 2e-3 / 50 <= searched.dt < 4e-3 / 50
    assert searched.point[0] == pytest.approx(0.475, abs=0.03)


def test_ends_of_the_ranges_without_a_derivative_are_left_out() -> None:
    """A slope -1/p at 0: the limit is that of half a percent of the range."""
    ranges = Ranges(np.zeros(1), np.ones(1), ("p",), 1)

    def slopes(points: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return (-1 / points[:, 0])[:, None, None]

    assert open_loop_limit(slopes, ranges, RK4.polynomial).dt == pytest.approx(0.005 * REAL_EXIT)


def test_a_mode_that_turns_leaves_at_its_own_ray() -> None:
    """F moves from -4, -4 to -1 +- 8i over the range of p; Heun's first exit is that of |1 + z + z^2/2| = 1."""
    ends, lengths = np.array([[[-4, 0], [0, -4]], [[-1, 8], [-8, -1]]]), np.linspace(0.001, 1, 10_000)
    ranges = Ranges(np.zeros(2), np.ones(2), ("p", "q"), 2)

    def slopes(points: np.ndarray) -> np.ndarray:
        p = points[:, :1, None]
        return (1 - p) * ends[0] + p * ends[1]

    modes = np.array([-4 + p * (3 + 8j) for p in np.linspace(0, 1, 101)])
    z = modes[:, None] * lengths
    first = lengths[(abs(1 + z + z**2 / 2) > 1).argmax(axis=1)]
    searched = open_loop_limit(slopes, ranges, HEUN.polynomial)
    assert searched.dt == pytest.approx(first.min(), rel=2e-3)
    assert searched.point[0] == pytest.approx(first.argmin() / 100, abs=0.02)
