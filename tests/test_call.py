"""Calling a step: shapes, missing and absurd samples, records by both engines, state, no compiler."""

import pickle
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from exact import machine
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import chain, fitzhugh_nagumo, kalman, pendulum, two_outputs, van_der_pol

import hgogen as hg
from hgogen.emit import layout
from hgogen.emit.cost import cost
from hgogen.emit.saved import ADDED, NotSaved
from hgogen.reading.given import BadNames
from hgogen.run import native
from hgogen.run.backends import COMPILED, FUNCTION, quickest_engine
from hgogen.run.native import CompilerFailed, NoCompiler, NoCompilerWarning
from hgogen.run.samples import BadShape
from hgogen.step import BadStep, CannotUpdate, StartsUncorrected

NAN, INF = float("nan"), float("inf")
X, V = hg.Signal("x", low=-10, high=10), hg.Signal("v", low=-3, high=3)
ENGINES = ("c", "python") if native.compiler() else ("python",)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def adaptive(innovation: object) -> hg.Observer:
    return fitzhugh_nagumo(theta=hg.theta.adaptive(4.0, mu=(0.16, 0.32), innovation=innovation))


def scalar_plant() -> hg.System:
    x, u, y = hg.Signal("x", low=-2, high=2), hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-3, high=3)
    return hg.System("one", states=(x,), inputs=(u,), outputs=(y,), flow=[-(x**3) + u], output=[x])


BUILD: dict[str, Callable[[], Any]] = {
    "staggered": lambda: hg.sample(adaptive(hg.innovation.staggered(1.0)), dt=0.01),
    "window": lambda: hg.sample(adaptive(hg.innovation.window(0.2)), dt=0.01),
    "decaying": lambda: hg.sample(fitzhugh_nagumo(theta=hg.theta.decaying(4.0, 1.0)), dt=0.01),
    "information": lambda: hg.sample(fitzhugh_nagumo(theta=3.0), hg.methods.rk4, dt=0.01),
    "high_gain": lambda: hg.sample(pendulum(), hg.methods.rk4, dt=0.01),
    "held": lambda: hg.sample(kalman(scalar_plant()), dt=0.01, between="hold"),
    "no_input": lambda: hg.sample(kalman(van_der_pol()), dt=0.01),
    "two_outputs": lambda: hg.sample(
        hg.observers.riccati(hg.forms.original(two_outputs()), Q=(1, 1, 1), R=(0.1, 0.2)), dt=0.01
    ),
    "twelve": lambda: hg.sample(kalman(chain(12), Q=(1e-3,) * 12), dt=0.01),
}
STEPS = list(BUILD)


@cache
def built(name: str) -> Any:
    return BUILD[name]()


def fresh(name: str) -> Any:
    """The step as before its first call; building and compiling it once is enough."""
    step = built(name)
    step.reset()
    return step


def record(step: Any, samples: int = 300) -> dict[str, np.ndarray]:
    """Sines, some of them missing: the outputs first together, later one at a time."""
    k = np.arange(samples)[:, None]
    u = 0.6 * np.sin(0.02 * k + np.arange(len(step.inputs)))
    y = 0.5 * np.cos(0.01 * k + np.arange(len(step.outputs)))
    y[40:45] = NAN
    y[60:65, 0] = NAN
    u[50:53] = NAN
    return {"u": u, "y": y}


def same(a: hg.Run, b: hg.Run, slack: float = 0.0) -> None:
    """Estimates and traces relative to their peaks, the status bit for bit."""
    assert np.array_equal(a.status, b.status)
    for mine, other in ((a.x, b.x), *((a.traces[name], b.traces[name]) for name in b.traces)):
        peak = np.abs(other).max(axis=0, initial=1e-300)
        assert (np.abs(mine - other) <= slack * peak).all()


# --- records ------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("high_gain")
@pytest.mark.parametrize("name", STEPS)
def test_a_run_is_repeated_calls(name: str) -> None:
    step = fresh(name)
    data = record(step)
    run = step.run(**data, engine="python")
    step.reset()
    samples = [step(u=u, y=y) for u, y in zip(data["u"], data["y"], strict=True)]
    assert np.array_equal(run.x, [sample.x for sample in samples])
    assert np.array_equal(run.status, [sample.status for sample in samples])
    for trace, values in run.traces.items():
        assert np.array_equal(values, [sample.traces[trace] for sample in samples])
    assert run.t == pytest.approx(0.01 * np.arange(300), abs=1e-15)


