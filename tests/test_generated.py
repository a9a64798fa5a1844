"""What is committed in generated/ is what the generator makes now."""

import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import conftest
import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from pinned import OLDEST, differing, versions
from test_cli import hgogen

ROOT = Path(__file__).parent.parent
MODELS = sorted(path.name for path in (ROOT / "generated").iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generated")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)  # the command that the files tell of has the paths from there
        hgogen("generate", *(f"models/{name}.py" for name in MODELS), "-o", str(folder))
    return folder


def test_what_is_generated_is_of_models() -> None:
    assert {"cascaded_tanks", "fitzhugh_nagumo", "pendulum"} <= set(MODELS)
    assert {path.stem for path in (ROOT / "models").glob("*.py")} >= set(MODELS)


@pytest.mark.pinned
@pytest.mark.parametrize("name", MODELS)
def test_the_text_is_the_same_byte_for_byte(name: str, fresh: Path) -> None:
    committed = {path.name for path in (ROOT / "generated" / name).iterdir()}
    made = {path.name for path in (fresh / name).iterdir()}
    assert committed == made
    sources = [file for file in made if file.endswith((".c", ".h", ".md"))]
    assert len(sources) == 4
    for file in sources:
        same = (ROOT / "generated" / name / file).read_bytes() == (fresh / name / file).read_bytes()
        assert same, f"{file} differs; {differing() or 'the installed versions are those that made it'}"


# --- the versions that made it ------------------------------------------------------------------------------


def test_every_lower_end_is_tested() -> None:
    """`.ci/oldest.txt` has the first version of each range; of linters and of what builds the wheel it has none."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [line for extra in extras if extra != "docs" for line in extras[extra]]
    wanted = {one.name: one.specifier for one in map(Requirement, (*project["dependencies"], *lines))}
    oldest = versions(OLDEST)
    assert set(wanted) - set(oldest) == {"hgogen", "hatchling", "mypy", "ruff"}
    for name, version in oldest.items():
        (lowest,) = (part.version for part in wanted[name] if part.operator == ">=")
        assert Version(lowest) == Version(version), name


def test_every_third_test_is_one_of_each_file() -> None:
    """The first, the fourth, .. of each file, and the others are counted as deselected."""
    tests = [
        SimpleNamespace(path=file, number=k) for file, count in (("a", 7), ("b", 2), ("c", 3)) for k in range(count)
    ]
    items, left = list(tests), list[SimpleNamespace]()
    hook = SimpleNamespace(pytest_deselected=lambda items: left.extend(items))
    config = SimpleNamespace(getoption={"every": 3}.get, hook=hook)
    conftest.pytest_collection_modifyitems(config, items)
    assert [(one.path, one.number) for one in items] == [("a", 0), ("a", 3), ("a", 6), ("b", 0), ("c", 0)]
    assert {id(one) for one in (*items, *left)} == set(map(id, tests))
    assert len(items) + len(left) == len(tests)


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
