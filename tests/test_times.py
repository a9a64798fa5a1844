"""Plants whose equations are functions of time, against integrated references, and the same functions as inputs."""

import json
import math
import pickle
import tomllib
from copy import copy
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from test_cli import hgogen

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import Verdict
from hgogen.emit import pystep
from hgogen.emit.syntax import DTYPE
from hgogen.program import Place
from hgogen.reading.text_model import from_table, to_text
from hgogen.recheck.file import NoCertificate
from hgogen.recheck.verification import recheck
from hgogen.rigor.recurrent import grouped
from hgogen.signal import Time
from hgogen.stepping.times import BadTime, T, parts, ratio
from hgogen.trial import Trial, simulate

t, COUNT, LARGEST = hg.t, Place("state", "count"), 20 * ((1 << 24) // 20)
REMAINDER = Place("state", "remainder")
q, v = hg.Signal("q", low=-2, high=2), hg.Signal("v", low=-20, high=20)
u, w, y = hg.Signal("u", low=-1, high=1), hg.Signal("w", low=-1, high=1), hg.Signal("y", low=-3, high=3)
f = hg.Signal("f", "1/s", "frequency", 50)
HUM = sp.cos(2 * sp.pi * 50 * t)
NOISE = {"R": 1e-5, "Q": {"q": 1e-3, "v": 0.1}}


def oscillator(force: sp.Expr, inputs: tuple[hg.Signal, ...] = (), output: sp.Expr = q) -> hg.System:
    flow = [v, -40 * q - v / 2 + 9 * force + sum(inputs)]
    return hg.System("osc", states=(q, v), inputs=inputs, outputs=(y,), parameters=(f,), flow=flow, output=[output])


def kalman(plant: hg.System, dt: float = 1e-3, **options: object) -> hg.Step:
    observer = hg.observers.riccati(hg.forms.triangular(plant), **NOISE)
    return hg.sample(observer, hg.methods.continuous_discrete, dt, **options)


# --- what is declared ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "turns"),
    [
        (HUM, [sp.Rational(1, 50)]),
        (sp.cos(2 * math.pi * 50 * t), [sp.Rational(1, 50)]),
        (sp.sin(2 * sp.pi * f * t + q), [sp.Rational(1, 50)]),
        (sp.sin(t) ** 2 + sp.exp(sp.sin(3 * t)), [2 * sp.pi]),
        (HUM + sp.sin(2 * sp.pi * 60 * t), [sp.Rational(1, 10)]),
        (HUM + sp.sin(t), [2 * sp.pi, sp.Rational(1, 50)]),
        (sp.Mod(t, sp.Rational(1, 5)) * q, [sp.Rational(1, 5)]),
        (t - sp.floor(4 * t) / 4, [sp.Rational(1, 4)]),
        (sp.Piecewise((1, sp.sin(4 * sp.pi * t) > 0), (-1, True)), [sp.Rational(1, 2)]),
        (sp.sin(2 * sp.pi * (5 * t + sp.cos(2 * sp.pi * t) / 9)), [sp.S.One]),
        (sp.cos(2 * sp.pi * t / sp.Rational("12.42")) + sp.cos(sp.pi * t / 6), [sp.Integer(2484)]),
        (sp.cos(2 * sp.pi * t / sp.Rational("12.4206012")) + sp.cos(sp.pi * t / 6), [sp.Rational("12.4206012"), 12]),
    ],
)
def test_its_periods_are_found(force: sp.Expr, turns: list[sp.Expr]) -> None:
    plant = oscillator(force)
    assert [sp.simplify(time.turn - turn) for time, turn in zip(plant.times, turns, strict=True)] == [0] * len(turns)
    assert plant.inputs == plant.times
    assert not plant.supplied
    back = dict.fromkeys(plant.times, t)
    moments = {t: 0.6180339, q: 0.3, v: 0, f: 50}
    row = plant.flow[1].xreplace(back) - (-40 * q - v / 2 + 9 * force)
    assert abs(float(row.subs(moments))) < 1e-9
    assert pickle.loads(pickle.dumps(plant)) == plant


