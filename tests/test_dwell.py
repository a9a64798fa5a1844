"""How long a high gain must hold: by the norms of the jumps between two gains, and along switchings that are bad."""

import json
import re
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import model
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Check, Verdict
from hgogen.estimators.integrators import integrators
from hgogen.prove.convergence import DecayProof, Flow
from hgogen.prove.error_models import on_companion
from hgogen.prove.inclusion import Inclusion, Nothing
from hgogen.prove.varying_gain import DwellProof, switching_checks
from hgogen.recheck.verification import recheck
from hgogen.theorem import Convergence, convergence

HIGH, LOW, POLES = 40.0, 20.0, (3.0, 3.0, 1.0)  # s^3 + 3 s^2 + 3 s + 1


@cache
def form() -> hg.Form:
    return hg.forms.triangular(model("disturbed_pendulum"))


@cache
def error() -> Inclusion:
    known = on_companion(integrators("x", form()), POLES)
    assert isinstance(known, Inclusion)
    return known


def checks(theta: float, low: float, hold: float) -> dict[str, Check]:
    return {check.id: check for check in switching_checks("x", form(), theta, low, hold, error())}


@cache
def enough(theta: float, low: float) -> float:
    """The time that is said to be."""
    return float(checks(theta, low, 1e-6)["x.hold"].fix.split()[3].rstrip(","))


def proof(theta: float, low: float) -> tuple[np.ndarray, np.ndarray, DwellProof]:
    """P of the low gain and of the high one, and what is proved of the time."""
    known = checks(theta, low, 2 * enough(theta, low))
    held = known["x.hold"].proofs[0].fact
    return matrix(known["x.theta"].proofs[0].fact.falls), matrix(held.falls), held


def matrix(falls: DecayProof) -> np.ndarray:
    return np.array([[float(x) for x in row] for row in falls.weights.P])


def fastest(theta: float) -> DecayProof:
    falls = Flow(error(), Fraction(theta)).fastest
    assert falls is not None
    return falls


def jumps(low: np.ndarray, high: np.ndarray, ratio: float) -> tuple[float, float]:
    """What V gains at most at a switch to the high gain, and at one back: by the eigenvalues of pencils."""
    D = np.diag(ratio ** -np.arange(3.0))
    back = np.linalg.inv(D)
    pencils = (low, D @ high @ D), (high, back @ low @ back)
    up, down = (float(np.linalg.eigvals(np.linalg.solve(*pencil)).real.max()) for pencil in pencils)
    return up, down


def test_the_time_is_enough_and_is_what_the_jumps_ask() -> None:
    """Of what V gains in both jumps at most, and loses in between."""
    least = enough(HIGH, LOW)
    assert checks(HIGH, LOW, 1.001 * least)["x.hold"].verdict is Verdict.PROVED
    assert checks(HIGH, LOW, 0.99 * least)["x.hold"].verdict is Verdict.UNKNOWN
    low, high, held = proof(HIGH, LOW)
    assert (float(held.up), float(held.down)) == pytest.approx(jumps(low, high, HIGH / LOW), rel=1e-4)
    assert least == pytest.approx(np.log(float(held.up * held.down)) / float(held.falls.alpha), rel=1e-3)


@pytest.mark.parametrize("ratio", [1.25, 2, 5])
def test_the_norm_of_the_high_gain_is_chosen_for_the_time(ratio: float) -> None:
    """The fastest one there, or that of the low gain, whichever asks for less."""
    low, _, held = proof(HIGH, HIGH / ratio)
    ways = (
        (matrix(fastest(HIGH)), float(fastest(HIGH).alpha)),
        (low, float(fastest(HIGH / ratio).alpha) * ratio),
    )
    times = [np.log(np.prod(jumps(low, P, ratio))) / alpha for P, alpha in ways]
    assert float(held.least.mid()) == pytest.approx(min(times), rel=1e-3)


def test_the_time_is_in_the_models_unit_and_of_the_continuous_observer() -> None:
    """A rate of the model is per its unit of time, here the hour, and so is the time of that rate: no seconds."""
    x1, x2 = (hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2))
    plant = hg.System("slow", states=(x1, x2), outputs=[hg.Signal("y")], flow=[x2, -x1], output=[x1], time="h")
    gains: dict[str, Any] = {"theta": 1e3, "theta_low": 1e2, "threshold": 1, "poles": (-1, -1.25)}
    for hold, verdict in ((1.0, Verdict.PROVED), (1e-3, Verdict.UNKNOWN)):
        made = hg.observers.switched_gain(hg.forms.triangular(plant), hold=hold, **gains)
        (check,) = (check for check in made.checks if check.id == "switched_gain.hold")
        assert check.verdict is verdict
        assert check.claim == f"in continuous time hold = {hold:g} is long enough: switching keeps the error's decay"
        assert not re.search(r"\bs\b", str(check.reason))


