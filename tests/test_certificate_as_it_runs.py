"""Certificates of the step as it runs, verified again: true ones of five observers, and forged numbers."""

import copy
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import MODELS, model, pendulum, two_outputs

import hgogen as hg
from hgogen.model import load
from hgogen.recheck.verification import recheck

SLOW = ("filtered_injection", "low_power", "peaking_free")  # whose certificates few tests ask for
FIVE = ("high_gain", "filtered", *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW))
Content = dict[str, Any]


def content_of(observer: hg.Observer, method: str = "rk4", dt: float = 1e-3) -> Content:
    step = hg.sample(observer, getattr(hg.methods, method), dt=dt)
    checks = (*observer.checks, *hg.contraction(step).checks)
    return hg.certificate(observer.form, checks, observer.name)


@cache
def certified(observer: str) -> Content:
    """The certificate of the pendulum's shipped tuning."""
    gains = load(MODELS / "pendulum.py").module.tuning[observer]
    return content_of(getattr(hg.observers, observer)(hg.forms.triangular(model("pendulum")), **gains))


def alone(observer: str, fact: str) -> Content:
    """To be forged, with the claims about the form and one about the step: no other reads its evidence."""
    content = copy.deepcopy(certified(observer))
    others = [each for each in content["claims"] if not each["id"].startswith(f"{observer}.")]
    content["claims"] = [*others, *(each for each in content["claims"] if each["id"] == f"{observer}.{fact}")]
    return content


def findings(content: Content) -> dict[str, str]:
    """What is found of each claim about the step, by its fact."""
    rows = {row.id.split(".")[1]: row.found for row in recheck(sealed(content)).rows}
    return {fact: rows[fact] for fact in ("step", "shorter", "tuned") if fact in rows}


def claim(content: Content, fact: str) -> Content:
    (one,) = (each for each in content["claims"] if each["id"].endswith(f".{fact}"))
    return one["evidence"]


@pytest.mark.parametrize("observer", FIVE)
def test_the_claims_of_each_observer_are_verified(observer: str) -> None:
    assert findings(certified(observer)) == dict.fromkeys(("step", "shorter", "tuned"), "verified")


@pytest.mark.parametrize("method", ["euler", "heun"])
def test_other_methods_are_verified(method: str) -> None:
    gains = load(MODELS / "pendulum.py").module.tuning["high_gain"]
    observer = hg.observers.high_gain(hg.forms.triangular(model("pendulum")), **gains)
    assert set(findings(content_of(observer, method)).values()) == {"verified"}


@pytest.mark.ordinary(
    "high_gain-bilinear-the bilinear rule",
    "high_gain-exponential-the matrix exponential",
    "filtered-bilinear-the bilinear rule",
)
@pytest.mark.parametrize(
    ("method", "name"), [("bilinear", "the bilinear rule"), ("exponential", "the matrix exponential")]
)
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_realised_core_is_verified_at_one_length(observer: str, method: str, name: str) -> None:
    gains = load(MODELS / "pendulum.py").module.tuning[observer]
    made = getattr(hg.observers, observer)(hg.forms.triangular(model("pendulum")), **gains)
    content = content_of(made, method, 0.05)
    assert findings(content) == {"step": "verified"}
    other = copy.deepcopy(content)
    claim(other, "step")["alpha"] = times(1.1)(claim(other, "step")["alpha"])
    assert findings(other)["step"] == "fails"
    shorter = alone(observer, "shorter")
    claim(shorter, "shorter")["method"] = name
    assert findings(shorter)["shorter"] == "fails"


@pytest.mark.slow
def test_the_bilinear_rule_does_not_realise_a_core_that_moves() -> None:
    content = copy.deepcopy(certified("peaking_free"))
    assert claim(content, "step")["method"] == "classical Runge-Kutta"
    half = len(claim(content, "step")["S"]) // 2
    claim(content, "step")["S"] = claim(content, "step")["S"][:half]
    claim(content, "step")["method"] = "the bilinear rule"
    assert findings(content)["step"] == "fails"


def driven(end: float = 2) -> hg.System:
    """x1' = (2 + u) x2, x2' = -sin x1: an a_2 that moves with the input; x1 is at most `end`."""
    x1, x2 = hg.Signal("x1", low=-end, high=end), hg.Signal("x2", low=-2, high=2)
    u = hg.Signal("u", low=-0.3, high=0.3)
    flow = [(2 + u) * x2, -sp.sin(x1)]
    return hg.System("driven", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])


def scaled() -> hg.System:
    """x1' = a x2, x2' = -sin x1, y = x1, a in a range: gains from poles follow it."""
    x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
    a = hg.Signal("a", "", "", 2, low=1, high=3)
    flow = [a * x2, -sp.sin(x1)]
    return hg.System("scaled", states=(x1, x2), parameters=(a,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])


