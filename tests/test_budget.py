"""The budget of time of the slow tests."""

import subprocess
import sys
from pathlib import Path

import pytest
from budget import ROOT, concerns, ordered

FILES = [ROOT / "tests" / f"test_{name}.py" for name in "abcde"]


@pytest.mark.parametrize("count", [0, 1, 3, 7])
def test_what_changed_comes_first_and_the_others_go_around(count: int) -> None:
    order = [file.stem[-1] for file in ordered(FILES, [FILES[3], FILES[1]], count)]
    first, others = "bd", "ace"
    assert "".join(order[:2]) == first[count % 2 :] + first[: count % 2]
    assert "".join(order[2:]) == others[count % 3 :] + others[: count % 3]


def test_as_many_commits_as_files_begin_with_each() -> None:
    assert {ordered(FILES, (), count)[0] for count in range(len(FILES))} == set(FILES)


@pytest.mark.parametrize(
    ("changed", "shown"),
    [
        ({"hgogen/step.py"}, True),
        ({"hgogen/emit/layout.py"}, True),
        ({"hgogen/emit/layout.toml", "hgogen/sentence.py"}, False),
        ({"tests/test_it.py"}, True),
    ],
)
def test_a_file_concerns_what_it_imports(tmp_path: Path, changed: set[str], shown: bool) -> None:
    test = tmp_path / "tests" / "test_it.py"
    test.parent.mkdir()
    test.write_text("from hgogen.emit import layout, pystep\n\ndef test_():\n    from hgogen.step import Step\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("budget.ROOT", tmp_path)
        assert concerns(test, changed) == shown


@pytest.mark.full
def test_no_test_begins_after_the_budget() -> None:
    """The two tests of a file, in a run of no time: both are left out, and said to be."""
    run = [sys.executable, "-m", "pytest", "-n", "0", "--budget", "0", "tests/test_given.py", "-k", "number"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert "passed" not in done.stdout
    assert "tests, of tests/test_given.py" in done.stdout
    assert "the others from test_given.py on" in done.stdout
