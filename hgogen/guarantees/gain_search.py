"""A gain of a small noise bound at a wanted rate, over P and Y = P K together, in floats: no proof of it.

    e' = (M - K C) e + (B + K) v + (G - K D) diag(d) (H e + E v),   |d_j| <= 1,   |v_j| <= 1,   V = e'P e

    minimise t:   V' <= -2 rate V where v = 0,   V' <= -alpha V + sum_j lambda_j v_j^2,   sum_j lambda_j <= alpha,
                  c P^-1 c' <= t for every c,   K'P K <= fastest^2 I

for all d at the corners, or by multipliers where these are many; all of it is linear in P, Y, the multipliers and t:
P (M - K C) is [P, Y] times the rows of M and -C, so that the forms are those of `inequality`, with [P, Y] for P.
The last row asks that noise alone moves e by at most `fastest`, per unit of time, in the norm in which e is at most 1:
without it the gain of a single state, for one, would have no end. Source: Boyd, El Ghaoui, Feron, Balakrishnan, "Linear
Matrix Inequalities in System and Control Theory", SIAM (1994), 6.1.3, 7.1.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.inequality import ends, flow, one_by_one, pushed
from hgogen.guarantees.quadratic import Array, Quadratic
from hgogen.guarantees.semidefinite import CLOSER, Rows, basis, definite, entries, reaching, solved

_WHAT = "the design of a gain"
_LESS = 1 - 1e-6  # of alpha for the lambda
_BY = 1e-7  # by which forms are negative
_DOUBLINGS = 60  # of the pace
_SMALL = 1e-12


@dataclass(frozen=True, eq=False)
class Open:
    """What the error obeys before there is a gain: `M` (n, n), `G` (n, m), `H` (m, n), `C` (p, n), `D` (p, m), `B` (n,
    p) and `E` (m, p), v in its sizes; `chain` (n): the output of each state's chain."""

    M: Array
    G: Array
    H: Array
    C: Array
    D: Array
    B: Array
    E: Array
    chain: tuple[int, ...]

    @property
    def with_gain(self) -> Uncertain:
        """What the error obeys, below which stands what a gain multiplies (n + p, ..)."""
        M, G = np.vstack([self.M, -self.C]), np.vstack([self.G, -self.D])
        B = np.vstack([self.B, np.eye(len(self.C))])
        return Uncertain(M, G, self.H, B, self.E, M, B)

    def seen(self, T: Array, pace: float) -> "Open":
        """The same of e = diag(T) x, in a time that runs `pace` times as fast, each slope as strong where it enters as
        where it reads."""
        G, H = self.G / T[:, None] / pace, self.H * T
        enters, reads = np.linalg.norm(G, axis=0), np.linalg.norm(H, axis=1)
        g = np.sqrt(np.divide(reads, enters, out=np.ones_like(reads), where=(reads > _SMALL) & (enters > _SMALL)))
        M, B = self.M * T / T[:, None] / pace, self.B / T[:, None] / pace
        return Open(M, G * g, H / g[:, None], self.C * T, self.D * g, B, self.E / g[:, None], self.chain)

    def scale(self, pace: float) -> Array:
        """The T (n) in which noise moves the head of a chain by 1, and a state of size 1 the one before it by the pace
        in a unit of time."""
        T = np.zeros(len(self.M))
        for i, j in enumerate(self.chain):
            head = i == 0 or self.chain[i - 1] != j
            T[i] = 1 / abs(self.C[j, i]) if head else T[i - 1] * pace / abs(self.M[i - 1, i])
        return T

    def pace(self, rate: float) -> float:
        """A rate, or twice it, and so on, in whose scale no slope weighs more than the chain does."""
        pace = rate
        for _ in range(_DOUBLINGS):
            x = self.seen(self.scale(pace), pace)
            if max(np.abs(x.M).max(), (np.abs(x.G) @ np.abs(x.H)).max(initial=0.0)) <= 1 + _SMALL:
                break
            pace *= 2
        return pace


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked: a gain for what is `open`, of a `rate`, with a small largest |c e| of the `rows` c (r, n), and no
    faster than `fastest` (1/time)."""

    open: Open
    rate: float
    rows: Array
    fastest: float

    @cached_property
    def pace(self) -> float:
        """In which numbers are near 1: a long chain needs poles that are faster than the rate."""
        return self.open.pace(self.rate) * (1 + len(self.open.M) / 4)

    def gain(self, rate: float, noisy: float) -> Array | None:
        """K (n, p) by a norm that falls at this rate, and with noise at the rate `noisy`; None where there is none.

        Raises: `NoSolver`.
        """
        T = self.open.scale(self.pace)
        rows = self.rows * T
        rows = rows / np.linalg.norm(rows, axis=1).max()
        program = _Program(self.open.seen(T, self.pace), rate / self.pace, 2 * noisy / self.pace)
        K = program.gain(rows, self.fastest / self.pace)
        return None if K is None else K * T[:, None] * self.pace


@dataclass(frozen=True, eq=False)
class _Program:
    """The program in the scale of the chain. Its variables (N) are the entries of P and Y, the multipliers of slopes
    for the rate, and with noise, and the lambda; t is the last."""

    open: Open
    rate: float
    alpha: float

    def gain(self, rows: Array, fastest: float) -> Array | None:
        """K (n, p)."""
        reach = (reaching(c, self._size) for c in rows)
        cones = [*self._falling(), *reach, self._limited(fastest), self._signs()]
        solution = solved(np.append(np.zeros(self._size), 1.0), cones, CLOSER, _WHAT)
        if solution is None:
            return None
        (p, n), (of_P, of_Y, _) = self.open.C.shape, self._sizes
        P = np.einsum("k,kij->ij", solution[0][:of_P], basis(n))
        Y = solution[0][of_P : of_P + of_Y].reshape(n, p)
        return np.linalg.solve(P, Y) if np.linalg.eigvalsh(P).min() > 0 else None

    @cached_property
    def _sizes(self) -> tuple[int, int, int]:
        """How many entries P and Y have, and how many slopes have multipliers: none at corners one by one."""
        n, m = self.open.G.shape
        return n * (n + 1) // 2, self.open.C.size, 0 if one_by_one(n, m) else m

    @cached_property
    def _size(self) -> int:
        """N."""
        of_P, of_Y, k = self._sizes
        return of_P + of_Y + 2 * k + len(self.open.C)

    def _falling(self) -> Iterator[Rows]:
        """The forms of the rate, and with noise, at each corner or with multipliers."""
        of_P, of_Y, k = self._sizes
        for e in ends(self.open.with_gain):
            yield self._negative(flow(e).falls(2 * self.rate), of_P + of_Y)
            yield self._negative(pushed(e, self.alpha), of_P + of_Y + k)

    def _negative(self, form: Quadratic, first: int) -> Rows:
        """That a form is negative, its multipliers from the `first` variable on."""
        brings, shared = entries(form), sum(self._sizes[:2])
        whole = np.zeros((self._size, form.size, form.size))
        whole[:shared], whole[first : first + len(form.Q)] = brings[:shared], brings[shared:]
        return definite(whole, np.zeros((1, form.size, form.size)), -_BY * np.eye(form.size))

    def _limited(self, fastest: float) -> Rows:
        """[fastest^2 I, Y'; Y, P] >= 0."""
        (p, n), of_P = self.open.C.shape, self._sizes[0]
        end, whole = np.zeros((n + p, n + p)), np.zeros((self._size, n + p, n + p))
        end[n:, n:] = fastest**2 * np.eye(p)
        whole[:of_P, :n, :n] = -basis(n)
        for k, (i, j) in enumerate(np.ndindex(n, p), of_P):
            whole[k, i, n + j] = whole[k, n + j, i] = -1.0
        return definite(whole, 0 * end[None], end)

    def _signs(self) -> Rows:
        """Multipliers at least 0, the lambda together at most alpha."""
        p, others = len(self.open.C), self._size - sum(self._sizes[:2])
        A = np.zeros((1 + others, self._size + 1))
        A[0, self._size - p : self._size] = 1.0
        A[1:, self._size - others : self._size] = -np.eye(others)
        return A, np.append([_LESS * self.alpha], np.zeros(others)), False


def opened(without: Uncertain, ones: Uncertain, *, heads: Sequence[int], chain: Sequence[int]) -> Open:
    """From what is obeyed, in floats, with a gain of 0, and with one whose entries are all 1: they differ by what the
    gain reads."""
    e, C, D = without, without.M - ones.M, without.G - ones.G
    return Open(e.M, e.G, e.H, C[list(heads)], D[list(heads)], e.B, e.E, tuple(chain))
