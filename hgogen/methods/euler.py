"""Explicit Euler, z+ = z + h f(z): first order, for any part; a Riccati observer in the form (z, S)."""

from hgogen.method import Explicit
from hgogen.runge_kutta import EULER

euler = Explicit(EULER, "information")
