"""The command `doctor`: which compilers, emulators and libraries this machine has, what each is for, and how to get it.

Nothing of the package needs them but what their rows say; the libraries that it always needs are installed with it.
"""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from typing import Annotated, Any, NamedTuple

from rich.text import Text

from hgogen.commands.command import Report, command
from hgogen.commands.output import headed
from hgogen.extras import live as wasm
from hgogen.extras.costs import COMPILER, EMULATOR
from hgogen.run.native import compiler
from hgogen.sentence import Encoded

_SECONDS = 10  # until a program has told its version


class Wanted(NamedTuple):
    """A program or library that hgogen may use; `find` returns its version and place, None if it is not installed."""

    name: str
    use: str
    install: str
    find: Callable[[str], tuple[str, str] | None]


def _program(name: str, path: str | None = None) -> tuple[str, str] | None:
    path = path or shutil.which(name)
    if path is None:
        return None
    try:
        done = subprocess.run([path, "--version"], capture_output=True, text=True, timeout=_SECONDS, check=False)
        first = (done.stdout or done.stderr).partition("\n")[0].strip()
    except (OSError, subprocess.TimeoutExpired):
        first = ""
    return first or "does not tell its version", path


def _c_compiler(name: str) -> tuple[str, str] | None:
    path = compiler()
    return _program(name, path) if path else None


def _library(name: str) -> tuple[str, str] | None:
    try:
        package = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return None
    return package.version, str(package.locate_file(""))


def _wasm_compiler(name: str) -> tuple[str, str] | None:
    command = wasm.compiler()
    return _program(name, command[0]) if command else None


_BOARD = "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
WANTED = (
    Wanted("C compiler", "runs at the speed of C, and the self-check of emitted C", "apt install gcc", _c_compiler),
    Wanted("rustc", "the self-check of emitted Rust", "apt install rustc", _program),
    Wanted(COMPILER, "hgogen cost: bytes of flash and RAM on a Cortex-M4F", _BOARD, _program),
    Wanted(EMULATOR, "hgogen cost: instructions of a call on a Cortex-M4F", _BOARD, _program),
    Wanted("wasm-ld", "the observer live in hgogen report", wasm.INSTALL, _wasm_compiler),
    Wanted("clarabel", "proofs of a step, of noise and of starts by a solver", 'pip install "hgogen[lmi]"', _library),
    Wanted("pandas", "DataFrames, Parquet and spreadsheets as logs", 'pip install "hgogen[logs]"', _library),
    Wanted("pyarrow", "Parquet files as logs", 'pip install "hgogen[logs]"', _library),
    Wanted("scipy", "MAT files as logs", 'pip install "hgogen[logs]"', _library),
    Wanted("pint", "units in the names of columns", 'pip install "hgogen[units]"', _library),
    Wanted("distributed", "campaigns on several computers", 'pip install "hgogen[cluster]"', _library),
)


@dataclass(frozen=True)
class Found(Encoded):
    """A program or library, with its version and place on this machine if it is installed."""

    name: Annotated[str, "its name"]
    version: Annotated[str | None, "its version, null where it is missing"]
    place: Annotated[str | None, "where it is, null where it is missing"]
    use: Annotated[str, "what it is for"]
    install: Annotated[str, "how to install it"]


@dataclass(frozen=True)
class Machine(Report):
    """The programs and libraries of this machine that hgogen may use."""

    tools: Annotated[tuple[Found, ...], "each program and library"]

    def tables(self) -> Iterator[Any]:
        """Yield a row for each program and library."""
        table = headed("what this machine has", "", "version, or how to install it", "what it is for")
        for one in self.tools:
            known = Text(one.version) if one.version else Text(f"missing: {one.install}", style="yellow")
            table.add_row(one.name, known, Text(one.use))
        yield table


@command(Machine)
def doctor_() -> Machine:
    """Print which compilers, emulators and optional libraries this machine has, their versions, what each is for, and
    how to install those that are missing. Nothing is changed."""
    rows = []
    for name, use, install, find in WANTED:
        version, place = find(name) or (None, None)
        rows.append(Found(name, version, place, use, install))
    return Machine(tuple(rows))
