"""Time-varying high gains: quadratic Lyapunov functions for every value and rate of a gain, verified in exact
arithmetic.

1. A gain gamma of any course (`adaptive_lmi`):

    what' = A what + c(what, u) + T K (y - what_1),   T = diag(gamma, .., gamma^n),   D = diag(1, .., n)
    e = T^-1 (w - what):   e' = gamma (A - K C) e - (gamma'/gamma) D e + T^-1 (c(w) - c(what)) + (T^-1 G_1 - K G_2) v

    P > 0,   D P + P D >= 0,   (A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I <= 0                    (54)
    gamma'/gamma^2 >= -sigma                                                                                    (55)
    gamma >= gamma_inf > max(1, 2 k lambda_max(P)/lambda)                                                   (56), (62)

A, C are a chain of integrators; v is a disturbance of the plant by G_1 and of the measurement by G_2; k >= |T^-1 dc/dw
T| for every gamma >= gamma_inf. Without v, V = e'P e has V' <= -(gamma lambda - 2 k lambda_max(P)) |e|^2. Part 2 has a
lower bound than (62). The paper leaves out D P + P D >= 0, without which (55) does not bound the term with gamma'. With
v, and

    lambda >= (4 k lambda_max(P) + 1)/(2 gamma_inf),   gamma <= gamma_sup                                   (70), (71)
    (A - K C)'P + P (A - K C) + sigma (D P + P D) + lambda I + P P/alpha_1 + P K K'P/alpha_2 <= 0                  (87)

the L2 gain from v to w - what is at most mu, mu^2 = 2 gamma_sup^(2n) max(delta_1 alpha_1, delta_2 alpha_2), where
delta_1 = 1 + |G_1|^2 and delta_2 = G_2 (I + G_1'G_1) G_2'. (79) may fail, and (72) wants delta_1 I in the place of its
matrix, since T^-1 G_1 G_1'T^-1 <= |G_1|^2 I for gamma >= 1; (85) lacks the delta_i. k may be taken at gamma_inf: c_i
reads w_1, .., w_i, so that T^-1 dc/dw T is a polynomial in 1/gamma. Its norm on a disc is largest at the edge, and
there equals that at gamma_inf, by a similarity with a diagonal of modulus 1. Source: Alessandri, "On Hamilton-Jacobi
approaches to state reconstruction for dynamic systems" (2020), theorems 5-7.

`VaryingGain` proves a smaller mu than (87), by one V for every course of gamma, in e_i = units_i (w_i -
what_i)/gamma^i,

    e' = gamma (N - r D) e + T^-1 (dc/dw) T e + (gamma^-i G_1 - K G_2) v,   r = gamma'/gamma^2 >= -sigma

Where D P + P D >= 0, V' is largest at r = -sigma. There V' + |w - what|^2 - mu^2 |v|^2 is for each e and v a sum of
terms that are convex in gamma, linear in the gamma^-i, and linear in the slopes of c, whose ranges shrink as gamma
grows. So it is negative if it is at both ends of gamma, and of each gamma^-i by itself, with the slopes at the lowest
gamma.

2. Convergence for every value of a gain l, every rate that its law permits, and all slopes of b in their ranges
(`adaptive_lmi`, `updated_gain`), by one quadratic Lyapunov function:

    e_k = error of w_k over l^(b+k-1):   e'/l = (N - r D + J(l)/l) e,   r = l'/l^2,   D = diag(b, .., b + n - 1)

J(l)/l shrinks as l grows: 0 is in the ranges of its slopes, each over a power of l that is at least 1. With r >= -s,
e'/l at an l >= least is a mean of the M_j e, less a share >= 0 of D e. V = e'P e decreases if it does for these:

    adaptive_lmi   s = sigma:                          N + sigma D + J(least)/least
    updated_gain   s = p_1 (1 - p_2/l), p_2 >= least:  N + J(least)/least,   N + p_1 D
                   in the shares least/l, 1 - least/l: l may fall fast only where it is far above p_2

    M_j'P + P M_j + alpha/least P < 0,   D P + P D > 0:   V' <= -alpha l/least V

The rate at which l rises does not matter, nor the law of its rise, nor an upper end at which it rests. So
`updated_gain` needs no bound of slopes by those at the estimate, as the paper does, only a large enough p_2.

3. The conditions of `updated_gain` on its law L' = L (p_1 (p_2 - L) + p_3 Gamma), in rationals and intervals:

    N'P + P N <= -I,  N = A - K C,   D = diag(b, .., b + n - 1)
    D P + P D > 0,   N'P + P N + p_1 (D P + P D) < 0,   p_3 (D P + P D) >= 2 lambda_max(P)

L never exceeds a cap above p_2 + (p_3/p_1) sup Gamma(cap), as L' < 0 there. `observers.updated_gain` has the source.

4. The dwell time of a gain that switches between two values (`switched_gain`), so that the error keeps its decay:

    V_l = eps_l'P_l eps_l,   eps_l = diag(theta^-p(i)) S e at theta = l:   V_l' <= -alpha_l V_l,   alpha_l >= 0

with a Lyapunov function for each of the two gains l (`convergence`). A switch multiplies eps by powers of the gains'
ratio: with eps_high = D eps_low, D = diag((low/high)^p(i)), V grows by at most the factor `up` at a switch to the high
gain, and by `down` at a switch back,

    up P_low - D P_high D >= 0,   down P_high - D^-1 P_low D^-1 >= 0

With at least a time T in the high gain between two switches down, V shrinks from cycle to cycle by a factor below 1 if

    alpha_high T > log(up down)

whatever makes the gains switch, and the error converges exponentially. Average dwell time: Hespanha, Morse, "Stability
of switched systems with average dwell-time", CDC 1999.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import product
from math import inf
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, fmpq_mat

from hgogen.analysis.evidence import LOOSE, Evidence, Grounds, Steep
from hgogen.analysis.ranges import chains
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.gains import as_matrix
from hgogen.estimators.integrators import Integrators, companion
from hgogen.form import Form
from hgogen.prove.convergence import DecayProof, Flow, GainVariation, convergence_checks, unknown_checks
from hgogen.prove.error_models import companions, on_integrators, plain, slope
from hgogen.prove.inclusion import Facts, Inclusion, Nothing
from hgogen.prove.quadratic import Array, floats, identity, inverse_root, rational
from hgogen.prove.questions import Driven, L2Bound, l2_bound
from hgogen.prove.semidefinite import NoSolver, lyapunov
from hgogen.reading.given import BadGain, reals
from hgogen.rigor import definite
from hgogen.rigor.bounds import Proof, bound
from hgogen.rigor.definite import (
    Matrix,
    exact,
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
from hgogen.rigor.tape import NoTape
from hgogen.sentence import NONE, Down, Reason, Up, because, down, same, up

_SLACKS = tuple(Fraction(1, 2**k) for k in range(40, 4, -4))  # increases of s, for rounding in (87)


@dataclass(frozen=True, eq=False)
class VaryingGain:
    """An observer on a chain of integrators whose gain gamma varies in [`low`, `high`] with gamma' >= -`sigma` gamma^2,
    under a disturbance v: w' = .. + G_1 v, y = w_1 + G_2 v. `error`: its error dynamics at a constant gamma; `plant`:
    G_1 (n, m); `measurement`: G_2 (m)."""

    error: Inclusion
    low: Fraction
    high: Fraction
    sigma: Fraction
    plant: Matrix
    measurement: tuple[Fraction, ...]

    def attenuation(self, P: Matrix) -> L2Bound | None:
        """Return a proved bound of the L2 gain from the disturbance v to the error of w, by one Lyapunov function close
        to e'`P` e for every permitted gamma(t); None where none is proved, or no solver is installed."""
        try:
            return l2_bound([*self._systems()], inverse_root(floats(rational(P))), self._powers)
        except NoSolver:
            return None

    @property
    def _powers(self) -> Array:
        """The matrix D = diag(1, .., n): e_i is the error of w_i over gamma^i."""
        return np.asarray(identity(len(self.plant)) * rational([p + 1 for p in self.error.layout.power]))

    def _systems(self) -> Iterator[Driven]:
        """Yield the error dynamics at both ends of gamma, and at both
        ends of each gamma^-i for which row i of G_1 is not 0."""
        e, units, D, one = self.error.at(self.low), rational(self.error.units), self._powers, identity(len(self.plant))
        falling = e.core * (1 / number(self.low)) + D * number(self.sigma)
        noise = e.driven_by(rational([self.measurement]) / number(self.low))
        nonzero = [any(row) for row in self.plant]
        ends = [(self.low**-p, self.high**-p) if driven else (self.low**-p,) for p, driven in enumerate(nonzero, 1)]
        for gamma, powers in product((self.low, self.high), product(*ends)):
            M = falling * number(gamma) + (e.M - e.core)
            pushed = rational(self.plant) * (units * rational(powers))[:, None]
            counted = one * (rational([gamma**p for p in range(1, len(ends) + 1)]) / units)
            yield Driven(replace(noise, M=M, B=noise.B - pushed), counted)


