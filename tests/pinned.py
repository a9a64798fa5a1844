"""The versions that made generated/, and which of those that are installed differ from them."""

import re
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

CONSTRAINTS = Path(__file__).parents[1] / ".ci" / "constraints.txt"
OLDEST = CONSTRAINTS.with_name("oldest.txt")


def versions(file: Path = CONSTRAINTS) -> dict[str, str]:
    """The version of each package in a file of constraints."""
    return dict(re.findall(r"^([\w-]+)==(\S+)$", file.read_text(), re.MULTILINE))


def differing(installed: Callable[[str], str] = metadata.version) -> str:
    """A sentence that names the packages whose versions are others; empty where there are none."""
    others = {name: (there, made) for name, made in versions().items() if (there := installed(name)) != made}
    differences = ", ".join(f"{name} {there} (made with {made})" for name, (there, made) in others.items())
    return f"installed are other versions than made generated/: {differences}" if differences else ""
