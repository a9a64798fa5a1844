"""The one inequality: how a form of what the error obeys falls in a step of a method, or in continuous time.

    X_i = e + h sum_j a_ij w_j,   w_i = M X_i + G p_i,   p_i = diag(d_i) H X_i,   e+ = e + h sum_i b_i w_i
    X_2 = e + h phi_1 (L e + r_1),   r_i = (M - L) X_i + G p_i,   e+ = X_2 + h phi_2 (r_2 - r_1)

e is the error of two estimates that are given the same samples (`uncertain`); M takes its slopes at their middles, G
and H what is beside, |d_ij| <= 1 for each stage by itself. With v = (e, p_1, .., p_s), e+ = e + h D v, H X_i = Q_i v,
P > 0 and S >= 0 diagonal

    2 e'P D v + h |D v|_P^2 + alpha |e|_P^2 + sum of Q_i'S_i Q_i - p_i'S_i p_i < 0   for all v

shows |e+|_P^2 <= (1 - alpha h) |e|_P^2; with inputs u beside v, and sum_k lambda_k u_k^2 taken off, sum_k lambda_k <=
alpha, that |e|_P <= 1 stays so while each |u_k| <= 1. Continuous time is Euler's step of the length 0: V' <= -alpha V.
For given P and S it is a polynomial in h of degree 2 s - 1 by a method of the first line: Euler's, Heun's and the
classical one of Runge and Kutta. The second realises the core L of M, X = h L: by
the bilinear rule phi_1 = (1 - X/2)^-1 = 2 phi_2, by the matrix exponential phi_1 = 1 + X phi_2, phi_2 = (exp X - 1 -
X)/X^2 but for what a program's polynomial is beside that. What that makes of the form is bounded entry by entry, in
absolute values, and |d| 2 |v_i v_j| <= |d| (v_i^2 s_j/s_i + v_j^2 s_i/s_j) brings it onto the diagonal, for any s > 0.

That a norm falls whatever the slopes of an inclusion: V = e'P e, V' <= -alpha V for e' = (M + G diag(d) H) e.

M is affine in each |d_j| <= 1, so that the corners stand for all, where there are no multipliers (`inequality`). A
slope without an end enters M by that which it has; what is beyond, -onto d reads e, d >= 0, takes from V' where P
onto = lambda reads', lambda >= 0.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    built,
    is_above,
    jacobian_bound,
    of_observer,
    on,
    on_chains,
    short,
)
from .file import Claim, Observer, above_zero, column, matrix, part, scalar, signless
from .interval import point
from .matrix import (
    Matrix,
    demand_nonnegative,
    demand_positive,
    inverse,
    minus,
    outer,
    plus,
    scaled,
    sizes,
    times,
    transposed,
    twice,
    unit,
    weight,
    zeros,
)
from .text import number

_ROWS, _WHOLE = 60, 100  # of an inequality of a step, without its inputs; of continuous time, with them
ONE = Fraction(1)
_METHODS: Mapping[str, tuple[tuple[tuple[str, ...], ...], tuple[str, ...], int]] = {
    "Euler": (((),), ("1",), 1),
    "Heun": (((), ("1",)), ("1/2", "1/2"), 2),
    "classical Runge-Kutta": (((), ("1/2",), ("0", "1/2"), ("0", "0", "1")), ("1/6", "1/3", "1/3", "1/6"), 4),
}
TAKEN = Fraction(1, 2**56)  # of an element of phi_2: what a program's polynomial may be beside it
Weights = tuple[Matrix, Matrix, Fraction]  # phi_1 and phi_2, and by how much elements of phi_2 may be beside these


@dataclass(frozen=True)
class Moved:
    """D, and X_i of each stage; `off`: by how much D and the last X may be beside these, entry by entry, empty where
    they are exact."""

    D: Matrix
    stages: list[Matrix]
    off: tuple[Matrix, ...] = ()


@dataclass(frozen=True)
class Parts:
    """e' = M e + G p + (B + R) v, p = diag(d) (H e + E v): M (N, N), G (N, m) and H (m, N) of what the error obeys, and
    the core L of M (N, N), of which a part is `moving` with them or none; B, R (N, p) and E (m, p) of errors v of the
    samples, B as L takes them and R as the rest does. Of slopes without an end `endless` has the columns onto (N) by
    which they enter less a number >= 0 times what they read (N), in the sign in which that is so."""

    M: Matrix
    G: Matrix
    H: Matrix
    L: Matrix
    moving: bool
    B: Matrix
    R: Matrix
    E: Matrix
    endless: list[tuple[list[Fraction], list[Fraction]]] = field(default_factory=list)

    def varied(self, p: Matrix) -> list[Matrix]:
        """G p of rows p (m, size), as a sum's one term; none without slopes that vary."""
        return [times(self.G, p)] if p else []

    def read(self, X: Matrix, v: Matrix) -> Matrix:
        """H X + E v (m, size) of rows v (p, size), of no sample none."""
        return plus(times(self.H, X), *([times(self.E, v)] if v else [])) if self.H else []

    def heard(self, v: Matrix) -> list[Matrix]:
        """(B + R) v of rows v (p, size), as a sum's one term; none without samples."""
        return [times(plus(self.B, self.R), v)] if v else []