@dataclass(frozen=True)
class Candidate:
    """A gain K (n), a symmetric P (n, n) and sigma >= 0 that are to satisfy the inequality (A - K C)'P + P (A - K C) +
    sigma (D P + P D) < 0 (54 of Alessandri 2020), A and C a chain of integrators, D = diag(b, .., b + n - 1)."""

    K: tuple[Fraction, ...]
    P: Matrix
    sigma: Fraction
    b: Fraction = Fraction(1)

    @property
    def n(self) -> int:
        """The number n of integrators."""
        return len(self.K)

    def evidence(self, form: Form) -> Evidence:
        """Return P under the key "P" of a certificate."""
        return {"P": self.P}

    @cached_property
    def shrink(self) -> Any:
        """The matrix D P + P D, in FLINT's rationals."""
        rows = enumerate(self.P)
        return fmpq_mat([[number(value * (2 * self.b + i + j)) for j, value in enumerate(row)] for i, row in rows])

    @cached_property
    def rate(self) -> Any:
        """The matrix -(A - K C)'P - P (A - K C) - sigma (D P + P D), in FLINT's rationals."""
        P, N = exact(self.P), exact(companion(np.array(self.K)))
        return -(N.transpose() * P + P * N + self.shrink * number(self.sigma))

    @cached_property
    def decay(self) -> Fraction:
        """A lambda with a proof of `rate` >= lambda I, close to the largest; 0 or negative where no positive one
        exists."""
        return smallest(self.rate)[0]

    @cached_property
    def peak(self) -> Fraction:
        """A proved upper bound of the largest eigenvalue of P, close to it."""
        return largest(exact(self.P))[1]

    def least(self, slope: Fraction, decay: Fraction | None = None) -> Fraction:
        """Return the least sufficient gain gamma, max(1, (4 k lambda_max(P) + 1)/(2 lambda)) (88), in exact arithmetic;
        k is the Lipschitz constant `slope`, lambda = `decay`, by default the attribute of this name."""
        return max(Fraction(1), (4 * slope * self.peak + 1) / (2 * (self.decay if decay is None else decay)))


