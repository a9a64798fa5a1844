"""The truth, the noise and the metrics of a trial."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from oracle import fitzhugh_nagumo as oracle

import hgogen as hg
from hgogen import model
from hgogen.run import native
from hgogen.run.comparison import agreement
from hgogen.run.metrics import crossings, metrics, settling, summary
from hgogen.trial import BadTrial, Jump, OrnsteinUhlenbeck, Settled, Trial, noisy, read_field, simulate, t, try_out

NEURON = model.load(Path(__file__).resolve().parents[1] / "models" / "fitzhugh_nagumo.py")
ONE_JUMP = NEURON.trials()[0]


def moving(flow, **trial):
    """A plant x' = v, v' = flow with input u, and a trial of 1 s for it."""
    x, v, u, y = hg.Signal("x"), hg.Signal("v"), hg.Signal("u"), hg.Signal("y")
    plant = hg.System("car", states=(x, v), inputs=(u,), outputs=(y,), flow=[v, flow(x, v, u)], output=[x + u])
    start = {"x": 0.0, "v": 1.0}
    return plant, Trial(**{"name": "drive", "duration": 1.0, "start": start, "inputs": {"u": sp.cos(t)}, **trial})


# --- what the observer's plant has beside the declared one ---------------------------------------------------------


def test_derivatives_of_inputs_come_from_the_trial():
    """The phase form of an oscillator takes u and u'; the trial gives u alone."""
    h, v = hg.Signal("h", low=-9, high=9), hg.Signal("v", low=-9, high=9)
    u, y = hg.Signal("u", low=0, high=2, rates=[(-3, 3)]), hg.Signal("y")
    plant = hg.System("swing", states=(h, v), inputs=(u,), outputs=(y,), flow=[v + u, -h], output=[h])
    step = hg.sample(hg.observers.high_gain(hg.forms.phase(plant), theta=5, poles=(-1, -1)), dt=0.01)
    assert [s.name for s in step.inputs] == ["u", "u_dot"]
    trial = Trial("drive", 5, start={"h": 3, "v": 0}, inputs={"u": 1 + sp.sin(2 * t)}, seeds=(0,))
    (outcome,) = try_out(step, trial, "python")
    assert outcome.truth.u[:, 1] == pytest.approx(2 * np.cos(2 * outcome.truth.t))
    # what is left is the input's second derivative between samples: 4 dt^2/8 in u', some 1e-4 of it
    assert np.abs(outcome.error[400:]).max() < 1e-4


def test_a_recast_plant_is_tried_as_declared():
    """The truth is that of the plant as declared, whose states are estimated."""
    tanks = model.load(Path(__file__).resolve().parents[1] / "models" / "cascaded_tanks.py")
    trial = Trial("fill", 400, start={"x1": 4, "x2": 3}, inputs={"u": 3}, seeds=(0,))
    (outcome,) = try_out(tanks.step(), trial, "python")
    assert outcome.truth.x[0] == pytest.approx([4, 3])
    assert np.abs(outcome.error[-10:]).max() < 0.01 < np.abs(outcome.error[0]).max()


# --- truth ----------------------------------------------------------------------------------------------------


def test_truth_and_noise_are_the_oracles():
    scenario = oracle.Scenario(((4.0, -6.0), (7.0, 3.0)), 10.0)
    trial = replace(ONE_JUMP, duration=10.0, steady=None, jumps=(Jump(4, "eta", -6), Jump(7, "eta", 3)))
    truth = simulate(NEURON.plant, trial, 0.01)
    # The oracle's RK4 at a fifth of the step has a global error of 1e-10 (fourth order: 1/16 at half the step), CVODES
    # at 1e-13 a step one of 1e-10; 1e-8 leaves room for another machine's order of operations.
    assert truth.x == pytest.approx(oracle.truth(scenario), abs=1e-8)
    assert truth.t == pytest.approx(oracle.times(scenario), abs=1e-12)
    assert truth.u[:, 0] == pytest.approx(np.sin(truth.t), abs=1e-15)
    for seed in (0, 7):
        noise = noisy(NEURON.plant, truth, trial, [seed])[0] - truth.y
        assert noise[:, 0] == pytest.approx(oracle.noise(range(seed, seed + 1), len(truth.t))[0], abs=1e-14)


