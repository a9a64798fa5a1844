"""A pendulum under an unknown torque that may jump, the example (91) of Alessandri 2020: the angle is measured, rate
and torque are estimated.

x1' = x2,  x2' = -0.5 sin x1 - 0.5 x2 + x3,  x3' = 0,  y = x1

Known answer, of the paper's K and P with sigma = 0.05, alpha = 50, d = 0.1, gamma in [20.53, 80], without noise from
x = (0, 0, 0.01) and the estimate (1, 1, 1), in continuous time: gamma turns at t = 0.00757026, 0.01507874, 0.01900230,
where it peaks at 36.0673, and is back at 20.53 at t = 0.438668; the errors peak at 1, 36.199 and 457.03; |e| is last
above 0.01 at t = 0.4829. The range of x2 is wide because the estimate passes through it on its way.
"""

import sympy as sp

import hgogen as hg
from hgogen.trial import Jump, OrnsteinUhlenbeck, Settled, Trial

x1, x2 = hg.Signal("x1", "rad", "angle", low=-4, high=4), hg.Signal("x2", "rad/s", "rate", low=-50, high=50)
x3 = hg.Signal("x3", "1/s2", "unknown torque over inertia", low=-5, high=5)
y = hg.Signal("y", "rad", "measured angle", low=-4, high=4)
a, b = hg.Signal("a", "1/s2", "gravity over length", 0.5), hg.Signal("b", "1/s", "damping", 0.5)

plant = hg.with_disturbance(
    hg.System(
        "disturbed_pendulum",
        states=(x1, x2),
        outputs=(y,),
        parameters=(a, b),
        flow=[x2, -a * sp.sin(x1) - b * x2],
        output=[x1],
    ),
    on="x2",
    signal=x3,
)

# of x^' = f(x^) + gain (y - x1^), poles at -2 without friction and gravity, under disturbances of all rates and of y
dissipation = {
    "gain": {"x1": 6, "x2": 12, "x3": 8},
    "V": ((4.9, -0.6, -2.5), (-0.6, 1.8, -1.5), (-2.5, -1.5, 4.1)),
    "mu": 30,
    "within": {"x1": 1, "x2": 3, "x3": 3},
}

START = {"x1": 1, "x2": 1, "x3": 1}
tuning = {
    "adaptive_lmi": {
        "gamma": (20.53, 80),
        "K": (8.9661, 16.5213, 9.1275),
        "P": ((1.2192, -0.6803, 0.1906), (-0.6803, 0.7829, -0.6874), (0.1906, -0.6874, 1.0244)),
        "sigma": 0.05,
        "rise": 50,
        "threshold": 0.1,
        "disturbance": (((0, 0), (0, 0), (0, 1)), (1, 0)),  # of the measurement, and of x3'
        "initial": START,
    },
    "kalman_like": {"form": "state_affine", "rho": 6, "R": 1e-9, "initial": START},
    "filtered": {"theta": 40, "alpha": 3, "beta": 1, "poles": (-1, -1, -1), "initial": START},
    "filtered_injection": {
        "theta": 40,
        "F": ((-3, 0, 0), (1, -3, 0), (0, 1, -3)),
        "G": (1, 0, 0),
        "H": ((3, 0, 0), (0, 3, 0), (0, 0, 1)),
        "initial": START,
    },
    "peaking_free": {"theta": 20, "initial": START},
    "cascade": {"theta": 40, "initial": START},
    "riccati": {
        "Q": {"x1": 1e-6, "x2": 1e-3, "x3": 10},
        "R": 1e-9,
        "covariance": {"x1": 1, "x2": 1000, "x3": 10},
        "initial": START,
    },
    "bank": {"member": "decaying", "count": 3, "period": 0.5},
    "hamilton_jacobi": {
        "Q": {"x1": 1e6, "x2": 1e3, "x3": 0.1},
        "R": 1e9,
        "P0": {"x1": 1, "x2": 1e-3, "x3": 0.1},
        "initial": START,
    },
    "high_gain": {"theta": 20, "poles": (-1, -1, -1), "initial": START},
    "circle_criterion": {  # of `hgogen design disturbed_pendulum --argument --rates 12`, the rate of high_gain
        "theta": 21,
        "gains": (1.8273, 1.13157, 0.236775),
        "argument": (1.01953, 1.27539, 0),
        "initial": START,
    },
    "low_power": {"theta": 10, "initial": START},
    "switched_gain": {
        "theta": 40,
        "theta_low": 10,
        "threshold": 0.01,
        "hold": 1.1,
        "poles": (-1, -1, -1),
        "initial": START,
    },
    "updated_gain": {"p_1": 0.035, "p_2": 10, "p_3": 1, "cap": 100, "poles": (-1, -1, -1), "initial": START},
    "stubborn": {"theta": 20, "decay": 0.5, "r": 10, "poles": (-1, -1, -1), "initial": START},
    "dead_zone": {"theta": 20, "decay": 1, "r": 0.1, "poles": (-1, -1, -1), "initial": START},
    "lambda_tracking": {
        "k_0": 2,
        "k_max": 100,
        "gamma": 1e3,
        "strip": 1e-3,
        "reach": 0.5,
        "poles": (-1, -1, -1),
        "model": True,
        "initial": START,
    },
}
tuning["decaying"] = {**tuning["riccati"], "kind": "riccati", "theta": hg.theta.decaying(8.0, 2.0)}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    observer = hg.observers.adaptive_lmi(form, **tuning["adaptive_lmi"])
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)


def trial() -> tuple[Trial, ...]:
    """The paper's first figure, without noise; and a torque that jumps, under the noise of an encoder."""
    return (
        Trial("quiet", 5, start={"x1": 0, "x2": 0, "x3": 0.01}, settled=Settled("x3", band=0.01, hold=0.5), seeds=(0,)),
        Trial(
            "torque",
            20,
            start={"x1": 0, "x2": 0, "x3": 0.01},
            noise={"y": OrnsteinUhlenbeck(sigma=1e-4, tau=0)},
            jumps=(Jump(10, "x3", 0.3),),
            settled=Settled("x3", band=0.2, hold=1),
        ),
    )
