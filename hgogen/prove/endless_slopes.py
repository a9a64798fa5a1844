"""One norm for slopes of one sign that have no other end, in continuous time.

    e' = M e + G p - sum_k s_k onto_k q_k,   q_k = d_k reads_k e,   d_k >= 0 of any size,   V = e'P e

A slope that is at most h, whatever it is below, is h less a d >= 0 (s = 1); one that is at least h is h and more (s =
-1); h stands in M. With

    P onto_k = s_k lambda_k reads_k',   lambda_k >= 0,

V' loses 2 lambda_k (reads_k e)^2 d_k, however large d_k is: what makes V fall without the d does with them. That V
falls wherever e is asks for a slope in the last of two states of a chain, N between 0 and a bound, or in its only one:
from longer chains to what b reads the response is not strictly positive. P keeps to these equations exactly: it is a
sum of rational matrices that do, of which a solver finds the shares, rounded, and rationals prove the rest as
`common_norm` does. What b reads nothing of, reads_k = 0, asks for nothing. An h of a degree above -1 has the sign that
makes the set of slopes shrink as theta grows, so that a P that serves a theta serves larger ones. Source: Arcak,
Kokotovic, "Nonlinear observers: a circle criterion design and robustness analysis", Automatica 37 (2001), theorem 1.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from flint import fmpq, fmpq_mat

from hgogen.prove.common_norm import CLOSE, Flow
from hgogen.prove.inclusion import Slope
from hgogen.prove.lmi import no_solver
from hgogen.prove.quadratic import Array, Quadratic, Weights, floats, on_grid, rational, verified
from hgogen.prove.semidefinite import margin
from hgogen.sentence import Reason, because

_WHAT = "one norm for slopes without an end"
_MARGIN = 1e-7  # that a form has to have in floats
_BITS = (20, 30, 44)
_NONE = (
    "no norm is found that keeps to the slopes without an end: there may be one where they are in the last of two "
    "states of a chain, by an argument that is positive there, or in a state in whose place b reads the sample"
)


@dataclass(frozen=True)
class OneSided(Flow):
    """Norms for an `error` some of whose slopes have one end, at `theta` and beyond."""

    how: str = "one norm that keeps to the signs of slopes without an end,"
    close: ClassVar[tuple[float, float]] = (CLOSE, CLOSE)

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes without an end, of which something is read."""
        return tuple(slope for slope in self.error.endless if any(slope.reads))

    @property
    def missing(self) -> Reason:
        """Why there is a proof at no theta."""
        return no_solver(_WHAT) or because(_NONE)

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        return no_solver(_WHAT) or because("no norm is found for all slopes in their ranges")

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        """The shares of the basis, rounded, so that P keeps to the equations exactly."""
        rows = np.array([floats(matrix).ravel() for matrix in self._basis])
        y = np.linalg.lstsq(rows.T, P.ravel(), rcond=None)[0]
        for bits in _BITS:
            multipliers = on_grid(S, bits)
            whole = sum(
                (share * one for share, one in zip(on_grid(y, bits), self._basis, strict=True)), 0 * self._basis[0]
            )
            if self._signed(whole) and verified(forms, whole, multipliers):
                return Weights.of(whole, multipliers)
        return None

    @cached_property
    def _basis(self) -> tuple[Array, ...]:
        """Symmetric matrices (n, n), of FLINT's rationals, of whose sums P onto_k is along reads_k for every k."""
        n = len(self.error.N)
        units, slopes = list[Array](), self.endless
        for j in range(n):
            for i in range(j + 1):
                unit = rational(np.zeros((n, n), dtype=int).tolist())
                unit[i, j] = unit[j, i] = fmpq(1)
                units.append(unit)
        rows = []
        for k, slope in enumerate(slopes):
            onto, reads = rational(slope.onto), rational(slope.reads)
            for i in range(n):
                along = [-reads[i] if at == k else fmpq(0) for at in range(len(slopes))]
                rows.append([*((unit @ onto)[i] for unit in units), *along])
        null = _null(rows, len(units) + len(slopes))
        return tuple(sum((x * unit for x, unit in zip(row, units, strict=False)), 0 * units[0]) for row in null)

    def _signed(self, P: Array) -> bool:
        """Whether every s_k lambda_k has the sign that it has to."""
        return all(share >= 0 for share in self._lambdas(P))

    def _lambdas(self, P: Array) -> Iterator[Any]:
        """The lambda_k, in the arithmetic of P, of one that keeps to the equations."""
        for slope in self.endless:
            onto, reads = rational(slope.onto), rational(slope.reads)
            onto, reads = (onto, reads) if P.dtype == object else (floats(each[None])[0] for each in (onto, reads))
            yield -slope.endless * ((P @ onto) @ reads) / (reads @ reads)

    def _sought(self, forms: Sequence[Quadratic]) -> tuple[Array, Array] | None:
        """P that keeps to the equations, and multipliers S, with which forms of floats are negative by the most."""
        basis = [floats(matrix) for matrix in self._basis]
        if not basis or no_solver(_WHAT):
            return None
        signs = np.array([[float(share) for share in self._lambdas(matrix)] for matrix in basis]).T
        best = margin(forms, _WHAT, span=(np.array(basis), signs))
        return (best.P, best.S) if best is not None and best.margin > _MARGIN else None


def _null(rows: Sequence[Sequence[fmpq]], count: int) -> list[list[fmpq]]:
    """A basis of the x (count) with which every row is 0."""
    if not rows:
        return [[fmpq(int(i == j)) for j in range(count)] for i in range(count)]
    reduced, rank = fmpq_mat([list(row) for row in rows]).rref()
    table = [[reduced[i, j] for j in range(count)] for i in range(rank)]
    leads = [next(j for j, x in enumerate(row) if x) for row in table]
    basis = []
    for free in (j for j in range(count) if j not in leads):
        row = [fmpq(int(j == free)) for j in range(count)]
        for lead, each in zip(leads, table, strict=True):
            row[lead] = -each[free]
        basis.append(row)
    return basis
