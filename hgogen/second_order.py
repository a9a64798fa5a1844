"""Whether a function that vanishes to second order at e = 0 is negative elsewhere on a box around it.

S(e, x) is no difference of positive numbers near e = 0, where it and its slope vanish: no bisection ends there. But
let N(c, x), a symmetric matrix, be such that S(e, x) <= - e'N e, N the average of N(c, x) over copies c of e in any
box around 0 that holds e. Positive definite N for every c in the box then gives S < 0 for every e of it but 0. So N is
tried on the whole box, and where that fails on smaller ones, half as wide each time; what is left of the box is covered
by slabs on which S keeps off 0 (`bounds.nonzero`). Positive definite by its leading principal minors (Sylvester), each
of one sign on the box, of T'N T with a constant T that makes it nearly the unit matrix in the middle.

Refuted by a point, exact and rational, where S >= 0 and e is not 0: from samples, from a direction along which N is not
positive, or from a slab.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.bounds import Sign, nonzero
from hgogen.box import Box, Point, Sides, rational
from hgogen.check import Verdict
from hgogen.pointwise import values
from hgogen.proof import Proof, ends
from hgogen.tape import Tape, tape

_GRID = 1024  # of a side: samples are exact
_SCALES = 10  # halvings of the box at which samples are taken
_SAMPLES, _ROUNDS, _BEST = 2000, 12, 6
_SMALLEST = 10  # halvings after which N is not tried further
_BITS = 128
_FAR = Fraction(10)  # for samples of what has no range


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
    """PROVED with the proofs, REFUTED with an exact point and the value there, or UNKNOWN; `reason` says how."""

    verdict: Verdict
    reason: str
    point: Mapping[sp.Symbol, Fraction] = field(default_factory=dict, hash=False)
    proofs: tuple[Proof, ...] = ()


def negative(asked: SecondOrder, boxes: int, obstacle: str = "") -> Answer:
    """Whether S < 0, as above; `boxes` for each question of a sign. With an `obstacle`, why N says nothing of S, it is
    refuted or unknown."""
    program = _Program.of(asked)
    found = next(program.violations(_samples(program)), None)
    if found:
        return _refuted(program, found)
    if obstacle:
        return Answer(Verdict.UNKNOWN, obstacle)
    share, proofs = Fraction(1), None
    tried: list[Point] = []
    while proofs is None and share >= Fraction(1, 2**_SMALLEST):
        proofs = _definite(*_near(asked, share), boxes, tried)
        share /= 2
    if proofs is None:
        found = next(program.violations(_along(program, tried, boxes)), None)
        if found:
            return _refuted(program, found)
        reason = "near e = 0 the second order does not decide it"
        return Answer(Verdict.UNKNOWN, f"{reason}, with {boxes} boxes for a sign")
    share *= 2
    if share == 1:
        return Answer(Verdict.PROVED, "its second order is definite on the whole box of errors", proofs=proofs)
    left = tuple(nonzero(asked.value, slab, boxes=boxes) for slab in _slabs(asked, share))
    for sign in left:
        found = next(program.violations(_of(sign)), None)
        if found:
            return _refuted(program, found)
    if all(sign.verdict is Verdict.PROVED and sign.sign < 0 for sign in left):
        total = sum(sign.range.boxes for sign in left)
        reason = f"its second order is definite on {share} of the box of errors, {total} boxes cover the rest"
        slabs = tuple(_proof(asked.value, slab, sign) for slab, sign in zip(_slabs(asked, share), left, strict=True))
        return Answer(Verdict.PROVED, reason, proofs=(*proofs, *slabs))
    reason = f"its second order is definite on {share} of the box of errors; the rest is not decided"
    return Answer(Verdict.UNKNOWN, f"{reason}, with {boxes} boxes for each of {len(left)} slabs")


# --- a counterexample ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Program:
    """S as a tape and as a numpy function."""

    asked: SecondOrder
    symbols: tuple[sp.Symbol, ...]
    exactly: Tape
    floats: Any

    @classmethod
    def of(cls, asked: SecondOrder) -> "_Program":
        others = sorted(asked.value.free_symbols - {*asked.errors}, key=str)
        symbols = (*asked.errors, *others)
        return cls(asked, symbols, tape([asked.value], symbols), sp.lambdify(symbols, asked.value, "numpy"))

    def violations(self, points: Iterator[Point]) -> Iterator[tuple[Point, str]]:
        """Those of the points where S >= 0 is proved and e is not 0, with the value there."""
        everything = {**self.asked.box, **self.asked.around}
        sides = Sides(self.symbols, tuple(everything[s] for s in self.symbols))
        for point in points:
            if not any(point[e] for e in self.asked.errors) or not sides.contains(point):
                continue
            (ball,) = values(self.exactly, [point[s] for s in self.symbols], _BITS)
            if ball >= 0:
                yield point, f"{float(ball.mid()):.3g}"

    def ratio(self, x: np.ndarray) -> np.ndarray:
        """S/|e|^2 at points (number of symbols, k), -inf where it is not a number."""
        with np.errstate(all="ignore"):
            value = np.broadcast_to(np.asarray(self.floats(*x), dtype=float), x.shape[1:])
            found = value / (x[: len(self.asked.errors)] ** 2).sum(axis=0)
        return np.where(np.isfinite(found), found, -np.inf)


def _refuted(program: _Program, found: tuple[Point, str]) -> Answer:
    point, value = found
    return Answer(Verdict.REFUTED, f"it is {value} there", point)


def _samples(program: _Program) -> Iterator[Point]:
    """The worst of a fixed set of random points, each moved uphill; e on scales down to a thousandth of its box."""
    n, rng = len(program.asked.errors), np.random.default_rng(1)
    low, high = _floats(program)
    size = len(program.symbols)
    whole = rng.integers(0, _GRID + 1, size=(size, _SAMPLES))
    whole[:, : _SAMPLES // 4] = rng.integers(0, 2, size=(size, _SAMPLES // 4)) * _GRID
    scale = 2.0 ** -rng.integers(0, _SCALES, size=_SAMPLES)

    def placed(grid: np.ndarray, scale: np.ndarray) -> np.ndarray:
        x = low[:, None] + (high - low)[:, None] * (grid / _GRID)
        x[:n] = x[:n] * scale
        return np.asarray(x)

    ratio = program.ratio(placed(whole, scale))
    for k in np.argsort(-ratio, kind="stable")[:_BEST]:
        best, small, most = whole[:, k], scale[k], ratio[k]
        for step in range(_ROUNDS):
            reach = max(1, _GRID >> (step + 2))
            near = np.clip(best[:, None] + rng.integers(-reach, reach + 1, size=(size, 48)), 0, _GRID)
            scales = np.minimum(small * 2.0 ** rng.integers(-1, 2, size=48), 1.0)
            tried = program.ratio(placed(near, scales))
            j = int(np.argmax(tried))
            if tried[j] > most:
                best, small, most = near[:, j], scales[j], tried[j]
        yield _exactly(program, best, Fraction(float(small)))


def _floats(program: _Program) -> tuple[np.ndarray, np.ndarray]:
    pairs = [_sampled(program, s) for s in program.symbols]
    return np.array([float(a) for a, _ in pairs]), np.array([float(b) for _, b in pairs])


def _sampled(program: _Program, symbol: sp.Symbol) -> tuple[Fraction, Fraction]:
    """The symbol's range, cut where it is not bounded."""
    low, high = {**program.asked.box, **program.asked.around}[symbol]
    first = Fraction(low) if abs(low) != float("inf") else min(-_FAR, Fraction(min(high, 0)) - _FAR)
    last = Fraction(high) if abs(high) != float("inf") else max(_FAR, first + _FAR)
    return first, last


