"""The high gain on the uniform form: an oracle, the known reach of its proof, what is verified, what is refused."""

import copy
import json
import math
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from oracle.uniform_injection import uniform_injection

import hgogen as hg
from hgogen.check import Refuted, Verdict
from hgogen.prove.quadratic import Quadratic
from hgogen.prove.semidefinite import margin
from hgogen.reading.given import BadGain
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import NotHurwitz

u = hg.Signal("u", low=-1, high=1)
y = hg.Signal("y")


def signals(n: int) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, n + 1)]


@cache
def bent(n: int, ratio: float, last: str = "0") -> hg.Form:
    """x_i' = x_(i+1) + (ratio - 1) x_(i+1)^3/3, whose slopes are 1 to the ratio; x_n' = last, y = x_1."""
    x = signals(n)
    flow = [z + sp.Rational(str(ratio - 1)) * z**3 / 3 for z in x[1:]]
    end = sp.sympify(last, {s.name: s for s in (*x, u)})
    return hg.forms.uniform(hg.System("bent", states=x, inputs=(u,), outputs=(y,), flow=[*flow, end], output=[x[0]]))


def binomial(n: int) -> list[int]:
    return [math.comb(n, i) for i in range(1, n + 1)]


def made(form: hg.Form, theta: float = 5, **gains: Any) -> hg.Observer:
    return hg.observers.uniform_injection(form, **{"theta": theta, "gains": binomial(form.n), **gains})


def claims(observer: hg.Observer) -> dict[str, Any]:
    return {check.id.fact: check for check in observer.checks if check.id.maker == "uniform_injection"}


def certificate(observer: hg.Observer) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(
        json.dumps(hg.certificate(observer.form, observer.checks, "uniform_injection"))
    )
    return content


# --- the equation -------------------------------------------------------------------------------------------


def test_it_is_the_equation() -> None:
    """By RK4 against plain numpy, with an estimate that leaves the ranges on its way."""
    observer = made(bent(2, 3.0, "-x1 + u"), theta=6, initial={"x1": -1, "x2": 1})
    s = float(observer.form.A[0, 1])
    assert 1 <= s <= 3
    step = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python", between="hold")
    rate = uniform_injection(
        np.array([2.0, 1.0]),
        6,
        lambda x, u: np.array([x[1] + 2 * x[1] ** 3 / 3, u - x[0]]),
        lambda x: [1 + 2 * x[1] ** 2],
        [s],
    )
    ys, us = 1.2 * np.cos(np.arange(120) / 20), np.sin(np.arange(120) / 9)
    run = step.run(u=us[:, None], y=ys[:, None]).x
    z, states = np.array([-1.0, 1.0]), []
    for k, sample in enumerate(ys):
        if k:
            h, mid = 0.01, (ys[k - 1] + sample) / 2
            k1 = rate(z, us[k], ys[k - 1])
            k2 = rate(z + h / 2 * k1, us[k], mid)
            k3 = rate(z + h / 2 * k2, us[k], mid)
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3, us[k], sample))
        states.append(z)
    reported = np.array(states)
    inside = np.abs(reported).max(axis=1) < 1
    assert 0.2 < inside.mean() < 1
    assert np.abs(run - reported)[:, 0][inside].max() < 1e-9


def test_signs_of_slopes_do_not_matter() -> None:
    """x1' = -(x2 + x2^3/3): the correction turns with the slope."""
    x = signals(2)
    form = hg.forms.uniform(
        hg.System("turned", states=x, outputs=(y,), flow=[-x[1] - x[1] ** 3 / 3, 0], output=[-2 * x[0] + 1])
    )
    observer = made(form, theta=4)
    assert {check.verdict for check in claims(observer).values()} == {Verdict.PROVED}
    step = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")
    t, a = np.arange(600) * 0.01, 0.3
    x1 = 0.9 - (a + a**3 / 3) * t
    run = step.run(y=(1 - 2 * x1)[:, None]).x
    assert np.abs(run[-1] - (x1[-1], a)).max() < 1e-3


