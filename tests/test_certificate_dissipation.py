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
from plants import van_der_pol

import hgogen as hg
from hgogen.certificate import certificate
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.recheck import NoCertificate, Unreadable, recheck

e, e1, e2 = sp.symbols("e e1 e2", real=True)
SAMPLES = 400


def line(F: sp.Expr, V: sp.Expr, within: float) -> hg.Dissipation:
    """e' = F(e) + w, mu = 3."""
    return hg.dissipation(hg.ErrorSystem("line", (e,), (F,), [[1]]), V, mu=3, within=[within])


def not_iss() -> hg.Dissipation:
    """e1' = -e1 + (1 + e1^2) w, e2' = -e2 of Alessandri 2020, example 1, V = |e|^2: (1 + e1^2)^2 < 3 mu^2/4."""
    system = hg.ErrorSystem("not_iss", (e1, e2), flow=(-e1, -e2), noise=[[1 + e1**2], [0]])
    return hg.dissipation(system, e1**2 + e2**2, mu=2, within=[0.8, 2])


def pendulum() -> hg.Dissipation:
    """An observer of q' = w, w' = -2 sin q - w/10 + u, with the gain (6, 9)."""
    q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-9, high=9)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    flow = [w, -2 * sp.sin(q) - w / 10 + u]
    plant = hg.System("swing", states=(q, w), inputs=(u,), outputs=(y,), flow=flow, output=[q])
    system = hg.error_system(plant, (6, 9))
    return hg.dissipation(system, [[6, -2], [-2, 1.2]], mu=40, within=[1, 4])


CASES: dict[str, Callable[[], hg.Dissipation]] = {
    "whole": lambda: line(-3 * e, e**2, 1),
    "slabs": lambda: line(-e - 3 * sp.sin(2 * e), e**2, 1.5),
    "quartic": lambda: line(-3 * e, e**2 + e**4, 1),
    "a Hessian that turns": lambda: line(-3 * e, e**2 - e**4 / 10, 2),
    "not_iss": not_iss,
    "pendulum": pendulum,
}


@cache
def _written(case: str) -> str:
    found = CASES[case]()
    assert found.proved, found
    form = hg.forms.triangular(van_der_pol())
    return json.dumps(certificate(form, (*form.checks, *found.checks)))


def written(case: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(_written(case))
    content["claims"] = [claim for claim in content["claims"] if claim["id"].startswith("dissipation")]
    return content


def sealed(content: dict[str, Any]) -> str:
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def found(content: dict[str, Any]) -> dict[str, str]:
    """What was found of the three claims."""
    rows = recheck(sealed(content)).rows
    return {row.id: row.found for row in rows if row.id.startswith("dissipation")}


@pytest.mark.parametrize("case", CASES)
def test_the_inequality_is_verified(case: str) -> None:
    content = written(case)
    ids = [f"dissipation.{what}" for what in ("positive", "inequality", "level")]
    assert found(content) == dict.fromkeys(ids, "verified"), recheck(sealed(content)).rows
    assert not falsehood(content)


def falsehood(content: dict[str, Any]) -> str:
    """What sampling says against what is told, or ""."""
    for claim in content["claims"]:
        told = claim["evidence"]["system"]
        every = told["errors"] + told["signals"]
        symbols = {s["name"]: sp.Symbol(s["name"]) for s in every}
        errors = [symbols[s["name"]] for s in told["errors"]]
        V = sp.sympify(told["V"], symbols)
        slope = sp.Matrix([[V.diff(each) for each in errors]])
        F, G = (sp.Matrix([sp.sympify(row, symbols) for row in told[part]]) for part in ("flow", "noise"))
        mu = sp.Rational(told["mu"])
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


@pytest.mark.parametrize("factor", ["-1", "101/100", "99/100", "10", "0"])
@pytest.mark.parametrize("case", ["slabs", "not_iss", "quartic"])
def test_a_forger_gets_only_true_statements_through(case: str, factor: str) -> None:
    content = written(case)
    every = {path for claim in content["claims"] for path in places(claim["evidence"])}
    failed = 0
    for path in sorted(every, key=str):
        forged = changed(content, path, factor)
        if forged == content:
            continue
        try:
            result = found(forged)
        except (NoCertificate, Unreadable):
            failed += 1
            continue
        if "fails" in result.values():
            failed += 1
        forged["claims"] = [claim for claim in forged["claims"] if result[claim["id"]] == "verified"]
        assert not falsehood(forged), (path, falsehood(forged))
    assert failed > (0 if "/" in factor else len(every) // 4)


LIES: dict[str, Callable[[dict[str, Any]], object]] = {
    "F does not vanish": lambda told: told["system"]["flow"].__setitem__(0, "-3*e + e**2 + 1/1000"),
    "F has a kink": lambda told: told["system"]["flow"].__setitem__(0, "-3*e - Abs(e)"),
    "V does not vanish": lambda told: told["system"].update(V="e**2 + 1"),
    "V has a slope at 0": lambda told: told["system"].update(V="e**2 + e/10"),
    "a box beside 0": lambda told: told["system"]["errors"][0].update(low="1/2"),
    "a box at 0": lambda told: told["system"]["errors"][0].update(low="0"),
    "no box": lambda told: told["system"]["errors"][0].update(low=None),
    "a share above 1": lambda told: told.update(share="2"),
    "a smaller share": lambda told: told.update(share="1/2"),
    "an unknown part": lambda told: told["system"].update(approved_by="nobody"),
    "a basis of zero": lambda told: told.update(basis=[["0"]]),
    "no noise": lambda told: told["system"].update(noise=[None]),
    "more noise": lambda told: told["system"].update(noise=[["10"]]),
    "an error that is a signal": lambda told: told["system"]["signals"].append({"name": "e", "low": "0", "high": "0"}),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_fails(lie: str) -> None:
    content = written("whole")
    for claim in content["claims"]:
        LIES[lie](claim["evidence"])
    assert found(content)["dissipation.inequality"] == "fails"


def test_the_claims_are_of_one_system() -> None:
    content = written("whole")
    content["claims"][1]["evidence"]["system"]["V"] = "2*e**2"
    assert set(found(content).values()) == {"fails"}


def test_the_left_side_is_that_of_the_system() -> None:
    content = written("slabs")
    evidence = content["claims"][1]["evidence"]
    assert len(evidence["slabs"]) == 2
    evidence["left"] = f"{evidence['left']} - e**2"
    assert found(content)["dissipation.inequality"] == "fails"
