"""Constraints c(x) = 0 that a flow keeps, exactly, and expressions on the set of points where they hold.

    grad c_i f = sum_j g_ij c_j with bounded g_ij   =>   x' = f keeps c = 0

Along a motion c' = G c is a linear differential equation, whose solution from c = 0 is 0. The quotients g_ij come from
division of polynomials in symbols and functions (`field.Writer`), with the equations of roots and |e|. Where they are
bounded has to be asked of the points on c = 0: c' = c log(c)^2 leaves 0.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, product

import flint
import sympy as sp

from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import Box, substituted
from hgogen.rigor.factors import factors as factored
from hgogen.rigor.field import Exp, Half, TooLarge, Writer, vanishes
from hgogen.rigor.lookup import Table
from hgogen.rigor.rank import Model, NowhereDefined, Places, at_random_point
from hgogen.rigor.series import Arithmetic, Point, Undecided, values
from hgogen.rigor.singular import Resolved, resolved
from hgogen.rigor.tape import NoTape

_JUMPS = (sp.Piecewise, sp.sign, sp.Heaviside, sp.floor, sp.ceiling, Table)
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo)
_MEANING: Mapping[type, Callable[..., sp.Expr]] = {
    Exp: lambda m, unit: sp.exp(m * unit),
    Half: lambda m, unit: sp.tan(m * unit / 2),
}
_SYMBOLS = 8  # most symbols of a Groebner basis
_CHOICES = 64  # most combinations of arguments of maxima and minima


@dataclass(frozen=True)
class Division:
    """An expression written as sum_j g_j p_j + `remainder`, with polynomials p_j that are 0 on the constraint set, and
    the `quotients` g_j; a quotient may be valid on the constraint set only."""

    quotients: tuple[sp.Expr, ...]
    remainder: sp.Expr


def divided(expression: sp.Expr, constraints: Sequence[sp.Expr]) -> Division:
    """Return the division of an expression by the constraints, as polynomials, or by substituting the solution of
    one of them. A remainder 0 proves that the expression is 0 on the constraint set, where the quotients then have
    values."""
    if vanishes(expression):
        return Division((), sp.S.Zero)
    for c, x in ((row, symbol) for row in constraints for symbol in sorted(row.free_symbols, key=str)):
        steep = sp.diff(c, x)
        if not (expression.has(*_JUMPS) or c.has(*_JUMPS) or steep.has(x)):
            there = substituted(expression, {x: sp.expand((steep * x - c) / steep)})
            if there is not None and not there.has(*_INFINITE) and vanishes(there):
                return Division((sp.diff(expression, x) / steep,), sp.S.Zero)
    return _divided(expression, constraints) or Division((), expression)


def _divided(expression: sp.Expr, constraints: Sequence[sp.Expr]) -> Division | None:
    writer, rows = Writer(), (expression, *constraints)
    try:
        for row in rows:
            writer.measure(row)
        (top, bottom), *parts = [sp.fraction(sp.together(writer.write(row))) for row in rows]
        roots = [sp.numer(sp.together(r.generator**r.degree - r.value)) for r in writer.relations]
        divisors = [*(part for part, _ in parts), *roots]
        symbols = sorted(sp.Tuple(top, *divisors).free_symbols, key=str)
        quotients, remainder = sp.reduced(top, divisors, *symbols)
        if remainder and len(parts) > 1 and len(symbols) <= _SYMBOLS:  # in another basis it may be 0
            quotients, remainder = sp.reduced(top, sp.groebner(divisors, *symbols, order="grevlex"), *symbols)
    except (TooLarge, sp.PolynomialError):
        return None
    back = {g: _MEANING[type(key)](*key.args) if type(key) in _MEANING else key for key, g in writer.kernels.items()}
    shares = tuple((q * sp.Mul(*(below for _, below in parts)) / bottom).xreplace(back) for q in quotients)
    left = (remainder / bottom).xreplace(back)
    if vanishes(left):
        return Division(shares, sp.S.Zero)
    plain = left.atoms(sp.tan) <= expression.atoms(sp.tan)  # without tangents of half angles
    return Division(shares, left if plain else expression)


def finite_on(
    rows: Iterable[sp.Expr],
    constraints: Sequence[sp.Expr],
    states: Sequence[sp.Symbol],
    others: Sequence[sp.Symbol],
    places: Places,
) -> bool:
    """Return whether the `rows` are proved to be finite around a point on the constraint set near one of the `places`,
    values of `states` and `others`. The proof covers every piece, sign and step in the rows, and every argument of a
    maximum or minimum, since any of them may apply on a part of the set."""
    choices = product(*(tuple(islice(_each_argument(row), _CHOICES + 1)) for row in rows))
    alike = [*islice(choices, _CHOICES + 1)]
    if len(alike) > _CHOICES or any(row.has(*_INFINITE) for each in alike for row in each):
        return False

    def finite_somewhere(chosen: Iterable[sp.Expr]) -> bool:
        rows = tuple(map(_every_piece, chosen))
        plant = Model(rows, constraints, states, others, places=places, constraints=constraints).plant

        def finite(numbers: Arithmetic, point: Point) -> bool:
            inputs = (u for j in range(plant.m) for u in point.inputs(j, 1))
            if all(ball.is_finite() for ball in values(plant.tape, [*point.states, *inputs], flint.ctx.prec)):
                return True
            raise Undecided

        try:
            return at_random_point(plant, finite)
        except NowhereDefined:
            return False

    return all(map(finite_somewhere, alike))


def _each_argument(e: sp.Expr) -> Iterator[sp.Expr]:
    """Yield the expression with each maximum and minimum replaced by one of its arguments, in all combinations."""
    node = min(e.atoms(sp.Max, sp.Min), key=str, default=None)
    if node is None:
        yield e
        return
    for argument in node.args:
        yield from _each_argument(e.xreplace({node: argument}))


def _every_piece(e: sp.Expr) -> sp.Expr:
    if not e.args:
        return e
    if isinstance(e, sp.Piecewise):
        return sp.Add(*(_every_piece(piece) for piece, _ in e.args))
    if isinstance(e, (sp.sign, sp.Heaviside)):
        return sp.S.One
    return e.func(*map(_every_piece, e.args))


def rate(constraint: sp.Expr, flow: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Return the time derivative grad c . f of a constraint c; `flow`: the right-hand side f_i of each state."""
    return sp.Add(*(sp.diff(constraint, x) * f for x, f in flow.items()))


