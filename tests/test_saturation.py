"""b limited in value: what is computed, what of the proofs stays, theta below 1, and what is refused."""

from typing import Any

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.ranges import saturated
from hgogen.check import Verdict
from hgogen.reading.given import BadGain, BadNames

x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
y = hg.Signal("y")
OBSERVERS: dict[str, dict[str, Any]] = {
    "high_gain": {"theta": 8, "poles": (-1, -1)},
    "filtered": {"theta": 12, "alpha": 3, "beta": 1, "poles": (-1, -1)},
    "filtered_injection": {"theta": 12, "F": ((-3, 0), (1, -3)), "G": (1, 0), "H": ((2, 0), (0, 1))},
    "low_power": {"theta": 8},
}


def swing(*, sign: int = 1, first: Any = 0) -> hg.Form:
    """x1' = x2 + first, x2' = -x1^2/2; y = x1, x2 with the sign in x1'."""
    flow = [sign * x2 + first, -(x1**2) / 2]
    plant = hg.System("swing", states=(x1, x2), outputs=(y,), flow=flow, output=[x1])
    return hg.forms.triangular(plant)


def b_of(form: hg.Form, z: tuple[float, ...]) -> list[float]:
    import casadi as ca

    dynamics = Dynamics(form)
    at, none = ca.SX.sym("z", form.n), ca.SX(0, 1)
    return [float(v) for v in np.array(ca.Function("b", [at], [dynamics.nonlinear(at, none)])(z)).ravel()]


# --- what is computed ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("saturate", "arguments", "z", "b"),
    [
        (None, True, (3, 0), -2),  # -x1^2/2 at the edge of the range, 2
        (1.5, True, (3, 0), -1.5),
        (7, True, (3, 0), -2),
        (7, False, (3, 0), -4.5),
        (7, False, (30, 0), -7),
        ((-1, 0.5), False, (1, 0), -0.5),
        ({"x2": (-0.1, 9)}, False, (1, 0), -0.1),
    ],
)
def test_value_and_argument(saturate: Any, arguments: bool, z: tuple[float, ...], b: float) -> None:
    assert b_of(saturated(swing(), saturate, arguments), z) == [0, b]


def test_a_pair_turns_with_its_state() -> None:
    """z2 = -x2, so that b_2 = x1^2/2: x2' in [-1, 3] is b_2 in [-3, 1]."""
    form = saturated(swing(sign=-1), (-1, 3), False)
    assert form.signs == (1, -1)
    assert form.limits[1] == (-3, 1)
    assert b_of(form, (2, 0)) == [0, 1]


def test_kinks_outside_of_the_box_stay_where_the_argument_is_free() -> None:
    """Max(x1, -3) is x1 on the box, and -3 far outside of it."""
    plant = hg.System("bent", states=(x1, x2), outputs=(y,), flow=[x2, sp.Max(x1, -3)], output=[x1])
    form = hg.forms.triangular(plant)
    assert b_of(saturated(form, 9, False), (-5, 0)) == [0, -3]
    assert b_of(form, (-5, 0)) == [0, -2]


