"""The standard high-gain observer: poles or gains, an A that moves with the input, several outputs."""

from dataclasses import replace
from fractions import Fraction
from functools import cache
from math import comb
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import high_gain as oracle
from oracle.sampled import run
from plants import chain, fitzhugh_nagumo, two_outputs, van_der_pol
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

import hgogen as hg
from hgogen.analysis.scaling import exponents
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import RK4
from hgogen.discretisation.stability import core_limit
from hgogen.estimators.core import core_numbers, nominal
from hgogen.estimators.gains import BadPoles, coefficients
from hgogen.estimators.integrators import Integrators
from hgogen.modelfiles.tuning import Tuning
from hgogen.program import Place
from hgogen.prove.convergence import Flow
from hgogen.prove.error_models import on_companion, with_gains
from hgogen.prove.inclusion import Inclusion, Nothing
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz, hurwitz
from hgogen.run import native
from hgogen.theorem import rows

NAN = float("nan")


def signals(n: int, size: float = 4.0) -> list[hg.Signal]:
    return [hg.Signal(f"x{i}", low=-size, high=size) for i in range(1, n + 1)]


@cache
def driven() -> hg.Form:
    """a_1 = 1 + u^2/2, a_2 = 1 + u/2, a_3 = 2, each with a range."""
    x, u = signals(3), hg.Signal("u", low=0, high=1)
    flow = [(1 + u / 2) * x[1], 2 * x[2] - sp.sin(x[1]), -sp.sin(x[0]) - x[2] + u]
    data = {"states": x, "inputs": (u,), "outputs": [hg.Signal("y")], "output": [(1 + u**2 / 2) * x[0]]}
    return hg.forms.triangular(hg.System("driven", **data, flow=flow))


DRIVEN_K = np.array([6.0, 6.0, 1.0])


@cache
def blocks(align: str) -> hg.Form:
    """Chains of three and two states; at the end, x3' and x2' may read one state further of the short chain."""
    x, u = signals(5), hg.Signal("u", low=-1, high=1)
    coupling = {"top": [0, x[3] / 4, sp.sin(x[4]) / 2], "end": [0, -x[3] / 4, sp.sin(x[4]) / 2 - x[3]]}[align]
    short = {"top": [-x[3] + x[0] / 4, -sp.sin(x[3]) + x[1] / 3], "end": [x[1] / 3 - x[0], -sp.sin(x[3]) + x[2] / 2]}[
        align
    ]
    flow = [
        x[1] + coupling[0],
        2 * x[2] + coupling[1],
        coupling[2] - sp.sin(x[0]) - x[2],
        x[4] + short[0],
        short[1] - x[4] + u,
    ]
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    plant = hg.System("blocks", states=x, inputs=(u,), outputs=outputs, flow=flow, output=[x[0], 2 * x[3] + u])
    return hg.forms.block_triangular(plant, align=align)


POLES = ((-1, -1 + 0.5j, -1 - 0.5j), (-1, -2))


def several(align: str = "top", **changes: Any) -> hg.Observer:
    return hg.observers.high_gain(blocks(align), **{"theta": 10, "poles": POLES, **changes})


def standing(observer: hg.Observer) -> dict[str, Verdict]:
    return {check.id: check.verdict for check in observer.checks}


# --- one output ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_gains_of_1992(n: int) -> None:
    """K_i = binom(n, i) times theta^i, with which every pole is at -theta: one power more than Delta^-1 has."""
    form = hg.forms.triangular(chain(n))
    K = [comb(n, i) for i in range(1, n + 1)]
    step = hg.sample(hg.observers.high_gain(form, theta=10, poles=[-1] * n), dt=1e-3)
    step.tune()
    assert step._kept.places[Place("derived", "K")] == pytest.approx([k * 10**i for i, k in enumerate(K, 1)], rel=1e-12)
    observer = hg.observers.high_gain(form, theta=10, gains=K)
    matrix = core_numbers(observer.parts[0], 1, nominal(observer))
    assert np.poly(matrix) == pytest.approx([comb(n, i) * 10.0**i for i in range(n + 1)], rel=1e-9)


