"""Steps whose C the tests compile, and what they need to compile and run it."""

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import plants
import pytest
import sympy as sp

import hgogen as hg
from hgogen.extras.costs import M4F as M4F
from hgogen.model import load
from hgogen.program import Field, lines_of
from hgogen.run.native import WARNINGS, with_main
from hgogen.stepping.reports import REPORTS

HERE = Path(__file__).parent
M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")


def signals(names: str, low: float = -10, high: float = 10) -> list[hg.Signal]:
    return [hg.Signal(name, low=low, high=high) for name in names.split()]


# --- steps --------------------------------------------------------------------------------------------------


def shipped(name: str) -> hg.Step:
    return load(plants.MODELS / f"{name}.py").step()


def two_outputs() -> hg.Step:
    form = hg.forms.original(plants.two_outputs())
    return hg.sample(hg.observers.riccati(form, Q=[0.1] * 3, R=[0.1, 0.2]), dt=0.01)


def no_input() -> hg.Step:
    """The paper's window and sigmoid, on an oscillator."""
    a, b, y = signals("a b y")
    plant = hg.System("no_input", states=(a, b), outputs=(y,), flow=[b, (1 - a**2) * b - a], output=[a])
    theta = hg.theta.adaptive(3, mu=hg.theta.logistic(0.1, 100), innovation=hg.innovation.window(0.2))
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[0.1, 0.1], R=0.1, theta=theta), dt=0.01)


def window_held() -> hg.Step:
    """A window with an input that is held, sampled unevenly with the restarts."""
    theta = hg.theta.adaptive(2, mu=hg.theta.smoothstep(0.01, 0.05), innovation=hg.innovation.window(0.1))
    observer = hg.observers.riccati(hg.forms.triangular(plants.chain(2)), Q=[0.1, 0.1], R=0.1, theta=theta)
    return hg.sample(observer, dt=0.02, between="hold")


def one_state() -> hg.Step:
    """One of everything, and theta that decays."""
    a, u, y = signals("a u y")
    plant = hg.System("one_state", states=(a,), inputs=(u,), outputs=(y,), flow=[-a + u], output=[2 * a])
    form = hg.forms.triangular(plant)
    return hg.sample(hg.observers.riccati(form, Q=[0.1], R=0.1, theta=hg.theta.decaying(3, 1)), dt=0.01)


def many_states() -> hg.Step:
    """Too many to unroll: kernels."""
    observer = hg.observers.riccati(hg.forms.triangular(plants.chain(12)), Q=[0.1] * 12, R=1.0)
    return hg.sample(observer, dt=0.01)


def coupled(n: int, **options: Any) -> hg.Step:
    """Rows alike with numbers that differ, a long sum, products of neighbours, and an own range for each state."""
    x = [hg.Signal(f"x{i}", low=-5 - i % 3, high=5 + i / 4) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-2, high=2), hg.Signal("y", low=-20, high=20)
    rows = [b - (1 + k / 8) * a + sp.sin(a) * x[0] for k, (a, b) in enumerate(pairwise(x))]
    flow = [*rows, sum(a * b for a, b in pairwise(x)) / 50 + sum(map(sp.cos, x)) / n - 2 * x[-1] + u]
    plant = hg.System("coupled", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0] + x[-1] / 4])
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.staggered(0.1, predictors=2))
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.1 + k / 64 for k in range(n)], R=0.01, theta=theta)
    return hg.sample(observer, dt=0.01, **options)


def integrated() -> hg.Step:
    """The covariance equation by Runge-Kutta, which integrates with the measurement."""
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.staggered(0.2, predictors=2))
    observer = hg.observers.riccati(hg.forms.triangular(plants.chain(2)), Q=[0.1, 0.1], R=0.1, theta=theta)
    return hg.sample(observer, hg.methods.rk4_covariance, dt=0.01)


def exponential() -> hg.Step:
    """The matrix exponential, a kernel, in tune."""
    observer = hg.observers.high_gain(hg.forms.triangular(plants.chain(2)), theta=5, poles=(-1, -1))
    return hg.sample(observer, hg.methods.exponential, dt=0.01)


