"""Step lengths: known answers, and observers integrated to failure on both sides of the limit.

The observer is integrated here by plain Runge-Kutta on (z, X), apart from the package:
    z' = f(z, u) + P C' (theta/R) (y - z_1),   P' = F P + P F' + Q_theta - P C' (theta/R) C P,   or S = P^-1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hgogen.discretisation.explicit_covariance import NotDefinite, covariance_limits
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau
from hgogen.discretisation.stability import UnstableCore, core_limit

# --- models -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Model:
    """f and F over any leading axes of z, at points z (k, n) and u (k,) of its box; y = z_1."""

    f: Callable[[Any, Any], Any]
    F: Callable[[Any, Any], Any]
    z: np.ndarray
    u: np.ndarray
    Q: np.ndarray
    R: float = 1.0

    @property
    def n(self) -> int:
        return len(self.Q)

    def limit(self, p0: float, theta: float, tableau: Tableau, view: str, **adaptive: Any) -> Any:
        F = np.array([self.F(z, u) for z, u in zip(self.z, self.u, strict=True)])
        C, R = np.eye(1, self.n), np.array([[self.R]])
        limits = covariance_limits(F, C, self.Q, R, p0 * np.eye(self.n), theta, tableau, view, **adaptive)
        return min(limits, key=lambda limit: limit.dt)


def fitzhugh_nagumo() -> Model:
    """z1' = -u z2 + z1 - z1^3/3, z2' = .8 (z3 + 3 sin z1 - z2), z3' = 0; z1 clamped to +-2.2, |u| <= 1."""

    def f(z, u):
        x = np.clip(z[..., 0], -2.2, 2.2)
        return np.stack([-u * z[..., 1] + x - x**3 / 3, 0.8 * (z[..., 2] + 3 * np.sin(x) - z[..., 1]), 0 * x], axis=-1)

    def F(z, u):
        x = np.clip(z[..., 0], -2.2, 2.2)
        J = np.zeros((*x.shape, 3, 3))
        J[..., 0, 0], J[..., 0, 1] = 1 - x**2, -u
        J[..., 1, 0], J[..., 1, 1], J[..., 1, 2] = 2.4 * np.cos(x), -0.8, 0.8
        return J

    x, u = (a.ravel() for a in np.meshgrid(np.linspace(-2.2, 2.2, 5), np.linspace(-1, 1, 5)))
    return Model(f, F, np.stack([x, 0 * x, 0 * x], axis=-1), u, np.diag([0.1, 0.01, 2.3e-4]))


def pendulum() -> Model:
    """q' = w, w' = -19.6 sin q - .1 w; q in [-4, 4]."""

    def f(z, u):
        return np.stack([z[..., 1], -19.6 * np.sin(z[..., 0]) - 0.1 * z[..., 1]], axis=-1)

    def F(z, u):
        J = np.zeros((*z.shape, 2))
        J[..., 0, 1], J[..., 1, 0], J[..., 1, 1] = 1, -19.6 * np.cos(z[..., 0]), -0.1
        return J

    q = np.linspace(-4, 4, 9)
    return Model(f, F, np.stack([q, 0 * q], axis=-1), 0 * q, np.diag([0.1, 0.1]))


def chain() -> Model:
    """Four integrators, z4' = -sin z1 - 4 z2 - 6 z3 - 4 z4 + sin z2."""

    def f(z, u):
        a, b, c, d = np.moveaxis(z, -1, 0)
        return np.stack([b, c, d, -np.sin(a) - 4 * b - 6 * c - 4 * d + np.sin(b)], axis=-1)

    def F(z, u):
        J = np.zeros((*z.shape, 4))
        J[..., 0, 1] = J[..., 1, 2] = J[..., 2, 3] = 1
        J[..., 3, 0], J[..., 3, 1] = -np.cos(z[..., 0]), -4 + np.cos(z[..., 1])
        J[..., 3, 2], J[..., 3, 3] = -6, -4
        return J

    a, b = (v.ravel() for v in np.meshgrid([-3.0, 0.0, 3.0], [-3.0, 0.0, 3.0]))
    return Model(f, F, np.stack([a, b, 0 * a, 0 * a], axis=-1), 0 * a, np.eye(4))


