"""A trial from ranges: it stays in them, moves, and says why there is none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import CART

import hgogen as hg
from hgogen.commands.trial_runs import trials_of
from hgogen.trial import CROSSINGS, NoTrial

X, V = hg.Signal("x", low=-1, high=3), hg.Signal("v", low=-2, high=2)
U, Y = hg.Signal("u", low=0, high=2), hg.Signal("y")


def plant(*flow: Any, inputs: tuple[hg.Signal, ...] = (U,)) -> hg.System:
    return hg.System("mass", states=(X, V), inputs=inputs, outputs=(Y,), flow=list(flow), output=[X])


def test_it_is_half_way_to_the_ends() -> None:
    """x crosses 4 at a speed of 2 in 2, v crosses 4 at a rate of 2 x 2 in 1."""
    trial = hg.proposed_trial(plant(V, -2 * V + 0 * U))
    assert trial.duration == pytest.approx(CROSSINGS * 2, rel=0.1)  # 32 points fill the box, not its corners alone
    assert trial.start == {"x": 2.0, "v": 1.0}
    assert trial.estimate == {"x": 1.0, "v": 0.0}
    u = np.array([float(trial.inputs["u"].subs(hg.trial.t, s)) for s in np.linspace(0, trial.duration, 201)])
    assert (u.min(), u.max()) == (pytest.approx(0.5, abs=1e-2), pytest.approx(1.5, abs=1e-2))


def test_the_heading_of_a_unicycle_turns() -> None:
    """Equal signals of both wheels would drive it straight on for ever."""
    x, y = (hg.Signal(name, low=-100, high=100) for name in "xy")
    heading, left, right = hg.Signal("psi", period=2 * sp.pi), *(hg.Signal(w, low=-30, high=30) for w in ("l", "r"))
    flow = [(left + right) * sp.cos(heading) / 20, (left + right) * sp.sin(heading) / 20, (right - left) / 4]
    states, outputs = (x, y, heading), (hg.Signal("gx"), hg.Signal("gy"))
    unicycle = hg.System("unicycle", states=states, inputs=(left, right), outputs=outputs, flow=flow, output=[x, y])
    trial = hg.proposed_trial(unicycle)
    truth = hg.trial.simulate(unicycle, trial, trial.duration / 733)
    assert np.ptp(truth.x[:, 2]) > 1
    assert np.argmax(np.abs(np.fft.rfft(truth.u, axis=0)), axis=0).tolist() == [10, 7]  # in 10 D
    assert (np.abs(truth.u) <= 30).all()


def test_an_input_stays_within_the_ranges_of_its_derivatives() -> None:
    """Half of u's range at once in 2 s is a rate of pi/2; .01 is slower, and .001 of the second derivative slowest."""
    slow = hg.Signal("u", low=0, high=2, rates=((-0.01, 0.5), (-0.001, 0.001)))
    u = sp.sympify(hg.proposed_trial(plant(V, -2 * V + 0 * slow, inputs=(slow,))).inputs["u"])
    moments = np.linspace(0, 1000, 3001)
    rate, second = (sp.lambdify(hg.trial.t, sp.diff(u, hg.trial.t, order))(moments) for order in (1, 2))
    assert np.abs(rate).max() == pytest.approx(0.01, rel=1e-4)
    assert np.abs(second).max() < 0.001


@pytest.mark.full
@settings(deadline=None, max_examples=15)
@given(a=st.floats(-3, 3), b=st.floats(-3, 3), c=st.floats(-1, 1))
def test_the_plant_stays_in_its_ranges(a: float, b: float, c: float) -> None:
    """Of any linear plant, stable or not, where there is a trial; at samples that it was not made with."""
    mass = plant(V, a * X + b * V + c * U)
    try:
        trial = hg.proposed_trial(mass)
    except NoTrial:
        return
    x = hg.trial.simulate(mass, trial, trial.duration / 733).x
    assert (np.abs(x - [1, 0]) <= 2 + 1e-9).all()
    assert np.ptp(x, axis=0).max() > 0


def test_an_unstable_plant_has_a_short_one() -> None:
    """x' = v, v' = 9 v leaves a range of 2 from c = 1/10 after log(10)/9 = .256."""
    trial = hg.proposed_trial(plant(V, 9 * V, inputs=()))
    assert trial.duration == pytest.approx(0.9 * np.log(10) / 9, abs=0.01)  # a sample


@pytest.mark.parametrize(
    ("mass", "reason"),
    [
        (plant(0 * X, 0 * V), "does not move within its ranges; declare a trial"),
        (plant(V, 9000 + 0 * X), "leaves its ranges within .* s on every motion that was tried"),
        (
            hg.System("free", states=(hg.Signal("x"),), inputs=(U,), outputs=(Y,), flow=[U], output=[U]),
            "has no range of x, and no trial; declare either",
        ),
    ],
)
def test_where_there_is_none_it_says_why(mass: hg.System, reason: str) -> None:
    with pytest.raises(NoTrial, match=reason):
        hg.proposed_trial(mass)


def test_a_plant_that_escapes_has_one_before() -> None:
    """x' = x^2 + 1 from 2 is infinite after pi/2 - atan(2) = .46."""
    grows = hg.System("grows", states=(X,), outputs=(Y,), flow=[X**2 + 1], output=[X])
    trial = hg.proposed_trial(grows)
    assert trial.start == {"x": 0.0}  # the sign -1, half way down: it stays longest
    leaves = np.arctan(3) - np.arctan(0)
    assert 0.9 * leaves / 2 < trial.duration <= 0.9 * leaves  # to a power of 2


NOISY = CART + 'observer = {kind = "ekf", Q_per_sample = {x = 1e-5, v = 1e-4}, noise = {y = 0.05}, dt = 0.01}\n'


def test_it_has_the_noise_that_the_observer_of_the_model_declares(tmp_path: Path) -> None:
    """A model's own trial keeps its own."""
    path = tmp_path / "cart.toml"
    path.write_text(NOISY)
    proposed = hg.load(str(path))
    (trial,) = trials_of(proposed, proposed.step())
    assert trial.noise["y"].sigma == pytest.approx(0.05, rel=1e-12)
    path.write_text(NOISY + "trial = {duration = 1, start = {x = 0, v = 0}, inputs = {u = 1}}")
    declared = hg.load(str(path))
    assert trials_of(declared, declared.step()) == declared.trials()
