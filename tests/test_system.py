"""A system fits together, or says in a sentence which part does not and what to do."""

import pickle

import numpy as np
import pytest
import sympy as sp

from hgogen.signal import BadName, Signal
from hgogen.system import BadSystem, System

q, w = Signal("q", "rad", low=-4, high=4), Signal("w", "rad/s", low=-20, high=20)
tau, y = Signal("tau", low=-1, high=1), Signal("y", "rad")
a, b = Signal("a", nominal=19.6), Signal("b", nominal=0.1)
GOOD = {
    "states": (q, w),
    "inputs": (tau,),
    "outputs": (y,),
    "parameters": (a, b),
    "flow": [w, -a * sp.sin(q) - b * w + tau],
    "output": [q],
}


def test_holds_what_it_was_given() -> None:
    plant = System("pendulum", **GOOD)
    assert plant.states == (q, w)
    assert plant.flow == (w, -a * sp.sin(q) - b * w + tau)
    assert plant.signals == (q, w, tau, y, a, b)
    assert System("pendulum", **{**GOOD, "flow": sp.Matrix(GOOD["flow"])}) == plant
    assert System("pendulum", **{**GOOD, "states": [q, w]}) == plant
    assert hash(pickle.loads(pickle.dumps(plant))) == hash(plant)


def test_nominal_values_are_the_decimals_that_were_written() -> None:
    assert System("pendulum", **GOOD).nominal == {a: sp.Rational(98, 5), b: sp.Rational(1, 10)}


def test_numbers_are_expressions() -> None:
    plant = System("pendulum", **{**GOOD, "flow": [np.float64(0.5), 0]})
    assert plant.flow == (sp.Float(0.5), sp.Integer(0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"flow": [w]}, "has 2 states but 1 expressions in flow; give one for each"),
        ({"output": [q, w]}, "has 1 outputs but 2 expressions in output"),
        ({"states": (), "flow": []}, "has no states"),
        ({"outputs": (), "output": []}, "has no outputs"),
        ({"states": q}, "states is a single Signal; write a tuple, states=(q,)"),
        ({"inputs": None}, "inputs is None; write a tuple of Signals"),
        ({"states": {q, w}}, "whose order counts"),
        ({"states": (q, sp.Symbol("w"))}, "states holds w, which is no Signal; declare it with hg.Signal"),
        ({"states": "qw"}, "states holds 'q', which is no Signal"),
        ({"inputs": (Signal("q"),)}, "the name 'q' is declared twice; rename"),
        ({"parameters": (a, Signal("b"))}, "parameter 'b' has no value; give it nominal="),
        ({"flow": [w, sp.Symbol("g") * q]}, "flow 2 uses the unknown symbol g; declare it as a Signal"),
        ({"flow": [w, sp.Symbol("tau")]}, "flow 2 uses a symbol tau that is not the Signal declared"),
        ({"flow": [w, Signal("q")]}, "flow 2 uses a symbol q that is not the Signal declared"),
        ({"flow": [w, y]}, "flow 2 uses the output y; write it in states and inputs"),
        ({"output": [Signal("v")]}, "output 1 uses the unknown symbol v"),
        ({"flow": [w, "sin(q)"]}, "flow 2 is 'sin(q)', not a SymPy expression"),
        ({"flow": [w, None]}, "flow 2 is None, not a SymPy expression"),
        ({"flow": [w, sp.Eq(q, w)]}, "flow 2 is Eq(q, w), which is not a scalar expression"),
        ({"flow": [w, sp.Matrix([q])]}, "which is not a scalar expression"),
        ({"flow": w}, "flow is w; write a list of expressions"),
        ({"flow": {q: w, w: q}}, "write a list of expressions in the signals' order"),
        ({"flow": "ab"}, "flow is 'ab'; write a list of expressions"),
        ({"flow": [w, q / sp.Integer(0)]}, "is not finite and real; correct it"),
        ({"flow": [w, sp.sqrt(-1) * q]}, "is not finite and real"),
        ({"flow": [w, sp.sqrt(-1 - q**2)]}, "is not finite and real"),
        ({"flow": [w, float("nan")]}, "is not finite and real"),
    ],
)
def test_a_part_that_does_not_fit_is_named(change: dict[str, object], says: str) -> None:
    with pytest.raises(BadSystem) as caught:
        System("pendulum", **{**GOOD, **change})
    assert str(caught.value).startswith("system 'pendulum': ")
    assert says in str(caught.value)


def test_a_name_that_c_cannot_carry() -> None:
    with pytest.raises(BadName, match="the name 'my plant' is not an identifier"):
        System("my plant", **GOOD)


@pytest.mark.parametrize(("name", "hint"), [("my plant", "my_plant"), ("3d", "x_3d"), ("_", "x_1"), ("a__b", "a_b")])
def test_a_refused_name_comes_with_one_that_does(name: str, hint: str) -> None:
    with pytest.raises(BadName, match=f"such as '{hint}'"):
        System(name, states=(), outputs=(), flow=[], output=[])


@pytest.mark.parametrize(("discrete", "mark"), [(False, "'"), (True, "+")])
def test_a_plant_prints_its_equations(discrete: bool, mark: str) -> None:
    signals = {"states": (q, w), "inputs": (tau,), "outputs": (y,)}
    plant = System("plant", **signals, flow=[w, tau - q], output=[2 * q], time="h", discrete=discrete)
    assert str(plant) == f"plant, time in h\n  q{mark} = w\n  w{mark} = -q + tau\n  y = 2*q"
