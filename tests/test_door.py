"""Bad input to what is asked in Python is a sentence, not a traceback."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.errors import HgogenError
from hgogen.reading.given import Misfit, cached
from hgogen.target import CannotWrite
from hgogen.trial import Trial

x1, x2, y = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1), hg.Signal("y")
PLANT = hg.System("plant", states=(x1, x2), outputs=(y,), flow=[x2, -x1], output=[x1])
a = hg.Signal("a", nominal=1)
TUNABLE = hg.System("tuned", states=(x1, x2), outputs=(y,), parameters=(a,), flow=[x2, -a * x1], output=[x1])
TRIAL = Trial("short", 1, {"x1": 0.5, "x2": 0})
LOG: Any = hg.Log(u=np.zeros((9, 0)), y=np.zeros(9), dt=1)
BOX = {"x1": (-1, 1)}


def step() -> Any:
    observer = hg.observers.high_gain(hg.forms.triangular(PLANT), theta=5, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")


@pytest.mark.parametrize(
    ("question", "said"),
    [
        (lambda: hg.bound(x1 > 0, BOX), "bound was given x1 > 0"),
        (lambda: hg.bound(None, BOX), "bound was given None"),
        (lambda: hg.nonzero(sp.Matrix([1]), BOX), "give one expression"),
        (lambda: hg.nonzero([1], BOX), "give one expression"),
        (lambda: hg.bound("x1", BOX, boxes=0), "boxes= was given 0"),
        (lambda: hg.nonzero("x1", BOX, boxes=2.5), "boxes= was given 2.5"),
        (lambda: hg.bound("x1", BOX, relative=-1), "relative= was given -1"),
        (lambda: hg.bound("x1", BOX, relative=float("nan")), "relative= was given nan"),
        (lambda: hg.survey(None), "survey was given None"),
        (lambda: hg.observability(3), "observability was given 3"),
        (lambda: hg.singularity("x"), "singularity was given 'x'"),
        (lambda: hg.fit(5, LOG), "fit was given 5, of type int; give a plant"),
        (lambda: hg.with_disturbance("p", on="x1"), "with_disturbance was given 'p'"),
        (lambda: hg.recast(5, {}, {}), "recast was given 5"),
        (lambda: hg.recast(PLANT, 5, {}), "recast, coordinates= was given 5, of type int; give a mapping from states"),
        (lambda: hg.recast(PLANT, {}, [x1]), "recast, inverse= was given [x1]"),
        (lambda: hg.l2_gain(5), "l2_gain was given 5, of type int; give an observer"),
        (lambda: hg.iss_gain(step()), "that of a step is step.observer"),
        (lambda: hg.design.noise_bounds(step()), "that of a step is step.observer"),
        (lambda: hg.reference(5), "reference was given 5, of type int; give an observer"),
        (lambda: hg.gramian(PLANT, 5, 1), "gramian, trial= was given 5"),
        (lambda: hg.gramian(5, TRIAL, 1), "gramian was given 5, of type int; give a plant"),
        (lambda: hg.campaign(5, TRIAL, 10), "campaign was given 5, of type int; give a step"),
        (lambda: hg.campaign(step(), 5, 10), "campaign, trial= was given 5"),
        (lambda: hg.consistency(5), "consistency was given 5, of type int; give a run"),
        *((lambda f=f: getattr(hg.forms, f)(None), f"{f} was given None") for f in hg.forms.__all__),
        (lambda: hg.forms.triangular(hg.load("pendulum")), "of a model file it is hg.load(path).plant"),
        (lambda: hg.write(5, "nowhere"), "write was given 5, of type int; give files by name"),
        (lambda: hg.load("pendulum").set("rk4"), "set was given 'rk4', of type str; give a Setting"),
    ],
)
def test_a_misfit_is_a_sentence(question: Callable[[], Any], said: str) -> None:
    with pytest.raises(Misfit) as caught:
        question()
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("question", "said"),
    [
        (lambda: hg.observability(PLANT, unknown=("a",)), "unknown names 'a' which is no parameter; there is none"),
        (lambda: hg.observability(PLANT, unknown=5), "unknown = 5 must be a name or several"),
        (lambda: hg.forms.original(PLANT, order=5), "order = 5 must be a name or several"),
        (lambda: hg.observers.high_gain(hg.forms.triangular(PLANT), theta=5, poles=(-1, -1), accept=5), "accept = 5"),
        (lambda: hg.gramian(PLANT, TRIAL, "1 s"), "d = '1' must be a number"),
        (lambda: hg.fit(TUNABLE, LOG, free=5), "parameter = 5 must be a name or several"),
        (lambda: hg.observability(TUNABLE, unknown="aa"), "unknown names 'aa' which is no parameter; did you mean a?"),
        (lambda: hg.load("pendulum").step(5), "there is no observer 5"),
        (lambda: step().run_many(y=np.zeros((2, 3, 1)), parameters=5), "parameters = 5 is no mapping from some of"),
        (lambda: step().run_many(y=np.zeros((2, 3, 1)), starts=5), "starts = 5 is no mapping from states to numbers"),
        (lambda: step().flags("1"), "status = '1' must be a number"),
        (lambda: step().flags(1.5), "status = 1.5 must be a whole number"),
        (lambda: step().started("x1"), "initial = 'x1' must be a number"),
        (lambda: hg.from_casadi("p", states=5, outputs=(y,), flow=[], output=[]), "states is 5; give a list of pairs"),
        (lambda: hg.write({}, 5), "cannot write 5: it is no path; give that of a folder"),
        (lambda: hg.write({5: ""}, "nowhere"), "cannot write 5: it is no name of a file"),
        (lambda: hg.write({"a": 5}, "nowhere"), "cannot write 'a': what it is to hold is of type int; give a text"),
    ],
)
def test_what_is_no_name_is_a_sentence(question: Callable[[], Any], said: str) -> None:
    with pytest.raises(HgogenError) as caught:
        question()
    assert said in str(caught.value)


SWITCHES = [
    *((getattr(folder, name), PLANT) for folder in (hg.forms, hg.observers) for name in folder.__all__),
    *((getattr(hg.targets, name), step()) for name in hg.targets.__all__),
    *((question, PLANT) for question in (hg.advise, hg.fit, hg.survey, hg.tune)),
]


@pytest.mark.parametrize("value", ["x1", 1, None, np.ones(2)])
def test_a_switch_is_true_or_false(value: Any) -> None:
    """measured="x1" would be taken for measured=True."""
    asked = 0
    for question, first in SWITCHES:
        for name, each in inspect.signature(question).parameters.items():
            if each.annotation not in (bool, "bool"):
                continue
            asked += 1
            assert each.kind is each.KEYWORD_ONLY
            with pytest.raises(Misfit, match=f"^{question.__name__}, {name}= was given .*; give True or False$"):
                question(first, **{name: value})
    assert asked >= 17
    assert hg.forms.triangular(PLANT, measured=np.True_) == hg.forms.triangular(PLANT, measured=True)


def test_nothing_is_made_of_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(CannotWrite):
        hg.write({"a": "text", "b": None}, tmp_path / "new")  # type: ignore[dict-item]
    assert not [*tmp_path.iterdir()]


def test_a_step_starts_where_it_is_told_by_name() -> None:
    there = step().started({"x1": 0.5, "x2": -0.25})
    assert there.observer.initial == step().started(lambda form: {"x1": 0.5, "x2": -0.25}).observer.initial
    assert there.observer.initial == {"x1": 0.5, "x2": -0.25}


def test_a_parameter_may_be_named_alone() -> None:
    whole = hg.observability(TUNABLE, unknown=("a",)).joint
    assert hg.observability(TUNABLE, unknown="a").joint == hg.observability(TUNABLE, unknown=(a,)).joint == whole


def test_a_plant_may_be_named() -> None:
    assert hg.forms.triangular(plant=PLANT) == hg.forms.triangular(PLANT)


def test_rounding_in_casadi_is_refused() -> None:
    s = ca.SX.sym("s", 2)
    with pytest.raises(HgogenError, match=r"floor\(x1\), which has no slope"):
        hg.from_casadi("p", states=[(s, (x1, x2))], outputs=(y,), flow=ca.vertcat(s[1], ca.floor(s[0])), output=s[0])


@pytest.mark.parametrize("folder", [hg.forms, hg.methods, hg.observers, hg.targets])
def test_a_folder_shows_its_cases_alone(folder: Any) -> None:
    assert dir(folder) == sorted(folder.__all__)


def test_an_output_without_states_is_a_proof() -> None:
    blind = hg.System("blind", states=(x1, x2), outputs=(y,), flow=[x2, -x1], output=[1])
    (check,) = hg.observability(blind).checks
    assert (check.verdict, str(check.reason).rpartition("; ")[2]) == (Verdict.REFUTED, "no output reads a state")
    assert "locally observable" in hg.observability(PLANT).checks[0].claim


# --- answers are sentences --------------------------------------------------------------------------------------


def test_answers_are_printed_as_sentences() -> None:
    sentence = str(hg.bound("x1**2 - x1 + 1", {"x1": (-3, 3)}))
    assert sentence.startswith("from 0.687499999 to 13, by 9 boxes; the least is")
    ends = "the least is at most -2, at x1 = -1, x2 = -1; the most is at least 2, at x1 = 1, x2 = 1"
    assert str(hg.bound("x1 + x2", PLANT)) == f"from -2 to 2, by 1 box; {ends}"
    assert str(hg.bound("1/x1", BOX)).endswith("it is not a finite real number at x1 = 0")
    assert str(hg.nonzero("x1 - 2", BOX)) == "proved: at most -1, by 1 box"
    assert str(hg.nonzero("x1 + 2", BOX)) == "proved: at least 1, by 1 box"
    assert str(hg.nonzero("x1", BOX)) == "refuted: vanishes, at x1 = 0"
    hard = hg.nonzero("x1*sin(x1) + 1.01 - x1**2 + cos(x1)**9", BOX, boxes=1)
    assert str(hard) == "unknown: 1 box does not decide it"


@pytest.mark.full
def test_what_overflows_keeps_its_lower_end() -> None:
    """e^e^e^e^0 = 3.8e6: neither many boxes nor a tower of exponentials lose it."""
    assert hg.bound("exp(exp(exp(exp(10*x))))", {"x": (0, 2)}).low > 3.8e6
    assert hg.bound("exp(-exp(exp(exp(10*x))))", {"x": (0, 2)}).low == 0
    assert hg.bound("sinh(exp(exp(exp(10*x))))", {"x": (0, 2)}).low > 1e6


@pytest.mark.parametrize("text", ["x1 + 2*abs(x1)", "x1 - 2*min(x1, 0)", "max(x1, -2*x1)"])
def test_a_least_value_of_zero_is_zero(text: str) -> None:
    """Not the float below it."""
    assert hg.bound(text, BOX).low == 0


def test_a_question_is_asked_once_of_equal_plants_and_options() -> None:
    """Another range is another plant, and what cannot be compared is asked anew."""
    asked = []

    @cached
    def question(plant: hg.System, order: object = ()) -> int:
        asked.append((plant, order))
        return len(asked)

    def one(low: float) -> hg.System:
        x = hg.Signal("x", low=low, high=1)
        return hg.System("one", states=(x,), outputs=(hg.Signal("y"),), flow=[-x], output=[x])

    assert [question(one(-1)), question(one(-1)), question(one(-2))] == [1, 1, 2]
    assert [question(one(-1), order=(1,)), question(one(-1), order=(1,)), question(one(-1), order=(2,))] == [3, 3, 4]
    assert [question(one(-1), order=[1]), question(one(-1), order=[1])] == [5, 6]
