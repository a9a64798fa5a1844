"""Gains of high-gain observers: from poles, of the low-power injection, and as derived values of a program.

Gains from poles: the coefficients p_1..p_n of (s - s_1)...(s - s_n) = s^n + p_1 s^(n-1) + ... + p_n.

With a filter in the output injection, the poles mu of A - L C need more than a negative real part: with

    M = [[A, diag L], [-beta C'C, -alpha I + beta A']],   p_M(s) = beta^n p_(A - L C)(s (s + alpha)/beta),

M is Hurwitz if and only if each mu lies inside a parabola, S = {alpha^2 Re mu + beta (Im mu)^2 < 0}. Source: Astolfi,
Jungers, Zaccarian, "Output injection filtering redesign in high-gain observers", ECC 2018, (9)-(11), Lemma 1; that
mu outside S make M unstable is Routh's test of s^2 + alpha s - beta mu.

The low-power injection: pairs (p_i, q_i) on a chain of integrators, with gains from 2n - 2 poles.

    p_i' = q_i + theta k_i1 e_i,   q_i' = q_(i+1) + theta^2 k_i2 e_i,   q_n = 0,   i = 1..m,   m = n - 1
    e_1 = y - p_1,   e_i = q_(i-1) - p_i

At theta = 1 this linear core has the characteristic polynomial

    D(s) = R_1 + k_12 (R_2 + k_22 (R_3 + .. + k_m2)),   R_i = s (s + k_i1) s (s + k_(i+1)1) .. s (s + k_m1).

Proof: the transfer function of pair i from q_(i-1) to q_i is k_i2 s D_(i+1)/D_i, D_i = s (s + k_i1) (D_(i+1) - k_(i+1)2
D_(i+2)) + k_i2 D_(i+1), D_(m+1) = 1; so that D_i - k_i2 D_(i+1) = R_i. Hence D(0) = c_m, c_i = k_12 .. k_i2, and
(D(s) - D(0))/s, of odd degree, has a real root, -k_m1; its quotient by s + k_m1 is the polynomial of the first m - 1
pairs, c_(m-1) at s = 0, and so on. For k_i = (2, (n - i)/i) the c_i are binomial coefficients and D = (1 + s
(s + 2))^m = (s + 1)^(2m). Source of the observer: Astolfi, Marconi, IEEE TAC 60 (2015).

The places of a gain's entries, in a matrix with a row for each state and a column for each chain's output.

    z' = A z + b(z, u) + K_theta (y - C z),   K_theta = theta^(p(i) - p(k) + 1) K_ik

p(i) is the power of theta that scales the state of row i, p(k) that of the first state of chain k (`scaling`): with
chains aligned at the top it is j in row j. In scaled coordinates the effect of the gain on an error then grows like
theta, for the errors of all chains.

A gain of an observer, whose entries are expressions of parameters times powers of theta: a derived value of its
program.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, pairwise
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import sympy as sp

from hgogen.analysis.scaling import exponents, power
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.program import Block, Field, Place, sym
from hgogen.reading.given import BadGain, reals
from hgogen.sentence import same, up


@dataclass(eq=False)
class BadPoles(HgogenError):
    """The error for poles that no real observer can have, or that are unstable."""

    poles: tuple[complex, ...]
    reason: str

    def __str__(self) -> str:
        return f"poles {', '.join(f'{p:g}' for p in self.poles) or 'given'}: {self.reason}"


@dataclass(eq=False)
class OutsideParabola(HgogenError):
    """The error for poles mu of A - L C, `poles`, with alpha^2 Re mu + beta (Im mu)^2 >= 0, for which a filtered output
    injection is unstable: `eigenvalue` is the worst pole, `ratio` is alpha^2/beta; any ratio above `least` admits the
    poles."""

    poles: tuple[complex, ...]
    eigenvalue: complex
    ratio: Fraction
    least: Fraction

    def __str__(self) -> str:
        return (
            f"poles {', '.join(f'{p:g}' for p in self.poles)}: outside the parabola alpha^2 Re + beta Im^2 < 0, so "
            f"that the filtered error core has the eigenvalue {self.eigenvalue:.6g}; alpha^2/beta = "
            f"{float(self.ratio):.6g} must be above {up(self.least, 6)} to admit them: raise alpha, lower beta, "
            "or give them smaller imaginary parts"
        )


def numbers(poles: Sequence[complex]) -> tuple[complex, ...]:
    """Return the poles as complex numbers. Raises: `BadPoles` if they are no sequence of numbers."""
    try:
        return tuple(complex(pole) for pole in poles)
    except (TypeError, ValueError, OverflowError):
        raise BadPoles((), f"{poles!r} is no sequence of numbers; write, say, (-1, -2)") from None


def coefficients(poles: Sequence[complex], n: int) -> np.ndarray:
    """Return p_1..p_n (n) of s^n + p_1 s^(n-1) + .. = (s - s_1)..(s - s_n) for n poles s_i in the open left half plane,
    complex ones in pairs. Raises: `BadPoles`."""
    values = numbers(poles)
    if len(values) != n:
        raise BadPoles(values, f"there are {len(values)}, the form has {n} states; give one for each")
    if not all(np.isfinite(values)):
        raise BadPoles(values, "are not all finite numbers")
    unstable = [pole for pole in values if pole.real >= 0]
    if unstable:
        raise BadPoles(values, f"{unstable[0]:g} is not in the open left half plane; give it a negative real part")
    polynomial = np.poly(values)
    if not np.isfinite(polynomial).all():
        raise BadPoles(values, "their polynomial is beyond a double's range; give smaller ones, and a larger theta")
    if np.abs(np.imag(polynomial)).max() > 1e-12 * np.abs(polynomial).max():
        raise BadPoles(values, "complex poles must come in conjugate pairs")
    return np.array(np.real(polynomial)[1:])


def least_ratio(pole: complex) -> Fraction:
    """Return the bound (Im mu)^2/(-Re mu), exactly, above which alpha^2/beta admits the pole mu: alpha^2 Re mu + beta
    (Im mu)^2 < 0."""
    return Fraction(pole.imag) ** 2 / -Fraction(pole.real)


def demand_parabola(poles: Iterable[complex], alpha: float, beta: float) -> None:
    """Demand alpha^2 Re mu + beta (Im mu)^2 < 0 for all poles mu, Re mu < 0, in exact arithmetic; alpha, beta > 0.
    Raises: `OutsideParabola`."""
    ratio = Fraction(alpha) ** 2 / Fraction(beta)
    outside = {complex(pole): least_ratio(complex(pole)) for pole in poles}
    outside = {pole: least for pole, least in outside.items() if least >= ratio}
    if outside:
        worst = max(filtered_spectrum(outside, alpha, beta), key=lambda value: value.real)
        raise OutsideParabola(tuple(outside), complex(worst), ratio, max(outside.values()))


def filtered_spectrum(poles: Iterable[complex], alpha: float, beta: float) -> np.ndarray:
    """Return the 2 n eigenvalues of the error of a filtered output injection whose A - L C has the n `poles` mu, by
    Lemma 1: both roots s of s (s + alpha) = beta mu."""
    root = np.sqrt(alpha * alpha / 4 + beta * np.array([complex(pole) for pole in poles]))
    return np.concatenate([-alpha / 2 + root, -alpha / 2 - root])


def filtered_core(L: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Return M = [[A, diag L], [-beta C'C, -alpha I + beta A']] (2 n, 2 n) of the gains L (n), A the shift."""
    n = len(L)
    shift = np.diag(np.ones(n - 1), 1)
    below = np.zeros((n, n))
    below[0, 0] = -beta
    return np.block([[shift, np.diag(L)], [below, beta * shift.T - alpha * np.eye(n)]])


