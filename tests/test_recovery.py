"""The law of recovery: what it counts, when it restarts, from where; and that an estimate is found again."""

import itertools
from functools import cache
from typing import Any

import emitted
import numpy as np
import plants
import pytest
import recovery
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.model import load
from hgogen.observer import Observer
from hgogen.program import Place
from hgogen.run import native
from hgogen.stepping.recovery import FINE, MARGIN, SHARE

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

NAN = float("nan")
BIT, PROJECTED = "RESTARTED_FROM_SAMPLE", "PROJECTED_ONTO_RANGES"


def memory(step: CallableStep, name: str) -> Any:
    return step._kept.places[Place("state", name)]


def first(step: hg.Step, name: str) -> float:
    return next(field.initial[0] for field in step.layout.state if field.name == name)


# --- what it counts -----------------------------------------------------------------------------------------


@cache
def quick() -> CallableStep:
    """The pendulum's high-gain observer with few samples to a second, so that its settling time is short."""
    return hg.sample(plants.pendulum(theta=4), hg.methods.rk4, dt=0.05)


def test_a_sign_shows_for_twice_the_time_in_which_the_core_converges() -> None:
    """theta = 4, poles -1, -1: the slowest rate is 4 a second."""
    outer = next(field for field in quick().layout.state if field.name == "z").high
    seconds = 2 * np.log(FINE * max(outer[0] / 4, outer[1] / 20)) / 4
    wait = np.ceil(seconds / 0.05)
    assert (first(quick(), "fault_limit_y"), first(quick(), "fault_limit_range")) == (wait, wait)
    ends = {field.name: field.box[0] for field in quick().layout.state}
    assert (ends["fault_limit_y"], ends["fault_limit_range"]) == ((wait, 1024 * wait), (wait, 1024 * wait))
    assert (ends["fault_count_y"], ends["fault_count_range"]) == ((-1024 * wait, 1024 * wait), (0, 1024 * wait))


def test_a_sign_shows_for_no_shorter_than_the_plant_is_slow() -> None:
    """x' = -x/100: 2/lambda is 200 s, of a filter that converges within seconds."""
    a, y = hg.Signal("a", low=-10, high=10), hg.Signal("y")
    plant = hg.System("slow", states=(a,), outputs=(y,), flow=[-a / 100], output=[a])
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[100.0], R=1.0), dt=0.1)
    assert first(step, "fault_limit_y") == first(step, "fault_limit_range") == 200 / 0.1


def without_ranges(**ranges: hg.Signal) -> CallableStep:
    """A pendulum none of whose signals has a range, but for those that are given."""
    a, b, y = (ranges.get(name, hg.Signal(name)) for name in "aby")
    plant = hg.System("free", states=(a, b), outputs=(y,), flow=[b, -sp.sin(a) - b / 5], output=[a])
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[0.1, 0.1], R=0.1), dt=0.05)


@pytest.mark.parametrize(
    ("ranges", "signs"),
    [
        ({}, ()),
        ({"y": hg.Signal("y", low=-1, high=1)}, ("y",)),
        ({"b": hg.Signal("b", low=-1, high=1)}, ("range",)),
        ({"a": hg.Signal("a", low=-1, high=1)}, ("y", "range")),  # y = a
    ],
)
def test_a_step_has_the_signs_that_its_ranges_give_and_its_manual_says_no_more(
    ranges: dict[str, hg.Signal], signs: tuple[str, ...]
) -> None:
    step = without_ranges(**ranges)
    assert tuple(sign.name for sign in step.code.signs) == signs
    fields = {field.name for field in step.layout.state}
    counts = {f"fault_count_{s}" for s in signs} | {f"fault_limit_{s}" for s in signs}
    assert {name for name in fields if name.startswith("fault")} == counts | ({"fault_checksum"} if signs else set())
    assert (BIT in {bit.name for bit in step.layout.bits}) == bool(signs)
    manual = emitted.manual(hg.targets.c99(step))
    assert ("nothing restarts an estimate that is lost" in manual) == (not signs)
    assert [f"s.fault_count_{name}" in manual for name in ("y", "range")] == [name in signs for name in ("y", "range")]


