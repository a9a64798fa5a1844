"""What is said of a bound, above which every theta converges, by whichever proof, or where there is none.

The error of an estimate against its plant as a linear differential inclusion, in exact numbers.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import Evidence, tree
from hgogen.form import Form
from hgogen.prove.quadratic import (
    Array,
    balance,
    floats,
    identity,
    inverse_root,
    lyapunov,
    rational,
    stacked,
)
from hgogen.rigor.bounds import Range
from hgogen.rigor.definite import number
from hgogen.sentence import Reason, because


@dataclass(frozen=True)
class Nothing:
    """No bound, and why."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


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
    """A slope: what `reads` (N) of e, and `takes` (p) of the samples' errors at theta = 1, bring into the rates by
    `onto` (N), over theta^`degree`: a number in [`low`, `high`]. `entry`: (i, j) where it is that of db_i/dz_j times
    units, which `range` shows; None of others. `endless`: 1 where it may be any number more than `low` = `high`, -1 any
    less, 0 of others (`error_models`). `realised`: what of it is in the linear core that a method realises, as much
    as a saturation passes of what is in its range, 0 of b; None where that core moves."""

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
        """The ends as a certificate has them, None where there is none."""
        return {"low": None if self.endless < 0 else self.low, "high": None if self.endless > 0 else self.high}


def field_row(field: int, count: int) -> tuple[Fraction, ...]:
    """Return the row that reads the error of one field (N)."""
    return tuple(Fraction(int(k == field)) for k in range(count))


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
    core_evidence: Evidence = field(default_factory=dict)
    late: tuple[int, ...] = (0,)
    hull: tuple[tuple[Fraction, ...], ...] = ()
    chained: bool = False

    @property
    def varying(self) -> tuple[Slope, ...]:
        """The slopes that are no numbers."""
        return tuple(slope for slope in self.slopes if slope.low < slope.high)

    @property
    def limit(self) -> Array:
        """The limit of M over theta as theta grows, with all that moves in it at its middle; in floats."""
        N = floats(self.N)
        for slope in self.slopes:
            if slope.degree == -1:
                onto, reads = (np.array(row, dtype=float) for row in (slope.onto, slope.reads))
                N += float(slope.low + slope.high) / 2 * np.outer(onto, reads)
        return N

    @cached_property
    def _balanced_lyapunov(self) -> tuple[Array, Array] | None:
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
    def linear_lyapunov(self) -> Array | None:
        """The P of `_balanced_lyapunov` for e, its trace N; None where it shows nothing. In floats."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        P = P / d / d[:, None]
        return np.asarray(P * len(P) / np.trace(P))

    @cached_property
    def coordinates(self) -> Array | None:
        """P^(-1/2) of it, near which the P that are sought are."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        return np.asarray(d[:, None] * inverse_root(P))

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes that have one end alone."""
        return tuple(slope for slope in self.slopes if slope.endless)

    @property
    def without_samples(self) -> "Inclusion":
        """The inclusion where it is not known how errors of the samples enter."""
        slopes = tuple(replace(slope, takes=()) for slope in self.slopes)
        return replace(self, B=self.B[:, :0], late=(), slopes=slopes)

    def narrowed(self, share: Fraction) -> "Inclusion":
        """Return the inclusion, the ranges of the slopes of b that share of what they are; 0 stays in them."""
        slopes = (
            replace(each, low=each.low * share, high=each.high * share) if each.entry else each for each in self.slopes
        )
        return replace(self, slopes=tuple(slopes))

    def slope_values(self, states: Sequence[sp.Symbol], d: Array) -> dict[str, Fraction]:
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
        return {"scale": self.scale, "slopes": slopes, **self.core_evidence}

    def scales(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return, by field (N), its error e_k where that of its state of the form is 1; None where a scale holds
        parameters."""
        scale = tuple(map(sp.sympify, self.scale))
        if not all(each.is_Rational for each in scale):
            return None
        index, power = self.layout.index, self.layout.power
        return tuple(Fraction(scale[i].p, scale[i].q) / theta**p for i, p in zip(index, power, strict=True))

    def remembered(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return, by field (N), its error e_k where that of a program's field is 1; None where a scale holds
        parameters."""
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
class Facts:
    """A proof: `facts`, by name, as a certificate has them beside how the slopes of an `error` are bounded, of which
    some are proved."""

    error: Inclusion | None
    facts: Evidence = field(hash=False)

    def evidence(self, form: Form) -> Evidence:
        """Return how the slopes are bounded, and the facts."""
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
        """The system in floats."""
        return Uncertain(*map(floats, (self.M, self.G, self.H, self.B, self.E, self.core, self.injected)))

    def with_constant_slopes(self, d: Array) -> "Uncertain":
        """Return the system with constant slopes d (m)."""
        D = self.G * d
        return replace(self, M=self.M + D @ self.H, B=self.B + D @ self.E, G=D[:, :0], H=self.H[:0], E=self.E[:0])

    def driven_by(self, columns: Array) -> "Uncertain":
        """Return the system with inputs of which each is a sum of errors of the samples, the `columns` (p, q) say how
        much of each."""
        return replace(self, B=self.B @ columns, E=self.E @ columns, injected=self.injected @ columns)

    def disturbed(self, onto: Array) -> "Uncertain":
        """Return the system with more inputs, each of which enters the rates alone, by a column of `onto` (N, q)."""
        B, injected = (np.hstack([columns, onto]) for columns in (self.B, self.injected))
        return replace(self, B=B, E=np.hstack([self.E, self.H @ (0 * onto)]), injected=injected)


def state_row(scales: Sequence[Fraction], field: int) -> Array:
    """c (N), of FLINT's rationals: c e is the error of the state of the form that a field stands for."""
    return np.asarray(identity(len(scales))[field] / number(scales[field]))
