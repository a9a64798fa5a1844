"""Filtered output injection: the observers `filtered` and `filtered_injection` of Astolfi, Jungers, Zaccarian 2018."""

from functools import cache
from typing import Any

import emitted
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import filtered as oracle
from plants import MODELS, chain, fitzhugh_nagumo, model, two_outputs

import hgogen as hg
from hgogen.estimators.core import core as linear_core
from hgogen.estimators.core import core_numbers, nominal, numbers
from hgogen.estimators.gains import BadPoles, OutsideParabola, coefficients, filtered_spectrum
from hgogen.model import load
from hgogen.part import Ode
from hgogen.reading.given import BadGain
from hgogen.rigor.definite import NotHurwitz
from hgogen.run import native
from hgogen.theorem import rows

POLES = (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)
L = np.array([6.0, 15, 18, 10])
A, C = np.eye(4, k=1), np.eye(1, 4)
FREE = {"N": np.eye(4), "F": -3 * np.eye(4) + A.T, "G": C[0], "H": np.diag(L)}  # free of k: Q is M
NAN = float("nan")


@cache
def form(name: str = "hyperjerk") -> hg.Form:
    plant = chain(int(name[-1])) if name.startswith("chain") else model(name)
    return hg.forms.triangular(plant)


def filtered(name: str = "hyperjerk", **changes: Any) -> hg.Observer:
    tuning: dict[str, Any] = {"theta": 10, "alpha": 3, "beta": 1, "poles": POLES}
    return hg.observers.filtered(form(name), **{**tuning, **changes})


def injected(name: str = "hyperjerk", **changes: Any) -> hg.Observer:
    return hg.observers.filtered_injection(form(name), **{"theta": 10, **FREE, **changes})


def core(observer: hg.Observer) -> np.ndarray:
    (part,) = observer.parts
    assert isinstance(part, Ode)
    return core_numbers(part, 1, nominal(observer))


def measured(samples: int, dt: float) -> np.ndarray:
    """Plant (22) from its bounded orbit, by the oracle."""
    return oracle.run(lambda x, y: oracle.plant(x), np.array([-0.9, 0, 0, 0]), np.zeros(samples), dt)


# --- the linear error core ----------------------------------------------------------------------------------

sizes = st.floats(0.2, 3.0)


@given(st.lists(st.tuples(sizes, st.floats(0.0, 1.5)), min_size=2, max_size=2), st.floats(1.0, 30.0), sizes)
@settings(deadline=None, max_examples=25)
def test_the_core_has_the_poles_of_lemma_1(pairs: list[tuple[float, float]], theta: float, beta: float) -> None:
    """theta times the roots of s (s + alpha) = beta mu, for any mu in the parabola. The characteristic polynomials are
    compared, whose coefficients are well conditioned where eigenvalues that meet are not."""
    poles = [pole for x, y in pairs for pole in (complex(-x, y), complex(-x, -y))]
    alpha = 1.1 * max(np.sqrt(beta * y * y / x) for x, y in pairs) + 0.1
    observer = filtered(theta=theta, alpha=alpha, beta=beta, poles=poles)
    expected = np.poly(theta * filtered_spectrum(poles, alpha, beta)).real
    assert np.poly(core(observer)) == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())


def test_eta_settles_at_powers_of_k_beta_over_alpha() -> None:
    """The DC gain from a constant y - x_1 to eta_i is (k beta/alpha)^i: eta' = 0 solved from the core."""
    observer = filtered(theta=7, alpha=2, beta=0.5, poles=None, gains=L)
    linear = linear_core(observer.parts[0], 1)
    slope, source = (numbers(graph, nominal(observer)) for graph in (linear.M, linear.B))
    assert np.linalg.solve(slope[4:, 4:], -source[4:, 0]) == pytest.approx((7 * 0.5 / 2) ** np.arange(1, 5), rel=1e-14)


