"""The innovation over a sliding window, I_d(t) = integral over [t-d, t] of |y - yhat|^2, yhat predicted from z(t-d).

Source: Boizot, Busvelle, Gauthier 2010, section 2.3. Two ways to compute it, both as values for an adaptive theta:

`window(d)`: as the paper says, the model is run again from z(t - d) at every sample; N = d/dt model steps a sample and
a history of N + 1 states, inputs and outputs.

`staggered(d, predictors=M)`: M + 1 copies of the model, one restarted from z every d/M, each summing dt |y - yhat|^2.
The oldest has an age between d and d (1 + 1/M); its sum is scaled down to d by its number of valid samples and never
scaled up. M + 1 model steps a sample and no history: the default.

A sum over samples keeps dt (unit y^2 s), so thresholds do not change with dt. Missing samples are not counted. Of
several outputs I_d is the sum of weights_j |y_j - yhat_j|^2, each with its own count of valid samples; weights such as
1/variance make outputs of different units one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeAlias, runtime_checkable

import casadi as ca

from hgogen.discretisation.lengths import Lengths
from hgogen.discretisation.runge_kutta import HEUN, Tableau, advance
from hgogen.discretisation.stability import EVERYWHERE, decay_limits
from hgogen.errors import BadArgument, HgogenError
from hgogen.graph import Graph
from hgogen.kalman.kalman_theorems import STAGGERED, WINDOW
from hgogen.part import Clock, Part, Pieces
from hgogen.program import INF, Block, Field, Group, Loop, Place, Program, When, scalar, sym
from hgogen.reading.given import real, reals
from hgogen.reading.named import Values, of_outputs
from hgogen.structure.dynamics import HUGE, Dynamics
from hgogen.theorem import Hypothesis

Weights: TypeAlias = tuple[float, ...] | Mapping[str, float]


@dataclass(eq=False)
class BadWindow(HgogenError):
    """A window that is no whole number of samples."""

    d: float
    dt: float
    predictors: int

    def __str__(self) -> str:
        unit = self.dt * self.predictors
        nearest = max(1, round(self.d / unit)) * unit
        share = f" between {self.predictors} predictors" if self.predictors > 1 else ""
        return (
            f"the window d = {self.d:g} is no whole number of samples of dt = {self.dt:g}{share}; "
            f"take d = {nearest:.6g}, or other dt or predictors"
        )


@runtime_checkable
class Innovation(Protocol):
    """A way to compute I_d into the place `state.innovation`."""

    @property
    def d(self) -> float:
        """Length of the window."""
        ...

    @property
    def hypothesis(self) -> Hypothesis:
        """What is known of it as the integral of the theorem."""
        ...

    def part(self, dynamics: Dynamics, z: Field) -> "Predictors":
        """The part that computes it, for the observer state of field `z`."""
        ...


POINTS = 12  # corners, and as many points inside, at which the model's decay is judged


@dataclass(frozen=True)
class Predictor:
    """What both ways share: the open-loop model over one step and its output error."""

    dynamics: Dynamics
    z: Field
    tableau: Tableau

    @property
    def lengths(self) -> Lengths:
        """The step lengths at which the tableau follows the model's decay."""
        limits = decay_limits(self.dynamics.linearised(POINTS)[0], self.tableau.polynomial)
        why = f"nowhere in the declared box does a predictor by {self.tableau.name} follow the model's decay beyond it"
        return Lengths(refused=float(limits.max()), take=float(limits.min()), why=why, basis=EVERYWHERE)

    def moved(self, z: Graph, u: Callable[[float], Graph], dt: float) -> Graph:
        """z one step later without correction, clamped to the box of the observer's state; z(0) where it is lost."""
        stages = advance(self.tableau, lambda v, c: {"z": self.dynamics.flow(v["z"], u(c))}, {"z": z}, dt)
        return kept(self.z, stages.result["z"])


@dataclass(frozen=True, eq=False)
class Predictors(Part):
    """Copies of the model without correction as a part of an observer; `build` makes its pieces, the same whatever the
    method: the predictors have their own."""

    predictor: Predictor
    build: Callable[[Predictor, Clock], Pieces]


