"""What is proved of a step as it runs, as numbers that stand with its code, for whoever signs them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from hgogen.sentence import NONE, Reason

Each = Mapping[str, float]


@dataclass(frozen=True)
class Signed:
    """How far the estimate of a step errs at most, and under what.

    `bounds`: by the name of a state; within 1.1 of it is its error from `settles` (the model's unit of time) on, of
    first errors of at most `begins`, by the name of a state of the form; `everywhere`: whether these are all that the
    ranges allow. None, and empty, where nothing is known of starts, and `unsettled` says why. `assumed`: by what enters
    ("noise" and the like) and by the name of a signal, how large it is at most; `real`: the precision in which what the
    program rounds is counted, None where it is not; `inside`: by how much the plant keeps clear of the ends of its
    ranges; `beyond`: the states of which no bound within the width of their range is proved. `least`: from which
    constant theta up to its own the error decays without what enters, and `longest`: at which dt up to that one, of its
    own theta; None where that is not proved. Without `bounds` none is proved.
    """

    bounds: Each = field(default_factory=dict)
    settles: float | None = None
    unsettled: Reason = NONE
    begins: Each = field(default_factory=dict)
    everywhere: bool = False
    assumed: Mapping[str, Each] = field(default_factory=dict)
    real: str | None = None
    inside: Each = field(default_factory=dict)
    beyond: tuple[str, ...] = ()
    least: Fraction | None = None
    longest: Fraction | None = None
