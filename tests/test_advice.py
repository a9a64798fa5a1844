"""What `check` says to take: every line makes a step, what is admitted accepts nothing, and nothing else is offered."""

import shlex
from pathlib import Path

import pytest
from plants import MODELS
from rich.console import Group
from typer.testing import CliRunner

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.check import Verdict
from hgogen.cli import app
from hgogen.commands.advice import Admitted, Advice, advice
from hgogen.commands.checking import advice_tables
from hgogen.commands.claims import checked
from hgogen.emit.cost import cost
from hgogen.model import Model, load
from hgogen.starting import rule

FILES = sorted(path for path in MODELS.glob("*.*") if path.is_file())
QUICK = ("battery", "sir")
RULES = {kind: rule(getattr(hg.observers, kind)) for kind in hg.observers.__all__}


def asked(path: Path, *, deep: bool = False) -> tuple[Model, Advice]:
    model = load(path)
    survey = hg.survey(model.plant, deep=deep)
    claims = checked(model, survey)
    return model, advice(model, hg.observability(model.plant), survey, claims, deep=deep)


def made(model: Model, one: Admitted, folder: Path) -> CallableStep:
    """The step that a line makes, in the place where it belongs."""
    if one.line.startswith("tuning."):
        entry = folder / f"tuned_{Path(model.path).name}"
        entry.write_text(f"{one.line}\n{Path(model.path).read_text()}")
        return load(entry).step(one.line.partition(" ")[0].removeprefix("tuning."))
    if one.line.startswith("hgogen generate "):
        _, _, path, *named = shlex.split(one.line)
        return load(path).step(*named[1:])
    step: CallableStep = eval(one.line, {"hg": hg, "load": load, "plant": model.plant})
    return step


def write(folder: Path, flow: dict[str, str], output: str, name: str = "plant.toml", **more: str) -> Path:
    """A plain-text model without an observer, states in [-1, 1]."""
    rows = [f'states.{x} = {{low = -1, high = 1, flow = "{rate}"}}' for x, rate in flow.items()]
    outputs = [f'outputs.{y} = {{low = -1, high = 1, equation = "{e}"}}' for y, e in {"y": output, **more}.items()]
    path = folder / name
    path.write_text("\n".join(['name = "plant"', *rows, *outputs, ""]))
    return path


@pytest.mark.ordinary("sir")
@pytest.mark.parametrize(
    "file",
    [pytest.param(f, marks=() if f.stem in QUICK else (pytest.mark.slow,), id=f.stem) for f in FILES],
)
def test_every_line_of_a_shipped_model_makes_its_step(file: Path, tmp_path: Path) -> None:
    model, advised = asked(file)
    assert advised.admitted or advised.notes
    for one in advised.admitted:
        step = made(model, one, tmp_path)
        assert (step.observer.name, step.observer.accepted) == (one.observer, ())
        assert cost(step) == one.cost
        assert (one.known == "no theorem") == (step.observer.form.kind == "original")
    assert len({one.observer for one in advised.admitted}) == len(advised.admitted)


@pytest.mark.full
def test_those_with_a_proof_come_first_then_the_cheaper() -> None:
    ranks = ("proved", "proved for its theta", "proved for a larger theta", "open", "no theorem")
    model, advised = asked(MODELS / "duffing.toml")
    order = [(max(1, ranks.index(one.known)), one.cost.operations) for one in advised.admitted]
    assert order == sorted(order)
    assert {"high_gain", "cascade", "riccati"} <= {one.observer for one in advised.admitted}
    assert all(one.proposed == (one.observer not in model.tuning.tables) for one in advised.admitted)
    assert any("--deep" in note and "peaking_free" in note for note in advised.notes)


def test_a_proof_is_said_to_be_of_continuous_time() -> None:
    """Beside it stands what a sample costs, of a step of which nothing is proved."""
    _, advised = asked(MODELS / "duffing.toml")
    shown = advice_tables(advised)
    assert isinstance(shown, Group)
    assert "convergence in continuous time" in str(shown.renderables[0])


@pytest.mark.full
def test_a_tuning_whose_first_gains_ask_a_solver_is_built_with_its_own() -> None:
    _, advised = asked(MODELS / "pendulum.py")
    best = advised.admitted[0]
    (adaptive,) = (one for one in advised.admitted if one.observer == "adaptive_lmi")
    assert (best.observer, best.known, best.proposed) == ("high_gain", "proved for its theta", False)
    assert (adaptive.known, adaptive.proposed) == ("proved for its theta", False)


