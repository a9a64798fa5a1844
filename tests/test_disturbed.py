"""An unknown input as states of the plant: what is added, what is asked again, and what is refused."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import model

import hgogen as hg
from hgogen.check import Verdict
from hgogen.errors import HgogenError
from hgogen.reading.text_model import BadModelFile, from_table, to_text
from hgogen.system import BadSystem

q, w = hg.Signal("q", "rad", low=-4, high=4), hg.Signal("w", "rad/s", low=-20, high=20)
tau, y = hg.Signal("tau", low=-1, high=1), hg.Signal("y")
LOAD = hg.Signal("load", "rad/s2", "unknown torque", low=-5, high=5)
RAMP = hg.Signal("load", "rad/s2", "unknown torque", low=-5, high=5, rates=((-1, 1), (-2, 2)))
DRIFT = hg.Signal("drift", low=-1, high=1)


def swing(damping: float = 0.1, name: str = "swing") -> hg.System:
    """q' = w, w' = -9 sin q - damping w + tau, y = q."""
    flow = [w, -9 * sp.sin(q) - damping * w + tau]
    return hg.System(name, states=(q, w), inputs=(tau,), outputs=(y,), flow=flow, output=[q], time="h")


# --- what is added ------------------------------------------------------------------------------------------


def test_the_input_is_a_state_that_rests() -> None:
    plant = hg.with_disturbance(swing(), on="w", signal=LOAD)
    assert plant.states == (q, w, LOAD)
    assert plant.flow == (w, swing().flow[1] + LOAD, 0)
    assert (plant.name, plant.time, plant.inputs, plant.output) == ("swing", "h", (tau,), (q,))


def test_the_pendulum_of_the_paper() -> None:
    """The example (91) of Alessandri 2020, written by hand: x3' = 0 in the row of x2."""
    plant = model("disturbed_pendulum")
    x1, x2, x3 = plant.states
    a, b = plant.parameters
    assert plant.flow == (x2, -a * sp.sin(x1) - b * x2 + x3, 0)
    assert plant.outputs[0].interval == (-4, 4)
    assert x3.meaning == "unknown torque over inertia"


def test_its_derivatives_are_states_too() -> None:
    plant = hg.with_disturbance(swing(), on=w, order=3, signal=RAMP)
    d, d1, d2 = plant.states[2:]
    assert plant.flow == (w, swing().flow[1] + d, d1, d2, 0)
    assert [s.name for s in (d, d1, d2)] == ["load", "load_dot", "load_ddot"]
    assert [s.interval for s in (d, d1, d2)] == [(-5, 5), (-1, 1), (-2, 2)]
    assert [s.unit for s in (d1, d2)] == ["(rad/s2)/h", "(rad/s2)/h2"]
    assert d1.meaning == "derivative of load"
    assert not any(s.rates for s in plant.states)


def test_two_rows_may_be_disturbed() -> None:
    once = hg.with_disturbance(swing(), on="w", signal=LOAD)
    plant = hg.with_disturbance(once, on="q", signal=DRIFT, name="twice")
    assert plant.flow == (w + DRIFT, once.flow[1], 0, 0)
    assert plant.name == "twice"


# --- whether it is seen -------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
def test_the_form_is_proved_of_the_new_plant(order: int) -> None:
    signal = hg.Signal("load", low=-5, high=5, rates=RAMP.rates[: order - 1])
    form = hg.forms.triangular(hg.with_disturbance(swing(), on="w", order=order, signal=signal))
    assert form.n == 2 + order
    assert {check.verdict for check in form.checks} == {Verdict.PROVED}


def test_what_outputs_do_not_show_is_refuted_and_named() -> None:
    """Of q' = w + drift, w' = .. + load without damping the outputs show w + drift alone: the known symmetry."""
    plant = hg.with_disturbance(swing(damping=0), on="q", signal=DRIFT)
    (structure, *_) = hg.forms.triangular(plant).checks
    assert structure.verdict is Verdict.REFUTED
    assert "q' brings in w, drift together" in str(structure)
    said = str(hg.observability(plant))
    assert "rank 2 of 3" in said
    assert "w, drift are not observable" in said


def test_damping_tells_a_drift_from_the_rate() -> None:
    """With damping b, y'' + .. = -b w shows w, though no triangular form holds the plant."""
    plant = hg.with_disturbance(swing(), on="q", signal=DRIFT)
    assert "rank 3 of 3" in str(hg.observability(plant))
    assert hg.forms.triangular(plant).checks[0].verdict is Verdict.REFUTED


