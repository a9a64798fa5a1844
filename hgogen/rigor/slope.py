"""Lipschitz constants of a vector field on a box, and the sign of functions that vanish to second order.

The Lipschitz constant is L_b = sup |db/dx| in the spectral norm. A box is convex, so a continuous b with a bounded
Jacobian is Lipschitz (mean value theorem), also with kinks (Abs, Min, Max), but not with jumps in the state. b is
proved not to be Lipschitz by a point of the box towards which an entry of the Jacobian tends to infinity.

Branch and bound with interval matrices bounds the norm. The slopes of the vector field's tape enclose each entry of the
matrix, and where the field has no kinks so does the symbolic Jacobian, in natural and mean value form. With M the
midpoint and D the radii, |J| <= |M| + |D|_F, also |J|^2 <= |J|_1 |J|_inf, and for a power m of two |M|^2 = |M'M| <=
|(M'M)^m|_F^(1/m), too large by the factor n^(1/(2m)) at most. A lower bound is |J v| / |v| at points, with any v.

The second question is whether a function S(e, x) that vanishes to second order at e = 0 is negative for all other e in
a box around 0. Bisection does not end near e = 0, where S and its gradient vanish. Let a symmetric matrix N(c, x)
satisfy S(e, x) <= - e'N e, N the average of N(c, x) over copies c of e in any box around 0 that contains e. If N is
positive definite for every c in the box, S < 0 for every e of it but 0. So N is tried on the whole box, then on boxes
half as wide each time; slabs on which S is not 0 (`bounds.nonzero`) cover the remainder. N is positive definite where
|I - T'N T/s| < 1 (`slope.lipschitz_bound` of the field (I - T'N T/s) t of t), with a constant T that makes T'N T the
unit matrix in the middle, and s in the middle of its eigenvalues.

A counterexample is an exact rational point where S >= 0 and e is not 0: from samples, from a direction in which N is
not positive, or from a slab.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache, reduce
from itertools import islice, product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.check import Verdict
from hgogen.rigor import outward
from hgogen.rigor.bounds import Proof, Sign, as_programmed, ends, nonzero, special_point
from hgogen.rigor.box import STRANGE, Box, End, Point, Sides, edges, exact, sides, sign_at, substituted
from hgogen.rigor.enclosure import enclose
from hgogen.rigor.lookup import Kinked, Stepped, Table
from hgogen.rigor.outward import Array, Flags, Pair, add, meet, negate, scale, up, where_known
from hgogen.rigor.search import (
    ROOT,
    AttainedValues,
    Bisection,
    Indices,
    LeafBounds,
    Tree,
    best_cuts,
    bisected,
    corners,
    everywhere,
    middle,
    placed,
    search,
    spread,
)
from hgogen.rigor.series import values
from hgogen.rigor.tape import Norm, Tape, tape, with_norms
from hgogen.sentence import NONE, Reason, because, equations

# --- the spectral norm on a box

_BATCH = 128
_FINE = 2.0**-40  # least width of a side that is cut, as a share of the root's
_SQUARINGS = 7
_SHARP = 8  # most rows and columns of a matrix of which a power is formed
_LOST = 1e-290  # far above the effect of underflow on the norm of a matrix with entries below 1


@dataclass(frozen=True)
class Field:
    """A vector field b as a tape. `states`: the indices of the states among the tape's symbols; `jacobian`: a tape of
    the entries of db/dx that are not constant, at the `places` (row, column); empty where b has kinks or jumps."""

    program: Tape
    states: tuple[int, ...]
    jacobian: Tape
    places: tuple[tuple[int, int], ...]


def steepest(field: Field, root: Pair, relative: float, limit: int, begun: Bisection | None = None) -> Bisection:
    """Return a bisection of the box `root` with bounds of |J|, the spectral norm of the field's Jacobian, on its
    leaves. It ends once the upper bound exceeds an attained value by at most the share `relative`, or at `limit` boxes.
    `begun`: a bisection with a lower limit to continue."""

    def bounds_on(
        low: Array, high: Array, node: Indices, inner: AttainedValues, points: Array | None = None
    ) -> tuple[LeafBounds, AttainedValues]:
        at = middle(low, high) if points is None else points
        # one walk of the tape costs little more for twice the columns
        matrices, valid, continuous = _slopes(field, np.hstack((low, at)), np.hstack((high, at)))
        k = low.shape[1]
        matrix, smooth = matrices[..., :k], valid[:k]
        weight = _sharpen(field, low, high, matrix, smooth & continuous[:k])
        norm = np.where(smooth, _norm(matrix), np.inf)
        known = LeafBounds(low, high, node, _cuts(root, low, high, weight), np.zeros(k), norm, smooth, smooth)
        return known, AttainedValues(most=max(inner.most, _attained(matrices[..., k:], valid[k:])))

    def goal(leaves: LeafBounds, inner: AttainedValues) -> Array:
        return np.where((leaves.top > (1.0 + relative) * inner.most) | ~leaves.defined, leaves.top, 0.0)

    with np.errstate(all="ignore"):
        if begun is None:
            points = corners(*root)[:, : limit + 1]
            begun = Bisection(*bounds_on(root[0][:, None], root[1][:, None], ROOT, AttainedValues(), points), [])
        return bisected(begun, bounds_on, goal, limit, _BATCH)


def _slopes(field: Field, low: Array, high: Array) -> tuple[Array, Flags, Flags]:
    """Return enclosures of the field's Jacobian (2 x rows x states x k) on k boxes; flags (k) whether they are valid,
    and flags (k) whether the field is continuous on the box."""
    rows = enclose(field.program, low, high, slopes=field.states)
    smooth = np.logical_and.reduce([row.defined for row in rows])  # a jump in a state makes the slope infinite
    continuous = np.logical_and.reduce([row.continuous for row in rows])
    return np.stack([row.slope for row in rows], axis=1), smooth, continuous


def _sharpen(field: Field, low: Array, high: Array, matrix: Array, sound: Flags) -> Array | None:
    """Tighten the enclosures `matrix` of the Jacobian in place by mean value forms of the symbolic Jacobian, if there
    is one, on the boxes flagged `sound`, where the field is continuous. Return the weight of each variable (m x k) in
    the choice of the next cut."""
    if not field.places:
        return None
    entries = enclose(field.jacobian, low, high, slopes=True)
    centre = middle(low, high)
    away = add((low, high), negate((centre, centre)))
    there = enclose(field.jacobian, centre, centre)
    weight = np.zeros(low.shape)
    for place, entry, middle_value in zip(field.places, entries, there, strict=True):
        value, slope = entry.value, entry.slope
        terms = scale(slope, away)
        weight = weight + np.maximum(np.abs(terms[0]), np.abs(terms[1]))
        form = middle_value.value
        for i in np.nonzero(((slope[0] != 0) | (slope[1] != 0)).any(axis=1))[0]:
            form = add(form, (terms[0][i], terms[1][i]))
        usable = entry.defined & entry.continuous & middle_value.defined & ~np.isnan(form[0]) & ~np.isnan(form[1])
        form = where_known(usable, form)
        first, last = matrix[0][place], matrix[1][place]
        joint = meet((first, last), where_known(entry.defined, meet(value, form)))
        sharper = (joint[0] <= joint[1]) & sound
        matrix[0][place], matrix[1][place] = np.where(sharper, joint[0], first), np.where(sharper, joint[1], last)
    return weight


def _norm(matrix: Array) -> Array:
    """Return upper bounds (k) of the spectral norms of interval matrices (2 x rows x columns x k)."""
    (low, high), exponent = _scaled(matrix)
    size = np.maximum(np.abs(low), np.abs(high))
    plain = _frobenius(size)
    norm = plain if 1 in low.shape[:2] else np.fmin(plain, _sharper(low, high, size, plain))
    norm = np.where(np.isnan(norm), np.inf, up(norm + _LOST))
    zero = ((low == 0) & (high == 0)).all(axis=(0, 1))
    return np.asarray(np.where(zero & (exponent == 0), 0.0, up(np.ldexp(norm, exponent))))


def _sharper(low: Array, high: Array, size: Array, plain: Array) -> Array:
    """Return upper bounds of the spectral norms of interval matrices [low, high], by their centres and radii and by
    sums of rows and columns; `size`: the largest |entries|; `plain`: the Frobenius norms, which the bounds may
    exceed."""
    centre = np.where(np.isfinite(low) & np.isfinite(high), low / 2.0 + high / 2.0, 0.0)
    radius = np.maximum(up(high - centre), up(centre - low))
    sharp = plain if max(low.shape[:2]) > _SHARP else up(_point_norm(centre) + _frobenius(radius))
    sums = _largest_sum(size), _largest_sum(np.swapaxes(size, 0, 1))
    mixed = up(np.sqrt(up(sums[0] * sums[1])))
    return np.fmin(mixed, sharp)


def _scaled(matrix: Array) -> tuple[Array, Indices]:
    """Return the matrices (.. x k) divided by powers of two, so that the largest entry of each is below 1, and the
    exponents; underflow changes a norm by less than `_LOST`."""
    largest = np.abs(matrix).max(axis=tuple(range(matrix.ndim - 1)))
    usable = (largest > 0) & np.isfinite(largest)
    exponent = np.where(usable, np.frexp(np.where(usable, largest, 1.0))[1], 0).astype(np.int64)
    return np.ldexp(matrix, -exponent), exponent


def _largest_sum(size: Array) -> Array:
    total = np.zeros((size.shape[0], size.shape[2]))
    for column in np.moveaxis(size, 1, 0):
        total = up(total + column)
    return np.asarray(total.max(axis=0))


def _frobenius(size: Array) -> Array:
    return outward.root_up(reduce(outward.add_up, outward.power_up(size, 2).reshape(-1, *size.shape[2:])))


def _point_norm(matrix: Array) -> Array:
    """Return upper bounds (k) of the spectral norms of matrices of floats M (rows x columns x k), by the Frobenius norm
    of a power of M'M."""
    matrix, exponent = _scaled(matrix)
    largest = np.abs(matrix).max(axis=(0, 1))
    transposed = np.swapaxes(matrix, 0, 1)
    gram = _product((transposed, transposed), (matrix, matrix))
    logarithm = np.zeros(largest.shape)  # of the extracted factor, base 2, exact
    times = 1
    for _ in range(_SQUARINGS):
        gram, times = _product(gram, gram), 2 * times
        size = np.abs(gram[1]).max(axis=(0, 1))
        out = np.where(size > 0, np.frexp(np.where(size > 0, size, 1.0))[1], 0)
        gram = np.ldexp(gram[0], -out), np.ldexp(gram[1], -out)
        logarithm = 2.0 * logarithm + out
    size = np.maximum(np.abs(gram[0]), np.abs(gram[1]))
    root = _frobenius(size)
    # |M|^(2 times) <= root 2^logarithm; the roots are square roots, rounded up
    parts = 2 * times
    whole = np.floor_divide(logarithm, parts)
    norm = np.ldexp(root, (logarithm - parts * whole).astype(int))
    for _ in range(_SQUARINGS + 1):
        norm = outward.root_up(norm)
    norm = up(np.ldexp(norm, whole.astype(int)) + _LOST)
    return np.asarray(np.where(largest > 0, up(np.ldexp(norm, exponent)), 0.0))