@pytest.mark.full
def test_first_gains_of_a_plain_text_model_without_an_observer(tmp_path: Path) -> None:
    model, advised = asked(write(tmp_path, {"x1": "x2", "x2": "-sin(x1) - x2"}, "x1"))
    quick = {kind for kind, each in RULES.items() if each.quick}
    assert {one.observer for one in advised.admitted} == quick - {"bank"}
    assert all(one.proposed for one in advised.admitted)
    assert {note.partition(" has no starting gains: ")[0] for note in advised.notes} == {"bank"}
    (one,) = (one for one in advised.admitted if one.observer == "high_gain")
    assert one.line.startswith('tuning.high_gain = {form = "triangular", theta = ')
    assert made(model, one, tmp_path).observer.name == "high_gain"
    x = made(model, one, tmp_path).run(y=[0.5] * 3000).x  # from 0, to where y is held
    assert x[-1][0] == pytest.approx(0.5, abs=0.1)


def test_what_is_said_of_none_is_said_where_it_may_be_taken(tmp_path: Path) -> None:
    """A bank goes around what is admitted, and there is none where nothing is."""
    _, bent = asked(write(tmp_path, {"x1": "x2 + x2**3/3", "x2": "-x1"}, "x1"))
    assert [note.partition(" has no starting gains")[0] for note in bent.notes] == ["bank"]
    _, blind = asked(write(tmp_path, {"x1": "-x1", "x2": "x1 - x2"}, "x1"))
    assert not any("has no starting gains" in note for note in blind.notes)


@pytest.mark.full
def test_several_outputs(tmp_path: Path) -> None:
    path = write(tmp_path, {"x1": "x2", "x2": "-x1 + x3", "x3": "-x3"}, "x1", z="x3")
    model, advised = asked(path)
    assert {"high_gain", "riccati", "hamilton_jacobi", "kalman_like"} <= {one.observer for one in advised.admitted}
    for one in advised.admitted:
        assert made(model, one, tmp_path).observer.name == one.observer


@pytest.mark.full
def test_a_python_model_without_a_tuning(tmp_path: Path) -> None:
    """A path with a space; the line names the plant of the file."""
    path = tmp_path / "my model.py"
    path.write_text(
        "import hgogen as hg\nx1, x2 = (hg.Signal(f'x{i}', low=-1, high=1) for i in (1, 2))\n"
        "plant = hg.System('p', states=(x1, x2), outputs=(hg.Signal('y'),), flow=[x2, -x1], output=[x1])\n"
    )
    model, advised = asked(path)
    (one,) = (one for one in advised.admitted if one.observer == "riccati")
    assert one.line.startswith("hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=")
    assert made(model, one, tmp_path).observer.form.kind == "triangular"


@pytest.mark.full
def test_first_gains_of_an_output_without_a_range_are_those_of_what_its_equation_spans(tmp_path: Path) -> None:
    """Noise, threshold and strip are shares of what the output spans, and the strip stays below its reach."""
    lines = []
    for ends in ("", "low = -100, high = 100, "):
        path = tmp_path / "wide.toml"
        rows = ['states.x1 = {low = -100, high = 100, flow = "x2"}']
        rows += ['states.x2 = {low = -100, high = 100, flow = "-x1"}', f'outputs.y = {{{ends}equation = "x1"}}']
        path.write_text("\n".join(['name = "wide"', *rows, ""]))
        _, advised = asked(path)
        lines.append({one.observer: one.line for one in advised.admitted})
    assert lines[0] == lines[1]
    assert "strip = 2.0, reach = 50.0" in lines[0]["lambda_tracking"]
    assert "threshold = 5.0" in lines[0]["switched_gain"]


@pytest.mark.full
def test_first_gains_beyond_a_double_are_not_offered(tmp_path: Path) -> None:
    _, advised = asked(write(tmp_path, {"x1": "x2", "x2": "1e300*x1"}, "x1"))
    observers = {one.observer for one in advised.admitted}
    assert not observers & {"high_gain", "lambda_tracking"}


