"""The phase form on plants whose maps and inverses are known, and observers on it that converge, in C as in Python."""

import importlib
import itertools
from collections.abc import Mapping
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from plants import model, van_der_pol

import hgogen as hg
from hgogen.analysis.determinant import Determinant
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import NoDeterminant, largest_determinant
from hgogen.analysis.maps import inverse
from hgogen.check import Check, Refuted, Verdict
from hgogen.forms.phase import NoPhase
from hgogen.reading.given import BadGain
from hgogen.rigor.bounds import variants
from hgogen.theorem import rows
from hgogen.trial import Trial, simulate, t

Y = hg.Signal("y")


def states(*ranges: tuple[float, float]) -> tuple[hg.Signal, ...]:
    return tuple(hg.Signal(f"x{i}", low=low, high=high) for i, (low, high) in enumerate(ranges, 1))


def plant(name: str, x: tuple[hg.Signal, ...], flow: list[Any], output: Any, **rest: Any) -> hg.System:
    return hg.System(name, states=x, outputs=(Y,), flow=flow, output=[output], **rest)


@cache
def bioreactor(**rates: Any) -> hg.System:
    """(15) of Bullinger, Ilchmann, Allgoewer 1998, a3 = 1."""
    m, s = hg.Signal("m", low=0.01, high=0.2), hg.Signal("s", low=0, high=0.2)
    u = hg.Signal("u", "1/h", "inflow", 0.08, low=0, high=0.2, **rates)
    a1, a2 = hg.Signal("a1", nominal=1), hg.Signal("a2", nominal=1)
    growth = a1 * m * s / (a2 * m + s)
    flow = [growth - u * m, -growth + u * (sp.Rational(1, 10) - s)]
    return hg.System("bioreactor", states=(m, s), inputs=(u,), outputs=(Y,), parameters=(a1, a2), flow=flow, output=[m])


def lorenz() -> hg.System:
    x1, x2, x3 = x = states((-20, 20), (-30, 30), (0, 50))
    return plant("lorenz", x, [10 * (x2 - x1), x1 * (28 - x3) - x2, x1 * x2 - sp.Rational(8, 3) * x3], x1)


def roessler() -> hg.System:
    x1, x2, x3 = x = states((-20, 20), (-20, 20), (0, 30))
    return plant("roessler", x, [-x2 - x3, x1 + x2 / 5, sp.Rational(1, 5) + x3 * (x1 - sp.Rational(57, 10))], x2)


def hyperjerk() -> hg.System:
    """(22) of Astolfi, Jungers, Zaccarian 2018."""
    x = states(*[(-6, 6)] * 4)
    jerk = -x[3] - sp.Rational(26, 5) * x[2] - sp.Rational(27, 10) * x[1] + sp.Rational(9, 2) * (x[0] ** 2 - 1)
    return plant("hyperjerk", x, [*x[1:], jerk], x[0])


def neuron(rates: Any = ((-1, 1), (-1, 1))) -> hg.System:
    """The neuron with the derivatives of its input declared."""
    system = model("fitzhugh_nagumo")
    u = hg.Signal("u", "", "input", low=-1, high=1, rates=rates)
    parts: dict[str, Any] = {"states": system.states, "outputs": system.outputs, "parameters": system.parameters}
    flow = [f.xreplace({system.inputs[0]: u}) for f in system.flow]
    return hg.System("neuron", inputs=(u,), flow=flow, output=system.output, **parts)


def checks(form: hg.Form) -> dict[str, Check]:
    return {check.id.removeprefix("phase."): check for check in form.checks}


def verdicts(form: hg.Form) -> dict[str, str]:
    return {id: str(check.verdict) for id, check in checks(form).items()}


ALL_PROVED = dict.fromkeys(("chain", "inputs", "rank", "inverse", "lipschitz"), "proved")


# --- the map and its inverse --------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [van_der_pol(), model("pendulum"), hyperjerk()], ids=lambda one: one.name)
def test_a_chain_is_its_own_phase_form(system: hg.System) -> None:
    form = hg.forms.phase(system)
    assert form.kind == "phase"
    assert form.to_form == system.states
    assert [z.interval for z in form.states] == [x.interval for x in system.states]
    assert verdicts(form) == ALL_PROVED


