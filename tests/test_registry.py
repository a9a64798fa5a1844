"""What help() shows of a case: its file's equations and reference, then its arguments."""

import inspect
import pydoc
import subprocess
import sys

import pytest

import hgogen as hg
from hgogen import registry

CASES = [(kind, name) for kind in ("forms", "observers") for name in getattr(hg, kind).__all__]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_the_help_of_a_case_opens_with_its_equations(kind: str, name: str) -> None:
    docstring = inspect.getdoc(getattr(getattr(hg, kind), name)) or ""
    module = inspect.cleandoc(sys.modules[f"hgogen.{kind}.{name}"].__doc__ or "")
    assert docstring.startswith(module + "\n\n")
    assert docstring.count(module) == 1
    assert len(docstring) > len(module) + 40
    assert docstring.partition("\n")[0] == registry.summary(kind, name)


def test_the_cascade() -> None:
    docstring = inspect.getdoc(hg.observers.cascade) or ""
    assert "    v_2' = l^2 alpha_2 (y - v_1)" in docstring
    assert docstring.index("Khalil") < docstring.index("Args: ") < docstring.index("`theta`")


def test_a_case_is_imported_when_it_is_read() -> None:
    """And its name means the case, however its file was imported: as a module first, or by its name."""
    code = (
        "import sys, hgogen.observers.low_power, hgogen as hg; "
        "print(hg.observers.low_power.__name__, hg.observers.high_gain.__name__, hg.observers.kalman.__name__, "
        "'hgogen.observers.ukf' in sys.modules, {'ukf', 'bank'} < {*dir(hg.observers)})"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["low_power", "high_gain", "kalman", "False", "True"]
    with pytest.raises(AttributeError, match=r"module 'hgogen\.observers' has no attribute 'low_powers'"):
        _ = hg.observers.low_powers


def test_it_is_told_once() -> None:
    before = hg.observers.cascade.__doc__
    assert registry.case_in(sys.modules["hgogen.observers.cascade"]).__doc__ == before


@pytest.mark.parametrize("name", hg.methods.__all__)
def test_the_help_of_a_method_is_its_files(name: str) -> None:
    method = getattr(hg.methods, name)
    module = inspect.cleandoc(sys.modules[f"hgogen.methods.{name}"].__doc__ or "")
    shown = pydoc.plain(pydoc.render_doc(method))
    assert all(line.strip() in shown for line in module.splitlines())
    assert type(method).__doc__ not in shown
