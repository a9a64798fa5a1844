"""Tables of two arguments: bilinear maps in models, proofs, graphs, emitted code and certificates, against SciPy, exact
rationals, and dense samples of random maps."""

import copy
import json
import math
import pickle
import tomllib
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise, product
from pathlib import Path
from random import Random

import casadi as ca
import emitted
import numpy as np
import pytest
import sympy as sp
from falsehood import falsehood
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.check import Verdict
from hgogen.emit.code import code
from hgogen.emit.cost import cost
from hgogen.emit.portable import tables
from hgogen.emit.pygraph import evaluated
from hgogen.emit.syntax import DTYPE
from hgogen.emit.syntaxes import C
from hgogen.graph import to_casadi
from hgogen.reading import text_model
from hgogen.reading.declared import MOST, BadTable, cells_of
from hgogen.recheck import tables as rechecked
from hgogen.recheck.arithmetic import Unproved
from hgogen.recheck.box import demand_differentiable
from hgogen.recheck.file import digest, model_digest
from hgogen.recheck.text import Unreadable, expression
from hgogen.recheck.verification import recheck
from hgogen.rigor.bounds import as_programmed, nonzero
from hgogen.rigor.box import Sides
from hgogen.rigor.enclosure import enclose
from hgogen.rigor.lookup import Cells, Kinked, Lookup, Stepped, applied, hessian, jacobian
from hgogen.rigor.series import BallSeries, Undecided, values
from hgogen.rigor.singular import one_sided
from hgogen.rigor.slope import lipschitz_bound
from hgogen.rigor.tape import tape
from hgogen.system import BadSystem

X, Y = sp.symbols("x y", real=True)
Box = Sequence[tuple[float, float]]
ORDERS = list(product(range(3), repeat=2))


def drawn(draw: Random, most: int = 5) -> Cells:
    """A map with flat patches, steep ones, and at times without any kink inside."""
    xs, ys = (sorted(draw.sample(range(-16, 16), draw.randint(2, most))) for _ in range(2))
    plane = draw.random() < 0.2
    rows = [
        [x - 2 * y if plane else draw.choice((draw.randint(-5, 5), draw.randint(-90, 90), 1)) for y in ys] for x in xs
    ]
    fractions = [[Fraction(z, 3) for z in row] for row in rows]
    return cells_of([[Fraction(x, 4) for x in xs], [Fraction(y, 4) for y in ys]], fractions, "linear", "drawn")


def sides(draw: Random, cells: Cells) -> list[tuple[float, float]]:
    """A box that ends on lines of the grid, between them, and beyond them; or that has no width."""
    ends = ([*map(float, axis.x), -5.0, 5.0, *(draw.uniform(-4, 4) for _ in range(3))] for axis in cells.axes)
    return [(low, high) for low, high in (sorted(draw.choices(each, k=2)) for each in ends)]


def points(cells: Cells, box: Box) -> list[list[Fraction]]:
    """Of each axis places of a box: its ends, those of the grid with their neighbours, and some between."""
    return [
        [
            Fraction(t)
            for t in sorted({low, high, *np.linspace(low, high, 3).tolist(), *around(axis.x)})
            if low <= t <= high
        ]
        for axis, (low, high) in zip(cells.axes, box, strict=True)
    ]


def around(places: Sequence[Fraction]) -> list[float]:
    return [float(x) + d for x in places for d in (-1e-6, 0, 1e-6)]


def exactly(cells: Cells, x: Fraction, y: Fraction) -> Fraction:
    """The map by its definition: the mean of the four points around, weighted by the opposite areas."""
    (a, s), (c, t) = [_part(axis.x, v) for axis, v in zip(cells.axes, (x, y), strict=True)]
    (low, high), b = (cells.values[a], cells.values[a + 1]), c + 1
    return (1 - s) * (1 - t) * low[c] + s * (1 - t) * high[c] + (1 - s) * t * low[b] + s * t * high[b]


def _part(places: Sequence[Fraction], t: Fraction) -> tuple[int, Fraction]:
    """The place below, and what part of the way to the next one is gone."""
    k = max((k for k in range(len(places) - 1) if places[k] <= t), default=0)
    return k, min(max((t - places[k]) / (places[k + 1] - places[k]), Fraction(0)), Fraction(1))


# --- the function -------------------------------------------------------------------------------------------


def test_it_is_scipy_s_inside_and_held_at_its_ends() -> None:
    """Within the rounding of four products of numbers below 30 in weights that add to 1."""
    from scipy.interpolate import RegularGridInterpolator

    draw = Random(1)
    for _ in range(25):
        cells = drawn(draw)
        xs, ys = (np.array(list(map(float, axis.x))) for axis in cells.axes)
        other = RegularGridInterpolator((xs, ys), np.array(cells.values, float))
        at = [(draw.uniform(-5, 5), draw.uniform(-5, 5)) for _ in range(60)]
        clamped = [(np.clip(x, xs[0], xs[-1]), np.clip(y, ys[0], ys[-1])) for x, y in at]
        numpy_s = sp.lambdify((X, Y), applied(cells, (X, Y)))(*np.array(at).T)
        exact = [float(cells.at((Fraction(x), Fraction(y)), (0, 0))) for x, y in at]
        assert np.allclose(exact, other(clamped), rtol=0, atol=1e-12)
        assert np.allclose(numpy_s, exact, rtol=0, atol=1e-12)


