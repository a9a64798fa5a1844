"""One step of a realised linear core on an inclusion, its nonlinear rest by a scheme of order 2.

    a  = Phi e + Psi_0 r_0,   e+ = a + Psi_1 (r_1 - r_0),   r_i = (M - L) X_i + G p_i,   X_0 = e,   X_1 = a

L is the core that is realised, M and G p what the error obeys (`stagewise`), errors of what is injected apart. With X =
h L, Phi = 1 + X phi_1, Psi_0 = h phi_1, Psi_1 = h phi_2, and phi_1 - phi_2 and phi_2 weigh what is injected at the two
ends; so the step has a limit at h = 0. By the bilinear rule phi_1 is (1 - X/2)^-1, and phi_2 half of it. The matrix
exponential has phi_1 = 1 + X phi_2; so have the polynomials that a program takes for them (`discretisation.kernels`),
as halvings and doublings of X keep to it. There phi_2 is in balls that hold these polynomials.
"""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat, ctx, fmpq_mat

from hgogen.algebra.definite import number
from hgogen.discretisation.kernels import DEGREE, HALVINGS
from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.quadratic import BALLS, Array, floats, identity
from hgogen.guarantees.stagewise import Inputs, Stagewise

WITHIN = Fraction(1, 2**56)  # of an element of phi_2: what a program's may be beside it
_SURE = 0.9  # of a spectral radius in floats


Realisation = Callable[[Array, Fraction], tuple[Array, Array]]  # of a core (N, N) at a length >= 0: phi_1 and phi_2


def by_bilinear_rule(L: Array, h: Fraction) -> tuple[Array, Array]:
    """Of FLINT's rationals."""
    resolvent = fmpq_mat((identity(len(L)) - L * (number(h) / 2)).tolist()).inv()
    phi_1 = np.array([[resolvent[i, j] for j in range(len(L))] for i in range(len(L))], dtype=object)
    return phi_1, phi_1 / 2


def by_matrix_exponential(L: Array, h: Fraction) -> tuple[Array, Array]:
    """Of balls that hold what a program takes; without an end where that may be further than `WITHIN` from the
    exponential's."""
    X, known = L * number(h), number(WITHIN)
    halvings = _halvings(X)
    with ctx.workprec(BALLS):
        exactly = _phi_2(X)
        away = max(each.abs_upper() for each in (exactly - _taken(X, halvings)).ravel())
        phi_2 = exactly + (arb(0, known) if away < known and halvings <= HALVINGS else arb(0, "inf"))
        return identity(len(X)) + X @ phi_2, phi_2


def _phi_2(X: Array) -> Array:
    """Of the exponential: a block of exp [X, 1, 0; 0, 0, 1; 0, 0, 0]."""
    n = len(X)
    wide = 0 * identity(3 * n)
    wide[:n, :n], wide[:n, n : 2 * n], wide[n : 2 * n, 2 * n :] = X, identity(n), identity(n)
    whole = arb_mat([[arb(value) for value in row] for row in wide]).exp()
    return np.array([[whole[i, 2 * n + j] for j in range(n)] for i in range(n)], dtype=object)


def _halvings(X: Array) -> int:
    """The fewest that bring the sums of |x_ij| by rows to 1/2, in coordinates that a diagonal matrix scales: in none is
    the largest sum below the spectral radius of |X|."""
    radius = float(np.abs(np.linalg.eigvals(np.abs(floats(X)))).max(initial=0)) * _SURE
    return max(0, int(np.ceil(np.log2(2 * radius)))) if radius else 0


def _taken(X: Array, halvings: int) -> Array:
    """The program's polynomial for phi_2. Each halving more leaves 2^-14 of the rest of the series."""
    one = _balls(identity(len(X)))
    X = _balls(X) / 2**halvings
    phi_2 = one
    for j in range(DEGREE, 0, -1):
        phi_2 = one + X @ phi_2 / (j + 2)
    phi_2 = phi_2 / 2
    phi_1 = one + X @ phi_2
    phi_0 = one + X @ phi_1
    for _ in range(halvings):
        phi_2 = (phi_0 @ phi_2 + phi_1 + phi_2) / 4
        phi_1 = (phi_0 @ phi_1 + phi_1) / 2
        phi_0 = phi_0 @ phi_0
    return phi_2


def _balls(M: Array) -> Array:
    return np.array([[arb(value) for value in row] for row in M], dtype=object).reshape(M.shape)


def realised(realisation: Realisation, h: Fraction, e: Uncertain) -> Stagewise:
    """The step of length h >= 0, the samples at its ends injected by the realised core."""
    (n, m), p, (phi_1, phi_2) = e.G.shape, e.B.shape[1], realisation(e.core, h)
    size = n + 2 * m
    unit, rest, beside = identity(size + 2 * p), e.M - e.core, e.B - e.injected
    X, v_0, v_1 = unit[:n], unit[size : size + p], unit[size + p :]
    first = rest @ X + beside @ v_0 + e.G @ unit[n : n + m]
    with ctx.workprec(BALLS):
        ahead = phi_1 @ (e.core @ X + first + e.injected @ v_0) + phi_2 @ e.injected @ (v_1 - v_0)  # (a - e)/h
        after = X + ahead * number(h)
        D = ahead + phi_2 @ (rest @ after + beside @ v_1 + e.G @ unit[n + m : size] - first)
        Q = np.concatenate([e.H @ X + e.E @ v_0, e.H @ after + e.E @ v_1])
    each = [Inputs(D[:, [k]], Q[:, [k]]) for k in range(size, size + 2 * p)]
    nodes = (Fraction(0), Fraction(1))
    return Stagewise(h, m, D[:, :size], Q[:, :size], (tuple(each[:p]), tuple(each[p:])), nodes)
