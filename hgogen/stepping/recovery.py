"""Recovery: an estimate that good samples do not bring back restarts from the sample.

    far      a sample is valid, and the estimate is outside a declared range by more than MARGIN of its width, or
             |y_j - yhat_j| > SHARE times what y_j can span
    c <- c + 2 p_j  where far,   c <- max(c - p_j, 0)  elsewhere           at each valid sample, p_j its period in dt
    c >= w:  the estimate restarts from the sample; c <- min(w, 2 W), w <- min(2 w, 4 W)
    c = 0:   w <- W
    W = 2 p T/dt, at most LONGEST                                          T of stepping/patience.py

Far for longer than T an estimate is taken not to converge, but to sit in a corner of its outer box, or at a false
equilibrium beyond the ranges, where the model is evaluated at the edge. That is a judgement by rates at rest and no
theorem: an estimate that converges more slowly is cut short, again and again where it needs more than 2 T. An
innovation that is far, or an estimate that is out of a range by CLEARLY of its width, is a clear sign: it counts T/T_c
times as much, so that T_c of it is enough. An observer without a model of its last row, whose error never tends to 0,
is far by its innovation only.

Restart from the sample: all memory is as after a reset but for what lasts, and the fields x that the estimate z(x) is
read from,

    x = x_0 + V g (y_j - h_j(z(x_0), u)) / (g' V g),   g = dh_j/dx at x_0,   V = diag(width of the outer box)^2

with x_0 their first values: the nearest point to rest, in units of the outer box, at which the linearised output is
what was measured. A cold restart would fall into the same attractor. While an estimate stays far, it restarts after T,
2 T, and then every 2 T; w is W again once the samples have been good for 2 T to 4 T. A theorem of convergence holds
from the last restart on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

import casadi as ca
import numpy as np

from hgogen.chains.core import numbers
from hgogen.observer import HUGE, Clock, Observer, Pieces
from hgogen.program import INF, Block, Field, Program, When, column, scalar, sym
from hgogen.stepping.guards import any_of, outside, readings
from hgogen.stepping.members import fresh, fresh_groups, read_fields
from hgogen.stepping.patience import Patience, patience
from hgogen.structure.dynamics import clamp

SHARE = 0.1  # of what an output can span: an innovation beyond it is far
CLEARLY = 0.25  # of a range: an estimate so far beyond it is as clear a sign as an innovation
MARGIN = 0.05  # of a range: the estimate of a plant that rests at the edge may lie beyond it, of noise and bias
LONGEST = 1 << 21  # a wait whose fourfold a float counts to


# by output: what was measured, whether it is valid, and its error before the correction; SX scalars
Samples = Mapping[int, tuple[Any, Any, Any]]


@dataclass(frozen=True, eq=False)
class Recovery:
    """The law for an observer whose parts are `pieces`; see the module."""

    observer: Observer
    clock: Clock
    pieces: Pieces

    @cached_property
    def _patience(self) -> Patience:
        return patience(self.observer, self.clock, self._widest())

    @cached_property
    def wait(self) -> int:
        """W, the count of doubt at which the estimate first restarts."""
        return max(2, min(ceil(2 * self.clock.outputs * self._patience.far / self.clock.dt), LONGEST))

    @property
    def fields(self) -> tuple[Field, ...]:
        """What the law remembers."""
        evidence = "evidence of valid samples that the estimate is lost"
        limit = "doubt at which it restarts from the sample"
        return (
            scalar("doubt", 0.0, low=0.0, high=4 * self.wait, meaning=evidence),
            scalar("patience", self.wait, low=self.wait, high=4 * self.wait, meaning=limit),
        )

    def _doubt(self, value: Any) -> Any:
        """c, where it can be; SX."""
        return clamp(value, 0.0, 4.0 * self.wait)

    def _limit(self, value: Any) -> Any:
        """w, where it can be; SX."""
        return clamp(value, self.wait, 4.0 * self.wait)

    def watch(self, samples: Samples, says: bool) -> Program:
        """The law at the end of a section that has corrected the estimate.

        `says`: whether this section also raises OUTSIDE_BOX.
        """
        large = self._large(samples)
        near, far = (
            any_of(large if self.observer.practical else [outside(self.observer, margin), *large])
            for margin in (0.0, MARGIN)
        )
        sampled = any_of(valid for _, valid, _ in samples.values())
        doubtful = ca.logic_and(sampled, ca.logic_or(near, sym("state.doubt") > 0))
        bit = {"status.OUTSIDE_BOX": outside(self.observer)} if says else {}
        weight = self._weight(tuple(samples))
        clearly = any_of(large if self.observer.practical else [outside(self.observer, CLEARLY), *large])
        judged = When("work.far", self._rise(weight, clearly, samples), self._fall(weight))
        return (
            Block("is the estimate where it cannot be for long?", {**bit, "work.doubtful": doubtful}),
            When("work.doubtful", (Block("is it far from where it can be?", {"work.far": far}), judged)),
        )

    def _large(self, samples: Samples) -> list[Any]:
        """Whether each output that has a range is valid and off by more than a share of it."""
        spans = [high - low for low, high in readings(self.observer.form)]
        return [
            ca.logic_and(valid, ca.fabs(error) > SHARE * spans[j])
            for j, (_, valid, error) in samples.items()
            if spans[j] < INF
        ]

    def _rise(self, weight: int, clearly: Any, samples: Samples) -> Program:
        doubt, limit = sym("state.doubt"), sym("state.patience")
        quick = float(f"{self._patience.far / self._patience.clear:.3g}")
        step = 2 * weight if quick == 1 else ca.if_else(clearly, 2 * weight * quick, 2 * weight)
        return (
            Block("more doubt", {"state.doubt": self._doubt(doubt + step)}),
            Block("is patience at its end?", {"work.over": doubt >= self._limit(limit)}),
            When("work.over", self._restart(samples)),
        )

    def _fall(self, weight: int) -> Program:
        doubt, limit = sym("state.doubt"), sym("state.patience")
        again = ca.if_else(doubt <= weight, self.wait, self._limit(limit))
        return (Block("less doubt", {"state.doubt": self._doubt(doubt - weight), "state.patience": again}),)

    def _weight(self, judged: tuple[int, ...]) -> int:
        """p_j: what a judgement by these outputs counts, so that all of them add up to p in a time dt."""
        if len(judged) == self.clock.outputs:
            return self.clock.outputs
        return self.clock.every[judged[0]] if self.clock.every else 1

    def _restart(self, samples: Samples) -> Program:
        """Memory as after a reset, but for the estimate, which is the nearest to it that fits the samples."""
        shown = self._shown()
        limit = sym("state.patience")
        slow = {"state.doubt": clamp(limit, self.wait, 2.0 * self.wait), "state.patience": self._limit(2 * limit)}
        rest = fresh("state", [field for field in self.pieces.fields if field not in shown and not field.lasting])
        fit = self._fitted(shown, samples)
        return (
            Block("the next restart waits longer", slow),
            Block("the estimate restarts from the sample", {**fit, "status.RESTARTED_FROM_SAMPLE": ca.SX(1)}),
            *rest,
            *fresh_groups("state", self.pieces.fields, self.pieces.groups, self.observer.z),
        )

    def _fitted(self, shown: tuple[Field, ...], samples: Samples) -> dict[str, Any]:
        """x of the module by place, one valid sample after the other."""
        u = sym("state.u", len(self.observer.form.system.inputs))
        x = ca.vertcat(*(sym(f"state.{field.name}", field.size) for field in shown))
        h = self.observer.dynamics.output(self.observer.z, u)
        ends = [end for field in shown for end in field.box]
        widths = np.array([high - low for low, high in ends])
        widths[~np.isfinite(widths)] = max(widths[np.isfinite(widths)], default=1.0)
        V, value = ca.DM(widths**2), ca.SX(ca.DM([v for field in shown for v in field.initial]))
        spans = [high - low for low, high in readings(self.observer.form)]
        for j, (y, valid, _) in samples.items():
            expected, slope = ca.substitute([h[j], ca.jacobian(h[j], x).T], [x], [value])
            across = ca.dot(slope, V * slope)
            least = (1e-6 * spans[j]) ** 2 if spans[j] < INF else 1e-30
            known = ca.if_else(ca.fabs(y) <= HUGE, y, expected)  # as `valid` says, once more where an analyser sees it
            moved = value + V * slope * ((known - expected) / ca.fmax(across, least))
            value = ca.if_else(valid, moved, value) if len(samples) > 1 else moved
        value = column(clamp(value[i], *end) for i, end in enumerate(ends))
        places = np.cumsum([0, *(field.size for field in shown)]).tolist()
        parts = ca.vertsplit(value, places)
        return {f"state.{field.name}": part for field, part in zip(shown, parts, strict=True)}

    def _shown(self) -> tuple[Field, ...]:
        """The fields that the estimate is read from."""
        read = read_fields([self.observer.z])
        return tuple(field for field in self.pieces.fields if field.name in read and field.kind == "real")

    def _widest(self) -> float:
        """r: by how much the outer box is wider than the declared one, at the coordinate where it is the most."""
        shown = self._shown()
        x = ca.vertcat(*(sym(f"state.{field.name}", field.size) for field in shown))
        values = {f"state.{field.name}": np.array(field.initial) for field in shown}
        values |= {"state.u": np.zeros(len(self.observer.form.system.inputs)), **self.clock.nominal}
        slope = np.abs(numbers(ca.jacobian(self.observer.z, x), values))
        outer = np.array([high - low for field in shown for low, high in field.box])
        inner = np.array([high - low for low, high in self.observer.dynamics.box])
        reach = slope @ np.where(np.isfinite(outer), outer, 0.0)
        known = np.isfinite(inner) & np.isfinite(reach) & (inner > 0)
        return float(np.clip(np.max(reach[known] / inner[known], initial=1.0), 1.0, 1e9))


def far(observer: Observer) -> str:
    """What the law takes for far, in words."""
    off = f"y is off by {SHARE:.0%} of what it can span"
    return off if observer.practical else f"the estimate is out of a range by {MARGIN:.0%} of it, or {off},"
