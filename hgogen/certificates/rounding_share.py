"""The share that rounding has in an error: its sizes on the states that the other shares and the start leave.

What rounding does depends on how large the numbers are, these on the error, and the error on rounding. So with r times
a bound R of what it does at first

    rho(plant's ranges + start + the other shares + r R) <= r rho_1   shows by induction that it does no more than r R,

and later, when the start has decayed, it does less: |e|_P^2 - 1 falls to 1 - alpha h of itself at each call.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import sympy as sp
from flint import arb

from hgogen.algebra.definite import fraction, number, root
from hgogen.certificates.rounded_step import rounding_errors
from hgogen.certificates.start_set import Start
from hgogen.guarantees.confined import reached
from hgogen.guarantees.contracting import Contracts, Steps
from hgogen.guarantees.entering import Heads, Sizes
from hgogen.guarantees.inclusion import of_state
from hgogen.guarantees.plant_step import Unbounded
from hgogen.guarantees.quadratic import extent, rational
from hgogen.guarantees.step_evidence import Share
from hgogen.guarantees.under_inputs import InputBound, of_step
from hgogen.intervals.bounds import bound
from hgogen.intervals.box import box
from hgogen.intervals.computed import Real, Unsure
from hgogen.sentence import because
from hgogen.step import Step
from hgogen.structure.polytope import signals

CLOSE = Fraction(1, 20)  # of a bound: what is left of the start, and of rounding, when it is said to have settled
_ROOM = Fraction(11, 10)  # of the other shares, with what is left of the start
_ROUNDS = 40
_GROWTH = Fraction(11, 10)  # of r, from round to round
_UP = 1 + 1e-9  # of a count of calls, for what its floats may be off
Sized = Mapping[int, Fraction]  # by field, in the unit of its state of the form


@dataclass(frozen=True)
class Rounding:
    """The `share` in the end; `early`: how far rounding moves the error of each field at first, at most; `calls`: after
    which it does no more than 1 + `CLOSE` of its share, once no more is left of the start than `left`."""

    share: Share
    early: Sized
    left: Sized
    calls: int


def rounding_share(
    step: Step,
    real: Real,
    steps: Steps,
    proof: Contracts,
    shares: Sequence[Share],
    start: Start,
    multiple: Fraction,
    samples: Sequence[Fraction],
    shown: Heads,
) -> Rounding:
    """The share of a program in a working precision, beside the others, from first errors of `multiple` times what the
    ranges allow, of samples that err by at most `samples` (p).

    Raises: `Unbounded`, `NoSolver`.
    """
    every = range(len(start.scales))
    parts = [_of_share(share.unit, share.proofs, start.scales) for share in shares]
    others = {k: sum((part[k] for part in parts), Fraction(0)) for k in every}
    begins = reached(rational(proof.weights.P), start.corners, {k: of_state(start.scales, k) for k in every})
    sizes = _Sizing(step, real, steps, start, samples)
    first = sizes.beside({k: others[k] * _ROOM for k in every})
    proofs, relative = dict[int, InputBound](), first.over(first.largest)
    inputs = relative.inputs(steps.at(proof.h), steps.error, start.scales, shown)
    for k in (k for k, fed in enumerate(steps.error.layout.fed) if fed):
        one = of_step(steps, proof.h, inputs, of_state(start.scales, k), proof.alpha)
        if one is None:
            raise Unbounded(because("no bound is found of what rounding does"))
        proofs[k] = one
    bounds = _of_share(first.largest, proofs, start.scales)

    def times(r: Fraction, beside: Callable[[int], Fraction]) -> Fraction:
        """How many times as much as at first is rounded, where rounding moves the error by r times its bounds."""
        moved = sizes.beside({k: beside(k) + r * bounds[k] for k in every})
        return max(more / less for more, less in zip(moved.fields, first.fields, strict=True))

    taken = min(multiple, Fraction(1))
    most = _kept_to(lambda r: times(r, lambda k: others[k] + taken * begins[k]))
    last = max(Fraction(1), times(most, lambda k: _ROOM * others[k] + CLOSE * most * bounds[k]))
    share = Share("rounding", Sizes(fields=tuple(size * last for size in first.fields)), first.largest * last, proofs)
    falls, ratio = min(one.alpha for one in proofs.values()) * proof.h, most / last
    early, left = ({k: more * bounds[k] + less * others[k] for k in every} for more, less in ((most, 0), (last, 1)))
    return Rounding(share, early, {k: CLOSE * each for k, each in left.items()}, _calls(float(ratio), float(falls)))


def _kept_to(times: Callable[[Fraction], Fraction]) -> Fraction:
    """An r with times(r) <= r. Raises: `Unbounded`."""
    r = Fraction(1)
    for _ in range(_ROUNDS):
        needed = times(r)
        if needed <= r:
            return r
        r = needed * _GROWTH
    raise Unbounded(because("what rounding does has no bound: the more it moves the estimate, the more is rounded"))


def _calls(ratio: float, falls: float) -> int:
    """The calls after which |e|_P, at most `ratio` at first, is at most 1 + `CLOSE`, where |e|_P^2 - 1 `falls`."""
    left = float((1 + CLOSE) ** 2 - 1)
    return max(0, math.ceil(math.log(max(1.0, (ratio**2 - 1) / left)) / -math.log1p(-falls) * _UP))


def _of_share(unit: Fraction, proofs: Mapping[int, InputBound], scales: Sequence[Fraction]) -> dict[int, Fraction]:
    """By field, how far inputs in a unit move its error: by its own proof, of one without by the least that others
    say."""
    P = [rational(one.weights.P) for one in proofs.values()]
    rows = {k: of_state(scales, k) for k in range(len(scales)) if k not in proofs}
    beside = {k: min(root(extent(each, c)) for each in P) for k, c in rows.items()}
    return {k: unit * (proofs[k].bound if k in proofs else beside[k]) for k in range(len(scales))}


@dataclass(frozen=True)
class _Sizing:
    """How much a call rounds on the plant's ranges, with errors of its fields beside."""

    step: Step
    real: Real
    steps: Steps
    start: Start
    samples: Sequence[Fraction]

    def beside(self, errors: Sized) -> Sizes:
        """Raises: `Unbounded`."""
        form, layout = self.step.observer.form, self.steps.error.layout
        held = []
        for k, (i, fed, e) in enumerate(zip(layout.index, layout.fed, self._remembered, strict=True)):
            low, high = map(Fraction, form.states[i].interval) if fed else (Fraction(0), Fraction(0))
            product = self.start.scales[k] / e
            held.append(_ball(product * (low - errors[k]), product * (high + errors[k])))
        try:
            rounded = rounding_errors(self.step, self.real, held, *self._signals)
        except Unsure as error:
            raise Unbounded(because("how far rounding goes is not known: {what}", what=error.args[0])) from error
        sizes = (_above(rho) * e / Fraction(self.step.dt) for rho, e in zip(rounded, self._remembered, strict=True))
        return Sizes(fields=tuple(sizes))

    @cached_property
    def _remembered(self) -> Sequence[Fraction]:
        known = self.steps.error.remembered(self.steps.theta)
        assert known is not None  # as `start.scales` is not
        return known

    @cached_property
    def _signals(self) -> tuple[list[Any], list[Any]]:
        """Samples and inputs. Raises: `Unbounded`."""
        form = self.step.observer.form
        where = box(signals(form), form.system.nominal)
        y, u = list[Any](), list[Any]()
        for row, size in zip(form.output, self.samples, strict=True):
            known = bound(sp.sympify(row), where)
            if not (known.defined and known.finite):
                raise Unbounded(because("{expression} has no finite range on the box", expression=row))
            y.append(_ball(Fraction(known.low) - size, Fraction(known.high) + size))
        for signal in form.system.inputs:
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
            u.append(_ball(*map(Fraction, signal.interval)))
        return y, u


def _ball(low: Fraction, high: Fraction) -> Any:
    return arb(number(low)).union(arb(number(high)))


def _above(value: Any) -> Fraction:
    return fraction(value.abs_upper().fmpq())
