"""What a release refuses, before anything is built."""

import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository with a commit, whose changelog has the day of the version."""
    if shutil.which("git") is None or shutil.which("bash") is None:
        pytest.skip("no git or bash")
    folder = tmp_path / "a project"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "release", folder / ".ci")
    (folder / "pyproject.toml").write_text(f'[project]\nversion = "{VERSION}"\n')
    (folder / "CHANGELOG.md").write_text(f"# Changelog\n\n## {VERSION} - 2026-01-31\n")
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "Begin")
    return folder


def git(folder: Path, *words: str) -> None:
    named = ("-c", "user.name=a", "-c", "user.email=a@b")
    subprocess.run(["git", *named, *words], cwd=folder, check=True)


def refused(folder: Path) -> str:
    """The sentence of a release that is refused, which has written nothing."""
    done = subprocess.run([folder / ".ci" / "release"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert not (folder / "build").exists()
    return done.stderr.strip()


def test_a_commit_without_the_tag_of_its_version(project: Path) -> None:
    git(project, "tag", "v0.0.1")
    assert refused(project) == f"release: HEAD has no tag v{VERSION}; git tag v{VERSION}"


@pytest.mark.parametrize("day", ["unreleased", "31 January 2026", "2026-01-31 or so"])
def test_a_version_without_a_day(project: Path, day: str) -> None:
    (project / "CHANGELOG.md").write_text(f"# Changelog\n\n## {VERSION} - {day}\n")
    git(project, "commit", "-qam", "Take the day away")
    git(project, "tag", f"v{VERSION}")
    assert refused(project).startswith(f"release: CHANGELOG.md has no day of {VERSION}; write its heading as ")


@pytest.mark.parametrize("name", ["pyproject.toml", "new.py"])
def test_what_is_not_committed(project: Path, name: str) -> None:
    git(project, "tag", f"v{VERSION}")
    with (project / name).open("a") as file:
        file.write("\n# a change\n")
    assert refused(project) == "release: there are changes; commit or stash them"