@pytest.mark.parametrize(
    ("force", "reason"),
    [
        (t, "is not periodic in t; write it with sin, cos or Mod of t and constants, or give its values as an input"),
        (sp.exp(-t), r"flow 2: exp\(-t\) is not periodic in t"),
        (t * sp.sin(t), "is not periodic"),
        (sp.Piecewise((1, t > 5), (0, True)), "t > 5 is not periodic"),
        (sp.sin(q * t), "varies with q"),
        (sp.sin(t - sp.floor(t)) + sp.sin(2 * sp.pi * t + sp.floor(sp.pi * t)), "without a common multiple"),
    ],
)
def test_what_does_not_recur_is_refused(force: sp.Expr, reason: str) -> None:
    with pytest.raises(hg.HgogenError, match=reason):
        oscillator(force)


def test_a_frequency_with_a_range_is_refused_and_another_value_has_another_period() -> None:
    loose = hg.Signal("f", "1/s", "", 50, 40, 60)
    with pytest.raises(hg.HgogenError, match="varies with f"):
        hg.System("loose", states=(q,), outputs=(y,), parameters=(loose,), flow=[sp.sin(loose * t)], output=[q])
    plant = oscillator(sp.sin(2 * sp.pi * f * t))
    assert hg.system.valued(plant, {"f": 40}).times[0].turn == sp.Rational(1, 40)


def test_a_signal_of_that_name_is_no_time() -> None:
    temperature = hg.Signal("t", "degC", low=0, high=1)
    plant = hg.System("warm", states=(q,), inputs=(temperature,), outputs=(y,), flow=[temperature - q], output=[q])
    assert plant.supplied == (temperature,)
    table = {
        "name": "warm",
        "states": {"q": {"flow": "t - q"}},
        "inputs": {"t": {}},
        "outputs": {"y": {"equation": "q"}},
    }
    assert not from_table(table).plant.times
    both = hg.System("both", states=(q,), inputs=(temperature,), outputs=(y,), flow=[temperature * 0 - q], output=[q])
    assert not both.times


def test_a_text_model_has_it() -> None:
    rows = {"q": {"flow": "cos(2*pi*50*t) + Mod(t, 0.3) - q"}}
    plant = from_table({"name": "text", "states": rows, "outputs": {"y": {"equation": "q"}}}).plant
    assert [time.turn for time in plant.times] == [sp.Rational(3, 5) / 2]
    assert from_table(tomllib.loads(to_text(plant))).plant == plant


def test_periods_join_where_they_recur_together_soon() -> None:
    turns = [sp.Rational(1, 50), sp.Rational(1, 60), sp.Integer(86400), 2 * sp.pi]
    assert grouped(turns) == (sp.Integer(86400), 2 * sp.pi, sp.Rational(1, 10))


# --- the count ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turn", "dt", "share", "exact"),
    [
        (sp.Rational(1, 50), 1e-3, Fraction(1, 20), True),
        (sp.Rational(1, 60), 1e-3, Fraction(3, 50), True),
        (sp.Integer(86400), 1.0, Fraction(1, 86400), True),
    ],
)
def test_the_count_is_exact(turn: sp.Expr, dt: float, share: Fraction, exact: bool) -> None:
    assert ratio(Time("t", turn), dt) == (share, exact)


def test_an_irrational_period_is_counted_to_thirteen_digits() -> None:
    share, exact = ratio(Time("t", 2 * sp.pi), 1e-3)
    assert not exact
    assert share.denominator <= 1 << 24
    assert abs(float(share) * 2 * math.pi / 1e-3 - 1) < 1e-10


@pytest.mark.parametrize(("dt", "reason"), [(0.011, "take at most 0.01 s"), (1e-10, "take at least")])
def test_a_period_that_cannot_be_counted_is_refused(dt: float, reason: str) -> None:
    with pytest.raises(BadTime, match=reason):
        ratio(Time("t", sp.Rational(1, 50)), dt)


