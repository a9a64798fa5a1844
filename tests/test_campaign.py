"""Campaigns: what varies and how, the same numbers whoever computes them, results that a stopped campaign goes on from,
quantiles and the run that repeats the worst."""

import contextlib
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import MODELS
from typer.testing import CliRunner, Result

import hgogen as hg
from hgogen import cli
from hgogen import trial as trial_module
from hgogen.call import CallableStep
from hgogen.model import load
from hgogen.reading.given import BadGain
from hgogen.registry import NotInstalled
from hgogen.run import campaign as campaign_module
from hgogen.run import native
from hgogen.run.campaign import (
    BadCampaign,
    BadVariation,
    Campaign,
    NoScheduler,
    Outcome,
    Spread,
    Tally,
    Varied,
    hypercube,
    outcome,
    results_head,
    results_line,
    stored_outcomes,
    varied,
)
from hgogen.run.metrics import Metrics, Response, metrics
from hgogen.target import CannotWrite, lines_of
from hgogen.trial import BadTrial, Extrapolation, Jump, OrnsteinUhlenbeck, Plant, Sine, Trial, simulate, t, try_out

NAN, INF = float("nan"), float("inf")


def plant() -> hg.System:
    """x1' = x2, x2' = -a sin x1 - b x2 + u, y = x1; b has no range."""
    x1, x2 = (hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2))
    a, b = hg.Signal("a", nominal=2, low=1, high=3), hg.Signal("b", nominal=0.2)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-5, high=5)
    flow = (x2, -a * sp.sin(x1) - b * x2 + u)
    return hg.System("swing", states=(x1, x2), inputs=(u,), outputs=(y,), parameters=(a, b), flow=flow, output=(x1,))


PLANT = plant()
TRIAL = Trial("let_go", 2.0, {"x1": 1.0, "x2": 0.0}, {"u": sp.Rational(1, 10)}, {"y": OrnsteinUhlenbeck(0.01, 0.05)})


def step(**options: Any) -> Any:
    observer = hg.observers.high_gain(hg.forms.triangular(PLANT), theta=5, poles=(-1, -1))
    return hg.sample(observer, dt=0.01, **options)


# --- what varies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ("x1", [("x1", "start", -4, 4)]),
        ("x0", [("x1", "start", -4, 4), ("x2", "start", -4, 4)]),
        ("x1=10%", [("x1", "start", 0.9, 1.1)]),
        ("x2=0.5", [("x2", "start", -0.5, 0.5)]),
        (" x1 = -1..1.5e0 , a", [("x1", "start", -1, 1.5), ("a", "parameter", 1, 3)]),
        ("parameters", [("a", "parameter", 1, 3)]),
        ("parameters=10%", [("a", "parameter", 1.8, 2.2), ("b", "parameter", 0.18, 0.22)]),
        ("noise=50%", [("noise", "noise", 0.5, 1.5)]),
        ("noise=0..2", [("noise", "noise", 0, 2)]),
        ({"x1": 0.25, "a": None}, [("x1", "start", 0.75, 1.25), ("a", "parameter", 1, 3)]),
    ],
)
def test_what_varies_and_how_far(asked: Any, wanted: list[tuple[str, str, float, float]]) -> None:
    read = varied(asked, PLANT, TRIAL)
    assert [(each.name, each.what) for each in read] == [row[:2] for row in wanted]
    assert [(each.low, each.high) for each in read] == [pytest.approx(row[2:]) for row in wanted]


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ("x3", "vary 'x3'"),
        ("x1,x1", "x1 varies already; name it once"),
        ("x0,x1=1%", "x1 varies already; name it once"),
        ("b", "it has no range; declare low= and high=, or say how far, as in 10% or 0.2"),
        ("a=2", "[0, 4] leaves its range [1, 3]; say less, or declare a wider range"),
        ("x2=10%", "'10%' leaves nothing to vary about 0"),
        ("x1=1..0", "leaves nothing to vary about 1"),
        ("x1=-1", "leaves nothing to vary about 1"),
        ("x1=abc", "'abc' is no interval; write NAME, NAME=10%, NAME=0.2 or NAME=0.8..1.2"),
        ("x1=nan", "'nan' is no interval"),
        ("x1=", "write NAME, NAME=10%"),
        ("", "write NAME, NAME=10%"),
        ("noise", "say by which factor, as in noise=50% or noise=0.5..2"),
        ("noise=150%", "a factor from -0.5 on is below 0; say less"),
        ({"x1": NAN}, "'nan' is no interval"),
    ],
)
def test_what_cannot_vary_is_refused(asked: Any, sentence: str) -> None:
    with pytest.raises(BadVariation) as error:
        varied(asked, PLANT, TRIAL)
    assert sentence in str(error.value)


