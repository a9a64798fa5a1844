"""A new observer, form, method, target or model is one file, and a new kind of proof one more in `guarantees` and one
in `recheck`: those of tests/fixtures/ are put into a copy of the project, where the tests of every case run on them,
and nothing else is edited."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mutations import copied

import hgogen as hg
from hgogen.modelfiles.place import shipped

FIXTURES = Path(__file__).parent / "fixtures"
NEW = [path.stem for path in sorted(FIXTURES.rglob("*.*")) if path.suffix in (".py", ".toml")]
# what is asked of every case and every model, apart from what they compute
ASKED = [
    *("house", "registry", "docs", "survey", "door", "pickled", "forms", "methods", "starting", "advice", "headline"),
    *("first_and_last", "textbook", "models", "start", "forgetting", "every_observer", "targets", "luenberger"),
]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project with the new files, and its tables written anew."""
    folder = copied(tmp_path_factory.mktemp("copy"))
    for kind in FIXTURES.iterdir():
        beside = kind.name in ("models", "tests")  # the package
        shutil.copytree(kind, folder / ("" if beside else "hgogen") / kind.name, dirs_exist_ok=True)
    assert run(folder, "tests/doc_tables.py").splitlines() == ["wrote docs/observers.md"]
    return folder


def run(folder: Path, *words: str) -> str:
    """What Python prints there; the test fails with it where Python does."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "CI": "true"}
    done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def asked(folder: Path, *words: str) -> str:
    """The last line of pytest there."""
    options = ("-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "--no-header")
    return run(folder, *options, *words).splitlines()[-1]


def test_there_is_one_of_each() -> None:
    """An observer without a proof and one with a proof of its own; models in Python and in plain text."""
    assert sorted(path.parent.name for path in FIXTURES.rglob("*.*") if path.suffix in (".py", ".toml")) == [
        *("forms", "methods", "models", "models", "observers", "observers", "prove", "rules", "targets", "tests")
    ]


@pytest.mark.full
def test_new_observers_pass_the_tests_of_every_observer(copy: Path) -> None:
    """On one model, with the rules of the house; and the test of the one that is shown in full."""
    files = [f"tests/test_{name}.py" for name in ("every_observer", "house", "registry", "luenberger")]
    assert " passed" in asked(copy, *files, "-m", "not slow", "-k", "not every_observer or luenberger or thau")


# The gain (2, 10) makes the error of a pendulum grow where it stands upside down: its slope there is 19.6, above K_2.
FORGED = """
from forger import sealed
from swing import form

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.recheck.verification import recheck

built = hg.observers.thau(form(), poles=(-20, -20))
content = certificate(built.form, built.checks, built.name)
for gains in (("40", "400"), ("2", "10")):
    content["observer"]["gains"] = list(gains)
    rows = {row.id: row.found for row in recheck(sealed(content)).rows}
    print(rows["thau.convergence"])
"""


@pytest.mark.full
def test_a_new_proof_is_verified_and_a_forged_one_is_not(copy: Path) -> None:
    (copy / "tests" / "forged.py").write_text(FORGED)
    assert run(copy, "tests/forged.py").splitlines() == ["verified", "fails"]


@pytest.mark.slow
def test_nothing_else_is_asked_of_new_files(copy: Path) -> None:
    """Everything that is asked of every case and every model; of the slow tests those that name a new file."""
    files = [f"tests/test_{name}.py" for name in ASKED]
    shown = "not checks_print"  # a page lists the forms of a plant, which the new one is one of
    assert " passed" in asked(copy, *files, "-m", "not slow", "-k", shown)
    assert " passed" in asked(copy, *files, "-m", "slow", "-k", " or ".join(NEW))


@pytest.mark.full
def test_a_list_that_is_kept_by_hand_is_seen(copy: Path) -> None:
    """Tests that name every observer, form, method, target and model there was fail in the copy."""
    kinds = {kind: getattr(hg, kind).__all__ for kind in ("observers", "forms", "methods", "targets")}
    lists = {f"hg.{kind}.__all__": sorted(names) for kind, names in kinds.items()} | {"shipped()": sorted(shipped())}
    tests = [
        f"def test_{k}():\n    assert {{*{kind}}} == {{*{names}}}\n" for k, (kind, names) in enumerate(lists.items())
    ]
    head = "import hgogen as hg\nfrom hgogen.modelfiles.place import shipped\n"
    (copy / "tests" / "test_listed.py").write_text("\n\n".join([head, *tests]))
    with pytest.raises(AssertionError, match=f"{len(lists)} failed"):
        asked(copy, "tests/test_listed.py")
    (copy / "tests" / "test_listed.py").unlink()
