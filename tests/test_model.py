"""Loading model files, and what is said of those that do not load."""

import os
import sys
from pathlib import Path

import pytest

import hgogen as hg
from hgogen.model import MissingPart, ModelFails, load
from hgogen.modelfiles.place import NoModel, available, listed, shipped

MODELS = Path(__file__).resolve().parents[1] / "models"
FIRST = "import hgogen as hg\n"


def model(folder: Path, text: str | bytes, name: str = "made.py") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_model_has_its_parts():
    loaded = load(MODELS / "fitzhugh_nagumo.py")
    assert loaded.name == "fitzhugh_nagumo"
    assert repr(loaded) == f"<model fitzhugh_nagumo in {loaded.path}>"
    assert loaded.plant.name == "fitzhugh_nagumo"
    assert loaded.step().dt == 0.01
    assert [trial.name for trial in loaded.trials()] == ["one_jump", "six_jumps"]
    assert loaded.has("tuning")
    assert not loaded.has("tunings")


def test_a_bare_name_and_the_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "models").mkdir()
    model(tmp_path / "models", "plant = 1\n", "one.py")
    model(tmp_path / "models", "plant = 2\n", "_helper.py")
    monkeypatch.chdir(tmp_path)
    assert load("one").path == str(Path("models/one.py"))
    assert listed() == (str(Path("models/one.py")),)
    with pytest.raises(NoModel, match=r"two: there is no such model file; the models here are .*one\.py"):
        load("two")
    with pytest.raises(NoModel, match=r"models: is a folder.*one\.py"):
        load("models")
    model(tmp_path, "plant = 3\n", "beside.py")
    for meant, guess in (("beside", "beside.py"), ("pendulm", "pendulum"), ("models/one.toml", "models/one.py")):
        with pytest.raises(NoModel, match=rf"{meant}: there is no such model file; did you mean {guess}\?"):
            load(meant)


