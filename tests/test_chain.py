"""The forced order of chains: found after terms cancel, refused with the reason, and never by trying permutations."""

import random
import time
from itertools import permutations
from typing import Any

import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.analysis.chain import Chains, Rows, Shape, cascade, end_aligned, levelwise
from tests.sweep import sweep

x = sp.symbols("x1:13")
X1, X2, X3, X4, X5, X6 = x[:6]
u, k = sp.symbols("u k")


def rows(flow: list[Any], output: Any = X1, **ranges: tuple[Any, Any]) -> Rows:
    outputs = tuple(map(sp.sympify, output if isinstance(output, list) else [output]))
    names = ("y",) if len(outputs) == 1 else tuple(f"y{i}" for i in range(1, len(outputs) + 1))
    box = {sp.Symbol(name): ends for name, ends in ranges.items()}
    return Rows(tuple(x[: len(flow)]), tuple(map(sp.sympify, flow)), names, outputs, box)


def answers(chains: Chains) -> tuple[bool | None, ...]:
    """For gains of inputs and parameters, also of z_1, any."""
    return tuple(chains.answer(shape)[0] for shape in Shape)


# One output


@pytest.mark.parametrize(
    ("flow", "output", "expected"),
    [
        ([X2, X3, 0], X1, (True, True, True)),
        ([u * k * X2 + X1**2, sp.exp(u) * X3 + X1 * X2, X1 * X2 * X3], 2 * X1, (True, True, True)),
        ([X2 * (2 + X1), X3 * X1 + X2, 0], X1, (False, True, True)),
        ([X2 * (2 + X1), X3 * X2, 0], X1, (False, False, True)),
        ([X2 + X2**3, X3, 0], X1, (False, False, True)),
        ([X2, 0], sp.sin(X1), (False, False, True)),
        ([X2, 0], u * X1, (True, True, True)),
        ([sp.exp(X1 + X2), 0], X1, (False, False, True)),
        ([X2 + X3, X3, 0], X1, (False, False, False)),
        ([X2, X1, X3], X1, (False, False, False)),
        ([X2, 0], X1 * X2, (False, False, False)),
        ([0, X1], X1, (False, False, False)),
        ([sp.sign(X2), 0], X1, (False, False, None)),
        ([sp.Function("f")(X2), 0], X1, (None, None, None)),
    ],
)
def test_one_output(flow: list[sp.Expr], output: sp.Expr, expected: tuple[bool | None, ...]) -> None:
    assert answers(levelwise(rows(flow, output))) == expected


@pytest.mark.parametrize(
    "hidden",
    [
        sp.sin(X3) ** 2 + sp.cos(X3) ** 2,
        (X3**2 - X2**2) / (X3 - X2) - X3 - X2,
        sp.exp(X3 + X4) / sp.exp(X3) - sp.exp(X4),
        sp.tanh(X4) * sp.cosh(X4) - sp.sinh(X4),
        (X3 + X4) ** 5 - sp.expand((X3 + X4) ** 5),
        sp.sqrt(X3 + 7) ** 2 - X3,
        sp.log(X3 * sp.exp(X4)) - sp.log(X3) - X4,
        (k - sp.Rational(1, 2)) * X4,
    ],
)
def test_terms_that_cancel_do_not_count(hidden: sp.Expr) -> None:
    chains = levelwise(rows([u * X2 + hidden, X3, X4, 0], X1 + hidden - hidden, k=(0.5, 0.5)))
    assert chains.order == (X1, X2, X3, X4)
    assert answers(chains) == (True, True, True)
    assert chains.links[0][1].gain == u
    assert not chains.links[0][1].offset.has(X3, X4)


@pytest.mark.parametrize(
    ("term", "says"),
    [
        (sp.Rational(1, 10**30) * X3, "x1' brings in x2, x3 together"),
        (sp.sin(X3) ** 2 + sp.cos(X3) ** 2 + X3 / 10**40, "x1' brings in x2, x3 together"),
        ((X3**2 - X2**2) / (X3 - X2) - sp.Rational(1000001, 10**6) * X3, "x1' brings in x2, x3 together"),
        ((k - sp.Rational(1, 2)) * X4, "x1' brings in x2, x4 together"),
        (sp.Rational(1, 10**30) * X2**2, "x1' brings in x2 with a slope that varies with x2"),
        (sp.Rational(1, 10**20) * X1 * X2, "x1' brings in x2 with a slope that varies with x1"),
        (sp.sin(X3) ** 2 - sp.cos(X3) ** 2, "x1' brings in x2, x3 together"),
        (-X2, "x1' brings in no new state, so the output never shows x2, x3, x4"),
    ],
)
def test_near_misses_are_refused_with_the_reason(term: sp.Expr, says: str) -> None:
    answer, why = levelwise(rows([X2 + term, X3, X4, 0])).answer(Shape.CONSTANT)
    assert answer is False
    assert says in str(why)


