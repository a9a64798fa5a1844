"""Where the entries of a gain stand, a matrix of a row for each state and a column for each chain's output.

    z' = A z + b(z, u) + K_theta (y - C z),   K_theta = theta^(p(i) - p(k) + 1) K_ik

p(i) is the power of theta that scales the state of row i, p(k) that of the first state of chain k (`scaling`): the
power is j in row j of a chain of the same alignment at the top, and what the gain does to an error in scaled
coordinates grows like theta, whatever chain it comes from.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hgogen.analysis.scaling import exponents
from hgogen.form import Form


@dataclass(frozen=True)
class Column:
    """The place of an entry: its `row` (0..n-1) and its `chain` (0..q-1), with the `power` of theta that scales it, and
    its `index` in print: (j), (i, j), or (i, j, k), of the row j of chain i and the output of chain k."""

    row: int
    chain: int
    power: int
    index: tuple[int, ...]


def columns(form: Form, count: int) -> tuple[Column, ...]:
    """The places of `count` entries: n of them act each on the output of its own chain, n q each row on all, row by
    row."""
    powers, heads = exponents(form), [form.heads[k] for k in form.leads]
    rows = [(i, j) for i, size in enumerate(form.blocks[k] for k in form.leads) for j in range(size)]
    own, several = count == form.n, len(heads) > 1
    places = []
    for row, (i, j) in enumerate(rows):
        for k in (i,) if own else range(len(heads)):
            power = j + 1 + powers[heads[i]] - powers[heads[k]]
            places.append(Column(row, k, power, (i + 1, j + 1, k + 1)[not several : 2 + (not own)]))
    return tuple(places)


def as_matrix(form: Form, entries: Sequence[Any]) -> np.ndarray:
    """The entries as a matrix (n, q), of objects, 0 where there is none."""
    K = np.zeros((form.n, len(form.leads)), dtype=object)
    for place, value in zip(columns(form, len(entries)), entries, strict=True):
        K[place.row, place.chain] = value
    return K
