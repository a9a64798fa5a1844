"""How much every window of an input's course shows at least: known answers, numbers from below, forged claims."""

import copy
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import flint
import numpy as np
import pytest
import sympy as sp
from forger import sealed
from plants import model
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.check import Check, Verdict
from hgogen.estimators.persistence import Course, GramianBound, WindowGramian, _smallest, _windows
from hgogen.reading.given import BadGain
from hgogen.recheck.verification import recheck
from hgogen.trial import t

Content = dict[str, Any]
x1, x2, x3 = (hg.Signal(f"x{i}", low=-3, high=3) for i in (1, 2, 3))
u, v = hg.Signal("u", low=-2, high=2), hg.Signal("v", low=-2, high=2)
y1, y2 = hg.Signal("y1"), hg.Signal("y2")


def form(*flow: Any, output: Any = (x1,), inputs: tuple[hg.Signal, ...] = (u,), a: hg.Signal | None = None) -> hg.Form:
    states, outputs = (x1, x2, x3)[: len(flow)], (y1, y2)[: len(output)]
    data = {"states": states, "inputs": inputs, "outputs": outputs, "parameters": (a,) if a else ()}
    return hg.forms.state_affine(hg.System("shown", **data, flow=flow, output=output))


def check_of(affine: hg.Form, inputs: Any, period: Any = None, R: Any = 0.1, **more: Any) -> Check:
    observer = hg.observers.kalman_like(affine, rho=1.0, R=R, inputs=inputs, period=period, **more)
    (check,) = (one for one in observer.checks if one.id == "kalman_like.gramian")
    return check


def fact(check: Check) -> GramianBound:
    (proof,) = check.proofs
    assert isinstance(proof, GramianBound)
    return proof


def least(affine: hg.Form, inputs: dict[str, Any], d: float, R: Any, begins: Any, a: float = 1.0) -> float:
    """The smallest eigenvalue of W(s, d) over some s, in floats."""
    course = [sp.sympify(inputs[s.name]) for s in affine.system.inputs]
    known = dict(zip(affine.system.inputs, course, strict=True))
    fixed = {p: a if p.bounded else value for p, value in affine.system.nominal.items()}
    C = sp.Matrix(affine.output).jacobian(sp.Matrix(affine.states))
    A, C = (sp.lambdify(t, M.subs(known).subs(fixed), "numpy") for M in (sp.Matrix(affine.A), C))
    D = np.diag([(s.interval[1] - s.interval[0]) / 2 for s in affine.states])
    n, weight = affine.n, np.diag(1 / np.broadcast_to(R, len(affine.output)))

    def rate(s: float, state: np.ndarray) -> np.ndarray:
        Phi = state[: n * n].reshape(n, n)
        V = np.array(C(s), dtype=float) @ Phi
        return np.concatenate([(np.array(A(s), dtype=float) @ Phi).ravel(), (V.T @ weight @ V).ravel()])

    start, values = np.concatenate([np.eye(n).ravel(), np.zeros(n * n)]), []
    for s in begins:
        W = solve_ivp(rate, (s, s + d), start, rtol=1e-8, atol=1e-11).y[n * n :, -1].reshape(n, n)
        values.append(np.linalg.eigvalsh(D @ (W + W.T) / 2 @ D)[0])
    return min(values)


TURNED = {"u": "sin(t)"}
CASES: dict[str, tuple[Callable[[], hg.Form], dict[str, Any], Any, Any]] = {
    "sine": (lambda: form(u * x2, -x1 / 2), TURNED, "2*pi", 0.1),
    "neuron": (lambda: hg.forms.state_affine(model("fitzhugh_nagumo")), TURNED, "2*pi", 0.1),
    "quotient": (lambda: form(u * x2, -x1), {"u": "1/(2 + cos(t))"}, "2*pi", 0.3),
    "exponential": (
        lambda: form(u * x2, v * x3, -x1, inputs=(u, v)),
        {"u": "3/2 + cos(2*t)/4", "v": "exp(sin(t))/2"},
        "2*pi",
        0.1,
    ),
    "roots": (
        lambda: form(u * x2, -x1),
        {"u": "sqrt(1 + sin(t)/2) + log(2 + cos(t))/9 + tan(sin(t)/3)/9"},
        "2*pi",
        0.1,
    ),
    "two outputs": (
        lambda: form(-x1, -2 * x2, x1 - x3, output=(u * x1 + v * x2, x3), inputs=(u, v)),
        {"u": "cos(t)", "v": 1},
        "2*pi",
        (0.1, 5.0),
    ),
    "constant": (lambda: form(u * x2, -x1), {"u": "3/2"}, None, 0.1),
    "at the end of its range": (lambda: form(u * x2, -x1), {"u": 2}, None, 0.1),
    "any input": (lambda: form(x2 + u, -x1), {"u": "sin(t)"}, None, 0.1),
}


