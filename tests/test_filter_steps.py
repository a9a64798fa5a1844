"""The step length that is advised of a filter: at corners of its box, at rest, and by trials of shipped models."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from step_lengths import pairs, row

import hgogen as hg
from hgogen.estimators.riccati_part import Riccati
from hgogen.estimators.step_lengths import factored_lengths
from hgogen.model import load
from hgogen.step import StepMayFail

MODELS = Path(__file__).resolve().parents[1] / "models"


def test_what_grows_at_a_corner_only_while_the_plant_passes_is_not_much() -> None:
    """An empty upper tank at full pump: its error grows up to 4.2 fold from 4.3 s on, which was advised, and decays."""
    (pair,) = pairs(load(MODELS / "cascaded_tanks.py"), ("decaying",))
    take = pair.lengths()[1]
    assert 20 / 4 < take < 12  # the trial settles up to half of its hold, 20 s
    assert pair.settles(take)


@pytest.mark.full
def test_no_step_is_advised_at_which_a_neuron_at_rest_is_lost() -> None:
    """At a constant current of 1 x rests at -1.4, where errors grow by steps of .13 to .18. The trial has a current of
    2.5, bursts, and settles up to half a second."""
    observer = load(MODELS / "hindmarsh_rose.toml").step("riccati").observer
    (part,) = (part for part in observer.parts if isinstance(part, Riccati))
    take = factored_lengths(part, 10.0).take
    assert 0.05 < take < 0.1
    assert resting(observer, take) < 0.01
    assert resting(observer, 0.14) > 10


def resting(observer: hg.Observer, dt: float) -> float:
    """The largest late error of w, in 60 s of a neuron that is excited once and rests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        step = hg.sample(observer, dt=dt)
    fine = round(dt / 0.005)
    now, x = np.array([-1.0, -5.0, 1.0]), []
    for k in range(12000):
        x += [now] if k % fine == 0 else []
        middle = now + dt / fine / 2 * neuron(now)
        now = now + dt / fine * neuron(middle)
    true = np.array(x)
    run = step.run(u=np.ones((len(true), 1)), y=true[:, :1])
    return float(np.abs(run.x - true)[len(true) // 2 :, 1].max())


def neuron(x: np.ndarray) -> np.ndarray:
    """Hindmarsh and Rose's, at a current of 1."""
    v, w, z = x
    return np.array([w - v**3 + 3 * v**2 - z + 1, 1 - 5 * v**2 - w, 0.006 * (4 * (v + 1.6) - z)])


@pytest.mark.full
def test_no_step_is_advised_at_which_a_motor_at_full_speed_is_lost() -> None:
    """In field weakening, i_d = -14 A, the motor turns at 285 rad/s within its voltages; its trial reaches 150, and
    settles by steps six times as long as is advised."""
    own = load(MODELS / "pmsm.toml").step("riccati")
    (part,) = (part for part in own.observer.parts if isinstance(part, Riccati))
    take = factored_lengths(part, 10.0).take
    assert 0.003 < take < 0.0035
    assert weakened(own.observer, take) < 1
    assert weakened(own.observer, 4 * take) > 40


def weakened(observer: hg.Observer, dt: float) -> float:
    """The largest late error of w (rad/s), in 2 s at full speed, from an error of 40."""
    speed, i_d = 285.0, -14.0
    i_q = 0.5 * speed / 500
    now, true, voltages = np.array([i_d, i_q, speed]), [], []
    for k in range(int(2 / dt)):
        ripple = 300 * np.sin(5 * k * dt)
        u = np.array([200 * i_d - speed * i_q, 200 * i_q + speed * i_d + 30 * speed + ripple])
        true.append(now)
        voltages.append(u)
        for _ in range(200):
            middle = now + dt / 400 * motor(now, u)
            now = now + dt / 200 * motor(middle, u)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        started = observer.started(lambda form: {"i_d": i_d, "i_q": i_q, "w": speed - 40})
        step = hg.sample(started, dt=dt, between="hold")
    run = step.run(u=np.array(voltages), y=np.array(true)[:, :2])
    return float(np.abs(run.x - np.array(true))[len(true) // 2 :, 2].max())


def motor(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """That of pmsm.toml."""
    i_d, i_q, w = x
    return np.array([-200 * i_d + w * i_q + u[0], -200 * i_q - w * i_d - 30 * w + u[1], 500 * i_q - 0.5 * w])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "name"),
    [
        ("cascaded_tanks", "decaying"),
        ("cascaded_tanks", "hamilton_jacobi"),
        ("disturbed_pendulum", "bank"),
        ("fitzhugh_nagumo", "kalman_like"),
        ("haldane", "riccati"),
    ],
)
def test_what_is_advised_of_a_filter_is_neither_too_long_nor_too_short(model: str, name: str) -> None:
    """Before its closed loop was looked at, the bank of the pendulum and the Kalman-like one failed."""
    rows = [row(pair) for pair in pairs(load(next(MODELS.glob(f"{model}.*"))), (name,))]
    assert rows
    assert not [str(verdict) for verdict in rows if not verdict.holds]
