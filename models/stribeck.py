"""Cart with Stribeck's friction, given as a map: position measured, speed estimated.

    x' = v,   v' = u - friction(v)

The friction is a table over the speed, odd, linear between its points: it breaks away within 0.1 m/s, falls as the film
of oil forms (Stribeck's effect), and rises with the speed beyond. Lines make it Lipschitz with kinks, which is all that
the triangular form asks of it.

Known answer: triangular, and L_b is the steepest slope of the map, 2/0.1 = 20 1/s at rest. The film makes the speed run
away from 0.1 m/s with 4 1/s; what goes through the origin at 20 1/s is damped there.

Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation methods for the control
of machines with friction, Automatica 30 (1994), for the shape; the numbers are made up.
"""

import sympy as sp

import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Settled, Trial, t

x = hg.Signal("x", "m", "position", low=-2, high=2)
v = hg.Signal("v", "m/s", "speed", low=-0.8, high=0.8)
u = hg.Signal("u", "m/s2", "force over mass", nominal=0, low=-6, high=6)
y = hg.Signal("y", "m", "measured position", low=-2.2, high=2.2)

speeds = [0.1, 0.2, 0.3, 0.5, 0.9]
forces = [2.0, 1.6, 1.4, 1.45, 1.8]
friction = hg.table(
    v,
    [*(-speed for speed in reversed(speeds)), 0, *speeds],
    [*(-force for force in reversed(forces)), 0, *forces],
    name="friction",
)

plant = hg.System("stribeck", states=(x, v), inputs=(u,), outputs=(y,), flow=[v, u - friction], output=[x])

tuning = {
    "high_gain": {"theta": 80, "poles": (-1, -1)},  # above the bound at which it is proved to converge
    "riccati": {"Q": {"x": 1e-6, "v": 4}, "R": 1e-9, "covariance": {"x": 1e-4, "v": 0.1}},
    "filtered": {"theta": 40, "alpha": 3, "beta": 1, "poles": (-1, -1)},
}


def step() -> hg.Step:
    form = hg.forms.triangular(plant)
    return hg.sample(hg.observers.high_gain(form, **tuning["high_gain"]), hg.methods.rk4, dt=1e-3)


def trial() -> Trial:
    """To and fro through the film and through rest, under the noise of an encoder; the estimate does not know the
    speed."""
    return Trial(
        "to_and_fro",
        10,
        start={"x": 0, "v": 0.4},
        inputs={"u": 2.5 * sp.sin(4 * t)},
        noise={"y": OrnsteinUhlenbeck(sigma=1e-6, tau=0)},
        settled=Settled("v", band=0.02, hold=0.5),
    )
