"""Angles in every observer and language: a motor in degrees whose sensor turns four times as often, the other way."""

from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from emitted import run
from test_casadi_target import called
from test_rust import built, driver

import hgogen as hg
from hgogen.modelfiles.tuning import value
from hgogen.program import Place
from hgogen.run import native
from hgogen.starting import gains_of, scale

TURN = 2 * np.pi
DT, COUNT = 0.01, 200
PAIRS = -4  # turns of the sensor in one turn of the shaft
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


def short_way(difference: np.ndarray, period: float = 360.0) -> np.ndarray:
    """The difference in [-period/2, period/2), by numpy."""
    return np.asarray((difference + period / 2) % period - period / 2)


# --- every observer, every target ---------------------------------------------------------------------------

FORMS = {"kalman_like": "state_affine", "uniform_injection": "uniform"}
OBSERVERS = [name for name in dir(hg.observers) if not name.startswith("_") and name not in ("bank", "not_iss")]


def motor(turns: bool, name: str = "motor") -> hg.System:
    """An unbalanced motor in degrees, with an angle as input; without turns its angles are plain numbers."""

    def signal(name: str, **turn: float) -> hg.Signal:
        return hg.Signal(name, "deg", **({"period": 360, **turn} if turns else {"low": -5e4, "high": 5e4}))

    th, a, y, w = signal("th", low=0, high=360), signal("a"), signal("y"), hg.Signal("w", "deg/s", low=-2e3, high=2e3)
    unit = sp.pi / 180
    pull = -100 * sp.sin(unit * th) + 50 * sp.cos(unit * a)
    if name == "affine":
        pull = 50 * sp.cos(unit * a)
    flow, output = [w, pull - w / 2 + 400], [PAIRS * th]
    return hg.System(name, states=(th, w), inputs=(a,), outputs=(y,), flow=flow, output=output)


@cache
def step(name: str, turns: bool) -> hg.Step:
    plant, make = "affine" if name == "kalman_like" else "motor", getattr(hg.observers, name)
    form, turning = (getattr(hg.forms, FORMS.get(name, "triangular"))(motor(each, plant)) for each in (turns, True))
    gains = gains_of(make, scale(turning, DT, {"y": 0.5}))
    assert not isinstance(gains, str), gains
    observer = make(form, initial={"th": 20, "w": 300}, **{key: value(key, entry) for key, entry in gains.items()})
    return hg.sample(observer, dt=DT)


