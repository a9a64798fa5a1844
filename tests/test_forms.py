"""Forms: the plant in observer coordinates is the same plant, and each hypothesis has the right verdict."""

import random
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from form_answers import assert_same_plant, check, verdicts
from hypothesis import strategies as st

import hgogen as hg
from hgogen import forms, observers
from hgogen.analysis.hypotheses import positive
from hgogen.check import Check, ClaimId, Refuted, UnknownCheck, Verdict, demand
from hgogen.form import Form, OneOutput
from hgogen.forms.original import BadOrder
from hgogen.registry import NoCase, case_in
from hgogen.signal import Signal
from hgogen.system import System
from tests.sweep import sweep

u, v, y = Signal("u", low=-1, high=1), Signal("v", low=1, high=2), Signal("y")
p, k = Signal("p", nominal=0.8), Signal("k", nominal=2, low=1, high=4)
x = tuple(Signal(f"x{i}", low=-3, high=2 + i) for i in range(1, 7))
X1, X2, X3, X4 = x[:4]


def plant(flow: list[object], output: object = X1, **data: object) -> System:
    """A plant with as many of x1..x6 as it has rates, unless `data` says otherwise."""
    outputs = output if isinstance(output, list) else [output]
    used = sp.Matrix([*flow, *outputs]).free_symbols
    return System(
        "plant",
        **{
            "states": x[: len(flow)],
            "inputs": [s for s in (u, v) if s in used],
            "outputs": [y],
            "parameters": [s for s in (p, k) if s in used],
            "flow": flow,
            "output": outputs,
            **data,
        },
    )


def assert_same_numbers(form: Form) -> None:
    """At points of the box on both sides of -1, 0, 1, 2, of each condition here: the form is the plant.

    1e-12: fifteen digits of numbers below 100.
    """
    draw = random.Random(3)
    system, back = form.system, dict(zip(form.states, form.to_form, strict=True))
    rows = list(zip(form.to_form, form.flow, strict=True))
    rates = dict(zip(system.states, system.flow, strict=True))
    gaps = [sum(z.diff(s) * rates[s] for s in system.states) - rate.xreplace(back) for z, rate in rows]
    gaps += [mine.xreplace(back) - theirs for mine, theirs in zip(form.output, system.output, strict=True)]
    signals = (*system.states, *system.inputs, *system.parameters)
    assert not any(gap.has(sp.AccumBounds, sp.nan, sp.zoo) for gap in gaps)
    for _ in range(25):
        lows = [(s.low, s.high) if s.bounded else (s.nominal, s.nominal) for s in signals]
        point = {s: draw.uniform(low, high) for s, (low, high) in zip(signals, lows, strict=True)}
        assert all(abs(sp.N(gap.subs(point))) < 1e-12 for gap in gaps), point


def assert_triangular(form: Form) -> None:
    assert_same_plant(form)
    n = form.n
    assert all(form.A[i, j] == 0 for i in range(n) for j in range(n) if j != i + 1)
    assert not form.A.free_symbols & {*form.states, *form.system.states}
    for i, row in enumerate(form.b):
        assert not row.free_symbols & {*form.states[i + 1 :], *form.system.states}


# Known answers


def test_fitzhugh_nagumo() -> None:
    """a_2 = -u vanishes in the paper's own example; a_3 = -eps is a sign."""
    form = forms.triangular(plant([X1 - X1**3 / 3 - X2 * u, p * (3 * sp.sin(X1) - X2 - X3), 0]))
    z1, z2, z3 = form.states
    assert form.to_form == (X1, X2, -X3)
    assert form.from_form == (z1, z2, -z3)
    assert sp.Matrix([[0, -u, 0], [0, 0, p], [0, 0, 0]]) == form.A
    assert form.b == (z1 - z1**3 / 3, p * (3 * sp.sin(z1) - z2), 0)
    assert form.output == (z1,)
    assert (z3.low, z3.high) == (-5.0, 3.0)
    assert verdicts(form) == {
        "structure": "proved",
        "a_1": "proved",
        "a_2": "refuted",
        "a_3": "proved",
        "lipschitz": "proved",
    }
    assert check(form, "a_2").witness == {"u": 0.0}
    assert (
        "Or accept triangular.a_2, knowing that the observer predicts without correction" in check(form, "a_2").advice
    )
    assert "through changes of u" in check(form, "a_2").consequence
    assert str(check(form, "a_3").reason) == "it is 4/5"
    assert_triangular(form)
    with pytest.raises(Refuted, match="a_2 vanishes; at u = 0"):
        demand(form.checks)
    demand(form.checks, accept="triangular.a_2")