@pytest.mark.full
def test_the_general_observer_is_the_filtered_one() -> None:
    """With the correction F = -(alpha I - k beta A'), and with numbers free of k, through a tuned theta and missing
    samples; as printed, F = alpha I - k beta A', it is refused. |theta^4 eta| eps of rounding."""
    k, rng = 10.0, np.random.default_rng(1)
    D = np.diag(k ** np.arange(1, 5))
    paper = {"N": np.linalg.inv(D), "F": -(3 * np.eye(4) - k * A.T), "G": k * C[0], "H": np.diag(L)}
    y = rng.normal(size=300)
    y[20:30] = NAN
    steps = [hg.sample(each, hg.methods.rk4, dt=2e-3) for each in (filtered(), injected(), injected(**paper))]
    runs = [step.run(y=y, engine="python").x for step in steps]
    assert np.abs(runs[0]).max() > 4
    assert runs[1] == pytest.approx(runs[0], abs=1e-11)
    assert runs[2] == pytest.approx(runs[0], abs=1e-11)
    for step in steps[:2]:
        step.reset()
        step.tune(theta=4.0)
    tuned = [step.run(y=y, engine="python").x for step in steps[:2]]
    assert tuned[1] == pytest.approx(tuned[0], abs=1e-11)
    assert np.abs(tuned[0] - runs[0]).max() > 0.5
    with pytest.raises(NotHurwitz, match=r"N, F, G, H: the linear error core has the eigenvalues .* do not decay"):
        injected(**{**paper, "F": -paper["F"]})


def test_a_filter_of_another_size() -> None:
    """One state: y goes through 1/(s/8 + 1), and the core is Q by its own definition, in powers of theta."""
    F, G, H = [[-8.0]], [8.0], coefficients([-1] * 4, 4)[:, None]
    observer = injected(theta=3, N=None, F=F, G=G, H=H)
    Q = np.block([[A, H], [-np.outer(G, C), np.array(F)]])
    assert np.poly(core(observer)) == pytest.approx(np.poly(3 * Q), rel=1e-10)
    assert [field.size for field in observer.parts[0].fields] == [4, 1]


# --- convergence, and agreement with the oracle ------------------------------------------------------------


@pytest.mark.ordinary("injected")
@pytest.mark.parametrize("which", ["filtered", "injected"])
def test_the_step_is_the_oracles(which: str) -> None:
    """From far off, so that the box saturates: rounding only, |theta^4 eta| eps for each of the contracting steps."""
    dt, start = 2e-3, {"x1": 1, "x2": -2, "x3": 3, "x4": -4}
    y = measured(1500, dt)[:, 0]
    observer = {"filtered": filtered, "injected": injected}[which](initial=start)
    rate = oracle.filtered(L, 3, 1, 10) if which == "filtered" else oracle.injected(**FREE, k=10)
    expected = oracle.run(rate, np.array([*start.values(), 0, 0, 0, 0], dtype=float), y, dt)[:, :4]
    run = hg.sample(observer, hg.methods.rk4, dt=dt).run(y=y, engine="python")
    assert (np.abs(expected) > oracle.HIGH).any()
    assert run.x == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


@pytest.mark.full
@pytest.mark.parametrize("which", ["filtered", "injected"])
def test_it_converges_from_a_bad_start_and_over_missing_samples(which: str) -> None:
    """What is left is the line between samples, dt^2/8 of y'' amplified by the core: 4e-6 x 10^3 at most."""
    dt = 2e-3
    x = measured(8000, dt)
    y = x[:, 0].copy()
    y[3000:3100] = NAN
    observer = {"filtered": filtered, "injected": injected}[which](initial=(3, 4, -6, 12))
    run = hg.sample(observer, hg.methods.rk4, dt=dt).run(y=y, engine="python")
    assert np.abs(run.x - x)[:100].max() > 5
    assert (np.abs(run.x - x)[-500:].max(axis=0) < [4e-6, 4e-5, 4e-4, 4e-3]).all()


def test_a_missing_sample_leaves_no_trace() -> None:
    """Whatever stood in its place."""
    y = measured(200, 2e-3)[:, 0]
    estimates = []
    for lost in (NAN, float("inf"), 1e9):
        y[100:110] = lost
        estimates.append(hg.sample(filtered(), hg.methods.rk4, dt=2e-3).run(y=y, engine="python").x)
    assert np.array_equal(estimates[0], estimates[1])
    assert np.array_equal(estimates[0], estimates[2])


