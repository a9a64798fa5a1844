"""The error of an estimate against its plant as a linear differential inclusion, in exact numbers.

    e' = theta (N e + B diag(theta^-late) v) + sum over slopes of theta^-degree d onto (reads'e + takes'diag(..) v)

d in [low, high], by itself; e holds the errors of the observer's fields, that of the field k over s_k theta^p(k), v the
errors of the samples; `late` are the p of the first states of the outputs' chains. A slope is what it `reads` brings
into the rates of others: the error of one field, or of b(z + L (y - C z)) that and what is injected:

    db_i/dz_j              the mean of the slope on the way from the plant's state to the clamped estimate, times the
                           share c_j in [0, 1] of the error that the clamp leaves: degree p(i) - p(j), 0 in its range
    a_i                    of a constant gain K, where a_i moves with an input or a parameter: degree -1
    a saturation           in the linear core: the share in [0, 1] that it leaves: degree -1

That b(sat z, u) - b(x, u) = J (sat z - x), J the mean of db/dz along the segment, asks b to be Lipschitz only, and
holds for every z, also far outside of the box: the box is convex, and x is in it. So it does for two estimates.
"""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import Evidence, enclosure, outward, tree
from hgogen.analysis.polytope import chains, span
from hgogen.analysis.scaling import exponents
from hgogen.analysis.spare import entering, heads, sharing, weighted
from hgogen.estimators.columns import as_matrix
from hgogen.estimators.integrators import Integrators
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.quadratic import (
    Array,
    balance,
    floats,
    fractions,
    identity,
    inverse_root,
    lyapunov,
    rational,
    stacked,
)
from hgogen.prove.steepness import companions, jacobian, obstacle
from hgogen.rigor.bounds import Range
from hgogen.rigor.definite import Matrix, number
from hgogen.rigor.kinks import bent
from hgogen.rigor.slope import JUMPS
from hgogen.sentence import Reason, because

_BOXES = 2_000  # for the range of one slope
_STEEPEST = sys.float_info.max / 4  # an end of a range, which is then widened
_LOOSE = 1e-9  # what a range with 0 is wider by, over its width, so that a weaker arithmetic reaches it
NO_SCALES = because("the gains of its chain are no numbers")  # where `Inclusion.scales` are None
_ROUND = 1e-10  # of the largest eigenvalue of a P in floats: a smaller one may be rounding


@dataclass(frozen=True)
class Layout:
    """The fields of an estimator in its core's order: `index` (N), i(k) from 0, by whose units a field is scaled;
    `power` (N), p(k); `fed` (N): whether c_i(k) enters; `picks` (n): the field that stands for w_i where c reads it."""

    index: tuple[int, ...]
    power: tuple[int, ...]
    fed: tuple[bool, ...]
    picks: tuple[int, ...]


@dataclass(frozen=True)
class Slope:
    """What `reads` (N) of e, and `takes` (p) of the samples' errors at theta = 1, bring into the rates by `onto` (N),
    over theta^`degree`: a number in [`low`, `high`]. `entry`: (i, j) where it is that of db_i/dz_j times units, which
    `range` shows; None of others. `endless`: 1 where it may be any number more than `low` = `high`, -1 any less, 0 of
    others (`endless_slopes`). `realised`: what of it is in the linear core that a method realises, as much as a
    saturation passes of what is in its range, 0 of b; None where that core moves."""

    reads: tuple[Fraction, ...]
    onto: tuple[Fraction, ...]
    low: Fraction
    high: Fraction
    degree: int
    takes: tuple[Fraction, ...] = ()
    endless: int = 0
    realised: Fraction | None = Fraction(0)
    entry: tuple[int, int] | None = None
    range: Range | None = field(default=None, hash=False, repr=False)

    @cached_property
    def exactly(self) -> tuple[Array, Array, Array]:
        """`onto`, `reads` and `takes`, of FLINT's rationals."""
        return rational(self.onto), rational(self.reads), rational(self.takes)

    @property
    def ends(self) -> dict[str, Fraction | None]:
        """As a certificate has them, None where there is none."""
        return {"low": None if self.endless < 0 else self.low, "high": None if self.endless > 0 else self.high}


def of_field(field: int, count: int) -> tuple[Fraction, ...]:
    """What reads the error of one field (N)."""
    return tuple(Fraction(int(k == field)) for k in range(count))