def test_noise_of_a_trial_without_noise_is_refused() -> None:
    with pytest.raises(BadVariation, match="the trial quiet has none; declare a trial with noise, or leave it out"):
        varied("noise=10%", PLANT, Trial("quiet", 1.0, TRIAL.start, TRIAL.inputs))


@given(st.integers(1, 40), st.integers(0, 9))
@settings(max_examples=25, deadline=None)
def test_one_draw_lies_in_each_part_of_an_interval(count: int, seed: int) -> None:
    each = (Varied("x1", "start", -1.0, 3.0), Varied("a", "parameter", 1.0, 2.0))
    draws = hypercube(each, count, seed)
    shares = (draws.values - [-1.0, 1.0]) / [4.0, 1.0] * count
    assert (np.sort(np.clip(np.floor(shares + 1e-9), 0, count - 1), axis=0) == np.arange(count)[:, None]).all()
    assert (draws.values == hypercube(each, count, seed).values).all()


def test_two_quantities_and_two_seeds_have_orders_of_their_own() -> None:
    each = (Varied("x1", "start", 0.0, 1.0), Varied("x2", "start", 0.0, 1.0))
    first, second = (hypercube(each, 50, seed).values for seed in (0, 1))
    orders = {tuple(np.argsort(column)) for column in (*first.T, *second.T)}
    assert len(orders) == 4


# --- the numbers ------------------------------------------------------------------------------------------------


def test_a_run_is_the_trial_of_its_draw() -> None:
    """Each against `try_out` of a trial, and a plant, that say the same outright."""
    made = hg.campaign(step(engine="python"), TRIAL, 3, "x1=20%,a=10%,noise=50%", seed=4, engine="python")
    outcomes = sorted(made.run(jobs=1), key=lambda one: one.run)
    for one in outcomes:
        x1, a, factor = one.varied.values()
        a_signal = hg.Signal("a", nominal=a)
        flow = [sp.sympify(e).subs(PLANT.parameters[0], a_signal) for e in PLANT.flow]
        other = hg.System(
            "swing",
            states=PLANT.states,
            inputs=PLANT.inputs,
            outputs=PLANT.outputs,
            parameters=(a_signal, PLANT.parameters[1]),
            flow=flow,
            output=PLANT.output,
        )
        truth = simulate(other, Trial("t", 2.0, {"x1": x1, "x2": 0.0}, TRIAL.inputs), 0.01)
        rng = np.random.default_rng(one.run)
        y = truth.y + OrnsteinUhlenbeck(0.01 * factor, 0.05).at(truth.t, [rng])
        estimate = step().run(u=np.full(len(y), 0.1), y=y, engine="python").x
        late = truth.t >= 1.8 - 1e-9
        wanted = np.sqrt(np.mean((estimate - truth.x)[late] ** 2, axis=0))
        assert one.metrics is not None
        assert list(one.metrics.rms.values()) == pytest.approx(wanted, rel=1e-6)  # the truth to 1e-13 a step


def test_noise_alone_is_the_trials_seeds() -> None:
    made = step()
    outcomes = sorted(hg.campaign(made, TRIAL, 20).run(jobs=1), key=lambda one: one.run)
    plain = [metrics(made, one) for one in try_out(made, TRIAL, seeds=range(20))]
    assert [one.metrics for one in outcomes] == plain


@pytest.mark.parametrize("vary", [None, "x1=20%", "noise=50%", "a=10%,noise=20%"])
def test_a_run_has_the_same_numbers_alone(vary: str | None) -> None:
    made = hg.campaign(step(), TRIAL, 70, vary)
    every = {one.run: one for one in made.run(jobs=1)}
    assert sorted(every) == list(range(70))
    assert [*made.run([33, 2, 69], jobs=1)] == [every[33], every[2], every[69]]


