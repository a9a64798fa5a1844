"""Joint updates against filters in numpy: several outputs, an angle, correlated noise, missing samples, invariants."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from oracle import joint

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.noise import sample_deviations
from hgogen.model import load
from hgogen.reading.given import BadGain, field_text
from hgogen.run import native

DT, N = 0.1, 250
FULL = np.array([[0.04, 0.006, -0.01], [0.006, 0.0025, 0.002], [-0.01, 0.002, 0.09]])
DIAGONAL = np.diag(np.diag(FULL))
Q = np.diag([1e-3, 1e-3, 1e-2])
START = {"px": 8.0, "py": 1.0, "psi": 2.0}
P0 = np.diag([4.0, 4.0, 0.3])
TURN = 2 * np.pi
INF = np.inf


@cache
def cart(name: str = "beacon") -> hg.System:
    """A cart that measures the distance of a beacon, its bearing, which wraps, and its own place on one axis."""
    px, py = hg.Signal("px", "m", low=1, high=60), hg.Signal("py", "m", low=-60, high=60)
    psi = hg.Signal("psi", "rad", period=TURN)
    v, w = hg.Signal("v", "m/s", low=-4, high=4), hg.Signal("w", "rad/s", low=-2, high=2)
    rho, bearing, x = hg.Signal("rho", "m"), hg.Signal("bearing", "rad", period=TURN), hg.Signal("x", "m")
    flow = [v * sp.cos(psi), v * sp.sin(psi), w]
    output = [sp.sqrt(px**2 + py**2), sp.atan2(py, px) - psi, px]
    return hg.System(name, states=(px, py, psi), inputs=(v, w), outputs=(rho, bearing, x), flow=flow, output=output)


def model() -> joint.Model:
    def f(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([u[0] * np.cos(z[2]), u[0] * np.sin(z[2]), u[1]])

    def F(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([[0, 0, -u[0] * np.sin(z[2])], [0, 0, u[0] * np.cos(z[2])], [0, 0, 0]])

    def h(z: np.ndarray) -> np.ndarray:
        return np.array([np.hypot(z[0], z[1]), np.arctan2(z[1], z[0]) - z[2], z[0]])

    def H(z: np.ndarray) -> np.ndarray:
        r = np.hypot(z[0], z[1])
        return np.array([[z[0] / r, z[1] / r, 0], [-z[1] / r**2, z[0] / r**2, -1], [1, 0, 0]])

    return joint.Model(f, F, h, H, (np.array([INF, INF, TURN]), np.array([INF, TURN, INF])))


def test_what_is_printed_of_a_full_R_is_R() -> None:
    form = hg.forms.original(cart())
    observer = hg.observers.riccati(form, Q_per_sample=Q, R_per_sample=FULL, update="joint")
    step = hg.sample(observer, dt=DT)
    assert sample_deviations(step) == pytest.approx(
        dict(zip(("rho", "bearing", "x"), np.sqrt(np.diag(FULL)), strict=True))
    )
    texts = [field_text(field) for field in step.layout.gains]
    assert any(text.startswith("D of R = L D L' = {rho: 0.004, bearing: ") for text in texts)
    alone = hg.sample(hg.observers.riccati(form, Q=Q, R_per_sample=0.1**2, update="joint"), dt=0.1)
    assert "R = {rho: 0.001, bearing: 0.001, x: 0.001}" in [field_text(field) for field in alone.layout.gains]


@cache
def log() -> tuple[np.ndarray, np.ndarray]:
    """Inputs, and samples of which some are missing in every pattern."""
    rng, t = np.random.default_rng(7), DT * np.arange(N)
    u = np.column_stack((1.5 + 0.5 * np.sin(t / 2), 0.6 + 0.3 * np.cos(t / 3)))
    z, states = np.array([9.0, 0.0, 2.2]), []
    for k in range(N):
        states.append(z)
        z = joint.advanced(model(), z, (u[k], u[min(k + 1, N - 1)]), DT)[0]
    y = np.array([model().h(each) for each in states]) + rng.multivariate_normal(np.zeros(3), FULL, N)
    y[:, 1] = joint.short(y[:, 1], np.array(TURN))
    patterns = rng.random((N, 3)) < 0.25
    y[patterns] = np.nan
    return u, y


def made(kind: str = "riccati", R: Any = FULL, method: Any = None, **options: Any) -> hg.Step:
    gains = {"Q": Q, "R_per_sample": R, "covariance": P0, "initial": START, "update": "joint"}
    accept = [f"{form().kind}.{each}" for each in ("lipschitz", "order", "connected")]
    observer = getattr(hg.observers, kind)(form(), accept=accept, **{**gains, **options})
    return hg.sample(observer, method or hg.methods.continuous_discrete, dt=DT, engine="python")


@cache
def form() -> hg.Form:
    return hg.forms.original(cart())


def off(run: Any, expected: np.ndarray) -> float:
    turns = np.array([INF, INF, TURN])
    return float(np.abs(joint.short(run.x - expected, turns)).max())


@pytest.mark.parametrize("R", [FULL, DIAGONAL], ids=["full", "diagonal"])
@pytest.mark.parametrize("method", [hg.methods.continuous_discrete, hg.methods.cholesky], ids=["ldl", "root"])
def test_it_is_an_extended_filter_in_numpy(method: Any, R: np.ndarray) -> None:
    expected, _ = joint.run("riccati", model(), (Q, R), (np.array([*START.values()]), P0), DT, log())
    assert off(made(R=R, method=method).run(*log()), expected) < 1e-9


def test_the_sequential_filter_is_another_one() -> None:
    plain = made(R=DIAGONAL, update="sequential").run(*log())
    assert off(plain, made(R=DIAGONAL).run(*log()).x) > 1e-4


SCALED = {
    "defaults": {},
    "julier": {"kappa": 0.5},
    "merwe": {"alpha": 0.5, "beta": 2.0, "kappa": 0.0},
    "even": {"beta": 0.0},
}


@pytest.mark.parametrize("R", [FULL, DIAGONAL], ids=["full", "diagonal"])
@pytest.mark.parametrize("name", SCALED)
def test_it_is_an_unscented_filter_in_numpy(name: str, R: np.ndarray) -> None:
    scaled = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0} | SCALED[name]
    start = (np.array([*START.values()]), P0)
    expected, _ = joint.run("ukf", model(), (Q, R), start, DT, log(), scaled=tuple(scaled.values()))
    step = made("ukf", R=R, **scaled)
    run = step.run(*log())
    assert off(run, expected) < 1e-9
    assert "POINTS_LIMITED" not in step.flags(int(np.bitwise_or.reduce(run.status)))


@pytest.mark.parametrize("R", [FULL, DIAGONAL], ids=["full", "diagonal"])
def test_it_is_an_iterated_filter_in_numpy(R: np.ndarray) -> None:
    expected, _ = joint.run("iterated_ekf", model(), (Q, R), (np.array([*START.values()]), P0), DT, log(), passes=2)
    run = made("iterated_ekf", R=R, passes=2).run(*log())
    assert off(run, expected) < 1e-9
    assert off(run, made(R=R).run(*log()).x) > 1e-4


def linear(n: int) -> tuple[hg.Form, np.ndarray, np.ndarray]:
    x = [hg.Signal(f"x{i}", low=-50, high=50) for i in range(1, n + 1)]
    A = np.diag(np.ones(n - 1), 1) - np.eye(n) / 2
    flow = [sum(a * each for a, each in zip(row, x, strict=True)) for row in A]
    C = np.zeros((3, n))
    C[0, 0], C[1, 1], C[1, 0], C[2, n - 1] = 1, 1, 0.5, 2
    output = [sum(c * each for c, each in zip(row, x, strict=True)) for row in C]
    outputs = [hg.Signal(f"y{j}") for j in range(3)]
    return hg.forms.original(hg.System("line", states=x, outputs=outputs, flow=flow, output=output)), A, C


@pytest.mark.parametrize(
    ("kind", "n"), [("riccati", 4), ("ukf", 4), ("iterated_ekf", 4), ("riccati", 14), ("riccati", 40)]
)
def test_of_a_linear_plant_all_are_the_kalman_filter(kind: str, n: int) -> None:
    """In loops as well, and without samples for a while."""
    own, A, C = linear(n)
    turns = (np.full(n, INF), np.full(3, INF))
    known = joint.Model(lambda z, u: A @ z, lambda z, u: A, lambda z: C @ z, lambda z: C, turns)
    y = np.random.default_rng(n).normal(size=(120, 3))
    y[20:30], y[40:60, 0], y[50:70, 1] = np.nan, np.nan, np.nan
    noises = np.eye(n) * 0.1, FULL
    dt = 0.02
    expected, _ = joint.run(kind, known, noises, (np.zeros(n), np.eye(n)), dt, (np.zeros((120, 1)), y))
    observer = getattr(hg.observers, kind)(own, Q=[0.1] * n, R_per_sample=FULL, update="joint")
    step = hg.sample(observer, dt=dt, engine="python")
    assert np.abs(step.run(y=y).x - expected).max() < (1e-9 if n < 40 else 1e-8)
    assert bool(step.layout.groups) == (n > 12)


def test_an_invariant_is_projected_once_after_all() -> None:
    c, s, b = (hg.Signal(each, low=-2, high=2) for each in ("c", "s", "b"))
    a, d, w = hg.Signal("a"), hg.Signal("d"), hg.Signal("w", low=-9, high=9)
    plant = hg.System(
        "disc",
        states=(c, s, b),
        inputs=(w,),
        outputs=(a, d),
        flow=[-s * (w - b), c * (w - b), 0],
        output=[c + s / 4, s],
        invariants=(c**2 + s**2 - 1,),
    )

    def onto(z: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v = z[:2] / np.linalg.norm(z[:2])
        M = np.eye(3)
        M[:2, :2] = (np.eye(2) - np.outer(v, v)) / np.linalg.norm(z[:2])
        return np.array([*v, z[2]]), M @ P @ M.T

    def F(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        turning = u[0] - z[2]
        return np.array([[0, -turning, z[1]], [turning, 0, -z[0]], [0, 0, 0]])

    C, R = np.array([[1, 0.25, 0], [0, 1, 0]]), np.array([[0.04, 0.01], [0.01, 0.05]])
    known = joint.Model(
        lambda z, u: np.array([-z[1] * (u[0] - z[2]), z[0] * (u[0] - z[2]), 0.0]),
        F,
        lambda z: C @ z,
        lambda z: C,
        (np.full(3, INF), np.full(2, INF)),
        onto,
    )
    Q, t = np.diag([1e-4, 1e-4, 1e-3]), DT * np.arange(N)
    angle = 0.7 * t
    u = np.full((N, 1), 0.9)
    y = np.column_stack((np.cos(angle) + np.sin(angle) / 4, np.sin(angle)))
    y = y + np.random.default_rng(4).multivariate_normal(np.zeros(2), R, N)
    y[30:40, 0], y[60:70, 1], y[80:90] = np.nan, np.nan, np.nan
    z0 = np.array([1.0, 0.0, 0.0])
    first = onto(z0, np.eye(3))
    expected, _ = joint.run("riccati", known, (Q, R), first, DT, (u, y))
    observer = hg.observers.riccati(hg.forms.original(plant), Q=Q, R_per_sample=R, initial={"c": 1}, update="joint")
    run = hg.sample(observer, dt=DT, engine="python").run(u=u, y=y)
    assert np.abs(run.x - expected).max() < 1e-6  # the directions off the circle have a floor
    assert np.abs(run.x[:, 0] ** 2 + run.x[:, 1] ** 2 - 1).max() < 1e-12


def test_a_gate_decides_before_all_correct() -> None:
    """A rejected sample is a missing one, bit for bit."""
    u, y = log()
    bad = y.copy()
    bad[100::20, 0] += 100.0
    gate = {"rho": 0.99999, ("bearing", "x"): 0.99999}
    missing = np.where(bad - y > 1, np.nan, bad)
    for kind in ("riccati", "ukf"):
        rejecting, plain = (made(kind, gate=gate).run(u, each) for each in (bad, missing))
        assert np.array_equal(rejecting.x, plain.x)
        step = made(kind, gate=gate)
        assert "GATED_RHO" in step.flags(int(np.bitwise_or.reduce(rejecting.status)))


@pytest.mark.parametrize("kind", ["riccati", "ukf", "iterated_ekf"])
def test_by_sections_adapt_corrects(kind: str) -> None:
    u, y = log()
    whole, parts = made(kind), made(kind)
    for k in range(40):
        expected = whole(u[k], y[k])
        parts.predict(u[k])
        for name, value in list(zip(("rho", "bearing", "x"), y[k], strict=True))[:: 1 if k % 2 else -1]:
            parts.update(**{name: value})
        assert np.array_equal(parts.adapt().x, expected.x)
        assert np.array_equal(parts.adapt().x, expected.x)


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("kind", ["riccati", "ukf", "iterated_ekf"])
def test_compiled_it_has_the_bits_of_python(kind: str) -> None:
    u, y = log()
    compiled, python = (made(kind).run(u=u, y=y, engine=engine).x for engine in ("c", "python"))
    assert np.array_equal(compiled, python)


def test_correlated_noise_needs_it() -> None:
    for arguments, words in (
        (
            {"update": "sequential"},
            'R correlates outputs, which a sequential update takes one by one; give update = "j',
        ),
        ({"update": "both"}, 'update = .both. must be "sequential"'),
        ({"R": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}, "R_per_sample must be positive definite"),
        ({"R": [[1, 0.5], [0.5, 1]]}, "must be a diagonal of 3 numbers or a 3 x 3 matrix"),
        (
            {"R": {"rho": {"x": 0.1}, "bearing": {"bearing": 1}, "x": {"x": 1}}},
            "R_per_sample of rho has no value for rho",
        ),
        ({"theta": 2.0}, "wants a chain for each of the 3 outputs"),
    ):
        with pytest.raises(hg.HgogenError, match=words):
            made(**arguments)
    with pytest.raises(hg.HgogenError, match="a filter with a joint update predicts and corrects: take"):
        made(method=hg.methods.rk4_covariance)
    with pytest.raises(BadGain, match="R_per_sample is a matrix, and kalman_like takes a number for each output"):
        hg.observers.kalman_like(hg.forms.state_affine(linear(4)[0].system), R_per_sample=FULL, rho=1.0)


def test_proofs_of_independent_noises_are_not_made_for_it() -> None:
    own = linear(4)[0]
    diagonal = hg.observers.riccati(own, Q=[1] * 4, R=[1, 2, 3], update="joint")
    correlated = hg.observers.riccati(own, Q=[1] * 4, R=FULL, update="joint")
    assert diagonal.checks[-1].verdict is Verdict.PROVED
    assert correlated.checks[-1].verdict is Verdict.UNKNOWN
    assert "outputs with independent noises" in str(correlated.checks[-1])


TEXT = """
name = "pair"
states = {q = {low = -5, high = 5, flow = "w"}, w = {low = -5, high = 5, flow = "-2*q - .3*w"}}
outputs = {y = {equation = "q"}, v = {equation = "w"}}
[tuning.riccati]
form = "original"
dt = 0.25
Q = {q = 1, w = 1}
update = "joint"
SPELLED
"""


def test_a_text_model_has_it(tmp_path: Path) -> None:
    for k, lines in enumerate(
        ("R = {y = {y = 1, v = 0.5}, v = {v = 2}}", "R_per_sample = [[4, 2], [2, 8]]", "R = [[1, 0.5], [0.5, 2]]")
    ):
        path = tmp_path / f"pair{k}.toml"
        path.write_text(TEXT.replace("SPELLED", lines))
        step = load(path).step("riccati")
        assert step.tuned["R"] == (1.0, 1.75)
        assert any("R: [4, 2], [2, 8]" in line or "[1, 0.5]" in line for line in step.observer.equations)


def test_beside_delays_periods_and_no_guards() -> None:
    """A late sample is as one in time; slow sensors and a step without guards correct as well."""
    u, y = log()
    u, y = u[:60], y[:60]
    gains = {"Q": Q, "R_per_sample": FULL, "covariance": P0, "initial": START, "update": "joint"}
    observer = hg.observers.riccati(form(), accept=("original.lipschitz", "original.order"), **gains)
    plain = hg.sample(observer, dt=DT, engine="python").run(u, y)
    late = hg.sample(hg.delayed(observer, x=2), dt=DT, engine="python").run(u, np.column_stack((y, np.zeros(60))))
    assert np.array_equal(late.x, plain.x)
    full = np.where(np.isfinite(y), y, 0.0)
    bare = hg.sample(observer, dt=DT, engine="python", guards="none").run(u, full)
    assert np.abs(bare.x - hg.sample(observer, dt=DT, engine="python").run(u, full).x).max() < 1e-6
    slow = hg.sample(observer, dt=DT, engine="python", periods={"x": 3 * DT})
    every = np.where(np.arange(60)[:, None] % 3 == [[0, 0, 0]], y, np.array([[1.0, 1.0, np.nan]]) * y)
    run = slow.run(u, every)
    assert np.isfinite(run.x).all()


@pytest.mark.parametrize("kind", ["riccati", "ukf", "iterated_ekf"])
def test_of_a_discrete_plant_as_well(kind: str) -> None:
    """The filters of other libraries: a map, its noise per sample, sigma points drawn anew, a full R."""
    a, b = hg.Signal("a", low=-20, high=20), hg.Signal("b", low=-20, high=20)
    flow = [a + b / 10, b - sp.sin(a) / 10]
    outputs, output = (hg.Signal("r"), hg.Signal("s")), [sp.sqrt(a**2 + 25), b + a**2 / 50]
    plant = hg.System("map", states=(a, b), outputs=outputs, flow=flow, output=output, discrete=True)
    known = joint.Model(
        lambda z, u: np.array([z[0] + z[1] / 10, z[1] - np.sin(z[0]) / 10]),
        lambda z, u: np.array([[1, 0.1], [-np.cos(z[0]) / 10, 1]]),
        lambda z: np.array([np.sqrt(z[0] ** 2 + 25), z[1] + z[0] ** 2 / 50]),
        lambda z: np.array([[z[0] / np.sqrt(z[0] ** 2 + 25), 0], [z[0] / 25, 1]]),
        (np.full(2, INF), np.full(2, INF)),
        discrete=True,
    )
    Q, R, z, rng = (
        np.array([[0.01, 0.004], [0.004, 0.02]]),
        FULL[:2, :2] * 4,
        np.array([2.0, 0.0]),
        np.random.default_rng(9),
    )
    states = [z := known.f(z, np.zeros(1)) for _ in range(200)]
    y = np.array([known.h(each) for each in states]) + rng.multivariate_normal(np.zeros(2), R, 200)
    y[rng.random((200, 2)) < 0.2] = np.nan
    start = (np.array([1.5, 0.3]), np.eye(2))
    scaled = {"alpha": 0.9, "beta": 2.0, "kappa": 1.0} if kind == "ukf" else {}
    options = {"scaled": tuple(scaled.values())} if scaled else {}
    options |= {"passes": 2} if kind == "iterated_ekf" else {}
    expected, _ = joint.run(kind, known, (Q, R), start, 1.0, (np.zeros((200, 1)), y), **options)
    gains = {"Q": Q, "R": R, "initial": {"a": 1.5, "b": 0.3}, "update": "joint", **scaled}
    gains |= {"passes": 2} if kind == "iterated_ekf" else {}
    observer = getattr(hg.observers, kind)(hg.forms.original(plant), **gains)
    run = hg.sample(observer, dt=0.1, engine="python").run(y=y)
    assert np.abs(run.x - expected).max() < 1e-9
