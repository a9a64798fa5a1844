"""Classical Runge-Kutta with the Riccati observer in the form (z, P = S^-1), which admits longer steps than (z, S).

An observer without a covariance is refused.
"""

from hgogen.discretisation.runge_kutta import RK4
from hgogen.method import Explicit

rk4_covariance = Explicit(RK4, "covariance")
