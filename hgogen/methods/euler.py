"""Explicit Euler, z+ = z + h f(z): first order, for any part; a Riccati observer in the form (z, S)."""

from hgogen.discretisation.runge_kutta import EULER
from hgogen.method import Explicit

euler = Explicit(EULER, "information")
