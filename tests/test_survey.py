"""Which forms a plant is in: verdicts, orders, reasons, and the form that stands for a model without an observer."""

import json
import time
from pathlib import Path

import pytest
import sympy as sp

import hgogen as hg
from hgogen import forms
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.which_forms import NOT_TRIED, Survey, survey_settings

MODELS = Path(__file__).resolve().parents[1] / "models"
X = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, 5))
X1, X2, X3, X4 = X
Y1, Y2 = hg.Signal("y1"), hg.Signal("y2")
PROVED, REFUTED, GENERIC, UNKNOWN = Verdict.PROVED, Verdict.REFUTED, Verdict.GENERIC, Verdict.UNKNOWN


def of(flow: list[sp.Expr], output: list[sp.Expr]) -> Survey:
    n, p = len(flow), len(output)
    return hg.survey(hg.System("plant", states=X[:n], outputs=(Y1, Y2)[:p], flow=flow, output=output))


def verdicts(survey: Survey) -> dict[str, Verdict | None]:
    return {row.name: row.verdict for row in survey.rows}


def test_the_pendulum_is_in_every_form_for_one_output() -> None:
    survey = hg.survey(load(MODELS / "pendulum.py").plant)
    assert (
        verdicts(survey).items()
        >= {
            "triangular": PROVED,
            "triangular, measured=True": PROVED,
            "uniform": PROVED,
            "block_triangular": None,
            "phase": None,
            "state_affine": PROVED,
            "original": None,
            "Gauthier-Bornard": GENERIC,
        }.items()
    )
    assert survey["triangular"].order == ("q", "w")
    assert survey["phase"].why == NOT_TRIED
    assert str(survey["block_triangular"].why) == "for 2 outputs or more"
    assert survey.best.kind == "triangular"


def test_the_neuron_is_in_none_because_of_the_input_zero() -> None:
    """Without input x2 and eta are hidden: d(v, L_f v, ..) has the rank 1."""
    survey = hg.survey(load(MODELS / "fitzhugh_nagumo.py").plant)
    assert {row.verdict for row in survey.answered if row.name != "state_affine"} == {REFUTED}
    assert survey["state_affine"].verdict is PROVED  # which says nothing of observability
    assert survey["triangular"].order == ("x1", "x2", "-eta")
    assert survey["triangular"].witness == survey["uniform"].witness == {"u": 0.0}
    assert str(survey["triangular"].why) == "a_2 vanishes, at u = 0"
    assert "u" in survey["triangular"].fix
    assert str(survey["Gauthier-Bornard"].why).endswith("rank 1 of 3: u = 0 hides x2, eta")
    assert survey.best.structured  # shown for its one refuted gain


def test_the_tanks_are_uniform_in_their_levels() -> None:
    survey = hg.survey(load(MODELS / "cascaded_tanks.py").plant)
    assert (survey["triangular"].verdict, survey["uniform"].verdict) == (REFUTED, PROVED)
    assert survey["triangular"].order == ()
    assert survey["uniform"].order == ("x2", "x1")
    assert survey.best.kind == "uniform"


def test_two_chains() -> None:
    survey = of([X2, -X1 - X3, X4, sp.sin(X1 + X2) - X3], [X1, X3])
    assert survey["block_triangular, align='top'"].verdict is PROVED
    assert survey["triangular"].verdict is None
    assert survey["Gauthier-Bornard"].verdict is None
    assert survey.best.kind == "block_triangular"


def test_a_hidden_state() -> None:
    survey = of([X2, -X1, X1 - X3], [X1])
    assert verdicts(survey)["uniform"] is REFUTED
    assert "never shows x3" in str(survey["uniform"].why)
    assert not survey.best.structured
    assert str(survey.best.head[0]).startswith("plant not shown in triangular form")


def test_the_proved_form_comes_before_the_one_with_a_refuted_gain() -> None:
    """x2 enters x1' with the slope 3 x2^2 + 1: uniform; the slope of x2 alone is not triangular."""
    assert of([X2**3 + X2, -X1], [X1]).best.kind == "uniform"
    assert of([X1 * X2, -X1], [X1]).best.checks[0].verdict is PROVED


@pytest.mark.parametrize("name", ["pendulum.py", "lorenz.toml"])
def test_deep_asks_the_costly_forms_too(name: str) -> None:
    survey = hg.survey(load(MODELS / name).plant, deep=True)
    costly = {name for name in hg.forms.__all__ if survey_settings(name).costly}
    assert costly == {"phase", "uniform_chain", "original"}
    assert {row.name for row in survey.answered} >= costly
    assert survey["original"].verdict is not PROVED  # no theorem covers it


def test_every_form_of_the_folder_is_asked_or_says_why_not() -> None:
    survey = of([X2, -X1], [X1])
    assert {row.name.partition(",")[0] for row in survey.rows} == {*forms.__all__, "Gauthier-Bornard"}
    assert all(row.why for row in survey.rows)
    assert json.loads(json.dumps(survey.as_dict())) == survey.as_dict()
    assert all(row.name in str(survey) for row in survey.rows)
    with pytest.raises(KeyError):
        survey["no form"]


@pytest.mark.full
def test_twenty_states_take_seconds() -> None:
    """Limits count boxes; 1.2 s of processor time."""
    n = 20
    x = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in range(n))
    flow = [x[i + 1] + sp.sin(x[i]) * x[0] for i in range(n - 1)] + [sum(map(sp.cos, x))]
    begin = time.process_time()
    survey = hg.survey(hg.System("chain", states=x[::-1], outputs=(Y1,), flow=flow[::-1], output=[x[0]]))
    assert time.process_time() - begin < 30
    assert survey["triangular"].verdict is PROVED
    assert survey["triangular"].order == tuple(s.name for s in x)
