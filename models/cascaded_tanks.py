"""Cascaded tanks: a pump fills an upper tank, which empties into a lower one, whose level is measured.

x1' = -k1 sqrt(x1) + k4 u,  x2' = k2 sqrt(x1) - k3 sqrt(x2),  y = x2,  levels from 0 to 10.

In w = sqrt(x1) the plant is triangular: x2' = k2 w - k3 sqrt(x2), w' = -k1/2 + k4 u/(2 w). The constants were
identified on the estimation half of the cascaded-tanks benchmark (Schoukens, Noel 2017). The upper level is measured
by nothing: its scale is fixed by k1 = k2, equal cross-sections, and known to a factor of about 1.4 only. The overflow
of the upper tank is not in the model; while it lasts the estimated upper level is too high.
"""

from typing import Any

import sympy as sp

import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Settled, Trial, t

x1 = hg.Signal("x1", "", "upper level", 3.0713, low=0.2704, high=10)
x2 = hg.Signal("x2", "", "lower level", 5.0, low=0.25, high=11)
w = hg.Signal("w", "", "square root of the upper level", low=0.52, high=3.1623)
u = hg.Signal("u", "V", "pump voltage", 3.0, low=0, high=7)
y = hg.Signal("y", "", "measured lower level", low=0, high=10)
k1 = hg.Signal("k1", "1/s", "outflow of the upper tank", 0.05646)
k2 = hg.Signal("k2", "1/s", "inflow of the lower tank", 0.05646)
k3 = hg.Signal("k3", "1/s", "outflow of the lower tank", 0.04425)
k4 = hg.Signal("k4", "1/(V s)", "pump", 0.03715)

plant = hg.System(
    "cascaded_tanks",
    states=(x1, x2),
    inputs=(u,),
    outputs=(y,),
    parameters=(k1, k2, k3, k4),
    flow=[-k1 * sp.sqrt(x1) + k4 * u, k2 * sp.sqrt(x1) - k3 * sp.sqrt(x2)],
    output=[x2],
)


def form(plant: hg.System) -> hg.Form:
    """Triangular, in w = sqrt(x1)."""
    return hg.forms.triangular(hg.recast(plant, {w: sp.sqrt(x1)}, {x1: w**2}))


gains = {
    "Q": {"x2": 1e-4, "w": 1.4e-3},
    "R": 1.6e-3,
    "covariance": {"x2": 0.25, "w": 0.25},
    # gamma_0 is set by the error of the model, the overflow above all, not by the noise of the sensor
    "theta": hg.theta.adaptive(
        2.0,
        rise_time=4.0,
        rate=0.25,
        mu=(0.7, 1.0),
        innovation=hg.innovation.staggered(32.0, predictors=4),
    ),
}
# Poles at 20 s, since a theta is at least 1; K, P, sigma of adaptive_lmi are the pendulum's with time slowed as much.
EVERY: dict[str, Any] = {"form": form, "dt": 1.0}
SLOW = {"poles": (-0.05, -0.05)}
tuning: dict[str, dict[str, Any]] = {
    "riccati": {"form": form, "dt": 4.0, **gains},
    "decaying": {"kind": "riccati", "form": form, "dt": 4.0, **gains, "theta": hg.theta.decaying(2.0, 0.02)},
    "bank": {"member": "decaying", "count": 3, "period": 80.0, "dt": 4.0},
    "hamilton_jacobi": {"form": form, "dt": 4.0, "Q": {"x2": 1e4, "w": 700.0}, "R": 600.0, "P0": {"x2": 4.0, "w": 4.0}},
    "high_gain": {**EVERY, **SLOW, "theta": 2},
    "low_power": {**EVERY, **SLOW, "theta": 2},
    "peaking_free": {**EVERY, **SLOW, "theta": 2, "last": 0.05},
    "cascade": {**EVERY, **SLOW, "theta": 4},
    "filtered": {**EVERY, **SLOW, "theta": 4, "alpha": 0.15, "beta": 0.05},
    "filtered_injection": {
        **EVERY,
        "theta": 4,
        "F": ((-0.15, 0), (0.05, -0.15)),
        "G": (0.05, 0),
        "H": ((0.1, 0), (0, 0.0025)),
    },
    "switched_gain": {**EVERY, **SLOW, "theta": 4, "theta_low": 1, "threshold": 0.1, "hold": 20},
    "updated_gain": {**EVERY, **SLOW, "p_1": 0.02, "p_2": 2, "p_3": 0.02, "cap": 8},
    "stubborn": {**EVERY, **SLOW, "theta": 2, "decay": 0.05, "r": 0.3},
    "dead_zone": {**EVERY, **SLOW, "theta": 2, "decay": 0.1, "r": 0.03},
    "lambda_tracking": {
        **EVERY,
        **SLOW,
        "k_0": 2,
        "k_max": 8,
        "gamma": 0.1,
        "strip": 0.08,
        "reach": 2,
        "model": True,
    },
    "adaptive_lmi": {
        **EVERY,
        "gamma": (1.5, 6),
        "K": (0.1, 0.0025),
        "P": ((10.4, -263), (-263, 13104)),
        "sigma": 0.005,
        "rise": 1,
        "threshold": 0.1,
    },
}


def step(**changes: object) -> hg.Step:
    """The observer at the sampling period of the benchmark, 4 s; `changes` replace gains."""
    observer = hg.observers.riccati(form(plant), **{**gains, **changes})
    return hg.sample(observer, hg.methods.continuous_discrete, dt=4.0)


def trial() -> Trial:
    """A slow swing of the pump without overflow; the noise is the one that R = sigma^2 dt stands for."""
    return Trial(
        "swing",
        800,
        start={"x1": 4, "x2": 3},
        inputs={"u": 3 + sp.sin(t / 40)},
        noise={"y": OrnsteinUhlenbeck(sigma=0.02)},
        settled=Settled("x1", band=0.3, hold=40),
        seeds=tuple(range(4)),
    )
