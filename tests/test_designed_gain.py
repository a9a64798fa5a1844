"""A designed gain: the rate and the noise bound that are said hold at frozen slopes, and no theta does better."""

import sys
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import model, two_outputs
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.prove.gain_design import NoGain
from hgogen.prove.semidefinite import NoSolver
from hgogen.reading.given import BadGain
from hgogen.recheck.verification import recheck


def chain(n: int, last: Any = 0, most: float = 1, **parts: Any) -> hg.Form:
    """y = x1, x1' = x2, .., x_n' = last, on -most..most."""
    x = [hg.Signal(f"x{i + 1}", low=-most, high=most) for i in range(n)]
    row = last(x) if callable(last) else sp.sympify(last)
    plant = hg.System("chain", states=tuple(x), outputs=(hg.Signal("y"),), flow=[*x[1:], row], output=[x[0]], **parts)
    return hg.forms.triangular(plant)


def powers(gain: hg.design.Gain) -> np.ndarray:
    """theta^i K_i."""
    K = np.array(gain.K)
    return K * gain.theta ** np.arange(1, len(K) + 1)


def moved(M: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The integrals of |c exp(M t) b|, which noise of e' = M e + b v comes to."""
    slow = -np.linalg.eigvals(M).real.max()
    fast = np.abs(np.linalg.eigvals(M)).max()
    h = 0.01 / fast
    step, e, total = expm(M * h), b.copy(), np.zeros(len(b))
    for _ in range(int(12 / slow / h)):
        after = step @ e
        total, e = total + h * (np.abs(e) + np.abs(after)) / 2, after
    return total


def frozen(rows: Sequence[Sequence[float]], K: np.ndarray) -> list[np.ndarray]:
    """A + J - K C of a chain of integrators, the last row of J at the ends of its ranges."""
    n = len(K)
    ends = []
    for last in product(*rows):
        M = np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0])
        M[-1] += last
        ends.append(M)
    return ends


PENDULUM = ((-19.6, 19.6), (-0.1, 0))


@pytest.mark.parametrize("rate", [1.0, 15.0, 200.0])
def test_what_is_said_holds_at_frozen_slopes(rate: float) -> None:
    gain = hg.design.gain(hg.forms.triangular(model("pendulum")), rate=rate)
    assert gain.rate >= rate * (1 - 1e-12)
    K = powers(gain)
    ends = frozen(PENDULUM, K)
    assert max(np.linalg.eigvals(M).real.max() for M in ends) <= -gain.rate * (1 - 1e-9)
    worst = np.max([moved(M, K) for M in ends], axis=0)
    said = [gain.bounds[x, "y"] for x in ("q", "w")]
    assert all(worst <= np.array(said) * (1 + 1e-3))  # of the integral
    assert all(np.array(said) < 2 * worst)


@pytest.mark.full
@pytest.mark.parametrize("name", ["pendulum", "duffing", pytest.param("hyperjerk", marks=pytest.mark.slow)])
def test_no_theta_does_better_at_its_rate(name: str) -> None:
    observer = load(name).step("high_gain").observer
    (above,) = (check for check in observer.checks if check.id == "high_gain.theta")
    known, form = hg.design.noise_bounds(observer), observer.form
    halves = {x: float(z.high - z.low) / 2 for x, z in zip(form.names, form.states, strict=True)}
    rate = above.proofs[0].fact.falls.rate
    gain = hg.design.gain(form, rate=rate)
    assert gain.rate >= rate * (1 - 1e-12)
    largest = [max(bound / halves[x] for (x, _), bound in each.items()) for each in (gain.bounds, known)]
    assert largest[0] <= largest[1]


@pytest.mark.ordinary("bilinear")
@pytest.mark.parametrize("method", ["rk4", "bilinear"])
def test_the_observer_of_a_gain_proves_it_and_its_step_is_verified(method: str) -> None:
    """By the bilinear rule too, as A - K C is a matrix of numbers."""
    form = hg.forms.triangular(model("pendulum"))
    gain = hg.design.gain(form, rate=8)
    observer = hg.observers.high_gain(form, theta=gain.theta, gains=gain.K)
    step = hg.sample(observer, getattr(hg.methods, method), dt=1e-3)
    known, noise = hg.contraction(step), hg.noise_gain(step)
    assert known.proved
    assert isinstance(noise, hg.NoiseGain)
    for place, bound in hg.design.noise_bounds(observer).items():
        assert bound == pytest.approx(gain.bounds[place], rel=0.03)
        assert bound < 1.02 * noise.gains[place] < 1.2 * bound
    checks = (*observer.checks, *known.checks, noise.check)
    rows = {row.id: row.found for row in recheck(sealed(hg.certificate(form, checks, "high_gain"))).rows}
    facts = ("convergence", "theta", "step", "noise")
    assert [rows[f"high_gain.{fact}"] for fact in facts] == ["verified"] * len(facts)


