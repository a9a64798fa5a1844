"""Sensors of different rates, late, early, repeated and missing samples, in Python and C."""

import ctypes
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import emitted
import neuron
import numpy as np
import pages
import pytest
from exact import machine
from hypothesis import given, settings
from hypothesis import strategies as st
from native_step import NativeStep
from plants import MODELS, kalman, pendulum, two_outputs, van_der_pol

import hgogen as hg
from hgogen.model import load
from hgogen.program import Place
from hgogen.run.native import run_check
from hgogen.run.samples import BadShape
from hgogen.step import CannotUpdate
from hgogen.stepping.sections import BadRate
from hgogen.trial import try_out

NAN = float("nan")
EVERY = 5  # samples of y1 to one of y2


@cache
def two(**periods: float) -> Any:
    """Two outputs of three states, dt = .01, y2 sampled every `periods`."""
    observer = hg.observers.riccati(hg.forms.original(two_outputs()), Q=[0.1] * 3, R=[0.1, 0.2])
    return hg.sample(observer, dt=0.01, periods=periods)


@cache
def adaptive() -> Any:
    """One output, every 2 dt, theta by staggered predictors."""
    innovation = hg.innovation.staggered(0.4, predictors=2)
    return hg.sample(neuron.observer(neuron.adaptive(innovation=innovation)), dt=0.01, periods={"y": 0.02})


@cache
def pendulum_filter() -> Any:
    """That of the page for firmware."""
    return hg.observers.riccati(pendulum().form, Q=(1, 10), R=1e-6)


def fresh(made: Any) -> Any:
    made.reset()
    return made


