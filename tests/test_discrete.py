"""Discrete plants x+ = f(x, u): declaration, observability, filters against an oracle in numpy, and refusals."""

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from oracle import discrete as oracle
from scipy.optimize import least_squares, minimize
from typer.testing import CliRunner

import hgogen as hg
from hgogen.check import Verdict
from hgogen.commands.app import app
from hgogen.logs.problem import steps_and_growth
from hgogen.model import load
from hgogen.reading.text_model import from_table, read, to_text
from hgogen.run import native

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
S = hg.Signal
p, v = S("p", "m", low=-100, high=100), S("v", "m/s", low=-5, high=5)
u, y, r = S("u", "", low=-1, high=1), S("y", "m"), S("r", "m")
N, DT = 120, 0.1
RNG = np.random.default_rng(1)
U = RNG.uniform(-1, 1, (N, 1))
P0, Q = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[1e-3, 2e-4], [2e-4, 1e-2]])


def cart(**changed: Any) -> hg.System:
    """A cart with a nonlinear force, and its distance from a point beside the track as second output."""
    declared: dict[str, Any] = {
        "states": (p, v),
        "inputs": (u,),
        "outputs": (y, r),
        "flow": [p + v / 10, v * sp.Rational(9, 10) + u / 10 + sp.sin(p) / 20],
        "output": [p, sp.sqrt(p**2 + 9)],
        "discrete": True,
    }
    return hg.System("cart", **{**declared, **changed})


def f(x: np.ndarray, now: np.ndarray) -> np.ndarray:
    return np.array([x[0] + x[1] / 10, 0.9 * x[1] + now[0] / 10 + np.sin(x[0]) / 20])


def F(x: np.ndarray, now: np.ndarray) -> np.ndarray:
    return np.array([[1, 0.1], [np.cos(x[0]) / 20, 0.9]])


def h(x: np.ndarray) -> np.ndarray:
    return np.array([x[0], np.hypot(x[0], 3)])


def H(x: np.ndarray) -> np.ndarray:
    return np.array([[1, 0], [x[0] / np.hypot(x[0], 3), 0]])


def samples() -> np.ndarray:
    """Samples of both outputs, a fifth of each missing."""
    rng, x, rows = np.random.default_rng(2), np.array([3.0, 1.0]), []
    for k in range(N):
        x = f(x, U[k - 1]) if k else x
        rows.append(h(x) + rng.normal(size=2) * (0.2, 0.1))
    return np.where(rng.uniform(size=(N, 2)) < 0.2, np.nan, np.array(rows))


Y, VARIANCES = samples(), np.array([0.04, 0.01])
NOISE: dict[str, Any] = {"Q": Q, "R": dict(zip(("y", "r"), VARIANCES, strict=True)), "covariance": P0}


# ---------------------------------------------------------------- declaration


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"discrete": 1}, "discrete = 1 must be True"),
        ({"invariants": [p**2 - 1]}, "is discrete and has invariants"),
        ({"inputs": (S("u", "", low=-1, high=1, rates=((-1, 1),)),)}, "is discrete, and u has rates"),
    ],
)
def test_what_a_discrete_plant_cannot_be(changed: dict[str, Any], said: str) -> None:
    if "inputs" in changed:
        changed["flow"] = [p, v]
    with pytest.raises(hg.HgogenError, match=said):
        cart(**changed)


def test_an_angle_may_advance_by_whole_turns() -> None:
    a, w = S("a", "rad", low=-np.pi, high=np.pi, period=2 * np.pi), S("w", "rad/s", low=-1, high=1)
    plant = hg.System("turn", states=(a, w), outputs=(y,), flow=[a + w / 10, w], output=[sp.sin(a)], discrete=True)
    assert plant.discrete
    with pytest.raises(hg.HgogenError, match=r"flow 1 changes by 2\*pi over one turn of a"):
        hg.System("turn", states=(a, w), outputs=(y,), flow=[a + w / 10, w], output=[sp.sin(a)])
    with pytest.raises(hg.HgogenError, match="no multiple of the state's own"):
        hg.System("turn", states=(a, w), outputs=(y,), flow=[a / 2 + w, w], output=[sp.sin(a)], discrete=True)
    with pytest.raises(hg.HgogenError, match="flow 2 changes by"):
        hg.System("turn", states=(a, w), outputs=(y,), flow=[a, w + a], output=[sp.sin(a)], discrete=True)


def test_plain_text(tmp_path: Path) -> None:
    plant = cart()
    file = tmp_path / "cart.toml"
    file.write_text(to_text(plant))
    assert "discrete = true" in file.read_text()
    assert read(file).plant == plant
    with pytest.raises(hg.HgogenError, match="true or false"):
        from_table({"name": "cart", "discrete": "true"})


# ---------------------------------------------------------------- observability


def brute_rank(
    flow: list[sp.Expr], output: list[sp.Expr], states: tuple[sp.Symbol, ...], inputs: tuple[Any, ...]
) -> int:
    """The rank of d(y_0, .., y_(n-1))/dx at a random rational point, the compositions written out by SymPy."""
    x, rows = sp.Matrix(states), []
    for k in range(len(states)):
        fresh = {i: sp.Symbol(f"{i}_{k}") for i in inputs}
        now = {**dict(zip(states, x, strict=True)), **fresh}
        rows += [sp.sympify(e).subs(now, simultaneous=True) for e in output]
        x = sp.Matrix([sp.sympify(e).subs(now, simultaneous=True) for e in flow])
    J = sp.Matrix(rows).jacobian(states)
    rng = np.random.default_rng(3)
    return int(J.subs({s: sp.Rational(int(rng.integers(1, 50)), 7) for s in sorted(J.free_symbols, key=str)}).rank())