def test_it_takes_an_offset_scaled_slopes_and_inputs() -> None:
    """y = -2 x1 + v, x1' = 3 x2, x2' = -sin x1: in the chain's coordinates, the estimate in the plant's."""
    import sympy as sp

    x = [hg.Signal(f"x{i}", low=-4, high=4) for i in (1, 2)]
    v, y = hg.Signal("v", low=-1, high=1), hg.Signal("y", low=-20, high=20)
    plant = hg.System(
        "scaled", states=x, inputs=(v,), outputs=(y,), flow=[3 * x[1], -sp.sin(x[0])], output=[-2 * x[0] + v]
    )
    observer = hg.observers.filtered(hg.forms.triangular(plant), theta=8, alpha=3, beta=1, poles=(-1, -2))
    assert np.poly(core(observer)) == pytest.approx(np.poly(8 * filtered_spectrum((-1, -2), 3, 1)).real, rel=1e-9)
    trial = hg.trial.Trial("swing", 10.0, {"x1": 1, "x2": 0}, inputs={"v": sp.sin(hg.trial.t)}, seeds=(0,))
    (done,) = hg.trial.try_out(hg.sample(observer, hg.methods.rk4, dt=2e-3), trial, engine="python")
    assert np.abs(done.error[-500:]).max() < 1e-5


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("which", ["filtered", "injected"])
def test_c_is_python(which: str) -> None:
    y = measured(400, 1e-3)[:, 0]
    y[50:60] = NAN
    step = hg.sample({"filtered": filtered, "injected": injected}[which](), hg.methods.rk4, dt=1e-3)
    python = step.run(y=y, engine="python")
    step.reset()
    c = step.run(y=y, engine="c")
    assert np.array_equal(c.x, python.x)
    assert np.array_equal(c.status, python.status)


# --- what is said of it, and what is refused ----------------------------------------------------------------


@pytest.mark.full
def test_the_theorem_says_what_is_proved() -> None:
    standing = {row.claim: row.standing for row in rows(filtered().theorem, filtered().checks)}
    assert standing["theta is large enough"] == "proved"
    assert [text for claim, text in standing.items() if claim.startswith("the poles of A - L C")] == ["proved"]
    assert "unknown" not in {row.standing for row in rows(filtered().theorem, filtered().checks)[:3]}


def test_the_bound_on_theta_is_that_of_the_filtered_observer() -> None:
    """With numbers free of k the general observer has the same core: the same bound, proved, and theta above it."""
    general = {"F": -3 * np.eye(2) + np.eye(2, k=-1), "G": (1, 0), "H": np.diag((2, 1)), "N": None, "theta": 40}
    each = (filtered("chain2", theta=40, poles=(-1, -1)), injected("chain2", **general))
    for observer in each:
        checks = {check.id.unqualified: check for check in observer.checks}
        assert checks["convergence"].verdict is checks["theta"].verdict is hg.Verdict.PROVED
        assert 2.9 < checks["convergence"].proofs[0].fact.theta < 3.2
        assert {row.standing for row in rows(observer.theorem, observer.checks) if "large" in row.claim} == {"proved"}
    low = injected("chain2", **{**general, "theta": 2.5})
    assert {row.standing for row in rows(low.theorem, low.checks) if "large" in row.claim} == {"unknown"}


def test_the_models_tuning_is_the_papers() -> None:
    tuning = load(MODELS / "hyperjerk.py").module.tuning["filtered"]
    assert tuning == {"theta": 10, "alpha": 3, "beta": 1, "poles": POLES}


