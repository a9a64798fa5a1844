"""One step of an explicit Runge-Kutta method on an inclusion, each stage with slopes of its own.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i

All is linear in v = (e, p_1, .., p_s): e+ = e + h D v, H X_i = Q_i v; an error of what is injected at a stage adds a
column to D and Q (`Inputs`). The slopes |d_ij| <= 1 of different stages are
independent, so what holds for all d_i holds for whatever the estimate meets on its way. With P > 0 and S_i >= 0
diagonal,

    (|e+|_P^2 - |e|_P^2)/h + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0

proves |e+|_P^2 <= (1 - alpha h) |e|_P^2. The difference over h is 2 e'P D v + h |D v|_P^2: at h = 0 the inequality is
that of continuous time.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, reduce
from itertools import product
from typing import Any

import numpy as np
from flint import arb

from hgogen.algebra.definite import fraction, number
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.quadratic import Array, Quadratic, floats, identity, times

_SHORT = 10_000  # the largest denominator of a tableau's coefficients
_ALL = 8  # slopes of which all corners are tried


@dataclass(frozen=True, eq=False)
class Inputs:
    """What q inputs add to a step: `D` (N, q) to e over h, `Q` (s m, q) to what the slopes read."""

    D: Array
    Q: Array

    def __mul__(self, size: Fraction) -> "Inputs":
        """Those of inputs in units of a size."""
        return Inputs(self.D * number(size), self.Q * number(size))

    def __add__(self, other: "Inputs") -> "Inputs":
        """One input that is both."""
        return Inputs(self.D + other.D, self.Q + other.Q)

    @classmethod
    def of(cls, each: Iterable["Inputs"]) -> "Inputs":
        """All of several."""
        each = tuple(each)
        return cls(np.hstack([one.D for one in each]), np.hstack([one.Q for one in each]))


@dataclass(frozen=True, eq=False)
class Stagewise:
    """A step of length `h` on `slopes` m: `D` (N, N + s m), what it adds to e over h, and `Q` (s m, N + s m). `stages`:
    what an error of each output (p) at each stage (s) adds, (s, p) of them; `nodes` (s): where the stages stand, from 0
    to 1. `degree`: of its form as a polynomial in h, 0 where it is none."""

    h: Fraction
    slopes: int
    D: Array
    Q: Array
    stages: tuple[tuple[Inputs, ...], ...]
    nodes: tuple[Fraction, ...]
    degree: int = 0

    @property
    def rows(self) -> int:
        """The size of its form."""
        return int(self.D.shape[1])

    @property
    def arithmetic(self) -> str:
        """The arithmetic in which its forms are shown to be negative."""
        return "outward rounded" if any(isinstance(value, arb) for value in self.D.flat) else "rational"

    def contraction(self, alpha: Fraction) -> Quadratic:
        """The form that is negative where |e+|_P^2 <= (1 - alpha h) |e|_P^2."""
        n, size = self.D.shape
        E, Z = identity(size)[:n], identity(size)[n:]
        return Quadratic(((E, self.D + E * (number(alpha) / 2)), (self.D * (number(self.h) / 2), self.D)), self.Q, Z)

    def ends(self, output: int) -> tuple[Inputs, Inputs]:
        """An error of the sample of an output at the beginning, and at the end, with those on the line between."""
        parts = [(one[output] * (1 - c), one[output] * c) for one, c in zip(self.stages, self.nodes, strict=True)]
        first, last = zip(*parts, strict=True)
        return reduce(Inputs.__add__, first), reduce(Inputs.__add__, last)

    def beside(self, onto: Array) -> Inputs:
        """What comes to e beside the step, `onto` (N) times h."""
        return Inputs(onto[:, None], 0 * self.Q[:, :1])

    def bounded(self, alpha: Fraction, inputs: Inputs) -> Quadratic:
        """The form that is negative where |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k v_k^2, v the inputs (q);
        the lambda_k are the last q multipliers."""
        onto = (0 * inputs.D, inputs.D), (inputs.D * (number(self.h) / 2), inputs.D)
        return self.contraction(alpha).driven(onto, inputs.Q)

    def frozen(self, d: np.ndarray) -> np.ndarray:
        """e+ = T e, T (k, N, N) in floats, of slopes d (k, m) that are the same at all stages."""
        n, size = self.D.shape
        v = np.zeros((len(d), size, n))
        v[:, :n] = np.eye(n)
        for i, row in enumerate(floats(self.Q)):  # reads nothing of its own stage, nor of later ones
            v[:, n + i] = d[:, i % self.slopes, None] * (row @ v)
        return np.asarray(np.eye(n) + float(self.h) * (floats(self.D) @ v))


ErrorStep = Callable[[Fraction, Uncertain], Stagewise]  # a method: a step of that length on what the error obeys


def corners(m: int) -> np.ndarray:
    """The corners (k, m) of the cube of m slopes; of many slopes some, always the same."""
    if m <= _ALL:
        return np.array(list(product((-1.0, 1.0), repeat=m))).reshape(2**m, m)
    return np.random.default_rng(0).choice((-1.0, 1.0), size=(2**_ALL, m))


def stagewise(tableau: Tableau, h: Fraction, e: Uncertain) -> Stagewise:
    """The step of length h >= 0, what is injected at a stage by itself."""
    (n, m), s, p, length = e.G.shape, len(tableau.b), e.B.shape[1], number(h)
    size = n + s * m
    unit = identity(size + s * p)[:n]
    nothing, rates, reads = 0 * unit, list[Array](), list[Array]()
    for i, row in enumerate(tableau.a):
        X = unit + length * sum((_exactly(a) * w for a, w in zip(row, rates, strict=True) if a), nothing)
        slopes, samples = slice(n + i * m, n + (i + 1) * m), slice(size + i * p, size + (i + 1) * p)
        read, rate = times(e.H, X), times(e.M, X)
        read[:, samples], rate[:, slopes], rate[:, samples] = e.E, e.G, e.B  # which nothing before has read
        reads.append(read)
        rates.append(rate)
    D, Q = sum((_exactly(b) * w for b, w in zip(tableau.b, rates, strict=True)), nothing), np.concatenate(reads)
    each = [Inputs(D[:, [k]], Q[:, [k]]) for k in range(size, size + s * p)]
    stages = tuple(tuple(each[i * p : (i + 1) * p]) for i in range(s))
    nodes = tuple(fraction(_exactly(c)) for c in tableau.c)
    return Stagewise(h, m, D[:, :size], Q[:, :size], stages, nodes, 2 * s - 1)


def flowing(e: Uncertain, alpha: Any) -> Quadratic:
    """The form that is negative where V' <= -alpha V, V = |e|_P^2, in continuous time, in the arithmetic of both.

    [M'P + P M + alpha P + H'S H, P G; G'P, -S]
    """
    n, m = e.G.shape
    one = np.eye(n + m) if e.M.dtype == float else identity(n + m)
    rates = np.hstack([e.M + one[:n, :n] * (alpha / 2), e.G])
    return Quadratic(((one[:n], rates),), np.hstack([e.H, 0 * one[n:, n:]]), one[n:])


def pushed(e: Uncertain, alpha: Any) -> Quadratic:
    """The form that is negative where V' <= -alpha V + sum_k lambda_k v_k^2, v the inputs (q) of e; the lambda_k are
    the last q multipliers."""
    return flowing(e, alpha).driven(((0 * e.B, e.B),), e.E)


@cache
def _exactly(coefficient: float) -> Any:
    """A coefficient as the tableau means it, such as 1/6."""
    return number(Fraction(coefficient).limit_denominator(_SHORT))
