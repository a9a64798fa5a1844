"""Initial errors from which the errors of periodic outputs stay below half a turn, with their certificates."""

import copy
import json
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
import test_periodic as periodic
from forger import sealed
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import Check
from hgogen.prove.inclusion import Nothing
from hgogen.prove.quadratic import floats, rational
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.file import NoCertificate
from hgogen.recheck.text import Unreadable, expression
from hgogen.recheck.turns import Turn, advance, turn
from hgogen.recheck.verification import recheck
from hgogen.rigor.box import box
from hgogen.rigor.periodic import exact_turn, half_turn

TURN = 2 * np.pi
PROVED, UNKNOWN = hg.Verdict.PROVED, hg.Verdict.UNKNOWN


x, v, u = hg.Signal("x"), hg.Signal("v"), hg.Signal("u")


def plant(name: str, rate: float, flow: tuple[Any, Any], slope: int = 1, period: float = TURN) -> hg.System:
    """x' and v' = `flow`, y = `slope` x, x and y with a period."""
    angle, measured = (hg.Signal(each, period=period) for each in ("x", "y"))
    speed, drive = hg.Signal("v", low=-rate, high=rate), hg.Signal("u", low=-3, high=3)
    rows = [sp.sympify(row).xreplace({x: angle, v: speed, u: drive}) for row in flow]
    return hg.System(
        name, states=(angle, speed), outputs=(measured,), inputs=(drive,), flow=rows, output=[slope * angle]
    )


PLANTS: dict[str, hg.System] = {
    "heading": plant("heading", 0.1, (u + v, 0)),
    "degrees": plant("degrees", 5, (u + v, 0), period=360),
    "encoder": plant("encoder", 50, (v, u), slope=4),
    "pendulum": plant("pendulum", 10, (v, -2 * sp.sin(x) - v / 2 + u)),
}


@cache
def observer(name: str, theta: float = 5) -> hg.Observer:
    return hg.observers.high_gain(hg.forms.triangular(PLANTS[name]), theta=theta, poles=(-1, -1))


def by_fact(known: hg.Observer) -> dict[str, Check]:
    return {check.id.fact: check for check in known.checks if check.id.maker == known.name}


def evidence(known: hg.Observer) -> dict[str, Any]:
    answer = by_fact(known)["region"].proofs[0].fact.facts["region"]
    return {"P": answer.weights.P, "level": answer.level, "first": answer.first}


# --- what is proved


@pytest.mark.parametrize("name", PLANTS)
def test_errors_converge_from_a_region_of_initial_errors(name: str) -> None:
    facts = by_fact(observer(name))
    assert [facts[fact].verdict for fact in ("convergence", "theta", "region")] == [PROVED] * 3
    for fact in ("convergence", "theta", "region"):
        assert "from initial errors of at most x" in str(facts[fact].reason)


def test_a_heading_may_begin_almost_half_a_turn_off() -> None:
    first = evidence(observer("heading"))["first"]
    assert 3.1 < first[0] < np.pi
    assert 0.098 < first[1] <= 0.1
    assert 0.1 < evidence(observer("encoder"))["first"][0] < np.pi / 16 + 1 / 2  # of pi/4 for one period


@pytest.mark.parametrize("name", PLANTS)
def test_the_level_just_keeps_to_half_a_turn(name: str) -> None:
    known, answer = observer(name), evidence(observer(name))
    P, period = floats(rational(answer["P"])), known.form.system.outputs[0].period
    slope = 4 if name == "encoder" else 1
    extent = slope * np.sqrt(float(answer["level"]) * np.linalg.inv(P)[0, 0])
    assert period / 2 * (1 - 1e-10) < extent < period / 2


@pytest.mark.parametrize("case", ["circle_criterion", "filtered", "filtered_injection", "low_power", "peaking_free"])
def test_every_observer_with_a_constant_injection_has_a_region(case: str) -> None:
    name, gains, _ = periodic.OBSERVERS[case]
    known = getattr(hg.observers, name)(hg.forms.triangular(periodic.rotor(True)), **gains)
    content = certificate(known.form, known.checks, known.name)
    answer = {row.id: row.found for row in recheck(json.dumps(content)).rows}
    assert {answer[f"{name}.{fact}"] for fact in ("convergence", "theta", "region")} == {"verified"}