@pytest.mark.parametrize("real", ["float", "double"])
def test_it_keeps_its_digits_for_years(real: str) -> None:
    """A count near its end, and a start ten years off, give the bits of the first second."""
    step = kalman(oscillator(HUM), real=real)
    samples = 0.1 * np.cos(np.arange(1000) * 0.02)
    first = step.run(y=samples)
    assert not first.status.any()
    step.reset(3e8)
    assert np.array_equal(step.run(y=samples).x, first.x)
    step.reset(3e8 + 0.005)
    assert not np.allclose(step.run(y=samples).x, first.x, atol=1e-3)
    step.reset(-0.001)
    assert step._kept.places[COUNT].tolist() == [19 * LARGEST // 20]
    step.reset(0.00137)  # between two samples of the first second
    assert step._kept.places[COUNT][0] == pytest.approx(0.0685 * LARGEST, abs=2)


@pytest.mark.parametrize("real", ["float", "double"])
def test_what_is_emitted_begins_at_its_time(real: str) -> None:
    """The counts of init and set_time are those of `reset`, up to the rounding of the time; of a time that has no
    place in a turn they are lost, and the next call says so."""
    step = kalman(oscillator(HUM + sp.sin(t)), real=real)
    set_time, places = pystep.entries(step, step._kept.record, real)["set_time"], step._kept.places
    rng, unit = np.random.default_rng(4), np.finfo(DTYPE[real]).eps
    for begin in [0.0, 0.02, -1e-12, 6.2831853, *rng.uniform(-30, 30, 40).astype(DTYPE[real]).astype(float)]:
        step.reset(begin)
        wanted = places[COUNT].copy()
        for running in (False, True):
            if running:  # the count goes on by one call before it is used
                step(y=0.0)
            places[T][:] = begin
            set_time()
            if running:
                step.predict()
            away = np.abs(places[COUNT] - wanted)
            ends = np.array([parts(time, step.dt)[1] for time in step.observer.form.system.times])
            assert (places[COUNT] < ends).all()
            turns = np.array([begin / float(time.turn) for time in step.observer.form.system.times])
            assert (np.minimum(away, ends - away) <= 0.51 + 2 * unit * ends * (1 + np.abs(turns))).all()
    for lost in (math.nan, math.inf, 1e30, 4e3 if real == "float" else 1e15):
        places[T][:] = lost
        set_time()
        assert step(y=0.0).flags == ("TIME_LOST",)


def test_casadi_begins_at_its_time() -> None:
    step = kalman(oscillator(HUM + sp.sin(t), (u,)))
    functions = hg.targets.casadi(step, bundled=True)
    y, inputs = np.random.default_rng(5).normal(size=(60, 1)) / 9, np.linspace(0, 1, 60)[:, None]
    step.reset(1.2345)
    run = step.run(u=inputs, y=y)
    begin = functions.begin(1.2345)
    _, x, status, *_ = functions.step.mapaccum(60)(begin, inputs.T, y.T, functions.p.initial)
    assert np.array_equal(x.full().T, run.x)
    assert np.array_equal(status.full()[0], run.status)
    assert ca.Function.deserialize(functions["osc_begin.casadi"])(1.2345).full().tolist() == begin.full().tolist()
    assert hg.targets.casadi(kalman(oscillator(sp.S.Zero, (u,)))).begin is None
    for inputs in ((), (u,)):
        with pytest.raises(hg.HgogenError, match="observer with functions of t is no differential equation"):
            _ = hg.targets.casadi(kalman(oscillator(HUM, inputs))).derivative


def test_a_lost_value_keeps_the_time() -> None:
    """All else begins anew; the estimate is then that of a step which began there."""
    step, other = kalman(oscillator(HUM)), kalman(oscillator(HUM))
    step.run(y=np.zeros(7))
    step._kept.places[Place("state", "z")][:] = math.nan
    assert "RESTARTED" in step(y=math.nan).flags
    assert step._kept.places[COUNT] == 7 * LARGEST // 20
    other.reset(0.007)
    other(y=math.nan)
    blind = np.full(30, math.nan)
    assert np.array_equal(step.run(y=blind).x, other.run(y=blind).x)


@pytest.mark.parametrize("spoiled", [math.nan, -1.0, 1.0 * LARGEST, 3.5, math.inf])
def test_a_spoiled_count_begins_anew(spoiled: float) -> None:
    step, other = kalman(oscillator(HUM)), kalman(oscillator(HUM))
    step(y=0.1)
    other(y=0.1)
    step._kept.places[COUNT][:] = spoiled
    other._kept.places[COUNT][:] = 0
    a, b = step(y=0.1), other(y=0.1)
    assert a.flags == ("TIME_LOST",)
    assert not b.flags
    assert (a.x == b.x).all()


def test_what_is_saved_keeps_the_time() -> None:
    step = kalman(oscillator(HUM))
    samples = 0.1 * np.sin(np.arange(60.0))
    whole = step.run(y=samples).x
    step.reset()
    step.run(y=samples[:37])
    for again in (copy(step), pickle.loads(pickle.dumps(step))):
        run = again.run(y=samples[37:])
        assert np.array_equal(run.x, whole[37:])
        assert run.times == pytest.approx((0.017,))
    memory = step.save()
    step.reset(0.007)
    step.restore(memory)
    assert np.array_equal(step.run(y=samples[37:]).x, whole[37:])


# --- the estimate ---------------------------------------------------------------------------------------------


def test_it_is_exact_at_the_stages() -> None:
    """Over missing samples the estimate is the plant's solution, which a function given as an input at the samples,
    and a line between them, is not."""
    plant = oscillator(HUM)
    truth = simulate(plant, Trial("free", 1.0, {"q": 1, "v": 0}), 1e-3)
    blind = np.full(len(truth.t), np.nan)
    run = kalman(plant).started({"q": 1, "v": 0}).run(y=blind)
    flow = [v, -40 * q - v / 2 + 9 * w]
    fed_plant = hg.System("fed", states=(q, v), inputs=(w,), outputs=(y,), flow=flow, output=[q])
    linear = kalman(fed_plant).started({"q": 1, "v": 0})
    fed = linear.run(u=np.cos(100 * np.pi * truth.t), y=blind)
    exact, line = (np.abs(each.x - truth.x).max() for each in (run, fed))
    assert exact < 1e-5
    assert line > 30 * exact
    assert line < 1e-2


def test_an_output_may_be_a_function_of_time() -> None:
    plant = oscillator(HUM, (u,), q * (2 + sp.sin(2 * sp.pi * 3 * t)))
    truth = simulate(plant, Trial("out", 2.0, {"q": 1, "v": 0}, {"u": sp.sin(t)}), 1e-3)
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), **NOISE), dt=1e-3)
    run = step.run(u=truth.u[:, 0], y=truth.y)
    assert np.abs(run.x - truth.x)[1500:, 0].max() < 1e-4
    assert ((truth.u[:, 1] >= 0) & (truth.u[:, 1] <= plant.times[0].high)).all()


