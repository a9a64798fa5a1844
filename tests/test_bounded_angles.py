"""Which sines and cosines are taken for those of bounded angles."""

from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.emit.elementary import BOUNDED, SMALL
from hgogen.emit.node import BOUNDED_COS, BOUNDED_SIN, SMALL_COS, SMALL_SIN, operations
from hgogen.emit.pygraph import evaluated

X = ca.SX.sym("x")
Y = ca.SX.sym("y")
POINTS = (0.0, -0.0, 1.0, -3.7, 4.71, -1e3, 1e30, -1e30, np.inf, -np.inf, np.nan)


def clamp(value: Any, low: float, high: float) -> Any:
    return ca.fmin(ca.fmax(value, low), high)


def limit(expression: Any) -> float:
    """The limit of angles for which its sine and its cosine are taken."""
    limits = {SMALL_SIN: SMALL, SMALL_COS: SMALL, BOUNDED_SIN: BOUNDED, BOUNDED_COS: BOUNDED}
    sine, cosine = (operations(ca.Function("f", [X, Y], [wave(expression)])) for wave in (ca.sin, ca.cos))
    of_sine, of_cosine = (limits.get(each[-2], np.inf) for each in (sine, cosine))  # the last one is the output
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
        (clamp(X, -1.0, 1.0) / 2, True),
        (clamp(X, -1.0, 1.0) / clamp(Y, -2.0, -1.0), True),
        (clamp(X, -1.0, 1.0) / clamp(Y, 0.0, 2.0), False),
        (ca.fmin(ca.sin(X), 9), False),
        (ca.fmin(9, ca.sin(X)), True),
        (ca.fmax(ca.sin(clamp(X, -1.0, 1.0) - clamp(Y, 0.0, 1.0)), -9), False),
    ],
)
def test_an_angle_is_small_where_what_it_is_made_of_is_bounded(expression: Any, answer: bool) -> None:
    assert (limit(expression) == SMALL) is answer


def test_an_angle_may_be_bounded_and_not_small() -> None:
    assert limit(clamp(X, -100.0, 100.0)) == BOUNDED
    assert limit(clamp(X, -100.0, 100.1)) == np.inf
    assert limit(50 * clamp(X, -1.0, 2.0)) == BOUNDED


def test_an_output_before_it_changes_no_bound() -> None:
    """Which has a number of its own, as places of work have."""
    t = clamp(X, -1.0, 1.0)
    assert SMALL_SIN in operations(ca.Function("f", [X, Y], [Y - t * t, ca.sin(t)]))
    assert SMALL_SIN in operations(ca.Function("f", [X, Y], [ca.vertcat(t, Y * t), ca.sin(t) + Y]))


def expressions() -> st.SearchStrategy[Any]:
    ends = st.floats(-3.0, 3.0)
    leaves = st.one_of(st.sampled_from([X, Y]), ends.map(ca.SX))
    two = [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: 9 * a * b, ca.fmin, ca.fmax]

    def above(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.one_of(
            st.builds(lambda a, low, high: clamp(a, min(low, high), max(low, high)), inner, ends, ends),
            st.builds(lambda a, b, f: f(a, b), inner, inner, st.sampled_from(two)),
            st.builds(lambda a, f: f(a), inner, st.sampled_from([ca.sin, ca.cos, lambda a: -a, lambda a: a**2])),
        )

    return st.recursive(leaves, above, max_leaves=8)


@pytest.mark.full
@settings(max_examples=300, deadline=None)
@given(expressions())
def test_no_angle_that_is_taken_for_bounded_is_larger(expression: Any) -> None:
    """At points beyond every clamp, as emitted code computes them; a dozen roundings are below 1e-14."""
    angle = evaluated(ca.Function("f", [X, Y], [expression]), "double")
    for x, y in product(POINTS, POINTS):
        ((value,),) = angle([[x], [y]])
        assert not abs(value) > limit(expression) * (1 + 1e-14)