def test_a_low_gain_below_the_bound_proves_nothing() -> None:
    least = Flow(error(), Fraction(LOW)).least
    assert least is not None
    low = 0.9 * float(least.theta)
    claims = checks(HIGH, low, 100.0)
    assert claims["x.convergence"].verdict is Verdict.PROVED
    assert (claims["x.theta"].verdict, claims["x.hold"].verdict) == (Verdict.UNKNOWN, Verdict.UNKNOWN)
    assert "theta_low" in claims["x.theta"].fix
    nothing = {check.id: check.verdict for check in switching_checks("x", form(), HIGH, LOW, 1.0, Nothing("no form"))}
    assert set(nothing.values()) == {Verdict.UNKNOWN}


@pytest.mark.parametrize("low_time", [0.001, 0.02, 0.2])
def test_cycles_of_the_proved_time_contract(low_time: float) -> None:
    """The pendulum's error over one cycle, as the proof has it: V in the coordinates of the high gain falls, whatever
    the time in the low one, from random states of plant and estimate."""
    hold, (_, P, _) = 1.001 * enough(HIGH, LOW), proof(HIGH, LOW)
    S = np.array([float(s.subs(form().system.nominal)) for s in error().scale])
    rng = np.random.default_rng(0)
    for _ in range(3):
        x = rng.uniform((-1, -1, -1), (1, 1, 1))
        w = x + 0.1 * rng.standard_normal(3)
        start = value(P, S, x - w)
        for level, time in ((HIGH, hold), (LOW, low_time)):
            steps = max(20, round(time * 4000))
            for _ in range(steps):
                x, w = moved(x, w, level, time / steps)
        assert value(P, S, x - w) < start


RESTLESS = {"theta": 5.016, "theta_low": 1.05, "threshold": 1.0}  # of two integrators, with these gains
SWING = (1.5167552156244541, 3.9155337274643007)


def restless(hold: float) -> hg.Observer:
    x1, x2 = (hg.Signal(f"x{i}", low=-(10**i), high=10**i) for i in (1, 2))
    plant = hg.System("integrators", states=(x1, x2), outputs=[hg.Signal("y")], flow=[x2, 0], output=[x1])
    return hg.observers.switched_gain(hg.forms.triangular(plant), **RESTLESS, hold=hold, gains=SWING)


def switches(hold: float, until: float, dt: float = 1e-3) -> list[float]:
    """The times at which the error of `restless` goes back to the high gain, its flow exact from step to step."""
    flows = {}
    for level in (RESTLESS["theta"], RESTLESS["theta_low"]):
        flows[level] = expm(dt * np.array([[-SWING[0] * level, 1], [-SWING[1] * level**2, 0]]))
    e, level, quiet, times = np.array([1.2, 4.0]), RESTLESS["theta"], 0.0, []
    for k in range(round(until / dt)):
        e = flows[level] @ e
        quiet = quiet + dt if abs(e[0]) <= RESTLESS["threshold"] else 0.0
        before, level = level, RESTLESS["theta_low"] if quiet >= hold else RESTLESS["theta"]
        times += [k * dt] if level > before else []
    return times


def test_two_gains_that_each_converge_may_switch_for_ever() -> None:
    """Both are above the bound, of b = 0, and the error goes round a cycle: nothing is concluded of that theta."""
    assert switches(0.2129, until=100)[-1] > 99
    assert not switches(2.3, until=100)
    short, long = restless(0.2129), restless(2.3)
    verdicts = {check.id.fact: check.verdict for check in short.checks if check.id.maker == "switched_gain"}
    assert verdicts == {"convergence": Verdict.PROVED, "theta": Verdict.PROVED, "hold": Verdict.UNKNOWN}
    assert convergence("switched_gain", short.checks) is Convergence.BELOW
    assert convergence("switched_gain", long.checks) is Convergence.ABOVE


def test_what_is_proved_of_each_gain_is_said_of_the_time_between_switches() -> None:
    """By the checks, and by the certificate's rows."""
    observer = restless(0.2129)
    text = json.dumps(hg.certificate(observer.form, observer.checks, "switched_gain"))
    for check in observer.checks:
        if check.id in ("switched_gain.convergence", "switched_gain.theta"):
            assert "between switches" in check.claim + str(check.reason)
    row = next(row for row in recheck(text).rows if row.id == "switched_gain.convergence")
    assert "the error decays exponentially between switches, in every gain above " in row.sentence


def value(P: np.ndarray, S: np.ndarray, error: np.ndarray) -> float:
    eps = S * error / HIGH ** np.arange(3)
    return float(eps @ P @ eps)


def moved(x: np.ndarray, w: np.ndarray, level: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Plant and estimate a time h later, by Heun."""

    def rate(both: np.ndarray) -> np.ndarray:
        x, w = both[:3], both[3:]
        K = level ** np.arange(1, 4) * np.array(POLES)
        return np.concatenate([plant(x), plant(w) + K * (x[0] - w[0])])

    both = np.concatenate([x, w])
    first = rate(both)
    both = both + h / 2 * (first + rate(both + h * first))
    return both[:3], both[3:]


def plant(x: np.ndarray) -> np.ndarray:
    """x' by the form's own equations, at the nominal parameters; the states stay in the box."""
    return np.asarray(_flow()(*x), dtype=float)


@cache
def _flow() -> Callable[..., list[float]]:
    return sp.lambdify(form().states, [e.subs(form().system.nominal) for e in form().flow], "math")
