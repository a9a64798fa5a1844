"""Faults that a log shows: each kind in logs that have it, and none in healthy ones."""

import json
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from test_cli import hgogen

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.commands.command import NO_COLUMNS
from hgogen.commands.data import logs_of
from hgogen.logs.findings import inspect
from hgogen.logs.records import Log
from hgogen.model import load
from hgogen.reading.measured import WINDOWS

a, b, c = (hg.Signal(name, low=-20, high=20) for name in "abc")
u, y, y2 = hg.Signal("u", low=-10, high=10), hg.Signal("y", unit="V"), hg.Signal("y2")
PLANTS = {
    "spring": (
        hg.System("spring", states=(a, b), inputs=(u,), outputs=(y,), flow=(b, u - 4 * a - b), output=(a,)),
        0.05,
    ),
    "walk": (hg.System("walk", states=(a,), outputs=(y,), flow=(sp.Integer(0),), output=(a,)), 1.0),
    "chain": (
        hg.System(
            "chain", states=(a, b, c), inputs=(u,), outputs=(y, y2), flow=(b, c - a, u - c), output=(a, b + c / 10)
        ),
        0.1,
    ),
    "pendulum": (
        hg.System("pendulum", states=(a, b), inputs=(u,), outputs=(y,), flow=(b, u - 4 * sp.sin(a) - b), output=(a,)),
        0.05,
    ),
}
SIGMA = 0.02


