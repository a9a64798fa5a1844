"""Inequality (38) of Alessandri 2020: known edges, counterexamples, and never proved where a sample violates it."""

from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import model
from scipy.linalg import eigh, solve_continuous_are, solve_continuous_lyapunov

import hgogen as hg
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.prove.dissipation import BadErrorSystem
from hgogen.reading.given import BadNames, Misfit
from hgogen.rigor import slope

MODELS = Path(__file__).resolve().parents[1] / "models"
e, f = sp.symbols("e f", real=True)
x = sp.Symbol("x", real=True)


def line(flow: Any, noise: Any = 1, **ranges: tuple[Any, Any]) -> hg.ErrorSystem:
    return hg.ErrorSystem("line", (e,), (flow,), [[noise]], {sp.Symbol(s, real=True): r for s, r in ranges.items()})


def verdicts(dissipation: hg.Dissipation) -> dict[str, Verdict]:
    return {check.id.removeprefix("dissipation."): check.verdict for check in dissipation.checks}


def left_side(dissipation: hg.Dissipation) -> sp.Expr:
    """(38), written down again."""
    slope = sp.Matrix([[dissipation.V.diff(one) for one in dissipation.system.errors]])
    pushed = slope * dissipation.system.noise
    return (
        (slope * sp.Matrix(dissipation.system.flow))[0, 0]
        + sum(value**2 for value in pushed) / (2 * dissipation.mu**2)
        + sum(one**2 for one in dissipation.system.errors) / 2
    )


def demand_witness(dissipation: hg.Dissipation) -> None:
    """The point is of the box, not e = 0, and the left side is not negative there, in exact arithmetic or 60 digits."""
    point = {s: sp.Rational(v.numerator, v.denominator) for s, v in dissipation.witness.items()}
    assert any(point[one] for one in dissipation.system.errors)
    for symbol, (low, high) in {**dissipation.system.box, **dissipation.within}.items():
        assert symbol not in point or low <= point[symbol] <= high
    assert left_side(dissipation).subs(point).evalf(60) >= 0


# --- known edges ------------------------------------------------------------------------------------------------


@pytest.mark.full
@given(st.floats(0.5, 5.0), st.floats(0.2, 3.0), st.floats(0.3, 3.0))
@settings(deadline=None, max_examples=8)
def test_the_gain_of_a_line_is_known_to_one_percent(a: float, b: float, p: float) -> None:
    """V = p e^2: e^2 (-2 p a + 2 p^2 b^2/mu^2 + 1/2) < 0 where mu^2 > 2 p^2 b^2/(2 p a - 1/2)."""
    a += 1 / (2 * p)  # so that 2 p a - 1/2 >= 1/2
    edge = np.sqrt(2 * p * p * b * b / (2 * p * a - 0.5))
    above, below = (hg.dissipation(line(-a * e, b), p * e**2, mu=share * edge, within=[2]) for share in (1.01, 0.99))
    assert above.proved
    assert above.level == pytest.approx(4 * p, rel=1e-8)
    assert above.level <= Fraction(repr(4 * p)) * (1 + Fraction(1, 2**50))
    assert verdicts(below)["inequality"] is Verdict.REFUTED
    demand_witness(below)


@pytest.mark.full
@given(st.floats(1.0, 9.0), st.floats(0.8, 4.0))
@settings(deadline=None, max_examples=8)
def test_the_region_of_a_cubic_is_known_to_one_percent(a: float, mu: float) -> None:
    """F = -a e + e^3, V = e^2: negative where e^2 < a - 1/4 - 1/mu^2; near e = 0 its second order is."""
    edge = a - 0.25 - 1 / mu**2
    if edge < 0.05:
        return
    inside, beyond = (
        hg.dissipation(line(-a * e + e**3), e**2, mu=mu, within=[np.sqrt(share * edge)]) for share in (0.99, 1.01)
    )
    assert inside.proved
    assert inside.level == pytest.approx(0.99 * edge, rel=1e-8)
    assert verdicts(beyond)["inequality"] is Verdict.REFUTED
    demand_witness(beyond)