@dataclass(frozen=True)
class Disturbance:
    """The matrices of a disturbance v in w' = .. + G_1 v, y = w_1 + G_2 v, rational: `plant` G_1 (n, m), `measurement`
    G_2 (m)."""

    plant: Matrix
    measurement: tuple[Fraction, ...]

    @cached_property
    def deltas(self) -> tuple[Fraction, Fraction]:
        """The numbers delta_1 = 1 + |G_1|^2, rounded up, and delta_2 = G_2 (I + G_1'G_1) G_2'."""
        G, g = exact(self.plant), fmpq_mat([[number(value) for value in self.measurement]])
        second = (g * (unit(len(self.measurement)) + G.transpose() * G) * g.transpose())[0, 0]
        return 1 + largest(G * G.transpose())[1], fraction(second)

    @property
    def reason(self) -> Reason:
        """The text of both matrices, for messages."""
        rows = [because("{row: }", row=map(float, row)) for row in self.plant]
        return because("G_1 = [{rows:; }], G_2 = [{row: }]", rows=rows, row=map(float, self.measurement))

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class Assumptions:
    """The assumptions of a proof about a varying gain gamma in [`low`, `high`]. `slope`: a Lipschitz constant k >=
    |T^-1 dc/dw T|, T = diag(gamma, .., gamma^n), for all gamma >= `low`, with its proof `steep`; None where it is not
    known, for the `reason`; `disturbance`, or None; `moving`: the error under this disturbance where the partial
    derivatives of b have ranges, else None."""

    low: Fraction
    high: Fraction
    slope: Fraction | None
    reason: Reason = NONE
    disturbance: Disturbance | None = None
    steep: Steep | None = None
    moving: VaryingGain | None = None


