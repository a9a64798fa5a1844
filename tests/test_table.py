"""`hg.table` in models, proofs, graphs, emitted code and certificates, against dense samples of random tables."""

import copy
import json
import math
import pickle
import re
import struct
import tomllib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import casadi as ca
import emitted
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.emit.code import code
from hgogen.emit.cost import cost
from hgogen.emit.portable import tables
from hgogen.emit.pygraph import evaluated
from hgogen.emit.syntax import DTYPE, PointsMerge
from hgogen.emit.syntaxes import C
from hgogen.graph import to_casadi
from hgogen.reading import text_model
from hgogen.reading.declared import MOST, BadTable, cells_of
from hgogen.recheck import tables as rechecked
from hgogen.recheck import tables as tables_module
from hgogen.recheck.interval import between, intervals
from hgogen.recheck.verification import recheck
from hgogen.rigor import bounds
from hgogen.rigor.bounds import as_programmed, nonzero, rounded
from hgogen.rigor.bounds import bound as bound_of
from hgogen.rigor.box import Sides, box
from hgogen.rigor.enclosure import enclose
from hgogen.rigor.lookup import (
    Axis,
    Cells,
    Kinked,
    Lookup,
    Stepped,
    Table,
    applied,
    hessian,
    jacobian,
    polynomial_range,
    polynomial_value,
)
from hgogen.rigor.series import values
from hgogen.rigor.singular import one_sided
from hgogen.rigor.slope import lipschitz_bound
from hgogen.rigor.tape import tape
from hgogen.signal import BadName
from hgogen.system import BadSystem

KINDS = ("linear", "monotone")
X = sp.Symbol("x", real=True)


def curve(xs: Iterable[object], ys: Iterable[object], kind: str, name: str) -> Cells:
    """The table of these points."""
    return cells_of([xs], ys, kind, name)


def places(cells: Cells) -> tuple[Fraction, ...]:
    """The breakpoints of its one axis."""
    return cells.axes[0].x


def value_of(cells: Cells, place: Fraction, order: int = 0) -> Fraction | None:
    """The value of a derivative."""
    return cells.at([place], (order,))


def span(
    cells: Cells, low: Fraction | float, high: Fraction | float, order: int = 0
) -> tuple[Fraction, Fraction] | None:
    """The range of a derivative."""
    return cells.limits([(low, high)], (order,))[0]


def call(cells: Cells, argument: sp.Expr, order: int = 0) -> sp.Expr:
    """A derivative at an expression."""
    return applied(cells, [argument], (order,))


def drawn(draw: Random, kind: str, most: int = 8) -> Cells:
    """A table with flat pieces, steep ones, and turns."""
    count = draw.randint(2, most)
    xs = sorted(draw.sample(range(-40, 40), count))
    ys = [draw.choice((draw.randint(-5, 5), draw.randint(-500, 500), 1)) for _ in xs]
    return curve([Fraction(x, 8) for x in xs], [Fraction(y, 3) for y in ys], kind, "drawn")


def boxes(draw: Random, cells: Cells, count: int = 12) -> Iterator[tuple[float, float]]:
    """Boxes that end on points, between them, and beyond the ends, and single numbers."""
    ends = [*map(float, places(cells)), -7.0, 7.0, *(draw.uniform(-6, 6) for _ in range(4))]
    for _ in range(count):
        low, high = sorted(draw.choices(ends, k=2))
        yield low, high


def inside(cells: Cells, low: float, high: float) -> list[Fraction]:
    """Points of a box, its ends, and on both sides of each breakpoint in it."""
    around = [float(x) + d for x in places(cells) for d in (-1e-6, 0, 1e-6)]
    points = {low, high, *np.linspace(low, high, 23).tolist(), *around}
    return [Fraction(p) for p in sorted(points) if low <= p <= high]


def within(cells: Cells, low: float, high: float) -> list[Fraction]:
    """Of these the points inside of it, or the one that it is."""
    return [p for p in inside(cells, low, high) if low < p < high or low == high]


# --- the function -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_it_passes_through_its_points_and_is_held_at_its_ends(kind: str) -> None:
    draw = Random(1)
    for _ in range(50):
        cells = drawn(draw, kind)
        assert [value_of(cells, x) for x in places(cells)] == list(cells.values)
        assert [value_of(cells, places(cells)[0] - 3), value_of(cells, places(cells)[-1] + 3)] == [
            cells.values[0],
            cells.values[-1],
        ]
        assert [value_of(cells, x, 1) for x in (places(cells)[0] - 3, places(cells)[-1] + 3)] == [0, 0]


def test_monotone_is_scipy_s_pchip() -> None:
    from scipy.interpolate import PchipInterpolator

    draw = Random(2)
    for _ in range(50):
        cells = drawn(draw, "monotone")
        other = PchipInterpolator([float(x) for x in places(cells)], [float(y) for y in cells.values])
        at = np.linspace(float(places(cells)[0]), float(places(cells)[-1]), 60)[1:-1]
        size = max(abs(float(y)) for y in cells.values) + 1
        ours = [float(value_of(cells, Fraction(t))) for t in at]
        assert np.allclose(ours, other(at), rtol=0, atol=1e-11 * size)


def test_monotone_rises_and_falls_with_its_points() -> None:
    draw = Random(3)
    for _ in range(100):
        cells = drawn(draw, "monotone")
        for (a, c), (b, d) in pairwise(zip(places(cells), cells.values, strict=True)):
            low, high = span(cells, a, b, 1)
            assert low >= 0 or d < c
            assert high <= 0 or d > c
            assert span(cells, a, b) == (min(c, d), max(c, d))


def test_monotone_has_one_continuous_derivative_between_its_ends() -> None:
    cells = curve([0, 1, 2, 4], [0, 1, 3, 6], "monotone", "t")
    assert cells.smooth == ((1, 2, 2, 1),)
    assert cells.smoothness == (0,)  # held, it has kinks at its ends
    box = {X: (Fraction(0), Fraction(4))}
    free = one_sided(call(cells, X), box)
    assert (free.cells.axes[0].clamped, free.cells.smoothness) == (False, (1,))
    assert not isinstance(free, Kinked)
    assert isinstance(free.diff(X), Kinked)
    assert isinstance(free.diff(X, 2), Stepped)
    assert one_sided(call(cells, X + 1), box).cells.axes[0].clamped
    line = curve([0, 1, 2, 4], [0, 1, 3, 6], "linear", "t")
    assert isinstance(one_sided(call(line, X), box), Kinked)


def test_a_table_is_a_value_of_sympy() -> None:
    t = hg.table(2 * X, [0, 1, 2], [0, 1, 4], name="ocv")
    assert (str(t), str(t.diff(X))) == ("ocv(2*x)", "2*ocv(2*x, 1)")
    assert t == hg.table(2 * X, [0, 1.0, 2], (0, 1, np.float64(4)), name="ocv") != hg.table(2 * X, [0, 1], [0, 1])
    assert pickle.loads(pickle.dumps(t)) == copy.deepcopy(t) == t
    assert t.subs(X, sp.Rational(3, 4)) == sp.Rational(5, 2)
    assert t.diff(X).subs(X, sp.Rational(1, 2)) != t.diff(X, 1).subs(X, sp.Rational(1, 4))  # a set at a kink
    assert abs(hg.table(sp.sqrt(2), [0, 1, 2], [0, 1, 4]).evalf() - (3 * math.sqrt(2) - 2)) < 1e-12
    assert hg.table(0.3, [0, 1], [0, 1]) == sp.Rational(3, 10)