def flowing(form: hg.Form) -> None:
    """Exactly: from_form undoes to_form, and d/dt to_form along the plant, with u' for the inputs, is A z + b."""
    system = form.system
    forward = dict(zip(form.states, form.to_form, strict=True))
    for x, e in zip(system.states, form.from_form, strict=True):
        assert sp.simplify(e.xreplace(forward) - x) == 0
    names = {s.name: s for s in system.inputs}
    for e, rate in zip(form.to_form, form.flow, strict=True):
        moved = sum(e.diff(x) * f for x, f in zip(system.states, system.flow, strict=True))
        moved += sum(e.diff(u) * names[f"{u.name}_dot"] for u in system.inputs if u in e.free_symbols)
        assert sp.simplify(moved - rate.xreplace(forward)) == 0


@pytest.mark.ordinary("roessler")
@pytest.mark.parametrize("system", [roessler(), bioreactor(rates=((-1, 1),))], ids=lambda one: one.name)
def test_the_form_is_the_plant(system: hg.System) -> None:
    form = hg.forms.phase(system)
    assert form.kind == "phase"
    assert verdicts(form) == ALL_PROVED
    flowing(form)


@pytest.mark.full
def test_the_bioreactor_as_its_paper_has_it() -> None:
    """s = a2 x1 (x2 + u x1)/(a1 x1 - x2 - u x1), det = a1 a2 m^2/(a2 m + s)^2; u' enters phi alone."""
    system = bioreactor()
    form = hg.forms.phase(system)
    (z1, z2), (u,), (a1, a2) = form.states, system.inputs, system.parameters
    assert form.from_form[0] == z1
    assert sp.cancel(form.from_form[1] - a2 * z1 * (z2 + u * z1) / (a1 * z1 - z2 - u * z1)) == 0
    assert "a1*a2*m**2/(a2*m + s)**2" in str(checks(form)["rank"].claim)
    assert [s.name for s in form.system.inputs] == ["u", "u_dot"]
    assert verdicts(form) == {**ALL_PROVED, "inputs": "unknown", "lipschitz": "unknown"}
    assert "u_dot (phi alone)" in str(checks(form)["inputs"].reason)
    assert form.behind is not None
    original = hg.forms.phase(system, original=True)
    assert original.system.inputs == system.inputs
    assert original.jacobian is not None


def test_the_neuron_is_refuted_where_its_input_is_zero() -> None:
    form = hg.forms.phase(neuron())
    rank = checks(form)["rank"]
    assert rank.verdict is Verdict.REFUTED
    assert rank.witness["u"] == 0
    assert "-eps*u**2" in str(rank.claim)
    assert form.kind == "phase, original coordinates"
    assert [u.name for u in form.system.inputs] == ["u", "u_dot"]
    assert checks(form)["inverse"].verdict is Verdict.WHERE
    with pytest.raises(Refuted, match=r"phase\.rank"):
        hg.observers.high_gain(form, theta=5, poles=(-1, -1, -1))


def test_lorenz_is_refuted_where_its_output_is_zero() -> None:
    rank = checks(hg.forms.phase(lorenz()))["rank"]
    assert rank.verdict is Verdict.REFUTED
    assert rank.witness == {"x1": 0}


@pytest.mark.parametrize(
    ("slope", "low", "verdict"),
    [
        (lambda x: x**2, 0.5, "proved"),
        (lambda x: x**2, -1, "refuted"),
        (lambda x: x + x**3, -1, "proved"),
        (lambda x: sp.exp(x) + sp.sin(x), -1, "proved"),
        (sp.sqrt, 0.25, "proved"),
        (sp.log, 0.25, "proved"),
        (sp.sqrt, 0, "refuted"),
        (lambda x: sp.Abs(x) + 2 * x, -1, "unknown"),
    ],
)
def test_a_branch_counts_only_where_it_holds(slope: Any, low: float, verdict: str) -> None:
    """x1' = g(x2): one to one where g is monotone on the box; the inverse, if any, is that of the box."""
    x1, x2 = x = states((-1, 1), (low, 2))
    form = hg.forms.phase(plant("branch", x, [slope(x2), -x2], x1))
    assert str(checks(form)["rank"].verdict) == verdict
    if verdict == "proved":
        assert checks(form)["inverse"].verdict is Verdict.PROVED
    if verdict == "proved" and form.kind == "phase":
        value = sp.Rational(5, 4)
        number = form.from_form[1].subs(form.states[1], slope(value))
        assert float(number) == pytest.approx(1.25, rel=1e-12)