@pytest.mark.parametrize("name", OBSERVERS)
def test_every_observer_takes_it(name: str) -> None:
    """In the step, too, whose state starts where b is cut; without guards the limit is part of the equations."""
    make, gains = getattr(hg.observers, name), OBSERVERS[name]
    runs = []
    for more in ({}, {"saturate": 0.5}, {"saturate": 0.5, "arguments": False}, {"saturate": 50}):
        observer = make(swing(), **gains, **more)
        runs.append(hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python").run(y=np.full((50, 1), 1.9)).x)
        assert any("b is limited in value" in line for line in observer.equations) is bool(more)
        if more.get("arguments") is False:
            bare = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python", guards="none")
            assert np.abs(bare.run(y=np.full((50, 1), 1.9)).x - runs[-1]).max() < 1e-12
    plain, cut, free, wide = runs
    assert np.abs(cut - plain).max() > 0.1
    assert np.abs(free - plain).max() > 0.1
    assert np.array_equal(plain, wide)


# --- what is proved -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OBSERVERS)
def test_a_proof_needs_both_clamps(name: str) -> None:
    """|b| <= 2 on the box: a limit from there on changes nothing with the argument clamped, and each other does."""
    pytest.importorskip("clarabel")
    make, gains = getattr(hg.observers, name), OBSERVERS[name]
    said = {}
    for more in ({}, {"saturate": 2}, {"saturate": 1.999}, {"saturate": 2, "arguments": False}):
        observer = make(swing(), **gains, **more)
        step = hg.contraction(hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python"))
        known = [check for check in (*observer.checks, *step.checks) if check.id.maker == name]
        said[str(more)] = {str(check.id): check for check in known}
    plain, same, cut, free = said.values()
    verdicts = [{id: check.verdict for id, check in each.items()} for each in (plain, same)]
    assert verdicts[0] == verdicts[1]
    assert plain[f"{name}.step"].verdict is plain[f"{name}.convergence"].verdict is Verdict.PROVED
    for each, why in ((cut, "b_2 is not shown to keep within its limits, -1.999 to 1.999"), (free, "is not clamped")):
        for fact in ("step", "convergence", "theta"):
            assert each[f"{name}.{fact}"].verdict is Verdict.UNKNOWN
        assert why in str(each[f"{name}.convergence"].reason)
        assert why in str(each[f"{name}.step"].reason)


@pytest.mark.parametrize("name", OBSERVERS)
def test_a_limit_of_a_row_without_a_b_holds_0(name: str) -> None:
    """x1' = x2 becomes x2 + 1 in the observer, whose estimate of x2 comes to -1 where the plant rests at 0."""
    pytest.importorskip("clarabel")
    for limit, end, verdict in ((1, 0, Verdict.PROVED), ((1, 2), -1, Verdict.UNKNOWN)):
        observer = getattr(hg.observers, name)(swing(), **OBSERVERS[name], saturate={"x1": limit, "x2": 2})
        step = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")
        assert step.run(y=np.zeros((500, 1)))["x2"][-1] == pytest.approx(end, abs=1e-6)
        known = {check.id: check.verdict for check in (*observer.checks, *hg.contraction(step).checks)}
        assert known[f"{name}.theta"] is known[f"{name}.step"] is verdict


def test_no_slope_is_proved_of_an_argument_that_is_free() -> None:
    """In the coordinates (y, y') of x1' = x2 + x1^2/9, whose slopes a claim of its own is about."""
    plant = hg.System("bowl", states=(x1, x2), outputs=(y,), flow=[x2 + x1**2 / 9, -x1], output=[x1])
    form, gains = hg.forms.phase(plant), OBSERVERS["filtered"]
    assert form.behind is None
    for more, verdict in (({"saturate": 99}, Verdict.PROVED), ({"saturate": 99, "arguments": False}, Verdict.UNKNOWN)):
        observer = hg.observers.filtered(form, **gains, **more)
        (slope,) = (check for check in observer.checks if check.id == "filtered.lipschitz")
        assert slope.verdict is verdict


# --- theta below 1 ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*OBSERVERS, "peaking_free"])
def test_theta_may_be_below_one(name: str) -> None:
    """It is accepted, and cannot be tuned; below every bound nothing is proved by it."""
    gains = {**OBSERVERS.get(name, {}), "theta": 0.5}
    observer = getattr(hg.observers, name)(swing(), **gains)
    (theta,) = observer.gains
    assert theta.box == ((0.5, 0.5),)
    assert {check.verdict for check in observer.checks if check.id == f"{name}.theta"} == {Verdict.UNKNOWN}
    hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")(y=0.1)


def test_below_one_it_is_proved_where_the_inequality_holds() -> None:
    """b = -x2/5 alone: the error core is Hurwitz, with its slope anywhere in [-.2, 0], at .5 as at 5."""
    pytest.importorskip("clarabel")
    plant = hg.System("slow", states=(x1, x2), outputs=(y,), flow=[x2, -x2 / 5], output=[x1])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=0.5, poles=(-1, -1))
    step = hg.contraction(hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python"))
    assert step.checks[0].verdict is Verdict.PROVED
    content = hg.certificate(observer.form, (*observer.checks, *step.checks), "high_gain")
    claims = {claim["id"]: claim["verdict"] for claim in content["claims"]}
    assert claims["high_gain.step"] == "proved"


# --- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "asked", "said"),
    [
        (swing, {"arguments": False}, r"arguments = False leaves b without a bound; give saturate="),
        (swing, {"saturate": 0}, r"saturate of x2 = 0 must be a positive finite number, or a pair"),
        (swing, {"saturate": (2, 1)}, r"saturate of x2 = \(2, 1\) must be a positive finite number, or a pair"),
        (swing, {"saturate": float("inf")}, r"saturate of x2 = inf must be"),
        (swing, {"saturate": "much"}, r"saturate of x2 = 'much' must be a number"),
        (swing, {"saturate": (1, 2, 3)}, r"saturate of x2 of shape \(3,\) must be a single number"),
        (swing, {"saturate": {"x3": 1}}, r"saturate names 'x3', which is none of the names"),
        (lambda: swing(first=-(x1**3)), {"saturate": 1}, r"saturate = 1 must be a limit by name, of x1, x2"),
        (
            lambda: swing(first=-(x1**3)),
            {"saturate": {"x2": 1}, "arguments": False},
            r"arguments = False needs a limit of every row of b; give one for x1",
        ),
        (lambda: hg.forms.phase(swing().system, original=True), {"saturate": 1}, r"saturate is for a form in whose"),
    ],
)
def test_limits_that_are_none(form: Any, asked: dict[str, Any], said: str) -> None:
    with pytest.raises((BadGain, BadNames), match=f"^{said}"):
        hg.observers.high_gain(form(), **OBSERVERS["high_gain"], **asked)
