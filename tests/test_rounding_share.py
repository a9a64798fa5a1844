"""What a program rounds: one call against exact arithmetic, its share in an error against runs, and forged numbers."""

import copy
import math
import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sp
from exact import evaluate, machine
from flint import arb
from forger import sealed
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import MODELS, model

import hgogen as hg
from hgogen.certificates import rounding_share
from hgogen.certificates.rounding_share import rounding_errors
from hgogen.check import Verdict
from hgogen.model import MissingPart, load
from hgogen.modelfiles.declarations import Bounds
from hgogen.program import Place
from hgogen.prove.inclusion import Inclusion
from hgogen.prove.plant_step import Unbounded
from hgogen.prove.quadratic import floats
from hgogen.recheck import program as recheck_rounding
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.rules.discrete_time import _sizes
from hgogen.recheck.verification import recheck
from hgogen.rigor.rounding import REALS, Computed, NoRoundingBound, Real, Rounding, error_free
from hgogen.step import BadStep

TYPE: dict[Real, Any] = {"float": np.float32, "double": np.float64}


def ball(low: float, high: float) -> Any:
    """A ball that holds both."""
    return arb(low).union(arb(high))


# --- operations


UNARY: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "sin": (ca.sin, mpmath.sin),
    "cos": (ca.cos, mpmath.cos),
    "exp": (lambda x: ca.exp(x / 4), lambda x: mpmath.exp(x / 4)),
    "log": (lambda x: ca.log(x * x + 0.3), lambda x: mpmath.log(x * x + mpmath.mpf(0.3))),
    "sqrt": (lambda x: ca.sqrt(1.7 + x * x), lambda x: mpmath.sqrt(mpmath.mpf(1.7) + x * x)),
    "atan": (ca.atan, mpmath.atan),
    "tanh": (ca.tanh, mpmath.tanh),
    "cosh": (lambda x: ca.cosh(x / 3), lambda x: mpmath.cosh(x / 3)),
    "size": (ca.fabs, abs),
    "clamp": (
        lambda x: ca.fmin(ca.fmax(x, -0.7), 1.3),
        lambda x: min(max(x, mpmath.mpf(-0.7)), mpmath.mpf(1.3)),
    ),
    "branch": (
        lambda x: ca.if_else(x < 0.4, 0.1 * x, x - 0.36),
        lambda x: mpmath.mpf(0.1) * x if x < mpmath.mpf(0.4) else x - mpmath.mpf(0.36),
    ),
    "inverse": (lambda x: 1 / (1.1 + x * x), lambda x: 1 / (mpmath.mpf(1.1) + x * x)),
}
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / (2 + b * b),
}


