"""The folder of compiled libraries, and which of them may be loaded.

Loading a library runs the code in it, so only this user may be able to write it. The folder belongs to this user and
is closed to others. It is reached through an open descriptor where the system has such paths, so that renaming a folder
above it does not exchange what was verified. Beside each library stands a digest of its name and its content: one that
is truncated, or was made for another model, is built anew.
"""

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path

from hgogen.target import CannotWrite, write

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_DESCRIPTORS = Path("/proc/self/fd")


@contextmanager
def cache_folder() -> Iterator[Path]:
    """The path of the folder of compiled libraries, which holds while the context is open: hgogen in $XDG_CACHE_HOME,
    if that is absolute, else in ~/.cache. Where that cannot be written, or belongs to another user, it is a folder of
    this process alone."""
    with ExitStack() as opened:
        try:
            named = os.environ.get("XDG_CACHE_HOME", "")
            above = Path(named) if os.path.isabs(named) else Path.home() / ".cache"
            folder = _private(above / "hgogen", opened)
        except (CannotWrite, OSError, RuntimeError, ValueError):  # RuntimeError: there is no home
            folder = process_folder()
        yield folder


def _private(folder: Path, opened: ExitStack) -> Path:
    """The path by which a folder is reached that only this user can change from now on.

    Raises: `CannotWrite`, `OSError` where it belongs to another user or cannot be written.
    """
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
    """The folder of this process for its libraries, which is removed when the process ends."""
    return Path(_temporary().name)


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="hgogen-", ignore_cleanup_errors=True)


def keep(library: Path, content: bytes) -> None:
    """Write a library and its digest. Raises: `CannotWrite`."""
    write({library.name: content, _beside(library).name: _digest(library, content)}, library.parent, private=True)


def is_kept(library: Path) -> bool:
    """Whether a library stands there as `keep` wrote it: this user's, writable by no other, with its own digest."""
    try:
        return _own(_beside(library)).decode(errors="replace") == _digest(library, _own(library))
    except OSError:
        return False


def _beside(library: Path) -> Path:
    return library.with_suffix(".sha256")


def _digest(library: Path, content: bytes) -> str:
    return sha256(library.name.encode() + b"\0" + content).hexdigest()


def _own(path: Path) -> bytes:
    """The content of a regular file that only this user can write. Raises: `OSError` for any other."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(path, flags), "rb") as stream:
        status = os.fstat(stream.fileno())
        shared = hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & _OTHERS_WRITE)
        if shared or not stat.S_ISREG(status.st_mode):
            raise PermissionError(f"others can write {path}")
        return stream.read()