def bank() -> hg.Step:
    """Structs in structs, and sensors that say when they sampled."""
    a, b, y, v = signals("a b y v")
    plant = hg.System("bank", states=(a, b), outputs=(y, v), flow=[b, -sp.sin(a) - b / 5], output=[a, b])
    member = hg.observers.riccati(hg.forms.original(plant), Q=[0.1, 0.1], R=[0.1, 0.2])
    score = hg.innovation.staggered(0.08, predictors=2)
    around = hg.observers.bank(member, count=3, period=0.1, innovation=score)
    return hg.sample(around, dt=0.01, periods={"v": 0.02})


def delayed() -> hg.Step:
    """Samples that come late, each with its age, and theta that adapts by predictors, which go back with it."""
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.staggered(0.2, predictors=2))
    observer = hg.observers.riccati(hg.forms.triangular(plants.chain(2)), Q=[0.1, 0.1], R=0.1, theta=theta)
    return hg.sample(hg.delayed(observer, y=3), dt=0.02)


def tunable() -> hg.Step:
    """A parameter of the plant that is tuned and has the name of a gain."""
    a, b, y = signals("a b y")
    u, R = hg.Signal("u", low=-1, high=1), hg.Signal("R", "1/s", "rate", 2.0, low=1, high=3)
    flow = [R * b, -sp.sin(a) * R + u]
    plant = hg.System("tunable", states=(a, b), inputs=(u,), outputs=(y,), parameters=(R,), flow=flow, output=[a])
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1, 1], R=1), dt=0.01)


def names(system: str) -> hg.Step:
    """Signals that have the names of our locals, members and functions."""
    s, p, z1, t1, k, y1, status = signals("s p z1 t1 k y1 status")
    i, theta = hg.Signal("i", "", "a parameter", 2.0, low=1, high=3), hg.Signal("theta", "", "", 1.0, low=0.5, high=2)
    flow = [p, -theta * sp.sin(s) + z1, -i * z1 + y1 * k, -y1 + t1]
    plant = hg.System(
        system, states=(s, p, z1, y1), inputs=(t1, k), outputs=(status,), parameters=(i, theta), flow=flow, output=[s]
    )
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 4, R=1), dt=0.01)


def functions() -> hg.Step:
    """Every function that a model may use."""
    third = sp.Rational(1, 3)
    terms = [
        lambda a, b: sp.tan(a / 4) + sp.atan(b) + sp.sqrt(4 + b),
        lambda a, b: sp.asin(a / 4) - sp.acos(b / 4),
        lambda a, b: sp.sinh(a / 3) - sp.cosh(b / 3) + sp.exp(-(a**2)),
        lambda a, b: sp.tanh(a) + sp.asinh(b) - sp.log(4 + a),
        lambda a, b: sp.acosh(2 + a**2) + sp.atanh(b / 4),
        lambda a, b: (4 + a) ** third + sp.atan2(a, 4 + b) + sp.cos(b),
        lambda a, b: sp.Abs(a) - sp.sign(b) + sp.floor(a) + sp.Min(a, b) - sp.Max(a, 1),
    ]
    x = signals(" ".join(f"x{i}" for i in range(7)), -3, 3)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-3, high=3)
    flow = [term(a, b) / 4 - a for term, a, b in zip(terms, x, [*x[1:], u], strict=True)]
    flow[0] += sp.Piecewise((x[0], x[1] > 1), (-x[1], sp.And(x[1] > 0, x[2] < 0)), (0, True))
    plant = hg.System("functions", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 7, R=1), dt=0.01)


def tables() -> hg.Step:
    """Tables of both kinds and a map, with their slopes in the covariance, one of them turning round."""
    a, b, c = hg.Signal("a", low=-2, high=3), hg.Signal("b", low=-4, high=4), hg.Signal("c", low=-1, high=1)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-3, high=3)
    friction = hg.table(b, [-3, -0.5, -0.1, 0.1, 0.5, 3], [-2.3, -0.7, -1.0, 1.0, 0.7, 2.3], name="friction")
    spring = hg.table(a + c, [-2, -1, 0, 1.5, 4], [-3, -0.8, 0.1, 0.9, 5.5], kind="monotone", name="spring")
    sensor = hg.table(a, [-2.5, 0.3, 3.1], [-2, 0.1, 2.7], kind="monotone", name="sensor")
    drag = hg.table(
        (b, c), ([-3, 0, 1, 3], [-1, 0.5, 2]), [[1, 0.3, 0], [0, 0.1, 0], [0.7, 1, 3], [2, 1, 5]], name="drag"
    )
    flow = [b, u - friction - spring - drag, (a - c) / 4]
    plant = hg.System("tables", states=(a, b, c), inputs=(u,), outputs=(y,), flow=flow, output=[sensor])
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[0.1] * 3, R=0.01), dt=0.01)