# --- ranges -------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("True-linear", "True-monotone", "False-monotone")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("held", [True, False])
def test_ranges_hold_every_value(kind: str, held: bool) -> None:
    """Of a derivative inside of the box: at its ends it may be another one's, and where it jumps it is a set."""
    draw = Random(f"{kind} {held}")
    for _ in range(60):
        cells = drawn(draw, kind)
        cells = cells.clamping(held)
        for low, high in boxes(draw, cells):
            points = inside(cells, low, high)
            for order in range(4):
                ends = span(cells, low, high, order)
                at = points if order == 0 else within(cells, low, high)
                reached = [value for p in at if (value := value_of(cells, p, order)) is not None]
                if ends is not None:
                    assert all(ends[0] <= value <= ends[1] for value in reached)
                    assert order or ends[0] == min(reached) or kind == "monotone" or low < high
                else:
                    assert cells.least_smooth(cells.overlapped([(low, high)]))[0] < order


def test_floats_beside_a_breakpoint_are_on_its_side() -> None:
    """Breakpoints that are no floats, that are, and one beside a float by less than any other."""
    axis = Axis((Fraction(1, 10), Fraction(1, 3), Fraction(1, 2), Fraction(1) + Fraction(1, 2**80)))
    nearest = [float(x) for x in axis.x]
    for end in [beside for x in nearest for beside in (math.nextafter(x, -1), x, math.nextafter(x, 2))]:
        exact = Fraction(end)
        below, until = sum(x < exact for x in axis.x), sum(x <= exact for x in axis.x)
        assert axis.overlapped(end, end) == axis.overlapped(exact, exact) == (below, until)
        assert axis.overlapped(end, 2.0) == (until, 4)
        assert axis.overlapped(0.0, end) == (0, below)


def test_extremes_hold_a_cubic_that_turns() -> None:
    """By its coefficients in Bernstein's basis, on an interval that does not begin at 0."""
    draw = Random(10)
    for _ in range(200):
        piece = tuple(Fraction(draw.randint(-9, 9)) for _ in range(4))
        a, b = sorted(Fraction(draw.randint(-30, 30), 10) for _ in range(2))
        low, high = polynomial_range(piece, [(a, b)])
        reached = [polynomial_value(piece, [a + (b - a) * k / 40]) for k in range(41)]
        assert low <= min(reached)
        assert max(reached) <= high
        assert high - low <= 30 * (max(reached) - min(reached))


@pytest.mark.parametrize("kind", KINDS)
def test_enclosures_of_values_and_slopes_on_boxes(kind: str) -> None:
    """Of f(g(x)) with g = x^2 - 1, and its slope, against differences of the exact function."""
    draw = Random(4)
    for _ in range(30):
        cells = drawn(draw, kind)
        program = tape([call(cells, X**2 - 1)], (X,))
        sides = list(boxes(draw, cells))
        low, high = (np.array([[side[i] for side in sides]]) for i in (0, 1))
        (enclosure,) = enclose(program, low, high, slopes=True)
        assert enclosure.defined.all()
        assert enclosure.continuous.all()
        for k, (a, b) in enumerate(sides):
            points = inside(cells, a, b)
            values = [value_of(cells, p**2 - 1) for p in points]
            assert all(enclosure.value[0][k] <= value <= enclosure.value[1][k] for value in values)
            for (p, c), (q, d) in pairwise(zip(points, values, strict=True)):
                chord = (d - c) / (q - p)
                assert enclosure.slope[0][0][k] <= chord <= enclosure.slope[1][0][k]


def test_a_slope_that_jumps_is_a_set_and_has_no_slope() -> None:
    """A box that ends on a point has the slope within; a box of one point both; across it the slope jumps."""
    line = curve([0, 1, 2], [0, 1, 3], "linear", "t")
    program = tape([call(line, X, 1), call(line, X, 2)], (X,))
    low, high = np.array([[0.5, 1.0, 0.5, 1.0, -1.0]]), np.array([[1.0, 1.5, 1.5, 1.0, 0.0]])
    first, second = enclose(program, low, high, slopes=True)
    assert list(zip(*first.value, strict=True)) == [(1, 1), (2, 2), (1, 2), (1, 2), (0, 0)]
    assert first.defined.all()
    assert first.continuous.tolist() == [True, True, False, False, True]
    assert np.isfinite(first.slope[1][0]).tolist() == [True, True, False, False, True]
    assert second.defined.tolist() == [True, True, False, False, True]
    assert span(line, 0.5, 1.5, 2) is None
    numbers = [n for point in zip(places(line), line.values, strict=True) for n in point]
    slope, beyond = (rechecked.name_of("Linear", [Fraction(order), *numbers]) for order in (1, 2))
    sides = [(0.5, 1.0), (1.0, 1.5), (0.5, 1.5), (1.0, 1.0), (-1.0, 0.0)]
    assert [rechecked.range_on(slope, [side]) for side in sides] == [(1, 1), (2, 2), (1, 2), (1, 2), (0, 0)]
    assert [rechecked.range_on(beyond, [side]) is None for side in sides] == [False, False, True, True, False]


@pytest.mark.parametrize("kind", KINDS)
def test_the_checker_s_own_tables_hold_every_value(kind: str) -> None:
    draw = Random(5)
    for _ in range(40):
        cells = drawn(draw, kind)
        numbers = [n for point in zip(places(cells), cells.values, strict=True) for n in point]
        for order in range(4):
            name = rechecked.name_of(kind.capitalize(), [Fraction(order), *numbers])
            for low, high in boxes(draw, cells, 4):
                ends = rechecked.range_on(name, [(low, high)])
                mine = span(cells, low, high, order)
                assert (ends is None) == (mine is None)
                if ends is None:
                    continue
                wide = intervals.function(name, (between(low, high),))
                at = inside(cells, low, high) if order == 0 else within(cells, low, high)
                reached = [value for p in at if (value := value_of(cells, p, order)) is not None]
                assert all(ends[0] <= value <= ends[1] for value in reached)
                assert not any(wide.at_least(value + Fraction(1, 10**9)) for value in reached)
                assert not any(wide.at_most(value - Fraction(1, 10**9)) for value in reached)


@pytest.mark.parametrize("kind", KINDS)
def test_values_at_points_are_balls_around_the_exact_ones(kind: str) -> None:
    draw = Random(6)
    for _ in range(30):
        cells = drawn(draw, kind)
        for order in range(3):
            program = tape([call(cells, X, order)], (X,))
            for p in [*places(cells), *(Fraction(draw.randint(-90, 90), 7) for _ in range(6))]:
                (ball,) = values(program, [p])
                exact = value_of(cells, p, order)
                if exact is None:
                    assert not ball.is_finite()
                elif ball.is_finite():
                    assert Fraction(str(ball.lower().fmpq())) <= exact <= Fraction(str(ball.upper().fmpq()))


@pytest.mark.ordinary("linear")
@pytest.mark.parametrize("kind", KINDS)
def test_lipschitz_bounds_hold_the_steepest_chord(kind: str) -> None:
    """On the box, a bound that chords approach: within its 2 percent, and of lines exactly."""
    draw = Random(7)
    for _ in range(25):
        cells = drawn(draw, kind)
        low, high = sorted(draw.choices([*places(cells), Fraction(-7), Fraction(7), Fraction(1, 3)], k=2))
        if low == high:
            continue
        bound = lipschitz_bound([call(cells, X)], (X,), {X: (low, high)})
        assert bound.verdict is Verdict.PROVED
        ends = span(as_programmed(call(cells, X), Sides((X,), ((low, high),))).cells, low, high, 1)
        steepest = max(map(abs, ends))
        assert float(steepest) <= bound.high <= 1.03 * float(steepest) + 1e-12
        points = inside(cells, float(low), float(high))
        chords = [abs((value_of(cells, q) - value_of(cells, p)) / (q - p)) for p, q in pairwise(points)]
        assert max(chords) <= Fraction(bound.high)