@pytest.mark.parametrize("seed", range(4))
def test_a_linear_system_with_the_v_of_its_riccati_equation(seed: int) -> None:
    """A'P + P A + 2 P G G'P/mu^2 + I = 0: more than true at mu, and true down to a gain that an eigenvalue says."""
    rng = np.random.default_rng(seed)
    n = 2 + seed % 2
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 1) * np.eye(n)
    G, mu = rng.normal(size=(n, 2)), 20.0
    P = solve_continuous_are(A, G, np.eye(n), -(mu**2 / 2) * np.eye(2))
    P = np.round((P + P.T) / 2, 6)
    edge = np.sqrt(eigh(2 * P @ G @ G.T @ P, -(A.T @ P + P @ A + np.eye(n) / 2), eigvals_only=True).max())
    assert edge < mu
    errors = sp.symbols(f"e1:{n + 1}", real=True)
    system = hg.ErrorSystem("linear", errors, tuple(sp.Matrix(A) * sp.Matrix(errors)), sp.Matrix(G))
    true, false = (hg.dissipation(system, P, mu=share * edge, within=[1] * n) for share in (1.01, 0.99))
    assert true.proved
    assert true.level == pytest.approx(1 / np.diag(np.linalg.inv(P)).max(), rel=1e-8)  # min of e'P e with e_i = 1
    assert verdicts(false)["inequality"] is Verdict.REFUTED
    demand_witness(false)


def test_where_the_second_order_is_definite_on_a_part_slabs_cover_the_rest() -> None:
    """-e - 3 sin 2e has a rising slope between pi/4 and 3 pi/4, and the sign of -e up to 2.2."""
    system = line(-e - 3 * sp.sin(2 * e))
    dissipation = hg.dissipation(system, e**2, mu=3, within=[1.5])
    assert dissipation.proved
    assert "1/2 of the box" in str(dissipation.checks[1].reason)
    beyond = hg.dissipation(system, e**2, mu=3, within=[2.5])
    assert verdicts(beyond)["inequality"] is Verdict.REFUTED
    demand_witness(beyond)


def test_other_functions_than_quadratic_ones() -> None:
    quartic = hg.dissipation(line(-3 * e), e**2 + e**4, mu=3, within=[1])
    assert quartic.proved
    assert quartic.level == pytest.approx(2, rel=2e-2)
    bent = hg.dissipation(line(-3 * e), e**2 - e**4 / 10, mu=3, within=[2])  # its Hessian is not definite on the box
    assert bent.proved
    assert bent.level == pytest.approx(2.4, rel=2e-2)


@pytest.mark.parametrize(("V", "level"), [(e**2 + e / 2, 0.5), (e**2 - sp.Rational(1, 2), 0.5)])
def test_the_level_is_of_all_of_v(V: sp.Expr, level: float) -> None:
    """Its second derivatives alone would say 1."""
    assert hg.dissipation(line(-3 * e), V, mu=3, within=[1]).level == pytest.approx(level, rel=2e-2)


def test_no_number_of_the_conclusion_is_below_what_is_proved() -> None:
    """mu = 1/3 and mu^2/2 = 1/18 are rounded up, in nine digits."""
    said = hg.dissipation(line(-20 * e), e**2, mu=Fraction(1, 3), within=[1]).conclusion
    assert "the L2 gain 0.333333334 from w" in said
    assert "0.0555555556 * integral" in said
    assert said.startswith("in continuous time, ")  # of a step nothing is proved


# --- an observer of a plant -------------------------------------------------------------------------------------


@cache
def pendulum(theta: float) -> tuple[hg.ErrorSystem, np.ndarray]:
    """The high-gain observer with both poles at -theta, and P for its linear part, states scaled by theta."""
    L = [2 * theta, theta**2]
    A = np.array([[-2 * theta, 1], [-(theta**2), -0.1]])
    P = solve_continuous_lyapunov(A.T, -np.diag([1.5 * theta**2, 1.5]))
    return hg.error_system(model("pendulum"), L), np.round(P, 3)


