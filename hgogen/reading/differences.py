"""Derivatives of inputs, which a form reads and few logs hold: differences from sample to sample.

    u'(k) = (u(k) - u(k - 1))/dt,   u''(k) = (u'(k) - u'(k - 1))/dt,   ..

which firmware can compute, and the slope of the line that reaches the sample. The first difference stands for those
before it.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from hgogen.signal import Signal

HIGHEST = 60  # order of a derivative: a form reads fewer than it has states


def derived(inputs: Sequence[Signal]) -> dict[str, tuple[str, int]]:
    """Of each input that is the derivative of another one by its name: that one's name, and the order. Of two inputs
    whose derivatives have one name, as u and u_, it is the one of which the signal is the derivative; of u_dot that is
    an input too, and has a derivative, it is u of which both are."""
    names, rates = {u.name: u for u in inputs}, dict[str, tuple[str, int]]()
    for u, k in product(inputs if len(inputs) > 1 else (), range(1, HIGHEST + 1)):
        rate = u.derivative(k)
        if rate.name in names and (rate.name not in rates or rate == names[rate.name]):
            rates[rate.name] = (u.name, k)

    def root(name: str, order: int) -> tuple[str, int]:
        source, more = rates.get(name, ("", 0))
        return root(source, order + more) if source else (name, order)

    return {name: root(*of) for name, of in rates.items()}


def said_of(rates: Mapping[str, tuple[str, int]]) -> tuple[str, ...]:
    """What is said of derivatives that no log holds, by name: of which input, and the order."""
    return tuple(
        f"{name} is taken as differences of {source} from sample to sample: no column gives it"
        for name, (source, _) in rates.items()
    )


def difference(values: np.ndarray, order: int, dt: float) -> np.ndarray:
    """Of a column (N,), NaN where one of its samples is missing, or none is there."""
    if len(values) <= order:
        return np.full(len(values), np.nan)
    rates = np.diff(values, order) / dt**order
    return np.concatenate([np.repeat(rates[:1], order), rates])
