"""That the sizes of what a realised core leaves follow from the plant, on its ranges.

The plant in the coordinates of the errors, X_k = s_k z_i of a field k that estimates z_i and 0 of a filter, obeys the
observer's own equations; a step of these from X_0, of the plant's own samples y_0 and y_1,

    X' = L X + w,   w = B y + beta,   beta_k = s_k b_i
    a = X_0 + h phi_1 X'_0 + h phi_2 B (y_1 - y_0),   X+ = a + h phi_2 (beta(a) - beta_0)

is beside X_1 by alpha + h phi_2 (beta(a) - beta_1), and a by alpha - h phi_2 (beta_1 - beta_0). With |beta_1 - beta_0|
<= h sup|beta'|, and the slopes of the rest of what the error obeys, whatever a clamp takes of them,

    by the bilinear rule        (1 - h L/2) alpha = -integral of (X' - line),   |alpha| <= |phi_1 s| h^3/12 sup|z'''|
    by the matrix exponential   alpha = h (phi_2 - phi_2*) integral of (1 - (h - s) L) X''(s)
                                        - integral of exp((h - s) L) (w - line)(s)

while the plant keeps clear of the ends of its ranges by h sup|F|: `line` is that between the ends of a signal v, |v -
line| <= s (h - s)/2 sup|v''|, or as if v'' were 4/h sup|v'|, and phi_2* the exponential's, of which the program's phi_2
is within 2^-56. Suprema are at most what the certificate says of them, shown by bisection; of a plant with kinks it
says how steep F and b are, of which their first derivatives follow, of states and inputs that move so fast.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

from .box import NotShown
from .context import Context, numbers
from .file import column, entries, matrix, part, scalar
from .inequality import REALISED, TAKEN, Parts, Weights
from .matrix import Matrix, demand_enough, minus, plus, scaled, sizes, times, unit, zeros
from .plant_motion import Derivative, PlantMotion, demand_derivatives, demand_keys, motion_of
from .slope import no_steeper
from .transition import core_integral
from .uncertain import ErrorInclusion

_KEYS = ("rates", "speeds", "flow", "rest", "steepness")
_BENT = 4  # over h, of a first derivative: what stands for the second


@dataclass(frozen=True)
class AtCore:
    """A step of length `h` of what obeys the core L of `parts`, by `weights`; of the plant's states `lifted`, s (N, n),
    and what `entering` (N, n) samples show of them, B C.

    Of the plant, bounds of a derivative of the `flow` z' in time (n), and of the first ones of the `rest` b, by their
    orders from 1 (.., n)."""

    parts: Parts
    h: Fraction
    weights: Weights
    lifted: Matrix
    entering: Matrix
    flow: list[Fraction]
    rest: Matrix

    def total(self, alpha: Matrix) -> list[Fraction]:
        """By how much a step is beside the plant (N), over h, of the sizes alpha (N, 1)."""
        _, phi_2, width = self.weights
        weight = [[self.h * (abs(x) + width) for x in row] for row in phi_2]
        moved = scaled(self.h, times(sizes(self.lifted), _upright(self.rest[0])))
        ahead = plus(alpha, times(weight, moved))
        parts = self.parts
        J = sizes(minus(parts.M, parts.L))  # at most, of what the rest makes of an error
        J = plus(J, times(sizes(parts.G), sizes(parts.H))) if parts.H else J
        return [x / self.h for (x,) in plus(alpha, times(weight, times(J, ahead)))]


@dataclass(frozen=True)
class Leaves:
    """What a realisation leaves of a plant whose rest is known at both ends of a step: the sizes `alpha` (N, 1), from
    the derivative of z' of the order `flow`, and those of b of up to the order `rest`."""

    flow: int
    rest: int
    alpha: Callable[[AtCore], Matrix]


def _by_bilinear_rule(step: AtCore) -> Matrix:
    phi_1, _, _ = step.weights
    return scaled(step.h**3 / 12, times(sizes(times(phi_1, step.lifted)), _upright(step.flow)))


def _by_matrix_exponential(step: AtCore) -> Matrix:
    L, h, (head, bent) = step.parts.L, step.h, (_upright(step.flow), _upright(step.rest[1]))
    source = [[*row, *own] for row, own in zip(step.entering, step.lifted, strict=True)]
    turned = plus(unit(len(L)), scaled(h / 2, sizes(L)))
    taken = times([[TAKEN] * len(L) for _ in L], times(turned, times(sizes(step.lifted), head)))
    return plus(times(core_integral(L, h, source), [*head, *bent]), scaled(h**2, taken))


