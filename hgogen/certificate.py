"""Certificates: what was proved of a model, as a JSON value that `hgogen.recheck` verifies again.

    {"format": "hgogen certificate", "version": "1", "hgogen": its version,
     "plant": {"name", "states", "inputs", "parameters": [{"name", "low", "high"}], "outputs": [name], "flow",
               "output"},
     "form": {"kind", "states", "to_form", "from_form", "A", "b", "output", "blocks", "alignment"},
     "observer": {"theta", "gains"} or null,
     "claims": [{"id", "verdict", "evidence"}],
     "digest": SHA-256 of all the rest}

Numbers are exact and texts, "7/2" or "0.05"; an infinite end of a range is null; a parameter without a range has its
value as both ends. x' = flow(x, u), y = output(x, u) is the plant as first declared, z = to_form(x), x = from_form(z),
z' = A z + b, y = output the form, with the number of states of each output's chain, and how chains may read each other.
An observer is z' = A z + b(sat z) + diag(theta, .., theta^n) gains (y - output(z)), b's argument clamped to the box.

Evidence of an enclosure: "expression", "box", "low", "high", "tree"; of a Lipschitz bound: "box", "bound" of |db/dz| in
the spectral norm, "tree"; of a refutation: "expression", "witness", and "other" where the sign is another; of a phase
form: "chain" (y, y', ..) in the plant's states; of convergence: "scale" S, "core" N = S (A - gains C) S^-1, "P" with
N'P + P N <= -I, "peak" >= lambda_max(P), and the Lipschitz bound of b in the coordinates S z. A tree is a bisection in
prefix order: a name cuts its side of the box at the midpoint (an unbounded side at 0, beyond 0 at twice its end and
one), a dot is a leaf.

A claim is "proved" or "refuted" here only if its evidence is verified by `hgogen.recheck`; what has no such evidence is
"stated", with a reason, and so are open verdicts as they are: they assert nothing.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import sympy as sp

from hgogen.box import box
from hgogen.certified import ThetaBound
from hgogen.check import Check, Verdict
from hgogen.errors import HgogenError
from hgogen.evidence import end, evidence, text
from hgogen.form import Form
from hgogen.recheck import recheck
from hgogen.recheck_file import FORMAT, VERSION, digest
from hgogen.recheck_text import Unreadable
from hgogen.signal import Signal


@dataclass(eq=False)
class NotCertifiable(HgogenError):
    """A model that a certificate cannot carry."""

    plant: str
    reason: str

    def __str__(self) -> str:
        return f"no certificate of {self.plant!r}: {self.reason}"


def certificate(form: Form, checks: Iterable[Check]) -> dict[str, Any]:
    """The certificate of a form's checks.

    What `hgogen.recheck` does not verify is "stated" in it, not "proved".

    Raises: `NotCertifiable` for a model with functions that the certificate's grammar has not (Piecewise, floor).
    """
    checks = tuple(checks)
    claims = [_claim(form, check) for check in checks]
    found = _sealed({**_model(form), "observer": _observer(form, checks), "claims": claims})
    try:
        rows = recheck(json.dumps(found)).rows
    except Unreadable as error:
        raise NotCertifiable(form.system.name, error.reason) from None
    failed = {row.id: row.sentence for row in rows if row.found == "fails"}
    return _sealed({**found, "claims": [_demoted(claim, failed) for claim in claims]})


def stated(content: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The ids and reasons of the claims that were proved or refuted, and that a certificate could not give evidence
    of."""
    return tuple(
        (claim["id"], claim["evidence"]["reason"]) for claim in content["claims"] if claim["verdict"] == "stated"
    )


def _sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    return {**content, "digest": digest(content)}


def _demoted(claim: Mapping[str, Any], failed: Mapping[str, str]) -> dict[str, Any]:
    if claim["id"] not in failed:
        return dict(claim)
    reason = f"{claim['verdict']}, but a second arithmetic does not show it: {failed[claim['id']]}"
    return {"id": claim["id"], "verdict": "stated", "evidence": {"reason": reason}}


# --- the model


def _model(form: Form) -> dict[str, Any]:
    system = form.system
    plant = system if system.origin is None else system.origin.plant

    def written(rows: Iterable[sp.Expr]) -> list[str]:
        return [text(form, row) for row in rows]

    inverse = [expression for _, expression in form.estimates]
    return {
        "format": FORMAT,
        "version": VERSION,
        "hgogen": version("hgogen"),
        "plant": {
            "name": plant.name,
            "states": _ranges(plant.states),
            "inputs": _ranges(system.inputs),
            "parameters": _ranges(system.parameters, system.nominal),
            "outputs": [y.name for y in plant.outputs],
            "flow": written(plant.flow),
            "output": written(plant.output),
        },
        "form": {
            "kind": form.kind,
            "states": _ranges(form.states),
            "to_form": written(form.entry),
            "from_form": written(inverse),
            "A": [written(form.A.row(i)) for i in range(form.n)],
            "b": written(form.b),
            "output": written(form.output),
            "blocks": list(map(str, form.blocks)),
            "alignment": form.alignment,
        },
    }


def _observer(form: Form, checks: Iterable[Check]) -> dict[str, Any] | None:
    """The gains that a bound on theta was found for."""
    found = next((proof for check in checks for proof in check.proofs if isinstance(proof, ThetaBound)), None)
    if found is None:
        return None
    return {"theta": str(found.chosen), "gains": [text(form, gain) for gain in found.gains]}


def _ranges(signals: Iterable[Signal], nominal: Mapping[Signal, sp.Rational] | None = None) -> list[dict[str, Any]]:
    return [{"name": s.name, "low": end(low), "high": end(high)} for s, (low, high) in box(signals, nominal).items()]


# --- the claims


def _claim(form: Form, check: Check) -> dict[str, Any]:
    found = evidence(form, check)
    if found is None:
        open_ = check.verdict not in (Verdict.PROVED, Verdict.REFUTED)
        verdict, prefix = (str(check.verdict), "") if open_ else ("stated", f"{check.verdict}: ")
        return {"id": check.id, "verdict": verdict, "evidence": {"reason": f"{prefix}{check.reason}"}}
    return {"id": check.id, "verdict": str(check.verdict), "evidence": found}