def test_the_error_system_of_a_plant() -> None:
    """e' = F(e, x) + G w, F the difference of plant and observer, G = (I, -L)."""
    system, _ = pendulum(20)
    (e_q, e_w), (q, _) = system.errors, system.states
    assert [s.name for s in system.errors] == ["e_q", "e_w"]
    assert system.noise == sp.Matrix([[1, 0, -40], [0, 1, -400]])
    expected = -sp.Rational("19.6") * (sp.sin(q) - sp.sin(q - e_q)) - e_w / 10 - 400 * e_q
    assert sp.expand(system.flow[1] - expected) == 0
    assert sp.expand(system.flow[0] - e_w + 40 * e_q) == 0


@pytest.mark.full
def test_a_high_gain_observer_of_the_pendulum() -> None:
    """On all errors up to a radian and 10 rad/s; the gain to 2 %, by a sample that violates it below."""
    system, P = pendulum(20)
    dissipation = hg.dissipation(system, P, mu=50, within={"q": 1, "e_w": 10})
    assert dissipation.proved
    assert dissipation.level == pytest.approx(1 / np.diag(np.linalg.inv(P) / [1, 100]).max(), rel=1e-8)
    low, high = 10.0, 50.0
    while high > 1.02 * low:
        middle = hg.dissipation(system, P, mu=np.sqrt(low * high), within=(1, 10))
        verdict = verdicts(middle)["inequality"]
        assert verdict is not Verdict.UNKNOWN
        low, high = (low, float(middle.mu)) if verdict is Verdict.PROVED else (float(middle.mu), high)
    demand_witness(hg.dissipation(system, P, mu=low, within=(1, 10)))


def test_the_gain_that_theorem_6_promises_is_one_by_theorem_1() -> None:
    """The pendulum (91) with the printed K and P at gamma = 20.53: (89) says 31364 (gamma/20.519)^3, far from sharp."""
    numbers = load(MODELS / "disturbed_pendulum.py").module.tuning["adaptive_lmi"]
    gamma = sp.Rational("20.53")
    gain = [gamma ** (i + 1) * sp.Rational(str(k)) for i, k in enumerate(numbers["K"])]
    scale = sp.diag(gamma**2, gamma, 1)  # gamma^3 T^-1
    V = scale * sp.Matrix(3, 3, lambda i, j: sp.Rational(str(numbers["P"][i][j]))) * scale
    system = hg.error_system(model("disturbed_pendulum"), gain, G1=[[0, 0], [0, 0], [0, 1]], G2=[[1, 0]])
    promised = 31364 * (20.53 / 20.519) ** 3
    assert hg.dissipation(system, V, mu=promised, within=(2, 50, 1000)).proved
    assert hg.dissipation(system, V, mu=5000, within=(2, 50, 1000)).proved
    far = hg.dissipation(system, V, mu=1000, within=(2, 50, 1000))
    assert verdicts(far)["inequality"] is Verdict.REFUTED
    demand_witness(far)


@pytest.mark.full
def test_the_error_stays_where_it_is_said_to_stay() -> None:
    """Simulated from the edge of the level set, with the disturbance that the inequality fears most."""
    system, P = pendulum(20)
    mu = 50.0
    dissipation = hg.dissipation(system, P, mu=mu, within=(1, 10))
    flow = sp.lambdify((*system.errors, *system.states), system.flow)
    G, dt = np.array(system.noise, dtype=float), 1e-4
    for angle in np.linspace(0, 2 * np.pi, 7):
        error = np.array([np.cos(angle), 10 * np.sin(angle)])
        error *= np.sqrt(0.5 * float(dissipation.level) / (error @ P @ error))
        start, supply, loss = error @ P @ error, 0.0, 0.0
        for k in range(5000):
            w = G.T @ P @ error * (2 / mu**2)
            if mu**2 / 2 * (supply + dt * w @ w) > 0.4 * float(dissipation.level):
                w = 0 * w
            supply, loss = supply + dt * w @ w, loss + dt * error @ error
            error = error + dt * (np.array(flow(*error, np.sin(k * dt), 0.0)) + G @ w)
            assert abs(error[0]) < 1
            assert abs(error[1]) < 10
        assert error @ P @ error - start <= mu**2 / 2 * supply - loss / 2 + 1e-2 * start  # of Euler's step