# --- the observer, integrated to failure --------------------------------------------------------------------


def survives(model, tableau, view, p0, theta, dt, steps=200):
    """(k,): whether the observer of a plant that starts at each point of the box stays finite and definite.

    The observer starts at the plant's state and the input is held: nothing but the discretisation can fail.
    """
    n, k = model.n, len(model.z)
    power = theta ** np.arange(n, dtype=float)
    Q, gain = theta * model.Q * np.outer(power, power), theta / model.R
    N, C = gain * np.eye(n)[:, :1] @ np.eye(n)[:1], np.repeat(np.eye(n)[None, :, :1], k, axis=0)

    def slope(state):
        x, z, X = state
        F, u = model.F(z, model.u), model.u
        Ft = np.swapaxes(F, 1, 2)
        column = np.linalg.solve(X, C)[:, :, 0] if view == "information" else X[:, :, 0]
        dX = -Ft @ X - X @ F + N - X @ Q @ X if view == "information" else F @ X + X @ Ft + Q - X @ N @ X
        return model.f(x, u), model.f(z, u) + gain * column * (x - z)[:, :1], dX

    def combine(start, slopes, weights):
        terms = [[dt * w * part for part in k] for w, k in zip(weights, slopes, strict=True)]
        return [part + sum((term[i] for term in terms), 0 * part) for i, part in enumerate(start)]

    start = np.eye(n) * (1 / p0 if view == "information" else p0)
    state, alive = [model.z, model.z, np.repeat(start[None], k, axis=0)], np.ones(k, dtype=bool)
    with np.errstate(all="ignore"):
        for _ in range(steps):
            slopes = []
            for row in tableau.a:
                stage = combine(state, slopes, row)
                stage[2] = np.where(finite(stage[2])[:, None, None], stage[2], np.eye(n))
                slopes.append(slope(stage))
            state = combine(state, slopes, tableau.b)
            alive &= finite(state[1][:, None]) & definite(state[2])
            reset = [model.z, model.z, start[None]]  # of those that failed, so that the others go on
            state = [
                np.where(alive.reshape(-1, *[1] * (part.ndim - 1)), part, new)
                for part, new in zip(state, reset, strict=True)
            ]
    return alive


def finite(X):
    return np.isfinite(X).all(axis=(1, 2)) & (np.abs(X).max(axis=(1, 2)) < 1e100)


def definite(X):
    """By eigenvalues of the matrix scaled to a unit diagonal."""
    diagonal = np.einsum("kii->ki", X)
    good = finite(X) & (diagonal > 0).all(axis=1)
    X = np.where(good[:, None, None], X, np.eye(X.shape[1]))
    scale = 1 / np.sqrt(np.einsum("kii->ki", X))
    return good & (np.linalg.eigvalsh(X * scale[:, :, None] * scale[:, None, :])[:, 0] > 0)


# Left out: where F turns by much within a step (a pendulum at theta <= 2), admission is no promise.
CASES = [
    (fitzhugh_nagumo, RK4, "information", 1.0, (8, 14, 20)),
    (fitzhugh_nagumo, RK4, "covariance", 1.0, (2, 8, 20)),
    (fitzhugh_nagumo, RK4, "covariance", 100.0, (1, 8)),
    (fitzhugh_nagumo, HEUN, "covariance", 1.0, (8,)),
    (fitzhugh_nagumo, EULER, "information", 1.0, (8,)),
    (pendulum, RK4, "information", 0.1, (1, 5)),
    (pendulum, RK4, "information", 1.0, (5, 20)),
    (pendulum, RK4, "covariance", 1.0, (5, 20)),
    (pendulum, HEUN, "information", 1.0, (10,)),
    (pendulum, EULER, "covariance", 1.0, (10,)),
    (chain, RK4, "information", 1.0, (1, 2, 5)),
    (chain, RK4, "covariance", 1.0, (1, 2, 5)),
    (chain, EULER, "covariance", 1.0, (2, 5)),
]


