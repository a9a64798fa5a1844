"""What is proved of (38), inequality and level, and its evidence: how the plant makes the error system, the bisections
of the inequality, the level of V."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import sympy as sp

from hgogen.evidence.grammar import end, spelled, tree
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.guarantees.error_system import Equations, ErrorSystem, Injection
from hgogen.intervals.box import Box
from hgogen.intervals.proof import Proof
from hgogen.intervals.second_order import Answer


@dataclass(frozen=True)
class Dissipates:
    """What a claim of (38) is about, and what was found of it: the `answer`, of the `left` side or of V, or `floor`,
    below which {V <= c} keeps off the faces of the box `within` of the errors."""

    system: ErrorSystem
    V: sp.Expr
    mu: sp.Rational
    within: Box = field(hash=False)
    answer: Answer | None = field(default=None, hash=False)
    left: sp.Expr | None = None
    floor: Fraction | None = None

    @property
    def unwritten(self) -> str:
        """Why a certificate cannot show it, "" where it can."""
        return "" if self.system.origin else "of an error system that is given and not made of the plant"

    def evidence(self, form: Form) -> Evidence | None:
        """The error system, and the floor or the bisections."""
        if self.system.origin is None:
            return None
        system = {"system": self._about(self.system.origin)}
        if self.floor is not None:
            return {**system, "floor": self.floor}
        answer = self.answer
        if answer is None or answer.basis is None:
            return None
        whole = self.left is None or answer.share == 1
        return {
            **system,
            "share": answer.share,
            "basis": answer.basis.tolist(),
            "slabs": [_slab(proof, -1 if self.left is None else 1) for proof in answer.proofs[1:]],
            **({} if whole else {"left": spelled(self.left, self._names)}),
        }

    @property
    def _names(self) -> set[str]:
        """The names of the errors and of the signals of the error system."""
        return {s.name for s in (*self.system.errors, *self.system.box)}

    def _about(self, made: Injection | Equations) -> dict[str, Any]:
        """How the error system is made of the plant, the ranges of e, V and mu."""
        names = self._names | {s.name for s in made.names}
        own = _equations(self.system, made, names) if isinstance(made, Equations) else _injection(made, names)
        errors = [{"name": s.name, "low": end(low), "high": end(high)} for s, (low, high) in self.within.items()]
        return {**own, "errors": errors, "V": spelled(self.V, names), "mu": str(self.mu)}


def _injection(made: Injection, names: set[str]) -> dict[str, Any]:
    return {key: _rows(M, names) for key, M in (("gain", made.gain), ("G1", made.G1), ("G2", made.G2))}


def _equations(system: ErrorSystem, made: Equations, names: set[str]) -> dict[str, Any]:
    """The outputs by their places, y_1, y_2, .."""
    seen = {y: sp.Symbol(f"y_{k}", real=True) for k, y in enumerate(made.outputs, 1)}
    known = names | {y.name for y in seen.values()}
    return {
        "observer": [spelled(row.xreplace(seen), known) for row in made.observer],
        "unknown": [w.name for w in made.unknown],
        "along": {x.name: spelled(value, names) for x, value in made.along},
        "flow": [spelled(row, names) for row in system.flow],
        "noise": _rows(system.noise, names),
    }


def _rows(M: sp.ImmutableDenseMatrix, names: set[str]) -> list[list[str]]:
    return [[spelled(cell, names) for cell in row] for row in M.tolist()]


def _slab(proof: Proof, way: int) -> dict[str, Any]:
    """S < 0 (`way` 1), or -V < 0 as V > 0 (-1), half of what was proved, so that a weaker arithmetic reaches it."""
    assert proof.high is not None  # it is negative
    return {"tree": tree(proof), "bound": way * Fraction(f"{float(proof.high) / 2:.6g}")}