q = S("q", "", low=-2, high=2)
CASES: dict[str, tuple[list[Any], list[Any], tuple[Any, ...]]] = {
    "a product": ([p * v, v], [p], (p, v)),
    "a speed that no output reads": ([p + v / 10, v * sp.Rational(9, 10)], [v], (p, v)),
    "a shift register": ([v, q, 0 * q], [p], (p, v, q)),
    "a register that is lost": ([0 * p, p, v], [q], (p, v, q)),
    "an input that makes it observable": ([p + u * v, v], [p], (p, v)),
    "no inverse, and a row after a pause": ([v * v, q, p * 0], [p], (p, v, q)),
    "equal states": ([p / 2, v / 2], [p + v], (p, v)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_rank_is_that_of_the_compositions(name: str) -> None:
    flow, output, states = CASES[name]
    inputs = (u,) if any(sp.sympify(e).has(u) for e in flow) else ()
    plant = hg.System("plant", states=states, inputs=inputs, outputs=(y,), flow=flow, output=output, discrete=True)
    answer = hg.observability(plant)
    rank = brute_rank(flow, output, states, inputs)
    assert answer.rank == rank
    (check, *_) = answer.checks
    assert check.verdict is (hg.Verdict.GENERIC if rank == len(states) else hg.Verdict.REFUTED)


def test_what_hides_a_state_is_named_and_proved() -> None:
    plant = cart(flow=[p + v / 10, v * sp.Rational(9, 10)], output=[v, 2 * v], inputs=())
    answer = hg.observability(plant)
    assert str(answer.known.symmetries[0]) == "p -> p + c"
    assert answer.known.symmetries[0].proved
    assert answer.known.advice == "measure p as well"
    scaled = hg.System("s", states=(p, v), outputs=(y,), flow=[p * v, v / p], output=[p * v], discrete=True)
    assert not any(
        one.proved for one in hg.observability(scaled).known.symmetries
    )  # p v is, the next p v is not hidden


def _piecewise(flow: Callable[..., list[Any]], output: Callable[..., list[Any]], **more: Any) -> Any:
    x1, x2, s = (hg.Signal(name, low=-2, high=2) for name in ("x1", "x2", "s"))
    outputs = (hg.Signal("y"), hg.Signal("z"))
    return hg.observability(
        hg.System(
            "switched", states=(x1, x2, s), outputs=outputs, flow=flow(x1, x2, s), output=output(x1, x2, s), **more
        )
    ).checks[0]


def test_the_rank_on_a_branch_that_samples_leave_decides_nothing() -> None:
    """x2 is observable on s > 0 alone, which is left at once; and x1, x2 by turns, of which no branch has both."""
    left = _piecewise(
        lambda x1, x2, s: [x2, x2, -sp.Abs(s)],
        lambda x1, x2, s: [sp.Piecewise((x1, s > 0), (0, True)), s],
        discrete=True,
    )
    turns = _piecewise(
        lambda x1, x2, s: [x1, x2, -s], lambda x1, x2, s: [sp.Piecewise((x1, s < 0), (x2, True)), s], discrete=True
    )
    assert [left.verdict, turns.verdict] == [Verdict.UNKNOWN, Verdict.UNKNOWN]
    assert "which the plant may leave" in str(left.reason)
    scheduled = _piecewise(
        lambda x1, x2, s: [0, 0, -s], lambda x1, x2, s: [sp.Piecewise((x1, sp.Mod(hg.t, 2) < 1), (x2, True)), s]
    )
    assert scheduled.verdict is Verdict.UNKNOWN


def test_what_a_map_forgets_is_determined_later() -> None:
    """v is not observable at sample 0, and v+ = w, w+ = u: after two samples it is an input. r is kept, and lost."""
    w, constant = S("w", "", "second", low=-1, high=1), S("k", "", "constant", low=-1, high=1)
    rows: dict[str, Any] = {"states": (p, v, w), "flow": [p / 2, w, u], "output": [p, p]}
    forgotten = hg.observability(cart(**rows)).known
    assert (forgotten.hidden, forgotten.later, forgotten.lost, forgotten.advice) == ((v, w), (v, w), (), "")
    assert "the outputs determine v, w at later samples all the same" in str(hg.observability(cart(**rows)).checks[0])
    rows |= {"states": (p, v, w, constant), "flow": [p / 2, w, u, constant]}
    lasting = hg.observability(cart(**rows)).known
    assert (lasting.later, lasting.lost) == ((v, w), (constant,))


def test_a_limit_of_an_input_is_no_branch_that_is_left() -> None:
    x, u = hg.Signal("x", low=-2, high=2), hg.Signal("u", low=-2, high=2)
    limited = hg.System(
        "limited",
        states=(x,),
        inputs=(u,),
        outputs=(hg.Signal("y"),),
        flow=[x / 2 + sp.Min(u, 1)],
        output=[x],
        discrete=True,
    )
    assert hg.observability(limited).checks[0].verdict is Verdict.GENERIC


def test_an_unknown_parameter() -> None:
    b = S("b", "", "gain", 0.5, low=0.1, high=1)
    plant = cart(parameters=(b,), flow=[p + v / 10, v * sp.Rational(9, 10) + b * u], output=[p, p])
    assert hg.observability(plant).joint.verdict is hg.Verdict.GENERIC
    hidden = cart(parameters=(b,), flow=[p + b * v, v], output=[p, p], inputs=())
    assert hg.observability(hidden).joint.hidden == (v, b)
    assert "sample 1" in str(hg.observability(hidden))


def test_a_hidden_direction_that_turns() -> None:
    """A field that the map carries to itself elsewhere: v(f(x)) and not v(x) has to be (df/dx) v."""
    plant = hg.System("turns", states=(p, v), outputs=(y,), flow=[p + v, p * v], output=[0 * p], discrete=True)
    assert hg.observability(plant).rank == 0
    scaled = hg.System(
        "scaled", states=(p, v, q), outputs=(y,), flow=[2 * p, v + 1, q], output=[p * 0 + q], discrete=True
    )
    assert {str(one): one.proved for one in hg.observability(scaled).known.symmetries} == {
        "p -> p + c": True,
        "v -> v + c": True,
    }
    product = hg.System("product", states=(p, v), outputs=(y,), flow=[p * p, v * v], output=[p * v], discrete=True)
    (one,) = hg.observability(product).known.symmetries
    assert str(one) == "p -> c p, v -> v/c"
    assert one.proved  # (2 p^2, -2 v^2) is twice the field at (p^2, v^2)


# ---------------------------------------------------------------- filters


@pytest.mark.parametrize("method", ["continuous_discrete", "cholesky"])
@pytest.mark.parametrize("first", ["update", "predict"])
@pytest.mark.parametrize("between", ["line", "hold"])
def test_the_extended_kalman_filter(method: str, first: Any, between: str) -> None:
    form = hg.forms.original(cart())
    observer = hg.observers.riccati(form, **NOISE)
    step = hg.sample(observer, getattr(hg.methods, method), dt=DT, first=first, between=between, engine="python")
    x, P = oracle.ekf(f, F, h, H, Q, VARIANCES, np.zeros(2), P0, U, Y, first, between)
    run = step.run(u=U, y=Y)
    assert run.x == pytest.approx(x, abs=1e-11)
    assert run.replay.innovations.covariance == pytest.approx(P, abs=1e-11)


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"), [(1.0, 2.0, 0.0), (0.1, 2.0, 0.0), (1.0, 0.0, 1.0), (1.0, 0.5, -0.5)]
)
def test_the_unscented_filter(alpha: float, beta: float, kappa: float) -> None:
    """Merwe's points, and with alpha = 1, beta = 0 those of Julier."""
    observer = hg.observers.ukf(hg.forms.original(cart()), **NOISE, alpha=alpha, beta=beta, kappa=kappa)
    run = hg.sample(observer, dt=DT, engine="python").run(u=U, y=Y)
    x, P = oracle.ukf(f, h, Q, VARIANCES, np.zeros(2), P0, U, Y, alpha, beta, kappa)
    assert run.x == pytest.approx(x, abs=1e-9)
    assert run.replay.innovations.covariance == pytest.approx(P, abs=1e-9)


def test_one_pass_of_the_iterated_filter_is_the_extended_one_up_to_the_row_of_its_covariance() -> None:
    plant = cart(output=[p, 2 * p - v])
    observer = hg.observers.iterated_ekf(hg.forms.original(plant), **NOISE)
    run = hg.sample(observer, dt=DT, engine="python").run(u=U, y=Y)

    def read(x: np.ndarray) -> np.ndarray:
        return np.array([x[0], 2 * x[0] - x[1]])

    def rows(x: np.ndarray) -> np.ndarray:
        return np.array([[1, 0], [2, -1]])

    x, _ = oracle.ekf(f, F, read, rows, Q, VARIANCES, np.zeros(2), P0, U, Y)
    assert run.x == pytest.approx(x, abs=1e-11)


def test_linear_with_missing_samples_and_several_outputs_is_the_kalman_filter_of_all_outputs_at_once() -> None:
    """With a diagonal R the order of the outputs is nothing: joint and sequential updates agree, masked ones too."""
    A, C = np.array([[1.0, 0.1], [-0.2, 0.9]]), np.array([[1.0, 0.0], [1.0, 2.0]])
    plant = cart(flow=list(sp.Matrix(A.tolist()) * sp.Matrix([p, v])), output=[p, p + 2 * v], inputs=())
    y = Y.copy()
    y[40:60] = np.nan
    run = hg.sample(hg.observers.riccati(hg.forms.original(plant), **NOISE), dt=DT, engine="python").run(y=y)
    x, P, states = np.zeros(2), P0, []
    for k, sample in enumerate(y):
        x, P = (A @ x, A @ P @ A.T + Q) if k else (x, P)
        there = np.isfinite(sample)
        if there.any():
            rows = C[there]
            K = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + np.diag(VARIANCES[there]))
            x, P = x + K @ (sample[there] - rows @ x), P - K @ rows @ P
        states.append(x)
    assert run.x == pytest.approx(np.array(states), abs=1e-9)
    assert run.replay.innovations.covariance[-1] == pytest.approx(P, abs=1e-9)


