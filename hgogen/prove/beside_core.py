"""What a plant does beside a step that realises the linear core of an observer, on its ranges.

The plant in the coordinates of the errors, X_k = s_k z_i of a field k that estimates z_i and 0 of a filter, obeys the
observer's own equations, as its output injects nothing. With the core L of `realised`, y the plant's own output and
beta_k = s_k b_i,

    X' = L X + w,   w = B y + beta
    a = X_0 + h phi_1 X'_0 + h phi_2 B (y_1 - y_0),   X+ = a + h phi_2 (beta(a) - beta_0)

the last a step of the program from X_0, of samples y_0 and y_1 that are the plant's at both ends: the line between two
samples needs no share of its own. alpha is what a realisation leaves of a rest that is known at both ends,

    alpha = X_0 + h phi_1 X'_0 + h phi_2 (w_1 - w_0) - X(t + h),   so that
    a - X(t + h) = alpha - h phi_2 (beta_1 - beta_0),   X+ - X(t + h) = alpha + h phi_2 (beta(a) - beta_1)

With v - line what a signal v is beside the line between its ends, |v - line| <= s (h - s)/2 sup|v''|, phi* the
exponential's phi, phi_1 = 1 + h L phi_2 as of each realisation, and h L X'_0 + w_1 - w_0 the integral of
(1 - (h - s) L) X''(s),

    by the matrix exponential   alpha = h (phi_2 - phi_2*) integral of (1 - (h - s) L) X''(s)
                                        - integral of exp((h - s) L) (w - line)(s)
    by the bilinear rule        alpha = -(1 - h L/2)^-1 integral of (X' - line)(s)

entry by entry. Where F has kinks, and derivatives no bound, F and b have steepness in states and inputs that move so
fast, which bounds z'' and b'; and |v - line| <= 2 s (h - s)/h sup|v'|, as if v'' were 4/h times that. |beta_1 - beta_0|
<= h sup|beta'|, and beta(a) is beside beta_1 by what its slopes, those of the error, make of a - X(t + h): that a is
clamped brings it nearer to a plant that keeps to its ranges. The integral with the exponential is a sum over pieces, in
each of which Arb's balls hold it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, arb_mat, ctx

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.polytope import fixed
from hgogen.analysis.spare import heads
from hgogen.prove import inequality
from hgogen.prove.entering import Entering, Sizes, heads_of
from hgogen.prove.inclusion import Inclusion, Uncertain
from hgogen.prove.plant_step import SUMMED, UNKNOWN, PlantStep, Unbounded, loose, times
from hgogen.prove.quadratic import BALLS, Array, floats, identity, rational
from hgogen.rigor.balls import between, magnitude
from hgogen.rigor.definite import number
from hgogen.rigor.interpolation import Table
from hgogen.rigor.points import exact
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.sentence import because

_FEW, _MANY = 8, 64  # pieces of a step
_FINE = 8  # of them, where the core turns by 1
_BARELY = 1 + Fraction(1, 10**6)  # of a size: what is said of it, which a weaker arithmetic reaches
_BENT = 4  # over h: by how much of a first derivative a signal may be beside a line as if it were its second
_SMOOTH = 5  # Taylor coefficients of the plant that are asked for, the last of which is of its third derivative


@dataclass(frozen=True, eq=False)
class BesideCore:
    """The plant's step beside one of an estimator whose error obeys `error` at `theta`; of a plant that is not taken to
    be `smooth` how steep it is stands for its derivatives."""

    plant: PlantStep
    error: Inclusion
    theta: Fraction
    smooth: bool = True

    def enters(self, realisation: inequality.Realisation, leaves: "Leaves") -> Entering:
        """What comes to each field of an estimate that begins at the plant's own state, and of what that follows.
        Raises: `Unbounded`."""
        self._demand_chain()
        try:
            return self._by_derivatives(realisation, leaves)
        except Unbounded:
            return replace(self, smooth=False)._by_derivatives(realisation, leaves)

    def _by_derivatives(self, realisation: inequality.Realisation, leaves: "Leaves") -> Entering:
        """By those of the flow and of the rest, or what stands for them. Raises: `Unbounded`."""
        with ctx.workprec(BALLS):
            weight, alpha = np.abs(realisation(self.L, self.plant.h)[1]) * self.h, leaves.alpha(self)
            ahead = alpha + weight @ np.abs(self.lifted) @ self.most(1, self.plant.rest) * self.h
            e = self.obeyed
            slopes = np.abs(e.M - e.core) + np.abs(e.G) @ np.abs(e.H)  # at most, of what the rest makes of an error
            total = alpha + weight @ slopes @ ahead
            sizes = Sizes(fields=tuple(map(self._over_h, total)))
        return Entering(sizes, self._follows(leaves))

    def _follows(self, leaves: "Leaves") -> Evidence:
        flow, rest = self.plant.flow, self.plant.rest
        known = {"rates": self.plant.moving, "speeds": self.plant.stated_speeds}
        if not self.smooth:
            return {**known, "flow": [], "rest": [], "steepness": [self.plant.steep(flow), self.plant.steep(rest)]}
        return {
            **known,
            "flow": self._derivatives(leaves.flow, flow),
            "rest": tuple(self._derivatives(order, rest) for order in range(1, leaves.rest + 1)),
            "steepness": [],
        }

    @cached_property
    def obeyed(self) -> Uncertain:
        """What the error obeys."""
        return self.error.at(self.theta)

    @property
    def L(self) -> Array:
        """The core (N, N)."""
        return self.obeyed.core

    @property
    def h(self) -> Any:
        """The length of the step, FLINT's."""
        return number(self.plant.h)

    @cached_property
    def lifted(self) -> Array:
        """s (N, n), from the plant's states to the coordinates of the errors."""
        scales, layout = self.error.scales(self.theta), self.error.layout
        assert scales is not None  # a plant's step is asked of numbers alone
        fields = zip(scales, layout.index, layout.fed, strict=True)
        return rational([[s * int(fed and i == at) for at in range(self.plant.form.n)] for s, i, fed in fields])

    @cached_property
    def entering(self) -> Array:
        """B (N, n), by what samples show of each state."""
        entering, shown = 0 * self.lifted, heads_of(self.plant.form)
        assert shown is not None
        for output, (head, slope) in shown.items():
            entering[:, head] += self.obeyed.injected[:, output] * number(slope)
        return entering

    def most(self, order: int, rows: Sequence[sp.Expr]) -> Array:
        """sup of sizes (n) of the derivatives of rows in time, of the order 1 or 2, or what stands for the second.
        Raises: `Unbounded`."""
        if self.smooth:
            return rational(self._derivatives(order, rows))
        rates = times(self.plant.steep(rows), (*self.plant.stated_speeds, *self.plant.moving))
        return rational([(_BENT / self.plant.h) ** (order - 1) * rate for rate in rates])

    def _derivatives(self, order: int, rows: Sequence[sp.Expr]) -> tuple[Fraction, ...]:
        self._demand_smooth()
        for _ in range(order):
            rows = [self.plant.along(row) for row in rows]
        return tuple(loose(row, self.plant.largest(row) * SUMMED) for row in rows)

    def _demand_chain(self) -> None:
        """That the plant obeys the observer's equations. Raises: `Unbounded`."""
        form, each = self.plant.form, range(self.plant.form.n)
        for output in heads(form):
            self.plant.demand_no_input(form.output[output])
        A = form.A.applyfunc(lambda a: exact(sp.sympify(a).xreplace(fixed(form))))
        chain = rational([[Fraction(int(A[i, j].p), int(A[i, j].q)) for j in each] for i in each])
        if (self.L @ self.lifted + self.entering != self.lifted @ chain).any():
            raise Unbounded(because("its core is not the plant's chain in exact numbers"))

    def _demand_smooth(self) -> None:
        """That derivatives are what rules of differentiation say. Raises: `Unbounded`."""
        if not any(row.has(*JUMPS, *KINKS, Table) for row in self.plant.flow):
            return
        try:
            self.plant.series(_SMOOTH, {})
        except UNKNOWN as error:
            pattern = "how far the plant bends in a step has no bound on the ranges: {flow}"
            raise Unbounded(because(pattern, flow=self.plant.flow)) from error

    def _over_h(self, x: Any) -> Fraction:
        """Raises: `Unbounded`."""
        size = arb(x)
        if not size.is_finite():
            raise Unbounded(because("its core turns too fast for a step of {h}", h=float(self.plant.h)))
        return magnitude(size) * _BARELY / self.plant.h


