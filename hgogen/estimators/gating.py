"""The program of innovation gates, which a step runs after its prediction and before it uses a sample.

It reads the errors y - h(z) and which samples are usable, 1 or 0, from `work`, for all outputs (p). For each group it
writes the verdict on its samples into the state. All decisions come before the covariance is changed. See
`estimators.gate`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Protocol

import casadi as ca

from hgogen.estimators.gate import GatedGroup
from hgogen.estimators.riccati_part import Riccati, pivots
from hgogen.graph import Graph, binary
from hgogen.part import Clock, Joint, Pieces
from hgogen.program import INF, Bit, Block, Field, Place, Program, When, column, scalar, sym
from hgogen.signal import LOST

UNJUDGED = Bit(
    "OUT_OF_ORDER",
    "an update was called twice, before the first predict, or without a new predict or gate decision: no correction",
    "call predict once a period, then gate with all samples that have one, then each update at most once",
)
PASSED, REJECTED = 1, 2  # verdicts; 0 is none yet
LEAST = 1e-30  # of H P H' in a ratio


class Filter(Protocol):
    """The interface that a gate uses of a filter with a covariance P."""

    @property
    def part(self) -> Riccati:
        """The Riccati observer."""

    @property
    def clock(self) -> Clock:
        """The sampling."""

    def joint(self, outputs: tuple[int, ...]) -> Joint:
        """Return the joint innovations of these outputs at the prediction."""

    def row(self, output: int) -> Graph:
        """Return the row dh/dz (1, n) of an output, sparse."""

    def state_variances(self, states: list[int]) -> tuple[Program, list[Graph]]:
        """Return the variances P_ii of these states, and the program that computes what they read."""

    def decoupled(self, states: list[int], cleared: list[Graph], variances: list[Graph]) -> Program:
        """Return the program that sets P_ii of each of these `states` to its variance and all other entries of its row
        to 0, where `cleared` holds."""


def verdict(group: GatedGroup) -> str:
    """Return the name of the state's field that stores the verdict of a group's gate on the samples of this period."""
    return f"gate_{group.name}"


def added_noise(group: GatedGroup) -> str:
    """Return the name of the state's field that stores the variances that a gate adds to R."""
    return f"gate_noise_{group.name}"


def raised(part: Riccati, output: int) -> Graph:
    """Return the variance that a gate adds to the noise of a sample of an output, SX scalar; 0 without a gate that does
    so."""
    for group in part.gates:
        if group.gate.inflate and output in group.outputs:
            return sym("state", added_noise(group), len(group.outputs))[group.outputs.index(output)]
    return ca.SX(0)


def with_gating(pieces: Pieces, filter: Filter) -> Pieces:
    """Return the memory and statements of a filter, with those of its gates."""
    groups = filter.part.gates
    if not groups:
        return pieces
    decisions = (statement for group in groups for statement in _decision(filter, group))
    acceptances = (statement for group in groups for statement in _acceptance(filter, group))
    return replace(
        pieces,
        fields=(*pieces.fields, *(field for group in groups for field in _fields(group))),
        bits=(*pieces.bits, UNJUDGED, *(bit for group in groups for bit in (group.outside, group.reacquired))),
        gate=(*decisions, *acceptances),
        verdicts={j: verdict(group) for group in groups for j in group.outputs},
    )


def _fields(group: GatedGroup) -> tuple[Field, ...]:
    meaning = f"samples of {', '.join(group.names)} beyond the gate in a row"
    counted = scalar(_count(group), 0, kind="index", high=group.gate.accept_after, meaning=meaning)
    if not group.gate.inflate:
        return (counted,)
    zeros, most = (0.0,) * len(group.outputs), (LOST,) * len(group.outputs)
    meaning = "variance that the gate adds to R/dt"
    return (counted, Field(added_noise(group), zeros, low=zeros, high=most, labels=group.names, meaning=meaning))


def _count(group: GatedGroup) -> str:
    return f"gate_count_{group.name}"


def _accepted(group: GatedGroup) -> Place:
    return Place("work", f"reacquired_{group.name}")


def _usable(filter: Filter, output: int) -> Graph:
    return sym("work", "usable", filter.clock.outputs)[output] > 0


