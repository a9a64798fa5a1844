"""A Kalman filter of a linear plant converges where (C, A) is observable and (A, Q) controllable, and not else."""

import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import hgogen as hg
from hgogen.check import Verdict
from hgogen.prove.steady_filter import Linear, divergence_reason, linear
from hgogen.reading.given import BadGain
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.verification import recheck
from hgogen.rigor.definite import rationals

y, u = hg.Signal("y"), hg.Signal("u", low=-1, high=1)


def plant(A: sp.Matrix, C: sp.Matrix, beside: sp.Expr = sp.S.Zero, parameters: tuple = ()) -> hg.System:
    x = sp.Matrix([hg.Signal(f"x{i}", low=-10, high=10) for i in range(A.rows)])
    flow = A * x + sp.Matrix([u, *[0] * (A.rows - 1)]) + sp.Matrix([*[0] * (A.rows - 1), beside])
    outputs = [hg.Signal(f"y{j}") for j in range(C.rows)]
    return hg.System(
        "linear",
        states=list(x),
        inputs=(u,),
        outputs=outputs,
        parameters=parameters,
        flow=list(flow),
        output=list(C * x),
    )


def claim(system: hg.System, form=hg.forms.original, **gains) -> hg.Check:
    gains = {"Q": (1e-3,) * len(system.states), "R": 1e-4} | gains
    observer = hg.observers.riccati(form(system), **gains)
    (check,) = (check for check in observer.checks if check.id == "riccati.convergence")
    return check


@pytest.mark.full
@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 4), p=st.integers(1, 2), density=st.floats(0.2, 0.9), seed=st.integers(0, 10**6))
def test_it_is_proved_where_the_plant_is_observable_and_there_alone(n: int, p: int, density: float, seed: int) -> None:
    draw = random.Random(seed)

    def entry(*_: int) -> int:
        return draw.randint(-3, 3) if draw.random() < density else 0

    A, C = sp.Matrix(n, n, entry), sp.Matrix(p, n, entry)
    rank = sp.Matrix.vstack(*(C * A**k for k in range(n))).rank()
    verdict = claim(plant(A, C), accept=("original.connected",)).verdict
    assert (verdict is Verdict.PROVED) == (rank == n)


A = sp.Matrix([[-3, 1, 1], [1, -2, 0], [1, 0, -3]])
C = sp.Matrix([[1, 0, 0]])


