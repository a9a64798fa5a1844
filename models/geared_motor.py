"""A direct-current motor with an encoder and a current sensor, its speed and load torque estimated.

    phi' = w,  i' = (v - R i - k w)/L,  w' = (k i - b w - c tanh(w/s) - T)/J,  T' = 0,   y1 = phi,  y2 = i

A known answer of alignment. The chains are (phi) and (i, w, T): the short chain's row reads w, the second state of the
long one. Aligned at the ends it may, for 2 <= 1 + n_2 - n_1 = 3; aligned at the tops it may not, for 2 > 1: phi' and i'
would bring in the same state. One after the other, i's chain first, they are a cascade, for which no high gain is
defined. n* = 3, Delta^-1 = diag(theta^2; 1, theta, theta^2), R_theta = diag(theta^3 R_1, R_2/theta).
"""

import sympy as sp

import hgogen as hg
from hgogen.trial import Jump, OrnsteinUhlenbeck, Settled, Trial, t

phi = hg.Signal("phi", "rad", "shaft angle", low=-200, high=200)
i = hg.Signal("i", "A", "armature current", low=-15, high=15)
w = hg.Signal("w", "rad/s", "speed", low=-300, high=300)
T = hg.Signal("T", "N m", "load torque", low=-0.2, high=0.2)
v = hg.Signal("v", "V", "armature voltage", low=-12, high=12)
y1 = hg.Signal("y1", "rad", "encoder")
y2 = hg.Signal("y2", "A", "current sensor")
R = hg.Signal("R", "ohm", "armature resistance", 1.0)
L = hg.Signal("L", "H", "armature inductance", 0.02)
k = hg.Signal("k", "V s/rad", "motor constant", 0.05)
J = hg.Signal("J", "kg m2", "inertia", 2e-4)
b = hg.Signal("b", "N m s/rad", "viscous friction", 2e-5)
c = hg.Signal("c", "N m", "Coulomb friction", 0.01)
s = hg.Signal("s", "rad/s", "speed at which Coulomb friction sets in", 5.0)

plant = hg.System(
    "geared_motor",
    states=(phi, i, w, T),
    inputs=(v,),
    outputs=(y1, y2),
    parameters=(R, L, k, J, b, c, s),
    flow=[w, (v - R * i - k * w) / L, (k * i - b * w - c * sp.tanh(w / s) - T) / J, 0],
    output=[phi, i],
)

tuning = {
    "high_gain": {
        "form": {"kind": "block_triangular", "align": "end"},
        "method": "rk4",
        "dt": 1e-3,
        "theta": 30,
        "poles": ((-1,), (-1, -1, -1)),
    },
    "riccati": {
        "form": {"kind": "block_triangular", "align": "end"},
        "dt": 1e-3,
        "Q": {"phi": 1e-3, "i": 1.0, "w": 10.0, "T": 1e-5},
        "R": {"y1": 1e-8, "y2": 1e-6},
        "covariance": {"phi": 1.0, "i": 1.0, "w": 100.0, "T": 1e-2},
        "theta": hg.theta.adaptive(
            2.0,
            rise_time=0.02,
            rate=20.0,
            mu=(400.0, 4000.0),
            innovation=hg.innovation.staggered(0.02, predictors=4, weights={"y1": 1e8, "y2": 1e3}),
        ),
    },
    "bank": {"dt": 1e-3, "member": "decaying", "count": 3, "period": 0.2},
    "hamilton_jacobi": {  # its weights are the inverses of riccati's noises
        "form": {"kind": "block_triangular", "align": "end"},
        "dt": 1e-3,
        "Q": {"phi": 1e3, "i": 1.0, "w": 0.1, "T": 1e5},
        "R": {"y1": 1e8, "y2": 1e6},
        "P0": {"phi": 1.0, "i": 1.0, "w": 0.01, "T": 100.0},
    },
}
tuning["decaying"] = {**tuning["riccati"], "kind": "riccati", "theta": hg.theta.decaying(3.0, rate=5.0)}


def step() -> hg.Step:
    gains = {name: value for name, value in tuning["riccati"].items() if name not in ("form", "dt")}
    observer = hg.observers.riccati(hg.forms.block_triangular(plant, "end"), **gains)
    return hg.sample(observer, hg.methods.continuous_discrete, dt=1e-3)


def trial() -> Trial:
    """A slow swing of the voltage; the load grips and lets go."""
    return Trial(
        "load",
        6,
        start={"phi": 1, "i": 0, "w": 0, "T": 0.02},
        inputs={"v": 9 * sp.sin(2 * t)},
        noise={"y1": OrnsteinUhlenbeck(sigma=1e-3), "y2": OrnsteinUhlenbeck(sigma=0.03)},
        jumps=(Jump(2, "T", 0.1), Jump(4, "T", 0.0)),
        settled=Settled("T", band=0.01, hold=0.2),
    )
