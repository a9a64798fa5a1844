"""The certified bound on theta: by hand, against eigenvalues in floats, and in simulation."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import chain, fitzhugh_nagumo, model, pendulum, van_der_pol
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.chains.gains import coefficients
from hgogen.check import Check, Verdict
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.certified import ThetaBound, of_gains, of_poles
from hgogen.guarantees.lmi import Lyapunov
from hgogen.intervals.digits import down, same, up
from tests.sweep import sweep


def bound(plant: hg.System, poles: tuple[complex, ...]) -> ThetaBound:
    theta_bound = of_poles(hg.forms.triangular(plant), coefficients(poles, len(plant.states)))
    assert isinstance(theta_bound, ThetaBound), theta_bound
    return theta_bound


def plant(flow: Any, x: Any, inputs: Any = (), parameters: Any = (), output: Any = None) -> hg.System:
    data = {"states": x, "inputs": inputs, "parameters": parameters, "outputs": (hg.Signal("y"),)}
    return hg.System("plant", **data, flow=flow, output=[x[0] if output is None else output])


def states(n: int, size: float = 4.0) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=-size, high=size) for i in range(1, n + 1)]


def theta_check(observer: hg.Observer) -> Check:
    return next(check for check in observer.checks if check.id == "high_gain.theta")


# --- by hand ------------------------------------------------------------------------------------------------


def test_one_state_by_hand() -> None:
    """x' = -sin x - x + u: P = 1/(2 p), L_b = 2, so theta > 2/p; the bound is never below 1."""
    for p, expected in ((1.0, 2.0), (0.25, 8.0), (4.0, 1.0)):
        assert float(bound(chain(1), (-p,)).theta) == pytest.approx(expected, rel=1e-2)
        assert bound(chain(1), (-p,)).theta >= expected


def test_a_theta_at_its_bound_is_not_above_it() -> None:
    """A chain of integrators alone has L_b = 0 and the bound 1."""
    x = states(2)
    form = hg.forms.triangular(plant([x[1], 0], x))
    for theta, verdict in ((1, Verdict.UNKNOWN), (1.001, Verdict.PROVED)):
        assert theta_check(hg.observers.high_gain(form, theta=theta, poles=(-1, -1))).verdict is verdict


def test_a_row_that_reads_too_much_has_no_bound() -> None:
    x = states(2)
    form = hg.forms.triangular(plant([x[1], -x[0]], x))
    z1, z2 = form.states
    assert isinstance(of_poles(form, (2, 1)), ThetaBound)
    theta_bound = of_poles(replace(form, b=(sp.sin(z2), -z1)), (2, 1))
    assert isinstance(theta_bound, Nothing)
    assert str(theta_bound.reason) == f"b_1 = sin({z2}) reads more than z_1..z_1"


def test_the_rate_by_hand() -> None:
    """e' = -p theta e + ..|e| L: the error of one state decays like exp(-(p theta - L) t), and of P nothing is left."""
    for p, theta in ((1.0, 5.0), (0.25, 20.0)):
        theta_bound = bound(chain(1), (-p,))
        assert theta_bound.rate(theta) == pytest.approx(p * theta - 2, rel=1e-2)
        assert theta_bound.rate(theta) <= p * theta - 2


def test_the_core_of_several_outputs_has_the_gains_of_each() -> None:
    """Chains of one and of two states: -5, and [[-2, 1], [-1, 0]]."""
    x = states(3)
    data = {"states": x, "outputs": (hg.Signal("y1"), hg.Signal("y2")), "output": [x[0], x[1]]}
    form = hg.forms.block_triangular(hg.System("two", **data, flow=[-x[0], x[2], -x[1]]), "top")
    theta_bound = of_gains(form, (5, 2, 1))
    assert isinstance(theta_bound, ThetaBound), theta_bound
    assert theta_bound.lyapunov.vertices == (((-5, 0, 0), (0, -2, 1), (0, -1, 0)),)


def test_two_states_by_hand() -> None:
    """x1' = x2, x2' = -3 x1: L_b = 3 d, the core [[-2, 1/d], [-d, 0]] in (x1, d x2); the best d, by a fine search."""
    x1, x2 = states(2)
    theta_bound = bound(plant([x2, -3 * x1], (x1, x2)), (-1, -1))

    def value(d: float) -> float:
        N = np.array([[-2, 1 / d], [-d, 0]])
        P = np.linalg.solve(np.kron(N.T, np.eye(2)) + np.kron(np.eye(2), N.T), -np.eye(2).ravel()).reshape(2, 2)
        return float(2 * np.linalg.eigvalsh(P).max() * 3 * d)

    assert value(1.0) == pytest.approx(6 * (1 + 0.5**0.5), rel=1e-12)
    best = min(value(d) for d in np.linspace(0.05, 2, 400))
    assert best * (1 - 1e-3) <= float(theta_bound.theta) <= 1.1 * best


