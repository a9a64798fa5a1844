"""Bounds of the error where what enters meets something else: late samples a disturbance, a parameter a jump."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed

import hgogen as hg
from hgogen.certificates.contraction import contraction
from hgogen.check import Verdict
from hgogen.program import Place
from hgogen.recheck.verification import recheck
from hgogen.step import NoStep
from hgogen.stepping.machine import Machine


def lag(flow: sp.Expr, *parameters: hg.Signal, slope: float = 1, **options: str) -> hg.Step:
    """x' = flow(x) on -5..5, y = slope x, theta = 20 at dt = .01."""
    x = hg.Signal("x", low=-5, high=5)
    rate = [sp.sympify(flow).subs(sp.Symbol("x"), x)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    plant = hg.System(
        "lag", states=(x,), inputs=(u,), outputs=(y,), parameters=parameters, flow=rate, output=[slope * x]
    )
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=[-1])
    return hg.sample(observer, hg.methods.rk4, dt=0.01, **options)


def test_a_late_sample_shows_the_disturbance_as_well() -> None:
    """A disturbance that drives the plant from end to end, beside which its own speed is nothing."""
    step, late, pushed = lag(-sp.Symbol("x") / 10), 5, 20.0
    known = hg.error_bound(step, late={"y": late * step.dt}, disturbance={"x": pushed})
    assert known.settles is not None
    machine, x, sign, errors = Machine(step), [0.0] * (late + 1), 1.0, []
    for _ in range(600):
        machine.memory[Place("output", "y")][0] = x[-1 - late]
        machine.call()
        errors.append(abs(machine.memory[Place("estimate", "x")][0] - x[-1]))
        sign = -np.sign(x[-1]) if abs(x[-1]) > 4.75 else sign
        x.append(x[-1] + (1 - np.exp(-step.dt / 10)) * (10 * sign * pushed - x[-1]))
    worst = max(errors[round(known.settles / step.dt) :])
    assert 0.6 * known.bounds["x"] < worst <= 1.1 * known.bounds["x"]


def test_a_late_sample_shows_the_parameter_as_well() -> None:
    p = hg.Signal("p", nominal=0.5)
    known = hg.error_bound(lag(p, p), late={"y": 0.1}, parameters={"p": 1})
    assert known.shares["late"]["x"] == pytest.approx(0.15, rel=0.01)


def test_of_a_parameter_at_which_the_flow_jumps_there_is_no_bound() -> None:
    p, x = hg.Signal("p", nominal=0.4), sp.Symbol("x")
    step = lag(-x + sp.Piecewise((1, p > sp.Rational(1, 2)), (0, True)), p)
    assert hg.error_bound(step, parameters={"p": 0.05}).check.verdict is Verdict.PROVED
    known = hg.error_bound(step, parameters={"p": 0.3})
    assert known.check.verdict is Verdict.UNKNOWN
    assert "may jump with p" in str(known)


def test_where_nothing_enters_there_is_nothing_to_bound() -> None:
    known = hg.error_bound(lag(0))
    assert known.check.verdict is Verdict.UNKNOWN
    assert "nothing enters the error" in str(known)
    assert hg.error_bound(lag(0), noise={"y": 1}).check.verdict is Verdict.PROVED


def kept(noise: float, calls: int) -> tuple[hg.ErrorBound, float, set[str]]:
    """A plant at rest far from where its estimate restarts, under noise of changing sign: the bounds, how far x2 errs
    once these hold, and what the status says."""
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=-20, high=20)
    u, y = hg.Signal("u", low=-20, high=20), hg.Signal("y")
    plant = hg.System("rest", states=(x1, x2), inputs=(u,), outputs=(y,), flow=[x2 / 5 - x1, u - x2], output=[x1])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=1, poles=[-1, -1])
    step = hg.sample(observer, hg.methods.rk4, dt=0.1, between="hold")
    known, machine, worst, status = hg.error_bound(step, noise={"y": noise}), Machine(step), 0.0, 0
    assert known.settles is not None
    machine.memory[Place("input", "u")][0] = 15
    for k in range(calls):
        machine.memory[Place("output", "y")][0] = 3 + noise * (-1) ** k
        status |= machine.call()
        if k * step.dt >= known.settles:
            worst = max(worst, abs(machine.memory[Place("estimate", "x2")][0] - 15))
    return known, worst, {bit.place.name for i, bit in enumerate(step.layout.bits) if status >> i & 1}


