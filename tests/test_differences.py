"""Derivatives of inputs that no log holds: differences, in runs, shifts and tuning; predictions of a form that reads
an input in its coordinates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import as_json

import hgogen as hg
from hgogen import forms, methods, observers
from hgogen.call import CallableStep
from hgogen.discretisation.runge_kutta import open_loop
from hgogen.logs.changes import Change, ChangeTrial, Map
from hgogen.logs.records import Log
from hgogen.reading.measured import difference, read
from hgogen.run.prediction import predictions
from hgogen.signal import derived
from hgogen.which_forms import of

X, V = hg.Signal("x", low=-3, high=3), hg.Signal("v", low=-3, high=3)
U, Y = hg.Signal("u", low=-1, high=1, rates=((-4, 4),)), hg.Signal("y")
PLANT = hg.System("driven", states=(X, V), inputs=(U,), outputs=(Y,), flow=[V + U, -X - V**3 / 9], output=[X])
MODEL = """
name = "driven"

[states]
x = {low = -3, high = 3, flow = "v + u"}
v = {low = -3, high = 3, flow = "-x - v**3/9"}

[inputs.u]
low = -1
high = 1
rates = [[-4, 4]]

[outputs]
y = {equation = "x"}

[tuning.high_gain]
form = {kind = "phase"}
theta = 8
poles = [-1, -1]
dt = 0.02
"""
DT, COUNT = 0.02, 400
TIMES = DT * np.arange(COUNT)


def course() -> tuple[np.ndarray, np.ndarray]:
    """The input, and the states by classical Runge-Kutta with ten steps a sample."""
    u = np.sin(1.3 * TIMES)
    x, h = [np.array([0.5, 0.0])], DT / 10

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        return np.array([s[1] + np.sin(1.3 * t), -s[0] - s[1] ** 3 / 9])

    for k in range(10 * (COUNT - 1)):
        t, s = k * h, x[-1]
        a = rate(t, s)
        b = rate(t + h / 2, s + h / 2 * a)
        c = rate(t + h / 2, s + h / 2 * b)
        x.append(s + h / 6 * (a + 2 * b + 2 * c + rate(t + h, s + h * c)))
    return u, np.array(x[::10])


def written(folder: Path) -> Path:
    """The log of the course, in which no column holds a derivative."""
    u, x = course()
    np.savetxt(folder / "log.csv", np.column_stack([TIMES, u, x]), delimiter=",", header="t,u,y,v", comments="")
    (folder / "driven.toml").write_text(MODEL)
    return folder


def step() -> CallableStep:
    return hg.sample(observers.high_gain(forms.phase(PLANT), theta=8, poles=[-1, -1]), methods.rk4, DT)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("name", ["u", "u_"])
def test_a_derivative_is_that_of_the_input_that_the_form_read(name: str, order: tuple[int, int]) -> None:
    """u_dot is the name of either's: the input that is in the coordinates counts, wherever it stands."""
    both = [hg.Signal(each, low=-1, high=1, rates=((-4, 4),)) for each in ("u", "u_")]
    used, other = sorted(both, key=lambda each: each.name != name)
    flow = [V + used, -X - V**3 / 9 + other]
    plant = hg.System(
        "driven", states=(X, V), inputs=tuple(both[i] for i in order), outputs=(Y,), flow=flow, output=[X]
    )
    assert derived(forms.phase(plant).system.inputs) == {"u_dot": (name, 1)}


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_derivative_of_an_input_that_is_a_derivative_is_taken_of_the_input(
    order: tuple[int, int], tmp_path: Path
) -> None:
    """A log that holds u alone gives u_dot, which the plant reads, and u_dot_dot, which its form does."""
    rate, written_to = hg.Signal("u_dot", low=-4, high=4, rates=((-9, 9),)), tmp_path / "log.csv"
    inputs = tuple((U, rate)[i] for i in order)
    plant = hg.System(
        "driven", states=(X, V), inputs=inputs, outputs=(Y,), flow=[V + rate, -X - V**3 / 9 + U], output=[X]
    )
    wanted = forms.phase(plant).system.inputs
    np.savetxt(written_to, np.column_stack([TIMES, TIMES**2]), delimiter=",", header="t,u", comments="")
    record = read(written_to, {s.name: s.name for s in wanted}, dt=DT, time="t", rates=derived(wanted))
    assert set(record.names) == {"u", "u_dot", "u_dot_dot"}
    assert np.allclose(record.values[2:, record.names.index("u_dot")], 2 * TIMES[2:] - DT)
    assert np.allclose(record.values[:, record.names.index("u_dot_dot")], 2)