KINDS = st.sampled_from(["far", "other", "near", "wild", "none", "reject"])
SEGMENTS = st.lists(st.tuples(KINDS, st.integers(1, 160)), max_size=9)
GUARDS = {BIT, PROJECTED}


@pytest.mark.parametrize("name", ["y", "range"])
def test_no_sample_takes_a_count_out_of_its_range(name: str) -> None:
    """Whatever its limit: that a count at its most is at its limit too is nothing that intervals show."""
    sign = next(sign for sign in quick().code.signs if sign.name == name)
    values = {sign.count: sign.most, sign.limit: sign.wait, f"moves_{name}": 1, f"side_{name}": 1}
    written = sign.counted.graph(*(values[place.name] for place, _ in sign.counted.reads))
    assert dict(zip((place.name for place in sign.counted.writes), map(float, written), strict=True)) == {
        sign.count: sign.most,
        sign.limit: sign.wait,
    }


@settings(max_examples=30, deadline=None)
@given(SEGMENTS, st.integers(0, 2**32 - 1))
def test_fault_counts_and_limits_follow_the_law(segments: list[tuple[str, int]], seed: int) -> None:
    """c and w of both signs from what a step shows: the estimate and the error after each sample, and which guard
    acted."""
    step, rng = quick(), np.random.default_rng(seed)
    step.reset()
    wait = first(step, "fault_limit_y")
    most, span, widths = 1024 * wait, 8.0, np.array([8.0, 40.0])
    change = next(sign.change for sign in step.code.signs if sign.name == "y")
    c, w = {"y": 0.0, "range": 0.0}, {"y": wait, "range": wait}
    for kind, count in segments:
        for k in range(count):
            before = memory(step, "z").copy()
            estimate = float(before[0])
            y = {
                "far": -5.0 if estimate > 0 else 5.0,
                "other": 5.0 if k % 3 else -5.0,
                "near": 0.9 * estimate,
                "wild": rng.uniform(-7, 7),
                "none": NAN,
                "reject": 1e9,
            }[kind]
            sample = step(5.0 * (k % 2), y)
            acted = GUARDS & set(sample.flags)
            now = {name: float(memory(step, f"fault_count_{name}")[0]) for name in c}
            if acted:
                over = [name for name in c if abs(c[name]) + 1 >= w[name]]
                assert over
                outside = (abs(before) > 0.5 * widths).any()  # from inside no sample moves it far
                assert "y" in over or w["range"] > wait or outside or acted == {PROJECTED}
                for name in over:
                    size, w[name] = min(w[name], most / 2), min(2 * w[name], most)
                    assert abs(now[name]) == size
                for name in c:  # what another showed before the guard acted is not seen any more
                    assert abs(now[name] - c[name]) <= change
                    c[name] = now[name]
                    w[name] = float(memory(step, f"fault_limit_{name}")[0]) if name not in over else w[name]
            elif not {"MISSING_Y", "REJECTED_Y"} & set(sample.flags):
                z = memory(step, "z")
                error = y - z[0]
                shows = abs(error) > SHARE * span
                size = max(abs(c["y"]) + ((1 if error * c["y"] >= 0 else -change) if shows else -1), 0.0)
                c["y"] = size * (np.sign(error) if shows else np.sign(c["y"]))
                out = (abs(z) > (0.5 + MARGIN) * widths).any()
                c["range"] = c["range"] + 1 if out else max(c["range"] - 1, 0.0)
                for name in c:
                    w[name] = wait if c[name] == 0 else w[name]
                    assert abs(c[name]) < w[name]
            for name in c:
                assert (now[name], memory(step, f"fault_limit_{name}")[0]) == (c[name], w[name])


def test_an_estimate_that_stays_off_y_restarts_ever_more_slowly() -> None:
    """Memory that is spoiled at each call: after T, T, 2 T, .. and at last every 512 T."""
    step = quick()
    step.reset()
    wait, restarts = int(first(step, "fault_limit_y")), []
    for k in range(129 * wait):
        memory(step, "z")[:] = -3.0, 0.0
        restarts += [k + 1] if BIT in step(0.0, 3.0).flags else []
    waits = np.diff([0, *restarts])
    assert waits.tolist() == [wait, *(wait * 2**k for k in range(7))]
    memory(step, "fault_count_y")[0] = 1024 * wait - 1
    memory(step, "fault_limit_y")[0] = 1024 * wait
    memory(step, "fault_checksum")[0] = 2047 * wait - 1 + memory(step, "fault_count_range")[0] + extra(step, "range")
    memory(step, "z")[:] = -3.0, 0.0
    assert BIT in step(0.0, 3.0).flags
    assert (memory(step, "fault_count_y")[0], memory(step, "fault_limit_y")[0]) == (512 * wait, 1024 * wait)


