"""A gain of a small noise bound at a wanted rate, over P and Y = P K together, in floats: no proof of it.

    e' = (M - K C) e + (B + K) v + (G - K D) diag(d) (H e + E v),   |d_j| <= 1,   |v_j| <= 1,   V = e'P e

    minimise t:   V' <= -2 rate V where v = 0,   V' <= -alpha V + sum_j lambda_j v_j^2,   sum_j lambda_j <= alpha,
                  c P^-1 c' <= t for every c,   K'P K <= fastest^2 I

for all d at the corners, or by multipliers where these are many; all of it is linear in P, Y, the multipliers and t.
The last row asks that noise alone moves e by at most `fastest`, per unit of time, in the norm in which e is at most 1:
without it the gain of a single state, for one, would have no end. Source: Boyd, El Ghaoui, Feron, Balakrishnan, "Linear
Matrix Inequalities in System and Control Theory", SIAM (1994), 6.1.3, 7.1.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.inequality import one_by_one
from hgogen.guarantees.quadratic import Array
from hgogen.guarantees.semidefinite import CLOSER, Rows, definite, solved

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
    """The program in the scale of the chain. Its variables are the entries of P and Y, the multipliers of slopes for
    the rate, and with noise, and the lambda; t is the last. Each matrix is linear in them, and is made for the unit
    vectors of all at once, (N, ..)."""

    open: Open
    rate: float
    alpha: float

    def gain(self, rows: Array, fastest: float) -> Array | None:
        """K (n, p)."""
        cones = [*self._falling(), *map(self._reach, rows), self._limited(fastest), self._signs()]
        solution = solved(np.append(np.zeros(self._size), 1.0), cones, CLOSER, _WHAT)
        if solution is None:
            return None
        P, Y = (np.einsum("k,kij->ij", solution[0][:-1], each) for each in (self._P, self._Y))
        return np.linalg.solve(P, Y) if np.linalg.eigvalsh(P).min() > 0 else None

    @cached_property
    def _of_P(self) -> list[tuple[int, int]]:
        return [(i, j) for j in range(len(self.open.chain)) for i in range(j + 1)]

    @cached_property
    def _multipliers(self) -> int:
        """Of slopes; none where corners are taken one by one."""
        n, m = self.open.G.shape
        return 0 if one_by_one(n, m) else m

    @cached_property
    def _size(self) -> int:
        """N."""
        return len(self._of_P) + self.open.C.size + 2 * self._multipliers + len(self.open.C)

    @cached_property
    def _P(self) -> Array:
        n = len(self.open.chain)
        P = np.zeros((self._size, n, n))
        for k, (i, j) in enumerate(self._of_P):
            P[k, i, j] = P[k, j, i] = 1.0
        return P

    @cached_property
    def _Y(self) -> Array:
        (p, n), first = self.open.C.shape, len(self._of_P)
        Y = np.zeros((self._size, n, p))
        Y[first : first + n * p] = np.eye(n * p).reshape(n * p, n, p)
        return Y

    def _diagonal(self, first: int, count: int) -> Array:
        """The diagonal matrix of so many variables, from this one on, as counted from the last."""
        diagonal = np.zeros((self._size, count, count))
        for i in range(count):
            diagonal[self._size - first + i, i, i] = 1.0
        return diagonal

    def _falling(self) -> Iterator[Rows]:
        """The forms of the rate, and with noise, at each corner or with multipliers."""
        k, p = self._multipliers, len(self.open.C)
        first = p + 2 * k
        powers = self._diagonal(p, p)
        corners = [None] if k else map(np.array, product((-1.0, 1.0), repeat=self.open.G.shape[1]))
        for d in corners:
            yield _negative(self._form(d, 2 * self.rate, self._diagonal(first, k)))
            S = self._diagonal(first - k, k)
            yield _negative(self._driven(d, self._form(d, self.alpha, S), S, powers))

    def _form(self, d: Array | None, alpha: float, S: Array) -> Array:
        """That of V' + alpha V."""
        o, P, Y, slopes = self.open, self._P, self._Y, self._slopes
        flow = P @ o.M - Y @ o.C + alpha / 2 * P
        if d is not None:
            flow = flow + (slopes * d) @ o.H
        whole = flow + flow.transpose(0, 2, 1)
        return whole if d is not None else _bordered(whole + o.H.T @ S @ o.H, slopes, -S)

    def _driven(self, d: Array | None, form: Array, S: Array, powers: Array) -> Array:
        """The form with errors of the samples, whose `powers` are theirs."""
        o, rates = self.open, self._P @ self.open.B + self._Y
        if d is not None:
            return _bordered(form, rates + (self._slopes * d) @ o.E, -powers)
        beside = np.concatenate([rates + o.H.T @ S @ o.E, 0 * S @ o.E], axis=1)
        return _bordered(form, beside, o.E.T @ S @ o.E - powers)

    @cached_property
    def _slopes(self) -> Array:
        """P (G - K D)."""
        return np.asarray(self._P @ self.open.G - self._Y @ self.open.D)

    def _reach(self, c: Array) -> Rows:
        """[t, c; c', P] >= 0."""
        n = len(c)
        beside, last, whole = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1)), np.zeros((self._size, n + 1, n + 1))
        beside[0, 1:] = beside[1:, 0] = c
        last[0, 0], whole[:, 1:, 1:] = -1.0, -self._P
        return definite(whole, last[None], beside)

    def _limited(self, fastest: float) -> Rows:
        """[fastest^2 I, Y'; Y, P] >= 0."""
        n, p = self._Y.shape[1:]
        end = np.zeros((n + p, n + p))
        end[n:, n:] = fastest**2 * np.eye(p)
        whole = -_bordered(self._P, self._Y, np.zeros((self._size, p, p)))
        return definite(whole, 0 * end[None], end)

    def _signs(self) -> Rows:
        """Multipliers at least 0, the lambda together at most alpha."""
        p = len(self.open.C)
        others = 2 * self._multipliers + p
        A = np.zeros((1 + others, self._size + 1))
        A[0, self._size - p : self._size] = 1.0
        A[1:, self._size - others : self._size] = -np.eye(others)
        return A, np.append([_LESS * self.alpha], np.zeros(others)), False


def _negative(forms: Array) -> Rows:
    """That a matrix of the variables but t is negative."""
    size = forms.shape[-1]
    return definite(forms, np.zeros((1, size, size)), -_BY * np.eye(size))


def _bordered(inner: Array, beside: Array, corner: Array) -> Array:
    """[inner, beside; beside', corner], each (N, ..)."""
    return np.block([[inner, beside], [beside.transpose(0, 2, 1), corner]])


def opened(without: Uncertain, ones: Uncertain, *, heads: Sequence[int], chain: Sequence[int]) -> Open:
    """From what is obeyed, in floats, with a gain of 0, and with one whose entries are all 1: they differ by what the
    gain reads."""
    e, C, D = without, without.M - ones.M, without.G - ones.G
    return Open(e.M, e.G, e.H, C[list(heads)], D[list(heads)], e.B, e.E, tuple(chain))
