"""Certificates of observers: what is verified is true of the papers' equations, and no changed number gets through."""

import copy
import json
import random
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.certificate import certificate
from hgogen.commands import jobs
from hgogen.model import load
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.recheck import NoCertificate, Unreadable, recheck

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 20
POLES = (-1, -1.25)


def heated() -> hg.Form:
    """x1' = a x2, x2' = -x1 - x2/5 + sin(x1)/4, y = 2 x1: gains that vary with a parameter."""
    x = [hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2)]
    a, y = hg.Signal("a", "", "", 1, low=0.5, high=2), hg.Signal("y")
    flow = [a * x[1], -x[0] - x[1] / 5 + sp.sin(x[0]) / 4]
    return hg.forms.triangular(
        hg.System("heated", states=x, outputs=(y,), parameters=(a,), flow=flow, output=[2 * x[0]])
    )


# Observers whose bound is certified, by name: on `heated`, and with the gain above the bound.
BUILT: dict[str, dict[str, Any]] = {
    "filtered": {"theta": 1e4, "alpha": 3, "beta": 1, "poles": (-1, -1)},
    "filtered_injection": {"theta": 1e4, "F": ((-3, 0), (1, -3)), "G": (1, 0), "H": ((2, 0), (0, 1))},
    "low_power": {"theta": 1e4},
    "peaking_free": {"theta": 1e4},
    "stubborn": {"theta": 1e4, "decay": 0.5, "r": 10, "poles": POLES},
    "dead_zone": {"theta": 1e4, "decay": 1, "r": 0.1, "poles": POLES},
}


@cache
def _written(name: str) -> str:
    observer = getattr(hg.observers, name)(heated(), **BUILT[name])
    return json.dumps(certificate(observer.form, observer.checks, observer.name))


def written(name: str) -> dict[str, Any]:
    """The certificate of an observer on `heated`."""
    content: dict[str, Any] = json.loads(_written(name))
    return content


def sealed(content: dict[str, Any]) -> str:
    """As a forger would write it: with the digests of the changed content."""
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def found(content: dict[str, Any]) -> dict[str, str]:
    return {row.id: row.found for row in recheck(sealed(content)).rows}


def claim_of(content: dict[str, Any], id: str) -> dict[str, Any]:
    return next(claim for claim in content["claims"] if claim["id"] == id)


# --- what is written is verified ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILT)
def test_all_claims_of_an_observer_are_verified(name: str) -> None:
    content = written(name)
    result = found(content)
    assert set(result.values()) == {"verified"}
    assert f"{name}.theta" in result
    assert not falsehood(content)


@pytest.mark.parametrize(
    "name", ["filtered", "filtered_injection", "peaking_free", "low_power", "stubborn", "dead_zone"]
)
def test_the_claims_of_a_shipped_model_are_verified(name: str) -> None:
    claims = jobs.checked(load(ROOT / "models" / "disturbed_pendulum.py"), None, name)
    content = certificate(claims.form, claims.checks, claims.observer)
    result = found(content)
    assert "stated" not in {claim["verdict"] for claim in content["claims"]}
    assert result[f"{name}.convergence"] == "verified"
    assert not falsehood(content)


# --- what the papers' equations say, in floats ----------------------------------------------------------------------


def floats(value: Any) -> Any:
    return np.array([floats(each) for each in value]) if isinstance(value, list) else float(Fraction(value))


Numbers = dict[str, Any]
Rows = Callable[[np.ndarray, float, Numbers, np.ndarray], np.ndarray]


def _filtered(x: np.ndarray, theta: float, o: Numbers, share: np.ndarray) -> np.ndarray:
    w, eta = np.split(x, 2)
    source = np.array([-w[0], *eta[:-1]])
    return np.array(
        [*(np.append(w[1:], 0) + o["gains"] * eta), *(-theta * o["alpha"] * eta + theta**2 * o["beta"] * source)]
    )


def _filtered_injection(x: np.ndarray, theta: float, o: Numbers, share: np.ndarray) -> np.ndarray:
    n = len(o["NH"])
    w, eta = x[:n], x[n:]
    pushed = theta ** np.arange(1, n + 1) * (o["NH"] @ eta)
    return np.array([*(np.append(w[1:], 0) + pushed), *(theta * (o["F"] @ eta) - theta * o["G"] * w[0])])


def _low_power(x: np.ndarray, theta: float, o: Numbers, share: np.ndarray) -> np.ndarray:
    p, q = np.split(x, 2)
    e = np.array([-p[0], *(q[:-1] - p[1:])])
    k = o["gains"]
    return np.array([*(q + theta * k[:, 0] * e), *(np.append(q[1:], 0) + theta**2 * k[:, 1] * e)])


