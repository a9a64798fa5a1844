"""Inputs of a log that is faster than the step, or irregular: means that keep the integral."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.reading import measured
from hgogen.reading.measured import WINDOWS, Record, needs_averaging, read, window_means

HOLD = 1e9
NAN = np.nan


def integral(u: np.ndarray, dt: float, between: str) -> float:
    """What a step makes of its inputs."""
    if between == "line":
        return dt * float((u[:-1] + u[1:]).sum()) / 2
    return dt * float((u[1:] if between == "hold" else u[:-1]).sum())


def held(times: np.ndarray, values: np.ndarray, until: float) -> float:
    """The integral of rows that are held, to a time."""
    ends = np.minimum(np.append(times[1:], until), until)
    return float((values * np.maximum(ends - times, 0)).sum())


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(1e-3, 3.0), min_size=1, max_size=60), st.integers(0, 2**31), st.sampled_from(sorted(WINDOWS)))
def test_the_integral_of_the_held_log_is_kept(steps: list[float], seed: int, between: str) -> None:
    """Whatever the times of the rows, to rounding of sums of 60 numbers of size 60."""
    times = np.concatenate([[5.0], 5.0 + np.cumsum(steps)])
    values = np.random.default_rng(seed).normal(size=len(times))
    dt, samples = 0.7, int((times[-1] - 5.0) / 0.7) + 2
    u = window_means(times, values, 5.0, samples, dt, WINDOWS[between], HOLD)
    until = 5.0 + (samples - 1) * dt
    assert integral(u, dt, between) == pytest.approx(held(times, values, until), abs=1e-11)


def test_a_constant_is_itself_and_a_step_is_where_it_was() -> None:
    times = np.arange(1000) * 0.001
    for window in WINDOWS.values():
        assert window_means(times, np.full(1000, 3.0), 0, 100, 0.01, window, HOLD) == pytest.approx(np.full(100, 3.0))
    rise = np.where(times >= 0.5 - 1e-9, 1.0, 0.0)
    expected = {"line": [0, 0.5, 1], "hold": [0, 0, 1], "forward": [0, 1, 1]}
    for between, means in expected.items():
        u = window_means(times, rise, 0, 100, 0.01, WINDOWS[between], HOLD)
        assert u[49:52] == pytest.approx(means, abs=1e-6), between


def test_what_was_not_measured_is_held_for_a_while_and_then_missing() -> None:
    times = np.arange(10.0)
    values = np.array([NAN, 1, NAN, NAN, NAN, NAN, NAN, 8, NAN, 10])
    u = window_means(times, values, 0, 10, 1.0, WINDOWS["forward"], 2.0)
    np.testing.assert_allclose(u, [NAN, 1, 1, 1, NAN, NAN, NAN, 8, 8, 10])
    assert np.isnan(window_means(times, np.full(10, NAN), 0, 10, 1.0, WINDOWS["line"], 2.0)).all()
    assert window_means(times[:1], np.array([4.0]), 0, 1, 1.0, WINDOWS["line"], 2.0) == [4.0]


def test_which_logs_are_averaged() -> None:
    regular, draw = np.full(99, 0.01), np.random.default_rng(1)
    assert needs_averaging(regular, 0.01, 0.1)
    assert not needs_averaging(regular, 0.01, 0.01)
    assert not needs_averaging(regular, 0.01, 0.001)
    assert not needs_averaging(regular * draw.uniform(0.9, 1.1, 99), 0.01, 0.01)  # jitter
    assert needs_averaging(draw.exponential(0.01, 99), 0.007, 0.01)
    assert not needs_averaging(np.append(regular, 5.0), 0.01, 0.01)  # a pause


def logged(folder: Path, times: np.ndarray, between: str, dt: float = 0.1) -> Record:
    rows = "\n".join(f"{t:.9f},{np.sin(7 * t):.9f},{np.cos(7 * t):.9f}" for t in times)
    (folder / "log.csv").write_text(f"t,u,y\n{rows}\n")
    columns = {"u": "u", "y": "y"}
    return read(folder / "log.csv", columns, dt=dt, time="t", inputs={"u": WINDOWS[between]})


@pytest.mark.parametrize("between", ["line", "hold"])
@pytest.mark.parametrize("kind", ["faster", "irregular"])
def test_inputs_are_averaged_and_outputs_are_sampled(kind: str, between: str, tmp_path: Path) -> None:
    draw = np.random.default_rng(2)
    times = np.arange(0, 2.0001, 0.004) if kind == "faster" else np.cumsum(draw.exponential(0.09, 60))
    times = np.round(times, 9)
    got = logged(tmp_path, times, between)
    u, y = got.values.T
    until = float(got.t[-1])
    charge = held(times, np.round(np.sin(7 * times), 9), until)
    assert integral(u, 0.1, between) == pytest.approx(charge, abs=1e-9)
    nearest = times[np.argmin(np.abs(times[:, None] - got.t), axis=0)]
    there = np.isfinite(y)
    np.testing.assert_allclose(y[there], np.cos(7 * nearest)[there], atol=1e-8)
    assert any("averaged over each step" in note for note in got.report.notes)
    assert got.report.absent["u"] == 0
    assert got.report.covered["u"] == 0


def test_a_log_on_the_grid_of_the_step_is_taken_as_it_is(tmp_path: Path) -> None:
    got = logged(tmp_path, np.arange(50) * 0.1, "line")
    np.testing.assert_allclose(got.values[:, 0], np.sin(0.7 * np.arange(50)), atol=1e-8)
    assert got.report.notes == ()


def test_the_last_window_goes_on_in_a_log_that_does() -> None:
    times, values = np.array([0.0, 0.5, 1.0, 1.5]), np.array([0.0, 0.0, 4.0, 8.0])
    means = measured.window_means(times, values, 0.0, 2, 1.0, (-0.5, 0.5), 10.0)
    assert means == pytest.approx([0.0, 2.0])  # of 0 and 4, half a step each
