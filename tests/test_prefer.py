"""What a step is made for: the choice between straight-line code and loops, which is counted, said and overridable."""

import copy
import pickle
from pathlib import Path

import emitted
import numpy as np
import pytest
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.estimators.factored import FULL, LARGE, LONGER
from hgogen.model import load
from hgogen.step import BadStep

IN_LOOPS, STRAIGHT = "the covariance in loops", "the covariance in straight-line code"
MODEL = """
name = "model"

[states.x]
flow = "v"
low = -1
high = 1

[states.v]
flow = "-x"
low = -1
high = 1

[outputs.y]
equation = "x"

[observer]
kind = "riccati"
Q = [0.1, 0.1]
R = 0.1
dt = 0.01
prefer = "flash"
"""


def named(step: hg.Step) -> bool:
    """Whether the covariance is in loops."""
    return any(group.name == "column" for group in step.layout.groups)


def row(n: int, **options: str) -> hg.Step:
    """So many states, each of which moves the next."""
    x, (u, y) = emitted.signals(" ".join(f"x{i}" for i in range(1, n + 1))), emitted.signals("u y")
    flow = [b - 2 * a for a, b in zip(x, (*x[1:], u), strict=True)]
    plant = hg.System("row", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[0.1] * n, R=0.1)
    return hg.sample(observer, dt=0.01, **options)


@pytest.mark.parametrize(
    ("n", "speed", "flash"), [(1, False, False), (3, False, True), (7, False, True), (14, True, True)]
)
def test_speed_takes_straight_line_code_and_flash_the_shorter_text(n: int, speed: bool, flash: bool) -> None:
    steps = row(n), row(n, prefer="flash")
    assert [named(step) for step in steps] == [speed, flash]
    assert [step.clock.prefer for step in steps] == ["speed", "flash"]
    assert all(step.choice.startswith(IN_LOOPS if named(step) else STRAIGHT) for step in steps)


@pytest.mark.full
def test_the_choice_is_by_what_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bound between the two differences tells the two programs apart, whatever n is."""
    assert LONGER["speed"] > LONGER["flash"] == 0
    assert not named(row(5))
    monkeypatch.setattr("hgogen.estimators.factored.LONGER", {"speed": 100, "flash": 10**6})
    assert named(row(5))
    assert not named(row(5, prefer="flash"))
    assert not named(row(2))
    assert named(row(LARGE + 1, prefer="flash"))


def test_a_full_matrix_is_no_choice() -> None:
    step = emitted.step("two")
    full = hg.observers.riccati(step.observer.form, Q=0.1 * np.eye(3) + 0.01, R=[0.1, 0.2])
    assert not named(hg.sample(full, dt=0.01, prefer="flash"))
    assert "full matrices" in hg.sample(full, dt=0.01, prefer="flash").choice


def test_what_is_counted_has_its_borders() -> None:
    """Up to 7 states a full matrix is taken, up to 12 both programs are made."""
    form = row(FULL).observer.form
    full = hg.observers.riccati(form, Q=0.1 * np.eye(FULL) + 0.01, R=0.1)
    assert "full matrices" in hg.sample(full, dt=0.01).choice
    assert "in any case" not in row(LARGE, prefer="flash").choice
    assert "in any case" in row(LARGE + 1, prefer="flash").choice


def test_both_compute_the_same_but_for_rounding() -> None:
    draw = np.random.default_rng(3)
    samples = {"u": draw.normal(size=200), "y": draw.normal(size=200)}
    runs = [row(5, prefer=prefer).run(**samples, engine="python") for prefer in ("speed", "flash")]
    assert runs[1].x == pytest.approx(runs[0].x, abs=1e-12 * np.abs(runs[0].x).max())
    assert (runs[0].status == runs[1].status).all()


def test_a_step_made_again_and_its_copies_keep_it() -> None:
    step = row(4, prefer="flash")
    again = (step.rebuilt(), copy.copy(step), pickle.loads(pickle.dumps(step)), step.rebuilt(dt=0.02))
    assert [each.clock.prefer for each in again] == ["flash"] * 4
    assert step.rebuilt(prefer="speed").clock.prefer == "speed"


def test_what_there_is_not_is_refused() -> None:
    with pytest.raises(BadStep, match='prefer = \'size\' must be "speed" or "flash"'):
        row(2, prefer="size")


@pytest.mark.full
def test_it_is_said_in_the_banner_and_in_the_document() -> None:
    made, plain = row(4, prefer="flash"), row(4)
    for target in (hg.targets.c99, hg.targets.markdown):
        text, other = (" ".join("\n".join(dict(target(each)).values()).split()) for each in (made, plain))
        assert "ade for flash: the covariance in loops" in text
        assert "ade for" not in other
    assert "Made for speed: the covariance in loops" in " ".join(dict(hg.targets.c99(row(14)))["row.h"].split())


def test_a_model_and_a_command_say_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.toml").write_text(MODEL)
    assert load(Path("model.toml")).step().clock.prefer == "flash"
    for words, said in (([], True), (["--prefer", "speed"], False)):
        made = CliRunner().invoke(app, ["generate", "model.toml", *words, "--out", "there"])
        assert made.exit_code == 0, made.output
        assert ("Made for flash" in next(Path("there").rglob("*.h")).read_text()) is said
