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
    """The arguments by name of an observer's function: all, and those without a default."""
    return _names(p for p in signature(make).parameters.values() if p.kind is Parameter.KEYWORD_ONLY)


def faults(
    make: Callable[..., Any], given: Iterable[str], beside: Iterable[str] = (), first: int = 0
) -> Iterator[tuple[str, str]]:
    """The keys that a function does not take, each with a sentence; then, with an empty key, a sentence for each one
    that is missing. `beside`: keys that stand in the same table; `first`: how many arguments are given otherwise."""
    known, needed = _names(list(signature(make).parameters.values())[first:])
    for key in given:
        if key not in known:
            listed = f"its arguments are {', '.join(known)}" if known else "it takes none"
            fix = nearest(key, [*known, *beside], listed)
            yield key, f"{make.__name__} has no argument {key[:60]!r}; {fix}"
    for key in needed:
        if key not in given:
            yield "", f"the key {key!r} is missing; {make.__name__} needs it"


def value(key: str, given: Any) -> Any:
    """What text stands for: a table with `kind` for the value that it makes, a list of thresholds `mu` for a tuple.

    Raises: `BadGain`, and what the value's function raises.
    """
    if key in _VALUES and isinstance(given, Mapping):
        makers = {make.__name__: make for make in _VALUES[key]}
        if given.get("kind") not in makers:
            raise BadGain(f"{key} of kind {given.get('kind')!r}", f"is none; the kinds are {', '.join(makers)}")
        make, told = makers[given["kind"]], {name: entry for name, entry in given.items() if name != "kind"}
        for _, said in faults(make, told, ("kind",)):
            raise BadGain(f"in {key},", said)
        return make(**{name: value(name, entry) for name, entry in told.items()})
    return tuple(given) if key == "mu" and isinstance(given, list) else given


def poles(given: Any, chains: int) -> Any:
    """What a list of poles stands for: a pair [re, im] for a complex pole; of several chains there is a list for each,
    in which a pair of numbers is two real poles."""
    if not isinstance(given, list):
        return given
    return [_complex(each) for each in given] if chains > 1 else _complex(given)


def _complex(given: Any) -> Any:
    return [complex(*pole) if _pair(pole) else pole for pole in given] if isinstance(given, list) else given


def _pair(given: Any) -> bool:
    return isinstance(given, list) and len(given) == 2 and all(type(part) in (int, float) for part in given)


def _names(parameters: Iterable[Parameter]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    named = tuple(parameters)
    return tuple(p.name for p in named), tuple(p.name for p in named if p.default is Parameter.empty)
