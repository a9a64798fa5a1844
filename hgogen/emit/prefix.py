"""The name that all of an emitted step begins with: its files, functions, types, guards and macros."""

from dataclasses import dataclass, replace
from typing import TypeVar

from hgogen.emit.cnames import c_name, demand_file
from hgogen.errors import HgogenError
from hgogen.reading import filename
from hgogen.signal import check_name
from hgogen.step import Step

AnyStep = TypeVar("AnyStep", bound=Step)


@dataclass(eq=False)
class BadPrefix(HgogenError):
    """A name that the files and symbols of a step cannot begin with, for a language has it already."""

    name: str

    def __str__(self) -> str:
        return f"the name {self.name} is a keyword or a macro of C; take another, such as {self.name}_observer"


def prefixed(step: AnyStep, name: str) -> AnyStep:
    """The step with another name, so that two observers of one plant link together; nothing else of it is another.

    Raises: as `demand_prefix`.
    """
    demand_prefix(name)
    return replace(step, name=name)


def demand_prefix(name: str | None) -> None:
    """Raises: `BadName`, `BadFileName`, `BadPrefix`; `HidesHeader` for the name of a standard header."""
    if name is None:
        return
    check_name(name)
    filename.demand(name)
    if c_name(name) != name:
        raise BadPrefix(name)
    demand_file(name)
