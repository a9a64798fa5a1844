"""Plain-text models: what they say, what they refuse and how, and that a system written reads back."""

import copy
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
import sympy as sp
from typer.testing import CliRunner

import hgogen as hg
from hgogen.check import Refuted
from hgogen.commands.app import app
from hgogen.commands.claims import checked
from hgogen.model import MissingPart, load
from hgogen.modelfiles.place import NoModel, listed
from hgogen.reading.text_model import BadModelFile, NoText, from_table, read, to_text

ROOT = Path(__file__).resolve().parents[1]
TOML = """
name = "van_der_pol"
meaning = "an oscillator with negative damping near rest"
reference = "van der Pol 1926"

[states.x2]
unit = "V/s"
low = -6
high = 6
flow = "mu*(1 - x1**2)*x2 - x1 + 0.1*u"

[states.x1]
unit = "V"
meaning = "voltage"
low = -3
high = 3
flow = "x2"

[inputs.u]
low = -1
high = 1
value = 0.5

[parameters.mu]
value = 1.5
low = 1
high = 2

[outputs.y]
equation = "x1"

[known]
order = ["x1", "x2"]

[observer]
kind = "high_gain"
method = "rk4"
dt = 1e-3
theta = 20
poles = [[-1, 0.5], [-1, -0.5]]

[trial]
duration = 2
start = {x1 = 1, x2 = 0}
inputs = {u = "sin(2*t)"}
noise = {y = 0.001}
seeds = 2
"""
PLANT = TOML.partition("[observer]")[0]


def table() -> dict[str, Any]:
    return tomllib.loads(TOML)


def written(folder: Path, text: str | bytes, name: str = "made.toml") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# --- what a file says ---------------------------------------------------------------------------------------


def test_toml_and_json_say_the_same(tmp_path: Path) -> None:
    toml = read(written(tmp_path, TOML))
    same = read(written(tmp_path, b"\xef\xbb\xbf" + json.dumps(table()).encode(), "made.json"))
    assert toml.plant == same.plant
    assert toml.known == same.known == {"order": ["x1", "x2"]}
    assert (toml.reference, toml.meaning) == (same.reference, same.meaning)


def test_the_system_is_what_is_written(tmp_path: Path) -> None:
    x1, x2 = hg.Signal("x1", "V", "voltage", low=-3, high=3), hg.Signal("x2", "V/s", low=-6, high=6)
    u, mu, y = hg.Signal("u", nominal=0.5, low=-1, high=1), hg.Signal("mu", "", "", 1.5, 1, 2), hg.Signal("y")
    plant = hg.System(
        "van_der_pol",
        states=(x2, x1),
        inputs=(u,),
        outputs=(y,),
        parameters=(mu,),
        flow=[mu * (1 - x1**2) * x2 - x1 + u / 10, x2],
        output=[x1],
    )
    assert read(written(tmp_path, TOML)).plant == plant


def test_an_expression_may_be_a_number() -> None:
    changed = table()
    changed["states"]["x1"]["flow"], changed["states"]["x2"]["flow"] = 0, 0.1
    assert from_table(changed).plant.flow == (sp.Rational(1, 10), 0)


# --- what is refused ----------------------------------------------------------------------------------------

