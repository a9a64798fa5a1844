"""A high gain that moves, and the quadratic Lyapunov function that allows it: verified in exact arithmetic.

    what' = A what + c(what, u) + T K (y - what_1),   T = diag(gamma, .., gamma^n),   D = diag(1, .., n)
    e = T^-1 (w - what):   e' = gamma (A - K C) e - (gamma'/gamma) D e + T^-1 (c(w) - c(what)) + (T^-1 G_1 - K G_2) v

    P > 0,   D P + P D >= 0,   (A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I <= 0                    (54)
    gamma'/gamma^2 >= -sigma                                                                                    (55)
    gamma >= gamma_inf > max(1, 2 k lambda_max(P)/lambda)                                                   (56), (62)

A, C a chain of integrators, v a disturbance of the plant by G_1 and of the measurement by G_2, k >= |T^-1 dc/dw T| for
every gamma >= gamma_inf. V = e'P e has V' <= -(gamma lambda - 2 k lambda_max(P)) |e|^2 without v; a lower bound than
(62) has `moving`. The paper leaves out D P + P D >= 0, without which (55) does not bound the term with gamma'. With v,
and

    lambda >= (4 k lambda_max(P) + 1)/(2 gamma_inf),   gamma <= gamma_sup                                   (70), (71)
    (A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I + P P/alpha_1 + P K K'P/alpha_2 <= 0                  (87)

the L2 gain from v to w - what is at most mu, mu^2 = 2 gamma_sup^(2n) max(delta_1 alpha_1, delta_2 alpha_2), where
delta_1 = 1 + |G_1|^2 and delta_2 = G_2 (I + G_1'G_1) G_2'. (79) may fail, and (72) wants delta_1 I in the place of its
matrix, since T^-1 G_1 G_1'T^-1 <= |G_1|^2 I for gamma >= 1; (85) lacks the delta_i. k may be taken at gamma_inf: c_i
reads w_1, .., w_i, so that T^-1 dc/dw T is a polynomial in 1/gamma, whose norm on a disc is largest at its edge, where
it is the one at gamma_inf up to a similarity by a diagonal of modulus 1. Source: Alessandri, "On Hamilton-Jacobi
approaches to state reconstruction for dynamic systems" (2020), theorems 5-7.

A smaller mu than that of (87) has one V for all of gamma's course, in e_i = units_i (w_i - what_i)/gamma^i,

    e' = gamma (N - r D) e + T^-1 (dc/dw) T e + (gamma^-i G_1 - K G_2) v,   r = gamma'/gamma^2 >= -sigma

Where D P + P D >= 0, a larger r takes from V' what a smaller leaves. At r = -sigma, V' + |w - what|^2 - mu^2 |v|^2 is
for each e and v a sum of what is convex in gamma, linear in the gamma^-i, and linear in the slopes of c, whose ranges
shrink as gamma grows: it is negative where it is at both ends of gamma, and of each gamma^-i by itself, with the slopes
at the lowest gamma (`MovingGain`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import sympy as sp
from flint import fmpq_mat

from hgogen.analysis.evidence import LOOSE, Evidence, Grounds, Steep
from hgogen.analysis.polytope import chains
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.injection import companion
from hgogen.estimators.integrators import Integrators
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.inclusion import Inclusion, Shown
from hgogen.prove.lmi import NoSolver
from hgogen.prove.quadratic import Array, identity, inverse_root, rational
from hgogen.prove.quadratic import floats as rounded
from hgogen.prove.questions import Driven, L2Bound, l2_bound
from hgogen.prove.steepness import slope
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.definite import (
    Matrix,
    exact,
    floats,
    fraction,
    largest,
    nonnegative,
    number,
    positive,
    rationals,
    root,
    smallest,
    symmetric,
    unit,
    unsymmetric,
)
from hgogen.sentence import NONE, Down, Reason, Up, because

_SLACKS = tuple(Fraction(1, 2**k) for k in range(40, 4, -4))  # of s, what rounding may take from (87)


@dataclass(frozen=True, eq=False)
class MovingGain:
    """A gamma in [`low`, `high`] that falls at most like -`sigma` gamma^2, of an observer whose error at a constant one
    obeys `error`; `plant` (n, m) and `measurement` (m): by what a disturbance v enters w' and y."""

    error: Inclusion
    low: Fraction
    high: Fraction
    sigma: Fraction
    plant: Matrix
    measurement: tuple[Fraction, ...]

    def attenuation(self, P: Matrix) -> L2Bound | None:
        """A small bound of the gain from v to w - what; `P`: what V may be near to. None where none is proved, or there
        is no solver."""
        try:
            return l2_bound([*self._systems()], inverse_root(rounded(rational(P))), self._powers)
        except NoSolver:
            return None

    @property
    def _powers(self) -> Array:
        """D."""
        return np.asarray(identity(len(self.plant)) * rational([p + 1 for p in self.error.layout.power]))

    def _systems(self) -> Iterator[Driven]:
        """Those at the ends of gamma and of each gamma^-i that enters."""
        e, units, D, one = self.error.at(self.low), rational(self.error.units), self._powers, identity(len(self.plant))
        falling = e.core * (1 / number(self.low)) + D * number(self.sigma)
        noise = e.driven_by(rational([self.measurement]) / number(self.low))
        entering = [any(row) for row in self.plant]
        ends = [(self.low**-p, self.high**-p) if enters else (self.low**-p,) for p, enters in enumerate(entering, 1)]
        for gamma, powers in product((self.low, self.high), product(*ends)):
            M = falling * number(gamma) + (e.M - e.core)
            pushed = rational(self.plant) * (units * rational(powers))[:, None]
            counted = one * (rational([gamma**p for p in range(1, len(ends) + 1)]) / units)
            yield Driven(replace(noise, M=M, B=noise.B - pushed), counted)


