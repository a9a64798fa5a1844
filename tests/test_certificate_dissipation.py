"""Certificates of inequality (38): what is verified is true at sample points, and no changed number gets through."""

import copy
import json
import random
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from typing import Any

import pytest
import sympy as sp
from oracle.text import read as as_sympy

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.recheck.file import NoCertificate, digest, model_digest
from hgogen.recheck.text import Unreadable
from hgogen.recheck.verification import recheck

SAMPLES = 400
e_x, e_q, e_w = sp.symbols("e_x e_q e_w", real=True)
x = hg.Signal("x", low=-0.01, high=0.01)
q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-9, high=9)
u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")


def line(flow: sp.Expr, gain: Any, V: sp.Expr, within: float, **noise: Any) -> tuple[hg.System, hg.Dissipation]:
    """x' = flow + w_1, y = x + w_2, mu = 6."""
    plant = hg.System("line", states=(x,), outputs=(y,), flow=[flow], output=[x])
    return plant, hg.dissipation(hg.error_system(plant, [gain], **noise), V, mu=6, within=[within])


def pendulum() -> tuple[hg.System, hg.Dissipation]:
    """An observer of q' = w, w' = -2 sin q - w/10 + u, with the gain (6, 9)."""
    flow = [w, -2 * sp.sin(q) - w / 10 + u]
    plant = hg.System("swing", states=(q, w), inputs=(u,), outputs=(y,), flow=flow, output=[q])
    system = hg.error_system(plant, (6, 9))
    return plant, hg.dissipation(system, [[6, -2], [-2, 1.2]], mu=40, within=[1, 4])


CASES: dict[str, Callable[[], tuple[hg.System, hg.Dissipation]]] = {
    "whole": lambda: line(-x, 2, e_x**2, 1),
    "slabs": lambda: line(-x - 3 * sp.sin(2 * x), 0, e_x**2, 1.5),
    "quartic": lambda: line(-x, 2, e_x**2 + e_x**4, 1),
    "a Hessian that turns": lambda: line(-x, 2, e_x**2 - e_x**4 / 10, 2),
    "a gain of the estimate": lambda: line(-3 * x, x**2 / 2, e_x**2, 1, G1=[[0, x]], G2=[[1, 0]]),
    "pendulum": pendulum,
}


@cache
def _written(case: str) -> str:
    plant, dissipation = CASES[case]()
    assert dissipation.proved, dissipation
    form = hg.forms.original(plant)
    return json.dumps(certificate(form, (*form.checks, *dissipation.checks)))


def written(case: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(_written(case))
    content["claims"] = [claim for claim in content["claims"] if claim["id"].startswith("dissipation")]
    return content


def sealed(content: dict[str, Any]) -> str:
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def findings(content: dict[str, Any]) -> dict[str, str]:
    """What was found of the three claims."""
    rows = recheck(sealed(content)).rows
    return {row.id: row.found for row in rows if row.id.startswith("dissipation")}


@pytest.mark.parametrize("case", CASES)
def test_the_inequality_is_verified(case: str) -> None:
    content = written(case)
    ids = [f"dissipation.{what}" for what in ("positive", "inequality", "level")]
    assert findings(content) == dict.fromkeys(ids, "verified"), recheck(sealed(content)).rows
    assert not falsehood(content)


def falsehood(content: dict[str, Any]) -> str:
    """What sampling says of the file's plant against what is told, or ""."""
    plant, p = content["plant"], len(content["plant"]["outputs"])
    for claim in content["claims"]:
        system = claim["evidence"]["system"]
        every = system["errors"] + plant["states"] + plant["inputs"] + plant["parameters"]
        symbols = {s["name"]: sp.Symbol(s["name"]) for s in every}
        states, errors = ([symbols[s["name"]] for s in part] for part in (plant["states"], system["errors"]))
        behind = {x: x - e for x, e in zip(states, errors, strict=True)}
        f, h = (sp.Matrix([as_sympy(row, symbols) for row in plant[part]]) for part in ("flow", "output"))
        gain, G1, G2 = (
            sp.Matrix([[as_sympy(cell, symbols) for cell in row] for row in system[part]])
            for part in ("gain", "G1", "G2")
        )
        assert gain.shape == (len(f), p)
        F = f - f.xreplace(behind) - gain.xreplace(behind) * (h - h.xreplace(behind))
        G = G1 - gain.xreplace(behind) * G2
        V, mu = as_sympy(system["V"], symbols), sp.Rational(system["mu"])
        slope = sp.Matrix([[V.diff(each) for each in errors]])
        left = (slope * F)[0] + (slope * G * G.T * slope.T)[0] / (2 * mu**2) + sum(x**2 for x in errors) / 2
        graph = sp.lambdify(list(symbols.values()), [V, left], "math")
        draw, ranges = random.Random(2), [(float(Fraction(s["low"])), float(Fraction(s["high"]))) for s in every]
        for _ in range(SAMPLES):
            at = [draw.choice([*ends, draw.uniform(*ends), draw.uniform(*ends)]) for ends in ranges]
            value, side = graph(*at)
            size = sum(x * x for x in at[: len(errors)])
            edge = any(x in ends for x, ends in zip(at, ranges[: len(errors)], strict=False))
            if claim["id"].endswith("positive") and value <= 0 < size:
                return f"V = {value} at {at}"
            if claim["id"].endswith("inequality") and side >= 0 and size:
                return f"the left side is {side} at {at}"
            if claim["id"].endswith("level") and edge and value < float(Fraction(claim["evidence"]["floor"])) - 1e-9:
                return f"V = {value} on a face"
    return ""


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*path, key))
    elif isinstance(value, str) and path[-1] not in ("name", "id", "verdict", "tree", "reason"):
        yield path