@cache
def healthy(name: str, seed: int, count: int = 500) -> tuple[CallableStep, Log]:
    """A log of a plant with process noise and readings' noise, as its filter takes them; of some seeds with rounded
    readings, as of a converter; inputs held, drawn at random, or a step."""
    plant, dt = PLANTS[name]
    draw, n = np.random.default_rng(seed), len(plant.states)
    shapes = (
        np.repeat(draw.normal(size=(count // 20 + 1, 1)), 20, axis=0)[:count] * 3,
        3 * np.sin(np.arange(count) / draw.uniform(5, 50))[:, None],
        np.where(np.arange(count)[:, None] > count // 3, 3.0, 0.0),
    )
    inputs = np.clip(shapes[seed % 3], -10, 10)[:, : len(plant.inputs)]
    rate = sp.lambdify([plant.states, plant.inputs], list(plant.flow))
    read = sp.lambdify([plant.states, plant.inputs], list(plant.output))
    x, rows = draw.uniform(1, 3, n), []
    for now in inputs:
        for _ in range(10):  # held up to its sample, as `between` says below
            half = x + dt / 20 * np.array(rate(x, now))
            x = x + dt / 10 * np.array(rate(half, now))
        x = x + SIGMA * np.sqrt(dt) * draw.normal(size=n)
        rows.append(np.ravel(read(x, now)) + SIGMA * draw.normal(size=len(plant.outputs)))
    values, sigma = np.array(rows), SIGMA
    if seed % 2:
        step = SIGMA * draw.uniform(0.2, 1.5)
        values, sigma = np.round(values / step) * step, float(np.hypot(SIGMA, step / np.sqrt(12)))
    Q, noise = [SIGMA**2] * n, {signal.name: sigma for signal in plant.outputs}
    observer = hg.observers.riccati(hg.forms.original(plant), Q=Q, noise=noise, covariance=[1.0] * n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return hg.sample(observer, dt=dt, between="hold"), Log(inputs, np.round(values, 5), dt)


def faulty(kind: str, log: Log, draw: np.random.Generator) -> Log:
    """The log with a fault in its first output."""
    values, count = log.y.copy(), len(log.y)
    first = values[:, 0]
    if kind == "still":
        first[count // 3 : count // 3 + 60] = first[count // 3]
    if kind == "outliers":
        first[draw.choice(count, 15, replace=False)] += 250 * SIGMA
    if kind == "code":
        first[draw.choice(count, 9, replace=False)] = -999
    if kind == "held":
        first[:] = np.repeat(first[::4], 4)
    if kind == "drawn":
        first[:] = np.interp(np.arange(count), np.arange(0, count, 5), first[::5])
    if kind == "clipped":
        first[:] = np.minimum(first, np.quantile(first, 0.85))
    if kind == "quantum":
        first[:] = np.round(first / (12 * SIGMA)) * 12 * SIGMA
    if kind == "offset":
        values[:, -1] += 12 * SIGMA
    return Log(log.u, values, log.dt)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", PLANTS)
def test_a_healthy_log_has_no_finding(name: str, seed: int) -> None:
    step, log = healthy(name, seed)
    assert inspect(step, log) == ()


@pytest.mark.full
def test_of_many_healthy_logs_one_in_fifty_has_a_finding_at_most() -> None:
    each = [inspect(*healthy(name, seed, count)) for name in PLANTS for seed in range(2, 27) for count in (200, 1500)]
    assert sum(map(bool, each)) <= len(each) / 50


@pytest.mark.parametrize("kind", ["still", "outliers", "code", "held", "drawn", "clipped", "quantum"])
@pytest.mark.parametrize("name", ["spring", "walk", "chain"])
def test_a_fault_has_its_name(name: str, kind: str) -> None:
    step, log = healthy(name, 4)
    log = faulty(kind, log, np.random.default_rng(1))
    faults = inspect(step, log)
    cut_off = {one for one in faults if kind == "clipped" and "is it cut off there" in one.fix}  # at one place alone
    one = next(each for each in faults if each.signal == "y" and (each.fault == kind or each in cut_off))
    assert one.strength > 1
    assert str(one).startswith(one.finding)
    if kind == "still":
        assert one.rows == ((166, 225),)
        assert "samples 166 to 225" in one.finding
    if kind in ("outliers", "code"):
        changed = np.flatnonzero(np.abs(log.y - healthy(name, 4)[1].y)[:, 0] > 1)
        assert len(one.rows) > len(changed) / 3
        assert all(np.abs(changed - first).min() <= 1 for first, _ in one.rows)  # one between two may count
    if kind in ("held", "drawn"):
        assert one.strength == {"held": 4, "drawn": 5}[kind]


def test_a_usual_code_need_not_be_far() -> None:
    """-999 in concentrations from 400 to 1,500, as a reader takes it; a value that is no usual code is an end."""
    step, log = healthy("walk", 4)
    rows = np.arange(20, 480, 50)
    for code, known in ((-999.0, True), (-1000.0, False)):
        values = 900 + 500 * np.sin(np.arange(500) / 40)[:, None] + log.y
        values[rows] = code
        assert known is ("code" in {one.fault for one in inspect(step, Log(log.u, values, log.dt))})


def test_a_pulse_that_the_model_predicts_is_no_outlier() -> None:
    """The output reads an input with pulses; without these it has outliers."""
    through = hg.System("through", states=(a,), inputs=(u,), outputs=(y,), flow=(-a / 4,), output=(a + u,))
    observer = hg.observers.riccati(hg.forms.original(through), Q=[1e-4], noise={"y": 0.01}, covariance=[1.0])
    step, draw = hg.sample(observer, dt=0.2), np.random.default_rng(3)
    pulses = 5.0 * (np.arange(500) % 25 == 7)[:, None]
    values = np.round(pulses + 0.01 * draw.normal(size=(500, 1)), 5)
    assert inspect(step, Log(pulses, values, 0.2)) == ()
    assert "outliers" in {one.fault for one in inspect(step, Log(0 * pulses, values, 0.2))}


def test_lines_of_significant_digits_are_drawn() -> None:
    """Values above 10 then have a decimal less than those below."""
    step, log = healthy("walk", 4)
    at = np.arange(0, 500, 6)
    course = np.interp(np.arange(500), at, 10 + 4 * np.sin(at / 40) + log.y[at, 0])
    values = np.array([[float(f"{value:.6g}")] for value in course])
    assert "drawn" in {one.fault for one in inspect(step, Log(log.u, values, log.dt))}


def test_an_offset_and_a_drift_are_those_of_their_signal() -> None:
    """Of a model without a state that learns them. Several means at once tell the output's from the input's."""
    step, log = healthy("chain", 2)
    (one,) = inspect(step, faulty("offset", log, np.random.default_rng(1)))
    assert (one.signal, one.fault, "standard errors from 0" in one.finding) == ("y2", "offset", True)
    taken = float(one.fix.partition('--map y2="y2 - ')[2].partition('"')[0])
    assert taken == pytest.approx(12 * SIGMA, rel=0.1)
    drifting = log.y + np.linspace(0, 30 * SIGMA, len(log.y))[:, None] * [0, 1]
    (one,) = inspect(step, Log(log.u, drifting, log.dt))
    assert (one.signal, one.fault) == ("y2", "drift")


@pytest.mark.full
def test_scales_and_signs_are_named_with_what_is_equal() -> None:
    """The other sign of an output of a linear plant is that of all other signals."""
    step, log = healthy("chain", 6)
    kinds = {"sign": [-1.0, 1.0], "scale": [3.7, 1.0]}
    for fault, factors in kinds.items():
        one = inspect(step, Log(log.u, log.y * factors, log.dt))[0]
        assert (one.signal, one.fault) == ("y", fault)
        if fault == "sign":
            assert one.fix == '--map y="-y", or equally u and y2 look like the other sign, --map u="-u" --map y2="-y2"'
        else:
            assert float(one.fix.partition('--map y="y/')[2].partition('"')[0]) == pytest.approx(3.7, rel=0.1)


def test_a_state_that_is_held_is_named() -> None:
    drift = hg.Signal("drift", low=-1, high=1)
    plant = hg.System(
        "gyro", states=(a, drift), inputs=(u,), outputs=(y,), flow=(u - drift, sp.Integer(0)), output=(a,)
    )
    form = hg.forms.original(plant)
    observer = hg.observers.riccati(form, Q=[1e-4, 1e-14], noise={"y": 0.01}, covariance=[1e-2, 1e-10])
    draw, rates = np.random.default_rng(4), np.sin(np.arange(300) / 20)[:, None]
    angle = np.cumsum(np.append(0, rates[:-1, 0])) * 0.02
    log = Log(rates + 0.3, (angle + 0.01 * draw.normal(size=300))[:, None], 0.02)
    (one,) = inspect(hg.sample(observer, dt=0.02), log)
    assert (one.fault, "drift, with too small a Q" in one.fix) == ("offset", True)


def test_what_stands_still_with_all_others_is_at_rest() -> None:
    """A plant without noise that rests, and then moves."""
    step, log = healthy("spring", 2)
    quiet = np.concatenate([np.zeros(200), 1 - np.cos(np.arange(300) / 20)])[:, None]
    resting = Log(np.concatenate([np.zeros((200, 1)), np.ones((300, 1))]), quiet, log.dt)
    assert "still" not in {one.fault for one in inspect(step, resting)}


@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
def test_a_shaft_at_rest_does_not_stand_still_for_the_offset_of_its_tachometer() -> None:
    """The offset moves the estimate, and the model of the angle alone does not move; where the angle does hang, the
    voltage moves it."""
    th, w = hg.Signal("th", low=-600, high=600), hg.Signal("w", low=-250, high=250)
    shaft = hg.System("shaft", states=(th, w), inputs=(u,), outputs=(y, y2), flow=(w, 15 * u - w), output=(th, w))
    form, sigmas = hg.forms.original(shaft), {"y": 1e-3, "y2": 0.2}
    observer = hg.observers.riccati(form, Q=[1e-5, 500], noise=sigmas, covariance=[1.0] * 2)
    step, draw = hg.sample(observer, dt=0.002, between="hold"), np.random.default_rng(1)
    speed = 30 * (1 - np.exp(-0.002 * np.arange(2500)))
    still, moving = np.zeros((500, 2)), np.column_stack([0.002 * np.cumsum(speed), speed])
    measured = np.concatenate([still, moving]) + draw.normal(size=(3000, 2)) * [1e-3, 0.2]
    measured[:, 0] = 3e-3 * np.round(measured[:, 0] / 3e-3)
    voltage, resting, hanging = np.repeat([[0.0], [2.0]], [500, 2500], axis=0), measured + np.array([0, 2]), measured
    resting[100:300, 0] = 0
    assert "still" not in {one.fault for one in inspect(step, Log(voltage, resting, 0.002))}
    hanging[2700:2900, 0] = hanging[2700, 0]  # at full speed, so that no other signal changes
    (one,) = (one for one in inspect(step, Log(voltage, hanging, 0.002)) if one.fault == "still")
    assert one.rows == ((2700, 2899),)
    assert "while" not in one.finding


def test_a_coarse_sensor_repeats_itself_by_chance() -> None:
    """Of a course that takes the next level with 5 of 100, a value comes 8 times in a row, and 60 times, by chance."""
    step, log = healthy("spring", 1)
    levels = np.cumsum(np.random.default_rng(3).choice([-1.0, 0.0, 1.0], p=[0.025, 0.95, 0.025], size=(500, 1)), axis=0)
    assert "still" not in {one.fault for one in inspect(step, Log(log.u, levels, log.dt))}


def test_an_angle_that_passes_the_end_of_its_turn_has_no_outlier() -> None:
    psi, rate, yaw = (
        hg.Signal("psi", period=2 * sp.pi),
        hg.Signal("rate", low=-3, high=3),
        hg.Signal("yaw", period=2 * sp.pi),
    )
    plant = hg.System("yawing", states=(psi,), inputs=(rate,), outputs=(yaw,), flow=[rate], output=[psi])
    observer = hg.observers.riccati(hg.forms.original(plant), Q_per_sample=[1e-6], noise={"yaw": 0.1})
    course = np.arange(1000) * 0.02 + 0.1 * np.random.default_rng(0).normal(size=1000)
    turned = (course + np.pi) % (2 * np.pi) - np.pi
    log = Log(np.ones((1000, 1)), turned[:, None], 0.02)
    assert inspect(hg.sample(observer, dt=0.02), log) == ()


def test_an_angle_in_another_unit_is_that_before_its_turns() -> None:
    """Of degrees, where the model has radians, a turn of 360 is no period of the model."""
    q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-4, high=4)
    y = hg.Signal("y", "rad", low=-4, high=4)
    plant = hg.System("wheel", states=(q, w), inputs=(), outputs=(y,), flow=[w, 0 * w], output=[q])
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=(1e-4, 1e-4), R=1e-5), dt=0.02)
    turned = (2.0 * 0.02 * np.arange(600) + np.pi) % (2 * np.pi) - np.pi
    noisy = turned + 1e-3 * np.random.default_rng(0).normal(size=600)
    named = [
        [(one.fault, one.fix) for one in inspect(step, Log(np.zeros((600, 0)), factor * noisy, 0.02))]
        for factor in (1.0, 180 / np.pi)
    ]
    assert [fault for fault, _ in named[0]] == ["turns"]
    assert [fault for fault, _ in named[1]] == ["range"]
    assert "pi/180*y" in named[1][0][1]


def test_few_and_missing_samples_raise_nothing() -> None:
    step, log = healthy("spring", 0)
    assert inspect(step, Log(log.u[:39], log.y[:39], log.dt)) == ()
    assert inspect(step, Log(log.u, np.full_like(log.y, np.nan), log.dt)) == ()
    gaps = np.where(np.random.default_rng(2).uniform(size=log.y.shape) < 0.3, np.nan, log.y)
    assert inspect(step, Log(log.u, gaps, log.dt)) == ()


SPRING = """
name = "spring"
states.a = {low = -20, high = 20, flow = "b"}
states.b = {low = -20, high = 20, flow = "u - 4*a - b"}
inputs.u = {low = -10, high = 10}
outputs.y = {equation = "a"}
observer = {kind = "ekf", dt = 0.05, Q_per_sample = [2e-5, 2e-5], noise = {y = 0.02}, covariance = [1, 1]}
"""


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    _, log = healthy("spring", 0, 400)
    values = faulty("still", log, np.random.default_rng(0)).y
    rows = "".join(
        f"{0.05 * k:g},{0.05 * k + 0.01 * (k % 3):g},{u:.6g},{y:.6g}\n"
        for k, (u, y) in enumerate(np.hstack([log.u, values]))
    )
    (tmp_path / "log.csv").write_text(f"t,stamp,u,y\n{rows}")
    (tmp_path / "spring.toml").write_text(SPRING)
    return tmp_path


def test_the_command_names_the_fault_and_the_better_clock(folder: Path) -> None:
    words = [
        "inspect",
        str(folder / "spring.toml"),
        "--data",
        str(folder / "log.csv"),
        "--time",
        "t",
        "-o",
        str(folder),
    ]
    printed = " ".join(hgogen(*words)[0].split())
    assert "y, still: y stands still at samples 133 to 192" in printed
    assert "60 in a row, while u moves: does the sensor hang" in printed
    assert "stamp, clock: the column 'stamp' runs like a clock, too" in printed
    assert "it may hold the true times: --time stamp" in printed
    report = json.loads((folder / "log_faults.json").read_text())
    faults = {(one["signal"], one["fault"]): one["rows"] for one in report["findings"]}
    assert faults == {("stamp", "clock"): [[0, 399]], ("y", "still"): [[133, 192]]}
    assert (folder / "log_signals.svg").stat().st_size > 1000


def test_a_model_without_an_observer_is_judged_by_riccati(folder: Path) -> None:
    (folder / "spring.toml").write_text(SPRING[: SPRING.index("observer")])
    words = ["inspect", str(folder / "spring.toml"), "--data", str(folder / "log.csv"), "--time", "t"]
    printed = " ".join(hgogen(*words, "-o", str(folder))[0].split())
    assert "y, still: y stands still at samples 133 to 192" in printed


def test_a_tuning_without_a_period_judges_a_log(folder: Path) -> None:
    """Where the model has no step of its own; with no finding nothing says that none was sought."""
    tuning = SPRING.replace("observer =", "tuning.mine =").replace("dt = 0.05, ", "")
    (folder / "spring.toml").write_text(tuning)
    words = ["inspect", str(folder / "spring.toml"), "--data", str(folder / "log.csv"), "--time", "t"]
    assert "y, still: y stands still at samples 133 to 192" in " ".join(hgogen(*words, "-o", str(folder))[0].split())
    model, columns = load(str(folder / "spring.toml")), replace(NO_COLUMNS, time="t")
    logs = logs_of(model.plant, [folder / "log.csv"], None, named=columns, shift=None, window=WINDOWS["line"])
    assert "still" in {one.fault for one in logs.inspected(model).findings[0]}


def test_a_run_says_the_fault_in_place_of_its_effect(folder: Path) -> None:
    words = ["run", str(folder / "spring.toml"), "--data", str(folder / "log.csv"), "--time", "t", "-o", str(folder)]
    printed = " ".join(hgogen(*words)[0].split())
    assert "y stands still at samples 133 to 192" in printed
    assert "R, Q or both are too small" not in printed
    printed = " ".join(hgogen(*words, "--map", "u=-u", "--missing", "y=133..192")[0].split())
    assert "u looks like" in printed  # a fault of the input explains the innovations of all outputs
    assert not [effect for effect in ("R, Q or both", "are not white", "worse than copying") if effect in printed]


MOTOR = """
name = "motor"
states.th = {unit = "rad", low = -600, high = 600, flow = "w"}
states.w = {unit = "rad/s", low = -250, high = 250, flow = "25*u - 1.75*w - 10*tanh(w/0.3)"}
inputs.u = {unit = "V", low = -12, high = 12}
outputs.angle = {unit = "rad", equation = "th"}
outputs.tacho = {unit = "rad/s", equation = "w"}
"""


@pytest.mark.parametrize("late", [0, 5])
def test_the_tuned_filter_reveals_what_first_gains_hide(late: int, tmp_path: Path) -> None:
    """First gains take a tacho that is 5 samples late for noise."""
    draw, dt, count = np.random.default_rng(3), 2e-3, 1500
    u = np.repeat(draw.uniform(-6, 6, count // 100), 100)
    th, w, rows = 0.0, 0.0, []
    for volts in u:
        rows.append((th, w))
        for _ in range(20):
            w += dt / 20 * (25 * volts - 1.75 * w - 10 * np.tanh(w / 0.3))
            th += dt / 20 * w
    angle, speed = np.array(rows).T
    turn = 2 * np.pi / 2048
    angle = np.round((angle + 0.0005 * draw.normal(size=count)) / turn) * turn
    tacho = np.concatenate([np.full(late, speed[0]), speed[: count - late]]) + 0.5 * draw.normal(size=count)
    table = np.column_stack([dt * np.arange(count), u, angle, tacho])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,u,angle,tacho", comments="", fmt="%.6g")
    (tmp_path / "motor.toml").write_text(MOTOR)
    words = ["tune", str(tmp_path / "motor.toml"), "--data", str(tmp_path / "log.csv"), "--time", "t", "-o"]
    printed = hgogen(*words, str(tmp_path), "--observers", "riccati", "--between", "hold", "--jobs", "1")[0]
    before, _, after = printed.partition("tuned observers")
    assert "tacho, " not in before
    assert ("tacho, delay: tacho fits if it is taken 5 samples earlier" in after) == bool(late)
    report = json.loads((tmp_path / "tuned.json").read_text())
    assert [one["fault"] for one in report["findings"][0] if one["signal"] == "tacho"] == ["delay"] * bool(late)
    assert printed.count("angle stands still") == 1  # where the motor sticks: not once more by the tuned gains


def test_times_in_milliseconds_are_named_before_all_else(tmp_path: Path) -> None:
    """Samples of 10 s say nothing about the signals, and the warning of the step length is printed once."""
    (tmp_path / "motor.toml").write_text(MOTOR)
    rows = [f"{10 * k},{k // 20 % 3},{0.1 * k if k < 30 else 3},{k // 20 % 3}" for k in range(100)]
    (tmp_path / "log.csv").write_text("\n".join(["t,u,angle,tacho", *rows]))
    words = ["inspect", str(tmp_path / "motor.toml"), "--data", str(tmp_path / "log.csv"), "-o", str(tmp_path)]
    out, error = hgogen(*words, "--time", "t")
    assert "t, milli: times look like milliseconds: the column 't' has a row every 10 s" in " ".join(out.split())
    assert "stands still" not in out
    assert error.count("may fail in a part of the declared box") == 1
    assert "stands still" in hgogen(*words, "--time", "t/1000")[0]


@pytest.mark.parametrize("command", ["fit", "tune"])
def test_learning_from_late_samples_demands_their_shift(command: str, tmp_path: Path) -> None:
    """Also where their ages are mapped, which a tuning does not read; with the shift the refusal is another one."""
    tuning = 'tuning.mine = {kind = "ekf", Q_per_sample = {th = 1e-8, w = 1.0}, noise = {angle = 0.001, tacho = 0.5}'
    (tmp_path / "motor.toml").write_text(f"{MOTOR}{tuning}, delays = {{tacho = 5}}, dt = 0.002}}\n")
    (tmp_path / "log.csv").write_text("t,u,angle,tacho\n0,0,0,0\n0.002,0,0,0\n")
    words = [command, str(tmp_path / "motor.toml"), "--data", str(tmp_path / "log.csv"), "--time", "t"]
    for more in ([], ["--map", "tacho_age=5"]):
        error = " ".join(hgogen(*words, *more, status=2)[1].replace("│", " ").split())
        assert "rows of their measurement: add --shift tacho=-5, or 0 if the log has them there" in error
    for shift in ("tacho=-5", "tacho = 0"):
        assert "come late" not in "".join(hgogen(*words, "--shift", shift, status=2))


@pytest.mark.parametrize(
    ("unit", "scale", "looks"),
    [
        ("m", 100, "like centimetres, where the model has metres"),
        ("", 100, "like a factor of 100, as of per cent"),
        ("m/s^2", 1 / 9.80665, "like g, where the model has m/s^2"),
    ],
)
def test_a_scale_is_that_of_the_unit(unit: str, scale: float, looks: str) -> None:
    log = healthy("spring", 0)[1]
    wide = hg.Signal("y", unit=unit, low=-1e4, high=1e4)
    plant = replace(PLANTS["spring"][0], outputs=(wide,))
    form = hg.forms.original(plant)
    observer = hg.observers.riccati(form, Q=[SIGMA**2] * 2, noise={"y": SIGMA}, covariance=[1.0] * 2)
    faults = inspect(hg.sample(observer, dt=log.dt, between="hold"), replace(log, y=scale * log.y))
    assert [looks in one.finding for one in faults if one.fault == "scale"] == [True]
