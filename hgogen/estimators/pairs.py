"""The low-power injection: pairs (p_i, q_i) on a chain of integrators, and their gains from 2n - 2 poles.

    p_i' = q_i + theta k_i1 e_i,   q_i' = q_(i+1) + theta^2 k_i2 e_i,   q_n = 0,   i = 1..m,   m = n - 1
    e_1 = y - p_1,   e_i = q_(i-1) - p_i

At theta = 1 this linear core has the characteristic polynomial

    D(s) = R_1 + k_12 (R_2 + k_22 (R_3 + .. + k_m2)),   R_i = s (s + k_i1) s (s + k_(i+1)1) .. s (s + k_m1).

Proof: the pair i turns q_(i-1) into q_i by the factor k_i2 s D_(i+1)/D_i, D_i = s (s + k_i1) (D_(i+1) - k_(i+1)2
D_(i+2)) + k_i2 D_(i+1), D_(m+1) = 1; so that D_i - k_i2 D_(i+1) = R_i. Hence D(0) = c_m, c_i = k_12 .. k_i2, and
(D(s) - D(0))/s, of odd degree, has a real root, -k_m1; its quotient by s + k_m1 is the polynomial of the pairs before,
c_(m-1) at s = 0, and so on. For k_i = (2, (n - i)/i) the c_i are binomial coefficients and D = (1 + s (s + 2))^m =
(s + 1)^(2m). Source of the observer: Astolfi, Marconi, IEEE TAC 60 (2015).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import mpmath
import numpy as np

from hgogen.estimators.gains import BadPoles, coefficients, numbers
from hgogen.graph import Graph
from hgogen.reading.given import BadGain, reals

_DIGITS = 60  # of the roots: close ones are less certain than the polynomial by many digits
_REAL = 1e-20  # the imaginary part, as a share of the largest root, of what is real


def pair_gains(observer: str, n: int, gains: Any, poles: Any) -> np.ndarray:
    """The gains k (n - 1, 2): the `gains`, or from `poles` (2n - 2), or by default (2, (n - i)/i) with all poles at -1.

    Raises: `BadGain` for both, or for gains of another shape or not finite; `BadPoles`.
    """
    if gains is not None and poles is not None:
        raise BadGain(observer, "takes gains or poles, not both; leave one out")
    if poles is not None:
        return from_poles(poles, n)
    if gains is None:
        return np.array([(2.0, (n - i) / i) for i in range(1, n)])
    k = reals("gains", gains)
    if k.shape != (n - 1, 2):
        raise BadGain(
            f"gains of shape {k.shape}", f"must be {n - 1} pairs (k_i1, k_i2), one for each state but the last"
        )
    if not np.isfinite(k).all():
        raise BadGain(f"gains = {k.tolist()}", "must be finite")
    return k


def from_poles(poles: Sequence[complex], n: int) -> np.ndarray:
    """The gains k (n - 1, 2) of 2n - 2 poles; where there is a choice, the last pair is the slowest.

    Raises: `BadPoles`, also where the search finds no positive gains for the poles.
    """
    listed = numbers(poles if isinstance(poles, Sequence | np.ndarray) else (poles,))
    if len(listed) != 2 * n - 2:
        raise BadPoles(listed, f"there are {len(listed)}, {n} states have {2 * n - 2} in low power")
    wanted = coefficients(poles, 2 * n - 2)
    slopes: list[Any] = []
    with mpmath.workdps(_DIGITS):
        left, products = [mpmath.mpf(1), *map(mpmath.mpf, wanted)], [mpmath.mpf(1)]
        while len(left) > 1:
            *rest, constant = left
            roots = mpmath.polyroots(rest, maxsteps=1000, extraprec=1000)
            largest = max(map(abs, roots))
            real = (mpmath.re(x) for x in roots if abs(mpmath.im(x)) <= _REAL * largest)
            root = max((x for x in real if x < 0), default=None)
            if root is None or constant <= 0:
                raise BadPoles(tuple(map(complex, poles)), "no positive gains were found that have them; give gains")
            slopes.insert(0, -root)
            products.insert(1, constant)
            left = _divided(rest, root)
        ratios = (after / before for before, after in pairwise(products))
        return np.array([(float(a), float(b)) for a, b in zip(slopes, ratios, strict=True)])


def _divided(polynomial: list[Any], root: Any) -> list[Any]:
    """The quotient by s - root, by Horner's scheme."""
    quotient = polynomial[:1]
    for coefficient in polynomial[1:-1]:
        quotient.append(coefficient + root * quotient[-1])
    return quotient


def errors(first: Graph, p: Graph, q: Graph) -> Graph:
    """The errors e (m): `first`, then q_(i-1) - p_i."""
    return ca.vertcat(first, *(q[i - 1] - p[i] for i in range(1, q.numel())))


def injected(k: np.ndarray, theta: Graph, e: Graph) -> tuple[Graph, Graph]:
    """What e (m) adds to p' (m) and q' (m)."""
    return theta * (ca.DM(k[:, 0]) * e), theta * theta * (ca.DM(k[:, 1]) * e)
