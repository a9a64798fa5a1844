"""The command line: exit status, JSON alone, sentences instead of tracebacks, nothing half written."""

import csv
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from typer import BadParameter
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.check import Check, ClaimId, Verdict
from hgogen.commands import building, claims
from hgogen.commands.app import command_of
from hgogen.commands.command import Meaning, meanings, names_in, numbers_by_name
from hgogen.commands.output import UNREAD, console, headed
from hgogen.modelfiles.place import summary
from hgogen.modelfiles.setting import UnknownCase
from hgogen.run import native
from hgogen.run.comparison import Agreement
from hgogen.target import Files
from hgogen.trial import proposed_trial

MODELS = Path(__file__).resolve().parents[1] / "models"
NEURON = MODELS / "fitzhugh_nagumo.py"
VERSION = tomllib.loads((MODELS.parent / "pyproject.toml").read_text())["project"]["version"]
SHORT = """

def trial():
    common = {"start": {"x1": 1.06, "x2": 2.69, "eta": 5}, "inputs": {"u": sp.sin(t)}}
    noise = {"y": OrnsteinUhlenbeck(0.2, 0.1)}
    return Trial("short", 3, noise=noise, jumps=(Jump(2, "eta", 4),), seeds=(0, 1), **common)
"""
LANGUAGES = ", ".join(building._languages())
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with models/neuron.py, a quick trial of the neuron, and log.csv, ten seconds of it."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "neuron.py").write_text(NEURON.read_text() + SHORT)
    rows = "".join(f"{k / 100},{np.cos(k / 100)},{np.sin(k / 100)}\n" for k in range(1000))
    (tmp_path / "log.csv").write_text("time,potential,drive\n" + rows)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def hgogen(*arguments: str, status: int = 0) -> tuple[str, str]:
    """Run the command; what it prints on the standard output and on the standard error stream."""
    result = CliRunner().invoke(cli.app, list(arguments))
    assert result.exit_code == status, (result.stdout, result.stderr, result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.stdout + result.stderr
    return result.stdout, result.stderr


def documented(command: str) -> str:
    return hgogen(command, "--help")[0].split("JSON keys:")[1]


def undescribed(rows: Sequence[Meaning], answer: Any) -> list[str]:
    """The keys of an answer that the rows of a schema do not describe, and those that they do and it has not."""
    if isinstance(answer, list):
        return [key for one in answer for key in undescribed(rows, one)]
    if not rows or answer is None:
        return []
    if not isinstance(answer, dict):
        return [repr(answer)]
    top = min(row.depth for row in rows)
    places = [k for k, row in enumerate(rows) if row.depth == top]
    known = {rows[k].name: rows[k:end] for k, end in zip(places, [*places[1:], len(rows)], strict=True)}
    lacking = {name for name, (own, *_) in known.items() if not own.optional} - answer.keys()
    faults = sorted(lacking | (answer.keys() - known.keys()))
    for name, (own, *below) in known.items():
        inner = answer.get(name)
        each = list(inner.values()) if own.kind.endswith("by name") and below and inner else [inner]
        faults += [f"{name}.{key}" for one in each for key in undescribed(below, one)]
    return faults


def as_json(*arguments: str, status: int = 0) -> dict[str, Any]:
    """The JSON a command prints; its keys are exactly those of one of the command's schemas, and stand in its help."""
    answer: dict[str, Any] = json.loads(hgogen(*arguments, "--json", status=status)[0])
    text = documented(arguments[0])
    many = "--library" in arguments
    described = [list(meanings(each)) for each in vars(command_of(arguments[0]))["reports"]]
    assert any(undescribed(rows, [*answer.values()] if many else answer) == [] for rows in described)
    assert [key for key in answer if not many and key not in text] == []
    return answer


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


LOG = ("--data", "log.csv", "--map", "y=potential", "--map", "u=drive")

# --- what the commands do -------------------------------------------------------------------------------------


def test_list(here: Path):
    answer = as_json("list")
    assert answer["models"][0] == str(Path("models/neuron.py"))
    assert {"pendulum", "battery"} <= set(answer["models"])  # which come with hgogen
    assert {"triangular"} <= set(answer["forms"])
    assert {"riccati", "high_gain"} <= set(answer["observers"])
    assert {"rk4", "continuous_discrete"} <= set(answer["methods"])
    assert "c99" in answer["targets"]
    assert {kind: list(summaries) for kind, summaries in answer["summaries"].items()} == {
        kind: names for kind, names in answer.items() if kind != "summaries"
    }
    assert answer["summaries"]["observers"]["high_gain"] == "Standard high-gain observer with a constant gain."
    models = answer["summaries"].pop("models")
    assert models[str(Path("models/neuron.py"))].startswith("Modified FitzHugh-Nagumo neuron")
    assert all(len(text) > 40 for summaries in answer["summaries"].values() for text in summaries.values())
    assert "models/neuron.py" in hgogen("list")[0]


@pytest.mark.parametrize(
    ("file", "text", "sentence"),
    [
        ("a.py", '"""One tank.\n\nIts level."""\nraise SystemExit', "One tank"),
        ("a.py", '"""A tank, its level\nmeasured. By hand."""', "A tank, its level measured"),
        ("a.py", "def f(:", ""),
        ("a.py", "plant = 1", ""),
        ("a.toml", 'meaning = "One tank"', "One tank"),
        ("a.toml", "meaning = ", ""),
        ("a.json", "[1]", ""),
    ],
)
def test_a_model_says_what_it_is_without_being_run(tmp_path: Path, file: str, text: str, sentence: str):
    (tmp_path / file).write_text(text)
    assert summary(str(tmp_path / file)) == sentence


def test_check(here: Path):
    answer = as_json("check", "neuron")
    verdicts = {check["id"]: (check["verdict"], check["accepted"]) for check in answer["checks"]}
    assert verdicts["triangular.a_2"] == ("refuted", True)
    assert answer["refuted"] == []
    assert answer["notes"] == []
    assert answer["coordinates"] == {"z1": "x1", "z2": "x2", "z3": "-eta"}
    assert answer["flow"]["z3"] == "0"
    assert answer["outputs"] == {"y": "z1"}
    shown, said = hgogen("check", "neuron", "--all")
    assert said == ""
    assert "z1 = x1, z2 = x2, z3 = -eta" in shown
    assert f"  z2' = {answer['flow']['z2']}\n" in shown
    assert "  y = z1\n" in shown
    assert "accepted" in shown
    assert "u = 0" in shown
    assert "Theorem: the estimate converges exponentially from any initial state (theorem 5)" in shown
    assert "left to you" in shown
    known = {row["claim"]: row for row in answer["theorem"]["hypotheses"]}
    driven = known["0 < a_m <= a_i <= a_M for every input and parameter in its range"]
    assert (driven["verdict"], "triangular.a_2" in driven["checks"]) == ("refuted", True)


def test_check_of_an_unknown_observer_prints_nothing_else(here: Path):
    out, err = hgogen("check", "neuron", "--observer", "nosuch", status=2)
    assert out == ""
    assert "there is no observer 'nosuch', it has tunings for" in err


def test_check_of_a_plant_without_an_observer_asks_only(here: Path):
    """What is refuted is an answer: there is no observer that needs it."""
    text = NEURON.read_text()
    (here / "bare.py").write_text(text[: text.index("tuning = ")])
    answer = as_json("check", "bare.py")
    assert answer["refuted"] == ["triangular.a_2"]
    out, err = hgogen("check", "bare.py", "--all")
    assert "a_2 vanishes; at u = 0" in out
    assert "z1 = x1" in out
    assert err == "hgogen: bare.py has no observer: the checks are those of the triangular form alone\n"
    assert err == f"hgogen: {answer['notes'][0]}\n"


@pytest.mark.full
def test_check_of_a_plant_in_no_form(here: Path):
    """The battery without its observer."""
    alone = here / "battery.toml"
    alone.write_text(re.split(r"^\[(?:observer|tuning|trial)", (MODELS / "battery.toml").read_text(), flags=re.M)[0])
    answer = as_json("check", str(alone))
    assert (answer["form"], answer["refuted"]) == ("triangular", ["triangular.structure"])
    assert {row["verdict"] for row in answer["forms"] if row["name"] in ("triangular", "uniform")} == {"refuted"}
    out, err = hgogen("check", str(alone), "--all")
    assert "in triangular form" not in out
    assert out.count("y brings in soc, v together") == 1
    assert "hgogen check MODEL tells" not in out  # which is what it does
    assert "has the structure of none of the requested forms" in err


def test_check_of_a_plant_that_is_not_observable(here: Path):
    answer = as_json("check", str(MODELS / "sir.toml"))
    assert answer["observability"]["known"]["unobservable"] == answer["observability"]["known"]["repairs"]
    out, _ = hgogen("check", str(MODELS / "sir.toml"), "--all")
    assert "is not observable: rank 2 of 3" in out
    assert "as well" in out
    assert "singularity" not in out


@pytest.mark.full
def test_check_names_the_states_of_a_recast_plant(here: Path):
    out, _ = hgogen("check", str(MODELS / "cascaded_tanks.py"), "--all")
    assert "cascaded_tanks in triangular form, z1 = x2, z2 = w\n  with w = sqrt(x1)\n" in out


@pytest.mark.full
def test_a_step_on_a_refuted_form_exits_1(here: Path):
    text = NEURON.read_text().replace('"accept": ("triangular.a_2",)', '"accept": ()')
    (here / "stubborn.py").write_text(text)
    answer = as_json("check", "stubborn.py", status=1)
    assert answer["refuted"] == ["triangular.a_2"]
    assert answer["coordinates"]["z3"] == "-eta"
    assert answer["checks"][0]["id"] == "triangular.structure"
    assert answer["theorem"] is None
    assert "refused on this form" in answer["notes"][0]
    shown = hgogen("check", "stubborn.py", "--all", status=1)[0]
    assert "  z3' = 0\n" in shown
    assert "triangular.lipschitz" in shown
    for command in ("build", "generate", "simulate"):
        out, err = hgogen(command, "stubborn.py", status=1)
        assert (out, err.count("\n")) == ("", 1)
        assert "accept=('triangular.a_2',)" in err
    assert not (here / "build").exists()
    assert not (here / "generated").exists()


@needs_compiler
def test_build(here: Path):
    answer = as_json("build", "neuron")
    names = [*(f"fitzhugh_nagumo{end}" for end in (".c", ".h", "_check.c", ".md")), "report.json"]
    names += [f"short_{what}.{kind}" for what in ("states", "theta") for kind in ("png", "svg")]
    assert files(here / "build" / "neuron") == sorted(names)
    assert sorted(Path(path).name for path in answer["files"]) == sorted(names)
    assert json.loads((here / "build" / "neuron" / "report.json").read_text()) == answer
    assert answer["coordinates"]["z3"] == "-eta"
    assert answer["comparison"][0]["agreed"] is True
    assert (answer["trials"][0]["seeds"], answer["trials"][0]["engine"]) == (2, "c")
    assert answer["self_check"]


@pytest.mark.usefixtures("undrawn")
def test_build_without_a_compiler(here: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(native, "compiler", lambda: None)
    out, err = hgogen("build", "neuron", "--out", "made", "--json")
    answer = json.loads(out)
    assert "no C compiler" in err
    assert (answer["compiler"], answer["self_check"], answer["comparison"]) == (None, None, [])
    assert (answer["trials"][0]["seeds"], answer["trials"][0]["engine"]) == (1, "python")
    assert "fitzhugh_nagumo.c" in files(here / "made")


@pytest.mark.full
@needs_compiler
@pytest.mark.usefixtures("undrawn")
def test_build_exits_1_where_c_and_python_disagree(here: Path, monkeypatch: pytest.MonkeyPatch):
    bad = Agreement("short", 0, until=1.0, before=0.5, after=0.5, settled=((1.0, 2.0),), dt=0.01)
    monkeypatch.setattr(building, "agreements", lambda *_: (bad,))
    _, err = hgogen("build", "neuron", status=1)
    assert "hgogen: C and Python disagree in trial 'short', seed 0: 5.0e-01" in err


@needs_compiler
def test_generate_is_the_same_again(here: Path):
    answer = as_json("generate", "neuron", "-o", "one")
    hgogen("generate", "neuron", "-o", "two")
    one, two = (here / name / "neuron" for name in ("one", "two"))
    assert sorted(answer["models"][0]["files"]) == sorted(str(Path("one/neuron") / name) for name in files(one))
    assert len(files(one)) == 8
    assert {name: (one / name).read_bytes() for name in files(one)} == {
        name: (two / name).read_bytes() for name in files(two)
    }


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_generate_without_a_compiler(here: Path, monkeypatch: pytest.MonkeyPatch):
    """The trials run in Python, which has no bit that C has not."""
    monkeypatch.setattr(native, "compiler", lambda: None)
    _, err = hgogen("generate", "neuron")
    assert "no C compiler" in err
    assert {"fitzhugh_nagumo.c", "short_theta.svg"} <= set(files(here / "generated" / "neuron"))


@pytest.mark.full
def test_generate_asks_only_for_the_files_of_its_target(here: Path):
    """A folder in the place of NAME.c is in the way of C alone; then nothing is written."""
    there = here / "generated" / "neuron"
    (there / "fitzhugh_nagumo.c").mkdir(parents=True)
    text = NEURON.read_text()
    (here / "models" / "neuron.py").write_text(text[: text.index("def trial")])
    _, err = hgogen("generate", "neuron", status=2)
    assert "fitzhugh_nagumo.c: it is a folder, where a file belongs" in err
    assert list(there.iterdir()) == [there / "fitzhugh_nagumo.c"]
    hgogen("generate", "neuron", "--target", "rust")
    assert (there / "fitzhugh_nagumo.rs").is_file()


@needs_compiler
def test_generate_of_a_model_without_a_trial(here: Path):
    text = NEURON.read_text()
    (here / "untried.py").write_text(text[: text.index("def trial")])
    _, err = hgogen("generate", "untried.py")
    assert "untried.py has no trial, so there are no figures of it" in err
    assert len(files(here / "generated" / "untried")) == 4


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("command", ["build", "simulate"])
def test_a_trial_that_does_not_fit_is_refused_before_anything_is_said(here: Path, command: str):
    path = here / "duffing.toml"
    path.write_text((MODELS / "duffing.toml").read_text().replace("start = {x = 1, ", "start = {"))
    out, err = hgogen(command, str(path), status=2)
    assert (out, err) == ("", "hgogen: trial 'forced': start says nothing of 'x'; give it a value\n")


@pytest.mark.full
def test_a_model_without_a_trial_is_tried_on_one_that_is_made_of_its_ranges(here: Path):
    """And that is said; as `advise` does, whose file the next command takes."""
    text = NEURON.read_text()
    (here / "untried.py").write_text(text[: text.index("def trial")])
    made = proposed_trial(hg.load("untried.py").plant)
    python = ("--engine", "python")
    for command in (("simulate", *python), ("compare", "-o", "out", *python), ("build", "--seeds", "1")):
        out, err = hgogen(command[0], "untried.py", *command[1:], "--json")
        (trial,) = json.loads(out)["trials"]
        assert trial["trial"] == made.name == "proposed"
        assert f"untried.py has no trial; it is tried on one that stays in its ranges, over {made.duration:.3g}" in err


@pytest.mark.full
@needs_compiler
@pytest.mark.usefixtures("undrawn")
def test_generate_in_another_language(here: Path):
    answer = as_json("generate", "neuron", "--target", "rust", "--real", "double", "-o", "crates")
    written = [name for name in files(here / "crates" / "neuron") if name.startswith("fitz")]
    assert written == ["fitzhugh_nagumo.md", "fitzhugh_nagumo.rs", "fitzhugh_nagumo_check.rs"]
    assert {Path(path).name for path in answer["models"][0]["files"]} >= set(written)
    text = (here / "crates" / "neuron" / "fitzhugh_nagumo.rs").read_text()
    assert "hgogen generate neuron --real double --target rust" in " ".join(text.replace("//!", "").split())
    assert "pub theta: f64," in text


@pytest.mark.full
@needs_compiler
@pytest.mark.parametrize("there", [True, False])
@pytest.mark.usefixtures("undrawn")
def test_build_in_another_language(there: bool, here: Path, monkeypatch: pytest.MonkeyPatch):
    """Its self-check is run where its compiler is there; the trials are those of C and Python."""
    if there and not (shutil.which("rustc", path="/usr/bin") or shutil.which("rustc")):
        pytest.skip("there is no rustc")
    monkeypatch.setenv("RUSTC", (shutil.which("rustc", path="/usr/bin") or "rustc") if there else "no_such_compiler")
    out, err = hgogen("build", "neuron", "--target", "rust", "--seeds", "1")
    report = json.loads((here / "build" / "neuron" / "report.json").read_text())
    assert report["self_check"] == ("fitzhugh_nagumo: 64 samples as recorded" if there else None)
    assert ("self-check of the float rust: fitzhugh_nagumo: 64 samples as recorded" in out) is there
    assert ("there is no rustc; install it, or name another by $RUSTC: the code is written but" in err) is not there
    assert all(one["agreed"] for one in report["comparison"])
    assert not list((here / "build" / "neuron").glob("*.c"))


def test_a_language_is_a_target_that_takes_a_command():
    """The rest of the folder runs a step on a computer, and is not for firmware."""
    assert {"c99", "rust"} <= set(building._languages()) < set(hg.targets.__all__)


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("casadi", "is for Python, as hg.targets.casadi"),
        ("record", "is no language of its own; call hg.targets.record"),
    ],
)
def test_a_target_that_is_no_language_says_what_it_is(here: Path, target: str, reason: str):
    _, err = hgogen("generate", "neuron", "--target", target, status=2)
    assert f"--target {target}: {reason}; there are {LANGUAGES}" in err


