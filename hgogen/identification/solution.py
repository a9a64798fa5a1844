"""A problem of multiple shooting solved by IPOPT, from one start, with exact derivatives.

Unknowns are in units of their ranges. Beside the residuals stands a pull of each parameter to its start of 1e-3 of its
unit: where a record tells nothing of a direction of parameters, they stay where they were and do not wander to a bound;
where it tells something, 1e-6 of a unit squared is nothing.

A residual e costs e^2/2, or with a corner c the pseudo-Huber loss c^2 (sqrt(1 + (e/c)^2) - 1), which grows like c |e|
beyond c. Source of the loss: Charbonnier, Blanc-Feraud, Aubert, Barlaud, IEEE Trans. Image Processing 6 (1997).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.calling.interrupt import heard
from hgogen.identification.shooting import Shooting

Array = np.ndarray
PULL = 1e-3
ITERATIONS = 200
TOLERANCE = 1e-8
_QUIET = {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS, "tol": TOLERANCE}


@dataclass(frozen=True, eq=False)
class Solution:
    """The `unknowns` with their `cost`, that of the residuals without the pull; how IPOPT ended, and
    after how many `iterations`; `settled`: whether it converged."""

    unknowns: Array
    cost: float
    status: str
    iterations: int
    settled: bool


@dataclass(frozen=True, eq=False)
class Solver:
    """IPOPT on a problem: `low`, `high` (v): bounds of the unknowns, which may be infinite; `unit` (v): their sizes;
    `corner` (p): of each output, in units of its scale, None for squares."""

    problem: Shooting
    low: Array
    high: Array
    unit: Array
    corner: Array | None = None

    def solve(self, start: Array, each: Callable[[int], None] = lambda _: None) -> Solution:
        """From the unknowns `start` (v); `each(k)` after iteration k."""
        begin = np.clip(start, self.low, self.high) / self.unit
        watch = _Watch(len(begin), self._gaps.numel_out(0), each)
        options: Any = {"print_time": False, "ipopt": _QUIET, "iteration_callback": watch, "show_eval_warnings": False}
        solver = ca.nlpsol("fit", "ipopt", self._nlp, options)
        bounds = {"lbx": self.low / self.unit, "ubx": self.high / self.unit, "lbg": 0, "ubg": 0}
        with heard() as watch.interrupts:
            result = solver(x0=begin, p=begin[: self._free], **bounds)
        end = result["x"].full().ravel()
        stats = solver.stats()
        cost = float(self._cost(end * self.unit))
        return Solution(end * self.unit, cost, stats["return_status"], stats["iter_count"], bool(stats["success"]))

    @property
    def _free(self) -> int:
        return len(self.problem.free)

    @cached_property
    def _cost(self) -> Any:
        v, residuals, _ = self.problem.graph
        return ca.Function("cost", [v], [self._loss(residuals)])

    def _loss(self, residuals: Any) -> Any:
        """What the residuals (MX) cost together."""
        if self.corner is None:
            return ca.sumsqr(residuals) / 2
        c = ca.DM(self.corner[self.problem.output])
        return ca.sum1(c**2 * (ca.sqrt(1 + (residuals / c) ** 2) - 1))

    @cached_property
    def _gaps(self) -> Any:
        v, _, gaps = self.problem.graph
        return ca.Function("gaps", [v], [gaps])

    @cached_property
    def _scaled(self) -> tuple[Any, Any, Any, Any]:
        """The unknowns in their units, the start of the parameters, what is minimised, and the gaps."""
        v, residuals, gaps = self.problem.graph
        w, p = ca.MX.sym("w", self.problem.size), ca.MX.sym("p", self._free)
        errors, jumps = ca.Function("problem", [v], [residuals, gaps])(w * self.unit)
        return w, p, self._loss(errors) + ca.sumsqr(PULL * (w[: self._free] - p)) / 2, jumps

    @cached_property
    def _nlp(self) -> dict[str, Any]:
        w, p, cost, gaps = self._scaled
        return {"x": w, "p": p, "f": cost, "g": gaps}


class _Watch(ca.Callback):
    """What CasADi calls after each iteration."""

    def __init__(self, unknowns: int, gaps: int, each: Callable[[int], None]) -> None:
        super().__init__()
        self.sizes = {"x": unknowns, "f": 1, "g": gaps, "lam_x": unknowns, "lam_g": gaps, "lam_p": 0}
        self.each, self.count, self.interrupts = each, 0, list[Any]()
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """As many as a solver gives back."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """A status."""
        return 1

    def get_name_in(self, i: int) -> str:
        """That of what a solver gives back."""
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> Any:
        """Columns, none where it is not asked for."""
        return ca.Sparsity.dense(self.sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, _: Any) -> list[int]:
        """Tell it, and go on unless there was a Ctrl-C."""
        self.each(self.count)
        self.count += 1
        return [len(self.interrupts)]
