"""Outputs that add nothing: their form, the mean of sensors that show the same, and what is proved of it."""

import copy
import json
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import two_outputs
from worst import Worst

import hgogen as hg
from hgogen.analysis.scaling import redundant_outputs, scaling, unused
from hgogen.check import Verdict
from hgogen.modelfiles.tuning import NoFirst, first
from hgogen.program import Place
from hgogen.prove.plant_step import Heads, Sizes, heads_of
from hgogen.reading.given import BadGain, BadNames
from hgogen.recheck.verification import recheck
from hgogen.stepping.machine import Machine
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


@pytest.mark.ordinary("output8-blocks8-ratios8", "output9-blocks9-ratios9", "output11-blocks11-ratios11")
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
        # a slope of 1 wherever there is one, and jumps
        ((x1, sp.Piecewise((x1, x1 < 0), (x1 - 1, True))), (2, 0), ((0, 1),)),
        ((x1, sp.atan2(sp.sin(4 * x1), sp.cos(4 * x1)) / 4), (2, 0), ((0, 1),)),
        ((k * x1, k * x1 + sp.Piecewise((0, x1 < 0), (1, True))), (2, 0), ((0, 1),)),
        ((k * x1, k * x1 + sp.Piecewise((0, u < 1.5), (1, True))), (2, 0), ((0, 1), (1, 1))),  # with what is known
        ((x1 * (k + 1) / k, 2 * x1 + 2 * x1 / k + u), (2, 0), ((0, 1), (1, 2))),
    ],
)
def test_what_adds_nothing_has_no_chain(output: Any, blocks: Any, ratios: Any) -> None:
    made = form(*output)
    assert made.structured
    assert made.blocks == blocks
    assert {check.verdict for check in made.checks} == {Verdict.PROVED}
    (chain,) = redundant_outputs(made)
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
    assert [[each.output for each in chain] for chain in redundant_outputs(made)] == [[0], [1, 2]]
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


def test_a_sensor_of_little_weight_counts_in_full_where_the_other_is_silent() -> None:
    y = samples()
    both = ran(stepped(x1, -2 * x1, weights={"y1": 3}), np.full(200, np.nan), -2 * y)
    assert np.abs(both - ran(stepped(x1), y)).max() < 1e-12


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


def test_all_is_proved_that_is_of_one_sensor() -> None:
    pytest.importorskip("clarabel")
    one, both = stepped(x1), stepped(x1, -2 * x1)
    alone, shared = (hg.contraction(step) for step in (one, both))
    assert verdicts(alone.checks) == verdicts(shared.checks)
    claims = ("high_gain.convergence", "high_gain.theta")
    mine, theirs = (verdicts(step.observer.checks) for step in (one, both))
    assert [mine[id] for id in claims] == [theirs[id] for id in claims] == ["proved", "proved"]


@pytest.mark.parametrize("method", [hg.methods.rk4, hg.methods.exponential])
@pytest.mark.parametrize(
    ("output", "weights", "shares"),
    [((x1, x1), None, (1 / 2, 1 / 2)), ((x1, 3 - 2 * x1, x1 + x2), {"y1": 3}, (3 / 4, 1 / 8, 0))],
)
def test_noise_enters_by_its_share_in_the_mean(method: Any, output: Any, weights: Any, shares: Any) -> None:
    """Of two alike noise v in each does what it does in one; of y2 = 3 - 2 x1 of a fourth of the weight an eighth."""
    pytest.importorskip("clarabel")
    one = hg.noise_gain(stepped(x1, method=method))
    both = hg.noise_gain(stepped(*output, method=method, weights=weights))
    assert isinstance(one, hg.NoiseGain)
    assert isinstance(both, hg.NoiseGain)
    for (state, _), gain in one.gains.items():
        for y, share in zip(("y1", "y2", "y3"), shares, strict=False):
            assert both.gains[state, y] == pytest.approx(share * gain, rel=1e-4)


