"""The uniform form, the block-triangular forms, slopes of the measured state: known answers, and what observers do."""

import numpy as np
import pytest
import sympy as sp
from form_answers import assert_same_plant, check, verdicts
from hypothesis import strategies as st

import hgogen as hg
from hgogen import forms
from hgogen.analysis.linearised import jacobians_on_box
from hgogen.check import Refuted, demand
from hgogen.form import OneOutput
from hgogen.forms.block_triangular import NoAlignment
from hgogen.reading.given import BadGain
from hgogen.signal import Signal
from hgogen.system import System
from tests.sweep import sweep

u, y1, y2 = Signal("u", low=-1, high=1), Signal("y1"), Signal("y2")
p, k = Signal("p", nominal=0.8), Signal("k", nominal=2, low=1, high=4)
x = tuple(Signal(f"x{i}", low=-1, high=2) for i in range(1, 7))
X1, X2, X3, X4, X5, X6 = x


def plant(flow: list[object], *outputs: object) -> System:
    used = sp.Matrix([*flow, *outputs]).free_symbols
    return System(
        "plant",
        states=x[: len(flow)],
        inputs=[u] if u in used else [],
        outputs=(y1, y2)[: len(outputs)],
        parameters=[s for s in (p, k) if s in used],
        flow=flow,
        output=outputs,
    )


# The uniform form


def test_uniform_by_permutation() -> None:
    """y = sinh x2, x2' = x3 + x3^3, x3' = e^x1 (2 + x2^2): slopes >= 1, >= 1, >= 2/e."""
    form = forms.uniform(plant([u * X2, X3 + X3**3, sp.exp(X1) * (2 + X2**2) - X3], sp.sinh(X2)))
    assert form.to_form == (X2, X3, X1)
    assert set(verdicts(form).values()) == {"proved"}
    assert str(check(form, "structure").reason) == "y1 -> x2 -> x3 -> x1"
    assert str(check(form, "slope_3").reason) == "it is at least 0.7357"  # 2/e = 0.7358
    assert_same_plant(form)


@pytest.mark.parametrize(
    ("rate", "verdict", "says"),
    [
        (X2 + X2**3, "proved", "at least 1"),
        (-X2 - sp.sin(X2) / 2, "proved", "at most -"),
        (X2**2, "refuted", "vanishes"),
        (X2 * u + X2**3, "refuted", ""),
        (sp.cosh(X2 + 3), "proved", "at least"),
        (X2**3 + (X1**2 - X1 + 1) * X2, "proved", "at least"),
        (sp.log(X2), "refuted", "not a finite real number"),
    ],
)
def test_a_slope_is_proved_or_refuted_on_the_box(rate: sp.Expr, verdict: str, says: str) -> None:
    form = forms.uniform(plant([rate, X1], X1))
    claim = check(form, "slope_2")
    assert claim.verdict == verdict
    assert says in str(claim.reason)
    assert (claim.verdict == "refuted") == bool(claim.witness)
    assert_same_plant(form)
    if verdict == "refuted":
        with pytest.raises(Refuted, match="Narrow the ranges"):
            demand(form.checks)


@pytest.mark.full
def test_a_slope_without_a_range_is_unknown_where_it_needs_one() -> None:
    wide = Signal("wide")
    form = forms.uniform(System("w", states=(X1, wide), outputs=(y1,), flow=[sp.exp(wide), 0], output=[X1]))
    assert check(form, "slope_2").verdict == "unknown"
    assert check(form, "slope_2").fix == "Declare low= and high= for wide."
    form = forms.uniform(System("w", states=(X1, wide), outputs=(y1,), flow=[wide + wide**3, 0], output=[X1]))
    assert check(form, "slope_2").verdict == "proved"


@pytest.mark.parametrize(
    ("flow", "output", "says"),
    [
        ([X2 + X3**2, X3, 0], X1, "x1' brings in x2, x3 together"),
        ([X2**3, X1, X2], X1, "x2' brings in no new state, so the output never shows x3"),
        ([X2, 0], X1 * X2, "y1 brings in x1, x2 together"),
    ],
)
def test_what_is_not_uniform_says_why(flow: list[sp.Expr], output: sp.Expr, says: str) -> None:
    form = forms.uniform(plant(flow, output))
    assert verdicts(form) == {"structure": "refuted"}
    assert says in str(check(form, "structure").reason)
    assert_same_plant(form)


def test_uniform_takes_one_output() -> None:
    with pytest.raises(OneOutput, match=r"has 2 outputs, y1, y2, .* use the form block_triangular"):
        forms.uniform(plant([X2, X1], X1, X2))