def test_a_file_that_declares_no_plant_is_not_offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of what hgogen writes as JSON; a model with a fault in it is, since loading it tells the fault."""
    monkeypatch.chdir(tmp_path)
    written = tmp_path / "build" / "pendulum"
    written.mkdir(parents=True)
    for name, text in (("cost.json", '{"model": "pendulum"}'), ("tuned.json", '{"tuning": {"a": {}}}')):
        model(written, text, name)
    model(written, '[project]\nname = "thing"\n', "pyproject.toml")
    assert listed(written) == ()
    with pytest.raises(NoModel, match=r"build/pendulum: is a folder, not a model file; did you mean pendulum\?$"):
        load("build/pendulum")
    assert load("pendulum").name == "pendulum"
    model(written, '{"name": "s", "states": {"x": {"flow": "-x"}}, "outputs": {"y": {"equation": "x"}}}', "s.json")
    model(written, '{"name": "s", "states": {', "open.json")
    with pytest.raises(NoModel, match=r"the models here are \S*open\.json, \S*s\.json$"):
        load("build/pendulum")
    model(written.parent, "[1, 2]", "costs.json")
    with pytest.raises(NoModel, match=r"build/cost\.json: there is no such model file; give the path"):
        load("build/cost.json")


def test_two_files_of_one_name_are_two_models(tmp_path: Path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    loaded = [load(model(tmp_path / folder, f"plant = {folder!r}\n")) for folder in "ab"]
    assert [one.module.plant for one in loaded] == ["a", "b"]
    assert all(sys.modules[one.module.__name__] is one.module for one in loaded)
    assert not list(tmp_path.rglob("__pycache__"))


@pytest.mark.skipif(sys.platform != "linux", reason="names of folders are texts there")
def test_a_folder_may_have_a_name_that_is_no_text(tmp_path: Path):
    """As any is with letters beyond ASCII, to a Python that reads names as ASCII."""
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    assert load(model(folder, "plant = 1\n")).module.plant == 1


def test_what_a_model_prints_is_no_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    load(model(tmp_path, "print('hello')\n"))
    assert capsys.readouterr() == ("", "hello\n")


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("x = 1\nimport nothing_of_that_name\n", 2, "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("x = 1\n\ny = (\n", 3, "never closed"),
        ("def f():\n    return 1/0\nf()\n", 2, "ZeroDivisionError"),
        ("import sys\nsys.exit('no')\n", 2, "raises SystemExit (no), which ends Python"),
        (FIRST + "x = hg.Signal('a__b')\n", 2, "double underscore"),
        (FIRST + "x = hg.Signal('x', low=2, high=1)\n", 2, "low = 2 is not below high = 1"),
        (FIRST + "p = hg.Signal('p', '', '', float('nan'))\n", 2, "not finite"),
        (
            FIRST + "x = hg.Signal('x')\nhg.System('s', states=(x, x), outputs=(x,), flow=[1, 1], output=[x])\n",
            3,
            "twice",
        ),
        ("x = 1\0\n", 1, ""),
        (b"x = '\xff'\n", 1, ""),
    ],
)
def test_a_model_that_fails_to_import_is_a_sentence(tmp_path: Path, text: str | bytes, line: int, said: str):
    path = model(tmp_path, text)
    with pytest.raises(ModelFails) as caught:
        load(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}, line {line}: ")
    assert said in sentence
    assert "Traceback" not in sentence


def test_paths_that_lead_nowhere(tmp_path: Path):
    with pytest.raises(NoModel, match="no such model file"):
        load(tmp_path / "none.py")
    with pytest.raises(NoModel, match="is a folder"):
        load(tmp_path)
    with pytest.raises(NoModel, match=r"is no model file \(\.py, \.toml, \.json\)"):
        load(model(tmp_path, "", "model.txt"))


def test_a_bare_name_says_where_it_is_sought(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        NoModel, match=r"nothing: there is no such .*; give .* one in \./models or of one that `hgogen list`"
    ):
        load("nothing")


def test_a_bare_name_is_that_of_a_model_that_comes_with_hgogen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Only where nothing here is called so: a file in `models` comes first, and a folder is not passed over."""
    monkeypatch.chdir(tmp_path)
    assert load("pendulum").path == str(MODELS / "pendulum.py")
    assert load("sir").plant.name == "sir"
    assert available()["pendulum"] == str(MODELS / "pendulum.py")
    with pytest.raises(NoModel, match="no such model file"):
        load("./pendulum")
    (tmp_path / "pendulum").mkdir()
    with pytest.raises(NoModel, match="is a folder, not a model file"):
        load("pendulum")
    (tmp_path / "models").mkdir()
    here = str(Path("models/pendulum.py"))
    model(tmp_path / "models", "plant = 1\n", "pendulum.py")
    assert load("pendulum").path == here
    assert next(iter(available())) == here
    assert "pendulum" not in available()
    assert "sir" in available()


def test_the_models_of_a_wheel_come_before_those_beside_the_package(tmp_path: Path):
    package = tmp_path / "hgogen"
    for folder in (package, tmp_path / "models"):
        folder.mkdir()
    beside = model(tmp_path / "models", "", "beside.py")
    assert shipped(package) == {"beside": beside}
    (package / "models").mkdir()
    inside = model(package / "models", "", "inside.py")
    assert shipped(package) == {"inside": inside}


def test_missing_parts_say_so(tmp_path: Path):
    loaded = load(model(tmp_path, "x = 1\n"))
    for part, wanted in (("plant", lambda: loaded.plant), ("step", loaded.step), ("trial", loaded.trials)):
        with pytest.raises(MissingPart, match=rf"made\.py: defines no {part}, which this command needs; add"):
            wanted()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("plant = 3\n", "plant is of type int; make it an hg.System"),
        ("step = 3\n", "step is of type int; make it a function"),
        ("def step(): return 3\n", "step() returns the type int"),
        ("def trial(): return 3\n", "trial() returns the type int"),
        ("def trial(): return ()\n", "trial() returns the type tuple"),
        ("from hgogen.trial import Trial\ndef trial(): return (Trial('a', 1, {}), Trial('a', 2, {}))\n", "two trials"),
    ],
)
def test_parts_of_the_wrong_kind_say_so(tmp_path: Path, text: str, said: str):
    loaded = load(model(tmp_path, text))
    part = {"plant": lambda: loaded.plant, "step()": loaded.step, "step": loaded.step, "trial()": loaded.trials}
    with pytest.raises(MissingPart) as caught:
        part[said.split(" ")[0] if said != "two trials" else "trial()"]()
    assert said in str(caught.value)


