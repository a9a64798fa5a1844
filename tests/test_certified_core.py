"""The certified bound on theta of estimators with a linear core of their own."""

import sys
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
import sympy as sp
from plants import chain, model
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.chains.core import core_numbers
from hgogen.chains.integrators import integrators
from hgogen.check import Verdict
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.certified import of_gains
from hgogen.guarantees.certified_core import CoreBound, Layout, of_core
from hgogen.program import Place
from hgogen.theorem import rows

pytest.importorskip("cvxpy")
pytest.importorskip("clarabel")


@cache
def form(name: str) -> hg.Form:
    if name != "mixed":
        return hg.forms.triangular(model(name) if name in ("pendulum", "hyperjerk") else chain(int(name)))
    x, u = [hg.Signal(f"x{i}", low=-3, high=4) for i in (1, 2, 3)], hg.Signal("u", low=-1, high=1)
    flow = [2 * x[1] + sp.sin(x[0] + u) / 2, x[2] / 2 - x[1] / 4 + u, -sp.sin(x[2]) - x[1] / 3 - x[0]]
    data = {"states": x, "inputs": (u,), "outputs": (hg.Signal("y"),), "output": [3 * x[0] + u]}
    return hg.forms.triangular(hg.System("mixed", **data, flow=flow))


def parts(kind: str, n: int) -> tuple[dict[str, Any], list[int], list[int], list[int], list[int]]:
    """Gains; of each field: the state it estimates or goes with, the power of theta in its error, whether c enters, and
    which fields the model reads."""
    low = [*range(n - 1), *range(1, n)]
    if kind == "low_power":
        return {}, low, low, [1] * len(low), [0, *range(n - 1, 2 * n - 2)]
    if kind == "peaking_free":
        index = [*range(n), *range(1, n)]
        return {}, index, index, [1] * len(index), list(range(n))
    index = [*range(n), *range(n)]
    poles = [-1] * n if n > 2 else (-1, -2)
    power = [*range(n), *range(1, n + 1)]
    return {"alpha": 3, "beta": 1, "poles": poles}, index, power, [1] * n + [0] * n, list(range(n))


KINDS = ("low_power", "peaking_free", "filtered")


def build(kind: str, name: str, theta: float) -> hg.Observer:
    gains = parts(kind, form(name).n)[0]
    return getattr(hg.observers, kind)(form(name), theta=theta, **gains)


def bound_of(kind: str, name: str) -> CoreBound:
    """As the observers find it, for its numbers."""
    gains, index, _, fed, _ = parts(kind, form(name).n)
    layout, cores = Layout(tuple(index), tuple(index), tuple(map(bool, fed)), ()), vertices(kind, name, 1.0)
    core_bound = of_core(integrators(kind, form(name)), layout, cores, {})
    assert isinstance(core_bound, CoreBound), (core_bound, gains)
    return core_bound


@cache
def vertices(kind: str, name: str, theta: float) -> list[np.ndarray]:
    """The core at theta, with every combination of saturations open and shut, from the core without."""
    n = form(name).n
    core = core_numbers(build(kind, name, theta).parts[0], 1, {Place("gain", "theta"): np.array([theta])})
    if kind != "peaking_free":
        return [core]
    corners = []
    for shares in product((1.0, 0.0), repeat=n - 1):
        cut = core.copy()
        for i, share in enumerate(shares, 1):
            entry = cut[i - 1, n + i - 1] if i < n else 0.0
            cut[:, n + i - 1] *= share
            cut[i - 1, n + i - 1] = entry  # p_i' has q_i as it is
        corners.append(cut)
    return corners


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["2", "4"])
def test_the_core_is_theta_times_a_constant_in_scaled_errors(kind: str, name: str) -> None:
    """What the proof takes for granted: every entry grows with the power of theta that the scaling takes away."""
    power = np.array(parts(kind, form(name).n)[2])
    one = vertices(kind, name, 1.0)
    for theta in (2.0, 8.0, 32.0):  # powers of two: exact
        for first, core in zip(one, vertices(kind, name, theta), strict=True):
            assert np.array_equal(core * theta ** (power[None, :] - power[:, None]), theta * first)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["pendulum", "mixed", "3"])
def test_the_lyapunov_function_decays_above_the_bound(kind: str, name: str) -> None:
    """e'P e falls by the error's matrix at points of the box, clamps and saturations at random shares."""
    plant = form(name)
    n, (_, index, power, fed, read) = plant.n, parts(kind, plant.n)
    core_bound = bound_of(kind, name)
    P = np.array([[float(x) for x in row] for row in core_bound.lyapunov.P])
    scale = np.array([float(core_bound.steep.units[i]) for i in index])
    products = integrators(kind, plant).nominal
    b = sp.Matrix([sp.sympify(row).subs(plant.system.nominal) for row in plant.b])
    free = (*plant.states, *plant.system.inputs)
    slope = sp.lambdify(free, b.jacobian(sp.Matrix(plant.states)), "numpy")
    rng = np.random.default_rng(1)
    for theta in (float(core_bound.theta) * 1.0001, float(core_bound.theta) * 3):
        ends = np.array(vertices(kind, name, theta))
        D = scale * theta ** -np.array(power, dtype=float)
        for _ in range(150):
            J = products[:, None] * np.array(slope(*(rng.uniform(*s.interval) for s in free)), dtype=float) / products
            fields = np.zeros((len(index), len(index)))
            for k, i in enumerate(index):
                fields[k, read] = fed[k] * J[i] * rng.uniform(0, 1, size=n)
            share = rng.dirichlet(np.full(len(ends), 0.3))
            M = D[:, None] * (np.tensordot(share, ends, 1) + fields) / D
            assert np.linalg.eigvalsh(M.T @ P + P @ M).max() < 0