def record(made: Any, samples: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Sines and noise; the last output has a sample every so many periods only, the first one misses some."""
    k, rng = np.arange(samples)[:, None], np.random.default_rng(3)
    outputs = len(made.outputs)
    y = np.cos(0.02 * k + np.arange(outputs)) + 0.1 * rng.standard_normal((samples, outputs))
    y[k[:, 0] % EVERY != 2, -1] = NAN
    y[40:45, 0] = NAN
    return 0.6 * np.sin(0.03 * k), y


# --- a record and its sections ------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("build", [lambda: two(y2=0.05), adaptive], ids=["two", "adaptive"])
def test_a_record_with_gaps_is_the_sections_by_hand(build: Any) -> None:
    made = build()
    u, y = record(made)
    run = fresh(made).run(u=u, y=y, engine="python")
    fresh(made)
    for k in range(len(y)):
        made.predict(u=u[k])
        for signal, value in zip(made.outputs, y[k], strict=True):
            if np.isfinite(value):
                made.update(k, **{signal.name: value})
        assert np.array_equal(made.adapt().x, run.x[k])


class Sections(NativeStep):
    """The compiled step by its sections."""

    def __init__(self, step: Any, real: Any) -> None:
        super().__init__(step, real)
        kinds = {"input": step.inputs, "output": step.outputs, "plant": step.states}
        self.records = {kind: np.zeros(1, [(s.name, self.number) for s in group]) for kind, group in kinds.items()}

    def _pointers_to(self, *kinds: str) -> list[Any]:
        return [*self._pointers, *(ctypes.c_void_p(self.records[kind].ctypes.data) for kind in kinds)]

    def predict(self, u: Any) -> int:
        self.records["input"][0] = tuple(u)
        return self._function("predict")(*self._pointers_to("input")) & 0xFFFFFFFF

    def update(self, name: str, value: float, at: int | None = None) -> int:
        self.records["output"][name] = value
        ending, time = ("", ()) if at is None else ("_at", (ctypes.c_uint16(at),))
        return self._function(f"update_{name}{ending}")(*self._pointers_to("output"), *time) & 0xFFFFFFFF

    def adapt(self) -> int:
        return self._function("adapt")(*self._pointers) & 0xFFFFFFFF

    @property
    def estimate(self) -> np.ndarray:
        self._function("estimate")(*self._pointers_to("plant"))
        return np.array(list(self.records["plant"][0]), self.number)


@pytest.mark.parametrize("real", ["float", "double"])
def test_c_by_its_sections_has_the_bits_of_the_record_and_of_python(real: Any) -> None:
    made = two(y2=0.05)
    u, y = record(made)
    native, exact = Sections(made, real), machine(made, real)
    whole = NativeStep(made, real).run(u, y)
    for k in range(len(y)):
        status = native.predict(u[k])
        exact.memory[Place("input", "u")][0] = u[k, 0]
        expected = exact.section("predict")
        for j, name in enumerate(("y1", "y2")):
            if np.isfinite(y[k, j]):
                status |= native.update(name, y[k, j], at=k)
                exact.memory[Place("output", name)][0], exact.memory[Place("argument", "at")][0] = y[k, j], k
                expected |= exact.section(f"update_{name}_at")
        assert status == expected
        exact.estimate()
        assert np.array_equal(native.estimate, [exact.memory[Place("estimate", f"x{i}")][0] for i in (1, 2, 3)])
        assert np.array_equal(native.estimate, whole.x[k])


@pytest.mark.full
def test_the_recorded_self_check_holds() -> None:
    for real in ("float", "double"):
        assert "as recorded" in run_check(hg.targets.c99(two(y2=0.05), real=real))


# --- the noise of a slow sensor -----------------------------------------------------------------------------


def test_r_is_taken_for_the_sensors_own_period() -> None:
    """P(0) = 1 in every state: the first gain is 1/(1 + R/h), with the sensor's h."""
    made = fresh(two(y2=0.05))
    made.predict(u=0.0)
    assert made.update(y1=0.3)["x1"] == pytest.approx(0.3 / (1 + 0.1 / 0.01), rel=1e-12)
    assert made.update(y2=0.4)["x3"] == pytest.approx(0.4 / (1 + 0.2 / 0.05), rel=1e-12)


def test_a_slow_sensor_is_worth_its_share() -> None:
    """R is a spectral density: in the long run few samples of period m dt tell as much as m times as many."""
    variances = []
    for made, every in ((two(y2=0.05), 5), (two(), 1)):
        y = np.zeros((3000, 2))
        y[np.arange(3000) % every > 0, 1] = NAN
        fresh(made).run(u=np.zeros(3000), y=y)
        memory = made._kept.places
        L, D = memory[Place("state", "L")], memory[Place("state", "D")]
        unit = np.array([[1, 0, 0], [L[0], 1, 0], [L[1], L[2], 1]])
        variances.append(np.diag(unit @ np.diag(D) @ unit.T))
    assert variances[0] == pytest.approx(variances[1], rel=0.05)


@pytest.mark.parametrize("way", [hg.innovation.staggered(0.4, predictors=2), hg.innovation.window(0.4)])
def test_the_innovation_of_a_slow_sensor_is_the_same_integral(way: Any) -> None:
    """A plant at rest and an observer that does not follow: |y - yhat| = 1 over the window, whatever the rate."""
    x, y = hg.Signal("x", low=-2, high=2), hg.Signal("y", low=-2, high=2)
    plant = hg.System("rest", states=(x,), outputs=(y,), flow=[0], output=[x])
    theta = hg.theta.adaptive(4.0, mu=(1e3, 2e3), innovation=way)
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=(1e-12,), R=1e12, covariance=(1e-12,), theta=theta)
    made = hg.sample(observer, dt=0.01, periods={"y": 0.05})
    values = np.full(400, NAN)
    values[::5] = 1.0
    innovation = made.run(y=values, engine="python").traces["innovation"][100:]
    assert innovation == pytest.approx(0.4, abs=1e-9)


# --- late, early, twice -------------------------------------------------------------------------------------


def at(made: Any, period: int) -> Any:
    """The step in the period of that number."""
    fresh(made).predict(u=0.1)
    made._kept.places[Place("state", "now")][0] = (period - 1) % 65536
    made.predict(u=0.1)
    return made


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 10**6), st.integers(-32767, 32768))
def test_only_a_sample_of_now_is_used(now: int, age: int) -> None:
    """Also where the count has wrapped round."""
    made, stamp = at(two(y2=0.05), now), now - age
    if stamp < 0:
        return
    before = made.save()
    sample = made.update(stamp, y2=0.4)
    assert sample.flags == ((f"{'LATE' if age > 0 else 'EARLY'}_Y2",) if age else ())
    assert (made.save() == before) == bool(age)


@pytest.mark.parametrize(
    ("now", "stamp", "flag"),
    [
        (65535, 65535, 0),
        (0, 0, 0),
        (0, 65535, "LATE_Y2"),
        (65535, 0, "EARLY_Y2"),
        (2, 65534, "LATE_Y2"),
        (32768, 0, "LATE_Y2"),
        (32769, 0, "EARLY_Y2"),
    ],
)
def test_c_counts_round_and_round(now: int, stamp: int, flag: Any) -> None:
    made, native = two(y2=0.05), Sections(two(y2=0.05), "float")
    native.predict((0.1,))
    native.state["now"] = (now - 1) % 65536
    native.predict((0.1,))
    assert native.state["now"][0] == now
    before = native.state.copy()
    assert made.flags(native.update("y2", 0.4, at=stamp)) == ((flag,) if flag else ())
    assert (native.state == before).all() == bool(flag)
    assert made.flags(at(made, now).update(stamp, y2=0.4).status) == ((flag,) if flag else ())


