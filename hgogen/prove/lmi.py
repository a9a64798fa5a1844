"""Lyapunov inequalities with an exact proof: N'P + P N <= -I for one P and every vertex N of a polytope.

    P > 0,   P <= peak I,   N_v'P + P N_v <= -I for every vertex N_v

Of one matrix the Lyapunov equation N'P + P N = -I is solved in rationals; its solution is the smallest P there is. It
is rounded to short rationals and then verified by the signs of characteristic polynomials in exact arithmetic
(`algebra.definite`). Gains for which there is one P for several are sought by a convex program (cvxpy, Clarabel).
Source: Boyd, El Ghaoui, Feron, Balakrishnan, "Linear Matrix Inequalities
in System and Control Theory", SIAM (1994), 5.1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from flint import fmpq, fmpq_mat

from hgogen.errors import HgogenError
from hgogen.rigor.definite import Matrix, exact, fraction, number, positive, unit
from hgogen.sentence import NONE, Reason, because

STATES = 12  # beyond it the exact Lyapunov equation has too many unknowns for a check that answers at once

# What rounding may take from the inequality: P is made larger by such a share, the smallest that is enough.
_SLACKS = (Fraction(1, 2**24), Fraction(1, 2**16), Fraction(1, 2**8))


@dataclass(eq=False)
class NoSolver(HgogenError):
    """A linear matrix inequality was asked for, and its solver is not installed."""

    what: str

    @property
    def reason(self) -> Reason:
        """What it is needed for."""
        return because("{what} needs cvxpy and clarabel; install them: pip install 'hgogen[lmi]'", what=self.what)

    def __str__(self) -> str:
        return str(self.reason)


def no_solver(what: str) -> Reason:
    """Why `what` has none, or `NONE`."""
    try:
        cones(what)
    except NoSolver as missing:
        return missing.reason
    return NONE


@dataclass(frozen=True)
class Lyapunov:
    """A proved solution: `P` (n, n) symmetric rational, `peak` >= its largest eigenvalue, `vertices` (k of n, n)."""

    P: Matrix
    peak: Fraction
    vertices: tuple[Matrix, ...]

    @property
    def condition(self) -> float:
        """The condition number of P, in floats: for reports."""
        return float(np.linalg.cond(np.array(self.P, dtype=float)))


def verified(candidate: Lyapunov) -> bool:
    """Whether P > 0, peak I - P > 0 and -I - N'P - P N > 0 at every vertex, in exact arithmetic."""
    P, n = exact(candidate.P), len(candidate.P)
    if P.transpose() != P:
        return False
    one = unit(n)
    falling = (-one - (N.transpose() * P + P * N) for N in map(exact, candidate.vertices))
    return all(positive(gap) for gap in (P, one * number(candidate.peak) - P, *falling))


def lyapunov(N: Matrix) -> Lyapunov | None:
    """The smallest P with N'P + P N <= -I, up to rounding outwards; None where N is not Hurwitz.

    N (n, n) rational. The Lyapunov equation is n(n + 1)/2 linear equations in rationals.
    """
    n = len(N)
    places = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(n) for j in range(i, n))}
    rows = [[fmpq(0)] * len(places) for _ in places]
    for (i, j), row in places.items():
        for k in range(n):
            rows[row][places[min(k, j), max(k, j)]] += number(N[k][i])
            rows[row][places[min(i, k), max(i, k)]] += number(N[k][j])
    try:
        solution = fmpq_mat(rows).solve(fmpq_mat([[fmpq(-(i == j))] for i, j in places]))
    except ZeroDivisionError:  # two eigenvalues add up to zero
        return None
    entries = [[solution[places[min(i, j), max(i, j)], 0] for j in range(n)] for i in range(n)]
    return _rounded([[fraction(value) for value in row] for row in entries], (N,))


def gains(corners: Iterable[tuple[Matrix, Sequence[Fraction]]], largest: float) -> tuple[Fraction, ...] | None:
    """A gain K (n), |K| <= `largest`, with one P for all A - K C, of a small largest eigenvalue; None where none is
    found.

    `corners`: (A (n, n), C (n)) at the vertices. With Y = P K the inequality A'P + P A - Y C - C'Y' <= -I is linear;
    K'P K <= largest^2 p and P >= p I bound the gain. Nothing is proved here: `common_norm` does it for the K returned.

    Raises: `NoSolver`.
    """
    cp = solver("a gain for a range of a_i")
    pairs = [(np.array(A, dtype=float), np.array([list(map(float, C))])) for A, C in corners]
    n = len(pairs[0][0])
    P, Y, peak, least = cp.Variable((n, n), PSD=True), cp.Variable((n, 1)), cp.Variable(), cp.Variable()
    one = np.eye(n)
    bounded = cp.bmat([[P, Y], [Y.T, cp.reshape(largest**2 * least, (1, 1), order="C")]])
    limits = [P << peak * one, P >> least * one, bounded >> 0]
    limits += [A.T @ P + P @ A - Y @ C - C.T @ Y.T << -one for A, C in pairs]
    value = solved(cp, cp.Problem(cp.Minimize(peak), limits), P)
    if value is None or np.linalg.eigvalsh(value).min() <= 0:
        return None
    K = np.linalg.solve(value, Y.value).ravel()
    return tuple(Fraction(float(f"{k:.6g}")) for k in K)


def solver(what: str) -> Any:
    """cvxpy, with Clarabel installed. Raises: `NoSolver`, of `what` needs it."""
    try:
        import clarabel  # noqa: F401  # which cvxpy calls
        import cvxpy  # here, because it is slow to import and seldom needed
    except ImportError:
        raise NoSolver(what) from None
    return cvxpy


def cones(what: str) -> tuple[Any, Any]:
    """Clarabel, and the sparse matrices that it takes. Raises: `NoSolver`, of `what` needs it."""
    try:
        import clarabel  # here, as `solver`
        from scipy import sparse
    except ImportError:
        raise NoSolver(what) from None
    return clarabel, sparse


def solved(cp: Any, problem: Any, P: Any) -> np.ndarray | None:
    """P as the solver leaves it, whatever it thinks of it."""
    try:
        with catch_warnings():
            simplefilter("ignore")  # of inaccuracy: what is not exact is refused by `verified`
            problem.solve(solver="CLARABEL")
    except cp.SolverError:
        return None
    value = P.value
    return None if value is None or not np.isfinite(value).all() else np.asarray((value + value.T) / 2)


def _rounded(P: Sequence[Sequence[Fraction]], vertices: tuple[Matrix, ...]) -> Lyapunov | None:
    """P a little larger, in multiples of a power of two so small that the inequality keeps half of what it won."""
    n, steepest = len(P), max([Fraction(1), *(abs(x) for N in vertices for row in N for x in row)])
    for slack in _SLACKS:
        step = Fraction(1, 2 ** (int(4 * n * n * steepest / slack).bit_length()))
        grid = tuple(tuple(round((1 + slack) * value / step) * step for value in row) for row in P)
        peak = float(np.linalg.eigvalsh(np.array(grid, dtype=float)).max())
        short = slack * Fraction(2) ** int(np.ceil(np.log2(max(peak, 1e-300))))
        above = -(-Fraction(peak) * (1 + slack) // short) * short  # by that share at least, a few times that at most
        candidate = Lyapunov(grid, above, vertices)
        if verified(candidate):
            return candidate
    return None
