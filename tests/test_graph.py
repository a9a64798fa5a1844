"""The door to CasADi keeps the meaning of every expression, and says which function it does not know."""

import casadi as ca
import mpmath
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from hgogen.graph import NoGraph, to_casadi
from hgogen.signal import Signal

x, y, u = Signal("x"), Signal("y"), Signal("u")
SYMBOLS = {s: ca.SX.sym(s.name) for s in (x, y, u)}

NEARLY = sp.exp(sp.pi * sp.sqrt(163)) - 262537412640768744  # -7.4992740280181e-13, by 50 digits


def test_a_constant_is_that_of_its_digits() -> None:
    """In doubles the difference is 0 or some 100: of 2.6e17 the last bit is 32."""
    (graph,) = to_casadi([NEARLY * x], {x: SYMBOLS[x]})
    assert float(ca.Function("f", [SYMBOLS[x]], [graph])(1)) == pytest.approx(-7.4992740280181e-13, rel=1e-12)


# Each is defined and well conditioned for x, y in [.2, .9] and u in [-2, 2].
EXPRESSIONS = [
    sp.Integer(3),
    sp.pi * x,
    sp.Rational(1, 3) * x - y + u,
    -x * y / (3 * u**2 + 1),
    x - x**3 / 3 - y * u,
    (x + y) ** 7,
    (x + 2) ** -3,
    1 / x,
    sp.sqrt(x) + 1 / sp.sqrt(y),
    x ** sp.Rational(5, 2) / y ** sp.Rational(3, 2),
    x ** sp.Rational(1, 3),
    x**y,
    2**u,
    sp.exp(-u) * sp.exp(2) / (1 + sp.exp(-x)),
    sp.sin(u) + sp.cos(u) * sp.tan(x),
    sp.asin(x) + sp.acos(y) + sp.atan(u) + sp.atan2(u, y),
    sp.sinh(u) + sp.cosh(u) + sp.tanh(u),
    sp.asinh(u) + sp.acosh(1 + x) + sp.atanh(y),
    sp.log(x * y + 1),
    sp.Abs(u) + sp.sign(u) * x + sp.floor(u),
    sp.Min(x, y, u) + 2 * sp.Max(u, x, y),
    sp.Piecewise((x, u < 0), (y, u <= 1), (x + y, True)),
    sp.Piecewise((x, sp.And(u > -1, u < 1)), (y, sp.Or(u >= sp.Rational(3, 2), sp.Ne(u, 0))), (u, True)),
    sp.Piecewise((x, sp.Not(sp.And(u > -1, x < y))), (y, True)),
]


@given(st.sampled_from(EXPRESSIONS), st.floats(0.2, 0.9), st.floats(0.2, 0.9), st.floats(-2, 2))
def test_graph_means_what_the_expression_means(expression: sp.Expr, x_: float, y_: float, u_: float) -> None:
    graph = ca.Function("f", list(SYMBOLS.values()), to_casadi([expression], SYMBOLS))
    with mpmath.workdps(40):
        exact = sp.lambdify((x, y, u), expression, "mpmath")(*map(mpmath.mpf, (x_, y_, u_)))
    # At most 20 operations, each within 2 units of 2^-53, on terms at most 8 times the result: under 5e-14.
    assert float(graph(x_, y_, u_)) == pytest.approx(float(exact), rel=5e-14, abs=5e-14)


def test_numbers_multiply_and_never_divide() -> None:
    (graph,) = to_casadi([x / 3 - 2 * y / 7 + x**4 / 5], SYMBOLS)
    function = ca.Function("f", [SYMBOLS[x], SYMBOLS[y]], [graph])
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    assert used.isdisjoint({ca.OP_DIV, ca.OP_INV, ca.OP_POW, ca.OP_CONSTPOW})
    assert ca.OP_SUB in used


def test_a_number_in_place_of_a_symbol_is_folded() -> None:
    (graph,) = to_casadi([x / y + sp.sin(y)], {x: SYMBOLS[x], y: 0.5})
    assert ca.symvar(graph)[0].name() == "x"
    assert len(ca.symvar(graph)) == 1
    (infinite,) = to_casadi([x / y], {x: SYMBOLS[x], y: 0.0})
    assert infinite.shape == (1, 1)


def test_a_shared_subexpression_is_built_once() -> None:
    graphs = to_casadi([sp.sin(x) + 1, 2 * sp.sin(x)], SYMBOLS)
    function = ca.Function("f", [SYMBOLS[x]], graphs)
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    assert codes.count(ca.OP_SIN) == 1


@pytest.mark.parametrize(
    ("expression", "term"),
    [
        (x + sp.gamma(y), "gamma(y)"),
        (sp.Function("h")(x, u) * y, "h(x, u)"),
        (sp.erf(x), "erf(x)"),
        (sp.Derivative(sp.Function("h")(x), x), "Derivative"),
    ],
)
def test_an_unknown_function_is_named_with_those_that_are_known(expression: sp.Expr, term: str) -> None:
    with pytest.raises(NoGraph) as caught:
        to_casadi([expression], SYMBOLS)
    assert term in str(caught.value)
    assert f"in {expression} cannot become a graph" in str(caught.value)
    assert "Abs, Heaviside, Max, Min" in str(caught.value)


def test_an_undeclared_symbol_is_named() -> None:
    with pytest.raises(NoGraph, match=r"the symbol k in x\*k cannot become a graph"):
        to_casadi([sp.Symbol("k") * x], SYMBOLS)
