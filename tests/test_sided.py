"""An inverse past its poles: the hidden state at the near end of its range, with a status; on the image unchanged."""

from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics, regular_at
from hgogen.analysis.maps import sided
from hgogen.observers.high_gain import high_gain
from hgogen.program import Place


@cache
def growth(sign: int = 1, low: float = 0.01, original: bool = False) -> hg.Form:
    """Contois growth, y = +-m: s = m w/(m - w), w = m' + u m; on the image m - w = m^2/(m + s)."""
    m, s = hg.Signal("m", low=low, high=0.2), hg.Signal("s", low=0, high=0.2)
    u, rate = hg.Signal("u", low=0, high=0.2, rates=((-1, 1),)), m * s / (m + s)
    flow = [rate - u * m, -rate + u * (sp.Rational(1, 10) - s)]
    plant = hg.System("growth", states=(m, s), inputs=(u,), outputs=(hg.Signal("y"),), flow=flow, output=[sign * m])
    return hg.forms.phase(plant, original=original)


@cache
def folded() -> hg.Form:
    """y = x1, y' = x2^2: x2 is a root of z_2."""
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=1, high=2)
    plant = hg.System("folded", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2**2, -x2], output=[x1])
    return hg.forms.phase(plant, recovered=True)


def full() -> hg.Form:
    """Three states in the plant's coordinates; dPhi/dx is triangular in no order, and its determinant has zeros."""
    x1, x2, x3 = x = tuple(hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2, 3))
    plant = hg.System("full", states=x, outputs=(hg.Signal("y"),), flow=[x2 * x3 + x3, x3 + x2, x1 * x2], output=[x1])
    return hg.forms.phase(plant, original=True)


def graph(form: hg.Form) -> ca.Function:
    dynamics = Dynamics(form)
    z, u = ca.SX.sym("z", form.n), ca.SX.sym("u", len(form.system.inputs))
    x, _ = dynamics.recovered(z, u)
    return ca.Function("x", [z, u], [x, ca.vertcat(*dynamics.beyond(z, u))])


@pytest.mark.full
@pytest.mark.parametrize("sign", [1, -1])
def test_on_the_image_of_the_ranges_it_is_the_inverse(sign: int) -> None:
    """Corners and 50 points. Where m - w = m^2/(m + s) is m/21, its rounding is 21 times that of m, and again in s."""
    form, rng = growth(sign), np.random.default_rng(2)
    Phi = sp.lambdify([*form.system.states, *form.system.inputs], form.to_form)
    recovered = graph(form)
    corners = [(m, s, u) for m in (0.01, 0.2) for s in (0, 0.2) for u in (0, 0.2)]
    for m, s, u in [*corners, *rng.uniform((0.01, 0, 0), 0.2, (50, 3))]:
        x, _ = recovered(np.array(Phi(m, s, u, 0.0)), [u, 0.0])
        assert np.array(x)[:, 0] == pytest.approx([m, s], rel=1e-12, abs=1e-15)


@pytest.mark.full
@pytest.mark.parametrize("sign", [1, -1])
def test_past_the_pole_the_hidden_state_is_at_the_near_end(sign: int) -> None:
    """s rises with m' up to its range's end, before, at and past the pole m' = m, and is said to be beyond it."""
    form = growth(sign)
    recovered = graph(form)
    rates = np.linspace(0, form.states[1].high if sign > 0 else -form.states[1].low, 101)
    rates = np.sort(np.append(rates, 0.05))
    recoveries = [recovered([sign * 0.05, sign * rate], [0, 0]) for rate in rates]
    s, beyond = (np.array([np.array(x)[-1, 0] for x in column]) for column in zip(*recoveries, strict=True))
    assert (np.diff(s) >= 0).all()
    assert (s[rates >= 0.04] == 0.2).all()  # m s/(m + s) = 0.04 at s = 0.2
    assert beyond.tolist() == (rates > 0.04).tolist()


@pytest.mark.parametrize(("make", "finite"), [(growth, (True, True)), (folded, (True, False))])
def test_what_is_no_rational_function_is_looked_at(make: Callable[[], hg.Form], finite: tuple[bool, ...]) -> None:
    assert sided(make()).finite == finite
    assert Dynamics(make()).recoverable == all(finite)