def test_its_slopes_are_those_of_its_patches() -> None:
    """(1 - t)(z_10 - z_00)/h + t (z_11 - z_01)/h in x, inside of a patch; 0 along an axis beyond its ends."""
    draw = Random(2)
    for _ in range(25):
        cells = drawn(draw)
        (xs, ys), z = (axis.x for axis in cells.axes), cells.values
        for (k, (a, b)), (m, (c, d)) in product(enumerate(pairwise(xs)), enumerate(pairwise(ys))):
            s, t = Fraction(draw.randint(1, 9), 10), Fraction(draw.randint(1, 9), 10)
            at = a + s * (b - a), c + t * (d - c)
            low, high = ((z[k + 1][m + i] - z[k][m + i]) / (b - a) for i in (0, 1))
            left, right = ((z[k + i][m + 1] - z[k + i][m]) / (d - c) for i in (0, 1))
            assert cells.at(at, (1, 0)) == (1 - t) * low + t * high
            assert cells.at(at, (0, 1)) == (1 - s) * left + s * right
            assert cells.at(at, (1, 1)) == (high - low) / (d - c)
            assert cells.at(at, (2, 0)) == cells.at(at, (0, 2)) == 0
            beyond = xs[0] - 1, at[1]
            assert (cells.at(beyond, (1, 0)), cells.at(beyond, (1, 1))) == (0, 0)
            assert cells.at(beyond, (0, 1)) == (z[0][m + 1] - z[0][m]) / (d - c)


