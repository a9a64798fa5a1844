"""The Riccati observer on P = L D L' as statements: straight-line code, and what `looped` shares with it.

Both do  z by one classical Runge-Kutta step, Phi = I + hF + (hF)^2/2 at its midpoint, P <- Phi P Phi' + h Q_theta,
and scalar updates with r = R_theta/h. Where a variance P_ii exceeds its cap, rows of L are scaled, a congruence, which
keeps what the last samples showed. h Q_theta keeps the rank. A part that forgets needs no cap:

    P <- exp(rho h) Phi P Phi' + h Q_0,   P^-1 <- P^-1 + (1 - exp(-rho h)) S_0,   S_0 = diag(1/cap_i)

The second is a scalar update for each state, of a sample that is the estimate: it moves P alone. Where A = 0 both
together are S <- exp(-rho h) S + (1 - exp(-rho h)) S_0, exact for any h but for Q_0.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation.growth import BY_TRIAL
from hgogen.discretisation.routine import routine
from hgogen.discretisation.runge_kutta import RK4, Stages, advance
from hgogen.discretisation.stability import Lengths
from hgogen.estimators.closed_loop import advised
from hgogen.estimators.covariance import (
    factor,
    lower,
    measurement_update,
    pack,
    packed_triangle,
    prior_status,
    time_update,
    unpack_lower,
)
from hgogen.estimators.riccati_part import Riccati
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Place, Program, When, column, scalar, sym
from hgogen.signal import LOST

# D_i stays above SMALLEST of its natural size and |L_ij| within LARGEST of its own: both only catch rounding.
SMALLEST, LARGEST, TINY = 1e-12, 1e9, 1e-35
Factors = Callable[[Graph], dict[Place, Graph]]  # of a vector (n), those of P as writes
_READ = ("z", "u", "y", "valid")  # by the flow and the Jacobian, in this order
POINTS = 12  # corners, and as many points inside, at which the model's growth is judged


@dataclass(frozen=True)
class Moved:
    """z over one step, F at its midpoint, and Phi = I + hF + (hF)^2/2 as an operator."""

    part: Riccati
    clock: Clock

    @property
    def z(self) -> Graph:
        """The symbols of z (n)."""
        return sym("state", self.part.z.name, self.part.dynamics.n)

    def stages(self) -> Stages:
        """The Runge-Kutta step of z."""
        return self.stages_from(self.z)

    def stages_from(self, z: Graph) -> Stages:
        """The Runge-Kutta step of another state (n)."""
        return advance(RK4, lambda v, c: {"z": self._flow(v["z"], c)["dz"]}, {"z": z}, self.clock.dt)

    @cached_property
    def _flow(self) -> Callable[[Graph, float], dict[str, Graph]]:
        return self._routine("flow", lambda *at: {"dz": self.part.flow(*at)})

    def jacobian(self, stages: Stages) -> Graph:
        """F (n, n) at the third stage's argument and the signals at mid-step."""
        jacobian = self._routine("jacobian", lambda *at: {"F": self.part.jacobian(*at)})
        return jacobian(stages.arguments[2]["z"], 0.5)["F"]

    def _routine(self, name: str, body: Callable[..., dict[str, Graph]]) -> Callable[[Graph, float], dict[str, Graph]]:
        """A routine of z and of the signals at a fraction of the step."""
        sizes = {"z": self.part.dynamics.n, **self.clock.sizes}
        call = routine(name, sizes, lambda at: body(*({**at, **self.clock.constants}[key] for key in _READ)))
        return lambda z, c: call({"z": z, **self.clock.signals(c)})

    def transition(self, stages: Stages) -> Graph:
        """Phi = I + hF + (hF)^2/2, sparse."""
        return self.transition_of(self.jacobian(stages))

    def transition_of(self, F: Graph) -> Graph:
        """The same of a matrix F."""
        h = self.clock.dt
        return ca.sparsify(ca.SX.eye(self.part.dynamics.n) + h * F + (h * h / 2) * (F @ F))

    def weights(self) -> Graph:
        """h theta^(1+g) weights, the diagonal of h Q_theta in its factor (k)."""
        return self.clock.dt * self.part.scaling.process(self.part.theta.value) * self.part.weights

    def grown(self, d: Graph) -> Graph:
        """The diagonal factor d (n) of P as it grows where the past is forgotten."""
        return d if self.part.forgetting is None else sym("derived", "growth") * d

    def priors(self) -> list[Graph]:
        """Rows (1, n) whose samples, of variance 1, have the information (1 - exp(-rho h)) S_0."""
        return [ca.sparsify(row) for row in ca.vertsplit(ca.diag(sym("derived", "prior", self.part.dynamics.n)))]

    @property
    def equation(self) -> str:
        """The equation of P over one step."""
        if self.part.forgetting is not None:
            return "P <- exp(rho h) Phi P Phi' + h Q_0"
        return "P <- Phi P Phi'" + (" + h Q_theta" if self.part.factor.size else "")

    def row(self, output: int) -> Graph:
        """The row c = dh/dz (1, n) of an output, sparse."""
        return ca.sparsify(self.part.dynamics.output_jacobian(self.z, self.clock.u_now)[output, :])

    def variance(self, output: int) -> Graph:
        """The variance r = R_theta/h of an output, h its sampling period."""
        return self.part.scaling.variance(self.part.R[output], self.part.theta.value, output, self.clock.period(output))

    def corrected(
        self, gain: Graph, error: Graph, factors: Mapping[Place, Graph], title: str = "correct by the scalar update"
    ) -> Block:
        """z moved by a gain (n) times an error, with the writes of the factors of P."""
        z = {Place("state", self.part.z.name): self.z + gain * error}
        return Block(title, {**z, **factors}, {f"K{i + 1}": k for i, k in enumerate(ca.vertsplit(gain))})


