"""The evidence of a step that contracts: the weights of its quadratic form, and the ranges of the slopes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.guarantees.all_shorter import Piece
from hgogen.guarantees.confined import Confined
from hgogen.guarantees.contracting import Contracts
from hgogen.guarantees.entering import Sizes
from hgogen.guarantees.inclusion import Inclusion
from hgogen.guarantees.under_inputs import InputBound


@dataclass(frozen=True)
class AtOneLength:
    """A proof at one step length by the method of that name."""

    error: Inclusion
    method: str
    proof: Contracts

    def evidence(self, form: Form) -> Evidence | None:
        """Method, dt and alpha, P and S, and how the slopes are bounded."""
        slopes, one = self.error.evidence(form), self.proof
        known = {"method": self.method, "dt": one.h, "alpha": one.alpha, "P": one.weights.P, "S": one.weights.S}
        return slopes and {**slopes, **known}


@dataclass(frozen=True)
class Throughout:
    """Proofs at one theta of every step length up to a longest, piece by piece."""

    error: Inclusion
    method: str
    theta: Fraction
    pieces: tuple[Piece, ...]

    def evidence(self, form: Form) -> Evidence | None:
        """Method and theta, each piece with its P and S, and how the slopes are bounded."""
        slopes = self.error.evidence(form)
        pieces: list[dict[str, Any]] = [
            {"low": one.low, "high": one.high, "P": one.weights.P, "S": one.weights.S} for one in self.pieces
        ]
        return slopes and {**slopes, "method": self.method, "theta": self.theta, "pieces": pieces}


@dataclass(frozen=True)
class UnderNoise:
    """Bounds at one step length of what errors of at most 1 in the samples of an output do to a state: for each place
    of a state and an output, from 0."""

    error: Inclusion
    method: str
    h: Fraction
    bounds: Mapping[tuple[int, int], InputBound]

    def evidence(self, form: Form) -> Evidence | None:
        """Method and dt, each bound with its alpha, P and S, and how the slopes are bounded."""
        slopes = self.error.evidence(form)
        bounds: list[dict[str, Any]] = [
            {
                "state": state + 1,
                "output": output + 1,
                "alpha": one.alpha,
                "P": one.weights.P,
                "S": one.weights.S,
                "bound": one.bound,
            }
            for (state, output), one in self.bounds.items()
        ]
        return slopes and {**slopes, "method": self.method, "dt": self.h, "bounds": bounds}


@dataclass(frozen=True)
class FromStart:
    """Bounds at one step length of errors that are at most `first` (n) at the start, by state: `clear`, of the fields
    that estimate, against their `limits`, and `peaks` (n), of each state."""

    error: Inclusion
    method: str
    h: Fraction
    first: tuple[Fraction, ...]
    limits: Mapping[int, Fraction]
    clear: Confined
    peaks: tuple[Confined, ...]

    def evidence(self, form: Form) -> Evidence | None:
        """Method and dt, the first errors, P and S of the limits and of each peak, and how the slopes are bounded."""
        slopes, multiple = self.error.evidence(form), 1 / max(self.clear.bounds.values())
        limits = [{"field": k + 1, "limit": limit} for k, limit in self.limits.items()]
        peaks: list[dict[str, Any]] = [
            {"P": one.weights.P, "S": one.weights.S, "bound": max(one.bounds.values())} for one in self.peaks
        ]
        clear = {"P": self.clear.weights.P, "S": self.clear.weights.S, "multiple": multiple, "limits": limits}
        known = {"method": self.method, "dt": self.h, "first": self.first, "clear": clear, "peaks": peaks}
        return slopes and {**slopes, **known}


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


@dataclass(frozen=True)
class UnderInputs:
    """Bounds at one step length of an error that inputs drive, the sums of their shares."""

    error: Inclusion
    method: str
    h: Fraction
    shares: tuple[Share, ...]

    def evidence(self, form: Form) -> Evidence | None:
        """Method and dt, each share with its sizes and of each field alpha, P, S and its bound, and how the slopes are
        bounded."""
        slopes = self.error.evidence(form)
        shares: list[dict[str, Any]] = [
            {
                "inputs": share.what,
                "follows": share.follows,
                "samples": share.sizes.samples,
                "stages": share.sizes.stages,
                "beside": share.sizes.beside,
                "fields": share.sizes.fields,
                "unit": share.unit,
                "bounds": [
                    {
                        "field": k + 1,
                        "alpha": one.alpha,
                        "P": one.weights.P,
                        "S": one.weights.S,
                        "bound": share.bound(k),
                    }
                    for k, one in share.proofs.items()
                ],
            }
            for share in self.shares
        ]
        return slopes and {**slopes, "method": self.method, "dt": self.h, "shares": shares}
