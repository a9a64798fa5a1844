"""The observer that puts the output error into the argument of b: its equations, what slopes read, what is proved."""

import copy
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from oracle.circle_criterion import circle_criterion as oracle
from oracle.sampled import run
from plants import model
from scipy.integrate import trapezoid
from test_cli import as_json, hgogen

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.certificates.rate_and_noise import tuned
from hgogen.model import load
from hgogen.prove import gain_design, semidefinite
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.inequality import driven_by_multipliers
from hgogen.reading.given import BadGain
from hgogen.recheck.context import Context
from hgogen.recheck.inclusion import argument_of
from hgogen.recheck.text import expression
from hgogen.recheck.verification import read, recheck
from hgogen.stepping.machine import Machine
from hgogen.trial import try_out


def joint(linear: bool = False, late: bool = False) -> hg.System:
    """x1' = 2 x2, x2' = -4 sin x1 - x2/2, x3' = .. in x1 and x3, y1 = 3 x1, y2 = x3/2; `linear` with slopes at the ends
    of their ranges."""
    x1, x2, x3 = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "x3"))
    bend = -4 * x1 if linear else -4 * sp.sin(x1)
    flow = [2 * x2, bend - x2 / 2, x1 / 4 - x3]
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    return hg.System("joint", states=(x1, x2, x3), outputs=outputs, flow=flow, output=[3 * x1, x3 / 2])


ARGUMENT = ((0.25, -0.3), (1.5,))


@cache
def observer(linear: bool = False, argument: Any = ARGUMENT, theta: float = 6) -> hg.Observer:
    form = hg.forms.block_triangular(joint(linear))
    return hg.observers.circle_criterion(form, theta=theta, poles=((-1, -1), (-1,)), argument=argument)


@cache
def pendulum(argument: Any = None, theta: float = 20) -> hg.Observer:
    form = hg.forms.triangular(model("pendulum"))
    return hg.observers.circle_criterion(form, theta=theta, poles=(-1, -1), argument=argument)


# --- the equations ----------------------------------------------------------------------------------------------------


def b(z: np.ndarray, u: np.ndarray) -> np.ndarray:
    x = np.clip(z, -2, 2)
    return np.array([0, -4 * np.sin(x[0]) - x[1] / 2, x[0] / 4 - x[2]])


@pytest.mark.parametrize("theta", [1.0, 6.0])
def test_a_run_is_that_of_the_equations(theta: float) -> None:
    """Samples that miss are among them, and an argument beyond the ranges of b."""
    made = observer(theta=theta)
    step = hg.sample(made, hg.methods.rk4, dt=0.01)
    rng = np.random.default_rng(1)
    y = rng.uniform(-1, 1, (60, 2)) + np.linspace(0, 1.2, 60)[:, None]
    y[rng.random((60, 2)) < 0.2] = np.nan
    K = (np.array([2 / 3, 1 / 6]), np.array([2.0]))
    A, C = np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]]), np.array([[3.0, 0, 0], [0, 0, 0.5]])
    wanted = run(oracle(K, tuple(map(np.array, ARGUMENT)), theta, A, C, b), np.zeros(3), y, 0.01)
    states = Machine(step).record(np.zeros((60, 0)), y)[0]
    assert np.nanmax(1.5 * y[:, 1]) > 2
    assert np.abs(wanted).max() > 0.1
    np.testing.assert_allclose(states, wanted, rtol=1e-12, atol=1e-12)


def test_an_input_in_an_output_is_none_of_its_error() -> None:
    """y = x1 + u/2 less u/2 is x1: the estimates are those by a plant that shows x1 alone."""
    x1, x2, u = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "u"))
    rng, dt, states = np.random.default_rng(2), 0.01, []
    v, y = rng.uniform(-1, 1, (40, 1)), rng.uniform(-1, 1, (40, 1))
    for share in (sp.Rational(1, 2), sp.S.Zero):
        flow, output = [x2, u - 4 * sp.sin(x1)], [x1 + share * u]
        plant = hg.System("fed", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=output)
        made = hg.observers.circle_criterion(hg.forms.triangular(plant), theta=6, poles=(-1, -1), argument=(0.5, 0.3))
        states.append(Machine(hg.sample(made, hg.methods.rk4, dt=dt)).record(v, y + float(share) * v)[0])
    assert np.abs(states[1]).max() > 0.1
    np.testing.assert_allclose(*states, rtol=1e-9, atol=1e-12)