@dataclass(frozen=True)
class Attenuating:
    """The evidence of an L2 gain mu from a disturbance to the error, for a `candidate` K, P, sigma under the
    `assumptions`."""

    candidate: Candidate
    assumptions: Assumptions

    def evidence(self, form: Form) -> Evidence | None:
        """Return P, lambda_max(P), k, the disturbance, s of (87) and mu, under the keys of a certificate; None where
        one of them has no proof. s and mu belong to the k of the certificate, which is slightly above the proved
        one."""
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
    """Return the `Candidate` of K (n), P (n, n) and sigma as exact rationals; P is replaced by (P + P')/2 if it is
    symmetric up to rounding. Raises: `BadGain` for other shapes, for a P that is not symmetric, for sigma < 0, and for
    numbers that are not finite."""
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
    """Return the `Disturbance` of a `pair` (G_1 (n, m), G_2 (m)) as rationals. Raises: `BadGain` for other shapes."""
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
    """Return a proved Lipschitz constant k >= |T^-1 dc/dw T|, T = diag(g, .., g^n), on the declared ranges for all g >=
    `gamma`, c the nonlinear part in the coordinates w of integrators; or the reason why there is none."""
    units = tuple(Fraction(gamma) ** -(i + 1) for i in range(chain.n))
    (a,) = chains(chain.form)
    scale = tuple(sp.Rational(x) * sp.Mul(*a[: i + 1]) for i, x in enumerate(units))
    bound = slope(chain.form, scale)
    return bound if isinstance(bound, Nothing) else Steep(units, scale, bound, LOOSE)


def attenuation(candidate: Candidate, decay: Fraction, alpha_1: Fraction, alpha_2: Fraction) -> Any:
    """Return the matrix [rate - lambda I, -P, -P K; -P, alpha_1 I, 0; -K'P, 0, alpha_2], lambda = `decay`, in FLINT's
    rationals: it is >= 0 exactly where (87) holds, which bounds the L2 gain."""
    n, P = candidate.n, rational(candidate.P)
    M = np.array((candidate.rate - unit(n) * number(decay)).tolist(), dtype=object)
    Y, last = P @ rational(candidate.K)[:, None], rational([[alpha_2]])
    one, zero = identity(n) * number(alpha_1), 0 * P[:, :1]
    return fmpq_mat(np.block([[M, -P, -Y], [-P, one, zero], [-Y.T, zero.T, last]]).tolist())


def candidate_checks(maker: str, candidate: Candidate, decay: Fraction | None = None) -> tuple[Check, Check, Check]:
    """Return the checks of a candidate's three inequalities: `MAKER.definite`, P > 0; `MAKER.shrink`, D P + P D >= 0;
    `MAKER.decay`, (54) with lambda = `decay`, by default any lambda > 0. `maker`: the observer's name."""
    more = "" if decay is None else f" + {float(decay):g} I"
    rate = candidate.rate if decay is None else candidate.rate - unit(candidate.n) * number(decay)
    return (
        definiteness_check(ClaimId(maker, "definite"), "P > 0", exact(candidate.P)),
        definiteness_check(
            ClaimId(maker, "shrink"), "D P + P D >= 0, D = diag(1, .., n)", candidate.shrink, strict=False
        ),
        definiteness_check(
            ClaimId(maker, "decay"),
            f"(A - K C)'P + P (A - K C) + {float(candidate.sigma):g} (D P + P D){more} < 0",
            rate,
            sign=-1,
        ),
    )


def definiteness_check(id: ClaimId, claim: str, M: Any, strict: bool = True, sign: int = 1) -> Check:
    """Return the check, decided exactly, that a symmetric matrix M is > 0, or >= 0 if not `strict`, with its smallest
    eigenvalue. `claim`: the text of the claim, which is about M for `sign` 1, about -M for `sign` -1."""
    holds, (low, high) = (positive if strict else nonnegative)(M), smallest(M)
    extreme, value = "smallest" if sign > 0 else "largest", sign * (low if holds else high)
    side = (("at most", "at least") if holds else ("above", "below"))[sign > 0]
    bound = Down(value) if holds is (sign > 0) else Up(value)
    pattern = "the {extreme} eigenvalue is {side} {bound}, in exact arithmetic"
    reason = because(pattern, extreme=extreme, side=side, bound=bound)
    if holds:
        return Check(id, claim, Verdict.PROVED, reason)
    witness = {"eigenvalue": float(value)}
    return Check(id, claim, Verdict.REFUTED, reason, witness=witness, fix="Take them of hgogen.design.")


