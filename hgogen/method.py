"""A method turns the differential equations of an observer into the statements of a step, and limits the step length.

It uses the stages of a tableau, or a sampled-data realisation of the linear core with a scheme of order 2 for the
nonlinear residual terms:

    x' = M x + B v + r(x, u, y),  v = y - o(u)                 M, B constant: the core of `Ode.linear`
    a  = Phi x + Gamma_0 v_0 + Gamma_1 v_1 + Psi_0 r_0         r_0 = r(x, u_0, y_0)
    x+ = a + Psi_1 (r_1 - r_0)                                 r_1 = r(a, u_1, y_1)

where 0 and 1 are the ends of a step. A method gives the matrices, which `tune` computes from the gains. Where a sample
is missing, M and B are those of `Ode.linear` without it. The core sets no limit to the step; the residual terms do.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, product
from typing import Literal, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from hgogen.analysis.linearised import jacobians_on_box
from hgogen.discretisation import explicit_covariance
from hgogen.discretisation.runge_kutta import RATE, RK4, Tableau, Values, advance, rounds, routine
from hgogen.discretisation.stability import EVERYWHERE, Lengths, Limit, core_limit, decay_limits, pace, polynomial
from hgogen.errors import BadArgument, HgogenError
from hgogen.estimators.core import Core, core, nominal, numbers
from hgogen.estimators.riccati_part import Riccati, riccati_ode, symmetric_covariance
from hgogen.estimators.step_lengths import first_unstable, lengths
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, NeedsFixedStep, Ode, Pieces
from hgogen.program import INF, Block, Field, Kernel, Place, Program, Repeat, When, address, sym
from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.inequality import Inequality, Realisation, realised_step, runge_kutta_step
from hgogen.prove.method_error import CoreDeviation, LocalError, StageDeviation
from hgogen.prove.plant_step import ErrorInput, PlantStep
from hgogen.sentence import NONE, Reason, because

POINTS = 6  # corners, and as many points inside, at which the stability of the covariance equation is tested
Rate = Callable[[Values, float | Graph], Values]
FACTORED = "the method continuous_discrete keeps it definite at any dt"


MOST = 3  # outputs: each may be missing, and every pattern of samples has its own matrices
MEANINGS = {  # of the matrices, whose structurally nonzero elements are stored
    "Phi": "the core's transition over a step",
    "Gamma_0": "weight of the last sample",
    "Gamma_1": "weight of this sample",
    "Psi_0": "weight of the nonlinear rest",
    "Psi_1": "weight of the change of the nonlinear rest",
}
Pattern = tuple[bool, ...]  # which outputs have a sample


@dataclass(eq=False)
class InfiniteCore(HgogenError):
    """The error that the matrix M of a linear error core e' = M e has entries beyond the range of a double."""

    text = "the error core has numbers beyond the range of a double; choose smaller gains, or other units"


@dataclass(eq=False)
class NoCovariance(HgogenError):
    """The error for a method that integrates the covariance P, applied to an observer without P."""

    text = "{method} is a method for the covariance of a Riccati observer, here there is none: take rk4"
    method: str


class NoRealisation(BadArgument):
    """The error for an observer without a linear part x' = M x + B v of constant coefficients that `Realising` could
    discretise."""

    text = "{what} realises a linear error core with constant coefficients; {reason}"


