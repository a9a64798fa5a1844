"""Starting gains: the rule stands beside its observer, reads ranges, noise and dt, and is taken where no tuning is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from plants import chain, model
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.model import MissingPart, load
from hgogen.modelfiles.setting import Setting
from hgogen.modelfiles.tuning import First, NoFirst, first, places
from hgogen.observers import high_gain
from hgogen.reading.given import BadGain
from hgogen.run.metrics import metrics
from hgogen.starting import Rule, gains_of, rule, scale
from hgogen.trial import try_out

RULED = [name for name in hg.observers.__all__ if name != "bank"]
BARE = """
name = "oscillator"
states.x1 = {low = -2, high = 2, flow = "x2"}
states.x2 = {low = -2, high = 2, flow = "-x1"}
outputs.y = {low = -2, high = 2, equation = "x1"}
trial = {duration = 10, start = {x1 = 1, x2 = 0}, noise = {y = 0.001}, settled = {state = "x2", band = 0.1, hold = 1}}
"""


def oscillator(scale: float = 1.0) -> hg.Form:
    """x1' = x2, x2' = -x1, in +-scale: each state crosses its range in 2, at its fastest; n = 2, theta = 2."""
    x1, x2, y = (hg.Signal(name, low=-scale, high=scale) for name in ("x1", "x2", "y"))
    return hg.forms.triangular(hg.System("o", states=(x1, x2), outputs=(y,), flow=[x2, -x1], output=[x1]))


SCALE = scale(oscillator())


@pytest.mark.parametrize("name", hg.observers.__all__)
def test_each_says_where_to_take_it_and_what_it_asks_for(name: str) -> None:
    own = rule(getattr(hg.observers, name))
    assert own.where
    assert own.asks
    assert own.state


@pytest.mark.parametrize("n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 4, 5))])
@pytest.mark.parametrize("name", RULED)
def test_each_is_built_with_its_starting_gains_on_a_chain(name: str, n: int) -> None:
    own = {"kalman_like": hg.forms.state_affine, "uniform_injection": hg.forms.uniform}
    form = own.get(name, hg.forms.triangular)(chain(n))
    start = hg.starting_gains(form, getattr(hg.observers, name))
    step = hg.sample(getattr(hg.observers, name)(form, **start.gains), dt=start.dt)
    assert step.observer.name == name
    assert np.isfinite(step.run(u=np.zeros((200, 1)), y=np.ones(200), engine="python").x).all()


def test_by_hand() -> None:
    """theta = 2 n/T with T about 2, or 2.1 among points; dt = 1/(20 theta); R = (1 %)^2 dt; Q = S^2/D."""
    for half in (1.0, 100.0):
        start = hg.starting_gains(oscillator(half), hg.observers.riccati)
        assert start.dt == 0.025
        assert start.gains["R"] == pytest.approx((half / 100) ** 2 * 0.025, rel=0.05)
        assert start.gains["Q"]["x1"] == pytest.approx(half**2 / 2.1, rel=0.06)
        assert start.gains["covariance"]["x2"] == pytest.approx(half**2 / 4)
        assert hg.starting_gains(oscillator(half), hg.observers.high_gain).gains == {"theta": 2.0, "poles": (-1, -1)}


@pytest.mark.parametrize(("coupling", "linked"), [("v/100", True), ("v**2/100", False), ("u*v/100", False)])
def test_a_state_that_hardly_shows_has_no_noise_before_it(coupling: str, linked: bool) -> None:
    """Q_x = (a D)^2 Q_v where x' reads v with a slope a of one sign; where the slope may be 0, S^2/D."""
    x, v, u = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=2), hg.Signal("u", low=-4, high=5)
    flow = [-x + sp.sympify(coupling, {"v": v, "u": u}), -v]
    plant = hg.System("hidden", states=(x, v), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[x])
    numbers = scale(hg.forms.original(plant))
    wanted = 1e-4 * numbers.longest**2 * numbers.process["v"] if linked else 1 / numbers.longest
    assert numbers.process["v"] == numbers.units["v"] == pytest.approx(1.5**2 / numbers.longest)
    assert numbers.process["x"] == pytest.approx(wanted)


