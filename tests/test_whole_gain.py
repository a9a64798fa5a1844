"""A gain of several chains as a full matrix, each of whose rows acts on every output: its step, its proofs, forged."""

import copy
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from oracle.sampled import run
from test_high_gain import blocks, model

import hgogen as hg
from hgogen.analysis.scaling import exponents
from hgogen.estimators.core import core_numbers, nominal
from hgogen.modelfiles.tuning import Tuning
from hgogen.program import Place
from hgogen.prove.convergence import Flow
from hgogen.prove.error_models import with_gains
from hgogen.prove.inclusion import Inclusion
from hgogen.reading.given import BadGain
from hgogen.recheck.file import NoCertificate
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import NotHurwitz
from hgogen.run import native

Content = dict[str, Any]

OWN = ((3.0, 2.5, 0.5), (1.5, 0.5))
WHOLE = np.array([[3, 0.4], [2.5, -0.3], [0.5, 0.2], [0.5, 1.5], [-0.2, 0.5]])
C = np.array([[1.0, 0, 0, 0, 0], [0, 0, 0, 2, 0]])
A = np.array([[0.0, 1, 0, 0, 0], [0, 0, 2, 0, 0], [0] * 5, [0, 0, 0, 0, 1], [0] * 5])
POWERS = {"top": [[1, 1], [2, 2], [3, 3], [1, 1], [2, 2]], "end": [[1, 0], [2, 1], [3, 2], [2, 1], [3, 2]]}


def pair(**changes: Any) -> hg.System:
    """x1' = a x2 + x3/4, x2' = -sin x1, x3' = -(2 + u) x3 + x1/5: an a that moves by a parameter, two outputs."""
    x1, x2, x3 = (hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2, 3))
    u, a = hg.Signal("u", low=-0.3, high=0.3), hg.Signal("a", "", "", 2, low=1.8, high=2.2)
    flow = [a * (1 + u) * x2 + x3 / 4, -sp.sin(x1), -2 * x3 + x1 / 5 + u]
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    data = {"states": (x1, x2, x3), "inputs": (u,), "parameters": (a,), "outputs": outputs, **changes}
    return hg.System("pair", **data, flow=flow, output=[x1, (1 + u / 2) * x3])


PAIR = np.array([[2, 0.5], [1, 0.2], [-0.3, 1.5]])


@cache
def observer_of_pair(theta: float = 4.0) -> hg.Observer:
    return hg.observers.high_gain(hg.forms.block_triangular(pair()), theta=theta, gains=PAIR)


@cache
def certified() -> Content:
    step = hg.sample(observer_of_pair(), hg.methods.heun, dt=1e-3)
    gain, start = hg.noise_gain(step), hg.start_set(step)
    assert isinstance(gain, hg.NoiseGain)
    assert isinstance(start, hg.StartSet)
    checks = (*step.observer.checks, *hg.contraction(step).checks, gain.check, start.check)
    return hg.certificate(step.observer.form, checks, "high_gain")


def findings(content: Content) -> dict[str, str]:
    return {row.id.split(".")[1]: row.found for row in recheck(sealed(content)).rows if row.id.startswith("high_gain")}


def block_columns() -> np.ndarray:
    matrix = np.zeros((5, 2))
    matrix[:3, 0], matrix[3:, 1] = OWN
    return matrix


# --- the step -----------------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("align", ["top", "end"])
def test_block_columns_are_the_gain_chain_by_chain(align: str) -> None:
    each = [hg.observers.high_gain(blocks(align), theta=8, gains=gains) for gains in (OWN, block_columns())]
    rng = np.random.default_rng(1)
    y, u = rng.normal(size=(200, 2)), rng.uniform(-1, 1, 200)
    assert np.array_equal(*(hg.sample(one, dt=1e-3).run(u=u, y=y, engine="python").x for one in each))
    least = [Flow(one.error, Fraction(8)).least for one in each]
    assert least[0].theta == least[1].theta


@pytest.mark.parametrize("align", ["top", "end"])
def test_the_core_is_that_of_the_scaled_matrix(align: str) -> None:
    theta = 3.0
    observer = hg.observers.high_gain(blocks(align), theta=theta, gains=WHOLE)
    K = WHOLE * theta ** np.array(POWERS[align], dtype=float)
    assert core_numbers(observer.parts[0], 2, nominal(observer)) == pytest.approx(A - K @ C, rel=1e-12)
    step = hg.sample(observer, dt=1e-3)
    step.tune()
    assert step._kept.places[Place("derived", "K")] == pytest.approx(K.ravel(), rel=1e-12)