def extra(step: CallableStep, name: str) -> float:
    """What a fault limit is beyond the first."""
    return float(memory(step, f"fault_limit_{name}")[0]) - first(step, f"fault_limit_{name}")


def estimate_of(step: CallableStep) -> float:
    return float(memory(step, "z")[0])


def test_an_estimate_that_is_right_beyond_its_range_restarts_ever_more_seldom() -> None:
    """A plant that rests 10 % of the width beyond its declared range, and an estimate that is exact: after T, T, 2 T,
    4 T .. and at last every 512 T, of 2^11 T a guard acts 13 times: a projection, then restarts."""
    step = hg.sample(
        hg.observers.high_gain(hg.forms.triangular(plants.chain(2)), theta=4, poles=(-1, -1)), hg.methods.rk4, dt=0.05
    )
    step.reset()
    count = 2048 * int(first(step, "fault_limit_range"))
    run = step.run(u=np.full((count, 1), np.sin(4.0)), y=np.full((count, 1), 4.8))
    names = [bit.name for bit in step.layout.bits]
    acted = {name: int((run.status & (1 << names.index(name)) != 0).sum()) for name in GUARDS}
    assert abs(run.x[-1, 0] - 4.8) < 1e-3
    assert acted[PROJECTED] == 1
    assert 11 <= acted[BIT] <= 12


def test_spoiled_counts_begin_anew() -> None:
    """A limit that memory was spoiled to would keep a lost estimate lost for as long."""
    step = quick()
    step.reset()
    for _ in range(50):
        step(0.0, 0.0)
    memory(step, "fault_limit_y")[0] = 60 * first(step, "fault_limit_y")
    memory(step, "fault_limit_range")[0] = 1000 * first(step, "fault_limit_range")
    step(0.0, 3.0)
    assert memory(step, "fault_limit_y")[0] == first(step, "fault_limit_y")
    assert memory(step, "fault_limit_range")[0] == first(step, "fault_limit_range")
    assert memory(step, "fault_count_y")[0] == 1


@needs_compiler
def test_each_output_counts_its_share() -> None:
    """p in each period, though one of the p = 2 sensors comes every second period only."""
    a, b, y, v = (hg.Signal(name, low=-10, high=10) for name in "abyv")
    plant = hg.System("two", states=(a, b), outputs=(y, v), flow=[b, -sp.sin(a) - b / 5], output=[a, b])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1e-6, 1e-6], R=[10.0, 10.0])
    together = hg.sample(observer, dt=0.01)
    separate = hg.sample(observer, dt=0.01, periods={"v": 0.02})
    rises = []
    for step in (together, separate):
        for k in range(8):
            step.predict()
            memory(step, "z")[:] = 12.0
            step.update(y=12.0)
            if step is together or k % 2 == 0:
                memory(step, "z")[:] = 12.0
                step.update(v=12.0)
        rises.append([float(memory(step, f"fault_count_{name}")[0]) for name in ("y_y", "y_v", "range")])
    assert rises == [[0, 0, 8 * 2]] * 2


def test_a_sensor_that_R_declares_worthless_judges_nothing() -> None:
    """Of three sensors the second is 3 of 20 off for ever, and R says so, 1e4 s is a noise of 1000 at a sample: it has
    no count. With an R that is 1,000 times as large but no wider than the range, or the same for all, it is judged."""
    a, b = (hg.Signal(name, low=-10, high=10) for name in "ab")
    outputs = tuple(hg.Signal(name, low=-10, high=10) for name in ("y1", "y2", "y3"))
    plant = hg.System("red", states=(a, b), outputs=outputs, flow=[b, -sp.sin(a) - b / 5], output=[a, a, b])
    counts = []
    for R in ([0.01, 1e4, 0.01], [1e-6, 1e-3, 1e-6], [0.01, 0.01, 0.01]):
        step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[0.01, 0.01], R=R), dt=0.01)
        for _ in range(100):
            step(y=[0.0, 6.0, 0.0])
        counts.append({sign.name: float(memory(step, sign.count)[0]) for sign in step.code.signs})
    assert counts[0] == {"y_y3": 0, "y_y1": 0, "range": 0}
    assert counts[1]["y_y2"] > 50
    assert counts[2]["y_y2"] > 50