GUARDS = "no sample is rejected, and the estimate does not restart"


def test_noise_that_might_restart_an_estimate_is_said() -> None:
    """Errors beyond a tenth of what y spans, which a proof does not follow from sample to sample."""
    known, worst, status = kept(0.85, 300)
    assert status <= {"OUTSIDE_BOX"}
    assert worst <= known.bounds["x2"]
    assert GUARDS in str(known)


def test_of_less_noise_no_guard_is_spoken() -> None:
    known, worst, status = kept(0.05, 300)
    assert status <= {"OUTSIDE_BOX"}
    assert worst <= 1.1 * known.bounds["x2"]
    assert GUARDS not in str(known)


@pytest.mark.parametrize(("noise", "bound"), [(9.0, True), (11.0, False)])
def test_a_bound_that_is_more_than_the_range_is_wide_is_unknown(noise: float, bound: bool) -> None:
    """Of a range that is 10 wide, where noise moves the estimate by about as much; nothing else is known of it."""
    known = hg.error_bound(lag(-sp.Symbol("x")), noise={"y": noise})
    assert (known.check.verdict is Verdict.PROVED) is bool(known.bounds) is bool(known.signed.bounds) is bound
    if not bound:
        said = str(known.check.reason)
        assert said.startswith("x is unknown, as ")
        assert "is more than its range is wide, 10, and noise alone has " in said
        assert known.check.fix == "State less of what enters, or take other gains."


@pytest.mark.parametrize(("noise", "rounded", "spoken"), [(0.3, 0.36, False), (0.3, 0.44, True), (0.52, 0, True)])
def test_all_by_which_a_sample_errs_counts_for_the_guards(noise: float, rounded: float, spoken: bool) -> None:
    """A tenth of the span is 1; both errors are in the sample, and about as much in the estimate: .48 or .52."""
    known = hg.error_bound(lag(-sp.Symbol("x")), noise={"y": noise}, rounded={"y": rounded})
    assert (GUARDS in str(known)) is spoken


@pytest.mark.parametrize(("low", "spoken"), [(0, True), (-0.1, False), (-0.9, False), (-1, True)])
def test_a_sample_beyond_a_width_of_its_range_is_said(low: float, spoken: bool) -> None:
    """y = x, from -1 to 1, is declared to be from `low` to a width of 1 above."""
    x, y = hg.Signal("x", low=-1, high=1), hg.Signal("y", low=low, high=low + 1)
    plant = hg.System("beyond", states=(x,), outputs=(y,), flow=[-x], output=[x])
    step = hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=[-1]), hg.methods.rk4, dt=0.01)
    assert (GUARDS in str(hg.error_bound(step, noise={"y": 0.02}))) is spoken


@pytest.mark.parametrize(("noise", "taken"), [(0.1, 1.0), (1.0, 1.0), (8.0, 0.4)])
def test_what_is_left_of_the_start_falls_by_the_proved_share(noise: float, taken: float) -> None:
    """To a tenth of the bound, about the noise, from the first errors of 5, or those that leave room in 10: the less of
    them the further that bound is above the least one."""
    step = lag(-sp.Symbol("x"))
    known, proof = hg.error_bound(step, noise={"y": noise}), contraction(step).proof
    assert proof is not None
    assert known.settles is not None
    assert known.multiple is not None
    assert min(known.multiple, 1) == pytest.approx(taken, rel=0.03)
    calls = (
        2 * np.log(min(known.multiple, 1) * 5 / (0.1 * known.bounds["x"])) / -np.log1p(-float(proof.alpha * proof.h))
    )
    assert known.settles / step.dt == pytest.approx(np.ceil(calls))


def test_a_parameter_counts_by_its_steepest_slope_beside_the_program_s() -> None:
    """exp(-p) at p = -1 as at 0, and half of a disturbance of that size twice."""
    p = hg.Signal("p", nominal=0)
    known = hg.error_bound(lag(sp.exp(-p), p), parameters={"p": 1}, disturbance={"x": 2 * np.e})
    assert known.shares["parameters"]["x"] == pytest.approx(known.shares["disturbance"]["x"] / 2, rel=0.01)


def test_the_plant_keeps_clear_by_its_largest_speed_whatever_its_sign() -> None:
    known = hg.error_bound(lag(sp.Symbol("x") / 5 - 2), noise={"y": 0.1})
    assert known.inside["x"] == pytest.approx(0.01 * 3)