def test_processes_give_the_same_numbers() -> None:
    made = hg.campaign(step(), TRIAL, 20, "x1=20%,noise=50%")
    assert {one.run: one for one in made.run(jobs=2)} == {one.run: one for one in made.run(jobs=1)}


@pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")
@pytest.mark.parametrize(("vary", "batches"), [(None, [0, 7, 2]), ("noise=50%", [0, 9]), ("x1=20%,a=10%", [0, 8, 1])])
def test_a_long_campaign_takes_its_records_together_with_the_same_numbers(
    vary: str | None, batches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 30 runs as many as are made at once, here 7 and then 2, or go out together; the step takes late samples and
    shows its theta."""
    theta = hg.theta.adaptive(2, mu=(0.1, 0.2), innovation=hg.innovation.staggered(0.2, predictors=2))
    observer = hg.observers.riccati(hg.forms.triangular(PLANT), Q=[0.1, 0.1], R=0.1, theta=theta)
    made, records = hg.sample(hg.delayed(observer, y=3), dt=0.02), list[int]()

    def counted(self: Any, u: Any, y: Any, run_many: Any = CallableStep.run_many, **options: Any) -> Any:
        records.append(len(y))
        return run_many(self, u, y, **options)

    monkeypatch.setattr(CallableStep, "run_many", counted)
    trial = replace(TRIAL, estimate={"x1": 0.5, "x2": 1.0})
    alone = [results_line(one) for one in hg.campaign(made, trial, 30, vary).run(range(9), jobs=1)]
    assert records == []
    monkeypatch.setattr(trial_module, "_TOGETHER", 7 * 101)
    monkeypatch.setattr(campaign_module, "FEWEST_SAMPLES", 30 * 101)
    together = [results_line(one) for one in hg.campaign(made, trial, 30, vary).run(range(9), jobs=1)]
    assert together == alone
    assert records == batches


def test_noise_of_many_seeds_together_has_the_bits_of_each_alone() -> None:
    """Lists for few columns, rows of an array for many."""
    times = np.arange(50) * 0.1
    for noise in (OrnsteinUhlenbeck(0.3, 0.7), OrnsteinUhlenbeck(0.3), Sine(0.2, 3.0)):
        together = noise.at(times, [np.random.default_rng(seed) for seed in range(40)])
        alone = [noise.at(times, [np.random.default_rng(seed)])[:, 0] for seed in range(40)]
        assert (together == np.column_stack(alone)).all()


@pytest.mark.full
def test_a_plant_that_escapes_is_said_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """x' = a x^2 from 1: for a = 1 it is gone at 1. It keeps its place among runs that are taken together."""
    x, a, y = hg.Signal("x", low=-9, high=9), hg.Signal("a", nominal=0.1, low=0.1, high=3), hg.Signal("y")
    system = hg.System("escapes", states=(x,), outputs=(y,), parameters=(a,), flow=(a * x**2,), output=(x,))
    observer = hg.observers.riccati(hg.forms.original(system), Q=(1,), R=0.1)
    trial = Trial("late", 1.0, {"x": 1.0})
    outcomes = list(hg.campaign(hg.sample(observer, dt=0.01), trial, 12, "a").run(jobs=1))
    gone = [one for one in outcomes if one.metrics is None]
    assert {one.run for one in gone} == {one.run for one in outcomes if one.varied["a"] > 1.0}
    assert gone
    assert all("cannot be integrated" in one.failed for one in gone)
    assert spreads(outcomes)[0].run not in {one.run for one in gone}
    assert spreads(gone) == []
    monkeypatch.setattr(campaign_module, "FEWEST_SAMPLES", 1)
    assert list(hg.campaign(hg.sample(observer, dt=0.01), trial, 12, "a").run(jobs=1)) == outcomes


@pytest.mark.parametrize(("runs", "seed"), [(0, 0), (-1, 0), (1.5, 0), (NAN, 0), (math.inf, 0), (True, 0), (3, -1)])
def test_a_number_of_runs_that_is_none_is_refused(runs: Any, seed: Any) -> None:
    with pytest.raises(BadGain, match="must be a whole number, from"):
        hg.campaign(step(), TRIAL, runs, seed=seed)


@pytest.mark.parametrize("bad", [{"numbers": [3]}, {"numbers": [-1]}, {"numbers": [1.5]}, {"jobs": 0}, {"jobs": 2.5}])
def test_numbers_of_runs_and_of_jobs_that_are_none_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(BadGain, match="must be a whole number, from"):
        list(hg.campaign(step(), TRIAL, 3).run(**bad))


@pytest.mark.parametrize("asked", [["x1"], {1: 2}, 3])
def test_what_names_nothing_is_refused(asked: Any) -> None:
    with pytest.raises(BadVariation, match="is no text and no mapping by name"):
        hg.campaign(step(), TRIAL, 3, asked)


@pytest.mark.full
def test_a_campaign_without_any_truth_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "gone.toml").write_text(
        'name = "gone"\nstates.x = {low = -9, high = 9, flow = "a*x**2"}\nparameters.a = {value = 2}\n'
        'outputs.y = {equation = "x"}\nobserver = {kind = "riccati", form = "original", Q = [1], R = 0.1, dt = 0.01}\n'
        "trial = {duration = 1, start = {x = 1}}\n"
    )
    done = hgogen(tmp_path, "simulate", "gone.toml", "--runs", "3", "--vary", "a=1.5..2.5", "--jobs", "1")
    assert done.exit_code == 2
    assert "3 of 3 runs without a truth" in done.stderr
    assert "leaves no run whose plant can be integrated; vary less, or shorten the trial" in done.stderr


