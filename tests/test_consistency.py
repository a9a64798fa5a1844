"""Innovations, their variances and covariances of a run, and whether an observer is consistent."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.run import consistency as consistency_module
from hgogen.run.consistency import prediction_warnings, quantile, whiteness
from hgogen.run.prediction import Prediction
from hgogen.run.samples import BadShape

Array = np.ndarray
DT, N = 0.02, 400
F = np.array([[0.0, 1.0], [-4.0, -0.4]])  # an oscillator, slow against DT
PHI = np.eye(2) + DT * F + DT**2 / 2 * F @ F
C = np.array([[2.0, 0.0], [0.0, 1.0]])
Q, R, P0 = np.array([0.02, 0.3]), np.array([1e-3, 4e-3]), np.array([0.01, 0.05])


def plant(outputs: int = 2) -> hg.System:
    q, w = hg.Signal("q", low=-50, high=50), hg.Signal("w", low=-50, high=50)
    signals = tuple(hg.Signal(name) for name in ("angle", "rate")[:outputs])
    return hg.System(
        "oscillator", states=(q, w), outputs=signals, flow=[w, -4 * q - 0.4 * w], output=[2 * q, w][:outputs]
    )


def filtering(
    system: hg.System, method: object = hg.methods.continuous_discrete, noise: float = 1.0, process: float = 1.0
) -> hg.Step:
    """A Kalman filter of the plant, its R and Q so many times the plant's."""
    names = [y.name for y in system.outputs]
    gains = {"Q": dict(zip("qw", process * Q, strict=True)), "R": dict(zip(names, noise * R, strict=False))}
    observer = hg.observers.riccati(hg.forms.original(system), **gains, initial={"q": 1, "w": 0}, covariance=P0)
    return hg.sample(observer, method, dt=DT)


def simulated(draw: np.random.Generator, outputs: int = 2, count: int = N) -> tuple[Array, Array]:
    """Samples and states of the plant as the filter takes it: process noise of covariance Q DT a sample, readings of
    variance R/DT, a first state drawn from the filter's."""
    x, states = np.array([1.0, 0.0]) + np.sqrt(P0) * draw.standard_normal(2), []
    for _ in range(count):
        states.append(x)
        x = PHI @ x + np.sqrt(Q * DT) * draw.standard_normal(2)
    states = np.array(states)
    return (states @ C.T + np.sqrt(R / DT) * draw.standard_normal((count, 2)))[:, :outputs], states


def dense(y: Array) -> tuple[Array, Array, Array]:
    """A Kalman filter written plainly: e (N, p), s (N, p), P (N, n, n), of all outputs before any corrects."""
    x, P = np.array([1.0, 0.0]), np.diag(P0)
    e, s, covariance = np.full(y.shape, np.nan), np.full(y.shape, np.nan), []
    for k, sample in enumerate(y):
        if k:
            x, P = PHI @ x, PHI @ P @ PHI.T + DT * np.diag(Q)
        there = np.isfinite(sample)
        H, S = C[: y.shape[1]], C[: y.shape[1]] @ P @ C[: y.shape[1]].T + np.diag(R[: y.shape[1]]) / DT
        e[k], s[k] = sample - H @ x, np.where(there, np.diag(S), np.nan)
        H, S = H[there], S[there][:, there]
        gain = P @ H.T @ np.linalg.inv(S)
        x, P = x + gain @ e[k, there], P - gain @ H @ P
        covariance.append(P)
    return e, s, np.array(covariance)


def slow(y: Array) -> Array:
    """The second output every fifth sample, the first with a gap."""
    y = y.copy()
    y[np.arange(len(y)) % 5 > 0, 1] = np.nan
    y[100:120, 0] = np.nan
    return y


METHODS = {"continuous_discrete": 1e-6, "cholesky": 1e-6, "rk4": 0.1, "rk4_covariance": 0.1}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("engine", ["c", "python"])
def test_innovations_and_covariance_are_those_of_a_kalman_filter(name: str, engine: str) -> None:
    """Of the plant's transition exp(DT F) both take other roundings, of order (DT |F|)^3/6 = 9e-5 in a state, some ten
    of which a filter remembers: 5e-3 of an innovation of .2. Variances do not see it. Methods that integrate with the
    measurement differ by what they take it to be between samples, of order DT times the filter's rate, about 1/10."""
    y = slow(simulated(np.random.default_rng(1))[0])
    run = filtering(plant(), getattr(hg.methods, name)).run(y=y, engine=engine)
    e, s, P = dense(y)
    assert run.innovations is not None
    assert run.variances is not None
    assert run.covariance is not None
    assert np.array_equal(np.isnan(run.innovations), np.isnan(y))
    assert np.array_equal(np.isnan(run.variances), np.isnan(y))
    share = METHODS[name]
    np.testing.assert_allclose(run.variances[20:], s[20:], rtol=share)
    np.testing.assert_allclose(run.covariance[20:], P[20:], rtol=share, atol=share * P[20:].max())
    differences = np.nanstd((run.innovations - e)[20:], axis=0)
    assert (differences <= 2 * max(2.5e-3, share) * np.nanstd(e[20:], axis=0)).all()