def test_differences_are_exact_on_polynomials_of_their_order() -> None:
    t = 0.25 * np.arange(6)
    assert difference(3 * t + 1, 1, 0.25).tolist() == [3.0] * 6
    assert difference(t**2, 2, 0.25).tolist() == [2.0] * 6
    assert difference(t**2, 1, 0.25).tolist() == [0.25, *(t[1:] + t[:-1])]  # of the interval before


def test_a_missing_sample_leaves_both_differences_out_and_a_single_one_has_none() -> None:
    assert np.isnan(difference(np.array([0, 1, np.nan, 3, 4]), 1, 1.0)).tolist() == [False, False, True, True, False]
    assert np.isnan(difference(np.array([2.0]), 1, 1.0)).all()


def test_derivatives_are_known_by_their_names() -> None:
    u, w = hg.Signal("u"), hg.Signal("w_dot")
    assert derived([u, w, u.derivative(3)]) == {"u_dddot": ("u", 3)}
    assert derived([w, w.derivative(1)]) == {w.derivative(1).name: ("w_dot", 1)}
    assert derived([u]) == {}


def test_a_record_has_the_derivatives_that_a_form_reads() -> None:
    u, x = course()
    log = Log(u[:, None], x[:, :1], DT).of(step().inputs)
    assert [s.name for s in step().inputs] == ["u", "u_dot"]
    assert log.u.shape == (COUNT, 2)
    # u'(t - dt/2) = 1.3 cos is met to 1.3^3 dt^2/24
    assert np.abs(log.u[1:, 1] - 1.3 * np.cos(1.3 * (TIMES[1:] - DT / 2))).max() < 1.3**3 * DT**2 / 24
    assert Log(u[:, None], x[:, :1], DT).of(PLANT.inputs).u.tolist() == u[:, None].tolist()


def test_a_log_that_holds_a_derivative_is_read_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,u,u_dot\n0,0,7\n1,1,7\n2,4,7\n")
    rates, columns = {"u_dot": ("u", 1)}, {"u": "u", "u_dot": "u_dot"}
    there = read(tmp_path / "a.csv", columns, dt=None, time="t", rates=rates)
    assert there.values[:, 1].tolist() == [7, 7, 7]
    (tmp_path / "b.csv").write_text("t,u\n0,0\n1,1\n2,4\n")
    taken = read(tmp_path / "b.csv", columns, dt=None, time="t", rates=rates)
    assert taken.names == ("u", "u_dot")
    assert taken.values[:, 1].tolist() == [1, 1, 3]
    assert [note for note in taken.report.notes if "u_dot" in note] == [
        "u_dot is taken as differences of u from sample to sample: no column gives it"
    ]
    assert taken.shifted({"u": 1}).values[1:].tolist() == [[0, 1], [1, 1]]
    assert there.shifted({"u": 1}).values[1:].tolist() == [[0, 7], [1, 7]]


def test_another_time_or_sign_of_an_input_is_that_of_its_derivative_too() -> None:
    u, x = course()
    log = Log(u[:, None], x[:, :1], DT).of(step().inputs)
    for by, factor in ((0, -1.0), (2, 1.0), (-3, 1.0), (0, 1000.0)):
        trial = ChangeTrial(step(), log.u, log.y, 0, None)
        whole = trial.changed(Change((0,), Map("{}", factor, 0.0, ""), shift=by))
        moved, outputs = whole[:, : log.u.shape[1]], whole[:, log.u.shape[1] :]
        inner = slice(3 + abs(by), COUNT - 3 - abs(by))
        assert moved[inner].tolist() == (factor * np.roll(log.u, by, axis=0))[inner].tolist()
        assert outputs.tolist() == log.y.tolist()


