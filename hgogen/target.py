"""A target turns a step into files. Emission is pure; only `write` touches the disk.

The folder that the user names may be a link. Below it no path leads elsewhere: "..", a link, a device, a pipe or a
socket is refused, as a folder on the path and in the place of a file.
"""

import os
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import IO

from hgogen.errors import HgogenError
from hgogen.reading.files import KINDS, name_key, quoted

_STAGED = ".hgogen-"  # begins the name of an incomplete file
AT_ONCE = 1 << 16  # bytes of a file, in search of its last line
_PRIVATE = stat.S_IRUSR | stat.S_IWUSR
LONGEST = 255  # bytes of a name, on most file systems


@dataclass(eq=False)
class CannotWrite(HgogenError):
    """The error for a folder or file that cannot be written."""

    text = "cannot write {path}: {reason}; {fix}"
    path: str
    reason: str
    fix: str = "choose a folder that can be written"


@dataclass(frozen=True)
class Files(Mapping[str, str]):
    """Emitted files: name to text, in order."""

    texts: tuple[tuple[str, str], ...]

    def __getitem__(self, name: str) -> str:
        return dict(self.texts)[name]

    def __iter__(self) -> Iterator[str]:
        return (name for name, _ in self.texts)

    def __len__(self) -> int:
        return len(self.texts)


Recipe = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Sources(Files):
    """The files of a generated program in one language.

    `recipe`: the commands that compile and run their self-check in their folder, for a language other than C; `names`:
    signals with another name in the language, and that name; `notes`: sentences about these.
    """

    recipe: Recipe = ()
    names: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


def write(files: Mapping[str, str | bytes], folder: str | Path, private: bool = False) -> list[Path]:
    """Write texts (UTF-8) or bytes by name, or by a path below it, into `folder`, which is created if needed, and
    return their paths.

    Nothing is written unless all can be, and each file appears whole or not at all. Incomplete files of a killed
    process in these folders are removed. `private`: only this user can read and write the files.

    Raises: `CannotWrite`; `Misfit` for a value that is no mapping from names.
    """
    paths = _demand_files(files, folder)
    staged, at = list[Path](), Path(folder)
    with ExitStack() as opened:
        try:
            for each in dict.fromkeys((Path(folder), *(path.parent for path in paths))):
                each.mkdir(parents=True, exist_ok=True)
                _clear(each)
            for at, content in zip(paths, files.values(), strict=True):
                handle, temporary = _staged(at.parent, opened)
                staged.append(temporary)
                with os.fdopen(handle, "wb", closefd=False) as stream:
                    stream.write(content.encode() if isinstance(content, str) else content)
                if private or at.exists():
                    os.chmod(temporary, _PRIVATE if private else at.stat().st_mode & 0o777)
            if os.name == "nt":  # it has no locks, and renames no file that is open
                opened.close()
            for temporary, at in zip(staged, paths, strict=True):
                os.replace(temporary, at)
        except OSError as error:
            raise _failed(error, at) from error
        finally:
            for temporary in staged:
                temporary.unlink(missing_ok=True)
    return paths


def _demand_files(files: Mapping[str, str | bytes], folder: str | Path) -> list[Path]:
    if not isinstance(files, Mapping):
        from hgogen.reading.given import Misfit  # slow to import

        raise Misfit("write", files, "files by name, as of hg.targets.c99(step)")
    paths = demand(files, folder)
    for name, content in files.items():
        if not isinstance(content, str | bytes):
            reason = f"what it is to hold is of type {type(content).__name__}"
            raise CannotWrite(quoted(name), reason, "give a text or bytes")
    return paths


def remove(name: str, folder: str | Path) -> None:
    """Remove a file of `folder`, if it exists. Raises: `CannotWrite`."""
    (path,) = demand([name], folder)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise _failed(error, Path(folder)) from error


@contextmanager
def lines_of(name: str, folder: str | Path) -> Iterator[tuple[Iterator[str], Callable[[str], None]]]:
    """Yield one pair: an iterator over the complete lines of a file in `folder`, and a function that appends a line,
    which has to end with a newline. An incomplete last line is overwritten. No other process can append meanwhile.

    Raises: `CannotWrite`.
    """
    (path,) = demand([name], folder)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "r+b", opener=lambda name, flags: os.open(name, flags | os.O_CREAT, 0o666)) as stream:
            if _locked(stream) is False:
                fix = "wait until that one has ended, or give another folder"
                raise CannotWrite(str(path), "another process is writing it", fix)
            end = _whole(stream)
            stream.seek(end)

            def add(line: str) -> None:
                stream.truncate()
                stream.write(line.encode())
                stream.flush()

            yield _lines(path, end), add
    except OSError as error:
        raise _failed(error, Path(folder)) from error