@cache
def bounded(*output: Any, **gains: Any) -> hg.ErrorBound:
    step = stepped(*output, **dict(gains, weights=dict(gains.get("weights", ())) or None))
    names = [y.name for y in step.observer.form.system.outputs]
    sizes = {"noise": dict.fromkeys(names, 0.01), "late": dict.fromkeys(names, 1e-4), "rates": {"u": 1}}
    known = hg.error_bound(step, **sizes, disturbance={"x2": 0.1})
    assert known.check.verdict is Verdict.PROVED, known
    return known


@pytest.mark.full
def test_the_error_is_bounded_as_with_one_sensor() -> None:
    """A disturbance shows in both samples at the end of a call, the line between two of each is beside the plant."""
    pytest.importorskip("clarabel")
    one, both = bounded(x1), bounded(x1, x1)
    for what, share in one.shares.items():
        assert both.shares[what] == pytest.approx(share, rel=1e-3)
    assert both.inside == one.inside
    assert both.settles == pytest.approx(one.settles)


def test_a_disturbance_enters_the_samples_of_the_state_that_it_moves() -> None:
    """Both outputs show x1 at the end of a call, neither x2."""
    worst = Worst(stepped(x1, -2 * x1))
    shown = heads_of(worst.form)
    assert shown == {0: (0, 1), 1: (0, -2)}

    def entering(k: int, shown: Heads) -> tuple[Any, Any]:
        beside = Sizes(deviation=tuple(Fraction(i == k) for i in range(2)))
        inputs = beside.inputs(worst.at, worst.error, worst.start.scales, shown)
        return inputs.D.tolist(), inputs.Q.tolist()

    assert entering(0, shown) != entering(0, {})
    assert entering(1, shown) == entering(1, {})


def test_an_output_that_enters_nowhere_has_no_share() -> None:
    pytest.importorskip("clarabel")
    one, beside = bounded(x1), bounded(x1, x1 + x2)
    assert beside.bounds == pytest.approx(one.bounds, rel=1e-3)
    assert "the estimate does not restart from one" in str(beside)
    assert "the estimate does not restart from one" not in str(one)
    assert "nothing enters the error" in str(hg.l2_gain(stepped(x1, x1 + x2).observer, noise={"y2": 1}))


def test_no_run_of_both_errs_further() -> None:
    """Noise of both by the sign of the error, against it or with it, beside a plant that rests."""
    pytest.importorskip("clarabel")
    step, known, worst = stepped(x1, x1), bounded(x1, x1), np.zeros(2)
    for push in (1, -1):
        machine, x, error = Machine(step), np.array([np.pi / 2, 0.0]), np.zeros(2)
        for k in range(400):
            for y in ("y1", "y2"):
                machine.memory[Place("output", y)][0] = x[0] + 0.01 * push * (np.sign(error[0]) or 1)
            machine.memory[Place("input", "u")][0] = 1
            machine.call()
            error = np.array([machine.memory[Place("estimate", name)][0] for name in ("x1", "x2")]) - x
            worst = np.maximum(worst, np.abs(error)) if k > 200 else worst
    bounds = np.array(list(known.bounds.values()))
    assert (worst <= 1.1 * bounds).all()
    assert worst[0] > 0.5 * bounds[0]


def test_the_certificate_is_verified() -> None:
    pytest.importorskip("clarabel")
    step = stepped(x1, -2 * x1)
    content = hg.certificate(step.observer.form, (*step.observer.checks, *hg.contraction(step).checks), "high_gain")
    rows = recheck(json.dumps(content)).rows
    assert {row.found for row in rows} == {"verified"}
    assert len(rows) > 7