def test_by_default_b_reads_the_samples() -> None:
    """N_1 = 1/a_1: a change of the first state of a chain, the sample as it is, moves b by nothing."""
    made = observer(argument=None)
    assert "N = (0.3333333333333333), (2)" in made.equations
    read = {slope.entry: slope.reads for slope in error_of(made).slopes}
    assert read[1, 0] == read[2, 0] == read[2, 2] == (0, 0, 0)
    assert read[1, 1] == (0, 1, 0)


def error_of(made: hg.Observer) -> Inclusion:
    assert isinstance(made.error, Inclusion)
    return made.error


def test_what_slopes_read_is_what_the_argument_is_given() -> None:
    """e_j - N_j (3 e_1 - v_1), e_3 - N_3 (e_3/2 - v_2), in units in which e_i = s_i (z_i - x_i); exactly."""
    error = error_of(observer())
    s = [Fraction(str(x)) for x in error.scale]
    assert s != [1, 1, 1]
    for slope in error.slopes:
        assert slope.entry is not None
        j = slope.entry[1]
        chain, entry = (1, Fraction(3, 2)) if j == 2 else (0, Fraction(ARGUMENT[0][j]))
        a, head = ((Fraction(3), 0), (Fraction(1, 2), 2))[chain]
        wanted = [Fraction(int(k == j)) - (k == head) * entry * a * s[j] / s[head] for k in range(3)]
        assert list(slope.reads) == wanted
        assert list(slope.takes) == [(k == chain) * entry * s[j] for k in range(2)]


# --- what is proved ---------------------------------------------------------------------------------------------------


def test_slopes_in_a_sample_ask_for_no_theta() -> None:
    """The pendulum's sine is of the measured angle: with it in the argument any theta is proved, .01 as 4.44 before."""
    (check,) = (each for each in pendulum().checks if each.id == "circle_criterion.convergence")
    assert check.verdict is hg.Verdict.PROVED
    assert "above 0.01" in str(check.reason)
    step = hg.sample(pendulum(theta=1.0), hg.methods.rk4, dt=0.02)
    assert hg.contraction(step).proved


@pytest.mark.ordinary(
    "argument0-euler", "None-euler", "None-rk4", "None-exponential", "None-bilinear", "argument2-euler"
)
@pytest.mark.parametrize("method", ["euler", "rk4", "exponential", "bilinear"])
@pytest.mark.parametrize("argument", [ARGUMENT, None, ((1.0, 0.2), (-1.0,))])
def test_no_noise_moves_a_linear_plant_further(argument: Any, method: str) -> None:
    """Its slopes are ends of their ranges, so that the sums of |response| are what the worst noise does: no more than
    the bound, and for a bound that holds for all slopes not a third of it."""
    step = hg.sample(observer(True, argument), getattr(hg.methods, method), dt=0.02)
    gain = hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    for j, name in enumerate(("y1", "y2")):
        y = np.zeros((200, 2))
        y[40, j] = 1e-3
        machine = Machine(step)
        response = np.abs(machine.record(np.zeros((200, 0)), y)[0]).sum(axis=0) / 1e-3
        for x, reached in zip(("x1", "x2", "x3"), response, strict=True):
            bound = gain.gains[x, name]
            assert reached <= bound * (1 + 1e-9), (x, name)
    assert gain.gains["x2", "y1"] < 3 * response_of(step, "x2", "y1")


def test_no_noise_moves_a_linear_plant_further_where_chains_end_together() -> None:
    """A chain of one state is late by a power of theta, of a sample as of what it adds to an argument."""
    x1, x2, x3 = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "x3"))
    flow, outputs = [2 * x2, -x1 / 9 - x2 / 2, x2 / 4 - x3], (hg.Signal("y1"), hg.Signal("y2"))
    plant = hg.System("late", states=(x1, x2, x3), outputs=outputs, flow=flow, output=[3 * x1, x3 / 2])
    form = hg.forms.block_triangular(plant)
    assert form.alignment == "end"
    made = hg.observers.circle_criterion(form, theta=6, poles=((-1, -1), (-1,)), argument=((0.25, -0.3), (4,)))
    step = hg.sample(made, hg.methods.rk4, dt=0.02)
    gain = hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    for x, y in gain.gains:
        assert response_of(step, x, y) <= gain.gains[x, y] * (1 + 1e-9)
    assert gain.gains["x3", "y2"] < 1.5 * response_of(step, "x3", "y2")
    content = certificate(form, (*made.checks, gain.check), made.name)
    rows = {row.id: row.found for row in recheck(sealed(content)).rows}
    assert rows["circle_criterion.noise"] == "verified"


