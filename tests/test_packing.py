"""The options --for and --name of `generate` and `build`: what is written where, and what is refused before anything
is."""

import json
import shlex
from pathlib import Path

import pytest
from test_cli import NEURON, as_json, documented, hgogen, needs_compiler

PENDULUM = str(NEURON.with_name("pendulum.py"))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with tank.toml, which is quickly tried."""
    (tmp_path / "tank.toml").write_text(
        'name = "tank"\nstates.h = {low = 0, high = 3, flow = "q - h"}\ninputs.q = {low = 0, high = 2}\n'
        'outputs.y = {equation = "h"}\n'
        'observer = {kind = "high_gain", theta = 2, poles = [-1], method = "rk4", dt = 0.01}\n'
        "[trial]\nduration = 1\nstart = {h = 1}\ninputs = {q = 1}\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


LIBRARY = {"README.md", "example/main.c", "src/tank.h", "src/tank.c", "src/tank_check.c", "CMakeLists.txt", "tank.md"}


@pytest.mark.full
def test_generate_for_an_ecosystem(here: Path) -> None:
    (written,) = as_json("generate", "tank.toml", "--for", "cmake")["models"]
    there = below(here / "generated" / "tank")
    figures = {f"extras/trial_states.{kind}" for kind in ("png", "svg")}
    assert there == LIBRARY | figures
    assert {str(Path(path).relative_to("generated/tank")) for path in written["files"]} == there
    hgogen("generate", "tank.toml", "--for", "cmake")  # what hgogen wrote is replaced
    assert "hgogen generate tank.toml\n" in (here / "generated" / "tank" / "src" / "tank.h").read_text()


@pytest.mark.usefixtures("undrawn")
def test_generate_under_another_name(here: Path) -> None:
    hgogen("generate", "tank.toml", "--name", "left")
    assert {"left.h", "left.c", "left_check.c"} < below(here / "generated" / "left")
    header = (here / "generated" / "left" / "left.h").read_text()
    assert "hgogen generate tank.toml --name left\n" in header
    assert "LEFT_H" in header
    assert "tank_" not in header
    hgogen("generate", "tank.toml", "--name", "right", "--for", "arduino", "-o", "out")
    assert {"src/right.c", "examples/right/right.ino", "library.properties"} < below(here / "out" / "right")
    hgogen("generate", "tank.toml", "--name", "third", "--target", "rust")
    assert {"third.rs", "third_check.rs"} < below(here / "generated" / "third")


@pytest.mark.full
@needs_compiler
def test_build_for_an_ecosystem_under_another_name(here: Path) -> None:
    report = as_json("build", "tank.toml", "--for", "cmake", "--name", "left", "--seeds", "1")
    assert report["self_check"] == "left: 64 samples as recorded"
    assert {"report.json", "src/left.c", "CMakeLists.txt", "extras/trial_states.svg"} < below(here / "build" / "left")


REFUSED = [
    (("--for", "cmak"), "--for cmak: there is no such ecosystem; did you mean cmake?"),
    (("--for", "make it so"), "there are cmake, platformio, arduino, zephyr, esp-idf, and all"),
    (("--for", "cmake", "--target", "rust"), "is for c99, not for rust"),
    (("--name", "int"), "the name int is a keyword or a macro of C"),
    (("--name", "a-b"), "the name 'a-b' is not an identifier"),
    (("--name", "stdio"), "hides <stdio.h>"),
    (("--name", "crate", "--target", "rust"), "crate cannot be a crate"),
    (("--for", "cmake", "--name", "test"), "the name test is CMake's own"),
]


@pytest.mark.parametrize("command", ["generate", "build"])
@pytest.mark.parametrize(("options", "said"), REFUSED)
def test_what_is_refused_writes_nothing(command: str, options: tuple[str, ...], said: str, here: Path) -> None:
    out, err = hgogen(command, "tank.toml", *options, status=2)
    assert said in " ".join(err.replace("│", " ").split())
    assert out == "" or "rust" in options
    assert below(here) == {"tank.toml"}


def test_one_name_is_of_one_model(here: Path) -> None:
    _, err = hgogen("generate", "tank.toml", PENDULUM, "--name", "left", status=2)
    assert "is one name, of one model" in " ".join(err.split())
    assert below(here) == {"tank.toml"}


@pytest.mark.parametrize("command", ["generate", "build"])
@pytest.mark.parametrize(
    ("there", "said"),
    [
        ("CMakeLists.txt", "hgogen did not write what is there"),
        ("README.md", "hgogen did not write what is there"),
        ("src/tank.h", "hgogen did not write what is there"),
        ("src/pump.c", "it also contains pump.c, which a build would compile too"),
    ],
)
@pytest.mark.usefixtures("undrawn")
def test_a_folder_with_files_of_others_is_left_as_it_is(command: str, there: str, said: str, here: Path) -> None:
    """Whatever else lies there, such as .git, is nobody's concern."""
    mine = here / "out" / "tank" if command == "generate" else here / "out"
    for name in (there, "notes.txt"):
        (mine / name).parent.mkdir(parents=True, exist_ok=True)
        (mine / name).write_text("mine\n")
    before = below(here)
    _, err = hgogen(command, "tank.toml", "--for", "cmake", "-o", "out", status=2)
    assert said in err
    assert below(here) == before
    assert (mine / there).read_text() == "mine\n"
    (mine / there).unlink()
    hgogen("generate", "tank.toml", "--for", "cmake", "-o", "out")
    assert (here / "out" / "tank" / "CMakeLists.txt").exists()