@cache
def proved(case: str) -> tuple[hg.Form, Check]:
    made, inputs, period, R = CASES[case]
    affine = made()
    return affine, check_of(affine, inputs, period, R)


# --- numbers ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_it_is_below_every_window_and_not_far(case: str) -> None:
    affine, check = proved(case)
    assert check.verdict is Verdict.PROVED, check
    known, (_, inputs, period, R) = fact(check), CASES[case]
    begins = np.linspace(0, float(sp.sympify(period)), 9) if period else (0.0,)
    seen = least(affine, inputs, float(known.window), R, begins)
    assert float(known.bound) <= seen
    assert float(known.bound) >= (0.4 if period else 0.99) * seen


@pytest.mark.parametrize(("d", "low", "high"), [(1, 1.6e-5, 5.9e-4), (Fraction(44, 7), 5.6e-3, 0.064)])
def test_the_neuron_has_the_windows_that_are_known(d: Fraction, low: float, high: float) -> None:
    """Those of its linearisation along the paper's trial, unscaled, where A(u) is another one: the same size."""
    u_ = sp.sin(t)
    A = sp.Matrix([[0, -u_, 0], [0, -sp.Rational(4, 5), -sp.Rational(4, 5)], [0, 0, 0]])
    piece = Fraction(d, 65)
    bound = min(_windows(Course(A, sp.Matrix([[1, 0, 0]]), t, ()), piece, 6, int(7 / piece)))
    assert low / 2 < bound < high