def test_pendulum() -> None:
    q, w = Signal("q", "rad", "angle", low=-4, high=4), Signal("w", "rad/s", "rate", low=-20, high=20)
    tau = Signal("tau", "1/s2", "drive", low=-1, high=1)
    a, b = Signal("a", "1/s2", nominal=19.6), Signal("b", "1/s", nominal=0.1)
    pendulum = System(
        "pendulum",
        states=(q, w),
        inputs=(tau,),
        outputs=(y,),
        parameters=(a, b),
        flow=[w, -a * sp.sin(q) - b * w + tau],
        output=[q],
    )
    form = forms.triangular(pendulum)
    z1, z2 = form.states
    assert [(z.name, z.unit, z.meaning, z.interval) for z in form.states] == [
        ("z1", "rad", "angle", (-4.0, 4.0)),
        ("z2", "rad/s", "rate", (-20.0, 20.0)),
    ]
    assert sp.Matrix([[0, 1], [0, 0]]) == form.A
    assert form.b == (0, -a * sp.sin(z1) - b * z2 + tau)
    assert set(verdicts(form).values()) == {"proved"}
    assert_triangular(form)
    assert "z2' = -a*sin(z1) - b*z2 + tau" in str(form)


def test_a_shuffled_chain_of_six_with_signs() -> None:
    """y = -2 x4 and x4 -> x1 -> x6 -> x2 -> x5 -> x3; every a_i comes out positive."""
    one, two, three, four, five, six = x
    form = forms.triangular(
        plant(
            [
                -six + sp.cos(four),
                -p * five,
                sp.sin(one * six) + three * five,
                -k * one,
                three / 3 - five**2,
                -v * two + four * one,
            ],
            -2 * four,
        )
    )
    assert form.to_form == (-four, one, -six, two, -five, -three)
    assert [form.A[i, i + 1] for i in range(5)] == [k, 1, v, p, sp.Rational(1, 3)]
    assert form.output == (2 * form.states[0],)
    assert set(verdicts(form).values()) == {"proved"}
    assert_triangular(form)


@pytest.mark.ordinary("flow0-output0", "flow4-output4")
@pytest.mark.parametrize(
    ("flow", "output"),
    [
        ([(X2 + X3) ** 2 - X2**2 - 2 * X2 * X3 - X3**2 + X2, X3, 0], X1),
        ([X2 + sp.sin(X3) ** 2 + sp.cos(X3) ** 2, X3, 0], X1),
        ([(X2**2 - X1**2) / (X2 - X1), X3, 0], X1),
        ([X2 * (X3**2 - 1) / (X3 - 1) - X2 * X3, X3, 0], X1),
        ([sp.log(sp.exp(X2) * sp.exp(X3)) - X3, sp.sin(X3) * (X3 / sp.sin(X3)), 0], X1 + X2 / X3 - X2 / X3),
        ([(X2**2 + X2 * sp.sin(X1)) / X2, X3, 0], X1),
        ([X2 + X3 * (sp.exp(u) - 1 - sp.exp(u) + 1), X3, 0], (X1**2 + X1 * X2) / (X1 + X2)),
    ],
)
def test_terms_that_cancel_do_not_count(flow: list[sp.Expr], output: sp.Expr) -> None:
    form = forms.triangular(plant(flow, output))
    assert form.to_form == (X1, X2, X3)
    assert verdicts(form)["structure"] == "proved"
    assert form.output == (form.states[0],)
    assert_triangular(form)


def test_a_known_offset_stays_in_the_output() -> None:
    form = forms.triangular(plant([X2, 0], k * X1 + 3 * u + 1))
    assert form.output == (k * form.states[0] + 3 * u + 1,)
    assert set(verdicts(form).values()) == {"proved"}


@pytest.mark.ordinary("offset0-proved-", "offset4-refuted-u", "offset7-unknown-loose")
@pytest.mark.parametrize(
    ("offset", "verdict", "says"),
    [
        (3 * u + 1, "proved", ""),
        (sp.sqrt(u + 1) + 1 / v, "proved", ""),
        (Signal("loose") ** 2, "proved", ""),
        (1 / u, "refuted", "u"),
        (sp.log(u), "refuted", "u"),
        (1 / (3 * u - sp.Rational(1, 7)), "unknown", "3*u - 1/7 != 0"),
        (sp.log(Signal("loose") ** 2 + 1), "proved", ""),
        (sp.sqrt(Signal("loose")), "unknown", "loose"),
    ],
)
def test_an_offset_must_be_a_number(offset: sp.Expr, verdict: str, says: str) -> None:
    inputs = sorted(offset.free_symbols, key=str)
    form = forms.triangular(plant([X2, 0], X1 + offset, inputs=inputs))
    claim = check(form, "offset")
    assert claim.verdict == verdict
    assert says in f"{claim.reason} {claim.fix} {' '.join(claim.witness)}"


def test_no_offset_no_claim() -> None:
    assert "offset" not in verdicts(forms.triangular(plant([X2, 0], k * X1)))


@pytest.mark.full
def test_a_long_chain_is_quick() -> None:
    """Followed, not searched: 0.7 s of processor time."""
    n = 40
    states = [Signal(f"s{i}", low=-1, high=1) for i in range(n)]
    rates = [(-1) ** i * states[i + 1] + sp.sin(states[i] * states[0]) for i in range(n - 1)]
    rates.append(sum(map(sp.sin, states)))
    chain = System("chain", states=states[::-1], outputs=[y], flow=rates[::-1], output=[states[0]])
    start = time.process_time()
    form = forms.triangular(chain)
    assert time.process_time() - start < 20
    assert [abs(z) for z in form.to_form] == [abs(s) for s in states]
    assert set(verdicts(form).values()) == {"proved"}


