"""Certificates of an observer with a kind of proof that is new: what no rule verifies is stated, and its C is
emitted."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import plants
import pytest

import hgogen as hg
from hgogen.analysis.evidence import Grounds, texts
from hgogen.certificates.certificate import OtherNumbers, certificate, fingerprint, stated
from hgogen.prove.convergence import AtTheta, DecayProof, FromTheta, convergence_checks
from hgogen.prove.inequality import Piece
from hgogen.prove.quadratic import Weights
from hgogen.prove.questions import InputBound
from hgogen.prove.region import Region
from hgogen.recheck.inequality import BOUND, NORM
from hgogen.recheck.verification import recheck


@dataclass(frozen=True)
class Margin:
    """A proof of a kind that no rule verifies, of every theta above 3."""

    theta: Fraction = Fraction(20)
    alpha: Fraction = Fraction(1)
    rate: float = 0.5
    how: str = "hand"

    @property
    def error(self) -> "Margin":
        """It knows nothing of the slopes."""
        return self

    @property
    def least(self) -> "Margin":
        """At 3."""
        return replace(self, theta=Fraction(3))

    @property
    def fastest(self) -> "Margin":
        """Here."""
        return self

    def evidence(self, form: hg.Form) -> None:
        """There is none."""


@dataclass(frozen=True)
class Renamed:
    """A proof of a kind that no table names; it writes the evidence of the one that it holds."""

    bound: FromTheta

    def evidence(self, form: hg.Form) -> Mapping[str, Any] | None:
        """How slopes are bounded, theta, and the matrix P."""
        return self.bound.evidence(form)


def proved(name: str = "newcomer", numbers: Any = None) -> hg.Observer:
    """An observer with a proof of its own, which `recheck` knows nothing of unless it knows the name."""
    built = plants.pendulum()
    own = convergence_checks(name, built.form, Margin(), {"theta": 20, **(numbers or {"gains": (1, Fraction(2, 3))})})
    return replace(built, name=name, claims=lambda: (*built.form.checks, *own))


def written(observer: hg.Observer) -> dict[str, Any]:
    return certificate(observer.form, observer.checks, observer.name)


def test_what_no_rule_verifies_is_stated() -> None:
    content = written(proved())
    assert [id for id, _ in stated(content)] == ["newcomer.convergence", "newcomer.theta"]
    assert content["observer"] == {"name": "newcomer"}
    findings = {row.id: row.found for row in recheck(json.dumps(content)).rows}
    assert findings.pop("newcomer.convergence") == findings.pop("newcomer.theta") == "stated"
    assert set(findings.values()) == {"verified"}


def test_its_c_is_emitted() -> None:
    observer = proved()
    model = fingerprint(observer.form, observer.checks, observer.name)
    header = next(iter(hg.targets.c99(hg.sample(observer, dt=1e-3)).values()))
    assert model[:16] in header


def test_a_new_kind_of_proof_writes_its_own_evidence() -> None:
    """What is written is what the rules of the observer verify."""
    built = hg.observers.low_power(plants.pendulum().form, theta=1e4)
    renamed = replace(built, claims=lambda: tuple(map(of_another_kind, built.checks)))
    facts = [proof.fact for check in renamed.checks for proof in check.proofs if isinstance(proof, Grounds)]
    assert list(map(type, facts)) == [Renamed, AtTheta]
    assert written(renamed) == written(built)
    assert not stated(written(renamed))


def of_another_kind(check: hg.Check) -> hg.Check:
    """The check with a `FromTheta` of its proofs in a new kind of proof."""

    def other(proof: Any) -> Any:
        core = isinstance(proof, Grounds) and isinstance(proof.fact, FromTheta)
        return replace(proof, fact=Renamed(proof.fact)) if core else proof

    return replace(check, proofs=tuple(map(other, check.proofs)))


def test_other_numbers_than_the_rule_reads_are_told() -> None:
    """The fix is in the file of the rule or in the proof, not in another run of the command."""
    observer = proved("low_power", {"gains": (1, 2), "margin": 2})
    said = "are of the numbers gains, margin, theta; its row in OBSERVERS of hgogen/recheck/rules says gains, theta"
    with pytest.raises(OtherNumbers, match=f"^the proofs of the observer 'low_power' {said}"):
        written(observer)


_ONE = Fraction(1)
_NORM = Weights(((_ONE,),), (_ONE,))


@pytest.mark.parametrize(
    ("proof", "keys"),
    [
        (_NORM, NORM),
        (InputBound(_ONE, _NORM, _ONE), BOUND),
        (Piece(Fraction(0), _ONE, _NORM), ("low", "high", *NORM)),
        (Region(_NORM, _ONE, (_ONE,)), (*NORM, "level", "first")),
        (DecayProof(_ONE, _ONE, _NORM, {"b": _ONE}), ("P", "b", "S")),
        (DecayProof(_ONE, _ONE, replace(_NORM, S=())), ("P",)),
        ({"state": 1, "V": _NORM, "each": [_NORM]}, ("state", *NORM, "each")),
    ],
)
def test_a_proof_is_written_by_the_keys_that_the_checker_reads(proof: Any, keys: tuple[str, ...]) -> None:
    """Its own fields and those of the proofs in it, also in a mapping and in a list."""
    written = texts(proved().form, proof)
    assert written is not None
    assert tuple(written) == keys
    assert written["P"] == [["1"]]
    assert written.get("each", [{"P": [["1"]], "S": ["1"]}]) == [{"P": [["1"]], "S": ["1"]}]
