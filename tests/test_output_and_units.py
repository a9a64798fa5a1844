"""Outputs that depend on the input or are not linear, and units: what a filter must not depend on."""

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.program import Block, Place, dangling, sym
from hgogen.run import native

SAMPLES = 400
THETAS = {
    "kalman": 1.0,
    "staggered": hg.theta.adaptive(3, mu=(0.1, 0.2), innovation=hg.innovation.staggered(0.4)),
    "window": hg.theta.adaptive(3, mu=(0.1, 0.2), innovation=hg.innovation.window(0.4)),
}
x1, x2 = hg.Signal("x1", low=-5, high=5), hg.Signal("x2", low=-5, high=5)
u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-20, high=20)


@pytest.mark.ordinary("kalman-u + x1", "staggered-u + x1", "window-x1*(u + 2)")
@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("output", [(2 + u) * x1, x1 + u], ids=str)
@pytest.mark.parametrize("theta", THETAS)
def test_the_input_in_the_output_is_the_same_in_c(output: sp.Expr, theta: str) -> None:
    plant = hg.System("pendulum", states=(x1, x2), inputs=(u,), outputs=(y,), flow=[x2, -sp.sin(x1)], output=[output])
    observer = hg.observers.riccati(
        hg.forms.triangular(plant), Q=(0.1, 0.1), R=0.01, theta=THETAS[theta], initial=(3, 0)
    )
    step = hg.sample(observer, dt=0.01)
    drive = np.sin(np.arange(SAMPLES) * 0.05)
    measured = np.array([float(output.subs({x1: sp.pi, u: v})) for v in drive])  # at rest, upside down
    compiled = step.run(u=drive, y=measured, engine="c")
    step.reset()
    read = step.run(u=drive, y=measured, engine="python")
    assert np.abs(compiled.x - read.x).max() < 1e-12
    assert np.abs(read["x1"][-100:] - np.pi).max() < 0.01


def test_a_section_that_reads_what_another_wrote_is_found() -> None:
    block = Block("late", {Place("state", "z"): sym("work", "u")})
    assert dangling((block,)) == {Place("work", "u")}
    assert dangling((Block("early", {Place("work", "u"): sym("input", "u")}), block)) == set()


def rescaled(a: float, b: float) -> np.ndarray:
    """Estimates of one filter, x1 in units of a and x2 of b, back in the first units."""
    p, q, r = hg.Signal("p"), hg.Signal("q"), hg.Signal("r")
    plant = hg.System("scaled", states=(p, q), outputs=(r,), flow=[q * a / b, -sp.sin(p / a) * b - q], output=[p])
    observer = hg.observers.riccati(
        hg.forms.triangular(plant),
        Q=(0.1 * a**2, 0.1 * b**2),
        R=0.1 * a**2,
        covariance=(a**2, b**2),
    )
    run = hg.sample(observer, dt=0.01).run(y=a * np.sin(np.arange(SAMPLES) * 0.01), engine="python")
    assert not run.status.any()
    return np.asarray(run.x / [a, b])


@pytest.mark.parametrize("units", [(1e-6, 1e-6), (1e-9, 1e-9), (1e-6, 1e5), (1e8, 1e8)])
def test_units_do_not_change_the_filter(units: tuple[float, float]) -> None:
    """Scaling is by powers of ten, so each operation rounds anew: some hundred units in the last place."""
    assert np.abs(rescaled(*units) - rescaled(1, 1)).max() < 1e-12


@pytest.mark.parametrize("root", [sp.sqrt, sp.log])
def test_an_output_undefined_outside_its_range_does_not_lock_the_observer_out(root: sp.Function) -> None:
    z, r, v = hg.Signal("z", low=0.01, high=4), hg.Signal("r", low=-5, high=5), hg.Signal("v", low=-1, high=1)
    plant = hg.System("level", states=(z,), inputs=(v,), outputs=(r,), flow=[v], output=[root(z)])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1e-3], R=1e-3, initial=[3.9])
    run = hg.sample(observer, dt=0.1).run(u=np.zeros(3000), y=np.full(3000, float(root(0.04))), engine="python")
    assert run["z"][-1] == pytest.approx(0.04, rel=1e-3)


def test_the_covariance_may_be_as_large_as_its_weights_ask() -> None:
    """R = 1 with states within 1 is no variance, only a weight; no cap is reached while measurements come."""
    chain = [hg.Signal(f"c{i}", low=-1, high=1) for i in range(3)]
    plant = hg.System("chain", states=chain, inputs=(u,), outputs=(y,), flow=[chain[1], chain[2], u], output=[chain[0]])
    for theta in (3, 10, 30):
        observer = hg.observers.riccati(hg.forms.triangular(plant), Q=[1] * 3, R=1.0, theta=theta)
        assert not hg.sample(observer, dt=0.01).run(u=np.zeros(500), y=np.zeros(500), engine="python").status.any()


def test_the_step_length_is_judged_with_the_output_of_the_same_point() -> None:
    """y = u x1 on u in [-9, 11]: at u = 11 the gain is 11^2 times that in the middle, where dt = .01 would do."""
    wide = hg.Signal("w", low=-9, high=11)
    plant = hg.System("gained", states=(x1,), inputs=(wide,), outputs=(y,), flow=[-x1], output=[wide * x1])
    form = hg.forms.triangular(plant)
    observer = hg.observers.riccati(form, Q=[100.0], R=0.01, accept=("triangular.a_1",))
    with pytest.warns(hg.step.StepMayFail):
        hg.sample(observer, hg.methods.rk4_covariance, dt=0.01)
