"""What hides a state: a vector field along which every output and all its derivatives stay as they are.

    v(x, p) = sum_j c_ij m_j(x, p),   O(x, p) v(x, p) = 0 at random points   ->   the coefficients c, by linear algebra
    exact proof:  L_v h = 0  and  [f, v] = 0 or along v   =>   L_v (L_f^k h) = 0 for every k

The coefficients are found modulo a prime, or with balls, and read back as small fractions; then SymPy proves the two
conditions where it can. A scaling reads x -> c x, a translation x -> x + c.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations_with_replacement
from math import lcm, prod
from typing import Any, ClassVar

import flint
import sympy as sp

from hgogen.rigor.box import exact
from hgogen.rigor.rank import FEW_BITS, Blurred, Places, kernel, matrix_rows, modulus, new_rows, plant_of, somewhere
from hgogen.rigor.series import Arithmetic, Plant, Point, first_gradients

TERMS = 400  # of the vector field that is looked for
OPERATIONS = 4000  # of the model, beyond which the exact proof is left out
_LARGEST = 1000  # numerator and denominator of a coefficient
_SPARE = 4  # equations more than coefficients


@dataclass(frozen=True)
class Symmetry:
    """A vector field that the outputs do not see: `field`, its components other than zero, by unknown.

    `proved`: exactly, by SymPy; otherwise it holds at every random point that was tried.
    """

    json_keys: ClassVar[None] = None

    field: tuple[tuple[sp.Symbol, sp.Expr], ...]
    proved: bool

    def __str__(self) -> str:
        how = "" if self.proved else " (at random points)"
        direction = ", ".join(f"{s}: {v}" for s, v in self.field)
        return (_scaling(self.field) or _translation(self.field) or f"along d/ds ({direction})") + how


@dataclass(frozen=True)
class _Sample:
    """The unknowns' values and the independent rows of the observability matrix at one point; the prime or 0."""

    values: tuple[Any, ...]
    rows: tuple[tuple[Any, ...], ...]
    prime: int


def symmetries(
    flow: Iterable[sp.Expr],
    output: Iterable[sp.Expr],
    states: Iterable[sp.Symbol],
    inputs: Iterable[sp.Symbol],
    parameters: Iterable[sp.Symbol],
    *,
    hidden: Sequence[sp.Symbol],
    order: int,
    places: Places = (),
) -> tuple[Symmetry, ...]:
    """Independent symmetries with polynomial components of degree 1, else 2, that move the `hidden` unknowns.

    `order`: the order of the derivatives that attain the rank; `places`: near which real points are taken. There may be
    fewer symmetries than the deficiency of the rank, where the search finds no more.
    """
    flow, output = tuple(map(sp.sympify, flow)), tuple(map(sp.sympify, output))
    plant, unknowns = plant_of(flow, output, states, inputs, parameters, places)
    first = _sample(plant, order, 0)
    missing = len(unknowns) - len(first.rows)
    samples = [first]
    best: list[list[sp.Expr]] = []
    for terms in _ladder(unknowns, hidden):
        if len(terms) > TERMS or not first.rows:
            break
        samples = _enough(plant, order, samples, len(hidden), len(terms))
        independent = _independent(_fields(samples, terms, unknowns), unknowns)
        best = independent if len(independent) > len(best) else best
        if len(best) >= missing:
            break
    rates = (*flow, *(sp.S.Zero for _ in unknowns[plant.n :]))
    proved = _proved(best, rates, output, unknowns)
    return tuple(
        Symmetry(tuple((s, v) for s, v in zip(unknowns, field, strict=True) if v != 0), proof)
        for field, proof in zip(best, proved, strict=True)
    )


def _ladder(unknowns: Sequence[sp.Symbol], hidden: Sequence[sp.Symbol]) -> Iterable[list[tuple[int, tuple[int, ...]]]]:
    """Terms (component, the unknowns of its monomial): scalings and translations, all of degree 1, of degree 2."""
    at = [unknowns.index(s) for s in hidden]
    yield [(i, m) for i in at for m in ((), (i,))]
    every = range(len(unknowns))
    for degree in (1, 2):
        yield [(i, m) for i in at for d in range(degree + 1) for m in combinations_with_replacement(every, d)]