def _product(a: Pair | Array, b: Pair) -> Pair:
    low, high = scale((a[0][:, :, None], a[1][:, :, None]), (b[0][None], b[1][None]))  # n x m x l x k
    terms = range(low.shape[1])
    return reduce(outward.add_down, (low[:, j] for j in terms)), reduce(outward.add_up, (high[:, j] for j in terms))


def _attained(matrix: Array, smooth: Flags) -> float:
    """Return the largest proved lower bound |J v|/|v| of the norms of k enclosed Jacobians J, `matrix` (2 x rows x
    columns x k), at points; those not flagged `smooth` are skipped."""
    usable = smooth & np.isfinite(matrix[0]).all(axis=(0, 1)) & np.isfinite(matrix[1]).all(axis=(0, 1))
    if not usable.any():
        return 0.0
    matrix, exponent = _scaled(matrix[..., usable])
    floats = np.moveaxis(matrix[0] / 2.0 + matrix[1] / 2.0, -1, 0)
    vectors = np.linalg.svd(floats)[2][:, 0, :].T[:, None, :]  # columns x 1 x k
    image = _product(matrix, (vectors, vectors))
    below = reduce(outward.add_down, outward.power_down(outward.absolute(image)[0][:, 0], 2))
    values = outward.down(outward.root_down(below) / _frobenius(np.abs(vectors)))
    values = np.maximum(outward.down(np.ldexp(np.maximum(outward.down(values - _LOST), 0.0), exponent)), 0.0)
    return float(values.max())


