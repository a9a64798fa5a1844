"""The updated-gain observer: the flow of its gain, what is proved of p_1 and p_3, and what it is for."""

from typing import Any

import numpy as np
import pytest
import swing
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import updated_gain as oracle
from plants import chain
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov

import hgogen as hg
from hgogen.check import Verdict
from hgogen.part import Clock
from hgogen.program import Place
from hgogen.reading.given import BadGain

GAINS: dict[str, Any] = {"p_1": 0.15, "p_2": 5, "p_3": 6, "cap": 200, "poles": (-1, -1)}


def observer(**changes: Any) -> hg.Observer:
    return hg.observers.updated_gain(swing.form(), **{**GAINS, **changes})


def known(built: hg.Observer) -> dict[str, Verdict]:
    return {check.id: check.verdict for check in built.checks}


def verdicts(built: hg.Observer) -> tuple[Verdict, Verdict]:
    claims = known(built)
    return claims["updated_gain.p_1"], claims["updated_gain.p_3"]


def test_the_linear_core_has_the_poles_at_the_cap() -> None:
    poles = swing.core_poles(hg.observers.updated_gain, **{**GAINS, "poles": (-1, -2)})
    assert poles == pytest.approx([-400, -200], rel=1e-12)


def test_it_is_the_oracles() -> None:
    """2200 samples; the oracle's ten Runge-Kutta steps of L' = L (a - p_1 L) err by some (a dt/10)^5 < 1e-14."""
    run = swing.run(observer(), swing.gappy(), engine="python")
    expected = oracle.run(swing.truth().u, swing.gappy()[:, None], swing.DT, (2, 1), (0.15, 5, 6), 5)
    assert run.traces["L"].max() > 25
    assert run.traces["L"] == pytest.approx(expected[:, 2], rel=1e-10)
    assert run.x == pytest.approx(expected[:, :2], abs=1e-10)


@given(st.floats(-4, 4), st.floats(5, 200), st.floats(1e-4, 3.0))
@settings(deadline=None, max_examples=8)
def test_the_gain_moves_by_its_law(q: float, L: float, dt: float) -> None:
    """Against a fine integration with Gamma held, for any dt; a plant and an estimate at rest at q."""
    part = observer().parts[1]
    (block,) = part.build(Clock(dt, "line", 1, 1)).adapt
    memory = {
        Place("state", "w"): [q, 0],
        Place("state", "L"): L,
        Place("state", "u"): 0,
        Place("gain", "p_1"): 0.15,
        Place("gain", "p_2"): 5,
        Place("gain", "p_3"): 6,
    }
    value = float(block.graph(*(memory[place] for place, _ in block.reads))[0])
    slope = oracle.slope(np.array([q, 0.0]), L)
    flow = solve_ivp(
        lambda t, L: L * (0.15 * (5 - L) + 6 * slope), (0, dt), [L], method="DOP853", rtol=1e-12, atol=1e-12
    )
    assert value == pytest.approx(flow.y[0, -1], rel=1e-9)
    assert min(L, 5 + 40 * slope) * (1 - 1e-12) <= value <= max(L, 5 + 40 * slope) * (1 + 1e-12)


@given(st.floats(-4, 4), st.floats(-20, 20))
@settings(deadline=None, max_examples=12)
def test_it_converges_from_any_initial_state(q: float, w: float) -> None:
    """Up to what the line between samples takes from y: dt^2/8 y'' = 2e-6, times L."""
    assert swing.last_error(observer, q, w) < 1e-4


def test_the_gain_follows_the_slope_of_the_model() -> None:
    """Stiff gravity at rest, none at q = pi/2: L is higher where the pendulum hangs."""
    truth, L = swing.truth(), swing.run(observer(), swing.truth().y).traces["L"]
    assert 20 < L[-1000:].min() < L[-1000:].max() < 32
    assert not swing.run(observer(), truth.y).status[100:].any()


# --- what is proved ------------------------------------------------------------------------------------------


def inequalities(poles: tuple[complex, ...], b: float) -> tuple[float, float]:
    """(the largest p_1, the smallest p_3) for the P of N'P + P N = -I, in floats."""
    n, K = len(poles), np.real(np.poly(poles))[1:]
    N = np.diag(np.ones(n - 1), 1) - np.outer(K, np.eye(n)[0])
    P, D = solve_continuous_lyapunov(N.T, -np.eye(n)), np.diag(b + np.arange(n))
    S = np.linalg.eigvalsh(D @ P + P @ D)
    return 1 / S[-1], 2 * np.linalg.eigvalsh(P)[-1] / S[0]