@given(
    st.lists(
        st.tuples(st.sampled_from([*UNARY, *BINARY]), st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=7
    ),
    st.sampled_from(REALS),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_no_graph_is_further_from_exact_arithmetic(rows: list[tuple[str, int, int]], real: Real, seed: int) -> None:
    """Of the bits of the C, at numbers of the precision, against 60 digits."""
    rng, x = np.random.default_rng(seed), ca.SX.sym("x", 2)
    low, width = rng.uniform(-2, 2, 2), rng.uniform(0, 1, 2)
    rounding, nodes = Rounding(real), [x[0], x[1]]
    for name, i, j in rows:
        a, b = nodes[i % len(nodes)], nodes[j % len(nodes)]
        nodes.append(UNARY[name][0](a) if name in UNARY else BINARY[name](a, b))
    function = ca.Function("f", [x], [nodes[-1]])
    held = [error_free(ball(*ends)) for ends in zip(low, low + width, strict=True)]
    (known,) = walked(rounding, function, held)
    for _ in range(20):
        at = (low + width * rng.random(2)).astype(TYPE[real]).astype(float)
        at = np.clip(at, low, low + width).astype(TYPE[real]).astype(float)
        if not ((low <= at) & (at <= low + width)).all():
            continue
        with mpmath.workdps(60):
            exact = [mpmath.mpf(value) for value in at]
            for name, i, j in rows:
                a, b = exact[i % len(exact)], exact[j % len(exact)]
                exact.append(UNARY[name][1](a) if name in UNARY else BINARY[name](a, b))
            computed = mpmath.mpf(float(evaluate(function, [at], real)[0][0]))
            assert abs(computed - exact[-1]) <= mpmath.mpf(float(known.error)) * (1 + mpmath.mpf(10) ** -9)


WIDE: dict[int, tuple[float, float, Callable[[float], float], float]] = {
    ca.OP_TAN: (-1.2, 1.2, math.tan, 1 + math.tan(1.2) ** 2),
    ca.OP_ASIN: (-0.8, 0.8, math.asin, 1 / math.sqrt(1 - 0.8**2)),
    ca.OP_ATAN: (0.5, 9.0, math.atan, 0.8),
    ca.OP_TANH: (-3.0, 3.0, math.tanh, 1.0),
    ca.OP_ASINH: (-9.0, 9.0, math.asinh, 1.0),
    ca.OP_ACOSH: (1.25, 9.0, math.acosh, 1 / math.sqrt(1.25**2 - 1)),
    ca.OP_ATANH: (-0.8, 0.8, math.atanh, 1 / (1 - 0.8**2)),
}


@pytest.mark.parametrize("op", WIDE)
def test_a_function_of_a_wide_range_is_bounded_by_its_values_and_steepest_slope(op: int) -> None:
    low, high, function, steepest = WIDE[op]
    known = Rounding("double").apply(op, [Computed(ball(low, high), arb(1e-3))])
    assert float(known.value.lower()) == pytest.approx(function(low), rel=1e-6)
    assert float(known.value.upper()) == pytest.approx(function(high), rel=1e-6)
    ends = function(low), function(high)
    assert known.value.lower() <= min(ends) * (1 + 1e-15)
    assert known.value.upper() >= max(ends) * (1 - 1e-15)
    assert steepest * 1e-3 <= float(known.error) <= 1.06 * steepest * 1e-3  # and a little beyond the ends


def walked(rounding: Rounding, function: ca.Function, held: list[Computed]) -> list[Computed]:
    """The first output of a graph of the operations alone."""
    slots: dict[int, Computed] = {}
    outputs = []
    for k in range(function.n_instructions()):
        op, take, give = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_INPUT:
            slots[give[0]] = held[take[1]]
        elif op == ca.OP_CONST:
            slots[give[0]] = rounding.constant(float(function.instruction_constant(k)))
        elif op == ca.OP_OUTPUT:
            outputs.append(slots[take[0]])
        else:
            slots[give[0]] = rounding.apply(op, [slots[i] for i in take])
    return outputs


@pytest.mark.parametrize(
    ("op", "held"),
    [
        (ca.OP_DIV, (ball(1, 2), ball(-1e-3, 1))),
        (ca.OP_SQRT, (ball(-1e-9, 1),)),
        (ca.OP_LOG, (ball(0, 1),)),
        (ca.OP_SIN, (ball(0, 300),)),
        (ca.OP_MUL, (ball(0, 1e30), ball(0, 1e30))),
        (ca.OP_EXP, (ball(0, 200),)),
        (ca.OP_FLOOR, (ball(0, 1),)),
        (ca.OP_TAN, (ball(1, 2),)),
    ],
)
def test_what_has_no_bound_is_not_bounded(op: int, held: tuple[Any, ...]) -> None:
    with pytest.raises(NoRoundingBound):
        Rounding("float").apply(op, [error_free(each) for each in held])


def test_a_square_of_numbers_about_zero_is_bounded_and_keeps_its_sign() -> None:
    square = Rounding("float").apply(ca.OP_SQ, [error_free(ball(-1, 1))])
    assert -1e-6 < square.value.lower() <= 0
    assert 1 <= square.value.upper() < 1 + 1e-6
    assert square.error < 2.0**-23


_AWAY = st.lists(st.floats(0.1, 1e3), min_size=3, max_size=3).map(sorted)  # a range without 0 and a number in it


@given(a=_AWAY, b=_AWAY, signs=st.tuples(*[st.sampled_from([-1, 1])] * 2))
def test_a_product_of_numbers_that_are_not_zero_is_not_zero(
    a: list[float], b: list[float], signs: tuple[int, int]
) -> None:
    wide = [error_free(ball(sign * low, sign * high)) for sign, (low, _, high) in zip(signs, (a, b), strict=True)]
    product = Rounding("float").apply(ca.OP_MUL, wide).value
    assert not product.contains(0)
    assert product.contains(signs[0] * arb(a[1]) * signs[1] * arb(b[1]))


def test_a_division_by_what_rounding_may_make_zero_is_not_bounded() -> None:
    divisor = Computed(ball(0.5, 1), arb(0.75))
    with pytest.raises(NoRoundingBound):
        Rounding("float").apply(ca.OP_DIV, [error_free(1), divisor])


def test_a_choice_that_rounding_may_turn_errs_by_what_is_between_its_branches() -> None:
    """Of what is the same in both, it does not turn."""
    rounding, x = Rounding("float"), error_free(ball(0, 1))

    def chosen(of: Computed) -> Computed:
        test = rounding.apply(ca.OP_LT, [of, error_free(0.5)])
        parts = [error_free(3), error_free(7)]
        tests = [test, rounding.apply(ca.OP_NOT, [test])]
        each = [rounding.apply(ca.OP_IF_ELSE_ZERO, list(pair)) for pair in zip(tests, parts, strict=True)]
        return rounding.apply(ca.OP_ADD, each)

    assert chosen(x).error == 0
    assert chosen(Computed(x.value, arb(1e-7))).error >= 4
    assert chosen(Computed(ball(0, 0.4), arb(1e-7))).error == 0


@pytest.mark.parametrize(("gap", "known"), [(0.5, None), (-0.5, None), (2, True), (-2, False)])
def test_a_comparison_that_errors_may_turn_is_not_known(gap: float, known: bool | None) -> None:
    """Both sides err by a half, and are one from each other where the errors meet."""
    held = [Computed(arb(value), arb(0.5)) for value in (0, gap)]
    for op in (ca.OP_LT, ca.OP_LE):
        assert Rounding("float").apply(op, held).known is known


def test_what_a_value_errs_by_is_rounded_as_well() -> None:
    """Of a sum that is 0 and may be computed as 1."""
    held = [Computed(arb(1), arb(0.5)), Computed(arb(-1), arb(0.5))]
    assert Rounding("float").apply(ca.OP_ADD, held).error >= 1 + arb(2) ** -24


def test_constants_are_held_as_the_program_holds_them() -> None:
    for real, bits in (("float", 24), ("double", 53)):
        rounding = Rounding(real)  # type: ignore[arg-type]
        assert rounding.constant(3.0).error == 0
        for value in (0.1, 1 / 3, 2e-4):
            error = float(rounding.constant(value).error)
            assert abs(float(TYPE[real](value)) - value) < error <= value * (2.0**-bits + 11 * 2.0**-53)  # type: ignore[index]


@pytest.mark.parametrize(
    ("op", "errors", "least"),
    [
        (ca.OP_ADD, (0.5, 0.25), 0.75),
        (ca.OP_SUB, (0.5, 0.25), 0.75),
        (ca.OP_MUL, (0.5, 0.0), 1.0),  # 3.5 2 - 3 2
        (ca.OP_MUL, (0.0, 0.25), 0.75),
        (ca.OP_MUL, (0.5, 0.25), 1.875),
        (ca.OP_DIV, (0.5, 0.0), 0.25),
        (ca.OP_DIV, (0.0, 0.25), 3 / 1.75 - 1.5),
        (ca.OP_FMIN, (0.5, 0.25), 0.25),
    ],
)
def test_what_both_operands_err_by_goes_on(op: int, errors: tuple[float, float], least: float) -> None:
    """Of 3 and 2."""
    held = [Computed(arb(value), arb(error)) for value, error in zip((3, 2), errors, strict=True)]
    assert float(Rounding("double").apply(op, held).error) >= least * (1 - 1e-12)


# --- one call


@cache
def step_of(name: str = "pendulum", observer: str = "high_gain", dt: float = 1e-3, method: str = "rk4") -> hg.Step:
    gains = load(MODELS / f"{name}.py").module.tuning[observer]
    form = hg.forms.triangular(model(name))
    return hg.sample(getattr(hg.observers, observer)(form, **gains), getattr(hg.methods, method), dt=dt)


@cache
def bounded(
    observer: str = "high_gain", dt: float = 1e-3, noise: float | None = None, real: Real | None = "float"
) -> hg.ErrorBound:
    """Of a step of a pendulum whose drive moves at up to 5."""
    return hg.error_bound(step_of("pendulum", observer, dt), noise=noise and {"y": noise}, rates={"tau": 5}, real=real)


def fields(step: hg.Step) -> list[str]:
    (part,) = step.observer.parts
    return [field.name for field in part.fields]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "observer", "dt", "method"),
    [
        ("pendulum", "high_gain", 1e-3, "rk4"),
        ("pendulum", "filtered", 1e-3, "euler"),
        ("pendulum", "peaking_free", 1e-3, "heun"),
        ("hyperjerk", "high_gain", 1e-6, "rk4"),
        ("hyperjerk", "low_power", 1e-2, "heun"),
    ],
)
def test_no_call_is_further_from_exact_arithmetic(name: str, observer: str, dt: float, method: str) -> None:
    """In floats beside doubles, from anywhere in the ranges and at their ends, where clamps act."""
    step = step_of(name, observer, dt, method)
    form, error = step.observer.form, step.observer.error
    assert isinstance(error, Inclusion)
    layout = error.layout
    ends = [form.states[i].interval if fed else (-0.1, 0.1) for i, fed in zip(layout.index, layout.fed, strict=True)]
    held = [ball(1.2 * low, 1.2 * high) for low, high in ends]
    y, u = form.states[0].interval, [each.interval for each in step.inputs]
    known = rounding_errors(step, "float", held, [ball(*y)], [ball(*each) for each in u])
    machines = [machine(step, real) for real in REALS]
    rng, worst = np.random.default_rng(2), np.zeros(len(held))
    for _ in range(60):
        start = [np.float32(rng.choice([rng.uniform(*each), *each]) * 1.19) for each in ends]
        samples = [np.array([[np.float32(rng.uniform(*y))]], float) for _ in range(2)]
        inputs = [np.array([[np.float32(rng.uniform(*each)) for each in u]], float) for _ in range(2)]
        after = []
        for each in machines:
            each.reset()
            each.record(inputs[0], samples[0])
            put = iter(start)
            for field in fields(step):
                memory = each.memory[Place("state", field)]
                memory[:] = [next(put) for _ in memory]
            each.record(inputs[1], samples[1])
            after.append(np.concatenate([each.memory[Place("state", field)].astype(float) for field in fields(step)]))
        worst = np.maximum(worst, np.abs(after[0] - after[1]))
    bounds = np.array([float(each) for each in known])
    assert (worst <= bounds).all()
    assert (worst > bounds / 40).all()


