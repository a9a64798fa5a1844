"""The filter whose innovations have derivatives, against the textbook's with all outputs of a sample at once."""

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import norm

import hgogen as hg
from hgogen.logs.likelihood import Innovations, log_odds, softplus, spans_of
from hgogen.logs.problem import Predicting

F, G, THEN = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([0.3, -0.5]), np.array([0.7, 0.4])
H, Q, R = np.array([[1.0, 0.5], [-0.3, 2.0]]), np.array([[0.04, 0.01], [0.01, 0.09]]), np.array([0.05, 0.2])
FIRST = np.array([0.5, -0.2])
COUNT = 40


def record() -> hg.Log:
    """Of the plant x+ = F x + G u + THEN u+ + w; samples of one, the other or both outputs are missing."""
    draw = np.random.default_rng(2)
    x, u, y = np.array([1.0, 1.0]), draw.normal(size=(COUNT, 1)), np.empty((COUNT, 2))
    for k in range(COUNT):
        y[k] = H @ x + np.sqrt(R) * draw.normal(size=2)
        after = u[min(k + 1, COUNT - 1), 0]
        x = F @ x + G * u[k, 0] + THEN * after + np.linalg.cholesky(Q) @ draw.normal(size=2)
    y[5:8, 0] = y[7:11, 1] = y[20, 1] = np.nan
    return hg.Log(u, y, 0.1)


def innovations(span: float | None = None, columns: slice = slice(0, 2)) -> Innovations:
    x, now, then, theta, Phi = (ca.SX.sym("a", *size) for size in ((2, 1), (1, 1), (1, 1), (2, 1), (2, 2)))
    return Innovations(
        ca.Function("move", [x, now, then, theta], [ca.mtimes(F, x) + ca.DM(G) * now + ca.DM(THEN) * then]),
        ca.Function("read", [x, now, theta], [ca.mtimes(H[columns], x)]),
        ca.Function("process", [theta, Phi], [ca.DM(Q)]),
        ca.Function("sensor", [theta], [ca.DM(R[columns])]),
        (hg.Signal("y1"), hg.Signal("y2"))[columns],
        np.array([[-np.inf] * 2, [np.inf] * 2]),
        None if span is None else np.full(2, span)[columns],
    )


def along(filter_: Innovations, log: hg.Log) -> tuple[np.ndarray, ...]:
    memory = ca.DM([*FIRST, *np.eye(2).ravel()])
    return tuple(value.full() for value in filter_.along(log, memory, ca.DM(1, 1)))


def test_two_outputs_are_as_likely_as_all_at_once() -> None:
    """One output after the other is the same update; 1e-10 of a sum of some 100 numbers is rounding."""
    log, x, P, total = record(), FIRST, np.eye(2), 0.0
    for k, y in enumerate(log.y):
        there = np.isfinite(y)
        S = H[there] @ P @ H[there].T + np.diag(R[there])
        e = y[there] - H[there] @ x
        K = P @ H[there].T @ np.linalg.inv(S)
        total += (e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1]) / 2
        x, P = x + K @ e, P - K @ S @ K.T
        x = F @ x + G * log.u[k, 0] + THEN * log.u[min(k + 1, COUNT - 1), 0]
        P = F @ P @ F.T + Q
    cost, e, s = along(innovations(), log)
    assert cost.sum() == pytest.approx(total, rel=1e-10)
    assert (np.isfinite(log.y).T * (e**2 / s + np.log(s)) / 2).sum() == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize("y", [0.6, 3.0, 1e6])