def _decision(filter: Filter, group: GatedGroup) -> Program:
    """Return the statements that compare d = r' S^-1 r of the usable samples of a group with the limit for so many."""
    joint, k = filter.joint(group.outputs), len(group.outputs)
    innovations = sym("work", "prediction_errors", filter.clock.outputs)
    usable = [_usable(filter, j) for j in group.outputs]
    biased = zip(group.outputs, ca.vertsplit(joint.bias), strict=True)
    errors = [filter.part.dynamics.output_error(j, innovations[j], bias) for j, bias in biased]
    distance, number = squared_distance(errors, usable, joint.covariance), sum(usable[1:], usable[0])
    beyond = ca.logic_not(distance <= sym("work", "limit"))
    counted, sampled = sym("state", _count(group)), number > 0
    outside, often = ca.logic_and(sampled, beyond), counted >= group.gate.accept_after
    accepted, rejected = ca.logic_and(outside, often), ca.logic_and(outside, ca.logic_not(often))
    counted_after = ca.if_else(rejected, counted + 1, ca.if_else(sampled, 0, counted))
    verdict_after = PASSED if group.gate.inflate else ca.if_else(rejected, REJECTED, PASSED)
    writes = {
        Place("state", _count(group)): counted_after,
        Place("state", verdict(group)): ca.SX(verdict_after),
        _accepted(group): accepted,
        group.outside.place: rejected,
        group.reacquired.place: accepted,
    }
    if group.gate.inflate:
        share = ca.if_else(rejected, ca.fmin(distance / sym("work", "limit") - 1, LOST), 0)
        added = (ca.fmin(share * joint.covariance[i, i], LOST) for i in range(k))
        writes[Place("state", added_noise(group))] = column(
            ca.if_else(ok, each, 0) for ok, each in zip(usable, added, strict=True)
        )
    names = ", ".join(group.names)
    return (
        *joint.program,
        Block(f"how many samples of {names} are there?", {Place("work", "limit"): passing_limit(group, usable)}),
        Block(f"is the joint innovation of {names} beyond its gate?", writes, {"distance": distance}),
    )


def squared_distance(errors: Sequence[Graph], usable: Sequence[Graph], covariance: Graph) -> Graph:
    """Return d = r' S^-1 r of the `usable` (k) of the innovations r = `errors` (k), S = `covariance` (k, k), SX."""
    k = len(errors)
    r = [ca.if_else(ok, error, 0) for ok, error in zip(usable, errors, strict=True)]
    S = ca.SX(k, k)
    for i in range(k):
        for m in range(k):
            both = usable[i] if i == m else ca.logic_and(usable[i], usable[m])
            S[i, m] = ca.if_else(both, covariance[i, m], float(i == m))
    L, D = pivots(S)
    distance = ca.SX(0)
    for i in range(k):
        r[i] = r[i] - sum(L[i, m] * r[m] for m in range(i))
        distance += r[i] * r[i] / D[i]
    return distance


def passing_limit(group: GatedGroup, usable: Sequence[Graph]) -> Graph:
    """Return the largest squared distance d that passes the gate of a group, SX: it depends on the number of samples
    that are `usable`."""
    number, most = sum(usable[1:], usable[0]), ca.SX(INF)
    for i in reversed(range(len(usable))):
        most = ca.if_else(number < i + 1.5, group.limits[i], most)
    return most


def _acceptance(filter: Filter, group: GatedGroup) -> Program:
    """Return the statements that raise the variances of the states that a group reads, and clear their covariances."""
    rows = {j: filter.row(j) for j in group.outputs}
    read = {j: sorted(set(row.sparsity().get_col())) for j, row in rows.items()}
    states = sorted({i for each in read.values() for i in each})
    if not states:
        return ()
    program, variances = filter.state_variances(states)
    prior = dict(zip(states, variances, strict=True))
    innovations = sym("work", "prediction_errors", filter.clock.outputs)
    scale = {}
    for j, row in rows.items():
        variance = sum((row[i] * row[i] * prior[i] for i in read[j]), ca.SX(0))
        raised = ca.fmax(1, innovations[j] * innovations[j] / ca.fmax(variance, LEAST))
        scale[j] = ca.if_else(_usable(filter, j), raised, 1)
    cleared, after = [], []
    for i in states:
        reading = [j for j in group.outputs if i in read[j]]
        cleared.append(reduce(lambda a, b: binary(ca.OP_OR, a, b), (_usable(filter, j) for j in reading)))
        most = reduce(ca.fmax, (scale[j] for j in reading))
        after.append(ca.fmin(most * prior[i], ca.fmax(prior[i], float(filter.part.cap[i]))))
    return (When(_accepted(group), (*program, *filter.decoupled(states, cleared, after))),)
