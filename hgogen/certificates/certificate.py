"""Certificates: the proved claims about a model, as a JSON value that `recheck.verification` verifies again.

    {"format": "hgogen certificate", "version": "3", "hgogen": its version,
     "plant": {"name", "states", "inputs", "parameters": [{"name", "low", "high"}], "outputs": [name], "flow",
               "output"},
     "form": {"kind", "states", "to_form", "from_form", "A", "b", "output", "blocks", "alignment"},
     "observer": {"name"}, and the numbers of the observer if a claim is about it; or null,
     "model": SHA-256 of plant, form and observer,
     "claims": [{"id", "verdict", "evidence"}],
     "digest": SHA-256 of all the other keys}

Plant and form have "periods", {name: "2*pi"}, where a signal has one; the range of an angle is a whole turn. A plant
has "times", the inputs that are times, of which the rate is 1. Numbers are exact and texts, "7/2" or "0.05"; an
infinite end of a range is null; a parameter without a range has its value as both ends. The plant as first declared is
x' = flow(x, u), y = output(x, u). The form is z = to_form(x), x = from_form(z), z' = A z + b, y = output, with the
number of states of each output's chain, and the alignment of chains.

A high_gain observer is z' = A z + b(sat z) + diag(theta, .., theta^n) gains (y - output(z)), b's argument clamped to
the box. For several chains gains act chain by chain. Or they are a matrix, row by row, whose entry for the state i and
the output of chain k is multiplied by theta^(p(i) - p(k) + 1), p the powers of theta that scale states. An output whose
chain has no states, and that is a multiple of another's, shares the mean of their errors (`analysis.scaling`), by the
observer's "weights", one for each output. Of a form "phase.recovered" b is taken at the recovered state instead. In
circle_criterion b has the argument sat(z + N (y - output(z))) in place of sat z, N of the numbers "argument" in the
order of gains, each times theta^(p(i) - p(k)). from_form is the plain inverse: the observer's inverse is the same on
the image of the plant's ranges, and keeps its denominators off 0 beyond. The files of `hgogen.recheck.rules` state the
equations and numbers of the other observers.

The banner of the C contains `model` as well. The digests detect accidents; they are no signature.

Evidence of an enclosure: "expression", "box", "low", "high", "tree"; of a Lipschitz bound: "box", "bound" of |db/dz| in
the spectral norm, "tree"; of a refutation: "expression", "witness", and "other" where the sign is another; of a phase
form: "chain" (y, y', ..) in the plant's states; of its injectivity: "weights" L, and of L dPhi/dx the enclosures of the
"minors" at "places"; of the convergence of an observer of a constant injection: "scale" S, the ranges of the "slopes"
of b in S z, each of "row", "column", "low", "high" (null of no end), "tree", with "core" N = S (A - gains C) S^-1, or
"ranges", the enclosures of the a_i, or "units" s_i of which S is s_i a_1 .. a_i, and "P", with multipliers "S" or
without, of a quadratic Lyapunov function at the theta "least"; of the rate at theta: "alpha" and its "P", with its "S";
of initial errors that stay below half a turn: "P", "S", "level", "first".
Of other observers: "units", "scale", and the keys in the docstrings of their modules. Of inequality (38): the "gain" of
the observer, the disturbances "G1" and "G2" and the ranges of the "errors", from which the system is rebuilt, with V
and mu; on which "share" of the box of errors its second order is definite in which "basis"; "slabs" cover the
remainder, "floor" is that of V on the faces. A tree is a bisection in prefix order: a name cuts its side of the box at
the midpoint (an unbounded side at 0, beyond 0 at twice its end and one), a dot is a leaf.

A claim is "proved" or "refuted" here only if `hgogen recheck` verifies its evidence. A claim without such evidence is
"stated", with a reason. Open verdicts are copied: they assert nothing.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import sympy as sp

from hgogen.analysis.evidence import Grounds, certificate_text, end_text, exact_texts, texts
from hgogen.check import Check, Verdict
from hgogen.errors import BadArgument
from hgogen.form import Form
from hgogen.recheck.file import FORMAT, VERSION, digest, model_digest
from hgogen.recheck.rules import OBSERVERS
from hgogen.recheck.text import Unreadable
from hgogen.recheck.verification import read, recheck
from hgogen.registry import version
from hgogen.rigor.box import box
from hgogen.rigor.periodic import exact_turn
from hgogen.signal import Signal
from hgogen.system import demand_continuous


class NotCertifiable(BadArgument):
    """The error that a certificate cannot represent a model."""

    text = (
        "no certificate of {what!r}: {reason}; a certificate holds + - * / **, the elementary "
        "functions, Abs, sign, Min, Max and tables: write the model by them"
    )


class OtherNumbers(BadArgument):
    """The error that the arguments in an observer's proofs differ from those in the checker's table
    `recheck.rules.OBSERVERS`."""

    text = (
        "the proofs of the observer {what!r} are of the numbers {reason}; write the same names in its Grounds and in "
        "that row"
    )


class NoClaims(BadArgument):
    """The error that an argument of `certificate` is no form, no sequence of checks or no name of an observer."""


def certificate(form: Form, checks: Iterable[Check], observer: str = "") -> dict[str, Any]:
    """Return the certificate of a form's `checks`, as a JSON value, and of the observer with the name `observer`, ""
    for none. A claim whose evidence `recheck.verification` does not verify has the verdict "stated" in the certificate,
    not "proved". Raises: `NotCertifiable` for a model with functions that the grammar lacks (Piecewise, floor);
    `OtherNumbers` for an observer that does not fit its rules; `NoClaims` for an argument that is no form, check or
    name."""
    checks = _demanded(form, checks, observer)
    claims = [_claim(form, check) for check in checks]
    content = sealed({**head(form, checks, observer), "claims": claims})
    try:
        rows = recheck(json.dumps(content)).rows
    except Unreadable as error:
        raise NotCertifiable(form.system.name, error.fault) from None
    failed = {row.id: row.sentence for row in rows if row.found == "fails"}
    for k, claim in enumerate(claims):
        if claim["id"] in failed:
            reason = f"{claim['verdict']}, but a second arithmetic does not show it: {failed[claim['id']]}"
            claims[k] = {"id": claim["id"], "verdict": "stated", "evidence": {"reason": reason}}
    return sealed({**content, "claims": claims})


def _demanded(form: object, checks: object, observer: object) -> tuple[Check, ...]:
    if not isinstance(form, Form):
        raise NoClaims(f"{type(form).__name__} given to certificate", "is no form; give observer.form, observer.checks")
    demand_continuous(form.system, "certificate")
    each = tuple(checks) if isinstance(checks, Iterable) else (checks,)
    if not isinstance(checks, Iterable) or not all(isinstance(check, Check) for check in each):
        wrong = next((one for one in each if not isinstance(one, Check)), each[0])
        fix = "is no sequence of checks; give observer.checks, and of each bound its .check"
        raise NoClaims(f"{type(wrong).__name__} given to certificate", fix)
    if not isinstance(observer, str):
        raise NoClaims(f"observer = {observer!r}", "is no name; give observer.name, or leave it out")
    return tuple(check for check in each if isinstance(check, Check))


def asserted(content: Mapping[str, Any]) -> int:
    """Return the number of claims in a certificate with the verdict "proved" or "refuted"."""
    return sum(claim["verdict"] in ("proved", "refuted") for claim in content["claims"])


def stated(content: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return (id, reason) of each claim in a certificate with the verdict "stated": it is proved or refuted, but
    without evidence that a checker verifies."""
    return tuple(
        (claim["id"], claim["evidence"]["reason"]) for claim in content["claims"] if claim["verdict"] == "stated"
    )


