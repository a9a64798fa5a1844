"""The value of a determinant, against the expansion in numbers at real points, where roots are real branches."""

import random
from typing import Any

import mpmath
import pytest
import sympy as sp

from hgogen.analysis.determinant import determinant
from hgogen.check import Verdict
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.factors import branches
from hgogen.rigor.field import Writer, field

V, W = sp.symbols("v w", real=True)
SQUARE, OTHER = sp.expand((W - 1) ** 2), sp.expand((V - W) ** 2)
POLYNOMIALS = [sp.S.Zero, sp.S.One, V, W, V - W, 1 - W]
ROOTS = [
    *(sp.sqrt(1 - W), sp.sqrt((1 - W) * (2 - W)), sp.sqrt(V * W), 1 / sp.sqrt(3 - V), sp.cbrt(1 - W), sp.cbrt(V**2)),
    *(sp.sqrt(SQUARE), OTHER ** sp.Rational(1, 4), sp.Abs(W), sp.Abs(1 - V), sp.sqrt(sp.Abs(W)), sp.sqrt(V**2 + W**2)),
]
HALVES = [W + sp.Abs(W), sp.Abs(V) - V, sp.sqrt(SQUARE) + W - 1, sp.sqrt(SQUARE) - W + 1, sp.sqrt(SQUARE), sp.Abs(W)]
KINDS = {"roots": (POLYNOMIALS + ROOTS, (1, 2, 2, 3), 20), "kinks": (POLYNOMIALS + HALVES, (3, 4), 8)}


def expansion(rows: list[list[Any]]) -> Any:
    """By the first row."""
    if not rows:
        return mpmath.mpf(1)
    return sum(
        (-1) ** j * entry * expansion([[*row[:j], *row[j + 1 :]] for row in rows[1:]])
        for j, entry in enumerate(rows[0])
    )


def numbers(e: Any, point: list[Any]) -> Any:
    """None where something is not a finite real number."""
    try:
        matrix = sp.lambdify((V, W), e, "mpmath")(*point)
    except ZeroDivisionError:
        return None
    flat = [x for row in matrix for x in row] if isinstance(matrix, list) else [matrix]
    return None if any(mpmath.im(x) != 0 or not mpmath.isfinite(x) for x in map(mpmath.mpmathify, flat)) else matrix


@pytest.mark.full
@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (6, 7))])
@pytest.mark.parametrize("kind", KINDS)
def test_the_value_is_the_determinant_at_every_real_point(kind: str, seed: int) -> None:
    entries, sizes, count = KINDS[kind]
    draw, met = random.Random(seed), 0
    with mpmath.workdps(40):
        for _ in range(count):
            n = draw.choice(sizes)
            rows = [[draw.choice(entries) for _ in range(n)] for _ in range(n)]
            value = determinant(rows).value
            for _ in range(6):
                point = [mpmath.mpf(draw.randint(-300, 300)) / 101 for _ in range(2)]
                there = numbers(rows, point)
                if there is not None:
                    known, computed = expansion(there), numbers(value, point)
                    assert computed is not None, (rows, value, point)
                    assert abs(computed - known) <= 1e-25 * (1 + abs(known)), (rows, value, point)
                    met += 1
    assert met > 3 * count


@pytest.mark.parametrize(
    ("e", "value"),
    [
        *((e, e) for e in ROOTS),
        (V * W / sp.sqrt(V * W), sp.sqrt(V * W)),
        ((1 - W) / sp.sqrt(1 - W), sp.sqrt(1 - W)),
        (sp.sqrt(1 + sp.cos(W)), sp.sqrt(1 + sp.cos(W))),
        (sp.Abs(sp.sin(W)), sp.Abs(sp.sin(W))),
        (sp.sqrt(1 - W) ** 3, sp.sqrt(1 - W) ** 3),
    ],
)
def test_a_root_stays_whole(e: sp.Expr, value: sp.Expr) -> None:
    assert sp.simplify(determinant([[e]]).value - sp.expand(value)) == 0


@pytest.mark.parametrize("e", [sp.sqrt(1 - W), sp.sqrt(1 - W**2), SQUARE ** sp.Rational(1, 4), 2 + sp.sqrt(sp.Abs(W))])
def test_what_has_no_zero_is_not_refuted(e: sp.Expr) -> None:
    """On [-0.9, 0.5]; a row before it brings in a pole that cancels."""
    value = determinant([[1, 0], [V * e.diff(W), e]]).value
    assert nonzero(value, {V: (-2, 2), W: (-0.9, 0.5)}).verdict is Verdict.PROVED


BRANCHES = [
    (sp.sqrt(V), False),
    (sp.sqrt(1 - V) * sp.sqrt(V * W), False),
    (sp.sqrt(SQUARE), True),
    (sp.sqrt(V**2 + W**2) * sp.sqrt(sp.expand((V**2 + W**2) * (V - 1) ** 2)), True),
    (sp.sqrt(V) + sp.sqrt(W) + sp.sqrt(V * W), False),  # the product of two roots, which is never negative
    (sp.sqrt(V * W) + sp.sqrt(V * (V + W)) + sp.sqrt(W * (V + W)), True),
    (sp.cbrt(V**2 + W**2), False),
    (sp.sqrt(1 + sp.sqrt(V**2 + 1)), True),
    (sp.sqrt(1 + sp.cos(V)), False),
    (sp.sqrt(1 - sp.cos(V)) + sp.sin(V / 2), True),
    (sp.sqrt(2) + sp.sqrt(3) * V + sp.sqrt(6), False),
    (sp.atan(V), False),
    (sp.atan(V) + sp.atan(1 / V), True),
    (sp.Abs(V), True),
    ((1 / V) ** sp.Rational(1, 10) + sp.sqrt(V), False),
]


@pytest.mark.parametrize(("e", "known"), BRANCHES)
def test_where_a_polynomial_in_generators_may_be_zero_on_a_part(e: sp.Expr, known: bool) -> None:
    writer = Writer()
    writer.measure(e)
    made, _ = field(writer, [writer.write(e)])
    assert branches(made) is known


def test_a_steep_function_is_no_high_power() -> None:
    """A valve that opens within 1e-5 of its way: exp(200000 w) under a root, where exp(w)^200000 takes for ever."""
    e = sp.sqrt(2 - V * sp.tanh(100000 * W))
    writer = Writer()
    writer.measure(e)
    made, _ = field(writer, [writer.write(e)])
    assert max(d for root in made.roots for end in root.value for d in end.degrees()) == 2


def test_a_division_leaves_no_pole() -> None:
    """Entries without one: G = |(v, w)| was divided by, and 0/0 at 0 is not finite."""
    G = sp.sqrt(V**2 + W**2)
    value = determinant([[G, 1, W], [V, G, V - W], [G - V, G - W, 0]]).value
    assert sp.denom(sp.together(value)) == 1