# What is not shown to be triangular

SOON, LATE = Signal("soon", low=1, high=2), Signal("late", low=-1, high=1)


@pytest.mark.ordinary("flow0-output0", "flow1-output1", "flow5-output5")
@pytest.mark.parametrize(
    ("flow", "output"),
    [
        ([sp.Piecewise((X2, X2 > 0), (X2 + 1, True)), -X1], X1),
        ([X2, -X1], sp.Piecewise((X1, X1 > 0), (X1 - 3, True))),
        ([X2 + sp.atan(X2) + sp.atan(1 / X2), -X1], X1),
        ([sp.floor(X2) + X2 - sp.floor(X2 + sp.sin(X1)), -X1], X1),
        ([X2 + sp.Heaviside(X2 - 1, 1), -X1], X1),
        ([X2 + sp.sign(X2), -X1], X1),
        ([sp.Abs(X2), -X1], X1),
        ([sp.Min(X2, 1), -X1], X1),
        ([X2 + sp.sqrt((X2 - 1) ** 2) / (X2 - 1), -X1], X1),
        ([sp.asin(sp.sin(X2)), -X1], X1),
    ],
)
def test_a_row_that_jumps_or_bends_in_the_new_state_is_not_linear(flow: list[sp.Expr], output: sp.Expr) -> None:
    form = forms.triangular(plant(flow, output))
    assert verdicts(form) == {"structure": "refuted"}
    assert_same_numbers(form)


@pytest.mark.parametrize(
    "row", [sp.Abs(SOON), sp.Min(SOON, 5), sp.Max(SOON, 1), sp.Piecewise((SOON, SOON > 0), (SOON + 1, True))]
)
def test_a_row_that_jumps_or_bends_outside_the_box_alone_is_linear(row: sp.Expr) -> None:
    """On the box the row is SOON."""
    form = forms.triangular(plant([row, 0], states=(X1, SOON)))
    assert verdicts(form)["structure"] == "proved"
    assert form.to_form == (X1, SOON)
    assert form.A[0, 1] == 1
    assert form.b[0] == 0
    assert_same_numbers(form)
    demand(form.checks)


def test_a_state_that_is_not_shown_to_matter_is_unknown() -> None:
    """atan(t) + atan(1/t) is pi/2 for t > 0."""
    form = forms.triangular(plant([LATE + sp.atan(SOON) + sp.atan(1 / SOON), SOON, 0], states=(X1, LATE, SOON)))
    assert verdicts(form)["structure"] == "unknown"
    assert "soon" in str(check(form, "structure").reason)
    assert form.to_form == (X1, LATE, SOON)
    assert_same_numbers(form)


_ROWS = st.sampled_from(
    [
        X2,
        u * X2 + X1**2,
        (2 + u) * (X2 + sp.sin(X1)),
        X2 + sp.Abs(X1),
        X2 * v + sp.Piecewise((X1, X1 > 1), (-X1, True)),
        (X2**2 - X1**2) / (X2 - X1),
        0.1 * (X2 + 0.3 * X1),
        X2 / k - X1 * sp.floor(u),
    ]
)
_JUMPY = st.sampled_from(
    [
        sp.Integer(0),
        sp.Integer(1),
        sp.sign(X2),
        sp.Abs(X2) - X2,
        sp.Heaviside(X2 - 1, 0),
        sp.Piecewise((1, X2 > 1), (0, True)),
        sp.Piecewise((1, X1 > 1), (0, True)),
        sp.Piecewise((X1, X2 > X1), (0, True)),
        sp.atan(X2) + sp.atan(1 / X2),
        sp.Min(X2, 1) + sp.Max(X2, 1) - X2,  # 1
        sp.sqrt(X2**2) / X2,
        sp.cos(X2) ** 2 + sp.sin(X2) ** 2,
        sp.log(sp.exp(X2)) - X2,
        sp.acos(sp.cos(X2)) - X2,
    ]
)


@pytest.mark.full
@sweep(10, 30, _ROWS, _JUMPY, _JUMPY, st.booleans())
def test_a_proved_structure_is_the_plant_itself(row: sp.Expr, extra: sp.Expr, end: sp.Expr, swap: bool) -> None:
    """Whatever the verdict, the form is the plant; and where it is proved, the rows are linear indeed."""
    states = {X1: X2, X2: X1} if swap else {}
    flow = [(row + extra).xreplace(states), (end * X1).xreplace(states)]
    form = forms.triangular(plant(flow[::-1] if swap else flow, X2 if swap else X1))
    assert_same_numbers(form)
    if verdicts(form)["structure"] == "proved":
        assert not form.b[0].has(form.states[1])
        assert not form.output[0].diff(form.states[0]).has(*form.states)


# What is not triangular


