"""Generic observability: series against symbolic Lie derivatives, ranks against Kalman's, known answers, bad input."""

import json
import math
import os
import random
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import flint
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import observability as oracle

from hgogen.rigor.rank import Model, NothingMeasured, NowhereDefined, Ranks
from hgogen.rigor.rank import observability as ranks
from hgogen.rigor.series import BallSeries, ModularSeries, Plant, gradients, random_point
from hgogen.rigor.tape import NoTape, tape

PRIME = 2**61 - 1
x1, x2, x3, k, u = sp.symbols("x1 x2 x3 k u")
JETS = sp.symbols("u0:8")


def observability(*equations: Any, limit: int | None = None) -> Ranks:
    return ranks(Model(*equations), limit=limit)


def lie_gradients(flow, output, states, unknowns, count):
    """Gradients of y, y', .. as symbols of states, parameters and the input's derivatives; over i!."""
    rate = [f.subs(u, JETS[0]) for f in flow]
    y = output.subs(u, JETS[0])
    for i in range(count):
        yield [sp.diff(y, v) / math.factorial(i) for v in unknowns]
        rates = (*zip(states, rate, strict=True), *pairwise(JETS))
        y = sum((y.diff(variable) * slope for variable, slope in rates), sp.S.Zero)


def first(plant, numbers, count):
    rows = []
    for matrices in gradients(plant, numbers, random_point(plant, numbers)):
        rows += [matrix.entries() for matrix in matrices]
        if len(rows) >= count:
            return rows[:count]
    raise AssertionError


@pytest.mark.full
def test_series_modulo_a_prime_are_the_lie_derivatives() -> None:
    """With an input, whose derivatives enter, and a division."""
    flow, output = [x2 * u + x1**2, x3 / (1 + x1) + k * x1, x1 * x2 - k * x3], x1 * u - x2
    plant = Plant(tape([*flow, output], [x1, x2, x3, u, k]), 3, 1, 1)
    numbers = ModularSeries(PRIME, PRIME, 3)
    point = random_point(plant, numbers)
    values = dict(zip((x1, x2, x3, k), (*point.states, *point.constants), strict=True))
    values |= {jet: c * math.factorial(i) for i, (jet, c) in enumerate(zip(JETS, point.inputs(0, 8), strict=True))}

    def residue(expression: sp.Expr) -> int:
        value = sp.Rational(expression.xreplace({s: sp.Integer(c) for s, c in values.items()}))
        return int(value.p) * pow(int(value.q), -1, PRIME) % PRIME

    expected = lie_gradients(flow, output, (x1, x2, x3), (x1, x2, x3, k), 6)
    for row, symbolic in zip(first(plant, numbers, 6), expected, strict=True):
        assert [int(c) for c in row] == [residue(e) for e in symbolic]


FUNCTIONS = [
    *(sp.exp, sp.log, sp.sin, sp.cos, sp.tan, sp.atan, sp.sinh, sp.cosh, sp.tanh, sp.asinh, sp.sqrt, sp.Abs),
    *(lambda x: sp.asin(x / 4), lambda x: sp.acos(x / 4), lambda x: sp.atanh(x / 4), lambda x: sp.acosh(x + 1)),
    *(lambda x: x**k, lambda x: k**x, lambda x: sp.atan2(x, k), lambda x: x ** sp.Rational(5, 3), lambda x: x**-2),
    *(lambda x: sp.Max(x, -1), lambda x: sp.Min(x, -1) + x, lambda x: sp.Piecewise((x**2, x > 0), (sp.sin(x), True))),
    *(lambda x: sp.sign(x) * x, lambda x: sp.Heaviside(x) * x, lambda x: x ** sp.Rational(-3, 2) + sp.pi * x),
]


