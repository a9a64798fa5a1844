"""One norm for every gain, every rate of it and all slopes: by hand, under gains that move as badly as they may, and
what is said of it."""

from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from hypothesis import strategies as st
from oracle import adaptive_lmi as oracle
from plants import MODELS, model

import hgogen as hg
from hgogen.check import Check, Verdict
from hgogen.estimators.gains import coefficients
from hgogen.estimators.integrators import integrators
from hgogen.model import load
from hgogen.prove import semidefinite
from hgogen.prove.convergence import AtTheta, FromTheta
from hgogen.prove.varying_gain import Law, varying_gain_checks
from hgogen.recheck.verification import recheck
from hgogen.theorem import Convergence, convergence, rows
from tests.sweep import sweep

pytest.importorskip("clarabel")


def plant(flow: Any, x: Any) -> hg.System:
    return hg.System("plant", states=x, outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])


def states(n: int, size: float = 4.0) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=-size, high=size) for i in range(1, n + 1)]


def pair(system: hg.System, K: Any, law: Law) -> tuple[Check, Check]:
    """The two claims."""
    line = integrators("it", hg.forms.triangular(system))
    return varying_gain_checks("it", line, [Fraction(float(k)) for k in K], law, {})


def law(least: float, fall: float, easing: bool, b: float = 1.0) -> Law:
    return Law("l", least, Fraction(fall), easing, Fraction(b))


def proofs(checks: tuple[Check, Check]) -> tuple[FromTheta, AtTheta]:
    first, second = (check.proofs[0].fact for check in checks)
    assert isinstance(first, FromTheta)
    assert isinstance(second, AtTheta)
    return first, second


def bound(checks: tuple[Check, Check]) -> float:
    fact = checks[0].proofs[0].fact
    assert isinstance(fact, FromTheta)
    return float(fact.theta)


# --- by hand ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("p", "fall"), [(1.0, 0.5), (4.0, 2.0), (0.25, 0.1)])
def test_one_state_by_hand(p: float, fall: float) -> None:
    """x' = sin x + x has slopes in [0, 2]; V = e^2/l^(1/2): V'/V = -2 (p l - d) - l'/(2 l), l' >= -s l^2. With s at any
    l it falls from 2/(p - s/4) on, with s that eases to 0 at the least l already from 2/p on."""
    (x,) = states(1)
    system = plant([sp.sin(x) + x], (x,))
    steady, eased = (pair(system, (p,), law(40.0, fall, easing)) for easing in (False, True))
    assert 2 / (p - fall / 4) < bound(steady) <= 1.03 * 2 / (p - fall / 4)
    assert 2 / p < bound(eased) <= 1.03 * 2 / p
    assert 0.85 * (40 * (p - fall / 4) - 2) < proofs(steady)[1].falls.rate <= 40 * (p - fall / 4) - 2


def test_two_states_by_hand() -> None:
    """With no fall at all the bound is that of a gain that only rises: no less than of a constant one."""
    x = states(2)
    system = plant([x[1], 3 * sp.sin(x[0])], x)
    assert 3**0.5 < bound(pair(system, (2, 1), law(10.0, 0.0, False))) < 1.3 * 3**0.5


def test_a_gain_that_may_fall_faster_than_the_core_decays_is_not_proved() -> None:
    """x'' = 0 with poles at -1: s = 4 leaves N + s D unstable for every b > 0, without b of the plant."""
    x = states(2)
    system = plant([x[1], 0], x)
    for easing in (False, True):
        fast = pair(system, (2, 1), law(10.0, 4.0, easing))
        assert [check.verdict for check in fast] == [Verdict.UNKNOWN] * 2
        slow = pair(system, (2, 1), law(10.0, 0.1, easing))
        assert [check.verdict for check in slow] == [Verdict.PROVED] * 2


def test_the_rate_is_that_of_a_gain_that_falls_as_well() -> None:
    """x' = 0 with N = -1, V = e^2, b = 1/4: 2 l at a gain l that rests, 2 l (1 - p_1/4) at one that falls. A rate
    between them, of a forged certificate, is not that of every course."""
    (x,) = states(1)
    form = hg.forms.triangular(plant([0], (x,)))
    built = hg.observers.updated_gain(form, p_1=0.8, p_2=10, p_3=30, cap=100, gains=(1,), b=0.5)
    content = hg.certificate(form, built.checks, built.name)
    (claim,) = (claim for claim in content["claims"] if claim["id"] == "updated_gain.theta")
    evidence, id = claim["evidence"], claim["id"]

    def seen() -> str:
        return next(row.found for row in recheck(sealed(content)).rows if row.id == id)

    assert Fraction(evidence["alpha"]) < 2 * 10 * Fraction(8, 10)
    assert seen() == "verified"
    evidence["alpha"] = "19"
    assert seen() == "fails"