@pytest.mark.ordinary("information", "high_gain")
@needs_compiler
@pytest.mark.parametrize("name", STEPS)
def test_c_and_python_agree(name: str) -> None:
    """Some 1e3 operations a sample, each 1e-16, forgotten within 1e2 samples: 1e-11 of the peak."""
    step = fresh(name)
    samples = record(step)
    python = step.run(**samples, engine="python")
    step.reset()
    c = step.run(**samples)
    assert (c.engine, python.engine) == ("c", "python")
    assert np.ptp(c.x[:, 0]) > 0.1
    same(c, python, 1e-11)


@needs_compiler
def test_a_short_log_runs_in_python_and_a_long_one_in_c() -> None:
    """At the number of samples from which on compiling takes less time than Python."""
    step = fresh(STEPS[0])
    each = cost(step)
    samples = int(COMPILED / (each.operations + FUNCTION * each.functions))
    assert [quickest_engine(step, count) for count in (1, samples, samples + 1)] == ["python", "python", "c"]


@needs_compiler
@pytest.mark.parametrize("name", STEPS)
def test_a_run_goes_on_where_the_last_one_stopped(name: str) -> None:
    """In either engine, and from one to the other."""
    step = fresh(name)
    samples = record(step)
    whole = step.run(**samples, engine="c")
    step.reset()
    parts = [
        step.run(**{key: value[begin:end] for key, value in samples.items()}, engine=engine)
        for begin, end, engine in ((0, 100, "c"), (100, 101, "python"), (101, 180, "c"), (180, 300, "python"))
    ]
    joined = hg.Run(
        t=np.concatenate([part.t for part in parts]),
        x=np.concatenate([part.x for part in parts]),
        names=whole.names,
        traces={name: np.concatenate([part.traces[name] for part in parts]) for name in whole.traces},
        status=np.concatenate([part.status for part in parts]),
        engine="c",
    )
    same(joined, whole, 1e-11)
    assert joined.t == pytest.approx(whole.t)


@pytest.mark.ordinary("high_gain-python", "held-c", "no_input-c")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", STEPS)
def test_reset_forgets(name: str, engine: str) -> None:
    step = fresh(name)
    samples, new = record(step), BUILD[name]().save()
    first = step.run(**samples, engine=engine)
    assert step.save() != new
    step.reset()
    assert step.save() == new
    again = step.run(**samples, engine=engine)
    same(again, first)
    assert again.t[0] == 0


@pytest.mark.ordinary("high_gain-python", "held-c", "held-python")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", STEPS)
def test_a_restored_state_is_the_saved_one(name: str, engine: str) -> None:
    """Into another step of the same program, whichever engine filled it."""
    step, other = fresh(name), BUILD[name]()
    samples = record(step)
    step.run(**samples, engine=engine)
    saved = step.save()
    other.restore(saved)
    assert other.save() == saved
    same(other.run(**samples, engine="python"), step.run(**samples, engine="python"))
    assert other.save() == step.save()


@pytest.mark.ordinary("high_gain")
@needs_compiler
@pytest.mark.parametrize("name", ["window", "high_gain", "two_outputs", "twelve"])
def test_in_float_every_reader_has_the_bits_of_the_emitted_c(name: str) -> None:
    """With a sample beyond a float, which is none; a step of matrix kernels; and the memory of one pickled midway."""
    step = built(name).rebuilt(real="float")
    signals = record(step, 48)
    signals["y"][20] = 1e300
    exact = machine(step, "float")
    with np.errstate(over="ignore"):
        wanted = exact.record(*(signals[key].astype(np.float32) for key in "uy"))
    for engine in ENGINES:
        step.reset()
        run = step.run(**signals, engine=engine)
        for mine, other in zip((run.x, np.array([*run.traces.values()]).T, run.status), wanted, strict=True):
            assert np.array_equal(mine.ravel(), other.ravel())
    step.reset()
    assert step(signals["u"][0], signals["y"][0]).x.tolist() == wanted[0][0].tolist()
    other = pickle.loads(pickle.dumps(step))
    assert other(signals["u"][1], signals["y"][1]).x.tolist() == wanted[0][1].tolist()
    assert len(step.save()) == layout.state_type(step, "float").itemsize + ADDED < len(built(name).save())


