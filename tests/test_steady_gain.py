"""The gain to which a Riccati filter settles: SciPy's equation, the filter itself, its proofs, what is refused."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import fitzhugh_nagumo, two_outputs
from scipy.linalg import solve_continuous_are
from test_high_gain import blocks
from test_whole_gain import C, pair

import hgogen as hg
from hgogen.check import Verdict
from hgogen.prove.steady_filter import steady_gain
from hgogen.reading.given import BadGain, BadNames, Misfit
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import NotHurwitz

ORIGIN = {f"x{i}": 0.0 for i in range(1, 6)}


def damped() -> hg.System:
    """x1' = x2, x2' = -sin x1 - x2 + u."""
    x1, x2 = (hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2))
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    return hg.System("damped", states=(x1, x2), inputs=(u,), outputs=(y,), flow=[x2, -sp.sin(x1) - x2 + u], output=[x1])


# --- the equation -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("theta", [0.7, 1.0, 6.0])
def test_it_is_that_of_q_theta_and_r_theta(theta: float) -> None:
    """K_theta = P C' R_theta^-1 of SciPy's P, without any scaled coordinates."""
    form, x1 = hg.forms.triangular(damped()), 0.5
    Q, R = np.array([[0.1, 0.05], [0.05, 2]]), 0.02
    K = np.array(steady_gain(form, Q, R, theta, at={"x1": x1, "x2": 0}, u={"u": 0.2}))
    F, spread = np.array([[0, 1], [-np.cos(x1), -1]]), np.diag([1, theta])
    P = solve_continuous_are(F.T, [[1], [0]], theta * spread @ Q @ spread, [[R / theta]])
    assert K * [theta, theta**2] == pytest.approx(P[:, 0] / (R / theta), rel=1e-9)


@pytest.mark.parametrize("align", ["top", "end"])
def test_of_several_outputs_at_either_alignment(align: str) -> None:
    """Delta and delta R delta of the thesis, chapter 5; theta^(p(i) - p(k) + 1) K_ik is P C' R_theta^-1."""
    form, theta, at = blocks(align), 3.0, {**ORIGIN, "x2": 0.5, "x5": -1.0}
    Q, R = np.array([1, 2, 0.5, 3, 1]), np.array([0.1, 0.4])
    K = np.array(steady_gain(form, Q, R, theta, at=at, u={"u": 0}))
    F = np.array(
        sp.Matrix(form.flow).jacobian(form.states).subs(dict(zip(form.states, at.values(), strict=True))), dtype=float
    )
    power = {"top": [0, 1, 2, 0, 1], "end": [0, 1, 2, 1, 2]}[align]
    delta = {"top": [1, 1], "end": [1, theta]}[align]
    spread = theta ** np.array(power)
    R_theta = R * np.square(delta) / theta
    P = solve_continuous_are(F.T, C.T, theta * np.outer(spread, spread) * np.diag(Q), np.diag(R_theta))
    own = np.array(power)[:, None] - np.array(power)[[0, 3]][None, :] + 1.0
    assert K.shape == (5, 2)
    assert K * theta**own == pytest.approx(P @ C.T / R_theta, rel=1e-8, abs=1e-10)


def test_the_filter_settles_to_it() -> None:
    """`riccati` around a plant at rest, and `high_gain` with its gain, are one observer once P has settled."""
    form, theta, dt, t = hg.forms.block_triangular(two_outputs()), 2.0, 1e-3, np.arange(12000) * 1e-3
    noise = {"Q": (1.0, 2.0, 1.0), "R": (0.1, 0.2), "theta": theta}
    K = steady_gain(form, **noise, at={"x1": 0, "x2": 0, "x3": 0}, u={"u": 0})
    observers = hg.observers.riccati(form, **noise), hg.observers.high_gain(form, theta=theta, gains=K)
    methods = hg.methods.rk4_covariance, hg.methods.rk4
    y = np.column_stack([1e-3 * np.sin(t), 1e-3 * np.cos(2 * t)])  # small: F hardly moves
    x = [
        hg.sample(one, method, dt=dt).run(u=0 * t, y=y).x[6000:] for one, method in zip(observers, methods, strict=True)
    ]
    assert np.abs(x[0]).max(axis=0).min() > 2e-4
    assert x[1] == pytest.approx(x[0], abs=1e-8)


def test_names_are_those_of_riccati() -> None:
    form, at = hg.forms.triangular(damped()), {"x1": 0, "x2": 1}
    named = steady_gain(form, {"x2": 2.0, "x1": 0.1}, {"y": 0.02}, 4, at=at, u={"u": 0})
    assert named == steady_gain(form, (0.1, 2.0), 0.02, 4, at={"x2": 1, "x1": 0}, u={"u": 0})


def test_a_point_is_of_the_plant_as_declared() -> None:
    """Of a plant in other states the point is that of the first ones."""
    plant, b = damped(), hg.Signal("b", low=-1, high=1)
    x2 = plant.states[1]
    moved = hg.forms.triangular(hg.recast(plant, {b: x2 / 2}, {x2: 2 * b}))
    K = steady_gain(moved, (0.1, 0.5), 0.02, 4, at={"x1": 0.3, "x2": 1}, u={"u": 0})
    own = steady_gain(hg.forms.triangular(plant), (0.1, 2.0), 0.02, 4, at={"x1": 0.3, "x2": 1}, u={"u": 0})
    assert np.multiply(K, [1, 2]) == pytest.approx(own, rel=1e-9)
    with pytest.raises(BadNames, match="at names 'b'"):
        steady_gain(moved, (0.1, 2.0), 0.02, 4, at={"x1": 0.3, "b": 1}, u={"u": 0})


