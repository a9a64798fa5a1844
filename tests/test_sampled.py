"""The matrix exponential and the bilinear rule as methods: exact or as their formula says for the linear core at any
step length, order 2 for the rest, the same bits in C."""

from dataclasses import replace
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracle import realised as oracle
from plants import fitzhugh_nagumo, model, pendulum, two_outputs
from scipy.linalg import expm
from test_every_observer import MODELS, kind, record, step

import hgogen as hg
from hgogen.discretisation.kernels import balance, exponential, resolvent
from hgogen.estimators.core import core, nominal, numbers
from hgogen.method import NoRealisation
from hgogen.run import native
from hgogen.step import StepTooLong
from hgogen.stepping.machine import Machine

METHODS = {"exponential": oracle.exact, "bilinear": oracle.bilinear}
POLES = (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)
OBSERVERS: dict[str, Any] = {
    "filtered": {"theta": 4, "alpha": 3, "beta": 1, "poles": POLES},
    "high_gain": {"theta": 4, "poles": POLES},
    "low_power": {"theta": 4},
}
NAN, EPS = float("nan"), np.finfo(float).eps
methods = pytest.mark.parametrize("method", METHODS)
compiled = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@cache
def pure(n: int) -> hg.Form:
    """x_i' = x_(i+1), x_n' = u, y = x_1 + u: the rest is linear in u."""
    x = [hg.Signal(f"x{i}", low=-1e6, high=1e6) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-1e6, high=1e6)
    data = {"states": x, "inputs": (u,), "outputs": (y,)}
    return hg.forms.triangular(hg.System(f"pure{n}", **data, flow=[*x[1:], u], output=[x[0] + u]))


def built(name: str, **changes: Any) -> hg.Observer:
    return getattr(hg.observers, name)(pure(4), **{**OBSERVERS[name], **changes})


