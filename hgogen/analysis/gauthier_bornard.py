"""Uniform observability for every input of a control-affine plant with one output.

    x' = f(x) + sum_j g_j(x) u_j,   y = h(x)
    rank d(h, L_f h, .., L_f^(n-1) h) = n   and   d(L_g L_f^(i-1) h) in span(dh, .., d L_f^(i-1) h)  for all i, g

on an open dense set: then, and only then, the plant is observable whatever the real input there, and
z = (h, L_f h, ..) brings it to triangular form. J.-P. Gauthier, G. Bornard, "Observability for any u(t) of a class of
nonlinear systems", IEEE Trans. Automatic Control 26 (1981), theorem 4.

The gradients come from power series at a random point, their slope along g from the same series at the point moved
along g, in numbers modulo the square of a prime (or with balls): no Lie derivative is written out. A span that is
left at one point is left almost everywhere; one that is invariant, or a rank below n, is tried at several points: that
is no proof. The theorem is of every real input: it does not know of declared ranges.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import sympy as sp

from hgogen.analysis.written import on_branches
from hgogen.check import Verdict
from hgogen.rigor.field import is_zero
from hgogen.rigor.rank import (
    NowhereDefined,
    Places,
    believe_zeros,
    branches,
    exact_numbers,
    modulus,
    new_rows,
    plant_of,
    somewhere,
)
from hgogen.rigor.series import Arithmetic, Plant, Point, evaluate, first_gradients
from hgogen.sentence import NONE, Reason, because
from hgogen.system import System

POINTS = 3
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo)


@dataclass(frozen=True)
class UniformObservability:
    """Whether a plant is uniformly observable: the `answer` is True or False where the test applies, and None where it
    does not, or where it cannot be decided; `reason` says why.

    It `applies` where the plant has one output, an input, a flow affine in the inputs, and an output free of them.
    `shown` tells whether a False is more than what ranks at random points say.
    """

    answer: bool | None
    applies: bool
    reason: Reason
    shown: bool = True

    @property
    def verdict(self) -> Verdict:
        """The verdict of the claim that the plant is observable for every real input, inside and outside its ranges."""
        if self.answer is None or not (self.answer or self.shown):
            return Verdict.UNKNOWN
        return Verdict.GENERIC if self.answer else Verdict.REFUTED


def gauthier_bornard(
    flow: Iterable[sp.Expr],
    output: Iterable[sp.Expr],
    states: Iterable[sp.Symbol],
    inputs: Iterable[sp.Symbol],
    places: Places = (),
) -> UniformObservability:
    """The test at random points, real ones near `places`; symbols that are neither state nor input are random
    constants.

    Raises: `NothingMeasured`, `NowhereDefined`; `NoTape` for a function without a rule.
    """
    flow, output, states, inputs = (tuple(map(sp.sympify, part)) for part in (flow, output, states, inputs))
    plant, _ = plant_of(flow, output, states, inputs, (), places)
    outside = _outside(flow, output, inputs)
    if outside:
        return UniformObservability(None, False, outside)
    ranks = []
    for k in range(POINTS):
        rank, left = somewhere(plant, lambda numbers, point: _left(plant, inputs, numbers, point), first=k, power=2)
        if left:
            return UniformObservability(False, True, left)
        ranks.append(rank)
    if max(ranks) < plant.n:
        return _deficient(max(ranks), flow, output[0], states, inputs)
    if branches(plant):
        pattern = "it holds at {points} points, but on one branch of {branches}"
        return UniformObservability(None, True, because(pattern, points=POINTS, branches=branches(plant)))
    kind = "modulo primes" if exact_numbers(plant) else "with balls"
    pattern = "rank {rank}, and every span is kept at {points} random points {kind}"
    return UniformObservability(True, True, because(pattern, rank=plant.n, points=POINTS, kind=kind))


def of_plant(plant: System) -> UniformObservability:
    """The test of a plant, parameters generic within their ranges, those without one at their nominal values; on each
    branch that its ranges reach.

    Raises: as `gauthier_bornard`.
    """
    reached = on_branches(plant, plant.tunable)
    n, answers = len(plant.states), []
    if not reached.branches:
        raise NowhereDefined(reached.points)
    outside = _outside(plant.flow, plant.output, plant.inputs) if reached.bent else NONE
    if outside:
        return UniformObservability(None, False, outside)
    for branch in reached.branches:
        one = gauthier_bornard(branch.rows[:n], branch.rows[n:], plant.states, plant.inputs, branch.places)
        if not reached.bent:
            return one
        at = because("where {conditions: and }: {reason}", conditions=branch.where, reason=one.reason)
        answers.append(replace(one, reason=at))
        if one.answer is False and one.shown:
            return answers[-1]
    doubtful = next((one for one in answers if one.answer is not True), None)
    smooth = because("it holds on the {count} branches asked, and the theorem is of smooth plants", count=len(answers))
    return doubtful or UniformObservability(None, True, smooth)


def _outside(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], inputs: Sequence[sp.Symbol]) -> Reason:
    """Why the test does not apply, or that this is not known; `NONE` where it applies."""
    if len(output) != 1:
        return because("the test is for one output, and there are {count}", count=len(output))
    if not inputs:
        return because("there is no input")
    slopes = [(output[0].diff(u), because("the output depends on {input}", input=u)) for u in inputs]
    pairs = combinations_with_replacement(inputs, 2)
    bent = [(u, v, because("the flow is not affine in {inputs}", inputs=dict.fromkeys((u, v)))) for u, v in pairs]
    slopes += [(e.diff(u).diff(v), what) for e in flow for u, v, what in bent]
    for slope, what in slopes:
        zero = is_zero(slope)
        if not zero:
            return what if zero is False else because("it is not known whether {slope} is zero", slope=slope)
    return NONE


def _deficient(
    rank: int, flow: Sequence[sp.Expr], output: sp.Expr, states: Sequence[sp.Symbol], inputs: Sequence[sp.Symbol]
) -> UniformObservability:
    """A rank below n: shown by states that, without input, no derivative of the output reads; else by random points
    alone."""
    n = len(states)
    reason = because("without input, d(h, .., L_f^{order} h) has rank {rank} of {n}", order=n - 1, rank=rank, n=n)
    drift = {x: rate.subs(dict.fromkeys(inputs, 0)) for x, rate in zip(states, flow, strict=True)}
    seen = [x for x in states if x in output.free_symbols]
    for x in seen:  # the list grows while it is read
        seen += [other for other in states if other in drift[x].free_symbols and other not in seen]
    hidden = [x for x in states if x not in seen]
    if not hidden or any(rate.has(*_INFINITE) for rate in drift.values()):
        random = because("{reason} at {points} random points, which is no proof", reason=reason, points=POINTS)
        return UniformObservability(False, True, random, shown=False)
    hides = because("{reason}: {inputs: = } = 0 hides {states}", reason=reason, inputs=inputs, states=hidden)
    return UniformObservability(False, True, hides)


def _left(plant: Plant, inputs: Sequence[sp.Symbol], numbers: Arithmetic, point: Point) -> tuple[int, Reason]:
    """The rank at this point, at most n, and which span is left there where it is n; `NONE` if none is."""
    n, prime = plant.n, modulus(numbers)
    point = replace(point, inputs=lambda j, order: [0] * order)
    rows = first_gradients(plant, numbers, point, n)
    flat = [[numbers.reduced(e) for e in row.entries()] for row in rows]
    rank = len(new_rows(flat, prime))
    if rank < n:
        believe_zeros(prime)
        return rank, NONE
    drift, bend = _field(plant, numbers, point, None)
    for j, u in enumerate(inputs):
        driven, tilt = _field(plant, numbers, point, j)
        g, slope = [a - b for a, b in zip(driven, drift, strict=True)], tilt - bend
        states = tuple(x + numbers.nudge * v for x, v in zip(point.states, g, strict=True))
        moved = first_gradients(plant, numbers, replace(point, states=states), n)
        for i, (row, beside) in enumerate(zip(rows, moved, strict=True)):
            turn = [numbers.slope(a, b) for a, b in zip(beside.entries(), row.entries(), strict=True)]
            tilted = (row * slope).entries()
            new = [numbers.reduced(a + numbers.reduced(b)) for a, b in zip(turn, tilted, strict=True)]
            if i + 1 in new_rows([*flat[: i + 1], new], prime):
                pattern = "d(L_g L_f^{i} h), g of {input}, leaves the span of dh, .., d L_f^{i} h"
                return rank, because(pattern, i=i, input=u)
    believe_zeros(prime)
    return rank, NONE


def _field(plant: Plant, numbers: Arithmetic, point: Point, j: int | None) -> tuple[list[Any], Any]:
    """The flow and its slope by the states where the input j is 1 and the others 0."""
    values = [numbers.series([x], 1) for x in point.states]
    values += [numbers.series([int(i == j)], 1) for i in range(plant.m)]
    values += [numbers.series([c], 1) for c in point.constants]
    rows = evaluate(plant, numbers, values, 1, 1)[: plant.n]
    entries = [numbers.coefficients(s[k], 1)[0] if k in s else 0 for _, s in rows for k in range(plant.n)]
    return [numbers.coefficients(f, 1)[0] for f, _ in rows], numbers.matrix(plant.n, plant.n, entries)