def test_a_target_that_takes_no_precision_is_no_language(monkeypatch: pytest.MonkeyPatch):
    """It would be offered, and end in a TypeError."""

    def zig(step: hg.Step, *, command: str = "") -> Files:
        return Files(())

    monkeypatch.setattr(hg.targets, "zig", zig, raising=False)
    monkeypatch.setattr(hg.targets, "__all__", [*hg.targets.__all__, "zig"])
    assert "zig" not in building._languages()
    with pytest.raises(UnknownCase, match=r"--target zig: takes command, and not real, check, as a language does"):
        building._demand_language("zig")


def test_languages_are_listed_as_one_says_them():
    assert building._join_with_or(["c99"]) == "c99"
    assert building._join_with_or(["c99", "rust"]) == "c99 or rust"
    assert building._join_with_or(["c99", "rust", "zig"]) == "c99, rust or zig"


def test_a_table_of_a_trial_has_the_course_of_theta_only_if_theta_adapts() -> None:
    for model, adapts in (("pendulum", False), ("fitzhugh_nagumo", True)):
        assert ("peak theta" in hgogen("simulate", model, "--seeds", "1")[0]) is adapts


def test_simulate(here: Path):
    answer = as_json("simulate", "neuron", "--engine", "python", "--seeds", "1")
    (trial,) = answer["trials"]
    assert (trial["trial"], trial["seeds"], trial["engine"]) == ("short", 1, "python")
    assert trial["times"] == [0.0, 2.0]
    assert len(trial["each"]) == 1
    (low, high), ratio = trial["falling"]["eigenvalues"], trial["falling"]["ratio"]
    assert 0 < low < high
    assert 0 < ratio < 1
    said = hgogen("simulate", "neuron", "--engine", "python", "--trial", "short", "--seeds", "1")[0]
    assert "trial short" in said
    assert "short: shown in trials, not proved: without noise V = e' S e" in " ".join(said.split())


