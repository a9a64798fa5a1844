"""From which first errors an estimate stays clear of its limits: known answers, runs from there, forged numbers."""

import copy
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from forger import sealed
from plants import MODELS, model

import hgogen as hg
from hgogen.certificates.contraction import contraction
from hgogen.certificates.start_set import Start, start_of
from hgogen.model import load
from hgogen.program import Place
from hgogen.prove.quadratic import rational
from hgogen.prove.questions import peak_errors
from hgogen.recheck.verification import recheck
from hgogen.stepping.machine import Machine

FIVE = (
    "high_gain",
    "filtered",
    *(pytest.param(each, marks=pytest.mark.slow) for each in ("filtered_injection", "low_power", "peaking_free")),
)
Content = dict[str, Any]


@cache
def step_of(name: str, observer: str, dt: float) -> hg.Step:
    gains = load(MODELS / f"{name}.py").module.tuning[observer]
    return hg.sample(getattr(hg.observers, observer)(hg.forms.triangular(model(name)), **gains), hg.methods.rk4, dt=dt)


def starts(name: str, observer: str, dt: float = 1e-3) -> hg.StartSet:
    known = hg.start_set(step_of(name, observer, dt))
    assert isinstance(known, hg.StartSet)
    return known


JERK = ("x1", "x2", "x3", "x4")


@pytest.mark.parametrize(
    ("name", "observer", "dt", "multiple", "peaks"),
    [
        ("pendulum", "high_gain", 0.001, 1.95, {"q": 4.11, "w": 53.4}),
        pytest.param("hyperjerk", "high_gain", 0.001, 0.35, None, marks=pytest.mark.slow),
        pytest.param("hyperjerk", "filtered", 0.001, 1.10, None, marks=pytest.mark.slow),
        pytest.param("hyperjerk", "filtered", 0.02, 1.10, None, marks=pytest.mark.slow),
    ],
)
def test_the_bounds_are_those_that_are_known(
    name: str, observer: str, dt: float, multiple: float, peaks: dict[str, float] | None
) -> None:
    known = starts(name, observer, dt)
    assert known.multiple == pytest.approx(multiple, rel=0.01)
    if peaks:
        assert known.first == {"q": 4, "w": 20}
        assert known.peaks == pytest.approx(peaks, rel=0.002)


@pytest.mark.parametrize("observer", FIVE)
def test_no_run_from_the_first_errors_goes_further(observer: str) -> None:
    """Of the program in doubles, beside a pendulum at rest, by errors at the corners and between them."""
    step, known = step_of("pendulum", observer, 0.01), starts("pendulum", observer, 0.01)
    first, bounds = (np.array(list(each.values())) for each in (known.first, known.peaks))
    farthest = np.zeros(2)
    for angle, signs in product((0.0, np.pi), product((1.0, 0.3), (1.0, -1.0, 0.0))):
        errors, limited = run_from(step, angle, first * signs)
        assert not limited
        farthest = np.maximum(farthest, np.abs(errors).max(axis=0))
        assert not run_from(step, angle, first * signs * known.multiple)[1]
    assert (farthest <= bounds * (1 + 1e-9)).all()
    assert (farthest > 0.4 * bounds).all()


def run_from(step: hg.Step, first: float, error: np.ndarray) -> tuple[np.ndarray, bool]:
    """The errors (N, n) of an estimate that begins with one, beside a plant at rest at (first, 0, .., 0), and whether
    its outer box was met."""
    machine, inclusion = Machine(step), step.observer.error
    assert inclusion is not None
    layout, rest = inclusion.layout, np.append([first], np.zeros(len(error) - 1))
    begins = [(rest + error)[i] * fed for i, fed in zip(layout.index, layout.fed, strict=True)]
    for field in step.observer.parts[0].fields:
        machine.set({Place("state", field.name): [begins.pop(0) for _ in range(field.size)]})
    x, _, status = machine.record(np.zeros((200, len(step.inputs))), np.full((200, 1), first))
    raised = {bit.name for i, bit in enumerate(step.layout.bits) if (status >> i & 1).any()}
    return x - rest, "STATE_LIMITED" in raised


def test_errors_of_a_whole_range_are_too_many_for_four_states() -> None:
    """So that runs from within the set say something: the multiple is .35 there."""
    assert run_from(step_of("hyperjerk", "high_gain", 0.01), 0.0, np.array([3.0, -4.0, -6.0, -12.0]))[1]


