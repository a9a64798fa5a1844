"""Restarts and projections of a run are counted and named with their times; undisturbed, they are a warning."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hgogen.commands.output import json_text
from hgogen.run.gates import GateShare
from hgogen.run.metrics import Interventions, guard_notes, interventions

STEP: Any = SimpleNamespace(
    layout=SimpleNamespace(
        bits=tuple(SimpleNamespace(name=n) for n in ("MISSING_Y", "PROJECTED_ONTO_RANGES", "RESTARTED_FROM_SAMPLE"))
    ),
    observer=SimpleNamespace(parts=()),
)


def test_the_times_are_those_at_which_a_bit_was_raised() -> None:
    status = np.array([0, 2, 4, 1, 6, 0])
    each = interventions(STEP, status, np.arange(6) / 10)
    assert each == Interventions(restarts=(0.2, 0.4), projections=(0.1, 0.4))
    numbers = {"restarts": [0.2, 0.4], "projections": [0.1, 0.4], "runs": 1, "gates": []}
    assert json.loads(json_text(each)) == numbers
    plain: Any = SimpleNamespace(layout=SimpleNamespace(bits=()), observer=STEP.observer)
    assert not interventions(plain, status, np.arange(6.0))


def test_a_sentence_names_the_first_times_of_all_runs() -> None:
    each = Interventions((5.0, 7.0), ()) + Interventions((1.0, 6.0), (2.5,))
    restarts = "4 restarts from the sample (t = 1, 5, 6, .. min)"
    assert each.sentence("min") == f"{restarts}, 1 projection onto the ranges (t = 2.5 min) in 2 runs"
    assert Interventions((3.0,)).sentence("s") == "1 restart from the sample (t = 3 s)"


@pytest.mark.parametrize(("disturbed", "warned"), [(True, False), (False, True)])
def test_they_are_a_warning_where_nothing_disturbs_the_plant(disturbed: bool, warned: bool) -> None:
    (sentence,) = guard_notes("swing", "ukf", Interventions((3.0,)), disturbed, "s")
    assert sentence.startswith("warning: nothing disturbs trial swing") == warned
    assert "1 restart from the sample (t = 3 s)" in sentence
    assert not list(guard_notes("swing", "ukf", Interventions(), disturbed, "s"))


def test_a_gate_that_rejects_too_many_samples_is_named_and_no_other() -> None:
    """Over all runs: a tenth of the samples, and twice the share that is expected, may be beyond a gate."""
    few, many = (GateShare(("x", "y"), 100, beyond, 1, expected=0.01) for beyond in (5, 40))
    each = Interventions(gates=(few, few)) + Interventions(gates=(few, many))
    assert sum((each, each), Interventions(runs=0)).gates == (
        replace(few, count=400, beyond=20, reacquired=4),
        each.gates[1] + each.gates[1],
    )
    (sentence,) = guard_notes("swing", "ukf", each, False, "s")
    assert sentence.startswith("trial swing, ukf: 22.5 % of 200 samples of x, y are beyond the gate, 1 % are expected")
    assert "check the NIS first" in sentence
    assert [replace(few, beyond=beyond).excessive for beyond in (12, 13)] == [False, True]
    assert not GateShare(("y",), 12, 9, 0, expected=0.001).excessive