def test_a_step_that_fails_names_its_line(tmp_path: Path):
    loaded = load(model(tmp_path, "def step():\n    x = {}\n    return x['dt']\n"))
    with pytest.raises(ModelFails, match=r"made\.py, line 3: KeyError: 'dt'"):
        loaded.step()


def test_a_refuted_form_is_not_wrapped(tmp_path: Path):
    text = (MODELS / "fitzhugh_nagumo.py").read_text().replace('"accept": ("triangular.a_2",)', '"accept": ()')
    path = model(tmp_path, text)
    with pytest.raises(hg.check.Refuted, match=r"^\S*made\.py: refuted: triangular\.a_2"):
        load(path).step()
    with pytest.raises(hg.check.Refuted) as caught:
        load(path).step("decaying")
    said = str(caught.value)
    assert said.startswith(f"{path}, tuning.decaying: refuted: triangular.a_2")
    assert said.count("accept") == said.count("accept=('triangular.a_2',)") == 1
    other = "The plant is state-affine, which is proved: kalman_like takes its form state_affine."
    assert f". {other} To build all the same, say accept=" in said


def test_no_observer_is_offered_that_is_refused_too(tmp_path: Path) -> None:
    """x' = A(u) x in its structure, but 1/u has a pole in every form of the plant."""
    path = tmp_path / "pole.toml"
    path.write_text(
        """
        name = "pole"
        states.x = {low = -1, high = 1, flow = "-x/u"}
        inputs.u = {low = 0, high = 1}
        outputs.y = {equation = "x"}
        observer = {kind = "riccati", form = "original", Q = [1], R = 1, dt = 0.1}
        """
    )
    with pytest.raises(hg.check.Refuted) as caught:
        load(path).step()
    assert "singular.x" in str(caught.value)
    assert "kalman_like takes" not in str(caught.value)


def test_a_tuning_and_a_certificate_without_the_command_line(tmp_path: Path) -> None:
    step = hg.load(MODELS / "pendulum.py").step("riccati")
    assert step.observer.name == "riccati"
    content = hg.certificate(step.observer.form, step.observer.checks, step.observer.name)
    assert content["observer"]["name"] == "riccati"
    with pytest.raises(hg.HgogenError, match="there is no such model file"):
        hg.load(tmp_path / "nothing.py")


SCRIPT = """
import numpy as np
import hgogen as hg
from hgogen.trial import Trial

q, w, y = hg.Signal("q", low=-1, high=1), hg.Signal("w", low=-3, high=3), hg.Signal("y")
plant = hg.System("spring", states=(q, w), outputs=(y,), flow=[w, -q], output=[q])
observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=5, poles=(-1, -1))
step = hg.sample(observer, hg.methods.rk4, dt=1e-2)
trial = Trial("swing", 1, {"q": 0.5, "w": 0})
run = step.run(y=np.ones(10))
"""


def test_a_script_whose_step_and_trial_are_values_is_a_model(tmp_path: Path) -> None:
    """As the lines of a first page are: its step begins anew, however far the script has run it, and each time."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    model = load(path)
    step = model.step()
    assert step.observer.name == "high_gain"
    first = hg.sample(step.observer, hg.methods.rk4, dt=1e-2)(y=0.3)["q"]
    assert step(y=0.3)["q"] == first
    assert step(y=0.3)["q"] != first
    assert model.step()(y=0.3)["q"] == first
    assert model.step("high_gain").dt == 1e-2
    assert [trial.name for trial in model.trials()] == ["swing"]
