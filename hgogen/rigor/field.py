"""Exact algebra on a set of expressions: generators, quotients of polynomials, and zero tests.

Expressions are written as rational functions of generators, so that algebra can cancel exp, sin, roots and powers:

    exp(p m) = E^(p/g)                          E = exp(g m)
    cos(k t) + i sin(k t) = ((1 + i T)^2/(1 + T^2))^k     T = tan(t/2)
    e^(p/q) = R^p                               R^q = e, a relation
    a^b = exp(b log a),   log(c g) = log c + log g for a rational c > 0,   sinh, cosh, tanh by exp
    |e|^2 = e^2, a relation,   max(a, b) = (a + b + |a - b|)/2,   min(a, b) = (a + b - |a - b|)/2

m is a monomial of the expanded argument, g the greatest common divisor of its rational factors. Any other function of
an argument is a generator of its own. Each rule is an identity over the reals wherever both sides are defined.
Relations between generators that are not listed only lose proofs.

The field consists of quotients of polynomials in symbols and kernels: exp(m), tan(m/2), roots, logarithms, .. As sin
and cos are rational in T = tan(m/2), the ring has unique factorisation, unlike the ring with sin, cos and their
relation. For the same reason a root of c s + r, with a number c and an r without the symbol s, replaces s:

    g^q = c s + r   =>   s = (g^q - r)/c

A tape forms quotients of FLINT polynomials over the rationals; sizes are limited by counts of terms.

Zero tests decide whether an expression is 0 wherever it is defined, and which symbols a function depends on. True is
proved by exact algebra (`vanishes`), False by a value at a rational point whose ball excludes 0, or by a polynomial
that is not 0; None means neither. A box restricts the points, not the algebra: on x >= 1, |x| - x is undecided.
"""

import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from math import comb
from typing import Any

import sympy as sp
from flint import Ordering, fmpq, fmpq_mpoly_ctx

from hgogen.errors import HgogenError
from hgogen.rigor.box import exact, substituted, substituted_where_real
from hgogen.rigor.series import values
from hgogen.rigor.tape import Norm, NoTape, tape
from hgogen.sentence import Reason, because

# Most multiples of an angle, and most terms and operations of an argument.
_MULTIPLE, _ANGLES, _OPERATIONS = 16, 6, 200
_TRIGONOMETRIC = (sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc)
_TRIED = 2**16  # the primes that a large whole number under a logarithm is divided by
_HYPERBOLIC = (sp.sinh, sp.cosh, sp.tanh, sp.coth, sp.sech, sp.csch)


@dataclass(eq=False)
class TooLarge(HgogenError):
    """The error that an expression, `what`, is too large for exact algebra."""

    what: str

    @property
    def reason(self) -> Reason:
        """Return the reason in words."""
        return because("{what} is too large for exact algebra; write it in fewer or simpler terms", what=self.what)

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class Relation:
    """The equation generator^degree = value of a root; `value`: a rational function of earlier generators."""

    generator: sp.Dummy
    degree: int
    value: sp.Expr


