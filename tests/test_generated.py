"""What is committed in generated/ is what the generator makes now."""

import json
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from pinned import OLDEST, differing, versions
from test_cli import hgogen

from hgogen.extras.costs import digest
from hgogen.model import MissingPart, load

ROOT = Path(__file__).parent.parent
MODELS = {path.stem: path for path in sorted((ROOT / "models").glob("*.*"))}
GENERATED = sorted(path.name for path in (ROOT / "generated").iterdir() if path.is_dir())
FEW = ("cascaded_tanks", "fitzhugh_nagumo", "hyperjerk", "pendulum")  # that every run makes again
WITHOUT = {"sir"}  # for which no observer is written
COST = "cost.json"  # by a command of its own


def test_every_model_with_a_step_is_generated() -> None:
    assert set(GENERATED) == set(MODELS) - WITHOUT
    for name in WITHOUT:
        with pytest.raises(MissingPart):
            load(MODELS[name]).step()


@pytest.mark.ordinary("hyperjerk", "pendulum")
@pytest.mark.pinned
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in FEW else pytest.mark.slow) for name in GENERATED]
)
def test_the_text_is_the_same_byte_for_byte(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # the command that the files tell of has the paths from there
    fresh = tmp_path
    hgogen("generate", str(MODELS[name].relative_to(ROOT)), "-o", str(fresh))
    committed = {path.name for path in (ROOT / "generated" / name).iterdir()} - {COST}
    made = {path.name for path in (fresh / name).iterdir()}
    assert committed == made
    sources = [file for file in made if file.endswith((".c", ".h", ".md"))]
    assert len(sources) == 4
    for file in sources:
        same = (ROOT / "generated" / name / file).read_bytes() == (fresh / name / file).read_bytes()
        assert same, f"{file} differs; {differing() or 'the installed versions are those that made it'}"


@pytest.mark.parametrize("name", GENERATED)
def test_the_costs_are_of_this_text(name: str) -> None:
    """As `hgogen cost` has written them."""
    folder = ROOT / "generated" / name
    assert json.loads((folder / COST).read_text())["source"] == digest((folder / f"{name}.c").read_text())


# --- the versions that made it ------------------------------------------------------------------------------


def test_every_lower_end_is_tested() -> None:
    """`.ci/oldest.txt` has the first version of each range, but of linters, of a compiler, and of what builds the wheel
    or the site."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [line for extra in extras if extra not in ("docs", "wasm") for line in extras[extra]]
    wanted = {one.name: one.specifier for one in map(Requirement, (*project["dependencies"], *lines))}
    oldest = versions(OLDEST)
    assert set(wanted) - set(oldest) == {"hgogen", "hatchling", "mypy", "ruff"}
    for name, version in oldest.items():
        (lowest,) = (part.version for part in wanted[name] if part.operator == ">=")
        assert Version(lowest) == Version(version), name


def test_versions_that_differ_are_named() -> None:
    assert differing(versions().__getitem__) == ""
    others = {**versions(), "sympy": "1.0", "numpy": "1.1"}
    sentence = f"numpy 1.1 (made with {versions()['numpy']}), sympy 1.0 (made with {versions()['sympy']})"
    assert differing(others.__getitem__) == f"installed are other versions than made generated/: {sentence}"
    assert ("sympy" in differing()) is (metadata.version("sympy") != versions()["sympy"])


def test_every_requirement_has_a_version_in_its_range() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [Requirement(line) for line in project["dependencies"]]
    assert {one.name for one in needed} <= set(versions())
    assert [str(one) for one in needed if versions()[one.name] not in one.specifier] == []
    assert [str(one) for one in needed if {part.operator for part in one.specifier} != {">=", "<"}] == []