MISSING = object()
NUMBERS = "such as 1.5, finite, below 1e+300 and without quotes"
REFUSED: list[tuple[str, Any, str, str]] = [
    ("name", MISSING, "", "the key 'name' is missing; add name = "),
    ("name", 3, "name", 'is 3; write text, such as "..."'),
    ("name", "a b", "", "is not an identifier"),
    ("state", {}, "state", "there is no key 'state' here; did you mean states?"),
    ("zzz", {}, "zzz", "there is no key 'zzz' here; the keys are name, meaning"),
    ("states", 3, "states", "is 3; write a table"),
    ("states", MISSING, "outputs.y.equation", "the name 'x1' is not declared"),
    ("outputs", {}, "", "has no outputs"),
    ("states.x1", "x2", "states.x1", "is 'x2', text, not a table; write its keys, unit, meaning"),
    ("states.x1.flow", MISSING, "states.x1", "the key 'flow' is missing; add flow = "),
    ("states.x1.flow", ["x2"], "states.x1.flow", "is a list; write an expression"),
    ("states.x1.flow", True, "states.x1.flow", "is True; write an expression"),
    ("states.x1.flow", "x3", "states.x1.flow", "column 1: the name 'x3' is not declared; did you mean x"),
    ("states.x1.flow", "x2.real", "states.x1.flow", "column 3: '.' is not in the grammar"),
    ("states.x1.flow", "y", "", "uses the output y; write it in states and inputs"),
    ("states.x1.flows", "x2", "states.x1.flows", "there is no key 'flows' here; did you mean flow?"),
    ("states.x1.unit", 3, "states.x1.unit", "is 3; write text"),
    ("states.x1.low", "-3", "states.x1.low", f"is '-3', text; write a number, {NUMBERS}"),
    ("states.x1.low", -1e301, "states.x1.low", f"is -1e+301; write a number, {NUMBERS}"),
    ("states.x1.low", float("nan"), "states.x1.low", "is nan; write a number"),
    ("states.x1.low", float("-inf"), "states.x1.low", "is -inf; write a number"),
    ("states.x1.low", -(10**5000), "states.x1.low", "is a huge number; write a number"),
    ("states.x1.low", True, "states.x1.low", "is True; write a number"),
    ("states.x1.low", 4, "states.x1", "low = 4 is not below high = 3; swap or widen them"),
    ("states.x1.high", MISSING, "states.x1", "has only one end of a range"),
    ("states.a__b", {"flow": "0"}, "states.a__b", "has a double underscore"),
    ("inputs.u.flow", "x1", "inputs.u.flow", "there is no key 'flow' here; did you mean low?"),
    ("inputs.x1", {}, "", "the name 'x1' is declared twice"),
    ("inputs.u.rates", [-1, 1], "inputs.u.rates", "is a list; write pairs of numbers, such as [[-1, 1], [-2, 2]]"),
    ("parameters.mu.value", MISSING, "parameters.mu", "the key 'value' is missing; add value = 1.5"),
    ("parameters.mu.value", 9, "parameters.mu", "nominal = 9 lies outside [1, 2]"),
    ("outputs.y.equation", MISSING, "outputs.y", "the key 'equation' is missing"),
    ("outputs.y.equation", "1/0", "outputs.y.equation", "column 2: divides by zero"),
    ("known", 3, "known", "is 3; write a table"),
]


def changed(path: str, value: Any) -> dict[str, Any]:
    whole = copy.deepcopy(table())
    *tables, key = path.split(".")
    inner = whole
    for name in tables:
        inner = inner[name]
    if value is MISSING:
        del inner[key]
    else:
        inner[key] = value
    return whole


@pytest.mark.parametrize(("path", "value", "key", "words"), REFUSED, ids=[f"{p}-{w[:25]}" for p, _, _, w in REFUSED])
def test_a_refusal_names_file_key_and_fix(path: str, value: Any, key: str, words: str) -> None:
    with pytest.raises(BadModelFile) as caught:
        from_table(changed(path, value), "made.toml")
    assert caught.value.key == key
    assert str(caught.value).startswith(f"made.toml{f', {key}' if key else ''}: ")
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.toml", "name = ", "is no TOML text (Invalid value (at end of document)); correct it"),
        ("a.toml", 'name = "a"\nname = "b"\n', "is no TOML text (Cannot overwrite a value (at line 2"),
        ("a.toml", "[states.x]\n[states.x]\n", "is no TOML text (Cannot declare"),
        ("a.toml", b"name = '\xff'", "is no TOML text ('utf-8' codec can't decode"),
        ("a.toml", "x = " + "[" * 100_000, "is no TOML text (it is nested too deep)"),
        ("a.toml", "x = " + "1" * 9000, "is no TOML text (Exceeds the limit"),
        ("a.toml", "#" * 4_000_001, "is larger than 4000000 bytes"),
        ("a.json", "", "is no JSON text (Expecting value"),
        ("a.json", "[]", "is a list, not a table; write its keys, name"),
        ("a.json", '{"name": NaN}', "is no JSON text (NaN is no finite number); correct it"),
        ("a.json", '{"name": "a", "name": "b"}', "is no JSON text (the key 'name' stands twice in one table)"),
        ("a.json", '{"states": {"x": {}, "x": {}}}', "the key 'x' stands twice in one table"),
        ("a.json", "[" * 100_000, "is no JSON text (it is nested too deep)"),
    ],
)
def test_what_is_no_text_of_its_kind_is_refused(tmp_path: Path, name: str, text: str | bytes, words: str) -> None:
    with pytest.raises(BadModelFile) as caught:
        read(written(tmp_path, text, name))
    assert words in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)


# --- there and back -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pendulum", "fitzhugh_nagumo", "cascaded_tanks"])
def test_a_model_written_reads_back(tmp_path: Path, name: str) -> None:
    plant = load(ROOT / "models" / f"{name}.py").plant
    assert read(written(tmp_path, to_text(plant))).plant == plant


