"""Which step lengths dt an explicit Runge-Kutta method admits.

Linear core. e' = M e becomes e <- R(dt M) e with the method's stability polynomial R, and is stable while
|R(dt lambda)| <= 1 for every eigenvalue lambda of M (Hairer, Wanner, Solving ODEs II, section IV.2).

Riccati equation. With Q_theta and R_theta of a `Scaling`, of one chain Q_theta = theta Delta^-1 Q Delta^-1, Delta =
diag(1, 1/theta, ..), N = C' R_theta^-1 C = theta C'R^-1 C,
    covariance   P' =  F P + P F' + Q_theta - P N P
    information  S' = -F'S - S F + N - S Q_theta S
are both X' = L X + X L' + W - X V X. Two things go wrong, and the smaller of their step lengths is the limit.

Steady. Around its steady value X moves like dX' = M dX + dX M', M = L - X V, whose eigenvalues are the sums
mu_i + mu_j. In both views the mu are those of the observer's closed loop F - P N, which are the stable
eigenvalues of the Hamiltonian [F', -N; -Q_theta, -F]: no Riccati equation is solved, and where (C, F) is
unobservable a mu is 0, which admits every step. Beyond this bound the steady value repels: X fails or
wanders.

Transient. On its way X can lose positive definiteness, which the equation keeps and an explicit step need
not. Where the quadratic term rules, X' = -X V X splits into scalars y' = -m y^2, m the eigenvalues of V
X(0), and fails at once from dt m = x* on, the first zero of the method's step from y = 1 (Euler 1, Heun
1.544, RK4 1.739). Elsewhere F decides, and no such formula held within a factor of 5. So the step itself is
taken, on the frozen equation, from every value that X starts from: X(0) and, where theta rises from a value
at which it rests, the steady value there.

Every Jacobian counts as frozen, and the worst decides. So a refusal is about one point of the box:
the observer started there fails, while from elsewhere steps twice as long may survive (about a rise: if the
plant rests there). To be admitted promises less: a Jacobian that turns faster than the covariance settles
is not seen (a pendulum that swings through its whole box at theta <= 2 can fail from half the limit on),
nor does z enter, which overshoots at first where P(0) is large. A Jacobian without a steady covariance
(unobservable) is no start of a rise. All is computed in the coordinates Delta z, a congruence, with which
the step commutes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hgogen.discretisation.rays import AXIS, spectral_limit
from hgogen.discretisation.runge_kutta import Tableau
from hgogen.errors import HgogenError
from hgogen.structure.scaling import Scaling

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rise = Callable[[Array, Array], Array]

ZERO = 1e-6  # what AXIS is, for the Hamiltonian, whose double zeros rounding splits by the root of eps
GRAPH = 1e12  # condition of the Hamiltonian's stable subspace from which on it is no graph: a growing mode is hidden
STEPS = 60  # of a transient, once theta has risen; over random equations all losses came within 40
PATIENCE = 3000  # steps of a transient in all
AT_ONCE = 20_000  # numbers of transients that are taken side by side
COARSE, FINE = 1.2, 1.02  # ratios of the step lengths tried in turn; the limit is low by less than FINE
# of the least of several limits:
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
    """A linear error core with an eigenvalue in the right half plane: no step length makes it converge."""

    eigenvalue: complex

    def __str__(self) -> str:
        return (
            f"the error core has the eigenvalue {self.eigenvalue:.6g}, which no step length makes stable; "
            "choose gains whose poles have negative real parts"
        )


@dataclass(eq=False)
class NotDefinite(HgogenError):
    """An initial covariance that is no covariance."""

    covariance: Array

    def __str__(self) -> str:
        return f"P(0) = {self.covariance.tolist()} is not positive definite; give, say, a diagonal that is"


def core_limit(core: Array, polynomial: Sequence[float]) -> float:
    """The largest dt with |R(h lambda)| <= 1 for all 0 < h <= dt and every eigenvalue of `core` (n, n), or (k, n, n).

    `polynomial`: the coefficients of R, constant first. inf where nothing limits (every eigenvalue 0), 0
    where no step is stable (Euler on an undamped oscillation). Raises: `UnstableCore`.
    """
    spectrum = np.linalg.eigvals(np.asarray(core, dtype=float)).astype(complex).ravel()
    size = np.abs(spectrum)
    if (spectrum.real > AXIS * size.max()).any():
        raise UnstableCore(complex(spectrum[np.argmax(spectrum.real)]))
    return spectral_limit(spectrum[size > AXIS * size.max()], polynomial)


def decay_limits(jacobians: Array, polynomial: Sequence[float]) -> Array:
    """For each F (k, n, n), the largest dt at which its decaying modes do not grow (k); inf where none decays."""
    limits = []
    for spectrum in np.linalg.eigvals(np.asarray(jacobians, dtype=float)).astype(complex):
        decaying = spectrum[spectrum.real < -AXIS * np.abs(spectrum).max(initial=0.0)]
        limits.append(spectral_limit(decaying, polynomial))
    return np.array(limits)


def pace(jacobians: Array) -> float:
    """1/|lambda| of the fastest mode of all F (k, n, n) that grows, or oscillates more than it decays; inf for none.

    Up to it a step of order 2 or more follows such a mode to some percent; decay has limits of its own.
    """
    spectrum = np.linalg.eigvals(np.asarray(jacobians, dtype=float))
    turning = np.abs(spectrum[spectrum.real > -np.abs(spectrum) / 2]).max(initial=0.0)
    return float(1 / turning) if turning > 0 else np.inf


def steady_covariance(
    jacobians: Array, C: Array, Q: Array, R: Array, theta: float, scaling: Scaling | None = None
) -> Array:
    """The steady P (k, n, n) at each F (k, n, n), C (k, p, n) under Q_theta, R_theta; nan where there is none.

    `Q` (n, n) and the diagonal `R` (p,) per unit of time; `scaling`: by default that of one chain.
    """
    return _steady_covariance(_riccati(jacobians, C, Q, R, scaling), theta)


def closed_loop_rates(
    jacobians: Array, C: Array, Q: Array, R: Array, theta: float, scaling: Scaling | None = None
) -> Array:
    """The rates at which the error decays under the steady P, the slowest first (k, n), at each F (k, n, n) and
    C (k, p, n); 0 where a mode is hidden. Other arguments as in `steady_covariance`."""
    spectra = np.abs(np.linalg.eigvals(_riccati(jacobians, C, Q, R, scaling).hamiltonian(theta)).real)
    return np.asarray(np.sort(spectra, axis=1)[:, ::2])  # each twice: they lie symmetric about the imaginary axis


def covariance_limit(
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
) -> Limit:
    """The largest dt at which an explicit method keeps a Riccati observer's covariance equation stable.

    `jacobians` (k, n, n): F at k points of the box; `C` (p, n), or (k, p, n) at the same points; `Q` (n, n),
    `R` (p, p), or its diagonal (p,): as in Q_theta and R_theta, per unit of time; `initial_covariance`: P(0).
    `theta_min`: where an adaptive theta rests (None: it starts at theta_max); `rise(theta, dt)`: each theta (d) a time
    dt (d) later when it rises as fast as its law lets it (None: it jumps); `scaling`: by default that of one chain.
    A continuous-discrete step keeps P definite at any dt: it has no such limit. Raises: `NotDefinite`.
    """
    initial = np.asarray(initial_covariance, dtype=float)
    if not _definite(initial[None])[0]:
        raise NotDefinite(initial)
    riccati = _riccati(jacobians, C, Q, R, scaling)
    rest = theta_max if theta_min is None else theta_min
    steady = _steady_limit(riccati, (rest, theta_max), tableau.polynomial)
    starts = _starts(riccati, initial, rest, theta_max)
    rising = rise or (lambda theta, dt: np.full_like(theta, theta_max))
    run = _Transients(riccati, theta_max, representation, rising, tableau)
    return min(steady, _transient_limit(run, starts, steady.dt), key=lambda limit: limit.dt)


# --- spectra ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Riccati:
    """F (k, n, n), C (k, p, n), R^-1 (p, p), Q (n, n)."""

    F: Array
    C: Array
    weight: Array
    Q: Array
    scaling: Scaling

    def only(self, rows: NDArray[np.intp]) -> "_Riccati":
        return replace(self, F=self.F[rows], C=self.C[rows])

    def delta(self, theta: float | Array) -> Array:
        """The diagonal of Delta (n), or (d, n) of several theta (d)."""
        return 1.0 / np.stack(np.broadcast_arrays(*self.scaling.spread(theta)), axis=-1)

    def parts(self, theta: float | Array, scale: float) -> tuple[Array, Array, Array]:
        """F, N, Q_theta at theta, in the coordinates Delta z of the theta `scale`; N and Q_theta (d, k, n, n) of
        several theta (d)."""
        delta, scaling = self.delta(scale), self.scaling
        F = delta[:, None] * self.F / delta
        C = self.C / np.sqrt(scaling.variances(np.ones(len(self.weight)), theta))[..., None, :, None]
        N = _t(C) @ self.weight @ C / np.outer(delta, delta)
        power = self.delta(scale / theta)
        Q = np.asarray(scaling.process(theta))[..., None, None] * self.Q * (power[..., None] * power[..., None, :])
        return F, N, np.broadcast_to(Q[..., None, :, :], N.shape)

    def hamiltonian(self, theta: float) -> Array:
        """The Hamiltonian matrices (k, 2n, 2n) in the coordinates Delta z."""
        F, N, Q = self.parts(theta, theta)
        return np.block([[_t(F), -N], [-Q, -F]])


def _riccati(jacobians: Array, C: Array, Q: Array, R: Array, scaling: Scaling | None) -> _Riccati:
    F = np.asarray(jacobians, dtype=float)
    C = np.broadcast_to(C, (len(F), *np.shape(C)[-2:]))
    weight: Array = np.asarray(np.linalg.inv(np.diag(R) if np.ndim(R) == 1 else R), dtype=float)
    chain = Scaling(tuple(range(len(Q))), (0,) * len(weight))
    return _Riccati(F, C, weight, np.asarray(Q, dtype=float), scaling or chain)


def _t(X: Array) -> Array:
    return X.swapaxes(-1, -2)


def _steady_limit(riccati: _Riccati, thetas: Sequence[float], polynomial: Sequence[float]) -> Limit:
    """The spectral bound, over all Jacobians; z moves with the mu, P and S with their sums."""
    limits, pairs = [], np.triu_indices(len(riccati.Q))
    for theta in dict.fromkeys(thetas):
        for i, spectrum in enumerate(np.linalg.eigvals(riccati.hamiltonian(theta))):
            mu = np.sort_complex(spectrum)[: len(riccati.Q)]
            mu = np.minimum(mu.real, 0.0) + 1j * mu.imag
            modes = np.concatenate((mu, mu[pairs[0]] + mu[pairs[1]]))
            modes = modes[np.abs(modes) > ZERO * np.abs(spectrum).max()]
            why = f"the covariance does not settle, for its steady value repels (theta = {theta:g})"
            limits.append(Limit(spectral_limit(modes, polynomial), why, i))
    return min(limits, key=lambda limit: limit.dt)


def _steady_covariance(riccati: _Riccati, theta: float) -> Array:
    """The stabilising P (k, n, n); nan where there is none."""
    n, delta = len(riccati.Q), riccati.delta(theta)
    P = np.full(riccati.F.shape, np.nan)
    for i, H in enumerate(riccati.hamiltonian(theta)):
        values, vectors = np.linalg.eig(H)
        stable = np.argsort(values.real)[:n]
        if values[stable].real.max() < -ZERO * np.abs(values).max():
            basis = vectors[:n, stable]
            if np.linalg.cond(basis) < GRAPH:
                X = np.linalg.solve(basis.T, vectors[n:, stable].T).real
                P[i] = (X + X.T) / 2.0 / np.outer(delta, delta)
    return P


# --- transients ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Start:
    """P (m, n, n), each under the Jacobian whose index `rows` gives, and how theta goes on from there."""

    name: str
    P: Array
    rows: NDArray[np.intp]
    theta: float
    rises: bool

    def only(self, mask: Flags) -> "_Start":
        return replace(self, P=self.P[mask], rows=self.rows[mask])

    def __str__(self) -> str:
        return f"{self.name} (theta {'rising from' if self.rises else '='} {self.theta:g})"


def _starts(riccati: _Riccati, initial: Array, rest: float, theta_max: float) -> tuple[_Start, ...]:
    first, rows = np.broadcast_to(initial, riccati.F.shape), np.arange(len(riccati.F))
    constant = _Start("P(0)", first, rows, rest, rises=False)
    if rest == theta_max:
        return (constant,)
    steady = _Start("the steady P", _steady_covariance(riccati, rest), rows, rest, rises=True)
    return (constant, replace(constant, rises=True), steady.only(_definite(steady.P)))


@dataclass(frozen=True)
class _Transients:
    """The step from some starts, in the coordinates Delta z of theta_max."""

    riccati: _Riccati
    theta_max: float
    representation: str
    rise: Rise
    tableau: Tableau

    def lost(self, starts: tuple[_Start, ...], lengths: Sequence[float]) -> tuple[int, tuple[_Start, ...]]:
        """Of some step lengths, the place of the first at which the step loses positive definiteness, and the starts,
        at their Jacobians, from which it does; the last place and no start where there is none."""
        end, failing = len(lengths), []
        for start in starts:
            fails = self._fails(start, lengths[:end])
            failing.append((start, fails))
            end = int(fails.any(axis=1).argmax()) + 1 if fails.any() else end
        there = (start.only(fails[end - 1]) for start, fails in failing if len(fails) >= end)
        return end - 1, tuple(start for start in there if len(start.rows))

    def _fails(self, start: _Start, lengths: Sequence[float]) -> Flags:
        """For each length (d), up to the first at which one does, at which Jacobians (m) the transient fails (d, m)."""
        many = max(1, AT_ONCE // max(1, start.P.size))
        rows = [np.zeros((0, len(start.rows)), dtype=bool)]
        for first in range(0, len(lengths), many):
            rows.append(self._run(start, lengths[first : first + many]))
            if rows[-1].any():
                break
        return np.concatenate(rows)

    def _run(self, start: _Start, lengths: Sequence[float]) -> Flags:
        """The same for lengths side by side."""
        delta, dt = self.riccati.delta(self.theta_max), np.reshape(lengths, (-1, 1, 1, 1))
        X: Array = start.P * np.outer(delta, delta)
        X = np.asarray(np.linalg.inv(X)) if self.representation == "information" else X
        X = np.broadcast_to(X, (len(lengths), *X.shape))
        riccati, theta = self.riccati.only(start.rows), np.full(len(lengths), start.theta)
        equation, alive = self._equation(riccati, start.theta), np.ones(X.shape[:2], dtype=bool)
        left = np.full((len(lengths), 1), STEPS)
        for _ in range(PATIENCE):
            if start.rises:
                theta = np.minimum(self.rise(theta, np.asarray(lengths)), self.theta_max)
                equation = self._equation(riccati, theta)
            with np.errstate(over="ignore", invalid="ignore"):  # what overflows has failed
                X = _step(X, *equation, self.tableau, dt)
                alive &= _definite(X) | (left == 0)
            left -= (left > 0) & (not start.rises or theta[:, None] > 0.9 * self.theta_max)
            if not (alive & (left > 0)).any():
                break
        return ~alive

    def _equation(self, riccati: _Riccati, theta: float | Array) -> tuple[Array, Array, Array]:
        """L, W, V of X' = L X + X L' + W - X V X."""
        F, N, Q = riccati.parts(theta, self.theta_max)
        return (-_t(F), N, Q) if self.representation == "information" else (F, Q, N)


def _step(X: Array, L: Array, W: Array, V: Array, tableau: Tableau, dt: Array) -> Array:
    slopes: list[Array] = []
    for row in tableau.a:
        stage = _combined(X, slopes, row, dt)
        half = (L - 0.5 * stage @ V) @ stage
        slopes.append(half + _t(half) + W)
    return _combined(X, slopes, tableau.b, dt)


def _combined(X: Array, slopes: list[Array], weights: Sequence[float], dt: Array) -> Array:
    X = X.copy()
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            X += dt * weight * slope
    return X


def _definite(X: Array) -> Flags:
    """Finite and positive definite, over the leading axes: the pivots of X = L D L'."""
    good: Flags = np.asarray(np.isfinite(X).all(axis=(-2, -1)))
    X = np.where(good[..., None, None], X, 0.0)
    while X.shape[-1]:
        pivot, column = X[..., 0, 0], X[..., 1:, 0]
        good = good & (pivot > 0.0)
        scale = np.where(pivot > 0.0, pivot, 1.0)[..., None, None]
        X = X[..., 1:, 1:] - column[..., :, None] * column[..., None, :] / scale
    return good


