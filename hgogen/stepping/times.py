"""The time of a plant whose equations are functions of it, counted by the step.

A time modulo its turn T is a whole number of parts of T, so that it keeps its digits for years:

    t = T count/N,    count <- count + M modulo N in each call after the first,    dt/T = M/N

M and N are exact where dt/T is a ratio of whole numbers up to 2^24, which a float holds exactly; else they are the
nearest ones. N is the largest such number, so that a start lies within T/2^24 of a part. At the fraction c of a step
the time is t - (1 - c) dt.

Where dt varies, r is the remainder of a part, and N the least power of two with T/N at most the shortest dt, up to
2^24, so that rounding r + dt N/T loses no more than rounding dt does:

    t = T (count + r)/N,    r + dt N/T = k + r',  k whole, |r'| <= 1/2,    count <- count + k modulo N,  r <- r'

The count advances by the whole dt, also where the sub-steps of the prediction do not reach it.
"""

from collections.abc import Iterable
from fractions import Fraction
from functools import lru_cache, reduce
from math import log10

import casadi as ca
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import Graph
from hgogen.part import Clock
from hgogen.program import Block, Field, Place, Section, column, sym
from hgogen.signal import Time

LARGEST = 1 << 24  # N: every whole number up to it is a float
COUNT, LOST, T = Place("state", "count"), Place("status", "TIME_LOST"), Place("time", "t")
REMAINDER = Place("state", "remainder")
_DIGITS = 40
_FINE = 2.0**-10  # of a turn: a time that its precision cannot place so well is none


class BadTime(BadArgument):
    """The error for a sampling period at which a step cannot count the time of a plant whose equations depend on it."""


@lru_cache(maxsize=32)
def ratio(time: Time, dt: float) -> tuple[Fraction, bool]:
    """Return dt/T as a fraction M/N in lowest terms, T the period of a function of time, and whether the fraction is
    exact. Raises: `BadTime`."""
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
    """Return M and N of dt/T = M/N, T the period of a function of time; N is as large as possible, up to 2^24. Raises:
    `BadTime`."""
    share, _ = ratio(time, dt)
    finer = LARGEST // share.denominator
    return finer * share.numerator, finer * share.denominator


def divisor(time: Time, clock: Clock) -> int:
    """Return N, the number of parts of the period T that a step counts. Raises: `BadTime`."""
    _, fixed = parts(time, clock.longest)
    if not clock.varying:
        return fixed
    return min(LARGEST, 1 << int(sp.ceiling(sp.log(time.turn / sp.Rational(repr(clock.varying.shortest)), 2)).evalf()))


def count_fields(times: tuple[Time, ...], clock: Clock) -> tuple[Field, ...]:
    """Return the state's fields that store the count of each time and, where dt varies, the remainder. Raises:
    `BadTime`."""
    if not times:
        return ()
    counts, meanings, labels = [divisor(time, clock) for time in times], [], tuple(map(str, times))
    for time, N in zip(times, counts, strict=True):
        share, exact = ratio(time, clock.longest)
        error = abs(sp.Rational(share) * time.turn / sp.Rational(repr(clock.longest)) - 1)
        drift = "" if exact or clock.varying else f", off by one part in 10^{int(-log10(float(error.evalf(_DIGITS))))}"
        meanings.append(f"{time} = {time.turn / N} {time.unit} times it{drift}")
    meaning = f"whole numbers that count the time, {'; '.join(meanings)}"
    low, high = (0.0,) * len(times), tuple(float(n - 1) for n in counts)
    count = Field(COUNT.name, low, low=low, high=high, lasting=True, labels=labels, meaning=meaning)
    half = (0.5,) * len(times)
    remainder = Field(
        REMAINDER.name,
        low,
        low=(-0.5,) * len(times),
        high=half,
        lasting=True,
        labels=labels,
        meaning="to add to the count",
    )
    return (count, *([remainder] if clock.varying else []))


def current_times(times: tuple[Time, ...], clock: Clock) -> list[Graph]:
    """Return each time t = T count/N at this call, SX."""
    count = sym(*COUNT, len(times)) + (sym(*REMAINDER, len(times)) if clock.varying else 0)
    return [count[i] * float(time.turn / divisor(time, clock)) for i, time in enumerate(times)]