def _cuts(root: Pair, low: Array, high: Array, weight: Array | None) -> Indices:
    width, whole = high - low, (root[1] - root[0])[:, None]
    share = np.where(np.isinf(whole), np.where(np.isinf(width), 1.0, 0.5), width / whole)
    known = np.full(low.shape[1], weight is not None)
    possible = (share > _FINE) & (np.abs(middle(low, high)) < 2.0**40)
    return best_cuts(low, high, share if weight is None else weight, known, share, possible)


# --- Lipschitz constants

# Functions that jump, which SymPy's derivative ignores, and functions with kinks, for which slopes are sharper.
JUMPS = (sp.Piecewise, sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Mod, sp.Heaviside, sp.atan2, Stepped)
KINKS = (sp.Abs, sp.Min, sp.Max, Norm, Kinked)
_TURNING = (sp.Heaviside, sp.Abs, sp.Min, sp.Max, Norm)

Ends = tuple[tuple[sp.Symbol, tuple[End, End]], ...]

LIMIT = 4000
_FIRST = 500  # boxes before the search for a singular point
_WORK = 400_000  # most boxes times rows times symbols squared, so that large systems take seconds, too
_RELATIVE = 0.02
_OPERATIONS = 150  # most operations of a slope whose limit is computed
_DISTANCES = (10, 30, 60)  # binary digits of the distances at which the slope must grow


