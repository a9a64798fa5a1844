"""The unscented and the iterated Kalman filter: against the textbook's sums, a Kalman filter, and a minimiser."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import unscented as oracle
from plants import chain, two_outputs
from scipy.optimize import minimize

import hgogen as hg
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.stepping.discretise import CorrectsAtSamples, NoEquation

NAN = float("nan")
PREDICT_CORRECT = [hg.methods.continuous_discrete, hg.methods.cholesky]
COMPARATORS = [hg.observers.ukf, hg.observers.iterated_ekf]
Q, R, P0 = np.array([[0.02, 0.01], [0.01, 0.3]]), (2e-3, 5e-3), np.diag([0.3, 0.5])


def swinging(*outputs: Callable[[Any, Any], Any], width: float = 20.0) -> hg.System:
    """A pendulum with a cubic spring, of the outputs given as functions of angle and rate."""
    q, w = (hg.Signal(name, low=-width, high=width) for name in ("q", "w"))
    u = hg.Signal("u", low=-5, high=5)
    return hg.System(
        "swinging",
        states=(q, w),
        inputs=(u,),
        outputs=tuple(hg.Signal(f"y{j + 1}", low=-1e4, high=1e4) for j in range(len(outputs))),
        flow=(w, u - sp.sin(q) * 4 - q**3 / 10 - w / 5),
        output=tuple(h(q, w) for h in outputs),
    )


BENT = swinging(lambda q, w: sp.sin(q) + q / 4 + w**2 / 20, lambda q, w: w + q**2 / 3)


def bent_flow(z: np.ndarray, u: float) -> np.ndarray:
    return np.array([z[1], u - 4 * np.sin(z[0]) - z[0] ** 3 / 10 - z[1] / 5])


def bent_output(z: np.ndarray) -> np.ndarray:
    return np.array([np.sin(z[0]) + z[0] / 4 + z[1] ** 2 / 20, z[1] + z[0] ** 2 / 3])


def record(count: int, dt: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """An input and noisy samples of BENT along it; some samples are missing."""
    rng = np.random.default_rng(seed)
    u, z, rows = np.sin(np.arange(count) * dt * 1.3), np.array([0.6, -0.4]), []
    for k in range(count):
        if k:
            z = oracle.runge_kutta(bent_flow, z, (u[k - 1], u[k]), dt)
        rows.append(bent_output(z) + rng.standard_normal(2) * np.sqrt(np.array(R) / dt) * 0.2)
    y = np.array(rows)
    y[40:55, 0], y[70:90] = NAN, NAN
    return u, y


def made(make: Any, plant: hg.System = BENT, method: Any = hg.methods.cholesky, dt: float = 0.01, **more: Any) -> Any:
    outputs = len(plant.outputs)
    gains = {"Q": Q, "R": R[:outputs], "covariance": P0, "initial": (0.1, 0.2)} | more
    return hg.sample(make(hg.forms.original(plant), **gains), method, dt=dt)


# --- the unscented filter -------------------------------------------------------------------------------------


@pytest.mark.ordinary(
    "1.0-2.0-0.0-method0", "1.0-2.0-0.0-method1", "0.5-2.0-1.0-method0", "1.2-1.44-3.0-method0", "1.0-0.0-0.0-method0"
)
@pytest.mark.parametrize("method", PREDICT_CORRECT)
@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"),
    [(1.0, 2.0, 0.0), (0.5, 2.0, 1.0), (1.2, 1.44, 3.0), (1.0, 0.0, 0.0), (1.0, 0.0, 1.0), (0.5, -0.1, 2.0)],
)
def test_it_is_the_textbooks_filter(method: Any, alpha: float, beta: float, kappa: float) -> None:
    """Of two bent outputs, with samples missing. The weighted sums lose eps/alpha^2 in the textbook's order; 1e3
    operations in each of 200 steps, forgotten within 50 of them."""
    u, y = record(200, 0.01)
    step = made(hg.observers.ukf, method=method, alpha=alpha, beta=beta, kappa=kappa)
    run = step.run(u=u, y=y, engine="python")
    start = np.array([0.1, 0.2])
    wanted = oracle.run(bent_flow, bent_output, Q, np.array(R), start, P0, 0.01, u, y, alpha, beta, kappa)
    assert np.abs(run.x - wanted).max() < 1e-10
    plain = made(hg.observers.riccati).run(u=u, y=y, engine="python")
    assert np.abs(run.x - plain.x).max() > 1e-3  # the bends matter


@pytest.mark.full
def test_the_middle_point_may_weigh_less_than_nothing() -> None:
    """alpha = 0.01: W_0c is -2e4, and the textbook's P is what is left of large sums; here nothing is taken away. By
    the limit of close points it is the same filter as with alpha = 0.02, but for terms of fourth order."""
    u, y = record(200, 0.01)
    close, closer = (made(hg.observers.ukf, alpha=a, kappa=0.0).run(u=u, y=y, engine="python") for a in (0.02, 0.01))
    assert np.abs(close.x - closer.x).max() < 1e-3
    assert not close.status[:, None].any() or (close.status == closer.status).all()


def seen_from_the_side() -> hg.System:
    """A vehicle that drives in a circle round a beacon: its heading, and the beacon's bearing from it."""
    px, py = (hg.Signal(name, low=-50, high=50) for name in ("px", "py"))
    psi, y1, y2 = (hg.Signal(name, "rad", period=2 * np.pi) for name in ("psi", "y1", "y2"))
    u = hg.Signal("u", low=-5, high=5)
    return hg.System(
        "side",
        states=(px, py, psi),
        inputs=(u,),
        outputs=(y1, y2),
        flow=(4 * sp.cos(psi), 4 * sp.sin(psi), u),
        output=(psi, sp.atan2(py, px) - 2 * psi),
    )