def entries(name: str, matrix: Graph) -> dict[str, Graph]:
    """The computed entries of a sparse SX matrix by name, for the C printer."""
    rows, columns = matrix.shape
    listed = ((i, j, matrix[i, j]) for i in range(rows) for j in range(columns))
    return {f"{name}_{i + 1}{j + 1}": entry for i, j, entry in listed if entry.n_dep()}


def common(part: Riccati, clock: Clock) -> dict[str, Any]:
    """What the pieces of every factored covariance have: the status bit, and of one that forgets exp(rho h) and the
    roots of (1 - exp(-rho h)) S_0. Both come of one rounding of exp, so that S tends to S_0 however small rho h is."""
    always = {"bits": (part.limited,), "uses_output": part.known is not None}
    if part.forgetting is None:
        return always
    growth = ca.exp(part.rho * clock.dt)
    share = ca.fmax(growth - 1, 0) / growth
    prior = ca.sqrt(share / ca.SX(ca.DM(part.cap)))
    meaning = "roots of (1 - exp(-rho dt)) S_0, what a step adds of the prior"
    return {
        **always,
        "derived": (
            scalar("growth", 1.0, meaning="exp(rho dt), by which the covariance grows in a step"),
            Field("prior", (0.0,) * len(part.cap), meaning=meaning),
        ),
        "tune": (Block("what a step forgets", {Place("derived", "growth"): growth, Place("derived", "prior"): prior}),),
    }


def factored_lengths(part: Riccati, dt: float) -> Lengths:
    """The step lengths of the closed loop, which are those of every factored covariance."""
    refused, take = advised(part, dt)
    why = "beyond it no error settles, wherever in the declared box it was tried"
    return Lengths(refused=refused, take=take, why=why, basis=BY_TRIAL)


def smallest(part: Riccati, clock: Clock, values: np.ndarray) -> np.ndarray:
    """What each D_i (n) stays above: a share of its natural size, that of P(0) = `values`, of the noise that one step
    adds, and of one sample's variance, the smallest."""
    noise, variances = part.nominal
    natural = np.minimum(values, clock.dt * factor(noise)[1]) if part.factor.size else values.copy()
    least = min(part.scaling.variances(variances, theta).min() for theta in (1.0, part.theta.peak))
    natural[0] = min(natural[0], least / max(clock.period(j) for j in range(clock.outputs)))
    return np.maximum(SMALLEST * natural, TINY)


def largest(part: Riccati) -> np.ndarray:
    """What each P_ii (n) stays below: its cap; where the past is forgotten, twice (1 + 2 mu/rho) cap_i at the smallest
    rho, mu the largest logarithmic norm of F in units of sqrt(cap), at points of the box, or 0. For S' = -rho (S - S_0)
    - F'S - S F + .. keeps S_0^-1/2 S S_0^-1/2 above rho/(rho + 2 mu), and twice is for what Q_0 adds and the points
    miss."""
    if part.forgetting is None:
        return part.cap
    unit = np.sqrt(part.cap)
    F = part.slopes(POINTS)[0] * unit / unit[:, None]
    mu = np.linalg.eigvalsh((F + np.swapaxes(F, 1, 2)) / 2).max(initial=0.0)
    return np.asarray(np.minimum(2 * (1 + 2 * mu / part.forgetting.low[0]) * part.cap, LOST))


