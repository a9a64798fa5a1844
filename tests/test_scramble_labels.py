"""The labels of the scrambled systems against brute force: a wrong label would be worse than none."""

import itertools
import math
import random
from collections.abc import Mapping
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp

from tests.oracle.structure import Sampled, read, structure
from tests.scramble import Labelled, queries
from tests.scramble_families import singles
from tests.scramble_several import several
from tests.scramble_tables import BENDS, CONSTANT, HEADS, INPUT, KINKS, MEASURED, PARAMETER, QUERIES, Gain

SLACK = 1e-9  # of sampling in doubles


@cache
def evaluated() -> dict[str, Sampled]:
    """By name, as several tests evaluate the same rows."""
    return {one.name: Sampled(one.model) for one in singles() + several()}


@pytest.mark.full
def test_there_are_enough_and_they_are_the_same_again() -> None:
    every = singles() + several() + queries()
    assert len(every) >= 300
    assert [one.model for one in singles.__wrapped__()] == [one.model for one in singles()]
    assert len({one.name for one in every}) == len(every)
    for field in ("triangular", "triangular_uy", "uof_structure", "uof", "lipschitz", "gb_uniform"):
        assert {True, False} <= {one.truth.get(field) for one in singles()}
    for field in ("mimo_levelwise", "mimo_cascade", "mimo_uof"):
        assert {True, False} <= {one.truth.get(field) for one in several()}


@pytest.mark.full
def test_structure_by_every_order() -> None:
    for one in (one for one in singles() if len(one.model["states"]) <= 5):
        labels = structure(evaluated()[one.name])
        truth = one.truth
        assert labels["uof_structure"] == truth["uof_structure"], one.name
        if "order" in truth:
            assert labels["order"] == truth["order"], one.name
        for field in ("triangular", "triangular_uy"):
            if truth[field] or "x_box" not in one.model:
                assert labels[field] == truth[field], (one.name, field)
            else:
                assert not labels[field] or any(low <= 0 for low, _ in truth["a_ranges"]), (one.name, field)


@pytest.mark.full
def test_structure_by_every_split() -> None:
    for one in several():
        labels = structure(evaluated()[one.name])
        for field, name in (("mimo_levelwise", "levelwise"), ("mimo_cascade", "cascade")):
            if field in one.truth:
                assert labels[name] == one.truth[field], (one.name, field)
        if one.truth.get("mimo_uof"):
            assert labels["bent"], one.name


# --- ranges -------------------------------------------------------------------------------------------------


def sampled(text: str, boxes: Mapping[str, Any]) -> tuple[float, float]:
    """Least and largest value over a grid that holds the ends, and over the best points' neighbourhoods."""
    names = sorted(boxes)
    function = sp.lambdify([sp.Symbol(n) for n in names], read(text, names), "numpy")
    ends = [[float(sp.N(read(end, ()))) for end in boxes[n]] for n in names]
    count = {0: 1, 1: 4001, 2: 121, 3: 31, 4: 13, 5: 7}[len(names)]
    best = []
    for sign in (1, -1):
        lows, highs = [a for a, _ in ends], [b for _, b in ends]
        for _ in range(8):  # zoom in on the best point
            axes = [np.linspace(a, b, count) for a, b in zip(lows, highs, strict=True)]
            grid = np.meshgrid(*axes, indexing="ij")
            values = sign * np.broadcast_to(function(*grid), np.shape(grid)[1:])
            where = np.unravel_index(np.argmin(values), values.shape)
            for k, axis in enumerate(axes):
                step = (axis[-1] - axis[0]) / max(count - 1, 1)
                lows[k] = max(ends[k][0], axis[where[k]] - 2 * step)
                highs[k] = min(ends[k][1], axis[where[k]] + 2 * step)
        best.append(sign * float(values.min()))
    return best[0], best[1]


def agree(text: str, boxes: Mapping[str, Any], low: str, high: str) -> None:
    least, most = sampled(text, boxes)
    assert math.isclose(least, float(sp.N(read(low, ()))), rel_tol=1e-6, abs_tol=1e-7), (text, least)
    assert math.isclose(most, float(sp.N(read(high, ()))), rel_tol=1e-6, abs_tol=1e-7), (text, most)


@pytest.mark.parametrize(
    "gain", [*CONSTANT, *PARAMETER, *INPUT, *MEASURED], ids=lambda gain: f"{gain.text} {gain.boxes}"
)
def test_ranges_of_gains(gain: Gain) -> None:
    names = {letter: f"v_{letter}" for letter in gain.boxes}
    agree(gain.text.format(**names), {names[k]: box for k, box in gain.boxes.items()}, gain.low, gain.high)


@pytest.mark.parametrize("bend", [*BENDS, *HEADS], ids=lambda bend: f"{bend.text} {bend.boxes}")
def test_ranges_of_slopes(bend: Any) -> None:
    names = {letter: f"v_{letter}" for letter in bend.boxes}
    slope = bend.slope.format(**names)
    agree(slope, {names[k]: box for k, box in bend.boxes.items()}, bend.low, bend.high)
    text = read(bend.text.format(**names), list(names.values()))
    assert sp.simplify(text.diff(sp.Symbol("v_n")) - read(slope, list(names.values()))) == 0


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query[0])
def test_ranges_of_queries(query: Any) -> None:
    text, boxes, low, high = query
    names = [f"v_{k}" for k in range(len(boxes))]
    agree(text.format(*names), dict(zip(names, boxes, strict=True)), low, high)