def test_what_a_slope_that_turns_or_rests_is_not_shown() -> None:
    """No sign of a slope that is 0 on a piece, or changes at a kink; one where it has one."""
    box = {X: (Fraction(0), Fraction(3))}
    for ys, verdict in (([0, 1, 3, 4], Verdict.PROVED), ([0, 1, 1, 4], None), ([0, 2, 1, 4], None)):
        for kind in KINDS:
            sign = nonzero(call(curve([0, 1, 2, 3], ys, kind, "t"), X).diff(X), box)
            assert (sign.verdict is Verdict.PROVED) == (verdict is Verdict.PROVED), (ys, kind)
    wide = {X: (Fraction(-1), Fraction(3))}  # flat beyond its ends
    assert nonzero(call(curve([0, 1, 2, 3], [0, 1, 3, 4], "linear", "t"), X).diff(X), wide).verdict is not (
        Verdict.PROVED
    )


# --- graphs and emitted code --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_graphs_and_their_derivatives_are_sympy_s(kind: str) -> None:
    """Ours, of lookups, and CasADi's own, which a user's functions have."""
    v = sp.Symbol("v", real=True)
    inner = hg.table(X * v, [0, 1, 2, 5, 6], [0, 1, 4, 5, -1], kind=kind, name="a")
    rows = [inner * v + hg.table(inner, [-1, 2, 5], [0.3, 1, 0], kind=kind, name="b"), X**2 * v]
    x, w = ca.SX.sym("x"), ca.SX.sym("v")
    both, at = ca.vertcat(x, w), Random(8)
    graph = ca.vertcat(*to_casadi(rows, {X: x, v: w}))
    ours = ca.Function("ours", [x, w], [graph, jacobian(graph, both), hessian(graph[0], both)])
    theirs = ca.Function("theirs", [x, w], [graph, ca.jacobian(graph, both), ca.hessian(graph[0], both)[0]])
    for _ in range(60):
        point = [at.uniform(-1, 3), at.uniform(-1, 3)]
        where = dict(zip((X, v), map(sp.Float, point), strict=True))
        J = [[float(row.diff(s).subs(where)) for s in (X, v)] for row in rows]
        H = [[float(rows[0].diff(s).diff(t).subs(where)) for s in (X, v)] for t in (X, v)]
        for computed in (ours(*point), theirs(*point)):
            assert np.allclose(computed[0].full().ravel(), [float(row.subs(where)) for row in rows])
            assert np.allclose(computed[1].full(), J)
            assert np.allclose(computed[2].full(), H)


_MAIN = """
#include <stdio.h>
#include <string.h>
{text}
int main(void)
{{
    {type} x;
    while (fread(&x, sizeof x, 1, stdin) == 1) {{
        const {type} values[] = {{{calls}}};
        fwrite(values, sizeof values, 1, stdout);
    }}
    return 0;
}}
"""


def program(all_cells: Iterable[Cells], real: str, folder: Path, *flags: str) -> Path:
    """What gives at each number the value and two slopes of each table."""
    lookups = [Lookup(cells, (order,)) for cells in all_cells for order in range(3)]
    text = "\n".join((tables(C, "t", real, lookups) + code("")).lines)
    calls = ", ".join(f"t_{each.name}(x)" for each in lookups)
    return emitted.compiled("gcc", {"main.c": _MAIN.format(text=text, type=real, calls=calls)}, folder, *flags)


def numbers(cells: Cells, real: str) -> np.ndarray:
    """Points, their neighbours, numbers between and beyond, and what is no number."""
    kind = DTYPE[real]
    points = np.array(list(map(float, places(cells))), kind)
    infinite = np.array([np.inf, -np.inf, np.nan, 3e38, -3e38, 0.0, -0.0], kind)
    around = np.concatenate([points, np.nextafter(points, kind(np.inf)), np.nextafter(points, kind(-np.inf))])
    return np.concatenate([around, infinite, np.linspace(-7, 7, 101, dtype=kind)])


@pytest.mark.ordinary("linear-float", "linear-double", "monotone-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("kind", KINDS)
def test_c_and_python_and_casadi_have_the_same_bits(kind: str, real: str, tmp_path: Path) -> None:
    """At every number, infinite and not a number among them: those give what is no number, and nothing is read out of
    bounds, which the sanitizers would tell."""
    emitted.tool("gcc")
    draw = Random(9)
    curves = []
    for count in (2, 3, 4, 5, 8, 9, 200):
        points = [x / 700 for x in sorted(draw.sample(range(-4000, 4000), count))]
        cells = curve(points, [draw.uniform(-3, 3) for _ in points], kind, f"t{count}")
        curves.append(cells.clamping(count % 2 == 0))
    binary = program(curves, real, tmp_path, "-O2", "-ffp-contract=off", "-fsanitize=address,undefined")
    for k, cells in enumerate(curves):
        xs = numbers(cells, real)
        run = emitted.subprocess.run([binary], input=xs.tobytes(), capture_output=True, check=True)
        seen = np.frombuffer(run.stdout, DTYPE[real]).reshape(len(xs), -1)[:, 3 * k : 3 * k + 3]
        x = ca.SX.sym("x")
        for order in range(3):
            lookup = Lookup(cells, (order,))
            graph = ca.Function("f", [x], [lookup(x)])
            with np.errstate(all="ignore"):
                python = [evaluated(graph, real)([[v]])[0][0] for v in (xs.tolist() if real == "double" else xs)]
            assert same(seen[:, order], np.array(python, DTYPE[real]))
            assert np.isnan(seen[~np.isfinite(xs), order]).all()
            finite = np.abs(xs) < 1e3
            if real == "double":
                assert (graph.map(int(finite.sum()))(xs[finite]).full()[0] == seen[finite, order]).all()


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """The same bits, of any NaN."""
    return bool(((a.view(f"u{a.itemsize}") == b.view(f"u{b.itemsize}")) | (np.isnan(a) & np.isnan(b))).all())


@pytest.mark.full
def test_a_long_table_costs_what_a_short_one_does() -> None:
    """One operation of a program, and a search whose steps grow with the logarithm."""
    steps = []
    for count in (10, 1000):
        x, y = hg.Signal("x", low=0, high=1), hg.Signal("y")
        xs = [k / (count - 1) for k in range(count)]
        t = hg.table(x, xs, [v**2 for v in xs], name="t")
        plant = hg.System("one", states=(x,), outputs=(y,), flow=[-t], output=[x])
        steps.append(hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=(-1,)), dt=0.1))
    assert cost(steps[0]) == cost(steps[1])
    assert [len(Lookup(curve(range(n), range(n), "linear", "t"), (0,)).axes[0].probes) for n in (10, 1000)] == [4, 10]