def test_run(here: Path):
    answer = as_json("run", "neuron", *LOG, "--time", "time", "--horizon", "1,5,1000,99999999")
    folder = here / "build" / "neuron"
    assert files(folder) == sorted(Path(path).name for path in answer["files"])
    assert len(files(folder)) == 9
    assert [(p["ahead"], p["count"]) for p in answer["predictions"]] == [(1, 999), (5, 995), (None, 999)]
    assert answer["notes"][-1] == "there is no sample to compare with predictions 1000, 99999999 samples ahead"
    assert answer["record"]["rows"] == answer["record"]["samples"] == 1000
    with (folder / "log_estimates.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["t", "y", "x1", "x2", "eta", "theta", "innovation", "status"]
    assert len(rows) == 1000
    assert float(rows[-1]["y"]) == pytest.approx(np.cos(9.99))


@pytest.mark.full
def test_run_says_where_gains_are_starting_gains(here: Path) -> None:
    words = ("run", "neuron", *LOG, "--time", "time")
    note = "ukf has no tuning in the model, and runs with starting gains"
    assert note not in hgogen(*words)[1]
    assert note in hgogen(*words, "--observer", "ukf")[1]


@pytest.mark.parametrize("command", ["run", "tune"])
def test_a_truth_that_is_empty_is_given_by_its_option(here: Path, command: str):
    rows = (here / "log.csv").read_text().splitlines()
    (here / "log.csv").write_text("\n".join([f"{rows[0]},empty", *(f"{row}," for row in rows[1:])]))
    _, err = hgogen(command, "neuron", *LOG, "--time", "time", "--truth", "x2=empty", status=2)
    assert "the column 'empty' holds no number for truth of x2; say --truth x2=COLUMN" in err


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_run_compares_with_what_the_observer_took(here: Path):
    """A spike that it rejected is in no prediction error, and is counted."""
    lines = (here / "log.csv").read_text().splitlines()
    time, _, rest = lines[500].split(",", 2)
    lines[500] = f"{time},1e9,{rest}"
    (here / "log.csv").write_text("\n".join(lines))
    answer = as_json("run", "neuron", *LOG, "--time", "time")
    assert answer["status"]["REJECTED_Y"] == 1
    assert [one["rejected"] for one in answer["predictions"]] == [1] * 4
    assert max(one["model"] for one in answer["predictions"]) < 10
    assert "y: 1 that the observer rejected, not compared" in hgogen("run", "neuron", *LOG, "--time", "time")[0]


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_run_says_what_is_wrong_with_a_record(here: Path):
    lines = (here / "log.csv").read_text().splitlines()
    lines[5:8] = ["0.04,,0.1", "0.05,err,0.1", "0.05,1,0.1"]
    del lines[100:120]
    lines[300], lines[301] = lines[301], lines[300]
    (here / "log.csv").write_text("\n".join(lines))
    out, _ = hgogen("run", "neuron", *LOG, "--time", "time")
    for said in (
        "y (potential): cells that are empty: 1, taken as missing samples",
        "y (potential): cells that are no finite number: 1, taken as missing samples",
        "rows earlier than one before them: 1, sorted by time",
        "rows that repeat a time: 1, merged",
        "gaps longer than 1.5 periods: 2",
        "grid points without a row: 21, given as missing samples",
        "MISSING_Y",
    ):
        assert said in out
    answer = as_json("run", "neuron", *LOG, "--time", "time")
    read = answer["record"]
    assert read["absent"]["y"] == answer["status"]["MISSING_Y"]
    lost = read["missing"]["y"] + read["not_numbers"]["y"] - read["covered"]["y"]
    assert lost + read["filled"] == read["absent"]["y"]
    assert ",," in (here / "build" / "neuron" / "log_estimates.csv").read_text()


@pytest.mark.full
def test_run_stays_finite_over_absurd_values(here: Path):
    y, u = {3: "1e30", 5: "inf"}, {2: "1e30"}
    rows = [f"{k / 100},{y.get(k % 7, 1)},{u.get(k % 5, 0.5)}" for k in range(500)]
    (here / "log.csv").write_text("time,potential,drive\n" + "\n".join(rows))
    answer = as_json("run", "neuron", *LOG, "--time", "time")
    assert answer["status"]["REJECTED_Y"] == sum(k % 7 == 3 for k in range(500))
    assert answer["status"]["MISSING_Y"] == sum(k % 7 == 5 for k in range(500))
    assert answer["status"]["REUSED_U"] == sum(k % 5 == 2 for k in range(500))
    text = (here / "build" / "neuron" / "log_estimates.csv").read_text()
    assert "nan" not in text
    assert "inf" not in text


@pytest.mark.full
def test_check_tells_the_singular_set(here: Path):
    """det = -eps u^2; at u = 0 the next jet has u'. These checks do not count for the exit status."""
    singular = as_json("check", "neuron")["singular"]
    assert set(singular["factors"]) == {"eps", "u"}
    assert singular["inputs"] == ["u"]
    assert [check["verdict"] for check in singular["checks"]] == ["where"] * 3
    shown, _ = hgogen("check", "neuron", "--all")
    assert "singular input: u = 0" in shown
    assert "holds where u_dot != 0" in shown


JUMPING = """
import sympy as sp
import hgogen as hg

x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
y = hg.Signal("y")
plant = hg.System("jumping", states=(x1, x2), outputs=(y,), flow=[(2 + sp.sign(x1)) * x2, -x1], output=[x1])
"""


@pytest.mark.full
def test_a_question_without_an_answer_leaves_the_others(here: Path):
    (here / "models" / "jumping.py").write_text(JUMPING)
    shown, _ = hgogen("check", "jumping", "--all", "--deep")
    assert "proved   triangular.a_2" in shown
    assert "not known: sign(x1) has no derivative somewhere" in shown
    answer = as_json("check", "jumping")
    assert answer["singular"]["factors"] is None
    assert answer["observability"]["known"]["rank"] == 2


@pytest.mark.full
def test_check_begins_with_its_answer(here: Path):
    first = hgogen("check", "neuron", "--all")[0].split("\n")[0]
    assert first.startswith("fitzhugh_nagumo: locally observable; state_affine, proved; its observer's form: ")
    assert first.endswith(": triangular but for a_2 (accepted); convergence unknown")
    assert as_json("check", "neuron")["headline"] == first
    assert hgogen("check", str(MODELS / "sir.toml"), "--all")[0].startswith(
        "sir: R not observable; in none of the requested forms; no observer\n"
    )
    headline = hgogen("check", str(MODELS / "pendulum.py"), "--all")[0].split("\n")[0]
    assert "; triangular, uniform, state_affine, proved; convergence proved in continuous time, for its " in headline


def test_what_is_accepted_or_said_in_another_way_is_not_gathered() -> None:
    """Of four that are alike."""
    alike = tuple(Check(ClaimId("f", "a", i), f"a_{i}", Verdict.PROVED, "it is 1", subject=sp.S.One) for i in range(4))

    def called(checks: Sequence[Check], accepted: Sequence[str] = ()) -> list[str]:
        return [name for name, _ in claims._gathered(checks, accepted)]

    assert called(alike) == ["f.a_0..a_3"]
    assert called(alike[:3]) == ["f.a_0", "f.a_1", "f.a_2"]
    assert called(alike, ["f.a_1"]) == ["f.a_0", "f.a_1", "f.a_2", "f.a_3"]
    assert called([*alike[:3], replace(alike[3], reason="it is more than 0")]) == ["f.a_0", "f.a_1", "f.a_2", "f.a_3"]


@pytest.mark.full
def test_check_says_alike_once(here: Path):
    for n, output in ((3, "x1"), (4, "x1"), (8, "2*x1")):
        rows = [f'states.x{k} = {{low = -1, high = 1, flow = "x{k + 1}"}}' for k in range(1, n)]
        last = f'states.x{n} = {{low = -1, high = 1, flow = "-x1"}}\noutputs.y = {{equation = "{output}"}}\n'
        (here / f"chain{n}.toml").write_text("\n".join([f'name = "chain{n}"', *rows, last]))
    shown = hgogen("check", "chain8.toml", "--all")[0]
    assert shown.count("triangular.a_") == 2
    assert "triangular.a_1  " in shown
    assert "triangular.a_2..a_8 " in shown
    assert "a_2 = 1 <= a_M on the box, and so for each up to a_8" in " ".join(shown.split())
    assert "triangular.a_1..a_4 " in hgogen("check", "chain4.toml", "--all")[0]  # from four on
    assert "triangular.a_3 " in hgogen("check", "chain3.toml", "--all")[0]
    assert len([check for check in as_json("check", "chain8.toml")["checks"] if ".a_" in check["id"]]) == 8


@pytest.mark.full
def test_what_is_folded_away_is_said_first(here: Path):
    """Before anything is called proved of x1 in the place of exp(log(x1)), and once."""
    (here / "el.toml").write_text(
        'name = "el"\nstates.x1 = {low = -3, high = 3, flow = "x2"}\noutputs.y = {equation = "x1"}\n'
        'states.x2 = {low = -1, high = 1, flow = "1e-30*x2 - exp(log(x1))"}\n'
        'observer = {kind = "high_gain", theta = 5, poles = [-1, -1], method = "rk4", dt = 1e-3}\n'
    )
    for command in ("check", "generate"):
        _, said = hgogen(command, "el.toml")
        assert said.startswith("hgogen: SymPy reads 1e-30*x2 - exp(log(x1)) as ")
        assert said.count("also where x1 <= 0; ") == 1
    assert "z2' = -z1 + z2/1e30\n" in hgogen("check", "el.toml", "--all")[0]


@pytest.mark.full
@pytest.mark.parametrize("columns", ["80", "120"])
def test_what_is_piped_is_as_wide_as_columns(columns: str, here: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", columns)
    lines = hgogen("check", str(MODELS / "induction_motor.toml"), "--all")[0].splitlines()
    copied = ("  hgogen ", "  tuning.")
    widths = [len(line) for line in lines if not line.startswith(copied)]
    assert int(columns) - 10 < max(widths) <= int(columns)


@pytest.mark.full
def test_json_of_a_model_into_a_file(here: Path):
    out, err = hgogen("check", "neuron", "--json=new/neuron.json")
    assert (out, err) == ("", "hgogen: wrote new/neuron.json, in a new folder\n")
    assert json.loads((here / "new" / "neuron.json").read_text()) == as_json("check", "neuron")


def test_window(here: Path):
    windows = as_json("window", "neuron")["windows"]
    assert [one["d"] for one in windows] == [0.5, 1.0, 2.0]
    assert windows[1]["weakest"] == "eta"
    assert all(b["least"] > a["least"] for a, b in itertools.pairwise(windows))
    chosen = as_json("window", "neuron", "--d", "1,2", "--trial", "short")
    assert [one["d"] for one in chosen["windows"]] == [1.0, 2.0]
    assert "weakest direction" in hgogen("window", "neuron", "--d", "1")[0]


def test_noise(here: Path):
    rng = np.random.default_rng(0)
    (here / "quiet.csv").write_text("y\n" + "\n".join(str(value) for value in 5 + 0.2 * rng.standard_normal(4000)))
    answer = as_json("noise", "neuron", "--data", "quiet.csv", "--period", "0.01", "--from", "1", "--to", "39")
    (one,) = answer["noise"]
    assert (one["samples"], one["tau"], one["d"]) == (3801, 0.0, 1.0)
    assert one["sigma"] == pytest.approx(0.2, rel=0.05)
    assert "gamma_0" in hgogen("noise", "neuron", "--data", "quiet.csv", "--period", "0.01")[0]


# --- bad input ------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("arguments1-MODEL", "arguments3-is a folder", "arguments4-is no model file")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("frobnicate",), "frobnicate"),
        (("check",), "MODEL"),
        (("check", "none"), "there is no such model file; the models here are models/neuron.py"),
        (("check", "models"), "is a folder"),
        (("check", "log.csv"), "is no model file"),
        (("check", "neuron", "--certificate", "models"), "models is a folder"),
        (("check", "neuron", "--json=models"), "models is a folder"),
        (("check", "neuron", "--limit", "3"), "is for --library"),
        (("window", "windowless.py"), "has no adaptive theta, whose window would be the default; give one by --d"),
        (("check", "broken.py"), "broken.py, line 1: ModuleNotFoundError"),
        (("check", "empty.py"), "defines no plant"),
        (("build", "plantless.py"), "defines no step"),
        (("simulate", "untried.py", "--trial", "short"), "'short' is none of proposed"),
        (("simulate", "neuron", "--trial", "long"), "'long' is none of short"),
        (("simulate", "neuron", "--engine", "rust"), "rust"),
        (("simulate", "neuron", "--seeds", "0"), "seeds"),
        (("build", "neuron", "--out", "log.csv"), "cannot write log.csv"),
        (("build", "neuron", "--real", "half"), "half"),
        (("build", "neuron", "--target", "rusty"), "--target rusty: there is no such target; did you mean rust?"),
        (("generate", "neuron", "--target", "java"), f"--target java: there is no such target; there are {LANGUAGES}"),
        (("run", "neuron"), "--data"),
        (("run", "neuron", "--data", "none.csv", "--time", "time"), "none.csv: there is no such file"),
        (("run", "neuron", "--data", "models", "--time", "time"), "models: is a folder"),
        (("run", "neuron", *LOG), "give either --time COLUMN or --period TIME"),
        (("run", "neuron", *LOG, "--time", "clock"), "no column 'clock'; its columns are time, potential, drive"),
        (("run", "neuron", *LOG, "--period", "-1"), "positive number of seconds"),
        (("run", "neuron", *LOG, "--period", "often"), "--period"),
        (("run", "neuron", *LOG, "--time", "time", "--map", "z=drive"), "the signals are u, y"),
        (("run", "neuron", *LOG, "--time", "time", "--map", "u=driv"), "map u twice"),
        (("run", "neuron", *LOG[:4], "--time", "time", "--map", "u=driv"), "did you mean 'drive'?"),
        (("run", "neuron", "--data", "log.csv", "--time", "time"), "say --map u=COLUMN, one of time, potential, drive"),
        (("run", "neuron", *LOG, "--time", "time", "--horizon", "1,x"), "positive whole numbers"),
        (("run", "neuron", *LOG, "--time", "time", "--horizon", "0"), "positive whole numbers"),
        (("run", "neuron", *LOG, "--time", "time", "--initial", "x1=1,x2=0,x1=2"), "x1 is given twice; leave one of"),
        (("run", "neuron", *LOG, "--time", "time", "--truth", "x2=u", "--truth", "x2=y"), "x2 is given twice"),
        (("run", "neuron", *LOG, "--time", "time", "--out", "log.csv"), "cannot write log.csv"),
        (("fit", "neuron", *LOG, "--time", "time", "--free", ""), "'' holds no name; give some, or leave the option"),
        (("tune", "neuron", *LOG, "--time", "time", "--observers", ""), "--observers: '' holds no name"),
        (("tune", "neuron", *LOG, "--time", "time", "--segments", "700"), "must be a whole number, from 2 to 665"),
        (("advise", "neuron", "--noise", "y=1", "--noise", "y=2"), "y is given twice; leave one of them out"),
        (("run", "neuron", "--data", "header.csv", "--time", "time"), "header but no rows"),
        (("run", "neuron", "--data", "void.csv", "--time", "time"), "is empty"),
        (
            ("noise", "neuron", "--data", "log.csv", "--time", "time", "--map", "y=potential", "--to", "0.1"),
            "at least 100",
        ),
        (("noise", "neuron", *LOG, "--time", "time", "--window", "-1"), "the window d = -1 s"),
        (("noise", "neuron", *LOG, "--time", "time", "--window", "0.001"), "must lie within 0.01..10 s"),
        (("noise", "neuron", *LOG, "--time", "time", "--window", "11"), "must lie within 0.01..10 s"),
        (("noise", "neuron", *LOG, "--time", "time", "--from", "10", "--to", "5"), "leave 0 of its rows"),
        (("noise", "neuron", *LOG, "--time", "time", "--from", "20"), "times run from 0 to 9.99 s"),
        (("noise", "windowless.py", *LOG, "--time", "time"), "hgogen: windowless.py: its tuning has no adaptive"),
    ],
)
def test_bad_input_is_a_sentence_and_exit_2(here: Path, arguments: tuple[str, ...], said: str):
    (here / "broken.py").write_text("import nothing_of_that_name\n")
    (here / "empty.py").write_text("x = 1\n")
    text = NEURON.read_text()
    (here / "plantless.py").write_text(text[: text.index("def step")])
    (here / "untried.py").write_text(text[: text.index("def trial")])
    (here / "windowless.py").write_text(text + "\n\ntuned = step()\ntuning = {}\ndef step(): return tuned\n")
    (here / "header.csv").write_text("time,u,y\n")
    (here / "void.csv").write_text("")
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    _, err = hgogen(*arguments, status=2)
    assert said in err
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


