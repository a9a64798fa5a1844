"""The Riccati observer on P = L D L' as statements: unrolled for few states, with loops over columns for many.

Both do  z by one classical Runge-Kutta step, Phi = I + hF + (hF)^2/2 at its midpoint, P <- Phi P Phi' + h Q_theta,
and scalar updates with r = R_theta/h. Where a variance P_ii exceeds its cap, rows of L are scaled, a congruence, which
keeps what the last samples showed, and h Q_theta keeps the rank. A part that forgets has no Q: Phi and the congruence,
turn by turn, would bring the correlation to 1 and D_n to 0 in a long silence, and the first sample after it would be
taken to tell every state. There, after a silence of 1/rho, P starts anew, L = 1, D_i = min(P_ii, cap_i/4), with
log(4)/rho to correlate in; the status stands from cap_i/4 on, between one start and the next. While samples come the
congruence stays: a start would cost what they have told of the other states.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from hgogen.covariance import factor, measurement_update, pack_unit_lower, time_update, unit_lower
from hgogen.observer import HUGE, BadGain, Clock, Pieces
from hgogen.program import Bit, Block, Field, Group, Kernel, Loop, Program, When, column, scalar, sym
from hgogen.riccati import Riccati
from hgogen.runge_kutta import HEUN, RK4, Stages, advance
from hgogen.stability import decay_limits

# D_i stays above SMALLEST of its natural size and |L_ij| within LARGEST of its own: both only catch rounding.
SMALLEST, LARGEST, TINY = 1e-12, 1e9, 1e-35
Factors = Callable[[Any], dict[str, Any]]  # of a vector (n), those of P as writes
SILENT = 2.0  # up to which silence is counted, in 1/rho
POINTS = 12  # corners, and as many points inside, at which the model's decay is judged

CAPPED = Bit(
    "COVARIANCE_LIMITED",
    "the covariance reached its cap: a long loss of measurements, or Q and R much too large for the declared ranges",
    "wait for measurements; if it stays while they come, scale Q and R down together",
)


HIDDEN = Bit(
    "COVARIANCE_LIMITED",
    "the covariance is at its cap, in silence a quarter of it: samples are missing, or the input shows too little",
    "excite the plant; if it stays while the input varies, lower rho, or scale R down",
)


@dataclass(frozen=True)
class Moved:
    """z over one step, F at its midpoint, and Phi = I + hF + (hF)^2/2 as an operator."""

    part: Riccati
    clock: Clock

    @property
    def z(self) -> Any:
        """The symbols of z (n)."""
        return sym(f"state.{self.part.z.name}", self.part.dynamics.n)

    def stages(self) -> Stages:
        """The Runge-Kutta step of z."""
        return advance(RK4, lambda v, c: {"z": self.part.flow(v["z"], *self._given(c))}, {"z": self.z}, self.clock.dt)

    def jacobian(self, stages: Stages) -> Any:
        """F (n, n), at the third stage's argument and what is given at mid-step."""
        return self.part.jacobian(stages.arguments[2]["z"], *self._given(0.5))

    def transition(self, stages: Stages) -> Any:
        """Phi = I + hF + (hF)^2/2, sparse."""
        F, h = self.jacobian(stages), self.clock.dt
        return ca.sparsify(ca.SX.eye(self.part.dynamics.n) + h * F + (h * h / 2) * (F @ F))

    def weights(self) -> Any:
        """h theta^(1+g) weights, the diagonal of h Q_theta in its factor (k)."""
        return self.clock.dt * self.part.scaling.process(self.part.theta.value) * self.part.weights

    def grown(self, d: Any) -> Any:
        """The diagonal factor d (n) of P as it grows where the past is forgotten."""
        return d if self.part.forgetting is None else sym("derived.growth") * d

    @property
    def equation(self) -> str:
        """Of P over one step."""
        grows = "" if self.part.forgetting is None else "exp(rho h) "
        return f"P <- {grows}Phi P Phi'" + (" + h Q_theta" if self.part.factor.size else "")

    def _given(self, c: float) -> tuple[Any, Any, Any]:
        """Input, measurement and its validity at the fraction c of the step."""
        return self.clock.u(c), self.clock.y(c), self.clock.valid

    def row(self, output: int) -> Any:
        """c = dh/dz of an output (1, n), sparse."""
        return ca.sparsify(self.part.dynamics.output_jacobian(self.z, self.clock.u_now)[output, :])

    def variance(self, output: int) -> Any:
        """r = R_theta/h, h the sampling period of that output."""
        return self.part.scaling.variance(self.part.R[output], self.part.theta.value, output, self.clock.period(output))


