"""A driven pendulum, angle measured, rate estimated: q' = w, w' = -a sin q - b w + tau, y = q."""

import sympy as sp

import hgogen as hg

q, w = hg.Signal("q", "rad", "angle", low=-4, high=4), hg.Signal("w", "rad/s", "rate", low=-20, high=20)
tau, y = hg.Signal("tau", "1/s2", "drive", low=-1, high=1), hg.Signal("y", "rad", "measured angle")
a, b = hg.Signal("a", "1/s2", "gravity over length", 19.6), hg.Signal("b", "1/s", "damping", 0.1)

plant = hg.System(
    "pendulum",
    states=(q, w),
    inputs=(tau,),
    outputs=(y,),
    parameters=(a, b),
    flow=[w, -a * sp.sin(q) - b * w + tau],
    output=[q],
)

tuning = {"high_gain": {"theta": 20, "poles": (-1, -1)}}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    observer = hg.observers.high_gain(form, **tuning["high_gain"])
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)
