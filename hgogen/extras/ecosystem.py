"""The ecosystems that a folder may be for, as ecosystems.toml has them: files, and how a project takes them."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from string import Template

from hgogen.errors import BadArgument, HgogenError, nearest

ALL = "all"


class UnknownEcosystem(BadArgument):
    """An ecosystem that there is not."""


@dataclass(eq=False)
class ReservedName(HgogenError):
    """A name that an ecosystem has for something of its own."""

    name: str
    ecosystem: str

    def __str__(self) -> str:
        return f"the name {self.name} is {self.ecosystem}'s own; take another by --name"


class Text(Template):
    """A template whose placeholders begin with a percent sign, for CMake has the dollar."""

    delimiter = "%"


@dataclass(frozen=True)
class Ecosystem:
    """`files`: the template of each path; `use`: how a project takes the folder; `reserved`: names that it may not
    have."""

    name: str
    files: Mapping[str, str]
    title: str = ""
    use: str = ""
    reserved: tuple[str, ...] = ()


@cache
def _table() -> Mapping[str, Ecosystem]:
    """All of them by name, and `common`, what every folder has."""
    rows = tomllib.loads(files("hgogen.extras").joinpath("ecosystems.toml").read_text(encoding="utf-8"))
    return {name: Ecosystem(name, **{**row, "reserved": tuple(row.get("reserved", ()))}) for name, row in rows.items()}


@cache
def template(name: str) -> Text:
    """A template by the name of its file."""
    path = files("hgogen.extras").joinpath("templates", name)
    return Text(path.read_text(encoding="utf-8"))


def common() -> Ecosystem:
    """What every folder has."""
    return _table()["common"]


def known() -> list[str]:
    """The names of all ecosystems."""
    return [name for name in _table() if name != "common"]


def chosen(words: str, name: str) -> tuple[Ecosystem, ...]:
    """The ecosystems of a list with commas, or of "all", for a folder of this name.

    Raises: `UnknownEcosystem`, `ReservedName`.
    """
    names = [word.strip() for word in words.split(",")]
    for word in names:
        if word not in (*known(), ALL):
            fix = nearest(word, (*known(), ALL), f"there are {', '.join(known())}, and all")
            raise UnknownEcosystem(f"--for {word[:60]}:", f"there is no such ecosystem; {fix}")
    picked = tuple(_table()[word] for word in known() if word in names or ALL in names)
    for each in picked:
        if name.lower() in each.reserved:
            raise ReservedName(name, each.title)
    return picked
