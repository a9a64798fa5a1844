"""What SymPy brings in unasked, by functions that every reader knows."""

import json
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.graph import to_casadi
from hgogen.recheck.verification import recheck
from hgogen.rigor.series import values
from hgogen.rigor.tape import plain, tape

a, b, c = sp.symbols("a b c", real=True)
SIGNS = [sp.Symbol(name) for name in "pqr"]


@pytest.mark.parametrize("kind", [sp.ITE, sp.Xor, sp.Implies, sp.Equivalent])
def test_a_condition_is_the_same_for_all_truths(kind: type[sp.Basic]) -> None:
    args = SIGNS[:2] if kind is sp.Implies else SIGNS
    condition = plain(kind(*args))
    assert not condition.has(kind)
    for truths in product((sp.true, sp.false), repeat=len(args)):
        assert condition.subs(dict(zip(args, truths, strict=True))) == kind(*truths)


def nested() -> sp.Expr:
    """A piecewise expression in the condition of another, which SymPy makes an ITE."""
    inner = sp.Piecewise((b**2 - a, b > 0), (a, True))
    outer = sp.Piecewise((a + b, inner > 0), (a - b, True))
    assert outer.has(sp.ITE)
    return outer


@pytest.mark.parametrize("at", [(-1, 2), (5, 2), (-1, -2), (1, -2)])
def test_a_choice_in_a_condition_has_its_value_in_every_reading(at: tuple[int, int]) -> None:
    e, (first, second) = nested(), at
    inner = second**2 - first if second > 0 else first
    want = first + second if inner > 0 else first - second
    graph_symbols = ca.SX.sym("a"), ca.SX.sym("b")
    graph = ca.Function("f", graph_symbols, to_casadi([e], dict(zip((a, b), graph_symbols, strict=True))))
    assert float(graph(first, second)) == want
    assert values(tape([e], [a, b]), list(map(sp.Rational, at)), 64)[0] == want


def test_a_plant_with_a_choice_in_a_condition_becomes_a_step() -> None:
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    row = nested().xreplace({a: x, b: v})
    plant = hg.System("nested", states=(x, v), outputs=(hg.Signal("y"),), flow=[v, -row], output=[x])
    form = hg.forms.triangular(plant)
    step = hg.sample(hg.observers.high_gain(form, theta=2, poles=(-1, -1)), hg.methods.euler, dt=1e-2)
    y = np.random.default_rng(1).uniform(-1, 1, 50)
    run = step.run(y=y)  # compiled, where there is a compiler
    step.reset()
    assert np.array_equal(run.x, [step(y=each).x for each in y])
    assert run.x[1:].all()


@pytest.mark.parametrize(
    ("times", "written"),
    [
        (a**2 * sp.sign(a), a * sp.Abs(a)),
        (3 * a * sp.sign(a) * sp.sign(b), 3 * sp.Abs(a) * sp.sign(b)),
        (-(a - b) * sp.sign(a - b) * sp.exp(c), -sp.Abs(a - b) * sp.exp(c)),  # SymPy has b - a in it
        ((b - a) ** 3 * sp.sign(a - b), -((b - a) ** 2) * sp.Abs(a - b)),
        (sp.sin(a) * sp.sign(sp.sin(a)), sp.Abs(sp.sin(a))),
        (sp.Piecewise((b, a * sp.sign(a) < 1), (c, True)), sp.Piecewise((b, sp.Abs(a) < 1), (c, True))),
        (sp.sign(a) * b, sp.sign(a) * b),
        (sp.log(a) * sp.sign(sp.log(a)), sp.log(a) * sp.sign(sp.log(a))),  # without a value at a < 0, as it is
    ],
)
def test_a_number_times_its_sign_is_its_size(times: sp.Expr, written: sp.Expr) -> None:
    assert plain(times) == written


def test_a_drag_by_its_sign_is_proved_and_verified_as_one_by_its_size() -> None:
    """Of v^2 sign(v) SymPy's derivative has a DiracDelta, of v |v| it has none."""

    def certificate(drag: sp.Expr) -> dict[str, Any]:
        plant = hg.System("drag", states=(x, v), outputs=(hg.Signal("y"),), flow=[v, -sp.sin(x) - drag], output=[x])
        form = hg.forms.triangular(plant)
        observer = hg.observers.high_gain(form, theta=40, poles=(-1, -1))
        return hg.certificate(form, observer.checks, "high_gain")

    x, v = hg.Signal("x", low=-2, high=2), hg.Signal("v", low=-2, high=2)
    written = certificate(v**2 * sp.sign(v))
    assert written == certificate(v * sp.Abs(v))
    rows = recheck(json.dumps(written)).rows
    assert {"high_gain.convergence", "high_gain.theta"} <= {row.id for row in rows}
    assert {row.found for row in rows} == {"verified"}