def test_odd_text_and_numbers_come_back(tmp_path: Path) -> None:
    x = hg.Signal("E", 'a"\\\n\t', "\x7f\x00\x1b é \U0001f600 '''", low=-1e-7, high=1e22)
    y = hg.Signal("y")
    plant = hg.System("odd", states=(x,), outputs=(y,), flow=[-0.1 * x + sp.Max(x, 1) / 3], output=[sp.Abs(x) ** 1.5])
    exact = sp.Max(x, 1) / 3 - x / 10
    again = read(written(tmp_path, to_text(plant))).plant
    assert again.states == plant.states
    assert again.flow == (exact,)
    assert again.output == (sp.Abs(x) ** sp.Rational(3, 2),)


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        (lambda x: sp.E * x, "reads back as another expression; rename the signal E or pi"),
    ],
)
def test_what_the_grammar_lacks_is_not_written(flow: Any, words: str) -> None:
    x = hg.Signal("E")
    plant = hg.System("bad", states=(x,), outputs=(hg.Signal("y"),), flow=[flow(x)], output=[x])
    with pytest.raises(NoText) as caught:
        to_text(plant)
    assert words in str(caught.value)


# --- as a model ---------------------------------------------------------------------------------------------


def test_a_bare_name_leads_to_any_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    written(tmp_path / "models", TOML, "one.toml")
    written(tmp_path / "models", json.dumps(table()), "two.json")
    written(tmp_path / "models", "", "three.txt")
    assert listed() == tuple(str(Path("models") / name) for name in ("one.toml", "two.json"))
    assert load("one").plant == load("two").plant
    result = CliRunner().invoke(app, ["list", "--json"])
    assert json.loads(result.stdout)["models"][:2] == list(listed())
    written(tmp_path / "models", "", "one.py")
    with pytest.raises(NoModel, match=r"the name is that of 2 files; give the path of one; .*one\.py, .*one\.toml"):
        load("one")


def test_its_step_is_the_one_python_would_make(tmp_path: Path) -> None:
    loaded = load(written(tmp_path, TOML))
    form = hg.forms.triangular(loaded.plant)
    observer = hg.observers.high_gain(form, theta=20, poles=(-1 + 0.5j, -1 - 0.5j))
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
    u, y = np.zeros(50), np.sin(np.arange(50) * 4e-3)
    runs = [one.run(u=u, y=y, engine="python").x for one in (loaded.step(), step)]
    assert np.array_equal(*runs)
    assert np.any(runs[0])


TUNING = """
[tuning.high_gain]
theta = 10
poles = [-1, -2]
method = "rk4"

[tuning.wide]
kind = "low_power"
form = {kind = "triangular"}
theta = 10
dt = 5e-4

[tuning.filter]
kind = "riccati"
Q = [1, 1]
R = 1
dt = 0.01
theta = {kind = "adaptive", theta_1 = 4, mu = [0.1, 0.2], innovation = {kind = "staggered", d = 1}}
"""


def test_its_tunings_are_observers_by_name(tmp_path: Path) -> None:
    """Beside the table `observer`, whose dt is that of a tuning without one; without the table the first is the
    step."""
    loaded = load(written(tmp_path, TOML + TUNING))
    made = {name: loaded.step(name) for name in ("high_gain", "wide", "filter", "observer")}
    assert {name: step.observer.name for name, step in made.items()} == {
        "high_gain": "high_gain",
        "wide": "low_power",
        "filter": "riccati",
        "observer": "high_gain",
    }
    assert [step.dt for step in made.values()] == [1e-3, 5e-4, 0.01, 1e-3]
    assert made["high_gain"].layout.gains[0].initial == (10.0,)
    assert made["observer"].layout.gains[0].initial == loaded.step().layout.gains[0].initial == (20.0,)
    assert made["filter"].observer.traces == ("theta", "innovation")
    first = load(written(tmp_path, PLANT + TUNING.replace('"rk4"', '"rk4"\ndt = 2e-3')))
    assert first.has("step")
    assert (first.step().dt, first.step().observer.name) == (2e-3, "high_gain")


