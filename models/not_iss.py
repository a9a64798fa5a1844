"""A plant whose observer converges without disturbance and is not input-to-state stable, and one that uses w.

    x1' = -x1 + (1 + x2) w,   x2' = -2 x1^2 + 2 x1 (1 + x2) w,   y1 = x1 (1 + x2) w,   y2 = x2,   x2(0) = x1(0)^2 > 0

Not knowing w, the observer

    xhat1' = -xhat1 + (2 - xhat1/sqrt(y2)) xhat1 y1/(1 + y2),   xhat2' = -xhat2 + 2 y1 - y2

has the error e1' = -e1 + (1 + e1^2) w, e2' = -e2: without w it decays like exp(-t), but w = 1/sqrt(2 t + 2), which
tends to 0, drives e1 from sqrt(2) along e1 = sqrt(2 t + 2), exactly. So no V satisfies the Hamilton-Jacobi inequality
for all errors: with V = e1^2 + e2^2 and the gain mu it holds where (1 + e1^2)^2 < 3 mu^2/4, and fails beyond: with
mu = 2 it is proved for |e1| <= 0.8, and would be up to 0.855. Source:
Alessandri, "On Hamilton-Jacobi approaches to state reconstruction for dynamic systems", Mathematical Problems in
Engineering (2020), example 1.

An observer that is given w as an input has no such error; its second output bends, y1 with x1 x2, and so its covariance
may take the outputs' second derivatives.
"""

import sympy as sp

import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Trial, t

x1, x2 = hg.Signal("x1", "", "driven state", low=0, high=2), hg.Signal("x2", "", "its square", low=0, high=4)
w = hg.Signal("w", "1/s", "drive, the disturbance of the observer that does not know it", low=0, high=1)
y1, y2 = hg.Signal("y1", "1/s", "measured push"), hg.Signal("y2", "", "measured square")

plant = hg.System(
    "not_iss",
    states=(x1, x2),
    inputs=(w,),
    outputs=(y1, y2),
    flow=[-x1 + (1 + x2) * w, -2 * x1**2 + 2 * x1 * (1 + x2) * w],
    output=[x1 * (1 + x2) * w, x2],
)

# The observer that does not know w; on x2 = x1^2, which the plant keeps, with x1 > 0.
blind = {"x1": -x1 + (2 - x1 / sp.sqrt(y2)) * x1 * y1 / (1 + y2), "x2": -x2 + 2 * y1 - y2}
error = hg.observer_errors(plant, blind, unknown=(w,), along={"x2": x1**2})

dissipation = {"system": error, "V": "e_x1**2 + e_x2**2", "mu": 2, "within": (0.8, 2)}

tuning = {
    "hamilton_jacobi": {
        "form": "original",
        "method": "rk4_covariance",
        "dt": 0.01,
        "Q": {"x1": 10, "x2": 10},
        "R": 100,
        "P0": {"x1": 100, "x2": 100},
        "curvature": 5,
    },
    "riccati": {"form": "original", "dt": 0.01, "Q": {"x1": 1e-4, "x2": 1e-4}, "R": {"y1": 1e-6, "y2": 1e-6}},
    "bank": {"dt": 0.01, "member": "riccati", "count": 3, "period": 1.0},  # a member that restarts has P(0) again
}


def step() -> hg.Step:
    gains = {key: tuning["hamilton_jacobi"][key] for key in ("Q", "R", "P0", "curvature")}
    observer = hg.observers.hamilton_jacobi(hg.forms.original(plant), **gains)
    return hg.sample(observer, hg.methods.rk4_covariance, dt=0.01)


def trial() -> Trial:
    """The disturbance that tends to 0 and does not let the other observer converge."""
    return Trial(
        "fading drive",
        10,
        start={"x1": 0.5, "x2": 0.25},
        inputs={"w": 1 / sp.sqrt(2 * t + 2)},
        noise={"y1": OrnsteinUhlenbeck(sigma=0.01, tau=0), "y2": OrnsteinUhlenbeck(sigma=0.01, tau=0)},
    )