def redundant() -> hg.Step:
    """Two sensors of one state, and b limited in value in the place of its argument."""
    a, b, u, y, v = signals("a b u y v", -3, 3)
    flow = [b, -(a**3) - b + u]
    plant = hg.System("redundant", states=(a, b), inputs=(u,), outputs=(y, v), flow=flow, output=[a, 1 - 2 * a])
    form, gains = hg.forms.block_triangular(plant), {"weights": {"v": 3}, "saturate": 20, "arguments": False}
    return hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1), **gains), hg.methods.rk4, dt=0.01)


def bent() -> hg.Step:
    """The uniform form: a division by a slope, and a row that goes on along a line."""
    a, b, u, y = signals("a b u y", -1, 1)
    flow = [b + b**3 / 3, -sp.sin(a) + u]
    plant = hg.System("bent", states=(a, b), inputs=(u,), outputs=(y,), flow=flow, output=[a])
    observer = hg.observers.uniform_injection(hg.forms.uniform(plant), theta=5, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=0.01)


def chained(original: bool = False) -> hg.Step:
    """The uniform form as a chain of integrators: b behind a change of coordinates in which an input stands, whose rate
    is an input too; or in the plant's own, the gain behind the Jacobian of that change."""
    a, b, y = signals("a b y", -1, 1)
    u = hg.Signal("u", low=-1, high=1, rates=((-2, 2),))
    flow = [b + a * b / 4 + u * sp.cos(a) / 8, -sp.sin(b) + u]
    plant = hg.System("chained", states=(a, b), inputs=(u,), outputs=(y,), flow=flow, output=[2 * a])
    form = hg.forms.uniform_chain(plant, original=original)
    return hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1)), hg.methods.rk4, dt=0.01)


def two_injections() -> hg.Step:
    """The output error in the argument of b as well, of two chains by a matrix."""
    a, b, c, y, v = signals("a b c y v", -2, 2)
    flow = [2 * b, -4 * sp.sin(a) - b**3 / 2, a / 4 - c]
    plant = hg.System("two_injections", states=(a, b, c), outputs=(y, v), flow=flow, output=[3 * a, c / 2])
    gains = {"poles": ((-1, -1), (-1,)), "argument": ((0.25, 0), (-0.3, 0.1), (0, 1.5))}
    observer = hg.observers.circle_criterion(hg.forms.block_triangular(plant), theta=5, **gains)
    return hg.sample(observer, hg.methods.rk4, dt=0.01)


def wide() -> hg.Step:
    """More status bits than a 16-bit int has."""
    x, y = signals(" ".join(f"x{i}" for i in range(7))), signals(" ".join(f"y{i}" for i in range(7)))
    plant = hg.System("wide", states=x, outputs=y, flow=[-v for v in x], output=x)
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 7, R=[1] * 7), dt=0.01)


def wider() -> hg.Step:
    """More status bits than 32: sixteen outputs of two states, and inputs with ranges."""
    a, b, u, w = signals("a b u w", -2, 2)
    y = signals(" ".join(f"y{i}" for i in range(16)))
    read = [(1 + i / 8) * (a if i % 2 else b) for i in range(16)]
    plant = hg.System("wider", states=(a, b), inputs=(u, w), outputs=y, flow=[u - a, w - b], output=read)
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 2, R=[1] * 16), dt=0.01)


