"""Methods: their orders against the continuous equations, the covariance's views, step lengths that are admitted."""

import re
import warnings
from collections.abc import Callable
from functools import cache

import casadi as ca
import neuron
import numpy as np
import pytest
from exact import evaluate, machine
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import chain, fitzhugh_nagumo, pendulum

import hgogen as hg
from hgogen.discretisation import kernels
from hgogen.discretisation.runge_kutta import EULER, HEUN, RK4, Tableau, advance, repeated, rounds
from hgogen.discretisation.stability import Limit, core_limit
from hgogen.estimators.riccati_part import Riccati, measurement_update, pack, riccati_ode, time_update, unpack
from hgogen.method import NoCovariance
from hgogen.program import Place, Repeat, sym, walk
from hgogen.step import BadStep, CannotUpdate, StepMayFail, StepTooLong

EPS = np.finfo(float).eps
Signal = Callable[[np.ndarray], np.ndarray]


def u(t: np.ndarray) -> np.ndarray:
    return 0.5 * np.sin(t)


def y(t: np.ndarray) -> np.ndarray:
    return 1.5 * np.cos(0.7 * t + 0.3)


def record(duration: float, dt: float) -> dict[str, np.ndarray]:
    t = np.arange(round(duration / dt) + 1) * dt
    return {"u": u(t), "y": y(t)}


def run(observer: hg.Observer, method: str, dt: float, duration: float, between: str = "line") -> hg.Run:
    step = hg.sample(observer, getattr(hg.methods, method), dt=dt, between=between)
    return step.run(**record(duration, dt), engine="python")


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the limit of dt by the covariance, which takes seconds to find."""
    monkeypatch.setattr("hgogen.method.covariance_limits", lambda *arguments: [Limit(np.inf, "not asked")])


# --- orders -------------------------------------------------------------------------------------------------

OBSERVERS = {
    "kalman": lambda: fitzhugh_nagumo(),
    "theta_3": lambda: fitzhugh_nagumo(theta=3.0),
    "high_gain": lambda: pendulum(),
}
LENGTHS = {"kalman": (0.025, 0.0125), "theta_3": (0.025, 0.0125), "high_gain": (0.005, 0.0025)}


@cache
def reference(name: str, dt: float, between: str) -> hg.Run:
    """The continuous equations on the line between the very samples that the step is given."""
    return hg.reference(OBSERVERS[name](), **record(1.0, dt), dt=dt, between=between)


def errors(name: str, method: str, between: str) -> list[float]:
    differences = []
    for dt in LENGTHS[name]:
        run_, exact = run(OBSERVERS[name](), method, dt, 1.0, between), reference(name, dt, between)
        assert not run_.status.any()  # no clamp is active: the equations are smooth
        assert not exact.status.any()
        differences.append(float(np.abs(run_.x - exact.x).max()))
    return differences


@pytest.mark.ordinary(
    "kalman-euler-1-hold",
    "high_gain-heun-2-line",
    "high_gain-rk4-4-hold",
    "theta_3-rk4_covariance-4-hold",
    "kalman-continuous_discrete-1-line",
)
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("between", ["line", "hold"])
@pytest.mark.parametrize(
    ("name", "method", "order"),
    [
        *((name, method, order) for name in OBSERVERS for method, order in (("euler", 1), ("heun", 2), ("rk4", 4))),
        *((name, "rk4_covariance", 4) for name in ("kalman", "theta_3")),
        # dt (y - C z) at the samples is the rectangle rule for the integral of the correction, in z as in P
        *((name, "continuous_discrete", 1) for name in ("kalman", "theta_3")),
    ],
)
def test_order(name: str, method: str, order: int, between: str) -> None:
    """An error c dt^p (1 + O(dt lambda)) halves p times; dt lambda is some .1 here, which moves p by less than .25."""
    coarse, fine = errors(name, method, between)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.25)


def adaptive(innovation: object) -> hg.Observer:
    """theta rises to 3.5 and falls again within 2 s, mu mostly strictly between 0 and 1."""
    mu = hg.theta.smoothstep(0.01, 0.3)
    return fitzhugh_nagumo(theta=hg.theta.adaptive(2.0, rise_time=0.3, mu=mu, innovation=innovation))


@pytest.mark.full
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "innovation",
    [
        lambda **method: hg.innovation.staggered(0.4, predictors=2, **method),
        lambda **method: hg.innovation.window(0.4, **method),
    ],
    ids=["staggered", "window"],
)
def test_order_with_an_adaptive_theta(innovation: Callable[..., object]) -> None:
    """4 with predictors by RK4; with Heun's, the default, theta has their order, 2."""
    ways, differences = {"rk4": innovation(method=hg.methods.rk4), "heun": innovation()}, {"rk4": [], "heun": []}
    for dt in (0.05, 0.025):
        exact = hg.reference(adaptive(ways["rk4"]), **record(2.0, dt), dt=dt)
        assert exact.traces["theta"].max() > 2.5
        for name, way in ways.items():
            own = run(adaptive(way), "rk4", dt, 2.0)
            differences[name].append(np.abs(own.traces["theta"] - exact.traces["theta"]).max())
    for name, order in (("rk4", 4), ("heun", 2)):
        assert np.log2(differences[name][0] / differences[name][1]) == pytest.approx(order, abs=0.5)


