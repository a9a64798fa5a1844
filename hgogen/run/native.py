"""Emitted C compiled by this machine's compiler, and the folder of compiled libraries.

Loading a library runs the code in it, so only this user may be able to write it. The folder belongs to this user and is
closed to others. It is reached through an open descriptor where the system has such paths, so that renaming a folder
above it cannot replace the verified folder. Each library has a file with a digest of its name and content: one that is
truncated, or was built for another model, is built again.
"""

# Takes apart: $CC, a command with its arguments.

import ctypes
import hashlib
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import ClassVar, Literal

from hgogen.errors import HgogenError
from hgogen.target import CannotWrite, Sources, remove, write

SOON = 30.0  # seconds for a compiler to read an empty file on a busy machine
LIMIT = 1800.0  # seconds for any other command
WARNINGS = (
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off",),
)


class NoCompilerWarning(UserWarning):
    """The step runs in Python, since there is no C compiler: the same bits, some twenty times slower."""


@dataclass(eq=False)
class NoCompiler(HgogenError):
    """The error for a step that is to run in C where there is no compiler."""

    text = (
        "there is no C compiler (looked for $CC, cc, gcc, clang); install one, or say engine='python' for Python's "
        "reading of the step"
    )


@dataclass(eq=False)
class NoTool(HgogenError):
    """The error for a program that a self-check needs and that is not installed."""

    name: str

    def __str__(self) -> str:
        return f"there is no {self.name}; install it, or name another by ${variable(self.name)}"


@dataclass(eq=False)
class CompilerFailed(HgogenError):
    """The error for a compiler that fails on emitted code; `fix`: the remedy."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str
    fix: str = "mend it, or name another by $CC, or say engine='python' for Python's reading of the step"

    def __str__(self) -> str:
        return f"the compiler failed: {' '.join(self.command)}\n{self.output.rstrip()}\n{self.fix}"


@dataclass(eq=False)
class CheckFailed(HgogenError):
    """The error for a self-check that ends with another exit status than 0."""

    status: ClassVar[int] = 1
    command: tuple[str, ...]
    output: str

    def __str__(self) -> str:
        return f"the self-check failed: {' '.join(self.command)}\n{self.output.rstrip()}"


Failed = Callable[[tuple[str, ...], str], HgogenError]  # of a command and its output


def compiler() -> str | None:
    """Return the path of the C compiler; None where there is none."""
    command = _compiler()
    return command[0] if command else None


def _compiler() -> tuple[str, ...] | None:
    """Return the C compiler as a command: $CC, which may hold arguments, as in
    "ccache gcc", else the first of cc, gcc and clang that is installed."""
    named, commands = os.environ.get("CC", ""), [["cc"], ["gcc"], ["clang"]]
    if named.strip():
        with suppress(ValueError):  # a quotation mark that is not closed
            commands.insert(0, shlex.split(named))
        commands.insert(0, [named])  # one path, which may hold blanks
    for words in commands:
        path = shutil.which(words[0])
        if path:
            return path, *words[1:]
    return None


def engine() -> Literal["c", "python"]:
    """Return the default engine of this machine: C if there is a compiler, else Python."""
    return "c" if compiler() else "python"


def library(files: Mapping[str, str], flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """Return the shared library of C files (text by name), compiled and loaded; a library that was compiled from the
    same text is used again.

    `flags`: further flags of the compiler, after those of every library. The default is -O1: up to some 100,000 samples
    -O2 takes more time to compile than it saves.

    Raises: `NoCompiler`, `CompilerFailed`.
    """
    command = _demanded()
    digest = hashlib.sha256()
    for text in (
        *command,
        sys.platform,
        sysconfig.get_platform(),
        *((_macros(command, flags), *flags) if flags else ()),
        *(part for item in files.items() for part in item),
    ):
        digest.update(text.encode(errors="surrogateescape") + b"\0")
    return _load(command, digest.hexdigest()[:32], tuple(files.items()), flags)


def machine_flags() -> tuple[str, ...]:
    """Return the compiler's flags that generate code for this machine's processor; none where the compiler has no such
    flags."""
    command = _compiler()
    flags = ("-march=native",)
    return flags if command and _macros(command, flags) else ()


@cache
def _macros(command: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Return the text of the compiler's predefined macros with these flags, which identify the
    processor in a shared cache of libraries; "" if the compiler fails within `SOON` seconds."""
    try:
        return run([*command, *flags, "-dM", "-E", "-x", "c", os.devnull], ".", limit=SOON)
    except CompilerFailed:
        return ""


