"""Step lengths dt that an explicit Runge-Kutta method admits for the covariance equation of a Riccati observer.

The equation of P, or of S = P^-1, is X' = L X + X L' + W - X V X. Each of two failures has a step length from which it
occurs, and the smaller one is the limit.

Steady. Around its steady value X moves like dX' = M dX + dX M', M = L - X V, whose eigenvalues are the sums mu_i +
mu_j. In both views the mu are those of the observer's closed loop F - P N: no Riccati equation is solved, and where
(C, F) is unobservable a mu is 0, which admits every step. Beyond this bound the steady value is unstable.

Transient. Before it settles X can lose positive definiteness, which the equation preserves and an explicit step need
not. Where the quadratic term dominates, X' = -X V X splits into scalars y' = -m y^2, m the eigenvalues of V X(0), and
fails in the first step from dt m = x* on, the first zero of the method's step from y = 1 (Euler 1, Heun 1.544, RK4
1.739). Elsewhere F decides, and no such formula was right within a factor of 5. So the step itself simulates the frozen
equation from every initial value of X: X(0) and, where theta rises from an idle value, the steady value there.

Every Jacobian is frozen, and the searches at all of them run in parallel. So a refusal is about one point of the
declared ranges: the observer started there fails (for a rise of theta: if the plant rests there), while steps twice as
long may be stable from elsewhere. An admitted step is no guarantee. The analysis ignores a Jacobian that changes faster
than the covariance settles (a pendulum that swings through its whole range at theta <= 2 can fail from half the limit
on), and z, which overshoots at first where P(0) is large. Rises of theta are not simulated at a Jacobian without a
steady covariance (unobservable).
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hgogen.analysis.scaling import Scaling
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.discretisation.stability import ZERO, FrozenRiccati, Limit, spectral_limit, transposed
from hgogen.errors import HgogenError

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rise = Callable[[Array, Array], Array]

STEPS = 60  # of a transient, once theta has risen; for random equations P was lost within 40 or never
MOST_STEPS = 3000  # of a transient in all
AT_ONCE = 20_000  # matrix entries of the transients that are simulated in parallel
COARSE, FINE = 1.2, 1.02  # ratios of the step lengths tried in turn; the limit is low by less than FINE
NOTHING = Limit(np.inf, "no transient fails")


@dataclass(eq=False)
class NotDefinite(HgogenError):
    """The error that an initial covariance P(0) is not positive definite."""

    covariance: Array

    def __str__(self) -> str:
        return f"P(0) = {self.covariance.tolist()} is not positive definite; give, say, a diagonal that is"


def covariance_limits(
    jacobians: Array,
    C: Array,
    Q: Array,
    R: Array,
    initial_covariance: Array,
    theta_max: float,
    tableau: Tableau,
    representation: Literal["information", "covariance"],
    theta_min: float | None = None,
    rise: Rise | None = None,
    scaling: Scaling | None = None,
) -> list[Limit]:
    """Return the largest dt, for each Jacobian, at which an explicit method keeps the covariance P of a Riccati
    observer stable, P' = F P + P F' + Q_theta - P C' R_theta^-1 C P.

    `jacobians` (k, n, n): F at k points of the box; `C` (p, n), or (k, p, n) at the same points; `Q` (n, n), `R` (p,
    p), or its diagonal (p,): as in Q_theta and R_theta, per unit of time; `initial_covariance`: P(0). `theta_min`: the
    idle value of an adaptive theta (None: it starts at theta_max); `rise(theta, dt)`: each theta (d) after a time dt
    (d) when it rises as fast as its law permits (None: it jumps); `scaling`: by default that of one chain of
    integrators. A continuous-discrete step keeps P definite at any dt: it has no such limit. Raises: `NotDefinite`.
    """
    initial = np.asarray(initial_covariance, dtype=float)
    if not _definite(initial[None])[0]:
        raise NotDefinite(initial)
    riccati = FrozenRiccati.of(jacobians, C, Q, R, scaling)
    idle = theta_max if theta_min is None else theta_min
    starts = _starts(riccati, initial, idle, theta_max)
    rising = rise or (lambda theta, dt: np.full_like(theta, theta_max))
    transients = _Transients(riccati, idle, theta_max, representation, rising, tableau)
    steady = _steady_limits(riccati, (idle, theta_max), tableau.polynomial)
    searches = [_transient_limit(starts.only(starts.rows == i), limit.dt) for i, limit in enumerate(steady)]
    each = zip(steady, transients.limits(searches), strict=True)
    return [min(limits, key=lambda limit: limit.dt) for limits in each]


def _steady_limits(riccati: FrozenRiccati, thetas: Sequence[float], polynomial: Sequence[float]) -> list[Limit]:
    """Return for each Jacobian F the largest dt at which the explicit method is stable around the steady covariance: by
    the eigenvalues mu_i of F - P N for the state, and by mu_i + mu_j for P and S = P^-1; `polynomial`: the coefficients
    of the stability polynomial."""
    each: list[list[Limit]] = [[] for _ in riccati.F]
    pairs = np.triu_indices(len(riccati.Q))
    for theta in dict.fromkeys(thetas):
        for i, spectrum in enumerate(np.linalg.eigvals(riccati.hamiltonian(theta))):
            mu = np.sort_complex(spectrum)[: len(riccati.Q)]
            mu = np.minimum(mu.real, 0.0) + 1j * mu.imag
            modes = np.concatenate((mu, mu[pairs[0]] + mu[pairs[1]]))
            modes = modes[np.abs(modes) > ZERO * np.abs(spectrum).max()]
            why = f"the covariance does not settle, for its steady value repels (theta = {theta:g})"
            each[i].append(Limit(spectral_limit(modes, polynomial), why, i))
    return [min(limits, key=lambda limit: limit.dt) for limits in each]


@dataclass(frozen=True)
class _Starts:
    """Initial covariances P (m, n, n) of simulations, each with the index `rows` of
    its Jacobian, a flag `rises` (theta rises, else it is constant) and a name."""

    P: Array
    rows: NDArray[np.intp]
    rises: Flags
    names: NDArray[np.str_]

    @classmethod
    def of(cls, each: Sequence["_Starts"]) -> "_Starts":
        fields = zip(*((one.P, one.rows, one.rises, one.names) for one in each), strict=True)
        return cls(*map(np.concatenate, fields))

    def only(self, part: Flags | slice) -> "_Starts":
        return _Starts(self.P[part], self.rows[part], self.rises[part], self.names[part])

    def __len__(self) -> int:
        return len(self.rows)


def _starts(riccati: FrozenRiccati, initial: Array, idle: float, theta_max: float) -> _Starts:
    k, risen = len(riccati.F), f"(theta rising from {idle:g})"
    each = [(initial, False, f"P(0) (theta = {idle:g})")]
    if idle != theta_max:
        each += [(initial, True, f"P(0) {risen}"), (riccati.steady(idle), True, f"the steady P {risen}")]
    P = np.concatenate([np.broadcast_to(P, riccati.F.shape) for P, _, _ in each])
    rises, names = (np.repeat(values, k) for values in list(zip(*each, strict=True))[1:])
    return _Starts(P, np.tile(np.arange(k), len(each)), rises, names).only(_definite(P))


Request = tuple[_Starts, Sequence[float]]  # transients to simulate: their starts, and the step lengths for each
Lost = tuple[int, _Starts]  # the index of the first length at which P is lost, and its starts; else the last, and none
Search = Generator[Request, Lost, Limit]


@dataclass(frozen=True)
class _Transients:
    """Simulations of the covariance equation X' = L X + X L' + W - X
    V X of P or P^-1 (`representation`), in the coordinates of
    theta_max, while theta rises from `idle` by the law `rise`."""

    riccati: FrozenRiccati
    idle: float
    theta_max: float
    representation: str
    rise: Rise
    tableau: Tableau

    def limits(self, searches: Sequence[Search]) -> list[Limit]:
        """Return the step-length limit that each search finds; the searches run in parallel, since a step of many P
        costs hardly more than one of one P."""
        limits = [NOTHING] * len(searches)
        requests = {i: next(search) for i, search in enumerate(searches)}
        while requests:
            for i, lost in zip(list(requests), self._lost(list(requests.values())), strict=True):
                try:
                    requests[i] = searches[i].send(lost)
                except StopIteration as end:
                    limits[i] = end.value
                    del requests[i]
        return limits

    def _lost(self, requests: Sequence[Request]) -> list[Lost]:
        every = _Starts.of([starts for starts, lengths in requests for _ in lengths])
        dt = np.concatenate([np.repeat(lengths, len(starts)) for starts, lengths in requests])
        many = max(1, AT_ONCE // self.riccati.Q.size)
        parts = [slice(first, first + many) for first in range(0, len(dt), many)]
        fails = np.concatenate([self._fails(every.only(part), dt[part]) for part in parts])
        ends = np.cumsum([len(starts) * len(lengths) for starts, lengths in requests])
        answers = []
        for (starts, lengths), flags in zip(requests, np.split(fails, ends[:-1]), strict=True):
            by_length = flags.reshape(len(lengths), -1)
            place = int(by_length.any(axis=1).argmax()) if flags.any() else len(lengths) - 1
            answers.append((place, starts.only(by_length[place])))
        return answers

    def _fails(self, starts: _Starts, lengths: Array) -> Flags:
        delta, dt = self.riccati.delta(self.theta_max), lengths[:, None, None]
        X: Array = starts.P * np.outer(delta, delta)
        X = np.asarray(np.linalg.inv(X)) if self.representation == "information" else X
        riccati, theta, rises = self.riccati.only(starts.rows), np.full(len(lengths), self.idle), starts.rises
        equation, alive = self._equation(riccati, self.idle), np.ones(len(lengths), dtype=bool)
        remaining = np.full(len(lengths), STEPS)
        for _ in range(MOST_STEPS):
            if rises.any():
                theta = np.where(rises, np.minimum(self.rise(theta, lengths), self.theta_max), theta)
                equation = self._equation(riccati, theta)
            with np.errstate(over="ignore", invalid="ignore"):  # a transient that overflows has failed
                X = _step(X, *equation, self.tableau, dt)
                alive &= _definite(X) | (remaining == 0)
            remaining -= (remaining > 0) & (~rises | (theta > 0.9 * self.theta_max))
            if not (alive & (remaining > 0)).any():
                break
        return ~alive

    def _equation(self, riccati: FrozenRiccati, theta: float | Array) -> tuple[Array, Array, Array]:
        """Return L, W, V of X' = L X + X L' + W - X V X at theta; X is P or P^-1, as represented."""
        F, N, Q = riccati.parts(theta, self.theta_max)
        return (-transposed(F), N, Q) if self.representation == "information" else (F, Q, N)


def _step(X: Array, L: Array, W: Array, V: Array, tableau: Tableau, dt: Array) -> Array:
    slopes: list[Array] = []
    for row in tableau.a:
        stage = _combined(X, slopes, row, dt)
        half = (L - 0.5 * stage @ V) @ stage
        slopes.append(half + transposed(half) + W)
    return _combined(X, slopes, tableau.b, dt)


def _combined(X: Array, slopes: list[Array], weights: Sequence[float], dt: Array) -> Array:
    X = X.copy()
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            X += dt * weight * slope
    return X


def _definite(X: Array) -> Flags:
    """Return flags of the matrices X (.., n, n) that are finite and positive definite, by the pivots of X = L D L'."""
    good: Flags = np.asarray(np.isfinite(X).all(axis=(-2, -1)))
    X = np.where(good[..., None, None], X, 0.0)
    while X.shape[-1]:
        pivot, column = X[..., 0, 0], X[..., 1:, 0]
        good = good & (pivot > 0.0)
        scale = np.where(pivot > 0.0, pivot, 1.0)[..., None, None]
        X = X[..., 1:, 1:] - column[..., :, None] * column[..., None, :] / scale
    return good


def _transient_limit(starts: _Starts, most: float) -> Search:
    good = bad = min(most, 1e9)
    while lost := (yield starts, (good,))[1]:
        first, good, bad = lost, good / 8.0, good
    if good == bad:
        return NOTHING
    good, bad, first = yield from _scan(starts, good, bad, COARSE, first)
    # the fine scan begins lower: where theta rises by steps, some shorter dt can fail below a dt that does not
    good, _, first = yield from _scan(first, good / COARSE, bad, FINE, first)
    why = f"the covariance loses positive definiteness on the way from {first.names[0]}"
    return Limit(good, why, int(first.rows[0]))


def _scan(
    starts: _Starts, good: float, bad: float, ratio: float, first: _Starts
) -> Generator[Request, Lost, tuple[float, float, _Starts]]:
    lengths = [good]
    while lengths[-1] * ratio < bad:
        lengths.append(lengths[-1] * ratio)
    place, lost = yield starts, lengths[1:]
    return (lengths[place], lengths[place + 1], lost) if lost else (lengths[-1], bad, first)