def parabola_advice(L: np.ndarray, alpha: float, beta: float) -> str:
    """Return advice for gains L (n) with which the filtered output injection is unstable, M of `filtered_core` not
    being Hurwitz."""
    poles = np.roots([1.0, *L]).astype(complex)
    unstable = poles[poles.real >= 0]
    if unstable.size:
        return f"A - L C itself has the pole {complex(unstable[0]):.6g}; take gains whose poles decay"
    least = float(max(map(least_ratio, map(complex, poles))))
    return f"alpha^2/beta = {alpha**2 / beta:.6g} must be above about {least:.4g}; raise alpha or lower beta"


_DIGITS = 60  # decimal digits of the roots: close roots lose many digits of the coefficients
_REAL = 1e-20  # the imaginary part of a real root at most, as a share of the largest root


def pair_gains(observer: str, n: int, gains: Any, poles: Any) -> np.ndarray:
    """Return the gains k (n - 1, 2) of the low-power injection from `gains`, or from the 2n - 2 `poles` of its linear
    core; by default (2, (n - i)/i), all poles at -1. Raises: `BadGain` for both arguments, or for gains of another
    shape or not finite; `BadPoles`."""
    if gains is not None and poles is not None:
        raise BadGain(observer, "takes gains or poles, not both; leave one out")
    if poles is not None:
        return from_poles(poles, n)
    if gains is None:
        return np.array([(2.0, (n - i) / i) for i in range(1, n)])
    k = reals("gains", gains)
    if k.shape != (n - 1, 2):
        raise BadGain(
            f"gains of shape {k.shape}", f"must be {n - 1} pairs (k_i1, k_i2), one for each state but the last"
        )
    if not np.isfinite(k).all():
        raise BadGain(f"gains = {k.tolist()}", "must be finite")
    return k


