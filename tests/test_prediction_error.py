"""Parameters by prediction error: a plant that noise moves, an unstable one, and the filter inside."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import hgogen as hg
from hgogen.logs.problem import Predicting, accumulated_noise

X = hg.Signal("x", low=-5, high=5)
U, Y = hg.Signal("u", low=-20, high=20), hg.Signal("y")
A = hg.Signal("a", "1/s", nominal=0.3, low=-2, high=4)
PLANT = hg.System("grows", states=(X,), inputs=(U,), outputs=(Y,), parameters=(A,), flow=[A * X + U], output=[X])
TRUE, DT, Q, SIGMA = 1.0, 0.1, 0.5, 0.05


def held(seed: int, count: int = 200, offset: float = 0.0) -> hg.Log:
    """x' = x + u + w under the feedback u = -3 y + r, w and the noise of samples white; the motion is exact."""
    draw = np.random.default_rng(seed)
    move, root = np.exp(TRUE * DT), np.sqrt(Q * np.expm1(2 * TRUE * DT) / (2 * TRUE))
    x, u, y = 0.0, [], []
    for k in range(count):
        y.append(x + SIGMA * draw.normal())
        u.append(-3 * y[-1] + np.sign(np.sin(0.7 * DT * k)))
        x = move * x + (move - 1) / TRUE * u[-1] + root * draw.normal()
    return hg.Log(np.array(u), np.array(y) + offset, DT)


@pytest.mark.full
def test_under_feedback_it_is_right_where_the_error_of_a_simulation_is_not() -> None:
    """Of 8 records the mean lies within 4 of its standard errors, and the values scatter as is said (chi square of 7,
    one in 1e3 beyond); a simulation takes what noise did for a slower plant."""
    logs = [held(seed) for seed in range(8)]
    each = {by: [hg.fit(PLANT, log, by=by, starts=1) for log in logs] for by in ("prediction", "simulation")}
    a = {by: np.array([fit.parameters[0].value for fit in fits]) for by, fits in each.items()}
    said = np.median([fit.parameters[0].deviation for fit in each["prediction"]])
    assert abs(a["prediction"].mean() - TRUE) < 4 * said / np.sqrt(8)
    assert 0.3 * said < a["prediction"].std(ddof=1) < 1.9 * said
    assert abs(a["simulation"].mean() - TRUE) > 3 * abs(a["prediction"].mean() - TRUE)
    assert abs(a["simulation"].mean() - TRUE) > 4 * said / np.sqrt(8)
    assert not any(fit.whiteness["y"].white for fit in each["simulation"])
    assert sum(fit.whiteness["y"].white for fit in each["prediction"]) >= 6  # of 8 with 19 in 20
    assert any("where noise moves the plant, --by prediction" in note for note in each["simulation"][0].notes())


def test_the_levels_of_noise_are_those_that_moved_it() -> None:
    """Of 900 samples a variance is known to 5 % where it is seen alone; here two share what is seen."""
    fit = hg.fit(PLANT, held(20, 900), by="prediction", starts=1)
    process, sample = fit.noise
    assert process["x"] == pytest.approx(Q, rel=0.3)
    assert sample["y"] == pytest.approx(SIGMA, rel=0.6)
    assert fit.as_dict()["noise"] == {"process": process, "sample": sample}
    assert hg.fit(PLANT, held(20, 50), starts=1).noise == ({}, {})


@pytest.mark.full
def test_samples_may_be_missing_and_an_output_have_an_offset_and_several_records_share() -> None:
    first, second = held(3, 150, offset=0.4), held(4, 200, offset=0.4)
    first.y[40:60] = np.nan
    fit = hg.fit(PLANT, first, second, by="prediction", offset="y", starts=1)
    (offset,) = fit.offsets
    assert abs(offset.value - 0.4) < 4 * offset.deviation < 0.8
    assert abs(fit.parameters[0].value - TRUE) < 4 * fit.parameters[0].deviation
    assert [np.isfinite(y).sum() for y in fit.fitted] == [130, 200]
    assert len(fit.first) == 2


def test_a_robust_one_is_not_moved_by_samples_that_are_wrong() -> None:
    """Every seventeenth is off by 2, forty deviations of the others."""
    for seed in (5, 7):
        log = held(seed)
        y = log.y.copy()
        y[::17] += 2.0
        plain, robust = (
            hg.fit(PLANT, hg.Log(log.u, y, DT), by="prediction", starts=1, robust=how).parameters[0]
            for how in (False, True)
        )
        assert abs(robust.value - TRUE) < min(3 * robust.deviation, abs(plain.value - TRUE))
        assert robust.deviation < 0.7 * plain.deviation


# --- what is minimised ------------------------------------------------------------------------------------------


def likelihood(log: hg.Log, a: float, first: float, q: float, sigma: float) -> float:
    """-log L but for a constant, by a Kalman filter of its own, of the exact motion."""
    move, x, P, total = np.exp(a * DT), first, 0.0, 0.0
    for u, y in zip(log.u, log.y, strict=True):
        s, e = P + sigma**2, y - x
        total += (e * e / s + np.log(s)) / 2
        x, P = x + P / s * e, P - P * P / s
        x, P = move * x + (move - 1) / a * u, move**2 * P + q * (move**2 - 1) / (2 * a)
    return total


def test_it_is_the_likelihood_of_another_filter() -> None:
    """To the errors of Runge-Kutta, (a h)^5/120, and of Simpson's rule, (2 a h)^4/2880, with h = 0.1."""
    log = held(1, 40)
    arrays = hg.Log(log.u[:, None], log.y[:, None], DT)
    problem = Predicting(PLANT, (A,), (arrays,), np.array([2.0]), 40, 1, unit=np.array([10.0]))
    logs = [np.log(0.3 * 40 * DT / 10**2), np.log((0.07 / 2) ** 2)]
    v, cost, gaps = problem.graph
    unknowns = np.array([0.8, 0.1, *logs])
    assert gaps.numel() == 0
    assert float(ca.Function("cost", [v], [cost])(unknowns)) == pytest.approx(
        likelihood(log, 0.8, 0.1, 0.3, 0.07), rel=1e-4
    )
    assert problem.noise(unknowns) == ({"x": pytest.approx(0.3)}, {"y": pytest.approx(0.07)})


def test_what_noise_adds_along_a_sample_is_the_integral() -> None:
    """Exactly for a chain of two integrators, and to third order for an oscillator, by van Loan's exponential."""
    for stiffness, tolerance in ((0.0, 1e-12), (9.0, 0.3**3)):
        F, h, Qc = np.array([[0.0, 1], [-stiffness, 0]]), 0.1, np.diag([0.0, 2.0])
        block = expm(np.block([[-F, Qc], [np.zeros((2, 2)), F.T]]) * h)
        exact = block[2:, 2:].T @ block[:2, 2:]
        made = accumulated_noise(ca.DM(expm(F * h)), ca.DM(Qc * h)).full()
        assert np.abs(made - exact).max() <= tolerance * np.abs(exact).max()


def test_a_state_that_is_a_rate_has_no_noise_of_its_own() -> None:
    v = hg.Signal("v", low=-5, high=5)
    plant = hg.System("pair", states=(X, v), inputs=(U,), outputs=(Y,), parameters=(A,), flow=[v, -A * X], output=[X])
    problem = Predicting(plant, (A,), (), np.ones(1), 10, 1, unit=np.ones(2))
    assert problem.noisy == ("v",)