def held() -> hg.Step:
    """A rate with a pole in an input, one that is endlessly steep at 0, an output with a pole, all accepted."""
    a, b, y, v = signals("a b y v", -2, 2)
    w = hg.Signal("w", low=-1, high=1)
    flow = [b - a + 1 / w, -a - sp.sign(b) * sp.sqrt(sp.Abs(b))]
    plant = hg.System("held", states=(a, b), inputs=(w,), outputs=(y, v), flow=flow, output=[a, b / a])
    accept = ("singular.a", "singular.b", "singular.v", "original.lipschitz")
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 2, R=[1] * 2, accept=accept), dt=0.01)


def removable() -> hg.Step:
    """Quotients and logarithms with a limit where they are not defined, in the flow, its Jacobian and an output."""
    a, u, y = signals("a u y", -3, 3)
    b = hg.Signal("b", low=0, high=3)
    flow = [sp.sinc(a) - a + (1 - sp.cos(u)) / u**2, a * (sp.exp(u) - 1) / u - b]
    plant = hg.System("removable", states=(a, b), inputs=(u,), outputs=(y,), flow=flow, output=[a + b * sp.log(b) / 9])
    observer = hg.observers.ukf(hg.forms.original(plant), Q=[1] * 2, R=1, accept=("original.lipschitz",))
    return hg.sample(observer, dt=0.01)


def angle(name: str, **data: Any) -> hg.Signal:
    return hg.Signal(name, "rad", **{"period": 2 * np.pi, **data})


def angles() -> hg.Step:
    """A vehicle that turns: its heading by a compass, a bearing in its own frame, the wind's direction as an input."""
    px, py = signals("px py", -100, 100)
    psi, compass, bearing, wind = angle("psi"), angle("compass"), angle("bearing", low=0, high=2 * np.pi), angle("wind")
    v, w = hg.Signal("v", low=0, high=5), hg.Signal("w", low=-2, high=2)
    flow = [v * sp.cos(psi) + sp.cos(wind) / 4, v * sp.sin(psi) + sp.sin(wind) / 4, w]
    outputs, read = (compass, bearing), [psi, sp.atan2(py, px) - psi]
    plant = hg.System("angles", states=(px, py, psi), inputs=(v, w, wind), outputs=outputs, flow=flow, output=read)
    form = hg.forms.original(plant)
    accept = ("singular.bearing", "original.lipschitz", "original.order")
    observer = hg.observers.ukf(form, Q=[0.1, 0.1, 0.01], R=[1e-3, 1e-4], initial={"px": 20}, accept=accept)
    return hg.sample(observer, dt=0.05)


def angle_integrated() -> hg.Step:
    """A motor that turns, in degrees, by a method that integrates with its measurement."""
    th, y = hg.Signal("th", "deg", period=360, low=0, high=360), hg.Signal("y", "deg", period=360)
    w, u = signals("w u", -900, 900)
    flow = [w, -90 * sp.sin(sp.pi * th / 180) - w / 2 + u]
    plant = hg.System("angle_integrated", states=(th, w), inputs=(u,), outputs=(y,), flow=flow, output=[th])
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.window(0.05))
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=[1, 1], R=0.1, theta=theta)
    return hg.sample(observer, hg.methods.rk4, dt=0.01)


def unit_vector() -> hg.Step:
    """A direction in the plane by a vector sensor, and the bias of its gyro; the direction has length 1."""
    c, s, bias, rate = signals("c s bias rate", -1, 1)
    ahead, left = signals("ahead left", -1.5, 1.5)
    flow = [-s * (rate - bias), c * (rate - bias), 0]
    plant = hg.System(
        "unit_vector",
        states=(c, s, bias),
        inputs=(rate,),
        outputs=(ahead, left),
        flow=flow,
        output=[c, s],
        invariants=(c**2 + s**2 - 1,),
    )
    return hg.sample(hg.observers.ukf(hg.forms.original(plant), Q=[1e-4, 1e-4, 1e-4], R=1e-5), dt=0.02)


def hyperbola() -> hg.Step:
    """A motion along x^2 - y^2 = 1, which a step of Newton keeps, with P = L D L'."""
    x, y, seen = signals("x y seen", -9, 9)
    plant = hg.System(
        "hyperbola", states=(x, y), outputs=(seen,), flow=[y / 9, x / 9], output=[y], invariants=(x**2 - y**2 - 1,)
    )
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.1, 0.1], R=1e-3, initial={"x": 1})
    return hg.sample(observer, hg.methods.continuous_discrete, dt=0.05)