def _claim(form: Form, check: Check) -> dict[str, Any]:
    proofs_by_verdict = {Verdict.PROVED: check.proofs[:1], Verdict.REFUTED: (check.disproof,)}.get(check.verdict)
    if proofs_by_verdict is None:
        return {"id": check.id, "verdict": str(check.verdict), "evidence": {"reason": str(check.reason)}}
    proof = next(filter(None, proofs_by_verdict), None)
    evidence = proof and texts(form, proof)
    if evidence is None:
        unwritten = getattr(proof, "unwritten", "")
        reason = f"{check.verdict}: {check.reason}{unwritten and f', {unwritten}'}"
        return {"id": check.id, "verdict": "stated", "evidence": {"reason": reason}}
    return {"id": check.id, "verdict": str(check.verdict), "evidence": evidence}


def head(form: Form, checks: Iterable[Check], observer: str) -> dict[str, Any]:
    """Return the head of a certificate, all its entries except the claims: format, plant, form and observer."""
    system = form.system
    plant = system.declared
    about = {
        "plant": {
            "name": plant.name,
            "states": _ranges(plant.states),
            "inputs": _ranges(system.inputs),
            "parameters": _ranges(system.parameters, system.nominal),
            "outputs": [y.name for y in plant.outputs],
            "flow": _written(form, plant.flow),
            "output": _written(form, plant.output),
            **_periods((*plant.states, *system.inputs, *plant.outputs)),
            **({"times": [w.name for w in system.times]} if system.times else {}),
        },
        "form": {
            "kind": form.kind if form.behind is None else f"{form.kind}.recovered",
            "states": _ranges(form.states),
            "to_form": _written(form, form.entry),
            "from_form": _written(form, (expression for _, expression in form.estimates)),
            "A": [_written(form, form.A.row(i)) for i in range(form.n)],
            "b": _written(form, form.b),
            "output": _written(form, form.output),
            "blocks": list(map(str, form.blocks)),
            "alignment": form.alignment,
            **_periods(form.states),
        },
        "observer": _observer(form, checks, observer),
    }
    return {"format": FORMAT, "version": VERSION, "hgogen": version(), **about, "model": model_digest(about)}