@dataclass(frozen=True)
class Lipschitz:
    """The verdict on whether b(x) is Lipschitz in its states on a box.

    PROVED: the spectral norm |db/dx| is <= `high` on the box, and >= `low` at a point of the box (at a table's
    breakpoint as programs compute it). REFUTED: `witness` is a point towards which an entry of db/dx tends to infinity.
    UNKNOWN: `reason` gives the number of boxes. `variables`, `tree`: the bisection, as in `bounds.Range`.
    """

    verdict: Verdict
    low: float
    high: float
    reason: Reason
    boxes: int
    variables: tuple[sp.Symbol, ...]
    witness: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)
    tree: Tree = field(default="leaf", repr=False)


def lipschitz_bound(
    b: Iterable[sp.Expr], states: Sequence[sp.Symbol], box: Box, *, boxes: int = LIMIT, relative: float = _RELATIVE
) -> Lipschitz:
    """Return bounds of the supremum over the box of the spectral norm |db/dx|, x the `states`. The upper bound exceeds
    the supremum by at most the share `relative`, else `reason` gives the cause. `boxes`: the largest number of boxes of
    the bisection.

    Raises: `EmptyBox`; `NoTape` for a function without a rule.
    """
    return _lipschitz_bound(tuple(map(sp.sympify, b)), tuple(states), tuple(box.items()), boxes, relative)


@lru_cache(maxsize=256)  # several forms, and their observers, need the slopes of the same rows
def _lipschitz_bound(
    b: tuple[sp.Expr, ...], states: tuple[sp.Symbol, ...], box: Ends, boxes: int, relative: float
) -> Lipschitz:
    whole, around = sides(sp.Tuple(*map(exact, b)), dict(box))
    rows = [as_programmed(row, around) for row in whole if not (row.is_number and row.is_real)]
    read = [x for x in states if x in around.symbols]

    def plain(verdict: Verdict, high: float, reason: Reason, tried: int = 0) -> Lipschitz:
        return Lipschitz(verdict, 0.0, high, reason, tried, around.symbols)

    if not rows:
        return plain(Verdict.PROVED, 0.0, because("it is constant"))
    if any(row.has(*STRANGE) for row in rows):
        return plain(Verdict.UNKNOWN, math.inf, because("it is not a finite real number"))
    if not read:
        covers = [search(tape([row], around.symbols), around, everywhere, boxes) for row in rows]
        tried = sum(one.boxes for one in covers)
        if all(one.defined for one in covers):
            return plain(Verdict.PROVED, 0.0, because("it does not depend on the state"), tried)
        return plain(
            Verdict.UNKNOWN, math.inf, because("{boxes} boxes do not show that it is defined", boxes=tried), tried
        )
    return _norm_bound(rows, read, around, boxes, relative)