def gated() -> hg.Step:
    """A body in a plane, two outputs that pass a gate together and one whose R is raised."""
    states = signals("px py vx vy", -40, 40)
    px, py, vx, vy = states
    outputs = signals("x y rho", -40, 40)
    read = [px, py, sp.sqrt(px**2 + py**2 + 1)]
    flow = [vx, vy, -px / 4 - vx / 10, -py / 4 - vy / 10]
    plant = hg.System("gated", states=states, outputs=outputs, flow=flow, output=read)
    gate = {("x", "y"): hg.Gate(0.9, accept_after=3), "rho": hg.Gate(0.9, inflate=True)}
    accept = ("original.lipschitz", "original.order")
    form, gains = hg.forms.original(plant), {"Q": [0.1] * 4, "R": [0.1, 0.1, 0.2], "accept": accept}
    return hg.sample(hg.observers.riccati(form, gate=gate, **gains), dt=0.1)


def gated_points() -> hg.Step:
    """A gate of the unscented filter, whose output is not linear, with an input and samples that come late."""
    (q, w), (u, y) = signals("q w", -4, 4), signals("u y")
    flow = [w, u - 4 * sp.sin(q) - w / 4]
    plant = hg.System("gated_points", states=(q, w), inputs=(u,), outputs=(y,), flow=flow, output=[q + sp.sin(q) / 2])
    form, gate = hg.forms.original(plant), {"y": hg.Gate(0.9, accept_after=2)}
    accept = ("original.lipschitz", "original.order")
    return hg.sample(hg.delayed(hg.observers.ukf(form, Q=[0.1, 0.1], R=0.1, gate=gate, accept=accept), y=2), dt=0.05)


def gated_columns() -> hg.Step:
    """A gate of a covariance in loops."""
    gate = {"y": hg.Gate(0.9, accept_after=2)}
    observer = hg.observers.riccati(hg.forms.triangular(plants.chain(13)), Q=[0.1] * 13, R=1.0, gate=gate)
    return hg.sample(observer, dt=0.01)


def sure() -> hg.Step:
    """A step that reports how sure its estimate is."""
    q, w, y, v = signals("q w y v")
    plant = hg.System("sure", states=(q, w), outputs=(y, v), flow=[w, -sp.sin(q) - w / 5], output=[q, w + q / 4])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.3, 0.3], R=[0.02, 0.02])
    return hg.sample(observer, dt=0.02, report=REPORTS)


def noisy_inputs() -> hg.Step:
    """Noise of two inputs, of which one moves the state in a direction that depends on it, in loops."""
    x = [hg.Signal(f"x{i}", low=-9, high=9) for i in range(1, 6)]
    u, v = hg.Signal("u", low=-9, high=9), hg.Signal("v", low=-9, high=9)
    flow = [b - a for a, b in zip(x, [*x[1:], u], strict=True)]
    flow[1] += v * sp.cos(x[0])
    plant = hg.System("noisy", states=x, inputs=(u, v), outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])
    noise, accept = {"y": 0.1, "u": 0.5, "v": 0.2}, ("original.lipschitz", "original.order")
    observer = hg.observers.riccati(hg.forms.original(plant), noise=noise, Q=[1e-3] * 5, accept=accept)
    return hg.sample(observer, dt=0.05, prefer="flash")


def varying() -> hg.Step:
    """A filter that is given the time since the last call, with an input on a line between two calls."""
    a, b, y, v = signals("a b y v")
    u = hg.Signal("u", low=-1, high=1)
    plant = hg.System("varying", states=(a, b), inputs=(u,), outputs=(y, v), flow=[b, u - sp.sin(a) / 5], output=[a, b])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.1, 0.1], noise={"y": 0.2, "v": 0.5})
    return hg.sample(observer, dt=(0.01, 0.03), substeps=4)


