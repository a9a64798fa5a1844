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


@pytest.mark.parametrize("place", [1, 4, 9])
def test_an_outlier_among_the_first_samples_moves_a_rate_little(place: int) -> None:
    y, u = swing((1.0, 5.0), 60, 2.0), np.full((60, 1), 2.0)
    y[place] += 0.5  # of 500 deviations
    assert first_states(PENDULUM, u, y, None, {"q": float(y[0, 0])}) == {"w": pytest.approx(5.0, abs=0.1)}


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


def heat(u: np.ndarray, x: tuple[float, ...], sigma: float = 0.02) -> np.ndarray:
    """The first of three masses in a row (N, 1), of which the last is heated by u and all lose to 20 degrees."""
    at, rows = np.array(x), []
    for power in u[:, 0]:
        rows.append(at[0])
        for _ in range(20):
            a, b, c = at
            at = at + DT / 20 * np.array([(b - a) - (a - 20) / 2, (a - b) + (c - b), (b - c) + power])
    return (np.array(rows) + sigma * np.random.default_rng(0).normal(size=len(u)))[:, None]


A, B2, C = (hg.Signal(name, low=0, high=200) for name in "abc")
MASSES = step_of([(B2 - A) - (A - 20) / 2, (A - B2) + (C - B2), (B2 - C) + U], (A, B2, C), A)


def test_first_samples_at_rest_tell_what_lies_behind_them() -> None:
    """Of constant ones: a = 20 + 2 u, b = a + u, c = b + u; ten samples tell c by their noise, five degrees off."""
    u = np.where(np.arange(100) < 50, 5.0, 8.0)[:, None]
    y = heat(u, (30.0, 35.0, 40.0))
    measured = {"a": float(y[0, 0])}
    begins = first_states(MASSES, u, y, None, measured, steady=True)
    assert begins == {"b": pytest.approx(35.0, abs=0.1), "c": pytest.approx(40.0, abs=0.1)}
    assert first_states(PENDULUM, np.zeros((60, 1)), swing((0.5, 4.0), 60, 0.0), None, {"q": 0.5}, steady=True) == {}
    changing = np.where(np.arange(100) < 5, 5.0, 8.0)[:, None]
    assert first_states(MASSES, changing, y, None, measured, steady=True) == {}


@pytest.mark.parametrize("level", [60.0, 195.0])
def test_where_no_rest_gives_the_samples_nothing_is_taken(level: float) -> None:
    """At u = 5 the rest of a is 30: c of a = 60 falls by 15 a second, and that of 195 is beyond its range."""
    y = level + 0.02 * np.random.default_rng(1).normal(size=(100, 1))
    assert first_states(MASSES, np.full((100, 1), 5.0), y, None, {"a": level}, steady=True) == {}


def test_a_constant_has_no_rest() -> None:
    """Of two states that stay where they are only the sum is measured."""
    both = step_of([W, U, 0 * B], (Q, W, B), Q + B)
    y = 0.2 + 1e-3 * np.random.default_rng(2).normal(size=(60, 1))
    begins = first_states(both, np.zeros((60, 1)), y, None, {}, steady=True)
    assert "b" not in begins
    assert begins["w"] == pytest.approx(0.0, abs=0.02)