@needs_compiler
def test_both_engines_leave_the_same_bytes() -> None:
    """A plant without elementary functions: the same operations in the same order."""
    step = fresh("no_input")
    samples, saved = record(step), {}
    for engine in ENGINES:
        step.reset()
        step.run(**samples, engine=engine)
        saved[engine] = step.save()
    assert saved["c"] == saved["python"]


def test_a_state_of_another_step_is_refused() -> None:
    step = fresh("staggered")
    for wrong in (b"", step.save()[:-1], step.save() + b"\0", fresh("no_input").save()):
        with pytest.raises(NotSaved, match=rf"saved state of {len(wrong)} bytes is not of this step"):
            step.restore(wrong)
    for stranger in (None, "state", 7, [0.0]):
        with pytest.raises(BadShape, match=rf"that is a {type(stranger).__name__} is no bytes; give what save"):
            step.restore(stranger)  # type: ignore[arg-type]


def test_times_begin_anew_after_a_restored_state() -> None:
    step = fresh("no_input")
    samples, saved = record(step), step.save()
    step.run(**samples, engine="python")
    step.restore(memoryview(saved))
    assert step.save() == saved
    assert step.run(**samples, engine="python").t[0] == 0


def test_tuned_gains_hold_in_c() -> None:
    step = BUILD["held"]()
    samples = record(step)
    before = step.run(**samples).x
    for engine in ENGINES:
        step.reset()
        step.tune(R=10.0)
        after = step.run(**samples, engine=engine).x
        assert np.abs(after - before).max() > 0.01
    other = hg.sample(kalman(scalar_plant(), R=10.0), dt=0.01, between="hold")
    assert after == pytest.approx(other.run(**samples, engine="python").x, abs=1e-15)


def test_an_empty_record() -> None:
    step = fresh("staggered")
    for engine in ENGINES:
        run = step.run(u=[], y=[], engine=engine)
        assert run.x.shape == (0, 3)
        assert run.traces["theta"].shape == (0,)


# --- sections -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["staggered", "window", "decaying", "two_outputs", "no_input"])
def test_sections_one_after_the_other_are_one_call(name: str) -> None:
    step, other = fresh(name), BUILD[name]()
    samples = record(step, 120)
    for u, y in zip(samples["u"], samples["y"], strict=True):
        whole = step(u=u, y=y)
        status = other.predict(u=u).status
        status |= other.update(**dict(zip((s.name for s in other.outputs), y, strict=True))).status
        last = other.adapt()
        assert np.array_equal(last.x, whole.x)
        assert (last.traces, status | last.status) == (whole.traces, whole.status)
    assert other.save() == step.save()


def test_an_output_without_a_sample_is_left_out() -> None:
    """Predict and update with one of two sensors is a call in which the other is missing."""
    step, other = fresh("two_outputs"), BUILD["two_outputs"]()
    for k in range(20):
        whole = step(u=0.1, y=(0.5, NAN if k % 3 else 0.2))
        other.predict(u=0.1)
        partial = other.update(y1=0.5) if k % 3 else other.update(y1=0.5, y2=0.2)
        assert np.array_equal(partial.x, whole.x)
    with pytest.raises(BadShape, match=r"update\(y3=\) names no output; the outputs are y1, y2"):
        other.update(y3=0.0)


@pytest.mark.parametrize("name", ["high_gain", "information"])
def test_what_integrates_with_the_measurement_cannot_be_taken_apart(name: str) -> None:
    step = fresh(name)
    for section in (step.predict, step.update, step.adapt):
        with pytest.raises(CannotUpdate, match=r"integrates with the measurement.*call the step, or use"):
            section()


# --- samples that are missing, late or absurd ---------------------------------------------------------------


@pytest.mark.parametrize("name", STEPS)
def test_a_missing_sample_predicts_and_says_so(name: str) -> None:
    """An implausible sample is worth as much as none."""
    step = fresh(name)
    samples = record(step, 30)
    step.run(**samples, engine="python")
    state = step.save()
    u, missing = samples["u"][-1], np.full(len(step.outputs), NAN)
    sample = step(u=u, y=missing)
    assert sample.flags[: len(step.outputs)] == tuple(f"MISSING_{s.name.upper()}" for s in step.outputs)
    assert np.isfinite(sample.x).all()
    step.restore(state)
    implausible = step(u=u, y=np.full(len(step.outputs), 1e30))
    assert implausible.flags[: len(step.outputs)] == tuple(f"REJECTED_{s.name.upper()}" for s in step.outputs)
    assert np.array_equal(implausible.x, sample.x)