@pytest.mark.parametrize("align", ["top", "end"])
def test_the_step_is_the_oracles(align: str) -> None:
    dt, theta, start, t = 2e-3, 10.0, (3.0, -3, 2, 1, -2), np.arange(600) * 2e-3
    u, y = np.sin(4 * t)[:, None], np.column_stack([5 * np.cos(3 * t), 6 * np.sin(2 * t)])
    y[40:60, 0] = np.nan
    y[50:90, 1] = np.nan
    observer = hg.observers.high_gain(blocks(align), theta=theta, gains=WHOLE, initial=start)
    step, b = hg.sample(observer, hg.methods.rk4, dt=dt), model(align)
    K = WHOLE * theta ** np.array(POWERS[align], dtype=float)

    def rate(z: np.ndarray, y_: np.ndarray, valid: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(A @ z + b(z, v) + K @ (valid * (y_ - [0, v[0]] - C @ z)))

    expected = run(rate, np.array(start), y, dt, u)
    assert step.run(u=u[:, 0], y=y, engine="python").x == pytest.approx(expected, abs=1e-10)


@pytest.mark.ordinary("end-float", "end-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("kind", ["top", "end", "driven"])
def test_the_c_is_the_program(kind: str, real: Any) -> None:
    observer = observer_of_pair() if kind == "driven" else hg.observers.high_gain(blocks(kind), theta=5, gains=WHOLE)
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
    assert "64 samples as recorded" in native.run_check(hg.targets.c99(step, real=real))


def test_the_banner_has_the_rows() -> None:
    observer = hg.observers.high_gain(blocks("end"), theta=5, gains=WHOLE)
    assert observer.equations[1] == "K = (3, 0.4), (2.5, -0.3), (0.5, 0.2), (0.5, 1.5), (-0.2, 0.5)"
    (K,) = observer.parts[0].derived
    assert K.labels[:4] == ("theta K_(1,1,1)", "K_(1,1,2)", "theta^2 K_(1,2,1)", "theta K_(1,2,2)")


def test_a_short_chain_at_the_end_reaches_a_long_one_by_powers_below_0() -> None:
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in range(1, 5)]
    outputs, flow = (hg.Signal("y1"), hg.Signal("y2")), [x[1], x[2], -sp.sin(x[0]) - x[3], -x[3] + x[0] / 9]
    plant = hg.System("long", states=x, outputs=outputs, flow=flow, output=[x[0], x[3]])
    gains = np.array([[3, 0.2], [3, 0.4], [1, 0.6], [0.1, 1]])
    form = hg.forms.block_triangular(plant, align="end")
    observer = hg.observers.high_gain(form, theta=8, gains=gains)
    step = hg.sample(observer, dt=1e-3)
    step.tune()
    expected = gains * 8.0 ** np.array([[1, -1], [2, 0], [3, 1], [3, 1]])
    assert step._kept.places[Place("derived", "K")] == pytest.approx(expected.ravel(), rel=1e-12)
    (K,) = observer.parts[0].derived
    assert K.labels[:4] == ("theta K_(1,1,1)", "theta^-1 K_(1,1,2)", "theta^2 K_(1,2,1)", "K_(1,2,2)")
    assert "64 samples as recorded" in native.run_check(hg.targets.c99(step, real="float"))
    checks = (*observer.checks, *hg.contraction(step).checks)
    rows = findings(hg.certificate(form, checks, "high_gain"))
    assert rows["step"] == rows["convergence"] == "verified"


def test_a_column_is_a_gain_of_one_chain() -> None:
    form = hg.forms.triangular(one())
    each = [hg.observers.high_gain(form, theta=5, gains=gains) for gains in ((2, 1), [[2], [1]])]
    assert each[0].equations == each[1].equations
    assert each[0].parts[0].derived[0].labels == each[1].parts[0].derived[0].labels


def one() -> hg.System:
    x1, x2 = (hg.Signal(f"x{i}", low=-2, high=2) for i in (1, 2))
    return hg.System("one", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -sp.sin(x1)], output=[x1])


def test_a_matrix_in_plain_text() -> None:
    read = Tuning(
        "text",
        blocks("top").system,
        {"high_gain": {"form": "block_triangular", "dt": 1e-3, "theta": 10, "gains": WHOLE.tolist()}},
    )
    expected = hg.observers.high_gain(blocks("top"), theta=10, gains=WHOLE)
    assert read.observer("high_gain").equations == expected.equations


# --- what is proved of it -----------------------------------------------------------------------------------


