"""The Kalman-like observer: its form, the persistence of inputs, and the observer where a_2(u) vanishes."""

import json
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from form_answers import assert_same_plant
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import kalman_like as oracle
from plants import MODELS, chain, model

import hgogen as hg
from hgogen import excitation
from hgogen.analysis.chain import measurements
from hgogen.certificates.certificate import certificate
from hgogen.check import Check, ClaimId, Refuted, Verdict
from hgogen.discretisation.stability import Limit
from hgogen.emit import layout
from hgogen.estimators.persistence import persistent
from hgogen.estimators.riccati_part import unpack
from hgogen.model import load
from hgogen.reading.given import BadGain
from hgogen.recheck.verification import recheck
from hgogen.run import native
from hgogen.run.native import run_check
from hgogen.theorem import rows
from hgogen.trial import Truth, simulate, t, try_out

NAN = float("nan")
EPS_NEURON = 0.8
SHOWN = ClaimId("input", "persistence")
WAVE = {"inputs": {"u": sp.sin(t)}, "period": 2 * sp.pi}
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

# --- the form -----------------------------------------------------------------------------------------------

x1, x2, x3 = (hg.Signal(f"x{i}", low=-5, high=5) for i in (1, 2, 3))
u, v = hg.Signal("u", low=-1, high=1), hg.Signal("v", low=-1, high=1)
y1, y2 = hg.Signal("y1"), hg.Signal("y2")


def plant(flow: list[Any], *output: Any) -> hg.System:
    states = (x1, x2, x3)[: len(flow)]
    return hg.System("plant", states=states, inputs=(u, v), outputs=(y1, y2)[: len(output)], flow=flow, output=output)


def structure(flow: list[Any], *output: Any) -> tuple[str, str]:
    check = hg.forms.state_affine(plant(flow, *output)).checks[0]
    return str(check.verdict), str(check.reason)


@pytest.mark.parametrize(
    ("flow", "output", "verdict", "said"),
    [
        ([u * x2, -sp.sin(x1) * x2], (x1,), "proved", "the outputs show x1"),
        ([x2 + x1**3, x1 * x2], ((2 + u) * x1 + v,), "proved", "the outputs show x1"),
        ([u * x2, -x1], (u * x1,), "proved", "no state alone"),  # u x1 does not tell x1 where u = 0
        ([x2, -x1], (x1 + x2,), "proved", "no state alone"),
        ([u * x2, sp.sin(x2)], (x1,), "refuted", "x2' has the slope cos(x2) in x2, which varies with x2"),
        ([u * x2 * x3, 0, 0], (x1,), "refuted", "varies with"),
        ([x2, sp.sign(x2)], (x1,), "unknown", "x2"),
        ([x2, sp.floor(x2)], (x1,), "unknown", "x2' is not shown to be affine in x2"),
        ([x2, sp.Piecewise((1, x2 > 0), (0, True))], (x1,), "refuted", "x2' is not affine in x2"),  # its slope is 0
        ([x2, -x1], (x1**2,), "refuted", "y1 has the slope 2*x1 in x1, which varies with x1"),
        ([x2 + sp.sin(x1), 0], (u * x1,), "unknown", "x1' has the slope cos(x1)"),
        ([sp.sin(x1 + x2), 0], (x1 + x2,), "unknown", "varies with"),  # of y: recast
        ([x2 * (sp.sin(x2) ** 2 + sp.cos(x2) ** 2), x1], (x1,), "proved", "the outputs show x1"),
        ([x2 * x3, x1 * x3, 0], (x1, x2), "proved", "the outputs show x1, x2"),
    ],
)
def test_structure(flow: list[Any], output: tuple[Any, ...], verdict: str, said: str) -> None:
    answer, reason = structure(flow, *output)
    assert answer == verdict
    assert said in reason


