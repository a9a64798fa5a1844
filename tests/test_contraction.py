"""The certificate of the step as it runs: known answers, what trials show, and what it refuses to say."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp
from flint import fmpq
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import MODELS, model

import hgogen as hg
from hgogen.certificates.contraction import Reach, _neighbour_checks, _proved, contraction, reach
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.program import Place
from hgogen.prove.inclusion import Inclusion, Nothing
from hgogen.prove.inequality import Contracts, Piece, Steps, corners, unstable
from hgogen.prove.quadratic import Quadratic, Weights, rational, verified
from hgogen.stepping.machine import Machine

FIVE = ("high_gain", "filtered", "filtered_injection", "low_power", "peaking_free")


def made(name: str, observer: str, **changes: Any) -> hg.Observer:
    """The observer of a shipped tuning."""
    gains = {**load(MODELS / f"{name}.py").module.tuning[observer], **changes}
    return getattr(hg.observers, observer)(hg.forms.triangular(model(name)), **gains)


def steps_of(observer: hg.Observer, method: str) -> Steps:
    """What is sought of the observer's step, at its theta."""
    error = observer.error
    assert isinstance(error, Inclusion)
    (theta,) = observer.gains[0].initial
    return Steps(error, getattr(hg.methods, method).error_step, Fraction(theta))


# the largest dt of all combinations of slopes, in floats, and the dt from which a frozen slope is unstable
LONGEST = [
    ("pendulum", "high_gain", "euler", 20, 0.0818, 0.0819),
    ("pendulum", "high_gain", "heun", 20, 0.0818, 0.0819),
    ("pendulum", "high_gain", "rk4", 20, 0.114, 0.114),
    ("pendulum", "high_gain", "euler", 50, 0.0367, 0.0368),
    ("pendulum", "high_gain", "rk4", 50, 0.0511, 0.0512),
    ("hyperjerk", "high_gain", "euler", 4, 0.125, 0.130),
    ("hyperjerk", "high_gain", "rk4", 4, 0.269, 0.270),
]
SLOW = [
    ("pendulum", "high_gain", "heun", 50, 0.0367, 0.0368),
    ("hyperjerk", "high_gain", "heun", 4, 0.202, 0.202),
    ("hyperjerk", "filtered", "euler", 10, 0.0685, 0.0717),
    ("hyperjerk", "filtered", "heun", 10, 0.0731, 0.0733),
    ("hyperjerk", "filtered", "rk4", 10, 0.101, 0.102),
    ("hyperjerk", "peaking_free", "euler", 10, 0.053, math.inf),
    ("hyperjerk", "peaking_free", "heun", 10, 0.085, math.inf),
    ("hyperjerk", "peaking_free", "rk4", 10, 0.103, math.inf),
]


@pytest.mark.parametrize(
    ("name", "observer", "method", "theta", "known", "frozen"),
    [*LONGEST, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW)],
)
def test_the_longest_dt_is_near_that_of_all_slopes_and_below_what_a_frozen_one_admits(
    name: str, observer: str, method: str, theta: float, known: float, frozen: float
) -> None:
    steps = steps_of(made(name, observer, theta=theta), method)
    far = reach(steps, Fraction(1, 1000), known * 1.2)
    assert far.longest is not None
    assert 0.9 * known <= far.longest <= 1.01 * frozen
    assert (far.pieces[0].low, far.pieces[-1].high) == (0, far.longest)
    assert all(first.high == second.low for first, second in zip(far.pieces, far.pieces[1:], strict=False))


LEAST = [  # the least theta in continuous time, at the corners of the slopes
    ("pendulum", "high_gain", 4.43),
    ("hyperjerk", "high_gain", 1.81),
    ("hyperjerk", "filtered", 6.60),
    ("hyperjerk", "low_power", 4.63),
]


@pytest.mark.parametrize(("name", "observer", "known"), LEAST)
def test_a_theta_a_little_above_the_least_is_proved_at_a_short_dt_and_one_below_is_not(
    name: str, observer: str, known: float
) -> None:
    short = Fraction(1, 10_000)
    assert steps_of(made(name, observer, theta=known * 1.06), "euler").certain(short) is not None
    assert steps_of(made(name, observer, theta=known * 0.99), "euler").certain(short) is None