# --- against gains that move --------------------------------------------------------------------------------


def drawn(n: int, seed: int) -> tuple[hg.System, np.ndarray, np.ndarray]:
    """A chain of integrators with rows of sines of all states before, and K of random poles."""
    rng = np.random.default_rng(seed)
    x = states(n, 1e3)
    c = np.round(rng.uniform(-2, 2, size=(n, n)), 2)
    row = [sum(float(c[i, j]) * sp.sin(x[j]) for j in range(i + 1)) for i in range(n)]
    flow = [row[i] + (x[i + 1] if i + 1 < n else 0) for i in range(n)]
    return plant(flow, x), c, coefficients(tuple(-rng.uniform(0.7, 2, size=n)), n)


@pytest.mark.full
@sweep(8, 60, st.integers(1, 4), st.integers(0, 2**32 - 1), st.booleans(), st.floats(0.01, 0.3))
def test_v_falls_at_every_gain_and_rate(n: int, seed: int, easing: bool, fall: float) -> None:
    """V' <= -alpha l/least V, by the plant's own numbers: with slopes at their ends, gains up to 1000 times the least,
    and rates from the fastest fall to any rise."""
    system, c, K = drawn(n, seed)
    known = pair(system, K, law(3.0, fall, easing))
    if known[0].verdict is not Verdict.PROVED:
        return
    fact = known[0].proofs[0].fact
    assert isinstance(fact, FromTheta)
    P = np.array([[float(x) for x in row] for row in fact.falls.weights.P])
    b, units = float(fact.error.core_evidence["b"]), np.array([float(x) for x in fact.error.units])
    least, alpha, rng = float(fact.theta), float(fact.falls.alpha), np.random.default_rng(seed)
    N = np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0])
    for _ in range(300):
        level = least * rng.choice([1, 1.01, 1.5, 4, 1000])
        slow = -fall * (1 - least / level if easing else 1)
        r = rng.choice([slow, slow, 0.0, 0.1, 1e3])
        J = np.tril(c * rng.choice([-1, 0, 1], size=(n, n)))
        T = units * level ** -np.arange(1.0, n + 1)
        M = level * (N * np.outer(units, 1 / units) - r * np.diag(b + np.arange(n))) + T[:, None] * J / T
        form = P @ M + M.T @ P + alpha * level / least * P
        assert np.linalg.eigvalsh(form).max() <= 1e-9 * np.abs(P @ M).max()


@cache
def disturbed(low: float) -> hg.Observer:
    form = hg.forms.triangular(load(MODELS / "disturbed_pendulum.py").plant)
    gains = {"K": oracle.K, "P": oracle.P, "sigma": oracle.SIGMA, "rise": oracle.ALPHA, "threshold": oracle.LEVEL}
    return hg.observers.adaptive_lmi(form, gamma=(low, 80), **gains)


@pytest.mark.parametrize("seed", range(3))
def test_the_error_decays_under_a_gain_that_jumps_up_and_falls_as_fast_as_it_may(seed: int) -> None:
    """gamma from 1 on, risen within .01 at random times, else falling by sigma gamma^2: V(t) <= exp(-2 r t) V(0)."""
    first, second = proofs(tuple(c for c in disturbed(1.0).checks if c.id.fact in ("convergence", "theta")))
    P = np.array([[float(x) for x in row] for row in second.falls.weights.P])
    b, rng = float(first.error.core_evidence["b"]), np.random.default_rng(seed)
    jumps, K = np.sort(rng.uniform(0, 1, size=4)), np.array(oracle.K)
    system = load(MODELS / "disturbed_pendulum.py").plant
    row = sp.lambdify(list(system.states), system.flow[2], "math")
    h, s = 2e-4, np.array([0, 0, 0.01, 1, 1, 1, 1])
    path = [s]

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        g, e = s[6], s[0] - s[3]
        if any(0 <= t - jump < 0.01 for jump in jumps):
            moved = 400 * g if g < 80 else 0.0
        else:
            moved = -oracle.SIGMA * g**2 if g > 1 else 0.0
        own = [s[4] + g * K[0] * e, s[5] + g**2 * K[1] * e, row(*s[3:6]) + g**3 * K[2] * e]
        return np.array([s[1], s[2], row(*s[:3]), *own, moved])

    for k in range(round(1 / h)):
        one = rate(k * h, s)
        two = rate((k + 0.5) * h, s + h / 2 * one)
        three = rate((k + 0.5) * h, s + h / 2 * two)
        s = s + h / 6 * (one + 2 * two + 2 * three + rate((k + 1) * h, s + h * three))
        path.append(s)
    t, s = h * np.arange(len(path)), np.array(path).T
    assert np.abs(s[:3]).max() < 4
    assert s[6].max() > 50
    e = (s[3:6] - s[:3]) / s[6] ** (b + np.arange(3.0)[:, None])
    V = np.einsum("it,ij,jt->t", e, P, e)
    assert (np.exp(-2 * second.falls.rate * t) * V[0] * (1 + 1e-4) + 1e-12 * V[0] >= V).all()


