"""The package gives what is public when it is asked for, whoever imported what before."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import hgogen as hg


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_types_and_values_come_from_the_same_files() -> None:
    stub = ast.parse(Path(f"{hg.__file__}i").read_text())
    typed = {
        alias.asname: (str(node.module), alias.name)
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert hg.__all__ == sorted(map(str, typed))
    assert set(hg.__all__) <= set(dir(hg))
    for name, (file, there) in typed.items():
        assert name == there
        space: dict[str, object] = {}
        exec(f"from {file} import {name}", space)
        assert getattr(hg, name) is space[name], name


@pytest.mark.full
def test_a_function_is_never_its_file() -> None:
    """Python binds a file to its package when it is imported, by whatever way, over what was there."""
    code = """from hgogen import survey, response
import hgogen.run.gramian, hgogen.which_forms
import hgogen.commands.checking  # and with it nearly all, before anything is asked for by name
from types import ModuleType
import hgogen as hg
from hgogen import *
modules = [name for name in hg.__all__ if isinstance(getattr(hg, name), ModuleType)]
assert globals()["gramian"] is hg.gramian
assert callable(hg.survey) and hg.survey.__name__ == "survey"
print(*modules)"""
    assert python(code) == "design excitation forms innovation methods observers targets theta trial"


def test_importing_it_imports_nothing() -> None:
    code = "import sys, importlib; before = set(sys.modules); import hgogen.cli; print(*set(sys.modules) - before)"
    assert set(python(code).split()) <= {"hgogen", "hgogen.cli", "_signal"}


def test_the_version_is_read_when_it_is_asked_for() -> None:
    """Of the one in pyproject.toml, as it was installed; where it changed since, install again."""
    project = tomllib.loads((Path(str(hg.__file__)).parents[1] / "pyproject.toml").read_text())["project"]
    assert hg.__version__ == project["version"]
    assert python("import hgogen, sys; print('__version__' in vars(hgogen))") == "False"


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="module 'hgogen' has no attribute 'nothing'"):
        hg.nothing  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from hgogen import nothing")


def test_the_help_of_the_command_line_waits_for_nothing() -> None:
    """No algebra, no arrays: `hgogen --help` takes .25 s of CPU in the place of 1.7."""
    code = """import sys
from typer.testing import CliRunner
from hgogen.cli import app
told = CliRunner().invoke(app, ["--help"])
assert told.exit_code == 0 and "noise" in told.stdout, told
print(*({"sympy", "casadi", "numpy", "flint", "matplotlib"} & set(sys.modules)))"""
    assert python(code) == ""