@pytest.mark.usefixtures("unchecked")
def test_a_decaying_theta_is_held_by_a_step() -> None:
    """The left value of theta in place of the decaying one: order 1."""
    observer, differences = fitzhugh_nagumo(theta=hg.theta.decaying(3.0, rate=1.0)), []
    for dt in (0.05, 0.025):
        exact = hg.reference(observer, **record(1.0, dt), dt=dt)
        differences.append(np.abs(run(observer, "rk4", dt, 1.0).x - exact.x).max())
    assert np.log2(differences[0] / differences[1]) == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize("tableau", [EULER, HEUN, RK4, repeated(HEUN, 3)], ids=lambda tableau: tableau.name)
def test_tableaux_are_consistent(tableau: Tableau) -> None:
    """Rows of a sum to c, b to 1, and R(z) is exp(z) up to the order."""
    for row, c in zip(tableau.a, tableau.c, strict=True):
        assert sum(row) == pytest.approx(c, abs=4 * EPS)
    assert sum(tableau.b) == pytest.approx(1, abs=4 * EPS)
    exponential = np.cumprod([1.0, *(1 / k for k in range(1, tableau.order + 1))])
    assert tableau.polynomial[: tableau.order + 1] == pytest.approx(exponential, abs=8 * EPS)


