"""A filter that corrects by the Jacobian takes an output by its tangent outside of the ranges: no correction is too
long."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics

s, v = hg.Signal("s", low=0, high=1), hg.Signal("v", low=-0.5, high=0.5)


def cell(output: Any) -> hg.System:
    """A charge that rests, and a voltage that relaxes."""
    return hg.System("cell", states=(s, v), outputs=(hg.Signal("y"),), flow=[0, -v / 60], output=[output])


STORED = s / 20 + (s - sp.Rational(1, 2)) ** 3 - v


@given(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), st.booleans())
def test_outside_of_the_ranges_an_output_goes_on_by_its_tangent(point: tuple[float, float], tangent: bool) -> None:
    form = hg.forms.original(cell(sp.sin(s) * sp.exp(v) + s - 2 * v))
    z, u = ca.SX.sym("z", 2), ca.SX(0, 1)
    (value,) = ca.Function("y", [z], [Dynamics(form, tangent).output(z, u)])(point).full().ravel()
    (a, b), (x, w) = np.clip(point, (0, -0.5), (1, 0.5)), point
    beyond = np.exp(b) * (np.cos(a) * (x - a) + np.sin(a) * (w - b)) if tangent else 0.0
    assert value == pytest.approx(np.sin(a) * np.exp(b) + x - 2 * w + beyond, rel=1e-12, abs=1e-12)


def test_a_sample_that_takes_an_estimate_out_of_its_range_does_not_lose_it() -> None:
    """One sample of noise takes s from .87 to 1.13. An output that ends flat there answers a move along the direction
    that is hardly seen, of which .8 ds - dv is small, by -dv alone: the correction would turn round and grow."""
    gains: dict[str, Any] = {"Q": (1e-12, 1e-9), "R": 1e-5, "initial": {"s": 0.9, "v": 0}}
    made = hg.observers.riccati(hg.forms.original(cell(STORED)), **gains)
    y = np.full(400, 0.025)
    y[1] -= 0.02
    guarded, plain = (hg.sample(made, dt=0.1, guards=guards).run(y=y) for guards in ("all", "none"))
    assert plain.x[1, 0] > 1.05
    assert (np.abs(plain.x[3:] - guarded.x[3:]) < 0.1).all()


def test_where_an_output_is_held_its_slope_adds_nothing() -> None:
    """Of y = v/s, held where that is accepted: at s = 0 it is the last one, 7; at s = 2 it goes on from s = 1."""
    made = hg.observers.riccati(
        hg.forms.original(cell(v / s)), Q=(1, 1), R=1, accept=("singular.y", "original.lipschitz")
    )
    z, u = ca.SX.sym("z", 2), ca.SX(0, 1)
    output = made.dynamics.output(z, u)
    (last,) = (each for each in ca.symvar(output) if each.name() not in {each.name() for each in ca.symvar(z)})
    read = ca.Function("y", [z, last], [output])
    assert [float(read(point, 7)) for point in ((0, 0.3), (-1, 0.3), (0.5, 0.3))] == [7, 7, 0.6]
    assert float(read((2, 0.3), 7)) == pytest.approx(0.3 - 0.3 * (2 - 1), abs=1e-15)


def test_where_a_slope_has_no_end_an_output_is_taken_as_it_is() -> None:
    """sqrt(s) + v at s = 0, and before it."""
    accept = ("singular.y", "original.lipschitz")
    made = hg.observers.riccati(hg.forms.original(cell(sp.sqrt(s) + v)), Q=(1, 1), R=1, accept=accept)
    z, u = ca.SX.sym("z", 2), ca.SX(0, 1)
    output = made.dynamics.output(z, u)
    (last,) = (each for each in ca.symvar(output) if each.name() not in {each.name() for each in ca.symvar(z)})
    read = ca.Function("y", [z, last], [output])
    assert [float(read(point, 7)) for point in ((0, 0.1), (-1, 0.1), (0.25, 0.1))] == [0.1, 0.1, 0.6]