@pytest.mark.full
def test_no_form_at_all(tmp_path: Path) -> None:
    """y shows x1 and x2 together: measured alone either begins a chain; the plant's own coordinates take it."""
    model, advised = asked(write(tmp_path, {"x1": "x2 - x1", "x2": "x1 - 2*x2"}, "x1 + x2**3 + x2"))
    observers = [one.observer for one in advised.admitted]
    assert observers[:2] == ["riccati", "hamilton_jacobi"]
    assert set(observers[2:]) == {"ukf", "iterated_ekf"}
    assert {one.known for one in advised.admitted} == {"no theorem"}
    assert "x1 in place of y (triangular)" in advised.notes[0]
    assert advised.notes[1].startswith(
        "Almost everywhere y and its derivatives can serve as the states of a form: `hgogen check "
    )
    assert "--deep` tests whether this holds" in advised.notes[1]
    assert hg.survey(model.plant, deep=True)["phase"].verdict is Verdict.PROVED


@pytest.mark.full
@pytest.mark.parametrize(("output", "more"), [("x1 + x2**3 + x2", {"y2": "x1*x2"}), ("x1*u + x2", {})])
def test_other_states_are_advised_only_where_a_form_has_them(output: str, more: dict[str, str], tmp_path: Path) -> None:
    """Of two outputs, and of one that reads the input, nobody knows any."""
    path = write(tmp_path, {"x1": "x2**2 - x1", "x2": "x1**2 - 2*x2 + u"}, output, **more)
    path.write_text(f"{path.read_text()}inputs.u = {{low = -1, high = 1}}\n")
    _, advised = asked(path)
    own = "No requested form is proved for the plant, and no theorem covers an observer in the plant's own states: "
    assert any(note.startswith(own) for note in advised.notes)
    assert "other states" not in " ".join(advised.notes).lower()


def test_what_is_hidden_is_named(tmp_path: Path) -> None:
    _, advised = asked(write(tmp_path, {"x1": "-x1", "x2": "x1 - x2"}, "x1"))
    assert advised.notes[0].startswith(
        "No observer can estimate x2 from these outputs: measure x2 as well, or leave it out"
    )
    _, tied = asked(write(tmp_path, {"x1": "-x1 + x2 - x3", "x2": "0", "x3": "0"}, "x1"))
    assert tied.notes[0] == "No observer can estimate x2, x3 from these outputs: measure x2 or x3 as well."


@pytest.mark.full
def test_what_is_only_accepted_is_not_admitted(tmp_path: Path) -> None:
    """A proposal in the plant's own coordinates stands in the place of a tuning that accepts a refutation."""
    model, advised = asked(MODELS / "fitzhugh_nagumo.py")
    admitted = {one.observer: one for one in advised.admitted}
    assert admitted["riccati"].proposed
    assert (admitted["riccati"].form, admitted["riccati"].known) == ("original", "no theorem")
    assert made(model, admitted["riccati"], tmp_path).observer.accepted == ()
    assert admitted["kalman_like"].name == "kalman_like"
    assert any("riccati needs these refuted checks to be accepted: triangular.a_2" in note for note in advised.notes)


def test_many_states_are_asked_for_little(tmp_path: Path) -> None:
    """Eight states: what would search for a bound is left to --deep, and said."""
    flow = {f"x{i}": f"x{i + 1}" for i in range(1, 8)} | {"x8": "-sin(x1)"}
    _, advised = asked(write(tmp_path, flow, "x1"))
    assert [one.observer for one in advised.admitted] == ["cascade", "riccati"]
    assert advised.notes == ("For a plant of this many states, --deep builds other observers with starting gains too.",)


@pytest.mark.parametrize("command", ["generate", "build"])
@pytest.mark.parametrize(
    ("flow", "notes"),
    [("0", ["hgogen: No observer can estimate z, d from these outputs: measure z or d as well."]), ("-z", [])],
)
def test_code_of_an_unobservable_plant_comes_with_a_note(
    tmp_path: Path, command: str, flow: str, notes: list[str]
) -> None:
    gains = "Q_per_sample = {z = 1e-3, v = 1e-3, d = 1e-3}, noise = {y = 0.1}, dt = 0.01"
    path = tmp_path / "baro.toml"
    path.write_text(f"""
name = "baro"
observer = {{kind = "ekf", {gains}}}
states.z = {{low = -5, high = 5, flow = "v"}}
states.v = {{low = -5, high = 5, flow = "{flow}"}}
states.d = {{low = -1, high = 1, flow = "0"}}
outputs.y = {{equation = "z + d"}}
""")
    done = CliRunner().invoke(app, [command, str(path), "-o", str(tmp_path / command)])
    assert done.exit_code == 0, done.output
    assert [line for line in done.output.splitlines() if "No observer can estimate" in line] == notes
