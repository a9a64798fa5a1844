"""The observer that converges and is not input-to-state stable: example 1 of Alessandri 2020."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from falsehood import falsehood
from forger import sealed
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import Verdict
from hgogen.commands.claims import checked
from hgogen.errors import HgogenError
from hgogen.model import load
from hgogen.recheck.algebra import Algebra
from hgogen.recheck.arithmetic import Undefined, evaluate
from hgogen.recheck.text import expression
from hgogen.recheck.verification import Rechecked, recheck

MODEL = load(Path(__file__).resolve().parents[1] / "models" / "not_iss.py")
ERROR = MODEL.module.error


def together(t: float, s: np.ndarray) -> list[float]:
    """(29) and (30)."""
    x1, x2, z1, z2 = s
    w = 1 / np.sqrt(2 * t + 2)
    y1, y2 = x1 * (1 + x2) * w, x2
    return [
        -x1 + (1 + x2) * w,
        -2 * x1**2 + 2 * x1 * (1 + x2) * w,
        -z1 + (2 - z1 / np.sqrt(y2)) * z1 * y1 / (1 + y2),
        -z2 + 2 * y1 - y2,
    ]


@pytest.mark.parametrize("start", [0.2, 0.5, 1.0])
def test_a_fading_disturbance_drives_its_error_away(start: float) -> None:
    """e1 = sqrt(2 t + 2), e2 = exp(-t) e2(0). The first repels, d/de (-e + (1 + e^2) w) = 1 there: what is lost at
    first, 1e-13, grows by e^10."""
    first = [start, start**2, start - np.sqrt(2), start**2 - 0.5]
    t = np.linspace(0, 10, 101)
    x1, x2, z1, z2 = solve_ivp(together, (0, 10), first, t_eval=t, method="DOP853", rtol=1e-13, atol=1e-14).y
    assert x1 - z1 == pytest.approx(np.sqrt(2 * t + 2), abs=1e-8)
    assert x2 - z2 == pytest.approx(0.5 * np.exp(-t), abs=1e-10)
    assert x2 == pytest.approx(x1**2, abs=1e-11)


@pytest.mark.parametrize("mu", [2, 3, 10, 100])
def test_its_inequality_is_refuted_for_large_errors_whatever_the_gain(mu: int) -> None:
    """V = e1^2 + e2^2: true where (1 + e1^2)^2 < 3 mu^2/4, both sides to one percent."""
    e1, e2 = ERROR.errors
    edge = np.sqrt(np.sqrt(0.75) * mu - 1) if mu > 1.2 else 0
    verdicts = [
        hg.dissipation(ERROR, e1**2 + e2**2, mu=mu, within=(share * edge, 1)).checks[1].verdict
        for share in (0.99, 1.01)
    ]
    assert verdicts == [Verdict.PROVED, Verdict.REFUTED]


def test_no_small_gain_holds_even_near_zero() -> None:
    e1, e2 = ERROR.errors
    dissipation = hg.dissipation(ERROR, e1**2 + e2**2, mu=1, within=(0.01, 0.01))
    assert dissipation.checks[1].verdict is Verdict.REFUTED
    assert dissipation.conclusion == "nothing is concluded"


def test_its_error_system_is_made_of_plant_and_observer() -> None:
    """e1' = -e1 + (1 + e1^2) w, e2' = -e2."""
    e1, e2 = ERROR.errors
    assert ERROR.flow == (-e1, -e2)
    assert ERROR.noise == sp.Matrix([[1 + e1**2], [0]])


BLIND, ALONG = MODEL.module.blind, {"x2": MODEL.module.x1**2}
x1, x2, w, y1 = (getattr(MODEL.module, name) for name in ("x1", "x2", "w", "y1"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"along": {"x2": x1**3}}, "is not kept by the plant"),
        ({"along": {"x2": sp.Piecewise((x1**2, x1 < 0), (x1**2 + 1, True))}}, "may jump"),
        ({"along": {"x2": x2}}, "uses x2"),
        ({"along": {"w": x1}}, "none of the states"),
        ({"observer": {"x1": w, "x2": x2}}, "uses w"),
        ({"observer": {"x1": x1}}, "has no value for x2"),
        ({"observer": [x1]}, "must have a row"),
        ({"observer": [x1, "a text"]}, "is no expression"),
        ({"observer": {**BLIND, "x2": y1**2}}, "not shown to be affine"),
        ({"unknown": ["v"]}, "none of the inputs; there are w"),
        ({"unknown": 5}, "must be a name or several"),
    ],
)
def test_what_makes_no_error_system_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(HgogenError, match=said):
        hg.observer_errors(MODEL.plant, **{"observer": BLIND, "unknown": [w], "along": ALONG, **change})


def test_one_unknown_input_may_be_given_alone() -> None:
    several = hg.observer_errors(MODEL.plant, BLIND, unknown=[w], along=ALONG)
    assert hg.observer_errors(MODEL.plant, BLIND, unknown=w, along=ALONG) == several
    assert hg.observer_errors(MODEL.plant, BLIND, unknown="w", along=ALONG) == several


@cache
def _clocks() -> tuple[hg.System, str]:
    """a' = b' = 1 + v, both measured and observed by themselves: b = a is kept."""
    a, b = (hg.Signal(name, low=-4, high=4) for name in ("a", "b"))
    v, outputs = hg.Signal("v", low=-1, high=1), (hg.Signal("y1"), hg.Signal("y2"))
    plant = hg.System("clocks", states=(a, b), inputs=(v,), outputs=outputs, flow=[1 + v, 1 + v], output=[a, b])
    error = hg.observer_errors(
        plant, [1 + 3 * (y - x) for x, y in zip((a, b), outputs, strict=True)], unknown=(v,), along={"b": a}
    )
    known = hg.dissipation(error, sum(e**2 for e in error.errors), mu=2, within=(1, 1))
    form = hg.forms.original(plant)
    return plant, json.dumps(certificate(form, (*form.checks, *known.checks)))


JUMPING = ("atan(tan(a))", "atan(tan(a/2)) + a/2", "atan2(sin(a), cos(a))", "a + atan(1/a) + acot(-a)", "a + sign(a)")


@pytest.mark.parametrize("text", JUMPING)
def test_no_plant_keeps_to_a_set_that_jumps(text: str) -> None:
    """atan(tan(a)) is a up to pi/2, and jumps to -pi/2 there: the state b goes on, though the slopes agree."""
    plant, _ = _clocks()
    a = plant.states[0]
    with pytest.raises(HgogenError, match=r"^along b = .* (may|and) jump"):
        hg.observer_errors(plant, [0, 0], unknown=plant.inputs, along={"b": sp.sympify(text, {"a": a})})


@pytest.mark.parametrize("text", ["a", *JUMPING[:3]])
def test_no_set_that_jumps_is_verified(text: str) -> None:
    content: dict[str, Any] = json.loads(_clocks()[1])
    claims = [claim for claim in content["claims"] if claim["id"].startswith("dissipation.")]
    for claim in claims:
        claim["evidence"]["system"]["along"] = {"b": text}
    findings = {row.id: row.found for row in recheck(sealed(content)).rows}
    assert {findings[claim["id"]] for claim in claims} == {"verified" if text == "a" else "fails"}


@cache
def _written() -> str:
    claims = checked(MODEL)
    return json.dumps(certificate(claims.form, claims.checks, claims.observer))


def rechecked(change: Callable[[dict[str, Any], dict[str, Any]], object]) -> Rechecked:
    """What is found of its certificate with a change of it, and of the system in each claim."""
    content: dict[str, Any] = json.loads(_written())
    for claim in content["claims"]:
        if claim["id"].startswith("dissipation."):
            change(content, claim["evidence"]["system"])
    return recheck(sealed(content))


def test_its_certificate_is_verified_and_says_whose_error_it_is() -> None:
    rows = {row.id: row for row in rechecked(lambda content, system: None).rows if row.id.startswith("dissipation.")}
    assert {row.found for row in rows.values()} == {"verified"}
    for row in rows.values():
        assert "of xhat and y, which does not know w, on x2 = x1**2, wherever it has a value" in row.sentence
    assert not falsehood(json.loads(_written()), list(rows))


FORGED: dict[str, Callable[[dict[str, Any], dict[str, Any]], object]] = {
    "no flow": lambda c, system: c["plant"].update(flow=["0", "0"]),
    "another plant": lambda c, system: c["plant"]["flow"].__setitem__(0, "-2*x1 + (1 + x2)*w"),
    "another output": lambda c, system: c["plant"]["output"].__setitem__(1, "2*x2"),
    "a state of both signs": lambda c, system: c["plant"]["states"][0].update(low="-2"),
    "another observer": lambda c, system: system["observer"].__setitem__(1, "-2*x2 + 2*y_1 - y_2"),
    "an invented system": lambda c, system: system.update(flow=["-2*e_x1", "-2*e_x2"]),
    "an invented noise": lambda c, system: system.update(noise=[["0"], ["0"]]),
    "a set that is left": lambda c, system: system.update(along={"x2": "x1**3"}),
    "no set": lambda c, system: system.update(along={}),
    "every state given": lambda c, system: system.update(along={"x1": "1", "x2": "1"}),
    "a set of an input": lambda c, system: system.update(along={"x2": "w"}),
    "an input that is known": lambda c, system: system.update(unknown=[]),
    "an input that is none": lambda c, system: system.update(unknown=["v"]),
    "an input twice": lambda c, system: system.update(unknown=["w", "w"]),
    "an observer without a value": lambda c, system: system["observer"].__setitem__(
        1, "-x2 + 2*y_1 - y_2 + 0*sqrt(-1 - y_2)"
    ),
    "an observer that knows w": lambda c, system: system["observer"].__setitem__(0, "w"),
    "a part too many": lambda c, system: system.update(G1=[["1"], ["0"]]),
    "a part too few": lambda c, system: system.pop("along"),
    "odd lists": lambda c, system: system.update(unknown=[["w"]], along=[]),
    "a state named as an output": lambda c, system: system["observer"].__setitem__(0, "y_3"),
}


@pytest.mark.parametrize("change", FORGED)
def test_a_forged_system_is_not_verified(change: str) -> None:
    findings = {row.id: row.found for row in rechecked(FORGED[change]).rows if row.id.startswith("dissipation.")}
    assert findings["dissipation.inequality"] == "fails"


NOTHING = "(sin(x1)**2 + cos(x1)**2 - 1)"
NOWHERE = {
    "a zero": f"0/{NOTHING}",
    "a zero below a root": f"0/sqrt({NOTHING})",
    "a zero below a denominator": f"0/(1 + 1/{NOTHING})",
    "a zero that is within a root": f"sqrt(1 + 0/{NOTHING}) - 1",
    "a zero over a zero within a product": f"x1*({NOTHING}/{NOTHING} - 1)",
    "two roots of one zero": f"0/sqrt({NOTHING}) + 0/(2*sqrt({NOTHING}))",
    "a root that is the other sign's": "0/(sqrt(x1**2) - x1)",
}


@cache
def _line() -> str:
    """x' = w - 3 x with the observer xhat' = -3 xhat, whose error is -3 e."""
    x1, w, e = hg.Signal("x1", low=1, high=2), hg.Signal("w", low=0, high=1), sp.Symbol("e_x1", real=True)
    plant = hg.System("p", states=(x1,), inputs=(w,), outputs=(hg.Signal("y1"),), flow=[w - 3 * x1], output=[x1])
    claims = hg.dissipation(hg.observer_errors(plant, {"x1": -3 * x1}, unknown=(w,)), e**2, mu=2, within=(0.5,))
    content = certificate(hg.forms.original(plant), claims.checks)
    return json.dumps(content)


def of_the_line(change: Callable[[dict[str, Any], dict[str, Any]], object]) -> set[str]:
    content: dict[str, Any] = json.loads(_line())
    for claim in content["claims"]:
        change(content, claim["evidence"]["system"])
    return {row.found for row in recheck(sealed(content)).rows if row.id.startswith("dissipation.")}


@pytest.mark.parametrize("nowhere", NOWHERE)
def test_a_plant_without_a_value_proves_no_unstable_observer(nowhere: str) -> None:
    """e' = 5 e: whatever is written over what is zero by identities would be equal to anything."""

    def forge(content: dict[str, Any], system: dict[str, Any]) -> None:
        content["plant"]["flow"] = [f"w + 5*x1 + {NOWHERE[nowhere]}"]
        system["observer"] = ["5*x1"]

    assert of_the_line(lambda content, system: None) == {"verified"}
    assert of_the_line(forge) == {"fails"}