def _norm_bound(rows: list[sp.Expr], read: list[sp.Symbol], around: Sides, boxes: int, relative: float) -> Lipschitz:
    vector = _field([with_norms(row) for row in rows], read, around)
    boxes = min(boxes, _WORK // (len(rows) * len(around.symbols) ** 2) + 1)
    first = min(boxes, _FIRST)
    cover = steepest(vector, around.outer, relative, first)
    steep = None if cover.defined and math.isfinite(cover.high) else _endless(rows, read, around)
    if not (cover.finished or steep) and first < boxes:
        cover = steepest(vector, around.outer, relative, boxes, cover.before)
    result = Lipschitz(
        Verdict.UNKNOWN, cover.inner.most, cover.high, NONE, cover.boxes, around.symbols, tree=cover.tree
    )
    if cover.defined and math.isfinite(cover.high):
        loose = because("{boxes} boxes bring it no closer to the slopes that are attained", boxes=cover.boxes)
        return replace(result, verdict=Verdict.PROVED, reason=NONE if cover.finished else loose)
    if steep:
        slope, point = steep
        reason = because("the slope {slope} has no bound towards {point}", slope=slope, point=equations(point))
        return replace(result, verdict=Verdict.REFUTED, high=math.inf, reason=reason, witness=point, tree="leaf")
    return replace(result, reason=because("{boxes} boxes give no bound", boxes=cover.boxes))


def _field(rows: list[sp.Expr], states: list[sp.Symbol], around: Sides) -> Field:
    smooth = not any(row.has(*JUMPS, *KINKS) for row in rows)
    places = [(i, j) for i, row in enumerate(rows) for j, x in enumerate(states) if smooth and x in row.free_symbols]
    slopes = {(i, j): rows[i].diff(states[j]) for i, j in places}
    entries = {place: slope for place, slope in slopes.items() if slope.free_symbols}
    at = tuple(around.symbols.index(x) for x in states)
    return Field(tape(rows, around.symbols), at, tape(entries.values(), around.symbols), tuple(entries))


# --- not Lipschitz


def _endless(rows: list[sp.Expr], states: list[sp.Symbol], around: Sides) -> tuple[sp.Expr, Point] | None:
    """Return an entry of the Jacobian of the `rows` in the states, and a point towards which it tends to infinity along
    a line; None if none is known."""
    real = {s: sp.Dummy(s.name, real=True) for s in around.symbols}
    plain = {dummy: s for s, dummy in real.items()}
    around = Sides(tuple(real.values()), around.ends)
    states = [real[x] for x in states]
    for row in (row.xreplace(real) for row in rows):
        if row.has(*JUMPS, Table):
            continue
        for point in _suspects(row, around):
            for x in states:
                slope = row.diff(x)
                if slope == 0 or slope.has(sp.re, sp.im) or slope.count_ops() >= _OPERATIONS:
                    continue  # |e| of an e that is not real everywhere: its limit is expensive
                if _grows(slope, point, around):
                    return slope.xreplace(plain), {plain[s]: value for s, value in point.items()}
    return None


def _suspects(row: sp.Expr, around: Sides) -> Iterator[Point]:
    kinds = (sp.Pow, sp.log, sp.asin, sp.acos, sp.atanh, sp.acosh), (sp.tan,)
    nodes = (node for some in kinds for node in sorted(row.atoms(*some), key=str))
    for argument in dict.fromkeys(e for node in nodes for e in edges(node)):
        symbols = [s for s in around.symbols if s in argument.free_symbols]
        part = around.only(symbols)
        if not symbols:
            continue
        special = special_point(argument, tape([argument], part.symbols), part, ("= 0",))
        if special:
            yield next(around.spread()) | special[1]


def _grows(slope: sp.Expr, point: Point, around: Sides) -> bool:
    t = sp.Dummy("t", positive=True)
    exponents = {s for node in slope.atoms(sp.Pow) for s in node.exp.free_symbols}
    for target in islice(around.spread(), 6):  # exponents are constant: powers to long fractions are expensive
        step = {s: Fraction(0) if s in exponents else target[s] - value for s, value in point.items()}
        along = substituted(slope, {s: sp.Rational(value) + t * sp.Rational(step[s]) for s, value in point.items()})
        along = along and along.replace(lambda node: isinstance(node, _TURNING), lambda node: _branch(node, t))
        if not along or not along.has(t) or along.has(sp.Heaviside):
            continue
        sizes = [_size(along, {t: sp.Rational(1, 2**digits)}) for digits in _DISTANCES]
        if None in sizes or not sizes[0] < sizes[1] < sizes[2]:  # type: ignore[operator]
            continue
        try:
            limit = sp.limit(along, t, 0, "+")
        except (NotImplementedError, ValueError, TypeError, RecursionError, sp.PoleError):
            return False  # other lines would fail as well, and each limit may be expensive
        if limit in (sp.oo, -sp.oo):
            return True
    return False


def _branch(node: sp.Expr, t: sp.Symbol) -> sp.Expr:
    if isinstance(node, (sp.Min, sp.Max)):
        way = 1 if isinstance(node, sp.Max) else -1
        ahead = (a for a in node.args if all((way * (a - b)).subs(t, 0).is_positive for b in node.args if b != a))
        return next(ahead, node)
    (argument, *_) = node.args
    start = argument.subs(t, 0)
    above, below = (argument, -argument) if isinstance(node, sp.Abs) else (sp.S.One, sp.S.Zero)
    return above if start.is_positive else below if start.is_negative else node


def _size(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Rational]) -> sp.Expr | None:
    if sign_at(expression, at) not in ("> 0", "< 0"):
        return None
    return abs(expression.xreplace(dict(at)).evalf(20))