@dataclass(frozen=True)
class Candidate:
    """A gain K (n), a symmetric P (n, n) and sigma >= 0 that may satisfy (54)."""

    K: tuple[Fraction, ...]
    P: Matrix
    sigma: Fraction

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.K)

    def evidence(self, form: Form) -> Evidence:
        """The matrix P."""
        return {"P": self.P}

    @cached_property
    def shrink(self) -> Any:
        """D P + P D, FLINT's."""
        return fmpq_mat([[number(value) * (i + j + 2) for j, value in enumerate(row)] for i, row in enumerate(self.P)])

    @cached_property
    def rate(self) -> Any:
        """-(A - K C)'P - P (A - K C) - sigma (D P + P D), FLINT's."""
        P, N = exact(self.P), exact(companion(np.array(self.K)))
        return -(N.transpose() * P + P * N + self.shrink * number(self.sigma))

    @cached_property
    def decay(self) -> Fraction:
        """A proved lambda of (54), all but the largest; not positive where there is none."""
        return smallest(self.rate)[0]

    @cached_property
    def peak(self) -> Fraction:
        """A proved upper bound of lambda_max(P), all but the smallest."""
        return largest(exact(self.P))[1]

    @cached_property
    def injection(self) -> Any:
        """P K K'P, FLINT's."""
        Y = exact(self.P) * fmpq_mat([[number(value)] for value in self.K])
        return Y * Y.transpose()

    def least(self, slope: Fraction, decay: Fraction | None = None) -> Fraction:
        """(70), (88): max(1, (4 k lambda_max(P) + 1)/(2 lambda)), from above."""
        return max(Fraction(1), (4 * slope * self.peak + 1) / (2 * (self.decay if decay is None else decay)))