def test_coordinates_that_read_an_input_are_entered_with_it() -> None:
    form = forms.phase(PLANT)
    z = open_loop(form, DT, "line").entry([0.5, 0.25], [0.75, 0.0])
    assert np.array(z).ravel().tolist() == [0.5, 1.0]  # (x, v + u)


def test_such_a_form_predicts_as_its_plant_does() -> None:
    u, x = course()
    log, made = Log(u[:, None], x[:, :1], DT).of(step().inputs), step()
    run = replace(made.run(u=log.u, y=log.y), x=x)  # from the true states
    one, ten, _ = predictions(made, run, log.u, log.y, (1, 10))
    # u' is off by up to u'' dt = .034, and y by dt^2/2 times that: 7e-6 of a step, a hundred times that of ten.
    assert one.model < 7e-6
    assert ten.model < 7e-4
    assert one.copying is not None
    assert one.copying > 1e-3


@pytest.mark.full
def test_the_noise_of_such_a_form_is_found_in_a_record() -> None:
    """The likelihood of a filter on it reads u' as well; the forms that a survey asks for at once do not."""
    u, x = course()
    y = x[:, :1] + 0.01 * np.random.default_rng(0).normal(size=(COUNT, 1))
    made = hg.tune(PLANT, hg.Log(u, y, DT), observers=["riccati"], rows=[of("phase", PLANT)])
    best = made.best
    assert best.first.row.kind == "phase"
    assert best.noise is not None
    assert best.noise.sample["y"] == pytest.approx(0.01, rel=0.15)  # of 400 samples: .01/sqrt(800) is 3.5 %


@pytest.mark.full
def test_the_commands_take_such_a_record(tmp_path: Path) -> None:
    folder = written(tmp_path)
    model, options = str(folder / "driven.toml"), ("--data", str(folder / "log.csv"), "--time", "t", "--truth", "v=v")
    report = as_json("run", model, *options, "--out", str(folder / "run"))
    assert any("u_dot is taken as differences of u" in note for note in report["record"]["notes"])
    assert report["hidden"]["v"] < 0.1
    tuned = as_json("tune", model, *options, "--observers", "high_gain,riccati", "--out", str(folder / "tuned"))
    assert "u_dot is taken as differences of u from sample to sample: no column gives it" in tuned["notes"]
    hidden = {row["name"]: row["hidden"]["v"] for row in tuned["rows"] if row["hidden"]}
    assert hidden["high_gain, as declared"] < 0.1  # its mean is 1.1


@pytest.mark.full
def test_an_input_of_the_plant_has_its_column_whatever_its_name(tmp_path: Path) -> None:
    """u_dot is an input of its own here, which the log holds, and which is the derivative of u by its name alone."""
    model, log = tmp_path / "driven.toml", tmp_path / "log.csv"
    declared = MODEL.replace('flow = "v + u"', 'flow = "v"').replace("- v**3/9", "- v**3/9 + u + u_dot")
    declared = declared.replace("rates = [[-4, 4]]", "[inputs.u_dot]\nlow = -2\nhigh = 2")
    model.write_text(declared.replace('form = {kind = "phase"}\n', ""))
    u, states = course()
    columns = np.column_stack([TIMES, u, 1.3 * np.cos(1.3 * TIMES), states[:, 0]])
    np.savetxt(log, columns, delimiter=",", header="t,u,u_dot,y", comments="")
    options = ("--data", str(log), "--time", "t", "--observers", "high_gain", "--out", str(tmp_path / "out"))
    tuned = as_json("tune", str(model), *options)
    assert not [note for note in tuned["notes"] if "differences" in note]