def varying_integrated() -> hg.Step:
    """An observer that integrates with the measurement over the time since the last call, by loops in loops."""
    observer = hg.observers.high_gain(hg.forms.triangular(plants.chain(3)), theta=3, poles=(-1, -1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=(0.01, 0.02))


def varying_moving() -> hg.Step:
    """A theta that adapts and a function of time, over the time since the last call."""
    a, b, y = signals("a b y")
    u = hg.Signal("u", low=-1, high=1)
    flow = [b, u + sp.cos(9 * hg.t) - sp.sin(a) / 5]
    plant = hg.System("moving", states=(a, b), inputs=(u,), outputs=(y,), flow=flow, output=[a])
    theta = hg.theta.adaptive(3, mu=(0.01, 0.1), innovation=hg.innovation.staggered(0.2, 2))
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=[0.1, 0.1], noise={"y": 0.2}, theta=theta)
    return hg.sample(observer, dt=(0.01, 0.03), substeps=4)


def timed() -> hg.Step:
    """Two functions of time without a short common period, on an oscillator with an input."""
    q, v, u, y = (hg.Signal(name, low=-3, high=3) for name in ("q", "v", "u", "y"))
    force = sp.cos(2 * sp.pi * 5 * hg.t) + (1 + q / 9) * sp.sin(hg.t) + sp.Mod(hg.t, sp.Rational(1, 5))
    plant = hg.System("timed", states=(q, v), inputs=(u,), outputs=(y,), flow=[v, -4 * q - v + u + force], output=[q])
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[0.1, 0.1], R=1e-3), dt=0.01)


def sure_columns() -> hg.Step:
    """The standard deviations of the selected member of a bank, from the columns of its covariance."""
    member = hg.observers.riccati(hg.forms.triangular(plants.chain(4)), Q=[0.1] * 4, R=1.0)
    bank = hg.observers.bank(member, count=2, period=0.05)
    return hg.sample(bank, dt=0.01, prefer="flash", report=("sigma", "age"))


def uneven() -> hg.Step:
    """A sample whose variance is an expression of state, input and parameter, of an iterated filter."""
    (q, w), (u, y) = signals("q w", -4, 4), signals("u y")
    b = hg.Signal("b", nominal=0.1, low=0, high=1)
    flow, output = [w, u - 4 * sp.sin(q) - w / 4], [q + sp.sin(q) / 2]
    plant = hg.System("uneven", states=(q, w), inputs=(u,), outputs=(y,), parameters=(b,), flow=flow, output=output)
    accept, gains = ("original.lipschitz", "original.order"), {"Q": [0.1, 0.1], "R": {"y": "0.1 + (b*q)**2 + u**2"}}
    return hg.sample(hg.observers.iterated_ekf(hg.forms.original(plant), accept=accept, **gains), dt=0.05)


def joint(kind: str) -> hg.Step:
    """Samples that correct together, with correlated noises, of two outputs of which one is not linear."""
    (q, w), (u, y, v) = signals("q w", -4, 4), signals("u y v")
    flow, output = [w, u - 4 * sp.sin(q) - w / 4], [q + sp.sin(q) / 2, w + q / 4]
    plant = hg.System(f"joint_{kind}", states=(q, w), inputs=(u,), outputs=(y, v), flow=flow, output=output)
    gains = {"Q": [0.1, 0.1], "R": [[0.1, 0.03], [0.03, 0.2]], "update": "joint"}
    accept = ("original.lipschitz", "original.order")
    return hg.sample(getattr(hg.observers, kind)(hg.forms.original(plant), accept=accept, **gains), dt=0.05)


