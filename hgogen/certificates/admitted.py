"""Up to which dt a step is certified, advised and admitted, the certified first."""

from dataclasses import dataclass
from fractions import Fraction

from hgogen.certificates.contraction import Contraction
from hgogen.intervals.digits import Down
from hgogen.program import INF
from hgogen.sentence import Sentence
from hgogen.step import Step


@dataclass(frozen=True)
class Admitted:
    """The step's own `dt`, in the unit of the model's `time`, as the others; `certified`: the largest at which its
    error is proved to contract, `throughout`: whether at every one up to it; `advised`: up to which nothing was seen to
    fail at points of the box; `refused`: above which there is no step. None where there is no such dt."""

    dt: float
    time: str
    certified: float | None
    throughout: bool
    advised: float | None
    refused: float | None

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
