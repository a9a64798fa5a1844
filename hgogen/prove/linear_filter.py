"""Whether a Kalman filter of a linear plant with constant coefficients converges: ranks in exact arithmetic.

    x' = A x + b(u),  y = C x + d(u),   P' = A P + P A' + Q - P C' R^-1 C P,   e' = (A - P C' R^-1 C) e

Where (C, A) is observable and (A, Q) controllable, P converges from every P(0) > 0 to the one positive definite P of
the algebraic equation, for which A - P C' R^-1 C is Hurwitz, so that e converges exponentially from everywhere. Both
ranks are n where the matrices sum_k (A')^k C'C A^k and sum_k A^k Q Q' (A')^k, k < n, are positive definite. Source:
R. E. Kalman, R. S. Bucy, "New results in linear filtering and prediction theory", J. Basic Engineering 83 (1961),
section 7.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp
from flint import fmpq_mat

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.polytope import fixed
from hgogen.analysis.undefined import undefined_values
from hgogen.form import Form
from hgogen.rigor.definite import Matrix, exact, nonnegative, positive, rationals
from hgogen.rigor.points import exact as exactly
from hgogen.sentence import Reason, because

STATES = 40  # of more, sums of products of rationals take long


@dataclass(frozen=True)
class Linear:
    """A and C of a form that is linear, its coefficients constant."""

    A: Matrix
    C: Matrix

    def evidence(self, form: Form) -> Evidence:
        """Both matrices."""
        return {"A": self.A, "C": self.C}


def linear(form: Form) -> Linear | Reason:
    """A and C (p, n) of a form with z' = A z + b(u), y = C z + d(u); or why it is none."""
    z = {*form.states}
    if form.n > STATES:
        return because("the ranks of more than {most} states are not computed", most=STATES)
    if form.jacobian is not None or form.behind is not None:
        return because("the filter works in other coordinates than the form's")
    if form.limits:
        return because("values of b are limited")
    if undefined_values(form.system):
        return because("a rate or an output is not known to have a finite value everywhere")
    known = dict(fixed(form))
    slopes = sp.Matrix(form.output).jacobian(form.states)
    A, b, h, C = (exactly(sp.Matrix(rows)).xreplace(known) for rows in (form.A, form.b, form.output, slopes))
    d = (h - C * sp.Matrix(form.states)).expand()  # a jump has a slope of 0 beside it
    if (b.free_symbols | C.free_symbols | d.free_symbols) & z:
        return because("it is not linear in the state")
    if moving := sorted((A.free_symbols | C.free_symbols), key=str):
        return because("its coefficients vary with {names}", names=moving)
    if not all(e.is_Rational for e in (*A, *C)):
        return because("a coefficient is not rational")
    return Linear(*(tuple(tuple(Fraction(int(e.p), int(e.q)) for e in row) for row in M.tolist()) for M in (A, C)))


def settles(plant: Linear, Q: np.ndarray, theta: float) -> Reason | None:
    """None where the filter of Q (n, n) and a constant theta converges; or which condition is not met.

    Q is a density of noise: with a negative eigenvalue P may leave the positive definite matrices, where the theorem
    says nothing. A theta above 1 scales Q by rows and columns, which leaves it positive definite, but may end what one
    of lower rank reaches.
    """
    A, C, noise = exact(plant.A), exact(plant.C), exact(rationals(Q))
    if not theta > 0:
        return because("theta is not positive")
    if noise != noise.transpose() or not nonnegative(noise):
        return because("Q is not symmetric, or has a negative eigenvalue")
    if not positive(_gramian(A, C.transpose() * C, True)):
        return because("(C, A) is not observable: C, C A, .. have a rank below {n}", n=len(plant.A))
    if positive(noise):
        return None
    if theta != 1:
        return because("Q is not positive definite, and theta scales it")
    if not positive(_gramian(A, noise * noise, False)):
        return because("(A, Q) is not controllable: Q, A Q, .. have a rank below {n}", n=len(plant.A))
    return None


def _gramian(A: Any, start: Any, turned: bool) -> fmpq_mat:
    """sum_k (A')^k M A^k for k < n where `turned`, else sum_k A^k M (A')^k."""
    total = term = start
    left, right = (A.transpose(), A) if turned else (A, A.transpose())
    for _ in range(A.nrows() - 1):
        term = left * term * right
        total = total + term
    return total
