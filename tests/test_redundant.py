"""Outputs that add nothing: their form, the mean of sensors that show the same, and what is proved of it."""

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import two_outputs

import hgogen as hg
from hgogen.check import Verdict
from hgogen.modelfiles.first import NoFirst, first
from hgogen.reading.given import BadGain
from hgogen.reading.named import BadNames
from hgogen.recheck.verification import recheck
from hgogen.structure.scaling import scaling
from hgogen.structure.spare import shown, unused
from hgogen.which_forms import of

x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
y1, y2, y3 = hg.Signal("y1"), hg.Signal("y2"), hg.Signal("y3")
k, u = hg.Signal("k", nominal=2, low=1, high=3), hg.Signal("u", low=1, high=2)
c = hg.Signal("c", nominal=2.5)
GAINS: dict[str, Any] = {"theta": 10, "poles": (-1, -1)}


def swing(*output: Any) -> hg.System:
    """x1' = x2, x2' = -sin x1 + u, with these outputs."""
    return hg.System(
        "swing",
        states=(x1, x2),
        inputs=(u,),
        outputs=(y1, y2, y3)[: len(output)],
        parameters=(k, c),
        flow=[x2, -sp.sin(x1) + u],
        output=output,
    )


def form(*output: Any, align: str | None = None) -> hg.Form:
    return hg.forms.block_triangular(swing(*output), align)


def verdicts(checks: Any) -> dict[str, str]:
    return {str(check.id): str(check.verdict) for check in checks}


# --- the form -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("output", "blocks", "ratios"),
    [
        ((x1, x1), (2, 0), ((0, 1), (1, 1))),
        ((x1, 3 - 2 * x1), (2, 0), ((0, 1), (1, -2))),
        ((x1, x1 + u), (2, 0), ((0, 1), (1, 1))),
        ((k * x1, 3 * k * x1), (2, 0), ((0, 1), (1, 3))),
        ((x1, x1, x1 / 2), (2, 0, 0), ((0, 1), (1, 1), (2, sp.Rational(1, 2)))),
        ((x1, c * x1), (2, 0), ((0, 1), (1, sp.Rational(5, 2)))),  # a constant has its value
        ((x1, k * x1), (2, 0), ((0, 1),)),  # a multiple that can be tuned is no number
        ((x1, u * x1), (2, 0), ((0, 1),)),
        ((x1, x1 + x2), (2, 0), ((0, 1),)),
        ((x1 + x2, x1), (0, 2), ((1, 1),)),
        ((x1, x1**3 + x1), (2, 0), ((0, 1),)),
        ((x1, x1 * x2), (2, 0), ((0, 1),)),
        ((x1, u), (2, 0), ((0, 1),)),
    ],
)
def test_what_adds_nothing_has_no_chain(output: Any, blocks: Any, ratios: Any) -> None:
    made = form(*output)
    assert made.structured
    assert made.blocks == blocks
    assert {check.verdict for check in made.checks} == {Verdict.PROVED}
    (chain,) = shown(made)
    assert tuple((each.output, each.ratio) for each in chain) == ratios
    assert unused(made) == tuple(sorted({*range(len(output))} - {each.output for each in chain}))


def test_outputs_that_each_begin_a_chain_keep_it() -> None:
    """Nothing changes where all are needed, or all can have a chain."""
    assert form(x1, x2).blocks == (1, 1)
    assert hg.forms.block_triangular(two_outputs()).blocks == (2, 1)


def test_a_second_sensor_of_one_of_two_chains() -> None:
    plant = two_outputs()
    third = hg.System(
        "three",
        states=plant.states,
        inputs=plant.inputs,
        outputs=(*plant.outputs, y3),
        parameters=plant.parameters,
        flow=plant.flow,
        output=[*plant.output, -plant.output[1]],
    )
    made = hg.forms.block_triangular(third, "end")
    assert made.blocks == (2, 1, 0)
    assert [[each.output for each in chain] for chain in shown(made)] == [[0], [1, 2]]
    assert scaling(made).outputs == (0, 1, 1)
    assert made.structured


def test_what_the_outputs_do_not_show_stays_refuted() -> None:
    assert not form(x2, x2).structured
    assert form(x2, x2, align="top").checks[0].verdict is Verdict.REFUTED


# --- the high gain ------------------------------------------------------------------------------------------