@cache
def course(affine: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input, noisy samples and states of the motor, unwrapped."""

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        pull = 50 * np.cos(np.radians(170 + 100 * t)) - (0 if affine else 100) * np.sin(np.radians(z[0]))
        return np.array([z[1], pull - z[1] / 2 + 400])

    states, z, h = [], np.array([20.0, 300.0]), DT / 10
    for k in range(COUNT):
        states.append(z)
        for i in range(10):
            t = k * DT + i * h
            z = z + h * slope(t + h / 2, z + h / 2 * slope(t, z))
    x, u = np.array(states), 170 + 100 * DT * np.arange(COUNT)
    return u[:, None], PAIRS * x[:, :1] + 0.5 * np.random.default_rng(1).standard_normal((COUNT, 1)), x


def same(one: hg.Run, other: hg.Run) -> bool:
    return (one.x.tobytes(), one.status.tobytes()) == (other.x.tobytes(), other.status.tobytes())


@pytest.mark.ordinary("high_gain", "riccati", "ukf")
@pytest.mark.parametrize("name", OBSERVERS)
def test_every_observer_goes_round_as_on_the_line(name: str) -> None:
    u, y, x = course(name == "kalman_like")
    line = step(name, False).run(u=u, y=y, engine="python")
    made = step(name, True)
    made.reset()
    circle = made.run(u=short_way(u), y=short_way(y), engine="python")
    assert x[-1, 0] > 2 * 360
    allowed = 1e-2 if name == "kalman_like" else 1e-7  # its covariance begins at a cap, which is made of the ranges
    assert np.abs(short_way(circle.x[:, 0] - line.x[:, 0])).max() < allowed
    assert np.abs(circle.x[:, 1] - line.x[:, 1]).max() < allowed
    assert circle.status.tolist() == line.status.tolist()
    assert 0 <= circle.x[:, 0].min() < circle.x[:, 0].max() <= 360
    assert rms(short_way(circle.x[100:, 0] - x[100:, 0])) < 8  # of the slowest, in degrees


def faulty(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The record with whole turns more or fewer, missing and absurd samples and inputs."""
    u, y, _ = course(name == "kalman_like")
    turns = np.random.default_rng(2).integers(-1000, 1000, (2, COUNT, 1))
    u, y = short_way(u) + 360 * turns[0], short_way(y) + 360 * turns[1]
    y[40:45], y[60], y[70], u[80:83], u[90] = np.nan, 1e300, 360 * 1030, np.nan, np.inf
    return u, y


def test_whole_turns_of_samples_and_inputs_change_nothing() -> None:
    made, (u, y, _) = step("riccati", True), course(False)
    turns = np.random.default_rng(3).integers(-1000, 1000, (2, COUNT, 1)) * 360
    made.reset()
    once = made.run(u=short_way(u), y=short_way(y), engine="python")
    made.reset()
    turned = made.run(u=short_way(u) + turns[0], y=short_way(y) + turns[1], engine="python")
    assert np.abs(short_way(turned.x[:, 0] - once.x[:, 0])).max() < 1e-8
    assert turned.status.tolist() == once.status.tolist() == [0] * COUNT


@pytest.mark.parametrize(("turns", "flags"), [(1023, set()), (1026, {"REUSED_A", "REJECTED_Y"})])
def test_beyond_1024_turns_nothing_is_used(turns: int, flags: set[str]) -> None:
    made = step("riccati", True)
    made.reset()
    made(u=0, y=-80)
    assert set(made(u=360 * turns, y=360 * turns).flags) == flags


@needs_compiler
@pytest.mark.ordinary("riccati")
@pytest.mark.parametrize("name", OBSERVERS)
def test_every_language_has_the_same_bits(name: str) -> None:
    u, y = faulty(name)
    for real in ("float", "double"):
        made = step(name, True).rebuilt(real=real)
        python = made.run(u=u, y=y, engine="python")
        made.reset()
        assert same(made.run(u=u, y=y, engine="c"), python)
        assert python.status.any()
    made.reset()
    many = made.run_many(u=np.stack([u, u[::-1]]), y=np.stack([y, y[::-1]]), jobs=1)
    assert many.x[0].tobytes() == python.x.tobytes()
    x, status = called(hg.targets.casadi(made, bundled=True), u, y)[1:]
    assert np.array_equal(x, python.x)
    assert np.array_equal(status, python.status)


@pytest.mark.full
@pytest.mark.parametrize("name", OBSERVERS)
def test_rust_has_the_bits_too(name: str, tmp_path: Path) -> None:
    made, (u, y) = step(name, True), faulty(name)
    crate = hg.targets.rust(made, real="double", check=False)[f"{made.name}.rs"]
    texts = {f"{made.name}.rs": crate, "driver.rs": driver(made, u, y)}
    lines = run([str(built(texts, made.name, tmp_path))], tmp_path).splitlines()
    printed = np.array([list(map(int, line.split())) for line in lines], np.uint64)
    made.reset()
    done = made.run(u=u, y=y, engine="python")
    assert (printed[:, 0] == done.status).all()
    assert (printed[:, 1:] == np.ascontiguousarray(done.x).view(np.uint64)).all()


# --- what the C says ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("real", ["float", "double"])
def test_the_c_says_what_an_angle_is(real: Any) -> None:
    files = hg.targets.c99(step("riccati", True), real=real, check=False)
    header, manual = files["motor.h"], files["motor.md"]
    assert "[deg], one turn, 0 .. 360" in header
    assert "[deg], one turn, -180 .. 180" in header
    assert "a is not finite or absurd (more than 1024 turns off)" in " ".join(header.replace("\n * ", " ").split())
    assert "y is implausible, outside -368820 .. 368820" in header
    assert "| `measurement.y` |  | deg | one turn, -180 .. 180 |" in manual
    assert "- Angles: a, y, th." in manual
    assert ("near 1e6 is a multiple of 0.0625" in header, "has lost its digits" in manual) == (real == "float",) * 2


def test_a_line_without_turns_says_nothing_of_them() -> None:
    text = "".join(hg.targets.c99(step("riccati", False), check=False).values())
    assert "turn," not in text
    assert "Angles:" not in text


# --- known answers ------------------------------------------------------------------------------------------


def radians(name: str) -> hg.Signal:
    return hg.Signal(name, "rad", period=TURN)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@needs_compiler
@pytest.mark.parametrize(
    ("name", "gains"),
    [("high_gain", {"theta": 2, "poles": (-1, -1)}), ("riccati", {"Q": (1e-3, 1e-6), "R": 1e-4 * 0.02})],
)
def test_a_compass_with_a_gyro_keeps_5_mrad_over_a_hundred_turns(name: str, gains: dict[str, Any]) -> None:
    th, b, w, y = radians("th"), hg.Signal("b", low=-0.1, high=0.1), hg.Signal("w", low=-3, high=3), radians("y")
    plant = hg.System("heading", states=(th, b), inputs=(w,), outputs=(y,), flow=[w + b, 0], output=[th])
    count, rng = 60_000, np.random.default_rng(1)
    truth = 0.53 * np.arange(count) * 0.02
    made = hg.sample(getattr(hg.observers, name)(hg.forms.triangular(plant), **gains), dt=0.02, real="float")
    y = short_way(truth + 0.01 * rng.standard_normal(count), TURN)
    error = short_way(made.run(u=np.full((count, 1), 0.5), y=y[:, None]).x[:, 0] - truth, TURN)
    assert truth[-1] > 100 * TURN
    assert rms(error[100:280]) < 0.005
    assert rms(error[300:]) < 0.005


@needs_compiler
def test_an_encoder_in_float_keeps_its_digits_for_a_million_radians() -> None:
    """2 rad a sample; the range of w allows half a turn more."""
    th, w, y = radians("th"), hg.Signal("w", "rad/s", low=-3e4, high=3e4), radians("y")
    plant = hg.System("encoder", states=(th, w), outputs=(y,), flow=[w, 0], output=[th])
    dt, count = 1e-4, 500_000
    truth = 2 * np.arange(1, count + 1)
    gains = {"Q": (1e-3, 1e6), "R": 1e-4 * dt, "covariance": (1e-2, 1e2), "initial": (0, 2e4)}
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), **gains), dt=dt, real="float")
    y = short_way(truth + 0.01 * np.random.default_rng(1).standard_normal(count), TURN)
    error = short_way(made.run(y=y[:, None]).x[:, 0] - truth, TURN)
    assert truth[-1] == 1e6
    assert rms(error[-10_000:]) < 1.1 * rms(error[:10_000])