@pytest.mark.ordinary("Max(-1, x1)", "x1*sign(x1)", "x1*Heaviside(x1)")
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: str(f(x1)))
def test_series_with_balls_are_the_lie_derivatives(function) -> None:
    """Each function's value, slope and series, to 40 digits."""
    x1, x2, k = sp.symbols("x1 x2 k", positive=True)
    flow, output = [x2 * u + x1, function(x1).subs(sp.Symbol("k"), k) * x2 / 4], function(x1).subs(sp.Symbol("k"), k)
    plant = Plant(tape([*flow, output], [x1, x2, u, k]), 2, 1, 1)
    numbers = BallSeries(0)  # draws from (1/2, 2)
    flint.ctx.prec, flint.ctx.cap = 256, 100
    try:
        point = random_point(plant, numbers)
        exact = [*point.states, *point.constants, *(c * math.factorial(i) for i, c in enumerate(point.inputs(0, 8)))]
        rows = [[sp.Float(entry.mid().str(60, radius=False), 60) for entry in row] for row in first(plant, numbers, 4)]
        numbers_at = [sp.Float(value.mid().str(60, radius=False), 60) for value in exact]
    finally:
        flint.ctx.prec, flint.ctx.cap = 53, 10
    values = dict(zip((x1, x2, k, *JETS), numbers_at, strict=True))
    for row, symbolic in zip(rows, lie_gradients(flow, output, (x1, x2), (x1, x2, k), 4), strict=True):
        for entry, expression in zip(row, symbolic, strict=True):
            assert abs(entry - expression.doit().subs(values).doit().evalf(60)) < 1e-40 * (1 + abs(entry))


# --- ranks --------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 5), p=st.integers(1, 2), density=st.floats(0.2, 0.9), seed=st.integers(0, 10**6))
def test_linear_systems_have_kalmans_rank(n: int, p: int, density: float, seed: int) -> None:
    draw = random.Random(seed)

    def entry(*_: int) -> int:
        return draw.randint(-3, 3) if draw.random() < density else 0

    A, C = sp.Matrix(n, n, entry), sp.Matrix(p, n, entry)
    states = sp.symbols(f"x0:{n}")
    x = sp.Matrix(states)
    whole = sp.Matrix.vstack(*(C * A**i for i in range(n)))
    answer = observability(A * x, C * x, states).known
    assert answer.rank == whole.rank()
    kernel = whole.nullspace()
    assert answer.observable == tuple(s for i, s in enumerate(states) if all(v[i] == 0 for v in kernel))
    order = next(i for i in range(n) if sp.Matrix.vstack(*(C * A**j for j in range(i + 1))).rank() == whole.rank())
    assert answer.order == order


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), curved=st.booleans())
def test_scrambled_states_leave_the_answer(seed: int, curved: bool) -> None:
    """Another order, other scales, other names."""
    draw = random.Random(seed)
    n = draw.randint(2, 4)
    states, new = sp.symbols(f"x0:{n}"), sp.symbols(f"w0:{n}")
    bend = sp.sin if curved else (lambda e: e**2)

    def pick() -> sp.Symbol:
        return draw.choice(states)

    flow = [draw.randint(-2, 2) * pick() + draw.choice((0, 1)) * bend(pick()) * pick() for _ in states]
    output = [pick() + draw.choice((0, 1)) * pick() * pick()]
    order = draw.sample(range(n), n)
    scales = [sp.Rational(draw.choice((-1, 1)) * draw.randint(1, 5), draw.randint(1, 5)) for _ in states]
    old = {states[j]: new[i] / scales[i] for i, j in enumerate(order)}
    moved = [scales[i] * sp.sympify(flow[j]).subs(old, simultaneous=True) for i, j in enumerate(order)]
    a = observability(flow, output, states).known
    b = observability(moved, [output[0].subs(old, simultaneous=True)], new).known
    assert (a.rank, a.order) == (b.rank, b.order)
    assert {new[order.index(states.index(s))] for s in a.observable} == set(b.observable)


def test_an_input_that_excites_and_one_that_does_not() -> None:
    """x1' = x2 u shows x2 through u; parameters scale: k x2 is seen, k and x2 are not."""
    assert observability([x2 * u, 0], [x1], [x1, x2], [u]).known.rank == 2
    joint = observability([k * x2, -x2], [x1], [x1, x2], [], [k])
    assert (joint.known.rank, joint.joint.rank) == (2, 2)
    assert joint.joint.observable == (x1,)
    assert joint.joint.unobservable == (x2, k)


def test_balls_find_the_deficiency_of_dependent_exponentials() -> None:
    """exp(x1) exp(x2) = exp(x1 + x2): only the sum is seen; with sin as well."""
    same = observability([0, 0], [sp.exp(x1) * sp.exp(x2), sp.exp(2 * (x1 + x2))], [x1, x2])
    assert (same.known.rank, same.known.observable) == (1, ())
    identity = observability([0, 0], [sp.sin(x1) ** 2 + sp.cos(x1) ** 2 + x2], [x1, x2])
    assert (identity.known.rank, identity.known.observable) == (1, (x2,))
    tiny = sp.sin(x1) ** 2 + sp.cos(x1) ** 2 + x2 / sp.Integer(10) ** 90  # what is small is not zero
    assert observability([0, 0], [tiny], [x1, x2]).known.observable == (x2,)
    assert observability([sp.sin(x2), 0], [x1], [x1, x2]).known.rank == 2
    assert observability([k * sp.sqrt(x1) - x1**k, 0], [x1], [x1, x2], [], [k]).joint.observable == (x1, k)