def kept(field: Field, value: Graph) -> Graph:
    """Each element clamped to the field's box; its initial value where it is not a number or absurd."""
    elements = []
    for i, (low, high) in enumerate(field.box):
        clamped = ca.fmin(ca.fmax(value[i], max(low, -HUGE)), min(high, HUGE))
        elements.append(ca.if_else(ca.fabs(value[i]) <= HUGE, clamped, field.initial[i]))
    return ca.vertcat(*elements)


def samples(d: float, dt: float, shares: int = 1) -> int:
    """The number of samples d/dt, which must be a whole multiple of `shares`.

    Raises: `BadWindow`.
    """
    count = round(d / dt)
    if count < 1 or count % shares or abs(count * dt - d) > 1e-9 * d:
        raise BadWindow(d, dt, shares)
    return count


@dataclass(frozen=True)
class Staggered:
    """See the module."""

    d: float
    predictors: int
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = STAGGERED

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """M + 1 copies of the model in the group `predictor`."""
        own = replace(self, weights=_weighed(self.weights, dynamics))
        return Predictors(Predictor(dynamics, z, self.tableau), own._pieces)

    def _pieces(self, predictor: Predictor, clock: Clock) -> Pieces:
        count = samples(self.d, clock.dt, self.predictors)
        members, period = self.predictors + 1, count // self.predictors
        most = members * period + 1
        n, p = predictor.dynamics.n, clock.outputs
        z, total, valid = sym("predictor", "z", n), sym("predictor", "sum", p), sym("predictor", "samples", p)
        moved = predictor.moved(z, clock.u, clock.dt)
        move = Block(
            f"each predictor by {predictor.tableau.name}, without correction", {Place("predictor", "z"): moved}
        )

        def accumulate(output: int) -> Program:
            error = sym("work", "sample") - predictor.dynamics.output(z, clock.u_now)[output]
            squared = ca.fmin(total[output] + clock.period(output) * error * error, HUGE * HUGE)
            more = ca.if_else(valid[output] < most, valid[output] + 1, most)
            add = Block("its squared output error", {Place("predictor", "sum"): _with(total, output, squared)})
            tally = Block("one more sample", {Place("predictor", "samples"): _with(valid, output, more)})
            return (Loop("predictor", members, (add, tally)),)

        wanted = _wanted(count, clock)
        scaled = total * (wanted / ca.fmax(valid, wanted))
        read = Block(
            "innovation: the sum of the oldest predictor, scaled to the window, never scaled up",
            {Place("state", "innovation"): _summed(self.weights, scaled)},
        )
        tick = sym("state", "tick") + 1
        due = Block(
            f"one predictor restarts every {period} samples",
            {Place("work", "restart"): tick >= period, Place("state", "tick"): ca.if_else(tick >= period, 0, tick)},
        )
        restart = (
            Block(
                "the oldest predictor restarts from the estimate",
                {Place("predictor", "z"): sym("state", predictor.z.name, n), Place("predictor", "sum"): ca.SX.zeros(p)},
            ),
            Block("no sample yet", {Place("predictor", "samples"): ca.SX.zeros(p)}),
        )
        after = sym("state", "oldest") + 1
        rotate = Block("the next one is the oldest", {Place("state", "oldest"): ca.if_else(after >= members, 0, after)})
        oldest = Place("state", "oldest")
        return Pieces(
            fields=(
                scalar("innovation", 0, low=0.0, high=HUGE * HUGE, unit="y^2 s", meaning="innovation I_d"),
                scalar("oldest", 0, kind="index", high=members - 1, meaning="index of the oldest predictor"),
                scalar("tick", 0, kind="index", high=period - 1, meaning="samples since the last restart"),
            ),
            groups=(
                Group(
                    "predictor",
                    members,
                    (
                        replace(predictor.z, meaning="predicted state"),
                        Field(
                            "sum",
                            (0.0,) * p,
                            low=(0.0,) * p,
                            high=(HUGE * HUGE,) * p,
                            unit="y^2 s",
                            meaning="sum of dt (y - yhat)^2",
                        ),
                        Field(
                            "samples",
                            (0.0,) * p,
                            kind="index",
                            low=(-INF,) * p,
                            high=(most,) * p,
                            meaning="valid samples in the sum",
                        ),
                    ),
                    "copies of the model that run without correction",
                ),
            ),
            predict=(Loop("predictor", members, (move,)),),
            update=tuple(accumulate(j) for j in range(clock.outputs)),
            adapt=(
                Loop("predictor", 1, (read,), start=oldest),
                due,
                When(Place("work", "restart"), (Loop("predictor", 1, restart, start=oldest), rotate)),
            ),
        )


