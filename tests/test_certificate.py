"""Certificates: what a model's file says is verified again; no changed number, and no false statement, is."""

import ast
import copy
import json
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from oracle.text import read as as_sympy
from plants import van_der_pol
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.analysis.evidence import outward
from hgogen.certificates.certificate import NotCertifiable, certificate
from hgogen.check import Check, Verdict
from hgogen.commands.claims import Checked, checked
from hgogen.model import load
from hgogen.recheck.file import VERSION, NoCertificate, digest, model_digest
from hgogen.recheck.text import Unreadable
from hgogen.recheck.verification import read, recheck

ROOT = Path(__file__).resolve().parents[1]
MODELS = sorted(p for p in ROOT.glob("models/*.*") if p.suffix in (".py", ".toml") and not p.name.startswith("_"))
PACKAGE = ROOT / "hgogen"
SAMPLES = 100
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def sealed(content: dict[str, Any]) -> str:
    """As a forger would write it: with the digests of the changed content."""
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def verified(text: str) -> bool:
    try:
        return not recheck(text).failed
    except (NoCertificate, Unreadable):
        return False


def findings(text: str) -> dict[str, str]:
    return {row.id: row.found for row in recheck(text).rows}


def bent_plant(low: float = -1) -> hg.System:
    """Two gains that need bisection, a sign, a permutation, transcendental rests, a parameter with a range."""
    x = [hg.Signal(f"x{i}", low=-2, high=3) for i in (1, 2, 3)]
    u, k = hg.Signal("u", low=low, high=1), hg.Signal("k", "", "", 0.5, low=0.25, high=1)
    y, c = hg.Signal("y"), hg.Signal("c", "", "", 0.3)
    flow = [
        -k * x[2] - c * x[0] * x[1] + sp.exp(-(x[1] ** 2)),
        (u**2 - u + 1) * x[0] + sp.sin(x[1]),
        sp.cos(x[0]) - x[2],
    ]
    return hg.System("bent", states=x, inputs=(u,), outputs=(y,), parameters=(k, c), flow=flow, output=[2 * x[1] + u])


@pytest.fixture(scope="module")
def bent() -> dict[str, Any]:
    form = hg.forms.triangular(bent_plant())
    return certificate(form, claimed(form))


def claimed(form: hg.Form) -> list[Check]:
    """The checks, all said to be proved: what is written then depends on what can be verified."""
    return [replace(check, verdict=Verdict.PROVED) for check in form.checks]


def of_model(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(text_of_model(path))
    return content


@cache
def claims_of_model(path: Path) -> Checked:
    return checked(load(path))


@cache
def text_of_model(path: Path) -> str:
    return written(claims_of_model(path))


def written(claims: Checked) -> str:
    return json.dumps(certificate(claims.form, claims.checks, claims.observer))


# --- what is written is verified ------------------------------------------------------------------------------------


@pytest.mark.ordinary("battery", "lotka_volterra", "sir")
@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_a_models_certificate_is_verified(path: Path) -> None:
    claims = claims_of_model(path)
    if claims.form.system.discrete:
        with pytest.raises(hg.HgogenError, match="certificate is for differential equations"):
            written(claims)
        return
    begin = time.process_time()
    text = written(claims)
    result = recheck(text)
    assert time.process_time() - begin < 60
    assert not result.failed
    assert {row.id for row in result.rows} == {check.id for check in claims.checks}
    assert text == text_of_model(path)


@pytest.mark.parametrize("name", ["cascaded_tanks", "fitzhugh_nagumo", "pendulum"])
def test_the_claims_on_the_form_carry_evidence(name: str) -> None:
    """None of them is only stated."""
    rows = recheck(json.dumps(of_model(ROOT / "models" / f"{name}.py"))).rows
    assert {row.found for row in rows if row.id.startswith(("triangular.", "recast."))} == {"verified"}


def test_a_slope_is_that_of_the_rows_as_they_are_given() -> None:
    """max(u, 5) is 5 on the box, and is proved as such: the model reads u all the same."""
    (x1, x2), u = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2")), hg.Signal("u", low=-1, high=1)
    flow = [x2, -sp.Max(u, 5) * sp.sin(x1)]
    plant = hg.System("pulled", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    form = hg.forms.triangular(plant)
    content = certificate(form, form.checks)
    assert claim_of(content, "triangular.lipschitz")["evidence"]["box"].keys() == {"u", "z1"}
    assert set(findings(json.dumps(content)).values()) == {"verified"}


def test_bisections_and_signs(bent: dict[str, Any]) -> None:
    result = recheck(json.dumps(bent))
    assert {row.id: row.found for row in result.rows} == dict.fromkeys(
        [
            "triangular.structure",
            *(f"triangular.a_{i}" for i in (1, 2, 3)),
            "triangular.offset",
            "triangular.lipschitz",
        ],
        "verified",
    )
    gains = {claim["id"]: claim["evidence"] for claim in bent["claims"]}
    low = Fraction(gains["triangular.a_2"]["low"])
    assert Fraction(3, 4) * Fraction(98, 100) < low <= Fraction(3, 4)
    assert " " in gains["triangular.a_2"]["tree"]


def test_a_refutation_carries_its_point() -> None:
    content = of_model(ROOT / "models" / "fitzhugh_nagumo.py")
    (refuted,) = [claim for claim in content["claims"] if claim["verdict"] == "refuted"]
    assert refuted["evidence"] == {"expression": "-u", "witness": {"u": "0"}}
    refuted["evidence"]["witness"]["u"] = "-1/2"  # a_2 = 1/2 there
    assert findings(sealed(content))["triangular.a_2"] == "fails"


def test_a_wrong_proof_is_not_written() -> None:
    """a_2 = -u on [-1, 1], called proved: the certificate says that it is stated only."""
    form = hg.forms.triangular(load(ROOT / "models" / "fitzhugh_nagumo.py").plant)
    content = certificate(form, claimed(form))
    assert claim_of(content, "triangular.a_2")["verdict"] == "stated"
    assert findings(json.dumps(content))["triangular.a_2"] == "stated"
    assert findings(json.dumps(content))["triangular.a_3"] == "verified"


def uniform_plant() -> hg.System:
    x = [hg.Signal(f"x{i}", low=1, high=2) for i in (1, 2)]
    u, y = hg.Signal("u", low=1, high=2), hg.Signal("y")
    return hg.System(
        "cube", states=x, inputs=(u,), outputs=(y,), flow=[x[1] ** 3 * u + x[0], -sp.sin(x[1])], output=[x[0]]
    )


def test_a_uniform_form() -> None:
    """The slope 3 u x2^2 has the range [3, 24]."""
    form = hg.forms.uniform(uniform_plant())
    content = certificate(form, form.checks)
    assert set(findings(json.dumps(content)).values()) == {"verified"}
    slope = claim_of(content, "uniform.slope_2")["evidence"]
    for end, value in (("low", "3000001/1000000"), ("high", "23999999/1000000"), ("low", "0")):
        forged = copy.deepcopy(content)
        claim_of(forged, "uniform.slope_2")["evidence"][end] = value
        assert findings(sealed(forged))["uniform.slope_2"] == "fails"
    assert Fraction(slope["low"]) > Fraction(29, 10)
    claim_of(content, "uniform.lipschitz")["evidence"]["bound"] = "24"  # |dF/dx| at (2, 2, 2) is 24.06
    assert findings(sealed(content))["uniform.lipschitz"] == "fails"


@pytest.mark.full
def test_a_slope_that_changes_its_sign() -> None:
    content = of_model(ROOT / "models" / "haldane.toml")
    claim = claim_of(content, "uniform.slope_2")
    assert (claim["verdict"], findings(json.dumps(content))["uniform.slope_2"]) == ("refuted", "verified")
    lies = ({"other": claim["evidence"]["witness"]}, {"expression": "1"}, {"witness": {"z2": "-100"}}, {"other": {}})
    for lie in lies:
        forged = copy.deepcopy(content)
        claim_of(forged, "uniform.slope_2")["evidence"].update(lie)
        assert findings(sealed(forged))["uniform.slope_2"] == "fails", lie


def measured_plant() -> hg.System:
    """x1' = (2 + sin x1) x2 - x1: the gain varies with what is measured."""
    x = [hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2)]
    y, flow = hg.Signal("y"), [(2 + sp.sin(x[0])) * x[1] - x[0], -(x[0] ** 2)]
    return hg.System("screen", states=x, outputs=(y,), flow=flow, output=[x[0]])


def test_gains_that_vary_with_the_measured_state() -> None:
    form = hg.forms.triangular(measured_plant(), measured=True)
    content = certificate(form, form.checks)
    assert set(findings(json.dumps(content)).values()) == {"verified"}
    assert claim_of(content, "triangular.a_2")["evidence"]["box"] == {"z1": ["-2", "2"]}
    other = copy.deepcopy(content)  # a gain may not vary with z2
    other["form"]["A"][0][1], other["form"]["b"][0] = "sin(z1) + 2 + z2", "-z1 - z2**2"
    assert findings(sealed(other))["triangular.structure"] == "fails"


# --- convergence ----------------------------------------------------------------------------------------------------


def heated_plant() -> hg.System:
    """x1' = a x2, x2' = -x1 - x2/5 + sin(x1)/4, y = 2 x1: the gains vary with a parameter."""
    x = [hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2)]
    a, y = hg.Signal("a", "", "", 1, low=0.5, high=2), hg.Signal("y")
    flow = [a * x[1], -x[0] - x[1] / 5 + sp.sin(x[0]) / 4]
    return hg.System("heated", states=x, outputs=(y,), parameters=(a,), flow=flow, output=[2 * x[0]])


