"""Memory that was written by hand or restored: where a step starts, and which counts of the recovery it takes."""

from copy import copy
from typing import Any

import numpy as np
import plants
import pytest

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.model import load
from hgogen.observer import Observer
from hgogen.program import Place

# --- an estimate that is written before the first call -------------------------------------------------------

ADAPTIVE = {
    "staggered": lambda: hg.innovation.staggered(0.2),
    "window": lambda: hg.innovation.window(0.2),
}


def adaptive(name: str) -> Observer:
    theta = hg.theta.adaptive(2.0, mu=(0.1, 0.2), innovation=ADAPTIVE[name]())
    return plants.kalman(plants.van_der_pol(), theta=theta)


def memory(step: CallableStep, name: str) -> Any:
    return step._kept.places[Place("state", name)]


def estimates(step: CallableStep) -> dict[Place, Any]:
    """Every estimate in the memory, by place: the step's own, and those of copies that run beside it."""
    return {place: array for place, array in step._kept.places.items() if place.name == "z"}


@pytest.mark.parametrize("name", ADAPTIVE)
@pytest.mark.parametrize("banked", [False, True], ids=["alone", "in a bank"])
def test_all_that_estimates_starts_where_the_estimate_was_written(name: str, banked: bool) -> None:
    observer = hg.observers.bank(adaptive(name), count=3, period=1.0) if banked else adaptive(name)
    step = hg.sample(observer, dt=0.01, engine="python")
    estimates(step)[Place("state", "z")][:] = (0.5, -0.25)
    sample = step(y=np.nan)
    assert sample.x.tolist() == [0.5, -0.25]
    arrays = estimates(step)
    assert len(arrays) > 1
    for place, array in arrays.items():
        if place.struct != "past":
            np.testing.assert_array_equal(array.reshape(-1, 2), [(0.5, -0.25)] * (array.size // 2), place)


def test_a_gain_that_adapts_rests_where_the_right_estimate_was_written() -> None:
    """The predictors of the neuron's filter begin there too; else its theta rises to 7.9 for some seconds."""
    made = load(plants.MODELS / "fitzhugh_nagumo.py").step()
    truth, filtered = copy(made), copy(made)
    for step in (truth, filtered):
        memory(step, "z")[:] = (1.5, 2.0, -1.5)
    u = 0.8 * np.sin(0.01 * np.arange(400)) + 0.1
    y = truth.run(u=u, y=np.full(400, np.nan), engine="python")["x1"]
    run = filtered.run(u=u, y=y, engine="python")
    assert run.traces["theta"].max() < 1.01


# --- counts that were spoiled --------------------------------------------------------------------------------


def rested() -> CallableStep:
    """A step whose fault counts are 0, settled at 0."""
    step = hg.sample(plants.pendulum(theta=4), hg.methods.rk4, dt=0.05, engine="python")
    for _ in range(20):
        step(0.0, 0.0)
    return step


def wait(step: CallableStep) -> float:
    return step.code.signs[0].wait


@pytest.mark.parametrize(
    ("count", "limit", "checksum"),
    [(-1e30, 0.0, 1e30), (20.0, -20.0, 0.0), (0.0, 1e30, 1e30), (np.nan, 0.0, 0.0)],
)
def test_counts_out_of_their_ranges_begin_anew_though_they_add_up(count: float, limit: float, checksum: float) -> None:
    step = rested()
    memory(step, "fault_count_y")[0] = count
    memory(step, "fault_limit_y")[0] = wait(step) + limit
    memory(step, "fault_checksum")[0] = checksum
    step(0.0, 3.0)
    assert (memory(step, "fault_count_y")[0], memory(step, "fault_limit_y")[0]) == (1, wait(step))
    assert memory(step, "fault_checksum")[0] == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_a_checksum_that_is_no_number_is_put_right_by_the_next_sample(value: float) -> None:
    step = rested()
    memory(step, "fault_checksum")[0] = value
    step(0.0, 0.0)
    assert memory(step, "fault_checksum")[0] == 0