def response_of(step: hg.Step, state: str, output: str) -> float:
    y = np.zeros((200, 2))
    y[40, ("y1", "y2").index(output)] = 1e-3
    rows = Machine(step).record(np.zeros((200, 0)), y)[0]
    return float(np.abs(rows[:, ("x1", "x2", "x3").index(state)]).sum() / 1e-3)


def test_in_continuous_time_bounds_hold_at_frozen_slopes() -> None:
    """e' = (A - K C + d onto (reads)) e + (K + d onto takes) v, d at the ends of its ranges, where noise comes in
    by b as much as by K."""
    argument, theta = (0.8, -0.4), 5.0
    made = pendulum(argument, theta)
    known = hg.design.noise_bounds(made)
    worst, peak = np.zeros(2), 0.0
    for steep, damping in product((-19.6, 19.6), (-0.1, 0.0)):
        N, K = np.array([0.8, -0.4 * theta]), np.array([2 * theta, theta**2])
        M = np.array([[-K[0], 1], [-K[1], 0]])
        M[1] += steep * np.array([1 - N[0], 0]) + damping * np.array([-N[1], 1])
        B = K + np.array([0, steep * N[0] + damping * N[1]])
        worst = np.maximum(worst, moved(M, B))
        at = 1j * np.linspace(0, 20, 400)[:, None, None] * np.eye(2)
        peak = max(peak, float(np.abs(np.linalg.solve(at - M, np.tile(B[:, None], (400, 1, 1)))[:, 1]).max()))
    said = np.array([known["q", "y"], known["w", "y"]])
    assert (worst <= said * (1 + 1e-3)).all()
    assert (said < 1.5 * worst).all()
    l2 = hg.l2_gain(made, noise={"y": 1}, of={"w": 1, "q": 0})
    assert peak <= l2.gain <= 1.5 * peak


