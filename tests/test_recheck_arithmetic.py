"""The verifier's own arithmetic: intervals that hold every value, matrices and bisections by known answers."""

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import product
from typing import Any

import mpmath
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.recheck.algebra import Algebra
from hgogen.recheck.arithmetic import Undefined, Unproved, evaluate
from hgogen.recheck.box import covered, frobenius, leaves, positive, ranged, spectral
from hgogen.recheck.interval import Interval, between, intervals, point
from hgogen.recheck.matrix import Matrix, decaying, demand_nonnegative, demand_positive
from hgogen.recheck.rules.persistence import ORDER, BallMatrix, ball_matrix, piece
from hgogen.recheck.text import expression

F = Fraction
ENTIRE: dict[str, Callable[[Any], Any]] = {
    name: getattr(mpmath, name) for name in ("exp", "sin", "cos", "atan", "sinh", "cosh", "tanh", "asinh")
}


def number(end: Any) -> Fraction:
    """The exact number of an end of an interval."""
    sign, mantissa, exponent, _ = end
    return (-1) ** sign * F(int(mantissa)) * F(2) ** exponent


@settings(deadline=None, max_examples=200)
@given(st.sampled_from(sorted(ENTIRE)), st.fractions(-30, 30), st.fractions(0, 3), st.fractions(0, 1))
def test_an_interval_holds_the_values(name: str, low: Fraction, width: Fraction, share: Fraction) -> None:
    interval = intervals.function(name, (between(low, low + width),))
    x = low + share * width
    with mpmath.workprec(300):
        exact = number(ENTIRE[name](mpmath.mpf(x.numerator) / x.denominator)._mpf_)
    slack = F(1, 2**200) * (1 + abs(exact))
    assert number(interval.ends[0]) <= exact + slack
    assert exact - slack <= number(interval.ends[1])
    if width == 0:
        assert number(interval.ends[1]) - number(interval.ends[0]) <= F(1, 2**60) * (1 + abs(exact))


@settings(deadline=None, max_examples=100)
@given(st.fractions(-3, 3), st.fractions(-3, 3), st.fractions(0, 1))
def test_an_angle_lies_in_its_quadrant(y: Fraction, x: Fraction, width: Fraction) -> None:
    """atan2 at the corners of a box, which has no value where the box touches the cut."""
    side, ahead = between(y, y + width), between(x, x + width)
    if x <= 0 and y <= 0 <= y + width:
        with pytest.raises(Undefined):
            intervals.function("atan2", (side, ahead))
        return
    angle = intervals.function("atan2", (side, ahead))
    for corner in product((y, y + width), (x, x + width)):
        with mpmath.workprec(300):
            exact = number(mpmath.atan2(*(mpmath.mpf(each.numerator) / each.denominator for each in corner))._mpf_)
        slack = F(1, 2**200)
        assert number(angle.ends[0]) <= exact + slack
        assert exact - slack <= number(angle.ends[1])


SIDES = st.tuples(st.fractions(-3, 3), st.fractions(-3, 3)).map(sorted)


@pytest.mark.full
@settings(deadline=None, max_examples=200)
@given(SIDES, SIDES)
def test_a_product_is_the_narrowest_that_holds_all_products(a: list[Fraction], b: list[Fraction]) -> None:
    x, y = between(*a), between(*b)
    every = [number(p) * number(q) for p in x.ends for q in y.ends]
    assert x * y == between(min(every), max(every))


@pytest.mark.parametrize(
    ("a", "b", "product"),
    [((-math.inf, 0), (-1, 0), (0, math.inf)), ((-math.inf, math.inf), (0, 0), (-math.inf, math.inf))],
)
def test_no_bound_times_zero_is_no_value(a: tuple[Any, Any], b: tuple[Any, Any], product: tuple[Any, Any]) -> None:
    assert between(*a) * between(*b) == between(*product)


def test_a_number_that_is_no_float_is_within_itself_of_neither_side() -> None:
    third, half = F(1, 3), F(1, 2)
    assert not point(third).at_most(third)
    assert not point(third).at_least(third)
    assert point(half).at_most(half)
    assert point(half).at_least(half)


@pytest.mark.parametrize(
    ("text", "zero"),
    [
        ("sqrt(a*p**2/q**2) - sqrt(a)*p/q", False),  # a may be negative
        ("sqrt(p**2/(3*q**4)) - sqrt(1/3)*p/q**2", True),
        ("sqrt(a**2) - a", False),
        ("sqrt(a**2*p**4) - Abs(a)*p**2", False),
        ("Abs(-3*p/q) - 3*p/q", True),
        ("Abs(a) - a", False),
        ("Abs(a**2) - a**2", True),
        ("Abs(sqrt(a)) - sqrt(a)", True),
        ("sqrt(-p**2) - p", False),
        ("(8*p**3)**(1/3) - 2*p", True),
        ("sqrt(7/10*p**2)/sqrt(7/10) - p", True),
    ],
)
def test_roots_and_moduli_of_what_is_not_negative(text: str, zero: bool) -> None:
    """p, q >= 0; of a nothing is known."""
    algebra = Algebra(("a", "p", "q"), ("p", "q"))
    value = evaluate(
        expression(text, ("a", "p", "q")), {name: algebra.names[name] for name in "apq"}, algebra.arithmetic
    )
    assert algebra.is_zero(value) is zero


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("log", 0, 1), ("log", -1, 1), ("tan", 1, 2), ("tan", -2, -1), ("atanh", 0, 1), ("asin", 0, 2), ("acosh", 0, 2)],
)
def test_what_may_have_no_value_is_undefined(name: str, low: int, high: int) -> None:
    with pytest.raises(Undefined):
        intervals.function(name, (between(low, high),))


