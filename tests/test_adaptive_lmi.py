"""The observer with adaptive gain: the paper's pendulum in continuous time and by the oracle's steps, and what it
refuses."""

from fractions import Fraction
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
import pytest
import sympy as sp
from forger import sealed
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import adaptive_lmi as oracle
from plants import MODELS, chain, fitzhugh_nagumo, model, two_outputs

import hgogen as hg
from hgogen.check import Refuted, Verdict
from hgogen.estimators.core import core_numbers, nominal
from hgogen.model import load
from hgogen.prove.adaptive_design import adaptive_gain, slope
from hgogen.prove.varying_gain import VaryingGain
from hgogen.reading.given import BadGain
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import NotHurwitz
from hgogen.run import figures as figure
from hgogen.theorem import rows
from hgogen.trial import Trial, simulate

NAN = float("nan")
TUNING: dict[str, Any] = {
    "gamma": (oracle.LOW, oracle.HIGH),
    "K": oracle.K,
    "P": oracle.P,
    "sigma": oracle.SIGMA,
    "rise": oracle.ALPHA,
    "threshold": oracle.LEVEL,
}


@cache
def form() -> hg.Form:
    return hg.forms.triangular(load(MODELS / "disturbed_pendulum.py").plant)


def observer(**changes: Any) -> hg.Observer:
    return hg.observers.adaptive_lmi(form(), **{**TUNING, "initial": (1, 1, 1), **changes})


@cache
def truth(dt: float, end: float = 1.0, start: tuple[float, ...] = (0, 0, 0.01)) -> np.ndarray:
    """x (N, 3)."""
    return simulate(form().system, Trial("it", end, dict(zip(("x1", "x2", "x3"), start, strict=True))), dt).x


# --- known answers ------------------------------------------------------------------------------------------


@cache
def continuous() -> oracle.Continuous:
    return oracle.continuous()


@pytest.mark.full
def test_the_paper_in_continuous_time() -> None:
    """The peaks of the errors that stand in the literature of this model are of a sampled path, 1e-4 below."""
    simulation = continuous()
    assert simulation.turns == pytest.approx((0.00757026, 0.01507874, 0.01900230), abs=5e-9)
    assert simulation.back == pytest.approx(0.438668, abs=5e-7)
    assert simulation.peak == pytest.approx(36.0673, abs=5e-5)
    assert simulation.errors == pytest.approx([1, 36.199, 457.03], rel=1e-4)
    assert simulation.last == pytest.approx((0.4829, 0.5814), abs=1e-4)


@pytest.mark.full
def test_the_law_as_printed_locks_itself_up() -> None:
    """(90) as printed has the rate 0 at both ends: from gamma_inf, where the paper begins, gamma never rises, however
    large the residual is; from gamma_sup it never falls, however small. Projected it does both."""
    low, high, printed, projected = oracle.LOW, oracle.HIGH, oracle.printed, oracle.projected
    assert printed(low, 1.0) == 0 < projected(low, 1.0)
    assert printed(high, 0.0) == 0 > projected(high, 0.0)
    stuck, slow = oracle.under(printed, low, 1.0)
    free, fast = oracle.under(projected, low, 1.0)
    assert stuck == low
    assert free == pytest.approx(low, abs=0.05)  # it rose, and is back
    assert fast == pytest.approx(0.4829, abs=6e-3)  # in continuous time; the steps are Euler's
    assert slow > 1.1 * fast
    assert oracle.under(printed, high, 1.0)[0] == high
    assert oracle.under(projected, high, 1.0)[0] < 30


