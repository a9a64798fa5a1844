"""The error of an estimate against its plant as a linear differential inclusion, in exact numbers.

    e' = theta (N e + B diag(theta^-late) v) + sum over slopes of theta^-degree d onto (reads'e + takes'diag(..) v)

Each slope d is anywhere in [low, high], independent of the others. e holds the errors of the observer's fields, that of
field k over s_k theta^p(k). v holds the errors of the samples; `late` are the powers p of the first states of the
outputs' chains. A slope multiplies what it `reads` and adds it to the rates of others. It reads the error of one field,
or of b(z + L (y - C z)) that error and the injected output error. There are three kinds:

    db_i/dz_j              the mean of the derivative between the plant's state and the clamped estimate, times the
                           share c_j in [0, 1] of the error that the clamp leaves: degree p(i) - p(j), 0 in its range
    a_i                    of a constant gain K, where a_i varies with an input or a parameter: degree -1
    a saturation           in the linear core: the share in [0, 1] of the error that passes: degree -1

b(sat z, u) - b(x, u) = J (sat z - x), J the mean of db/dz along the segment, needs b to be Lipschitz only. It holds for
every z, also far outside of the declared ranges, as these are convex and contain x. It also holds for two estimates.
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
    """A bound that is not proved, with the `reason`."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


NO_SCALES = because("the gains of its chain are no numbers")  # the reason for `Inclusion.scales` of None
_ROUND = 1e-10  # of the largest eigenvalue of P in floats: a smaller eigenvalue may be a rounding error


@dataclass(frozen=True)
class Layout:
    """The fields of an estimator in its core's order: `index` (N), i(k) from 0, the state whose unit scales field k;
    `power` (N), p(k); `fed` (N): whether field k has c_i(k) in its rate; `picks` (n): the field from which c reads
    w_i."""

    index: tuple[int, ...]
    power: tuple[int, ...]
    fed: tuple[bool, ...]
    picks: tuple[int, ...]


@dataclass(frozen=True)
class Slope:
    """A number d in [`low`, `high`] that adds onto d (reads'e + takes'v)/theta^`degree` to the rates, `onto` and
    `reads` (N), `takes` (p) at theta = 1. `entry`: (i, j) of a slope db_i/dz_j times units, of which `range` is the
    proof; None for others. `endless`: 1 for a slope that may be any number from `low` = `high` up, -1 down, 0 for
    others (`error_models`). `realised`: the value of d in the linear core that a method realises, 1 for a saturation
    that passes all, 0 for b; None if that core varies."""

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
        """The arrays `onto`, `reads` and `takes`, of FLINT's rationals."""
        return rational(self.onto), rational(self.reads), rational(self.takes)

    @property
    def ends(self) -> dict[str, Fraction | None]:
        """The ends of the range as a certificate has them, None for an infinite one."""
        return {"low": None if self.endless < 0 else self.low, "high": None if self.endless > 0 else self.high}


def field_row(field: int, count: int) -> tuple[Fraction, ...]:
    """Return the row (N) that reads the error of one field."""
    return tuple(Fraction(int(k == field)) for k in range(count))


