"""Observers: each file is a case, a function from a Form to an Observer."""

from typing import TYPE_CHECKING, Any

from hgogen.observer import remembered
from hgogen.reading.door import switches
from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = {name: switches(remembered(case)) for name, case in load(__name__).items()}
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
