"""The hypothesis 0 < a_m <= a(u) <= a_M on the closed box of inputs and parameters, and the sign of a(u)."""

from collections.abc import Iterator

import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.interval import End, Interval, enclose, finite
from hgogen.interval import box as box_of
from hgogen.points import Point, exact, kind, points, witness
from hgogen.signal import Signal
from hgogen.singular import singular
from hgogen.system import System


def sign(a: sp.Expr, system: System) -> int:
    """1 or -1 if a has that sign on the box (proved, or else at all sample points), 0 otherwise."""
    a, signals = _varying(a, system)
    low, high = _range(a, signals)
    if low > 0 or high < 0:
        return 1 if low > 0 else -1
    seen = {kind(a, point) for point in points(signals)}
    return 1 if seen == {"> 0"} else -1 if seen == {"< 0"} else 0


def positive(id: str, name: str, a: sp.Expr, system: System) -> Check:
    """The check that 0 < a_m <= a <= a_M. `name` is what the report calls a.

    proved: by exact intervals. refuted: with a point where a is zero, negative or not finite and real.
    unknown: a range is missing, or neither decides.
    """
    claim = f"0 < a_m <= {name} = {a} <= a_M on the box"
    a, signals = _varying(a, system)
    low, high = _range(a, signals)
    if low > 0 and finite((low, high)) and not singular([a], box_of(signals)):
        return Check(id, claim, Verdict.PROVED, _proof(low, high))
    found = _refutation(a, signals)
    if found:
        reason, point = found
        fix = _fix(id, name, signals, system)
        return Check(id, claim, Verdict.REFUTED, f"{name} {reason}", witness(point), fix)
    loose = ", ".join(s.name for s in signals if not s.bounded)
    if loose:
        fix = f"Declare low= and high= for {loose}."
        return Check(id, claim, Verdict.UNKNOWN, f"no range is declared for {loose}", fix=fix)
    return Check(id, claim, Verdict.UNKNOWN, "no sample point refutes it, exact intervals do not decide it")


def _varying(a: sp.Expr, system: System) -> tuple[sp.Expr, tuple[Signal, ...]]:
    """a with constants at their values, all numbers exact, and the signals that it then varies with."""
    a = exact(a.xreplace({p: value for p, value in system.nominal.items() if not p.bounded}))
    return a, tuple(s for s in (*system.states, *system.inputs, *system.parameters) if s in a.free_symbols)


def _range(a: sp.Expr, signals: tuple[Signal, ...]) -> Interval:
    """The tighter of the ranges of a as written and of a in factors."""
    box = box_of(signals)
    low, high = enclose(a, box)
    try:
        factors = enclose(sp.factor(a), box)
    except sp.PolynomialError:
        return low, high
    return max(low, factors[0]), min(high, factors[1])


def _proof(low: End, high: End) -> str:
    if low == high:
        return f"it is {low}"
    return f"exact intervals: between {sp.Rational(low).evalf(3)} and {sp.Rational(high).evalf(3)}, rounded"


def _refutation(a: sp.Expr, signals: tuple[Signal, ...]) -> tuple[str, Point] | None:
    """Why and where a is not positive and finite, from sample points."""
    first: dict[str, Point] = {}
    for point in points(signals):
        first.setdefault(kind(a, point), point)
    for point in _roots(a, signals) if len(first) == 1 else ():  # a zero between samples of one sign
        first.setdefault(kind(a, point), point)
    if "= 0" in first:
        return "vanishes", first["= 0"]
    if "undefined" in first:
        return "is not a finite real number", first["undefined"]
    if "< 0" in first and "> 0" in first:
        return "changes sign", _crossing(a, first["< 0"], first["> 0"])
    return ("is negative", first["< 0"]) if "< 0" in first else None


def _roots(a: sp.Expr, signals: tuple[Signal, ...]) -> Iterator[Point]:
    """The rational zeros in the range of a polynomial in one signal, such as (u - 1/7)^2, which has one sign."""
    if len(signals) != 1 or not signals[0].bounded or not a.is_polynomial(signals[0]):
        return
    low, high = (sp.Rational(str(end)) for end in signals[0].interval)
    try:
        roots = sp.Poly(a, signals[0]).ground_roots()
    except sp.PolynomialError:  # coefficients that are no rationals
        return
    yield from ({signals[0]: root} for root in sorted(roots) if low <= root <= high)


def _crossing(a: sp.Expr, below: Point, above: Point) -> Point:
    """Bisection, to float accuracy, on the line between a point where a < 0 and one where a > 0."""
    for _ in range(60):
        middle = {s: (below[s] + above[s]) / 2 for s in below}
        what = kind(a, middle)
        if what not in ("< 0", "> 0"):
            return middle
        below, above = (middle, above) if what == "< 0" else (below, middle)
    return below


def _fix(id: str, name: str, signals: tuple[Signal, ...], system: System) -> str:
    if not signals:
        return f"{name} is a constant; correct the model or the parameter's value."
    names = ", ".join(s.name for s in signals)
    inputs = ", ".join(s.name for s in signals if s in system.inputs)
    narrow = f"Restrict the range of {names} so that {name} keeps one sign"
    if not inputs:
        return f"{narrow}."
    return (
        f"{narrow}, or build with accept=({id!r},) knowing that the observer coasts while {name} is near 0: "
        f"the states behind it are then seen only through changes of {inputs}."
    )