def test_observers_on_a_uniform_form() -> None:
    """The filter follows a still state from its output; a constant gain is refused by its theory."""
    form = forms.uniform(plant([X2 + X2**3 - X1, -X2 / 4], X1))
    with pytest.raises(BadGain, match=r"constant slopes"):
        hg.observers.high_gain(form, theta=3, poles=(-1, -1))
    step = hg.sample(
        hg.observers.riccati(form, Q=(1e-2, 1e-2), R=1e-2, theta=2), hg.methods.continuous_discrete, dt=0.01
    )
    states = np.array([0.3, 0.9])
    for _ in range(800):
        estimate = step(y=states[0])
        states = states + 0.01 * np.array([states[1] + states[1] ** 3 - states[0], -states[1] / 4])
    assert estimate["x2"] == pytest.approx(states[1], abs=0.02)  # Euler's error and one step's lag, 0.01 of x2 each


# Slopes that vary with the measured state


def test_a_slope_of_the_measured_state() -> None:
    system = plant([-(3 + X1) * X2, X1 * X2 - k * X3 * (2 - u), X1], 2 * X1)
    assert "the form's option measured" in check(forms.triangular(system), "structure").fix
    form = forms.triangular(system, measured=True)
    z1, z2, _ = form.states
    assert form.to_form == (X1, -X2, X3)
    assert form.A[0, 1] == z1 + 3
    assert form.A[1, 2] == k * (2 - u)
    assert form.b == (0, z1 * z2, z1)
    assert set(verdicts(form).values()) == {"proved"}
    assert_same_plant(form)


@pytest.mark.parametrize(
    ("rate", "verdict", "says"),
    [
        ((1 + X1) * X2, "a_2 refuted", "vanishes"),
        ((X1 - X2) * X2, "structure refuted", "x1' brings in x2 with a slope that varies with"),
        ((X1**2 + 1) * X2, "a_2 proved", ""),
    ],
)
def test_a_slope_of_the_measured_state_is_checked_on_its_range(rate: sp.Expr, verdict: str, says: str) -> None:
    form = forms.triangular(plant([rate, 0], X1), measured=True)
    name, _, expected = verdict.partition(" ")
    assert check(form, name).verdict == expected
    assert says in str(check(form, name).reason)


def test_the_jacobian_of_a_slope_of_the_measured_state() -> None:
    """The filter's F is the plant's own Jacobian."""
    system = plant([(3 + X1) * X2, -X1], X1)
    form = forms.triangular(system, measured=True)
    observer = hg.observers.riccati(form, Q=(1, 1), R=1)
    F, _ = jacobians_on_box(observer.dynamics, 0)
    point = {s: sp.Rational(1, 2) for s in (X1, X2)}  # the middle of the box
    assert np.allclose(F[0], np.array(sp.Matrix(system.flow).jacobian(system.states).subs(point), dtype=float))
    with pytest.raises(BadGain, match="a_2 = z1 \\+ 3 depends on the state"):
        hg.observers.high_gain(form, theta=2, poles=(-1, -1))


# Several outputs


def test_top_aligned() -> None:
    """Chains x1 -> -x4 and x2 -> x3; x4' reads x3, of its level."""
    form = forms.block_triangular(plant([-X4 + X2, k * X3, X1 * X4, X3 + u], -2 * X1, X2))
    assert form.blocks == (2, 2)
    assert form.alignment == "top"
    assert form.to_form == (-X1, X4, X2, X3)
    assert sp.Matrix([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, k], [0, 0, 0, 0]]) == form.A
    assert set(verdicts(form).values()) == {"proved"}
    assert set(verdicts(form)) == {"structure", "a_1_1", "a_1_2", "a_2_1", "a_2_2", "lipschitz"}
    assert_same_plant(form)


def test_end_aligned() -> None:
    """A chain of one state, whose row reads everything, and a chain of three."""
    system = plant([X2 * X3 * X4, -X2 + X3, (2 + u) * X4, X1 * X2], X1, X2)
    form = forms.block_triangular(system)
    assert (form.blocks, form.alignment) == ((1, 3), "end")
    assert set(verdicts(form).values()) == {"proved"}
    assert_same_plant(form)
    for align in ("top", "cascade"):
        other = forms.block_triangular(system, align)
        assert verdicts(other) == {"structure": "refuted"}
        assert "x1' brings in" in str(check(other, "structure").reason)
        assert_same_plant(other)


