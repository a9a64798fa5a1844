"""The version of the package."""

from functools import cache
from importlib import metadata


@cache
def version() -> str:
    """That of pyproject.toml, as it was installed."""
    return metadata.version("hgogen")