@lru_cache(maxsize=32)  # a search asks it of each gain
def slopes_of(form: Form, layout: Layout, scale: tuple[sp.Expr, ...], endless: bool) -> tuple[Slope, ...] | Reason:
    """Those of b, with 0 in each range; `endless`: whether one may have one end alone."""
    slopes, powers, J = [], exponents(form), jacobian(form)
    jumps = sorted(map(str, (part for row in form.b for part in bent(row).atoms(*JUMPS) if part.has(*form.states))))
    if endless and jumps:
        return because("{part} may jump", part=jumps[0])
    for i, (j, z) in product(range(form.n), enumerate(form.states)):
        slope = scale[i] / scale[j] * J[i, j]
        if slope == 0:
            continue
        known = span(slope, form, _BOXES)
        if not (known and known.defined and (known.finite or endless)) or known.low == -math.inf == -known.high:
            return because("db_{i}/d{z} = {slope} has no finite range on the box", i=i + 1, z=z, slope=slope)
        if any(_STEEPEST < abs(end) < math.inf for end in (known.low, known.high)):
            return because(
                "db_{i}/d{z} = {slope} is beyond the range of a double on the box", i=i + 1, z=z, slope=slope
            )
        onto = tuple(Fraction(int(fed and index == i)) for fed, index in zip(layout.fed, layout.index, strict=True))
        low, high, way = _ends(known)
        reads, degree = of_field(layout.picks[j], len(onto)), powers[i] - powers[j]
        slopes.append(Slope(reads, onto, low, high, degree, endless=way, entry=(i, j), range=known))
    return tuple(slopes)


def _ends(known: Range) -> tuple[Fraction, Fraction, int]:
    """The ends of the slope, 0 among them, and whether it goes on beyond one (`Slope.endless`)."""
    sides = [end for end in (known.low, known.high) if math.isfinite(end)]
    loose = _LOOSE * (max(*sides, 0.0) - min(*sides, 0.0))
    low, high = (min(outward(sides[0] - loose, -1), Fraction(0)), max(outward(sides[-1] + loose, 1), Fraction(0)))
    way = (known.high == math.inf) - (known.low == -math.inf)
    return (high, high, way) if way < 0 else (low, low, way) if way > 0 else (low, high, way)


