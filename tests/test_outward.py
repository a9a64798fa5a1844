"""Outward rounding: every operation holds the exact result, and is the next float away at most."""

import math
from fractions import Fraction

import numpy as np
import pytest
from flint import arb, ctx
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hgogen.rigor import outward
from hgogen.rigor.enclosure import FUNCTIONS, arctangent, elementary
from hgogen.rigor.outward import Pair

_FLOATS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0.0, 5e-324, -5e-324, 1e300, -1e300, 1.7976931348623157e308, 2.2250738585072014e-308, 1.0, 0.1]),
    st.floats(-4, 4),
)


def pair(low: float, high: float) -> Pair:
    return np.array([min(low, high)]), np.array([max(low, high)])


def holds(interval: Pair, value: Fraction) -> bool:
    low, high = float(interval[0][0]), float(interval[1][0])
    assert low < math.inf
    assert high > -math.inf
    return (math.isinf(low) or Fraction(low) <= value) and (math.isinf(high) or value <= Fraction(high))


@st.composite
def with_point(draw: st.DrawFn) -> tuple[Pair, Fraction]:
    low, high = sorted((draw(_FLOATS), draw(_FLOATS)))
    t = draw(st.fractions(0, 1, max_denominator=7))
    return pair(low, high), Fraction(low) * (1 - t) + Fraction(high) * t


@settings(deadline=None, max_examples=300)
@given(with_point(), with_point(), st.integers(-5, 9))
def test_the_exact_result_is_inside(first: tuple[Pair, Fraction], second: tuple[Pair, Fraction], n: int) -> None:
    (a, x), (b, y) = first, second
    with np.errstate(all="ignore"):
        assert holds(outward.add(a, b), x + y)
        assert holds(outward.multiply(a, b), x * y)
        assert holds(outward.scale(a, b), x * y)
        assert holds(outward.absolute(a), abs(x))
        assert holds(outward.hull(a, b), x)
        if x or n >= 0:
            assert holds(outward.power(a, n), x**n)
        if x:
            assert holds(outward.reciprocal(a), 1 / x)
        if x >= 0:
            low, high = (float(end[0]) for end in outward.square_root(a))
            assert Fraction(low) ** 2 <= x
            assert math.isinf(high) or x <= Fraction(high) ** 2


@pytest.mark.full
@settings(deadline=None, max_examples=300)
@given(_FLOATS, _FLOATS)
def test_points_grow_by_one_float_at_most_and_exact_results_not_at_all(x: float, y: float) -> None:
    a, b = pair(x, x), pair(y, y)
    with np.errstate(all="ignore"):
        for interval, exact in (
            (outward.add(a, b), Fraction(x) + Fraction(y)),
            (outward.multiply(a, b), Fraction(x) * Fraction(y)),
        ):
            low, high = float(interval[0][0]), float(interval[1][0])
            assume(1e-270 < abs(exact) < 1e280)
            assert low == high if low == exact or high == exact else math.nextafter(low, math.inf) == high


def test_zeros_signs_and_infinite_ends() -> None:
    zero, line, right = pair(0.0, 0.0), pair(-math.inf, math.inf), pair(0.0, math.inf)
    tiny = pair(1e-200, 1e-180)
    with np.errstate(all="ignore"):
        assert [float(end[0]) for end in outward.multiply(zero, line)] == [0.0, 0.0]
        assert [float(end[0]) for end in outward.scale(zero, line)] == [0.0, 0.0]
        assert float(outward.scale(pair(0.0, 2.0), pair(1.0, 3.0))[0][0]) == 0.0
        assert float(outward.scale(pair(-2.0, 0.0), pair(1.0, 3.0))[1][0]) == 0.0
        assert float(outward.multiply(tiny, tiny)[0][0]) == 0.0
        assert float(outward.multiply(tiny, outward.negate(tiny))[1][0]) == 0.0
        assert [float(end[0]) for end in outward.reciprocal(right)] == [0.0, math.inf]
        assert [float(end[0]) for end in outward.reciprocal(line)] == [-math.inf, math.inf]
        assert [float(end[0]) for end in outward.reciprocal(pair(1.0, math.inf))] == [0.0, 1.0]
        assert [float(end[0]) for end in outward.reciprocal(pair(4.0, 4.0))] == [0.25, 0.25]
        assert [float(end[0]) for end in outward.power(line, 2)] == [0.0, math.inf]
        assert [float(end[0]) for end in outward.power(pair(-3.0, 2.0), 3)] == [-27.0, 8.0]
        assert [float(end[0]) for end in outward.square_root(pair(-1.0, 4.0))] == [0.0, 2.0]
        assert [float(end[0]) for end in outward.power(pair(1.0, 1e300), 10**40)] == [1.0, math.inf]


