"""Every file in models/ conforms: it loads, its step builds and runs, its C compiles clean, its trial stays finite."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from plants import loaded

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.emit.syntax import Real
from hgogen.model import Model, load
from hgogen.run import native
from hgogen.trial import try_out

FILES = sorted((Path(__file__).resolve().parents[1] / "models").glob("*.py"))
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
MODELS = [loaded(path) for path in FILES]
every = pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
each = pytest.mark.parametrize("model", [model for model in MODELS if model.has("step")], ids=lambda model: model.name)


@cache
def built(name: str) -> CallableStep:
    (model,) = (model for model in MODELS if model.name == name)
    return model.step()


def fresh(model: Model) -> CallableStep:
    """The model's own step, which is built once, as new."""
    step = built(model.name)
    step.reset()
    return step


def test_there_are_models() -> None:
    assert {path.stem for path in FILES} >= {"cascaded_tanks", "fitzhugh_nagumo", "pendulum"}


@every
def test_the_file_is_named_after_its_plant_and_says_what_it_is(model: Model) -> None:
    assert model.plant.name == model.name
    text = model.module.__doc__ or ""
    assert "'" in text, "the docstring shows the equations"
    assert "=" in text, "the docstring shows the equations"
    for signal in model.plant.signals:
        assert signal.meaning, f"{signal} says nothing of itself"


@pytest.mark.ordinary("bioreactor", "pendulum", "stribeck")
@each
def test_every_claim_about_its_form_has_a_verdict(model: Model) -> None:
    observer = fresh(model).observer
    assert len({check.id for check in observer.checks}) == len(observer.checks) > 2
    refuted = {check.id for check in observer.checks if check.verdict is hg.Verdict.REFUTED}
    assert refuted <= set(observer.accepted)


@pytest.mark.ordinary("bioreactor", "pendulum", "stribeck")
@each
def test_its_tuning_is_what_its_step_uses(model: Model) -> None:
    """`tuning` maps an observer's name, or one with `kind`, to its gains; the step is built from one of them."""
    kinds = {table.get("kind", name) for name, table in model.tuning.tables.items()}
    assert fresh(model).observer.name in kinds
    assert kinds <= set(hg.observers.__all__)


@pytest.mark.ordinary("disturbed_pendulum", "pendulum", "stribeck")
@each
def test_a_record_over_its_ranges_stays_finite(model: Model) -> None:
    """The inputs and outputs swing over half their ranges, at the model's own sampling period."""
    step = fresh(model)
    k = np.arange(300)[:, None]

    def swing(signals: tuple[hg.Signal, ...], pace: float) -> np.ndarray:
        low, high = np.array([s.interval if s.bounded else (-1.0, 1.0) for s in signals]).reshape(-1, 2).T
        return (low + high) / 2 + (high - low) / 4 * np.sin(pace * k)

    run = step.run(u=swing(step.inputs, 0.03), y=swing(step.outputs, 0.02), engine="python")
    assert np.isfinite(run.x).all()
    assert "RESTARTED" not in step.flags(np.bitwise_or.reduce(run.status))


@pytest.mark.ordinary("float-stribeck", "double-pendulum")
@needs_compiler
@each
@pytest.mark.parametrize("real", ["float", "double"])
def test_its_c_compiles_clean_and_checks_itself(model: Model, real: Real) -> None:
    """Every warning is an error; the recorded vectors come out bit for bit."""
    files = hg.targets.c99(fresh(model), real=real)
    printed = native.run_check(files, ("-O2", f"-D{model.name.upper()}_EXACT"))
    assert printed == f"{model.name}: 64 samples as recorded\n"


@pytest.mark.ordinary("cascaded_tanks", "disturbed_pendulum", "pendulum")
@each
def test_its_trial_stays_finite(model: Model) -> None:
    """At most 4000 samples of the first trial, one seed; in the second half the error is less than the box is wide."""
    if not model.has("trial"):
        pytest.skip("has no trial")
    step = fresh(model)
    trial = model.trials()[0]
    duration = min(trial.duration, 4000 * step.dt)
    jumps = tuple(jump for jump in trial.jumps if jump.time < duration)
    short = replace(trial, duration=duration, jumps=jumps, steady=None)
    (trajectory,) = try_out(step, short, engine="python", seeds=trial.seeds[:1])
    assert np.isfinite(trajectory.x).all()
    assert np.isfinite(trajectory.truth.x).all()
    late = trajectory.error[len(trajectory.error) // 2 :]
    widths = [s.high - s.low if s.bounded else np.inf for s in step.states]
    assert (np.abs(late).max(axis=0) < widths).all()


def test_no_two_models_share_a_name() -> None:
    names = [load(path).plant.name for path in FILES]
    assert all(a != b for a, b in itertools.pairwise(sorted(names)))