def test_an_estimate_that_begins_at_an_end_may_err_by_the_whole_range() -> None:
    gains = load(MODELS / "pendulum.py").module.tuning["high_gain"]
    observer = hg.observers.high_gain(hg.forms.triangular(model("pendulum")), **gains, initial={"q": -4, "w": 5})
    known = hg.start_set(hg.sample(observer, hg.methods.rk4, dt=1e-3))
    assert isinstance(known, hg.StartSet)
    assert known.first == pytest.approx({"q": 8, "w": 25}, rel=1e-8)
    assert known.multiple < 1.2


def test_of_errors_that_are_too_many_the_peaks_are_those_of_the_share_that_is_taken() -> None:
    """It does not touch the limits: that of x2 is 6 - 1."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2, 3)]
    plant = hg.System("three", states=x, outputs=(hg.Signal("y"),), flow=[x[1], x[2], -sum(x)], output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=(-1, -1, -1))
    known = hg.start_set(hg.sample(observer, hg.methods.rk4, dt=1e-2))
    assert isinstance(known, hg.StartSet)
    assert known.multiple < 0.75
    assert 4.5 < known.peaks["x2"] <= 5 * (1 + 1e-6)
    assert known.peaks["x1"] == pytest.approx(known.multiple, rel=0.05)


def test_where_nothing_is_proved_there_are_no_starts() -> None:
    gains = load(MODELS / "hyperjerk.py").module.tuning["low_power"]
    observer = hg.observers.low_power(hg.forms.triangular(model("hyperjerk")), **gains)
    assert "no norm is found" in str(hg.start_set(hg.sample(observer, hg.methods.rk4, dt=1e-3)))


def oscillator(end: float | None, a: float | None = None, unit: float = 1.0) -> hg.System:
    """x1' = a x2, x2' = -x1/unit - x2, y = x1; linear, so that it needs no range of x2."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", **({"low": -end, "high": end} if end else {}))
    gain = hg.Signal("a", "", "", 2, low=1, high=3)
    return hg.System(
        "oscillator",
        states=(x1, x2),
        outputs=(hg.Signal("y"),),
        parameters=() if a else (gain,),
        flow=[(a or gain) * x2, -x1 / unit - x2],
        output=[x1],
    )


@pytest.mark.parametrize(
    ("end", "a", "why"),
    [
        (None, 1.0, "initial errors are those of states in ranges, and x2 has none"),
        (1.0, None, "the gains of its chain are no numbers"),
    ],
)
def test_without_ranges_or_with_gains_that_follow_a_parameter_there_are_none(
    end: float | None, a: float | None, why: str
) -> None:
    observer = hg.observers.high_gain(hg.forms.triangular(oscillator(end, a)), theta=3, poles=(-1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=1e-2)
    assert hg.contraction(step).proved
    assert str(hg.start_set(step)) == why


GAINS: dict[str, dict[str, Any]] = {
    "high_gain": {"poles": (-1, -1)},
    "filtered": {"alpha": 3, "beta": 1, "poles": (-1, -1)},
    "peaking_free": {},
}


@pytest.mark.parametrize("observer", GAINS)
def test_limits_and_errors_are_in_units_of_the_states(observer: str) -> None:
    """Of chains whose fields are multiples of the states: 4 x2 in the place of x2."""

    def known(end: float, a: float) -> hg.StartSet:
        made = getattr(hg.observers, observer)(hg.forms.triangular(oscillator(end, a, a)), theta=6, **GAINS[observer])
        starts = hg.start_set(hg.sample(made, hg.methods.rk4, dt=1e-2))
        assert isinstance(starts, hg.StartSet)
        return starts

    one, other = known(4.0, 1.0), known(1.0, 4.0)
    assert one.first == pytest.approx({"x1": 1, "x2": 4})
    assert other.first == pytest.approx({"x1": 1, "x2": 1})
    assert other.peaks == pytest.approx({"x1": one.peaks["x1"], "x2": one.peaks["x2"] / 4}, rel=1e-3)
    assert other.multiple == pytest.approx(one.multiple, rel=1e-3)


@cache
def certified(observer: str) -> Content:
    step = step_of("pendulum", observer, 1e-3)
    return hg.certificate(step.observer.form, (*step.observer.checks, starts("pendulum", observer).check), observer)


def verdict(content: Content) -> str:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".start"))
    return row.found


@pytest.mark.parametrize("observer", FIVE)
def test_the_bounds_are_verified_again(observer: str) -> None:
    assert verdict(certified(observer)) == "verified"


def times(factor: str, *path: Any) -> Callable[[Content], None]:
    def change(evidence: Any) -> None:
        *inner, last = path
        for key in inner:
            evidence = evidence[key]
        evidence[last] = str(Fraction(evidence[last]) * Fraction(factor))

    return change


