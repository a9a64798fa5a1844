"""The evidence of a claim about an error system, inequality (38): how the plant makes it, its bisections, the level of
V."""

from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.certificates.of_forms import Evidence, end, tree, written
from hgogen.check import Check, Verdict
from hgogen.guarantees.dissipation import Dissipates
from hgogen.guarantees.error_system import Equations, ErrorSystem, Injection
from hgogen.intervals.box import Box
from hgogen.intervals.proof import Proof


def evidence(check: Check) -> Evidence | None:
    """The evidence of a proved check; None where the check is not proved, or has no evidence of this kind."""
    dissipation = next((proof for proof in check.proofs if isinstance(proof, Dissipates)), None)
    if dissipation is None or dissipation.system.origin is None or check.verdict is not Verdict.PROVED:
        return None
    system = {"system": _system(dissipation, dissipation.system.origin)}
    if dissipation.floor is not None:
        return {**system, "floor": str(dissipation.floor)}
    answer, names = dissipation.answer, _names(dissipation)
    if answer is None or answer.basis is None:
        return None
    left = {} if dissipation.left is None or answer.share == 1 else {"left": written(dissipation.left, names)}
    return {
        **system,
        "share": str(answer.share),
        "basis": [[str(value) for value in row] for row in answer.basis.tolist()],
        "slabs": [_slab(proof, -1 if dissipation.left is None else 1) for proof in answer.proofs[1:]],
        **left,
    }


def _names(dissipation: Dissipates) -> set[str]:
    """The names of the errors and of the signals of the error system."""
    return {s.name for s in (*dissipation.system.errors, *dissipation.system.box)}


def made_elsewhere(check: Check) -> bool:
    """Whether a check is about an error system that was given, and not made of the plant."""
    return any(isinstance(proof, Dissipates) and proof.system.origin is None for proof in check.proofs)


def _system(dissipation: Dissipates, made: Injection | Equations) -> dict[str, Any]:
    """The description of the error system in a claim: how it is made of the plant, the ranges of e, V and mu."""
    names = {s.name for s in (*dissipation.system.errors, *dissipation.system.box, *made.names)}
    own = _equations(dissipation.system, made, names) if isinstance(made, Equations) else _injection(made, names)
    return {**own, "errors": _ranges(dissipation.within), "V": written(dissipation.V, names), "mu": str(dissipation.mu)}


def _injection(made: Injection, names: set[str]) -> dict[str, Any]:
    return {key: _rows(M, names) for key, M in (("gain", made.gain), ("G1", made.G1), ("G2", made.G2))}


def _equations(system: ErrorSystem, made: Equations, names: set[str]) -> dict[str, Any]:
    """The outputs by their places, y_1, y_2, .."""
    seen = {y: sp.Symbol(f"y_{k}", real=True) for k, y in enumerate(made.outputs, 1)}
    known = names | {y.name for y in seen.values()}
    return {
        "observer": [written(row.xreplace(seen), known) for row in made.observer],
        "unknown": [w.name for w in made.unknown],
        "along": {x.name: written(value, names) for x, value in made.along},
        "flow": [written(row, names) for row in system.flow],
        "noise": _rows(system.noise, names),
    }


def _rows(M: sp.ImmutableDenseMatrix, names: set[str]) -> list[list[str]]:
    return [[written(cell, names) for cell in row] for row in M.tolist()]


def _ranges(box: Box) -> list[dict[str, str | None]]:
    return [{"name": s.name, "low": end(low), "high": end(high)} for s, (low, high) in box.items()]


def _slab(proof: Proof, way: int) -> dict[str, str]:
    """S < 0 (`way` 1), or -V < 0 as V > 0 (-1), half of what was proved, so that a weaker arithmetic reaches it."""
    assert proof.high is not None  # it is negative
    return {"tree": tree(proof), "bound": str(way * Fraction(f"{float(proof.high) / 2:.6g}"))}
