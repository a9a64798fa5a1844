"""The evidence of a claim about an observer: what `hgogen recheck` needs to verify it, by what was found of it."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from fractions import Fraction

from hgogen.certificates.of_forms import LOOSE, Evidence, enclosure, steep, text, written
from hgogen.check import Check, Verdict
from hgogen.form import Form
from hgogen.guarantees.adaptive_gain import Adapting, Attenuating, Candidate, gain, share_given
from hgogen.guarantees.certified import Steep, ThetaBound
from hgogen.guarantees.certified_core import CoreBound
from hgogen.guarantees.dwell import Held
from hgogen.guarantees.gain_update import Weighted
from hgogen.guarantees.sector import Decay, SectorBound
from hgogen.intervals.proof import Grounds
from hgogen.kalman.persistence import Persistent
from hgogen.structure.polytope import chains


def evidence(form: Form, check: Check) -> Evidence | None:
    """What shows a proved check; None where nothing here does."""
    if check.verdict is not Verdict.PROVED:
        return None
    for proof in check.proofs:
        fact = proof.fact if isinstance(proof, Grounds) else proof
        if type(fact) in _MAKERS:
            return _MAKERS[type(fact)](form, fact)
    return None


def _constant_gain(form: Form, found: ThetaBound) -> Evidence | None:
    """P for A - K C in scaled coordinates, and the bound of db/dz in them."""
    slope = steep(form, (*form.b, *found.scale), found.slope)
    if slope is None:
        return None
    core: Evidence = {"core": numbers(found.lyapunov.vertices[0])}
    if len(found.lyapunov.vertices) > 1:
        gains = (a for chain in chains(form) for a in chain)
        core = {"ranges": [enclosure(form, a, known) for a, known in zip(gains, found.ranges, strict=True)]}
    scale = [text(form, s) for s in found.scale]
    return {"scale": scale, **core, "P": numbers(found.lyapunov.P), "peak": str(found.lyapunov.peak), **slope}


def _core(form: Form, found: CoreBound) -> Evidence | None:
    """P for the core in scaled coordinates of integrators, |P G|, and the bound of dc/dw in them."""
    slope = _sloped(form, found.steep)
    return slope and {"P": numbers(found.lyapunov.P), "push": str(found.push), **slope}


def _decay(form: Form, found: Decay) -> Evidence:
    """P and the multipliers of the form, in scaled coordinates of integrators."""
    return {"units": _powers(found), "P": numbers(found.P), "mu": str(found.mu), "tau": str(found.tau)}


def _sector(form: Form, found: SectorBound) -> Evidence | None:
    """The same with its margin, and the bound of dc/dw."""
    slope, decay = _sloped(form, found.steep), found.decay
    return slope and {**_decay(form, decay), "peak": str(decay.peak), "margin": str(decay.margin), **slope}


def _held(form: Form, found: Held) -> Evidence:
    """A lower bound of P of the claim of convergence."""
    return {"least": str(found.least)}


def _weighted(form: Form, found: Weighted) -> Evidence:
    """P and b of D."""
    peak = {} if found.peak is None else {"peak": str(found.peak)}
    return {"P": numbers(found.P), "b": str(found.b), **peak}


def _sloped(form: Form, found: Steep, wider: float = 1e-9) -> Evidence | None:
    """A bound of dc/dw in scaled coordinates of integrators."""
    slope = steep(form, (*form.b, *found.scale), found.proof, wider)
    return slope and {"units": list(map(str, found.units)), "scale": [text(form, s) for s in found.scale], **slope}


def _steep(form: Form, found: Steep | None) -> Evidence | None:
    """The same where it has room, since no threshold is printed of it."""
    return None if found is None else _sloped(form, found, LOOSE)


def _candidate(form: Form, found: Candidate) -> Evidence:
    return {"P": numbers(found.P)}


def _adapting(form: Form, proof: Adapting) -> Evidence | None:
    """P, lambda_max(P), k and lambda."""
    slope, found = _steep(form, proof.given.steep), proof.found
    return slope and {"P": numbers(found.P), "peak": str(found.peak), "decay": str(found.decay), **slope}


def _attenuating(form: Form, proof: Attenuating) -> Evidence | None:
    """The same with the disturbance, for the k as written: s of (87), and mu."""
    slope, found, disturbed = _steep(form, proof.given.steep), proof.found, proof.given.disturbance
    if slope is None or disturbed is None:
        return None
    given = replace(proof.given, slope=Fraction(slope["bound"]))
    share, mu = share_given(found, given), gain(found, given)
    if share is None or mu is None:
        return None
    return {
        "P": numbers(found.P),
        "peak": str(found.peak),
        "G_1": numbers(disturbed.plant),
        "G_2": list(map(str, disturbed.measurement)),
        "delta_1": str(disturbed.deltas[0]),
        "share": str(share),
        "mu": str(mu),
        **slope,
    }


def _persistent(form: Form, found: Persistent) -> Evidence:
    """The inputs in time, and when they show every state."""
    period = {} if found.period is None else {"period": written(found.period, set())}
    inputs = {name: written(e, {"t"}) for name, e in found.inputs.items()}
    return {"inputs": inputs, "at": written(found.at, set()), **period}


def _powers(found: Decay) -> list[str]:
    return [str(found.growth**i) for i in range(len(found.P))]


def numbers(matrix: Iterable[Iterable[Fraction]]) -> list[list[str]]:
    """A matrix as texts."""
    return [[str(value) for value in row] for row in matrix]


def _nothing(form: Form, found: None) -> Evidence:
    """For claims that follow from the observer's numbers and another claim."""
    return {}


_MAKERS: dict[type, Callable[..., Evidence | None]] = {
    ThetaBound: _constant_gain,
    CoreBound: _core,
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
