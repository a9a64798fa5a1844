"""A trial from ranges: it stays in them, moves, and says why there is none."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
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
