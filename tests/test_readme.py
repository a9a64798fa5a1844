"""What the README says is run: its Python lines, its two commands."""

import re
from pathlib import Path

import numpy as np
import pytest
from pages import README, ROOT, blocks

TEXT = README.read_text()


def test_it_is_short() -> None:
    assert len(TEXT.splitlines()) <= 120


def test_the_first_two_shell_blocks_are_one_line_each() -> None:
    run, test = (block.strip().split("\n") for block in blocks("sh", TEXT)[:2])
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
    exec(compile("".join(blocks("python", TEXT)), "README.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "pendulum in triangular form" in printed
    assert "refuted" not in printed
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"pendulum.h", "pendulum.c", "pendulum_check.c"}
    # a high-gain observer with poles at -20 has followed a smooth angle within the last tenth of a second: the rate of
    # sin(4t) at its end, the error bounded by the neglected acceleration over the gain, 19.6 + 16 over 400, times 20
    run = names["run"]
    assert run["q"].shape == (1000,)  # type: ignore[index]
    assert np.abs(run["w"][-100:] - 4 * np.cos(4 * np.arange(900, 1000) * 1e-3)).max() < 2 * 20 * 36 / 400  # type: ignore[index]
