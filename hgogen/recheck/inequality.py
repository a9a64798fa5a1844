"""The matrix inequality for the decay of a quadratic form of the error, in a step of a method or in continuous time.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i
    X_2 = e + h phi_1 (L e + r_1),   r_i = (M - L) X_i + G p_i,   e+ = X_2 + h phi_2 (r_2 - r_1)

e is the difference of two estimates from the same samples (`inclusion`); M has the slopes at their middles, G and H
their deviations, |d_ij| <= 1 independently at each stage. With v = (e, p_1, .., p_s), e+ = e + h D v, H X_i = Q_i v, P
> 0 and S >= 0 diagonal

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0   for all v

proves |e+|_P^2 <= (1 - alpha h) |e|_P^2. With inputs u appended to v, and sum_k lambda_k u_k^2 subtracted, sum_k
lambda_k <= alpha, it proves that |e|_P <= 1 is invariant while each |u_k| <= 1. Continuous time is Euler's step of the
length 0: V' <= -alpha V. For given P and S it is a polynomial in h of degree 2 s - 1 by a method of the first line:
Euler's, Heun's and the classical one of Runge and Kutta. The second realises the core L of M, X = h L: by the bilinear
rule phi_1 = (1 - X/2)^-1 = 2 phi_2, by the matrix exponential phi_1 = 1 + X phi_2, phi_2 = (exp X - 1 - X)/X^2 up to
the error of a program's polynomial. The effect of that error on the form is bounded entry by entry, in absolute values,
and |d| 2 |v_i v_j| <= |d| (v_i^2 s_j/s_i + v_j^2 s_i/s_j) moves it to the diagonal, for any s > 0.

A quadratic form decays for all slopes of an inclusion: V = e'P e, V' <= -alpha V for e' = (M + G diag(d) H) e.

M is affine in each |d_j| <= 1, so without multipliers the corners suffice. A slope that is unbounded on one side enters
M by its finite end; the excess, -a d r'e, d >= 0, decreases V' if P a = lambda r, lambda >= 0.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from itertools import product
from operator import mul
from typing import Any

from .arithmetic import Unproved
from .box import definite
from .context import (
    CARRIED,
    STEEP,
    STRUCTURE,
    Context,
    Finding,
    Keys,
    Rule,
    chains_rule,
    is_above,
    jacobian_bound,
    observer_of,
    observer_rule,
    on_ranges,
    printed,
)
from .file import Claim, Observer, above_zero, column, matrix, part, scalar, signless, whole
from .interval import point
from .matrix import (
    Matrix,
    demand_nonnegative,
    demand_positive,
    dot,
    inverse,
    lyapunov,
    outer,
    unit,
    unit_row,
    weight,
    zeros,
)
from .text import number

_ROWS, _WHOLE = 60, 100  # most rows: in a step without its inputs, in continuous time with them
NORM = ("P", "S")  # keys of the evidence of a V = e'P e, with its multipliers
BOUND = ("alpha", *NORM, "bound")  # of the response to inputs, by one
ONE = Fraction(1)
_METHODS: Mapping[str, tuple[tuple[tuple[str, ...], ...], tuple[str, ...], int]] = {
    "Euler": (((),), ("1",), 1),
    "Heun": (((), ("1",)), ("1/2", "1/2"), 2),
    "classical Runge-Kutta": (((), ("1/2",), ("0", "1/2"), ("0", "0", "1")), ("1/6", "1/3", "1/3", "1/6"), 4),
}
POLYNOMIAL_ERROR = Fraction(1, 2**56)  # of an element of phi_2 by a program's polynomial
Weights = tuple[Matrix, Matrix, Fraction]  # phi_1, phi_2, and a bound of the errors of phi_2's elements


@dataclass(frozen=True)
class StepMaps:
    """A step of length h of the error dynamics as linear maps of v = (e, p_1, .., p_s, inputs): e+ = e + h `D` v, and
    X_i = `stages`[i] v at stage i. `off`: entrywise bounds of the errors of D and of the last stage, empty if they are
    exact."""

    D: Matrix
    stages: list[Matrix]
    off: tuple[Matrix, ...] = ()


@dataclass(frozen=True)
class ErrorMatrices:
    """The matrices of the error dynamics e' = M e + G p + (B + R) v, p = diag(d) (H e + E v), for all |d_j| <= 1: M (N,
    N), G (N, m), H (m, N); B, R (N, p) and E (m, p) multiply the errors v of the samples. L (N, N) is the part of M
    without b, B belongs to L and R to b; `moving`: whether L varies.

    `one_sided`: for each slope that is unbounded on one side the pair (a, r) of a term -t a r'e with any t >= 0, a and
    r (N).
    """

    M: Matrix
    G: Matrix
    H: Matrix
    L: Matrix
    moving: bool
    B: Matrix
    R: Matrix
    E: Matrix
    one_sided: list[tuple[list[Fraction], list[Fraction]]] = field(default_factory=list)


@dataclass(frozen=True)
class Method:
    """A discretisation of the error dynamics. `nodes` (s): the times of its stages, from 0 to 1 in a step; `degree`:
    the degree in h of the quadratic form of a step, 0 if it is no polynomial.

    `changes`(parts, h, e, p, v): the step as `StepMaps`, from the matrices that express e (N, size), p_i (m, size) and
    the errors v_i (p, size) of the samples at each stage.
    """

    nodes: list[Fraction]
    degree: int
    changes: Callable[[ErrorMatrices, Fraction, Matrix, list[Matrix], list[Matrix]], StepMaps]


@dataclass(frozen=True)
class Tableau:
    """A Runge-Kutta method k_i = F(x + h sum_j a_ij k_j, c_i), x+ = x + h sum_i b_i k_i: the `rows` of a below its
    diagonal, the `weights` b, and its order."""

    rows: list[list[Fraction]]
    weights: list[Fraction]
    order: int

    @property
    def nodes(self) -> list[Fraction]:
        """The nodes c_i (s), the sums of the rows of a."""
        return [sum(row, Fraction(0)) for row in self.rows]

    @property
    def deviations(self) -> Matrix:
        """The coefficients c_i b_j - a_ij (s, s) of h k_j in c_i (x+ - x) - (X_i - x), the distance of stage X_i from
        the line from x to x+."""
        s = len(self.weights)
        wide = Matrix([[*row, *[Fraction(0)] * (s - len(row))] for row in self.rows])
        return outer(self.nodes, self.weights) - wide

    @property
    def cubic(self) -> list[int]:
        """The indices of the stages whose distance from the line from x to x+ is of the order h^3, and not of h^2."""
        return [i for i, row in enumerate(self.deviations) if any(row) and not sum(map(mul, row, self.nodes))]


def tableau_of(evidence: Mapping[str, Any]) -> Tableau:
    """Return the Runge-Kutta method that the evidence names under `method`. Raises: `Unproved` for another name."""
    known = _METHODS.get(part(evidence, "method", str))
    if known is None:
        raise Unproved(f"its method is none of {', '.join(_METHODS)}")
    rows, weights, order = known
    return Tableau([[number(a) for a in row] for row in rows], [number(b) for b in weights], order)


def method_of(evidence: Mapping[str, Any]) -> Method:
    """Return the method that the evidence names under `method`: Runge-Kutta, the bilinear rule or the matrix
    exponential. Raises: `Unproved`."""
    name = part(evidence, "method", str)
    if name in REALISED:
        return Method([Fraction(0), ONE], 0, partial(_realised, REALISED[name]))
    return _explicit(tableau_of(evidence))


def _explicit(tableau: Tableau) -> Method:
    rows, weights = tableau.rows, tableau.weights

    def changes(parts: ErrorMatrices, h: Fraction, e: Matrix, p: list[Matrix], v: list[Matrix]) -> StepMaps:
        rates, stages = list[Matrix](), list[Matrix]()
        for row, p_i, v_i in zip(rows, p, v, strict=True):
            stages.append(sum((h * a * w for a, w in zip(row, rates, strict=True)), start=e))
            rates.append(parts.M @ stages[-1] + parts.G @ p_i + (parts.B + parts.R) @ v_i)
        whole = (b * w for b, w in zip(weights, rates, strict=True))
        return StepMaps(sum(whole, start=zeros(len(e), e.width)), stages)

    return Method(tableau.nodes, 2 * len(weights) - 1, changes)


FLOW, NOW = _explicit(Tableau([[]], [ONE], 1)), Fraction(0)  # continuous time, and the length of its step


def _realised(
    weights: Callable[[Matrix], Weights], parts: ErrorMatrices, h: Fraction, e: Matrix, p: list[Matrix], v: list[Matrix]
) -> StepMaps:
    """Return a step of an exponential integrator on e' = L e + r as linear maps: X_2 = e + h phi_1 (L e + r_1), e+ =
    X_2 + h phi_2 (r_2 - r_1). `weights`(h L): phi_1, phi_2 and a bound of the error of phi_2's entries."""
    if parts.moving:
        raise Unproved("a part of its core moves, which its method does not realise")
    nonlinear, X = parts.M - parts.L, h * parts.L
    phi_1, phi_2, width = weights(X)
    first = nonlinear @ e + parts.G @ p[0] + parts.R @ v[0]
    driven = parts.L @ e + first + parts.B @ v[0]  # multiplied by phi_1; `later`, the change of the samples, by phi_2
    later = parts.B @ (v[1] - v[0])
    ahead = phi_1 @ driven + phi_2 @ later
    after = e + h * ahead
    change = nonlinear @ after + parts.G @ p[1] + parts.R @ v[1] - first
    D = ahead + phi_2 @ change
    if not width:
        return StepMaps(D, [e, after])
    any_of_it = Matrix([[width] * len(X) for _ in X])
    off = any_of_it @ (abs(X) @ abs(driven) + abs(later))  # of `ahead`
    spread = abs(nonlinear) @ (h * off)
    off_D = off + any_of_it @ (abs(change) + spread) + abs(phi_2) @ spread
    return StepMaps(D, [e, after], (off_D, h * off))


