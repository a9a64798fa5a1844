"""Bilinear rule s = (2/h) (z - 1)/(z + 1) for the linear error core, stable at every step length h.

    (1 - h M/2) x+ = (1 + h M/2) x + (h/2) B (v_0 + v_1) + (h/2) (r_0 + r_1)

where r_1 is evaluated at the x+ that r_0 alone gives: order 2. The mode of a core much faster than 2/h is hardly damped
and changes sign at each sample; use the matrix exponential there. The method applies to any part with a linear core,
such as a constant-gain observer. Source: Dabroom, Khalil, "Discrete-time implementation of high-gain observers for
numerical differentiation", Int. J. Control 72 (1999).
"""

import casadi as ca
import numpy as np

from hgogen.estimators.core import Core
from hgogen.method import Matrices, Realising, balanced, spread
from hgogen.program import Kernel, Place
from hgogen.prove import inequality, method_error


def _matrices(line: Core, h: float) -> Matrices:
    X = h / 2 * line.M
    program, size = balanced(X)
    places = ((Place("work", "core"), size**2), (Place("work", "inverse"), size**2))
    S = spread(Place("work", "inverse"), X, size)
    source = h / 2 * S @ line.B
    return Matrices(
        program=(*program, Kernel("resolvent", size, None, places)),
        Phi=2 * S - ca.SX.eye(X.shape[0]),
        Gamma_0=source,
        Gamma_1=source,
        Psi_0=h * S,
        Psi_1=h / 2 * S,
    )


def _numbers(core: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    one = np.eye(len(core))
    S = np.linalg.inv(one - h / 2 * core)
    return 2 * S - one, h * S, h / 2 * S


EQUATIONS = ("(1 - h/2 M) x+ = (1 + h/2 M) x + h/2 B (v_0 + v_1) + h/2 (r_0 + r_1)",)

_PROVED = inequality.by_bilinear_rule, method_error.BILINEAR
bilinear = Realising("the bilinear rule", _matrices, _numbers, EQUATIONS, *_PROVED)