def test_a_jump_between_samples_takes_effect_at_its_time():
    plant, trial = moving(lambda x, v, u: 0 * x, jumps=(Jump(0.333, "v", -2.0),))
    truth = simulate(plant, trial, 0.1)
    exact = np.where(truth.t < 0.333, truth.t, 0.333 - 2 * (truth.t - 0.333))
    assert truth.x[:, 0] == pytest.approx(exact, abs=1e-11)


def test_a_jump_on_a_sample_shows_in_that_sample():
    plant, trial = moving(lambda x, v, u: 0 * x, jumps=(Jump(0.3, "v", 5.0), Jump(0.3, "x", 7.0), Jump(1.0, "x", 9.0)))
    truth = simulate(plant, trial, 0.1)
    assert truth.x[2] == pytest.approx([0.2, 1.0])
    assert truth.x[3] == pytest.approx([7.0, 5.0])
    assert truth.x[9] == pytest.approx([7.0 + 5 * 0.6, 5.0])
    assert truth.x[10, 0] == 9.0


def test_the_input_acts_between_samples_too():
    plant, trial = moving(lambda x, v, u: u)
    truth = simulate(plant, trial, 0.25)
    assert truth.x[:, 1] == pytest.approx(1 + np.sin(truth.t), abs=1e-10)
    assert truth.y[:, 0] == pytest.approx(truth.x[:, 0] + np.cos(truth.t), abs=1e-12)