@dataclass(frozen=True)
class Method:
    """A method: where its stages stand, from 0 to 1, the `degree` of its form in h, 0 of none; and how it `moves` e (N,
    size), of p_i (m, size) and of errors v_i of the samples (p, size) at each stage."""

    nodes: list[Fraction]
    degree: int
    moves: Callable[[Parts, Fraction, Matrix, list[Matrix], list[Matrix]], Moved]


@dataclass(frozen=True)
class Tableau:
    """k_i = F(x + h sum_j a_ij k_j, c_i), x+ = x + h sum_i b_i k_i: the `rows` of a below its diagonal, the `weights` b
    and the `nodes` c, of a method of an order."""

    rows: list[list[Fraction]]
    weights: list[Fraction]
    order: int

    @property
    def nodes(self) -> list[Fraction]:
        """The sums of the rows."""
        return [sum(row, Fraction(0)) for row in self.rows]

    @property
    def bends(self) -> Matrix:
        """c_i b_j - a_ij (s, s): by what k_j is in c_i Phi_h - X_i, over h."""
        s = len(self.weights)
        wide = [[*row, *[Fraction(0)] * (s - len(row))] for row in self.rows]
        return [
            [c * b - a for b, a in zip(self.weights, row, strict=True)] for c, row in zip(self.nodes, wide, strict=True)
        ]

    @property
    def cubic(self) -> list[int]:
        """The stages at which that begins with a third Taylor coefficient."""
        return [i for i, row in enumerate(self.bends) if any(row) and not sum(map(mul, row, self.nodes))]


def tableau_of(evidence: Mapping[str, Any]) -> Tableau:
    """That of the method that the evidence names. Raises: `Unproved` for what is none of these methods."""
    known = _METHODS.get(part(evidence, "method", str))
    if known is None:
        raise Unproved(f"its method is none of {', '.join(_METHODS)}")
    rows, weights, order = known
    return Tableau([[number(a) for a in row] for row in rows], [number(b) for b in weights], order)


def method_of(evidence: Mapping[str, Any]) -> Method:
    """The method that the evidence names. Raises: `Unproved`."""
    name = part(evidence, "method", str)
    if name in REALISED:
        return Method([Fraction(0), ONE], 0, partial(_realised, REALISED[name]))
    return _explicit(tableau_of(evidence))


def _explicit(tableau: Tableau) -> Method:
    rows, weights = tableau.rows, tableau.weights

    def moves(parts: Parts, h: Fraction, e: Matrix, p: list[Matrix], v: list[Matrix]) -> Moved:
        rates, stages = list[Matrix](), list[Matrix]()
        for row, p_i, v_i in zip(rows, p, v, strict=True):
            stages.append(plus(e, *(scaled(h * a, w) for a, w in zip(row, rates, strict=True))))
            rates.append(plus(times(parts.M, stages[-1]), *parts.varied(p_i), *parts.heard(v_i)))
        return Moved(plus(*(scaled(b, w) for b, w in zip(weights, rates, strict=True))), stages)

    return Method(tableau.nodes, 2 * len(weights) - 1, moves)


FLOW, NOW = _explicit(Tableau([[]], [ONE], 1)), Fraction(0)  # continuous time, and the length of its step


