"""The names of signals and files in a language, and the files of a step. A signal has another name where the language
reserves its own.

A C compiler reads the member of a struct after every header of the firmware that includes it, and a macro of one of
them, such as I of <complex.h> or SREG of an AVR, silently replaces the member's name. `names.txt` lists such names; a
test compares those of the standard headers with the installed compilers' own.
"""

# Takes apart: the lists of reserved names.

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

# <NAME.h> of the C standard, of POSIX and of CMSIS-DSP, which an emitted NAME.h in the path of headers would hide
_HEADERS = """
    arm_math assert complex ctype errno fcntl fenv float inttypes iso646 limits locale malloc math memory pthread sched
    semaphore setjmp signal stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn
    string strings syslog tgmath threads time types uchar unistd wchar wctype
"""


@dataclass(eq=False)
class HidesHeader(HgogenError):
    """The error for a model whose files would have the name of a standard C header and hide that header."""

    name: str

    def __str__(self) -> str:
        return f"the model {self.name} would be {self.name}.h, which hides <{self.name.lower()}.h>; rename the model"


@cache
def _reserved_names() -> frozenset[str]:
    lines = files("hgogen.emit").joinpath("names.txt").read_text(encoding="ascii").splitlines()
    return frozenset(word for line in lines if not line.startswith("#") for word in line.split())


def c_name(name: str) -> str:
    """Return a model's name as C may have it: `I_` for I, which is a macro; other names are rarely changed."""
    return f"{name}_" if name in _reserved_names() else name


def demand_file(name: str) -> None:
    """Raise `HidesHeader` for the name of a standard header."""
    if name.lower() in _HEADERS.split():
        raise HidesHeader(name)


@dataclass(eq=False)
class OneName(HgogenError):
    """The error for two signals of one struct whose names would be equal in a language."""

    names: tuple[str, str]
    language: str
    why: str

    def __str__(self) -> str:
        reserved, other = self.names
        return (
            f"{reserved} is {self.why} in {self.language}, where it would be called {other}, as another is; rename one"
        )


def renamed(step: Step, syntax: Syntax) -> dict[str, str]:
    """Return by the model's name the changed name of each signal whose name the language reserves (keywords,
    macros)."""
    names = dict.fromkeys(s.name for signals in _structs(step) for s in signals)
    return {name: syntax.name(name) for name in names if syntax.name(name) != name}


def renaming_sentence(step: Step, syntax: Syntax) -> str:
    """Return a sentence on the names that a language changes, such as "in C I is called I_, for a keyword or a macro
    has the name"; "" without such names."""
    pairs = ", ".join(f"{name} is called {other}" for name, other in renamed(step, syntax).items())
    return f"in {syntax.language} {pairs}, for {syntax.reserved} has the name" if pairs else ""


def demand_distinct(step: Step, syntax: Syntax) -> None:
    """Raise `OneName` where two signals of a struct would have equal names in the language of `syntax`."""
    for signals in _structs(step):
        names = {signal.name for signal in signals}
        for name in sorted(names):
            if syntax.name(name) != name and syntax.name(name) in names:
                raise OneName((name, syntax.name(name)), syntax.language, syntax.reserved)


def _structs(step: Step) -> Iterable[tuple[Signal, ...]]:
    return step.inputs, step.samples, step.states, step.observer.form.system.tunable


AnyStep = TypeVar("AnyStep", bound=Step)


@dataclass(eq=False)
class BadPrefix(HgogenError):
    """The error for a name that cannot be the prefix of a step's files and symbols, since C reserves it."""

    text = "the name {name} is a keyword or a macro of C; take another, such as {name}_observer"
    name: str


def prefixed(step: AnyStep, name: str) -> AnyStep:
    """Return a step with another name, the prefix of its files and symbols, so that two observers of one plant can be
    linked into one program.

    Raises: as `demand_prefix`.
    """
    demand_prefix(name)
    return replace(step, name=name)


def demand_prefix(name: str | None) -> None:
    """Raise `BadName`, `BadFileName`, `BadPrefix` or `HidesHeader` for a name that cannot be the prefix of a step's
    files and symbols; None passes."""
    if name is None:
        return
    check_name(name)
    demand_file_name(name)
    if c_name(name) != name:
        raise BadPrefix(name)
    demand_file(name)


def sources(step: Step, syntax: Syntax, files: Mapping[str, Iterable[str]], recipe: Recipe = ()) -> Sources:
    """Return the emitted files, with long lines broken and with the names that the language changes; `files`: lines by
    file name; `recipe`: the commands that compile and run the self-check."""
    texts = tuple((name, "\n".join(folded(lines)) + "\n") for name, lines in files.items())
    notes = tuple(filter(None, [renaming_sentence(step, syntax)]))
    return Sources(texts, recipe, tuple(renamed(step, syntax).items()), notes)
