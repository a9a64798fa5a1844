"""A problem solved by IPOPT, with exact derivatives, from one start after the other; what a stopped fit goes on from.

Unknowns are in units of their ranges. Beside what is minimised stands a pull of each parameter and offset to its
start of 1e-3 of its unit: where a record tells nothing of a direction of them, they stay where they were and do not
wander to a bound; where it tells something, 1e-6 of a unit squared is nothing.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.logs.problem import Problem
from hgogen.logs.records import BadLog, Log
from hgogen.sentence import Encoded
from hgogen.system import System
from hgogen.trial import heard

Array = np.ndarray
PULL = 1e-3
ITERATIONS = 200
TOLERANCE = 1e-8
_QUIET = {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS, "tol": TOLERANCE}
_THERE = {"bound_push": 1e-8, "bound_frac": 1e-8}  # to begin where an iterate was, close to a bound too
_OTHER = {"plant": "another plant", "records": "other records", "options": "other options"}


@dataclass(frozen=True, eq=False)
class Solution:
    """The `unknowns` with their `cost`, without the pull; how IPOPT ended, and after how many `iterations`; `settled`:
    whether it converged."""

    unknowns: Array
    cost: float
    status: str
    iterations: int
    settled: bool


@dataclass(frozen=True, eq=False)
class Solver:
    """IPOPT on a problem: `low`, `high` (v): bounds of the unknowns, which may be infinite; `unit` (v): their sizes."""

    problem: Problem
    low: Array
    high: Array
    unit: Array

    def solve(
        self, start: Array, at: Array | None = None, each: Callable[[int, Array], None] = lambda k, last: None
    ) -> Solution:
        """From the unknowns `start` (v), to which parameters and offsets are pulled, or going on `at` others;
        `each(k, last)` after iteration k, with its unknowns."""
        begin, first = (np.clip(v, self.low, self.high) / self.unit for v in (start, start if at is None else at))
        watch, solver = self._watched if at is None else self._made(_QUIET | _THERE)
        watch.begin(lambda k, w: each(k, w * self.unit))
        bounds = {"lbx": self.low / self.unit, "ubx": self.high / self.unit, "lbg": 0, "ubg": 0}
        with heard() as watch.interrupts:
            result = solver(x0=first, p=begin[: self._pulled], **bounds)
        if watch.raised:
            raise watch.raised[0]
        end = result["x"].full().ravel() * self.unit
        cost, stats = float(self._cost(end)), solver.stats()
        return Solution(end, cost, stats["return_status"], stats["iter_count"], bool(stats["success"]))

    @property
    def _pulled(self) -> int:
        return self.problem.constants

    @cached_property
    def _watched(self) -> tuple["_Watch", Any]:
        """That of searches from a start, which share it: derivatives take as long to make as some searches do."""
        return self._made(_QUIET)

    def _made(self, ipopt: dict[str, Any]) -> tuple["_Watch", Any]:
        """What IPOPT, with these options, calls after each iteration, and IPOPT."""
        watch = _Watch(self.problem.size, self._nlp["g"].numel())
        options: Any = {"print_time": False, "ipopt": ipopt, "iteration_callback": watch, "show_eval_warnings": False}
        return watch, ca.nlpsol("fit", "ipopt", self._nlp, options)

    @cached_property
    def _cost(self) -> Any:
        v, cost, _ = self.problem.graph
        return ca.Function("cost", [v], [cost])

    @cached_property
    def _nlp(self) -> dict[str, Any]:
        """Of the unknowns in their units, and the start of those that are pulled."""
        v, cost, gaps = self.problem.graph
        w, p = ca.MX.sym("w", self.problem.size), ca.MX.sym("p", self._pulled)
        least, jumps = ca.Function("problem", [v], [cost, gaps])(w * self.unit)
        return {"x": w, "p": p, "f": least + ca.sumsqr(PULL * (w[: self._pulled] - p)) / 2, "g": jumps}


class _Watch(ca.Callback):
    """What CasADi calls after each iteration."""

    def __init__(self, unknowns: int, gaps: int) -> None:
        super().__init__()
        self.sizes = {"x": unknowns, "f": 1, "g": gaps, "lam_x": unknowns, "lam_g": gaps, "lam_p": 0}
        self.construct("watch", {})

    def begin(self, each: Callable[[int, Array], None]) -> None:
        """A search, of whose iterations `each` is told."""
        self.each, self.count, self.interrupts, self.raised = each, 0, list[Any](), list[Exception]()

    def get_n_in(self) -> int:
        """As many as a solver gives back."""
        return int(ca.nlpsol_n_out())

    def get_sparsity_in(self, i: int) -> Any:
        """Columns, none where it is not asked for."""
        return ca.Sparsity.dense(self.sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, entries: Any) -> list[int]:
        """Tell it, and go on unless there was a Ctrl-C, or an error, which CasADi would take for one of its own."""
        try:
            self.each(self.count, entries[ca.nlpsol_out().index("x")].full().ravel())
        except Exception as error:
            self.raised.append(error)
        self.count += 1
        return [len(self.interrupts) + len(self.raised)]


class CannotGoOn(BadLog):
    """A stopped fit of something else, or what is none."""


@dataclass(frozen=True, eq=False)
class Progress(Encoded):
    """Of a fit whose `task` is told by these digests: the searches that have `ended`, and of the one that runs the
    `iteration` and its unknowns (v), `at`."""

    task: Mapping[str, str]
    ended: tuple[Solution, ...]
    iteration: int
    at: Array

    @property
    def start(self) -> int:
        """The number of the search that runs, from 0: those of the starts, then, of a robust fit, its passes."""
        return len(self.ended)


def progress_of(table: Mapping[str, Any]) -> Progress:
    """The progress that `as_dict` gave. Raises: `CannotGoOn`."""
    try:
        ended = []
        for one in table["ended"]:
            cost = float("nan") if one["cost"] is None else float(one["cost"])
            how = (str(one["status"]), int(one["iterations"]), bool(one["settled"]))
            ended.append(Solution(np.array(one["unknowns"], dtype=float), cost, *how))
        task = {str(what): str(digest) for what, digest in table["task"].items()}
        return Progress(task, tuple(ended), int(table["iteration"]), np.array(table["at"], dtype=float))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise CannotGoOn("the stopped fit", "is not as a fit leaves it; fit anew") from None


def digests(plant: System, records: Iterable[Log], options: Mapping[str, Any]) -> dict[str, str]:
    """Of what is fitted to what."""
    signals = [(s.name, s.nominal, s.interval) for s in plant.signals]
    arrays = [part for record in records for part in (record.u.tobytes(), record.y.tobytes(), repr(record.dt))]
    return {
        "plant": _digest(signals, plant.flow, plant.output, plant.time),
        "records": _digest(*arrays),
        "options": _digest(*sorted(options.items())),
    }


def _digest(*parts: Any) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part if isinstance(part, bytes) else f"{part}\n".encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Searches:
    """The searches of a fit one after the other, some of which `resumed` may have done; `each` is called after every
    iteration."""

    task: Mapping[str, str]
    each: Callable[[Progress], None]
    resumed: Progress | None

    def __post_init__(self) -> None:
        """Raises: `CannotGoOn`."""
        if self.resumed is None:
            return
        if others := [_OTHER[what] for what, digest in self.task.items() if self.resumed.task.get(what) != digest]:
            reason = f"is of {' and '.join(others)}"
            raise CannotGoOn("the stopped fit", f"{reason}; give it what it was begun with, or fit anew")

    def solved(self, solver: Solver, begin: Array, ended: tuple[Solution, ...]) -> tuple[Solution, ...]:
        """Those that ended, and one more, from the unknowns `begin`."""
        resumed = self.resumed
        if resumed is not None and len(ended) < resumed.start:
            return (*ended, resumed.ended[len(ended)])
        here = resumed is not None and len(ended) == resumed.start
        at = resumed.at if resumed is not None and here else None
        if at is not None and len(at) != len(begin):
            raise CannotGoOn("the stopped fit", "has another number of unknowns; fit anew")
        return (*ended, solver.solve(begin, at, lambda k, last: self.each(Progress(self.task, ended, k, last))))
