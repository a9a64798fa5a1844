"""A record most of whose samples a step rejects: the likely cause, and the map that mends it."""

import json
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.logs.records import range_warnings, wider
from hgogen.model import load
from hgogen.run.prediction import clamped

MODEL = """
name = "swing"
[states.q]
unit = "{unit}"
low = {low}
high = {high}
flow = "w"
[states.w]
unit = "{unit}/s"
low = -60
high = 60
flow = "-4*(q - {middle}) - 0.2*w"
[outputs.y]
unit = "{unit}"
equation = "q"
[tuning.riccati]
Q = {{ q = 1e-7, w = 1e-3 }}
R = 1e-6
dt = 0.02
"""


def written(folder: Path, unit: str, low: float, high: float, scale: float, shift: float, name: str = "y") -> list[str]:
    """A model of an oscillator about the middle of its range, a log of what it does in other units, and the words that
    run the one over the other."""
    from_text = MODEL.format(unit=unit, low=low, high=high, middle=(low + high) / 2)
    (folder / "swing.toml").write_text(from_text)
    t = np.arange(600) * 0.02
    q = (low + high) / 2 + 0.35 * (high - low) * np.exp(-0.1 * t) * np.cos(np.sqrt(4 - 0.01) * t)
    rows = "\n".join(f"{a:.4f},{scale * b + shift:.10g}" for a, b in zip(t, q, strict=True))
    (folder / "log.csv").write_text(f"t,{name}\n{rows}\n")
    data = ("--data", str(folder / "log.csv"), "--time", "t", "--map", f"y={name}")
    return ["run", str(folder / "swing.toml"), *data, "--observer", "riccati", "-o", str(folder)]


CAUSES = {
    "degrees": ("rad", -1, 1, 180 / np.pi, 0, 'y="pi/180*y"'),
    "Celsius": ("K", 290, 310, 1, -273.15, 'y="y + 273.15"'),
    "kelvin": ("degC", 10, 40, 1, 273.15, 'y="y - 273.15"'),
    "milli": ("m", 0.5, 1.5, 1000, 0, 'y="y/1000"'),
    "sign": ("m", 2, 3, -1, 0, 'y="-y"'),
    "offset": ("m", 0, 1, 1, 20, 'y="y - 20'),
}


@pytest.mark.ordinary("degrees", "Celsius", "kelvin", "milli", "sign", "offset")
@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.usefixtures("undrawn")
def test_the_cause_is_named_and_its_map_mends_it(cause: str, tmp_path: Path) -> None:
    unit, low, high, scale, shift, fix = CAUSES[cause]
    words = written(tmp_path, unit, low, high, scale, shift)
    out, said = hgogen(*words, "--json", status=1)
    said = " ".join(said.split())
    assert "of the samples of y were rejected" in said
    assert fix in said
    (one,) = json.loads(out)["rejected"]
    assert one["share"] > 0.5
    mended = ["--map" if word == "--map" else word for word in words]
    mended[mended.index("y=y")] = f"y={one['map']}"
    answer = json.loads(hgogen(*mended, "--json")[0])
    assert answer["rejected"] == []


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_a_map_of_an_expression_or_of_a_name_in_brackets_stands_in_one(tmp_path: Path) -> None:
    words = written(tmp_path, "rad", -1, 1, 180 / np.pi, 0, "angle #1")
    assert 'y="pi/180*[angle #1]"' in " ".join(hgogen(*words, status=1)[1].split())
    words[words.index("y=angle #1")] = "y=2*[angle #1]/2"
    assert 'y="pi/180*(2*[angle #1]/2)"' in " ".join(hgogen(*words, status=1)[1].split())


@pytest.mark.usefixtures("undrawn")
def test_what_no_map_mends_is_said(tmp_path: Path) -> None:
    words = written(tmp_path, "m", 0, 1, 1e7, 20)
    assert "no usual map makes it fit" in " ".join(hgogen(*words, status=1)[1].split())


@pytest.mark.usefixtures("undrawn")
def test_a_few_rejected_samples_are_no_cause(tmp_path: Path) -> None:
    words = written(tmp_path, "m", 0, 1, 1, 0)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    lines[20:120] = [f"{line.split(',')[0]},99" for line in lines[20:120]]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    answer = json.loads(hgogen(*words, "--json")[0])
    assert answer["status"]["REJECTED_Y"] == 100
    assert answer["rejected"] == []


def test_an_input_in_another_unit_is_said() -> None:
    step = load("pendulum").step("riccati")  # whose drive has the range -1 .. 1
    t = np.arange(200)
    milli, huge, inside = (scale * (2 + np.sin(t / 9))[:, None] / 3 for scale in (1e3, 1e9, 1.0))
    (said,) = map(str, clamped(step, milli, {"tau": "[u (mV)]"}))
    assert "beyond its declared range, -1..1, in 100 % of the samples" in said
    assert '--map tau="[u (mV)]/1000"' in said
    (said,) = map(str, clamped(step, huge, {"tau": "u"}))
    assert "check its column and its unit" in said
    assert not list(clamped(step, inside, {"tau": "u"}))
    assert not list(clamped(step, np.full((5, 1), np.nan), {"tau": "u"}))


def test_an_input_that_is_mostly_off_may_have_another_unit() -> None:
    """0 is 0 in every unit."""
    step = load("pendulum").step("riccati")
    (said,) = map(str, clamped(step, 1e3 * (np.arange(200) % 5 == 0)[:, None], {"tau": "u"}))
    assert "in 100 % of the samples that are not 0" in said
    assert '--map tau="u/1000"' in said


@pytest.mark.usefixtures("undrawn")
def test_samples_beyond_the_range_of_their_state_are_told_where_none_is_rejected(tmp_path: Path) -> None:
    """Of the other sign, and yet within the width of the range beside it, where a sample is still taken."""
    answer = json.loads(hgogen(*written(tmp_path, "m", 0, 10, -1, 2, "height"), "--json")[0])
    assert "REJECTED_Y" not in {bit for bit, count in answer["status"].items() if count}
    (said,) = (note for note in answer["notes"] if "declared range" in note)
    assert said.startswith("y leaves the declared range of q, 0..10, in ")
    assert f" of {answer['record']['samples']} samples, as far as -6." in said


def test_the_plausible_cause_of_samples_beyond_a_range_is_said() -> None:
    """Without a fault it is the range, whose new ends are named; a fault comes first; where none judged, neither."""
    q = hg.Signal("q", low=0, high=10)
    plant = hg.System("p", states=(q,), outputs=(hg.Signal("y"),), flow=[0 * q], output=[q])
    log = hg.Log(np.zeros((20, 0)), np.linspace(4, 12, 20)[:, None], 1.0)
    causes = {faulty: next(range_warnings(plant, log, faulty)).partition(": ")[2] for faulty in ((), ("y",), None)}
    assert causes == {
        (): "no fault of it is found, so that the range is too small: high = 13 of q",
        ("y",): "the faults of y come first; then widen it",
        None: "widen it, if the unit and the sign are right",
    }
    assert wider(0.1, 20, 0.0, 30) == "low = 0, high = 32"
    assert wider(-5, -1, -7, -0.2) == "low = -7.4, high = 0"