# --- nothing is proved that is not so ---------------------------------------------------------------------------

numbers = st.fractions(-2, 2, max_denominator=8)


@pytest.mark.full
@given(st.lists(numbers, min_size=8, max_size=8), st.fractions(1, 6, max_denominator=4), st.booleans())
@settings(deadline=None, max_examples=6)
def test_a_dense_sample_never_violates_what_is_proved(c: list[Fraction], damping: Fraction, trig: bool) -> None:
    a = [sp.Rational(v.numerator, v.denominator) for v in c]
    d = sp.Rational(damping.numerator, damping.denominator)
    curved = sp.sin(x) - sp.sin(x - e) if trig else x**2 - (x - e) ** 2
    flow = (-d * e + a[0] * f + a[1] * curved, a[2] * e - d * f + a[3] * e * f + a[4] * f**3 / 4)
    system = hg.ErrorSystem("random", (e, f), flow, [[1, 0], [a[5] * x, 1]], {x: (-1, 1)}, ())
    V = e**2 + a[6] / 3 * e * f + f**2 + max(a[7] - 1, 0) / 8 * e**4  # now and then not quadratic
    dissipation = hg.dissipation(system, V, mu=2, within=[1, 1], boxes=100)
    points = np.random.default_rng(0).uniform(-1, 1, size=(3, 20_000))
    points[:2] *= 2.0 ** -np.random.default_rng(1).integers(0, 8, size=20_000)
    left = sp.lambdify((e, f, x), left_side(dissipation))(*points)
    size = (points[:2] ** 2).sum(axis=0)
    if verdicts(dissipation)["inequality"] is Verdict.PROVED:
        assert (left < 1e-12 * size).all()
    if (
        verdicts(dissipation)["inequality"] is Verdict.REFUTED
        and verdicts(dissipation)["positive"] is not Verdict.REFUTED
    ):
        demand_witness(dissipation)
    if verdicts(dissipation)["positive"] is Verdict.PROVED:
        assert (sp.lambdify((e, f), V)(*points[:2]) > 0).all()


def rotated(angle: float) -> hg.ErrorSystem:
    """Damped along one direction and driven along another: with V = e^2 + f^2 a full N, indefinite by its minor."""
    c, s = sp.Rational(f"{np.cos(angle):.6f}"), sp.Rational(f"{np.sin(angle):.6f}")
    T = sp.Matrix([[c, -s], [s, c]])
    return hg.ErrorSystem("rotated", (e, f), tuple(T * sp.diag(-3, -1) * T.T * sp.Matrix([e, f])), T)


EDGES: dict[str, Any] = {  # the system, V, the box, and the gain at which (38) turns false
    "line": (line(-2 * e), e**2, [1], np.sqrt(2 / 3.5)),
    "cubic": (line(-2 * e + e**3), e**2, [1], np.sqrt(2 / 1.5)),
    "rotated": (rotated(0.7), e**2 + f**2, [1, 1], np.sqrt(2 / 1.5)),
    "slabs": (line(-e - 3 * sp.sin(2 * e)), e**2, [1.6], np.sqrt(2 / (1.5 + 6 * np.sin(3.2) / 1.6))),
    "state": (line(-2 * e + sp.sin(x) - sp.sin(x - e), x=(-3, 3)), e**2, [1], np.sqrt(2 / 1.5)),
    "matrix": (
        hg.ErrorSystem("matrix", (e, f), (-2 * e - x * f, -x * e - 2 * f), sp.eye(2), {x: (-0.5, 1.2)}),
        e**2 + f**2,
        [1, 1],
        np.sqrt(2 / 1.1),
    ),
    "noise": (line(-2 * e, 1 + x * e, x=(-1, 1)), e**2, [1], np.sqrt(8 / 3.5)),
}


