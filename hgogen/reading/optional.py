"""What is installed: libraries that few need, else a sentence that says how to install them; the package's version."""

from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata
from typing import Any

from hgogen.errors import HgogenError


@dataclass(eq=False)
class NotInstalled(HgogenError):
    """A library that is not installed, what it is needed for, and the extra of hgogen that brings it."""

    what: str
    library: str
    extra: str

    def __str__(self) -> str:
        return f'{self.what} needs {self.library}; install it: pip install "hgogen[{self.extra}]"'


def library(name: str, what: str, extra: str = "logs") -> Any:
    """The module of that name. Raises: `NotInstalled`, of `what` needs it."""
    try:
        return import_module(name)
    except ImportError:
        raise NotInstalled(what, name.partition(".")[0], extra) from None


@cache
def version() -> str:
    """That of pyproject.toml, as it was installed."""
    return metadata.version("hgogen")
