"""Shifts of states that change no output, as of an angle by a quarter turn where an encoder has four pole pairs.

    row(x + s) - row(x) = c s         0, or a whole number of the row's periods
    sin, cos(k x + ..) in a row       k s/(2 pi) is a whole number
    f(x + s) - f(x) = F s,  x+ = f    the same of F s, F^2 s, .. in place of s

The rows c over the periods span a lattice in the space where the others are 0, and the shifts are its dual: a group of
vectors with rational components in units of turns. Of a discrete plant it is the largest one that F maps into itself,
which lies in the space of the eigenvalues of F that are algebraic integers.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import lcm, prod
from typing import Any

import sympy as sp
from flint import fmpz_mat

from hgogen.rigor.box import exact
from hgogen.rigor.periodic import exact_turn

Row = tuple[sp.Expr, float | None]  # an expression and the period, if any, modulo which it is meant
_Slopes = Sequence[sp.Expr]
_OPERATIONS = 4000  # of the rows, beyond which no shift is looked for
_ONCE = (sp.exp, sp.log, sp.sinh, sp.tanh, sp.asinh, sp.atanh, sp.asin, sp.acos, sp.atan)  # have each value once


@dataclass(frozen=True)
class Shifts:
    """Shifts of states that leave every output unchanged; whole turns of an angle do not count. `single`: the smallest
    shift of each state alone; `joint`: shifts of several states together; `open`: states for which further shifts are
    not excluded. A state with a period is shifted in units of its period."""

    single: dict[sp.Symbol, sp.Expr]
    joint: tuple[dict[sp.Symbol, sp.Expr], ...] = ()
    open: tuple[sp.Symbol, ...] = ()


def hidden_shifts(
    periods: Mapping[sp.Symbol, float | None], rows: Iterable[Row], following: Iterable[sp.Expr] = ()
) -> Shifts:
    """Return the shifts of states that leave all `rows` unchanged and, for a discrete plant, also at later samples.
    `periods`: of each state, None without one; `following`: the next values of the states. A state on which no row
    depends is omitted."""
    rows, following = tuple(rows), tuple(following)
    conditions, own = _Conditions(tuple(periods)), [None if p is None else exact_turn(p) for p in periods.values()]
    none = Shifts({}, (), tuple(x for x, period in periods.items() if period is not None))
    if sum(row.count_ops() for row in (*following, *(row for row, _ in rows))) > _OPERATIONS:
        return none
    for row, period in rows:
        conditions.need(conditions.change(exact(row)), None if period is None else exact_turn(period))
    F = sp.Matrix([conditions.change(exact(row)) for row in following])
    zero = [need.slopes for need in conditions.needs if need.period is None]
    periodic = [need for need in conditions.needs if need.period is not None]
    whole = [[c / need.period for c in need.slopes] for need in periodic]
    units = _units(zero, whole, F, own)
    U = sp.diag(*units)
    zero = [[c / next(filter(None, row)) for c in row] for row in (list(sp.Matrix([row]) * U) for row in zero)]
    scaled, F = [sp.simplify(sp.Matrix([row]) * U) for row in whole], sp.simplify(U.inv() * F * U if F else F)
    A = sp.simplify(sp.Matrix(zero))
    if not all(e.is_Rational for part in (A, F, *scaled) for e in part):
        return none
    turns = [row for row, turn in zip(sp.eye(len(own)).tolist(), own, strict=True) if turn is not None]
    basis, free = _dual(len(own), A, scaled, F, turns)
    wide, loose = _dual(
        len(own), A, [row for row, need in zip(scaled, periodic, strict=True) if need.necessary], F, turns
    )
    extra = [row for row in wide if _echelon([*basis, row]) != basis]
    unknown = (loose | {j for row in extra for j, e in enumerate(row) if e}) - free
    single, joint = _in_turns(tuple(periods), own, units, basis)
    return Shifts(single, joint, tuple(x for j, x in enumerate(periods) if j in unknown))


def _in_turns(
    states: Sequence[sp.Symbol], own: Sequence[sp.Expr | None], units: Sequence[sp.Expr], basis: Sequence[_Slopes]
) -> tuple[dict[sp.Symbol, sp.Expr], tuple[dict[sp.Symbol, sp.Expr], ...]]:
    """Return the shifts in the lattice of a `basis`, of single states and of several: for a state with a period in
    `own` as a share of the period, for another state (None in `own`) times its entry of `units`."""
    steps = [_step(basis, j) for j in range(len(own))]
    joint = [[_nearest(e, step) for e, step in zip(row, steps, strict=True)] for row in basis]
    sizes = [unit if turn is None else sp.S.One for unit, turn in zip(units, own, strict=True)]
    parts = [x for x, step, turn in zip(states, steps, own, strict=True) if step and not (turn and step == 1)]
    in_turns = [{x: e * size for x, e, size in zip(states, row, sizes, strict=True) if e} for row in (steps, *joint)]
    single, *several = in_turns
    return {x: single[x] for x in parts}, tuple(filter(None, several))


@dataclass(frozen=True)
class _Need:
    """The condition on a shift s that slopes . s is 0, or, with a `period`, a whole number of periods. `necessary`:
    whether a shift that changes nothing must satisfy it."""

    slopes: _Slopes
    period: sp.Expr | None
    necessary: bool


@dataclass(frozen=True)
class _Conditions:
    """The conditions on shifts s of the `states` under which expressions change by constants only.

    An expression is written as a polynomial in symbols, e^(i k x) and other functions. The arguments of these functions
    must not change, which is necessary for a function that takes each value once.
    """

    states: tuple[sp.Symbol, ...]
    needs: list[_Need] = field(default_factory=list)
    known: dict[sp.Expr, sp.Symbol] = field(default_factory=dict)
    necessary: bool = True

    def need(self, slopes: _Slopes, period: sp.Expr | None = None, necessary: bool = True) -> None:
        if any(slopes):
            self.needs.append(_Need(slopes, period, period is None or (self.necessary and necessary)))

    def change(self, row: sp.Expr) -> _Slopes:
        """Return the slopes c in row(x + s) - row(x) = c s, and add the conditions on s under which this holds."""
        parts: dict[tuple[sp.Expr, sp.Expr], sp.Expr] = {}
        for term in sp.Add.make_args(sp.expand(self.written(row))):
            factors = sp.Mul.make_args(term)
            turning = [f for f in factors if isinstance(f, sp.exp)]
            number, angle = sp.Add(*(sp.expand(f.exp / sp.I) for f in turning)).as_coeff_Add()
            kernels = sp.Mul(*(f for f in factors if f.has(*self.known.values())))
            factor = sp.Mul(*(f for f in factors if f not in turning and not f.has(*self.known.values())))
            parts[angle, kernels] = parts.get((angle, kernels), sp.S.Zero) + factor * sp.exp(sp.I * number)
        slopes: _Slopes = [sp.S.Zero] * len(self.states)
        for (angle, kernels), factor in parts.items():
            factor = sp.expand(factor)
            if factor != 0 and angle == 0 and kernels == 1:
                slopes = self.linear(factor)
            elif factor != 0:
                self.need(self.linear(factor))
                self.need(self.linear(angle), 2 * sp.pi, kernels == 1)
        return slopes

    def linear(self, polynomial: sp.Expr) -> _Slopes:
        """Return the slopes c in p(x + s) - p(x) = c s for a polynomial p, and add the conditions that it has no other
        terms."""
        slopes = {sp.S.One: [sp.S.Zero] * len(self.states)}
        for j, x in enumerate(self.states):
            for term in sp.Add.make_args(sp.expand(sp.diff(polynomial, x))):
                number, monomial = term.as_independent(*term.free_symbols, as_Add=False)
                slopes.setdefault(monomial, [sp.S.Zero] * len(self.states))[j] += number
        constant = slopes.pop(sp.S.One)
        for row in slopes.values():
            self.need(row)
        return constant

    def written(self, e: sp.Expr) -> sp.Expr:
        if e.is_number or e.is_Symbol:
            return e
        if e.is_Add or e.is_Mul:
            return e.func(*map(self.written, e.args))
        if e.is_Pow and e.exp.is_Integer and e.exp > 0:
            return self.written(e.base) ** e.exp
        first = e.args[0]
        if isinstance(e, (sp.sin, sp.cos)) and e.has(*self.states):
            angle = sp.expand(self.written(first))
            up, down = sp.exp(sp.I * angle), sp.exp(-sp.I * angle)
            return (up + down) / 2 if isinstance(e, sp.cos) else (up - down) / (2 * sp.I)
        if isinstance(e, (sp.floor, sp.ceiling)):
            return self.written(first) - self.kernel(e, [sp.cos(2 * sp.pi * first)], True)
        if isinstance(e, (sp.Abs, sp.tan)):
            return self.kernel(e, [first**2 if isinstance(e, sp.Abs) else sp.cos(2 * first)], True)
        factors = [{*sp.Mul.make_args(argument)} for argument in e.args]
        once = (len(e.args) == 1 and isinstance(e, _ONCE)) or (e.is_Pow and e.exp.is_Rational and e.exp > 0)
        return self.kernel(e, _arguments(e), once or (isinstance(e, sp.atan2) and not factors[0] & factors[1]))

    def kernel(self, e: sp.Expr, arguments: Iterable[sp.Expr], once: bool) -> sp.Symbol:
        """Return the symbol that replaces a function e, and add the conditions that its `arguments` do not change;
        `once`: whether the function takes each value once, so that these conditions are necessary."""
        if e not in self.known:
            self.known[e] = sp.Dummy()
            inner = replace(self, necessary=self.necessary and once)
            for argument in arguments if e.has(*self.states) else ():
                inner.need(inner.change(argument))
        return self.known[e]


def _arguments(e: sp.Basic) -> Iterator[sp.Expr]:
    for part in e.args:
        if isinstance(part, sp.Expr):
            yield part
        else:
            yield from _arguments(part)


def _units(zero: Sequence[_Slopes], whole: Sequence[_Slopes], F: sp.Matrix, known: Sequence[Any]) -> list[sp.Expr]:
    """Return a unit of shift for each state in which all conditions have rational coefficients, if there is one;
    `known`: the units of states with a period, else None."""
    units = list(known)

    def link(j: int, size: sp.Expr) -> None:
        if units[j] is None and size:
            units[j] = abs(size)

    while None in units:
        before = list(units)
        for row in whole:
            for j, c in enumerate(row):
                link(j, c and 1 / c)
        for i, j in product(range(F.rows), repeat=2):
            if units[i] is not None and F[i, j]:
                link(j, units[i] / F[i, j])
            elif units[j] is not None:
                link(i, F[i, j] * units[j])
        for row in zero:
            size = next((c * unit for c, unit in zip(row, units, strict=True) if c and unit is not None), 0)
            for j, c in enumerate(row):
                link(j, c and size / c)
        if units == before:
            units[units.index(None)] = sp.S.One
    return units


def _dual(
    n: int, zero: sp.Matrix, whole: Sequence[sp.Matrix], F: sp.Matrix, turns: Sequence[_Slopes]
) -> tuple[list[_Slopes], set[int]]:
    """Return a basis of the lattice of shifts s with zero s = 0 and whole numbers whole s, also for F s, F^2 s, .. in
    place of s, restricted to the states that these conditions determine; and the set of indices of the other states."""
    B = sp.eye(n)
    if F:
        parts = [(p.primitive()[1], k) for p, k in F.charpoly().factor_list()[1]]
        integral = [_at(p, F) ** k for p, k in parts if abs(p.LC()) == 1]
        powers = [F**k for k in range(n)]
        zero = sp.Matrix.vstack(prod(integral, start=sp.eye(n)), *(zero * P for P in powers if zero))
        whole = [row * P for row in whole for P in powers]
    if zero:
        B = sp.Matrix.hstack(sp.zeros(n, 0), *zero.nullspace())
    M = sp.Matrix(_echelon([(row * B).tolist()[0] for row in whole] if B.cols else []))
    kernel = [B * v for v in (M.nullspace() if M else sp.eye(B.cols).columnspace())]
    free = {j for v in kernel for j in range(n) if v[j]}
    shifts = (B * M.T * (M * M.T).inv()).T.tolist() if M else []
    determined = [[0 if j in free else e for j, e in enumerate(row)] for row in (*shifts, *turns)]
    return _echelon(determined), free


def _at(polynomial: sp.Poly, F: sp.Matrix) -> sp.Matrix:
    return sum((c * F**k for (k,), c in polynomial.terms()), sp.zeros(F.rows))


def _echelon(rows: Sequence[_Slopes]) -> list[_Slopes]:
    """Return the Hermite normal form of the lattice that the rows, vectors of rational numbers, span."""
    if not rows:
        return []
    scale = lcm(*(int(sp.Rational(e).q) for row in rows for e in row))
    form = fmpz_mat([[int(e * scale) for e in row] for row in rows]).hnf().tolist()
    return [[sp.Rational(int(e), scale) for e in row] for row in form if any(row)]


def _step(basis: Sequence[_Slopes], j: int) -> sp.Rational:
    """Return the smallest positive multiple of unit vector j that is in a lattice, or 0 if there is none."""
    *others, last = _echelon([[*row[:j], *row[j + 1 :], row[j]] for row in basis])[-1] if basis else [0]
    return sp.S.Zero if any(others) else last


def _nearest(value: sp.Rational, step: sp.Rational) -> sp.Rational:
    """Return the value reduced by whole steps to the interval (-step/2, step/2]."""
    return value - step * sp.ceiling(value / step - sp.S.Half) if step else value