@pytest.mark.parametrize(
    ("flow", "output", "says"),
    [
        ([X2 + X3, X3, 0], X1, "x1' brings in x2, x3 together"),
        ([X2, 0], X1 + X2, "y brings in x1, x2 together"),
        ([X2, X1, X3], X1, "x2' brings in no new state, so the output never shows x3"),
        ([0, X1], X1, "x1' brings in no new state, so the output never shows x2"),
        ([X2, 0], 2 * u, "y brings in no new state, so the output never shows x1, x2"),
        ([X2**3, 0], X1, "x1' brings in x2 with a slope that varies with x2, 3*x2**2"),
        ([X1 * X2, 0], X1, "x1' brings in x2 with a slope that varies with x1, x1"),
        ([X2, 0], sp.sin(X1), "y brings in x1 with a slope that varies with x1, cos(x1)"),
        ([sp.floor(X2), 0], X1, "slope that varies with x2"),
        ([X2 + sp.atan(X3) + sp.atan(1 / X3), X3, 0], X1, "x1' brings in x2, x3 together"),
    ],
)
def test_what_is_not_triangular_says_why_and_is_not_built_on(flow: list[sp.Expr], output: sp.Expr, says: str) -> None:
    form = forms.triangular(plant(flow, output))
    assert verdicts(form) == {"structure": "refuted"}
    assert says in str(check(form, "structure").reason)
    assert check(form, "structure").fix
    assert form.to_form == form.system.states
    assert_same_plant(form)
    with pytest.raises(Refuted, match=r"\. hgogen check MODEL tells .* the form original is for any plant"):
        demand(form.checks, form=form)


def test_the_observer_that_is_advised_takes_the_option_that_is_advised() -> None:
    """x1' = (4 + x1) x2: no constant gain has a slope that varies with the measured state."""
    varying = plant([(4 + X1) * X2, -X2], X1)
    with pytest.raises(Refuted, match="by the form's option measured, which riccati takes"):
        observers.high_gain(forms.triangular(varying), theta=5, poles=(-1, -1))
    measured = forms.triangular(varying, measured=True)
    assert verdicts(measured)["structure"] == "proved"
    assert observers.riccati(measured, Q=(1, 1), R=1).name == "riccati"


def test_several_outputs_are_for_another_form() -> None:
    two = plant([X2, X1], [X1, X2], outputs=[y, Signal("w")])
    with pytest.raises(OneOutput, match=r"'plant' has 2 outputs, y, w, .* keep one of them, or use the form original"):
        forms.triangular(two)


# 0 < a_m <= a_i <= a_M


@pytest.mark.ordinary(
    "gain0-proved-witness0-it is 4/5",
    "gain1-proved-witness1-between 1.414 and 1.415",
    "gain10-refuted-witness10-vanishes",
)
@pytest.mark.parametrize(
    ("gain", "verdict", "witness", "says"),
    [
        (-p, "proved", {}, "it is 4/5"),
        (-sp.sqrt(2), "proved", {}, "between 1.414 and 1.415"),
        (-v, "proved", {}, "between 1 and 2,"),
        (1 + u**2, "proved", {}, "between 1 and 2,"),
        (u**2 + 2 * u + 2, "proved", {}, "between 0.9999 and 5,"),
        (-sp.exp(-3 * u), "proved", {}, "between 0.04978 and 20.09"),
        (k**-2 * v, "proved", {}, "outward-rounded intervals"),
        (2 + sp.sin(sp.log(v)), "proved", {}, "between 2 and 2.639"),
        (2 + sp.sin(sp.log(u)), "refuted", {"u": 0.0}, "not a finite real number"),
        (sp.sqrt(v) - 1, "refuted", {"v": 1.0}, "vanishes"),
        (u, "refuted", {"u": 0.0}, "vanishes"),
        (u**2, "refuted", {"u": 0.0}, "vanishes"),
        (0.1 * u**2 + 0.2 * u + 0.1, "refuted", {"u": -1.0}, "vanishes"),
        (0.2 * v**2 + 0.1 * v - 0.3, "refuted", {"v": 1.0}, "vanishes"),  # in floats it is 5.6e-17 there
        (0.3 * v**2 - 0.6 * v + 0.31, "proved", {}, "between 0.009999 and 0.3101"),
        (u * v, "refuted", {"u": 0.0}, "vanishes"),
        (u - sp.Rational(1, 3), "refuted", {"u": 1 / 3}, "vanishes"),
        (sp.exp(u) - 2, "refuted", {"u": float(sp.log(2))}, "changes sign"),
        ((u - sp.Rational(1, 7)) ** 2, "refuted", {"u": 1 / 7}, "vanishes"),
        (1 / u, "refuted", {"u": 0.0}, "not a finite real number"),
        (k - 3, "refuted", {"k": 3.0}, "vanishes"),
    ],
)
def test_gains_are_proved_refuted_or_honestly_unknown(
    gain: sp.Expr, verdict: str, witness: dict[str, float], says: str
) -> None:
    form = forms.triangular(plant([gain * X2, 0]))
    claim = check(form, "a_2")
    assert claim.verdict == verdict
    assert says in str(claim.reason)
    found_at = {name: claim.witness[name] for name in witness}
    # Bisection halves a line of length 2 sixty times: exact to the last place of a float.
    assert found_at == pytest.approx(witness, rel=1e-15)
    assert_triangular(form)


