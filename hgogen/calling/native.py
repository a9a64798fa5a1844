"""Compile emitted C with this machine's compiler and call it."""

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import ClassVar, Literal

from hgogen.errors import HgogenError
from hgogen.target import CannotWrite, Sources, demand, write

WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off",),
)


class NoCompilerWarning(UserWarning):
    """There is no C compiler: the record runs in Python, sample by sample: the same bits, some twenty times slower."""


@dataclass(eq=False)
class NoCompiler(HgogenError):
    """C was asked for where there is no compiler."""

    def __str__(self) -> str:
        return (
            "there is no C compiler (looked for $CC, cc, gcc, clang); install one, or say engine='python' for Python's "
            "reading of the step"
        )


@dataclass(eq=False)
class NoTool(HgogenError):
    """A program that a self-check needs and that is not there."""

    name: str

    def __str__(self) -> str:
        return f"there is no {self.name}; install it, or name another by ${variable(self.name)}"


@dataclass(eq=False)
class CompilerFailed(HgogenError):
    """A compiler refused emitted code; `fix`: what can be done about it."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str
    fix: str = "mend it, or name another by $CC, or say engine='python' for Python's reading of the step"

    def __str__(self) -> str:
        return f"the compiler failed: {' '.join(self.command)}\n{self.output.rstrip()}\n{self.fix}"


@dataclass(eq=False)
class CheckFailed(HgogenError):
    """A self-check ended with another status than 0."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str

    def __str__(self) -> str:
        return f"the self-check failed: {' '.join(self.command)}\n{self.output.rstrip()}"


Failed = Callable[[tuple[str, ...], str], HgogenError]  # of a command and its output


def compiler() -> str | None:
    """The path of the C compiler: $CC, else the first of cc, gcc and clang that is installed; None where none is."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


def engine() -> Literal["c", "python"]:
    """What takes samples here: the compiled step where there is a compiler, else Python."""
    return "c" if compiler() else "python"


def library(files: Mapping[str, str], flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """The C files compiled into a shared library and loaded; a library made before from the same text is used again.

    `flags`: of the compiler, after those of every library, -O1 among them: a record of some 100,000 samples is done
    before -O2 has saved what it takes longer to compile.

    Raises: `NoCompiler`, `CompilerFailed`.
    """
    command = compiler()
    if command is None:
        raise NoCompiler()
    digest = hashlib.sha256()
    for text in (
        command,
        sys.platform,
        sysconfig.get_platform(),
        *((_macros(command, flags), *flags) if flags else ()),
        *(part for item in files.items() for part in item),
    ):
        digest.update(text.encode() + b"\0")
    return _load(command, digest.hexdigest()[:32], tuple(files.items()), flags)


def own() -> tuple[str, ...]:
    """The flags by which the compiler writes for the processor of this machine; none where it knows no such flag."""
    command = compiler()
    flags = ("-march=native",)
    return flags if command and _macros(command, flags) else ()


@cache
def _macros(command: str, flags: tuple[str, ...]) -> str:
    """What a compiler says of a machine with these flags, which a shared cache of libraries must tell apart."""
    known = [command, *flags, "-dM", "-E", "-x", "c", os.devnull]
    return subprocess.run(known, capture_output=True, text=True, check=False).stdout


@cache
def _load(command: str, digest: str, files: tuple[tuple[str, str], ...], flags: tuple[str, ...]) -> ctypes.CDLL:
    path = demand([f"{digest}.so"], cache_folder())[0]
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            write(dict(files), folder)
            sources = [name for name, _ in files if name.endswith(".c")]
            built = Path(folder) / "step.so"
            run(
                [
                    command,
                    "-std=c99",
                    "-O1",
                    "-fPIC",
                    "-shared",
                    "-ffp-contract=off",
                    *flags,
                    *sources,
                    "-o",
                    str(built),
                ],
                folder,
            )
            write({path.name: built.read_bytes()}, path.parent)
    return ctypes.CDLL(str(path))


def cache_folder() -> Path:
    """Where compiled libraries are kept: $XDG_CACHE_HOME/hgogen or ~/.cache/hgogen; where that cannot be written, a
    folder of this process alone, since what lies in one that others can write to is not to be loaded."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hgogen"
        write({}, folder)
    except (CannotWrite, RuntimeError):  # or there is no home
        return Path(_own_folder().name)
    return folder if os.access(folder, os.W_OK | os.X_OK) else Path(_own_folder().name)


@cache
def _own_folder() -> tempfile.TemporaryDirectory[str]:
    """The folder of this process for its libraries, which is removed when the process ends."""
    return tempfile.TemporaryDirectory(prefix="hgogen-", ignore_cleanup_errors=True)


def run(command: Sequence[str], folder: str | Path, failed: Failed = CompilerFailed) -> str:
    """Run a command in a folder and return what it prints.

    Raises: what `failed` makes of the command and its output where it does not end with 0.
    """
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise failed(tuple(command), done.stdout + done.stderr)
    return done.stdout


def run_recipe(files: Sources) -> str:
    """Compile and run the self-check of another language than C, and return what it prints: its last command.

    Raises: `NoTool`, `CompilerFailed`, `CheckFailed`.
    """
    *before, last = files.recipe
    with tempfile.TemporaryDirectory() as folder:
        write(files, folder)
        for first, *rest in before:
            failed = partial(CompilerFailed, fix=f"mend it, or name another by ${variable(first)}")
            run([_program(first, folder), *rest], folder, failed)
        return run([_program(last[0], folder), *last[1:]], folder, CheckFailed)


def _program(name: str, folder: str) -> str:
    """The path of a recipe's program: one that was made in the folder, as ./check, or a tool of this machine."""
    return str(Path(folder) / name) if name.startswith("./") else tool(name)


def variable(name: str) -> str:
    """The environment variable that names another program: RUSTC of rustc, CXX of c++."""
    return name.upper().translate({ord("+"): "X"})


def tool(name: str) -> str:
    """The path of a program: what its environment variable names, else what is in the path.

    Raises: `NoTool`.
    """
    there = shutil.which(os.environ.get(variable(name), "") or name)
    if there is None:
        raise NoTool(name)
    return there


def with_main(files: Iterable[str]) -> list[str]:
    """The flags that ask the self-checks among files of C for their main: NAME_check.c has one where NAME_CHECK_MAIN is
    defined."""
    return [f"-D{Path(name).stem.upper()}_MAIN" for name in files if name.endswith("_check.c")]


def run_check(files: Mapping[str, str], flags: Sequence[str] = ("-O2",)) -> str:
    """Compile C files with every warning an error, run the self-check, and return what it prints.

    Raises: `NoCompiler`, `CompilerFailed`, `CheckFailed`.
    """
    command = compiler()
    if command is None:
        raise NoCompiler()
    with tempfile.TemporaryDirectory() as folder:
        write(files, folder)
        sources = [name for name in files if name.endswith(".c")]
        run([command, "-std=c99", *WARNINGS, *with_main(files), *flags, *sources, "-o", "check"], folder)
        return run([str(Path(folder) / "check")], folder, CheckFailed)
