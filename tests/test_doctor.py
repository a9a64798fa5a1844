"""The command `doctor`: what is here, what is missing, and nothing that fails because of it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hgogen.cli import app
from hgogen.commands.doctor import WANTED


def tools() -> dict[str, dict[str, str | None]]:
    done = CliRunner().invoke(app, ["doctor", "--json"])
    assert done.exit_code == 0, done.output
    return {row["name"]: row for row in json.loads(done.stdout)["tools"]}


def test_what_is_missing_has_a_line_that_installs_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    listed = tools()
    assert list(listed) == [wanted.name for wanted in WANTED]
    assert listed["C compiler"]["version"] is None
    assert listed["C compiler"]["install"] == "apt install gcc"
    assert listed["scipy"]["version"]  # tests need it
    shown = " ".join(CliRunner().invoke(app, ["doctor"], env={"COLUMNS": "200"}).output.split())
    assert "rustc missing: apt install rustc the self-check of emitted Rust" in shown


@pytest.mark.skipif(os.name == "nt", reason="the program is a shell script")
@pytest.mark.parametrize(
    ("script", "version"), [("echo rustc 1.2.3; echo more", "rustc 1.2.3"), ("exit 1", "does not")]
)
def test_a_program_tells_its_version(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, script: str, version: str
) -> None:
    (tmp_path / "rustc").write_text(f"#!/bin/sh\n{script}\n")
    (tmp_path / "rustc").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    listed = tools()["rustc"]
    assert str(listed["version"]).startswith(version)
    assert listed["place"] == str(tmp_path / "rustc")


def test_the_command_list_imports_nothing_that_computes() -> None:
    slow = {"sympy", "numpy", "casadi", "matplotlib", "flint"}
    code = (
        f"import sys; from hgogen.commands.app import command_of; command_of('list'); print(*{slow} & {{*sys.modules}})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"