# --- as a constant gain -------------------------------------------------------------------------------------


@pytest.mark.full
def test_it_is_proved_as_it_runs_and_verified() -> None:
    """With an a that moves by an input and a parameter, of two outputs."""
    form, theta = hg.forms.block_triangular(pair()), 4.0
    K = steady_gain(form, (1, 1, 1), (0.2, 0.3), theta, at={"x1": 0, "x2": 0, "x3": 0}, u={"u": 0.1})
    observer = hg.observers.high_gain(form, theta=theta, gains=K)
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
    checks = (*observer.checks, *hg.contraction(step).checks)
    report = recheck(sealed(hg.certificate(form, checks, "high_gain")))
    rows = {row.id: row.found for row in report.rows}
    assert rows["high_gain.step"] == rows["high_gain.tuned"] == rows["high_gain.theta"] == "verified"


def test_the_filter_stays_unknown_and_names_it() -> None:
    observer = hg.observers.riccati(hg.forms.triangular(damped()), Q=(0.1, 1), R=0.1, theta=4)
    (check,) = (check for check in observer.checks if check.id == "riccati.convergence")
    assert check.verdict is Verdict.UNKNOWN
    assert str(check.reason).endswith("can be proved as it runs, by hg.design.steady_gain")
    assert "high_gain with the gain to which it settles" in check.fix


@pytest.mark.parametrize("form", [hg.forms.original, hg.forms.uniform, hg.forms.state_affine])
def test_the_filter_names_no_gain_that_is_refused(form: Any) -> None:
    made = form(damped())
    observer = hg.observers.riccati(made, Q=(0.1, 1), R=0.1)
    (check,) = (check for check in observer.checks if check.id == "riccati.convergence")
    assert "steady_gain" not in str(check.reason)
    assert check.fix == "validate by trials over noise seeds and jumps"
    with pytest.raises(BadGain, match="steady_gain"):
        steady_gain(made, (0.1, 1), 0.1, at={"x1": 0, "x2": 0}, u={"u": 0})


# --- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"at": {"x1": 0}}, BadNames, "at has no value for x2; give one for each of x1, x2"),
        ({"at": {"x1": 0, "x2": 3}}, BadGain, r"at x2 = 3 must be finite and in \[-2, 2\]"),
        ({"at": {"x1": float("nan"), "x2": 0}}, BadGain, "at x1 = nan must be finite"),
        ({"at": (0, 0)}, BadNames, "is no mapping from names to numbers; give {'x1': 0, 'x2': 0}"),
        ({"u": None}, BadNames, "u has no value for u"),
        ({"u": {"u": 5}}, BadGain, r"u u = 5 must be finite and in \[-1, 1\]"),
        (
            {"Q": (0, 1)},
            BadGain,
            "Q must be positive definite",
        ),
        ({"R": -1}, BadGain, "R = -1 must be positive"),
        ({"theta": 0}, BadGain, "theta = 0 must be"),
        ({"form": damped()}, Misfit, "steady_gain was given"),
        ({"form": hg.forms.phase(damped(), original=True)}, BadGain, "take a form in chains"),
    ],
)
def test_what_is_refused(changes: dict[str, Any], error: type, said: str) -> None:
    asked = {"Q": (0.1, 1), "R": 0.1, "theta": 3, "at": {"x1": 0, "x2": 0}, "u": {"u": 0}, **changes}
    with pytest.raises(error, match=said):
        steady_gain(asked.pop("form", hg.forms.triangular(damped())), **asked)


def test_a_point_that_hides_a_state() -> None:
    """a_2 = -u: at u = 0 the outputs show x1 alone."""
    form = fitzhugh_nagumo().form
    at = {s.name: 0.0 for s in form.system.declared.states}
    with pytest.raises(BadGain, match=r"the point .*u = 0 shows not every state: .* take one, or an input, at which"):
        steady_gain(form, (1, 1, 1), 0.1, at=at, u={"u": 0})
    assert len(steady_gain(form, (1, 1, 1), 0.1, 20.0, at=at, u={"u": -1})) == 3


def test_a_state_that_is_hidden_and_decays_is_not_shown() -> None:
    """Its equation has a solution all the same."""
    x1, x2 = (hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2))
    data = {"states": (x1, x2), "inputs": (hg.Signal("u", low=-1, high=1),), "outputs": (hg.Signal("y"),)}
    form = hg.forms.triangular(hg.System("hidden", **data, flow=[data["inputs"][0] * x2, -x2], output=[x1]))
    with pytest.raises(BadGain, match="shows not every state"):
        steady_gain(form, (1, 1), 0.1, at={"x1": 0, "x2": 0}, u={"u": 0})


def test_a_gain_that_leans_on_b_names_a_theta_that_does() -> None:
    """A small Q of x2 leaves K_2 below 0, which -sin x1 - x2 makes good, at the point alone."""
    form, asked = hg.forms.triangular(damped()), {"Q": (10, 0.1), "R": 1.0, "at": {"x1": 0, "x2": 0}, "u": {"u": 0}}
    with pytest.raises(NotHurwitz, match=r"the steady gains at theta = 1: .* theta = .* would do") as raised:
        steady_gain(form, **asked)
    enough = float(str(raised.value).split("theta = ")[-1].split(" ")[0])
    hg.observers.high_gain(form, theta=enough, gains=steady_gain(form, **asked, theta=enough))
