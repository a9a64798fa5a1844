"""The lambda-tracking observer: the bioreactor's known answers, the error without a model, and bad input."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import swing
import sympy as sp
from forger import sealed
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import lambda_tracking as oracle
from plants import MODELS, model
from scipy.signal import lsim

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.integrators import companion
from hgogen.model import load
from hgogen.program import Place
from hgogen.prove.semidefinite import lyapunov
from hgogen.reading.given import BadGain
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import NotHurwitz
from hgogen.theorem import rows
from hgogen.trial import Truth, simulate, try_out

FINAL = 0.550380472  # k, without noise


@cache
def reactor() -> hg.Form:
    return hg.forms.phase(model("bioreactor"))


def tuned(**changes: Any) -> hg.Observer:
    table = load(MODELS / "bioreactor.py").module.tuning["lambda_tracking"]
    gains = {key: value for key, value in table.items() if key not in ("form", "method", "dt")}
    return hg.observers.lambda_tracking(reactor(), **{**gains, **changes})


@cache
def truth(dt: float) -> Truth:
    return simulate(model("bioreactor"), load(MODELS / "bioreactor.py").trials()[0], dt)


def run(dt: float, **changes: Any) -> hg.Run:
    return hg.sample(tuned(**changes), hg.methods.rk4, dt=dt).run(u=truth(dt).u, y=truth(dt).y)


# --- the transform ------------------------------------------------------------------------------------------


def test_the_derivative_of_the_inflow_is_not_asked_for() -> None:
    assert [signal.name for signal in reactor().system.inputs] == ["u", "u_dot"]
    step = hg.sample(tuned(), hg.methods.rk4, dt=0.01)
    assert [signal.name for signal in step.inputs] == ["u"]
    assert "lambda_tracking.lipschitz" not in {check.id for check in step.observer.checks}


def test_at_the_start_the_inverse_is_taken_at_the_edge_of_the_ranges() -> None:
    """xhat = (0, 0), where it is 0/0, is below the range of m: s of (.01, 0) is .00087, below its own."""
    step = hg.sample(tuned(), hg.methods.rk4, dt=0.01)
    first = step(u=0.08, y=0.075)
    assert (first["m"], first["s"], first.flags) == (0.01, 0.001, ("OUTSIDE_BOX",))
    for _ in range(400):
        last = step(u=0.08, y=0.09)
    assert last.flags == ()
    assert 0.001 < last["s"] < 0.15


def test_at_a_pole_of_the_inverse_the_substrate_is_at_its_highest() -> None:
    """In binary fractions, x2 = (a1 - u) x1 exactly: the denominator is 0, what is measured stays as it is."""
    step = hg.sample(tuned(), hg.methods.rk4, dt=0.01)
    step._kept.places[Place("state", "w")][:] = 1 / 16, 1 / 16 - 1 / 256
    sample = step(u=1 / 16, y=1 / 16)
    assert (sample["m"], sample["s"]) == (1 / 16, 0.15)
    assert sample.flags == ("OUTSIDE_BOX",)


# --- known answers ------------------------------------------------------------------------------------------


@cache
def exact() -> tuple[np.ndarray, np.ndarray]:
    return oracle.exact((0.0, 0.0))


def test_the_final_gain_of_the_oracle() -> None:
    assert exact()[1][-1, 4] == pytest.approx(FINAL, abs=5e-10)


def test_the_final_gain_of_the_step() -> None:
    """The line between samples errs by order dt^2: two step lengths give the limit, to dt^4 = 6e-10."""
    coarse, fine = (run(dt).traces["k"][-1] for dt in (0.01, 0.005))
    assert coarse == pytest.approx(FINAL, abs=1e-6)
    assert fine + (fine - coarse) / 3 == pytest.approx(FINAL, abs=2e-9)


def test_the_estimates_are_the_oracles() -> None:
    """Along the way, to the order dt^2 of the line between samples."""
    result, (t, states) = run(0.005), exact()
    at = np.searchsorted(t, result.t - 1e-6)
    assert np.abs(result.traces["k"] - states[at, 4]).max() < 1e-6
    inside = result.t > 4  # where xhat_1 is within the declared range of m
    assert np.abs(result["m"] - states[at, 2])[inside].max() < 1e-6


def test_when_the_strip_is_entered() -> None:
    """At 3.23471 h, and never left; by a line between two steps of .001 h."""
    t, states = exact()
    e = np.abs(states[:, 0] - states[:, 2])
    last = int(np.flatnonzero(e > oracle.STRIP)[-1])
    entered = t[last] + (e[last] - oracle.STRIP) / (e[last] - e[last + 1]) * (t[last + 1] - t[last])
    assert entered == pytest.approx(3.23471, abs=1e-5)
    k = run(0.005).traces["k"]
    assert (k[:640] < k[-1]).all()
    assert (k[650:] == k[-1]).all()


@pytest.mark.full
@pytest.mark.parametrize("first", [0.0341, 0.1429])
def test_the_papers_gain_takes_another_start(first: float) -> None:
    assert oracle.exact((first, 0.0))[1][-1, 4] == pytest.approx(0.275, abs=2e-4)
    assert run(0.01, start=(first, 0)).traces["k"][-1] == pytest.approx(0.275, abs=2e-4)


@pytest.mark.full
def test_the_final_gain_with_noise() -> None:
    """Standard deviation .005 a sample of .01 h, 40 seeds: .557 with each value held; on lines between samples the
    noise has two thirds of the power, and the gain ends a little lower. Of 40 seeds the mean errs by .0005."""
    held = oracle.noisy(0.005 * np.random.default_rng(0).standard_normal((40, 10_000)))
    assert held.mean() == pytest.approx(0.557, abs=0.0015)
    assert held.std() == pytest.approx(0.003, abs=0.001)
    step = hg.sample(tuned(), hg.methods.rk4, dt=0.01)
    trial = replace(load(MODELS / "bioreactor.py").trials()[0], estimate={})  # from the paper's start, the tuning's own
    line = np.array([one.traces["k"][-1] for one in try_out(step, trial, seeds=range(40))])
    assert line.mean() == pytest.approx(0.554, abs=0.0015)
    assert line.std() == pytest.approx(0.003, abs=0.001)


# --- theorem ------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_a_phi_that_grows_again_and_again_keeps_the_gain_moving() -> None:
    """An oscillator in its ranges, driven half a minute of every two, without fault or noise: the gain falls in each
    calm, and the error is far in each drive. The theorem names that among what it rests on."""
    x, v = (hg.Signal(name, low=-1.5, high=1.5) for name in ("x", "v"))
    force = hg.Signal("force", low=-1.2, high=1.2)
    plant = hg.System(
        "driven", states=[x, v], inputs=[force], outputs=[hg.Signal("y")], flow=[v, force - x - v], output=[x]
    )
    gains = {"k_0": 1, "k_max": 20, "gamma": 10, "strip": 0.1, "reach": 0.2, "poles": (-1, -1)}
    observer = hg.observers.lambda_tracking(hg.forms.phase(plant), **gains)
    dt = 2e-3
    t = np.arange(0, 720, dt)
    u = np.where((t % 120 >= 30) & (t % 120 < 60), 1.2 * np.sin(t), 0)
    _, _, states = lsim(([[0.0, 1], [-1, -1]], [[0.0], [1]], [[1.0, 0]], [[0.0]]), u, t)
    assert 1 < np.abs(states).max() < 1.5
    run = hg.sample(observer, hg.methods.rk4, dt=dt).run(u=u, y=states[:, 0])
    assert not run.status.any()
    falls = t[1:][np.diff(np.asarray(run.traces["k"]).ravel()) < -0.1]
    last = np.abs(run.x[t > 600, 0] - states[t > 600, 0])
    assert (falls < 240).any()
    assert (falls > 600).any()
    assert last.max() > gains["reach"]
    (row,) = (row for row in rows(observer.theorem, observer.checks) if "no more than finitely often" in row.claim)
    assert row.verdict is None


def test_a_gain_that_wild_samples_from_the_start_raised_falls_again() -> None:
    """x'' = -x without a model: errors that change their sign TURNS times are of no estimate on its way."""
    x, v = (hg.Signal(name, low=-1, high=1) for name in ("x", "v"))
    plant = hg.System("swinging", states=[x, v], outputs=[hg.Signal("y")], flow=[v, -x], output=[x])
    gains = {"k_0": 4, "k_max": 64, "gamma": 5000, "strip": 0.1, "reach": 0.6, "poles": (-1, -1)}
    observer, dt = hg.observers.lambda_tracking(hg.forms.phase(plant), **gains), 2e-3
    t = np.arange(0, 20, dt)
    y, first = np.cos(t), t < 0.5
    y[first] = np.random.default_rng().uniform(-1, 1, int(first.sum()))
    run = hg.sample(observer, hg.methods.rk4, dt=dt).run(u=np.zeros((t.size, 0)), y=y)
    k = np.asarray(run.traces["k"]).ravel()
    assert k[first].max() > 16
    assert k[-1] < 8
    assert np.abs(run.x[t > 15, 0] - np.cos(t[t > 15])).max() < gains["strip"]


def test_an_error_within_a_wide_strip_is_no_fault() -> None:
    """x'' = -x without a model, in a strip of more than a tenth of what y spans, without fault or noise: the error at
    the first gain that settles is 1/(1 + k^2), between a fifth and the strip. By the theorem the gain never falls."""
    x, v = (hg.Signal(name, low=-1, high=1) for name in ("x", "v"))
    plant = hg.System("swinging", states=[x, v], outputs=[hg.Signal("y")], flow=[v, -x], output=[x])
    gains = {"k_0": 0.5, "k_max": 20, "gamma": 500, "strip": 0.3, "reach": 0.6, "poles": (-1, -1)}
    observer = hg.observers.lambda_tracking(hg.forms.phase(plant), **gains, initial={"x": -1, "v": 1})
    t = np.arange(0, 60, 2e-3)
    run = hg.sample(observer, hg.methods.rk4, dt=2e-3).run(u=np.zeros((t.size, 0)), y=np.cos(t))
    assert (np.diff(np.asarray(run.traces["k"]).ravel()) >= 0).all()
    assert np.abs(run.x[t > 30, 0] - np.cos(t[t > 30])).max() < gains["strip"]


def test_the_bound_of_phi_is_that_of_the_chain_of_integrators() -> None:
    """x1' = 100 x2, x2' = u: y'' = 100 u, and a constant u leaves an error of 100 (1, 2 k)/k^2. The corrected bound of
    theorem 3 with the mu that is said holds for it."""
    x1, x2, u = hg.Signal("x1", low=-5, high=5), hg.Signal("x2", low=-1, high=1), hg.Signal("u", low=-1, high=1)
    plant = hg.System("long", states=[x1, x2], inputs=[u], outputs=[hg.Signal("y")], flow=[100 * x2, u], output=[x1])
    gains: dict[str, Any] = {"k_0": 10, "k_max": 99, "gamma": 1, "strip": 5, "reach": 6, "poles": (-1, -1)}
    made = hg.observers.lambda_tracking(hg.forms.triangular(plant), **gains)
    (check,) = (check for check in made.checks if check.id == "lambda_tracking.phi")
    mu, k = check.reason.part("mu").value, 10
    assert mu == 100
    solution = lyapunov(tuple(map(tuple, companion(np.array([sp.Rational(2), sp.Rational(1)])))))
    assert solution is not None
    bound = (
        2 * mu * float(solution.peak) * np.sqrt(np.linalg.cond(np.array(solution.P, dtype=float))) / np.array([k**2, k])
    )
    assert (np.array([100 / k**2, 200 / k]) < bound).all()


def test_the_factor_that_theorem_3_misses() -> None:
    """sqrt(cond P) = 3.18 for p = (1, .2)."""
    solution = lyapunov(tuple(map(tuple, companion(np.array([sp.Rational(1), sp.Rational(1, 5)])))))
    assert solution is not None
    assert np.sqrt(np.linalg.cond(np.array(solution.P, dtype=float))) == pytest.approx(3.18, abs=0.005)


def test_a_stepping_inflow_leaves_phi_without_a_bound() -> None:
    by_claim = {row.claim: row for row in rows(tuned().theorem, tuned().checks)}
    row = by_claim["phi is bounded along the plant's motion"]
    assert row.verdict is Verdict.UNKNOWN
    assert "u_dot" in next(str(check.reason) for check in tuned().checks if check.id == "lambda_tracking.phi")
    assert "does not tend to 0" in tuned().theorem.conclusion


def tracking(**changes: Any) -> hg.Observer:
    gains: dict[str, Any] = {"k_0": 20, "k_max": 400, "gamma": 1, "strip": 5, "reach": 6, "poles": (-1, -2)}
    return hg.observers.lambda_tracking(swing.form(), **{**gains, **changes})


def test_tuning_keeps_strip_below_reach() -> None:
    """Else the gain would never grow."""
    step = hg.sample(tracking(), hg.methods.rk4, dt=swing.DT)
    assert step.flags(step.tune(strip=5.4)) == ()
    assert step.flags(step.tune(strip=6.0)) == ("PARAMETER_LIMITED",)
    assert step.flags(step.tune(strip=5.0, reach=4.0)) == ("PARAMETER_LIMITED",)
    ranges = {field.name: field.box[0] for field in step.layout.gains}
    assert ranges["strip"][1] < ranges["reach"][0]


def test_the_linear_core_has_the_poles_at_the_cap() -> None:
    gains: dict[str, Any] = {"k_0": 20, "k_max": 400, "gamma": 1, "strip": 5, "reach": 6, "poles": (-1, -2)}
    assert swing.core_poles(hg.observers.lambda_tracking, **gains) == pytest.approx([-800, -400], rel=1e-12)


def test_without_a_model_the_error_is_of_order_1_over_k() -> None:
    """Twice the gain, half the error of w and a quarter of that of q; never 0; below theorem 3's bound, corrected."""
    late = slice(1000, None)
    errors = {k: swing.error(tracking(k_0=k))[late].max(axis=0) for k in (20, 40, 80)}
    for k in (20, 40):
        assert errors[k] / errors[2 * k] == pytest.approx([4, 2], rel=0.15)
    solution = lyapunov(tuple(map(tuple, companion(np.array([sp.Rational(3), sp.Rational(2)])))))
    assert solution is not None
    check = next(check for check in tracking().checks if check.id == "lambda_tracking.phi")
    assert check.verdict is Verdict.PROVED
    mu = float(str(check.reason.part("mu")))
    factor = 2 * mu * float(solution.peak) * np.sqrt(np.linalg.cond(np.array(solution.P, dtype=float)))
    assert (errors[40] < factor / np.array([40**2, 40])).all()