@pytest.mark.full
@sweep(8, 30, st.fractions(-1, 1, max_denominator=20), st.fractions(1, 2, max_denominator=20))
def test_a_gain_that_vanishes_somewhere_is_never_proved(at_u: sp.Rational, at_v: sp.Rational) -> None:
    gain = (u - sp.Rational(at_u)) ** 2 + (v - sp.Rational(at_v)) ** 2
    assert check(forms.triangular(plant([gain * X2, 0])), "a_2").verdict in (Verdict.REFUTED, Verdict.UNKNOWN)


def test_an_input_without_a_range_takes_any_value() -> None:
    loose = Signal("loose")
    claim = check(forms.triangular(plant([loose * X2, 0], inputs=[loose])), "a_2")
    assert (claim.verdict, dict(claim.witness)) == (Verdict.REFUTED, {"loose": 0.0})
    claim = check(forms.triangular(plant([(1 + loose**2) * X2, 0], inputs=[loose])), "a_2")
    assert claim.verdict == Verdict.UNKNOWN
    assert claim.fix == "Declare low= and high= for loose."


def test_a_gain_of_a_parameter_that_is_zero() -> None:
    dead = Signal("dead", nominal=0)
    claim = check(forms.triangular(plant([dead * X2, 0], parameters=[dead])), "a_2")
    assert claim.verdict == Verdict.REFUTED
    assert "correct the model or the parameter's value" in claim.fix


# Lipschitz


@pytest.mark.ordinary(
    "b6-refuted-no bound towards x1 = 0",
    "b7-where-holds on every closed part of the box where u > 0",
    "b14-proved-",
    "b15-unknown-may jump",
)
@pytest.mark.parametrize(
    ("b", "verdict", "says"),
    [
        (X1**3 * sp.sin(X2) * sp.exp(u), "proved", ""),
        (sp.Abs(X1) + sp.Max(X2, 0, u) + sp.tanh(X1 * X2), "proved", ""),
        (X1 / (X2**2 + 1) + sp.sqrt(X1 + 4), "proved", ""),
        (sp.sqrt(v - 1) * X1 + sp.sign(u) * X2, "proved", ""),
        (sp.tan(X1 / 6) + sp.log(X2 + 4), "proved", ""),
        (sp.sqrt(X1 + 3), "refuted", "no bound towards x1 = -3"),
        (1 / X1 + sp.log(X2), "refuted", "no bound towards x1 = 0"),
        (sp.sqrt(u) * X1, "where", "holds on every closed part of the box where u > 0"),
        (X1 / u, "refuted", "no bound towards u = 0"),
        (1 / u, "where", "holds on every closed part of the box where u != 0"),
        (1 / u + sp.sqrt(u) * X1, "where", "holds on every closed part of the box where u > 0"),
        (sp.tan(X1), "unknown", "no uniform bound is shown; it may be singular at cos(x1) = 0"),
        (X1 * sp.sin(1 / X1), "unknown", "no uniform bound is shown; it may be singular at x1 = 0"),
        (sp.asin(X1), "refuted", "no bound towards x1 = 1"),
        (sp.Piecewise((X1, X1 > 0), (0, True)), "proved", ""),
        (sp.Piecewise((X1 + 1, X1 > 0), (0, True)), "unknown", "may jump"),
        (1 / X1 + sp.exp(400 * X2), "refuted", "no bound towards x1 = 0"),
        (X1 * sp.sign(X2), "unknown", "sign(x2) may jump"),
        (sp.Mod(X1, 1), "unknown", "may jump"),
    ],
)
def test_lipschitz(b: sp.Expr, verdict: str, says: str) -> None:
    claim = check(forms.triangular(plant([X2, b])), "lipschitz")
    assert claim.verdict == verdict
    assert says in str(claim.reason)


def test_the_bound_in_the_plant_s_own_coordinates_is_that_of_the_rows_as_a_whole() -> None:
    """x' = x + sin x with y = x: the slopes 1 + cos x and 1 have at x = 0 the norm sqrt(5), though those of the terms
    x, sin x and y = x have sqrt(3)."""
    x, y = Signal("x", low=-1, high=1), Signal("y")
    plant = System("sum", states=(x,), outputs=(y,), flow=[x + sp.sin(x)], output=[x])
    check = next(check for check in forms.original(plant).checks if check.id == "original.lipschitz")
    assert check.verdict is Verdict.PROVED
    assert check.proofs[0].proof.high >= 5**0.5


def test_lipschitz_needs_ranges_only_where_the_slope_grows() -> None:
    wide = (Signal("s1"), Signal("s2"))
    bounded = plant([wide[1], sp.sin(wide[0]) - 3 * wide[1]], wide[0], states=wide)
    assert verdicts(forms.triangular(bounded))["lipschitz"] == "proved"
    cubic = check(forms.triangular(plant([wide[1], -(wide[1] ** 3)], wide[0], states=wide)), "lipschitz")
    assert (cubic.verdict, cubic.fix) == (Verdict.UNKNOWN, "Declare low= and high= for s2.")


# Any scrambled triangular plant is recovered

