"""The innovation over a sliding window, I_d(t) = integral over [t-d, t] of |y - yhat|^2, yhat predicted from z(t-d).

Source: Boizot, Busvelle, Gauthier 2010, section 2.3. It is computed in one of two ways, as the input of an adaptive
theta:

`window(d)`: as in the paper, the model is simulated again from z(t - d) at every sample. It costs N = d/dt model steps
per sample and a history of N + 1 states, inputs and outputs.

`staggered(d, predictors=M)`, the default: M + 1 copies of the model, one restarted from z every d/M, each summing dt
|y - yhat|^2. The oldest has an age between d and d (1 + 1/M); its sum is scaled down to d by its number of valid
samples and never scaled up. It costs M + 1 model steps per sample and no history.

The sum over samples has the factor dt (unit y^2 s), so thresholds do not depend on dt. Missing samples are not counted.
For several outputs I_d is the sum of weights_j |y_j - yhat_j|^2, each with its own count of valid samples; weights such
as 1/variance make outputs of different units comparable. A predictor is the model over one step without correction.

Where dt varies, staggered predictors count times in place of samples: a sample has the time since the last call as its
factor, at most the longest dt, and a predictor restarts once d/M has passed.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeAlias, runtime_checkable

import casadi as ca

from hgogen.analysis.dynamics import HUGE, Dynamics, inside, into_range
from hgogen.analysis.linearised import jacobians_on_box
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import HEUN, Tableau, advance, routine
from hgogen.discretisation.stability import EVERYWHERE, Lengths, decay_limits
from hgogen.errors import BadArgument, HgogenError
from hgogen.graph import Graph
from hgogen.part import Clock, Part, Pieces
from hgogen.program import INF, Block, Field, Group, Loop, Place, Program, When, scalar, sym
from hgogen.reading.given import Values, by_output, real, reals
from hgogen.signal import LOST
from hgogen.theorem import Hypothesis

__all__ = ["Innovation", "staggered", "window"]

Weights: TypeAlias = tuple[float, ...] | Mapping[str, float]
POINTS = 12  # corners, and as many points inside, at which the model's decay is evaluated
MOST = LOST  # upper limit of a sum of squared errors
INNOVATION = scalar("innovation", 0, low=0.0, high=MOST, unit="y^2 s", meaning="innovation I_d")

WINDOW = Hypothesis(
    "the innovation is an integral over the last d seconds",
    verdict=Verdict.UNKNOWN,
    reason="it is a sum over the samples, of a model run by a method with the step dt",
    reference="(4)",
)
STAGGERED = Hypothesis(
    "the innovation is an integral over the last d seconds",
    verdict=Verdict.UNKNOWN,
    reason="it is a sum over the samples, and M staggered predictors look back over d to d (1 + 1/M) seconds",
    reference="(4)",
)


@dataclass(eq=False)
class BadWindow(HgogenError):
    """The error for a window `d` (s) of the innovation that is no whole number of samples dt, or of shares by
    `predictors`."""

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


class BadWindowSize(BadArgument):
    """The error for an inadmissible length of an innovation's window, number of predictors, weight or method."""


@runtime_checkable
class Innovation(Protocol):
    """A rule that computes the innovation I_d(t) = integral over [t-d, t] of |y - yhat|^2, yhat predicted by the model
    from the estimate z(t-d), and stores it in the state's field `innovation`."""

    @property
    def d(self) -> float:
        """Length d of the window (s)."""
        ...

    @property
    def hypothesis(self) -> Hypothesis:
        """The hypothesis, with its verdict, that the computed value is the integral I_d of the convergence theorem."""
        ...

    def part(self, dynamics: Dynamics, z: Field) -> "Predictors":
        """Return the part of the observer that computes I_d, for the estimated state in the field `z`."""
        ...


@dataclass(frozen=True)
class Predictor:
    """The model z' = f(z, u) without correction, integrated by a Runge-Kutta `tableau`; `z`: the field of its state."""

    dynamics: Dynamics
    z: Field
    tableau: Tableau

    @property
    def lengths(self) -> Lengths:
        """The step lengths at which the tableau's errors decay where the model's do, over points of the box."""
        limits = decay_limits(jacobians_on_box(self.dynamics, POINTS)[0], self.tableau.polynomial)
        why = f"nowhere in the declared box does a predictor by {self.tableau.name} follow the model's decay beyond it"
        return Lengths(refused=float(limits.max()), take=float(limits.min()), why=why, basis=EVERYWHERE)

    def stepped(self, z: Graph, u: Callable[[float], Graph], dt: Any) -> Graph:
        """Return z (n) after a step of z' = f(z, u) of the length `dt`, a number or an SX scalar, without the clamp
        `clamped`; `u`: the input as a function of the fraction of the step, from 0 to 1."""
        sizes = {"z": z.numel(), "u": u(0.0).numel()}
        flow = routine("flow", sizes, lambda at: {"dz": self.dynamics.flow(at["z"], at["u"])})
        stages = advance(self.tableau, lambda v, c: {"z": flow({**v, "u": u(c)})["dz"]}, {"z": z}, dt)
        result: Graph = stages.result["z"]
        return result