def test_the_form_is_the_plant() -> None:
    form = hg.forms.state_affine(plant([u * x2 + x1 - x1**3 / 3, 3 * sp.sin(x1) - x2 + x1 * x3, 0], (2 + u) * x1 + v))
    assert_same_plant(form)
    z1 = form.states[0]
    assert sp.Matrix([[1, u, 0], [0, -1, z1], [0, 0, 0]]) == form.A
    assert not any(b.free_symbols & set(form.states[1:]) for b in form.b)
    (one,) = measurements(form.system)
    assert (one.state, one.output, one.gain, one.offset) == (0, 0, 2 + u, v)


def test_the_models_that_are_state_affine() -> None:
    """The paper's own example is, with sin x1 of the measured state; friction of the speed is not."""
    verdicts = {name: hg.forms.state_affine(model(name)).checks[0].verdict for name in ("fitzhugh_nagumo", "pendulum")}
    assert set(verdicts.values()) == {Verdict.PROVED}
    assert hg.forms.state_affine(model("geared_motor")).checks[0].verdict is Verdict.REFUTED
    assert hg.survey(model("fitzhugh_nagumo"), deep=True).best.kind != "state_affine"  # nothing said of observability


# --- persistence --------------------------------------------------------------------------------------------


@cache
def neuron() -> hg.Form:
    return hg.forms.state_affine(model("fitzhugh_nagumo"))


def one_input(rate: Any, *parameters: hg.Signal) -> hg.Form:
    """x1' = rate, x2' = 0, y = x1."""
    data = {"states": (x1, x2), "inputs": (u,), "outputs": (y1,), "parameters": parameters}
    return hg.forms.state_affine(hg.System("p", **data, flow=[rate, 0], output=[x1]))


@pytest.mark.parametrize(
    ("expression", "period", "verdict", "said"),
    [
        (sp.sin(t), 2 * sp.pi, "proved", "and so in every period"),
        ("sin(t)", "2*pi", "proved", "and so in every period"),
        (sp.Rational(3, 10), None, "proved", "the pair (C, A) has rank 3"),
        (0, None, "refuted", "the pair (C, A) has a rank below 3"),  # det = -eps u^2
        (sp.sin(t), None, "unknown", "no period is given"),
        (sp.sin(t), 6.283185307179586, "unknown", "not shown that"),
        (sp.sin(t) * sp.exp(-t), 2 * sp.pi, "unknown", "not shown that"),
        (sp.Abs(sp.sin(t)), 2 * sp.pi, "unknown", "kinks"),
        (sp.sin(t), -2 * sp.pi, "unknown", "no positive number"),
        (2 + sp.sin(t), 2 * sp.pi, "unknown", "with the input inside its range"),  # the observer clamps it to 1
        (sp.sin(t) / 2 + sp.Rational(3, 4), 2 * sp.pi, "proved", "and so in every period"),  # clamped in part
        (2, None, "unknown", "the range of u, to which the observer clamps it"),
        (1, None, "proved", "the pair (C, A) has rank 3"),
        (sp.I, None, "unknown", "u = I is not shown to be a finite real number"),
        (sp.sqrt(sp.sin(t)), 2 * sp.pi, "unknown", "sqrt(sin(t)) is not shown to be a finite real number"),
        (sp.log(sp.sin(t)), 2 * sp.pi, "unknown", "log(sin(t)) is not shown to be a finite real number"),
        (1 / sp.sin(t), 2 * sp.pi, "unknown", "1/sin(t) is not shown to be a finite real number"),
        (sp.tan(t), 2 * sp.pi, "unknown", "tan(t) is not shown to be a finite real number"),
    ],
)
def test_persistence_of_a_known_input(expression: Any, period: Any, verdict: str, said: str) -> None:
    check = persistent(SHOWN, neuron(), {"u": expression}, period)
    assert check.verdict == verdict
    assert said in str(check.reason)


def test_persistence_is_for_all_parameters() -> None:
    """x2 is seen through k u; k may be 0 or not."""
    for low, verdict in ((0.5, "proved"), (-0.5, "unknown")):
        k = hg.Signal("k", "", "", 1.0, low=low, high=2)
        check = persistent(SHOWN, one_input(k * u * x2, k), {"u": sp.cos(t)}, 2 * sp.pi)
        assert check.verdict == verdict


