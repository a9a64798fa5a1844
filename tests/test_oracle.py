"""The oracle itself, held against mathematics it does not use and against the reference trial's answers."""

from dataclasses import replace

import numpy as np
import pytest
from oracle import adaptive_ekf as ekf
from oracle import fitzhugh_nagumo as fn

STAGGERED = ekf.Staggered(d=1.0, M=4)


# --- theta --------------------------------------------------------------------------------------------------


def rise(theta: ekf.Array, theta_1: float) -> ekf.Array:
    """F_0 of equation (5), Delta T = 1."""
    return np.where(theta <= theta_1, theta**2, (theta - 2.0 * theta_1) ** 2)


def test_the_rise_is_the_exact_flow():
    law = fn.adaptive()
    theta, s = (a.ravel() for a in np.meshgrid(np.linspace(1.0, 8.0, 29), np.linspace(0.0, 2.0, 21)))
    fine, steps = theta, 4000
    for _ in range(steps):
        middle = fine + s / steps / 2.0 * rise(fine, 4.0)
        fine = fine + s / steps * rise(middle, 4.0)
    # Midpoint rule: h^3 theta^4 a step, carried to theta_1 by (theta_1/theta)^2, sums to 48 h^2; the kink
    # adds 32 h^2 once; above theta_1 the flow contracts.
    np.testing.assert_allclose(law.risen(theta, s), fine, rtol=0, atol=80.0 * (2.0 / steps) ** 2)


def test_rise_then_fall_is_first_order_in_dt():
    errors = []
    for steps in (100, 200):
        law = replace(fn.adaptive(), mu=lambda innovation: np.full_like(innovation, 0.3))
        theta, exact, dt = np.array([1.5]), np.array([1.5]), 0.2 / steps
        for _ in range(steps):
            theta = law.next(theta, np.zeros(1), dt)
        for _ in range(20000):
            exact = exact + 0.2 / 20000 * (0.3 * rise(exact, 4.0) / law.rise + 0.7 * law.decay * (1.0 - exact))
        errors.append(abs(theta[0] - exact[0]))
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("dt", [1e-4, 0.1, 100.0])
def test_theta_keeps_its_range(dt: float):
    law = fn.adaptive()
    theta = np.linspace(1.0, 8.0, 50)
    for innovation in (0.0, 0.16, 0.2, 0.32, 1e30):
        after = law.next(theta, np.full(50, innovation), dt)
        assert after.min() >= 1.0
        assert after.max() <= 8.0
        assert (np.diff(after) >= 0.0).all()  # a flow keeps the order


def test_mu_meets_equation_6():
    mu = ekf.smoothstep(0.16, 0.32)
    assert mu(np.array([0.0, 0.16, 0.24, 0.32, 9.0])).tolist() == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    assert ekf.logistic(0.16, 500.0)(np.array([0.16]))[0] == 0.5


def test_decaying_theta_is_the_exponential():
    law = ekf.Decaying(initial=5.0, decay=0.1)
    theta = np.array([5.0])
    for _ in range(300):
        theta = law.next(theta, np.zeros(1), 0.01)
    assert theta[0] == pytest.approx(1.0 + 4.0 * np.exp(-0.3), rel=1e-13)


# --- predict and update -------------------------------------------------------------------------------------


def test_jacobian_is_the_derivative_inside_the_box():
    form, z, step = fn.form(), np.array([1.1, -4.0, 5.0]), 1e-6
    slopes = [(form.f(z + step * e, 0.7) - form.f(z - step * e, 0.7)) / (2.0 * step) for e in np.eye(3)]
    np.testing.assert_allclose(form.F(z, 0.7), np.transpose(slopes), atol=1e-8)  # h^2 f'''/6 + eps |f|/h