THIRD = Tableau("Ralston", ((), (1 / 2,), (0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9), (0, 1 / 2, 3 / 4), 3)


@pytest.mark.parametrize("tableau", [RK4, THIRD])
def test_a_step_in_rounds_has_the_bits_of_one_at_once(tableau: Tableau) -> None:
    """Each stage reads what the one before has left, no other."""
    z = np.array([0.3, -1.7])
    rate = lambda values, c: {"z": np.sin(3 * values["z"]) + c}  # noqa: E731
    at_once, plan = advance(tableau, rate, {"z": z}, 0.1), rounds(tableau, 0.1)
    at, total = z, np.zeros(2)
    for c, share, ahead, expected in zip(plan.fractions, plan.shares, plan.ahead, at_once.slopes, strict=True):
        slope = rate({"z": at}, c)["z"]
        np.testing.assert_array_equal(slope, expected["z"])
        at, total = z + ahead * slope, total + share * slope
    np.testing.assert_array_equal(z + plan.last * total, at_once.result["z"])
    assert tableau.chained


def test_the_stages_are_a_loop_with_one_call_of_the_equations() -> None:
    """In Python's reading they are one after the other, and compute the same."""
    made = neuron.step(1.0, hg.methods.rk4_covariance)
    text = hg.targets.c99(made, check=False)["fitzhugh_nagumo.c"]
    assert text.count("fitzhugh_nagumo_rate(") == 2
    (stages,) = (s for s in walk(made.code.program) if isinstance(s, Repeat))
    assert stages.count == 4
    assert len(stages.unrolled) == 8
    rng = np.random.default_rng(0)
    u, y = rng.uniform(-1, 1, (50, 1)), rng.uniform(-2, 2, (50, 1))
    ends = []
    for engine in ("c", "python"):
        made.reset()
        ends.append(made.run(u=u, y=y, engine=engine).x)
    assert np.array_equal(*ends)


@pytest.mark.parametrize("tableau", [EULER, HEUN, repeated(RK4, 2)])
def test_a_step_of_few_stages_or_whose_stages_read_many_is_one_block(tableau: Tableau) -> None:
    assert not tableau.chained


def test_a_repeated_method_is_that_many_steps() -> None:
    """R of 3 steps of length h/3 is R(h/3)^3."""
    once, thrice = np.array(RK4.polynomial[::-1]), np.array(repeated(RK4, 3).polynomial[::-1])
    for h in (-1.0, -0.3, 0.7):
        assert np.polyval(thrice, h) == pytest.approx(np.polyval(once, h / 3) ** 3, rel=64 * EPS)


# --- the covariance's views ---------------------------------------------------------------------------------


def definite(rng: np.random.Generator, n: int) -> np.ndarray:
    """A symmetric matrix with eigenvalues from 0.01 to 100."""
    turn, _ = np.linalg.qr(rng.standard_normal((n, n)))
    return turn @ np.diag(10 ** rng.uniform(-2, 2, n)) @ turn.T


@cache
def rates() -> tuple[object, object]:
    """(z, X, u, y, valid) to (z', X'), X the lower triangle of P or S."""
    (part,) = fitzhugh_nagumo(theta=3.0, Q=np.diag([0.1, 0.01, 2.3e-4]) + 1e-4).parts
    assert isinstance(part, Riccati)
    n, gains = (
        part.dynamics.n,
        {Place("gain", "Q"): part.nominal[0], Place("gain", "R"): part.nominal[1], Place("gain", "theta"): 3.0},
    )
    z, X, u_, y_, valid = (ca.SX.sym(name, size) for name, size in zip("zXuyv", (n, 6, 1, 1, 1), strict=True))
    functions = []
    for view, name in (("covariance", "P"), ("information", "S")):
        slopes = riccati_ode(part, view).rhs({"z": z, name: X}, u_, y_, valid)
        weights = np.diag(np.linalg.cholesky(gains[Place("gain", "Q")])) ** 2
        substituted = ca.substitute(
            [ca.vertcat(slopes["z"]), ca.vertcat(slopes[name])],
            [sym("gain", "Q", n), sym("gain", "R"), sym("gain", "theta")],
            [ca.SX(ca.DM(weights)), ca.SX(1.0), ca.SX(3.0)],
        )
        functions.append(ca.Function(name, [z, X, u_, y_, valid], substituted))
    return tuple(functions)


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(deadline=None, max_examples=50)
def test_the_information_form_is_the_covariance_form(seed: int, valid: bool) -> None:
    """z' is the same and S' = -S P' S: the condition number is at most 1e4, each product keeps 1e-16 of it."""
    rng = np.random.default_rng(seed)
    P = definite(rng, 3)
    S = np.linalg.inv(P)
    z, signals = rng.uniform(-4, 4, 3), (*rng.uniform(-1, 1, 2), float(valid))
    forward, backward = rates()
    slope, rate = (np.array(part) for part in forward(z, pack(P), *signals))
    other, back = (np.array(part) for part in backward(z, pack(S), *signals))
    rate, back = (np.array(ca.DM(unpack(ca.SX(ca.DM(part)), 3))) for part in (rate, back))
    assert other == pytest.approx(slope, abs=1e-10 * max(1.0, np.abs(slope).max()))
    expected = -S @ rate @ S
    scale = np.abs(S).max() ** 2 * np.abs(rate).max() + np.abs(back).max()
    assert back == pytest.approx(expected, abs=1e-10 * scale)


sizes = st.integers(1, 6)
seeds = st.integers(0, 2**32 - 1)


@cache
def updates(n: int) -> tuple[object, object, object]:
    """Of (L, d, Phi, W, w), of (L, d, c, r) with a full row, and with c = (c_1, 0, ..., 0)."""
    names = (("L", n, n), ("d", n), ("A", n, n), ("W", n, n), ("w", n), ("c", 1, n), ("r",))
    L, d, A, W, w, c, r = (ca.SX.sym(*name) for name in names)
    lower = ca.SX.eye(n) + ca.SX(ca.Sparsity.lower(n), 0)
    for j in range(n):
        for i in range(j + 1, n):
            lower[i, j] = L[i, j]
    first = ca.sparsify(ca.horzcat(c[0], ca.SX(1, n - 1)))
    return (
        ca.Function("time", [L, d, A, W, w], time_update(lower, d, A, W, w)[:2]),
        ca.Function("full", [L, d, c, r], measurement_update(lower, d, c, r)),
        ca.Function("first", [L, d, c, r], measurement_update(lower, d, first, r)),
    )


def factors(rng: np.random.Generator, n: int, decades: float) -> tuple[np.ndarray, np.ndarray]:
    return np.tril(rng.standard_normal((n, n)), -1) + np.eye(n), 10 ** rng.uniform(-decades, decades, n)


def assert_factors(L: np.ndarray, d: np.ndarray) -> None:
    assert np.array_equal(L, np.tril(L, -1) + np.eye(len(d)))
    assert (d > 0).all()
    assert np.isfinite(d).all()


@given(sizes, seeds)
@settings(deadline=None, max_examples=60)
def test_the_time_update_is_the_dense_one(n: int, seed: int) -> None:
    """Gram-Schmidt on 2n rows is stable row by row: the error is some n^2 eps of |Phi L| D |Phi L|' + |W| w |W|'."""
    rng = np.random.default_rng(seed)
    (L, d), (W, w), A = factors(rng, n, 2), factors(rng, n, 2), rng.standard_normal((n, n))
    lower, diagonal = (np.array(part) for part in updates(n)[0](L, d, A, W, w))
    assert_factors(lower, diagonal[:, 0])
    dense = A @ L @ np.diag(d) @ L.T @ A.T + W @ np.diag(w) @ W.T
    size = np.diag(dense)  # of which no entry is larger than the geometric mean of its row's and column's
    error = np.abs(lower @ np.diag(diagonal[:, 0]) @ lower.T - dense) / np.sqrt(np.outer(size, size))
    assert error.max() < 100 * n**2 * EPS


@given(sizes, seeds, st.booleans())
@settings(deadline=None, max_examples=60)
def test_the_measurement_update_is_the_dense_one(n: int, seed: int, full: bool) -> None:
    """P - K c P loses no more than some n^2 eps of P, and K as much of itself."""
    rng = np.random.default_rng(seed)
    (L, d), c, r = factors(rng, n, 2), rng.standard_normal((1, n)), 10 ** rng.uniform(-2, 2)
    if not full:
        c[0, 1:] = 0
    lower, diagonal, gain = (np.array(part) for part in updates(n)[1 if full else 2](L, d, c, r))
    assert_factors(lower, diagonal[:, 0])
    P = L @ np.diag(d) @ L.T
    alpha = r + (c @ P @ c.T).item()
    K = P @ c.T / alpha
    scale = np.sqrt(np.diag(P))
    error = np.abs(lower @ np.diag(diagonal[:, 0]) @ lower.T - (P - K @ c @ P)) / np.outer(scale, scale)
    assert error.max() < 100 * n**2 * EPS
    assert gain == pytest.approx(K, abs=100 * n**2 * EPS * (scale[:, None] * np.sqrt(1 / alpha)).max())
    if not full:
        assert np.array_equal(lower, L)


@given(sizes, seeds)
@settings(deadline=None, max_examples=60)
def test_the_loops_of_the_measurement_update_are_the_dense_one(n: int, seed: int) -> None:
    """The same of the kernel, which has L by columns and ends with K."""
    rng = np.random.default_rng(seed)
    (L, d), c, r = factors(rng, n, 2), rng.standard_normal(n), np.array([10 ** rng.uniform(-2, 2)])
    columns, diagonal, gain = L.T.copy(), d.copy(), np.zeros(n)
    kernels.correct(columns, diagonal, c, r, gain, n)
    lower = np.tril(columns.T, -1) + np.eye(n)
    P = L @ np.diag(d) @ L.T
    alpha = r[0] + c @ P @ c
    K = P @ c / alpha
    scale = np.sqrt(np.diag(P))
    error = np.abs(lower @ np.diag(diagonal) @ lower.T - (P - np.outer(K, c @ P))) / np.outer(scale, scale)
    assert error.max() < 100 * n**2 * EPS
    assert gain == pytest.approx(K, abs=100 * n**2 * EPS * (scale * np.sqrt(1 / alpha)).max())


@given(sizes, seeds)
@settings(deadline=None, max_examples=60)
def test_factors_stay_positive_over_thirty_decades(n: int, seed: int) -> None:
    """Where P itself could not be formed: every pivot is a sum or quotient of positive numbers."""
    rng = np.random.default_rng(seed)
    (L, d), (W, w), A = factors(rng, n, 15), factors(rng, n, 15), rng.standard_normal((n, n))
    after = [np.array(part) for part in updates(n)[0](L, d, A, W, w)]
    assert_factors(after[0], after[1][:, 0])
    c, r = rng.standard_normal((1, n)), 10 ** rng.uniform(-15, 15)
    corrected = [np.array(part) for part in updates(n)[1](L, d, c, r)]
    assert_factors(corrected[0], corrected[1][:, 0])
    # det(P+) = det(P) r/alpha, in logarithms; alpha = r + sum of d_j f_j^2 with positive terms
    f = L.T @ c[0]
    alpha = r + d @ f**2
    change = np.log(corrected[1][:, 0]).sum() - np.log(d).sum()
    assert change == pytest.approx(np.log(r) - np.log(alpha), abs=1e-11)


@pytest.mark.parametrize("n", [5, 6])
def test_factors_in_float_survive_2000_samples_without_measurement(n: int) -> None:
    """P grows over eight decades; formed and factored in float it stops being positive definite."""
    h, function = 0.01, updates(n)[0]
    F = np.diag(np.ones(n - 1), 1)
    F[-1, 0] = F[-1, -1] = -1
    Phi = (np.eye(n) + h * F + h * h / 2 * F @ F).astype(np.float32)
    L, d, P = np.eye(n, dtype=np.float32), np.ones(n, np.float32), np.eye(n, dtype=np.float32)
    noise, lost = np.full(n, 0.01 * h, np.float32), False
    constants = [Phi.T.ravel(), np.eye(n, dtype=np.float32).ravel(), noise]
    places = function.sparsity_out(0).get_triplet()  # rows and columns of what is computed of L
    for _ in range(2000):
        lower, d = (np.array(part, np.float32) for part in evaluate(function, [L.T.ravel(), d, *constants], "float"))
        L[*places] = lower
        assert (d > 0).all()
        P = Phi @ P @ Phi.T + np.diag(noise)
        lost = lost or np.linalg.eigvalsh((P + P.T).astype(float) / 2).min() <= 0
    assert lost
    assert np.isfinite(L).all()
    assert np.isfinite(d).all()


@pytest.mark.full
def test_a_step_in_float_comes_back_after_2000_samples_without_measurement() -> None:
    """The chain's truth is its rest; the covariance is capped meanwhile, the factors stay positive."""
    observer = hg.observers.riccati(
        hg.forms.triangular(chain(5)), Q=(0.01,) * 5, R=0.01, initial={"x1": 1.0, "x5": -1.0}
    )
    reader = machine(hg.sample(observer, dt=0.01), "float")
    reader.memory[Place("output", "y")][0] = np.nan
    for _ in range(2000):
        reader.call()
        assert (reader.memory[Place("state", "D")] > 0).all()
        assert all(np.isfinite(reader.memory[Place("state", name)]).all() for name in ("z", "L", "D"))
    reader.memory[Place("output", "y")][0] = 0.0
    for _ in range(1500):
        reader.call()
    assert np.abs(reader.memory[Place("state", "z")]).max() < 0.1


@pytest.mark.parametrize("loops", [False, True])
def test_beyond_its_cap_the_covariance_is_scaled_by_rows_and_columns(
    loops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """S P S with S = diag(min(1, cap_i/P_ii)), a congruence; the states stand still and Q adds some 1e-12 of P."""
    if loops:
        monkeypatch.setattr("hgogen.estimators.factored.LONGER", {"speed": -(10**9)})
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2, 3)]
    plant = hg.System("still", states=x, outputs=(hg.Signal("y"),), flow=[0, 0, 0], output=[x[0] + x[1] + x[2]])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1e-12,) * 3, R=1.0)
    reader, (part,) = machine(hg.sample(observer, dt=0.01), "double"), observer.parts
    memory, below = reader.memory, np.triu_indices(3, 1)
    memory[Place("output", "y")][0] = np.nan
    reader.call()  # the first call advances no time

    columns, d = np.array([[1.0, 0.5, -0.25], [0, 1, 2], [0, 0, 1]]), part.cap * [0.5, 3.0, 0.1]
    P = columns.T @ np.diag(d) @ columns
    scale = np.minimum(1, part.cap / np.diag(P))
    assert (scale < 1).tolist() == [False, True, True]
    memory[Place("state", "D")][:] = d
    memory[Place("column", "v") if loops else Place("state", "L")][:] = columns if loops else columns[below]
    assert "COVARIANCE_LIMITED" in reader.step.flags(reader.call())

    columns[below] = memory[Place("column", "v")][below] if loops else memory[Place("state", "L")]
    covariance = columns.T @ np.diag(memory[Place("state", "D")]) @ columns
    assert covariance == pytest.approx(np.diag(scale) @ P @ np.diag(scale), rel=1e-9)