def test_a_pair_is_the_standard_observer() -> None:
    """n = 2: the low-power observer is the standard one with K = (2, 1), and so is its bound, scaled or not."""
    core_bound, standard = bound_of("low_power", "2"), of_gains(form("2"), (2, 1))
    assert float(core_bound.push) == pytest.approx(float(core_bound.lyapunov.peak), rel=1e-4)
    assert not isinstance(standard, Nothing)
    assert core_bound.theta <= standard.theta * 1.001


def test_only_what_is_fed_counts() -> None:
    """|P G| in floats: of the filtered observer the columns of w; of the low-power one p_2 and q_1 get c_2 together."""
    for kind, groups in (("filtered", [[0], [1], [2]]), ("low_power", [[0], [1, 2], [3]])):
        core_bound = bound_of(kind, "3")
        P = np.array([[float(x) for x in row] for row in core_bound.lyapunov.P])
        G = np.array([[float(k in group) for group in groups] for k in range(len(P))])
        assert float(core_bound.push) == pytest.approx(np.linalg.norm(P @ G, 2), rel=1e-4)
        assert float(core_bound.push) >= np.linalg.norm(P @ G, 2)
        theta = 2 * float(core_bound.theta)  # V' <= -(theta - 2 push L) |e|^2 with V <= lambda_max(P) |e|^2
        room = theta - 2 * float(core_bound.push) * float(core_bound.lipschitz)
        assert core_bound.rate(theta) == pytest.approx(room / (2 * np.linalg.eigvalsh(P).max()), rel=1e-3)


def test_the_error_decays_as_proved_through_saturations() -> None:
    """The peaking-free observer of the pendulum, from the far corner of the box: V(t) <= exp(-2 r t) V(0)."""
    core_bound = bound_of("peaking_free", "pendulum")
    theta = 1.5 * float(core_bound.theta)
    low, high = np.array([-4.0, -20]), np.array([4.0, 20])

    def c(w: np.ndarray) -> float:
        q, v = np.clip(w, low, high)
        return float(-19.6 * np.sin(q) - 0.1 * v)

    def both(t: float, state: np.ndarray) -> list[float]:
        x, (p1, p2, q) = state[:2], state[2:]
        e, sat, last = x[0] - p1, float(np.clip(q, -20, 20)), c(np.array([p1, p2]))
        own = [q + 2 * theta * e, last + theta * (sat - p2), last + theta**2 * e]
        return [x[1], c(x), *own]

    t = np.linspace(0, 12 / theta, 80)
    solved = solve_ivp(both, (0, t[-1]), [1, 0, -3, 20, 20], t_eval=t, rtol=1e-10, atol=1e-10, max_step=t[-1] / 2000).y
    assert np.abs(solved[4]).max() > 25
    scale = np.array([float(core_bound.steep.units[i]) for i in (0, 1, 1)]) / np.array([1, theta, theta])
    e = scale[:, None] * (solved[2:] - solved[[0, 1, 1]])
    V = np.einsum("it,ij,jt->t", e, np.array([[float(x) for x in row] for row in core_bound.lyapunov.P]), e)
    assert (np.exp(-2 * core_bound.rate(theta) * t) * V[0] * (1 + 1e-5) + 1e-8 * V[0] >= V).all()


# --- what is said -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_theta_above_the_bound_is_proved_and_below_it_unknown(kind: str) -> None:
    top = float(bound_of(kind, "pendulum").theta)
    for share, verdict in ((0.999, Verdict.UNKNOWN), (1.001, Verdict.PROVED)):
        observer = build(kind, "pendulum", top * share)
        verdicts = {check.id: check.verdict for check in observer.checks}
        assert verdicts[f"{kind}.convergence"] is Verdict.PROVED
        assert verdicts[f"{kind}.theta"] is verdict
        claims = {row.claim: row.verdict for row in rows(observer.theorem, observer.checks)}
        assert claims["theta is large enough"] is verdict


def test_no_bound_without_its_hypotheses() -> None:
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=-4, high=4)
    rough = hg.System("rough", states=(x1, x2), outputs=[hg.Signal("y")], flow=[x2, sp.sqrt(x1 + 4)], output=[x1])
    observer = hg.observers.low_power(hg.forms.triangular(rough), theta=5, accept="triangular.lipschitz")
    (claim,) = (check for check in observer.checks if check.id == "low_power.convergence")
    assert (claim.verdict, str(claim.reason)) == (
        Verdict.UNKNOWN,
        "the bound rests on triangular.lipschitz, which is not proved",
    )
    many = build("low_power", "9", 2)
    (claim,) = (check for check in many.checks if check.id == "low_power.convergence")
    assert "up to 14 fields" in str(claim.reason)
    unstable = of_core(
        integrators("low_power", form("2")),
        Layout((0, 1), (0, 1), (True, True), (0, 1)),
        [np.array([[1.0, 1], [0, 1]])],
        {},
    )
    assert isinstance(unstable, Nothing)
    assert "no P" in str(unstable.reason)


def test_without_a_solver_nothing_is_proved_and_nothing_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    x, u = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2)], hg.Signal("u", low=0, high=1)
    data = {"states": x, "inputs": (u,), "outputs": [hg.Signal("y")], "output": [x[0]]}
    driven = hg.forms.triangular(hg.System("driven", **data, flow=[(1 + u) * x[1], -sp.sin(x[0])]))
    observers = build("peaking_free", "pendulum", 100), hg.observers.high_gain(driven, theta=5, gains=(3, 1))
    for observer in observers:
        convergence = {check.id: check for check in observer.checks}[f"{observer.name}.convergence"]
        assert convergence.verdict is Verdict.UNKNOWN
        assert "install" in str(convergence.reason)
