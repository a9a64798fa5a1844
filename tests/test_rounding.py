"""The analysis of rounding errors itself, against exact arithmetic and 30 digits."""

from fractions import Fraction
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
import rounding

FRACTIONS = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_NEG: lambda a: -a,
    ca.OP_FABS: abs,
    ca.OP_FMIN: min,
    ca.OP_FMAX: max,
}


def exactly(graph: Any, arguments: list[Fraction]) -> Fraction:
    """The value of a graph of scalars in exact arithmetic, constants unrounded."""
    slots: dict[int, Fraction] = {}
    for k in range(graph.n_instructions()):
        op, take, give = graph.instruction_id(k), graph.instruction_input(k), graph.instruction_output(k)
        if op == ca.OP_OUTPUT:
            return slots[take[0]]
        if op == ca.OP_INPUT:
            slots[give[0]] = arguments[take[0]]
        elif op == ca.OP_CONST:
            slots[give[0]] = Fraction(graph.instruction_constant(k))
        else:
            slots[give[0]] = FRACTIONS[op](*(slots[i] for i in take))
    raise AssertionError("no output")


def test_rounding_bound_holds_against_exact_arithmetic() -> None:
    """Sums that cancel, quotients, constants that are no floats, values on either side of a minimum."""
    a, b, c = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c")
    difference = (a + b) * c - a * c
    value = ca.fmin(difference**2 + 0.1 / b, ca.fmax(0.3 * ca.fabs(a - c), 2 * a)) - 1 / (1.7 + c * c) + (-b)
    graph, rng = ca.Function("f", [a, b, c], [value]), np.random.default_rng(0)
    shares = []
    for _ in range(300):
        values = rng.normal(size=3).astype(np.float32)
        result = rounding.run(graph, [[v] for v in values])[0][0]
        error = abs(Fraction(float(result.value)) - exactly(graph, [Fraction(float(v)) for v in values]))
        assert error <= Fraction(result.error)
        shares.append(float(error) / result.error)
    assert max(shares) > 0.1


@pytest.mark.parametrize("name", ["sin", "cos", "exp"])
def test_rounding_bound_of_functions(name: str) -> None:
    """From an argument that has an error of its own, a product, against 30 digits."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    graph, rng = ca.Function("f", [a, b], [getattr(ca, name)(a * b)]), np.random.default_rng(0)
    with mpmath.workdps(30):
        for _ in range(300):
            values = rng.uniform(-3, 3, 2).astype(np.float32)
            result = rounding.run(graph, [[v] for v in values])[0][0]
            true = getattr(mpmath, name)(mpmath.mpf(float(values[0])) * mpmath.mpf(float(values[1])))
            assert abs(mpmath.mpf(float(result.value)) - true) <= result.error
            assert result.error < 1e-5 * max(1.0, float(abs(true)))


def test_a_comparison_that_rounding_can_turn_is_uncertain() -> None:
    """0.1 (1 + x) against 0.1 + 0.1 x: equal, but each rounded in its own way."""
    x = ca.SX.sym("x")
    graph = ca.Function("f", [x], [ca.if_else(0.1 * (1 + x) < 0.1 + 0.1 * x, 1.0, 2.0)])
    with pytest.raises(rounding.Uncertain):
        rounding.run(graph, [[np.float32(0.7)]])
    sure = ca.Function("f", [x], [ca.if_else(0.1 * (1 + x) < 0.2 + 0.1 * x, 1.0, 2.0)])
    assert rounding.run(sure, [[np.float32(0.7)]])[0][0].value == 1.0