# --- what is proved -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "ratio", "proved"), [(2, 5.8, True), (2, 5.86, False), (3, 1.98, True), (3, 2.02, False)]
)
def test_the_known_reach(n: int, ratio: float, proved: bool) -> None:
    """K binomial, the slopes from state to state in [m, M], no others: M/m < 5.83 for n = 2, < 2.0 for n = 3."""
    pytest.importorskip("clarabel")
    known = claims(made(bent(n, ratio)))
    verdict = Verdict.PROVED if proved else Verdict.UNKNOWN
    assert known["convergence"].verdict is known["theta"].verdict is verdict
    if not proved:
        assert "no norm is found in which the linear part of the error falls" in str(known["convergence"].reason)


@pytest.mark.full
@pytest.mark.parametrize(("ratio", "last"), [(2.0, "-3*sin(2*x1) - x2 + u"), (3.0, "x1*x2 - x1**2")])
def test_the_bound_is_less_than_what_is_declared_and_held_by_trials(ratio: float, last: str) -> None:
    """At a theta above the bound errors fall in |e|_P everywhere, of estimates far outside of the ranges too; a theta
    below it is not claimed."""
    pytest.importorskip("clarabel")
    form = bent(2, ratio, last)
    high = claims(made(form, theta=40))
    assert high["theta"].verdict is Verdict.PROVED
    (grounds,) = high["convergence"].proofs
    least = float(grounds.fact.theta)
    assert 0.1 < least < 40
    assert claims(made(form, theta=least * 0.5))["theta"].verdict is Verdict.UNKNOWN
    theta = least * 1.1
    (grounds,) = claims(made(form, theta=theta))["theta"].proofs
    falls = grounds.fact.falls
    assert falls.alpha > 0
    P = np.array([[float(x) for x in row] for row in falls.weights.P])
    s, rng = float(made(form).form.A[0, 1]), np.random.default_rng(3)
    rate = sp.lambdify((*form.states, u), form.flow)
    for _ in range(4000):
        x, force = rng.uniform(-1, 1, 2), rng.uniform(-1, 1)
        z = rng.uniform(-1, 1, 2) if rng.random() < 0.5 else rng.uniform(-30, 30, 2)
        held = np.clip(z, -1, 1)
        slope = 1 + (ratio - 1) * held[1] ** 2
        F = np.array(rate(*held, force)) + np.array([s * (z[1] - held[1]), 0])
        F += np.array([theta * 2, theta**2 / slope]) * (x[0] - z[0])
        scale = np.array([1, s / theta])
        e, moved = scale * (z - x), scale * (F - np.array(rate(*x, force)))
        assert 2 * e @ P @ moved <= -float(falls.alpha) * (e @ P @ e) + 1e-9


@pytest.mark.full
def test_many_slopes_are_proved_by_multipliers() -> None:
    """Of four states whose last row reads all of them there are too many combinations."""
    pytest.importorskip("clarabel")
    x = signals(4)
    flow = [*(z + z**3 / 30 for z in x[1:]), -(x[0] ** 2) - x[1] ** 2 / 3 - x[2] * x[1] / 4 - x[3] ** 3 / 5]
    form = hg.forms.uniform(hg.System("long", states=x, outputs=(y,), flow=flow, output=[x[0]]))
    observer = made(form, theta=30)
    known = claims(observer)
    assert known["theta"].verdict is Verdict.PROVED
    content = certificate(observer)
    assert len(next(c for c in content["claims"] if c["id"] == "uniform_injection.convergence")["evidence"]["S"]) > 7
    assert {row.found for row in recheck(json.dumps(content)).rows} == {"verified"}


def test_without_a_solver_it_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "clarabel", None)
    known = claims(made(bent(2, 2.25)))
    assert known["convergence"].verdict is Verdict.UNKNOWN
    assert "needs clarabel" in str(known["convergence"].reason)


def test_as_it_runs_nothing_is_claimed() -> None:
    """Two estimates do not obey the equation of the error: the proof is against the plant."""
    step = hg.sample(made(bent(2, 2.0)), hg.methods.rk4, dt=0.01, engine="python")
    assert hg.contraction(step).checks[0].verdict is Verdict.UNKNOWN


