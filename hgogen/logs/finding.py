"""A fault of a log: what, where, how strong, and what mends it."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.sentence import Encoded

MOST = 20  # stretches of a finding


@dataclass(frozen=True)
class Finding(Encoded):
    """A fault of a log."""

    signal: Annotated[str, "the signal, several with commas, or the column of times"]
    fault: Annotated[str, "what is wrong with it, by one word"]
    rows: Annotated[
        tuple[tuple[int, int], ...],
        "first and last sample, of times row of the file, of each stretch, the longest first; 20 at most",
    ]
    count: Annotated[int, "samples concerned"]
    strength: Annotated[float, "its measure over the limit, above 1"]
    finding: Annotated[str, "a sentence"]
    fix: Annotated[str, "what mends it"]

    def __str__(self) -> str:
        return f"{self.finding}: {self.fix}"


def longest(first: np.ndarray, last: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the stretches of samples from `first` to `last` (k), the longest first, 20 at most."""
    order = np.argsort(first - last, kind="stable")[:MOST]
    return tuple((int(first[k]), int(last[k])) for k in order)


def stretches_of(places: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Return the stretches (first, last) of consecutive numbers in ascending `places` (k), the longest first, 20 at
    most."""
    ends = np.flatnonzero(np.diff(places) > 1)
    return longest(places[np.append(0, ends + 1)], places[np.append(ends, len(places) - 1)]) if len(places) else ()
