"""A step's way to its text goes down the column of folders: what calls is below what it calls."""

import pytest
from house import ROOT, calls, climbs

import hgogen as hg
from hgogen.model import load


@pytest.mark.ordinary("pendulum.py-True")
@pytest.mark.parametrize(("name", "check"), [("fitzhugh_nagumo.py", False), ("pendulum.py", True)])
def test_a_step_becomes_text_without_climbing_back(name: str, check: bool) -> None:
    """But for the arithmetic that the fold of a graph carries out, and for functions that the printer joins as they
    come."""
    step = load(ROOT / "models" / name).step()
    assert climbs(lambda: hg.targets.c99(step, check=check)) <= {("rigor", "emit"), ("emit", "targets")}


def test_a_call_of_a_folder_is_seen() -> None:
    form = load(ROOT / "models" / "pendulum.py").step().observer.form
    assert ("targets", "emit") in calls(lambda: hg.targets.markdown(load(ROOT / "models" / "pendulum.py").step()))
    assert ("certificates", "recheck") in calls(lambda: hg.certificate(form, ()))
    assert calls(lambda: hg.System.__name__) == set()


def test_a_step_is_made_without_climbing_back() -> None:
    """But for the equations of an observer, which those evaluate who were handed them."""
    observer = load(ROOT / "models" / "pendulum.py").step().observer
    handed = {("discretisation", "estimators"), ("discretisation", "observers"), ("estimators", "observers")}
    assert climbs(lambda: hg.sample(observer, hg.methods.rk4, dt=0.00137)) <= handed