def _demanded() -> tuple[str, ...]:
    command = _compiler()
    if command is None:
        raise NoCompiler()
    return command


@cache
def _load(
    command: tuple[str, ...], digest: str, files: tuple[tuple[str, str], ...], flags: tuple[str, ...]
) -> ctypes.CDLL:
    with cache_folder() as folder:
        library = folder / f"{digest}.so"
        if not is_kept(library):
            options = ("-O1", "-fPIC", "-shared", "-ffp-contract=off", *flags)
            with _built(command, dict(files), options, "step.so") as built:
                content = built.read_bytes()
            try:
                keep(library, content)
            except CannotWrite:  # as on a full disk
                library = process_folder() / library.name
                keep(library, content)
        try:
            return ctypes.CDLL(str(library))
        except OSError as error:
            remove(library.name, library.parent)
            raise CompilerFailed(command, f"what it made cannot be loaded: {error}") from None


@contextmanager
def _built(command: tuple[str, ...], files: Mapping[str, str], options: Iterable[str], name: str) -> Iterator[Path]:
    """Yield the path of the file `name` that the C compiler builds from C files; the file is removed
    when the context ends. Raises: `CompilerFailed`, also if the compiler hangs or writes nothing."""
    with tempfile.TemporaryDirectory() as folder:
        write(files, folder)
        run([*_demanded(), "-E", "-x", "c", os.devnull], folder, limit=SOON)
        sources = (each for each in files if each.endswith(".c"))
        whole, built = (*command, "-std=c99", *options, *sources, "-o", name), Path(folder) / name
        run(whole, folder)
        if not built.is_file():
            raise CompilerFailed(whole, f"it ended with status 0, but wrote no {name}")
        yield built


def run(command: Sequence[str], folder: str | Path, failed: Failed = CompilerFailed, limit: float = LIMIT) -> str:
    """Run a command in a folder and return its output.

    Raises: the error `failed(command, output)` if the command cannot be started, ends with an exit status other than 0,
    or exceeds `limit` seconds; the processes that it started are then ended, too.
    """
    group = 0 if os.name == "posix" else -1
    try:
        child = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            process_group=group,
        )
    except OSError as error:
        raise failed(tuple(command), f"it cannot be started: {error.strerror}") from None
    with child:
        try:
            output, errors = child.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            _end(child)
            raise failed(tuple(command), f"it did not end within {limit:g} s") from None
        except BaseException:  # such as Ctrl-C, which another process group does not receive
            _end(child)
            raise
    if child.returncode:
        raise failed(tuple(command), output + errors)
    return output


def _end(child: "subprocess.Popen[str]") -> None:
    if os.name == "posix":
        os.killpg(child.pid, signal.SIGKILL)
    child.kill()


def run_recipe(files: Sources) -> str:
    """Compile and run the self-check of another language than C, and return the output of its last command.

    Raises: `NoTool`, `CompilerFailed`, `CheckFailed`.
    """
    *before, last = files.recipe
    with tempfile.TemporaryDirectory() as folder:
        write(files, folder)
        for first, *arguments in before:
            failed = partial(CompilerFailed, fix=f"mend it, or name another by ${variable(first)}")
            run([_program(first, folder), *arguments], folder, failed)
        return run([_program(last[0], folder), *last[1:]], folder, CheckFailed)