def stepped(*output: Any, method: Any = hg.methods.rk4, **gains: Any) -> Any:
    made = hg.forms.triangular(swing(*output)) if len(output) == 1 else form(*output)
    observer = hg.observers.high_gain(made, **{**GAINS, **gains})
    return hg.sample(observer, method, dt=0.01, engine="python")


@cache
def samples() -> np.ndarray:
    """x1 of the plant by small Euler steps, u = 1.5."""
    x, rows = np.array([1.0, 0.5]), []
    for _ in range(200):
        rows.append(x[0])
        for _ in range(10):
            x = x + 0.001 * np.array([x[1], -np.sin(x[0]) + 1.5])
    return np.array(rows)


def ran(step: Any, *columns: Any) -> np.ndarray:
    return np.asarray(step.run(u=np.full((200, 1), 1.5), y=np.column_stack(columns)).x)


@pytest.mark.parametrize("method", [hg.methods.rk4, hg.methods.exponential])
def test_sensors_that_agree_are_one(method: Any) -> None:
    y = samples()
    one = ran(stepped(x1, method=method), y)
    both = ran(stepped(x1, 3 - 2 * x1, method=method), y, 3 - 2 * y)
    assert np.abs(both - one).max() < 1e-12
    assert abs(both[-1, 0] - y[-1]) < 1e-2


@pytest.mark.parametrize("method", [hg.methods.rk4, hg.methods.exponential])
def test_a_sensor_that_is_silent_leaves_the_other(method: Any) -> None:
    """The mean is of the samples that are there: the first sensor stops, and later the second."""
    y, silent = samples(), np.full(200, np.nan)
    a, b = np.where(np.arange(200) < 50, y, silent), np.where(np.arange(200) < 150, y, silent)
    one = ran(stepped(x1, method=method), b)
    both = ran(stepped(x1, x1, method=method), a, b)
    assert np.abs(both - one).max() < 1e-12


def test_the_mean_is_by_weight() -> None:
    """Of readings 1 and 2 apart by noise, in the unit of the first: (3*a + b)/4."""
    y, noise = samples(), np.random.default_rng(1).normal(size=(2, 200)) / 100
    a, b = y + noise[0], y + noise[1]
    both = ran(stepped(x1, -2 * x1, weights={"y1": 3}), a, -2 * b)
    assert np.abs(both - ran(stepped(x1), (3 * a + b) / 4)).max() < 1e-12
    assert np.abs(both - ran(stepped(x1), (a + b) / 2)).max() > 1e-3


def test_what_shows_something_else_takes_no_part() -> None:
    y = samples()
    step = stepped(x1, x1 + x2)
    assert np.array_equal(ran(step, y, y), ran(stepped(x1), y))
    assert "y2 has no chain, and no part in the correction" in step.observer.equations


def test_all_is_proved_that_is_of_one_sensor_but_for_the_noise() -> None:
    pytest.importorskip("clarabel")
    one, both = stepped(x1), stepped(x1, -2 * x1)
    alone, shared = (hg.contraction(step) for step in (one, both))
    assert verdicts(alone.checks) == verdicts(shared.checks)
    claims = ("high_gain.convergence", "high_gain.theta")
    mine, theirs = (verdicts(step.observer.checks) for step in (one, both))
    assert [mine[id] for id in claims] == [theirs[id] for id in claims] == ["proved", "proved"]
    assert hg.noise_gain(one) is not None
    assert hg.noise_gain(both) is None


def test_the_certificate_is_verified() -> None:
    pytest.importorskip("clarabel")
    step = stepped(x1, -2 * x1)
    content = hg.certificate(step.observer.form, (*step.observer.checks, *hg.contraction(step).checks), "high_gain")
    rows = recheck(json.dumps(content)).rows
    assert {row.found for row in rows} == {"verified"}
    assert len(rows) > 7


def test_gains_for_an_input_in_the_chain_are_proved_too() -> None:
    """x1' = u x2, measured twice: one P for the ends of u, and its certificate."""
    pytest.importorskip("clarabel")
    plant = hg.System(
        "driven", states=(x1, x2), inputs=(u,), outputs=(y1, y2), flow=[u * x2, -sp.sin(x1)], output=[x1, -x1]
    )
    observer = hg.observers.high_gain(hg.forms.block_triangular(plant), theta=20, gains=(2, 1))
    assert verdicts(observer.checks)["high_gain.theta"] == "proved"
    rows = recheck(json.dumps(hg.certificate(observer.form, observer.checks, "high_gain"))).rows
    assert {row.found for row in rows} == {"verified"}
    step = hg.sample(observer, hg.methods.rk4, dt=0.01, engine="python")
    alone = hg.observers.high_gain(
        hg.forms.triangular(
            hg.System("driven", states=(x1, x2), inputs=(u,), outputs=(y1,), flow=plant.flow, output=[x1])
        ),
        theta=20,
        gains=(2, 1),
    )
    y = np.sin(np.arange(200) / 30)
    one = ran(hg.sample(alone, hg.methods.rk4, dt=0.01, engine="python"), y)
    assert np.abs(ran(step, np.where(np.arange(200) > 70, np.nan, y), -y) - one).max() < 1e-12