def runge_kutta(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float) -> np.ndarray:
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))


def neuron(x: np.ndarray) -> np.ndarray:
    """FitzHugh-Nagumo at u = 1/2."""
    return np.array([x[0] - x[0] ** 3 / 3 - 0.5 * x[1], 0.8 * (3 * np.sin(x[0]) - x[1] - x[2]), 0])


@pytest.mark.parametrize(
    ("name", "flow"),
    [
        ("held", lambda x: -(x**3) + 0.5),
        ("high_gain", lambda x: np.array([x[1], -19.6 * np.sin(x[0]) - 0.1 * x[1] + 0.5])),
        (
            "information",
            lambda x: np.array([x[0] - x[0] ** 3 / 3 - 0.5 * x[1], 0.8 * (3 * np.sin(x[0]) - x[1] - x[2]), 0]),
        ),
    ],
)
def test_a_prediction_is_the_models(name: str, flow: Callable[[np.ndarray], np.ndarray]) -> None:
    """One classical Runge-Kutta step without correction."""
    step = fresh(name)
    step(u=0.5, y=1.0)
    before = step(u=0.5, y=1.0).x
    after = step(u=0.5, y=NAN)
    assert after.flags == (f"MISSING_{step.outputs[0].name.upper()}",)
    assert after.x == pytest.approx(runge_kutta(flow, before, 0.01), rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("bad", [NAN, INF, -INF, 1e30, -1e30])
def test_a_lost_input_is_the_last_valid_one(bad: float) -> None:
    step, other = fresh("held"), BUILD["held"]()
    for k, u in enumerate((0.3, 0.4, bad, bad, 0.2)):
        lost = not abs(u) <= 1
        sample = step(u=u, y=0.1 * k)
        assert np.array_equal(sample.x, other(u=0.4 if lost else u, y=0.1 * k).x)
        assert sample.flags == (("REUSED_U",) if lost else ())


def test_an_input_that_is_lost_at_first_is_the_resting_one() -> None:
    step, other = fresh("held"), BUILD["held"]()
    for _ in range(3):
        assert np.array_equal(step(u=NAN, y=0.5).x, other(u=0.0, y=0.5).x)


def test_an_input_out_of_range_is_clamped() -> None:
    step, other = fresh("held"), BUILD["held"]()
    for _ in range(3):
        sample = step(u=7.0, y=0.5)
        assert sample.flags == ("CLAMPED_U",)
        assert np.array_equal(sample.x, other(u=1.0, y=0.5).x)


def finite(step: Any) -> bool:
    passing = ("input", "output", "work")
    memory = step._kept.places.items()
    return all(np.isfinite(array).all() for place, array in memory if place.struct not in passing)


numbers = st.one_of(
    st.sampled_from([NAN, INF, -INF, 1e30, -1e30, 1.7e308, 1e15, -1e14, 5e-324, -0.0]), st.floats(width=64)
)


@pytest.mark.parametrize("name", STEPS)
@given(data=st.data())
@settings(deadline=None, max_examples=12)
def test_nothing_absurd_reaches_the_state(name: str, data: st.DataObject) -> None:
    """And the first estimate is finite too, whatever came."""
    step = fresh(name)
    m, p = len(step.inputs), len(step.outputs)
    rows = data.draw(st.lists(st.lists(numbers, min_size=m + p, max_size=m + p), min_size=1, max_size=12))
    for row in rows:
        sample = step(u=row[:m], y=row[m:])
        assert np.isfinite(sample.x).all()
        assert finite(step)


@pytest.mark.ordinary("staggered-c", "window-c", "information-c", "high_gain-c", "held-c", "held-python", "no_input-c")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["staggered", "window", "information", "high_gain", "held", "no_input"])
def test_the_estimate_recovers(name: str, engine: str) -> None:
    """Ten seconds of nonsense, then a record that the undisturbed step had, too: both end at the same estimate."""
    step, other = fresh(name), BUILD[name]()
    absurd = np.resize([NAN, INF, -INF, 1e30, -1e30, 1e300, 1e6, -4.0], 1000)
    samples = record(step, 5000)
    step.run(u=np.tile(absurd[::-1, None], len(step.inputs)), y=absurd[:, None], engine=engine)
    assert finite(step)
    disturbed, calm = step.run(**samples, engine=engine), other.run(**samples, engine=engine)
    away = np.abs(disturbed.x - calm.x).max(axis=1)
    assert away[0] > 0.05
    assert away[-1] < 0.05 * away[0]


