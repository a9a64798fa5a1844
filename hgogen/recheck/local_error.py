"""Verification that the sizes of a method's local error follow from the plant, on its ranges.

    x(t + h) = Phi_h(x) + delta,   Phi_h: a step of a method of order p on x' = F(x, u), u' constant

    beside      |delta|/h <= h^q (sup|x_(q+1)| + sup|Phi_(q+1)|), of an order q from 1 to p for each row: Taylor
                coefficients of the flow at any point, of the step at any length up to h; for the order 0 the bound
                below, for a Lipschitz F
    stages      |(1 - c_i) y + c_i C Phi_h(x) - C X_i| <= h^2 sum_j |c_i b_j - a_ij| sum_k |a_jk| sup|y''|, and
                h^3 sup|c_i C Phi_3 - C X_(i,3)| where sum_j (c_i b_j - a_ij) c_j = 0

where the plant's distance from the ends of its ranges is at least h sup|F|. y'' is at most the slopes of y' in states
and inputs times their speeds. The certificate states bounds of the suprema, which are proved by bisection: those of
coefficients on the cells of its tree.

For a plant with a Lipschitz flow, also with kinks, |dF_i/dx_j|, |dF_i/du_k| <= L, |x'| <= V, |u'| <= r, so that |d/dt
F_i(x(t), u(t))| <= W_i = (L (V, r))_i. A sum of values at c_l, with weights w_l that add to c, differs from the
integral from 0 to c by at most W times that of |min(s, c) - sum of the w_l with c_l <= s|. For c = 1, weights that add
the c_l to 1/2, and an F_i with a second derivative of at most w, by w (1/24 + sum |w_l| (c_l - 1/2)^2/2); a linear row
has w = (L (W, 0))_i. A stage differs from the plant at its time by that, times h, and by the differences of the earlier
stages, times L.

The sizes of the local error of a realised core follow from the plant likewise.

The plant in the coordinates of the errors, X_k = s_k z_i for a field k that estimates z_i and 0 for a filter, obeys the
observer's own equations; a step of these from X_0, with the plant's own samples y_0 and y_1,

    X' = L X + w,   w = B y + beta,   beta_k = s_k b_i
    a = X_0 + h phi_1 X'_0 + h phi_2 B (y_1 - y_0),   X+ = a + h phi_2 (beta(a) - beta_0)

differs from X_1 by alpha + h phi_2 (beta(a) - beta_1), and a by alpha - h phi_2 (beta_1 - beta_0). With |beta_1 -
beta_0| <= h sup|beta'|, and the slopes of the remaining error dynamics under any clamp,

    by the bilinear rule        (1 - h L/2) alpha = -integral of (X' - line),   |alpha| <= |phi_1 s| h^3/12 sup|z'''|
    by the matrix exponential   alpha = h (phi_2 - phi_2*) integral of (1 - (h - s) L) X''(s)
                                        - integral of exp((h - s) L) (w - line)(s)

while the plant's distance from the ends of its ranges is at least h sup|F|: `line` is the chord between the ends of a
signal v, |v - line| <= s (h - s)/2 sup|v''|, or with 4/h sup|v'| in the place of sup|v''|, and phi_2* is the
exponential's, from which the program's phi_2 differs by at most 2^-56. The certificate's bounds of the suprema are
proved by bisection; for a plant with kinks it bounds the slopes of F and b, from which their first derivatives follow
with the speeds of states and inputs.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import chain, pairwise
from typing import Any

from .arithmetic import Undefined, Unproved
from .box import Attempt, Box, covered, demand_jacobian, narrowed
from .context import Context, numbers
from .file import column, entries, matrix, part, scalar, whole
from .inclusion import ErrorInclusion
from .inequality import ONE, POLYNOMIAL_ERROR, REALISED, ErrorMatrices, Tableau, Weights
from .interval import Interval, point
from .matrix import Matrix, column_matrix, core_integral, demand_at_least, dot, unit, zeros
from .plant_motion import Derivative, PlantMotion, PlantSeries, demand_derivatives, demand_keys, motion_of
from .text import Expression

_KEYS = ("rates", "speeds", "slopes", "lines", "orders", "flow", "step", "steepness", "tree")
_THIRD = 3  # the coefficient of a line
_MORE = 100  # boxes for the coefficients beyond the cells of a tree
_NONLINEAR = 2  # degree of a nonlinear expression
_HALF, _ZERO, _TWELFTH = Fraction(1, 2), Fraction(0), Fraction(1, 12)


@dataclass(frozen=True)
class LocalError:
    """The local error of a Runge-Kutta method on the plant x' = F(x, u) with constant u', from bounds that a
    certificate states.

    `slopes` (p, n + m): bounds of the partial derivatives of y' in states and inputs; `lines` (p, ..): of the third
    Taylor coefficients of the outputs at the stages `tableau.cubic`, or empty. `orders` (n): the order q for each row
    of F; `flow`, `step` (n): bounds of the Taylor coefficient q + 1 of x(t) and of the step Phi_h, on the cells of the
    bisection `tree`. `steepness` (n, n + m): bounds of |dF/dx| and |dF/du|, used for rows of order 0, else empty.
    """

    context: Context
    tableau: Tableau
    motion: PlantMotion
    slopes: Matrix
    lines: Matrix
    orders: list[int]
    flow: list[Fraction]
    step: list[Fraction]
    steepness: Matrix
    tree: str

    @property
    def deviation(self) -> list[Fraction]:
        """Bounds (n) of the local error |x(t + h) - Phi_h(x)|/h of a step Phi_h of the method. Raises: `Unproved`."""
        h, each = self.motion.h, zip(self.orders, self.flow, self.step, strict=True)
        residual = [h**order * (x + y) for order, x, y in each]
        if not self.steepness:
            return residual
        constant = {name for name, (low, high) in self.context.form.box.items() if low == high}
        linear = [_degree(row, constant) <= 1 for row in self.context.rates]
        lipschitz = lipschitz_error(self.tableau, h, self.steepness, self._moving, linear)
        return [x if order else y for order, x, y in zip(self.orders, residual, lipschitz, strict=True)]

    @property
    def _moving(self) -> tuple[Fraction, ...]:
        return (*self.motion.speeds, *self.motion.rates)

    @property
    def stages(self) -> Matrix:
        """Bounds (p, s) of the distance of each output at each stage from the line through the output's two samples."""
        return Matrix(self._line(*each) for each in zip(self.slopes, self.lines, strict=True))

    def _line(self, slopes: list[Fraction], thirds: list[Fraction]) -> list[Fraction]:
        h = self.motion.h
        curvature = dot(slopes, self._moving)
        away = [sum(map(abs, row), _ZERO) for row in self.tableau.rows]
        sizes = [h**2 * curvature * share for share in abs(self.tableau.deviations).applied(away)]
        for i, third in zip(self.tableau.cubic, thirds, strict=False):
            sizes[i] = min(sizes[i], h**_THIRD * third)
        return sizes

    def demand(self) -> int:
        """Demand that all stated bounds hold on the plant's ranges; return the number of boxes. Raises: `Unproved`."""
        context, box, boxes = self.context, self.context.form.box, self.motion.demand()
        names = (*context.z, *context.file.inputs)
        for j, (head, slope) in self.motion.observed.items():
            bounds = Matrix([[x / abs(slope) for x in self.slopes[j]]])
            boxes += demand_jacobian((context.rates[head],), names, bounds, [Fraction(1)] * len(names), box)
        if self.steepness:
            boxes += demand_jacobian(context.rates, names, self.steepness, [Fraction(1)] * len(names), box)
        if not (any(self.orders) or any(self.lines)):
            return boxes
        return boxes + covered(narrowed(box, self.motion.read), self.tree, self._within, _MORE)

    def _within(self, box: Box) -> Attempt:
        context, orders, whole = self.context, self.orders, self.context.form.box
        rates = dict(zip(context.file.inputs, self.motion.rates, strict=True))
        plant = PlantSeries(context.rates, context.z, rates, {**whole, **box}, whole)
        try:
            flow = plant.flow(max(orders) + 2)
            if not _all_within(_after(flow, orders, self.flow)):
                return Attempt(False)
            steps = plant.step(self.tableau, self.motion.h, max(max(orders) + 2, _THIRD + 1))
        except Undefined:
            return Attempt(False)
        step = [x.coefficients for x in steps[-1]]
        pairs = _after(step, orders, self.step)
        for j, (head, slope) in self.motion.observed.items():
            for i, third in zip(self.tableau.cubic, self.lines[j], strict=False):
                line = point(self.tableau.nodes[i]) * step[head][_THIRD] - steps[i][head].coefficients[_THIRD]
                pairs.append((line, third / abs(slope)))
        return Attempt(_all_within(pairs))