def test_the_limit_gives_a_partial_answer() -> None:
    chain = sp.symbols("c1:7")
    flow = [*chain[1:], 0]
    part = observability(flow, [chain[0]], chain, limit=2).known
    assert not part.final
    assert part.observable == chain[:3]
    assert part.rank == 3
    assert observability(flow, [chain[0]], chain).known.observable == chain


# --- the library, by two methods that share no code -----------------------------------------------------------

DATA = Path(os.environ.get("HGOGEN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
LIBRARY = DATA / "observability_models.json"
here = pytest.mark.skipif(not LIBRARY.exists(), reason="no observability_models.json; set HGOGEN_DATA")


def library() -> list[tuple[str, tuple]]:
    return [(model["name"], oracle.parse(model)) for model in json.loads(LIBRARY.read_text())["models"]]


@here
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.slow) for part in (1, 2, 3))])
def test_two_methods_agree_on_the_whole_library(part: int) -> None:
    """Both questions, none missing: rank, order of derivatives, and which are observable one by one."""
    models = json.loads(LIBRARY.read_text())["models"]
    assert len(models) == 341
    for model in models[part::4]:
        name, (flow, output, states, inputs, parameters) = model["name"], oracle.parse(model)
        ours = observability(flow, output, states, inputs, parameters)
        theirs = oracle.observability(flow, output, states, inputs, parameters)
        for rank, expected in zip((ours.known, ours.joint), theirs, strict=True):
            assert rank.final
            assert (rank.rank, rank.order, [s.name for s in rank.observable]) == expected, name


def test_the_oracle_shares_nothing_and_refuses_what_it_cannot_do() -> None:
    """Exponentials of dependent terms are no independent generators; terms that expand to each other are found."""
    text = Path(oracle.__file__).read_text()
    assert "import hgogen" not in text
    assert "from hgogen" not in text
    with pytest.raises(oracle.Dependent):
        oracle.observability([0, 0], [sp.exp(x1 / (1 + x2)) * sp.exp(x1 * x2 / (1 + x2)) - sp.exp(x1)], [x1, x2])
    known, _ = oracle.observability([0, 0], [sp.exp(x1 + x2) + sp.exp(2 * x1) * sp.exp(2 * x2)], [x1, x2])
    assert known == (1, 0, [])


@here
@pytest.mark.slow
def test_the_library_is_quick() -> None:
    """Median 20 ms, slowest 3 s, all in 60 s, with a margin of four for a busy machine; both methods."""
    models = library()
    for method in (observability, oracle.observability):
        times = []
        for _, model in models:
            start = time.process_time()
            method(*model)
            times.append(time.process_time() - start)
        print(
            f"{method.__module__}: median {np.median(times):.4f} s, slowest {max(times):.2f} s, all {sum(times):.1f} s"
        )
        assert np.median(times) < 4 * 0.020
        assert max(times) < 4 * 3
        assert sum(times) < 60


# --- bad input ----------------------------------------------------------------------------------------------


def test_branches_are_local() -> None:
    answer = observability([sp.Abs(x2), 0], [sp.Piecewise((x1, x1 > 0), (x2, True))], [x1, x2])
    assert answer.local == "abs, piecewise"
    assert observability([x2, 0], [x1], [x1, x2]).local == ""
    half = observability([sp.Max(x2, 0), 0], [x1], [x1, x2])  # x2 < 0 is not seen
    assert half.known.observable == (x1,)
    assert half.known.unobservable == (x2,)


def test_bad_input_is_a_sentence() -> None:
    with pytest.raises(NothingMeasured, match="no outputs"):
        observability([x1], [], [x1])
    with pytest.raises(NothingMeasured, match="no states"):
        observability([], [x1], [])
    with pytest.raises(NowhereDefined, match="division by zero"):
        observability([x1], [1 / sp.Add(x1, -x1 * x2 / x2, evaluate=False)], [x1, x2][:1], [x2])
    with pytest.raises(NowhereDefined, match="logarithm"):
        observability([x1], [sp.log(-(x1**2) - 1)], [x1])
    with pytest.raises(NoTape, match="gamma"):
        observability([x1], [sp.gamma(x1)], [x1])