@dataclass(frozen=True)
class Disturbance:
    """G_1 (n, m) and G_2 (m), rational, in the coordinates of integrators."""

    plant: Matrix
    measurement: tuple[Fraction, ...]

    @cached_property
    def deltas(self) -> tuple[Fraction, Fraction]:
        """delta_1, from above, and delta_2."""
        G, g = exact(self.plant), fmpq_mat([[number(value) for value in self.measurement]])
        second = (g * (unit(len(self.measurement)) + G.transpose() * G) * g.transpose())[0, 0]
        return 1 + largest(G * G.transpose())[1], fraction(second)

    @property
    def reason(self) -> Reason:
        """The pair, as a reason names it."""
        rows = [because("{row: }", row=map(float, row)) for row in self.plant]
        return because("G_1 = [{rows:; }], G_2 = [{row: }]", rows=rows, row=map(float, self.measurement))

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class Given:
    """What an observer guarantees: gamma in [`low`, `high`], and k >= |T^-1 dc/dw T| from gamma = `low` on, the
    `slope`, as shown by `steep`; None where no k is known, for the `reason`. `moving`: what a disturbance does to the
    error, where that is known by slope."""

    low: Fraction
    high: Fraction
    slope: Fraction | None
    reason: Reason = NONE
    disturbance: Disturbance | None = None
    steep: Steep | None = None
    moving: MovingGain | None = None


@dataclass(frozen=True)
class Attenuating:
    """The proof of a claim about the L2 gain of the `candidate`, under the `assumptions`."""

    candidate: Candidate
    assumptions: Given

    def evidence(self, form: Form) -> Evidence | None:
        """The matrix P, lambda_max(P), the bound k of dc/dw, the disturbance, and s of (87) and mu for the k that is
        written, which is a little more than the proof's."""
        one, disturbed, steep = self.candidate, self.assumptions.disturbance, self.assumptions.steep
        slope = steep.evidence(form) if steep else None
        if slope is None or disturbed is None:
            return None
        assumptions = replace(self.assumptions, slope=slope["bound"])
        share, mu = assumed_share(one, assumptions), gain(one, assumptions)
        if share is None or mu is None:
            return None
        matrices = {"P": one.P, "peak": one.peak, "G_1": disturbed.plant, "G_2": disturbed.measurement}
        return {**matrices, "delta_1": disturbed.deltas[0], "share": share, "mu": mu, **slope}


def candidate(K: Any, P: Any, sigma: Any, n: int | None = None) -> Candidate:
    """K, P, sigma as rationals, which floats are; of a P that is symmetric but for rounding, (P + P')/2 (`symmetric`).

    Raises: `BadGain` for other than n numbers K, a matrix P that is less symmetric, sigma < 0, or what is not finite.
    """
    gain, matrix, shrink = reals("K", K), reals("P", P), reals("sigma", sigma)
    n = gain.size if n is None else n
    if gain.shape != (n,):
        raise BadGain(f"K of shape {gain.shape}", f"must have {n} numbers, one for each state")
    if matrix.shape != (n, n):
        raise BadGain(f"P of shape {matrix.shape}", f"must be a {n} x {n} matrix")
    for name, values in (("K", gain), ("P", matrix), ("sigma", shrink)):
        if not np.isfinite(values).all():
            raise BadGain(name, "must be finite")
    even = symmetric(rationals(matrix))
    if even is None:
        raise BadGain("P", unsymmetric("P"))
    if shrink.ndim or shrink < 0:
        raise BadGain(f"sigma = {sigma!r}", "must be a number, at least 0")
    return Candidate(tuple(map(Fraction, gain.tolist())), even, Fraction(float(shrink)))


def disturbance(pair: Any, n: int) -> Disturbance:
    """(G_1, G_2) as rationals. Raises: `BadGain` for shapes other than (n, m) and (m)."""
    if not isinstance(pair, Sequence) or len(pair) != 2:
        raise BadGain("disturbance", "must be a pair, G_1 of the plant and G_2 of the measurement")
    G, g = reals("G_1", pair[0]), reals("G_2", pair[1])
    if G.ndim != 2 or G.shape[0] != n or not G.shape[1] or g.shape != (G.shape[1],):
        reason = f"must be ({n}, m) and (m,), a column for each disturbance"
        raise BadGain(f"G_1 of shape {G.shape} and G_2 of shape {g.shape}", reason)
    if not (np.isfinite(G).all() and np.isfinite(g).all()):
        raise BadGain("G_1 and G_2", "must be finite")
    return Disturbance(rationals(G), tuple(map(Fraction, g.tolist())))


