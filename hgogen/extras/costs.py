"""The cost of a step's C on a Cortex-M4F: a program that steps over a log, compiled and run in QEMU."""

import hashlib
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Annotated, Any, ClassVar

import numpy as np

from hgogen.emit.code import indented
from hgogen.emit.interface import Parameter, address, assigned, prototypes, structs
from hgogen.emit.naming import c_name
from hgogen.emit.syntax import Real
from hgogen.errors import HgogenError
from hgogen.step import Step
from hgogen.target import write

NAME = "Cortex-M4F"
COMPILER, SIZE, EMULATOR = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"
M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
FLAGS = ("-O2", *M4F, "-ffp-contract=off")
_QEMU = ("-nographic", "-icount", "shift=0", "-semihosting-config", "enable=on,target=native")
_SECONDS = 900  # time limit of a tool


@dataclass(eq=False)
class NoBoard(HgogenError):
    """The error for a missing tool of the board: the cross compiler, or the emulator QEMU."""

    text = (
        "there is no {name}, without which nothing is measured; install gcc-arm-none-eabi, libnewlib-arm-none-eabi and "
        "qemu-system-arm"
    )
    name: str


@dataclass(eq=False)
class BoardFailed(HgogenError):
    """The error for a failed tool of the board: the cross compiler, or the emulator QEMU."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str

    def __str__(self) -> str:
        return f"{' '.join(self.command)} failed\n{self.output.rstrip()}"


def demand_board() -> None:
    """Raise `NoBoard` if the cross compiler or the emulator QEMU is missing."""
    for name in (COMPILER, SIZE, EMULATOR):
        if shutil.which(name) is None:
            raise NoBoard(name)


def version(name: str) -> str:
    """Return the first line that a tool prints about its version. Raises: `NoBoard`, `BoardFailed`."""
    return _output([name, "--version"], Path()).splitlines()[0]


def compiled(source: str, folder: Path, flags: Sequence[str]) -> int:
    """Return the bytes of code and constants of a C file, after compiling it to an object in the folder.

    Raises: `NoBoard`, `BoardFailed`.
    """
    _output([COMPILER, "-std=c99", *flags, "-c", source], folder)
    return bytes_of([str(Path(source).with_suffix(".o"))], folder)


def bytes_of(objects: Sequence[str], folder: Path) -> int:
    """Return the bytes of code and constants of the first of the object files. Raises: `NoBoard`, `BoardFailed`."""
    return int(_output([SIZE, *objects], folder).splitlines()[1].split()[0])


def linked(main: str, objects: Sequence[str], harness: Mapping[str, str], folder: Path, flags: Sequence[str]) -> Path:
    """Return the path of the program linked from the C text `main`, object files and the board's files `harness` (text
    by name).

    Raises: `NoBoard`, `BoardFailed`.
    """
    write({**harness, "main.c": main}, folder)
    board_options = ["-nostartfiles", "-T", "mps2.ld", "mps2.c", "main.c"]
    _output([COMPILER, "-std=gnu99", *flags, "-w", *board_options, *objects, "-o", "program", "-lm"], folder)
    return folder / "program"


def ran(program: Path, machine: str = "mps2-an386") -> dict[str, int]:
    """Return the numbers, by name, that a program prints when it runs in the emulator of a machine. Raises: `NoBoard`,
    `BoardFailed`."""
    text = _output([EMULATOR, "-M", machine, *_QEMU, "-kernel", str(program)], program.parent)
    return {key: int(value) for key, value in re.findall(r"(\w+) (\d+)", text)}


def _output(command: Sequence[str], folder: Path) -> str:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_SECONDS, check=False)
    except FileNotFoundError:
        raise NoBoard(command[0]) from None
    except subprocess.TimeoutExpired:
        raise BoardFailed(tuple(command), f"it took more than {_SECONDS} s") from None
    if done.returncode:
        raise BoardFailed(tuple(command), done.stdout + done.stderr)
    return done.stdout + done.stderr


ROWS = 600  # rows of the log in the board's flash: half nominal, half hostile
COPIES = 40  # copies of the state, so that a tick of 40 instructions resolves one instruction
_WORST = (np.nan, np.inf, -np.inf, 1e30, -1e12, 1e-40, 50.0, -3.0)


@cache
def text(name: str) -> str:
    """Return the text of the board's C file `name`."""
    return files("hgogen.extras").joinpath(name).read_text(encoding="ascii")


def harness() -> dict[str, str]:
    """Return the C files and the linker script of the emulated board, by name."""
    return {name: text(name) for name in ("mps2.c", "mps2.h", "mps2.ld")}


def with_faults(rows: np.ndarray) -> np.ndarray:
    """Return the rows (N, columns) of a log with faults of sensors and buses in 3 of 10 numbers: NaN, infinite, huge
    and tiny values, jumps."""
    draw, rows = np.random.default_rng(8), rows.copy()
    for column in rows.T:
        hit = draw.random(len(column)) < 0.3
        column[hit] = draw.choice(_WORST, size=int(hit.sum()))
    return rows


def head(rows: np.ndarray, real: Real, states: int, nominal_rows: int) -> str:
    """Return the C text of the log `rows` (N, columns) and its sizes; `states`: the number of estimated states,
    `nominal_rows`: how many of the rows have no faults."""
    lines = ",\n".join("    {" + ", ".join(literal(v, real) for v in row) + "}" for row in rows.tolist())
    sizes = {"N": states, "COLUMNS": rows.shape[1], "RECORD": len(rows), "QUIET": nominal_rows}
    defined = f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};\n"  # no member is one
    includes = "#include <math.h>\n#include <stddef.h>\n"
    return f"{includes}{defined}typedef {real} real;\nstatic const real record[RECORD][COLUMNS] = {{\n{lines}\n}};\n"


