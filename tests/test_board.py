"""What a step costs on a Cortex-M4F: counted, bounded, told, and refused in a sentence where the tools are missing."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from emitted import files, run, step, tool
from pages import shown
from test_cli import as_json, hgogen
from test_packing import here as here  # the fixture

import hgogen as hg
from hgogen.extras import costs as costs_
from hgogen.extras.costs import COMPILER, EMULATOR, FLAGS, SIZE, driver, head, literal, measured, with_faults
from hgogen.model import load
from hgogen.trial import rows_given

LIMITS = {
    "--max-flash": "flash_bytes",
    "--max-ram": "ram_bytes",
    "--max-stack": "stack_bytes",
    "--max-instructions": "worst_instructions",
}


@pytest.fixture
def board() -> None:
    for name in (COMPILER, EMULATOR):
        tool(name)


@pytest.mark.full
def test_costs_are_those_of_the_step(board: None) -> None:
    """RAM and flash as the compiler has them; a step that computes more costs more; the same again."""
    rows = np.full((300, 2), 0.1)
    first, again = (measured(step("pendulum"), files("pendulum"), rows, "float") for _ in range(2))
    assert first == again
    assert 100 < first.nominal_instructions < first.worst_instructions < 2000
    assert first.ram_bytes == 4 * (2 + 2 + 5 + 4 + 3)  # of which 2 are the marks
    assert 1000 < first.flash_bytes < 10_000
    assert 16 < first.stack_bytes < 1000
    assert "arm-none-eabi-gcc" in first.compiler
    doubled = measured(step("pendulum"), files("pendulum", "double"), rows, "double")
    assert doubled.nominal_instructions > 10 * first.nominal_instructions  # in software
    assert doubled.real == "double"


def test_the_worst_is_that_of_a_hostile_record(board: None, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.full((300, 2), 0.1)
    worst = measured(step("pendulum"), files("pendulum"), rows, "float").worst_instructions
    monkeypatch.setattr(costs_, "with_faults", np.copy)
    assert worst > measured(step("pendulum"), files("pendulum"), rows, "float").worst_instructions + 10


@pytest.mark.full
def test_the_stack_is_that_of_memory_that_is_spoiled_too(board: None, tmp_path: Path) -> None:
    """At least the frames of the calls that begin a state anew, of which calm samples make none."""
    hg.write(files("pendulum"), tmp_path)
    run([COMPILER, "-std=c99", *FLAGS, "-fstack-usage", "-c", "pendulum.c"], tmp_path)
    frames = dict(re.findall(r":pendulum_(\w+)\t(\d+)", (tmp_path / "pendulum.su").read_text()))
    needed = sum(int(frames[name]) for name in ("step", "ready", "reset", "clear_fault_counts"))
    assert measured(step("pendulum"), files("pendulum"), np.full((300, 2), 0.1), "float").stack_bytes >= needed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bank", "no_input", "delayed", "tunable", "wide", "tables", "sin"])
def test_every_kind_of_step_is_measured(name: str, board: None) -> None:
    made = step(name)
    rows = np.zeros((40, len(made.inputs) + len(made.samples)))
    costs = measured(made, files(name), rows, "float")
    assert costs.nominal_instructions > 0
    assert costs.worst_instructions > 0


def test_a_member_is_called_as_in_c() -> None:
    x, y = hg.Signal("x", low=-1, high=1), hg.Signal("y", low=-1, high=1)
    current = hg.Signal("I", low=-1, high=1)
    plant = hg.System("coil", states=(x,), inputs=(current,), outputs=(y,), flow=[current - x], output=[x])
    text = driver(hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=0.1))
    assert "in.I_ = row[0];\n    measurement.y = row[1];\n" in text
    assert "(void)coil_step(&m->s, &m->p, &in, &measurement);" in text


@pytest.mark.full
def test_members_may_have_the_names_of_what_counts_them(board: None) -> None:
    x = [hg.Signal(name, low=-1, high=1) for name in ("N", "COLUMNS", "COPIES", "record", "real")]
    y = hg.Signal("RECORD", low=-1, high=1)
    plant = hg.System("sample", states=x, outputs=(y,), flow=[-each for each in x], output=[sum(x)])
    made = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 5, R=1), dt=0.1)
    assert measured(made, hg.targets.c99(made, check=False), np.zeros((9, 1)), "float").nominal_instructions > 100


def test_a_hostile_record_has_gaps_and_jumps_in_about_a_third_of_its_numbers() -> None:
    calm = np.full((1000, 2), 0.25)
    worst = with_faults(calm)
    assert (calm == 0.25).all()
    assert 0.25 < np.mean(worst != 0.25) < 0.35
    assert np.isnan(worst).any()
    assert np.isinf(worst).any()
    assert [literal(v, "float") for v in (np.nan, np.inf, -np.inf, 0.1)] == ["NAN", "INFINITY", "-INFINITY", "0.1f"]
    assert "enum { N = 3, COLUMNS = 2, RECORD = 1000, QUIET = 7 };\n" in head(calm, "double", 3, 7)


def test_the_rows_of_a_trial_are_what_a_step_is_given() -> None:
    model = load("pendulum")
    made, (trial,) = model.step(), model.trials()
    rows = rows_given(made, trial)
    assert rows.shape == (300, 2)
    assert not np.isnan(rows).any()
    run = made.run(u=rows[:, 0], y=rows[:, 1], engine="python")
    assert not run.status[100:].any()


@pytest.mark.full
def test_cost_writes_what_the_folder_then_tells(board: None, here: Path) -> None:
    answer = as_json("cost", "tank.toml")
    stored = json.loads((here / "generated" / "tank" / "cost.json").read_text())
    assert {key: answer[key] for key in stored if key != "model"} == {k: v for k, v in stored.items() if k != "model"}
    assert stored["model"] == "tank"
    assert answer["files"] == [str(Path("generated/tank/cost.json"))]
    hgogen("generate", "tank.toml", "--for", "zephyr")
    readme = (here / "generated" / "tank" / "README.md").read_text()
    assert f"| bytes of flash | {stored['flash_bytes']} |" in readme
    hgogen("generate", "tank.toml", "--for", "zephyr", "--dt", "0.02")  # another source
    assert "bytes of flash" not in (here / "generated" / "tank" / "README.md").read_text()


@pytest.mark.full
def test_limits_are_kept_or_exceeded(board: None, here: Path) -> None:
    costs = as_json("cost", "tank.toml", "--name", "left")
    assert (here / "generated" / "left" / "cost.json").exists()
    limits = [word for option, key in LIMITS.items() for word in (option, str(costs[key]))]
    hgogen("cost", "tank.toml", *limits)
    for option, key in LIMITS.items():
        out, err = hgogen("cost", "tank.toml", option, str(costs[key] - 1), status=1)
        assert f": {costs[key]}, more than {costs[key] - 1}\n" in err
        assert "on a Cortex-M4F" in out
    _, err = hgogen("cost", "tank.toml", "--max-flash", "1", "--max-ram", "1", status=1)
    assert err.count("more than 1") == 2


def test_the_page_shows_a_command_that_keeps_to_its_limits(board: None, here: Path) -> None:
    ((line, wanted),) = shown("hgogen cost")
    out, _ = hgogen(*shlex.split(line)[1:])
    assert wanted.strip() in out


@pytest.mark.parametrize("missing", [COMPILER, SIZE, EMULATOR])
def test_without_a_tool_it_says_so(missing: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(costs_.shutil, "which", lambda name: None if name == missing else f"/bin/{name}")
    out, err = hgogen("cost", "tank.toml", "--max-flash", "10", status=2)
    assert out == ""
    assert f"there is no {missing}, without which nothing is measured; install gcc-arm-none-eabi" in err
    assert not (here / "generated").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [(("--max-flash", "-1"), "max-flash"), (("--max-ram", "much"), "max-ram"), (("--name", "int"), "keyword")],
)
def test_bad_limits_are_wrong_usage(options: tuple[str, ...], said: str, here: Path) -> None:
    assert said in hgogen("cost", "tank.toml", *options, status=2)[1]