def factors(constraint: sp.Expr, states: Collection[sp.Symbol], box: Box) -> tuple[tuple[sp.Expr, int], ...]:
    """Return the factors of a constraint that may be 0 on the box, each with its multiplicity. Omitted are the
    denominator, factors that read no state, and factors proved not to be 0; a factor exp(m) - r becomes m - log(r)."""
    try:  # by FLINT, or by SymPy, which takes minutes for a polynomial in 50 symbols
        product = factored(constraint)
        whole = [(one.base, one.exponent) for one in product.factors if one.exponent > 0] if product else []
        every = sorted(whole, key=str) or sp.factor_list(sp.numer(sp.together(constraint)))[1]
    except sp.PolynomialError:
        every = [(constraint, 1)]
    return tuple((_logarithm(one), k) for one, k in every if one.free_symbols & {*states} and not _never(one, box))


def _never(factor: sp.Expr, box: Box) -> bool:
    if factor.is_zero is False:
        return True
    try:
        return nonzero(factor, {s: box[s] for s in factor.free_symbols}, refute=False).never
    except NoTape:
        return False


def _logarithm(factor: sp.Expr) -> sp.Expr:
    terms = sp.Add.make_args(factor)
    if len(terms) != 2 or not factor.has(sp.exp):
        return factor
    equal = sp.expand_log(sp.log(sp.powsimp(-terms[0] / terms[1])))
    if any(e.free_symbols for e in equal.atoms(sp.log)) or equal.has(sp.I):
        return factor
    return -equal if equal.could_extract_minus_sign() else equal


