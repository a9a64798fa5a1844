"""The form, the method, the period and the precision that a user sets in the place of what a model's file says."""

import dataclasses
import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hgogen.commands.app import app
from hgogen.model import load
from hgogen.modelfiles.setting import Setting, UnknownCase

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = ("build", "generate", "simulate", "compare", "check", "run", "noise", "response", "design")


def model(name: str) -> str:
    return str(ROOT / "models" / name)


def command(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_that_makes_a_step_takes_them(name: str) -> None:
    _, stdout, _ = command(name, "--help")
    assert all(f"--{field.name} " in stdout for field in dataclasses.fields(Setting))
    assert re.search(r"--observer\b", stdout)


@pytest.mark.ordinary("pendulum.py")
@pytest.mark.parametrize("name", ["pendulum.py", "fitzhugh_nagumo.py"])
def test_a_models_own_step_is_made_again(name: str) -> None:
    """Of what is not set it keeps all: the observer with its gains, what the input does between samples."""
    own = load(model(name)).step()
    step = load(model(name)).set(Setting(method="euler", dt=own.dt / 4)).step()
    assert (step.method.name, step.dt, step.clock.between) == ("Euler", own.dt / 4, own.clock.between)
    assert step.layout.gains == own.layout.gains
    assert step.observer.form.to_form == own.observer.form.to_form
    moved = load(model(name)).set(Setting(form="phase")) if name == "pendulum.py" else None
    assert moved is None or moved.step().observer.form.kind == "phase"


def test_a_tuning_around_another_one_is_made_on_the_form() -> None:
    step = load(model("pendulum.py")).set(Setting(form="phase", method="heun", dt=5e-4)).step("bank")
    assert (step.observer.name, step.observer.form.kind, step.dt) == ("bank", "phase", 5e-4)
    assert step.method.name == load(model("pendulum.py")).set(Setting(method="heun")).step().method.name


@pytest.mark.parametrize("observer", [None, "high_gain", "stubborn", "bank"])
def test_a_precision_is_that_of_the_samples(observer: str | None) -> None:
    """Of the model's own step, of a tuning, of starting gains, and of one around another."""
    for name in ("pendulum.py", "duffing.toml"):
        loaded = load(model(name))
        if observer != "bank" or name == "pendulum.py":
            assert loaded.set(Setting(real="float")).step(observer).real == "float"
            assert loaded.step(observer).real == "double"


def test_trials_run_in_the_precision_that_is_set() -> None:
    """The errors differ, by little."""
    errors = []
    for real in ("double", "float"):
        status, stdout, said = command("simulate", model("pendulum.py"), "--seeds", "1", "--real", real, "--json")
        assert status == 0, said
        errors.append(json.loads(stdout)["trials"][0]["rms"])
    assert errors[0] != errors[1]
    assert errors[0] == pytest.approx(errors[1], rel=1e-2)


def test_nothing_set_changes_nothing() -> None:
    loaded = load(model("pendulum.py"))
    assert not Setting()
    assert loaded.set(Setting()).step().dt == loaded.step().dt


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        (Setting(form="triangle"), "--form triangle: there is no such form; did you mean triangular?"),
        (Setting(method="qqq"), "--method qqq: there is no such method; there are bilinear"),
    ],
)
def test_a_case_that_there_is_not(setting: Setting, said: str) -> None:
    with pytest.raises(UnknownCase) as refused:
        load(model("pendulum.py")).set(setting)
    assert str(refused.value).startswith(said)


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_the_command_in_the_banner_makes_the_same_c_again(tmp_path: Path) -> None:
    for place in ("one", "two"):
        words = ("--form", "phase", "--dt", "0.002", "--method", "heun", "--real", "double")
        status, _, said = command("generate", model("pendulum.py"), *words, "-o", str(tmp_path / place))
        assert status == 0, said
    (header,) = (tmp_path / "one").rglob("pendulum.h")
    (again,) = (tmp_path / "two").rglob("pendulum.h")
    banner = " ".join(header.read_text()[:400].replace("\n *", " ").split())
    assert "hgogen generate pendulum --form phase --method heun --dt 0.002 --real double" in banner
    assert header.read_bytes() == again.read_bytes()


@pytest.mark.full
def test_check_asks_the_form_that_is_set_and_takes_the_observers_as_they_are_tuned() -> None:
    status, stdout, _ = command("check", model("pendulum.py"), "--form", "phase", "--json")
    answer = json.loads(stdout)
    assert (status, answer["form"]) == (0, "phase")
    as_written = json.loads(command("check", model("pendulum.py"), "--json")[1])
    assert answer["take"] == as_written["take"]
    without = json.loads(command("check", model("sir.toml"), "--form", "uniform", "--json")[1])
    assert without["form"] == "uniform"
    assert any("of the uniform form alone" in note for note in without["notes"])


def test_a_period_that_is_too_long_is_refused_in_a_sentence() -> None:
    status, _, said = command("simulate", model("pendulum.py"), "--dt", "5")
    assert status == 2
    assert "dt = 5 is too long" in said


def test_a_setting_is_not_for_a_library(tmp_path: Path) -> None:
    library = tmp_path / "many.json"
    library.write_text('{"models": []}')
    status, _, said = command("check", "--library", str(library), "--form", "phase")
    assert status == 2
    assert "--form" in said


@pytest.mark.full
def test_window_asks_the_tuning_that_is_named() -> None:
    status, stdout, said = command("window", model("fitzhugh_nagumo.py"), "--observer", "riccati", "--json")
    assert status == 0, said
    assert json.loads(stdout)["windows"]
    status, _, said = command("window", model("fitzhugh_nagumo.py"), "--observer", "rikati")
    assert status == 2
    assert "riccati" in said


def test_a_form_that_is_set_is_of_the_plant_without_what_another_form_added() -> None:
    """The bioreactor's own step is on its phase form, whose plant has the derivative of the input beside it."""
    loaded = load(model("bioreactor.py")).set(Setting(form="phase"))
    assert loaded.step().observer.form.kind == "phase"
    assert [u.name for u in loaded.step("high_gain").inputs] == ["u", "u_dot"]


def test_a_form_that_is_set_is_not_asked_of_the_models_own_step() -> None:
    """Whose period another observer takes: the tracking of the bioreactor takes no uniform form, and riccati does."""
    loaded = load(model("bioreactor.py"))
    step = loaded.set(Setting(form="uniform")).step("riccati")
    assert (step.observer.form.kind, step.dt) == ("uniform", loaded.step().dt)
