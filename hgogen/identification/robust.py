"""Residuals among which some are wrong: their scale, and what each tells.

    sigma = 1.4826 median |e|,   c = 1.345 sigma,   rho(e) = c^2 (sqrt(1 + (e/c)^2) - 1),   psi = rho'

The median is not moved by the wrong ones, as long as they are fewer than half. An estimate that minimises the sum of
rho has the covariance of least squares with the variance E psi^2/(E psi')^2: so a residual tells psi(e)/E psi'.
Source: Huber, Robust Statistics (1981), chapters 5 and 7.
"""

import numpy as np

Array = np.ndarray
NORMAL, CORNER = 1.4826, 1.345  # sigma over the median of |e|; c over sigma: 5 % less than the best where all are right
LEAST = 1e-9  # of the scale of an output: smaller residuals are rounding
WRONG = 5.0  # sigma: what lies beyond is an outlier


def deviation(residuals: Array) -> float:
    """sigma of residuals (N) in units of their output's scale."""
    return max(NORMAL * float(np.median(np.abs(residuals))), LEAST)


def corner(residuals: Array) -> float:
    """c of residuals (N)."""
    return CORNER * deviation(residuals)


def influence(residuals: Array, c: float) -> Array:
    """What each residual (N) tells."""
    bend = 1 + (residuals / c) ** 2
    share = float(np.mean(bend**-1.5))
    return np.asarray(residuals / np.sqrt(bend) / share)