def test_a_denominator_keeps_at_most_half_of_what_it_is_on_the_image() -> None:
    """m^2/(m + s) >= 1e-4/0.21 on the ranges."""
    (least,) = (e for row in sided(growth()).rows for pair in row.atoms(sp.Max) for e in pair.args if e.is_number)
    assert 0.1 * 1e-4 / 0.21 < float(least) <= 0.5 * 1e-4 / 0.21


@pytest.mark.full
def test_a_side_that_is_not_proved_is_not_kept() -> None:
    """With m from 0 on the denominator is 0 on the image's edge: the plant keeps its coordinates, or Psi as it is."""
    form = growth(low=0)
    assert sided(form).rows == form.from_form


@pytest.mark.full
def test_the_status_tells_of_a_clamped_state() -> None:
    """OUTSIDE_BOX if and only if z, or Psi(z) before its clamp, is outside: y steps, and m' overshoots."""
    form = growth()
    step = hg.sample(hg.observers.low_power(form, theta=10), hg.methods.rk4, dt=0.01)
    assert not any(bit.name == "SINGULAR" for bit in step.layout.bits)
    z_box, (_, (low, high)) = [z.interval for z in form.states], [x.interval for x in form.system.states]
    hidden, seen = 0, set()
    for k in range(400):
        sample = step(u=(0.1, 0), y=0.05 if k < 200 else 0.08)
        z = [float(step._kept.places[Place("state", name)][0]) for name in ("xi_p", "xi_q")]
        m, w = z[0], z[1] + 0.1 * z[0]
        inside = all(a <= v <= b for v, (a, b) in zip(z, z_box, strict=True))
        plain = inside and m - w > 0 and low <= m * w / (m - w) <= high
        assert ("OUTSIDE_BOX" in sample.flags) == (not plain)
        hidden += inside and not plain
        seen.add(plain)
    assert hidden
    assert seen == {False, True}


@pytest.mark.full
def test_no_correction_is_divided_by_a_determinant_of_0() -> None:
    """At x2 = x3 = 0, x1 = 0 dPhi/dx has no inverse: the push is 0, and no step of it was a division by 0."""
    dynamics = Dynamics(full())
    z, v = ca.SX.sym("z", 3), ca.SX.sym("v", 3)
    push = dynamics.pulled(v, z, ca.SX(0, 1), 1e-3)
    assert np.array(ca.Function("push", [z, v], [push])([0, 0, 0], [1, 1, 1]))[:, 0].tolist() == [0, 0, 0]
    divisors = [e.dep(1) for e in _nodes(push) if e.is_op(ca.OP_DIV)]
    values = np.array(ca.Function("d", [z], [ca.vertcat(*divisors)])([0, 0, 0]))
    assert len(divisors) > 0
    assert (values != 0).all()


X = ca.SX.sym("x")


@pytest.mark.parametrize(
    "rows", [[[X, 1], [1, X]], [[X, 0], [1, X]], [[1, X], [X, 0]], [[0, X, 1], [1, 0, X], [X, 1, 0]], [[2, 1], [X, 3]]]
)
def test_a_matrix_without_an_inverse_gives_way_to_one_with(rows: list[list[Any]]) -> None:
    """Dense ones, with constants off the pivots too, and triangular ones in orders of their own."""
    matrix, test = ca.sparsify(ca.vertcat(*(ca.horzcat(*row) for row in rows))), ca.SX.sym("test")
    at = ca.Function("A", [X, test], [regular_at(matrix, test), matrix])
    for x in (-1.0, 0.0, 1.0, 6.0):
        assert abs(np.linalg.det(np.array(at(x, 0)[0]))) >= 1
        assert np.array(at(x, 1)[0]).tolist() == np.array(at(x, 1)[1]).tolist()


def _nodes(value: ca.SX) -> list[ca.SX]:
    nodes: dict[int, ca.SX] = {}
    todo = [value[i] for i in range(value.numel())]
    while todo:
        e = todo.pop()
        if e.element_hash() not in nodes:
            nodes[e.element_hash()] = e
            todo += [e.dep(i) for i in range(e.n_dep())]
    return list(nodes.values())


def test_a_determinant_proved_off_0_is_not_tested() -> None:
    observer = high_gain(growth(original=True), theta=2, poles=(-1, -1))
    step = hg.sample(observer, hg.methods.rk4, dt=0.01)
    assert not any(bit.name == "SINGULAR" for bit in step.layout.bits)