def test_persistence_wants_the_structure_proved() -> None:
    """x2 of a Piecewise row stands in b, not in A, whose pair with C has rank 1; the plant shows x2 where u > 0."""
    flow = [sp.Piecewise((x2, u > 0), (0, True)), -x2]
    form = hg.forms.state_affine(hg.System("p", states=(x1, x2), inputs=(u,), outputs=(y1,), flow=flow, output=[x1]))
    check = persistent(SHOWN, form, {"u": 1})
    assert check.verdict is Verdict.UNKNOWN
    assert "not shown that the plant is state-affine" in str(check.reason)


def test_what_is_measured_is_not_known_beforehand() -> None:
    form = hg.forms.state_affine(plant([x1 * x2, 0], x1))
    assert "excitation.along" in persistent(SHOWN, form, {"u": 0, "v": 0}).fix
    assert persistent(SHOWN, form, {"u": 0, "v": 0}).verdict is Verdict.UNKNOWN
    with pytest.raises(BadGain, match="inputs 'v' must be given"):
        persistent(SHOWN, form, {"u": 0})
    with pytest.raises(BadGain, match=r"must be an expression of hgogen\.trial\.t alone"):
        persistent(SHOWN, form, {"u": x1, "v": 0})
    with pytest.raises(BadGain, match=r"is no expression of the time"):
        persistent(SHOWN, form, {"u": "__import__('os')", "v": 0})


def test_a_rank_that_only_the_derivative_gives() -> None:
    """x1' = u x2 + v x3: N_1 = (0, u, v), N_2 = (0, u', v'), and u v' - v u' = -1 for sin, cos; 0 for a multiple."""
    form = hg.forms.state_affine(plant([u * x2 + v * x3, 0, 0], x1))
    turning = persistent(SHOWN, form, {"u": sp.sin(t), "v": sp.cos(t)}, 2 * sp.pi)
    assert turning.verdict is Verdict.PROVED
    assert persistent(SHOWN, form, {"u": sp.sin(t), "v": 2 * sp.sin(t)}, 2 * sp.pi).verdict is Verdict.UNKNOWN


def test_an_input_that_a_does_not_read_need_not_be_known() -> None:
    check = persistent(SHOWN, hg.forms.state_affine(model("pendulum")))
    assert (check.verdict, str(check.reason)) == (Verdict.PROVED, "the pair (C, A) has rank 2")
    assert persistent(SHOWN, neuron()).verdict is Verdict.UNKNOWN
    assert persistent(SHOWN, one_input(0 * x2)).verdict is Verdict.REFUTED


def test_a_rank_that_time_gives() -> None:
    """C and CA hide x2 where sin 7 t = 0; another time of the period shows it."""
    assert persistent(SHOWN, one_input(u * x2), {"u": sp.sin(7 * t)}, 2 * sp.pi / 7).verdict is Verdict.PROVED


def test_windows_of_a_record() -> None:
    """W of x1' = u x2, x2' = 0: [[d, U], [U, V]] with the integrals of the integral of u; in closed form for u = 1:
    d, d^2/2, d^3/3, times R^-1 and the half-widths 5."""
    form, N = one_input(u * x2), 401
    windows = excitation.along(form, 0.1, np.ones(N), np.zeros(N), 0.01, 2.0)
    W = 25 / 0.1 * np.array([[2, 2], [2, 8 / 3]])
    assert windows.smallest == pytest.approx(np.linalg.eigvalsh(W)[0], rel=1e-9)  # cubic: Simpson's rule is exact
    assert excitation.shown("p", windows).verdict is Verdict.UNKNOWN
    hidden = excitation.along(form, {"y1": 0.1}, np.zeros(N), np.zeros(N), 0.01, 2.0)
    quiet = replace(windows, smallest=1e-20 * windows.smallest, largest=1e-20 * windows.largest)
    assert excitation.shown("p", quiet).verdict is Verdict.UNKNOWN  # a larger R hides nothing
    check = excitation.shown("p", hidden)
    assert (check.verdict, hidden.weakest[0]) == (Verdict.REFUTED, "x2")
    for bad in (
        {"d": 9.0},
        {"d": NAN},
        {"dt": 0.0},
        {"dt": -0.01, "d": -0.1},
        {"dt": "a"},
        {"R": -1.0},
        {"y": np.full(N, NAN)},
        {"u": np.zeros((N, 2))},
    ):
        with pytest.raises(BadGain):
            excitation.along(form, **{"R": 0.1, "u": np.zeros(N), "y": np.zeros(N), "dt": 0.01, "d": 2.0, **bad})