def test_noise_is_bounded_from_the_end_of_a_chain_on() -> None:
    """Q_v by Q_w, then Q_x by the Q_v that is left."""
    x, v, w = (hg.Signal(name, low=-1, high=1) for name in "xvw")
    plant = hg.System(
        "chain", states=(x, v, w), outputs=(hg.Signal("y"),), flow=[-x + v / 10, -v + w / 100, -w], output=[x]
    )
    numbers = scale(hg.forms.original(plant))
    D, (Q_x, Q_v, Q_w) = numbers.longest, numbers.process.values()
    assert Q_w == pytest.approx(1 / D)
    assert Q_v == pytest.approx((D / 100) ** 2 * Q_w)
    assert Q_x == pytest.approx((D / 10) ** 2 * Q_v) != pytest.approx((D / 10) ** 2 / D)


@pytest.mark.parametrize("name", ["contois", "series_dc_motor", "magnetic_levitation"])
def test_the_hidden_state_of_a_trial_settles(name: str) -> None:
    """Of plants whose hidden state moves the measured one much less than that moves itself; with S^2/D none did."""
    shipped = load(name)
    form = hg.forms.uniform(shipped.plant)
    start = hg.starting_gains(form, hg.observers.riccati)
    step = hg.sample(hg.observers.riccati(form, **start.gains), dt=start.dt)
    (one,) = try_out(step, shipped.trials()[0], seeds=(0,))
    assert metrics(step, one).responses[0].settled is not None


def test_noise_and_dt_are_taken() -> None:
    start = hg.starting_gains(oscillator(), hg.observers.riccati, dt=0.01, noise={"y": 0.3})
    assert (start.dt, start.gains["R"]) == (0.01, 9e-4)
    assert hg.starting_gains(oscillator(), hg.observers.high_gain, dt=0.04).gains["theta"] == 1.2
    assert hg.starting_gains(oscillator(), hg.observers.high_gain, dt=9).gains["theta"] == 1.0
    with pytest.raises(BadGain, match="dt"):
        hg.starting_gains(oscillator(), hg.observers.riccati, dt=-1)


def test_what_has_none_says_why() -> None:
    start = hg.starting_gains(oscillator(), hg.observers.bank)
    assert not start
    assert start.none.startswith("it goes around another observer")
    without = hg.starting_gains(oscillator(), lambda form: high_gain(form, theta=2))
    assert without.none == "no rule for them stands beside it"
    assert rule(len) == Rule()  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1e6, 1e10, 1e14, 1e15, 1e16, 1e20, 1e29, 1e30])
def test_what_is_proposed_of_large_ranges_is_taken(size: float) -> None:
    """A covariance of states in +-1e15 is beyond what an observer takes; theta knows of no size."""
    form = oscillator(size)
    start = hg.starting_gains(form, hg.observers.riccati)
    assert bool(start) == (size < 2e15)
    if start:
        hg.observers.riccati(form, **start.gains)
    else:
        assert str(start.none) == "they are beyond 1e+30; give the signals other units"
    assert hg.starting_gains(form, hg.observers.high_gain)


def test_the_first_form_that_admits_it() -> None:
    neuron = hg.survey(model("fitzhugh_nagumo"))
    taken = {name: first(name, places(neuron)) for name in ("riccati", "kalman_like", "high_gain", "bank")}
    rows = {name: one.row.kind for name, one in taken.items() if isinstance(one, First)}
    assert rows == {"riccati": "original", "kalman_like": "state_affine"}
    assert {name for name, one in taken.items() if isinstance(one, NoFirst) and one.ruled} == {"bank"}
    refused = first("high_gain", places(neuron))
    assert isinstance(refused, NoFirst)
    assert refused.reason == "high_gain takes a triangular form, this one is original"
    alone = first("high_gain", [neuron["triangular"]])
    assert isinstance(alone, NoFirst)
    assert alone.reason == f"the plant is not in the form triangular: {neuron['triangular'].why}"


@pytest.mark.parametrize("observer", ["high_gain", "kalman_like", "riccati"])
def test_a_plant_in_no_form_is_refused_for_the_first_reason(observer: str) -> None:
    """No output shows the recovered of an epidemic: that is not for the lack of one form of several."""
    none = first(observer, places(hg.survey(load("sir").plant)))
    assert isinstance(none, NoFirst)
    assert none.reason == "original.connected is refuted: no output ever shows R"