def test_what_has_no_proof_is_unknown() -> None:
    rotor = hg.forms.triangular(periodic.rotor(True))
    for known in (
        hg.observers.riccati(rotor, **periodic.KALMAN),
        hg.observers.stubborn(rotor, **periodic.OBSERVERS["stubborn"][1]),
    ):
        facts = by_fact(known)
        assert facts["convergence"].verdict is facts["region"].verdict is UNKNOWN
        assert facts.get("theta", facts["region"]).verdict is UNKNOWN
    step = hg.sample(observer("pendulum"), dt=0.01)
    assert "samples of periodic outputs" in str(hg.contraction(step))
    assert isinstance(hg.noise_gain(step), Nothing)


def test_a_state_without_a_range_has_no_initial_errors() -> None:
    angle, measured = hg.Signal("x", period=TURN), hg.Signal("y", period=TURN)
    form = hg.forms.triangular(hg.System("open", states=(angle, v), outputs=(measured,), flow=[v, 0], output=[angle]))
    facts = by_fact(hg.observers.high_gain(form, theta=5, poles=(-1, -1)))
    assert facts["convergence"].verdict is UNKNOWN
    assert "v has none" in str(facts["region"].reason)


def test_outputs_of_different_periods_are_each_kept_below_half_a_turn() -> None:
    angle, speed = hg.Signal("x", period=TURN), hg.Signal("v", low=-1, high=1)
    outputs = hg.Signal("coarse", period=TURN), hg.Signal("fine", period=TURN)
    two = hg.System("two", states=(angle, speed), outputs=outputs, flow=[speed, 0], output=[angle, 8 * angle])
    form = hg.forms.block_triangular(two)
    known = hg.observers.high_gain(form, theta=5, poles=(-1, -1))
    assert evidence(known)["first"][0] < np.pi / 8
    assert recheck(json.dumps(certificate(form, known.checks, known.name))).failed == ()


# --- that it holds


def wrapped(value: np.ndarray, period: float) -> np.ndarray:
    return value - period * np.floor(value / period + 0.5)


@pytest.mark.parametrize("name", PLANTS)
def test_from_the_edge_of_the_region_no_error_reaches_half_a_turn(name: str) -> None:
    """1000 initial errors on the edge of the ellipsoid, for plants that begin anywhere and turn many times; the
    observer by an own fine Runge-Kutta method, with the sample's turn unknown."""
    known, answer, rng = observer(name), evidence(observer(name)), np.random.default_rng(2)
    system, theta = known.form.system, 5.0
    period, slope, rate = system.outputs[0].period, 4 if name == "encoder" else 1, system.states[1].high
    P = floats(rational(answer["P"]))
    edge = np.linalg.solve(np.linalg.cholesky(P).T, unit_vectors(rng, 1000).T).T * np.sqrt(float(answer["level"]))
    error = edge * (1, theta)
    flow = sp.lambdify((*system.states, *system.inputs), system.flow, "numpy")
    K = np.array([2 * theta, theta**2]) / slope

    def motion(state: np.ndarray, drive: np.ndarray) -> np.ndarray:
        angle, speed, estimate, rate_of_it = state
        injected = wrapped(wrapped(slope * angle, period) - slope * estimate, period)
        limited = np.clip(rate_of_it, -rate, rate)  # of what b reads; a_2 z_2 reads the estimate itself
        true, own = flow(angle, speed, drive), flow(estimate, limited, drive)
        own = own[0] + rate_of_it - limited + K[0] * injected, own[1] + K[1] * injected
        return np.array([np.broadcast_to(each, angle.shape) for each in (*true, *own)])

    angle, speed = rng.uniform(-50, 50, 1000) * period, rng.uniform(-rate, rate, 1000) / 2
    state, drive, h = np.array([angle, speed, angle + error[:, 0], speed + error[:, 1]]), rng.uniform(-1, 1, 1000), 2e-3
    assert np.abs(slope * error[:, 0]).max() > 0.99 * period / 2
    for _ in range(1500):
        state = state + h * motion(state + h / 2 * motion(state, drive), drive)
        off = slope * (state[2] - state[0])
        assert np.abs(off).max() < period / 2
    assert np.abs(state[1]).max() <= rate
    assert np.abs(off).max() < 1e-3 * period


