"""The slope of a form whose b is read at x = Psi(z), in the plant's ranges: the model's, also where x is clamped.

Of a linear plant phi is the same function of z on the whole space, so its slope is what the form read directly has.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics
from hgogen.check import Verdict
from hgogen.estimators.riccati_part import Riccati
from hgogen.theorem import rows


@cache
def linear(decay: float, recovered: bool) -> hg.Form:
    """x1' = x2 + u, x2' = x1 - decay x2, y = x1: z = (x1, x2 + u), phi = z_1 - decay (z_2 - u) + u'."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    u = hg.Signal("u", low=-5, high=5, rates=((-1, 1),))
    flow = [x2 + u, x1 - sp.Rational(decay) * x2]
    plant = hg.System("linear", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    return hg.forms.phase(plant, recovered=recovered)


@cache
def bilinear() -> hg.Form:
    """Three states, and no order of rows and columns in which dPhi/dx is triangular; its determinant is 4 - x1."""
    x1, x2, x3 = x = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2, 3))
    flow = [2 * x2 + x3, x3, x1 * x2]
    plant = hg.System("bilinear", states=x, outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    return hg.forms.phase(plant, recovered=True)


@cache
def bioreactor() -> hg.Form:
    """Contois growth: s = z_1 (z_2 + u z_1)/(z_1 - z_2 - u z_1), whose poles cross the box of z."""
    m, s = hg.Signal("m", low=0.01, high=0.2), hg.Signal("s", low=0, high=0.2)
    u, growth = hg.Signal("u", low=0, high=0.2, rates=((-1, 1),)), m * s / (m + s)
    flow = [growth - u * m, -growth + u * (sp.Rational(1, 10) - s)]
    plant = hg.System("bioreactor", states=(m, s), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[m])
    return hg.forms.phase(plant, recovered=True)


def graphs(form: hg.Form) -> ca.Function:
    """(z, u) to the Jacobian, the slope of the flow through its clamps, and x."""
    dynamics = Dynamics(form)
    z, u = ca.SX.sym("z", form.n), ca.SX.sym("u", len(form.system.inputs))
    x, _ = dynamics.recovered(z, u)
    return ca.Function("J", [z, u], [dynamics.jacobian(z, u), ca.jacobian(dynamics.flow(z, u), z), x])


def expected(form: hg.Form, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """d phi/dx (dPhi/dx)^-1 at x, in 30 digits."""
    assert form.behind is not None
    values = zip((*form.system.states, *form.system.inputs), (*x, *u), strict=True)
    at = {s: sp.Float(float(value), 30) for s, value in values}
    steep, map_ = (sp.Matrix([*row]).jacobian(form.system.states).subs(at) for row in (form.behind, form.to_form))
    return np.array((steep * map_.inv())[-1, :], float)[0]


def test_the_slope_at_a_clamped_state_is_the_models() -> None:
    """At z = (0, 4) x2 = 4 is beyond its range: dphi/dz_2 is -3, not 0."""
    slopes = [np.array(graphs(linear(3, recovered))([0, 4], [0, 0])[0]) for recovered in (False, True)]
    assert slopes[1] == pytest.approx(np.array([[0, 1], [1, -3]]), abs=1e-15)
    assert slopes[1] == pytest.approx(slopes[0], abs=1e-15)


@pytest.mark.ordinary("bilinear")
@pytest.mark.parametrize("make", [bilinear, bioreactor])
def test_it_is_that_of_the_map_on_the_whole_box_of_z(make: Callable[[], hg.Form]) -> None:
    """60 points of the box and beyond it; where no state is clamped it is the slope of the flow itself. Against 30
    digits: dPhi/dx, of condition below 1e4, costs 4 digits of 16."""
    form = make()
    graph, rng, clamped = graphs(form), np.random.default_rng(1), 0
    low, high = np.array([s.interval for s in form.states]).T
    ends = np.array([s.interval for s in form.system.states])
    u = np.array([0.3 * s.interval[1] for s in form.system.inputs])
    for place in low + (high - low) * rng.uniform(-0.1, 1.1, (60, form.n)):
        J, through, x = (np.array(v) for v in graph(place, u))
        model = expected(form, x[:, 0], u)
        close_to_model = pytest.approx(model, rel=1e-11, abs=1e-11 * np.abs(model).max())
        assert J[-1] == close_to_model
        if ((low < place) & (place < high)).all() and ((ends[:, :1] < x) & (x < ends[:, 1:])).all():
            assert through[-1] == close_to_model
        else:
            clamped += 1
    assert 20 < clamped < 60


@pytest.mark.full
def test_at_a_pole_of_the_inverse_it_is_that_at_the_end_that_the_pole_is_past() -> None:
    """Where z_1 = z_2 + u z_1, exactly in floats: dPsi/dz has a pole, dPhi/dx has an inverse."""
    form, u = bioreactor(), np.array([0.125, 0.0])
    graph = graphs(form)
    for place in ([0.0625, 0.0546875], [0.03125, 0.02734375]):
        J, _, x = (np.array(v) for v in graph(place, u))
        assert x[:, 0] == pytest.approx([place[0], 0.2])
        assert np.isfinite(J).all()
        assert J[-1] == pytest.approx(expected(form, x[:, 0], u), rel=1e-11)


def test_the_updated_gain_rises_where_the_estimate_peaks() -> None:
    """While x2 is clamped, as while the model is read directly: L at 0.02 s and 0.05 s of y = 0.9."""
    gains: dict[str, Any] = {"p_1": 0.15, "p_2": 5, "p_3": 6, "cap": 2000, "poles": (-1, -1), "b": 1}
    traces = []
    for recovered in (False, True):
        step = hg.sample(hg.observers.updated_gain(linear(30, recovered), **gains), hg.methods.rk4, dt=1e-4)
        traces.append(step.run(u=np.zeros((501, 2)), y=np.full((501, 1), 0.9), engine="python").traces["L"])
    assert traces[0][[200, 500]] == pytest.approx([161.5, 1171.6], abs=0.05)
    assert traces[1] == pytest.approx(traces[0], rel=1e-9)


@pytest.mark.parametrize("name", ["riccati", "hamilton_jacobi"])
def test_a_covariance_moves_by_the_model_where_a_state_is_clamped(name: str) -> None:
    """F of the recovered form, an estimate far beyond the range of x2, is that of the direct one."""
    build = {"riccati": {"covariance": (1, 1)}, "hamilton_jacobi": {"P0": (1, 1)}}[name]
    shown = []
    for recovered in (False, True):
        observer = getattr(hg.observers, name)(linear(3, recovered), Q=(1, 1), R=1, **build)
        (part,) = (part for part in observer.parts if isinstance(part, Riccati))
        z, u = ca.SX.sym("z", 2), ca.SX.sym("u", 2)
        F = part.jacobian(z, u, ca.SX.sym("y"), ca.SX(1))
        shown.append(np.array(ca.Function("F", [z, u], [F])([0, 4], [0, 0])))
    assert shown[1] == pytest.approx(shown[0], abs=1e-15)


def test_what_a_clamp_may_leave_of_the_slope_is_said() -> None:
    gains: dict[str, Any] = {"p_1": 0.15, "p_2": 5, "p_3": 6, "cap": 2000, "poles": (-1, -1)}
    claims = []
    for recovered in (False, True):
        observer = hg.observers.updated_gain(linear(3, recovered), **gains)
        claims.append({row.claim: row.verdict for row in rows(observer.theorem, observer.checks)})
    assert not any("clamped" in claim for claim in claims[0])
    (more,) = (claim for claim in claims[1] if "clamped" in claim)
    assert claims[1][more] is Verdict.UNKNOWN
