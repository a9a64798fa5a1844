"""Methods: each file is a case, a value that turns differential equations into statements.

It has the interface of `Method` in `hgogen/method.py`. An explicit Runge-Kutta method is its tableau in
`hgogen/discretisation/runge_kutta.py` and a file of one line, as `heun.py`.
"""

from typing import TYPE_CHECKING, Any

from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = load(__name__)
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
