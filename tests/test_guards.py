"""Guards that a firmware engineer found wanting: each was seen to fail."""

import re

import casadi as ca
import emitted
import neuron
import numpy as np
import pytest
import sympy as sp
from exact import machine

import hgogen as hg
from hgogen.program import Block, Place, address, walk


def pendulum(**output: float) -> hg.Step:
    q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20)
    tau, y = hg.Signal("tau", low=-1, high=1), hg.Signal("y", **output)
    plant = hg.System(
        "pendulum", states=(q, w), inputs=(tau,), outputs=(y,), flow=[w, -19.6 * sp.sin(q) - 0.1 * w + tau], output=[q]
    )
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=1e-3)


def test_an_output_without_a_range_is_judged_by_the_ranges_of_its_states() -> None:
    """y = q on [-4, 4]: beyond 12 a reading is as implausible as it would be with a declared range."""
    step = pendulum()
    assert "REJECTED_Y" not in step(u=0, y=11.9).flags
    step.reset()
    for value in (12.5, -12.5, 50, 1e6, 1e14):
        assert "REJECTED_Y" in step(u=0, y=value).flags
    assert abs(step(u=0, y=0)["q"]) < 0.01


@pytest.mark.parametrize("lost", [np.nan, np.inf])
@pytest.mark.parametrize("field", ["z", "L", "D"])
def test_a_lost_value_restarts_the_whole_state(field: str, lost: float) -> None:
    """A restarted estimate with the old, small covariance would believe a made-up number."""
    q, w, y = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20), hg.Signal("y")
    plant = hg.System("pendulum", states=(q, w), outputs=(y,), flow=[w, -sp.sin(q)], output=[q])
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=(0.1, 0.1), R=0.1), dt=0.01)
    for _ in range(300):
        step(y=0.5)
    memory = step._kept.places
    memory[Place("state", field)][0] = lost
    sample = step(y=np.nan)
    assert "RESTARTED" in sample.flags
    assert memory[Place("state", "z")].tolist() == [0, 0]
    assert memory[Place("state", "D")].tolist() == [1, 1]
    assert memory[Place("state", "L")].tolist() == [0]
    assert step(y=np.nan).flags == ("MISSING_Y",)


@pytest.mark.parametrize("lost", [np.nan, np.inf, -1.0, 1e300])
@pytest.mark.parametrize("name", ["many_states", "for_flash"])
def test_loops_do_not_go_on_with_a_variance_that_is_none(name: str, lost: float) -> None:
    """A restored state that holds one is mended by the next predict, and the estimate goes on from where it was."""
    made = emitted.step(name)
    made.reset()
    inputs, variances = dict.fromkeys(map(str, made.inputs), 0.0), made._kept.places[Place("state", "D")]
    for _ in range(3):
        made(**inputs, y=0.01)
    variances[0] = lost
    assert "COVARIANCE_LIMITED" in made(**inputs, y=np.nan).flags
    assert np.isfinite(variances).all()
    assert (variances >= 0).all()
    for _ in range(60):
        assert "RESTARTED" not in made(**inputs, y=0.01).flags
    assert np.isfinite(variances).all()
    assert (variances > 0).all()
    made.reset()


@pytest.mark.parametrize(("element", "at"), [(0, "update_y"), (1, "predict")])
def test_an_update_asks_for_what_it_changes_and_the_next_predict_for_all(element: int, at: str) -> None:
    """Of y = q a factor's update changes the variance of q; that of w it leaves as predict has kept it in its box."""
    q, w, y = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20), hg.Signal("y")
    plant = hg.System("pendulum", states=(q, w), outputs=(y,), flow=[w, -sp.sin(q)], output=[q])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=(0.1, 0.1), R=0.1), dt=0.01)
    reader = machine(made, "double")
    reader.call()
    reader.section("predict")
    reader.memory[Place("state", "D")][element] = np.nan
    restarted = [name for name in ("update_y", "predict") if "RESTARTED" in made.flags(reader.section(name))]
    assert restarted[0] == at


@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "tunable"])
def test_one_function_keeps_the_state_in_its_box(name: str) -> None:
    made = emitted.step(name)
    assert "keep_in_box" in [section.name for section in made.code.inner]
    assert emitted.files(name)[f"{made.name}.c"].count("/* is a value lost? */") == 1