@pytest.mark.parametrize("observer", ["high_gain", "filtered", "low_power"])
def test_a_fields_own_error_is_that_of_the_proof(observer: str) -> None:
    """Of x1' = 3 x2, x2' = 2 x3, x3' = 0: fields of a chain of integrators are in other units than the plant."""
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in range(1, 4)]
    flow = [3 * x[1], 2 * x[2], 0]
    plant = hg.System("units", states=x, outputs=(hg.Signal("y"),), flow=flow, output=[x[0]])
    options: dict[str, Any] = {
        "high_gain": {"poles": (-1, -1, -1)},
        "filtered": {"poles": (-1, -1, -1), "alpha": 10, "beta": 10},
        "low_power": {"gains": [[3, 2], [1, 1]]},
    }[observer]
    made = getattr(hg.observers, observer)(hg.forms.triangular(plant), theta=4, **options)
    error = made.error
    assert isinstance(error, Inclusion)
    assert error.chained is (observer != "high_gain")
    step, h = hg.sample(made, hg.methods.rk4, dt=0.01), Fraction(0.01)
    known = hg.methods.rk4.error_step(h, error.at(Fraction(4)))
    remembered = error.remembered(Fraction(4))
    assert remembered is not None
    e, n = np.array(remembered, dtype=float), len(remembered)
    Phi = np.eye(n) + float(h) * floats(known.D)[:, :n]
    runs = []
    for shift in [None, *range(n)]:
        each = machine(step, "double")
        each.record(np.zeros((1, 0)), np.zeros((1, 1)))
        at = 0
        for field in fields(step):
            memory = each.memory[Place("state", field)]
            memory[:] = [1e-3 * (at + k == shift) for k in range(len(memory))]
            at += len(memory)
        each.record(np.zeros((1, 0)), np.zeros((1, 1)))
        runs.append(np.concatenate([each.memory[Place("state", field)] for field in fields(step)]))
    moved = (np.array(runs[1:]) - runs[0]).T / 1e-3
    np.testing.assert_allclose(e[:, None] * moved / e, Phi, atol=1e-9)


