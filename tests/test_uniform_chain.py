"""The uniform form as a chain of integrators: the paper's coordinates by hand and by numbers, and observers on it."""

import copy
import json
from itertools import product
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import strategies as st
from plants import MODELS

import hgogen as hg
from hgogen.certificates.certificate import certificate
from hgogen.check import Check, Verdict
from hgogen.forms.uniform_chain import NoUniformChain
from hgogen.model import load
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.verification import recheck
from hgogen.theorem import rows
from hgogen.trial import Trial, simulate, t
from tests.sweep import sweep

Y = hg.Signal("y")


def states(n: int, low: float = -1, high: float = 1) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=low, high=high) for i in range(1, n + 1)]


def plant(flow: list[Any], x: list[hg.Signal], output: Any = None, **rest: Any) -> hg.System:
    y = x[0] if output is None else output
    return hg.System("plant", states=x, outputs=(Y,), flow=flow, output=[y], **rest)


def bent(**rates: Any) -> hg.System:
    """Rows that bring in one state each with a slope that moves, and an input that multiplies."""
    x, u = states(3), hg.Signal("u", low=-1, high=1, **rates)
    flow = [
        (2 + x[0] / 2) * x[1] + u * x[0],
        (3 + u) * x[2] - x[1] ** 2,
        x[0] - x[2] * x[1] + u,
    ]
    return plant(flow, x, inputs=(u,))


def checks(form: hg.Form) -> dict[str, Check]:
    return {check.id.removeprefix("uniform_chain."): check for check in form.checks}


# --- by hand ------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_the_coordinates_of_the_paper() -> None:
    """xi_2 = F_1, xi_3 = dF_1/dx_2 F_2, in which F_2 reads x_3."""
    system = bent(rates=((-1, 1),))
    x, u = system.states, system.inputs[0]
    xi = hg.forms.uniform_chain(system).to_form
    F = system.flow
    assert xi[0] == x[0]
    assert sp.simplify(xi[1] - F[0]) == 0
    assert sp.simplify(xi[2] - F[0].diff(x[1]) * F[1]) == 0
    J = sp.Matrix(xi).jacobian(sp.Matrix(x))
    assert all(J[i, j] == 0 for i, j in product(range(3), repeat=2) if j > i)
    diagonal = [1, F[0].diff(x[1]), F[0].diff(x[1]) * F[1].diff(x[2])]
    assert all(sp.simplify(J[i, i] - d) == 0 for i, d in enumerate(diagonal))
    assert u in xi[1].free_symbols


@pytest.mark.parametrize(
    "jumps",
    [
        lambda x: sp.Piecewise((x, x < 0), (x - 1, True)),
        lambda x: sp.atan2(sp.sin(4 * x), sp.cos(4 * x)),
        lambda x: sp.Piecewise((2 * x, x < sp.Rational(1, 2)), (2 * x - 3, True)),
    ],
)
def test_an_output_that_jumps_is_no_multiple_of_a_state_though_its_slope_is_a_number(jumps: Any) -> None:
    x = states(2)
    with pytest.raises(NoUniformChain, match="not a constant times x1; recast x1"):
        hg.forms.uniform_chain(plant([x[1], -x[0]], x, jumps(x[0])))


def test_what_jumps_or_bends_moves_as_no_derivative_says() -> None:
    """x2 - 1 and x2, one above the other: the first of xi that moves by an impulse, and no slope sees it."""
    x = states(2)
    jumps = checks(hg.forms.uniform_chain(plant([sp.Piecewise((x[1] - 1, x[1] > 0), (x[1], True)), -x[0]], x)))
    assert {name for name, check in jumps.items() if check.verdict is Verdict.PROVED} == {"slope_1", "inputs"}
    assert str(jumps["structure"].reason).startswith("Piecewise")
    assert str(jumps["slope_2"].reason).startswith("x1' may jump with x2, at a step of Piecewise")
    bends = checks(hg.forms.uniform_chain(plant([x[1] + sp.Abs(x[1]) / 2, -x[0]], x)))
    assert {name for name, check in bends.items() if check.verdict is Verdict.PROVED} == {
        *("slope_1", "slope_2", "inputs")
    }


@pytest.mark.full
def test_of_the_derivatives_of_an_input_only_the_first_enters() -> None:
    """The phase form of the same plant reads u'' as well."""
    system = bent(rates=((-1, 1), (-1, 1), (-1, 1)))
    form = hg.forms.uniform_chain(system)
    assert [u.name for u in form.system.inputs] == ["u", "u_dot"]
    assert "u_ddot" in [u.name for u in hg.forms.phase(system).system.inputs]
    assert checks(form)["inputs"].verdict is Verdict.PROVED
    assert checks(hg.forms.uniform_chain(bent()))["inputs"].verdict is Verdict.UNKNOWN