def from_poles(poles: Sequence[complex], n: int) -> np.ndarray:
    """Return the low-power gains k (n - 1, 2) that place the 2n - 2 poles; if there are several, those with the slowest
    last pair. Raises: `BadPoles`, also where the search finds no positive gains for the poles."""
    listed = numbers(poles if isinstance(poles, Sequence | np.ndarray) else (poles,))
    if len(listed) != 2 * n - 2:
        raise BadPoles(listed, f"there are {len(listed)}, {n} states have {2 * n - 2} in low power")
    wanted = coefficients(poles, 2 * n - 2)
    slopes: list[Any] = []
    with mpmath.workdps(_DIGITS):
        polynomial, products = [mpmath.mpf(1), *map(mpmath.mpf, wanted)], [mpmath.mpf(1)]
        while len(polynomial) > 1:
            *upper, constant = polynomial
            roots = mpmath.polyroots(upper, maxsteps=1000, extraprec=1000)
            largest = max(map(abs, roots))
            real = (mpmath.re(x) for x in roots if abs(mpmath.im(x)) <= _REAL * largest)
            root = max((x for x in real if x < 0), default=None)
            if root is None or constant <= 0:
                raise BadPoles(tuple(map(complex, poles)), "no positive gains were found that have them; give gains")
            slopes.insert(0, -root)
            products.insert(1, constant)
            polynomial = _divided(upper, root)
        ratios = (after / before for before, after in pairwise(products))
        return np.array([(float(a), float(b)) for a, b in zip(slopes, ratios, strict=True)])


def _divided(polynomial: list[Any], root: Any) -> list[Any]:
    """Return the coefficients of the quotient polynomial/(s - root), by Horner's scheme."""
    quotient = polynomial[:1]
    for coefficient in polynomial[1:-1]:
        quotient.append(coefficient + root * quotient[-1])
    return quotient


def errors(first: Graph, p: Graph, q: Graph) -> Graph:
    """Return the errors e (m) of the low-power pairs (p_i, q_i): e_1 = `first` = y - p_1, e_i = q_(i-1) - p_i."""
    return ca.vertcat(first, *(q[i - 1] - p[i] for i in range(1, q.numel())))


def injected(k: np.ndarray, theta: Graph, e: Graph) -> tuple[Graph, Graph]:
    """Return the injection terms theta k_i1 e_i of p' (m) and theta^2 k_i2 e_i of q' (m), k (m, 2), errors e (m)."""
    return theta * (ca.DM(k[:, 0]) * e), theta * theta * (ca.DM(k[:, 1]) * e)


@dataclass(frozen=True)
class Column:
    """The position of an entry of a gain matrix K (n, q): its `row` (0..n-1), its `chain` (0..q-1), the `power` of
    theta that scales it, and its printed `index`: (j), (i, j), or (i, j, k) for row j of chain i and the output of
    chain k."""

    row: int
    chain: int
    power: int
    index: tuple[int, ...]


