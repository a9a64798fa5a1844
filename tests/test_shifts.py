"""Signals taken some samples later or earlier, and the shift or sign that fits a record better."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from test_cli import hgogen

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.logs import changes
from hgogen.logs.changes import Better, better_change
from hgogen.model import load
from hgogen.reading.log import BadRecord, shifts_of
from hgogen.reading.measured import shifted
from hgogen.run import native
from hgogen.trial import noisy, simulate

DT, N = 0.01, 1500
U, Y, Z = hg.Signal("pump"), hg.Signal("level"), hg.Signal("flow")


def driven(lag: int, sign: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The drive of a pendulum as it was logged, and the angle, which obeys the drive `lag` samples later, times
    `sign`; with a reading's noise of a milliradian."""
    draw = np.random.default_rng(8)
    logged = np.repeat(draw.uniform(-1, 1, N // 10), 10)
    drive = sign * np.roll(logged, lag)
    if lag > 0:
        drive[:lag] = 0
    x, q = np.array([0.5, 0.0]), []

    def rate(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], -19.6 * np.sin(x[0]) - 0.1 * x[1] + u])

    for k in range(N):
        q.append(x[0])
        now, then = drive[k], drive[min(k + 1, N - 1)]
        middle = (now + then) / 2
        a = rate(x, now)
        b = rate(x + DT / 2 * a, middle)
        c = rate(x + DT / 2 * b, middle)
        x = x + DT / 6 * (a + 2 * b + 2 * c + rate(x + DT * c, then))
    return logged[:, None], (np.array(q) + 1e-4 * draw.standard_normal(N))[:, None]


@pytest.fixture(scope="module")
def step() -> CallableStep:
    return load("pendulum").step("riccati").rebuilt(dt=DT)