def test_an_observer_finds_the_torque() -> None:
    """A constant one, of 3, which the plant as declared knows nothing of: explicit small steps of the plant."""
    plant = hg.with_disturbance(swing(name="pushed"), on="w", signal=LOAD)
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=8, poles=(-1, -1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=0.005, engine="python")
    x = np.array([0.5, 0.0])
    for _ in range(1000):
        estimate = step(u=0.0, y=x[0])
        for _ in range(5):
            x = x + 0.001 * np.array([x[1], -9 * np.sin(x[0]) - 0.1 * x[1] + 3])
    assert abs(estimate.x[2] - 3) < 0.05


# --- the door of plain text ---------------------------------------------------------------------------------


def text(**disturbance: Any) -> dict[str, Any]:
    return {
        "name": "swing",
        "time": "h",
        "states": {
            "q": {"unit": "rad", "low": -4, "high": 4, "flow": "w"},
            "w": {"unit": "rad/s", "low": -20, "high": 20, "flow": "-9*sin(q) - 0.1*w + tau"},
        },
        "inputs": {"tau": {"low": -1, "high": 1}},
        "outputs": {"y": {"equation": "q"}},
        "disturbances": {"load": disturbance},
    }


def test_plain_text_declares_one() -> None:
    entry = {"on": "w", "unit": "rad/s2", "meaning": "unknown torque", "low": -5, "high": 5}
    plant = from_table(text(**entry)).plant
    assert plant.states == (q, w, LOAD)
    assert plant.flow == (w, -9 * sp.sin(q) - w / 10 + tau + LOAD, 0)
    longer = from_table(text(**entry, order=3, rates=[[-1, 1], [-2, 2]])).plant
    assert longer.states == hg.with_disturbance(swing(), on="w", order=3, signal=RAMP).states


def test_it_is_written_as_the_states_that_it_is() -> None:
    plant = hg.with_disturbance(swing(damping=2), on="w", order=3, signal=RAMP)
    assert 'flow = "load_dot"' in to_text(plant)


@pytest.mark.parametrize(
    ("entry", "key", "said"),
    [
        ({"low": -1, "high": 1}, "disturbances.load", "the key 'on' is missing; add on = \"...\""),
        ({"on": "w"}, "disturbances.load", "the disturbance load has no range"),
        ({"on": "v", "low": -1, "high": 1}, "disturbances.load", "on = 'v' is no state of it"),
        ({"on": "w", "low": -1, "high": 1, "order": "2"}, "disturbances.load.order", "write a number"),
        ({"on": "w", "low": -1, "high": 1, "order": 1.5}, "disturbances.load", "order = 1.5 must be a whole number"),
        ({"on": "w", "low": -1, "high": 1, "rate": 1}, "disturbances.load.rate", "did you mean rates?"),
    ],
)
def test_plain_text_is_refused_with_its_key(entry: dict[str, Any], key: str, said: str) -> None:
    with pytest.raises(BadModelFile) as caught:
        from_table(text(**entry))
    assert caught.value.key == key
    assert said in str(caught.value)


# --- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"on": "tau"}, r"on = 'tau' is an input, which has no row; its states are q, w"),
        ({"on": "ww"}, r"on = 'ww' is no state of it; did you mean w\?"),
        ({"on": hg.Signal("w")}, r"on = 'w' is a symbol of that name, and not the state; give the state, or its name"),
        ({"on": 2}, r"on = '2' is no state of it; its states are q, w"),
        ({"order": 0}, r"order = 0 must be a whole number, at least 1"),
        ({"order": True}, r"order = True must be a whole number"),
        (
            {"signal": None},
            r"the disturbance on w needs a range; give it by "
            r'signal=hg\.Signal\("d_w", "\(rad/s\)/h", low=-1, high=1\)$',
        ),
        ({"signal": hg.Signal("load")}, r"the disturbance load has no range; give low= and high="),
        ({"order": 2}, r"the disturbance load has 0 rates, and order = 2; give a pair for each derivative"),
        ({"signal": RAMP}, r"the disturbance load has 2 rates, and order = 1; leave them out"),
        ({"signal": hg.Signal("tau", low=0, high=1)}, r"the name 'tau' is declared twice"),
    ],
)
def test_a_refusal_says_what_to_give(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(BadSystem, match=rf"^system 'swing': {said}"):
        hg.with_disturbance(swing(), **{"on": "w", "signal": LOAD, **asked})


def test_a_recast_plant_is_sent_back() -> None:
    v = hg.Signal("v", low=-40, high=40)
    moved = hg.recast(swing(), {v: 2 * w}, {w: v / 2})
    with pytest.raises(HgogenError, match=r"is recast, .*; give the disturbance to the plant that it was recast from"):
        hg.with_disturbance(moved, on="v", signal=LOAD)
    pushed = hg.recast(hg.with_disturbance(swing(), on="w", signal=LOAD), {v: 2 * w}, {w: v / 2})
    assert pushed.flow[1:] == (-18 * sp.sin(q) - v / 10 + 2 * tau + 2 * LOAD, 0)
