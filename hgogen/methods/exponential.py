"""Exact matrix exponential for the linear error core, exponential time differencing for the nonlinear part.

    x+ = phi_0(h M) x + h (phi_1 - phi_2)(h M) B v_0 + h phi_2(h M) B v_1 + h phi_1(h M) r_0 + h phi_2(h M) (r_1 - r_0)
    phi_0(X) = exp X,  phi_1(X) = (phi_0 - 1)/X,  phi_2(X) = (phi_1 - 1)/X

where r_1 is evaluated at the x+ that r_0 alone gives. It is exact at every step length h if the measurement is linear
between samples and there is no nonlinear part r; r has order 2. The method applies to any part with a linear core, such
as a constant-gain observer. Source of the scheme: Cox, Matthews, "Exponential time differencing for stiff systems", J.
Comput. Phys. 176 (2002), ETD2RK.
"""

import numpy as np

from hgogen.discretisation import kernels
from hgogen.estimators.core import Core
from hgogen.method import Matrices, Realising, balanced, spread
from hgogen.program import Kernel, Place
from hgogen.prove import inequality, method_error


def _matrices(line: Core, h: float) -> Matrices:
    X = h * line.M
    program, size = balanced(X)
    places = tuple((Place("work", name), size**2) for name in ("core", "phi_0", "phi_1", "phi_2"))
    phi_0, phi_1, phi_2 = (spread(place, X, size) for place, _ in places[1:])
    return Matrices(
        program=(*program, Kernel("exponential", size, None, places)),
        Phi=phi_0,
        Gamma_0=h * (phi_1 - phi_2) @ line.B,
        Gamma_1=h * phi_2 @ line.B,
        Psi_0=h * phi_1,
        Psi_1=h * phi_2,
    )


def _numbers(core: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    size = core.size
    phi_0, phi_1, phi_2 = (np.zeros(size) for _ in range(3))
    kernels.exponential((h * core).reshape(-1), phi_0, phi_1, phi_2)
    Phi, Psi_0, Psi_1 = (phi.reshape(core.shape) for phi in (phi_0, h * phi_1, h * phi_2))
    return Phi, Psi_0, Psi_1


EQUATIONS = (
    "x+ = phi_0 x + h (phi_1 - phi_2) B v_0 + h phi_2 B v_1 + h phi_1 r_0 + h phi_2 (r_1 - r_0), each phi of X = h M",
    "phi_0 = exp X, phi_1 = (phi_0 - 1) X^-1, phi_2 = (phi_1 - 1) X^-1",
)

_PROVED = inequality.by_matrix_exponential, method_error.EXPONENTIAL
exponential = Realising("the matrix exponential", _matrices, _numbers, EQUATIONS, *_PROVED)