def test_a_column_is_shifted_and_its_ends_are_missing() -> None:
    values = np.array([1.0, 2, 3, 4])
    np.testing.assert_array_equal(shifted(values, 1), [np.nan, 1, 2, 3])
    np.testing.assert_array_equal(shifted(values, -3), [4, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(shifted(values, 0), values)
    assert np.isnan(shifted(values, 9)).all()


@pytest.mark.parametrize("lag", [-3, -1, 2, 3])
def test_the_shift_by_which_a_log_was_made_fits_best(step: CallableStep, lag: int) -> None:
    one = better_change(step, *driven(lag), 100, "c")
    assert one is not None
    assert (one.signal, one.shift, one.factor) == ("tau", lag, 1)
    assert f"--shift tau={lag + 1}" in one.sentence({"tau": 1}, {})[1]


def test_a_long_shift_is_found_and_both_readings_of_it_are_named(step: CallableStep) -> None:
    one = better_change(step, *driven(8), 100, "c")
    assert one is not None
    assert (one.signal, one.shift, one.late) == ("tau", 8, ("y",))
    ages = 'say delays = {y = 8} in the table of the observer and --map y_age="8 + 0*tau"'
    assert f"samples of y come 8 late, {ages}" in one.sentence({}, {})[1]
    assert "or tau acts 8 late, say --shift tau=8" in one.sentence({}, {})[1]
    assert one.sentence({}, {})[1].endswith("; hgogen fit --lag y tells whether a first-order lag fits instead")


def test_an_input_in_another_unit_is_found(step: CallableStep) -> None:
    u, y = driven(0)
    one = better_change(step, u / 1000, y, 100, "c")
    assert one is not None
    assert (one.signal, one.factor, one.shift) == ("tau", 1e3, 0)
    assert '--map tau="1000*tau"' in one.sentence({}, {})[1]


def test_the_other_sign_is_said(step: CallableStep) -> None:
    one = better_change(step, *driven(0, -1), 100, "c")
    assert one is not None
    assert (one.signal, one.shift, one.factor) == ("tau", 0, -1)
    assert '--map tau="-[u (V)]"' in one.sentence({}, {"tau": "[u (V)]"})[1]


def test_nothing_is_said_where_nothing_is_better(step: CallableStep) -> None:
    u, y = driven(0)
    assert better_change(step, u, y, 100, "c") is None
    assert better_change(step, u[:5], y[:5], 0, "c") is None  # shorter than the predictions
    assert better_change(step, u, np.full_like(y, 0.3), 0, "c") is None  # what stands still is copied without error
    assert better_change(step, u, np.full_like(y, np.nan), 0, "c") is None


def test_a_shift_that_gains_little_is_not_named(step: CallableStep, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a reading so noisy that the right shift takes a seventh of the error, and not the fifth that it has to."""
    u, y = driven(1)
    noisy = y + 3e-4 * np.random.default_rng(1).standard_normal(y.shape)
    assert better_change(step, u, noisy, 0, native.engine()) is None
    monkeypatch.setattr(changes, "CLEAR", 1.0)
    slight = better_change(step, u, noisy, 0, native.engine())
    assert slight is not None
    assert (slight.shift, slight.error < slight.present) == (1, True)


def courses(true: str, sigma: float, between: str) -> Better | None:
    """The better change of x' = u - x, with an input drawn anew for each sample, which is held, or goes on along a
    line; no shift helps."""
    x, u, y = hg.Signal("x", low=-5, high=5), hg.Signal("u", low=-5, high=5), hg.Signal("y")
    plant = hg.System("slow", states=(x,), inputs=(u,), outputs=(y,), flow=[u - x], output=[x])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1e-3,), noise={"y": 0.01}, covariance=(1,))
    draw, dt, at, rows = np.random.default_rng(2), 0.3, 0.0, []
    inputs = draw.uniform(-2, 2, 500)
    for last, now in zip([0, *inputs[:-1]], inputs, strict=True):
        for part in (np.arange(60) + 0.5) / 60:
            at += dt / 60 * ((now if true == "hold" else last + (now - last) * part) - at)
        rows.append([at + sigma * draw.normal()])
    step = hg.sample(observer, dt=dt, between=between)
    return better_change(step, inputs[:, None], np.array(rows), 0, "python")


@pytest.mark.parametrize("true", ["hold", "line"])
def test_the_other_course_of_inputs_is_named(true: str) -> None:
    for between in ("hold", "line"):
        one = courses(true, 0.01, between)
        assert (one and (one.between, one.shift)) == (None if between == true else (true, 0))


def test_a_course_that_gains_little_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of samples so noisy that the right course takes 7 % of the error, and not the tenth that it has to."""
    assert courses("hold", 0.3, "line") is None
    monkeypatch.setattr(changes, "CLEAR_COURSE", 1.0)
    slight = courses("hold", 0.3, "line")
    assert slight is not None
    assert 0.9 < slight.error / slight.present < 0.95


@pytest.mark.full
def test_an_estimate_that_settles_does_not_blame_a_signal() -> None:
    """Of a record that its own plant made: while the estimate settles, another sign of u may predict better by chance,
    and the first eighth has most of the squared error."""
    model = load("hindmarsh_rose")
    bursts, one = model.trials()[0], model.step("riccati")
    truth = simulate(model.plant, replace(bursts, duration=600 * one.dt), one.dt)
    (y,) = noisy(model.plant, truth, bursts, (0,))
    one = one.started(lambda form: {**one.observer.initial, "x": y[0, 0]})
    assert better_change(one, truth.u, y, 0, native.engine()) is None


@pytest.mark.full
def test_an_input_that_stands_still_has_no_other_sign() -> None:
    """Of an estimate that settles too slowly its negative, an offset, makes up for what is wrong of hidden states."""
    model = load("hindmarsh_rose")
    bursts, one = model.trials()[0], model.step("ukf")
    truth = simulate(model.plant, replace(bursts, duration=250 * one.dt), one.dt)
    (y,) = noisy(model.plant, truth, bursts, (0,))
    one = one.started(lambda form: {**one.observer.initial, "x": y[0, 0]})
    assert np.ptp(truth.u) == 0
    assert better_change(one, truth.u, y, 0, native.engine()) is None


@pytest.mark.full
def test_a_change_that_leads_the_estimate_to_the_right_one_is_no_fault_of_the_signal() -> None:
    """From its first estimate a filter of an induction motor takes the speed for another one; with any sample later it
    does not."""
    model = load("induction_motor")
    start_up, one = model.trials()[0], model.step("riccati")
    truth = simulate(model.plant, replace(start_up, duration=600 * one.dt), one.dt)
    (y,) = noisy(model.plant, truth, start_up, (0,))
    assert better_change(one, truth.u, y, 0, native.engine()) is None


def test_predictions_worse_than_copying_tell_nothing(step: CallableStep, monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = driven(0, -1)
    assert better_change(step, u[:300], y[:300], 0, native.engine()) is not None
    monkeypatch.setattr(changes, "_scale", lambda outputs, y, ahead: np.full(1, 1e-6))  # as if copying erred by that
    assert better_change(step, u[:300], y[:300], 0, native.engine()) is None


def test_few_samples_tell_nothing(step: CallableStep) -> None:
    """Neither do many of which few count."""
    u, y = driven(0, -1)
    assert better_change(step, u[:80], y[:80], 0, native.engine()) is not None
    assert better_change(step, u[:79], y[:79], 0, native.engine()) is None
    assert better_change(step, u[:179], y[:179], 100, native.engine()) is None


def test_shifts_are_read_by_name() -> None:
    assert shifts_of("log", ("u=1",), (U,), (Y, Z)) == {"pump": 1}
    assert shifts_of("log", ("pump=-2, flow=3", "level=0"), (U,), (Y, Z)) == {"pump": -2, "flow": 3, "level": 0}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (("y=1",), "names no signal; the signals are pump, level, flow"),
        (("u=1", "pump=2"), "gives pump twice"),
        (("u=0.5",), "a whole number, such as u=1"),
        (("u",), "must read SIGNAL=SAMPLES"),
    ],
)
def test_a_bad_shift_is_a_sentence(texts: tuple[str, ...], said: str) -> None:
    with pytest.raises(BadRecord, match="log: --shift") as caught:
        shifts_of("log", texts, (U,), (Y, Z))
    assert said in str(caught.value)


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_run_takes_a_shift_and_says_which_is_better(tmp_path: Path) -> None:
    rows = "\n".join(f"{k * DT:.4f},{a:.9f},{b:.9f}" for k, (a, b) in enumerate(np.hstack(driven(2))))
    (tmp_path / "log.csv").write_text(f"t,tau,y\n{rows}\n")
    words = ("run", "pendulum", "--data", str(tmp_path / "log.csv"), "--time", "t", "--dt", "0.01")
    words = (*words, "--observer", "riccati", "-o", str(tmp_path))
    answer = json.loads(hgogen(*words, "--json")[0])
    assert (answer["better"]["signal"], answer["better"]["shift"]) == ("tau", 2)
    assert "--shift tau=2" in " ".join(hgogen(*words)[0].split())
    answer = json.loads(hgogen(*words, "--shift", "u=2", "--json")[0])
    assert answer["better"] is None
    assert answer["record"]["notes"] == ["tau is taken later than it was logged, by samples: 2"]
    further = json.loads(hgogen(*words, "--shift", "u=1", "--json")[0])
    assert any("--shift tau=2" in note for note in further["notes"])
    _, said = hgogen(*words, "--shift", "u=1500", status=2)
    assert "leaves nothing" in said


def vehicle(offset: float = 0.0, scale: float = 1.0, sign: float = 1.0) -> tuple[CallableStep, np.ndarray, np.ndarray]:
    """A vehicle at 3 m/s with a gyro and a compass ten times a second and positions once a second, and its log; the
    compass reads `offset` more, the gyro `scale` times the rate, the position east `sign` times itself."""
    east, north = (hg.Signal(name, "m", low=-200, high=200) for name in ("x_east", "x_north"))
    psi, rate = hg.Signal("psi", "rad", period=2 * np.pi), hg.Signal("gyro", "rad/s", low=-1, high=1)
    outputs = *(hg.Signal(name, "m") for name in ("east", "north")), hg.Signal("compass", "rad", period=2 * np.pi)
    states, flow = (east, north, psi), [3 * sp.cos(psi), 3 * sp.sin(psi), rate]
    plant = hg.System("vehicle", states=states, inputs=(rate,), outputs=outputs, flow=flow, output=list(states))
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(0.3, 0.3, 0.003), R=(0.04, 0.04, 4e-4), theta=1)
    draw, t = np.random.default_rng(5), 0.1 * np.arange(1600)
    u = 0.3 * np.sin(0.2 * t) + 0.2 * np.sin(0.05 * t)
    heading = np.cumsum(np.append(0, 0.1 * (u[1:] + u[:-1]) / 2))
    y = np.column_stack([0.3 * np.cumsum(np.cos(heading)), 0.3 * np.cumsum(np.sin(heading)), heading + offset])
    y += draw.normal(size=y.shape) * (0.5, 0.5, 0.06)
    y[:, 2] = (y[:, 2] + np.pi) % (2 * np.pi) - np.pi
    y[:, 0] *= sign
    y[np.arange(1600) % 10 > 0, :2] = np.nan
    return hg.sample(observer, dt=0.1, between="line"), scale * u[:, None], y


@pytest.mark.parametrize(
    ("fault", "option"),
    [
        ({}, None),
        ({"offset": 0.15}, '--map compass="compass - 0.'),
        ({"offset": 0.5}, '--map compass="compass - 0.'),
        ({"offset": -2.6}, '--map compass="compass + 2.'),
        ({"scale": 1.25}, '--map gyro="gyro/1.'),
        ({"sign": -1.0}, '--map east="-east"'),
    ],
    ids=str,
)
def test_a_fault_is_named_that_shows_in_a_slow_sensor_or_over_many_samples(
    fault: dict[str, float], option: str | None
) -> None:
    """Over 5 of 10 samples a second, the noise of the compass hides the turning of the vehicle; the position that shows
    where the compass points has a tenth of the samples."""
    one = better_change(*vehicle(**fault), 100, native.engine())
    assert (one is None) == (option is None)
    if one is not None:
        ((name, size),) = fault.items()
        assert one.fault == name
        assert option in (fix := one.sentence({}, {})[1])
        assert name == "sign" or abs(float(re.findall(r"[\d.]+", fix)[0])) == pytest.approx(abs(size), rel=0.08)
        assert one.error < 0.8 * one.present


@pytest.mark.parametrize(
    ("factor", "text", "fault"),
    [(1.0, "{} + 273.15", "scale"), (1.0, "{} - 0.5", "offset"), (-1.0, "-{}", "sign"), (0.5, "{}/2", "scale")],
)
def test_another_unit_is_no_offset_of_the_sensor(factor: float, text: str, fault: str) -> None:
    assert changes.Better("y", 0, factor, 0.1, 1.0, 5, map=text).fault == fault
