"""The time of a plant whose equations are functions of it, counted by the step.

A time modulo its turn T is a whole number of parts of T, so that it keeps its digits for years:

    t = T count/N,    count <- count + M modulo N in each call after the first,    dt/T = M/N

M and N are exact where dt/T is a ratio of whole numbers up to 2^24, which a float holds exactly; else they are the
nearest ones. At the fraction c of a step the time is t - (1 - c) dt.
"""

from collections.abc import Iterable
from fractions import Fraction
from functools import lru_cache, reduce
from math import log10

import casadi as ca
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import Graph
from hgogen.program import Block, Field, Place, column, sym
from hgogen.signal import Time

LARGEST = 1 << 24  # N: every whole number up to it is a float
COUNT, LOST = Place("state", "count"), Place("status", "TIME_LOST")
_DIGITS = 40


class BadTime(BadArgument):
    """A sampling period at which a function of time cannot be counted."""


@lru_cache(maxsize=32)
def ratio(time: Time, dt: float) -> tuple[Fraction, bool]:
    """Return M/N = dt/T in lowest terms, and whether it is exact. Raises: `BadTime`."""
    share = sp.simplify(sp.Rational(repr(dt)) / time.turn)
    exact = Fraction(str(share if share.is_Rational else share.evalf(_DIGITS)))
    unit = time.unit
    if exact > Fraction(1, 2):
        longest = f"{float(time.turn) / 2:.6g} {unit}, half the period {time.turn} {unit} of the plant's functions of t"
        raise BadTime(f"dt = {dt:g}", f"is too long; take at most {longest}")
    if exact < Fraction(1, LARGEST):
        shortest = f"{float(time.turn) / LARGEST:.6g} {unit}, of which {LARGEST} are counted"
        raise BadTime(f"dt = {dt:g}", f"is too short for the period {time.turn} {unit}; take at least {shortest}")
    nearest = exact.limit_denominator(LARGEST)
    return nearest, share.is_Rational and nearest == exact


def count_field(times: tuple[Time, ...], dt: float) -> Field:
    """Return the state's field with the count of each time. Raises: `BadTime`."""
    counts, meanings = [], []
    for time in times:
        share, exact = ratio(time, dt)
        drift = "" if exact else f", off by one part in 10^{_size(time, dt, share)}"
        meanings.append(f"{time} = {time.turn / share.denominator} {time.unit} times it{drift}")
        counts.append(share.denominator)
    meaning = f"whole numbers that count the time, {'; '.join(meanings)}: set after init to begin at another time"
    low, high = (0.0,) * len(times), tuple(float(n - 1) for n in counts)
    return Field(COUNT.name, low, low=low, high=high, labels=tuple(map(str, times)), meaning=meaning)


def _size(time: Time, dt: float, share: Fraction) -> int:
    off = abs(sp.Rational(share) * time.turn / sp.Rational(repr(dt)) - 1)
    return int(-log10(float(off.evalf(_DIGITS))))


def now(times: tuple[Time, ...], dt: float) -> list[Graph]:
    """Return each time from its count, SX."""
    return [
        sym(*COUNT, len(times))[i] * float(time.turn / ratio(time, dt)[0].denominator) for i, time in enumerate(times)
    ]


def counted(times: tuple[Time, ...], dt: float) -> Block:
    """Return the block that counts the time on by dt, not in the first call; a count that is none begins anew at 0."""
    count, calls = sym(*COUNT, len(times)), sym("state", "calls")
    after, lost = [], []
    for i, time in enumerate(times):
        share, _ = ratio(time, dt)
        M, N = share.numerator, share.denominator
        whole = ca.logic_and(ca.logic_and(count[i] >= 0, count[i] <= N - 1), ca.floor(count[i]) >= count[i])
        k = ca.if_else(whole, count[i], 0)
        on = ca.if_else(k >= N - M, k - (N - M), k + M)
        after.append(ca.if_else(calls >= 1, on, k))
        lost.append(ca.logic_not(whole))
    return Block("the time", {COUNT: column(after), LOST: reduce(ca.logic_or, lost)})


def next_times(times: tuple[Time, ...], dt: float, count: Iterable[float], running: bool) -> tuple[float, ...]:
    """Return each time at the next call from its present count; `running`: whether there was a call."""
    parts = zip(times, count, strict=True)
    return tuple(float(k * w.turn / ratio(w, dt)[0].denominator) + dt * running for w, k in parts)


def count_at(times: tuple[Time, ...], dt: float, t: float) -> list[float]:
    """Return the counts of the time t, each the nearest one."""
    counts = []
    for time in times:
        n = ratio(time, dt)[0].denominator
        counts.append(float(round(Fraction(str((sp.Rational(repr(t)) / time.turn % 1).evalf(_DIGITS))) * n) % n))
    return counts