def test_gains_on_an_a_that_moves_are_proved_and_verified() -> None:
    observer = hg.observers.high_gain(hg.forms.triangular(driven()), theta=6, gains=(2, 0.5))
    content = content_of(observer)
    assert findings(content) == dict.fromkeys(("step", "shorter", "tuned"), "verified")
    narrow = copy.deepcopy(content)
    claim(narrow, "step")["ranges"][1] |= {"low": "1.9", "high": "2.1"}
    assert findings(narrow)["step"] == "fails"
    other = copy.deepcopy(content)
    claim(other, "step")["scale"] = ["1", "1/3"]
    assert findings(other)["step"] == "fails"


def beside() -> hg.System:
    """x1' = (2 + u) x2, x2' = -sin x1, x3' = -x3; y1 = x1, y2 = x3: two chains, in one of which an a moves."""
    plant, x3 = driven(), hg.Signal("x3", low=-2, high=2)
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    flow, output = [*plant.flow, -x3], [*plant.output, x3]
    return hg.System(
        "beside", states=(*plant.states, x3), inputs=plant.inputs, outputs=outputs, flow=flow, output=output
    )


def test_an_a_that_moves_in_one_of_two_chains_is_proved_and_verified() -> None:
    observer = hg.observers.high_gain(hg.forms.block_triangular(beside()), theta=6, gains=((2, 0.5), (1,)))
    content = content_of(observer, "euler")
    assert "ranges" in claim(content, "step")
    assert findings(content)["step"] == "verified"


@pytest.mark.parametrize("observer", ["low_power", "peaking_free"])
def test_a_longer_chain_is_verified(observer: str) -> None:
    """Where saturations are several, in the order of their multipliers."""
    gains = load(MODELS / "hyperjerk.py").module.tuning[observer]
    form = hg.forms.triangular(model("hyperjerk"))
    content = content_of(getattr(hg.observers, observer)(form, **{**gains, "theta": 10}), "euler", 1e-2)
    assert findings(content)["step"] == "verified"


def test_gains_from_poles_follow_a_parameter_and_are_verified() -> None:
    observer = hg.observers.high_gain(hg.forms.triangular(scaled()), theta=8, poles=(-1, -1))
    assert findings(content_of(observer)) == dict.fromkeys(("step", "shorter", "tuned"), "verified")