@pytest.mark.parametrize("guards", ["all", "none"])
@pytest.mark.parametrize("speed", [0.0, 15.0, 40.0])
def test_a_fast_encoder_keeps_the_region_in_the_running_step(speed: float, guards: str) -> None:
    """The output turns by up to a quarter of its period in a call, and the first error is on the edge."""
    known, answer, count = observer("encoder"), evidence(observer("encoder")), 80
    P, angle, dt = floats(rational(answer["P"])), 0.3 + speed * np.arange(80) * 0.01, 0.01
    touching = np.linalg.inv(P)[:, 0] * np.sqrt(float(answer["level"]) / np.linalg.inv(P)[0, 0]) * (0.99, 0.99 * 5)
    for sign in (1, -1):
        begin = {"x": 0.3 + sign * touching[0], "v": float(np.clip(speed + sign * touching[1], -50, 50))}
        own = hg.observers.high_gain(known.form, theta=5, poles=(-1, -1), initial=begin)
        y = wrapped(4 * angle, TURN)[:, None]
        run = hg.sample(own, dt=dt, guards=guards).run(u=np.zeros((count, 1)), y=y, engine="python")
        off = 4 * wrapped(run.x[:, 0] - angle, TURN)
        assert 0.95 * np.pi < abs(off[0]) < np.pi
        assert np.abs(off).max() < np.pi
        assert np.abs(off[-1]) < 0.5


