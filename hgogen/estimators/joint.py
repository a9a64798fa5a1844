"""Joint updates: the samples of a call wait, and correct together, with all outputs linearised at the prediction.

    e = y - h(z),  C = dh/dz at the prediction z;  R_u = L diag(d) L' the block of R of the samples that are used
    L^-1 e,  L^-1 C:   samples with independent noises of variances d, which correct one by one:
    z <- z + K (e_j - c_j (z - z before all)),  P <- P - K c_j P

This is K = P C' (C P C' + R_u)^-1, z <- z + K e, as a batch. Rows and columns of L of samples that are not used are
those of the unit matrix, so that the pattern of missing samples needs no branch. Source: Bierman, "Factorization
methods for discrete sequential estimation" (1977), the decorrelation of a measurement's noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import casadi as ca

from hgogen.estimators.riccati_part import Riccati
from hgogen.graph import Graph
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Place, Program, When, column, scalar, sym
from hgogen.signal import Signal

WAITS = "waits_"  # of names of flags in the state


class Filter(Protocol):
    """A filter with a covariance P, as far as its joint update needs it."""

    @property
    def part(self) -> Riccati:
        """The Riccati observer."""

    @property
    def clock(self) -> Clock:
        """The sampling."""

    def joint_correction(self) -> Program:
        """Return the statements that correct by all samples that wait."""


def outputs(filter: Filter) -> tuple[Signal, ...]:
    """Return the plant's outputs."""
    return filter.part.dynamics.form.system.outputs


def with_joint(pieces: Pieces, filter: Filter) -> Pieces:
    """Return the memory and statements of a filter whose updates are joint, where its part asks for it: an update
    stores its sample, and the correction comes after all updates."""
    if not filter.part.joint:
        return pieces
    waits = "1 where the sample waits for the correction"
    fields = [scalar(_reading(y), 0.0, unit=y.unit, meaning="sample of this period") for y in outputs(filter)]
    flags = [scalar(_waits(y), 0, kind="index", high=1, meaning=waits) for y in outputs(filter)]
    none = Block("no sample waits", {Place("state", _waits(y)): ca.SX(0) for y in outputs(filter)})
    return replace(
        pieces,
        fields=(*pieces.fields, *fields, *flags),
        predict=(*pieces.predict, none),
        update=tuple(map(_stored, outputs(filter))),
        correct=(*filter.joint_correction(), none),
    )


def _stored(y: Signal) -> Program:
    writes = {Place("state", _reading(y)): sym("work", "reading"), Place("state", _waits(y)): ca.SX(1)}
    return (Block(f"the sample of {y} waits for those of other outputs", writes),)


def _reading(y: Signal) -> str:
    return f"sample_{y}"


def _waits(y: Signal) -> str:
    return f"{WAITS}{y}"


def waiting(filter: Filter) -> list[Graph]:
    """Return whether each output has a sample that waits (p), SX."""
    return [sym("state", _waits(y)) > 0 for y in outputs(filter)]


def errors(filter: Filter, predicted: Graph, drift: Graph | None = None) -> Graph:
    """Return e (p), the sample less `predicted` + `drift` of each output, 0 where none waits."""
    shift = ca.SX.zeros(len(outputs(filter))) if drift is None else drift
    dynamics, each = filter.part.dynamics, []
    for j, (y, waits) in enumerate(zip(outputs(filter), waiting(filter), strict=True)):
        error = dynamics.output_error(j, dynamics.output_error(j, sym("state", _reading(y)), predicted[j]), shift[j])
        each.append(ca.if_else(waits, error, 0))
    return column(each)


def where_waiting(filter: Filter, programs: Sequence[Program]) -> Program:
    """Return the statements of each output (p), run where it has a sample that waits."""
    places = [Place("work", f"{_waits(y)}_now") for y in outputs(filter)]
    test = Block("which samples wait?", dict(zip(places, waiting(filter), strict=True)))
    return (test, *(When(place, program) for place, program in zip(places, programs, strict=True)))


def decorrelated(R: Graph, used: Sequence[Graph]) -> tuple[Graph, Graph]:
    """Return L (p, p), unit lower triangular and sparse, and d (p) of R_u = L diag(d) L', the block of `R` (p, p) of
    the samples that are `used` (p)."""
    R, L, d = ca.sparsify(R), ca.SX.eye(len(used)), list[Graph]()
    for j in range(len(used)):
        for k in range(j):
            value = R[j, k] - sum((L[j, m] * L[k, m] * d[m] for m in range(k)), ca.SX(0))
            if not value.is_zero():
                L[j, k] = ca.if_else(ca.logic_and(used[j], used[k]), value / d[k], 0)
        d.append(R[j, j] - sum((L[j, k] ** 2 * d[k] for k in range(j)), ca.SX(0)))
    return L, column(d)


def whitened(L: Graph, rows: Graph) -> Graph:
    """Return L^-1 rows (p, k) for a unit lower triangular L (p, p), sparse."""
    return ca.vertcat(*_whitened(L, rows))


def _whitened(L: Graph, rows: Graph) -> Iterator[Graph]:
    known = list[Graph]()
    for j, row in enumerate(ca.vertsplit(rows)):
        known.append(ca.sparsify(row - sum((L[j, k] * known[k] for k in range(j) if not L[j, k].is_zero()), 0)))
        yield known[-1]


def used_block(R: Graph, used: Sequence[Graph]) -> Graph:
    """Return R (p, p) with 0 for the correlations of samples that are not `used` (p)."""
    block = ca.SX(R)
    for j, k in zip(*ca.sparsify(R).sparsity().get_triplet(), strict=True):
        if j != k:
            block[j, k] = ca.if_else(ca.logic_and(used[j], used[k]), R[j, k], 0)
    return block