def test_a_slope_jumps_across_its_own_lines_only() -> None:
    """In x at a line of x, where its value is a set; across a line of y it is continuous."""
    cells = cells_of([[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [3, 4, 9], [1, 1, 1]], "linear", "t")
    half = Fraction(1, 2)
    assert cells.at((half, 1), (1, 0)) == 3
    assert cells.at((1, half), (1, 0)) is None
    assert cells.limits([(1, 1), (half, half)], (1, 0))[0] == (Fraction(-5, 2), 3)
    assert cells.limits([(1, 1), (1, 1)], (1, 1))[0] == (Fraction(-5, 2), 2)
    assert cells.limits([(half, 1), (0, 1)], (1, 0))[0] == (3, 3)  # of a box that ends on a line the patch within
    assert cells.limits([(half, 1.5), (0, 1)], (2, 0))[0] is None
    assert cells.limits([(half, half), (half, 1.5)], (2, 0))[0] == (0, 0)
    plane = cells_of([[0, 1, 2], [0, 1]], [[0, 1], [2, 3], [4, 5]], "linear", "t")
    assert plane.smooth == ((1, 1000, 1), (1, 1))


def test_a_map_is_a_value_of_sympy() -> None:
    f = hg.table((2 * X, Y), ([0, 1, 2], [0, 1]), [[0, 1], [1, 2], [4, 5]], name="map")
    assert (str(f), str(f.diff(X)), str(f.diff(Y))) == ("map(2*x, y)", "2*map(2*x, y, 1, 0)", "map(2*x, y, 0, 1)")
    assert f.diff(X, Y) == f.diff(Y, X)
    assert f == hg.table([2 * X, Y], [[0, 1, 2], (0, 1)], np.array([[0, 1], [1, 2], [4, 5.0]]), name="map")
    assert pickle.loads(pickle.dumps(f)) == copy.deepcopy(f) == f
    assert f.subs({X: sp.Rational(3, 4), Y: sp.Rational(1, 2)}) == 3
    assert f.subs(Y, sp.Rational(1, 2)).free_symbols == {X}  # along a line it is no number yet
    assert abs(f.subs({X: sp.sqrt(2) / 2, Y: sp.pi / 4}).evalf() - (3 * math.sqrt(2) - 2 + math.pi / 4)) < 1e-12
    assert sp.latex(f) == r"\mathrm{map}\left(2 x, y\right)"
    assert sp.latex(f.diff(Y)) == r"\mathrm{map}^{\left(0,1\right)}\left(2 x, y\right)"
    assert isinstance(f, Kinked)
    assert isinstance(f.diff(Y), Stepped)


# --- ranges -------------------------------------------------------------------------------------------------


def test_ranges_are_exact() -> None:
    """Of the value: at the corners that a box and the lines within it make, no less and no more. Of a derivative, what
    is reached inside of the box."""
    draw = Random(3)
    for _ in range(25):
        cells = drawn(draw, 4)
        for box in (sides(draw, cells) for _ in range(3)):
            at = points(cells, box)
            reached = [exactly(cells, x, y) for x, y in product(*at)]
            assert cells.limits(box, (0, 0))[0] == (min(reached), max(reached))
            inside = [[t for t in ts if low < t < high or low == high] for ts, (low, high) in zip(at, box, strict=True)]
            for order in ORDERS:
                ends, seen = cells.limits(box, order)[0], [cells.at(place, order) for place in product(*inside)]
                smooth = cells.least_smooth(cells.overlapped(box))
                assert (ends is None) == any(jump < k for jump, k in zip(smooth, order, strict=True))
                assert ends is None or all(ends[0] <= value <= ends[1] for value in seen if value is not None)
            low, high = cells.limits(box, (1, 0))[0]
            steps = [(exactly(cells, b, y) - exactly(cells, a, y)) / (b - a) for a, b in pairwise(at[0]) for y in at[1]]
            assert not steps or (low <= min(steps) and max(steps) <= high and {low, high} <= {*steps})


@pytest.mark.ordinary("inner0", "inner5")
@pytest.mark.parametrize(
    "inner", [(X, Y), (X, X), (X, -X), (X**2 - 1, Y), (X + Y, X - Y), (X, sp.Rational(1, 4)), (sp.Min(X, 1), X * Y)]
)
def test_enclosures_hold_values_and_chords(inner: tuple[sp.Expr, sp.Expr]) -> None:
    """Along both axes and along the diagonal, where the arguments depend on each other too: chords between points on
    lines and corners of the grid and next to them."""
    draw, inside = Random(str(inner)), sp.lambdify((X, Y), inner)
    for _ in range(12):
        cells = drawn(draw)
        program = tape([applied(cells, inner)], (X, Y))
        boxes = [sides(draw, cells) for _ in range(6)]
        low, high = (np.array([[box[k][i] for box in boxes] for k in (0, 1)]) for i in (0, 1))
        (enclosure,) = enclose(program, low, high, slopes=True)
        assert enclosure.defined.all()
        assert enclosure.continuous.all()
        for k, box in enumerate(boxes):
            xs, ys = (ts[:: 1 + len(ts) // 12] for ts in points(cells, box))
            z = {place: exactly(cells, *map(Fraction, inside(*place))) for place in product(xs, ys)}
            assert all(enclosure.value[0][k] <= value <= enclosure.value[1][k] for value in z.values())
            slopes = [(enclosure.slope[0][i][k], enclosure.slope[1][i][k]) for i in (0, 1)]
            steps = [(b - a, 0, (a, y), (b, y)) for a, b in pairwise(xs) for y in ys]
            steps += [(0, d - c, (x, c), (x, d)) for c, d in pairwise(ys) for x in xs]
            steps += [(b - a, d - c, (a, c), (b, d)) for (a, b), (c, d) in product(pairwise(xs), pairwise(ys))]
            for dx, dy, start, end in steps:
                rise = z[end] - z[start]
                bounds = [
                    sum(Fraction(slope[i]) * d for slope, d in zip(slopes, (dx, dy), strict=True)) for i in (0, 1)
                ]
                assert bounds[0] <= rise <= bounds[1]


def test_a_corner_has_all_its_slopes_along_the_diagonal() -> None:
    """f(x, x) at a corner of the grid, whose four patches have slopes of their own in x and in y."""
    cells = cells_of([[0, 1, 2], [0, 1, 2]], [[0, 0, 0], [0, 1, 5], [0, 2, 0]], "linear", "t")
    program = tape([applied(cells, (X, X))], (X,))
    low, high = np.array([[0.5, 1.0, 1.0, 0.5]]), np.array([[1.5, 1.0, 1.5, 1.0]])
    (enclosure,) = enclose(program, low, high, slopes=True)
    for k, (a, b) in enumerate(zip(low[0], high[0], strict=True)):
        rises = [
            cells.at((q, q), (0, 0)) - cells.at((p, p), (0, 0))
            for p, q in pairwise(map(Fraction, np.linspace(a, b, 9)))
        ]
        bounds = [Fraction(ends[0][k]) * Fraction(b - a) / 8 for ends in enclosure.slope]
        assert all(bounds[0] <= rise <= bounds[1] for rise in rises)
    assert [float(ends[0][1]) for ends in enclosure.slope] == pytest.approx([2, 5])  # in x 1, in y from 1 to 4
    assert enclosure.continuous.all()


def test_a_slope_that_jumps_has_no_slope_across_its_lines() -> None:
    """In x; in y it has one."""
    cells = cells_of([[0, 1, 2], [0, 1, 2]], [[0, 1, 2], [1, 3, 7], [5, 4, 3]], "linear", "t")
    program = tape([applied(cells, (X, Y), (1, 0))], (X, Y))
    low, high = (
        np.array([[0.5, 0.5, 1.0, 0.5], [0.5, 0.0, 0.5, 0.5]]),
        np.array([[1.5, 1.0, 1.0, 1.0], [0.5, 1.0, 1.0, 1.5]]),
    )
    (enclosure,) = enclose(program, low, high, slopes=True)
    assert enclosure.defined.all()
    assert enclosure.continuous.tolist() == [False, True, False, True]
    assert np.isfinite(enclosure.slope[1][0]).tolist() == [False, True, False, True]
    assert np.isfinite(enclosure.slope[1][1]).all()
    assert enclosure.slope[0][1][1:] == pytest.approx([1, -3, 1])
    assert enclosure.slope[1][1][1:] == pytest.approx([1, 1, 3])


def test_on_a_box_it_is_held_where_it_may_leave_its_grid_only() -> None:
    cells = cells_of([[0, 1, 2], [0, 1]], [[0, 1], [2, 3], [4, 5]], "linear", "t")
    box = {X: (Fraction(0), Fraction(2)), Y: (Fraction(0), Fraction(2))}
    free = one_sided(applied(cells, (X, Y)), box)
    assert [axis.clamped for axis in free.cells.axes] == [False, True]
    assert free.cells.smooth == ((1000, 1000, 1000), (1, 1))
    assert free.cells.clamping() == cells
    assert not isinstance(free.diff(X), Stepped)
    assert sp.lambdify((X, Y), free + 10 * applied(cells, (X, Y)))(3.0, 0.5) == 6.5 + 45
    on = free.cells
    assert on.limits([(-1, 3), (0, 1)], (0, 0))[0] == (-2, 7)
    assert on.limits([(-math.inf, 3), (0, 1)], (0, 0))[0] == (-math.inf, math.inf)
    assert on.limits([(-math.inf, 3), (0, 1)], (1, 0))[0] == (2, 2)


def test_values_at_points_are_balls_around_the_exact_ones() -> None:
    draw = Random(5)
    for _ in range(20):
        cells = drawn(draw)
        for order in ORDERS:
            program = tape([applied(cells, (X, Y), order)], (X, Y))
            for _ in range(6):
                place = [draw.choice([*axis.x, Fraction(draw.randint(-90, 90), 21)]) for axis in cells.axes]
                (ball,), exact = values(program, place), cells.at(place, order)
                if exact is None:
                    assert not ball.is_finite()
                elif ball.is_finite():
                    assert Fraction(str(ball.lower().fmpq())) <= exact <= Fraction(str(ball.upper().fmpq()))


def test_balls_of_a_series_keep_within_one_patch() -> None:
    """At a line of the grid they do not say which patch is meant; elsewhere they give the value and both slopes."""
    cells = cells_of([[0, 1, 2], [0, 1, 2]], [[0, 1, 2], [1, 3, 7], [5, 4, 3]], "linear", "t")
    balls = BallSeries(0)
    half, line = (balls.number(Fraction(place), 2) for place in ("1/2", "1"))
    assert [float(each[0]) for each in balls.table(cells, (0, 0), half, half)] == [1.25, 1.5, 1.5]
    for place in ([half, line], [line, half], [line, line]):
        with pytest.raises(Undecided):
            balls.table(cells, (0, 0), *place)


@st.composite
def maps(draw: st.DrawFn) -> tuple[Cells, list[tuple[Fraction, Fraction]]]:
    """A map and a box."""
    places = st.lists(st.integers(-12, 12), min_size=2, max_size=4, unique=True).map(sorted)
    xs, ys = draw(places), draw(places)
    numbers = st.integers(-20, 20)
    rows = draw(st.lists(st.lists(numbers, min_size=len(ys), max_size=len(ys)), min_size=len(xs), max_size=len(xs)))
    ends = st.lists(st.integers(-13, 13), min_size=2, max_size=2, unique=True).map(sorted)
    box = [(Fraction(low), Fraction(high)) for low, high in (draw(ends), draw(ends))]
    return cells_of([xs, ys], rows, "linear", "t"), box


@pytest.mark.full
@settings(max_examples=25)
@given(maps(), st.booleans())
def test_lipschitz_bounds_hold_the_steepest_chord(
    drawn_map: tuple[Cells, list[tuple[Fraction, Fraction]]], diagonal: bool
) -> None:
    """On the box and along f(x, x), a bound that the slopes of a patch attain within its 2 percent."""
    cells, box = drawn_map
    both = [(max(low, box[1][0]), min(high, box[1][1])) for low, high in box[:1]] * 2 if diagonal else box
    if both[0][0] >= both[0][1]:
        return
    ranges = dict(zip((X, Y), both, strict=True))
    inner, names = ((X, X), (X,)) if diagonal else ((X, Y), (X, Y))
    bound = lipschitz_bound([applied(cells, inner)], names, {name: ranges[name] for name in names})
    assert bound.verdict is Verdict.PROVED
    xs, ys = points(cells, [(float(low), float(high)) for low, high in both])
    steps = list(zip(pairwise(xs), pairwise(xs), strict=True)) if diagonal else product(pairwise(xs), pairwise(ys))
    steepest = 0.0
    for (a, b), (c, d) in steps:
        rise = exactly(cells, b, d) - exactly(cells, a, c)
        steepest = max(steepest, abs(float(rise)) / math.hypot(b - a, 0 if diagonal else d - c))
    assert steepest <= bound.high * (1 + 1e-9)
    counted = as_programmed(applied(cells, inner), Sides(names, tuple(ranges[name] for name in names))).cells
    ends = [counted.limits(both, order)[0] for order in ((1, 0), (0, 1))]
    most = [float(max(map(abs, each))) for each in ends]
    assert bound.high <= 1.03 * (sum(most) if diagonal else math.hypot(*most)) + 1e-9


def test_what_a_slope_that_turns_or_rests_is_not_shown() -> None:
    box = {X: (Fraction(0), Fraction(2)), Y: (Fraction(0), Fraction(2))}
    for rows, proved in (
        ([[0, 1], [1, 3], [3, 4]], True),
        ([[0, 1], [1, 1], [3, 4]], False),
        ([[0, 1], [2, 3], [1, 4]], False),
    ):
        sign = nonzero(applied(cells_of([[0, 1, 2], [0, 2]], rows, "linear", "t"), (X, Y)).diff(X), box)
        assert (sign.verdict is Verdict.PROVED) == proved
    wide = {**box, X: (Fraction(-1), Fraction(2))}  # flat beyond its ends
    rise = applied(cells_of([[0, 1, 2], [0, 2]], [[0, 1], [1, 3], [3, 4]], "linear", "t"), (X, Y)).diff(X)
    assert nonzero(rise, wide).verdict is not Verdict.PROVED


# --- the checker --------------------------------------------------------------------------------------------


def numbers_of(cells: Cells) -> list[Fraction]:
    xs, ys = (axis.x for axis in cells.axes)
    return [Fraction(len(xs)), *xs, *ys, *(z for row in cells.values for z in row)]


def test_the_checker_s_own_maps_have_the_same_ranges() -> None:
    """By sums of weighted values, where the proofs have polynomials."""
    draw = Random(6)
    for _ in range(30):
        cells = drawn(draw)
        for box in [*(sides(draw, cells) for _ in range(4)), [(-math.inf, 0.5), (-math.inf, math.inf)]]:
            for order in ORDERS:
                name = rechecked.name_of("Bilinear", [*map(Fraction, order), *numbers_of(cells)])
                assert rechecked.range_on(name, box) == cells.limits(box, order)[0]
        name = rechecked.name_of("Bilinear", [Fraction(0), Fraction(0), *numbers_of(cells)])
        slopes = [rechecked.next_of(name, k) for k in (0, 1)]
        assert [rechecked.table_of(each)[1] for each in (name, *slopes)] == [(0, 0), (1, 0), (0, 1)]
        assert [rechecked.jumps(each) for each in (name, *slopes)] == [
            False,
            *(min(each) == 1 for each in cells.smooth),
        ]


@pytest.mark.parametrize(
    "numbers",
    [
        "0, 0, 2, 0, 1, 0, 1, 1, 2, 3",  # a value is missing
        "0, 0, 2, 0, 1, 0, 1, 1, 2, 3, 4, 5",
        "0, 0, 1, 0, 0, 1, 1, 2",  # one place
        "0, 0, 3, 0, 1, 2, 0, 1, 2, 3",
        "0, 0, 2, 1, 0, 0, 1, 1, 2, 3, 4",
        "0, 0, 2, 0, 1, 1, 1, 1, 2, 3, 4",
        "0, 1/2, 2, 0, 1, 0, 1, 1, 2, 3, 4",
        "0, 0, 5/2, 0, 1, 0, 1, 1, 2, 3, 4",
        "0, 0, -1, 0, 1, 0, 1, 1, 2, 3, 4",
        "0, 9, 2, 0, 1, 0, 1, 1, 2, 3, 4",
        "0, 0, 2, 0, 1, 0, x, 1, 2, 3, 4",
        "0, 0",
        "0",
    ],
)
def test_the_checker_reads_no_map_that_is_none(numbers: str) -> None:
    with pytest.raises(Unreadable):
        expression(f"Bilinear(x, y, {numbers})", {"x", "y"})
    assert expression("Bilinear(2*x, y, 0, 0, 2, 0, 1, 0, 1, 1, 2, 3, 4)", {"x", "y"})


def test_no_slope_is_read_on_a_line_of_a_map() -> None:
    """By the checker, where a witness says that a slope is 0: there it is a set."""
    text = expression("Bilinear(x, y**2, 0, 0, 2, 0, 2, 1, 4, 1, 2, 3, 5)", {"x", "y"})
    demand_differentiable([text], {"x": Fraction(1), "y": Fraction(3, 2)})
    for x, y in ((0, Fraction(3, 2)), (1, 2), (2, -1)):
        with pytest.raises(Unproved):
            demand_differentiable([text], {"x": Fraction(x), "y": Fraction(y)})


def cart(*, both: bool = False) -> hg.System:
    """A cart with friction over the speed and the temperature; with `both` over the speed and the position."""
    x, v = hg.Signal("x", "m", low=-1, high=3), hg.Signal("v", "m/s", low=-4, high=4)
    u, T = hg.Signal("u", "N", low=-1, high=1), hg.Signal("T", "degC", low=-20, high=60)
    y = hg.Signal("y", "m")
    speeds, places = [-5, -1, -0.1, 0, 0.1, 1, 5], [0, 1, 2] if both else [0, 20, 50]
    rows = [[z, 0.8 * z, 0.7 * z] for z in (-2.3, -0.7, -1, 0, 1, 0.7, 2.3)]
    friction = hg.table((v, x if both else T), (speeds, places), rows, name="friction")
    return hg.System("cart", states=(x, v), inputs=(u, T), outputs=(y,), flow=[v, u - friction - x], output=[x])


@pytest.mark.parametrize("both", [True, False])
def test_what_is_proved_of_a_map_is_verified_again_and_holds_at_samples(both: bool) -> None:
    form = hg.forms.triangular(cart(both=both))
    assert all(check.verdict is Verdict.PROVED for check in form.checks)
    observer = hg.observers.high_gain(form, theta=60, poles=(-1, -1))
    content = hg.certificate(form, observer.checks, "high_gain")
    rows = recheck(json.dumps(content)).rows
    assert {row.found for row in rows} == {"verified"}
    assert {"high_gain.convergence", "high_gain.theta"} <= {row.id for row in rows}
    assert falsehood(json.loads(json.dumps(content)), [row.id for row in rows]) == ""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.1, 1, 5, 0, 20, 50", "0.1, 1, 5, 0, 20, 50"),  # as it is
        ("0, 0, 0, 1, 0.8, 0.7", "0, 0, 0, 1, 0.8, 3"),  # steeper in v
        ("-0.1, 0, 0.1, 1, 5, 0, 20, 50", "-0.1, 0, 1/50, 1, 5, 0, 20, 50"),  # as well
    ],
)
def test_a_certificate_of_another_map_is_not_verified(old: str, new: str) -> None:
    """With the digests made again."""
    form = hg.forms.triangular(cart())
    content = hg.certificate(form, form.checks)
    text = json.dumps({key: content[key] for key in ("plant", "form", "observer")})
    assert text.count(old) == 2  # once in the plant, once in the form
    about = json.loads(text.replace(old, new))
    forged = {**content, **about, "model": model_digest(about)}
    del forged["digest"]
    forged["digest"] = digest(forged)
    verdicts = {row.id: row.found for row in recheck(json.dumps(forged)).rows}
    assert verdicts.pop("triangular.lipschitz") == ("verified" if old == new else "fails")
    assert set(verdicts.values()) == {"verified"}


@pytest.mark.parametrize(
    ("old", "new", "verdict"),
    [
        ('"Bilinear(z1, z2, 0, 1,', '"Bilinear(z1, z2, 0, 1,', "verified"),  # as it is
        ('"Bilinear(z1, z2, 0, 1,', '"Bilinear(z1, z2, 1, 0,', "fails"),  # in x, which is as steep
        ('"low": "1", "high": "4"', '"low": "3/2", "high": "4"', "fails"),
        ('"low": "1", "high": "4"', '"low": "1", "high": "7/2"', "fails"),
    ],
)
def test_a_certificate_of_another_slope_is_not_verified(old: str, new: str, verdict: str) -> None:
    """That v enters x' with a slope from 1 to 4: the four patches have others."""
    x, v, y = hg.Signal("x", low=0, high=2), hg.Signal("v", low=0, high=2), hg.Signal("y")
    scale = hg.table((x, v), ([0, 1, 2], [0, 1, 2]), [[0, 1, 2], [2, 3, 5], [3, 5, 9]], name="scale")
    form = hg.forms.uniform(hg.System("s", states=(x, v), outputs=(y,), flow=[scale, -v], output=[x]))
    content = hg.certificate(form, form.checks)
    assert json.dumps(content["claims"]).count(old) == 1
    content["claims"] = json.loads(json.dumps(content["claims"]).replace(old, new))
    del content["digest"]
    content["digest"] = digest(content)
    verdicts = {row.id: row.found for row in recheck(json.dumps(content)).rows}
    assert verdicts.pop("uniform.slope_2") == verdict
    assert set(verdicts.values()) == {"verified"}


@pytest.mark.full
def test_a_certificate_holds_the_largest_map() -> None:
    """Of numbers with all their digits."""
    x, y, draw = hg.Signal("x", low=0, high=1), hg.Signal("y"), Random(11)
    u = hg.Signal("u", low=0, high=1)
    places = [sorted(-draw.random() for _ in range(count)) for count in (MOST // 40, 40)]
    rows = [[draw.random() for _ in places[1]] for _ in places[0]]
    plant = hg.System(
        "l", states=(x,), inputs=(u,), outputs=(y,), flow=[hg.table((x, u), places, rows) - x], output=[x]
    )
    form = hg.forms.triangular(plant)
    assert {row.found for row in recheck(json.dumps(hg.certificate(form, form.checks))).rows} == {"verified"}


def test_a_form_that_asks_for_more_smoothness_says_so() -> None:
    """phase differentiates the output twice along the flow of two states."""
    x, v = hg.Signal("x", low=0, high=3), hg.Signal("v", low=-2, high=2)
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y")
    scale = hg.table((x, u), ([0, 1, 2, 3], [-1, 1]), [[0, 1], [1, 3], [3, 5], [4, 8]], name="scale")
    plant = hg.System("p", states=(x, v), inputs=(u,), outputs=(y,), flow=[v, u - x], output=[scale])
    rank = {str(check.id): check for check in hg.forms.phase(plant).checks}["phase.rank"]
    assert rank.verdict is Verdict.UNKNOWN
    assert "has no derivative somewhere" in str(rank.reason)
    assert rank.fix
    assert hg.observability(plant).rank == 2  # between its ends; beyond them a map shows nothing


# --- graphs and emitted code --------------------------------------------------------------------------------


def test_graphs_and_their_derivatives_are_sympy_s() -> None:
    """Ours, of lookups, and CasADi's own, which a user's functions have; of maps in maps, and along a diagonal."""
    v = sp.Symbol("v", real=True)
    grid = [0, 1, 2, 5], [-1, 0, 2, 3]
    rows = [[0, 1, 2, 0], [3, 1, 4, 1], [-5, 9, 2, 6], [2, 7, 1, 8]]
    inner = hg.table((X * v, X), grid, rows, name="a")
    both = [inner * v + hg.table((inner, v), grid, rows[::-1], name="b") + hg.table((X, X), grid, rows, name="a")]
    x, w, at = ca.SX.sym("x"), ca.SX.sym("v"), Random(8)
    graph, places = ca.vertcat(*to_casadi(both, {X: x, v: w})), ca.vertcat(x, w)
    ours = ca.Function("ours", [x, w], [graph, jacobian(graph, places), hessian(graph[0], places)])
    theirs = ca.Function("theirs", [x, w], [graph, ca.jacobian(graph, places), ca.hessian(graph[0], places)[0]])
    gradient = [both[0].diff(s) for s in (X, v)]
    second = [[row.diff(s) for s in (X, v)] for row in gradient]
    for _ in range(25):
        point = [at.uniform(-1, 3), at.uniform(-1, 3)]
        where = dict(zip((X, v), map(sp.Float, point), strict=True))
        for value, g, H in (ours(*point), theirs(*point)):
            assert np.allclose(float(value), float(both[0].subs(where)))
            assert np.allclose(g.full().ravel(), [float(row.subs(where)) for row in gradient])
            assert np.allclose(H.full(), [[float(entry.subs(where)) for entry in row] for row in second])


def test_casadi_s_own_derivatives_of_a_slope_that_is_level_are_zero() -> None:
    """Forward and reverse, of a map's slopes and of a table's, which do not depend on all of their arguments."""
    x, way = ca.SX.sym("x"), ca.SX.sym("way")
    grid = cells_of([[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [3, 4, 9], [1, 1, 1]], "linear", "m")
    curve = cells_of([[0, 1, 2, 3]], [0, 1, 3, 4], "linear", "t")
    level = [Lookup(grid, order)(x, x) for order in ((1, 1), (2, 0), (0, 2))] + [Lookup(curve, (1,))(x**2)]
    rows = [ca.jtimes(each, x, way, reverse) for each in level for reverse in (False, True)]
    assert ca.Function("f", [x, way], [ca.vertcat(*rows)])(0.6, 0.5).full().ravel().tolist() == [0] * len(rows)


_MAIN = """
#include <stdio.h>
{text}
int main(void)
{{
    {type} at[2];
    while (fread(at, sizeof at, 1, stdin) == 1) {{
        const {type} values[] = {{{calls}}};
        fwrite(values, sizeof values, 1, stdout);
    }}
    return 0;
}}
"""


@pytest.mark.full
@pytest.mark.parametrize("real", ["float", "double"])
def test_c_and_python_and_casadi_have_the_same_bits(real: str, tmp_path: Path) -> None:
    """At every pair of numbers, infinite and not a number among them: those give what is no number, and nothing is read
    out of bounds, which the sanitizers would tell."""
    emitted.tool("gcc")
    draw, kind = Random(9), DTYPE[real]
    maps = []
    for shape in ((2, 2), (3, 8), (9, 4), (30, 25)):
        axes = [[x / 700 for x in sorted(draw.sample(range(-3000, 3000), count))] for count in shape]
        cells = cells_of(axes, [[draw.uniform(-3, 3) for _ in axes[1]] for _ in axes[0]], "linear", f"t{len(maps)}")
        pairs = np.array([*product(*(numbers(draw, axis, kind) for axis in axes))], kind)
        maps.append((cells, [Lookup(cells, order) for order in ORDERS], pairs))
    every = [each for _, lookups, _ in maps for each in lookups]
    calls = ", ".join(f"t_{each.name}(at[0], at[1])" for each in every)
    text = "\n".join((tables(C, "t", real, every) + code("")).lines)
    main = _MAIN.format(text=text, type=real, calls=calls)
    flags = ("-O2", "-ffp-contract=off", "-fsanitize=address,undefined")
    binary = emitted.compiled("gcc", {"main.c": main}, tmp_path, *flags)
    for k, (cells, lookups, pairs) in enumerate(maps):
        run = emitted.subprocess.run([binary], input=pairs.tobytes(), capture_output=True, check=True)
        seen = np.frombuffer(run.stdout, kind).reshape(len(pairs), len(maps), len(ORDERS))[:, k]
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        graph = ca.Function("f", [x, y], [ca.vertcat(*(each(x, y) for each in lookups))])
        with np.errstate(all="ignore"):
            python = [evaluated(graph, real)([[a], [b]])[0] for a, b in (pairs.tolist() if real == "double" else pairs)]
        assert same(seen, np.array(python, kind))
        finite = (np.abs(pairs) < 1e3).all(axis=1)
        assert np.isnan(seen[~np.isfinite(pairs).all(axis=1)]).all()
        exact = [float(exactly(cells, *map(Fraction, pair.tolist()))) for pair in pairs[finite]]
        rounded = 2 * 4.3 * float(np.finfo(kind).eps) * 6 * 700  # places below 4.3 on both axes, slopes below 6 * 700
        assert np.allclose(seen[finite, 0], exact, rtol=0, atol=rounded)
        if real == "double":
            assert (seen[finite] == graph.map(int(finite.sum()))(*pairs[finite].T).full().T).all()


def numbers(draw: Random, places: Sequence[float], kind: type) -> np.ndarray:
    """Some places, their neighbours, numbers between and beyond, and what is no number."""
    at = np.array([places[0], places[-1], draw.choice(places)], kind)
    odd = np.array([np.inf, -np.inf, np.nan, 9, -9, -0.0, draw.uniform(-4, 4)], kind)
    return np.concatenate([at, np.nextafter(at, kind(np.inf)), np.nextafter(at, kind(-np.inf)), odd])


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """The same bits, of any NaN."""
    return bool(((a.view(f"u{a.itemsize}") == b.view(f"u{b.itemsize}")) | (np.isnan(a) & np.isnan(b))).all())


@pytest.mark.full
def test_a_large_map_costs_what_a_small_one_does() -> None:
    """One operation of a program, and a search along each axis whose steps grow with the logarithm."""
    steps, probes = [], []
    for shape in ((5, 2), (40, 25)):
        x, u, y = hg.Signal("x", low=0, high=1), hg.Signal("u", low=0, high=1), hg.Signal("y")
        axes = [[k / (count - 1) for k in range(count)] for count in shape]
        f = hg.table((x, u), axes, [[a * b - a for b in axes[1]] for a in axes[0]], name="t")
        plant = hg.System("one", states=(x,), inputs=(u,), outputs=(y,), flow=[f], output=[x])
        steps.append(hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=(-1,)), dt=0.1))
        probes.append([len(axis.probes) for axis in Lookup(f.cells, (0, 0)).axes])
    assert cost(steps[0]) == cost(steps[1])
    assert probes == [[3, 2], [6, 5]]


@pytest.mark.slow
def test_eva_raises_no_alarm(tmp_path: Path) -> None:
    """Every index is shown to be in range, for any floats, infinite and not a number among them."""
    cells = cells_of(
        [[0, 0.1, 0.3, 0.7, 1.5], [0, 1, 5]], [[0, 1, 5], [1, 3, 2], [3, 1, 1], [2, 0, 1], [1, 9, 2]], "linear", "t"
    )
    lookups = [Lookup(cells, order) for order in ((0, 0), (1, 0), (0, 1))]
    text = "\n".join(tables(C, "t", "float", lookups).lines)
    calls = " + ".join(f"t_{each.name}(any, other)" for each in lookups)
    main = f"static volatile float any, other;\nint main(void) {{ return {calls} < 1.0f; }}\n"
    hg.write({"main.c": f"{text}\n{main}"}, tmp_path)
    options = ["-eva-precision=3", "-warn-special-float=none"]
    said = emitted.run([emitted.tool("frama-c"), "-eva", *options, "main.c"], tmp_path)
    assert " 0 alarms generated" in said
    assert "NON TERMINATING" not in said


# --- at the door --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "zs", "says"),
    [
        (([0, 1], [0, 1, 2]), [[1, 2, 3]], "has 2 xs, 3 ys, and in zs 1 row of 3 numbers; give 2 rows"),
        (([0, 1], [0, 1, 2]), [[1, 2], [3, 4], [5, 6]], "and in zs 3 rows of 2 numbers; transpose zs"),
        (
            ([0, 1], [0, 1, 2]),
            [[1, 2, 3], [4, 5]],
            "2 rows of 2 or 3 numbers; give 2 rows, one for each of xs, of 3",
        ),
        (([0, 1], [0, 1]), [], "0 rows of no numbers"),
        (([0, 1], [0, 1]), [1, 2], "row 1 of zs is 1; give a list of numbers"),
        (([0, 1], [0, 1]), 3, "zs is 3; give a row of numbers for each of xs"),
        (([0, 1], [0, 1]), [[1, 2], [3, math.nan]], "row 2 of zs, number 2 is nan, no finite number"),
        (([0, 1], [0, 1]), [[1, 2], [3, "4"]], "no finite number"),
        (([0, math.inf], [0, 1]), [[1, 2], [3, 4]], "xs 2 is inf, no finite number"),
        (([0, 1], [0, math.nan]), [[1, 2], [3, 4]], "ys 2 is nan, no finite number"),
        (([0, 1, 0.5], [0, 1]), [[1, 2], [3, 4], [5, 6]], "xs 2 and 3, 1 and 0.5, do not increase; sort them"),
        (([0, 1], [1, 0]), [[1, 2], [3, 4]], "ys 1 and 2, 1 and 0, do not increase; sort them"),
        (([0], [0, 1]), [[1, 2]], "xs is a constant, 0; give 2 numbers or more, or leave this axis out"),
        (([0, 1], [20, 20]), [[1, 2], [3, 4]], "ys is a constant, 20, 20; give 2 numbers or more, or leave this axis"),
        (([0, 1], []), [[], []], "ys is a constant, empty; give 2 numbers or more"),
        (([0, 1],), [[1, 2], [3, 4]], "give two lists of numbers, (xs, ys)"),
        ([0, 1], [[1, 2], [3, 4]], "give two lists of numbers, (xs, ys)"),
        ({1: 2}, [[1, 2], [3, 4]], "give two lists of numbers, (xs, ys)"),
        ((range(50), range(50)), [[1] * 50] * 50, f"has 50 x 50 points; give {MOST} at most"),
        (([0, 1], [0, 1]), [[1, 10**400], [1, 1]], "choose other units"),
        (([0, 1e-200], [0, 1e-200]), [[0, 1], [1, 1]], "choose other units"),
    ],
)
def test_a_bad_map_is_refused_with_its_fix(axes: object, zs: object, says: str) -> None:
    with pytest.raises(BadTable, match="table 'table': ") as refused:
        hg.table((X, Y), axes, zs)
    assert says in str(refused.value)


def test_a_bad_argument_or_kind_of_a_map_is_refused() -> None:
    grid = ([0, 1], [0, 1]), [[1, 2], [3, 4]]
    for argument in ("x", None, sp.I, sp.Matrix([X]), [X]):
        with pytest.raises(BadTable, match="give"):
            hg.table((X, argument), *grid)
    with pytest.raises(BadTable, match="kind = 'monotone'; a map is linear in each"):
        hg.table((X, Y), *grid, kind="monotone")
    with pytest.raises(BadTable, match="none of its kinds"):
        hg.table((X, Y), *grid, kind="bilinear")


def test_a_system_tells_a_map_from_a_table_of_its_name() -> None:
    x, u, y = hg.Signal("x", low=0, high=1), hg.Signal("u", low=0, high=1), hg.Signal("y")

    def system(*flow: sp.Expr) -> hg.System:
        return hg.System("s", states=(x,), inputs=(u,), outputs=(y,), flow=[sp.Add(*flow)], output=[x])

    f = hg.table((x, u), ([0, 1], [0, 1]), [[1, 2], [3, 4]], name="t")
    assert system(f, f**2, f.subs(u, x)).tables == (f.cells,)
    with pytest.raises(BadSystem, match="two tables are called 't'"):
        system(f, hg.table(x, [0, 1], [0, 1], name="t"))
    with pytest.raises(BadSystem, match="a signal and a table are called 'x'"):
        system(hg.table((x, u), ([0, 1], [0, 1]), [[1, 2], [3, 4]], name="x"))
    with pytest.raises(BadSystem, match=r"t\(x, u, 0, 1\), which jumps at its points"):
        system(f.diff(u))


# --- plain text ---------------------------------------------------------------------------------------------

CART = """
name = "cart"
[states.v]
low = -1
high = 1
flow = "u - friction(v, T)"
[inputs.u]
low = -1
high = 1
[inputs.T]
low = 0
high = 50
[tables.friction]
x = [-1, 0, 1]
y = [0, 50]
z = [[-2, -1], [0, 0], [2, 1]]
[outputs.y]
equation = "v"
"""


def read(text: str = CART) -> hg.System:
    return text_model.from_table(tomllib.loads(text)).plant


def test_a_map_in_plain_text_is_that_in_python() -> None:
    plant = read()
    (v,), (u, T) = plant.states, plant.inputs
    assert plant.flow[0] == u - hg.table((v, T), ([-1, 0, 1], [0, 50]), [[-2, -1], [0, 0], [2, 1]], name="friction")
    assert read(text_model.to_text(plant)) == plant
    at = hg.bound("friction(v, 25)", plant)
    assert (float(at.low), float(at.high)) == pytest.approx((-1.5, 1.5), rel=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "z = [[-2, -1], [0, 0], [2, 1]]",
            "z = [[-2, 0, 2], [-1, 0, 1]]",
            "tables.friction: table 'friction': has 3 xs, 2",
        ),
        (
            "z = [[-2, -1], [0, 0], [2, 1]]",
            "z = [-2, 0, 2]",
            "tables.friction.z: is a list; write a list of lists of numb",
        ),
        ("z = [[-2, -1], [0, 0], [2, 1]]\n", "", "has 3 xs and 2 ys; give a y for each x"),
        ("y = [0, 50]\n", "", "tables.friction: the key 'y' is missing; add y = [0"),
        ("y = [0, 50]\n", 'y = [0, 50]\nkind = "monotone"\n', 'a map is linear in each: write "linear"'),
        ("friction(v, T)", "friction(v)", "the table friction of column 5, of 2 arguments, needs ',' here"),
        ("friction(v, T)", "friction(v, T, 1)", "the table friction of column 5 needs ')' here"),
        ("friction(v, T)", "friction(v, )", "stands where a number, a name or a parenthesis belongs"),
        ("[tables.friction]", "[tables.v]", "a signal is called 'v' as well"),
    ],
)
def test_a_bad_map_in_plain_text_is_refused_with_its_place(old: str, new: str, says: str) -> None:
    with pytest.raises(text_model.BadModelFile) as refused:
        read(CART.replace(old, new))
    assert says in str(refused.value)


