"""Seeded bugs, and the tests that must find them: `python tests/mutations.py` prints which are found, with `--ordinary`
by those of their tests alone that the ordinary run takes.

Each row of mutations.toml changes one place of the code: `pattern`, which the source of `function` (its qualified
name, wherever in the package it stands) holds exactly once, becomes `replacement`. One of `tests` must then fail.
`equivalent` says why no test can tell the change from the original; such a row is not run. `unread`: the row was
written by somebody who had not read the tests.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import cache_from_source
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).parent.parent
ROWS = Path(__file__).with_suffix(".toml")
NO_TESTS = 5  # pytest's status where marks leave none
SECONDS = 300  # for the tests of a row; a change that makes them hang is found as well

Tests = tuple[str, ...]


@dataclass(frozen=True)
class Mutation:
    """A row of mutations.toml."""

    function: str
    pattern: str
    replacement: str
    tests: Tests = ()
    equivalent: str = ""
    unread: bool = False

    def __str__(self) -> str:
        return f"{self.function}: {self.pattern.strip()} -> {self.replacement.strip()}"


class NotOnce(ValueError):
    """A pattern that is not in its function, or in more than one place."""


class NotRun(RuntimeError):
    """Tests that say nothing of a change: they fail without it, or cannot be run."""


@cache
def mutations() -> tuple[Mutation, ...]:
    """All rows."""
    rows = tomllib.loads(ROWS.read_text())["mutation"]
    return tuple(Mutation(**{**row, "tests": tuple(row.get("tests", ()))}) for row in rows)


@cache
def functions() -> dict[str, list[tuple[Path, int, int]]]:
    """Where the functions of a qualified name stand: the file below `ROOT`, the first line, and the one after the last,
    from 0."""
    spans: dict[str, list[tuple[Path, int, int]]] = {}
    for path in sorted((ROOT / "hgogen").rglob("*.py")):
        for name, node in _defined(ast.parse(path.read_text()), ""):
            spans.setdefault(name, []).append((path.relative_to(ROOT), node.lineno - 1, node.end_lineno or 0))
    return spans


def _defined(node: ast.AST, above: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            name = f"{above}{child.name}"
            if isinstance(child, ast.FunctionDef):
                yield name, child
            yield from _defined(child, f"{name}.")


def changed(mutation: Mutation) -> tuple[Path, str]:
    """The file below `ROOT` that changes, and its text. Raises: `NotOnce`."""
    matches = []
    for path, first, last in functions().get(mutation.function, []):
        lines = (ROOT / path).read_text().splitlines(keepends=True)
        before, inner, after = ("".join(part) for part in (lines[:first], lines[first:last], lines[last:]))
        text = before + inner.replace(mutation.pattern, mutation.replacement) + after
        matches += [(path, text)] * inner.count(mutation.pattern)
    if len(matches) != 1:
        raise NotOnce(f"{mutation.pattern!r} is {len(matches)} times in {mutation.function}; it must be there once")
    return matches[0]


def copied(folder: Path) -> Path:
    """A copy of what the tests read."""
    for name in ("hgogen", "tests", "models", "generated", "docs", ".ci"):
        shutil.copytree(ROOT / name, folder / name)
    for path in (path for path in ROOT.glob("[!.]*") if path.is_file()):
        shutil.copy(path, folder)
    return folder


def fail(tests: Tests, folder: Path, ordinary: bool = False) -> bool:
    """Whether one of the tests, or of the `ordinary` ones among them, fails in a copy, or hangs.

    Raises: `NotRun` where they cannot be run.
    """
    marks = () if ordinary else ("-m", "")
    options = ("-q", "-x", "-n", "0", *marks, "-p", "no:cacheprovider", "--no-header")
    environment = {**os.environ, "PYTHONPATH": str(folder), "CI": "true"}  # the copy, and the same examples every time
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # each row would compile the whole package
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return True
    if done.returncode not in ((0, 1, NO_TESTS) if ordinary else (0, 1)):
        raise NotRun(f"pytest cannot run {' '.join(tests)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 1


@contextmanager
def mutated(mutation: Mutation, folder: Path) -> Iterator[None]:
    """The change in a copy, which is then as it was. Raises: `NotOnce`."""
    path, text = changed(mutation)
    try:
        _write(folder / path, text)
        yield
    finally:
        _write(folder / path, (ROOT / path).read_text())


def _write(path: Path, text: str) -> None:
    path.write_text(text)
    Path(cache_from_source(str(path))).unlink(missing_ok=True)  # Python takes it for that of a text of the same second


def _detected(mutation: Mutation, ordinary: bool, folder: Path) -> bool:
    with mutated(mutation, folder):
        detected = fail(mutation.tests, folder, ordinary)
    print(f"{'found   ' if detected else 'SURVIVES'} {mutation}", flush=True)
    return detected


def survivors(rows: Iterable[Mutation], workers: int = 1, ordinary: bool = False) -> list[Mutation]:
    """The rows that their tests, or the `ordinary` ones of these, do not find. Prints a line for each.

    Raises: `NotRun` where the tests of a row fail without its change, or cannot be run.
    """
    rows = [row for row in rows if not row.equivalent]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        free: SimpleQueue[Path] = SimpleQueue()
        for k in range(workers):
            free.put(copied(Path(folder) / str(k)))

        def lent(task: Callable[[Path], bool]) -> bool:
            copy = free.get()
            try:
                return task(copy)
            finally:
                free.put(copy)

        each = sorted({row.tests for row in rows})
        for tests, failed in zip(
            each, pool.map(lent, (partial(fail, tests, ordinary=ordinary) for tests in each)), strict=True
        ):
            if failed:
                raise NotRun(f"without a change, one fails of {' '.join(tests)}")
        detected = list(pool.map(lent, (partial(_detected, row, ordinary) for row in rows)))
    return [row for row, was in zip(rows, detected, strict=True) if not was]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Seeded bugs, and the tests that must find them.")
    parser.add_argument("--only", default="", help="rows whose function holds this text")
    parser.add_argument("--workers", type=int, default=2, help="copies that are tested at a time")
    parser.add_argument("--ordinary", action="store_true", help="by the tests that the ordinary run takes")
    options = parser.parse_args()
    rows = [row for row in mutations() if options.only in row.function]
    run, left = [row for row in rows if not row.equivalent], survivors(rows, options.workers, options.ordinary)
    share = 100 * (1 - len(left) / len(run)) if run else 100.0
    print(f"{len(run) - len(left)} of {len(run)} are found, {share:.1f} %; {len(rows) - len(run)} are equivalent")
    for row in left:
        print(f"survives: {row}")
    sys.exit(bool(left))


if __name__ == "__main__":
    main()