def test_a_linear_b_of_zero_needs_no_more_than_1() -> None:
    x1, x2 = states(2)
    assert bound(plant([x2, 0], (x1, x2)), (-1, -2)).theta == 1


def test_the_gains_of_parameters_cancel() -> None:
    """x1' = a x2, x2' = -x1/a: in (x1, a x2) the parameter disappears, whatever its range."""
    x1, x2 = states(2)
    for low, high in ((0.5, 2.0), (1e-3, 1e3)):
        a = hg.Signal("a", "", "", 1.0, low=low, high=high)
        theta_bound = bound(plant([a * x2, -x1 / a], (x1, x2), parameters=(a,)), (-1, -2))
        assert float(theta_bound.lipschitz) == pytest.approx(
            float(bound(plant([x2, -x1], (x1, x2)), (-1, -2)).lipschitz)
        )


# --- against eigenvalues ------------------------------------------------------------------------------------

PLANTS = {
    "pendulum": (model("pendulum"), (-1, -1)),
    "van_der_pol": (van_der_pol(), (-1, -2)),
    "chain3": (chain(3), (-1, -1, -1)),
    "chain6": (chain(6), (-1, -1 + 1j, -1 - 1j, -2, -2, -3)),
    "chain8": (chain(8), (-1,) * 8),
}


@pytest.mark.parametrize("name", PLANTS)
def test_the_lyapunov_function_decays_above_the_bound(name: str) -> None:
    """theta (N'P + P N) + P E + E'P < 0, E = Delta S J S^-1 Delta^-1, at points of the box and for theta above the
    bound; and the search for S has not made the bound worse than S = I."""
    plant, poles = PLANTS[name]
    form, n = hg.forms.triangular(plant), len(plant.states)
    theta_bound = bound(plant, poles)
    P = np.array([[float(x) for x in row] for row in theta_bound.lyapunov.P])
    S = np.array([float(s) for s in theta_bound.scale])
    N = np.diag(np.ones(n - 1), 1)
    N[:, 0] -= coefficients(poles, n)
    N = S[:, None] * N / S
    free = (*form.states, *plant.inputs)
    b = sp.Matrix([sp.sympify(row).subs(plant.nominal) for row in form.b])
    slope = sp.lambdify(free, b.jacobian(sp.Matrix(form.states)), "numpy")
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(300):
        J = np.array(slope(*(rng.uniform(*s.interval) for s in free)), dtype=float)
        worst = max(worst, np.linalg.norm(S[:, None] * J / S, 2))
        for theta in (float(theta_bound.theta) * 1.0001, float(theta_bound.theta) * 3):
            Delta = theta ** -np.arange(n) * S
            E = Delta[:, None] * J / Delta
            assert np.linalg.eigvalsh(theta * (N.T @ P + P @ N) + P @ E + E.T @ P).max() < 0
    assert worst <= theta_bound.lipschitz <= 1.5 * worst


def test_the_search_finds_a_smaller_bound() -> None:
    """The pendulum: 66.9 = 2 (1 + sqrt(1/2)) 19.6 without scaling."""
    plain = 2 * (1 + 0.5**0.5) * np.hypot(19.6, 0.1)
    assert float(bound(model("pendulum"), (-1, -1)).theta) < 0.7 * plain


# --- in simulation ------------------------------------------------------------------------------------------