@pytest.mark.full
def test_the_neurons_windows() -> None:
    """A window of a whole period shows a hundred times what one of d = 1 does at its worst."""
    truth = noiseless(0.05)
    least = [excitation.along(neuron(), 0.008, truth.u, truth.y, 0.05, d).range[0] for d in (1.0, 6.3)]
    assert least[0] < 1 < 100 < least[1]


# --- the observer -------------------------------------------------------------------------------------------


def kalman_like(**changes: Any) -> hg.Observer:
    return hg.observers.kalman_like(neuron(), **{"rho": 1.0, "R": 0.05, **WAVE, **changes})


def caps(observer: hg.Observer) -> np.ndarray:
    """The diagonal of S_0^-1."""
    (part,) = observer.parts
    return part.cap


def A_neuron(u: float, v: np.ndarray) -> np.ndarray:
    return np.array([[1, -u, 0], [0, -EPS_NEURON, -EPS_NEURON], [0, 0, 0]])


def b_neuron(u: float, v: np.ndarray) -> np.ndarray:
    return np.array([-(v[0] ** 3) / 3, 3 * EPS_NEURON * np.sin(v[0]), 0])


def record(dt: float, duration: float) -> dict[str, np.ndarray]:
    time = np.arange(round(duration / dt) + 1) * dt
    return {"u": np.sin(time), "y": 1.5 * np.cos(0.7 * time + 0.3)}


def test_it_is_the_oracles() -> None:
    """With samples missing: rounding only."""
    data, h = record(0.01, 8.0), 0.01
    data["y"][300:340] = NAN
    data["y"][500:700:3] = NAN
    start = np.array([0.5, -1.0, 2.0])
    observer = kalman_like(initial=start, covariance=(1.0, 2.0, 3.0))
    run = hg.sample(observer, dt=h).run(**data, engine="python")
    P = np.diag([1.0, 2, 3])
    samples = (data["u"], data["y"][:, None], caps(observer))
    expected = oracle.run(A_neuron, b_neuron, 1.0, np.array([0.05]), start, P, h, *samples)
    assert run.x == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@cache
def rotor() -> hg.Form:
    """Two outputs, and a speed that turns what they show: A depends on what is measured."""
    flow = [-x1 + x2 * x3 + u, -x2 - x1 * x3 - x3 + v, -x3 / 5 + x2]
    return hg.forms.state_affine(plant(flow, x1, x2))