@pytest.mark.parametrize("name", ["pendulum", "cascaded_tanks", "coupled", "exponential", "bank", "delayed"])
def test_memory_spoiled_before_the_first_call_is_made_anew(name: str) -> None:
    """A first call without a sample moves nothing, and so wrote nothing that a guard had asked for."""
    step = emitted.step(name)
    reader = machine(step, "float")
    for field in (field for field in step.layout.state if field.kind == "real"):
        reader.memory[Place("state", field.name)][:] = np.nan
    for signal in step.samples:
        reader.memory[Place("output", signal.name)][:] = np.nan
    status = reader.call()
    assert "RESTARTED" in {bit.name for k, bit in enumerate(step.layout.bits) if status >> k & 1}
    assert all(np.isfinite(reader.memory[Place("estimate", x.name)]).all() for x in step.states)


def test_outside_the_box_is_said_of_the_estimate_that_is_returned() -> None:
    """A reading of 7 or -7 for .1 s leads the estimate out of the box on each side, and back."""
    step, seen = pendulum(low=-4, high=4), set()
    for k in range(800):
        sample = step(u=0, y=7 * (-1) ** (k // 200) if k % 200 > 100 else 0)
        outside = abs(sample["q"]) > 4 or abs(sample["w"]) > 20
        assert ("OUTSIDE_BOX" in sample.flags) == outside
        seen |= {(outside, sample["q"] > 4, sample["q"] < -4)}
    assert seen >= {(True, True, False), (True, False, True), (False, False, False)}


def test_beyond_the_box_the_model_is_evaluated_at_its_edge_but_for_its_linear_part() -> None:
    """q' = w as it stands; w' = -19.6 sin q - .1 w + tau at q = 4, w = 20, and so its slopes."""
    dynamics, z, tau = pendulum().observer.dynamics, ca.SX.sym("z", 2), ca.SX.sym("tau")
    at = ca.Function("at", [z, tau], [dynamics.flow(z, tau), dynamics.jacobian(z, tau)])
    flow, slopes = (np.array(values) for values in at([6, 25], 0.5))
    assert flow.ravel() == pytest.approx([25, -19.6 * np.sin(4) - 0.1 * 20 + 0.5], rel=1e-12)
    assert slopes == pytest.approx(np.array([[0, 1], [-19.6 * np.cos(4), -0.1]]), rel=1e-12)


def still(**signal: float) -> hg.Step:
    """x1' = x2' = u, y = x1 + x2."""
    x, u = [hg.Signal(name, **signal) for name in ("x1", "x2")], hg.Signal("u", low=-1, high=1)
    plant = hg.System("still", states=x, inputs=(u,), outputs=(hg.Signal("y"),), flow=[u, u], output=[x[0] + x[1]])
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=(1, 1), R=1), dt=0.01)


def test_a_sample_too_far_from_the_prediction_to_be_squared_is_rejected() -> None:
    """Without ranges an estimate may be anywhere; in a float the square of 1e20 is infinite."""
    step = still()
    step._kept.places[Place("state", "z")][0] = 1e20
    assert step(u=0, y=0).flags == ("REJECTED_Y",)
    step.reset()
    step._kept.places[Place("state", "z")][0] = 1e15
    assert step(u=0, y=0).flags == ()


def test_a_restart_keeps_the_last_input() -> None:
    """It is no estimate: an input that is lost after it is still replaced by the last valid one."""
    reader = machine(still(low=-2, high=2), "double")
    reader.memory[Place("input", "u")][0] = 0.5
    reader.call()
    reader.section("predict")
    reader.memory[Place("state", "D")][0] = np.nan
    assert "RESTARTED" in reader.step.flags(reader.section("update_y"))
    assert reader.memory[Place("state", "z")].tolist() == [0, 0]
    reader.memory[Place("input", "u")][0] = np.nan
    assert "REUSED_U" in reader.step.flags(reader.section("predict"))
    assert reader.memory[Place("state", "z")] == pytest.approx([0.5 * reader.step.dt] * 2, rel=1e-12)


def after(step: hg.Step, last: dict[str, float], samples: int = 3) -> tuple[np.ndarray, set[str]]:
    """The estimate, and the bits that are raised, of a call after some in which fields of the state are overwritten."""
    reader = machine(step, "float")
    for signal in (*step.inputs, *step.samples):
        place = Place("input" if signal in step.inputs else "output", signal.name)
        reader.memory[place][0] = 0.25
    for _ in range(samples):
        reader.call()
    for name, value in last.items():
        reader.memory[Place("state", name)][:] = value
    flags = set(step.flags(reader.call()))
    return np.array([reader.memory[Place("estimate", x.name)][0] for x in step.states]), flags


