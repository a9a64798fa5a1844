"""How much the outputs show: by hand for a linear chain, nothing where nothing is shown, what no unit changes."""

import math

import numpy as np
import pytest
import sympy as sp
from plants import MODELS
from scipy.linalg import expm, solve_continuous_lyapunov

import hgogen as hg
from hgogen.analysis.linearised import NoLinearisation
from hgogen.model import load
from hgogen.run.gramian import RESOLVED, ObservabilityMeasure, observability_measure
from hgogen.trial import BadTrial, Jump, Trial, t


def integrator(rate: float = 2.0, low: float = -1.0) -> hg.System:
    """x1' = x2, x2' = 0, y = x1, in the ranges [low, 1], +-rate; y has none."""
    x1, x2 = hg.Signal("x1", low=low, high=1), hg.Signal("x2", low=-rate, high=rate)
    return hg.System(
        "integrator", states=(x1, x2), outputs=(hg.Signal("y", low=-1, high=1),), flow=[x2, 0], output=[x1]
    )


def car(still: bool) -> tuple[hg.System, Trial]:
    """Heading psi' = k v u with an unknown gain k of the steering; the heading is measured."""
    psi, k = hg.Signal("psi", low=-3, high=3), hg.Signal("k", low=0.5, high=1.5)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-4, high=4)
    plant = hg.System("car", states=(psi, k), inputs=(u,), outputs=(y,), flow=[10 * k * u, 0], output=[psi])
    return plant, Trial("drive", 4, start={"psi": 0, "k": 1}, inputs={"u": 0 if still else sp.cos(t) / 10})


def by_hand(d: float, rate: float, samples: int) -> float:
    """The root of the smaller eigenvalue of the mean of (1, rate t)'(1, rate t) from 0 to d, t^2 by trapezoids."""
    a, b, c = 1.0, rate * d / 2, (rate * d) ** 2 * (1 / 3 + 1 / (6 * samples**2))
    return math.sqrt((a + c - math.sqrt((a - c) ** 2 + 4 * b * b)) / 2)


@pytest.mark.parametrize("rate", [2.0, 0.01])
def test_a_chain_by_hand(rate: float) -> None:
    """x1 crosses its range of 2 in 2/rate at the highest speed, x2 never moves: the same at every point."""
    visibility = observability_measure(integrator(rate))
    assert 2 / rate <= visibility.window <= 2.2 / rate
    assert visibility.least == pytest.approx(by_hand(visibility.window, rate, 20), rel=1e-12)
    assert visibility.median == pytest.approx(visibility.least, rel=1e-12)


def test_along_a_trial_by_hand() -> None:
    visibility = observability_measure(integrator(), Trial("rest", 5.0, start={"x1": 0, "x2": 0}, inputs={}))
    assert visibility.window == 0.5
    assert visibility.least == pytest.approx(by_hand(0.5, 2.0, 20), rel=1e-12)
    assert next(iter(visibility.direction)) == "x2"
    assert sum(share**2 for share in visibility.direction.values()) == pytest.approx(1)


def test_a_car_that_goes_straight_shows_exactly_nothing_of_its_steering() -> None:
    visibility = observability_measure(*car(still=True))
    assert visibility.least == visibility.median == 0.0
    assert visibility.below_resolution
    assert abs(visibility.direction["k"]) == 1.0
    assert not observability_measure(*car(still=False)).below_resolution


def test_what_a_frozen_plant_hides_its_motion_shows() -> None:
    """An induction motor under an unknown load, which shows its speed as its flux turns."""
    names = {"ia": 20, "ib": 20, "fa": 1.5, "fb": 1.5, "w": 200, "load": 50}
    ia, ib, fa, fb, w, load = (hg.Signal(name, low=-most, high=most) for name, most in names.items())
    ua, ub = (hg.Signal(name, low=-300, high=300) for name in ("ua", "ub"))
    flow = [
        100 * ua - 200 * ia + 250 * fa + 25 * w * fb,
        100 * ub - 200 * ib + 250 * fb - 25 * w * fa,
        2 * ia - 10 * fa - w * fb,
        2 * ib - 10 * fb + w * fa,
        20 * (fa * ib - fb * ia) - load,
        0,
    ]
    states, outputs = (ia, ib, fa, fb, w, load), (hg.Signal("ya"), hg.Signal("yb"))
    motor = hg.System("motor", states=states, inputs=(ua, ub), outputs=outputs, flow=flow, output=[ia, ib])
    frozen = observability_measure(motor)
    assert frozen.by_motion
    assert not frozen.below_resolution
    assert str(frozen).startswith("linearised at fixed points of the declared ranges, ")
    turning = {"ua": 100 * sp.cos(60 * t), "ub": 100 * sp.sin(60 * t)}
    moving = observability_measure(motor, Trial("turning", 2, start=dict.fromkeys(names, 0), inputs=turning))
    assert not moving.by_motion
    assert moving.median > 1e-4


def test_where_the_rank_of_a_frozen_plant_is_not_known_it_is_as_measured() -> None:
    """Frozen, x' = u k + w + sign(x) tells k from w nowhere; the slope of its sign is beyond algebra."""
    x, k, w, u = (hg.Signal(name, low=-1, high=1) for name in ("x", "k", "w", "u"))
    flow = [u * k + w + sp.sign(x), 0, 0]
    frozen = observability_measure(
        hg.System("step", states=(x, k, w), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x])
    )
    assert frozen.by_motion
    assert not frozen.below_resolution