def test_scrambled_queries_keep_their_range() -> None:
    """At random points of the scaled boxes the text stays in the range."""
    for one in queries():
        names = one.model["states"]
        function = sp.lambdify([sp.Symbol(n) for n in names], read(one.model["bound_queries"][0], names), "math")
        ends = [[float(sp.N(read(end, ()))) for end in one.model["x_box"][n]] for n in names]
        low, high = (float(sp.N(end)) for end in one.truth["bounds"][0])
        rng = random.Random(2)
        for _ in range(200):
            value = function(*(rng.uniform(*pair) for pair in ends))
            assert low - SLACK * (1 + abs(low)) <= value <= high + SLACK * (1 + abs(high)), one.name


@pytest.mark.full
def test_scaled_gains_stay_in_their_range() -> None:
    """The slope of each row in the next state, in the model's own coordinates."""
    for one in (one for one in singles() if "a_ranges" in one.truth):
        s = evaluated()[one.name]
        place = [one.model["states"].index(name) for name in one.truth["order"]]
        for (row, nxt), (low, high) in zip(itertools.pairwise(place), one.truth["a_ranges"], strict=True):
            for point in s.samples:
                slope = abs(s.change(row, nxt, point, 0.37))
                assert float(low) * (1 - SLACK) <= slope <= float(high) * (1 + SLACK), one.name


@pytest.mark.parametrize("kink", KINKS, ids=lambda kink: f"{kink.text} {kink.box}")
def test_kinks_by_difference_quotients(kink: Any) -> None:
    """Quotients over ever shorter steps at the ends, 0, 1 and pi/2 grow without bound, or do not."""
    p = sp.Symbol("v_p")
    function = sp.lambdify(p, read(kink.text.format(p=p), ["v_p"]), "mpmath")
    low, high = (float(sp.N(read(end, ()))) for end in kink.box)
    worst = []
    for step in (1e-3, 1e-7):
        starts = [
            low,
            high - 2 * step,
            *(x + d for x in (0, 1, math.pi / 2, -math.pi / 2) for d in (step / 3, -step / 3)),
        ]
        quotients = []
        for a in (a for a in starts if low <= a and a + step <= high):
            try:
                quotients.append(abs(complex(function(a + step) - function(a))) / step)
            except (ZeroDivisionError, ValueError):  # undefined at an end
                quotients.append(abs(complex(function(a + 2 * step) - function(a + step))) / step)
        worst.append(max(quotients))
    assert (worst[1] < 2 * worst[0] + 1) == kink.lipschitz, worst


# --- Lie derivatives ----------------------------------------------------------------------------------------


def small(field: str) -> list[Labelled]:
    """Those of up to three states on a box, of which the field is labelled."""
    return [one for one in singles() if len(one.model["states"]) <= 3 and "x_box" in one.model and field in one.truth]


def lie(one: Labelled) -> tuple[list[sp.Symbol], list[sp.Symbol], list[sp.Expr], list[sp.Expr]]:
    """States, inputs, the flow, and h, L_f h, .. with the drift."""
    names = evaluated()[one.name].names
    x, u = ([sp.Symbol(n) for n in one.model[key]] for key in ("states", "inputs"))
    flow = [read(text, names) for text in one.model["f"]]
    still = dict.fromkeys(u, 0)
    drift, row = [f.subs(still) for f in flow], read(one.model["h"][0], names).subs(still)
    rows = [row]
    for _ in x[1:]:
        rows.append(sum(rows[-1].diff(s) * f for s, f in zip(x, drift, strict=True)))
    return x, u, flow, rows


def numbers(one: Labelled, seed: int) -> dict[sp.Symbol, sp.Expr]:
    """A random point strictly inside the boxes."""
    s, rng = evaluated()[one.name], random.Random(seed)
    pairs = [(sp.Rational(str(a)[:25]), sp.Rational(str(b)[:25])) for a, b in s.boxes]
    return {
        sp.Symbol(n): (a + (b - a) * sp.Rational(rng.randint(101, 899), 1000))
        for n, (a, b) in zip(s.names, pairs, strict=True)
    }


def rank(rows: list[list[sp.Expr]], at: Mapping[sp.Symbol, sp.Expr]) -> int:
    """By singular values in 50 digits."""
    with mpmath.workdps(50):
        m = mpmath.matrix([[mpmath.mpmathify(sp.N(e.subs(at), 50)) for e in row] for row in rows])
        if m.rows < m.cols:
            m = m.T
        values = mpmath.svd_c(m, compute_uv=False)
        return sum(abs(v) > mpmath.mpf(10) ** -30 for v in values)


@pytest.mark.full
def test_gauthier_bornard_by_lie_derivatives() -> None:
    for one in (one for one in small("gb_uniform") if one.truth["gb_uniform"] in (True, False)):
        x, u, flow, rows = lie(one)
        at = numbers(one, 1)
        gradients = [[row.diff(s) for s in x] for row in rows]
        assert rank(gradients, at) == len(x), one.name
        good = True
        for k, row in enumerate(rows):
            for v in u:
                field = [f.diff(v) for f in flow]
                assert all(g.diff(w) == 0 for g in field for w in u), one.name
                along = sum(row.diff(s) * g for s, g in zip(x, field, strict=True))
                good &= rank([*gradients[: k + 1], [along.diff(s) for s in x]], at) == k + 1
        assert good == one.truth["gb_uniform"], one.name


@pytest.mark.full
def test_singular_set_by_lie_derivatives() -> None:
    for one in small("singular"):
        x, _, _, rows = lie(one)
        gradients = [[row.diff(s) for s in x] for row in rows]
        truth = one.truth["singular"]
        at = numbers(one, 3)
        assert (rank(gradients, at) < len(x)) == (truth == "all"), one.name
        if isinstance(truth, sp.Expr):
            assert sp.N(truth.subs(at)) != 0, one.name
            for s in x:
                if truth.has(s) and truth.subs(s, 0) == 0:
                    assert rank(gradients, at | {s: sp.Integer(0)}) < len(x), one.name
