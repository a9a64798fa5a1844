"""The one place that knows all kinds of parts: which rule makes memory and statements of each, what its differential
equation is, and how long a step may be."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from hgogen.analysis.jacobians import flow_jacobians
from hgogen.discretisation.open_loop_limit import Ranges, open_loop_lengths
from hgogen.discretisation.runge_kutta import RK4, Tableau
from hgogen.discretisation.stability import Lengths
from hgogen.errors import HgogenError
from hgogen.estimators.covariance import covariance_ode, information_ode
from hgogen.estimators.factored import factored_lengths
from hgogen.estimators.innovation import Predictors
from hgogen.estimators.riccati_part import AtSamples, Riccati
from hgogen.estimators.transient import errors_at
from hgogen.method import Method
from hgogen.observer import Observer
from hgogen.part import Clock, Jump, Ode, Part, Pieces
from hgogen.program import Program
from hgogen.signal import spread
from hgogen.stepping.curvature import Curved, curved, curved_lengths
from hgogen.stepping.parallel import Parallel, judge_lengths, parallel


def pieces(part: Part, method: Method, clock: Clock) -> Pieces:
    """A part as memory and statements.

    Raises: what the method raises of a part that it does not take; `MovesAtSamples`.
    """
    match part:
        case Ode():
            return method.ode(part, clock)
        case Riccati():
            return method.riccati(part, clock)
        case Curved():
            return curved(part, method, clock)
        case AtSamples(plain=plain, name=name, build=build):
            if not method.riccati(plain, clock).update:  # it would not correct the filter that this stands on
                raise MovesAtSamples(method.name, name)
            return build(clock)
        case Predictors(predictor=predictor, build=build):
            return build(predictor, clock)
        case Jump(build=build):
            return build(clock)
        case Parallel():
            return parallel(part, clock, lambda each: pieces(each, method, clock))
    raise TypeError(f"no rule makes statements of a {type(part).__name__}")


@dataclass(eq=False)
class MovesAtSamples(HgogenError):
    """A method that integrates, asked of a filter that predicts and corrects."""

    method: str
    filter: str

    def __str__(self) -> str:
        return f"{self.method} integrates, {self.filter} predicts and corrects: take continuous_discrete or cholesky"


@dataclass(eq=False)
class NoEquation(HgogenError):
    """A differential equation asked of an observer that is none."""

    observer: str
    reason: str

    def __str__(self) -> str:
        return f"{self.observer} is no differential equation: {self.reason}; take its step"


def equation(part: Part, view: Literal["information", "covariance"]) -> Ode | None:
    """The differential equation of a part, of a covariance in this view; None for what moves at samples alone.

    Raises: `NoEquation`.
    """
    match part:
        case Ode():
            return part
        case Riccati():
            return information_ode(part) if view == "information" else covariance_ode(part)
        case Curved():
            return part.equation(view)
        case AtSamples(name=name):
            raise NoEquation(name, "it predicts and corrects at samples")
        case Jump(flow=flow):
            return Ode((), lambda values, u, y, valid: flow)
        case Parallel():
            raise NoEquation("a bank", "its members restart, and one of them is selected, at samples")
    return None


def tuned(part: Part, clock: Clock) -> Program:
    """What `tune` computes for the differential equation of a part."""
    match part:
        case Ode(tune=tune):
            return tune
        case Jump(build=build):
            return build(clock).tune
    return ()


def lengths(observer: Observer, method: Method, dt: float) -> Iterator[Lengths]:
    """The step lengths of each part that has some, as far as `dt` asks for them."""
    for part in observer.parts:
        match part:
            case Ode():
                yield method.ode_lengths(part, observer, dt)
                yield unmeasured(observer, method.prediction, dt, part)
            case Riccati():
                yield method.riccati_lengths(part, dt)
                yield unmeasured(observer, method.prediction, dt)
            case Curved():
                yield from curved_lengths(part, method, dt)
                yield unmeasured(observer, method.prediction, dt)
            case AtSamples(plain=plain):
                yield factored_lengths(plain, dt)
                yield unmeasured(observer, RK4, dt)
            case Predictors(predictor=predictor):
                yield predictor.lengths
            case Parallel(member=member):
                yield from (*lengths(member, method, dt), *judge_lengths(part, dt))


def unmeasured(observer: Observer, tableau: Tableau | None, dt: float, part: Ode | None = None) -> Lengths:
    """The step length up to which the model is followed while samples are missing, if `dt` is longer: of its Jacobian,
    or of the Jacobian of a part without samples; none where a method has no tableau."""
    known = Lengths() if tableau is None else _unmeasured(observer, tableau, part)
    return known if dt > known.take else Lengths()


@lru_cache(maxsize=16)
def _unmeasured(observer: Observer, tableau: Tableau, part: Ode | None) -> Lengths:
    form = observer.form
    tuned = form.system.tunable if part is None else ()
    signals, names = (*form.states, *form.system.inputs, *tuned), (*form.to_form, *form.system.inputs, *tuned)
    low, high = np.array([*map(spread, signals)]).T
    ranges = Ranges(low, high, tuple(map(str, names)), form.n)
    if part is None:
        return open_loop_lengths(flow_jacobians(observer.dynamics), ranges, tableau, form.system.time)
    errors = errors_at(part, observer)
    return open_loop_lengths(lambda points: errors(points)[1], ranges, tableau, form.system.time)