# --- at the door --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([0], [1]), "has 1 point; give 2 to"),
        (([0, 1], [1]), "has 2 xs and 1 ys; give a y for each x"),
        (([0, 2, 1], [1, 2, 3]), "xs 2 and 3, 2 and 1, do not increase; sort them"),
        (([0, 0], [1, 2]), "do not increase"),
        (([0, math.nan], [1, 2]), "xs 2 is nan, no finite number"),
        (([0, 1], [1, math.inf]), "ys 2 is inf, no finite number"),
        (([0, 1], [1, 2j]), "no finite number"),
        (([0, 1], [1, "2"]), "no finite number"),
        (([0, 1], [1, True]), "no finite number"),
        (([0, 1], [1, 10**400]), "choose other units"),
        (([0, 5e-324], [0, 1e300]), "choose other units"),
        (("01", [1, 2]), "give a list of numbers"),
        (({0, 1}, [1, 2]), "give a list of numbers"),
        ((3, [1, 2]), "give a list of numbers"),
    ],
)
def test_a_bad_table_is_refused_with_its_fix(arguments: tuple[object, object], says: str) -> None:
    with pytest.raises(BadTable, match="table 'table': ") as refused:
        hg.table(X, *arguments)
    assert says in str(refused.value)


def test_a_bad_argument_kind_or_name_is_refused() -> None:
    points = [0, 1], [0, 1]
    for x in ("x", None, sp.I, sp.Matrix([X]), [X]):
        with pytest.raises(BadTable, match="give"):
            hg.table(x, *points)
    with pytest.raises(
        BadTable, match="is taken at 3 expressions, and a table is a function of one or two; write it as"
    ):
        hg.table((X, X, X), *points)
    with pytest.raises(BadTable, match='write "linear" or "monotone"'):
        hg.table(X, *points, kind="cubic")
    with pytest.raises(BadName):
        hg.table(X, *points, name="a b")


def test_a_system_tells_its_tables_by_their_names() -> None:
    x, y = hg.Signal("x", low=0, high=1), hg.Signal("y")

    def system(*flow: sp.Expr) -> hg.System:
        return hg.System("s", states=(x,), outputs=(y,), flow=[sp.Add(*flow)], output=[x])

    a, b = (hg.table(x, [0, 1], [0, k], name="t") for k in (1, 2))
    assert system(a, a**2)
    with pytest.raises(BadSystem, match="two tables are called 't'"):
        system(a, b)
    with pytest.raises(BadSystem, match="a signal and a table are called 'x'"):
        system(hg.table(x, [0, 1], [0, 1], name="x"))
    with pytest.raises(BadSystem, match="jumps at its points"):
        system(a.diff(x))
    assert system(hg.table(x, [0, 1, 2], [0, 1, 3], kind="linear", name="u"))


# --- forms and certificates ---------------------------------------------------------------------------------


def cart(kind: str) -> hg.System:
    x, v = hg.Signal("x", "m", low=-1, high=3), hg.Signal("v", "m/s", low=-4, high=4)
    u, y = hg.Signal("u", "N", low=-1, high=1), hg.Signal("y", "m")
    friction = hg.table(v, [-5, -1, -0.1, 0, 0.1, 1, 5], [-2.3, -0.7, -1, 0, 1, 0.7, 2.3], kind=kind, name="friction")
    spring = hg.table(x, [-2, 0, 1, 4], [-3, 0, 0.5, 2.5], kind=kind, name="spring")
    return hg.System("cart", states=(x, v), inputs=(u,), outputs=(y,), flow=[v, u - friction - spring], output=[x])


@pytest.mark.ordinary("linear")
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_proved_of_a_table_is_verified_again(kind: str) -> None:
    form = hg.forms.triangular(cart(kind))
    assert all(check.verdict is Verdict.PROVED for check in form.checks)
    observer = hg.observers.high_gain(form, theta=60, poles=(-1, -1))
    content = hg.certificate(form, observer.checks, "high_gain")
    rows = recheck(json.dumps(content)).rows
    assert {row.id: row.found for row in rows} == dict.fromkeys(
        (*(str(c.id) for c in form.checks), "high_gain.convergence", "high_gain.theta"), "verified"
    )


@pytest.mark.full
def test_a_certificate_holds_the_longest_table() -> None:
    """Of numbers with all their digits."""
    x, y, draw = hg.Signal("x", low=0, high=1), hg.Signal("y"), Random(11)
    xs, ys = (sorted(-draw.random() for _ in range(MOST)) for _ in range(2))
    plant = hg.System("long", states=(x,), outputs=(y,), flow=[-hg.table(x, xs, ys, name="t") - x], output=[x])
    form = hg.forms.triangular(plant)
    assert {row.found for row in recheck(json.dumps(hg.certificate(form, form.checks))).rows} == {"verified"}


def test_a_certificate_of_another_table_is_not_verified() -> None:
    """Steeper by a quarter at its steepest, with the digests made again."""
    from hgogen.recheck.file import digest, model_digest

    form = hg.forms.triangular(cart("linear"))
    content = hg.certificate(form, form.checks)
    text = json.dumps({key: content[key] for key in ("plant", "form", "observer")})
    assert text.count("0.1, 1, 1") == 2  # once in the plant, once in the form
    about = json.loads(text.replace("0.1, 1, 1", "0.1, 5/4, 1"))
    forged = {**content, **about, "model": model_digest(about)}
    del forged["digest"]
    forged["digest"] = digest(forged)
    verdicts = {row.id: row.found for row in recheck(json.dumps(forged)).rows}
    assert verdicts.pop("triangular.lipschitz") == "fails"
    assert set(verdicts.values()) == {"verified"}


@pytest.mark.parametrize(
    ("maker", "claim", "lie"),
    [
        ("triangular", "lipschitz", {"bound": "2"}),
        ("uniform", "lipschitz", {"bound": "2"}),
        ("uniform", "slope_2", {"low": "1/2", "high": "2"}),
    ],
)
def test_a_derivative_that_jumps_is_not_verified_where_the_bisection_is_cut(
    maker: str, claim: str, lie: dict[str, str]
) -> None:
    """T bends at 1/2, in the middle of the range of v. A forger writes T'(v) in the place of T(v), which jumps there,
    and cuts the box there: on both leaves the slope of v + T'(v) is 1."""
    from hgogen.recheck.file import digest, model_digest

    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=2)
    bends = v + hg.table(v, [-4, sp.Rational(1, 2), 5], [0, 9, 100], name="T")
    flow = (v, bends) if maker == "triangular" else (bends, -x)
    form = getattr(hg.forms, maker)(_two_states(*flow, x=x, v=v))
    text = json.dumps(hg.certificate(form, form.checks))
    forged = json.loads(re.sub(r"Linear\((\w+), (\d),", lambda of: f"Linear({of[1]}, {int(of[2]) + 1},", text))
    (evidence,) = (each["evidence"] for each in forged["claims"] if each["id"] == f"{maker}.{claim}")
    evidence |= {"tree": "z2 . .", **lie}
    forged["model"] = model_digest(forged)
    forged["digest"] = digest(forged)
    (row,) = (each for each in recheck(json.dumps(forged)).rows if each.id == f"{maker}.{claim}")
    assert (row.found, "is not shown to be continuous" in row.sentence) == ("fails", True)


@pytest.mark.parametrize(
    "text",
    [
        "Linear(x, 0, 0, 1)",
        "Linear(x, 0, 0, 1, 0, 2)",
        "Linear(x, 0, 0, 1, 2)",
        "Linear(x, 1/2, 0, 1, 2, 3)",
        "Linear(x, 0, 0, 1, x, 2)",
        "Linear(x)",
        "Monotone(x, -1, 0, 1, 2, 3)",
        "Spline(x, 0, 0, 1, 2, 3)",
    ],
)
def test_the_checker_reads_no_table_that_is_none(text: str) -> None:
    from hgogen.recheck.text import Unreadable, expression

    with pytest.raises(Unreadable):
        expression(text, {"x"})
    assert expression("Linear(2*x, 0, 0, 1, 2, 3)", {"x"})