def test_a_covariance_may_fall_far_below_its_first_value() -> None:
    """Of two states that stand still, each seen alone, P_ii <- (P_ii + h q) r/(P_ii + h q + r), r = R/h."""
    x, y = [hg.Signal(f"x{i}", low=-1e3, high=1e3) for i in (1, 2)], [hg.Signal(f"y{i}") for i in (1, 2)]
    plant = hg.System("still", states=x, outputs=y, flow=[0, 0], output=x)
    q, R, h = 1e-12, 1e-12, 0.01
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(q, q), R=(R, R), covariance=(1e6, 1e6))
    reader, P = machine(hg.sample(observer, dt=h), "double"), 1e6
    reader.memory[Place("output", "y1")][0] = reader.memory[Place("output", "y2")][0] = 0.0
    for k in range(50):
        reader.call()
        predicted = P + h * q * (k > 0)  # the first call advances no time
        P = predicted * (R / h) / (predicted + R / h)
        assert reader.memory[Place("state", "D")] == pytest.approx([P, P], rel=1e-9)


# --- step lengths -------------------------------------------------------------------------------------------


def admitted(sentence: str) -> float:
    (length,) = re.findall(r"take dt <= ([0-9.e+-]+) \(", sentence)
    return float(length)


@pytest.mark.ordinary("euler-7.0", "heun-3.0", "heun-7.0", "heun-20.0", "heun-33.0", "rk4-3.0")
@pytest.mark.parametrize("theta", [3.0, 7.0, 20.0, 33.0])
@pytest.mark.parametrize("method", ["euler", "heun", "rk4"])
def test_a_dt_too_long_names_one_that_works(method: str, theta: float) -> None:
    """Refused where the core and a slope of the model, -19.6 to 19.6 or none of it, leave the stability region."""
    observer, way = pendulum(theta=theta), getattr(hg.methods, method)
    slopes = [(s, b) for s in np.linspace(-19.6, 19.6, 99) for b in (0.0, 0.1)]
    whole = np.array([[[-2 * theta, 1], [s - theta**2, -b]] for s, b in slopes])
    limit = core_limit(whole[np.linalg.eigvals(whole).real.max(axis=1) < 0], way.tableau.polynomial)
    with pytest.raises(StepTooLong, match=r"refused above .* beyond it ") as caught:
        hg.sample(observer, way, dt=1.1 * limit)
    assert (1 - 1e-9) * limit <= caught.value.limit < 1.03 * limit  # at the points that are tried
    dt = admitted(str(caught.value))
    unmeasured = "while samples are missing" in str(caught.value)  # steps of low order make the swinging model grow
    assert unmeasured or caught.value.limit / 8 < dt
    assert not unmeasured or method in ("euler", "heun")
    assert dt <= caught.value.limit / 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hg.sample(observer, way, dt=dt)