# --- functions that vanish to second order

_FAR = 20.0  # width of the first steps along a side without ends
_SAMPLES, _BEST = 600, 6  # samples, and the best of them
_ROUNDS, _AROUND = 10, 40  # steps uphill from each, and points of a step
_SMALLEST = 10  # most halvings of the box on which N is tried
_RELATIVES = (0.05, 0.002)  # tolerances of the norm
_FEW = 200  # sample points of a matrix
_BITS = 128
_DIGITS = 1024  # parts of the largest entry to which a direction is rounded


@dataclass(frozen=True)
class SecondOrder:
    """The claim that S(e, x) = `value` < 0 for all x in `box` and all errors e != 0 (the symbols `errors`) in the box
    `around` 0.

    `matrix`: a symmetric N(c, x) with S <= - e'N e, N averaged over the `copies` c of e, each a tuple of symbols (n).
    """

    value: sp.Expr
    matrix: sp.Matrix
    copies: tuple[tuple[sp.Symbol, ...], ...]
    errors: tuple[sp.Symbol, ...]
    around: Box
    box: Box
    states: tuple[sp.Symbol, ...] = ()

    def sides(self, share: Fraction = Fraction(1)) -> Sides:
        """Return the box of e, scaled by `share`, and of x."""
        symbols = (*self.errors, *sorted(self.value.free_symbols - {*self.errors}, key=str))
        whole = {**self.box, **{e: (low * share, high * share) for e, (low, high) in self.around.items()}}
        return Sides(symbols, tuple(whole[s] for s in symbols))


@dataclass(frozen=True)
class Answer:
    """The verdict on the claim S(e, x) < 0: PROVED by the `proofs`, REFUTED by an exact `point` with S = `value` >= 0,
    or UNKNOWN for the `reason`.

    `share`: the share of the box of e on which N is proved positive definite (S <= - e'N e), by way of T'N T, T =
    `basis`, which is nearly the unit matrix. The first proof is about N, the other ones prove S < 0 on the slabs that
    cover the remaining box.
    """

    verdict: Verdict
    reason: Reason = NONE
    point: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)
    value: float | None = None
    proofs: tuple[Proof, ...] = ()
    share: Fraction = Fraction(1)
    basis: sp.Matrix | None = None


def negative(claim: SecondOrder, boxes: int, obstacle: Reason = NONE) -> Answer:
    """Return the verdict on the claim S(e, x) < 0 for e != 0. Near e = 0 a definite matrix N proves it (S <= - e'N e),
    on the remaining box bisection, with at most `boxes` for each sign. `obstacle`: the reason why N does not bound S;
    the verdict is then refuted or unknown."""
    counterexample = _refuted(claim, _samples(claim))
    if counterexample or obstacle:
        return counterexample or Answer(Verdict.UNKNOWN, obstacle)
    share, definite = _largest(claim, boxes)
    if definite is None:
        pattern = "near e = 0 the second order does not decide it, with {boxes} boxes for a sign"
        return _refuted(claim, _along(claim)) or Answer(Verdict.UNKNOWN, because(pattern, boxes=boxes))
    proof, basis = definite
    if share == 1:
        whole = because("its second order is definite on the whole box of errors")
        return Answer(Verdict.PROVED, whole, proofs=(proof,), basis=basis)
    signs = tuple(nonzero(claim.value, slab, boxes=boxes, refute=False) for slab in _slabs(claim, share))
    largest = (dict(sign.range.most.point) for sign in signs if sign.range.most is not None)
    return _refuted(claim, largest) or _on_slabs(claim, boxes, share, definite, signs)