@pytest.mark.ordinary(
    "fitzhugh_nagumo-tableau2-covariance-100.0-thetas2",
    "fitzhugh_nagumo-tableau4-information-1.0-thetas4",
    "pendulum-tableau5-information-0.1-thetas5",
    "pendulum-tableau9-covariance-1.0-thetas9",
    "chain-tableau12-covariance-1.0-thetas12",
)
@pytest.mark.parametrize(("make", "tableau", "view", "p0", "thetas"), CASES)
def test_the_limit_parts_survival_from_failure(make, tableau, view, p0, thetas):
    """At .9 of the limit every start in the box survives; at 1.15 the start that the limit names fails."""
    model = make()
    for theta in thetas:
        limit = model.limit(p0, theta, tableau, view)
        assert survives(model, tableau, view, p0, theta, 0.9 * limit.dt).all(), (theta, limit)
        assert not survives(model, tableau, view, p0, theta, 1.15 * limit.dt)[limit.at], (theta, limit)


# --- the published table ------------------------------------------------------------------------------------


def largest(model, view, grid):
    """The largest theta of the grid up to which each dt of the table is admitted."""
    limits = [model.limit(1.0, theta, RK4, view).dt for theta in grid]
    assert limits == sorted(limits, reverse=True)
    return [max(t for t, limit in zip(grid, limits, strict=True) if dt <= limit) for dt in DTS]


DTS = (0.005, 0.01, 0.02, 0.05, 0.1)


@pytest.mark.full
def test_table_of_information():
    """Largest theta that survives RK4 on (z, S), FitzHugh-Nagumo, S(0) = I, whatever the Jacobian."""
    assert largest(fitzhugh_nagumo(), "information", (8, 10, 12, 14, 16, 18)) == [16, 14, 12, 10, 8]


def test_table_of_covariance():
    """The same for RK4 on (z, P): there the trial's own first Jacobian matters, at z = 0, u = 0."""
    model = fitzhugh_nagumo()
    first = Model(model.f, model.F, np.zeros((1, 3)), np.zeros(1), model.Q)
    assert largest(first, "covariance", (12, 16, 20, 32, 40, 80, 100)) == [100, 100, 80, 32, 16]


# --- closed forms -------------------------------------------------------------------------------------------


def scalar(q, r, p0, tableau, view):
    """p' = q - p^2/r."""
    one = np.ones((1, 1))
    (limit,) = covariance_limits(0 * one[None], one, q * one, r * one, p0 * one, 1.0, tableau, view)
    return limit


@pytest.mark.parametrize(
    ("tableau", "root"),
    [
        (EULER, 1.0),
        (HEUN, 1.5436890126920764),
        (RK4, 1.7394568807370768),
    ],  # roots of each method's step from 1
)
def test_quadratic_decay(tableau, root):
    """p' = -p^2/r from p0 fails at dt p0/r = x*; found from below within the scan's 2%."""
    limit = scalar(0.0, 2.0, 10.0, tableau, "covariance")
    assert root / 1.021 <= limit.dt * 10 / 2 <= root


@pytest.mark.parametrize("view", ["information", "covariance"])
@pytest.mark.parametrize(("tableau", "real"), [(EULER, 2.0), (HEUN, 2.0), (RK4, 2.785293563405282)])
def test_steady_state(tableau, real, view):
    """From its steady value sqrt(q r) the scalar equation has the eigenvalue -2 sqrt(q/r), in both views."""
    limit = scalar(3.0, 0.5, np.sqrt(1.5), tableau, view)
    assert limit.dt == pytest.approx(real / (2 * np.sqrt(6)), rel=1e-9)  # a root of a polynomial of degree 8
    assert "repels" in limit.why


