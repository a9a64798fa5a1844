"""The projection onto the ranges, and which guard acts when: nothing that is healthy restarts."""

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.forms.phase import phase
from hgogen.part import Clock
from hgogen.program import Block, Place
from hgogen.stepping import discretise
from hgogen.stepping.projection import _within, projection

OUTER = 3  # the end of the outer box of this filter
RESTARTED, PROJECTED = "RESTARTED_FROM_SAMPLE", "PROJECTED_ONTO_RANGES"
METHODS = {
    "L D L'": hg.methods.continuous_discrete,
    "S S'": hg.methods.cholesky,
    "information": hg.methods.rk4,
    "covariance": hg.methods.rk4_covariance,
}


@cache
def graph(method: str) -> ca.Function:
    """What a filter of three states in [-1, 1] projects onto, as a function of the state's fields by name."""
    x = tuple(hg.Signal(name, low=-1, high=1) for name in "abc")
    plant = hg.System("three", states=x, outputs=(hg.Signal("y"),), flow=[x[1], x[2], -x[0]], output=[x[0]])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1.0] * 3, R=1.0)
    pieces = discretise.pieces(observer.parts[0], METHODS[method], Clock(0.01, "line", 0, 1))
    (block,) = projection(observer, pieces)
    assert isinstance(block, Block)
    names, inputs = [place.name for place, _ in block.reads], block.graph.sx_in()
    return ca.Function("project", inputs, block.graph.call(inputs)[:1], names, ["z_after"])


def fields(P: np.ndarray) -> dict[str, Any]:
    """P (3, 3) in each of its views."""
    root, below = np.linalg.cholesky(P), np.tril_indices(3)
    d, unit = np.diag(root) ** 2, root / np.diag(root)
    packed = [(i, j) for j in range(3) for i in range(j, 3)]
    strict = [(i, j) for i, j in packed if i > j]
    assert len(packed) == len(below[0])
    return {
        "D": d,
        "L": [unit[i] for i in strict],
        "root": [root[i] for i in packed],
        "P": [P[i] for i in packed],
        "S": [np.linalg.inv(P)[i] for i in packed],
    }


