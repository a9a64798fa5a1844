"""What steps cost beside CasADi, SymForce, SymPy and Eigen in C, and beside other filters in Python.

    python tests/benchmarks [--cases default,chain10] [-o build/benchmarks]
    python tests/benchmarks --record        # the costs that the slow tests compare

It writes benchmarks.json and benchmarks.svg. Peers are ordinary packages (symforce and clang-format, filterpy, do-mpc,
libeigen3-dev); one that is missing is named and left out. Instructions want valgrind, the board QEMU and
gcc-arm-none-eabi.
"""

import argparse
import json
import platform
import sys
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[1]))  # what the tests share

import figure
import in_python
import measure
import recorded
from cases import CASES
from programs import CannotBuild

IN_PYTHON = ("default", "rk4_covariance")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(CASES), help="of " + ", ".join(CASES))
    parser.add_argument("-o", "--out", type=Path, default=Path("build/benchmarks"))
    parser.add_argument("--record", action="store_true", help="only write what the slow tests compare")
    asked = parser.parse_args()
    folder = asked.out.resolve()
    if asked.record:
        recorded.record(folder)
        print(f"{recorded.TABLE} holds the costs by {recorded.key()}")
        return
    names = asked.cases.split(",")
    if unknown := [name for name in names if name not in CASES]:
        parser.error(f"--cases {unknown[0]}: there is no such case; there are {', '.join(CASES)}")
    tell = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    try:
        cases = {name: measure.measured(name, folder, tell) for name in names}
    except CannotBuild as error:
        parser.error(str(error))
    python = {name: dict(in_python.microseconds(CASES[name](), 5)) for name in names if name in IN_PYTHON}
    machine = {"machine": platform.processor() or platform.machine(), **recorded.compilers()}
    report = {"on": machine, "cases": cases, "python_us": python}
    (folder / "benchmarks.json").write_text(json.dumps(report, indent=1) + "\n")
    if any(figure.ratios(cases, path) for _, path in figure.PANELS):
        figure.drawn(cases).savefig(folder / "benchmarks.svg")
    for name, case in cases.items():
        print(table(name, case))
    for name, rivals in python.items():
        for who, times in rivals.items():
            print(f"{name:16} {who:18} " + (times if isinstance(times, str) else f"{min(times):9.3g} us a sample"))
    print(f"{folder} holds benchmarks.json, and benchmarks.svg where there is a peer")


COLUMNS = {
    "x86 -O2": ("O2", "instructions"),
    "-O3": ("O3", "instructions"),
    "ns": ("O3", "ns"),
    "M4F": ("M4F", "nominal"),
    "worst": ("M4F", "worst"),
    "text": ("M4F", "text"),
    "stack": ("M4F", "stack"),
    "RAM": ("M4F", "ram"),
    "made, s": ("seconds", "generate"),
    "gcc, s": ("seconds", "compile"),
}


def table(name: str, case: dict[str, Any]) -> str:
    """A line for each generator."""
    lines = [f"{name}, n = {case['states']}".ljust(22) + "".join(head.rjust(9) for head in COLUMNS)]
    for who, costs in case["costs"].items():
        values = [figure.number(costs, path) for path in COLUMNS.values()]
        lines.append(f"  {who}".ljust(22) + "".join(map(_short, values)))
    return "\n".join([*lines, *(f"  {who}: {why}" for who, why in case["missing"].items()), ""])


def _short(value: float | None) -> str:
    return ("-" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.3g}").rjust(9)


if __name__ == "__main__":
    main()
