"""A budget of time for tests that take hours in all: what changed first, then the others in an order that moves on.

    pytest -m slow --no-loadscope-reorder --budget SECONDS

The test files that changed in the last day of commits, or that import a module that did, come first, then the others.
Both go by name, from another file on at each commit, so that a series of commits runs them all. No test begins after
the budget: it counts as skipped, and the end of the run says how many were left out and where the next commit begins.
"""

import re
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = "left out: the budget of time is spent"
DAY = 24 * 3600  # seconds before the last commit within which a change is recent


def _git(*arguments: str) -> list[str]:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()


def changed_files() -> set[str]:
    """Return the paths, from the root of the project, of the files that changed in the last day of commits."""
    (now,) = _git("log", "-1", "--format=%ct")
    return set(_git("log", f"--since=@{int(now) - DAY}", "--format=", "--name-only"))


def commit_count() -> int:
    """Return the number of commits up to now: where the order of the files begins."""
    return int(_git("rev-list", "--count", "HEAD")[0])


def concerns(test: Path, changed: Iterable[str]) -> bool:
    """Whether a test file changed, or names a changed module of the package in an import."""
    if test.relative_to(ROOT).as_posix() in changed:
        return True
    modules = {path.removesuffix(".py").replace("/", ".") for path in changed if path.startswith("hgogen/")}
    imports = re.findall(r"^ *(?:from (hgogen[\w.]*) import ([\w, ]+)|import (hgogen[\w.]*))", test.read_text(), re.M)
    names = {f"{package}.{name.strip()}" for package, several, _ in imports for name in several.split(",")}
    return not modules.isdisjoint(names | {name for package, _, alone in imports for name in (package, alone)})


def ordered(files: Iterable[Path], first: Iterable[Path], count: int) -> list[Path]:
    """Return the files with `first` before the others, each of the two from the count-th on, around the end."""
    first = set(first)
    groups = (sorted(first), sorted(set(files) - first))
    begins = (count % max(1, len(group)) for group in groups)
    return [file for group, k in zip(groups, begins, strict=True) for file in (*group[k:], *group[:k])]


class Budget:
    """The plugin: tests in that order, none of which begins `seconds` after the start."""

    def __init__(self, seconds: float) -> None:
        self.end = time.monotonic() + seconds
        self.files = sorted((ROOT / "tests").glob("test_*.py"))

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort the test files."""
        changed = changed_files()
        first = [file for file in self.files if concerns(file, changed)]
        place = {file: k for k, file in enumerate(ordered(self.files, first, commit_count()))}
        items.sort(key=lambda item: place[item.path])

    def pytest_runtest_setup(self) -> None:
        """Leave out a test that would begin too late."""
        if time.monotonic() >= self.end:
            pytest.skip(LEFT_OUT)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Say how many tests were left out, of which files, and where the order of the next commit begins."""
        reports = [each for reports in terminalreporter.stats.values() for each in reports if hasattr(each, "longrepr")]
        left = [each.nodeid.split("::")[0] for each in reports if LEFT_OUT in str(each.longrepr)]
        names = {each.nodeid.split("::")[0] for each in reports}
        here = [file for file in self.files if file.relative_to(ROOT).as_posix() in names]
        coming = [file.name for file in ordered(self.files, (), commit_count() + 1) if file in here]
        terminalreporter.write_line(f"left out: {len(left)} tests, of {', '.join(sorted(set(left))) or 'no file'}")
        if coming:
            terminalreporter.write_line(f"next commit: what it changes, then the others from {coming[0]} on")
