"""How fast a plant moves, and how fast errors of it grow, at points of its box."""

import math

import casadi as ca
import numpy as np

from hgogen.graph import to_casadi
from hgogen.identification.records import BadLog
from hgogen.program import column
from hgogen.reading.time_unit import plural
from hgogen.signal import resting
from hgogen.system import System

POINTS = 40
FOLLOWED = 1.0  # |h lambda| of a Runge-Kutta step, at most
MOST_STEPS = 50  # of a sample


def paced(plant: System, period: float) -> tuple[int, float]:
    """The Runge-Kutta steps of a sample that the fastest mode asks for, and the rate at which errors grow.

    Raises: `BadLog` for samples too slow for the plant.
    """
    fastest, growing = rates(plant)
    steps = max(1, math.ceil(fastest * period / FOLLOWED))
    if steps > MOST_STEPS:
        reason = f"moves at rates up to {fastest:.3g}, too fast for samples {period:g} apart"
        fix = f"are the times in {plural(plant.time)}? Else narrow its ranges, or give a faster record"
        raise BadLog(f"plant {plant.name!r}", f"{reason}; {fix}")
    return steps, growing


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
