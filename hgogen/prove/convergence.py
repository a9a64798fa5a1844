"""The convergence of an observer's error in continuous time: one quadratic Lyapunov function for all partial
derivatives of b in their ranges, at one gain theta or at every theta above a bound.

    V = e'P e,   V' <= -alpha V:   M'P + P M + alpha P < 0   for every M = M_0 + G diag(d) H, |d_j| <= 1

M is affine in each slope d_j, so it is enough to check the corners, 2^m for m slopes. For too many slopes one form has
a multiplier S_j >= 0 for each:

    [M_0'P + P M_0 + alpha P + H'S H, P G; G'P, -S] < 0

A P that is valid for a theta at the corners is valid for every larger one: M/theta is N plus the slopes over
theta^(degree + 1), and the ranges of those with a degree above -1 hold 0 and shrink. The form implies the corners.

The search for theta or for the rate runs in floats: as far as known weights reach, then with new ones from there. Its
end is proved. A solver finds P and S, rationals prove them. Without a solver, or for more rows than it can handle, P is
the first one given, or that of large theta, N'P + P N = -I with each slope in N at its middle. It may also be valid,
from a larger theta on.

Slopes of one sign may be unbounded:

    e' = M e + G p - sum_k s_k onto_k q_k,   q_k = d_k reads_k e,   d_k >= 0 of any size,   V = e'P e

A slope of at most h, with no lower bound, is h less a d >= 0 (s = 1). One of at least h is h plus a d >= 0 (s = -1). M
contains h. With

    P onto_k = s_k lambda_k reads_k',   lambda_k >= 0,

V' gets the term -2 lambda_k (reads_k e)^2 d_k, however large d_k is: if V decreases without the d, it does with them.
Such a P exists for a slope in the last of two states of a chain, with N between 0 and a bound, or in its only state. In
longer chains the response from the slope to what b reads is not strictly positive real. P satisfies these equations
exactly: it is a sum of rational matrices that do. A solver finds the coefficients, which are rounded, and rationals
prove the rest as above. reads_k = 0 adds no equation. An h of a degree above -1 has the sign with which the set of
slopes shrinks as theta grows, so that a P for a theta is valid for larger ones. Source: Arcak, Kokotovic, "Nonlinear
observers: a circle criterion design and robustness analysis", Automatica 37 (2001), theorem 1.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from flint import fmpq, fmpq_mat

from hgogen.analysis.evidence import Evidence, Grounds
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.prove.inclusion import Inclusion, Slope, Uncertain
from hgogen.prove.inequality import NOW, bisect_towards, corners, decrease_forms, flow
from hgogen.prove.quadratic import (
    Array,
    Quadratic,
    Weights,
    floats,
    inverse_root,
    largest_blend,
    negative,
    on_grid,
    proved,
    rational,
    verified,
)
from hgogen.prove.semidefinite import Margin, NoSolver, largest_margin, margin, no_solver
from hgogen.rigor import outward
from hgogen.rigor.definite import number
from hgogen.sentence import NONE, Down, Reason, Up, because, point, same, up

EXISTS = "in continuous time, without noise, the error converges exponentially for every theta above a bound"


def theta_claim(theta: float) -> str:
    """Return the text of the claim that the observer's gain `theta` is above the bound from which on errors are proved
    to converge."""
    return f"theta = {same(theta)} is above that bound"


def unknown_checks(maker: str, theta: float, why: Reason) -> tuple[Check, Check]:
    """Return the two checks `MAKER.convergence` and `MAKER.theta` of an observer with the verdict unknown. `maker`: the
    observer's name; `theta`: its gain; `why`: the reason why there is no proof."""
    none, fix = because("no bound is proved"), "Validate by trials."
    return (
        Check(ClaimId(maker, "convergence"), EXISTS, Verdict.UNKNOWN, why, fix=fix),
        Check(ClaimId(maker, "theta"), theta_claim(theta), Verdict.UNKNOWN, none, fix=fix),
    )


