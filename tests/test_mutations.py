"""The tests find seeded bugs: the rows of mutations.toml, a fixed twentieth of them here."""

import ast
from functools import cache
from pathlib import Path
from zlib import crc32

import pytest
from conftest import RUN
from mutations import ROOT, Mutation, NotOnce, NotRun, changed, mutations, survivors

ROWS = mutations()
SEEN = "tests/test_digits.py::test_what_is_to_be_built_again_reads_back_as_the_same"


@cache
def named(file: str) -> frozenset[str]:
    """The tests of a file, by the names of their functions."""
    tree = ast.parse((ROOT / file).read_text())
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


def test_every_row_finds_its_place_and_its_tests() -> None:
    for row in ROWS:
        path, text = changed(row)
        ast.parse(text)
        assert text != (ROOT / path).read_text()
        assert bool(row.tests) is not bool(row.equivalent), str(row)
        for test in row.tests:
            file, name = test.partition("[")[0].split("::")
            assert name in named(file), f"{row}: there is no {test}"


def test_there_are_enough_and_many_of_them_unread() -> None:
    assert len(ROWS) >= 80
    assert len({(row.function, row.pattern, row.replacement) for row in ROWS}) == len(ROWS)
    assert sum(row.unread for row in ROWS) >= 600


def test_nine_in_ten_have_a_test_in_the_ordinary_run(pytestconfig: pytest.Config) -> None:
    """As `python tests/mutations.py --ordinary` finds them; here the tests that it runs are counted."""
    option = pytestconfig.option
    if pytestconfig.args != pytestconfig.getini("testpaths") or option.every > 1 or option.keyword:
        pytest.skip("these are not all of the ordinary run")
    names = {part for name in pytestconfig.stash[RUN] for part in (name, name.partition("[")[0])}
    asked = [row for row in ROWS if row.tests]
    assert sum(not names.isdisjoint(row.tests) for row in asked) >= 0.9 * len(asked)


@pytest.mark.parametrize("pattern", ["nothing of the sort", "theta"])
def test_a_pattern_that_is_not_there_once_is_an_error(pattern: str) -> None:
    with pytest.raises(NotOnce, match="it must be there once"):
        changed(Mutation("rise", pattern, ""))


@pytest.mark.slow
def test_a_change_that_no_test_sees_survives(tmp_path: Path) -> None:
    change, blind = ("same", "repr(float(value))", "short"), tmp_path / "test_blind.py"
    blind.write_text("def test_blind():\n    pass\n")
    rows = [Mutation(*change, (test,)) for test in (str(blind), SEEN)]
    assert survivors(rows) == rows[:1]
    full = "tests/test_tutorials.py::test_it_goes_from_a_record_to_c"
    rows = [Mutation(*change, tests) for tests in ((full,), (full, SEEN))]
    assert survivors(rows, ordinary=True) == rows[:1]


@pytest.mark.full
def test_tests_that_fail_anyway_find_nothing(tmp_path: Path) -> None:
    failing = tmp_path / "test_failing.py"
    failing.write_text("def test_failing():\n    assert False\n")
    with pytest.raises(NotRun, match="without a change"):
        survivors([Mutation("same", "short", "value", (str(failing),))])


@pytest.mark.full
@pytest.mark.parametrize("test", ["tests/test_digits.py::test_that_is_not_there", "tests/not_there.py"])
def test_tests_that_cannot_be_run_find_nothing(test: str) -> None:
    with pytest.raises(NotRun, match="not_there"):
        survivors([Mutation("same", "short", "value", (test,))])


@pytest.mark.slow
def test_a_twentieth_is_found() -> None:
    """Rows are chosen by the checksum of their change, so that a new row moves no other in or out."""
    chosen = [row for row in ROWS if crc32(f"{row.function}{row.pattern}{row.replacement}".encode()) % 20 == 0]
    assert len(chosen) > len(ROWS) / 30
    assert not survivors(chosen, workers=2)
