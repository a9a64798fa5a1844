"""The bytes of a file or a pipe, up to a limit: no read is endless, in size or in time."""

import os
import select
import stat
from pathlib import Path
from time import monotonic

from hgogen.errors import BadArgument

SILENCE, PATIENCE = 60.0, 600.0  # seconds for which a pipe may say nothing, and may go on
_PIECE = 1 << 20  # bytes


class Unread(BadArgument):
    """A path of which the content was not read."""

    text = "{what}: {reason}"


def content_of(path: str | Path, most: int, silence: float = SILENCE, patience: float = PATIENCE) -> bytes:
    """The content of a regular file, or of a pipe until its end, `most` bytes at most; `silence`, `patience` (s): for
    how long a pipe may say nothing, and may go on.

    Raises: `Unread` where it is larger, takes longer, is a device or a folder, or is not there.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb", buffering=0) as stream:
            kind = os.fstat(handle).st_mode
            if not stat.S_ISREG(kind) and not stat.S_ISFIFO(kind):
                raise Unread(str(path), "is a device, whose content may have no end; give a file or a pipe")
            content, end = bytearray(), monotonic() + patience
            while len(content) <= most:
                wait = min(silence, max(end - monotonic(), 0))
                if stat.S_ISFIFO(kind) and not select.select([stream], [], [], wait)[0]:
                    raise Unread(str(path), "is a pipe that says nothing, or has no end; give a file")
                piece = stream.read(_PIECE)
                if piece == b"":
                    return bytes(content)
                content += piece or b""
    except FileNotFoundError:
        raise Unread(str(path), "there is no such file") from None
    except IsADirectoryError:
        raise Unread(str(path), "is a folder; give a file in it") from None
    except ValueError:  # a null byte
        raise Unread(str(path), "is no path") from None
    except OSError as error:
        raise Unread(str(path), f"cannot be read: {error.strerror}") from None
    raise Unread(str(path), f"holds more than {most / 2**20:g} MiB; give a part of it")