def test_two_tides_are_followed() -> None:
    tide = sp.cos(2 * sp.pi * t / sp.Rational("12.4206012")) + sp.cos(2 * sp.pi * t / 12) / 3
    level, seen = hg.Signal("level", "m", low=-9, high=9), hg.Signal("seen", "m", low=-9, high=9)
    plant = hg.System("tide", states=(level,), outputs=(seen,), flow=[tide - level / 3], output=[level], time="h")
    truth = simulate(plant, Trial("month", 400.0, {"level": 0}), 0.25)
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), R=1e-4, Q=[1e-4]), dt=0.25)
    run = step.run(y=np.full(len(truth.t), np.nan))
    assert np.abs(run.x - truth.x).max() < 1e-5


@pytest.mark.parametrize("between", ["line", "hold"])
def test_a_held_input_holds_no_time(between: str) -> None:
    plant = oscillator(HUM, (u,))
    truth = simulate(plant, Trial("held", 0.5, {"q": 1, "v": 0}, {"u": 0.3}), 1e-3)
    step = kalman(plant, between=between).started({"q": 1, "v": 0})
    blind = np.full(len(truth.t), np.nan)
    first = step.run(u=np.full(len(blind), 0.3), y=blind)
    assert np.abs(first.x - truth.x)[1:].max() < 2e-3  # the first input is held from before