@dataclass(frozen=True, eq=False)
class Predictors(Part):
    """Copies of the model without correction as a part of an observer. `build` returns its memory and statements for
    any method of the observer, since a predictor has its own."""

    predictor: Predictor
    build: Callable[[Predictor, Clock], Pieces]


def clamped(field: Field, value: Graph, still: Collection[int] = ()) -> Graph:
    """Return `value` (n) clamped to the field's box; an element that is not a number, or absurdly large, gets its
    initial value. Elements whose index is in `still` are constant in the model and not clamped."""
    elements = []
    for i, (end, period) in enumerate(zip(field.box_within(HUGE), field.turns, strict=True)):
        inside = into_range(value[i], end, period)
        kept_in = ca.if_else(ca.fabs(value[i]) <= HUGE, inside, field.initial[i])
        elements.append(value[i] if i in still else kept_in)
    return ca.vertcat(*elements)


def outside_box(field: Field, value: Graph, still: Collection[int]) -> Graph:
    """Return whether an element of `value` (n) is outside the field's box or not a number; those with an index in
    `still` are not tested."""
    moving = [i for i in range(value.numel()) if i not in still]
    ends = field.box_within(HUGE)
    return ca.logic_not(inside(value[moving], [ends[i] for i in moving]))


def samples(d: float, dt: float, shares: int = 1) -> int:
    """Return the number d/dt of samples in a window d, a whole multiple of `shares`. Raises: `BadWindow`."""
    count = round(d / dt)
    if count < 1 or count % shares or abs(count * dt - d) > 1e-9 * d:
        raise BadWindow(d, dt, shares)
    return count


def in_order(weights: Weights | Values, dynamics: Dynamics) -> tuple[float, ...]:
    """Return the `weights` of the squared output errors in the order of the outputs. Raises: `BadNames`;
    `BadWindowSize` for another number of weights."""
    ordered = tuple(by_output("weights", weights, dynamics.form)) if weights else ()
    if ordered and len(ordered) != dynamics.outputs:
        reason = f"must have one number for each of {dynamics.outputs} outputs"
        raise BadWindowSize(f"weights of length {len(ordered)}", reason)
    return ordered


def summed(weights: tuple[float, ...], squares: Graph) -> Graph:
    """Return sum_j weights_j squares_j over the outputs (p), all weights 1 for (); limited to remain finite."""
    if weights:
        return ca.fmin(ca.dot(ca.SX(ca.DM(weights)), squares), MOST)
    return squares if squares.numel() == 1 else ca.fmin(ca.sum1(squares), MOST)


_NEWEST, _FILLED = Place("state", "newest"), Place("state", "filled")
_RECENT_Y, _RECENT_VALID = Place("state", "recent_y"), Place("state", "recent_valid")
_START, _FIRST, _STEPS = (Place("work", name) for name in ("oldest", "first", "steps"))
_RUN_Z, _RUN_U, _RUN_SUM = (Place("work", name) for name in ("zw", "uw", "sum"))


@dataclass(frozen=True)
class Window:
    """The innovation I_d = integral over [t-d, t] of |y - yhat|^2, for which the model is simulated again from z(t-d)
    at each sample: `d` (s), the `tableau` that integrates the model, `weights` of the outputs' squares."""

    d: float
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = WINDOW

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """Return the observer's part that stores the last d/dt + 1 samples, and simulates the model over them."""
        weights = in_order(self.weights, dynamics)

        def build(predictor: Predictor, clock: Clock) -> Pieces:
            if clock.varying:
                reason = "remembers samples of one period; take innovation.staggered, or a number for dt"
                raise BadWindowSize(f"innovation.window of {self.d:g}", reason)
            return _Ring(predictor, clock, samples(self.d, clock.dt), weights).pieces

        return Predictors(Predictor(dynamics, z, self.tableau), build)