_GAINS = st.sampled_from([sp.Integer(1), sp.Rational(3, 7), p, k, v, k * v, 1 + u**2, sp.Float(0.25)])


def _nonlinear(states: tuple[Signal, ...]) -> st.SearchStrategy[sp.Expr]:
    leaf = st.sampled_from([*states, u, p, sp.Integer(2)])
    grow = lambda inner: st.one_of(  # noqa: E731
        st.builds(lambda a, b: a + b, inner, inner),
        st.builds(lambda a, b: a * b, inner, inner),
        st.builds(lambda a, b: a - b, inner, inner),
        st.builds(lambda f, a: f(a), st.sampled_from([sp.sin, sp.cos, sp.tanh]), inner),
    )
    return st.recursive(leaf, grow, max_leaves=4)


@st.composite
def _scrambled(draw: st.DrawFn) -> tuple[System, tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
    """A triangular plant in shuffled states with random signs, the z that undoes it, and its a_1..a_n."""
    n = draw(st.integers(1, 5))
    order = draw(st.permutations(x[:n]))
    signs = draw(st.lists(st.sampled_from([1, -1]), min_size=n, max_size=n))
    gains = draw(st.lists(_GAINS, min_size=n, max_size=n))
    z = tuple(Signal(f"c{i}") for i in range(n))
    hidden = {c: sign * state for c, sign, state in zip(z, signs, order, strict=True)}
    rates = {}
    for i, state in enumerate(order):
        rate = draw(_nonlinear(z[: i + 1])) + (gains[i + 1] * z[i + 1] if i + 1 < n else 0)
        rates[state] = signs[i] * sp.sympify(rate).xreplace(hidden)
    flow = [rates[state] for state in x[:n]]
    system = plant(flow, gains[0] * hidden[z[0]])
    return system, tuple(hidden[c] for c in z), tuple(gains)


@pytest.mark.full
@sweep(15, 60, _scrambled())
def test_a_scrambled_plant_is_recovered(
    scrambled: tuple[System, tuple[sp.Expr, ...], tuple[sp.Expr, ...]],
) -> None:
    system, z, gains = scrambled
    form = forms.triangular(system)
    assert form.to_form == z
    assert tuple(form.A[i, i + 1] for i in range(form.n - 1)) == gains[1:]
    assert form.output == (gains[0] * form.states[0],)
    assert set(verdicts(form).values()) == {"proved"}
    assert_triangular(form)


# The plant in its own coordinates


def test_the_levels_are_those_of_the_states_in_their_order() -> None:
    """Outwards x1, x3, x2: of the order (x3, x2, x1) these are 1, 2, 0, which is not its own inverse."""
    turned = forms.original(plant([sp.sqrt(X3 + 4) - X1, X1 - X3**2, 2 * u * X2 + X1], X1), ("x3", "x2", "x1"))
    assert turned.levels == (1, 2, 0)


@pytest.mark.parametrize("order", [None, ("x1", X3, "x2")])
def test_original_keeps_the_order_and_knows_the_way_outwards(order: tuple[Signal | str, ...] | None) -> None:
    form = forms.original(plant([sp.sqrt(X3 + 4) - X1, X1 - X3**2, 2 * u * X2 + X1], X1), order)
    assert form.to_form == ((X1, X3, X2) if order else (X1, X2, X3))
    assert form.levels == ((0, 1, 2) if order else (0, 2, 1))
    z = dict(zip(form.names, form.states, strict=True))
    rates = dict(zip(form.names, form.flow, strict=True))
    assert rates == {
        "x1": sp.sqrt(z["x3"] + 4) - z["x1"],
        "x2": z["x1"] - z["x3"] ** 2,
        "x3": 2 * u * z["x2"] + z["x1"],
    }
    assert form.A[list(z).index("x3"), list(z).index("x2")] == 2 * u
    assert verdicts(form) == {
        "connected": "proved",
        "order": "generic",
        "lipschitz": "proved",
    }
    assert check(form, "order").claim.startswith("in the order (x1, x3, x2) ")
    assert_same_plant(form)
    assert z["x2"].interval == X2.interval


@pytest.mark.parametrize(
    ("flow", "output", "verdict", "says"),
    [
        ([X2 / u, X1], X1, "refuted", "no bound towards u = 0"),
        ([X2, X1], X1 / u, "refuted", "no bound towards u = 0"),
        ([X2, X1], sp.sqrt(X1), "refuted", "no bound towards x1 = 0"),
        ([X2, X1], sp.sign(X1), "unknown", "sign(x1) may jump"),
        ([X2 / v + X1 * X2, X1], sp.exp(X1), "proved", ""),
    ],
)
def test_original_is_lipschitz_as_a_whole(flow: list[sp.Expr], output: sp.Expr, verdict: str, says: str) -> None:
    claim = check(forms.original(plant(flow, output)), "lipschitz")
    assert claim.verdict == verdict
    assert says in str(claim.reason)


@pytest.mark.parametrize(
    ("flow", "output", "says"),
    [
        ([X2 + X3, X3, X1], X1, "x1' depends on x3, later in this order"),
        ([X2, X1, X2], X1 + X3, "y depends on x3, later in this order"),
        ([X2, X2, X2], X3, "x2' does not depend on x1"),
        ([X2, sp.Max(X3, 0), X1], X1, "the slope of x2' in x3 may be 0 on a part of the box"),
        ([hg.table(X2, [-3, 0, 4], [0, 0, 3]), X3, X1], X1, "the slope of x1' in x2 may be 0 on a part of the box"),
    ],
)
def test_original_does_not_claim_a_shape_that_is_not_there(flow: list[sp.Expr], output: sp.Expr, says: str) -> None:
    form = forms.original(plant(flow, output))
    assert check(form, "order").verdict == Verdict.UNKNOWN
    assert says in str(check(form, "order").reason)
    assert_same_plant(form)


@pytest.mark.parametrize("link", [X2 + sp.Abs(X2) / 2, hg.table(X2, [-3, 0, 4], [-1, 0, 3]), X2**3 + X2])
def test_original_claims_it_where_a_slope_with_branches_has_one_sign(link: sp.Expr) -> None:
    assert check(forms.original(plant([link, X3, X1], X1)), "order").verdict == Verdict.GENERIC


def test_original_takes_several_outputs() -> None:
    form = forms.original(plant([X3, X4, u, X1 * X2], [X2, X1 + v * X2], outputs=[y, Signal("w")]))
    z1, z2, *_ = form.states
    assert form.to_form == (X1, X2, X3, X4)
    assert form.output == (z2, z1 + v * z2)
    assert verdicts(form)["order"] == "unknown"
    assert_same_plant(form)


def test_original_names_a_hidden_state() -> None:
    form = forms.original(plant([X2, X1, X1 + X3]))
    assert form.to_form == (X1, X2, X3)
    assert check(form, "connected").verdict == Verdict.REFUTED
    assert str(check(form, "connected").reason) == "no output ever shows x3"


@pytest.mark.parametrize("make", [forms.state_affine, forms.block_triangular])
def test_no_form_that_an_observer_takes_hides_a_state(make: Callable[..., Any]) -> None:
    """The slope of x2 varies with the measured x1: state-affine, and no chain; x3 sees both and is seen by none."""
    form = make(plant([X1 * X2, X1, X1 + X3]))
    connected = next(c for c in form.checks if c.id.fact == "connected")
    assert (connected.verdict, str(connected.reason)) == (Verdict.REFUTED, "no output ever shows x3")
    with pytest.raises(Refuted, match="no output ever shows x3"):
        observers.riccati(form, Q=(1, 1, 1), R=1)
    assert not [c for c in make(plant([X1 * X2, X1])).checks if c.id.fact == "connected"]


@pytest.mark.parametrize("order", [(X1,), (X1, X1), (X1, X3), ()])
def test_original_wants_each_state_once(order: tuple[Signal, ...]) -> None:
    with pytest.raises(BadOrder, match="must hold each of the states x1, x2 once"):
        forms.original(plant([X2, X1]), order=order)


# Names, checks, registry


def test_the_states_of_a_form_take_names_that_are_free() -> None:
    z1, z2 = Signal("z1"), Signal("zeta2")
    form = forms.triangular(plant([z2, z1], z1, states=(z1, z2)))
    assert [z.name for z in form.states] == ["xi1", "xi2"]


def test_a_mirrored_state_mirrors_its_data() -> None:
    back = Signal("back", "m", "depth", nominal=0, low=0, high=3)
    form = forms.triangular(plant([-back, 0], X1, states=(X1, back)))
    z = form.states[1]
    assert (z.unit, z.meaning, str(z.nominal), z.low, str(z.high)) == ("m", "minus depth", "0.0", -3.0, "0.0")


def test_accept_must_name_a_check() -> None:
    form = forms.triangular(plant([u * X2, 0]))
    with pytest.raises(UnknownCheck, match="accept names 'a_2', which is no check here; the checks are tri"):
        demand(form.checks, accept=("a_2",))


def test_the_folder_is_the_registry() -> None:
    here = {path.stem for path in Path(forms.__path__[0]).glob("*.py")} - {"__init__"}
    assert set(forms.__all__) == here
    for name in here:
        assert callable(getattr(forms, name))


def test_a_file_without_its_case_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cases_for_a_test"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "good.py").write_text("def good(): return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    try:
        assert case_in(import_module("cases_for_a_test.good"))() == 1
        (folder / "stray.py").write_text("other = 1\n")
        with pytest.raises(NoCase, match=r"cases_for_a_test\.stray defines no 'stray'"):
            case_in(import_module("cases_for_a_test.stray"))
    finally:
        for name in [name for name in sys.modules if name.startswith("cases_for_a_test")]:
            del sys.modules[name]


@pytest.mark.parametrize(
    ("gain", "verdict"),
    [
        (lambda x: 2 + sp.sin(x), Verdict.PROVED),
        (lambda x: 2 + sp.sign(x), Verdict.UNKNOWN),  # the field jumps at 0
        (lambda x: 2 + sp.sqrt(sp.Abs(x - sp.Rational(3, 10))), Verdict.REFUTED),  # steep without bound at 3/10
    ],
)
def test_a_gain_of_the_measured_state_counts_as_b_does(gain: Callable[[sp.Expr], sp.Expr], verdict: Verdict) -> None:
    x1, x2 = Signal("x1", low=-1, high=1), Signal("x2", low=-1, high=1)
    plant = System("screen", states=(x1, x2), outputs=(Signal("y"),), flow=[gain(x1) * x2, -x1], output=[x1])
    checks = {check.id: check for check in forms.triangular(plant, measured=True).checks}
    assert checks["triangular.a_2"].verdict is Verdict.PROVED
    assert checks["triangular.lipschitz"].verdict is verdict
    assert checks["triangular.lipschitz"].claim.startswith("b, with the a_i(z_1) z_i, is Lipschitz")


# --- steps ----------------------------------------------------------------------------------------------------


def test_a_slope_does_not_see_a_jump() -> None:
    """x2 - 1 and x2, one above the other: x2 = 1 and x2 = 0 give the same rate, though each branch has the slope 1."""
    stepped = sp.Piecewise((X2 - 1, X2 > 0), (X2, True))
    check = verdicts_of(forms.uniform(plant([stepped, -X1])))["uniform.slope_2"]
    assert check.verdict is Verdict.UNKNOWN
    assert str(check.reason).startswith("x1' may jump with x2, at a step of Piecewise")
    why = verdicts_of(forms.triangular(plant([stepped, -X1])))["triangular.structure"].reason
    assert str(why) == "x1' brings in x2 in a way that is not linear"
    kinked = verdicts_of(forms.uniform(plant([X2 + sp.Abs(X2) / 2, -X1])))["uniform.slope_2"]
    assert kinked.verdict is Verdict.PROVED


@pytest.mark.ordinary("tangent")
@pytest.mark.parametrize(
    "rate",
    [
        lambda x: x + sp.atan(sp.tan(x)),  # falls by pi at pi/2, where it has no value
        lambda x: x + sp.atanh(3 / x),  # no real number within 3
    ],
    ids=("tangent", "unreal"),
)
def test_a_slope_does_not_see_what_has_no_value_and_cancels_in_it(rate: Callable[[sp.Expr], sp.Expr]) -> None:
    x1, x2 = Signal("x1", low=-2, high=2), Signal("x2", low=-2, high=2)
    system = System("poles", states=(x1, x2), outputs=(Signal("y"),), flow=[rate(x2), -x2], output=[x1])
    assert verdicts_of(forms.uniform(system))["uniform.slope_2"].verdict is not Verdict.PROVED


def verdicts_of(form: Form) -> dict[str, Check]:
    return {check.id: check for check in form.checks}


def test_a_slope_of_the_wrong_sign_is_refuted() -> None:
    x = Signal("x", low=1, high=2)
    system = System("one", states=(x,), outputs=(Signal("y"),), flow=[-x], output=[x])
    verdicts = {
        text: positive(ClaimId("form", "a"), "a", a, system).verdict
        for text, a in {"x": x, "-x": -x, "x - 3": x - 3}.items()
    }
    assert verdicts == {"x": Verdict.PROVED, "-x": Verdict.REFUTED, "x - 3": Verdict.REFUTED}


BOXED = tuple(Signal(name, low=-1, high=1) for name in ("x1", "x2"))
NOTHING = sp.Abs(sp.sin(BOXED[0]) ** 2 + sp.cos(BOXED[0]) ** 2 - 1)  # 0, which no algebra here shows


@pytest.mark.parametrize(
    ("rate", "connected"),
    [
        (sp.Max(BOXED[1], 5), "refuted"),
        (BOXED[1] + sp.Abs(BOXED[1] - 3), "refuted"),
        (BOXED[1] * sp.Heaviside(BOXED[1] - 2), "refuted"),
        (BOXED[1] * NOTHING, "unknown"),
        (sp.floor(BOXED[1] / 3 + sp.Rational(1, 2)), "unknown"),
    ],
)
def test_original_connects_no_state_that_does_not_matter_on_the_box(rate: sp.Expr, connected: str) -> None:
    """max(x2, 5) is 5 on the box, where no output shows x2; what may be 0 shows nothing for certain."""
    x1, x2 = BOXED
    boxed = System("p", states=BOXED, outputs=(y,), flow=[rate, x1 + x2], output=[x1])
    form = forms.original(boxed)
    assert check(form, "connected").verdict == connected
    assert check(form, "order").verdict == Verdict.UNKNOWN
    hidden = [one.id for one in forms.state_affine(boxed).checks if one.id.fact == "connected"]
    assert bool(hidden) is (connected == "refuted")


def test_a_step_connects_a_state_and_has_no_slope() -> None:
    """floor(2 x2) varies with x2, and its slope is 0 wherever it has one."""
    x1, x2 = BOXED
    form = forms.original(System("p", states=BOXED, outputs=(y,), flow=[sp.floor(2 * x2), x1], output=[x1]))
    assert check(form, "connected").verdict == Verdict.PROVED
    assert check(form, "order").verdict == Verdict.UNKNOWN
