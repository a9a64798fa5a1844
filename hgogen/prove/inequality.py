"""The decrease of |e|_P^2 over one step of a method, or along the flow, as a quadratic inequality; contraction of
steps.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i
    X_2 = e + h (phi_1 (L e + r_1)),   r_i = (M - L) X_i + G p_i,   e+ = X_2 + h phi_2 (r_2 - r_1)

The first line is an explicit Runge-Kutta method. The second is a method that realises the linear core L of M, with a
scheme of order 2 for the remainder. Both are linear in v = (e, p_1, .., p_s): e+ = e + h D v, H X_i = Q_i v. An error
of the injection at a stage adds a column to D and Q (`Inputs`). The slopes |d_ij| <= 1 of different stages are
independent, so the result covers every course of the estimate. With P > 0 and S_i >= 0 diagonal,

    (|e+|_P^2 - |e|_P^2)/h + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0

proves |e+|_P^2 <= (1 - alpha h) |e|_P^2. The difference over h is 2 e'P D v + h |D v|_P^2: continuous time is Euler's
step of the length 0, V' <= -alpha V.

With X = h L, phi_1 - phi_2 and phi_2 weigh the injections at the two ends of a realised step, which so has a limit at h
= 0. The bilinear rule has phi_1 = (1 - X/2)^-1 and phi_2 = phi_1/2. The matrix exponential has phi_1 = 1 + X phi_2, and
so have the polynomials of a program (`discretisation.kernels`), as halving and doubling X keep this identity. There
phi_2 consists of balls that hold these polynomials.

A solver finds the weights, rationals prove them. Of a search over step lengths or thetas only the end is proved. A
proof is of one step length and one theta, or of every step length up to one with the same slopes: for fixed weights the
form of an explicit method is a polynomial in h, of degree d = 2 s - 1 for s stages. On a piece [a, b] it is a mean of
its d + 1 Bernstein coefficients, so that it is negative there where these are. They follow exactly from its values at d
+ 1 points (Farouki, "The Bernstein polynomial basis: a centennial retrospective", Computer Aided Geometric Design 29
(2012), 3.1). Pieces without weights are halved.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, lru_cache, reduce
from itertools import product
from math import comb
from typing import Any

import numpy as np
from flint import arb, arb_mat, ctx, fmpq_mat

from hgogen.discretisation.notation import DEGREE, HALVINGS
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.quadratic import (
    BALLS,
    Array,
    Quadratic,
    Weights,
    floats,
    identity,
    inverse_root,
    negative,
    on_grid,
    proved,
    rational,
    times,
)
from hgogen.prove.semidefinite import feasible_weights
from hgogen.rigor.definite import fraction, number, positive

_DENOMINATOR = 10_000  # the largest denominator of a tableau's coefficients
WORK = 2**13  # corners times fields^3, up to which corners are checked one by one
_ALL = 8  # the most slopes of which all corners are tried
Pairs = tuple[tuple[Array, Array], ...]
NOW = Fraction(0)  # the step length of continuous time
WITHIN = Fraction(1, 2**56)  # of an element of phi_2: what a program's may be beside it
_SURE = 0.9  # safety factor of a spectral radius in floats

Realisation = Callable[[Array, Fraction], tuple[Array, Array]]  # phi_1 and phi_2 of a core (N, N) at a length >= 0


@dataclass(frozen=True, eq=False)
class Inputs:
    """The linear effect of q inputs v on a step e+ = e + h D v: `D` (N, q), the effect on (e+ - e)/h; `Q` (s m, q), the
    effect on the arguments H X_i of the m uncertain slopes at each of s stages."""

    D: Array
    Q: Array

    def __mul__(self, size: Fraction) -> "Inputs":
        """Return both matrices times `size`: the terms of inputs that are measured in units of this size."""
        return Inputs(self.D * number(size), self.Q * number(size))

    def __add__(self, other: "Inputs") -> "Inputs":
        """Return the sums of both matrices: the terms of one input that acts in both places."""
        return Inputs(self.D + other.D, self.Q + other.Q)

    @classmethod
    def of(cls, each: Iterable["Inputs"]) -> "Inputs":
        """Return the terms of several groups of inputs as one group, their columns side by side."""
        each = tuple(each)
        return cls(np.hstack([one.D for one in each]), np.hstack([one.Q for one in each]))


@dataclass(frozen=True, eq=False)
class Inequality:
    """One step of an error, e+ = e + h D v, v = (e, p_1, .., p_s), whose uncertain slopes d_i at stage i add p_i =
    diag(d_i) Q_i v, |d_ij| <= 1.

    `h`: the length of the step, 0 for continuous time, e' = D v; `slopes`: the number m of uncertain slopes; `D` (N, N
    + s m); `Q` (s m, N + s m): all Q_i; `stages` (s, p): the effect of an error of each output's sample at each stage;
    `nodes` (s): the times of the stages over h; `degree`: the degree in h of the form that `falls` returns, 0 where it
    is no polynomial.
    """

    h: Fraction
    slopes: int
    D: Array
    Q: Array
    stages: tuple[tuple[Inputs, ...], ...]
    nodes: tuple[Fraction, ...]
    degree: int = 0

    @property
    def rows(self) -> int:
        """The number N + s m of rows of the quadratic form: the components of the error, and m slopes at each of s
        stages."""
        return int(self.D.shape[1])

    @property
    def arithmetic(self) -> str:
        """The name of the arithmetic in which forms are proved negative: "outward rounded" or "rational"."""
        return "outward rounded" if any(isinstance(value, arb) for value in self.D.flat) else "rational"

    def falls(self, alpha: Any) -> Quadratic:
        """Return the quadratic form 2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum_i (Q_i v)'S_i Q_i v - p_i'S_i p_i;
        where it is negative for a P > 0 and diagonal S_i >= 0, |e+|_P^2 <= (1 - alpha h) |e|_P^2. In the arithmetic of
        D."""
        size = self.rows
        n = size - len(self.Q)
        one, half = _one(self.D, size), (float if self.D.dtype == float else number)(alpha) / 2
        rates = self.D.copy()
        rates[:n] += one[:n] * half
        pairs: Pairs = ((one[:n], rates),)
        if self.h:
            pairs += ((self.D * (number(self.h) / 2), self.D),)
        return Quadratic(pairs, self.Q, one[n:])

    def driven(self, alpha: Any, inputs: Inputs) -> Quadratic:
        """Return the noise inequality: the form of `falls` with inputs w (q), less sum_k lambda_k w_k^2. Where it is
        negative, |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k w_k^2; for h = 0, V' <= -alpha V + sum_k lambda_k
        w_k^2. The lambda_k are the last q of its multipliers."""
        onto: Pairs = ((0 * inputs.D[: self.rows - len(self.Q)], inputs.D),)
        if self.h:
            onto += ((inputs.D * (number(self.h) / 2), inputs.D),)
        return self.falls(alpha).driven(onto, inputs.Q)

    def ends(self, output: int) -> tuple[Inputs, Inputs]:
        """Return the two `Inputs` of an error of the sample of `output` (index from 0) at the beginning of the step,
        and at its end. A stage at c h in between uses the linear interpolation of both samples, with the weights 1 - c
        and c."""
        parts = [(one[output] * (1 - c), one[output] * c) for one, c in zip(self.stages, self.nodes, strict=True)]
        first, last = zip(*parts, strict=True)
        return reduce(Inputs.__add__, first), reduce(Inputs.__add__, last)

    def additive_input(self, onto: Array) -> Inputs:
        """Return the `Inputs` of one input w that adds h w `onto` to e+, `onto` a column (N)."""
        return Inputs(onto[:, None], 0 * self.Q[:, :1])

    def frozen(self, d: np.ndarray) -> np.ndarray:
        """Return the matrices T (k, N, N) of e+ = T e, in floats, for k choices `d` (k, m) of constant slopes in [-1,
        1], equal at all stages."""
        n, size = self.D.shape
        v = np.zeros((len(d), size, n))
        v[:, :n] = np.eye(n)
        for i, row in enumerate(floats(self.Q)):  # a stage reads earlier ones only
            v[:, n + i] = d[:, i % self.slopes, None] * (row @ v)
        return np.asarray(np.eye(n) + float(self.h) * (floats(self.D) @ v))


ErrorStep = Callable[[Fraction, Uncertain], Inequality]  # a method's step of that length on an uncertain system


def corners(m: int) -> np.ndarray:
    """Return the corners (k, m) of the cube [-1, 1]^m: all 2^m for m <= 8, else a fixed random sample of 2^8."""
    if m <= _ALL:
        return np.array(list(product((-1.0, 1.0), repeat=m))).reshape(2**m, m)
    return np.random.default_rng(0).choice((-1.0, 1.0), size=(2**_ALL, m))


def flow(e: Uncertain) -> Inequality:
    """Return the `Inequality` of continuous time, h = 0, for the error system e' = M e + G p, p = diag(d) H e. Its
    quadratic form is [M'P + P M + alpha P + H'S H, P G; G'P, -S] < 0."""
    m = len(e.H)
    return Inequality(NOW, m, np.hstack([e.M, e.G]), np.hstack([e.H, 0 * _one(e.H, m)]), (), (NOW,), 1)


def _one(like: Array, size: int) -> Array:
    return np.eye(size) if like.dtype == float else identity(size)


def few_corners(n: int, m: int) -> bool:
    """Return whether the corners of [-1, 1]^m, for m uncertain slopes, are few enough to be checked one by one: 2^m n^3
    <= 2^13 for an error of n components."""
    return bool(2**m * n**3 <= WORK)


def vertex_systems(e: Uncertain, hull: Sequence[Sequence[Fraction]] = ()) -> tuple[Uncertain, ...]:
    """Return error systems without uncertain slopes whose convex hull contains e: one for each corner of [-1, 1]^m, or
    for each point of a `hull` (k, m) that contains the slopes. Where there are too many corners (`few_corners`) only e
    itself, with its uncertain slopes."""
    m, n = e.H.shape
    if not (hull or few_corners(n, m)):
        return (e,)
    places: Sequence[Sequence[Any]] = hull or tuple(product((-1, 1), repeat=m))
    return tuple(map(e.with_constant_slopes, np.array(places, dtype=float) if e.G.dtype == float else rational(places)))


def decrease_forms(e: Uncertain, alpha: Any, hull: Sequence[Sequence[Fraction]] = ()) -> tuple[Quadratic, ...]:
    """Return the quadratic forms, one for each of the `vertex_systems`, that prove V' <= -alpha V, V = e'P e, for all
    slopes if one P > 0 makes all of them negative. `hull` (k, m): points whose convex hull contains the slopes, () for
    all of [-1, 1]^m."""
    return tuple(flow(each).falls(alpha) for each in vertex_systems(e, hull))


def noise_forms(e: Uncertain, alpha: Any, hull: Sequence[Sequence[Fraction]] = ()) -> tuple[Quadratic, ...]:
    """Return the noise inequality in continuous time: the quadratic forms, one for each of the `vertex_systems`, that
    prove V' <= -alpha V + sum_k lambda_k v_k^2, V = e'P e, v the inputs (q) of e, if one P > 0 makes all of them
    negative. The lambda_k are the last q of their multipliers. `hull` as in `decrease_forms`."""
    return tuple(driven_by_multipliers(each, alpha) for each in vertex_systems(e, hull))


def driven_by_multipliers(e: Uncertain, alpha: Any) -> Quadratic:
    """Return the noise inequality in continuous time for the error system e as a single quadratic form for all
    uncertain slopes, with one multiplier S_jj >= 0 for each slope instead of the corners of `noise_forms`. It proves V'
    <= -alpha V + sum_k lambda_k v_k^2, V = e'P e, v the inputs."""
    return flow(e).driven(alpha, Inputs(e.B, e.E))


def runge_kutta_step(tableau: Tableau, h: Fraction, e: Uncertain) -> Inequality:
    """Return one step, of length h >= 0, of an explicit Runge-Kutta method (`tableau` a, b, c) on the error system e,
    where the output error is evaluated anew at each stage: X_i = e + h sum_j a_ij w_j, e+ = e + h sum_i b_i w_i."""
    (n, m), s, p, length = e.G.shape, len(tableau.b), e.B.shape[1], number(h)
    size = n + s * m
    unit = identity(size + s * p)[:n]
    nothing, rates, reads = 0 * unit, list[Array](), list[Array]()
    for i, row in enumerate(tableau.a):
        X = unit + length * sum((_exactly(a) * w for a, w in zip(row, rates, strict=True) if a), nothing)
        slopes, samples = slice(n + i * m, n + (i + 1) * m), slice(size + i * p, size + (i + 1) * p)
        read, rate = times(e.H, X), times(e.M, X)
        read[:, samples], rate[:, slopes], rate[:, samples] = e.E, e.G, e.B  # earlier stages have zeros there
        reads.append(read)
        rates.append(rate)
    D = sum((_exactly(b) * w for b, w in zip(tableau.b, rates, strict=True)), nothing)
    nodes = tuple(fraction(_exactly(c)) for c in tableau.c)
    return _with_samples(h, e, D, np.concatenate(reads), nodes, 2 * s - 1)


def _with_samples(
    h: Fraction, e: Uncertain, D: Array, Q: Array, nodes: tuple[Fraction, ...], degree: int = 0
) -> Inequality:
    """Return the step of D (N, ..) and Q (s m, ..) with N + s m + s p columns:
    the last s p belong to the errors of p samples at each of s stages.
    `nodes` (s): times of the stages; `degree` of the quadratic form in h."""
    (n, m), p = e.G.shape, e.B.shape[1]
    size = n + len(nodes) * m
    each = [Inputs(D[:, [k]], Q[:, [k]]) for k in range(size, size + len(nodes) * p)]
    stages = tuple(tuple(each[i * p : (i + 1) * p]) for i in range(len(nodes)))
    return Inequality(h, m, D[:, :size], Q[:, :size], stages, nodes, degree)


@cache
def _exactly(coefficient: float) -> Any:
    """Return a tableau's coefficient as the exact quotient that its float rounds, such as 1/6."""
    return number(Fraction(coefficient).limit_denominator(_DENOMINATOR))


def by_bilinear_rule(L: Array, h: Fraction) -> tuple[Array, Array]:
    """Return the matrices phi_1 = (1 - h L/2)^-1 and phi_2 = phi_1/2 (N, N) of the bilinear rule, in FLINT's rationals,
    for the linear core L (N, N) and step length h."""
    resolvent = fmpq_mat((identity(len(L)) - L * (number(h) / 2)).tolist()).inv()
    phi_1 = np.array([[resolvent[i, j] for j in range(len(L))] for i in range(len(L))], dtype=object)
    return phi_1, phi_1 / 2


def by_matrix_exponential(L: Array, h: Fraction) -> tuple[Array, Array]:
    """Return phi_1 = 1 + h L phi_2 and phi_2 (N, N) of exp(h L), for the linear core L and step length h, as Arb's
    balls that enclose the polynomials of the program; infinite balls where these may differ from the exponential's by
    more than 2^-56."""
    X, known = L * number(h), number(WITHIN)
    halvings = _halvings(X)
    with ctx.workprec(BALLS):
        exactly = _phi_2(X)
        away = max(each.abs_upper() for each in (exactly - _program_phi_2(X, halvings)).ravel())
        phi_2 = exactly + (arb(0, known) if away < known and halvings <= HALVINGS else arb(0, "inf"))
        return identity(len(X)) + X @ phi_2, phi_2


def _phi_2(X: Array) -> Array:
    """Return phi_2(X) = sum_k X^k/(k + 2)! with error balls: the
    upper right block of exp [X, 1, 0; 0, 0, 1; 0, 0, 0]."""
    n = len(X)
    wide = 0 * identity(3 * n)
    wide[:n, :n], wide[:n, n : 2 * n], wide[n : 2 * n, 2 * n :] = X, identity(n), identity(n)
    whole = arb_mat([[arb(value) for value in row] for row in wide]).exp()
    return np.array([[whole[i, 2 * n + j] for j in range(n)] for i in range(n)], dtype=object)


def _halvings(X: Array) -> int:
    """Return k such that the row sums of |X|/2^k are at most 1/2 in the best diagonally
    scaled coordinates: there the largest row sum is the spectral radius of |X|."""
    radius = float(np.abs(np.linalg.eigvals(np.abs(floats(X)))).max(initial=0)) * _SURE
    return max(0, int(np.ceil(np.log2(2 * radius)))) if radius else 0


def _program_phi_2(X: Array, halvings: int) -> Array:
    """Return the emitted program's phi_2(X) with error balls: a Taylor polynomial of X/2^halvings,
    doubled `halvings` times. Each further halving multiplies the truncation error by 2^-14."""
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


def realised_step(realisation: Realisation, h: Fraction, e: Uncertain) -> Inequality:
    """Return one step, of length h >= 0, on the error system e of a method that integrates its linear core L exactly or
    nearly, and uses samples at both ends: X_2 = e + h phi_1 (L e + r_1), e+ = X_2 + h phi_2 (r_2 - r_1), r the
    remainder. `realisation`: the function from (L, h) to phi_1 and phi_2."""
    (n, m), p, (phi_1, phi_2) = e.G.shape, e.B.shape[1], realisation(e.core, h)
    size = n + 2 * m
    unit, remainder, direct = identity(size + 2 * p), e.M - e.core, e.B - e.injected
    X, v_0, v_1 = unit[:n], unit[size : size + p], unit[size + p :]
    first = remainder @ X + direct @ v_0 + e.G @ unit[n : n + m]
    with ctx.workprec(BALLS):
        ahead = phi_1 @ (e.core @ X + first + e.injected @ v_0) + phi_2 @ e.injected @ (v_1 - v_0)  # (a - e)/h
        after = X + ahead * number(h)
        D = ahead + phi_2 @ (remainder @ after + direct @ v_1 + e.G @ unit[n + m : size] - first)
        Q = np.concatenate([e.H @ X + e.E @ v_0, e.H @ after + e.E @ v_1])
    return _with_samples(h, e, D, Q, (NOW, Fraction(1)))


ROWS = 48  # fields and slopes of all stages: above, a solver is too slow for a check
CLOSE = 1.02  # ratio of the ends at which a search stops
_HALVINGS = 6  # bisections of the rate
_FIRST = Fraction(3, 4)  # first rate of a search, over that at constant slopes, an upper bound
_LATER = Fraction(1, 3)  # next rate, over the last one
_PASSES = 2
_SHARES = (Fraction(1), Fraction(199, 200), Fraction(19, 20), Fraction(0))  # of a rate found in floats, for proofs
_WHAT = "a proof of the step"
_NOTHING = Fraction(0)
_LENGTHS = 16  # number of cached steps
_PIECES = 12  # the most pieces that are tried
_GRID = 60  # bits after the point of the weights


@dataclass(frozen=True)
class Steps:
    """The steps of a method on an observer's `error` at one `theta` and any length h, and the search for proofs that
    they contract. `way`: the function from h and the error system at theta to the `Inequality` of the step."""

    error: Inclusion
    way: ErrorStep
    theta: Fraction

    @cached_property
    def at(self) -> Callable[[Fraction], Inequality]:
        """The function from a step length h to its `Inequality`; the last 16 results are cached."""
        return lru_cache(maxsize=_LENGTHS)(lambda h: self.way(h, self._uncertain))

    @cached_property
    def _uncertain(self) -> Uncertain:
        return self.error.at(self.theta)

    def may_contract(self, h: Fraction) -> bool:
        """Return whether a solver finds weights P and S in floats with which the step of length h contracts. This is
        faster than a proof. Raises: `NoSolver`."""
        step = self.at(h)
        return step.rows <= ROWS and unstable(step) is None and self.weights(h, Fraction(0)) is not None

    def weights(self, h: Fraction, alpha: Fraction) -> tuple[Array, Array] | None:
        """Return P (N, N) and the multipliers S, in floats, for |e+|_P^2 <= (1 - alpha h) |e|_P^2; None where a solver
        finds none. Raises: `NoSolver`."""
        if self.coordinates is None:
            return None
        form = self.at(h).falls(alpha)
        weights = feasible_weights((form,), _WHAT, self.coordinates)
        return weights if weights is not None and negative((form.floats,), *weights, self.coordinates) else None

    @cached_property
    def coordinates(self) -> Array | None:
        """The matrix W = P^(-1/2) (N, N) of a Lyapunov function V = e'P e in continuous time; None where there is none.
        In the coordinates W^-1 e the P of a step is expected close to the unit matrix. The first search starts from the
        P of the linear part, the second from the result of the first."""
        W = self.error.coordinates
        for _ in range(_PASSES):
            weights = feasible_weights((flow(self._uncertain).falls(NOW),), _WHAT, W)
            if weights is None:
                return None
            W = inverse_root(weights[0])
        return W

    def proved(self, h: Fraction) -> "Contracts | None":
        """Return a proof that the step of length h contracts, with an alpha close to the largest for which a solver
        finds weights; None where there is none. Raises: `NoSolver`."""
        if not self.may_contract(h):
            return None
        slow, fast = Fraction(0), Fraction((1 - _frozen(self.at(h))[0] ** 2) / float(h))
        for k in range(_HALVINGS):
            middle = Fraction(math.sqrt(slow * fast)) if slow else fast * (_LATER if k else _FIRST)
            slow, fast = (middle, fast) if self.weights(h, middle) else (slow, middle)
        for alpha in (slow * share for share in _SHARES):
            weights = self.certain(h, alpha)
            if weights:
                return Contracts(self, h, alpha, weights)
        return None

    def certain(self, h: Fraction, alpha: Fraction = _NOTHING) -> Weights | None:
        """Return weights P and S in rationals that prove |e+|_P^2 <= (1 - alpha h) |e|_P^2 for the step of length h;
        None where none are found. Raises: `NoSolver`."""
        weights = self.weights(h, alpha)
        return weights and proved((self.at(h).falls(alpha),), *weights)


@dataclass(frozen=True)
class Contracts:
    """A proof, by rational `weights` P and S, that a step of length `h` contracts: |e+|_P^2 <= (1 - alpha h) |e|_P^2.
    `steps`: the method's steps of any length, of which it is one."""

    steps: Steps
    h: Fraction
    alpha: Fraction
    weights: Weights

    @property
    def step(self) -> Inequality:
        """The `Inequality` of the step of length h."""
        return self.steps.at(self.h)

    @property
    def rate(self) -> float:
        """The rate r (1/time) with |e|_P <= exp(-r t) |e(0)|_P at the samples: -log(1 - alpha h)/(2 h)."""
        lost = self.alpha * self.h  # log1p keeps the digits of a short step
        return -math.log1p(-float(lost)) / 2 / float(self.h) * (1 - 1e-9) if lost < 1 else math.inf


def bisect_towards(holds: Callable[[Fraction], bool], start: Fraction, end: Fraction, close: float = CLOSE) -> Fraction:
    """Return, by bisection on a logarithmic scale, the value farthest from `start` and toward `end` at which the
    predicate `holds` is true, up to a factor of `close`. It must be true at `start`; the result is `end` if it is true
    there."""
    if holds(end):
        return end
    while not 1 / close < start / end < close:
        middle = Fraction(math.sqrt(start) * math.sqrt(end))
        start, end = (middle, end) if holds(middle) else (start, middle)
    return start


def unstable(step: Inequality) -> Array | None:
    """Return constant slopes d (m) in [-1, 1] with which errors do not decay: e+ = T e with a spectral radius >= 1;
    None where no tried corner of [-1, 1]^m has this property."""
    radius, d = _frozen(step)
    return d if radius >= 1 else None


def _frozen(step: Inequality) -> tuple[float, Array]:
    """Return the largest spectral radius of T in e+ = T e over the tried
    corners d (m) of constant partial derivatives, and this corner."""
    d = corners(step.slopes)
    radius = np.abs(np.linalg.eigvals(step.frozen(d))).max(axis=1)
    worst = int(radius.argmax())
    return float(radius[worst]), d[worst]


@dataclass(frozen=True)
class Piece:
    """A proof, by one pair of `weights` P and S, that the steps of all lengths from `low` to `high` contract."""

    low: Fraction
    high: Fraction
    weights: Weights


def all_shorter(steps: Steps, longest: Fraction) -> tuple[Piece, ...]:
    """Return pieces, in ascending order, that together prove contraction at every step length in (0, `longest`]; ()
    where a part is not proved, or where the quadratic form is no polynomial in h. Raises: `NoSolver`."""
    if not steps.at(longest).degree:
        return ()
    pending, pieces, tried = [(Fraction(0), longest)], [], 0
    while pending:
        low, high = pending.pop()
        tried += 1
        piece = _piece(steps, low, high)
        if piece is not None:
            pieces.append(piece)
        elif tried >= _PIECES:
            return ()
        else:
            pending += [(low, (low + high) / 2), ((low + high) / 2, high)]
    return tuple(sorted(pieces, key=lambda piece: piece.low))


def _piece(steps: Steps, low: Fraction, high: Fraction) -> Piece | None:
    weights = steps.weights(high, _NOTHING)  # the longest step is the hardest
    if weights is None:
        return None
    P, S = (on_grid(value, _GRID) for value in weights)
    degree = steps.at(high).degree
    values = [steps.at(low + (high - low) * k / degree).falls(_NOTHING).value(P, S) for k in range(degree + 1)]
    parts = times(_bernstein(degree), np.array([value.ravel() for value in values])).reshape(-1, *values[0].shape)
    if any(np.linalg.eigvalsh(floats(part)).max() >= 0 for part in parts):
        return None
    negative_definite = all(positive(fmpq_mat((-part).tolist())) for part in parts) and positive(fmpq_mat(P.tolist()))
    return Piece(low, high, Weights.of(P, S)) if negative_definite else None


@lru_cache(maxsize=8)
def _bernstein(degree: int) -> Array:
    """Return the matrix (d + 1, d + 1) from the values of a polynomial of degree
    d at k/d, k = 0, .., d, to its Bernstein coefficients on [0, 1]."""
    at = [Fraction(k, degree) for k in range(degree + 1)]
    basis = rational([[comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(degree + 1)] for t in at])
    return np.array(fmpq_mat(basis.tolist()).inv().tolist(), dtype=object)