def decay_sentence(rate: float, during: str = "") -> Reason:
    """Return the sentence that the error decays at least like exp(-`rate` t), `rate` in 1/time; `during` is a
    restriction at its beginning, such as "between switches"."""
    pattern = "the error decays at least like exp(-{rate} t) while the estimate keeps to its outer box"
    decay = because(pattern, rate=Down(rate, 2))
    return because("{during} {decay}", during=during, decay=decay) if during else decay


ROWS = 48  # of one form with multipliers: above, a solver is too slow for a check
_WHAT = "one norm for all slopes"
LOWEST = Fraction(1, 100)  # the smallest theta of a search
FACTOR, TIMES = 4, 24  # factor and number of increases of theta until a P is found
_STEP, _ROUNDS = 1.1, 8  # the least step with new weights, and the number of steps
CLOSE = 1.003  # ratio of the ends of a search with known weights at which it stops
SLOW = Fraction(1, 2**12)  # first rate of a search, over its upper bound
SHARES = tuple(Fraction(k, 200) for k in (200, 199, 190, 100, 0))  # of a rate found in floats, for proofs
_BEYOND = tuple(Fraction(k, 1000) for k in (1000, 1001, 1010, 1050))  # of a theta found in floats, for proofs
_BELOW = tuple(1 - Fraction(1, 2**k) for k in (10, 20, 30))  # of a theta, for proofs just below it
_JOIN = 2  # forms that join the binding ones at a time
_NARROWER = Fraction(99, 100)
_THETAS = 16  # number of thetas whose systems are cached

Pair = tuple[Array, Array]  # P and S, in floats


@dataclass(frozen=True)
class DecayProof:
    """A proof that the Lyapunov function V = e'P e of the error e satisfies V' <= -`alpha` V at the gain `theta`, for
    all partial derivatives of b in their ranges. `weights`: P, and the multipliers S of the uncertain derivatives; S is
    empty where every corner of the ranges is checked. `others`: further parameters of V, by name."""

    theta: Fraction
    alpha: Fraction
    weights: Weights
    others: Evidence = field(default_factory=dict, hash=False)

    @property
    def rate(self) -> float:
        """The rate r = alpha/2 (1/time) with |e|_P <= exp(-r t) |e(0)|_P, rounded down."""
        return outward.number(self.alpha / 2)[0]

    def evidence(self, form: Form) -> Evidence:
        """Return P, the other parameters of V, and S where there are multipliers, under the keys of a certificate."""
        return {"P": self.weights.P, **self.others} | ({"S": self.weights.S} if self.weights.S else {})


@dataclass(frozen=True, eq=False)
class GainVariation:
    """The additional conditions on V = e'P e for an observer whose gain varies with time, as matrices (N, N) in FLINT's
    rationals. `shift` is added to M/theta in e' = M e; V must also decrease along e' = theta C e for each C of the
    `cores`, and not increase along e' = theta W e for each W of the `ways`."""

    shift: Array
    cores: tuple[Array, ...] = ()
    ways: tuple[Array, ...] = ()

    def forms(
        self, e: Uncertain, theta: Fraction, alpha: Any, hull: Sequence[Sequence[Fraction]]
    ) -> Iterator[Quadratic]:
        """Yield the quadratic forms that have to be negative to prove V' <= -alpha V for the error system e at this
        `theta`, for all variations of the gain. `hull` (k, m): points whose convex hull contains the uncertain slopes;
        () for independent slopes."""
        known = floats if e.M.dtype == float else np.asarray
        shifted = decrease_forms(replace(e, M=e.M + known(self.shift * number(theta))), alpha, hull)
        yield from shifted
        k = shifted[0].size - len(e.M)
        still = replace(e, G=0 * e.G[:, :k], H=0 * e.H[:k])
        for core in self.cores:
            yield flow(replace(still, M=known(core * number(theta)))).falls(alpha)
        for way in self.ways:
            yield flow(replace(still, M=known(way * number(theta)))).falls(NOW)


