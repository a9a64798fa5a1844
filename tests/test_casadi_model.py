"""Models declared in CasADi: SymPy to CasADi to SymPy, exactly and in numbers, and what is refused."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.graph import NoSymbols, to_casadi, to_sympy
from hgogen.reading.declared import BadGraph, from_casadi

q, w, tau, y = (hg.Signal(name) for name in ("q", "w", "tau", "y"))
g = hg.Signal("g", nominal=9.81)
R = sp.Rational

EXACT = [
    q + 2 * w - q * w / 4,
    -(q**2) + q**3 - 1 / w,
    sp.sqrt(w),
    sp.sin(q) + sp.cos(q) * sp.tan(w) + sp.asin(q) - sp.acos(q) + sp.atan(q),
    sp.sinh(q) + sp.cosh(q) * sp.tanh(w) + sp.asinh(q) - sp.acosh(w) + sp.atanh(q),
    sp.exp(q) * sp.log(w) + sp.atan2(q, w),
    sp.Abs(q) + sp.sign(q) + sp.floor(w),
    sp.Min(q, w) + sp.Max(q, 1),
    sp.Piecewise((q, q < w), (w, True)),
    sp.Piecewise((q, (q <= w) & (w < 1)), (w, True)),
    w**q,
    R(1, 10) * q,
]


def back(expression: sp.Expr) -> sp.Expr:
    x = ca.SX.sym("x", 2)
    graph = to_casadi([expression], {q: x[0], w: x[1]})
    return to_sympy(ca.Function("f", [x], graph), [(q, w)])[0][0]


@pytest.mark.parametrize("expression", EXACT, ids=str)
def test_there_and_back(expression: sp.Expr) -> None:
    """The same function at every point, and the same expression where CasADi keeps its numbers."""
    again = back(expression)
    assert again.equals(expression) or again == expression
    one, other = (sp.lambdify((q, w), e) for e in (expression, again))
    points = np.random.default_rng(0).uniform(0.1, 0.9, (20, 2))
    if expression.has(sp.acosh):
        points[:, 1] += 1
    for point in points:
        assert np.isclose(float(one(*point)), float(other(*point)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_a_plant_is_the_one_sympy_would_give(kind: Any) -> None:
    x, u, p = kind.sym("x", 2), kind.sym("u"), kind.sym("p")
    plant = from_casadi(
        "pendulum",
        states=[(x, (q, w))],
        inputs=[(u, tau)],
        parameters=[(p, g)],
        outputs=[y],
        flow=ca.vertcat(x[1], -p * ca.sin(x[0]) - 0.1 * x[1] + u),
        output=x[0],
    )
    same = hg.System(
        "pendulum",
        states=(q, w),
        inputs=(tau,),
        outputs=(y,),
        parameters=(g,),
        flow=[w, -g * sp.sin(q) - w / 10 + tau],
        output=[q],
    )
    assert plant == same


X, U = ca.SX.sym("x"), ca.SX.sym("u")
FINE: dict[str, Any] = {"states": [(X, q)], "inputs": [(U, tau)], "outputs": [y], "flow": U - X, "output": X}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"flow": ca.SX.sym("z")}, "flow uses z, which is not declared; pair that symbol with a Signal"),
        ({"flow": ca.SX.sym("x")}, "flow uses x, which is another symbol of that name"),
        ({"flow": "x"}, "flow is of type str; give a CasADi graph"),
        ({"flow": ca.horzcat(X, U)}, "flow has the shape (1, 2); make it a column"),
        ({"states": [X]}, "states holds x, no pair"),
        ({"states": [(X + 1, q)]}, "no CasADi symbol"),
        ({"states": [(X, (q, w))]}, "has 1 entries; give a Signal for each"),
        ({"inputs": [(X, tau)], "flow": X}, "declare it in SX, each symbol once"),
    ],
)
def test_a_refusal_names_the_part(change: dict[str, Any], words: str) -> None:
    assert from_casadi("fine", **FINE).flow == (tau - q,)
    with pytest.raises(BadGraph) as caught:
        from_casadi("bad", **{**FINE, **change})
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("graph", "words"),
    [(ca.erf(X), "CasADi's erf has no"), (ca.fmod(X, 2), "CasADi's fmod has no"), (X + np.inf, "constant inf has no")],
)
def test_what_has_no_expression_is_refused(graph: Any, words: str) -> None:
    with pytest.raises(NoSymbols) as caught:
        from_casadi("bad", **{**FINE, "flow": graph})
    assert words in str(caught.value)
