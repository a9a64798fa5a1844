"""A driven pendulum, angle measured, rate estimated: q' = w, w' = -a sin q - b w + tau, y = q."""

import sympy as sp

import hgogen as hg
from hgogen.trial import Jump, OrnsteinUhlenbeck, Settled, Trial, t

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

tuning = {
    "adaptive_lmi": {
        "gamma": (16, 60),
        "K": (2, 1),
        "P": ((10.4, -13.15), (-13.15, 32.76)),
        "sigma": 0.1,
        "rise": 50,
        "threshold": 0.01,
    },
    "filtered": {"theta": 20, "alpha": 3, "beta": 1, "poles": (-1, -1)},
    "filtered_injection": {"theta": 20, "F": ((-3, 0), (1, -3)), "G": (1, 0), "H": ((2, 0), (0, 1))},
    "high_gain": {"theta": 20, "poles": (-1, -1)},
    "circle_criterion": {"theta": 20, "poles": (-1, -1)},  # the sine is of the measured angle
    "kalman_like": {"form": "state_affine", "rho": 5, "R": 1e-9},  # R: the encoder's variance times dt
    "low_power": {"theta": 20},
    "peaking_free": {"theta": 20},
    "cascade": {"theta": 100},
    "riccati": {"Q": {"q": 1e-7, "w": 1e-3}, "R": 1e-9},  # R = v dt for samples of variance v = 1e-6
    "decaying": {"kind": "riccati", "Q": {"q": 1e-7, "w": 1e-3}, "R": 1e-9, "theta": hg.theta.decaying(8.0, rate=1.0)},
    "bank": {"member": "decaying", "count": 3, "period": 1.0},
    "hamilton_jacobi": {"Q": {"q": 1e4, "w": 1.0}, "R": 1e9},  # R is the inverse of riccati's
    "switched_gain": {"theta": 40, "theta_low": 10, "threshold": 0.01, "hold": 0.2, "poles": (-1, -1)},
    "lambda_tracking": {
        "k_0": 5,
        "k_max": 100,
        "gamma": 1e3,
        "strip": 0.005,
        "reach": 0.5,
        "poles": (-1, -1),
        "model": True,
    },
    "updated_gain": {"p_1": 0.15, "p_2": 5, "p_3": 6, "cap": 100, "poles": (-1, -1)},
    "stubborn": {"theta": 20, "decay": 0.5, "r": 3, "poles": (-1, -1)},
    "dead_zone": {"theta": 20, "decay": 1, "r": 0.3, "poles": (-1, -1)},
}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    observer = hg.observers.high_gain(form, **tuning["high_gain"])
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)


def trial() -> Trial:
    """A swing under a slow drive, knocked once; the encoder errs by a milliradian."""
    return Trial(
        "knock",
        10,
        start={"q": 1, "w": 0},
        inputs={"tau": sp.sin(t)},
        noise={"y": OrnsteinUhlenbeck(sigma=1e-3, tau=0)},
        jumps=(Jump(5, "w", 3),),
        settled=Settled("w", band=0.5, hold=0.5),
    )
