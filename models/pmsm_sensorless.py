"""Permanent magnet motor without a position sensor, in the frame of the stator: currents measured, flux linkage of the
rotor and speed estimated.

    i_a' = (-R i_a + w f_b + u_a)/L,   f_a' = -w f_b,   w' = c (f_a i_b - f_b i_a) - b w,
    i_b' = (-R i_b - w f_a + u_b)/L,   f_b' =  w f_a,   y = (i_a, i_b)

Each current brings in flux and speed together, so no block-triangular form holds the plant: the observer is the
extended Kalman filter in the plant's own coordinates, for which no theorem promises convergence.

Known answer: y, y' and y_a'' have the Jacobian determinant w (f_a w^2 + 2 c f_b (f_b i_a - f_a i_b))/L^3, y, y' and
y_b'' that of a turn by 90 degrees, so the state is seen through y'' while the rotor turns. At zero speed and without
voltage it is not seen at all: any flux gives i = 0. The declared speed keeps off zero.

Bolognani, Oboe, Zigliotto, Sensorless full-digital PMSM drive with EKF estimation of speed and rotor position, IEEE
Trans. Industrial Electronics 46 (1999), there with c = 0.
"""

import sympy as sp

import hgogen as hg
from hgogen.trial import OrnsteinUhlenbeck, Settled, Trial, t

i_a = hg.Signal("i_a", "A", "current along axis a", low=-20, high=20)
i_b = hg.Signal("i_b", "A", "current along axis b", low=-20, high=20)
f_a = hg.Signal("f_a", "Wb", "flux linkage of the rotor along axis a", low=-0.2, high=0.2)
f_b = hg.Signal("f_b", "Wb", "flux linkage of the rotor along axis b", low=-0.2, high=0.2)
w = hg.Signal("w", "rad/s", "electrical speed", low=20, high=600)
u_a = hg.Signal("u_a", "V", "voltage along axis a", low=-60, high=60)
u_b = hg.Signal("u_b", "V", "voltage along axis b", low=-60, high=60)
y_a = hg.Signal("y_a", "A", "measured current along axis a", low=-25, high=25)
y_b = hg.Signal("y_b", "A", "measured current along axis b", low=-25, high=25)
R = hg.Signal("R", "Ohm", "resistance of a phase", 0.5)
L = hg.Signal("L", "H", "inductance of a phase", 0.002)
c = hg.Signal("c", "rad/(Wb A s2)", "torque constant over inertia", 6000)
b = hg.Signal("b", "1/s", "friction over inertia", 5)

plant = hg.System(
    "pmsm_sensorless",
    states=(i_a, i_b, f_a, f_b, w),
    inputs=(u_a, u_b),
    outputs=(y_a, y_b),
    parameters=(R, L, c, b),
    flow=[
        (-R * i_a + w * f_b + u_a) / L,
        (-R * i_b - w * f_a + u_b) / L,
        -w * f_b,
        w * f_a,
        c * (f_a * i_b - f_b * i_a) - b * w,
    ],
    output=[i_a, i_b],
)


tuning = {
    "riccati": {
        "form": "original",
        "dt": 1e-4,
        "Q": {"i_a": 1, "i_b": 1, "f_a": 1e-4, "f_b": 1e-4, "w": 1e3},
        "R": {"y_a": 4e-8, "y_b": 4e-8},
        "covariance": {"i_a": 1, "i_b": 1, "f_a": 0.01, "f_b": 0.01, "w": 1e4},
    },
    "bank": {
        "dt": 1e-4,
        "member": "riccati",  # one that restarts has P(0) again
        "count": 3,
        "period": 0.2,
        # Heun's rule lets the turning currents grow from a dt of .66 ms on
        "innovation": hg.innovation.staggered(0.08, predictors=4, method=hg.methods.rk4),
    },
    "hamilton_jacobi": {
        "form": "original",
        "dt": 1e-4,
        "Q": {"i_a": 1, "i_b": 1, "f_a": 1e4, "f_b": 1e4, "w": 1e-3},
        "R": {"y_a": 2.5e7, "y_b": 2.5e7},
        "P0": {"i_a": 1, "i_b": 1, "f_a": 100, "f_b": 100, "w": 1e-4},
    },
}


def trial() -> Trial:
    """Run up from 200 to 300 rad/s on a voltage that turns ahead of the rotor."""
    angle = 200 * t + 25 * t**2
    voltage = 20 + 5 * t
    return Trial(
        "run_up",
        2,
        start={"i_a": 0, "i_b": 0, "f_a": 0.1, "f_b": 0, "w": 200},
        inputs={"u_a": -voltage * sp.sin(angle), "u_b": voltage * sp.cos(angle)},
        noise={"y_a": OrnsteinUhlenbeck(0.02), "y_b": OrnsteinUhlenbeck(0.02)},
        settled=Settled("w", band=5, hold=0.1),
        seeds=tuple(range(4)),
    )