def test_late_samples_are_those_of_their_time() -> None:
    plant, rng = oscillator(HUM), np.random.default_rng(2)
    observer = hg.observers.riccati(hg.forms.original(plant), **NOISE)
    late = hg.sample(hg.delayed(observer, y=7), dt=1e-3)
    samples = rng.normal(size=200) / 9
    ages = np.full(200, 7.0)
    arrived = np.column_stack([np.concatenate([np.full(7, np.nan), samples[:-7]]), ages])
    known = np.concatenate([samples[:-7], np.full(7, np.nan)])
    x = late.run(y=arrived).x[-1]
    assert np.array_equal(x, late.undelayed.run(y=known).x[-1])


def test_every_reader_has_its_bits() -> None:
    step = kalman(oscillator(HUM + sp.sin(t), (u,)))
    samples, inputs = np.random.default_rng(0).normal(size=(3, 80)) / 9, np.linspace(0, 1, 80)
    step.reset(1.25)
    c, python = (copy(step).run(u=inputs, y=samples[0], engine=engine) for engine in ("c", "python"))
    assert np.array_equal(c.x, python.x)
    many = step.run_many(u=np.tile(inputs[None, :, None], (3, 1, 1)), y=samples[:, :, None])
    assert np.array_equal(many.x[0], c.x)


# --- a dt that varies -----------------------------------------------------------------------------------------

DTS = (0.002, 0.012)


def varying(force: sp.Expr, inputs: tuple[hg.Signal, ...] = (), **options: Any) -> Any:
    observer = hg.observers.riccati(hg.forms.triangular(oscillator(force, inputs)), Q=NOISE["Q"], noise={"y": 0.01})
    return hg.sample(observer, dt=DTS, engine="python", **options)


def time_of(step: Any) -> float:
    """The time of the last call modulo its turn."""
    (turn,), places = (time.turn for time in step.observer.form.system.times), step._kept.places
    (field,) = (each for each in step.layout.state if each.name == "count")
    return float((places[COUNT] + places[REMAINDER])[0] * float(turn) / (field.high[0] + 1))


@pytest.mark.parametrize(("real", "digits"), [("float", 3e-7), ("double", 1e-14)])
def test_a_varying_dt_loses_no_more_than_its_own_digits(real: str, digits: float) -> None:
    """In a turn of an hour a sum of such times in float would lose 2e-4 s in each."""
    step, elapsed = varying(sp.cos(2 * sp.pi * t / 3600), real=real), np.random.default_rng(0).uniform(*DTS, 4000)
    elapsed = elapsed.astype(DTYPE[real])
    step.reset(3599.5)
    step.run(y=np.full(4000, np.nan), dt=elapsed)
    passed = math.fsum(map(float, elapsed[1:]))
    assert time_of(step) - (passed - 0.5) == pytest.approx(0, abs=digits * passed)
    assert not step.run(y=np.full(3, np.nan), dt=0.01).status.max() & (1 << step.flags(2**30 - 1).index("TIME_LOST"))


def test_a_lost_value_keeps_the_remainder_of_the_time() -> None:
    """The count alone is off by up to half a part."""
    step = varying(sp.cos(2 * sp.pi * 5 * t))
    step.run(y=np.zeros(7), dt=np.full(7, 0.0033))
    before = float(step._kept.places[REMAINDER][0])
    assert before
    step._kept.places[Place("state", "z")][:] = math.nan
    assert "RESTARTED" in step(y=math.nan, dt=0.0).flags
    assert step._kept.places[REMAINDER] == before