def _exactly(program: _Program, grid: np.ndarray, scale: Fraction) -> Point:
    point = {}
    for symbol, k in zip(program.symbols, grid, strict=True):
        low, high = _sampled(program, symbol)
        value = low + (high - low) * int(k) / _GRID
        point[symbol] = value * scale if symbol in program.asked.errors else value
    return point


def _along(program: _Program, tried: list[Point], boxes: int) -> Iterator[Point]:
    """Short steps e from points x where N of zero copies is not positive definite, along its worst direction."""
    asked, n = program.asked, len(program.asked.errors)
    matrix = asked.matrix.xreplace({c: sp.S.Zero for copy in asked.copies for c in copy})
    for found in (*_indefinite(matrix, asked.box, boxes), *tried):
        x = {s: found[s] if s in found else _sampled(program, s)[0] for s in program.symbols[n:]}
        there = _numbers(matrix, x)
        if not np.isfinite(there).all():
            continue
        direction = np.linalg.eigh(there)[1][:, 0]
        e = [Fraction(round(float(d) * _GRID), _GRID) for d in direction]
        reach = min(min(-Fraction(a), Fraction(b)) for a, b in asked.around.values())
        for k, sign in product(range(0, 40, 3), (1, -1)):
            yield x | {s: sign * d * reach / 2**k for s, d in zip(asked.errors, e, strict=True)}


