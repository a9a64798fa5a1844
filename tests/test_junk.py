"""What is no argument of a public function is met by a sentence, whatever it is, in the place of each argument."""

import inspect
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
import plants
import pytest
import sympy as sp

import hgogen as hg
from hgogen.errors import HgogenError
from hgogen.model import load

SAMPLES = 20
JUNK = (
    *(None, 5, -1, 0, 1.5, "x", b"x", [], {}, (1, 2, 3), math.nan, math.inf, object(), np.zeros((2, 2)), True, 1j),
    *(sp.Symbol("q"), {"x": 1}, {"q": "a"}, ["q", 5], lambda *a: 1, 10**400),
)
Call = tuple[Callable[..., Any], Mapping[str, Any]]  # a function, and arguments that it takes


def of(function: Callable[..., Any], *first: Any, **others: Any) -> Call:
    """A call, with its first argument by name."""
    names = iter(inspect.signature(function).parameters)
    return function, {**dict(zip(names, first, strict=False)), **others}


@cache
def observers() -> dict[str, Call]:
    """Each observer as the first shipped model makes it that has one, in the order of its arguments."""
    calls: dict[str, Call] = {}
    for model in map(load, sorted(plants.MODELS.glob("[!_]*"))):
        for name in set(hg.observers.__all__) - calls.keys():
            try:
                _, base, gains = model.step(name).observer._making
            except HgogenError:
                continue
            case = getattr(hg.observers, name)
            calls[name] = of(case, base, **gains)
    return calls


@cache
def others() -> dict[str, Call]:
    """The forms, the targets and what is asked of plants, observers, steps and runs."""
    model = load("pendulum")
    plant, step, trial = model.plant, model.step("high_gain"), model.trials()[0]
    observer, (a, b) = step.observer, (hg.Signal("a", low=-1, high=1), hg.Signal("b", low=-1, high=1))
    u, y = np.zeros((SAMPLES, 1)), np.full((SAMPLES, 1), 0.1)
    run = step.run(u=u, y=y)
    system: dict[str, Any] = {
        "states": (a, b),
        "inputs": (),
        "outputs": (hg.Signal("c"),),
        "flow": [b, -a],
        "output": [a],
    }
    drive = hg.Signal("v", low=-1, high=1)
    affine = hg.System("affine", **{**system, "inputs": (drive,), "flow": [drive * b, 0]})
    hidden: Any = {"form": hg.forms.state_affine(affine), "R": 0.1, "u": u, "y": y, "dt": 0.01, "d": 0.1}
    many = {"u": np.stack([u, u]), "y": np.stack([y, y])}
    return {
        **{name: of(getattr(hg.forms, name), plant) for name in hg.forms.__all__},
        **{name: of(getattr(hg.targets, name), step) for name in hg.targets.__all__},
        **{name: of(getattr(hg, name), plant) for name in ("observability", "singularity", "survey")},
        **{name: of(getattr(hg, name), observer) for name in ("l2_gain", "iss_gain")},
        **{name: of(getattr(hg, name), step) for name in ("noise_gain", "start_set", "contraction")},
        "Signal": of(hg.Signal, "x", unit="V", low=-1, high=1),
        "System": of(hg.System, "p", **system),
        "Log": of(hg.Log, u, y=y, dt=0.01),
        "Trial": of(type(trial), "a", duration=1, start={"q": 0.1, "w": 0}),
        "table": of(hg.table, a, xs=[0, 1, 2], ys=[0, 1, 4]),
        "recast": of(hg.recast, plant, coordinates={}, inverse={}),
        "with_disturbance": of(hg.with_disturbance, plant, on="w", signal=hg.Signal("d", low=-1, high=1)),
        "load": of(hg.load, "pendulum"),
        "bound": of(hg.bound, "x**2", where={"x": (0, 1)}),
        "nonzero": of(hg.nonzero, "x + 2", where={"x": (0, 1)}),
        "sample": of(hg.sample, observer, method=hg.methods.rk4, dt=step.dt),
        "certificate": of(hg.certificate, observer.form, checks=observer.checks, observer="high_gain"),
        "delayed": of(hg.delayed, observer, y=3),
        "error_bound": of(hg.error_bound, step, noise={"y": 1e-3}),
        "starting_gains": of(hg.starting_gains, observer.form, observer=hg.observers.high_gain),
        "run": of(step.run, u, y=y),
        "run_many": of(step.run_many, **many),
        "started": of(step.started, {"q": 0.1, "w": 0}),
        "flags": of(step.flags, 1),
        "consistency": of(hg.consistency, run),
        "reference": of(hg.reference, step, u=u, y=y),
        "gramian": of(hg.gramian, plant, trial=trial, d=0.1),
        "campaign": of(hg.campaign, step, trial=trial, runs=3),
        "along": of(hg.excitation.along, **hidden),
        "shown": of(hg.excitation.shown, "shown", gramian=hg.excitation.along(**hidden)),
        "injection_filter": of(hg.design.injection_filter, observer.form, theta=20.0, rate=1.0),
        "gain_of_poles": of(hg.design.gain_of_poles, (-1, -2)),
    }


def demand_sentences(function: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Every argument in turn is anything else: that is taken, or an error of the package is raised."""
    parameters = inspect.signature(function).parameters.values()
    places = [each.name for each in parameters if each.kind is each.POSITIONAL_ONLY]

    def call(**values: Any) -> None:
        first = [values.pop(name) for name in places]
        function(*first, **values)

    call(**arguments)
    for each in parameters:
        if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
            for junk in JUNK:
                with suppress(HgogenError):
                    call(**{**arguments, each.name: junk})


QUICK = ("Signal", "System", "Log", "Trial", "table", "load", "bound", "run", "flags", "consistency", "gain_of_poles")


@pytest.mark.ordinary("Log", "run", "flags")
@pytest.mark.parametrize("name", QUICK)
def test_what_is_no_argument_is_met_by_a_sentence(name: str) -> None:
    demand_sentences(*others()[name])


@pytest.mark.slow
def test_what_is_no_argument_of_any_other_is_met_by_a_sentence() -> None:
    for name in sorted(others().keys() - QUICK):
        demand_sentences(*others()[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", hg.observers.__all__)
def test_what_is_no_argument_of_an_observer_is_met_by_a_sentence(name: str) -> None:
    demand_sentences(*observers()[name])
