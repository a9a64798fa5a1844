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
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import Evidence, bisection_text
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
    """The result of a search that has no proof or no bound, with the `reason`."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


NO_SCALES = because("the gains of its chain are no numbers")  # the reason for `Inclusion.scales` of None
_ROUND = 1e-10  # of the largest eigenvalue of P in floats: a smaller eigenvalue may be a rounding error


@dataclass(frozen=True)
class Layout:
    """The states to which the N components of an estimator's error belong: e_k = s_i(k) (error of state
    i(k))/theta^p(k), s the `Inclusion.units`. `index`: i(k) from 0; `power`: p(k); `fed`: whether e_k' contains b_i(k),
    which is true for an estimate of a state, false for a filter's state; `picks` (n): for each state, the k of the
    estimate at which b is evaluated."""

    index: tuple[int, ...]
    power: tuple[int, ...]
    fed: tuple[bool, ...]
    picks: tuple[int, ...]


@dataclass(frozen=True)
class Slope:
    """An uncertain number d in [`low`, `high`], such as a partial derivative of b, that adds the term `onto` d
    (`reads`'e + `takes`'v)/theta^`degree` to e', v the errors of samples.

    `onto`, `reads` (N), `takes` (p): at theta = 1. `entry`: (i, j) where d is db_i/dz_j in the units of e, and `range`
    the proof of its range, else None. `endless`: 1 if d is unbounded above (then `low` = `high` is its lower end), -1
    if it is unbounded below, else 0. `realised`: the value of d in the linear core that a method integrates exactly: 1
    for a saturation, 0 for b, None where the core varies.
    """

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
        """The vectors `onto` (N), `reads` (N) and `takes` (p) in FLINT's rationals."""
        return rational(self.onto), rational(self.reads), rational(self.takes)

    @property
    def ends(self) -> dict[str, Fraction | None]:
        """The ends of [low, high] by the keys "low" and "high" of a certificate, None for an infinite end."""
        return {"low": None if self.endless < 0 else self.low, "high": None if self.endless > 0 else self.high}


def field_row(field: int, count: int) -> tuple[Fraction, ...]:
    """Return the unit row (`count`) with 1 at the index `field`: its product with e is component `field` of e."""
    return tuple(Fraction(int(k == field)) for k in range(count))


