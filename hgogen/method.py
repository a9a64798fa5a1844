"""A method turns the differential equations of an observer into the statements of a step, and says how long a step may
be."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from hgogen.analysis.linearised import jacobians_on_box
from hgogen.discretisation import explicit_covariance
from hgogen.discretisation.growth import polynomial
from hgogen.discretisation.routine import RATE, Values, routine
from hgogen.discretisation.runge_kutta import RK4, Tableau, advance, rounds
from hgogen.discretisation.stability import EVERYWHERE, Lengths, Limit, core_limit, decay_limits, pace
from hgogen.errors import HgogenError
from hgogen.estimators.core import core, nominal, numbers
from hgogen.estimators.covariance import covariance_ode, covariance_of_view, information_ode, prior_status_of_view
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.sampled import Sampled
from hgogen.estimators.transient import lengths
from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Clock, Ode, Pieces
from hgogen.program import INF, Block, Place, Repeat, address, sym
from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.inequality import Inequality, Realisation, realised, stagewise
from hgogen.prove.method_error import BesideCore, BesideStages, Leaves
from hgogen.prove.plant_step import Entering, PlantStep
from hgogen.sentence import NONE, Reason, because

POINTS = 6  # corners, and as many points inside, at which the covariance equation is judged
Rate = Callable[[Values, float | Graph], Values]
FACTORED = "the method continuous_discrete keeps it definite at any dt"


@dataclass(eq=False)
class InfiniteCore(HgogenError):
    """A linear error core whose numbers overflow."""

    def __str__(self) -> str:
        return "the error core has numbers beyond the range of a double; choose smaller gains, or other units"


@dataclass(eq=False)
class NoCovariance(HgogenError):
    """A method for a covariance, asked of an observer that has none."""

    method: str

    def __str__(self) -> str:
        return f"{self.method} is a method for the covariance of a Riccati observer, here there is none: take rk4"


class Method(Protocol):
    """A discretisation: one rule for differential equations, one for the covariance of a Riccati observer."""

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        ...

    @property
    def equations(self) -> tuple[str, ...]:
        """What a step does, in lines for reports; h is its length."""
        ...

    @property
    def prediction(self) -> Tableau | None:
        """The tableau by which the model moves while samples are missing; None for a method that realises a core."""
        ...

    def __hash__(self) -> int:
        """Equal methods make the same step of an observer, which is remembered."""
        ...

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """The part over one step, the measurement on the line between two valid samples."""
        ...

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """The Riccati observer over one step."""
        ...

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """The step lengths for a part of the observer, as far as `dt` asks for them."""
        ...

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """The step lengths for the Riccati observer, as far as `dt` asks for them."""
        ...


@runtime_checkable
class OnErrors(Protocol):
    """A method of which it is known how it moves the error of an observer, so that its step can be proved."""

    def obstacle(self, error: Inclusion) -> Reason:
        """Why it is not known for what the error obeys, or `NONE`."""
        ...

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """A step of length h on what the error obeys; of length 0 its limit."""
        ...

    def beside(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> Entering:
        """What the plant does beside a step, as it enters the error. Raises: `Unbounded`."""
        ...


@dataclass(frozen=True)
class Realising(Sampled):
    """A realisation of a linear core, of which it is known how it moves the error of an observer: by the `realisation`,
    in which proofs have its matrices; and what it `leaves` of a plant whose rest is known at both ends of a step."""

    realisation: Realisation
    leaves: Leaves

    def obstacle(self, error: Inclusion) -> Reason:
        """A core in which something varies, which is not realised."""
        if any(slope.realised is None for slope in error.slopes):
            return because("the proof by {rule} is for a linear core that does not move", rule=self.name)
        return NONE

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """The core realised, and the rest by two stages."""
        return realised(self.realisation, h, e)

    def beside(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> Entering:
        """The plant's own samples at both ends, its rest by two stages."""
        return BesideCore(plant, error, theta).enters(self.realisation, self.leaves)


