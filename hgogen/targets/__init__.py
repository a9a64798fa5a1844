"""Targets: each file is a case, a function from a Step to Files."""

from typing import TYPE_CHECKING, Any

from hgogen.reading.door import switches
from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = {name: switches(case) for name, case in load(__name__).items()}
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