@dataclass(frozen=True, eq=False)
class Inclusion:
    """The error dynamics of an observer, a linear differential inclusion with uncertain slopes d_l in their ranges:

        e' = theta (N e + B diag(theta^-late) v) + sum_l theta^-degree_l onto_l d_l (reads_l'e + takes_l'diag(..) v)

    `N` (N, N); `B` (N, p), for errors v of samples; the `slopes`; the `layout` of e; `units` (n): the factors s_i of e
    on a chain of integrators; `scale` (n): the factors from errors of the form's states to e, expressions of
    parameters; `numbers`: the observer's arguments without theta; `core_evidence`: the evidence of N for a certificate;
    `late` (p): the power of theta of each output; `hull`: points of [-1, 1]^m whose convex hull contains the varying
    slopes, () for independent ones; `chained`: whether the program's memory holds integrators.
    """

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
        """The slopes d in [low, high] with low < high."""
        return tuple(slope for slope in self.slopes if slope.low < slope.high)

    @property
    def limit(self) -> Array:
        """The limit (N, N), in floats, of M(theta)/theta as theta grows, e' = M(theta) e, each slope in the middle of
        its range."""
        N = floats(self.N)
        for slope in self.slopes:
            if slope.degree == -1:
                onto, reads = (np.array(row, dtype=float) for row in (slope.onto, slope.reads))
                N += float(slope.low + slope.high) / 2 * np.outer(onto, reads)
        return N

    @cached_property
    def _balanced_lyapunov(self) -> tuple[Array, Array] | None:
        """A vector d (N) and P (N, N) with A'P + P A = -I, A = diag(d)^-1 N diag(d): d = 1, or a d
        that balances N if P is then too ill-conditioned for floats. None if neither gives a P > 0."""
        N = self.limit
        for units in (lambda N: np.ones(len(N)), balance):
            d = units(N)
            P = lyapunov(N * d / d[:, None])
            if P is not None and 0 < _ROUND * np.linalg.eigvalsh(P).max() < np.linalg.eigvalsh(P).min():
                return d, P
        return None

    @property
    def linear_lyapunov(self) -> Array | None:
        """A Lyapunov matrix P (N, N) of e' = `limit` e, in floats, scaled to the trace N; None where none is found."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        P = P / d / d[:, None]
        return np.asarray(P * len(P) / np.trace(P))

    @cached_property
    def coordinates(self) -> Array | None:
        """The matrix W = P^(-1/2) (N, N) of a Lyapunov matrix P of e' = `limit` e, in floats; None where there is none.
        In the coordinates W^-1 e the P of a proof is expected close to the unit matrix, where solvers are accurate."""
        if self._balanced_lyapunov is None:
            return None
        d, P = self._balanced_lyapunov
        return np.asarray(d[:, None] * inverse_root(P))

    @property
    def endless(self) -> tuple[Slope, ...]:
        """The slopes whose range has an infinite end."""
        return tuple(slope for slope in self.slopes if slope.endless)

    @property
    def without_samples(self) -> "Inclusion":
        """A copy without the terms of sample errors v, for an observer whose B is unknown."""
        slopes = tuple(replace(slope, takes=()) for slope in self.slopes)
        return replace(self, B=self.B[:, :0], late=(), slopes=slopes)

    def narrowed(self, share: Fraction) -> "Inclusion":
        """Return a copy in which the range of each slope of b, which contains 0, is multiplied by `share`."""
        slopes = (
            replace(each, low=each.low * share, high=each.high * share) if each.entry else each for each in self.slopes
        )
        return replace(self, slopes=tuple(slopes))

    def slope_values(self, states: Sequence[sp.Symbol], d: Array) -> dict[str, Fraction]:
        """Return the values of the partial derivatives of b, by names such as "db_2/dx1". `d` (m): the positions of all
        varying slopes in their ranges, from -1 to 1; `states` (n): the symbols of the z_j."""
        values = {}
        for slope, share in zip(self.varying, d.tolist(), strict=True):
            if slope.entry is not None:
                i, j = slope.entry
                values[f"db_{i + 1}/d{states[j]}"] = slope.low + (slope.high - slope.low) * Fraction((1 + share) / 2)
        return values

    def evidence(self, form: Form) -> Evidence | None:
        """Return the evidence of the error dynamics for a certificate: the factors `scale`, the proved range of each
        db_i/dz_j, and `core_evidence`."""
        slopes = [
            {"row": i + 1, "column": j + 1, **slope.ends, "tree": bisection_text(slope.range, form)}
            for slope in self.slopes
            if slope.entry is not None and slope.range is not None
            for i, j in [slope.entry]
        ]
        return {"scale": self.scale, "slopes": slopes, **self.core_evidence}

    def scales(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return the factors f (N) with e_k = f_k times the error of the form's state i(k) at this theta; None where
        one contains parameters."""
        scale = tuple(map(sp.sympify, self.scale))
        if not all(each.is_Rational for each in scale):
            return None
        index, power = self.layout.index, self.layout.power
        return tuple(Fraction(scale[i].p, scale[i].q) / theta**p for i, p in zip(index, power, strict=True))

    def lifted(self, scales: Sequence[Fraction]) -> Array:
        """Return the matrix s (N, n), in FLINT's rationals, with e = s times the errors of the form's states; its rows
        are 0 for components of filters. `scales` (N): the factors f of the method `scales`."""
        fields = zip(scales, self.layout.index, self.layout.fed, strict=True)
        return rational([[s * (fed and i == at) for at in range(len(self.scale))] for s, i, fed in fields])

    def corners(self, scales: Sequence[Fraction], sides: Sequence[Fraction]) -> Array:
        """Return the vectors e (2^(n-1), N) at the corners of the box in which the errors of the form's states are at
        most `sides` (n), one of each opposite pair. `scales` (N): the factors f of the method `scales`."""
        signs = rational([*product((1,), *[(1, -1)] * (len(sides) - 1))])
        return np.asarray((signs * rational(sides)) @ self.lifted(scales).T)

    def remembered(self, theta: Fraction) -> tuple[Fraction, ...] | None:
        """Return the factors f (N) with e_k = f_k times the error of number k in the program's memory at this theta;
        None where one contains parameters."""
        if not self.chained:
            return self.scales(theta)
        return tuple(self.units[i] / theta**p for i, p in zip(self.layout.index, self.layout.power, strict=True))

    def at(self, theta: Fraction) -> "Uncertain":
        """Return the error system e' = M e + B v + G diag(d) (H e + E v), |d_j| <= 1, at a theta > 0."""
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
    """The evidence of a proof: its `facts` by the keys of a certificate, and the `error` dynamics whose ranges of
    slopes the proof assumes, or None."""

    error: Inclusion | None
    facts: Evidence = field(hash=False)

    def evidence(self, form: Form) -> Evidence:
        """Return the facts together with the evidence of the error dynamics, whose ranges of slopes the proof
        assumes."""
        return self.facts if self.error is None else {"error": self.error, **self.facts}


@dataclass(frozen=True, eq=False)
class Uncertain:
    """The error system e' = M e + B v + G diag(d) (H e + E v) at one theta, with uncertain |d_j| <= 1; v are the errors
    of samples, or other inputs. `M` (N, N), `G` (N, m), `H` (m, N), `B` (N, p), `E` (m, p), of FLINT's rationals or
    floats. `core` (N, N) and `injected` (N, p): the parts of M and B that a method with a linear core integrates
    exactly: they contain no slopes of b, and saturations let the error through."""

    M: Array
    G: Array
    H: Array
    B: Array
    E: Array
    core: Array
    injected: Array

    @cached_property
    def floats(self) -> "Uncertain":
        """The error system with all its matrices in floats."""
        return Uncertain(*map(floats, (self.M, self.G, self.H, self.B, self.E, self.core, self.injected)))

    def with_constant_slopes(self, d: Array) -> "Uncertain":
        """Return the system without uncertain slopes in which d has a constant value (m): M + G diag(d) H, B + G
        diag(d) E."""
        D = self.G * d
        return replace(self, M=self.M + D @ self.H, B=self.B + D @ self.E, G=D[:, :0], H=self.H[:0], E=self.E[:0])

    def driven_by(self, columns: Array) -> "Uncertain":
        """Return the system with q inputs w in place of the sample errors, v = `columns` w, `columns` (p, q)."""
        return replace(self, B=self.B @ columns, E=self.E @ columns, injected=self.injected @ columns)

    def disturbed(self, onto: Array) -> "Uncertain":
        """Return the system with q additional inputs w: e' contains `onto` w, `onto` (N, q)."""
        B, injected = (np.hstack([columns, onto]) for columns in (self.B, self.injected))
        return replace(self, B=B, E=np.hstack([self.E, self.H @ (0 * onto)]), injected=injected)


def state_row(scales: Sequence[Fraction], field: int) -> Array:
    """Return the row c (N), in FLINT's rationals, for which c e is the error of the state to which component `field` of
    e belongs; `scales` (N): the factors of `Inclusion.scales`."""
    return np.asarray(identity(len(scales))[field] / number(scales[field]))
