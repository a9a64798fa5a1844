"""A signal is a symbol of its own: equal only with equal data, safe as a C name, and picklable."""

import copy
import math
import pickle
import string

import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.signal import BadName, BadRange, Signal, check_name


def test_equal_only_with_equal_data() -> None:
    plain = Signal("x")
    assert plain == Signal("x")
    assert hash(plain) == hash(Signal("x"))
    others = [
        Signal("x", "m"),
        Signal("x", meaning="angle"),
        Signal("x", nominal=0),
        Signal("x", low=-1, high=1),
        Signal("x", low=-1, high=2),
        Signal("x", low=-1, high=2, rates=((-1, 1),)),
        sp.Symbol("x", real=True),
    ]
    for index, other in enumerate(others):
        assert plain != other
        assert all(other != later for later in others[index + 1 :])
    assert len({plain, *others}) == len(others) + 1


def test_sympy_keeps_signals_of_one_name_apart() -> None:
    narrow, wide = Signal("x", low=-1, high=1), Signal("x", low=-2, high=2)
    assert (narrow.low, wide.low) == (-1.0, -2.0)
    assert narrow - wide != 0
    assert (narrow * wide).diff(narrow) == wide
    assert sp.sin(narrow).subs(narrow, 0) == 0
    assert sp.sin(wide).subs(narrow, 0) == sp.sin(wide)


def test_is_real_and_carries_its_data() -> None:
    signal = Signal("w", "rad/s", "rate", 0.5, low=-20, high=20)
    assert signal.is_real
    assert (signal.unit, signal.meaning, signal.nominal) == ("rad/s", "rate", 0.5)
    assert signal.bounded
    assert signal.interval == (-20.0, 20.0)
    assert not Signal("w").bounded
    assert Signal("w").interval == (-math.inf, math.inf)


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))  # SymPy's own least
def test_pickles(protocol: int) -> None:
    signal = Signal("q", "rad", "angle", 0.25, low=-4, high=4, rates=((-1, 1), (-2, 3)))
    again = pickle.loads(pickle.dumps(signal, protocol))
    assert again == signal
    assert (again.unit, again.meaning, again.nominal, again.interval) == ("rad", "angle", 0.25, (-4.0, 4.0))
    assert again.rates == ((-1.0, 1.0), (-2.0, 3.0))
    expression = pickle.loads(pickle.dumps(sp.sin(signal) ** 2, protocol))
    assert expression == sp.sin(signal) ** 2
    assert copy.deepcopy(signal) == signal


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("", "not an identifier"),
        ("1x", "not an identifier"),
        ("x y", "not an identifier"),
        ("x\n", "not an identifier"),
        ("größe", "not an identifier"),
        ("_x", "not an identifier"),
        ("x__y", "double underscore"),
        ("x" * 64, "has 64 characters"),
        ("x_" * 40, "has 80 characters"),
    ],
)
def test_bad_names_are_refused_with_a_better_one(name: str, says: str) -> None:
    with pytest.raises(BadName) as caught:
        Signal(name)
    assert says in str(caught.value)
    assert repr(name) in str(caught.value)
    check_name(caught.value.hint)


@given(st.text(alphabet=string.printable + "äß_λ०", max_size=8))
def test_the_name_that_an_error_offers_is_good(name: str) -> None:
    check_name(BadName(name, "is bad").hint)


def test_a_name_has_no_more_characters_than_c_tells_apart() -> None:
    x, v = (Signal("x" * 62 + end, low=-1, high=1) for end in "ab")
    y = Signal("y" * 63)
    plant = hg.System("s" * 63, states=(x, v), outputs=(y,), flow=[v, -x], output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=5, poles=(-1, -1))
    files = hg.targets.c99(hg.sample(observer, dt=0.01), real="float")
    assert "Model: " in files[f"{plant.name}.h"]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ({"low": 1, "high": -1}, "low = 1 is not below high = -1; swap"),
        ({"low": 1, "high": 1}, "not below"),
        ({"low": 1}, "only one end"),
        ({"high": 1}, "only one end"),
        ({"low": -math.inf, "high": 1}, "not finite"),
        ({"nominal": math.nan}, "nominal = nan is not finite"),
        ({"nominal": 10**400}, "is not a number"),
        ({"nominal": "fast"}, "'fast' is not a number"),
        ({"nominal": 1j}, "is not a number"),
        ({"rates": (1, 2)}, "rate 1 is 1, no pair of numbers"),
        ({"rates": ((1, 1),)}, "low end of rate 1 = 1 is not below"),
        ({"rates": 3}, "rates = 3 is no list"),
        ({"rates": ((None, None),)}, "no pair of numbers"),
        ({"low": -2e30, "high": 1}, "low = -2e+30 is beyond 1e+30; give it in another unit"),
        ({"low": -1.0000001e30, "high": 1}, "low = -1.0000001e+30 is beyond 1e+30"),
        ({"low": 0, "high": 1.7e308}, "high = 1.7e+308 is beyond 1e+30; give it in another unit"),
        ({"rates": ((-1, 1e31),)}, "high end of rate 1 = 1e+31 is beyond 1e+30; give it in another unit"),
        ({"nominal": 3, "low": 0, "high": 2}, "nominal = 3 lies outside [0, 2]; widen"),
    ],
)
def test_bad_ranges_are_refused(data: dict[str, object], says: str) -> None:
    with pytest.raises(BadRange) as caught:
        Signal("x", **data)
    assert str(caught.value).startswith("signal 'x': ")
    assert says in str(caught.value)