@pytest.mark.parametrize("between", ["line", "hold"])
def test_sub_steps_have_the_time_of_calls(between: str) -> None:
    """A call over 5 dt is five calls without samples; at a constant dt it is the fixed step, and time goes on by all of
    a dt of which the prediction does not reach the end."""
    step = varying(sp.cos(2 * sp.pi * 5 * t), (u,), between=between)
    samples, inputs = 0.1 * np.cos(np.arange(60) * 0.02), np.sin(np.arange(60) * 0.03)
    observer = hg.observers.riccati(step.observer.form, Q=NOISE["Q"], noise={"y": 0.01})
    fixed = hg.sample(observer, dt=0.01, between=between, engine="python")
    for each in (step, fixed):
        each.reset(3.21)
    assert step.run(u=inputs, y=samples, dt=0.01).x == pytest.approx(fixed.run(u=inputs, y=samples).x, abs=1e-12)
    parts = copy(step)
    ends = inputs[-1] + np.linspace(0.2, 1, 5) * (0.3 - inputs[-1]) if between == "line" else np.full(5, 0.3)
    for now, sample in zip(ends, [math.nan] * 4 + [0.2], strict=True):
        last = parts(now, sample, dt=0.01)
    assert step(0.3, 0.2, dt=0.05).x == pytest.approx(last.x, abs=1e-12)
    before = time_of(step)
    assert step(0.3, 0.2, dt=0.31).flags == ("DT_LIMITED",)
    assert (time_of(step) - before - 0.31 + 0.1) % 0.2 == pytest.approx(0.1, abs=1e-12)
    before = time_of(step)
    for off in (0.0, -1.0, math.nan):
        step(0.3, 0.2, dt=off)
    assert time_of(step) == before
    assert step(0.3, 0.2, dt=math.inf).flags == ("DT_LIMITED",)
    assert "TIME_LOST" not in step(0.3, 0.2, dt=0.01).flags


@pytest.mark.full
def test_every_reader_has_its_bits_at_varying_times() -> None:
    step, elapsed = varying(sp.cos(10 * sp.pi * t) + sp.sin(t), (u,)), np.random.default_rng(0).uniform(0, 0.02, 80)
    elapsed[30:34] = 0, 0.5, -1, math.nan
    samples, inputs = np.random.default_rng(0).normal(size=80) / 9, np.linspace(0, 1, 80)
    step.reset(1.25)
    c, python = (copy(step).run(u=inputs, y=samples, dt=elapsed, engine=engine) for engine in ("c", "python"))
    assert np.array_equal(c.x, python.x)
    assert np.array_equal(c.status, python.status)
    many = step.run_many(u=inputs, y=np.stack([samples, samples])[..., None], dt=elapsed, engine="c")
    assert np.array_equal(many.x[1], c.x)
    made = hg.targets.casadi(step)
    rows = np.column_stack([inputs, elapsed])[:30]
    _, x, _ = made.step.mapaccum(30)(made.begin(1.25), rows.T, samples[None, :30], made.p.initial)
    assert python.x[:30] == pytest.approx(np.array(x).T, abs=1e-9)


@pytest.mark.full
def test_an_irregular_log_has_its_times() -> None:
    """The stiffness of an oscillator under a known force, from rows at random times; a force of a wrong phase tells
    nothing of it."""
    k = hg.Signal("k", "", "stiffness", 30, low=10, high=80)
    flow = [v, -k * q - v / 2 + 9 * sp.cos(10 * sp.pi * t)]
    plant = hg.System("osc", states=(q, v), outputs=(y,), parameters=(k,), flow=flow, output=[q])
    times = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.06, 300))
    true = Trial("forced", 12, {"q": 1, "v": 0}, seeds=(0,))
    x = simulate(hg.system.valued(plant, {"k": 40}), true, 0.01, np.concatenate([[0], times])).x[1:, :1]
    log = hg.Log(np.zeros((300, 0)), x, 0.035, start=times[0], times=times)
    assert hg.fit(plant, log, starts=1).values["k"] == pytest.approx(40, rel=1e-3)
    tuned = hg.tune(hg.system.valued(plant, {"k": 40}), log, observers=("riccati",))
    assert tuned.best.first.step.clock.varying
    assert tuned.best.error < 0.01