def test_a_name_is_given_once_and_some_name_at_least() -> None:
    assert numbers_by_name(["a=1,b=2", "c=3"], "--initial") == {"a": 1, "b": 2, "c": 3}
    for texts in (["a=1,b=2,a=3"], ["a=1", "a=2"]):
        with pytest.raises(BadParameter, match="a is given twice"):
            numbers_by_name(texts, "--initial")
    assert (names_in(None, "--lag"), names_in("a, b", "--lag")) == ((), ("a", "b"))
    for text in ("", " ", ","):
        with pytest.raises(BadParameter, match=f"{text!r} holds no name"):
            names_in(text, "--lag")


def test_new_writes_a_model_that_builds(here: Path):
    """Each part under a comment line of its own; what is built of it is checked, tried and drawn."""
    assert as_json("new", "spring") == {"model": "spring", "files": ["spring.py"]}
    text = (here / "spring.py").read_text()
    assert "NAME" not in text
    parts = re.split(r"\n\n+(?! |    )", text.partition("t\n\n")[2])
    assert len(parts) >= 7
    assert [part for part in map(str.strip, parts) if not re.match(r"# .*\n[^#]", part)] == []
    out, err = hgogen("build", "spring.py")
    assert "refuted" not in out
    assert err == ("" if native.compiler() else err)
    assert {"spring.h", "spring.c", "report.json", "blow_states.svg"} <= set(files(here / "build" / "spring"))
    hgogen("compare", "spring.py", "--observers", "high_gain,riccati", "--seeds", "1")


