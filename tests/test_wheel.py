"""A wheel holds the package and the models, and its command knows them from any folder."""

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("hatchling")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an unpacked wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*command, "-w", str(folder), str(ROOT)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    with ZipFile(wheel) as archive:
        archive.extractall(folder / "unpacked")
    return folder / "unpacked"


def hgogen(unpacked: Path, cwd: Path, *arguments: str) -> str:
    """What the wheel's own command prints, run in a folder that holds no model."""
    path = {**os.environ, "PYTHONPATH": str(unpacked), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-m", "hgogen", *arguments], cwd=cwd, env=path, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_a_wheel_holds_all_files_of_the_package_and_the_models(unpacked: Path) -> None:
    def below(folder: Path) -> set[Path]:
        every = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
        return {path for path in every if "__pycache__" not in path.parts}

    assert below(unpacked / "hgogen" / "models") == below(ROOT / "models")
    assert {path for path in below(unpacked / "hgogen") if path.parts[0] != "models"} == below(ROOT / "hgogen")
    others = {path.name for path in unpacked.iterdir()} - {"hgogen"}
    assert len(others) == 1
    assert others.pop().endswith(".dist-info")


@pytest.mark.full
def test_the_command_of_a_wheel_knows_the_models(unpacked: Path, tmp_path: Path) -> None:
    listed = hgogen(unpacked, tmp_path, "list")
    names = {path.stem for path in (ROOT / "models").iterdir() if path.suffix in (".py", ".toml")}
    assert names <= set(listed.split())
    headline = hgogen(unpacked, tmp_path, "check", "fitzhugh_nagumo").splitlines()[0]
    assert headline.startswith("fitzhugh_nagumo: locally observable; state_affine, proved")
    code = "import hgogen as hg; print(hg.load('pendulum').path)"
    path = {**os.environ, "PYTHONPATH": str(unpacked)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(unpacked / "hgogen" / "models" / "pendulum.py")


def test_the_wheel_has_the_version_of_the_project(unpacked: Path, tmp_path: Path) -> None:
    version = hgogen(unpacked, tmp_path, "--version").split()[1]
    assert f'version = "{version}"' in (ROOT / "pyproject.toml").read_text()