def test_low_power_on_hyperjerk_is_not_proved_at_its_theta_and_says_from_which_on_it_is() -> None:
    known = contraction(hg.sample(made("hyperjerk", "low_power"), hg.methods.rk4, dt=1e-3))
    (check,) = known.checks
    assert (known.proved, known.rate, check.verdict) == (False, None, Verdict.UNKNOWN)
    assert known.reach.least is not None
    assert 4.63 <= known.reach.least <= 1.05 * 4.63
    assert f"theta = {float(known.reach.least):g}" in check.fix


def test_the_shipped_pendulum_is_proved_at_its_dt_at_every_shorter_one_and_at_lower_thetas() -> None:
    known = hg.contraction(load(MODELS / "pendulum.py").step())
    step, shorter, tuned = known.checks
    assert {check.verdict for check in known.checks} == {Verdict.PROVED}
    assert [check.id for check in known.checks] == ["high_gain.step", "high_gain.shorter", "high_gain.tuned"]
    assert known.rate is not None
    assert 14 < known.rate < 15.6  # no frozen slope is slower than 15.6
    assert "dt = 0.001 s" in step.claim
    assert "at every dt up to 0.11" in shorter.claim
    assert "at every theta from 4.4" in tuned.claim
    assert str(known) == "\n".join(map(str, known.checks))


def shrinking(
    steps: Steps, dt: float, step: hg.Step, starts: np.ndarray, record: tuple[np.ndarray, np.ndarray]
) -> float:
    """The largest V+/V, V = e'P e of two estimates, as the program moves them in doubles from `starts` (2, N) given the
    same samples, at calls in which no guard acts, over what is proved."""
    proof = steps.proved(Fraction(dt))
    assert proof is not None
    (u, y), P, pair = record, np.array(proof.weights.P, dtype=float), []
    for start in starts:
        machine, names = Machine(step), [field.name for field in step.observer.parts[0].fields]
        machine.record(u[:1], y[:1])  # the first call advances no time
        ends = np.cumsum([len(machine.memory[Place("state", name)]) for name in names])
        for name, values in zip(names, np.split(start, ends[:-1]), strict=True):
            machine.memory[Place("state", name)][:] = values
        seen, free = [start], []
        for k in range(1, len(y)):
            _, _, status = machine.record(u[k : k + 1], y[k : k + 1])
            seen.append(np.concatenate([machine.memory[Place("state", name)] for name in names]))
            raised = {bit.name for i, bit in enumerate(step.layout.bits) if int(status[0]) >> i & 1}
            free.append(not raised - {"OUTSIDE_BOX"})
        pair.append((np.array(seen), np.array(free)))
    (first, calm), (second, quiet) = pair
    e = (first - second) * float(steps.theta) ** -np.array(steps.error.layout.power)
    V = np.einsum("ki,ij,kj->k", e, P, e)
    counted = (V[:-1] > 1e-10 * V[0]) & calm & quiet
    assert counted.any()
    return float((V[1:][counted] / V[:-1][counted]).max() / (1 - proof.alpha * Fraction(dt)))


@pytest.mark.ordinary(
    "high_gain-rk4",
    "high_gain-euler",
    "peaking_free-heun",
    "high_gain-bilinear",
    "filtered-bilinear",
    "high_gain-exponential",
)
@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
@pytest.mark.parametrize(
    ("observer", "method"),
    [
        ("high_gain", "rk4"),
        ("high_gain", "euler"),
        ("peaking_free", "heun"),
        ("high_gain", "bilinear"),
        ("filtered", "bilinear"),
        ("high_gain", "exponential"),
        ("filtered", "exponential"),
        *(pytest.param(each, "rk4", marks=pytest.mark.slow) for each in FIVE[1:]),
    ],
)
def test_two_estimates_come_together_by_the_proved_share_at_every_call(observer: str, method: str) -> None:
    dt, estimator = 0.03, made("pendulum", observer)
    step, steps = hg.sample(estimator, getattr(hg.methods, method), dt=dt), steps_of(estimator, method)
    rng, scale = np.random.default_rng(1), 20.0 ** np.array(steps.error.layout.power)
    record = rng.uniform(-1, 1, (12, 1)), rng.uniform(-0.1, 0.1, (12, 1))
    ratios = [shrinking(steps, dt, step, rng.uniform(-1, 1, (2, len(scale))) * scale, record) for _ in range(4)]
    assert 0.2 < max(ratios) <= 1 + 1e-9