def test_the_truth_is_the_same_again():
    first, second = (simulate(NEURON.plant, replace(ONE_JUMP, duration=60.0, steady=None), 0.01) for _ in range(2))
    assert (first.x == second.x).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": {"x": 1.0}}, "says nothing of 'v'"),
        ({"start": {"x": 1.0, "v": math.nan}}, "not finite"),
        ({"start": {"x": 1.0, "v": 1.0, "z": 1.0}}, "names 'z'"),
        ({"inputs": {}}, "says nothing of 'u'"),
        ({"inputs": {"u": sp.Symbol("q")}}, "input u uses q"),
        ({"noise": {"x": OrnsteinUhlenbeck(0.1)}}, "names 'x'"),
        ({"noise": {"y": OrnsteinUhlenbeck(-0.1)}}, "not negative"),
        ({"jumps": (Jump(0.5, "q", 1.0),)}, "names 'q'"),
        ({"jumps": (Jump(1.5, "x", 1.0),)}, "within 0..1 s"),
        ({"jumps": (Jump(0.5, "x", math.inf),)}, "finite value"),
        ({"settled": Settled("q", 0.1, 1.0)}, "names 'q'"),
        *(({"settled": Settled("x", band, 1.0)}, "above 0") for band in (0.0, -1.0, math.nan)),
        *(({"settled": Settled("x", 0.1, hold)}, "above 0") for hold in (0.0, -1.0, math.inf)),
        ({"duration": 0.001}, "at least dt"),
        ({"duration": math.inf}, "must be a time"),
        ({"steady": 2.0}, "steady = 2"),
        ({"seeds": ()}, "no seeds"),
    ],
)
def test_a_bad_trial_is_a_sentence(change, said):
    plant, trial = moving(lambda x, v, u: u, **change)
    with pytest.raises(BadTrial, match="drive") as caught:
        simulate(plant, trial, 0.1)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("fields", "meant"),
    [
        ({"seeds": 4}, {"seeds": (0, 1, 2, 3)}),
        ({"seeds": range(2)}, {"seeds": (0, 1)}),
        ({"seeds": np.arange(2)}, {"seeds": (0, 1)}),
        ({"noise": {"y": 3e-3}}, {"noise": {"y": OrnsteinUhlenbeck(3e-3)}}),
        ({"jumps": Jump(0.5, "v", 2)}, {"jumps": (Jump(0.5, "v", 2),)}),
        ({"jumps": [Jump(0.5, "v", 2)]}, {"jumps": (Jump(0.5, "v", 2),)}),
        ({"inputs": {"u": "sin(2*t)"}}, {"inputs": {"u": sp.sin(2 * t)}}),
    ],
)
def test_a_field_may_be_given_as_in_text(fields, meant):
    plant, trial = moving(lambda x, v, u: u, **fields)
    assert {key: getattr(trial, key) for key in meant} == meant
    assert simulate(plant, trial, 0.1).x.shape == (11, 2)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("name", 3, "trial '3': name = 3 must be text"),
        *(("duration", wrong, "must be a number") for wrong in ("1", None, True, [1], 1j)),
        *(
            ("start", wrong, "number for each state by name")
            for wrong in (None, 3, "ab", {"x": "a"}, {1: 1}, {"x": None})
        ),
        *(("estimate", wrong, "number for each state by name") for wrong in (3, {"x": "a"})),
        *(("inputs", wrong, "or a number, for each input by name") for wrong in (None, 3, {1: 1})),
        ("inputs", {"u": [1]}, "inputs: an input was given [1], of type list"),
        ("inputs", {"u": "sin(t"}, "inputs: "),
        *(
            ("noise", wrong, "a standard deviation")
            for wrong in (None, 0.1, {"y": "a"}, {"y": True}, {"y": Jump(1, "x", 1)})
        ),
        ("noise", {"y": OrnsteinUhlenbeck("a")}, "a standard deviation"),
        *(("jumps", wrong, "must be a Jump(time, state, value)") for wrong in (None, 3, (3,), Jump("v", 5, 2), "ab")),
        *(
            ("settled", wrong, "must be a Settled(state, band, hold)")
            for wrong in (3, ("x", 1, 1), Settled("x", "a", 1))
        ),
        *(("steady", wrong, "must be a number, or None") for wrong in ("a", [1], True)),
        *(
            ("seeds", wrong, "a count from 1 to 1000")
            for wrong in ("abc", None, 1.5, True, 1001, (0, -1), (0.5,), [True])
        ),
    ],
)
def test_a_field_of_another_kind_is_a_sentence(key, value, said):
    with pytest.raises(BadTrial) as caught:
        read_field("drive", key, value) if key != "name" else Trial(value, 1, {})
    assert said in str(caught.value)


def test_a_model_with_such_a_trial_names_its_line(tmp_path):
    path = tmp_path / "made.py"
    path.write_text("from hgogen.trial import Trial\n\n\ndef trial():\n    return Trial('a', 1, {}, seeds='abc')\n")
    with pytest.raises(model.ModelFails, match=r"made\.py, line 5: trial 'a': seeds = 'abc' must be a count from 1 to"):
        model.load(path).trials()


@pytest.mark.parametrize(("value", "fits"), [(8, True), (-8, True), (8.1, False), (-20, False)])
def test_a_jump_keeps_to_the_states_range(value: float, fits: bool):
    trial = replace(ONE_JUMP, duration=0.1, steady=None, jumps=(Jump(0.05, "eta", value),))
    if fits:
        assert simulate(NEURON.plant, trial, 0.05).x[-1, 2] == value
    else:
        with pytest.raises(BadTrial, match=r"leaves the range -8.*\.\.8.* of eta"):
            simulate(NEURON.plant, trial, 0.05)


