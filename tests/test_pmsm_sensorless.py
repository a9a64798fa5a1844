"""Flux and speed of a permanent magnet motor from its currents: the determinants, standstill, and the filter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.model import load
from hgogen.run import native
from hgogen.trial import simulate, try_out

MODEL = load(Path(__file__).resolve().parents[1] / "models" / "pmsm_sensorless.py")
PLANT = MODEL.plant
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def determinant(last: int) -> sp.Expr:
    """Of y, y' and the second derivative of output `last`, by SymPy alone."""
    x, flow = list(PLANT.states), sp.Matrix(PLANT.flow)
    first = [sp.Matrix([h]).jacobian(x).dot(flow) for h in PLANT.output]
    second = sp.Matrix([first[last]]).jacobian(x).dot(flow)  # the derivatives of the voltages bring in no state
    return sp.expand(sp.Matrix([*PLANT.output, *first, second]).jacobian(x).det())


def test_the_determinants_are_those_of_the_docstring() -> None:
    i_a, i_b, f_a, f_b, w = PLANT.states
    L, c = (next(p for p in PLANT.parameters if p.name == name) for name in ("L", "c"))
    turning = f_b * i_a - f_a * i_b
    along_a = w * (f_a * w**2 + 2 * c * f_b * turning) / L**3
    along_b = w * (f_b * w**2 - 2 * c * f_a * turning) / L**3  # turned by 90 degrees: a -> b, b -> -a
    assert sp.expand(determinant(0) - along_a) == 0
    assert sp.expand(determinant(1) - along_b) == 0
    jet_determinant = hg.singularity(PLANT).jets[0].determinant
    assert sp.expand(jet_determinant - along_a) == 0 or sp.expand(jet_determinant + along_a) == 0
    seen = hg.observability(PLANT)
    assert (seen.rank, seen.n) == (5, 5)


def test_at_standstill_any_flux_gives_the_same_currents() -> None:
    """Zero speed and no voltage: the singular set w = 0 holds states that no time tells apart."""
    still = {"i_a": 0, "i_b": 0, "w": 0}
    trial = replace(MODEL.trials()[0], duration=0.1, inputs={"u_a": 0, "u_b": 0}, noise={}, settled=None)
    fluxes = ((0.1, 0.0), (-0.05, 0.08))
    truths = [simulate(PLANT, replace(trial, start={**still, "f_a": a, "f_b": b}), 1e-3) for a, b in fluxes]
    assert [tuple(truth.x[-1, 2:4]) for truth in truths] == list(fluxes)
    assert all(np.array_equal(truth.y, np.zeros_like(truth.y)) for truth in truths)


def test_no_block_triangular_form_holds_it() -> None:
    form = hg.forms.block_triangular(PLANT, align="cascade")
    structure = next(check for check in form.checks if check.id == "block_triangular.structure")
    assert structure.verdict is hg.Verdict.REFUTED
    assert "brings in f_b, w together" in str(structure.reason)


@pytest.mark.full
@needs_compiler
@pytest.mark.parametrize("name", ["riccati", "hamilton_jacobi"])
def test_the_filter_finds_flux_and_speed(name: str) -> None:
    """From the rest of the estimate (no flux, 20 rad/s) at 200 rad/s: 2% of the flux, 1% of the speed after a tenth of
    the run-up; no theorem, so the bounds are twice what was seen."""
    step = MODEL.step(name)
    (trajectory,) = try_out(step, MODEL.trials()[0], "c", seeds=(3,))
    late = np.abs(trajectory.error[trajectory.truth.t >= 0.2]).max(axis=0)
    assert late[2:4].max() < 0.02 * 0.1
    assert late[4] < 0.01 * 200
    assert "OUTSIDE_BOX" not in step.flags(np.bitwise_or.reduce(trajectory.status[200:]))