def side_flow(z: np.ndarray, u: float) -> np.ndarray:
    return np.array([4 * np.cos(z[2]), 4 * np.sin(z[2]), u])


def side_output(z: np.ndarray) -> np.ndarray:
    return np.array([z[2], np.arctan2(z[1], z[0]) - 2 * z[2]])


TURNS = (np.array([np.inf, np.inf, 2 * np.pi]), np.full(2, 2 * np.pi))
ACCEPT = ("singular.y2", "original.lipschitz", "original.order")


def on_the_side(start: np.ndarray, P: np.ndarray, silent: int = 0, **points: float) -> tuple[Any, ...]:
    """The filter's run over 5 turns round the beacon, with its input, samples and truth; no compass at first."""
    rng, dt, count = np.random.default_rng(5), 0.05, 800
    u, z, truth = np.full(count, 0.8), np.array([0.0, -5.0, 0.0]), []
    for k in range(count):
        z = oracle.runge_kutta(side_flow, z, (0.8, 0.8), dt) if k else z
        truth.append(z)
    y = np.array([side_output(z) for z in truth]) + 0.02 * rng.standard_normal((count, 2))
    y = oracle.short_way(y, TURNS[1])
    y[:silent, 0] = NAN
    gains = {"Q": np.diag((0.01, 0.01, 1e-3)), "R": (4e-4 * dt,) * 2, "covariance": P, "accept": ACCEPT}
    step = hg.sample(hg.observers.ukf(hg.forms.original(PLANT), initial=start, **gains, **points), dt=dt)
    return step.run(u=u, y=y, engine="python"), u, y, np.array(truth)


PLANT = seen_from_the_side()


@pytest.mark.parametrize("points", [{}, {"alpha": 0.5, "kappa": 1.0}, {"alpha": 1.0, "beta": 0.5, "kappa": -0.5}])
def test_points_of_angles_have_the_mean_about_their_middle(points: dict[str, float]) -> None:
    """With wrapped sums in the textbook's order; heading and bearing go round, in states and outputs."""
    start, P = np.array([0.5, -4.0, 3.0 - np.pi]), np.diag([0.5, 0.5, 0.1])
    run, u, y, truth = on_the_side(start, P, **points)
    weights = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0} | points
    Q, R = np.diag((0.01, 0.01, 1e-3)), np.full(2, 4e-4 * 0.05)
    wanted = oracle.run(side_flow, side_output, Q, R, start, P, 0.05, u, y, *weights.values(), TURNS)
    off = oracle.short_way(run.x - wanted, TURNS[0])
    assert truth[-1, 2] > 5 * 2 * np.pi
    assert np.abs(off).max() < 1e-9
    assert np.abs(oracle.short_way(run.x - truth, TURNS[0])[400:]).max() < 0.3