TUNINGS: list[tuple[str, str, str]] = [
    ("[tuning.high_gain]\npoles = [-1, -1]", "tuning.high_gain", "the key 'theta' is missing; high_gain needs it"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, 1]", "tuning.high_gain", "pole"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\nthet = 5", "tuning.high_gain.thet", "did you mean theta?"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\nform = 'tri'", "tuning.high_gain.form", "there is no 'tri'"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\nform = {order = 3}", "tuning.high_gain", "order"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\nmember = 'x'", "tuning.high_gain.member", "no observer around"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\ndt = 'long'", "tuning.high_gain.dt", "write a number"),
    ("[tuning.high_gain]\ntheta = 5\npoles = [-1, -1]\ndt = 0", "tuning.high_gain", "must be a positive time"),
    ("[tuning]\nhigh_gain = 5", "tuning.high_gain", "is of type int; write a table"),
    ("[tuning.high_gain]\nkind = 'high'", "tuning.high_gain.kind", "there is no 'high'"),
    ("[tuning.'a/b']\ntheta = 5", "tuning.a/b", "must be a name of letters"),
    (
        "[tuning.riccati]\nQ = [1, 1]\nR = 1\ntheta = {kind = 'adapt'}",
        "tuning.riccati",
        "kinds are constant",
    ),
    ("[tuning.riccati]\nQ = [1, 1]\nR = 1\ntheta = {kind = 'decaying', rat = 1}", "tuning.riccati", "'rat'"),
]


@pytest.mark.parametrize(("text", "key", "words"), TUNINGS)
def test_a_tuning_is_refused_with_its_key(tmp_path: Path, text: str, key: str, words: str) -> None:
    loaded = load(written(tmp_path, PLANT + text + "\n"))
    with pytest.raises(BadModelFile, match=re.escape(words)) as caught:
        loaded.step(next(iter(loaded.tuning.tables)))
    assert caught.value.key.startswith(key)


def test_an_observer_without_a_tuning_is_told_what_to_add(tmp_path: Path) -> None:
    loaded = load(written(tmp_path, TOML))
    with pytest.raises(
        MissingPart,
        match=r"none for bank; add a table \[tuning.bank\] with member, count, period \(it also takes .*\); it has no "
        "starting gains: it goes around another observer",
    ):
        loaded.step("bank")
    with pytest.raises(MissingPart, match=r"there is no observer 'low_pow', .* did you mean low_power"):
        loaded.step("low_pow")
    with pytest.raises(
        BadModelFile, match=r"tuning.low_power: the key 'dt' is missing; add dt, the time in seconds \D*$"
    ):
        load(written(tmp_path, PLANT + "[tuning.low_power]\ntheta = 5\n")).step("low_power")


def test_a_refuted_hypothesis_is_of_a_tuning_and_accepted_in_its_language(tmp_path: Path) -> None:
    """x2 acts on x1 through u, which vanishes: the sentence names the file and the key, and offers accept once."""
    text = PLANT.replace('flow = "x2"', 'flow = "u*x2"') + "[tuning.quick]\nkind = 'high_gain'\n"
    path = written(tmp_path, text + "theta = 5\npoles = [-1, -1]\ndt = 1e-3\n")
    assert path.read_text().count("u*x2") == 1
    with pytest.raises(Refuted) as caught:
        load(path).step("quick")
    said = str(caught.value)
    assert said.startswith(f"{path}, tuning.quick: refuted: ")
    assert said.count("accept") == said.count('accept = ["triangular.a_2"]') == 1


@pytest.mark.parametrize(("flow", "refused"), [("x2", ()), ("u*x2", ("triangular.a_2",))])
def test_what_an_observer_claims_may_be_accepted_before_it_is_made(
    flow: str, refused: tuple[str, ...], tmp_path: Path
) -> None:
    """It is built in no case, as P = -1 has no decay and no shrink: what is then shown are the claims of the form."""
    gains = "gamma = [1, 9]\nK = [2, 1]\nP = [[-1, 0], [0, -1]]\nsigma = 0.05\nrise = 1\nthreshold = 0.1\ndt = 1e-3\n"
    text = PLANT.replace('flow = "x2"', f'flow = "{flow}"') + f"[tuning.adaptive_lmi]\n{gains}"
    path = written(tmp_path, text + 'accept = ["adaptive_lmi.definite"]\n')
    with pytest.raises(Refuted) as caught:
        load(path).step("adaptive_lmi")
    assert {check.id for check in caught.value.checks} >= {*(refused or ("adaptive_lmi.decay", "adaptive_lmi.shrink"))}
    claims = checked(load(path), None, "adaptive_lmi")
    assert (claims.accepted, tuple(check.id for check in claims.open)) == ((), refused)