@dataclass(frozen=True, eq=False)
class Inclusion:
    """`N` (N, N); `B` (N, p), by which errors v of the samples enter at theta = 1; the `slopes`; how the fields lie,
    the `layout`; the `units` (n) of the chain's states, by which the errors of fields are scaled; `scale` (n), of
    parameters, from the form's states to these; `numbers`: what the observer is built with beside theta; `own`:
    evidence of the core, beside these; `late` (p): the powers of theta of the first states of the outputs' chains;
    `hull`: places of the slopes that vary, from -1 to 1 in their ranges, in whose hull they keep together; none where
    each goes by itself; `chained`: whether a program's fields are of w, not of z."""

    N: Array
    B: Array
    slopes: tuple[Slope, ...]
    layout: Layout
    units: tuple[Fraction, ...]
    scale: tuple[sp.Expr, ...]
    numbers: Mapping[str, Any]
    own: Evidence = field(default_factory=dict)
    late: tuple[int, ...] = (0,)
    hull: tuple[tuple[Fraction, ...], ...] = ()
    chained: bool = False

    @property
    def varying(self) -> tuple[Slope, ...]:
        """The slopes that are no numbers."""
        return tuple(slope for slope in self.slopes if slope.low < slope.high)

    @property
    def limit(self) -> Array:
        """What M over theta comes to as theta grows, with all that moves in it at its middle; in floats."""
        N = floats(self.N)
        for slope in self.slopes:
            if slope.degree == -1:
                onto, reads = (np.array(row, dtype=float) for row in (slope.onto, slope.reads))
                N += float(slope.low + slope.high) / 2 * np.outer(onto, reads)
        return N

    @cached_property
    def _alone(self) -> tuple[Array, Array] | None:
        """Units d (N) of e and P (N, N) with N'P + P N = -I for that in these: 1, or where P is too far from round for
        floats those in which N is balanced; None where it shows nothing."""
        N = self.limit
        for units in (lambda N: np.ones(len(N)), balance):
            d = units(N)
            P = lyapunov(N * d / d[:, None])
            if P is not None and 0 < _ROUND * np.linalg.eigvalsh(P).max() < np.linalg.eigvalsh(P).min():
                return d, P
        return None

    @property
    def alone(self) -> Array | None:
        """That P of e, its trace N; None where it shows nothing. In floats."""
        if self._alone is None:
            return None
        d, P = self._alone
        P = P / d / d[:, None]
        return np.asarray(P * len(P) / np.trace(P))

    @cached_property
    def coordinates(self) -> Array | None:
        """P^(-1/2) of it, near which the P that are sought are."""
        if self._alone is None:
            return None
        d, P = self._alone
        return np.asarray(d[:, None] * inverse_root(P))

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes that have one end alone."""
        return tuple(slope for slope in self.slopes if slope.endless)

    @property
    def deaf(self) -> "Inclusion":
        """The same, where it is not known how errors of the samples enter."""
        slopes = tuple(replace(slope, takes=()) for slope in self.slopes)
        return replace(self, B=self.B[:, :0], late=(), slopes=slopes)

    def narrowed(self, share: Fraction) -> "Inclusion":
        """The same, the ranges of the slopes of b that share of what they are; 0 stays in them."""
        slopes = (
            replace(each, low=each.low * share, high=each.high * share) if each.entry else each for each in self.slopes
        )
        return replace(self, slopes=tuple(slopes))

    def named(self, states: Sequence[sp.Symbol], d: Array) -> dict[str, Fraction]:
        """The values of the slopes that are entries of a Jacobian, for d (m) in [-1, 1], by name."""
        values = {}
        for slope, share in zip(self.varying, d.tolist(), strict=True):
            if slope.entry is not None:
                i, j = slope.entry
                values[f"db_{i + 1}/d{states[j]}"] = slope.low + (slope.high - slope.low) * Fraction((1 + share) / 2)
        return values

    def evidence(self, form: Form) -> Evidence | None:
        """The scale, how each slope of b is bounded in these coordinates, and what is the core's own."""
        slopes = [
            {"row": i + 1, "column": j + 1, **slope.ends, "tree": tree(slope.range, form)}
            for slope in self.slopes
            if slope.entry is not None and slope.range is not None
            for i, j in [slope.entry]
        ]
        return {"scale": self.scale, "slopes": slopes, **self.own}

    def scales(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """By field (N), its error e_k where that of its state of the form is 1; None where a scale holds parameters."""
        scale = tuple(map(sp.sympify, self.scale))
        if not all(each.is_Rational for each in scale):
            return None
        index, power = self.layout.index, self.layout.power
        return tuple(Fraction(scale[i].p, scale[i].q) / theta**p for i, p in zip(index, power, strict=True))

    def remembered(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """By field (N), its error e_k where that of a program's field is 1; None where a scale holds parameters."""
        if not self.chained:
            return self.scales(theta)
        return tuple(self.units[i] / theta**p for i, p in zip(self.layout.index, self.layout.power, strict=True))

    def at(self, theta: Fraction) -> "Uncertain":
        """The inclusion at a theta > 0."""
        level = number(theta)
        late = np.array([level**-power for power in self.late], dtype=object)
        M, B, core, injected = self.N * level, self.B * late * level, self.N * level, self.B * late * level
        for slope in self.slopes:
            onto, reads, takes = slope.exactly
            way = onto * level**-slope.degree
            onto = way * (number(slope.low + slope.high) / 2)
            M, B = M + np.outer(onto, reads), B + np.outer(onto, takes * late)
            core = core + np.outer(way * number(slope.realised), reads) if slope.realised else core
        varying = self.varying
        G = [slope.exactly[0] * (number(slope.high - slope.low) / 2 * level**-slope.degree) for slope in varying]
        H, E = ([slope.exactly[k] for slope in varying] for k in (1, 2))
        return Uncertain(M, stacked(G, len(M)).T, stacked(H, len(M)), B, stacked(E, len(late)) * late, core, injected)


@dataclass(frozen=True)
class Shown:
    """What is proved: `facts`, by name, as a certificate has them beside how the slopes of an `error` are bounded, of
    which some are proved."""

    error: Inclusion | None
    facts: Evidence = field(hash=False)

    def evidence(self, form: Form) -> Evidence:
        """How the slopes are bounded, and the facts."""
        return self.facts if self.error is None else {"error": self.error, **self.facts}


@dataclass(frozen=True, eq=False)
class Uncertain:
    """e' = M e + B v + G diag(d) (H e + E v), |d_j| <= 1: `M` (N, N), `G` (N, m), `H` (m, N), `B` (N, p) and `E` (m, p)
    of FLINT's rationals; `core` (N, N) and `injected` (N, p): the parts of M and B that a method realises, which are no
    slope of b, saturations open."""

    M: Array
    G: Array
    H: Array
    B: Array
    E: Array
    core: Array
    injected: Array

    @cached_property
    def floats(self) -> "Uncertain":
        """The same in floats."""
        return Uncertain(*map(floats, (self.M, self.G, self.H, self.B, self.E, self.core, self.injected)))

    def held(self, d: Array) -> "Uncertain":
        """With slopes that are held at d (m), so that none varies."""
        D = self.G * d
        return replace(self, M=self.M + D @ self.H, B=self.B + D @ self.E, G=D[:, :0], H=self.H[:0], E=self.E[:0])

    def driven_by(self, columns: Array) -> "Uncertain":
        """With inputs of which each is a sum of errors of the samples, the `columns` (p, q) say how much of each."""
        return replace(self, B=self.B @ columns, E=self.E @ columns, injected=self.injected @ columns)

    def disturbed(self, onto: Array) -> "Uncertain":
        """With more inputs, each of which enters the rates alone, by a column of `onto` (N, q)."""
        B, injected = (np.hstack([columns, onto]) for columns in (self.B, self.injected))
        return replace(self, B=B, E=np.hstack([self.E, self.H @ (0 * onto)]), injected=injected)


def inclusion(
    form: Form,
    layout: Layout,
    core: Array | Matrix,
    measured: Array,
    scale: Sequence[sp.Expr],
    units: Sequence[Fraction],
    numbers: Mapping[str, Any],
    others: Iterable[Slope] = (),
    endless: bool = False,
) -> Inclusion | Nothing:
    """The inclusion of an observer on a form in chains, in the errors `scale` (n, of parameters) times those of z.

    `core` (N, N): the linear error core at theta = 1 in fields of the coordinates scale/units times z, floats as they
    are; `measured` (N, p): by what the samples enter there; `others`: what varies in the core, in those fields;
    `endless`: whether slopes of b may have one end alone.
    """
    slopes = slopes_of(form, layout, tuple(scale), endless)
    if isinstance(slopes, Reason):
        return Nothing(slopes)
    t, nothing = [units[i] for i in layout.index], (Fraction(0),) * measured.shape[1]
    scaled = rational(core) * np.outer(rational(t), 1 / rational(t))
    for slope in others:
        of = t[slope.reads.index(Fraction(1))]  # the unit of the field that it reads
        slopes = (*slopes, replace(slope, onto=tuple(x * unit_ / of for x, unit_ in zip(slope.onto, t, strict=True))))
    injected = rational(measured) * rational(t)[:, None]
    powers, shown, own = exponents(form), heads(form), {"units": tuple(units)}
    late = tuple(powers[shown[j]] if j in shown else 0 for j in range(measured.shape[1]))
    each = tuple(replace(slope, takes=nothing) for slope in slopes)
    return Inclusion(scaled, injected, each, layout, tuple(units), tuple(scale), numbers, own, late)


def on_integrators(
    chain: Integrators,
    layout: Layout,
    core: np.ndarray | Matrix,
    measured: np.ndarray,
    numbers: Mapping[str, Any],
    gates: Iterable[tuple[int, np.ndarray]] = (),
    endless: bool = False,
) -> Inclusion | Nothing:
    """The inclusion of an estimator on a chain of integrators, in errors of w near the units of z. `gates`: fields
    whose error saturations pass by a share in [0, 1], each with the column by which it enters the `core`; `endless` as
    of `inclusion`."""
    reason = obstacle(chain.form, endless)
    if reason:
        return Nothing(reason)
    units = nominal_units(chain)
    if isinstance(units, Nothing):
        return units
    scale = from_form(chain.form, units)
    zero, one = Fraction(0), Fraction(1)
    shares = (
        Slope(of_field(of, len(column)), tuple(map(Fraction, column.tolist())), zero, one, -1, realised=one)
        for of, column in gates
    )
    error = inclusion(chain.form, layout, core, measured, scale, units, numbers, shares, endless)
    return error if isinstance(error, Nothing) else replace(error, chained=True)


def nominal_units(chain: Integrators) -> list[Fraction] | Nothing:
    """The s_i (n) near 1/(a_1 .. a_i) at the nominal parameters, in which w is near z; or why there are none."""
    units = [Fraction(f"{float(1 / product):.6g}") for product in chain.nominal]
    if any(unit_ <= 0 for unit_ in units):
        return Nothing(because("the bound is for a_i shown to be positive"))
    return units


def from_form(form: Form, units: Sequence[Fraction]) -> tuple[sp.Expr, ...]:
    """s_i a_1 .. a_i (n) of each chain, which scale z to s_i w_i."""
    products = (sp.Mul(*each[: i + 1]) for each in chains(form) for i in range(len(each)))
    return tuple(sp.Rational(s) * product for s, product in zip(units, products, strict=True))


def on_companion(
    chain: Integrators, p: Sequence[float], weights: Sequence[float] | None = None, endless: bool = False
) -> Inclusion | Nothing:
    """The inclusion of gains p_i/(a_1 .. a_i), `p` (n) the coefficients of the chains' polynomials, on the means of
    outputs by their `weights` (p), by default all alike; `endless` as of `inclusion`."""
    form, exactly = chain.form, [Fraction(x) for x in p]
    weights = weights or weighted(form, None)
    products = (sp.Mul(*each[: i + 1]) for each in chains(form) for i in range(len(each)))
    numbers = {"gains": tuple(sp.Rational(x) / a for x, a in zip(exactly, products, strict=True))}
    numbers |= _weights(form, weights)
    measured = as_matrix(form, exactly) @ entering(form, weights)
    error = on_integrators(chain, plain(form), companions(exactly, form.blocks), measured, numbers, endless=endless)
    return error if isinstance(error, Nothing) else replace(error, own={"core": fractions(error.N)}, chained=False)


def with_gains(
    form: Form, K: Sequence[Fraction], weights: Sequence[float] | None = None, endless: bool = False
) -> Inclusion | Nothing:
    """The inclusion of a constant gain of the entries K (n, or n q: `columns`) in the form's own coordinates, whose a_i
    may move with inputs, on the means of outputs by their `weights` (p), by default all alike; `endless` as of
    `inclusion`."""
    reason = obstacle(form, endless)
    if reason:
        return Nothing(reason)
    n, each, gain = form.n, [a for chain in chains(form) for a in chain], as_matrix(form, K)
    heads = [form.heads[k] for k in form.leads]
    onto = [-gain[:, heads.index(at)] if at in heads else np.arange(n) == at - 1 for at in range(n)]
    core, slopes, ranges = np.zeros((n, n), dtype=object), list[Slope](), list[Evidence | None]()
    moves = not all(a.is_Rational for a in each)
    for at, a in enumerate(each):
        known = span(a, form)
        if not (known and known.defined and known.finite):
            return Nothing(because("a = {a} has no finite range on the box", a=a))
        if not moves:
            core[:, at] = [Fraction(a.p, a.q) * Fraction(x) for x in onto[at].tolist()]
            continue
        ranges.append(enclosure(form, a, known))
        ends = (Fraction(a.p, a.q),) * 2 if a.is_Rational else (outward(known.low, -1), outward(known.high, 1))
        slopes.append(Slope(of_field(at, n), tuple(map(Fraction, onto[at].tolist())), *ends, -1, realised=None))
    weights = weights or weighted(form, None)
    numbers = {"gains": tuple(map(sp.Rational, K)), **_weights(form, weights)}
    one, ones = [Fraction(1)] * n, [sp.S.One] * n
    error = inclusion(form, plain(form), core, gain @ entering(form, weights), ones, one, numbers, slopes, endless)
    if isinstance(error, Nothing):
        return error
    return replace(error, own={"ranges": ranges} if moves else {"core": fractions(error.N)})


def of_state(scales: Sequence[Fraction], field: int) -> Array:
    """c (N), of FLINT's rationals: c e is the error of the state of the form that a field stands for."""
    return np.asarray(identity(len(scales))[field] / number(scales[field]))


def _weights(form: Form, weights: Sequence[float]) -> dict[str, tuple[Fraction, ...]]:
    """The weights (p) as a number of an observer; none where no outputs share a state."""
    return {"weights": tuple(map(Fraction, weights))} if sharing(form) else {}


def plain(form: Form) -> Layout:
    """That of an observer whose fields are the form's states."""
    return Layout(tuple(range(form.n)), exponents(form), (True,) * form.n, tuple(range(form.n)))