def test_a_piece_is_enclosed() -> None:
    """Phi and W over a piece, and what |v|^2 keeps in it."""
    A, C = sp.Matrix([[sp.sin(t), 2], [-1, sp.cos(3 * t)]]), sp.Matrix([[1, t]])
    course, begin, length = Course(A, C, t, ()), Fraction(1, 3), Fraction(1, 20)
    shown = course.piece(begin, length)

    def rate(s: float, state: np.ndarray) -> np.ndarray:
        Phi = state[:4].reshape(2, 2)
        V = np.array([[1, s]]) @ Phi
        return np.concatenate([(np.array(A.subs(t, s), dtype=float) @ Phi).ravel(), (V.T @ V).ravel()])

    exact = solve_ivp(rate, (1 / 3, 1 / 3 + 0.05), [1, 0, 0, 1, 0, 0, 0, 0], rtol=1e-12, atol=1e-14).y[:, -1]
    for balls, values in ((shown.Phi, exact[:4]), (shown.W, exact[4:])):
        for at, value in enumerate(values):
            ball = balls[at // 2, at % 2]
            assert abs(float(ball.mid()) - value) <= float(ball.rad()) + 1e-10
            assert float(ball.rad()) < 1e-8
    steep = max(
        np.abs(np.linalg.eigvalsh(np.array(A.subs(t, s) + A.subs(t, s).T, dtype=float) / 2)).max()
        for s in (1 / 3, 0.36, 1 / 3 + 0.05)
    )
    assert float(course.steepest(begin, length).upper()) >= steep


def test_what_the_series_leave_counts() -> None:
    """Over a long piece their rest is large, and the exact values lie in the balls all the same."""
    course = Course(sp.Matrix([[0, 1], [-4, 0]]), sp.Matrix([[1, 0]]), t, ())
    shown = course.piece(Fraction(0), Fraction(3))
    assert abs(np.cos(6) - float(shown.Phi[0, 0].mid())) <= float(shown.Phi[0, 0].rad())
    assert abs(np.cos(6) - float(shown.Phi[0, 0].mid())) > 1e-3
    W = 1.5 + np.sin(12) / 8
    assert abs(W - float(shown.W[0, 0].mid())) <= float(shown.W[0, 0].rad())


def test_what_grows_leaves_more() -> None:
    """All that is left out of a series of positive numbers: more than the first of it."""
    shown = Course(sp.Matrix([[1]]), sp.Matrix([[1]]), t, ()).piece(Fraction(0), Fraction(1))
    assert shown.Phi[0, 0].contains(flint.arb(1).exp())
    assert shown.W[0, 0].contains((flint.arb(2).exp() - 1) / 2)


def test_the_widest_ball_counts() -> None:
    """A matrix that is known to within a half in its least entry, and in no other, may be as small."""
    W = flint.arb_mat([[flint.arb(1, 0.5), 0], [0, 3]])
    assert 0.49 < _smallest(WindowGramian(None, W)) <= 0.5


@pytest.mark.full
def test_parameters_are_anywhere_in_their_ranges() -> None:
    a, wide = hg.Signal("a", "", "", 1, low=1 - 1e-6, high=1 + 1e-6), hg.Signal("a", "", "", 1, low=0.2, high=5)
    affine = form(u * x2, -a * x1, a=a)
    known = fact(check_of(affine, TURNED, "2*pi"))
    for value in (1 - 1e-6, 1 + 1e-6):
        assert float(known.bound) <= least(affine, TURNED, float(known.window), 0.1, (0.0, 1.0, 2.0), value)
    check = check_of(form(u * x2, -wide * x1, a=wide), TURNED, "2*pi")
    assert check.verdict is Verdict.UNKNOWN
    assert "no bound above 0 is shown by" in str(check.reason)
    assert "narrower ranges of parameters" in check.fix


@pytest.mark.full
def test_a_longer_window_shows_more() -> None:
    affine = form(u * x2, -x1 / 2)
    short, long = (fact(check_of(affine, TURNED, "2*pi", window=d)) for d in (3.0, 9.0))
    assert 3 - 1e-9 < short.window <= 3
    assert long.bound > 2 * short.bound
    assert check_of(affine, TURNED, "2*pi", window=3.0).claim.written(str) == "every window of 3 s shows every state"
    still = form(x2, -x1)
    assert fact(check_of(still, None)).window == 1
    assert fact(check_of(still, None, window=0.25)).window == Fraction(1, 4)


def test_noise_as_a_whole_scales_it() -> None:
    affine = form(-x1, -2 * x2, output=(u * x1, x2))
    one, other = (fact(check_of(affine, {"u": "cos(t)"}, "2*pi", R)) for R in ((0.1, 0.5), (0.7, 3.5)))
    assert float(one.bound / other.bound) == pytest.approx(7, rel=1e-9)
    for known in (one, other):
        assert all(s * s * r <= 1 for s, r in zip(known.weights, known.R, strict=True))
        assert all(s * s * r > 1 - 1e-9 for s, r in zip(known.weights, known.R, strict=True))


# --- what is not proved -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inputs", "period", "said"),
    [
        (None, None, "it is asked of a course that is declared in closed form, and shown to be persistent"),
        ({"u": "sin(t)"}, None, "it is asked of a course"),
        ({"u": "10 - 9*cos(t - 9/10)"}, "2*pi", "u is not shown to keep to its range, to which an observer clamps it"),
        ({"u": "9*cos(t - 9/10) - 10"}, "2*pi", "u is not shown to keep to its range, to which an observer clamps it"),
        ({"u": "sin(t)"}, "2*pi", ""),
    ],
)
def test_an_unknown_course_has_no_bound(inputs: Any, period: Any, said: str) -> None:
    check = check_of(form(u * x2, -x2), inputs, period)
    assert check.verdict is (Verdict.UNKNOWN if said else Verdict.PROVED)
    assert said in str(check.reason)
    assert bool(said) is bool(check.fix)