@given(st.floats(-4, 4), st.floats(-20, 20))
@settings(deadline=None, max_examples=15)
def test_with_a_model_it_converges_from_any_initial_state(q: float, w: float) -> None:
    """Once k is large enough for phi's slope; up to what the line between samples takes from y."""
    assert swing.last_error(modelled, q, w) < 1e-4


def modelled() -> hg.Observer:
    return tracking(model=True, k_0=25)


def test_the_gain_grows_outside_the_strip_only_and_a_missing_sample_leaves_it() -> None:
    observer = tracking(k_0=5, gamma=100, strip=1e-4, reach=1, model=True)
    y = swing.gappy()
    step = hg.sample(observer, hg.methods.rk4, dt=swing.DT)
    run = step.run(u=swing.truth().u[: len(y)], y=y, engine="python")
    k = run.traces["k"]
    assert (np.diff(k) >= 0).all()
    assert k[-1] > 5
    missing = np.flatnonzero(np.isnan(y))
    assert (k[missing] == k[missing - 1]).all()


def test_the_gain_grows_no_faster_beyond_its_reach() -> None:
    """While |e| > reach, k' = gamma (reach - strip)^2."""
    observer = tracking(k_0=5, gamma=100, strip=0.01, reach=0.02, model=True)
    k = swing.run(observer, swing.truth().y[:50], engine="python").traces["k"]
    assert np.diff(k) == pytest.approx(np.full(49, 100 * 0.01**2 * swing.DT), rel=1e-6)


