"""Observability forms: each file is a case, a function from a System to a Form."""

from typing import TYPE_CHECKING, Any

from hgogen.form import valued
from hgogen.reading.door import asks_a_plant, remembers, switches
from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = {name: asks_a_plant(switches(remembers(valued(case)))) for name, case in load(__name__).items()}
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
