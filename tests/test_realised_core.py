"""The proof of a step by the matrix exponential: against SciPy's, and with the polynomials that a program takes."""

import copy
import sys
from fractions import Fraction
from functools import partial
from itertools import product
from typing import Any

import mpmath
import numpy as np
import pytest
from flint import arb, ctx, fmpq_mat
from forger import sealed
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plants import MODELS, model
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Verdict
from hgogen.discretisation import kernels
from hgogen.model import load
from hgogen.program import Place
from hgogen.prove import inequality as maker
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.inequality import Steps, unstable
from hgogen.prove.quadratic import BALLS, floats, rational
from hgogen.recheck import inequality
from hgogen.recheck.matrix import Matrix, weight
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import definite, fraction, number
from hgogen.stepping.machine import Machine


def steps_of(name: str, observer: str, theta: float | None = None) -> Steps:
    """What is sought of the step of a shipped tuning, by the matrix exponential."""
    gains = load(MODELS / f"{name}.py").module.tuning[observer]
    known = gains | ({} if theta is None else {"theta": theta})
    made = getattr(hg.observers, observer)(hg.forms.triangular(model(name)), **known)
    assert isinstance(made.error, Inclusion)
    return Steps(made.error, hg.methods.exponential.error_step, Fraction(known["theta"]))


CORES = [("pendulum", "high_gain"), ("pendulum", "filtered"), ("hyperjerk", "filtered"), ("hyperjerk", "low_power")]


@pytest.mark.parametrize(("name", "observer"), CORES)
@pytest.mark.parametrize("h", [1e-6, 0.01, 0.3])
def test_the_balls_hold_what_the_program_takes(name: str, observer: str, h: float) -> None:
    """Its polynomial in fractions, with as many halvings as its kernel takes of the balanced core."""
    steps = steps_of(name, observer)
    core = steps.error.at(steps.theta).core
    _, phi_2 = maker.by_matrix_exponential(core, Fraction(h))
    x, scale = h * floats(core).reshape(-1), np.ones(len(core))
    kernels.balance(x, scale)
    norm = np.abs(x.reshape(core.shape)).sum(axis=1).max()
    halvings = max(0, int(np.ceil(np.log2(2 * norm))))
    with ctx.workprec(4 * BALLS):
        X = core * number(Fraction(h)) / 2**halvings * arb(1)
        one = np.eye(len(core), dtype=int) * arb(1)
        a2 = one
        for j in range(kernels.DEGREE, 0, -1):
            a2 = one + X @ a2 / (j + 2)
        a2 = a2 / 2
        a1 = one + X @ a2
        a0 = one + X @ a1
        for _ in range(halvings):
            a2, a1, a0 = (a0 @ a2 + a1 + a2) / 4, (a0 @ a1 + a1) / 2, a0 @ a0
    assert all(ball.contains(value) for ball, value in zip(phi_2.flat, a2.flat, strict=True))


def test_a_polynomial_that_may_be_further_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    h = Fraction(0.01)
    assert steps_of("pendulum", "high_gain").certain(h) is not None
    monkeypatch.setattr(maker, "WITHIN", Fraction(1, 2**120))
    assert steps_of("pendulum", "high_gain").certain(h) is None


def test_a_core_that_the_program_does_not_halve_enough_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    h = Fraction(1, 2)
    assert steps_of("pendulum", "high_gain").certain(h) is not None
    monkeypatch.setattr(maker, "HALVINGS", 2)
    assert steps_of("pendulum", "high_gain").certain(h) is None