# --- what is said -------------------------------------------------------------------------------------------


def updated(**changes: Any) -> hg.Observer:
    form = hg.forms.triangular(model("pendulum"))
    gains = {"p_1": 0.15, "p_2": 5, "p_3": 6, "cap": 200, "poles": (-1, -1)}
    return hg.observers.updated_gain(form, **{**gains, **changes})


def claim(observer: hg.Observer, fact: str) -> Check:
    return next(check for check in observer.checks if check.id == f"{observer.name}.{fact}")


def test_a_p_2_that_is_enough_alone_is_the_theorem() -> None:
    """The pendulum needs 4.43, the bound of a constant gain: at p_2 the gain does not fall."""
    proved, low = updated(), updated(p_2=4.4)
    assert 4.4 < bound((claim(proved, "convergence"), claim(proved, "theta"))) < 4.6
    known = rows(proved.theorem, proved.checks)
    assert not [row for row in known if "Gamma" in row.claim]
    assert next(row for row in known if row.claim.startswith("p_2 is large enough")).verdict is Verdict.PROVED
    assert convergence("updated_gain", proved.checks) is Convergence.ABOVE
    assert claim(low, "theta").verdict is Verdict.UNKNOWN
    assert claim(low, "theta").fix.startswith("Raise p_2, ")
    assert [row for row in rows(low.theorem, low.checks) if "Gamma" in row.claim]
    assert convergence("updated_gain", low.checks) is Convergence.BELOW


def test_what_p_3_and_the_cap_are_does_not_count() -> None:
    """Whatever lets the gain rise, or keeps it from rising."""
    bounds = {bound((claim(one, "convergence"), claim(one, "theta"))) for one in (updated(), updated(p_3=0.01, cap=6))}
    assert len(bounds) == 1


def test_the_bound_of_the_paper_is_far_above() -> None:
    """(62) of the disturbed pendulum is 6.35: slopes of 1/2 in place of their norm make of it .2."""
    adaptive = disturbed(20.53)
    assert 0.1 < bound((claim(adaptive, "convergence"), claim(adaptive, "theta"))) < 0.25
    assert convergence("adaptive_lmi", adaptive.checks) is Convergence.ABOVE


def test_without_a_solver_the_declared_p_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(what: str) -> None:
        raise semidefinite.NoSolver(what)

    with_solver = bound((claim(disturbed(20.53), "convergence"), claim(disturbed(20.53), "theta")))
    disturbed.cache_clear()
    monkeypatch.setattr("hgogen.prove.semidefinite.solver_modules", missing)
    alone = disturbed(20.53)
    disturbed.cache_clear()
    assert with_solver < bound((claim(alone, "convergence"), claim(alone, "theta"))) < 6.347
    assert claim(updated(p_2=30), "theta").verdict is Verdict.PROVED


def test_a_form_with_nothing_to_go_by_says_so() -> None:
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2")
    known = pair(plant([x2, -(x2**3)], (x1, x2)), (2, 1), law(5.0, 0.1, False))
    assert str(known[0].reason).startswith("the bound rests on triangular.lipschitz")


@pytest.mark.full
def test_more_slopes_than_corners_are_taken_of_have_multipliers() -> None:
    system, _, K = drawn(4, 2)
    known = pair(system, K, law(3.0, 0.1, True))
    fact = known[0].proofs[0].fact
    assert isinstance(fact, FromTheta)
    assert len(fact.falls.weights.S) == 10