# --- the share


@pytest.mark.ordinary("0.001-5-3.0", "0.02-60-3.0")
@pytest.mark.parametrize(("dt", "seconds", "swing"), [(1e-3, 5, 0.0), (1e-3, 5, 3.0), (0.02, 60, 3.0)])
def test_no_run_in_floats_is_further_from_one_in_doubles(dt: float, seconds: float, swing: float) -> None:
    """Of samples that rest, where roundings go on in one direction, the worst is within 6 times of the bound."""
    step, known = step_of(dt=dt), bounded(dt=dt)
    assert known.settles is not None
    count = round(seconds / dt)
    t = np.arange(count) * dt
    samples = np.float32(3.3 if not swing else swing * np.cos(4.4 * t))
    samples, inputs = np.broadcast_to(samples, count)[:, None].astype(float), np.zeros((count, 1))
    seen = []
    for real in REALS:
        each, states = machine(step, real), []
        for k in range(count):
            each.record(inputs[k : k + 1], samples[k : k + 1])
            states.append(each.memory[Place("state", "z")].astype(float).copy())
        seen.append(np.array(states))
    worst = np.abs(seen[0] - seen[1])[round(known.settles / dt) :].max(axis=0)
    bounds = np.array([known.shares["rounding"][name] for name in ("q", "w")])
    assert (worst <= bounds).all()
    assert swing or worst[1] > bounds[1] / 6