def test_saturations_in_units_of_their_own_are_verified() -> None:
    x1, x2, x3 = states = tuple(hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2, 3))
    flow = [2 * x2, 3 * x3, -sp.sin(x1)]
    plant = hg.System("units", states=states, outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    content = content_of(hg.observers.peaking_free(hg.forms.triangular(plant), theta=12), "euler")
    assert claim(content, "step")["units"] == ["1", "1/2", "166667/1000000"]
    assert findings(content)["step"] == "verified"


def test_several_outputs_are_proved_and_verified() -> None:
    form = hg.forms.block_triangular(two_outputs())
    observer = hg.observers.high_gain(form, theta=6, poles=((-1, -1), (-1,)))
    assert findings(content_of(observer))["step"] == "verified"


def put(*path: Any, value: Any) -> Callable[[Content], None]:
    def change(evidence: Content) -> None:
        *inner, last = path
        for key in inner:
            evidence = evidence[key]
        evidence[last] = value(evidence[last]) if callable(value) else value

    return change


def times(factor: float) -> Callable[[str], str]:
    return lambda text: str(Fraction(text) * Fraction(factor))


AT_ONE = {
    "dt beyond": put("dt", value="0.2"),
    "dt of 0": put("dt", value="0"),
    "a faster rate": put("alpha", value=times(2)),
    "a negative rate": put("alpha", value="-1"),
    "all at once": put("alpha", value="1000"),
    "P turned": put("P", value=lambda P: [[str(-Fraction(x)) for x in row] for row in P]),
    "P skew": put("P", 0, 1, value="0"),
    "S below 0": put("S", 0, value="-1"),
    "S of nothing": put("S", value=lambda S: ["0"] * len(S)),
    "S too short": put("S", value=lambda S: S[:-1]),
    "a narrow slope": put("slopes", 0, value=lambda one: {**one, "low": "-1", "high": "1"}),
    "a slope less steep upwards": put("slopes", 0, "high", value="19"),
    "a slope less steep downwards": put("slopes", 0, "low", value="-19"),
    "a slope elsewhere": put("slopes", 0, "column", value="2"),
    "a slope of nothing": put("slopes", value=lambda slopes: [*slopes, {**slopes[0], "row": "1"}]),
    "no slopes": put("slopes", value=[]),
    "another method": put("method", value="the matrix exponential"),
    "units": put("units", value=lambda units: [str(3 * Fraction(u)) for u in units]),
    "scale": put("scale", value=lambda scale: ["3", *scale[1:]]),
}
PIECES = {
    "theta above the observer's": put("theta", value="21"),
    "theta far below": put("theta", value="1"),
    "a longer piece": put("pieces", -1, "high", value="0.5"),
    "a gap": put("pieces", 0, "low", value="1/1000000"),
    "no piece": put("pieces", value=[]),
    "S of nothing": put("pieces", 0, "S", value=lambda S: ["0"] * len(S)),
    "P turned": put("pieces", 0, "P", value=lambda P: [[str(-Fraction(x)) for x in row] for row in P]),
    "more in a piece": put("pieces", 0, value=lambda piece: {**piece, "note": "x"}),
    "another method": put("method", value="Euler"),
}


@pytest.mark.parametrize("lie", AT_ONE)
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_forged_number_of_one_length_fails(observer: str, lie: str) -> None:
    content = alone(observer, "step")
    if observer == "high_gain" and lie == "units":
        return  # it has no units: its scale says all
    AT_ONE[lie](claim(content, "step"))
    assert findings(content) == {"step": "fails"}


@pytest.mark.parametrize("fact", ["step", "shorter", "tuned"])
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_claim_about_the_step_is_verified_alone(observer: str, fact: str) -> None:
    assert findings(alone(observer, fact)) == {fact: "verified"}


@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_claim_that_is_forged_leaves_the_others(observer: str) -> None:
    content = copy.deepcopy(certified(observer))
    AT_ONE["a faster rate"](claim(content, "step"))
    assert findings(content) == {"step": "fails", "shorter": "verified", "tuned": "verified"}


@pytest.mark.parametrize(
    ("observer", "key", "value"),
    [("high_gain", "units", ["1", "1"]), ("filtered", "core", []), ("low_power", "ranges", [])],
)
def test_evidence_that_nothing_reads_is_refused(observer: str, key: str, value: Any) -> None:
    content = copy.deepcopy(certified(observer))
    for fact in ("step", "shorter", "tuned"):
        claim(content, fact)[key] = value
    assert set(findings(content).values()) == {"fails"}


@pytest.mark.parametrize("lie", PIECES)
@pytest.mark.parametrize("fact", ["shorter", "tuned"])
def test_a_forged_number_of_all_shorter_lengths_fails(fact: str, lie: str) -> None:
    content = alone("high_gain", fact)
    PIECES[lie](claim(content, fact))
    assert findings(content) == {fact: "fails"}


@pytest.mark.parametrize("core", [True, False])
def test_a_core_of_numbers_is_not_one_of_ranges_too(core: bool) -> None:
    content = alone("high_gain", "step")
    evidence = claim(content, "step")
    if core:
        evidence["ranges"] = []
    else:
        del evidence["core"]
    assert findings(content)["step"] == "fails"


def test_without_a_rate_errors_fall_all_the_same() -> None:
    """The inequality is strict: at alpha = 0 no rate is promised."""
    content = alone("high_gain", "step")
    claim(content, "step")["alpha"] = "0"
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".step"))
    assert row.found == "verified"
    assert row.sentence.endswith("|e|_P^2 falls at each call")


def test_a_form_that_is_no_norm_proves_nothing() -> None:
    """Where errors grow, P below 0 makes the inequality hold."""
    content = alone("high_gain", "step")
    evidence = claim(content, "step")
    content["observer"] |= {
        "theta": "1000",
        "gains": [f"-({content['observer']['gains'][0]})", *content["observer"]["gains"][1:]],
    }
    evidence["core"][0][0] = str(-Fraction(evidence["core"][0][0]))
    (a, b), (c, d) = N = [[float(Fraction(x)) for x in row] for row in evidence["core"]]
    rows = [[2 * a, 2 * c, 0], [b, a + d, c], [0, 2 * b, 2 * d]]  # N'P + P N = -1 of P_11, P_12, P_22
    p, q, r = (str(Fraction(x).limit_denominator()) for x in np.linalg.solve(rows, [-1, 0, -1]))
    assert np.linalg.eigvals(N).real.min() > 0
    evidence |= {"method": "Euler", "dt": "1/1000000", "alpha": "0", "P": [[p, q], [q, r]], "S": ["1", "1"]}
    assert findings(content)["step"] == "fails"