def restricted(row: sp.Expr, constraints: Sequence[sp.Expr]) -> sp.Expr:
    """Return an expression that equals `row` on the constraint set: functions, roots and comparisons whose arguments
    are proved to be constant there are replaced by their values, and quotients by their continuous extensions.
    Derivatives along the set agree as well, other derivatives may not. A row that divides by 0 on the set is returned
    unchanged."""

    def zero(e: sp.Expr) -> bool:
        return _value(e, constraints) == 0

    if not constraints:
        return row
    filled, full = row, resolved(row)
    while nodes := full.atoms(Resolved):
        node = next(each for each in nodes if not any(part.has(Resolved) for part in each.args))
        (within, inside), (beyond, _) = node.args
        full = full.xreplace({node: within if _put_in(inside, constraints) == sp.true else beyond})
    if any(zero(node.base) for node in row.atoms(sp.Pow) if node.exp.is_negative):
        filled = full
    if any(zero(node.base) for node in filled.atoms(sp.Pow) if node.exp.is_negative):
        return row
    there = _put_in(filled, constraints)
    return row if there.has(*_INFINITE) else there


def _put_in(e: sp.Basic, constraints: Sequence[sp.Expr]) -> sp.Basic:
    """Return an expression or a comparison in which each part that is proved to be a number on the constraint set is
    this number."""
    for node in sp.postorder_traversal(e):
        value = _at_number(node, constraints)
        if value is not None:
            return _put_in(e.xreplace({node: value}), constraints)
    return e


def _value(e: sp.Expr, constraints: Sequence[sp.Expr]) -> sp.Expr | None:
    """Return the number that an expression is proved to be on the constraint set, or None."""
    value = divided(e, constraints).remainder if e.free_symbols else e
    return value if value.is_number else None


def _at_number(node: sp.Basic, constraints: Sequence[sp.Expr]) -> sp.Basic | None:
    if not node.free_symbols:
        return None
    if isinstance(node, sp.core.relational.Relational):
        value = _value(node.lhs - node.rhs, constraints)
        return None if value is None else sp.sympify(node.func(value, 0))
    if isinstance(node, (sp.Min, sp.Max)):
        pairs = ((a, b) for i, a in enumerate(node.args) for b in node.args[:i])
        same = next((a for a, b in pairs if _value(a - b, constraints) == 0), None)
        return None if same is None else node.func(*(e for e in node.args if e != same))
    if isinstance(node, sp.Heaviside) or (isinstance(node, sp.Function) and len(node.args) == 1):
        value = _value(node.args[0], constraints)
        return None if value is None else node.func(value, *node.args[1:])
    if isinstance(node, sp.Pow) and not node.exp.is_Integer and node.exp.is_number:
        value = _value(node.base, constraints)
        return None if value is None else value**node.exp
    return None


def opposites(
    constraints: Sequence[sp.Expr], flow: Mapping[sp.Symbol, sp.Expr], output: Sequence[sp.Expr]
) -> tuple[tuple[int, ...], ...]:
    """Return the sets of states, by their indices, whose vector v can be replaced by -v without changing the plant's
    motion, as the quaternions q and -q: no output, no constraint and no rate of another state changes, and v' becomes
    -v'."""
    states, groups = list(flow), list[tuple[int, ...]]()
    for constraint in constraints:
        turned = {x: -x for x in states if x in constraint.free_symbols}
        changes = (row.xreplace(turned) - row for row in (*constraints, *output))
        rates = (f.xreplace(turned) - (-f if x in turned else f) for x, f in flow.items())
        if all(vanishes(change) for change in (*changes, *rates)):
            groups.append(tuple(states.index(x) for x in turned))
    return tuple(dict.fromkeys(groups))
