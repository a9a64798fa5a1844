"""Whether a state moves in a step: by what the model moves it at most, against the spacing of the numbers that hold it.

z + dt f rounds to z where |dt f| is less than half the distance between z and its neighbours. With M the largest |z| of
the declared range, that is half an ulp below M; with |f| <= F on the ranges, by one outward-rounded look at them, a
state stands still for certain in the binade below M where dt F is less. A state whose F is 0, and one without a range,
limit nothing.

The law of recovery counts samples. Where all that can be counted last for less than the fastest state takes for a part
of its range, what is counted does not change meanwhile, and the count means nothing.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.rigor.bounds import enclose
from hgogen.rigor.box import box
from hgogen.sentence import up

_DIGITS = {"float": 24, "double": 53}  # binary


@dataclass(eq=False)
class StepTooShort(HgogenError):
    """A step length with which a state stands still, or a count does not fit into a number: `take` is long enough, and
    `way` names what else helps."""

    dt: float
    why: str
    take: float
    unit: str
    way: str = ""

    def __str__(self) -> str:
        return f"dt = {self.dt:g} {self.unit} is too short: {self.why}; take dt >= {up(self.take, 3)}{self.way}"


def demand_motion(form: Form, dt: float, real: str) -> None:
    """Raise `StepTooShort` where a state of the form stands still for certain near the end of its range."""
    for name, (low, high), fastest in _fastest(form):
        end = max(abs(low), abs(high))
        share, power = math.frexp(end)
        half = math.ldexp(1.0, power - (share == 0.5) - _DIGITS[real] - 1)
        if dt * fastest < half:
            why = (
                f"the model moves {name} by at most {dt * fastest:.3g} in a step, and half the distance of two numbers "
                f"of type {real} below {end:g} is {half:.3g}, so that it stands still there"
            )
            way = ', real = "double",' * (real == "float") + f" or estimate {name} as the difference from a constant"
            raise StepTooShort(dt, why, half / fastest, form.system.time, way)


def demand_countable(form: Form, dt: float, most: int, part: float) -> None:
    """Raise `StepTooShort` where no state of the form moves by so large a part of its range in `most` samples."""
    times = [part * (high - low) / fastest for _, (low, high), fastest in _fastest(form)]
    if times and most * dt < min(times):
        why = f"no state moves by {part:.0%} of its range in the {most} samples that can be counted"
        raise StepTooShort(dt, why, min(times) / most, form.system.time)


@lru_cache(maxsize=16)  # asked of the counts, and of the precision
def _fastest(form: Form) -> tuple[tuple[str, tuple[float, float], float], ...]:
    """The name, the range and a bound of |z'| on the ranges of each state that has such a range and moves."""
    system = form.system
    known = box((*form.states, *system.inputs, *system.parameters), system.nominal)
    bounds = (max(abs(float(end)) for end in enclose(row, known)) for row in form.flow)
    rows = zip(form.names, form.states, bounds, strict=True)
    return tuple((name, z.interval, fastest) for name, z, fastest in rows if z.bounded and 0 < fastest < math.inf)