@pytest.mark.parametrize("tree", ["x", "x .", "x . x .", "x . . .", "", "y . .", "z . ."])
def test_a_bisection_covers_its_box(tree: str) -> None:
    box = {"x": (F(0), F(1)), "z": (F(0), F(0))}
    assert leaves("x . x . .", box) == [{**box, "x": ends} for ends in ((0, F(1, 2)), (F(1, 2), F(3, 4)), (F(3, 4), 1))]
    with pytest.raises(Unproved):
        leaves(tree, box)


@pytest.mark.parametrize(("low", "high", "where"), [("-199/100", 2, "x = 0, y = 1"), (-2, "99/100", "x = 1, y = 0")])
def test_a_bound_that_fails_in_a_corner_fails_there_at_once(low: Any, high: Any, where: str) -> None:
    box = {name: (Fraction(0), Fraction(1)) for name in ("x", "y")}
    with pytest.raises(Unproved, match=f"it does not hold at {where}"):
        covered(box, ".", ranged(expression("x - y**3 - y", box), Fraction(low), Fraction(high)), more=1)


def rows(*numbers: tuple[int, ...]) -> Matrix:
    return Matrix([map(F, row) for row in numbers])


@pytest.mark.parametrize(
    ("M", "definite", "semidefinite"),
    [
        (rows((2, 1), (1, 1)), True, True),
        (rows((1, 1), (1, 1)), False, True),
        (rows((0, 0), (0, 1)), False, True),
        (rows((0, 1), (1, 5)), False, False),
        (rows((1, 2), (2, 1)), False, False),
        (rows((1, 0, 0), (0, 0, 1), (0, 1, 0)), False, False),
    ],
)
def test_signs_of_symmetric_matrices(M: Matrix, definite: bool, semidefinite: bool) -> None:
    for demand, holds in ((demand_positive, definite), (demand_nonnegative, semidefinite)):
        if holds:
            demand({"M": M})
        else:
            with pytest.raises(Unproved):
                demand({"M": M})
    inner = [[point(value) for value in row] for row in M]
    assert positive(inner) is definite


def test_an_interval_that_touches_zero_is_not_positive() -> None:
    assert positive([[between(F(1, 10), 1)]])
    assert not positive([[between(0, 1)]])
    assert not positive([[between(-1, 1)]])


def test_decay_is_by_more_than_one() -> None:
    """-I - N'P - P N of N = -1 is 2 P - 1."""
    assert decaying(rows((-1,)), rows((2,))) == rows((3,))
    with pytest.raises(Unproved):
        demand_positive({"decay": decaying(rows((-1,)), Matrix([[F(1, 2)]]))})


@pytest.mark.parametrize("within", [frobenius, spectral])
def test_a_norm_is_at_most_its_bound(within: Callable[[list[list[Interval]], Fraction], bool]) -> None:
    """diag(3, 4) has the norm 4, and 5 by Frobenius."""
    norm = 4 if within is spectral else 5
    J = [[point(F(3)), point(F(0))], [point(F(0)), point(F(4))]]
    assert within(J, F(norm) + F(1, 100))
    assert not within(J, F(norm) - F(1, 100))


def test_a_piece_of_time_is_enclosed_and_closely() -> None:
    """x' = (1 + 2 t) (x2, -x1), y = (1 + t) x1 from t = 0 on: a turn by t + t^2."""
    h, one = Fraction(1, 8), point(Fraction(1))

    def line(first: Interval, slope: int, rows: list[list[int]], count: int) -> list[BallMatrix]:
        numbers = [first, point(Fraction(slope)), *[point(Fraction(0))] * (count - 2)]
        return [ball_matrix([[each * point(Fraction(x)) for x in row] for row in rows]) for each in numbers]

    turning, seen, later = [[0, 1], [-1, 0]], [[1, 0]], ORDER + 2
    around = line(between(1, 1 + 2 * h), 2, turning, later), line(between(1, 1 + h), 1, seen, later)
    known = piece(line(one, 2, turning, ORDER + 1), line(one, 1, seen, ORDER + 1), around, h)

    def turned(t: Any) -> Any:
        return mpmath.matrix(
            [[mpmath.cos(t + t**2), mpmath.sin(t + t**2)], [-mpmath.sin(t + t**2), mpmath.cos(t + t**2)]]
        )

    with mpmath.workdps(40):
        end = mpmath.mpf(h.numerator) / h.denominator
        for i, j in product(range(2), repeat=2):
            shown = mpmath.quad(lambda t, i=i, j=j: (1 + t) ** 2 * turned(t)[0, i] * turned(t)[0, j], [0, end])
            for ball, value in ((known.Phi, turned(end)[i, j]), (known.W, shown)):
                assert abs(ball.mid[i][j] - value * 2**192) <= ball.off[i][j] + 2**70  # of 40 digits
                assert ball.off[i][j] < 2 ** (192 - 30)