def _indefinite(matrix: sp.Matrix, box: Box, boxes: int) -> Iterator[Point]:
    """Points where a leading minor is least."""
    for minor in _minors(matrix):
        least = nonzero(minor, box, boxes=boxes).range.least
        if least is not None:
            yield dict(least.point)


def _of(sign: Sign) -> Iterator[Point]:
    """Where a search met the largest value, and its witness."""
    if sign.range.most is not None:
        yield dict(sign.range.most.point)
    if sign.witness:
        yield dict(sign.witness)


# --- positive definite --------------------------------------------------------------------------------------


def _near(asked: SecondOrder, share: Fraction) -> tuple[sp.Matrix, Box]:
    """N and its box, every copy in `share` of the box of e; where N reads x and a copy by their difference alone, it
    is one symbol."""
    box, matrix = dict(asked.box), asked.matrix
    for copy in asked.copies:
        for e, c in zip(asked.errors, copy, strict=True):
            low, high = (Fraction(end) * share for end in asked.around[e])
            box[c] = low, high
        for x, c in zip(asked.states, copy, strict=bool(asked.states)):
            behind = sp.Dummy(f"{x.name}_behind", real=True)
            joined = matrix.xreplace({x: behind + c})
            if c in matrix.free_symbols and not {x, c} & joined.free_symbols:
                matrix, (first, last) = joined, asked.box[x]
                box[behind] = first - box[c][1], last - box[c][0]
    return matrix, {s: box[s] for s in sorted(matrix.free_symbols, key=str)}


def _definite(matrix: sp.Matrix, box: Box, boxes: int, tried: list[Point]) -> tuple[Proof, ...] | None:
    """The proofs that N is positive definite on the whole box, or None."""
    order = tuple(box)
    middle = Sides(order, tuple(box[s] for s in order)).centre() if order else {}
    there = _numbers(matrix, middle)
    if not np.isfinite(there).all() or np.linalg.eigvalsh(there).min() <= 0:
        tried.append(middle)
        return None
    proofs = []
    for minor in _minors(_preconditioned(matrix, there)):
        sign = nonzero(minor, box, boxes=boxes)
        if sign.verdict is not Verdict.PROVED or sign.sign < 0:
            return None
        proofs.append(_proof(minor, box, sign))
    return tuple(proofs)


def _numbers(matrix: sp.Matrix, point: Mapping[sp.Symbol, Fraction]) -> np.ndarray:
    """The matrix at a point in floats, nan where it is not real."""
    try:
        return np.array(matrix.xreplace({s: rational(v) for s, v in point.items()}).evalf(), dtype=float)
    except (TypeError, ValueError):
        return np.full(matrix.shape, np.nan)


def _preconditioned(matrix: sp.Matrix, there: np.ndarray) -> sp.Matrix:
    """T'N T, T rational and upper triangular with a positive diagonal, near the inverse of Cholesky's factor of N in
    the middle."""
    T = np.linalg.inv(np.linalg.cholesky(there)).T
    short = sp.Matrix(*T.shape, [sp.Rational(*float(f"{v:.4g}").as_integer_ratio()) for v in T.ravel()])
    return (short.T * matrix * short).applyfunc(sp.expand)


def _minors(matrix: sp.Matrix) -> Iterator[sp.Expr]:
    for k in range(1, matrix.rows + 1):
        yield sp.expand(matrix[:k, :k].det(method="berkowitz"))


def _slabs(asked: SecondOrder, share: Fraction) -> Iterator[Box]:
    """Boxes that cover what `share` of the box of e leaves."""
    inner: dict[sp.Symbol, tuple[Any, Any]] = dict(asked.around)
    for e in asked.errors:
        low, high = (Fraction(end) for end in asked.around[e])
        yield {**asked.box, **inner, e: (low, low * share)}
        yield {**asked.box, **inner, e: (high * share, high)}
        inner[e] = low * share, high * share


def _proof(expression: sp.Expr, box: Box, sign: Sign) -> Proof:
    found = sign.range
    return Proof("range", (expression,), box, *ends(found.low, found.high), found.variables, found.tree)
