"""Maps between coordinates: their inverses, and derivatives along the flow of a plant.

The inverse of a map z = Phi(x, u) is solved state by state, where a row reads one unknown state, and the remaining
states together where their rows are linear.

A candidate counts only if Psi(Phi(x, u), u) = x is proved exactly, for the signs that the ranges of x and the values of
fixed parameters give. Then Phi is one to one wherever Psi(Phi) is defined. Of several branches the one that fits the
ranges is chosen.

An observer evaluates x = Psi(z, u) with denominators whose sign is fixed (`sided`). z = Phi(x, u) maps the plant's
ranges to a part of the box of z. A denominator d(z, u) of Psi with d(Phi(x, u), u) >= least > 0 on the plant's ranges
may still be 0 elsewhere in the box of z. Past that pole Psi has the other sign, and the clamp to the ranges would
return the far end. Therefore Psi is evaluated with max(d, least), or min(d, -least). On the image of the ranges it is
unchanged. Beyond, it is continuous, and the clamp returns the near end.

Derivatives along the flow of a plant are y, y', y'', ..., with the derivatives of the inputs as symbols.

    (L e)(x, u, u', ..) = de/dx f(x, u) + de/du u' + de/du' u'' + ...

The derivatives of an input are Signals (`Signal.derivative`), in the ranges that its `rates` declare. Source: M.
Fliess, "Generalized controller canonical forms for linear and nonlinear dynamics", IEEE TAC 35 (1990).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import sympy as sp
from sympy.solvers.solveset import NonlinearError

from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import Box, exact, points
from hgogen.rigor.field import is_zero
from hgogen.rigor.series import values
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.rigor.tape import NoTape, tape
from hgogen.sentence import NONE, Reason, because, down
from hgogen.signal import Signal, derived
from hgogen.system import System

_SIDED = 2000  # boxes: a bound away from 0 need not be the best
# Beyond so many nodes an expression is not simplified.
_LIMIT = 400
_TOGETHER = 2 * _LIMIT  # nodes times functions: each function is one more symbol for `cancel`
_BITS, _NOTHING = 256, 1e-9  # bits of a value at a sample point, and the largest rounding error after cancellation
EMPTY: Mapping[Signal, float] = MappingProxyType({})
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


def stand_ins(signals: Iterable[Signal], fixed: Mapping[Signal, float] = EMPTY) -> dict[Signal, sp.Dummy]:
    """Return a SymPy dummy symbol for each signal, with assumptions on its sign from its range or its `fixed` value, so
    that sqrt(w^2) can be simplified to w."""
    ends = {s: (fixed[s], fixed[s]) if s in fixed else s.interval for s in signals}
    dummies = {}
    for s, (low, high) in ends.items():
        assumed = {"nonnegative": True} if low == 0 else {}
        if low > 0 or high < 0:
            assumed = {"positive" if low > 0 else "negative": True}
        dummies[s] = sp.Dummy(s.name, real=True, **assumed)
    return dummies


def inverse(
    images: Mapping[sp.Symbol, sp.Expr],
    states: Sequence[Signal],
    known: Sequence[Signal],
    fixed: Mapping[Signal, float] = EMPTY,
) -> dict[sp.Symbol, sp.Expr] | None:
    """Return the inverse map x = Psi(z, u) of z = Phi(x, u): for each state an expression of z, inputs and parameters;
    None where the solver has no result.

    Args: `images`: the expression Phi_i of each z_i, in order; `states`: x; `known`: the inputs and parameters that Phi
    may depend on; `fixed`: the values of those that never change.
    """
    plain = stand_ins((*states, *known), fixed)
    forward = {z: exact(e).xreplace(plain) for z, e in images.items()}
    unknown = [plain[x] for x in states]
    solved: dict[sp.Symbol, sp.Expr] = {}
    rows = dict(forward)
    while len(solved) < len(unknown):
        remaining = [x for x in unknown if x not in solved]
        new = _next(rows, remaining, forward) or _linear(rows, remaining, forward)
        if not new:
            return None
        solved |= new
        rows = {z: cancel_factors(e.xreplace(new)) for z, e in rows.items() if e.free_symbols & set(remaining)}
    back = {dummy: signal for signal, dummy in plain.items()}
    candidate = {x: solved[plain[x]].xreplace(back) for x in states}
    return candidate if _holds(candidate, images, (*states, *known), fixed) else None


def cancel_factors(expression: sp.Expr) -> sp.Expr:
    """Return the expression with common factors of numerator and denominator cancelled; functions and roots count as
    symbols."""
    nodes, roots = size([expression]), {p for p in expression.atoms(sp.Pow) if not p.exp.is_Integer}
    dummies = {f: sp.Dummy() for f in sorted(roots | expression.atoms(sp.Function), key=sp.default_sort_key)}
    if nodes > _LIMIT or nodes * len(dummies) > _TOGETHER:
        return expression
    whole = expression.xreplace(dummies)
    return sp.cancel(whole).xreplace({dummy: f for f, dummy in dummies.items()})


def _next(
    rows: Mapping[sp.Symbol, sp.Expr], remaining: Sequence[sp.Symbol], forward: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, sp.Expr]:
    for z, row in rows.items():
        read = [x for x in remaining if x in row.free_symbols]
        if len(read) == 1:
            for candidate in _roots(row - z, read[0]):
                if _undoes(candidate, read[0], forward):
                    return {read[0]: candidate}
    return {}


def _linear(
    rows: Mapping[sp.Symbol, sp.Expr], remaining: list[sp.Symbol], forward: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, sp.Expr]:
    numerators = [sp.fraction(sp.together(e - z))[0] for z, e in rows.items() if e.free_symbols & set(remaining)]
    try:
        matrix, right = sp.linear_eq_to_matrix(numerators, remaining)
    except (NonlinearError, ValueError):
        return {}
    if matrix.rows != matrix.cols or cancel_factors(matrix.det()) == 0:
        return {}
    solution = dict(zip(remaining, map(cancel_factors, matrix.LUsolve(right)), strict=True))
    return solution if all(_undoes(e, x, forward) for x, e in solution.items()) else {}


def _roots(equation: sp.Expr, x: sp.Symbol) -> Iterator[sp.Expr]:
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
            root = sp.sqrt(cancel_factors(b**2 - 4 * a * c))
            yield from ((-b + root) / (2 * a), (-b - root) / (2 * a))
        return
    functions = numerator.atoms(sp.Function, sp.Pow)
    inner = {f for f in functions if x in f.free_symbols and not f.is_polynomial(x)}
    for f in sorted(inner, key=sp.default_sort_key):
        value = sp.Dummy()
        in_function = numerator.xreplace({f: value})
        if x in in_function.free_symbols or not in_function.is_polynomial(value):
            continue
        for root in _roots(in_function, value):
            inner_equation = _behind(f, root)
            if inner_equation is not None:
                yield from _roots(inner_equation, x)


def _behind(f: sp.Expr, value: sp.Expr) -> sp.Expr | None:
    """Return an expression that is 0 exactly if f = value, as
    g - log(value) for f = exp(g); None without an inverse."""
    if isinstance(f, sp.Pow):
        return f.base - value ** (1 / f.exp) if f.exp.is_Rational else None
    back = _BACK.get(type(f))
    return None if back is None else f.args[0] - back(value)


def _undoes(candidate: sp.Expr, x: sp.Symbol, forward: Mapping[sp.Symbol, sp.Expr]) -> bool:
    error = cancel_factors(candidate.xreplace(dict(forward)) - x)
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
    """Return whether Psi(Phi(x)) = x, Psi = `candidate`,
    Phi = `images`, up to rounding errors at all sample points."""
    errors = [exact(e.xreplace(dict(images)).xreplace(dict(fixed))) - x for x, e in candidate.items()]
    read = [s for s in signals if any(s in e.free_symbols for e in errors)]
    try:
        program = tape(errors, read)
    except NoTape:
        return False
    balls = (ball for at in points(read) for ball in values(program, [at[s] for s in read], _BITS))
    return not any(ball.is_finite() and abs(ball) > _NOTHING for ball in balls)


# ---------------------------------------------------------------- as an observer evaluates it


@dataclass(frozen=True)
class Sided:
    """The inverse map x = Psi(z), `rows` (n), with each denominator of proved sign clamped to that sign. `finite` (n):
    whether Psi_i is proved to be a number on the whole box of z; where it is not, an observer has to test it."""

    rows: tuple[sp.Expr, ...]
    finite: tuple[bool, ...]


def sided(form: Form) -> Sided:
    """Return the form's inverse map x = Psi(z), with each denominator of a proved sign clamped to that sign.

    The least size of a denominator on the image of the plant's box is proved by outward-rounded intervals. The clamp is
    at half of it, which leaves room for rounding.
    """
    plant = form.system
    around, ranges, images = form.box, plant.box, dict(zip(form.states, form.to_form, strict=True))
    denominators = sorted({d for row in form.from_form for d in _denominators(row)}, key=sp.default_sort_key)
    poles = [d for d in denominators if not _least(d, around)]
    leasts = {d: _least(cancel_factors(d.xreplace(images)), ranges) for d in poles}
    leasts = {d: least for d, least in leasts.items() if least}
    doubtful = {d for d in poles if d not in leasts}
    finite = []  # a state with a sign, or a rational function of bounded signals without a denominator that may be 0
    for row in form.from_form:
        read = row.free_symbols
        bounded = all(s.bounded for s in (*form.states, *plant.inputs) if s in read)
        rational = bounded and bool(row.is_rational_function(*read)) and not doubtful & {*_denominators(row)}
        finite.append(rational or row in form.states or -row in form.states)
    return Sided(tuple(_bounded_away(row, leasts) for row in form.from_form), tuple(finite))


def _denominators(row: sp.Expr) -> list[sp.Expr]:
    powers = (p for p in row.atoms(sp.Pow) if p.exp.is_Integer and p.exp.is_negative)
    return [p.base for p in powers if not p.is_number]


def _least(denominator: sp.Expr, ranges: Box) -> sp.Rational:
    sign = nonzero(denominator, ranges, boxes=_SIDED, refute=False)
    if sign.verdict is not Verdict.PROVED:
        return sp.S.Zero
    return sign.sign * sp.Rational(down(sign.margin / 2))


def _bounded_away(row: sp.Expr, leasts: Mapping[sp.Expr, sp.Rational]) -> sp.Expr:
    """Return `row` with each denominator d in `leasts` as max(d, least), or min(d, least) if least < 0."""
    powers = (p for p in row.atoms(sp.Pow) if p.exp.is_Integer and p.exp.is_negative and p.base in leasts)
    changed = {}
    for p in powers:
        least = leasts[p.base]
        keep = sp.Max if least > 0 else sp.Min
        changed[p] = keep(_bounded_away(p.base, leasts), least) ** p.exp
    return row.xreplace(changed)


# ---------------------------------------------------------------- lie


def rates(plant: System, orders: int) -> dict[sp.Symbol, sp.Expr]:
    """Return, by symbol, the time derivatives of the states, x' = f, and of the inputs and their derivatives u^(k), k <
    `orders`."""
    changes = {x: exact(row) for x, row in zip(plant.states, plant.flow, strict=True)}  # no product of floats is exact
    for u in plant.supplied:
        changes |= {u.derivative(k): u.derivative(k + 1) for k in range(orders)}
    return changes | dict.fromkeys(plant.times, sp.S.One)


def time_derivative(expression: sp.Expr, rates: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Return the time derivative of an expression by the chain rule; `rates`: the time derivatives of its symbols, of
    which those that are not listed are constant. Polynomials are expanded."""
    moving = sorted(expression.free_symbols & rates.keys(), key=str)
    result = sp.Add(*(expression.diff(symbol) * rates[symbol] for symbol in moving))
    return sp.expand(result) if result.is_polynomial() else result