def test_no_slope_is_read_at_a_point_of_a_table() -> None:
    """By the checker, where a witness says that a slope is 0: there it is a set."""
    from hgogen.recheck.arithmetic import Unproved
    from hgogen.recheck.box import demand_differentiable
    from hgogen.recheck.text import expression

    text = expression("Linear(x**2, 0, 0, 1, 2, 1, 3, 4)", {"x"})
    demand_differentiable([text], {"x": Fraction(1)})
    for place in (text, expression("Linear(x + 2, 0, 0, 1, 2, 1, 3, 4)", {"x"})):
        with pytest.raises(Unproved):
            demand_differentiable([place], {"x": Fraction(0)})


def test_a_form_that_asks_for_more_smoothness_says_so() -> None:
    """phase differentiates the output twice along the flow of two states: lines have a kink, cubics one derivative."""
    x, v = hg.Signal("x", low=0, high=3), hg.Signal("v", low=-2, high=2)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    for kind in KINDS:
        t = hg.table(x, [0, 1, 2, 3], [0, 1, 3, 4], kind=kind, name="scale")
        plant = hg.System("p", states=(x, v), inputs=(u,), outputs=(y,), flow=[v, u - x], output=[t])
        assert all(check.verdict is Verdict.PROVED for check in hg.forms.uniform(plant).checks)
        checks = {str(check.id): check for check in hg.forms.phase(plant).checks}
        rank = checks["phase.rank"]
        assert rank.verdict is Verdict.UNKNOWN
        assert "has no derivative somewhere" in str(rank.reason)
        assert rank.fix
        assert hg.observability(plant).rank == 2  # between its ends; beyond them a table shows nothing


def test_beyond_the_image_of_the_plant_s_box_a_phase_form_s_table_is_held() -> None:
    """T(v)/(6 + v) is 1 on the box of v, where T is 6 + v; the box of z reaches to v = -5, where T is 5, and the slope
    of what is computed is -10 5/(6 + v)^2."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    flow = [v - 2 * x, 10 * hg.table(v, [-1, 1], [5, 7], name="T") / (6 + v)]
    form = hg.forms.phase(hg.System("p", states=(x, v), outputs=(hg.Signal("y"),), flow=flow, output=[x]))
    bound = lipschitz_bound(form.b, form.states, box(form.states))
    z = ca.SX.sym("z", 2)
    phi = ca.Function("phi", [z], to_casadi([form.b[1]], dict(zip(form.states, ca.vertsplit(z), strict=True))))
    low = form.states[1].low
    rise = abs(float(phi([-1, low + 1e-3]) - phi([-1, low]))) / 1e-3
    assert bound.verdict is Verdict.PROVED
    assert 40 < rise <= bound.high  # 2 of it without the table


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("held", [True, False])
def test_a_slope_beyond_a_table_is_0_or_that_at_its_ends(kind: str, held: bool) -> None:
    """At the last point as well, where a lookup takes the cell above."""
    cells = curve([-1, 0, 1], [0, 2, 3], kind, "T").clamping(held)
    first, second = (Lookup(cells, (order,)) for order in (1, 2))
    ends = [float(cells.clamping(False).of_order((1,))[k,][0]) for k in (0, 3)]
    bends = [float(cells.clamping(False).of_order((2,))[k,][0]) for k in (0, 3)]
    places = (-3, -1 - 2**-50, 1, 1 + 2**-50, 5)
    for lookup, (low, high) in ((first, ends), (second, bends)):
        expected = [0, 0, 0, 0, 0] if held else [low, low, high, high, high]
        assert [float(lookup.graph(x)) for x in places] == pytest.approx(expected)
    assert [float(Lookup(cells, (0,)).graph(x)) for x in (-3, 5)] == [0, 3]
    assert [each.name for each in (first, second)] == (
        ["flat_slope_T", "flat_slope_2_T"] if held else ["slope_T", "slope_2_T"]
    )
    assert Lookup(cells, (0,)) == Lookup(cells.clamping(not held), (0,))
    assert first != Lookup(cells.clamping(not held), (1,))


def _two_states(*flow: sp.Expr, x: hg.Signal, v: hg.Signal) -> hg.System:
    return hg.System("p", states=(x, v), outputs=(hg.Signal("y"),), flow=flow, output=[x])


@pytest.mark.parametrize("kind", KINDS)
def test_where_a_table_ends_with_the_ranges_what_is_computed_keeps_to_the_proved_slope(kind: str) -> None:
    """phi = -x + v T'(x) in the phase form; z_1 is clamped to the last point of T."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    form = hg.forms.phase(_two_states(v + hg.table(x, [-1, 1], [-2, 2], kind=kind, name="T"), -x, x=x, v=v))
    observer = hg.observers.high_gain(form, theta=50, poles=[-1, -1])
    bound = lipschitz_bound(form.b, form.states, box(form.states))
    z = ca.SX.sym("z", 2)
    b = ca.Function("b", [z], [observer.dynamics.nonlinear(z, ca.SX(0, 1))])
    assert bound.verdict is Verdict.PROVED
    assert {check.id: check for check in observer.checks}["high_gain.convergence"].verdict is Verdict.PROVED
    for inner, outer in (([0.999, 1], [1, 1]), ([0.999, 1], [1.1, 1]), ([-0.999, 1], [-1.1, 1])):
        rise = float(ca.norm_2(b(outer) - b(inner)))
        assert rise <= bound.high * math.dist(inner, outer)