def _peaking_free(x: np.ndarray, theta: float, o: Numbers, share: np.ndarray) -> np.ndarray:
    n = (len(x) + 1) // 2
    p, q, k = x[:n], x[n:], o["gains"]
    sat = share * q
    e = np.array([-p[0], *(sat - p[1:])])
    onto = np.append(q, 0) + theta * np.append(k[:, 0], o["last"]) * e
    return np.array([*onto, *(np.append(sat[1:], 0) + theta**2 * k[:, 1] * e[:-1])])


# The linear part of the error's flow; of n states, which w_i(k) a field stands for, the power of theta it is scaled by,
# and whether c_i(k) enters; which fields the model reads.
FIELDS: dict[str, tuple[Rows, Callable[[int], tuple[list[int], list[int], list[bool], list[int]]]]] = {
    "filtered": (
        _filtered,
        lambda n: ([*range(n)] * 2, [*range(n), *range(1, n + 1)], [True] * n + [False] * n, [*range(n)]),
    ),
    "filtered_injection": (
        _filtered_injection,
        lambda n: ([*range(n), *[0] * n], [*range(n), *[0] * n], [True] * n + [False] * n, [*range(n)]),
    ),
    "low_power": (
        _low_power,
        lambda n: (
            [*range(n - 1), *range(1, n)],
            [*range(n - 1), *range(1, n)],
            [True] * (2 * n - 2),
            [0, *range(n - 1, 2 * n - 2)],
        ),
    ),
    "peaking_free": (
        _peaking_free,
        lambda n: ([*range(n), *range(1, n)], [*range(n), *range(1, n)], [True] * (2 * n - 1), [*range(n)]),
    ),
}


def falsehood(content: dict[str, Any]) -> str:
    """What sampling says against the claims about the observer, or "": above the bound on theta V' is negative."""
    name, o = content["observer"]["name"], floats_of(content["observer"])
    for claim in content["claims"]:
        id, told = claim["id"], claim["evidence"]
        if claim["verdict"] != "proved" or not id.startswith(f"{name}."):
            continue
        if id.endswith(".core") and (said := _limited(content, o, told, np.inf, 1)):
            return f"{id}: {said}"
        if id.endswith(".convergence"):
            bound = threshold(name, told)
            for theta in (bound * (1 + 1e-9), 10 * bound):
                if said := (_limited if name in ("stubborn", "dead_zone") else _linear)(content, o, told, theta, 3):
                    return f"{id} at theta = {theta}: {said}"
        if id.endswith(".theta") and o["theta"] <= threshold(
            name, claim_of(content, f"{name}.convergence")["evidence"]
        ):
            return f"{id}: it is below"
    return ""


def floats_of(observer: dict[str, Any]) -> Numbers:
    return {key: floats(value) for key, value in observer.items() if key != "name"}


def threshold(name: str, told: dict[str, Any]) -> float:
    e = {key: floats(told[key]) for key in ("bound", "push", "peak", "margin", "mu") if key in told}
    if "push" in e:
        return max(1.0, 2 * e["push"] * e["bound"])
    weight = e["peak"] + (e["mu"] if name == "stubborn" else 0)
    return max(1.0, 2 * e["bound"] * max(weight / e["margin"], e["peak"]))


