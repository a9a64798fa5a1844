"""Plants and observers that several tests use."""

from functools import cache
from pathlib import Path
from typing import Any

import sympy as sp

import hgogen as hg
from hgogen.model import Model, load

MODELS = Path(__file__).resolve().parents[1] / "models"

CART = """
name = "cart"
states.x = {low = -1, high = 3, flow = "v"}
states.v = {low = -2, high = 2, flow = "u - v"}
inputs.u = {low = 0, high = 2}
outputs.y = {equation = "x"}
"""


@cache
def loaded(path: Path) -> Model:
    """The model of a file, read once in a process."""
    return load(path)


def model(name: str) -> hg.System:
    return loaded(MODELS / f"{name}.py").plant


def chain(n: int) -> hg.System:
    """x1' = x2, .., xn' = -sin x1 - x_n + u, y = x1."""
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-5, high=5)
    flow = [*x[1:], -sp.sin(x[0]) - x[-1] + u]
    return hg.System(f"chain{n}", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])


def fitzhugh_nagumo(**changes: Any) -> hg.Observer:
    """The filter of the reference trial, theta = 1 unless `changes` say otherwise."""
    gains: dict[str, Any] = {"Q": (0.1, 0.01, 2.3e-4), "R": 1.0, "accept": ("triangular.a_2",)}
    return hg.observers.riccati(hg.forms.triangular(model("fitzhugh_nagumo")), **{**gains, **changes})


def pendulum(**changes: Any) -> hg.Observer:
    """The high-gain observer, theta = 20."""
    gains: dict[str, Any] = {"theta": 20, "poles": (-1, -1)}
    return hg.observers.high_gain(hg.forms.triangular(model("pendulum")), **{**gains, **changes})


def two_outputs(**data: Any) -> hg.System:
    """x1' = x2, x2' = -sin x1 - x2/5 + x3, x3' = -x3/10 + u; y1 = x1, y2 = x3."""
    x1, x2, x3 = (hg.Signal(f"x{i}", low=-10, high=10) for i in (1, 2, 3))
    u, y1, y2 = hg.Signal("u", low=-1, high=1), hg.Signal("y1"), hg.Signal("y2")
    flow = [x2, -sp.sin(x1) - x2 / 5 + x3, -x3 / 10 + u]
    return hg.System("two", states=(x1, x2, x3), inputs=(u,), outputs=(y1, y2), flow=flow, output=[x1, x3], **data)


def van_der_pol() -> hg.System:
    """No input, no parameter, no elementary function: C and Python agree to the bit."""
    x1, x2 = (hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2))
    flow = [x2, (1 - x1**2) * x2 - x1]
    return hg.System("van_der_pol", states=(x1, x2), outputs=(hg.Signal("y"),), flow=flow, output=[x1])


def kalman(plant: hg.System, **changes: Any) -> hg.Observer:
    """The extended Kalman filter of a plant in triangular form."""
    return hg.observers.riccati(hg.forms.triangular(plant), **{"Q": (0.1,) * len(plant.states), "R": 0.1, **changes})