def test_a_sample_counts_once() -> None:
    made = fresh(two(y2=0.05))
    made.predict(u=0.1)
    assert made.update(0, y1=0.3, y2=NAN).flags == ("MISSING_Y2",)
    first = made.save()
    assert made.update(0, y1=0.3).flags == ("REPEATED_Y1",)
    assert made.update(y1=-0.3).flags == ("REPEATED_Y1",)
    assert made.save() == first
    assert made.update(0, y2=0.2).flags == ()  # that one was missing
    made.predict(u=0.1)
    assert made.update(0, y1=0.3).flags == ("LATE_Y1",)
    assert made.update(1, y1=0.3).flags == ()


def test_before_the_first_predict_every_sample_is_early() -> None:
    """Else that of period 0 would be used twice: before the first predict, which forgets what was used, and after."""
    made, native = fresh(two(y2=0.05)), Sections(two(y2=0.05), "float")
    before, memory = made.save(), native.state.copy()
    for at_ in (None, 0):
        assert made.update(at_, y1=0.3).flags == ("EARLY_Y1",)
        assert made.flags(native.update("y1", 0.3, at=at_)) == ("EARLY_Y1",)
    assert made.save() == before
    assert (native.state == memory).all()
    made.predict(u=0.1)
    native.predict((0.1,))
    for flags in ((), ("REPEATED_Y1",)):
        assert made.update(0, y1=0.3).flags == flags
        assert made.flags(native.update("y1", 0.3, at=0)) == flags


def test_theta_adapts_once() -> None:
    made, native = fresh(adaptive()), Sections(adaptive(), "double")
    for step in range(2):
        made.predict(u=0.1)
        native.predict((0.1,))
        assert made.update(step, y=0.3).flags == ()
        native.update("y", 0.3, at=step)
        assert made.adapt().flags == ()
        assert native.adapt() == 0
        before, native_before = made.save(), native.state.copy()
        assert made.adapt().flags == ("ADAPTED",)
        assert made.flags(native.adapt()) == ("ADAPTED",)
        assert made.save() == before
        assert (native.state == native_before).all()


def test_a_trial_samples_a_slow_sensor_seldom() -> None:
    made = hg.sample(pendulum_filter(), dt=1e-3, periods={"y": 0.01})
    tried = next(
        try_out(
            made, replace(load(MODELS / "pendulum.py").trials()[0], jumps=(), steady=None, duration=0.5), seeds=(0,)
        )
    )
    there = np.arange(501) % 10 == 0
    assert np.array_equal(np.isfinite(tried.y[:, 0]), there)
    assert np.array_equal([made.flags(status) == () for status in tried.status], there)


# --- the page for firmware -----------------------------------------------------------------------------------

PROGRAM = """
#include <stdio.h>
#include "pendulum.h"
static unsigned status, number;
static int running(pendulum_input *in) { in->tau = 0.1f; return number < 66000u; }
static int arrived(pendulum_output *measurement, uint16_t *taken)
{
    measurement->y = 0.02f;
    *taken = (uint16_t)(number % 30u == 0u ? number - 1u : number);
    return number++ % 10u == 0u && number > 1u;
}
int main(void)
{
    uint16_t taken;
    unsigned late = 0u;
    pendulum_state s; pendulum_params p; pendulum_input in; pendulum_output measurement; pendulum_plant x;
    pendulum_init(&s, &p);
LOOP
    (void)printf("%u late\\n", late);
    return x.q < 0.1f ? 0 : 1;
}
"""