def test_an_input_moves_at_its_fastest_declared_rate_whatever_its_sign() -> None:
    x, u = hg.Signal("x", low=-1, high=1), hg.Signal("u", low=-1, high=1, rates=((-50, 1),))
    plant = hg.System("led", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=[u - x], output=[x])
    step = hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=[-1]), hg.methods.rk4, dt=0.01)
    assert hg.error_bound(step).shares == hg.error_bound(step, rates={"u": 50}).shares
    assert hg.error_bound(step).shares != hg.error_bound(step, rates={"u": 1}).shares


def test_an_output_may_have_a_slope_in_decimals() -> None:
    step = lag(-sp.Symbol("x"), slope=-0.1)
    known, whole = hg.error_bound(step, noise={"y": 0.01}), hg.error_bound(lag(-sp.Symbol("x")), noise={"y": 0.1})
    assert known.shares["noise"]["x"] == pytest.approx(whole.shares["noise"]["x"], rel=1e-3)
    assert GUARDS not in str(known)
    content = hg.certificate(step.observer.form, (*step.observer.checks, known.check), "high_gain")
    assert [row.found for row in recheck(sealed(content)).rows if row.id == "high_gain.error"] == ["verified"]


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ({"noise": 1}, "noise = 1 is no mapping from names to numbers"),
        ({"noise": [1]}, "noise = [1] is no mapping"),
        ({"rates": 3}, "rates = 3 is no mapping"),
        ({"noise": {"y": 10**400}}, "must be a number"),
        ({"noise": {"y": True}}, "noise of y = True must be a finite number, not negative"),
        ({"rates": {"u": False}}, "rates of u = False must be a finite number"),
        ({"noise": {"y": None}}, "noise of y = None must be a number"),
        ({"rates": {"u": -1}}, "rates of u = -1 must be a finite number, not negative"),
    ],
)
def test_what_is_no_size_is_named(sizes: dict[str, Any], said: str) -> None:
    """Of an input that is held, too, whose rates are not read."""
    with pytest.raises(hg.HgogenError) as error:
        hg.error_bound(lag(-sp.Symbol("x"), between="hold"), **sizes)
    assert said in str(error.value)


@pytest.mark.full
def test_a_disturbance_is_of_the_plant_before_it_was_recast() -> None:
    """w = x1 - x2: what moves x2 moves w as well, and the estimate of x2 errs by all of a lasting disturbance."""
    x1, x2, w = hg.Signal("x1", low=-3, high=3), hg.Signal("x2", low=-1, high=1), hg.Signal("w", low=-4, high=4)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    plant = hg.System("pair", states=(x1, x2), inputs=(u,), outputs=(y,), flow=[u, u - x2], output=[x1 - x2])
    form = hg.forms.triangular(hg.recast(plant, {w: x1 - x2}, {x1: w + x2}))
    step = hg.sample(hg.observers.high_gain(form, theta=5, poles=[-1, -1]), hg.methods.rk4, dt=0.01, between="hold")
    known, machine, x = hg.error_bound(step, disturbance={"x2": 0.1}), Machine(step), np.zeros(2)
    assert known.settles is not None
    for _ in range(round(known.settles / step.dt) + 100):
        machine.memory[Place("output", "y")][0] = x[0] - x[1]
        machine.call()
        error = machine.memory[Place("estimate", "x2")][0] - x[1]
        x[1] += (1 - np.exp(-step.dt)) * (0.1 - x[1])
    assert 0.09 < abs(error) <= 1.1 * known.bounds["x2"]
    assert hg.error_bound(step, disturbance={"x1": 0.1}).check.verdict is Verdict.PROVED


def test_a_parameter_in_the_map_of_a_recast_plant_is_said() -> None:
    x, w, u, y = (hg.Signal(name, low=-2, high=2) for name in ("x", "w", "u", "y"))
    p = hg.Signal("p", nominal=0.5)
    plant = hg.System("part", states=(x,), inputs=(u,), outputs=(y,), parameters=(p,), flow=[u - x], output=[p * x])
    form = hg.forms.triangular(hg.recast(plant, {w: p * x}, {x: w / p}))
    step = hg.sample(hg.observers.high_gain(form, theta=5, poles=[-1]), hg.methods.rk4, dt=0.01, between="hold")
    known = hg.error_bound(step, parameters={"p": 0.1})
    assert known.check.verdict is Verdict.UNKNOWN