OBSERVED = {"pendulum": lambda: load(ROOT / "models" / "pendulum.py").plant, "heated": heated_plant, "vdp": van_der_pol}


def observed(name: str, theta: float = 1e4) -> dict[str, Any]:
    observer = hg.observers.high_gain(hg.forms.triangular(OBSERVED[name]()), theta=theta, poles=(-1, -2))
    return certificate(observer.form, observer.checks, observer.name)


@pytest.mark.parametrize("name", OBSERVED)
def test_the_convergence_of_an_observer(name: str) -> None:
    content = observed(name)
    assert set(findings(json.dumps(content)).values()) == {"verified"}
    assert Fraction(content["observer"]["theta"]) == 10_000
    assert not falsehood(content)


def scaled(value: Any, factor: Fraction) -> Any:
    if isinstance(value, list):
        return [scaled(part, factor) for part in value]
    return str(Fraction(value) * factor)


CONVERGENCE_LIES = {
    "a smaller theta": lambda o, e: e.update(least=scaled(e["least"], Fraction(9, 10))),
    "a negative theta": lambda o, e: e.update(least=scaled(e["least"], Fraction(-1))),
    "a narrower slope": lambda o, e: e["slopes"][0].update(low=scaled(e["slopes"][0]["low"], Fraction(9, 10))),
    "no slope": lambda o, e: e["slopes"].pop(),
    "a P of its diagonal": lambda o, e: e.update(P=[[e["P"][0][0], "0"], ["0", e["P"][1][1]]]),
    "a negative P": lambda o, e: e.update(P=scaled(e["P"], Fraction(-1))),
    "a P that is not symmetric": lambda o, e: e["P"][0].__setitem__(1, "0"),
    "a P that is nearly symmetric": lambda o, e: e["P"][0].__setitem__(
        1, str(Fraction(e["P"][0][1]) + Fraction(1, 2**30))
    ),
    "a P of another size": lambda o, e: e.update(P=e["P"][:1]),
    "a faster core": lambda o, e: e.update(core=scaled(e["core"], Fraction(2))),
    "another scale": lambda o, e: e["scale"].__setitem__(1, "1000 + a"[: 4 if "a" not in e["scale"][1] else 8]),
    "a scale of zero": lambda o, e: e.update(scale=["0", "0"]),
    "a scale of a state": lambda o, e: e["scale"].__setitem__(0, "z1"),
    "other gains": lambda o, e: o["gains"].__setitem__(1, "1"),
    "gains of a state": lambda o, e: o["gains"].__setitem__(1, f"{o['gains'][1]} + z1 - z1"),
    "a bisection with a gap": lambda o, e: e["slopes"][0].update(tree=f"z1 {e['slopes'][0]['tree']}"),
}


@pytest.mark.parametrize("name", ["pendulum", "heated"])
@pytest.mark.parametrize("lie", CONVERGENCE_LIES)
def test_a_lie_about_convergence_fails(name: str, lie: str) -> None:
    content = observed(name)
    CONVERGENCE_LIES[lie](content["observer"], claim_of(content, "high_gain.convergence")["evidence"])
    result = findings(sealed(content))
    assert result["high_gain.convergence"] == result["high_gain.theta"] == "fails"


def test_an_unstable_core_has_no_proof() -> None:
    """K = -2 makes N = 2: a negative P satisfies the inequality."""
    slope = {"row": "1", "column": "1", "low": "-1", "high": "1", "tree": "."}
    shown = {"scale": ["1"], "least": "2", "slopes": [slope]}
    for K, N, P, holds in (("2", "-2", "1/2", True), ("-2", "2", "-1", False)):
        evidence = {**shown, "core": [[N]], "P": [[P]]}
        content = plain(claims=[{"id": "high_gain.convergence", "verdict": "proved", "evidence": evidence}])
        content["observer"] = {"name": "high_gain", "theta": "3", "gains": [K]}
        assert (findings(sealed(content))["high_gain.convergence"] == "verified") is holds