def _bilinear(X: Matrix) -> Weights:
    phi_1 = inverse(unit(len(X)) - Fraction(1, 2) * X)
    return phi_1, Fraction(1, 2) * phi_1, Fraction(0)


def _exponential(X: Matrix) -> Weights:
    phi_2, width = weight(X)
    return unit(len(X)) + X @ phi_2, phi_2, width + POLYNOMIAL_ERROR


REALISED: Mapping[str, Callable[[Matrix], Weights]] = {  # by the name of a method, of X
    "the bilinear rule": _bilinear,
    "the matrix exponential": _exponential,
}


@dataclass(frozen=True)
class Input:
    """An input u of the error dynamics by its effects per unit: `stages` (s, p), on the samples at each stage of a
    step; `rate` (N), on (e+ - e)/h."""

    stages: Matrix
    rate: list[Fraction]

    def __add__(self, other: "Input") -> "Input":
        """Return the input whose effects are the sums of both inputs' effects."""
        return Input(self.stages + other.stages, [x + y for x, y in zip(self.rate, other.rate, strict=True)])

    def __mul__(self, size: Fraction) -> "Input":
        """Return the input with its effects multiplied by `size`, so that u counts in units of `size`."""
        return Input(size * self.stages, [size * x for x in self.rate])


def ends(method: Method, parts: ErrorMatrices, output: int) -> tuple[Input, Input]:
    """Return the errors of an output's sample at the beginning and at the end of a step as two inputs; between the
    samples the error is interpolated linearly. `output`: its index."""
    row, still = unit_row(output, parts.B.width), [Fraction(0)] * len(parts.M)
    return Input(outer([ONE - c for c in method.nodes], row), still), Input(outer(method.nodes, row), still)