def test_a_plant_that_escapes_is_a_sentence(capfd: pytest.CaptureFixture[str]):
    """And no line of the integrator's own."""
    plant, trial = moving(lambda x, v, u: v**2, duration=2.0)  # v = 1/(1 - t)
    with pytest.raises(BadTrial, match="cannot be integrated from t = 0 to t = 2"):
        simulate(plant, trial, 0.1)
    assert capfd.readouterr() == ("", "")


# --- noise ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.0, 0.3])
def test_noise_has_its_deviation_and_correlation(tau: float):
    plant, trial = moving(lambda x, v, u: 0 * x, duration=2000.0, noise={"y": OrnsteinUhlenbeck(0.5, tau)})
    truth = simulate(plant, trial, 0.1)
    noise = (noisy(plant, truth, trial, [3])[0] - truth.y)[:, 0]
    rho = math.exp(-0.1 / tau) if tau else 0.0
    # Over N samples the estimate of the variance has the relative deviation sqrt(2/N (1 + rho^2)/(1 - rho^2)), that of
    # rho sqrt((1 - rho^2)/N): four deviations.
    spread = math.sqrt(2 / len(noise) * (1 + rho**2) / (1 - rho**2))
    assert np.var(noise) == pytest.approx(0.25, rel=4 * spread)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(rho, abs=4 * math.sqrt((1 - rho**2) / len(noise)))


def test_outputs_draw_their_noise_one_after_the_other():
    x, y1, y2 = hg.Signal("x"), hg.Signal("y1"), hg.Signal("y2")
    plant = hg.System("pair", states=(x,), outputs=(y1, y2), flow=[-x], output=[x, x])
    noise = {"y1": OrnsteinUhlenbeck(1.0), "y2": OrnsteinUhlenbeck(1.0)}
    trial = Trial("pair", 1.0, {"x": 0.0}, noise=noise)
    y = noisy(plant, simulate(plant, trial, 0.1), trial, [5])[0]
    assert y.T.ravel() == pytest.approx(np.random.default_rng(5).standard_normal(22))


# --- metrics --------------------------------------------------------------------------------------------------


def test_settling_is_the_oracles():
    rng = np.random.default_rng(0)
    wanted = Settled("eta", band=0.3, hold=0.2)
    for scale in (0.05, 0.15, 0.25, 1.0):
        error = np.cumsum(rng.normal(scale=scale, size=500)) * np.exp(-np.arange(500) / 100)
        expected = oracle.settling(np.arange(500) * 0.01, error[None], 0.0, 0.3, 0.2)[0]
        time = settling(error, wanted, 0.01)
        assert (math.isnan(expected) and time is None) or time == pytest.approx(expected)
    assert settling(np.zeros(5), wanted, 0.01) is None  # too short to hold


def test_crossings_are_the_rises():
    assert crossings(np.array([1.0, 1.6, 2.0, 1.4, 1.5, 1.51, 1.0])).tolist() == [1, 5]


CLOCK = SimpleNamespace(guarded=True, varying=False)


def trajectory(theta, error, status):
    """A made-up trajectory of a one-state step over 1 s samples."""
    signal = hg.Signal("x")
    bits = (SimpleNamespace(name="MISSING_Y"), SimpleNamespace(name="OUTSIDE_BOX"))
    step, n = SimpleNamespace(states=(signal,), dt=1.0, layout=SimpleNamespace(bits=bits), clock=CLOCK), len(error)
    wanted = {"settled": Settled("x", 0.1, 2.0), "jumps": (Jump(10.0, "x", 1.0),), "steady": 15.0}
    error = np.asarray(error, float)[:, None]
    made = SimpleNamespace(
        trial=Trial("made_up", n - 1.0, {"x": 0.0}, **wanted),
        truth=SimpleNamespace(t=np.arange(n) * 1.0, x=np.zeros((n, 1))),
        x=error,
        error=error,
        traces={"theta": np.asarray(theta, float)},
        status=np.asarray(status, np.uint32),
        seed=4,
        engine="c",
    )
    return step, made