def test_theta_counts() -> None:
    """Above the bound it is proved, below it a forger is met; without an observer, or a structure, nothing holds."""
    content = observed("pendulum")
    evidence = claim_of(content, "high_gain.convergence")["evidence"]
    bound = Fraction(evidence["least"])
    claim_of(content, "high_gain.theta")["evidence"] = {}
    for theta, verdict in ((bound, "fails"), (bound + Fraction(1, 10**6), "verified")):
        content["observer"]["theta"] = str(theta)
        assert findings(sealed(content))["high_gain.theta"] == verdict
    assert claim_of(observed("pendulum", float(bound) / 2), "high_gain.theta")["verdict"] == "unknown"
    for change in (
        lambda c: c.update(observer=None),
        lambda c: claim_of(c, "triangular.structure").update(evidence={}, verdict="unknown"),
    ):
        forged = copy.deepcopy(content)
        change(forged)
        result = findings(sealed(forged))
        assert result["high_gain.convergence"] == result["high_gain.theta"] == "fails"


# --- several outputs ------------------------------------------------------------------------------------------------


def several(align: str) -> dict[str, Any]:
    """Two outputs, with chains of this alignment."""
    x = [hg.Signal(f"x{i}", low=-1, high=2) for i in range(1, 5)]
    u, y = hg.Signal("u", low=-1, high=1), (hg.Signal("y1"), hg.Signal("y2"))
    x1, x2, x3, x4 = x
    flows = {
        "top": ([(2 + u) * x2 + sp.sin(x1) * x3, x1 * x4, -3 * x4 + x1, x2 * x4], [x1, x3 + u]),
        "end": ([x2 * x3 * x4, x3 - x2, (2 + u) * x4, x1 * x2], [x1, x2]),
        "cascade": ([x2, -x1 * x2 + u, x4 + x2 * x3, sp.sin(x2) * x4], [x1, x3]),
    }
    flow, output = flows[align]
    plant = hg.System("several", states=x, inputs=(u,), outputs=y, flow=flow, output=output)
    form = hg.forms.block_triangular(plant, align)
    assert form.alignment == align, form
    return certificate(form, form.checks)


@pytest.mark.parametrize(
    ("align", "others"), [("top", ["cascade"]), ("end", ["top", "cascade"]), ("cascade", ["top", "end"])]
)
def test_chains_of_several_outputs(align: str, others: list[str]) -> None:
    """Chains of one length are aligned at both ends."""
    content = several(align)
    assert set(findings(json.dumps(content)).values()) == {"verified"}
    for other in (*others, "middle", ""):
        content["form"]["alignment"] = other
        assert findings(sealed(content))["block_triangular.structure"] == "fails", other


def test_lies_about_several_outputs() -> None:
    content = several("top")
    for blocks in (["1", "3"], ["4"], ["3", "1"], ["0", "4"], ["4", "0"]):
        forged = copy.deepcopy(content)
        forged["form"]["blocks"] = blocks
        assert not verified(sealed(forged))
    for blocks in (["2", "3"], ["5/2", "3/2"], [2, 2], ["-1", "5"]):
        forged = copy.deepcopy(content)
        forged["form"]["blocks"] = blocks
        with pytest.raises((NoCertificate, Unreadable)):
            recheck(sealed(forged))
    for id, end, value in (("a_1_2", "low", "1001/1000"), ("a_2_2", "high", "2999/1000"), ("a_2_2", "low", "0")):
        forged = copy.deepcopy(content)
        claim_of(forged, f"block_triangular.{id}")["evidence"][end] = value
        assert findings(sealed(forged))[f"block_triangular.{id}"] == "fails"
    for id in ("a_1_1", "a_2_2", "lipschitz", "structure"):
        forged = copy.deepcopy(content)
        forged["claims"] = [claim for claim in forged["claims"] if claim["id"] != f"block_triangular.{id}"]
        assert findings(sealed(forged))[f"block_triangular.{id}"] == "fails"
    claim_of(content, "block_triangular.a_1_2")["id"] = "block_triangular.a_3_1"
    assert findings(sealed(content))["block_triangular.a_3_1"] == "fails"


def test_a_cascade_has_no_circle() -> None:
    content = several("cascade")
    content["plant"]["flow"][1] += " + x3"
    content["form"]["b"][1] += " + z3"
    result = {row.id: row for row in recheck(sealed(content)).rows}
    assert "in a circle" in result["block_triangular.structure"].sentence


def test_a_changed_file_tells_what_still_holds() -> None:
    """The digest is one row of it, and fails."""
    content = of_model(ROOT / "models" / "pendulum.py")
    claim_of(content, "triangular.a_1")["evidence"]["high"] = "2"
    result = findings(json.dumps(content))
    assert result.pop("digest") == "fails"
    assert result["triangular.a_1"] == result["triangular.lipschitz"] == "verified"
    claim_of(content, "triangular.a_1")["evidence"]["low"] = "3/2"
    assert findings(json.dumps(content))["triangular.a_1"] == "fails"


def test_a_refuted_structure_leaves_nothing_to_verify() -> None:
    form = hg.forms.triangular(uniform_plant())
    content = certificate(form, form.checks)
    assert findings(json.dumps(content)) == {"triangular.structure": "stated"}
    claim_of(content, "triangular.structure").update(verdict="proved")
    result = findings(sealed(content))
    assert set(result.values()) == {"fails"}
    assert len(result) == 4


def driven_plant() -> hg.System:
    """y = x1, y' = x2 + u x1, y'' = (1 + x1^2) x3 + .. + u' x1: the determinant is that of the chain, 1 + x1^2."""
    x = [hg.Signal(f"x{i}", low=-1, high=2) for i in (1, 2, 3)]
    u, y = hg.Signal("u", low=-1, high=1, rates=((-3, 3),)), hg.Signal("y")
    flow = [x[1] + u * x[0], (1 + x[0] ** 2) * x[2], -sp.sin(x[2])]
    return hg.System("driven", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])


@pytest.mark.parametrize("original", [True, False])
def test_the_rank_of_a_phase_form(original: bool) -> None:
    form = hg.forms.phase(driven_plant(), original=original)
    content = certificate(form, form.checks)
    result = findings(json.dumps(content))
    assert result["phase.chain"] == result["phase.rank"] == "verified", recheck(json.dumps(content)).rows
    chain, rank = claim_of(content, "phase.chain")["evidence"], claim_of(content, "phase.rank")["evidence"]
    assert "u_dot" in chain["chain"][2]
    for holder, key, value, failing in (
        (rank, "low", "1001/1000", ["phase.rank"]),
        (rank, "low", "0", ["phase.rank"]),
        (rank, "high", "4999/1000", ["phase.rank"]),
        (rank, "expression", "3*x1**2/4 + 1", ["phase.rank"]),
        (rank, "box", {"x1": ["0", "2"]}, ["phase.rank"]),
        (rank, "tree", "x1 .", ["phase.rank"]),
        (chain, "chain", ["x2", *chain["chain"][1:]], ["phase.chain", "phase.rank"]),
        (chain, "chain", [f"2*({entry})" for entry in chain["chain"]], ["phase.chain"]),
        (chain, "chain", chain["chain"][:2], ["phase.chain", "phase.rank"]),
        (chain, "chain", [*chain["chain"][:2], chain["chain"][2].replace("u_dot", "u")], ["phase.chain"]),
    ):
        before, holder[key] = holder[key], value
        result = findings(sealed(content))
        assert {result[id] for id in failing} == {"fails"}, (key, value)
        holder[key] = before
    content["plant"]["flow"][2] += " + x1"  # seen by the third derivative first
    assert findings(sealed(content))["phase.rank"] == "verified"
    content["plant"]["flow"][1] += " + x1"
    assert findings(sealed(content))["phase.chain"] == "fails"


