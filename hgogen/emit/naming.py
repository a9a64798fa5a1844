"""What signals, and files, are called in a language: by their own names, another one where a language has the name.

A struct's member is read by a C compiler after every header of the firmware that includes it, and a macro of one of
them, such as I of <complex.h> or SREG of an AVR, replaces the member's name without a word. `names.txt` lists such
names; those of the standard headers are compared with the installed compilers' by a test.
"""

# Takes apart: the lists of names that are taken.

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import TypeVar

from hgogen.emit.code import folded
from hgogen.emit.syntax import Syntax
from hgogen.errors import HgogenError
from hgogen.reading.files import demand_file_name
from hgogen.signal import Signal, check_name
from hgogen.step import Step
from hgogen.target import Recipe, Sources

# <NAME.h> of the C standard, of POSIX and of CMSIS-DSP, which a NAME.h of ours in the path of headers would hide
_HEADERS = """
    arm_math assert complex ctype errno fcntl fenv float inttypes iso646 limits locale malloc math memory pthread sched
    semaphore setjmp signal stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn
    string strings syslog tgmath threads time types uchar unistd wchar wctype
"""


@dataclass(eq=False)
class HidesHeader(HgogenError):
    """A model whose files would take the place of a standard header."""

    name: str

    def __str__(self) -> str:
        return f"the model {self.name} would be {self.name}.h, which hides <{self.name.lower()}.h>; rename the model"


@cache
def _taken() -> frozenset[str]:
    lines = files("hgogen.emit").joinpath("names.txt").read_text(encoding="ascii").splitlines()
    return frozenset(word for line in lines if not line.startswith("#") for word in line.split())


def c_name(name: str) -> str:
    """The name in C: `I_` for I, which is a macro; almost always the name itself."""
    return f"{name}_" if name in _taken() else name


def demand_file(name: str) -> None:
    """Raise `HidesHeader` for the name of a header."""
    if name.lower() in _HEADERS.split():
        raise HidesHeader(name)


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
    """The renaming in words, "in C I is called I_, for a keyword or a macro has the name"; "" where none is."""
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
    return step.inputs, step.samples, step.states, step.observer.form.system.tunable


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
    demand_file_name(name)
    if c_name(name) != name:
        raise BadPrefix(name)
    demand_file(name)


def sources(step: Step, syntax: Syntax, files: Mapping[str, Iterable[str]], recipe: Recipe = ()) -> Sources:
    """Files of these lines, of which none is long, and the signals that the language calls otherwise."""
    texts = tuple((name, "\n".join(folded(lines)) + "\n") for name, lines in files.items())
    return Sources(texts, recipe, tuple(renamed(step, syntax).items()), tuple(filter(None, [says(step, syntax)])))
