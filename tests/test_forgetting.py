"""What a covariance that forgets does where nothing is seen: without samples, and with states that the input hides.

S' = -rho (S - S_0) - A'S - S A + C'R^-1 C - S Q_0 S, Q_0 = 1e-14 rho S_0^-1: linear but for the last term, S is what
the samples show plus what S_0 leaves; the last bounds S where the plant contracts faster than S is forgotten.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from exact import machine
from native_step import NativeStep, unpack_state
from oracle import kalman_like as oracle
from plants import MODELS, chain, loaded, model
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov

import hgogen as hg
from hgogen.discretisation.stability import Limit
from hgogen.emit import layout
from hgogen.emit.syntax import Real
from hgogen.estimators.factored import largest
from hgogen.estimators.riccati_part import unpack
from hgogen.observer import Observer
from hgogen.program import Place
from hgogen.run import native
from hgogen.trial import t, try_out

NAN = float("nan")
EPS_NEURON = 0.8
SHARE = 1e-14  # of Q_0
TUNED = {path.stem: loaded(path) for path in sorted(MODELS.glob("*.*")) if path.is_file()}
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
reals = pytest.mark.parametrize("real", ["float", "double"])
VIEWS = [("pendulum", "continuous_discrete"), ("pendulum", "cholesky"), ("chain", "continuous_discrete")]


@cache
def observer(name: str) -> Observer:
    """The pendulum with its own tuning, or the chain of eight, whose covariance is in loops."""
    if name == "chain":
        return hg.observers.kalman_like(hg.forms.state_affine(chain(8)), rho=4.0, R=1e-3)
    return hg.observers.kalman_like(hg.forms.state_affine(model("pendulum")), rho=5, R=1e-9)


@cache
def sampled(name: str, method: str) -> hg.Step:
    return hg.sample(observer(name), getattr(hg.methods, method), dt=0.01 if name == "chain" else 1e-3)


def caps(of: Observer) -> np.ndarray:
    (part,) = of.parts
    return part.cap


def covariance(step: hg.Step, state: np.ndarray) -> np.ndarray:
    """P of L and D, of the columns of L in a group, or of its root."""
    n = len(step.states)
    lower, numbers = np.eye(n), {name: np.asarray(state[name][0], dtype=object) for name in state.dtype.names}
    if "root" in numbers:
        lower = np.zeros((n, n))
        lower.T[np.triu_indices(n)] = numbers["root"].astype(float)
        return lower @ lower.T
    if "column" in numbers:
        for k in range(n):
            lower[k + 1 :, k] = state["column"]["v"][0][k, k + 1 :]
    else:
        lower.T[np.triu_indices(n, 1)] = numbers["L"].astype(float)
    return lower @ np.diag(numbers["D"].astype(float)) @ lower.T


# --- without samples ----------------------------------------------------------------------------------------


@pytest.mark.ordinary("pendulum-cholesky-float", "pendulum-cholesky-double", "chain-continuous_discrete-double")
@needs_compiler
@reals
@pytest.mark.parametrize(("name", "method"), VIEWS)
def test_in_silence_the_covariance_tends_to_its_limit(name: str, method: str, real: Real) -> None:
    """S = (exp(rho h) Phi S^-1 Phi' + h Q_0)^-1 + (1 - exp(-rho h)) S_0, to which the start decays at rho less twice
    the plant's own rate (.1 or 1). A step rounds n^2 products, and 1/(rho h) of them count."""
    step, of = sampled(name, method), observer(name)
    rho, n, h = of.gains[0].initial[0], of.form.n, step.dt
    compiled, count = NativeStep(step, real), round(60 / (rho - (0.2 if name == "pendulum" else 2.0)) / h)
    run = compiled.run(np.zeros((count, 1)), np.full((count, 1), NAN))
    A = np.array([[0, 1], [0, -0.1]]) if name == "pendulum" else np.eye(n, k=1) - np.diag([0.0] * (n - 1) + [1])
    grown = np.exp(rho * h / 2) * (np.eye(n) + h * A + h * h / 2 * A @ A)
    S = np.linalg.inv(of.parts[0].covariance)
    for _ in range(count):
        after = np.linalg.inv(grown @ np.linalg.inv(S) @ grown.T + h * rho * SHARE * np.diag(caps(of)))
        S = after + (1 - np.exp(-rho * h)) * np.diag(1 / caps(of))
    P, unit = covariance(step, compiled.state), np.sqrt(caps(of))
    rounding = n * n / (rho * h) * np.finfo(np.float32 if real == "float" else float).eps
    scaled = S * np.outer(unit, unit)
    limits = np.linalg.cond(scaled) * rounding
    assert scaled @ (P / np.outer(unit, unit)) == pytest.approx(np.eye(n), abs=limits)
    assert (np.diag(P) < largest(of.parts[0])).all()
    assert all("COVARIANCE_LIMITED" in step.flags(status) for status in run.status[count // 2 :])


@needs_compiler
@pytest.mark.parametrize("method", ["continuous_discrete", "cholesky"])
def test_after_a_long_silence_samples_tell_every_state(method: str) -> None:
    """100 s without a sample; then the plant is at (1.5, -2). Of the wrong rate the samples of .1 s leave the share
    12 r/(100 .1^2) over D_2 = 1136 (s. above), r = R/dt: 1e-8. What is left is the line between two samples, a
    y'' dt^2/8 < 1e-4 over 1/rho."""
    step, h, quiet = sampled("pendulum", method), 1e-3, 100_000
    time = np.arange(500) * h

    def flow(_: float, x: np.ndarray) -> list[float]:
        return [x[1], -19.6 * np.sin(x[0]) - 0.1 * x[1]]

    truth = solve_ivp(flow, (0, 1), (1.5, -2.0), t_eval=time, method="DOP853", rtol=1e-12, atol=1e-12).y.T
    y = np.concatenate([np.full(quiet, NAN), truth[:, 0]])
    step.reset()
    run = step.run(u=np.zeros(len(y)), y=y)
    assert np.abs(run.x[quiet:] - truth)[time >= 0.1].max() < 1e-4
    assert not any(run.status[quiet + 2 :])


def test_eight_states_after_a_silence_are_the_oracles() -> None:
    """In loops; at rest in silence, as the plant is. P in full loses eps cond P."""
    of, step, n = observer("chain"), sampled("chain", "continuous_discrete"), 8
    (part,) = of.parts
    y = np.concatenate([np.full(900, NAN), 0.01 * np.cos(0.3 * np.arange(300) * 0.01)])
    A, last = np.eye(n, k=1), np.eye(n)[-1]
    A[-1, -1] = -1
    step.reset()
    run = step.run(u=np.zeros(1200), y=y, engine="python")
    arguments = (4.0, np.array([1e-3]), np.zeros(n), part.covariance, 0.01, np.zeros(1200), y[:, None], caps(of))
    expected = oracle.run(lambda u, v: A, lambda u, v: -np.sin(v[0]) * last, *arguments)
    assert run.x == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@needs_compiler
def test_a_sample_now_and_then_is_enough() -> None:
    """Every third of the chain's samples."""
    of = hg.observers.kalman_like(hg.forms.state_affine(chain(8)), rho=1.0, R=1e-6, initial={"x8": 1.0})
    y = np.zeros(3000)
    y[np.arange(3000) % 3 != 0] = NAN
    run = hg.sample(of, dt=0.01).run(u=np.zeros(3000), y=y)
    assert np.abs(run.x[-1]).max() < 1e-3


@pytest.mark.ordinary(
    "pendulum-continuous_discrete-double", "pendulum-cholesky-float", "chain-continuous_discrete-double"
)
@needs_compiler
@reals
@pytest.mark.parametrize(("name", "method"), VIEWS)
def test_c_is_python_to_the_bit_after_a_silence(name: str, method: str, real: Real) -> None:
    step = sampled(name, method)
    reader, compiled = machine(step, real), NativeStep(step, real)
    reader.memory[Place("input", "tau") if name == "pendulum" else Place("input", "u")][0] = 0
    for sample in np.concatenate([np.full(200, NAN), np.linspace(1, 1.1, 20)]):
        reader.memory[Place("output", "y")][0] = sample
        status, run = reader.call(), compiled.run(np.zeros((1, 1)), np.array([[sample]]))
        assert run.status[0] == status
    again = {place: array.copy() for place, array in reader.memory.items()}
    unpack_state(step, compiled.state, again)
    for place, array in again.items():
        np.testing.assert_array_equal(array, reader.memory[place], err_msg=place)


@needs_compiler
def test_what_rounds_away_is_neither_forgotten_nor_told() -> None:
    """1e-3 of rho = 1e-2 at dt = 1 ms: exp(1e-8) is 1 in float. P would shrink for ever if S_0 were still told."""
    of = hg.observers.kalman_like(hg.forms.state_affine(chain(1)), rho=0.01, R=1.0)
    compiled = NativeStep(hg.sample(of, dt=1e-3), "float")
    compiled.params["gain"]["rho"] = 1e-5
    compiled.tune()
    assert (compiled.params["derived"]["growth"][0], compiled.params["derived"]["prior"][0]) == (1, 0)


# --- what the plant contracts faster than it is forgotten ----------------------------------------------------


@cache
def motor() -> hg.Step:
    """The motor, at rest at vq = 400 from the first sample on."""
    of = hg.observers.kalman_like(hg.forms.state_affine(TUNED["pmsm"].plant), rho=10, R=1e-8, initial=tuple(RESTS))
    return hg.sample(of, dt=1e-4)


def contracting(x: np.ndarray) -> np.ndarray:
    """A (3, 3) of the motor."""
    return np.array([[-200.0, 0, x[1]], [0, -200, -x[0] - 30], [0, 500, -0.5]])


RESTS = np.array([0.0, 0.0, 0.0])
for _ in range(100):  # i_d = w i_q/200, i_q = w/1000, w (1/5 + i_d + 30) = 400
    RESTS = np.array([RESTS[2] * RESTS[1] / 200, RESTS[2] / 1000, 400 / (30.2 + RESTS[0])])


@pytest.mark.ordinary("double")
@needs_compiler
@reals
def test_what_contracts_fast_keeps_its_rank_in_silence(real: Real) -> None:
    """30000 samples are missing. P solves rho (P - P S_0 P) + A P + P A' + Q_0 = 0 to first order in h, which moves
    the modes of A, at 50 to 150, by h |A|/2 or so of itself. Then samples are off by v: K_i^2 <= P_ii/r, so
    that they move z_i by at most the sum of sqrt(P_ii/r) |v|, and by h w v as the products have the measured currents.
    With D at its floor the first threw the speed by hundreds."""
    step, count, v = motor(), 30_000, 0.02
    of, compiled = step.observer, NativeStep(step, real)
    u, y = np.tile([0.0, 400.0], (count, 1)), np.full((count, 2), NAN)
    compiled.run(u, y)
    computed = covariance(step, compiled.state)
    A = contracting(RESTS) + 5 * np.eye(3)
    P = solve_continuous_are(A.T, np.eye(3), 10 * SHARE * np.diag(caps(of)), np.diag(caps(of)) / 10)
    assert computed == pytest.approx(P, rel=0.03, abs=0.03 * np.abs(P).max())
    before = compiled.run(u[:1], y[:1]).x[0]
    after = compiled.run(u[:1], RESTS[None, :2] + [v, -v]).x[0]
    assert (np.abs(after - before) <= 1.1 * v * (2 * np.sqrt(np.diag(P) / 1e-4) + step.dt * RESTS[2])).all()


@pytest.mark.ordinary("lorenz", "hindmarsh_rose")
@needs_compiler
@pytest.mark.parametrize("name", ["lorenz", "cstr", "fitzhugh_nagumo", "hindmarsh_rose"])
def test_a_million_silent_samples_leave_no_pivot_at_its_floor(name: str) -> None:
    """In float. D_i >= h Q_0ii before S_0 is told, which takes a share of some rho h: the floor is 1e-12 of it."""
    step = TUNED[name].step("kalman_like")
    (part,), outputs = step.observer.parts, len(step.outputs)
    compiled, count = NativeStep(step, "float"), 10_000
    middle = np.array([(s.interval[0] + s.interval[1]) / 2 for s in step.observer.form.system.inputs])
    u, y = np.tile(middle, (count, 1)), np.full((count, outputs), NAN)
    (diagonal,) = (field for field in step.layout.state if field.name == "D")
    for _ in range(100):
        run = compiled.run(u, y)
        assert not any("RESTARTED" in step.flags(status) for status in np.unique(run.status))
        assert (compiled.state["D"][0] > 1e6 * np.array(diagonal.low)).all()
        assert (np.diag(covariance(step, compiled.state)) < largest(part)).all()


# --- with states that the input hides -----------------------------------------------------------------------

HIDDEN, DT = 20.0, 0.01


@cache
def neuron(rho: float, method: str = "continuous_discrete") -> hg.Step:
    form = hg.forms.state_affine(model("fitzhugh_nagumo"))
    of = hg.observers.kalman_like(form, rho=rho, R=0.008, inputs={"u": sp.sin(t)}, period=2 * sp.pi)
    return hg.sample(of, getattr(hg.methods, method), dt=DT)


def moved(start: np.ndarray, excited: bool, duration: float) -> np.ndarray:
    """The plant from `start` with u = sin t, or 0."""

    def flow(time: float, x: np.ndarray) -> list[float]:
        u = np.sin(time) if excited else 0.0
        return [x[0] - x[0] ** 3 / 3 - x[1] * u, EPS_NEURON * (3 * np.sin(x[0]) - x[1] - x[2]), 0.0]

    time = np.arange(round(duration / DT) + 1) * DT
    return solve_ivp(flow, (0, duration), start, t_eval=time, method="DOP853", rtol=1e-10, atol=1e-10).y.T


def settled(step: hg.Step, real: Real, first: np.ndarray, jump: float, band: float) -> float:
    """How long eta's error is above the band after the input is sin t, from `first` on, which u = 0 moves, and eta then
    jumps; with no samples before it, a fresh observer's."""
    start = first[-1] + (0, 0, jump)
    truth = np.concatenate([first[:-1], moved(start, True, 30.0)])
    quiet = len(first) - 1
    u = np.concatenate([np.zeros(quiet), np.sin(np.arange(len(truth) - quiet) * DT)])
    run = NativeStep(step, real).run(u[:, None], truth[:, :1])
    above = np.flatnonzero(np.abs(run.x - truth)[quiet:, 2] > band)
    return (above[-1] + 1) * DT


START = np.array([1.06, 2.69, 5.0])


@pytest.mark.ordinary("0.3-double", "0.1-float", "0.1-double")
@needs_compiler
@reals
@pytest.mark.parametrize("band", [0.3, 0.1])
def test_hidden_states_settle_no_later_than_a_fresh_observers(band: float, real: Real) -> None:
    """u = 0 hides x2 and eta for 20 s. (e' S e)' <= -rho (e' S e - e' S_0 e); the plant leaves e3 = 5 as it is and
    brings e2 to -5: e' S_0 e is below 25/900 + 25/576 < .08, and e' S e = .55 at first, for S(0) = 9 S_0. So it is no
    larger than a fresh observer's when the input comes back, and decays by the same law."""
    step = neuron(0.3)
    hidden = settled(step, real, moved(START, False, HIDDEN), 0.0, band)
    assert hidden <= settled(step, real, START[None], 0.0, band)


def test_with_a_rate_above_the_plants_no_direction_is_lost() -> None:
    """Of the hidden states e2 + e3 decays at eps, and rho = 2 > 2 eps forgets it faster: S tends to the solution of
    rho (S - S_0) + A'S + S A = 0, to first order in h, which is below S(0)."""
    step = neuron(2.0)
    step.reset()
    step.run(u=np.zeros(2000), y=np.zeros(2000), engine="python")
    P = covariance(step, np.frombuffer(bytes(step._kept.state), layout.state_type(step)))[1:, 1:]
    A = EPS_NEURON * np.array([[-1.0, -1], [0, 0]])
    S = solve_continuous_lyapunov(A.T + np.eye(2), 2 * np.diag(1 / caps(step.observer)[1:]))
    assert np.linalg.inv(P) == pytest.approx(S, rel=2.0 * DT)
    assert np.linalg.eigvalsh(P - step.observer.parts[0].covariance[1:, 1:])[0] > 0


@needs_compiler
@reals
def test_a_jump_of_what_was_hidden_is_found(real: Real) -> None:
    """eta jumps from 5 to 0 at the end of the 20 s: the error of a fresh observer at eta = 5. By the test above e' S e
    is no larger than the fresh one's either. At rho = .3 it settles after 12 s, as after a jump with nothing hidden."""
    step = neuron(2.0)
    hidden = settled(step, real, moved(START, False, HIDDEN), -5.0, 0.1)
    assert hidden <= settled(step, real, START[None], 0.0, 0.1)


@needs_compiler
def test_a_million_samples_leave_the_covariance_its_rank_in_float() -> None:
    """20 s with u = 0, 30 s with sin t, two hundred times; A does not depend on y. P in units of double's is the unit
    matrix but for rounding: n^2 eps a step, of which 1/(rho h) count, times what scaling by a root of P can lose, the
    root of its condition number."""
    step, eps = neuron(2.0), np.finfo(np.float32).eps
    quiet, busy = np.zeros((2000, 1)), np.sin(np.arange(3000) * DT)[:, None]
    builds = [NativeStep(step, real) for real in ("float", "double")]
    for u in (quiet, busy) * 200:
        run, _ = (build.run(u, np.zeros((len(u), 1))) for build in builds)
        assert not any("RESTARTED" in step.flags(status) for status in np.unique(run.status))
        P, exact = (covariance(step, build.state) for build in builds)
        root = np.linalg.inv(np.linalg.cholesky(exact))
        rounding = 9 * eps / (2.0 * DT) * np.sqrt(np.linalg.cond(exact))
        assert root @ P @ root.T == pytest.approx(np.eye(3), abs=rounding)


# --- the bit that tells of it -------------------------------------------------------------------------------


@cache
def common(n: int, rate: float, covariance: str = "diagonal") -> Observer:
    """x_i' = rate x_i, of which the outputs show the differences alone: (1, .., 1) is hidden."""
    x = [hg.Signal(f"x{i}", low=-5, high=5) for i in range(n)]
    outputs = [hg.Signal(f"y{i}") for i in range(n - 1)]
    flow = [sp.Rational(str(rate)) * each for each in x]
    shown = [a - b for a, b in pairwise(x)]
    form = hg.forms.state_affine(hg.System("common", states=x, outputs=outputs, flow=flow, output=shown))
    start = 1e6 * (np.full((n, n), 0.99) + 0.01 * np.eye(n)) if covariance == "correlated" else None
    accept = ("kalman_like.persistence",)
    return hg.observers.kalman_like(form, rho=1.0, R=(1.0,) * (n - 1), covariance=start, accept=accept)


def largest_share(step: hg.Step, state: np.ndarray) -> float:
    """s, the largest eigenvalue of S_0 P."""
    n, unit = len(step.states), np.sqrt(caps(step.observer))
    if "P" in state.dtype.names or "S" in state.dtype.names:
        (name,) = {"P", "S"} & {*state.dtype.names}
        full = np.array(ca.DM(unpack(ca.SX(ca.DM(state[name][0].astype(float))), n)))
        P = np.linalg.inv(full) if name == "S" else full
    else:
        P = covariance(step, state)
    return float(np.linalg.eigvalsh(P / np.outer(unit, unit))[-1])


@pytest.mark.ordinary(
    "0.2-continuous_discrete", "0.2-loops", "0.0-loops in Python", "0.0-cholesky", "0.0-rk4", "0.0-rk4_covariance"
)
@pytest.mark.parametrize(
    "view", ["continuous_discrete", "loops", "loops in Python", "cholesky", "rk4", "rk4_covariance"]
)
@pytest.mark.parametrize("rate", [0.2, 0.0])
def test_an_unset_bit_means_that_the_samples_show_more(view: str, rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one hidden direction of three states each P_ii is a third of s = 1 + 2 rate/rho, to first order in h."""
    monkeypatch.setattr("hgogen.method.covariance_limits", lambda *arguments: [Limit(np.inf, "not asked")])
    loops, engine = view.startswith("loops"), "python" if "Python" in view else None
    if loops:
        monkeypatch.setattr("hgogen.estimators.factored.LONGER", {"speed": -(10**9)})
    method = getattr(hg.methods, "continuous_discrete" if loops else view)
    step, limited = hg.sample(common(3, rate), method, dt=0.02, engine=engine), []
    step.reset()
    for _ in range(round(8 / step.dt)):
        flags = step.flags(step(y=(0.0, 0.0)).status)
        share = largest_share(step, np.frombuffer(bytes(step._kept.state), layout.state_type(step)))
        limited.append("COVARIANCE_LIMITED" in flags)
        assert limited[-1] or share <= 0.5 * (1 + 1e-12)
    assert share == pytest.approx(1 + 2 * rate, rel=0.02)
    assert limited[-1]
    assert not limited[1]


def test_a_hidden_state_that_grows_has_room() -> None:
    """P_22 tends to (1 + 2 rate/rho)/S_0, to first order in h; rho is tuned as low as it may be."""
    x, y = [hg.Signal(name, low=-2, high=2) for name in ("x1", "x2")], (hg.Signal("y"),)
    form = hg.forms.state_affine(hg.System("hidden", states=x, outputs=y, flow=[-x[0], x[1]], output=[x[0]]))
    accept = ("state_affine.connected", "kalman_like.persistence")
    step = hg.sample(hg.observers.kalman_like(form, rho=1.0, R=1.0, accept=accept), dt=0.02)
    assert step.tune(rho=1e-3) == 0
    for _ in range(500):
        step(y=0.0)
    P = covariance(step, np.frombuffer(bytes(step._kept.state), layout.state_type(step)))
    assert P[1, 1] / caps(step.observer)[1] == pytest.approx(2001, rel=0.03)


def test_at_first_the_prior_is_far_below_whatever_the_covariance() -> None:
    """P(0) of five states that are nearly one: S_0 P(0) has the largest eigenvalue 1/4, its sum is 5/4 of it."""
    of = common(5, 0.0, "correlated")
    (part,) = of.parts
    unit = np.sqrt(caps(of))
    assert np.linalg.eigvalsh(part.covariance / np.outer(unit, unit))[-1] == pytest.approx(0.25, rel=1e-12)


SHOWN = [name for name, each in TUNED.items() if "kalman_like" in each.tuning.tables and each.has("trial")]


@needs_compiler
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "pendulum" else (pytest.mark.slow,)) for name in SHOWN]
)
def test_a_plant_that_shows_its_states_does_not_set_it(name: str) -> None:
    """After the first transient of the model's own trials, a twentieth of their duration."""
    step = TUNED[name].step("kalman_like")
    for trial in TUNED[name].trials():
        (trajectory,) = try_out(step, trial, engine="c", seeds=trial.seeds[:1])
        late = trajectory.status[trajectory.truth.t > trial.duration / 20]
        assert not any("COVARIANCE_LIMITED" in step.flags(status) for status in np.unique(late))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: neuron(0.3).observer, "lower rho, or scale R down"),
        (lambda: hg.observers.riccati(hg.forms.triangular(chain(2)), Q=(1, 1), R=1), "scale Q and R down together"),
        (
            lambda: hg.observers.hamilton_jacobi(hg.forms.triangular(chain(2)), Q=(1, 1), R=1),
            "scale the weights Q and R up",
        ),
    ],
    ids=["kalman_like", "riccati", "hamilton_jacobi"],
)
def test_the_advice_is_the_observers(make: Callable[[], Observer], said: str) -> None:
    (bit,) = (bit for bit in hg.sample(make(), dt=0.01).layout.bits if bit.name == "COVARIANCE_LIMITED")
    assert said in bit.action