@pytest.mark.parametrize(("form", "verified"), [("block_triangular", set()), ("original", {"original.lipschitz"})])
def test_what_has_no_rule_is_stated(form: str, verified: set[str]) -> None:
    made = getattr(hg.forms, form)(uniform_plant())
    rows = recheck(json.dumps(certificate(made, made.checks))).rows
    assert {row.id for row in rows} == {check.id for check in made.checks}
    assert {row.id for row in rows if row.found == "verified"} == verified
    assert {row.found for row in rows} <= {"open", "stated", "verified"}


def test_piecewise_has_no_certificate() -> None:
    x, y = hg.Signal("x", low=0, high=1), hg.Signal("y")
    rate = sp.Piecewise((x, x > sp.Rational(1, 2)), (0, True))
    form = hg.forms.triangular(hg.System("steps", states=(x,), outputs=(y,), flow=[rate], output=[x]))
    with pytest.raises(NotCertifiable, match="steps"):
        certificate(form, form.checks)


def test_a_text_that_was_just_verified_is_not_verified_again() -> None:
    """As `certificate` does it of what it writes; a text that differs in one letter is another one."""
    content = of_model(ROOT / "models" / "pendulum.py")
    text = json.dumps(content)
    assert recheck(text) is recheck(json.dumps(content))
    assert [row.id for row in recheck(text.replace('"pendulum"', '"pendulun"', 1)).failed][:2] == ["digest", "model"]


@pytest.mark.parametrize("value", [0.5, -0.1, 1e-300, 123456.789, 1 / 3, -2e17])
def test_short_numbers_lie_outward(value: float) -> None:
    low, high = outward(value, -1), outward(value, 1)
    assert low <= Fraction(value) <= high
    assert high - low <= abs(Fraction(value)) * Fraction(1, 10**11)


