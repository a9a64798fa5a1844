"""What a plant does beside a step that realises a linear core: by hand, beside runs of the program, verified again."""

import copy
from fractions import Fraction
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from scipy.integrate import quad, solve_ivp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.method import Realising
from hgogen.model import load
from hgogen.part import Ode
from hgogen.program import Place
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.method_error import by_matrix_exponential
from hgogen.prove.plant_step import PlantStep
from hgogen.prove.quadratic import rational
from hgogen.prove.questions import theta_of
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import number
from hgogen.stepping.machine import Machine

RATE = 5  # at most, of inputs between two samples
METHODS = ("exponential", "bilinear")
STEPS = [
    ("pendulum", "high_gain"),
    ("disturbed_pendulum", "high_gain"),
    ("joint", "high_gain"),
    ("joint", "circle_criterion"),
    ("pendulum", "peaking_free"),
    pytest.param("pendulum", "filtered", marks=pytest.mark.slow),
    pytest.param("hyperjerk", "peaking_free", marks=pytest.mark.slow),
    pytest.param("disturbed_pendulum", "low_power", marks=pytest.mark.slow),
    pytest.param("hyperjerk", "filtered", marks=pytest.mark.slow),
]


def joint(observer: str) -> hg.Observer:
    """Of two chains, one of which is read by the other, with a_i and slopes of outputs that are not 1, and three
    sensors."""
    x1, x2, x3 = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "x3"))
    u, outputs = hg.Signal("u", low=-1, high=1), [hg.Signal(f"y{j}") for j in (1, 2, 3)]
    flow = [2 * x2, -4 * sp.sin(x1) - x2 / 2, x1 / 4 - x3 + u]
    plant = hg.System(
        "joint", states=(x1, x2, x3), inputs=(u,), outputs=outputs, flow=flow, output=[3 * x1, x3 / 2, 1 - x3]
    )
    form = hg.forms.block_triangular(plant)
    weights = {"weights": {"y3": 3}} if observer == "high_gain" else {}
    return getattr(hg.observers, observer)(form, theta=6, poles=((-1, -1), (-1,)), **weights)


@cache
def step_of(name: str, tuning: str, method: str, dt: float) -> hg.Step:
    observer = joint(tuning) if name == "joint" else load(name).step(tuning).observer
    return hg.sample(observer, getattr(hg.methods, method), dt=dt)


def plant_step(step: hg.Step) -> PlantStep:
    form = step.observer.form
    return PlantStep(form, Fraction(step.dt), tuple(Fraction(RATE) for _ in form.system.inputs))


def left(step: hg.Step) -> np.ndarray:
    """What is proved to be left in each field (N), over dt."""
    error, method = step.observer.error, step.method
    assert isinstance(error, Inclusion)
    assert isinstance(method, Realising)
    deviation = method.plant_deviation(plant_step(step), error, theta_of(step.observer))
    return np.array(list(map(float, deviation.sizes.fields)))