@dataclass(frozen=True)
class _Ring:
    predictor: Predictor
    clock: Clock
    steps: int
    weights: tuple[float, ...]

    @property
    def size(self) -> int:
        return self.steps + 1

    @property
    def n(self) -> int:
        return self.predictor.dynamics.n

    @property
    def pieces(self) -> Pieces:
        p = self.clock.outputs
        zeros, after = (0.0,) * p, sym("state", "newest") + 1
        newest = {_NEWEST: ca.if_else(after >= self.size, 0, after)}
        sample = {"z": sym("state", self.predictor.z.name, self.n)}
        sample |= {"y": sym("state", "recent_y", p), "valid": sym("state", "recent_valid", p)}
        sample |= {"u": sym("state", "u", self.clock.inputs)} if self.clock.inputs else {}
        store = Block("store", {Place("past", name): value for name, value in sample.items()})
        start = {_RUN_Z: sym("past", "z", self.n), _RUN_SUM: ca.SX(0), **self._input()}
        oldest = Block("the model starts from the estimate d ago", start)
        again = Block(f"the model again by {self.predictor.tableau.name}, its squared output error", self._replay())
        return Pieces(
            fields=(
                INNOVATION,
                scalar("newest", 0, kind="index", high=self.size - 1, meaning="index of the newest sample"),
                scalar("filled", 0, kind="index", high=self.size, meaning="samples in the window"),
                Field("recent_y", zeros, meaning="measurement of this call"),
                Field("recent_valid", zeros, meaning="1 where it counts"),
            ),
            groups=(self._group(),),
            predict=(Block("no sample yet", {_RECENT_VALID: ca.SX.zeros(p)}),),
            update=tuple(self._remember(j) for j in range(p)),
            adapt=(
                Block("the newest sample takes the place of the oldest", newest),
                Loop("past", 1, (store,), start=_NEWEST),
                self._find(),
                Loop("past", 1, (oldest,), start=_START),
                Loop("past", self.steps, (again,), start=_FIRST, active=_STEPS),
                Block("innovation", {Place("state", "innovation"): sym("work", "sum")}),
            ),
        )

    def _group(self) -> Group:
        zeros = (0.0,) * self.clock.outputs
        fields = [replace(self.predictor.z, meaning="estimate")]
        fields += [Field("u", (0.0,) * self.clock.inputs, meaning="input")] if self.clock.inputs else []
        fields += [Field("y", zeros, meaning="measurement"), Field("valid", zeros, meaning="1 where it counts")]
        return Group("past", self.size, tuple(fields), "the samples of the window")

    def _remember(self, output: int) -> Program:
        p = self.clock.outputs
        y, valid = ca.SX(sym("state", "recent_y", p)), ca.SX(sym("state", "recent_valid", p))
        y[output], valid[output] = sym("work", "reading"), 1
        return (Block("this sample", {_RECENT_Y: y, _RECENT_VALID: valid}),)

    def _find(self) -> Block:
        newest, filled, size = sym("state", "newest"), sym("state", "filled"), self.size
        count = ca.if_else(filled < size, filled + 1, size)
        oldest = ca.if_else(newest + 1 < count, newest + 1 + size - count, newest + 1 - count)
        first = ca.if_else(oldest + 1 >= size, 0, oldest + 1)
        writes = {_FILLED: count, _START: oldest, _FIRST: first, _STEPS: count - 1}
        return Block("the window starts at the oldest sample", writes)

    def _input(self) -> dict[Place, Graph]:
        return {_RUN_U: sym("past", "u", self.clock.inputs)} if self.clock.inputs else {}

    def _replay(self) -> dict[Place, Graph]:
        """Return the assignments of one simulated model step, and
        of the sum increased by its squared output error."""
        p, m, clock = self.clock.outputs, self.clock.inputs, self.clock
        y, valid, u, before = sym("past", "y", p), sym("past", "valid", p), sym("past", "u", m), sym("work", "uw", m)
        z = sym("work", "zw", self.n)
        after = self.predictor.stepped(z, lambda c: clock.between_samples(c, before, u), clock.dt)
        after = clamped(self.predictor.z, after) if clock.guarded else after
        error = self.predictor.dynamics.error(y, self.predictor.dynamics.output(after, u))
        rates = ca.SX(ca.DM(clock.every)) * valid if clock.every else valid
        squares = summed(self.weights, rates * (error * error))
        return {_RUN_Z: after, _RUN_SUM: ca.fmin(sym("work", "sum") + clock.dt * squares, MOST), **self._input()}


_ROUNDING = 2.0**-6  # of the shortest dt: in a sum of times
_Z, _SUM, _SAMPLES = (Place("predictor", name) for name in ("z", "sum", "samples"))
_OLDEST, _TICK = Place("state", "oldest"), Place("state", "tick")
_RESTART, _BEYOND = Place("work", "restart"), Place("work", "beyond")