@pytest.mark.full
def test_the_step_converges_to_continuous_time_as_its_switches_do() -> None:
    """A switch is seen within a step, so that gamma errs by rise gamma dt at each of three switches at most; between
    switches the order is four, and nothing else is left at these dt."""
    exact = continuous()
    for dt in (1e-3, 2.5e-4, 1e-4):
        x = truth(dt)
        run = hg.sample(observer(), hg.methods.rk4, dt=dt).run(y=x[:, 0], engine="python")
        gamma, t, e = run.traces["gamma"], run.t, run.x - x
        rising = np.diff(gamma) > 0
        turns = t[1:-1][rising[1:] != rising[:-1]][:3]
        assert turns == pytest.approx(exact.turns, abs=1.5 * dt)
        assert gamma.max() == pytest.approx(exact.peak, abs=3 * oracle.ALPHA * exact.peak * dt)
        back = t[1:][(gamma[1:] == oracle.LOW) & (gamma[:-1] > oracle.LOW)]
        # gamma falls by sigma gamma^2, 21 at its end, where an error of the peak is as large as it was
        assert back == pytest.approx([exact.back], abs=2 * dt + 3 * oracle.ALPHA * exact.peak * dt / 21)
        assert np.abs(e).max(axis=0) == pytest.approx(exact.errors, rel=10 * dt)
        size = np.linalg.norm(e, axis=1)
        last = tuple(t[size > level][-1] for level in (1e-2, 1e-3))
        assert last == pytest.approx(exact.last, abs=5 * dt)


def test_it_is_the_oracles_steps() -> None:
    """Rounding only, of values up to 500 over a thousand steps; a gap, and single samples that are missing."""
    dt, y = 5e-4, truth(5e-4, 0.5)[:, 0].copy()
    y[[5, 30, 31, 400, 700]] = NAN
    y[500:540] = NAN
    run = hg.sample(observer(), hg.methods.rk4, dt=dt).run(y=y, engine="python")
    x, gamma = oracle.stepped(y, dt)
    assert run.x == pytest.approx(x, abs=1e-12 * np.abs(x).max() * len(y))
    assert run.traces["gamma"] == pytest.approx(gamma, abs=1e-12 * gamma.max() * len(y))
    assert (np.diff(gamma) > 0).any()
    assert (gamma[500:539] == gamma[500]).all()


# --- properties ---------------------------------------------------------------------------------------------


@cache
def chains(n: int) -> hg.Form:
    return hg.forms.triangular(chain(n))


def lyapunov(K: np.ndarray, sigma: float) -> np.ndarray:
    n = len(K)
    M = np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0]) + sigma * np.diag(np.arange(1.0, n + 1))
    P = np.linalg.solve(np.kron(M.T, np.eye(n)) + np.kron(np.eye(n), M.T), -np.eye(n).ravel()).reshape(n, n)
    return (P + P.T) / 2


@given(st.integers(2, 4), st.lists(st.floats(0.5, 2.0), min_size=4, max_size=4), st.floats(2.0, 30.0))
@settings(deadline=None, max_examples=20)
def test_the_core_has_its_poles_times_the_largest_gamma(n: int, poles: list[float], high: float) -> None:
    K = np.poly(-np.array(poles[:n]))[1:]
    tuning = {**TUNING, "K": K, "P": lyapunov(K, 0.01), "sigma": 0.01, "gamma": (1, high)}
    built = hg.observers.adaptive_lmi(chains(n), **tuning, accept="adaptive_lmi.shrink")
    core = core_numbers(built.parts[0], 1, nominal(built))
    scale = high ** np.arange(n)
    assert core == pytest.approx(
        high * np.outer(scale, 1 / scale) * (np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0])), rel=1e-12
    )
    assert np.poly(np.linalg.eigvals(core)) == pytest.approx(np.poly(-high * np.array(poles[:n])), rel=1e-8)


@pytest.mark.full
@given(st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 2)), st.tuples(*[st.floats(-3, 3)] * 3))
@settings(deadline=None, max_examples=8)
def test_v_never_grows_whatever_gamma_does(start: tuple[float, ...], estimate: tuple[float, ...]) -> None:
    """V = e'P e, e = T^-1 (x - xhat), falls in continuous time at more than 2 (18.5 0.3242 - 2 0.5006 2.056)/(2 2.056);
    a step errs by (528 dt)^5 of it."""
    dt = 2e-4
    x = truth(dt, 0.4, start)
    step = hg.sample(observer(initial=estimate), hg.methods.rk4, dt=dt)
    run = step.run(y=x[:, 0], engine="python")
    e = (x - run.x) / run.traces["gamma"][:, None] ** np.arange(1, 4)
    V = np.einsum("ki,ij,kj->k", e, oracle.P, e)
    assert (V[1:] <= V[:-1] * (1 + 2e-5) + 1e-16).all()
    assert V[-1] <= 1e-2 * V[0] + 1e-16


