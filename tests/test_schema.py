"""`hgogen schema`: what it describes is what the commands print as JSON."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from hgogen.commands.app import command_of, known
from hgogen.commands.command import Meaning, meanings, names
from hgogen.extras.costs import COMPILER, EMULATOR
from hgogen.sentence import Encoded, because, encoded
from tests.test_cli import NEURON, SHORT, as_json, hgogen, undescribed

SPRING = """
name = "spring"
[states.q]
unit = "m"
meaning = "position"
low = -2
high = 2
flow = "v"
[states.v]
unit = "m/s"
meaning = "velocity"
low = -4
high = 4
flow = "-k*q - v/5"
[parameters.k]
unit = "1/s2"
meaning = "stiffness"
value = 3
low = 1
high = 9
[outputs.y]
unit = "m"
meaning = "measured position"
equation = "q"
[trial]
name = "free"
duration = 2
start = {q = 1, v = 0}
noise = {y = 0.001}
seeds = 1
[tuning.high_gain]
theta = 2
poles = [-1, -1]
dt = 0.05
"""
LOG = ("--data", "spring.csv", "--time", "t", "--map", "y=y")
ONE = ("--jobs", "1", "--observers", "high_gain")
LIBRARY = {"models": [{"name": "one", "states": ["x"], "f": ["-x"], "outputs": ["y"], "h": ["x"]}, {"name": "bad"}]}
CALLS = [
    *("list", "new tank", "check neuron --bound x1", "check --library library.json", "build neuron", "generate neuron"),
    *("simulate neuron", "simulate neuron --runs 2 --repeat 1 --jobs 1 --vary x0", "compare neuron --seeds 1"),
    "inspect spring " + " ".join(LOG),
    *("compare neuron --runs 2 --jobs 1", "window neuron", "run spring --horizon 1 " + " ".join(LOG)),
    "noise neuron --data quiet.csv --period 0.01 --map y=y --map u=y",
    *("response spring --omega 1,100", "design spring --rates 0.1", "recheck spring.json"),
    *("advise spring " + " ".join(ONE), "fit spring --starts 1 " + " ".join(LOG)),
    "tune spring --segments 2 --truth v=v " + " ".join((*ONE, *LOG)),
    "cost spring",
    "doctor",
    "report neuron --out neuron.html",
]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with models and logs."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "neuron.py").write_text(NEURON.read_text() + SHORT)
    (tmp_path / "models" / "spring.toml").write_text(SPRING)
    draw, t = np.random.default_rng(3), np.arange(200) * 0.05
    rows = zip(t, np.exp(-t / 10) * np.cos(1.7 * t) + 0.01 * draw.normal(size=len(t)), np.sin(t), strict=True)
    (tmp_path / "spring.csv").write_text("t,y,v\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    (tmp_path / "quiet.csv").write_text("y\n" + "".join(f"{value}\n" for value in 0.1 * draw.normal(size=4000)))
    (tmp_path / "library.json").write_text(json.dumps(LIBRARY))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.mark.ordinary("check --library*", "compare neuron --runs*", "design*")
@pytest.mark.parametrize("call", CALLS)
def test_the_keys_of_every_answer_are_described(here: Path, call: str) -> None:
    if call.startswith("cost") and not all(map(shutil.which, (COMPILER, EMULATOR))):
        pytest.skip("no board")
    if call.startswith("recheck"):
        hgogen("check", "spring", "--certificate", "spring.json")
    as_json(*call.split())


def test_every_command_with_json_is_called_above() -> None:
    described = {name for name in known() if vars(command_of(name)).get("reports")}
    assert described == {call.split()[0] for call in CALLS} == set(known()) - {"schema"}


@pytest.mark.parametrize("name", [name for name in known() if name != "schema"])
def test_every_key_has_a_meaning(name: str) -> None:
    shown, _ = hgogen("schema", name)
    for report in vars(command_of(name))["reports"]:
        rows = list(meanings(report))
        assert [row.name for row in rows if not row.text or "\n" in row.text] == []
        assert all(row.name in shown for row in rows)


def test_what_has_no_json_has_no_schema() -> None:
    assert "schema has no --json" in " ".join(hgogen("schema", "schema", status=2)[1].replace("│", " ").split())
    assert "there is no such command" in hgogen("schema", "chek", status=2)[1]


@dataclass(frozen=True)
class Inner:
    """A result in another."""

    a: Annotated[float, "First"]
    b: Annotated[tuple[str, int] | None, "B of two"]


@dataclass(frozen=True)
class Outer(Encoded):
    """A result."""

    json_keys = "size again=inner.a second=inner.b.1 *inner *more left? each why"

    inner: Inner | None
    more: Inner | None
    left: Annotated[str | None, "what may be left out"]
    each: Annotated[dict[str, Inner], "by name"]
    why: Annotated[object, "a sentence"] = because("{n} things", n=2)

    @property
    def size(self) -> int:
        """Return how many there are.

        Not said.
        """
        return len(self.each)


def test_a_result_is_encoded_by_its_keys() -> None:
    one = Inner(float("inf"), ("x", 3))
    assert Outer(one, None, None, {"k": one}).as_dict() == {
        "size": 1,
        "again": None,
        "second": 3,
        "a": None,
        "b": ["x", 3],
        "each": {"k": {"a": None, "b": ["x", 3]}},
        "why": "2 things",
    }
    assert Outer(None, one, "y", {}).as_dict() == {
        "size": 0,
        "again": None,
        "second": None,
        "a": None,
        "b": ["x", 3],
        "left": "y",
        "each": {},
        "why": "2 things",
    }
    assert encoded({"a": (np.arange(2), np.float64(1.5), Path("b"), True)}) == {"a": [[0, 1], 1.5, "b", True]}


def test_the_keys_of_a_result_are_read_from_its_class() -> None:
    assert names(Outer) == ["size", "again", "second", "a", "b", "a", "b", "left", "each", "why"]
    size, again, second, *_, left, each, a, b, why = meanings(Outer)
    assert size == Meaning("size", 0, "whole number", "return how many there are", False)
    assert again == Meaning("again", 0, "number or null", "first", False)
    assert second == Meaning("second", 0, "whole number or null", "B of two", False)
    assert left == Meaning("left", 0, "text or null", "what may be left out", True)
    assert (each.kind, a.depth, b.kind) == ("object by name", 1, "[text, whole number] or null")
    assert why.kind == "text"


def test_the_search_for_undescribed_keys_finds_them() -> None:
    rows = [Meaning("a", 0, "list of object", "", False), Meaning("b", 1, "number", "", True)]
    assert undescribed(rows, {"a": [{"b": 1}, {}]}) == []
    assert undescribed(rows, {"a": [{"c": 1}], "d": 2}) == ["d", "a.c"]
    assert undescribed(rows, {}) == ["a"]