# --- what is verified again ---------------------------------------------------------------------------------


def sealed(content: dict[str, Any]) -> str:
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


@cache
def file_of_two() -> str:
    return json.dumps(certificate(made(bent(2, 3.0, "-x1**2 + u"), theta=20)))


def content_of_two() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file_of_two())
    content.pop("digest", None)
    return content


def test_the_certificate_is_verified() -> None:
    pytest.importorskip("clarabel")
    rows = {row.id: row for row in recheck(file_of_two()).rows}
    assert {row.found for row in rows.values()} == {"verified"}
    assert "every theta above" in rows["uniform_injection.convergence"].sentence


def forged(change: Any) -> str:
    content = content_of_two()
    evidence = next(c for c in content["claims"] if c["id"] == "uniform_injection.convergence")["evidence"]
    change(evidence, content)
    rows = {row.id: row.found for row in recheck(sealed(content)).rows}
    return str(rows["uniform_injection.convergence"])


@pytest.mark.parametrize(
    "change",
    [
        lambda e, c: e["shares"][0].update(low=e["shares"][0]["high"]),
        lambda e, c: e["shares"][0].update(high="1/2"),
        lambda e, c: e["shares"].pop(),
        lambda e, c: e["shares"][0].update(expression="1"),
        lambda e, c: e.update(least="1/1000"),
        lambda e, c: e.update(least="-1"),
        lambda e, c: e.update(P=[["1", "2"], ["2", "1"]]),
        lambda e, c: e.update(P=[["1", "0"], ["0", "1"]]),
        lambda e, c: e.update(S=["1", "1", "1", "1", "1"]),
        lambda e, c: e.update(scale=["1", "1"]),
        lambda e, c: e["slopes"].pop(),
        lambda e, c: e["slopes"][0].update(low="0", high="0"),
        lambda e, c: c["observer"].update(gains=["2", "-1"]),
        lambda e, c: c["observer"].update(gains=["2", "100"]),
        lambda e, c: c["form"]["A"][0].__setitem__(1, "z2"),
        lambda e, c: c["plant"]["states"][1].update(high="3"),
    ],
)
def test_a_forged_number_fails(change: Any) -> None:
    pytest.importorskip("clarabel")
    assert forged(lambda e, c: None) == "verified"
    assert forged(change) != "verified"


def evidence_of(content: dict[str, Any]) -> dict[str, Any]:
    claim: dict[str, Any] = next(c for c in content["claims"] if c["id"] == "uniform_injection.convergence")
    evidence: dict[str, Any] = claim["evidence"]
    return evidence


def common(*vertices: Any) -> list[list[str]]:
    """P with M'P + P M < 0 for all of these M, in text."""
    one, nothing = np.eye(2), np.zeros((0, 2))
    best = margin([Quadratic(((one, np.array(M)),), nothing, nothing) for M in vertices], "a forgery")
    assert best is not None
    assert best.margin > 0
    return [[str(Fraction(float(x))) for x in row] for row in best.P]


def forger_of_nine() -> dict[str, Any]:
    """A certificate that claims of slopes of 1 to 9 what holds at the smallest gain alone: P, and all ranges right."""
    content = certificate(made(bent(2, 9.0)))
    content.pop("digest", None)
    s, small = Fraction(content["form"]["A"][0][1]), Fraction(1, 10**9)
    ends = (1 / s - small, 9 / s + small)
    shares = {"expression": "1/(1 + 8*z2**2)", "box": {"z2": ["-1", "1"]}, "tree": "."}
    shares |= {"low": str(1 / Fraction(9) - small), "high": str(1 + small)}
    slope = {"row": "1", "column": "2", "low": str(ends[0] - 1), "high": str(ends[1] - 1), "tree": "."}
    P = common(*([[-2.0, float(end)], [-float(s) / 9, 0.0]] for end in ends))
    evidence = {
        "scale": ["1", str(s)],
        "slopes": [slope],
        "shares": [shares],
        "least": "1",
        "P": P,
    }
    claim = next(c for c in content["claims"] if c["id"] == "uniform_injection.convergence")
    claim.update(verdict="proved", evidence=evidence)
    content["observer"] = {"name": "uniform_injection", "theta": "5", "gains": ["2", "1"]}
    return content


