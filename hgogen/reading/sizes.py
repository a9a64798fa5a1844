"""Sizes as a user gives them: each by the name of a signal, at most so much of what enters a step."""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from hgogen.reading.given import BadGain, real
from hgogen.reading.named import BadNames, in_order

Each = Mapping[str, float] | None


def sizes(what: str, values: Each, names: Sequence[str], default: float = 0.0) -> list[Fraction]:
    """A size for each name, the default where none is given. Raises: `BadNames`, `BadGain`."""
    each = by_name(what, values, names, default)
    return [size(f"{what} of {name}", value) for name, value in zip(names, each, strict=True)]


def by_name(what: str, values: Each, names: Sequence[str], default: Any) -> list[Any]:
    """What is given for each name, or the default. Raises: `BadNames`."""
    if not isinstance(values, Mapping | None):
        raise BadNames(what, f"= {values!r} is no mapping from names to numbers")
    return list(in_order(what, values or {}, names, default=dict.fromkeys(names, default)))


def size(what: str, value: Any) -> Fraction:
    """A finite number, not negative. Raises: `BadGain` for anything else."""
    number = real(what, value)
    if isinstance(value, bool) or not 0 <= number < math.inf:
        raise BadGain(f"{what} = {value if isinstance(value, bool) else f'{number:g}'}", _FIX)
    return Fraction(number)


_FIX = "must be a finite number, not negative"