def test_a_gain_at_its_cap_is_said() -> None:
    step = hg.sample(tracking(k_0=5, k_max=6, gamma=1e4, strip=1e-3, reach=1), hg.methods.rk4, dt=swing.DT)
    run = step.run(u=swing.truth().u, y=swing.truth().y)
    assert run.traces["k"][-1] == 6
    assert "GAIN_LIMITED" in step.flags(run.status[-1])


# --- bad input ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"k_0": 0}, "k_0 = 0 must be a positive finite number"),
        ({"k_max": 20}, "k_max = 20 must be above k_0 = 20; the gain only grows"),
        ({"gamma": -1}, "gamma = -1 must be a positive"),
        ({"strip": 0}, "strip = 0 must be a positive"),
        ({"reach": 5}, "reach = 5 must be above strip = 5"),
        ({"gains": (1, 1)}, "lambda_tracking takes either the poles of A - K C or the gains K"),
        ({"start": (0,)}, r"start of shape \(1,\) must have 2 numbers: the output and its derivatives"),
        ({"start": (1e9, 0)}, r"start q = 1e\+09 must be finite and in its outer box"),
        ({"start": (float("nan"), 0)}, "start q = nan must be finite"),
        ({"initial": {"q": 9}}, r"initial q = 9\.0 must be finite and in"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        tracking(**changes)


def test_gains_that_do_not_decay() -> None:
    with pytest.raises(NotHurwitz):
        tracking(poles=None, gains=(1, -1))


def test_a_triangular_form_with_more_than_phi_wants_its_model() -> None:
    x1, x2, y = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2), hg.Signal("y")
    plant = hg.System("more", states=(x1, x2), outputs=(y,), flow=[x2 - sp.sin(x1), -x2], output=[x1])
    form = hg.forms.triangular(plant)
    gains: dict[str, Any] = {"k_0": 1, "k_max": 9, "gamma": 1, "strip": 0.1, "reach": 1, "poles": (-1, -1)}
    with pytest.raises(BadGain, match=r"takes a form with b in its last row only .* take the form phase, or model="):
        hg.observers.lambda_tracking(form, **gains)
    assert hg.observers.lambda_tracking(form, model=True, **gains).name == "lambda_tracking"