def _realised(
    weights: Callable[[Matrix], Weights], parts: Parts, h: Fraction, e: Matrix, p: list[Matrix], v: list[Matrix]
) -> Moved:
    """By phi_1 and phi_2 of the core. Raises: `Unproved`."""
    if parts.moving:
        raise Unproved("a part of its core moves, which its method does not realise")
    rest, X, (phi_1, phi_2, width) = minus(parts.M, parts.L), scaled(h, parts.L), weights(scaled(h, parts.L))
    B, R = (partial(times, each) for each in (parts.B, parts.R))
    first = plus(times(rest, e), *parts.varied(p[0]), R(v[0]))
    driven = plus(times(parts.L, e), first, B(v[0]))  # by phi_1; by phi_2 what the last sample is beside the first
    later = B(minus(v[1], v[0]))
    ahead = plus(times(phi_1, driven), times(phi_2, later))
    after = plus(e, scaled(h, ahead))
    change = minus(plus(times(rest, after), *parts.varied(p[1]), R(v[1])), first)
    D = plus(ahead, times(phi_2, change))
    if not width:
        return Moved(D, [e, after])
    any_of_it = [[width] * len(X) for _ in X]
    off = times(any_of_it, plus(times(sizes(X), sizes(driven)), sizes(later)))  # of `ahead`
    bent = times(sizes(rest), scaled(h, off))
    off_D = plus(off, times(any_of_it, plus(sizes(change), bent)), times(sizes(phi_2), bent))
    return Moved(D, [e, after], (off_D, scaled(h, off)))


def _bilinear(X: Matrix) -> Weights:
    phi_1 = inverse(minus(unit(len(X)), scaled(Fraction(1, 2), X)))
    return phi_1, scaled(Fraction(1, 2), phi_1), Fraction(0)


def _exponential(X: Matrix) -> Weights:
    phi_2, width = weight(X)
    return plus(unit(len(X)), times(X, phi_2)), phi_2, width + TAKEN


REALISED: Mapping[str, Callable[[Matrix], Weights]] = {  # by the name of a method, of X
    "the bilinear rule": _bilinear,
    "the matrix exponential": _exponential,
}


@dataclass(frozen=True)
class Input:
    """What one input adds: to the samples (p) at each of the stages (s), and `beside` (N) to e over h."""

    stages: list[list[Fraction]]
    beside: list[Fraction]

    def __add__(self, other: "Input") -> "Input":
        """One input that is both."""
        return Input(plus(self.stages, other.stages), plus([self.beside], [other.beside])[0])

    def __mul__(self, size: Fraction) -> "Input":
        """That of an input in units of a size."""
        return Input(scaled(size, self.stages), scaled(size, [self.beside])[0])


def ends(method: Method, parts: Parts, output: int) -> tuple[Input, Input]:
    """An error of the sample of an output at the beginning of a step, and at the end, with the line between them."""
    row, nothing = unit(len(parts.B[0]))[output], [Fraction(0)] * len(parts.M)
    first, last = (
        [[w * x for x in row] for w in weights] for weights in ([ONE - c for c in method.nodes], method.nodes)
    )
    return Input(first, nothing), Input(last, nothing)


def form_of(
    parts: Parts, method: Method, h: Fraction, evidence: Mapping[str, Any], entering: Sequence[Input] = ()
) -> Matrix:
    """2 e'P D v + h |D v|_P^2 + sum of Q'S Q - p'S p, without alpha; P and S are shown to have their signs. Inputs
    stand at the end of v, and S goes on with them."""
    n, m, s, inputs = len(parts.M), len(parts.H), len(method.nodes), len(entering)
    size = n + s * m
    # of a step the inputs are as few as the model's rows; of continuous time a certificate says how many there are
    rows, most = (size + inputs, _WHOLE) if method is FLOW else (size, _ROWS)
    if rows > most:
        raise Unproved(f"its inequality has more than {most} rows")
    P, S = matrix(evidence, "P", n, n), column(evidence, "S", s * m + inputs)
    demand_positive({"P": P})
    if any(value < 0 for value in S):
        raise Unproved("its S has a negative number")
    one = unit(size + inputs)
    start, p = one[:n], [one[n + i * m : n + (i + 1) * m] for i in range(s)]
    nothing, last = zeros(len(parts.B[0]), size + inputs), list(enumerate(entering, size))
    v = [plus(nothing, *(outer(each.stages[i], one[k]) for k, each in last)) for i in range(s)]
    moved = method.moves(parts, h, start, p, v)
    D = plus(moved.D, *(outer(each.beside, one[k]) for k, each in last))
    reads = [row for X, v_i in zip(moved.stages, v, strict=True) for row in parts.read(X, v_i)]
    PD = times(P, D)
    linear = times(transposed(start), PD)
    form = plus(linear, transposed(linear), scaled(h, times(transposed(D), PD)))
    if m:
        weighed = [[value * x for x in row] for value, row in zip(S, reads, strict=False)]
        form = plus(form, times(transposed(reads), weighed))
    for k, value in enumerate(S):
        form[n + k][n + k] -= value
    return plus(form, _slack(form, h, P, S[: s * m], D, parts.H, reads, moved.off)) if moved.off else form


