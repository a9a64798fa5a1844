"""What residuals tell: whether they follow each other, how many tell as much as one, and their size if some are wrong.

    N (N + 2) sum_k r_k^2/(N - k)   is chi-square with K degrees of freedom

of the first K autocorrelations r_k of N numbers that are white (Ljung and Box). Those of a model that is too simple
follow each other: then tau of them tell as much as one, tau = 1 + 2 sum_k r_k up to the first that is not positive.

    sigma = 1.4826 median |e|,   c = 1.345 sigma,   rho(e) = c^2 (sqrt(1 + (e/c)^2) - 1),   psi = rho'

The median is not moved by wrong residuals, as long as they are fewer than half. An estimate that minimises the sum of
rho has the covariance of least squares with the variance E psi^2/(E psi')^2: so a residual tells psi(e)/E psi'.

Quantiles of chi-square are Wilson and Hilferty's (1931), within 4 % from 5 degrees of freedom on. Sources: G. M. Ljung,
G. E. P. Box, Biometrika 65 (1978); T. Soederstroem, P. Stoica, System Identification (1989), chapter 11; Huber, Robust
Statistics (1981), chapters 5 and 7.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.sentence import Encoded

Array = np.ndarray
LAGS = 20  # correlations that a test of whiteness asks at most
LEAST = 3  # samples for each of them
NORMAL = {0.025: -1.959963985, 0.95: 1.644853627, 0.975: 1.959963985}  # quantiles of the normal distribution
OF_MEDIAN = 1.4826  # sigma over the median of |e|
CORNER = 1.345  # c over sigma: 5 % less than the best where all residuals are right
ROUNDING = 1e-9  # of the scale of an output: smaller residuals are rounding
WRONG = 5.0  # sigma: what lies beyond is an outlier


@dataclass(frozen=True)
class Whiteness(Encoded):
    """Ljung and Box's test of a sequence."""

    json_keys = "test statistic limit lags white"

    statistic: Annotated[float, "the statistic of the correlations"]
    limit: Annotated[float, "what one in 20 white sequences exceeds"]
    lags: Annotated[int, "number of correlations"]

    @property
    def test(self) -> str:
        """Name of the test."""
        return "Ljung-Box"

    @property
    def white(self) -> bool:
        """Whether the limit is kept."""
        return self.statistic <= self.limit


def whiteness(e: Array) -> Whiteness | None:
    """Ljung and Box's test of a sequence (N,); None where it is too short, or stands still."""
    N = len(e)
    lags = min(LAGS, N // LEAST)
    r = correlations(e, lags)
    if not lags or r is None:
        return None
    statistic = N * (N + 2) * float(np.sum(r**2 / (N - np.arange(1, lags + 1))))
    return Whiteness(statistic, quantile(0.95, lags), lags)


def correlations(e: Array, lags: int) -> Array | None:
    """The first autocorrelations of a sequence (N,), N - 1 at most; None where it stands still."""
    e = np.ldexp(e, -np.frexp(np.abs(e).max(initial=0.0))[1])  # exactly so, and without squares that overflow
    centred = e - e.mean() if len(e) else e
    power = float(centred @ centred)
    if not power > 0:
        return None
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(e))) ** 2  # of twice the length, so that its ends do not meet
    return np.asarray(np.fft.irfft(spectrum)[1 : min(lags + 1, len(e))] / power)


def quantile(p: float, freedom: float) -> float:
    """That of chi-square with so many degrees of freedom, p one of `NORMAL`."""
    spread = 2 / (9 * freedom)
    return float(freedom * max(0.0, 1 - spread + NORMAL[p] * math.sqrt(spread)) ** 3)


def alike(residuals: Array) -> float:
    """tau: how many of the residuals (N,) tell as much as one that is independent of the others."""
    r = correlations(residuals, len(residuals))
    return 1.0 if r is None else 1.0 + 2.0 * float(r[np.cumsum(r <= 0) == 0].sum())


def deviation(residuals: Array) -> float:
    """sigma of residuals (N) in units of their output's scale."""
    return max(OF_MEDIAN * float(np.median(np.abs(residuals))), ROUNDING)


def corner(residuals: Array) -> float:
    """c of residuals (N)."""
    return CORNER * deviation(residuals)


def influence(residuals: Array, c: float) -> Array:
    """What each residual (N) tells."""
    bend = 1 + (residuals / c) ** 2
    share = float(np.mean(bend**-1.5))
    return np.asarray(residuals / np.sqrt(bend) / share)