def test_two_outputs_are_the_oracles() -> None:
    h, time = 0.01, np.arange(601) * 0.01
    y = np.column_stack([np.cos(time), np.sin(0.6 * time)])
    y[200:230, 0] = NAN
    y[210:260, 1] = NAN
    R = np.array([0.1, 0.05])
    observer = hg.observers.kalman_like(rotor(), rho=0.7, R=R, covariance=(1.0, 1.0, 4.0))
    run = hg.sample(observer, dt=h).run(u=np.column_stack([np.sin(time), 0 * time]), y=y, engine="python")
    expected = oracle.run(
        lambda u, v: np.array([[-1, 0, v[1]], [0, -1, -v[0] - 1], [0, 1, -0.2]]),
        lambda u, v: np.array([u, 0, 0]),
        0.7,
        R,
        np.zeros(3),
        np.diag([1.0, 1, 4]),
        h,
        np.sin(time),
        y,
        caps(observer),
    )
    assert not run.status[:200].any()
    assert run.x == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the limit of dt by the covariance, which takes seconds to find."""
    monkeypatch.setattr("hgogen.method.covariance_limits", lambda *arguments: [Limit(np.inf, "not asked")])


@pytest.mark.full
@pytest.mark.usefixtures("unchecked")
def test_every_view_is_of_one_equation() -> None:
    """S and P by RK4 of order 4; L D L' and S S' of order 1, the same but for rounding."""
    errors: dict[str, list[float]] = {}
    for dt in (0.01, 0.005):
        samples, observer = record(dt, 0.6), kalman_like(covariance=(1.0, 1.0, 1.0))
        exact = hg.reference(observer, **samples, dt=dt).x
        for name in ("rk4", "rk4_covariance", "continuous_discrete", "cholesky"):
            estimates = hg.sample(observer, getattr(hg.methods, name), dt=dt).run(**samples, engine="python").x
            errors.setdefault(name, []).append(float(np.abs(estimates - exact).max()))
    orders = {name: np.log2(coarse / fine) for name, (coarse, fine) in errors.items()}
    assert min(orders["rk4"], orders["rk4_covariance"]) > 3.5
    assert orders["continuous_discrete"] == pytest.approx(1, abs=0.25)
    assert errors["cholesky"] == pytest.approx(errors["continuous_discrete"], rel=1e-6)


def test_loops_are_the_unrolled_step(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = record(0.01, 3.0)
    unrolled = hg.sample(kalman_like(), dt=0.01).run(**samples, engine="python").x
    monkeypatch.setattr("hgogen.estimators.factored.LONGER", {"speed": -(10**9)})
    looped = hg.sample(kalman_like(), dt=0.01).run(**samples, engine="python").x
    assert looped == pytest.approx(unrolled, abs=1e-9 * np.abs(unrolled).max())


@cache
def noiseless(dt: float = 0.01) -> Truth:
    """The first 30 time units of the model's trial."""
    trial = load(MODELS / "fitzhugh_nagumo.py").trials()[0]
    return simulate(model("fitzhugh_nagumo"), replace(trial, duration=30, jumps=(), steady=27), dt)


@pytest.mark.usefixtures("unchecked")
def test_the_weighted_error_forgets_at_its_rate() -> None:
    """(e' S e)' = -rho (e' S e - e' S_0 e) - |C e|^2/R: exp(rho t) e' S e gains rho exp(rho t) e' S_0 e at most.
    Until what y misses on the line between two samples, some 1e-5, is all that is left."""
    truth, observer = noiseless(), kalman_like(initial=(3.0, -8.0, -6.0), covariance=(1.0, 4.0, 9.0))
    step = hg.sample(observer, hg.methods.rk4, dt=0.01)
    values, priors = [], []
    for k in range(400):
        step(truth.u[k, 0], truth.y[k, 0])
        state = np.frombuffer(bytes(step._kept.state), layout.state_type(step))
        S = np.array(ca.DM(unpack(ca.SX(ca.DM(state["S"][0])), 3)))
        error, grown = state["z"][0] - truth.x[k], np.exp(0.01 * k)
        values.append(grown * (error @ S @ error))
        priors.append(grown * np.sum(error**2 / caps(observer)))
    gained = 0.01 * (np.array(priors)[1:] + priors[:-1]) / 2
    assert (np.diff(values) <= gained + 1e-4 * values[0]).all()
    assert values[-1] < 0.9 * values[0]


@pytest.mark.full
@needs_compiler
@given(st.floats(-3.5, 3.5), st.floats(-10, 10), st.floats(-8, 8))
@settings(deadline=None, max_examples=4)
def test_it_converges_from_anywhere(a: float, b: float, c: float) -> None:
    """Without noise, rho = 1: exp(-rho t/2) of some 10 is below 1e-5 after 30, where a_2(u) = -u keeps crossing 0.
    What is left is the line between two samples, which misses y by y'' dt^2/8."""
    truth = noiseless()
    run = started(a, b, c).run(u=truth.u[:3000], y=truth.y[:3000])
    assert np.abs(run.x[-500:] - truth.x[2500:3000]).max() < 2e-3


