"""The rules for all kinds of parts: memory and statements of each, its differential equation, and its step lengths.

A minimum-energy estimator (`MinimumEnergy`) has the second derivatives of the outputs in its Riccati equation:

    Pi' = -Pi F - F'Pi - Pi Q^-1 Pi + C'R C - s D,    D = sum_j R_j (y_j - h_j) d2h_j/dz2
    P'  = F P + P F' + Q^-1 - P C'R C P + s P D P,    P = Pi^-1
    s = rate/max(rate, nu),    nu = |Pi^(-1/2) D Pi^(-1/2)|_F = sqrt(tr (P D)^2)

With s = 1 a large error could make Pi indefinite. With this s, s D lies between -rate Pi and rate Pi: P' <= F P + P
F' + Q^-1 + rate P and Pi' <= -Pi F - F'Pi + C'R C + rate Pi, so both stay finite and positive definite. For nu <= rate
s is 1. A step of finite length need not preserve this: a matrix that is no longer positive definite after it is reset
to its initial value, and the status reports it.

A step is too short if rounding freezes a state: z + dt f rounds to z where |dt f| is less than half the distance
between z and its neighbours. With M the largest |z| of the declared range, this is half an ulp below M. With |f| <= F
on the ranges, by one outward-rounded evaluation, a state is certainly frozen in the binade below M if dt F is less. A
state with F = 0, or without a range, gives no limit.

The law of recovery counts samples. If the largest count lasts for less time than the fastest state needs to cross a
part of its range, the counted quantity does not change meanwhile, and the count means nothing.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Any, Literal

import casadi as ca
import numpy as np

from hgogen.analysis.linearised import flow_jacobians
from hgogen.discretisation.runge_kutta import RK4, Tableau
from hgogen.discretisation.stability import Lengths, Ranges, open_loop_lengths
from hgogen.errors import HgogenError
from hgogen.estimators.innovation import Predictors
from hgogen.estimators.riccati_part import (
    SYMMETRIC,
    Riccati,
    RiccatiVariant,
    SampledFilter,
    View,
    pack,
    pivots,
    riccati_ode,
    solve,
    unpack,
)
from hgogen.estimators.step_lengths import factored_lengths, slopes_without_samples
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.method import Explicit, Method
from hgogen.observer import Observer
from hgogen.part import Clock, Jump, Ode, Part, Pieces
from hgogen.program import Bit, Block, Field, Place, Program, When, sym
from hgogen.rigor.bounds import enclose
from hgogen.sentence import up
from hgogen.signal import spread
from hgogen.stepping.parallel import Parallel, judge_lengths, parallel


def pieces(part: Part, method: Method, clock: Clock) -> Pieces:
    """Return the memory and statements that integrate a part by a method. Raises: `CorrectsAtSamples`, and the errors
    of a method that does not apply to the part."""
    match part:
        case Ode():
            return method.ode(part, clock)
        case Riccati():
            riccati = method.riccati(part, clock)
            if part.gates and not riccati.gate:
                raise CorrectsAtSamples(method.name, "a filter with a gate")
            if part.joint and not riccati.correct:
                raise CorrectsAtSamples(method.name, "a filter with a joint update")
            return riccati
        case MinimumEnergy():
            return minimum_energy_pieces(part, method, clock)
        case SampledFilter(plain=plain, name=name, build=build):
            if not method.riccati(plain, clock).update:  # it would not correct the plain filter
                raise CorrectsAtSamples(method.name, name)
            return build(clock)
        case Predictors(predictor=predictor, build=build):
            return build(predictor, clock)
        case Jump(build=build):
            return build(clock)
        case Parallel():
            return parallel(part, clock, lambda each: pieces(each, method, clock))
    raise TypeError(f"no rule makes statements of a {type(part).__name__}")


@dataclass(eq=False)
class CorrectsAtSamples(HgogenError):
    """The error for a method that integrates a differential equation, applied to a filter that predicts and corrects at
    samples."""

    text = "{method} integrates, {filter} predicts and corrects: take continuous_discrete or cholesky"
    method: str
    filter: str


@dataclass(eq=False)
class NoEquation(HgogenError):
    """The error for the differential equation of an observer that has none."""

    text = "{observer} is no differential equation: {reason}; take its step"
    observer: str
    reason: str


def equation(part: Part, view: Literal["information", "covariance"]) -> Ode | None:
    """Return the differential equation of a part, with the information matrix S = P^-1 or the covariance P, by `view`;
    None for a part that changes only at samples. Raises: `NoEquation`."""
    match part:
        case Ode():
            return part
        case Riccati():
            return riccati_ode(part, view)
        case MinimumEnergy():
            return part.equation(view)
        case SampledFilter(name=name):
            raise NoEquation(name, "it predicts and corrects at samples")
        case Jump(flow=flow):
            return Ode((), lambda values, u, y, valid: flow)
        case Parallel():
            raise NoEquation("a bank", "its members restart, and one of them is selected, at samples")
    return None


def tuned(part: Part, clock: Clock) -> Program:
    """Return the program that computes the derived constants of a part's differential equation whenever parameters
    change."""
    match part:
        case Ode(tune=tune):
            return tune
        case Jump(build=build):
            return build(clock).tune
    return ()


def lengths(observer: Observer, method: Method, dt: float, advice: bool = True) -> Iterator[Lengths]:
    """Yield the step lengths, advised and refused, of each part that limits them, computed as far as `dt` requires;
    none for a discrete plant. `advice`: whether to include the advised length of the model while samples are missing,
    which never refuses a step."""
    without_samples = unmeasured if advice else lambda *_: Lengths()
    if observer.form.system.discrete:
        return
    for part in observer.parts:
        match part:
            case Ode():
                yield method.ode_lengths(part, observer, dt)
                yield without_samples(observer, method.prediction, dt, part)
            case Riccati():
                yield method.riccati_lengths(part, dt)
                yield without_samples(observer, method.prediction, dt)
            case MinimumEnergy():
                yield from minimum_energy_lengths(part, method, dt)
                yield without_samples(observer, method.prediction, dt)
            case SampledFilter(plain=plain):
                yield factored_lengths(plain, dt)
                yield without_samples(observer, RK4, dt)
            case Predictors(predictor=predictor):
                yield predictor.lengths
            case Parallel(member=member):
                yield from (*lengths(member, method, dt, advice), *judge_lengths(part, dt))


def unmeasured(observer: Observer, tableau: Tableau | None, dt: float, part: Ode | None = None) -> Lengths:
    """Return the longest step at which a Runge-Kutta `tableau` resolves the model, or a `part`, while samples are
    missing; no limit if `dt` is not longer, or without a tableau."""
    limits = Lengths() if tableau is None else _unmeasured(observer, tableau, part)
    return limits if dt > limits.take else Lengths()


@lru_cache(maxsize=16)
def _unmeasured(observer: Observer, tableau: Tableau, part: Ode | None) -> Lengths:
    form = observer.form
    tuned = form.system.tunable if part is None else ()
    signals, names = (*form.states, *form.system.inputs, *tuned), (*form.to_form, *form.system.inputs, *tuned)
    low, high = np.array([*map(spread, signals)]).T
    ranges = Ranges(low, high, tuple(map(str, names)), form.n)
    slopes = flow_jacobians(observer.dynamics) if part is None else slopes_without_samples(part, observer)
    return open_loop_lengths(slopes, ranges, tableau, form.system.time)


RESTARTED = Bit(
    "COVARIANCE_RESTARTED",
    "a step left the covariance without positive variances: it restarted at its first value",
    "none if rare; if it comes again, shorten dt, lower curvature or raise Q",
)


@dataclass(frozen=True, eq=False)
class MinimumEnergy(RiccatiVariant):
    """A minimum-energy estimator at theta = 1: the Riccati observer `plain` with the additional term -s D in Pi', D =
    sum_j R_j (y_j - h_j) d2h_j/dz2, s <= 1. `rate` (1/s) limits s D: SX scalar, at most `fastest`."""

    rate: Graph
    fastest: float

    def equation(self, view: View) -> Ode:
        """Return the differential equation of z and Pi = P^-1 (its field is S), or of z and P, by `view`."""
        name, plain, n = SYMMETRIC[view], riccati_ode(self.plain, view), self.plain.dynamics.n

        def rate(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
            slopes, X = plain.rhs(values, u, y, valid), unpack(values[name], n)
            z, dynamics = values[self.plain.z.name], self.plain.dynamics
            pull = valid * dynamics.error(y, dynamics.output(z, u)) / self.plain.R
            curvatures = dynamics.output_curvature(z, u)
            D = sum((pull[j] * curvature for j, curvature in enumerate(curvatures)), ca.SX(n, n))
            PD = X @ D if name == "P" else ca.horzcat(*(solve(X, D[:, j]) for j in range(n)))
            size = ca.sum1(ca.sum2(PD * PD.T))  # nu^2, which rounding can make negative
            share = self.rate / ca.sqrt(ca.fmax(self.rate**2, size))
            term = PD @ X if name == "P" else -D
            return {**slopes, name: slopes[name] + pack(share * term)}

        return Ode(plain.fields, rate)


def minimum_energy_pieces(part: MinimumEnergy, method: Any, clock: Clock) -> Pieces:
    """Return memory and statements of a minimum-energy estimator: an explicit method integrates it in its own
    variables, another method is replaced by Runge-Kutta on (z, P)."""
    explicit = _explicit(method)
    plain = explicit.riccati(part.plain, clock)
    integration = explicit.step(part.equation(explicit.view), clock)
    covariance = next(field for field in plain.fields if field.name == SYMMETRIC[explicit.view])
    return replace(
        plain,
        bits=(*plain.bits, RESTARTED),
        projected=None,  # Pi^-1 is that of weights
        predict=(*integration.predict, *_reset_unless_definite(covariance, part.plain.dynamics.n)),
    )


def minimum_energy_lengths(part: MinimumEnergy, method: Any, dt: float) -> tuple[Lengths, Lengths]:
    """Return two step lengths of a minimum-energy estimator: that of the Riccati observer without the outputs' second
    derivatives, and 1/fastest, the limit due to these."""
    plain = replace(_explicit(method).riccati_lengths(part.plain, dt), other="")
    why = "beyond it the second derivatives of the output can take all of Pi in one step"
    return plain, Lengths(refused=1 / part.fastest, why=why, rule=plain.rule)


def _explicit(method: Any) -> Explicit:
    return method if isinstance(method, Explicit) else Explicit(RK4, "covariance")


def _reset_unless_definite(covariance: Field, n: int) -> Program:
    """Return the statements that reset a packed matrix (n, n) = L D L' to its initial value unless D > 0."""
    place = Place("state", covariance.name)
    definite = reduce(ca.logic_and, (pivot > 0 for pivot in pivots(unpack(sym(*place, covariance.size), n))[1]))
    first = {place: ca.SX(ca.DM(covariance.initial)), Place("status", "COVARIANCE_RESTARTED"): ca.SX(1)}
    return (
        Block("is it positive definite?", {Place("work", "broken"): ca.logic_not(definite)}),
        When(Place("work", "broken"), (Block("a covariance that is none restarts", first),)),
    )


