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
    """The form: `pairs` of (X, Y) (n, N), `Q` and `Z` (k, N), and a `constant` term (N, N), None for zero."""

    pairs: tuple[tuple[Array, Array], ...]
    Q: Array
    Z: Array
    constant: Array | None = None

    def value(self, P: Array, S: Array) -> Array:
        """Return the matrix (N, N) of the form at P (n, n) and S (k)."""
        if P.dtype == object and not any(isinstance(value, arb) for value in self.pairs[0][1].flat):
            value = self._of_rationals(P, S)
        else:
            halves = [X.T @ P @ Y for X, Y in self.pairs]
            squares = self.Q.T @ (S[:, None] * self.Q) - self.Z.T @ (S[:, None] * self.Z)
            value = np.asarray(sum((half + half.T for half in halves), squares))
        return value if self.constant is None else value + self.constant

    def _of_rationals(self, P: Array, S: Array) -> Array:
        """Return the value in integers over common denominators, which takes a tenth of the time."""
        parts = []
        for X, Y in self.pairs:
            half, below = _product(X.T, P, Y)
            parts.append((half + half.transpose(), below))
        parts += [_product(rows.T, np.diag(by), rows) for rows, by in ((self.Q, S), (self.Z, -S))]
        common = reduce(lcm, (int(below) for _, below in parts))
        return _array(fmpq_mat(reduce(add, (part * (common // int(below)) for part, below in parts))) / common)

    def driven(self, onto: Sequence[tuple[Array, Array]], reads: Array) -> "Quadratic":
        """Return the form of v and of inputs (q). The inputs add `onto` to the X v and Y v of each pair, and `reads`
        (k, q) to Q v; the last q multipliers belong to the inputs themselves."""
        q, size = reads.shape[1], self.size
        one = np.eye(size + q, dtype=int) + 0 * self.pairs[0][0][0, 0]
        pairs = tuple((np.hstack([X, x]), np.hstack([Y, y])) for (X, Y), (x, y) in zip(self.pairs, onto, strict=True))
        Q = np.vstack([np.hstack([self.Q, reads]), 0 * one[:q]])
        constant = None if self.constant is None else np.pad(self.constant, (0, q))
        return Quadratic(pairs, Q, np.vstack([np.hstack([self.Z, 0 * reads]), one[size:]]), constant)

    def over(self, pace: Any) -> "Quadratic":
        """Return the form divided by `pace` > 0, with its multipliers: it is negative where the original is."""
        constant = None if self.constant is None else self.constant / pace
        return Quadratic(tuple((X, Y / pace) for X, Y in self.pairs), self.Q, self.Z, constant)

    @property
    def size(self) -> int:
        """The number N of columns."""
        return int(self.pairs[0][0].shape[1])

    @property
    def floats(self) -> "Quadratic":
        """The form in floats."""
        pairs = tuple((floats(X), floats(Y)) for X, Y in self.pairs)
        return Quadratic(
            pairs, floats(self.Q), floats(self.Z), None if self.constant is None else floats(self.constant)
        )


@dataclass(frozen=True)
class Weights:
    """Weights of a proof: `P` (n, n) symmetric and `S` (k), rational, with which a form is negative."""

    P: Matrix
    S: tuple[Fraction, ...]

    @classmethod
    def of(cls, P: Array, S: Array) -> "Weights":
        """Return the weights from FLINT's rationals."""
        return cls(fractions(P), tuple(map(fraction, S)))

    @property
    def written(self) -> dict[str, Any]:
        """The weights as a certificate has them."""
        return {"P": self.P, "S": self.S}


def proved(forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
    """Return rational weights near those in floats that are proved to make exact forms negative, if any."""
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
    """Return weights of FLINT's rationals that make exact forms negative; None where none are confirmed.

    `by_margin` searches weights in floats with each of the `margins`: a smaller one helps if the forms have no room for
    it, a larger one if the solver uses all of it. The last q of S sum up to at most `most`, if that is given.
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
class View:
    """The forms of floats `originals` in coordinates x of e = `W` x, each multiplied relation in units of `g` (k)."""

    originals: Sequence[Quadratic]
    W: Array
    g: Array

    @classmethod
    def paced(cls, forms: Sequence[Quadratic], W: Array) -> tuple["View", float]:
        """Return the view of forms in their own unit of time, with each relation balanced between input and reading,
        and the number of these units in one unit of time."""
        fast = pace(forms[0], W)
        slow = [form.over(fast) for form in forms]
        return cls(slow, W, even(slow[0], W)), fast

    @cached_property
    def forms(self) -> list[Quadratic]:
        """The forms in the coordinates x."""
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
        """Return the weights for e from those for x."""
        back = self._inverse.T @ P @ self._inverse
        return (back + back.T) / 2, S / self.g**2  # symmetric after rounding


def lyapunov(N: Array, W: Array | None = None) -> Array | None:
    """Return P (n, n) with N'P + P N = -W, by default -I, in floats; None where there is none."""
    n, one = len(N), np.eye(len(N))
    try:
        P = np.linalg.solve(np.kron(N.T, one) + np.kron(one, N.T), -(one if W is None else W).ravel()).reshape(n, n)
    except np.linalg.LinAlgError:
        return None
    return np.asarray((P + P.T) / 2) if np.isfinite(P).all() else None


def balance(N: Array) -> Array:
    """Return units d (n) that make the rows and columns of N, in e over d, equally long (Osborne 1960)."""
    d = np.ones(len(N))
    for _ in range(_SWEEPS):
        for i in range(len(N)):
            size = abs(N * d / d[:, None])
            column, row = size[:, i].sum() - size[i, i], size[i].sum() - size[i, i]
            d[i] *= np.sqrt(row / column) if row and column else 1.0
    return d


def pace(form: Quadratic, W: Array) -> float:
    """Return the speed of x, e = W x, in a form of floats: the factor to its own unit of time."""
    n = len(W)
    fast = float(np.linalg.norm(np.linalg.inv(W) @ form.pairs[0][1][:, :n] @ W))
    return fast if 0 < fast < math.inf else 1.0


def even(form: Quadratic, W: Array) -> Array:
    """Return the g (k) that make each relation's input to x as large as its reading of x. Readings below a small share
    of the largest are raised to it. A reading of rounding errors alone counts as a tenth of the largest."""
    n = len(W)
    columns = np.linalg.norm(np.linalg.inv(W) @ form.pairs[0][1][:, n:], axis=0)
    reads = np.linalg.norm(form.Q[:, :n] @ W, axis=1)
    reads = np.where(reads > _NIL * reads.max(initial=0), reads, _TENTH * reads.max(initial=0))
    columns, reads = (np.maximum(each, _SMALL * each.max(initial=0)) for each in (columns, reads))
    return np.asarray(np.sqrt(np.divide(reads, columns, out=np.ones_like(reads), where=(reads > 0) & (columns > 0))))


def negative(forms: Sequence[Quadratic], P: Array, S: Array, W: Array | None = None) -> bool:
    """Return whether all forms of floats are negative, with a margin for rounding to a grid, in coordinates x of e =
    `W` x, in which P is near the unit matrix."""
    values, P = _valued(forms, P, S, W)
    return bool(np.linalg.eigvalsh(values).max() < -_ROUNDING and np.linalg.eigvalsh(P).min() > 0)


def reach(forms: Sequence[Quadratic], towards: Sequence[Quadratic], P: Array, S: Array, W: Array | None) -> float:
    """Return the largest share of the way from `forms` `towards` others at which the forms are `negative`, 0 where they
    are not at the start. Their values are affine in it."""
    values, _ = _valued((*forms, *towards), P, S, W)
    first, last = np.split(values, 2)
    try:
        root = np.linalg.inv(np.linalg.cholesky(-first - _ROUNDING * np.eye(first.shape[-1])))
    except np.linalg.LinAlgError:
        return 0.0
    most = float(np.linalg.eigvalsh(root @ (last - first) @ root.swapaxes(1, 2)).max())
    return 1 / most if most > 0 else math.inf


def _valued(forms: Sequence[Quadratic], P: Array, S: Array, W: Array | None) -> tuple[Array, Array]:
    """Return the values (k, N, N) of forms of floats, and P, in coordinates x of e = W x."""
    if W is not None:
        view, fast = View.paced(forms, W)
        forms, P, S = view.forms, W.T @ P @ W, S * view.g**2 / fast
    return np.array([form.value(P, S) for form in forms]), P


def verified(forms: Sequence[Quadratic], P: Array, S: Array) -> bool:
    """Return whether P > 0, S >= 0 and all forms are negative, in exact arithmetic or their balls; P, S of FLINT's
    rationals."""
    if any(value < 0 for value in S) or not positive(fmpq_mat(P.tolist())):
        return False
    with ctx.workprec(BALLS):
        return all(definite(-form.value(P, S)) for form in forms)


def extent(P: Array, c: Array) -> Fraction:
    """Return c P^-1 c', the largest |c e|^2 where |e|_P <= 1; of FLINT's rationals."""
    row = fmpq_mat([c.tolist()])
    return fraction((row * fmpq_mat(P.tolist()).solve(row.transpose()))[0, 0])


def inverse_root(P: Array) -> Array:
    """Return P^(-1/2) of a P > 0 in floats: in coordinates x of e = P^(-1/2) x, P is the unit matrix."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors / np.sqrt(values) @ vectors.T)


def floats(M: Array) -> Array:
    """Return an array of rationals, balls or floats as floats."""
    if M.dtype == float:
        return M
    return np.array([float(arb(value)) if value else 0.0 for value in M.ravel().tolist()]).reshape(M.shape)


def on_grid(values: Array, bits: int) -> Array:
    """Return floats rounded to so many bits after the point, as FLINT's rationals."""
    step = fmpq(1, 2**bits)
    rounded = np.array([round(value * 2**bits) * step for value in values.ravel().tolist()], dtype=object)
    return rounded.reshape(values.shape)


def rational(values: Any) -> Array:
    """Return fractions, floats without rounding, or integers as an array of FLINT's rationals."""
    array = np.array(values, dtype=object)
    exactly = [fmpq(*each.as_integer_ratio()) for each in array.ravel().tolist()]
    return np.array(exactly, dtype=object).reshape(array.shape)


def fractions(M: Array) -> Matrix:
    """Return a matrix of FLINT's rationals as fractions."""
    return tuple(tuple(map(fraction, row)) for row in M)


def identity(n: int) -> Array:
    """Return the unit matrix (n, n), of FLINT's rationals."""
    one = np.full((n, n), fmpq(0))
    np.fill_diagonal(one, fmpq(1))
    return one


def times(A: Array, B: Array) -> Array:
    """Return A B, of FLINT's rationals."""
    whole, below = _product(A, B)
    return _array(fmpq_mat(whole) / below)


def _array(M: Any) -> Array:
    return np.array(M.entries(), dtype=object).reshape(M.nrows(), M.ncols())


def _product(*factors: Array) -> tuple[Any, Any]:
    """Return the product of rational matrices as FLINT's integer matrix and its denominator."""
    each = [fmpq_mat(*M.shape, M.ravel().tolist()).numer_denom() for M in factors]
    return reduce(mul, (whole for whole, _ in each)), reduce(mul, (below for _, below in each))


def stacked(rows: Sequence[Array], size: int) -> Array:
    """Return rows (size) of FLINT's rationals as a matrix, (0, size) for no rows."""
    return np.array([list(row) for row in rows], dtype=object).reshape(len(rows), size)