def test_an_unobservable_jacobian_sets_no_limit():
    """FitzHugh-Nagumo at u = 0 has no steady covariance: the rest of the box decides."""
    model = fitzhugh_nagumo()
    rest = model.u != 0
    without = Model(model.f, model.F, model.z[rest], model.u[rest], model.Q)
    whole, part = (m.limit(0.01, 4, RK4, "covariance", theta_min=1) for m in (model, without))
    assert np.isfinite(whole.dt)
    assert whole.dt == pytest.approx(part.dt, rel=0.021)  # the scan's ratio


# --- a theta that rises -------------------------------------------------------------------------------------


def rise(theta_1, time):
    """theta' = theta^2/time up to theta_1, (2 theta_1 - theta)^2/time above, exactly."""

    def flow(theta, dt):
        s = dt / time
        if theta <= theta_1:
            needed = 1 / theta - 1 / theta_1
            if s <= needed:
                return 1 / (1 / theta - s)
            theta, s = theta_1, s - needed
        rest = 2 * theta_1 - theta
        return 2 * theta_1 - rest / (1 + rest * s)

    return flow


@pytest.mark.full
@pytest.mark.parametrize("view", ["information", "covariance"])
def test_a_rise_admits_more_than_a_jump_and_less_than_rest(view):
    model = fitzhugh_nagumo()
    jump = model.limit(1.0, 8, RK4, view, theta_min=1)
    gradual = model.limit(1.0, 8, RK4, view, theta_min=1, rise=np.vectorize(rise(4, 0.1)))
    slow = model.limit(1.0, 8, RK4, view, theta_min=1, rise=np.vectorize(rise(4, 10.0)))
    assert 1.2 * jump.dt < gradual.dt < slow.dt
    assert slow.dt <= model.limit(1.0, 1, RK4, view).dt


def frozen(model, at, view):
    """The slope of X under one Jacobian: X, theta -> dX."""
    F, n = model.F(model.z[at], model.u[at]), model.n
    N = np.outer(np.eye(n)[0], np.eye(n)[0]) / model.R

    def slope(X, theta):
        power = theta ** np.arange(float(n))
        Q = theta * np.outer(power, power) * model.Q
        if view == "information":
            return -F.T @ X - X @ F + theta * N - X @ Q @ X
        return F @ X + X @ F.T + Q - theta * X @ N @ X

    return slope


def rk4(slope, X, theta, h):
    k1 = slope(X, theta)
    k2 = slope(X + h / 2 * k1, theta)
    k3 = slope(X + h / 2 * k2, theta)
    return X + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(X + h * k3, theta))


@pytest.mark.parametrize("theta", [10, 20])
def test_beyond_its_bound_the_steady_value_repels(theta):
    """On the Jacobian that the limit names P comes to rest at .95 of it; at 1.05 it fails or never rests."""
    model = pendulum()
    limit = model.limit(0.1, theta, RK4, "covariance")
    assert "repels" in limit.why
    slope = frozen(model, limit.at, "covariance")
    for factor, good in ((0.95, True), (1.05, False)):
        P = 0.1 * np.eye(2)
        for _ in range(1000):
            P, last = rk4(slope, P, theta, factor * limit.dt), P
            if not definite(P[None])[0]:
                break
        rests = bool(definite(P[None])[0]) and np.allclose(P, last, rtol=1e-9, atol=0)
        assert rests == good


def test_the_rise_from_rest_to_failure():
    """The chain at rest under theta = 1; then theta rises: .98 of the limit survives, 1.03 fails."""
    model, flow = chain(), rise(2, 0.1)
    plant = Model(model.f, model.F, model.z[4:5], model.u[4:5], model.Q)
    limit = plant.limit(10.0, 4, RK4, "information", theta_min=1, rise=np.vectorize(flow))
    assert "from the steady P" in limit.why
    slope, rest = frozen(plant, 0, "information"), np.eye(4)
    for _ in range(2000):
        rest = rk4(slope, rest, 1.0, 0.02)
    for factor, good in ((0.98, True), (1.03, False)):
        S, theta, positive = rest, 1.0, True
        for _ in range(100):
            theta = flow(theta, factor * limit.dt)
            S = rk4(slope, S, theta, factor * limit.dt)
            positive = positive and bool(definite(S[None])[0])
            if not positive:
                break
        assert positive == good