def derivatives(expression: sp.Expr, rates: Mapping[sp.Symbol, sp.Expr], count: int) -> tuple[sp.Expr, ...]:
    """Return an expression and its first count - 1 time derivatives; `rates`: the time derivatives of its symbols."""
    chain = [expression]
    while len(chain) < count:
        chain.append(time_derivative(chain[-1], rates))
    return tuple(chain[:count])


def input_derivatives(expressions: Iterable[sp.Expr], plant: System, orders: int) -> tuple[Signal, ...]:
    """Return the derivatives of the plant's inputs, up to the order `orders`, that occur in the expressions."""
    read = set().union(*(e.free_symbols for e in expressions))
    known = (u.derivative(k) for u in plant.supplied for k in range(1, orders + 1))
    return tuple(signal for signal in known if signal in read)


def without_rates(plant: System) -> System:
    """Return the plant without the inputs that a form has added as derivatives of other inputs."""
    read = set().union(*(sp.sympify(e).free_symbols for e in (*plant.flow, *plant.output)))
    known = derived(plant.inputs)
    return replace(plant, inputs=tuple(u for u in plant.inputs if u in read or u.name not in known))


def without_derivative(expressions: Iterable[sp.Expr]) -> Reason:
    """Return a reason that names the first function with jumps or kinks in the expressions, such as |x|; `NONE` without
    one."""
    node = min((node for e in expressions for node in e.atoms(*JUMPS, *KINKS)), key=str, default=None)
    return NONE if node is None else because("{part} has no derivative somewhere", part=node)


def length(expression: sp.Expr) -> int:
    """Return the number of nodes of the expression's tree, with repeated parts counted each time: a measure of its
    length when written out."""
    known: dict[sp.Basic, int] = {}

    def count(node: sp.Basic) -> int:
        if node not in known:
            known[node] = 1 + sum(map(count, node.args))
        return known[node]

    return count(expression)


def size(expressions: Iterable[sp.Expr]) -> int:
    """Return the number of distinct nodes of the expressions' trees: a measure of the cost of computing with them."""
    visited: set[sp.Basic] = set()
    stack: list[sp.Basic] = list(expressions)
    while stack:
        node = stack.pop()
        if node not in visited:
            visited.add(node)
            stack += node.args
    return len(visited)
