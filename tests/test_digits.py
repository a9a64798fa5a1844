"""A printed bound is a bound: rounded to the safe side, and to the nearest number there."""

import math
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.emit.syntax import shortest
from hgogen.sentence import down, same, up

REALS = {"float": np.float32, "double": np.float64}
NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.fractions()


@given(NUMBERS, st.integers(1, 9))
def test_the_value_lies_between(value: float | Fraction, digits: int) -> None:
    low, high = Fraction(down(value, digits)), Fraction(up(value, digits))
    assert low <= Fraction(value) <= high
    assert high - low <= 2 * abs(Fraction(value)) * Fraction(10) ** (1 - digits)


@pytest.mark.parametrize(
    ("value", "below", "above"),
    [
        (0.0, "0", "0"),
        (40.0, "40", "40"),
        (-0.22222, "-0.2223", "-0.2222"),
        (Fraction(2, 3), "0.6666", "0.6667"),
        (1.4400001e5, "1.44e+5", "1.441e+5"),
        (Fraction(129, 10**7), "1.29e-5", "1.29e-5"),
        (9999.5, "9999", "1e+4"),
        (math.inf, "inf", "inf"),
    ],
)
def test_known_numbers(value: float | Fraction, below: str, above: str) -> None:
    assert (down(value), up(value)) == (below, above)


def test_a_check_says_no_more_than_is_proved() -> None:
    """The slope of exp(-x) on [0, 1.2] is at least 0.30119..: to three digits it is not at least 0.302."""
    x, y = hg.Signal("x", low=0, high=1.2), hg.Signal("y")
    z = hg.Signal("z", low=0, high=1)
    plant = hg.System("slow", states=(x, z), outputs=(y,), flow=[sp.exp(-x) * z, -z], output=[x])
    form = hg.forms.triangular(plant, measured=True)
    reason = next(check.reason for check in form.checks if check.id == "triangular.a_2")
    low, high = (Fraction(str(reason.part(end))) for end in ("low", "high"))
    assert float(low) <= math.exp(-1.2) <= float(low) * (1 + 2e-2)
    assert high >= 1


@given(st.floats(1e-6, 1e6), st.floats(1e-13, 1e-2))
def test_a_bound_that_a_number_is_above_is_printed_below_it(bound: float, more: float) -> None:
    """Of 5.97098 and 5.970983 above it, four digits rounded up would say that 5.97098 is above 5.971."""
    number = bound * (1 + more)
    assert Fraction(bound) <= Fraction(up(bound, below=number)) < Fraction(same(number))
    assert up(bound, below=bound) == up(bound, below=bound / 2) == up(bound)


@given(st.floats(allow_nan=False))
def test_what_is_to_be_built_again_reads_back_as_the_same(value: float) -> None:
    assert float(same(value)) == value


@pytest.mark.parametrize(
    ("value", "text"), [(0.1, "0.1"), (20.0, "20"), (1e-7, "1e-07"), (1 / 3, "0.3333333333333333")]
)
def test_six_digits_serve_where_they_do(value: float, text: str) -> None:
    assert same(value) == text


@pytest.mark.parametrize("real", ["float", "double"])
@given(st.floats(-1e30, 1e30).filter(lambda value: value == 0 or abs(value) > 1e-30))
def test_the_shortest_text_reads_back_as_the_number_of_the_code(real: str, value: float) -> None:
    kind = REALS[real]
    text = shortest(value, real)
    assert kind(text) == kind(value)
    assert len(text) <= len(repr(float(value)))
    assert not text.endswith(".0")


@pytest.mark.parametrize(
    ("value", "text"), [(4e9 / 9, "4.4444445e+08"), (5.0, "5"), (-0.2, "-0.2"), (3115534, "3115534")]
)
def test_known_texts(value: float, text: str) -> None:
    assert shortest(value, "float") == text
