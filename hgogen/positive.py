"""The hypothesis 0 < a_m <= a(u) <= a_M on the closed box of inputs and parameters, and the sign of a(u)."""

import itertools
import random
from collections.abc import Iterator, Mapping

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import Interval, enclose, finite
from hgogen.interval import box as box_of
from hgogen.signal import Signal
from hgogen.system import System

Point = Mapping[Signal, sp.Rational]

_CORNERS = 64
_RANDOM = 32


def sign(a: sp.Expr, system: System) -> int:
    """+1 or -1 if a has that sign on the box (proved, or else at every sample point), 0 if it has no one sign."""
    a, box = _prepare(a, system)
    low, high = _range(a, box_of(box))
    if low > 0 or high < 0:
        return 1 if low > 0 else -1
    seen = {_sign_at(a, point) for point in _points(box)}
    return seen.pop() or 0 if len(seen) == 1 else 0


def positive(id: str, name: str, a: sp.Expr, system: System) -> Check:
    """The check that 0 < a_m <= a <= a_M. `name` is what the report calls a.

    proved: by exact intervals. refuted: with a point where a is zero, has the other sign or is not finite.
    """
    claim = f"0 < a_m <= {name} = {a} <= a_M on the box"
    a, signals = _prepare(a, system)
    low, high = _range(a, box_of(signals))
    if low > 0 and finite((low, high)):
        return Check(id, claim, Verdict.PROVED, _proof(low, high))
    witness = _witness(a, signals)
    if witness is not None:
        reason, point = witness
        at = {s.name: float(value) for s, value in point.items()}
        return Check(id, claim, Verdict.REFUTED, f"{name} {reason}", at, _fix(id, name, signals, system))
    loose = ", ".join(s.name for s in signals if not s.bounded)
    if loose:
        fix = f"Declare low= and high= for {loose}."
        return Check(id, claim, Verdict.UNKNOWN, f"no range is declared for {loose}", fix=fix)
    return Check(
        id, claim, Verdict.UNKNOWN, "no sample point refutes it and exact intervals do not decide it"
    )


def _prepare(a: sp.Expr, system: System) -> tuple[sp.Expr, tuple[Signal, ...]]:
    """a with constants at their values, and the signals that it then varies with."""
    a = a.xreplace({p: value for p, value in system.nominal.items() if not p.bounded})
    return a, tuple(s for s in (*system.inputs, *system.parameters) if s in a.free_symbols)


def _range(a: sp.Expr, box: Mapping[sp.Symbol, Interval]) -> Interval:
    """The tightest of the ranges of a as written and in factors."""
    first, second = enclose(a, box), enclose(sp.factor(a), box)
    return max(first[0], second[0]), min(first[1], second[1])


def _proof(low: object, high: object) -> str:
    low, high = sp.sympify(low), sp.sympify(high)
    if low == high:
        return f"it is {low}"
    return f"exact intervals give [{low}, {high}]"


def _points(signals: tuple[Signal, ...]) -> Iterator[Point]:
    """Midpoint, zeros in the box, corners, then random points from a fixed seed; exact rationals."""
    ends = [_ends(s) for s in signals]
    yield dict(zip(signals, ((low + high) / 2 for low, high in ends), strict=True))
    for s, (low, high) in zip(signals, ends, strict=True):
        if low <= 0 <= high:
            others = {t: sp.Rational(3 * a + 4 * b, 7) for t, (a, b) in zip(signals, ends, strict=True)}
            yield {**others, s: sp.S.Zero}
    yield from (
        dict(zip(signals, corner, strict=True))
        for corner in itertools.islice(itertools.product(*ends), _CORNERS)
    )
    draw = random.Random(1)
    for _ in range(_RANDOM if signals else 0):
        yield {
            s: low + (high - low) * sp.Rational(draw.randint(0, 1000), 1000)
            for s, (low, high) in zip(signals, ends, strict=True)
        }


def _ends(signal: Signal) -> tuple[sp.Rational, sp.Rational]:
    """Its range; a signal without one may have any value, so one around its nominal value serves."""
    if signal.bounded:
        return sp.Rational(str(signal.low)), sp.Rational(str(signal.high))
    centre = sp.Rational(str(signal.nominal or 0.0))
    width = 10 * max(1, abs(centre))
    return centre - width, centre + width


def _sign_at(a: sp.Expr, point: Point) -> int | None:
    """The sign of a there, from exact zero tests and guaranteed digits; None where a is not finite and real."""
    value = a.xreplace(dict(point))
    if value.is_zero:
        return 0
    value = value.evalf(15)
    if not value.is_Float:
        return None if value.is_finite is False or value.is_real is False else 0 if value == 0 else None
    return 1 if value > 0 else -1


def _witness(a: sp.Expr, signals: tuple[Signal, ...]) -> tuple[str, Point] | None:
    """Why and where a is not positive and finite, from sample points."""
    by_sign: dict[int | None, Point] = {}
    for point in _points(signals):
        by_sign.setdefault(_sign_at(a, point), point)
    if 0 in by_sign:
        return "vanishes there", by_sign[0]
    if None in by_sign:
        return "is not a finite real number there", by_sign[None]
    if -1 in by_sign and 1 in by_sign:
        return "changes sign there", _crossing(a, by_sign[-1], by_sign[1])
    return ("is negative there", by_sign[-1]) if -1 in by_sign else None


def _crossing(a: sp.Expr, below: Point, above: Point) -> Point:
    """Bisection on the line between a point where a < 0 and one where a > 0."""
    for _ in range(60):
        middle = {s: (below[s] + above[s]) / 2 for s in below}
        value = _sign_at(a, middle)
        if value == -1:
            below = middle
        elif value == 1:
            above = middle
        else:
            return middle
    return below


def _fix(id: str, name: str, signals: tuple[Signal, ...], system: System) -> str:
    inputs = [s.name for s in signals if s in system.inputs]
    names = ", ".join(s.name for s in signals)
    accept = f"accept=({id!r},)"
    if inputs:
        return (
            f"Restrict the range of {names} so that {name} keeps one sign, or build with {accept} knowing that the "
            f"observer coasts while {name} is near 0: what lies behind it is then seen only as {inputs[0]} moves."
        )
    return f"Restrict the range of {names} so that {name} keeps one sign." if names else "Correct the model."