def _after(
    series: Sequence[Sequence[Interval]], orders: Sequence[int], bounds: Sequence[Fraction]
) -> list[tuple[Interval, Fraction]]:
    each = zip(series, orders, bounds, strict=True)
    return [(x[order + 1], most) for x, order, most in each if order]


def _degree(row: Expression, constant: Container[str]) -> int:
    degrees = list[int]()
    for op, args, value in row.instructions:
        column_ = [degrees[arg] for arg in args]
        if op == "symbol":
            degrees.append(int(value not in constant))
        elif op in ("add", "sub", "neg"):
            degrees.append(max(column_))
        elif op == "mul" or (op == "div" and not column_[1]):
            degrees.append(sum(column_))
        else:
            degrees.append(_NONLINEAR if any(column_) else 0)
    return degrees[row.result]


def _all_within(pairs: Iterable[tuple[Interval, Fraction]]) -> bool:
    return all(x.at_least(-most) and x.at_most(most) for x, most in pairs)


def demand_remainder(
    context: Context, tableau: Tableau, h: Fraction, share: Mapping[str, Any]
) -> tuple[PlantMotion, int]:
    """Demand that the sizes stated in a `share`, the evidence on a Runge-Kutta method, are at least its local error on
    the plant; return the plant's motion that this assumes, and the number of boxes. Raises: `Unproved`."""
    follows, p, n, m = part(share, "follows", dict), len(context.form.output), len(context.z), len(context.file.inputs)
    demand_keys(follows, _KEYS)
    motion = motion_of(context, h, follows)
    slopes = matrix(follows, "slopes", p, n + m)
    orders = [whole({"orders": q}, "orders", 0, tableau.order) for q in entries(follows, "orders", n)]
    steepness = Matrix([]) if all(orders) else matrix(follows, "steepness", n, n + m)
    if all(orders) and part(follows, "steepness", list):
        raise Unproved("none of its rows follows from their steepness")
    lines = matrix(follows, "lines", p, len(tableau.cubic) if any(entries(follows, "lines", p)) else 0)
    rows = column(follows, "flow", n), column(follows, "step", n)
    tree = part(follows, "tree", str)
    local_error = LocalError(context, tableau, motion, slopes, lines, orders, *rows, steepness, tree)
    stages, deviation = matrix(share, "stages", p, len(tableau.nodes)), column(share, "beside", n)
    demand_at_least("the method", (*deviation, *chain(*stages)), (*local_error.deviation, *chain(*local_error.stages)))
    return motion, local_error.demand()