def form_of(
    parts: ErrorMatrices, method: Method, h: Fraction, evidence: Mapping[str, Any], inputs: Sequence[Input] = ()
) -> Matrix:
    """Return the matrix of the quadratic form 2 e'P D v + h |D v|_P^2 + sum_i Q_i'S_i Q_i - p_i'S_i p_i - sum_k
    lambda_k u_k^2 in v = (e, p_1, .., p_s, u), e+ = e + h D v, Q_i = H X_i + E v_i, for a step of length h. The
    evidence has P, and S with the lambda of the `inputs` as its last entries. Raises: `Unproved` unless P > 0, S >=
    0."""
    n, m, s = len(parts.M), len(parts.H), len(method.nodes)
    size = n + s * m
    width = size + len(inputs)
    # a step has no more inputs than the model has rows; in continuous time the certificate sets their number
    rows, most = (width, _WHOLE) if method is FLOW else (size, _ROWS)
    if rows > most:
        raise Unproved(f"its inequality has more than {most} rows")
    P, S = matrix(evidence, "P", n, n), column(evidence, "S", s * m + len(inputs))
    demand_positive({"P": P})
    if any(value < 0 for value in S):
        raise Unproved("its S has a negative number")
    one = unit(width)
    e, p = Matrix(one.rows[:n]), [Matrix(one.rows[n + i * m : n + (i + 1) * m], width) for i in range(s)]
    last = list(enumerate(inputs, size))
    v = [sum((outer(u.stages[i], one[k]) for k, u in last), start=zeros(parts.B.width, width)) for i in range(s)]
    change = method.changes(parts, h, e, p, v)
    D = sum((outer(u.rate, one[k]) for k, u in last), start=change.D)
    pairs = zip(change.stages, v, strict=True)
    reads = Matrix([row for X, v_i in pairs for row in parts.H @ X + parts.E @ v_i], width)
    PD = P @ D
    linear = e.T @ PD
    form = linear + linear.T + h * (D.T @ PD) + reads.T @ reads.weighed(S[: s * m])
    for k, value in enumerate(S):
        form[n + k][n + k] -= value
    return form + _slack(form, h, P, S[: s * m], D, parts.H, reads, *change.off) if change.off else form