class Method(Protocol):
    """A discretisation: a rule that integrates the differential equations of an observer over a step, and a rule for
    estimate and covariance of a Riccati observer."""

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        ...

    @property
    def equations(self) -> tuple[str, ...]:
        """The equations of a step, in lines for reports; h is its length."""
        ...

    @property
    def prediction(self) -> Tableau | None:
        """The tableau that integrates the model while samples are missing; None if the method is `Realising`."""
        ...

    def __hash__(self) -> int:
        """Return a hash; equal methods make the same step of an observer, which is cached."""
        ...

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Return memory and statements that integrate `part` over a step; y varies linearly between two valid
        samples."""
        ...

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Return memory and statements that integrate a Riccati observer, estimate and covariance, over a step."""
        ...

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """Return the refused and the advised step length for the stability of `part`, as far as `dt` requires."""
        ...

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return the step lengths up to which the Riccati observer is stable, computed as far as `dt` requires."""
        ...


@runtime_checkable
class ProvableMethod(Protocol):
    """A method whose discrete-time error dynamics are known, so that convergence of the discretised observer can be
    proved."""

    def obstacle(self, error: Inclusion) -> Reason:
        """Return why the effect of the method on the error dynamics e' in `error` is not known, or `NONE`."""
        ...

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """Return the method's step of length h for the error system `e`, e' = M e + ..; its limit for h = 0."""
        ...

    def plant_deviation(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> ErrorInput:
        """Return the plant's local error in a step of the method at theta, as input of e'. Raises: `Unbounded`."""
        ...


@dataclass(frozen=True)
class Staged:
    """A method that applies the stages of a Runge-Kutta tableau, both to the observer and, while samples are missing,
    to the model."""

    prediction: Tableau = RK4
    exact = False  # every eigenvalue of the core limits the step

    def obstacle(self, error: Inclusion) -> Reason:
        """Return `NONE`: the stages apply to any error dynamics."""
        return NONE

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """Return the step e+ = e + h sum_i b_i w_i of the error system `e` by the stages of the tableau."""
        return runge_kutta_step(self.prediction, h, e)

    def plant_deviation(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> ErrorInput:
        """Return the local error of the plant's solution against a step by the tableau, and the deviation of its output
        from the line between two samples, at the gain theta."""
        return StageDeviation(plant, self.prediction).error_input

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Return the memory and statements that integrate all fields of the part by the tableau."""
        return self.step(part, clock)

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """Return the step lengths at which the tableau is stable, with the linear core and with the Jacobian."""
        name = self.prediction.name
        why = f"beyond it the linear error core leaves the stability region of {name}"
        return lengths(part, observer, dt, self, Limit(stable_step(part, observer, self.prediction), why), name)

    def transition(self, core: np.ndarray, M: np.ndarray, h: float) -> np.ndarray:
        """Return the amplification matrices R(h M) (k, N, N) of a step, R the stability polynomial of the tableau."""
        return polynomial(h * M, self.prediction.polynomial)

    def refused(self, core: np.ndarray, M: np.ndarray) -> np.ndarray:
        """Return the least step length h (k) at which h times an eigenvalue of M (k, N, N) leaves the stability region
        of R."""
        return decay_limits(M, self.prediction.polynomial)

    def step(self, part: Ode, clock: Clock) -> Pieces:
        """Return the memory and statements that integrate all fields of any differential equation, a covariance
        included, by the tableau."""
        start = {field.name: sym("state", field.name, field.size) for field in part.fields}

        def equations(moving: Values) -> dict[str, Graph]:
            at = {**moving, **clock.constants}
            return {f"d{name}": slope for name, slope in part.rhs(at, at["u"], at["y"], at["valid"]).items()}

        rhs = routine(RATE, {name: value.numel() for name, value in start.items()} | clock.sizes, equations)

        def rate(values: Mapping[str, Graph], c: float | Graph) -> Mapping[str, Graph]:
            slopes = rhs({**values, **clock.signals(c)})
            return {name: slopes[f"d{name}"] for name in start}

        return Pieces(
            fields=part.fields,
            derived=part.derived,
            tune=part.tune,
            predict=tuple(self._blocks(rate, start, clock)),
            uses_output=True,
            rule=self.prediction.name,
        )

    def _blocks(self, rate: Rate, start: Values, clock: Clock) -> Iterator[Block | Repeat]:
        """Yield the statements of the step: one block, or a loop over the stages if
        each stage depends on few earlier ones, so that the other slopes need not
        stay in memory. `rate`: the right-hand side; `start`: the states before."""
        title = f"{', '.join(start)}: one step of {self.prediction.name}"
        notes = ("its tableau:", *(f"  {row}" for row in self.prediction.rows))
        if not self.prediction.chained:
            stages = advance(self.prediction, rate, start, clock.h)
            writes = {Place("state", name): value for name, value in stages.result.items()}
            yield Block(title, writes, {"u_mid": clock.u(0.5), "y_mid": clock.y(0.5)} | stages.names, notes=notes)
        else:
            yield from self._loop(rate, start, clock, title, notes)

    def _loop(
        self, rate: Rate, start: Values, clock: Clock, title: str, notes: tuple[str, ...]
    ) -> Iterator[Block | Repeat]:
        h, scale = (1.0, clock.h) if clock.varying else (clock.dt, 1)  # the rows of a loop are constants
        plan = rounds(self.prediction, h)
        fraction, share, ahead = numbers = [sym("work", name) for name in ("fraction", "share", "ahead")]
        at, total = ({n: sym("work", f"{n}_{kind}", v.numel()) for n, v in start.items()} for kind in ("at", "sum"))
        slopes = rate(at, fraction)
        sums = {f"{key}_sum": total[key] + share * slopes[key] for key in start}
        sums |= {f"{key}_at": start[key] + scale * ahead * slopes[key] for key in start}
        names = {f"k_{key}": slope for key, slope in slopes.items()}
        stage = Block("a stage", {Place("work", key): value for key, value in sums.items()}, names)
        rows = zip(numbers, (plan.fractions, plan.shares, plan.ahead), strict=True)
        read = {place for place, _ in stage.reads}
        first = {Place("work", f"{key}_sum"): ca.SX.zeros(value.numel()) for key, value in start.items()}
        note = "fraction is c of a stage; share is its b over that of the first; ahead is the next stage's a"
        note += " times dt" * (not clock.varying)
        begin = first | {Place("work", f"{key}_at"): value for key, value in start.items()}
        yield Block(title, begin, notes=(*notes, note))
        yield Repeat({place: row for number, row in rows if (place := address(number)[0]) in read}, (stage,))
        ends = {Place("state", key): value + scale * plan.last * total[key] for key, value in start.items()}
        yield Block("the slopes of all stages", ends)


@dataclass(frozen=True)
class Explicit(Staged):
    """An explicit Runge-Kutta method. `view`: the variables of a Riccati observer that it integrates, (z, S) with the
    information matrix S = P^-1, or (z, P) with the covariance P. Only a method with (z, S) accepts observers without a
    covariance."""

    view: Literal["information", "covariance"] = "information"

    @property
    def tableau(self) -> Tableau:
        """The coefficients (Butcher tableau) of the explicit Runge-Kutta method."""
        return self.prediction

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return f"{self.tableau.name}, {self.view} form" if self.view == "covariance" else self.tableau.name

    @property
    def equations(self) -> tuple[str, ...]:
        """The equations of the tableau's stages, and of their sum, as lines for reports."""
        return self.tableau.equations

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Return the memory and statements that integrate the part. Raises: `NoCovariance` in the view (z, P)."""
        if self.view == "covariance":
            raise NoCovariance(self.name)
        return self.step(part, clock)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Return the memory and statements that integrate z and S, or z and P, as one differential equation. Raises:
        `NeedsFixedStep`, as the density R is the noise of one sample at one dt only."""
        if clock.varying:
            raise NeedsFixedStep
        pieces, (covariance, limited) = (
            self.step(riccati_ode(part, self.view), clock),
            symmetric_covariance(part, self.view),
        )
        if part.forgetting is not None:
            pieces = replace(pieces, bits=(part.limited,), predict=(*pieces.predict, limited))
        return replace(
            pieces,
            rule=self.name,
            covariance=covariance,
            projected=lambda rows: ((), rows @ covariance @ rows.T),
        )

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return the step lengths at which the Riccati equation is stable; the advised one is also short against the
        plant's time scales."""
        limits = sorted(covariance_limits(part, self.tableau, self.view), key=lambda limit: limit.dt)
        return Lengths(
            refused=limits[-1].dt,
            take=min(limits[0].dt, pace(jacobians_on_box(part.dynamics, POINTS)[0])),
            why=f"even where the declared box admits the longest, {limits[-1].why}",
            other=FACTORED,
            basis=EVERYWHERE,
            rule=self.name,
        )


def equations(method: Method, rule: str) -> tuple[str, ...]:
    """Return the equations, as lines for reports, of the method called `rule` that integrates an observer: `method`
    itself, or classical Runge-Kutta, to which it may leave a part; () for an observer with its own update equations."""
    return {RK4.name: RK4.equations, method.name: method.equations}.get(rule, ())


def stable_step(part: Ode, observer: Observer, tableau: Tableau) -> float:
    """Return the largest step length at which the tableau keeps the linear error dynamics e' = M e of `part` stable;
    inf for a part without a linear core. Raises: `InfiniteCore`, `stability.UnstableCore`."""
    line = core(part, len(observer.form.system.outputs))
    matrix = part.core if line is None else numbers(line.M, nominal(observer))
    if matrix is None:
        return INF
    if not np.isfinite(matrix).all():
        raise InfiniteCore
    return core_limit(matrix, tableau.polynomial)


def covariance_limits(part: Riccati, tableau: Tableau, view: Literal["information", "covariance"]) -> list[Limit]:
    """Return the step length up to which the covariance equation is stable at each of several points of the declared
    box.

    Points at which the linearised model is not observable are left out where theta rises from its resting value:
    without observability there is no steady covariance.
    """
    noise, variance = part.typical
    points = list(zip(*part.linearised(POINTS), strict=True))
    if part.theta.error_free is not None:
        observability = [np.vstack([C @ np.linalg.matrix_power(F, k) for k in range(len(F))]) for F, C in points]
        ranks = map(np.linalg.matrix_rank, observability)
        points = [(F, C) for (F, C), rank in zip(points, ranks, strict=True) if rank == len(F)] or points
    F, C = map(np.array, zip(*points, strict=True))
    return explicit_covariance.covariance_limits(
        F,
        C,
        noise,
        variance,
        part.covariance,
        part.theta.peak,
        tableau,
        view,
        part.theta.error_free,
        part.theta.rise,
        part.scaling,
    )


# --- the core realised


@dataclass(frozen=True, eq=False)
class Matrices:
    """The matrices Phi, Psi_0, Psi_1 (N, N), Gamma_0, Gamma_1 (N, p) of a step x+ = Phi x + Gamma_0 v_0 + Gamma_1 v_1 +
    Psi_0 r_0 + Psi_1 (r_1 - r_0), as SX of the places that `program` writes; index 0 and 1: the ends of the step."""

    program: Program
    Phi: Graph
    Gamma_0: Graph
    Gamma_1: Graph
    Psi_0: Graph
    Psi_1: Graph


@dataclass(frozen=True)
class Realising:
    """A method that discretises the linear core x' = M x + B v by matrices, and the residual terms r(x, u, y) by two
    stages. `matrices`: the `Matrices` of a core and a step length (s); `numbers`: (Phi, Psi_0, Psi_1) (N, N) of h M;
    `equations`: lines for reports; `realisation`: the matrices in proofs about an observer's error; `local_error`: the
    local error for a plant whose r is known at both ends of a step."""

    name: str
    matrices: Callable[[Core, float], Matrices]
    numbers: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray, np.ndarray]]
    equations: tuple[str, ...]
    realisation: Realisation
    local_error: LocalError
    exact = True  # the core is realised, not integrated
    prediction = None

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """Return the memory and statements that integrate all fields of the part. Raises: `NoRealisation`."""
        if part.frozen:
            raise NoRealisation(self.name, f"here {min(part.frozen)} adapts, and the core with it: take rk4")
        if part.linear is None:
            raise NoRealisation(self.name, "this observer has none: take rk4")
        if clock.outputs > MOST:
            raise NoRealisation(self.name, f"for at most {MOST} outputs, each of which may be missing: take rk4")
        patterns = product((False, True), repeat=clock.outputs)
        updates = {pattern: _update(self, part, clock, pattern) for pattern in patterns}
        names = [f"seen_{j + 1}" for j in range(clock.outputs)] if clock.outputs > 1 else ["seen"]
        flags = [Place("work", name) for name in names]
        named = Block("is there a sample?", {flag: clock.valid[j] > 0 for j, flag in enumerate(flags)})
        return Pieces(
            fields=part.fields,
            derived=(*part.derived, *chain.from_iterable(update.derived for update in updates.values())),
            tune=(*part.tune, *chain.from_iterable(update.tune for update in updates.values())),
            predict=(named, *_chosen(flags, (), updates)),
            uses_output=True,
        )

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """Return the step lengths at which the residual terms r(x) are stable: the linear core sets no limit."""
        return lengths(part, observer, dt, self, Limit(INF, ""))

    def transition(self, core: np.ndarray, M: np.ndarray, h: float) -> np.ndarray:
        """Return (k, N, N) of e+ = a + Psi_1 J (a - e), a = (Phi + Psi_0 J) e, J = M - core the slope of r(x)."""
        J, (Phi, Psi_0, Psi_1) = M - core, self.numbers(core, h)
        first = Phi + Psi_0 @ J
        return np.asarray(first + Psi_1 @ J @ (first - np.eye(len(core))))

    def refused(self, core: np.ndarray, M: np.ndarray) -> np.ndarray:
        """Return the least step lengths (k) at which `transition` is unstable, found by trial."""
        return first_unstable(core, M, self)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """Refuse the observer. Raises: `NoRealisation`."""
        raise NoRealisation(self.name, "that of a Riccati observer moves with its covariance: take continuous_discrete")

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """Return no lengths: `riccati` refuses the observer."""
        return Lengths()

    def obstacle(self, error: Inclusion) -> Reason:
        """Return why the error dynamics `error` is not realised, a linear core that varies, or `NONE`."""
        if any(slope.realised is None for slope in error.slopes):
            return because("the proof by {rule} is for a linear core that does not move", rule=self.name)
        return NONE

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """Return a step of length h of the error system `e`: its linear core by matrices, the nonlinear terms by two
        stages."""
        return realised_step(self.realisation, h, e)

    def plant_deviation(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> ErrorInput:
        """Return the local error at theta of the plant's solution, given at both ends of a step with its r(x)."""
        return CoreDeviation(plant, error, theta).error_input(self.realisation, self.local_error)


def _chosen(flags: list[Place], known: Pattern, updates: Mapping[Pattern, Pieces]) -> Program:
    if not flags:
        return updates[known].predict
    present, missing = (_chosen(flags[1:], (*known, value), updates) for value in (True, False))
    return (When(flags[0], present, missing),)


def _update(method: Realising, part: Ode, clock: Clock, pattern: Pattern) -> Pieces:
    line = core(part, clock.outputs, tuple(map(float, pattern)))
    assert line is not None
    (label, suffix), valid = _named(pattern), ca.SX(ca.DM(list(map(float, pattern))))

    def residual(x: Graph, c: float) -> Graph:
        """Return the residual r (N) at the states x (N), at
        the begin (c = 0) or the end (c = 1) of the step."""
        rates = part.residual(_split(part, x), clock.u(c), clock.y(c), valid)
        return ca.densify(ca.vertcat(*(rates[field.name] for field in part.fields)))

    start = residual(line.x, 0.0)
    nonlinear_rows = [i for i in range(start.numel()) if not start[i].is_zero()]
    whole = method.matrices(line, clock.dt)
    matrices = {"Phi": whole.Phi, "Gamma_0": whole.Gamma_0, "Gamma_1": whole.Gamma_1}
    matrices |= {"Psi_0": whole.Psi_0[:, nonlinear_rows], "Psi_1": whole.Psi_1[:, nonlinear_rows]}
    matrices = {name: ca.sparsify(matrix) for name, matrix in matrices.items()}
    used = {
        name: ca.SX(matrix.sparsity(), sym("derived", f"{name}{label}", matrix.nnz()))
        for name, matrix in matrices.items()
    }
    guess = used["Phi"] @ line.x + used["Psi_0"] @ start[nonlinear_rows, :]
    guess += used["Gamma_0"] @ _source(part, clock, 0.0) + used["Gamma_1"] @ _source(part, clock, 1.0)
    after = guess + used["Psi_1"] @ (residual(guess, 1.0) - start)[nonlinear_rows, :]
    nonempty = {name: matrix for name, matrix in matrices.items() if matrix.nnz()}
    stored = {Place("derived", f"{name}{label}"): ca.vertcat(*matrix.nonzeros()) for name, matrix in nonempty.items()}
    step = Block(
        f"{', '.join(field.name for field in part.fields)}: one step by {method.name}{suffix}",
        {Place("state", name): piece for name, piece in _split(part, after).items()},
        {f"guess_{name}": piece for name, piece in _split(part, guess).items()},
    )
    return Pieces(
        derived=tuple(
            Field(f"{name}{label}", (0.0,) * matrix.nnz(), meaning=f"{MEANINGS[name]}{suffix}, by columns")
            for name, matrix in nonempty.items()
        ),
        tune=(*whole.program, Block(f"the core over a step{suffix}", stored)),
        predict=(step,),
    )


def _source(part: Ode, clock: Clock, c: float) -> Graph:
    """Return v = y - offset(u) (p), the input of the linear
    part, at the begin (c = 0) or end (c = 1) of a step."""
    return clock.y(c) if part.offset is None else clock.y(c) - part.offset(clock.u(c))


def _split(part: Ode, x: Graph) -> dict[str, Graph]:
    ends = np.cumsum([0, *(field.size for field in part.fields)]).tolist()
    return dict(zip((field.name for field in part.fields), ca.vertsplit(x, ends), strict=True))


def _named(pattern: Pattern) -> tuple[str, str]:
    if all(pattern):
        return "", ""
    present = ", ".join(str(j) for j, valid in enumerate(pattern, 1) if valid)
    if not present:
        return "_blind", ", without a sample"
    return "_" + "".join("01"[valid] for valid in pattern), f", with sample {present} only"


# --- balanced matrices ------------------------------------------------------------------------------------


def balanced(X: Graph) -> tuple[Program, int]:
    """Return a program that writes S^-1 X S, X an SX matrix (N, N), to `work.core` and the diagonal of S to
    `work.scale`, and the size of S, at least 2: the emitted C has no arrays of one element, so a scalar X gets a row
    and a column of zeros."""
    size = max(2, X.shape[0])
    wide = ca.SX(size, size)
    wide[: X.shape[0], : X.shape[0]] = X
    dense = ca.densify(wide.T)
    block = Block("the linear core, by rows", {Place("work", "core"): ca.reshape(dense, -1, 1)})
    arguments = ((Place("work", "core"), size**2), (Place("work", "scale"), size))
    return (block, Kernel("balance", size, None, arguments)), size


def spread(place: Place, X: Graph, size: int) -> Graph:
    """Return f(X) = S f(S^-1 X S) S^-1 (N, N) without its structural zeros, from f(S^-1 X S), a matrix of order `size`
    in `place`, by rows."""
    n, scale, F = X.shape[0], sym("work", "scale", size), sym(*place, size**2)
    links = np.array(ca.DM(X.sparsity(), 1)) + np.eye(n)
    reached = np.linalg.matrix_power(links, n) > 0
    unscaled = ca.SX(n, n)
    for i, j in zip(*np.nonzero(reached), strict=True):
        unscaled[int(i), int(j)] = F[int(i) * size + int(j)] * (1 if i == j else scale[int(i)] / scale[int(j)])
    return unscaled
