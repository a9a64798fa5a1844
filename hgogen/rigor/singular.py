"""Singularities of an expression on a box: where it may be undefined or not smooth, and removable singularities.

SymPy simplifies x/x to 1, which has a value where x/x has none: `lost_part` finds such parts of an expression that a
simplified one lacks. A Piecewise reads no branch of a false condition, and a Heaviside its value at 0 only there: the
expressions in them demand no value by themselves, and each of the two is one part.

Programs compute quotients without removable singularities: sin(x)/x is 1 at x = 0, and accurate to some ulp nearby.

A quotient g(x) = N(x)/x^m of a power series N = sum_k a_k x^k with a_0 = .. = a_(m-1) = 0 is

    g(x) = x^j (q_0 + q_1 x + .. + q_n x^n) + R    for |x| < r,    q_k = a_(m+j+k),  q_0 != 0,
    g(x) as written, or with sines of a/2, if that has fewer terms, for |x| >= r.

The a_k are exact. N consists of sums, products and powers of numbers, x and functions. A majorant M has the absolute
values of the numbers, and for each function the one with its absolute coefficients. The terms of M(r) beyond n bound R,
and n is the least number for which this bound is at most 2^-57 of q_0 x^j. r is the number of a short list at which
both forms and their derivatives lose the least to cancellation, the forms at most a factor of 4.

max(e, 0)^p with p < 1 is computed as e^p where e > 0 and 0 elsewhere, so that its slope is 0 where e < 0.

The derivative of e^p, 0 < p < 1, has no bound at e = 0, as that of sign(q) |q|^(1/2) for the flow through an orifice.
The power is computed as it is written, while its derivative is that of `with_limited_slopes`: the slope of the chord,

    e max(e, f)^(p - 1),   f = 2^-10 of the largest e on the box

below f. This slope is 32 times that at the largest e for p = 1/2. With a tiny f, the derivative of e^p, p > 1, is
computed without 0 times infinity.

x^p log(c x), p > 0, is computed with its limit 0 at x = 0: below the smallest normal float the logarithm is constant.
So is x^p log(x^2) = 2 x^p log |x|.

`one_sided` removes kinks and jumps whose side the box decides: |x| is x where x >= 0. Sides are proved in exact or
outward-rounded arithmetic, on the closed box, and removed parts are proved to be finite real numbers there: max(sqrt(x
- 1), 5) remains where x may be below 1, since it has no value there, and |x|/x where x may be 0.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import fsum, inf, prod
from typing import Any

import sympy as sp
from flint import arb, ctx, fmpq, fmpq_series

from hgogen.check import Verdict
from hgogen.rigor import definite
from hgogen.rigor.bounds import clamped_cells, contains_zero, enclose, nonzero, rational
from hgogen.rigor.box import EVERYTHING, STRANGE, Box, End, exact, sides
from hgogen.rigor.lookup import Cells, Table, applied, replaced
from hgogen.rigor.search import is_defined
from hgogen.rigor.tape import Norm, NoTape, off_zero, rooted, shared, signed, squares, unsigned, with_norms
from hgogen.sentence import Reason, because

POSITIVE, NONZERO = "{of} > 0", "{of} != 0"


@dataclass(frozen=True)
class Condition:
    """A condition under which a subexpression is smooth: a `relation` such as "{of} != 0", about the expression
    `of`."""

    relation: str
    of: sp.Expr

    @property
    def reason(self) -> Reason:
        """Return the condition in words, such as "u != 0"."""
        return because(self.relation, of=self.of)

    def __str__(self) -> str:
        return str(self.reason)

    @property
    def failure(self) -> Reason:
        """Return the place where the condition fails, in words such as "at u = 0"."""
        if self.relation == NONZERO:
            return because("at {of} = 0", of=self.of)
        return because("unless {condition}", condition=self.reason)


# index of the argument, an interval of it without singular points, the condition (for tan(m) on cos(m))
_SINGULAR: dict[type, tuple[int, End, End, str]] = {
    sp.log: (0, 0, math.inf, POSITIVE),
    sp.tan: (0, Fraction(-3, 2), Fraction(3, 2), NONZERO),
    **dict.fromkeys((sp.asin, sp.acos, sp.atanh), (0, -1, 1, "-1 < {of} < 1")),
    sp.acosh: (0, 1, math.inf, "{of} > 1"),
    sp.atan2: (1, 0, math.inf, POSITIVE),
}
# Functions defined everywhere, some of which jump.
_ENTIRE = (
    *(sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.atan, sp.asinh, sp.exp, sp.Abs),
    *(sp.sign, sp.floor, sp.ceiling, sp.frac, sp.Heaviside, sp.Piecewise),
)


def singular(expressions: Iterable[sp.Expr], box: Box) -> dict[sp.Expr, Condition]:
    """Return the powers and functions in the expressions that may be singular on the box, each with the condition under
    which it is not."""
    nodes = {node for expression in expressions for node in expression.atoms(sp.Pow, sp.Function)}
    conditions = {node: _condition(node, box) for node in sorted(nodes, key=str)}
    return {node: condition for node, condition in conditions.items() if condition}


def reasons(conditions: Iterable[Condition]) -> tuple[Reason, ...]:
    """Return each condition in words, such as "u != 0"."""
    return tuple(each.reason for each in conditions)


def minimal(conditions: Iterable[Condition]) -> tuple[Condition, ...]:
    """Return the distinct conditions, ordered by their texts, without u != 0 where u > 0 is among them."""
    every = sorted(set(conditions), key=str)
    positive = {each.of for each in every if each.relation == POSITIVE}
    return tuple(each for each in every if each.relation != NONZERO or each.of not in positive)


def _condition(node: sp.Expr, box: Box) -> Condition | None:
    if type(node) in _SINGULAR:
        index, low, high, relation = _SINGULAR[type(node)]
        argument = node.args[index]
        least, most = enclose(argument, box)
        clear = low < least and (most < high or high == math.inf)
        clear = clear or (isinstance(node, sp.atan2) and not contains_zero(enclose(node.args[0], box)))
        return None if clear else Condition(relation, sp.cos(argument) if isinstance(node, sp.tan) else argument)
    if not isinstance(node, sp.Pow):
        return None if type(node) in _ENTIRE or isinstance(node, Table) else Condition("{of} is smooth", node)
    base = enclose(node.base, box)
    if node.exp.is_Integer:
        return Condition(NONZERO, node.base) if node.exp < 0 and contains_zero(base) else None
    if base[0] > 0 or (node.exp.is_Rational and node.exp > 0 and base[0] >= 0):
        return None
    return Condition(POSITIVE, node.base)


def off_origin(angle: sp.atan2) -> Condition:
    """Return the condition under which atan2(y, x) has a value and is smooth up to whole turns: x^2 + y^2 != 0."""
    return Condition(NONZERO, sp.Add(*(part**2 for part in angle.args)))


# --- parts lost by simplification

_CHOOSING = (sp.Piecewise, sp.Heaviside)


def lost_part(before: Iterable[sp.Expr], after: Iterable[sp.Expr], box: Box) -> sp.Expr | None:
    """Return a power or function of the expressions `before` that is not proved to be a finite real number on the box
    and is missing in `after`, as after a simplification; None if there is none.

    It is not missing where `after` has an expression that is undefined at the same points, as 1/x**2 for 1/x. It is
    missing where it vanishes by a one-point range of the box, as log(x) in k log(x) with k = 0.
    """
    every = tuple(dict.fromkeys(part for row in before for part in parts(row)))
    rows = tuple(sides(exact(row), box)[0] for row in after)
    remaining = {part for row in rows for part in parts(row)}
    needs = singular((*every, *rows), box)
    # nodes that are undefined where their condition fails; asin(1) and atan2(1, 0) have a value
    endless = {node for node in remaining if isinstance(node, (sp.log, sp.tan, sp.atanh))}
    endless |= {node for node in remaining if node.is_Pow and node.exp.is_Rational and node.exp.is_negative}
    poles = {needs[part] for part in endless if part in needs}

    def shares(part: sp.Expr) -> bool:
        return part in remaining or singular((part,), box).get(part) in poles

    read = (part for part in every if _demands(part, needs))
    return next((part for part in read if not (shares(sides(exact(part), box)[0]) or is_defined(part, box))), None)


def possibly_undefined(expressions: Iterable[sp.Expr], box: Box) -> tuple[sp.Expr, ...]:
    """Return the powers and functions in the expressions that are not proved to be finite real numbers on the whole
    box."""
    every = tuple(dict.fromkeys(part for e in expressions for part in parts(e)))
    needs = singular(every, box)
    return tuple(part for part in every if _demands(part, needs) and not is_defined(part, box))


def conditions(expressions: Iterable[sp.Expr], box: Box) -> tuple[Condition, ...]:
    """Return the conditions, such as u != 0 for 1/u, under which the expressions are finite real numbers on the box."""
    necessary = set[Condition]()
    for part in possibly_undefined(expressions, box):
        needs = [] if isinstance(part, _CHOOSING) else [*singular((part,), box).values()]
        needs = [off_origin(part)] if isinstance(part, sp.atan2) else needs  # it has a value on its cut
        necessary.update(needs or (Condition("{of} has a value", part),))
    return minimal(necessary)


def parts(e: sp.Expr) -> Iterator[sp.Expr]:
    """Yield the powers and functions in an expression, outermost first, except those inside a Piecewise or
    Heaviside."""
    walk = sp.preorder_traversal(e)
    for node in walk:
        if isinstance(node, (sp.Pow, sp.Function)):
            yield node
        if isinstance(node, _CHOOSING):
            walk.skip()


def mapped_parts(expressions: Iterable[sp.Expr], put: Callable[[sp.Expr], sp.Expr]) -> Iterator[sp.Expr]:
    """Yield put(part) for each power and function in the expressions. SymPy may simplify a substitution in the whole
    expression: (a - b)/(2 a - 2 b) becomes 1/2 for a = b + w. For a Piecewise, put(part) of its inner parts follows
    where put(Piecewise) has lost them."""
    for part in dict.fromkeys(part for e in expressions for part in parts(e)):
        whole = put(part)
        yield whole
        if isinstance(part, _CHOOSING):
            within = (put(node) for node in part.atoms(sp.Pow, sp.Function) - {part})
            yield from (node for node in within if not whole.has(node))


def _demands(part: sp.Expr, needs: Mapping[sp.Expr, Condition]) -> bool:
    if not isinstance(part, _CHOOSING):
        return part in needs
    ends = not isinstance(part, sp.Piecewise) or part.args[-1].cond == sp.true
    return part in needs or not ends or any(node in needs for node in part.atoms(sp.Pow, sp.Function))


_RADII = tuple(map(sp.Rational, ("1/4", "1/2", "3/4", "1", "3/2", "2", "5/2", "3")))
_ORDER, _BITS, _DIGITS = 56, 57, 400  # order of the series; bits of accuracy of the remainder; bits of its bound
_LOSS = 4  # largest ratio of the terms' absolute values to their sum
_SUM_OPERATIONS = 200  # most operations of a sum that is rewritten
_X, _Z = sp.Dummy("x", real=True), sp.Dummy("z", real=True)
_ROOT = sp.Dummy("r", positive=True)


# functions of a series or a ball, each with its majorant, the function with absolute coefficients; log is log(1 + x)
_FUNCTIONS: dict[type, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    sp.exp: (lambda x: x.exp(), lambda x: x.exp()),
    sp.sin: (lambda x: x.sin(), lambda x: x.sinh()),
    sp.cos: (lambda x: x.cos(), lambda x: x.cosh()),
    sp.tan: (lambda x: x.tan(), lambda x: _tangent(x)),
    sp.sinh: (lambda x: x.sinh(), lambda x: x.sinh()),
    sp.cosh: (lambda x: x.cosh(), lambda x: x.cosh()),
    sp.tanh: (lambda x: x.tanh(), lambda x: _tangent(x)),
    sp.atan: (lambda x: x.atan(), lambda x: x.atanh()),
    sp.asin: (lambda x: x.asin(), lambda x: x.asin()),
    sp.log: (lambda x: (1 + x).log(), lambda x: -(1 - x).log()),
}


def _tangent(x: Any) -> Any:
    return x.tan() if isinstance(x, fmpq_series) or x < 1.5 else arb("nan")


class _NoSeries(Exception):
    """The error that an expression has no power series with rational coefficients at 0."""


class Resolved(sp.Piecewise):  # type: ignore[misc]
    """A quotient g(x) with its removable singularity replaced: a Piecewise of a polynomial where |x| is small, else
    g(x) as written."""

    @property
    def reads(self) -> Iterator[sp.Expr]:
        """Yield the expressions from which the value is computed: the polynomial in x, and the powers and functions in
        g(x) that do not divide by x."""
        (within, inside), (beyond, _) = self.args
        factors = [f.args[0] if isinstance(f, sp.Abs) else f for f in sp.Mul.make_args(inside.lhs)]  # |3 x| is 3 |x|
        base = sp.Mul(*factors)
        parts = (base, *factors, *(each for f in factors for each in sp.Mul.make_args(f)))
        divisors = {sign * part for each in parts for part in (each, each.primitive()[1]) for sign in (1, -1)}
        yield within
        for part in beyond.atoms(sp.Pow, sp.Function):
            if not (part.is_Pow and part.exp.is_Rational and part.base in divisors):
                yield part


@dataclass(frozen=True)
class _Term:
    """A term number h(x)/x^power of a quotient, with a rational `number`."""

    number: sp.Rational
    power: int
    h: sp.Expr

    @property
    def whole(self) -> sp.Expr:
        return self.number * self.h / _X**self.power


@dataclass(frozen=True)
class _Regular:
    """A quotient with its removable singularity at 0 replaced: a polynomial with the `coefficients` for |x| < `radius`,
    else `beyond`, the quotient as written."""

    coefficients: tuple[sp.Rational, ...]
    radius: sp.Rational
    beyond: sp.Expr

    def at(self, base: sp.Expr) -> sp.Expr:
        even, square = not any(self.coefficients[1::2]), base**2
        if even and not square.is_Pow and any(root.is_Pow and root.exp == sp.S.Half for root in sp.Mul.make_args(base)):
            within, inside = _horner(self.coefficients[::2], square), square < self.radius**2
        else:
            first = next(k for k, c in enumerate(self.coefficients) if c)
            step = 2 if not any(self.coefficients[first + 1 :: 2]) else 1
            inner = _horner(self.coefficients[first::step], base**step)
            within, inside = base**first * inner, sp.StrictLessThan(sp.Abs(base), self.radius)
        return Resolved((within, inside), (self.beyond.xreplace({_X: base}), True), evaluate=False)


def _horner(coefficients: Sequence[sp.Rational], x: sp.Expr) -> sp.Expr:
    """Return the polynomial c_0 + x (c_1 + x (..)) at x."""
    total: sp.Expr = sp.S.Zero
    for c in reversed(coefficients):
        total = c + x * total
    return total


@lru_cache(maxsize=1024)  # each stage of a step needs the same rows
def resolved(expression: sp.Expr) -> sp.Expr:
    """Return the expression with removable singularities of quotients replaced (`Resolved`), and max(e, 0)^p, p < 1,
    written as a Piecewise."""
    if not any(_is_ramp(node) or _divides(node) for node in expression.atoms(sp.Pow)):
        return expression
    if isinstance(expression, sp.Pow) and _is_ramp(expression):
        (e,) = (each for each in expression.base.args if each != 0)
        return sp.Piecewise((resolved(e) ** expression.exp, e > 0), (0, True), evaluate=False)
    if isinstance(expression, (sp.Add, sp.Mul)) and expression.count_ops() <= _SUM_OPERATIONS:
        for base in _bases(expression):
            without = _without(expression, base)
            if without is not None:
                return resolved(without)
    if isinstance(expression, sp.Piecewise) or not expression.args:
        return expression
    args = [resolved(each) if isinstance(each, sp.Expr) else each for each in expression.args]
    return expression if args == list(expression.args) else expression.func(*args)


def _is_ramp(node: sp.Pow) -> bool:
    base, p = node.base, node.exp
    return bool(
        isinstance(base, sp.Max) and len(base.args) == 2 and sp.S.Zero in base.args and p.is_Rational and 0 < p < 1
    )


def _divides(node: sp.Pow) -> bool:
    return bool(node.exp.is_Rational and node.exp.is_negative and node.base.free_symbols)


def _bases(expression: sp.Expr) -> list[sp.Expr]:
    roots = {node.base for node in expression.atoms(sp.Pow) if node.exp.is_Rational and node.exp.q == 2}
    bases = dict[sp.Expr, None]()
    for term in sp.Add.make_args(expression):
        for factor in sp.Mul.make_args(term):
            if isinstance(factor, sp.Pow) and _divides(factor) and factor.exp.q in (1, 2):
                bases[sp.sqrt(factor.base) if factor.base in roots else factor.base] = None
    return sorted(bases, key=sp.default_sort_key)


def _without(expression: sp.Expr, base: sp.Expr) -> sp.Expr | None:
    summands, groups = list[sp.Expr](), dict[sp.Expr, list[_Term]]()
    for term in sp.Add.make_args(expression):
        coefficient, f = _in_x(term, base).as_independent(_X, as_Add=False)
        (number, others), f = coefficient.as_coeff_Mul(), exact(f)
        power = -f.as_powers_dict().get(_X, sp.S.Zero)
        if power.is_Integer and power > 0 and exact(number).is_Rational:
            h, separate = _parted(f * _X**power)
            group = others * separate.xreplace({_X: base})
            groups.setdefault(group, []).append(_Term(exact(number), int(power), h))
        else:
            summands.append(term)
    quotients = {others: _scaled(tuple(terms)) for others, terms in groups.items()}
    regular = {others: _regular(terms) for others, (terms, _) in quotients.items()}
    if not any(regular.values()):
        return None
    for others, each in regular.items():
        terms, c = quotients[others]
        scaled, others = c * base, others * (1 if c.is_Rational else c ** terms[0].power)
        back = each.at(scaled) if each else sp.Add(*(t.whole for t in terms)).xreplace({_X: scaled})
        summands.append(others * back)
    return sp.Add(*summands)


def _scaled(terms: tuple[_Term, ...]) -> tuple[tuple[_Term, ...], sp.Expr]:
    """Return the terms in x rewritten as terms in c x, and c. It is 1 if the sum of the terms is regular at 0, else c x
    is the argument of a function. If c is not rational, all terms must have one power and depend on x by c x only."""
    if _regular(terms):
        return terms, sp.S.One
    for c in dict.fromkeys(f.args[0].coeff(_X) for term in terms for f in term.h.atoms(*_FUNCTIONS)):
        if c == 0 or c.has(_X):
            continue
        if c.is_Rational:
            put = tuple(_Term(t.number * c**t.power, t.power, t.h.xreplace({_X: _X / c})) for t in terms)
        else:
            put = tuple(_Term(t.number, t.power, t.h.xreplace({c * _X: _Z, -c * _X: -_Z})) for t in terms)
            if any(t.h.has(_X) for t in put) or len({t.power for t in put}) > 1:
                continue
            put = tuple(_Term(t.number, t.power, t.h.xreplace({_Z: _X})) for t in put)
        if _regular(put):
            return put, c
    return terms, sp.S.One


def _parted(h: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    factors = sp.Mul.make_args(h)
    several = [f for f in factors if f.free_symbols - {_X}]
    return (sp.Mul(*several), sp.Mul(*(f for f in factors if f not in several))) if several else (h, sp.S.One)


def _in_x(term: sp.Expr, base: sp.Expr) -> sp.Expr:
    if base.is_Pow and base.exp == sp.S.Half:
        return term.xreplace({base.base: _ROOT**2}).xreplace({_ROOT: _X})
    return term.xreplace({base: _X, -base: -_X})


@lru_cache(maxsize=256)
def _regular(terms: tuple[_Term, ...]) -> _Regular | None:
    """Return the sum of the terms h(x)/x^m with its singularity at 0 replaced; None if it is not removable, or no
    radius suits."""
    if any(term.h.free_symbols - {_X} for term in terms) or not any(term.h.atoms(sp.Function) for term in terms):
        return None
    m = max(term.power for term in terms)
    try:
        a = _series(terms, m)
    except _NoSeries:
        return None
    if any(a[:m]) or not any(a):
        return None
    whole = sp.expand_mul(sp.Add(*(t.whole for t in terms)))
    beyond = min((whole, _halved(whole)), key=lambda e: len(sp.Add.make_args(e)))
    each: list[tuple[float, _Regular]] = []
    for radius in _RADII:
        with ctx.workprec(_DIGITS):
            count = _enough(terms, a[m:], m, radius)
        coefficients = tuple(sp.Rational(definite.fraction(c)) for c in a[m : m + count])
        polynomial = sp.Add(*(c * _X**k for k, c in enumerate(coefficients)))
        forms = (polynomial, beyond)
        if count and max(_loss(form, radius) for form in forms) <= _LOSS:
            loss = max(_loss(form.diff(_X), radius) for form in forms)
            each.append((loss, _Regular(coefficients, radius, beyond)))
    return min(each, key=lambda pair: pair[0])[1] if each else None


def _halved(whole: sp.Expr) -> sp.Expr:
    """Return a sum rewritten with cos a = 1 - 2 sin(a/2)^2, cosh a = 1 + 2 sinh(a/2)^2, exp a = 1 + 2 exp(a/2)
    sinh(a/2)."""
    put = whole.replace(sp.cos, lambda a: 1 - 2 * sp.sin(a / 2) ** 2)
    put = put.replace(sp.exp, lambda a: 1 + 2 * sp.exp(a / 2) * sp.sinh(a / 2))
    return sp.expand_mul(put.replace(sp.cosh, lambda a: 1 + 2 * sp.sinh(a / 2) ** 2))


def _enough(terms: Sequence[_Term], q: Sequence[fmpq], m: int, radius: sp.Rational) -> int:
    """Return how many coefficients q_0, q_1, .. of the series x^j (q_0 + q_1 x + ..) of the terms' sum are needed,
    so that for |x| < radius the remainder is at most 2^-57 of the first nonzero term; 0 if no number is proved to
    suffice."""
    r = arb(definite.number(radius))
    try:
        whole, sizes = _numerator(terms, m, r, majorant=True), _series(terms, m, majorant=True)
    except _NoSeries:
        return 0
    first = next(k for k, c in enumerate(q) if c)
    least = arb(abs(q[first])) * r**first / 2**_BITS
    residual = whole - sum((arb(sizes[k]) * r**k for k in range(m)), arb(0))
    for k in range(_ORDER - m):
        residual = residual - arb(sizes[m + k]) * r ** (m + k)
        if k >= first and residual / r**m <= least:
            return k + 1
    return 0


def _loss(whole: sp.Expr, radius: sp.Rational) -> float:
    """Return the cancellation sum |t_i| / |sum t_i| of the terms t_i of the sum `whole`, the larger one of x = radius
    and -radius."""
    terms = sp.lambdify(_X, sp.Add.make_args(sp.expand_mul(whole)), "math")
    sizes = [(sum(map(abs, each)), abs(fsum(each))) for each in map(terms, (float(radius), -float(radius)))]
    return max(size / total if total else inf for size, total in sizes)


def _series(terms: Sequence[_Term], m: int, *, majorant: bool = False) -> list[fmpq]:
    """Return the first coefficients of x^m times the sum of the terms, or of a majorant: a series whose coefficients
    are at least as large in size."""
    before, ctx.cap = ctx.cap, _ORDER
    try:
        series = _numerator(terms, m, fmpq_series([0, 1], prec=_ORDER), majorant)
        return [series[k] for k in range(_ORDER)]
    finally:
        ctx.cap = before


def _numerator(terms: Sequence[_Term], m: int, x: Any, majorant: bool) -> Any:
    return sum((_at(term.number * term.h, x, majorant) * x ** (m - term.power) for term in terms), 0 * x)


def _at(e: sp.Expr, x: Any, majorant: bool) -> Any:
    if e.is_Rational:
        return 0 * x + definite.number(abs(e) if majorant else e)
    if e == _X:
        return x
    if e.is_Add:
        return sum((_at(part, x, majorant) for part in e.args), 0 * x)
    if e.is_Mul:
        return prod((_at(part, x, majorant) for part in e.args), start=1 + 0 * x)
    if e.is_Pow and e.exp.is_Integer and e.exp > 0:
        return _at(e.base, x, majorant) ** int(e.exp)
    if type(e) not in _FUNCTIONS:
        raise _NoSeries
    inner = _at(e.args[0] - (1 if isinstance(e, sp.log) else 0), x, majorant)
    try:
        value = _FUNCTIONS[type(e)][majorant](inner)
    except ValueError:  # the first coefficient is not the point of expansion
        raise _NoSeries from None
    if isinstance(value, arb) and not value.is_finite():
        raise _NoSeries
    return value


# --- powers times logarithms

LEAST = sp.Rational(1, 2**126)  # the smallest normal float


def with_limits(expression: sp.Expr) -> sp.Expr:
    """Return the expression with the limit 0 of b^p log(c b), p > 0, as the value at b = 0; where c b < 0 there is no
    value."""
    return _logs(expression, _limited)


def bounded_logs(expression: sp.Expr) -> sp.Expr:
    """Return the expression with each log(c b) in a product b^p log(c b), p > 0, replaced by an expression that is
    finite where the product has a limit."""
    return _logs(expression, lambda product, log, argument: product.xreplace({log: argument.bounded}))


@dataclass(frozen=True)
class _LogArgument:
    """The argument of a logarithm, b = `base`: c b or c/b; or |b| or an even power of b, with c = 1, if `even`."""

    base: sp.Expr
    c: sp.Expr
    even: bool

    @property
    def bounded(self) -> sp.Expr:
        """Return an expression that is finite exactly where c b >= 0 and c != 0; for all b if `even`."""
        if self.even:
            return sp.sqrt(sp.Abs(self.base))
        return sp.sqrt(self.c * self.base) + (0 if self.c.is_number else sp.log(self.c**2))


def _logs(expression: sp.Expr, put: Callable[[sp.Mul, sp.Expr, _LogArgument], sp.Expr]) -> sp.Expr:
    products = expression.atoms(sp.Mul) if expression.has(sp.log) else ()
    vanishing = {product: log for product in products if (log := _vanishing(product)) is not None}
    return expression.xreplace({product: put(product, *log) for product, log in vanishing.items()})


def _vanishing(product: sp.Mul) -> tuple[sp.Expr, _LogArgument] | None:
    """Return the factor log(c b) of a product that also has b^p, p > 0, and the argument of the logarithm; None if
    there is none."""
    powers = product.as_powers_dict()
    growing = [b for b, p in powers.items() if b.free_symbols and p.is_positive]
    growing += [b.args[0] for b in growing if isinstance(b, sp.Abs)]
    for factor in powers:
        if not isinstance(factor, sp.log) or powers[factor] != 1:
            continue
        e = factor.args[0]
        even = e.args[0] if isinstance(e, sp.Abs) or (e.is_Pow and e.exp.is_Integer and e.exp.is_even) else None
        if even is not None and e not in growing:
            if even in growing and (isinstance(e, sp.Abs) or e.exp > 0):
                return factor, _LogArgument(even, sp.S.One, True)
            continue
        for b in growing:
            c = next((c for c in (e / b, e * b) if not c.has(b) and not (c.free_symbols & b.free_symbols)), None)
            if c is not None:
                return factor, _LogArgument(b, c, False)
    return None


def _limited(product: sp.Mul, log: sp.Expr, argument: _LogArgument) -> sp.Expr:
    b, e = argument.base, log.args[0]
    if argument.even:
        power = e.exp if e.is_Pow else 1
        lowest, plain = (power * sp.log(x) for x in (LEAST, sp.Abs(b)))
        return sp.Piecewise(
            (product.xreplace({log: plain}), sp.Abs(b) > LEAST), (product.xreplace({log: lowest}), True)
        )
    if e == b:
        low = product.xreplace({log: sp.log(LEAST)})
        return sp.Piecewise((product, b > LEAST), (low, b >= 0), evaluate=False)
    low = product.xreplace({log: sp.log(sp.Abs(e.xreplace({b: LEAST})))})
    return sp.Piecewise((low, sp.And(sp.Abs(b) <= LEAST, argument.c * b >= 0)), (product, True), evaluate=False)


_KINDS = (sp.Abs, sp.Min, sp.Max, sp.sign, sp.Heaviside, sp.Piecewise, Table)
_OPERATIONS = 200  # most operations of an argument whose sign is proved
_BOXES = 60
TINY = sp.Rational(1, 2**60)  # of the largest e: below it programs take the slope of the chord of e^p, p > 1
_LEAST = sp.Rational(1, 2**120)  # least sum of squares whose root is computed, a float with the root 2^-60
CHORD = sp.Rational(1, 2**10)  # of the largest e: below it programs take the slope of the chord of e^p, p < 1
_SMALL = 2.0**-40  # sums of squares below it are scaled by a unit, of which `_LEAST` is a small part
_MOST = 60  # most halvings of the root of the unit, so that its inverse is a float


def one_sided(expression: sp.Expr, box: Box) -> sp.Expr:
    """Return the expression without the kinks of which only one side occurs on the box: |x| is x for x >= 0. Where the
    expression is defined on the box the result is equal."""
    return _visited(expression, box) if _has_kinks(expression) else expression


def _has_kinks(expression: sp.Expr) -> bool:
    return expression.has(*_KINDS) or any(rooted(node) for node in expression.atoms(sp.Pow))


def _visited(node: sp.Expr, box: Box) -> sp.Expr:
    if isinstance(node, sp.Piecewise):
        return _chosen(node, box)
    if isinstance(node, Table):  # not clamped along the axes where its argument stays between the breakpoints
        arguments = [_visited(argument, box) for argument in node.args]
        return applied(clamped_cells(node, arguments, box), arguments, node.order)
    if not node.args:
        return node
    args = [_visited(part, box) if isinstance(part, sp.Expr) else part for part in node.args]
    if isinstance(node, (sp.Min, sp.Max)):
        return _extreme(type(node), args, box)
    built = node if args == list(node.args) else node.func(*args)
    simplified = _plain(built, box)
    return node if simplified != node and lost_part(args, (simplified,), box) is not None else simplified


def with_limited_slopes(expression: sp.Expr, box: Box, share: sp.Rational = CHORD, tiny: sp.Rational = TINY) -> sp.Expr:
    """Return the expression that programs differentiate in place of `expression`, so that derivatives are finite on the
    box: near e = 0 the chord replaces each power e^p, p not whole, that may be 0 there. E the largest e on the box, the
    chord ends at `share` E for p < 1 and at `tiny` E for p > 1."""
    powers = _vanishing_powers(expression, tuple(box.items()), share, tiny)
    if not powers:
        return expression
    whole = expression.xreplace({e: e.base * sp.Max(e.base, end) ** (e.exp - 1) for e, end in powers.items()})
    return whole.replace(lambda e: isinstance(e, sp.Mul), unsigned)


def chord_ends(expression: sp.Expr, box: Box) -> dict[sp.Expr, sp.Rational]:
    """Return the base e of each power e^p with a slope without bound at e = 0, with the value of e below which programs
    use a chord."""
    powers = _vanishing_powers(expression, tuple(box.items()), CHORD, sp.S.Zero)
    return {e.base: end for e, end in powers.items() if end > 0}


@lru_cache(maxsize=512)  # each stage of a step needs the same rows
def _vanishing_powers(
    expression: sp.Expr, sides: tuple[tuple[sp.Symbol, tuple[End, End]], ...], share: sp.Rational, tiny: sp.Rational
) -> dict[sp.Pow, sp.Rational]:
    """Return the powers e^p, p > 0 not whole, whose base may be 0 while the expression has values on both sides of e =
    0, each with the e below which it has the slope of a chord. Such a base is an absolute value or a norm, or the power
    is in a Piecewise."""
    powers = {e for e in expression.atoms(sp.Pow) if _fractional(e) and _is_size(e.base)}
    branches = (branch for choice in expression.atoms(sp.Piecewise) for branch, _ in choice.args)
    powers |= {e for branch in branches for e in branch.atoms(sp.Pow) if _fractional(e)}
    ends = {}
    for e in sorted(powers, key=str):
        low, high = rational(e.base, dict(sides))
        squared = not isinstance(e.base, sp.Abs) and squares(e.base) is not None
        if low <= 0 < high and not (squared and rooted(e)):
            largest = sp.Rational(Fraction(high)) if high < math.inf else sp.S.One
            steep = e.exp < (sp.S.Half if squared else 1)
            ends[e] = largest * (share ** (1 + squared) if steep else tiny)
    return ends


def _fractional(e: sp.Pow) -> bool:
    return bool(e.exp.is_number and e.exp.is_positive and not exact(e.exp).is_integer and e.base.free_symbols)


def _is_size(e: sp.Expr) -> bool:
    return isinstance(e, (sp.Abs, Norm)) or (isinstance(e, sp.Max) and 0 in e.args) or squares(e) is not None


def as_computed(expression: sp.Expr, box: Box) -> sp.Expr:
    """Return the expression as programs compute it, with arguments clamped to the box: kinks of which only one side
    occurs on the box are removed, so that a slope at an end of the box is the one inside; a table is not clamped where
    only rounding leaves its breakpoints; kinks at one place share a norm; and norms have a slope at 0."""
    return _computed(expression, tuple(box.items())) if _has_kinks(expression) else expression


@lru_cache(maxsize=512)  # each stage of a step needs the same rows
def _computed(expression: sp.Expr, sides: tuple[tuple[sp.Symbol, tuple[End, End]], ...]) -> sp.Expr:
    box = dict(sides)

    def cells(node: Table) -> Cells:
        return clamped_cells(node, [one_sided(part, box) for part in node.args], box, program=True)

    def unit(squares: sp.Expr) -> sp.Rational:
        """Return the unit of a sum of squares: 1, or, if it is
        small on the whole box, a power of 4 near its maximum."""
        _, high = rational(squares, box)
        small = 0 < high < _SMALL
        return sp.Rational(1, 4 ** min(int(-math.log2(high) / 2), _MOST)) if small else sp.S.One

    return off_zero(shared(one_sided(replaced(expression, cells), box)), _LEAST, unit)


def _plain(e: sp.Expr, box: Box) -> sp.Expr:
    if isinstance(e, sp.Mul) and any(isinstance(part, sp.sign) for part in e.args):
        whole = signed(e)
        return e if whole == e else _visited(whole, box)
    if isinstance(e, sp.Abs) or (isinstance(e, Norm) and len(e.args) == 1):
        return _size(e.args[0], box)
    if isinstance(e, sp.sign):
        return sp.Integer(_constant(e.args[0], box)) or e
    if isinstance(e, sp.Heaviside):
        way = _constant(e.args[0], box)
        return e if way == 0 else sp.Integer(way > 0)
    if isinstance(e, sp.Pow) and rooted(e):
        whole = with_norms(e)
        return e if whole == e or not whole.is_Function or len(whole.args) > 1 else _size(whole.args[0], box)
    return e


def _size(argument: sp.Expr, box: Box) -> sp.Expr:
    ways = {factor: _side(factor, box) for factor in sp.Mul.make_args(argument)}
    undecided = sp.Mul(*(factor for factor, way in ways.items() if not way))
    return sp.Mul(*(way * factor for factor, way in ways.items() if way), sp.Abs(undecided))


def _extreme(kind: type[sp.Expr], args: Iterable[sp.Expr], box: Box) -> sp.Expr:
    way = 1 if kind is sp.Max else -1
    remaining: list[sp.Expr] = []
    for a in args:
        if any(_side(way * (b - a), box) > 0 for b in remaining) and is_defined(a, box):
            continue
        remaining = [b for b in remaining if _side(way * (a - b), box) <= 0 or not is_defined(b, box)]
        remaining.append(a)
    return kind(*remaining)


def _chosen(node: sp.Piecewise, box: Box) -> sp.Expr:
    branches: list[tuple[sp.Expr, sp.Basic]] = []
    smooth = not with_norms(node).has(sp.Piecewise)
    for value, condition in (tuple(pair.args) for pair in node.args):
        holds = _holds(condition, smooth, box)
        if holds is not False:
            branches.append((_visited(value, box), sp.true if holds else condition))
        if holds:
            break
    return sp.Piecewise(*branches) if branches else node


def _holds(condition: sp.Basic, weakly: bool, box: Box) -> bool | None:
    if condition in (sp.true, sp.false):
        return bool(condition)
    if not isinstance(condition, (sp.StrictLessThan, sp.LessThan, sp.StrictGreaterThan, sp.GreaterThan)):
        return None
    rise = condition.gts - condition.lts
    strict = isinstance(condition, (sp.StrictLessThan, sp.StrictGreaterThan))
    above = _side(rise, box) if weakly or not strict else _strict(rise, box)
    below = _side(rise, box) if weakly or strict else _strict(rise, box)
    holds = True if above > 0 else False if below < 0 else None
    return holds if holds is None or is_defined(rise, box) else None


def _constant(e: sp.Expr, box: Box) -> int:
    way = _strict(e, box)
    return way if way and is_defined(e, box) else 0


def _side(e: sp.Expr, box: Box) -> int:
    low, high = rational(e, box) if e.count_ops() <= _OPERATIONS and not e.has(*STRANGE) else EVERYTHING
    return 1 if low >= 0 else -1 if high <= 0 else _strict(e, box)


def _strict(e: sp.Expr, box: Box) -> int:
    if e.count_ops() > _OPERATIONS or e.has(*STRANGE):
        return 0
    low, high = rational(e, box)
    if low > 0 or high < 0:
        return 1 if low > 0 else -1
    try:
        answer = nonzero(e, box, boxes=_BOXES, refute=False)
    except NoTape:
        return 0
    return answer.sign if answer.verdict is Verdict.PROVED else 0
