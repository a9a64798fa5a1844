"""A step's way to its text goes down the column of folders: what calls is below what it calls."""

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from house import COLUMN

import hgogen as hg
from hgogen.model import load

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hgogen"


@cache
def folder(file: str) -> str:
    """The folder of the package in which a file stands, "" for one at its root or of a library."""
    path = Path(file)
    inner = path.relative_to(PACKAGE).parts if path.is_relative_to(PACKAGE) else ()
    return inner[0] if len(inner) > 1 else ""


def calls(function: Callable[[], Any]) -> set[tuple[str, str]]:
    """The pairs of folders of which one calls the other, by whatever way between them, while a function runs."""
    pairs: set[tuple[str, str]] = set()

    def called(frame: FrameType, event: str, _: Any) -> None:
        callee, caller = folder(frame.f_code.co_filename), frame.f_back
        while event == "call" and callee and caller is not None:
            if above := folder(caller.f_code.co_filename):
                pairs.add((above, callee))
                return
            caller = caller.f_back

    sys.setprofile(called)
    try:
        function()
    finally:
        sys.setprofile(None)
    return {(caller, callee) for caller, callee in pairs if caller != callee}


@pytest.mark.ordinary("pendulum.py-True")
@pytest.mark.parametrize(("name", "check"), [("fitzhugh_nagumo.py", False), ("pendulum.py", True)])
def test_a_step_becomes_text_without_climbing_back(name: str, check: bool) -> None:
    """But for the arithmetic that the fold of a graph carries out, and for functions that the printer joins as they
    come."""
    step = load(ROOT / "models" / name).step()
    seen = calls(lambda: hg.targets.c99(step, check=check))
    assert ("targets", "emit") in seen
    climbs = {pair for pair in seen if COLUMN.index(pair[0]) < COLUMN.index(pair[1])}
    assert climbs <= {("rigor", "emit"), ("emit", "targets")}


def test_a_call_of_a_folder_is_seen() -> None:
    form = load(ROOT / "models" / "pendulum.py").step().observer.form
    assert ("certificates", "recheck") in calls(lambda: hg.certificate(form, ()))
    assert calls(lambda: hg.System.__name__) == set()
