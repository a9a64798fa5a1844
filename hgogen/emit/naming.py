"""Signals whose names a language does not take as they are: what they are called there, and that none is called as
another is."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from hgogen.errors import HgogenError
from hgogen.signal import Signal
from hgogen.step import Step


@dataclass(eq=False)
class OneName(HgogenError):
    """Two signals of one struct that a language would call the same."""

    names: tuple[str, str]
    language: str
    why: str

    def __str__(self) -> str:
        reserved, other = self.names
        return (
            f"{reserved} is {self.why} in {self.language}, where it would be called {other}, as another is; rename one"
        )


def renamed(step: Step, name: Callable[[str], str]) -> dict[str, str]:
    """The signals that `name` calls otherwise, and how."""
    names = dict.fromkeys(s.name for signals in _structs(step) for s in signals)
    return {own: name(own) for own in names if name(own) != own}


def says(step: Step, name: Callable[[str], str]) -> str:
    """The same in words, "I is called I_"."""
    return ", ".join(f"{own} is called {other}" for own, other in renamed(step, name).items())


def demand_distinct(step: Step, name: Callable[[str], str], language: str, why: str) -> None:
    """Raise `OneName` where two names of a struct would be one."""
    for signals in _structs(step):
        names = {signal.name for signal in signals}
        for own in sorted(names):
            if name(own) != own and name(own) in names:
                raise OneName((own, name(own)), language, why)


def _structs(step: Step) -> Iterable[tuple[Signal, ...]]:
    """The signals of each struct."""
    parameters = tuple(p for p in step.observer.form.system.parameters if p.bounded)
    return step.inputs, step.samples, step.states, parameters