def test_a_window_is_a_time() -> None:
    with pytest.raises(BadGain, match="window = -1"):
        check_of(form(x2, -x1), None, window=-1)
    tiny = check_of(form(u * x2, -x1), TURNED, "2*pi", window=0.1)
    assert "the window is too short beside the period" in str(tiny.reason)


# --- verified again -----------------------------------------------------------------------------------------


@cache
def _content(case: str) -> Content:
    made, inputs, period, R = CASES[case]
    affine = made()
    observer = hg.observers.kalman_like(affine, rho=1.0, R=R, inputs=inputs, period=period)
    return hg.certificate(affine, observer.checks, "kalman_like")


def content_of(case: str) -> Content:
    return copy.deepcopy(_content(case))


def evidence(content: Content) -> Content:
    return next(one["evidence"] for one in content["claims"] if one["id"] == "kalman_like.gramian")


def finding(content: Content) -> str:
    return next(row.found for row in recheck(sealed(content)).rows if row.id == "kalman_like.gramian")


@pytest.mark.ordinary("sine", "constant")
@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow) if case in ("roots", "exponential") else case for case in CASES]
)
def test_what_is_proved_is_verified(case: str) -> None:
    assert finding(content_of(case)) == "verified"


def times(factor: float) -> Callable[[Any], Any]:
    return lambda text: str(Fraction(text) * Fraction(factor))


LIES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "a larger bound": ("bound", times(2.5)),
    "a bound below 0": ("bound", times(-1)),
    "shorter pieces": ("piece", times(0.5)),
    "fewer pieces in a window": ("level", lambda _: "5"),
    "a level that is no number": ("level", lambda _: "13/2"),
    "too many pieces": ("level", lambda _: "12"),
    "fewer windows": ("starts", lambda _: "3"),
    "a still course": ("starts", lambda _: "0"),
    "more noise": ("R", lambda R: [times(1.1)(each) for each in R]),
    "R of nothing": ("R", lambda R: ["0"] * len(R)),
    "more weight": ("weights", lambda s: [times(1.01)(each) for each in s]),
    "weights below 0": ("weights", lambda s: [times(-1)(each) for each in s]),
    "another period": ("period", lambda _: "pi"),
    "a weaker course": ("inputs", lambda _: {"u": "sin(t)/9"}),
    "a course beyond the range": ("inputs", lambda _: {"u": "9*sin(t)"}),
    "no course": ("inputs", lambda _: {}),
    "a constant course": ("inputs", lambda _: {"u": "1"}),
    "a course with a corner": ("inputs", lambda _: {"u": "Abs(sin(t))"}),
}


FAST = ("a larger bound", "fewer windows", "more noise", "another period", "a course beyond the range")


@pytest.mark.parametrize("lie", [lie if lie in FAST else pytest.param(lie, marks=pytest.mark.slow) for lie in LIES])
def test_a_forged_number_fails(lie: str) -> None:
    content = content_of("sine")
    key, change = LIES[lie]
    evidence(content)[key] = change(evidence(content)[key])
    assert finding(content) != "verified"


def test_a_still_course_is_not_one_that_moves() -> None:
    content = content_of("constant")
    assert finding(content) == "verified"
    evidence(content)["inputs"]["u"] = "3/2 + sin(t)/9"
    assert finding(content) != "verified"


@pytest.mark.full
def test_another_plant_is_not_what_was_proved() -> None:
    content = content_of("sine")
    for part in ("plant", "form"):
        for state in content[part]["states"]:
            state.update(low="-1", high="1")
    assert finding(content) != "verified"


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 12))])
def test_no_random_course_shows_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, q, r, s = (sp.Rational(round(100 * value), 100) for value in rng.uniform(-1.5, 1.5, 4))
    affine = form(p * x1 + (1 + u) * x2, q * u * x1 + r * x2, output=(x1 + s * u * x2,))
    inputs = {"u": sp.Rational(3, 4) * sp.sin(3 * t) + sp.cos(6 * t) / 2}
    check = check_of(affine, inputs, "2*pi/3", 0.2)
    if check.verdict is Verdict.PROVED:
        known = fact(check)
        assert float(known.bound) <= least(affine, inputs, float(known.window), 0.2, np.linspace(0, 2.1, 15))