def test_a_trial_that_does_not_fit_is_refused_before_any_process() -> None:
    with pytest.raises(BadTrial, match="says nothing of 'u'"):
        list(hg.campaign(step(), Trial("t", 1.0, TRIAL.start), 5).run(jobs=2))


@pytest.mark.skipif(native.compiler() is None, reason="the plant of many records is compiled")
@pytest.mark.parametrize("jump", [None, 0.505])
def test_many_truths_are_those_of_cvodes(jump: float | None) -> None:
    """Each as far from the truth as CVODES leaves it, some 1e-10 of the peak; a jump lies between samples."""
    jumps = () if jump is None else (Jump(jump, "x2", 1.5),)
    trial = Trial("swing", 2.0, TRIAL.start, {"u": sp.sin(3 * t) / 2}, jumps=jumps)
    free = PLANT.parameters[:1]
    one, many = (Plant(PLANT, trial, 0.01, free, quickly) for quickly in (False, True))
    for x1, a in ((1.0, 2.0), (-3.0, 1.2)):
        start = {"x1": x1, "x2": 0.3}
        wanted, made = one.truth(start, [a]), many.truth(start, [a])
        assert np.abs(made.x - wanted.x).max() <= 1e-9 * np.abs(wanted.x).max()
        assert (made.x != wanted.x).any()


def test_many_truths_of_a_stiff_plant_are_left_to_cvodes() -> None:
    """x' = -1e6 (x - sin t), of which steps of 0.01 by any explicit method grow."""
    x = hg.Signal("x", low=-2, high=2)
    u = hg.Signal("u", low=-1, high=1)
    plant = hg.System(
        "stiff", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=(10**6 * (u - x),), output=(x,)
    )
    trial = Trial("rest", 1.0, {"x": 0.5}, {"u": sp.sin(t)})
    one, many = (Plant(plant, trial, 0.01, (), quickly).truth(trial.start) for quickly in (False, True))
    assert (one.x == many.x).all()
    assert one.x[-1, 0] == pytest.approx(math.sin(1.0), abs=2e-6)


@pytest.mark.skipif(native.compiler() is None, reason="the plant of many records is compiled")
def test_an_error_that_is_too_large_is_seen() -> None:
    """Of x' = x cos(40 t) over steps of 0.2; over steps of 0.002 the solution exp(sin(40 t)/40) is there."""
    x, time = ca.SX.sym("x"), ca.SX.sym("t")
    ode = {"x": x, "t": time, "p": ca.SX(0, 1), "ode": x * ca.cos(40 * time)}
    assert Extrapolation(ode, list(np.linspace(0, 2, 11)))(np.ones(1), np.zeros(0)) is None
    times = np.linspace(0, 2, 1001)
    states = Extrapolation(ode, list(times))(np.ones(1), np.zeros(0))
    assert states is not None
    assert states[:, 0] == pytest.approx(np.exp(np.sin(40 * times[1:]) / 40), abs=1e-12)