@cache
def started(*initial: float) -> hg.Step:
    return hg.sample(kalman_like(initial=initial), dt=0.01)


def test_an_input_that_hides_is_said_and_survived() -> None:
    """u = 0 for 60 time constants of the forgetting: P is near S_0^-1, the estimate finite; then it comes back."""
    truth = noiseless()
    step = hg.sample(kalman_like(), dt=0.01)
    quiet = step.run(u=np.zeros(6000), y=np.zeros(6000), engine="python")
    assert np.isfinite(quiet.x).all()
    assert "COVARIANCE_LIMITED" in step.flags(quiet.status[-1])
    assert not any("RESTARTED" in step.flags(status) for status in np.unique(quiet.status))
    back = step.run(u=truth.u[:3000], y=truth.y[:3000], engine="python")
    assert np.abs(back.x[-500:] - truth.x[2500:3000]).max() < 2e-3
    assert step.flags(back.status[-1]) == ()
    (bit,) = (bit for bit in step.layout.bits if bit.name == "COVARIANCE_LIMITED")
    assert "the input shows too little" in bit.meaning


@pytest.mark.ordinary("double")
@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
def test_its_c_runs(real: Any) -> None:
    run_check(hg.targets.c99(hg.sample(hg.observers.kalman_like(rotor(), rho=0.7, R=0.1), dt=0.01), real=real))


def test_kinks_stay_as_they_are_written_and_are_verified() -> None:
    form = hg.forms.state_affine(plant([u * x2 - sp.Max(0, x1 - 1), -x1 - x2], x1))
    assert form.b == (-sp.Max(0, form.states[0] - 1), 0)
    assert set(rechecked(form, form.checks).values()) == {"verified"}


@pytest.mark.parametrize("drag", [sp.Max(0, x1 - 1), sp.Abs(x1) * x2, sp.Min(1, u) * x2, sp.sqrt(x1**2 + u**2) * x2])
def test_kinks_of_what_is_measured_are_run(drag: Any) -> None:
    """The program reads the kinks that proofs write as norms."""
    form = hg.forms.state_affine(plant([x2 - drag, -x1 - x2], x1))
    step = hg.sample(hg.observers.kalman_like(form, rho=2, R=1e-3), dt=0.01)
    at = {form.states[0]: 1.5, form.states[1]: -0.5, u: 0.25, v: 0}
    flow = (sp.Matrix(form.A) * sp.Matrix(form.states) + sp.Matrix(form.b)).subs(at)
    assert float(flow[0]) == pytest.approx(float((x2 - drag).subs({x1: 1.5, x2: -0.5, u: 0.25})))
    run = step.run(u=np.zeros((50, 2)), y=np.zeros(50))
    assert np.isfinite(run.x).all()


@pytest.mark.full
@needs_compiler
def test_eight_states_in_loops() -> None:
    """The chain is state-affine: sin x1 is of the measured state."""
    observer = hg.observers.kalman_like(hg.forms.state_affine(chain(8)), rho=1.0, R=1e-6, initial={"x8": 1.0})
    step = hg.sample(observer, dt=0.01)
    run = step.run(u=np.zeros(3000), y=np.zeros(3000))
    assert np.abs(run.x[-1]).max() < 1e-3