def _on_slabs(
    claim: SecondOrder, boxes: int, share: Fraction, definite: tuple[Proof, sp.Matrix], signs: Sequence[Sign]
) -> Answer:
    """Return the verdict on S(e, x) < 0 from the `signs` of S on slabs that cover the box of e outside the `share` on
    which N is definite (S <= - e'N e); `definite`: the proof about N and its basis."""
    proof, basis = definite
    if all(sign.verdict is Verdict.PROVED and sign.sign < 0 for sign in signs):
        total = sum(sign.range.boxes for sign in signs)
        pattern = "its second order is definite on {share} of the box of errors, {boxes} boxes cover the rest"
        reason = because(pattern, share=share, boxes=total)
        extents = (sign.range for sign in signs)
        slabs = (Proof((claim.value,), *ends(each.low, each.high), each.variables, each.tree) for each in extents)
        return Answer(Verdict.PROVED, reason, proofs=(proof, *slabs), share=share, basis=basis)
    pattern = (
        "its second order is definite on {share} of the box of errors; the rest is not decided, with {boxes} boxes for "
        "each of {slabs} slabs"
    )
    return Answer(Verdict.UNKNOWN, because(pattern, share=share, boxes=boxes, slabs=len(signs)))


# --- a counterexample


def _refuted(claim: SecondOrder, points: Iterable[Point]) -> Answer | None:
    """Return the refutation by the first of the points in the box with e != 0 at which S >= 0 is proved; None if there
    is none."""
    around = claim.sides()
    program = tape([claim.value], around.symbols)
    for point in points:
        if any(point[e] for e in claim.errors) and around.contains(point):
            (ball,) = values(program, [point[s] for s in around.symbols], _BITS)
            if ball >= 0:
                return Answer(Verdict.REFUTED, point=point, value=float(ball.mid()))
    return None


def _samples(claim: SecondOrder) -> Iterator[Point]:
    """Yield points with large S/|e|^2, which a random search uphill reaches from the best samples of the box."""
    around = claim.sides()
    program = tape([claim.value / sp.Add(*(e**2 for e in claim.errors))], around.symbols)
    (low, high), m = (end[:, None] for end in around.outer), len(around.symbols)
    width, t = np.where(np.isinf(high - low), _FAR, high - low), spread(m, _AROUND)[:, :, None]

    def rates(x: Array) -> Array:
        (ratio,) = enclose(program, x, x)
        return np.where(ratio.defined, ratio.value[0], -np.inf)

    x = np.concatenate((corners(*around.outer), placed(*around.outer, spread(m, _SAMPLES))), axis=1)
    best = x[:, np.argsort(-rates(x), kind="stable")[:_BEST]]
    for step in range(_ROUNDS):
        reach = width / 2.0 ** (step + 2)
        first, last = np.maximum(low, best - reach)[:, None], np.minimum(high, best + reach)[:, None]
        candidates = np.concatenate((best[:, None], first + (last - first) * t), axis=1)  # m x points x starts
        highest = rates(candidates.reshape(m, -1)).reshape(candidates.shape[1:]).argmax(axis=0)
        best = candidates[:, highest, range(candidates.shape[2])]
    yield from (around.point(at) for at in best.T.tolist())


def _along(claim: SecondOrder) -> Iterator[Point]:
    """Yield points with small e along the eigenvector of the smallest eigenvalue of N at e = 0 (S <= - e'N e), for
    sampled x in the order of this eigenvalue."""
    sampled, around = _Sampled.of(*_restricted(claim, Fraction(0))), claim.sides()
    with np.errstate(invalid="ignore"):
        start = around.point(middle(*around.outer).tolist())
    reach = min(min(-Fraction(a), Fraction(b)) for a, b in claim.around.values())
    smallest = sampled.spectra[:, 0]
    for k in (k for k in np.argsort(smallest, kind="stable")[:_BEST] if np.isfinite(smallest[k])):
        direction = np.linalg.eigh(sampled.matrices[k])[1][:, 0]
        d = [Fraction(round(float(x) * _DIGITS), _DIGITS) for x in direction]
        for i, sign in product(range(0, 40, 3), (1, -1)):
            e = {s: sign * x * reach / 2**i for s, x in zip(claim.errors, d, strict=True)}
            yield start | sampled.around.point(sampled.points[:, k].tolist()) | e


# --- positive definite


def _largest(claim: SecondOrder, boxes: int) -> tuple[Fraction, tuple[Proof, sp.Matrix] | None]:
    """Return the largest share 1, 1/2, 1/4, .. of the box of e on which N is proved positive definite (S <= - e'N e),
    and the proof with its basis; None in place of the proof if there is none."""
    share, definite = Fraction(1), None
    if _definite(*_restricted(claim, Fraction(0)), boxes) is not None:
        for share in (Fraction(1, 2**k) for k in range(_SMALLEST + 1)):
            definite = _definite(*_restricted(claim, share), boxes)
            if definite is not None:
                break
    return share, definite


