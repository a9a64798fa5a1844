"""How well a state is known: bounds against runs that search the worst, their shares, and forged numbers."""

import copy
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import enlarged, sealed
from hypothesis import given
from hypothesis import strategies as st
from plants import MODELS, model, two_outputs
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.check import Verdict
from hgogen.commands.claims import checked
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau
from hgogen.model import MissingPart, load
from hgogen.program import Place
from hgogen.prove.method_error import StageDeviation
from hgogen.prove.plant_step import PlantStep, Unbounded
from hgogen.reading.given import BadGain, BadNames
from hgogen.recheck.rules.discrete_time import _root
from hgogen.recheck.verification import recheck
from hgogen.run.comparison import bounded_errors
from hgogen.run.figures import errors
from hgogen.stepping.machine import Machine

FIVE = (
    "high_gain",
    "filtered",
    *(pytest.param(each, marks=pytest.mark.slow) for each in ("filtered_injection", "low_power", "peaking_free")),
)
A, B = 19.6, 0.1  # of the pendulum
INPUTS: dict[str, Mapping[str, float]] = {
    "noise": {"y": 2e-3},
    "rounded": {"y": 1e-3},
    "late": {"y": 1e-4},
    "disturbance": {"w": 0.5},
    "parameters": {"a": 0.1},
    "rates": {"tau": 5},
}
Content = dict[str, Any]


@cache
def step_of(observer: str = "high_gain", dt: float = 0.01, method: str = "rk4", **options: Any) -> hg.Step:
    gains = load(MODELS / "pendulum.py").module.tuning[observer]
    form = hg.forms.triangular(model("pendulum"))
    return hg.sample(getattr(hg.observers, observer)(form, **gains), getattr(hg.methods, method), dt=dt, **options)


@cache
def bounded(observer: str = "high_gain", dt: float = 0.01, method: str = "rk4") -> hg.ErrorBound:
    known = hg.error_bound(step_of(observer, dt, method), **INPUTS)
    assert known.check.verdict is Verdict.PROVED, known
    return known


@pytest.mark.full
@pytest.mark.parametrize("method", ["rk4", pytest.param("euler", marks=pytest.mark.slow)])
@pytest.mark.parametrize("observer", FIVE)
def test_no_run_errs_further(observer: str, method: str) -> None:
    """Of the program in doubles, beside a plant with another a; noise, late samples and disturbances push by the sign
    of the error, against it, and by that of the swing."""
    known = bounded(observer, 0.01, method)
    assert known.settles is not None
    step, first = step_of(observer, 0.01, method), round(known.settles / 0.01)
    reached, bounds = np.zeros(2), np.array(list(known.bounds.values()))
    for push in (1, -1):
        for follow in ("error", "swing", "at rest"):
            errors = np.abs(run(step, first + 300, push, follow))[first:]
            assert (errors <= 1.1 * bounds).all()
            reached = np.maximum(reached, errors.max(axis=0))
    method = np.array([known.shares["method"][name] for name in known.bounds])  # of a plant anywhere in its ranges
    assert (reached > 0.15 * (bounds - method)).all()


def run(step: hg.Step, calls: int, push: int, follow: str) -> np.ndarray:
    """The errors (N, 2) beside a pendulum that swings from 1.5, or rests, the estimate from its own start."""
    machine, errors = Machine(step), np.zeros((calls, 2))
    truth = np.array([0.0 if follow == "at rest" else 1.5, 0.0])
    error = -truth
    for k in range(calls):
        sign = push * np.sign((truth if follow == "swing" else error)[1]) or 1.0
        sample = truth[0] + 1e-4 * truth[1] * sign + 2e-3 * sign
        machine.memory[Place("output", "y")][0] = np.round(sample / 1e-3) * 1e-3
        machine.call()
        errors[k] = error = np.array([machine.memory[Place("estimate", name)][0] for name in ("q", "w")]) - truth
        truth = swing(truth, step.dt, A + 0.1 * push, 0.5 * sign)
    return errors