@dataclass(frozen=True)
class Window:
    """See the module."""

    d: float
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = WINDOW

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """A ring of N + 1 samples in the group `past`."""
        own = replace(self, weights=_weighed(self.weights, dynamics))
        return Predictors(Predictor(dynamics, z, self.tableau), own._pieces)

    def _pieces(self, predictor: Predictor, clock: Clock) -> Pieces:
        steps = samples(self.d, clock.dt)
        n, m, p, size = predictor.dynamics.n, clock.inputs, clock.outputs, steps + 1
        z, u, y, valid = sym("past", "z", n), sym("past", "u", m), sym("past", "y", p), sym("past", "valid", p)
        newest, filled = sym("state", "newest"), sym("state", "filled")
        after = ca.if_else(newest + 1 >= size, 0, newest + 1)
        push = Block("the newest sample takes the place of the oldest", {Place("state", "newest"): after})
        store = {Place("past", "z"): sym("state", predictor.z.name, n)}
        store |= {
            Place("past", "y"): sym("state", "recent_y", p),
            Place("past", "valid"): sym("state", "recent_valid", p),
        }
        store |= {Place("past", "u"): sym("state", "u", m)} if m else {}
        count = ca.if_else(filled < size, filled + 1, size)
        oldest = ca.if_else(newest + 1 < count, newest + 1 + size - count, newest + 1 - count)
        first = ca.if_else(oldest + 1 >= size, 0, oldest + 1)
        find = Block(
            "the window starts at the oldest sample",
            {
                Place("state", "filled"): count,
                Place("work", "oldest"): oldest,
                Place("work", "first"): first,
                Place("work", "steps"): count - 1,
            },
        )
        load = {Place("work", "zw"): z, Place("work", "sum"): ca.SX(0)} | ({Place("work", "uw"): u} if m else {})
        before = sym("work", "uw", m)
        moved = predictor.moved(sym("work", "zw", n), lambda c: clock.between_samples(c, before, u), clock.dt)
        error = y - predictor.dynamics.output(moved, u)
        rates = ca.SX(ca.DM(clock.every)) * valid if clock.every else valid
        added = _summed(self.weights, rates * (error * error))
        squared = ca.fmin(sym("work", "sum") + clock.dt * added, HUGE * HUGE)
        replay = {Place("work", "zw"): moved, Place("work", "sum"): squared} | ({Place("work", "uw"): u} if m else {})
        recent = Block("no sample yet", {Place("state", "recent_valid"): ca.SX.zeros(p)})

        def remember(output: int) -> Program:
            values = ca.SX(sym("state", "recent_y", p)), ca.SX(sym("state", "recent_valid", p))
            values[0][output], values[1][output] = sym("work", "sample"), 1
            writes = {Place("state", "recent_y"): values[0], Place("state", "recent_valid"): values[1]}
            return (Block("this sample", writes),)

        zeros = (0.0,) * p
        past = [replace(predictor.z, meaning="estimate")]
        past += [Field("u", (0.0,) * m, meaning="input")] if m else []
        past += [Field("y", zeros, meaning="measurement"), Field("valid", zeros, meaning="1 where it counts")]
        return Pieces(
            fields=(
                scalar("innovation", 0, low=0.0, high=HUGE * HUGE, unit="y^2 s", meaning="innovation I_d"),
                scalar("newest", 0, kind="index", high=size - 1, meaning="index of the newest sample"),
                scalar("filled", 0, kind="index", high=size, meaning="samples in the window"),
                Field("recent_y", zeros, meaning="measurement of this call"),
                Field("recent_valid", zeros, meaning="1 where it counts"),
            ),
            groups=(Group("past", size, tuple(past), "the samples of the window"),),
            predict=(recent,),
            update=tuple(remember(j) for j in range(p)),
            adapt=(
                push,
                Loop("past", 1, (Block("store", store),), start=Place("state", "newest")),
                find,
                Loop(
                    "past", 1, (Block("the model starts from the estimate d ago", load),), start=Place("work", "oldest")
                ),
                Loop(
                    "past",
                    steps,
                    (Block(f"the model again by {predictor.tableau.name}, its squared output error", replay),),
                    start=Place("work", "first"),
                    active=Place("work", "steps"),
                ),
                Block("innovation", {Place("state", "innovation"): sym("work", "sum")}),
            ),
        )