def _slack(
    form: Matrix,
    h: Fraction,
    P: Matrix,
    S: list[Fraction],
    D: Matrix,
    H: Matrix,
    reads: Matrix,
    off: tuple[Matrix, ...],
) -> Matrix:
    """A diagonal that is at least what the form becomes larger by where D and the last X are off."""
    off_D, off_X, n, m = *off, len(P), len(H)
    PD = times(sizes(P), off_D)
    linear = plus([*PD, *zeros(len(form) - n, len(form))], scaled(h, times(transposed(sizes(D)), PD)))
    terms = [linear, transposed(linear), scaled(h, times(transposed(off_D), PD))]
    if m:
        read = times(sizes(H), off_X)
        weighed = [[value * x for x in row] for value, row in zip(S[-m:], read, strict=True)]
        mixed = times(transposed(sizes(reads[-m:])), weighed)
        terms += [mixed, transposed(mixed), times(transposed(read), weighed)]
    scales = [Fraction(1 / math.sqrt(abs(float(row[i])) or 1.0)) for i, row in enumerate(form)]
    sums = [sum(map(mul, row, scales)) / own for row, own in zip(plus(*terms), scales, strict=True)]
    return [[value * x for x in row] for value, row in zip(sums, unit(len(form)), strict=True)]


def demand_falls(
    parts: Parts,
    method: Method,
    h: Fraction,
    alpha: Fraction,
    evidence: Mapping[str, Any],
    inputs: Sequence[Input] = (),
) -> None:
    """Demand that |e|_P^2 falls by alpha h of itself at least, but for the sum of lambda_k u_k^2 of inputs u. Raises:
    `Unproved`."""
    form, n = form_of(parts, method, h, evidence, inputs), len(parts.M)
    for own, row in zip(form, matrix(evidence, "P", n, n), strict=False):
        own[:n] = (x + alpha * y for x, y in zip(own, row, strict=False))
    demand_negative("its inequality", form)


def demand_kept(
    parts: Parts, method: Method, h: Fraction, evidence: Mapping[str, Any], inputs: Sequence[Input]
) -> None:
    """Demand that |e|_P <= 1 stays so while each input is at most 1. Raises: `Unproved`."""
    alpha, lambdas = scalar(evidence, "alpha"), multipliers(evidence, inputs)
    if not (alpha > 0 and alpha * h < 1 and min(lambdas) >= 0 and sum(lambdas) <= alpha):
        raise Unproved("alpha is not above 0, alpha dt not below 1, or its lambda exceed alpha")
    demand_falls(parts, method, h, alpha, evidence, inputs)


def multipliers(evidence: Mapping[str, Any], inputs: Sequence[Input]) -> list[Fraction]:
    """The lambda of the inputs. Raises: `Unproved`."""
    return column({"S": part(evidence, "S", list)[-len(inputs) :]}, "S", len(inputs))


def demand_negative(what: str, form: Matrix) -> None:
    """Demand that a symmetric form is negative: by its elimination in intervals, where these are too wide in fractions.
    Raises: `Unproved`."""
    negated = scaled(Fraction(-1), form)
    known = definite([[point(value) for value in row] for row in negated]) if transposed(negated) == negated else 0
    if known < 0:
        raise Unproved(f"{what} is not negative")
    if not known:
        demand_positive({f"{what}, negated,": negated})


def within(one: Mapping[str, Any], field: int, scales: list[Fraction], bound: Fraction, V: Fraction = ONE) -> None:
    """That the error which a field stands for is at most `bound` where |e|_P^2 <= V: bound^2 P >= V c'c. Raises:
    `Unproved`."""
    c = [Fraction(int(k == field)) / scale for k, scale in enumerate(scales)]
    P = matrix(one, "P", len(c), len(c))
    demand_nonnegative(
        {
            "bound": [
                [bound**2, *(V * x for x in c)],
                *([V * x, *(V * y for y in row)] for x, row in zip(c, P, strict=True)),
            ]
        }
    )