def _slack(
    form: Matrix,
    h: Fraction,
    P: Matrix,
    S: list[Fraction],
    D: Matrix,
    H: Matrix,
    reads: Matrix,
    off_D: Matrix,
    off_X: Matrix,
) -> Matrix:
    """Return a diagonal matrix that bounds the increase of the quadratic `form` in v by entrywise errors: `off_D` of D,
    in e+ = e + h D v, and `off_X` of the last stage X; `reads`: the rows H X of all stages."""
    n, m, size = len(P), len(H), len(form)
    PD = abs(P) @ off_D
    linear = Matrix([*PD, *zeros(size - n, size)]) + h * (abs(D).T @ PD)
    read, last = abs(H) @ off_X, Matrix(reads.rows[len(reads) - m :], size)
    weighed = read.weighed(S[len(S) - m :])
    mixed = abs(last).T @ weighed
    whole = linear + linear.T + h * (off_D.T @ PD) + mixed + mixed.T + read.T @ weighed
    scales = [Fraction(1 / math.sqrt(abs(float(row[i])) or 1.0)) for i, row in enumerate(form)]
    return unit(size).weighed(x / base for x, base in zip(whole.applied(scales), scales, strict=True))


def demand_falls(
    parts: ErrorMatrices,
    method: Method,
    h: Fraction,
    alpha: Fraction,
    evidence: Mapping[str, Any],
    inputs: Sequence[Input] = (),
) -> None:
    """Demand |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k u_k^2 for a step of length h, with the P and S of the
    evidence. Raises: `Unproved`."""
    form, n = form_of(parts, method, h, evidence, inputs), len(parts.M)
    for base, row in zip(form, matrix(evidence, "P", n, n), strict=False):
        base[:n] = (x + alpha * y for x, y in zip(base, row, strict=False))
    demand_negative("its inequality", form)