class Beside:
    """A step of the program from the state of a plant that moves by an accurate integration."""

    def __init__(self, step: hg.Step) -> None:
        error, theta, form = step.observer.error, theta_of(step.observer), step.observer.form
        assert isinstance(error, Inclusion)
        scales, remembered = error.scales(theta), error.remembered(theta)
        assert scales is not None
        assert remembered is not None
        self.step, self.form, self.machine, self.layout = step, form, Machine(step), error.layout
        self.scales, self.remembered = (np.array(list(map(float, each))) for each in (scales, remembered))
        self.flow = sp.lambdify([form.states, form.system.inputs], list(plant_step(step).flow))
        self.shown = sp.lambdify([form.states], list(form.output))
        (part,) = step.observer.parts
        assert isinstance(part, Ode)
        self.fields = part.fields

    def lifted(self, x: np.ndarray) -> np.ndarray:
        """A state of the form in the coordinates of the errors."""
        return np.asarray(self.scales * x[list(self.layout.index)] * self.layout.fed)

    def after(self, x: np.ndarray, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """The plant after a step."""
        moved = solve_ivp(lambda t, x: self.flow(x, u + rate * t), (0, self.step.dt), x, rtol=1e-12, atol=1e-14)
        return np.asarray(moved.y[:, -1])

    def error(self, x: np.ndarray, u: np.ndarray, rate: np.ndarray) -> np.ndarray | None:
        """Of the estimate (N) after a call, over dt; None where the plant does not keep to its ranges."""
        after, memory = self.after(x, u, rate), self.machine.memory
        if not all(abs(value) <= state.high for value, state in zip(after, self.form.states, strict=True)):
            return None
        begins = iter(self.lifted(x) / self.remembered)
        for field in self.fields:
            memory[Place("state", field.name)][:] = [next(begins) for _ in range(field.size)]
        for place, value in (("y", self.shown(x)), ("y_valid", 1), ("calls", 9)):
            memory[Place("state", place)][:] = value
        for y, value in zip(self.form.system.outputs, self.shown(after), strict=True):
            memory[Place("output", y.name)][0] = value
        for i, signal in enumerate(self.form.system.inputs):
            memory[Place("state", "u")][i], memory[Place("input", signal.name)][0] = u[i], (u + rate * self.step.dt)[i]
        self.machine.call()
        ends = np.concatenate([memory[Place("state", field.name)].ravel() for field in self.fields])
        return np.asarray(ends * self.remembered - self.lifted(after)) / self.step.dt


@pytest.mark.ordinary(
    "pendulum-high_gain-exponential-0.02",
    "pendulum-high_gain-bilinear-0.001",
    "disturbed_pendulum-high_gain-bilinear-0.001",
    "joint-high_gain-exponential-0.02",
    "joint-circle_criterion-exponential-0.001",
    "pendulum-peaking_free-exponential-0.02",
)
@pytest.mark.parametrize("dt", [0.001, 0.02])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("name", "tuning"), STEPS)
def test_a_step_of_the_program_leaves_no_more_and_not_much_less(name: str, tuning: str, method: str, dt: float) -> None:
    """From states anywhere in the ranges, inputs at their rates, which keep to theirs."""
    step, rng = step_of(name, tuning, method, dt), np.random.default_rng(0)
    beside, bounds = Beside(step), left(step)
    low, high = np.array([state.interval for state in beside.form.states], dtype=float).T
    inputs, worst = beside.form.system.inputs, np.zeros(len(bounds))
    for _ in range(200):
        rate = RATE * rng.choice([-1, 1], len(inputs))
        ends = np.array([signal.interval for signal in inputs], dtype=float).reshape(-1, 2)
        u = rng.uniform(ends[:, 0] + RATE * dt, ends[:, 1] - RATE * dt)
        error = beside.error(rng.uniform(low, high), u, rate)
        if error is not None:
            worst = np.maximum(worst, np.abs(error))
    assert (worst <= bounds * (1 + 1e-6) + 1e-9).all()
    assert (worst > bounds / 20).any()
    assert np.median(worst / bounds) > 1 / 5


@pytest.mark.ordinary("pendulum-exponential-0.02", "pendulum-bilinear-0.02")
@pytest.mark.parametrize("dt", [0.001, 0.02])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["pendulum", "disturbed_pendulum"])
def test_no_run_errs_further(name: str, method: str, dt: float) -> None:
    """Beside a pendulum that swings from nearly above, its input at the declared rate now and again."""
    step = step_of(name, "high_gain", method, dt)
    known, beside = hg.error_bound(step, rates={u.name: RATE for u in step.inputs}), Beside(step)
    assert known.check.verdict is Verdict.PROVED, known
    assert known.settles is not None
    first, x, seen = round(known.settles / dt), np.array([2.8, *[0.0] * (beside.form.n - 1)]), 0 * left(step)
    (y,) = beside.form.system.outputs
    for k in range(first + round(1.5 / dt)):
        u, after = (np.array([np.sin(RATE * at * dt) for _ in step.inputs]) for at in (k, k + 1))
        memory = beside.machine.memory
        memory[Place("output", y.name)][0] = x[0]
        for signal, value in zip(step.inputs, u, strict=True):
            memory[Place("input", signal.name)][0] = value
        beside.machine.call()
        errors = np.array([memory[Place("estimate", state)][0] for state in known.bounds]) - x
        seen = np.maximum(seen, np.abs(errors)) if k >= first else seen
        x = beside.after(x, u, (after - u) / dt)
    bounds = np.array(list(known.bounds.values()))
    assert (seen <= 1.1 * bounds).all()
    assert name != "pendulum" or (seen > bounds / 20).all()  # the ranges of the other are far wider than its swing


def single(method: str, slope: float = 0) -> hg.Step:
    """x' = u + slope x, at theta = 20 with a pole at -1: L = -20."""
    x, u = hg.Signal("x", low=-1, high=1), hg.Signal("u", low=-1, high=1)
    plant = hg.System("single", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=[u + slope * x], output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=[-1])
    return hg.sample(observer, getattr(hg.methods, method), dt=0.02)


def test_of_an_integrator_the_bilinear_rule_leaves_nothing() -> None:
    """Its second derivative is constant, its third is 0."""
    assert left(single("bilinear")) == [0]