# --- no changed number ----------------------------------------------------------------------------------------------


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], int, int]]:
    """Every number in every text: the path to the text, and where the number stands in it."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from places(inner, (*path, index))
    elif isinstance(value, str):
        yield from ((path, match.start(), match.end()) for match in NUMBER.finditer(value))


def changed(content: dict[str, Any], place: tuple[tuple[Any, ...], int, int], how: str) -> dict[str, Any]:
    path, start, end = place
    result = copy.deepcopy(content)
    holder = result
    for key in path[:-1]:
        holder = holder[key]
    text = holder[path[-1]]
    old = text[start:end]
    new = {"last": old[:-1] + str((int(old[-1]) + 1) % 10), "sign": f"(-{old})", "ten": f"1{old}"}[how]
    if how == "sign" and (text[:start] in ("", "-") and re.fullmatch(r"-?[\d/.]+", text)):
        new, start = (old, 0) if text[:start] == "-" else (f"-{old}", start)  # a number, not an expression
    holder[path[-1]] = text[:start] + new + text[end:]
    return result


CASES = ["cascaded_tanks", "fitzhugh_nagumo", "pendulum", "bent"]


@pytest.mark.ordinary("cascaded_tanks-last", "cascaded_tanks-sign", "fitzhugh_nagumo-ten", "pendulum-sign", "bent-sign")
@pytest.mark.parametrize("how", ["last", "sign", "ten"])
@pytest.mark.parametrize("case", CASES)
def test_every_changed_number_is_noticed(case: str, how: str, bent: dict[str, Any]) -> None:
    """By the digest, which is one row of what `recheck` finds."""
    content = bent if case == "bent" else of_model(ROOT / "models" / f"{case}.py")
    count = 0
    for place in places(content):
        assert not untouched(json.dumps(changed(content, place, how))), place
        count += 1
    assert count > 50
    assert untouched(json.dumps(content))


def untouched(text: str) -> bool:
    try:
        return read(text).untouched
    except (NoCertificate, Unreadable):
        return False


@pytest.mark.ordinary("cascaded_tanks-last", "fitzhugh_nagumo-ten", "pendulum-sign", "bent-sign")
@pytest.mark.parametrize("how", ["last", "sign", "ten"])
@pytest.mark.parametrize("case", [*CASES, pytest.param("pendulum as it runs", marks=pytest.mark.slow)])
def test_a_forger_gets_only_true_statements_through(case: str, how: str, bent: dict[str, Any]) -> None:
    """With the digest made anew, what is still verified is not refuted at sample points."""
    content = bent if case == "bent" else of_model(ROOT / "models" / f"{case.split()[0]}.py")
    if " " not in case:  # the claims of the step take ten times as long as the others
        content = {**content, "claims": [each for each in content["claims"] if "method" not in each["evidence"]]}
    passed = failed = 0
    every = list(places({key: part for key, part in content.items() if key != "digest"}))
    every = [place for place in every if place[0][-1] != "tree"]  # another bisection proves the same
    weights = [place for place in every if {"P", "S"} & set(map(str, place[0]))]  # so may others near these: some do
    every = [place for place in every if place not in weights] + weights[::7]
    for place in every[:: 1 if case != "bent" else 3]:
        forged = changed(content, place, how)
        if forged == content or not verified(sealed(forged)):
            failed += 1
            continue
        passed += 1
        assert not falsehood(forged), (place, falsehood(forged))
    assert failed > passed


@cache
def parsed(text: str, names: tuple[str, ...]) -> sp.Expr:
    return as_sympy(text, {name: sp.Symbol(name) for name in names})


@cache  # a forger changes one text of many
def value_of(text: str, at: tuple[tuple[sp.Symbol, float], ...], names: tuple[str, ...]) -> float:
    return float(parsed(text, names).subs(dict(at)))


@cache
def graph(texts: tuple[str, ...], names: tuple[str, ...]) -> Callable[..., Any]:
    return sp.lambdify(list(map(sp.Symbol, names)), [parsed(text, names) for text in texts], "math")


@cache
def functions(text: str) -> tuple[Callable[..., Any], ...]:
    """Of [plant, form]: the states of the plant, and its flow and output at them; the same by the form's equations; the
    slopes of b."""
    plant, form = json.loads(text)
    common = tuple(s["name"] for s in plant["inputs"] + plant["parameters"])
    z, x = (tuple(s["name"] for s in part["states"]) for part in (form, plant))
    inner = (*z, *common)
    back, flow = graph(tuple(form["from_form"]), inner), graph((*plant["flow"], *plant["output"]), (*x, *common))
    X, b = (sp.Matrix([parsed(text, inner) for text in form[part]]) for part in ("from_form", "b"))
    A = sp.Matrix([[parsed(text, inner) for text in row] for row in form["A"]])
    v = sp.Matrix(list(map(sp.Symbol, z)))
    rates, output = X.jacobian(v) * (A * v + b), [parsed(text, inner) for text in form["output"]]
    inside, slopes = (sp.lambdify(inner, rows, "math") for rows in ([*rates, *output], b.jacobian(v).tolist()))
    return back, flow, inside, slopes


Ranges = dict[str, tuple[float, float]]


def ranges_of(signals: list[dict[str, Any]]) -> Ranges:
    return {s["name"]: (float(Fraction(s["low"])), float(Fraction(s["high"]))) for s in signals}


@cache  # a forger of claims leaves them as they are
def sampled(text: str) -> list[tuple[dict[str, float], np.ndarray, float]]:
    """Of [plant, form]: points of the ranges, with the slopes of b there and their norm; none where at one of them the
    equations of the form are not those of the plant."""
    plant, form = json.loads(text)
    common = plant["inputs"] + plant["parameters"]
    (back, flow, inside, slopes), ranges = functions(text), ranges_of(form["states"] + common)
    draw, points = random.Random(1), list[tuple[dict[str, float], np.ndarray, float]]()
    for _ in range(SAMPLES):
        at = {name: draw.choice([low, high, draw.uniform(low, high)]) for name, (low, high) in ranges.items()}
        there = [*back(*at.values()), *(at[s["name"]] for s in common)]
        if not np.allclose(inside(*at.values()), flow(*there), rtol=1e-9, atol=1e-9):
            return []
        J = np.array(slopes(*at.values()))
        points.append((at, J, np.linalg.norm(J, 2)))
    return points


def falsehood(content: dict[str, Any]) -> str:
    """What sampling says against a certificate, or ""; written without the package."""
    plant, form = content["plant"], content["form"]
    ranges = ranges_of(form["states"] + plant["inputs"] + plant["parameters"])
    symbols = {name: sp.Symbol(name) for name in (*ranges, *ranges_of(plant["states"]))}
    equations = json.dumps([plant, form])
    slopes, points = functions(equations)[-1], sampled(equations)
    if not points:
        return "the equations differ"
    ranged = [claim for claim in content["claims"] if "low" in claim["evidence"]]
    ends = [[float(Fraction(claim["evidence"][end])) for end in ("low", "high")] for claim in ranged]
    texts = graph(tuple(claim["evidence"]["expression"] for claim in ranged), tuple(ranges))
    draw = random.Random(1)
    for sample, (at, J, steep) in enumerate(points):
        for claim, (low, high), value in zip(ranged, ends, texts(*at.values()), strict=True):
            if not low - 1e-12 <= value <= high + 1e-12 or (".a_" in claim["id"] and low <= 0):
                return f"{claim['id']}: {value} is outside [{low}, {high}]"
        for claim in content["claims"]:
            if "method" in claim["evidence"]:
                if sample < 3 and (contradiction := no_contraction(content, claim, ranges, slopes, draw)):
                    return contradiction
            elif "core" in claim["evidence"]:
                if sample < 3 and (contradiction := no_convergence(content, claim["evidence"], symbols, at, J)):
                    return contradiction
            elif steep > float(Fraction(claim["evidence"].get("bound", 1e300))) + 1e-9:
                return f"{claim['id']}: the slope is {steep}"
    for claim in content["claims"]:
        if "witness" in claim["evidence"]:
            at = {name: Fraction(value) for name, value in claim["evidence"]["witness"].items()}
            value = parsed(claim["evidence"]["expression"], tuple(symbols)).subs(
                {symbols[n]: sp.Rational(t.numerator, t.denominator) for n, t in at.items()}
            )
            if value > 0 or any(not ranges[n][0] <= t <= ranges[n][1] for n, t in at.items()):
                return f"{claim['id']}: the witness refutes nothing"
    return ""


def no_convergence(content: dict[str, Any], evidence: dict[str, Any], symbols: Any, at: Any, J: np.ndarray) -> str:
    """What floats say against the bound on theta at one point, or ""."""
    form, observer = content["form"], content["observer"]
    point, names = {symbols[name]: value for name, value in at.items()}, tuple(symbols)

    def numbers(value: Any) -> np.ndarray:
        there = tuple(point.items())
        return np.array([numbers(each) if isinstance(each, list) else value_of(each, there, names) for each in value])

    A, K, S = numbers(form["A"]), numbers(observer["gains"])[:, None], np.diag(numbers(evidence["scale"]))
    C = np.array([[parsed(form["output"][0], names).diff(symbols[s["name"]]).subs(point) for s in form["states"]]])
    N, P = numbers(evidence["core"]), numbers(evidence["P"])
    if not np.allclose(S @ (A - K @ C.astype(float)) @ np.linalg.inv(S), N):
        return "the core is another"
    steep, within = S @ J @ np.linalg.inv(S), np.zeros((2, *J.shape))
    for one in evidence["slopes"]:
        place = int(one["row"]) - 1, int(one["column"]) - 1
        within[(slice(None), *place)] = float(Fraction(one["low"])), float(Fraction(one["high"]))
    if (steep < within[0] - 1e-9).any() or (steep > within[1] + 1e-9).any():
        return "a slope is outside of its range"
    least, claim = Fraction(evidence["least"]), claim_of(content, "high_gain.theta")
    if claim["verdict"] == "proved" and Fraction(observer["theta"]) <= least:
        return "theta is below the bound"
    norms = [(float(least), P, 0.0)]
    if claim["verdict"] == "proved" and claim["evidence"]:
        rate = float(Fraction(claim["evidence"]["alpha"]))
        norms.append((float(Fraction(observer["theta"])), numbers(claim["evidence"]["P"]), rate))
    for theta, P_, alpha in norms:
        power = theta ** -np.arange(len(N), dtype=float)
        M = theta * N + power[:, None] * steep / power
        worst = np.linalg.eigvalsh(P_ @ M + M.T @ P_ + alpha * P_).max()
        if np.linalg.eigvalsh(P_).min() <= 0 or worst > 1e-9 * abs(P_ @ M).max():
            return "P proves nothing"
    return ""


def no_contraction(
    content: dict[str, Any], claim: dict[str, Any], ranges: Any, slopes: Any, draw: random.Random
) -> str:
    """What floats say against a step that contracts, by slopes at points of their own in each stage, or ""."""
    evidence, theta = claim["evidence"], float(Fraction(content["observer"]["theta"]))
    if "pieces" in evidence:
        one, theta = draw.choice(evidence["pieces"]), float(Fraction(evidence["theta"]))
        h, alpha = draw.uniform(float(Fraction(one["low"])), float(Fraction(one["high"]))), 0.0
    else:  # what noise is added to contracts without it
        parts = evidence.get("bounds") or evidence.get("peaks") or [evidence]
        one, h = draw.choice(parts), float(Fraction(evidence["dt"]))
        alpha = float(Fraction(one.get("alpha", 0)))
    S = np.array([float(Fraction(text)) for text in evidence["scale"]])
    N, P = (np.array([[float(Fraction(x)) for x in row] for row in M]) for M in (evidence["core"], one["P"]))
    a, b = {
        "Euler": ([[]], [1]),
        "Heun": ([[], [1]], [1 / 2, 1 / 2]),
        "classical Runge-Kutta": ([[], [1 / 2], [0, 1 / 2], [0, 0, 1]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    }[evidence["method"]]
    power, rates = theta ** -np.arange(len(N)), list[np.ndarray]()
    for row in a:
        at = [draw.choice([low, high, draw.uniform(low, high)]) for low, high in ranges.values()]
        J = np.array(slopes(*at), dtype=float) * [draw.choice([0, 1, draw.random()]) for _ in N]
        M = theta * N + (S * power)[:, None] * J / (S * power)
        rates.append(M @ (np.eye(len(N)) + h * sum((x * w for x, w in zip(row, rates, strict=True)), 0 * N)))
    Phi = np.eye(len(N)) + h * sum(x * w for x, w in zip(b, rates, strict=True))
    if np.linalg.eigvalsh(P).min() <= 0:
        return f"{claim['id']}: P is not positive"
    worst = np.linalg.eigvals(np.linalg.solve(P, Phi.T @ P @ Phi)).real.max()
    return f"{claim['id']}: V grows by {worst}" if worst > 1 - alpha * h + 1e-9 else ""


# --- no false statement ---------------------------------------------------------------------------------------------


def claim_of(content: dict[str, Any], id: str) -> dict[str, Any]:
    return next(claim for claim in content["claims"] if claim["id"] == id)


@pytest.mark.parametrize(("end", "true"), [("low", Fraction(3, 4)), ("high", Fraction(3))])
def test_a_bound_may_touch_the_range_and_not_enter_it(bent: dict[str, Any], end: str, true: Fraction) -> None:
    """u^2 - u + 1 on [-1, 1] has the range [3/4, 3]."""
    content = copy.deepcopy(bent)
    evidence = claim_of(content, "triangular.a_2")["evidence"]
    evidence[end] = str(true)
    assert findings(sealed(content))["triangular.a_2"] == "verified"
    evidence[end] = str(true + Fraction(1, 10**6) * (1 if end == "low" else -1))
    assert findings(sealed(content))["triangular.a_2"] == "fails"


def test_a_lipschitz_bound_below_the_slope_fails(bent: dict[str, Any]) -> None:
    content = copy.deepcopy(bent)
    evidence = claim_of(content, "triangular.lipschitz")["evidence"]
    evidence["bound"] = scaled(evidence["bound"], Fraction(97, 100))  # it is within 2% of a slope
    assert findings(sealed(content))["triangular.lipschitz"] == "fails"


@pytest.mark.parametrize("tree", ["", "u .", "u . . .", "x1 . .", "u u . .", "0 . .", ". ."])
def test_a_bisection_with_a_gap_fails(bent: dict[str, Any], tree: str) -> None:
    content = copy.deepcopy(bent)
    claim_of(content, "triangular.a_2")["evidence"]["tree"] = tree
    assert findings(sealed(content))["triangular.a_2"] == "fails"


def edit(content: dict[str, Any], what: str) -> None:
    """One lie."""
    form, plant, gain = content["form"], content["plant"], claim_of(content, "triangular.a_2")["evidence"]
    if what == "the rest's coefficient":
        form["b"][1] = form["b"][1].replace("exp(", "2*exp(")
    elif what == "the flow's coefficient":
        plant["flow"][1] = plant["flow"][1].replace("sin", "cos")
    elif what == "the output":
        form["output"][0] = form["output"][0].replace("2", "3")
    elif what == "the sign of z3":
        form["to_form"][2] = "x3"
    elif what == "an entry off the chain":
        form["A"][0][2] = "1"
    elif what == "a smaller box":
        gain["box"]["u"][0] = "0"
    elif what == "a smaller range of the input":
        plant["inputs"][0]["low"] = "0"
    elif what == "a smaller range of a state":
        form["states"][0]["low"] = "-1"
    elif what == "a wider range of the plant":
        plant["states"][0]["low"] = "-3"
    elif what == "another expression":
        gain["expression"] = "u**2 + 1"
    elif what == "a claim left out":
        content["claims"] = [claim for claim in content["claims"] if claim["id"] != "triangular.a_2"]
    elif what == "a claim twice":
        content["claims"].append(claim_of(content, "triangular.a_1"))
    elif what == "a refutation of what is true":
        claim_of(content, "triangular.a_2").update(verdict="refuted", evidence={"expression": "1", "witness": {}})
    elif what == "a claim that no rule knows":
        content["claims"].append({"id": "triangular.beautiful", "verdict": "proved", "evidence": {}})
    elif what == "a row that is not there":
        content["claims"].append({**claim_of(content, "triangular.a_1"), "id": "triangular.a_4"})
    elif what == "another kind":
        form["kind"] = "phase"


LIES = [
    *("the rest's coefficient", "the flow's coefficient", "the output", "the sign of z3", "an entry off the chain"),
    *(
        "a smaller box",
        "a smaller range of the input",
        "a smaller range of a state",
        "a wider range of the plant",
        "another expression",
    ),
    *("a claim left out", "a claim twice", "a refutation of what is true", "a claim that no rule knows"),
    *("a row that is not there", "another kind"),
]


@pytest.mark.ordinary("the rest's coefficient", "the flow's coefficient", "an entry off the chain")
@pytest.mark.parametrize("lie", LIES)
def test_a_lie_fails(bent: dict[str, Any], lie: str) -> None:
    content = copy.deepcopy(bent)
    edit(content, lie)
    assert content != bent
    assert not verified(sealed(content))


def test_an_open_claim_asserts_nothing(bent: dict[str, Any]) -> None:
    content = copy.deepcopy(bent)
    claim_of(content, "triangular.a_2").update(verdict="unknown", evidence={"reason": "20 boxes do not decide it"})
    result = recheck(sealed(content))
    assert not result.failed
    assert next(row for row in result.rows if row.id == "triangular.a_2").found == "open"


def plain(**changes: Any) -> dict[str, Any]:
    """A certificate written by hand: x' = -x + u, y = x, on x, u in [-1, 1]; `changes` of its parts."""
    x, z, u = ({"name": name, "low": "-1", "high": "1"} for name in ("x", "z", "u"))
    plant = {"name": "plain", "states": [x], "inputs": [u], "parameters": [], "outputs": ["y"]}
    plant |= {"flow": ["-x + u"], "output": ["x"]} | changes.get("plant", {})
    form = {"kind": "triangular", "states": [z], "to_form": ["x"], "from_form": ["z"], "A": [["0"]], "b": ["-z + u"]}
    form |= {"output": ["z"], "blocks": ["1"], "alignment": ""} | changes.get("form", {})
    one = {"expression": "1", "box": {}, "low": "1", "high": "1", "tree": "."}
    steep = {"box": {"u": ["-1", "1"], "z": ["-1", "1"]}, "bound": "1", "tree": "."} | changes.get("steep", {})
    evidence = {"structure": {}, "a_1": one | changes.get("a_1", {}), "lipschitz": steep}
    claims = [{"id": f"triangular.{id}", "verdict": "proved", "evidence": content} for id, content in evidence.items()]
    claims += changes.get("claims", [])
    head = {"format": "hgogen certificate", "version": VERSION, "hgogen": "0"}
    return {**head, "plant": plant, "form": form, "observer": None, "claims": claims}