@pytest.mark.parametrize("method", ["euler", "heun", "rk4"])
def test_every_combination_of_slopes_contracts_by_the_proved_share(method: str) -> None:
    """e+ = Phi(M_1, .., M_s) e by the stages written out, each with corners of its own: no more than sqrt(1 - a h)."""
    steps, h = steps_of(made("hyperjerk", "high_gain"), method), 0.1
    proof = steps.proved(Fraction(h))
    assert proof is not None
    u, tableau = steps.error.at(steps.theta), getattr(hg.methods, method).tableau
    M, G, H = (np.array([[float(Fraction(int(x.p), int(x.q))) for x in row] for row in A]) for A in (u.M, u.G, u.H))
    root, rng, worst = np.linalg.cholesky(np.array(proof.weights.P, dtype=float)).T, np.random.default_rng(0), 0.0
    for _ in range(3000):
        slopes = [M + G @ np.diag(rng.choice([-1.0, 1.0], len(H))) @ H for _ in tableau.b]
        rates: list[np.ndarray] = []
        for row, slope in zip(tableau.a, slopes, strict=True):
            rates.append(slope @ (np.eye(len(M)) + h * sum((a * w for a, w in zip(row, rates, strict=True)), 0 * M)))
        Phi = np.eye(len(M)) + h * sum(b * w for b, w in zip(tableau.b, rates, strict=True))
        worst = max(worst, float(np.linalg.norm(root @ Phi @ np.linalg.inv(root), 2)))
    assert 0.7 < worst <= math.sqrt(1 - float(proof.alpha) * h) * (1 + 1e-9)


def test_a_step_beyond_the_longest_is_not_proved_and_says_which_slope_held_there_does_not_decay() -> None:
    steps = steps_of(made("pendulum", "high_gain"), "euler")
    assert unstable(steps.at(Fraction(0.083))) is not None
    assert steps.certain(Fraction(0.083)) is None
    step = hg.sample(made("pendulum", "high_gain", theta=4), hg.methods.rk4, dt=1e-3)
    (check,) = hg.contraction(step).checks
    assert check.verdict is Verdict.UNKNOWN
    assert "db_2/dz1 = " in str(check.reason) or "no common norm" in str(check.reason)


def test_other_lengths_and_thetas_are_claimed_where_there_are_pieces() -> None:
    observer = made("pendulum", "high_gain")
    steps = steps_of(observer, "euler")
    assert list(_neighbour_checks(observer, "Euler", steps, Reach(Fraction(1, 10), (), steps.theta))) == []
    pieces = (Piece(Fraction(0), Fraction(1, 10), Weights(((Fraction(1),),), ())),)
    shorter, tuned = _neighbour_checks(observer, "Euler", steps, Reach(Fraction(1, 10), pieces, Fraction(5), pieces))
    assert "every dt up to 0.1 s, of a larger theta while theta dt is up to 2" in shorter.claim
    assert "every theta from 5 to 20" in tuned.claim


def test_thetas_are_tuned_at_the_longest_dt_that_serves_one_of_them() -> None:
    """That of the least theta where it is below the step's own; there are none to tune where it is above."""
    h = Fraction(1, 1000)
    far = reach(steps_of(made("pendulum", "high_gain"), "euler"), h, math.inf)
    assert far.least is not None
    assert far.least < 20
    assert far.tuned[-1].high == h * 20 / far.least
    low = reach(steps_of(made("pendulum", "high_gain", theta=4), "euler"), h, math.inf)
    assert low.least is not None
    assert low.least > 4
    assert low.tuned == ()


def test_a_proof_is_first_tried_at_the_short_number_next_to_the_end() -> None:
    for start, end, nearest in ((20, Fraction("4.412"), "4.42"), (1, Fraction("4.418"), "4.41")):
        value = _proved(lambda _: True, Fraction(start), end)
        assert float(value or 0) == float(nearest)


def test_an_a_that_moves_lies_in_the_range_of_its_slope() -> None:
    x, v, u = hg.Signal("x", low=-2, high=2), hg.Signal("v", low=-2, high=2), hg.Signal("u", low=-1, high=1)
    flow = [(2 + u / 3) * v, -sp.sin(x)]
    plant = hg.System("p", states=(x, v), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x])
    error = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, gains=(2, 0.5)).error
    assert isinstance(error, Inclusion)
    (moving,) = (slope for slope in error.varying if slope.entry is None)
    assert moving.low <= Fraction(5, 3)
    assert Fraction(7, 3) <= moving.high