# --- what is proved -------------------------------------------------------------------------------------------


def test_its_rate_is_one() -> None:
    """A vector at rest that is seen from a turning direction is observable, one seen along a fixed one is not."""
    turning = q * sp.cos(2 * sp.pi * t) + v * sp.sin(2 * sp.pi * t)
    seen = hg.System("turning", states=(q, v), outputs=(y,), flow=[0, 0], output=[turning])
    assert hg.observability(seen).known.rank.rank == 2
    fixed = hg.System("fixed", states=(q, v), outputs=(y,), flow=[0, 0], output=[(q + v) * (2 + sp.cos(t))])
    assert hg.observability(fixed).known.rank.rank == 1


def test_a_rate_that_only_an_input_has_shows_nothing() -> None:
    """w'' + 4 pi^2 w = 0 for w = cos 2 pi t: what a free input would show by it, this one does not."""
    c, s = sp.cos(2 * sp.pi * t), sp.sin(2 * sp.pi * t)
    x = [hg.Signal(f"x{k}", low=-1, high=1) for k in range(3)]
    output = x[0] * c + x[1] * s + x[2] * sp.cos(2 * sp.pi * t + 1)
    plant = hg.System("three", states=x, outputs=(y,), flow=[0, 0, 0], output=[output])
    assert hg.observability(plant).known.rank.rank == 2


def test_the_phase_form_follows_its_derivatives() -> None:
    plant = oscillator(HUM, output=q * (2 + sp.cos(2 * sp.pi * t)))
    form = hg.forms.phase(plant)
    assert all(check.verdict is Verdict.PROVED for check in form.checks)
    assert form.system.inputs == plant.times
    truth = simulate(plant, Trial("phase", 1.0, {"q": 1, "v": 0}), 1e-3)
    step = hg.sample(hg.observers.high_gain(form, theta=20, poles=(-1, -1)), hg.methods.rk4, 1e-3)
    assert np.abs(step.run(y=truth.y).x - truth.x)[-1] == pytest.approx([0, 0], abs=1e-3)


def test_a_certificate_holds_for_every_time() -> None:
    form = hg.forms.triangular(oscillator(HUM * sp.sin(q)))
    observer = hg.observers.high_gain(form, theta=20, poles=(-1, -1))
    assert any(check.verdict is Verdict.PROVED for check in observer.checks)
    rows = recheck(json.dumps(certificate(form, observer.checks, observer.name))).rows
    assert len(rows) >= 4
    assert {row.found for row in rows} == {"verified"}


def test_a_certificate_of_derivatives_of_the_output_takes_the_rate_of_time_for_1() -> None:
    plant = oscillator(HUM, output=q * (2 + sp.cos(2 * sp.pi * t)))
    form = hg.forms.phase(plant)
    content = certificate(form, form.checks, "")
    assert content["plant"]["times"] == [w.name for w in plant.times]
    rows = {row.id: row.found for row in recheck(json.dumps(content)).rows}
    assert (rows["phase.chain"], rows["phase.rank"]) == ("verified", "verified")
    assert "fails" not in rows.values()
    free = {**content, "plant": {key: value for key, value in content["plant"].items() if key != "times"}}
    assert "fails" in {row.found for row in recheck(json.dumps(free)).rows}
    strange = {**content, "plant": {**content["plant"], "times": ["q"]}}
    with pytest.raises(NoCertificate, match="is a time, and no input"):
        recheck(json.dumps(strange))