def test_a_plausible_sample_that_is_absurdly_far_off_is_a_sign() -> None:
    """It is rejected, and corrects nothing: without a restart the estimate would stay at 3e7 for ever."""
    x, u = hg.Signal("x"), hg.Signal("u")
    y = hg.Signal("y", low=-30, high=30)
    plant = hg.System("cubic", states=(x,), inputs=(u,), outputs=(y,), flow=[u], output=[x**3 + x])
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1.0], R=[1.0]), dt=0.01)
    inputs = np.zeros((4000, 1))
    inputs[1000:1003] = 1e9
    run = step.run(u=inputs, y=np.full((4000, 1), 2.0))
    assert abs(run.x[999, 0] - 1) < 0.01
    assert run.x[1100, 0] > 1e6
    assert abs(run.x[-1, 0] - 1) < 0.1


@pytest.mark.parametrize("method", [hg.methods.rk4, None], ids=["together", "one by one"])
def test_an_estimate_that_only_one_of_two_outputs_shows_to_be_lost_restarts(method: Any) -> None:
    """The other is off by nothing, and takes nothing of the count away."""
    a, b = (hg.Signal(name, low=-10, high=10) for name in "ab")
    y, v = (hg.Signal(name, low=-10, high=10) for name in "yv")
    plant = hg.System("two", states=(a, b), outputs=(y, v), flow=[b, -sp.sin(a) - b / 5], output=[a, b])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1e-6, 1e-6], R=[10.0, 10.0])
    step = hg.sample(observer, dt=0.01, **({"method": method} if method else {}))
    sign = next(sign for sign in step.code.signs if sign.name == "y_y")
    for _ in range(sign.wait - 1):
        memory(step, "z")[:] = -6.0, 0.0
        assert BIT not in step(y=[5.0, 0.0]).flags
    memory(step, "z")[:] = -6.0, 0.0
    sample = step(y=[5.0, 0.0])
    assert BIT in sample.flags
    assert sample["a"] == pytest.approx(5.0, abs=0.1)  # the other sample may correct it


# --- from where it restarts ---------------------------------------------------------------------------------


def nearly(observer: Observer, **options: Any) -> CallableStep:
    """A step one far sample before its restart, with memory that is not that of a reset."""
    step = hg.sample(observer, **{"dt": 0.01, **options})
    for _ in range(3):
        step([0.3] * len(step.inputs), [0.2] * len(step.outputs))
    nearly_lost(step)
    return step


def nearly_lost(step: CallableStep) -> None:
    """One sample that is off y, or out of a range, is enough for a restart."""
    total = 0.0
    for sign in step.code.signs:
        memory(step, sign.count)[0] = sign.wait - 1
        memory(step, sign.limit)[0] = sign.wait
        total += sign.wait - 1
    memory(step, "fault_checksum")[0] = total


def test_the_measured_state_is_the_sample_and_the_others_rest() -> None:
    step = nearly(plants.pendulum(theta=4), method=hg.methods.rk4)
    memory(step, "z")[:] = -12.0, 55.0
    sample = step(0.0, 2.5)
    assert BIT in sample.flags
    assert (sample["q"], sample["w"]) == (2.5, 0.0)


def test_the_start_is_the_nearest_to_rest_that_shows_the_sample() -> None:
    """y = a + 2 b: x_0 + V g e/(g' V g) with V of equal widths is (e, 2 e)/5, and the covariance restarts as well."""
    a, b = (hg.Signal(name, low=-10, high=10) for name in "ab")
    y = hg.Signal("y", low=-30, high=30)
    plant = hg.System("mixed", states=(a, b), outputs=(y,), flow=[b, -sp.sin(a) - b / 5], output=[a + 2 * b])
    step = nearly(hg.observers.riccati(hg.forms.original(plant), Q=[0.1, 0.1], R=0.1, covariance=[2.0, 3.0]))
    memory(step, "z")[:] = 29.0, 29.0
    sample = step(y=-20.0)
    assert BIT in sample.flags
    assert np.allclose([sample["a"], sample["b"]], [-4.0, -8.0], rtol=1e-14)
    assert memory(step, "D").tolist() == [2.0, 3.0]
    assert memory(step, "L").tolist() == [0.0]