def test_it_comes_back_from_far_off_with_samples_missing_and_in_c() -> None:
    """After a missing sample y is held for a step, off by |x2| dt/2 = 4e-6 in the mean, which gamma^3 k_3 = 8e4 brings
    into x3' for the time dt: 3e-4."""
    dt, x = 1e-3, truth(1e-3, 3.0)
    y = x[:, 0].copy()
    y[::7] = NAN
    step = hg.sample(observer(initial=(-3, 40, -5)), hg.methods.rk4, dt=dt)
    run = step.run(y=y, engine="python")
    assert np.abs(run.x[-1] - x[-1]).max() < 3e-4
    assert run.traces["gamma"].max() > oracle.LOW + 1
    assert run.traces["gamma"][-1] == oracle.LOW
    step.reset()
    assert np.abs(step.run(y=y).x - run.x).max() <= 1e-9 * np.abs(run.x).max()


def test_gamma_keeps_to_its_range_however_fast_it_rises() -> None:
    """rise tuned up to a thousand times: gamma would pass any bound within one step."""
    x = truth(1e-3)
    step = hg.sample(observer(gamma=(20.53, 40)), hg.methods.rk4, dt=1e-3)
    assert step.tune(rise=5e4) == 0
    run = step.run(y=x[:, 0], engine="python")
    assert run.traces["gamma"].max() == 40
    assert run.traces["gamma"].min() == oracle.LOW
    assert np.abs(run.x[-1] - x[-1]).max() < 1e-3
    assert np.abs(run.x).max() < 40**2  # a gamma beyond 40 in a slope would bring in its cube


def test_its_gamma_is_drawn() -> None:
    step = hg.sample(observer(), hg.methods.rk4, dt=1e-3)
    run = step.run(y=truth(1e-3)[:, 0], engine="python")
    (axis,) = figure.adaptation(step, run.t, run.traces).axes
    (line,) = axis.get_lines()
    assert line.get_ydata().max() == run.traces["gamma"].max()
    assert axis.get_title(loc="left") == "high-gain parameter"


# --- what is known of it ------------------------------------------------------------------------------------


def test_the_hypotheses_of_its_theorem() -> None:
    built = observer(disturbance=(((0, 0), (0, 0), (0, 1)), (1, 0)))
    known = {check.id: check for check in built.checks}
    for name in ("definite", "decay", "shrink", "convergence", "theta", "attenuation"):
        assert known[f"adaptive_lmi.{name}"].verdict is Verdict.PROVED
    assert known["adaptive_lmi.theta"].claim == "gamma_inf = 20.53 is above that bound"
    proved = {row.claim: row.verdict for row in rows(built.theorem, built.checks)}
    assert proved["gamma_inf is large enough"] is Verdict.PROVED
    assert proved["D P + P D >= 0"] is Verdict.PROVED
    assert proved["the L2 gain from the declared disturbance to the error in w is at most mu"] is Verdict.PROVED
    assert not any("L2" in row.claim for row in rows(observer().theorem, observer().checks))


CANCELLED = (tuple((oracle.K[i] * oracle.LOW ** (i + 1) if i else 0,) for i in range(3)), (1,))
TORQUE = (((0, 0), (0, 0), (0, 1)), (1, 0))