def test_the_slopes_of_a_corner_are_named_by_their_ends() -> None:
    error = made("pendulum", "high_gain").error
    assert isinstance(error, Inclusion)
    entries = [slope for slope in error.varying if slope.entry is not None]
    for share, end in ((-1.0, "low"), (1.0, "high")):
        values = error.slope_values(model("pendulum").states, np.full(len(error.varying), share))
        assert list(values.values()) == [getattr(slope, end) for slope in entries]


def test_a_multiplier_below_zero_proves_nothing() -> None:
    """Of e' = e with a relation |0| <= |e|, which says nothing."""
    one = rational([[1]])
    form = Quadratic(((one, one),), one, 0 * one)
    assert not verified((form,), one, rational([-3]))
    assert (form.value(one, rational([-3])) < 0).all()


def test_the_rate_is_rounded_down_however_little_one_step_takes() -> None:
    steps = steps_of(made("pendulum", "high_gain"), "rk4")
    slow = Contracts(steps, Fraction(1, 10**6), Fraction(1, 10**6), Weights((), ()))
    assert 5e-7 * (1 - 1e-8) < slow.rate <= 5e-7  # -log(1 - alpha dt)/(2 dt), 1 - alpha dt being 1 - 1e-12


def test_what_rationals_do_not_confirm_is_no_proof() -> None:
    form = steps_of(made("pendulum", "high_gain"), "rk4").at(Fraction(1, 1000)).falls(Fraction(0))
    weights = steps_of(made("pendulum", "high_gain"), "rk4").certain(Fraction(1, 1000))
    assert weights is not None
    P, S = rational(weights.P), rational(weights.S)
    assert verified((form,), P, S)
    assert not verified((form,), -P, S)
    assert not verified((form,), P, -S)
    assert not verified((form,), P, 0 * S)
    assert not verified((form,), P * fmpq(1, 10**9), S)


@pytest.mark.full
@given(st.lists(st.floats(0.2, 3), min_size=2, max_size=3), st.floats(2, 12), st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_no_pair_of_estimates_of_a_random_plant_grows_apart_where_it_is_proved(
    slopes: list[float], theta: float, seed: int
) -> None:
    n = len(slopes)
    x = [hg.Signal(f"x{i}", low=-2, high=2) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    rest = [a * sp.sin(z + u) for a, z in zip(slopes, x, strict=True)]
    flow = [after + r for after, r in zip([*x[1:], 0], rest, strict=True)]
    plant = hg.System("random", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])
    estimator = hg.observers.high_gain(hg.forms.triangular(plant), theta=theta, poles=(-1,) * n)
    steps, h = steps_of(estimator, "rk4"), 0.5 / theta
    if steps.certain(Fraction(h)) is None:
        return
    rng, step = np.random.default_rng(seed), hg.sample(estimator, hg.methods.rk4, dt=h)
    record = rng.uniform(-1, 1, (6, 1)), rng.uniform(-0.1, 0.1, (6, 1))
    assert shrinking(steps, h, step, rng.uniform(-1, 1, (2, n)) * theta ** np.arange(n), record) <= 1 + 1e-9


def test_where_nothing_is_proved_it_is_said_why() -> None:
    known = hg.contraction(hg.sample(made("pendulum", "riccati"), hg.methods.continuous_discrete, dt=1e-3))
    assert (known.proved, known.reach.longest) == (False, None)
    assert "constant injection" in str(known.checks[0].reason)


def test_nothing_is_proved_by_a_method_of_which_it_is_not_known_how_it_moves_the_error() -> None:
    class Own:
        """The contract of a method, and no more."""

        known = hg.methods.exponential
        name, equations, prediction = "my own", known.equations, known.prediction
        ode, riccati, ode_lengths, riccati_lengths = known.ode, known.riccati, known.ode_lengths, known.riccati_lengths

    (check,) = hg.contraction(hg.sample(made("pendulum", "high_gain"), Own(), dt=1e-3)).checks
    assert "not made for my own" in str(check.reason)


def test_without_guards_nothing_is_proved() -> None:
    step = hg.sample(made("pendulum", "high_gain"), hg.methods.rk4, dt=1e-3, guards="none")
    assert "without guards" in str(hg.contraction(step).checks[0].reason)


def test_a_linear_plant_has_no_slopes_and_contracts_as_its_core_does() -> None:
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)
    plant = hg.System("double", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, 0], output=[x1])
    estimator = hg.observers.high_gain(hg.forms.triangular(plant), theta=8, poles=(-1, -1.2))
    known = hg.contraction(hg.sample(estimator, hg.methods.euler, dt=0.01))
    assert [check.id.split(".")[1] for check in known.checks] == ["step", "shorter", "tuned"]
    assert known.rate is not None
    assert 7 < known.rate < 8.4  # Euler's 1 - 8 dt, as a rate
    assert known.reach.longest is not None
    assert 0.95 * 2 / 9.6 < known.reach.longest < 2 / 9.6  # where 1 - 9.6 dt is -1


