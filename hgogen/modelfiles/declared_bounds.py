"""What a model file says in its bounds: how large at most what enters a step is, and what is asked of the errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hgogen.errors import HgogenError
from hgogen.guarantees.entering import ENTERING
from hgogen.intervals.computed import REALS

_GAINS = "gains"


@dataclass(eq=False)
class NoBounds(HgogenError):
    """What stands in bounds and is none."""

    shown: str

    def __str__(self) -> str:
        sizes = f"a mapping from some of {', '.join(ENTERING)} to sizes by name"
        return f"in bounds, {self.shown} is none; make it {sizes}, real a precision, {_GAINS} true or false"


@dataclass(frozen=True)
class Bounds:
    """`sizes`: arguments of `hg.error_bound`; `gains`: whether those in continuous time are asked for as well."""

    sizes: Mapping[str, Any]
    gains: bool


def bounds(declared: Any) -> Bounds:
    """Those that a file declares. Raises: `NoBounds`."""
    for what, value in declared.items() if isinstance(declared, Mapping) else [("bounds", declared)]:
        sized = what in ENTERING and isinstance(value, Mapping)
        if not (sized or (what == "real" and value in REALS) or (what == _GAINS and isinstance(value, bool))):
            raise NoBounds(f"{what} = {value!r}")
    sizes = {what: value for what, value in declared.items() if what != _GAINS}
    return Bounds(sizes, declared.get(_GAINS, False))
