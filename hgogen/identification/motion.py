"""How fast a plant moves, and how fast errors of it grow, at points of its box."""

import casadi as ca
import numpy as np

from hgogen.graph import to_casadi
from hgogen.program import column
from hgogen.signal import resting
from hgogen.system import System

POINTS = 40


def rates(plant: System) -> tuple[float, float]:
    """The largest modulus of an eigenvalue of df/dx, and the largest real part, 0 where none is positive: at rest, and
    at random points of the declared ranges."""
    draw, n, signals = np.random.default_rng(0), len(plant.states), (*plant.states, *plant.inputs, *plant.parameters)
    symbols = {s: ca.SX.sym(s.name) for s in signals}
    at = column(symbols.values())
    flow = column(to_casadi(plant.flow, symbols))
    jacobian = ca.Function("jacobian", [at], [ca.jacobian(flow, at)[:, :n]])
    spectra = [np.zeros(1)]
    for k in range(POINTS):
        J = jacobian([draw.uniform(*s.interval) if s.bounded and k else resting(s) for s in signals]).full()
        if np.isfinite(J).all():
            spectra.append(np.linalg.eigvals(J))
    every = np.concatenate(spectra)
    return float(np.abs(every).max()), float(max(0.0, every.real.max()))