@pytest.mark.parametrize("name", ["pendulum", "cascaded_tanks", "two", "integrated", "delayed"])
@pytest.mark.parametrize(("spoiled", "end"), [(1e6, 1), (np.inf, 1), (-1e6, 0), (np.nan, 0)])
def test_a_last_input_is_brought_into_its_range_before_it_is_used(name: str, spoiled: float, end: int) -> None:
    """The call computes what it computes of the end of the range."""
    step = emitted.step(name)
    field = next(each for each in step.layout.state if each.name == "u")
    expected, flags = after(step, {"u": np.array(field.box)[:, end]})
    estimate, raised = after(step, {"u": spoiled})
    assert estimate.tolist() == expected.tolist() != after(step, {})[0].tolist()
    assert raised == flags


def test_a_last_input_without_a_range_is_its_first_value_where_it_is_lost() -> None:
    x, u, y = hg.Signal("x", low=-2, high=2), hg.Signal("u"), hg.Signal("y")
    plant = hg.System("lag", states=(x,), inputs=(u,), outputs=(y,), flow=[u - x], output=[x])
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=0.01)
    assert after(step, {"u": np.nan})[0] == after(step, {"u": 0})[0] != after(step, {})[0]


@pytest.mark.parametrize("spoiled", [1e6, -np.inf, np.nan])
def test_a_last_sample_out_of_the_range_of_its_sensor_is_none(spoiled: float) -> None:
    step = emitted.step("pendulum")
    expected, _ = after(step, {"y_valid": 0, "y": 0})
    estimate, raised = after(step, {"y": spoiled})
    assert (estimate.tolist(), raised) == (expected.tolist(), set())


@pytest.mark.parametrize(("spoiled", "taken"), [(1e20, 1e15), (np.nan, 0.0), (-np.inf, 0.0)])
def test_a_last_finite_rate_is_one(spoiled: float, taken: float) -> None:
    """At w = 0 the rate of a has no value: the last one is used."""
    step = emitted.step("held")
    reader = machine(step, "float")
    for name, value in (("w", 0.5), ("y", 0.0), ("v", np.nan)):
        reader.memory[Place("input" if name == "w" else "output", name)][0] = value
    reader.call()
    reader.memory[Place("state", "last_a")][0] = spoiled
    reader.memory[Place("state", "u")][0] = reader.memory[Place("input", "w")][0] = 0.0
    assert "HELD_A" in step.flags(reader.section("predict"))
    assert reader.memory[Place("state", "last_a")][0] == np.float32(taken)


def test_a_status_text_has_the_limits_that_the_code_compares_with() -> None:
    """One that reads back as the same float; an estimate that may be anywhere may be absurdly far off, too."""
    q, w, y = hg.Signal("q", low=-1 / 3, high=2 / 7), hg.Signal("w", low=-1, high=1), hg.Signal("y")
    plant = hg.System("swing", states=(q, w), outputs=(y,), flow=[w, -q], output=[q])
    texts = hg.targets.c99(hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1, 1], R=1), dt=0.01))
    header = " ".join(texts["swing.h"].replace("\n *", "").split())
    low, high = re.findall(r"y is implausible, outside (\S+) \.\. (\S+): predicted only\.", header)[0]
    assert f"reading >= {low}f && reading <= {high}f" in texts["swing.c"]
    assert "y is not finite: predicted only" in header
    free = hg.targets.c99(still())["still.h"]
    assert "beyond 1e+15, or 1e+16 off its estimate: predicted" in " ".join(free.replace("\n *", "").split())


@pytest.mark.parametrize("end", [0, 1])
def test_at_the_edge_of_its_outer_box_an_estimate_is_not_projected(end: int) -> None:
    step = still(low=-2, high=2)
    step(u=0, y=np.nan)
    (z,) = (field for field in step.layout.state if field.name == "z")
    step._kept.places[Place("state", "z")][:] = [ends[end] for ends in z.box]
    assert "STATE_LIMITED" not in step(u=0, y=np.nan).flags
    step._kept.places[Place("state", "z")][0] *= 1.001
    assert "STATE_LIMITED" in step(u=0, y=np.nan).flags


