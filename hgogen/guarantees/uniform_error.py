"""The error of a high gain on the uniform form, against the plant, and one norm in which it decays.

    z' = F(z, u) + diag(g_1, .., g_n) (y - h(z, u)),   F_k = s_k z_(k+1) + b_k(sat z, u),   y = a z_1 + c
    g_i = theta^i K_i/(a F_1' .. F_(i-1)') at (sat z, u),   F_k' = dF_k/dz_(k+1)

s_k is a number between the ends of the range of F_k': so F_k goes on beyond the ranges, and its mean slope from the
plant's state to any estimate is in that range still. With e = z - x, exactly, in e_i s_1 .. s_(i-1)/theta^(i-1),

    e' = (theta (N - diag(K_1, K_2 q_1, K_3 q_1 q_2, ..) 1 C) + slopes) e,   q_k in the range of s_k/F_k'

N the shift. The slopes are those of b: of F_k in z_(k+1), which stay as theta grows, and in z_j, j <= k, which shrink,
whose ranges hold 0. So one P > 0 that decays for all of them at some theta decays for every larger one, at a rate that
grows with it. The matrix is affine in each slope and in each q_k, so that it is in the hull of those at all
combinations of their ends: of few that is what is shown, of many with a multiplier for each slope, and each
K_i q_1 .. q_(i-1) a slope of its own. P is found by a solver, and proved in rationals. The difference of two estimates
obeys no such equation, for it holds (g(z) - g(z~)) (y - h(z~)).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import sympy as sp
from flint import fmpq

from hgogen.algebra.definite import Matrix, number
from hgogen.algebra.kinks import slope
from hgogen.algebra.points import exact
from hgogen.check import Verdict
from hgogen.discretisation.runge_kutta import EULER
from hgogen.evidence.enclosing import enclosure
from hgogen.evidence.grammar import outward
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.contracting import Steps, farthest
from hgogen.guarantees.inclusion import Inclusion, Slope, inclusion, plain
from hgogen.guarantees.lmi import NoSolver, common
from hgogen.guarantees.quadratic import fractions, rational
from hgogen.guarantees.stagewise import stagewise
from hgogen.intervals import outward as rounded
from hgogen.intervals.bounds import Range
from hgogen.intervals.digits import Up, up
from hgogen.sentence import Reason, because
from hgogen.structure.polytope import fixed, span

STATES = 6  # of more the search for P takes longer than a check may
_NOW = Fraction(0)  # a step of length 0 is continuous time
_LEAST = Fraction(1, 16)  # theta, from which one is looked for
_GROWTHS = 4  # by factors of 4, of a theta that is too small
_FEW = 7  # slopes and shares of which all combinations of ends are taken
_ROOM = (Fraction(0), Fraction(1, 100), Fraction(1, 10), Fraction(1))  # over the least theta, for a proof
_HALVINGS = 8  # of the rate
_OPERATIONS = 100  # of a slope that is factored
_SHARES = (Fraction(1), Fraction(19, 20), Fraction(1, 2), Fraction(1, 16))  # of a rate found in floats, for proofs


@dataclass(frozen=True)
class Decay:
    """`P` (n, n), in which |e|_P^2 falls by `alpha` of itself in a unit of time: at all combinations of ends of the
    slopes, or with their multipliers `S` (m)."""

    P: Matrix
    S: tuple[Fraction, ...]
    alpha: Fraction


@dataclass(frozen=True)
class Injected:
    """What the error obeys: by the `slopes` of b, and by the `gains` K (n) times q_k, each in its range of `shares`
    (n - 1)."""

    slopes: Inclusion
    gains: tuple[Fraction, ...]
    shares: tuple[tuple[Fraction, Fraction], ...]

    @property
    def varying(self) -> int:
        """How many slopes and shares are no numbers."""
        return len(self.slopes.varying) + sum(low < high for low, high in self.shares)

    def vertices(self, theta: Fraction) -> Iterator[Matrix]:
        """The matrix at all combinations of ends."""
        e = self.slopes.at(theta)
        ends = [sorted({low, high}) for low, high in self.shares]
        for d, q in product(product((-1, 1), repeat=len(e.H)), product(*ends)):
            M = e.M + (e.G * np.array([fmpq(x) for x in d], dtype=object)) @ e.H if d else e.M + 0 * e.M
            M[:, 0] -= rational(injected(self.gains, q)) * number(theta)
            yield fractions(M)

    @property
    def apart(self) -> Inclusion:
        """The same with each K_i q_1 .. q_(i-1) as a slope of its own."""
        n, every = range(len(self.gains)), [injected(self.gains, q) for q in product(*self.shares)]
        ends = [(min(each), max(each)) for each in zip(*every, strict=True)]
        more = (Slope(0, tuple(Fraction(-int(k == i)) for k in n), *ends[i], -1) for i in n)
        return replace(self.slopes, slopes=(*self.slopes.slopes, *more))


@dataclass(frozen=True)
class UniformBound:
    """A proof that every theta > `theta` converges, as at `theta` itself the `decay` shows; `own`: how the error decays
    at a larger one, where that is proved. `ranges` (n - 1): of 1/F_k', as evidence."""

    theta: Fraction
    decay: Decay
    own: tuple[Fraction, Decay] | None
    error: Inclusion
    ranges: tuple[Evidence | None, ...]

    @property
    def numbers(self) -> Mapping[str, Any]:
        """What the observer is built with, beside theta."""
        return self.error.numbers

    @property
    def reason(self) -> Reason:
        """The bound in words."""
        pattern = "{theta}: one norm decays for all slopes and gains in their ranges"
        return because(pattern, theta=Up(self.theta))

    def rate(self, theta: float) -> float:
        """r (1/s) with |error(t)| <= c exp(-r t) |error(0)| at a theta above the bound; it is rounded down."""
        level, decay = self.own if self.own and theta >= self.own[0] else (self.theta, self.decay)
        return rounded.number(decay.alpha / 2 * Fraction(theta) / level)[0]

    def evidence(self, form: Form) -> Evidence | None:
        """theta and alpha, P and S, and how the slopes and gains are bounded."""
        slopes, known = self.error.evidence(form), self.decay
        if slopes is None or None in self.ranges:
            return None
        at = {"level": self.theta, "alpha": known.alpha, "P": known.P, "S": known.S}
        return {**slopes, "shares": self.ranges, **at}


