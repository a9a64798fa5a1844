"""Numbers and names as a user gives them; a masked entry of a NumPy array is missing, NaN, where numbers are taken."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import sympy as sp

from hgogen.check import Check
from hgogen.errors import HgogenError, nearest

S = TypeVar("S", bound=sp.Symbol)


@dataclass(eq=False)
class BadGain(HgogenError):
    """A gain of the wrong length, sign or kind; the sentence names it and the fix.

    `because`: the check that says why, where one does; `fix`: what to do then.
    """

    gain: str
    reason: str
    because: Check | None = None
    fix: str = ""

    def __str__(self) -> str:
        why = f": {self.because.reason}" if self.because else ""
        return f"{self.gain} {self.reason}{why}{f'; {self.fix}' if self.fix else ''}"


def reals(name: str, value: Any) -> np.ndarray:
    """A number or an array of numbers as floats, NaN where it is masked. Raises: `BadGain` for anything else."""
    try:
        array = np.asarray(unmasked(value))
        if value is None or array.dtype.kind in "USc":  # which numpy would turn into NaN, into numbers, or cut
            raise TypeError
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise BadGain(f"{name} = {value!r}", "must be a number or an array of numbers") from None


def real(name: str, value: Any) -> float:
    """A number as a float. Raises: `BadGain` for anything else."""
    array = reals(name, value)
    if array.ndim:
        raise BadGain(f"{name} of shape {array.shape}", "must be a single number")
    return float(array)


def positive(name: str, value: Any) -> float:
    """A number above 0 as a float. Raises: `BadGain` for anything else."""
    number = real(name, value)
    if not 0 < number < np.inf:
        raise BadGain(f"{name} = {value!r}", "must be a positive finite number")
    return number


def names(what: str, value: Any) -> tuple[Any, ...]:
    """Names, or signals for theirs, of which one may be given alone. Raises: `BadGain` for anything else."""
    if isinstance(value, str | sp.Symbol):
        return (value,)
    if not isinstance(value, Iterable):
        raise BadGain(f"{what} = {value!r}", "must be a name or several, such as ['a', 'b']")
    return tuple(value)


def signals_named(
    what: str, value: Any, signals: Iterable[S], unknown: Callable[[str, str], HgogenError]
) -> tuple[S, ...]:
    """The signals of these names, in their own order. Raises: `BadGain` for no names; for the name of none what
    `unknown` makes of it and of what to take instead."""
    every = {str(signal): signal for signal in signals}
    wanted = set(map(str, names(what, value)))
    for name in sorted(wanted.difference(every)):
        listed = f"there are {', '.join(every)}" if every else "there is none"
        raise unknown(name[:60], nearest(name, every, listed))
    return tuple(signal for name, signal in every.items() if name in wanted)


def among(value: object, choices: Iterable[str | None]) -> bool:
    """Whether a value is a text, or None, that is one of the choices; an array or a list is none."""
    return (value is None or isinstance(value, str)) and value in choices


def count(name: str, value: Any, low: int, high: int) -> int:
    """A whole number from `low` to `high`. Raises: `BadGain` for anything else."""
    number = real(name, value)
    if isinstance(value, bool) or not low <= number <= high or number != round(number):
        raise BadGain(f"{name} = {value!r}", f"must be a whole number, from {low} to {high}")
    return int(number)


def unmasked(value: Any) -> Any:
    """The value with NaN for each entry that is masked, in arrays inside of sequences as well. Raises: `TypeError`,
    `ValueError` where an array with a mask holds no numbers."""
    if isinstance(value, np.ma.MaskedArray):
        return np.ma.filled(value.astype(float), np.nan)
    if isinstance(value, list | tuple) and any(isinstance(each, list | tuple | np.ma.MaskedArray) for each in value):
        return [unmasked(each) for each in value]
    return value