def _wanted(count: int, clock: Clock) -> Graph:
    """The number of samples of each output in a window of `count` periods; one number where it is the same for all."""
    counts = [max(1, count // every) for every in clock.every]
    return ca.SX(ca.DM(counts)) if len({*counts}) > 1 else counts[0] if counts else count


def staggered(d: float, predictors: int = 4, method: Any = None, weights: float | Values | None = None) -> Staggered:
    """Innovation by `predictors` + 1 staggered copies of the model over a window `d` (s); Heun unless `method` says.

    `weights`: of each output's square, by name or in their order, 1 by default.

    Raises: `HgogenError` where d, the number or a weight is not positive.
    """
    _positive(d)
    if real("predictors", predictors) not in range(1, 1000):
        raise BadWindowSize(f"predictors = {predictors}", "must be a whole number, from 1 to 999")
    return Staggered(float(d), int(predictors), _tableau(method), _weights(weights))


def window(d: float, method: Any = None, weights: float | Values | None = None) -> Window:
    """Innovation as the paper defines it, the model run again over the window `d` (s) at every sample; `weights` as in
    `staggered`."""
    _positive(d)
    return Window(float(d), _tableau(method), _weights(weights))


class BadWindowSize(BadArgument):
    """A window, a number of predictors or a method that cannot be used."""


def _positive(d: float) -> None:
    if not 0 < real("the window d", d) < HUGE:
        raise BadWindowSize(f"the window d = {d!r}", "must be a positive time")


def _tableau(method: Any) -> Tableau:
    tableau = HEUN if method is None else getattr(method, "tableau", None)
    if not isinstance(tableau, Tableau):
        raise BadWindowSize(
            f"method = {method!r}", "must be an explicit one: methods.euler, methods.heun or methods.rk4"
        )
    return tableau


def _weights(declared: Any) -> Weights:
    """The weights of the outputs; () for all 1."""
    if declared is None:
        return ()
    values = list(declared.values()) if isinstance(declared, Mapping) else declared
    weights = tuple(map(float, reals("weights", values).reshape(-1)))
    if not weights or not all(0 < weight < HUGE for weight in weights):
        raise BadWindowSize(f"weights = {declared!r}", "must be positive numbers, one for each output")
    return dict(zip(declared, weights, strict=True)) if isinstance(declared, Mapping) else weights


def _weighed(declared: Weights, dynamics: Dynamics) -> tuple[float, ...]:
    """The declared weights in the order of the outputs; () for all 1."""
    weights = tuple(of_outputs("weights", declared, dynamics.form)) if declared else ()
    if weights and len(weights) != dynamics.outputs:
        reason = f"must have one number for each of {dynamics.outputs} outputs"
        raise BadWindowSize(f"weights of length {len(weights)}", reason)
    return weights


def _summed(weights: Any, squares: Graph) -> Graph:
    """The weighted sum over outputs (p), clamped to a finite number."""
    if weights:
        return ca.fmin(ca.dot(ca.SX(ca.DM(weights)), squares), HUGE * HUGE)
    return squares if squares.numel() == 1 else ca.fmin(ca.sum1(squares), HUGE * HUGE)


def _with(values: Graph, index: int, value: Graph) -> Graph:
    """The SX column with another element."""
    return ca.vertcat(*(value if i == index else values[i] for i in range(values.numel())))