@dataclass(frozen=True, eq=False)
class Inclusion:
    """The inclusion: `N` (N, N); `B` (N, p), the input matrix of the sample errors v at theta = 1; the `slopes`; the
    `layout` of the fields; the `units` (n) of the chain's states, which scale the errors of fields; `scale` (n), with
    parameters, from the form's states to these units; `numbers`: the observer's arguments other than theta;
    `core_evidence`: further evidence about the core; `late` (p): the powers of theta of the first states of the
    outputs' chains; `hull`: points in [-1, 1]^m, whose convex hull holds the varying slopes, scaled to their ranges;
    empty for independent slopes; `chained`: whether the program's fields estimate w, not z."""

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
        """The slopes whose range is more than one number."""
        return tuple(slope for slope in self.slopes if slope.low < slope.high)

    @property
    def limit(self) -> Array:
        """The limit of M/theta as theta grows, with each slope at the middle of its range; in floats."""
        N = floats(self.N)
        for slope in self.slopes:
            if slope.degree == -1:
                onto, reads = (np.array(row, dtype=float) for row in (slope.onto, slope.reads))
                N += float(slope.low + slope.high) / 2 * np.outer(onto, reads)
        return N

    @cached_property
    def _balanced_lyapunov(self) -> tuple[Array, Array] | None:
        """Units d (N) of e and P (N, N) with N'P + P N = -I for N in these units: d = 1, or if P is too ill-conditioned
        for floats a d that balances N; None if neither gives P > 0."""
        N = self.limit
        for units in (lambda N: np.ones(len(N)), balance):
            d = units(N)
            P = lyapunov(N * d / d[:, None])
            if P is not None and 0 < _ROUND * np.linalg.eigvalsh(P).max() < np.linalg.eigvalsh(P).min():
                return d, P
        return None

    @property
    def linear_lyapunov(self) -> Array | None:
        """The P of `_balanced_lyapunov` for e in floats, scaled to the trace N; None if there is none."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        P = P / d / d[:, None]
        return np.asarray(P * len(P) / np.trace(P))

    @cached_property
    def coordinates(self) -> Array | None:
        """P^(-1/2) of `_balanced_lyapunov`: coordinates in which a solver expects P near the unit matrix."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        return np.asarray(d[:, None] * inverse_root(P))

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes with an infinite end."""
        return tuple(slope for slope in self.slopes if slope.endless)

    @property
    def without_samples(self) -> "Inclusion":
        """The inclusion without sample errors, for an observer whose input matrix of samples is unknown."""
        slopes = tuple(replace(slope, takes=()) for slope in self.slopes)
        return replace(self, B=self.B[:, :0], late=(), slopes=slopes)

    def narrowed(self, share: Fraction) -> "Inclusion":
        """Return the inclusion with the ranges of the slopes of b, which hold 0, scaled by `share`."""
        slopes = (
            replace(each, low=each.low * share, high=each.high * share) if each.entry else each for each in self.slopes
        )
        return replace(self, slopes=tuple(slopes))

    def slope_values(self, states: Sequence[sp.Symbol], d: Array) -> dict[str, Fraction]:
        """Return the values of the slopes of b at d (m) in [-1, 1], by name."""
        values = {}
        for slope, share in zip(self.varying, d.tolist(), strict=True):
            if slope.entry is not None:
                i, j = slope.entry
                values[f"db_{i + 1}/d{states[j]}"] = slope.low + (slope.high - slope.low) * Fraction((1 + share) / 2)
        return values

    def evidence(self, form: Form) -> Evidence | None:
        """Return the scale, the proved range of each slope of b, and the evidence of the core."""
        slopes = [
            {"row": i + 1, "column": j + 1, **slope.ends, "tree": tree(slope.range, form)}
            for slope in self.slopes
            if slope.entry is not None and slope.range is not None
            for i, j in [slope.entry]
        ]
        return {"scale": self.scale, "slopes": slopes, **self.core_evidence}

    def scales(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return, by field (N), the error e_k for an error of 1 in its state of the form; None if a scale holds
        parameters."""
        scale = tuple(map(sp.sympify, self.scale))
        if not all(each.is_Rational for each in scale):
            return None
        index, power = self.layout.index, self.layout.power
        return tuple(Fraction(scale[i].p, scale[i].q) / theta**p for i, p in zip(index, power, strict=True))

    def remembered(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return, by field (N), the error e_k for an error of 1 in the program's field; None if a scale holds
        parameters."""
        if not self.chained:
            return self.scales(theta)
        return tuple(self.units[i] / theta**p for i, p in zip(self.layout.index, self.layout.power, strict=True))

    def at(self, theta: Fraction) -> "Uncertain":
        """Return the uncertain linear system at a theta > 0."""
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
    """The `facts` of a proof by name, as a certificate has them, and the `error` whose slopes they assume, if any."""

    error: Inclusion | None
    facts: Evidence = field(hash=False)

    def evidence(self, form: Form) -> Evidence:
        """Return the facts, with the bounds of the slopes."""
        return self.facts if self.error is None else {"error": self.error, **self.facts}


@dataclass(frozen=True, eq=False)
class Uncertain:
    """The system e' = M e + B v + G diag(d) (H e + E v), |d_j| <= 1: `M` (N, N), `G` (N, m), `H` (m, N), `B` (N, p) and
    `E` (m, p) of FLINT's rationals; `core` (N, N) and `injected` (N, p): the parts of M and B that a method realises,
    without slopes of b, and with saturations that pass all."""

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
        """Return the system with q inputs, from which the sample errors are v = `columns` (p, q) times the inputs."""
        return replace(self, B=self.B @ columns, E=self.E @ columns, injected=self.injected @ columns)

    def disturbed(self, onto: Array) -> "Uncertain":
        """Return the system with further inputs, each added to the rates by a column of `onto` (N, q)."""
        B, injected = (np.hstack([columns, onto]) for columns in (self.B, self.injected))
        return replace(self, B=B, E=np.hstack([self.E, self.H @ (0 * onto)]), injected=injected)


def state_row(scales: Sequence[Fraction], field: int) -> Array:
    """Return c (N), of FLINT's rationals: c e is the error of the state of the form that a field estimates."""
    return np.asarray(identity(len(scales))[field] / number(scales[field]))
