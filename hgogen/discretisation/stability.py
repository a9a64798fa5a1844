"""Step lengths at which errors decay: of a linear core, of a frozen Riccati equation, and while samples are missing.

Linear core. e' = M e becomes e <- R(dt M) e with the method's stability polynomial R, and is stable while
|R(dt lambda)| <= 1 for every eigenvalue lambda of M (Hairer, Wanner, Solving ODEs II, section IV.2). With z = x d,
d = lambda/|lambda|, the first x > 0 at which |R(x d)| passes 1 is a root of the real polynomial |R(x d)|^2 - 1.

Riccati equation. With Q_theta and R_theta of a `Scaling`, of one chain Q_theta = theta Delta^-1 Q Delta^-1, Delta =
diag(1, 1/theta, ..), N = C' R_theta^-1 C = theta C'R^-1 C,
    covariance   P' =  F P + P F' + Q_theta - P N P
    information  S' = -F'S - S F + N - S Q_theta S
Everything is computed in the coordinates Delta z, a congruence. The eigenvalues of the closed loop F - P N at the
steady P are the stable ones of the Hamiltonian [F', -N; -Q_theta, -F].

Growth. `growth` is the largest growth of a frozen error e <- T(h) e before it decays, `longest` the largest step length
h up to which that growth is acceptable.

Missing samples. Without samples an error moves as e' = F e, F the model's Jacobian. A step of length h multiplies a
mode of the eigenvalue lambda by R(h lambda). With Re lambda < 0 the mode decays, and the step follows it up to the
first exit of the ray h lambda from the region |R| <= 1. A mode that does not decay in the plant limits no step. A mode
with a damping ratio below DAMPING does not either: where damping vanishes somewhere in the ranges, no step would be
short enough. The limit is the least first exit of all decaying modes over the ranges, so that for every longer dt the
estimate diverges at some point of the ranges. The search evaluates the middle, corners and random points of the ranges,
and from the best of these moves one coordinate at a time, to its ends and by steps that halve. It refutes longer steps;
the true limit may be shorter.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce

import numpy as np
from numpy.typing import NDArray

from hgogen.analysis.scaling import Scaling
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.errors import HgogenError
from hgogen.program import INF


@dataclass(frozen=True)
class Lengths:
    """Two step lengths, in the unit of the model's time, that a part of an observer permits.

    A step above `refused` is refused: `why` states what happens there, and `other` names a method without this limit. A
    step up to `take` is advised, and `basis` is the reason for this advice. `rule`: the name of the method that
    integrates the part, "" for the observer's method.
    """

    refused: float = INF
    take: float = INF
    why: str = ""
    other: str = ""
    basis: str = ""
    rule: str = ""


AXIS = 1e-9  # allowance for the rounding of eig: |Re z| below which a unit z is imaginary, |z|/max below which z is 0


def spectral_limit(spectrum: NDArray[np.complex128], polynomial: Sequence[float]) -> float:
    """Return the largest dt with |R(h lambda)| <= 1 for all 0 < h <= dt and each lambda of `spectrum`; inf for none.
    `polynomial`: the coefficients of R, constant first."""
    upper = map(complex, spectrum[spectrum.imag >= 0.0])  # the others are conjugates
    return min((_passed(each / abs(each), tuple(polynomial)) / abs(each) for each in upper), default=np.inf)


@lru_cache(maxsize=1024)  # all real eigenvalues, and those of points with equal Jacobians, lie on the same rays
def _passed(direction: complex, polynomial: tuple[float, ...]) -> float:
    """Return the first x > 0 at which |R(x direction)| exceeds 1, a root of the polynomial |R|^2 - 1 of x; inf if there
    is none."""
    terms = np.array([c * direction**k for k, c in enumerate(polynomial)])
    excess = np.convolve(terms.real, terms.real) + np.convolve(terms.imag, terms.imag)
    excess[0] -= 1.0
    excess[np.abs(excess) < AXIS] = 0.0  # on the imaginary axis the low powers cancel and leave rounding
    roots = np.roots(excess[::-1])
    edges = np.sort(roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)])
    edges = np.concatenate(([0.0], edges, [2.0 * edges.max(initial=1.0)]))
    grows = np.polyval(excess[::-1], (edges[1:] + edges[:-1]) / 2.0) > 0.0
    return float(edges[np.argmax(grows)]) if grows.any() else np.inf


Array = np.ndarray
ZERO = 1e-6  # AXIS of the Hamiltonian, whose double zeros are split by rounding, by the root of eps
GRAPH = 1e12  # condition number from which the Hamiltonian's stable subspace has no P: a growing mode is unobservable
# the basis of the least of several limits:
EVERYWHERE = "admitted with the gains as declared at every point of the box that was tried, no proof"


@dataclass(frozen=True)
class Limit:
    """The largest admissible step length, in the model's time unit (inf: any), and what happens beyond it.

    `at`: the index of the Jacobian that decides, -1 if none does.
    """

    dt: float
    why: str
    at: int = -1


@dataclass(eq=False)
class UnstableCore(HgogenError):
    """The error for a linear error core with an eigenvalue in the right half plane, which no step length makes
    stable."""

    text = (
        "the error core has the eigenvalue {eigenvalue:.6g}, which no step length makes stable; choose gains whose "
        "poles have negative real parts"
    )
    eigenvalue: complex


def core_limit(core: Array, polynomial: Sequence[float]) -> float:
    """Return the largest dt with |R(h lambda)| <= 1 for all 0 < h <= dt and every eigenvalue of `core` (n, n), or (k,
    n, n).

    `polynomial`: the coefficients of R, constant first. inf where nothing limits (every eigenvalue 0), 0 where no step
    is stable (Euler on an undamped oscillation). Raises: `UnstableCore`.
    """
    spectrum = np.linalg.eigvals(np.asarray(core, dtype=float)).astype(complex).ravel()
    size = np.abs(spectrum)
    if (spectrum.real > AXIS * size.max()).any():
        raise UnstableCore(complex(spectrum[np.argmax(spectrum.real)]))
    return spectral_limit(spectrum[size > AXIS * size.max()], polynomial)


def decay_limits(jacobians: Array, polynomial: Sequence[float]) -> Array:
    """Return, for each F (k, n, n), the largest dt (k) at which no decaying mode of F grows; inf where none decays."""
    limits = []
    for spectrum in np.linalg.eigvals(np.asarray(jacobians, dtype=float)).astype(complex):
        decaying = spectrum[spectrum.real < -AXIS * np.abs(spectrum).max(initial=0.0)]
        limits.append(spectral_limit(decaying, polynomial))
    return np.array(limits)


def pace(jacobians: Array) -> float:
    """Return the time 1/|lambda| of the fastest mode of all F (k, n, n) among the modes that grow, or oscillate more
    than they decay; inf if there are none.

    A step up to it, of order 2 or more, reproduces such a mode to some percent; decaying modes have other limits.
    """
    spectrum = np.linalg.eigvals(np.asarray(jacobians, dtype=float))
    turning = np.abs(spectrum[spectrum.real > -np.abs(spectrum) / 2]).max(initial=0.0)
    return float(1 / turning) if turning > 0 else np.inf


@dataclass(frozen=True)
class FrozenRiccati:
    """The data of P' = F P + P F' + Q_theta - P C' R_theta^-1 C P at k points: F (k, n, n), C (k, p, n), the weight
    R^-1 (p, p), Q (n, n); `scaling`: how theta scales Q and R."""

    F: Array
    C: Array
    weight: Array
    Q: Array
    scaling: Scaling

    @classmethod
    def of(cls, jacobians: Array, C: Array, Q: Array, R: Array, scaling: Scaling | None = None) -> "FrozenRiccati":
        """Return the Riccati equation at each F (k, n, n) and C (p, n) or (k, p, n); `Q` (n, n) and `R` (p, p), or its
        diagonal (p), per unit of time; `scaling`: by default that of one chain of integrators."""
        F = np.asarray(jacobians, dtype=float)
        C = np.broadcast_to(C, (len(F), *np.shape(C)[-2:]))
        weight: Array = np.asarray(np.linalg.inv(np.diag(R) if np.ndim(R) == 1 else R), dtype=float)
        chain = Scaling(tuple(range(len(Q))), (0,) * len(weight))
        return cls(F, C, weight, np.asarray(Q, dtype=float), scaling or chain)

    def only(self, rows: NDArray[np.intp]) -> "FrozenRiccati":
        """Return the Riccati equations at the points with the indices `rows`."""
        return replace(self, F=self.F[rows], C=self.C[rows])

    def delta(self, theta: float | Array) -> Array:
        """Return the diagonal (n) of Delta = diag(1, 1/theta, ..), or (d, n) for several theta (d)."""
        return 1.0 / np.stack(np.broadcast_arrays(*self.scaling.spread(theta)), axis=-1)

    def parts(self, theta: float | Array, scale: float) -> tuple[Array, Array, Array]:
        """Return F, N = C' R_theta^-1 C and Q_theta (k, n, n) at theta, or at a theta (k) for each F, in the
        coordinates Delta z with theta = `scale` in Delta."""
        delta, scaling = self.delta(scale), self.scaling
        F = delta[:, None] * self.F / delta
        C = self.C / np.sqrt(scaling.variances(np.ones(len(self.weight)), theta))[..., :, None]
        N = transposed(C) @ self.weight @ C / np.outer(delta, delta)
        power = self.delta(scale / theta)
        Q = np.asarray(scaling.process(theta))[..., None, None] * self.Q * (power[..., None] * power[..., None, :])
        return F, N, np.broadcast_to(Q, N.shape)

    def hamiltonian(self, theta: float) -> Array:
        """Return the Hamiltonians [F', -N; -Q_theta, -F] (k, 2n, 2n) in the coordinates Delta z."""
        F, N, Q = self.parts(theta, theta)
        return np.block([[transposed(F), -N], [-Q, -F]])

    def decay_rates(self, theta: float) -> Array:
        """Return the decay rates (k, n) of the error under the steady P, slowest first; 0 for an unobservable mode."""
        spectra = np.abs(np.linalg.eigvals(self.hamiltonian(theta)).real)
        return np.asarray(np.sort(spectra, axis=1)[:, ::2])  # each twice: they lie symmetric about the imaginary axis

    def steady(self, theta: float) -> Array:
        """Return the stabilising P (k, n, n) of F P + P F' + Q_theta - P N P = 0; nan where there is none."""
        n, delta = len(self.Q), self.delta(theta)
        P = np.full(self.F.shape, np.nan)
        for i, H in enumerate(self.hamiltonian(theta)):
            values, vectors = np.linalg.eig(H)
            stable = np.argsort(values.real)[:n]
            if values[stable].real.max() < -ZERO * np.abs(values).max():
                basis = vectors[:n, stable]
                if np.linalg.cond(basis) < GRAPH:
                    X = np.linalg.solve(basis.T, vectors[n:, stable].T).real
                    P[i] = (X + X.T) / 2.0 / np.outer(delta, delta)
        return P


@dataclass(frozen=True)
class FrozenMap(FrozenRiccati):
    """The data of the Riccati equation of a discrete plant at k points, P <- F (P - K C P) F' + Q, K = P C' (C P C' +
    R)^-1; theta is 1, and time is counted in samples."""

    def steady(self, theta: float) -> Array:
        """Return the stabilising P (k, n, n), the covariance before a sample; nan where there is none.

        By doubling, which has the covariance after 2^j steps from P = Q: W = (I + G P)^-1, A <- A W A,
        G <- G + A W G A', P <- P + A' P W A, from A = F', G = C' R^-1 C (E. Chu et al., Int. J. Control 77, 2004).
        """
        A, G, P = transposed(self.F), transposed(self.C) @ self.weight @ self.C, np.broadcast_to(self.Q, self.F.shape)
        one = np.eye(len(self.Q))
        with np.errstate(all="ignore"):
            for _ in range(DOUBLED):
                W = np.linalg.inv(one + G @ P)
                A, G, P = A @ W @ A, G + A @ W @ G @ transposed(A), P + transposed(A) @ P @ W @ A
        settled = (np.abs(A).max((1, 2)) < SETTLED) & np.isfinite(P).all((1, 2))
        return np.where(settled[:, None, None], (P + transposed(P)) / 2, np.nan)

    def decay_rates(self, theta: float) -> Array:
        """Return the decay rates (k, n) of the error in a sample under the steady P, -log |eigenvalue|, slowest first;
        0 for all where there is none."""
        P, C = self.steady(theta), self.C
        S = C @ P @ transposed(C) + np.linalg.inv(self.weight)
        known = np.isfinite(P).all((1, 2))
        rates = np.zeros(self.F.shape[:2])
        K = P[known] @ transposed(C[known]) @ np.linalg.inv(S[known])
        spectra = np.abs(np.linalg.eigvals(self.F[known] @ (np.eye(len(self.Q)) - K @ C[known])))
        rates[known] = np.sort(np.clip(-np.log(np.maximum(spectra, 1e-300)), 0.0, FASTEST), axis=1)
        return rates


DOUBLED, SETTLED = 30, 1e-6  # doublings, 2^30 samples; what is left of a first error then
FASTEST = 3.0  # the rate of a mode that is gone after a sample or two


def transposed(X: Array) -> Array:
    """Return the matrices X (.., n, n) transposed."""
    return X.swapaxes(-1, -2)


# --- growth of errors before they decay

GROWTH = 1.5  # the acceptable growth, as a multiple of that in continuous time
BY_TRIAL = "found by trying errors at points of the declared box with the gains as declared, no proof"
WIDER, NARROWINGS = 1.2, 4  # of a search: the ratio of its lengths, and the bisections of the last one's logarithm
COARSE_STEPS = 8  # lengths that a coarse search advances at a time: a factor of 4.3
TOGETHER, DECAYED = 8, 0.999  # powers computed at a time, and a bound below 1 by more than rounding
POWERS, BASES, DOUBLINGS = 48, (24, 29, 34, 41), 12  # the exponents k: to 48, and these times powers of two


def polynomial(X: Array, coefficients: tuple[float, ...]) -> Array:
    """Return the sums sum_j c_j X^j (k, N, N), the constant c_0 first."""
    total, power = np.zeros_like(X), np.broadcast_to(np.eye(X.shape[-1]), X.shape)
    for c in coefficients:
        total, power = total + c * power, power @ X
    return total


def growth(T: Array) -> Array:
    """Return, for each T (k, N, N), the largest |T^j| over powers j >= 0, at least 1. After a power with |T^j| < 1 no
    larger one follows, as |T^(j+k)| <= |T^j| |T^k|."""
    powers = np.empty((POWERS, *T.shape))
    largest: Array = np.ones(len(T))
    with np.errstate(over="ignore", invalid="ignore"):  # a power that overflows has grown
        powers[0] = T
        for start in range(0, POWERS, TOGETHER):
            for k in range(max(1, start), start + TOGETHER):
                np.matmul(powers[k - 1], T, out=powers[k])
            sizes = _size(powers[start : start + TOGETHER])
            largest = np.maximum(largest, sizes.max(axis=0))
            if (sizes.min(axis=0) < DECAYED).all():
                return largest
        squares = powers[[k - 1 for k in BASES]]
        for _ in range(DOUBLINGS):
            squares = squares @ squares
            sizes = _size(squares)
            largest = np.maximum(largest, sizes.max(axis=0))
            if (sizes < DECAYED).all():
                break
    return np.where(np.isnan(largest), math.inf, largest)


def continuous(M: Array, units: Array) -> Array:
    """Return, for each M (k, N, N), the largest |exp(M t)| over t at multiples of `units` (k)."""
    return growth(polynomial(M * units[:, None, None], tuple(1 / math.factorial(j) for j in range(9))))


def longest(grows: Callable[[float], bool], start: float, end: float, coarse_end: float = 0.0) -> float:
    """Return the largest step length h up to which `grows(h)` is False, by a search upwards from `start` by the ratio
    WIDER and bisections of the last ratio; `start` where the error grows there, inf where h is beyond `end`.

    The lengths do not depend on `end`. The search is upwards because an error may grow at a length and not at a longer
    one. Up to `coarse_end` it advances COARSE_STEPS lengths at a time.
    """
    fine, step = max(0, math.floor(math.log(coarse_end / start, WIDER))) if coarse_end else 0, 0
    good = bad = start
    while not grows(bad):
        if bad >= end:
            return math.inf
        step += 1 if step >= fine else (fine - step) % COARSE_STEPS or COARSE_STEPS  # so that one step ends at `fine`
        good, bad = bad, start * WIDER**step
    while bad > 1.001 * good * WIDER**0.5**NARROWINGS:
        middle = math.sqrt(good * bad)
        good, bad = (good, middle) if grows(middle) else (middle, bad)
    return good if good <= max(start, end) else math.inf


def _size(T: Array) -> Array:
    """Return the norm max_i sum_j |T_ij| of each T (.., N, N); inf or NaN if T is not finite.
    The sum is formed entry by entry, since NumPy is slow for sums of a few numbers."""
    rows = reduce(np.add, np.moveaxis(np.abs(T), -1, 0))
    return np.asarray(reduce(np.maximum, np.moveaxis(rows, -1, 0)))


# --- while samples are missing

Slopes = Callable[[Array], Array]
RANDOM = 64  # random points, and corners at most
STARTS = 4  # points from which the search goes on
FIRST, SHORTEST = 2.0**-2, 2.0**-10  # of a range: the first and the last step of the search
EDGE = 0.005  # share of a range that is omitted at its ends where F is not finite at a corner: no plant stays there
ANGLES = 181  # rays of the half plane Re < 0, between which the search interpolates the first exit
DAMPING = 1e-3  # least damping ratio of a mode that counts as decaying: .6 % per period
SEARCHED = "sought over the declared ranges, no proof"


@dataclass(frozen=True, eq=False)
class Ranges:
    """The ranges `low` (n), `high` (n) of coordinates with `names`; the first `states` are the model's state."""

    low: Array
    high: Array
    names: tuple[str, ...]
    states: int

    def points(self, shares: Array) -> Array:
        """Return the points low + share (high - low) (k, n) for shares (k, n) from 0 to 1."""
        return np.asarray(self.low + shares * (self.high - self.low))


@dataclass(frozen=True, eq=False)
class OpenLoopLimit:
    """The longest step `dt` at which decaying modes of e' = F e decay, inf where none decays, with the `point` (n) and
    the `eigenvalue` of F that limit it.

    `state`: the name of the state with the largest component in that mode, each in units of its range.
    """

    dt: float
    point: Array
    eigenvalue: complex
    state: str


def open_loop_limit(slopes: Slopes, ranges: Ranges, polynomial: Sequence[float]) -> OpenLoopLimit:
    """Return the longest step that keeps decaying modes of e' = F e decaying, F (k, N, N) = slopes(points (k, n)),
    which may be NaN, over points of the ranges; `polynomial`: the coefficients of R with e <- R(h F) e, constant
    first."""
    shares, edge = _start_points(slopes, ranges)
    table = _exits(tuple(polynomial))

    def limits(at: Array) -> Array:
        return _interpolated(slopes(ranges.points(at)), table)

    values = limits(shares)
    moving = np.flatnonzero(ranges.high > ranges.low)
    best = values.argsort(kind="stable")[:STARTS]
    if not np.isfinite(values[best[0]]):
        return OpenLoopLimit(np.inf, ranges.points(shares[0]), 0j, "")
    minima, least = _local_minima(limits, shares[best], values[best], moving, edge)
    point = ranges.points(minima[least.argmin()])
    return _decided(slopes(point[None])[0], point, ranges, polynomial)


def open_loop_lengths(slopes: Slopes, ranges: Ranges, tableau: Tableau, time: str) -> Lengths:
    """Return the longest step that keeps decaying modes of e' = F e decaying (`open_loop_limit`) as an advised step
    length, with the point that limits it; `time`: the unit of time."""
    limit = open_loop_limit(slopes, ranges, tableau.polynomial)
    if not np.isfinite(limit.dt):
        return Lengths()
    at = ", ".join(f"{name} = {value:.3g}" for name, value in zip(ranges.names, limit.point, strict=True))
    eigenvalue, turning = f"{limit.eigenvalue.real:.3g}", abs(limit.eigenvalue.imag)
    if turning > AXIS * abs(limit.eigenvalue):
        eigenvalue += f" +- {turning:.3g}i"
    basis = (
        f"beyond it {limit.state} diverges while samples are missing, at {at}, where the model has the "
        f"eigenvalue {eigenvalue} 1/{time} and the step leaves the stability region; {SEARCHED}"
    )
    return Lengths(take=limit.dt, basis=basis, rule=tableau.name)


def _start_points(slopes: Slopes, ranges: Ranges) -> tuple[Array, float]:
    n = len(ranges.low)
    rng = np.random.default_rng(1)
    every = 2**n <= RANDOM
    corners = (np.arange(2**n)[:, None] >> np.arange(n)) % 2 if every else rng.integers(0, 2, size=(RANDOM, n))
    finite = np.isfinite(slopes(ranges.points(corners))).all()
    edge = 0.0 if finite else EDGE
    inside = rng.uniform(size=(RANDOM, n))
    return edge + (1 - 2 * edge) * np.vstack([np.full((1, n), 0.5), corners, inside]), edge


def _local_minima(
    limits: Callable[[Array], Array], points: Array, values: Array, moving: Array, edge: float
) -> tuple[Array, Array]:
    points, values, lengths = points.copy(), values.copy(), np.full(len(points), FIRST)
    every, rows = np.arange(len(points)), np.arange(len(moving))
    while len(moving) and lengths.max() >= SHORTEST:
        here, move = points[:, moving], lengths[:, None]
        ends = np.full(here.shape, edge), np.full(here.shape, 1 - edge)
        tried = np.repeat(points[:, None], 4 * len(moving), axis=1).reshape(len(points), 4, len(moving), -1)
        for k, shifted in enumerate((*ends, here - move, here + move)):
            tried[:, k, rows, moving] = np.clip(shifted, edge, 1 - edge)
        trials: Array = tried.reshape(len(points), 4 * len(moving), -1)
        limits_tried = limits(trials.reshape(-1, points.shape[1])).reshape(len(points), -1)
        least = limits_tried.argmin(axis=1)
        better = limits_tried[every, least] < values * (1 - AXIS)
        points[better], values[better] = trials[every, least][better], limits_tried[every, least][better]
        lengths[~better] /= 2
    return points, values


def _decided(F: Array, point: Array, ranges: Ranges, polynomial: Sequence[float]) -> OpenLoopLimit:
    values, vectors = np.linalg.eig(F)
    values = values.astype(complex)
    decaying = np.flatnonzero(_decays(values))
    exits = [spectral_limit(values[[k]].real + 1j * np.abs(values[[k]].imag), polynomial) for k in decaying]
    k = decaying[int(np.argmin(exits))]
    dt, eigenvalue = float(min(exits)), complex(values[k])
    if len(F) != ranges.states:
        return OpenLoopLimit(dt, point, eigenvalue, "the estimate")
    width = (ranges.high - ranges.low)[: len(F)]
    share = np.abs(vectors[:, k]) / np.where(width > 0, width, 1.0)
    return OpenLoopLimit(dt, point, eigenvalue, ranges.names[int(share.argmax())])


def _decays(spectra: Array) -> Array:
    sizes = np.abs(spectra)
    rounding = AXIS * sizes.max(axis=-1, keepdims=True, initial=0.0)
    return np.asarray(spectra.real < -np.maximum(rounding, DAMPING * sizes))


def _interpolated(F: Array, exits: Array) -> Array:
    """Return the least x (k) at which a decaying mode of F (k, N, N) leaves the region |R| <= 1,
    interpolated between the angles of the table `exits`; inf if no mode decays or F is not finite."""
    finite = np.isfinite(F).all(axis=(1, 2))
    spectra = np.linalg.eigvals(np.where(finite[:, None, None], F, 0.0)).astype(complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.interp(np.abs(np.angle(spectra)), np.linspace(np.pi / 2, np.pi, ANGLES), exits)
        limits = np.where(_decays(spectra), radius / np.abs(spectra), np.inf)
    return np.asarray(limits.min(axis=1, initial=np.inf))


@lru_cache(maxsize=8)
def _exits(polynomial: tuple[float, ...]) -> Array:
    """Return the first x with |R(x d)| > 1, R the polynomial, along
    rays d from the imaginary axis to the negative real one."""
    rays = np.exp(1j * np.linspace(np.pi / 2, np.pi, ANGLES))
    return np.array([spectral_limit(np.array([ray]), polynomial) for ray in rays])
