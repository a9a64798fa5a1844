"""A quadratic form in floats, whose multiplied columns that enter along one direction are made one.

Columns p_j that enter as r_j u, and nowhere else, leave of sum_j S_j p_j^2 its least for a u = sum_j r_j p_j, which is
T u^2 with the largest T that

    diag(S) - T r r' >= 0

admits. The form of (e, u), with T in its place, is negative where that of (e, p) is: slopes of one row of b, which all
push in one direction, are one column of it, and a solver's work falls with the fourth power of its size and faster.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hgogen.guarantees.quadratic import Array, Quadratic

_ALIKE = 1e-9  # by how much directions of length 1 may differ


@dataclass(frozen=True)
class Group:
    """The multipliers of these `places`, that push in one direction, each by its `weights` r, the largest 1; `column`:
    where they stand in the form."""

    places: tuple[int, ...]
    weights: tuple[float, ...]
    column: int


@dataclass(frozen=True, eq=False)
class Merged:
    """The `form`, in which multipliers of the `groups` have no Z."""

    form: Quadratic
    groups: tuple[Group, ...]


def merged(form: Quadratic) -> Merged:
    """The form of floats with as few columns as it takes: what decays comes first, then one for each direction."""
    n, each = len(form.pairs[0][0]), tuple(_alike(form))
    T, Z = np.zeros((form.size, n + len(each))), np.zeros((len(form.Z), n + len(each)))
    T[:n, :n] = np.eye(n)
    for at, places in enumerate(each, n):
        T[n + places[0], at] = 1.0  # the largest, by which the others are measured
        if len(places) == 1:
            Z[places[0], at] = 1.0
    pairs = tuple((X @ T, Y @ T) for X, Y in form.pairs)
    columns, groups = _columns(form), list[Group]()
    for at, places in enumerate(each, n):
        if len(places) > 1:
            first = columns[:, places[0]]
            weights = tuple(float(columns[:, k] @ first / (first @ first)) for k in places)
            groups.append(Group(tuple(places), weights, at))
    return Merged(Quadratic(pairs, form.Q @ T, Z), tuple(groups))


def _columns(form: Quadratic) -> Array:
    """What a multiplied column brings anywhere: (rows, k)."""
    n = len(form.pairs[0][0])
    return np.vstack([part for pair in form.pairs for part in pair] + [form.Q])[:, n:]


def _alike(form: Quadratic) -> Iterator[list[int]]:
    """The multipliers by direction, of each the one that enters most first."""
    columns, left = _columns(form), list(range(len(form.Q)))
    lengths = np.linalg.norm(columns, axis=0)
    while left:
        first = max(left, key=lengths.__getitem__)
        places = [k for k in left if k == first or _along(columns, lengths, first, k)]
        places.sort(key=lambda k: -lengths[k])
        yield places
        left = [k for k in left if k not in places]


def _along(columns: Array, lengths: Array, first: int, other: int) -> bool:
    """Whether two columns are one but for a factor."""
    if not lengths[other]:
        return False
    cosine = columns[:, first] @ columns[:, other] / lengths[first] / lengths[other]
    unit = columns[:, other] / lengths[other] * np.sign(cosine)
    return bool(np.abs(columns[:, first] / lengths[first] - unit).max() < _ALIKE)
