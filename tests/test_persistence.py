"""What the check of regular persistence tells a user to write."""

from typing import Any

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import ClaimId, Verdict
from hgogen.estimators.persistence import persistent, t

SHOWN = ClaimId("input", "persistence")


def turned() -> hg.Form:
    """x' = u x2: x2 shows where u is not 0."""
    x1, x2, u = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2), hg.Signal("u", low=-1, high=1)
    data = {"states": (x1, x2), "inputs": (u,), "outputs": (hg.Signal("y"),)}
    return hg.forms.state_affine(hg.System("turned", **data, flow=[u * x2, -x2], output=[x1]))


@pytest.mark.parametrize("period", [2 * np.pi, "6.283185307179586", None])
def test_a_period_that_is_rounded_is_told_how_to_be_written(period: Any) -> None:
    check = persistent(SHOWN, turned(), {"u": "sin(t)"}, period)
    assert check.verdict is Verdict.UNKNOWN
    assert 'Write a multiple of pi as such: period = "2*pi"' in check.fix


@pytest.mark.parametrize("period", ["2*pi", 2 * sp.pi])
def test_as_it_is_told_it_is_proved(period: Any) -> None:
    assert persistent(SHOWN, turned(), {"u": sp.sin(t)}, period).verdict is Verdict.PROVED


def test_an_input_outside_of_its_range_when_it_is_asked_shows_nothing() -> None:
    """Of a period of 2 pi the input is in [-1, 1] around t = 0.3 alone; it is asked at 0.9, 2.5 and 4.7."""
    assert persistent(SHOWN, turned(), {"u": "10 - 9.9*cos(t - 3/10)"}, "2*pi").verdict is Verdict.UNKNOWN
    assert persistent(SHOWN, turned(), {"u": "10 - 9.9*cos(t - 9/10)"}, "2*pi").verdict is Verdict.PROVED


def test_the_times_asked_are_shares_of_a_period_however_short() -> None:
    """At t = 0, to which three decimals of a second would round them, sin shows nothing."""
    check = persistent(SHOWN, turned(), {"u": "sin(20000*pi*t)"}, "1/10000")
    assert check.verdict is Verdict.PROVED
    assert "at t = 1.43e-05," in str(check.reason)
    assert persistent(SHOWN, turned(), {"u": "sin(20000*pi*t)"}, "1/9999").verdict is Verdict.UNKNOWN


@pytest.mark.parametrize(("u", "period"), [("sin(24*t)", "2*pi"), ("cos(25)", None)])
def test_an_angle_alone_may_be_any_multiple(u: str, period: str | None) -> None:
    assert persistent(SHOWN, turned(), {"u": u}, period).verdict is Verdict.PROVED


@pytest.mark.parametrize(("u", "period"), [("sin(t)/2 + sin(24*t)/2", "2*pi"), ("cos(25)/2 + cos(1)/2", None)], ids=str)
def test_what_exact_algebra_cannot_do_is_unknown(u: str, period: str | None) -> None:
    """A multiple beyond 16 of what angles have in common is too large for it: a check says so, and what may help."""
    check = persistent(SHOWN, turned(), {"u": u}, period)
    assert check.verdict is Verdict.UNKNOWN
    assert "is too large for exact algebra" in str(check.reason)
    assert "the shortest period" in check.fix
    observer = hg.observers.kalman_like(turned(), rho=1, R=1, inputs={"u": u}, period=period)
    assert check.reason in {one.reason for one in observer.checks}


def test_the_shortest_period_is_proved() -> None:
    assert persistent(SHOWN, turned(), {"u": "sin(24*t)"}, "pi/12").verdict is Verdict.PROVED


def test_an_input_that_touches_its_range_from_outside_shows_nothing() -> None:
    """u = -sin(t) is below 1 but at t = 3 pi/2, so that the observer takes 1 for good, and x2 shows in u - 1 alone."""
    x, u = [hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2, 3)], hg.Signal("u", low=1, high=2)
    data = {"states": x, "inputs": (u,), "outputs": (hg.Signal("y1"), hg.Signal("y2")), "flow": [0, 0, 0]}
    form = hg.forms.state_affine(hg.System("touched", **data, output=[x[0] + (u - 1) * x[1], x[2]]))
    assert persistent(SHOWN, form, {"u": "-sin(t)"}, "2*pi").verdict is Verdict.UNKNOWN
    assert persistent(SHOWN, form, {"u": "1.5 - sin(t)/4"}, "2*pi").verdict is Verdict.PROVED


def test_two_inputs_that_hide_a_state_together() -> None:
    """y = x1 + sin(t) x2 is constant, for x1' = -cos(t) x2."""
    x = [hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2)]
    u, w = (hg.Signal(name, low=-2, high=2) for name in "uw")
    data = {"states": x, "inputs": (u, w), "outputs": (hg.Signal("y"),), "flow": [w * x[1], 0]}
    form = hg.forms.state_affine(hg.System("hidden", **data, output=[x[0] + u * x[1]]))
    assert persistent(SHOWN, form, {"u": "sin(t)", "w": "-cos(t)"}, "2*pi").verdict is not Verdict.PROVED
    assert persistent(SHOWN, form, {"u": "sin(t)", "w": "cos(t)"}, "2*pi").verdict is Verdict.PROVED


@pytest.mark.parametrize(
    ("row", "a", "b", "period"),
    [
        ("gain", "sin(t)", "sin(t)", "2*pi"),
        ("gain", "sin(t)", "sin(t)", None),
        ("rest", "2", "0", None),
        ("output", "sin(t)", "sin(t)", "2*pi"),
    ],
)
def test_an_input_for_which_the_plant_has_no_value_shows_nothing(row: str, a: str, b: str, period: str | None) -> None:
    """a/b is 1 for a = b = sin t, and (b x + b)/b is x + 1, but the plant has no value where b = 0."""
    x, z = (hg.Signal(name, low=-1, high=1) for name in "xz")
    u, w = hg.Signal("a"), hg.Signal("b")
    rate = {"gain": u / w * z, "rest": (w * z + w) / w, "output": z}[row]
    output = u / w * x if row == "output" else x
    plant = hg.System(
        "plant", states=(x, z), inputs=(u, w), outputs=(hg.Signal("y"),), flow=[rate, -z], output=[output]
    )
    form = hg.forms.state_affine(plant)
    assert persistent(SHOWN, form, {"a": a, "b": b}, period).verdict is Verdict.UNKNOWN
    assert persistent(SHOWN, form, {"a": "2 + sin(t)", "b": "2 + sin(t)"}, "2*pi").verdict is Verdict.PROVED
