"""How far noise moves an estimate: known answers, noise that is searched for the worst, and forged bounds."""

import copy
import random
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from forger import enlarged, sealed
from plants import MODELS, model, two_outputs

import hgogen as hg
from hgogen.model import load
from hgogen.reading.given import BadGain, BadNames
from hgogen.recheck.inequality import ErrorMatrices, method_of
from hgogen.recheck.matrix import Matrix, unit
from hgogen.recheck.verification import recheck
from hgogen.stepping.machine import Machine

FIVE = (
    "high_gain",
    "filtered",
    *(pytest.param(each, marks=pytest.mark.slow) for each in ("filtered_injection", "low_power", "peaking_free")),
)


@cache
def step_of(name: str, observer: str, dt: float, method: str = "rk4") -> hg.Step:
    gains = load(MODELS / f"{name}.py").module.tuning[observer]
    made = getattr(hg.observers, observer)(hg.forms.triangular(model(name)), **gains)
    return hg.sample(made, getattr(hg.methods, method), dt=dt)


# per unit of noise what a prototype gave, which the bounds may exceed by a tenth, and the worst gain of a frozen slope
Known = dict[str, tuple[float, float]]
KNOWN: list[tuple[str, str, float, Known]] = [
    ("pendulum", "high_gain", 0.001, {"q": (1.49, 1.27), "w": (18.5, 15.5)}),
    ("pendulum", "high_gain", 0.02, {"q": (1.48, 1.27), "w": (18.4, 15.3)}),
]
JERK: Known = {"x1": (2.66, 1.82), "x2": (31.6, 23.7), "x3": (182, 135), "x4": (476, 334)}
FILTERED: Known = {"x1": (4.84, 3.02), "x2": (55.5, 35.5), "x3": (286, 178), "x4": (677, 330)}
SLOW = [("hyperjerk", "high_gain", 0.001, JERK), ("hyperjerk", "filtered", 0.01, FILTERED)]


@pytest.mark.parametrize(
    ("name", "observer", "dt", "known"), [*KNOWN, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW)]
)
def test_the_bounds_are_those_that_are_known(name: str, observer: str, dt: float, known: Known) -> None:
    gain = hg.noise_gain(step_of(name, observer, dt))
    assert isinstance(gain, hg.NoiseGain)
    assert {state for state, _ in gain.gains} == set(known)
    for state, (bound, frozen) in known.items():
        assert frozen <= gain.gains[state, "y"] <= 1.1 * bound


@pytest.mark.full
@pytest.mark.parametrize("method", ["rk4", pytest.param("euler", marks=pytest.mark.slow)])
@pytest.mark.parametrize("observer", FIVE)
def test_no_noise_moves_the_estimate_further(observer: str, method: str) -> None:
    """Of the program in doubles: one estimate is given the output of a plant at rest, the other noise as well, by the
    sign of the response to one wrong sample, and at random."""
    level, count = 0.02, 160
    step = step_of("pendulum", observer, 0.01, method)
    gain = hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    rng, push = np.random.default_rng(3), np.zeros(count)
    push[20] = level
    response = moved(step, push, 0.0)[20:]
    for k, state in enumerate(("q", "w")):
        worst = [level * np.append(np.zeros(20), np.sign(response[::-1, k]))]
        worst += [level * rng.choice([-1.0, 1.0], count) for _ in range(2)]
        reached = max(np.abs(moved(step, noise, angle)[:, k]).max() for noise in worst for angle in (0.0, 3.1))
        assert 0.3 * gain.bound(state, {"y": level}) < reached <= gain.bound(state, {"y": level}) * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bilinear", "exponential"])
@pytest.mark.parametrize("observer", ["high_gain", "filtered", "peaking_free"])
def test_no_noise_moves_it_further_by_a_realised_core(observer: str, method: str) -> None:
    test_no_noise_moves_the_estimate_further(observer, method)


def moved(step: hg.Step, noise: np.ndarray, angle: float) -> np.ndarray:
    """How far noise moves the estimate of (q, w) from that without it, at a constant angle, from the same state, which
    has come to rest there; no guard acts."""
    estimates = []
    for y in (np.full(len(noise), angle), angle + noise):
        machine = Machine(step)
        machine.record(np.zeros((400, 1)), np.full((400, 1), angle))
        x, _, status = machine.record(np.zeros((len(y), 1)), y[:, None])
        assert not {bit.name for i, bit in enumerate(step.layout.bits) if (status >> i & 1).any()} - {"OUTSIDE_BOX"}
        estimates.append(x)
    return np.asarray(estimates[1] - estimates[0])