def _enough(plant: Plant, order: int, samples: list[_Sample], hidden: int, terms: int) -> list[_Sample]:
    """Samples with more equations than terms, all modulo one prime; what is observable gives no equation."""
    samples = list(samples)
    each = max(len(samples[0].rows) - (plant.wide - hidden), 1)
    k = len(samples)
    while each * len(samples) < terms + _SPARE:
        sample = _sample(plant, order, k)
        k += 1
        if sample.prime == samples[0].prime:
            samples.append(sample)
    return samples


def _sample(plant: Plant, order: int, k: int) -> _Sample:
    def answer(numbers: Arithmetic, point: Point) -> _Sample:
        prime = modulus(numbers)
        rows = [row for y in first_gradients(plant, numbers, point, order + 1) for row in matrix_rows(y)]
        independent = tuple(tuple(rows[i]) for i in new_rows(rows, prime))
        return _Sample((*point.states, *point.constants[: plant.q]), independent, prime)

    return somewhere(plant, answer, first=k)


def _fields(
    samples: Sequence[_Sample], terms: Sequence[tuple[int, tuple[int, ...]]], unknowns: Sequence[sp.Symbol]
) -> list[list[sp.Expr]]:
    """A basis of the fields with these terms that all the rows of all the samples annihilate."""
    prime = samples[0].prime
    with flint.ctx.workprec(FEW_BITS):
        equations = [
            [row[i] * prod((sample.values[j] for j in m), start=row[i] * 0 + 1) for i, m in terms]
            for sample in samples
            for row in sample.rows
        ]
        try:
            basis = kernel(equations, len(terms), prime)
        except Blurred:
            return []
        vectors = [_fractions(vector, prime) for vector in basis]
    fields = []
    for vector in vectors:
        if vector is None:
            continue
        field = [sp.S.Zero] * len(unknowns)
        scale = lcm(*(c.denominator for c in vector))
        for (i, m), c in zip(terms, vector, strict=True):
            field[i] += sp.Integer(int(c * scale)) * prod((unknowns[j] for j in m), start=sp.S.One)
        fields.append(field)
    return fields


def _fractions(vector: Sequence[Any], prime: int) -> list[Fraction] | None:
    """The vector as small fractions, scaled so that its first nonzero entry is 1; None where they are not small."""
    lead = next((c for c in vector if c != 0), None)
    if lead is None:
        return None
    fractions = [
        _residue(int(c) * pow(int(lead), -1, prime) % prime, prime) if prime else _number(c / lead) for c in vector
    ]
    return None if None in fractions else [c for c in fractions if c is not None]


