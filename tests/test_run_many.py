"""Many records at once give the bits of one after the other, whatever the records hold."""

from functools import cache

import emitted
import numpy as np
import plants
import pytest

import hgogen as hg
from hgogen.emit import lanewriter
from hgogen.emit.saved import NotSaved
from hgogen.emit.syntax import Real
from hgogen.model import load
from hgogen.program import Place
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.run.backends import Batch
from hgogen.run.samples import BadShape, Engine, Run

COUNT, SAMPLES = 21, 1200  # of no register's width
STEPS = sorted({path.stem for path in plants.MODELS.glob("*.py")} | set(emitted.STEPS))
WORST = (np.nan, np.inf, -np.inf, 1e30, -1e30, 3.2e38, -0.0, 1e-300)
lanes = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


# a program of each kind; to compile all takes a minute
QUICK = {(name, "double") for name in ("bank", "delayed", "many_states", "pendulum", "tables", "window_held")}
QUICK |= {("fitzhugh_nagumo", "float"), ("sin", "float")}


@cache
def step(name: str, real: Real = "double") -> hg.Step:
    made = emitted.step(name) if name in emitted.STEPS else load(plants.MODELS / f"{name}.py").step()
    return made.rebuilt(real=real)


@cache
def started(real: Real, x1: float) -> bytes:
    """The state of a step that starts from an estimate."""
    return step("fitzhugh_nagumo", real).started(lambda _: {"x1": x1, "eta": 0.25}).save()


