"""Heun, z+ = z + h/2 (k_1 + k_2): second order, for any part; a Riccati observer in the form (z, S)."""

from hgogen.discretisation.runge_kutta import HEUN
from hgogen.method import Explicit

heun = Explicit(HEUN, "information")