@dataclass(frozen=True)
class Staged:
    """What moves a differential equation, and the model while samples are missing, by the stages of a tableau."""

    prediction: Tableau = RK4
    exact = False  # every eigenvalue of the core limits the step

    def obstacle(self, error: Inclusion) -> Reason:
        """None: whatever the error obeys, the stages read it."""
        return NONE

    def error_step(self, h: Fraction, e: Uncertain) -> Inequality:
        """The stages of the tableau."""
        return stagewise(self.prediction, h, e)

    def beside(self, plant: PlantStep, error: Inclusion, theta: Fraction) -> Entering:
        """The plant beside its step by the tableau, and beside the line between two samples."""
        return BesideStages(plant, self.prediction).entering

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """One step of every field of the part at once."""
        return self.step(part, clock)

    def ode_lengths(self, part: Ode, observer: Observer, dt: float) -> Lengths:
        """The step lengths that the linear core admits, and the core with the model's Jacobian."""
        name = self.prediction.name
        why = f"beyond it the linear error core leaves the stability region of {name}"
        return lengths(part, observer, dt, self, Limit(paced(part, observer, self.prediction), why), name)

    def transition(self, core: np.ndarray, M: np.ndarray, h: float) -> np.ndarray:
        """R(h M) (k, N, N), R the stability polynomial."""
        return polynomial(h * M, self.prediction.polynomial)

    def refused(self, core: np.ndarray, M: np.ndarray) -> np.ndarray:
        """The h at which h times an eigenvalue of M leaves the stability region (k)."""
        return decay_limits(M, self.prediction.polynomial)

    def step(self, part: Ode, clock: Clock) -> Pieces:
        """One step of every field of the part at once, whatever the part is of."""
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
        """The step as one block, or where a stage needs little of those before it a loop over the stages, whose slopes
        then need not stay in memory."""
        title = f"{', '.join(start)}: one step of {self.prediction.name}"
        if not self.prediction.chained:
            stages = advance(self.prediction, rate, start, clock.dt)
            writes = {Place("state", name): value for name, value in stages.result.items()}
            yield Block(title, writes, {"u_mid": clock.u(0.5), "y_mid": clock.y(0.5)} | stages.names)
            return

        plan = rounds(self.prediction, clock.dt)
        fraction, share, ahead = numbers = [sym("work", name) for name in ("fraction", "share", "ahead")]
        at, total = ({n: sym("work", f"{n}_{kind}", v.numel()) for n, v in start.items()} for kind in ("at", "sum"))
        slopes = rate(at, fraction)
        left = {f"{key}_sum": total[key] + share * slopes[key] for key in start}
        left |= {f"{key}_at": start[key] + ahead * slopes[key] for key in start}
        names = {f"k_{key}": slope for key, slope in slopes.items()}
        stage = Block("a stage", {Place("work", key): value for key, value in left.items()}, names)
        rows = zip(numbers, (plan.fractions, plan.shares, plan.ahead), strict=True)
        read = {place for place, _ in stage.reads}
        first = {Place("work", f"{key}_sum"): ca.SX.zeros(value.numel()) for key, value in start.items()}
        yield Block(title, first | {Place("work", f"{key}_at"): value for key, value in start.items()})
        yield Repeat({place: row for number, row in rows if (place := address(number)[0]) in read}, (stage,))
        ends = {Place("state", key): value + plan.last * total[key] for key, value in start.items()}
        yield Block("the slopes of all stages", ends)


@dataclass(frozen=True)
class Explicit(Staged):
    """An explicit Runge-Kutta method: of a Riccati observer it integrates (z, S) or (z, P), in the view (z, S) any
    other part too."""

    view: Literal["information", "covariance"] = "information"

    @property
    def tableau(self) -> Tableau:
        """The tableau of an explicit method."""
        return self.prediction

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return f"{self.tableau.name}, {self.view} form" if self.view == "covariance" else self.tableau.name

    @property
    def equations(self) -> tuple[str, ...]:
        """The stages of the tableau, and what they lead to."""
        return self.tableau.equations

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """One step of every field of the part at once. Raises: `NoCovariance` in the view (z, P)."""
        if self.view == "covariance":
            raise NoCovariance(self.name)
        return self.step(part, clock)

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """z and S, or z and P, as one differential equation."""
        views = {"information": information_ode, "covariance": covariance_ode}
        pieces = self.step(views[self.view](part), clock)
        forgets = part.forgetting is not None
        return replace(
            pieces,
            bits=(part.limited,) if forgets else (),
            predict=(*pieces.predict, prior_status_of_view(part, self.view)) if forgets else pieces.predict,
            rule=self.name,
            covariance=covariance_of_view(part, self.view),
        )

    def riccati_lengths(self, part: Riccati, dt: float) -> Lengths:
        """The step lengths that the covariance equation admits; `take` also follows the model's motion."""
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
    """The lines of what carries an observer out: the method, or classical Runge-Kutta where the method leaves a part
    to it; none of a rule that is a part's own."""
    return {RK4.name: RK4.equations, method.name: method.equations}.get(rule, ())


def paced(part: Ode, observer: Observer, tableau: Tableau) -> float:
    """The largest step length at which the tableau keeps the linear error core stable.

    Raises: `InfiniteCore`, `stability.UnstableCore`.
    """
    line = core(part, len(observer.form.system.outputs))
    matrix = part.core if line is None else numbers(line.M, nominal(observer))
    if matrix is None:
        return INF
    if not np.isfinite(matrix).all():
        raise InfiniteCore
    return core_limit(matrix, tableau.polynomial)


def covariance_limits(part: Riccati, tableau: Tableau, view: Literal["information", "covariance"]) -> list[Limit]:
    """The step length that the covariance equation admits at each of a number of points of the declared box.

    Points at which the frozen model is not observable are left out where theta rises from rest: there is no covariance
    at rest to rise from.
    """
    noise, variance = part.nominal
    points = list(zip(*part.linearised(POINTS), strict=True))
    if part.theta.rest is not None:
        shown = [np.vstack([C @ np.linalg.matrix_power(F, k) for k in range(len(F))]) for F, C in points]
        ranks = map(np.linalg.matrix_rank, shown)
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
        part.theta.rest,
        part.theta.rise,
        part.scaling,
    )