def _written(form: Form, rows: Iterable[sp.Expr]) -> list[str]:
    return [certificate_text(form, row) for row in rows]


def _observer(form: Form, checks: Iterable[Check], name: str) -> dict[str, Any] | None:
    """Return the observer's name and the gains that a proof depends on. Other
    gains are left out, since nothing is verified with them; None for a
    member of a bank of observers, whose claims are not about the bank."""
    if not name:
        return None
    proofs = (proof for check in checks if check.id.maker == name for proof in check.proofs)
    grounds = next((proof for proof in proofs if isinstance(proof, Grounds)), None)
    if grounds is None or name not in OBSERVERS:
        return {"name": name}
    wanted = sorted((*OBSERVERS[name].numbers, *OBSERVERS[name].expressions))
    if sorted(grounds.numbers.keys() - {*OBSERVERS[name].optional}) != wanted:
        row = f"its row in OBSERVERS of hgogen/recheck/rules says {', '.join(wanted)}"
        raise OtherNumbers(name, f"{', '.join(sorted(grounds.numbers))}; {row}")
    return {"name": name, **{key: exact_texts(form, value) for key, value in grounds.numbers.items()}}


def _ranges(signals: Iterable[Signal], nominal: Mapping[Signal, sp.Rational] | None = None) -> list[dict[str, Any]]:
    return [
        {"name": s.name, "low": end_text(low), "high": end_text(high)}
        for s, (low, high) in box(signals, nominal).items()
    ]


def _periods(signals: Iterable[Signal]) -> dict[str, dict[str, str]]:
    """Return the periods of angles by name under the key "periods"; nothing where there are none."""
    periods = {s.name: str(exact_turn(s.period)) for s in signals if s.period is not None}
    return {"periods": periods} if periods else {}


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a certificate with its digest added, under the key "digest"."""
    return {**content, "digest": digest(content)}


def fingerprint(form: Form, checks: Iterable[Check], observer: str) -> str:
    """Return the digest of the model (plant, form, observer) that a certificate of these arguments has under the key
    "model", without proofs. Raises: `NotCertifiable`; `OtherNumbers`."""
    content = sealed({**head(form, checks, observer), "claims": []})
    try:
        return read(json.dumps(content)).model
    except Unreadable as error:
        raise NotCertifiable(form.system.name, error.fault) from None