def test_the_negative_branch_is_taken_on_a_negative_range() -> None:
    x1, x2 = x = states((-1, 1), (-2, -0.5))
    form = hg.forms.phase(plant("negative", x, [x2**2, -x2], x1))
    assert form.from_form[1] == -sp.sqrt(form.states[1])
    assert verdicts(form) == ALL_PROVED


@pytest.mark.parametrize("value", [0.25, -0.25])
@pytest.mark.parametrize(("low", "high"), [(0.5, 2), (-2, -0.5)])
def test_the_sign_of_a_constant_opens_a_root(value: float, low: float, high: float) -> None:
    """x1' = c x2^2: sqrt(c^2 x2^2) is c x2 or -c x2, which the value of c decides, and that it has no range."""
    x1, x2 = x = states((-1, 1), (low, high))
    c = hg.Signal("c", nominal=value)
    form = hg.forms.phase(plant("scaled", x, [c * x2**2, -x2], x1, parameters=(c,)))
    assert verdicts(form) == ALL_PROVED
    number = form.from_form[1].subs({form.states[1]: value * 1.25**2, c: value})
    assert float(number) == pytest.approx(1.25 if low > 0 else -1.25, rel=1e-12)


HALF = sp.Rational(1, 2)
SLOPES = [
    (lambda x: sp.sqrt(1 - x), "proved"),
    (lambda x: sp.sqrt((1 - x) * (2 - x)), "proved"),
    (lambda x: sp.sqrt(2 - x**2), "proved"),
    (lambda x: (x**2 - 2 * x + 1) ** (HALF / 2), "proved"),
    (lambda x: 2 + sp.sqrt(sp.Abs(x - sp.Rational(3, 10))), "unknown"),
    (lambda x: sp.sqrt(HALF - x), "refuted"),
]


@pytest.mark.parametrize(("slope", "verdict"), SLOPES)
def test_the_rank_is_that_of_whole_roots(slope: Any, verdict: str) -> None:
    """x1' = g(x1) x2: the determinant is g, real and not 0 on the box, or 0 at its end x1 = 1/2."""
    x1, x2 = x = states((-1, 0.5), (-2, 2))
    form = hg.forms.phase(plant("root", x, [x2 * slope(x1), -x1], x1))
    rank = checks(form)["rank"]
    assert f"= {slope(x1).expand()} has" in str(rank.claim)
    assert str(rank.verdict) == verdict