def demand_kept(
    parts: ErrorMatrices, method: Method, h: Fraction, evidence: Mapping[str, Any], inputs: Sequence[Input]
) -> None:
    """Demand that {|e|_P <= 1} is invariant under steps of length h while all inputs |u_k| <= 1, with the P, S and
    alpha of the evidence and sum_k lambda_k <= alpha. Raises: `Unproved`."""
    alpha, lambdas = scalar(evidence, "alpha"), multipliers(evidence, inputs)
    if not (alpha > 0 and alpha * h < 1 and min(lambdas) >= 0 and sum(lambdas) <= alpha):
        raise Unproved("alpha is not above 0, alpha dt not below 1, or its lambda exceed alpha")
    demand_falls(parts, method, h, alpha, evidence, inputs)


def demand_l2(
    parts: ErrorMatrices,
    evidence: Mapping[str, Any],
    inputs: Sequence[Input],
    counted: Iterable[tuple[int, Fraction]],
    mu: Fraction,
) -> None:
    """Demand that the L2 gain from the inputs u to the outputs c_k e_k is at most mu: V' + sum_k (c_k e_k)^2 - mu^2
    |u|^2 < 0 in continuous time, with the P and S of the evidence. `counted`: the pairs (k, c_k). Raises:
    `Unproved`."""
    if max(multipliers(evidence, inputs)) > mu**2:
        raise Unproved("a lambda is above mu^2")
    form = form_of(parts, FLOW, NOW, evidence, inputs)
    for k, c in counted:
        form[k][k] += c**2
    demand_negative("its inequality", form)


def multipliers(evidence: Mapping[str, Any], inputs: Sequence[Input]) -> list[Fraction]:
    """Return the multipliers lambda_k of u_k^2 for the `inputs`, the last entries of S in the evidence. Raises:
    `Unproved`."""
    return column({"S": part(evidence, "S", list)[-len(inputs) :]}, "S", len(inputs))


def demand_negative(what: str, form: Matrix) -> None:
    """Demand that a symmetric matrix `form` is negative definite, by the signs of pivots in intervals, or in fractions
    where intervals do not decide; `what`: its name in the error. Raises: `Unproved`."""
    negated = -1 * form
    known = definite(negated.mapped(point).rows) if negated == negated.T else 0
    if known < 0:
        raise Unproved(f"{what} is not negative")
    if not known:
        demand_positive({f"{what}, negated,": negated})


def demand_within(
    one: Mapping[str, Any], field: int, scales: list[Fraction], bound: Fraction, V: Fraction = ONE
) -> None:
    """Demand |e_k/s_k| <= `bound` while |e|_P^2 <= V, for the observer state k = `field` and its entry s_k of `scales`:
    bound^2 P >= V c'c with the row c of e_k/s_k = c e. `one`: the evidence with P. Raises: `Unproved`."""
    c = [Fraction(int(k == field)) / scale for k, scale in enumerate(scales)]
    rows = zip(c, V * matrix(one, "P", len(c), len(c)), strict=True)
    demand_nonnegative({"bound": Matrix([[bound**2, *(V * x for x in c)], *([V * x, *row] for x, row in rows)])})


def index_under(holder: Mapping[str, Any], key: str, count: int) -> int:
    """Return k - 1, an index from 0, for the integer k from 1 to `count` under a key of a JSON object. Raises:
    `Unproved` for another number."""
    return whole(holder, key, 1, count) - 1


# --- decay in continuous time

# the proof of V' <= -alpha V at a theta, by the claim's V and the evidence of the slopes; returns the number of boxes
Falls = Callable[[Context, Claim, Mapping[str, Any], Fraction, Fraction], int]
WORK = 2**16  # corners times fields^3