def literal(value: float, real: Real) -> str:
    """Return a number, which may be infinite or NaN, as text in C."""
    if not np.isfinite(value):
        return "NAN" if np.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"
    return f"{value!r}f" if real == "float" else repr(value)


def driver(step: Step) -> str:
    """Return the C text that defines how the board's program calls a step: `memory`, BEGIN, `sample` and `estimate`."""
    declared, inner = prototypes(step), [each for each in structs(step) if each.name in ("in", "measurement")]
    filled = [f"{struct}.{c_name(s.name)} = row[{column}];" for column, (struct, s) in enumerate(assigned(step))]
    states = [f"values[{i}] = x.{c_name(s.name)};" for i, s in enumerate(step.states)]
    return Template(text("step.c")).substitute(
        name=step.name,
        locals="\n".join(indented(each.local for each in inner)),
        given="\n".join(indented(filled)),
        init=declared["init"].call(_argument).replace("m->", "(m)->"),
        step=declared["step"].call(_argument),
        estimate=declared["estimate"].call(_argument),
        states="\n".join(indented(states)),
    )


def counting_program(called: str) -> str:
    """Return the board's main C file, which counts instructions of the calls that the text `called` defines, such as
    that of `driver`."""
    return f"{called}\nenum {{ COPIES = {COPIES} }};\n{text('count.c')}"


def _argument(parameter: Parameter) -> str:
    return f"&m->{parameter.name}" if parameter.name in ("s", "p") else address(parameter)


@dataclass(frozen=True)
class Costs:
    """The measured costs of a step: executed instructions of a nominal and of the worst call, bytes of flash, RAM and
    stack; and the tools that measured them."""

    nominal_instructions: Annotated[int, "instructions of a step, the mean of nominal samples"]
    worst_instructions: Annotated[int, "instructions of a step, the worst of a hostile record"]
    flash_bytes: Annotated[int, "bytes of flash: code and constants"]
    ram_bytes: Annotated[int, "bytes of state and parameters"]
    stack_bytes: Annotated[int, "bytes of stack, the deepest of all samples and of spoiled memory"]
    real: Annotated[Real, "working precision"]
    machine: Annotated[str, "the processor"]
    compiler: Annotated[str, "version of the compiler"]
    flags: Annotated[str, "options of the compiler"]
    emulator: Annotated[str, "version of the emulator"]
    source: Annotated[str, "digest of the C, by which it is known whether the costs are of it"]


def measured(step: Step, files: Mapping[str, str], rows: np.ndarray, real: Real) -> Costs:
    """Return the costs of a step's C in an emulated board, `files` of the target c99, over the rows (N, m + p) of its
    inputs and outputs; the rows are repeated cyclically. A log with faults is derived from them.

    Raises: `NoBoard`, `BoardFailed`.
    """
    demand_board()
    nominal = rows[np.arange(ROWS // 2) % len(rows)]
    record = np.concatenate([nominal, with_faults(nominal)])
    sources = {name: files[name] for name in (f"{step.name}.h", f"{step.name}.c")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(sources, folder)
        flash = compiled(f"{step.name}.c", folder, FLAGS)
        main = head(record, real, len(step.states), len(nominal)) + counting_program(driver(step))
        numbers = ran(linked(main, [f"{step.name}.o"], harness(), folder, FLAGS))
    return Costs(
        nominal_instructions=numbers["nominal"],
        worst_instructions=numbers["worst"],
        flash_bytes=flash,
        ram_bytes=numbers["ram"],
        stack_bytes=numbers["stack"],
        real=real,
        machine=NAME,
        compiler=version(COMPILER),
        flags=" ".join(FLAGS),
        emulator=version(EMULATOR),
        source=digest(files[f"{step.name}.c"]),
    )


_UNKNOWN = (
    "`hgogen cost` measures instructions, flash, RAM and stack on a Cortex-M4F, and writes them to `cost.json` here;\n"
    "generated again, this page tells them."
)
MEANINGS = {  # of the numbers of `Costs`
    "nominal_instructions": "instructions of a step, nominal",
    "worst_instructions": "instructions of a step, the worst of a hostile record",
    "flash_bytes": "bytes of flash",
    "ram_bytes": "bytes of RAM, of state and parameters",
    "stack_bytes": "bytes of stack, the deepest of a hostile record and of spoiled memory",
}


def digest(source: str) -> str:
    """Return the digest of a C source, by which measured costs are recognised as those of this source."""
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def cost_table(costs: Mapping[str, Any] | None, source: str) -> str:
    """Return the measured costs as a Markdown table, or advice on how to measure them if they are unknown, incomplete
    (as those of another version may be) or of another source."""
    needed = {"machine", "compiler", "flags", *MEANINGS}
    if costs is None or costs.get("source") != digest(source) or not needed <= costs.keys():
        return _UNKNOWN
    title = f"On a {costs['machine']}, compiled by {costs['compiler']} with `{costs['flags']}`:"
    rows = (f"| {what} | {costs[key]} |" for key, what in MEANINGS.items())
    return "\n".join((title, "", "| what | how much |", "|---|---|", *rows))