@needs_compiler
def test_the_trial_of_the_paper() -> None:
    """Beside the adaptive filter's 8.4 and .0118, medians: settled after 9..20, eta's error .1..4 with noise, which
    enters A and b; each estimate within its range all the while."""
    loaded = load(MODELS / "fitzhugh_nagumo.py")
    table = {key: value for key, value in loaded.module.tuning["kalman_like"].items() if key != "form"}
    step = hg.sample(hg.observers.kalman_like(neuron(), **table), dt=0.01)
    settled, steady = [], []
    for run in try_out(step, loaded.trials()[0], seeds=range(6)):
        time, error = run.truth.t, np.abs(run.error[:, 2])
        inside = np.convolve(error <= 0.3, np.ones(301), "valid") > 300.5
        first = np.flatnonzero(inside & (time[:-300] >= 50))
        settled.append(time[first[0]] - 50)
        steady.append(np.sqrt((error[time > 75] ** 2).mean()))
    assert 8 < np.median(settled) < 20
    assert 0.1 < np.median(steady) < 0.4


def test_the_theorem_is_proved_but_for_operation() -> None:
    observer = kalman_like()
    standings = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert {claim for claim, standing in standings.items() if standing == "refuted"} == set()
    persistence = next(claim for claim in standings if "regularly persistent" in claim)
    assert standings[persistence] == "proved"
    unknown = {c.id: c.verdict for c in kalman_like(inputs=None).checks}
    assert unknown["kalman_like.persistence"] is Verdict.UNKNOWN


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rho": 0.0}, r"rho = 0.0 must be positive"),
        ({"rho": -1.0}, r"rho = -1.0 must be positive"),
        ({"R": (0.1, 0.1)}, r"R of shape \(2,\) must have one number for each of 1 outputs"),
        ({"R": 0.0}, r"R = 0.0 must be positive"),
        ({"covariance": (1.0, 1.0)}, r"covariance of shape \(2,\) must be a diagonal of 3 numbers"),
        ({"initial": {"x1": 99.0}}, r"initial x1 = 99.0 must be finite and in"),
        ({"inputs": {"w": 0}}, r"inputs 'w' is no input of the plant; its inputs are u"),
        ({"inputs": {}}, r"inputs 'u' must be given, as every one of u"),
    ],
)
def test_bad_input_is_a_sentence(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=said):
        kalman_like(**changes)


def test_a_form_or_an_input_that_does_not_fit_is_refused() -> None:
    with pytest.raises(BadGain, match="takes the form state_affine, not one of kind triangular"):
        hg.observers.kalman_like(hg.forms.triangular(model("pendulum")), rho=1, R=1)
    with pytest.raises(BadGain, match="takes a form"):
        hg.observers.kalman_like(None, rho=1, R=1)
    with pytest.raises(Refuted, match=r"state_affine\.structure"):
        hg.observers.kalman_like(hg.forms.state_affine(model("geared_motor")), rho=1, R=1)
    with pytest.raises(Refuted, match=r"kalman_like\.persistence.*Vary the input"):
        kalman_like(inputs={"u": 0}, period=None)
    assert kalman_like(inputs={"u": 0}, period=None, accept="kalman_like.persistence").accepted


# --- certificates -------------------------------------------------------------------------------------------


def rechecked(form: hg.Form, checks: tuple[Check, ...]) -> dict[str, str]:
    return {row.id: row.found for row in recheck(json.dumps(certificate(form, checks))).rows}


@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "lorenz", "pmsm"])
def test_a_second_arithmetic_verifies_the_form(name: str) -> None:
    (path,) = MODELS.glob(f"{name}.*")
    form = hg.forms.state_affine(load(path).plant)
    assert set(rechecked(form, form.checks).values()) == {"verified"}


@pytest.mark.parametrize(
    ("flow", "output"),
    [
        ([u * x2, sp.sin(x2)], (x1,)),  # a rate of what is hidden
        ([x2, -x1], (x1**2,)),  # an output that is not affine
        ([x2 + sp.sin(x1), 0], (u * x1,)),  # measured, where u is not 0
        ([x2 * x3, x1, 0], (x1 + x3,)),  # nothing is shown alone
    ],
)
def test_a_structure_that_is_not_there_is_not_verified(flow: list[Any], output: tuple[Any, ...]) -> None:
    form = hg.forms.state_affine(plant(flow, *output))
    said = replace(form.checks[0], verdict=Verdict.PROVED)
    assert rechecked(form, (said,))["state_affine.structure"] == "stated"