@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"theta": 0}, BadGain, r"theta = 0 must be a positive finite number"),
        ({"alpha": 0}, BadGain, "alpha = 0 must be a positive finite number"),
        ({"beta": NAN}, BadGain, "beta = nan must be a positive finite number"),
        ({"alpha": "3"}, BadGain, "alpha = '3' must be a number"),
        ({"poles": None}, BadGain, "filtered takes either the poles of A - L C or the gains L; give one of the two"),
        ({"gains": L}, BadGain, "filtered takes either the poles"),
        ({"poles": (-1, -2)}, BadPoles, r"poles .*: there are 2, the form has 4 states; give one for each"),
        ({"poles": (-1, -1, -1, 1)}, BadPoles, r"poles .*: 1\+0j is not in the open left half plane"),
        ({"poles": (-1 + 1j, -1, -1, -1)}, BadPoles, "poles .*: complex poles must come in conjugate pairs"),
        (
            {"poles": (-1 + 4j, -1 - 4j, -1, -1)},
            OutsideParabola,
            r"poles -1\+4j, -1-4j: outside the parabola .* alpha\^2/beta = 9 must be above 16 to admit them",
        ),
        ({"poles": None, "gains": (1, 2)}, BadGain, r"gains = \(1, 2\) must be 4 finite numbers, one for each state"),
        ({"poles": None, "gains": (1, 2, 3, NAN)}, BadGain, r"gains = .* must be 4 finite numbers"),
        (
            {"poles": None, "gains": L, "alpha": 0.9},
            NotHurwitz,
            r"gains: .* do not decay; alpha\^2/beta = 0\.81 must be above about 1; raise alpha or lower beta",
        ),
        ({"poles": None, "gains": -L}, NotHurwitz, "gains: .*; A - L C itself has the pole .*; take gains whose poles"),
        ({"initial": {"x1": 99}}, BadGain, r"initial x1 = 99\.0 must be finite and in \[-3, 3\]"),
    ],
)
def test_what_filtered_refuses(changes: dict[str, Any], kind: type, said: str) -> None:
    with pytest.raises(kind, match=f"^{said}"):
        filtered(**changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"F": np.eye(3)}, r"F of shape \(3, 3\) must be 4 x 4 finite numbers; the length of G is the filter's size"),
        ({"G": 1.0}, r"G of shape \(\) must be 1 finite numbers"),
        ({"H": np.eye(3, 4)}, r"H of shape \(3, 4\) must be 4 x 4 finite numbers"),
        ({"N": np.eye(3)}, r"N of shape \(3, 3\) must be 4 x 4 finite numbers"),
        ({"F": np.full((4, 4), NAN)}, r"F of shape \(4, 4\) must be 4 x 4 finite numbers"),
        ({"F": "F"}, "F = 'F' must be a number or an array of numbers"),
    ],
)
def test_what_filtered_injection_refuses(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        injected(**changes)


@pytest.mark.full
def test_the_manual_prints_the_matrices_and_what_they_stand_in() -> None:
    step = hg.sample(injected(N=np.diag([1, 2, 3, 4.5])), dt=1e-3)
    manual = emitted.manual(hg.targets.c99(step, check=False))
    matrices = {name: np.array(FREE[name]) for name in ("F", "G", "H")} | {"N": np.diag([1, 2, 3, 4.5])}
    for name, matrix in matrices.items():
        rows = ", ".join(f"({', '.join(f'{v:g}' for v in row)})" for row in np.atleast_2d(matrix))
        assert f" {name} = {rows if matrix.ndim == 1 else f'({rows})'} " in manual
    assert "in chains of integrators the plant is } dot{w} = A w + c(w, u),quad A" in manual


@pytest.mark.parametrize("build", [hg.observers.filtered, hg.observers.filtered_injection])
def test_other_forms_are_refused(build: Any) -> None:
    gains = {"alpha": 3, "beta": 1, "poles": POLES} if build is hg.observers.filtered else FREE
    with pytest.raises(BadGain, match="takes one output, two has 2"):
        build(hg.forms.original(two_outputs()), theta=2, **gains)
    neuron = fitzhugh_nagumo().form
    with pytest.raises(BadGain, match=r"a_2 = -u depends on the input, .* wants it constant; use riccati"):
        build(neuron, theta=2, **gains, accept="triangular.a_2")
    with pytest.raises(BadGain, match="takes a form"):
        build("form", theta=2, **gains)