def changed(content: dict[str, Any], path: tuple[Any, ...], factor: str) -> dict[str, Any]:
    """One number or expression times a factor, in all claims that have it: a forger's file is of one system."""
    result = copy.deepcopy(content)
    for claim in result["claims"]:
        holder = claim["evidence"]
        try:
            for key in path[:-1]:
                holder = holder[key]
            old = holder[path[-1]]
        except (KeyError, IndexError):
            continue
        try:
            holder[path[-1]] = str(Fraction(old) * Fraction(factor))
        except ValueError:
            holder[path[-1]] = f"({old})*({factor})"
    return result


@pytest.mark.ordinary("slabs-101/100", "slabs-99/100", "slabs-10", "slabs-0", "quartic-0")
@pytest.mark.parametrize("factor", ["-1", "101/100", "99/100", "10", "0"])
@pytest.mark.parametrize("case", ["slabs", pytest.param("a gain of the estimate", marks=pytest.mark.slow), "quartic"])
def test_a_forger_gets_only_true_statements_through(case: str, factor: str) -> None:
    content = written(case)
    every = {path for claim in content["claims"] for path in places(claim["evidence"])}
    failed = 0
    for path in sorted(every, key=str):
        forged = changed(content, path, factor)
        if forged == content:
            continue
        try:
            result = findings(forged)
        except (NoCertificate, Unreadable):
            failed += 1
            continue
        if "fails" in result.values():
            failed += 1
        forged["claims"] = [claim for claim in forged["claims"] if result[claim["id"]] == "verified"]
        assert not falsehood(forged), (path, falsehood(forged))
    assert failed > (0 if "/" in factor else len(every) // 4)


LIES: dict[str, Callable[[dict[str, Any]], object]] = {
    "V does not vanish": lambda evidence: evidence["system"].update(V="e_x**2 + 1"),
    "V has a slope at 0": lambda evidence: evidence["system"].update(V="e_x**2 + e_x/10"),
    "V has a kink": lambda evidence: evidence["system"].update(V="e_x**2 + Abs(e_x)"),
    "a box beside 0": lambda evidence: evidence["system"]["errors"][0].update(low="1/2"),
    "a box at 0": lambda evidence: evidence["system"]["errors"][0].update(low="0"),
    "no box": lambda evidence: evidence["system"]["errors"][0].update(low=None),
    "a share above 1": lambda evidence: evidence.update(share="2"),
    "a smaller share": lambda evidence: evidence.update(share="1/2"),
    "an unknown part": lambda evidence: evidence["system"].update(approved_by="nobody"),
    "a system of its own": lambda evidence: evidence["system"].update(flow=["-3*e_x"]),
    "a basis of zero": lambda evidence: evidence.update(basis=[["0"]]),
    "no noise": lambda evidence: evidence["system"].update(G1=[None]),
    "more noise": lambda evidence: evidence["system"].update(G1=[["10", "0"]]),
    "noise of another size": lambda evidence: evidence["system"].update(G2=[["1"]]),
    "a gain that does not correct": lambda evidence: evidence["system"].update(gain=[["-1"]]),
    "a gain with a kink": lambda evidence: evidence["system"].update(gain=[["2 + Abs(x)/1000"]]),
    "a gain that reads the error": lambda evidence: evidence["system"].update(gain=[["2 + e_x"]]),
    "an error of another name": lambda evidence: evidence["system"]["errors"][0].update(name="e"),
    "an error too many": lambda evidence: evidence["system"]["errors"].append(
        {"name": "e_y", "low": "-1", "high": "1"}
    ),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_fails(lie: str) -> None:
    content = written("whole")
    for claim in content["claims"]:
        LIES[lie](claim["evidence"])
    assert findings(content)["dissipation.inequality"] == "fails"


PLANTS: dict[str, Callable[[dict[str, Any]], object]] = {
    "no flow": lambda c: c["plant"].update(flow=["0", "0"]),
    "no output": lambda c: c["plant"].update(output=["0"]),
    "another output": lambda c: c["plant"].update(output=["w"]),
    "a steeper plant": lambda c: c["plant"]["flow"].__setitem__(1, "-40*sin(q) - w/10 + u"),
    "a plant with a kink": lambda c: c["plant"]["flow"].__setitem__(1, "-2*sin(q) - Abs(w)/10 + u"),
    "an error that is a signal": lambda c: c["plant"]["inputs"].append({"name": "e_q", "low": "0", "high": "1"}),
    "another model's claims": lambda c: c.update(claims=written("whole")["claims"]),
    "the states in another order": lambda c: c["plant"]["states"].reverse(),
}


@pytest.mark.parametrize("change", PLANTS)
def test_the_system_is_that_of_the_files_plant(change: str) -> None:
    """Whatever form the file has: no claim rests on it."""
    content = written("pendulum")
    PLANTS[change](content)
    result = findings(content)
    assert result["dissipation.inequality"] == "fails", change
    if change.endswith(("order", "claims", "signal", "kink")):
        assert set(result.values()) == {"fails"}


def test_an_invented_system_is_not_verified() -> None:
    """e' = -e, with all of its evidence, as the first version of the format had it."""
    content = written("whole")
    system = {"errors": [{"name": "e", "low": "-1", "high": "1"}], "signals": [], "flow": ["-e"], "noise": [["0"]]}
    for claim in content["claims"]:
        claim["evidence"]["system"] = {**system, "V": "e**2", "mu": "1"}
    assert set(findings(content).values()) == {"fails"}


def test_a_system_that_is_given_is_only_stated() -> None:
    """No file of a plant can show that it is that of the plant's observer."""
    plant, _ = CASES["whole"]()
    e = sp.Symbol("e", real=True)
    own = hg.dissipation(hg.ErrorSystem("own", (e,), (-3 * e,), [[1]]), e**2, mu=3, within=[1])
    assert own.proved
    form = hg.forms.original(plant)
    content = certificate(form, own.checks)
    assert set(findings(content).values()) == {"stated"}
    assert "is given and not made of the plant" in content["claims"][0]["evidence"]["reason"]


def test_the_sentence_says_whose_error_it_is() -> None:
    rows = {row.id: row.sentence for row in recheck(sealed(written("pendulum"))).rows}
    equations = "xhat' = f(xhat, u) + gain (y - h(xhat, u)), gain = (6; 9), G1 = (1, 0, 0; 0, 1, 0), G2 = (0, 0, 1)"
    assert all(equations in sentence for id, sentence in rows.items() if id.startswith("dissipation"))


def test_the_claims_are_of_one_system() -> None:
    content = written("whole")
    content["claims"][1]["evidence"]["system"]["V"] = "2*e_x**2"
    assert set(findings(content).values()) == {"fails"}


def test_the_left_side_is_that_of_the_system() -> None:
    content = written("slabs")
    evidence = content["claims"][1]["evidence"]
    assert len(evidence["slabs"]) == 2
    evidence["left"] = f"{evidence['left']} - e_x**2"
    assert findings(content)["dissipation.inequality"] == "fails"
