"""Signals whose names a language does not take as they are: what they are called there, and that none is called as
another is."""

from collections.abc import Iterable
from dataclasses import dataclass

from hgogen.emit.syntax import Syntax
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


def renamed(step: Step, syntax: Syntax) -> dict[str, str]:
    """The signals that the language calls otherwise, and how."""
    names = dict.fromkeys(s.name for signals in _structs(step) for s in signals)
    return {own: syntax.name(own) for own in names if syntax.name(own) != own}


def says(step: Step, syntax: Syntax) -> str:
    """The same in words, "in C I is called I_, for a keyword or a macro has the name"; "" where none is."""
    pairs = ", ".join(f"{own} is called {other}" for own, other in renamed(step, syntax).items())
    return f"in {syntax.language} {pairs}, for {syntax.reserved} has the name" if pairs else ""


def demand_distinct(step: Step, syntax: Syntax) -> None:
    """Raise `OneName` where two names of a struct would be one."""
    for signals in _structs(step):
        names = {signal.name for signal in signals}
        for own in sorted(names):
            if syntax.name(own) != own and syntax.name(own) in names:
                raise OneName((own, syntax.name(own)), syntax.language, syntax.reserved)


def _structs(step: Step) -> Iterable[tuple[Signal, ...]]:
    """The signals of each struct."""
    return step.inputs, step.samples, step.states, step.observer.form.system.tunable