@pytest.mark.parametrize("case", ["riccati", "ukf"])
def test_all_outputs_at_once_with_a_full_covariance_of_their_noise(case: str) -> None:
    """Masked samples take their rows and columns of R with them."""
    R = np.array([[0.04, 0.005], [0.005, 0.01]])
    arguments = {"Q": Q, "R": R, "covariance": P0, "update": "joint"}
    run = hg.sample(getattr(hg.observers, case)(hg.forms.original(cart()), **arguments), dt=DT, engine="python").run(
        u=U, y=Y
    )
    x, P, states = np.zeros(2), P0, []
    for k, sample in enumerate(Y):
        known = np.isfinite(sample)
        if case == "riccati":
            slope = F(x, U[k - 1])
            x, P = (f(x, U[k - 1]), slope @ P @ slope.T + Q) if k else (x, P)
            rows, mean = H(x)[known], h(x)[known]
            cross, S = P @ rows.T, rows @ P @ rows.T
        else:
            every, w, c = oracle.points(x, P, 1, 2, 0)
            after = np.array([f(point, U[k - 1]) for point in every])
            x, P = (w @ after, (c[:, None] * (after - w @ after)).T @ (after - w @ after) + Q) if k else (x, P)
            every, w, c = oracle.points(x, P, 1, 2, 0)
            read = np.array([h(point) for point in every])[:, known]
            mean = w @ read
            cross, S = (c[:, None] * (every - x)).T @ (read - mean), (c[:, None] * (read - mean)).T @ (read - mean)
        if known.any():
            S = S + R[np.ix_(known, known)]
            K = cross @ np.linalg.inv(S)
            x, P = x + K @ (sample[known] - mean), P - K @ S @ K.T
        states.append(x)
    assert run.x == pytest.approx(np.array(states), abs=1e-9)