def test_points_that_would_lie_half_a_turn_off_are_drawn_nearer() -> None:
    """A heading of which nothing is known: the status says so until the samples tell it, and the filter settles."""
    run, *_, truth = on_the_side(np.array([0.5, -4.0, 2.5]), np.diag([0.5, 0.5, 9.0]), silent=5)
    limited = [k for k, status in enumerate(run.status) if "POINTS_LIMITED" in run.replay.step.flags(status)]
    assert limited == [0, 1, 2, 3, 4, 5]  # at 5 of the prediction, before the first sample of the compass
    assert np.abs(oracle.short_way(run.x - truth, TURNS[0])[400:]).max() < 0.3


def integrators() -> hg.System:
    """Three in a chain."""
    x = [hg.Signal(f"x{i}", low=-20, high=20) for i in (1, 2, 3)]
    return hg.System(
        "integrators", states=x, inputs=(), outputs=(hg.Signal("y"),), flow=(x[1], x[2], 0), output=(x[0],)
    )


@pytest.mark.parametrize("make", COMPARATORS)
def test_on_a_linear_plant_it_is_the_kalman_filter(make: Any) -> None:
    """In plain numpy with Phi = R_4(hF), which for a chain of three is exp(hF): F^3 = 0."""
    rng = np.random.default_rng(1)
    y = 0.3 * np.sin(np.arange(300) * 0.03)[:, None] + 0.05 * rng.standard_normal((300, 1))
    gains = {"Q": (0.1, 0.2, 0.3), "R": 1e-3, "covariance": (1.0, 2.0, 3.0)}
    step = hg.sample(make(hg.forms.original(integrators()), **gains), hg.methods.cholesky, dt=0.01)
    run = step.run(y=y, engine="python")
    F = np.diag(np.ones(2), 1)
    Phi = np.eye(3) + 0.01 * F + 0.01**2 / 2 * F @ F
    z, P, noise = np.zeros(3), np.diag([1.0, 2.0, 3.0]), 0.01 * np.diag([0.1, 0.2, 0.3])
    for k, sample in enumerate(y[:, 0]):
        if k:
            z, P = Phi @ z, Phi @ P @ Phi.T + noise
        K = P[:, 0] / (P[0, 0] + 1e-3 / 0.01)
        z, P = z + K * (sample - z[0]), P - np.outer(K, P[0])
        assert run.x[k] == pytest.approx(z, abs=1e-9)


def inputs_of(step: Any, count: int) -> dict[str, np.ndarray]:
    return {"u": np.zeros((count, len(step.inputs)))} if step.inputs else {}