def adaptive_checks(maker: str, candidate: Candidate, assumptions: Assumptions) -> tuple[Check, ...]:
    """Return the checks of `candidate_checks`, and for a disturbance also `MAKER.attenuation`, that the L2 gain from
    the disturbance to the error is bounded. `maker`: the observer's name."""
    known, disturbed, moving = candidate_checks(maker, candidate), assumptions.disturbance, assumptions.moving
    built = numbers(candidate, assumptions)
    checks = [replace(check, proofs=(Grounds(built, candidate),)) for check in known]
    if disturbed is None:
        return tuple(checks)
    id = ClaimId(maker, "attenuation")
    claim = "in continuous time, the L2 gain from v in w' + G_1 v, y + G_2 v to the error of w has a bound"
    sound = all(check.verdict is Verdict.PROVED for check in known)
    lost = because("P proves nothing") if not sound else NONE if assumptions.slope is not None else assumptions.reason
    one = None if lost or moving is None else moving.attenuation(candidate.P)
    fact: Facts | Attenuating = Attenuating(candidate, assumptions)
    mu: Up | None
    if moving and one:
        facts_of_V = {"G_1": moving.plant, "G_2": moving.measurement, "V": one.weights.P, "S": one.weights.S}
        mu, fact = Up(one.mu, 3), Facts(moving.error, {**facts_of_V, "mu": one.mu})
    else:
        mu = None if lost or (paper := gain(candidate, assumptions)) is None else Up(paper)
    if mu is not None:
        pattern = (
            "mu <= {mu}, in the coordinates of integrators, while the estimate keeps to its outer box; {disturbance}"
        )
        check = Check(id, claim, Verdict.PROVED, because(pattern, mu=mu, disturbance=disturbed.reason))
    elif lost:
        check = Check(id, claim, Verdict.UNKNOWN, lost)
    else:
        least = Up(candidate.least(assumptions.slope or Fraction(0)))
        low = because("not shown: (70) asks for gamma_inf above {least} at least", least=least)
        check = Check(id, claim, Verdict.UNKNOWN, low, fix="Raise gamma_inf.")
    return (*checks, replace(check, proofs=(Grounds(built, fact),)))


def numbers(candidate: Candidate, assumptions: Assumptions) -> dict[str, Any]:
    """Return the observer's arguments for a certificate, by name: the range of gamma, sigma and the gains K."""
    return {"gamma": (assumptions.low, assumptions.high), "sigma": candidate.sigma, "gains": candidate.K}


def gain(candidate: Candidate, assumptions: Assumptions) -> Fraction | None:
    """Return a proved bound mu = sqrt(2 s) high^n of the L2 gain from the disturbance to the error, by the inequality
    (87) of Alessandri (2020) with a small s; None where its (70) or (87) does not hold."""
    share = assumed_share(candidate, assumptions)
    return None if share is None else root(2 * share, bits=52) * assumptions.high**candidate.n


def assumed_share(candidate: Candidate, assumptions: Assumptions) -> Fraction | None:
    """Return the s of `share_of` for lambda = (4 k lambda_max(P) + 1)/(2 low) (70); None without a Lipschitz constant k
    or a disturbance, or where `share_of` is None."""
    if assumptions.slope is None or assumptions.disturbance is None:
        return None
    decay = (4 * assumptions.slope * candidate.peak + 1) / (2 * assumptions.low)
    return share_of(candidate, decay, assumptions.disturbance)


def share_of(candidate: Candidate, decay: Fraction, disturbance: Disturbance) -> Fraction | None:
    """Return a small s for which the inequality (87) of Alessandri (2020) is proved with delta_i alpha_i = s, for
    lambda = `decay`: rate - lambda I - (delta_1 P P + delta_2 P K K'P)/s >= 0; None where there is none."""
    M = candidate.rate - unit(candidate.n) * number(decay)
    if not positive(M):
        return None
    first, second = disturbance.deltas
    P = exact(candidate.P)
    Y = P * fmpq_mat([[number(value)] for value in candidate.K])
    load = P * P * number(first) + Y * Y.transpose() * number(second)
    try:
        factor = np.linalg.inv(np.linalg.cholesky(definite.floats(M)))
    except np.linalg.LinAlgError:  # positive definite, but not in floats
        return None
    least = Fraction(float(np.linalg.eigvalsh(factor @ definite.floats(load) @ factor.T).max()))
    tried = (least * (1 + slack) for slack in _SLACKS)
    return next((s for s in tried if s > 0 and nonnegative(M - load * (1 / number(s)))), None)


_DEFAULT_B = Fraction(1, 4)  # b of D: nearly the best one for two to four states