@pytest.mark.parametrize("proof", [hg.contraction, hg.noise_gain, hg.start_set, hg.error_bound])
@pytest.mark.parametrize("other", [None, "step", hg.methods.rk4])
def test_what_is_no_step_is_refused(proof: Any, other: Any) -> None:
    with pytest.raises(NoStep) as error:
        proof(other)
    assert f"given to {proof.__name__} is no step; make one by hg.sample" in str(error.value)


@pytest.mark.full
def test_a_short_chain_aligned_at_the_end_is_in_units_of_its_own() -> None:
    """The errors of its first state are over a power of theta, and so are those of its samples, or what one sample
    shows of a disturbance would seem to undo it."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, 5)]
    y1, y2 = hg.Signal("y1"), hg.Signal("y2")
    flow = [-x[0] / 10 + sp.sin(x[2]) * x[3] / 20, x[2], x[3], -x[1] / 10]
    plant = hg.System("ends", states=tuple(x), outputs=(y1, y2), flow=flow, output=x[:2])
    form = hg.forms.block_triangular(plant)
    assert (form.alignment, form.blocks) == ("end", (1, 3))
    observer = hg.observers.high_gain(form, theta=10, poles=((-1,), (-1, -1, -1)))
    step = hg.sample(observer, hg.methods.heun, dt=2e-3)
    known = hg.error_bound(step, disturbance={"x1": 1}, noise={"y1": 1})
    assert 1 / 10.1 <= known.shares["disturbance"]["x1"] < 0.105  # e' = -10.1 e - 1, while the plant rests
    assert 0.98 <= known.shares["noise"]["x1"] < 1.1
    content = hg.certificate(form, (*observer.checks, *hg.contraction(step).checks, known.check), observer.name)
    rows = {row.id: row.found for row in recheck(sealed(content)).rows}
    assert rows["high_gain.error"] == "verified"
    (claim,) = (each for each in content["claims"] if each["id"] == "high_gain.error")
    for share in claim["evidence"]["shares"]:
        for one in share["bounds"]:
            one["bound"] = str(Fraction(one["bound"]) / 50)
    rows = {row.id: row.found for row in recheck(sealed(content)).rows}
    assert rows["high_gain.error"] != "verified"


@pytest.mark.parametrize(("x2", "u", "names"), [({}, (-1, 1), "x2"), ({"low": -1, "high": 1}, None, "u")])
def test_without_a_range_the_bound_asks_for_it(x2: Any, u: Any, names: str) -> None:
    x = [hg.Signal("x1", low=-1, high=1), hg.Signal("x2", **x2)]
    drive = hg.Signal("u", low=u[0], high=u[1]) if u else hg.Signal("u")
    flow, outputs = [x[1], drive - x[0] - x[1]], (hg.Signal("y"),)
    plant = hg.System("endless", states=x, inputs=(drive,), outputs=outputs, flow=flow, output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=[-1, -1])
    check = hg.error_bound(hg.sample(observer, hg.methods.rk4, dt=0.01), noise={"y": 0.1}, rates={"u": 1}).check
    assert check.verdict is Verdict.UNKNOWN
    assert f"is bounded on ranges, and {names} has none" in str(check.reason)
    assert check.fix == f"Declare low and high of {names}."


def test_ranges_that_the_limits_of_an_estimate_do_not_hold_have_no_set_of_starts() -> None:
    x = [hg.Signal(name, low=-1e30, high=1e30) for name in ("x1", "x2")]
    plant = hg.System("vast", states=x, outputs=(hg.Signal("y"),), flow=[x[1], -x[0] - x[1]], output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=[-1, -1])
    with np.errstate(all="ignore"):
        start = hg.start_set(hg.sample(observer, hg.methods.rk4, dt=0.01))
    assert str(start) == "the limits of the estimate do not hold the ranges with room around"


@pytest.mark.full
def test_a_flow_whose_series_divide_by_balls_that_hold_zero_has_a_remainder_in_cells() -> None:
    """The square of a wide ball holds numbers below 0, so does what is divided by; that of a narrow one does not."""
    x, v = hg.Signal("x", low=-300, high=300), hg.Signal("v", low=-300, high=300)
    flow = [v, -5 * v / (25 + v**2) - v]
    plant = hg.System("steep", states=(x, v), outputs=(hg.Signal("y"),), flow=flow, output=[x])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=6, poles=[-1, -1])
    known = hg.error_bound(hg.sample(observer, hg.methods.rk4, dt=0.01), noise={"y": 0.1})
    assert known.check.verdict is Verdict.PROVED
    assert known.bounds["v"] < 4