def test_a_power_of_theta_less_would_be_unstable() -> None:
    """diag(1, .., theta^(n-1)) K in its place: s^3 + 3 s^2 + 3 theta s + theta^2, by Routh, wants theta < 9."""
    for theta, decays in ((8.0, True), (10.0, False)):
        matrix = np.diag(np.ones(2), 1) - np.outer([3, 3 * theta, theta**2], [1, 0, 0])
        assert hurwitz(matrix) is decays
    observer = hg.observers.high_gain(hg.forms.triangular(chain(3)), theta=10, poles=[-1] * 3)
    assert hurwitz(core_numbers(observer.parts[0], 1, nominal(observer)))


def test_gains_in_the_plants_own_coordinates() -> None:
    form, y = hg.forms.phase(van_der_pol(), original=True), np.sin(np.arange(200) * 0.01)
    each = ({"poles": (-1, -2)}, {"gains": (3, 2)})
    estimates = [
        hg.sample(hg.observers.high_gain(form, theta=5, **kind), dt=0.01).run(y=y, engine="python").x for kind in each
    ]
    assert np.array_equal(*estimates)


def test_gains_and_poles_are_the_same_observer() -> None:
    form, poles = hg.forms.triangular(chain(3)), (-1, -2 + 1j, -2 - 1j)
    y = np.sin(np.arange(300) * 0.01)
    estimates = []
    for kind in ({"poles": poles}, {"gains": coefficients(poles, 3)}):
        observer = hg.observers.high_gain(form, theta=5, **kind)
        estimates.append(hg.sample(observer, dt=0.01).run(u=np.zeros(300), y=y, engine="python").x)
        assert standing(observer)["high_gain.convergence"] is Verdict.PROVED
    assert np.array_equal(*estimates)


# --- an A that moves with the input -------------------------------------------------------------------------


def test_every_end_of_the_ranges_is_judged() -> None:
    """dt is admitted for the fastest of the four ends; gains that one of them does not bear are refused."""
    observer = hg.observers.high_gain(driven(), theta=8, gains=DRIVEN_K)
    ends = [
        8 * (np.array([[0, a2, 0], [0, 0, 2], [0, 0, 0]]) - np.outer(DRIVEN_K, [a1, 0, 0]))
        for a1 in (1, 1.5)
        for a2 in (1, 1.5)
    ]
    expected = min(core_limit(end, RK4.polynomial) for end in ends)
    assert hg.sample(observer, hg.methods.rk4, dt=1e-3).limit == pytest.approx(expected, rel=1e-12)
    with pytest.raises(NotHurwitz, match=r"gains: the linear error core has the eigenvalues .*design.constant_gain"):
        hg.observers.high_gain(driven(), theta=8, gains=(1.1, 0.8, 0.55))
    assert np.linalg.eigvals(ends[2] / 8 + np.outer(DRIVEN_K - [1.1, 0.8, 0.55], [1.5, 0, 0])).real.max() < 0


def test_the_driven_step_is_the_oracles() -> None:
    """Far off, through missing samples: rounding only, some theta^2 eps."""
    dt, samples, start = 2e-3, 800, (3.0, -3, 2)
    t = np.arange(samples) * dt
    u, y = 0.5 + 0.5 * np.sin(5 * t)[:, None], 5 * np.cos(3 * t)[:, None]
    y[[50, 51, 400], 0] = NAN
    observer = hg.observers.high_gain(driven(), theta=8, gains=DRIVEN_K, initial=start)
    estimates = hg.sample(observer, hg.methods.rk4, dt=dt).run(u=u[:, 0], y=y[:, 0], engine="python").x

    def b(z: np.ndarray, v: np.ndarray) -> np.ndarray:
        x = np.clip(z, -4, 4)
        return np.array([0, -np.sin(x[1]), -np.sin(x[0]) - x[2] + v[0]])

    rate = oracle.high_gain(
        [DRIVEN_K],
        8.0,
        lambda v: np.array([[0, 1 + v[0] / 2, 0], [0, 0, 2], [0, 0, 0]]),
        lambda v: np.array([[1 + v[0] ** 2 / 2, 0, 0]]),
        b,
    )
    expected = run(rate, np.array(start), y, dt, u)
    assert np.abs(expected).max() > 4
    assert estimates == pytest.approx(expected, abs=1e-10)


