"""What a signal is called in C: by its own name, with an underscore where a keyword or a macro would take its place.

A struct's member is read by the compiler after every header of the firmware that includes it, and a macro of one of
them, such as I of <complex.h> or SREG of an AVR, replaces the member's name without a word. `names.txt` lists such
names; those of the standard headers are compared with the installed compilers' by a test.
"""

# Takes apart: the lists of names that are taken.

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from hgogen.errors import HgogenError

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