def test_a_certificate_by_hand() -> None:
    assert set(findings(sealed(plain())).values()) == {"verified"}


ALL = ("structure", "a_1", "lipschitz")
SYMMETRIC = {"box": {"z": ["0", "1"]}, "bound": "100"}
TRICKS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    # z = x^2 is no coordinate where x has both signs: x' = 1 + x gives z' = 2 x + 2 x^2, not 2 sqrt(z) + 2 z
    "coordinates that fold the plant": (
        {
            "plant": {"flow": ["1 + x"], "output": ["x**2"]},
            "form": {
                "states": [{"name": "z", "low": "0", "high": "1"}],
                "to_form": ["x**2"],
                "from_form": ["sqrt(z)"],
                "b": ["2*sqrt(z) + 2*z"],
            },
            "steep": {"box": {"z": ["0", "1"]}},
        },
        ALL,
    ),
    # the form of a surface x2 = 0 of the plant only
    "a form of fewer states": (
        {
            "plant": {
                "states": [{"name": x, "low": "-1", "high": "1"} for x in ("x", "w")],
                "flow": ["-x + u + w", "w"],
            },
            "form": {"from_form": ["z", "0"]},
        },
        ALL,
    ),
    "a plant that is nowhere defined": ({"plant": {"flow": ["-x + u + 1/(sin(x)**2 + cos(x)**2 - 1)"]}}, ALL),
    "an identity that holds for want of a value": (
        {"plant": {"flow": ["-x + u + 7*(sin(x)**2 + cos(x)**2 - 1)/(sin(x)**2 + cos(x)**2 - 1)"]}},
        ALL,
    ),
    "narrower ranges behind an open claim": (
        {
            "form": {"states": [{"name": "z", "low": "0", "high": "1/10"}]},
            "steep": {"box": {"u": ["-1", "1"], "z": ["0", "1/10"]}},
            "claims": [{"id": "recast.range", "verdict": "unknown", "evidence": {"reason": ""}}],
        },
        ALL,
    ),
    "narrower ranges of half the state": (
        {
            "form": {
                "states": [{"name": "z", "low": "0", "high": "1/10"}],
                "to_form": ["2*x"],
                "from_form": ["z/2"],
                "output": ["z/2"],
                "b": ["-z + 2*u"],
            },
            "a_1": {"expression": "1/2", "low": "1/2", "high": "1/2"},
            "steep": {"box": {"u": ["-1", "1"], "z": ["0", "1/10"]}},
            "claims": [{"id": "recast.range", "verdict": "unknown", "evidence": {"reason": ""}}],
        },
        ALL,
    ),
    "a root that is no root": ({"plant": {"flow": ["-sqrt(x)**2 + u"]}}, ALL),
    "a change of coordinates without a value": (
        {"form": {"from_form": ["z + 5*(sin(z)**2 + cos(z)**2 - 1)/(sin(z)**2 + cos(z)**2 - 1)"], "b": ["-z/2"]}},
        ALL,
    ),
    "a pole that cancels": ({"form": {"b": ["(-z**2 + u*z)/z"]}}, ALL),
}