@pytest.mark.ordinary("3.0-rk4", "8.0-rk4_covariance", "3.0-euler")
@pytest.mark.parametrize(("theta", "method"), [(3.0, "rk4"), (8.0, "rk4"), (8.0, "rk4_covariance"), (3.0, "euler")])
def test_a_covariance_too_stiff_names_a_dt_that_works(theta: float, method: str) -> None:
    observer = fitzhugh_nagumo(theta=theta)
    with pytest.raises(StepTooLong) as caught:
        hg.sample(observer, getattr(hg.methods, method), dt=5.0)
    reasons = "loses positive definiteness on the way from|does not settle, for its steady value repels"
    sentence = rf"declared box admits the longest, the covariance ({reasons}).* \(theta = {theta:g}\); the method "
    assert re.search(sentence + "continuous_discrete keeps it definite at any dt; take dt <= ", str(caught.value))
    dt = admitted(str(caught.value))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        step = hg.sample(observer, getattr(hg.methods, method), dt=dt)
    assert dt <= caught.value.take <= caught.value.limit == step.limit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        hg.sample(observer, hg.methods.continuous_discrete, dt=2 * dt)


def test_a_dt_without_a_warning_runs() -> None:
    observer = fitzhugh_nagumo(theta=8.0)
    with pytest.warns(StepMayFail, match="may fail in a part of the declared box") as caught:
        hg.sample(observer, hg.methods.rk4, dt=0.15)
    dt = admitted(str(caught[0].message))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        step = hg.sample(observer, hg.methods.rk4, dt=float(dt))
    result = step.run(**record(20.0, float(dt)), engine="python")
    assert "RESTARTED" not in step.flags(np.bitwise_or.reduce(result.status))
    S = np.array(ca.DM(unpack(ca.SX(ca.DM(step._kept.places[Place("state", "S")])), 3)))
    assert np.linalg.eigvalsh(S).min() > 0