# --- where the flow is Lipschitz


def lipschitz_error(
    tableau: Tableau, h: Fraction, steepness: Matrix, moving: Sequence[Fraction], linear: Sequence[bool]
) -> list[Fraction]:
    """Return bounds (n) of the local error |x(t + h) - Phi_h(x)|/h of a step Phi_h of a Runge-Kutta method on x' = F(x,
    u), from bounds `steepness` (n, n + m) of |dF/dx|, |dF/du| and `moving` (n + m) of |x'|, |u'|; `linear` (n): which
    rows of F are linear. Raises: `Unproved`."""
    if any(x < 0 for row in steepness for x in row):
        raise Unproved("one of its steepness is negative")
    n, nodes, off = len(steepness), tableau.nodes, list[list[Fraction]]()
    W = _driven(steepness, moving)
    for row, c in zip((*tableau.rows, tableau.weights), (*nodes, ONE), strict=True):
        deviation = [h * h * _kernel(row, nodes, c) * x for x in W]
        for w, before in zip(row, off, strict=False):
            deviation = [x + h * abs(w) * y for x, y in zip(deviation, _driven(steepness, before), strict=True)]
        off.append(deviation)
    if dot(tableau.weights, nodes) != _HALF:  # not exact for lines
        return [x / h for x in off[-1]]
    second = _driven(steepness, W)
    moment = sum((abs(w) * (c - _HALF) ** 2 for w, c in zip(tableau.weights, nodes, strict=True)), _TWELFTH) / 2
    kernel, residual = _kernel(tableau.weights, nodes, ONE), list[Fraction]()
    for i in range(n):
        less = max(h * kernel * W[i] - h * h * moment * second[i], _ZERO) if linear[i] else _ZERO
        residual.append(off[-1][i] / h - less)
    return residual


