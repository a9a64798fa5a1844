"""Methods: each file is a case, a value that turns differential equations into statements."""

from typing import TYPE_CHECKING, Any

from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = load(__name__)
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