@pytest.mark.full
def test_a_designed_gain_converges_under_any_input() -> None:
    """Proved by one P for all ends; here under an input that jumps, from a start far off: V decays as proved."""
    pytest.importorskip("clarabel")
    pytest.importorskip("clarabel")
    K = hg.design.constant_gain(driven(), largest=50.0)
    assert not isinstance(K, Nothing)
    error = with_gains(driven(), K)
    assert isinstance(error, Inclusion)
    theta = 1.2
    proof = Flow(error, Fraction(theta)).fastest
    assert proof is not None
    observer = hg.observers.high_gain(driven(), theta=theta, gains=K)
    assert standing(observer)["high_gain.theta"] is Verdict.PROVED
    claims = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert claims["one P > 0 has (A - K C)'P + P (A - K C) < 0 for every input"] == "proved"
    gain = np.array(K) * theta ** np.arange(1, 4)

    def both(t: float, state: np.ndarray) -> np.ndarray:
        u, (x, z) = float(np.sin(40 * t) > 0), state.reshape(2, 3)
        rate = []
        for value in (x, z):
            s = np.clip(value, -4, 4)
            rate.append([(1 + u / 2) * value[1], 2 * value[2] - np.sin(s[1]), -np.sin(s[0]) - s[2] + u])
        return np.array([rate[0], rate[1] + gain * (1 + u * u / 2) * (x[0] - z[0])]).reshape(-1)

    t = np.linspace(0, 20 / theta, 60)
    solved = solve_ivp(both, (0, t[-1]), [0.5, 0, 0, -3, 3, 3], t_eval=t, rtol=1e-9, atol=1e-9, max_step=t[-1] / 2000)
    S = np.array([float(s) for s in error.scale]) * theta ** -np.arange(3)
    P = np.array([[float(v) for v in row] for row in proof.weights.P])
    e = S[:, None] * (solved.y[3:] - solved.y[:3])
    V = np.einsum("it,ij,jt->t", e, P, e)
    assert (np.exp(-2 * proof.rate * t) * V[0] * (1 + 1e-4) + 1e-9 * V[0] >= V).all()


# --- several outputs ----------------------------------------------------------------------------------------


@pytest.mark.ordinary("end")
@pytest.mark.parametrize("align", ["top", "end"])
def test_each_chain_has_its_poles(align: str) -> None:
    assert blocks(align).alignment == align
    assert blocks(align).blocks == (3, 2)
    observer = several(align, theta=7.0)
    matrix = core_numbers(observer.parts[0], 2, nominal(observer))
    expected = np.poly(7 * np.array([*POLES[0], *POLES[1]])).real
    assert np.poly(matrix) == pytest.approx(expected, rel=1e-9)
    assert not matrix[:3, 3:].any()
    assert not matrix[3:, :3].any()