def test_an_outlier_is_weighed_by_its_probability(y: float) -> None:
    """The density of an innovation is 19 of 20 parts of a normal and one of a uniform distribution over the span 40,
    and a correction is the mean over both cases, as its covariance is."""
    cost, e, s = along(innovations(40.0, slice(0, 1)), hg.Log(np.zeros((2, 1)), np.array([[y], [0.0]]), 0.1))
    first, variance = y - H[0] @ FIRST, H[0] @ H[0] + R[0]
    assert (e[0, 0], s[0, 0]) == (pytest.approx(first), pytest.approx(variance))
    good, bad = 0.95 * norm.pdf(first, scale=np.sqrt(variance)), 0.05 / 40
    sure = -np.log(0.95 / np.sqrt(2 * np.pi))  # of a sample that is no outlier for sure the cost is (e^2/s + log s)/2
    assert cost[0, 0] == pytest.approx(-np.log(good + bad) - sure)
    w, K = good / (good + bad), H[0] / variance
    assert e[0, 1] == pytest.approx(-H[0] @ F @ (FIRST + w * K * first))
    cases = np.array([K * first, 0 * K]) - w * K * first  # of the two about their mean
    P = np.eye(2) - w * np.outer(K, H[0]) + cases.T @ np.diag([w, 1 - w]) @ cases
    assert s[0, 1] == pytest.approx(H[0] @ (F @ P @ F.T + Q) @ H[0] + R[0])


def test_outliers_lie_in_the_range_of_their_output() -> None:
    outputs = hg.Signal("y1"), hg.Signal("y2", period=6.0), hg.Signal("y3")
    logs = [hg.Log(np.zeros((3, 0)), np.array(rows).T, 0.1) for rows in ([[1, 2, np.nan], [1] * 3, [5] * 3],) * 2]
    logs[1] = replace(logs[1], y=logs[1].y + 10)
    assert spans_of(outputs, logs[:1]).tolist() == [1.0, 6.0, 1.0]  # 1 for a sensor that stands still
    assert spans_of(outputs, logs).tolist() == [11.0, 6.0, 10.0]


def test_an_outlier_has_a_gradient_however_far_it_is() -> None:
    e, s = ca.SX.sym("e"), ca.SX.sym("s")
    odds = log_odds(e * e / s, ca.log(s), 1.0)
    slope = ca.Function("slope", [e, s], [ca.jacobian(softplus(odds) + ca.exp(-softplus(-odds)), ca.vertcat(e, s))])
    assert slope(1e6, 1e-9).full() == pytest.approx(np.zeros((1, 2)))


def test_the_information_of_a_mean_and_of_the_logarithm_of_a_variance() -> None:
    """N/r and N/2, as of N independent samples of a normal distribution."""
    v, (level, count) = ca.MX.sym("v", 2), (0.3, 50)
    unit: Any = ca.DM.ones(count)
    information = Predicting._fisher(None, v, -unit * v[0], unit * ca.exp(v[1]))  # type: ignore[arg-type]
    values = ca.Function("fisher", [v], [information])([1.0, math.log(level)]).full()
    assert values == pytest.approx(np.diag([count / level, count / 2]))


def test_residuals_are_sorted_by_output() -> None:
    """Of two outputs that miss different samples each residual is that of its own: here those of the first are 1, of
    the second 3, over a deviation that does not change."""
    x, a = hg.Signal("x", low=-50, high=50), hg.Signal("a", "1/s", nominal=0.0, low=-1, high=1)
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    plant = hg.System("two", states=(x,), outputs=outputs, parameters=(a,), flow=[a * x], output=[x, 2 * x])
    y = np.tile([1.0, 3.0], (30, 1))
    y[3:9, 0] = y[11:13, 1] = np.nan
    problem = Predicting(plant, (a,), (hg.Log(np.zeros((30, 0)), y, 0.1),), np.ones(2), 30, 1, unit=np.ones(1))
    tiny, levels = -24.0, [0.0, 0.0]  # no process noise: the state stays where it is, at 0
    first, second = problem.residuals(np.array([0.0, 0.0, tiny, *levels]))
    assert (len(first), len(second)) == (24, 28)
    assert first == pytest.approx(np.ones(24), abs=1e-3)
    assert second == pytest.approx(3 * np.ones(28), abs=1e-3)