def test_nothing_is_scaled_by_the_period() -> None:
    form = hg.forms.original(cart())
    runs = [
        hg.sample(hg.observers.riccati(form, **NOISE), dt=dt, engine="python").run(u=U, y=Y) for dt in (1e-3, 0.1, 50)
    ]
    assert np.array_equal(runs[0].x, runs[1].x)
    assert np.array_equal(runs[0].x, runs[2].x)
    assert runs[2].t[1] == 50


@pytest.mark.full
def test_every_spelling_of_the_noise_is_of_one_sample() -> None:
    form, R = hg.forms.original(cart()), {"y": 0.04, "r": 0.01}
    spelled: tuple[dict[str, Any], ...] = (
        {"Q": Q, "R": R},
        {"Q_per_sample": Q, "R_per_sample": R},
        {"Q": Q, "noise": {"y": 0.2, "r": 0.1}},
    )
    for case in (hg.observers.riccati, hg.observers.ekf):
        runs = [hg.sample(case(form, **one), dt=DT, engine="python").run(u=U, y=Y).x for one in spelled]
        assert runs[1] == pytest.approx(runs[0], abs=1e-13)
        assert runs[2] == pytest.approx(runs[0], abs=1e-13)
    with pytest.raises(hg.HgogenError, match="density = True is for differential equations"):
        hg.observers.riccati(form, Q=Q, R=R, density=True)


def test_a_singular_map_without_noise() -> None:
    """A delay: x3+ = x1, where F is singular and Q has no noise, in straight-line code and with roots."""
    a, b = S("a", low=-9, high=9), S("b", low=-9, high=9)
    plant = hg.System("delay", states=(a, b), outputs=(y,), flow=[sp.Rational(1, 2) * a, a], output=[b], discrete=True)
    A, C = np.array([[0.5, 0.0], [1.0, 0.0]]), np.array([[0.0, 1.0]])
    Q, x, P, states = np.zeros((2, 2)), np.array([1.0, -1.0]), np.eye(2), []
    for k in range(30):
        x, P = (A @ x, A @ P @ A.T + Q) if k else (x, P)
        K = P @ C[0] / (P[1, 1] + 0.1)
        x, P = x + K * (np.sin(k) - x[1]), P - np.outer(K, P[1])
        states.append(x)
    samples = np.sin(np.arange(30.0))
    for method in (hg.methods.continuous_discrete, hg.methods.cholesky):
        observer = hg.observers.riccati(hg.forms.original(plant), Q=Q, R=0.1, initial=(1, -1))
        for guards in ("all", "none"):
            run = hg.sample(observer, method, dt=1, engine="python", guards=guards).run(y=samples)  # type: ignore[arg-type]
            assert run.x == pytest.approx(np.array(states), abs=1e-9)


# ---------------------------------------------------------------- logs


def pushed() -> tuple[hg.System, hg.Log]:
    """A cart with unknown friction and force, 0.8 and 0.5, and a log of it with noise."""
    force, friction = hg.Signal("force", "", "", 0.2, 0.01, 1), hg.Signal("friction", "", "", 0.7, 0.4, 1)
    flow = [p + v / 10, friction * v + force * u]
    plant = cart(outputs=(y,), parameters=(friction, force), flow=flow, output=[p])
    rng, x, rows = np.random.default_rng(0), np.array([1.0, 0.5]), []
    inputs = np.sign(np.sin(0.11 * np.arange(200))) / 2
    for now in inputs:
        rows.append(x[0] + rng.normal(0, 0.02))
        x = np.array([x[0] + x[1] / 10, 0.8 * x[1] + now / 2])
    return plant, hg.Log(inputs[:, None], np.array(rows)[:, None], DT)


def test_a_fit_is_that_of_least_squares() -> None:
    plant, log = pushed()

    def residuals(q: np.ndarray) -> list[float]:
        x, errors = q[2:], []
        for now, sample in zip(log.u[:, 0], log.y[:, 0], strict=True):
            errors.append(x[0] - sample)
            x = np.array([x[0] + x[1] / 10, q[0] * x[1] + q[1] * now])
        return errors

    least = least_squares(residuals, [0.9, 0.2, 0, 0], xtol=1e-10).x
    fitted = hg.fit(plant, log, starts=1)
    assert [*fitted.values.values(), *fitted.first[0].values()] == pytest.approx(least, rel=1e-4)
    assert [fitted.values["friction"], fitted.values["force"]] == pytest.approx([0.8, 0.5], rel=1e-2)


def kalman_cost(
    A: np.ndarray, B: np.ndarray, process: np.ndarray, r: float, x: np.ndarray, P: np.ndarray, log: Any
) -> Any:
    """-log of the likelihood of a log of x+ = A x + B u, y = x_1 by the Kalman filter, from the prediction x and P."""
    cost = 0.0
    for now, sample in zip(log.u, log.y[:, 0], strict=True):
        s = P[0, 0] + r
        cost += ((sample - x[0]) ** 2 / s + np.log(s)) / 2
        x, P = x + P[:, 0] / s * (sample - x[0]), P - np.outer(P[:, 0], P[0]) / s
        x, P = A @ x + B @ now, A @ P @ A.T + np.diag(process)
    return cost


def decaying() -> hg.System:
    """x+ = A x, y = p."""
    return cart(outputs=(y,), inputs=(), flow=[p * 0.9 + v * 0.2, 0.7 * v], output=[p])