@pytest.mark.parametrize("value", [Fraction(1, 3), Fraction(10) ** 400, -(Fraction(10) ** 400), Fraction(1, 10**400)])
def test_a_number_lies_between_neighbouring_floats(value: Fraction) -> None:
    low, high = outward.number(value)
    assert math.nextafter(low, math.inf) == high
    assert math.isinf(low) or Fraction(low) < value
    assert math.isinf(high) or value < Fraction(high)


_ARGUMENTS = st.one_of(st.floats(-9, 9), st.floats(-1, 1), st.floats(-1e4, 1e4), st.sampled_from([0.0, 1e-300, 800.0]))


@pytest.mark.full
@settings(deadline=None, max_examples=400)
@given(st.sampled_from(sorted(FUNCTIONS)), _ARGUMENTS, _ARGUMENTS, st.floats(0, 1))
def test_elementary_functions_hold_their_values(name: str, x: float, y: float, t: float) -> None:
    import mpmath

    low, high = min(x, y), max(x, y)
    inside = min(max(low + (high - low) * t, low), high)
    with mpmath.workdps(50), np.errstate(all="ignore"):
        (least, most), defined = elementary(name, pair(low, high))
        try:
            value = getattr(mpmath, name)(mpmath.mpf(inside))
        except (ValueError, ZeroDivisionError):
            value = mpmath.mpc(0, 1)
        if not isinstance(value, mpmath.mpf) or not mpmath.isfinite(value):
            assert not defined[0]
            return
        assert least[0] <= value <= most[0]


@settings(deadline=None, max_examples=300)
@given(*[st.floats(-3, 3)] * 4, st.floats(0, 1), st.floats(0, 1))
def test_an_angle_holds_its_values(a: float, b: float, c: float, d: float, s: float, t: float) -> None:
    y, x = (min(a, b), max(a, b)), (min(c, d), max(c, d))
    with np.errstate(all="ignore"):
        (low, high), defined, continuous = arctangent(pair(*y), pair(*x))
    at = min(y[0] + (y[1] - y[0]) * s, y[1]), min(x[0] + (x[1] - x[0]) * t, x[1])  # rounding may leave the interval
    if at == (0.0, 0.0):
        assert not defined[0]
        return
    at = at[0] + 0.0, at[1] + 0.0  # no -0, whose angle is -pi
    assert low[0] - 1e-15 <= math.atan2(*at) <= high[0] + 1e-15  # the library's own rounding
    if continuous[0] and defined[0]:
        assert not (y[0] < 0 <= y[1] and x[0] <= 0)


def test_turning_points_are_met() -> None:
    with np.errstate(all="ignore"):
        for name, low, high, expected in (
            ("sin", 0.0, 2.0, (0.0, 1.0)),
            ("sin", -2.0, 5.0, (-1.0, 1.0)),
            ("cos", -1.0, 0.5, (math.cos(1.0), 1.0)),
            ("cos", 3.0, 3.5, (-1.0, math.cos(3.5))),
            ("cosh", -1.0, 2.0, (1.0, math.cosh(2.0))),
            ("sin", -math.inf, 0.0, (-1.0, 1.0)),
            ("tan", -1.0, 1.5, (math.tan(-1.0), math.tan(1.5))),
            ("tan", 1.0, 2.0, (-math.inf, math.inf)),
            ("tanh", -math.inf, math.inf, (-1.0, 1.0)),
            ("log", 0.0, 1.0, (-math.inf, 0.0)),
            ("exp", -math.inf, 0.0, (0.0, 1.0)),
        ):
            (least, most), defined = elementary(name, pair(low, high))
            assert (float(least[0]), float(most[0])) == pytest.approx(expected, rel=1e-15, abs=1e-15), name
            assert defined[0] == (abs(expected[0]) < math.inf and abs(expected[1]) < math.inf), name


@pytest.mark.parametrize(("name", "phase"), [("sin", 1), ("cos", 0)])
@pytest.mark.parametrize("size", [1.0, 1e6, 1e13])
def test_between_the_floats_next_to_where_a_wave_turns_is_its_extreme(name: str, phase: int, size: float) -> None:
    """At (4 k + phase) pi/2 it is 1, pi further -1; at 1e13 the floats are 2e-3 apart."""
    below = {}
    with ctx.workprec(200):
        for sign, turn in ((1, phase), (-1, phase + 2)):
            first = round(size / 6)
            exactly = [(4 * k + turn) * arb.pi() / 2 for k in range(first, first + 400)]
            floats = [float(ball) for ball in exactly]
            below[sign] = [
                x if arb(x) < ball else math.nextafter(x, -math.inf) for x, ball in zip(floats, exactly, strict=True)
            ]
    for sign, ends in below.items():
        low = np.array(ends)
        (least, most), everywhere = elementary(name, (low, np.nextafter(low, np.inf)))
        assert everywhere.all()
        assert ((most if sign > 0 else least) == sign).all()
