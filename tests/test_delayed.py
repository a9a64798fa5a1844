"""Samples that come late: the filter without delays of the same samples in time, faults, C, and what is told."""

import copy
import json
import pickle
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import chain, kalman, two_outputs
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.emit.cost import cost
from hgogen.emit.interface import entries, of_section
from hgogen.emit.saved import mark, sealed
from hgogen.emit.syntax import Real
from hgogen.program import Call, Place, Program, walk
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.run.samples import BadShape
from hgogen.step import CannotUpdate
from hgogen.stepping import delays
from hgogen.stepping.discretise import NoEquation
from hgogen.stepping.machine import Machine

NAN = float("nan")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


# --- observers and schedules --------------------------------------------------------------------------------


def linear() -> hg.System:
    """x1' = x2, x2' = -x1 - x2/2 + u."""
    x1, x2 = (hg.Signal(name, low=-4, high=4) for name in ("x1", "x2"))
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-5, high=5)
    flow = [x2, -x1 - x2 / sp.Integer(2) + u]
    return hg.System("linear", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=[x1])


def adaptive(innovation: Any) -> hg.Observer:
    theta = hg.theta.adaptive(2, mu=(0.001, 0.01), innovation=innovation)
    return kalman(chain(2), theta=theta)


def several() -> hg.Observer:
    return hg.observers.riccati(hg.forms.original(two_outputs()), Q=[0.1] * 3, R=[0.1, 0.2])


OBSERVERS = {
    "linear": lambda: kalman(linear()),
    "bent": lambda: kalman(chain(2)),
    "window": lambda: adaptive(hg.innovation.window(0.2)),
    "staggered": lambda: adaptive(hg.innovation.staggered(0.4, predictors=2)),
    "decaying": lambda: kalman(chain(2), theta=hg.theta.decaying(3, 1)),
    "many states": lambda: kalman(chain(12), Q=(0.1,) * 12),
    "ukf": lambda: hg.observers.ukf(hg.forms.triangular(chain(2)), Q=[0.1] * 2, R=0.1),
    "iterated_ekf": lambda: hg.observers.iterated_ekf(hg.forms.triangular(chain(2)), Q=[0.1] * 2, R=0.1),
    "several": several,
}


@cache
def observer(name: str) -> hg.Observer:
    return OBSERVERS[name]()


@cache
def steps(name: str, real: Real = "double", engine: Any = "python", **late: int) -> tuple[Any, Any]:
    """The step for late samples, and that without delays."""
    options: dict[str, Any] = {"dt": 0.05, "real": real, "engine": engine}
    around = hg.delayed(observer(name), **(late or {observer(name).form.system.outputs[0].name: 5}))
    return hg.sample(around, **options), hg.sample(observer(name), **options)


def fresh(name: str, real: Real = "double", engine: Any = "python", **late: int) -> tuple[Any, Any]:
    both = steps(name, real, engine, **late)
    for one in both:
        one.reset()
    return both