@pytest.mark.usefixtures("undrawn")
def test_another_name_in_the_same_folder_leaves_no_second_source(here: Path) -> None:
    hgogen("build", "tank.toml", "--for", "cmake", "-o", "out")
    before = {path: (here / "out" / path).read_bytes() for path in below(here / "out")}
    _, err = hgogen("build", "tank.toml", "--for", "cmake", "--name", "left", "-o", "out", status=2)
    assert "it also contains tank.c" in err
    assert {path: (here / "out" / path).read_bytes() for path in below(here / "out")} == before


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"source": "of another"}', "\xff"])
@pytest.mark.usefixtures("undrawn")
def test_costs_that_say_nothing_of_this_source_are_left_out(text: str, here: Path) -> None:
    folder = here / "generated" / "tank"
    folder.mkdir(parents=True)
    (folder / "cost.json").write_bytes(text.encode("latin1"))
    hgogen("generate", "tank.toml", "--for", "platformio")
    assert "`hgogen cost` measures" in (folder / "README.md").read_text()
    assert json.loads((folder / "library.json").read_text())["name"] == "tank"


def test_the_help_says_what_there_is() -> None:
    for command in ("generate", "build"):
        text = " ".join(hgogen(command, "--help")[0].replace("│", " ").split())
        assert "cmake, platformio, arduino, zephyr, esp-idf, several with commas, or all" in text
    assert "nominal_instructions, worst_instructions" in documented("cost")


@pytest.mark.parametrize("file", ["tank.toml", "my tank.toml"])
@pytest.mark.usefixtures("undrawn")
def test_the_command_of_a_file_names_the_file(here: Path, file: str) -> None:
    (here / "tank.toml").rename(here / file)
    hgogen("generate", file, "-o", "by_path")
    (header,) = (here / "by_path").rglob("tank.h")
    (command,) = (line.removeprefix(" *").strip() for line in header.read_text().splitlines() if " generate " in line)
    assert command.endswith(f"hgogen generate {shlex.quote(file)}")
    hgogen(*shlex.split(command[command.index("hgogen generate") :])[1:], "-o", "again")
    (again,) = (here / "again").rglob("tank.h")
    assert again.read_bytes() == header.read_bytes()