@pytest.mark.ordinary("high_gain-0.02", "filtered-0.01")
@pytest.mark.parametrize(("observer", "dt"), [("high_gain", 1e-3), ("high_gain", 0.02), ("filtered", 0.01)])
def test_errors_that_push_one_way_come_close_to_the_share(observer: str, dt: float) -> None:
    """Added to the fields of a run in doubles after each call, by the sign of the response to one."""
    step, known = step_of("pendulum", observer, dt), bounded(observer, dt)
    (proof,) = known.check.proofs
    (one,) = (each for each in proof.fact.facts["shares"] if each.what == "rounding")  # type: ignore[union-attr]
    error = step.observer.error
    assert isinstance(error, Inclusion)
    remembered = np.array(error.remembered(Fraction(20)), dtype=float)
    rho, count = dt * np.array(one.sizes.fields, dtype=float) / remembered, round(6 / dt)

    def run(pushes: np.ndarray) -> np.ndarray:
        each, states = machine(step, "double"), []
        for push in pushes:
            each.record(np.zeros((1, 1)), np.zeros((1, 1)))
            for field in fields(step):
                memory = each.memory[Place("state", field)]
                memory += push[: len(memory)]
                push = push[len(memory) :]
            states.append(np.concatenate([each.memory[Place("state", field)] for field in fields(step)]))
        return np.array(states)

    response = [run(np.eye(len(rho))[k] * rho[k] * (np.arange(count) == 1)[:, None])[1:] for k in range(len(rho))]
    for state in range(2):
        signs = np.array([np.sign(each[::-1, state]) for each in response]).T
        worst = np.abs(run(signs * rho)[:, state]).max()
        bound = known.shares["rounding"][("q", "w")[state]]
        assert bound / 4 < worst <= bound


@pytest.mark.full
def test_rounding_is_a_share_of_its_own_that_grows_with_the_unit_and_with_short_steps() -> None:
    plain, single, double = (bounded(noise=1e-3, real=real) for real in (None, *REALS))
    short = bounded(dt=1e-6, noise=1e-3)
    assert list(single.shares) == ["noise", "method", "rounding"]
    assert "rounding" not in plain.shares
    for name, bound in single.bounds.items():
        assert bound == pytest.approx(plain.bounds[name] + single.shares["rounding"][name], rel=1e-6)
        ratio = single.shares["rounding"][name] / double.shares["rounding"][name]
        assert 2**26 < ratio < 2**30
        assert short.shares["rounding"][name] > short.shares["noise"][name]  # which is most of what is rounded there
    assert ", rounding " in str(single.check.reason)
    assert plain.settles is not None
    assert single.settles is not None
    assert single.settles > plain.settles


@pytest.mark.full
def test_a_plant_that_its_observer_repeats_exactly_errs_by_rounding_alone() -> None:
    x = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2)]
    plant = hg.System("double", states=x, outputs=(hg.Signal("y"),), flow=[x[1], 0], output=[x[0]])
    made = hg.observers.high_gain(hg.forms.triangular(plant), theta=8, poles=(-1, -1.2))
    known = hg.error_bound(hg.sample(made, hg.methods.rk4, dt=0.01), real="float")
    assert list(known.shares) == ["rounding"]
    assert known.settles is not None
    assert all(0 < bound < 1e-3 for bound in known.bounds.values())


def test_a_plant_and_its_mirror_image_round_alike() -> None:
    """Beyond the end of the ranges that is far from 0, where an error takes the estimate, either way."""

    def share(low: float, high: float) -> float:
        x = [hg.Signal(f"x{i}", low=low, high=high) for i in (1, 2)]
        plant = hg.System("double", states=x, outputs=(hg.Signal("y"),), flow=[x[1], 0], output=[x[0]])
        made = hg.observers.high_gain(hg.forms.triangular(plant), theta=1, poles=(-1, -1.2))
        known = hg.error_bound(hg.sample(made, hg.methods.rk4, dt=0.01), noise={"y": 4}, real="float")
        return known.shares["rounding"]["x1"]

    assert share(-30, -10) == pytest.approx(share(10, 30), rel=1e-3)


@pytest.mark.full
def test_rounding_leaves_less_room_for_first_errors() -> None:
    """Beside what inputs do, what is rounded while the first error decays moves the estimate towards its limits."""
    exact, single = (
        hg.error_bound(step_of(), noise={"y": 1e-3}, rates={"tau": 5}, real=real) for real in (None, "float")
    )
    assert single.multiple is not None
    assert exact.multiple is not None
    assert single.multiple < exact.multiple


