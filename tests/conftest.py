"""What is the same for every test."""

import gc
import os
import signal
import sys
from collections.abc import Collection, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from budget import Budget
from forgetful import forget, know
from hypothesis import HealthCheck, settings

from hgogen.run import native

# Each run, and each process that a test starts, would compile the whole package, and each worker all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# What a process writes is buffered, as it is for most users.
os.environ.pop("PYTHONUNBUFFERED", None)

# How long an example takes says nothing: a first one may import what it needs. Where CI is set examples are the same
# each time, with any version of hypothesis.
settings.register_profile(
    "hgogen", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize="CI" in os.environ
)
settings.load_profile("hgogen")

collect_ignore = ["fixtures"]  # cases for a copy of the project, where their tests are run

# What others stand for, as tests/full_cases.py found them.
LONG_CASES = frozenset((Path(__file__).parent / "full_cases.txt").read_text(encoding="utf-8").splitlines())
RUN = pytest.StashKey[tuple[str, ...]]()  # the names of the tests that a run takes
ABSENT = pytest.StashKey[tuple[str, ...]]()  # and of representatives that there are not

# Graphs and expressions are many small objects, most of them alive to the end: a collection for every 700 new ones
# takes a twelfth of the run.
gc.set_threshold(20_000, 20, 20)


WITHOUT = native.compiler() is None  # asked before a test can hide the compiler


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """Where a machine has no compiler, or no other tool, a test that comes to need it is skipped."""
    try:
        yield
    except (native.NoCompiler, native.NoTool) as missing:
        if WITHOUT:
            pytest.skip(str(missing))
        raise


pytest_runtest_call = pytest_runtest_setup


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C is heard, which a process ignores that a shell began in its background; and not in what hypothesis has
    the garbage collector call, where it would be lost."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.disable()
    yield
    gc.enable()
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Figures are made and their files written, but not drawn into these: for tests that ask something else of a
    command, which takes less time than to draw. The others draw."""
    from hgogen.run import figures

    def empty(name: str, _: Any) -> dict[str, bytes]:
        return {f"{name}.{kind}": b"" for kind in ("svg", "png")}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "files", empty)
        yield


class Patching(pytest.MonkeyPatch):
    """What is patched is asked anew of observers and steps, and so is what was before, afterwards."""

    def setattr(self, *args: Any, **options: Any) -> None:
        super().setattr(*args, **options)
        forget()

    def undo(self) -> None:
        patched = bool(self._setattr)
        super().undo()
        if patched:
            forget()


@pytest.fixture
def monkeypatch() -> Iterator[pytest.MonkeyPatch]:
    """Pytest's own, by which a test gets nothing that was made before it patched the package, and leaves nothing."""
    patch = Patching()
    yield patch
    patch.undo()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--every", type=int, default=1, metavar="K", help="run every K-th test of each file")
    parser.addoption("--budget", type=float, metavar="SECONDS", help="begin no test later: see tests/budget.py")


def pytest_configure(config: pytest.Config) -> None:
    seconds = config.getoption("budget")
    if seconds is not None:
        config.pluginmanager.register(Budget(seconds), "budget")


@pytest.hookimpl(wrapper=True)  # around the one that deselects by marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    absent = (*stand_for_others(items), *leave_long_cases(items, LONG_CASES))
    config.stash[ABSENT] = () if any("::" in arg for arg in config.args) else absent  # of tests that are not all there
    yield
    every(config, items)
    config.stash[RUN] = tuple(item.nodeid for item in items)


def stand_for_others(items: list[pytest.Item]) -> tuple[str, ...]:
    """Mark as full the cases of each test that are not `ordinary`, unless none is, as without a compiler. Return the
    names of those that are not there."""
    absent = []
    for (path, name), cases in groupby(items, key=lambda item: (item.path, getattr(item, "originalname", item.name))):
        family = list(cases)
        named = family[0].get_closest_marker("ordinary")
        if named is None:
            continue
        chosen = {k: [case for case in family if stands(k, case)] for k in named.args}
        absent += [f"{path.name}::{name}[{k}]" for k in chosen if not chosen[k]]
        for case in set(family).difference(*chosen.values()) if any(chosen.values()) else ():
            case.add_marker("full")
    return tuple(absent)


def leave_long_cases(items: list[pytest.Item], names: Collection[str]) -> tuple[str, ...]:
    """Mark the named cases as full. Return those names that no case of the collected files has."""
    for item in items:
        if item.nodeid in names:
            item.add_marker("full")
    files, there = {item.nodeid.partition("::")[0] for item in items}, {item.nodeid for item in items}
    return tuple(name for name in sorted(names) if name.partition("::")[0] in files and name not in there)


def stands(named: str, case: pytest.Item) -> bool:
    """Whether a case is the named one, or one whose name begins so."""
    id = case.name.partition("[")[2][:-1]
    return id.startswith(named[:-1]) if named.endswith("*") else id == named


def every(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep every K-th test of each file, where that is asked for, of those that marks leave."""
    files = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    chosen = [item for tests in files for item in tests[:: config.getoption("every")]]
    others = set(map(id, items)) - set(map(id, chosen))
    config.hook.pytest_deselected(items=[item for item in items if id(item) in others])
    items[:] = chosen


def pytest_collection_finish() -> None:
    """What is imported by now is never garbage."""
    know()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    """Pytest looks for garbage five times at its end, and Python as it ends, among all that the tests have made: what
    is none at the first look is none at the others."""
    gc.collect()
    gc.freeze()