def demand_decays(parts: ErrorMatrices, alpha: Fraction, evidence: Mapping[str, Any]) -> None:
    """Demand V' <= -alpha V, V = e'P e, for e' = (M + G diag(d) H) e with all |d_j| <= 1: with the P and the
    multipliers S of the evidence, or without S at all corners d_j = +-1. Raises: `Unproved`."""
    n, m = len(parts.M), len(parts.H)
    P = matrix(evidence, "P", n, n)
    for a, reads in parts.one_sided:  # P a = share reads, share >= 0: the slope decreases V' at any size
        pushed = P.T.applied(a)
        share = dot(pushed, reads) / dot(reads, reads)
        if share < 0 or pushed != [share * x for x in reads]:
            raise Unproved("a slope without an end is not shown to take from V")
    if "S" in evidence:
        demand_falls(parts, FLOW, NOW, alpha, evidence)
        return
    demand_positive({"P": P})
    if 2**m * n**3 > WORK:
        raise Unproved("it has no S, and more corners of its slopes than are tried one by one")
    for corner in corners_of(parts):
        demand_negative("its inequality", lyapunov(P, corner) + alpha * P)


def corners_of(parts: ErrorMatrices) -> Iterator[Matrix]:
    """Yield M + G diag(d) H (N, N) at each of the 2^m corners d_j = +-1."""
    for d in product((-1, 1), repeat=len(parts.H)):
        yield parts.M + parts.G @ parts.H.weighed(d)


@dataclass(frozen=True)
class Decay:
    """The decay of an observer's error at every gain above a least one. `falls`: the function that proves V' <= -alpha
    V at a gain; `gain`(observer): the name and the value of the observer's gain; `phrase`(observer): the result in
    words, with {} for the least gain."""

    falls: Falls
    gain: Callable[[Observer], tuple[str, Fraction]] = lambda observer: ("theta", scalar(observer.numbers, "theta"))
    phrase: Callable[[Observer], str] = lambda observer: "the error converges exponentially for every theta above {}"

    def converges(self, context: Context, claim: Claim) -> Finding:
        """Return the finding that the error converges at every gain above the claim's `least`, since V' < 0 there for
        the V of the claim; the structure of the form is another claim. Raises: `Unproved`."""
        observer, least = observer_of(context, claim), above_zero(claim.evidence, "least")
        boxes = self.falls(context, claim, claim.evidence, least, Fraction(0))
        phrase = self.phrase(observer).format(printed(least, 1))
        return Finding(
            f"in continuous time, without noise, {phrase}{context.modulo}{on_ranges(context.form.box)}", boxes
        )

    def chosen(self, context: Context, claim: Claim) -> Finding:
        """Return the finding that the observer's gain is above the `least` gain in its claim `convergence`, and that V'
        <= -alpha V there if the claim states an alpha. Raises: `Unproved`."""
        (name, chosen), bound = self.gain(observer_of(context, claim)), context.file.claim(f"{claim.maker}.convergence")
        if bound is None or not chosen > scalar(bound.evidence, "least"):
            raise Unproved(f"{name} = {printed(chosen)} is not above the bound")
        known = f"{name} = {is_above(chosen, scalar(bound.evidence, 'least'))}"
        if not claim.evidence:
            return Finding(known)
        alpha = signless(claim.evidence, "alpha")
        boxes = self.falls(context, claim, bound.evidence, chosen, alpha)
        return Finding(f"{known}, where V' <= -{printed(alpha, -1)} V{context.modulo}", boxes)


def decays(makers: Keys, decay: Decay, slopes: Keys, norm: Keys, turning: Keys | None = None) -> tuple[Rule, Rule]:
    """Return the rules for two claims about the observers `makers` on chains: `convergence`, which states a least gain,
    and `theta`, that the observer's gain is above it. `slopes`, `norm`: the permitted keys of evidence on slopes and on
    V; `turning`: as in `Rule`."""
    return (
        chains_rule(makers, ("convergence",), decay.converges, (*slopes, "least", *norm), turning=turning),
        chains_rule(makers, ("theta",), decay.chosen, ("alpha", *norm), "{maker}.convergence", turning=turning),
    )


def clamped(makers: Keys) -> Rule:
    """Return the rule that verifies a bound |db/dz| <= bound on the whole box of a form in other coordinates, to which
    the observers `makers` clamp the argument of b."""

    def steep(context: Context, claim: Claim) -> Finding:
        return jacobian_bound(context, claim, context.form.b, "db/dz")

    return observer_rule(makers, ("lipschitz",), steep, STEEP, STRUCTURE, kinds=CARRIED, turning=())
