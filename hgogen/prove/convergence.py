"""One norm in which an error falls, whatever its slopes: in continuous time, at a theta, and from which theta on.

    V = e'P e,   V' <= -alpha V:   M'P + P M + alpha P < 0   for every M = M_0 + G diag(d) H, |d_j| <= 1

M is affine in each slope d_j, so that the corners, 2^m of m slopes, stand for all. Of more slopes than are worth that,
one form has a multiplier S_j >= 0 for each:

    [M_0'P + P M_0 + alpha P + H'S H, P G; G'P, -S] < 0

A P that serves a theta at the corners serves every larger one: M/theta is N and the slopes over theta^(degree + 1), and
those of a degree above -1 have 0 in their ranges, which shrink. What the form shows holds at the corners.

How far theta or the rate goes is searched in floats, with weights that are known as far as these reach and with others
from there, and proved where that ends. A solver finds P and S, rationals prove them. Without a solver, or of more rows
than it is asked for, P is one that is at hand, or that of large theta alone, N'P + P N = -I with all that moves in N at
its middle: it may serve too, from a larger theta on.

Slopes of one sign may have no other end:

    e' = M e + G p - sum_k s_k onto_k q_k,   q_k = d_k reads_k e,   d_k >= 0 of any size,   V = e'P e

A slope that is at most h, whatever it is below, is h less a d >= 0 (s = 1); one that is at least h is h and more (s =
-1); h stands in M. With

    P onto_k = s_k lambda_k reads_k',   lambda_k >= 0,

V' loses 2 lambda_k (reads_k e)^2 d_k, however large d_k is: what makes V fall without the d does with them. That V
falls wherever e is asks for a slope in the last of two states of a chain, N between 0 and a bound, or in its only one:
from longer chains to what b reads the response is not strictly positive. P keeps to these equations exactly: it is a
sum of rational matrices that do, of which a solver finds the shares, rounded, and rationals prove the rest as
above. What b reads nothing of, reads_k = 0, asks for nothing. An h of a degree above -1 has the sign that
makes the set of slopes shrink as theta grows, so that a P that serves a theta serves larger ones. Source: Arcak,
Kokotovic, "Nonlinear observers: a circle criterion design and robustness analysis", Automatica 37 (2001), theorem 1.
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
from hgogen.prove.inclusion import Inclusion, Nothing, Slope, Uncertain
from hgogen.prove.inequality import NOW, corners, falling, farthest, flow
from hgogen.prove.quadratic import (
    Array,
    Quadratic,
    Weights,
    floats,
    inverse_root,
    negative,
    on_grid,
    proved,
    rational,
    reach,
    verified,
)
from hgogen.prove.semidefinite import Margin, NoSolver, margin, no_solver, widest
from hgogen.rigor import outward
from hgogen.rigor.definite import number
from hgogen.sentence import NONE, Down, Reason, Up, because, point, same, up

EXISTS = "in continuous time, without noise, the error converges exponentially for every theta above a bound"


def theta_claim(theta: float) -> str:
    """The claim that theta is above the bound."""
    return f"theta = {same(theta)} is above that bound"


def nothing(maker: str, theta: float, why: Reason) -> tuple[Check, Check]:
    """The two claims, where no bound is proved."""
    none, fix = because("no bound is proved"), "Validate by trials."
    return (
        Check(ClaimId(maker, "convergence"), EXISTS, Verdict.UNKNOWN, why, fix=fix),
        Check(ClaimId(maker, "theta"), theta_claim(theta), Verdict.UNKNOWN, none, fix=fix),
    )


def decays(rate: float, during: str = "") -> Reason:
    """Return that the error decays at a rate, or does `during` some times alone."""
    pattern = "the error decays at least like exp(-{rate} t) while the estimate keeps to its outer box"
    decay = because(pattern, rate=Down(rate, 2))
    return because("{during} {decay}", during=during, decay=decay) if during else decay


ROWS = 48  # of one form with multipliers: beyond, a solver takes longer than a check may
_WHAT = "one norm for all slopes"
LOWEST = Fraction(1, 100)  # theta that is looked for
FACTOR, TIMES = 4, 24  # by which theta is raised, and how often, until there is a norm
_STEP, _ROUNDS = 1.1, 8  # shorter ones are not worth new weights
CLOSE = 1.003  # where a search with known weights ends
SLOW = Fraction(1, 2**12)  # of the fastest rate: where a rate is looked for first
SHARES = tuple(Fraction(k, 200) for k in (200, 199, 190, 100, 0))  # of a rate that is proved
_BEYOND = tuple(Fraction(k, 1000) for k in (1000, 1001, 1010, 1050))  # of a theta that is proved
_BELOW = tuple(1 - Fraction(1, 2**k) for k in (10, 20, 30))  # of a theta, for one that is hardly smaller
_JOIN = 2  # forms at a time
_NARROWER = Fraction(99, 100)
_THETAS = 16  # of which what the error obeys is remembered

Pair = tuple[Array, Array]  # P and S, in floats


@dataclass(frozen=True)
class Falls:
    """A proof that V' <= -alpha V at `theta`, by the `weights`; their S is empty where corners stand one by one.
    `others`: what V holds beside P, by name."""

    theta: Fraction
    alpha: Fraction
    weights: Weights
    others: Evidence = field(default_factory=dict, hash=False)

    @property
    def rate(self) -> float:
        """r (1/s) with |e|_P <= exp(-r t), rounded down."""
        return outward.number(self.alpha / 2)[0]

    @property
    def written(self) -> Evidence:
        """P and the others, and S where there are multipliers."""
        return {"P": self.weights.P, **self.others} | ({"S": self.weights.S} if self.weights.S else {})


@dataclass(frozen=True, eq=False)
class GainVariation:
    """The effect of a time-varying gain on e' = M e: `shift` comes to M over theta; `cores` N, of which e' = theta N e
    is without b; and `ways` W, where W e comes to e' besides, times any share >= 0. All of FLINT's rationals."""

    shift: Array
    cores: tuple[Array, ...] = ()
    ways: tuple[Array, ...] = ()

    def forms(
        self, e: Uncertain, theta: Fraction, alpha: Any, hull: Sequence[Sequence[Fraction]]
    ) -> Iterator[Quadratic]:
        """Yield the forms of `falling`, and those of the other terms, which are as large."""
        known = floats if e.M.dtype == float else np.asarray
        shifted = falling(replace(e, M=e.M + known(self.shift * number(theta))), alpha, hull)
        yield from shifted
        k = shifted[0].size - len(e.M)
        still = replace(e, G=0 * e.G[:, :k], H=0 * e.H[:k])
        for core in self.cores:
            yield flow(replace(still, M=known(core * number(theta)))).falls(alpha)
        for way in self.ways:
            yield flow(replace(still, M=known(way * number(theta)))).falls(NOW)


STILL = GainVariation(rational([[0]]))  # of a constant gain


@dataclass(frozen=True)
class Flow:
    """The `error` of an observer in continuous time, for which functions that fall are sought, at `theta` and beyond.

    `how`: what they are; here norms, of an observer whose gain varies by its `variation`. `first` (n, n): a P > 0 in
    floats that may serve. Another kind of function says which weights it has in floats at a theta and an alpha
    (`_weights`), which thetas and alphas these serve (`_thetas`, `_alphas`), and what it proves there (`at`)."""

    error: Inclusion
    theta: Fraction
    how: str = "one norm"
    variation: GainVariation = STILL
    first: Array | None = None
    close: ClassVar[tuple[float, float]] = (1.02, 1.1)  # where a search for weights ends: for theta, for a rate

    @cached_property
    def fastest(self) -> Falls | None:
        """A proof at theta with a rate close to the largest; None where none is found."""
        theta, weights = self.theta, self._known
        if weights is None:
            return None
        most, alpha = self._most, Fraction(0)
        if self._alphas(weights)(most * SLOW):
            ends = most * SLOW, most
            alpha = _reached(*ends, weights, self._alphas, lambda a: self._weights(theta, a), self.close[1])
        tried = (self.at(theta, alpha * share) for share in SHARES)
        return next(filter(None, tried), None)

    @cached_property
    def least(self) -> Falls | None:
        """A proof at a theta close to the least, which is below the one at hand where there are weights at that; None
        where none is found."""
        thetas = (self.theta * FACTOR**k for k in range(1, TIMES))
        later = ((theta, weights) for theta in thetas if (weights := self._weights(theta)) is not None)
        first = (self.theta, self._known) if self._known is not None else next(later, None)
        if first is None:
            return None
        theta, weights = first
        lowest = self.theta if theta > self.theta else min(LOWEST, theta / 2)
        end = farthest(lambda at: self._slowest(at)[0] < 0, theta, lowest, CLOSE)
        last = _reached(theta, end, weights, self._thetas, self._weights, self.close[0])
        tried = [Fraction(up(last * share, 3)) for share in _BEYOND] + [theta * share for share in _BELOW] + [theta]
        return next(filter(None, (self.at(one) for one in tried if theta > self.theta or one < theta)), None)

    @property
    def _most(self) -> Fraction:
        """A bound of every alpha at theta."""
        return Fraction(-2 * self.slowest[0])

    def unstable(self, states: Sequence[Any]) -> Reason:
        """The slopes at which, held, errors do not decay at theta; `NONE` where none of those tried is so."""
        speed, d = self.slowest
        if speed < 0:
            return NONE
        return because(
            "with {slopes}, held there, errors do not decay", slopes=point(self.error.slope_values(states, d))
        )

    @cached_property
    def _known(self) -> Any:
        """Weights at theta; None where there are none, or an error does not decay with slopes that are held."""
        return self._weights(self.theta) if self.slowest[0] < 0 else None

    @cached_property
    def _moving(self) -> Callable[[Fraction], Uncertain]:
        """The system that the error obeys at a theta, once for the last ones, as each is asked for at several rates."""
        return lru_cache(maxsize=_THETAS)(self.error.at)

    def _slowest(self, theta: Fraction) -> tuple[float, Array]:
        """The largest real part of an eigenvalue at the corners that are tried, and the corner."""
        e = self._moving(theta).floats
        d = np.array(self.error.hull, dtype=float) if self.error.hull else corners(e.G.shape[1])
        parts = np.linalg.eigvals(e.M + (e.G * d[:, None]) @ e.H).real.max(axis=1)
        return float(parts.max()), d[parts.argmax()]

    @cached_property
    def slowest(self) -> tuple[float, Array]:
        """The slowest corner at theta."""
        return self._slowest(self.theta)

    def _thetas(self, by: Any) -> Callable[[Fraction], bool]:
        P, S = by
        return lambda theta: negative(self._floats(theta, NOW), P, S, self._coordinates)

    def _alphas(self, by: Any) -> Callable[[Fraction], bool]:
        (P, S), theta, most = by, self.theta, self._most
        last = most * reach(self._floats(theta, Fraction(0)), self._floats(theta, most), P, S, self._coordinates)
        return lambda a: a <= last

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is no proof at theta: slopes at which, held, errors do not decay, or the one that hinders most."""
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

    def by(self, weights: Weights, alpha: Fraction) -> Falls | None:
        """A proof at theta by these weights; None where they show nothing."""
        P, S = rational(weights.P), rational(weights.S)
        forms = self._exactly(self.theta, alpha)
        return Falls(self.theta, alpha, weights) if verified(forms, P, S) else None

    @property
    def missing(self) -> Reason:
        """Why there is no norm at any theta."""
        return no_solver(_WHAT) or because(
            "no norm is found in which the linear part of the error falls, whatever moves in it"
        )

    def _hindrance(self) -> Slope | None:
        """The slope of b whose narrowing would bring the forms at theta nearest to being negative."""
        forms = self._floats(self.theta, Fraction(0))
        best = widest(forms, _WHAT, self._coordinates, priced=True) if forms[0].size <= ROWS else None
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

    def at(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Falls | None:
        """A proof of that rate at a theta; None where none is found."""
        weights = self._weights(theta, alpha)
        known = weights and self._proved(self._exactly(theta, alpha), *weights)
        return Falls(theta, alpha, known) if known else None

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        """Weights near those in floats that prove the forms."""
        return proved(forms, P, S)

    def _weights(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Any:
        """Weights in floats with which the forms are negative."""
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
        """The weights with the largest margin for the forms that ask for most: these are few, and are remembered. The
        others are checked, and join them until no form has less than half of the margin."""
        W, few, last = self._coordinates, self._binding, len(forms) - 1
        while True:
            few.extend({0, last} - {*few} if not few else ())
            best = widest([forms[k] for k in few], _WHAT, W)
            if best is None or best.margin <= 0 or len(few) == len(forms):
                return best
            values = [form.value(best.P, best.S) for form in forms]
            if W is not None:  # with multiplied relations as they are
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
        """The numbers of the forms that ask for most, as far as they are known."""
        return []

    def _plain(self, forms: tuple[Quadratic, ...]) -> Pair | None:
        """The first P, its trace n, or that of the linear part alone, and S with which slopes take least from it; None
        where it shows nothing."""
        first = self.first
        P = self.error.linear_lyapunov if first is None else np.asarray(first * len(first) / np.trace(first))
        if P is None:
            return None
        n = len(P)
        return P, np.linalg.norm(P @ forms[0].pairs[0][1][:, n:], axis=0)

    def _exactly(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._moving(theta), theta, alpha)

    def _floats(self, theta: Fraction, alpha: Fraction) -> tuple[Quadratic, ...]:
        return self._forms(self._moving(theta).floats, theta, float(alpha))

    def _forms(self, e: Uncertain, theta: Fraction, alpha: Any) -> tuple[Quadratic, ...]:
        return tuple(self.variation.forms(e, theta, alpha, self.error.hull))

    @cached_property
    def _coordinates(self) -> Array | None:
        """P^(-1/2) of the first P, near which the P that are sought are."""
        return self.error.coordinates if self.first is None else inverse_root(self.first)


def _reached(
    start: Fraction,
    end: Fraction,
    weights: Any,
    serving: Callable[[Any], Callable[[Fraction], bool]],
    seek: Callable[[Fraction], Any],
    close: float,
) -> Fraction:
    """Return how far from the start towards the end there are weights: first as far as those reach that are known, and
    from there again with those that are sought there; then by halving."""
    for _ in range(_ROUNDS):
        value = farthest(serving(weights), start, end, CLOSE)
        better = seek(value) if not 1 / _STEP < value / start < _STEP else None
        start = value
        if better is None:
            break
        weights = better
    return farthest(lambda at: seek(at) is not None, start, end, close)


_ONE_SIDED = "one norm for slopes without an end"
_MARGIN = 1e-7  # that a form has to have in floats
_BITS = (20, 30, 44)
_NO_NORM = (
    "no norm is found that keeps to the slopes without an end: there may be one where they are in the last of two "
    "states of a chain, by an argument that is positive there, or in a state in whose place b reads the sample"
)


@dataclass(frozen=True)
class OneSided(Flow):
    """Norms for an `error` some of whose slopes have one end, at `theta` and beyond."""

    how: str = "one norm that keeps to the signs of slopes without an end,"
    close: ClassVar[tuple[float, float]] = (CLOSE, CLOSE)

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes without an end, of which something is read."""
        return tuple(slope for slope in self.error.endless if any(slope.reads))

    @property
    def missing(self) -> Reason:
        """Why there is a proof at no theta."""
        return no_solver(_ONE_SIDED) or because(_NO_NORM)

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Why there is none at theta."""
        return no_solver(_ONE_SIDED) or because("no norm is found for all slopes in their ranges")

    def _proved(self, forms: Sequence[Quadratic], P: Array, S: Array) -> Weights | None:
        """The shares of the basis, rounded, so that P keeps to the equations exactly."""
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
        """Symmetric matrices (n, n), of FLINT's rationals, of whose sums P onto_k is along reads_k for every k."""
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
        """The lambda_k, in the arithmetic of P, of one that keeps to the equations."""
        for slope in self.endless:
            onto, reads = rational(slope.onto), rational(slope.reads)
            onto, reads = (onto, reads) if P.dtype == object else (floats(each[None])[0] for each in (onto, reads))
            yield -slope.endless * ((P @ onto) @ reads) / (reads @ reads)

    def _sought(self, forms: Sequence[Quadratic]) -> tuple[Array, Array] | None:
        """P that keeps to the equations, and multipliers S, with which forms of floats are negative by the most."""
        basis = [floats(matrix) for matrix in self._basis]
        if not basis or no_solver(_ONE_SIDED):
            return None
        signs = np.array([[float(share) for share in self._lambdas(matrix)] for matrix in basis]).T
        best = margin(forms, _ONE_SIDED, span=(np.array(basis), signs))
        return (best.P, best.S) if best is not None and best.margin > _MARGIN else None


def _null(rows: Sequence[Sequence[fmpq]], count: int) -> list[list[fmpq]]:
    """A basis of the x (count) with which every row is 0."""
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
    """A proof that every theta above `theta` converges: by the norm that falls there."""

    error: Inclusion
    falls: Falls

    @property
    def theta(self) -> Fraction:
        """The bound, which is proved to converge too."""
        return self.falls.theta

    def evidence(self, form: Form) -> Evidence | None:
        """Return how the slopes are bounded, theta, and the P and S at it."""
        function = self.falls.written
        return None if function is None else {"error": self.error, "least": self.theta, **function}


@dataclass(frozen=True)
class AtTheta:
    """A proof of the rate at which the error decays at the declared theta."""

    falls: Falls

    def evidence(self, form: Form) -> Evidence | None:
        """alpha, and the P and S for it; the slopes are those of the claim of convergence."""
        function = self.falls.written
        return None if function is None else {"alpha": self.falls.alpha, **function}


def theta_checks(maker: str, form: Form, theta: float, error: Inclusion | Nothing) -> tuple[Check, Check]:
    """`MAKER.convergence`, that there is a bound; `MAKER.theta`, that theta is above it, with the rate there."""
    if isinstance(error, Nothing):
        return nothing(maker, theta, error.reason)
    kind = OneSided if error.endless else Flow
    return claims(maker, form, kind(error, Fraction(theta)), {"theta": theta, **error.numbers})


def claims(
    maker: str, form: Form, flow: Flow, numbers: Mapping[str, Any], name: str = "theta", during: str = ""
) -> tuple[Check, Check]:
    """Return these claims of an observer of these numbers, theta the gain of that name; the error decays `during` some
    times."""
    theta = float(flow.theta)
    try:
        least = flow.least
        sufficient = least is not None and least.theta < flow.theta
        fastest = flow.fastest if sufficient else None
        why = NONE if sufficient else flow.missing if least is None else flow.obstacle(form.states)
    except OverflowError:
        return nothing(maker, theta, because("the numbers of a proof are beyond the range of doubles"))
    if least is None:
        return nothing(maker, theta, why)
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
        decay = decays(fastest.rate, during)
        reason, fact = because("{above}; {decay}", above=reason, decay=decay), AtTheta(fastest)
    return convergence, Check(id, above, Verdict.PROVED, reason, proofs=(Grounds(numbers, fact),))