def entries(name: str, matrix: Any) -> dict[str, Any]:
    """Those of a sparse SX matrix that are computed, by name, for the C printer."""
    rows, columns = matrix.shape
    listed = ((i, j, matrix[i, j]) for i in range(rows) for j in range(columns))
    return {f"{name}_{i + 1}{j + 1}": entry for i, j, entry in listed if entry.n_dep()}


def common(part: Riccati, clock: Clock) -> dict[str, Any]:
    """What the pieces of every factored covariance have: the status bit of the cap, the growth exp(rho h), and the step
    lengths. P has no limit on h, but Phi follows a decaying mode of the model only while |1 + x + x^2/2| <= 1, x = h
    lambda."""
    limits = decay_limits(part.slopes(POINTS)[0], HEUN.polynomial)
    why = "nowhere in the declared box does Phi = I + hF + (hF)^2/2 follow the model's decay beyond it"
    found: dict[str, Any] = {
        "limit": float(limits.max()),
        "caution": float(limits.min()),
        "why": why,
        "bits": (CAPPED,),
    }
    found["uses_output"] = part.known is not None
    if part.forgetting is not None:
        found["bits"] = (HIDDEN,)
        growth = ca.exp(part.forgetting[0] * clock.dt)
        found["derived"] = (scalar("growth", 1.0, meaning="exp(rho dt), by which the covariance grows in a step"),)
        found["tune"] = (Block("growth of the covariance over one step", {"derived.growth": growth}),)
    return found


def smallest(part: Riccati, clock: Clock, values: np.ndarray) -> np.ndarray:
    """What each D_i (n) stays above: a share of its natural size, that of P(0) = `values`, of the noise that one step
    adds, and of one sample's variance, the smallest."""
    noise, variances = part.nominal
    natural = np.minimum(values, clock.dt * factor(noise)[1]) if part.factor.size else values.copy()
    least = min(part.scaling.variances(variances, theta).min() for theta in (1.0, part.theta.peak))
    natural[0] = min(natural[0], least / max(clock.period(j) for j in range(clock.outputs)))
    return np.maximum(SMALLEST * natural, TINY)


def _diagonal(part: Riccati, clock: Clock, values: np.ndarray) -> Field:
    return Field(
        "D",
        tuple(float(value) for value in values),
        low=tuple(map(float, smallest(part, clock, values))),
        high=tuple(float(value) for value in part.cap),
        meaning="diagonal factor of the covariance P = L D L'",
    )


# ---------------------------------------------------------------- unrolled


def unrolled(part: Riccati, clock: Clock) -> Pieces:
    """Straight-line code; L packed by columns."""
    return Pieces(
        fields=(part.z, *_factors(part, clock), *counters(part)),
        **common(part, clock),
        predict=(_predict(part, clock), *_cap(part, clock)),
        update=tuple(_update(part, clock, j) for j in range(clock.outputs)),
    )


def _factors(part: Riccati, clock: Clock) -> tuple[Field, ...]:
    n, deviation = part.dynamics.n, np.sqrt(part.cap)
    start, diagonal = factor(part.covariance)
    pairs = [(i, j) for j in range(n) for i in range(j + 1, n)]
    if not pairs:
        return (_diagonal(part, clock, diagonal),)
    L = Field(
        "L",
        tuple(float(start[i, j]) for i, j in pairs),
        low=tuple(float(-LARGEST * deviation[i] / deviation[j]) for i, j in pairs),
        high=tuple(float(LARGEST * deviation[i] / deviation[j]) for i, j in pairs),
        labels=tuple(f"{i + 1},{j + 1}" for i, j in pairs),
        meaning="unit lower factor of P, strict lower triangle by columns",
    )
    return (L, _diagonal(part, clock, diagonal))