def test_theta_stays_below_twice_theta_1_as_it_is_tuned() -> None:
    """From 7.9, of theta_1 = 4: tuned to 1.5, theta is at most 3 at once, whatever the innovation."""
    reader = machine(neuron.step(neuron.adaptive()), "double")
    for _ in range(2):  # the first call advances no time
        reader.call()
    reader.memory[Place("gain", "theta_1")][0], reader.memory[Place("state", "theta")][0] = 1.5, 7.9
    reader.tune()
    for innovation in (10.0, 0.0):
        reader.memory[Place("state", "innovation")][0] = innovation
        reader.section("adapt")
        assert 1 <= reader.memory[Place("state", "theta")][0] <= 3


CHAINS = {
    "low_power": {"theta": 200},
    "peaking_free": {"theta": 200},
    "filtered": {"theta": 200, "poles": (-1, -1), "alpha": 3, "beta": 1},
    "switched_gain": {"theta": 40, "theta_low": 20, "threshold": 0.1, "hold": 3, "poles": (-1, -1)},
    "stubborn": {"theta": 200, "decay": 1, "r": 5, "poles": (-1, -1)},
    "dead_zone": {"theta": 200, "decay": 1, "r": 0.1, "poles": (-1, -1)},
    "updated_gain": {"p_1": 0.1, "p_2": 20, "p_3": 10, "cap": 500, "poles": (-1, -1)},
    "cascade": {"theta": 50},
}


@pytest.mark.parametrize("name", CHAINS)
def test_the_outer_box_holds_the_plant_at_any_parameters(name: str) -> None:
    """y = k q, k in [1, 10], nominally 1, tuned to 10: w_1 = k q is up to 10, three times its nominal range is 3."""
    q, w = hg.Signal("q", low=-1, high=1), hg.Signal("w", low=-1, high=1)
    k, y = hg.Signal("k", "", "", 1.0, low=1, high=10), hg.Signal("y")
    plant = hg.System("swing", states=(q, w), outputs=(y,), parameters=(k,), flow=[w, -q], output=[k * q])
    observer = getattr(hg.observers, name)(hg.forms.triangular(plant), **CHAINS[name])
    step, t = hg.sample(observer, hg.methods.rk4, dt=5e-4, engine="python"), np.arange(0, 0.5, 5e-4)
    step.tune(k=10.0)
    run = step.run(y=9.5 * np.cos(t))
    assert set(step.flags(int(np.bitwise_or.reduce(run.status[-100:])))) <= {"OUTSIDE_BOX"}
    assert run["q"][-1] == pytest.approx(0.95 * np.cos(t[-1]), abs=1e-2)  # held at 3, w_1 would be an estimate of 0.3


def test_a_predictor_is_asked_only_for_what_it_moves() -> None:
    """Its third state rests, as does the plant's. A value there that no step makes is gone with the predictor."""
    made = emitted.step("fitzhugh_nagumo")
    title = "is it beyond its box, or lost?"
    (asked,) = (s for s in walk(made.code.program) if isinstance(s, Block) and s.title == title)
    (question,) = asked.writes.values()
    assert {address(symbol)[1] for symbol in ca.symvar(question)} == {0, 1}
    made.reset()
    made.run(u=np.zeros(10), y=np.ones(10), engine="python")
    made._kept.places[Place("predictor", "z")][:, 2] = np.nan
    run = made.run(u=np.zeros(200), y=np.ones(200), engine="python")
    assert np.isfinite(run.x).all()
    assert np.isfinite(made._kept.places[Place("predictor", "z")]).all()


def test_without_a_sample_the_prediction_stands_in_for_both_ends_of_the_call() -> None:
    """x' = 0, z' = 2 (y - z): y is on the line between two samples that were taken, constant at one after a
    missing one, and z rests where there is none."""
    x, y = hg.Signal("x", low=-4, high=4), hg.Signal("y", low=-4, high=4)
    plant = hg.System("still", states=(x,), outputs=(y,), flow=[0 * x], output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=[-1], initial={"x": 0.5})
    step = hg.sample(observer, hg.methods.heun, dt=0.1)
    z, before, first = 0.5, None, True
    for sample in (1.0, 0.8, np.nan, np.nan, 1.2, 0.4, np.nan, 0.9):
        now = z if np.isnan(sample) else sample
        last = now if before is None or np.isnan(sample) else before
        if not first:
            rate = 2 * (last - z)
            z += 0.1 / 2 * (rate + 2 * (now - z - 0.1 * rate))
        first, before = False, None if np.isnan(sample) else sample
        assert step(y=sample)["x"] == pytest.approx(z, abs=1e-12)