@dataclass(frozen=True)
class Law:
    """The bounds of a time-varying gain l >= `least` and its rate: l'/l^2 >= -`fall`; if `easing`, the stronger l'/l^2
    >= -fall (1 - least/l). `name`: that of the least value in claims; `b`: that of D = diag(b, b + 1, ..); `P` (n, n):
    the first candidate, for errors of w, or None."""

    name: str
    least: float
    fall: Fraction
    easing: bool
    b: Fraction
    P: np.ndarray | None = None


def varying_gain_checks(
    maker: str, chain: Integrators, K: Sequence[Fraction], law: Law, numbers: dict[str, Any]
) -> tuple[Check, Check]:
    """Return the checks of convergence for every gain that the `law` permits: `MAKER.convergence`, that errors converge
    if the least value of the gain is above some bound, and `MAKER.theta`, that it is above this bound. `maker`: the
    observer's name; `K` (n): its gains on the `chain`; `numbers`: its arguments for a certificate."""
    form = chain.form
    error = on_integrators(chain, plain(form), companions(K, form.blocks), as_matrix(form, K), numbers)
    if isinstance(error, Nothing):
        return _named(law, unknown_checks(maker, law.least, error.reason))
    first, units = law.P, floats(rational([error.units]))[0]
    if first is not None:  # in the errors of the inclusion, if it is positive definite
        first = None if np.linalg.eigvalsh(first).min() <= 0 else np.asarray(first / np.outer(units, units))
    flows = list[Flow]()
    for b in (_DEFAULT_B, law.b):
        D = rational(np.diag([b + p for p in error.layout.power]))
        fall = D * number(law.fall)
        variation = GainVariation(0 * D, (error.N + fall,), (-D,)) if law.easing else GainVariation(fall, (), (-D,))
        extended = replace(error, core_evidence={**error.core_evidence, "b": b})
        flows.append(Flow(extended, Fraction(law.least), "one norm at every rate of the gain", variation, first))
    try:
        flow = next((flow for flow in flows if flow.least is not None), flows[0])
    except OverflowError:  # the claims report it
        flow = flows[0]
    return _named(law, convergence_checks(maker, form, flow, numbers, law.name))


def _named(law: Law, checks: tuple[Check, Check]) -> tuple[Check, Check]:
    convergence, above = checks
    name, value = law.name, same(law.least)
    exists = f"in continuous time, without noise, the error converges exponentially for every {name} above a bound"
    return (
        replace(convergence, claim=f"{exists}, at every rate of the gain that its law permits"),
        replace(above, claim=f"{name} = {value} is above that bound"),
    )


def proved_above(checks: Sequence[Check], maker: str) -> bool:
    """Return whether the check `MAKER.theta`, that the least value of the gain is above its bound, is proved among the
    `checks`."""
    return any(check.id == ClaimId(maker, "theta") and check.verdict is Verdict.PROVED for check in checks)


BOXES = 500  # enough for sup Gamma, which need not be tight


def update_checks(
    chain: Integrators, K: np.ndarray, b: float, p_1: float, p_2: float, p_3: float, cap: float
) -> tuple[Check, ...]:
    """Return the checks of the observer `updated_gain`, whose gain obeys L' = L (p_1 (p_2 - L) + p_3 Gamma):
    `updated_gain.p_1`, `.p_3` and `.cap`, and those of `varying_gain_checks` about p_2. `K` (n): gains on the `chain`;
    `b`: that of D = diag(b, b + 1, ..). Raises: `BadGain` where D P + P D is not positive definite for the P of N'P + P
    N <= -I, N = A - K C."""
    gains = tuple(map(Fraction, K.tolist()))
    proof = lyapunov(tuple(map(tuple, companion(np.array(gains)))))
    assert proof is not None  # N is Hurwitz
    one = Candidate(gains, proof.P, Fraction(p_1), Fraction(b))
    if not positive(one.shrink):
        pencil = np.linalg.solve(definite.floats(exact(one.P)), definite.floats(replace(one, b=Fraction(0)).shrink))
        least = -np.linalg.eigvals(pencil).real.min() / 2
        fix = f"take b = {up(1.01 * float(least))} or more"
        raise BadGain(f"b = {b:g}", f"leaves D P + P D not positive definite; {fix}")
    numbers = {"p_1": p_1, "p_2": p_2, "p_3": p_3, "cap": cap, "gains": K}
    weighted_by = {"P": one.P, "b": one.b}
    fall, rise = Facts(None, weighted_by), Facts(None, {**weighted_by, "peak": proof.peak})
    stay = _cap_check(chain, p_1, p_2, p_3, cap)
    each = ((_fall_check(one), fall), (_rise_check(one, proof.peak, p_3), rise), (stay, *stay.proofs))
    known = (replace(check, proofs=tuple(Grounds(numbers, fact) for fact in facts)) for check, *facts in each)
    law = Law("p_2", p_2, one.sigma, easing=True, b=one.b)
    return (*known, *varying_gain_checks("updated_gain", chain, gains, law, numbers))


