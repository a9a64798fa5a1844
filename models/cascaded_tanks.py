"""Cascaded tanks: a pump fills an upper tank, which empties into a lower one, whose level is measured.

x1' = -k1 sqrt(x1) + k4 u,  x2' = k2 sqrt(x1) - k3 sqrt(x2),  y = x2,  levels from 0 to 10.

In w = sqrt(x1) the plant is triangular: x2' = k2 w - k3 sqrt(x2), w' = -k1/2 + k4 u/(2 w). The constants were
identified on the estimation half of the cascaded-tanks benchmark (Schoukens, Noel 2017). The upper level is measured
by nothing: its scale is fixed by k1 = k2, equal cross-sections, and known to a factor of about 1.4 only. The overflow
of the upper tank is not in the model; while it lasts the estimated upper level is too high.
"""

import sympy as sp

import hgogen as hg

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
    "Q": (1e-4, 1.4e-3),
    "R": 1.6e-3,
    "covariance": (0.25, 0.25),
    # gamma_0 is set by the error of the model, the overflow above all, not by the noise of the sensor
    "theta": hg.theta.adaptive(
        2.0,
        rise_time=4.0,
        rate=0.25,
        mu=(0.7, 1.0),
        innovation=hg.innovation.staggered(32.0, predictors=4),
    ),
}
tuning = {"riccati": {"form": form, "dt": 4.0, **gains}}


def step(**changes: object) -> hg.Step:
    """The observer at the sampling period of the benchmark, 4 s; `changes` replace gains."""
    observer = hg.observers.riccati(form(plant), **{**gains, **changes})
    return hg.sample(observer, hg.methods.continuous_discrete, dt=4.0)
