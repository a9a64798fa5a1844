"""Library runs: what each field says, bad models beside good ones, time limits, crashes."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hgogen import cli
from hgogen.commands.library import FIELDS, BadLibrary, End, Event, answers, check, read, run
from hgogen.errors import HgogenError
from hgogen.reading.expression import parse
from hgogen.reading.text_model import FORMAT, entry
from hgogen.rigor.bounds import bound

GOOD: dict[str, Any] = {
    "name": "good",
    "states": ["x1", "E"],
    "inputs": ["u"],
    "outputs": ["y"],
    "f": ["-2*u*E", "-x1**3"],
    "h": ["x1"],
    "x_box": {"x1": ["-1", "pi/3"], "E": [0, 1]},
    "u_box": {"u": [0.5, 2]},
    "bound_queries": ["x1**2 - x1 + 1", "1/E"],
}


def asked(model: dict[str, Any]) -> dict[str, Any]:
    return dict(answers(entry(model)))


@pytest.mark.full
def test_every_field_of_a_model() -> None:
    answer = check([("good", GOOD)])["good"]
    assert answer.pop("notes") == ["bound_queries, '1/E': it is not a finite real number at E = 0"]
    assert list(answer) == list(FIELDS)
    (low, high), pole = answer.pop("bounds")
    assert 0.7 < low <= 0.75
    assert 3 <= high < 3.1
    assert pole is None
    assert 0 < answer.pop("seconds") < 5
    ((least, most),) = answer.pop("a_ranges")
    assert 0.99 < least <= 1
    assert 4 <= most < 4.01
    structure = dict.fromkeys(("triangular", "triangular_uy", "uof_structure", "uof", "lipschitz"), True)
    structure |= dict.fromkeys(("mimo_levelwise", "mimo_cascade", "mimo_uof"), True)
    names = {"order": ["x1", "E"], "observable_params_known": ["x1", "E"], "observable_joint": ["x1", "E"]}
    ranks = {"rank_params_known": 2, "rank_joint": 2}
    assert answer == {**structure, **names, **ranks, "gb_uniform": False, "singular": "all"}


def test_a_bound_says_where_there_is_no_value() -> None:
    """As --bound does: sqrt(3 - x) has a range on [0, 3.14], and no value beyond 3."""
    model = GOOD | {"x_box": {"x1": [0, 3.14], "E": [0.5, 1]}, "bound_queries": ["sqrt(3 - x1)", "1/E"]}
    answer = check([("good", model)])["good"]
    (low, high), _ = answer["bounds"]
    assert low <= 0 < 3**0.5 <= high < 1.8
    (note,) = answer["notes"]
    enclosure = bound(parse("sqrt(3 - x1)", entry(model).symbols), entry(model).outer)
    assert note == f"bound_queries, 'sqrt(3 - x1)': {enclosure.note}"
    assert "it is not a finite real number at x1 = 157/50" in note


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"f": ["1"]}, "2 states and 1 expressions in f"),
        ({"states": ["x1", "x1"]}, "'x1' is listed twice"),
        ({"states": ["x1", 2]}, "which is no name"),
        ({"states": "x1"}, "write a list"),
        ({"states": [], "f": []}, "has no states"),
        ({"outputs": [], "h": []}, "has no outputs"),
        ({"f": ["E", None]}, "write each expression as text"),
        ({"f": ["E", "w"]}, "'w' is not declared"),
        ({"f": ["E", "__import__('os')"]}, "__import__"),
        ({"x_box": {"x1": [1, 0]}}, "holds no number; give low <= high"),
        ({"x_box": {"x1": [float("nan"), 0]}}, "which is no number"),
        ({"x_box": {"x1": ["oo", "oo"]}}, "holds no number"),
        ({"x_box": {"x1": [1]}}, "write [low, high]"),
        ({"x_box": {"x1": ["sqrt(-1)", 1]}}, "real"),
        ({"x_box": {"u": [0, 1]}}, "none of its states"),
        ({"x_box": [0, 1]}, "write an object of ranges"),
    ],
)
def test_a_bad_model_is_a_sentence_and_harms_no_other(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(HgogenError) as caught:
        entry(GOOD | change)
    assert sentence in str(caught.value)


def test_bad_models_beside_a_good_one() -> None:
    models = [("bad", GOOD | {"name": "bad", "f": ["1"]}), ("good", GOOD), ("good2", GOOD | {"name": "good2"})]
    models += [("models[3]", 3), ("two", GOOD | {"name": "two"}), ("two", GOOD | {"name": "two"})]
    by_name = check(models)
    assert [name for name, answer in by_name.items() if "error" in answer] == ["bad", "models[3]", "two"]
    assert "2 models are named 'two'" in by_name["two"]["error"]
    assert by_name["good"]["triangular"] is True
    assert all(by_name["bad"][field] is None for field in FIELDS)


def test_a_bad_query_leaves_the_other_answers() -> None:
    answer = asked(GOOD | {"bound_queries": ["w", "u"]})
    assert "'w' is not declared" in answer["error"]
    assert answer["bounds"] == [None, [0.5, 2.0]]
    assert answer["uof"] is True


@pytest.mark.ordinary("change10-expected10", "change17-expected17", "change18-expected18")
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"u_box": {"u": [-1, 1]}}, {"triangular": False, "uof": False, "uof_structure": True}),
        ({"u_box": {"u": [0, 1]}}, {"triangular": False, "uof": False}),
        ({"f": ["E/u", "0"], "u_box": {"u": [-1, 1]}}, {"triangular": False, "uof": False}),
        ({"f": ["E/u", "0"], "u_box": {"u": [0, 1]}}, {"triangular": None, "uof": None}),
        ({"f": ["sqrt(E)", "0"], "x_box": {"E": [0, 1]}}, {"triangular": False, "uof": None}),
        ({"u_box": None}, {"triangular": None, "uof": None, "uof_structure": True}),
        ({"u_box": None, "x_box": None}, {"triangular": True, "uof": None, "lipschitz": None, "a_ranges": None}),
        ({"u_box": None, "f": ["(1 + u**2)*E", "0"]}, {"triangular": True, "uof": True}),
        ({"f": ["x1*E", "0"]}, {"triangular": False, "triangular_uy": False, "uof_structure": True}),
        ({"f": ["E**3", "0"]}, {"triangular": False, "uof": False, "uof_structure": True}),
        ({"f": ["E + E**3", "0"]}, {"triangular": False, "uof": True}),
        ({"f": ["Piecewise((E, E < 0), (E - 1, True))", "0"]}, {"uof": True, "mimo_uof": True}),  # one branch
        (
            {"f": ["Piecewise((E, E < 0), (E - 1, True))", "0"], "x_box": {"x1": [-1, 1], "E": [-1, 1]}},
            {"uof": None, "mimo_uof": None, "uof_structure": True},
        ),
        ({"f": ["log(E)", "0"], "x_box": {"x1": [-1, 1], "E": [1, 2]}}, {"uof": True, "mimo_uof": True}),
        ({"f": ["log(E)", "0"], "x_box": {"x1": [-1, 1], "E": [-2, -1]}}, {"uof": None, "mimo_uof": None}),  # no real
        ({"f": ["atanh(E)", "0"], "x_box": {"x1": [-1, 1], "E": [2, 3]}}, {"uof": None, "mimo_uof": None}),
        ({"f": ["u*E + sign(x1)*E", "0"], "u_box": {"u": [2, 3]}}, {"triangular": False, "uof": True}),
        ({"f": ["0", "E"]}, {"triangular": False, "uof_structure": False, "uof": False}),
        ({"h": ["x1 + u"]}, {"triangular": None, "uof_structure": True, "uof": True}),
        ({"f": ["u*E", "sqrt(E)"]}, {"triangular": True, "lipschitz": False}),
        ({"f": ["u*E + (E*x1 + E)/E", "-E"], "x_box": {"x1": [-1, 1], "E": [1, 2]}}, {"lipschitz": True}),
        ({"f": ["(u*E**2 + E)/E", "-E"], "x_box": {"x1": [-1, 1], "E": [-1, 2]}}, {"lipschitz": None}),
        ({"f": ["u*E", "x1**2"], "x_box": {"E": [0, 1]}}, {"triangular": True, "lipschitz": None}),
        ({"f": ["cos(u)*E", "0"], "u_box": {"u": [0, "pi/2"]}}, {"triangular": None}),
        ({"f": ["cos(u)*E", "0"], "u_box": {"u": [0, "pi/3"]}}, {"triangular": True}),
        ({"f": ["(u**2 - 1)/(u - 1)*E", "0"]}, {"triangular": None}),
    ],
)
def test_boxes_decide_where_they_must(change: dict[str, Any], expected: dict[str, Any]) -> None:
    answer = asked(GOOD | change)
    assert {field: answer.get(field) for field in expected} == expected


TABLE: dict[str, Any] = {
    "name": "table",
    "states": {"x1": {"flow": "x2", "low": -1, "high": 1}, "x2": {"flow": "-k*x1 - mu*x2", "low": -2, "high": 2}},
    "parameters": {"mu": {"value": 1.0, "low": 0.5, "high": 2}, "k": {"value": 1.5}},
    "outputs": {"y": {"equation": "x1"}},
    "bound_queries": ["k*x1"],
}


def test_a_plain_text_model_is_a_model() -> None:
    """The same as lists: mu, which has a range, is unknown, and k is known."""
    answer = asked(TABLE)
    assert (answer["triangular"], answer["bounds"]) == (True, [[-1.5, 1.5]])
    assert answer["observable_joint"] == ["x1", "x2", "mu"]
    lists = {"states": ["x1", "x2"], "f": ["x2", "-k*x1 - mu*x2"], "h": ["x1"], "outputs": ["y"], "known_params": ["k"]}
    boxes = {"x_box": {"x1": [-1, 1], "x2": [-2, 2]}, "param_ranges": {"mu": [0.5, 2], "k": [1.5, 1.5]}}
    same = asked({"name": "lists", "unknown_params": ["mu"], "bound_queries": ["k*x1"], **lists, **boxes})
    assert {**answer, "seconds": 0} == {**same, "seconds": 0}
    with pytest.raises(HgogenError, match=r"model 'table', states.x1.flw: there is no key 'flw' here"):
        entry(TABLE | {"states": {"x1": {"flw": "0"}}})


def test_the_format_that_errors_show_is_read() -> None:
    assert asked(json.loads(FORMAT))["uof"] is True
    with pytest.raises(HgogenError, match=r"model 'hello': is no object; write it as"):
        entry("hello")


def test_a_querys_error_names_it() -> None:
    assert asked(GOOD | {"bound_queries": ["u", "x9"]})["error"].startswith("bound_queries, 'x9': ")


def test_files_that_are_no_library(tmp_path: Path) -> None:
    for text in ("", "{", "[]", '{"models": 3}', "[" * 100_000):
        (tmp_path / "in.json").write_text(text)
        with pytest.raises(BadLibrary, match="a library is JSON"):
            read(tmp_path / "in.json")
    with pytest.raises(BadLibrary, match="there is no such file"):
        read(tmp_path / "none.json")


# --- workers ------------------------------------------------------------------------------------------------


def _task(task: Any) -> Iterator[Any]:
    yield "begun"
    if task == "hang":
        time.sleep(3600)
    if task == "wait":
        time.sleep(1.5)
    if task == "spin":
        while True:
            pass
    if task == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if task == "big":
        yield len(bytearray(1 << 40))
    yield task


@pytest.mark.full
def test_a_task_that_hangs_spins_or_crashes_costs_itself_alone() -> None:
    tasks = ["a", "hang", "spin", "crash", "b", "big", "c"]
    events = list(run(_task, tasks, limit=1.0, processes=2))
    ends = {tasks[event.task]: event.end for event in events if event.end}
    late, crashed = {"hang", "spin"}, {"crash", "big"}
    assert ends == {t: End.LATE if t in late else End.CRASHED if t in crashed else End.DONE for t in tasks}
    assert Event(1, "begun") in events
    assert {event.result for event in events if event.result != "begun" and event.result} == {"a", "b", "c"}


@pytest.mark.full
def test_a_task_has_its_time_of_the_processor_however_long_it_waits() -> None:
    """A second and a half by the clock, with a limit of one."""
    begun, result, end = run(_task, ["wait"], limit=1.0, processes=1)
    assert (begun.result, result.result, end.end) == ("begun", "wait", End.DONE)


# --- command line -------------------------------------------------------------------------------------------


def hgogen(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    command = [str(Path(sys.executable).parent / "hgogen"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


@pytest.mark.full
def test_the_command(tmp_path: Path) -> None:
    sixty = [f"x{k}" for k in range(60)]
    steps = [f"x{k + 1}*(1 + x{k}**2)/(2 + sin(x{k}))" for k in range(59)]
    big = {"name": "sixty", "states": sixty, "outputs": ["y"], "f": [*steps, "x0"], "h": ["x0"]}
    (tmp_path / "in.json").write_text(json.dumps({"models": [big, GOOD]}))
    done = hgogen("check", "--library", "in.json", "--json", "out.json", "--limit", "10", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    by_name = json.loads((tmp_path / "out.json").read_text())
    assert by_name["good"]["triangular"] is True
    # found first, since the ranks of sixty states may take all the time
    assert by_name["sixty"]["uof_structure"] is True
    assert by_name["sixty"]["triangular"] is False
    bad = GOOD | {"name": "bad", "f": ["1"]}
    (tmp_path / "in.json").write_text(json.dumps({"models": [bad, GOOD]}))
    stderr = hgogen("check", "--library", "in.json", "--json=new/out.json", cwd=tmp_path).stderr
    assert stderr == "hgogen: wrote new/out.json, in a new folder\nhgogen: 1 of 2 models has an error\n"


def test_what_the_command_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("in.json").write_text("no")

    def refused(*arguments: str) -> str:
        done = CliRunner().invoke(cli.app, ["check", *arguments])
        assert done.exit_code == 2
        return done.stderr

    for option in (("--deep",), ("--certificate", "c.json"), ("--bound", "x1"), ("--latex",)):
        assert "does nothing beside --library" in refused("--library", "in.json", *option)
    assert "in.json: is no JSON" in refused("--library", "in.json", "--json")
    assert "MODEL" in refused()
