"""The window's Gramian, against the paper's neuron and an integration of its own."""

import math
from io import StringIO

import numpy as np
import pytest
import sympy as sp
from plants import MODELS, van_der_pol
from rich.console import Console
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.commands.running import window_table
from hgogen.model import load
from hgogen.run.gramian import BadWindows, gramian
from hgogen.trial import Jump, Trial, t


def neuron() -> tuple[hg.System, Trial]:
    model = load(MODELS / "fitzhugh_nagumo.py")
    return model.plant, model.trials()[0]


@pytest.mark.full
def test_the_neurons_known_answers() -> None:
    """1.6e-5 is the least for d = 1 along the nominal trial, and values up to some 4e-4 are met; .01 for d = 2 pi."""
    short, long = gramian(*neuron(), (1.0, 2 * math.pi))
    assert short.range[0] == pytest.approx(1.6e-5, rel=0.05)
    assert 3.6e-4 <= short.range[1] <= 6e-4
    assert long.median == pytest.approx(0.01, rel=0.5)
    assert short.weakest[0] == "eta"
    assert "d = 1: smallest eigenvalue 1.6e-05 .. " in str(short)


def rate(time: float, state: np.ndarray) -> np.ndarray:
    """FitzHugh-Nagumo with its variational equation and Gramian, u = sin t."""
    (x1, x2, eta), Phi, u = state[:3], state[3:12].reshape(3, 3), np.sin(time)
    F = np.array([[1 - x1**2, -u, 0], [2.4 * np.cos(x1), -0.8, -0.8], [0, 0, 0]])
    f = [x1 - x1**3 / 3 - x2 * u, 0.8 * (3 * np.sin(x1) - x2 - eta), 0]
    return np.concatenate([f, (F @ Phi).ravel(), np.outer(Phi[0], Phi[0]).ravel()])


def window(x: np.ndarray, begin: float, d: float) -> np.ndarray:
    start = np.concatenate([x, np.eye(3).ravel(), np.zeros(9)])
    done = solve_ivp(rate, (begin, begin + d), start, rtol=1e-11, atol=1e-13, method="DOP853")
    return done.y[:, -1]


@pytest.mark.parametrize("d", [0.5, 2.0])
def test_it_is_the_integral(d: float) -> None:
    plant, trial = neuron()
    (gramians,) = gramian(plant, Trial("short", 4.0, start=trial.start, inputs={"u": sp.sin(t)}), d)
    x = np.array([1.06, 2.69, 5.0])
    for k in (0, 5, 10):
        begin = gramians.start[k]
        now = window(x, 0.0, begin)[:3] if begin else x
        values, vectors = np.linalg.eigh(window(now, begin, gramians.d)[12:].reshape(3, 3))
        assert gramians.smallest[k] == pytest.approx(values[0], rel=1e-5)
        assert abs(gramians.direction[k] @ vectors[:, 0]) == pytest.approx(1, abs=1e-6)
    assert gramians.d == pytest.approx(d)


def test_a_longer_window_shows_more() -> None:
    """W grows with d, and so does its smallest eigenvalue."""
    trial = Trial("free", 10.0, start={"x1": 1, "x2": 0})
    short, middle, long = gramian(van_der_pol(), trial, (0.5, 1.0, 2.0))
    count = len(long.start)
    assert (short.smallest[:count] < middle.smallest[:count]).all()
    assert (middle.smallest[:count] < long.smallest).all()


def test_what_is_never_shown_has_no_eigenvalue() -> None:
    x1, x2 = hg.Signal("x1"), hg.Signal("x2")
    plant = hg.System("blind", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[-x1, -x2], output=[x1])
    (gramians,) = gramian(plant, Trial("rest", 2.0, start={"x1": 1, "x2": 1}, jumps=(Jump(1, "x1", 3),)), 1.0)
    assert gramians.range == (0.0, 0.0)
    assert gramians.weakest == ("x2", 1.0)


@pytest.mark.parametrize("d", [0.0, -1.0, 11.0, math.nan, ()])
def test_bad_windows_are_a_sentence(d: float | tuple[float, ...]) -> None:
    with pytest.raises(BadWindows, match=r"above 0 and at most the trial's 10"):
        gramian(van_der_pol(), Trial("free", 10.0, start={"x1": 1, "x2": 0}), d)


def test_the_innovation_of_a_small_error_is_its_quadratic_form() -> None:
    """As the command says: to first order, per the error's squared length, at least the smallest eigenvalue. Not of an
    error of length 1: after x' = -x^3 little is left of one, and y = x shows less than W."""
    x = hg.Signal("x")
    plant = hg.System("cubic", states=(x,), outputs=(hg.Signal("y"),), flow=[-(x**3)], output=[x])
    (gramians,) = gramian(plant, Trial("rest", 2.0, start={"x": 0}), 1.0)
    assert gramians.smallest[0] == pytest.approx(1)

    def innovation(e: float) -> float:
        """Of y = e/sqrt(1 + 2 e^2 t), t = 0..1."""
        return math.log(1 + 2 * e**2) / 2

    assert innovation(1e-3) / 1e-6 == pytest.approx(1, rel=1e-5)
    assert innovation(1) < 0.6 * gramians.smallest[0]
    console = Console(width=200, record=True, file=StringIO())
    console.print(window_table("rest", [gramians], "s"))
    said = " ".join(console.export_text().split())
    assert (
        "of a small initial error, per its squared length, is at least the smallest eigenvalue, to first order" in said
    )