def test_of_several_outputs_only_valid_ones_are_fitted() -> None:
    step = nearly(
        hg.observers.riccati(hg.forms.original(plants.two_outputs()), Q=[0.1] * 3, R=[0.1, 0.2]),
        method=hg.methods.rk4_covariance,
    )
    memory(step, "z")[:] = 29.0
    sample = step(0.0, [NAN, 7.0])
    assert BIT in sample.flags
    assert [sample[name] for name in ("x1", "x2", "x3")] == [0.0, 0.0, 7.0]


@pytest.mark.parametrize(
    ("h", "there", "span"),
    [
        (sp.exp, 5.0, np.exp(6.0)),  # one step along the slope at 0 would end at the corner, 6
        (lambda x: x**3 + x, 5.0, 2 * (6**3 + 6)),
        (lambda x: x**2, 5.0, 36.0),  # flat where the estimate rests
        (sp.atan, 3.0, 2 * np.arctan(6.0)),
    ],
    ids=["exp", "cubic", "square", "atan"],
)
def test_the_start_fits_a_sensor_that_is_not_linear(h: Any, there: float, span: float) -> None:
    x, v = (hg.Signal(name, low=-6, high=6) for name in "xv")
    plant = hg.System(
        "ntc", states=(x, v), outputs=(hg.Signal("y"),), flow=[v - x, -sp.sin(x) / 5 - v / 5], output=[h(x)]
    )
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1, 1], R=1.0), dt=0.01)
    reading = float(h(sp.Float(there)))
    step(y=reading)
    memory(step, "z")[:] = -17.0
    nearly_lost(step)
    sample = step(y=reading)
    assert BIT in sample.flags
    assert abs(float(h(sp.Float(sample["x"]))) - reading) <= SHARE / 2 * span
    assert abs(sample["v"]) <= 6


def test_the_start_stays_in_the_declared_range() -> None:
    """A reading a tenth beyond what the range shows is noise: the start is at its end."""
    x, v = (hg.Signal(name, low=-6, high=6) for name in "xv")
    plant = hg.System("ntc", states=(x, v), outputs=(hg.Signal("y"),), flow=[v - x, -v], output=[sp.exp(x / 3)])
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1, 1], R=1.0), dt=0.01)
    reading = 1.1 * np.exp(2)
    step(y=reading)
    memory(step, "z")[:] = -17.0
    nearly_lost(step)
    sample = step(y=reading)
    assert BIT in sample.flags
    assert sample["x"] == 6


def test_a_bank_restarts_each_member_at_the_sample() -> None:
    step = nearly(hg.observers.bank(plants.kalman(plants.van_der_pol()), count=3, period=0.1))
    estimates = [array for place, array in step._kept.places.items() if place.name == "z"]
    for array in estimates:
        array[...] = 11.0
    sample = step(y=1.5)
    assert BIT in sample.flags
    assert sample["x1"] == 1.5
    assert estimates
    assert all((array.reshape(-1, 2) == [1.5, 0.0]).all() for array in estimates)


# --- where nothing is wrong ---------------------------------------------------------------------------------