@pytest.mark.full
def test_all_is_proved_of_it() -> None:
    form = hg.forms.uniform_chain(bent(rates=((-1, 1),)))
    assert {check.verdict for check in form.checks} == {Verdict.PROVED}
    assert [*checks(form)] == ["structure", "slope_1", "slope_2", "slope_3", "smooth", "inputs", "lipschitz"]


def test_an_output_with_a_gain_and_an_offset() -> None:
    x, u = states(2), hg.Signal("u", low=-1, high=1)
    k = hg.Signal("k", nominal=2.0, low=1, high=3)
    system = plant([(2 + x[0]) * x[1], -x[0]], x, 3 * k * x[0] + u, inputs=(u,), parameters=(k,))
    form = hg.forms.uniform_chain(system)
    assert form.to_form[0] == 3 * k * x[0]
    assert sp.simplify(form.to_form[1] - 3 * k * (2 + x[0]) * x[1]) == 0
    assert form.output == (form.states[0] + u,)


# --- by numbers ---------------------------------------------------------------------------------------------


@pytest.mark.full
@sweep(3, 30, st.integers(2, 3), st.integers(0, 2**32 - 1))
def test_the_equations_are_the_plants(n: int, seed: int) -> None:
    """d/dt xi(x, u) by differences along the plant is xi_{i+1} + b_i, and b_i reads no state beyond xi_i."""
    rng = np.random.default_rng(seed)
    x, u = states(n), hg.Signal("u", low=-1, high=1, rates=((-2, 2),))
    a = [float(value) for value in np.round(rng.uniform(0.2, 0.8, n), 2)]
    flow = [(2 + a[i] * u) * (x[i + 1] if i + 1 < n else 1) + a[i] * x[i] ** 2 for i in range(n)]
    flow[0] = (2 + a[0] * x[0]) * x[1] - x[0] * u
    form = hg.forms.uniform_chain(plant(flow, x, inputs=(u,)))
    assert form.kind == "uniform_chain"
    rate = form.system.inputs[1]
    assert all(row.free_symbols <= {*form.states[: i + 1], u, rate} for i, row in enumerate(form.b))
    to_form = sp.lambdify([*x, u], form.to_form, "math")
    to_plant = sp.lambdify([*form.states, u], form.from_form, "math")
    speeds = sp.lambdify([*form.states, u, rate], form.flow, "math")
    f = sp.lambdify([*x, u], flow, "math")
    for _ in range(10):
        at, force, moving = rng.uniform(-1, 1, n), rng.uniform(-1, 1), rng.uniform(-2, 2)
        assert to_plant(*to_form(*at, force), force) == pytest.approx(at, abs=1e-9)
        h, v = 1e-5, np.array(f(*at, force))
        ahead, behind = (np.array(to_form(*(at + s * h * v), force + s * h * moving)) for s in (1, -1))
        expected = np.array(speeds(*to_form(*at, force), force, moving))
        assert (ahead - behind) / (2 * h) == pytest.approx(expected, rel=1e-5, abs=1e-5)


# --- what it is not for -------------------------------------------------------------------------------------


def test_a_slope_that_vanishes_keeps_the_plants_coordinates() -> None:
    x = states(2)
    form = hg.forms.uniform_chain(plant([x[1] ** 2, -x[0]], x))
    assert form.jacobian is not None
    assert form.kind == "uniform_chain, original coordinates"
    assert checks(form)["slope_2"].verdict is Verdict.REFUTED
    assert checks(form)["lipschitz"].verdict is Verdict.UNKNOWN


def test_a_row_with_a_kink_is_not_taken_for_smooth() -> None:
    x = states(2)
    form = hg.forms.uniform_chain(plant([2 * x[1] + abs(x[1]), -x[0]], x))
    assert checks(form)["smooth"].verdict is Verdict.UNKNOWN
    assert form.jacobian is not None


def test_a_row_without_an_inverse_in_closed_form_keeps_the_plants_coordinates() -> None:
    x = states(2)
    form = hg.forms.uniform_chain(plant([3 * x[1] + sp.sin(x[1]), -x[0]], x))
    assert form.jacobian is not None
    assert {check.verdict for check in form.checks} == {Verdict.PROVED}


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (plant([1, 0], states(2)), "is not shown to be in uniform form"),
        (plant([states(2)[1], 0], states(2), states(2)[0] ** 3), "measures x1\\*\\*3, not a constant times x1"),
    ],
)
def test_a_plant_that_it_does_not_take_is_told_why(system: hg.System, said: str) -> None:
    with pytest.raises(NoUniformChain, match=said):
        hg.forms.uniform_chain(system)


def test_two_outputs_are_refused() -> None:
    x = states(2)
    two = hg.System("two", states=x, outputs=(Y, hg.Signal("v")), flow=[x[1], 0], output=[x[0], x[1]])
    with pytest.raises(NoUniformChain, match="has 2 outputs, y, v"):
        hg.forms.uniform_chain(two)


