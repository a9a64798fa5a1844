"""A trial whose own plant leaves the ranges that it declares."""

import json
import math
from pathlib import Path

import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.run.metrics import leaving_notes, leaving_signals
from hgogen.trial import Jump, Trial, t, try_out

ESCAPING = """name = "escaping"
states.x1 = {unit = "V", low = -3, high = 3, flow = "x1 + u"}
inputs.u = {low = -1, high = 1}
outputs.y = {unit = "V", equation = "x1"}
observer = {kind = "high_gain", theta = 5, poles = [-1], method = "rk4", dt = 1e-2}
trial = {duration = 4, start = {x1 = 1}, inputs = {u = "0"}, seeds = 1}
"""


def tried(drive: object = 0, start: float = 1.0, duration: float = 4.0, **changes: object) -> tuple[object, ...]:
    x, u = hg.Signal("x", low=-3, high=3), hg.Signal("u", low=-1, high=1)
    plant = hg.System("grows", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=[x + u], output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=5, poles=(-1,))
    step = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")
    trial = Trial("grown", duration, {"x": start}, {"u": drive}, seeds=(0,), **changes)  # type: ignore[arg-type]
    return leaving_signals(plant, next(try_out(step, trial, "python")))


def test_a_state_that_leaves_its_range() -> None:
    """x = exp(t), which passes 3 at log 3 = 1.0986 and ends at exp(4)."""
    (one,) = tried()
    assert (one.signal, one.low, one.high, one.time) == ("x", -3, 3, pytest.approx(1.10))
    assert one.value == pytest.approx(math.exp(1.1), rel=1e-9)
    assert one.farthest == pytest.approx(math.exp(4), rel=1e-9)
    (said,) = leaving_notes("grown", [one], "h")
    assert said.startswith(
        "trial grown, the plant itself: x leaves its range -3..3 at t = 1.1 h, where it is 3.00417, and gets as far as "
        "54.5982. The proofs hold on the ranges alone"
    )


def test_an_input_that_leaves_its_range() -> None:
    """Below, and back again."""
    (one,) = tried(-2 * t * (2 - t), duration=2.0)
    assert one.signal == "u"
    assert (one.time, one.farthest) == (pytest.approx(0.30), pytest.approx(-2))


def test_a_plant_in_its_ranges_says_nothing() -> None:
    """To the end of the range, and along it."""
    assert tried(duration=1.09) == ()
    assert tried(-1, start=1.0) == ()
    assert tried(-t / t, start=1.0, jumps=Jump(2, "x", 1.0)) == ()
    assert list(leaving_notes("grown", (), "s")) == []


@pytest.mark.ordinary("command0")
@pytest.mark.parametrize("command", [("simulate", "--engine", "python"), ("compare", "--engine", "python")])
def test_the_commands_say_so(command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "escaping.toml").write_text(ESCAPING)
    name, *options = command
    out, err = hgogen(name, "escaping.toml", *options, "--json")
    assert "the plant itself: x1 leaves its range -3..3 at t = 1.1 s, where it is 3.00417" in err
    (trial,) = json.loads(out)["trials"]
    assert [(one["signal"], one["time"]) for one in trial["left"]] == [("x1", pytest.approx(1.1))]