@pytest.mark.ordinary("end")
@pytest.mark.parametrize("align", ["top", "end"])
def test_the_bound_on_theta_holds(align: str) -> None:
    """M'P + P M < 0, M = Delta (A - K_theta C + J) Delta^-1, at points of the box, above the bound."""
    form = blocks(align)
    error = with_gains(form, [*map(Fraction, WHOLE.ravel().tolist())])
    assert isinstance(error, Inclusion), error
    proof = Flow(error, Fraction(12)).least
    assert proof is not None
    P = np.array([[float(x) for x in row] for row in proof.weights.P])
    slope = sp.lambdify(form.states, sp.Matrix(form.b).jacobian(sp.Matrix(form.states)), "numpy")
    rng, power = np.random.default_rng(1), np.array(exponents(form), dtype=float)
    for _ in range(300):
        J = np.array(slope(*rng.uniform(-4, 4, size=5)), dtype=float) * rng.choice([0.0, 1.0, rng.uniform()], 5)
        for theta in (float(proof.theta) * 1.0001, float(proof.theta) * 3):
            K, Delta = WHOLE * theta ** np.array(POWERS[align], dtype=float), theta**-power
            M = Delta[:, None] * (A - K @ C + J) / Delta
            assert np.linalg.eigvalsh(M.T @ P + P @ M).max() < 0


@pytest.mark.full
def test_it_is_verified_as_it_runs() -> None:
    """With an a that moves by an input and a parameter, and a C that moves by the input."""
    wanted = ("convergence", "theta", "step", "shorter", "tuned", "noise", "start")
    assert findings(certified()) == dict.fromkeys(wanted, "verified")


@pytest.mark.full
def test_two_estimates_come_together_by_the_proved_share() -> None:
    """In floats and doubles' reading of the program, with inputs and parameters anywhere in their ranges."""
    observer, dt = observer_of_pair(), 2e-2
    step = hg.sample(observer, hg.methods.rk4, dt=dt)
    known = hg.contraction(step)
    assert known.proof is not None
    P = np.array([[float(x) for x in row] for row in known.proof.weights.P])
    Delta = 4.0 ** -np.array([0.0, 1, 0])
    rng = np.random.default_rng(5)
    u, y = rng.uniform(-0.3, 0.3, 40), rng.normal(size=(40, 2))
    runs = [
        hg.sample(hg.observers.high_gain(observer.form, theta=4, gains=PAIR, initial=x0), hg.methods.rk4, dt=dt)
        for x0 in ((2, -2, 1), (-1.5, 1, -2))
    ]
    z = [one.run(u=u, y=y, engine="python").x for one in runs]
    e = Delta * (z[0] - z[1])
    V = np.einsum("ti,ij,tj->t", e, P, e)
    assert V[0] > 0.1
    assert (V[1:] <= V[:-1] * (1 - float(known.proof.alpha) * dt) * (1 + 1e-9) + 1e-20).all()


@pytest.mark.ordinary("20-1", "20-2")
@pytest.mark.parametrize("at", range(6))
@pytest.mark.parametrize("more", ["20", "-20"])
def test_another_entry_is_not_what_was_proved(at: int, more: str) -> None:
    content = copy.deepcopy(certified())
    entry = content["observer"]["gains"][at]
    content["observer"]["gains"][at] = str(Fraction(entry) + Fraction(more))
    assert set(findings(content).values()) == {"fails"}


def test_so_many_entries_are_no_gain() -> None:
    content = copy.deepcopy(certified())
    content["observer"]["gains"] = content["observer"]["gains"][:5]
    with pytest.raises(NoCertificate, match="its gains are not 3 entries, nor 3 for each of 2 chains"):
        findings(content)


def test_the_entries_of_each_chain_are_not_the_whole() -> None:
    """The rate is that of the rows that act on both outputs."""
    content = copy.deepcopy(certified())
    gains = content["observer"]["gains"]
    content["observer"]["gains"] = [gains[0], gains[2], gains[5]]
    assert findings(content)["step"] == "fails"


# --- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gains", "error", "said"),
    [
        (WHOLE[:4], BadGain, "must be 2 sequences, one for each output with a chain, or a matrix of 5 x 2"),
        (WHOLE.T, BadGain, "must be 3 and 2 finite numbers"),
        (WHOLE * np.nan, BadGain, "must be 5 x 2 finite numbers"),
        (-WHOLE, NotHurwitz, "gains: the linear error core has the eigenvalues"),
    ],
)
def test_bad_matrices(gains: Any, error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        hg.observers.high_gain(blocks("top"), theta=10, gains=gains)