@pytest.mark.parametrize(
    ("output", "weights", "said"),
    [
        ((x1, x2), {"y1": 2}, r"weights are of outputs that show the same state, and here there are none; leave them"),
        ((x1, x1), {"y1": 0}, r"weight of y1 = 0\.?0* must be a positive finite number"),
        ((x1, x1), (1, 2), r"weights = \(1, 2\) must be positive numbers by name, such as \{'y2': 2\}"),
        ((x1, x1), {"y": 2}, r"weights names 'y', which is none of the names"),
        ((x1, x1, x2 + x1), {"y3": 2}, r"weights names 'y3', which alone shows its state, or is not used"),
    ],
)
def test_weights_that_are_none(output: Any, weights: Any, said: str) -> None:
    gains = {**GAINS, "weights": weights} | ({"poles": ((-1,), (-1,))} if x2 in output else {})
    with pytest.raises((BadGain, BadNames), match=rf"^{said}"):
        hg.observers.high_gain(form(*output), **gains)


def test_weights_of_one_output() -> None:
    with pytest.raises(BadGain, match=r"^weights are of outputs that show the same state"):
        hg.observers.high_gain(hg.forms.triangular(swing(x1)), **GAINS, weights={"y1": 1})


# --- others -------------------------------------------------------------------------------------------------


def test_a_filter_weighs_by_the_noise() -> None:
    """Two sensors of variances r and r/4 in the unit of the first are one of r/(1 + 4)."""
    y = samples()
    filters = [
        hg.observers.riccati(made, Q=(1, 1), R=R, theta=3.0)
        for made, R in ((hg.forms.triangular(swing(x1)), 0.01 / 5), (form(x1, -2 * x1), (0.01, 0.01)))
    ]
    one, both = (hg.sample(each, hg.methods.continuous_discrete, dt=0.01, engine="python") for each in filters)
    assert np.abs(ran(one, y) - ran(both, y, -2 * y)).max() < 1e-9


def test_a_filter_scales_only_what_shows_a_first_state() -> None:
    made = form(x1, x1 + x2)
    hg.observers.riccati(made, Q=(1, 1), R=(1, 1))
    with pytest.raises(BadGain, match=r"^theta up to 3 wants outputs .*, y2 of swing shows another; leave it out"):
        hg.observers.riccati(made, Q=(1, 1), R=(1, 1), theta=3.0)


@pytest.mark.parametrize("observer", ["high_gain", "riccati"])
def test_first_gains_are_there(observer: str) -> None:
    one = first(observer, [of("block_triangular", swing(x1, x1))], 0.01)
    assert not isinstance(one, NoFirst), one.reason
    assert one.step is not None


def test_observers_of_one_output_say_so() -> None:
    with pytest.raises(BadGain, match=r"^filtered takes one output, swing has 2; use riccati"):
        hg.observers.filtered(form(x1, x1), theta=5, alpha=3, beta=1, poles=(-1, -1))


def test_no_bound_of_noise_is_verified_of_outputs_that_share_a_chain() -> None:
    """A file that says of the shared chain what is true of one sensor: that noise of the second moves nothing."""
    pytest.importorskip("clarabel")
    step = stepped(x1)
    gains = hg.noise_gain(step)
    assert gains is not None
    content = hg.certificate(step.observer.form, (*step.observer.checks, gains.check), "high_gain")
    assert {row.id: row.found for row in recheck(json.dumps(content)).rows}["high_gain.noise"] == "verified"
    both = json.loads(
        json.dumps(hg.certificate(form(x1, x1), (*stepped(x1, x1).observer.checks, gains.check), "high_gain"))
    )
    claimed = next(claim for claim in both["claims"] if claim["id"] == "high_gain.noise")
    assert claimed["verdict"] == "stated", claimed