def _fall_check(one: Candidate) -> Check:
    """Return the check N'P + P N + p_1 (D P + P D) < 0, p_1 the sigma of the candidate `one`."""
    gap, spread = definite.floats(replace(one, sigma=Fraction(0)).rate), definite.floats(one.shrink)
    most = 1 / np.linalg.eigvals(np.linalg.solve(gap, spread)).real.max()
    claim, fix = "p_1 is small enough: N'P + P N + p_1 (D P + P D) < 0", f"Take p_1 <= {down(0.99 * float(most))}."
    return _positive("p_1", claim, one.rate, one.b, "not {about}; another P or b may do", fix)


def _rise_check(one: Candidate, peak: Fraction, p_3: float) -> Check:
    """Return the check p_3 (D P + P D) >= 2 lambda_max(P), P of the candidate `one`, lambda_max(P) <= `peak`."""
    least = 2 * float(peak) / np.linalg.eigvalsh(definite.floats(one.shrink))[0]
    claim, fix = "p_3 is large enough: p_3 (D P + P D) >= 2 lambda_max(P)", f"Take p_3 >= {up(1.01 * float(least))}."
    room = one.shrink * number(Fraction(p_3)) - unit(one.n) * number(2 * peak)
    pattern = "not {about}; another P or b may do, or a gain that stays far above Gamma"
    return _positive("p_3", claim, room, one.b, pattern, fix)


def _positive(fact: str, claim: str, M: Any, b: Fraction, pattern: str, fix: str) -> Check:
    about = because("for the P of N'P + P N = -I and D = diag(b, .., b + n - 1), b = {b}", b=float(b))
    id = ClaimId("updated_gain", fact)
    if positive(M):
        return Check(id, claim, Verdict.PROVED, because("in rational arithmetic, {about}", about=about))
    return Check(id, claim, Verdict.UNKNOWN, because(pattern, about=about), fix=fix)


def _cap_check(chain: Integrators, p_1: float, p_2: float, p_3: float, cap: float) -> Check:
    """Return the check p_1 (p_2 - cap) + p_3 sup Gamma(cap) < 0, by which L' < 0 at the upper limit L = `cap` of the
    gain; Gamma is evaluated at an estimate clamped to the declared ranges."""
    id, claim = (
        ClaimId("updated_gain", "cap"),
        "in continuous time L' < 0 at the cap: p_2 + (p_3/p_1) sup Gamma(cap) < cap",
    )
    form, n = chain.form, chain.n
    unknown = Check(id, claim, Verdict.UNKNOWN, NONE, fix="Raise cap, or watch the status GAIN_LIMITED.")
    if form.behind is not None:
        not_sought = because("c is taken at Psi(z), in the plant's ranges: no bound of its slope was sought there")
        return replace(unknown, reason=not_sought)
    units = tuple(Fraction(cap) ** -(i + 1) for i in range(n))
    scale = tuple(product * sp.Rational(s) for product, s in zip(chain.products, units, strict=True))
    slopes = (scale[i] * form.b[i].diff(form.states[j]) / scale[j] for i in range(n) for j in range(n))
    around = form.box
    try:
        squares = bound(sp.Add(*(slope**2 for slope in slopes)), around, boxes=BOXES)
    except NoTape as missing:
        return replace(unknown, reason=because("{what} may jump or be singular", what=missing.what))
    if not (squares.defined and math.isfinite(squares.high)):
        return replace(unknown, reason=because("no bound of Gamma was found"))
    above = Fraction(p_1) * (Fraction(cap) - Fraction(p_2)) / Fraction(p_3)
    gamma = Up(math.sqrt(max(squares.high, 0.0)) * (1 + 1e-12))
    most = Fraction(max(squares.high, 0.0))
    if above > 0 and above**2 > most:
        steep = Proof(form.b, None, root(most), squares.variables, squares.tree)
        reason = because("Gamma(cap) <= {gamma}, by outward-rounded intervals", gamma=gamma)
        proofs = (Steep(units, scale, steep, LOOSE),)
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=proofs)
    return replace(unknown, reason=because("Gamma(cap) may be {gamma}", gamma=gamma))