STILL = GainVariation(rational([[0]]))  # for a constant gain


@dataclass(frozen=True)
class Flow:
    """The search for a quadratic Lyapunov function V = e'P e of an observer's `error` in continuous time, valid for all
    partial derivatives of b in their ranges: at the declared gain `theta`, and at the smallest possible one.

    `how`: the name of V in claims; `variation`: how the gain varies with time; `first` (n, n): a P > 0 in floats, the
    first candidate. A subclass for another kind of V defines its weights at a theta and an alpha (`_weights`), the
    other thetas and alphas for which these are valid (`_thetas`, `_alphas`), and its proof (`at`).
    """

    error: Inclusion
    theta: Fraction
    how: str = "one norm"
    variation: GainVariation = STILL
    first: Array | None = None
    # ratio of the ends at which a search for weights stops: for theta, for a rate
    close: ClassVar[tuple[float, float]] = (1.02, 1.1)

    @cached_property
    def fastest(self) -> DecayProof | None:
        """A proof of V' <= -alpha V at the declared theta, with alpha close to the largest possible; None where the
        search has no result."""
        theta, weights = self.theta, self._weights_at_theta
        if weights is None:
            return None
        most, alpha = self._most, Fraction(0)
        if self._alphas(weights)(most * SLOW):
            ends = most * SLOW, most
            alpha = _reached(*ends, weights, self._alphas, lambda a: self._weights(theta, a), self.close[1])
        tried = (self.at(theta, alpha * share) for share in SHARES)
        return next(filter(None, tried), None)

    @cached_property
    def least(self) -> DecayProof | None:
        """A proof that V decreases at a theta close to the smallest possible one: below the declared theta if V
        decreases there, else above it; None where the search has no result."""
        thetas = (self.theta * FACTOR**k for k in range(1, TIMES))
        later = ((theta, weights) for theta in thetas if (weights := self._weights(theta)) is not None)
        first = (self.theta, self._weights_at_theta) if self._weights_at_theta is not None else next(later, None)
        if first is None:
            return None
        theta, weights = first
        lowest = self.theta if theta > self.theta else min(LOWEST, theta / 2)
        end = bisect_towards(lambda at: self._slowest(at)[0] < 0, theta, lowest, CLOSE)
        last = _reached(theta, end, weights, self._thetas, self._weights, self.close[0])
        tried = [Fraction(up(last * share, 3)) for share in _BEYOND] + [theta * share for share in _BELOW] + [theta]
        return next(filter(None, (self.at(one) for one in tried if theta > self.theta or one < theta)), None)

    @property
    def _most(self) -> Fraction:
        """An upper bound of every alpha with V' <= -alpha V at
        theta: -2 times the largest real part of an eigenvalue."""
        return Fraction(-2 * self.slowest[0])

    def unstable(self, states: Sequence[Any]) -> Reason:
        """Return a reason that names constant values of the partial derivatives of b with which the error does not
        decay at the declared theta; `NONE` where no tried corner of the ranges has this property. `states`: the symbols
        of the z_j in this text."""
        speed, d = self.slowest
        if speed < 0:
            return NONE
        return because(
            "with {slopes}, held there, errors do not decay", slopes=point(self.error.slope_values(states, d))
        )

    @cached_property
    def _weights_at_theta(self) -> Any:
        """The P and S, in floats, with which V = e'P e decreases at the declared theta
        for all partial derivatives of b in their ranges; None if none are found."""
        return self._weights(self.theta) if self.slowest[0] < 0 else None

    @cached_property
    def _system(self) -> Callable[[Fraction], Uncertain]:
        """The function from theta to the error dynamics e' = M e + G diag(d) H e."""
        return lru_cache(maxsize=_THETAS)(self.error.at)

    def _slowest(self, theta: Fraction) -> tuple[float, Array]:
        """Return the largest real part of an eigenvalue of M + G
        diag(d) H over the tried corners d at a theta, and its d."""
        e = self._system(theta).floats
        d = np.array(self.error.hull, dtype=float) if self.error.hull else corners(e.G.shape[1])
        parts = np.linalg.eigvals(e.M + (e.G * d[:, None]) @ e.H).real.max(axis=1)
        return float(parts.max()), d[parts.argmax()]

    @cached_property
    def slowest(self) -> tuple[float, Array]:
        """The largest real part of an eigenvalue of M + G diag(d) H at the declared theta over the tried corners d of
        [-1, 1]^m, and its d (m)."""
        return self._slowest(self.theta)

    def _thetas(self, by: Any) -> Callable[[Fraction], bool]:
        P, S = by
        return lambda theta: negative(self._floats(theta, NOW), P, S, self._coordinates)

    def _alphas(self, by: Any) -> Callable[[Fraction], bool]:
        (P, S), theta, most = by, self.theta, self._most
        last = most * largest_blend(
            self._floats(theta, Fraction(0)), self._floats(theta, most), P, S, self._coordinates
        )
        return lambda a: a <= last

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Return the reason why there is no proof at the declared theta: constant slopes (partial derivatives of b)
        with which errors do not decay, or the slope whose range limits the proof most. `states`: the symbols of the z_j
        in this text."""
        unstable = self.unstable(states)
        if unstable:
            return unstable
        try:
            most = self._hindrance()
        except NoSolver as missing:
            return missing.reason
        if most is None or most.entry is None:
            return because("no norm is found for all slopes in their ranges")
        (i, j), low, high = most.entry, float(most.low), float(most.high)
        pattern = "no norm is found for all slopes in their ranges, db_{i}/d{z} in [{low:.3g}, {high:.3g}] hinders most"
        return because(pattern, i=i + 1, z=states[j], low=low, high=high)

    def by(self, weights: Weights, alpha: Fraction) -> DecayProof | None:
        """Return the proof that V' <= -`alpha` V at theta by the given
        P and S (`weights`), or None if they do not prove it."""
        P, S = rational(weights.P), rational(weights.S)
        forms = self._exactly(self.theta, alpha)
        return DecayProof(self.theta, alpha, weights) if verified(forms, P, S) else None

    @property
    def missing(self) -> Reason:
        """The reason why no V = e'P e is known to decrease at any theta: no solver is installed, or the linear part of
        the error has no such V."""
        return no_solver(_WHAT) or because(
            "no norm is found in which the linear part of the error falls, whatever moves in it"
        )

    def _hindrance(self) -> Slope | None:
        """Return the partial derivative of b whose range limits the proof most:
        narrowing it by 1 % raises the margin of the matrix inequalities most."""
        forms = self._floats(self.theta, Fraction(0))
        best = largest_margin(forms, _WHAT, self._coordinates, priced=True) if forms[0].size <= ROWS else None
        if best is None:
            return None
        values, gains = [form.value(best.P, best.S) for form in forms], dict[Slope, float]()
        for k, slope in enumerate(self.error.slopes):
            if slope.entry is None or slope.low == slope.high:
                continue
            less = replace(slope, low=slope.low * _NARROWER, high=slope.high * _NARROWER)
            slopes = (*self.error.slopes[:k], less, *self.error.slopes[k + 1 :])
            others = replace(self, error=replace(self.error, slopes=slopes))._floats(self.theta, Fraction(0))
            changes = (form.value(best.P, best.S) - value for form, value in zip(others, values, strict=True))
            gains[slope] = sum(float((price * by).sum()) for price, by in zip(best.prices, changes, strict=True))
        return min(gains, key=gains.__getitem__, default=None)

    def at(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> DecayProof | None:
        """Return a proof of V' <= -alpha V at the gain theta; None where the search has no result."""
        weights = self._weights(theta, alpha)
        known = weights and self._proved(self._exactly(theta, alpha), *weights)
        return DecayProof(theta, alpha, known) if known else None

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        return proved(forms, P, S)

    def _weights(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Any:
        """Return P and S, in floats, with which V' <= -alpha V at a theta; None if none are found."""
        forms = self._floats(theta, alpha)
        weights = self._sought(forms)
        return weights if weights is not None and negative(forms, *weights, self._coordinates) else None

    def _sought(self, forms: tuple[Quadratic, ...]) -> Pair | None:
        if forms[0].size > ROWS:
            return self._plain(forms)
        try:
            best = self._widest(forms)
        except NoSolver:
            return self._plain(forms)
        return (best.P, best.S) if best is not None and best.margin > 0 else None

    def _widest(self, forms: tuple[Quadratic, ...]) -> Margin | None:
        """Return P and S with the largest margin of all matrix inequalities. To save
        time each program has few of them: the first and the last, then also those
        above half of the margin, until none is. The next call begins with them."""
        W, few, last = self._coordinates, self._binding, len(forms) - 1
        while True:
            few.extend({0, last} - {*few} if not few else ())
            best = largest_margin([forms[k] for k in few], _WHAT, W)
            if best is None or best.margin <= 0 or len(few) == len(forms):
                return best
            values = [form.value(best.P, best.S) for form in forms]
            if W is not None:  # in coordinates of P, without a change of the multiplied inputs
                T = np.eye(forms[0].size)
                T[: len(W), : len(W)] = W
                values = [T.T @ value @ T for value in values]
            matrices = np.array(values)
            largest = np.linalg.eigvalsh(matrices).max(axis=1)
            order = [int(k) for k in largest.argsort()[::-1] if largest[k] > -best.margin / 2 and k not in few]
            if not order:
                return best
            few.extend(order[:_JOIN])

    @cached_property
    def _binding(self) -> list[int]:
        return []

    def _plain(self, forms: tuple[Quadratic, ...]) -> Pair | None:
        """Return a P without a semidefinite solver, and the S that suits it best: `first`, scaled
        to the trace n, or else the P of the linear part; None if there is no such P."""
        first = self.first
        P = self.error.linear_lyapunov if first is None else np.asarray(first * len(first) / np.trace(first))
        if P is None:
            return None
        n = len(P)
        return P, np.linalg.norm(P @ forms[0].pairs[0][1][:, n:], axis=0)

    def _exactly(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._system(theta), theta, alpha)

    def _floats(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._system(theta).floats, theta, float(alpha))

    def _forms(self, e: Uncertain, theta: Fraction, alpha: Any) -> tuple[Quadratic, ...]:
        return tuple(self.variation.forms(e, theta, alpha, self.error.hull))

    @cached_property
    def _coordinates(self) -> Array | None:
        """The matrix P^(-1/2) of `first`, or else of the linear part:
        coordinates in which a solver's P is near the unit matrix."""
        return self.error.coordinates if self.first is None else inverse_root(self.first)


def _reached(
    start: Fraction,
    end: Fraction,
    weights: Any,
    serving: Callable[[Any], Callable[[Fraction], bool]],
    seek: Callable[[Fraction], Any],
    close: float,
) -> Fraction:
    """Return the value nearest to `end`, from `start` on, at which P and S prove
    the decrease: as far as `serving(weights)` holds, then with new weights by
    `seek`, last by bisection until the ratio of the ends is below `close`."""
    for _ in range(_ROUNDS):
        value = bisect_towards(serving(weights), start, end, CLOSE)
        better = seek(value) if not 1 / _STEP < value / start < _STEP else None
        start = value
        if better is None:
            break
        weights = better
    return bisect_towards(lambda at: seek(at) is not None, start, end, close)


_ONE_SIDED = "one norm for slopes without an end"
_MARGIN = 1e-7  # the least margin of a form in floats
_BITS = (20, 30, 44)
_NO_NORM = (
    "no norm is found that keeps to the slopes without an end: there may be one where they are in the last of two "
    "states of a chain, by an argument that is positive there, or in a state in whose place b reads the sample"
)


@dataclass(frozen=True)
class OneSided(Flow):
    """The search for a quadratic Lyapunov function V = e'P e where some slopes d_k (partial derivatives of b) are
    unbounded on one side. Such a slope adds onto_k d_k reads_k'e to e', so P must satisfy P onto_k = s_k lambda_k
    reads_k' with a lambda_k >= 0 and the sign s_k that makes this term decrease V."""

    how: str = "one norm that keeps to the signs of slopes without an end,"
    close: ClassVar[tuple[float, float]] = (CLOSE, CLOSE)

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes that are unbounded on one side and multiply an error."""
        return tuple(slope for slope in self.error.endless if any(slope.reads))

    @property
    def missing(self) -> Reason:
        """The reason why no V = e'P e is known to decrease at any theta for all slopes, including those unbounded on
        one side."""
        return no_solver(_ONE_SIDED) or because(_NO_NORM)

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Return the reason why there is no proof at the declared theta. `states` is not used."""
        return no_solver(_ONE_SIDED) or because("no norm is found for all slopes in their ranges")

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        """Return rational P and S near the given floats that prove all matrix inequalities. P is
        a sum of the basis matrices, so that P onto_k = s_k lambda_k reads_k' holds exactly."""
        rows = np.array([floats(matrix).ravel() for matrix in self._basis])
        y = np.linalg.lstsq(rows.T, P.ravel(), rcond=None)[0]
        for bits in _BITS:
            multipliers = on_grid(S, bits)
            whole = sum(
                (share * one for share, one in zip(on_grid(y, bits), self._basis, strict=True)), 0 * self._basis[0]
            )
            if all(share >= 0 for share in self._lambdas(whole)) and verified(forms, whole, multipliers):
                return Weights.of(whole, multipliers)
        return None

    @cached_property
    def _basis(self) -> tuple[Array, ...]:
        """A basis, in rationals, of the symmetric P (n, n) with P onto_k parallel to
        reads_k for every partial derivative k that is unbounded on one side."""
        n = len(self.error.N)
        units, slopes = list[Array](), self.endless
        for j in range(n):
            for i in range(j + 1):
                unit = rational(np.zeros((n, n), dtype=int).tolist())
                unit[i, j] = unit[j, i] = fmpq(1)
                units.append(unit)
        rows = []
        for k, slope in enumerate(slopes):
            onto, reads = rational(slope.onto), rational(slope.reads)
            for i in range(n):
                along = [-reads[i] if at == k else fmpq(0) for at in range(len(slopes))]
                rows.append([*((unit @ onto)[i] for unit in units), *along])
        null = _null(rows, len(units) + len(slopes))
        return tuple(sum((x * unit for x, unit in zip(row, units, strict=False)), 0 * units[0]) for row in null)

    def _lambdas(self, P: Array) -> Iterator[Any]:
        """Yield lambda_k of P onto_k = s_k lambda_k reads_k' for each partial
        derivative k that is unbounded on one side, in the arithmetic of P."""
        for slope in self.endless:
            onto, reads = rational(slope.onto), rational(slope.reads)
            onto, reads = (onto, reads) if P.dtype == object else (floats(each[None])[0] for each in (onto, reads))
            yield -slope.endless * ((P @ onto) @ reads) / (reads @ reads)

    def _sought(self, forms: Sequence[Quadratic]) -> tuple[Array, Array] | None:
        basis = [floats(matrix) for matrix in self._basis]
        if not basis or no_solver(_ONE_SIDED):
            return None
        signs = np.array([[float(share) for share in self._lambdas(matrix)] for matrix in basis]).T
        best = margin(forms, _ONE_SIDED, span=(np.array(basis), signs))
        return (best.P, best.S) if best is not None and best.margin > _MARGIN else None


def _null(rows: Sequence[Sequence[fmpq]], count: int) -> list[list[fmpq]]:
    if not rows:
        return [[fmpq(int(i == j)) for j in range(count)] for i in range(count)]
    reduced, rank = fmpq_mat([list(row) for row in rows]).rref()
    table = [[reduced[i, j] for j in range(count)] for i in range(rank)]
    leads = [next(j for j, x in enumerate(row) if x) for row in table]
    basis = []
    for free in (j for j in range(count) if j not in leads):
        row = [fmpq(int(j == free)) for j in range(count)]
        for lead, each in zip(leads, table, strict=True):
            row[lead] = -each[free]
        basis.append(row)
    return basis


@dataclass(frozen=True)
class FromTheta:
    """A proof that the `error` converges for every theta above a bound: the Lyapunov function of the proof `falls`, at
    the bound, is valid for every larger theta."""

    error: Inclusion
    falls: DecayProof

    @property
    def theta(self) -> Fraction:
        """The bound: the error converges for every larger theta."""
        return self.falls.theta

    def evidence(self, form: Form) -> Evidence:
        """Return the ranges of the partial derivatives of b, the bound on theta, and P and S at this bound, under the
        keys of a certificate."""
        return {"error": self.error, "least": self.theta, "V": self.falls}


@dataclass(frozen=True)
class AtTheta:
    """A proof at the declared theta of V' <= -alpha V, V = e'P e, with which errors decay like exp(-alpha t/2)."""

    falls: DecayProof

    def evidence(self, form: Form) -> Evidence:
        """Return alpha, P and S under the keys of a certificate; the ranges of the slopes are in
        `FromTheta.evidence`."""
        return {"alpha": self.falls.alpha, "V": self.falls}


def convergence_checks(
    maker: str, form: Form, flow: Flow, numbers: Mapping[str, Any], name: str = "theta", during: str = ""
) -> tuple[Check, Check]:
    """Return the two checks of an observer's convergence that the search `flow` proves: `MAKER.convergence`, that
    errors converge for every theta above some bound, and `MAKER.theta`, that the declared theta is above this bound.
    `maker`: the observer's name; `numbers`: its arguments, for the certificate; `name`: the name of its gain theta in
    advice; `during`: a restriction of the decay, as in `decay_sentence`."""
    theta = float(flow.theta)
    try:
        least = flow.least
        sufficient = least is not None and least.theta < flow.theta
        fastest = flow.fastest if sufficient else None
        why = NONE if sufficient else flow.missing if least is None else flow.obstacle(form.states)
    except OverflowError:
        return unknown_checks(maker, theta, because("the numbers of a proof are beyond the range of doubles"))
    if least is None:
        return unknown_checks(maker, theta, why)
    bound = Up(least.theta, 3, below=theta)
    pattern = "above {bound}, by {how} for all slopes of b; exact arithmetic and outward-rounded intervals"
    proof = because(pattern, bound=bound, how=flow.how)
    grounds = (Grounds(numbers, FromTheta(flow.error, least)),)
    convergence = Check(ClaimId(maker, "convergence"), EXISTS, Verdict.PROVED, proof, proofs=grounds)
    id, above = ClaimId(maker, "theta"), theta_claim(theta)
    if not sufficient:
        pattern = "not shown: {theta} is below the certified {bound}; {why}"
        low = because(pattern, theta=theta, bound=Up(least.theta, 3), why=why)
        fix = f"Raise {name}, narrow the ranges of the states, or validate by trials."
        return convergence, Check(id, above, Verdict.UNKNOWN, low, fix=fix)
    reason, fact = because("above {bound}", bound=bound), None
    if fastest is not None:
        decay = decay_sentence(fastest.rate, during)
        reason, fact = because("{above}; {decay}", above=reason, decay=decay), AtTheta(fastest)
    return convergence, Check(id, above, Verdict.PROVED, reason, proofs=(Grounds(numbers, fact),))