@cache
def certified() -> dict[str, Any]:
    """Of two sensors and of an output that enters nowhere."""
    output, weights = (x1, 3 - 2 * x1, x1 + x2), {"y1": 3}
    step, noise = stepped(*output, weights=weights), {"y1": 0.01, "y2": 0.02}
    known, gain = bounded(*output, weights=tuple(weights.items())), hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    bounds = (known, gain, hg.l2_gain(step.observer, noise=noise), hg.iss_gain(step.observer, noise=noise))
    return hg.certificate(
        step.observer.form, (*step.observer.checks, *(each.check for each in bounds)), step.observer.name
    )


def outcome(content: Any) -> dict[str, str]:
    return {row.id.split(".")[1]: row.found for row in recheck(sealed(content)).rows if row.id.startswith("high_gain")}


INPUTS = ("noise", "error", "l2_gain", "iss_gain")


def test_how_noise_enters_is_verified_again() -> None:
    pytest.importorskip("clarabel")
    verdicts = outcome(certified())
    assert {verdicts[fact] for fact in INPUTS} == {"verified"}
    assert certified()["observer"]["weights"] == ["3", "1", "1"]


def test_other_weights_fail() -> None:
    """Of two sensors alike noise of the second does twice as much as of one of a fourth of the weight."""
    pytest.importorskip("clarabel")
    content = copy.deepcopy(certified())
    content["observer"]["weights"] = ["1", "1", "1"]
    assert outcome(content)["noise"] == "fails"


@pytest.mark.parametrize("weights", [["3", "1", "0"], ["3", "-1", "1"], ["3", "1"], "3", None])
def test_what_are_no_weights_fails(weights: Any) -> None:
    pytest.importorskip("clarabel")
    content = copy.deepcopy(certified())
    if weights is None:
        del content["observer"]["weights"]
    else:
        content["observer"]["weights"] = weights
    verdicts = outcome(content)
    assert {verdicts[fact] for fact in INPUTS} == {"fails"}


@pytest.mark.parametrize("key", ["slopes", "lines"])
def test_a_line_of_the_second_sensor_follows_from_the_plant(key: str) -> None:
    """Of twice the slope it is twice as far beside the plant; of an output that enters nowhere nothing is asked."""
    pytest.importorskip("clarabel")
    content = copy.deepcopy(certified())
    (claim,) = (claim for claim in content["claims"] if claim["id"] == "high_gain.error")
    (share,) = (each for each in claim["evidence"]["shares"] if each["inputs"] == "method")
    assert {*share["stages"][2], *share["follows"]["slopes"][2], *share["follows"]["lines"][2]} == {"0"}
    share["follows"][key][1] = share["follows"][key][0]
    assert outcome(content)["error"] == "fails"


def test_noise_of_what_is_not_shown_to_enter_is_not_verified() -> None:
    pytest.importorskip("clarabel")
    content = copy.deepcopy(certified())
    for claim in content["claims"]:
        if claim["id"] == "high_gain.error":
            (share,) = (each for each in claim["evidence"]["shares"] if each["inputs"] == "noise")
            share["samples"][2] = share["follows"]["sizes"][2] = "1/100"
        if claim["id"] == "high_gain.noise":
            claim["evidence"]["bounds"][0]["output"] = "3"
        if claim["id"] in ("high_gain.l2_gain", "high_gain.iss_gain"):
            claim["evidence"]["noise"][2] = "1/100"
    verdicts = outcome(content)
    assert {verdicts[fact] for fact in INPUTS} == {"fails"}


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


def test_noise_of_the_second_that_moves_nothing_is_not_verified() -> None:
    """A file that says of the shared chain that noise of the second sensor moves nothing, as of one sensor."""
    pytest.importorskip("clarabel")
    content = copy.deepcopy(certified())
    (claim,) = (claim for claim in content["claims"] if claim["id"] == "high_gain.noise")
    for one in claim["evidence"]["bounds"]:
        one["bound"] = "1/1000000" if one["output"] == "2" else one["bound"]
    assert outcome(content)["noise"] == "fails"