@pytest.mark.ordinary("1-0.97-float", "1-0.97-double", "0.3-1.0-double", "0.7-0.7-double", "1.1-0.33-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize(("gain", "end"), [("1", 0.97), ("0.3", 1.0), ("0.7", 0.7), ("1.1", 0.33)])
def test_a_range_that_is_rounded_outward_past_a_table_has_its_slope_at_the_end(
    gain: str, end: float, real: str
) -> None:
    """z = 0.3 x is clamped to a number above 0.3, and z/0.3 lies beyond the last point, where phi may not jump."""
    x, v = hg.Signal("x", low=-end, high=end), hg.Signal("v", low=-1, high=1)
    T = hg.table(x, [-end, end], [-2, 2], name="T")
    y = hg.Signal("y")
    plant = hg.System("p", states=(x, v), outputs=(y,), flow=[v + T, -x], output=[sp.Rational(gain) * x])
    form = hg.forms.phase(plant)
    assert {check.id: check for check in form.checks}["phase.lipschitz"].verdict is Verdict.PROVED
    z = ca.SX.sym("z", 2)
    phi = hg.observers.high_gain(form, theta=50, poles=[-1, -1]).dynamics.nonlinear(z, ca.SX(0, 1))[1]
    at = evaluated(ca.Function("phi", [z], [phi]), real)
    kind = DTYPE[real]
    for place in form.states[0].interval:
        within, beyond = (float(at([[kind(a), kind(1)]])[0][0]) for a in (0.999 * place, place))
        assert beyond == pytest.approx(within, abs=0.01)


@pytest.mark.ordinary("xs0-v/3", "xs1-v", "xs2-v")
@pytest.mark.parametrize("argument", ["v", "-v", "v/3"])
@pytest.mark.parametrize("xs", [[-1, 1], [-1, 0.25, 1, 3], [-1, 1, 3]])
def test_where_a_point_of_a_table_ends_the_ranges_the_slope_beyond_counts(argument: str, xs: list[Any]) -> None:
    """dPhi/dx = diag(1, T'(..)), and it is never 0 on the ranges, beyond them it is. Where T ends there, a program goes
    on with its slope; else the rank is not proved."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    a = sp.sympify(argument, {"v": v})
    scale = sp.Rational(1, 3) if "3" in argument else 1
    ys = [min(place, 1) * 2 for place in xs]
    T = hg.table(a, [place * scale for place in xs], ys, name="T")
    form = hg.forms.phase(_two_states(T, -x, x=x, v=v), original=True)
    rank = {check.id: check for check in form.checks}["phase.rank"]
    if len(xs) > 2:
        assert rank.verdict is Verdict.UNKNOWN
        return
    assert rank.verdict is Verdict.PROVED
    dynamics = hg.observers.high_gain(form, theta=5, poles=[-1, -1]).dynamics
    z = ca.SX.sym("z", 2)
    outputs = [dynamics.pulled(ca.DM([1, 1]), z, ca.SX(0, 1), None), dynamics.jacobian(z, ca.SX(0, 1))[0, 1]]
    at = ca.Function("at", [z], outputs)
    slope = float(2 / scale) * (-1 if "-" in argument else 1) * float(scale)
    for place in (-1.5, -1, 0.5, 1, 1.5):
        pushed, steep = at([0, place])
        assert float(steep) == pytest.approx(slope)
        assert float(pushed[1]) == pytest.approx(1 / slope)


def _beside(end: float, real: str, count: int = 60) -> Iterator[Any]:
    """The numbers next to one."""
    for way in (-np.inf, np.inf):
        place = DTYPE[real](end)
        for _ in range(count):
            yield place
            place = np.nextafter(place, DTYPE[real](way))


@pytest.mark.ordinary(
    "v-ends0-xs0-bounds0-float",
    "v-ends0-xs0-bounds0-double",
    "v + 8-ends2-xs2-bounds2-double",
    "Min(v, 0)-ends3-xs3-bounds3-double",
    "v*4**9 + 8-ends5-xs5-bounds5-double",
    "v + 27315/100-ends6-xs6-bounds6-double",
    "I(v)-ends9-xs9-bounds9-double",
)
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize(
    ("argument", "ends", "xs", "bounds"),
    [
        ("v", (-1, 1), [-2, -1, 1, 2], (1, 300)),
        ("v", (1, 2), [-2, -1, 0, 1], (0, 0)),  # a range begins where the table ends
        ("v + 8", (1, 2), [6, 7, 8, 9], (0, 300)),
        ("Min(v, 0)", (-1, 1), [-2, -1, 0, 1], (1, 300)),
        ("Min(2*v, -v)", (-1, 1), [-2, -1, 0, 1], (1, 500)),
        ("v*4**9 + 8", (-1, 1), [8 - 2**19, 8, 8 + 2**18, 8 + 2**19], (0.5, 300)),
        ("v + 27315/100", (-1, 1), [270, 272, 274.15, 275.15], (0.2, 300)),
        ("v*(1 - v/4) + 27315/100", (0, 4), [272.15, 273.15, 274.15, 274.16], (1, 30_000)),
        ("1000*v - 1124", (1, 1.125), [-200, -99, 1, 2], (9, 300_000)),
        ("I(v)", (-1, 1), [-2, -1, 0, 1], (1, 300)),
    ],
)
def test_a_program_keeps_to_the_proved_slope_where_the_ranges_end_on_a_point(
    argument: str, ends: tuple[float, float], xs: list[float], bounds: tuple[float, float], real: str
) -> None:
    """Past the third point, at which the ranges end or to which the argument may be rounded, T has 200 times the slope.
    CasADi's slope of a minimum at its kink is the mean of both."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=ends[0], high=ends[1])
    tent = hg.table(v, [-1, 0, 1], [-1, 0, -1], name="I")
    inner = tent if argument == "I(v)" else sp.sympify(argument, {"v": v})
    T = hg.table(inner, xs, [-2, -1, 0, 200], name="T")
    form = hg.forms.triangular(_two_states(v, T, x=x, v=v))
    observer = hg.observers.high_gain(form, theta=5, poles=[-1, -1])
    z = ca.SX.sym("z", 2)
    slope = evaluated(ca.Function("slope", [z], [observer.dynamics.jacobian(z, ca.SX(0, 1))[1, 1]]), real)
    bound = lipschitz_bound(form.b, form.states, box(form.states))
    middle = sum(ends) / 2
    further = np.linspace(middle - 0.02, middle + 0.02, 801).astype(DTYPE[real])
    places = (*(place for end in (*ends, middle) for place in _beside(end, real)), *further)
    seen = [abs(float(slope([[DTYPE[real](0), place]])[0][0])) for place in places]
    assert bounds[0] <= max(seen) * (1 + 1e-6) + 1e-12
    assert max(seen) <= bound.high * (1 + 1e-5) <= bounds[1] * (1 + 1e-4)


def test_a_gain_that_is_updated_counts_the_slope_beyond_the_ranges() -> None:
    """Gamma at an estimate that is clamped to the end of the range of v, where T goes on with 100 times the slope."""
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    T = hg.table(v, [-1, 1, 2], [-1, 1, 101], name="T")
    form = hg.forms.triangular(_two_states(v, T, x=x, v=v))
    for cap, verdict in ((60, Verdict.UNKNOWN), (3000, Verdict.PROVED)):
        observer = hg.observers.updated_gain(form, p_1=1, p_2=2, p_3=10, cap=cap, poles=[-1, -1])
        check = {check.id: check for check in observer.checks}["updated_gain.cap"]
        assert check.verdict is verdict
        assert "100" in str(check.reason)


@pytest.mark.parametrize(
    ("real", "ends", "offset", "xs"),
    [("double", (0.1, 1), "0.7", [0.8, 1.9]), ("float", (0, 1.67), "1990.28", [1990.28, 1991.95])],
)
def test_an_argument_that_is_rounded_past_the_first_or_last_point_has_a_slope_within(
    real: str, ends: tuple[float, float], offset: str, xs: list[float]
) -> None:
    """0.1 + 0.7 is below 0.8 in doubles, and 1.67 + 1990.28 two steps above 1991.95 in single precision, where a state
    a little inside its range is no other argument. det dPhi/dx is proved to keep off 0, and is divided by."""
    x, v = hg.Signal("x", low=ends[0], high=ends[1]), hg.Signal("v", low=-1, high=1)
    T = hg.table(x + sp.Rational(offset), xs, [0, 3], name="T")
    plant = hg.System("p", states=(x, v), outputs=(hg.Signal("y"),), flow=[v, -v * x], output=[T])
    form = hg.forms.phase(plant, original=True)
    assert {check.id: check for check in form.checks}["phase.rank"].verdict is Verdict.PROVED
    z = ca.SX.sym("z", 2)
    pulled = hg.observers.high_gain(form, theta=5, poles=[-1, -1]).dynamics.pulled(ca.DM([1, 1]), z, ca.SX(0, 1), None)
    at = evaluated(ca.Function("at", [z], [pulled]), real)
    for place in (-1, *ends, 0.5, 2000):
        pushed = at([[DTYPE[real](place), DTYPE[real](0)]])[0]
        assert float(pushed[0]) == pytest.approx((xs[1] - xs[0]) / 3, rel=1e-3)


@pytest.mark.full
def test_the_cells_that_a_program_may_take_are_counted() -> None:
    """At the end of a range the one above, of a signal by itself; else those on both sides."""
    v, w = hg.Signal("v", low=-1, high=1), hg.Signal("w", low=-1, high=1)
    sides = dict.fromkeys((v, w), (Fraction(-1), Fraction(1)))

    def slopes(argument: sp.Expr, xs: list[Any]) -> tuple[float, float]:
        """T rises with the slopes 1, 2, 3, .."""
        ys = np.concatenate(([0], np.cumsum(np.diff(np.array(xs, dtype=object)) * range(1, len(xs))))).tolist()
        range_ = bound_of(hg.table(argument, xs, ys, name="T").diff(argument.free_symbols.copy().pop()), sides)
        return round(range_.low, 4), round(range_.high, 4)

    steep = hg.table(v, [-2, -1, 1, 2], [0, 1, 2, 9], name="T").diff(v)
    assert bounds.enclose(steep, sides) == pytest.approx((0.5, 7))
    assert bound_of(steep, sides).most is None  # v = 1 is not a point where the slope is 7
    assert slopes(v, [-2, -1, 1, 2]) == (2, 3)
    assert slopes(v, [-1, 1]) == (1, 1)
    assert slopes(v, [-1, 1, 2]) == (1, 2)
    assert slopes(v, [-1, 0.5]) == (0, 1)
    assert slopes(v, [-2, -1 - 2**-26, 1 + 2**-26, 2]) == (2, 3)
    assert slopes(v, [-2, -1 - 2**-10, 1 + 2**-10, 2]) == (2, 2)
    assert slopes(v + 7, [5, 6, 8, 9]) == (1, 3)
    assert slopes(v + 7, [6, 8]) == (1, 1)
    assert slopes(v + 7, [5, 6 - 2**-22, 8 + 2**-22, 9]) == (1, 3)
    assert slopes(v + 7, [5, 6 - 2**-10, 8 + 2**-10, 9]) == (2, 2)


def test_of_a_table_that_goes_on_a_program_takes_no_slope_but_within() -> None:
    """The bend of a cubic is linear, and would be steeper half a unit below the first point."""
    cells = curve([0, 1, 3], [0, 1, 5], "monotone", "T").clamping(False)
    counted = cells.rounding((Fraction(1, 2), Fraction(1, 2)))
    assert span(counted, 0, 3, 2) == span(cells, 0, 3, 2)
    assert span(counted, 0, Fraction(3, 4), 2) == span(cells, 0, Fraction(5, 4), 2) != span(cells, 0, Fraction(3, 4), 2)


def test_a_slope_beyond_that_decides_is_named() -> None:
    x, v = hg.Signal("x", low=-1, high=1), hg.Signal("v", low=-1, high=1)
    T = hg.table(v, [-1, 1, 2], [-1, 1, -5], name="T")
    check = {check.id: check for check in hg.forms.uniform(_two_states(T, -x, x=x, v=v)).checks}["uniform.slope_2"]
    assert (check.verdict, check.fix) == (Verdict.UNKNOWN, "")
    assert "the ranges end on 1 of the table T, whose slope beyond is taken there" in str(check.reason)


def test_how_far_an_argument_may_be_rounded() -> None:
    """By the errors of its parts, and their slopes; each computed in single precision keeps within."""
    v, w = sp.Symbol("v", real=True), sp.Symbol("w", real=True)
    around = Sides((v, w), ((Fraction(-1), Fraction(1)), (Fraction(1, 2), Fraction(2))))
    inner = hg.table(v, [-1, 0, 1], [0, 3, -2], name="I")
    draw = Random(3)

    def rounding(e: sp.Expr) -> tuple[float, float]:
        (axis,) = rounded(hg.table(e, [-10, 10], [0, 1], name="T"), around).cells.axes
        return tuple(map(float, axis.rounded))

    arguments = [
        *(v + 7, 1000 * v - 999, v * w - 3 * v, v**3 / w, sp.sqrt(w) * 100, sp.exp(3 * v) - 20, sp.sin(9 * v) + 4),
        *(sp.Abs(v) - w, sp.Max(v, w) * 8 - 7, inner + 100, sp.tanh(v) / w**2, sp.log(w) + sp.atan(v)),
        1 / (w - sp.Rational("0.499")),
    ]
    for e in arguments:
        z = ca.SX.sym("z", 2)
        program = evaluated(ca.Function("e", [z], to_casadi([e], {v: z[0], w: z[1]})), "float")
        for k in range(60):
            place = [draw.uniform(-1, 1), draw.uniform(0.5, 2) if k else 0.5]
            exactly = e.subs(dict(zip((v, w), map(sp.Rational, place), strict=True))).evalf(30)
            error = float(program([[np.float32(p) for p in place]])[0][0]) - float(exactly)
            below, above = rounding(e)
            assert -below <= error <= above
    assert rounding(v + 7)[1] < 2**-16
    assert rounding(sp.sign(v))[1] >= 2
    assert rounding(sp.Piecewise((1, v < 0), (-1, True)))[1] >= 2


def test_a_slope_is_not_taken_for_another_table_of_its_name() -> None:
    """The slope of T beside a table that is called T_1, T between its ends beside T_within_0: in SymPy's order, and in
    numpy's functions."""
    T, other, third = (
        hg.table(X, [0, 1, 2], ys, name=name)
        for name, ys in (("T", [0, 1, 3]), ("T_1", [5, 6, 5]), ("T_within_0", [8, 7, 9]))
    )
    between = one_sided(T, {X: (Fraction(0), Fraction(2))})
    for a, b, difference in ((T.diff(X), other, 1 - 5.5), (between, third, 0.5 - 7.5)):
        assert sp.Add(a, -b) == sp.Add(-b, a)
        assert sp.lambdify(X, a - b)(0.5) == difference


# --- plain text ---------------------------------------------------------------------------------------------

CELL = """
name = "cell"
[states.soc]
low = 0.1
high = 0.9
flow = "-i/9000"
[inputs.i]
low = -5
high = 5
[tables.ocv]
x = [0, 0.1, 0.5, 0.9, 1]
y = [2.9, 3.42, 3.68, 4.07, 4.18]
kind = "monotone"
[outputs.y]
equation = "ocv(soc) - 0.02*i"
"""


def cell(text: str = CELL) -> hg.System:
    return text_model.from_table(tomllib.loads(text)).plant


def test_a_table_in_plain_text_is_that_in_python() -> None:
    plant = cell()
    soc, i = plant.states[0], plant.inputs[0]
    ocv = hg.table(soc, [0, 0.1, 0.5, 0.9, 1], [2.9, 3.42, 3.68, 4.07, 4.18], kind="monotone", name="ocv")
    assert plant.output[0] == ocv - i / 50
    assert cell(text_model.to_text(plant)) == plant
    assert all(check.verdict is Verdict.PROVED for check in hg.forms.uniform(plant).checks)


def test_a_text_about_a_plant_may_call_its_tables() -> None:
    """ocv(soc) on [0.1, 0.9] and on [0.2, 1.8] as ocv(2 soc), which is held."""
    at, held = hg.bound("ocv(soc)", cell()), hg.bound("ocv(2*soc)", cell())
    assert (float(at.low), float(at.high)) == pytest.approx((3.42, 4.07), rel=1e-9)
    assert float(held.high) == pytest.approx(4.18, rel=1e-9)


def test_a_number_that_no_text_holds_is_refused() -> None:
    x, y = hg.Signal("x", low=0, high=1), hg.Signal("y")
    third = hg.table(x, [0, 1], [0, sp.Rational(1, 3)], name="t")
    plant = hg.System("third", states=(x,), outputs=(y,), flow=[-third], output=[x])
    with pytest.raises(text_model.NoText, match="y of the table t has a number that is no decimal"):
        text_model.to_text(plant)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("x = [0, 0.1,", "x = [0, 0.6,", "tables.ocv: table 'ocv': xs 2 and 3, 0.6 and 0.5, do not increase"),
        ("x = [0, ", "x = [", "has 4 xs and 5 ys"),
        ("x = [0, 0.1, 0.5, 0.9, 1]\n", "", "tables.ocv: the key 'x' is missing; add x = [0"),
        ('kind = "monotone"', 'kind = "spline"', 'write "linear" or "monotone"'),
        ("y = [2.9", 'y = ["2.9"', "tables.ocv.y: is a list; write a list of numbers"),
        ("[tables.ocv]", "[tables.exp]", "has the name of a function"),
        ("[tables.ocv]", "[tables.ocw]", "there is no function 'ocv'; did you mean ocw?"),
        ("[tables.ocv]", "[tables.i]\nx = [0, 1]\ny = [0, 1]\n[tables.ocv]", "a signal is called 'i' as well"),
        ("ocv(soc)", "ocv(soc, 1)", "the table ocv of column 1 needs ')' here"),
        ("ocv(soc)", "ocv", "the table ocv needs its argument; write ocv(...)"),
        ("ocv(soc)", "ocv()", "stands where a number, a name or a parenthesis belongs"),
    ],
)
def test_a_bad_table_in_plain_text_is_refused_with_its_place(old: str, new: str, says: str) -> None:
    with pytest.raises(text_model.BadModelFile) as refused:
        cell(CELL.replace(old, new))
    assert says in str(refused.value)


