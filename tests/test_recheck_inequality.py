"""The one inequality of the checker against its block form, by matrices of fractions, and which claims a rule takes."""

from contextlib import nullcontext
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.file import _claim
from hgogen.recheck.inequality import FLOW, NOW, ErrorMatrices, Input, demand_falls, demand_kept, form_of, method_of
from hgogen.recheck.matrix import Matrix
from hgogen.recheck.rules import rule_of

NONE = Fraction(0)


def rows(count: int, size: int) -> st.SearchStrategy[Any]:
    numbers = st.fractions(min_value=-5, max_value=5, max_denominator=8)
    return st.lists(st.lists(numbers, min_size=size, max_size=size), min_size=count, max_size=count)


@given(rows(2, 2), rows(2, 1), rows(1, 2), rows(2, 1), rows(2, 1), rows(1, 1), rows(2, 1))
def test_continuous_time_is_a_step_of_length_0(M: Any, G: Any, H: Any, B: Any, R: Any, E: Any, beside: Any) -> None:
    """[M'P + P M, P G, P D; G'P, -S, 0; D'P, 0, -lambda] + [H, 0, E]'S [H, 0, E],   D = [B + R, beside]."""
    P, s = [[Fraction(3), Fraction(1)], [Fraction(1), Fraction(2)]], Fraction(5, 2)
    lambdas = [Fraction(7), Fraction(11)]
    parts = ErrorMatrices(*map(Matrix, (M, G, H, M)), False, *map(Matrix, (B, R, E)))
    inputs = [Input(Matrix([[Fraction(1)]]), [NONE] * 2), Input(Matrix([[NONE]]), [each for (each,) in beside])]
    made = np.array(form_of(parts, FLOW, NOW, {"P": P, "S": [s, *lambdas]}, inputs).rows)
    D = np.hstack([np.array(B) + np.array(R), np.array(beside)])
    rates = np.hstack([np.array(M), np.array(G), D])
    reads = np.hstack([np.array(H), [[NONE]], np.array(E), [[NONE]]])
    half = np.vstack([np.array(P) @ rates, np.full((3, 5), NONE)])
    squares = np.diag([NONE, NONE, -s, *(-x for x in lambdas)])
    assert (made == half + half.T + s * reads.T @ reads + squares).all()


FALL, SHARE = Matrix([[Fraction(-1)]]), Matrix([[Fraction(1)]])
STILL = ErrorMatrices(FALL, Matrix([[]]), Matrix([], 1), FALL, False, SHARE, Matrix([[NONE]]), Matrix([], 1))
SAMPLE = Input(SHARE, [NONE])


SHOWN, NOT_NEGATIVE = nullcontext(), pytest.raises(Unproved, match="not negative")


@pytest.mark.parametrize(("alpha", "outcome"), [("1.99", SHOWN), ("2.01", NOT_NEGATIVE)])
def test_the_rate_is_that_of_the_square(alpha: str, outcome: Any) -> None:
    """e' = -e: |e|^2 falls by 2 of itself."""
    with outcome:
        demand_falls(STILL, FLOW, NOW, Fraction(alpha), {"P": [[Fraction(1)]], "S": []})


@pytest.mark.parametrize(("weight", "outcome"), [("0.99", SHOWN), ("1.01", NOT_NEGATIVE)])
def test_an_error_stays_within_1_that_an_input_may_push_up_to_1(weight: str, outcome: Any) -> None:
    """e' = -e + v, |v| <= 1 comes to |e| = 1: P e^2 <= 1 is kept of P < 1 alone; -2 P e^2 + 2 P e v + alpha (P e^2 -
    v^2) < 0 at alpha = 1."""
    bound = {"P": [[Fraction(weight)]], "S": [Fraction(1)], "alpha": Fraction(1)}
    with outcome:
        demand_kept(STILL, FLOW, NOW, bound, [SAMPLE])


@pytest.mark.parametrize(("alpha", "of_input"), [("0", "0"), ("-1", "-1"), ("1", "1.01"), ("1", "-0.01")])
def test_what_pays_for_inputs_is_within_the_rate(alpha: str, of_input: str) -> None:
    bound = {"P": [[Fraction(1, 100)]], "S": [Fraction(of_input)], "alpha": Fraction(alpha)}
    with pytest.raises(Unproved):
        demand_kept(STILL, FLOW, NOW, bound, [SAMPLE])


@pytest.mark.parametrize(
    ("count", "outcome"), [(99, SHOWN), (100, pytest.raises(Unproved, match="more than 100 rows"))]
)
def test_no_more_inputs_of_a_flow_are_taken_than_an_elimination_can(count: int, outcome: Any) -> None:
    """A certificate says how many there are: what it would cost to look at is its writer's to choose."""
    bound = {"P": [[Fraction(1, 100)]], "S": [Fraction(1, 100)] * count, "alpha": Fraction(1)}
    with outcome:
        demand_kept(STILL, FLOW, NOW, bound, [SAMPLE * Fraction(1, 100)] * count)


@pytest.mark.parametrize(("slopes", "outcome"), [(59, "not negative"), (60, "more than 60 rows")])
def test_no_more_slopes_of_a_step_are_taken_than_an_elimination_can(slopes: int, outcome: str) -> None:
    one, none = [Fraction(1)], [NONE]
    G, H, E = Matrix([one * slopes]), Matrix([one] * slopes), Matrix([none] * slopes)
    steep = ErrorMatrices(STILL.M, G, H, STILL.L, False, STILL.B, STILL.R, E)
    with pytest.raises(Unproved, match=outcome):
        demand_falls(steep, method_of({"method": "Euler"}), Fraction(1, 10), NOW, {"P": [one], "S": one * slopes})


@pytest.mark.parametrize(
    ("kind", "known", "unknown"),
    [
        ("triangular", "triangular.a_2", "triangular.a_1_2"),
        ("block_triangular", "block_triangular.a_1_2", "block_triangular.a_2"),
        ("block_triangular", "block_triangular.offset_2", "block_triangular.offset"),
        ("triangular", "triangular.structure", "block_triangular.structure"),
        ("triangular", "high_gain.theta", "high_gain.structure"),
        ("phase", "high_gain.lipschitz", "phase.structure"),
        ("triangular", "triangular.lipschitz", "high_gain.lipschitz"),
        ("uniform", "uniform_injection.theta", "high_gain.theta"),
        ("uniform", "uniform.slope_1", "uniform.slope"),
        ("triangular", "updated_gain.p_1", "updated_gain.p_2"),
        ("triangular", "adaptive_lmi.shrink", "high_gain.shrink"),
    ],
)
def test_a_rule_takes_the_claims_of_its_makers_on_its_forms(kind: str, known: str, unknown: str) -> None:
    claim, other = (_claim(id, {"verdict": "proved", "evidence": {}}) for id in (known, unknown))
    assert rule_of(kind, claim) is not None
    assert rule_of(kind, other) is None
    assert rule_of(kind, _claim(known, {"verdict": "generic", "evidence": {}})) is None
