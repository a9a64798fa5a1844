"""A step without guards: the same mathematics, and nothing else."""

import pickle
from functools import cache
from pathlib import Path

import casadi as ca
import emitted
import numpy as np
import plants
import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.emit import pystep
from hgogen.estimators.core import nominal, numbers
from hgogen.model import load
from hgogen.program import Place, places, sym
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.run.metrics import metrics
from hgogen.run.prediction import rejected
from hgogen.step import BadStep
from hgogen.trial import try_out

NAMES = (
    *("cascaded_tanks", "exponential", "fitzhugh_nagumo", "integrated", "many_states", "no_input", "pendulum"),
    *("tables", "tunable", "two", "window_held"),
)
SAMPLES = 150


def both(name: str) -> tuple[CallableStep, CallableStep]:
    """The step with its guards and without, read as Python, as after a reset."""
    for step in (steps := _both(name)):
        step.reset()
    return steps


@cache
def _both(name: str) -> tuple[CallableStep, CallableStep]:
    made = emitted.step(name)

    def sampled(guards: str) -> CallableStep:
        step: CallableStep = hg.sample(
            made.observer, made.method, made.dt, between=made.clock.between, guards=guards, engine="python"
        )
        return step

    return sampled("all"), sampled("none")


def record(step: CallableStep) -> tuple[np.ndarray, np.ndarray]:
    """Inputs that move a little in the middle of their ranges, and outputs about what the estimate rests at."""
    wave = np.sin(np.arange(SAMPLES) / 9)[:, None]
    middle = [sum(s.interval) / 2 if s.bounded else 0.0 for s in step.inputs]
    width = [s.interval[1] - s.interval[0] if s.bounded else 1.0 for s in step.inputs]
    observer, u = step.observer, sym("state", "u", len(middle))
    values = nominal(observer) | {Place("state", field.name): np.array(field.initial) for field in step.layout.state}
    values[Place("state", "u")] = np.array(middle)
    rest = numbers(observer.dynamics.output(observer.z, u), values).ravel()
    return middle + 0.02 * wave * width, rest + 0.01 * wave


@pytest.mark.ordinary("pendulum", "tunable", "two")
@pytest.mark.parametrize("name", NAMES)
def test_while_no_guard_acts_it_has_the_same_bits(name: str) -> None:
    """Of a sine that is of a bounded angle where the model clamps it, another rounding."""
    guarded, plain = both(name)
    u, y = record(guarded)
    known, run = guarded.run(u, y), plain.run(u, y)
    quiet = int(np.argmax(np.append(known.status, 1) != 0))
    assert quiet > 20
    assert np.allclose(known.x[:quiet], run.x[:quiet], rtol=1e-12, atol=1e-13)
    assert not run.status.any()


@pytest.mark.ordinary("pendulum", "tunable", "two")
@pytest.mark.parametrize("name", NAMES)
def test_it_says_nothing_and_asks_nothing(name: str) -> None:
    _, plain = both(name)
    programs = (*plain.code.tuning, *(s for section in plain.code.called for s in section.program))
    assert plain.layout.bits == ()
    assert "status" not in {place.struct for place, _ in places(programs)}
    assert all(low == -np.inf and high == np.inf for field in plain.layout.state for low, high in field.box)
    assert plain.observer.checks == plain.observer.form.checks


TUNED = load(plants.MODELS / "bioreactor.py")


@pytest.mark.ordinary("cascade")
@pytest.mark.parametrize("tuning", [name for name in TUNED.tuning.tables if name != "bank"])
def test_each_observer_reads_only_what_is_remembered_without_guards(tuning: str) -> None:
    """The validity of a sample is a constant then, and no field of the state. A bank demands guards."""
    made = TUNED.step(tuning)
    plain = hg.sample(made.observer, made.method, made.dt, guards="none")
    read = {place for section in plain.code.called for place, _ in places(section.program) if place.struct == "state"}
    assert read <= {Place("state", field.name) for field in plain.layout.state}


def test_what_a_part_has_to_say_is_not_said() -> None:
    """The Kalman-like observer tells by its covariance whether its theorem holds."""
    observer = hg.observers.kalman_like(hg.forms.state_affine(plants.chain(2)), rho=1.0, R=1.0)
    assert "COVARIANCE_LIMITED" in {bit.name for bit in hg.sample(observer, dt=0.01).layout.bits}
    plain = hg.sample(observer, dt=0.01, guards="none")
    assert plain.layout.bits == ()
    assert not plain.run([[0.1]] * 9, [[5.0]] * 9).status.any()


