"""Bounds of the plant's own states behind a change of coordinates: against runs that push, samples of the map's slopes,
and where none is known."""

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import MODELS

import hgogen as hg
from hgogen.certificates.error_bound import slopes_of_states
from hgogen.check import Verdict
from hgogen.emit.manual import proved_bounds
from hgogen.model import load
from hgogen.program import Place
from hgogen.stepping.machine import Machine

INPUTS: dict[str, Any] = {"noise": {"y": 1e-3}, "disturbance": {"x2": 0.05}, "rates": {"u": 0.1}}
u, y = hg.Signal("u", low=0.2, high=1.5), hg.Signal("y", "m")
w = hg.Signal("w", low=0, high=1.7)


def pushed() -> hg.Form:
    """x2 = exp(w) of the triangular form."""
    x1, x2 = hg.Signal("x1", "m", low=-4, high=4), hg.Signal("x2", low=1, high=5)
    flow = [sp.log(x2) - x1, x2 * (u - sp.log(x2))]
    plant = hg.System("pushed", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=[x1])
    return hg.forms.triangular(hg.recast(plant, {w: sp.log(x2)}, {x2: sp.exp(w)}))


def geared() -> hg.Form:
    """x2 is recovered from x1 and y', clamped to its range."""
    x1, x2 = hg.Signal("x1", "m", low=-1, high=1), hg.Signal("x2", low=-2, high=2)
    flow = [x2 * (2 + x1 / 4) - x1, u - x2]
    return hg.forms.phase(hg.System("geared", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=[x1]))


CASES: dict[str, tuple[Callable[[], hg.Form], float, float, tuple[float, float]]] = {
    "pushed": (pushed, 5, 0.01, (0.5, 2.0)),
    "geared": (geared, 12, 0.005, (0.4, 0.3)),
}


@cache
def step_of(case: str) -> hg.Step:
    form, theta, dt, _ = CASES[case]
    return hg.sample(hg.observers.high_gain(form(), theta=theta, poles=(-1, -1)), hg.methods.rk4, dt=dt)


@cache
def bounded(case: str) -> hg.ErrorBound:
    known = hg.error_bound(step_of(case), **INPUTS)
    assert known.check.verdict is Verdict.PROVED, known
    return known


@pytest.mark.full
@pytest.mark.parametrize("case", CASES)
def test_no_run_errs_further(case: str) -> None:
    known, step = bounded(case), step_of(case)
    assert known.settles is not None
    first, bound = round(known.settles / step.dt), known.bounds["x2"]
    largest = max(np.abs(run(case, first + 400, sign, follow))[first:].max() for sign in (1, -1) for follow in (0, 1))
    assert 0.05 * bound < largest <= 1.1 * bound


def run(case: str, calls: int, push: int, follow: int) -> np.ndarray:
    """The error of x2, noise and disturbance by the sign of it, or of one sign."""
    machine, errors, step, truth = Machine(step_of(case)), np.zeros(calls), step_of(case), np.array(CASES[case][3])
    flow = sp.lambdify([*step.states, *step.inputs], list(step.observer.form.system.declared.flow))
    error = 1.0
    for k in range(calls):
        sign = push * (np.sign(error) if follow else 1.0)
        machine.memory[Place("output", "y")][0] = truth[0] + 1e-3 * sign
        machine.memory[Place("input", "u")][0] = 0.3
        machine.call()
        errors[k] = error = machine.memory[Place("estimate", "x2")][0] - truth[1]
        for _ in range(10):
            truth = truth + step.dt / 10 * (np.array(flow(*truth, 0.3)) + np.array([0, 0.05 * sign]))
    return errors


@pytest.mark.full
@pytest.mark.parametrize("case", CASES)
def test_its_shares_add_and_the_check_names_it(case: str) -> None:
    known = bounded(case)
    assert list(known.bounds)[-1] == "x2"
    assert "x2" not in known.inside
    assert known.bounds["x2"] == pytest.approx(sum(share["x2"] for share in known.shares.values()))
    assert "x2 within" in str(known.check.reason)
    assert "The bound of x2 follows from the others" in "\n".join(proved_bounds(hg.signed(step_of(case), **INPUTS)))


