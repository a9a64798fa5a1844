"""The inverse of a map z = Phi(x, u): one state after the other where a row brings in one, the rest where it is linear.

A candidate counts only if Psi(Phi(x, u), u) = x is shown exactly, for the signs that the ranges of x and the values of
fixed parameters give; then Phi is one to one wherever Psi(Phi) is defined, and of several branches the one that fits
the ranges is taken.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction

import sympy as sp
from sympy.solvers.solveset import NonlinearError

from hgogen.algebra.identity import is_zero
from hgogen.algebra.points import exact, points
from hgogen.algebra.pointwise import values
from hgogen.algebra.tape import NoTape, tape
from hgogen.analysis.lie import size
from hgogen.signal import Signal
from hgogen.structure.diffeomorphism import EMPTY, stand_ins

# Beyond so many nodes an expression is not simplified.
_LIMIT = 400
_TOGETHER = 2 * _LIMIT  # nodes times functions, each of which is a symbol more to cancel in
_BITS, _NOTHING = 256, 1e-9  # of a value at a sample point, and what of it may be left of cancellations
_BACK: dict[type, Callable[[sp.Expr], sp.Expr]] = {
    sp.exp: sp.log,
    sp.log: sp.exp,
    sp.sinh: sp.asinh,
    sp.asinh: sp.sinh,
    sp.tanh: sp.atanh,
    sp.atanh: sp.tanh,
    sp.atan: sp.tan,
    sp.tan: sp.atan,
    sp.sin: sp.asin,
    sp.cos: sp.acos,
}


def inverse(
    images: Mapping[sp.Symbol, sp.Expr],
    states: Sequence[Signal],
    known: Sequence[Signal],
    fixed: Mapping[Signal, float] = EMPTY,
) -> dict[sp.Symbol, sp.Expr] | None:
    """Each state as an expression of z, inputs and parameters; None where the search finds no inverse.

    Args: `images`: z to Phi, in order; `states`: x; `known`: the inputs and parameters that Phi may read; `fixed`: the
    values of those that never change.
    """
    plain = stand_ins((*states, *known), fixed)
    forward = {z: exact(e).xreplace(plain) for z, e in images.items()}
    unknown = [plain[x] for x in states]
    solved: dict[sp.Symbol, sp.Expr] = {}
    rows = dict(forward)
    while len(solved) < len(unknown):
        left = [x for x in unknown if x not in solved]
        new = _next(rows, left, forward) or _linear(rows, left, forward)
        if not new:
            return None
        solved |= new
        rows = {z: tidy(e.xreplace(new)) for z, e in rows.items() if e.free_symbols & set(left)}
    back = {dummy: signal for signal, dummy in plain.items()}
    candidate = {x: solved[plain[x]].xreplace(back) for x in states}
    return candidate if _holds(candidate, images, (*states, *known), fixed) else None


def tidy(expression: sp.Expr) -> sp.Expr:
    """The expression with common factors cancelled, functions and roots taken as symbols of their own."""
    nodes, roots = size([expression]), {p for p in expression.atoms(sp.Pow) if not p.exp.is_Integer}
    stands = {f: sp.Dummy() for f in sorted(roots | expression.atoms(sp.Function), key=sp.default_sort_key)}
    if nodes > _LIMIT or nodes * len(stands) > _TOGETHER:
        return expression
    whole = expression.xreplace(stands)
    return sp.cancel(whole).xreplace({dummy: f for f, dummy in stands.items()})


def _next(
    rows: Mapping[sp.Symbol, sp.Expr], left: Sequence[sp.Symbol], forward: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, sp.Expr]:
    """The state of the first row that brings in only one and can be solved for it."""
    for z, row in rows.items():
        read = [x for x in left if x in row.free_symbols]
        if len(read) == 1:
            for candidate in _roots(row - z, read[0]):
                if _undoes(candidate, read[0], forward):
                    return {read[0]: candidate}
    return {}


def _linear(
    rows: Mapping[sp.Symbol, sp.Expr], left: list[sp.Symbol], forward: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, sp.Expr]:
    """All remaining states at once, where the numerators of the remaining rows are linear in them together."""
    numerators = [sp.fraction(sp.together(e - z))[0] for z, e in rows.items() if e.free_symbols & set(left)]
    try:
        matrix, right = sp.linear_eq_to_matrix(numerators, left)
    except (NonlinearError, ValueError):
        return {}
    if matrix.rows != matrix.cols or tidy(matrix.det()) == 0:
        return {}
    solution = dict(zip(left, map(tidy, matrix.LUsolve(right)), strict=True))
    return solution if all(_undoes(e, x, forward) for x, e in solution.items()) else {}


def _roots(equation: sp.Expr, x: sp.Symbol) -> Iterator[sp.Expr]:
    """Solutions of equation = 0 for x: of a polynomial of degree 1 or 2, or behind a function that occurs alone."""
    numerator = sp.fraction(sp.together(equation))[0]
    if numerator.is_polynomial(x):
        coefficients = sp.Poly(numerator, x).all_coeffs()
        if len(coefficients) == 2:
            yield -coefficients[1] / coefficients[0]
        elif len(coefficients) == 3 and coefficients[1] == 0:
            a, _, c = coefficients
            root = sp.sqrt(sp.factor(-c / a))  # a product shows its sign
            yield from (root, -root)
        elif len(coefficients) == 3:
            a, b, c = coefficients
            root = sp.sqrt(tidy(b**2 - 4 * a * c))
            yield from ((-b + root) / (2 * a), (-b - root) / (2 * a))
        return
    functions = numerator.atoms(sp.Function, sp.Pow)
    inner = {f for f in functions if x in f.free_symbols and not f.is_polynomial(x)}
    for f in sorted(inner, key=sp.default_sort_key):
        value = sp.Dummy()
        rest = numerator.xreplace({f: value})
        if x in rest.free_symbols or not rest.is_polynomial(value):
            continue
        for root in _roots(rest, value):
            undone = _behind(f, root)
            if undone is not None:
                yield from _roots(undone, x)


def _behind(f: sp.Expr, value: sp.Expr) -> sp.Expr | None:
    """What is 0 where f = value, with the function undone; None for one without an inverse here."""
    if isinstance(f, sp.Pow):
        return f.base - value ** (1 / f.exp) if f.exp.is_Rational else None
    back = _BACK.get(type(f))
    return None if back is None else f.args[0] - back(value)


def _undoes(candidate: sp.Expr, x: sp.Symbol, forward: Mapping[sp.Symbol, sp.Expr]) -> bool:
    """Whether the candidate, an expression of z, is x where z = Phi(x)."""
    error = tidy(candidate.xreplace(dict(forward)) - x)
    if error == 0 or size([error]) > _LIMIT:
        return bool(error == 0)
    signed = [s for s in error.free_symbols if s.is_nonnegative or s.is_nonpositive]
    signs = {s: (0, sp.oo) if s.is_nonnegative else (-sp.oo, 0) for s in signed}
    answer = is_zero(error, signs)
    return bool(sp.simplify(error) == 0) if answer is None else answer


def _holds(
    candidate: Mapping[sp.Symbol, sp.Expr],
    images: Mapping[sp.Symbol, sp.Expr],
    signals: Sequence[Signal],
    fixed: Mapping[Signal, float],
) -> bool:
    """A second test of the candidate: at no sample point of the box does a ball exclude that Psi(Phi(x)) = x."""
    errors = [exact(e.xreplace(dict(images)).xreplace(dict(fixed))) - x for x, e in candidate.items()]
    read = [s for s in signals if any(s in e.free_symbols for e in errors)]
    try:
        program = tape(errors, read)
    except NoTape:
        return False
    at = ([Fraction(point[s].p, point[s].q) for s in read] for point in points(read))
    return not any(ball.is_finite() and abs(ball) > _NOTHING for place in at for ball in values(program, place, _BITS))