def _program(name: str, folder: str) -> str:
    return str(Path(folder) / name) if name.startswith("./") else tool(name)


def variable(name: str) -> str:
    """Return the name of the environment variable that selects a program: RUSTC for rustc, CXX for c++."""
    return name.upper().translate({ord("+"): "X"})


def tool(name: str) -> str:
    """Return the path of a program, from its environment variable, else from the search path.

    Raises: `NoTool`.
    """
    there = shutil.which(os.environ.get(variable(name), "") or name)
    if there is None:
        raise NoTool(name)
    return there


def with_main(files: Iterable[str]) -> list[str]:
    """Return the compiler flags that enable the main functions of self-checks: -DNAME_CHECK_MAIN for each file
    NAME_check.c."""
    return [f"-D{Path(name).stem.upper()}_MAIN" for name in files if name.endswith("_check.c")]


def run_check(files: Mapping[str, str], flags: Sequence[str] = ("-O2",)) -> str:
    """Compile C files, with every warning an error, run their self-check, and return its output.

    Raises: `NoCompiler`, `CompilerFailed`, `CheckFailed`.
    """
    with _built(_demanded(), files, (*WARNINGS, *with_main(files), *flags), "check") as built:
        return run([str(built)], built.parent, CheckFailed)


_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_DESCRIPTORS = Path("/proc/self/fd")


@contextmanager
def cache_folder() -> Iterator[Path]:
    """The path of the folder of compiled libraries, valid while the context is open: hgogen in $XDG_CACHE_HOME, if that
    is absolute, else in ~/.cache. Where that cannot be written, or belongs to another user, it is a folder of this
    process alone."""
    with ExitStack() as opened:
        try:
            named = os.environ.get("XDG_CACHE_HOME", "")
            above = Path(named) if os.path.isabs(named) else Path.home() / ".cache"
            folder = _private_path(above / "hgogen", opened)
        except (CannotWrite, OSError, RuntimeError, ValueError):  # RuntimeError: there is no home
            folder = process_folder()
        yield folder


def _private_path(folder: Path, opened: ExitStack) -> Path:
    """Return a path to a folder that only this user can change, and that no
    renaming of folders above it redirects: libraries are loaded from it."""
    write({}, folder)
    if not hasattr(os, "geteuid"):  # on Windows the cache is part of the user's profile, which is closed to others
        return folder
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    opened.callback(os.close, handle)
    status = os.fstat(handle)
    if status.st_uid != os.geteuid() or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{folder} is not this user's to write")
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        os.fchmod(handle, stat.S_IRWXU)
    reached = _DESCRIPTORS / str(handle)
    return reached if reached.is_dir() else folder


def process_folder() -> Path:
    """Return the folder of this process for its libraries, which is removed when the process ends."""
    return Path(_temporary().name)


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="hgogen-", ignore_cleanup_errors=True)


def keep(library: Path, content: bytes) -> None:
    """Write a compiled library and its digest to disk. Raises: `CannotWrite`."""
    write({library.name: content, _digest_file(library).name: _digest(library, content)}, library.parent, private=True)


def is_kept(library: Path) -> bool:
    """Return whether a library is unchanged since `keep` wrote it: owned by this user, writable by no other, with the
    same digest."""
    try:
        known = _trusted_content(_digest_file(library)).decode(errors="replace")
        return known == _digest(library, _trusted_content(library))
    except OSError:
        return False


def _digest_file(library: Path) -> Path:
    return library.with_suffix(".sha256")


def _digest(library: Path, content: bytes) -> str:
    return sha256(library.name.encode() + b"\0" + content).hexdigest()


def _trusted_content(path: Path) -> bytes:
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(path, flags), "rb") as stream:
        status = os.fstat(stream.fileno())
        shared = hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & _OTHERS_WRITE)
        if shared or not stat.S_ISREG(status.st_mode):
            raise PermissionError(f"others can write {path}")
        return stream.read()
