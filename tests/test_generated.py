"""What is committed in generated/ is what the generator makes now."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MODELS = sorted(path.name for path in (ROOT / "generated").iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generated")
    command = "from hgogen.cli import main; main()"
    paths = [f"models/{name}.py" for name in MODELS]
    subprocess.run(
        [sys.executable, "-c", command, "generate", *paths, "-o", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    return folder


def test_what_is_generated_is_of_models() -> None:
    assert {"cascaded_tanks", "fitzhugh_nagumo", "pendulum"} <= set(MODELS)
    assert {path.stem for path in (ROOT / "models").glob("*.py")} >= set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_the_c_is_the_same_byte_for_byte(name: str, fresh: Path) -> None:
    committed = {path.name for path in (ROOT / "generated" / name).iterdir()}
    made = {path.name for path in (fresh / name).iterdir()}
    assert committed == made
    sources = [file for file in made if file.endswith((".c", ".h"))]
    assert len(sources) == 3
    for file in sources:
        assert (ROOT / "generated" / name / file).read_bytes() == (fresh / name / file).read_bytes(), file