@pytest.mark.parametrize("trick", TRICKS)
def test_a_trick_fails(trick: str) -> None:
    changes, failing = TRICKS[trick]
    result = findings(sealed(plain(**changes)))
    assert "fails" in result.values()
    assert {id for id in failing if result[f"triangular.{id}"] == "verified"} == set()


def test_a_gain_that_is_only_written_badly_is_not_refuted() -> None:
    """u^2 + 1 is no zero and no pole at u = 0, however it is written."""
    for text in ("(u**2 + 1)*u/u", "(u**2 + 1)/u**0*u/u"):
        content = plain(form={"output": ["(u**2 + 1)*z"]}, plant={"output": ["(u**2 + 1)*x"]})
        evidence = {"expression": text, "witness": {"u": "0", "z": "0"}}
        claim_of(content, "triangular.a_1").update(verdict="refuted", evidence=evidence)
        assert findings(sealed(content))["triangular.a_1"] == "fails"
        content["form"]["output"] = [f"{text}*z"]
        assert findings(sealed(content))["triangular.a_1"] == "fails"


# --- the file -------------------------------------------------------------------------------------------------------

HOSTILE = {
    "nothing": "",
    "no JSON": "hello",
    "a list": "[]",
    "other JSON": '{"models": []}',
    "a later version": '{"format": "hgogen certificate", "version": "3"}',
    "no plant": f'{{"format": "hgogen certificate", "version": "{VERSION}"}}',
    "a deep nest": "[" * 100_000,
    "a key twice": '{"format": "x", "format": "hgogen certificate"}',
    "a long number": '{"format": ' + "9" * 10_000 + "}",
    "not a number": '{"format": NaN}',
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_certificate(text: str) -> None:
    with pytest.raises(NoCertificate) as caught:
        recheck(text)
    assert str(caught.value).endswith("hgogen check MODEL --certificate FILE")


EXPRESSIONS = [
    *(
        "__import__('os')",
        "x1.real",
        "x1[0]",
        "lambda: 1",
        "x1 if x1 else 1",
        "x9",
        "exec(x1)",
        "1 +",
        "((x1)",
        "x1 x2",
    ),
    *("2**99999", "9" * 500, "(" * 5000 + "x1" + ")" * 5000, "-" * 5000 + "x1", "x1+" * 60_000 + "x1"),
    *("sin()", "sin(x1, x2)", "1e999999", "x1 ** ** 2", "é", "x1;x2", "x1\n#"),
]


@pytest.mark.parametrize("text", EXPRESSIONS, ids=lambda text: text[:12])
def test_hostile_expressions_are_refused_at_once(bent: dict[str, Any], text: str) -> None:
    content = copy.deepcopy(bent)
    content["plant"]["flow"][0] = text
    begin = time.process_time()
    with pytest.raises(Unreadable):
        recheck(sealed(content))
    assert time.process_time() - begin < 10


@pytest.mark.parametrize(
    "text",
    [
        *("exp(exp(exp(exp(x1))))", "x1**(10**9)", "(x1+x2+x3+1)**900", "((x1**900)**900)**900", "1/0", "log(-1)"),
        "cos(" * 20 + "x1" + ")" * 20,
    ],
)
def test_costly_expressions_fail_in_time(bent: dict[str, Any], text: str) -> None:
    content = copy.deepcopy(bent)
    content["plant"]["flow"][0] = text
    begin = time.process_time()
    assert not verified(sealed(content))
    assert time.process_time() - begin < 30


@pytest.mark.full
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.slow) for part in (1, 2, 3))])
def test_every_part_may_be_missing_or_of_another_type(bent: dict[str, Any], part: int) -> None:
    """Each gives the sentence of a bad file, or a claim that fails; no other error."""

    def holders(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        yield path
        pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in pairs:
            yield from holders(inner, (*path, key))

    count, passed = 0, set()
    for path in list(holders({key: value for key, value in bent.items() if key not in ("model", "digest")}))[part::4]:
        for junk in (None, 7, {}):
            content = copy.deepcopy(bent)
            holder: Any = content
            for key in path[:-1]:
                holder = holder[key]
            if not path or holder[path[-1]] == junk:
                continue
            holder[path[-1]] = junk
            count += 1
            if verified(sealed(content)):
                passed.add(path[:2])
    assert count > 50
    assert passed <= {("hgogen",), ("plant", "outputs")}


def command(*arguments: str) -> Any:
    return CliRunner().invoke(cli.app, list(arguments))


def test_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "p.json"
    assert command("check", str(ROOT / "models" / "pendulum.py"), "--certificate", str(file)).exit_code == 0
    shown = command("recheck", str(file))
    assert shown.exit_code == 0
    assert "triangular.lipschitz" in shown.stdout
    answer = json.loads(command("recheck", str(file), "--json").stdout)
    assert answer["verified"] is True
    file.write_text(file.read_text().replace('"high": "20"', '"high": "21"'))
    shown = command("recheck", str(file))
    assert shown.exit_code == 1
    assert "digest" in shown.stderr
    file.write_text(file.read_text()[:500])
    assert command("recheck", str(file)).exit_code == 2
    assert command("recheck", str(tmp_path / "none.json")).exit_code == 2
    file.write_bytes(b"\xff\xfe\x00")
    assert command("recheck", str(file)).exit_code == 2


@pytest.mark.full
def test_what_is_only_stated_is_said(tmp_path: Path) -> None:
    shown = command("check", str(ROOT / "models" / "sir.toml"), "--certificate", str(tmp_path / "sir.json"))
    assert shown.exit_code == 0
    assert "only states triangular.structure, it cannot be verified again: refuted: I' brings in S" in shown.stderr
    shown = command("check", str(ROOT / "models" / "lorenz.toml"), "--certificate", str(tmp_path / "lorenz.json"))
    assert "only states" not in shown.stderr


# --- independence ---------------------------------------------------------------------------------------------------


def test_the_verifier_shares_no_code() -> None:
    """It imports its own files, mpmath and Python's library."""
    imported = set()
    for path in sorted((PACKAGE / "recheck").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(str(node.module).partition(".")[0])
            elif isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
    assert "mpmath" in imported
    assert imported - {"mpmath"} <= sys.stdlib_module_names


def test_a_sign_of_the_row_itself_is_0_at_the_edge() -> None:
    """x1' = x2 sign(u): where u is 0 its slope in x2 is 0, and not that of |u|, which at the edge u = 0 would be 1."""
    x, u = [hg.Signal(f"x{i}", low=0, high=1) for i in (1, 2)], hg.Signal("u", low=0, high=1)
    flow = [x[1] * (2 + sp.sign(u)) + abs(x[1]), 0]
    plant = hg.System("edge", states=x, inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])
    form = hg.forms.uniform(plant)
    content = certificate(form, form.checks)
    assert findings(sealed(content))["uniform.slope_2"] == "verified"
    content = json.loads(json.dumps(content).replace("sign(u) + 2", "sign(u)"))
    claim = next(claim for claim in content["claims"] if claim["id"] == "uniform.slope_2")
    claim["evidence"] |= {"low": "2", "high": "2"}
    assert findings(sealed(content))["uniform.slope_2"] == "fails"


def alone(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`python -m recheck` in a folder that holds it and mpmath, and nothing else that Python finds."""
    if not (folder / "recheck").exists():
        shutil.copytree(PACKAGE / "recheck", folder / "recheck")
        shutil.copytree(Path(str(mpmath.__file__)).parent, folder / "mpmath", ignore=shutil.ignore_patterns("tests"))
    command = [sys.executable, "-S", "-m", "recheck", *arguments]
    only = {"PYTHONPATH": str(folder)}
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=only, check=False)


def false_threshold(content: dict[str, Any]) -> None:
    """The observer's theta below the bound that its claim of convergence has."""
    content["observer"]["theta"] = "1"


def no_structure(content: dict[str, Any]) -> None:
    content["claims"] = [claim for claim in content["claims"] if claim["id"] != "triangular.structure"]


def of_another_version(content: dict[str, Any]) -> None:
    content["version"] = "1"


@pytest.mark.parametrize(
    ("forge", "status"),
    [(None, 0), (false_threshold, 1), (no_structure, 1), (of_another_version, 2)],
)
def test_the_verifier_runs_alone(tmp_path: Path, forge: Callable[[dict[str, Any]], None] | None, status: int) -> None:
    """It says the same as the command where nothing else is installed, of true certificates and of false ones."""
    content = copy.deepcopy(observed("pendulum"))
    if forge:
        forge(content)
    file = tmp_path / "pendulum.json"
    file.write_text(sealed(content))
    by_command = command("recheck", str(file), "--json")
    by_itself = alone(tmp_path, str(file), "--json")
    assert (by_itself.returncode, by_command.exit_code) == (status, status), by_itself.stderr
    assert by_itself.stderr.split() == by_command.stderr.split()[1:]  # which begins with the command's name
    if status == 2:
        assert by_itself.stdout == by_command.stdout == ""
        return
    answer = json.loads(by_itself.stdout)
    assert answer == json.loads(by_command.stdout)
    text = alone(tmp_path, str(file))
    assert text.returncode == status
    assert all(row["sentence"] in text.stdout for row in answer["claims"])


def test_the_verifier_says_which_format_it_reads(tmp_path: Path) -> None:
    output = alone(tmp_path, "--version")
    assert output.stdout.strip() == f"it reads hgogen certificates of format version {VERSION}"


def test_a_reader_that_stops_early_leaves_the_verifier_without_a_traceback(tmp_path: Path) -> None:
    file = tmp_path / "pendulum.json"
    file.write_text(json.dumps(observed("pendulum")))
    alone(tmp_path, "--version")
    words = [sys.executable, "-S", "-m", "recheck", str(file)]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)}
    ) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        said = running.stderr.read()
    assert (said, running.returncode) == (b"", 141)


@pytest.mark.parametrize("form", ["phase", "uniform_chain", "uniform"])
@pytest.mark.parametrize("bent", [0, 0.07])
def test_numbers_of_a_form_are_the_decimals_of_the_plant(form: str, bent: float) -> None:
    """0.7 (1.1 - 0.9 p) in floats is 0.7700000000000001 - 0.63 p: the form, and its slopes, are of another plant."""
    x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
    p = hg.Signal("p", nominal=0.3, low=0.1, high=0.7)
    flow = [1.1 * x1 - 0.9 * p * x1 + 0.7 * x2 + bent * x2**3, 0.001 * x2]
    plant = hg.System(
        "plant", states=(x1, x2), outputs=(hg.Signal("y"),), parameters=(p,), flow=flow, output=[0.7 * x1]
    )
    made = getattr(hg.forms, form)(plant)
    rows = recheck(json.dumps(hg.certificate(made, made.checks))).rows
    assert len(rows) >= len(made.checks) > 1
    assert not [row for row in rows if row.found == "fails" or "second arithmetic" in row.sentence]