def test_the_end_of_a_long_chain_is_practically_unobservable_frozen_too() -> None:
    """Cells of a rod at rest: the rank of the frozen plant is full, its smallest singular value below what rounds."""
    T = [hg.Signal(f"T{i}", low=-1, high=1) for i in range(20)]
    flow = [T[max(i - 1, 0)] - 2 * T[i] + T[min(i + 1, 19)] - T[i] ** 3 / 10 for i in range(20)]
    frozen = observability_measure(hg.System("rod", states=T, outputs=(hg.Signal("y"),), flow=flow, output=[T[0]]))
    assert 0 < frozen.median < 1e-12
    assert not frozen.by_motion
    assert frozen.below_resolution
    assert "less than 1e-12 times their range" in str(frozen)


def test_where_it_is_least() -> None:
    """Steering stops for good at 2: from there on nothing is shown, before something is."""
    plant, trial = car(still=False)
    stopped = Trial("stop", 4, start=trial.start, inputs={"u": sp.Piecewise((sp.cos(t), t < 2), (0, True))})
    visibility = observability_measure(plant, stopped)
    assert visibility.least == 0.0 < visibility.median
    assert visibility.where["t"] == pytest.approx(2, abs=4 / 100 + 1e-9)


def test_a_singular_input_is_among_the_points() -> None:
    """The middle of the box has u = 0; the lorenz system is blind on x = 0, the middle of its box."""
    visibility = observability_measure(load(MODELS / "lorenz.toml").plant)
    assert visibility.least == 0.0
    assert visibility.where["x"] == 0.0
    assert visibility.median > RESOLVED


def test_it_is_the_root_mean_square_of_the_integral() -> None:
    """x' = A x, against SciPy's Lyapunov equation: its Gramian for ever, less what comes after the window."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, 4)]
    A = np.array([[0, 1, 0], [-9, -1, 1], [0, 0, -2]])
    plant = hg.System(
        "linear",
        states=x,
        outputs=(hg.Signal("y", low=-1, high=1),),
        flow=list(sp.Matrix(A) * sp.Matrix(x)),
        output=[x[0]],
    )
    visibility = observability_measure(plant, Trial("free", 30, start={"x1": 1, "x2": 0, "x3": 0}, inputs={}))
    forever = solve_continuous_lyapunov(A.T, -np.outer(*2 * [np.eye(3)[0]]))  # A'X + XA = -C'C
    end = expm(A * visibility.window)
    W = (forever - end.T @ forever @ end) / visibility.window
    # (2 |A| h)^2/24 at h = 0.15
    assert visibility.least == pytest.approx(math.sqrt(np.linalg.eigvalsh(W)[0]), rel=0.035)


def test_units_change_nothing() -> None:
    """Millimetres and milliseconds: ranges, rates and the time unit all scale."""
    x1, x2 = hg.Signal("x1", low=-1000, high=1000), hg.Signal("x2", low=-2, high=2)
    plant = hg.System(
        "mm", states=(x1, x2), outputs=(hg.Signal("y", low=-1000, high=1000),), flow=[x2, 0], output=[x1], time="ms"
    )
    assert observability_measure(plant).least == pytest.approx(observability_measure(integrator()).least, rel=1e-12)
    assert observability_measure(plant).window == pytest.approx(1000 * observability_measure(integrator()).window)


def test_a_jump_and_a_stiff_mode_are_no_obstacle() -> None:
    """A mode of 1e4/s that shows nothing for long; the trial jumps."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)
    plant = hg.System(
        "stiff", states=(x1, x2), outputs=(hg.Signal("y", low=-1, high=1),), flow=[x2 - x1, -1e4 * x2], output=[x1]
    )
    visibility = observability_measure(
        plant, Trial("jump", 10, start={"x1": 0, "x2": 0}, inputs={}, jumps=(Jump(5, "x1", 0.5),))
    )
    assert 0 < visibility.least < 1e-4
    assert visibility.below_resolution
    assert math.isfinite(observability_measure(plant).least)


def test_what_cannot_be_measured_says_why() -> None:
    free = hg.System("free", states=(hg.Signal("x"),), outputs=(hg.Signal("y"),), flow=[0], output=[hg.Signal("x")])
    with pytest.raises(NoLinearisation, match="no range is declared for x"):
        observability_measure(free)
    x = hg.Signal("x", low=-2, high=-1)
    nowhere = hg.System("nowhere", states=(x,), outputs=(hg.Signal("y"),), flow=[sp.log(x)], output=[x])
    with pytest.raises(NoLinearisation, match="no value at any of"):
        observability_measure(nowhere)
    with pytest.raises(BadTrial):
        observability_measure(integrator(), Trial("late", 5.0, start={"x1": 0}, inputs={}))


def test_a_system_without_an_end_is_finite() -> None:
    """x' = x^2 leaves its box in finite time; what grows is cut."""
    x = hg.Signal("x", low=-100, high=100)
    plant = hg.System("escape", states=(x,), outputs=(hg.Signal("y"),), flow=[x**2], output=[x**3])
    visibility: ObservabilityMeasure = observability_measure(plant)
    assert 0 <= visibility.least <= visibility.median < math.inf
    assert visibility.as_dict()["where"] == {"x": 0.0}