_DIGITS = {"float": 24, "double": 53}  # binary


@dataclass(eq=False)
class StepTooShort(HgogenError):
    """The error for a step length at which rounding freezes a state, or a count exceeds its number type; `take` is long
    enough, and `way` names another remedy."""

    dt: float
    why: str
    take: float
    unit: str
    way: str = ""

    def __str__(self) -> str:
        return f"dt = {self.dt:g} {self.unit} is too short: {self.why}; take dt >= {up(self.take, 3)}{self.way}"


def demand_motion(form: Form, dt: float, real: str) -> None:
    """Raise `StepTooShort` if rounding in the type `real` certainly freezes a state near the end of its range; never
    for a discrete plant."""
    if form.system.discrete:
        return
    for name, (low, high), fastest in _fastest(form):
        end = max(abs(low), abs(high))
        share, power = math.frexp(end)
        half = math.ldexp(1.0, power - (share == 0.5) - _DIGITS[real] - 1)
        if dt * fastest < half:
            why = (
                f"the model moves {name} by at most {dt * fastest:.3g} in a step, and half the distance of two numbers "
                f"of type {real} below {end:g} is {half:.3g}, so that it stands still there"
            )
            way = ', real = "double",' * (real == "float") + f" or estimate {name} as the difference from a constant"
            raise StepTooShort(dt, why, half / fastest, form.system.time, way)


def demand_countable(form: Form, dt: float, most: int, part: float) -> None:
    """Raise `StepTooShort` where no state of the form can move by the share `part` of its range in `most` samples."""
    times = [part * (high - low) / fastest for _, (low, high), fastest in _fastest(form)]
    if times and most * dt < min(times):
        why = f"no state moves by {part:.0%} of its range in the {most} samples that can be counted"
        raise StepTooShort(dt, why, min(times) / most, form.system.time)


@lru_cache(maxsize=16)  # called for the counts, and for the precision
def _fastest(form: Form) -> tuple[tuple[str, tuple[float, float], float], ...]:
    ranges = form.box
    bounds = (max(abs(float(end)) for end in enclose(row, ranges)) for row in form.flow)
    rows = zip(form.names, form.states, bounds, strict=True)
    return tuple((name, z.interval, fastest) for name, z, fastest in rows if z.bounded and 0 < fastest < math.inf)