def moved(M: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The integrals of |exp(M t) B|."""
    values, vectors = np.linalg.eig(M)
    t = np.linspace(0, 12 / -values.real.max(), 20000)
    rows = vectors @ (np.exp(np.outer(values, t)) * np.linalg.solve(vectors, B.astype(complex))[:, None])
    return trapezoid(np.abs(rows.real), t, axis=1)


# --- certificates -----------------------------------------------------------------------------------------------------


@cache
def content() -> dict[str, Any]:
    made = observer()
    step = hg.sample(made, hg.methods.rk4, dt=0.01)
    noise, start, error = hg.noise_gain(step), hg.start_set(step), hg.error_bound(step, noise={"y1": 1e-3})
    assert isinstance(noise, hg.NoiseGain)
    assert isinstance(start, hg.StartSet)
    flow = hg.iss_gain(made, noise={"y1": 1e-3})
    checks = (*made.checks, *hg.contraction(step).checks, noise.check, start.check, error.check, flow.check)
    return certificate(made.form, checks, made.name)


FACTS = ("convergence", "theta", "step", "shorter", "tuned", "noise", "start", "error", "iss_gain")


def found_of(changed: dict[str, Any]) -> dict[str, str]:
    rows = {row.id: row.found for row in recheck(sealed(changed)).rows}
    return {fact: rows[f"circle_criterion.{fact}"] for fact in FACTS}


@pytest.mark.full
def test_every_claim_is_verified() -> None:
    assert found_of(content()) == dict.fromkeys(FACTS, "verified")


@pytest.mark.full
def test_what_is_read_in_other_units() -> None:
    """In (1, 2, 5) z: e_1 - (3/4) e_1, e_2 + (9/10) 2 e_1, e_3 - (3/4) e_3, and 1/4 v_1, -3/10 2 v_1, 3/2 5 v_2."""
    context = Context(read(sealed(content())))
    texts = [[expression(text, {}) for text in row] for row in (("1/4", "-3/10", "3/2"), ("1", "2", "5"))]
    argument = argument_of(context, *texts)
    assert argument.reads == [[Fraction(1, 4), 0, 0], [Fraction(9, 5), 1, 0], [0, 0, Fraction(1, 4)]]
    assert argument.from_y == [[Fraction(1, 4), 0], [Fraction(-3, 5), 0], [0, Fraction(15, 2)]]


@pytest.mark.full
def test_of_sensors_that_show_one_state_each_is_in_the_argument_by_its_share() -> None:
    """y3 = -y2 counts as much as y2 does; a proof of the noise of one is none for that of both as one."""
    plant = joint()
    third = replace(plant, outputs=(*plant.outputs, hg.Signal("y3")), output=(*plant.output, -plant.output[1]))
    made = hg.observers.circle_criterion(
        hg.forms.block_triangular(third), theta=6, poles=((-1, -1), (-1,)), argument=ARGUMENT
    )
    noise = hg.noise_gain(hg.sample(made, hg.methods.rk4, dt=0.01))
    assert isinstance(noise, hg.NoiseGain)
    assert noise.gains["x3", "y2"] == pytest.approx(noise.gains["x3", "y3"], rel=1e-3)
    rows = {
        row.id: row.found
        for row in recheck(sealed(certificate(made.form, (*made.checks, noise.check), made.name))).rows
    }
    assert rows["circle_criterion.noise"] == "verified"


@pytest.mark.ordinary("2--40")
@pytest.mark.parametrize(("place", "entry"), [(0, "2"), (1, "-20"), (2, "-40")])
def test_another_argument_is_not_what_was_proved(place: int, entry: str) -> None:
    changed = copy.deepcopy(content())
    changed["observer"]["argument"][place] = entry
    assert "fails" in found_of(changed).values()


@pytest.mark.parametrize("fact", ["noise", "error", "iss_gain"])
def test_noise_in_the_argument_counts(fact: str) -> None:
    """An N that adds to what slopes read little of the errors and much of the samples."""
    changed = copy.deepcopy(content())
    changed["observer"]["argument"] = ["1/3", "-10", "2"]
    assert found_of(changed)[fact] == "fails"


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ((0, 0), "is 0 throughout"),
        ((1, 2, 3), "must be 2 finite numbers"),
        ((float("nan"), 0), "must be 2 finite numbers"),
        ("y", "argument = 'y' must be a number or an array of numbers"),
        ((), "is empty, as of a designed gain where none does better: take high_gain"),
        ((1, -1e16), r"must be numbers up to 1e\+15; take other units"),
    ],
)
def test_an_argument_that_is_none_is_refused(argument: Any, said: str) -> None:
    with pytest.raises(BadGain, match=said):
        hg.observers.circle_criterion(
            hg.forms.triangular(model("pendulum")), theta=20, poles=(-1, -1), argument=argument
        )


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("[0.25, -0.3]", "argument = [0.25, -0.3] must be 2 sequences, one for each output with a chain, or a matrix"),
        ("[[0.25, 0, 1], [1.5]]", "argument = [[0.25, 0, 1], [1.5]] must be 2 and 1 finite numbers"),
        ("[[0, 0], [0]]", "argument is 0 throughout"),
        ("true", "argument = True must be 2 sequences"),
    ],
)
def test_an_argument_of_a_text_model_that_is_none_is_refused(argument: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "two.toml"
    path.write_text(TWO.format(argument=argument))
    for command in ("check", "build", "simulate"):
        out = ("-o", str(tmp_path / "out")) if command == "build" else ()
        _, err = hgogen(command, str(path), "--observer", "circle_criterion", *out, status=2)
        assert f"two.toml, tuning.circle_criterion: {said}" in " ".join(err.split())


TWO = """
name = 'two'
[states]
x1 = {{low = -2, high = 2, flow = '2*x2'}}
x2 = {{low = -2, high = 2, flow = '-4*sin(x1) - x2/2'}}
x3 = {{low = -2, high = 2, flow = 'x1/4 - x3'}}
[outputs]
y1 = {{equation = '3*x1', low = -6, high = 6}}
y2 = {{equation = 'x3/2', low = -1, high = 1}}
[trial]
duration = 2
start = {{x1 = 1, x2 = 0, x3 = 0}}
[tuning.circle_criterion]
form = 'block_triangular'
dt = 0.01
theta = 6
poles = [[-1, -1], [-1]]
argument = {argument}
"""


@pytest.mark.full
@pytest.mark.parametrize("argument", ["[[0.25, -0.3], [1.5]]", "[[0.25, 0], [-0.3, 0], [0, 1.5]]"])
def test_a_text_model_says_the_argument(argument: str, tmp_path: Path) -> None:
    """Chain by chain or as a matrix, in every command that takes an observer."""
    path, out = tmp_path / "two.toml", ("-o", str(tmp_path / "out"))
    path.write_text(TWO.format(argument=argument))
    named = "--observer", "circle_criterion"
    step = load(path).step("circle_criterion")
    assert hg.design.noise_bounds(step.observer) == pytest.approx(hg.design.noise_bounds(observer()), rel=1e-3)
    checked = as_json("check", str(path), *named)
    assert [each["verdict"] for each in checked["checks"] if each["id"] == "circle_criterion.theta"] == ["proved"]
    assert as_json("build", str(path), *named, *out)["gains"] == {"theta": 6}
    (trial,) = as_json("simulate", str(path), *named)["trials"]
    assert None not in trial["settled"]
    assert "circle_criterion" in str(as_json("compare", str(path), "--observers", "circle_criterion,high_gain", *out))


def test_a_form_in_the_plant_s_coordinates_is_refused() -> None:
    form = hg.forms.phase(model("pendulum"), original=True)
    with pytest.raises(BadGain, match=r"does not take this form: .* keeps the plant's coordinates; use high_gain"):
        hg.observers.circle_criterion(form, theta=20, poles=(-1, -1))


def test_an_a_that_moves_with_an_input_is_refused() -> None:
    x1, x2, u = (hg.Signal(name, low=1, high=2) for name in ("x1", "x2", "u"))
    plant = hg.System(
        "driven", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=[u * x2, -x1], output=[x1]
    )
    with pytest.raises(BadGain, match="do not move with an input"):
        hg.observers.circle_criterion(hg.forms.triangular(plant), theta=6, gains=(2, 0.5))


# --- gains that are designed ------------------------------------------------------------------------------------------


def damped() -> hg.Form:
    """x1' = x2, x2' = x3 - x2^3, x3' = -x3^3 on -2..2: slopes of one sign in states that nothing measures."""
    x1, x2, x3 = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "x3"))
    flow = [x2, x3 - x2**3, -(x3**3)]
    return hg.forms.triangular(
        hg.System("damped", states=(x1, x2, x3), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    )


@pytest.mark.full
def test_an_argument_takes_noise_that_no_gain_alone_takes() -> None:
    alone = hg.design.gain(damped(), rate=2)
    both = hg.design.gain(damped(), rate=2, argument=True)
    assert alone.argument == ()
    assert both.rate >= 2
    assert both.bounds["x3", "y"] < 0.8 * alone.bounds["x3", "y"]
    made = hg.observers.circle_criterion(damped(), theta=both.theta, gains=both.K, argument=both.argument)
    assert hg.design.noise_bounds(made) == pytest.approx(both.bounds, rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize(("name", "last"), [("disturbed_pendulum", "x3"), ("hyperjerk", "x4")])
def test_the_tunings_that_are_designed_take_noise_at_the_rate_of_high_gain(name: str, last: str) -> None:
    """Less than half of the bound of the tuning with poles, in continuous time; in trials half of the error."""
    loaded = load(name)
    steps = [loaded.step(kind) for kind in ("high_gain", "circle_criterion")]
    before, after = (tuned(step) for step in steps)
    assert before.rate is not None
    assert after.rate is not None
    assert after.rate > 0.95 * before.rate  # which the design proves by a norm of its own
    assert after.continuous[last, "y"] < 0.5 * before.continuous[last, "y"]
    trial = loaded.trials()[-1]
    runs = [next(iter(try_out(step, trial, engine="python", seeds=trial.seeds[:1]))) for step in steps]
    late = [run.error[run.truth.t >= trial.steady_from, -1] for run in runs]
    assert np.std(late[1]) < 0.5 * np.std(late[0])


@pytest.mark.full
def test_of_one_output_the_size_of_noise_does_not_matter() -> None:
    """Nor where it enters through slopes."""
    loud, quiet = (hg.design.gain(damped(), rate=2, argument=(1, 1, 1), noise={"y": size}) for size in (100, 0.01))
    assert loud.bounds == pytest.approx(quiet.bounds, rel=0.02)


@pytest.mark.full
def test_a_multiplier_for_one_slope_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the corners of one slope have, a multiplier has the gain of the least bounds."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    flow, y = [x2, -2 * x2**3], hg.Signal("y")
    form = hg.forms.triangular(hg.System("one", states=(x1, x2), outputs=(y,), flow=flow, output=[x1]))
    corners = hg.design.gain(form, rate=1, argument=(1, 1), theta=1)
    monkeypatch.setattr(gain_design, "vertex_systems", lambda e: (e,))
    multiplier = hg.design.gain(form, rate=1, argument=(1, 1), theta=1)
    assert multiplier.bounds == pytest.approx(corners.bounds, rel=0.01)


def test_the_program_with_multipliers_is_the_inequality_that_it_stands_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """V' + alpha V + sum S_j ((H e + E v)_j^2 - w_j^2) - sum lambda_j v_j^2, at any P, Y, S, lambda, e, w and v."""
    monkeypatch.setattr(gain_design, "vertex_systems", lambda e: (e,))
    rng, n, m, p = np.random.default_rng(5), 3, 2, 2
    M, G, H, C, D, B, E = map(rng.standard_normal, [(n, n), (n, m), (m, n), (p, n), (p, m), (n, p), (m, p)])
    program = gain_design._Program(gain_design.Open(M, G, H, C, D, B, E, (0, 0, 1)), rate=1, alpha=1.5)
    at = rng.standard_normal(program._size)
    of_P, of_Y, _ = program._sizes
    form = driven_by_multipliers(*program._ends, 1.5)
    whole = np.tensordot(np.append(at[: of_P + of_Y], at[-p - m :]), semidefinite.coefficient_matrices(form), 1)
    _, (A, _, _) = program._falling()
    assert A @ np.append(at, 0.0) == pytest.approx(semidefinite._packed(whole[None])[:, 0], rel=1e-12)
    P, Y = np.tensordot(at[:of_P], semidefinite.basis(n), 1), at[of_P : of_P + of_Y].reshape(n, p)
    e, w, v = (rng.standard_normal(size) for size in (n, m, p))
    change = 2 * e @ P @ (M @ e + G @ w + B @ v) - 2 * e @ Y @ (C @ e + D @ w - v)
    slopes = at[-p - m : -p] @ ((H @ e + E @ v) ** 2 - w**2)
    inequality = change + 1.5 * e @ P @ e + slopes - at[-p:] @ v**2
    point = np.concatenate([e, w, v])
    assert point @ whole @ point == pytest.approx(inequality, rel=1e-12)


@pytest.mark.full
def test_an_argument_that_does_no_better_is_left_out() -> None:
    """The slope of van der Pol's last row in its rate takes no noise from an output error: the gain is that without."""
    form = hg.forms.triangular(load("van_der_pol").plant)
    both = hg.design.gain(form, rate=1.25, argument=True)
    assert both.argument == ()
    assert both == hg.design.gain(form, rate=1.25)


def test_no_argument_is_designed_where_an_a_i_moves() -> None:
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    u = hg.Signal("u", low=1, high=2)
    flow = [u * x2, -x1]
    plant = hg.System("driven", states=(x1, x2), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x1])
    with pytest.raises(BadGain, match=r"not designed for driven: .* do not move with an input; leave it out"):
        hg.design.gain(hg.forms.triangular(plant), rate=1, argument=True)


@pytest.mark.parametrize("argument", [(1, 0.5), np.array([1, 0.5])])
def test_a_given_argument_is_taken_as_it_is(argument: Any) -> None:
    designed = hg.design.gain(hg.forms.triangular(model("pendulum")), rate=10, argument=argument, theta=4)
    assert designed.argument == (1, 0.125)
    assert "N = (1, 0.125)" in str(designed)
    with pytest.raises(BadGain, match="argument"):
        hg.design.gain(hg.forms.triangular(model("pendulum")), rate=10, argument=(1, 2, 3))


def test_a_given_argument_of_zeros_is_none() -> None:
    assert hg.design.gain(hg.forms.triangular(model("pendulum")), rate=10, argument=(0, 0)).observer == "high_gain"


@pytest.mark.full
def test_of_several_outputs_an_argument_is_a_matrix() -> None:
    form = hg.forms.block_triangular(joint())
    designed = hg.design.gain(form, rate=1, argument=((1 / 3, 0), (2,)))
    made = hg.observers.circle_criterion(form, theta=designed.theta, gains=designed.K, argument=designed.argument)
    assert hg.design.noise_bounds(made) == pytest.approx(designed.bounds, rel=0.02)
