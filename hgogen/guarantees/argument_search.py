"""The gain N into the argument of b with which a designed gain has a small noise bound, in floats.

b reads e_j - N_j (C e - v) in the place of e_j. With N given, all else is the convex program of `gain_search`; N is
sought from outside, near the samples in the place of what they measure (N_1 = 1/a_1), in steps that are as large as
noise moves a state. Where slopes stand at their corners one by one, N makes what is left of them smaller; with a
multiplier for each, all that N does K does as well (Arcak, Kokotovic, Automatica 37 (2001), have slopes of one sign).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hgogen.chains.columns import columns
from hgogen.form import Form
from hgogen.guarantees.argument import numbers_in_place
from hgogen.guarantees.gain_search import Task
from hgogen.guarantees.quadratic import Array
from hgogen.guarantees.rate_search import Search, plain
from hgogen.sentence import Reason

_FIRST, _MORE = 12, 8  # gains that are tried, and for each entry of N
_FAR = 1e30  # for what has no gain


def least_noise(form: Form, task: Task, sizes: Array) -> tuple[float, ...]:
    """The entries of N (n, or n q: `columns`), none where b reads no error; `task` without it.

    Raises: `NoSolver`.
    """
    start = np.array(numbers_in_place(form))
    places, reads = columns(form, len(start)), np.abs(task.open.H).sum(axis=0)
    free = [k for k, at in enumerate(places) if reads[at.row]]
    steps = task.open.scale(task.pace)[[places[k].row for k in free]]

    def entries(x: Array) -> tuple[float, ...]:
        values = start.copy()
        values[free] += x * steps
        return tuple(map(float, values))

    def worth(x: Array) -> float:
        one = searched(form, task, sizes, entries(x)).middle()
        return one.worth if one else _FAR

    if not free:
        return ()

    from scipy.optimize import minimize  # which the solver needs as well

    simplex = np.vstack([np.zeros(len(free)), np.eye(len(free))])
    most = {"maxfev": _FIRST + _MORE * len(free), "initial_simplex": simplex}
    return entries(minimize(worth, simplex[0], method="Nelder-Mead", options=most).x)


def searched(form: Form, task: Task, sizes: Array, argument: Sequence[float]) -> Search:
    """The search with these entries of N, whose task is that of the error with them, written at theta = 1."""
    open_ = plain(form, sizes, argument=argument)
    assert not isinstance(open_, Reason)
    return Search(form, replace(task, open=open_), sizes, 1.0, tuple(argument))