# --- a cluster --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cluster_gives_the_same_numbers() -> None:
    distributed = pytest.importorskip("distributed")
    made = hg.campaign(step(), TRIAL, 20, "x1=20%")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        outcomes = {one.run: one for one in made.run(scheduler=cluster.scheduler_address)}
    assert outcomes == {one.run: one for one in made.run(jobs=1)}


@pytest.mark.ordinary("nowhere")
@pytest.mark.parametrize("address", ["nowhere", "tcp://127.0.0.1:1"])
def test_a_scheduler_that_does_not_answer_is_said(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("hgogen.run.campaign.TIMEOUT", "1s")
    with pytest.raises(NoScheduler, match=f"scheduler {address} does not answer"):
        list(hg.campaign(step(), TRIAL, 2).run(scheduler=address))


def test_without_the_package_of_the_cluster_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(NotInstalled, match=r'pip install "hgogen\[cluster\]"'):
        list(hg.campaign(step(), TRIAL, 2).run(scheduler="tcp://127.0.0.1:1"))


# --- results in a file ------------------------------------------------------------------------------------------


@cache
def campaign_of_three() -> Campaign:
    return hg.campaign(step(), TRIAL, 3, "x1=20%")


def test_an_outcome_is_read_as_it_was_written() -> None:
    each = campaign_of_three()
    for one in each.run(jobs=1):
        assert outcome(each, results_line(one)) == one
    lost = Outcome(2, each.draws.named(2), None, "it escaped")
    assert outcome(each, results_line(lost)) == lost
    assert one.metrics
    escaped = replace(one, metrics=replace(one.metrics, rms={"x1": INF, "x2": INF}))
    assert outcome(each, results_line(escaped)) == escaped


def test_a_file_of_another_campaign_is_refused() -> None:
    first, second = hg.campaign(step(), TRIAL, 3, "x1=20%"), hg.campaign(step(), TRIAL, 3, "x1=21%")
    assert list(stored_outcomes(first, [results_head(first)], "file")) == []
    for text in (results_head(second), "something else\n", "\n"):
        with pytest.raises(BadCampaign, match="file holds the results of another campaign"):
            list(stored_outcomes(first, [text], "file"))


def test_the_digest_is_of_what_the_numbers_depend_on() -> None:
    made = step()
    tuned = step()
    tuned.tune(theta=4.0)
    changed = [
        hg.campaign(made, TRIAL, 3),
        hg.campaign(made, TRIAL, 3, "x1=1%"),
        hg.campaign(made, TRIAL, 4, "x1=1%"),
        hg.campaign(made, TRIAL, 3, "x1=1%", seed=1),
        hg.campaign(made, Trial("let_go", 2.5, TRIAL.start, TRIAL.inputs), 3),
        hg.campaign(made.rebuilt(dt=0.02), TRIAL, 3),
        hg.campaign(made.rebuilt(real="float"), TRIAL, 3),
        hg.campaign(tuned, TRIAL, 3),
    ]
    assert len({one.digest for one in changed}) == len(changed)
    again = step()
    again.run(u=np.zeros(5), y=np.ones(5))
    assert hg.campaign(again, TRIAL, 9).digest == changed[0].digest


def test_lines_are_added_to_whole_ones(tmp_path: Path) -> None:
    for known, new in (("", "a\n"), ("a\n", "b\n"), ("a\nb\n", "c")):
        with lines_of("lines", tmp_path / "made") as (lines, add):
            assert "".join(lines) == known
            add(new)
    with lines_of("lines", tmp_path / "made") as (lines, add):
        assert list(lines) == ["a\n", "b\n"]
        add("d\n")
    assert (tmp_path / "made" / "lines").read_text() == "a\nb\nd\n"


def test_what_is_no_file_of_lines_stays_as_it_is_until_one_is_added(tmp_path: Path) -> None:
    (tmp_path / "lines").write_bytes(b"\xff\xfe\nunfinished")
    with lines_of("lines", tmp_path) as (lines, _):
        assert list(lines) == ["\ufffd\ufffd\n"]
    assert (tmp_path / "lines").read_bytes() == b"\xff\xfe\nunfinished"
    with lines_of("lines", tmp_path) as (_, add):
        add("a\n")
    assert (tmp_path / "lines").read_bytes() == b"\xff\xfe\na\n"


def test_a_line_longer_than_what_is_read_at_once_is_whole(tmp_path: Path) -> None:
    long = "x" * 200_000 + "\n"
    (tmp_path / "lines").write_text(long + "y" * 100_000)
    with lines_of("lines", tmp_path) as (lines, _):
        assert list(lines) == [long]


def test_two_do_not_add_lines_to_one_file(tmp_path: Path) -> None:
    with lines_of("lines", tmp_path) as (_, add):
        add("a\n")
        with pytest.raises(CannotWrite, match="another process is writing it; wait until"):
            lines_of("lines", tmp_path).__enter__()
        add("b\n")
    with lines_of("lines", tmp_path) as (lines, _):
        assert list(lines) == ["a\n", "b\n"]


FORGED: dict[str, Any] = {
    "run": (-1, 3, 10**30, True, 1.0, "1", None, [1]),
    "varied": ({}, {"x1": 0.5}, [], None),
    "failed": ("it escaped", None, 1),
    "metrics": (None, 1, [], {}),
    "metrics.seed": (0, None),
    "metrics.engine": ("\x1b[2J", 1),
    "metrics.clamped": (-1, 10**9, 0.5, None),
    "metrics.rms": ({}, {"x1": 0.1}, {"x1": 0.1, "x3": 0.1}, [0.1, 0.1], 0.1),
    "metrics.rms.x1": (-1.0, "0", None, 10**400, -INF),
    "metrics.responses": ([], 1, [3], [{}], None, {}),
    "metrics.responses.0": ([], {"time": 0.0}),
    "metrics.responses.0.time": (0.5, NAN, None),
    "metrics.responses.0.settled": (-1.0, 1e9, NAN, INF, "never", [1.0]),
    "metrics.responses.0.peak": ("x", {}),
    "metrics.responses.0.theta_settled": (-1.0, NAN),
    "metrics.responses.0.triggers": (-1, 0.5, 10**9),
    "metrics.responses.0.loud": (-0.1, 1.1),
    "of my own": (1,),
}


@cache
def of_run_one() -> Outcome:
    (one,) = campaign_of_three().run([1], jobs=1)
    return one


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in FORGED.items() for value in values])
def test_a_line_that_can_be_no_outcome_of_the_campaign_is_none(key: str, value: Any) -> None:
    each = campaign_of_three()
    row: Any = json.loads(results_line(of_run_one()))
    *above, last = (int(word) if word.isdigit() else word for word in key.split("."))
    inner = row
    for word in above:
        inner = inner[word]
    inner[last] = value
    assert outcome(each, json.dumps(row)) is None