def test_the_loop_of_the_page(tmp_path: Path) -> None:
    """66,000 periods, more than the count holds: a third of the samples is late, no other one is refused."""
    loop = next(block for block in pages.blocks("c", pages.text("howto/two_rates")) if "_at(" in block)
    count = "    late += (status & PENDULUM_LATE_Y) != 0u;\n    if ((status & PENDULUM_EARLY_Y) != 0u) { return 2; }\n"
    loop = loop.replace("    pendulum_estimate", f"{count}    pendulum_estimate")
    made = hg.sample(pendulum_filter(), dt=1e-3, periods={"y": 0.01})
    files = hg.targets.c99(made, check=False)
    texts = {name: files[name] for name in ("pendulum.h", "pendulum.c")}
    program = emitted.compiled(emitted.tool("cc"), {**texts, "main.c": PROGRAM.replace("LOOP", loop)}, tmp_path, "-O2")
    assert emitted.run([str(program)], tmp_path) == f"{len(range(30, 66000, 30))} late\n"


# --- with others --------------------------------------------------------------------------------------------


def test_a_bank_takes_sensors_of_different_rates() -> None:
    member = hg.observers.riccati(hg.forms.original(two_outputs()), Q=[0.1] * 3, R=[0.1, 0.2])
    bank = hg.observers.bank(member, count=3, period=0.4)
    made = hg.sample(bank, dt=0.01, periods={"y2": 0.05})
    u, y = record(made)
    python = made.run(u=u, y=y, engine="python")
    c = fresh(made).run(u=u, y=y, engine="c")
    assert np.array_equal(python.status, c.status)
    assert c.x == pytest.approx(python.x, abs=1e-10)


def test_a_step_without_periods_is_as_before() -> None:
    """No count, no functions for it; that there was an update is remembered all the same."""
    made = hg.sample(two().observer, dt=0.01)
    files = hg.targets.c99(made, check=False)
    assert "_at(" not in files["two.h"] + files["two.c"]
    assert not {"now", "adapted"} & {f.name for f in made.layout.state}
    u, y = record(made)
    assert np.array_equal(made.run(u=u, y=y).x, fresh(two()).run(u=u, y=y).x)


# --- bad input ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("periods", "said"),
    [
        ({"y3": 0.1}, "periods names 'y3', which is no output; the outputs are y1, y2"),
        ({"y2": 0.025}, r"the period y2 = 0\.025 is no whole multiple of dt = 0\.01; take 0\.02, or another dt"),
        ({"y2": 0.0201}, r"the period y2 = 0\.0201 is no whole multiple of dt = 0\.01; take 0\.02, or another dt"),
        ({"y2": 0.001}, r"the period y2 = 0\.001 is no whole multiple of dt = 0\.01; take 0\.01,"),
        ({"y2": 0}, "the period y2 = 0 must be a positive time"),
        ({"y2": NAN}, "the period y2 = nan must be a positive time"),
        ({"y2": "slow"}, "the period y2 = 'slow' must be a positive time"),
        ([0.1], r"periods = \[0\.1\] must name outputs"),
    ],
)
def test_bad_periods(periods: Any, said: str) -> None:
    with pytest.raises(BadRate, match=f"^{said}"):
        hg.sample(two().observer, dt=0.01, periods=periods)


def test_a_bad_time() -> None:
    made = fresh(two())
    for wrong in (-1, 0.5, True, "now"):
        with pytest.raises(BadShape, match="needs the number of a period, a whole number from 0"):
            made.update(wrong, y1=0.1)
    with pytest.raises(BadShape, match=r"this step has no `periods`: make it by sample\(\.\., periods=\{\}\)"):
        hg.sample(made.observer, dt=0.01).update(1, y1=0.1)


@pytest.mark.parametrize(
    "build", [lambda: (pendulum(), hg.methods.rk4), lambda: (kalman(van_der_pol()), hg.methods.rk4)]
)
def test_who_integrates_with_the_measurement_refuses(build: Any) -> None:
    observer, method = build()
    with pytest.raises(CannotUpdate, match="integrates with the measurement, so it cannot predict and update apart"):
        hg.sample(observer, method, dt=0.01, periods={"y": 0.02})
    made = hg.sample(observer, method, dt=0.01)
    for call in (lambda: made.predict(u=0.1 if made.inputs else ()), lambda: made.update(y=0.1), made.adapt):
        with pytest.raises(CannotUpdate):
            call()


@pytest.mark.full
def test_the_c_of_who_cannot_update_has_no_such_function() -> None:
    """Its sections are there, for the step alone."""
    made = emitted.integrated()
    files = hg.targets.c99(made, check=False)
    for name in ("predict", "update_y", "adapt"):
        assert f"{made.name}_{name}(" not in files[f"{made.name}.h"]
        assert f"static unsigned {made.name}_{name}(" in files[f"{made.name}.c"]
    assert "each once a period" not in files[f"{made.name}.h"]