def swing(x: np.ndarray, h: float, a: float, d: float) -> np.ndarray:
    """The pendulum after h, with a disturbance of its rate's rate; by steps of a tenth."""

    def flow(x: np.ndarray) -> np.ndarray:
        return np.array([x[1], -a * np.sin(x[0]) - B * x[1] + d])

    for _ in range(10):
        k1 = flow(x)
        k2 = flow(x + h / 20 * k1)
        k3 = flow(x + h / 20 * k2)
        x = x + h / 60 * (k1 + 2 * k2 + 2 * k3 + flow(x + h / 10 * k3))
    return x


def test_the_shares_add_and_that_of_noise_is_its_gain() -> None:
    known, gain = bounded(), hg.noise_gain(step_of())
    assert isinstance(gain, hg.NoiseGain)
    assert list(known.shares) == ["noise", "rounded", "late", "disturbance", "parameters", "method"]
    for state, bound in known.bounds.items():
        assert bound == pytest.approx(sum(share[state] for share in known.shares.values()))
        assert known.shares["noise"][state] == pytest.approx(2e-3 * gain.gains[state, "y"])
        assert known.shares["rounded"][state] == pytest.approx(known.shares["noise"][state] / 4)
        assert known.shares["late"][state] == pytest.approx(known.shares["noise"][state])  # 20 rad/s for .1 ms


def test_what_is_not_given_has_no_share() -> None:
    known = hg.error_bound(step_of("high_gain", 0.01, "rk4", between="hold"))
    assert list(known.shares) == ["method"]
    assert known.bounds == known.shares["method"]
    assert known.bounds["w"] < 0.05


def test_the_multiple_leaves_room_for_what_inputs_do() -> None:
    start, known = hg.start_set(step_of()), bounded()
    assert isinstance(start, hg.StartSet)
    assert known.multiple is not None
    assert known.multiple < start.multiple
    much = hg.error_bound(wild(), noise={"y": 10})
    assert much.check.verdict is Verdict.PROVED
    assert much.settles is much.multiple is None


LOUD = "what enters may move the estimate of q to its limits; state less of it, or lower the gains"
VAST = "the limits of the estimate do not hold the ranges with room around"


def wild() -> hg.Step:
    """Of a pendulum that may turn fast: what moves q by more than its range is known of w."""
    q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-500, high=500)
    plant = hg.System("wild", states=(q, w), outputs=(hg.Signal("y"),), flow=[w, -19.6 * sp.sin(q)], output=[q])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=0.001)


def vast() -> hg.Step:
    """Of ranges that end where a state is lost."""
    x = [hg.Signal(name, low=-1e30, high=1e30) for name in ("x1", "x2")]
    plant = hg.System("vast", states=x, outputs=(hg.Signal("y"),), flow=[x[1], -x[0] - x[1]], output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=[-1, -1])
    return hg.sample(observer, hg.methods.rk4, dt=0.01)


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("step", "why"), [(wild, LOUD), (vast, VAST)])
def test_where_no_time_is_proved_every_answer_says_why(step: Callable[[], hg.Step], why: str) -> None:
    noise = {"y": 10}
    known = hg.error_bound(step(), noise=noise)
    assert known.check.verdict is Verdict.PROVED
    assert known.settles is known.multiple is None
    assert str(known.missing) == f"no time is proved from which on the bounds of the errors hold: {why}"
    assert f"the start has decayed, for which no time is proved: {why}" in str(known)
    header = " ".join(hg.targets.c99(hg.signed(step(), noise=noise), check=False)[f"{step().name}.h"].split())
    assert f"no time is proved: {why}" in header.replace(" * ", " ")
    rounded = hg.error_bound(step(), noise=noise, real="double")
    assert str(rounded.check.reason) == f"how much is rounded is not known: {why}"


def test_of_what_is_known_nothing_is_missing() -> None:
    assert not bounded().missing
    assert str(hg.error_bound(step_of()).missing).startswith("no bound of the errors is proved: how fast tau moves")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"noise": {"z": 1}}, "noise names 'z'"),
        ({"noise": {"y": -1}}, "noise of y = -1 must be a finite number, not negative"),
        ({"disturbance": {"w": float("inf")}}, "disturbance of w = inf must be"),
        ({"late": {"y": float("nan")}}, "late of y = nan must be"),
        ({"rates": {"tau": -5}}, "rates of tau = -5 must be"),
    ],
)
def test_what_is_no_size_is_refused(arguments: Any, said: str) -> None:
    with pytest.raises((BadGain, BadNames)) as error:
        hg.error_bound(step_of(), **arguments)
    assert said in str(error.value)


