"""Classical Runge-Kutta, z+ = z + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4): any part; a Riccati observer in the form (z, S)."""

from hgogen.discretisation.runge_kutta import RK4
from hgogen.method import Explicit

rk4 = Explicit(RK4, "information")