def test_saturation_clamps_the_arguments_of_b_and_never_the_linear_part():
    form, edge = fn.form(), np.array([3.5, 10.0, 0.0])
    far = edge + np.array([1.0, 2.0, 100.0])
    np.testing.assert_allclose(form.f(far, 0.5) - form.f(edge, 0.5), [-0.5 * 2.0, fn.EPS * 100.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(form.F(far, 0.5), form.F(edge, 0.5))


def test_one_step_agrees_with_the_information_form():
    theta, dt, rng = np.array([3.0]), 0.01, np.random.default_rng(0)
    observer = fn.observer(ekf.Constant(3.0))
    root = rng.standard_normal((3, 3))
    before = ekf.State(rng.standard_normal((1, 3)), (root @ root.T)[None], theta, np.zeros(1), 0.2, None)
    after = ekf.step(observer, before, 0.6, np.array([0.9]))

    predicted = ekf.predict(observer, before, 0.6)
    middle = before.z + dt / 2 * observer.form.f(before.z + dt / 2 * observer.form.f(before.z, 0.2), 0.4)
    F = observer.form.F(middle, 0.4)[0]
    Phi = np.eye(3) + dt * F + dt**2 / 2 * F @ F
    inverse_delta = np.diag([1.0, 3.0, 9.0])
    P = Phi @ before.P[0] @ Phi.T + dt * 3.0 * inverse_delta @ observer.Q @ inverse_delta
    np.testing.assert_allclose(predicted.P[0], P, rtol=1e-12, atol=1e-12)

    weight = 3.0 * dt / observer.R * np.diag([1.0, 0.0, 0.0])  # C' C / r
    S = np.linalg.inv(P) + weight
    np.testing.assert_allclose(after.P[0] @ S, np.eye(3), atol=1e-11)  # eps times the condition number, < 1e4 here
    gain = np.linalg.solve(S, weight @ np.array([1.0, 0.0, 0.0]))
    expected = predicted.z[0] + gain * (0.9 - predicted.z[0, 0])
    np.testing.assert_allclose(after.z[0], expected, rtol=1e-11, atol=1e-12)


def chain(theta: float, dt: float) -> ekf.Observer:
    """Three integrators, the first measured: linear, no b."""
    A = np.diag([1.0, 2.0], 1)
    form = ekf.Form(lambda z, u: z @ A.T, lambda z, u: np.broadcast_to(A, (*z.shape, 3)), lambda u: np.eye(3)[0])
    Q, P0 = np.diag([0.1, 0.2, 0.3]), np.eye(3)
    return ekf.Observer(form, Q, 1.0, P0, np.zeros(3), dt, ekf.Constant(theta))


def stabilising_riccati(Phi: ekf.Array, Q: ekf.Array, C: ekf.Array, r: float) -> ekf.Array:
    """P = Phi (P - P C'(r + C P C')^-1 C P) Phi' + Q from the stable subspace of its symplectic matrix."""
    G, back = np.outer(C, C) / r, np.linalg.inv(Phi)
    symplectic = np.block([[Phi.T + G @ back @ Q, -G @ back], [-back @ Q, back]])
    values, vectors = np.linalg.eig(symplectic)
    stable = vectors[:, np.abs(values) < 1.0]
    return np.real(stable[3:] @ np.linalg.inv(stable[:3]))


@pytest.mark.parametrize("theta", [1.0, 3.0])
def test_linear_observer_reaches_the_riccati_fixed_point(theta: float):
    observer, dt = chain(theta, 0.05), 0.05
    last = ekf.run(observer, np.zeros(2000), np.zeros((1, 2000))).last
    A = np.diag([1.0, 2.0], 1)
    Phi = np.eye(3) + dt * A + dt**2 / 2 * A @ A
    Q = dt * ekf.process_noise(observer.Q, np.array([theta]))[0]
    expected = stabilising_riccati(Phi, Q, np.eye(3)[0], observer.R / (theta * dt))
    predicted = ekf.predict(observer, last, 0.0).P[0]
    np.testing.assert_allclose(predicted, expected, rtol=1e-9)  # eigenvectors near a multiple eigenvalue at 1


def test_a_chain_at_theta_is_the_chain_at_one_with_time_theta_dt():
    theta, dt = 3.0, 0.02
    scale = np.diag([1.0, theta, theta**2])  # Delta^-1
    high = replace(chain(theta, dt), P0=scale @ scale)
    y = np.random.default_rng(1).standard_normal((2, 300))
    slow, fast = (ekf.run(o, np.zeros(300), y) for o in (chain(1.0, theta * dt), high))
    np.testing.assert_allclose(fast.z, slow.z @ scale, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fast.last.P, scale @ slow.last.P @ scale, rtol=1e-9)


def test_without_measurements_the_estimate_follows_the_plant():
    errors = []
    for dt in (0.02, 0.01):
        scenario = fn.Scenario((), 2.0)
        t, x = fn.times(scenario, dt), fn.truth(scenario, dt, substeps=20)
        observer = replace(fn.observer(ekf.Constant(1.0), dt=dt), z0=np.array([*fn.START, -5.0]))
        z = ekf.run(observer, np.sin(t), np.full((1, len(t)), np.nan)).z[0]
        errors.append(np.abs(z - x * [1, 1, -1]).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.4)  # the line between samples of u is second order
    assert errors[1] < 1e-4


def test_a_missing_sample_only_predicts():
    observer = fn.observer(fn.adaptive(), STAGGERED)
    state = ekf.step(observer, ekf.start(observer, 2), 0.0, np.array([1.0, 1.0]))
    both = ekf.step(observer, state, 0.01, np.array([1.0, np.nan]))
    predicted = ekf.predict(observer, state, 0.01)
    np.testing.assert_array_equal(both.z[1], predicted.z[1])
    np.testing.assert_array_equal(both.P[1], predicted.P[1])
    assert not np.array_equal(both.z[0], predicted.z[0])
    assert both.predictors.count[:, 0].tolist() == [2.0, 1.0]


def test_records_do_not_touch_each_other():
    t = np.arange(150) * fn.DT
    y = 1.0 + fn.noise(range(3), 150)
    observer = fn.observer(fn.adaptive(), STAGGERED)
    together, alone = ekf.run(observer, np.sin(t), y), ekf.run(observer, np.sin(t), y[1:2])
    np.testing.assert_allclose(together.z[1], alone.z[0], rtol=1e-12, atol=1e-14)


# --- innovation ---------------------------------------------------------------------------------------------


def literal_cost(z: ekf.Array, u: ekf.Array, y: ekf.Array, launched: int, now: int) -> float:
    """Equation of section 2.3 as it reads: Heun from the estimate at `launched`, summed to `now`."""
    f, x, h, cost = fn.form().f, z[launched], fn.DT, 0.0
    for k in range(launched + 1, now + 1):
        slope = f(x, u[k - 1])
        x = x + h / 2.0 * (slope + f(x + h * slope, u[k]))
        cost += h * (y[k] - x[0]) ** 2
    return cost


def recorded(innovation: ekf.Staggered | ekf.Window) -> tuple[ekf.Array, ekf.Array, ekf.Array, ekf.Array]:
    """z, u, y and the innovation of 240 samples with d = .4 (40 samples)."""
    t = np.arange(240) * fn.DT
    y = np.cos(t) + fn.noise(range(1), 240)[0]
    record = ekf.run(fn.observer(fn.adaptive(), innovation), np.sin(t), y[None])
    return record.z[0], np.sin(t), y, record.innovation[0]


def test_window_is_a_simulation_from_the_estimate_d_ago():
    z, u, y, innovation = recorded(ekf.Window(0.4))
    expected = [literal_cost(z, u, y, max(k - 40, 0), k) for k in range(1, 240)]
    np.testing.assert_allclose(innovation[1:], expected, rtol=1e-12)


def test_staggered_predictors_are_launched_every_quarter_of_d():
    z, u, y, innovation = recorded(ekf.Staggered(0.4, M=4))
    for k in range(51, 240):
        launched = (k - 41) // 10 * 10  # the oldest of the starts 10, 20, .. that has seen more than 40 samples
        age = k - launched
        assert 40 < age <= 50
        assert innovation[k] == pytest.approx(literal_cost(z, u, y, launched, k) * 40 / age, rel=1e-12)


def test_a_young_predictor_is_not_scaled_up():
    _, u, y, innovation = recorded(ekf.Staggered(0.4, M=4))
    first = fn.DT * y[0] ** 2  # every predictor stands at z(0) = 0 when the first sample comes
    f, x = fn.form().f, np.zeros(3)
    slope = f(x, u[0])
    x = x + fn.DT / 2.0 * (slope + f(x + fn.DT * slope, u[1]))
    assert innovation[1] == pytest.approx(first + fn.DT * (y[1] - x[0]) ** 2, rel=1e-12)


# --- trial and metrics --------------------------------------------------------------------------------------


def test_noise_has_its_deviation_and_its_correlation_time():
    n = fn.noise(range(400), 500)
    # 400 records of 500 dt / (2 tau) = 25 independent samples: four standard errors are 4/sqrt(2 * 10^4) = 3%
    assert n.std() == pytest.approx(0.2, rel=0.03)
    assert n[:, 0].std() == pytest.approx(0.2, rel=4.0 / np.sqrt(2 * 400))  # stationary from the start
    assert np.mean(n[:, 10:] * n[:, :-10]) / 0.04 == pytest.approx(np.exp(-1.0), abs=0.04)


def test_metrics_on_signals_that_can_be_read_off():
    t = np.arange(2001) * 0.01
    error = np.where(t < 7.0, 1.0, 0.1)
    early = np.where((t > 5.5) & (t < 6.0), 0.1, error)  # half a time unit inside does not count
    never = np.ones_like(t)
    assert fn.settling(t, np.array([error, early]), since=5.0) == pytest.approx([2.0, 2.0])
    assert np.isnan(fn.settling(t, never[None], since=5.0)[0])
    assert fn.rms(t, error[None], 6.0, 8.0)[0] == pytest.approx(np.sqrt((1.0 + 0.01) / 2.0))
    theta = np.where((t > 6.0) & (t < 9.0), 2.0, 1.0)
    assert fn.calm_again(t, np.array([theta, np.ones_like(t)]), since=5.0) == pytest.approx([4.0, 0.0])


def trial(
    observer: ekf.Observer, scenario: fn.Scenario, seeds: int = 12, clean: bool = False
) -> tuple[ekf.Array, ekf.Array, ekf.Record]:
    """t, eta's error (s, k), record."""
    t, x = fn.times(scenario), fn.truth(scenario)
    y = x[:, 0] + (np.zeros((1, len(t))) if clean else fn.noise(range(seeds), len(t)))
    record = ekf.run(observer, np.sin(t), y)
    return t, -record.z[..., 2] - x[:, 2], record


def jump(size: float, duration: float) -> fn.Scenario:
    return fn.Scenario(((50.0, 5.0 + size),), duration)


@pytest.mark.full
def test_reference_trial():
    """Settling, peak and return of theta (brackets of the known answers), and no clamp after the first 5%."""
    t, error, record = trial(fn.observer(fn.adaptive(), STAGGERED), jump(-11.0, 70.0))
    settled = fn.settling(t, error, 50.0)
    assert 7.0 <= np.median(settled) <= 9.5
    assert settled.max() <= 14.0
    assert np.logical_and(record.theta[:, t > 50].max(axis=1) >= 7.9, record.theta.max() <= 8.0).all()
    assert np.median(fn.calm_again(t, record.theta, 50.0)) == pytest.approx(11.0, abs=0.5)
    estimates = record.z[:, t > 0.05 * t[-1]] * [1, 1, -1]
    assert (np.abs(estimates) < fn.BOX[:, 1]).all()


@pytest.mark.full
def test_constant_theta_8_without_noise():
    t, error, _ = trial(fn.observer(ekf.Constant(8.0)), jump(-11.0, 60.0), clean=True)
    assert fn.settling(t, error, 50.0)[0] == pytest.approx(4.7, abs=0.1)


@pytest.mark.slow
def test_plain_ekf_takes_690():
    t, error, _ = trial(fn.observer(ekf.Constant(1.0)), jump(-11.0, 800.0))
    assert 640.0 <= np.median(fn.settling(t, error, 50.0)) <= 730.0


@pytest.mark.slow
def test_steady_error_is_the_plain_ekfs():
    """Both over the same samples, long after (500..1000): the memory of a large P fades like 1/t."""
    t, adaptive_error, _ = trial(fn.observer(fn.adaptive(), STAGGERED), jump(-11.0, 1000.0))
    informed = replace(fn.observer(ekf.Constant(1.0)), z0=np.array([*fn.START, 6.0]))
    _, ekf_error, _ = trial(informed, fn.Scenario((), 1000.0, eta=-6.0))
    adaptive, plain = (np.median(fn.rms(t, e, 500.0, 1000.0)) for e in (adaptive_error, ekf_error))
    assert plain == pytest.approx(0.0107, rel=0.1)
    assert adaptive <= 1.25 * plain


@pytest.mark.slow
def test_constant_theta_8_does_not_stay_in_noise():
    t, error, _ = trial(fn.observer(ekf.Constant(8.0)), jump(-11.0, 200.0))
    assert np.median(fn.rms(t, error, 100.0, 200.0)) == pytest.approx(0.370, rel=0.05)
    assert (np.abs(error[:, t > 190.0]) > 0.3).any(axis=1).all()


@pytest.mark.slow
def test_m_is_the_mean_of_the_quiet_innovation_and_no_threshold():
    """Centred at m = sigma^2 d, mu never lets theta rest; eta's error is 25 times the plain filter's."""
    centred = replace(fn.adaptive(), mu=ekf.logistic(0.04, 500.0))
    t, error, record = trial(fn.observer(centred, STAGGERED), jump(-11.0, 200.0))
    assert record.theta[:, t > 150.0].mean() == pytest.approx(6.35, rel=0.03)
    plain = 0.0105  # the plain filter's, test_steady_error_is_the_plain_ekfs
    assert np.median(fn.rms(t, error, 150.0, 200.0)) / plain == pytest.approx(25.0, rel=0.15)

    quiet = fn.observer(replace(fn.adaptive(), mu=np.zeros_like), ekf.Window(1.0))
    t, _, record = trial(quiet, fn.Scenario((), 300.0))
    innovation = record.innovation[:, t > 100.0]
    # 2,400 windows of relative deviation .437: four standard errors are .036
    assert innovation.mean() / 0.04 == pytest.approx(0.996, abs=0.036)
    assert (innovation > 0.04).mean() == pytest.approx(0.41, abs=0.04)
    lag, N = np.arange(1, 100), 100
    spread = np.sqrt(2 / N * (1 + 2 * np.sum((1 - lag / N) * np.exp(-2 * lag * fn.DT / 0.1))))
    assert innovation.std() / innovation.mean() == pytest.approx(spread, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("thresholds", "size", "share"),
    [
        ((0.16, 0.32), 0.0, 0.0),
        ((0.16, 0.32), 0.2, 0.0),
        ((0.16, 0.32), 0.4, 0.78),
        ((0.12, 0.20), 0.0, 0.05),
        ((0.12, 0.20), 0.2, 0.20),
        ((0.12, 0.20), 0.4, 1.0),
    ],
)
def test_triggers(thresholds: tuple[float, float], size: float, share: float):
    """theta > 1.5 within 10 after the jump, 40 seeds; to two standard errors of a difference of shares."""
    t, _, record = trial(fn.observer(fn.adaptive(*thresholds), STAGGERED), jump(size, 60.0), seeds=40)
    triggered = (record.theta[:, t >= 50.0] > 1.5).any(axis=1)
    one = 1.0 / 40.0
    error = 2.0 * np.sqrt(2.0 * max(share * (1.0 - share), one * (1.0 - one)) / 40.0)
    assert triggered.mean() == pytest.approx(share, abs=error)