def test_what_is_not_known_is_no_answer() -> None:
    """|x2| on x2 >= 1: no point refutes that it is x2, and nothing proves it."""
    assert answers(levelwise(rows([sp.Abs(X2), 0], x2=(1, 2)))) == (None, None, True)
    assert answers(levelwise(rows([X2 + sp.atan(X3) + sp.atan(1 / X3), X3, 0], x3=(1, 2)))) == (None, None, None)
    assert answers(levelwise(rows([sp.Max(X2, X3), X3, 0], x2=(2, 3), x3=(0, 1)))) == (None, None, None)


def test_the_range_of_a_state_that_is_a_point_hides_nothing() -> None:
    assert answers(levelwise(rows([X2, 0], x2=(1, 1)))) == (True, True, True)


_DISGUISES = [
    lambda a, b: a * 0,
    lambda a, b: sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1,
    lambda a, b: (a**2 - b**2) / (a - b) - a - b,
    lambda a, b: sp.exp(a - b) - sp.exp(a) / sp.exp(b),
    lambda a, b: (a + b) ** 3 - a**3 - 3 * a**2 * b - 3 * a * b**2 - b**3,
    lambda a, b: sp.sin(a + b) - sp.sin(a) * sp.cos(b) - sp.cos(a) * sp.sin(b),
    lambda a, b: sp.Abs(a * b) ** 2 - a**2 * b**2,
]
_SPOILERS = [lambda a: a / 10**25, lambda a: sp.sin(a) / 1000, lambda a: a**2, lambda a: sp.Abs(a)]


@pytest.mark.full
@sweep(20, 60, st.integers(2, 8), st.randoms(use_true_random=False), st.booleans())
def test_a_scramble_is_recognised_and_a_spoiled_one_refused(n: int, draw: random.Random, spoil: bool) -> None:
    """A permuted, signed, scaled chain with zeros in disguise; spoiled by one term of a state two places later."""
    order = draw.sample(x[:n], n)
    scale = {s: draw.choice((1, -1, sp.Rational(2, 7), -30)) for s in order}
    z = [scale[s] * s for s in order]
    at = draw.randrange(n - 2) if spoil and n > 2 else None
    flow = dict.fromkeys(order, sp.S.Zero)
    for i, s in enumerate(order):
        rate = sp.cos(z[draw.randrange(i + 1)]) * z[draw.randrange(i + 1)]
        if i + 1 < n:
            rate += draw.choice((1, k, 2 + sp.sin(u), sp.exp(u))) * z[i + 1]
        if at == i:
            rate += draw.choice(_SPOILERS)(z[draw.randrange(i + 2, n)])
        rate += draw.choice(_DISGUISES)(*draw.sample(order, 2))
        flow[s] = rate / scale[s]
    chains = levelwise(rows([flow[s] for s in x[:n]], z[0] * draw.choice((1, k, -3))))
    if at is None:
        assert chains.order == tuple(order)
        assert answers(chains) == (True, True, True)
    else:
        assert answers(chains) == (False, False, False)
        assert f"{order[at]}' brings in" in str(chains.answer(Shape.CONSTANT)[1])


# Several outputs


@pytest.mark.parametrize(
    ("flow", "output", "level", "cascaded", "ends"),
    [
        ([X3, X4, X1 * X2 * u, X3 * X4], [X1, 2 * X2], True, None, True),
        ([X3, X3, u * X1], [X1, X2], False, True, True),
        ([X3, X3 + X4, u * X1, X2], [X1, X2], False, True, None),
        ([X2 * X3 * X4, X3, X4, X1 * X2], [X1, X2], False, False, True),
        ([X3, X4 + X1, X4 * X3, X1 * X2], [X1, X2], True, False, True),
        ([X2 * X3, 0, 0], [X1, X2], False, False, None),
        ([X2, 0], [X1, X1], False, False, None),
        ([X2, 0], [X1, X1 + X2], False, False, None),
        ([X3, 0, 0, X4], [X1, X2], False, False, None),
        ([X3 * X1, X4, 0, 0], [X1, X2], False, False, None),
        ([X2, X1, X2 * X1], [X1, X3], False, True, True),
    ],
)
def test_several_outputs(
    flow: list[sp.Expr], output: list[sp.Expr], level: bool, cascaded: bool | None, ends: bool | None
) -> None:
    plant = rows(flow, output)
    assert levelwise(plant).answer(Shape.CONSTANT)[0] is level
    if cascaded is not None:
        assert cascade(plant).answer(Shape.CONSTANT)[0] is cascaded
    assert end_aligned(plant).answer(Shape.CONSTANT)[0] is ends


