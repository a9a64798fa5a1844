"""The Riccati observer on P = L D L' as straight-line code or as loops, whichever suits what the step is made for.

For speed straight-line code, which carries out fewer operations and steers no loops, as long as its text does not
become too long; for flash the shorter text. Both are counted, not measured: see `discretisation.counting`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from hgogen.discretisation.counting import carried_out, written
from hgogen.kalman.factored import unrolled
from hgogen.kalman.looped import admits, looped
from hgogen.kalman.riccati_part import Riccati
from hgogen.part import Clock, Pieces

LONGER = {"speed": 1450, "flash": 0}  # operations that straight-line code may be longer than loops; one is some 6 bytes
FULL = 7  # states up to which a full matrix Q or P(0) is taken, which loops do not admit
LARGE = 12  # states beyond which straight-line code is too long in any case, and takes long to make


@dataclass(frozen=True)
class _Way:
    """One of the two programs."""

    name: str
    pieces: Pieces

    @cached_property
    def longest(self) -> int:
        """How many operations its longest section holds."""
        return max(map(written, (self.pieces.predict, *self.pieces.update)))

    def __str__(self) -> str:
        sections = (self.pieces.predict, *self.pieces.update)
        times = sum(carried_out(section).total() for section in sections)
        return f"in {self.name} {self.longest} operations in its longest section, {times} in a period"


def chosen(part: Riccati, clock: Clock) -> Pieces:
    """The pieces of the shorter program, or of the faster one if it is not too long, with a sentence on the choice.
    Where straight-line code is short, loops are not made to be counted."""
    n = part.dynamics.n
    if n <= FULL and not admits(part):
        return replace(unrolled(part, clock), choice="the covariance in straight-line code, as for full matrices")
    if n > LARGE:
        choice = f"the covariance in loops, as for more than {LARGE} states in any case"
        return replace(looped(part, clock), choice=choice)
    straight = _Way("straight-line code", unrolled(part, clock))
    if straight.longest <= LONGER[clock.prefer]:
        return replace(straight.pieces, choice=f"the covariance {straight}, too few for loops to be shorter by enough")
    loops = _Way("loops", looped(part, clock))
    longer = straight.longest - loops.longest > LONGER[clock.prefer]
    taken, other = (loops, straight) if longer else (straight, loops)
    return replace(taken.pieces, choice=f"the covariance {taken}; {other}")