# --- linear cores -------------------------------------------------------------------------------------------


OSCILLATION = np.array([[0.0, 1.0], [-1.0, 0.0]])


@pytest.mark.parametrize(
    ("tableau", "real", "imaginary"),
    [(EULER, 2.0, 0.0), (HEUN, 2.0, 0.0), (RK4, 2.785293563405282, 2 * np.sqrt(2))],
)
def test_core_on_the_axes(tableau, real, imaginary):
    """Known intervals of stability, to the rounding of a root; every step suits a core of zeros."""
    assert core_limit(-np.eye(1), tableau.polynomial) == pytest.approx(real, rel=1e-12)
    assert core_limit(10 * OSCILLATION, tableau.polynomial) == pytest.approx(imaginary / 10, rel=1e-9)
    assert core_limit(np.zeros((3, 3)), tableau.polynomial) == np.inf


def test_core_damped_oscillation_under_euler():
    """lambda = -a +- ib: h = 2a/(a^2 + b^2)."""
    core = -0.3 * np.eye(2) + 4 * OSCILLATION
    assert core_limit(core, EULER.polynomial) == pytest.approx(0.6 / (0.09 + 16), rel=1e-9)


@pytest.mark.parametrize("tableau", [EULER, HEUN, RK4])
def test_core_by_its_amplification(tableau):
    """The spectral radius of the matrix R(h M) is below 1 up to the limit and above 1 just beyond."""
    rng = np.random.default_rng(3)
    for n in (2, 3, 5):
        core = rng.normal(size=(n, n))
        core -= (0.1 + np.linalg.eigvals(core).real.max()) * np.eye(n)
        limit = core_limit(core, tableau.polynomial)

        def radius(h, core=core):
            total, power = 0 * core, np.eye(len(core))
            for c in tableau.polynomial:
                total, power = total + c * power, h * power @ core
            return np.abs(np.linalg.eigvals(total)).max()

        assert all(radius(limit * x) < 1 for x in np.linspace(0.01, 0.999, 200))
        assert radius(1.001 * limit) > 1


def test_core_limit_goes_like_one_over_theta():
    """The poles -theta, -2 theta, -3 theta: 2.785/(3 theta), to the rounding of a root."""
    core = np.diag([1.0, 1.0], 1) - np.outer([6.0, 11.0, 6.0], [1.0, 0, 0])
    for theta in (1, 10, 1000):
        assert core_limit(theta * core, RK4.polynomial) == pytest.approx(2.785293563405282 / (3 * theta), rel=1e-9)


def test_errors_name_the_thing():
    with pytest.raises(UnstableCore, match=r"eigenvalue 0\.5"):
        core_limit(np.diag([0.5, -1.0]), RK4.polynomial)
    for start in (-1.0, 0.0):
        with pytest.raises(NotDefinite, match="not positive definite"):
            pendulum().limit(start, 2.0, RK4, "covariance")


def test_a_rise_is_named_where_no_theta_at_rest_loses_the_covariance():
    """Of a double integrator, which from P(0) = 0.1 holds at theta = 1 by steps in which it is lost at 3."""
    F, C = np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.array([[1.0, 0.0]])
    rest, rise = (
        covariance_limits(F, C, np.eye(2), np.eye(1), 0.1 * np.eye(2), theta, RK4, "information", 1.0)[0]
        for theta in (1.0, 3.0)
    )
    assert rise.why.endswith("on the way from P(0) (theta rising from 1)")
    assert rise.dt < rest.dt
