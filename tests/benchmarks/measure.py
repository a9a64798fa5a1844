"""What a step costs in C beside its peers: each first agrees with it, then all are measured in one run, in turn."""

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import programs
from cases import CASES, Case
from in_python import CLOSE, demand_agreement
from peers import PEERS, Missing, source, start
from programs import M4F, X86, Built, CannotBuild, Parts

from hgogen.emit.cost import cost
from hgogen.extras import costs as qemu
from hgogen.extras.costs import BoardFailed, NoBoard

OURS = "hgogen"
SAMPLES, REPEATS = 4000, 15  # of a timing


@dataclass
class Row:
    """A step by one generator: `builds` its programs on this machine by their flags, `costs` what was measured."""

    name: str
    parts: Callable[[str], Parts]
    builds: dict[str, Built] = field(default_factory=dict)
    costs: dict[str, Any] = field(default_factory=dict)


def rows_of(case: Case) -> Iterator[Row]:
    """Ours, with guards and without, and each peer."""
    yield Row(OURS, lambda real: programs.ours(case, real))
    bare = case.unguarded
    yield Row(f"{OURS}, no guards", lambda real: programs.ours(bare, real))
    for peer in PEERS:
        yield Row(peer, lambda real, peer=peer: _peer(case, peer, real))


def _peer(case: Case, name: str, real: str) -> Parts:
    return programs.peer(source(name, case, real), start(case), real)


def measured(name: str, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """The costs of a case by generator, or in a sentence why there are none.

    Raises: `Differs`; `CannotBuild` where the step itself is not.
    """
    begin = time.process_time()
    case = CASES[name]()
    seconds = time.process_time() - begin
    said, rows = {}, []
    for row in rows_of(case):
        tell(f"{name}: {row.name}")
        try:
            _built(case, row, folder / name / row.name)
        except (Missing, CannotBuild) as error:
            if row.name == OURS:
                raise
            said[row.name] = str(error).splitlines()[0]
            continue
        rows.append(row)
        demand_agreement(row.name, _estimates(row), _estimates(rows[0]), CLOSE)
        _counted(case, row, folder / name / row.name)
    rows[0].costs["seconds"]["generate"] = seconds
    tell(f"{name}: nanoseconds")
    _timed(rows)
    operations = {"operations": cost(case.step).operations}
    return {"states": case.n, **operations, "costs": {row.name: row.costs for row in rows}, "missing": said}


def _built(case: Case, row: Row, folder: Path) -> None:
    begin = time.process_time()
    parts = row.parts("double")
    row.costs["seconds"] = {"generate": time.process_time() - begin}
    for flags, words in X86.items():
        row.builds[flags] = programs.built(case, parts, "double", folder / flags, False, words)
        row.costs[flags] = {"text": row.builds[flags].text}
    row.costs["seconds"]["compile"] = row.builds["O2"].seconds


def _estimates(row: Row) -> Any:
    return programs.estimates(row.builds["O2"].path, 1000)


def _counted(case: Case, row: Row, folder: Path) -> None:
    """Instructions, which are the same in each run."""
    if shutil.which("valgrind"):
        for flags, build in row.builds.items():
            row.costs[flags]["instructions"] = programs.instructions(build.path)
    try:
        board = programs.built(case, row.parts("float"), "float", folder / "M4F", True, M4F)
        row.costs["M4F"] = {"text": board.text, **qemu.ran(board.path)}
    except (CannotBuild, NoBoard, BoardFailed) as error:
        row.costs["M4F"] = {"none": str(error).splitlines()[0]}
        return
    if row.name != OURS:  # which guards against nothing
        row.costs["M4F"].pop("worst")


def _timed(rows: Sequence[Row]) -> None:
    """Nanoseconds of a sample: the median and the quartiles of runs that take turns."""
    for flags in X86:
        times: dict[str, list[float]] = {row.name: [] for row in rows}
        for _ in range(REPEATS):
            for row in rows:
                times[row.name] += programs.nanoseconds(row.builds[flags].path, SAMPLES, 1)
        for row in rows:
            each = sorted(times[row.name])
            row.costs[flags]["ns"] = [each[len(each) // 4], each[len(each) // 2], each[3 * len(each) // 4]]