_LEAVES: Mapping[str, Leaves] = {
    "the bilinear rule": Leaves(2, 1, _by_bilinear_rule),
    "the matrix exponential": Leaves(1, 2, _by_matrix_exponential),
}


def demand_left_by_core(
    context: Context, error: ErrorInclusion, theta: Fraction, evidence: Mapping[str, Any], share: Mapping[str, Any]
) -> tuple[PlantMotion, int]:
    """How the plant moves, from which the sizes of the share follow, with how many boxes. Raises: `NotShown`."""
    follows, n, name = part(share, "follows", dict), len(context.z), evidence["method"]
    demand_keys(follows, _KEYS)
    leaves, parts, h = _LEAVES[name], error.at(theta), scalar(evidence, "dt")
    motion = motion_of(context, h, follows)
    bounds = _by_steepness if part(follows, "steepness", list) else _by_derivatives
    flow, rest, shown = bounds(motion, follows, leaves)
    each = zip(error.scales(context, theta), error.index, error.fed, strict=True)
    lifted = [[s * int(fed and i == at) for at in range(n)] for s, i, fed in each]
    entering = zeros(len(parts.L), n)  # B C, from what outputs show
    for j, (head, slope) in motion.shown.items():
        for row, by in zip(entering, parts.B, strict=True):
            row[head] += by[j] * slope
    _demand_chain(context, parts, lifted, entering)
    step = AtCore(parts, h, REALISED[name](scaled(h, parts.L)), lifted, entering, flow, rest)
    least = step.total(leaves.alpha(step))
    demand_enough("the method", column(share, "fields", len(lifted)), least)
    return motion, motion.demand() + shown()


def _by_derivatives(
    motion: PlantMotion, follows: Mapping[str, Any], leaves: Leaves
) -> tuple[list[Fraction], Matrix, Callable[[], int]]:
    """Bounds of the derivatives of the flow and of the rest, and what shows them with how many boxes. Raises:
    `NotShown`."""
    context, n = motion.context, len(motion.context.z)
    flow, rest = column(follows, "flow", n), matrix(follows, "rest", leaves.rest, n)
    derivatives = [Derivative(row, leaves.flow, most) for row, most in zip(context.rates, flow, strict=True)]
    for order, bounds in enumerate(rest, 1):
        derivatives += [Derivative(row, order, most) for row, most in zip(context.form.b, bounds, strict=True)]
    return flow, rest, partial(demand_derivatives, motion, derivatives)


def _by_steepness(
    motion: PlantMotion, follows: Mapping[str, Any], leaves: Leaves
) -> tuple[list[Fraction], Matrix, Callable[[], int]]:
    """The same, and what stands for them, of how steep both are. Raises: `NotShown`."""
    context, names = motion.context, (*motion.context.z, *motion.context.file.inputs)
    if follows["flow"] != [] or follows["rest"] != []:
        raise NotShown("its sizes follow from derivatives or from steepness")
    both = (context.rates, context.form.b)
    steep = [
        matrix({"steepness": rows}, "steepness", len(context.z), len(names))
        for rows in entries(follows, "steepness", len(both))
    ]
    moving = _upright([*motion.speeds, *motion.rates])
    flow, rest = ([x for (x,) in times(rows, moving)] for rows in steep)

    def standing(order: int, first: list[Fraction]) -> list[Fraction]:
        return [(_BENT / motion.h) ** (order - 1) * x for x in first]

    def shown() -> int:
        ones = [Fraction(1)] * len(names)
        pairs = zip(both, steep, strict=True)
        return sum(no_steeper(rows, names, most, ones, context.form.box) for rows, most in pairs)

    return standing(leaves.flow, flow), [standing(k, rest) for k in range(1, leaves.rest + 1)], shown


def _demand_chain(context: Context, parts: Parts, lifted: Matrix, entering: Matrix) -> None:
    """L s + B C = s A: that X obeys the observer's equations. Raises: `NotShown`."""
    chain = numbers([context.value(entry) for entry in row] for row in context.form.A)
    if chain is None:
        raise NotShown("the chain of the plant moves, which its method does not realise")
    if plus(times(parts.L, lifted), entering) != times(lifted, chain):
        raise NotShown("its core is not the plant's chain")


def _upright(values: list[Fraction]) -> Matrix:
    return [[value] for value in values]
