"""What a plant does beside a step of a method, of plants of which it is known by hand."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import pytest
import sympy as sp

import hgogen as hg
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau
from hgogen.prove.method_error import StageDeviation
from hgogen.prove.plant_step import PlantStep

H = Fraction(1, 50)


def beside(tableau: Tableau, ranges: Sequence[tuple[float, float]], flow: Any, u: hg.Signal) -> StageDeviation:
    """Of a plant x' = flow(x, u), of which the first state is measured, whose input moves at up to 5."""
    x = [hg.Signal(f"x{i}", low=low, high=high) for i, (low, high) in enumerate(ranges)]
    plant = hg.System("plant", states=x, inputs=(u,), outputs=(hg.Signal("y"),), flow=flow(*x, u), output=[x[0]])
    return StageDeviation(PlantStep(hg.forms.triangular(plant), H, (Fraction(5),)), tableau)


def test_the_line_of_a_double_integrator_is_known_stage_by_stage() -> None:
    """h^2 u/4 has a second Taylor coefficient, h^3 u'/12 none; of the last, u'/6 and u'/4 are of any two u'."""
    u = hg.Signal("u", low=-1, high=1)
    line = beside(RK4, [(-4, 4), (-4, 4)], lambda x, v, u: [v, u], u).line(0)
    third = float(5 * H**3)
    assert list(map(float, line)) == pytest.approx([0, float(H**2) / 4, third / 12, third * (1 / 6 + 1 / 4)])


@pytest.mark.parametrize("sign", [1, -1])
def test_an_input_that_falls_or_rises_adds_to_how_the_plant_bends(sign: int) -> None:
    """x'' = u' - x', x' from 1 to 3 or from -3 to -1: 8 at most, half of which one step of Euler leaves."""
    u, ends = hg.Signal("u", low=min(3 * sign, 4 * sign), high=max(3 * sign, 4 * sign)), sorted((sign, 2 * sign))
    plant = beside(EULER, [(ends[0], ends[1])], lambda x, u: [u - x], u)
    assert list(map(float, plant.remainder())) == pytest.approx([4 * H])
    assert plant.plant.margins == (3 * H,)


def test_what_a_step_of_the_method_bends_is_in_the_remainder() -> None:
    """x' = sqrt(x) is a parabola, whose third Taylor coefficient is 0; that of a step by Heun's method is -1/16."""
    plant = beside(HEUN, [(1, 1.001)], lambda x, u: [sp.sqrt(x)], hg.Signal("u", low=-1, high=1))
    assert 0.95 * H**2 / 16 < float(plant.remainder()[0]) < 1.2 * H**2 / 16


@pytest.mark.parametrize("steep", [1, 3, 10])
def test_a_steep_tanh_has_a_remainder(steep: float) -> None:
    """Of a wide ball a quotient of exponentials holds everything; by its ends tanh is within -1 and 1."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-2, high=2)
    plant = hg.System("bend", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -sp.tanh(steep * x1)], output=[x1])
    left = StageDeviation(PlantStep(hg.forms.triangular(plant), Fraction(1, 1000), ()), RK4).remainder()
    # x2' = -tanh(s x1), x2'' = -s (1 - t^2) x2, ..: each derivative more is at most 8 (s x2) larger, with x1'' <= 1
    assert 0 < float(left[1]) < (8 * (1 + 2 * steep)) ** 4 * 1e-12


def test_cells_are_of_what_the_flow_reads() -> None:
    """x1' = u, which no state and no constant moves."""
    u = hg.Signal("u", low=-1, high=1)
    assert {str(x) for x in beside(RK4, [(-1, 1)], lambda x, u: [u], u).plant.read} == {"u"}
