"""Which tests a run takes: representatives, and every K-th."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import ABSENT, every, leave_long_cases, stand_for_others
from full_cases import long_cases

from hgogen.run import native


class Case:
    """A case of a test, as pytest collects it."""

    path = Path("test_a.py")

    def __init__(self, test: str, case: str, *representatives: str) -> None:
        self.originalname, self.name = test, f"{test}[{case}]"
        self.marker = SimpleNamespace(args=representatives) if representatives else None
        self.marks: list[str] = []

    def get_closest_marker(self, name: str) -> Any:
        assert name == "ordinary"
        return self.marker

    def add_marker(self, name: str) -> None:
        self.marks.append(name)


def cases(test: str, names: str, *representatives: str) -> list[Any]:
    return [Case(test, name, *representatives) for name in names.split()]


def full(items: list[Any]) -> list[str]:
    return [item.name for item in items if item.marks == ["full"]]


def test_the_others_of_a_test_are_full() -> None:
    items = [*cases("test_a", "x y z"), *cases("test_b", "x y z", "y", "z"), *cases("test_c", "u-x u-y v-x", "u-*")]
    assert not stand_for_others(items)
    assert full(items) == ["test_b[x]", "test_c[v-x]"]


def test_a_representative_that_is_not_there_is_named_and_another_stands_alone() -> None:
    items = [*cases("test_b", "x y", "y", "renamed"), *cases("test_c", "x y", "renamed")]
    assert stand_for_others(items) == ("test_a.py::test_b[renamed]", "test_a.py::test_c[renamed]")
    assert full(items) == ["test_b[x]"]  # of the other test nobody stands for anybody


def test_long_cases_are_full_and_a_name_that_is_not_there_is_told() -> None:
    items = cases("test_a", "x y")
    for item in items:
        item.nodeid = f"tests/test_a.py::{item.name}"
    names = ("tests/test_a.py::test_a[y]", "tests/test_a.py::test_a[renamed]", "tests/test_b.py::test_b[other file]")
    assert leave_long_cases(items, names) == ("tests/test_a.py::test_a[renamed]",)
    assert full(items) == ["test_a[y]"]


def test_the_quickest_stands_for_those_that_no_seeded_bug_names(tmp_path: Path) -> None:
    rows = {"a[x]": 0.5, "a[y]": 0.4, "a[z]": 0.1, "b[x]": 9, "c[x]": 2, "c[y]": 1, "d": 5}
    cases_ = "".join(f'<testcase classname="tests.t" name="{name}" time="{time}"/>' for name, time in rows.items())
    (tmp_path / "times.xml").write_text(f"<testsuites><testsuite>{cases_}</testsuite></testsuites>")
    named = {"tests/t.py::a[y]", "tests/t.py::d"}
    assert set(long_cases(str(tmp_path / "times.xml"), named)) == {"tests/t.py::a[x]", "tests/t.py::c[x]"}


@pytest.mark.pinned  # names of cases may depend on the versions
@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_every_representative_is_there(pytestconfig: pytest.Config) -> None:
    assert not pytestconfig.stash[ABSENT]


def test_every_third_test_is_one_of_each_file() -> None:
    """The first, the fourth, .. of each file, and the others are counted as deselected."""
    tests = [
        SimpleNamespace(path=file, number=k) for file, count in (("a", 7), ("b", 2), ("c", 3)) for k in range(count)
    ]
    items, left = list(tests), list[SimpleNamespace]()
    hook = SimpleNamespace(pytest_deselected=lambda items: left.extend(items))
    config = SimpleNamespace(getoption={"every": 3}.get, hook=hook)
    every(config, items)
    assert [(one.path, one.number) for one in items] == [("a", 0), ("a", 3), ("a", 6), ("b", 0), ("c", 0)]
    assert {id(one) for one in (*items, *left)} == set(map(id, tests))
    assert len(items) + len(left) == len(tests)