def test_from_larger_first_errors_more_is_rounded_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """The share in the end is all but the same."""
    taken = list[Any]()

    def share(*arguments: Any) -> rounding_share.RoundingShare:
        taken.extend(arguments)
        return rounding_share.rounding_share(*arguments)

    monkeypatch.setattr("hgogen.certificates.error_bound.rounding_share", share)
    hg.error_bound(step_of(), noise={"y": 1e-3}, rates={"tau": 5}, real="float")
    before, multiple, after = taken[:4], taken[4], taken[5:]
    small, large = (rounding_share.rounding_share(*before, multiple * k, *after) for k in (Fraction(1, 1000), 1))
    assert all(large.early[k] > Fraction(6, 5) * small.early[k] for k in small.early)
    assert small.share.unit <= large.share.unit < Fraction(6, 5) * small.share.unit


def near_zero(low: float) -> hg.Step:
    """x1' = x2, x2' = -x1/(x1 - low), x1 from 1 on."""
    x1, x2 = hg.Signal("x1", low=1, high=2), hg.Signal("x2", low=-1, high=1)
    plant = hg.System("pole", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, -x1 / (x1 - low)], output=[x1])
    made = hg.observers.high_gain(hg.forms.triangular(plant), theta=40, poles=(-1, -1))
    return hg.sample(made, hg.methods.rk4, dt=1e-3)


@pytest.mark.full
def test_a_division_near_zero_rounds_more_and_one_by_what_rounding_may_reach_is_not_known() -> None:
    far, close = (hg.error_bound(near_zero(low), real="float") for low in (0.0, 0.9))
    assert close.shares["rounding"]["x2"] > far.shares["rounding"]["x2"]
    none = hg.error_bound(near_zero(1 - 1e-9), real="float")
    assert none.check.verdict is Verdict.UNKNOWN


def test_what_is_not_followed_is_said() -> None:
    x1, x2 = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)
    curve = hg.table(x1, [-2, 0, 2], [1, 0, -1], name="curve")
    plant = hg.System("bent", states=(x1, x2), outputs=(hg.Signal("y"),), flow=[x2, curve], output=[x1])
    made = hg.observers.high_gain(hg.forms.triangular(plant), theta=10, poles=(-1, -1))
    step = hg.sample(made, hg.methods.euler, dt=1e-3)
    with pytest.raises(NoRoundingBound, match="a table"):
        rounding_errors(step, "float", [ball(-1, 1)] * 2, [ball(-1, 1)], [])


