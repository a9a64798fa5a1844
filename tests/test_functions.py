"""Functions of a plant beyond the elementary ones: built as SymPy means them, or refused where it is declared."""

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.graph import to_casadi
from hgogen.reading.expression import BadExpression, parse
from hgogen.system import BadSystem

x, y = hg.Signal("x", low=-3, high=3), hg.Signal("y")


def plant(rate: sp.Expr) -> hg.System:
    return hg.System("p", states=(x,), outputs=(y,), flow=[rate - x], output=[x])


@pytest.mark.ordinary(
    "Heaviside(x - 1)", "Heaviside(x - 1, 0)", "Heaviside(x - 1, 1)", "Heaviside(x - 1, 1/4)", "Mod(x, -7/5)"
)
@pytest.mark.parametrize(
    "function",
    [
        sp.Heaviside(x - 1),
        sp.Heaviside(x - 1, 0),
        sp.Heaviside(x - 1, 1),
        sp.Heaviside(x - 1, sp.Rational(1, 4)),
        sp.ceiling(x),
        sp.Mod(x, sp.Rational(7, 5)),
        sp.Mod(x, -sp.Rational(7, 5)),
        sp.frac(x),
    ],
    ids=str,
)
def test_they_are_what_sympy_has(function: sp.Expr) -> None:
    """At exact binary numbers, the jumps among them, to the rounding of one operation or two."""
    import casadi as ca

    symbol = ca.SX.sym("x")
    (graph,) = to_casadi(plant(function).flow, {x: symbol})
    numbers = np.arange(-12, 13) / 4
    values = np.array(ca.Function("f", [symbol], [graph])(numbers[None])).ravel()
    wanted = [float((function - x).subs(x, sp.Rational(n))) for n in numbers]
    assert np.abs(values - wanted).max() < 1e-14
    observer = hg.observers.riccati(hg.forms.original(plant(function)), Q=(1,), R=1)
    assert hg.sample(observer, dt=0.01).run(y=[0.5] * 10, engine="python").x.shape == (10, 1)


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (
            sp.erf(x),
            r"flow 1: there is no rule for erf\(x\); give its values on the declared range as a table, or take",
        ),
        (sp.gamma(x + 5), r"gamma\(x \+ 5\); give its values on the declared range as a table"),
        (sp.besselj(0, x), "no rule for besselj.*or as a table"),
        (sp.Function("f")(x), r"no rule for f\(x\)"),
        (sp.Integral(sp.sin(x**2), (x, 0, 1)) * sp.erf(x), "make an integral a state"),
    ],
    ids=["erf", "gamma", "bessel", "unknown", "integral"],
)
def test_others_are_refused_where_the_plant_is_declared(function: sp.Expr, says: str) -> None:
    with pytest.raises(BadSystem, match=says):
        plant(function)


def test_the_way_out_of_erf_is_as_near_as_it_says() -> None:
    from scipy.special import erf

    t = np.linspace(-6, 6, 10_001)
    assert np.abs(erf(t) - np.tanh(2 * t / np.sqrt(np.pi))).max() < 0.04


def test_plain_text_says_what_to_write_instead() -> None:
    assert parse("x - 2*floor(x/2)", {"x": x}) == x - 2 * sp.floor(x / 2)
    for text, says in (("Mod(x, 2)", "write x - p\\*floor"), ("gamma(x)", "as a table"), ("cosinus(x)", "cos")):
        with pytest.raises(BadExpression, match=says):
            parse(text, {"x": x})