@pytest.mark.slow
def test_a_bound_is_near_the_least_where_numbers_are_far_from_1() -> None:
    """The third state of a chain, whose P a solver took for the best when it was an eighth from it."""
    gain = hg.noise_gain(load(MODELS / "disturbed_pendulum.py").step("peaking_free"))
    assert isinstance(gain, hg.NoiseGain)
    assert gain.gains["x3", "y"] < 163


@pytest.mark.full
def test_what_next_to_nothing_of_a_norm_shows_is_bounded_too() -> None:
    """The angle, of which a norm of all states is a millionth; the current by a sensor that does not read it."""
    gain = hg.noise_gain(load(MODELS / "geared_motor.py").step("high_gain"))
    assert isinstance(gain, hg.NoiseGain)
    assert 1 <= gain.gains["phi", "y1"] < 1.4
    assert gain.gains["phi", "y2"] < 1.9
    assert gain.gains["i", "y1"] < 1e-6


@pytest.mark.slow
def test_of_several_outputs_the_shares_add() -> None:
    observer = hg.observers.high_gain(hg.forms.block_triangular(two_outputs()), theta=6, poles=((-1, -1), (-1,)))
    gain = hg.noise_gain(hg.sample(observer, hg.methods.rk4, dt=1e-3))
    assert isinstance(gain, hg.NoiseGain)
    assert set(gain.gains) == {(x, y) for x in ("x1", "x2", "x3") for y in ("y1", "y2")}
    one, other = (gain.bound("x2", {name: 0.1}) for name in ("y1", "y2"))
    assert gain.bound("x2", {"y1": 0.1, "y2": 0.1}) == pytest.approx(one + other)
    with pytest.raises(BadNames, match="y3"):
        gain.bound("x2", {"y3": 1.0})
    with pytest.raises(BadNames, match="x4"):
        gain.bound("x4", {"y1": 1.0})


@pytest.mark.parametrize("size", [-1.0, float("inf"), float("nan"), True, None])
def test_noise_of_no_size_has_no_bound(size: Any) -> None:
    gain = hg.noise_gain(step_of("pendulum", "high_gain", 1e-3))
    assert isinstance(gain, hg.NoiseGain)
    with pytest.raises(BadGain, match="noise of y = "):
        gain.bound("q", {"y": size})


@pytest.mark.full
def test_of_chains_that_end_together_the_later_head_counts_by_its_power() -> None:
    """Of a gain below 1, by which less of the noise would seem to enter than does."""
    x1, x2, x3, u = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "x3", "u"))
    outputs, flow = (hg.Signal("y1"), hg.Signal("y2")), [x2, u - x2, u - x3 / 100]
    plant = hg.System("two", states=(x1, x2, x3), inputs=(u,), outputs=outputs, flow=flow, output=[x1, x3])
    form = hg.forms.block_triangular(plant, "end")
    observer = hg.observers.high_gain(form, theta=0.5, poles=((-1, -1), (-1,)))
    step = hg.sample(observer, hg.methods.rk4, dt=0.05)
    gain, machine = hg.noise_gain(step), Machine(step)
    assert isinstance(gain, hg.NoiseGain)
    x, _, _ = machine.record(np.zeros((600, 1)), np.tile([0.0, 0.1], (600, 1)))
    assert 0.097 < x[-1, 2] <= gain.bound("x3", {"y2": 0.1}) < 0.101
    content = hg.certificate(form, (*observer.checks, gain.check), "high_gain")
    assert verdict(content) == "verified"
    (claim,) = (each for each in content["claims"] if each["id"] == "high_gain.noise")
    for one in claim["evidence"]["bounds"]:
        one["bound"] = str(Fraction(one["bound"]) / 2)
    assert verdict(content) == "fails"


def test_where_nothing_is_proved_there_is_no_bound() -> None:
    gains = load(MODELS / "hyperjerk.py").module.tuning["low_power"]
    observer = hg.observers.low_power(hg.forms.triangular(model("hyperjerk")), **gains)
    assert "no norm is found" in str(hg.noise_gain(hg.sample(observer, hg.methods.rk4, dt=1e-3)))


@cache
def certified(observer: str) -> dict[str, Any]:
    step = step_of("pendulum", observer, 1e-3)
    gain = hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    return hg.certificate(step.observer.form, (*step.observer.checks, gain.check), observer)


def verdict(content: dict[str, Any]) -> str:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".noise"))
    return row.found


@pytest.mark.parametrize("observer", FIVE)
def test_the_bounds_are_verified_again(observer: str) -> None:
    assert verdict(certified(observer)) == "verified"