# --- observers on it ----------------------------------------------------------------------------------------

TRIAL = Trial("it", 8, start={"x1": 0.3, "x2": -0.2, "x3": 0.1}, inputs={"u": sp.sin(t) / 2})


@pytest.mark.ordinary("low_power-True", "switched_gain-True")
@pytest.mark.parametrize("original", [False, True])
@pytest.mark.parametrize("name", ["high_gain", "low_power", "switched_gain"])
def test_observers_converge_on_it(name: str, original: bool) -> None:
    """In xi, and through dxi/dx, in which an input's derivative does not enter."""
    x, u = states(3, -2, 2), hg.Signal("u", low=-1, high=1, rates=((-1, 1),))
    flow = [(2 + x[0] / 5) * x[1], (3 + u / 2) * x[2] - x[1], -x[0] - x[1] - x[2] + u / 2]
    form = hg.forms.uniform_chain(plant(flow, x, inputs=(u,)), original=original)
    if original and name != "high_gain":
        return
    assert [each.name for each in form.system.inputs] == (["u"] if original else ["u", "u_dot"])
    gains: dict[str, Any] = {
        "high_gain": {"theta": 5, "poles": (-1, -1, -1)},
        "low_power": {"theta": 8},
        "switched_gain": {"theta": 8, "theta_low": 5, "threshold": 0.1, "hold": 1, "poles": (-1, -1, -1)},
    }
    observer = getattr(hg.observers, name)(form, **gains[name])
    step = hg.sample(observer, hg.methods.rk4, dt=2e-3)
    true = simulate(form.system, TRIAL, 2e-3)
    run = step.run(u=true.u, y=true.y, engine="python")
    assert np.abs(run.x[-1] - true.x[-1]).max() < 1e-4
    assert np.abs(run.x[0] - true.x[0]).max() > 0.05


@pytest.mark.full
def test_the_header_says_where_the_derivative_comes_from() -> None:
    form = hg.forms.uniform_chain(bent(rates=((-1, 1),)), original=False)
    step = hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1, -1)), hg.methods.rk4, dt=1e-3)
    text = hg.targets.c99(step)["plant.h"]
    assert "derivative of u; you supply it, from what sets the signal or from a filter of it" in " ".join(text.split())


@pytest.mark.full
def test_the_theorem_knows_the_form() -> None:
    form = hg.forms.uniform_chain(load(MODELS / "glucose_insulin.toml").plant)
    observer = hg.observers.high_gain(form, theta=5, poles=(-1, -1, -1))
    known = {row.claim: row.verdict for row in rows(observer.theorem, observer.checks)}
    assert known["xi is a change of coordinates, with u' in its range"] is Verdict.PROVED
    assert not any("Phi = (y, y', .." in claim for claim in known)


@pytest.mark.full
def test_a_bound_in_these_coordinates_may_be_lower() -> None:
    """Of glucose and insulin 1.31, by the derivatives of y 2.71: there the last row alone holds what stands in two."""
    system = load(MODELS / "glucose_insulin.toml").plant
    bounds = []
    for form in (hg.forms.uniform_chain(system), hg.forms.phase(system)):
        observer = hg.observers.high_gain(form, theta=5, poles=(-1, -1, -1))
        check = next(check for check in observer.checks if check.id == "high_gain.convergence")
        bounds.append(float(check.proofs[0].fact.theta))
    assert bounds[0] < 0.6 * bounds[1]


# --- certificates -------------------------------------------------------------------------------------------


def findings(content: dict[str, Any]) -> dict[str, str]:
    content = {**content, "model": model_digest(content)}
    return {row.id: row.found for row in recheck(json.dumps({**content, "digest": digest(content)})).rows}


@pytest.mark.full
def test_a_certificate_of_an_observer_on_it() -> None:
    """The structure is shown with the claim, of the equations in the file; of other equations it fails."""
    form = hg.forms.uniform_chain(load(MODELS / "lotka_volterra.toml").plant)
    observer = hg.observers.high_gain(form, theta=400, poles=(-1, -1))
    content = json.loads(json.dumps(certificate(form, observer.checks, observer.name)))
    ids = ("high_gain.convergence", "high_gain.theta")
    assert {findings(content)[id] for id in ids} == {"verified"}
    for forge in (
        lambda form: form["b"].__setitem__(0, "z1/1000"),
        lambda form: form["b"].__setitem__(1, "0"),
        lambda form: form["to_form"].__setitem__(1, form["to_form"][0]),
        lambda form: form["states"][0].__setitem__("high", "2"),
    ):
        forged = copy.deepcopy(content)
        forge(forged["form"])
        assert "verified" not in {findings(forged)[id] for id in ids}