STEPS: Mapping[str, Callable[[], hg.Step]] = {
    "fitzhugh_nagumo": lambda: shipped("fitzhugh_nagumo"),
    "pendulum": lambda: shipped("pendulum"),
    "cascaded_tanks": lambda: shipped("cascaded_tanks"),
    "two": two_outputs,
    "no_input": no_input,
    "window_held": window_held,
    "one_state": one_state,
    "many_states": many_states,
    "coupled": lambda: coupled(11),
    "for_flash": lambda: coupled(5, prefer="flash"),
    "integrated": integrated,
    "exponential": exponential,
    "bank": bank,
    "delayed": delayed,
    "tunable": tunable,
    "sin": lambda: names("sin"),
    "x": lambda: names("x"),
    "functions": functions,
    "tables": tables,
    "wide": wide,
    "wider": wider,
    "redundant": redundant,
    "bent": bent,
    "chained": chained,
    "chained_in_x": lambda: chained(original=True),
    "two_injections": two_injections,
    "held": held,
    "removable": removable,
    "angles": angles,
    "angle_integrated": angle_integrated,
    "unit_vector": unit_vector,
    "hyperbola": hyperbola,
    "gated": gated,
    "gated_points": gated_points,
    "gated_columns": gated_columns,
    "sure": sure,
    "noisy_inputs": noisy_inputs,
    "uneven": uneven,
    "varying": varying,
    "varying_integrated": varying_integrated,
    "varying_moving": varying_moving,
    "sure_columns": sure_columns,
    **{f"joint_{kind}": partial(joint, kind) for kind in ("riccati", "ukf", "iterated_ekf")},
    "timed": timed,
}


@cache
def step(name: str) -> hg.Step:
    return STEPS[name]()


def elapsed(step: hg.Step) -> dict[str, float]:
    """What a call of a step is given besides its samples: the time since the last, where it varies."""
    return {"dt": step.dt} if step.clock.varying else {}


def begin(step: hg.Step) -> str:
    """The last argument of init and reset, for a plant with functions of t."""
    return ", 0" * len(step.code.time)


def files(name: str, real: str = "float") -> Mapping[str, str]:
    """The C of a step, with its self-check."""
    return _files(name, real)


def manual(files: Mapping[str, str]) -> str:
    """The text of NAME.md among files, in one line and without Markdown's escapes."""
    (text,) = (text for name, text in files.items() if name.endswith(".md"))
    return " ".join(text.replace("\\", "").split())


def crate(name: str, real: str = "float") -> str:
    """The Rust of a step."""
    return _crate(name, real)


@cache  # by both, whether the second was said or not
def _files(name: str, real: str) -> Mapping[str, str]:
    return hg.targets.c99(step(name), real=real)


@cache
def _crate(name: str, real: str) -> str:
    return hg.targets.rust(step(name), real=real, check=False)[f"{step(name).name}.rs"]


# --- tools --------------------------------------------------------------------------------------------------


def tool(name: str) -> str:
    """The path of a tool; the test is skipped where it is absent."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"there is no {name}")
    return path


def run(command: list[str], folder: Path, timeout: float = 300) -> str:
    """What a command prints; the test fails with it where the command fails."""
    settings = {"cwd": folder, "env": {**os.environ, "PWD": str(folder)}, "timeout": timeout}  # Frama-C goes by PWD
    done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-4000:]}{done.stderr[-4000:]}"
    return done.stdout + done.stderr


def compiled(compiler: str, texts: Mapping[str, str], folder: Path, *flags: str) -> Path:
    """An executable of the C files, every warning an error; a self-check among them is its program."""
    parsed(compiler, texts, folder, *flags, "-o", "program", "-lm")
    return folder / "program"


def parsed(compiler: str, texts: Mapping[str, str], folder: Path, *flags: str) -> None:
    """The C files as a compiler takes them with these flags, every warning an error."""
    hg.write(texts, folder)
    sources = [name for name in texts if name.endswith(".c")]
    run([compiler, "-std=c99", *WARNINGS, *with_main(texts), *sources, *flags], folder)


@dataclass(frozen=True)
class Element:
    """One number of the state, its C text as a member of `s`, and the box that a call leaves it in."""

    text: str
    field: Field
    low: float
    high: float


def elements(step: hg.Step) -> Iterator[Element]:
    """Every number of the state; one without a box of its own is of plausible size."""
    members = [("s.", step.layout.state)]
    for line in lines_of(step.layout.groups):
        starts = ["s."]
        for group in line:
            starts = [f"{start}{group.name}[{k}]." for start in starts for k in range(group.count)]
        members += [(start, line[-1].fields) for start in starts]
    for start, fields in members:
        for field in fields:
            for i, (low, high) in enumerate(field.box):
                index = f"[{i}]" if field.size > 1 else ""
                low = 0.0 if field.kind == "index" else low if low > -np.inf else -1e30
                yield Element(f"{start}{field.name}{index}", field, low, high if high < np.inf else 1e30)