def diagonal(part: Riccati, clock: Clock, values: np.ndarray) -> Field:
    """The field of D (n), which begins with these values."""
    return Field(
        "D",
        tuple(float(value) for value in values),
        low=tuple(map(float, smallest(part, clock, values))),
        high=tuple(map(float, largest(part))),
        meaning="diagonal factor of the covariance P = L D L'",
    )


def unrolled(part: Riccati, clock: Clock) -> Pieces:
    """Straight-line code; L packed by columns."""
    L, d = _symbols(part)

    def scaled(scale: Graph) -> dict[Place, Graph]:
        return _written(ca.diag(scale) @ L @ ca.diag(1 / scale), scale**2 * d)

    forgets = part.forgetting is not None
    bounded = _renewed(part, clock) if forgets else capped(clock, part, _variances(part), scaled)
    moved, update = Moved(part, clock), []
    for j in range(clock.outputs):
        *factors, gain = measurement_update(L, d, moved.row(j), moved.variance(j))
        update.append((moved.corrected(gain, sym("work", "e"), _written(*factors)),))
    return Pieces(
        fields=(part.z, *_factors(part, clock)),
        covariance=L @ ca.diag(d) @ L.T,
        **common(part, clock),
        predict=(_predict(part, clock), *bounded),
        update=tuple(update),
    )


def _factors(part: Riccati, clock: Clock) -> tuple[Field, ...]:
    n, deviation = part.dynamics.n, np.sqrt(part.cap)
    start, values = factor(part.covariance)
    if n == 1:
        return (diagonal(part, clock, values),)
    ends = tuple(float(LARGEST * deviation[i] / deviation[j]) for i, j in lower(n, 1))
    meaning = "unit lower factor of P, strict lower triangle"
    L = packed_triangle("L", start, meaning, 1, low=tuple(-end for end in ends), high=ends)
    return (L, diagonal(part, clock, values))


def _symbols(part: Riccati) -> tuple[Graph, Graph]:
    n = part.dynamics.n
    return unpack_lower(sym("state", "L", n * (n - 1) // 2), n, 1), sym("state", "D", n)


def _written(L: Graph, d: Graph) -> dict[Place, Graph]:
    written = {Place("state", "L"): ca.densify(pack(L, 1))} if d.numel() > 1 else {}
    return written | {Place("state", "D"): d}


def _predict(part: Riccati, clock: Clock) -> Block:
    moved = Moved(part, clock)
    stages = moved.stages()
    transition, (L, d) = moved.transition(stages), _symbols(part)
    L, d, names = time_update(L, moved.grown(d), transition, part.scaled_factor(), moved.weights())
    return Block(
        f"z by classical Runge-Kutta; P = L D L' by {moved.equation}",
        {Place("state", part.z.name): stages.result["z"], **_written(L, d)},
        {**stages.names, **entries("Phi", transition), **names},
    )


def _renewed(part: Riccati, clock: Clock) -> Program:
    blocks = []
    for i, row in enumerate(Moved(part, clock).priors(), 1):
        L, d, _ = measurement_update(*_symbols(part), row, ca.SX(1))
        blocks.append(Block(f"what is forgotten of z{i} tends to S_0", _written(L, d)))
    return (*blocks, prior_status(part, _variances(part)))


def _variances(part: Riccati) -> list[Graph]:
    L, d = _symbols(part)
    return [ca.dot(L[i, :].T ** 2, d) for i in range(part.dynamics.n)]


def capped(clock: Clock, part: Riccati, variance: list[Graph], scaled: Factors) -> Program:
    """The program that caps P where a P_ii (`variance`) exceeds its cap: it writes the factors `scaled` of
    min(1, cap_i/P_ii) (n), a congruence. Nothing without guards."""
    if not clock.guarded:
        return ()
    caps = [float(value) for value in part.cap]
    scale = column(ca.fmin(1, cap / value) for cap, value in zip(caps, variance, strict=True))
    beyond = reduce(ca.logic_or, [value > cap for cap, value in zip(caps, variance, strict=True)])
    limited = {Place("status", "COVARIANCE_LIMITED"): ca.SX(1)}
    return (
        Block("largest variances", {Place("work", "capped"): beyond}),
        When(Place("work", "capped"), (Block("cap", {**scaled(scale), **limited}),)),
    )