@pytest.mark.full
def test_a_model_without_a_tuning_takes_them(tmp_path: Path) -> None:
    path = tmp_path / "oscillator.toml"
    path.write_text(BARE)
    bare = load(path)
    step = bare.step("filtered")
    assert (step.observer.name, step.dt) == ("filtered", 0.025)
    assert bare.set(Setting(dt=0.01)).step("filtered").dt == 0.01
    assert bare.set(Setting(form="uniform")).step("riccati").observer.form.kind == "uniform"
    with pytest.raises(MissingPart, match=r"does not take this plant in the form triangular: .*state_affine"):
        bare.set(Setting(form="triangular")).step("kalman_like")
    with pytest.raises(MissingPart) as caught:
        bare.set(Setting(form="original")).step("high_gain")
    said = "high_gain takes a triangular form, this one is original; `hgogen check"
    assert f"does not take this plant in the form original: {said}" in str(caught.value)
    with pytest.raises(MissingPart, match=r"toml: riccati with starting gains: dt = 50 is too long .*; take dt <= "):
        bare.set(Setting(dt=50.0)).step("riccati")
    with pytest.raises(MissingPart, match="defines no step"):
        bare.step()


def test_they_have_the_period_of_the_models_own_step(tmp_path: Path) -> None:
    """0.05 in place of 0.025, at which theta is 1/(20 dt) in place of 2."""
    path = tmp_path / "oscillator.toml"
    path.write_text(BARE + "tuning.riccati = {Q = [1, 1], R = 1, dt = 0.05}\n")
    assert load(path).step("high_gain").dt == 0.05
    assert load(path).tuned("high_gain").tables["high_gain"]["theta"] == 1.0


@pytest.mark.ordinary("words0")
@pytest.mark.parametrize(
    "words", [("simulate", "--observer", "high_gain"), ("compare", "--observers", "high_gain,filtered")]
)
def test_commands_take_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    monkeypatch.chdir(tmp_path)
    Path("oscillator.toml").write_text(BARE)
    command, *options = words
    made = CliRunner().invoke(app, [command, "oscillator.toml", *options, "--seeds", "1", "--json"])
    assert made.exit_code == 0, made.output
    (trial,) = json.loads(made.stdout)["trials"]
    each = trial.get("observers", [trial])
    assert all(0 <= one["settled"][0] < 5 for one in each)


def test_a_plant_at_rest_has_gains() -> None:
    x, y = hg.Signal("x"), hg.Signal("y")
    still = hg.forms.original(hg.System("s", states=(x,), outputs=(y,), flow=[sp.S.Zero], output=[x]))
    assert hg.starting_gains(still, hg.observers.riccati).gains["Q"] == {"x": 1.0}


@pytest.mark.parametrize(
    ("observer", "noise", "says"),
    [
        ("high_gain", None, "must be one of hg.observers"),
        (hg.observers.riccati, 0.01, "by its name"),
        (hg.observers.riccati, {"x1": 1}, "is of no output; the outputs are y"),
        (hg.observers.riccati, {"y": -1}, "must be a positive finite number"),
    ],
)
def test_what_is_given_wrong_is_refused_by_a_sentence(observer: Any, noise: Any, says: str) -> None:
    with pytest.raises(BadGain, match=says):
        hg.starting_gains(oscillator(), observer, noise=noise)


def test_a_plant_in_the_place_of_its_form_is_refused() -> None:
    with pytest.raises(BadGain, match="starting_gains takes a form"):
        hg.starting_gains(oscillator().system, hg.observers.riccati)  # type: ignore[arg-type]


@given(st.lists(st.integers(1, 5), min_size=1, max_size=3), st.floats(1, 20))
def test_poles_that_differ_have_a_mean_of_1_and_a_ratio(blocks: list[int], spread: float) -> None:
    """To the two digits of each; a chain of one has -1."""
    chains = replace(SCALE, blocks=tuple(blocks), spread=spread).poles
    for poles in (chains,) if len(blocks) == 1 else chains:
        assert np.prod(np.abs(poles)) == pytest.approx(1, rel=0.05 * len(poles) + 1e-9)
        assert poles[-1] / poles[0] == pytest.approx(spread if len(poles) > 1 else 1, rel=0.1)
    assert replace(SCALE, blocks=tuple(blocks)).poles == replace(SCALE, blocks=tuple(blocks), spread=1).poles


def test_a_filter_keeps_its_gain_at_rest_whatever_its_corner() -> None:
    """alpha/beta, and of a chain -F^-1 G: a third of what comes before."""
    for corner in (1.5, 3, 6):
        numbers = replace(SCALE, corner=corner)
        pair = gains_of(hg.observers.filtered, numbers)
        assert pair["beta"] / pair["alpha"] == pytest.approx(1 / 3)
        chain = gains_of(hg.observers.filtered_injection, numbers)
        F, G = np.array(chain["F"], dtype=float), np.array(chain["G"], dtype=float)
        assert -np.linalg.solve(F, G) == pytest.approx([3.0 ** -(k + 1) for k in range(len(G))])
        assert np.linalg.eigvals(F) == pytest.approx(-corner)
