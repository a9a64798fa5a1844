"""How x' = A(t) x moves over a piece of time, and what y = C(t) x shows of it there, enclosed in balls.

    Phi' = A Phi, Phi = 1 at its begin,   W = integral Phi' C' C Phi:   (Phi, W) of one piece after another is
    (Phi_2 Phi_1, W_1 + Phi_1' W_2 Phi_1)

Phi and Phi' C' C Phi are Taylor series at the begin to an order N. What they leave is the coefficient N + 1 somewhere
in the piece (Lagrange), entry by entry: at most that of the series whose coefficients are the norms of those of A and C
on the whole piece, from |Phi| <= exp(length |A|); an entry of V' V, V = C Phi, is no more than |V|^2. Arb's balls are
rounded outward.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint
import sympy as sp

from hgogen.algebra.balls import Balls, between
from hgogen.algebra.definite import number
from hgogen.algebra.series import Plant, evaluate
from hgogen.algebra.tape import tape

ORDER = 9  # N

_BALLS = Balls(0)


@dataclass(frozen=True)
class Shown:
    """Of a time: the transition `Phi` over it and what is shown in it, `W` (n, n), matrices of balls."""

    Phi: Any
    W: Any

    def then(self, after: "Shown") -> "Shown":
        """Of this time and the one after it together."""
        return Shown(after.Phi * self.Phi, self.W + self.Phi.transpose() * after.W * self.Phi)


class Course:
    """A (n, n) and C (p, n) as expressions of the time, and of parameters in their `ends`.

    Raises: `NoTape` for what has no series.
    """

    def __init__(self, A: sp.Matrix, C: sp.Matrix, time: sp.Symbol, ends: Sequence[tuple[sp.Symbol, Any, Any]]) -> None:
        self.n, self.p = A.rows, C.rows
        self._plant = Plant(tape([*A, *C], (time, *(symbol for symbol, _, _ in ends))), 0, 0, 1 + len(ends))
        self._constants = [between(Fraction(low), Fraction(high)) for _, low, high in ends]

    def piece(self, begin: Fraction, length: Fraction) -> Shown:
        """Of the piece of that length (s) that begins there. Raises: `Undecided`, `ZeroDivisionError`."""
        h, order = flint.arb(number(length)), ORDER + 1
        A, C = self._series(flint.arb(number(begin)), order)
        Phi = [flint.arb_mat(self.n, self.n, [int(i == j) for i in range(self.n) for j in range(self.n)])]
        for k in range(ORDER):
            Phi.append(_convolved(A, Phi, k) * _BALLS.over(k + 1))
        V = [_convolved(C, Phi, k) for k in range(order)]
        rates = [_convolved([v.transpose() for v in V], V, k) for k in range(order)]
        rest, lost = self._rest(begin, length)
        end = sum((Phi[k] * h**k for k in range(1, order)), Phi[0] + _around(self.n, rest))
        shown = (rates[k] * (h ** (k + 1) * _BALLS.over(k + 1)) for k in range(order))
        return Shown(end, sum(shown, _around(self.n, lost)))

    def steepest(self, begin: Fraction, length: Fraction) -> Any:
        """A bound of the largest eigenvalue of |A + A'|/2 on the piece, a ball."""
        (A,), _ = self._series(between(begin, begin + length), 1)
        return _norm((A + A.transpose()) * _BALLS.over(2))

    def _rest(self, begin: Fraction, length: Fraction) -> tuple[Any, Any]:
        """What the two series leave at the end of the piece, balls whose upper ends are the bounds."""
        h, order = flint.arb(number(length)), ORDER + 2
        A, C = self._series(between(begin, begin + length), order)
        a, c = ([_norm(each) for each in series] for series in (A, C))
        phi = [(h * a[0]).exp()]
        for k in range(ORDER + 1):
            phi.append(_convolved(a, phi, k) * _BALLS.over(k + 1))
        v = [_convolved(c, phi, k) for k in range(order)]
        shown = _convolved(v, v, ORDER + 1)
        return phi[-1] * h ** (ORDER + 1), shown * h ** (ORDER + 2) * _BALLS.over(ORDER + 2)

    def _series(self, time: Any, order: int) -> tuple[list[Any], list[Any]]:
        """The Taylor coefficients of A and C, below the order, at a ball of times."""
        values = [_BALLS.series([time, 1], order), *(_BALLS.series([value], order) for value in self._constants)]
        rows = [_BALLS.coefficients(row, order) for row, _ in evaluate(self._plant, _BALLS, values, order, 1)]
        square = self.n * self.n
        A, C = rows[:square], rows[square:]
        return (
            [_BALLS.matrix(self.n, self.n, (row[k] for row in A)) for k in range(order)],
            [_BALLS.matrix(self.p, self.n, (row[k] for row in C)) for k in range(order)],
        )


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    """The coefficient k of a b."""
    total = a[0] * b[k]
    for i in range(1, k + 1):
        total = total + a[i] * b[k - i]
    return total


def _norm(M: Any) -> Any:
    """The largest sum of sizes of a row, or of a column, a ball whose upper end is the bound: at least the spectral
    norm, and each entry."""
    rows = [[abs(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())]
    sums = [sum(row, flint.arb(0)) for row in (*rows, *zip(*rows, strict=True))]
    total = sums[0]
    for each in sums[1:]:
        total = total.max(each)
    return total


def _around(n: int, size: Any) -> Any:
    """A matrix of balls about 0."""
    return flint.arb_mat(n, n, [flint.arb(0, size.abs_upper())] * (n * n))
