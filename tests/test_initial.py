"""The state at the first sample of a log: known answers of motions, of what no sample determines, and odd logs."""

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.logs.initial import first_states

Q, W, B = hg.Signal("q", low=-9, high=9), hg.Signal("w", low=-20, high=20), hg.Signal("b", nominal=0.3, low=-1, high=1)
U, Y = hg.Signal("u", low=-9, high=9), hg.Signal("y")
DT = 0.02


def step_of(flow: list[object], states: tuple[hg.Signal, ...], output: object, y: hg.Signal = Y) -> hg.Step:
    plant = hg.System("swing", states=states, inputs=(U,), outputs=(y,), flow=flow, output=[output])
    form = hg.forms.original(plant)
    return hg.sample(hg.observers.riccati(form, Q=dict.fromkeys(form.names, 1.0), R=1e-4), dt=DT)


def swing(x: tuple[float, float], count: int, u: float, seed: int = 0, sigma: float = 1e-3) -> np.ndarray:
    at, rows = np.array(x), []
    for _ in range(count):
        rows.append(at[0])
        for _ in range(20):
            at = at + DT / 20 * np.array([at[1], -10 * np.sin(at[0]) + u])
    return (np.array(rows) + sigma * np.random.default_rng(seed).normal(size=count))[:, None]


PENDULUM = step_of([W, -10 * sp.sin(Q) + U], (Q, W), Q)


@pytest.mark.parametrize("rate", [0.0, 5.0, -15.0])
def test_a_rate_is_that_of_the_first_window(rate: float) -> None:
    y, u = swing((1.0, rate), 60, 2.0), np.full((60, 1), 2.0)
    y[[2, 3]] = np.nan  # missing samples
    begins = first_states(PENDULUM, u, y, None, {"q": float(y[0, 0])})
    assert begins == {"w": pytest.approx(rate, abs=0.05)}  # sigma/(T sqrt(N/12)) is .006, the rest the steps of 1e-3


def test_a_state_behind_several_is_found_and_one_that_nothing_moves_is_not() -> None:
    """Of the measured q + b the rate is known from a short window, b is not, and keeps its start."""
    y, u = swing((0.5, 4.0), 60, 0.0), np.zeros((60, 1))
    both = step_of([W, -0.01 * sp.sin(Q) + U, 0 * B], (Q, W, B), Q + B)
    line = 0.8 + 4 * DT * np.arange(60)[:, None] + 1e-3 * np.random.default_rng(1).normal(size=(60, 1))
    begins = first_states(both, u, line, None, {})
    assert begins["w"] == pytest.approx(4.0, abs=0.2)
    assert "b" not in begins
    all_known = first_states(PENDULUM, u, y, None, {})
    assert all_known == {"q": pytest.approx(0.5, abs=0.01), "w": pytest.approx(4.0, abs=0.1)}


def test_an_angle_is_taken_across_its_turn() -> None:
    turning = hg.Signal("q", low=-np.pi, high=np.pi, period=2 * np.pi)
    angle = hg.Signal("y", period=2 * np.pi)
    step = step_of([W, -10 * sp.sin(turning) + U], (turning, W), turning, angle)
    y = np.remainder(swing((-0.3, 6.0), 60, 0.0), 2 * np.pi)
    begins = first_states(step, np.zeros((60, 1)), y, None, {"q": -0.3})
    assert begins == {"w": pytest.approx(6.0, abs=0.05)}


@pytest.mark.parametrize("y", [np.full((60, 1), np.nan), np.full((9, 1), 0.1)])
def test_too_few_samples_determine_nothing(y: np.ndarray) -> None:
    assert first_states(PENDULUM, np.zeros((len(y), 1)), y, None, {}) == {}


def test_a_log_far_from_the_model_keeps_the_ranges() -> None:
    y = (1e3 * np.arange(60.0) ** 2)[:, None]
    begins = first_states(PENDULUM, np.zeros((60, 1)), y, None, {"q": 9.0})
    assert all(-20 <= value <= 20 for value in begins.values())