def test_new_writes_into_a_folder_and_replaces_nothing(here: Path):
    hgogen("new", "spring", "--out", "made/here")
    path = here / "made" / "here" / "spring.py"
    path.write_text("mine")
    for name in ("spring", "spring.py"):
        _, err = hgogen("new", name, "-o", "made/here", status=2)
        assert f"cannot write {Path('made/here/spring.py')}: it is there already" in err
    assert path.read_text() == "mine"
    (here / "led.py").symlink_to("nowhere")
    hgogen("new", "led", status=2)
    assert not (here / "nowhere").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("two words", "is not an identifier"),
        ("../up", "is not an identifier"),
        ("spring.toml", "is not an identifier"),
        ("a__b", "has a double underscore"),
        ("con", "is that of a device on Windows"),
        ("math", "hides <math.h>; rename the model"),
        ("a" * 101, "is longer than 100 bytes"),
    ],
)
def test_new_refuses_a_name_that_is_none(here: Path, name: str, said: str):
    before = sorted(here.rglob("*"))
    assert said in hgogen("new", name, status=2)[1]
    assert sorted(here.rglob("*")) == before


def test_the_version_is_that_of_the_project(here: Path):
    assert hgogen("--version") == (f"hgogen {VERSION}\n", "")
    assert hgogen("-h")[0].count("--version") == 1