def unit_vectors(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.standard_normal((count, 2))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


# --- certificates


@cache
def _written(name: str) -> str:
    known = observer(name)
    return json.dumps(certificate(known.form, known.checks, known.name))


def written(name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(_written(name))
    return content


def claim(content: dict[str, Any], fact: str) -> Any:
    (answer,) = [each["evidence"] for each in content["claims"] if each["id"] == f"high_gain.{fact}"]
    return answer


def failures(content: dict[str, Any]) -> dict[str, str]:
    try:
        return {row.id: row.sentence for row in recheck(sealed(content)).failed}
    except (NoCertificate, Unreadable) as error:
        return {"file": error.reason}


@pytest.mark.parametrize("name", PLANTS)
def test_recheck_verifies_the_region(name: str) -> None:
    report = recheck(_written(name))
    assert report.failed == ()
    assert {f"high_gain.{fact}" for fact in ("region", "convergence", "theta")} <= {row.id for row in report.verified}


def scaled(text: str, by: Fraction) -> str:
    return str(Fraction(text) * by)


def larger_level(content: dict[str, Any]) -> None:
    answer = claim(content, "region")
    answer["level"] = scaled(answer["level"], 1 + Fraction(1, 10**11))


def larger_errors(content: dict[str, Any]) -> None:
    answer = claim(content, "region")
    answer["first"] = [scaled(each, Fraction(101, 100)) for each in answer["first"]]


def period_of(key: str, text: str | None) -> Callable[[dict[str, Any]], None]:
    def forge(content: dict[str, Any]) -> None:
        holder = content["form"]["periods"] if key == "z1" else content["plant"]["periods"]
        holder.pop(key)
        if text is not None:
            holder[key] = text

    return forge


def growing_function(content: dict[str, Any]) -> None:
    """V = e'P e of the unit matrix, which grows from some errors, with a level and initial errors that suit it."""
    n = len(content["form"]["states"])
    evidence_of = claim(content, "region")
    evidence_of |= {
        "P": [["1" if i == j else "0" for i in range(n)] for j in range(n)],
        "level": "9",
        "first": ["1", "1"],
    }


def narrower_turn(content: dict[str, Any]) -> None:
    for holder in (content["plant"], content["form"]):
        holder["states"][0]["high"] = "3.14"


def without_region(content: dict[str, Any]) -> None:
    content["claims"] = [each for each in content["claims"] if each["id"] != "high_gain.region"]


def aperiodic_plant(content: dict[str, Any]) -> None:
    for holder, key in (("plant", "flow"), ("form", "b")):
        content[holder][key][1] = content[holder][key][1].replace("sin(x)", "sin(x/2)").replace("sin(z1)", "sin(z1/2)")


def smaller_gain(content: dict[str, Any]) -> None:
    content["observer"]["theta"] = "9/2"


FORGERIES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "a level that is too large in its last digits": (larger_level, "half a turn is not positive"),
    "initial errors that are too large": (larger_errors, "its initial errors are not within its level"),
    "a function that grows": (growing_function, "not negative"),
    "a longer period of the output": (period_of("y", "4*pi"), "is not the same a turn of"),
    "a longer period": (period_of("x", "4*pi"), "does not span a turn"),
    "a period that is no whole number of periods": (period_of("x", "3"), "periodic"),
    "a shorter period of the output": (period_of("y", "pi"), "half a turn is not positive"),
    "no period of the output": (period_of("y", None), "is not the same a turn of"),
    "no period of the plant's angle": (period_of("x", None), "is not the same a turn of"),
    "no period of the form's angle": (period_of("z1", None), "is not the same a turn of"),
    "a period that is no number": (period_of("y", "x"), "not declared"),
    "a period below 0": (period_of("y", "-2*pi"), "no positive number"),
    "a range that is less than a turn": (narrower_turn, "does not span a turn"),
    "no region": (without_region, "rests on high_gain.region"),
    "a plant that is not periodic": (aperiodic_plant, "periodic"),
    "a smaller theta": (smaller_gain, "not negative"),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forged_region_is_refused(forgery: str) -> None:
    content = copy.deepcopy(written("pendulum"))
    forge, said = FORGERIES[forgery]
    forge(content)
    answer = failures(content)
    assert answer
    assert said in " ".join(answer.values()), answer
    assert {"file", "high_gain.region", "high_gain.convergence"} & answer.keys()


def test_claims_of_a_step_are_refused_where_an_output_is_periodic() -> None:
    line = hg.observers.high_gain(hg.forms.triangular(periodic.rotor(False)), **periodic.CHAIN)
    step = hg.sample(line, dt=0.01)
    answer = certificate(line.form, (*line.checks, *hg.contraction(step).checks), line.name)
    content = copy.deepcopy(written("pendulum"))
    content["claims"] += [each for each in answer["claims"] if each["id"] == "high_gain.step"]
    assert "an output is periodic" in failures(content)["high_gain.step"]


# --- turns

NAMES = ("x", "v")


@pytest.mark.parametrize(
    ("text", "period", "change"),
    [
        ("x", "2*pi", Turn(pis=Fraction(2))),
        ("4*x - v", "2*pi", Turn(pis=Fraction(8))),
        ("-x*pi/180", "360", Turn(pis=Fraction(-2))),
        ("sin(3*x + v) + cos(x)**2*v", "2*pi", Turn()),
        ("sin(x*pi/180)", "360", Turn()),
        ("tan(x)/v", "pi", Turn()),
        ("atan2(sin(x), cos(x))", "2*pi", Turn()),
        ("(x + 1)/2 - x/2", "2*pi", Turn()),
        ("v**2", "2*pi", Turn()),
    ],
)
def test_an_expression_goes_on_by_a_known_amount(text: str, period: str, change: Turn) -> None:
    assert advance(expression(text, NAMES), "x", turn(period)) == change


def test_a_name_of_one_value_is_a_number_of_turns() -> None:
    four, several = {"v": (Fraction(4), Fraction(4))}, {"v": (Fraction(3), Fraction(4))}
    assert advance(expression("v*x", NAMES), "x", turn("2*pi"), four) == Turn(pis=Fraction(8))
    assert advance(expression("sin(v*x)", NAMES), "x", turn("2*pi"), four) == Turn()
    with pytest.raises(Unproved):
        advance(expression("v*x", NAMES), "x", turn("2*pi"), several)


@pytest.mark.parametrize("text", ["sin(x/2)", "x**2", "x*v", "v/x", "sin(x)*x", "exp(x)", "sin(x + x*v)", "Abs(x)"])
def test_what_is_not_shown_to_be_periodic_is_refused(text: str) -> None:
    with pytest.raises(Unproved):
        advance(expression(text, NAMES), "x", turn("2*pi"))
    with pytest.raises(Unproved):
        advance(expression("sin(x)", NAMES), "x", turn("6.283185307179586"))


@pytest.mark.parametrize("text", ["0", "-1", "pi - 4", "pi*pi"])
def test_a_period_is_a_positive_number(text: str) -> None:
    with pytest.raises(Unproved):
        turn(text)


@given(st.sampled_from([TURN, np.pi, 360.0, 0.1, 4 * np.pi, 1e-3, 7.3]), st.floats(-10, 10))
def test_the_range_of_an_angle_spans_a_turn_and_little_more(period: float, low: float) -> None:
    angle = hg.Signal("a", period=period, low=low, high=low + period)
    ((bottom, top),) = box([angle]).values()
    exactly = exact_turn(period)
    assert sp.Rational(top) - sp.Rational(bottom) >= exactly
    assert float(top - bottom) < period * (1 + 1e-11)
    assert bottom <= Fraction(repr(low))
    assert sp.Rational(half_turn(period)) <= exactly / 2