def test_the_error_decays_as_proved() -> None:
    """An unstable plant: the steady gain, by the flow of the Riccati equation's Hamiltonian, makes A - K C Hurwitz."""
    unstable = A + sp.Matrix([[4, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert claim(plant(unstable, C), theta=2.0).verdict is Verdict.PROVED
    F, c = np.array(unstable, dtype=float), np.array(C, dtype=float)
    H = np.block([[-F.T, c.T @ c / 1e-4], [1e-3 * np.eye(3), F]])
    flow = expm(H * 3.0) @ np.vstack([np.eye(3), np.eye(3)])
    P = flow[3:] @ np.linalg.inv(flow[:3])
    assert np.linalg.eigvals(F - P @ c.T @ c / 1e-4).real.max() < 0


def test_it_is_not_proved_of_what_is_not_linear_or_varies() -> None:
    """A parameter with a range in A, a term that bends, and a theta that moves; a parameter beside the states may."""
    k = hg.Signal("k", nominal=1, low=0, high=2)
    x2 = hg.Signal("x2", low=-10, high=10)
    moving = A + sp.Matrix([[0, 0, 0], [0, 0, 0], [0, 0, k]])
    assert claim(plant(moving, C, parameters=(k,))).verdict is Verdict.UNKNOWN
    assert claim(plant(A, C, sp.sin(x2))).verdict is Verdict.UNKNOWN
    assert claim(plant(A, C), theta=hg.theta.decaying(2.0, 1.0)).verdict is Verdict.UNKNOWN
    assert claim(plant(A, C, k, (k,))).verdict is Verdict.PROVED
    fixed = hg.Signal("k", nominal=1)
    moving = A + sp.Matrix([[0, 0, 0], [0, 0, 0], [0, 0, fixed / 2]])
    assert claim(plant(moving, C, parameters=(fixed,))).verdict is Verdict.PROVED


@pytest.mark.parametrize("noise", [np.diag([-1.0, 1, 1]), -np.eye(3), np.diag([1, 1, -1e-9])])
def test_it_is_not_proved_of_noise_that_is_none(noise: np.ndarray) -> None:
    """Of a negative density, of one that is not symmetric, and of a theta that turns the sign of the correction."""
    known = linear(hg.forms.original(plant(A, C)))
    assert isinstance(known, Linear)
    assert divergence_reason(known, rationals(np.eye(3)), 1.0) is None
    skew = np.eye(3) + np.eye(3, k=1)
    for Q, theta in ((noise, 1.0), (noise, 2.0), (skew, 1.0), (np.eye(3), 0.0), (np.eye(3), -2.0)):
        assert divergence_reason(known, rationals(Q), theta) is not None


def test_it_is_not_proved_of_an_output_that_jumps() -> None:
    """Of x = 5/2 and z = -5/2 both outputs read -5/2, and nothing corrects the estimate."""
    x0, x1 = (hg.Signal(name, low=-10, high=10) for name in ("x0", "x1"))
    read = sp.Piecewise((x0, x0 < 0), (x0 - 5, True))
    jumps = hg.System("jumps", states=(x0, x1), inputs=(u,), outputs=(y,), flow=[x1, u], output=[read])
    assert read.xreplace({x0: sp.Rational(5, 2)}) == read.xreplace({x0: -sp.Rational(5, 2)})
    assert claim(jumps).verdict is Verdict.UNKNOWN


def test_it_is_not_proved_where_there_is_no_value() -> None:
    """log(u) of an input that may be negative: no sample of that output is used there."""
    x0, x1 = (hg.Signal(name, low=-10, high=10) for name in ("x0", "x1"))
    for rate, read, accept in ((u, x0 + sp.log(u), "singular.y"), (sp.log(u), x0, "singular.x1")):
        plant = hg.System("gap", states=(x0, x1), inputs=(u,), outputs=(y,), flow=[x1, rate], output=[read])
        assert claim(plant, accept=(accept,)).verdict is Verdict.UNKNOWN


# --- the certificate ------------------------------------------------------------------------------------------


def verified(change: Callable[[dict[str, Any], dict[str, Any]], Any], **gains: Any) -> bool:
    """Whether the claim is verified of a certificate that was changed and sealed again."""
    observer = hg.observers.riccati(hg.forms.original(plant(A, C)), **{"Q": (1e-3,) * 3, "R": 1e-4} | gains)
    content = json.loads(json.dumps(hg.certificate(observer.form, observer.checks, "riccati")))
    content.pop("digest", None)
    evidence = next(each for each in content["claims"] if each["id"] == "riccati.convergence")["evidence"]
    change(evidence, content)
    content["model"] = model_digest(content)
    rows = {row.id: row for row in recheck(json.dumps({**content, "digest": digest(content)})).rows}
    return rows["riccati.convergence"].found == "verified"


@pytest.mark.parametrize(
    "change",
    [
        lambda e, c: e["A"][2].__setitem__(2, "-2"),
        lambda e, c: e["C"][0].__setitem__(0, "2"),
        lambda e, c: c["observer"].update(R=["0"]),
        lambda e, c: c["observer"].update(R=["-1"]),
        lambda e, c: c["observer"].update(theta="0"),
        lambda e, c: c["observer"].update(theta="-2"),
        lambda e, c: c["observer"].update(Q=[["0"] * 3] * 3),
        lambda e, c: c["observer"].update(Q=[["0", "0", "0"], ["0", "1", "0"], ["0", "0", "0"]], theta="2"),
        lambda e, c: c["observer"].update(Q=[["-1", "0", "0"], ["0", "1", "0"], ["0", "0", "1"]]),
        lambda e, c: c["observer"].update(Q=[["1", "1", "0"], ["0", "1", "0"], ["0", "0", "1"]]),
        lambda e, c: (c["form"]["b"].__setitem__(2, "z2**2"), c["plant"]["flow"].__setitem__(2, "x0 - 3*x2 + x1**2")),
        lambda e, c: c["form"]["A"][2].__setitem__(2, "-2"),
    ],
)
def test_a_forged_number_fails(change: Any) -> None:
    assert verified(lambda e, c: None)
    assert not verified(change)


def test_noise_that_reaches_every_state_is_verified_and_one_that_does_not_is_refused() -> None:
    """On one state alone it drives the others; that of a state which no other reads does not."""
    assert verified(lambda e, c: None, Q=(0, 1e-3, 0))
    chained = sp.Matrix([[-1, 1, 0], [0, -2, 0], [0, 1, -3]])
    blocked = claim(plant(chained, sp.eye(3)), Q=(1e-3, 0, 0))
    assert (blocked.verdict, "not controllable" in str(blocked.reason)) == (Verdict.UNKNOWN, True)
    assert claim(plant(chained, sp.eye(3)), Q=(0, 1e-3, 0)).verdict is Verdict.PROVED
    with pytest.raises(BadGain, match="must be positive semidefinite"):
        claim(plant(chained, sp.eye(3)), Q=(-1e-3, 1e-3, 1e-3))
    uncontrollable = claim(plant(sp.zeros(2, 2), sp.eye(2)), Q=((1, 1), (1, 2))).verdict
    assert uncontrollable is Verdict.PROVED


@pytest.mark.ordinary("riccati")
@pytest.mark.parametrize("make", [hg.observers.riccati, hg.observers.ukf])
def test_a_zero_is_the_limit_of_small_numbers(make: Any) -> None:
    """A chain of integrators with noise on its last state: the estimates are those of 1e-30 in place of 0, to the
    rounding of 600 steps."""
    x = [hg.Signal(f"x{i}", low=-10, high=10) for i in range(3)]
    chain = hg.System("chain", states=x, inputs=(u,), outputs=(y,), flow=[x[1], x[2], u - x[2]], output=[x[0]])
    measured = np.sin(np.arange(600) / 50)
    runs = []
    for small in (0, 1e-30):
        observer = make(hg.forms.original(chain), Q=(small, small, 1.0), R=1e-4)
        runs.append(hg.sample(observer, dt=0.01).run(u=np.zeros(600), y=measured, engine="python").x)
    assert np.abs(runs[0] - runs[1]).max() < 1e-9
    assert np.isfinite(runs[0]).all()