@pytest.mark.full
def test_gains_from_a_log_are_the_most_likely_of_a_sample() -> None:
    """By the likelihood in numpy; the period, 7 s, scales nothing."""
    A, rng, x, rows = np.array([[0.9, 0.2], [0, 0.7]]), np.random.default_rng(4), np.zeros(2), []
    for _ in range(150):
        rows.append(x[0] + rng.normal(0, 0.3))
        x = A @ x + rng.normal(size=2) * (0.1, 0.4)
    log = hg.Log(np.empty((150, 0)), np.array(rows)[:, None], 7.0)
    tuned = hg.tune(decaying(), log, observers=("riccati",))
    noise, table = tuned.best.noise, tuned.best.table
    assert noise
    assert [*tuned.refused] == ["adaptive"]
    assert "speeds up the correction of differential equations" in tuned.refused["adaptive"]
    later = replace(log, y=log.y[1:], u=log.u[1:])  # the first sample corrects nothing

    def cost(logs: Any) -> Any:
        process, start = np.exp(logs[:2]), np.diag([2500, 6.25])
        P = A @ start @ A.T + np.diag(process)
        return kalman_cost(A, np.empty((2, 0)), process, np.exp(logs[2]), A @ [log.y[0, 0], 0], P, later)

    least = minimize(cost, np.log([0.01, 0.1, 0.1]), method="Nelder-Mead", options={"fatol": 1e-9}).x
    assert cost(np.log([*noise.process.values(), noise.sample["y"] ** 2])) == pytest.approx(cost(least), abs=1e-4)
    assert table["R"] == pytest.approx(noise.sample["y"] ** 2, rel=0.06)
    assert table["dt"] == 7


def test_first_gains_are_those_of_a_sample() -> None:
    """p moves by at most 11 in a sample, of a range of 200, and by 0.2 v; v by 1.5, of 10."""
    plant, noise = decaying(), {"y": 0.3}
    first = hg.starting_gains(hg.forms.original(plant), hg.observers.riccati, dt=DT, noise=noise)
    assert (first.dt, first.gains["R"]) == (DT, 0.09)
    crossing = 200 / 11
    q = 5**2 / crossing
    assert [*first.gains["Q"].values()] == pytest.approx([(0.2 * crossing) ** 2 * q, q], rel=0.15)
    assert first.gains == hg.starting_gains(hg.forms.original(plant), hg.observers.ukf, dt=7, noise=noise).gains
    advised, refused = hg.advise(plant, dt=DT, noise=noise)
    assert {one.name: one.table["dt"] for one in advised} == dict.fromkeys(("riccati", "ukf", "iterated_ekf"), DT)
    assert not refused
    with pytest.raises(hg.HgogenError, match="declare a trial"):
        hg.proposed_trial(plant)


def test_the_short_answer_makes_its_filter(tmp_path: Path) -> None:
    """`check` prints the entry that makes the extended Kalman filter, and with the entry the command."""
    file = tmp_path / "decaying.toml"
    file.write_text(to_text(decaying()))
    answer = CliRunner().invoke(app, ["check", str(file)]).output
    (entry,) = re.findall(r"tuning\.riccati = .*", answer)
    assert "high-gain observers do not apply" in " ".join(answer.split())
    assert "take riccati, the extended Kalman filter, in the plant's own states, with starting" in " ".join(
        answer.split()
    )
    file.write_text(entry.replace("tuning.riccati = {", 'observer = {kind = "riccati", ') + "\n" + file.read_text())
    answer = CliRunner().invoke(app, ["check", str(file)]).output
    assert "with the gains of the model:" in " ".join(answer.split())
    assert f"hgogen generate {file}" in answer


@pytest.mark.full
def test_a_fit_by_prediction_is_at_the_least_cost() -> None:
    """At its own R and first state, with Q that of a sample whatever the period."""
    plant, log = pushed()
    fitted, late = (hg.fit(plant, replace(log, dt=dt), by="prediction", starts=1, between="line") for dt in (DT, 7.0))
    assert late.values == pytest.approx(fitted.values, rel=1e-6)
    (process, sample), first = fitted.noise, np.array([*fitted.first[0].values()])

    def cost(values: Any) -> Any:
        A, B = np.array([[1, 0.1], [0, values[0]]]), np.array([[0.0], [values[1]]])
        return kalman_cost(A, B, np.array([*process.values()]), sample["y"] ** 2, first, np.zeros((2, 2)), log)

    least = minimize(cost, [0.75, 0.45], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9})
    assert [*fitted.values.values()] == pytest.approx(least.x, rel=1e-3)


def test_a_map_that_grows_has_segments_in_which_errors_stay() -> None:
    plant, log = pushed()
    assert steps_and_growth(plant, DT) == (1, pytest.approx(0, abs=1e-9))
    steep = cart(outputs=(y,), flow=[1.5 * p, v], output=[p])
    assert steps_and_growth(steep, DT) == (1, pytest.approx(np.log(1.5) / DT))
    with pytest.raises(hg.HgogenError, match="is discrete in time, and a lag"):
        hg.fit(plant, log, lag=("y",))
    with pytest.raises(hg.HgogenError, match="is discrete in time; give one of one period"):
        hg.fit(plant, replace(log, times=np.arange(200) ** 1.01))


# ---------------------------------------------------------------- the shipped one


def test_the_radar_of_the_shipped_model_in_numpy() -> None:
    """Its filter, with both samples at the prediction and the bearing the short way round, as the target passes the
    west, where the bearing jumps by a turn."""
    model = load("radar_track")
    step, (track,) = model.step(), model.trials()
    (flight,) = hg.trial.try_out(step, track, "python", seeds=(0,))
    assert np.abs(np.diff(flight.y[:, 1])).max() > 6
    A = np.eye(4) + np.diag([0.5, 0.5], 2)
    x, P, Q, R = (
        np.array([-1400.0, -800, 0, 0]),
        np.diag([1e4, 1e4, 900, 900.0]),
        [0.004, 0.004, 0.0625, 0.0625],
        [100, 1e-4],
    )
    for k, sample in enumerate(flight.y):
        if k:
            x, P = A @ x, A @ P @ A.T + np.diag(Q)
        r = np.hypot(x[0], x[1])
        H = np.array([[x[0] / r, x[1] / r, 0, 0], [-x[1] / r**2, x[0] / r**2, 0, 0]])
        e = sample - [r, np.arctan2(x[1], x[0])]
        e[1] -= 2 * np.pi * np.round(e[1] / (2 * np.pi))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R))
        x, P = x + K @ e, P - K @ H @ P
        assert flight.x[k] == pytest.approx(x, rel=1e-9, abs=1e-8)
    late = np.abs(flight.error[60:])
    assert (late.max(axis=0) < (20, 30, 3, 4)).all()