def columns(form: Form, count: int) -> tuple[Column, ...]:
    """Return the positions in K (n, q) of `count` entries, row by row: n entries act each on the output of their own
    chain, n q entries on every output."""
    powers, heads = exponents(form), [form.heads[k] for k in form.leads]
    rows = [(i, j) for i, size in enumerate(form.blocks[k] for k in form.leads) for j in range(size)]
    chainwise, several = count == form.n, len(heads) > 1
    places = []
    for row, (i, j) in enumerate(rows):
        for k in (i,) if chainwise else range(len(heads)):
            power = j + 1 + powers[heads[i]] - powers[heads[k]]
            places.append(Column(row, k, power, (i + 1, j + 1, k + 1)[not several : 2 + (not chainwise)]))
    return tuple(places)


def as_matrix(form: Form, entries: Sequence[Any]) -> np.ndarray:
    """Return the gain matrix K (n, q), of objects, with the `entries` row by row: n q entries, or n entries, each in
    the column of its own chain, and 0 elsewhere."""
    K = np.zeros((form.n, len(form.leads)), dtype=object)
    for place, value in zip(columns(form, len(entries)), entries, strict=True):
        K[place.row, place.chain] = value
    return K


_CHAIN_INDEX = 2  # numbers in the index of an entry that acts on its own chain


@dataclass(frozen=True)
class ScaledGain:
    """The gain K_theta of z' = A z + b + K_theta (y - C z): its `name`, the `values` K_ik of its entries, expressions
    of parameters, their `places` in the matrix (n, q), and its `meaning` in reports."""

    name: str
    values: tuple[sp.Expr, ...]
    places: tuple[Column, ...]
    meaning: str

    def __str__(self) -> str:
        numbers = {x: sp.Symbol(same(float(x))) for k in self.values for x in k.atoms(sp.Float)}
        texts = dict(zip(self.places, (str(k.xreplace(numbers)) for k in self.values), strict=True))
        groups = groupby(texts, lambda place: place.row if self.coupled else place.chain)
        return ", ".join(f"({', '.join(texts[place] for place in group)})" for _, group in groups)

    @property
    def coupled(self) -> bool:
        """Whether a row of K acts on the output errors of other chains, too."""
        return any(len(place.index) > _CHAIN_INDEX for place in self.places)

    @property
    def field(self) -> Field:
        """The memory field of the entries theta K_1, theta^2 K_2, .. that the program derives from the gains; chain by
        chain if there are several."""
        labels = []
        for place in self.places:
            powers = {0: "", 1: "theta "}.get(place.power, f"theta^{place.power} ")
            index = ",".join(map(str, place.index))
            labels.append(f"{powers}{self.name}_{index}" if len(place.index) == 1 else f"{powers}{self.name}_({index})")
        return Field(self.name, (0.0,) * len(self.values), labels=tuple(labels), meaning=self.meaning)

    def tuned(self, form: Form) -> Block:
        """Return the block that computes the entries of K_theta from theta and the symbols of the parameters."""
        constants = {s: v for s, v in form.system.nominal.items() if not s.bounded}
        parameters = {s: sym("plant", s.name) for s in form.system.parameters if s.bounded}
        values: list[Graph] = to_casadi([k.subs(constants) for k in self.values], parameters)
        theta, powered = sym("gain", "theta"), []
        for place, value in zip(self.places, values, strict=True):
            scale = power(theta, place.power) if place.power >= 0 else 1 / power(theta, -place.power)
            powered.append(scale * value)
        return Block(self.meaning, {Place("derived", self.name): ca.vertcat(*powered)})

    def injection(self, e: Graph, n: int) -> Graph:
        """Return K_theta e (n), SX, for the errors e (q) of the chains' outputs."""
        entries: Sequence[Graph] = ca.vertsplit(sym("derived", self.name, len(self.values)))
        rows: list[Graph] = [0] * n
        for place, row in groupby(zip(self.places, entries, strict=True), lambda pair: pair[0].row):
            rows[place] = sum(k * e[at.chain] for at, k in row)
        return ca.vertcat(*rows)