# --- shapes -------------------------------------------------------------------------------------------------


def test_a_sample_has_names_and_a_text() -> None:
    sample = fresh("staggered")(u=0.1, y=0.5)
    assert sample.names == ("x1", "x2", "eta")
    assert sample["x1"] == sample.x[0]
    assert sample.flags == ()
    assert set(sample.traces) == {"theta", "innovation"}
    assert str(sample).startswith("x1 = 0.")
    assert str(sample).endswith("theta = 1, innovation = 0 (ok)")
    with pytest.raises(BadShape, match=r"'x9' names no state; the states are x1, x2, eta"):
        sample["x9"]
    run = fresh("staggered").run(u=[0.1], y=[0.5])
    assert np.array_equal(run["eta"], run.x[:, 2])
    with pytest.raises(BadShape, match=r"'x9' names no state"):
        run["x9"]


def test_one_value_or_an_array_of_one() -> None:
    estimates = [
        fresh("staggered")(u=u, y=y).x for u, y in ((0.1, 0.5), ([0.1], (0.5,)), (np.float32(0.1), np.array(0.5)))
    ]
    assert np.array_equal(estimates[0], estimates[1])
    assert estimates[2] == pytest.approx(estimates[0], abs=1e-7)


@pytest.mark.parametrize(
    ("name", "sample", "said"),
    [
        ("staggered", {"u": 0.1}, r"y is missing; give y=, the values of y$"),
        ("staggered", {"y": 0.1}, r"u is missing; give u=, the values of u$"),
        ("staggered", {"u": (0.1, 0.2), "y": 0.5}, r"u of shape \(2,\) must have 1 element$"),
        ("two_outputs", {"u": 0.1, "y": 0.5}, r"y of shape \(\) must have 2 elements: y1, y2$"),
        ("no_input", {"u": 0.1, "y": 0.5}, r"u of shape \(\) must have 0 elements$"),
        ("staggered", {"u": "x", "y": 0.5}, r"u = 'x' is not an array of numbers$"),
        ("staggered", {"u": "0.1", "y": 0.5}, r"u = '0.1' is not an array of numbers$"),
        ("two_outputs", {"u": 0.1, "y": (0.5, "1")}, r"y = \(0.5, '1'\) is not an array of numbers$"),
        ("staggered", {"u": 0.1, "y": np.datetime64(5, "s")}, r"y = .*datetime64.* is not an array of numbers$"),
        ("staggered", {"u": 0.1, "y": 1j}, r"y = 1j is not an array of numbers$"),
    ],
)
def test_a_sample_of_the_wrong_shape_is_refused(name: str, sample: dict[str, Any], said: str) -> None:
    step = fresh(name)
    with pytest.raises(BadShape, match=f"^{said}"):
        step(**sample)
    assert step.save() == BUILD[name]().save()


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("staggered", {"u": [0, 0], "y": [0]}, r"u of shape \(2,\) must have shape \(1, 1\) or \(1,\)$"),
        ("staggered", {"u": [0], "y": [[0, 0]]}, r"y of shape \(1, 2\) must have shape \(N, 1\) or \(N,\)$"),
        ("staggered", {"u": 0.0, "y": 0.0}, r"y of shape \(\) must have shape \(N, 1\) or \(N,\)$"),
        ("staggered", {"y": [0.0]}, r"u is missing; give u=, the values of u$"),
        ("staggered", {"u": [0.0]}, r"y is missing; give y=, the values of y$"),
        ("two_outputs", {"u": [0], "y": [0]}, r"y of shape \(1,\) must have shape \(N, 2\): y1, y2$"),
        ("staggered", {"u": ["a"], "y": [0]}, r"u is not an array of numbers$"),
        ("staggered", {"u": ["0.5"], "y": [0]}, r"u is not an array of numbers$"),
        ("staggered", {"u": np.array(["0.5", None], object), "y": [0, 0]}, r"u is not an array of numbers$"),
        ("staggered", {"u": [0], "y": np.array([0j])}, r"y is not an array of numbers$"),
        ("staggered", {"u": [0], "y": [0], "engine": "fortran"}, r"engine = 'fortran' must be"),
    ],
)
def test_a_record_of_the_wrong_shape_is_refused(name: str, data: dict[str, Any], said: str) -> None:
    step = fresh(name)
    with pytest.raises(BadShape, match=f"^{said}"):
        step.run(**data)
    assert step.save() == BUILD[name]().save()
    assert step.run(u=np.zeros((1, 1)), y=np.zeros((1, len(step.outputs))), engine="python").t[0] == 0


