"""What the package remembers of observers and steps, forgotten: for tests that patch what makes them."""

import functools
import gc
from typing import Any

import hgogen as hg

MAKERS = (
    *("hgogen.observer", "hgogen.step", "hgogen.run.backends", "hgogen.emit.manual"),
    *("hgogen.certificates.rounding_share", "hgogen.recheck.verification", "hgogen.emit.node"),
    "hgogen.discretisation.runge_kutta",
)
_REMEMBERED: list[Any] = []


def know() -> None:
    """Take note of what is imported by now, and of every case; what is frozen then is seen by nobody."""
    for folder in (hg.forms, hg.observers, hg.methods, hg.targets):
        for name in folder.__all__:
            getattr(folder, name)
    caches = (each for each in gc.get_objects() if isinstance(each, functools._lru_cache_wrapper))
    _REMEMBERED.extend(each for each in caches if each.__module__ in MAKERS)


def forget() -> None:
    """Have all made anew."""
    for cache in _REMEMBERED:
        cache.cache_clear()