@pytest.mark.parametrize("text", ["", "{", "null", "[1]", '"a"', '{"run": 3}', "[" * 100_000, "1" * 5000, "\ufffd"])
def test_a_line_that_is_no_outcome_is_none(text: str) -> None:
    assert outcome(campaign_of_three(), text) is None


@pytest.mark.parametrize("failed", ["", "\x1b[2Jall is well", 3, None])
def test_a_failure_says_why_in_printable_text(failed: Any) -> None:
    each = campaign_of_three()
    assert outcome(each, results_line(Outcome(1, each.draws.named(1), None, failed))) is None


def test_of_noise_alone_a_file_may_hold_more_runs() -> None:
    many, few = (hg.campaign(step(), TRIAL, runs) for runs in (5, 2))
    (one,) = many.run([4], jobs=1)
    lines = [results_head(many), results_line(one), "torn", results_line(one)]
    assert list(stored_outcomes(few, lines, "file")) == [one, None, one]


# --- what it says -----------------------------------------------------------------------------------------------


def ran(run: int, settled: float | None, rms: float) -> Outcome:
    return Outcome(run, {}, Metrics(run, "c", (Response(0.0, settled, None, None, None, None),), {"x": rms}, 0))


def spreads(outcomes: Iterable[Outcome], unit: str = "s") -> list[Spread]:
    tally = Tally(100, unit)
    for one in outcomes:
        tally.add(one)
    return tally.spreads()


def test_quantiles_are_values_that_runs_had_and_never_is_the_worst() -> None:
    outcomes = [ran(k, None if k == 7 else float(k), 1 / (k + 1)) for k in reversed(range(20))]
    settled, error = spreads(outcomes, "h")
    assert settled == Spread("settled after 0 h", 0.0, 10.0, 19.0, None, 7)
    assert error == Spread("steady error of x", 1 / 20, 1 / 11, 1 / 2, 1.0, 0)