def place(holder: Mapping[str, Any], key: str, count: int) -> int:
    """A place from 0, given from 1. Raises: `Unproved`."""
    value = scalar(holder, key)
    if value.denominator > 1 or not 1 <= value <= count:
        raise Unproved(f"its {key} is none of 1 to {count}")
    return int(value) - 1


# ---

# V' <= -alpha V at a theta, by the claim's V, whatever the slopes that the second evidence bounds; in how many boxes
Falls = Callable[[Context, Claim, Mapping[str, Any], Fraction, Fraction], int]
WORK = 2**16  # corners times fields^3


def demand_decays(parts: Parts, alpha: Fraction, evidence: Mapping[str, Any]) -> None:
    """V' <= -alpha V by the evidence's P, and its S where it has one. Raises: `Unproved`."""
    n, m = len(parts.M), len(parts.H)
    P = matrix(evidence, "P", n, n)
    for onto, reads in parts.endless:  # P onto is what is read times a number >= 0: V' loses by a slope of any size
        (pushed,) = times([onto], P)
        share = sum(x * y for x, y in zip(pushed, reads, strict=True)) / sum(x * x for x in reads)
        if share < 0 or pushed != [share * x for x in reads]:
            raise Unproved("a slope without an end is not shown to take from V")
    if "S" in evidence:
        demand_falls(parts, FLOW, NOW, alpha, evidence)
        return
    demand_positive({"P": P})
    if 2**m * n**3 > WORK:
        raise Unproved("it has no S, and more corners of its slopes than are tried one by one")
    for corner in corners_of(parts):
        demand_negative("its inequality", plus(twice(P, corner), scaled(alpha, P)))


def corners_of(parts: Parts) -> Iterator[Matrix]:
    """M + G diag(d) H at all corners of the slopes."""
    for d in product((-1, 1), repeat=len(parts.H)):
        signed = [[x * sign for x, sign in zip(row, d, strict=True)] for row in parts.G]
        yield plus(parts.M, times(signed, parts.H)) if d else parts.M


@dataclass(frozen=True)
class Decay:
    """Decay of an observer's error at every gain from a least one on: how it `falls`, the name and the value of the
    least `gain` that an observer has, and what is `said` of its error at every gain above a bound."""

    falls: Falls
    gain: Callable[[Observer], tuple[str, Fraction]] = lambda observer: ("theta", scalar(observer.numbers, "theta"))
    said: Callable[[Observer], str] = lambda observer: "the error converges exponentially for every theta above {}"

    def converges(self, context: Context, claim: Claim) -> Finding:
        """The bound above which every gain converges, by a V of the claim; the structure of the form is another."""
        observer, least = built(context, claim), above_zero(claim.evidence, "least")
        boxes = self.falls(context, claim, claim.evidence, least, Fraction(0))
        said = self.said(observer).format(short(least, 1))
        return Finding(f"in continuous time, without noise, {said}{on(context.form.box)}", boxes)

    def chosen(self, context: Context, claim: Claim) -> Finding:
        """The observer's gain is above that bound; V falls there, where the claim says at which rate."""
        (name, chosen), bound = self.gain(built(context, claim)), context.file.claim(f"{claim.maker}.convergence")
        if bound is None or not chosen > scalar(bound.evidence, "least"):
            raise Unproved(f"{name} = {short(chosen)} is not above the bound")
        known = f"{name} = {is_above(chosen, scalar(bound.evidence, 'least'))}"
        if not claim.evidence:
            return Finding(known)
        alpha = signless(claim.evidence, "alpha")
        boxes = self.falls(context, claim, bound.evidence, chosen, alpha)
        return Finding(f"{known}, where V' <= -{short(alpha, -1)} V", boxes)


def decays(makers: Keys, decay: Decay, slopes: Keys, norm: Keys) -> tuple[Rule, Rule]:
    """The rules that observers on a form in chains decay: the evidence of their `slopes`, and of a V, its `norm`."""
    return (
        on_chains(makers, ("convergence",), decay.converges, (*slopes, "least", *norm)),
        on_chains(makers, ("theta",), decay.chosen, ("alpha", *norm), "{maker}.convergence"),
    )


def clamped(makers: Keys) -> Rule:
    """The rule of |db/dz| <= bound on the whole box of z of a form in other coordinates, to which observers clamp the
    argument of b."""

    def steep(context: Context, claim: Claim) -> Finding:
        return jacobian_bound(context, claim, context.form.b, "db/dz")

    return of_observer(makers, ("lipschitz",), steep, STEEP, STRUCTURE, kinds=CARRIED)