@pytest.mark.parametrize("low", [-1, 0.5])
@pytest.mark.parametrize("place", ["rate", "gain", "output"])
def test_phi_is_not_proved_bounded_of_a_plant_without_a_value(place: str, low: float) -> None:
    """(u x + u)/u - 1 is x in a form, and has no value at u = 0: the theorem asks for no Lipschitz constant."""
    x1, x2, y = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2), hg.Signal("y")
    u = hg.Signal("u", low=low, high=1)
    seen = {x: (u * x + u) / u - 1 for x in (x1, x2)}
    flow = [seen[x2] if place == "gain" else x2, -x1 - (seen[x2] if place == "rate" else x2)]
    output = [seen[x1] if place == "output" else x1]
    plant = hg.System("plant", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=output)
    form = (hg.forms.phase if place == "rate" else hg.forms.triangular)(plant)
    gains: dict[str, Any] = {"k_0": 1, "k_max": 9, "gamma": 1, "strip": 0.1, "reach": 1, "poles": (-1, -1)}
    row = {"rate": "x2", "gain": "x1", "output": "y"}[place]
    made = hg.observers.lambda_tracking(form, accept=[f"singular.{row}"] if low < 0 else [], **gains)
    (verdict,) = (check.verdict for check in made.checks if check.id == "lambda_tracking.phi")
    assert (verdict is Verdict.PROVED) is (low > 0)


def test_with_a_model_the_last_row_of_a_certificates_form_is_examined() -> None:
    """An observer without one reads no b, which its file then has as 0: that is said, and is no fault of the form."""
    for modelled in (False, True):
        observer = tracking(model=modelled)
        content = hg.certificate(observer.form, observer.checks, observer.name)
        known = recheck(sealed(content))
        assert "form" not in {row.id for row in known.failed}
        assert any("has no model of it" in said for said in known.unexamined) is not modelled
        content["form"]["b"][-1] += " + 1"
        assert "form" in {row.id for row in recheck(sealed(content)).failed}