@dataclass(frozen=True)
class Leaves:
    """What a realisation leaves of a rest that is known at both ends of a step: the sizes of `alpha` (N), from the
    derivative of z' of the order `flow`, and from those of b of up to the order `rest`, the first of which counts
    whatever the realisation."""

    flow: int
    rest: int
    alpha: Callable[[BesideCore], Array]


def by_bilinear_rule(step: BesideCore) -> Array:
    """|(1 - h L/2)^-1 s| h^3/12 sup of the third derivatives of z. Raises: `Unbounded`."""
    resolvent, _ = inequality.by_bilinear_rule(step.L, step.plant.h)
    return np.asarray(np.abs(resolvent @ step.lifted) @ step.most(2, step.plant.flow) * (step.h**3 / 12))


def by_matrix_exponential(step: BesideCore) -> Array:
    """By the integral, and by what a program's polynomials may be beside the exponential. Raises: `Unbounded`."""
    source, bent = np.hstack([step.entering, step.lifted]), step.most(1, step.plant.flow)
    driven = _integral(step.L, step.plant.h, source) @ np.concatenate([bent, step.most(2, step.plant.rest)])
    any_of_it = 0 * step.L + number(inequality.WITHIN)
    turned = identity(len(step.L)) + np.abs(step.L) * (step.h / 2)
    return np.asarray(driven + any_of_it @ turned @ np.abs(step.lifted) @ bent * step.h**2)


BILINEAR = Leaves(2, 1, by_bilinear_rule)
EXPONENTIAL = Leaves(1, 2, by_matrix_exponential)


def _integral(L: Array, h: Fraction, source: Array) -> Array:
    """At least the integral of s (h - s)/2 |exp(s L) source| over s from 0 to h, entry by entry."""
    turns = float(np.abs(floats(L)).sum(axis=1).max()) * float(h)
    count, total = min(_MANY, max(_FEW, math.ceil(_FINE * turns))), 0 * source
    for low, high in pairwise(h * Fraction(k, count) for k in range(count + 1)):
        weight = _primitive(high, h) - _primitive(low, h)
        sizes = [[x.abs_upper() for x in row] for row in _power(L, low, high) @ source]
        total = total + np.array(sizes, dtype=object).reshape(source.shape) * number(weight)
    return total


def _primitive(s: Fraction, h: Fraction) -> Fraction:
    """The integral of s (h - s)/2 from 0."""
    return h * s**2 / 4 - s**3 / 6


def _power(L: Array, low: Fraction, high: Fraction) -> Array:
    """Balls that hold exp(s L) of each s between two ends."""
    half, each = (high - low) / 2, range(len(L))
    power = _exp(L, arb(number(low + half))) * _exp(L, between(-half, half))
    return np.array([[power[i, j] for j in each] for i in each], dtype=object)


def _exp(L: Array, s: Any) -> Any:
    return arb_mat([[arb(x) * s for x in row] for row in L.tolist()]).exp()
