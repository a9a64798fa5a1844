"""A constant gain of an observer for a wanted rate, of a small noise bound, proved in continuous time.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)

theta is only the unit of time in which K is written, by default one in which its numbers are near 1, or in which a
proof is accurate. The gain is that of `gain_search`; what is said of it is proved of its rounded numbers in rationals,
the bound of each state by a norm of its own.

b may read e_j - N_j (C e - v) in the place of e_j. With N given, all else is the convex program of `gain_search`; N is
sought from outside, in floats, near the samples in the place of what they measure (N_1 = 1/a_1), in steps that are as
large as noise moves a state. Where slopes stand at their corners one by one, N makes what is left of them smaller; with
a multiplier for each, all that N does K does as well (Arcak, Kokotovic, Automatica 37 (2001), have slopes of one sign).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from hgogen.estimators.columns import as_matrix, columns
from hgogen.form import Form
from hgogen.prove.argument import no_argument, numbers_in_place
from hgogen.prove.constant_gain import entries_of
from hgogen.prove.gain_search import Candidate, Search, Task, plain, unreached
from hgogen.prove.quadratic import Array
from hgogen.prove.questions import Bounds, bounds, named
from hgogen.reading.door import Misfit, remembers
from hgogen.reading.given import BadGain, positive
from hgogen.reading.named import Each, each_by_name, names_of
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, same

_FORM = "a form: hg.forms.triangular(plant)"
_FASTEST = 10  # times the number of states and the pace of rate and slopes
_FAR = 1e15  # a number this large, or as small, is for another unit
_FIRST, _MORE = 12, 8  # entries of N that are tried, and more for each that is sought
_NO_GAIN = 1e30  # the worth of what has none
_OWN: Any = object()  # the measure that a state's range gives


@dataclass(frozen=True)
class Gain:
    """`theta` and `K`, as the `observer` takes them that `taken` makes: K a number for each state, or
    of several outputs a matrix, a row for each state. `rate` (1/time): |e|_P falls at least like exp(-rate t), in
    continuous time without noise; `bounds`: by the name of a state of the form and of an output, how far the estimate
    of the one goes at most for noise of at most 1 of the other, in their units; of several outputs the shares add. Both
    are proved in rational arithmetic. `argument`: N as `hg.observers.circle_criterion` takes it with the others; empty
    of a gain for `hg.observers.high_gain`."""

    theta: float
    K: Annotated[tuple[Any, ...], "injection gains; null for the tuning"]
    rate: float
    bounds: Bounds
    time: str
    argument: Annotated[tuple[Any, ...], "gains N in the argument of b; empty for high_gain"] = ()

    @property
    def observer(self) -> str:
        """The observer of the package that it is for."""
        return "circle_criterion" if self.argument else "high_gain"

    @property
    def taken(self) -> dict[str, Any]:
        """What that observer takes beside the form, by name."""
        own = {"argument": self.argument} if self.argument else {}
        return {"theta": self.theta, "gains": self.K, **own}

    def bound(self, state: str, noise: Mapping[str, float]) -> float:
        """How far the estimate of a state goes at most for noise of at most these sizes, by output.

        Raises: `KeyError` for a state or an output that there is not.
        """
        return sum(self.bounds[state, output] * size for output, size in noise.items())

    def __str__(self) -> str:
        moved = [
            Sentence.of("{state} by at most {bound} for 1 of {output}", state=x, bound=Up(bound, 3), output=y)
            for (x, y), bound in self.bounds.items()
        ]
        pattern = (
            "theta = {theta}, K = {K}{N}: errors decay at least like exp(-{rate} t), t in {time}, and noise moves "
            "{moved}; in continuous time, by rational arithmetic"
        )
        argument = Sentence.of(", N = {N}", N=_numbers(self.argument)) if self.argument else ""
        theta, decay = same(self.theta), Down(self.rate, 3)
        return str(
            because(pattern, theta=theta, K=_numbers(self.K), N=argument, rate=decay, time=self.time, moved=moved)
        )


@remembers
@np.errstate(all="ignore")
def gain(
    form: Form,
    *,
    rate: float,
    noise: Each = None,
    per: Each = None,
    fastest: float | None = None,
    theta: float | None = None,
    argument: Any = None,
) -> Gain:
    """A constant gain of `observers.high_gain` for a form in chains, of a small noise bound; with an `argument` one of
    `observers.circle_criterion`.

    Args: `rate` (1/time) > 0 at which errors decay at least; `noise` how large that of each output is at most, by name,
    by default 1: what of several outputs counts is how they compare; `per` in what the error of each state of the form
    is measured, by its name, by default half of its range: the largest bound in these is made small; `fastest` (1/time)
    by how much noise alone may move the estimate in a unit of time, over how far it moves it at most: by default ten
    times n times the rate, or what the slopes ask for; `theta` > 0, by whose powers K is divided; `argument`
    for an output error in the argument of b, on a form whose a_i are numbers: True for an N that is searched, or its
    entries at theta = 1, as `circle_criterion` takes them.

    Raises: `NoGain` for a rate that is not reached; `lmi.NoSolver`; `Misfit` for no form; `BadGain` for a form without
    chains of constant gains, and for numbers that are none or not positive; `BadNames`.
    """
    if not isinstance(form, Form):
        raise Misfit("gain", form, _FORM)
    wanted, names = _moderate("rate", rate), names_of(form.system.outputs)
    each = zip(names, each_by_name("noise", noise, names, 1.0), strict=True)
    sizes = np.array([_moderate(f"noise of {name}", value) for name, value in each])
    measures, open_ = _measures(form, per), plain(form, sizes)
    if isinstance(open_, Reason):
        fix = "gains are designed on a form of the plant's own states in chains, triangular or block_triangular"
        raise BadGain(form.system.name, f"has no gain that is designed: {open_}", fix=fix)
    pace = open_.pace(wanted)
    rows = np.diag([1 / (size or natural) for size, natural in zip(measures, open_.scale(pace), strict=True)])
    quickest = _FASTEST * form.n * pace if fastest is None else _moderate("fastest", fastest)
    task = Task(open_, wanted, rows, quickest)
    if theta is None:  # the first is taken unless one of the others, from there to 1, is more accurate
        levels = tuple(float(f"{level:.2g}") for level in (task.pace, math.sqrt(task.pace), 1.0))
    else:
        levels = (_moderate("theta", theta),)
    tried = list[Candidate | None]()
    for entries in _arguments(form, task, sizes, argument):
        one = searched(form, task, sizes, entries)
        tried.append(min((replace(one, theta=level) for level in levels), key=Search.promise).best())
    best = min(filter(None, tried), key=lambda one: one.worth, default=None)
    if best is None:
        raise unreached(form, task, sizes)
    return _stated(form, best)


def _arguments(form: Form, task: Task, sizes: np.ndarray, argument: Any) -> Sequence[tuple[float, ...]]:
    """The entries of N that are tried, of one that is searched none first. Raises: `NoSolver`, `BadGain`."""
    if argument is None or argument is False:
        return ((),)
    moving = because("its {a} moves in a range", a=form.gain_names[0][0]) if task.open.D.any() else NONE
    if why := no_argument(form) or moving:
        raise BadGain("argument", f"is not designed for {form.system.name}: {why}; leave it out")
    if argument is True:
        return (), least_noise(form, task, sizes)
    entries = entries_of("argument", argument, form)
    return (entries if any(entries) else (),)


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
        return one.worth if one else _NO_GAIN

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


def _measures(form: Form, per: Any) -> list[float]:
    """In what the error of each state is measured; 0 where neither it nor a range says.

    Raises: `BadNames`, `BadGain`.
    """
    each = each_by_name("per", per, form.names, _OWN)
    halves = ((z.high - z.low) / 2 if z.low is not None and z.high is not None else 0.0 for z in form.states)
    return [
        float(half) if value is _OWN else _moderate(f"per of {name}", value)
        for name, value, half in zip(form.names, each, halves, strict=True)
    ]


def _moderate(what: str, value: Any) -> float:
    """A positive number. Raises: `BadGain`."""
    size = positive(what, value)
    if not 1 / _FAR <= size <= _FAR:
        raise BadGain(f"{what} = {size:g}", f"must be from {1 / _FAR:g} to {_FAR:g}; take other units")
    return size


def _stated(form: Form, best: Candidate) -> Gain:
    fastest = max(filter(None, (best.flow.fastest, best.falls)), key=lambda one: one.alpha)
    known = bounds(best.flow, fastest)
    if isinstance(known, Reason):
        raise BadGain(form.system.name, f"has a gain whose noise is not bounded: {known}")
    one = len(form.blocks) == 1
    K: tuple[Any, ...] = tuple(k for (k,) in best.K) if one else best.K
    N: tuple[Any, ...] = best.argument
    if N and not one:
        N = tuple(map(tuple, as_matrix(form, N).tolist()))
    return Gain(float(best.flow.theta), K, fastest.rate, named(form, known), form.system.time, N)


def _numbers(K: Any) -> str:
    """A gain as text that reads back as the same."""
    return f"({', '.join(map(_numbers, K))})" if isinstance(K, tuple) else same(K)