def _whole(stream: IO[bytes]) -> int:
    end = stream.seek(0, os.SEEK_END)
    while end:
        begin = stream.seek(max(0, end - AT_ONCE))
        if (last := stream.read(end - begin).rfind(b"\n")) >= 0:
            return begin + last + 1
        end = begin
    return 0


def _lines(path: Path, end: int) -> Iterator[str]:
    with open(path, "rb") as stream:
        while stream.tell() < end:
            yield stream.readline().decode(errors="replace")


def _locked(stream: IO[bytes] | int) -> bool | None:
    """Lock a file until it is closed. Return False if another process holds it, None if there are no locks."""
    try:
        import fcntl

        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # the system, or the file system, has none
        return None
    return True


def demand(names: Iterable[str], folder: str | Path) -> list[Path]:
    """Return the paths at which `write` would put files with these names, without writing. Raises: `CannotWrite` where
    `write` would refuse a file."""
    if not isinstance(folder, str | os.PathLike):
        raise CannotWrite(quoted(folder), "it is no path", "give that of a folder")
    names, root = list(names), Path(folder)
    if strange := [name for name in names if not isinstance(name, str)]:
        raise CannotWrite(quoted(strange[0]), "it is no name of a file", "give a text")
    try:
        if _kind(root, follow=True) not in (None, stat.S_IFDIR):
            raise _misplaced(root, "a folder")
        by_key: dict[str, str] = {}
        for name in names:
            if name_key(name) in by_key:
                reason = f"{quoted(by_key[name_key(name)])} and {quoted(name)} are one name on some systems"
                raise CannotWrite(str(root), reason, "rename one of them")
            by_key[name_key(name)] = name
        paths = [_below(root, name) for name in names]
        for there in {next(above for above in path.parents if above.exists()) for path in paths}:
            if not os.access(there, os.W_OK | os.X_OK):
                raise CannotWrite(str(there), "it may not be written to")
        return paths
    except OSError as error:
        raise _failed(error, root) from error
    except ValueError as error:  # a null byte, or a character that the file system cannot encode
        raise CannotWrite(quoted(str(root)), f"no path is made of it and {names} ({error})", "take others") from None


def _below(root: Path, name: str) -> Path:
    pure = PurePath(name)
    if not pure.parts or pure.anchor or ".." in pure.parts:
        raise CannotWrite(quoted(name), f"it leaves the folder {root}", "take a name that stays in it")
    if any(len(os.fsencode(part)) > LONGEST for part in pure.parts):
        raise CannotWrite(quoted(name), f"it has a part longer than {LONGEST} bytes", "take a shorter name")
    path = root / pure
    for above in reversed(path.parents[: len(pure.parts) - 1]):
        if _kind(above) not in (None, stat.S_IFDIR):
            raise _misplaced(above, "a folder")
    if _kind(path) not in (None, stat.S_IFREG):
        raise _misplaced(path, "a file")
    return path


def _kind(path: Path, follow: bool = False) -> int | None:
    try:
        return stat.S_IFMT(path.stat(follow_symlinks=follow).st_mode)
    except FileNotFoundError:
        return _kind(path) if follow else None


def _misplaced(path: Path, wanted: str) -> CannotWrite:
    there = KINDS.get(_kind(path) or 0, "no file")
    return CannotWrite(str(path), f"it is {there}, where {wanted} belongs", "remove it, or take another path")


def _staged(folder: Path, opened: ExitStack) -> tuple[int, Path]:
    """Return a new temporary file, its descriptor and path, locked until
    `opened` is closed, so that no other process removes it as incomplete."""
    while True:
        path = folder / f"{_STAGED}{secrets.token_hex(8)}"
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        opened.callback(os.close, handle)
        if _locked(handle) is not False and path.exists():  # else another process was faster than the lock
            return handle, path


def _clear(folder: Path) -> None:
    """Remove the incomplete files of killed processes in a
    folder: those that are neither locked nor renamed."""
    for path in folder.glob(f"{_STAGED}*"):
        if _kind(path) == stat.S_IFREG:
            with suppress(OSError), open(path, "rb") as stream:
                if _locked(stream):
                    path.unlink(missing_ok=True)


def _failed(error: OSError, path: Path) -> CannotWrite:
    """Return the error for the path that could not be written; `path` if the error names no path, or a temporary
    file."""
    known = Path(error.filename) if error.filename else path
    return CannotWrite(str(path if known.name.startswith(_STAGED) else known), error.strerror or str(error))
