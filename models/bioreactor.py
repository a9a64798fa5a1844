"""A bioreactor, the concentration of microorganisms measured, that of the substrate estimated; time in hours.

m' = a1 m s/(a2 m + s) - u m,  s' = -a3 a1 m s/(a2 m + s) - u s + a4 u,  y = m:  the example (15) of Bullinger,
Ilchmann, Allgoewer, NOLCOS 1998, from Bastin and Dochain 1990.

Phase form x1 = m, x2 = m': inverse s = a2 x1 (x2 + u x1)/(a1 x1 - x2 - u x1), which needs no u' and is 0/0 at (0, 0),
below the range of m, at whose edge it is taken there; det = a1 a2 m^2/(a2 m + s)^2. From xhat(0) = (0, 0) the gain of
lambda-tracking ends at k = .550380472 without noise, at .557 +- .003 with noise of standard deviation .005 held over a
sample of .01 h (.554 on lines between samples); the output error enters the strip at 3.23471 h and stays there. The
paper's k = .275 takes xhat_1(0) = .0341 or .1429. u steps, and x2 with it, so that phi is not bounded, as the paper's
theorem 2 asks.
"""

from typing import Any

import sympy as sp

import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Settled, Trial, t

m = hg.Signal("m", "g/l", "microorganisms", 0.075, low=0.01, high=0.15)
s = hg.Signal("s", "g/l", "substrate", 0.03, low=0.001, high=0.15)
u = hg.Signal("u", "1/h", "inflow rate", low=0.0, high=0.1)
y = hg.Signal("y", "g/l", "measured microorganisms", low=-0.05, high=0.25)
a1 = hg.Signal("a1", "1/h", "largest growth rate", 1.0)
a2 = hg.Signal("a2", "", "saturation of growth", 1.0)
a3 = hg.Signal("a3", "", "substrate that growth takes", 1.0)
a4 = hg.Signal("a4", "g/l", "substrate in the inflow", 0.1)

growth = a1 * m * s / (a2 * m + s)
plant = hg.System(
    "bioreactor",
    states=(m, s),
    inputs=(u,),
    outputs=(y,),
    parameters=(a1, a2, a3, a4),
    flow=[growth - u * m, -a3 * growth - u * s + a4 * u],
    output=[m],
    time="h",
)

PHASE: dict[str, Any] = {"form": "phase", "method": "rk4", "dt": 0.01}
TRACKING: dict[str, Any] = {
    "k_0": 0.1,
    "k_max": 5,
    "gamma": 100,
    "strip": 0.02,
    "reach": 0.5,
    "gains": (1, 0.2),
    "start": (0, 0),
}
tuning: dict[str, dict[str, Any]] = {
    "lambda_tracking": {**PHASE, **TRACKING},
    "lambda_tracking_model": {"kind": "lambda_tracking", **PHASE, **TRACKING, "model": True},
    "switched_gain": {**PHASE, "theta": 2, "theta_low": 1, "threshold": 0.02, "hold": 2, "gains": (0.6, 0.1)},
    "updated_gain": {**PHASE, "p_1": 0.15, "p_2": 1, "p_3": 0.05, "cap": 5, "gains": (1, 0.25)},
    "stubborn": {**PHASE, "theta": 1, "decay": 0.1, "r": 3, "gains": (1, 0.25)},
    "dead_zone": {**PHASE, "theta": 1, "decay": 0.2, "r": 0.06, "gains": (1, 0.25)},
    "low_power": {**PHASE, "theta": 1},
    "peaking_free": {**PHASE, "theta": 1},
    "cascade": {**PHASE, "theta": 2},
    "filtered": {**PHASE, "theta": 2, "alpha": 3, "beta": 1, "poles": (-1, -1)},
    "filtered_injection": {**PHASE, "theta": 2, "F": ((-3, 0), (1, -3)), "G": (1, 0), "H": ((2, 0), (0, 1))},
    "adaptive_lmi": {
        **PHASE,
        "gamma": (1, 4),
        "K": (2, 1),
        "P": ((10.4, -13.15), (-13.15, 32.76)),
        "sigma": 0.1,
        "rise": 5,
        "threshold": 0.02,
    },
    "high_gain": {"form": {"kind": "phase", "original": True}, "method": "rk4", "theta": 1, "poles": (-0.5, -0.5)},
    "riccati": {"form": "uniform", "Q": {"m": 1e-6, "s": 1e-6}, "R": 2.5e-7, "covariance": {"m": 0.1, "s": 0.1}},
    "bank": {"member": "decaying", "count": 3, "period": 10.0},
    "hamilton_jacobi": {"form": "uniform", "Q": {"m": 1e6, "s": 1e6}, "R": 4e6, "P0": {"m": 10, "s": 10}},
}
tuning["decaying"] = {**tuning["riccati"], "kind": "riccati", "theta": hg.theta.decaying(3.0, 0.1)}


def step() -> hg.Step:
    observer = hg.observers.lambda_tracking(hg.forms.phase(plant), **TRACKING)
    return hg.sample(observer, hg.methods.rk4, dt=PHASE["dt"])


def trial() -> Trial:
    """The paper's: the inflow is throttled from 30 h to 50 h."""
    return Trial(
        "throttled",
        100,
        start={"m": 0.075, "s": 0.03},
        estimate={"m": 0.06, "s": 0.06},
        inputs={"u": sp.Piecewise((0.08, t < 30), (0.02, t < 50), (0.08, True))},
        noise={"y": OrnsteinUhlenbeck(sigma=0.005, tau=0)},
        settled=Settled("s", band=0.005, hold=5),
    )