def test_an_error_that_is_no_number_is_the_worst() -> None:
    assert spreads([ran(0, 1.0, 2.0), ran(1, 1.0, NAN)])[1] == Spread("steady error of x", 2.0, 2.0, None, None, 1)


def test_runs_are_told_in_any_order_and_once() -> None:
    """And take some bytes each."""
    tally = Tally(20, "h")
    for k in (7, 3, 7, 19, 0):
        tally.add(ran(k, float(k), 1.0))
    tally.add(Outcome(5, {}, None, "it escaped"))
    tally.add(Outcome(4, {}, None, "it escaped sooner"))
    assert (len(tally), tally.failed, tally.failure and tally.failure.run) == (6, 2, 4)
    assert [k for k in range(20) if k not in tally] == [1, 2, *range(6, 7), *range(8, 19)]
    assert tally.spreads()[0] == Spread("settled after 0 h", 0.0, 3.0, 19.0, 19.0, 19)
    assert tally.spreads()[1].run == 0  # of errors that are equal the first


# --- the command ------------------------------------------------------------------------------------------------


def hgogen(folder: Path, *words: str) -> Result:
    with contextlib.chdir(folder):
        return CliRunner().invoke(cli.app, list(words))


@pytest.mark.full
def test_a_campaign_that_was_stopped_goes_on(tmp_path: Path) -> None:
    """Some lines of its file, the last one broken off, then all of it again, and a run by itself."""
    words = ("simulate", str(MODELS / "pendulum.py"), "--vary", "x0=0.1", "--runs", "6", "--jobs", "1", "--json")
    folder = ("--results", "a folder")
    whole = json.loads(hgogen(tmp_path, *words).stdout)["campaigns"]
    assert json.loads(hgogen(tmp_path, *words, *folder).stdout)["campaigns"] == whole
    (file,) = (tmp_path / "a folder").iterdir()
    lines = file.read_text().splitlines(keepends=True)
    assert len(lines) == 7
    marked = lines[2].replace('"clamped": 0', '"clamped": 1')
    assert marked != lines[2]
    forged = lines[4].replace('"rms"', '"r"')
    file.write_text("".join([lines[0], marked, "torn\n", forged, lines[3][:40]]))
    again = hgogen(tmp_path, *words, *folder)
    assert json.loads(again.stdout)["campaigns"] == whole
    assert "2 lines (3, 4) hold no outcome of this campaign: left out, their runs repeated" in again.stderr
    after = file.read_text().splitlines(keepends=True)
    assert after[:4] == [lines[0], marked, "torn\n", forged]
    assert sorted(after[4:]) == sorted({*lines[1:]} - {lines[2]})
    worst = whole[0]["quantiles"][0]
    alone = json.loads(hgogen(tmp_path, *words, "--repeat", str(worst["run"])).stdout)["campaigns"][0]
    assert alone["run"]["run"] == worst["run"]
    assert alone["run"]["metrics"]["responses"][0]["settled"] == worst["worst"]
    other = hgogen(tmp_path, *words[:-1], *folder, "--draw", "3")
    assert other.exit_code == 2
    assert "holds the results of another campaign" in other.stderr
    assert file.read_text().splitlines(keepends=True) == after


