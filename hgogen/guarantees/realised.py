"""One step of a realised linear core on an inclusion, its nonlinear rest by a scheme of order 2.

    a  = Phi e + Psi_0 r_0,   e+ = a + Psi_1 (r_1 - r_0),   r_i = (M - L) X_i + G p_i,   X_0 = e,   X_1 = a

L is the core that is realised, M and G p what the error obeys (`stagewise`). The rates (Phi - 1)/h, Psi/h and Gamma/h
have limits at h = 0, so that the step has one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import number
from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.quadratic import Array, identity
from hgogen.guarantees.stagewise import Inputs, Stagewise


@dataclass(frozen=True, eq=False)
class Rates:
    """(Phi - 1)/h, Psi_0/h and Psi_1/h (N, N), and (Gamma_0, Gamma_1)/h before B, of FLINT's rationals."""

    Phi: Array
    Psi_0: Array
    Psi_1: Array
    Gamma: tuple[Array, Array]


Realisation = Callable[[Array, Fraction], Rates]  # of a core (N, N), at a step length >= 0


def by_bilinear_rule(L: Array, h: Fraction) -> Rates:
    """S L, S and S/2 with S = (1 - h L/2)^-1."""
    resolvent = fmpq_mat((identity(len(L)) - L * (number(h) / 2)).tolist()).inv()
    S = np.array([[resolvent[i, j] for j in range(len(L))] for i in range(len(L))], dtype=object)
    half = S / 2
    return Rates(S @ L, S, half, (half, half))


def realised(realisation: Realisation, h: Fraction, e: Uncertain) -> Stagewise:
    """The step of length h >= 0, the samples at its ends injected by the realised core."""
    (n, m), p, rates = e.G.shape, e.B.shape[1], realisation(e.core, h)
    size = n + 2 * m
    unit, rest = identity(size + 2 * p), e.M - e.core
    X = unit[:n]
    first = rest @ X + e.G @ unit[n : n + m]
    sampled = [Gamma @ e.B @ unit[size + i * p : size + (i + 1) * p] for i, Gamma in enumerate(rates.Gamma)]
    ahead = rates.Phi @ X + rates.Psi_0 @ first + sampled[0] + sampled[1]  # (a - e)/h
    after = X + ahead * number(h)
    D = ahead + rates.Psi_1 @ (rest @ after + e.G @ unit[n + m : size] - first)
    Q = np.concatenate([e.H @ X, e.H @ after])
    each = [Inputs(D[:, [k]], Q[:, [k]]) for k in range(size, size + 2 * p)]
    nodes = (Fraction(0), Fraction(1))
    return Stagewise(h, m, D[:, :size], Q[:, :size], (tuple(each[:p]), tuple(each[p:])), nodes)