def unknown(step: hg.Step, **arguments: Any) -> str:
    known = hg.error_bound(step, **arguments)
    assert known.check.verdict is Verdict.UNKNOWN
    assert not known.bounds
    return str(known.check.reason)


def test_an_input_without_a_rate_asks_for_it() -> None:
    assert "how fast tau moves between samples is not known" in unknown(step_of())


def test_a_step_that_is_not_proved_has_no_bound() -> None:
    gains = load(MODELS / "hyperjerk.py").module.tuning["low_power"]
    observer = hg.observers.low_power(hg.forms.triangular(model("hyperjerk")), **gains)
    assert "no norm is found for all slopes in their ranges, db_4/dz3 in [" in unknown(
        hg.sample(observer, hg.methods.rk4, dt=1e-3)
    )


def test_a_flow_that_is_not_lipschitz_has_no_remainder() -> None:
    x = hg.Signal("x", low=-1, high=1)
    plant = hg.System("jumps", states=(x,), outputs=(hg.Signal("y"),), flow=[-x - sp.sign(x)], output=[x])
    step = PlantStep(hg.forms.triangular(plant), Fraction(1, 100), ())
    with pytest.raises(Unbounded, match="may jump with z1"):
        StageDeviation(step, RK4).remainder()


def test_a_parameter_in_the_coordinates_is_said() -> None:
    x1, x2, a = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1), hg.Signal("a", "", "", 2)
    flow, outputs = [x2, -sp.sin(x1)], (hg.Signal("y"),)
    plant = hg.System("read", states=(x1, x2), outputs=outputs, parameters=(a,), flow=flow, output=[a * x1])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=(-1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=1e-2)
    assert "the coordinates or outputs read a" in unknown(step, parameters={"a": 0.1})


# --- the plant beside a step of the method ----------------------------------------------------------------------------


def plant_step(h: float) -> PlantStep:
    return PlantStep(hg.forms.triangular(model("pendulum")), Fraction(h), (Fraction(5),))


@pytest.mark.parametrize("tableau", [EULER, HEUN, RK4], ids=lambda each: each.name)
def test_the_remainder_holds_what_a_step_leaves_and_little_more(tableau: Tableau) -> None:
    h, rng = 0.02, np.random.default_rng(0)
    plant = StageDeviation(plant_step(h), tableau)
    bounds, lines = np.array(list(map(float, plant.remainder()))), np.array(list(map(float, plant.line(0))))
    worst, off = np.zeros(2), np.zeros(len(tableau.b))
    for _ in range(300):
        x, u, rate = rng.uniform(-1, 1, 2) * [4, 20], rng.uniform(-1, 1), rng.uniform(-5, 5)

        def flow(t: float, x: np.ndarray, u: float = u, rate: float = rate) -> np.ndarray:
            return np.array([x[1], -A * np.sin(x[0]) - B * x[1] + u + rate * t])

        exact = solve_ivp(flow, (0, h), x, rtol=1e-12, atol=1e-13).y[:, -1]
        slopes, stages = list[np.ndarray](), list[np.ndarray]()
        for row, c in zip(tableau.a, tableau.c, strict=True):
            stages.append(x + h * sum((w * k for w, k in zip(row, slopes, strict=True)), np.zeros(2)))
            slopes.append(flow(c * h, stages[-1]))
        after = x + h * sum((w * k for w, k in zip(tableau.b, slopes, strict=True)), np.zeros(2))
        worst = np.maximum(worst, np.abs(exact - after) / h)
        line = [(1 - c) * x[0] + c * after[0] - stage[0] for c, stage in zip(tableau.c, stages, strict=True)]
        off = np.maximum(off, np.abs(line))
    assert (worst <= bounds * (1 + 1e-6) + 1e-9).all()
    assert (worst > bounds / 60).all()  # whose balls hold the whole box
    assert (off <= lines * (1 + 1e-9) + 1e-15).all()
    assert (off[lines > 0] > lines[lines > 0] / 8).all()


