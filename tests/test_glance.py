"""Outward-rounded intervals enclose every value on the box; what they cannot bound stays unbounded."""

import math
from fractions import Fraction

import pytest
import sympy as sp
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from hgogen.rigor.bounds import contains_zero, enclose, finite
from hgogen.rigor.box import EVERYTHING, box
from hgogen.signal import Signal

x, y, free = Signal("x", low=-1.5, high=2), Signal("y", low=0.1, high=3), Signal("free")
BOX = box((x, y, free))
_FUNCTIONS = (
    sp.sin,
    sp.cos,
    sp.tan,
    sp.atan,
    sp.asin,
    sp.acos,
    sp.sinh,
    sp.cosh,
    sp.tanh,
    sp.exp,
    sp.log,
    sp.Abs,
)


def _pair(function: type[sp.Expr], a: sp.Expr, b: sp.Expr) -> sp.Expr:
    try:
        return function(a, b)
    except ValueError:  # SymPy refuses to compare numbers such as asin(3)
        reject()


def _grow(inner: st.SearchStrategy[sp.Expr]) -> st.SearchStrategy[sp.Expr]:
    powers = st.sampled_from([-2, -1, 2, 3, sp.Rational(1, 2), sp.Rational(-3, 2), sp.Rational(4, 3)])
    return st.one_of(
        st.builds(lambda a, b: a + b, inner, inner),
        st.builds(lambda a, b: a * b, inner, inner),
        st.builds(sp.Pow, inner, powers),
        st.builds(lambda f, a: f(a), st.sampled_from(_FUNCTIONS), inner),
        st.builds(_pair, st.sampled_from([sp.Min, sp.Max, sp.atan2]), inner, inner),
    )


_LEAVES = st.sampled_from([x, y, sp.pi, sp.Float(0.1), sp.Rational(-7, 3), sp.Integer(2)])
_POINTS = st.fractions(0, 1, max_denominator=50)


@pytest.mark.full
@settings(deadline=None, max_examples=200)
@given(st.recursive(_LEAVES, _grow, max_leaves=5), _POINTS, _POINTS)
def test_every_value_on_the_box_lies_in_the_enclosure(expression: sp.Expr, s: Fraction, t: Fraction) -> None:
    point = {x: sp.Rational(-3, 2) + sp.Rational(7, 2) * s, y: sp.Rational(1, 10) + sp.Rational(29, 10) * t}
    try:
        value, *parts = (node.xreplace(point).evalf(30) for node in sp.preorder_traversal(expression))
    except ValueError:
        reject()
    if not value.is_Float or not abs(value) < sp.Float("1e300") or any(part.is_real is False for part in parts):
        return  # not defined, not real, or beyond what evalf resolves
    low, high = enclose(expression, BOX)
    slack = sp.Rational(1, 10**20) * (1 + abs(value))  # evalf rounds the 30th digit, Float(0.1) the 17th
    if expression.has(sp.Float):
        slack = sp.Rational(1, 10**10) * (1 + abs(value))
    assert math.isinf(low) or sp.Rational(low) <= value + slack
    assert math.isinf(high) or sp.Rational(high) >= value - slack


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (x, (Fraction(-3, 2), Fraction(2))),
        (sp.Float(0.1) * y, (Fraction(1, 100), Fraction(3, 10))),
        (x**2, (0, 4)),
        (x**3, (Fraction(-27, 8), 8)),
        (1 / y, (Fraction(1, 3), 10)),
        (1 / x, EVERYTHING),
        (1 / x**2, (Fraction(1, 4), math.inf)),
        (0 * free, (0, 0)),
        (free**2 + 1, (1, math.inf)),
        (1 / (free**2 + 1), (0, 1)),
        (sp.sin(free) + 2, (1, 3)),
        (sp.Abs(x), (0, 2)),
        (sp.Max(x, y), (Fraction(1, 10), 3)),
        (sp.tan(3 * x / 4), (math.tan(-9 / 8), math.tan(3 / 2))),
        (sp.tan(x), EVERYTHING),
        (sp.gamma(x), EVERYTHING),
        (sp.Piecewise((x, x > 0), (y, True)), (-1.5, 3)),
        (sp.log(x), (-math.inf, math.log(2))),
        (sp.sqrt(x), (0, math.sqrt(2))),
        (y**10_000, (0, math.inf)),
    ],
)
def test_known_ranges(expression: sp.Expr, expected: tuple[Fraction | float, Fraction | float]) -> None:
    """Outward, by an ulp or two; exact where floats are."""
    low, high = enclose(expression, BOX)
    if all(isinstance(end, Fraction | int) for end in expected):
        assert low <= expected[0]
        assert high >= expected[1]
    assert (float(low), float(high)) == pytest.approx((float(expected[0]), float(expected[1])), rel=1e-15)


def test_exponentials_stay_positive_and_finite_on_a_bounded_box() -> None:
    low, high = enclose(sp.exp(-3 * x), BOX)
    assert 0 < low <= Fraction(math.exp(-6.0))
    assert Fraction(math.exp(4.5)) <= high < math.inf
    low, high = enclose(2 * sp.exp(400 * y) / 3 + 1, {y: (Fraction(0), Fraction(2))})
    assert 1.666 < low <= Fraction(5, 3)
    assert high == math.inf  # finite, but beyond all floats
    assert enclose(sp.exp(10_000 * x), BOX) == (0, math.inf)


def test_predicates() -> None:
    assert contains_zero((Fraction(-1), Fraction(0)))
    assert not contains_zero((Fraction(1), math.inf))
    assert finite((Fraction(0), Fraction(1)))
    assert not finite((Fraction(0), math.inf))