def steepness(chain: Integrators, gamma: float) -> Steep | Nothing:
    """k >= |T^-1 dc/dw T| on the box for every gamma from this one on, by outward-rounded intervals; or why there is
    none."""
    units = tuple(Fraction(gamma) ** -(i + 1) for i in range(chain.n))
    (a,) = chains(chain.form)
    scale = tuple(sp.Rational(x) * sp.Mul(*a[: i + 1]) for i, x in enumerate(units))
    bound = slope(chain.form, scale)
    return bound if isinstance(bound, Nothing) else Steep(units, scale, bound, LOOSE)


def attenuation(candidate: Candidate, decay: Fraction, alpha_1: Fraction, alpha_2: Fraction) -> Any:
    """The block matrix of (87), FLINT's, times -1."""
    n, P = candidate.n, rational(candidate.P)
    M = np.array((candidate.rate - unit(n) * number(decay)).tolist(), dtype=object)
    Y, last = P @ rational(candidate.K)[:, None], rational([[alpha_2]])
    one, zero = identity(n) * number(alpha_1), 0 * P[:, :1]
    return fmpq_mat(np.block([[M, -P, -Y], [-P, one, zero], [-Y.T, zero.T, last]]).tolist())


def facts(maker: str, candidate: Candidate, decay: Fraction | None = None) -> tuple[Check, Check, Check]:
    """`MAKER.definite`, `MAKER.shrink`, `MAKER.decay`: what is asked of K, P and sigma alone."""
    more = "" if decay is None else f" + {float(decay):g} I"
    rate = candidate.rate if decay is None else candidate.rate - unit(candidate.n) * number(decay)
    return (
        judged(ClaimId(maker, "definite"), "P > 0", exact(candidate.P)),
        judged(ClaimId(maker, "shrink"), "D P + P D >= 0, D = diag(1, .., n)", candidate.shrink, strict=False),
        judged(
            ClaimId(maker, "decay"),
            f"(A - K C)'P + P (A - K C) + {float(candidate.sigma):g} (D P + P D){more} < 0",
            rate,
            sign=-1,
        ),
    )


def judged(id: ClaimId, claim: str, M: Any, strict: bool = True, sign: int = 1) -> Check:
    """Whether M > 0, or M >= 0; the claim is about `sign` M."""
    low, high = smallest(M)
    extreme = "smallest" if sign > 0 else "largest"
    pattern = "the {extreme} eigenvalue is {side} {bound}, in exact arithmetic"
    if (positive if strict else nonnegative)(M):
        side, bound = ("at least", Down(low)) if sign > 0 else ("at most", Up(-low))
        return Check(id, claim, Verdict.PROVED, because(pattern, extreme=extreme, side=side, bound=bound))
    side, bound = ("below", Up(high)) if sign > 0 else ("above", Down(-high))
    return Check(
        id,
        claim,
        Verdict.REFUTED,
        because(pattern, extreme=extreme, side=side, bound=bound),
        witness={"eigenvalue": float(sign * high)},
        fix="Take them of hgogen.design.",
    )