def _residue(a: int, prime: int) -> Fraction | None:
    """The small fraction that is `a` modulo the prime, by the extended Euclidean algorithm."""
    (r, s), (b, t) = (prime, 0), (a, 1)
    while b > _LARGEST:
        (r, s), (b, t) = (b, t), (r - r // b * b, s - r // b * t)
    return Fraction(b, t) if 0 < abs(t) <= _LARGEST else None


def _number(a: Any) -> Fraction | None:
    fraction = Fraction(float(flint.arb(a).mid())).limit_denominator(_LARGEST)
    close = (flint.arb(a) - flint.arb(flint.fmpq(fraction.numerator, fraction.denominator))).contains(0)
    return fraction if close and abs(fraction) <= _LARGEST else None


def _independent(fields: Sequence[Sequence[sp.Expr]], unknowns: Sequence[sp.Symbol]) -> list[list[sp.Expr]]:
    """The simplest fields that are independent at a point, scalings and translations first."""
    ordered = sorted(fields, key=lambda field: (sum(v != 0 for v in field), sum(v.count_ops() for v in field)))
    draw = [Fraction(3 * k + 2, 2 * k + 5) for k in range(len(unknowns))]
    point = {s: sp.Rational(c) for s, c in zip(unknowns, draw, strict=True)}
    rows = [list(sp.Matrix([field]).xreplace(point)) for field in ordered]
    chosen: list[list[sp.Expr]] = []
    values: list[list[sp.Expr]] = []
    for field, row in zip(ordered, rows, strict=True):
        if sp.Matrix([*values, row]).rank() > len(values):
            chosen.append(list(field))
            values.append(row)
    return chosen


def _proved(
    fields: Sequence[Sequence[sp.Expr]],
    rates: Sequence[sp.Expr],
    output: Sequence[sp.Expr],
    unknowns: Sequence[sp.Symbol],
) -> list[bool]:
    """For each field v, whether L_v h = 0 and [f, v] lies in the span of such fields, exactly; False where SymPy does
    not decide it."""
    if sum(e.count_ops() for e in (*rates, *output)) > OPERATIONS:
        return [False] * len(fields)

    def along(h: sp.Expr, direction: Sequence[sp.Expr]) -> sp.Expr:
        return sum((h.diff(s) * v for s, v in zip(unknowns, direction, strict=True) if v != 0), sp.S.Zero)

    def commutator(field: Sequence[sp.Expr]) -> list[sp.Expr]:
        return [_together(along(v, rates) - along(f, field)) for v, f in zip(field, rates, strict=True)]

    def spanned(bracket: Sequence[sp.Expr], family: Sequence[Sequence[sp.Expr]]) -> bool:
        """Whether the bracket is a combination of independent fields with functions as coefficients, exactly."""
        rows = sp.Matrix([*family, bracket])
        return bool(rows.rank(iszerofunc=_vanishes, simplify=_together) == len(family))

    unseen = [all(_vanishes(along(h, field)) for h in output) for field in fields]
    brackets = [commutator(field) if ok else [] for field, ok in zip(fields, unseen, strict=True)]
    closed = list(unseen)
    while True:  # the largest family that f maps into itself
        family = [field for field, ok in zip(fields, closed, strict=True) if ok]
        remaining = [ok and spanned(bracket, family) for bracket, ok in zip(brackets, closed, strict=True)]
        if remaining == closed:
            return remaining
        closed = remaining


def _together(e: sp.Expr) -> sp.Expr:
    return sp.S.Zero if _vanishes(e) else sp.cancel(e) if e.is_rational_function() else e


def _vanishes(e: sp.Expr) -> bool:
    if e == 0:
        return True
    e = exact(e)
    if sp.expand(sp.fraction(sp.together(e))[0]) == 0:
        return True
    return not e.is_rational_function() and sp.simplify(e) == 0


def _letter(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> sp.Symbol:
    """A name for the free constant that no unknown has."""
    taken = {s.name for x, v in field for s in {x, *v.free_symbols}}
    return sp.Symbol(next(name for name in ("c", "s", "r", *(f"c{k}" for k in range(len(taken)))) if name not in taken))


def _scaling(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> str:
    """ "x -> c x, k -> k/c", with "z -> z + log(c)" where a component is constant; or ""."""
    powers = {s: v / s for s, v in field if not v.is_Rational}
    if not powers or not all(power.is_Rational for power in powers.values()):
        return ""
    c = _letter(field)
    whole = lcm(*(int(p.q) for p in powers.values()))
    moves = []
    for s, v in field:
        if s not in powers:
            moves.append(f"{s} -> {s + v * whole * sp.log(c)}")
            continue
        power = int(powers[s] * whole)
        factor = f"{c}" if abs(power) == 1 else f"{c}^{abs(power)}"
        moves.append(f"{s} -> {factor} {s}" if power > 0 else f"{s} -> {s}/{factor}")
    return ", ".join(moves)


def _translation(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> str:
    """ "x -> x + c v" where v is of unknowns that stay, or ""."""
    moved = {s for s, _ in field}
    if any(v.free_symbols & moved for _, v in field):
        return ""
    c = _letter(field)
    shifts = ((s, v if v.is_Number else sp.factor(v)) for s, v in field)
    return ", ".join(f"{s} -> {s + c * v}" for s, v in shifts)