@pytest.mark.full
def test_theta_is_only_how_a_gain_is_written() -> None:
    form = hg.forms.triangular(model("pendulum"))
    one, own = (hg.design.gain(form, rate=5, theta=theta) for theta in (1, None))
    assert one.theta == 1 < own.theta
    assert one.bounds["w", "y"] == pytest.approx(own.bounds["w", "y"], rel=0.02)
    observer = hg.observers.high_gain(form, theta=1, gains=one.K)
    assert {check.verdict for check in observer.checks} == {Verdict.PROVED}


@pytest.mark.full
def test_noise_of_chains_aligned_at_the_end_does_not_depend_on_theta() -> None:
    """Of the same gain, each row of which acts on both outputs, written with two values of theta."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, 4)]
    flow = [-x[0] + sp.sin(x[2]) * x[2] / 20, x[2], -x[1] / 10]
    plant = hg.System("ends", states=tuple(x), outputs=(hg.Signal("y1"), hg.Signal("y2")), flow=flow, output=x[:2])
    form = hg.forms.block_triangular(plant)
    assert (form.alignment, form.blocks) == ("end", (1, 2))
    K, powers = np.array([[3, 0.2], [0.1, 4], [0.3, 5]]), np.array([[1, 2], [0, 1], [1, 2]])
    one, other = (hg.observers.high_gain(form, theta=theta, gains=K / theta**powers) for theta in (1.0, 2.0))
    known = hg.design.noise_bounds(one)
    assert known["x1", "y1"] > 0.7  # what is slow passes by 3/4
    assert dict(hg.design.noise_bounds(other)) == pytest.approx(dict(known), rel=0.05)


@pytest.mark.full
def test_a_single_state_is_bounded_by_its_own_fastest() -> None:
    """e' = (5 - k) e + k v: noise comes to k/(k - 5), less the larger k."""
    slow, fast = (hg.design.gain(chain(1, lambda x: 5 * x[0]), rate=1, fastest=most) for most in (4, 40))
    for gain in (slow, fast):
        (k,) = powers(gain)
        assert k / (k - 5) <= gain.bounds["x1", "y"] < 1.02 * k / (k - 5)
    assert powers(slow)[0] < 10
    assert fast.bounds["x1", "y"] < slow.bounds["x1", "y"]


@pytest.mark.parametrize(("fastest", "gain"), [(1.0, 6.0), (2.0, 7.0), (4.0, 9.0)])
def test_a_limit_of_speed_is_kept(fastest: float, gain: float) -> None:
    """x' = 5 x decays at the rate 1 from k = 6 on; noise of 1 moves it at k, at most by k/(k - 5): k - 5 <= fastest."""
    designed = hg.design.gain(chain(1, lambda x: 5 * x[0]), rate=1, fastest=fastest)
    assert powers(designed)[0] == pytest.approx(gain, rel=1e-3)
    assert designed.bounds["x1", "y"] == pytest.approx(gain / (gain - 5), rel=1e-3)


def test_noise_moves_a_single_state_no_faster_than_is_asked_for() -> None:
    """By k in a unit of time, over the bound: by about 2."""
    gain = hg.design.gain(chain(1, lambda x: 5 * x[0]), rate=1, fastest=2)
    assert powers(gain)[0] < 1.2 * 2 * gain.bounds["x1", "y"]


@pytest.mark.ordinary("1.0")
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_unit_of_time_does_not_matter(scale: float) -> None:
    gain = hg.design.gain(chain(2), rate=scale, per={"x1": 1, "x2": scale})
    assert scale * (1 - 1e-12) <= gain.rate < 1.3 * scale
    assert gain.bounds["x1", "y"] == pytest.approx(1.44, rel=0.1)
    assert gain.bounds["x2", "y"] == pytest.approx(scale, rel=0.2)


def test_a_measure_weighs_a_state() -> None:
    coarse, fine = (hg.design.gain(chain(2), rate=1, per={"x2": size}) for size in (10, 0.1))
    assert fine.bounds["x2", "y"] < 0.96 * coarse.bounds["x2", "y"]


@pytest.mark.full
def test_of_several_outputs_each_row_acts_on_all() -> None:
    form = hg.forms.block_triangular(two_outputs())
    gain = hg.design.gain(form, rate=2)
    assert np.shape(gain.K) == (3, 2)
    observer = hg.observers.high_gain(form, theta=gain.theta, gains=gain.K)
    assert {check.verdict for check in observer.checks if check.id.maker == "high_gain"} == {Verdict.PROVED}
    noise = {"y1": 0.5, "y2": 2.0}
    state = form.names[0]
    assert gain.bound(state, noise) == gain.bounds[state, "y1"] / 2 + gain.bounds[state, "y2"] * 2
    assert f"K = (({gain.K[0][0]:g}, {gain.K[0][1]:g}), (" in str(gain)
    assert str(gain).count(" for 1 of y1") == form.n