@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
def test_a_stage_that_reads_nothing_of_the_error_is_proved_as_others_are() -> None:
    """At theta dt = 2 the second stage of classical Runge-Kutta starts where two estimates agree."""
    x = hg.Signal("x", low=-1, high=1)
    plant = hg.System("one", states=(x,), outputs=(hg.Signal("y"),), flow=[x**2 / 2], output=[x])
    estimator = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1,))
    assert steps_of(estimator, "rk4").certain(Fraction(1, 10)) is not None
    step = hg.sample(estimator, hg.methods.rk4, dt=0.1)  # where it reads next to nothing, by the float's rounding
    gain = hg.noise_gain(step)
    assert hg.contraction(step).proved
    assert isinstance(gain, hg.NoiseGain)
    assert 1 <= gain.gains["x", "y"] < 1.3


def test_a_plant_without_finite_slopes_has_no_inclusion() -> None:
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2")
    plant = hg.System("free", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -(x2**3)], output=[x1])
    estimator = hg.observers.high_gain(hg.forms.triangular(plant), theta=5, poles=(-1, -1))
    assert isinstance(estimator.error, Nothing)


@pytest.mark.full
def test_an_observer_in_the_plants_coordinates_has_none_and_says_so() -> None:
    """On a phase form whose a_i are no numbers of the plant's."""
    known = hg.contraction(load(MODELS / "battery.toml").step("high_gain"))
    assert not known.proved
    assert "stays in the plant's" in str(known.checks[0].reason)


def test_a_rate_far_below_one_over_dt_is_found() -> None:
    """Within a seventh of that of the slowest slopes that are held, which no norm exceeds."""
    step = load(MODELS / "duffing.toml").step("high_gain")
    known = hg.contraction(step)
    assert known.proof is not None
    stage = known.proof.step
    radius = max(np.abs(np.linalg.eigvals(stage.frozen(corners(stage.slopes)))).max(axis=1))
    assert 0.85 * -np.log(radius) / step.dt < (known.rate or 0) <= -np.log(radius) / step.dt


@pytest.mark.full
@pytest.mark.parametrize(("name", "tuning"), [("flexible_joint.toml", "filtered"), ("geared_motor.py", "high_gain")])
def test_a_norm_that_is_far_from_round_is_proved(name: str, tuning: str) -> None:
    """Whose P has eigenvalues 10^7 times others, in the coordinates that an error has by its units."""
    step = load(MODELS / name).step(tuning)
    known, (above,) = hg.contraction(step), (check for check in step.observer.checks if check.id.fact == "theta")
    assert known.proved
    assert above.verdict is Verdict.PROVED
    assert known.reach.least is not None
    assert known.reach.least < 0.75 * float(step.observer.gains[0].initial[0])


@pytest.mark.full
def test_a_step_without_a_norm_says_which_slope_hinders_and_by_how_much() -> None:
    known = hg.contraction(load(MODELS / "chua.toml").step("high_gain"))
    assert not known.proved
    said = str(known.checks[0].reason)
    assert "no norm is found for all slopes in their ranges, db_3/dz2 in [" in said
    assert said.endswith("hinders most; one is with 0.84 of the ranges of all slopes of b")


def test_a_share_of_the_ranges_keeps_what_is_no_slope_of_b() -> None:
    """The saturations of peaking_free pass from nothing to all, whatever b does."""
    error = load(MODELS / "pendulum.py").step("peaking_free").observer.error
    less = error.narrowed(Fraction(1, 2))
    for one, other in zip(error.slopes, less.slopes, strict=True):
        factor = Fraction(1, 2) if one.entry else 1
        assert (other.low, other.high) == (one.low * factor, one.high * factor)
    assert {slope.entry is None for slope in less.slopes} == {True, False}