@pytest.mark.ordinary("line", "rotated")
@pytest.mark.parametrize("name", EDGES)
def test_the_proof_alone_says_nothing_false(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the samples that refute at once: proved above the edge, not proved below it."""
    monkeypatch.setattr(slope, "_samples", lambda claim: iter(()))
    system, V, within, edge = EDGES[name]
    assert hg.dissipation(system, V, mu=1.02 * edge, within=within).proved
    dissipation = hg.dissipation(system, V, mu=0.98 * edge, within=within)
    assert verdicts(dissipation)["inequality"] is not Verdict.PROVED
    if verdicts(dissipation)["inequality"] is Verdict.REFUTED:
        demand_witness(dissipation)


def test_a_counterexample_in_a_corner_of_the_box_is_reached() -> None:
    """It is one for e near -1 and x near 1 only, where no sample of the whole box is: steps uphill lead there."""
    g, R = sp.Symbol("g", real=True), sp.Rational
    flow = (
        -3 * e - R(15, 16) * f + R(13, 16) * g + R(7, 8) * (x**2 - (x - e) ** 2),
        R(7, 4) * e * f - e / 16 - f**3 / 32 - 3 * f - R(13, 16) * g,
        -R(3, 8) * e - R(9, 16) * f + g * sp.tanh(e) - 3 * g,
    )
    noise = [[1, 0, 0], [-R(5, 4) * x, 1, 1], [0, 0, 1]]
    system = hg.ErrorSystem("corner", (e, f, g), flow, noise, {x: (-1, 1)}, ())
    dissipation = hg.dissipation(system, e**2 - e * f + f**2 + g**2, mu=3, within=[1, 1, 1], boxes=100)
    assert verdicts(dissipation)["inequality"] is Verdict.REFUTED
    demand_witness(dissipation)


@pytest.mark.full
def test_a_left_side_that_only_touches_zero_is_not_proved() -> None:
    """-e^2 (e^2 - 1/2)^2, which is 0 at the root of 1/2: no rational point refutes it, and no box proves it."""
    flow = -e * (sp.Rational(1, 2) + (e**2 - sp.Rational(1, 2)) ** 2 / 2)
    dissipation = hg.dissipation(line(flow), e**2, mu=2, within=[1])
    assert sp.expand(left_side(dissipation) + e**2 * (e**2 - sp.Rational(1, 2)) ** 2) == 0
    assert verdicts(dissipation)["inequality"] is Verdict.UNKNOWN


@pytest.mark.parametrize(("where", "size"), [(e, 1.2), (x, 0.7)], ids=["error", "state"])
def test_a_narrow_violation_is_not_overlooked(where: sp.Symbol, size: float) -> None:
    """Positive on some thousandth of the box only, where samples do not fall; in the state, by a little."""
    bump = sp.exp(-(10**6) * (where - sp.Rational(7123, 10_000)) ** 2)
    dissipation = hg.dissipation(line(-e * (1 - size * bump), x=(0, 1)), e**2, mu=3, within=[1])
    assert verdicts(dissipation)["inequality"] is not Verdict.PROVED
    assert "nothing is concluded" in str(dissipation)


@pytest.mark.parametrize(
    ("V", "positive"),
    [(e, Verdict.REFUTED), (-(e**2), Verdict.REFUTED), (e**2 - e**4, Verdict.REFUTED), (e**2 + 1, Verdict.REFUTED)],
)
def test_a_v_that_is_not_positive_is_refuted(V: sp.Expr, positive: Verdict) -> None:
    dissipation = hg.dissipation(line(-3 * e), V, mu=3, within=[2])
    assert verdicts(dissipation)["positive"] is positive
    assert not dissipation.proved


@pytest.mark.parametrize(
    ("system", "V", "said"),
    [
        (line(-e - sp.Abs(e) / 2), e**2, "kinks"),
        (line(-2 * e - sp.sign(e)), e**2, "kinks or jumps"),
        (line(-2 * e - sp.sqrt(sp.Abs(e)) * sp.sign(e)), e**2, "kinks or jumps"),
        (line(-e + x - x), e**4, "second order does not decide"),
        (line(-2 * e + x, x=(0, 1)), e**2, ""),
        (line(-2 * e - 1 / (e - 3) - sp.Rational(1, 3)), e**2, "bounded slope"),
    ],
)
def test_what_is_not_smooth_or_flat_is_not_proved(system: hg.ErrorSystem, V: sp.Expr, said: str) -> None:
    dissipation = hg.dissipation(system, V, mu=3, within=[3])
    assert verdicts(dissipation)["inequality"] is not Verdict.PROVED
    assert any(said in str(check.reason) for check in dissipation.checks)


def test_without_a_range_nothing_is_missed() -> None:
    """The slope grows with x: refuted, unless it is bounded."""
    rising = hg.ErrorSystem("wide", (e,), (-3 * e + x * e,), [[1]], {x: (-sp.oo, sp.oo)})
    assert verdicts(hg.dissipation(rising, e**2, mu=3, within=[1]))["inequality"] is Verdict.REFUTED
    bounded = hg.ErrorSystem("wide", (e,), (-3 * e + sp.sin(x) * e,), [[1]], {x: (-sp.oo, sp.oo)})
    assert hg.dissipation(bounded, e**2, mu=3, within=[1]).proved


# --- bad input --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"V": x}, "uses x; it is a function of the errors e alone"),
        ({"V": [[1, 2], [2, 1]]}, "symmetric 1 x 1"),
        ({"V": "much"}, "neither an expression"),
        ({"mu": 0}, "mu = 0 must be a positive number"),
        ({"mu": "x"}, "mu = 'x' must be a positive number"),
        ({"within": [0]}, "the range 0 of e is none around 0"),
        ({"within": [(1, 2)]}, "none around 0"),
        ({"within": [1, 1]}, "within of length 2"),
        ({"within": {"y": 1}}, "within names 'y', which is none of the names; they are e"),
        ({"within": [float("nan")]}, "none around 0"),
    ],
)
def test_bad_questions_are_met_with_a_sentence(changes: dict[str, Any], said: str) -> None:
    with pytest.raises((BadErrorSystem, BadNames), match=said):
        hg.dissipation(line(-e), **{"V": e**2, "mu": 1, "within": [1], **changes})


def test_bad_systems_are_met_with_a_sentence() -> None:
    with pytest.raises(BadErrorSystem, match="uses x, which is no error and has no range"):
        line(-e + x)
    with pytest.raises(BadErrorSystem, match="1 errors, 2 rows of flow"):
        hg.ErrorSystem("two", (e,), (-e, -f), [[1]])
    with pytest.raises(BadErrorSystem, match="no real symbols"):
        hg.ErrorSystem("complex", (sp.Symbol("c"),), (0,), [[1]])
    with pytest.raises(Misfit, match=r"hg\.error_system"):
        hg.dissipation(model("pendulum"), e**2, mu=1, within=[1])
    with pytest.raises(Misfit, match="boxes"):
        hg.dissipation(line(-e), e**2, mu=1, within=[1], boxes=0)
    with pytest.raises(BadErrorSystem, match=r"gain of shape \(3, 1\) must be 2 x 1"):
        hg.error_system(model("pendulum"), [1, 2, 3])
    with pytest.raises(BadErrorSystem, match="gain uses strange"):
        hg.error_system(model("pendulum"), [sp.Symbol("strange"), 1])
    with pytest.raises(BadErrorSystem, match=r"G2 of shape .* must be 1 x 2"):
        hg.error_system(model("pendulum"), [1, 2], G1=sp.eye(2), G2=[[1, 2, 3]])


@pytest.mark.ordinary("output")
@pytest.mark.parametrize("place", ["rate", "output"])
def test_a_part_of_the_plant_that_cancels_in_the_error_must_have_a_value(place: str) -> None:
    """log(u) on both sides leaves the error without it, and the plant has no value where u <= 0."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    y, by_end = hg.Signal("y"), {}
    for low in (-1, 1):
        u = hg.Signal("u", low=low, high=2)
        rate, seen = (x2 + sp.log(u), x1) if place == "rate" else (x2, x1 + sp.log(u))
        flow = [rate, -x1 - x2]
        plant = hg.System("plant", states=(x1, x2), inputs=(u,), outputs=(y,), flow=flow, output=[seen])
        observer = [gain * (y - seen) + row for gain, row in zip((4, 3), flow, strict=True)]
        V = [[2, -0.5], [-0.5, 1]]
        for system in (hg.error_system(plant, [4, 3]), hg.observer_errors(plant, observer, unknown=())):
            assert not any(row.has(u) for row in system.flow)
            by_end.setdefault(low, set()).add(hg.dissipation(system, V, mu=30, within=[1, 1]).checks[1].verdict)
    assert by_end == {-1: {Verdict.UNKNOWN}, 1: {Verdict.PROVED}}


@pytest.mark.parametrize(
    ("part", "beside", "shown"),
    [
        (sp.log, lambda u: sp.atan2(2, u), False),
        (lambda u: sp.atanh(1 - u), lambda u: sp.asin(1 - u), False),
        (lambda u: 1 / u, sp.sqrt, False),
        (lambda u: 1 / sp.sqrt(u), sp.log, True),
        (lambda u: 1 / u, lambda u: u**-2, True),
        (lambda u: sp.atanh(1 - u), lambda u: sp.atanh(1 - u), True),
    ],
)
def test_what_the_error_still_reads_shows_a_part_only_where_it_has_no_value_itself(
    part: Any, beside: Any, shown: bool
) -> None:
    """atan2(2, u), asin(1 - u) and sqrt(u) have a value at u = 0, where log(u), atanh(1 - u) and 1/u have none."""
    x1, x2 = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2"))
    u, outputs = hg.Signal("u", low=0, high=0.5), (hg.Signal("y"),)
    flow = [x2 * beside(u) + part(u), -x1]
    plant = hg.System("plant", states=(x1, x2), inputs=(u,), outputs=outputs, flow=flow, output=[x1])
    assert (hg.error_system(plant, [1, 1]).lost is None) is shown


def test_a_part_of_the_plant_that_a_value_takes_out_must_have_one() -> None:
    """0 log(u), and sqrt(x2)/x1 along x2 = x1**2, are 0 and 1 to SymPy, and the plant has no value at u = 0, x1 = 0."""
    x1, x2, u = (hg.Signal(name, low=0, high=1) for name in ("x1", "x2", "u"))
    w, k, outputs = hg.Signal("w", low=-1, high=1), hg.Signal("k", nominal=0), (hg.Signal("y"),)
    for extra, along in ((k * sp.log(u), None), (sp.sqrt(x2) / x1 - 1, {"x2": x1**2})):
        flow = [extra - x1 + (w if along is None else 0), -2 * x2]
        signals = {"states": (x1, x2), "inputs": (u, w), "outputs": outputs, "parameters": (k,)}
        plant = hg.System("plant", **signals, flow=flow, output=[x1])
        assert hg.observer_errors(plant, [-x1, -2 * x2], unknown=("w",), along=along).lost is not None


def test_a_parameter_may_have_the_name_of_a_function() -> None:
    """The same verdicts as under another name."""

    def of(name: str) -> dict[str, Verdict]:
        a = sp.Symbol(name, real=True)
        system = line(-e - a * sp.sin(e) + e * sp.cos(e) / 10, **{name: (1, 2)})
        return verdicts(hg.dissipation(system, e**2, mu=3, within=[1]))

    assert of("cos") == of("a")
