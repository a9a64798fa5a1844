"""A target turns a step into files. Emission is pure; only `write` touches the disk."""

import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hgogen.errors import HgogenError


@dataclass(eq=False)
class CannotWrite(HgogenError):
    """A folder or file that cannot be written."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f"cannot write {self.path}: {self.reason}; choose a folder that can be written"


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


def write(files: Mapping[str, str] | Mapping[str, bytes], folder: str | Path) -> list[Path]:
    """Write texts (UTF-8) or bytes by name into `folder` (made if it is not there); each appears whole or not at all.

    Raises: `CannotWrite`.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_replace(folder / name, content) for name, content in files.items()]
    except OSError as error:
        raise CannotWrite(str(error.filename or folder), error.strerror or str(error)) from error


def _replace(path: Path, content: str | bytes) -> Path:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return path