# ---------------------------------------------------------------- what refuses a discrete plant


OF_PLANTS = ("error_system", "observer_errors", "gramian", "recast", "with_disturbance")


@pytest.mark.parametrize("name", OF_PLANTS)
def test_what_is_about_differential_equations_refuses_it(name: str) -> None:
    call: Callable[..., Any] = getattr(hg, name)
    empty = [each for each in inspect.signature(call).parameters.values() if each.default is each.empty]
    with pytest.raises(hg.HgogenError, match=f"is discrete in time, .*: {name} is for differential equations"):
        call(cart(), *([None] * sum(each.kind is each.POSITIONAL_OR_KEYWORD for each in empty[1:])))


def test_every_other_form_and_observer_refuses_it() -> None:
    plant = cart()
    for name in hg.forms.__all__:
        if name != "original":
            with pytest.raises(hg.HgogenError, match=f"{name} is for differential equations"):
                getattr(hg.forms, name)(plant)
    form, filters = hg.forms.original(plant), {"riccati", "ukf", "iterated_ekf"}
    for name in set(hg.observers.__all__) - filters:
        case = getattr(hg.observers, name)
        noise = {key: np.ones(2) for key in ("Q", "R") if key in inspect.signature(case).parameters}
        first = hg.observers.riccati(form, **NOISE) if name == "bank" else form
        needed = {
            each.name: 2.0
            for each in inspect.signature(case).parameters.values()
            if each.kind is each.KEYWORD_ONLY and each.default is each.empty
        }
        with pytest.raises(hg.HgogenError, match=r"is for differential equations|takes the form state_affine"):
            case(first, **{**needed, **noise})


@pytest.mark.parametrize("name", ["gain", "constant_gain", "injection_filter", "slope", "steady_gain"])
def test_no_gain_is_designed_of_it(name: str) -> None:
    call: Callable[..., Any] = getattr(hg.design, name)
    _, *others = (each.name for each in inspect.signature(call).parameters.values() if each.default is each.empty)
    with pytest.raises(hg.HgogenError, match=f"{name} is for differential equations"):
        call(hg.forms.original(cart()), **dict.fromkeys(others))


def test_no_proof_is_made_of_it() -> None:
    form = hg.forms.original(cart())
    observer = hg.observers.riccati(form, **NOISE)
    assert not any(check.verdict is hg.Verdict.PROVED for check in observer.checks if check.id.maker == "riccati")
    step = hg.sample(observer, dt=DT)
    assert hg.contraction(step).rate is None
    for nothing in (hg.noise_gain(step), hg.start_set(step)):
        assert "constant injection" in str(nothing)
    for call in (
        lambda: hg.certificate(form, observer.checks),
        lambda: hg.reference(step, U, Y),
        lambda: hg.response(step, 1.0),
        lambda: hg.design.constant_gain(form),
        lambda: hg.design.steady_gain(form, Q=(1, 1), R=1.0, at=None),
        lambda: hg.design.gain(form, rate=1.0),
        lambda: hg.design.slope(form),
        lambda: hg.design.injection_filter(form, theta=1.0, rate=1.0),
        lambda: hg.excitation.along(form, 1.0, U, Y, DT, 1.0),
    ):
        with pytest.raises(hg.HgogenError, match="is for differential equations"):
            call()
    assert not hg.singularity(cart()).jets


@pytest.mark.parametrize("method", ["rk4", "heun", "euler", "rk4_covariance", "bilinear", "exponential"])
def test_a_method_that_integrates_refuses_it(method: str) -> None:
    with pytest.raises(hg.HgogenError, match="take continuous_discrete"):
        hg.sample(hg.observers.riccati(hg.forms.original(cart()), **NOISE), getattr(hg.methods, method), dt=DT)


def test_settings_that_are_for_one_kind_of_plant() -> None:
    form = hg.forms.original(cart())
    with pytest.raises(hg.HgogenError, match="theta = 3 speeds up"):
        hg.observers.riccati(form, **NOISE, theta=3)
    continuous = cart(discrete=False)
    observer = hg.observers.riccati(hg.forms.original(continuous), **NOISE)
    with pytest.raises(hg.HgogenError, match='first = "predict" is for discrete plants'):
        hg.sample(observer, dt=DT, first="predict")
    with pytest.raises(hg.HgogenError, match='must be "update" or "predict"'):
        hg.sample(hg.observers.riccati(form, **NOISE), dt=DT, first="correct")  # type: ignore[arg-type]
    with pytest.raises(hg.HgogenError, match="give dt as a number"):
        hg.sample(hg.observers.riccati(form, **NOISE), dt=(0.1, 0.2))  # type: ignore[arg-type]
    with pytest.raises(hg.HgogenError, match="sensors that all have the period dt"):
        hg.sample(hg.observers.riccati(form, **NOISE), dt=DT, first="predict", periods={"r": 0.2})


# ---------------------------------------------------------------- constant gains


GAINS = {"y": (0.3, 0.4), "r": {"p": 0.05, "v": 0.1}}