def slopes(content: dict[str, Any]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """dc/dw in the coordinates of integrators, and their scale a_1 .. a_i from z, at sample points."""
    form, plant = content["form"], content["plant"]
    yield from _sampled(json.dumps([form, plant["inputs"] + plant["parameters"]]))


@cache
def _sampled(text: str) -> list[tuple[np.ndarray, np.ndarray]]:
    form, common = json.loads(text)
    every = form["states"] + common
    symbols = {s["name"]: sp.Symbol(s["name"]) for s in every}
    z = [symbols[s["name"]] for s in form["states"]]
    b = sp.Matrix([sp.sympify(row, symbols) for row in form["b"]])
    a = [sp.sympify(form["output"][0], symbols).diff(z[0])]
    a += [sp.sympify(form["A"][i][i + 1], symbols) for i in range(len(z) - 1)]
    graph = sp.lambdify(list(symbols.values()), [b.jacobian(z).tolist(), a], "math")
    draw, points = random.Random(3), []
    ranges = [[float(Fraction(s[end])) for end in ("low", "high")] for s in every]
    for _ in range(SAMPLES):
        J, gains = map(np.array, graph(*(draw.choice([*ends, draw.uniform(*ends)]) for ends in ranges)))
        scale = np.cumprod(gains)
        points.append((scale[:, None] * J / scale, scale))
    return points


def _linear(content: dict[str, Any], o: Numbers, told: dict[str, Any], theta: float, times: int) -> str:
    """V = e'P e in e_k = s_i(k) theta^-p(k) (x_k - w_i(k))."""
    rows, layout = FIELDS[content["observer"]["name"]]
    n = len(content["form"]["states"])
    index, power, fed, read = layout(n)
    P, units, draw = floats(told["P"]), floats(told["units"]), np.random.default_rng(5)
    T = units[index] / theta ** np.array(power, dtype=float)
    for J, scale in slopes(content):
        for text, s, u in zip(told["scale"], scale, units, strict=True):
            if not sp.sympify(text).free_symbols and not np.isclose(float(sp.sympify(text)), s * u):
                return "the scale is another"
        G = np.array([[float(enters and i == k) for k in range(n)] for i, enters in zip(index, fed, strict=True)])
        if np.linalg.norm(P @ G, 2) > floats(told["push"]) * (1 + 1e-12):
            return "|P G| is larger"
        if np.linalg.norm(units[:, None] * J / units, 2) > floats(told["bound"]) * (1 + 1e-12):
            return "the slope is larger"
        share = draw.choice([0.0, 1.0, draw.uniform()], n - 1)
        flow = np.array([rows(x, theta, o, share) for x in np.eye(len(index))]).T
        for row, (i, enters) in enumerate(zip(index, fed, strict=True)):
            flow[row, read] += J[i] * enters
        M = T[:, None] * flow / T
        if np.linalg.eigvalsh(P).min() <= 0 or np.linalg.eigvalsh(P @ M + M.T @ P).max() > 1e-9 * abs(P @ M).max():
            return "V' may be positive"
    return ""


def _limited(content: dict[str, Any], o: Numbers, told: dict[str, Any], theta: float, times: int) -> str:
    """V = eps'P eps + mu sigma, or + mu max(eps_1^2 - sigma, 0), at random errors; theta inf: without the model."""
    P, units, mu, K = floats(told["P"]), floats(told["units"]), floats(told["mu"]), o["gains"]
    n, draw = len(K), np.random.default_rng(7)
    N = units[:, None] * (np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0])) / units
    K = units * K
    if np.linalg.eigvalsh(P).min() <= 0:
        return "P is not positive"
    for J, _ in slopes(content):
        level = 0.0 if np.isinf(theta) else 1 / theta
        D = units * theta ** -np.arange(n) if level else units
        rest = level * D[:, None] * J / D
        for _ in range(times * 10):
            eps = draw.normal(size=n)
            root = abs(draw.choice([0, draw.normal(), eps[0] * draw.uniform()]))
            s = np.clip(eps[0], -root, root)
            sigma = -o["decay"] * root**2 + o["r"] * eps[0] ** 2
            if content["observer"]["name"] == "dead_zone":
                value = 2 * eps @ P @ (N @ eps + K * s + rest @ eps) + mu * sigma
            else:
                rate = N @ eps + K * (eps[0] - s) + rest @ eps
                value = 2 * eps @ P @ rate + (mu * (2 * eps[0] * rate[0] - sigma) if abs(eps[0]) > root else 0)
            if value > 1e-9 * abs(P).max() * (eps @ eps + root**2):
                return f"V' = {value}"
    return ""


# --- no changed number ----------------------------------------------------------------------------------------------


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path to each text that is a number."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*path, key))
    elif isinstance(value, str) and path[-1] not in ("name", "id", "verdict", "tree", "expression", "reason"):
        yield path


def changed(content: dict[str, Any], path: tuple[Any, ...], how: str) -> dict[str, Any]:
    """One number made larger or smaller by a share, or of the other sign."""
    result = copy.deepcopy(content)
    holder = result
    for key in path[:-1]:
        holder = holder[key]
    old = holder[path[-1]]
    factor = {"sign": "-1", "more": "1001/1000", "less": "999/1000", "far": "10", "zero": "0"}[how]
    try:
        holder[path[-1]] = str(Fraction(old) * Fraction(factor))
    except ValueError:  # an expression
        holder[path[-1]] = f"({old})*({factor})"
    return result


@pytest.mark.parametrize("how", ["sign", "more", "less", "far", "zero"])
@pytest.mark.parametrize("name", BUILT)
def test_a_forger_gets_only_true_statements_through(name: str, how: str) -> None:
    """Of the observer's numbers, and of all evidence about it; what is still verified is not refuted by sampling."""
    content = written(name)
    every = [("observer", *path) for path in places(content["observer"])]
    for k, claim in enumerate(content["claims"]):
        if claim["id"].startswith(f"{name}."):
            every += [("claims", k, "evidence", *path) for path in places(claim["evidence"])]
    assert len(every) > 15
    failed = 0
    for path in every:
        forged = changed(content, path, how)
        if forged == content:
            continue
        try:
            result = found(forged)
        except (NoCertificate, Unreadable):
            failed += 1
            continue
        if "fails" in result.values():
            failed += 1
        else:
            assert not falsehood(forged), (path, falsehood(forged))
    assert failed > len(every) // 3