def test_a_pole_of_the_writing_alone_refutes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 written as x1/x1."""
    x1, x2 = x = states((-1, 1), (-1, 1))
    quotient = sp.Mul(x1 + x2, sp.Pow(x1 + x2, -1, evaluate=False), evaluate=False)
    module = importlib.import_module("hgogen.forms.phase")
    monkeypatch.setattr(module, "determinant", lambda rows: Determinant(quotient, ()))
    rank = checks(hg.forms.phase(plant("as_a_quotient", x, [x2, -x1], x1)))["rank"]
    assert rank.verdict is Verdict.UNKNOWN
    assert "as it is written it is 0/0 there" in str(rank.reason)


JUMPS = (sp.sign, sp.floor, sp.ceiling, sp.Heaviside)


@pytest.mark.parametrize("jump", JUMPS)
def test_what_jumps_has_no_phase_form(jump: Any) -> None:
    x1, x2 = x = states((-1, 1), (-1, 1))
    with pytest.raises(NoPhase, match=r"no derivatives to order 2 here: \w+\(x1\) has no derivative somewhere"):
        hg.forms.phase(plant("jump", x, [(2 + jump(x1)) * x2, -x1], x1))


@pytest.mark.parametrize(
    ("flow", "output", "verdict"),
    [
        ("x2", "Piecewise((x1, x1 < 0), (x1 - 1, True))", Verdict.UNKNOWN),
        ("x2", "Piecewise((x1, x1 < 0), (2*x1, True))", Verdict.UNKNOWN),
        ("Piecewise((x2, x2 < 0), (x2 - 1, True))", "x1", Verdict.PROVED),  # y' is what it is, and y'' is not claimed
    ],
)
def test_what_jumps_or_bends_moves_as_no_derivative_says(flow: str, output: str, verdict: Verdict) -> None:
    x = states((-1, 1), (-1, 1))
    names = {"x1": x[0], "x2": x[1]}
    rows = [sp.sympify(text, locals=names) for text in (flow, "-x1", output)]
    assert checks(hg.forms.phase(plant("rough", x, rows[:2], rows[2])))["chain"].verdict is verdict


def test_a_kink_that_cancels_a_choice_refutes_no_rank() -> None:
    """2 max(v, 0) - (v where v >= 0, else -v) = v, whose slope at 0 SymPy has as 2/2 - 1; that of -v^3/3 is 0 there."""
    x1, x2 = x = states((-1, 1), (-1, 1))
    choice = sp.Piecewise((x2, x2 >= 0), (-x2, True))
    for row, verdict in ((2 * sp.Max(x2, 0) - choice, Verdict.UNKNOWN), (-(x2**3) / 3, Verdict.REFUTED)):
        assert checks(hg.forms.phase(plant("kink", x, [row, -x1 - x2], x1)))["rank"].verdict is verdict


def test_nearby_is_not_one_to_one() -> None:
    """A full turn: (cos, sin) has full rank everywhere and meets each value twice."""
    x1, x2 = states((0.1, 7), (0.1, 7))
    form = hg.forms.phase(plant("turn", (x1, x2), [sp.sin(x1) * x2, -x2], x2 * sp.cos(x1)))
    assert checks(form)["inverse"].verdict is not Verdict.PROVED
    assert inverse({hg.Signal("z1"): sp.sin(x1)}, (x1,), ()) is None


def test_a_steep_exponential_is_factored_at_once() -> None:
    """exp(-8750/T), of a reaction, is no power of 8750 to algebra."""
    x, T = sp.symbols("x T", positive=True)
    assert x * (1 + sp.exp(-8750 / T)) in variants(x * sp.exp(-8750 / T) + x)


def test_it_takes_one_output() -> None:
    x1, x2 = x = states((-1, 1), (-1, 1))
    two = hg.System("two", states=x, outputs=(Y, hg.Signal("y2")), flow=[x2, -x1], output=[x1, x2])
    with pytest.raises(NoPhase, match="has 2 outputs, y, y2; the phase form takes one"):
        hg.forms.phase(two)


# --- observers ----------------------------------------------------------------------------------------------

SOME = 300  # samples on which Python, which is slow, is compared with C
DRIVE = {"u": sp.sin(t), "u_dot": sp.cos(t)}
FLOW = {"u": sp.Rational(8, 100) + sp.sin(t) / 100, "u_dot": sp.cos(t) / 100}
CASES: dict[str, tuple[Any, float, float, Mapping[str, float], Mapping[str, float], Mapping[str, Any]]] = {
    # form, theta, duration, start, initial estimate, inputs
    "van_der_pol": (lambda: hg.forms.phase(van_der_pol()), 10, 5, {"x1": 1, "x2": 0}, {"x1": 0, "x2": 2}, {}),
    "hyperjerk": (lambda: hg.forms.phase(hyperjerk()), 10, 5, {"x1": -0.9, "x2": 0, "x3": 0, "x4": 0}, {}, {}),
    "roessler": (lambda: hg.forms.phase(roessler()), 10, 5, {"x1": 1, "x2": 2, "x3": 1}, {"x3": 5}, {}),
    "bioreactor": (lambda: hg.forms.phase(bioreactor()), 4, 20, {"m": 0.075, "s": 0.03}, {"s": 0.1}, FLOW),
    "original": (lambda: hg.forms.phase(bioreactor(), original=True), 4, 20, {"m": 0.075, "s": 0.03}, {"s": 0.1}, FLOW),
    "lorenz": (lambda: hg.forms.phase(lorenz()), 10, 5, {"x1": 1, "x2": 2, "x3": 20}, {"x1": 3, "x3": 25}, {}),
    "neuron": (lambda: hg.forms.phase(neuron()), 5, 15, {"x1": 1.06, "x2": 2.69, "eta": 5}, {}, DRIVE),
}


def stepped(form: hg.Form, theta: float, **rest: Any) -> hg.Step:
    refuted = [check.id for check in form.checks if check.verdict is Verdict.REFUTED]
    observer = hg.observers.high_gain(form, theta=theta, poles=(-1,) * form.n, accept=refuted, **rest)
    return hg.sample(observer, hg.methods.rk4, dt=0.002)


def bit(step: hg.Step, name: str) -> int:
    return 1 << [one.name for one in step.layout.bits].index(name)


@pytest.mark.ordinary("van_der_pol", "original")
@pytest.mark.parametrize("name", CASES)
def test_it_converges_in_c_as_in_python(name: str) -> None:
    """At the end the error is 1e-3 of the first one; C and Python differ by roundings that the observer forgets."""
    build, theta, duration, start, initial, inputs = CASES[name]
    step = stepped(build(), theta, initial=initial)
    system = step.observer.form.system
    signals = {u.name: inputs[u.name] for u in system.inputs}
    truth = simulate(system, Trial(name, duration, start=start, inputs=signals), step.dt)
    in_c = step.run(u=truth.u, y=truth.y, engine="c")
    error = np.abs(in_c.x - truth.x)
    assert error[0].max() > 0
    assert (error[-1] < 1e-3 * error[0].max()).all()
    step.reset()
    some = slice(0, SOME)
    python = step.run(u=truth.u[some], y=truth.y[some], engine="python")
    assert python.x == pytest.approx(in_c.x[some], abs=1e-9)
    assert np.array_equal(python.status, in_c.status[some])


def test_at_a_singular_point_there_is_no_correction() -> None:
    """With x1 = 0 of Lorenz the measured 5 changes nothing, and a bit says so."""
    step = stepped(hg.forms.phase(lorenz()), 10, initial={"x1": 0, "x2": 0, "x3": 20})
    run = step.run(y=np.full(50, 5.0), engine="python")
    assert (run.status & bit(step, "SINGULAR")).all()
    assert not (run.status & bit(step, "RESTARTED")).any()
    assert (run.x[:, :2] == 0).all()
    step = stepped(hg.forms.phase(lorenz()), 10, initial={"x1": 1, "x2": 0, "x3": 20})
    run = step.run(y=np.full(50, 5.0), engine="python")
    assert not (run.status & bit(step, "SINGULAR")).any()
    assert run.x[-1, 0] > 2


@pytest.mark.ordinary("neuron-python", "neuron-c", "bioreactor-python", "lorenz-python")
@pytest.mark.parametrize("engine", ["python", "c"])
@pytest.mark.parametrize("name", ["neuron", "bioreactor", "lorenz"])
def test_nothing_reaches_the_state(name: str, engine: Any) -> None:
    """Zeros, numbers beyond reason and NaN: every estimate stays a number."""
    build, theta, *_ = CASES[name]
    step = stepped(build(), theta)
    rng, count, m = np.random.default_rng(1), 200, len(step.inputs)
    wild = np.array([0.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 1.0, -0.05])
    u, y = rng.choice(wild, (count, m)), rng.choice(wild, (count, 1))
    y[100:] = 0.0
    run = step.run(u=u, y=y, engine=engine) if m else step.run(y=y, engine=engine)
    assert np.isfinite(run.x).all()


def test_an_inverse_at_zero_over_zero_rests() -> None:
    """At z1 = 0, and where a1 z1 - z2 - u z1 = 0, the state rests, or is clamped."""
    form = hg.forms.phase(bioreactor())
    dynamics = stepped(form, 4).observer.dynamics
    z, u = ca.SX.sym("z", 2), ca.SX.sym("u", 2)
    graph = ca.Function("f", [z, u], [*dynamics.recovered(z, u), dynamics.flow(z, u)])
    for place in ([0.0, 0.0], [0.1, 0.092], [0.01, 0.01 * (1 - 0.08)]):
        x, _, rate = (np.array(v)[:, 0] for v in graph(place, [0.08, 0.0]))
        assert np.isfinite(x).all()
        assert np.isfinite(rate).all()


def test_a_root_of_a_product_of_negative_factors_corrects() -> None:
    """x1' = x2 sqrt((1 - x1) (2 - x1)): the estimate moves to what is measured."""
    x1, x2 = x = states((-1, 0.5), (-2, 2))
    root = plant("root", x, [x2 * sp.sqrt((1 - x1) * (2 - x1)), -x1], x1)
    step = stepped(hg.forms.phase(root, original=True), 5, initial={"x1": 0, "x2": 0})
    run = step.run(y=np.full(50, 0.3), engine="python")
    assert run.x[-1, 0] > 0.1