@pytest.mark.parametrize("place", ["observer", "flow", "noise"])
def test_what_is_told_has_a_value(place: str) -> None:
    """Nor the observer or the error system."""

    def forge(content: dict[str, Any], system: dict[str, Any]) -> None:
        content["plant"]["flow"] = ["w + 5*x1"]
        system["observer"] = ["5*x1"]
        entry = f"0/{NOTHING}"
        system[place] = [[f"1 + {entry}"]] if place == "noise" else [f"{system[place][0]} + {entry}"]

    assert of_the_line(forge) == {"fails"}


def test_a_set_without_a_value_is_not_kept() -> None:
    def forge(content: dict[str, Any], system: dict[str, Any]) -> None:
        content["plant"]["flow"][1] = "5*x2"
        system["along"] = {"x2": f"x1**2 + 0/{NOTHING}"}

    findings = {row.id: row.found for row in rechecked(forge).rows}
    assert findings["dissipation.inequality"] == "fails"


@pytest.mark.parametrize("nowhere", [entry for name, entry in NOWHERE.items() if "sign" not in name])
def test_what_is_written_over_zero_is_not_shown_to_be_zero(nowhere: str) -> None:
    """In the algebra itself, whoever asks: 5 x over zero is none."""
    algebra = Algebra(("x1",))
    text = expression(f"5*x1 + {nowhere}", ("x1",))
    try:
        value = evaluate(text, {"x1": algebra.names["x1"]}, algebra.arithmetic)
    except Undefined:
        return
    assert not algebra.is_zero(value)
