"""Whether a function that vanishes to second order at e = 0 is negative elsewhere on a box around it.

S(e, x) is no difference of positive numbers near e = 0, where it and its slope vanish: no bisection ends there. But
let N(c, x), a symmetric matrix, be such that S(e, x) <= - e'N e, N the average of N(c, x) over copies c of e in any
box around 0 that holds e. Positive definite N for every c in the box then gives S < 0 for every e of it but 0. So N is
tried on the whole box, and where that fails on smaller ones, half as wide each time; what is left of the box is covered
by slabs on which S keeps off 0 (`bounds.nonzero`). Positive definite by |I - T'N T/s| < 1 (`slope.lipschitz_bound` of
the field (I - T'N T/s) t of t), with a constant T that makes T'N T the unit matrix in the middle, and s in the middle
of its eigenvalues.

Refuted by a point, exact and rational, where S >= 0 and e is not 0: from samples, from a direction along which N is not
positive, or from a slab.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.check import Verdict
from hgogen.rigor.balls import values
from hgogen.rigor.bounds import Proof, ends, nonzero
from hgogen.rigor.box import Box, Point, Sides
from hgogen.rigor.slope import lipschitz_bound
from hgogen.rigor.tape import Tape, tape
from hgogen.sentence import NONE, Reason, because

_GRID = 1024  # of a side: samples are exact
_SCALES = 10  # halvings of the box at which samples are taken
_SAMPLES, _ROUNDS, _BEST = 2000, 12, 6
_SMALLEST = 10  # halvings after which N is not tried further
_RELATIVE = (0.05, 0.002)  # of the norm
_FEW = 100
_BITS = 128
_FAR = Fraction(10)  # for samples of what has no range
# for SymPy's own, of which version 1.13 makes an array of all arguments, which a number beside arrays does not let it
_EXTREMES = {sp.Min: sp.Function("least_of"), sp.Max: sp.Function("most_of")}
_FUNCTIONS = {
    "least_of": lambda *arguments: reduce(np.minimum, arguments),
    "most_of": lambda *arguments: reduce(np.maximum, arguments),
}


def on_arrays(symbols: Sequence[sp.Symbol], rows: Sequence[sp.Expr]) -> Callable[..., list[Any]]:
    """The values of rows where the symbols are arrays, in floats, for what is found by samples and proved of none; of a
    row that reads no symbol a number. A symbol may have the name of a function."""
    replaced = [
        sp.sympify(row).replace(lambda e: type(e) in _EXTREMES, lambda e: _EXTREMES[type(e)](*e.args)) for row in rows
    ]
    function: Callable[..., list[Any]] = sp.lambdify(symbols, replaced, [_FUNCTIONS, "numpy"], dummify=True)
    return function


@dataclass(frozen=True)
class SecondOrder:
    """S < 0 is asked for all x of `box` and all e of `around` but 0.

    `matrix`: N of the `copies`, one tuple of symbols (n) each in the order of e, and of x.
    """

    value: sp.Expr
    matrix: sp.Matrix
    copies: tuple[tuple[sp.Symbol, ...], ...]
    errors: tuple[sp.Symbol, ...]
    around: Box
    box: Box
    states: tuple[sp.Symbol, ...] = ()


@dataclass(frozen=True)
class Answer:
    """PROVED with the proofs, REFUTED with an exact point and the `value` there, or UNKNOWN; `reason` says how.

    Of what is proved, `share` of the box of errors is that where N is definite, T'N T nearly the unit matrix with T =
    `basis`; the proofs are the one of that, and one for each slab.
    """

    verdict: Verdict
    reason: Reason = NONE
    point: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)
    value: float | None = None
    proofs: tuple[Proof, ...] = ()
    share: Fraction = Fraction(1)
    basis: sp.Matrix | None = None


def negative(claim: SecondOrder, boxes: int, obstacle: Reason = NONE) -> Answer:
    """Whether S < 0, by the method of the module, with `boxes` for each question of a sign. With an `obstacle`, the
    reason why N says nothing of S, the answer is refuted or unknown."""
    program = _Program.of(claim)
    violation = next(program.violations(_samples(program)), None)
    if violation:
        return _refuted(violation)
    if obstacle:
        return Answer(Verdict.UNKNOWN, obstacle)
    share, definite = _largest(claim, boxes)
    if definite is None:
        violation = next(program.violations(_along(program)), None)
        if violation:
            return _refuted(violation)
        pattern = "near e = 0 the second order does not decide it, with {boxes} boxes for a sign"
        return Answer(Verdict.UNKNOWN, because(pattern, boxes=boxes))
    if share == 1:
        whole = because("its second order is definite on the whole box of errors")
        return Answer(Verdict.PROVED, whole, proofs=(definite.proof,), basis=definite.basis)
    left = tuple(nonzero(claim.value, slab, boxes=boxes, refute=False) for slab in _slabs(claim, share))
    met = (dict(sign.range.most.point) for sign in left if sign.range.most is not None)  # at the largest values
    violation = next(program.violations(met), None)
    if violation:
        return _refuted(violation)
    if all(sign.verdict is Verdict.PROVED and sign.sign < 0 for sign in left):
        total = sum(sign.range.boxes for sign in left)
        pattern = "its second order is definite on {share} of the box of errors, {boxes} boxes cover the rest"
        reason = because(pattern, share=share, boxes=total)
        extents = (sign.range for sign in left)
        slabs = (Proof((claim.value,), *ends(each.low, each.high), each.variables, each.tree) for each in extents)
        return Answer(Verdict.PROVED, reason, proofs=(definite.proof, *slabs), share=share, basis=definite.basis)
    pattern = (
        "its second order is definite on {share} of the box of errors; the rest is not decided, with {boxes} boxes for "
        "each of {slabs} slabs"
    )
    return Answer(Verdict.UNKNOWN, because(pattern, share=share, boxes=boxes, slabs=len(left)))


# --- a counterexample


@dataclass(frozen=True)
class _Grid:
    """Points of a box, each a column of whole numbers up to `_GRID`; sides that are not bounded are cut."""

    symbols: tuple[sp.Symbol, ...]
    sides: tuple[tuple[Fraction, Fraction], ...]

    @classmethod
    def of(cls, symbols: Sequence[sp.Symbol], box: Box) -> "_Grid":
        return cls(tuple(symbols), tuple(_cut(box[s]) for s in symbols))

    def floats(self, columns: np.ndarray) -> np.ndarray:
        low, high = np.array(self.sides, dtype=float).reshape(-1, 2).T[:, :, None]
        return np.asarray(low + (high - low) * (columns / _GRID))

    def exactly(self, column: np.ndarray) -> dict[sp.Symbol, Fraction]:
        pairs = zip(self.symbols, self.sides, column, strict=True)
        return {s: low + (high - low) * int(k) / _GRID for s, (low, high), k in pairs}


def _neighbours(column: np.ndarray, step: int, rng: np.random.Generator) -> np.ndarray:
    """Random points of a grid around one, the closer the later the step."""
    reach = max(1, _GRID >> (step + 2))
    return np.clip(column[:, None] + rng.integers(-reach, reach + 1, size=(len(column), 48)), 0, _GRID)


def _cut(ends: tuple[Any, Any]) -> tuple[Fraction, Fraction]:
    low, high = ends
    first = Fraction(low) if abs(low) != float("inf") else min(-_FAR, Fraction(min(high, 0)) - _FAR)
    last = Fraction(high) if abs(high) != float("inf") else max(_FAR, first + _FAR)
    return first, last


@dataclass(frozen=True)
class _Program:
    """S as a tape and as a numpy function, of e and what else it reads."""

    claim: SecondOrder
    grid: _Grid
    exactly: Tape
    floats: Any

    @classmethod
    def of(cls, claim: SecondOrder) -> "_Program":
        symbols = (*claim.errors, *sorted(claim.value.free_symbols - {*claim.errors}, key=str))
        graph = on_arrays(symbols, [claim.value])
        grid = _Grid.of(symbols, {**claim.box, **claim.around})
        return cls(claim, grid, tape([claim.value], symbols), lambda *point: graph(*point)[0])

    def violations(self, points: Iterator[Point]) -> Iterator[tuple[Point, float]]:
        """The points where S >= 0 is proved and e is not 0, with the value there."""
        symbols, everything = self.grid.symbols, {**self.claim.box, **self.claim.around}
        sides = Sides(symbols, tuple(everything[s] for s in symbols))
        for point in points:
            if not any(point[e] for e in self.claim.errors) or not sides.contains(point):
                continue
            (ball,) = values(self.exactly, [point[s] for s in symbols], _BITS)
            if ball >= 0:
                yield point, float(ball.mid())

    def ratio(self, columns: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """The ratios S/|e|^2 at points of the grid (number of symbols, k), e scaled, -inf where one is not finite."""
        x, n = self.grid.floats(columns), len(self.claim.errors)
        x[:n] = x[:n] * scale
        with np.errstate(all="ignore"):
            value = np.broadcast_to(np.asarray(self.floats(*x), dtype=float), x.shape[1:])
            ratios = value / (x[:n] ** 2).sum(axis=0)
        return np.where(np.isfinite(ratios), ratios, -np.inf)


def _refuted(violation: tuple[Point, float]) -> Answer:
    point, value = violation
    return Answer(Verdict.REFUTED, point=point, value=value)


def _samples(program: _Program) -> Iterator[Point]:
    """The points with the largest ratios of a fixed set of random ones, each moved uphill; e has scales down to a
    thousandth of its box."""
    rng, size = np.random.default_rng(1), len(program.grid.symbols)
    whole = rng.integers(0, _GRID + 1, size=(size, _SAMPLES))
    whole[:, : _SAMPLES // 4] = rng.integers(0, 2, size=(size, _SAMPLES // 4)) * _GRID
    scale = 2.0 ** -rng.integers(0, _SCALES, size=_SAMPLES)
    ratio = program.ratio(whole, scale)
    for k in np.argsort(-ratio, kind="stable")[:_BEST]:
        best, small, most = whole[:, k], scale[k], ratio[k]
        for step in range(_ROUNDS):
            neighbours = _neighbours(best, step, rng)
            scales = np.minimum(small * 2.0 ** rng.integers(-1, 2, size=48), 1.0)
            tried = program.ratio(neighbours, scales)
            j = int(np.argmax(tried))
            if tried[j] > most:
                best, small, most = neighbours[:, j], scales[j], tried[j]
        point, share = program.grid.exactly(best), Fraction(float(small))
        yield {s: x * share if s in program.claim.errors else x for s, x in point.items()}


def _along(program: _Program) -> Iterator[Point]:
    """Short steps e from points x where N of zero copies is not positive definite, along its worst direction."""
    claim, n = program.claim, len(program.claim.errors)
    eigenvalues = _Eigenvalues.of(*_restricted(claim, Fraction(0)))
    reach = min(min(-Fraction(a), Fraction(b)) for a, b in claim.around.values())
    for column in eigenvalues.worst():
        worst = eigenvalues.grid.exactly(column)
        x = {s: worst[s] if s in worst else _cut(claim.box[s])[0] for s in program.grid.symbols[n:]}
        direction = np.linalg.eigh(eigenvalues.floats(column[:, None])[0])[1][:, 0]
        e = [Fraction(round(float(d) * _GRID), _GRID) for d in direction]
        for k, sign in product(range(0, 40, 3), (1, -1)):
            yield x | {s: sign * d * reach / 2**k for s, d in zip(claim.errors, e, strict=True)}


# --- positive definite


@dataclass(frozen=True)
class _Definite:
    """The proof that N is positive definite, with T = `basis`."""

    proof: Proof
    basis: sp.Matrix


def _largest(claim: SecondOrder, boxes: int) -> tuple[Fraction, _Definite | None]:
    """The largest tried share of the box of e on which N is proved positive definite, halved as often as it takes, and
    the proof; the proof is None where N is not shown to be definite on any of them, or not even at e = 0."""
    share, definite = Fraction(1), None
    if _definite(*_restricted(claim, Fraction(0)), boxes) is None:
        return share, None
    for share in (Fraction(1, 2**k) for k in range(_SMALLEST + 1)):
        definite = _definite(*_restricted(claim, share), boxes)
        if definite is not None:
            break
    return share, definite


def _restricted(claim: SecondOrder, share: Fraction) -> tuple[sp.Matrix, Box]:
    """N and its box, with every copy in a `share` of the box of e; where N reads x and a copy by their difference
    alone, the difference is one symbol."""
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


def _definite(matrix: sp.Matrix, box: Box, boxes: int) -> _Definite | None:
    """The proof that N is positive definite on the whole box, or None."""
    n, eigenvalues = matrix.rows, _Eigenvalues.of(matrix, box)
    if not eigenvalues.least > 0:
        return None
    T = np.linalg.inv(np.linalg.cholesky(eigenvalues.middle)).T
    short = sp.Matrix(n, n, [_short(value) for value in T.ravel()])
    moved = _Eigenvalues.of(short.T * matrix * short, box)
    if not moved.least > 0:
        return None
    t = tuple(sp.Dummy(f"t{i + 1}", real=True) for i in range(n))
    rows = (sp.eye(n) - short.T * matrix * short / _short((moved.least + moved.most) / 2)) * sp.Matrix(t)
    whole: Box = {**box, **dict.fromkeys(t, (Fraction(-1), Fraction(1)))}
    for relative in _RELATIVE:
        steepest = lipschitz_bound(rows, t, whole, boxes=boxes, relative=relative)
        if steepest.verdict is Verdict.PROVED and steepest.high < 1:
            high, tree = Fraction(steepest.high), steepest.tree
            return _Definite(Proof(tuple(rows), None, high, steepest.variables, tree), short)
        if steepest.verdict is not Verdict.PROVED or steepest.low >= 1:
            break
    return None


def _short(value: float) -> sp.Rational:
    return sp.Rational(f"{float(value):.4g}")


@dataclass(frozen=True)
class _Eigenvalues:
    """The eigenvalues of a symmetric matrix of symbols at sample points of their box (`columns` of its grid), as floats
    that prove nothing.

    `least`, `most`: the extremes; `middle`: the matrix in the middle.
    """

    grid: _Grid
    floats: Callable[[np.ndarray], np.ndarray]
    columns: np.ndarray
    spectra: np.ndarray

    @classmethod
    def of(cls, matrix: sp.Matrix, box: Box) -> "_Eigenvalues":
        grid, graph = _Grid.of(tuple(box), box), on_arrays(tuple(box), list(matrix))
        rng, size, n = np.random.default_rng(1), len(box), matrix.rows
        corners = rng.integers(0, 2, size=(size, _FEW)) * _GRID
        inner = rng.integers(0, _GRID + 1, size=(size, _FEW))
        columns = np.concatenate((np.full((size, 1), _GRID // 2), corners, inner), axis=1)

        def floats(columns: np.ndarray) -> np.ndarray:
            with np.errstate(all="ignore"):
                entries = graph(*grid.floats(columns))
            whole = np.array([np.broadcast_to(np.asarray(entry, dtype=float), columns.shape[1:]) for entry in entries])
            return whole.T.reshape(-1, n, n)

        return cls(grid, floats, columns, _spectrum(floats(columns)))

    @property
    def least(self) -> float:
        """The smallest, -inf where the matrix is not finite."""
        return float(self.spectra[:, 0].min())

    @property
    def most(self) -> float:
        return float(self.spectra[:, -1].max())

    @property
    def middle(self) -> np.ndarray:
        return np.asarray(self.floats(self.columns[:, :1])[0])

    def worst(self) -> Iterator[np.ndarray]:
        """The points with the smallest eigenvalues, each moved downhill, where they are finite."""
        rng = np.random.default_rng(2)
        for k in np.argsort(self.spectra[:, 0], kind="stable")[:_BEST]:
            best, least = self.columns[:, k], self.spectra[k, 0]
            if not np.isfinite(least):
                continue
            for step in range(_ROUNDS):
                neighbours = _neighbours(best, step, rng)
                smallest = _spectrum(self.floats(neighbours))[:, 0]
                j = int(np.argmin(np.where(np.isfinite(smallest), smallest, np.inf)))
                if np.isfinite(smallest[j]) and smallest[j] < least:
                    best, least = neighbours[:, j], smallest[j]
            yield best


def _spectrum(matrices: np.ndarray) -> np.ndarray:
    """Eigenvalues (k, n) of matrices (k, n, n), -inf where they are not finite."""
    good = np.isfinite(matrices).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(good[:, None, None], matrices, 0.0))
    return np.where(good[:, None], values, -np.inf)


def _slabs(claim: SecondOrder, share: Fraction) -> Iterator[Box]:
    """Boxes that cover what `share` of the box of e leaves."""
    inner: dict[sp.Symbol, tuple[Any, Any]] = dict(claim.around)
    for e in claim.errors:
        low, high = (Fraction(end) for end in claim.around[e])
        yield {**claim.box, **inner, e: (low, low * share)}
        yield {**claim.box, **inner, e: (high * share, high)}
        inner[e] = low * share, high * share