def test_its_trial_is_the_one_written(tmp_path: Path) -> None:
    (trial,) = load(written(tmp_path, TOML)).trials()
    assert (trial.duration, dict(trial.start), trial.seeds) == (2, {"x1": 1, "x2": 0}, (0, 1))
    assert trial.inputs["u"] == sp.sin(2 * hg.trial.t)
    assert trial.noise["y"].sigma == 0.001
    assert trial.settled is None
    table = TOML.replace("[trial]\n", "[trial]\nsettled = {state = 'x2', band = 0.1, hold = 0.5}\n")
    assert load(written(tmp_path, table)).trials()[0].settled == hg.trial.Settled("x2", 0.1, 0.5)


def test_missing_tables_are_named(tmp_path: Path) -> None:
    loaded = load(written(tmp_path, PLANT))
    with pytest.raises(MissingPart, match=r"add an observer table.*, or name one: --observer riccati"):
        loaded.step()
    with pytest.raises(MissingPart, match="defines no trial, which this command needs; add a trial table"):
        loaded.trials()


RECIPES: list[tuple[str, Any, str, str]] = [
    ("observer.kind", MISSING, "observer", "the key 'kind' is missing"),
    ("observer.kind", "high_gian", "observer.kind", "there is no 'high_gian'; did you mean high_gain?"),
    ("observer.form", "q", "observer.form", "there is no 'q'; there are "),
    ("observer.method", "rk5", "observer.method", "there is no 'rk5'; did you mean rk4?"),
    ("observer.dt", MISSING, "observer", "the key 'dt' is missing"),
    ("observer.dt", "1 ms", "observer.dt", "is '1 ms', text; write a number"),
    ("observer.dt", -1, "observer", "dt"),
    ("observer.thet", 3, "observer.thet", "high_gain has no argument 'thet'; did you mean theta?"),
    ("observer.theta", MISSING, "observer", "the key 'theta' is missing; high_gain needs it"),
    ("observer.theta", -0.5, "observer", "must be a positive finite number"),
    ("observer.theta", "big", "observer", "theta"),
    ("observer.poles", [-1], "observer", "pole"),
    ("observer.poles", ["a", "b"], "observer", "pole"),
    ("trial.duration", MISSING, "trial", "the key 'duration' is missing"),
    ("trial.start.x3", 1, "trial.start.x3", "there is no key 'x3' here; the keys are x2, x1"),
    ("trial.inputs.u", "sin(x1)", "trial.inputs.u", "the name 'x1' is not declared; what can be read here: t"),
    ("trial.noise.y", "small", "trial.noise.y", "is 'small', text; write a number"),
    ("trial.settled", {"state": "x2", "band": 0.1}, "trial.settled", "the key 'hold' is missing"),
    ("trial.settled", {"state": 2, "band": 0.1, "hold": 1}, "trial.settled.state", "write text"),
    ("trial.seeds", 1.5, "trial.seeds", "is 1.5; write a whole number from 1 to 1000"),
    ("trial.seeds", 10**9, "trial.seeds", "write a whole number from 1 to 1000"),
]


@pytest.mark.parametrize(("path", "value", "key", "words"), RECIPES, ids=[f"{p}-{w[:25]}" for p, _, _, w in RECIPES])
def test_a_recipe_is_refused_with_its_key(tmp_path: Path, path: str, value: Any, key: str, words: str) -> None:
    loaded = load(written(tmp_path, json.dumps(changed(path, value)), "made.json"))
    with pytest.raises(BadModelFile) as caught:
        (loaded.step if path.startswith("observer") else loaded.trials)()
    assert caught.value.key == key
    assert words in str(caught.value)


@pytest.mark.full
def test_the_command_line_checks_and_simulates_it(tmp_path: Path) -> None:
    path = str(written(tmp_path, TOML))
    checked = CliRunner().invoke(app, ["check", path, "--json"])
    assert checked.exit_code == 0, checked.output
    assert json.loads(checked.stdout)["plant"] == "van_der_pol"
    tried = CliRunner().invoke(app, ["simulate", path, "--engine", "python", "--seeds", "1", "--json"])
    assert tried.exit_code == 0, tried.output
    (trial,) = json.loads(tried.stdout)["trials"]
    assert trial["rms"]["x2"] < 1
    bad = CliRunner().invoke(app, ["check", str(written(tmp_path, "name = 3", "bad.toml"))])
    assert bad.exit_code == 2
    assert "bad.toml, name: is 3; write text" in bad.output
    assert "Traceback" not in bad.output


def test_the_model_of_the_page_works(tmp_path: Path) -> None:
    model, *_ = pages.blocks("toml", pages.text("plain_text"))
    loaded = load(written(tmp_path, model, "oscillator.toml"))
    assert loaded.plant.name == "oscillator"
    assert loaded.step().dt == 1e-3
