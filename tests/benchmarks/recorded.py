"""Instructions and bytes of six steps, which are the same in each run of the same compilers, against a committed table.

`costs.json` holds them by the versions of the compilers. What costs more by `MORE` is found; what costs less by as much
is to be recorded: `python tests/benchmarks --record`.
"""

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import programs
from cases import CASES
from programs import M4F, X86

from hgogen.extras import costs as qemu

TABLE = Path(__file__).with_name("costs.json")
SIX = ("adaptive", "default", "rk4_covariance", "two_outputs", "dense6", "chain10")
MORE = 0.03
Costs = dict[str, int]


def compilers() -> dict[str, str]:
    """The tools that decide, by their versions; empty for one that is missing."""
    tools = ("gcc", "arm-none-eabi-gcc", "valgrind", "qemu-system-arm")
    return {
        tool: programs.said([tool, "--version"], Path()).splitlines()[0] if shutil.which(tool) else "" for tool in tools
    }


def key() -> str:
    """The versions on which the costs depend."""
    known = compilers()
    return f"{known['gcc']}; {known['arm-none-eabi-gcc']}"


def costs(name: str, folder: Path) -> Costs:
    """Of a step: instructions on this machine at -O2 in double, and on the board in float with bytes."""
    case = CASES[name]()
    here = programs.built(case, programs.ours(case, "double"), "double", folder / "O2", False, X86["O2"])
    board = programs.built(case, programs.ours(case, "float"), "float", folder / "M4F", True, M4F)
    return {"x86": programs.instructions(here.path), "text": board.text, **qemu.ran(board.path)}


def committed() -> Mapping[str, Mapping[str, Costs]]:
    """The table: by compilers and step."""
    table: Mapping[str, Mapping[str, Costs]] = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    return table


def record(folder: Path) -> None:
    """Write the costs of today beside those by other compilers."""
    today = {name: costs(name, folder / name) for name in SIX}
    TABLE.write_text(json.dumps({**committed(), key(): today}, indent=1) + "\n")


def changes(known: Mapping[str, int], today: Mapping[str, int]) -> Iterator[str]:
    """A sentence for each cost that is another one by more than `MORE`."""
    for what, before in known.items():
        now = today[what]
        if now > before * (1 + MORE):
            yield f"{what}: {now}, {now / before - 1:.1%} more than the {before} that are recorded"
        elif now < before * (1 - MORE):
            fix = "record it by python tests/benchmarks --record"
            yield f"{what}: {now}, less than the {before} that are recorded; {fix}"