def line(observer: hg.Observer, seen: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """M and B of the observer, u as a second source beside y: x_n' = u, v = y - u."""
    (part,) = observer.parts
    linear = core(part, 1, [seen])
    M, B = numbers(linear.M, nominal(observer)), numbers(linear.B, nominal(observer))
    driven = np.zeros((len(M), 1))
    driven[3 if len(M) != 6 else 5] = 1  # the last w, or the last q
    return M, np.hstack([B, driven - B])


# --- the matrices -------------------------------------------------------------------------------------------

elements = st.integers(-60, 60).map(lambda k: k / 8)
matrices = st.integers(2, 4).flatmap(lambda n: st.lists(elements, min_size=n * n, max_size=n * n))


@given(matrices)
@settings(deadline=None, max_examples=25)
def test_phi_functions(values: list[float]) -> None:
    """Against the exponential of [[X, 1, 0], [0, 0, 1], [0, 0, 0]] to 30 digits, whose first rows are phi_0, phi_1,
    phi_2. Each of the log2 |X| doublings doubles a rounding error, so that |X| eps is lost."""
    n = int(np.sqrt(len(values)))
    X, phi = np.array(values), [np.zeros(n * n) for _ in range(3)]
    exponential(X.copy(), *phi)
    one, null = np.eye(n), np.zeros((n, n))
    with mpmath.workdps(30):
        whole = mpmath.expm(mpmath.matrix(np.block([[X.reshape(n, n), one, null], [null, null, one], [null] * 3])))
    exact = np.array(whole.tolist(), dtype=float)[:n]
    for value, expected in zip(phi, np.split(exact, 3, axis=1), strict=True):
        room = 16 * n * EPS * max(1.0, np.abs(X).sum()) * np.abs(exact).max()
        assert value.reshape(n, n) == pytest.approx(expected, abs=room)


@given(st.integers(2, 8), st.integers(0, 99), st.floats(-2, 2))
@settings(deadline=None, max_examples=25)
def test_balancing_is_a_similarity_by_powers_of_two(n: int, seed: int, power: float) -> None:
    """Exactly; and it takes out the powers of a high gain: of rows that hang together what is left is as large as
    without them, but for the last power of two in each element."""
    X = np.random.default_rng(seed).uniform(0.5, 2, (n, n)) * (np.eye(n, k=1) + np.eye(n) + np.eye(n)[:1])
    D = (10.0**power) ** np.arange(n)
    matrix = D[:, None] * X / D
    balanced, scale = matrix.ravel().copy(), np.zeros(n)
    balance(balanced, scale)
    assert (np.frexp(scale)[0] == 0.5).all()
    assert np.array_equal(balanced.reshape(n, n), matrix * scale / scale[:, None])
    assert np.abs(balanced).sum() < 4 * np.abs(X).sum()


@example([1.0, -1.0, -1.0, 1.0])  # 1 - X has no pivot in its first place
@given(matrices)
@settings(deadline=None, max_examples=25)
def test_the_resolvent(values: list[float]) -> None:
    n = int(np.sqrt(len(values)))
    X, computed = np.array(values).reshape(n, n), np.zeros(n * n)
    with np.errstate(all="ignore"):
        resolvent(X.ravel().copy(), computed)
    condition = np.linalg.cond(np.eye(n) - X)
    if condition < 1e10:
        expected = np.linalg.inv(np.eye(n) - X)
        assert computed.reshape(n, n) == pytest.approx(expected, abs=1e-14 * n * condition * np.abs(expected).max())


# --- the linear core ----------------------------------------------------------------------------------------


@pytest.mark.ordinary(
    "0.001-filtered-bilinear", "0.001-high_gain-exponential", "0.001-low_power-bilinear", "3.0-high_gain-bilinear"
)
@methods
@pytest.mark.parametrize("name", OBSERVERS)
@pytest.mark.parametrize("dt", [1e-3, 3.0])
def test_the_core_is_the_formulas_at_any_step_length(name: str, method: str, dt: float) -> None:
    """A record of u and y on lines: scipy's matrices, to rounding (x is up to 1e4, theta^4 enters)."""
    observer = built(name, initial=(1, -2, 3, -4))
    (part,) = observer.parts
    rng = np.random.default_rng(3)
    u, y = rng.uniform(-1, 1, 60), rng.normal(size=60)
    start = np.concatenate([field.initial for field in part.fields])
    expected = oracle.run(METHODS[method](*line(observer), dt), start, np.column_stack([y, u]))
    run = hg.sample(observer, getattr(hg.methods, method), dt=dt).run(u=u, y=y, engine="python")
    shown = expected[:, [0, 3, 4, 5] if name == "low_power" else [0, 1, 2, 3]]
    assert not run.status.any()
    assert run.x == pytest.approx(shown, abs=1e-10 * np.abs(expected).max())


@pytest.mark.ordinary("filtered-bilinear", "high_gain-exponential", "low_power-exponential")
@methods
@pytest.mark.parametrize("name", OBSERVERS)
def test_without_a_sample_the_core_is_the_blind_one(name: str, method: str) -> None:
    """One sample is missing: that step has M without the output; the next one has y at both ends again, as in every
    method, from the only valid sample."""
    dt, observer = 0.05, built(name, initial=(1, -2, 3, -4))
    (part,) = observer.parts
    y = np.array([0.3, -0.2, NAN, 0.7])
    run = hg.sample(observer, getattr(hg.methods, method), dt=dt).run(u=0 * y, y=y, engine="python")
    x = np.concatenate([field.initial for field in part.fields])
    seen, blind = (METHODS[method](*line(observer, valid), dt) for valid in (1.0, 0.0))
    assert not blind[1][:, 0].any()
    still = np.zeros(2)
    for steps, before, now in ((seen, y[0], y[1]), (blind, 0, 0), (seen, y[3], y[3])):
        x = oracle.run(steps, x, np.array([[before, 0.0], [now, 0.0]]) + still)[-1]
    assert run.x[-1] == pytest.approx(x[[0, 3, 4, 5] if name == "low_power" else [0, 1, 2, 3]], abs=1e-11)


@pytest.mark.ordinary("filtered-bilinear", "high_gain-exponential", "high_gain-bilinear", "low_power-bilinear")
@methods
@pytest.mark.parametrize("name", OBSERVERS)
def test_far_beyond_the_limit_of_runge_kutta_it_is_stable(name: str, method: str) -> None:
    observer, t = built(name), np.arange(300) * 1.0
    with pytest.raises(StepTooLong):
        hg.sample(observer, hg.methods.rk4, dt=1.0)
    step = hg.sample(observer, getattr(hg.methods, method), dt=1.0)
    assert step.limit == np.inf
    run = step.run(u=0 * t, y=np.sin(0.1 * t), engine="python")
    transfer = hg.response(step, 0.1).H[0, :, 0]
    expected = (transfer * np.exp(0.1j * t)[:, None]).imag
    assert run.x[-100:] == pytest.approx(expected[-100:], abs=1e-9)


@pytest.mark.full
@methods
def test_a_tuned_gain_has_its_own_matrices(method: str) -> None:
    y = np.random.default_rng(4).normal(size=50)
    way = getattr(hg.methods, method)
    tuned, declared = hg.sample(built("filtered"), way, dt=0.1), hg.sample(built("filtered", theta=2), way, dt=0.1)
    before = tuned.run(u=0 * y, y=y, engine="python").x
    tuned.reset()
    assert tuned.tune(theta=2.0) == 0
    estimates = tuned.run(u=0 * y, y=y, engine="python").x
    assert np.array_equal(estimates, declared.run(u=0 * y, y=y, engine="python").x)
    assert np.abs(estimates - before).max() > 0.1


@pytest.mark.parametrize("name", OBSERVERS)
def test_the_response_is_the_formulas(name: str) -> None:
    """Of the bilinear rule exactly the continuous one at (2/h) tan(omega h/2); of the exponential one that of scipy's
    matrices. 1e-9 for |z - Phi|^-1 theta^4 eps."""
    observer, dt, omega = built(name), 0.1, np.array([0.3, 3.0, 20.0])
    bilinear = hg.response(hg.sample(observer, hg.methods.bilinear, dt=dt), omega)
    assert pytest.approx(hg.response(observer, 2 / dt * np.tan(omega * dt / 2)).H, rel=1e-9) == bilinear.H
    exact = hg.response(hg.sample(observer, hg.methods.exponential, dt=dt), omega)
    M, B = line(observer)
    Phi, before, now = oracle.exact(M, B[:, :1], dt)
    z = np.exp(1j * omega * dt)
    H = np.array([np.linalg.solve(s * np.eye(len(M)) - Phi, before + s * now)[:, 0] for s in z])
    rows = [0, 3, 4, 5] if name == "low_power" else [0, 1, 2, 3]
    assert exact.H[:, :, 0] == pytest.approx(H[:, rows], rel=1e-9)


# --- the nonlinear rest -------------------------------------------------------------------------------------


@pytest.mark.full
@methods
@pytest.mark.parametrize("between", ["line", pytest.param("hold", marks=pytest.mark.slow)])
def test_the_rest_has_order_2(method: str, between: str) -> None:
    """The pendulum, theta = 20, against the continuous equations on the same lines."""
    errors = []
    for dt in (4e-3, 2e-3):
        t = np.arange(round(1 / dt) + 1) * dt
        record = {"u": 0.5 * np.sin(t), "y": 1.5 * np.cos(0.7 * t + 0.3)}
        exact = hg.reference(pendulum(), **record, dt=dt, between=between)
        run = hg.sample(pendulum(), getattr(hg.methods, method), dt=dt, between=between).run(**record, engine="python")
        assert not run.status.any()
        errors.append(np.abs(run.x - exact.x).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


@methods
def test_a_constant_has_no_rest(method: str) -> None:
    """x' = 0, of one state: z' = theta k (y - z), whose step is a number."""
    x = hg.Signal("x", low=-2, high=2)
    plant = hg.System("constant", states=(x,), outputs=(hg.Signal("y"),), flow=[sp.S.Zero], output=[x])
    made = hg.observers.high_gain(hg.forms.triangular(plant), theta=3, poles=(-1,))
    step = hg.sample(made, getattr(hg.methods, method), dt=0.1)
    rows = Machine(step).record(np.zeros((20, 0)), np.ones((20, 1)))[0]
    turned = {"exponential": np.exp(-0.3), "bilinear": 0.85 / 1.15}[method]
    np.testing.assert_allclose(1 - rows[1:, 0], (1 - rows[0, 0]) * turned ** np.arange(1, 20), rtol=1e-12, atol=1e-15)


@pytest.mark.slow
@methods
@pytest.mark.parametrize("name", ["filtered", "low_power"])
def test_it_converges_at_ten_times_the_step_that_a_model_has(name: str, method: str) -> None:
    """The hyperjerk plant at 10 ms without noise: what is left is the line between samples and order 2."""
    loaded = MODELS["hyperjerk"]
    trial = replace(loaded.trials()[0], noise={}, duration=15)
    step = hg.sample(loaded.step(name).observer, getattr(hg.methods, method), dt=0.01)
    (done,) = hg.trial.try_out(step, trial, engine="python")
    assert (np.abs(done.error[-300:]).max(axis=0) < [1e-3, 1e-2, 0.05, 0.1]).all()


@pytest.mark.ordinary("bilinear")
@methods
def test_several_outputs_have_matrices_for_each_pattern_of_samples(method: str) -> None:
    """Two chains: either output may be missing, or both. What Runge-Kutta does, but for (h |lambda|)^2 = 1e-4."""
    gains = {"theta": 5, "poles": ((-1, -2), (-1,))}
    observer = hg.observers.high_gain(hg.forms.block_triangular(two_outputs()), **gains)
    t = np.arange(300) * 1e-3
    y = np.column_stack([np.cos(9 * t), np.sin(5 * t)])
    y[50:150, 0] = NAN
    y[100:250, 1] = NAN
    estimates, expected = (
        hg.sample(observer, getattr(hg.methods, name), dt=1e-3).run(u=np.sin(t), y=y, engine="python").x
        for name in (method, "rk4")
    )
    assert estimates == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    assert np.abs(expected).max() > 1


# --- C ------------------------------------------------------------------------------------------------------


@pytest.mark.full
@compiled
@pytest.mark.parametrize(("method", "name"), [("exponential", "filtered"), ("bilinear", "low_power")])
def test_c_is_python(name: str, method: str) -> None:
    y = np.sin(np.arange(300) * 0.03)
    y[50:60] = NAN
    step = hg.sample(MODELS["hyperjerk"].step(name).observer, getattr(hg.methods, method), dt=0.01)
    python = step.run(y=y, engine="python")
    step.reset()
    c = step.run(y=y, engine="c")
    assert np.array_equal(c.x, python.x)
    assert np.array_equal(c.status, python.status)


@pytest.mark.ordinary("exponential-float", "bilinear-double")
@compiled
@pytest.mark.parametrize(("method", "real"), [("exponential", "float"), ("bilinear", "float"), ("bilinear", "double")])
def test_c_checks_itself(method: str, real: Any) -> None:
    """Every warning is an error; matrices and samples come out bit for bit."""
    files = hg.targets.c99(hg.sample(pendulum(), getattr(hg.methods, method), dt=0.05), real=real)
    assert native.run_check(files, ("-O2", "-DPENDULUM_EXACT")) == "pendulum: 64 samples as recorded\n"


@methods
def test_the_matrices_are_good_in_float(method: str) -> None:
    """theta^8 = 1e16 between the elements of M: balanced, the float kernels lose some digits and not all."""
    rng = np.random.default_rng(6)
    for n in (2, 4, 8):
        D = 100.0 ** np.arange(n)
        X = np.diag(np.ones(n - 1), 1) * 0.5 - np.outer(rng.uniform(0.1, 1, n), np.eye(n)[0])
        single, scale = (D[:, None] * X / D).astype(np.float32).ravel(), np.zeros(n, np.float32)
        balance(single, scale)
        if method == "exponential":
            computed = [np.zeros(n * n, np.float32) for _ in range(3)]
            exponential(single, *computed)
            expected = expm(X)
        else:
            computed = [np.zeros(n * n, np.float32)]
            resolvent(single, computed[0])
            expected = np.linalg.inv(np.eye(n) - X)
        assert computed[0].dtype == np.float32
        back = computed[0].reshape(n, n).astype(float) * scale[:, None] / scale / D[:, None] * D
        assert back == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


# --- what is refused ----------------------------------------------------------------------------------------


@methods
def test_what_has_no_constant_core_is_refused(method: str) -> None:
    way = getattr(hg.methods, method)
    start = f"^{way.name} realises a linear error core with constant coefficients; "
    with pytest.raises(NoRealisation, match=start + "that of a Riccati observer moves with its covariance: take cont"):
        hg.sample(fitzhugh_nagumo(), way, dt=0.01)
    original = hg.forms.phase(model("pendulum"), original=True)
    with pytest.raises(NoRealisation, match=start + "this observer has none: take rk4"):
        hg.sample(hg.observers.high_gain(original, theta=4, poles=(-1, -1)), way, dt=0.01)
    observer = built("high_gain")
    adapting = replace(observer.parts[0], frozen={"z": (1.0,) * 4})
    with pytest.raises(NoRealisation, match=start + "here z adapts, and the core with it: take rk4"):
        hg.sample(replace(observer, parts=(adapting,)), way, dt=0.01)


# --- every observer that has a linear core -----------------------------------------------------------------


LINEAR = ("cascade", "filtered", "filtered_injection", "high_gain", "low_power", "peaking_free")


@pytest.mark.slow
@methods
@pytest.mark.parametrize("name", ["hyperjerk", "pendulum"])
def test_a_models_observers_with_a_linear_core_do_what_runge_kutta_does(name: str, method: str) -> None:
    """At the step of its model, whose h |lambda| is some 1e-2: an error of order 2, below 1%."""
    for tuned in MODELS[name].tuning.tables:
        if kind(name, tuned) not in LINEAR:
            continue
        made = step(name, tuned)
        u, y = record(made)
        estimates, expected = (
            hg.sample(made.observer, way, dt=made.dt, between=made.clock.between).run(u=u, y=y, engine="python").x
            for way in (getattr(hg.methods, method), hg.methods.rk4)
        )
        assert np.abs(estimates - expected).max() < 1e-2 * np.abs(expected).max()