def _transient_limit(run: _Transients, starts: tuple[_Start, ...], most: float) -> Limit:
    """The first dt, going up to `most`, at which a transient fails."""
    good = bad = min(most, 1e9)
    while lost := run.lost(starts, (good,))[1]:
        first, good, bad = lost, good / 8.0, good
    if good == bad:
        return Limit(np.inf, "no transient fails")
    good, bad, first = _scan(run, starts, good, bad, COARSE, first)
    # The fine scan begins lower: where theta rises by steps, failure can have islands below.
    good, _, first = _scan(run, first, good / COARSE, bad, FINE, first)
    why = f"the covariance loses positive definiteness on the way from {first[0]}"
    return Limit(good, why, int(first[0].rows[0]))


def _scan(
    run: _Transients,
    starts: tuple[_Start, ...],
    good: float,
    bad: float,
    ratio: float,
    first: tuple[_Start, ...],
) -> tuple[float, float, tuple[_Start, ...]]:
    """Going up from `good`: the last step length without loss, the first with it, and what it loses."""
    lengths = [good]
    while lengths[-1] * ratio < bad:
        lengths.append(lengths[-1] * ratio)
    place, lost = run.lost(starts, lengths[1:])
    return (lengths[place], lengths[place + 1], lost) if lost else (lengths[-1], bad, first)