@pytest.mark.full
@pytest.mark.usefixtures("interruptible")
def test_a_truth_is_ended_by_ctrl_c_and_not_taken_for_a_failure() -> None:
    """CasADi takes what a handler raises for a plant that cannot be integrated."""
    long = Trial("long", 2000.0, {"x1": 1.0, "x2": 0.0}, {"u": sp.sin(t)})
    each = Plant(PLANT, long, 0.01)
    each.truth(long.start)
    timer = threading.Timer(0.3, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()

    def again() -> None:
        for _ in range(200):
            each.truth(long.start)

    with pytest.raises(KeyboardInterrupt):
        again()
    timer.join()


@pytest.mark.full
def test_observers_are_compared_on_the_same_draws(tmp_path: Path) -> None:
    words = ("compare", str(MODELS / "pendulum.py"), "--observers", "high_gain,riccati", "--vary", "x0=0.1,noise=50%")
    done = hgogen(tmp_path, *words, "--runs", "4", "--jobs", "1")
    assert done.exit_code == 0, done.stderr
    assert "high_gain, trial knock, 4 runs" in done.stdout
    assert "riccati, trial knock, 4 runs" in done.stdout
    assert not (tmp_path / "build").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--vary", "x9"), "vary 'x9'"),
        (("--vary", ""), "write NAME"),
        (("--runs", "0"), "runs = 0 must be a whole number, from 1"),
        (("--runs", "3", "--repeat", "3"), "the runs are numbered from 0 to 2"),
        (("--runs", "3", "--seeds", "2"), "run k of a campaign has the noise of seed k; give --runs"),
    ],
)
def test_bad_options_are_sentences(tmp_path: Path, options: tuple[str, ...], sentence: str) -> None:
    done = hgogen(tmp_path, "simulate", str(MODELS / "pendulum.py"), *options)
    assert done.exit_code == 2
    assert sentence in " ".join(done.stderr.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


@pytest.mark.full
def test_the_neuron_is_sent_to_processes() -> None:
    """A step of a model's file, whose theta adapts and whose trial has jumps and an estimate."""
    model = load(MODELS / "fitzhugh_nagumo.py")
    made = hg.campaign(model.step(), model.trials()[0], 4)
    assert {one.run: one for one in made.run(jobs=2)} == {one.run: one for one in made.run(jobs=1)}


def test_the_worst_run_is_named_by_its_number() -> None:
    assert campaign_module._spread_of("late", np.array([1.0, np.inf, 2.0]), np.array([4, 7, 9])).run == 7


def test_an_interval_may_leave_its_range_at_neither_end() -> None:
    share = hg.Signal("share", low=0, high=1)
    for width in ("-0.1..0.9", "0.1..1.1"):
        with pytest.raises(BadVariation, match="leaves its range"):
            campaign_module._interval(share, width, 0.5)


def test_a_share_of_a_negative_value_is_as_wide_as_of_a_positive_one() -> None:
    assert campaign_module._read("a", "50%", -2.0) == (-3.0, -1.0)


def test_free_parameters_have_their_values_in_their_order() -> None:
    x, p, q = hg.Signal("x"), hg.Signal("p", "", "", 0.0), hg.Signal("q", "", "", 0.0)
    plant = hg.System("ramp", states=(x,), outputs=(hg.Signal("y"),), parameters=(p, q), flow=(p + 3 * q,), output=(x,))
    truth = trial_module.Plant(plant, Trial("ramp", duration=1.0, start={"x": 0.0}, inputs={}), 0.5, (p, q))
    assert truth.truth({"x": 0.0}, [1.0, 2.0]).x[-1, 0] == pytest.approx(7.0, abs=1e-9)


def test_an_error_in_the_middle_is_seen_behind_fine_steps() -> None:
    """One step of 0.2 between steps of 0.002, of x' = x cos(40 t)."""
    x, time = ca.SX.sym("x"), ca.SX.sym("t")
    ode = {"x": x, "t": time, "p": ca.SX(0, 1), "ode": x * ca.cos(40 * time)}
    times = [*np.linspace(0, 0.2, 101), *np.linspace(0.4, 0.6, 101)]
    assert Extrapolation(ode, times)(np.ones(1), np.zeros(0)) is None


def test_the_peak_of_a_run_is_the_largest_after_any_event() -> None:
    events = tuple(Response(time, 0.1, peak, 0.0, 0, 0.0) for time, peak in ((0.0, 2.0), (1.0, 3.0), (2.0, 1.0)))
    (peak,) = (one for one in spreads([Outcome(0, {}, Metrics(0, "c", events, {}, 0))]) if one.name == "peak of theta")
    assert peak.worst == 3.0


def test_noise_that_varies_alone_has_the_size_of_its_draw() -> None:
    made = step()
    each = hg.campaign(made, TRIAL, 3, "noise=0.1..10")
    for one in each.run(jobs=1):
        noise = {"y": OrnsteinUhlenbeck(0.01 * one.varied["noise"], 0.05)}
        (wanted,) = try_out(made, Trial("let_go", 2.0, TRIAL.start, TRIAL.inputs, noise), seeds=[one.run])
        assert one.metrics == metrics(made, wanted)
