"""Targets: each file is a case, a function from a Step to Files."""

from typing import TYPE_CHECKING, Any

from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = load(__name__)
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