def test_constant_gains() -> None:
    observer = hg.observers.luenberger(hg.forms.original(cart()), gains=GAINS)
    run = hg.sample(observer, dt=DT, engine="python").run(u=U, y=Y)
    x, states, K = np.zeros(2), [], np.array([[0.3, 0.4], [0.05, 0.1]])
    for k in range(N):
        x = f(x, U[k - 1]) if k else x
        for j in np.flatnonzero(np.isfinite(Y[k])):
            x = x + K[j] * (Y[k, j] - h(x)[j])
        states.append(x)
    assert run.x == pytest.approx(np.array(states), abs=1e-12)
    assert run.replay.innovations.variances is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"gains": (0.3, 0.4)}, "must be 2 finite numbers for each of 2 outputs"),
        ({"gains": {"y": (1, 2, 3), "r": (1, 2)}}, "must be 2 finite numbers"),
        ({}, "takes gains"),
        ({"gains": {"y": (-5, 0), "r": (0, 0)}}, "let the error grow at every point"),
        ({"poles": (0.1, 0.2)}, "poles= is for differential equations"),
    ],
)
def test_gains_that_are_none(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(hg.HgogenError, match=said):
        hg.observers.luenberger(hg.forms.original(cart()), **arguments)


def test_an_error_that_only_the_map_makes_decay() -> None:
    """Without a gain of its own v decays by the map alone; p by its gain, and not without one."""
    plant = cart(flow=[p + v, v / 2], output=[p, p], inputs=())
    observer = hg.observers.luenberger(hg.forms.original(plant), gains={"y": (0.5, 0), "r": (0, 0)})
    assert observer.name == "luenberger"
    with pytest.raises(hg.HgogenError, match="let the error grow at every point"):
        hg.observers.luenberger(hg.forms.original(plant), gains={"y": (0, 0), "r": (0, 0)})


def test_gains_that_converge_by_turns_only_are_taken() -> None:
    """Frozen, p or v doubles; by turns of w = 1 and -1 both shrink by 0.6 in two samples. No turns save 2 and 2."""
    shrinking, w = sp.Rational(85, 100), hg.Signal("w", "", "switch", low=-1, high=1)
    rows = [(sp.Rational(115, 100) - shrinking * w) * p, (sp.Rational(115, 100) + shrinking * w) * v]
    plant = cart(flow=rows, output=[p, v], inputs=(w,))
    observer = hg.observers.luenberger(hg.forms.original(plant), gains={"y": (0, 0), "r": (0, 0)}, initial=(1, 1))
    run = hg.sample(observer, dt=DT, engine="python").run(u=(-1.0) ** np.arange(N)[:, None], y=np.zeros((N, 2)))
    assert np.abs(run.x[-1]).max() < 1e-3
    decay = next(check for check in observer.checks if check.id == "luenberger.decay")
    assert decay.verdict is hg.Verdict.UNKNOWN
    assert str(decay.reason).startswith("frozen at points of the ranges it decays at 0 of ")
    growing = cart(flow=[2 * p, 2 * v + w], output=[p, v], inputs=(w,))
    with pytest.raises(hg.HgogenError, match="let the error grow at every point"):
        hg.observers.luenberger(hg.forms.original(growing), gains={"y": (0, 0), "r": (0, 0)})


# ---------------------------------------------------------------- targets

OBSERVERS: dict[str, Callable[[hg.Form], hg.Observer]] = {
    "riccati": lambda form: hg.observers.riccati(form, **NOISE),
    "ukf": lambda form: hg.observers.ukf(form, **NOISE),
    "iterated_ekf": lambda form: hg.observers.iterated_ekf(form, **NOISE),
    "luenberger": lambda form: hg.observers.luenberger(form, gains=GAINS),
}


@needs_compiler
@pytest.mark.full
@pytest.mark.parametrize("name", OBSERVERS)
@pytest.mark.parametrize("real", ["float", "double"])
def test_every_reader_computes_the_same_bits(name: str, real: Any) -> None:
    step = hg.sample(OBSERVERS[name](hg.forms.original(cart())), dt=DT, real=real)
    in_c, python = (step.run(u=U, y=Y, engine=engine) for engine in ("c", "python") if not step.reset())
    assert np.array_equal(in_c.x, python.x)
    assert np.array_equal(in_c.status, python.status)
    step.reset()
    many = step.run_many(u=np.stack([U, -U]), y=np.stack([Y, Y]))
    assert np.array_equal(many.x[0], in_c.x)
    step.reset()
    one_by_one = np.array([step(u=U[k], y=Y[k]).x for k in range(N)])
    assert np.array_equal(one_by_one, in_c.x)


@pytest.mark.parametrize("name", OBSERVERS)
def test_as_casadi(name: str) -> None:
    step = hg.sample(OBSERVERS[name](hg.forms.original(cart())), dt=DT, engine="python")
    made = hg.targets.casadi(step)
    _, x, _ = made.step.mapaccum(N)(made.memory.initial, U.T, Y.T, made.p.initial)
    assert step.run(u=U, y=Y).x == pytest.approx(np.array(x).T, abs=1e-7)  # whose sine is another one
    with pytest.raises(hg.HgogenError, match="is no differential equation"):
        made.derivative  # noqa: B018


def test_the_header_says_which_input_moves_the_plant() -> None:
    form = hg.forms.original(cart())
    texts = {}
    for between, first in (("line", "update"), ("hold", "predict")):
        step = hg.sample(hg.observers.riccati(form, **NOISE), dt=DT, between=between, first=first)  # type: ignore[arg-type]
        texts[between] = hg.targets.c99(step)["cart.h"]
        assert "p+ = p + v/10" in texts[between]
        assert "p' =" not in texts[between]
        assert "discrete, L D L', dt = 0.1 s" in texts[between]
        assert "no certificate is made of a discrete plant" in texts[between]
    assert "The input of a call moves the plant from this call to the next" in texts["line"]
    assert "The first call advances no time" in texts["line"]
    assert "The input of a call moved the plant from the call before to this one" in texts["hold"]
    assert "The first call predicts" in texts["hold"]
    manual = hg.targets.markdown(step)["cart.md"]
    assert "z^+ &=" in manual
    assert "straight line" not in manual


@pytest.mark.full
def test_forty_states_in_loops() -> None:
    """A ring of forty states, by the same equations in numpy."""
    n, rng = 40, np.random.default_rng(4)
    xs = [S(f"x{i}", low=-10, high=10) for i in range(n)]
    rows = [0.7 * x + 0.2 * sp.sin(xs[(i + 1) % n]) for i, x in enumerate(xs)]
    plant = hg.System("ring", states=xs, outputs=(y,), flow=rows, output=[xs[0]], discrete=True)
    samples = rng.normal(size=40)
    step = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=np.full(n, 0.01), R=0.1), dt=1, engine="python")
    x, P, states = np.zeros(n), np.eye(n), []
    for k, sample in enumerate(samples):
        if k:
            slope = 0.7 * np.eye(n) + 0.2 * np.roll(np.diag(np.cos(np.roll(x, -1))), 1, axis=1)
            x, P = 0.7 * x + 0.2 * np.sin(np.roll(x, -1)), slope @ P @ slope.T + 0.01 * np.eye(n)
        K = P[0] / (P[0, 0] + 0.1)
        x, P = x + K * (sample - x[0]), P - np.outer(K, P[0])
        states.append(x)
    assert step.run(y=samples).x == pytest.approx(np.array(states), abs=1e-9)


