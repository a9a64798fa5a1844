"""Which sines and cosines are taken for those of small angles."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.emit.elementary import SMALL
from hgogen.emit.small_angles import SMALL_COS, SMALL_SIN, operations

X = ca.SX.sym("x")
Y = ca.SX.sym("y")
POINTS = np.array([0.0, -0.0, 1.0, -3.7, 4.71, -1e3, 1e30, -1e30, np.inf, -np.inf, np.nan])


def clamp(value: Any, low: float, high: float) -> Any:
    return ca.fmin(ca.fmax(value, low), high)


def small(expression: Any) -> bool:
    """Whether its sine and its cosine are of a small angle: both or neither."""
    codes = [operations(ca.Function("f", [X, Y], [wave(expression)])) for wave in (ca.sin, ca.cos)]
    (of_sine, of_cosine) = (bool({SMALL_SIN, SMALL_COS} & {*each}) for each in codes)
    assert of_sine == of_cosine
    return of_sine


@pytest.mark.parametrize(
    ("expression", "answer"),
    [
        (X, False),
        (clamp(X, -4.7, 4.7), True),
        (clamp(X, -4.7, 4.71), False),
        (clamp(X, -4.71, 0.0), False),
        (ca.fmin(X, 1.0), False),
        (ca.fmax(ca.fmin(X, 1.0), -1.0), True),
        (2 * clamp(X, -2.3, 2.3), True),
        (2 * clamp(X, -2.4, 2.4), False),
        (clamp(X, -1.0, 1.0) * clamp(Y, -4.0, 3.0), True),
        (clamp(X, -1.0, 1.0) * Y, False),
        (clamp(X, -1.0, 1.0) + clamp(Y, 0.0, 3.0) - 0.5, True),
        (clamp(X, -1.0, 1.0) - clamp(Y, -4.0, 3.0), False),
        (-(clamp(X, 0.0, 2.0) ** 2), True),
        (-(clamp(X, 0.0, 2.2) ** 2), False),
        (4 * ca.sin(X) + 0.7 * ca.cos(Y), True),
        (4 * ca.sin(X) + 0.8 * ca.cos(Y), False),
        (ca.exp(clamp(X, 0.0, 1.0)), False),
        (ca.SX(3.0) * clamp(X, -1.0, 1.0) / 1.5, False),
    ],
)
def test_an_angle_is_small_where_what_it_is_made_of_is_bounded(expression: Any, answer: bool) -> None:
    assert small(expression) is answer


def expressions() -> st.SearchStrategy[Any]:
    ends = st.floats(-3.0, 3.0)
    leaves = st.one_of(st.sampled_from([X, Y]), ends.map(ca.SX))
    two = [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, ca.fmin, ca.fmax]

    def above(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.one_of(
            st.builds(lambda a, low, high: clamp(a, min(low, high), max(low, high)), inner, ends, ends),
            st.builds(lambda a, b, f: f(a, b), inner, inner, st.sampled_from(two)),
            st.builds(lambda a, f: f(a), inner, st.sampled_from([ca.sin, ca.cos, lambda a: -a, lambda a: a**2])),
        )

    return st.recursive(leaves, above, max_leaves=8)


@settings(max_examples=300, deadline=None)
@given(expressions())
def test_no_angle_that_is_taken_for_small_is_large(expression: Any) -> None:
    """At points beyond every clamp; the rounding of a dozen operations is below 1e-14."""
    if small(expression):
        x, y = np.meshgrid(POINTS, POINTS)
        angles = np.array(ca.Function("f", [X, Y], [expression]).map(x.size)(x.ravel(), y.ravel()))
        assert not np.any(np.abs(angles) > SMALL * (1 + 1e-14))