# --- bearings -----------------------------------------------------------------------------------------------

ACCEPT = ("singular.bearing", "original.lipschitz", "original.order")


def bearing(name: str, **more: Any) -> hg.Observer:
    px, py = (hg.Signal(each, "m", low=-50, high=50) for each in ("px", "py"))
    vx, vy = (hg.Signal(each, "m/s", low=-5, high=5) for each in ("vx", "vy"))
    plant = hg.System(
        "beacon",
        states=(px, py),
        inputs=(vx, vy),
        outputs=(radians("bearing"),),
        flow=[vx, vy],
        output=[sp.atan2(py, px)],
    )
    gains = {"Q": (1e-4, 1e-4), "R": 2.5e-5 * 0.05, "covariance": (1, 1), "accept": ACCEPT} | more
    made: hg.Observer = getattr(hg.observers, name)(hg.forms.original(plant), **gains)
    return made


@pytest.mark.parametrize("name", ["riccati", "ukf", "iterated_ekf"])
def test_a_bearing_keeps_7_cm_over_the_cut(name: str) -> None:
    """Round a beacon at 20 m, with the speed known."""
    phase = 0.2 * 0.05 * np.arange(900)
    at = 20 * np.column_stack([np.cos(phase), np.sin(phase)])
    v = 4 * np.column_stack([-np.sin(phase), np.cos(phase)])
    y = short_way(phase + 0.005 * np.random.default_rng(1).standard_normal(900), TURN)
    step = hg.sample(bearing(name, initial=(20.5, 0.5)), dt=0.05)
    error = np.hypot(*(step.run(u=v, y=y[:, None], engine="python").x - at).T)
    cut = int(np.argmax(np.abs(np.diff(y)) > 3))
    assert 200 < cut < 400
    assert rms(error[cut - 100 : cut]) < 0.07
    assert rms(error[cut:]) < 0.07


QUADRANTS = [(3.0, 2.0), (-3.0, 2.0), (-3.0, -2.0), (3.0, -2.0), (5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0)]
QUADRANTS += [(-5.0, 1e-9), (-5.0, -1e-9), (1e-9, -5.0), (-1e-3, 1e-3), (40.0, -1e-12)]


@pytest.mark.parametrize(("x", "y"), QUADRANTS)
def test_a_bearing_has_its_slope_in_every_quadrant(x: float, y: float) -> None:
    """(-y, x)/(x^2 + y^2), over the cut too; by the filter's own graph."""
    dynamics = bearing("riccati").dynamics
    z, u = ca.SX.sym("z", 2), ca.SX.zeros(2)
    rows = [dynamics.output_jacobian(z, u), dynamics.output(z, u)]
    (last,) = (each for each in ca.symvar(ca.horzcat(*rows)) if each.name() not in ("z_0", "z_1"))
    row, at = (np.ravel(each.full()) for each in ca.Function("slope", [z, last], rows)((x, y), 0))
    assert np.allclose(row, np.array([-y, x]) / (x * x + y * y), rtol=1e-14, atol=0)
    assert at[0] == pytest.approx(np.arctan2(y, x), rel=1e-15, abs=0)  # numpy's and the C library's differ by 1 ulp


@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", ["riccati", "ukf", "iterated_ekf"])
def test_at_the_beacon_the_bearing_is_not_used(name: str, real: Any) -> None:
    """The direction of no vector: the step predicts, says so, and goes on as soon as there is a direction."""
    step = hg.sample(bearing(name), dt=0.05, real=real)
    step(u=(0, 0), y=np.nan)
    step._kept.places[Place("state", "z")][:] = 0
    there = step(u=(0, 0), y=1.0)
    assert "UNDEFINED_BEARING" in there.flags
    assert there.x.tolist() == [0, 0]
    later = [step(u=(4, 0), y=0.5) for _ in range(20)][-1]
    assert np.isfinite(later.x).all()
    assert "UNDEFINED_BEARING" not in later.flags