LIES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "bound": lambda one: {"bound": str(Fraction(one["bound"]) * Fraction(9, 10))},
    "state": lambda one: {"state": "2"},
    "a state between two": lambda one: {"state": "3/2"},
    "output": lambda one: {"output": "2"},
    "alpha": lambda one: {"alpha": str(Fraction(one["alpha"]) * 2)},
    "more alpha than time": lambda one: {"alpha": "5000"},
    "lambda": lambda one: {"S": [*one["S"][:-1], "0"]},
    "too much lambda": lambda one: {"S": [*one["S"][:-2], *(str(1000 * Fraction(x)) for x in one["S"][-2:])]},
    "P": lambda one: {"P": [[str(2 * Fraction(x)) for x in row] for row in one["P"]]},
    "none of S": lambda one: {"S": one["S"][-2:]},
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_forged_bound_fails(observer: str, lie: str) -> None:
    content = copy.deepcopy(certified(observer))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    one = claim["evidence"]["bounds"][0]
    one |= LIES[lie](one)
    assert verdict(content) == "fails"


@pytest.mark.parametrize(("most", "found_again"), [(sum, "verified"), (max, "fails")])
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_the_multipliers_of_all_inputs_are_within_alpha_together(observer: str, most: Any, found_again: str) -> None:
    """Each of them alone is not enough: the bound would be 1/sqrt(2) of what is true."""
    content = copy.deepcopy(certified(observer))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    one = claim["evidence"]["bounds"][0]
    claim["evidence"]["bounds"][0] = enlarged(one, 2, most)
    assert verdict(content) == found_again


@pytest.mark.parametrize(("share", "found_again"), [(Fraction(1, 2), "verified"), (Fraction(1, 10**6), "fails")])
def test_both_ends_of_a_call_are_paid_for_by_the_bilinear_rule(share: Fraction, found_again: str) -> None:
    """Which takes half of each, so that the lambda are equal."""
    x = hg.Signal("x", low=-1, high=1)
    plant = hg.System("lag", states=(x,), outputs=(hg.Signal("y"),), flow=[-x], output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=[-1])
    gain = hg.noise_gain(hg.sample(observer, hg.methods.bilinear, dt=1e-2))
    assert isinstance(gain, hg.NoiseGain)
    content = copy.deepcopy(hg.certificate(observer.form, (*observer.checks, gain.check), "high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    (one,) = claim["evidence"]["bounds"]
    first, last = map(Fraction, one["S"][-2:])
    assert float(first) == pytest.approx(float(last), rel=0.01)
    one["S"][-2:] = [str((first + last) * (1 - share)), str((first + last) * share)]
    assert verdict(content) == found_again


def test_the_rest_takes_the_sample_at_each_end_by_a_realised_core() -> None:
    """L = -20, M = -18, B = 3, R = 5, h = 1/10, so that phi_1 = 1/2 and phi_2 = 1/4: of (e, v_0, v_1)."""
    M, L, B, R = (Matrix([[Fraction(each)]]) for each in (-18, -20, 3, 5))
    e, *v = (Matrix([row]) for row in unit(3))
    method = method_of({"method": "the bilinear rule"})
    parts = ErrorMatrices(M, Matrix([[]]), Matrix([], 1), L, False, B, R, Matrix([], 1))
    moved = method.changes(parts, Fraction(1, 10), e, [Matrix([], 3)] * 2, v)
    (after,), (rates,) = moved.stages[1], moved.D
    assert [float(x) for x in after] == [0.1, 0.325, 0.075]
    assert [float(x) for x in rates] == [-9.45, 2.1625, 2.0375]


def test_a_bound_that_stands_twice_fails() -> None:
    """Of which a file could hold more than anybody waits for."""
    content = copy.deepcopy(certified("high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    claim["evidence"]["bounds"] *= 2
    assert verdict(content) == "fails"


def test_the_last_state_is_not_one_before_the_first() -> None:
    content = copy.deepcopy(certified("high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    last = claim["evidence"]["bounds"][-1]
    assert last["state"] == "2"
    last["state"] = "0"
    assert verdict(content) == "fails"


def test_a_file_of_long_numbers_is_refused_at_once() -> None:
    """Without an elimination in fractions, which takes many times as long as one in intervals."""
    content, rng = copy.deepcopy(certified("filtered")), random.Random(1)
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".noise"))
    for one in claim["evidence"]["bounds"]:
        for i, row in enumerate(one["P"]):
            for j in range(i + 1):
                long = Fraction(rng.randrange(10**9), 10**270 + rng.randrange(10**269))
                row[j] = one["P"][j][i] = str(Fraction(row[j]) + long)
        one["S"][0] = "0"
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".noise"))
    assert (row.found, row.sentence) == ("fails", "its inequality is not negative")