@pytest.mark.full
def test_the_installed_command(here: Path):
    """One run in a process of its own, for what a runner inside this one cannot see."""
    command = [sys.executable, "-c", "from hgogen.cli import main; main()"]
    good = subprocess.run([*command, "list", "--json"], capture_output=True, text=True, check=False)
    assert (good.returncode, good.stderr) == (0, "")
    assert json.loads(good.stdout)["models"]
    bad = subprocess.run([*command, "check", "none"], capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.startswith("hgogen: none: ")
    assert bad.stderr.count("\n") == 1


# --- observers by name --------------------------------------------------------------------------------------------

PENDULUM = MODELS / "pendulum.py"


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_every_command_takes_an_observer_by_name(here: Path):
    answer = as_json("check", str(PENDULUM), "--observer", "low_power")
    assert answer["theorem"]["reference"].startswith("Astolfi, Marconi")
    (trial,) = as_json("simulate", str(PENDULUM), "--observer", "low_power", "--seeds", "1")["trials"]
    assert trial["falling"] is None
    assert trial["rms"]["w"] < 0.01
    (written,) = as_json("generate", str(PENDULUM), "--observer", "low_power", "-o", "c")["models"]
    assert str(Path("c/pendulum_low_power/pendulum.c")) in written["files"]
    header = (here / "c" / "pendulum_low_power" / "pendulum.h").read_text()
    assert "hgogen generate pendulum --observer low_power" in " ".join(header.replace("\n *", "\n").split())


@pytest.mark.parametrize("command", ["check", "simulate", "build", "generate"])
def test_an_observer_without_a_tuning_is_a_sentence(here: Path, command: str):
    bare = here / "bare.py"
    bare.write_text(PENDULUM.read_text().replace('"bank": {', '"riccati_twice": {"kind": "bank", '))
    _, err = hgogen(command, str(bare), "--observer", "bank", status=2)
    assert f"{bare}: it has tunings for " in err
    assert "none for bank; add 'bank': {...} to tuning, with member, count, period" in err


def test_a_theory_that_refuses_says_why(here: Path):
    """The observer's own sentence, with file and key."""
    text = PENDULUM.read_text().replace('"low_power": {"theta": 20}', '"low_power": {"theta": -0.5}')
    (here / "low.py").write_text(text)
    _, err = hgogen("simulate", "low.py", "--observer", "low_power", status=2)
    assert err == "hgogen: low.py, tuning.low_power: theta = -0.5 must be a positive finite number\n"


# --- names --------------------------------------------------------------------------------------------------------

NAMES = """name = "names"
states.E = {low = 1, high = 2, flow = "beta*S - gamma*E"}
states.S = {low = 1, high = 2, flow = "N + I*lambda_*sin(S)"}
states.N = {low = 1, high = 2, flow = "Q"}
states.Q = {low = 1, high = 2, flow = "-Q*I"}
inputs.I = {low = 1, high = 2}
parameters.beta = {value = 1.0}
parameters.gamma = {value = 1.0}
parameters.lambda_ = {value = 1.0, low = 0.5, high = 2}
outputs.O = {equation = "E"}
observer = {kind = "high_gain", theta = 20, poles = [-1, -1, -1, -1], method = "rk4", dt = 1e-3}
"""


@pytest.mark.full
def test_names_that_mean_something_else_elsewhere(here: Path):
    """E, I, S, N, Q, O, beta and gamma are SymPy's, lambda Python's, I a macro of complex.h."""
    (here / "names.toml").write_text(NAMES)
    answer = as_json("check", "names.toml", "--bound", "E*S + Q*N*lambda_ + beta*gamma + O + I")
    assert answer["refuted"] == []
    assert answer["coordinates"] == {"z1": "E", "z2": "S", "z3": "N", "z4": "Q"}
    assert answer["flow"]["z2"] == "I*lambda_*sin(z2) + z3"
    assert {check["id"]: check["verdict"] for check in answer["checks"]}["triangular.a_3"] == "proved"
    (bound,) = answer["bounds"]
    assert bound["low"] <= 4.5  # 1 + 1*0.5 + 1 + 1 + 1
    assert 17 <= bound["high"] < 17.4  # 4 + 8 + 1 + 2 + 2


@pytest.mark.full
@needs_compiler
def test_names_that_mean_something_else_in_c(here: Path):
    (here / "names.toml").write_text(NAMES)
    hgogen("generate", "names.toml")
    flags = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", "-c", "-o", "names.o")
    subprocess.run([str(native.compiler()), *flags, "generated/names/names.c"], check=True)
    subprocess.run([str(native.compiler()), *flags, "-DNAMES_USE_LIBM", "generated/names/names.c"], check=True)


# --- every model ----------------------------------------------------------------------------------------------------


def keys(value: Any, free: tuple[str, ...]) -> set[str]:
    """Every key of a JSON value, but for those of the objects whose keys are names of the plant."""
    if isinstance(value, list):
        return {key for part in value for key in keys(part, free)}
    if not isinstance(value, dict):
        return set()
    return set(value).union(*(keys(part, free) for key, part in value.items() if key not in free))


@pytest.mark.ordinary("sir.toml")
@pytest.mark.parametrize("name", ["quadruple_tank.toml", "sir.toml", "haldane.toml", "pendulum.py"])
def test_the_json_of_a_check_is_documented(here: Path, name: str):
    """Every key, however deep; a number is finite or null, and an observer's refused hypothesis alone exits with 1."""
    answer = as_json("check", str(MODELS / name), "--bound", "1/2")
    words = set(re.findall(r"\w+", hgogen("schema", "check")[0]))
    free = (
        "witness",
        "coordinates",
        "flow",
        "outputs",
        "gains",
        "direction",
        "where",
        "values",
    )  # whose keys are names
    assert keys(answer, free) <= words
    assert {row["verdict"] for row in answer["forms"]} <= {None, "proved", "refuted", "where", "generic", "unknown"}


CHECK = ("check", str(MODELS / "lotka_volterra.toml"))


@pytest.mark.ordinary("arguments3")
@pytest.mark.parametrize(
    "arguments", [CHECK, (*CHECK, "--json"), (*CHECK, "--latex"), ("--help",), ("check", "--help")]
)
def test_a_reader_that_stops_early_is_no_error(arguments: tuple[str, ...]):
    """As `hgogen check MODEL | head -1`."""
    command = [sys.executable, "-c", "from hgogen.cli import main; main()", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()  # type: ignore[union-attr]
    process.stdout = None
    assert process.communicate() == (None, "")
    assert process.returncode == UNREAD


@pytest.mark.full
@pytest.mark.parametrize("module", ["hgogen", "hgogen.cli"])
def test_python_runs_the_command_as_a_module(module: str) -> None:
    done = subprocess.run([sys.executable, "-m", module, "list", "--json"], capture_output=True, text=True, check=True)
    assert "low_power" in json.loads(done.stdout)["observers"]


@pytest.mark.parametrize(
    ("words", "offered"), [("hgogen re", {"recheck", "report", "response"}), ("hgogen run --ma", {"--map"})]
)
def test_a_shell_completes_commands_and_options(words: str, offered: set[str]) -> None:
    env = {**os.environ, "_HGOGEN_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    code = "from hgogen.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.argv = ['hgogen']; {code}"], env=env, capture_output=True, text=True
    )
    assert set(done.stdout.split()) == offered


def test_a_table_of_many_outputs_goes_on_below(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    """Each part names its rows, and every number and header is there once and whole; a table that fits has one part."""
    names = [f"{y} {ahead}" for ahead in (1, 5, 25) for y in ("east", "north")]
    numbers = [f"0.01234{k}" for k in range(len(names))]
    for columns, parts in ((42, 3), (110, 1)):
        monkeypatch.setenv("COLUMNS", str(columns))
        table = headed("errors", "", "observer", *names, numbers=len(names))
        table.add_row("take", "riccati", *numbers)
        console().print(table)
        text = capsys.readouterr().out
        assert max(map(len, text.splitlines())) <= columns
        assert re.findall(r"0\.\d+", text) == numbers
        assert re.findall(r"[a-z]+ \d+", text) == names
        assert [text.count(word) for word in ("errors", "observer", "take  riccati")] == [1, parts, parts]