def test_records_without_inputs() -> None:
    step, estimates = fresh("no_input"), []
    for u in ((), [], np.zeros((5, 0)), {}, None):
        step.reset()
        estimates.append(step.run(**({} if u is None else {"u": u}), y=np.ones(5), engine="python").x)
    assert all(np.array_equal(x, estimates[0]) for x in estimates)
    assert step(y=1.0).names == ("x1", "x2")
    with pytest.raises(BadNames, match=r"^u names 'w', but there are no names to give$"):
        step.run(u={"w": np.ones(5)}, y=np.ones(5))


def test_tuning_names_what_can_be_tuned() -> None:
    step = BUILD["staggered"]()
    with pytest.raises(BadShape, match=r"tune\(gamma=\) names nothing tunable; that is .*theta_1.*gamma_0, gamma_1"):
        step.tune(gamma=1.0)
    with pytest.raises(BadShape, match=r"Q of shape \(2,\) must have 3 elements"):
        step.tune(Q=(1, 2))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (lambda: (pendulum(), 0.01), r"method = 0\.01 is no method; take one of hg\.methods, and the time as dt="),
        (lambda: (pendulum(), "rk4"), r"method = 'rk4' is no method"),
        (lambda: (hg.forms.triangular(van_der_pol()),), "Form given to sample is no observer"),
    ],
)
def test_sample_wants_an_observer_and_a_method(arguments: Callable[[], tuple[Any, ...]], said: str) -> None:
    with pytest.raises(BadStep, match=f"^{said}"):
        hg.sample(*arguments())


# --- no compiler --------------------------------------------------------------------------------------------


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_python_runs_and_says_so() -> None:
    step = BUILD["held"]()
    samples = record(step, 20)
    with pytest.warns(NoCompilerWarning, match="The step runs in Python, since there is no C compiler"):
        run = step.run(**samples)
    assert run.engine == "python"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = fresh("held").run(**samples, engine="python")
    same(run, again)


@pytest.mark.usefixtures("no_compiler")
def test_c_without_a_compiler_is_refused() -> None:
    step = BUILD["held"]()
    before = step.save()
    with pytest.raises(NoCompiler, match=r"no C compiler .* install one, or say engine='python'"):
        step.run(**record(step, 20), engine="c")
    assert step.save() == before
    assert step.run(**record(step, 20), engine="python").t[0] == 0


def test_a_broken_compiler_leaves_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\necho no licence >&2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    step = BUILD["held"]()
    with pytest.raises(CompilerFailed, match=r"no licence\nmend it, .* or say engine='python'"):
        step.run(**record(step, 5))
    assert step.run(**record(step, 5), engine="python").engine == "python"


@pytest.mark.parametrize(
    ("output", "flow", "initial", "warned"),
    [
        (sp.sqrt(X**2 + V**2), (V, -V), {}, True),  # a range, from where it is 0
        (sp.cos(X), (V, -V), {}, True),
        (X, (V, -V), {}, False),
        (sp.cos(X), (V, -V), {"x": 1}, False),
        (sp.cos(X), (V, 1 - V), {}, False),  # it moves away
    ],
)
def test_a_start_that_no_sample_corrects_is_named(
    output: sp.Expr, flow: tuple[sp.Expr, ...], initial: dict[str, float], warned: bool
) -> None:
    plant = hg.System("stuck", states=(X, V), outputs=(hg.Signal("y"),), flow=flow, output=[output])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1e-3, 1e-3], noise={"y": 0.1}, initial=initial)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        step = hg.sample(observer, dt=0.1)
    texts = [str(one.message) for one in seen if one.category is StartsUncorrected]
    assert bool(texts) is warned
    assert all("starts at x = 0, v = 0" in text for text in texts)
    assert bool((step.run(y=np.full(50, 0.5)).x[-1] == 0).all()) is warned