def _restricted(claim: SecondOrder, share: Fraction) -> tuple[sp.Matrix, Box]:
    """Return the matrix N(c, x) and the box of its symbols, each copy c of e in a `share` of the box of e. If N
    contains x and c as x - c only, this difference is one symbol."""
    box, matrix = dict(claim.box), claim.matrix
    if not share:
        matrix = matrix.xreplace({c: sp.S.Zero for copy in claim.copies for c in copy})
        return matrix, {s: box[s] for s in sorted(matrix.free_symbols, key=str)}
    for copy in claim.copies:
        for e, c in zip(claim.errors, copy, strict=True):
            low, high = (Fraction(end) * share for end in claim.around[e])
            box[c] = low, high
        for x, c in zip(claim.states, copy, strict=bool(claim.states)):
            behind = sp.Dummy(f"{x.name}_behind", real=True)
            joined = matrix.xreplace({x: behind + c})
            if c in matrix.free_symbols and not {x, c} & joined.free_symbols:
                matrix, (first, last) = joined, claim.box[x]
                box[behind] = first - box[c][1], last - box[c][0]
    return matrix, {s: box[s] for s in sorted(matrix.free_symbols, key=str)}


def _definite(matrix: sp.Matrix, box: Box, boxes: int) -> tuple[Proof, sp.Matrix] | None:
    """Return the proof that a symmetric matrix M is positive definite on the whole box, and the matrix T with T'M T
    nearly 1 that it uses; None if there is no proof."""
    n, sampled = matrix.rows, _Sampled.of(matrix, box)
    if not sampled.least > 0:
        return None
    T = np.linalg.inv(np.linalg.cholesky(sampled.matrices[0])).T
    basis = sp.Matrix(n, n, [_four_digits(value) for value in T.ravel()])
    turned = _Sampled.of(basis.T * matrix * basis, box)
    if not turned.least > 0:
        return None
    t = tuple(sp.Dummy(f"t{i + 1}", real=True) for i in range(n))
    middle = _four_digits((turned.least + turned.most) / 2)
    rows = (sp.eye(n) - basis.T * matrix * basis / middle) * sp.Matrix(t)
    whole: Box = {**box, **dict.fromkeys(t, (Fraction(-1), Fraction(1)))}
    for relative in _RELATIVES:
        steepest = lipschitz_bound(rows, t, whole, boxes=boxes, relative=relative)
        if steepest.verdict is Verdict.PROVED and steepest.high < 1:
            high, tree = Fraction(steepest.high), steepest.tree
            return Proof(tuple(rows), None, high, steepest.variables, tree), basis
        if steepest.verdict is not Verdict.PROVED or steepest.low >= 1:
            break
    return None


def _four_digits(value: float) -> sp.Rational:
    return sp.Rational(f"{float(value):.4g}")


@dataclass(frozen=True)
class _Sampled:
    """A symbolic symmetric matrix in floats, without proof, at sample `points` (m, k) of a box, its middle first:
    `matrices` (k, n, n) and their eigenvalues `spectra` (k, n), -inf for a matrix that is not finite."""

    around: Sides
    points: Array
    matrices: Array
    spectra: Array

    @classmethod
    def of(cls, matrix: sp.Matrix, box: Box) -> "_Sampled":
        around, n = Sides(tuple(box), tuple(box.values())), matrix.rows
        low, high = around.outer
        with np.errstate(all="ignore"):
            points = np.concatenate((corners(low, high), placed(low, high, spread(len(low), _FEW))), axis=1)
        entries = [entry.value for entry in enclose(tape(list(matrix), around.symbols), points, points)]
        matrices = np.array([least / 2 + most / 2 for least, most in entries]).T.reshape(-1, n, n)
        finite = np.isfinite(matrices).all(axis=(1, 2))
        matrices = np.where(finite[:, None, None], matrices, 0.0)
        return cls(around, points, matrices, np.where(finite[:, None], np.linalg.eigvalsh(matrices), -np.inf))

    @property
    def least(self) -> float:
        return float(self.spectra[:, 0].min())

    @property
    def most(self) -> float:
        return float(self.spectra[:, -1].max())


def _slabs(claim: SecondOrder, share: Fraction) -> Iterator[Box]:
    """Yield boxes that together cover the box of e except its `share` around 0, each with the box of x."""
    inner: dict[sp.Symbol, tuple[Any, Any]] = dict(claim.around)
    for e in claim.errors:
        low, high = (Fraction(end) for end in claim.around[e])
        yield {**claim.box, **inner, e: (low, low * share)}
        yield {**claim.box, **inner, e: (high * share, high)}
        inner[e] = low * share, high * share
