"""The evidence of a claim about an observer: what `recheck.recheck` needs to verify it, by what was found of it."""

from collections.abc import Callable, Iterable
from fractions import Fraction

from hgogen.check import Check, Verdict
from hgogen.convergence.certified import ThetaBound
from hgogen.convergence.certified_core import CoreBound
from hgogen.convergence.sector import Decay, SectorBound
from hgogen.evidence import Evidence, enclosure, steep, text
from hgogen.form import Form
from hgogen.intervals.proof import Grounds
from hgogen.structure.polytope import chains


def evidence(form: Form, check: Check) -> Evidence | None:
    """What shows a proved check; None where nothing here does."""
    if check.verdict is not Verdict.PROVED:
        return None
    for proof in check.proofs:
        if isinstance(proof, Grounds):
            make = _MAKERS[type(proof.fact)]
            return make(form, proof.fact)
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
    slope = steep(form, (*form.b, *found.scale), found.slope)
    return slope and {
        "units": list(map(str, found.units)),
        "scale": [text(form, s) for s in found.scale],
        "P": numbers(found.lyapunov.P),
        "push": str(found.push),
        **slope,
    }


def _decay(form: Form, found: Decay) -> Evidence:
    """P and the multipliers of the form, in scaled coordinates of integrators."""
    return {"units": _powers(found), "P": numbers(found.P), "mu": str(found.mu), "tau": str(found.tau)}


def _sector(form: Form, found: SectorBound) -> Evidence | None:
    """The same with its margin, and the bound of dc/dw."""
    slope, decay = steep(form, (*form.b, *found.scale), found.slope), found.decay
    return slope and {
        **_decay(form, decay),
        "scale": [text(form, s) for s in found.scale],
        "peak": str(decay.peak),
        "margin": str(decay.margin),
        **slope,
    }


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
    type(None): _nothing,
}