def _symbols(part: Riccati) -> tuple[Any, Any]:
    n = part.dynamics.n
    lower = unit_lower(sym("state.L", n * (n - 1) // 2), n) if n > 1 else ca.SX.eye(1)
    return lower, sym("state.D", n)


def _written(L: Any, d: Any) -> dict[str, Any]:
    return {"state.L": ca.densify(pack_unit_lower(L)), "state.D": d} if d.numel() > 1 else {"state.D": d}


def _predict(part: Riccati, clock: Clock) -> Block:
    moved = Moved(part, clock)
    stages = moved.stages()
    transition, (L, d) = moved.transition(stages), _symbols(part)
    L, d, names = time_update(L, moved.grown(d), transition, part.scaled_factor(), moved.weights())
    return Block(
        f"z by classical Runge-Kutta; P = L D L' by {moved.equation}",
        {f"state.{part.z.name}": stages.result["z"], **_written(L, d)},
        {**stages.names, **entries("Phi", transition), **names},
    )


def _cap(part: Riccati, clock: Clock) -> Program:
    L, d = _symbols(part)
    variance = [ca.dot(L[i, :].T ** 2, d) for i in range(part.dynamics.n)]

    def scaled(scale: Any) -> dict[str, Any]:
        return _written(ca.diag(scale) @ L @ ca.diag(1 / scale), scale**2 * d)

    return capped(part, clock, variance, scaled, lambda diagonal: _written(ca.SX.eye(diagonal.numel()), diagonal))


def capped(part: Riccati, clock: Clock, variance: list[Any], scaled: Factors, anew: Factors) -> Program:
    """Where a P_ii (`variance`) exceeds its cap: the factors `scaled` of min(1, cap_i/P_ii) (n), the congruence; of a
    part that forgets, in silence, those `anew` of the diagonal min(P_ii, cap_i/4) (n)."""
    caps = [float(value) for value in part.cap]
    quarters = [cap / 4 for cap in caps]
    over, limited = _beyond(variance, caps), {"status.COVARIANCE_LIMITED": ca.SX(1)}
    scale = column(ca.fmin(1, cap / value) for cap, value in zip(caps, variance, strict=True))
    scaling = When("work.capped", (Block("cap", {**scaled(scale), **limited}),))
    if part.forgetting is None:
        return (Block("largest variances", {"work.capped": over}), scaling)
    silence, counted = _silence(part, clock)
    tests = {"work.capped": ca.logic_and(over, ca.logic_not(silence)), "work.anew": ca.logic_and(over, silence)}
    limited = {"status.COVARIANCE_LIMITED": ca.logic_and(_beyond(variance, quarters), silence)}
    diagonal = column(ca.fmin(quarter, value) for quarter, value in zip(quarters, variance, strict=True))
    start = Block("in silence the covariance starts anew, without correlation", anew(diagonal))
    return (Block("largest variances", {**tests, **limited, **counted}), scaling, When("work.anew", (start,)))


def _beyond(variance: list[Any], limits: list[float]) -> Any:
    return reduce(ca.logic_or, [value > limit for value, limit in zip(variance, limits, strict=True)])


def _silence(part: Riccati, clock: Clock) -> tuple[Any, dict[str, Any]]:
    """Has no output had a usable sample for 1/rho? And the time without one, as it is written."""
    assert part.forgetting is not None
    heard = reduce(ca.logic_or, [clock.valid[j] for j in range(clock.outputs)])
    silent = ca.if_else(heard, 0, ca.fmin(sym("state.silence") + part.forgetting[0] * clock.dt, SILENT))
    return silent >= 1, {"state.silence": silent}


def counters(part: Riccati) -> tuple[Field, ...]:
    """The time without a sample, of a part that forgets."""
    if part.forgetting is None:
        return ()
    return (scalar("silence", 0.0, low=0.0, high=SILENT, meaning="rho times the time without a sample, at most 2"),)


def _update(part: Riccati, clock: Clock, output: int) -> Program:
    moved = Moved(part, clock)
    L, d, gain = measurement_update(*_symbols(part), moved.row(output), moved.variance(output))
    return (
        Block(
            "correct by the scalar update",
            {f"state.{part.z.name}": moved.z + gain * sym("work.e"), **_written(L, d)},
            {f"K{i + 1}": gain[i] for i in range(part.dynamics.n)},
        ),
    )


# ---------------------------------------------------------------- loops


def looped(part: Riccati, clock: Clock) -> Pieces:
    """L as the columns of a group, matrix operations as kernels; needs diagonal Q and P(0).

    Raises: `BadGain` where they are not.
    """
    n = part.dynamics.n
    for name, matrix in (("Q", part.nominal[0]), ("covariance", part.covariance)):
        if np.count_nonzero(matrix - np.diag(np.diag(matrix))):
            raise BadGain(name, f"must be diagonal for {n} states; full matrices are for up to 7")
    columns = Field("v", (0.0,) * n, meaning="rows below the diagonal")
    return Pieces(
        fields=(part.z, _diagonal(part, clock, np.diag(part.covariance).copy()), *counters(part)),
        groups=(Group("column", n, (columns,), "columns of the unit lower factor of P"),),
        **common(part, clock),
        predict=_looped_predict(part, clock),
        update=tuple(_looped_update(part, clock, j) for j in range(clock.outputs)),
    )


def _looped_predict(part: Riccati, clock: Clock) -> Program:
    moved, n, h = Moved(part, clock), part.dynamics.n, clock.dt
    stages = moved.stages()
    F = ca.sparsify(moved.jacobian(stages))
    entries = sym("work.F", F.nnz())
    held = ca.SX(F.sparsity(), entries)
    v = sym("column.v", n)
    noise: Program = ()
    if part.factor.size:
        scaled = Block("h Q_theta", {"work.w": moved.weights() * part.spread() ** 2})
        noise = (scaled, Kernel("add", n, "column.v", (("state.D", n), ("work.w", n))))
    return (
        Block(
            "z by classical Runge-Kutta; the Jacobian F at mid-step, its entries by columns",
            {f"state.{part.z.name}": stages.result["z"], "work.F": ca.vertcat(*F.nonzeros())},
            stages.names,
        ),
        Kernel("expand", n, "column.v"),
        Loop(
            "column",
            n,
            (Block("a column of Phi L", {"column.v": v + h * (held @ (v + h / 2 * (held @ v)))}),),
        ),
        *((Block("forgetting", {"state.D": moved.grown(sym("state.D", n))}),) if part.forgetting is not None else ()),
        Kernel("triangularise", n, "column.v", (("state.D", n),)),
        *noise,
        Block("largest variances", {"work.caps": ca.SX(ca.DM(part.cap))}),
        *_looped_cap(part, clock),
        When("work.capped", (Block("capped", {"status.COVARIANCE_LIMITED": ca.SX(1)}),)),
        *_looped_keep(n),
    )


def _looped_cap(part: Riccati, clock: Clock) -> Program:
    n = part.dynamics.n

    def rule(name: str) -> Kernel:
        return Kernel(name, n, "column.v", (("state.D", n), ("work.caps", n)), result="work.capped")

    if part.forgetting is None:
        return (rule("cap"),)
    silence, counted = _silence(part, clock)
    test = Block("no sample for 1/rho?", {"work.silent": silence, **counted})
    return (test, When("work.silent", (rule("decorrelate"),), (rule("cap"),)))


def _looped_keep(n: int) -> Program:
    v = sym("column.v", n)
    kept = column(ca.if_else(ca.fabs(v[i]) <= HUGE * HUGE, v[i], 0) for i in range(n))
    return (Loop("column", n, (Block("a lost value restarts", {"column.v": kept}),)),)


def _looped_update(part: Riccati, clock: Clock, output: int) -> Program:
    moved, n = Moved(part, clock), part.dynamics.n
    row = {"work.c": ca.densify(moved.row(output)).T, "work.r": moved.variance(output)}
    arguments = (("state.D", n), ("work.c", n), ("work.r", 1), ("work.K", n))
    gain = sym("work.K", n)
    return (
        Block("the measurement's row and variance", row),
        Kernel("correct", n, "column.v", arguments),
        Block("correct", {f"state.{part.z.name}": moved.z + gain * sym("work.e")}),
    )