@pytest.mark.ordinary("iterated_ekf")
@pytest.mark.parametrize("make", COMPARATORS)
def test_a_run_tells_what_the_filter_takes_its_errors_to_be(make: Any) -> None:
    """On a linear plant, what the extended Kalman filter by the same factors says."""
    y = 0.3 * np.sin(np.arange(100) * 0.03)[:, None]
    gains = {"Q": (0.1, 0.2, 0.3), "R": 1e-3, "covariance": (1.0, 2.0, 3.0)}
    form = hg.forms.original(integrators())
    runs = [
        hg.sample(each(form, **gains), hg.methods.cholesky, dt=0.01).run(y=y) for each in (make, hg.observers.riccati)
    ]
    for name in ("innovations", "variances", "covariance"):
        one, other = (getattr(run, name) for run in runs)
        assert one == pytest.approx(other, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("make", COMPARATORS)
@pytest.mark.parametrize("method", [hg.methods.euler, hg.methods.rk4, hg.methods.rk4_covariance, hg.methods.heun])
def test_a_method_that_integrates_is_refused(make: Any, method: Any) -> None:
    with pytest.raises(CorrectsAtSamples, match="predicts and corrects: take continuous_discrete or cholesky"):
        made(make, method=method)


@pytest.mark.ordinary("ukf")
@pytest.mark.parametrize("make", COMPARATORS)
def test_it_is_no_differential_equation(make: Any) -> None:
    functions = hg.targets.casadi(made(make))
    with pytest.raises(NoEquation, match="it predicts and corrects at samples; take its step"):
        functions.derivative  # noqa: B018


@pytest.mark.parametrize(
    ("gains", "sentence"),
    [
        ({"alpha": 0.0}, "alpha = 0.0 must be a positive finite number"),
        ({"alpha": 1e-5}, "alpha sqrt(n + kappa) = 1.41421e-05 must be from 1e-3 to 1e3"),
        (
            {"alpha": 2.0, "kappa": -1.5},
            r"beta = 2 must be from -alpha^2 kappa/n = 3 to 1e6, so that the covariance stays",
        ),
        ({"beta": -1.0}, "beta = -1 must be from -alpha^2 kappa/n = 0 to 1e6"),
        ({"beta": NAN}, "beta"),
        ({"kappa": -2.0}, "kappa = -2 must be above -2, the number of states with a minus"),
        ({"kappa": 1e9}, "must be from 1e-3 to 1e3"),
        ({"kappa": NAN}, "kappa"),
        ({"kappa": "many"}, "kappa"),
    ],
)
def test_points_that_are_none_are_refused(gains: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadGain) as error:
        made(hg.observers.ukf, **gains)
    assert sentence in str(error.value)


@pytest.mark.parametrize("passes", [0, 11, 2.5, NAN, "two"])
def test_passes_that_are_no_number_of_them_are_refused(passes: Any) -> None:
    with pytest.raises(BadGain, match="passes"):
        made(hg.observers.iterated_ekf, passes=passes)


@pytest.mark.parametrize("make", COMPARATORS)
def test_more_than_seven_states_are_refused(make: Any) -> None:
    with pytest.raises(BadGain, match=f"{make.__name__} takes up to 7 states, there are 8; take riccati, which loops"):
        make(hg.forms.original(chain(8)), Q=(1,) * 8, R=1)


@pytest.mark.ordinary("float-ukf", "double-ukf", "double-iterated_ekf")
@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("make", COMPARATORS)
@pytest.mark.parametrize("real", ["float", "double"])
def test_its_c_has_the_bits_of_python(make: Any, real: Any) -> None:
    """Of bent outputs, which no shipped model that it takes has."""
    step = made(make)
    files = hg.targets.c99(step, real=real)
    assert native.run_check(files, ("-O2", f"-D{step.name.upper()}_EXACT")).endswith("samples as recorded\n")


@pytest.mark.parametrize("make", COMPARATORS)
def test_it_takes_several_outputs_and_parameters(make: Any) -> None:
    step = hg.sample(make(hg.forms.original(two_outputs()), Q=(1, 1, 1), R=(0.1, 0.2)), dt=0.01)
    assert step.code.rule == "continuous-discrete, S S'"
    assert np.isfinite(step.run(**inputs_of(step, 50), y=np.full((50, 2), 0.3), engine="python").x).all()


# --- the iterated filter --------------------------------------------------------------------------------------


def corrected(passes: int, y: float, h: Callable[[Any, Any], Any], r: float = 0.2) -> tuple[np.ndarray, Any]:
    """The estimate after the first sample y of one output h, from (0.1, 0.2) with P0, which no step has moved yet; and
    the cost that it minimises."""
    plant = swinging(h)
    step = made(hg.observers.iterated_ekf, plant, passes=passes, R=(r * 0.01,))
    x = step.run(u=np.zeros(1), y=np.array([[y]]), engine="python").x[0]
    read = sp.lambdify(plant.states, plant.output[0])

    def cost(z: np.ndarray) -> float:
        off = z - np.array([0.1, 0.2])
        return float(off @ np.linalg.solve(P0, off) + (y - read(*z)) ** 2 / r)

    return x, cost


@given(st.floats(-3, 3), st.sampled_from(["square", "sine", "exponential"]))
@settings(deadline=None, max_examples=20)
def test_the_estimate_minimises_the_cost_of_a_sample(y: float, kind: str) -> None:
    """Ten passes come within a hundredth of what there is to gain from where the prediction stands: the method of Gauss
    and Newton converges linearly where the error stays large. The minimum next to it is that of Nelder and Mead."""
    h = {"square": lambda q, w: q + q**2 / 4, "sine": lambda q, w: q + sp.sin(w) / 2, "exponential": exponential}[kind]
    x, cost = corrected(10, y, h)
    least = minimize(cost, x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13}).fun
    assert cost(x) - least <= 0.01 * (cost(np.array([0.1, 0.2])) - least) + 1e-10


def exponential(q: Any, w: Any) -> Any:
    return sp.exp(q / 2) + w / 4


