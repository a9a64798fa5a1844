"""Up to which dt a step is certified, advised and admitted, the certified first."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

from hgogen.certificates.contraction import Contraction
from hgogen.intervals.digits import Down
from hgogen.program import INF
from hgogen.sentence import Sentence
from hgogen.step import Step


@dataclass(frozen=True)
class Admitted:
    """Limits of a step's dt."""

    dt: Annotated[float, "the step's own dt"]
    time: Annotated[str, "unit of time"]
    certified: Annotated[float | None, "largest dt at which its error is proved to contract; null: none"]
    throughout: Annotated[bool, "whether that holds at every dt up to it"]
    advised: Annotated[float | None, "dt up to which nothing was seen to fail at points of the box; null: none"]
    refused: Annotated[float | None, "dt above which there is no step; null: none"]

    @property
    def sentence(self) -> Sentence:
        """The limits in their order; of what is advised only where it goes beyond what is certified."""
        limits = []
        if self.certified is None:
            limits.append(Sentence.of("certified at none"))
        else:
            pattern = "certified up to {most}" if self.throughout else "certified at {most}"
            typed = Fraction(repr(self.certified))  # as it is typed: 0.147, which no float is
            limits.append(Sentence.of(pattern, most=Down(typed, 3)))
        if self.advised is not None and not (self.throughout and self.advised <= (self.certified or 0)):
            limits.append(Sentence.of("tried without failure up to {most}", most=Down(self.advised, 3)))
        if self.refused is not None:
            limits.append(Sentence.of("refused above {most}", most=Down(self.refused, 3)))
        return Sentence.of("dt = {dt} {time}: {limits:; }", dt=self.dt, time=self.time, limits=tuple(limits))


def admitted(step: Step, known: Contraction) -> Admitted:
    """The limits of a step's dt, of what is known of its contraction."""
    far = known.reach
    certified = float(far.longest) if far.longest else step.dt if known.proved else None
    advised, refused = (None if most == INF else most for most in (step.advised, step.limit))
    return Admitted(step.dt, step.time, certified, bool(far.pieces), advised, refused)