@sweep(2, 10, st.integers(1, 4), st.integers(0, 2**32 - 1), st.booleans())
def test_the_error_decays_as_proved(n: int, seed: int, driven: bool) -> None:
    """Random triangular systems of bounded slopes, from anywhere in the box: V(t) <= exp(-2 r t) V(0)."""
    rng = np.random.default_rng(seed)
    x, u = states(n, 1e3), hg.Signal("u", low=-1, high=1)
    c = np.round(rng.uniform(-2, 2, size=(n, n)), 2)
    w = np.round(rng.uniform(-2, 2, size=(n, n)), 2)
    row = [sum(float(c[i, j]) * sp.sin(float(w[i, j]) * x[j] + u) for j in range(i + 1)) for i in range(n)]
    flow = [row[i] + (x[i + 1] if i + 1 < n else 0) for i in range(n)]
    poles = tuple(-rng.uniform(0.5, 2, size=n))
    theta_bound = bound(plant(flow, x, inputs=(u,)), poles)
    theta = float(theta_bound.theta) * (1.001 if driven else 2)
    K = coefficients(poles, n) * theta ** np.arange(1, n + 1)

    def both(t: float, state: np.ndarray) -> np.ndarray:
        truth, z, force = state[:n], state[n:], np.sin(t)
        result = []
        for value in (truth, z):
            terms = np.tril(c * np.sin(w * np.clip(value, -1e3, 1e3) + force)).sum(axis=1)
            result.append(terms + np.append(value[1:], 0))
        return np.concatenate([result[0], result[1] + K * (truth[0] - z[0])])

    start = rng.uniform(-100, 100, size=2 * n)
    t = np.linspace(0, 5 / theta, 40)
    run = solve_ivp(both, (0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-10, atol=1e-10)
    assert np.abs(run.y[:n]).max() < 1e3
    S = np.array([float(s) for s in theta_bound.scale]) * theta ** -np.arange(n)
    P = np.array([[float(v) for v in r] for r in theta_bound.lyapunov.P])
    e = S[:, None] * (run.y[n:] - run.y[:n])
    V = np.einsum("it,ij,jt->t", e, P, e)
    assert (np.exp(-2 * theta_bound.rate(theta) * t) * V[0] * (1 + 1e-5) + 1e-8 * V[0] >= V).all()


# --- verdicts -----------------------------------------------------------------------------------------------


def test_theta_above_the_bound_is_proved_and_below_it_unknown() -> None:
    top = float(bound(model("pendulum"), (-1, -1)).theta)
    low, high = theta_check(pendulum(theta=top * 0.999)), theta_check(pendulum(theta=top * 1.001))
    assert (low.verdict, high.verdict) == (Verdict.UNKNOWN, Verdict.PROVED)
    assert f"not shown: {same(top * 0.999)} is below the certified 44.3" in str(low.reason)
    assert "sufficient, not necessary" in str(low.reason)
    assert "decays at least like exp(-" in str(high.reason)
    assert str(high.reason).endswith("while the estimate keeps to its outer box")
    assert {c.id: c.verdict for c in pendulum().checks}["high_gain.convergence"] is Verdict.PROVED


@pytest.mark.parametrize("more", [1e-4, 1e-6, 1e-9, 1e-12])
def test_the_bound_that_is_said_is_below_a_theta_that_is_above_it(more: float) -> None:
    """However near; the rate as well is said to the safe side."""
    known = bound(model("pendulum"), (-1, -1))
    theta = float(known.theta) * (1 + more)
    check = theta_check(pendulum(theta=theta))
    said = Fraction(str(check.reason.part("bound")))
    assert check.verdict is Verdict.PROVED
    assert known.theta <= said < Fraction(same(theta))
    assert check.claim == f"theta = {same(theta)} is above that bound"
    assert Fraction(known.rate(theta)) <= (Fraction(theta) - known.theta) / (2 * known.lyapunov.peak)


def test_a_rate_is_rounded_down() -> None:
    """1.3 less a little is no 1.3, which is what the nearest float would print."""
    little, peak = Fraction(1, 10**30), Fraction(1)
    solution = Lyapunov(((Fraction(1),),), peak, (((Fraction(-1),),),))
    steep = bound(model("pendulum"), (-1, -1)).slope
    one = ThetaBound(2 * peak * little, solution, little + Fraction(1, 5), (sp.S.One,), steep, (sp.S.One,))
    exactly = (Fraction(3) - 2 * one.lipschitz) / 2
    assert exactly < Fraction(13, 10) < Fraction(float(exactly))
    assert Fraction(one.rate(3.0)) <= exactly
    assert down(one.rate(3.0), 2) == "1.2"


@pytest.mark.parametrize(
    ("flow", "why"),
    [
        (lambda x1, x2, u: [x2, sp.sqrt(x1 + 4)], "rests on triangular.lipschitz"),
        (lambda x1, x2, u: [x2, -sp.Abs(x2) * sp.sign(x1)], "rests on triangular.lipschitz"),
        (lambda x1, x2, u: [u * x2, -x1], "rests on triangular.a_2"),
        (lambda x1, x2, u: [(u + 2) * x2, -x1], "a_2 = u + 2 varies with the input"),
    ],
)
def test_no_bound_without_its_hypotheses(flow: Any, why: str) -> None:
    x1, x2 = states(2)
    u = hg.Signal("u", low=-1, high=1)
    theta_bound = of_poles(hg.forms.triangular(plant(flow(x1, x2, u), (x1, x2), inputs=(u,))), (2, 1))
    assert isinstance(theta_bound, Nothing)
    assert why in str(theta_bound.reason)


def test_no_bound_where_b_is_not_bounded_or_the_form_is_another() -> None:
    x1, x2 = hg.Signal("x1"), hg.Signal("x2")
    theta_bound = of_poles(hg.forms.triangular(plant([x2, -(x1**3)], (x1, x2))), (2, 1))
    assert isinstance(theta_bound, Nothing)
    assert isinstance(of_poles(hg.forms.original(van_der_pol()), (2, 1)), Nothing)
    assert isinstance(of_poles(fitzhugh_nagumo().form, (3, 3, 1)), Nothing)


def test_no_bound_for_an_observer_in_other_coordinates() -> None:
    """A form that carries the Jacobian of a map acts through its inverse, which the proof does not know."""
    form = hg.forms.triangular(van_der_pol())
    assert isinstance(of_poles(form, (2, 1)), ThetaBound)
    theta_bound = of_poles(replace(form, jacobian=sp.ImmutableDenseMatrix(sp.eye(2))), (2, 1))
    assert isinstance(theta_bound, Nothing)
    assert "stays in the plant's" in str(theta_bound.reason)


def test_no_bound_for_poles_that_are_not_stable() -> None:
    theta_bound = of_poles(hg.forms.triangular(van_der_pol()), (2, -1))
    assert isinstance(theta_bound, Nothing)
    assert "no P" in str(theta_bound.reason)


def test_many_states_are_left_alone() -> None:
    theta_bound = of_poles(hg.forms.triangular(chain(14)), np.poly([-1] * 14)[1:])
    assert isinstance(theta_bound, Nothing)
    assert "up to 12 states" in str(theta_bound.reason)


@settings(max_examples=200)
@given(st.fractions(min_value=Fraction(1, 10**6), max_value=10**9))
def test_a_bound_is_printed_upwards(value: Fraction) -> None:
    assert value <= Fraction(up(value)) <= value * Fraction(1002, 1000)


# --- a_i in a range -----------------------------------------------------------------------------------------


def test_a_constant_gain_serves_an_input_driven_chain() -> None:
    """a_1, a_2 between 1 and 3/2: one P for the four vertices, against random a_i in floats."""
    pytest.importorskip("cvxpy")
    pytest.importorskip("clarabel")
    x1, x2 = states(2)
    u = hg.Signal("u", low=0, high=1)
    form = hg.forms.triangular(
        plant([(1 + u / 2) * x2, -sp.sin(x1)], (x1, x2), inputs=(u,), output=(1 + u**2 / 2) * x1)
    )
    K = hg.design.constant_gain(form, largest=20.0)
    assert not isinstance(K, Nothing)
    theta_bound = of_gains(form, K)
    assert isinstance(theta_bound, ThetaBound), theta_bound
    assert len(theta_bound.lyapunov.vertices) == 4
    P = np.array([[float(v) for v in r] for r in theta_bound.lyapunov.P])
    rng = np.random.default_rng(3)
    for a1, a2 in rng.uniform(1, 1.5, size=(200, 2)):
        N = np.array([[-K[0] * a1, a2], [-K[1] * a1, 0]])
        assert np.linalg.eigvalsh(N.T @ P + P @ N).max() <= -1 + 1e-6
    assert float(theta_bound.lipschitz) == pytest.approx(1, rel=1e-2)
    assert float(theta_bound.theta) == pytest.approx(max(1, 2 * np.linalg.eigvalsh(P).max()), rel=1e-2)


def test_too_many_vertices_are_left_alone() -> None:
    x, u = states(10), hg.Signal("u", low=0, high=1)
    form = hg.forms.triangular(plant([*((1 + u) * s for s in x[1:]), 0], x, inputs=(u,)))
    theta_bound = of_gains(form, (1.0,) * 10)
    assert isinstance(theta_bound, Nothing)
    assert "more than 8 of the a_i vary" in str(theta_bound.reason)


def test_gains_on_a_constant_chain_are_those_of_the_poles() -> None:
    form = hg.forms.triangular(chain(2))
    theta_bound, poles = of_gains(form, (2, 1)), of_poles(form, (2, 1))
    assert isinstance(theta_bound, ThetaBound)
    assert isinstance(poles, ThetaBound)
    assert float(theta_bound.lyapunov.peak) == pytest.approx(1 + 0.5**0.5, rel=1e-6)
    assert poles.theta <= theta_bound.theta


@pytest.mark.parametrize("name", ["cos", "exp"])
def test_a_signal_may_have_the_name_of_a_function(name: str) -> None:
    """The bound on theta is that of the same plant with another name."""

    def bound(b: str) -> str:
        q, w = hg.Signal("q", low=-4, high=4), hg.Signal("w", low=-20, high=20)
        k = hg.Signal(b, nominal=1.5, low=1, high=2)
        flow = [w, -k * sp.sin(q) + sp.exp(-k) * sp.Abs(q)]
        plant = hg.System("pendulum", states=(q, w), outputs=(hg.Signal("y"),), parameters=(k,), flow=flow, output=[q])
        observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1, -1))
        return str(next(check.reason for check in observer.checks if check.id == "high_gain.convergence"))

    assert bound(name) == bound("k")