def test_continuous_discrete_is_limited_by_the_model_and_by_a_covariance_at_its_cap() -> None:
    """In the middle of the box F has the eigenvalue -0.8, which Phi follows up to 2/0.8 and R_4 up to 2.785/0.8. At
    theta = 100 the cap leaves too small a gain far below that: by trials the estimate is lost from dt = 0.3 on."""
    assert hg.sample(fitzhugh_nagumo(theta=1.0), dt=0.01).limit == np.inf  # it is within what is advised
    limits = []
    for theta in (1.0, 100.0):
        with pytest.raises(StepTooLong) as caught:
            hg.sample(fitzhugh_nagumo(theta=theta), dt=5.0)
        assert caught.value.take < min(0.3, caught.value.limit)
        limits.append(caught.value.limit)
    assert 2 / 0.8 < limits[0] < 2.785 / 0.8
    assert 0.3 < limits[1] < 1


def test_a_stiff_plant_is_refused_where_its_decay_cannot_be_followed() -> None:
    """x2' = -k (x2 - u): R_4 follows up to h k = 2.785. At k = 280, dt = 0.01 the error of b stays above 1.5, with
    every check proved; at 260 it vanishes, though the covariance is at its cap from 200 on."""
    a, b = hg.Signal("a", low=-5, high=5), hg.Signal("b", low=-5, high=5)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-20, high=20)

    def stiff(k: float) -> hg.System:
        return hg.System("stiff", states=(a, b), inputs=(u,), outputs=(y,), flow=[b - a, -k * (b - u)], output=[a])

    hg.sample(hg.observers.riccati(hg.forms.triangular(stiff(190)), Q=[0.1, 0.1], R=0.1), dt=0.01)
    with pytest.warns(StepMayFail, match=r"above 0\.013\d* it is refused; take dt <= 0\.009"):
        hg.sample(hg.observers.riccati(hg.forms.triangular(stiff(210)), Q=[0.1, 0.1], R=0.1), dt=0.01)
    with pytest.raises(StepTooLong, match=r"refused above 0\.009"):
        hg.sample(hg.observers.riccati(hg.forms.triangular(stiff(285)), Q=[0.1, 0.1], R=0.1), dt=0.01)