@dataclass(frozen=True)
class Staggered:
    """The innovation I_d = integral over [t-d, t] of |y - yhat|^2 by M + 1 copies of the model, of which one restarts
    from the estimate every d/M: `d` (s), `predictors` M, the `tableau` that integrates the copies, `weights` of the
    outputs' squares."""

    d: float
    predictors: int
    tableau: Tableau
    weights: Weights = field(default=(), hash=False)
    hypothesis: Hypothesis = STAGGERED

    def part(self, dynamics: Dynamics, z: Field) -> Predictors:
        """Return the observer's part with M + 1 copies of the model, in C an array of structures."""
        weights = in_order(self.weights, dynamics)

        def build(predictor: Predictor, clock: Clock) -> Pieces:
            length = self.d if clock.varying else samples(self.d, clock.dt, self.predictors)
            return _Copies(predictor, clock, length, self.predictors, weights).pieces

        return Predictors(Predictor(dynamics, z, self.tableau), build)


@dataclass(frozen=True)
class _Copies:
    """Copies of the model, M + 1 for M = `shares`, of which one restarts every `count`/M. `count`: the length of the
    window, in samples, or in time where dt varies."""

    predictor: Predictor
    clock: Clock
    count: float
    shares: int
    weights: tuple[float, ...]

    @property
    def members(self) -> int:
        return self.shares + 1

    @property
    def period(self) -> float:
        return self.count / self.shares if self.clock.varying else int(self.count) // self.shares

    @property
    def most(self) -> float:
        return (
            self.members * (self.period + self.clock.longest) if self.clock.varying else self.members * self.period + 1
        )

    @property
    def sampled(self) -> Graph:
        """The amount by which one sample raises a count: 1, or where dt varies the time since the last call, at most
        the longest dt."""
        return self.clock.longest * self.clock.share if self.clock.varying else ca.SX(1)

    @property
    def n(self) -> int:
        return self.predictor.dynamics.n

    @property
    def total(self) -> Graph:
        """The sums dt (y_j - yhat_j)^2 of a copy of the model for each output (p)."""
        return sym("predictor", "sum", self.clock.outputs)

    @property
    def valid(self) -> Graph:
        return sym("predictor", "samples", self.clock.outputs)

    @property
    def pieces(self) -> Pieces:
        return Pieces(
            fields=(
                INNOVATION,
                scalar("oldest", 0, kind="index", high=self.members - 1, meaning="index of the oldest predictor"),
                self._tick,
            ),
            groups=(self._group(),),
            predict=(Loop("predictor", self.members, self._move()),),
            update=tuple(self._accumulate(j) for j in range(self.clock.outputs)),
            adapt=self._adapt(),
        )

    @property
    def _tick(self) -> Field:
        if self.clock.varying:
            return scalar("tick", 0, low=0.0, high=self.period, unit="s", meaning="time since the last restart")
        return scalar("tick", 0, kind="index", high=self.period - 1, meaning="samples since the last restart")

    def _group(self) -> Group:
        p = self.clock.outputs
        zeros, many = (0.0,) * p, (float(self.most),) * p
        sums = Field("sum", zeros, low=zeros, high=(MOST,) * p, unit="y^2 s", meaning="sum of dt (y - yhat)^2")
        counts = Field("samples", zeros, "index", (-INF,) * p, many, meaning="valid samples in the sum")
        if self.clock.varying:
            counts = Field("samples", zeros, low=zeros, high=many, unit="s", meaning="time of the samples in the sum")
        fields = (replace(self.predictor.z, meaning="predicted state"), sums, counts)
        return Group("predictor", self.members, fields, "copies of the model that run without correction")

    def _move(self) -> Program:
        z, field = sym("predictor", "z", self.n), self.predictor.z
        after = self.predictor.stepped(z, self.clock.u, self.clock.h)
        advance = Block(f"each predictor by {self.predictor.tableau.name}, without correction", {_Z: after})
        still = [k for k in range(self.n) if ca.is_equal(after[k], z[k], 1)]
        if not self.clock.guarded or len(still) == self.n:
            return (advance,)
        return (
            advance,
            Block("is it beyond its box, or lost?", {_BEYOND: outside_box(field, z, still)}),
            When(_BEYOND, (Block("keep it in its box", {_Z: clamped(field, z, still)}),), idle=True),
        )

    def _accumulate(self, output: int) -> Program:
        """Return the statements that add dt (y_j - yhat_j)^2 of
        output j to the sum of every copy of the model."""
        total, valid = self.total, self.valid
        z = sym("predictor", "z", self.n)
        predicted = self.predictor.dynamics.output(z, self.clock.u_now)[output]
        error = self.predictor.dynamics.output_error(output, sym("work", "reading"), predicted)
        weight = self.sampled if self.clock.varying else self.clock.period(output)
        squared = ca.fmin(total[output] + weight * error * error, MOST)
        more = ca.if_else(valid[output] < self.most, valid[output] + self.sampled, self.most)
        add = Block("its squared output error", {_SUM: _with(total, output, squared)})
        tally = Block("one more sample", {_SAMPLES: _with(valid, output, more)})
        return (Loop("predictor", self.members, (add, tally)),)

    def _adapt(self) -> Program:
        """Return the statements that set I_d, the integral of the squared output error over the
        window, to the sum of the oldest copy of the model, and restart this copy when it is due."""
        numbers: list[float] = [max(1, int(self.count) // every) for every in self.clock.every] or [self.count]
        wanted = ca.SX(ca.DM(numbers)) if len({*numbers}) > 1 else numbers[0]  # samples of each output in the window
        scaled = self.total * (wanted / ca.fmax(self.valid, wanted))
        text = "innovation: the sum of the oldest predictor, scaled to the window, never scaled up"
        read = Block(text, {Place("state", "innovation"): summed(self.weights, scaled)})
        varying, after = self.clock.varying, sym("state", "oldest") + 1
        tick = sym("state", "tick") + (self.clock.passed if varying else 1)
        over = tick >= self.period - (_ROUNDING * varying.shortest if varying else 0)
        due = {_RESTART: over, _TICK: ca.if_else(over, 0, tick)}
        none, estimate = ca.SX.zeros(self.clock.outputs), sym("state", self.predictor.z.name, self.n)
        restart = Block("the oldest predictor restarts from the estimate", {_Z: estimate, _SUM: none})
        empty = Block("no sample yet", {_SAMPLES: none})
        rotate = Block("the next one is the oldest", {_OLDEST: ca.if_else(after >= self.members, 0, after)})
        return (
            Loop("predictor", 1, (read,), start=_OLDEST),
            Block(f"one predictor restarts every {self.period:g} {'s' if varying else 'samples'}", due),
            When(_RESTART, (Loop("predictor", 1, (restart, empty), start=_OLDEST), rotate)),
        )


def _with(values: Graph, index: int, value: Graph) -> Graph:
    return ca.vertcat(*(value if i == index else values[i] for i in range(values.numel())))


def staggered(d: float, predictors: int = 4, method: Any = None, weights: float | Values | None = None) -> Staggered:
    """Innovation I_d = integral over [t-d, t] of |y - yhat|^2 by `predictors` + 1 copies of the model, restarted in
    turn, over a window `d` (s), by default with Heun's method.

    `weights`: of each output's square, by name or in their order, 1 by default.

    Raises: `HgogenError` where d, the number or a weight is not positive.
    """
    _positive(d)
    if real("predictors", predictors) not in range(1, 1000):
        raise BadWindowSize(f"predictors = {predictors}", "must be a whole number, from 1 to 999")
    return Staggered(float(d), int(predictors), _tableau(method), _weights(weights))


def window(d: float, method: Any = None, weights: float | Values | None = None) -> Window:
    """Innovation I_d as the paper defines it, with the model simulated again over the window `d` (s) at every sample,
    by default with Heun's method; `weights` of each output's square, by name or in their order, 1 by default."""
    _positive(d)
    return Window(float(d), _tableau(method), _weights(weights))


def _positive(d: float) -> None:
    if not 0 < real("the window d", d) < HUGE:
        raise BadWindowSize(f"the window d = {d!r}", "must be a positive time")


def _tableau(method: Any) -> Tableau:
    tableau = HEUN if method is None else getattr(method, "tableau", None)
    if not isinstance(tableau, Tableau):
        reason = "must be an explicit one: methods.euler, methods.heun or methods.rk4"
        raise BadWindowSize(f"method = {method!r}", reason)
    return tableau


def _weights(declared: Any) -> Weights:
    if declared is None:
        return ()
    values = list(declared.values()) if isinstance(declared, Mapping) else declared
    weights = tuple(map(float, reals("weights", values).reshape(-1)))
    if not weights or not all(0 < weight < HUGE for weight in weights):
        raise BadWindowSize(f"weights = {declared!r}", "must be positive numbers, one for each output")
    return dict(zip(declared, weights, strict=True)) if isinstance(declared, Mapping) else weights
