"""Variances of samples that are expressions: the filters against own ones in numpy, and what is refused."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.estimators.noise import deviation_lines, sample_deviations
from hgogen.model import load
from hgogen.run import native

DT, N = 0.05, 200
START, P0 = {"q": 2.0, "w": 0.5}, np.diag([0.5, 0.5])
ACCEPT = ("original.lipschitz", "original.order")


@cache
def form() -> hg.Form:
    q, w = hg.Signal("q", low=-5, high=5), hg.Signal("w", low=-5, high=5)
    u, b = hg.Signal("u", low=-2, high=2), hg.Signal("b", nominal=0.02)
    y, v = hg.Signal("y"), hg.Signal("v")
    flow, output = [w, u - 2 * q - w / 4], [q + q**3 / 40, w]
    plant = hg.System("swing", states=(q, w), inputs=(u,), outputs=(y, v), parameters=(b,), flow=flow, output=output)
    return hg.forms.original(plant)


VARYING = {"y": "0.01 + (b*q)**2 + u**2/100", "v": 0.09}


@cache
def log() -> tuple[np.ndarray, np.ndarray]:
    rng, t = np.random.default_rng(1), DT * np.arange(N)
    y = np.column_stack((2 * np.cos(1.4 * t), -2.8 * np.sin(1.4 * t))) + rng.normal(0, 0.2, (N, 2))
    y[30:50, 0], y[70:80] = np.nan, np.nan
    return np.sin(t)[:, None], y


def made(kind: str = "riccati", R: Any = None, **options: Any) -> hg.Step:
    gains = {"Q": [1e-3, 1e-2], "R_per_sample": VARYING if R is None else R, "covariance": P0, "initial": START}
    observer = getattr(hg.observers, kind)(form(), accept=ACCEPT, **{**gains, **options})
    return hg.sample(observer, dt=DT, engine="python")


def expected(joint: bool) -> np.ndarray:
    """The extended Kalman filter; a variance is that at the estimate just before the sample corrects it."""
    A, (u, y) = np.array([[0, 1.0], [-2, -0.25]]), log()
    step, z, P, rows = DT * A, np.array([*START.values()]), P0, []
    Phi = np.eye(2) + step + step @ step / 2

    def f(z: np.ndarray, u: float) -> np.ndarray:
        return A @ z + np.array([0, u])

    for k, sample in enumerate(y):
        if k:
            first, last = u[k - 1, 0], u[k, 0]
            k1 = f(z, first)
            k2 = f(z + DT / 2 * k1, (first + last) / 2)
            k3 = f(z + DT / 2 * k2, (first + last) / 2)
            z = z + DT / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + DT * k3, last))
            P = Phi @ P @ Phi.T + DT * np.diag([1e-3, 1e-2])
        there, before = np.flatnonzero(np.isfinite(sample)), z
        for group in [there] if joint else there[:, None]:
            z_read = before if joint else z
            h = np.array([z_read[0] + z_read[0] ** 3 / 40, z_read[1]])
            C = np.array([[1 + 3 * z_read[0] ** 2 / 40, 0], [0, 1]])[group]
            R = np.diag([0.01 + (0.02 * z_read[0]) ** 2 + u[k, 0] ** 2 / 100, 0.09])[np.ix_(group, group)]
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
            z, P = z + K @ (sample - h)[group], P - K @ C @ P
        rows.append(z)
    return np.array(rows)


@pytest.mark.parametrize("update", ["sequential", "joint"])
def test_it_is_a_filter_whose_variance_varies(update: str) -> None:
    run = made(update=update).run(*log())
    assert np.abs(run.x - expected(update == "joint")).max() < 1e-9
    constant = made(update=update, R={"y": 0.01, "v": 0.09}).run(*log())
    assert np.abs(run.x - constant.x).max() > 1e-3


def test_a_constant_expression_is_a_number() -> None:
    for kind in ("riccati", "ukf", "iterated_ekf"):
        written, number = (made(kind, R={"y": value, "v": 0.09}) for value in (sp.Rational(1, 25), 0.04))
        assert np.array_equal(written.run(*log()).x, number.run(*log()).x)
    own = form().system.states[0]
    scaled, plain = made(R={"y": 0.04 + 0 * own, "v": 0.09}), made(R={"y": 0.04, "v": 0.09})
    assert scaled.tuned == plain.tuned


@pytest.mark.parametrize("kind", ["ukf", "iterated_ekf"])
def test_it_is_held_while_a_sample_corrects(kind: str) -> None:
    """It is no part of the output that sigma points and passes evaluate."""
    x = made(kind).run(*log()).x
    assert np.abs(x - made("riccati").run(*log()).x).max() < 0.2
    assert np.abs(x - made(kind, R={"y": 0.01, "v": 0.09}).run(*log()).x).max() > 1e-3


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_compiled_it_has_the_bits_of_python() -> None:
    u, y = log()
    for kind, update in (("riccati", "sequential"), ("ukf", "joint")):
        compiled, python = (made(kind, update=update).run(u=u, y=y, engine=engine).x for engine in ("c", "python"))
        assert np.array_equal(compiled, python)


def test_reports_name_the_expression_and_no_proof_is_made() -> None:
    step = made()
    assert sample_deviations(step) == pytest.approx({"v": 0.3})
    assert deviation_lines(step) == (
        "R as the standard deviation of one sample: v = 0.3",
        "variance of one sample: y = b**2*q**2 + u**2/100 + 1/100",
    )
    last = step.observer.checks[-1]
    assert last.verdict is Verdict.UNKNOWN


def test_a_variance_may_read_a_table_of_the_plant() -> None:
    q, y = hg.Signal("q", low=-5, high=5), hg.Signal("y")
    drag = hg.table(q, [-5, 0, 5], [4, 1, 4], name="drag")
    original = hg.forms.original(hg.System("dragged", states=(q,), outputs=(y,), flow=[-q * drag], output=[q]))
    text, written = (hg.observers.riccati(original, Q=[1], R={"y": R}) for R in ("drag(q)", drag))
    assert text.parts[0].varying == written.parts[0].varying


def test_a_variance_is_proved_to_be_positive_however_small_beside_its_range() -> None:
    (part,) = made(R={"y": "(q - 1)**2 + 1/1000000", "v": 1}).observer.parts
    assert 0 < part.varying.least[0] <= 1e-6


def test_what_is_no_variance_is_met_at_the_door() -> None:
    for R, words in (
        ({"y": "q", "v": 1}, "R_per_sample of y = q is not proved to be positive on the declared ranges"),
        ({"y": "-1 - q**2", "v": 1}, r"\(proved: at most -1, by "),
        ({"y": "q**2", "v": 1}, r"\(vanishes, at q = 0\); add a positive number, or narrow the ranges"),
        ({"y": "1/(q + 1)**2", "v": 1}, "is not proved to be positive"),
        ({"y": "1 + z**2", "v": 1}, "z"),
        ({"y": sp.Symbol("y") ** 2 + 1, "v": 1}, "reads y, which is no state, input or parameter"),
        ({"y": "1 + q**2"}, "has no value for v"),
    ):
        with pytest.raises(hg.HgogenError, match=words.replace("**", r"\*\*")):
            made(R=R)
    with pytest.raises(hg.HgogenError, match="has numbers, which are densities, with variances of a sample"):
        hg.observers.riccati(form(), Q=[1, 1], R={"y": "1 + q**2", "v": 1}, accept=ACCEPT)
    with pytest.raises(hg.HgogenError, match="has an expression, and hamilton_jacobi takes numbers"):
        hg.observers.hamilton_jacobi(form(), Q=[1, 1], R={"y": "1 + q**2", "v": "1"}, accept=ACCEPT)


TEXT = """
name = "swing"
states = {q = {low = -5, high = 5, flow = "w"}, w = {low = -5, high = 5, flow = "-2*q - .3*w"}}
outputs = {y = {equation = "q"}}
[tuning.riccati]
form = "original"
dt = 0.5
Q = {q = 1, w = 1}
R = {y = "0.01 + (0.02*q)**2"}
"""


def test_a_text_model_has_it(tmp_path: Path) -> None:
    path = tmp_path / "swing.toml"
    path.write_text(TEXT)
    step = load(path).step("riccati")
    assert step.tuned["R"] == (0.5,)
    assert any("variance of a sample of y = " in line for line in step.observer.equations)