@pytest.mark.parametrize("name", ["tables", "one_state"])
def test_header_and_manual_say_that_static_data_do_not_change(name: str) -> None:
    files = emitted.files(name)
    assert "No heap, no recursion, no static data but constant tables." in files[f"{emitted.step(name).name}.h"]
    assert "No heap, no recursion, no static data that changes, for tables are constant" in emitted.manual(files)


# --- Frama-C ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_eva_raises_no_alarm(kind: str, tmp_path: Path) -> None:
    """Every index is shown to be in range, for any float, infinite and not a number among them."""
    cells = curve([0, 0.1, 0.3, 0.7, 1.5], [0, 1, -1, 2, 3], kind, "t")
    text = "\n".join(tables(C, "t", "float", [Lookup(cells, (order,)) for order in range(2)]).lines)
    main = "static volatile float any;\nint main(void) { return t_table_t(any) < t_flat_slope_t(any); }\n"
    hg.write({"main.c": f"{text}\n{main}"}, tmp_path)
    options = ["-eva-precision=3", "-warn-special-float=none"]
    said = emitted.run([emitted.tool("frama-c"), "-eva", *options, "main.c"], tmp_path)
    assert " 0 alarms generated" in said
    assert "NON TERMINATING" not in said


def test_bits_are_those_of_struct() -> None:
    """That `same` tells one bit."""
    a = np.array([1.0, math.nan], np.float64)
    b = np.frombuffer(struct.pack("<dd", math.nextafter(1.0, 2), math.nan), np.float64)
    assert same(a, a)
    assert not same(a, b)
    assert issubclass(Stepped, Table)