def test_two_sensors_of_one_state_have_the_variances_of_the_prediction() -> None:
    """By a filter that corrects at samples, and by one that integrates with them: their variances differ by what the
    filter forgets between samples, a fifth. None depends on the other sensor, and they are correlated."""
    q, w = hg.Signal("q", low=-50, high=50), hg.Signal("w", low=-50, high=50)
    outputs = (hg.Signal("one"), hg.Signal("other"))
    system = hg.System("twice", states=(q, w), outputs=outputs, flow=[w, -4 * q - 0.4 * w], output=[2 * q, 2 * q])
    runs = [
        filtering(system, method, noise=0.03).run(y=np.zeros((N, 2)))
        for method in (hg.methods.continuous_discrete, hg.methods.rk4)
    ]
    variances = [run.variances[100:].mean(axis=0) for run in runs]
    np.testing.assert_allclose(variances[1], variances[0], rtol=0.2)
    for run in runs:
        S, r = run.joint[100:], 0.03 * R / DT
        np.testing.assert_allclose(S[:, 0, 0] - r[0], S[:, 0, 1], rtol=1e-9)  # C P C' of one row twice
        np.testing.assert_allclose(S[:, 1, 1] - r[1], S[:, 0, 1], rtol=1e-9)


@pytest.mark.ordinary("continuous_discrete")
@pytest.mark.parametrize("name", ["continuous_discrete", "cholesky"])
def test_a_bank_has_the_variances_of_the_member_that_is_selected(name: str) -> None:
    """Of two members the one that did not restart last: its covariance, which depends on no sample, is P0 just after
    its restart one period before. The first has never restarted."""
    every, count = 12, 60
    y, method = simulated(np.random.default_rng(4), 1, count)[0], getattr(hg.methods, name)
    member = filtering(plant(1), method).observer
    bank = hg.observers.bank(member, count=2, period=every * DT, hysteresis=1e-3)
    run = hg.sample(bank, method, dt=DT).run(y=y)

    def known(k: int, at: int) -> tuple[float, Array]:
        """s and P in sample k of the member that is selected after sample `at`."""
        begin, P, s = max(0, (at // every - 1) * every), np.diag(P0), 0.0
        for j in range(begin, k + 1):
            P = PHI @ P @ PHI.T + DT * np.diag(Q) if j > begin else P
            if j > begin or not begin:  # it restarts when the sample is over
                s = C[0] @ P @ C[0] + R[0] / DT
                P = P - np.outer(P @ C[0], C[0] @ P) / s
        return s, P

    variances = [known(k, max(0, k - 1))[0] for k in range(count)]
    covariance = [known(k, k)[1] for k in range(count)]
    assert list(run.traces["selected"]) == [float(k // every % 2) for k in range(count)]
    np.testing.assert_allclose(run.covariance, covariance, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(run.variances[:, 0], variances, rtol=1e-6)


def test_the_covariance_is_that_of_the_plants_states() -> None:
    """The phase form's coordinates are z = (2 q, 2 w)."""
    y = simulated(np.random.default_rng(2), 1)[0]
    system = plant(1)
    form = hg.forms.phase(system)
    observer = hg.observers.riccati(form, Q=4 * Q, R=R[:1], initial={"q": 1, "w": 0}, covariance=4 * P0)
    run = hg.sample(observer, dt=DT).run(y=y)
    assert run.covariance is not None
    np.testing.assert_allclose(run.covariance, filtering(system).run(y=y).covariance, rtol=1e-9, atol=1e-12)


def test_a_run_that_is_not_asked_takes_no_sample_twice_and_none_is_disturbed() -> None:
    y = simulated(np.random.default_rng(3), 1)[0]
    step = filtering(plant(1))
    first, second = step.run(y=y[:200]), step.run(y=y[200:])
    whole = filtering(plant(1)).run(y=y)
    saved = step.save()
    assert first.innovations is not None
    assert whole.innovations is not None
    assert np.array_equal(np.concatenate([first.innovations, second.innovations]), whole.innovations)
    assert step.save() == saved
    assert np.array_equal(whole.since(150).innovations, whole.innovations[150:])
    assert np.array_equal(whole.since(100).since(50).covariance, whole.covariance[150:])
    assert len(whole.since(500).innovations) == 0


def test_what_a_run_is_given_may_change_afterwards() -> None:
    y = simulated(np.random.default_rng(3), 1)[0]
    run, before = filtering(plant(1)).run(y=y), y.copy()
    y[:] = 0
    assert np.array_equal(run.innovations, filtering(plant(1)).run(y=before).innovations)


def test_an_observer_without_a_covariance_has_innovations_alone() -> None:
    y = simulated(np.random.default_rng(3), 1)[0]
    observer = hg.observers.high_gain(hg.forms.phase(plant(1)), theta=5, poles=(-1, -1))
    run = hg.sample(observer, dt=DT).run(y=y)
    assert run.innovations is not None
    assert (run.variances, run.covariance) == (None, None)
    whole = hg.consistency(run, {"q": np.zeros(N)})
    assert (whole.outputs[0].count, whole.outputs[0].nis, whole.states) == (N, None, None)


def test_quantiles_of_chi_square_are_those_of_the_tables() -> None:
    """Wilson and Hilferty's are 4 % off at the low end of 5 degrees of freedom, and soon better."""
    table = {(0.95, 20): 31.410, (0.025, 20): 9.591, (0.975, 20): 34.170, (0.025, 5): 0.831, (0.975, 1000): 1089.531}
    for (p, freedom), value in table.items():
        assert quantile(p, freedom) == pytest.approx(value, rel=0.25 / freedom)


def test_a_matched_filter_is_consistent_at_the_rate_of_its_bands() -> None:
    """Of 200 runs of a matched filter each band is left by a binomial number of mean 10 and deviation 3.1: four
    deviations are 22. Beyond 2 sigma are .0455 of 80,000 innovations, whose deviation is 7.4e-4. The NEES of
    neighbours hangs together, and its band counts how much, by an estimate: twice the rate is allowed."""
    step, draw = filtering(plant()), np.random.default_rng(4)
    outside, coloured, errors, shares, means = np.zeros(2), np.zeros(2), 0, [], []
    for _ in range(200):
        y, states = simulated(draw)
        step.reset()
        whole = hg.consistency(step.run(y=y), {"q": states[:, 0], "w": states[:, 1]})
        outside += [not one.band[0] <= one.nis <= one.band[1] for one in whole.outputs]
        coloured += [not one.whiteness.white for one in whole.outputs]
        errors += not whole.states.band[0] <= whole.states.nees <= whole.states.band[1]
        shares.append([one.outside for one in whole.outputs])
        means.append(whole.states.nees)
    assert ((outside >= 1) & (outside <= 22)).all()
    assert ((coloured >= 1) & (coloured <= 22)).all()
    assert errors <= 32
    assert np.mean(shares, axis=0) == pytest.approx(0.0455, abs=4 * 7.4e-4)
    assert np.mean(means) == pytest.approx(2, rel=0.05)


@pytest.mark.parametrize("noise", [0.01, 100])
def test_a_mistuned_filter_is_inconsistent(noise: float) -> None:
    """With R a hundred times too large the readings' part of s is, and most of it: NIS falls far below 1; with R a
    hundredth it rises above 1."""
    y, _ = simulated(np.random.default_rng(5))
    for one in hg.consistency(filtering(plant(), noise=noise).run(y=y)).outputs:
        assert one.nis > 2 if noise < 1 else one.nis < 0.5
        assert not one.band[0] <= one.nis <= one.band[1]


def test_sentences_say_what_is_off() -> None:
    y, states = simulated(np.random.default_rng(6))
    truth = {"w": states[:, 1]}
    assert not [said for said in hg.consistency(filtering(plant()).run(y=y), truth).sentences() if "times" in said]
    large, small = (hg.consistency(filtering(plant(), noise=n).run(y=y), truth).sentences() for n in (1e-4, 1e4))
    assert any("innovations of angle are" in said and "too small" in said for said in large)
    assert any("innovations of angle are" in said and "too large" in said for said in small)
    assert any("errors of w are" in said and "which is too small" in said for said in large)
    careful = hg.consistency(filtering(plant(), noise=10, process=10).run(y=y), truth).sentences()
    assert any("errors of w are" in said and "which is too large" in said for said in careful)
    drifting = filtering(plant()).run(y=y + np.sin(np.arange(N) / 10)[:, None])
    assert any("not white" in said for said in hg.consistency(drifting).sentences())


def test_a_nis_of_few_samples_is_one_of_outliers() -> None:
    """One innovation in 20 is 30 deviations: NIS is 46, by the median 1.1, by that of |e|; of all twice as large 4."""
    normed = np.random.default_rng(7).normal(size=2000)
    wild = np.where(np.arange(2000) % 20, normed, 30.0)
    few, many = (consistency_module._output_consistency("y", e, np.ones(2000)) for e in (wild, 2 * normed))
    assert (few.median, many.median) == (pytest.approx(1.1, abs=0.1), pytest.approx(4, abs=0.3))
    said = [consistency_module.Consistency((one,), None).sentences()[0] for one in (few, many)]
    assert "few samples are the cause, since by the median they are 1.0" in said[0]
    assert "gate = {y = 0.999}" in said[0]
    assert said[1].endswith("R, Q or both are too small, or the model is wrong")


def test_a_bad_truth_is_a_sentence() -> None:
    run = filtering(plant()).run(y=np.zeros((5, 2)))
    with pytest.raises(BadShape, match="names no state; the states are q, w"):
        hg.consistency(run, {"v": np.zeros(5)})
    with pytest.raises(BadShape, match=r"truth of w of shape \(4,\) must have shape \(5,\)"):
        hg.consistency(run, {"w": np.zeros(4)})


def test_little_to_judge_by_is_no_error() -> None:
    step = filtering(plant())
    for y in (np.full((1, 2), 0.3), np.full((5, 2), np.nan), np.zeros((50, 2)), np.zeros((0, 2))):
        step.reset()
        whole = hg.consistency(step.run(y=y), {"w": np.full(len(y), np.nan)})
        assert [one.count for one in whole.outputs] == [int(np.isfinite(y[:, 0]).sum())] * 2
        assert whole.states is None
    assert whiteness(np.ones(100)) is None


def test_the_statistic_is_ljung_and_boxs() -> None:
    """N (N + 2) sum_k r_k^2/(N - k), by sums written out."""
    e = np.random.default_rng(2).normal(size=30).cumsum()
    d, N = e - e.mean(), 30
    r = [float(d[k:] @ d[: N - k] / (d @ d)) for k in range(11)]
    test = whiteness(e)
    assert test is not None
    assert test.lags == 10
    assert test.statistic == pytest.approx(N * (N + 2) * sum(r[k] ** 2 / (N - k) for k in range(1, 11)), rel=1e-9)
    gappy = np.where(np.arange(N) % 7 == 0, 0.0, np.nan)
    assert hg.consistency(filtering(plant()).run(y=np.zeros((N, 2))), {"w": gappy}).states.count == len(range(0, N, 7))


def test_worse_than_copying_is_a_sentence() -> None:
    rows = [
        Prediction("y", 1, 0.1, 0.2, 9, 0),
        Prediction("y", 5, 0.4, 0.3, 9, 0),
        Prediction("y", None, 9.0, None, 9, 0),
    ]
    still = [Prediction("y", 1, 0.1, 0.0, 9, 0), Prediction("y", None, 9.0, None, 9, 0)]
    assert list(prediction_warnings(still)) == [
        "y is constant in the whole log, so that the error of copying is 0: give a log in which it moves"
    ]
    (said,) = prediction_warnings(rows)
    assert said.startswith(
        "y: predictions are worse than copying 5 steps ahead, by RMS errors of 0.4 for 0.3; if this is only until"
    )
    assert "give --initial or --burn-in; otherwise fit" in said


@pytest.mark.full
def test_run_says_whether_an_observer_is_consistent(tmp_path: Path) -> None:
    draw = np.random.default_rng(7)
    t = np.arange(1500) * 0.01
    q = np.exp(-0.05 * t) * np.cos(4.3 * t)
    w = np.gradient(q, 0.01)
    known = np.where(np.arange(1500) % 3 == 0, w, np.nan)
    y = q + 1e-3 * draw.standard_normal(1500)
    rows = zip(t, y, known, strict=True)
    text = "\n".join(f"{a:.4f},{b:.9f},{'' if np.isnan(c) else c},0" for a, b, c in rows)
    (tmp_path / "log.csv").write_text(f"t,y,rate,tau\n{text}\n")
    words = ("run", "pendulum", "--data", str(tmp_path / "log.csv"), "--time", "t", "--dt", "0.01", "--truth", "w=rate")
    out = ("--observer", "riccati", "-o", str(tmp_path / "out"))
    answer = json.loads(hgogen(*words, *out, "--json")[0])
    (one,) = answer["innovations"]
    assert one["count"] == 1500
    assert one["whiteness"]["test"] == "Ljung-Box"
    assert answer["nees"]["count"] == 500
    shown = hgogen(*words, *out)[0]
    assert "its 95 % band" in shown
    assert "NEES of w" in shown
    innovations = np.genfromtxt(tmp_path / "out" / "log_innovations.csv", delimiter=",", names=True)
    assert innovations.dtype.names == ("t", "e_y", "s_y", "P_q_q", "P_w_q", "P_w_w")
    assert np.mean(innovations["e_y"] ** 2 / innovations["s_y"]) == pytest.approx(one["nis"], rel=1e-6)
    assert (tmp_path / "out" / "log_innovations.svg").exists()


def test_innovations_of_any_size_are_judged() -> None:
    """As of a step without guards whose estimate has grown large before it is no number."""
    e, s = np.random.default_rng(4).standard_normal(100), np.ones(100)
    for size in (2.0**1020, 2.0**-1000):
        assert whiteness(e * size) == whiteness(e)
    large = consistency_module._output_consistency("y", e * 1e300, s)
    assert (large.nis, large.outside) == (np.inf, 1.0)
    assert consistency_module._output_consistency("y", e * 1e-200, s).nis == 0.0


def test_whiteness_is_that_of_innovations_over_their_deviations() -> None:
    e, s = np.random.default_rng(3).normal(size=200), np.linspace(0.1, 9.0, 200)
    assert consistency_module._output_consistency("y", e, s).whiteness == consistency_module.whiteness(e / np.sqrt(s))


def test_errors_are_as_many_times_too_large_as_a_state_s_share_of_nees() -> None:
    states = consistency_module.StateConsistency(("a", "b"), 100, 1.0, 8.0, (1.0, 3.0))
    (sentence,) = consistency_module.Consistency((), states).sentences()
    assert "errors of a, b are 2 times as large" in sentence


def test_two_sensors_that_measure_a_jump_have_the_same_innovation() -> None:
    """Of one state, before either corrects: by a filter that corrects at samples, and by one that integrates."""
    q, w = hg.Signal("q", low=-50, high=50), hg.Signal("w", low=-50, high=50)
    outputs = (hg.Signal("one"), hg.Signal("other"))
    system = hg.System("twice", states=(q, w), outputs=outputs, flow=[w, -4 * q - 0.4 * w], output=[2 * q, 2 * q])
    y = np.zeros((60, 2))
    y[50:] = 1.0
    for method in (hg.methods.continuous_discrete, hg.methods.rk4):
        first, second = filtering(system, method, noise=0.03).run(y=y).innovations[50]
        assert second == pytest.approx(first, rel=1e-12)


def test_nis_of_several_outputs_is_by_their_joint_covariance() -> None:
    """Two sensors of one state with little noise have nearly the same innovation: their sum and their difference."""
    draw = np.random.default_rng(7)
    y = simulated(draw, 2, 4000)[0]
    y[draw.random(y.shape) < 0.1] = np.nan
    run = filtering(plant()).run(y=y)
    statistics = consistency_module.consistency(run)
    assert statistics.joint is not None
    assert statistics.joint.freedom == np.isfinite(y).sum()
    assert statistics.joint.band[0] < statistics.joint.nis < statistics.joint.band[1]
    e, S, total = run.innovations, run.joint, 0.0
    for row, each in zip(e, S, strict=True):
        there = np.isfinite(row)
        total += row[there] @ np.linalg.solve(each[there][:, there], row[there])
    assert statistics.joint.nis == pytest.approx(total / statistics.joint.freedom, rel=1e-9)
    assert consistency_module.consistency(filtering(plant(1)).run(y=y[:, :1])).joint is None


def test_a_wrong_correlation_is_a_sentence() -> None:
    joint = consistency_module.JointConsistency(("a", "b"), 100, 4.0, (0.8, 1.2))
    (sentence,) = consistency_module.Consistency((), None, joint).sentences()
    assert "innovations of a, b together are 2 times as large" in sentence
    assert not consistency_module.Consistency((), None, replace(joint, nis=1.1)).sentences()


def test_what_is_forgotten_until_a_sample_is_in_its_variance() -> None:
    """s = exp(rho h) c Phi P Phi' c' + R/h of the P of the last sample, of a filter that integrates with them."""
    observer = hg.observers.kalman_like(hg.forms.state_affine(plant(1)), rho=20, R=R[0])
    run = hg.sample(observer, hg.methods.rk4, dt=DT).run(y=simulated(np.random.default_rng(3), 1, 60)[0])
    c = C[0] @ PHI
    known = np.exp(20 * DT) * np.einsum("i,kij,j->k", c, run.covariance[:-1], c) + R[0] / DT
    assert run.variances[1:, 0] == pytest.approx(known, rel=1e-3)
