"""What is compared: steps of filters, on plants whose form has the plant's own states, and the records they run on."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import emitted
import numpy as np
import plants
import sympy as sp
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.extras.costs import with_faults

SAMPLES = 1200  # of a record


@dataclass(frozen=True)
class Case:
    """A step, with what its filter is made of, so that a peer can do the same: `Q` (n) and `R` (p) diagonal; `start`:
    of the plant, whose motion is the record; `method`: that which peers repeat, empty where none does."""

    name: str
    step: hg.Step
    start: tuple[float, ...]
    method: str = ""
    Q: tuple[float, ...] = ()
    R: tuple[float, ...] = ()

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.states)

    @property
    def unguarded(self) -> "Case":
        """The same without guards, as peers are."""
        made = self.step
        step = hg.sample(made.observer, made.method, made.dt, between=made.clock.between, guards="none")
        return replace(self, step=step)

    @property
    def plant(self) -> hg.System:
        """The plant."""
        return self.step.observer.form.system

    @property
    def states(self) -> tuple[sp.Symbol, ...]:
        """The plant's states, the filter's coordinates."""
        return tuple(self.plant.states)

    @property
    def inputs(self) -> tuple[sp.Symbol, ...]:
        """The plant's inputs."""
        return tuple(self.plant.inputs)

    @cached_property
    def flow(self) -> sp.Matrix:
        """x' (n, 1), with the parameters' values."""
        return sp.Matrix(self.plant.flow).subs(self.plant.nominal)

    @cached_property
    def output(self) -> sp.Matrix:
        """y (p, 1)."""
        return sp.Matrix(self.plant.output).subs(self.plant.nominal)

    @cached_property
    def quiet(self) -> np.ndarray:
        """Rows (N, m + p) of the inputs and outputs of the plant itself, with little noise."""
        draw, dt = np.random.default_rng(7), self.step.dt
        symbols = (*self.states, *self.inputs)
        rate, read = (sp.lambdify([symbols], list(rows)) for rows in (self.flow, self.output))
        u = np.array([[_wave(k, i) for i in range(len(self.inputs))] for k in range(SAMPLES)])

        def at(t: float, x: np.ndarray) -> list[float]:
            k = min(int(t / dt), SAMPLES - 2)
            return rate([*x, *(u[k] + (t / dt - k) * (u[k + 1] - u[k]))])

        times = dt * np.arange(SAMPLES)
        x = solve_ivp(at, (0, times[-1]), self.start, t_eval=times, rtol=1e-8, atol=1e-10, max_step=5 * dt).y.T
        y = np.array([read([*each, *now]) for each, now in zip(x, u, strict=True)])
        return np.concatenate([u, y + 1e-3 * draw.normal(size=y.shape)], axis=1)

    @cached_property
    def hostile(self) -> np.ndarray:
        """The same rows with what a sensor and a bus do at their worst: gaps, numbers that are none, jumps."""
        return with_faults(self.quiet)


def _wave(k: int, i: int) -> float:
    return float(0.8 * np.sin(0.013 * k + i) + 0.1)


def _filter(name: str, plant: hg.System, method: str, start: tuple[float, ...]) -> Case:
    Q, R = (0.1,) * len(plant.states), (0.01,) * len(plant.outputs)
    observer = hg.observers.riccati(hg.forms.original(plant), Q=Q, R=R)
    return Case(name, hg.sample(observer, getattr(hg.methods, method), 1e-2), start, method, Q, R)


def chain(n: int) -> hg.System:
    """x_i' = x_(i+1) + sin(x_i) x_1, x_n' = sum cos(x_i) + u, and what holds it near 0."""
    x = [hg.Signal(f"x{i}", low=-10, high=10) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-2, high=2), hg.Signal("y", low=-20, high=20)
    rows = [b - 2 * a + sp.sin(a) * x[0] for a, b in pairwise(x)]
    flow = [*rows, sum(map(sp.cos, x)) / n - 2 * x[-1] + u]
    return hg.System(f"chain{n}", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])


def dense(n: int = 6) -> hg.System:
    """Each state moves each other one."""
    x = [hg.Signal(f"x{i}", low=-10, high=10) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-2, high=2), hg.Signal("y", low=-20, high=20)
    flow = [sum(sp.sin(a + k * b) for b in x) / n - 2 * a + u for k, a in enumerate(x, 1)]
    return hg.System("dense", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])


def arrow(n: int = 8) -> hg.System:
    """Each state moves the first, which moves each."""
    x = [hg.Signal(f"x{i}", low=-10, high=10) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-2, high=2), hg.Signal("y", low=-20, high=20)
    flow = [sum(map(sp.sin, x[1:])) / n - x[0] + u, *(x[0] * sp.cos(a) - k * a for k, a in enumerate(x[1:], 1))]
    return hg.System("arrow", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])


def two_outputs() -> hg.System:
    """A pendulum on a slow base, both measured."""
    x = [hg.Signal(f"x{i}", low=-10, high=10) for i in range(1, 5)]
    u, y = hg.Signal("u", low=-2, high=2), [hg.Signal(f"y{i}", low=-20, high=20) for i in (1, 2)]
    flow = [x[1], -sp.sin(x[0]) - x[1] / 5 + x[3] / 4, x[3], -x[2] - x[3] / 3 + u]
    return hg.System("two_outputs", states=x, inputs=(u,), outputs=y, flow=flow, output=[x[0], x[2]])


DEFAULT, INTEGRATED = "continuous_discrete", "rk4_covariance"
NEURON = (1.0, 0.5, 0.2)
CASES: Mapping[str, Callable[[], Case]] = {
    "adaptive": lambda: Case("adaptive", emitted.step("fitzhugh_nagumo"), NEURON),
    "default": lambda: _filter("default", plants.model("fitzhugh_nagumo"), DEFAULT, NEURON),
    "rk4_covariance": lambda: _filter("rk4_covariance", plants.model("fitzhugh_nagumo"), INTEGRATED, NEURON),
    "chain10": lambda: _filter("chain10", chain(10), DEFAULT, (0.5,) * 10),
    "chain20": lambda: _filter("chain20", chain(20), DEFAULT, (0.5,) * 20),
    "chain40": lambda: _filter("chain40", chain(40), DEFAULT, (0.5,) * 40),
    "dense6": lambda: _filter("dense6", dense(), DEFAULT, (0.5,) * 6),
    "arrow8": lambda: _filter("arrow8", arrow(), DEFAULT, (0.5,) * 8),
    "two_outputs": lambda: _filter("two_outputs", two_outputs(), DEFAULT, (0.5, 0.0, 0.0, 0.0)),
}