def model(align: str) -> Any:
    """b of z = (x1, .., x5), its argument clamped, by hand."""

    def b(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        x = np.clip(z, -4, 4)
        if align == "top":
            far, short = [0, x[3] / 4, np.sin(x[4]) / 2], [-x[3] + x[0] / 4, -np.sin(x[3]) + x[1] / 3]
        else:
            far, short = [0, -x[3] / 4, np.sin(x[4]) / 2 - x[3]], [x[1] / 3 - x[0], -np.sin(x[3]) + x[2] / 2]
        return np.array([*far[:2], far[2] - np.sin(x[0]) - x[2], short[0], short[1] - x[4] + u[0]])

    return b


@pytest.mark.full
@pytest.mark.parametrize("align", ["top", "end"])
def test_the_step_of_several_outputs_is_the_oracles(align: str) -> None:
    """Either sensor misses samples: rounding only, some theta^2 eps."""
    dt, samples, theta, start = 2e-3, 600, 10.0, (3.0, -3, 2, 1, -2)
    t = np.arange(samples) * dt
    u = np.sin(4 * t)[:, None]
    y = np.column_stack([5 * np.cos(3 * t), 6 * np.sin(2 * t)])
    y[40:60, 0] = NAN
    y[50:90, 1] = NAN
    step = hg.sample(several(align, theta=theta, initial=start), hg.methods.rk4, dt=dt)
    estimates = step.run(u=u[:, 0], y=y, engine="python").x
    A = np.zeros((5, 5))
    A[0, 1], A[1, 2], A[3, 4] = 1, 2, 1
    K = [coefficients(POLES[0], 3) / [1, 1, 2], coefficients(POLES[1], 2) / [2, 2]]
    C = np.array([[1.0, 0, 0, 0, 0], [0, 0, 0, 2, 0]])
    rate = oracle.high_gain(K, theta, lambda _: A, lambda _: C, model(align))
    expected = run(lambda z, y_, valid, v: rate(z, y_ - [0, v[0]], valid, v), np.array(start), y, dt, u)
    assert not any("LIMITED" in flag for status in set(found_status(step, u, y)) for flag in step.flags(status))
    assert np.abs(expected).max() > 4
    assert estimates == pytest.approx(expected, abs=1e-10)


def found_status(step: Any, u: np.ndarray, y: np.ndarray) -> list[int]:
    step.reset()
    return step.run(u=u[:, 0], y=y).status.tolist()


@pytest.mark.ordinary("end")
@pytest.mark.parametrize("align", ["top", "end"])
def test_the_bound_of_several_outputs_holds(align: str) -> None:
    """M'P + P M < 0, M = Delta S (A - theta^i K C + J) S^-1 Delta^-1, at points of the box, above the bound."""
    form = blocks(align)
    p = np.concatenate([coefficients(POLES[0], 3), coefficients(POLES[1], 2)])
    error = on_companion(Integrators(form, form.gains), p.tolist())
    assert isinstance(error, Inclusion), error
    proof = Flow(error, Fraction(5)).least
    assert proof is not None
    P = np.array([[float(x) for x in row] for row in proof.weights.P])
    S = np.array([float(s) for s in error.scale])
    A, C = (np.array(M, dtype=float) for M in (form.A, sp.Matrix(form.output).jacobian(sp.Matrix(form.states))))
    K = block_diag(*(np.array(gain)[:, None] for gain in np.split(np.array(error.numbers["gains"], dtype=float), [3])))
    slope = sp.lambdify(form.states, sp.Matrix(form.b).jacobian(sp.Matrix(form.states)), "numpy")
    rng, power, levels = np.random.default_rng(1), np.array(exponents(form)), np.array([1, 2, 3, 1, 2])
    for _ in range(300):
        J = np.array(slope(*rng.uniform(-4, 4, size=5)), dtype=float) * rng.choice([0.0, 1.0, rng.uniform()], 5)
        for theta in (float(proof.theta) * 1.0001, float(proof.theta) * 3):
            Delta = S * theta ** -power.astype(float)
            M = Delta[:, None] * (A - theta ** levels[:, None].astype(float) * K @ C + J) / Delta
            assert np.linalg.eigvalsh(M.T @ P + P @ M).max() < 0


def test_a_row_that_reads_too_far_has_no_bound() -> None:
    """A form whose checks say otherwise: the structure is tested again."""
    form = blocks("top")
    other = replace(form, b=(form.b[0] + form.states[2], *form.b[1:]))
    error = on_companion(Integrators(other, other.gains), [1.0] * 5)
    assert isinstance(error, Nothing)
    assert "reads more than" in str(error.reason)


@pytest.mark.full
@pytest.mark.parametrize("align", ["top", "end"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=2)
def test_it_converges_from_anywhere_in_the_box(align: str, seed: int) -> None:
    rng, b = np.random.default_rng(seed), model(align)
    A = np.zeros((5, 5))
    A[0, 1], A[1, 2], A[3, 4] = 1, 2, 1
    t = np.arange(3000) * 1e-3
    plant = solve_ivp(
        lambda s, x: A @ x + b(x, np.array([np.sin(s)])),
        (0, 3),
        rng.uniform(-0.5, 0.5, 5),
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    ).y.T
    y = np.column_stack([plant[:, 0], 2 * plant[:, 3] + np.sin(t)])
    step = hg.sample(several(align, theta=15, initial=tuple(rng.uniform(-4, 4, 5))), hg.methods.rk4, dt=1e-3)
    result = step.run(u=np.sin(t), y=y)
    assert np.abs(plant).max() < 4
    assert np.abs(result.x[-1] - plant[-1]).max() < 1e-5


@pytest.mark.ordinary("driven-float", "driven-double", "several-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("kind", ["driven", "several"])
def test_the_c_is_the_program(kind: str, real: Any) -> None:
    observer = several() if kind == "several" else hg.observers.high_gain(driven(), theta=5, gains=DRIVEN_K)
    step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
    assert "64 samples as recorded" in native.run_check(hg.targets.c99(step, real=real))


def test_the_theorem_of_several_outputs_names_their_chains() -> None:
    observer = several()
    claims = {row.claim: row.standing for row in rows(observer.theorem, observer.checks)}
    assert claims["0 < a_m <= a_(i,j) <= a_M for every input and parameter in its range"] == "proved"
    assert claims["theta is large enough"] in ("proved", "unknown")
    assert "A - K C is Hurwitz" in claims


# --- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({}, BadGain, "takes either the poles of A - K C or the gains K; give one of the two"),
        ({"gains": (1, 1, 1), "poles": (-1,) * 3}, BadGain, "give one of the two"),
        ({"gains": (1, 1)}, BadGain, r"gains = \(1, 1\) must be 3 finite numbers"),
        ({"gains": (1, 1, NAN)}, BadGain, "must be 3 finite numbers"),
        ({"gains": ((1, 1, 1),)}, BadGain, "must be 3 finite numbers"),
        ({"gains": "high"}, BadGain, "gains = 'high' must be a number or an array of numbers"),
        (
            {"gains": Nothing("no gain up to 100 was found")},
            BadGain,
            "gains were not found: no gain up to 100 was found",
        ),
        ({"gains": (-6, 6, 1)}, NotHurwitz, "gains: the linear error core has the eigenvalues"),
        ({"poles": (-1, -1, -1)}, BadGain, r"a_1 = .* depends on the input, poles want it constant; give gains"),
    ],
)
def test_bad_gains(changes: dict[str, Any], error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        hg.observers.high_gain(driven(), theta=2, **changes)


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"poles": (-1,) * 5}, BadGain, "poles = .* must be 2 sequences, one for each output"),
        ({"poles": -1}, BadGain, "must be 2 sequences, one for each output"),
        ({"poles": ((-1,) * 2, (-1,) * 3)}, BadPoles, "there are 2, the form has 3 states"),
        ({"poles": None, "gains": ((3, 3, 1),)}, BadGain, "gains = .* must be 2 sequences, one for each output"),
        ({"poles": None, "gains": ((3, 3), (2, 1))}, BadGain, "must be 3 and 2 finite numbers"),
        ({"poles": None, "gains": ((3, 3, 1), (2, -1))}, NotHurwitz, "do not decay"),
    ],
)
def test_bad_gains_of_several_outputs(changes: dict[str, Any], error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        several(**changes)


def test_forms_it_does_not_take() -> None:
    with pytest.raises(
        BadGain, match=r"two has 2 outputs and no chains; use the form block_triangular if the plant is in it, else"
    ):
        hg.observers.high_gain(hg.forms.original(two_outputs()), theta=2, poles=((-1,), (-1, -1)))
    with pytest.raises(NotHurwitz, match="gains: the linear error core"):  # a_2 = -u goes through 0
        hg.observers.high_gain(fitzhugh_nagumo().form, theta=2, gains=(3, 3, 1), accept="triangular.a_2")
    x, v = signals(2), hg.Signal("v")
    data = {"states": x, "inputs": (v,), "outputs": [hg.Signal("y")], "output": [x[0]]}
    loose = hg.System("loose", **data, flow=[(1 + v**2) * x[1], -x[0]])
    with pytest.raises(BadGain, match=r"cannot be judged: a_2 = .* has no finite range on the box; declare ranges"):
        hg.observers.high_gain(hg.forms.triangular(loose), theta=2, gains=(2, 1), accept=())


def test_poles_of_several_outputs_in_plain_text() -> None:
    """A list for each output; two real poles are written as pairs, which else would be one complex pole."""
    each = {"theta": 10, "poles": [[-1, [-1, 0.5], [-1, -0.5]], [[-1, 0], [-2, 0]]]}
    read = Tuning("text", blocks("top").system, {"high_gain": {"form": "block_triangular", "dt": 1e-3, **each}})
    assert read.observer("high_gain").equations == several().equations
