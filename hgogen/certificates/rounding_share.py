"""The share that rounding has in an error: its sizes on the states that the other shares and the start leave.

What rounding does depends on how large the numbers are, these on the error, and the error on rounding. With R what it
does where it moves nothing itself,

    rho(plant's ranges + start + the other shares + r R) <= r rho(plant's ranges + start + the other shares)

shows by induction that it does no more than r R. Once the start has decayed it does less: |e|_P^2 - 1 falls to 1 -
alpha h of itself at each call, in the norm of what is rounded from then on.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Evidence
from hgogen.analysis.polytope import signals
from hgogen.certificates.listed_program import listed
from hgogen.certificates.one_call import rounding_errors
from hgogen.certificates.start_set import Running, Start
from hgogen.prove.entering import Share, Sizes
from hgogen.prove.inclusion import of_state
from hgogen.prove.plant_step import SUMMED, Unbounded
from hgogen.prove.quadratic import extent, rational
from hgogen.prove.questions import InputBound
from hgogen.rigor.balls import between, magnitude
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import box
from hgogen.rigor.computed import Real, Unsure
from hgogen.rigor.definite import root
from hgogen.sentence import because

CLOSE = Fraction(1, 20)  # of a bound: what is left of the start, and of rounding, when it is said to have settled
_ROOM = Fraction(11, 10)  # of the other shares, with what is left of the start
_ROUNDS = 40
_GROWTH = Fraction(11, 10)  # of r, from round to round
_PIECES = 32  # of the ranges of the first states
_UP = 1 + 1e-9  # of a count of calls, for what its floats may be off
Side = tuple[Fraction, Fraction]
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
    running: Running, real: Real, shares: Sequence[Share], start: Start, multiple: Fraction, samples: Sequence[Fraction]
) -> Rounding:
    """The share of a program in a working precision, beside the others, from first errors of `multiple` times what the
    ranges allow, of samples that err by at most `samples` (p). Raises: `Unbounded`, `NoSolver`."""
    every, plant = range(len(start.scales)), running.plant
    parts = [_of_share(share.unit, share.proofs, start.scales) for share in shares]
    others = {k: sum((part[k] for part in parts), Fraction(0)) for k in every}
    begins = running.begins(start, every)
    taken, speeds = min(multiple, Fraction(1)), plant.stated_speeds
    besides = [share.sizes.beside for share in shares if share.sizes.beside]
    rates = [speed + sum((each[i] for each in besides), Fraction(0)) for i, speed in enumerate(speeds)]
    moves = [plant.h * rate for rate in rates]  # of a plant in a call, by row of its form
    sizes = _Sizing(running, real, samples, moves, speeds)

    def moved(what: Sizes) -> tuple[dict[int, InputBound], dict[int, Fraction]]:
        """The proofs of what such sizes do, over the largest, and what they say of each field."""
        known = running.bounds(what)
        if known is None:
            raise Unbounded(because("no bound is found of what rounding does"))
        return known, _of_share(what.largest, known, start.scales)

    wide = {k: others[k] + taken * begins[k] for k in every}
    first = sizes.beside(wide)
    _, bounds = moved(first)
    most = _kept_to(lambda r: _times(sizes.beside({k: wide[k] + r * bounds[k] for k in every}), first))
    early = {k: most * bounds[k] for k in every}
    within = {k: _ROOM * others[k] + (1 + CLOSE) * early[k] for k in every}
    later = sizes.beside(within)
    proofs, bounds = moved(later)
    left = {k: CLOSE * (others[k] + min(bounds[k], early[k])) for k in every}
    falls = min(one.alpha for one in proofs.values()) * running.proof.h
    calls = _calls(float(most * _times(first, later)), float(falls))
    share = Share("rounding", later, later.largest, proofs, sizes.follows([within[k] for k in every]))
    return Rounding(share, early, left, calls)


def _times(more: Sizes, less: Sizes) -> Fraction:
    """How many times as much is rounded, in no field more. Raises: `Unbounded`."""
    if not all(less.fields):
        raise Unbounded(because("a field is not rounded"))
    return max(x / y for x, y in zip(more.fields, less.fields, strict=True))


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
    """How much a call rounds on the plant's ranges, with errors of its fields beside: the most of pieces of the ranges
    of the first states, as what is injected is small where samples are those of the same piece."""

    running: Running
    real: Real
    samples: Sequence[Fraction]
    moves: Sequence[Fraction]
    speeds: Sequence[Fraction]

    def beside(self, errors: Sized) -> Sizes:
        """Raises: `Unbounded`."""
        rounded = [self._on(ranges, errors) for ranges in self._pieces]
        each = zip(zip(*rounded, strict=True), self._remembered, strict=True)
        return Sizes(fields=tuple(max(rhos) * e * SUMMED / Fraction(self.running.step.dt) for rhos, e in each))

    def follows(self, within: Sequence[Fraction]) -> Evidence:
        """Of what the sizes follow where the error of each field (N) is within its bound, as a certificate has it;
        empty where it cannot list the program."""
        listing = listed(self.running.step, self.running.steps.error)
        if listing is None:
            return {}
        return {
            "between": self.running.step.clock.between,
            "parameters": list(self.running.step.observer.form.system.nominal.values()),
            "precision": self.real,
            "speeds": self.speeds,
            "within": within,
            "program": listing.statements,
            "stages": listing.stages,
            "rates": listing.rates,
            "after": listing.after,
        }

    def _on(self, ranges: Sequence[Side], errors: Sized) -> list[Fraction]:
        """By field, on a piece. Raises: `Unbounded`."""
        layout, held = self.running.steps.error.layout, []
        for k, (i, fed, e) in enumerate(zip(layout.index, layout.fed, self._remembered, strict=True)):
            low, high = ranges[i] if fed else (Fraction(0), Fraction(0))
            unit = self.running.scales[k] / e
            held.append(between(unit * (low - errors[k]), unit * (high + errors[k])))
        try:
            rounded = rounding_errors(self.running.step, self.real, held, self._samples(ranges), self._inputs)
        except Unsure as error:
            raise Unbounded(because("how far rounding goes is not known: {what}", what=error.args[0])) from error
        return list(map(magnitude, rounded))

    @cached_property
    def _pieces(self) -> list[tuple[Side, ...]]:
        """The ranges (n) of the states, those of the first ones in pieces."""
        heads = {head for head, _ in self.running.shown.values()}
        count, sides = round(_PIECES ** (1 / len(heads))), list[list[Side]]()
        for i, state in enumerate(self.running.step.observer.form.states):
            low, high = map(Fraction, state.interval)
            parts = count if i in heads else 1
            cuts = [low + (high - low) * Fraction(part, parts) for part in range(parts + 1)]
            sides.append(list(pairwise(cuts)))
        return list(product(*sides))

    @cached_property
    def _remembered(self) -> Sequence[Fraction]:
        known = self.running.steps.error.remembered(self.running.steps.theta)
        assert known is not None  # as `start.scales` is not
        return known

    def _samples(self, ranges: Sequence[Side]) -> list[Any]:
        """The samples of a plant in these ranges at the beginning of a call, at both ends of it."""
        y = []
        for j, (low, high) in enumerate(self._offsets):
            i, slope = self.running.shown[j]
            ends = [slope * (end + way * self.moves[i]) for end, way in zip(ranges[i], (-1, 1), strict=True)]
            y.append(between(min(ends) + low - self.samples[j], max(ends) + high + self.samples[j]))
        return y

    @cached_property
    def _offsets(self) -> list[Side]:
        """What each output is beside its first state times its slope. Raises: `Unbounded`."""
        form, offsets = self.running.step.observer.form, list[Side]()
        where = box(signals(form), form.system.nominal)
        slopes = {output: form.states[i] * sp.Rational(slope) for output, (i, slope) in self.running.shown.items()}
        for j, row in enumerate(form.output):
            known = bound(sp.expand(row - slopes.get(j, 0)), where)
            if not (known.defined and known.finite) or j not in slopes:
                raise Unbounded(because("{expression} has no finite range on the box", expression=row))
            offsets.append((Fraction(known.low), Fraction(known.high)))
        return offsets

    @cached_property
    def _inputs(self) -> list[Any]:
        """Raises: `Unbounded`."""
        for signal in self.running.step.inputs:
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
        return [between(*map(Fraction, signal.interval)) for signal in self.running.step.inputs]
