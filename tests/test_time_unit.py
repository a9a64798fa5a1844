"""The unit of time belongs to the model, and whatever speaks of time says it."""

import re
from pathlib import Path

import emitted
import numpy as np
import pytest
from typer import BadParameter
from typer.core import TyperCommand

import hgogen as hg
from hgogen.commands.command import numbers_in
from hgogen.commands.designing import response_
from hgogen.commands.running import noise_, window_
from hgogen.errors import HgogenError
from hgogen.model import load
from hgogen.modelfiles.tuning import Tuning
from hgogen.reading.text_model import BadModelFile, from_table, read, to_text
from hgogen.run import consistency, excitation
from hgogen.signal import of_time, pace, plural
from hgogen.system import BadSystem
from hgogen.targets import c99
from hgogen.trial import Trial

MODELS = Path(__file__).parent.parent / "models"
x = hg.Signal("x", "m", low=-1, high=1)
y = hg.Signal("y", "m")
u = hg.Signal("u", "1/h", low=-1, high=1, rates=((-1, 1),))


def plant(time: str = "h") -> hg.System:
    return hg.System("tank", states=(x,), inputs=(u,), outputs=(y,), flow=[-x * u], output=[x], time=time)


@pytest.mark.parametrize("time", ["", "1/h", "two words", "h\n", "/*", 3600, None])
def test_a_unit_of_time_is_a_plain_word(time: object):
    with pytest.raises(BadSystem, match="is no unit of time; write one plain word"):
        plant(time)
    assert hg.System("tank", states=(x,), outputs=(y,), flow=[x], output=[x]).time == "s"


def test_a_model_file_has_a_unit_of_time(tmp_path: Path):
    (tmp_path / "tank.toml").write_text(to_text(plant("min")))
    read_plant = read(tmp_path / "tank.toml").plant
    assert (read_plant, read_plant.time) == (plant("min"), "min")
    assert "time" not in to_text(plant("s"))
    with pytest.raises(BadModelFile, match="is no unit of time"):
        from_table({"name": "tank", "time": "per hour", "states": {"x": {"flow": "-x"}}, "outputs": {}})


def test_a_unit_is_written_in_the_models_time():
    written = {of_time(unit, "h") for unit in ("1/s", "y^2 s", "z^2/s2", "rows", "")}
    assert written == {"1/h", "y^2 h", "z^2/h2", "rows", ""}
    assert (of_time("1/s", "s"), of_time("m/s", "h", {"m/s"})) == ("1/s", "m/s")  # the last is a signal's own
    assert [pace(0.01, unit) for unit in ("h", "s", "sol")] == ["0.01 h (36 s)", "0.01 s", "0.01 sol"]
    assert (plural("s"), plural("h"), plural("sol")) == ("seconds", "hours", "sol")
    assert u.derivative(1, "h").unit == "(1/h)/h"


@pytest.mark.parametrize(
    ("model", "period"),
    [("contois.toml", "0.01 h (36 s)"), ("bioreactor.py", None), ("cstr.toml", "0.005 min (0.3 s)")],
)
def test_a_header_tells_the_unit_of_time(model: str, period: str | None):
    """In its first lines, in the period, in every gain: nothing of it is said to be in seconds."""
    step = load(str(MODELS / model)).step()
    period = period or pace(step.dt, "h")
    files = c99(step, check=False)
    (text,), manual = (text for name, text in files.items() if name.endswith(".h")), emitted.manual(files)
    for part in (text.split("#include")[0], manual):
        assert f"Time is counted in {step.time}: call it every {period}" in part
    assert f"dt = {period}" in text
    assert f"a sampling period of {period}" in manual
    assert f"for (;;) {{ /* every {period} */" in manual
    assert not re.search(r"\bs2?\]|dt = [\d.e-]+ s\b", text + manual)


def test_errors_about_time_tell_its_unit():
    form = hg.forms.original(plant())
    observer = hg.observers.riccati(form, Q=[1], R=[1])
    for call, said in (
        (lambda: hg.sample(observer), "dt is missing; give the sampling period in hours"),
        (lambda: hg.sample(observer, dt=-1), "must be a positive time in hours"),
        (lambda: hg.sample(observer, dt=0.1, periods={"y": 0}), "must be a positive time in hours"),
        (
            lambda: hg.sample(high_gain(), dt=9),
            " h,",
        ),
        (lambda: hg.gramian(plant(), Trial("far", 2.0, {"x": 1.0}, {"u": 0}), 3.0), "must be times in hours"),
        (lambda: consistency.suggest("y", np.arange(200.0), 0.1, 50.0, "h"), r"d = 50 h must lie within 0\.1\.\.20 h,"),
        (lambda: hg.response(high_gain(), -1), r"must be positive numbers \(rad/h\)"),
        (lambda: numbers_in("fast", "numbers in rad/h", "--omega"), "'fast' must be numbers in rad/h"),
        (lambda: excitation.along(hg.forms.state_affine(plant()), 1, [0.0], [0.0], 1, 5), "d = 5 h on 1 samples"),
        (lambda: untimed().period("high_gain"), "add dt, the time in hours between two calls"),
    ):
        with pytest.raises((HgogenError, BadParameter), match=said):
            call()


def high_gain() -> hg.Observer:
    return hg.observers.high_gain(hg.forms.triangular(moving()), theta=9, poles=(-1, -1))


def untimed() -> Tuning:
    """A tuning without a period."""
    return Tuning("cart.toml", moving(), {"high_gain": {"theta": 9, "poles": (-1, -1)}})


def moving() -> hg.System:
    v = hg.Signal("v", low=-1, high=1)
    return hg.System("cart", states=(x, v), outputs=(y,), flow=[v, -v], output=[x], time="h")


@pytest.mark.parametrize("command", [noise_, response_, window_])
def test_no_option_counts_in_seconds(command: TyperCommand):
    """A command takes times in the unit of its model."""
    helps = [getattr(option, "help", None) or "" for option in command.params]
    assert len(helps) > 3
    assert not [said for said in helps if re.search(r"\(s\)|rad/s|seconds", said)]


def test_a_doubt_about_a_record_tells_the_unit():
    doubts = consistency.suggest("y", np.sin(np.arange(2000) * 0.01), 0.01, 1.0, "h").notes
    assert [said for said in doubts if re.search(r"correlation time is \S+ h in a record of 20 h", said)]