@pytest.mark.parametrize(("name", "observer"), CORES)
def test_the_error_moves_as_by_scipys_exponential(name: str, observer: str) -> None:
    """e+ = (Phi + Psi_0 J_0 + Psi_1 (J_1 (Phi + Psi_0 J_0) - J_0)) e, the phi by a block of one exponential."""
    steps, h, rng = steps_of(name, observer), 0.03, np.random.default_rng(0)
    e, step = steps.error.at(steps.theta), steps.at(Fraction(h))
    M, G, H, core = map(floats, (e.M, e.G, e.H, e.core))
    n, m = e.G.shape
    wide = np.zeros((3 * n, 3 * n))
    wide[:n, :n], wide[:n, n : 2 * n], wide[n : 2 * n, 2 * n :] = h * core, np.eye(n), np.eye(n)
    phi_0, phi_1, phi_2 = (expm(wide)[:n, k * n : (k + 1) * n] for k in range(3))
    for _ in range(5):
        d = rng.uniform(-1, 1, (2, m))
        J_0, J_1 = (M - core + G @ np.diag(each) @ H for each in d)
        first = phi_0 + h * phi_1 @ J_0
        wanted = first + h * phi_2 @ (J_1 @ first - J_0)
        v = np.vstack([np.eye(n), d[0][:, None] * H, d[1][:, None] * (H @ first)])
        np.testing.assert_allclose(np.eye(n) + h * floats(step.D) @ v, wanted, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(floats(step.Q) @ v, np.vstack([H, H @ first]), rtol=1e-9, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize(("name", "observer", "theta"), [("hyperjerk", "filtered", 10), ("hyperjerk", "low_power", 6)])
def test_it_is_proved_to_nine_tenths_of_where_a_frozen_slope_is_unstable(
    name: str, observer: str, theta: float
) -> None:
    steps = steps_of(name, observer, theta)
    edge = next(h for h in np.geomspace(0.3, 3, 200) if unstable(steps.at(Fraction(h))) is not None)
    assert all(steps.certain(Fraction(share * edge)) is not None for share in (0.02, 0.2, 0.5, 0.82, 0.9))


@pytest.mark.full
def test_it_is_said_in_which_arithmetic() -> None:
    gains = load(MODELS / "pendulum.py").module.tuning["high_gain"]
    made = hg.observers.high_gain(hg.forms.triangular(model("pendulum")), **gains)
    for method, said in (("exponential", "outward rounded arithmetic"), ("bilinear", "rational arithmetic")):
        step = hg.sample(made, getattr(hg.methods, method), dt=0.01)
        gain = hg.noise_gain(step)
        assert isinstance(gain, hg.NoiseGain)
        assert all(f"in {said}" in str(check.reason) for check in (hg.contraction(step).checks[0], gain.check))


def test_balls_are_definite_where_every_matrix_within_them_is() -> None:
    M = np.array([[2, 1], [1, 1]], dtype=object)
    exactly, wide = rational(M), np.array([[arb(2, 0.5), arb(1)], [arb(1), arb(1)]], dtype=object)
    for matrix, sure in [(exactly, True), (wide, True), (wide - np.diag([arb(0.5), arb(0)]), False)]:
        assert definite(matrix) is sure
    assert not definite(-wide)
    assert not definite(np.array([[arb(0, "inf")]], dtype=object))


def within(M: Any, radius: Fraction) -> Any:
    """Balls around the elements of a matrix."""
    return np.array([[arb(x, number(radius)) for x in row] for row in M], dtype=object)


@pytest.mark.parametrize("n", [4, 10, 16])
def test_wide_balls_are_definite_up_to_a_share_of_the_least_eigenvalue(n: int) -> None:
    """The inverse of min(i, j) is the second difference, of a norm below 4: no eigenvalue is below 1/4, and no matrix
    within balls of a radius of 1/(4 n) is singular. An elimination makes balls wider at each pivot. In balls of 1/3 is
    min(i, j) - s s'/3 of the signs s = (-1)^i, with (1, -1, 0, ..) M (1, -1, 0, ..)' = 1 - 4/3."""
    M = np.minimum.outer(np.arange(1, n + 1), np.arange(1, n + 1)).tolist()
    with ctx.workprec(BALLS):
        assert definite(within(M, Fraction(1, 8 * n * n)))
        assert not definite(within(M, Fraction(1, 3)))


def test_narrow_balls_are_definite_where_no_float_factors() -> None:
    """Hilbert's matrix of 20 rows has a condition number of 1e28."""
    n = 20
    M = [[number(Fraction(1, i + j + 1)) for j in range(n)] for i in range(n)]
    with ctx.workprec(BALLS):
        assert definite(within(M, Fraction(1, 2**200)))
        assert not definite(within(M, Fraction(1, 10**9)))


@given(st.lists(st.lists(st.integers(-5, 5), min_size=4, max_size=4), min_size=4, max_size=4))
@settings(deadline=None, max_examples=60)
def test_balls_that_hold_a_singular_matrix_are_not_definite(rows: list[list[int]]) -> None:
    """M - r s s' of signs s is singular where r s'M^-1 s = 1."""
    A = fmpq_mat(rows)
    assume(A.rank() == 4)
    M = A * A.transpose()
    signs = fmpq_mat([list(s) for s in product((-1, 1), repeat=4)]).transpose()
    most = max((signs.transpose() * M.solve(signs)).tolist()[k][k] for k in range(16))
    with ctx.workprec(BALLS):
        assert not definite(within(M.tolist(), 1 / fraction(most)))


@pytest.mark.parametrize("size", [0.01, 0.4, 3, 40])
def test_the_weight_is_rebuilt_to_its_width(size: float) -> None:
    """By mpmath at many digits, as (exp X - 1 - X)/X^2."""
    rng = np.random.default_rng(5)
    X = Matrix([[Fraction(value) for value in row] for row in rng.normal(0, size, (4, 4)) - size * np.eye(4)])
    middle, width = weight(X)
    with mpmath.workdps(80):
        big = mpmath.matrix([[mpmath.mpf(x.numerator) / x.denominator for x in row] for row in X])
        exactly = (mpmath.expm(big) - mpmath.eye(4) - big) * (big * big) ** -1
        away = max(
            abs(exactly[i, j] - mpmath.mpf(middle[i][j].numerator) / middle[i][j].denominator)
            for i in range(4)
            for j in range(4)
        )
        assert away <= width.numerator / mpmath.mpf(width.denominator)
        assert width < Fraction(1, 10**14)


def certified(observer: str) -> dict[str, Any]:
    """The certificate of the hyperjerk's shipped tuning, with the bound of noise."""
    gains = load(MODELS / "hyperjerk.py").module.tuning[observer]
    made = getattr(hg.observers, observer)(hg.forms.triangular(model("hyperjerk")), **gains)
    step = hg.sample(made, hg.methods.exponential, dt=0.02)
    gain = hg.noise_gain(step)
    assert isinstance(gain, hg.NoiseGain)
    return hg.certificate(made.form, (*made.checks, *hg.contraction(step).checks, gain.check), observer)


def findings(content: dict[str, Any]) -> dict[str, str]:
    """What is found of the claims of the step."""
    rows = {row.id.split(".")[1]: row.found for row in recheck(sealed(content)).rows}
    return {fact: rows[fact] for fact in ("step", "noise")}


def test_forged_numbers_and_a_polynomial_that_may_be_further_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    content = certified("high_gain")
    assert findings(content) == {"step": "verified", "noise": "verified"}
    for fact, forge in (
        ("step", partial(_larger, key="alpha")),
        ("noise", _smaller),
        ("step", partial(_larger, key="dt", by=40)),
    ):
        forged = copy.deepcopy(content)
        (one,) = (each["evidence"] for each in forged["claims"] if each["id"].endswith(f".{fact}"))
        forge(one)
        assert findings(forged)[fact] == "fails", fact
    monkeypatch.setattr(inequality, "POLYNOMIAL_ERROR", Fraction(1, 100))
    assert findings(content) == {"step": "fails", "noise": "fails"}


def _larger(one: dict[str, Any], key: str, by: float = 1.1) -> None:
    one[key] = str(Fraction(one[key]) * Fraction(by))


def _smaller(one: dict[str, Any]) -> None:
    one["bounds"][0]["bound"] = str(Fraction(one["bounds"][0]["bound"]) * Fraction(9, 10))


def test_a_core_too_fast_for_its_dt_is_not_rebuilt() -> None:
    limit = sys.float_info.max
    with pytest.raises(inequality.Unproved, match="too fast"):
        weight(Matrix([[Fraction(limit)]]))


@pytest.mark.parametrize("method", ["exponential", "bilinear"])
def test_nothing_is_proved_where_a_core_moves(method: str) -> None:
    """With a parameter, of which the program realises the core at its own value."""
    x1, x2 = hg.Signal("x1", low=-2, high=2), hg.Signal("x2", low=-2, high=2)
    a = hg.Signal("a", "", "", 2, low=1, high=3)
    plant = hg.System(
        "scaled", states=(x1, x2), parameters=(a,), outputs=(hg.Signal("y"),), flow=[a * x2, -x1], output=[x1]
    )
    made = hg.observers.high_gain(hg.forms.triangular(plant), theta=8, gains=(2, 0.5))
    (check,) = hg.contraction(hg.sample(made, getattr(hg.methods, method), dt=1e-3)).checks
    assert check.verdict is Verdict.UNKNOWN
    assert "for a linear core that does not move" in str(check.reason)


@pytest.mark.ordinary("bilinear")
@pytest.mark.parametrize("method", ["exponential", "bilinear"])
def test_a_core_is_realised_with_its_saturations_open(method: str) -> None:
    """The slope of a step of the program in its fields, each saturation open, is that of the proof with its slopes at
    what they are there."""
    gains = load(MODELS / "pendulum.py").module.tuning["peaking_free"]
    made = hg.observers.peaking_free(hg.forms.triangular(model("pendulum")), **gains)
    step = hg.sample(made, getattr(hg.methods, method), dt=0.02)
    assert hg.contraction(step).proved
    error, theta = made.error, Fraction(gains["theta"])
    assert isinstance(error, Inclusion)
    e, remembered = error.at(theta), error.remembered(theta)
    assert remembered is not None
    d = []
    for slope in error.varying:  # at rest: -a cos 0 and -b of the swing, saturations open
        value = 1.0 if slope.entry is None else {(1, 0): -19.6, (1, 1): -0.1}[slope.entry]
        span = float(slope.high - slope.low)
        d.append((value - float(slope.low + slope.high) / 2) / (span / 2))
    wanted = step.method.error_step(Fraction(0.02), e).frozen(np.array([d]))[0]
    units, eps, seen = np.array(list(map(float, remembered))), 1e-6, []
    for k in range(len(units)):
        ends = []
        for sign in (1, -1):
            machine = Machine(step)
            machine.record(np.zeros((2, 1)), np.zeros((2, 1)))
            fields = np.zeros(len(units))
            fields[k] = sign * eps / units[k]
            place = 0
            for field in made.parts[0].fields:
                machine.memory[Place("state", field.name)][:] = fields[place : place + field.size]
                place += field.size
            machine.record(np.zeros((1, 1)), np.zeros((1, 1)))
            ends.append(
                np.concatenate([machine.memory[Place("state", f.name)].ravel() for f in made.parts[0].fields]) * units
            )
        seen.append((ends[0] - ends[1]) / (2 * eps))
    np.testing.assert_allclose(np.array(seen).T, wanted, atol=2e-6)


# --- what the verifier allows for a polynomial beside phi_2 ---------------------------------------------------------


def one_state(rest: int, read: int) -> inequality.ErrorMatrices:
    """M = 1 + rest, L = 1, G = 1, H = read, of a sample that enters by 1 as L takes it."""
    M, L, G, H, B, none = (Matrix([[Fraction(value)]]) for value in (1 + rest, 1, 1, read, 1, 0))
    return inequality.ErrorMatrices(M, G, H, L, False, B, none, none)


def within_width(width: Fraction, by: int = 0) -> Any:
    """phi_2 = 1/2 + by width and phi_1 = 1 + X phi_2, which are known to the width where they are not moved."""

    def weights(X: inequality.Matrix) -> inequality.Weights:
        phi_2 = Fraction(1, 2) + by * width
        return Matrix([[1 + X[0][0] * phi_2]]), Matrix([[phi_2]]), Fraction(0) if by else width

    return weights


@pytest.mark.parametrize("width", [Fraction(1, 100), Fraction(1), Fraction(1000)])
def test_what_a_polynomial_may_be_beside_moves_a_step_by_no_more_and_no_less(width: Fraction) -> None:
    """Of one state all that is added has one sign, so that the width is met at its end: D, and the last X."""
    parts, (e, p_0, p_1, v_0, v_1) = one_state(3, 2), (Matrix([row]) for row in inequality.unit(5))
    known, moved = (
        inequality._realised(within_width(width, by), parts, Fraction(1, 10), e, [p_0, p_1], [v_0, v_1])
        for by in (0, 1)
    )
    off_D, off_X = known.off
    beside_D, beside_X = (abs(a - b) for a, b in ((moved.D, known.D), (moved.stages[1], known.stages[1])))
    assert all(x <= most for x, most in zip(beside_D[0], off_D[0], strict=True))
    assert all(x <= most for x, most in zip(beside_X[0], off_X[0], strict=True))
    assert (beside_D[0][0], beside_X[0][0]) == (off_D[0][0], off_X[0][0])


@pytest.mark.parametrize("by", [1, -1])
@pytest.mark.parametrize("width", [Fraction(1, 100), Fraction(1), Fraction(1000)])
@pytest.mark.parametrize("read", [1, 100])
@pytest.mark.parametrize(("P", "S"), [("1", "1"), ("1/1000000", "1000")])
def test_the_inequality_holds_whatever_a_polynomial_is_within_its_width(
    by: int, width: Fraction, read: int, P: str, S: str
) -> None:
    """Where the norm weighs most, and where the slopes do."""
    parts, nodes, h = one_state(-3, read), [Fraction(0), Fraction(1)], Fraction(1, 10)
    evidence = {"P": [[P]], "S": [S, S]}
    allowed, moved = (
        inequality.form_of(
            parts, inequality.Method(nodes, 0, partial(inequality._realised, within_width(width, k))), h, evidence
        )
        for k in (0, by)
    )
    inequality.demand_nonnegative({"what is allowed beside it": allowed - moved})
