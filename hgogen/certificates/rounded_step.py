"""How far one call of a step's program is from exact arithmetic, on a set of states, samples and inputs.

What a step remembers, samples and inputs are numbers of the working precision, the same in both; gains, parameters,
constants and what `tune` computes of them are rounded.
"""

from collections.abc import Sequence
from typing import Any

from hgogen.certificates.one_call import after_call
from hgogen.intervals.computed import Real, Rounding, exactly
from hgogen.step import Step


def rounding_errors(step: Step, real: Real, held: Sequence[Any], y: Sequence[Any], u: Sequence[Any]) -> list[Any]:
    """By element of the observer's fields (N), how far a call leaves it from what exact arithmetic makes of the same:
    of fields in the balls `held` (N), samples in `y` (p), now and at the last call, and inputs in `u` (m).

    Raises: `Unsure`.
    """
    fields, samples, inputs = (list(map(exactly, each)) for each in (held, y, u))
    return [each.error for each in after_call(Rounding(real), step, fields, [samples] * 2, [inputs] * 2)]