def test_metrics_of_a_made_up_trajectory():
    error = [1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 5, 5, 5, 0, 0, 3, 4, 3, 4, 3, 4]
    theta = [1, 1, 3, 1.04, 1, 1, 1, 1, 1, 1, 1, 2, 1.2, 1.6, 1.2, 1.1, 1.01, 1, 1, 1, 1]
    step, made = trajectory(theta, error, [2, 2, *[1] * 8, 2, *[0] * 9, 3])
    measures = metrics(step, made)
    first, second = measures.responses
    assert (first.settled, first.peak, first.theta_settled, first.triggers) == (2.0, 3.0, 3.0, 1)
    assert (second.settled, second.peak, second.theta_settled, second.triggers) == (None, 2.0, 6.0, 2)
    assert measures.rms["x"] == pytest.approx(math.sqrt((3 * 9 + 3 * 16) / 6))
    assert measures.clamped == 2  # the two after the first 5% with bit 1
    statistics = summary(made.trial, [measures])
    assert statistics.settled == (2.0, None)
    assert statistics.triggered == (1.0, 1.0)


def test_a_seed_that_never_settles_is_not_forgotten():
    calm = [1.0] * 21
    step, made = trajectory(calm, [0.0] * 21, [0] * 21)
    good = metrics(step, made)
    bad = metrics(*trajectory(calm, [1.0] * 21, [0] * 21))
    assert summary(made.trial, [good, good, bad]).settled == (0.0, 0.0)
    assert summary(made.trial, [good, good, bad]).worst == (None, None)
    assert summary(made.trial, [good, bad, bad]).settled == (None, None)


# --- a step on its trial --------------------------------------------------------------------------------------

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@needs_compiler
def test_the_reference_trial_in_c():
    step = NEURON.step()
    statistics = summary(ONE_JUMP, [metrics(step, one) for one in try_out(step, ONE_JUMP, "c")])
    assert 9.5 <= statistics.worst[1] <= 14.0
    assert 7.9 <= statistics.peak[1][0] <= statistics.peak[1][1] <= 8.0
    assert statistics.triggered == (1.0, 1.0)
    assert statistics.clamped == 0


@needs_compiler
def test_c_and_python_agree_and_a_difference_is_seen():
    step = NEURON.step()
    short = replace(ONE_JUMP, duration=12.0, jumps=(), steady=None)
    c, python = (next(try_out(step, short, engine, seeds=(1,))) for engine in ("c", "python"))
    assert (c.engine, python.engine) == ("c", "python")
    pair = (c, metrics(step, c)), (python, metrics(step, python))
    assert agreement(*pair, step.dt).agreed
    wrong = replace(c, x=c.x * (1 + 1e-9))
    assert not agreement((wrong, metrics(step, wrong)), pair[1], step.dt).agreed
    late = replace(pair[0][1], responses=(replace(pair[0][1].responses[0], settled=99.0),))
    assert not agreement((c, late), pair[1], step.dt).agreed


def test_a_trial_starts_from_the_reset_state():
    step = NEURON.step()
    short = replace(ONE_JUMP, duration=0.5, jumps=(), steady=None)
    first, again = (next(try_out(step, short, "python", seeds=(0,))) for _ in range(2))
    assert (first.x == again.x).all()


def test_a_jump_happens_once() -> None:
    a, b = hg.Signal("a"), hg.Signal("b")
    plant = hg.System("still", states=(a, b), outputs=(hg.Signal("y"),), flow=(-a, 0 * b), output=(a,))
    jumps = (Jump(1.0, "a", 5.0), Jump(2.0, "b", 1.0))
    truth = simulate(plant, Trial("twice", duration=3.0, start={"a": 0.0, "b": 0.0}, inputs={}, jumps=jumps), 0.5)
    assert truth.x[-1] == pytest.approx([5 * np.exp(-2), 1.0], abs=1e-9)