def test_shares_at_one_end_alone_prove_nothing() -> None:
    pytest.importorskip("clarabel")
    content = forger_of_nine()
    rows = {row.id: row for row in recheck(sealed(content)).rows}
    assert rows["uniform_injection.convergence"].found == "fails"
    assert "its inequality is not negative" in rows["uniform_injection.convergence"].sentence


def test_multipliers_are_paid_for() -> None:
    """By a P that decays at the middle of all ranges: small ones free the slopes in -S, large ones cost H'S H."""
    pytest.importorskip("clarabel")
    content = forger_of_nine()
    s, evidence = Fraction(content["form"]["A"][0][1]), evidence_of(content)
    evidence.update(P=common([[-2.0, float(5 / s)], [-float(5 * s / 9), 0.0]]))
    for S in (["1000000"] * 2, ["1/1000000"] * 2):
        evidence["S"] = S
        rows = {row.id: row for row in recheck(sealed(content)).rows}
        assert "its inequality is not negative" in rows["uniform_injection.convergence"].sentence


@pytest.mark.parametrize("alpha", ["-1", "1000"])
def test_a_forged_rate_fails(alpha: str) -> None:
    pytest.importorskip("clarabel")
    content = content_of_two()
    claim = next(c for c in content["claims"] if c["id"] == "uniform_injection.theta")
    assert Fraction(claim["evidence"]["alpha"]) > 0
    claim["evidence"]["alpha"] = alpha
    assert {row.id: row.found for row in recheck(sealed(content)).rows}["uniform_injection.theta"] == "fails"


def test_a_theta_below_the_bound_is_not_verified() -> None:
    pytest.importorskip("clarabel")
    content = content_of_two()
    for theta, outcome in (("20", "verified"), ("1/1000", "fails")):
        other = copy.deepcopy(content)
        other["observer"]["theta"] = theta
        assert {row.id: row.found for row in recheck(sealed(other)).rows}["uniform_injection.theta"] == outcome


# --- what is refused ----------------------------------------------------------------------------------------


def system(flow: Any, output: Any = None) -> hg.System:
    x = signals(2)
    return hg.System("bad", states=x, outputs=(y,), flow=flow(*x), output=[x[0] if output is None else output(*x)])


@pytest.mark.parametrize(
    ("form", "asked", "error", "said"),
    [
        (
            lambda: hg.forms.triangular(system(lambda a, b: [b, 0])),
            {},
            BadGain,
            r"uniform_injection takes a uniform form",
        ),
        (lambda: bent(2, 2.0), {"theta": 0}, BadGain, r"theta = 0 must be a positive finite number"),
        (lambda: bent(2, 2.0), {"gains": (1,)}, BadGain, r"gains = \(1,\) must be 2 finite numbers"),
        (lambda: bent(2, 2.0), {"gains": (1, -1)}, NotHurwitz, r"gains: the linear error core"),
        (lambda: bent(2, 2.0), {"poles": (-1, -1)}, BadGain, r"uniform_injection takes either the poles"),
        (
            lambda: hg.forms.uniform(system(lambda a, b: [b, 0], lambda a, b: a + a**3)),
            {},
            BadGain,
            r"uniform_injection wants an output that is linear in its state, not",
        ),
        (lambda: hg.forms.uniform(system(lambda a, b: [b**2, 0])), {}, Refuted, r"uniform\.slope_2"),
    ],
)
def test_refusals(form: Any, asked: dict[str, Any], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        made(form(), **asked)


def test_a_slope_without_a_range_is_named() -> None:
    a, b = hg.Signal("x1"), hg.Signal("x2")
    form = hg.forms.uniform(hg.System("open", states=(a, b), outputs=(y,), flow=[b + b**3, 0], output=[a]))
    with pytest.raises(BadGain, match=r"divides by the slopes: F_1' = .* has no finite range that keeps off zero"):
        made(form)