@dataclass(frozen=True, eq=False)
class Writer:
    """A translation of expressions to rational functions of generators: symbols, roots, exp(g m), tan(g m/2) with
    rational g and monomials m, and other functions.

    `kernels`: the generator of each function, in the order of first use; `relations`: the equations g^q = value of
    roots; `units`: the number g of each monomial m; `known`: the translations so far.
    """

    kernels: dict[sp.Expr, sp.Dummy] = attribute(default_factory=dict)
    relations: list[Relation] = attribute(default_factory=list)
    units: dict[tuple[str, sp.Expr], sp.Rational] = attribute(default_factory=dict)
    known: dict[sp.Expr, sp.Expr] = attribute(default_factory=dict)

    def measure(self, expression: sp.Expr) -> None:
        """Update `units` by an expression: g becomes the greatest common divisor of the rational factors of the
        monomial m in all exponents and angles; exp(3 m/2) and exp(m) need g = 1/2."""
        for node in sp.preorder_traversal(expression):
            kind = _kind(node)
            if kind:
                for factor, monomial in _terms(_argument(node)):
                    key = (kind, monomial)
                    self.units[key] = sp.gcd(self.units.get(key, sp.S.Zero), factor)
                    self.measure(monomial)

    def write(self, node: sp.Expr) -> sp.Expr:
        """Return an expression as a rational function of generators: symbols, exp(g m), tan(g m/2), roots, logarithms
        and others."""
        if node.is_Rational or node.is_Symbol:
            return node
        if node not in self.known:
            self.known[node] = self._write(node)
        return self.known[node]

    def _write(self, node: sp.Expr) -> sp.Expr:
        if node.is_Add or node.is_Mul:
            return node.func(*(self.write(part) for part in node.args))
        if node.is_Pow and node.exp.is_Integer:
            return self.write(node.base) ** node.exp
        if node.is_Pow and node.exp.is_Rational:
            base, degree = _canonical(node.base), int(node.exp.q)
            root = sp.Pow(base, sp.Rational(1, degree), evaluate=False)
            return self._relation(root, degree, base) ** int(node.exp.p)
        if isinstance(node, _TRIGONOMETRIC):
            return self._trigonometric(node)
        if _kind(node) == "exp":
            return self._exponential(node)
        if isinstance(node, sp.log):
            return self._log(_canonical(node.args[0]))
        if isinstance(node, sp.Abs) or (isinstance(node, Norm) and len(node.args) == 1):
            argument = _canonical(node.args[0])
            if argument.could_extract_minus_sign():
                argument = _canonical(-argument)
            return self._relation(sp.Abs(argument, evaluate=False), 2, argument**2)
        if isinstance(node, (sp.Min, sp.Max)):
            sign = 1 if isinstance(node, sp.Max) else -1
            return self.write(reduce(lambda a, b: (a + b + sign * sp.Abs(a - b)) / 2, node.args))
        return self._kernel(node)

    def _kernel(self, node: sp.Expr) -> sp.Expr:
        if isinstance(node, sp.Function) and not isinstance(node, sp.Piecewise):
            node = node.func(*(_canonical(part) for part in node.args), evaluate=False)
        return self.kernels.setdefault(node, sp.Dummy(f"kernel{len(self.kernels)}"))

    def _relation(self, key: sp.Expr, degree: int, value: sp.Expr) -> sp.Expr:
        if key not in self.kernels:
            inner = self.write(value)
            self.kernels[key] = sp.Dummy(f"kernel{len(self.kernels)}")
            self.relations.append(Relation(self.kernels[key], degree, inner))
        return self.kernels[key]

    def _log(self, argument: sp.Expr) -> sp.Expr:
        if argument.is_Integer and argument > 1:
            known = {} if argument < 2**40 else {"limit": _TRIED, "use_rho": False, "use_pm1": False, "use_ecm": False}
            factors = sp.factorint(argument, **known)
            return sp.Add(*(k * self._kernel(sp.log(p, evaluate=False)) for p, k in factors.items()))
        factor, primitive = argument.as_content_primitive()
        if factor < 0:
            factor, primitive = -factor, -primitive
        powers = [part for part in sp.Mul.make_args(primitive) if isinstance(part, sp.exp)]
        others = sp.Mul(*(part for part in sp.Mul.make_args(primitive) if part not in powers))
        inner = sp.S.Zero if others == 1 else self._kernel(sp.log(others, evaluate=False))
        ends = [self._log(sp.Integer(n)) if n != 1 else sp.S.Zero for n in (factor.p, factor.q)]
        return sp.Add(inner, ends[0], -ends[1], *(self.write(power.args[0]) for power in powers))

    def _exponential(self, node: sp.Expr) -> sp.Expr:
        factors = []
        for factor, monomial in _terms(_argument(node)):
            if isinstance(monomial, sp.log):
                factors.append(self.write(sp.Pow(monomial.args[0], factor)))
            else:
                unit, times = self._unit("exp", factor, monomial)
                factors.append(self._kernel(Exp(monomial, unit)) ** times)
        power = sp.Mul(*factors)
        rules = {
            sp.sinh: (power - 1 / power) / 2,
            sp.cosh: (power + 1 / power) / 2,
            sp.tanh: (power**2 - 1) / (power**2 + 1),
            sp.coth: (power**2 + 1) / (power**2 - 1),
            sp.sech: 2 * power / (power**2 + 1),
            sp.csch: 2 * power / (power**2 - 1),
        }
        return rules.get(type(node), power)

    def _unit(self, kind: str, factor: sp.Rational, monomial: sp.Expr) -> tuple[sp.Rational, int]:
        """Return g and the integer k with factor = k g, for exp(factor m) (`kind` "exp") or the angle factor m (`kind`
        "turn") of a monomial m. g is that of `measure`, or 1/q for a factor p/q that is no integer multiple of it."""
        unit = self.units.get((kind, monomial), sp.S.One)
        if not (factor / unit).is_Integer:
            unit = sp.Rational(1, factor.q)
        return unit, int(factor / unit)

    def _trigonometric(self, node: sp.Expr) -> sp.Expr:
        terms = list(_terms(_argument(node)))
        if len(terms) > _ANGLES:
            raise TooLarge(str(node))
        c, s = sp.S.One, sp.S.Zero
        for factor, monomial in terms:
            a, b = self._turn(factor, monomial)
            c, s = c * a - s * b, s * a + c * b
        if isinstance(node, (sp.sin, sp.cos)):
            return s if isinstance(node, sp.sin) else c
        return {sp.tan: s / c, sp.cot: c / s, sp.sec: 1 / c, sp.csc: 1 / s}[type(node)]

    def _turn(self, factor: sp.Rational, monomial: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Return cos(factor m) and sin(factor m) of the `monomial` m as rational functions of tan(g m/2)."""
        if monomial == sp.pi:
            exact = sp.cos(factor * sp.pi), sp.sin(factor * sp.pi)
            if not any(value.has(*_TRIGONOMETRIC) for value in exact):
                return self.write(exact[0]), self.write(exact[1])
        unit, times = self._unit("turn", factor, monomial)
        T = self._kernel(Half(monomial, unit))
        if abs(times) > _MULTIPLE:
            raise TooLarge(f"{times} times the angle {unit * monomial}")
        a, b = (1 - T**2) / (1 + T**2), 2 * T / (1 + T**2)
        c, s = sp.S.One, sp.S.Zero
        for _ in range(abs(times)):
            c, s = c * a - s * b, s * a + c * b
        return c, s if times >= 0 else -s


class Exp(sp.Function):  # type: ignore[misc]
    """The SymPy function of (m, g) for exp(g m), unevaluated."""


class Half(sp.Function):  # type: ignore[misc]
    """The SymPy function of (m, g) for tan(g m/2), unevaluated."""


def _kind(node: sp.Basic) -> str:
    if isinstance(node, (sp.exp, *_HYPERBOLIC)) or node == sp.E or (node.is_Pow and not node.exp.is_Rational):
        return "exp"
    return "turn" if isinstance(node, _TRIGONOMETRIC) else ""


def _argument(node: sp.Expr) -> sp.Expr:
    if node == sp.E:
        return sp.S.One
    if isinstance(node, sp.exp):
        return _canonical(node.args[0])
    if node.is_Pow:
        return _canonical(node.exp * sp.log(node.base))
    return _canonical(node.args[0])


def _terms(argument: sp.Expr) -> Iterator[tuple[sp.Rational, sp.Expr]]:
    for term in sp.Add.make_args(argument):
        factor, monomial = term.as_coeff_Mul(rational=True)
        if factor:
            yield factor, monomial


def _canonical(argument: sp.Expr) -> sp.Expr:
    if argument.is_Atom:
        return argument
    inverse = any(not (node.exp.is_Integer and node.exp > 0) for node in argument.atoms(sp.Pow))
    if inverse and argument.count_ops() <= _OPERATIONS:
        try:
            top, bottom = sp.fraction(sp.cancel(sp.together(argument)))
            return sp.expand(sp.expand(top) / bottom)
        except sp.PolynomialError:  # Piecewise
            return argument
    return sp.expand(argument)


# --- quotients

_TERMS = 200_000  # most terms of a product
_DIGITS = 4_000_000  # most digits of all coefficients of a power
Quotient = tuple[Any, Any]  # numerator and denominator without a common factor


def ring_of(generators: Sequence[sp.Symbol]) -> Any:
    """Return FLINT's ring of polynomials over the rationals in the generators, in their order."""
    return fmpq_mpoly_ctx.get([f"g{i}" for i in range(len(generators))] or ["g"], Ordering.degrevlex)


def quotients(expressions: Iterable[sp.Expr], generators: Sequence[sp.Symbol], ring: Any) -> list[Quotient]:
    """Return each expression, a rational function of the generators, as a pair (numerator, denominator). Raises:
    `TooLarge`; `ZeroDivisionError` for a denominator that is zero; `NoTape` for other functions."""
    program = tape(expressions, generators)
    values, one = list[Quotient](), ring.constant(1)
    for op, places, value in program.instructions:
        args = [values[i] for i in places]
        if op == "symbol":
            values.append((ring.gens()[value], one))
        elif op == "number":
            values.append((ring.constant(fmpq(value.numerator, value.denominator)), one))
        elif op in ("add", "mul"):
            values.append(add(*args) if op == "add" else multiply(*args))
        elif op == "power":
            top, bottom = args[0] if value >= 0 else args[0][::-1]
            if bottom.is_zero():
                raise ZeroDivisionError
            values.append((power(top, abs(value)), power(bottom, abs(value))))
        else:
            raise NoTape(op, "a rational function", f"there is no rule for {op}")
    return [values[i] for i in program.outputs]


def add(one: Quotient, other: Quotient) -> Quotient:
    """Return the sum a/b + c/d of two quotients, without common factors. Raises: `TooLarge`."""
    (a, b), (c, d) = one, other
    if b == d:
        return _cancelled(a + c, b)
    shared = b.gcd(d)
    to_a, to_c = d / shared, b / shared
    return _cancelled(times(a, to_a) + times(c, to_c), times(b, to_a))


def multiply(one: Quotient, other: Quotient) -> Quotient:
    """Return the product a/b c/d of two quotients, without common factors. Raises: `TooLarge`."""
    (a, b), (c, d) = one, other
    (a, d), (c, b) = _cancelled(a, d), _cancelled(c, b)
    return times(a, c), times(b, d)


def partial(value: Quotient, generator: int) -> Quotient:
    """Return the partial derivative of a quotient by the generator of index `generator`. Raises: `TooLarge`."""
    top, bottom = value
    if bottom.is_constant():
        return top.derivative(generator) / bottom, bottom.context().constant(1)
    up = times(top.derivative(generator), bottom) - times(top, bottom.derivative(generator))
    return _cancelled(up, times(bottom, bottom))


def times(a: Any, b: Any) -> Any:
    """Return the product a b of two polynomials. Raises: `TooLarge`."""
    if len(a) * len(b) > _TERMS:
        raise TooLarge("a product")
    return a * b


def power(base: Any, exponent: int) -> Any:
    """Return the power base^exponent of a polynomial. Raises: `TooLarge`."""
    if len(base) > 1:  # a bound on the number of terms, before the power is formed
        terms = comb(len(base) + exponent - 1, exponent) if exponent < _TERMS else _TERMS + 1
        if terms > _TERMS or terms * exponent > _DIGITS:
            raise TooLarge("a power")
    return base**exponent


def _cancelled(top: Any, bottom: Any) -> Quotient:
    if bottom.is_constant():
        return top, bottom
    shared = top.gcd(bottom)
    return top / shared, bottom / shared


# --- fields


@dataclass(frozen=True)
class Root:
    """A generator g with the equation g^degree = value, by its `index`. `rational`: whether g replaces a symbol s,
    which is s = (g^q - r)/c for g^q = c s + r."""

    index: int
    degree: int
    value: Quotient
    rational: bool


@dataclass(frozen=True)
class Field:
    """A field of quotients of polynomials. `generators` of its polynomial `ring`: symbols, then functions such as
    roots; `meaning`: each generator as an expression in the symbols.

    `angles`: the angle m of each generator tan(m/2), by its index; `exponents`: the m of each generator exp(m);
    `roots`: the generators with an equation g^q = value, or that replace a symbol.
    """

    generators: tuple[sp.Symbol, ...]
    meaning: tuple[sp.Expr, ...]
    ring: Any
    roots: tuple[Root, ...]
    angles: Mapping[int, sp.Expr]
    exponents: Mapping[int, sp.Expr]

    @property
    def relations(self) -> tuple[Root, ...]:
        """Return the roots g^q = value that replace no symbol, inner roots before the roots that contain them."""
        return tuple(root for root in self.roots if not root.rational)

    def expression(self, polynomial: Any) -> sp.Expr:
        """Return a polynomial in the generators as a SymPy expression in symbols and functions."""
        value, highest = written(polynomial, self.meaning), polynomial.degrees()
        return sp.expand(value) if any(highest[root.index] for root in self.roots) else value

    def kernels(self, polynomial: Any) -> bool:
        """Return whether the polynomial contains a generator that is a function, such as exp(m) or a root."""
        return any(d and g.is_Dummy for d, g in zip(polynomial.degrees(), self.generators, strict=False))


def written(polynomial: Any, values: Sequence[sp.Expr]) -> sp.Expr:
    """Return a polynomial as a SymPy expression, with `values` in place of the generators, one for each."""
    terms = (
        sp.Mul(number(c), *(v ** int(k) for v, k in zip(values, powers, strict=False) if k))
        for powers, c in polynomial.terms()
    )
    return sp.Add(*terms)


def number(coefficient: Any) -> sp.Rational:
    """Return a rational coefficient of FLINT as SymPy's rational."""
    return sp.Rational(int(coefficient.p), int(coefficient.q))


def field(writer: Writer, expressions: Sequence[sp.Expr]) -> tuple[Field, list[Quotient]]:
    """Return the field of quotients that contains expressions from `writer.write`, and the expressions as its elements.
    Raises: `TooLarge`; `ZeroDivisionError` for a division by 0; `NoTape` for an unknown function."""
    right = [relation.value for relation in writer.relations]
    symbols = {s for e in (*expressions, *right) for s in e.free_symbols if not s.is_Dummy}
    keys = {dummy: key for key, dummy in writer.kernels.items()}
    generators = (*sorted(symbols, key=str), *keys)
    place = {g: k for k, g in enumerate(generators)}
    ring = ring_of(generators)
    replaced, rational = _replaced(writer.relations)
    as_quotients = quotients([*(e.xreplace(replaced) for e in expressions), *right], generators, ring)
    inner = quotients([e.xreplace(replaced) for e in right], generators, ring)
    roots = (
        Root(place[r.generator], r.degree, plain if r.generator in rational else value, r.generator in rational)
        for r, plain, value in zip(writer.relations, as_quotients[len(expressions) :], inner, strict=True)
    )
    functions: dict[type, Callable[..., sp.Expr]] = {
        Exp: lambda m, unit: sp.exp(m * unit),
        Half: lambda m, unit: sp.tan(m * unit / 2),
    }
    meaning = {g: functions[type(key)](*key.args) if type(key) in functions else key for g, key in keys.items()}
    result = Field(
        generators=generators,
        meaning=tuple(meaning.get(g, g) for g in generators),
        ring=ring,
        roots=tuple(roots),
        angles={place[g]: key.args[0] * key.args[1] for g, key in keys.items() if isinstance(key, Half)},
        exponents={place[g]: key.args[0] * key.args[1] for g, key in keys.items() if isinstance(key, Exp)},
    )
    return result, as_quotients[: len(expressions)]


def _replaced(relations: Sequence[Relation]) -> tuple[dict[sp.Symbol, sp.Expr], set[sp.Symbol]]:
    """Return the values (g^q - r)/c of the symbols s that roots g^q = c s + r replace, by symbol, and the set of these
    roots g."""
    replacements: dict[sp.Symbol, sp.Expr] = {}
    roots: set[sp.Symbol] = set()
    for relation in relations:
        value = sp.expand(relation.value.xreplace(replacements))
        symbols = sorted((s for s in value.free_symbols if not s.is_Dummy), key=str)
        s = next((s for s in symbols if value.diff(s).is_Rational), None)
        if s is not None:
            new = {s: sp.expand(s + (relation.generator**relation.degree - value) / value.diff(s))}
            replacements = {old: sp.expand(e.xreplace(new)) for old, e in replacements.items()} | new
            roots.add(relation.generator)
    return replacements, roots


# --- relations


def vanishes(expression: sp.Expr) -> bool | None:
    """Return True for an expression of exact numbers that is zero wherever it is defined, False for a rational function
    of symbols that is defined and not zero on a dense open set, None where undecided.

    Source: normal forms of rational functions over a tower of radicals; B. F. Caviness, R. J. Fateman, "Simplification
    of radical expressions", SYMSAC 1976.
    """
    writer = Writer()
    try:
        writer.measure(expression)
        parts = [writer.write(expression), *(relation.value for relation in writer.relations)]
        read = {s for part in parts for s in part.free_symbols} | {r.generator for r in writer.relations}
        every = (*sorted(expression.free_symbols, key=str), *writer.kernels.values())
        generators = [s for s in every if s in read]
        (top, _), *values = quotients(parts, generators, ring_of(generators))
        for relation, value in reversed(list(zip(writer.relations, values, strict=True))):
            (top,), _ = reduced([top], generators.index(relation.generator), relation.degree, value)
    except (TooLarge, ZeroDivisionError, NoTape):
        return None
    if top.is_zero():
        return True
    return False if read <= expression.free_symbols else None


def reduced(row: list[Any], index: int, degree: int, value: Quotient) -> tuple[list[Any], int]:
    """Return the polynomials `row` times b^t, with g^degree replaced by `value` = a/b, for the generator g of that
    index; and the power t, which clears the denominators b. Raises: `TooLarge`."""
    ring = row[0].context()
    most = max((int(powers[index]) // degree for top in row for powers in top.monoms()), default=0)
    if not most:
        return row, 0
    weights = [times(power(value[0], t), power(value[1], most - t)) for t in range(most + 1)]
    replaced = []
    for top in row:
        layers: dict[int, dict[tuple[int, ...], Any]] = {}
        for powers, coefficient in top.to_dict().items():
            t, remainder = divmod(int(powers[index]), degree)
            exponents = tuple(remainder if i == index else int(k) for i, k in enumerate(powers))
            layers.setdefault(t, {})[exponents] = coefficient
        replaced.append(
            sum((times(ring.from_dict(terms), weights[t]) for t, terms in layers.items()), ring.constant(0))
        )
    return replaced, most


Box = Mapping[sp.Symbol, tuple[Any, Any]]

_QUICK, _PATIENT = 4, 12  # points
_BITS, _MORE_BITS = 64, (256, 1024, 4096)
# Ranges of points for a symbol without a declared one, a positive one first, for logarithms and roots.
_SCALES = ((Fraction(1, 7), Fraction(2)), (Fraction(-3), Fraction(3)), (Fraction(0), Fraction(40)))
_GRID = 997
# Values to put in for symbols that do not matter.
_NUMBERS = ((0,), (1,), (2, 1, 3), (sp.Rational(-1, 2), 3, 5))
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds)


def is_zero(expression: sp.Expr, box: Box | None = None) -> bool | None:
    """Return True if the expression is defined somewhere and 0 at every real point where it is defined, False if not,
    None if unknown. `box`: closed ranges of symbols, also infinite; a symbol without one may have any value, one whose
    ends are equal has that value."""
    expression = _settled(expression, box)
    if expression.is_Rational or expression.has(*_INFINITE):
        return bool(expression == 0) if expression.is_Rational else None
    symbols = sorted(expression.free_symbols, key=str)
    try:
        program = tape((expression,), symbols)
    except NoTape:
        return True if vanishes(expression) else None
    points = list(_points(symbols, box, _PATIENT))
    quick = [values(program, point, _BITS)[0] for point in points[:_QUICK]]
    if any(_not_zero(ball) for ball in quick):
        return False
    answer, finite = vanishes(expression), any(ball.is_finite() for ball in quick)
    if answer is False or (answer and finite):
        return answer
    for bits in _MORE_BITS:
        balls = [values(program, point, bits)[0] for point in points]
        if any(_not_zero(ball) for ball in balls):
            return False
        finite = finite or any(ball.is_finite() for ball in balls)
        if answer and finite:
            return True
    return None


def depends(expression: sp.Expr, symbol: sp.Symbol, box: Box | None = None) -> bool | None:
    """Return whether the value of the expression depends on the symbol, None where unknown; terms that cancel do not
    count. `box`: closed ranges of symbols, of which those with equal ends are numbers."""
    proved, unknown = dependence(expression, (symbol,), box)
    return True if proved else None if unknown else False


def dependence(
    expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None
) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...]]:
    """Return the symbols on which the value of the expression is proved to depend, and those for which this is unknown.

    The value depends on no other symbol s: e(.., s, ..) - e(.., t, ..) is 0 by exact algebra with s and t as two
    symbols. A derivative of 0 would not prove this: atan(x) + atan(1/x) jumps.
    """
    expression = _settled(expression, box)
    present = [s for s in symbols if s in expression.free_symbols]
    changing = _changing(expression, present, box) if present else set()
    proved: list[sp.Symbol] = []
    unknown: list[sp.Symbol] = []
    for s in present:
        answer: bool | None = False
        if s not in changing:
            t = sp.Dummy(s.name, real=s.is_real)
            wider = {**(box or {}), **({t: box[s]} if box and s in box else {})}
            answer = is_zero(expression - expression.xreplace({s: t}), wider)
        if not answer:
            (proved if answer is False else unknown).append(s)
    return tuple(proved), tuple(unknown)