@pytest.mark.ordinary("double-pendulum")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "many_states"])
@pytest.mark.parametrize("real", ["float", "double"])
def test_c_and_rust_have_the_bits_of_python(name: str, real: str) -> None:
    _, plain = both(name)
    if native.compiler() is None:
        pytest.skip("no C compiler")
    files = hg.targets.c99(plain, real=real)
    assert "samples as recorded" in native.run_check(files, ("-O2", f"-D{plain.name.upper()}_EXACT"))
    header, manual = files[f"{plain.name}.h"], emitted.manual(files)
    assert "This step has no guards." in manual
    assert "Guards: none" in header
    assert "convergence" not in header
    assert ".  To start" not in manual  # no sentence on a mark stands before it
    try:
        assert "samples as recorded" in native.run_recipe(hg.targets.rust(plain, real=real))
    except native.NoTool as error:
        pytest.skip(str(error))


@pytest.mark.full
@pytest.mark.parametrize("real", ["float", "double"])
def test_a_self_check_ends_where_the_estimate_is_lost(real: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing holds the temperature, exp(8750/T) leaves every precision at a T below 0 or near it."""
    monkeypatch.setattr(pystep, "_motion", lambda _, u: ([0], np.full((len(u), 1), -9.0)))  # K
    guarded = load(plants.MODELS / "cstr.toml").step("riccati")
    plain = hg.sample(guarded.observer, guarded.method, guarded.dt, guards="none", engine="python")
    count = len(pystep.record_vectors(plain, real).status)
    assert 1 <= count < pystep.SAMPLES
    if native.compiler() is None:
        pytest.skip("no C compiler")
    checked = native.run_check(hg.targets.c99(plain, real=real), ("-O2", f"-D{plain.name.upper()}_EXACT"))
    assert checked == f"{plain.name}: {count} samples as recorded\n"
    try:
        assert f"{count} samples as recorded" in native.run_recipe(hg.targets.rust(plain, real=real))
    except native.NoTool as error:
        pytest.skip(str(error))


def test_the_function_of_casadi_has_its_values() -> None:
    _, plain = both("pendulum")
    functions = hg.targets.casadi(plain)
    u, y = record(plain)
    memory, x = functions.memory.initial, []
    for now, read in zip(u, y, strict=True):
        memory, estimate, status = functions.step(memory, now, read, functions.p.initial)
        x.append(np.array(estimate).ravel())
        assert float(status) == 0
    assert np.allclose(plain.run(u, y).x, x, rtol=1e-12, atol=1e-13)


def test_what_is_not_a_number_spoils_the_estimate_until_a_reset() -> None:
    _, plain = both("fitzhugh_nagumo")
    plain.reset()
    assert np.isfinite(plain(0.0, 0.1).x).all()
    assert np.isfinite(plain(0.0, 0.1).x).all()
    plain(0.0, np.nan)
    spoiled = [plain(0.0, 0.1) for _ in range(5)]
    assert all(not np.isfinite(sample.x).any() and sample.status == 0 for sample in spoiled)
    plain.reset()
    assert np.isfinite(plain(0.0, 0.1).x).all()


def test_beyond_its_ranges_the_model_is_as_it_is_written() -> None:
    """The pendulum's angle at 6 rad, where the guarded step has the sine of 4, and its rate beyond 20."""
    guarded, plain = both("pendulum")
    form = plain.observer.form
    z = np.array([6.0, 25.0])
    rates = [
        ca.DM(ca.SX(step.observer.dynamics.flow(ca.SX(z), ca.SX(1, 1)))).full().ravel() for step in (plain, guarded)
    ]
    assert not form.clamped
    assert rates[0] == pytest.approx([25.0, -19.6 * np.sin(6.0) - 2.5], rel=1e-14)
    assert rates[1] == pytest.approx([25.0, -19.6 * np.sin(4.0) - 2.0], rel=1e-14)


def test_a_trial_counts_estimates_out_of_their_ranges_without_a_status() -> None:
    """What peaks out of its ranges, or is no number, is not told to have stayed in its box."""
    model = load(plants.MODELS / "pendulum.py")
    guarded = model.step("high_gain")
    plain = hg.sample(guarded.observer, guarded.method, guarded.dt, guards="none", engine="python")
    made = next(try_out(plain, model.trials()[0]))
    made.x[:] = 0.0
    made.x[-3:] = [[100.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]
    assert metrics(plain, made).clamped == 2


def test_of_a_measured_record_every_sample_is_used() -> None:
    """No bit says that one was not; with guards an absurd one was not."""
    for step, unused in zip(both("pendulum"), (1, 0), strict=True):
        u, y = record(step)
        y[SAMPLES // 2] = 1e6
        assert np.count_nonzero(rejected(step, step.run(u, y), y)) == unused


def test_tune_limits_nothing() -> None:
    _, plain = both("pendulum")
    functions = hg.targets.casadi(plain)
    far = np.array(functions.p.initial, dtype=float) * 1e3
    _, _, status = functions.step(functions.memory.initial, [0.0], [0.1], far)
    assert float(status) == 0
    assert plain.code.tuning == tuple(s for s in plain.code.tuning if s.title == "observer gain")


@pytest.mark.parametrize("name", ["pendulum", "fitzhugh_nagumo"])
def test_it_goes_through_a_pickle(name: str) -> None:
    _, plain = both(name)
    again = pickle.loads(pickle.dumps(plain))
    u, y = record(plain)
    assert again.clock.guards == "none"
    assert again.observer.checks == plain.observer.checks
    assert np.array_equal(plain.run(u, y).x, again.run(u, y).x)


def test_guards_come_and_go_with_the_observer() -> None:
    """Whose equations clamp or do not: a guarded step of an observer that was sampled without is the guarded one."""
    guarded, plain = both("pendulum")
    again = hg.sample(plain.observer, plain.method, plain.dt, engine="python")
    assert again.observer.form.clamped
    assert again.observer.checks == guarded.observer.checks
    u, y = record(guarded)
    assert np.array_equal(guarded.run(u, y).x, again.run(u, y).x)
    assert again.rebuilt(guards="none").clock.guards == "none"
    assert plain.rebuilt(dt=2e-3).clock.guards == "none"
    assert plain.rebuilt(guards="all").layout.bits == guarded.layout.bits


@pytest.mark.parametrize("name", ["high_gain", "circle_criterion", "low_power", "peaking_free", "filtered"])
def test_nothing_is_proved_of_what_is_not_clamped(name: str) -> None:
    """Of its observer in continuous time neither: beyond its range the slope of q^3 has no end."""
    q, w, y = hg.Signal("q", low=-1, high=1), hg.Signal("w", low=-1, high=1), hg.Signal("y")
    plant = hg.System("cube", states=(q, w), outputs=(y,), flow=[w, -(q**3) - w], output=[q])
    gains = {"alpha": 3, "beta": 1} if name == "filtered" else {}
    poles = {} if name in ("low_power", "peaking_free") else {"poles": (-0.5, -0.5)}
    observer = getattr(hg.observers, name)(hg.forms.triangular(plant), theta=20, **gains, **poles)
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3, guards="none", engine="python")
    for answer in (
        hg.design.noise_bounds(step.observer),
        hg.l2_gain(step.observer, noise={"y": 1}).check.reason,
        hg.iss_gain(step.observer, noise={"y": 1}).check.reason,
        hg.contraction(step).checks[0].reason,
    ):
        assert "no argument of b is clamped" in str(answer)


@pytest.mark.full
def test_the_commands_take_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    hgogen("generate", str(plants.MODELS / "pendulum.py"), "--guards", "none", "-o", str(tmp_path))
    header = (tmp_path / "pendulum" / "pendulum.h").read_text()
    assert "hgogen generate pendulum --guards none" in " ".join(header.replace(" *", "").split())
    assert "Guards: none" in header


def test_bad_input() -> None:
    observer = emitted.step("pendulum").observer
    with pytest.raises(BadStep, match='guards = \'some\' must be "all" or "none"'):
        hg.sample(observer, dt=1e-3, guards="some")
    late = emitted.step("delayed")
    with pytest.raises(BadStep, match="is not for samples that come late"):
        hg.sample(late.observer, late.method, late.dt, guards="none")
    filter = hg.observers.riccati(hg.forms.original(plants.two_outputs()), Q=[0.1] * 3, R=[0.1, 0.2])
    with pytest.raises(BadStep, match="is not for sensors of different rates"):
        hg.sample(filter, dt=0.01, periods={filter.form.system.outputs[0].name: 0.02}, guards="none")
    bank = emitted.step("bank")
    with pytest.raises(BadGain, match="sample a member of it alone"):
        hg.sample(bank.observer, bank.method, bank.dt, guards="none")


def test_a_plain_text_model_may_ask_for_it(tmp_path: object) -> None:
    text = (
        'name = "decay"\n[states.x]\nlow = -1\nhigh = 1\nflow = "-x"\n[outputs.y]\nequation = "x"\n'
        '[observer]\nkind = "high_gain"\npoles = [-1]\ntheta = 5\ndt = 0.01\nguards = "none"\n'
    )
    path = tmp_path / "decay.toml"  # type: ignore[operator]
    path.write_text(text)
    assert load(path).step().clock.guards == "none"


@pytest.mark.parametrize("name", ["pendulum", "two", "tunable"])
def test_its_header_says_nothing_of_guards(name: str) -> None:
    """Not that NaN is told, a second update ignored, a parameter limited or memory marked, which it does none of."""
    made = both(name)[1]
    header = " ".join(hg.targets.c99(made, check=False)[f"{made.name}.h"].replace("\n *", "").split())
    for absent in ("MISSING", "does not correct", "limits them", "mark */", "status bits", "or their statuses"):
        assert absent not in header
    manual = emitted.manual(hg.targets.c99(made, check=False))
    assert ("NaN spoils the state. An update that comes again corrects again." in manual) == made.code.separable