def test_a_disturbance_of_any_course_moves_the_plant_no_further() -> None:
    h = 0.05
    most = np.array([float(x) for x in plant_step(h).disturbed([Fraction(1, 10), Fraction(1, 2)])])
    for x in (np.array([0.0, 0.0]), np.array([3.1, 2.0]), np.array([-1.5, 10.0])):
        for signs in ((1, 1), (-1, 1)):
            d = np.array(signs) * [0.1, 0.5]
            moved = [
                solve_ivp(
                    lambda t, x, d=d: [x[1] + d[0], -A * np.sin(x[0]) - B * x[1] + d[1]], (0, h), x, rtol=1e-10
                ).y[:, -1]
                for d in (d, 0 * d)
            ]
            assert (np.abs(moved[0] - moved[1]) / h <= most).all()
    assert most == pytest.approx([0.1, 0.5], rel=0.2)


# --- verified again ---------------------------------------------------------------------------------------------------


@cache
def certified(observer: str) -> Content:
    step = step_of(observer)
    return hg.certificate(step.observer.form, (*step.observer.checks, bounded(observer).check), observer)


def verdict(content: Content) -> str:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".error"))
    return row.found


@pytest.mark.parametrize("observer", FIVE)
def test_the_bounds_are_verified_again(observer: str) -> None:
    assert verdict(certified(observer)) == "verified"


@pytest.mark.slow
def test_bounds_of_several_outputs_are_verified_again() -> None:
    observer = hg.observers.high_gain(hg.forms.block_triangular(two_outputs()), theta=6, poles=((-1, -1), (-1,)))
    step = hg.sample(observer, hg.methods.rk4, dt=1e-2, between="hold")
    known = hg.error_bound(step, noise={"y1": 0.01, "y2": 0.02}, disturbance={"x2": 0.1, "x3": 0.1})
    assert known.check.verdict is Verdict.PROVED, known
    assert verdict(hg.certificate(observer.form, (*observer.checks, known.check), "high_gain")) == "verified"


def put(*path: Any, value: Any) -> Callable[[Any], None]:
    def change(evidence: Any) -> None:
        *inner, last = path
        for key in inner:
            evidence = evidence[key]
        evidence[last] = value(evidence[last]) if callable(value) else value

    return change


def times(factor: str) -> Callable[[str], str]:
    return lambda text: str(Fraction(text) * Fraction(factor))


