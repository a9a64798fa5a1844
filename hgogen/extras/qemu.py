"""A program compiled for a Cortex-M4F and run in QEMU."""

import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from hgogen.errors import HgogenError
from hgogen.target import write

NAME = "Cortex-M4F"
COMPILER, SIZE, EMULATOR = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"
M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
_QEMU = ("-nographic", "-icount", "shift=0", "-semihosting-config", "enable=on,target=native")
_SECONDS = 900  # that a tool may take


@dataclass(eq=False)
class NoBoard(HgogenError):
    """A tool of the board that is not there."""

    name: str

    def __str__(self) -> str:
        return (
            f"there is no {self.name}, without which nothing is measured; install gcc-arm-none-eabi, "
            "libnewlib-arm-none-eabi and qemu-system-arm"
        )


@dataclass(eq=False)
class BoardFailed(HgogenError):
    """A tool of the board that fails."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str

    def __str__(self) -> str:
        return f"{' '.join(self.command)} failed\n{self.output.rstrip()}"


def demand_board() -> None:
    """Raises: `NoBoard` where a tool is missing."""
    for name in (COMPILER, SIZE, EMULATOR):
        if shutil.which(name) is None:
            raise NoBoard(name)


def version(name: str) -> str:
    """The first line of what a tool says of itself. Raises: `NoBoard`, `BoardFailed`."""
    return _said([name, "--version"], Path()).splitlines()[0]


def compiled(source: str, folder: Path, flags: Sequence[str]) -> int:
    """Compile a file of C in the folder to an object, and return the bytes of its code and constants.

    Raises: `NoBoard`, `BoardFailed`.
    """
    _said([COMPILER, "-std=c99", *flags, "-c", source], folder)
    return bytes_of([str(Path(source).with_suffix(".o"))], folder)


def bytes_of(objects: Sequence[str], folder: Path) -> int:
    """The bytes of code and constants of the first object. Raises: `NoBoard`, `BoardFailed`."""
    return int(_said([SIZE, *objects], folder).splitlines()[1].split()[0])


def linked(main: str, objects: Sequence[str], harness: Mapping[str, str], folder: Path, flags: Sequence[str]) -> Path:
    """The program of a main, of objects that are there and of the board's own files.

    Raises: `NoBoard`, `BoardFailed`.
    """
    write({**harness, "main.c": main}, folder)
    own = ["-nostartfiles", "-T", "mps2.ld", "mps2.c", "main.c"]
    _said([COMPILER, "-std=gnu99", *flags, "-w", *own, *objects, "-o", "program", "-lm"], folder)
    return folder / "program"


def ran(program: Path, machine: str = "mps2-an386") -> dict[str, int]:
    """The numbers that a program says, by name. Raises: `NoBoard`, `BoardFailed`."""
    text = _said([EMULATOR, "-M", machine, *_QEMU, "-kernel", str(program)], program.parent)
    return {key: int(value) for key, value in re.findall(r"(\w+) (\d+)", text)}


def _said(command: Sequence[str], folder: Path) -> str:
    """What a command prints."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_SECONDS, check=False)
    except FileNotFoundError:
        raise NoBoard(command[0]) from None
    except subprocess.TimeoutExpired:
        raise BoardFailed(tuple(command), f"it took more than {_SECONDS} s") from None
    if done.returncode:
        raise BoardFailed(tuple(command), done.stdout + done.stderr)
    return done.stdout + done.stderr