def test_cascade_and_its_refusals() -> None:
    """x2' = x3 + x4 reads the first chain; level by level it brings in two."""
    system = plant([X3, X3 + X4, u * X1, X2], X1, X2)
    form = forms.block_triangular(system)
    assert (form.alignment, form.blocks, form.to_form) == ("cascade", (2, 2), (X1, X3, X2, X4))
    assert set(verdicts(form).values()) == {"proved"}
    assert verdicts(forms.block_triangular(system, "top")) == {"structure": "refuted"}
    assert verdicts(forms.block_triangular(system, "end")) == {"structure": "unknown"}
    assert_same_plant(form)


def test_a_gain_of_a_block_that_vanishes_is_refuted() -> None:
    form = forms.block_triangular(plant([u * X3, X4, 0, X1], X1, X2))
    assert check(form, "a_1_2").verdict == "refuted"
    assert dict(check(form, "a_1_2").witness) == {"u": 0.0}
    with pytest.raises(Refuted):
        hg.observers.riccati(form, Q=(1,) * 4, R=1)
    hg.observers.riccati(form, Q=(1,) * 4, R=1, accept="block_triangular.a_1_2")


@pytest.mark.parametrize(
    ("flow", "outputs", "says"),
    [
        ([X2, 0], (X2, X2), "y1 and y2 bring in the same state, x2"),
        ([X2, 0], (X2, X1 + X2), "y2 brings in x1, x2 together"),
        ([X3, 0, 0, X4], (X1, X2), "no equation brings in x4"),
        ([X3 * X1, 0, 0], (X1, X2), "x1' brings in x3 with a slope that varies with x1"),
    ],
)
def test_what_is_no_block_form_says_why(flow: list[sp.Expr], outputs: tuple[sp.Expr, ...], says: str) -> None:
    form = forms.block_triangular(plant(flow, *outputs), "top")
    hidden = {"connected": "refuted"} if "no equation brings in" in says or "same state" in says else {}
    assert verdicts(form) == {"structure": "refuted"} | hidden
    assert says in str(check(form, "structure").reason)
    assert form.blocks == (form.n,)


def test_an_alignment_is_one_of_three() -> None:
    with pytest.raises(NoAlignment, match="align='middle' is none of top, end, cascade"):
        forms.block_triangular(plant([X2, 0], X1), "middle")


def test_one_output_is_one_block() -> None:
    one, other = plant([X2, X3, X1 * X2], -X1), plant([X2, X3, X1 * X2], -X1)
    block, triangular = forms.block_triangular(one), forms.triangular(other)
    assert (block.A, block.b, block.output) == (triangular.A, triangular.b, triangular.output)
    assert block.blocks == triangular.blocks == (3,)


def test_the_filter_runs_on_blocks() -> None:
    """theta = 1; the unmeasured speeds of two coupled oscillators are found."""
    form = forms.block_triangular(plant([X3, X4, -2 * X1 + X2, X1 - 3 * X2], X1, X2))
    step = hg.sample(hg.observers.riccati(form, Q=(0.1,) * 4, R=1e-3), hg.methods.continuous_discrete, dt=0.005)
    states = np.array([0.5, -0.3, 0.2, 0.4])
    matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-2, 1, 0, 0], [1, -3, 0, 0]])
    move = np.linalg.matrix_power(np.eye(4) + matrix * 0.005 / 50, 50)
    for _ in range(2000):
        estimate = step(y=states[:2])
        last, states = states, move @ states
    assert [estimate["x3"], estimate["x4"]] == pytest.approx(last[2:], abs=2e-3)


@pytest.mark.full
@sweep(3, 10, st.permutations(x[:5]), st.lists(st.sampled_from([1, -1]), min_size=5, max_size=5), st.integers(1, 4))
def test_scrambled_blocks_are_recovered(order: list[Signal], signs: list[int], n1: int) -> None:
    """Chains of n1 and 5 - n1 states, level by level, in shuffled states with random signs."""
    z = [s * o for s, o in zip(signs, order, strict=True)]
    chains = (z[:n1], z[n1:])
    rates = {}
    for i, own in enumerate(chains):
        for j, state in enumerate(own):
            seen = [c for chain in chains for c in chain[: j + 1]]
            rest = sp.sin(seen[-1]) * seen[0] + seen[i]
            following = (k, 1 + u**2)[i] * own[j + 1] if j + 1 < len(own) else 0
            rates[abs(state) if not state.is_Symbol else state] = (rest + following, state)
    flow = []
    for s in x[:5]:
        rest, state = next((rate, c) for rate, c in rates.values() if s in c.free_symbols)
        flow.append(rest * state.coeff(s))
    form = forms.block_triangular(plant(flow, chains[0][0], chains[1][0]), "top")
    assert form.to_form == tuple(z)
    assert form.blocks == (n1, 5 - n1)
    assert set(verdicts(form).values()) == {"proved"}
    assert_same_plant(form)