def reads(expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None) -> tuple[sp.Symbol, ...]:
    """Return the symbols, in their order, on which the value of the expression depends or may depend on the box."""
    symbols = tuple(symbols)
    relevant = {s for part in dependence(expression, symbols, box) for s in part}
    return tuple(s for s in symbols if s in relevant)


def free_of(expression: sp.Expr, symbols: Iterable[sp.Symbol], box: Box | None = None) -> sp.Expr:
    """Return an equal expression with a number, if possible 0, in place of each of the `symbols` on which the value is
    proved not to depend."""
    idle = [s for s in symbols if s in expression.free_symbols and depends(expression, s, box) is False]
    for numbers in _NUMBERS if idle else ():
        plain = substituted(expression, {s: sp.sympify(numbers[i % len(numbers)]) for i, s in enumerate(idle)})
        if plain is not None and not plain.has(*_INFINITE) and is_zero(expression - plain, box):
            return plain
    return expression


def _settled(expression: sp.Expr, box: Box | None) -> sp.Expr:
    point = {s: sp.Rational(str(low)) for s, (low, high) in (box or {}).items() if low == high}
    return exact(substituted_where_real(expression, point) if point else sp.sympify(expression))


def _changing(expression: sp.Expr, symbols: Sequence[sp.Symbol], box: Box | None) -> set[sp.Symbol]:
    every = sorted(expression.free_symbols, key=str)
    try:
        program = tape((expression,), every)
    except NoTape:
        return set()
    changing = set()
    for point, other in pairwise(list(_points(every, box, _QUICK + 1))):
        before = values(program, point, _BITS)[0]
        for s in symbols:
            neighbour = [b if t == s else a for t, a, b in zip(every, point, other, strict=True)]
            if s not in changing and _not_zero(before - values(program, neighbour, _BITS)[0]):
                changing.add(s)
    return changing


def _not_zero(ball: Any) -> bool:
    return bool(ball.is_finite() and not ball.contains(0))


def _points(symbols: Sequence[sp.Symbol], box: Box | None, count: int) -> Iterator[list[Fraction]]:
    draw = random.Random(1)
    for k in range(count):
        yield [
            low + (high - low) * Fraction(draw.randint(1, _GRID - 1), _GRID)
            for low, high in (_ends(s, box, k) for s in symbols)
        ]


def _ends(symbol: sp.Symbol, box: Box | None, k: int) -> tuple[Fraction, Fraction]:
    low, high = (box or {}).get(symbol, (-sp.oo, sp.oo))
    start, end = _SCALES[k % len(_SCALES)]
    unbounded = low == -sp.oo, high == sp.oo
    if all(unbounded):
        return start, end
    if unbounded[0]:
        return Fraction(str(high)) - (end - start), Fraction(str(high))
    return Fraction(str(low)), Fraction(str(low)) + (end - start) if unbounded[1] else Fraction(str(high))
