"""The unit in which a model counts time: a plain word, "s" unless its System says otherwise.

Rates, periods, trials and gains of a model are all in it; nothing is converted. What is printed for people and for
firmware says it, and a known unit also in seconds.
"""

import re
from collections.abc import Iterable

from hgogen.sentence import same

_WORD = re.compile(r"[A-Za-z]{1,12}\Z")
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_PLURAL = {"us": "microseconds", "ms": "milliseconds", "s": "seconds", "min": "minutes", "h": "hours", "d": "days"}


def is_unit(value: object) -> bool:
    """Whether a value can be a unit of time."""
    return isinstance(value, str) and bool(_WORD.match(value))


def seconds(time: str) -> float | None:
    """How many seconds the unit has, where that is known."""
    return _SECONDS.get(time)


def plural(time: str) -> str:
    """The unit in a sentence: "seconds" for "s"; one without a known name as it is."""
    return _PLURAL.get(time, time)


def of_time(unit: str, time: str, declared: Iterable[str] = ()) -> str:
    """A unit that is written with s, such as y^2 s, in the time of the model; one that a signal declares stays."""
    return unit if time == "s" or unit in declared else re.sub(r"\bs(\d*)\b", rf"{time}\1", unit)


def pace(dt: float, time: str) -> str:
    """A period as a caller keeps it: "0.01 h (36 s)", without the seconds where they are not known."""
    text = f"{same(dt)} {time}"
    return text if time == "s" or time not in _SECONDS else f"{text} ({dt * _SECONDS[time]:.6g} s)"