def slopes_on(form: Form) -> tuple[sp.Expr, ...]:
    """F_1', .., F_(n-1)' of a form in the order of its chain, constants at their values."""
    known = dict(fixed(form))
    rows = zip(form.flow, form.states[1:], strict=False)
    return tuple(_short(exact(slope(sp.sympify(row), z).xreplace(known))) for row, z in rows)


def _short(expression: sp.Expr) -> sp.Expr:
    """In factors, where a variable stands less often and ranges are narrower; as it is where that may take long."""
    return sp.factor(expression) if sp.count_ops(expression) <= _OPERATIONS else expression


def middles(form: Form) -> tuple[sp.Rational, ...] | Reason:
    """s_1, .., s_(n-1), each short and in the range of its F_k'; or why there are none."""
    numbers = []
    for k, each in enumerate(slopes_on(form), 1):
        known = _range(each, form)
        if known is None or known.low <= 0 <= known.high:
            return because("F_{k}' = {slope} has no finite range that keeps off zero on the box", k=k, slope=each)
        middle = math.copysign(math.sqrt(known.low * known.high), known.low)
        short = sp.Rational(f"{middle:.3g}")
        numbers.append(short if known.low <= short <= known.high else sp.Rational(Fraction(middle)))
    return tuple(numbers)


def certified(form: Form, K: tuple[float, ...], theta: float) -> UniformBound | Nothing:
    """The bound for the gains K (n), on a form whose A holds the s_k above its diagonal and nothing else.

    It is looked for below `theta`, which is enough for that one. Raises: `Misfit` for no such form.
    """
    reason = _obstacle(form)
    if reason:
        return Nothing(reason)
    made = _error(form, tuple(map(Fraction, K)))
    if isinstance(made, Nothing):
        return made
    try:
        return _proved(*made, Fraction(theta))
    except NoSolver as missing:
        return Nothing(missing.reason)