def signals(made: hg.Step, count: int = COUNT, samples: int = SAMPLES) -> tuple[np.ndarray, np.ndarray]:
    """Records u (B, N, m), y (B, N, p) of walks in the declared ranges; some jump and stay away, some have gaps, the
    worst numbers or both."""
    draw, arrays = np.random.default_rng(5), []
    for group in (made.inputs, made.samples):
        ends = np.array([_range(signal) for signal in group]).reshape(-1, 2)
        walk = np.cumsum(draw.normal(size=(count, samples, len(group))), axis=1) / 30
        middle, half = ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2
        away = np.where(draw.random((count, 1, len(group))) < 0.4, 0.9, 0.0)
        walk = np.sin(walk) * 0.3 + away * (np.arange(samples) > samples // 4)[:, None]
        values = middle + half * walk
        values = np.where(draw.random(values.shape) < 0.02 * (np.arange(count) % 3)[:, None, None], np.nan, values)
        bad = draw.random(values.shape) < 0.05 * (np.arange(count) % 2)[:, None, None]
        arrays.append(np.where(bad, draw.choice(WORST, size=values.shape), values))
    for j, _ in enumerate(made.ages, len(made.outputs)):
        arrays[1][..., j] = np.where(np.isnan(arrays[1][..., j]), np.nan, draw.integers(0, 5, (count, samples)))
    return arrays[0], arrays[1]


def _range(signal: hg.Signal) -> tuple[float, float]:
    low, high = signal.interval
    return max(low, -10.0), min(high, 10.0)


def is_run(many: Batch, k: int, alone: Run) -> bool:
    """Whether record k of many is this one, bit for bit."""
    pairs = [(many.x[k], alone.x), (many.status[k], alone.status)]
    pairs += [(values[k], alone.traces[name]) for name, values in many.traces.items()]
    return all(one.tobytes() == other.tobytes() for one, other in pairs)


@pytest.mark.ordinary("bank-double", "many_states-double", "pendulum-double", "sin-float", "window_held-double")
@lanes
@pytest.mark.parametrize(
    ("name", "real"),
    [
        pytest.param(name, real, marks=() if (name, real) in QUICK else pytest.mark.slow, id=f"{name}-{real}")
        for name in STEPS
        for real in ("float", "double")
    ],
)
def test_lanes_have_the_bits_of_the_scalar_step(name: str, real: Real) -> None:
    made = step(name, real)
    u, y = signals(made)
    made.reset()
    many = made.run_many(u, y, jobs=1, traces=True, **emitted.elapsed(made))
    assert (many.engine, many.names) == ("lanes", tuple(state.name for state in made.states))
    assert many.status.any()
    for k in range(COUNT):
        made.reset()
        assert is_run(many, k, made.run(u[k], y[k], "c", **emitted.elapsed(made))), k


@pytest.mark.ordinary("bank", "window_held")
@lanes
@pytest.mark.parametrize(
    "name", ["bank", "delayed", "fitzhugh_nagumo", "integrated", "many_states", "two_injections", "window_held"]
)
def test_lanes_that_are_at_other_samples_go_their_own_way(name: str) -> None:
    """Each goes on from where another number of samples left it, so that rings and members stand apart."""
    made = step(name)
    u, y = signals(made)
    states = list[bytes]()
    for k in range(COUNT):
        made.reset()
        made.run(u[-k, : 7 * k], y[-k, : 7 * k], "c")
        states.append(made.save())
    many, short = made.run_many(u, y, starts=states, traces=True), made.run_many(u[:, :25], y[:, :25], starts=states)
    for k in range(COUNT):
        made.restore(states[k])
        assert is_run(short, k, made.run(u[k, :25], y[k, :25], "c")), k
        assert made.save() == short.states[k]
        made.restore(states[k])
        assert is_run(many, k, made.run(u[k], y[k], "c")), k
    rest = made.run_many(u[:, 25:], y[:, 25:], starts=short.states)
    assert (rest.x.tobytes(), rest.states) == (many.x[:, 25:].tobytes(), many.states)


@lanes
def test_a_member_is_copied_in_the_lanes_that_are_due_alone() -> None:
    """Of a bank whose members differ, and of which one is selected that is not the next to restart."""
    made = step("bank")
    u, y = signals(made)
    states = list[bytes]()
    for k in range(COUNT):
        made.reset()
        made.run(u[k, :k], y[k, :k], "c")
        made._kept.places[Place("state", "selected")][0] = k % 3
        made._kept.places[Place("member", "z")][:] += 0.01 * np.arange(3)[:, None]
        states.append(made.save())
    many = made.run_many(u[:, :5], y[:, :5], starts=states)
    for k in range(COUNT):
        made.restore(states[k])
        assert is_run(many, k, made.run(u[k, :5], y[k, :5], "c")), k
        assert made.save() == many.states[k]


@lanes
def test_threads_chunks_and_lanes_without_a_record_change_no_byte() -> None:
    """150 records are three chunks, of which the last is no whole number of registers; one record is less than one."""
    made = step("fitzhugh_nagumo")
    u, y = signals(made, 150, 100)
    made.reset()
    one, two = (made.run_many(u, y, jobs=jobs) for jobs in (1, 2))
    assert (one.x.tobytes(), one.status.tobytes()) == (two.x.tobytes(), two.status.tobytes())
    for k in (0, 63, 64, 149):
        alone = made.run_many(u[k : k + 1], y[k : k + 1])
        assert (alone.x.tobytes(), alone.status.tobytes()) == (one.x[k].tobytes(), one.status[k].tobytes())
        assert alone.x.shape == (1, 100, 3)


@pytest.mark.ordinary("float-c", "double-python", "double-c")
@pytest.mark.parametrize("engine", ["python", pytest.param("c", marks=lanes)])
@pytest.mark.parametrize("real", ["float", "double"])
def test_records_differ_by_parameters_and_starts(engine: Engine, real: Real) -> None:
    """Numbers beyond their range are limited as `tune` limits them; what is one number is that of all records."""
    made = step("fitzhugh_nagumo", real)
    u, y = signals(made, 4, 30)
    Q, starts = np.array([[1, 2, 3], [4, 5, 6], [0.1, 0.2, 0.3], [1e9, 1, 1]]), [0.5, -1.0, 0.5, 2.0]
    made.reset()
    wanted = {"Q": Q, "R": 0.3, "theta_1": [1.5, 2, 3, 4]}
    many = made.run_many(u[0], y, parameters=wanted, starts={"x1": starts, "eta": 0.25}, engine=engine)
    assert many.engine == ("lanes" if engine == "c" else "python")
    before = made.tuned
    for k in range(4):
        assert many.tuned[k] == made.tune(Q=Q[k], R=0.3, theta_1=wanted["theta_1"][k])
        made.restore(started(real, starts[k]))
        assert is_run(many, k, made.run(u[0], y[k], engine)), k
        assert made.save() == many.states[k]
    assert [made.flags(status) for status in many.tuned] == [(), (), (), ("PARAMETER_LIMITED",)]
    made.tune(**before)


@lanes
def test_records_go_on_from_the_present_state_which_stays() -> None:
    """The state has counters: the oldest of the samples in a window, and how many there are."""
    made = step("window_held")
    u, y = signals(made, 3, 60)
    made.reset()
    made.run(u[0], y[0])
    saved = made.save()
    many = made.run_many(u, y)
    assert made.save() == saved
    for k in range(3):
        made.restore(saved)
        assert is_run(many, k, made.run(u[k], y[k]))
    states = [saved, made.save(), saved]
    many = made.run_many(u, y, starts=states)
    for k in range(3):
        made.restore(states[k])
        assert is_run(many, k, made.run(u[k], y[k]))


@lanes
def test_signals_are_given_as_run_takes_them_where_all_records_have_the_same() -> None:
    made = step("pendulum")
    u, y = signals(made, 2, 40)
    made.reset()
    named = {signal.name: y[0][:, j] for j, signal in enumerate(made.outputs)}
    many = made.run_many(u[0][:, 0], named, parameters={"theta": [2.0, 3.0]})
    assert many.x.shape == (2, 40, 2)
    assert not np.array_equal(many.x[0], many.x[1])
    assert made.run_many(u[0], y[0]).x.shape == (1, 40, 2)
    assert made.run_many(u[0], y, traces=False).traces == {}


@lanes
def test_a_callback_is_told_how_many_are_done() -> None:
    made = step("pendulum")
    u, y = signals(made, 130, 5)
    calls: list[tuple[int, int]] = []
    made.run_many(u, y, jobs=2, each=lambda *counts: calls.append(counts))
    assert calls == [(64, 130), (128, 130), (130, 130)]


@pytest.mark.full
@lanes
@pytest.mark.parametrize("real", ["float", "double"])
def test_narrower_registers_have_the_same_bits(real: Real, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that any machine of this kind has; what was compiled for this one is not taken for them."""
    made = step("fitzhugh_nagumo", real)
    u, y = signals(made, 5, 200)
    made.run_many(u[:1], y[:1])
    wide = "__AVX__" in native._macros((native.compiler(),), native.machine_flags())
    assert (made._many.lanes.width > {"double": 2, "float": 4}[real]) == wide
    made = made.rebuilt()
    monkeypatch.setattr(native, "machine_flags", tuple)
    many = made.run_many(u, y)
    assert many.engine == "lanes"
    assert made._many.lanes.width == {"double": 2, "float": 4}[real]
    for k in range(5):
        made.reset()
        assert is_run(many, k, made.run(u[k], y[k])), k


@lanes
def test_a_compiler_without_vectors_runs_one_by_one_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    made = step("pendulum").rebuilt()
    u, y = signals(made, 3, 50)
    monkeypatch.setattr(native, "machine_flags", lambda: ("-Dvector_size=no_such_attribute_of", "-Werror"))
    many = made.run_many(u, y)
    assert many.engine == "c"
    for k in range(3):
        made.reset()
        assert is_run(many, k, made.run(u[k], y[k]))


@pytest.mark.full
@lanes
def test_a_step_with_a_kernel_that_has_no_lanes_runs_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    made = step("many_states").rebuilt()
    monkeypatch.setattr(lanewriter, "TOGETHER", lanewriter.TOGETHER - {"cap"})
    assert made.run_many(*signals(made, 2, 5)).engine == "c"
    with pytest.raises(lanewriter.NoLanes, match="the kernel cap goes another way in each lane"):
        hg.targets.lanes(made)


def test_without_a_compiler_it_is_python(monkeypatch: pytest.MonkeyPatch) -> None:
    made = step("pendulum").rebuilt()
    u, y = signals(made, 2, 5)
    monkeypatch.setattr(native, "compiler", lambda: None)
    with pytest.warns(native.NoCompilerWarning):
        assert made.run_many(u, y).engine == "python"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"y": np.zeros((3, 5, 2))}, r"y of shape \(3, 5, 2\) must have shape \(B, N, 1\)"),
        ({"u": np.zeros((3, 4, 1))}, r"u of shape \(3, 4, 1\) must have shape \(B, 5, 1\)"),
        ({"u": np.zeros((2, 5, 1))}, r"different numbers of records \(u 2, y 3\) must be one for all"),
        ({"parameters": {"theta": [1.0, 2.0]}}, r"different numbers of records \(u 3, y 3, theta 2\)"),
        ({"parameters": {"no": 1.0}}, "parameters 'no' names nothing tunable; that is"),
        ({"parameters": {"theta": "x"}}, "theta is not an array of numbers"),
        ({"parameters": {"theta": [[1.0]] * 3}}, r"theta of shape \(3, 1\) must be a number, or one for each record"),
        ({"starts": {"q": [0.0, 1.0]}}, r"different numbers of records \(u 3, y 3, starts q 2\)"),
        ({"starts": [b""] * 3}, "a saved state of 0 bytes is not of this step"),
        ({"starts": [1, 2, 3]}, "a saved state that is a int is no bytes"),
        ({"engine": "no"}, 'engine = \'no\' must be "c", "python" or None'),
    ],
)
def test_what_does_not_fit_is_refused(asked: dict[str, object], said: str) -> None:
    words = {"u": np.zeros((3, 5, 1)), "y": np.zeros((3, 5, 1)), "engine": "python"} | asked
    with pytest.raises((BadShape, NotSaved), match=said):
        step("pendulum").run_many(**words)


def test_a_bad_start_and_bad_jobs_are_refused() -> None:
    made, signals = step("pendulum"), {"u": np.zeros(5), "y": np.zeros(5), "engine": "python"}
    with pytest.raises(BadGain, match="jobs = 0 must be a whole number"):
        made.run_many(**signals, jobs=0)
    with pytest.raises(hg.HgogenError, match="nobody"):
        made.run_many(**signals, starts={"nobody": 1.0})
