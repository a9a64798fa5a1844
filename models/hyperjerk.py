"""Chaotic hyperjerk system, the example (22) of Astolfi, Jungers, Zaccarian, ECC 2018.

x1' = x2, x2' = x3, x3' = x4, x4' = -x4 - 5.2 x3 - 2.7 x2 + 4.5 (x1^2 - 1), y = x1

From (-.9, 0, 0, 0) the orbit is bounded; from the paper's (.9, 0, 0, 0) it escapes in finite time, at t = 13.28.
Known answers, the error's amplitude of x1, .., x4 over that of a sinusoidal noise of frequency 100: .594, 1.438, 1.665,
.851 with the filtered observer (k = 10), 2.389, 23.9, 114.8, 255 with the standard one (k = 4).
"""

import hgogen as hg
from hgogen.trial import Settled, Sine, Trial

x1, x2 = hg.Signal("x1", "m", "position", low=-3, high=3), hg.Signal("x2", "m/s", "velocity", low=-4, high=4)
x3 = hg.Signal("x3", "m/s2", "acceleration", low=-6, high=6)
x4 = hg.Signal("x4", "m/s3", "jerk", low=-12, high=12)
y = hg.Signal("y", "m", "measured position")

plant = hg.System(
    "hyperjerk",
    states=(x1, x2, x3, x4),
    outputs=(y,),
    flow=[x2, x3, x4, -x4 - 5.2 * x3 - 2.7 * x2 + 4.5 * (x1**2 - 1)],
    output=[x1],
)

POLES = (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)
tuning = {
    "adaptive_lmi": {  # P is proved; gamma is far below the bound, as everybody's on this plant
        "gamma": (4, 12),
        "K": (6, 15, 18, 10),
        "P": (
            (9.6059086, -0.90238792, -2.6431891, 0.93186724),
            (-0.90238792, 3.1128452, -0.84678398, -1.861682),
            (-2.6431891, -0.84678398, 2.1002496, -0.85180627),
            (0.93186724, -1.861682, -0.85180627, 3.4455667),
        ),
        "sigma": 0.02,
        "rise": 20,
        "threshold": 0.3,
    },
    "filtered": {"theta": 10, "alpha": 3, "beta": 1, "poles": POLES},
    "filtered_sampled": {
        "kind": "filtered",
        "method": "exponential",
        "dt": 5e-3,
        "theta": 10,
        "alpha": 3,
        "beta": 1,
        "poles": POLES,
    },
    "filtered_injection": {
        "theta": 10,
        "F": ((-3, 0, 0, 0), (1, -3, 0, 0), (0, 1, -3, 0), (0, 0, 1, -3)),
        "G": (1, 0, 0, 0),
        "H": ((4, 0, 0, 0), (0, 6, 0, 0), (0, 0, 4, 0), (0, 0, 0, 1)),
    },
    "cascade": {"theta": 5},  # practical: the last row, which it does not know, is large here
    # a tone is no white noise: R stands for its power over the filter's bandwidth
    "riccati": {
        "Q": {"x1": 0.4, "x2": 0.6, "x3": 1, "x4": 6},
        "R": 1e-3,
        "covariance": {"x1": 9, "x2": 20, "x3": 40, "x4": 100},
    },
    "bank": {"member": "decaying", "count": 3, "period": 5.0},
    "hamilton_jacobi": {
        "Q": {"x1": 2.5, "x2": 1.7, "x3": 1, "x4": 0.17},
        "R": 1e3,
        "P0": {"x1": 0.11, "x2": 0.05, "x3": 0.025, "x4": 0.01},
    },
    "kalman_like": {"form": "state_affine", "rho": 2, "R": 1e-5},
    "high_gain": {"theta": 4, "poles": POLES},
    "circle_criterion": {  # of `hgogen design hyperjerk --argument --rates 2.14`, the rate of high_gain
        "theta": 8.6,
        "gains": (1.82227, 1.44178, 0.534989, 0.07863),
        "argument": (0.925614, 0.503875, 0.702349, 0.154261),
    },
    "low_power": {"theta": 4},
    "peaking_free": {"theta": 10},
    "low_power_sampled": {"kind": "low_power", "theta": 4, "method": "bilinear", "dt": 5e-3},
    "switched_gain": {"theta": 3, "theta_low": 1, "threshold": 0.3, "hold": 3, "poles": POLES},
    "updated_gain": {"p_1": 0.02, "p_2": 1, "p_3": 0.005, "cap": 10, "b": 2, "poles": POLES},
    "stubborn": {"theta": 4, "decay": 0.5, "r": 30, "poles": POLES},
    "dead_zone": {"theta": 4, "decay": 1, "r": 0.03, "poles": POLES},
    "lambda_tracking": {
        "k_0": 1,
        "k_max": 20,
        "gamma": 2,
        "strip": 0.15,
        "reach": 1,
        "poles": POLES,
        "model": True,
    },
}
tuning["decaying"] = {**tuning["riccati"], "kind": "riccati", "theta": hg.theta.decaying(3.0, 0.2)}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    observer = hg.observers.filtered(form, **tuning["filtered"])
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)


def trial() -> Trial:
    """The bounded orbit; the sensor's error is a tone."""
    return Trial(
        "tone",
        30,
        start={"x1": -0.9, "x2": 0, "x3": 0, "x4": 0},
        noise={"y": Sine(amplitude=0.1, omega=100)},
        settled=Settled("x4", band=0.5, hold=3),
        seeds=(0,),
    )