def reached(z: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The last point of the way from z to `end` in the outer box."""
    way = end - z
    room = np.where(way > 0, OUTER - z, z + OUTER)
    return z + way * min(1.0, (room / np.maximum(np.abs(way), 1e-300)).min())


numbers = st.floats(-1, 1, width=32)


@pytest.mark.parametrize("method", METHODS)
@given(st.lists(numbers, min_size=9, max_size=9), st.lists(numbers, min_size=3, max_size=3), st.data())
def test_a_projection_brings_the_estimate_no_farther_from_any_plant_in_its_ranges(
    method: str, entries: list[float], truth: list[float], data: st.DataObject
) -> None:
    """V = e' P^-1 e does not grow, for P of a condition of up to 1e4. An estimate inside stays to the bit."""
    A = np.reshape(entries, (3, 3))
    P = A @ A.T + 1e-3 * np.eye(3)
    z = np.array(data.draw(st.lists(st.floats(-2.75, 2.75, width=32), min_size=3, max_size=3)))
    function = graph(method)
    arguments = {name: value for name, value in {**fields(P), "z": z}.items() if name in function.name_in()}
    after = np.array(function(**arguments)["z_after"]).ravel()
    expected = z.copy()
    for k in range(3):
        expected -= P[:, k] * (expected[k] - np.clip(expected[k], -1, 1)) / P[k, k]
    V = [float((v - truth) @ np.linalg.solve(P, v - truth)) for v in (z, expected, after)]
    assert V[1] <= V[0] * (1 + 1e-9) + 1e-9
    assert after == pytest.approx(reached(z, expected), abs=1e-8)
    assert (np.abs(after) <= OUTER).all()
    assert V[2] <= V[0] * (1 + 1e-6) + 1e-6
    if (np.abs(z) <= 1).all():
        assert after.tolist() == z.tolist()


def test_two_states_are_projected_along_their_correlation() -> None:
    """P = [1 .5 0; .5 1 0; 0 0 1] and z = (1.4, .2, 0): z_1 becomes 1 and z_2 .2 - .5 .4."""
    P = np.array([[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]])
    for method in METHODS:
        function = graph(method)
        arguments = {
            name: value for name, value in {**fields(P), "z": [1.4, 0.2, 0]}.items() if name in function.name_in()
        }
        assert np.array(function(**arguments)["z_after"]).ravel() == pytest.approx([1, 0, 0], abs=1e-15)


@pytest.mark.parametrize("method", METHODS)
def test_a_projection_ends_at_the_outer_box(method: str) -> None:
    """z_1 would become 0 - .4 .099/.01 = -3.96, after its own range has been looked at: 3/3.96 of the way is taken."""
    P = np.array([[1, 0, 0.099], [0, 1, 0], [0.099, 0, 0.01]])
    function = graph(method)
    arguments = {name: value for name, value in {**fields(P), "z": [0, 0, 1.4]}.items() if name in function.name_in()}
    after = np.array(function(**arguments)["z_after"]).ravel()
    assert after == pytest.approx([-OUTER, 0, 1.4 - 0.4 * OUTER / 3.96])


@pytest.mark.parametrize(
    ("start", "end", "last"),
    [
        ((0, 0), (6, 4), (3, 2)),
        ((0, 0), (-4, 6), (-2, 3)),
        ((3, 1), (4, -1), (3, 1)),  # at an end already
        ((1, 2), (2, -2), (2, -2)),
        ((0, 3), (0, 3), (0, 3)),
    ],
)
def test_the_way_ends_where_the_first_state_meets_its_outer_box(
    start: tuple[float, ...], end: tuple[float, ...], last: tuple[float, ...]
) -> None:
    x, moved = ca.SX.sym("x", 2), ca.SX.sym("m", 2)
    function = ca.Function("within", [x, moved], [_within(x, moved, [(-3, 3), (-3, 3)])])
    assert np.array(function(start, end)).ravel() == pytest.approx(last)


@pytest.mark.parametrize("method", METHODS)
def test_a_projection_that_is_lost_leaves_the_estimate_where_it_was(method: str) -> None:
    """A covariance or its inverse that is 0, of which P a/(a' P a) is no number."""
    function, z = graph(method), [1.4, 0.2, -1.2]
    arguments = {name: value for name, value in {**fields(np.eye(3)), "z": z}.items() if name in function.name_in()}
    arguments |= {name: np.zeros(len(value)) for name, value in arguments.items() if name != "z"}
    assert np.array(function(**arguments)["z_after"]).ravel().tolist() == z


def test_a_clamp_to_the_outer_box_would_make_v_larger_and_the_way_to_it_does_not() -> None:
    """What the module says of a correlated P."""
    P = np.array([[0.911, -0.9937, 0.4137], [-0.9937, 1.21636, -0.35869], [0.4137, -0.35869, 0.25556]])
    z, truth = np.array([0.42839, 2.12955, 2.84659]), np.array([-0.17851, 0.51171, 0.84566])
    expected = z.copy()
    for k in range(3):
        expected -= P[:, k] * (expected[k] - np.clip(expected[k], -1, 1)) / P[k, k]
    function = graph("L D L'")
    arguments = {name: value for name, value in {**fields(P), "z": z}.items() if name in function.name_in()}
    after = np.array(function(**arguments)["z_after"]).ravel()
    clamped = np.clip(expected, -OUTER, OUTER)
    V = [(v - truth) @ np.linalg.solve(P, v - truth) for v in (z, expected, clamped, after)]
    assert np.round(V[:3]) == pytest.approx([45, 22, 243], rel=0.02)
    assert V[3] < V[0]


def memory(step: CallableStep, name: str) -> Any:
    return step._kept.places[Place("state", name)]


def put_outside(step: CallableStep, name: str, value: list[float], u: list[float], y: float) -> set[str]:
    """The flags of a call at which the estimate has been outside its ranges for long."""
    sign = next(sign for sign in step.code.signs if sign.name == "range")
    memory(step, sign.count)[0] = sign.wait - 1
    memory(step, sign.limit)[0] = sign.wait
    memory(step, "fault_checksum")[0] = sign.wait - 1
    memory(step, name)[:] = value
    return set(step(u, y).flags)


def test_a_state_of_the_plant_is_projected_where_the_estimate_has_other_coordinates() -> None:
    """z = (x1, x2 + u) with u = 2 and |x2| <= 1: x2 = 1.3 becomes 1, and not z_2 in its wider range."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    u = hg.Signal("u", low=-5, high=5, rates=((-1, 1),))
    plant = hg.System(
        "linear", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=[x2 + u, -x1], output=[x1]
    )
    form = phase(plant)
    step = hg.sample(hg.observers.high_gain(form, theta=1, poles=(-1, -1)), hg.methods.rk4, dt=1e-6, engine="python")
    inputs = [2.0] + [0.0] * (len(step.inputs) - 1)
    step(inputs, 0.0)
    flags = put_outside(step, "z", [0.0, 3.3], inputs, 0.0)
    assert (PROJECTED in flags, RESTARTED in flags) == (True, False)
    assert memory(step, "z") == pytest.approx([0, 3], abs=1e-5)


def test_every_member_of_a_bank_is_projected_in_its_own_metric() -> None:
    step = hg.sample(
        hg.observers.bank(plants.kalman(plants.van_der_pol()), count=3, period=0.1), dt=0.01, engine="python"
    )
    widths = [signal.interval[1] for signal in step.observer.form.states]
    estimates = [array for place, array in step._kept.places.items() if place.name == "z"]
    for _ in range(3):
        step(y=0.2)
    for array in estimates:
        array.reshape(-1, 2)[:] = [0.0, 1.2 * widths[1]]
    flags = put_outside(step, "z", [0.0, 1.2 * widths[1]], [], 0.0)
    assert (PROJECTED in flags, RESTARTED in flags) == (True, False)
    for array in estimates:
        assert (np.abs(array.reshape(-1, 2)[:, 1]) <= widths[1] * (1 + 1e-12)).all()


# --- which guard acts ---------------------------------------------------------------------------------------


def acted(step: CallableStep, status: np.ndarray) -> dict[str, int]:
    """How often each guard acted."""
    bits = {bit.name: k for k, bit in enumerate(step.layout.bits)}
    return {name: int(((status >> bits[name]) & 1).sum()) for name in (RESTARTED, PROJECTED)}


def drifting(bias: float) -> CallableStep:
    """A filter of x1' = x2, x2' = -x1 - bias for a plant without the bias; the range of x2 is [-1, 1]."""
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=-1, high=1)
    plant = hg.System("biased", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2 + bias, -x2 / 10], output=[x1])
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1.0, 1.0], R=1e-3), dt=0.01)


def test_a_filter_whose_output_agrees_is_projected_and_not_restarted() -> None:
    """y = 0 asks for x2 = -1.2, 11 % of its range beyond the range: at the first limit the estimate is put back."""
    step = drifting(1.35)
    wait = next(sign.wait for sign in step.code.signs if sign.name == "range")
    run = step.run(y=np.zeros((round(1.9 * wait), 1)))
    assert acted(step, run.status) == {RESTARTED: 0, PROJECTED: 1}


def test_a_filter_that_is_outside_again_restarts() -> None:
    step = drifting(1.35)
    wait = next(sign.wait for sign in step.code.signs if sign.name == "range")
    run = step.run(y=np.zeros((round(2.5 * wait), 1)))
    assert acted(step, run.status) == {RESTARTED: 1, PROJECTED: 1}


def test_a_filter_that_is_far_outside_restarts_at_once() -> None:
    """y = 0 asks for x2 = -2.3."""
    step = drifting(2.5)
    wait = next(sign.wait for sign in step.code.signs if sign.name == "range")
    run = step.run(y=np.zeros((round(1.5 * wait), 1)))
    assert acted(step, run.status) == {RESTARTED: 1, PROJECTED: 0}


@cache
def follower() -> CallableStep:
    """The pendulum's high-gain observer with a limit of 60 samples."""
    return hg.sample(plants.pendulum(theta=4), hg.methods.rk4, dt=0.05)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 1, 2]))