def test_a_determinant_that_is_nowhere_a_number_is_refused() -> None:
    x1, x2 = x = states((-1, 0.5), (-2, 2))
    form = hg.forms.phase(plant("nowhere", x, [x2 * sp.sqrt(x1 - 1), -x1], x1), original=True)
    with pytest.raises(NoDeterminant, match="det dPhi/dx of nowhere is a finite real number at no sample point"):
        largest_determinant(Dynamics(form))
    with pytest.raises(NoDeterminant):
        stepped(form, 5)


def test_the_share_of_the_determinant_is_a_share() -> None:
    form = hg.forms.phase(lorenz())
    with pytest.raises(BadGain, match=r"singular = 2.0 must be a share"):
        hg.observers.high_gain(form, theta=5, poles=(-1, -1, -1), singular=2, accept=("phase.rank",))


def test_the_theorem_knows_the_form() -> None:
    """Structure by construction, the change of coordinates by its checks; no bound is claimed through (dPhi/dx)^-1."""
    observer = hg.observers.high_gain(hg.forms.phase(roessler()), theta=5, poles=(-1, -1, -1))
    by_checks = {row.checks: row.verdict for row in rows(observer.theorem, observer.checks)}
    assert by_checks["phase.chain",] is Verdict.PROVED
    assert by_checks["phase.inputs", "phase.rank", "phase.inverse"] is Verdict.PROVED
    original = hg.observers.high_gain(hg.forms.phase(roessler(), original=True), theta=5, poles=(-1, -1, -1))
    convergence = next(check for check in original.checks if check.id == "high_gain.convergence")
    assert convergence.verdict is Verdict.UNKNOWN