def test_of_an_integrator_the_exponential_leaves_what_the_sample_bends() -> None:
    """|y''| <= 5 through 20 exp(-20 s) s (h - s)/2, and the rest, which is on a line, nothing."""
    step = single("exponential")
    whole, _ = quad(lambda s: RATE * 20 * np.exp(-20 * s) * s * (step.dt - s) / 2, 0, step.dt)
    assert whole / step.dt <= left(step)[0] < 1.1 * whole / step.dt


def nilpotent(source: Fraction, lifted: int, bent: int, rest: int) -> Any:
    """A plant's step of length 1 beside that of L = [0, 1; 0, 0], of which exp(s L) = [1, s; 0, 1]: by one sample that
    enters as (source, 1), and one state; derivatives of what is injected, and of the rest, are as large as said."""
    return SimpleNamespace(
        L=rational([[0, 1], [0, 0]]),
        h=number(Fraction(1)),
        plant=SimpleNamespace(h=Fraction(1), flow=bent, nonlinear_part=rest),
        sample_input=rational([[source], [Fraction(1)]]),
        lifted=rational([[0], [lifted]]),
        most=lambda order, size: rational([size]),
    )


def test_the_integral_of_what_changes_its_sign_is_from_above() -> None:
    """|s - c| s (1 - s)/2, c in the middle of a piece, where its size is least."""
    c = Fraction(9, 16)
    whole, _ = quad(lambda s: abs(s - c) * s * (1 - s) / 2, 0, 1, points=[float(c)])
    assert whole <= float(by_matrix_exponential(nilpotent(-c, 0, 1, 0))[0]) < 1.5 * whole


def test_what_the_polynomials_of_a_program_leave_counts() -> None:
    """2^-56 of 1 + h |L|/2, on a state whose rate moves at up to 1, which no sample shows."""
    step = nilpotent(Fraction(0), 1, 1, 0)
    step.sample_input = 0 * step.sample_input
    assert [float(size) for size in by_matrix_exponential(step)] == [1.5 * 2**-56, 1.5 * 2**-56]


def test_a_rest_that_rises_counts_by_all_of_its_slope() -> None:
    """Of z' = u + 10 z both z'' and b' are 5 + 10 (1 + 10) at most, and the third derivative ten times that."""
    step = single("bilinear", 10)
    h, most, resolvent = step.dt, 115, 1 / (1 + 20 * step.dt / 2)
    alpha = resolvent * h**3 / 12 * 10 * most
    ahead = alpha + h * resolvent / 2 * h * most
    assert left(step)[0] == pytest.approx((alpha + h * resolvent / 2 * 10 * ahead) / h, rel=1e-2)


def test_an_input_that_is_held_leaves_the_plant_a_parabola() -> None:
    step = single("bilinear")
    held = hg.sample(step.observer, step.method, dt=0.02, between="hold")
    known = hg.error_bound(held, noise={"y": 0.01})
    assert list(known.shares) == ["noise"]


# --- what cannot be bounded -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("flow", "output", "said"),
    [
        (lambda x1, x2, u: [x2, u - sp.sin(x1)], lambda x1, u: x1 + u, "reads an input"),
    ],
)
def test_what_has_no_bound_is_said(method: str, flow: Any, output: Any, said: str) -> None:
    x1, x2, u = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2", "u"))
    plant = hg.System(
        "plant", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow(x1, x2, u), output=[output(x1, u)]
    )
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=(-1, -1))
    known = hg.error_bound(hg.sample(observer, getattr(hg.methods, method), dt=1e-2), rates={"u": RATE})
    assert known.check.verdict is Verdict.UNKNOWN
    assert said in str(known.check.reason)


# --- verified again ---------------------------------------------------------------------------------------------------


@cache
def certified(method: str) -> dict[str, Any]:
    step = step_of("pendulum", "high_gain", method, 0.02)
    known = hg.error_bound(step, noise={"y": 1e-3}, disturbance={"w": 0.2}, rates={"tau": RATE})
    return hg.certificate(step.observer.form, (*step.observer.checks, known.check), "high_gain")


def verdict(content: dict[str, Any]) -> str:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".error"))
    return row.found


@pytest.mark.ordinary("bilinear")
@pytest.mark.parametrize("method", METHODS)
def test_the_bounds_are_verified_again(method: str) -> None:
    content = copy.deepcopy(certified(method))
    assert verdict(content) == "verified"
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    (share,) = (each for each in claim["evidence"]["shares"] if each["inputs"] == "method")
    assert len(share["fields"]) == 2
    assert share["samples"] == share["stages"] == share["beside"] == []
    share["fields"][1] = str(Fraction(share["fields"][1]) * 2)
    assert verdict(content) == "fails"
