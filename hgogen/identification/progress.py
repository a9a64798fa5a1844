"""How far a fit is: what a fit that was stopped goes on from."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hgogen.identification.records import BadLog, Log
from hgogen.identification.solution import Solution, Solver
from hgogen.system import System

Array = np.ndarray
_OTHER = {"plant": "another plant", "records": "other records", "options": "other options"}


class CannotGoOn(BadLog):
    """A stopped fit of something else, or what is none."""


@dataclass(frozen=True, eq=False)
class Progress:
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

    def as_dict(self) -> dict[str, Any]:
        """For JSON, of which `progress_of` makes the value again."""
        ended = [{**vars(one), "unknowns": one.unknowns.tolist()} for one in self.ended]
        return {"task": dict(self.task), "ended": ended, "iteration": self.iteration, "at": self.at.tolist()}


def progress_of(table: Mapping[str, Any]) -> Progress:
    """From what `as_dict` gave. Raises: `CannotGoOn`."""
    try:
        ended = tuple(
            Solution(
                np.array(one["unknowns"], dtype=float),
                float("nan") if one["cost"] is None else float(one["cost"]),
                str(one["status"]),
                int(one["iterations"]),
                bool(one["settled"]),
            )
            for one in table["ended"]
        )
        at = np.array(table["at"], dtype=float)
        return Progress({str(k): str(v) for k, v in table["task"].items()}, ended, int(table["iteration"]), at)
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
        others = [what for what, digest in self.task.items() if self.resumed.task.get(what) != digest]
        if others:
            reason = f"is of {' and '.join(map(_OTHER.__getitem__, others))}"
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