def signals(step: Any, samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """u (N, m), y (N, p) of random numbers."""
    random = np.random.default_rng(seed)
    y = np.cumsum(random.uniform(-0.5, 0.5, (samples, len(step.outputs))), axis=0)
    return random.uniform(-1, 1, (samples, len(step.inputs))), np.clip(y, -4, 4)


def posted(step: Any, y: np.ndarray, ages: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """What each call is given where the first output's sample of row k comes `ages[k]` rows later, if that row is free
    and `ages[k]` is not None; and the samples y (N, p), in the order of time, that are there after each call."""
    most, count = int(step.ages[0].interval[1]), len(y)
    rows = np.column_stack([y, np.zeros(count)])
    rows[:, 0] = NAN
    first = np.full(count, NAN)
    came: dict[int, int] = {}
    for taken, age in enumerate(ages):
        if age is not None and taken + age < count and taken + age not in came:
            came[taken + age] = taken
            rows[taken + age, 0], rows[taken + age, -1] = y[taken, 0], age
    known = []
    for row in range(count):
        if row in came and row - came[row] <= most:
            first[came[row]] = y[came[row], 0]
        there = np.column_stack([first, y[:, 1:]])[: row + 1].copy()
        known.append(there)
    return rows, known


# --- the filter without delays of the same samples in the order of time --------------------------------------


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_after_each_call_it_is_the_filter_without_delays(data: Any) -> None:
    """Bit for bit, of every observer, with samples that come late, too late, out of order or never."""
    name = data.draw(st.sampled_from(["linear", "bent", "several", "staggered"]))
    step, plain = fresh(name)
    ages = data.draw(st.lists(st.one_of(st.integers(0, 7), st.none()), min_size=12, max_size=24))
    u, y = signals(step, len(ages), data.draw(st.integers(0, 99)))
    for k in data.draw(st.lists(st.integers(0, len(ages) - 1), max_size=3)):
        y[k] = data.draw(st.sampled_from([NAN, np.inf, -1e30, 1e16, 50.0]))  # missing or rejected
    rows, known = posted(step, y, ages)
    run = step.run(u, rows)
    for k, there in enumerate(known):
        plain.reset()
        assert np.array_equal(run.x[k], plain.run(u[: k + 1], there).x[-1])


@pytest.mark.ordinary("bent-double", "window-double", "staggered-double", "several-float")
@pytest.mark.parametrize(
    ("name", "real"), [*((name, "double") for name in OBSERVERS), ("several", "float"), ("window", "float")]
)
def test_every_observer_ends_where_it_would_without_delays(name: str, real: Real) -> None:
    step, plain = fresh(name, real)
    u, y = signals(step, 80)
    rows, known = posted(step, y, np.random.default_rng(1).integers(0, 6, 80))
    run, expected = step.run(u, rows), plain.run(u, known[-1])
    assert np.array_equal(run.x[-1], expected.x[-1])
    assert {name: values[-1] for name, values in run.traces.items()} == {
        name: values[-1] for name, values in expected.traces.items()
    }


@pytest.mark.ordinary("linear", "bent", "window", "several")
@pytest.mark.parametrize("name", OBSERVERS)
def test_samples_that_come_at_once_give_the_filter_without_delays(name: str) -> None:
    """In every call, its status as well."""
    step, plain = fresh(name)
    u, y = signals(step, 60)
    y[20], y[30], u[40] = NAN, 1e30, NAN
    run, expected = step.run(u, np.column_stack([y, np.zeros(60)])), plain.run(u, y)
    assert np.array_equal(run.x, expected.x)
    assert [step.flags(one) for one in run.status] == [plain.flags(one) for one in expected.status]


@pytest.mark.parametrize("most", [1, 50])
def test_all_late_by_as_much_as_they_may(most: int) -> None:
    """After K calls more without a sample, which predict in both."""
    step, plain = fresh("bent", y=most)
    u, y = signals(step, 70)
    run = step.run(u, step.arriving(y))
    there = np.where(np.arange(70)[:, None] < 70 - most, y, NAN)
    assert np.array_equal(run.x[-1], plain.run(u, there).x[-1])


def test_a_burst_in_one_period_is_fused_at_once() -> None:
    """In any order; `adapt` runs the periods again once for all of them."""
    step, plain = fresh("several")
    u, y = signals(step, 12)
    for k in range(12):
        step.predict(u[k])
        step.update(y2=y[k, 1])
        if k == 11:
            for age in (3, 0, 5, 1, 4, 2):
                assert not step.update(y1=y[k - age, 0], y1_age=age).status
        last = step.adapt()
    y[:6, 0] = NAN
    assert np.array_equal(last.x, plain.run(u, y).x[-1])


def test_what_adapt_was_not_called_for_is_made_up_by_the_next() -> None:
    step, plain = fresh("bent")
    u, y = signals(step, 10)
    for k in range(10):
        step.predict(u[k])
        step.update(y=y[k, 0])
        last = step.adapt() if k in (3, 4, 9) else None
    assert last is not None
    assert np.array_equal(last.x, plain.run(u, y).x[-1])


@pytest.mark.parametrize("age", [0, 3, 5])
def test_a_sample_that_waits_for_adapt_until_it_is_too_old_is_dropped_and_said_to_be(age: int) -> None:
    """One of `age` periods ago waits for 5 - `age` more, in silence; the next `predict` drops it, and says so once."""
    step, other = fresh("bent")[0], copy.copy(fresh("bent")[0])
    for one in (step, other):
        for _ in range(7):
            one(0.1, [NAN, 0])
    step.update(y=0.2, y_age=age)
    for k in range(8):
        assert step.flags(step.predict(0.1).status) == (("DROPPED",) if k == 5 - age else ())
        assert other.predict(0.1).status == 0  # where no sample waits none is dropped
        last, without = copy.copy(step).adapt(), copy.copy(other).adapt()
        assert np.array_equal(last.x, without.x) == (k >= 5 - age)


def test_a_sample_in_time_is_dropped_as_a_late_one_is() -> None:
    step, _ = fresh("several")
    said = []
    for k in range(7):
        said.append(step.flags(step.predict(0.0).status))
        step.update(**({"y2": 0.1} if k == 0 else {}))
    assert said == [()] * 6 + [("DROPPED",)]


def test_both_outputs_late_by_numbers_of_their_own() -> None:
    step, plain = fresh("several", y1=2, y2=4)
    assert [age.interval for age in step.ages] == [(0, 2), (0, 4)]
    u, y = signals(step, 40)
    run = step.run(u, step.arriving(y))
    there = y.copy()
    there[38:, 0], there[36:, 1] = NAN, NAN
    assert np.array_equal(run.x[-1], plain.run(u, there).x[-1])
    assert step.flags(step(u[0], [1.0, NAN, 3, 0]).status)[0] == "LATE_Y1"


def test_slower_sensors_have_the_noise_of_their_own_period() -> None:
    late = hg.sample(hg.delayed(observer("several"), y1=3), dt=0.05, periods={"y1": 0.1}, engine="python")
    plain = hg.sample(observer("several"), dt=0.05, periods={"y1": 0.1}, engine="python")
    u, y = signals(late, 30)
    y[1::2, 0] = NAN
    there = y.copy()
    there[27:, 0] = NAN
    assert np.array_equal(late.run(u, late.arriving(y)).x[-1], plain.run(u, there).x[-1])
    assert late.rebuilt().clock.periods == plain.clock.periods


# --- restarts -----------------------------------------------------------------------------------------------


def test_a_restart_in_the_middle_is_that_of_the_samples_in_time() -> None:
    """Of a filter that trusts its model the estimate is off by more than a tenth of what y spans, until it restarts
    from a sample that came late; others that were taken before come later still."""
    step, plain = (copy.copy(one) for one in fresh("bent"))
    for one in (step, plain):
        one.tune(Q=[1e-7, 1e-7], R=1e4)
    count = 2 * plain.code.signs[0].wait
    u, y = np.zeros((count, 1)), np.full((count, 1), 3.9)
    rows, known = posted(step, y, np.random.default_rng(3).integers(0, 6, count))
    run, expected = step.run(u, rows), plain.run(u, known[-1])
    assert any("RESTARTED_FROM_SAMPLE" in plain.flags(one) for one in expected.status)
    assert any("RESTARTED_FROM_SAMPLE" in step.flags(one) for one in run.status)
    assert np.array_equal(run.x[-1], expected.x[-1])


def test_what_is_lost_of_the_memory_begins_anew() -> None:
    """Of every period and of now, the counters of the period with it, also where the next sample goes back to one."""
    step = copy.copy(fresh("bent")[0])
    for age in range(6):
        step.reset()
        for _ in range(8):
            step(0.1, [NAN, 0])
        for place, array in step._kept.places.items():
            if place.struct == "memory":
                array[:] = NAN if array.dtype == float else 0
        sample = step(0.1, [0.1, age])
        assert np.isfinite(sample.x).all()
        assert ("RESTARTED" in sample.flags) == (age > 0)
    worn = np.full(len(step._kept.state) // 4, 0x7FF80000, np.uint32)
    worn[0] = mark(step, "double")
    step.restore(sealed(step, "double", worn.tobytes()))
    after = step.run(np.zeros(30), np.column_stack([np.zeros(30), np.arange(30) % 6]))
    assert np.isfinite(after.x[1:]).all()
    assert any("RESTARTED" in step.flags(one) for one in after.status)


# --- faults -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("y", "age", "bit"),
    [
        (1.0, 6, "LATE_Y"),
        (1.0, 1e300, "LATE_Y"),
        (1.0, np.inf, "LATE_Y"),
        (1.0, -1, "UNDATED_Y"),
        (1.0, 0.5, "UNDATED_Y"),
        (1.0, NAN, "UNDATED_Y"),
        (1.0, 3, "REPEATED_Y"),
        (NAN, 2, "MISSING_Y"),
        (np.inf, 2, "MISSING_Y"),
        (NAN, NAN, "MISSING_Y"),
    ],
)
def test_a_sample_that_is_not_used_is_said_and_leaves_no_trace(y: float, age: float, bit: str) -> None:
    """3 periods ago there was one. The memory is that after a call without a sample."""
    step, other = fresh("bent")[0], copy.copy(fresh("bent")[0])
    for one in (step, other):
        for k in range(9):
            one(0.1, [0.2 * k, 0])
    status = step(0.3, [y, age]).status
    other(0.3, [NAN, 0])
    assert step.flags(status) == (bit,)
    assert step.save() == other.save()
    assert np.isfinite(np.frombuffer(bytes(step._kept.state), float)[:-8]).all()


def test_a_sample_from_before_the_start_or_a_reset_is_late() -> None:
    step, _ = fresh("bent")
    assert step.flags(step(0.0, [1.0, 1]).status) == ("LATE_Y",)
    assert step.flags(step(0.0, [1.0, 1]).status) == ()
    step.reset()
    assert step.flags(step(0.0, [1.0, 1]).status) == ("LATE_Y",)


def test_before_the_first_predict_every_sample_is_early() -> None:
    step, _ = fresh("several")
    assert step.flags(step.update(y1=1.0, y2=1.0, y1_age=0).status) == ("EARLY_Y1", "EARLY_Y2")
    assert step.adapt().status == 0
    assert step.save() == steps("several")[0].save() == fresh("several")[0].save()


def test_a_rejected_sample_is_said_where_it_is_fused() -> None:
    step, _ = fresh("bent")
    for k in range(5):
        step(0.0, [0.1 * k, 0])
    assert step.flags(step(0.0, [1e9, 2]).status) == ("REPEATED_Y",)
    step(0.0, [NAN, 0])
    assert "REJECTED_Y" in step.flags(step(0.0, [1e9, 1]).status)


def test_an_input_that_is_no_number_reuses_the_last_one_again() -> None:
    step, plain = fresh("bent")
    u, y = signals(step, 20)
    u[10:12] = [[NAN], [np.inf]]
    rows, known = posted(step, y, [3] * 20)
    run, expected = step.run(u, rows), plain.run(u, known[-1])
    assert np.array_equal(run.x[-1], expected.x[-1])
    assert "REUSED_U" in step.flags(run.status[10])
    step(NAN, [NAN, 0])
    memory = (array for place, array in step._kept.places.items() if place.struct in ("state", "period", "memory"))
    assert all(np.isfinite(array).all() for array in memory)


BAD: dict[str, tuple[Any, str]] = {
    "a form": (lambda: hg.delayed(hg.forms.triangular(chain(2)), y=1), "goes around an observer"),
    "nothing": (lambda: hg.delayed(kalman(chain(2))), "delays nothing; name an output, such as y=5"),
    "no output": (lambda: hg.delayed(kalman(chain(2)), v=1), "names no output; the outputs are y"),
    "zero": (lambda: hg.delayed(kalman(chain(2)), y=0), "must be a whole number, from 1 to 1000"),
    "a share": (lambda: hg.delayed(kalman(chain(2)), y=1.5), "must be a whole number, from 1 to 1000"),
    "too many": (lambda: hg.delayed(kalman(chain(2)), y=1001), "must be a whole number, from 1 to 1000"),
    "truth": (lambda: hg.delayed(kalman(chain(2)), y=True), "must be a whole number, from 1 to 1000"),
    "twice": (lambda: hg.delayed(hg.delayed(several(), y1=1), y2=1), "name all late outputs in one call"),
    "a bank": (
        lambda: hg.delayed(hg.observers.bank(kalman(chain(2)), count=2, period=1.0), y=1),
        "not around a bank",
    ),
    "in a bank": (
        lambda: hg.observers.bank(hg.delayed(kalman(chain(2)), y=1), count=2, period=1.0),
        "whose samples come at once",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_delays(name: str) -> None:
    make, said = BAD[name]
    with pytest.raises(BadGain, match=said):
        make()


def test_its_theorem_is_claimed_under_a_model_that_foretells_to_now() -> None:
    late = hg.delayed(observer("linear"), y=5)
    (added,) = set(late.theorem.hypotheses) - set(observer("linear").theorem.hypotheses)
    assert added == delays.IN_TIME
    assert added.verdict is hg.Verdict.UNKNOWN


def test_a_name_that_the_plant_has_already() -> None:
    x, age, y = hg.Signal("x", low=-1, high=1), hg.Signal("y_age", low=-1, high=1), hg.Signal("y")
    plant = hg.System("aged", states=(x, age), outputs=(y,), flow=[age, -x], output=[x])
    with pytest.raises(BadGain, match="adds a signal y_age, which the plant has already"):
        hg.delayed(kalman(plant), y=1)


def test_an_output_whose_name_ends_in_an_underscore() -> None:
    x, y = hg.Signal("x", low=-1, high=1), hg.Signal("y_")
    plant = hg.System("lined", states=(x,), outputs=(y,), flow=[-x], output=[x])
    assert [age.name for age in hg.sample(hg.delayed(kalman(plant), y_=1), dt=0.05).ages] == ["y_age"]


def test_an_observer_that_integrates_with_the_measurement_is_refused() -> None:
    with pytest.raises(CannotUpdate, match="so it cannot predict and update apart"):
        hg.sample(hg.delayed(kalman(chain(2)), y=1), hg.methods.rk4_covariance, dt=0.01)


def test_samples_without_ages_are_refused() -> None:
    step, _ = fresh("bent")
    with pytest.raises(BadShape, match=r"must have shape \(N, 2\)"):
        step.run(np.zeros(3), np.zeros(3))
    with pytest.raises(BadShape, match="must have 2 elements: y, y_age"):
        step(0.0, 1.0)


def test_an_age_without_a_sample_is_refused() -> None:
    step, _ = fresh("bent")
    step.predict(0.0)
    with pytest.raises(BadShape, match=r"update\(y_age=\) is the age of a sample of y that is missing; give y too"):
        step.update(y_age=1)


# --- what else is done with a step ---------------------------------------------------------------------------


def test_it_is_copied_pickled_and_made_again() -> None:
    step, _ = fresh("bent")
    u, y = signals(step, 20)
    rows, _ = posted(step, y, [1, 4, 0, 2] * 5)
    step.run(u[:10], rows[:10])
    others = [copy.copy(step), pickle.loads(pickle.dumps(step)), step.rebuilt()]
    others[2].restore(step.save())
    last = step.run(u[10:], rows[10:]).x
    for other in others:
        assert np.array_equal(other.run(u[10:], rows[10:]).x, last)
    started = step.started(lambda form: {"x1": 1.5})
    assert started.observer.delays == (("y", 5),)
    assert started.observer.initial == {"x1": 1.5}


def test_an_estimate_that_was_written_is_where_it_starts() -> None:
    step, plain = fresh("staggered")
    u, y = signals(step, 20)
    for one in (step, plain):
        one._kept.places[next(place for place in one._kept.places if str(place) == "state.z")][:] = [1.0, -1.0]
    rows, known = posted(step, y, [3] * 20)
    assert np.array_equal(step.run(u, rows).x[-1], plain.run(u, known[-1]).x[-1])


def test_records_in_time_and_in_the_order_of_arrival() -> None:
    step, _ = fresh("several")
    _, y = signals(step, 30)
    rows, known = posted(step, y, np.random.default_rng(5).integers(0, 7, 30))
    assert np.array_equal(step.in_time(rows), known[-1], equal_nan=True)
    late = step.arriving(y)
    assert np.array_equal(late[5:, 0], y[:-5, 0])
    assert np.isnan(late[:5, 0]).all()
    assert set(late[:, 2]) == {5.0}
    assert np.array_equal(step.undelayed.arriving(y), y)
    assert step.arriving(y[:3])[:, 0].tolist() != y[:3, 0].tolist()
    odd = np.array([[1.0, 0.0, 0.5], [2.0, 0.0, NAN], [3.0, 0.0, 9.0], [4.0, 0.0, 2.0], [5.0, 0.0, 3.0]])
    assert np.array_equal(step.in_time(odd)[:, 0], [NAN, 4.0, NAN, NAN, NAN], equal_nan=True)


@pytest.mark.parametrize("name", ["bent", "many states"])
def test_innovations_are_those_of_the_prediction_in_the_sample_s_own_period(name: str) -> None:
    """Where every sample of the only output comes as late as it may, each finds all before it fused, as in time."""
    step, plain = fresh(name)
    u, y = signals(step, 60)
    run, expected = step.run(u, step.arriving(y)), plain.run(u, y)
    assert run.innovations is not None
    assert expected.innovations is not None
    assert run.variances is not None
    assert expected.variances is not None
    assert np.array_equal(run.innovations[5:, 0], expected.innovations[:-5, 0])
    assert run.variances[5:, 0] == pytest.approx(expected.variances[:-5, 0], rel=1e-12)
    assert run.covariance is not None
    assert (np.linalg.eigvalsh(run.covariance) > 0).all()


def test_a_trial_brings_every_sample_as_late_as_it_may() -> None:
    step, plain = fresh("bent")
    trial = hg.trial.Trial("late", 2.0, {"x1": 1.0, "x2": 0.0}, {"u": 0.3}, {"y": 0.01}, seeds=(0,))
    one, other = next(iter(hg.trial.try_out(step, trial))), next(iter(hg.trial.try_out(plain, trial)))
    assert np.array_equal(one.y, other.y)
    plain.reset()
    y = np.where(np.arange(len(one.y))[:, None] < len(one.y) - 5, one.y, NAN)
    assert np.array_equal(one.x[-1], plain.run(one.truth.u, y).x[-1])


def test_a_casadi_function_takes_late_samples_and_has_no_derivative() -> None:
    step, _ = fresh("several", y1=2)
    functions = hg.targets.casadi(step, bundled=True)
    u, y = signals(step, 12)
    rows, _ = posted(step, y, [1, 2, 0, None, 2, 1] * 2)
    run, memory = step.run(u, rows), functions.memory.initial
    for k in range(12):
        memory, x, status = functions.step(memory, u[k], rows[k], functions.p.initial)
        assert np.array_equal(np.array(x).ravel(), run.x[k])
        assert int(status) == run.status[k]
    with pytest.raises(NoEquation, match="goes back to samples of the past"):
        _ = functions.derivative


# --- C ------------------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize(("name", "real"), [("several", "double"), ("staggered", "float"), ("many states", "float")])
def test_c_and_python_have_the_same_bits(name: str, real: Real) -> None:
    step, _ = fresh(name, real)
    u, y = signals(step, 50)
    y[7], y[20], u[30] = NAN, 1e30, NAN
    rows, _ = posted(step, y, np.random.default_rng(2).integers(0, 8, 50))
    run, compiled = step.run(u, rows), fresh(name, real, "c")[0].run(u, rows)
    assert np.array_equal(run.x, compiled.x)
    assert np.array_equal(run.status, compiled.status)


def lines(most: int) -> list[str]:
    step = hg.sample(hg.delayed(observer("several"), y1=most), dt=0.05)
    return hg.targets.c99(step, check=False)["two.c"].splitlines()


def test_the_c_runs_periods_in_a_loop() -> None:
    """Its length does not know how late a sample may be."""
    assert len(lines(5)) == len(lines(500))


def test_what_is_called_is_what_is_declared() -> None:
    """A call holds a section of its own, of which more may be pruned where it stands among those of the step."""
    step, _ = steps("several")
    sections = [each.section for part in step.code.called for each in walk(part.program) if isinstance(each, Call)]
    assert {section.name for section in sections} <= {section.name for section in step.code.inner}
    assert len(sections) > 5
    assert all(of_section(step, section) == entries(step)[section.name] for section in sections)


def test_the_numbers_of_members_are_in_their_range() -> None:
    """A loop that copies a member takes its number from a loop over as many, and asks no more whether there is one."""
    text = hg.targets.c99(steps("staggered")[0], check=False)["chain2.c"]
    assert "memory_predictor[which_predictor]" in text.replace("\n", "").replace(" ", "")
    assert "which_predictor <" not in text


def sizes(most: int) -> Iterator[int]:
    step, plain = fresh("several", "float", "python", y1=most)
    worst, once = cost(step), cost(plain)
    yield from (worst.state, worst.operations, worst.functions, once.state, once.operations, once.functions)


def test_memory_and_the_worst_call_are_told_and_grow_with_the_periods() -> None:
    """Each more takes the memory of the step without its mark, the input and the samples, and no more than the
    operations of a period and a few choices: those of which sample is none, of the loop, and of the first prediction,
    which is not made twice.
    """
    state, operations, functions, once_state, once, once_functions = sizes(4)
    more_state, more, more_functions, *_ = sizes(14)
    assert more_state - state == 10 * (once_state - 4 + 4 * 3)
    assert 10 * once <= more - operations <= 10 * (once + 20)
    assert more_functions - functions == 10 * once_functions
    assert 5 * once <= operations <= 6 * once + 60


@pytest.mark.parametrize("age", [0, 1, 4])
def test_a_call_predicts_now_and_each_period_after_that_of_the_sample(
    age: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = hg.sample(hg.delayed(observer("bent"), y=4), dt=0.05)
    predict = next(section for section in step.code.inner if section.name == "then_predict")
    counts, action = [0], Machine.action

    def counted(self: Machine, program: Program) -> Callable[[], None]:
        run = action(self, program)

        def once() -> None:
            counts[0] += program is predict.program
            run()

        return once

    monkeypatch.setattr(Machine, "action", counted)
    machine = Machine(step)
    for sample in (*[NAN] * 6, 0.1):
        machine.memory[Place("output", "y")][0], machine.memory[Place("output", "y_age")][0] = sample, age
        counts[0] = 0
        machine.call()
    assert counts[0] == 1 + age


def test_the_manual_says_how_late_samples_are_given_and_what_they_cost() -> None:
    step, plain = fresh("several", "float")
    said = " ".join(hg.targets.c99(step, check=False)["two.md"].replace("\\", "").split())
    worst, once = cost(step), cost(plain)
    assert "measurement.y1_age = ...;" in said
    assert "with a sample of y1 goes y1_age, the number of periods ago in which it was taken, 0 for now" in said
    assert f"A period takes {once.operations} operations" in said
    assert f"no more than {worst.operations} and {worst.functions}" in said
    assert f"The state has {worst.state} bytes with them, {once.state} without delays" in said
    assert "each once a period" not in said
    assert "adapt, once after them, raises the bits about the estimate" in said
    assert "drops this sample, and raises DROPPED" in said
    assert "then_predict" not in said
    crate = " ".join(hg.targets.rust(step, check=False)["two.rs"].replace("//!", "").split())
    assert f"no more than {worst.operations} and {worst.functions}" in crate


# --- the command line ---------------------------------------------------------------------------------------

MODEL = """
name = "cart"

[states]
x = {low = -4, high = 4, flow = "v"}
v = {low = -4, high = 4, flow = "-sin(x) - v + u"}

[inputs.u]
low = -1
high = 1

[outputs.y]
low = -5
high = 5
equation = "x"

[observer]
kind = "riccati"
Q = [0.1, 0.1]
R = 0.001
dt = 0.05
delays = {y = 4}

[trial]
duration = 2
start = {x = 1, v = 0}
inputs = {u = "sin(t)"}
noise = {y = 0.01}
seeds = 1
"""


def test_a_plain_text_model_says_how_late_samples_come(tmp_path: Path) -> None:
    path = tmp_path / "cart.toml"
    path.write_text(MODEL)
    step = hg.load(path).step()
    assert step.observer.delays == (("y", 4),)
    assert [signal.name for signal in step.samples] == ["y", "y_age"]
    path.write_text(MODEL.replace("y = 4", "v = 4"))
    with pytest.raises(hg.HgogenError, match=r"observer\.delays: .* names no output; the outputs are y"):
        hg.load(path).step()


@pytest.mark.usefixtures("undrawn")
def test_run_takes_late_samples_and_judges_them_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a log with a column of ages; predictions are of samples in the order of time, innovations of what came. A
    shift takes the ages with their samples: here y was logged a row too early."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(MODEL)
    step = hg.load(tmp_path / "cart.toml").step()
    truth = hg.trial.simulate(step.observer.form.system, hg.load(tmp_path / "cart.toml").trials()[0], 0.05)
    rows, known = posted(step, truth.y, [1, 4, 2, 0, 3] * 8 + [1])
    log = np.column_stack([truth.t, truth.u, np.roll(rows, -1, axis=0)])
    np.savetxt(tmp_path / "late.csv", log, delimiter=",", header="t,u,y,age", comments="")
    arguments = ["run", "cart.toml", "--data", "late.csv", "--time", "t", "--map", "y_age=age", "--shift", "y=1"]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0, done.output
    report = json.loads(done.stdout)
    ahead = {one["ahead"]: one for one in report["predictions"]}
    assert ahead[1]["model"] < 0.05 * np.std(truth.y)
    assert report["innovations"][0]["count"] == np.isfinite(rows[1:, 0]).sum()
    assert ahead[5]["count"] == np.isfinite(known[-1][5:]).sum()
    missing = CliRunner().invoke(app, arguments[:6])
    assert "y_age" in missing.output


def test_a_sample_that_is_too_late_has_no_innovation() -> None:
    step, _ = fresh("bent")
    u, y = signals(step, 20)
    rows = step.arriving(y)
    rows[12, -1] = 9.0
    run = step.run(u, rows)
    assert step.flags(run.status[12]) == ("LATE_Y",)
    assert np.isnan([run.innovations[12, 0], run.variances[12, 0]]).all()
    assert np.isfinite(np.delete(run.innovations[5:, 0], 7)).all()