def test_samples_are_those_of_the_piece_in_which_the_plant_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reaches as far as the plant moves in a call, and as samples err; together the pieces are the whole range."""
    seen = []

    def asked(step: hg.Step, real: Real, held: Any, y: Any, u: Any) -> list[Any]:
        seen.append((held[0], y[0]))
        return rounding_errors(step, real, held, y, u)

    monkeypatch.setattr(rounding_share, "rounding_errors", asked)
    assert hg.error_bound(step_of(), noise={"y": 1e-3}, rates={"tau": 5}, real="float").bounds
    pieces = seen[: rounding_share._PIECES]
    assert len(pieces) == 32
    assert float(pieces[0][0].lower()) < -4
    assert float(pieces[-1][0].upper()) > 4
    for (z, y), (after, _) in pairwise(pieces):
        assert z.overlaps(after)
        assert float(y.rad()) == pytest.approx(8 / 64 + 20 * 1e-3 + 1e-3, rel=1e-3)
        assert float(y.mid()) == pytest.approx(float(z.mid()), abs=1e-6)


@pytest.mark.full
def test_an_injection_that_is_small_rounds_little() -> None:
    """A filter would round as much as the state is large, were samples anywhere in their range."""
    known = bounded("filtered")
    assert known.shares["rounding"]["q"] < 2e-4
    assert known.shares["rounding"]["w"] < 2e-3


def test_a_gain_that_is_no_number_of_the_precision_is_rounded() -> None:
    def errors(theta: float) -> list[float]:
        x = [hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2)]
        plant = hg.System("double", states=x, outputs=(hg.Signal("y"),), flow=[x[1], 0], output=[x[0]])
        made = hg.observers.high_gain(hg.forms.triangular(plant), theta=theta, poles=(-1, -1))
        step = hg.sample(made, hg.methods.euler, dt=1 / 16)
        return [float(each) for each in rounding_errors(step, "float", [ball(-1, 1)] * 2, [ball(-1, 1)], [])]

    for exact, more in zip(errors(2), errors(2 + 1e-9), strict=True):
        assert more > 1.01 * exact


def test_what_grows_with_itself_has_no_bound() -> None:
    assert rounding_share._fixed_point(lambda r: Fraction(1, 2) + r / 2) == 1
    r = rounding_share._fixed_point(lambda r: 3 + r / 2)
    assert 3 + r / 2 <= r < 20
    with pytest.raises(Unbounded):
        rounding_share._fixed_point(lambda r: 1 + r)


def test_rounding_at_first_is_within_a_twentieth_after_its_calls() -> None:
    """|e|_P^2 - 1, at first ratio^2 - 1, falls to 1 - a of itself at each call."""
    for ratio, falls in ((1.0, 0.1), (1.05, 0.1), (3.0, 0.01), (50.0, 1e-4)):
        calls = rounding_share._calls(ratio, falls)
        assert math.sqrt(1 + (ratio**2 - 1) * (1 - falls) ** calls) <= 1.05 * (1 + 1e-9)
        assert not calls or math.sqrt(1 + (ratio**2 - 1) * (1 - falls) ** (calls - 2)) > 1.05


# --- certificates


@cache
def certified(observer: str) -> dict[str, Any]:
    made = step_of("pendulum", observer).observer
    return hg.certificate(made.form, (*made.checks, bounded(observer, noise=1e-3).check), observer)


def verdict(content: dict[str, Any]) -> str:
    (row,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".error"))
    return row.found


def rounded(content: dict[str, Any]) -> dict[str, Any]:
    (one,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    (share,) = (each for each in one["shares"] if each["inputs"] == "rounding")
    return share


def less(text: str, by: Fraction = Fraction(9, 10)) -> str:
    return str(Fraction(text) * by)


FORGED: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "a bound": lambda share: {"bounds": [{**share["bounds"][0], "bound": less(share["bounds"][0]["bound"])}]},
    "a larger size": lambda share: {"fields": [less(each, Fraction(2)) for each in share["fields"]]},
    "a unit": lambda share: {"unit": less(share["unit"])},
    "no fields": lambda share: {"fields": []},
    "a negative size": lambda share: {"fields": [f"-{each}" for each in share["fields"]]},
    "too many": lambda share: {"fields": [*share["fields"], "1"]},
}


@pytest.mark.full
@pytest.mark.parametrize("observer", ["high_gain", "filtered"])
def test_the_share_is_verified_again(observer: str) -> None:
    content = certified(observer)
    assert verdict(content) == "verified"
    share = rounded(content)
    assert len(share["fields"]) == (2 if observer == "high_gain" else 4)


@pytest.mark.parametrize("lie", FORGED)
def test_a_forged_number_fails(lie: str) -> None:
    content = copy.deepcopy(certified("high_gain"))
    share = rounded(content)
    changed = FORGED[lie](share)
    if "bounds" in changed:
        changed["bounds"] += share["bounds"][1:]
    share |= changed
    assert verdict(content) == "fails"


def test_in_a_call_the_plant_moves_by_its_speed_and_by_all_that_is_beside_a_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So far a sample may be from where the plant was at the beginning."""
    moves, content, made = list[Any](), certified("high_gain"), recheck_rounding.Rounded

    def spied(*arguments: Any) -> Any:
        moves.append(arguments[-1])
        return made(*arguments)

    monkeypatch.setattr(recheck_rounding, "Rounded", spied)
    assert {row.found for row in recheck.__wrapped__(sealed(content)).rows if row.id.endswith(".error")} == {"verified"}
    (evidence,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    beside = [[Fraction(x) for x in share["beside"]] for share in evidence["shares"] if share["beside"]]
    speeds = [Fraction(x) for x in rounded(content)["follows"]["speeds"]]
    assert any(map(any, beside))
    assert moves == [
        [Fraction(evidence["dt"]) * (x + sum(each)) for x, *each in zip(speeds, *beside, strict=True)],
    ]


@pytest.mark.parametrize("size", ["-1/2", "-2"])
def test_a_size_is_not_negative(size: str) -> None:
    """Whatever else such a share says that does not follow."""
    with pytest.raises(Unproved, match="a size of its fields is negative"):
        _sizes({"fields": ["0", size]}, "fields", 2)
    assert _sizes({"fields": ["0", "1/2"]}, "fields", 2) == [0, Fraction(1, 2)]


def larger(share: dict[str, Any], by: int = 100) -> None:
    """The share with more rounding than there is, by which its proofs hold as before."""
    for holder, key in ((share, "unit"), *((one, "bound") for one in share["bounds"])):
        holder[key] = less(holder[key], Fraction(by))
    for holder, key in ((share, "fields"), (share["follows"], "within")):
        holder[key] = [less(each, Fraction(by)) for each in holder[key]]


def run_on(follows: dict[str, Any], *texts: str, field: int = 1) -> None:
    """Statements of what is after the call in a field, "v", each of the one before: its program as it goes on."""
    for text in texts:
        follows["program"].append(re.sub(r"\bv\b", follows["after"][field], text))
        follows["after"][field] = f"v{len(follows['program'])}"


def one_for_both(follows: dict[str, Any]) -> None:
    run_on(follows, "mul v 1000000001/1000000000")
    follows["after"][0] = follows["after"][1]


def infinite(follows: dict[str, Any]) -> None:
    follows["program"].append(f"div {10**200} {10**200}")
    run_on(follows, f"mul v v{len(follows['program'])}")


def held(follows: dict[str, Any]) -> None:
    follows["between"] = "hold"
    follows["program"] = [text.replace("u1_last", "u1") for text in follows["program"]]


OTHER_PROGRAMS: dict[str, Callable[[dict[str, Any]], None]] = {
    "one statement after both fields": one_for_both,
    "doublings that overflow": lambda follows: run_on(follows, *["mul 2 v"] * 130, f"div v {2**100}", f"div v {2**30}"),
    "numbers that overflow": infinite,
    "inputs that move and are held": held,
    "a statement of nothing": lambda follows: follows["program"].append(""),
    "functions in each other": lambda follows: run_on(follows, *["sin v"] * 300),
    "functions that are read twice": lambda follows: run_on(follows, *["add v 1", "square v", "tanh v"] * 60),
    "too many functions": lambda follows: follows["program"].extend(["sin x1"] * 5000),
}


@pytest.mark.ordinary("inputs that move and are held", "a statement of nothing")
@pytest.mark.parametrize("program", [None, *OTHER_PROGRAMS])
def test_another_program_fails_however_much_it_may_round(program: str | None) -> None:
    content = copy.deepcopy(certified("high_gain"))
    larger(rounded(content))
    if program:
        OTHER_PROGRAMS[program](rounded(content)["follows"])
    assert verdict(content) == ("fails" if program else "verified")


@pytest.mark.parametrize("kind", ["rounding", "method"])
@pytest.mark.parametrize("follows", [None, [], "program", 7])
def test_what_sizes_follow_from_is_an_object(kind: str, follows: Any) -> None:
    content = copy.deepcopy(certified("high_gain"))
    (one,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    (share,) = (each for each in one["shares"] if each["inputs"] == kind)
    share["follows"] = follows
    assert verdict(content) == "fails"


def verdict_of(states: Sequence[hg.Signal], flow: Sequence[Any], output: Any, observer: str, **gains: Any) -> str:
    """Of a step of Euler's method in floats."""
    plant = hg.System("own", states=states, outputs=(hg.Signal("y"),), flow=flow, output=[output])
    form = hg.forms.triangular(plant)
    made = getattr(hg.observers, observer)(form, theta=7.3, **gains)
    known = hg.error_bound(hg.sample(made, hg.methods.euler, dt=0.0123), real="float")
    return verdict(hg.certificate(form, (*made.checks, known.check), made.name))


@pytest.mark.full
def test_a_cube_of_a_wide_range_may_be_divided_by() -> None:
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    flow = [v, -v - x + 1 / (sp.Rational(33, 10) + x) ** 3]
    assert verdict_of((x, v), flow, x, "high_gain", poles=(-1.37, -0.61)) == "verified"


@pytest.mark.full
def test_a_number_of_the_plant_is_listed_as_it_stands_there() -> None:
    """x/1.3, whose 0.7692307692307692 is also almost 10/13."""
    x, v = hg.Signal("x", low=-2, high=2), hg.Signal("v", low=-2, high=2)
    assert verdict_of((x, v), [v, -sp.sin(x / 1.3)], x, "high_gain", poles=(-1.37, -0.61)) == "verified"


@pytest.mark.full
def test_of_two_numbers_that_are_all_but_the_same_the_nearest_is_listed() -> None:
    """The ends of the ranges are 1 and 0.9999999999999998 in the units of the fields."""
    x, v = hg.Signal("x", low=-0.7, high=0.7), hg.Signal("v", low=-2.0999999999999996, high=2.0999999999999996)
    assert verdict_of((x, v), [v / 3, -sp.sin(x) / 10], x * sp.Rational(10, 7), "peaking_free") == "verified"


# --- how it is asked for


def test_no_other_precision_is_known() -> None:
    with pytest.raises(BadStep, match="real = 'half'"):
        hg.error_bound(step_of(), real="half")  # type: ignore[arg-type]


def test_a_model_says_in_which_precision_it_runs(tmp_path: Path) -> None:
    path = tmp_path / "swing.toml"
    text = (MODELS / "van_der_pol.toml").read_text()
    path.write_text(f'{text}\n[bounds]\nreal = "float"\n')
    assert load(path).bounds == Bounds({"real": "float"}, False)
    path.write_text(f'{text}\n[bounds]\nreal = "half"\n')
    with pytest.raises(MissingPart, match="real a precision"):
        _ = load(path).bounds