def test_levels_with_nonlinear_slopes() -> None:
    plant = rows([X3 + X3**3, sp.exp(X4) + X1, X1 * X2, X3], [X1, sp.sinh(X2)])
    chains = levelwise(plant)
    assert chains.blocks == (2, 2)
    assert answers(chains) == (False, False, True)


@pytest.mark.full
@pytest.mark.parametrize("outputs", [5, pytest.param(10, marks=pytest.mark.slow)])
def test_many_states_and_outputs_are_quick(outputs: int) -> None:
    """Sixty states take 2 s to 3 s on an idle core; a factorial would not end, of thirty either."""
    start = time.process_time()
    n = 6 * outputs
    s = sp.symbols(f"s0:{n}")
    flow = [(2 + sp.sin(u)) * s[i + 1] + sp.sin(s[i] * s[0]) for i in range(n - 1)] + [sum(map(sp.sin, s))]
    shuffled = random.Random(1).sample(range(n), n)
    one = Rows(tuple(s[i] for i in shuffled), tuple(flow[i] for i in shuffled), ("y",), (s[0],), {})
    assert levelwise(one).order == s
    assert levelwise(one).answer(Shape.CONSTANT)[0] is True
    level = [
        (s[6 * j + i + 1] if i < 5 else 0) + sp.sin(sum(s[6 * m + q] for m in range(outputs) for q in range(i + 1)))
        for j in range(outputs)
        for i in range(6)
    ]
    chain = [(s[i + 1] if i % 6 < 5 else 0) + sum(s[: i + 1]) ** 2 for i in range(n)]
    names, heads = tuple(f"y{j}" for j in range(outputs)), tuple(s[6 * j] for j in range(outputs))
    assert levelwise(Rows(s, tuple(level), names, heads, {})).blocks == (6,) * outputs
    chains = cascade(Rows(s, tuple(chain), names, heads[::-1], {}))
    assert chains.answer(Shape.CONSTANT)[0] is True
    assert chains.order[:6] == s[n - 6 :]
    assert time.process_time() - start < 60


def brute_force(plant: Rows) -> bool:
    """Whether any partition into ordered chains is a cascade, by trying all; the flow is polynomial."""
    heads = [next(iter(h.free_symbols)) for h in plant.output]

    def grow(taken: list[sp.Symbol], left: list[int]) -> bool:
        if not left:
            return len(taken) == len(plant.states)
        return any(fits(taken, j, left) for j in left)

    def fits(taken: list[sp.Symbol], j: int, left: list[int]) -> bool:
        free = [s for s in plant.states if s not in taken and s not in heads]
        for size in range(len(free) + 1):
            for tail in permutations(free, size):
                own = [heads[j], *tail]
                if all(ok(taken, own, i) for i in range(len(own))) and grow(
                    [*taken, *own], [m for m in left if m != j]
                ):
                    return True
        return False

    def ok(taken: list[sp.Symbol], own: list[sp.Symbol], i: int) -> bool:
        row = sp.expand(plant.rate(own[i]))
        following = own[i + 1] if i + 1 < len(own) else None
        allowed = {*taken, *own[: i + 1]} | ({following} if following else set())
        if not row.free_symbols & set(plant.states) <= allowed:
            return False
        slope = row.diff(following) if following else sp.S.One
        return slope != 0 and slope.is_number

    return len(set(heads)) == len(heads) and grow([], list(range(len(heads))))


@pytest.mark.full
@settings(deadline=None, max_examples=150)
@given(st.randoms(use_true_random=False), st.integers(2, 5), st.integers(1, 3))
def test_greedy_finds_a_cascade_wherever_there_is_one(draw: random.Random, n: int, p: int) -> None:
    states = x[:n]
    flow = [
        sum(draw.choice((1, -2)) * s for s in draw.sample(states, draw.choice((0, 1, 1, 2))))
        + draw.choice((0, 0, draw.choice(states) * draw.choice(states)))
        for _ in states
    ]
    plant = rows(flow, draw.sample(states, min(p, n)))
    answer = cascade(plant).answer(Shape.CONSTANT)[0]
    assert answer is brute_force(plant)