@pytest.mark.parametrize(
    ("observer", "number", "value"),
    [
        ("high_gain", "theta", "200000"),
        ("high_gain", "gains", ["2", "3"]),
        ("filtered", "alpha", "1"),
        ("filtered", "beta", "3"),
        pytest.param("filtered_injection", "NH", [["5", "0"], ["0", "1"]], marks=pytest.mark.slow),
        pytest.param("low_power", "gains", [["2", "2"]], marks=pytest.mark.slow),
        pytest.param("peaking_free", "last", "100", marks=pytest.mark.slow),
    ],
)
def test_numbers_of_another_observer_are_not_what_was_proved(observer: str, number: str, value: Any) -> None:
    content = alone(observer, "step")
    content["observer"][number] = value
    assert findings(content)["step"] == "fails"


def test_a_steeper_plant_is_not_what_was_proved() -> None:
    content = copy.deepcopy(certified("high_gain"))
    for parameter in content["plant"]["parameters"]:
        if parameter["name"] == "a":
            parameter.update(low="40", high="40")
    assert set(findings(content).values()) == {"fails"}


@pytest.mark.full
def test_an_a_that_moves_with_the_estimate_is_not_one_that_moves_with_an_input() -> None:
    """A(sat z) z - A(sat x) x is more than A times the error: what is left grows with z."""
    content = content_of(hg.observers.high_gain(hg.forms.triangular(driven(0.3)), theta=6, gains=(2, 0.5)))
    assert findings(content)["step"] == "verified"
    content["plant"]["flow"][0] = "(x1 + 2)*x2"
    content["form"]["A"][0][1] = "z1 + 2"
    for fact in ("step", "shorter", "tuned"):
        range_ = claim(content, fact)["ranges"][1]
        range_ |= {"expression": "z1 + 2", "box": {"z1": range_["box"]["u"]}}
    assert set(findings(content).values()) == {"fails"}
    assert {row.id: row.found for row in recheck(sealed(content)).rows}["triangular.structure"] == "verified"


def test_a_gain_that_has_no_value_at_a_parameter_is_none_of_an_observer() -> None:
    x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
    a, y = hg.Signal("a", "", "", 2, low=1, high=3), hg.Signal("y")
    plant = hg.System("seen", states=(x1, x2), parameters=(a,), outputs=(y,), flow=[x2, 0], output=[a * x1])
    content = content_of(hg.observers.high_gain(hg.forms.triangular(plant), theta=8, poles=(-1, -1)))
    assert findings(content) == dict.fromkeys(("step", "shorter", "tuned"), "verified")
    assert content["observer"]["gains"] == ["2/a", "1/a"]
    content["plant"]["parameters"][0]["low"] = "-1"
    assert set(findings(content).values()) == {"fails"}


@pytest.mark.parametrize(
    ("name", "numbers"), [("low_power", {"gains": []}), ("peaking_free", {"gains": [], "last": "1"})]
)
def test_an_observer_in_pairs_of_one_state_has_no_error_that_could_contract(name: str, numbers: Content) -> None:
    x, y = hg.Signal("x", low=-2, high=2), hg.Signal("y")
    plant = hg.System("one", states=(x,), outputs=(y,), flow=[0], output=[x])
    content = content_of(hg.observers.high_gain(hg.forms.triangular(plant), theta=8, poles=(-1,)))
    empty = {**claim(content, "step"), "units": ["1"], "P": [], "S": []}
    del empty["core"]
    content["observer"] = {"name": name, "theta": "8", **numbers}
    content["claims"] = [each for each in content["claims"] if not each["id"].startswith("high_gain.")]
    content["claims"].append({"id": f"{name}.step", "verdict": "proved", "evidence": empty})
    assert findings(content) == {"step": "fails"}


def test_a_slope_of_one_value_is_verified_again() -> None:
    """A number times units of six digits, which no double is."""
    step = load(MODELS / "flexible_joint.toml").step("high_gain")
    rows = recheck(sealed(hg.certificate(step.observer.form, step.observer.checks, "high_gain"))).rows
    outcome = {row.id: row.found for row in rows}
    assert outcome["high_gain.convergence"] == outcome["high_gain.theta"] == "verified"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda made: (made, made.checks), "Observer given to certificate is no form; give observer.form"),
        (lambda made: (None, made.checks), "NoneType given to certificate is no form"),
        (lambda made: (made.form, None), "NoneType given to certificate is no sequence of checks"),
        (lambda made: (made.form, made.checks[0]), "Check given to certificate is no sequence of checks"),
        (lambda made: (made.form, [*made.checks, None]), "NoneType given to certificate is no sequence of checks"),
        (lambda made: (made.form, made.checks, made), "is no name; give observer.name"),
    ],
)
def test_what_a_certificate_is_not_made_of_is_refused(asked: Callable[[hg.Observer], Any], said: str) -> None:
    with pytest.raises(hg.HgogenError) as error:
        hg.certificate(*asked(pendulum()))
    assert said in str(error.value)
