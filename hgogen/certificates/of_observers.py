"""The evidence of a claim about an observer: what `hgogen recheck` needs to verify it, by the kind of its proof.

A proof writes its own as `evidence`, a mapping of exact values by name. In it a `Steep` stands for the bound of dc/dw
in scaled coordinates of integrators, with its keys. The kinds whose evidence is made of more than the proof are here.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.certificates.of_forms import LOOSE, Evidence, enclosure, steep, text, written
from hgogen.check import Check, Verdict
from hgogen.form import Form
from hgogen.guarantees.adaptive_gain import Adapting, Attenuating, Candidate, assumed_share, gain
from hgogen.guarantees.certified import Steep, ThetaBound
from hgogen.guarantees.dwell import Held
from hgogen.guarantees.gain_update import Weighted
from hgogen.guarantees.sector import Decay, SectorBound
from hgogen.intervals.proof import Grounds
from hgogen.kalman.persistence import Persistent
from hgogen.structure.polytope import chains


def evidence(form: Form, check: Check) -> Evidence | None:
    """The evidence of a proved check; None where the check is not proved, or has no evidence of this kind."""
    if check.verdict is not Verdict.PROVED:
        return None
    for proof in check.proofs:
        fact = proof.fact if isinstance(proof, Grounds) else proof
        if type(fact) in _MAKERS:
            return _MAKERS[type(fact)](form, fact)
        if hasattr(fact, "evidence"):
            return _own(form, fact.evidence)
    return None


def exactly(form: Form, value: Any) -> Any:
    """A number or an expression as an exact text, or a list of them; a text as it is."""
    if isinstance(value, str):
        return value
    if isinstance(value, Iterable):
        return [exactly(form, each) for each in value]
    return text(form, value) if isinstance(value, sp.Basic) else str(Fraction(value))


def _own(form: Form, parts: Mapping[str, Any]) -> Evidence | None:
    """The evidence that a proof writes; None where a bound of dc/dw in it has none."""
    made: Evidence = {}
    for key, value in parts.items():
        part = _sloped(form, value) if isinstance(value, Steep) else {key: exactly(form, value)}
        if part is None:
            return None
        made |= part
    return made


def _constant_gain(form: Form, bound: ThetaBound) -> Evidence | None:
    """The matrix P for A - K C in scaled coordinates, and the bound of db/dz in them."""
    slope = steep(form, (*form.b, *bound.scale), bound.slope)
    if slope is None:
        return None
    core: Evidence = {"core": numbers(bound.lyapunov.vertices[0])}
    if len(bound.lyapunov.vertices) > 1:
        gains = (a for chain in chains(form) for a in chain)
        core = {"ranges": [enclosure(form, a, known) for a, known in zip(gains, bound.ranges, strict=True)]}
    scale = [text(form, s) for s in bound.scale]
    return {"scale": scale, **core, "P": numbers(bound.lyapunov.P), "peak": str(bound.lyapunov.peak), **slope}


def _decay(form: Form, decay: Decay) -> Evidence:
    """The matrix P and the multipliers of the quadratic form, in scaled coordinates of integrators."""
    return {"units": _powers(decay), "P": numbers(decay.P), "mu": str(decay.mu), "tau": str(decay.tau)}


def _sector(form: Form, bound: SectorBound) -> Evidence | None:
    """The evidence of the decay with its margin, and the bound of dc/dw."""
    slope, decay = _sloped(form, bound.steep), bound.decay
    return slope and {**_decay(form, decay), "peak": str(decay.peak), "margin": str(decay.margin), **slope}


def _held(form: Form, held: Held) -> Evidence:
    """The lower bound of the P in the claim of convergence."""
    return {"least": str(held.least)}


def _weighted(form: Form, weighted: Weighted) -> Evidence:
    """The matrix P and the b of D."""
    peak = {} if weighted.peak is None else {"peak": str(weighted.peak)}
    return {"P": numbers(weighted.P), "b": str(weighted.b), **peak}


def _sloped(form: Form, lipschitz: Steep, wider: float = 1e-9) -> Evidence | None:
    """The bound of dc/dw in scaled coordinates of integrators."""
    slope = steep(form, (*form.b, *lipschitz.scale), lipschitz.proof, wider)
    return slope and {
        "units": list(map(str, lipschitz.units)),
        "scale": [text(form, s) for s in lipschitz.scale],
        **slope,
    }


def _steep(form: Form, lipschitz: Steep | None) -> Evidence | None:
    """The bound of dc/dw with room to spare, since no threshold is printed of it."""
    return None if lipschitz is None else _sloped(form, lipschitz, LOOSE)


def _candidate(form: Form, candidate: Candidate) -> Evidence:
    """The matrix P of the candidate."""
    return {"P": numbers(candidate.P)}


def _adapting(form: Form, proof: Adapting) -> Evidence | None:
    """The matrix P, lambda_max(P), lambda, and the bound k of dc/dw."""
    slope, candidate = _steep(form, proof.assumptions.steep), proof.candidate
    return slope and {"P": numbers(candidate.P), "peak": str(candidate.peak), "decay": str(candidate.decay), **slope}


def _attenuating(form: Form, proof: Attenuating) -> Evidence | None:
    """The evidence of `_adapting` with the disturbance, and s of (87) and mu for the k that is written."""
    slope, candidate, disturbed = _steep(form, proof.assumptions.steep), proof.candidate, proof.assumptions.disturbance
    if slope is None or disturbed is None:
        return None
    assumptions = replace(proof.assumptions, slope=Fraction(slope["bound"]))
    share, mu = assumed_share(candidate, assumptions), gain(candidate, assumptions)
    if share is None or mu is None:
        return None
    return {
        "P": numbers(candidate.P),
        "peak": str(candidate.peak),
        "G_1": numbers(disturbed.plant),
        "G_2": list(map(str, disturbed.measurement)),
        "delta_1": str(disturbed.deltas[0]),
        "share": str(share),
        "mu": str(mu),
        **slope,
    }


def _persistent(form: Form, persistent: Persistent) -> Evidence:
    """The inputs as functions of time, and a time at which they show every state."""
    period = {} if persistent.period is None else {"period": written(persistent.period, set())}
    inputs = {name: written(e, {"t"}) for name, e in persistent.inputs.items()}
    return {"inputs": inputs, "at": written(persistent.at, set()), **period}


def _powers(decay: Decay) -> list[str]:
    """The units of the scaled coordinates, the powers of their growth."""
    return [str(decay.growth**i) for i in range(len(decay.P))]


def numbers(matrix: Iterable[Iterable[Fraction]]) -> list[list[str]]:
    """The matrix with its entries as texts."""
    return [[str(value) for value in row] for row in matrix]


def _nothing(form: Form, absent: None) -> Evidence:
    """No evidence: the claim follows from the observer's numbers and another claim."""
    return {}


_MAKERS: dict[type, Callable[..., Evidence | None]] = {
    ThetaBound: _constant_gain,
    Decay: _decay,
    SectorBound: _sector,
    Held: _held,
    Weighted: _weighted,
    Steep: _steep,
    Candidate: _candidate,
    Adapting: _adapting,
    Attenuating: _attenuating,
    Persistent: _persistent,
    type(None): _nothing,
}
