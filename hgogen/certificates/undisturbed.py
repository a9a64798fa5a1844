"""Whether samples are used and the estimate is left alone, while its error is within its bounds.

No proof of a step speaks of a sample that is rejected, or of an estimate that restarts from one as it seems to be lost
(`stepping.recovery`): by noise above a tenth of what an output can span that may be, however small the error.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

import sympy as sp

from hgogen.certificates.start_set import Running
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import box
from hgogen.step import Step
from hgogen.stepping.guards import readings
from hgogen.stepping.recovery import MARGIN, SHARE

_CLOSE = 1 - Fraction(1, 10**9)  # of a limit, which a program compares in floats


def room(running: Running, samples: Sequence[Fraction], totals: Mapping[int, Fraction]) -> dict[int, Fraction] | None:
    """By field, what an error may be beside its bound of the `totals` for no guard to act; None where one may act with
    no more than these. `samples` (p): by how much a sample may err."""
    form, layout = running.step.observer.form, running.steps.error.layout
    where = box((*form.states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    for y, (low, high), size in zip(form.output, readings(form), samples, strict=True):
        known, width = bound(sp.sympify(y), where), high - low
        taken = known.low - size >= low - width and known.high + size <= high + width
        if not taken:
            return None
    left = dict[int, Fraction]()
    for state, most in _limits(running, samples):
        k = layout.picks[state]
        left[k] = min(most * _CLOSE - totals[k], left.get(k, most))
    return left if all(x > 0 for x in left.values()) else None


def patient(step: Step) -> int:
    """How many calls a sign that the estimate is lost may show for before it restarts."""
    return min((math.floor(sign.time / step.dt * (1 - 1e-9)) for sign in step.code.signs), default=0)


def _limits(running: Running, samples: Sequence[Fraction]) -> Iterator[tuple[int, Fraction]]:
    """States, by place, and up to which error no sign of the estimate being lost shows."""
    form, shown, inside = running.step.observer.form, running.shown, running.plant.margins
    spans = [high - low for low, high in readings(form)]
    for sign in running.step.code.signs:
        if sign.output is not None:
            if sign.output not in shown:  # what else it shows is not followed
                yield 0, Fraction(0)
                continue
            head, slope = shown[sign.output]
            yield head, (Fraction(SHARE * spans[sign.output]) - samples[sign.output]) / abs(slope)
            continue
        own = all(row.is_Symbol or (-row).is_Symbol for row in form.from_form)
        for i, (state, clear) in enumerate(zip(form.states, inside, strict=True)):
            low, high = map(Fraction, state.interval)
            yield i, clear + Fraction(MARGIN) * (high - low) if own else Fraction(0)
