"""What an observer remembers of the arguments that made it: as they were, whoever changes his own afterwards."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import van_der_pol

import hgogen as hg
from hgogen.observer import Observer

FORM = hg.forms.triangular(van_der_pol())


def high_gain(**gains: Any) -> Observer:
    return hg.observers.high_gain(FORM, **{"theta": 5.0, "poles": (-1, -1), **gains})


def injected(observer: Observer) -> str:
    """The gains, as its equations and those of what is made of it again have them."""
    text, again = (each.equations[-1] for each in (observer, observer.clamping(True)))
    assert text == again
    return text


def test_a_start_that_is_changed_later_starts_nobody_else() -> None:
    """The observer of the second call is remembered from the first, whose caller has changed his dict since."""
    start = {"x1": 0.125}
    high_gain(initial=start)
    start["x1"] = 0.5
    observer = high_gain(initial={"x1": 0.125})
    assert observer.initial == {"x1": 0.125}
    assert hg.sample(observer, dt=0.005, guards="none").run(y=[[0.125]]).x[0, 0] == 0.125


@pytest.mark.parametrize("poles", [[-1.0, -1.0], np.array([-1.0, -1.0])], ids=["list", "array"])
def test_an_observer_is_made_again_of_what_made_it(poles: Any) -> None:
    wanted = injected(high_gain(poles=(-1.0, -1.0)))
    observer = high_gain(poles=poles)
    poles[0] = -3.0
    assert injected(observer) == wanted


def test_an_iterator_gives_its_items_to_all_that_is_made_of_it() -> None:
    """Else what was accepted is refused where the observer is made again."""
    v, w = (hg.Signal(name, low=0, high=1) for name in "vw")
    flow = [w, sp.sqrt(w)]
    form = hg.forms.triangular(hg.System("root", states=(v, w), outputs=(hg.Signal("y"),), flow=flow, output=[v]))
    accepted = ["triangular.lipschitz"]
    observer = hg.observers.high_gain(form, theta=5.0, poles=(-1, -1), accept=iter(accepted))
    assert observer.clamping(True).accepted == observer.accepted == tuple(accepted)


def test_numbers_that_lie_where_others_lay_are_others() -> None:
    """An array of objects holds their addresses, and that of a number which is gone may be the next one's."""
    for k in range(2, 20):
        one = np.array([Fraction(-1, k), Fraction(-2)], dtype=object)
        first = high_gain(poles=one)
        one[0] = Fraction(-k)
        other = np.array([Fraction(-k - 1), one[1]], dtype=object)
        assert high_gain(poles=other) is not first