def checks(maker: str, candidate: Candidate, assumptions: Given) -> tuple[Check, ...]:
    """The checks of `facts`, and with a disturbance `MAKER.attenuation`, that the L2 gain has a bound."""
    known = facts(maker, candidate)
    whole: list[tuple[Check, Candidate | Attenuating | Shown]] = [(check, candidate) for check in known]
    if assumptions.disturbance:
        sound = all(check.verdict is Verdict.PROVED for check in known)
        lost = NONE if sound else because("P proves nothing")
        lost = lost or (NONE if assumptions.slope is not None else assumptions.reason)
        moving = None if lost or assumptions.moving is None else assumptions.moving
        one = moving and moving.attenuation(candidate.P)
        if moving and one:
            disturbed = {"G_1": moving.plant, "G_2": moving.measurement}
            fact = Shown(moving.error, {**disturbed, "V": one.weights.P, "S": one.weights.S, "mu": one.mu})
            whole += [(_attenuated(maker, assumptions.disturbance, Up(one.mu, 3)), fact)]
        else:
            whole += [(_gain(maker, candidate, assumptions, lost), Attenuating(candidate, assumptions))]
    built = numbers(candidate, assumptions)
    return tuple(replace(check, proofs=(Grounds(built, fact),)) for check, fact in whole)


def numbers(candidate: Candidate, assumptions: Given) -> dict[str, Any]:
    """What the observer is built with, as far as its claims go."""
    return {"gamma": (assumptions.low, assumptions.high), "sigma": candidate.sigma, "gains": candidate.K}


_ATTENUATES = "in continuous time, the L2 gain from v in w' + G_1 v, y + G_2 v to the error of w has a bound"


def _attenuated(maker: str, disturbance: Disturbance, mu: Up) -> Check:
    pattern = "mu <= {mu}, in the coordinates of integrators, while the estimate keeps to its outer box; {disturbance}"
    reason = because(pattern, mu=mu, disturbance=disturbance.reason)
    return Check(ClaimId(maker, "attenuation"), _ATTENUATES, Verdict.PROVED, reason)


def _gain(maker: str, candidate: Candidate, assumptions: Given, lost: Reason) -> Check:
    if lost or assumptions.disturbance is None:
        return Check(ClaimId(maker, "attenuation"), _ATTENUATES, Verdict.UNKNOWN, lost)
    mu = gain(candidate, assumptions)
    if mu is None:
        least = Up(candidate.least(assumptions.slope or Fraction(0)))
        low = because("not shown: (70) asks for gamma_inf above {least} at least", least=least)
        return Check(ClaimId(maker, "attenuation"), _ATTENUATES, Verdict.UNKNOWN, low, fix="Raise gamma_inf.")
    return _attenuated(maker, assumptions.disturbance, Up(mu))


def gain(candidate: Candidate, assumptions: Given) -> Fraction | None:
    """A proved mu for gamma in its range, near the smallest that (87) gives; None where (70) or (87) fails."""
    share = assumed_share(candidate, assumptions)
    return None if share is None else root(2 * share, bits=52) * assumptions.high**candidate.n


def assumed_share(candidate: Candidate, assumptions: Given) -> Fraction | None:
    """The number s of `share_of`, with lambda of (70); None where no slope or no disturbance is known."""
    if assumptions.slope is None or assumptions.disturbance is None:
        return None
    return share_of(
        candidate, (4 * assumptions.slope * candidate.peak + 1) / (2 * assumptions.low), assumptions.disturbance
    )


def share_of(candidate: Candidate, decay: Fraction, disturbance: Disturbance) -> Fraction | None:
    """A small s = delta_1 alpha_1 = delta_2 alpha_2 that satisfies (87) with lambda = `decay`, proved; None where none
    is found."""
    M = candidate.rate - unit(candidate.n) * number(decay)
    if not positive(M):
        return None
    first, second = disturbance.deltas
    P = exact(candidate.P)
    load = P * P * number(first) + candidate.injection * number(second)
    try:
        factor = np.linalg.inv(np.linalg.cholesky(floats(M)))
    except np.linalg.LinAlgError:  # positive definite, but not to a float
        return None
    least = Fraction(float(np.linalg.eigvalsh(factor @ floats(load) @ factor.T).max()))
    tried = (least * (1 + slack) for slack in _SLACKS)
    return next((s for s in tried if s > 0 and nonnegative(M - load * (1 / number(s)))), None)