def test_independent_noise_of_any_size_restarts_nothing(seed: int, size: float) -> None:
    """In 4,000 samples a count reaches 60 with a probability below 4000 1.618^-59 = 2e-9."""
    noise = np.random.default_rng(seed).uniform(-6, 6, (4000, 1)) * size
    step = follower()
    assert next(sign.wait for sign in step.code.signs if sign.output == 0) == 60
    memory(step, "z")[:] = 0.0
    status, count = 0, []
    step.reset()
    for y in noise:
        memory(step, "z")[:] = 0.0  # the errors are the noise alone
        status |= step(0.0, float(y[0])).status
        count.append(float(memory(step, "fault_count_y")[0]))
    assert RESTARTED not in step.flags(status)
    assert max(map(abs, count)) < 60


def test_a_tone_that_is_faster_than_the_plant_restarts_nothing() -> None:
    """Errors of one sign for m - 1 samples, then of the other, for ever: the count never reaches m; slower ones do."""
    step = follower()
    (sign,) = (sign for sign in step.code.signs if sign.output == 0)
    for half, restarts in ((sign.change - 1, False), (3 * sign.change, True)):
        step.reset()
        status, count = 0, []
        for k in range(3000):
            memory(step, "z")[:] = 0.0
            status |= step(0.0, 3.0 if (k // half) % 2 else -3.0).status
            count.append(abs(float(memory(step, "fault_count_y")[0])))
        assert (RESTARTED in step.flags(status)) == restarts
        assert restarts or max(count) == half


def test_a_weak_sensor_is_judged_by_its_variance() -> None:
    """A pseudo-measurement with a standard deviation of 4 that is 5 off, in a range of 20, for ever."""
    a, b = hg.Signal("a", low=-1, high=1), hg.Signal("b", low=0, high=20)
    plant = hg.System(
        "prior", states=(a, b), outputs=(hg.Signal("y1"), hg.Signal("y2")), flow=[(b - 10) / 20 - a, 0], output=[a, b]
    )
    dt, count = 0.01, 12000
    y = np.c_[np.full(count, (9.0 - 10) / 20), np.full(count, 14.0)]
    observer = hg.observers.riccati(
        hg.forms.original(plant), Q=[1e-4] * 2, R=[1e-6 * dt, 16 * dt], initial=(-0.05, 9), covariance=(1, 4)
    )
    step = hg.sample(observer, dt=dt)
    assert acted(step, step.run(y=y).status) == {RESTARTED: 0, PROJECTED: 0}