_BETWEEN = (
    "in continuous time, without noise, the error decays exponentially between switches, in every gain above a bound"
)
_ROUND = Fraction(1, 2**20)  # relative increase of `up` and `down` over their floats


@dataclass(frozen=True)
class DwellProof:
    """A proof of a dwell time for an observer that switches between a high and a low gain: V `falls` at a rate alpha in
    the high gain, and grows at most by the factors `up` and `down` when the gain switches up and down."""

    falls: DecayProof
    up: Fraction
    down: Fraction

    @property
    def least(self) -> arb:
        """The least sufficient dwell time log(up down)/alpha in the high gain, as a ball."""
        return arb(number(self.up * self.down)).log() / arb(number(self.falls.alpha))

    def evidence(self, form: Form) -> Evidence:
        """Return alpha and P of the high gain, and both factors, under the keys of a certificate; P of the low gain is
        in the evidence of the claim about theta."""
        return {"alpha": self.falls.alpha, "V": self.falls, "up": self.up, "down": self.down}


def switching_checks(
    maker: str, form: Form, theta: float, low: float, hold: float, error: Inclusion | Nothing
) -> tuple[Check, ...]:
    """Return the checks of an observer that switches between the gains `theta` and `low` < theta: `MAKER.convergence`,
    that errors converge at every constant gain above some bound; `MAKER.theta`, that the low gain is above this bound;
    `MAKER.hold`, that the dwell time `hold` (time) in the high gain is long enough. `maker`: the observer's name;
    `error`: its error dynamics."""
    claim = f"in continuous time hold = {same(hold)} is long enough: switching keeps the error's decay"
    why = because("theta_low is not above a proved bound")
    hold_check = Check(ClaimId(maker, "hold"), claim, Verdict.UNKNOWN, why, fix="Validate by trials.")
    if isinstance(error, Nothing):
        known = unknown_checks(maker, low, error.reason)
    else:
        numbers = {"theta": theta, "theta_low": low, "hold": hold, **error.numbers}
        flow = Flow(error, Fraction(low))
        known = convergence_checks(maker, form, flow, numbers, "theta_low", "between switches")
        if known[1].verdict is Verdict.PROVED:
            hold_check = _dwell(hold_check, flow, Fraction(theta), hold)
        hold_check = replace(hold_check, proofs=tuple(Grounds(numbers, proof) for proof in hold_check.proofs))
    convergence, above = known
    convergence = replace(convergence, claim=_BETWEEN)
    above = replace(above, claim=f"theta_low = {same(low)}, and theta with it, is above that bound")
    return convergence, above, hold_check


def _dwell(unknown: Check, flow: Flow, theta: Fraction, hold: float) -> Check:
    low = flow.fastest
    if low is None:
        return unknown
    above, P_low, ways = Flow(flow.error, theta), rational(low.weights.P), list[DwellProof]()
    # by the fastest P of the high gain, and by that of the low gain, which switches change less
    for high in (above.fastest, above.by(low.weights, low.alpha * theta / flow.theta)):
        if high is not None and high.alpha > 0:
            P_high = rational(high.weights.P)
            D = rational([(low.theta / high.theta) ** p for p in flow.error.layout.power])
            up, down = _factor(P_low, P_high * np.outer(D, D)), _factor(P_high, P_low / np.outer(D, D))
            ways.append(DwellProof(high, up, down))
    if not ways:
        return replace(unknown, reason=because("no norm is found that falls in the high gain"))
    best = min(ways, key=lambda way: float(way.least.mid()))
    if arb(number(Fraction(hold))) > best.least:
        reason = because("above {least}, by outward-rounded balls", least=_up(best.least, hold))
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=(best,))
    reason = because("not shown: {least} is, and is sufficient, not necessary", least=_up(best.least))
    return replace(unknown, reason=reason, fix=f"Take hold > {_up(best.least)}, or validate by trials.")


def _factor(P: Array, Q: Array) -> Fraction:
    """Return a short rational c, near the least, with c P - Q >= 0, for P, Q > 0."""
    half = np.linalg.inv(np.linalg.cholesky(floats(P)))
    c = Fraction(f"{np.linalg.eigvalsh(half @ floats(Q) @ half.T).max() * (1 + _ROUND):.9g}")
    while not nonnegative(fmpq_mat((P * number(c) - Q).tolist())):
        c *= 1 + _ROUND
    return c


def _up(value: arb, below: float = inf) -> Up:
    return Up(float(value.upper()) * (1 + 1e-12), below=below)
