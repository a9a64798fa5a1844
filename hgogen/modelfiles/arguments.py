"""Arguments of a function as a table holds them: whether it takes them, and the values that text stands for."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import Parameter, signature
from typing import Any

from hgogen.errors import nearest
from hgogen.kalman import innovation, theta
from hgogen.reading.given import BadGain

_VALUES: dict[str, tuple[Callable[..., Any], ...]] = {  # arguments that a table with `kind` makes
    "theta": (theta.constant, theta.decaying, theta.adaptive),
    "mu": (theta.smoothstep, theta.logistic),
    "innovation": (innovation.staggered, innovation.window),
}


def arguments(make: Callable[..., Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The arguments by name of an observer's function as a table has them: all, and those without a default; of one
    around another observer the member first."""
    each = signature(make).parameters.values()
    return _names(p for p in each if p.kind is Parameter.KEYWORD_ONLY or p.name == "member")


def faults(
    make: Callable[..., Any], keys: Iterable[str], beside: Iterable[str] = (), first: int = 0
) -> Iterator[tuple[str, str]]:
    """The keys that a function does not take, each with a sentence; then, with an empty key, a sentence for each one
    that is missing. `beside`: keys that stand in the same table; `first`: how many arguments are given otherwise."""
    known, needed = _names(list(signature(make).parameters.values())[first:])
    for key in keys:
        if key not in known:
            listed = f"its arguments are {', '.join(known)}" if known else "it takes none"
            fix = nearest(key, [*known, *beside], listed)
            yield key, f"{make.__name__} has no argument {key[:60]!r}; {fix}"
    for key in needed:
        if key not in keys:
            yield "", f"the key {key!r} is missing; {make.__name__} needs it"


def value(key: str, raw: Any) -> Any:
    """What text stands for: a table with `kind` for the value that it makes, a list of thresholds `mu` for a tuple.

    Raises: `BadGain`, and what the value's function raises.
    """
    if key in _VALUES and isinstance(raw, Mapping):
        makers = {make.__name__: make for make in _VALUES[key]}
        if raw.get("kind") not in makers:
            raise BadGain(f"{key} of kind {raw.get('kind')!r}", f"is none; the kinds are {', '.join(makers)}")
        make, options = makers[raw["kind"]], {name: entry for name, entry in raw.items() if name != "kind"}
        for _, said in faults(make, options, ("kind",)):
            raise BadGain(f"in {key},", said)
        return make(**{name: value(name, entry) for name, entry in options.items()})
    return tuple(raw) if key == "mu" and isinstance(raw, list) else raw


def poles(listed: Any, chains: int) -> Any:
    """What a list of poles stands for: a pair [re, im] for a complex pole; of several chains there is a list for each,
    in which a pair of numbers is two real poles."""
    if not isinstance(listed, list):
        return listed
    return [_complex(each) for each in listed] if chains > 1 else _complex(listed)


def _complex(listed: Any) -> Any:
    return [complex(*pole) if _pair(pole) else pole for pole in listed] if isinstance(listed, list) else listed


def _pair(pole: Any) -> bool:
    return isinstance(pole, list) and len(pole) == 2 and all(type(part) in (int, float) for part in pole)


def _names(parameters: Iterable[Parameter]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    named = tuple(parameters)
    return tuple(p.name for p in named), tuple(p.name for p in named if p.default is Parameter.empty)
