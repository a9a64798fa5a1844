"""The time of a plant whose equations are functions of it, counted by the step.

A time modulo its turn T is a whole number of parts of T, so that it keeps its digits for years:

    t = T count/N,    count <- count + M modulo N in each call after the first,    dt/T = M/N

M and N are exact where dt/T is a ratio of whole numbers up to 2^24, which a float holds exactly; else they are the
nearest ones. N is the largest such number, so that a start lies within T/2^24 of a part. At the fraction c of a step
the time is t - (1 - c) dt.
"""

from collections.abc import Iterable
from fractions import Fraction
from functools import lru_cache, reduce
from math import log10

import casadi as ca
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import Graph
from hgogen.program import Block, Field, Place, Section, column, sym
from hgogen.signal import Time

LARGEST = 1 << 24  # N: every whole number up to it is a float
COUNT, LOST, T = Place("state", "count"), Place("status", "TIME_LOST"), Place("time", "t")
_DIGITS = 40
_FINE = 2.0**-10  # of a turn: a time that its precision cannot place so well is none


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


def parts(time: Time, dt: float) -> tuple[int, int]:
    """Return M and N. Raises: `BadTime`."""
    share, _ = ratio(time, dt)
    finer = LARGEST // share.denominator
    return finer * share.numerator, finer * share.denominator


def count_field(times: tuple[Time, ...], dt: float) -> Field:
    """Return the state's field with the count of each time. Raises: `BadTime`."""
    counts, meanings = [], []
    for time in times:
        (share, exact), (_, N) = ratio(time, dt), parts(time, dt)
        drift = "" if exact else f", off by one part in 10^{_size(time, dt, share)}"
        meanings.append(f"{time} = {time.turn / N} {time.unit} times it{drift}")
        counts.append(N)
    meaning = f"whole numbers that count the time, {'; '.join(meanings)}"
    low, high = (0.0,) * len(times), tuple(float(n - 1) for n in counts)
    labels = tuple(map(str, times))
    return Field(COUNT.name, low, low=low, high=high, lasting=True, labels=labels, meaning=meaning)


def _size(time: Time, dt: float, share: Fraction) -> int:
    off = abs(sp.Rational(share) * time.turn / sp.Rational(repr(dt)) - 1)
    return int(-log10(float(off.evalf(_DIGITS))))


def now(times: tuple[Time, ...], dt: float) -> list[Graph]:
    """Return each time from its count, SX."""
    return [sym(*COUNT, len(times))[i] * float(time.turn / parts(time, dt)[1]) for i, time in enumerate(times)]


def counted(times: tuple[Time, ...], dt: float) -> Block:
    """Return the block that counts the time on by dt, not in the first call; a count that is none begins anew at 0."""
    count, calls = sym(*COUNT, len(times)), sym("state", "calls")
    after, lost = [], []
    for i, time in enumerate(times):
        M, N = parts(time, dt)
        whole = ca.logic_and(ca.logic_and(count[i] >= 0, count[i] <= N - 1), ca.floor(count[i]) >= count[i])
        k = ca.if_else(whole, count[i], 0)
        on = ca.if_else(k >= N - M, k - (N - M), k + M)
        after.append(ca.if_else(calls >= 1, on, k))
        lost.append(ca.logic_not(whole))
    return Block("the time", {COUNT: column(after), LOST: reduce(ca.logic_or, lost)})


def set_time(times: tuple[Time, ...], dt: float) -> Section:
    """Return the section that sets the counts to the time t of the next call. Of a time that is no number, or has so
    many turns that its precision cannot place it, the counts are -1, which the next call reports as lost."""
    t, calls, size = sym(*T), sym("state", "calls"), len(times)
    turns, above = (sym("work", name, size) for name in ("turns", "above"))
    measured = {Place("work", "turns"): column(t / float(time.turn) for time in times)}
    rounded = {Place("work", "above"): turns + _FINE}  # in a block of its own, or no rounding is left to compare
    counts = []
    for i, time in enumerate(times):
        M, N = parts(time, dt)
        placed = above[i] > turns[i]
        turn = ca.if_else(placed, turns[i], 0)
        k = ca.floor((turn - ca.floor(turn)) * N + 0.5)
        k = ca.if_else(k >= N, 0, k)
        k = ca.if_else(calls >= 1, ca.if_else(k >= M, k - M, k + (N - M)), k)
        counts.append(ca.if_else(placed, k, -1))
    program = (
        Block("turns of the time", measured),
        Block("the same, a little later", rounded),
        Block("its count", {COUNT: column(counts)}),
    )
    return Section("set_time", "set the time t of the next call", program)


def next_times(times: tuple[Time, ...], dt: float, count: Iterable[float], running: bool) -> tuple[float, ...]:
    """Return each time at the next call from its present count; `running`: whether there was a call."""
    pairs = zip(times, count, strict=True)
    return tuple(float(k * w.turn / parts(w, dt)[1]) + dt * running for w, k in pairs)


def count_at(times: tuple[Time, ...], dt: float, t: float) -> list[float]:
    """Return the counts of the time t, each the nearest one."""
    counts = []
    for time in times:
        n = parts(time, dt)[1]
        counts.append(float(round(Fraction(str((sp.Rational(repr(t)) / time.turn % 1).evalf(_DIGITS))) * n) % n))
    return counts
