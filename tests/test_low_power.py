"""Low-power high-gain observers, as they are and without peaking."""

from functools import cache
from math import comb
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import low_power as oracle
from oracle.sampled import run
from plants import chain, fitzhugh_nagumo, model, two_outputs
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.estimators.core import core_numbers, nominal
from hgogen.estimators.gains import BadPoles, from_poles
from hgogen.estimators.integrators import integrators
from hgogen.program import sym
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz, hurwitz
from hgogen.run import native
from hgogen.theorem import rows

NAN = float("nan")
s = sp.Symbol("s")


def triangular(n: int = 3) -> hg.System:
    """A chain with every a_i and b_i there is: a_2 = 2, a_3 = -1/2, a_1 = 3, an offset, an input."""
    x = [hg.Signal(f"x{i}", low=-3, high=4) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    a = [2, sp.Rational(-1, 2), 1, 1][: n - 1]
    b = [sp.sin(x[0] + u) / 2, -x[1] / 4 + u, -sp.sin(x[2]) - x[1] / 3, -x[3] if n > 3 else 0][:n]
    flow = [g * z + r for g, z, r in zip(a, x[1:], b, strict=False)] + [b[n - 1] - x[0]]
    return hg.System(f"triangular{n}", states=x, inputs=(u,), outputs=(y,), flow=flow, output=[3 * x[0] + u])


PLANTS = {"hyperjerk": lambda: model("hyperjerk"), "pendulum": lambda: model("pendulum"), "triangular": triangular}


@cache
def form(name: str) -> hg.Form:
    return hg.forms.triangular(PLANTS[name]() if name in PLANTS else chain(int(name)))


def build(kind: str, name: str = "hyperjerk", **changes: Any) -> hg.Observer:
    return getattr(hg.observers, kind)(form(name), **{"theta": 10, **changes})


def core(observer: hg.Observer) -> np.ndarray:
    return core_numbers(observer.parts[0], 1, nominal(observer))


# --- the linear error core ----------------------------------------------------------------------------------


def exactly(k: list[tuple[Any, Any]]) -> sp.Matrix:
    """The core at theta = 1, in (p, q), from the paper's equations, in rationals."""
    m = len(k)
    M = sp.zeros(2 * m, 2 * m)
    for i, (first, second) in enumerate(k):
        e = sp.zeros(1, 2 * m)
        e[i] = -1
        if i:
            e[m + i - 1] = 1
        M[i, :] += first * e
        M[i, m + i] += 1
        M[m + i, :] += second * e
        if i + 1 < m:
            M[m + i, m + i + 1] += 1
    return M


@pytest.mark.parametrize("n", range(2, 11))
def test_the_default_gains_put_every_pole_at_minus_1(n: int) -> None:
    """Exact: (s + 1)^(2n - 2) by the characteristic polynomial in rationals; and the observer has that core."""
    k = [(sp.Integer(2), sp.Rational(n - i, i)) for i in range(1, n)]
    polynomial = exactly(k).charpoly(s).all_coeffs()
    assert polynomial == [comb(2 * n - 2, j) for j in range(2 * n - 1)]
    matrix = core(build("low_power", str(n), theta=1))
    assert matrix == pytest.approx(np.array(exactly(k), dtype=float), rel=1e-15)
    assert hurwitz(matrix)


pairs_of_poles = st.tuples(st.floats(0.2, 4.0), st.floats(-3.0, 3.0))


@pytest.mark.full
@given(st.lists(pairs_of_poles, min_size=1, max_size=5), st.floats(1.0, 50.0))
@settings(deadline=None, max_examples=15)
def test_the_core_has_the_poles_it_was_given(pairs: list[tuple[float, float]], theta: float) -> None:
    """Pairs of conjugate or, where the second number is negative, of real poles: by the characteristic polynomial, as
    eigenvalues that meet are badly conditioned and its coefficients are not."""
    poles = [p for x, y in pairs for p in ((complex(-x, y), complex(-x, -y)) if y > 0 else (-x, -x + y))]
    n = len(pairs) + 1
    k = from_poles(poles, n)
    assert (k > 0).all()
    observer = build("low_power", str(n), theta=theta, poles=poles)
    expected = np.poly(theta * np.array(poles)).real
    exact = sp.Matrix(core(observer).tolist()).applyfunc(sp.Rational).charpoly(s).all_coeffs()
    assert np.array(exact, dtype=float) == pytest.approx(expected, rel=1e-9)


@pytest.mark.full
def test_pole_placement_by_hand() -> None:
    """n = 2: s (s + k_1) + k_2. n = 3, poles at -1, -2, -3, -4: (D - 24)/s = s^3 + 10 s^2 + 35 s + 50 has the real root
    -5, the quotient s^2 + 5 s + 10: k = ((5, 10), (5, 24/10)). All at -1: the default."""
    assert from_poles((-1, -2), 2) == pytest.approx(np.array([[3, 2]]), rel=1e-14)
    assert from_poles((-1, -2, -3, -4), 3) == pytest.approx(np.array([[5, 10], [5, 2.4]]), rel=1e-13)
    for n in range(2, 9):
        default = [(2, (n - i) / i) for i in range(1, n)]
        assert from_poles([-1] * (2 * n - 2), n) == pytest.approx(np.array(default), rel=1e-12)


@pytest.mark.parametrize("n", range(2, 5))
def test_the_peaking_free_core_is_the_low_power_one_beside_a_filter(n: int) -> None:
    """Unsaturated: the low-power polynomial times s + theta alpha_n."""
    low, free = build("low_power", str(n), theta=3), build("peaking_free", str(n), theta=3, last=2.0)
    expected = np.polymul(np.poly(core(low)), [1, 6.0])
    assert np.poly(core(free)) == pytest.approx(expected, rel=1e-8)


# --- known answers ------------------------------------------------------------------------------------------


def wide(span: float, second: float = 10) -> hg.Form:
    """The hyperjerk system with wide ranges, so that nothing is saturated but what the observer itself does."""
    ends = (max(span, 10), max(span, second), span, span)
    x = [hg.Signal(f"x{i}", low=-end, high=end) for i, end in enumerate(ends, 1)]
    flow = [x[1], x[2], x[3], -x[3] - 5.2 * x[2] - 2.7 * x[1] + 4.5 * (x[0] ** 2 - 1)]
    return hg.forms.triangular(hg.System("wide", states=x, outputs=[hg.Signal("y")], flow=flow, output=[x[0]]))


@cache
def orbit(dt: float, duration: float) -> np.ndarray:
    def rate(t: float, x: np.ndarray) -> list[float]:
        return [x[1], x[2], x[3], -x[3] - 5.2 * x[2] - 2.7 * x[1] + 4.5 * (x[0] ** 2 - 1)]

    t = np.arange(round(duration / dt) + 1) * dt
    return solve_ivp(rate, (0, t[-1]), [-0.9, 0, 0, 0], method="DOP853", t_eval=t, rtol=1e-12, atol=1e-12).y.T


def test_the_peaks_of_both_observers() -> None:
    """n = 4, l = 50, xhat_1 off by 10, the rest at the truth: the error of x4 peaks at 55,128.29, by a plain
    integration with a tenth of the step. Others, without their start and levels, tell of 55,098, .05% less, as of a
    peak that is read off a solver's steps, and of 4.5 without peaking, where 5% are left to the levels."""
    x, off = orbit(1e-4, 0.4), {"x1": 9.1, "x2": 0, "x3": 0, "x4": 0}
    peaks = []
    for kind, span in (("low_power", 1e6), ("peaking_free", 5.0)):
        step = hg.sample(getattr(hg.observers, kind)(wide(span), theta=50, initial=off), hg.methods.rk4, dt=1e-4)
        result = step.run(y=x[:, 0])
        peaks.append(np.abs(result.x - x)[:, 3].max())
    assert peaks[0] == pytest.approx(55128.29, rel=1e-6)
    assert peaks[0] == pytest.approx(55098, rel=1e-3)
    assert peaks[1] == pytest.approx(4.5, rel=0.05)


@pytest.mark.parametrize(("second", "expected"), [(5, 4.497), (10, 4.509)])
def test_the_peak_without_peaking_to_its_digits(second: float, expected: float) -> None:
    """4.5, as others tell: with x2, x3, x4 saturated at 5, and the same where x2 is at 10; a tenth of the step moves it
    by less than 1e-5."""
    x, off = orbit(1e-4, 0.4), {"x1": 9.1, "x2": 0, "x3": 0, "x4": 0}
    observer = hg.observers.peaking_free(wide(5.0, second), theta=50, initial=off)
    result = hg.sample(observer, hg.methods.rk4, dt=1e-4).run(y=x[:, 0])
    assert np.abs(result.x - x)[:, 3].max() == pytest.approx(expected, abs=5e-4)


@pytest.mark.full
def test_the_peak_does_not_grow_with_theta() -> None:
    """It keeps to the range; against the low-power observer, whose error of x4 grows like theta^3."""
    x, off = orbit(1e-4, 0.4), {"x1": 9.1, "x2": 0, "x3": 0, "x4": 0}
    peaks = {}
    for kind in ("low_power", "peaking_free"):
        for theta in (25, 50, 100):
            step = hg.sample(getattr(hg.observers, kind)(wide(5.0), theta=theta, initial=off), hg.methods.rk4, dt=1e-4)
            peaks[kind, theta] = np.abs(step.run(y=x[:, 0]).x - x)[:, 3].max()
    assert peaks["low_power", 50] > 7 * peaks["low_power", 25]
    assert max(peaks["peaking_free", theta] for theta in (25, 50, 100)) < 5


# --- convergence, and agreement with the oracle -------------------------------------------------------------


def terms(name: str) -> tuple[Any, np.ndarray, np.ndarray, Any]:
    """c of the coordinates w, the ranges of w (n), and w from x, by hand."""
    if name == "hyperjerk":
        low, high = np.array([-3.0, -4, -6, -12]), np.array([3.0, 4, 6, 12])

        def c(w: np.ndarray, u: np.ndarray) -> np.ndarray:
            x = np.clip(w, low, high)
            return np.array([0, 0, 0, -x[3] - 5.2 * x[2] - 2.7 * x[1] + 4.5 * (x[0] ** 2 - 1)])

        return c, low, high, np.ones(4)
    # z = (x1, x2, -x3), as a_3 = -1/2: w = (3 z1, 6 z2, 3 z3)
    scale = np.array([3.0, 6, -3])
    low, high = np.array([-9.0, -18, -12]), np.array([12.0, 24, 9])

    def general(w: np.ndarray, u: np.ndarray) -> np.ndarray:
        x = np.clip(w, low, high) / scale
        return scale * [np.sin(x[0] + u[0]) / 2, -x[1] / 4 + u[0], -np.sin(x[2]) - x[1] / 3 - x[0]]

    return general, low, high, scale


@pytest.mark.ordinary("hyperjerk-low_power", "triangular-peaking_free")
@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
@pytest.mark.parametrize("name", ["hyperjerk", "triangular"])
def test_the_step_is_the_oracles(kind: str, name: str) -> None:
    """Far off, so that every saturation acts, through missing samples: rounding only, some theta^3 eps."""
    c, low, high, scale = terms(name)
    n, dt, theta = len(scale), 2e-3, 6.0
    k = np.array([(3.0, 2.5), (2.0, 1.1), (1.5, 0.3)])[: n - 1]
    start = np.array([2.5, -3, 3, -4])[:n]
    rng = np.random.default_rng(3)
    y = (2 if name == "hyperjerk" else 12) * np.sin(np.arange(600) * dt * 3)[:, None] + 0.1 * rng.normal(size=(600, 1))
    u = np.cos(np.arange(600) * dt)[:, None] if name == "triangular" else np.zeros((600, 0))
    y[[100, 101, 300], 0] = NAN
    options = {"theta": theta, "gains": k, "initial": tuple(start)}
    if kind == "peaking_free":
        options["last"] = 1.5
    step = hg.sample(build(kind, name, **options), hg.methods.rk4, dt=dt)
    result = step.run(y=y[:, 0], **({"u": u[:, 0]} if u.shape[1] else {}), engine="python")
    w = scale * start
    if kind == "low_power":
        first = np.array([(w[i], w[i + 1]) for i in range(n - 1)]).reshape(-1)
        rate = oracle.low_power(k, theta, c)
    else:
        first = np.concatenate([w, w[1:]])
        rate = oracle.peaking_free(k, 1.5, theta, c, low, high)
    states = run(lambda state, y_, valid, u_: rate(state, y_ - u_.sum(), valid, u_), first, y, dt, u)  # o(u) = u
    if kind == "low_power":
        states = np.column_stack([states[:, 0], states[:, 1::2]])
    expected = states[:, :n]
    assert not any("LIMITED" in flag for status in set(result.status.tolist()) for flag in step.flags(status))
    assert result.x == pytest.approx(expected / scale, abs=1e-9)
    assert np.abs(expected / scale).max() > 4


@pytest.mark.full
@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=3)
def test_it_converges_from_anywhere_in_the_box(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = orbit(1e-3, 4.0)
    initial = tuple(rng.uniform(-1, 1, size=4) * [3, 4, 6, 12])
    step = hg.sample(build(kind, theta=20, initial=initial), hg.methods.rk4, dt=1e-3)
    error = np.abs(step.run(y=x[:, 0]).x - x)
    assert error[-1].max() < 1e-5


@pytest.mark.ordinary("low_power-float", "low_power-double", "peaking_free-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
def test_the_c_is_the_program(kind: str, real: Any) -> None:
    step = hg.sample(build(kind, "triangular"), hg.methods.rk4, dt=0.01)
    assert "64 samples as recorded" in native.run_check(hg.targets.c99(step, real=real))


# --- what is said, and what is refused ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
def test_the_theorem_says_what_is_known(kind: str) -> None:
    observer = build(kind)
    standings = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert standings["the linear error core is Hurwitz"] == "proved"
    assert standings["b is Lipschitz in the state, uniformly in the input"] == "proved"
    assert "left to you" in standings.values()


@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"theta": 0}, BadGain, r"theta = 0 must be a positive finite number"),
        ({"gains": [(1, 1)]}, BadGain, r"gains of shape \(1, 2\) must be 3 pairs \(k_i1, k_i2\)"),
        ({"gains": [(1, 1, 1)] * 3}, BadGain, r"gains of shape \(3, 3\) must be 3 pairs"),
        ({"gains": [(1, NAN)] * 3}, BadGain, r"gains = .* must be finite"),
        ({"gains": [(1, 1)] * 3, "poles": [-1] * 6}, BadGain, "takes gains or poles, not both; leave one out"),
        ({"gains": [(0.1, 3), (0.1, 3), (0.1, 3)]}, NotHurwitz, "gains: the linear error core has the eigenvalues"),
        ({"poles": [-1] * 4}, BadPoles, "there are 4, 4 states have 6 in low power"),
        ({"poles": -1}, BadPoles, "there are 1, 4 states have 6 in low power"),
        ({"poles": [-1] * 5 + [1]}, BadPoles, "is not in the open left half plane"),
        ({"poles": [-1] * 5 + [-1 + 1j]}, BadPoles, "complex poles must come in conjugate pairs"),
    ],
)
def test_bad_gains(kind: str, changes: dict[str, Any], error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        build(kind, **changes)


def test_only_a_saturated_observer_wants_positive_gains() -> None:
    for gains in ([(2, -3), (2, 1), (2, 1 / 3)], [(0, 3), (2, 1), (2, 1 / 3)]):
        with pytest.raises(BadGain, match="must all be positive: a pair behind a saturation decays by itself"):
            build("peaking_free", gains=gains)
    for last in (0, -1.0, NAN):
        with pytest.raises(BadGain, match=f"last = {last!r} must be a positive finite number"):
            build("peaking_free", last=last)


@pytest.mark.parametrize(("kind", "more"), [("low_power", {}), ("high_gain", {"poles": (-1, -1)})])
def test_a_form_whose_gain_is_zero_as_declared_is_met_at_the_door(kind: str, more: dict[str, Any]) -> None:
    """The observer would divide by it; by one that is 0 elsewhere in its range only, who accepts that may."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)

    def observer(nominal: float) -> hg.Observer:
        p = hg.Signal("p", nominal=nominal, low=-1, high=1)
        data = {"states": (x1, x2), "outputs": (hg.Signal("y"),), "parameters": (p,)}
        form = hg.forms.triangular(hg.System("still", **data, flow=[p * x2, -x2], output=[x1]))
        return getattr(hg.observers, kind)(form, theta=2, accept=("triangular.a_2",), **more)

    with pytest.raises(BadGain, match=r"^a_2 = p is 0 at the nominal parameters, and the observer divides by it"):
        observer(0.0)
    assert observer(0.5).name == kind


@pytest.mark.parametrize("kind", ["low_power", "peaking_free"])
def test_forms_it_does_not_take(kind: str) -> None:
    observer = getattr(hg.observers, kind)
    with pytest.raises(BadGain, match="wants at least two states, chain1 has 1; use high_gain"):
        build(kind, "1")
    with pytest.raises(BadGain, match="takes one output, two has 2; use riccati"):
        observer(hg.forms.original(two_outputs()), theta=2)
    with pytest.raises(BadGain, match=r"a_2 = -u depends on the input"):
        observer(fitzhugh_nagumo().form, theta=2, accept="triangular.a_2")


@pytest.mark.parametrize("nominal", [-1.0, 0.5])
def test_a_range_turns_with_the_sign_of_its_scale(nominal: float) -> None:
    """w_2 = a x2, x2 in [-1, 3], a of a sign that is not shown."""
    x = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=3)
    a = hg.Signal("a", "", "", nominal, low=-2, high=1)
    data = {"states": x, "parameters": (a,), "outputs": [hg.Signal("y")], "output": [x[0]]}
    either = hg.forms.triangular(hg.System("either", **data, flow=[a * x[1], -x[0]]))
    held, place = integrators("peaking_free", either), sym("plant", "a")
    ends = ca.Function("sat", [place], [ca.vertcat(*(held.saturated(ca.SX(end), 1) for end in (-9, 9)))])(nominal)
    assert np.array(ends).reshape(-1) == pytest.approx(sorted((-nominal, 3 * nominal)))


def test_a_saturation_wants_a_range() -> None:
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2")
    plant = hg.System("loose", states=(x1, x2), outputs=[hg.Signal("y")], flow=[x2, -sp.sin(x1)], output=[x1])
    loose = hg.forms.triangular(plant)
    hg.observers.low_power(loose, theta=2)
    with pytest.raises(
        BadGain, match="peaking_free saturates the estimate of x2 which has no range; declare low and high"
    ):
        hg.observers.peaking_free(loose, theta=2)