def test_a_plant_at_rest_at_the_edge_of_its_range_is_not_restarted() -> None:
    """The sensor reads 2 % of the range too much: the estimate stays beyond it, and is right."""
    observer = hg.observers.high_gain(hg.forms.triangular(plants.chain(2)), theta=4, poles=(-1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=0.05)
    flags = [step(np.sin(4.0), 4.0 + 0.16).flags for _ in range(3000)]
    assert "OUTSIDE_BOX" in flags[-1]
    assert not any(BIT in each for each in flags[100:])


PAIRS = tuple(recovery.pairs())


def calm(name: str, tuning: str, seeds: int) -> None:
    step = recovery.model(name).step(tuning)
    share, restarts = recovery.undisturbed(name, step, seeds)
    assert (restarts, share < 1) == (0, True), f"the fault count reaches {share:.2f} of its limit"


@pytest.mark.ordinary("cascaded_tanks-riccati")
@needs_compiler
@pytest.mark.parametrize(("name", "tuning"), [("pendulum", "high_gain"), ("cascaded_tanks", "riccati")])
def test_no_shipped_trial_restarts(name: str, tuning: str) -> None:
    calm(name, tuning, 3)


# --- faults -------------------------------------------------------------------------------------------------


def fault(name: str) -> recovery.Fault:
    return next(each for each in recovery.FAULTS if each.name == name)


@pytest.mark.full
@needs_compiler
@pytest.mark.parametrize(
    ("name", "tuning", "faults"),
    [
        ("hindmarsh_rose", "high_gain", ("random 1", "random long", "spikes 2")),  # a corner of the outer box
        ("haldane", "high_gain", ("jump 1", "stuck above")),  # a false equilibrium beyond the ranges
    ],
)
def test_an_estimate_that_was_lost_for_ever_comes_back(name: str, tuning: str, faults: tuple[str, ...]) -> None:
    pair, outcomes = recovery.survey(name, tuning, [fault(each) for each in faults])
    assert pair.settles
    assert [(o.fault.name, o.enough and not o.lost) for o in outcomes] == [(each, True) for each in faults]
    assert any(o.recoveries for o in outcomes)


def surveyed(name: str, tuning: str) -> None:
    calm(name, tuning, 100)
    pair, outcomes = recovery.survey(name, tuning)
    assert all(o.finite for o in outcomes)
    lost = [o.fault.name for o in outcomes if o.lost and o.enough]
    assert not (pair.settles and lost), recovery.line(pair, outcomes)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(("name", "tuning"), PAIRS[3::10])
def test_a_tenth_of_the_survey(name: str, tuning: str) -> None:
    surveyed(name, tuning)


def test_the_survey_holds_faults_of_every_kind_in_both_halves() -> None:
    for half in (recovery.DESIGN, recovery.HELD_OUT):
        assert {each.kind for each in half} == set(recovery.KINDS)
    names = [each.name for each in recovery.FAULTS]
    assert len(names) == len(set(names)) >= 40
    assert len(recovery.DESIGN) == len(recovery.HELD_OUT)


def test_a_gain_that_a_fault_has_raised_falls_again() -> None:
    """lambda_tracking: k rises while samples are wild, and is at k_0 again long after, as before the fault."""
    step = load(plants.MODELS / "pendulum.py").step("lambda_tracking")
    step.reset()
    quiet = [step(0.0, 0.0)["q"] for _ in range(20000)]
    before = float(memory(step, "k")[0])
    for sign in itertools.islice(itertools.cycle((-1, 1)), 400):
        step(0.0, 3.0 * sign)
    raised = float(memory(step, "k")[0])
    for _ in range(60000):
        last = step(0.0, 0.0)
    assert raised > 2 * before
    assert float(memory(step, "k")[0]) == first(step, "k")
    assert abs(last["q"]) <= max(abs(quiet[-1]), 0.05)


def test_a_gain_that_was_learned_outlives_a_restart() -> None:
    """lambda_tracking: k is of the plant, not of its state; without it each restart would learn it again."""
    step = load(plants.MODELS / "pendulum.py").step("lambda_tracking")
    step.reset()
    for k in range(200):
        step(0.0, 3.0 * (-1) ** k)
    learned = float(memory(step, "k")[0])
    nearly_lost(step)
    estimate = float(memory(step, "w")[0])
    assert BIT in step(0.0, -3.0 if estimate > 0 else 3.0).flags
    assert float(memory(step, "k")[0]) >= learned > 1.5 * first(step, "k")


def test_a_lost_value_restarts_the_predictors_as_well() -> None:
    """Sums of the innovation that are no numbers would lose theta again and again, and each time a good estimate."""
    step = load(plants.MODELS / "fitzhugh_nagumo.py").step()
    for _ in range(20):
        step(0.0, 0.1)
    sums = next(array for place, array in step._kept.places.items() if place.name == "sum")
    sums[...] = NAN
    flags = [step(0.0, NAN).flags for _ in range(20)]
    assert sum("RESTARTED" in each for each in flags) == 1
    assert np.isfinite(sums).all()
