"""Guards that a firmware engineer found wanting: each was seen to fail."""

import numpy as np
import pytest
import sympy as sp

import hgogen as hg


def pendulum(**output: float) -> hg.Step:
    q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20)
    tau, y = hg.Signal("tau", low=-1, high=1), hg.Signal("y", **output)
    plant = hg.System(
        "pendulum", states=(q, w), inputs=(tau,), outputs=(y,), flow=[w, -19.6 * sp.sin(q) - 0.1 * w + tau], output=[q]
    )
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)


def test_an_output_without_a_range_is_judged_by_the_ranges_of_its_states() -> None:
    """y = q on [-4, 4]: beyond 12 a reading is as implausible as it would be with a declared range."""
    step = pendulum()
    assert "REJECTED_y" not in step(u=0, y=11.9).flags
    step.reset()
    for value in (12.5, -12.5, 50, 1e6, 1e14):
        assert "REJECTED_y" in step(u=0, y=value).flags
    assert abs(step(u=0, y=0)["q"]) < 0.01


@pytest.mark.parametrize("lost", [np.nan, np.inf])
@pytest.mark.parametrize("field", ["z", "L", "D"])
def test_a_lost_value_restarts_the_whole_state(field: str, lost: float) -> None:
    """A restarted estimate with the old, small covariance would believe a made-up number."""
    q, w, y = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20), hg.Signal("y")
    plant = hg.System("pendulum", states=(q, w), outputs=(y,), flow=[w, -sp.sin(q)], output=[q])
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=(0.1, 0.1), R=0.1), dt=0.01)
    for _ in range(300):
        step(y=0.5)
    memory = step._kept.places
    memory[f"state.{field}"][0] = lost
    sample = step(y=np.nan)
    assert "RESTARTED" in sample.flags
    assert memory["state.z"].tolist() == [0, 0]
    assert memory["state.D"].tolist() == [1, 1]
    assert memory["state.L"].tolist() == [0]
    assert step(y=np.nan).flags == ("MISSING_y",)


def test_outside_the_box_is_said_of_the_estimate_that_is_returned() -> None:
    rng = np.random.default_rng(0)
    step = pendulum(low=-4, high=4)
    for k in range(2000):
        sample = step(u=0, y=rng.uniform(-8, 8) if k % 200 > 100 else 0.0)
        outside = abs(sample["q"]) > 4 or abs(sample["w"]) > 20
        assert ("OUTSIDE_BOX" in sample.flags) == outside