LIES: dict[str, Callable[[Any], None]] = {
    "more noise": put("shares", 0, "samples", 0, value=times("11/10")),
    "noise below zero": put("shares", 0, "samples", 0, value="-1"),
    "more disturbance": put("shares", 3, "beside", 1, value=times("11/10")),
    "a larger line": put("shares", 5, "stages", 0, 3, value=times("3/2")),
    "a larger remainder": put("shares", 5, "beside", 1, value=times("1000")),
    "less than the flow and the step leave together": put("shares", 5, "beside", 1, value=times("9/10")),
    "a smaller line": put("shares", 5, "stages", 0, 3, value=times("9/10")),
    "a smaller bound": put("shares", 0, "bounds", 0, "bound", value=times("9/10")),
    "a bound below zero": put("shares", 0, "bounds", 0, "bound", value=times("-1")),
    "another unit": put("shares", 0, "unit", value=times("1/2")),
    "a unit of 0": put("shares", 0, "unit", value="0"),
    "another field": put("shares", 0, "bounds", 0, "field", value="2"),
    "a field less": put("shares", 0, "bounds", value=lambda bounds: bounds[:1]),
    "a field twice": put("shares", 0, "bounds", value=lambda bounds: [*bounds, bounds[0]]),
    "no shares": put("shares", value=[]),
    "no inputs": put("shares", 0, "samples", value=[]),
    "more alpha": put("shares", 0, "bounds", 0, "alpha", value=times("2")),
    "no lambda": put("shares", 0, "bounds", 0, "S", -1, value="0"),
    "more lambda": put("shares", 0, "bounds", 0, "S", -1, value=times("1000")),
    "another P": put("shares", 0, "bounds", 0, "P", value=lambda P: [[times("2")(x) for x in row] for row in P]),
    "another dt": put("dt", value="1/5"),
    "another method": put("method", value="Heun"),
    "inputs of no kind": put("shares", 0, "inputs", value="nothing"),
    "a share twice": put("shares", value=lambda shares: [*shares, shares[0]]),
    "samples that are no list": put("shares", 3, "samples", value=False),
    "less noise than is said": put("shares", 0, "samples", 0, value=times("9/10")),
    "a smaller step than is said": put("shares", 1, "samples", 0, value=times("9/10")),
    "more noise said": put("shares", 0, "follows", "sizes", 0, value=times("11/10")),
    "larger steps said": put("shares", 1, "follows", "sizes", 0, value=times("11/10")),
    "later samples said": put("shares", 2, "follows", "sizes", 0, value=times("11/10")),
    "samples before their time": put("shares", 2, "follows", "sizes", 0, value=times("-1")),
    "a slower output": put("shares", 2, "follows", "speeds", 0, value=times("9/10")),
    "more disturbance said": put("shares", 3, "follows", "sizes", 1, value=times("101/100")),
    "a disturbance of another row said": put("shares", 3, "follows", "sizes", 0, value="1/10"),
    "a flatter change of coordinates": put("shares", 3, "follows", "rows", 1, 1, value=times("9/10")),
    "a flatter plant": put("shares", 3, "follows", "steepness", 1, 0, value=times("9/10")),
    "a steepness below zero": put("shares", 3, "follows", "steepness", 1, 0, value=times("-1")),
    "other parameters said": put("shares", 4, "follows", "sizes", 0, value=times("11/10")),
    "a parameter that does less": put("shares", 4, "follows", "rows", 1, 0, value=times("9/10")),
    "noise of nothing": put("shares", 0, "follows", value={}),
    "disturbance of nothing": put("shares", 3, "follows", value={}),
    "a method of something": put("shares", 5, "follows", value={"sizes": ["1"]}),
    "follows no object": put("shares", 0, "follows", value=[]),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("observer", ["high_gain", pytest.param("filtered", marks=pytest.mark.slow)])
def test_a_forged_number_fails(observer: str, lie: str) -> None:
    content = copy.deepcopy(certified(observer))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    LIES[lie](claim["evidence"])
    assert verdict(content) == "fails"


@pytest.mark.parametrize(("most", "found_again"), [(sum, "verified"), (max, "fails")])
def test_the_multipliers_of_all_inputs_of_a_share_are_within_alpha_together(most: Any, found_again: str) -> None:
    """Each of them alone is not enough, in none of the shares of several inputs."""
    content = copy.deepcopy(certified("high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    noise = claim["evidence"]["shares"][0]
    assert noise["inputs"] == "noise"
    noise["bounds"][0] = enlarged(noise["bounds"][0], 2, most)
    assert verdict(content) == found_again


@given(st.fractions(0, 10**6))
def test_a_root_of_the_verifier_is_at_least_the_root_and_hardly_above(value: Fraction) -> None:
    root = _root(value)
    assert value < root**2
    assert root**2 <= value + Fraction(3 * 10**3, 2**199)


def test_what_is_verified_says_how_large_the_inputs_are() -> None:
    content = copy.deepcopy(certified("high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".error"))
    put("shares", 0, "samples", 0, value="1/1000000")(claim["evidence"])
    put("shares", 0, "follows", "sizes", 0, value="1/1000000")(claim["evidence"])
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".error"))
    assert row.found == "verified"
    assert "noise of 1/1000000; rounded of 0.00100000; late of 0.000100000; disturbance of 1/2;" in row.sentence
    assert "what the method leaves as tau moves at up to 5 move z1 by" in row.sentence
    total = float(row.sentence.partition("move z1 by at most ")[2].partition(",")[0])
    assert total == pytest.approx(bounded("high_gain").bounds["q"], rel=1e-5)  # of all the shares


# --- from a model's file ----------------------------------------------------------------------------------------------

BOUNDS = "\n[bounds]\nnoise = {y = 1e-3}\ndisturbance = {w = 0.2}\n"


def plain(tmp_path: Path, bounds: str) -> Path:
    file = tmp_path / "pendulum.toml"
    signals = "[states.q]\nflow = 'w'\nlow = -4\nhigh = 4\n[states.w]\nflow = '-19.6*sin(q)'\nlow = -20\nhigh = 20\n"
    observer = "[observer]\nkind = 'high_gain'\ntheta = 20\npoles = [-1, -1]\ndt = 1e-3\n"
    file.write_text(f"name = 'pendulum'\n{signals}[outputs.y]\nequation = 'q'\n{observer}{bounds}")
    return file


def test_a_model_says_how_large_its_inputs_are(tmp_path: Path) -> None:
    (row,) = (check for check in checked(load(plain(tmp_path, BOUNDS))).checks if check.id == "high_gain.error")
    assert row.verdict is Verdict.PROVED
    assert {"noise", "disturbance"} <= {str(part) for part in shares(row)}
    ids = [str(check.id) for check in checked(load(plain(tmp_path, ""))).checks]
    assert "high_gain.error" not in ids
    assert "high_gain.start" in ids


@pytest.mark.parametrize("asked", [True, False])
def test_a_model_asks_for_gains_in_continuous_time(tmp_path: Path, asked: bool) -> None:
    model = load(plain(tmp_path, f"{BOUNDS}gains = {str(asked).lower()}\n"))
    rows = {str(check.id): check for check in checked(model).checks}
    assert "high_gain.error" in rows
    sizes = {"noise": {"y": 1e-3}, "disturbance": {"w": 0.2}}
    wanted = [hg.l2_gain(model.step().observer, **sizes), hg.iss_gain(model.step().observer, **sizes)]
    for one in wanted:
        assert one.check.verdict is Verdict.PROVED
        assert (str(rows.get(str(one.check.id))) == str(one.check)) is asked


def test_gains_of_an_observer_without_a_proof_say_why(tmp_path: Path) -> None:
    file = plain(tmp_path, f"{BOUNDS}gains = true\n")
    file.write_text(
        file.read_text().replace(
            "kind = 'high_gain'\ntheta = 20\npoles = [-1, -1]", "kind = 'riccati'\nQ = [1, 1]\nR = 1"
        )
    )
    rows = {str(check.id): check for check in checked(load(file)).checks}
    for fact in ("error", "l2_gain", "iss_gain"):
        assert rows[f"riccati.{fact}"].verdict is Verdict.UNKNOWN


def shares(check: hg.Check) -> list[str]:
    """The names of the shares in a reason."""
    parts = check.reason.part("parts")[0].part("each")[0].part("of")
    return [part.part("what") for part in parts]


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ("[bounds]\nnois = {y = 1}\n", "in bounds, nois = {'y': 1} is none; make it a mapping from some of noise,"),
        ("[bounds]\nnoise = 1\n", "in bounds, noise = 1 is none"),
        ("[bounds]\ngains = 1\n", "in bounds, gains = 1 is none"),
        ("[bounds]\nnoise = {z = 1}\n", "in bounds, noise names 'z'"),
        ("[bounds]\nnoise = {y = -1}\n", "in bounds, noise of y = -1 must be"),
    ],
)
def test_bounds_that_are_none_are_named_with_the_file(tmp_path: Path, bounds: str, said: str) -> None:
    with pytest.raises(MissingPart) as error:
        checked(load(plain(tmp_path, bounds)))
    assert said in str(error.value)
    assert "pendulum.toml" in str(error.value)


@pytest.mark.full
def test_a_trial_is_shown_beside_what_is_proved(tmp_path: Path) -> None:
    trial = "\n[trial]\nduration = 3\nstart = {q = 1, w = 0}\nnoise = {y = 1e-4}\nseeds = 1\n"
    file = plain(tmp_path, BOUNDS + trial)
    out = json.loads(invoked("simulate", str(file), "--json"))
    rows = {row["state"]: row for row in out["trials"][0]["bounds"]}
    assert list(rows) == ["q", "w"]
    known = hg.error_bound(load(file).step(), noise={"y": 1e-3}, disturbance={"w": 0.2})
    for state, row in rows.items():
        assert row["bound"] == known.bounds[state]
        assert row["after"] == known.settles
        assert 0 < row["worst"] < 0.3 * row["bound"]
    assert "beside what is proved of them" in " ".join(invoked("simulate", str(file)).split())
    short = plain(tmp_path, BOUNDS + trial.replace("duration = 3", "duration = 0.2"))
    (one,) = json.loads(invoked("simulate", str(short), "--json"))["trials"]
    assert [row["worst"] for row in one["bounds"]] == [None, None]


def test_a_trial_without_a_time_from_which_on_bounds_hold_says_why(tmp_path: Path) -> None:
    loud = "\n[bounds]\nnoise = {y = 10}\n[trial]\nduration = 0.1\nstart = {q = 1, w = 0}\nseeds = 1\n"
    file = plain(tmp_path, loud)
    file.write_text(file.read_text().replace("low = -20\nhigh = 20", "low = -500\nhigh = 500"))
    done = CliRunner().invoke(cli.app, ["simulate", str(file), "--json"])
    assert json.loads(done.stdout)["trials"][0]["bounds"] == []
    assert f"pendulum.toml: no time is proved from which on the bounds of the errors hold: {LOUD}" in done.stderr


@pytest.mark.full
@pytest.mark.parametrize(("bounds", "drawn"), [(BOUNDS, ["once_errors", "once_states"]), ("", ["once_states"])])
def test_simulate_draws_what_build_draws(tmp_path: Path, bounds: str, drawn: list[str]) -> None:
    """The errors beside what is proved of them, where the model has bounds; nothing where no folder is named."""
    trial = "\n[trial]\nname = 'once'\nduration = 0.5\nstart = {q = 1, w = 0}\nnoise = {y = 1e-4}\nseeds = 1\n"
    file, names = plain(tmp_path, bounds + trial), sorted(f"{one}.{kind}" for one in drawn for kind in ("png", "svg"))
    assert json.loads(invoked("simulate", str(file), "--json"))["files"] == []
    files = json.loads(invoked("simulate", str(file), "-o", str(tmp_path / "drawn"), "--json"))["files"]
    assert sorted(Path(one).name for one in files) == names
    invoked("build", str(file), "-o", str(tmp_path / "built"))
    for name in names:
        assert (tmp_path / "drawn" / name).read_bytes() == (tmp_path / "built" / name).read_bytes()
    assert "once_states.svg" in invoked("simulate", str(file), "-o", str(tmp_path / "drawn"))


def test_the_worst_is_that_of_once_it_has_settled_after_each_event() -> None:
    """At an event itself the estimate has not: neither just before it settles, nor just after the next event."""
    t, error = np.arange(10) / 10, np.zeros((10, 2))
    error[[1, 5, 6], 1] = 3
    error[[2, 4, 9], 0] = -1, -2, 1
    trial: Any = SimpleNamespace(truth=SimpleNamespace(t=t), trial=SimpleNamespace(events=(0.0, 0.5)), error=error)
    known = replace(bounded(), settles=0.2)
    assert [row.worst for row in bounded_errors(step_of().states, trial, known)] == [2, 0]
    error[8, 1] = 0.5
    assert [row.worst for row in bounded_errors(step_of().states, trial, known)] == [2, 0.5]


def test_a_figure_has_a_line_where_the_bound_is() -> None:
    t = np.linspace(0, 1, 50)
    figure = errors(step_of().states, t, {"high_gain": np.ones((50, 2))}, bounds={"w": 0.25})
    lines = [[line.get_label() for line in axis.get_lines()] for axis in figure.axes]
    assert lines == [["high_gain"], ["high_gain", "proved"]]
    assert set(figure.axes[1].get_lines()[1].get_ydata()) == {0.25}


def invoked(*arguments: str) -> str:
    result = CliRunner().invoke(cli.app, list(arguments))
    assert result.exit_code == 0, result.output
    return result.stdout
