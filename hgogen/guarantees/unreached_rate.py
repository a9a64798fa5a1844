"""Why a rate is not reached by any gain: how far one gets, and the slope that stands in the way most."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction

from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.gain_search import Task
from hgogen.guarantees.inclusion import with_gains
from hgogen.guarantees.quadratic import Array
from hgogen.guarantees.rate_search import plain
from hgogen.intervals.digits import Down
from hgogen.sentence import Reason, because

_BACK, _STEPS = 12, 5  # halvings of the rate; steps from it to the one that is reached
_NOISY = 0.5  # the share of a rate with which noise is bounded


@dataclass(eq=False)
class NoGain(HgogenError):
    """No gain is found with which errors decay at the wanted `rate`. `reached`: the largest of the smaller rates tried
    at which one is, 0.0 where none is; `hindrance`: what stands in the way."""

    plant: str
    rate: float
    reached: float
    hindrance: Reason

    def __str__(self) -> str:
        most = "nor at any smaller one that is tried"
        if self.reached:
            most = str(because("at {reached} there is one", reached=Down(self.reached, 2)))
        what = f"no gain is found with which errors of {self.plant} decay at rate = {self.rate:g}"
        return f"{what}; {most}; {self.hindrance}"


def unreached(form: Form, task: Task, sizes: Array) -> NoGain:
    """What is said of a task, under noise of these `sizes` (p), for which there is no gain: the slope that is named is
    that in half of whose range more is reached than in that of any other.

    Raises: `NoSolver`.
    """
    error = with_gains(form, [Fraction(0)] * form.n)
    slopes = () if isinstance(error, Nothing) else error.slopes
    reached = _reached(task, (task.rate / 2**k for k in range(1, _BACK)))
    step = (task.rate / reached) ** (1 / _STEPS) if reached else 2.0
    rates = [task.rate / step**k for k in range(_STEPS if reached else _BACK)]
    narrower = {}
    for k, slope in enumerate(slopes):
        open_ = plain(form, sizes, k)
        if slope.low < slope.high and not isinstance(open_, Reason):
            narrower[k] = _reached(replace(task, open=open_), rates)
    best = max(narrower, key=narrower.__getitem__, default=None)
    if best is None or narrower[best] <= reached:
        return NoGain(form.system.name, task.rate, reached, because("no slope hinders, but the solver gets no further"))
    slope = slopes[best]
    if slope.entry is None:
        called = [name for chain in form.gain_names for name in chain][slope.reads.index(1)]
    else:
        i, j = slope.entry
        called = f"db_{i + 1}/d{form.states[j]}"
    low, high = float(slope.low), float(slope.high)
    pattern = "{slope} in [{low:.3g}, {high:.3g}] hinders most: in half of that {more} is reached"
    more = Down(narrower[best], 2)
    why = because(pattern, slope=called, low=low, high=high, more=more)
    return NoGain(form.system.name, task.rate, reached, why)


def _reached(task: Task, rates: Iterable[float]) -> float:
    """The first of these rates at which one norm has a gain; 0.0 where none has."""
    return next((rate for rate in rates if task.gain(rate, rate * _NOISY) is not None), 0.0)