def test_delays_that_loops_cannot_rotate() -> None:
    xs = [S(f"x{i}", low=-10, high=10) for i in range(14)]
    plant = hg.System("delay", states=xs, outputs=(y,), flow=[xs[0], *xs[:-1]], output=[xs[-1]], discrete=True)
    with pytest.raises(hg.HgogenError, match="has a singular Jacobian df/dx"):
        hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=np.ones(14), R=0.1), dt=1)
    few = hg.System("delay", states=xs[:9], outputs=(y,), flow=[xs[0], *xs[:8]], output=[xs[8]], discrete=True)
    step = hg.sample(hg.observers.riccati(hg.forms.original(few), Q=np.ones(9), R=0.1), dt=1, prefer="flash")
    assert "as for delays in a map" in step.choice
    assert not step.run(y=np.ones(30), engine="python").status.any()


# ---------------------------------------------------------------- trials


def trial(**changed: Any) -> hg.trial.Trial:
    declared = {"duration": 10, "start": {"p": 3, "v": 1}, "inputs": {"u": sp.sin(hg.trial.t)}, "seeds": (0,)}
    return hg.trial.Trial("drive", **{**declared, **changed})


def test_the_truth_of_a_trial_is_the_iteration_of_the_map() -> None:
    jump = hg.trial.Jump(2.03, "v", -1.0)
    truth = hg.trial.simulate(cart(), trial(jumps=(jump,)), DT)
    x = np.array([3.0, 1.0])
    for k in range(101):
        x = f(x, np.sin([(k - 1) * DT])) if k else x
        x = np.array([x[0], -1.0]) if k == 21 else x
        assert truth.x[k] == pytest.approx(x, abs=1e-12)
    with pytest.raises(hg.HgogenError, match="no finite value before t"):
        hg.trial.simulate(cart(flow=[p * p, v]), trial(), DT)


def test_a_campaign_and_a_consistent_filter() -> None:
    noise = {"y": 0.2, "r": 0.1}
    step = hg.sample(hg.observers.riccati(hg.forms.original(cart()), **NOISE), dt=DT, engine="python")
    b = S("b", "", "gain", 0.1, low=0.05, high=0.2)
    varied = cart(parameters=(b,), flow=[p + v / 10, v * sp.Rational(9, 10) + b * u])
    other = hg.sample(hg.observers.riccati(hg.forms.original(varied), **NOISE), dt=DT, engine="python")
    (one,) = hg.trial.try_out(step, trial(noise=noise))
    assert np.abs(one.error[20:]).max() < 0.6
    outcomes = list(hg.campaign(other, trial(noise=noise), 4, vary="b", engine="python").run(jobs=1))
    assert len(outcomes) == 4
    assert all(each.metrics is not None for each in outcomes)


def test_a_log_of_another_spacing_is_refused(tmp_path: Path) -> None:
    """A row that is missing on the grid is a missing sample; a map is not for rows at other times."""
    plant, file = cart(), tmp_path / "log.csv"

    def write(times: np.ndarray) -> None:
        rows = np.column_stack([times, np.sin(times), np.cos(times), np.cos(times)])
        np.savetxt(file, rows, delimiter=",", header="t,u,y,r", comments="")

    regular = np.delete(np.arange(60) * DT, [7, 8, 30])
    write(regular)
    log = hg.record(file, plant, time="t")
    assert log.dt == pytest.approx(DT)
    assert np.isnan(log.y[[7, 8, 30]]).all()
    for times, dt in ((regular, 0.2), (regular, 0.05), (np.cumsum(np.tile([0.08, 0.12], 30)), None)):
        write(times)
        with pytest.raises(hg.HgogenError, match="discrete in time; resample it"):
            hg.record(file, plant, time="t", dt=dt)
        assert len(hg.record(file, cart(discrete=False), time="t", dt=dt).y)


def test_predictions_ahead_iterate_the_map() -> None:
    from hgogen.run.prediction import forecasts

    step = hg.sample(hg.observers.riccati(hg.forms.original(cart()), **NOISE), dt=DT, engine="python")
    run = step.run(u=U, y=Y)
    (ahead,) = [one for one in forecasts(step, run, U, Y, (3,)) if one.ahead == 3]
    for k in np.flatnonzero(ahead.compared.all(axis=1))[:20]:
        x = run.x[k - 3]
        for j in range(k - 3, k):
            x = f(x, U[j])
        assert ahead.model[k] == pytest.approx(h(x) - Y[k], abs=1e-9)


def test_late_samples_are_fused_in_their_period() -> None:
    observer = hg.observers.riccati(hg.forms.original(cart()), **NOISE)
    late = hg.sample(hg.delayed(observer, y=3), dt=DT, engine="python")
    arriving = late.run(u=U, y=late.arriving(Y)).x
    x, P = np.zeros(2), P0
    known = np.where((np.arange(N) > N - 4)[:, None] & np.array([True, False]), np.nan, Y)  # not yet come at the end
    for k, now in oracle.moved(U, "update", "line"):
        if now is not None:
            slope = F(x, now)
            x, P = f(x, now), slope @ P @ slope.T + Q
        for j in np.flatnonzero(np.isfinite(known[k])):
            row = H(x)[j]
            K = P @ row / (row @ P @ row + VARIANCES[j])
            x, P = x + K * (known[k, j] - h(x)[j]), P - np.outer(K, row @ P)
    assert arriving[-1] == pytest.approx(x, abs=1e-9)
