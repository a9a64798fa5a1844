"""Certificates of inputs that show every state: verified where they do, and nothing false."""

import copy
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from oracle.text import read as as_sympy

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import ClaimId
from hgogen.commands.claims import checked
from hgogen.estimators.persistence import persistent
from hgogen.model import load
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.verification import recheck

ROOT = Path(__file__).resolve().parents[1]
ID = ClaimId("kalman_like", "persistence")
x1, x2, x3 = (hg.Signal(f"x{i}", low=-3, high=3) for i in (1, 2, 3))
u, v = hg.Signal("u", low=-2, high=2), hg.Signal("v", low=-2, high=2)
a, y = hg.Signal("a", "", "", 1, low=0.5, high=2), hg.Signal("y")


def plant(*flow: Any, inputs: tuple[hg.Signal, ...] = (u,), output: Any = x1) -> hg.Form:
    states = (x1, x2, x3)[: len(flow)]
    system = hg.System("shown", states=states, inputs=inputs, outputs=(y,), parameters=(a,), flow=flow, output=[output])
    return hg.forms.state_affine(system)


CASES: dict[str, tuple[Callable[[], hg.Form], dict[str, Any] | None, Any]] = {
    "any input": (lambda: plant(a * x2 + u, -x1), None, None),
    "constant": (lambda: plant(u * x2, -a * x1), {"u": "3/2"}, None),
    "at the end of its range": (lambda: plant(u * x2, -a * x1), {"u": 2}, None),
    "sine": (lambda: plant(u * x2, -a * x1), {"u": "sin(3*t)"}, "2*pi/3"),
    "two": (
        lambda: plant(u * x2, v * x3, -x1, inputs=(u, v)),
        {"u": "3/2 + cos(2*t)/4", "v": "exp(sin(t))/2"},
        "2*pi",
    ),
    "in the output": (
        lambda: plant(-x1, -2 * x2, output=u * x1 + v * x2, inputs=(u, v)),
        {"u": "cos(t)", "v": 1},
        "2*pi",
    ),
    "hertz": (lambda: plant(u * x2, -a * x1), {"u": "sin(100*pi*t)"}, "1/50"),
}


@cache
def _written(case: str) -> str:
    form, inputs, period = CASES[case]
    affine = form()
    return json.dumps(certificate(affine, (*affine.checks, persistent(ID, affine, inputs, period))))