@pytest.mark.parametrize(("poles", "b"), [((-1, -1), 1.0), ((-1, -2), 2.0), ((-1 + 1j, -1 - 1j), 1.0)])
def test_p_1_and_p_3_are_proved_up_to_their_bounds(poles: tuple[complex, ...], b: float) -> None:
    most, least = inequalities(poles, b)
    inside = observer(p_1=0.99 * most, p_3=1.01 * least, poles=poles, b=b)
    assert verdicts(inside) == (Verdict.PROVED, Verdict.PROVED)
    assert verdicts(observer(p_1=1.01 * most, p_3=0.99 * least, poles=poles, b=b)) == (Verdict.UNKNOWN,) * 2


def test_an_inequality_says_of_which_D_it_is() -> None:
    """b is no number of the observer: two claims that differ by it alone would read the same."""
    said = [{check.id.fact: str(check.reason) for check in observer(b=b).checks} for b in (1.0, 2.5)]
    for reasons, b in zip(said, ("1", "2.5"), strict=True):
        assert all(f"D = diag(b, .., b + n - 1), b = {b}" in reasons[fact] for fact in ("p_1", "p_3"))


def test_what_is_not_proved_names_what_would_be() -> None:
    loose = observer(p_1=1, p_3=0.1)
    fixes = {check.id: check.fix for check in loose.checks}
    p_1 = float(fixes["updated_gain.p_1"].split()[-1].rstrip("."))
    p_3 = float(fixes["updated_gain.p_3"].split()[-1].rstrip("."))
    assert verdicts(observer(p_1=p_1, p_3=p_3)) == (Verdict.PROVED, Verdict.PROVED)


def test_a_gain_whose_lyapunov_function_does_not_suit_is_refused_with_one_that_does() -> None:
    """Three poles at -1: D P + P D > 0 from b = .564 on."""
    form = hg.forms.triangular(chain(3))
    gains = {**GAINS, "poles": (-1, -1, -1)}
    with pytest.raises(BadGain, match=r"b = 0\.5 leaves D P \+ P D not positive definite; take b = ") as caught:
        hg.observers.updated_gain(form, **gains, b=0.5)
    enough = float(str(caught.value).split()[-3])
    assert 0.56 < enough < 0.58
    hg.observers.updated_gain(form, **gains, b=enough)


@given(st.floats(5, 50), st.floats(0, 50), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_the_lyapunov_function_falls_where_it_is_proved_to(L: float, slope: float, seed: int) -> None:
    """With any delta of size Gamma |eps|: the derivative along the error equation, for p_1 = .15, p_3 = 6, p_2 = 5."""
    rng = np.random.default_rng(seed)
    eps, delta = rng.standard_normal(2), rng.standard_normal(2)
    delta *= slope * np.linalg.norm(eps) / np.linalg.norm(delta)
    N = np.array([[-2.0, 1], [-1, 0]])
    P = solve_continuous_lyapunov(N.T, -np.eye(2))
    rate = L * N @ eps - (0.15 * (5 - L) + 6 * slope) * np.array([1, 2]) * eps + delta
    assert 2 * eps @ P @ rate < 0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"p_1": 0}, "p_1 = 0 must be a positive finite number"),
        ({"p_2": 0.5}, r"p_2 = 0\.5 must be at least 1 and below cap = 200"),
        ({"p_2": 300}, "p_2 = 300 must be at least 1 and below cap = 200"),
        ({"p_3": -1}, "p_3 = -1 must be a positive"),
        ({"cap": float("inf")}, "cap = inf must be a positive finite"),
        ({"start": 2}, "start = 2 must be from p_2 = 5 to cap = 200"),
        ({"b": 0}, "b = 0 must be a positive"),
        ({"poles": None}, "updated_gain takes either the poles"),
    ],
)
def test_bad_gains(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        observer(**changes)


def test_the_cap_is_said_in_the_status() -> None:
    step = hg.sample(observer(cap=10), hg.methods.rk4, dt=swing.DT)
    run = step.run(u=swing.truth().u, y=swing.truth().y)
    assert run.traces["L"].max() == 10
    assert "GAIN_LIMITED" in step.flags(run.status[-1])
    quiet = hg.sample(observer(), hg.methods.rk4, dt=swing.DT)
    assert not quiet.run(u=swing.truth().u, y=swing.truth().y).status[100:].any()


def test_a_cap_is_proved_to_hold_up_to_where_the_gain_would_pass_it() -> None:
    """cap = 5 + 40 |(19.6/cap, .1)|: L' = 0 there at the steepest point of the box."""
    cap = 31.0
    for _ in range(60):
        cap = 5 + 40 * np.hypot(19.6 / cap, 0.1)
    assert 25 < cap < 35
    assert known(observer(cap=1.02 * cap))["updated_gain.cap"] is Verdict.PROVED
    assert known(observer(cap=0.98 * cap))["updated_gain.cap"] is Verdict.UNKNOWN


def test_more_states_than_can_be_proved_are_refused() -> None:
    with pytest.raises(BadGain, match=r"proves its gains for 12 states at most, chain13 has 13"):
        hg.observers.updated_gain(hg.forms.triangular(chain(13)), **{**GAINS, "poles": (-1,) * 13})
