"""What a user hands over in another shape: by name, masked, or in no order; the same everywhere it is taken."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from plants import model, two_outputs

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.forms.original import BadOrder
from hgogen.reading.given import BadGain, BadNames, real, reals
from hgogen.reading.measured import Record
from hgogen.run.samples import BadShape

NAN = np.nan
MASKED = np.ma.array([[1, 2], [3, 4], [5, 6]], mask=[[0, 1], [0, 0], [1, 0]])  # of whole numbers
HOLES = [[1, NAN], [3, 4], [NAN, 6]]
MASKS: dict[str, Any] = {
    "an array": MASKED,
    "of floats": MASKED.astype(float),
    "a list of rows": list(MASKED),
    "lists": [[1, np.ma.masked], [3, 4], [np.ma.masked, 6]],
    "by name": {"y2": MASKED[:, 1], "y1": MASKED[:, 0]},
}


@cache
def built() -> CallableStep:
    observer = hg.observers.riccati(hg.forms.block_triangular(two_outputs()), Q=(0.1, 0.1, 0.1), R=(0.1, 0.1))
    return hg.sample(observer, dt=0.01, engine="python")


def fresh() -> CallableStep:
    built().reset()
    return built()


def bits(sample: Any) -> tuple[Any, ...]:
    return sample.x.tobytes(), np.asarray(sample.status).tobytes()


@pytest.mark.parametrize("masked", MASKS.values(), ids=MASKS)
def test_a_masked_entry_of_a_record_is_a_missing_sample(masked: Any):
    run = fresh().run(u=np.zeros(3), y=masked)
    assert [built().flags(status) for status in run.status] == [("MISSING_Y2",), (), ("MISSING_Y1",)]
    assert bits(run) == bits(fresh().run(u=np.zeros(3), y=HOLES))


@pytest.mark.parametrize("masked", [MASKED[0], tuple(MASKED[0]), {"y1": 1, "y2": np.ma.masked}])
def test_a_masked_entry_of_a_sample_is_missing(masked: Any):
    assert bits(fresh()(u=0.0, y=masked)) == bits(fresh()(u=0.0, y=(1.0, NAN)))


def test_a_masked_input_is_no_input():
    assert fresh()(u=np.ma.masked, y=(1, 2)).flags == ("REUSED_U",)
    assert fresh().predict(u=np.ma.array(3.0, mask=True)).flags == ("REUSED_U",)
    assert built().update(y1=np.ma.masked, y2=1.0).flags == ("MISSING_Y1",)


def test_a_record_has_no_mask():
    """A selection of its columns would lose that."""
    signals, report = built().outputs, Any
    record = Record(np.arange(3.0), ("y1", "y2"), MASKED, report)  # type: ignore[arg-type]
    np.testing.assert_array_equal(record.of(signals[::-1]), np.array(HOLES)[:, ::-1])


@pytest.mark.parametrize("gains", [{"Q": np.ma.array([1, 1], mask=[0, 1])}, {"R": np.ma.masked}])
def test_a_masked_gain_is_refused(gains: dict[str, Any]):
    with pytest.raises(BadGain, match="must be"):
        hg.observers.riccati(hg.forms.triangular(model("pendulum")), **{"Q": (1, 1), "R": 1, **gains})


def test_signals_by_name():
    y = np.array([[1.0, 2.0], [3.0, 4.0]])
    named = {"y2": y[:, 1].tolist(), "y1": y[:, 0]}
    assert bits(fresh().run(u={"u": [0.1, 0.2]}, y=named)) == bits(fresh().run(u=[0.1, 0.2], y=y))
    assert bits(fresh()(u={"u": 0.1}, y={"y2": 2, "y1": 1})) == bits(fresh()(u=0.1, y=(1, 2)))
    by_signal = dict(zip(built().outputs, (1, 2), strict=True))
    assert bits(fresh()(u=0.1, y=by_signal)) == bits(fresh()(u=0.1, y=(1, 2)))
    u, y1 = np.zeros((4, 1)), np.ones((4, 2))
    assert bits(hg.reference(fresh(), u={"u": u[:, 0]}, y={"y1": y1[:, 0], "y2": y1[:, 1]})) == bits(
        hg.reference(fresh(), u=u, y=y1)
    )


BAD: dict[str, tuple[Callable[[CallableStep], Any], type[Exception], str]] = {
    "missing": (lambda step: step(u=0, y={"y1": 1}), BadNames, "y has no value for y2; give one for each of y1, y2"),
    "unknown": (lambda step: step(u={"v": 0}, y=(1, 2)), BadNames, "u names 'v', which is none of the names"),
    "of a record": (lambda step: step.run(u=[0], y={"y2": [1]}), BadNames, "y has no value for y1"),
    "lengths": (
        lambda step: step.run(u=[0, 0], y={"y1": [1, 2], "y2": [1]}),
        BadShape,
        r"y with columns of different lengths \(y1 2, y2 1\) must have one length for all",
    ),
    "text": (lambda step: step.run(u=[0], y={"y1": ["a"], "y2": [1]}), BadShape, "y of y1 = .* is not an array of num"),
    "order": (
        lambda step: hg.forms.original(two_outputs(), order={"x1": 0, "x2": 1, "x3": 2}),  # type: ignore[arg-type]
        BadOrder,
        "the order is a dict, which has no order; it must hold each of the states x1, x2, x3 once",
    ),
    "set": (
        lambda step: hg.forms.original(two_outputs(), order={"x1", "x2", "x3"}),  # type: ignore[arg-type]
        BadOrder,
        "the order is a set",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_does_not_fit_is_a_sentence(name: str):
    call, kind, sentence = BAD[name]
    with pytest.raises(kind, match=sentence):
        call(fresh())
    assert fresh().save() == built().save()


def test_a_state_that_initial_leaves_out_rests():
    """As docs/tuning.md says: at its nominal value, else at 0 or at the end of its range that is nearest to it."""
    x = [hg.Signal("a", low=1, high=3), hg.Signal("b", nominal=0.5), hg.Signal("c", low=-1, high=1)]
    plant = hg.System("rests", states=x, outputs=(hg.Signal("y"),), flow=[x[1], x[2], -x[0]], output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=(-1,) * 3, initial={"c": 0.25})
    assert observer.parts[0].fields[0].initial == (1, 0.5, 0.25)


@pytest.mark.parametrize("gain", [1j, 0.1 + 0j, [0.1, 1j], np.array([0.1, 0.2 + 1j])])
def test_a_complex_number_is_no_gain(gain: Any):
    """NumPy would leave out the imaginary part."""
    for take in (reals, lambda name, value: real(name, np.ravel(value)[-1])):
        with pytest.raises(BadGain, match="must be a number or an array of numbers"):
            take("R", gain)