def test_a_proof_at_the_least_gamma_alone_is_not_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a v that enters y, and w_2 and w_3 as the injection does at gamma_inf, where they cancel."""
    whole = VaryingGain._systems
    content = certified(CANCELLED)
    assert found(content) == "verified"
    monkeypatch.setattr(VaryingGain, "_systems", lambda gain: islice(whole(gain), 0, None, 4))  # two powers enter
    assert found(certified(CANCELLED)) != "verified"


def certified(disturbance: Any) -> dict[str, Any]:
    built = observer(disturbance=disturbance)
    return hg.certificate(form(), built.checks, built.name)


def found(content: dict[str, Any]) -> str:
    return recheck_of(content).found


def recheck_of(content: dict[str, Any]) -> Any:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id == "adaptive_lmi.attenuation")
    return row


def forged(**evidence: Any) -> Any:
    """What is said of the claim with other evidence."""
    content = certified(TORQUE)
    (claim,) = (claim for claim in content["claims"] if claim["id"] == "adaptive_lmi.attenuation")
    for name, change in evidence.items():
        claim["evidence"][name] = change(claim["evidence"])
    return recheck_of(content)


def test_each_lambda_is_below_the_square_of_the_gain() -> None:
    assert forged().found == "verified"
    large = forged(S=lambda known: [*known["S"][:-1], str(2 * Fraction(known["mu"]) ** 2)])
    assert large.found == "fails"
    assert "a lambda is above mu^2" in large.sentence


def test_a_v_that_a_rising_gain_may_raise_is_not_one() -> None:
    """It is positive, but D V + V D is not, of D = diag(1, 2, 3)."""
    rising = forged(V=lambda _: [["1", "1", "0"], ["1", "21/20", "0"], ["0", "0", "1"]])
    assert rising.found == "fails"
    assert "D V + V D" in rising.sentence


@cache
def geared() -> hg.Form:
    """a_1 = 5, a_2 = a in [1, 4], a_3 = -3, so that z_3 = -x_3."""
    a, u = hg.Signal("a", "", "", 2.0, low=1, high=4), hg.Signal("u", low=-1, high=1)
    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2, 3)]
    flow = [a * x[1], -3 * x[2] - sp.sin(x[0]), u - x[2] * x[0] ** 2 / 10]
    data = {"states": x, "inputs": (u,), "outputs": (hg.Signal("y"),), "parameters": (a,)}
    return hg.forms.triangular(hg.System("geared", **data, flow=flow, output=[5 * x[0]]))


@pytest.mark.full
def test_a_chain_with_gains_and_a_parameter() -> None:
    """w = (5 z_1, 5 a z_2, 15 a z_3): |T^-1 dc/dw T|^2 = (a cos z_1/gamma)^2 + (z_1^2/10)^2 +
    (0.6 a z_1 z_3/gamma^2)^2, the largest at z = 4, a = 4, gamma = 20.53."""
    built = hg.observers.adaptive_lmi(geared(), **TUNING)
    k = np.hypot(1.6, np.hypot(4 * np.cos(4) / 20.53, 0.6 * 4**3 / 20.53**2))
    assert k < float(slope(geared(), 20.53)) < k + 1e-3
    (check,) = (check for check in built.checks if check.id == "adaptive_lmi.theta")
    assert check.verdict is Verdict.PROVED
    step = hg.sample(built, hg.methods.rk4, dt=5e-4)
    start = Trial("it", 1.0, {"x1": 1, "x2": 0.5, "x3": -0.5}, {"u": 0.2})
    true = simulate(geared().system, start, 5e-4)
    run = step.run(u=true.u, y=true.y, engine="python")
    assert np.abs(run.x[-1] - true.x[-1]).max() < 1e-6


def test_from_a_form_to_a_proved_observer() -> None:
    """The slope from gamma_inf on, K and P for it, and the observer takes them."""
    pytest.importorskip("clarabel")
    k = slope(geared(), 10)
    assert k < slope(geared(), 1)
    design = adaptive_gain(3, slope=k)
    tuning = {**TUNING, "K": design.K, "P": design.P, "gamma": (max(10, float(design.gamma)), 80)}
    checks = {check.id: check.verdict for check in hg.observers.adaptive_lmi(geared(), **tuning).checks}
    assert checks["adaptive_lmi.theta"] is Verdict.PROVED
    with pytest.raises(BadGain, match=r"^gamma = 0\.5 must be a finite number, at least 1"):
        slope(geared(), 0.5)
    with pytest.raises(BadGain, match=r"^adaptive_lmi takes one output"):
        slope(hg.forms.original(two_outputs()))


def test_a_slope_without_a_bound_is_said() -> None:
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2")
    plant = hg.System("open", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -(x2**3)], output=[x1])
    with pytest.raises(BadGain, match=r"^the slope of open has no bound: the bound rests on triangular\.lipschitz"):
        slope(hg.forms.triangular(plant))


def test_below_the_bound_it_is_not_proved_and_built_all_the_same() -> None:
    tuning = {**TUNING, "K": (2, 1), "P": ((10.4, -13.15), (-13.15, 32.76)), "sigma": 0.1, "gamma": (2, 80)}
    built = hg.observers.adaptive_lmi(hg.forms.triangular(model("pendulum")), **tuning)
    (check,) = (check for check in built.checks if check.id == "adaptive_lmi.theta")
    assert check.verdict is Verdict.UNKNOWN
    assert "not shown: 2 is below the certified 5.1" in str(check.reason)
    assert check.fix.startswith("Raise gamma_inf, ")


def test_a_p_that_is_refuted_stops_unless_it_is_accepted() -> None:
    wrong = oracle.P + np.diag([0, 0, 5.0])
    with pytest.raises(Refuted, match=r"adaptive_lmi\.decay: .*\(the largest eigenvalue is above .*hgogen\.design"):
        observer(P=wrong)
    accepted = observer(P=wrong, accept="adaptive_lmi.decay")
    assert accepted.accepted == ("adaptive_lmi.decay",)
    known = {check.id.fact: check.verdict for check in accepted.checks if check.id.maker == "adaptive_lmi"}
    assert known["decay"] is Verdict.REFUTED
    assert known["theta"] is Verdict.PROVED  # by another P


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gamma": (80, 20)}, r"gamma = \(80, 20\) must be \(gamma_inf, gamma_sup\) with 1 <= gamma_inf < gamma_sup"),
        ({"gamma": (0.5, 20)}, r"gamma = \(0\.5, 20\) must be"),
        ({"gamma": 20}, r"gamma = 20 must be"),
        ({"gamma": (20, float("inf"))}, r"gamma = \(20, inf\) must be"),
        ({"K": (1, 2)}, r"K of shape \(2,\) must have 3 numbers, one for each state"),
        ({"P": np.eye(2)}, r"P of shape \(2, 2\) must be a 3 x 3 matrix"),
        ({"sigma": 0}, r"sigma = 0 would keep gamma from falling"),
        ({"sigma": -1}, r"sigma = -1 must be a number, at least 0"),
        ({"rise": 0}, r"rise = 0 must be a positive finite number"),
        ({"threshold": -0.1}, r"threshold = -0\.1 must be a positive finite number"),
        ({"disturbance": (np.eye(3), (1, 0))}, r"G_1 of shape \(3, 3\) and G_2 of shape \(2,\) must be"),
        ({"initial": (9, 0, 0)}, r"initial x1 = 9\.0 must be finite and in \[-4, 4\]"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        observer(**changes)


def test_a_gain_that_does_not_decay() -> None:
    with pytest.raises(NotHurwitz, match=r"^K: .* take K and P of hgogen\.design"):
        observer(K=(1, 1, 2))


def test_forms_that_are_no_chain() -> None:
    with pytest.raises(BadGain, match=r"^adaptive_lmi takes one output, two has 2"):
        hg.observers.adaptive_lmi(hg.forms.original(two_outputs()), **TUNING)
    driven = fitzhugh_nagumo().form
    with pytest.raises(BadGain, match=r"^a_2 = -u depends on the input"):
        hg.observers.adaptive_lmi(driven, **TUNING, accept="triangular.a_2")
