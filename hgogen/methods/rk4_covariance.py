"""Classical Runge-Kutta with the Riccati observer in the form (z, P = S^-1), which admits longer steps than (z, S).

An observer without a covariance is refused.
"""

from hgogen.method import Explicit
from hgogen.runge_kutta import RK4

rk4_covariance = Explicit(RK4, "covariance")
