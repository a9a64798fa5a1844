"""The small functions of emitted code, each after those that it calls; see `discretisation.notation`."""

from hgogen.discretisation.notation import ALL_WHOLE, FIRST, LARGE, ROUNDS, n, real, start


def abs(v: float) -> float:
    """|v|."""
    return 0.0 - v if v <= 0.0 else v


def min(a: float, b: float) -> float:
    """The smaller of two."""
    return a if a < b else b


def max(a: float, b: float) -> float:
    """The larger of two."""
    return a if a > b else b


def acts(flag: bool) -> bool:
    """whether statements run that are left out for their cost alone; to a static analyser they always do"""
    return flag


def clamp(v: float, low: float, high: float) -> float:
    """v in [low, high]."""
    raised = v if v > low else low
    return raised if raised < high else high


def within(v: float, limit: float) -> bool:
    """whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers"""
    return v == v and v >= -limit and v <= limit


def inside(v: float, low: float, high: float) -> bool:
    """whether v is a number in [low, high]"""
    return v >= low and v <= high


def outside(v: float, low: float, high: float) -> bool:
    """whether v is a number beyond [low, high]"""
    return v < low or v > high


def equal(a: float, b: float) -> bool:
    """whether two numbers are one, and meant to be"""
    return a == b


def limit(v: float, most: float) -> float:
    """v in [-most, most]"""
    return v if within(v, most) else (most if v > 0.0 else -most)


def keep(v: float, low: float, high: float, otherwise: float, limit: float) -> float:
    """v in [low, high]; `otherwise` where v is not a number or beyond limit"""
    return clamp(v, low, high) if within(v, limit) else otherwise


def sign(v: float) -> float:
    """-1, 0 or 1."""
    return (1.0 if v > 0.0 else 0.0) - (1.0 if v < 0.0 else 0.0)


def whole(v: float) -> float:
    """largest whole number not above v, which an {int} can hold"""
    whole = real(int(v))
    return whole - (1.0 if whole > v else 0.0)


def nearest(v: float) -> float:
    """whole number nearest to v, where |v| is below a third of {ROUNDS}: sums near that are rounded to whole numbers"""
    return v + ROUNDS - ROUNDS


def floor(v: float) -> float:
    """largest whole number not above v; numbers from {ALL_WHOLE} on are whole"""
    return whole(v) if within(v, ALL_WHOLE) else v


def inf() -> float:
    """Infinity."""
    large = LARGE
    return large * large


def nan() -> float:
    """Not a number."""
    large = inf()
    return large - large


def search(x: float) -> float:
    """The distance, along an axis of a table, of x from the start of its cell k, whose number is that of the
    breakpoints at or below x; steps of powers of two find it; see `hgogen.rigor.lookup`."""
    k = 0
    probe = FIRST
    while probe > 0:
        if k + probe <= n and start[k + probe] <= x:
            k = k + probe
        probe = probe // 2
    return x - start[k]
