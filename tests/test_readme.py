"""What the README says is run: its Python lines, its piece of C, its commands, its links."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hgogen as hg
from hgogen.calling import native
from hgogen.cli import app
from hgogen.commands.answers import answers
from hgogen.emit.cost import cost
from hgogen.model import load
from hgogen.reading.entry import entry
from hgogen.stepping.guards import STEP_BITS

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_checks_are_shown() -> None:
    """So that the test of what they print cannot pass on nothing."""
    assert len(COMMANDS) >= 4


def test_the_first_two_shell_blocks_are_one_line_each() -> None:
    run, test = (block.strip().split("\n") for block in blocks("sh")[:2])
    assert len(run) == 1
    assert run[0].endswith("hgogen build models/fitzhugh_nagumo.py")
    assert len(test) == 1
    assert test[0].endswith("pytest -q")
    (run_by_ci,) = re.findall(r"^test_command='(.*)'$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
    assert run_by_ci == test[0]


def test_the_python_lines_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile("".join(blocks("python")), "README.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "pendulum in triangular form" in printed
    assert "refuted" not in printed
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"pendulum.h", "pendulum.c", "pendulum_check.c"}
    # a high-gain observer with poles at -20 has followed a smooth angle within the last tenth of a second: the rate of
    # sin(4t) at its end, the error bounded by the neglected acceleration over the gain, 19.6 + 16 over 400, times 20
    run = names["run"]
    assert run["q"].shape == (1000,)  # type: ignore[index]
    assert np.abs(run["w"][-100:] - 4 * np.cos(4 * np.arange(900, 1000) * 1e-3)).max() < 2 * 20 * 36 / 400  # type: ignore[index]


def test_the_pieces_of_c_are_in_the_generated_c() -> None:
    source = (ROOT / "generated/fitzhugh_nagumo/fitzhugh_nagumo.c").read_text()
    squeezed = re.sub(r"\s+", " ", source)
    piece = blocks("c")[-1]
    assert len(piece) > 100
    assert re.sub(r"\s+", " ", piece).strip() in squeezed


def test_the_cc_line_works(tmp_path: Path) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    line, wanted = re.search(r"\$ (cc .*?) && \./check\n(.*?)\n", TEXT).groups()  # type: ignore[union-attr]
    command = line.replace("-o check", f"-o {tmp_path / 'check'}").replace("cc ", f"{native.compiler()} ", 1)
    subprocess.run(command, shell=True, cwd=ROOT, check=True)
    assert subprocess.run([tmp_path / "check"], capture_output=True, text=True, check=True).stdout.strip() == wanted


COMMANDS = re.findall(r"^\$ (hgogen check models/.*)\n((?:[^$`\n].*\n)+)", TEXT, re.MULTILINE)


@pytest.mark.parametrize(("line", "wanted"), COMMANDS, ids=[line for line, _ in COMMANDS])
def test_the_checks_print_what_is_shown(line: str, wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLUMNS", "200")
    result = CliRunner().invoke(app, shlex.split(line)[1:])
    assert result.exit_code == 0
    printed = [row.rstrip() for row in result.stdout.splitlines()]
    assert [row for row in wanted.splitlines() if row not in printed] == []


def test_the_comparison_prints_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLUMNS", "200")
    ((line, wanted),) = re.findall(r"^\$ (hgogen compare models/.*)\n((?:[^$`\n].*\n)+)", TEXT, re.MULTILINE)
    result = CliRunner().invoke(app, [*shlex.split(line)[1:], "-o", str(tmp_path)])
    printed = [row.rstrip() for row in result.stdout.splitlines()]
    assert [row for row in wanted.splitlines() if row not in printed] == []


def test_the_table_of_observers_is_complete_and_its_costs_are_counted() -> None:
    """Each observer, with the operations and functions of the pendulum's tuning."""
    told = dict(re.findall(r"^\| `(\w+)` \|.*\| (\d+ \+ \d+) \|$", TEXT, re.MULTILINE))
    assert set(told) == set(hg.observers.__all__)
    pendulum = load(ROOT / "models" / "pendulum.py")
    counted = {name: cost(pendulum.step(name)) for name in told}
    assert {name: f"{one.operations} + {one.functions}" for name, one in counted.items()} == told


def test_the_json_is_a_model_of_a_library() -> None:
    found = dict(answers(entry(json.loads(blocks("json")[0]))))
    assert (found["triangular"], found["bounds"]) == (True, [[0, 1]])


def test_the_plain_text_model_is_generated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "oscillator.toml").write_text(blocks("toml")[0])
    assert CliRunner().invoke(app, ["generate", "oscillator.toml"]).exit_code == 0
    assert (tmp_path / "generated" / "oscillator" / "oscillator.c").is_file()
    assert "defines no trial" in CliRunner().invoke(app, ["build", "oscillator.toml"]).stderr


def test_the_tunings_in_plain_text_are_observers(tmp_path: Path) -> None:
    model, tunings = blocks("toml")
    (tmp_path / "oscillator.toml").write_text(model + tunings)
    loaded = load(tmp_path / "oscillator.toml")
    assert [loaded.step(name).observer.name for name in ("high_gain", "quiet")] == ["high_gain", "filtered"]


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", TEXT)
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


BIT = re.compile(r'\bBit\(\s*"([A-Z_]+)"')  # those of observers and parts: no one header has them all


def test_every_status_bit_is_explained() -> None:
    header = (ROOT / "generated/fitzhugh_nagumo/fitzhugh_nagumo.h").read_text()
    bits = re.findall(r"#define FITZHUGH_NAGUMO_(\w+) +0x[0-9A-F]+u", header)
    assert len(bits) >= 9
    others = [name for path in ROOT.glob("hgogen/**/*.py") for name in BIT.findall(path.read_text())]
    assert {"GAIN_LIMITED", "COVARIANCE_RESTARTED", "COVARIANCE_LIMITED"} <= set(others)
    for bit in [*bits, *others, *STEP_BITS]:
        assert f"| `{bit}` |" in TEXT


def test_commands_are_those_there_are() -> None:
    listed = set(re.findall(r"^\| `hgogen (\w+)", TEXT, re.MULTILINE))
    command = [sys.executable, "-c", "from hgogen.cli import main; main()", "--help"]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    assert listed == set(re.findall(r"^│ (\w+)  ", told.stdout, re.MULTILINE))