def written(case: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(_written(case))
    return content


def evidence_of(content: dict[str, Any]) -> dict[str, Any]:
    return next(claim["evidence"] for claim in content["claims"] if claim["id"] == ID)


def finding(content: dict[str, Any]) -> str:
    content = {**content, "model": model_digest(content)}
    rows = recheck(json.dumps({**content, "digest": digest(content)})).rows
    return next(f"{row.found}: {row.sentence}" for row in rows if row.id == ID)


@pytest.mark.ordinary("constant", "at the end of its range")
@pytest.mark.parametrize("case", CASES)
def test_what_is_proved_is_verified(case: str) -> None:
    content = written(case)
    assert finding(content).startswith("verified"), finding(content)
    assert least(content) > 0


def least(content: dict[str, Any]) -> float:
    """The smallest eigenvalue of the Gramian over two periods, by Runge and Kutta's steps, at corners of a."""
    evidence, form = evidence_of(content), content["form"]
    names = {name: sp.Symbol(name) for name in ("t", "a", "u", "v", *(s["name"] for s in form["states"]))}
    inputs = {names[name]: as_sympy(text, names) for name, text in evidence["inputs"].items()}
    z = [names[s["name"]] for s in form["states"]]
    A = sp.Matrix([[as_sympy(entry, names) for entry in row] for row in form["A"]]).subs(inputs)
    C = sp.Matrix([as_sympy(row, names) for row in form["output"]]).jacobian(z).subs(inputs)
    graph = sp.lambdify((names["t"], names["a"]), [A, C])
    T, count, n = 2 * float(as_sympy(evidence.get("period", "1"))), 2000, len(z)
    worst = np.inf
    for at in (0.5, 1.0, 2.0):
        Phi, W, h = np.eye(n), np.zeros((n, n)), T / count
        for k in range(count):
            first, middle = (graph(k * h + share * h, at) for share in (0, 0.5))
            CPhi = np.array(first[1], dtype=float) @ Phi
            W += h * CPhi.T @ CPhi
            Phi = Phi + h * np.array(middle[0], float) @ (Phi + h / 2 * np.array(first[0], float) @ Phi)
        worst = min(worst, np.linalg.eigvalsh(W)[0] / np.linalg.eigvalsh(W)[-1])
    return worst if worst > 1e-12 else 0.0


LIES: dict[str, tuple[str, Callable[[dict[str, Any]], object]]] = {
    "no period": ("sine", lambda e: e.update(period="pi/3")),
    "a rounded period": ("sine", lambda e: e.update(period="2094395102/1000000000")),
    "a period of zero": ("sine", lambda e: e.update(period="0")),
    "without a period": ("sine", lambda e: e.pop("period")),
    "an input that grows": ("sine", lambda e: e["inputs"].update(u="t/100 + sin(3*t)")),
    "a chirp": ("sine", lambda e: e["inputs"].update(u="sin(3*t + sin(t))")),
    "an input beyond its range": ("sine", lambda e: e["inputs"].update(u="5*sin(3*t)")),
    "a time at which it is zero": ("sine", lambda e: e.update(at="0")),
    "a constant beyond its range": ("constant", lambda e: e["inputs"].update(u="21/10")),
    "a constant that hides": ("constant", lambda e: e["inputs"].update(u="0")),
    "a kink": ("constant", lambda e: e["inputs"].update(u="Abs(3/2)")),
    "an input left out": ("two", lambda e: e["inputs"].pop("v")),
    "an input of another name": ("constant", lambda e: e["inputs"].update(w="1")),
    "an input of a parameter": ("constant", lambda e: e["inputs"].update(u="a")),
}


@pytest.mark.ordinary("without a period", "a constant beyond its range", "a constant that hides")
@pytest.mark.parametrize("lie", LIES)
def test_a_lie_fails(lie: str) -> None:
    case, change = LIES[lie]
    content = copy.deepcopy(written(case))
    change(evidence_of(content))
    assert finding(content).startswith("fails"), finding(content)


@pytest.mark.full
def test_other_inputs_that_show_the_states_are_verified() -> None:
    """The gramian says so, too."""
    content = written("sine")
    for text, period in (("3/2*cos(6*t)", "2*pi/3"), ("sin(3*t)", "4*pi/3"), ("sin(3*t)**3", "2*pi")):
        evidence_of(content)["inputs"]["u"], evidence_of(content)["period"] = text, period
        assert finding(content).startswith("verified"), finding(content)
        assert least(content) > 0


def test_a_parameter_that_hides_a_state_somewhere() -> None:
    """a - 1 is 0 at a = 1."""
    content = written("any input")
    for part, states in (("plant", "x"), ("form", "z")):
        holder = json.dumps(content[part]).replace(f'"a*{states}2 + u"', f'"(a - 1)*{states}2 + u"')
        content[part] = json.loads(holder.replace('"a"', '"a - 1"').replace('{"name": "a - 1"', '{"name": "a"'))
    assert finding(content).startswith("fails: it does not"), finding(content)


@pytest.mark.ordinary("pendulum")
@pytest.mark.parametrize("name", ["pendulum", "fitzhugh_nagumo"])
def test_the_claims_of_a_shipped_model_are_verified(name: str) -> None:
    claims = checked(load(ROOT / "models" / f"{name}.py"), None, "kalman_like")
    content = certificate(claims.form, claims.checks, claims.observer)
    assert finding(content).startswith("verified")
