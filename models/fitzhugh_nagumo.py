"""Modified FitzHugh-Nagumo neuron with an unknown parameter, the example (22) of Boizot, Busvelle, Gauthier
2010.

x1' = x1 - x1^3/3 - x2 u,  x2' = eps (3 sin x1 - x2 - eta),  eta' = 0,  y = x1,  u = sin t
"""

from typing import Any

import sympy as sp

import hgogen as hg
from hgogen.trial import Jump, OrnsteinUhlenbeck, Settled, Trial, t

x1 = hg.Signal("x1", "", "membrane potential", low=-3.5, high=3.5)
x2 = hg.Signal("x2", "", "recovery", low=-10, high=10)
eta = hg.Signal("eta", "", "slowly changing parameter", low=-8, high=8)
u = hg.Signal("u", "", "input", low=-1, high=1)
y = hg.Signal("y", "", "measured potential", low=-5, high=5)
eps = hg.Signal("eps", "", "ratio of time scales", 0.8)

plant = hg.System(
    "fitzhugh_nagumo",
    states=(x1, x2, eta),
    inputs=(u,),
    outputs=(y,),
    parameters=(eps,),
    flow=[x1 - x1**3 / 3 - x2 * u, eps * (3 * sp.sin(x1) - x2 - eta), 0],
    output=[x1],
)

tuning = {
    "riccati": {
        "Q": {"x1": 0.1, "x2": 0.01, "eta": 2.3e-4},
        "R": 1.0,
        "theta": hg.theta.adaptive(
            4.0,
            rise_time=0.1,
            rate=1.0,
            mu=(0.16, 0.32),
            innovation=hg.innovation.staggered(1.0, predictors=4),
        ),
        "accept": ("triangular.a_2",),
    },
    # a_2 = -u vanishes, and the plant is state-affine all the same: sin x1 and x1^3 are of the measured state
    "kalman_like": {
        "form": "state_affine",
        "rho": 0.3,
        "R": 0.008,  # 2 sigma^2 tau of the trial's noise
        "inputs": {"u": sp.sin(t)},
        "period": 2 * sp.pi,
    },
    # weights, not noises; theta is 1, which asks nothing of a_2: the plant's own coordinates do
    "hamilton_jacobi": {"form": "original", "Q": {"x1": 10.0, "x2": 100.0, "eta": 30.0}, "R": 125.0},
}
tuning["decaying"] = {**tuning["riccati"], "kind": "riccati", "theta": hg.theta.decaying(8.0, 0.1)}
tuning["bank"] = {"member": "decaying", "count": 5, "period": 10.0}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    observer = hg.observers.riccati(form, **tuning["riccati"])
    return hg.sample(observer, hg.methods.continuous_discrete, dt=0.01)


def trial() -> tuple[Trial, ...]:
    """The paper's two scenarios."""
    common: dict[str, Any] = {
        "start": {"x1": 1.06, "x2": 2.69, "eta": 5},
        "inputs": {"u": sp.sin(t)},
        "noise": {"y": OrnsteinUhlenbeck(sigma=0.2, tau=0.1)},
        "settled": Settled("eta", band=0.3, hold=3),
    }
    jumps = ((30, -6), (60, -3), (90, 5), (120, 5.2), (150, -6), (180, 3))
    return (
        Trial("one_jump", 100, jumps=(Jump(50, "eta", -6),), steady=75, **common),
        Trial("six_jumps", 210, jumps=tuple(Jump(when, "eta", value) for when, value in jumps), **common),
    )
