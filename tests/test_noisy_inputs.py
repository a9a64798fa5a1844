"""Noise of inputs: the filters against an own one in numpy, its spellings, and what is refused."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import plants
import pytest
import sympy as sp
from oracle import noisy_inputs

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.noise import deviation_lines, sample_deviations
from hgogen.model import load
from hgogen.reading.given import BadGain, BadNames
from hgogen.run import native

DT, N = 0.1, 400
SIGMA = {"x": 0.3, "y": 0.2, "v": 0.4, "w": 0.15}
Q = np.diag([0.0, 0.0, 1e-4])
START = {"px": 1.0, "py": -1.0, "psi": 0.3}
C = np.eye(3)[:2]


@cache
def cart(name: str = "cart") -> hg.System:
    """A cart that is driven by its speed and its turning rate, both measured, with its place."""
    px, py = (hg.Signal(each, "m", low=-60, high=60) for each in ("px", "py"))
    psi, v = hg.Signal("psi", "rad", low=-40, high=40), hg.Signal("v", "m/s", low=-4, high=4)
    w, x, y = hg.Signal("w", "rad/s", low=-2, high=2), hg.Signal("x", "m"), hg.Signal("y", "m")
    flow = [v * sp.cos(psi), v * sp.sin(psi), w]
    return hg.System(name, states=(px, py, psi), inputs=(v, w), outputs=(x, y), flow=flow, output=[px, py])


def made(kind: str = "riccati", method: Any = None, dt: float = DT, **options: Any) -> hg.Step:
    gains = {"noise": SIGMA, "Q": Q, "initial": START, "accept": ("original.lipschitz", "original.order")}
    observer = getattr(hg.observers, kind)(hg.forms.original(cart()), **{**gains, **options})
    return hg.sample(observer, method or hg.methods.continuous_discrete, dt=dt, engine="python")


@cache
def log() -> tuple[np.ndarray, np.ndarray]:
    rng, t = np.random.default_rng(5), DT * np.arange(N)
    u = np.column_stack((1 + np.sin(t / 3), 0.3 * np.cos(t)))
    psi = 0.3 + DT * np.cumsum(u[:, 1])
    place = DT * np.cumsum(u[:, :1] * np.column_stack((np.cos(psi), np.sin(psi))), axis=0)
    y = place + rng.normal(size=(N, 2)) * [SIGMA["x"], SIGMA["y"]]
    y[50:60, 0], y[100:140] = np.nan, np.nan
    return u + rng.normal(size=(N, 2)) * [SIGMA["v"], SIGMA["w"]], y


def expected() -> tuple[np.ndarray, np.ndarray]:
    def f(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([u[0] * np.cos(z[2]), u[0] * np.sin(z[2]), u[1]])

    def F(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([[0, 0, -u[0] * np.sin(z[2])], [0, 0, u[0] * np.cos(z[2])], [0, 0, 0]])

    def G(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([[np.cos(z[2]), 0], [np.sin(z[2]), 0], [0, 1]])

    squares = np.array([SIGMA[name] ** 2 for name in ("v", "w", "x", "y")])
    start = (np.array([*START.values()]), np.eye(3))
    return noisy_inputs.run((f, F, G), C, (Q, squares[:2], squares[2:]), start, DT, *log())


@pytest.mark.parametrize("kind", ["riccati", "iterated_ekf"])
@pytest.mark.parametrize("method", [hg.methods.continuous_discrete, hg.methods.cholesky], ids=["ldl", "root"])
def test_it_is_a_filter_with_noisy_inputs_in_numpy(kind: str, method: Any) -> None:
    u, y = log()
    u = np.clip(u, [-4, -2], [4, 2])
    run = made(kind, method).run(u=u, y=y)
    x, P = expected()
    assert np.abs(run.x - x).max() < 1e-9
    assert np.linalg.norm(P[-1]) > 2 * np.linalg.norm(noiseless()[-1])


def noiseless() -> np.ndarray:
    """The covariances without noise of inputs."""
    saved = dict(SIGMA)
    try:
        SIGMA.update(v=1e-9, w=1e-9)
        return expected()[1]
    finally:
        SIGMA.update(saved)


def spring(name: str, **limits: float) -> hg.System:
    q, w = hg.Signal("q", low=-5, high=5), hg.Signal("w", low=-5, high=5)
    a, y = hg.Signal("a", low=-9, high=9), hg.Signal("y", **limits)
    return hg.System(name, states=(q, w), inputs=(a,), outputs=(y,), flow=[w, a - 2 * q - 0.3 * w], output=[q])


METHODS = {name: getattr(hg.methods, name) for name in ("continuous_discrete", "cholesky", "rk4", "rk4_covariance")}


@pytest.mark.parametrize("name", METHODS)
def test_of_constant_directions_it_is_a_matrix_q(name: str) -> None:
    """Of a linear plant, f_u U f_u' is a matrix: of all methods, and with theta."""
    form, draw = hg.forms.triangular(spring("spring")), np.random.default_rng(3)
    u, y = draw.normal(size=200), draw.normal(size=200)
    for theta in (1.0, 2.0):
        others = {"R": 0.05, "theta": theta}
        noisy = hg.observers.riccati(form, U={"a": 0.3}, Q=(0.02, 0.0), **others)
        plain = hg.observers.riccati(form, Q=(0.02, 0.3), **others)
        run, wanted = (
            hg.sample(each, METHODS[name], dt=0.02, engine="python").run(u=u, y=y) for each in (noisy, plain)
        )
        assert np.abs(run.x - wanted.x).max() < 1e-12
        assert np.isfinite(run.x).all()


