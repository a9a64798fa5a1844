"""Exact zero tests: whether an expression is 0 wherever it is defined, and which symbols a function depends on.

True is proved by exact algebra (`vanishes`); False by a value at an exact rational point whose ball excludes
0, or by a polynomial that is not 0. None: neither. A box restricts the points, not the algebra: |x| - x is not
refuted on x >= 1, and not proved either.
"""

import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import sympy as sp

from hgogen.rigor.balls import values
from hgogen.rigor.field import vanishes
from hgogen.rigor.points import exact, put, settled
from hgogen.rigor.tape import NoTape, tape

Box = Mapping[sp.Symbol, tuple[Any, Any]]

_QUICK, _PATIENT = 4, 12  # points
_BITS, _MORE_BITS = 64, (256, 1024, 4096)
# The ranges of points for a symbol without one: a positive range first, because logarithms and roots need it.
_SCALES = ((Fraction(1, 7), Fraction(2)), (Fraction(-3), Fraction(3)), (Fraction(0), Fraction(40)))
_GRID = 997
# Values at which a symbol is left out.
_NUMBERS = ((0,), (1,), (2, 1, 3), (sp.Rational(-1, 2), 3, 5))
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds)


def is_zero(expression: sp.Expr, box: Box | None = None) -> bool | None:
    """Whether the expression is 0 at every real point at which it is defined, and is defined somewhere.

    Args: `box` holds closed ranges of symbols, infinite ends allowed; a symbol without one may have any value. A
    symbol whose ends are equal has that value.
    """
    expression = _settled(expression, box)
    if expression.is_Rational:
        return bool(expression == 0)
    if expression.has(*_INFINITE):
        return None
    symbols = sorted(expression.free_symbols, key=str)
    try:
        program = tape((expression,), symbols)
    except NoTape:
        return True if vanishes(expression) else None
    points = list(_points(symbols, box, _PATIENT))
    quick = [values(program, point, _BITS)[0] for point in points[:_QUICK]]
    if any(_not_zero(ball) for ball in quick):
        return False
    answer = vanishes(expression)
    if answer is False:
        return False
    finite = any(ball.is_finite() for ball in quick)
    if answer and finite:
        return True
    for bits in _MORE_BITS:
        balls = [values(program, point, bits)[0] for point in points]
        if any(_not_zero(ball) for ball in balls):
            return False
        finite = finite or any(ball.is_finite() for ball in balls)
        if answer and finite:
            return True
    return None


def depends(expression: sp.Expr, symbol: sp.Symbol, box: Box | None = None) -> bool | None:
    """Whether the value changes with the symbol; terms that cancel do not count."""
    sure, maybe = dependence(expression, (symbol,), box)
    return True if sure else None if maybe else False


def dependence(
    expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None
) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...]]:
    """The symbols that the value is proved to depend on, and those for which this is not known.

    For the rest, e(.., s, ..) - e(.., t, ..) is 0 by exact algebra with s and t as two symbols; that the slope is 0
    would not be enough: atan(x) + atan(1/x) jumps.
    """
    expression = _settled(expression, box)
    present = [s for s in symbols if s in expression.free_symbols]
    seen = _seen(expression, present, box) if present else set()
    sure: list[sp.Symbol] = []
    maybe: list[sp.Symbol] = []
    for s in present:
        answer: bool | None = False
        if s not in seen:
            t = sp.Dummy(s.name, real=s.is_real)
            wider = {**(box or {}), **({t: box[s]} if box and s in box else {})}
            answer = is_zero(expression - expression.xreplace({s: t}), wider)
        if not answer:
            (sure if answer is False else maybe).append(s)
    return tuple(sure), tuple(maybe)


def reads(expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None) -> tuple[sp.Symbol, ...]:
    """The symbols, in their order, that the value of the expression depends on, or may depend on."""
    symbols = tuple(symbols)
    relevant = {s for part in dependence(expression, symbols, box) for s in part}
    return tuple(s for s in symbols if s in relevant)


def free_of(expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None) -> sp.Expr:
    """The function written without the symbols on which it is proved not to depend.

    Each of these symbols is set to one value: to 0 where the function is defined there.
    """
    idle = [s for s in symbols if s in expression.free_symbols and depends(expression, s, box) is False]
    for numbers in _NUMBERS if idle else ():
        plain = put(expression, {s: sp.sympify(numbers[i % len(numbers)]) for i, s in enumerate(idle)})
        if plain is not None and not plain.has(*_INFINITE) and is_zero(expression - plain, box):
            return plain
    return expression


def _settled(expression: sp.Expr, box: Box | None) -> sp.Expr:
    """Exact numbers, and the value of each symbol that has one."""
    point = {s: sp.Rational(str(low)) for s, (low, high) in (box or {}).items() if low == high}
    return exact(settled(expression, point) if point else sp.sympify(expression))


def _seen(expression: sp.Expr, symbols: Sequence[sp.Symbol], box: Box | None) -> set[sp.Symbol]:
    """The symbols that change the value between two sample points that differ in them only."""
    every = sorted(expression.free_symbols, key=str)
    try:
        program = tape((expression,), every)
    except NoTape:
        return set()
    seen = set()
    for point, other in pairwise(list(_points(every, box, _QUICK + 1))):
        before = values(program, point, _BITS)[0]
        for s in symbols:
            moved = [b if t == s else a for t, a, b in zip(every, point, other, strict=True)]
            if s not in seen and _not_zero(before - values(program, moved, _BITS)[0]):
                seen.add(s)
    return seen


def _not_zero(ball: Any) -> bool:
    return bool(ball.is_finite() and not ball.contains(0))


def _points(symbols: Sequence[sp.Symbol], box: Box | None, count: int) -> Iterator[list[Fraction]]:
    """Rational points of the box from a fixed seed, never on its faces."""
    draw = random.Random(1)
    for k in range(count):
        yield [
            low + (high - low) * Fraction(draw.randint(1, _GRID - 1), _GRID)
            for low, high in (_ends(s, box, k) for s in symbols)
        ]


def _ends(symbol: sp.Symbol, box: Box | None, k: int) -> tuple[Fraction, Fraction]:
    low, high = (box or {}).get(symbol, (-sp.oo, sp.oo))
    start, end = _SCALES[k % len(_SCALES)]
    unbounded = low == -sp.oo, high == sp.oo
    if all(unbounded):
        return start, end
    if unbounded[0]:
        return Fraction(str(high)) - (end - start), Fraction(str(high))
    return Fraction(str(low)), Fraction(str(low)) + (end - start) if unbounded[1] else Fraction(str(high))