def test_the_header_says_where_a_derivative_comes_from() -> None:
    step = stepped(hg.forms.phase(neuron()), 5)
    text = hg.targets.c99(step)["neuron.h"]
    assert "derivative of u; you supply it, from what sets the signal or from a filter of it" in " ".join(text.split())
    assert "u_dot;" in text
    assert "NEURON_SINGULAR" in text


def test_a_smooth_map_whose_inverse_is_steep_is_not_taken_for_one_of_full_rank() -> None:
    """y = x^2, x' = 1: one to one on [0, 1], where phi = 2 x is Lipschitz in x but 2 sqrt(z) is not in z."""
    x = hg.Signal("x", low=0, high=1)
    checks = {check.id: check.verdict for check in hg.forms.phase(plant("square", (x,), [1], x**2)).checks}
    assert checks["phase.inverse"] is Verdict.PROVED
    assert checks["phase.rank"] is Verdict.REFUTED
    assert checks["phase.lipschitz"] is Verdict.UNKNOWN


def test_full_rank_everywhere_does_not_make_a_map_one_to_one() -> None:
    """Phi = exp(x1) (cos x2, sin x2): the determinant is exp(2 x1), and x2 comes back after 2 pi."""
    x = states((0, 1), (0, 7))
    form = hg.forms.phase(plant("turning", x, [0, -1], sp.exp(x[0]) * sp.cos(x[1])))
    checks = {check.id: check.verdict for check in form.checks}
    assert checks["phase.rank"] is Verdict.PROVED
    assert checks["phase.inverse"] is not Verdict.PROVED