@pytest.mark.full
def test_no_pass_makes_the_estimate_worse() -> None:
    """h = atan(5 q): from afar the full Gauss-Newton step overshoots to where the slope is none."""
    costs = []
    for passes in (1, 2, 4, 8):
        x, cost = corrected(passes, -1.2, lambda q, w: sp.atan(5 * (q - sp.Rational(3, 2))), r=1e-4)
        costs.append(cost(x))
    assert costs == sorted(costs, reverse=True)
    assert costs[0] <= cost(np.array([0.1, 0.2]))


def test_one_pass_is_the_extended_kalman_filters_correction() -> None:
    """Where its cost falls; the covariance after it is by the row at the new estimate."""
    x, _ = corrected(1, 0.3, lambda q, w: q + q**2 / 4)
    plain = made(hg.observers.riccati, swinging(lambda q, w: q + q**2 / 4), R=(2e-3,))
    assert x == pytest.approx(plain.run(u=np.zeros(1), y=np.array([[0.3]]), engine="python").x[0], abs=1e-12)


@pytest.mark.full
def test_it_takes_a_distance_for_what_it_is_where_one_pass_does_not() -> None:
    """To a beacon, within .1, of a state that is known in one direction: one linearisation lands a third of the way
    beyond the circle, and P does not know of it."""
    costs = []
    for passes in (1, 10):
        x, cost = corrected(passes, 0.9, lambda q, w: sp.sqrt((q - 1) ** 2 + 8 * (w - 1) ** 2 + 0.01), r=1e-2)
        costs.append(cost(x))
    assert costs[1] < costs[0] / 3


def test_the_iterated_filter_s_covariance_is_that_at_the_corrected_estimate() -> None:
    q, w = (hg.Signal(name, low=-9, high=9) for name in ("q", "w"))
    outputs = tuple(hg.Signal(name, low=-1e4, high=1e4) for name in ("bent", "straight"))
    plant = hg.System("still", states=(q, w), outputs=outputs, flow=(0 * q, 0 * w), output=(q + q**3 / 3, w))
    P, r, dt = np.array([[0.5, 0.2], [0.2, 0.4]]), 0.02, 0.1
    start = {"initial": {"q": 0.2, "w": 0.0}, "covariance": P}
    observer = hg.observers.iterated_ekf(hg.forms.original(plant), Q=np.eye(2), R=r * dt, **start)
    step = hg.sample(observer, hg.methods.cholesky, dt=dt)
    estimates = []
    for straight in (NAN, 3.0):  # the second sensor weighs by the covariance that the first one leaves
        step.reset()
        estimates.append(step.run(np.zeros((1, 0)), np.array([[2.0, straight]]), engine="python").x[0])
    one, both = estimates
    f = (1 + one[0] ** 2) * P[0]
    after = P - np.outer(f, f) / (r + (1 + one[0] ** 2) * f[0])
    assert both == pytest.approx(one + after[1] / (r + after[1, 1]) * (3.0 - one[1]), abs=1e-6)


@pytest.mark.ordinary("10.0-6", "400.0-1", "400.0-2", "400.0-3", "400.0-4", "400.0-5", "400.0-6")
@pytest.mark.parametrize("passes", range(1, 7))
@pytest.mark.parametrize("y", [10.0, 400.0, -2.0])
def test_a_pass_that_overshoots_is_halved_and_the_next_that_does_not_is_whole_again(passes: int, y: float) -> None:
    """Pass by pass, by the equations of the method of Gauss and Newton with halved steps; of an exponential output, of
    which a whole step is 700 times too far."""
    x, _ = corrected(passes, y, lambda q, w: sp.exp(3 * q) + w / 4)
    S, z, r = np.linalg.cholesky(P0), np.array([0.1, 0.2]), 0.2
    w, share, shares = np.zeros(2), 1.0, []

    def error(w: np.ndarray) -> float:
        q, v = z + S @ w
        return float(y - np.exp(3 * q) - v / 4)

    for _ in range(passes):
        f = S.T @ np.array([3 * np.exp(3 * (z + S @ w)[0]), 0.25])
        tried = w + share * (f * (error(w) + f @ w) / (r + f @ f) - w)
        shares.append(share)
        if tried @ tried + error(tried) ** 2 / r < w @ w + error(w) ** 2 / r:
            w, share = tried, 1.0
        else:
            share /= 2
    assert x == pytest.approx(z + S @ w, abs=1e-9)
    if y == 400.0 and passes == 6:
        assert min(shares) <= 0.25