def _obstacle(form: Form) -> Reason:
    """Why nothing is proved before it is tried, or `NONE`."""
    if form.n > STATES:
        return because("the bound is computed for up to {most} states", most=STATES)
    open_ = [check.id for check in form.checks if check.verdict is not Verdict.PROVED]
    return because("the bound rests on {check}, which is not proved", check=open_[0]) if open_ else Reason("")


def _error(form: Form, K: tuple[Fraction, ...]) -> tuple[Injected, tuple[Evidence | None, ...]] | Nothing:
    """What the error obeys, and the evidence of the ranges of 1/F_k'."""
    n, units, shares, ranges = form.n, [Fraction(1)], list[tuple[Fraction, Fraction]](), list[Evidence | None]()
    A = np.array([[Fraction(str(form.A[i, j])) for j in range(n)] for i in range(n)], dtype=object)
    for k, dF in enumerate(slopes_on(form)):
        inverse = exact(sp.sympify(1 / dF))
        known = _range(inverse, form)
        if known is None:
            return Nothing(because("1/({slope}) has no finite range on the box", slope=dF))
        ranges.append(enclosure(form, inverse, known))
        number_ = Fraction(str(inverse)) if inverse.is_Rational else None
        ends = [outward(known.low, -1), outward(known.high, 1)] if number_ is None else [number_] * 2
        low, high = sorted(A[k, k + 1] * end for end in ends)
        shares.append((low, high))
        units.append(units[-1] * A[k, k + 1])
    scale = tuple(map(sp.Rational, units))
    slopes = inclusion(form, plain(form), A, np.zeros((n, 0)), scale, units, {"gains": K})
    if isinstance(slopes, Nothing):
        return slopes
    return Injected(replace(slopes, own={}), K, tuple(shares)), tuple(ranges)


def injected(gains: Sequence[Fraction], q: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """K_1, K_2 q_1, K_3 q_1 q_2, .."""
    return tuple(k * math.prod(q[:i]) for i, k in enumerate(gains))


def _proved(error: Injected, ranges: tuple[Evidence | None, ...], theta: Fraction) -> UniformBound | Nothing:
    """A bound near the least that is found, below theta where that is possible, else the first above it.

    Raises: `NoSolver`.
    """
    decays = partial(_may_decay, error)
    start = next((theta * 4**k for k in range(_GROWTHS) if decays(theta * 4**k)), None)
    if start is None:
        return Nothing(because("no common norm is found for all slopes and gains in their ranges"))
    least = farthest(decays, start, min(_LEAST, start))
    for room in _ROOM:
        level = Fraction(up(least * (1 + room), 4))
        decay = _decay(error, level)
        if decay is not None:
            fast = _decay(error, theta) if theta > level else None
            return UniformBound(level, decay, (theta, fast) if fast else None, error.slopes, ranges)
    return Nothing(because("no common norm that floats find is proved in rationals"))


def _may_decay(error: Injected, theta: Fraction) -> bool:
    """Whether a proof at theta is worth a try. Raises: `NoSolver`."""
    if error.varying <= _FEW:
        return _decay(error, theta) is not None
    return _steps(error, theta).weights(_NOW, _NOW) is not None


def _decay(error: Injected, theta: Fraction) -> Decay | None:
    """A proof at theta, of a rate near the largest. Raises: `NoSolver`."""
    if error.varying <= _FEW:
        known = common(error.vertices(theta))
        return Decay(known.P, (), 1 / known.peak) if known else None
    steps, slow, fast = _steps(error, theta), _NOW, theta
    for _ in range(_HALVINGS):
        middle = (slow + fast) / 2
        slow, fast = (middle, fast) if steps.weights(_NOW, middle) else (slow, middle)
    for alpha in (slow * share for share in _SHARES):
        weights = steps.certain(_NOW, alpha) if alpha else None
        if weights:
            return Decay(weights.P, weights.S, alpha)
    return None


def _steps(error: Injected, theta: Fraction) -> Steps:
    return Steps(error.apart, partial(stagewise, EULER), theta)


def _range(expression: sp.Expr, form: Form) -> Range | None:
    known = span(expression, form)
    return known if known and known.defined and known.finite else None