@pytest.mark.parametrize(
    "slope",
    [
        lambda x: sp.sqrt(x),
        lambda x: x ** sp.Rational(4, 3),
        lambda x: sp.sqrt(1 - x**2),
        lambda x: x ** hg.Signal("p", nominal=2, low=1, high=3),
    ],
    ids=["sqrt(x)", "x**(4/3)", "sqrt(1 - x**2)", "x**p"],
)
def test_an_inverse_that_divides_by_a_root_is_one_where_the_root_is_not_zero(slope: Any) -> None:
    """Phi = (x1, g x2): where g(x1) = 0, every x2 has the same image; in Psi(Phi(x)) = g x2/g SymPy cancels g."""

    def verdict(low: float, high: float) -> Verdict:
        x = states((low, high), (-1, 1))
        known = tuple(s for s in slope(x[0]).free_symbols if s not in x)
        form = hg.forms.phase(plant("rooted", x, [slope(x[0]) * x[1], -x[1]], x[0], parameters=known))
        return checks(form)["inverse"].verdict

    assert verdict(0, 1) is not Verdict.PROVED
    assert verdict(0.1, 0.9) is Verdict.PROVED


@pytest.mark.parametrize(("low", "verdict"), [(-1, Verdict.UNKNOWN), (0.5, Verdict.PROVED)])
def test_a_form_says_nothing_of_a_plant_without_a_value(low: float, verdict: Verdict) -> None:
    """(x1 x3)' = x2 by x1' = x2/x3, x3' = 0: at x3 = 0 there is no x1'."""
    x1, x2, x3 = x = states((1, 2), (-1, 1), (low, 1))
    form = hg.forms.phase(plant("hidden_pole", x, [x2 / x3, -x1, 0], x1 * x3))
    assert form.to_form == (x1 * x3, x2, -x1)
    assert {checks(form)[fact].verdict for fact in ("chain", "rank", "inverse")} == {verdict}


def test_a_map_that_is_undefined_on_the_box_has_no_rank_there() -> None:
    """Phi = (x1, x2 + log x1) has the determinant 1, and no value at x1 = 0; with a root in its place, no slope."""
    ranks = []
    for low, function in itertools.product((0, 0.1), (sp.log, sp.sqrt)):
        x = states((low, 1), (-1, 1))
        form = hg.forms.phase(plant("log", x, [x[1] + function(x[0]), 0], x[0]), original=True)
        ranks += [check.verdict for check in form.checks if check.id == "phase.rank"]
    assert ranks == [Verdict.UNKNOWN, Verdict.UNKNOWN, Verdict.PROVED, Verdict.PROVED]


def test_a_derivative_of_an_input_wants_a_range() -> None:
    """y' = x2 + u, so that y'' has u'."""
    verdicts = []
    for rates in ({}, {"rates": ((-1, 1),)}):
        x, u = states((-1, 1), (-1, 1)), hg.Signal("u", low=-1, high=1, **rates)
        form = hg.forms.phase(plant("driven", x, [x[1] + u, -x[0]], x[0], inputs=(u,)))
        verdicts += [check.verdict for check in form.checks if check.id == "phase.inputs"]
    assert verdicts == [Verdict.UNKNOWN, Verdict.PROVED]


def test_near_a_singular_state_there_is_no_correction() -> None:
    """x1' = x2^2/2, y = x1: det dPhi/dx = x2, through which (1, 1) is pulled to (1, 1/x2), or to 0 up to the least."""
    x1, x2, y = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1), hg.Signal("y")
    plant = hg.System("fold", states=(x1, x2), outputs=(y,), flow=[x2**2 / 2, -x2], output=[x1])
    dynamics, z = Dynamics(hg.forms.phase(plant, original=True)), ca.SX.sym("z", 2)
    pulled = ca.Function("pulled", [z], [dynamics.pulled(ca.SX([1, 1]), z, ca.SX(0, 1), 0.05)])
    for value, wanted in ((0.051, 1 / 0.051), (-0.2, -5), (1, 1)):
        assert np.array(pulled([0, value]))[:, 0] == pytest.approx([1, wanted])
    for value in (0, 0.01, -0.049):
        assert np.array(pulled([0, value]))[:, 0].tolist() == [0, 0]