@pytest.mark.full
def test_the_sizes_of_noise_are_weighed() -> None:
    """A gain for other sizes does no better under these."""
    form = hg.forms.block_triangular(two_outputs())
    halves = {x: float(z.high - z.low) / 2 for x, z in zip(form.names, form.states, strict=True)}
    loud = ({"y1": 1.0, "y2": 30.0}, {"y1": 30.0, "y2": 1.0})
    gains = [hg.design.gain(form, rate=2, noise=noise) for noise in loud]
    for noise, own, other in zip(loud, gains, reversed(gains), strict=True):
        largest = [max(gain.bound(x, noise) / halves[x] for x in form.names) for gain in (own, other)]
        assert largest[0] < 0.99 * largest[1]


@pytest.mark.full
def test_a_parameter_may_be_anywhere_in_its_range() -> None:
    x = [hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)]
    a = hg.Signal("a", nominal=3, low=2, high=4)
    flow = [a * x[1], -a * sp.sin(x[0])]
    plant = hg.System("a", states=tuple(x), parameters=(a,), outputs=(hg.Signal("y"),), flow=flow, output=[a * x[0]])
    gain = hg.design.gain(hg.forms.triangular(plant), rate=4)
    K = powers(gain)
    for slope, at in product((-4.0, 0.0), (2.0, 4.0)):
        M = np.array([[0.0, at], [slope, 0.0]]) - at * np.outer(K, [1, 0])
        assert np.linalg.eigvals(M).real.max() <= -4
        assert all(moved(M, K) <= [1.001 * gain.bounds[state, "y"] for state in ("x1", "x2")])


def test_a_sensor_may_show_ten_times_as_much() -> None:
    """What K reads of an output with a slope in 1..10 moves with it."""
    x, a = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2)], hg.Signal("a", nominal=5.5, low=1, high=10)
    flow, y = [x[1], -sp.sin(x[0])], hg.Signal("y")
    plant = hg.System("a", states=tuple(x), parameters=(a,), outputs=(y,), flow=flow, output=[a * x[0]])
    assert hg.design.gain(hg.forms.triangular(plant), rate=2).rate >= 2 * (1 - 1e-12)


@pytest.mark.slow
def test_eight_states_have_a_gain() -> None:
    form = chain(8, lambda x: sp.sin(x[0]) + x[3] / 2 - x[7] ** 3 / 9)
    gain = hg.design.gain(form, rate=1)
    K = powers(gain)
    for M in frozen(((np.cos(1), 1), (0,), (0,), (0.5,), (0,), (0,), (0,), (-1 / 3, 0)), K):
        assert np.linalg.eigvals(M).real.max() <= -1


@pytest.mark.full
def test_a_rate_that_is_not_reached_names_what_hinders() -> None:
    x = [hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)]
    u, y = hg.Signal("u", low=sp.Rational(1, 1000), high=10), hg.Signal("y")
    flow = [u * x[1], sp.sin(5 * x[0])]
    plant = hg.System("driven", states=tuple(x), inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])
    said = r"of driven decay at rate = 5; at \S+ there is one; \S+ in \[\S+, \S+\] hinders"
    with pytest.raises(NoGain, match=said) as error:
        hg.design.gain(hg.forms.triangular(plant), rate=5)
    assert 0 < error.value.reached < 5
    with pytest.raises(BadGain, match="no bound is found of what noise does"):
        hg.design.gain(chain(3), rate=1, theta=1e15)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rate": 0}, "rate = 0 must be a positive finite number"),
        ({"rate": -1}, "rate = -1 must be a positive"),
        ({"rate": float("inf")}, "rate = inf must be a positive"),
        ({"rate": float("nan")}, "rate = nan must be a positive"),
        ({"rate": "fast"}, "rate = 'fast' must be a number"),
        ({"noise": {"z": 1}}, "noise names 'z'"),
        ({"noise": {"y": 0}}, "noise of y = 0 must be a positive"),
        ({"noise": 3}, "noise = 3 is no mapping"),
        ({"per": {"x1": 0}}, "per of x1 = 0 must be a positive"),
        ({"per": {"x1": None}}, "per of x1 = None must be a number"),
        ({"per": {"q": 1}}, "per names 'q'"),
        ({"fastest": 0}, "fastest = 0 must be a positive"),
        ({"theta": -1}, "theta = -1 must be a positive"),
        ({"rate": 1e16}, r"rate = 1e\+16 must be from 1e-15 to 1e\+15; take other units"),
        ({"noise": {"y": 1e-200}}, "noise of y = 1e-200 must be from"),
    ],
)
def test_what_is_no_number_is_named(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(hg.HgogenError, match=said):
        hg.design.gain(chain(2), **{"rate": 1.0, **changes})


def test_what_has_no_chains_is_refused() -> None:
    form = chain(2)
    with pytest.raises(hg.HgogenError, match=r"gain was given System.* give a form"):
        hg.design.gain(form.system, rate=1)
    with pytest.raises(hg.HgogenError, match=r"chain has no gain that is designed: the bound rests on"):
        hg.design.gain(hg.forms.original(form.system), rate=1)
    observer = hg.observers.riccati(form, Q=(1, 1), R=1)
    assert "constant injection" in str(hg.design.noise_bounds(observer))


def test_without_a_solver_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(NoSolver, match=r"the design of a gain needs clarabel; install it"):
        hg.design.gain(chain(2), rate=1)