def advance_by_period(times: tuple[Time, ...], clock: Clock) -> Block:
    """Return the block that advances each count by a fixed dt, except in the first call; a count out of its range
    begins again at 0."""
    count, calls = sym(*COUNT, len(times)), sym("state", "calls")
    after, lost = [], []
    for i, time in enumerate(times):
        N = divisor(time, clock)
        whole = ca.logic_and(ca.logic_and(count[i] >= 0, count[i] <= N - 1), ca.floor(count[i]) >= count[i])
        k = ca.if_else(whole, count[i], 0)
        after.append(k if clock.varying else ca.if_else(calls >= 1, _later(k, *parts(time, clock.longest)), k))
        lost.append(ca.logic_not(whole))
    writes = {COUNT: column(after), LOST: reduce(ca.logic_or, lost)}
    if clock.varying:
        remainder = sym(*REMAINDER, len(times))
        writes[REMAINDER] = column(ca.if_else(ca.fabs(remainder[i]) <= 0.5, remainder[i], 0) for i in range(len(times)))
    return Block("the time", writes)


def _later(k: Graph, M: int, N: int) -> Graph:
    return ca.if_else(k >= N - M, k - (N - M), k + M)


def advance_by(times: tuple[Time, ...], clock: Clock, dt: Graph) -> Block:
    """Return the block that advances each count by the time `dt` since the last call, for a step in which dt varies."""
    counts, remainders = [], []
    for i, time in enumerate(times):
        N = divisor(time, clock)
        sum_ = sym(*REMAINDER, len(times))[i] + dt * float(N / time.turn)
        whole = ca.floor(sum_ + 0.5)
        after = sym(*COUNT, len(times))[i] + whole
        counts.append(after - N * ca.floor(after * (1 / N)))
        remainders.append(sum_ - whole)
    return Block("the time goes on", {COUNT: column(counts), REMAINDER: column(remainders)})


def set_time(times: tuple[Time, ...], clock: Clock) -> Section:
    """Return the section that sets the counts to the time t of the next call, or where dt varies of the last one. Of a
    time that is no number, or has so many turns that its precision cannot place it, the counts are -1, which the next
    call reports as lost."""
    t, calls, size = sym(*T), sym("state", "calls"), len(times)
    turns, above = (sym("work", name, size) for name in ("turns", "above"))
    measured = {Place("work", "turns"): column(t / float(time.turn) for time in times)}
    rounded = {Place("work", "above"): turns + _FINE}  # in a block of its own, or no rounding is left to compare
    counts, remainders = [], []
    for i, time in enumerate(times):
        N = divisor(time, clock)
        placed = above[i] > turns[i]
        turn = ca.if_else(placed, turns[i], 0)
        share = (turn - ca.floor(turn)) * N
        k = ca.floor(share + 0.5)
        remainders.append(share - k)
        k = ca.if_else(k >= N, 0, k)
        if not clock.varying:
            M, _ = parts(time, clock.longest)
            k = ca.if_else(calls >= 1, _later(k, N - M, N), k)
        counts.append(ca.if_else(placed, k, -1))
    remainder = {REMAINDER: column(remainders)} if clock.varying else {}
    program = (
        Block("turns of the time", measured),
        Block("the same, a little later", rounded),
        Block("its count", {COUNT: column(counts), **remainder}),
    )
    when = "the last call, to which the next one adds its dt" if clock.varying else "the next call"
    return Section("set_time", f"set the time t of {when}", program)


def next_times(times: tuple[Time, ...], clock: Clock, count: Iterable[float], passed: float) -> tuple[float, ...]:
    """Return each time at the next call; `count`: the present count, and remainder, of each; `passed`: the time until
    the next call."""
    pairs = zip(times, count, strict=True)
    return tuple(float(k * w.turn / divisor(w, clock)) + passed for w, k in pairs)


def count_at(times: tuple[Time, ...], clock: Clock, t: float) -> list[tuple[float, float]]:
    """Return for each time the count and the remainder that are nearest to the time t."""
    counts = []
    for time in times:
        n = divisor(time, clock)
        share = Fraction(str((sp.Rational(repr(t)) / time.turn % 1).evalf(_DIGITS))) * n
        counts.append((float(round(share) % n), float(share - round(share))))
    return counts
