"""What a user keeps goes through a pickle, as multiprocessing sends it: a copy gives the same bits."""

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from plants import MODELS, pendulum, two_outputs, van_der_pol

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.model import Model, load
from hgogen.reading.given import BadGain
from hgogen.step import StepMayFail, StepTooLong

FORMS: dict[str, Callable[[], hg.Form]] = {
    "triangular": lambda: hg.forms.triangular(van_der_pol()),
    "measured": lambda: hg.forms.triangular(van_der_pol(), measured=True),
    "uniform": lambda: hg.forms.uniform(van_der_pol()),
    "phase": lambda: hg.forms.phase(van_der_pol()),
    "phase, original": lambda: hg.forms.phase(van_der_pol(), original=True),
    "block_triangular": lambda: hg.forms.block_triangular(two_outputs()),
    "original": lambda: hg.forms.original(two_outputs()),
}
AROUND = {"adaptive": {"theta": hg.theta.adaptive(4, mu=(0.16, 0.32), innovation=hg.innovation.window(d=0.5))}}
AROUND["staggered"] = {"theta": hg.theta.adaptive(4, mu=(0.16, 0.32), innovation=hg.innovation.staggered(d=0.48))}
AROUND["decaying"] = {"theta": hg.theta.decaying(5, rate=1)}


@cache
def tuned() -> Model:
    """The shipped model with a tuning for each observer."""
    return load(MODELS / "pendulum.py")


def sent(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def answers(step: CallableStep, engine: Any = "python") -> bytes:
    """The bits of 50 samples with a missing one, from where the step stands."""
    t = np.arange(50)[:, None]
    u, y = np.sin(t + np.arange(len(step.inputs))), 0.3 * np.cos(0.1 * t + np.arange(len(step.outputs)))
    y[7] = np.nan
    run = step.run(u=u, y=y, engine=engine)
    return run.x.tobytes() + run.status.tobytes() + b"".join(trace.tobytes() for trace in run.traces.values())


def same(step: CallableStep) -> None:
    """After ten samples of its own, with a memory of its own."""
    step.run(u=np.zeros((10, len(step.inputs))), y=np.zeros((10, len(step.outputs))), engine="python")
    other = sent(step)
    assert other.save() == step.save()
    assert answers(other) == answers(step)


def kalman(form: hg.Form, **changes: Any) -> hg.Observer:
    weights = {"Q": dict.fromkeys(form.names, 0.1), "R": {y.name: 0.1 for y in form.system.outputs}}
    return hg.observers.riccati(form, **weights, **changes)


@pytest.mark.parametrize("name", FORMS)
def test_a_form_and_its_step(name: str):
    form = FORMS[name]()
    assert sent(form) == form
    same(hg.sample(kalman(form), dt=0.01))


@pytest.mark.parametrize("name", AROUND)
def test_gains_that_move(name: str):
    same(hg.sample(kalman(FORMS["triangular"](), **AROUND[name]), dt=0.01))


@pytest.mark.parametrize("name", hg.methods.__all__)
def test_a_method(name: str):
    method, linear = getattr(hg.methods, name), name in ("bilinear", "exponential")
    assert sent(method) == method
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        same(hg.sample(pendulum() if linear else kalman(FORMS["triangular"]()), method, dt=0.01))


@pytest.mark.ordinary("cascade", "stubborn")
@pytest.mark.parametrize("name", load(MODELS / "pendulum.py").tuning.tables)
def test_an_observer(name: str):
    step = tuned().step(name)
    same(step)
    other = sent(step.observer)
    assert (other.name, other.gains, other.checks) == (step.observer.name, step.observer.gains, step.observer.checks)


def test_what_a_step_was_told():
    """Its gains, the periods of its sensors and how its input goes between samples."""
    step = hg.sample(kalman(FORMS["original"]()), dt=0.01, periods={"y2": 0.03}, between="hold", engine="python")
    step.tune(R={"y1": 2.0, "y2": 0.5})
    other = sent(step)
    assert (other.clock, other.engine) == (step.clock, step.engine)
    assert answers(other) == answers(step)


def test_a_step_that_was_warned_of_is_not_warned_of_again():
    with pytest.raises(StepTooLong) as refused:
        hg.sample(pendulum(), hg.methods.rk4, dt=10)
    with pytest.warns(StepMayFail):
        step = hg.sample(pendulum(), hg.methods.rk4, dt=0.99 * refused.value.limit)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sent(step)


def test_an_observer_that_nobody_can_make_again_is_refused():
    with pytest.raises(BadGain, match=r"riccati was not made by hg\.observers"):
        pickle.dumps(replace(kalman(FORMS["triangular"]()), construction=None))


@pytest.mark.slow
def test_in_another_process():
    """Whose hashes of text differ."""
    step = hg.sample(kalman(FORMS["phase"]()), dt=0.01)
    code = "import pickle, sys; from test_pickled import answers; step = pickle.load(sys.stdin.buffer)"
    code += "; sys.stdout.buffer.write(answers(step))"
    path = os.pathsep.join([str(MODELS.parent), str(MODELS.parent / "tests"), *sys.path])
    around = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "77"}
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(step), capture_output=True, env=around)
    assert done.stdout == answers(step), done.stderr.decode()