@pytest.mark.parametrize("dt", [0, -1, float("nan"), float("inf"), "1"])
def test_no_time_is_no_dt(dt: object) -> None:
    with pytest.raises(BadStep, match=r"dt = .* must be a positive time in seconds"):
        hg.sample(pendulum(), hg.methods.rk4, dt=dt)


def test_a_period_is_asked_for() -> None:
    with pytest.raises(BadStep, match=r"^dt is missing; give the sampling period in seconds, as dt=$"):
        hg.sample(pendulum())


def test_u_is_on_a_line_or_held() -> None:
    with pytest.raises(BadStep, match='must be "line" or "hold"'):
        hg.sample(pendulum(), hg.methods.rk4, dt=0.01, between="cubic")


@pytest.mark.parametrize("method", ["cholesky", "rk4_covariance"])
def test_a_covariance_is_not_stepped_where_there_is_none(method: str) -> None:
    with pytest.raises(NoCovariance, match=r"is a method for the covariance of a Riccati observer.*none: take rk4"):
        hg.sample(pendulum(), getattr(hg.methods, method), dt=1e-3)


def test_sentences_name_the_rule_that_runs() -> None:
    """Of the default that is Runge-Kutta where there is no covariance."""
    step = hg.sample(pendulum(), dt=1e-3)
    assert repr(step).endswith("high_gain by classical Runge-Kutta, dt = 0.001>")
    with pytest.raises(CannotUpdate, match=r"^high_gain by classical Runge-Kutta integrates with the measurement"):
        step.predict(u=0.1 if step.inputs else ())
    with pytest.raises(StepTooLong, match=r"^dt = 10 is too long for classical Runge-Kutta: "):
        hg.sample(pendulum(), dt=10.0)


def test_an_error_core_beyond_a_double_is_refused_by_a_sentence() -> None:
    x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
    plant = hg.System("p", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -x1], output=[x1])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=1e160, poles=(-1, -1))
    with pytest.raises(hg.HgogenError, match="beyond the range of a double; choose smaller gains"):
        hg.sample(observer, hg.methods.rk4, dt=1e-3)