def test_the_slope_is_the_largest_between_plant_and_estimate() -> None:
    """Of w = sqrt(x1), of a level, with an estimate that errs by .2; it is clamped below, where the square turns."""
    form = load(MODELS / "cascaded_tanks.py").step("high_gain").observer.form
    slopes = slopes_of_states(form, [Fraction(1, 10), Fraction(1, 5)])["x1"]
    assert slopes[0] == 0
    assert 2 * (3.1623 + 0.2) <= slopes[1] <= 2.02 * (3.1623 + 0.2)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_estimate_may_be_beyond_either_end(sign: int) -> None:
    """x2 = exp(w), w up to 1.7, or x2 = exp(-w), w from -1.7, with an estimate that errs by .1."""
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=1, high=5)
    own = hg.Signal("w", low=min(0, 1.7 * sign), high=max(0, 1.7 * sign))
    plant = hg.System("curved", states=(x1, x2), outputs=(y,), flow=[sign * sp.log(x2), 3 - x2], output=[x1])
    form = hg.forms.triangular(hg.recast(plant, {own: sign * sp.log(x2)}, {x2: sp.exp(sign * own)}))
    slopes = slopes_of_states(form, [Fraction(0), Fraction(1, 10)])["x2"]
    assert slopes[0] == 0
    assert np.exp(1.8) <= float(slopes[1]) <= 1.001 * np.exp(1.8)


def test_what_is_linear_counts_without_the_rest_as_well() -> None:
    """x2 = 2 w - w^2/4: of two estimates beyond where the square is clamped, the whole is 2 w."""
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=1, high=3)
    root, own = 4 - 2 * sp.sqrt(4 - x2), hg.Signal("w", low=0.5, high=2.1)
    plant = hg.System("bent", states=(x1, x2), outputs=(y,), flow=[root - x1, 2 - x2], output=[x1])
    form = hg.forms.triangular(hg.recast(plant, {own: root}, {x2: 2 * own - own**2 / 4}))
    slopes = slopes_of_states(form, [Fraction(0), Fraction(1, 100)])["x2"]
    assert 2 <= slopes[1] <= 2.02


def test_of_a_recovered_state_it_is_that_of_the_inverse() -> None:
    form = geared()
    (low, high), (least, most) = (z.interval for z in form.states)
    z1, z2 = np.meshgrid(np.linspace(low, high, 200), np.linspace(least, most, 200))
    each = np.abs([(32 - 4 * z2) / (z1 + 8) ** 2, 4 / (z1 + 8)]).max(axis=(1, 2))  # of 4 (z1 + z2)/(z1 + 8)
    slopes = np.array([float(x) for x in slopes_of_states(form, [Fraction(0)] * 2)["x2"]])
    assert (each <= slopes).all()
    assert (slopes <= 1.03 * each).all()


def test_of_a_sum_of_recovered_states_it_is_that_of_both() -> None:
    """x2 = v - x1, as each of them is clamped by itself: x1 = z1, v = z1 + 4 (z1 + z2)/(z1 + 8)."""
    plant, own = geared().system.declared, hg.Signal("v", low=-3, high=3)
    x1, x2 = plant.states
    form = hg.forms.phase(hg.recast(plant, {own: x2 + x1}, {x2: own - x1}))
    (low, high), (least, most) = (z.interval for z in form.states)
    z1, z2 = np.meshgrid(np.linspace(low, high, 200), np.linspace(least, most, 200))
    each = np.abs([2 + (32 - 4 * z2) / (z1 + 8) ** 2, 4 / (z1 + 8)]).max(axis=(1, 2))
    slopes = np.array([float(x) for x in slopes_of_states(form, [Fraction(0)] * 2)["x2"]])
    assert (each <= slopes).all()
    assert (slopes <= 1.03 * each).all()


def test_without_a_slope_there_is_no_bound() -> None:
    """Of a root that may be 0."""
    form = hg.forms.phase(load(MODELS / "magnetic_levitation.toml").plant)
    assert set(slopes_of_states(form, [Fraction(0)] * 3)) <= {"x", "v"}