def test_a_derivative_has_no_value_where_it_jumps() -> None:
    x, y = ((Fraction(0), Fraction(1), Fraction(2)), (Fraction(0), Fraction(1), Fraction(3)))
    table = curve(x, y, "linear", "bend")
    assert [value_of(table, Fraction(place), 1) for place in (Fraction(1, 2), 1, Fraction(3, 2))] == [1, None, 2]


def test_a_held_table_and_one_that_goes_on_stand_in_one_expression() -> None:
    x, points = sp.Symbol("x"), ((Fraction(0), Fraction(1)), (Fraction(0), Fraction(2)))
    held, on = (call(curve(*points, "linear", "two").clamping(h), x) for h in (True, False))
    assert sp.lambdify(x, held + 10 * on)(2.0) == 42.0


def test_the_checker_knows_which_derivative_of_a_table_jumps() -> None:
    numbers = list(map(Fraction, (0, 0, 1, 1, 2, 3)))
    names = [tables_module.name_of("Linear", [Fraction(order), *numbers]) for order in (0, 1)]
    assert [tables_module.jumps(name) for name in names] == [False, True]


def test_the_checker_s_ranges_of_cubics_end_where_their_pieces_do() -> None:
    numbers = list(map(Fraction, (0, 0, 1, 1, 2, 3, 3, 3)))
    value, bend = (rechecked.name_of("Monotone", [Fraction(order), *numbers]) for order in (0, 2))
    half = rechecked.value_at(value, [Fraction(1, 2)])
    for high in (Fraction(5, 2), math.inf):  # at rest from 2 on
        assert rechecked.range_on(value, [(Fraction(1, 2), high)]) == (half, 3)
    assert rechecked.range_on(bend, [(Fraction(1), Fraction(1))]) == (Fraction(1, 3), Fraction(20, 3))
    assert rechecked.value_at(bend, [Fraction(1)]) is None  # it jumps there


def test_a_third_derivative_that_jumps_is_the_checker_s_too() -> None:
    """At 2 the chords turn round, and value, slope and bend are continuous: only the third derivative jumps."""
    numbers = list(map(Fraction, (0, 0, 1, 3, 2, 0, 3, 7)))
    third, fourth = (rechecked.name_of("Monotone", [Fraction(order), *numbers]) for order in (3, 4))
    assert rechecked.table_of(third)[0].jumps == ((1, 2, 3, 1),)
    around = [(Fraction(3, 2), Fraction(5, 2))]
    least, most = rechecked.range_on(third, around)
    assert least < most
    assert rechecked.range_on(fourth, around) is None
    assert rechecked.range_on(fourth, [(Fraction(5, 4), Fraction(7, 4))]) == (0, 0)
    assert curve(numbers[::2], numbers[1::2], "monotone", "turned").smooth == ((1, 2, 3, 1),)


@pytest.mark.parametrize("second", [1.000000001, 1.0000002])
def test_points_that_are_one_number_in_float_are_refused_there(second: float) -> None:
    """Between them the table rises from 1 to 100, which would be a jump: the bound of its slope is of no jump."""
    x, v, y = (hg.Signal(name, low=0, high=1) for name in "xvy")
    table = hg.table(x, [0, 1, second], [0, 1, 100])
    plant = hg.System("merged", states=(x, v), outputs=(y,), flow=[v, -table], output=[x])
    step = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1, 1], R=1), dt=0.01)
    ys = np.full((3, 1), 0.5)
    assert hg.targets.c99(step, real="double", check=False)
    assert np.isfinite(step.run(y=ys, engine="python").x).all()
    if second == 1.0000002:  # a float apart
        assert hg.targets.c99(step, real="float", check=False)
        return
    for carry_out in (
        lambda: hg.targets.c99(step, real="float", check=False),
        lambda: hg.targets.rust(step, real="float", check=False),
        lambda: hg.sample(step.observer, dt=0.01, real="float", engine="python").run(y=ys),
    ):
        with pytest.raises(PointsMerge, match=r"points 1\.0 and 1\.000000001, which are one number in float; take"):
            carry_out()