def test_what_is_not_followed_between_samples_is_unknown() -> None:
    form = hg.forms.triangular(oscillator(HUM))
    step = hg.sample(hg.observers.high_gain(form, theta=20, poles=(-1, -1)), hg.methods.rk4, 1e-3, between="hold")
    bound = hg.error_bound(step, noise={"y": 0.01})
    assert bound.check.verdict is Verdict.UNKNOWN


# --- logs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("between", ["line", "hold"])
def test_a_log_begins_at_its_time(between: str) -> None:
    """A parameter is found where the log's start is known, and a wrong one is found where it is not."""
    a = hg.Signal("a", "", "", 30.0, 20, 60)
    flow = [v, -a * q - v / 2 + 3 * sp.cos(2 * sp.pi * t)]
    plant = hg.System("fitted", states=(q, v), outputs=(y,), parameters=(a,), flow=flow, output=[q])
    true = hg.system.valued(plant, {"a": 40})
    truth = simulate(true, Trial("log", 6.0, {"q": 0, "v": 0}), 0.02)
    rows = slice(45, None)  # from 0.9 s on
    no_input = np.zeros((len(truth.t[rows]), 0))
    fitted = hg.fit(plant, hg.Log(no_input, truth.y[rows], 0.02, 0.9), starts=1, between=between)
    assert fitted.parameters[0].value == pytest.approx(40, rel=1e-4)
    wrong = hg.fit(plant, hg.Log(no_input, truth.y[rows], 0.02), starts=1, between=between)
    assert abs(wrong.parameters[0].value - 40) > 1e-2


@pytest.mark.full
def test_a_command_sets_the_time_of_the_first_row(tmp_path: Path) -> None:
    """A log without absolute times, whose first row is at t = 0.9; run follows it with --start alone."""
    a = hg.Signal("a", "", "", 30.0, 20, 60)
    flow = [v, -a * q - v / 2 + 3 * sp.cos(2 * sp.pi * t)]
    plant = hg.System("dated", states=(q, v), outputs=(y,), parameters=(a,), flow=flow, output=[q])
    truth = simulate(hg.system.valued(plant, {"a": 40}), Trial("log", 6.0, {"q": 0, "v": 0}), 0.02)
    tuning = {"observer": {"kind": "riccati", "R": 1e-4, "Q": [1e-4, 1e-4], "dt": 0.02}}
    (tmp_path / "dated.toml").write_text(to_text(plant, tuning))
    rows = "\n".join(f"{each:.12g}" for each in truth.y[45:, 0])
    (tmp_path / "log.csv").write_text(f"y\n{rows}\n")
    model, data = str(tmp_path / "dated.toml"), ("--data", str(tmp_path / "log.csv"), "--period", "0.02")
    fitted, errors = list[float](), list[float]()
    for start in ("0.9", "0"):
        options = (*data, "--start", start, "--out", str(tmp_path / start), "--json")
        printed = hgogen("fit", model, *options, "--starts", "1", "--held-out", "0")[0]
        fitted.append(json.loads(printed)["parameters"]["a"])
        parameters = ("--parameters", str(tmp_path / "0.9" / "fitted.json"))
        last = json.loads(hgogen("run", model, *options, *parameters)[0])["predictions"][-1]
        assert last["ahead"] is None
        errors.append(last["model"])
    assert fitted[0] == pytest.approx(40, rel=1e-4)
    assert abs(fitted[1] - 40) > 1e-2
    assert errors[1] > 1.2 * errors[0]


def test_time_is_no_input_of_any_course() -> None:
    """At t = 0 the second derivative has x2, whose coefficient is 0 there."""
    x1, x2 = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2"))
    plant = hg.System("late", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[sp.Mod(hg.t, 2) * x2, -x2], output=[x1])
    (row,) = (one for one in hg.survey(plant).rows if one.name == "Gauthier-Bornard")
    assert (row.verdict, "any course" in str(row)) == (None, True)