def test_the_shipped_map_is_as_it_says() -> None:
    """L_b of models/warm_bearing.toml is the steepest slope in the speed, and the map odd in it."""
    plant = text_model.read(Path(__file__).parents[1] / "models" / "warm_bearing.toml").plant
    (friction,) = plant.tables
    assert all(
        list(row) == [-z for z in other] for row, other in zip(friction.values, friction.values[::-1], strict=True)
    )
    assert friction.limits([(-0.8, 0.8), (-10, 90)], (1, 0))[0] == (-7, 24)


def test_a_map_that_goes_on_is_unbounded_where_it_is_not_level() -> None:
    """x y between 0 and 2: along each axis that is not held it goes on for ever, but for the line on which it is 0."""
    axes, rows = [[Fraction(0), Fraction(2)]] * 2, [[Fraction(0), Fraction(0)], [Fraction(0), Fraction(4)]]
    whole = cells_of(axes, rows, "linear", "product")
    inside, beyond, level = (Fraction(0), Fraction(1)), (Fraction(1), math.inf), (Fraction(0), Fraction(0))
    for k, held in enumerate(((False, True), (True, False))):
        on = whole.clamping(*held)
        sides = [(inside, beyond), (beyond, inside)][1 - k]
        assert on.limits(sides, (0, 0))[0] == (-math.inf, math.inf)
        assert on.limits([level if side == inside else side for side in sides], (0, 0))[0] is not None
        assert whole.limits(sides, (0, 0))[0] == (0, 2)
        assert on.limits(sides, (1, 1))[0] == (1, 1)
