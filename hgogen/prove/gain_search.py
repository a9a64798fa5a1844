"""A gain of a small noise bound at a wanted rate: the program over P and Y = P K, and the search for a proved one.

    e' = (M - K C) e + (B + K) v + (G - K D) diag(d) (H e + E v),   |d_j| <= 1,   |v_j| <= 1,   V = e'P e

    minimise t:   V' <= -2 rate V where v = 0,   V' <= -alpha V + sum_j lambda_j v_j^2,   sum_j lambda_j <= alpha,
                  c P^-1 c' <= t for every c,   K'P K <= fastest^2 I

for all d at the corners, or by multipliers where these are many; all of it is linear in P, Y, the multipliers and t:
P (M - K C) is [P, Y] times the rows of M and -C, so that the forms are those of `inequality`, with [P, Y] for P.
The last row asks that noise alone moves e by at most `fastest`, per unit of time, in the norm in which e is at most 1:
without it the gain of a single state, for one, would have no end. Source: Boyd, El Ghaoui, Feron, Balakrishnan, "Linear
Matrix Inequalities in System and Control Theory", SIAM (1994), 6.1.3, 7.1.

That is one norm for the rate and for noise, though each may have its own. So it is asked for less than the rate, as
little as leaves a gain of which a norm of its own proves the rate, with noise at a rate that is searched; of these
gains the one of the least bound is taken, which is found in floats. The rate is proved of rounded numbers. Where no
gain reaches it, the slope that stands in the way most is told.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.estimators.columns import columns
from hgogen.form import Form
from hgogen.prove.argument import injected
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.common_norm import Falls, Flow
from hgogen.prove.inclusion import Inclusion, Slope, Uncertain, with_gains
from hgogen.prove.inequality import ends, flow, pushed
from hgogen.prove.quadratic import Array, Quadratic
from hgogen.prove.questions import together_in_floats
from hgogen.prove.semidefinite import CLOSER, Rows, basis, definite, entries, reaching, solved
from hgogen.sentence import Down, Reason, because

_WHAT = "the design of a gain"
_LESS = 1 - 1e-6  # of alpha for the lambda
_BY = 1e-7  # by which forms are negative
_DOUBLINGS = 60  # of the pace
_SMALL = 1e-12
_SLOW, _FAST, _SEARCHED = 1 / 8, 6, 8  # of the rates of noise: where they begin and end, and how many are tried
_OF_PACE = 1 / 10  # of the pace of slopes: as fast as it are rates of noise, however slow the wanted one
_LARGE = 1e30  # in the place of a bound, where there is no gain
_PARTS = (1.02, 0.7, 0.4)  # of the rate, that the one norm is asked for first
_LEAST, _HALVINGS = 0.0, 6
_DIGITS = 6
_ONE = Fraction(1)
_BACK, _STEPS = 12, 5  # halvings of the rate; steps from it to the one that is reached
_NOISY = 0.5  # the share of a rate with which noise is bounded


@dataclass(frozen=True, eq=False)
class Open:
    """What the error obeys before there is a gain: `M` (n, n), `G` (n, m), `H` (m, n), `C` (p, n), `D` (p, m), `B` (n,
    p) and `E` (m, p), v in its sizes; `chain` (n): the output of each state's chain."""

    M: Array
    G: Array
    H: Array
    C: Array
    D: Array
    B: Array
    E: Array
    chain: tuple[int, ...]

    @property
    def with_gain(self) -> Uncertain:
        """What the error obeys, below which stands what a gain multiplies (n + p, ..)."""
        M, G = np.vstack([self.M, -self.C]), np.vstack([self.G, -self.D])
        B = np.vstack([self.B, np.eye(len(self.C))])
        return Uncertain(M, G, self.H, B, self.E, M, B)

    def seen(self, T: Array, pace: float) -> "Open":
        """The same of e = diag(T) x, in a time that runs `pace` times as fast, each slope as strong where it enters as
        where it reads."""
        G, H = self.G / T[:, None] / pace, self.H * T
        enters, reads = np.linalg.norm(G, axis=0), np.linalg.norm(H, axis=1)
        g = np.sqrt(np.divide(reads, enters, out=np.ones_like(reads), where=(reads > _SMALL) & (enters > _SMALL)))
        M, B = self.M * T / T[:, None] / pace, self.B / T[:, None] / pace
        return Open(M, G * g, H / g[:, None], self.C * T, self.D * g, B, self.E / g[:, None], self.chain)

    def scale(self, pace: float) -> Array:
        """The T (n) in which noise moves the head of a chain by 1, and a state of size 1 the one before it by the pace
        in a unit of time."""
        T = np.zeros(len(self.M))
        for i, j in enumerate(self.chain):
            head = i == 0 or self.chain[i - 1] != j
            T[i] = 1 / abs(self.C[j, i]) if head else T[i - 1] * pace / abs(self.M[i - 1, i])
        return T

    def pace(self, rate: float) -> float:
        """A rate, or twice it, and so on, in whose scale no slope weighs more than the chain does."""
        pace = rate
        for _ in range(_DOUBLINGS):
            x = self.seen(self.scale(pace), pace)
            if max(np.abs(x.M).max(), (np.abs(x.G) @ np.abs(x.H)).max(initial=0.0)) <= 1 + _SMALL:
                break
            pace *= 2
        return pace


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked: a gain for what is `open`, of a `rate`, with a small largest |c e| of the `rows` c (r, n), and no
    faster than `fastest` (1/time)."""

    open: Open
    rate: float
    rows: Array
    fastest: float

    @cached_property
    def pace(self) -> float:
        """In which numbers are near 1: a long chain needs poles that are faster than the rate."""
        return self.open.pace(self.rate) * (1 + len(self.open.M) / 4)

    def gain(self, rate: float, noisy: float) -> Array | None:
        """K (n, p) by a norm that falls at this rate, and with noise at the rate `noisy`; None where there is none.
        Raises: `NoSolver`."""
        T = self.open.scale(self.pace)
        rows = self.rows * T
        rows = rows / np.linalg.norm(rows, axis=1).max()
        program = _Program(self.open.seen(T, self.pace), rate / self.pace, 2 * noisy / self.pace)
        K = program.gain(rows, self.fastest / self.pace)
        return None if K is None else K * T[:, None] * self.pace


@dataclass(frozen=True, eq=False)
class _Program:
    """The program in the scale of the chain. Its variables (N) are the entries of P and Y, the multipliers of slopes
    for the rate, and with noise, and the lambda; t is the last."""

    open: Open
    rate: float
    alpha: float

    def gain(self, rows: Array, fastest: float) -> Array | None:
        """K (n, p)."""
        reach = (reaching(c, self._size) for c in rows)
        cones = [*self._falling(), *reach, self._limited(fastest), self._signs()]
        solution = solved(np.append(np.zeros(self._size), 1.0), cones, CLOSER, _WHAT)
        if solution is None:
            return None
        (p, n), (of_P, of_Y, _) = self.open.C.shape, self._sizes
        P = np.einsum("k,kij->ij", solution[0][:of_P], basis(n))
        Y = solution[0][of_P : of_P + of_Y].reshape(n, p)
        return np.linalg.solve(P, Y) if np.linalg.eigvalsh(P).min() > 0 else None

    @cached_property
    def _ends(self) -> tuple[Uncertain, ...]:
        """At each corner, or with multipliers."""
        return ends(self.open.with_gain)

    @cached_property
    def _sizes(self) -> tuple[int, int, int]:
        """How many entries P and Y have, and how many slopes have multipliers: none at corners one by one."""
        n = len(self.open.M)
        return n * (n + 1) // 2, self.open.C.size, len(self._ends[0].H)

    @cached_property
    def _size(self) -> int:
        """N."""
        of_P, of_Y, k = self._sizes
        return of_P + of_Y + 2 * k + len(self.open.C)

    def _falling(self) -> Iterator[Rows]:
        """The forms of the rate, and with noise."""
        of_P, of_Y, k = self._sizes
        for e in self._ends:
            yield self._negative(flow(e).falls(2 * self.rate), of_P + of_Y)
            yield self._negative(pushed(e, self.alpha), of_P + of_Y + k)

    def _negative(self, form: Quadratic, first: int) -> Rows:
        """That a form is negative, its multipliers from the `first` variable on."""
        brings, shared = entries(form), sum(self._sizes[:2])
        whole = np.zeros((self._size, form.size, form.size))
        whole[:shared], whole[first : first + len(form.Q)] = brings[:shared], brings[shared:]
        return definite(whole, np.zeros((1, form.size, form.size)), -_BY * np.eye(form.size))

    def _limited(self, fastest: float) -> Rows:
        """[fastest^2 I, Y'; Y, P] >= 0."""
        (p, n), of_P = self.open.C.shape, self._sizes[0]
        end, whole = np.zeros((n + p, n + p)), np.zeros((self._size, n + p, n + p))
        end[n:, n:] = fastest**2 * np.eye(p)
        whole[:of_P, :n, :n] = -basis(n)
        for k, (i, j) in enumerate(np.ndindex(n, p), of_P):
            whole[k, i, n + j] = whole[k, n + j, i] = -1.0
        return definite(whole, 0 * end[None], end)

    def _signs(self) -> Rows:
        """Multipliers at least 0, the lambda together at most alpha."""
        p, others = len(self.open.C), self._size - sum(self._sizes[:2])
        A = np.zeros((1 + others, self._size + 1))
        A[0, self._size - p : self._size] = 1.0
        A[1:, self._size - others : self._size] = -np.eye(others)
        return A, np.append([_LESS * self.alpha], np.zeros(others)), False


def opened(without: Uncertain, ones: Uncertain, *, heads: Sequence[int], chain: Sequence[int]) -> Open:
    """From what is obeyed, in floats, with a gain of 0, and with one whose entries are all 1: they differ by what the
    gain reads."""
    e, C, D = without, without.M - ones.M, without.G - ones.G
    return Open(e.M, e.G, e.H, C[list(heads)], D[list(heads)], e.B, e.E, tuple(chain))


@dataclass(frozen=True)
class Candidate:
    """A gain K (n, p), with the entries of N in the `argument` of b, with a proof that the error `falls` at the rate;
    `worth`: its largest bound, about."""

    K: tuple[tuple[float, ...], ...]
    argument: tuple[float, ...]
    flow: Flow
    falls: Falls
    worth: float = _LARGE


@dataclass(frozen=True, eq=False)
class Search:
    """For gains of a form, of a `task` under noise of these `sizes` (p), written with `theta`; with the output error in
    the argument of b by `argument`, the entries of N at theta = 1, or none."""

    form: Form
    task: Task
    sizes: Array
    theta: float
    argument: tuple[float, ...] = ()

    def best(self) -> Candidate | None:
        """That of the least worth; None where none is found. Raises: `NoSolver`."""
        tried = list[Candidate]()

        def worth(noisy: float) -> float:
            one = self._slowest(math.exp(noisy))
            tried.extend([one] if one else [])
            return one.worth if one else _LARGE

        from scipy.optimize import minimize_scalar  # which the solver needs as well

        ends = math.log(self.task.rate * _SLOW), math.log(self._fast * _FAST)
        minimize_scalar(worth, bounds=ends, method="bounded", options={"maxiter": _SEARCHED})
        return min(tried, key=lambda one: one.worth, default=None)

    @property
    def _fast(self) -> float:
        return max(self.task.rate, _OF_PACE * self.task.pace)

    @property
    def written(self) -> tuple[float, ...]:
        """The entries of N over their powers of theta, in as many digits as those of K."""
        places = columns(self.form, len(self.argument)) if self.argument else ()
        return tuple(self._short(x, at.power - 1) for x, at in zip(self.argument, places, strict=True))

    def _short(self, value: float, power: int) -> float:
        return float(f"{value / self.theta**power:.{_DIGITS}g}")

    def promise(self) -> float:
        """The worth with noise at about half of the rate, to two digits. Raises: `NoSolver`."""
        one = self.middle()
        return float(f"{one.worth:.2g}") if one else _LARGE

    def middle(self) -> Candidate | None:
        """That with noise at about half of the rate; None where none is found. Raises: `NoSolver`."""
        return self._slowest(math.sqrt(self.task.rate * self._fast) / 2)

    def _slowest(self, noisy: float) -> Candidate | None:
        """With noise at that rate, the gain of the least rate in one norm that has the wanted one in its own."""
        start = next(((less, one) for less in _PARTS if (one := self._at(less, noisy))), None)
        if start is None:
            return None
        (high, best), low = start, _LEAST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            one = self._at(middle, noisy)
            low, high, best = (low, middle, one) if one else (middle, high, best)
        worth = together_in_floats(
            best.flow.error, self.sizes, self.task.rows, best.falls, 2 * noisy, self.task.fastest
        )
        return replace(best, worth=min(worth, _LARGE))

    def _at(self, less: float, noisy: float) -> Candidate | None:
        """The gain by one norm at so much of the rate, where it has the whole rate in its own."""
        K = self.task.gain(less * self.task.rate, noisy)
        if K is None or not np.isfinite(K).all():
            return None
        K = K / self.sizes
        entries = [self._short(K[at.row, at.chain], at.power) for at in columns(self.form, K.size)]
        error = error_of(self.form, [*map(Fraction, entries)], self.written)
        if isinstance(error, Nothing):
            return None
        flow = Flow(error, Fraction(self.theta))
        falls = flow.at(flow.theta, 2 * Fraction(self.task.rate))
        rows = tuple(map(tuple, np.reshape(entries, K.shape).tolist()))
        return Candidate(rows, self.written, flow, falls) if falls else None


def error_of(form: Form, K: Sequence[Fraction], argument: Sequence[float]) -> Inclusion | Nothing:
    """What the error obeys with a gain of these entries, and with those of N in the argument of b, or none."""
    error = with_gains(form, K)
    return injected(error, form, [sp.Rational(Fraction(x)) for x in argument]) if argument else error


def plain(form: Form, sizes: Array, narrower: int | None = None, argument: Sequence[float] = ()) -> Open | Reason:
    """What the error obeys before there is a gain, noise in its sizes (p), with half of the range of the slope of that
    number; or why there is nothing to design."""
    if len(form.leads) < len(form.blocks):
        return because("it is for outputs of which each has a chain of its own")
    without, ones = (error_of(form, [Fraction(k)] * form.n, argument) for k in (0, 1))
    if isinstance(without, Nothing) or isinstance(ones, Nothing):
        return because("{why}", why=without)
    chain = [k for k, size in enumerate(form.blocks) for _ in range(size)]
    parts = list[Uncertain]()
    for error in (without, ones):
        slopes = tuple(_half(slope) if k == narrower else slope for k, slope in enumerate(error.slopes))
        parts.append(replace(error, slopes=slopes).at(_ONE).floats)
    open_ = opened(*parts, heads=form.heads, chain=chain)
    C, D = (each / sizes[:, None] for each in (open_.C, open_.D))
    return replace(open_, C=C, D=D, B=open_.B * sizes, E=open_.E * sizes)


def _half(slope: Slope) -> Slope:
    """With half of its range: about its middle, but that of an entry of a Jacobian, which holds 0, about that."""
    centre = (slope.low + slope.high) / 2 if slope.entry is None else Fraction(0)
    return replace(slope, low=(slope.low + centre) / 2, high=(slope.high + centre) / 2)


@dataclass(eq=False)
class NoGain(HgogenError):
    """No gain is found with which errors decay at the wanted `rate`. `reached`: the largest of the smaller rates tried
    at which one is, 0.0 where none is; `hindrance`: what stands in the way."""

    plant: str
    rate: float
    reached: float
    hindrance: Reason

    def __str__(self) -> str:
        most = "nor at any smaller one that is tried"
        if self.reached:
            most = str(because("at {reached} there is one", reached=Down(self.reached, 2)))
        what = f"no gain is found with which errors of {self.plant} decay at rate = {self.rate:g}"
        return f"{what}; {most}; {self.hindrance}"


def unreached(form: Form, task: Task, sizes: Array) -> NoGain:
    """What is said of a task, under noise of these `sizes` (p), for which there is no gain: the slope that is named is
    that in half of whose range more is reached than in that of any other. Raises: `NoSolver`."""
    error = with_gains(form, [Fraction(0)] * form.n)
    slopes = () if isinstance(error, Nothing) else error.slopes
    reached = _reached(task, (task.rate / 2**k for k in range(1, _BACK)))
    step = (task.rate / reached) ** (1 / _STEPS) if reached else 2.0
    rates = [task.rate / step**k for k in range(_STEPS if reached else _BACK)]
    narrower = {}
    for k, slope in enumerate(slopes):
        open_ = plain(form, sizes, k)
        if slope.low < slope.high and not isinstance(open_, Reason):
            narrower[k] = _reached(replace(task, open=open_), rates)
    best = max(narrower, key=narrower.__getitem__, default=None)
    if best is None or narrower[best] <= reached:
        return NoGain(form.system.name, task.rate, reached, because("no slope hinders, but the solver gets no further"))
    slope = slopes[best]
    if slope.entry is None:
        called = [name for chain in form.gain_names for name in chain][slope.reads.index(1)]
    else:
        i, j = slope.entry
        called = f"db_{i + 1}/d{form.states[j]}"
    low, high = float(slope.low), float(slope.high)
    pattern = "{slope} in [{low:.3g}, {high:.3g}] hinders most: in half of that {more} is reached"
    more = Down(narrower[best], 2)
    why = because(pattern, slope=called, low=low, high=high, more=more)
    return NoGain(form.system.name, task.rate, reached, why)


def _reached(task: Task, rates: Iterable[float]) -> float:
    """The first of these rates at which one norm has a gain; 0.0 where none has."""
    return next((rate for rate in rates if task.gain(rate, rate * _NOISY) is not None), 0.0)
