"""Routines: parts of a graph that emitted code keeps as functions."""

import re
from functools import cache

import casadi as ca
import emitted
import numpy as np
import pytest

import hgogen as hg
from hgogen.discretisation.runge_kutta import Routine, routine
from hgogen.emit.node import Subprogram, _distinct, subprograms
from hgogen.graph import Graph
from hgogen.program import Block, Place, sym, walk
from hgogen.rigor.lookup import called, instructions

Z, U = ca.SX.sym("z", 3), ca.SX.sym("u")


@cache
def made() -> Graph:
    """The results of a call, one after the other: of a column with a number in it, and of a matrix with one."""
    gain = sym("gain", "theta")

    def body(at: dict[str, Graph]) -> dict[str, Graph]:
        z, u = at["z"], at["u"]
        slopes = ca.vertcat(gain * z[1], u * u, 0)
        return {"dz": slopes, "F": ca.sparsify(ca.blockcat([[0, gain], [ca.sin(z[0]), -0.5]])), "E": ca.SX.eye(2)}

    results = routine("flow", {"z": 3, "u": 1, "y": 2}, body)({"z": Z + 1, "u": 2 * U, "y": ca.SX(2, 1)})
    return ca.vertcat(results["dz"], ca.vec(ca.densify(results["F"])), ca.vec(ca.densify(results["E"])))


def test_a_call_computes_what_its_body_says() -> None:
    theta, z, u = 3.0, np.array([0.2, 0.5, 9.0]), 0.7
    values = ca.Function("values", [Z, U, sym("gain", "theta")], [made()])(z, u, theta).full().ravel()
    wanted = [theta * 1.5, 1.4 * 1.4, 0, 0, np.sin(1.2), theta, -0.5, 1, 0, 0, 1]
    assert values == pytest.approx(wanted, rel=1e-15)


def test_a_number_stays_a_number() -> None:
    assert [k for k in range(made().numel()) if made()[k].is_constant()] == [2, 3, 6, 7, 8, 9, 10]


def test_it_is_given_what_it_reads_and_computes_what_moves() -> None:
    graph = ca.Function("values", [Z, U, sym("gain", "theta")], [made()])
    (inner,) = (called(each) for each in instructions(graph) if each.is_call())
    assert isinstance(inner, ca.Function)
    flow = Routine(inner)
    assert [(each.name, each.size, each.place) for each in flow.arguments] == [
        ("z", 3, None),
        ("u", 1, None),
        ("place0", 1, Place("gain", "theta")),
    ]
    assert flow.results == (("dz", 2), ("F", 2))
    assert [flow.elements(k) for k in range(3)] == [(0, 1), (0,), (0,)]
    assert [flow.entries(k) for k in range(2)] == [["", ""], ["F_21", "F_12"]]


def routines(name: str) -> list[Subprogram]:
    return list(subprograms(emitted.step(name)).values())


def test_few_numbers_that_are_read_are_passed_by_value_and_many_as_arrays() -> None:
    flow, jacobian = routines("fitzhugh_nagumo")
    assert [each.names for each in flow.passed] == [["z1", "z2", "z3"], ["u"]]
    assert [each.names for each in jacobian.passed] == [["z1"], ["u"]]
    flow, *_ = routines("many_states")
    assert [each.names for each in flow.passed if each.argument.name == "z"] == [["z"]]


def test_parameters_are_read_where_they_lie() -> None:
    (rate,) = routines("pendulum")
    assert rate.reads_parameters
    assert {each.argument.name for each in rate.passed} == {"z", "u", "y", "valid"}


def test_routines_of_one_name_are_numbered() -> None:
    functions = [ca.Function(name, [Z], [Z]) for name in ("flow", "rate", "flow", "flow")]
    assert _distinct({str(k): Routine(each) for k, each in enumerate(functions)}) == [
        "flow",
        "rate",
        "flow_2",
        "flow_3",
    ]


@pytest.mark.parametrize("name", ["pendulum", "fitzhugh_nagumo"])
def test_the_model_stands_once_in_its_c(name: str) -> None:
    """A sine that each stage of the Runge-Kutta step computes is written once in the flow."""
    text = hg.targets.c99(emitted.step(name), check=False)[f"{emitted.step(name).name}.c"]
    body = text.partition("#endif\n\n/* the ")[2]
    assert len(re.findall(r"_sin\(", body)) == 1


def test_the_same_flow_of_filter_and_predictors_is_one_function() -> None:
    step = emitted.step("fitzhugh_nagumo")
    blocks = [s for section in step.code.called for s in walk(section.program) if isinstance(s, Block)]
    calls = [each for block in blocks for each in instructions(block.graph) if each.is_call()]
    assert len(calls) == 4 + 1 + 2  # of the stages, of F, and of the predictors in their loop
    assert [each.name for each in subprograms(step).values()] == ["flow", "jacobian"]