def _driven(rows: Matrix, by: Sequence[Fraction]) -> list[Fraction]:
    return [sum((x * y for x, y in zip(row, by, strict=False)), _ZERO) for row in rows]


def _kernel(weights: Sequence[Fraction], nodes: Sequence[Fraction], c: Fraction) -> Fraction:
    """Return the integral from 0 to 1 of |min(s, c) - sum of the weights w_l with c_l <= s| ds: the norm of the Peano
    kernel, which bounds the error of a quadrature with nodes c_l from 0 to c. The weights must add to c, else
    `Unproved` is raised."""
    if sum(weights, _ZERO) != c:
        raise Unproved("its stages are not exact for what is constant")
    jumps = dict.fromkeys(sorted({_ZERO, c, ONE, *nodes}), _ZERO)
    for w, at in zip(weights, nodes, strict=False):
        jumps[at] += w
    value, total = _ZERO, _ZERO
    for here, there in pairwise(jumps):
        value -= jumps[here]
        after = value + (there - here if there <= c else _ZERO)
        # the mean of |x| as x varies linearly from `value` to `after`
        alike = value * after >= 0
        mean = abs(value + after) / 2 if alike else (value**2 + after**2) / (2 * abs(after - value))
        total += mean * (there - here)
        value = after
    return total


_CORE_KEYS = ("rates", "speeds", "flow", "rest", "steepness")
_STAND_IN = 4  # times a first derivative over h: the substitute for the second


@dataclass(frozen=True)
class CoreStep:
    """A step of length `h` of an observer whose linear part X' = L X is realised by `weights`, phi_1 and phi_2 of h L;
    `parts`: its error dynamics. X = s z is the plant's state z in the states of the observer (N), s = `lifted` (N, n),
    and `injected` is B C (N, n).

    Bounds on the plant: `flow` (n), of a time derivative of z'; `nonlinear` (.., n), of the time derivatives of b, from
    the first on.
    """

    parts: ErrorMatrices
    h: Fraction
    weights: Weights
    lifted: Matrix
    injected: Matrix
    flow: list[Fraction]
    nonlinear: Matrix

    def total(self, alpha: Matrix) -> list[Fraction]:
        """Return bounds (N) of the local error |X_1 - X+|/h, X+ the step from the plant's X_0 and X_1 the plant's state
        after it, from bounds `alpha` (N, 1) of the error of a step in which b is known at both ends."""
        _, phi_2, width = self.weights
        weight, parts = self.h * phi_2.mapped(lambda x: abs(x) + width), self.parts
        ahead = alpha + weight @ (self.h * (abs(self.lifted) @ column_matrix(self.nonlinear[0])))
        J = abs(parts.M - parts.L) + abs(parts.G) @ abs(parts.H)  # bounds the Jacobian of the remaining error dynamics
        return [x / self.h for (x,) in alpha + weight @ (J @ ahead)]


@dataclass(frozen=True)
class Realisation:
    """The local error of a realised linear part when b is known at both ends of a step: `alpha`(step), bounds (N, 1),
    from bounds of the time derivative of z' of the order `flow`, and of those of b up to the order `nonlinear`."""

    flow: int
    nonlinear: int
    alpha: Callable[[CoreStep], Matrix]


def _by_bilinear_rule(step: CoreStep) -> Matrix:
    return step.h**3 / 12 * (abs(step.weights[0] @ step.lifted) @ column_matrix(step.flow))


def _by_matrix_exponential(step: CoreStep) -> Matrix:
    L, h, head = step.parts.L, step.h, column_matrix(step.flow)
    source = Matrix([[*row, *column_] for row, column_ in zip(step.injected, step.lifted, strict=True)])
    rotated = unit(len(L)) + h / 2 * abs(L)
    polynomial = Matrix([[POLYNOMIAL_ERROR] * len(L) for _ in L]) @ (rotated @ (abs(step.lifted) @ head))
    return core_integral(L, h, source) @ column_matrix([*step.flow, *step.nonlinear[1]]) + h**2 * polynomial


