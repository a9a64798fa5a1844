"""Quadratic forms that a P > 0 and multipliers S >= 0 make negative: weights found in floats, proved in rationals.

    sum over pairs (X, Y) of X'P Y + Y'P X,   plus   Q'S Q - Z'S Z,   is negative definite;   S diagonal

A vector v of the form holds the state that decays and the multiplied inputs: each multiplier belongs to a relation |Z_j
v| <= |Q_j v|, such as p = d q, |d| <= 1, for a slope d. Where the form is negative for all v, the pairs alone are
negative for each v that satisfies the relations (the S-procedure; Boyd, El Ghaoui, Feron, Balakrishnan, "Linear Matrix
Inequalities in System and Control Theory", SIAM (1994), 2.6.3).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from math import lcm
from operator import add, mul
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq, fmpq_mat

from hgogen.rigor.definite import Matrix, definite, fraction, number, positive

Array = np.ndarray  # of floats, or of FLINT's rationals or balls as objects
BALLS = 256  # bits of a ball

MARGINS = (1e-4, 1e-6, 1e-3)  # margins of a negative form, for rounding
_FINE = (34, 48)  # bits after the point, over the size of P
_GRIDS = (30, 44, 60, 110)  # bits after the point of rounded P and S, for a P of trace n
_ROUNDING = 1e-8  # the largest effect of rounding to a grid on a form
_SWEEPS = 10  # over all rows and columns
_SMALL = 1e-6  # of the largest reading: a lower limit
_NIL, _TENTH = 1e-12, 0.1  # of the largest reading: one of rounding errors, and its substitute


@dataclass(frozen=True, eq=False)
class Quadratic:
    """A symmetric matrix (N, N) that is linear in P (n, n) and a diagonal S (k): the sum over `pairs` (X, Y) of X'P Y +
    Y'P X, plus Q'S Q - Z'S Z + `constant`. Shapes: X, Y (n, N); `Q`, `Z` (k, N); `constant` (N, N), None for 0."""

    pairs: tuple[tuple[Array, Array], ...]
    Q: Array
    Z: Array
    constant: Array | None = None

    def value(self, P: Array, S: Array) -> Array:
        """Return the symmetric matrix (N, N) of the quadratic form at P (n, n) and the diagonal S (k)."""
        if P.dtype == object and not any(isinstance(value, arb) for value in self.pairs[0][1].flat):
            value = self._of_rationals(P, S)
        else:
            halves = [X.T @ P @ Y for X, Y in self.pairs]
            squares = self.Q.T @ (S[:, None] * self.Q) - self.Z.T @ (S[:, None] * self.Z)
            value = np.asarray(sum((half + half.T for half in halves), squares))
        return value if self.constant is None else value + self.constant

    def _of_rationals(self, P: Array, S: Array) -> Array:
        """Return the matrix (N, N) of the quadratic form at rational P and S.
        Integers over a common denominator make it ten times as fast."""
        parts = []
        for X, Y in self.pairs:
            half, below = _product(X.T, P, Y)
            parts.append((half + half.transpose(), below))
        parts += [_product(rows.T, np.diag(by), rows) for rows, by in ((self.Q, S), (self.Z, -S))]
        common = reduce(lcm, (int(below) for _, below in parts))
        return _array(fmpq_mat(reduce(add, (part * (common // int(below)) for part, below in parts))) / common)

    def driven(self, onto: Sequence[tuple[Array, Array]], reads: Array) -> "Quadratic":
        """Return the quadratic form with q additional inputs w, in (v, w): `onto` has a pair (x, y) (n, q) for each of
        the `pairs`, and X v becomes X v + x w, Y v becomes Y v + y w, Q v becomes Q v + `reads` w, `reads` (k, q). Then
        sum_k lambda_k w_k^2 is subtracted; the lambda_k are the last q entries of its S."""
        q, size = reads.shape[1], self.size
        one = np.eye(size + q, dtype=int) + 0 * self.pairs[0][0][0, 0]
        pairs = tuple((np.hstack([X, x]), np.hstack([Y, y])) for (X, Y), (x, y) in zip(self.pairs, onto, strict=True))
        Q = np.vstack([np.hstack([self.Q, reads]), 0 * one[:q]])
        constant = None if self.constant is None else np.pad(self.constant, (0, q))
        return Quadratic(pairs, Q, np.vstack([np.hstack([self.Z, 0 * reads]), one[size:]]), constant)

    def over(self, pace: Any) -> "Quadratic":
        """Return the form in a unit of time 1/`pace`: each Y is divided by `pace` > 0. With S divided by `pace` as
        well, it is negative exactly where this form is."""
        constant = None if self.constant is None else self.constant / pace
        return Quadratic(tuple((X, Y / pace) for X, Y in self.pairs), self.Q, self.Z, constant)

    @property
    def size(self) -> int:
        """The number N of rows and columns of the form."""
        return int(self.pairs[0][0].shape[1])

    @property
    def floats(self) -> "Quadratic":
        """The form with its matrices in floats."""
        pairs = tuple((floats(X), floats(Y)) for X, Y in self.pairs)
        return Quadratic(
            pairs, floats(self.Q), floats(self.Z), None if self.constant is None else floats(self.constant)
        )


@dataclass(frozen=True)
class Weights:
    """Rational weights that make a quadratic form negative: `P` (n, n), symmetric, and multipliers `S` (k) >= 0."""

    P: Matrix
    S: tuple[Fraction, ...]

    @classmethod
    def of(cls, P: Array, S: Array) -> "Weights":
        """Return the weights from arrays of FLINT's rationals."""
        return cls(fractions(P), tuple(map(fraction, S)))


def proved(forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
    """Return rational weights that are proved to make all exact `forms` negative, by rounding `P` and `S` (floats);
    None where no rounding does."""
    for bits in _GRIDS:
        exactly = on_grid(P, bits), on_grid(S, bits)
        if verified(forms, *exactly):
            return Weights.of(*exactly)
    return None


def confirmed(
    forms: Sequence[Quadratic],
    by_margin: Callable[[float], tuple[Array, Array] | None],
    q: int = 0,
    most: Fraction | None = None,
    margins: Sequence[float] = MARGINS,
) -> tuple[Array, Array] | None:
    """Return P and S, in FLINT's rationals, that are proved to make all exact `forms` negative; None where none are.

    `by_margin(m)` searches P and S in floats with forms <= -m I, for each m of `margins`: a smaller m helps where the
    forms do not admit a larger one, a larger m where the solver ends at the boundary. The last `q` entries of S sum up
    to at most `most`.
    """
    for candidate in filter(None, map(by_margin, margins)):
        if not np.isfinite(np.concatenate([each.ravel() for each in candidate])).all():
            continue
        places = max(0, -int(np.floor(np.log2(np.trace(candidate[0])))))  # bits between the trace of P and 1
        for bits in _FINE:
            P, S = (on_grid(each, bits + places) for each in candidate)
            if (most is None or sum(S[-q:]) <= number(most)) and verified(forms, P, S):
                return P, S
    return None


@dataclass(frozen=True, eq=False)
class ScaledForms:
    """The quadratic forms `originals` (floats) in scaled coordinates: e = `W` x, and each multiplied input in units of
    `g` (k)."""

    originals: Sequence[Quadratic]
    W: Array
    g: Array

    @classmethod
    def paced(cls, forms: Sequence[Quadratic], W: Array) -> tuple["ScaledForms", float]:
        """Return the scaled forms in a unit of time in which x changes at a speed close to 1, with the units g of
        `balanced_units`; and this speed (1/time)."""
        speed = float(np.linalg.norm(np.linalg.inv(W) @ forms[0].pairs[0][1][:, : len(W)] @ W))
        fast = speed if 0 < speed < math.inf else 1.0
        slow = [form.over(fast) for form in forms]
        return cls(slow, W, balanced_units(slow[0], W)), fast

    @cached_property
    def forms(self) -> list[Quadratic]:
        """The quadratic forms in the scaled coordinates."""
        n, size = self.originals[0].pairs[0][0].shape
        whole, back, g, forms = np.eye(size), self._inverse, self.g[:, None], list[Quadratic]()
        whole[:n, :n] = self.W
        whole[range(n, size), range(n, size)] = self.g
        for one in self.originals:
            T = whole[: one.size, : one.size]
            pairs = tuple((back @ X @ T, back @ Y @ T) for X, Y in one.pairs)
            constant = None if one.constant is None else T.T @ one.constant @ T
            forms.append(Quadratic(pairs, one.Q @ T / g, one.Z @ T / g, constant))
        return forms

    @cached_property
    def _inverse(self) -> Array:
        return np.linalg.inv(self.W)

    def back(self, P: Array, S: Array) -> tuple[Array, Array]:
        """Return the weights P and S in the original coordinates e, from P and S in the scaled ones x, e = W x."""
        back = self._inverse.T @ P @ self._inverse
        return (back + back.T) / 2, S / self.g**2  # symmetric after rounding


def lyapunov(N: Array, W: Array | None = None) -> Array | None:
    """Return the solution P (n, n), in floats, of the Lyapunov equation N'P + P N = -W, W = I by default; None where
    the equation is singular."""
    n, one = len(N), np.eye(len(N))
    try:
        P = np.linalg.solve(np.kron(N.T, one) + np.kron(one, N.T), -(one if W is None else W).ravel()).reshape(n, n)
    except np.linalg.LinAlgError:
        return None
    return np.asarray((P + P.T) / 2) if np.isfinite(P).all() else None


def balance(N: Array) -> Array:
    """Return scales d (n) that balance a matrix: in diag(d)^-1 N diag(d) the off-diagonal entries of each row and of
    its column have equal sums of magnitudes (Osborne 1960)."""
    d = np.ones(len(N))
    for _ in range(_SWEEPS):
        for i in range(len(N)):
            size = abs(N * d / d[:, None])
            column, row = size[:, i].sum() - size[i, i], size[i].sum() - size[i, i]
            d[i] *= np.sqrt(row / column) if row and column else 1.0
    return d


def balanced_units(form: Quadratic, W: Array) -> Array:
    """Return units g (k) of the multiplied inputs that balance the form: each input then acts on x, e = `W` x, as
    strongly as x acts on this input through its row of Q. Rows of Q W below 1e-6 of the longest count as 1e-6, rows of
    rounding errors alone as a tenth."""
    n = len(W)
    columns = np.linalg.norm(np.linalg.inv(W) @ form.pairs[0][1][:, n:], axis=0)
    reads = np.linalg.norm(form.Q[:, :n] @ W, axis=1)
    reads = np.where(reads > _NIL * reads.max(initial=0), reads, _TENTH * reads.max(initial=0))
    columns, reads = (np.maximum(each, _SMALL * each.max(initial=0)) for each in (columns, reads))
    return np.asarray(np.sqrt(np.divide(reads, columns, out=np.ones_like(reads), where=(reads > 0) & (columns > 0))))


def negative(forms: Sequence[Quadratic], P: Array, S: Array, W: Array | None = None) -> bool:
    """Return whether P > 0 and all `forms` (floats) are negative at P and S, by a margin of 1e-8 for rounding. The
    margin is measured in coordinates x, e = `W` x, in which P is close to the unit matrix; with W = None in e."""
    values, P = _valued(forms, P, S, W)
    return bool(np.linalg.eigvalsh(values).max() < -_ROUNDING and np.linalg.eigvalsh(P).min() > 0)


def largest_blend(
    forms: Sequence[Quadratic], towards: Sequence[Quadratic], P: Array, S: Array, W: Array | None
) -> float:
    """Return the largest r such that (1 - r) F + r T is negative at P and S for each pair F of `forms` and T of
    `towards`, in coordinates e = `W` x; 0 where an F is not negative, inf where every r will do."""
    values, _ = _valued((*forms, *towards), P, S, W)
    first, last = np.split(values, 2)
    try:
        root = np.linalg.inv(np.linalg.cholesky(-first - _ROUNDING * np.eye(first.shape[-1])))
    except np.linalg.LinAlgError:
        return 0.0
    most = float(np.linalg.eigvalsh(root @ (last - first) @ root.swapaxes(1, 2)).max())
    return 1 / most if most > 0 else math.inf


def _valued(forms: Sequence[Quadratic], P: Array, S: Array, W: Array | None) -> tuple[Array, Array]:
    """Return the matrices (k, N, N) of `forms` (floats) at P and S, and P, in coordinates x with e = W x."""
    if W is not None:
        view, fast = ScaledForms.paced(forms, W)
        forms, P, S = view.forms, W.T @ P @ W, S * view.g**2 / fast
    return np.array([form.value(P, S) for form in forms]), P


def verified(forms: Sequence[Quadratic], P: Array, S: Array) -> bool:
    """Return whether P > 0, S >= 0 and all `forms` are negative at P and S, decided in exact arithmetic or Arb's balls;
    P and S are FLINT's rationals."""
    if any(value < 0 for value in S) or not positive(fmpq_mat(P.tolist())):
        return False
    with ctx.workprec(BALLS):
        return all(definite(-form.value(P, S)) for form in forms)


def extent(P: Array, c: Array) -> Fraction:
    """Return c P^-1 c', which is the largest |c e|^2 over the ellipsoid e'P e <= 1, for a row c (n), in FLINT's
    rationals."""
    row = fmpq_mat([c.tolist()])
    return fraction((row * fmpq_mat(P.tolist()).solve(row.transpose()))[0, 0])


def inverse_root(P: Array) -> Array:
    """Return P^(-1/2) (n, n), in floats, of a P > 0: in the coordinates x, e = P^(-1/2) x, e'P e is x'x."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors / np.sqrt(values) @ vectors.T)


def floats(M: Array) -> Array:
    """Return an array of rationals or balls as an array of floats."""
    if M.dtype == float:
        return M
    return np.array([float(arb(value)) if value else 0.0 for value in M.ravel().tolist()]).reshape(M.shape)


def on_grid(values: Array, bits: int) -> Array:
    """Return an array of floats rounded to `bits` bits after the binary point, as FLINT's rationals."""
    step = fmpq(1, 2**bits)
    rounded = np.array([round(value * 2**bits) * step for value in values.ravel().tolist()], dtype=object)
    return rounded.reshape(values.shape)


def rational(values: Any) -> Array:
    """Return an array of numbers (fractions, floats or integers) exactly, as FLINT's rationals."""
    array = np.array(values, dtype=object)
    exactly = [fmpq(*each.as_integer_ratio()) for each in array.ravel().tolist()]
    return np.array(exactly, dtype=object).reshape(array.shape)


def fractions(M: Array) -> Matrix:
    """Return a matrix of FLINT's rationals as tuples of `Fraction`."""
    return tuple(tuple(map(fraction, row)) for row in M)


def identity(n: int) -> Array:
    """Return the unit matrix (n, n), of FLINT's rationals."""
    one = np.full((n, n), fmpq(0))
    np.fill_diagonal(one, fmpq(1))
    return one


def times(A: Array, B: Array) -> Array:
    """Return the product A B of matrices of FLINT's rationals."""
    whole, below = _product(A, B)
    return _array(fmpq_mat(whole) / below)


def _array(M: Any) -> Array:
    return np.array(M.entries(), dtype=object).reshape(M.nrows(), M.ncols())


def _product(*factors: Array) -> tuple[Any, Any]:
    each = [fmpq_mat(*M.shape, M.ravel().tolist()).numer_denom() for M in factors]
    return reduce(mul, (whole for whole, _ in each)), reduce(mul, (below for _, below in each))


def stacked(rows: Sequence[Array], size: int) -> Array:
    """Return the matrix (k, size), in FLINT's rationals, whose rows are the k `rows`; (0, size) for none."""
    return np.array([list(row) for row in rows], dtype=object).reshape(len(rows), size)