LIES: dict[str, Callable[[Content], object]] = {
    "larger first errors": times("11/10", "first", 1),
    "a negative first error": times("-1", "first", 0),
    "a smaller peak": times("9/10", "peaks", 1, "bound"),
    "a negative peak": times("-1", "peaks", 1, "bound"),
    "a larger multiple": times("11/10", "clear", "multiple"),
    "a smaller limit": times("9/10", "clear", "limits", 0, "limit"),
    "a limit less": lambda evidence: evidence["clear"]["limits"].pop(),
    "a peak less": lambda evidence: evidence["peaks"].pop(),
    "peaks of each other": lambda evidence: evidence["peaks"].reverse(),
    "no peak": lambda evidence: evidence["peaks"].__setitem__(0, None),
    "another P": times("1/2", "clear", "P", 0, 0),
    "another P of a peak": times("1/2", "peaks", 0, "P", 0, 0),
    "S of nothing": times("0", "clear", "S", 0),
    "a dt beyond": lambda evidence: evidence.update(dt="1/5"),
    "a dt of 0": lambda evidence: evidence.update(dt="0"),
    "another method": lambda evidence: evidence.update(method="Euler", dt="1/10"),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_forged_number_fails(observer: str, lie: str) -> None:
    content = copy.deepcopy(certified(observer))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".start"))
    LIES[lie](claim["evidence"])
    assert verdict(content) == "fails"


@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
@pytest.mark.parametrize("sizes", [(1, 100, 10**4), (10**4, 100, 1)])
def test_a_norm_is_the_same_at_any_size(observer: str, sizes: tuple[int, ...]) -> None:
    """Each counts with the value that it has itself at the start, and not with that of another."""
    content = copy.deepcopy(certified(observer))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".start"))
    evidence = claim["evidence"]
    for one, size in zip((evidence["clear"], *evidence["peaks"]), sizes, strict=True):
        one["P"] = [[str(Fraction(x) * size) for x in row] for row in one["P"]]
        one["S"] = [str(Fraction(x) * size) for x in one["S"]]
    assert verdict(content) == "verified"


def test_what_is_verified_says_which_limits_are_not_met() -> None:
    content = copy.deepcopy(certified("high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".start"))
    claim["evidence"]["clear"]["limits"][0]["limit"] = "1000000000"
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".start"))
    assert row.found == "verified"
    assert "no field errs by more than 1000000000, 380.000" in row.sentence


@pytest.mark.parametrize(("beside", "found_again"), [("0", "verified"), ("1/5", "fails"), ("-1/5", "fails")])
def test_a_norm_counts_at_its_worst_corner(beside: str, found_again: str) -> None:
    """Of two states that do nothing to each other, an ellipse that is turned to one diagonal or to the other."""
    x, y = ([hg.Signal(f"{name}{i}", low=-1, high=1) for i in (1, 2)] for name in "xy")
    plant = hg.System("two", states=x, outputs=y, flow=[-x[0], -x[1]], output=x)
    observer = hg.observers.high_gain(hg.forms.block_triangular(plant), theta=6, poles=((-1,), (-1,)))
    known = hg.start_set(hg.sample(observer, hg.methods.rk4, dt=1e-2))
    assert isinstance(known, hg.StartSet)
    content = copy.deepcopy(hg.certificate(observer.form, (*observer.checks, known.check), "high_gain"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".start"))
    P = claim["evidence"]["clear"]["P"]
    P[0][1] = P[1][0] = str(Fraction(P[0][0]) * Fraction(beside))
    assert verdict(content) == found_again


@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_a_field_that_estimates_nothing_begins_without_an_error(observer: str) -> None:
    known, made = contraction(step_of("pendulum", observer, 1e-3)), step_of("pendulum", observer, 1e-3).observer
    assert known.proof is not None
    start, fed = start_of(made, known.proof.steps), known.proof.steps.error.layout.fed
    assert isinstance(start, Start)
    assert [all(corner[k] != 0 for corner in start.corners) for k in range(len(fed))] == [bool(each) for each in fed]


def test_a_box_of_twice_the_size_goes_twice_as_far() -> None:
    P, corners, c = (rational(np.array(each)) for each in ([[2, 1], [1, 2]], [[1, 1], [1, -1]], [1, 0]))
    one, other = (peak_errors(P, size * corners, {0: c})[0] for size in (1, 2))
    assert float(one) == pytest.approx(2)
    assert float(other) == pytest.approx(4)


def test_the_field_of_a_filter_has_no_limit() -> None:
    """It is none that estimates."""
    content = copy.deepcopy(certified("filtered"))
    (claim,) = (each for each in content["claims"] if each["id"].endswith(".start"))
    claim["evidence"]["clear"]["limits"].append({"field": "3", "limit": "1000000"})
    assert verdict(content) == "fails"