_REALISATIONS: Mapping[str, Realisation] = {
    "the bilinear rule": Realisation(2, 1, _by_bilinear_rule),
    "the matrix exponential": Realisation(1, 2, _by_matrix_exponential),
}


def demand_core_error(
    context: Context, error: ErrorInclusion, theta: Fraction, evidence: Mapping[str, Any], share: Mapping[str, Any]
) -> tuple[PlantMotion, int]:
    """Demand that the sizes stated in a `share`, the evidence on a realised linear part, are at least its local error
    on the plant; return the plant's motion that this assumes, and the number of boxes. Raises: `Unproved`."""
    follows, n, name = part(share, "follows", dict), len(context.z), evidence["method"]
    demand_keys(follows, _CORE_KEYS)
    realisation, parts, h = _REALISATIONS[name], error.at(theta), scalar(evidence, "dt")
    motion = motion_of(context, h, follows)
    bounds = _by_steepness if part(follows, "steepness", list) else _by_derivatives
    flow, nonlinear, demanded = bounds(motion, follows, realisation)
    lifted = error.lifted(error.scales(context, theta))
    injected = zeros(len(parts.L), n)  # B C
    for j, (head, slope) in motion.observed.items():
        for row, by in zip(injected, parts.B, strict=True):
            row[head] += by[j] * slope
    _demand_chain(context, parts, lifted, injected)
    step = CoreStep(parts, h, REALISED[name](h * parts.L), lifted, injected, flow, nonlinear)
    demand_at_least("the method", column(share, "fields", len(lifted)), step.total(realisation.alpha(step)))
    return motion, motion.demand() + demanded()


def _by_derivatives(
    motion: PlantMotion, follows: Mapping[str, Any], realisation: Realisation
) -> tuple[list[Fraction], Matrix, Callable[[], int]]:
    context, n = motion.context, len(motion.context.z)
    flow, nonlinear = column(follows, "flow", n), matrix(follows, "rest", realisation.nonlinear, n)
    derivatives = [Derivative(row, realisation.flow, most) for row, most in zip(context.rates, flow, strict=True)]
    for order, bounds in enumerate(nonlinear, 1):
        derivatives += [Derivative(row, order, most) for row, most in zip(context.form.b, bounds, strict=True)]
    return flow, nonlinear, partial(demand_derivatives, motion, derivatives)


def _by_steepness(
    motion: PlantMotion, follows: Mapping[str, Any], realisation: Realisation
) -> tuple[list[Fraction], Matrix, Callable[[], int]]:
    """Return bounds of the time derivatives of z' (n) and b (.., n), and a function that proves the stated bounds of
    |dF/dx| and |db/dx| that they follow from: the first derivative is such a bound times the speeds, each higher one
    has a further factor 4/h."""
    context, names = motion.context, (*motion.context.z, *motion.context.file.inputs)
    if follows["flow"] != [] or follows["rest"] != []:
        raise Unproved("its sizes follow from derivatives or from steepness")
    both = (context.rates, context.form.b)
    steep = [
        matrix({"steepness": rows}, "steepness", len(context.z), len(names))
        for rows in entries(follows, "steepness", len(both))
    ]
    flow, nonlinear = (rows.applied([*motion.speeds, *motion.rates]) for rows in steep)

    def stand_in(order: int, first: list[Fraction]) -> list[Fraction]:
        return [(_STAND_IN / motion.h) ** (order - 1) * x for x in first]

    def demanded() -> int:
        pairs, ones = zip(both, steep, strict=True), [Fraction(1)] * len(names)
        return sum(demand_jacobian(rows, names, most, ones, context.form.box) for rows, most in pairs)

    return (
        stand_in(realisation.flow, flow),
        Matrix(stand_in(k, nonlinear) for k in range(1, realisation.nonlinear + 1)),
        demanded,
    )


def _demand_chain(context: Context, parts: ErrorMatrices, lifted: Matrix, injected: Matrix) -> None:
    """Demand L s + B C = s A, s = `lifted`, B C = `injected`, so that X = s z obeys the linear part of the observer.
    Raises: `Unproved`."""
    chain = numbers([context.value(entry) for entry in row] for row in context.form.A)
    if chain is None:
        raise Unproved("the chain of the plant moves, which its method does not realise")
    if parts.L @ lifted + injected != lifted @ Matrix(chain):
        raise Unproved("its core is not the plant's chain")