def test_sigma_points_of_a_linear_plant_are_the_kalman_filter() -> None:
    b, g, w = hg.Signal("b", low=-40, high=40), hg.Signal("g", low=-1, high=1), hg.Signal("w", low=-9, high=9)
    plant = hg.System("heading", states=(b, g), inputs=(w,), outputs=(hg.Signal("y"),), flow=[w - g, 0], output=[b])
    gains = {"noise": {"y": 0.05, "w": 0.2}, "Q_per_sample": (0, 1e-6)}
    u, y = np.ones(300), np.arange(300) * DT + np.random.default_rng(1).normal(0, 0.05, 300)
    form = hg.forms.original(plant)
    runs = [
        hg.sample(getattr(hg.observers, kind)(form, **gains), dt=DT, engine="python").run(u=u, y=y).x
        for kind in ("riccati", "ukf", "iterated_ekf")
    ]
    assert np.abs(runs[1] - runs[0]).max() < 1e-9
    assert np.abs(runs[2] - runs[0]).max() < 1e-9


@pytest.mark.parametrize("n", [5, 14])
def test_loops_add_a_column_that_moves(n: int) -> None:
    """Two noises of inputs, one of a column that depends on the state, in loops and in numpy."""
    x = [hg.Signal(f"x{i}", low=-9, high=9) for i in range(1, n + 1)]
    u, v = hg.Signal("u", low=-9, high=9), hg.Signal("v", low=-9, high=9)
    flow = [b - a for a, b in zip(x, [*x[1:], u], strict=True)]
    flow[1] += v * sp.cos(x[0])
    plant = hg.System("line", states=x, inputs=(u, v), outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])
    noise, form = {"y": 0.1, "u": 0.5, "v": 0.2}, hg.forms.original(plant)
    observer = hg.observers.riccati(form, noise=noise, Q=[1e-3] * n, accept=("original.lipschitz", "original.order"))
    step = hg.sample(observer, dt=0.05, engine="python", prefer="flash")
    assert step.layout.groups
    rng = np.random.default_rng(2)
    inputs, y = rng.normal(size=(150, 2)), rng.normal(size=(150, 1))
    A = np.diag(np.ones(n - 1), 1) - np.eye(n)
    e, last = np.eye(n)[1], np.eye(n)[n - 1]

    def f(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return A @ z + last * u[0] + e * u[1] * np.cos(z[0])

    def F(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return A - np.outer(e, np.eye(n)[0]) * u[1] * np.sin(z[0])

    def G(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.column_stack((last, e * np.cos(z[0])))

    squares = np.array([noise[name] ** 2 for name in ("u", "v", "y")])
    noises, start = (np.eye(n) * 1e-3, squares[:2], squares[2:]), (np.zeros(n), np.eye(n))
    expected_x, _ = noisy_inputs.run((f, F, G), np.eye(n)[:1], noises, start, 0.05, inputs, y)
    assert np.abs(step.run(u=inputs, y=y).x - expected_x).max() < 1e-9


def test_the_variance_of_a_sample_stays_where_dt_changes() -> None:
    observer = made().observer
    for dt in (DT, DT / 4):
        step = hg.sample(observer, dt=dt)
        assert step.tuned["U"] == pytest.approx((SIGMA["v"] ** 2 * dt, SIGMA["w"] ** 2 * dt), rel=1e-14)
        assert sample_deviations(step) == pytest.approx(SIGMA)
    assert deviation_lines(made()) == (
        "R as the standard deviation of one sample: x = 0.3 m, y = 0.2 m",
        "U as the standard deviation of one sample: v = 0.4 m/s, w = 0.15 rad/s",
    )


def test_no_proof_is_made_for_it() -> None:
    form = hg.forms.original(spring("spring"))
    observer = hg.observers.riccati(form, R=1, U={"a": 1})
    assert hg.observers.riccati(form, R=1, Q=(0.1, 0)).checks[-1].verdict is Verdict.PROVED
    last = observer.checks[-1]
    assert (last.verdict, str(last.id)) == (Verdict.UNKNOWN, "riccati.convergence")
    assert "constant Q, without noise of inputs" in str(last)
    assert "noise of inputs reaches every state" in str(observer.theorem)


def test_what_is_no_noise_of_inputs_is_met_at_the_door() -> None:
    a, q, y = hg.Signal("a", low=0, high=1), hg.Signal("q", low=-1, high=1), hg.Signal("y")

    def plant(flow: sp.Expr, output: sp.Expr) -> hg.Form:
        return hg.forms.original(hg.System("one", states=(q,), inputs=(a,), outputs=(y,), flow=[flow], output=[output]))

    plain, silent = plant(a - q, q), hg.forms.original(plants.van_der_pol())
    cases: tuple[tuple[hg.Form, dict[str, Any], str], ...] = (
        (plain, {"R": 1, "U": {}}, "must give densities of the noise of inputs by name, such as {'a': 1e-4}"),
        (silent, {"R": 1, "U": {"a": 1}}, "names 'a', but there are no names|which is none of the names"),
        (plain, {"R": 1, "U": {"a": -1}}, "U = .* must be positive"),
        (plain, {"R": 1, "U": {"a": 1}, "noise": {"a": 1}}, "its noise of inputs twice, as U and noise"),
        (plain, {"noise": {"a": 1}}, "has no measurement noise"),
        (plain, {"noise": {"a": 1, "y": 1, "b": 1}}, "names 'b'"),
        (plant(-q, q), {"R": 1, "U": {"a": 1}}, "moves no state, for it is not in the flow; leave it out"),
        (plant(a - q, q + a), {"R": 1, "U": {"a": 1}}, "enters the output y as well"),
        (plant(sp.sqrt(a) - q, q), {"R": 1, "U": {"a": 1}}, "derivatives of the flow that may have no value"),
    )
    for form, arguments, words in cases:
        with pytest.raises((BadGain, BadNames), match=words):
            hg.observers.riccati(form, accept=("original.lipschitz",), **arguments)
    with pytest.raises(BadNames, match="kalman_like has no noise of inputs; leave it out, or take riccati"):
        hg.observers.kalman_like(hg.forms.state_affine(spring("affine")), noise={"y": 1, "a": 1}, rho=1.0)
    with pytest.raises(BadGain, match=r"must say what its R and U are"):
        hg.observers.ekf(plain, R=1, U={"a": 1})


TEXT = """
name = "spring"
states = {q = {low = -5, high = 5, flow = "w"}, w = {low = -5, high = 5, flow = "a - 2*q - .3*w"}}
inputs = {a = {low = -9, high = 9}}
outputs = {y = {equation = "q"}}
[tuning.riccati]
form = "original"
dt = 0.5
SPELLED
"""


def test_a_text_model_has_it(tmp_path: Path) -> None:
    for k, lines in enumerate(("noise = {y = 1, a = 2}", "R = 0.5\nU = {a = 2}", "R = 0.5\nnoise = {a = 2}")):
        path = tmp_path / f"spring{k}.toml"
        path.write_text(TEXT.replace("SPELLED", lines))
        assert load(path).step("riccati").tuned == {"Q": (0.0, 0.0), "R": (0.5,), "U": (2.0,)}


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_compiled_it_has_the_bits_of_python() -> None:
    u, y = log()
    for kind, method in (("riccati", hg.methods.continuous_discrete), ("ukf", None)):
        compiled, python = (made(kind, method).run(u=u, y=y, engine=engine).x for engine in ("c", "python"))
        assert np.array_equal(compiled, python)
