"""What enters the error of a step from outside, and how large it is at most.

samples     an error of an output's samples at both ends of a call, each by itself, with those on the line between
stages      an error of what is injected at a stage
beside      what the plant does in a row of its form beside a step of the method, over h; its sample at the end of
            the call shows it
fields      what comes to a field of the estimator itself, over h
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.polytope import fixed
from hgogen.analysis.spare import heads
from hgogen.form import Form
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.inequality import Inequality, Inputs
from hgogen.prove.quadratic import identity, rational
from hgogen.prove.questions import InputBound
from hgogen.rigor.points import exact

_NOTHING = Fraction(0)
ENTERING = ("noise", "rounded", "late", "disturbance", "parameters", "rates")  # of which a user says how large they are


Heads = Mapping[int, tuple[int, Fraction]]  # by an output's place, that of the state that it shows, and dy/dz


def heads_of(form: Form) -> Heads | None:
    """What outputs show of the first states of chains; None where a slope is no number."""
    known, slopes = dict(fixed(form)), dict[int, tuple[int, Any]]()
    for j, head in heads(form).items():
        row = exact(sp.sympify(form.output[j]).xreplace(known))
        slopes[j] = head, sp.cancel(sp.diff(row, form.states[head]))
    if not all(slope.is_Rational for _, slope in slopes.values()):
        return None
    return {j: (head, Fraction(slope.p, slope.q)) for j, (head, slope) in slopes.items()}


@dataclass(frozen=True)
class Sizes:
    """Of the `samples` (p), of the `stages` (p, s), `beside` (n) in units of the form's states, and of the `fields` (N)
    as e has them; empty of none."""

    samples: tuple[Fraction, ...] = ()
    stages: tuple[tuple[Fraction, ...], ...] = ()
    beside: tuple[Fraction, ...] = ()
    fields: tuple[Fraction, ...] = ()

    @property
    def largest(self) -> Fraction:
        """The largest of all, whatever their units."""
        stages = (x for row in self.stages for x in row)
        return max((*self.samples, *stages, *self.beside, *self.fields), default=_NOTHING)

    def over(self, size: Fraction) -> "Sizes":
        """In units of a size > 0."""
        rows = tuple(tuple(x / size for x in row) for row in self.stages)
        samples, beside, fields = (tuple(x / size for x in each) for each in (self.samples, self.beside, self.fields))
        return Sizes(samples, rows, beside, fields)

    def inputs(self, step: Inequality, error: Inclusion, scales: Sequence[Fraction], shown: Heads) -> Inputs:
        """The inputs of a step that are not 0; `scales` (N) as `Inclusion.scales` gives them."""
        each = list[Inputs]()
        for output, size in enumerate(self.samples):
            each += [end * size for end in step.ends(output) if size]
        for output, row in enumerate(self.stages):
            each += [step.stages[i][output] * size for i, size in enumerate(row) if size]
        for state, size in enumerate(self.beside):
            fields = zip(scales, error.layout.index, error.layout.fed, strict=True)
            moved = step.beside(rational([-scale * (fed and i == state) for scale, i, fed in fields]))
            for output, (head, slope) in shown.items():
                moved += step.ends(output)[1] * (step.h * slope * (head == state))
            each += [moved * size] if size else []
        one = identity(len(scales))
        each += [step.beside(one[k]) * size for k, size in enumerate(self.fields) if size]
        return Inputs.of(each)


@dataclass(frozen=True)
class Entering:
    """The `sizes` of what enters, and of what they follow, as a certificate has it."""

    sizes: Sizes
    follows: Evidence


@dataclass(frozen=True)
class Share:
    """What some inputs of these `sizes` do, by name: by the `proofs` of their sizes over `unit`, by field. `follows`:
    of what the sizes follow, numbers that a user says and suprema on the ranges; empty where that is not written."""

    what: str
    sizes: Sizes
    unit: Fraction
    proofs: Mapping[int, InputBound]
    follows: Evidence = field(default_factory=dict)

    def bound(self, field: int) -> Fraction:
        """How far they move the error for which a field stands."""
        return self.unit * self.proofs[field].bound

    @property
    def written(self) -> Evidence:
        """As a certificate has it."""
        bounds = [{"field": k + 1, **one.written, "bound": self.bound(k)} for k, one in self.proofs.items()]
        return {"inputs": self.what, "follows": self.follows, **vars(self.sizes), "unit": self.unit, "bounds": bounds}
