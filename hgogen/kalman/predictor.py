"""What every innovation shares: the model without correction over one step, samples of a window, outputs' weights."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import casadi as ca

from hgogen.discretisation.routine import routine
from hgogen.discretisation.runge_kutta import Tableau, advance
from hgogen.discretisation.stability import EVERYWHERE, Lengths, decay_limits
from hgogen.errors import BadArgument, HgogenError
from hgogen.graph import Graph
from hgogen.part import Clock, Part, Pieces
from hgogen.program import Field, scalar
from hgogen.reading.named import Values, of_outputs
from hgogen.signal import LOST
from hgogen.structure.dynamics import HUGE, Dynamics, clamp, inside
from hgogen.structure.jacobians import jacobians_on_box
from hgogen.theorem import Hypothesis

Weights: TypeAlias = tuple[float, ...] | Mapping[str, float]
POINTS = 12  # corners, and as many points inside, at which the model's decay is judged
MOST = LOST  # of a squared error
INNOVATION = scalar("innovation", 0, low=0.0, high=MOST, unit="y^2 s", meaning="innovation I_d")


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


class BadWindowSize(BadArgument):
    """A window, a number of predictors or a method that cannot be used."""


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


@dataclass(frozen=True)
class Predictor:
    """The open-loop model over one step and its output error."""

    dynamics: Dynamics
    z: Field
    tableau: Tableau

    @property
    def lengths(self) -> Lengths:
        """The step lengths at which the tableau follows the model's decay."""
        limits = decay_limits(jacobians_on_box(self.dynamics, POINTS)[0], self.tableau.polynomial)
        why = f"nowhere in the declared box does a predictor by {self.tableau.name} follow the model's decay beyond it"
        return Lengths(refused=float(limits.max()), take=float(limits.min()), why=why, basis=EVERYWHERE)

    def moved(self, z: Graph, u: Callable[[float], Graph], dt: float) -> Graph:
        """z one step later without correction, not yet `clamped` to the box of the observer's state."""
        sizes = {"z": z.numel(), "u": u(0.0).numel()}
        flow = routine("flow", sizes, lambda at: {"dz": self.dynamics.flow(at["z"], at["u"])})
        stages = advance(self.tableau, lambda v, c: {"z": flow({**v, "u": u(c)})["dz"]}, {"z": z}, dt)
        result: Graph = stages.result["z"]
        return result


@dataclass(frozen=True, eq=False)
class Predictors(Part):
    """Copies of the model without correction as a part of an observer; `build` makes its pieces, the same whatever the
    method: the predictors have their own."""

    predictor: Predictor
    build: Callable[[Predictor, Clock], Pieces]


def clamped(field: Field, value: Graph, still: Collection[int] = ()) -> Graph:
    """Each element clamped to the field's box, but for those that are `still`, which are in it; its initial value where
    it is not a number or absurd."""
    elements = []
    for i, end in enumerate(field.box_within(HUGE)):
        inside = clamp(value[i], *end)
        kept_in = ca.if_else(ca.fabs(value[i]) <= HUGE, inside, field.initial[i])
        elements.append(value[i] if i in still else kept_in)
    return ca.vertcat(*elements)


def beyond(field: Field, value: Graph, still: Collection[int]) -> Graph:
    """Whether an element that is not `still` is beyond the field's box, or lost."""
    moving = [i for i in range(value.numel()) if i not in still]
    ends = field.box_within(HUGE)
    return ca.logic_not(inside(value[moving], [ends[i] for i in moving]))


def samples(d: float, dt: float, shares: int = 1) -> int:
    """The number of samples d/dt, which must be a whole multiple of `shares`.

    Raises: `BadWindow`.
    """
    count = round(d / dt)
    if count < 1 or count % shares or abs(count * dt - d) > 1e-9 * d:
        raise BadWindow(d, dt, shares)
    return count


def in_order(weights: Weights | Values, dynamics: Dynamics) -> tuple[float, ...]:
    """The weights in the order of the outputs.

    Raises: `BadNames`; `BadWindowSize` for another number of them.
    """
    ordered = tuple(of_outputs("weights", weights, dynamics.form)) if weights else ()
    if ordered and len(ordered) != dynamics.outputs:
        reason = f"must have one number for each of {dynamics.outputs} outputs"
        raise BadWindowSize(f"weights of length {len(ordered)}", reason)
    return ordered


def summed(weights: tuple[float, ...], squares: Graph) -> Graph:
    """The weighted sum over outputs (p), limited so that it stays a number."""
    if weights:
        return ca.fmin(ca.dot(ca.SX(ca.DM(weights)), squares), MOST)
    return squares if squares.numel() == 1 else ca.fmin(ca.sum1(squares), MOST)
