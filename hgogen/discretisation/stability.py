"""Up to which step lengths dt an explicit Runge-Kutta method is stable, and the Riccati equation of frozen Jacobians.

Linear core. e' = M e becomes e <- R(dt M) e with the method's stability polynomial R, and is stable while
|R(dt lambda)| <= 1 for every eigenvalue lambda of M (Hairer, Wanner, Solving ODEs II, section IV.2). With z = x d,
d = lambda/|lambda|, the first x > 0 at which |R(x d)| passes 1 is a root of the real polynomial |R(x d)|^2 - 1.

Riccati equation. With Q_theta and R_theta of a `Scaling`, of one chain Q_theta = theta Delta^-1 Q Delta^-1, Delta =
diag(1, 1/theta, ..), N = C' R_theta^-1 C = theta C'R^-1 C,
    covariance   P' =  F P + P F' + Q_theta - P N P
    information  S' = -F'S - S F + N - S Q_theta S
All is computed in the coordinates Delta z, a congruence. The eigenvalues of the closed loop F - P N at the steady P are
the stable ones of the Hamiltonian [F', -N; -Q_theta, -F].
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hgogen.analysis.scaling import Scaling
from hgogen.errors import HgogenError
from hgogen.program import INF


@dataclass(frozen=True)
class Lengths:
    """Two step lengths, in the unit of the model's time.

    Above `refused` a step is refused: `why` says what happens there, and `other` which method has no such limit. Up to
    `take` a step is advised, and `basis` says how that is known. `rule`: by what the part goes, "" for the method.
    """

    refused: float = INF
    take: float = INF
    why: str = ""
    other: str = ""
    basis: str = ""
    rule: str = ""


AXIS = 1e-9  # for eig's rounding: |Re z| below which a unit z is imaginary, |z|/max below which it is 0


def spectral_limit(spectrum: NDArray[np.complex128], polynomial: Sequence[float]) -> float:
    """The largest dt with |R(h lambda)| <= 1 for all 0 < h <= dt and each lambda; inf for none."""
    upper = map(complex, spectrum[spectrum.imag >= 0.0])  # the others are conjugates
    return min((_passed(each / abs(each), tuple(polynomial)) / abs(each) for each in upper), default=np.inf)


@lru_cache(maxsize=1024)  # all real eigenvalues, and those of points with the same slopes, lie on the same rays
def _passed(direction: complex, polynomial: tuple[float, ...]) -> float:
    """The first x at which |R(x direction)| passes 1: a root of the real polynomial |R|^2 - 1 of x; inf for none."""
    terms = np.array([c * direction**k for k, c in enumerate(polynomial)])
    excess = np.convolve(terms.real, terms.real) + np.convolve(terms.imag, terms.imag)
    excess[0] -= 1.0
    excess[np.abs(excess) < AXIS] = 0.0  # on the imaginary axis the low powers cancel and leave rounding
    roots = np.roots(excess[::-1])
    edges = np.sort(roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)])
    edges = np.concatenate(([0.0], edges, [2.0 * edges.max(initial=1.0)]))
    grows = np.polyval(excess[::-1], (edges[1:] + edges[:-1]) / 2.0) > 0.0
    return float(edges[np.argmax(grows)]) if grows.any() else np.inf


Array = NDArray[np.float64]

ZERO = 1e-6  # what AXIS is, for the Hamiltonian, whose double zeros rounding splits by the root of eps
GRAPH = 1e12  # condition of the Hamiltonian's stable subspace from which on it is no graph: a growing mode is hidden
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
    return Riccati.of(jacobians, C, Q, R, scaling).steady(theta)


def closed_loop_rates(
    jacobians: Array, C: Array, Q: Array, R: Array, theta: float, scaling: Scaling | None = None
) -> Array:
    """The rates at which the error decays under the steady P, the slowest first (k, n), at each F (k, n, n) and
    C (k, p, n); 0 where a mode is hidden. Other arguments as in `steady_covariance`."""
    spectra = np.abs(np.linalg.eigvals(Riccati.of(jacobians, C, Q, R, scaling).hamiltonian(theta)).real)
    return np.asarray(np.sort(spectra, axis=1)[:, ::2])  # each twice: they lie symmetric about the imaginary axis


@dataclass(frozen=True)
class Riccati:
    """F (k, n, n), C (k, p, n), R^-1 (p, p), Q (n, n)."""

    F: Array
    C: Array
    weight: Array
    Q: Array
    scaling: Scaling

    @classmethod
    def of(cls, jacobians: Array, C: Array, Q: Array, R: Array, scaling: Scaling | None) -> "Riccati":
        """Of the arguments of `steady_covariance`, R a matrix (p, p) or its diagonal (p)."""
        F = np.asarray(jacobians, dtype=float)
        C = np.broadcast_to(C, (len(F), *np.shape(C)[-2:]))
        weight: Array = np.asarray(np.linalg.inv(np.diag(R) if np.ndim(R) == 1 else R), dtype=float)
        chain = Scaling(tuple(range(len(Q))), (0,) * len(weight))
        return cls(F, C, weight, np.asarray(Q, dtype=float), scaling or chain)

    def only(self, rows: NDArray[np.intp]) -> "Riccati":
        """At those of the Jacobians."""
        return replace(self, F=self.F[rows], C=self.C[rows])

    def delta(self, theta: float | Array) -> Array:
        """The diagonal of Delta (n), or (d, n) of several theta (d)."""
        return 1.0 / np.stack(np.broadcast_arrays(*self.scaling.spread(theta)), axis=-1)

    def parts(self, theta: float | Array, scale: float) -> tuple[Array, Array, Array]:
        """F, N, Q_theta at theta, or at one (k) for each F, in the coordinates Delta z of the theta `scale`."""
        delta, scaling = self.delta(scale), self.scaling
        F = delta[:, None] * self.F / delta
        C = self.C / np.sqrt(scaling.variances(np.ones(len(self.weight)), theta))[..., :, None]
        N = transposed(C) @ self.weight @ C / np.outer(delta, delta)
        power = self.delta(scale / theta)
        Q = np.asarray(scaling.process(theta))[..., None, None] * self.Q * (power[..., None] * power[..., None, :])
        return F, N, np.broadcast_to(Q, N.shape)

    def hamiltonian(self, theta: float) -> Array:
        """The Hamiltonian matrices (k, 2n, 2n) in the coordinates Delta z."""
        F, N, Q = self.parts(theta, theta)
        return np.block([[transposed(F), -N], [-Q, -F]])

    def steady(self, theta: float) -> Array:
        """The stabilising P (k, n, n); nan where there is none."""
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


def transposed(X: Array) -> Array:
    """The matrices X (.., n, n) transposed."""
    return X.swapaxes(-1, -2)
