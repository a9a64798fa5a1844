"""Whether an expression is zero by exact algebra: its numerator, reduced by the relations of its generators.

Polynomials over the rationals (FLINT). Sizes are limited by counts of terms, never by seconds.
"""

from math import comb
from typing import Any

import sympy as sp
from flint import Ordering, fmpq, fmpq_mpoly_ctx

from hgogen.rewrite import Rational, Relation, TooLarge, rational
from hgogen.tape import Instruction, NoTape, tape

# Products of more terms than this are not formed.
_TERMS = 200_000
# A fraction: numerator and denominator.
_Fraction = tuple[Any, Any]


def vanishes(expression: sp.Expr) -> bool | None:
    """True: zero wherever it is defined. False: a rational function of symbols that is zero nowhere on a dense
    open set, and defined there. None: not decided. The numbers are exact.

    Source: normal forms of rational functions over a tower of radicals; B. F. Caviness, R. J. Fateman,
    "Simplification of radical expressions", SYMSAC 1976.
    """
    try:
        form = rational(expression)
        ring = fmpq_mpoly_ctx.get([f"g{i}" for i in range(len(form.generators))] or ["g"], Ordering.degrevlex)
        (top, _), *values = _fractions(form, ring)
        for relation, value in reversed(list(zip(form.relations, values, strict=True))):
            top = _reduced(top, form.generators.index(relation.generator), relation, value)
    except (TooLarge, ZeroDivisionError, NoTape):
        return None
    if top.is_zero():
        return True
    return False if set(form.generators) <= expression.free_symbols else None


def _fractions(form: Rational, ring: Any) -> list[_Fraction]:
    """The value and each relation's value.

    Raises: `TooLarge`; `ZeroDivisionError` for a denominator that is zero.
    """
    program = tape((form.value, *(relation.value for relation in form.relations)), form.generators)
    generators = ring.gens()
    values: list[_Fraction] = []
    for instruction in program.instructions:
        values.append(_apply(instruction, [values[i] for i in instruction.args], generators, ring))
    return [values[i] for i in program.outputs]


def _apply(instruction: Instruction, args: list[_Fraction], generators: Any, ring: Any) -> _Fraction:
    op, value, one = instruction.op, instruction.value, ring.constant(1)
    if op == "symbol":
        return generators[value], one
    if op == "number":
        return ring.constant(fmpq(value.numerator, value.denominator)), one  # type: ignore[union-attr]
    if op == "add":
        return _sum(*args)
    if op == "mul":
        (a, b), (c, d) = args
        return _product(*_cancelled(a, d), *_cancelled(c, b))
    if op == "power":
        top, bottom = args[0]
        return _power((top, bottom) if int(value or 0) >= 0 else _inverse(top, bottom), abs(int(value or 0)))
    raise NoTape(op, "a rational function")


def _sum(one: _Fraction, other: _Fraction) -> _Fraction:
    (a, b), (c, d) = one, other
    if b == d:
        return _cancelled(a + c, b)
    shared = b.gcd(d)
    left, right = d / shared, b / shared
    return _cancelled(_times(a, left) + _times(c, right), _times(b, left))


def _product(a: Any, d: Any, c: Any, b: Any) -> _Fraction:
    return _times(a, c), _times(b, d)


def _inverse(top: Any, bottom: Any) -> _Fraction:
    if top.is_zero():
        raise ZeroDivisionError
    return bottom, top


def _power(base: _Fraction, exponent: int) -> _Fraction:
    for part in base:
        if len(part) > 1 and comb(len(part) + exponent - 1, exponent) > _TERMS:
            raise TooLarge("a power")
    return base[0] ** exponent, base[1] ** exponent


def _times(a: Any, b: Any) -> Any:
    if len(a) * len(b) > _TERMS:
        raise TooLarge("a product")
    return a * b


def _cancelled(top: Any, bottom: Any) -> _Fraction:
    if bottom.is_constant():
        return top, bottom
    shared = top.gcd(bottom)
    return top / shared, bottom / shared


def _reduced(top: Any, index: int, relation: Relation, value: _Fraction) -> Any:
    """The polynomial with generator^degree replaced by the relation's value, times a power of its denominator."""
    ring, degree = top.context(), relation.degree
    most = max((int(powers[index]) // degree for powers in top.monoms()), default=0)
    layers: dict[int, dict[tuple[int, ...], Any]] = {}
    for powers, coefficient in top.to_dict().items():
        times, left = divmod(int(powers[index]), degree)
        rest = tuple(left if i == index else int(power) for i, power in enumerate(powers))
        layers.setdefault(times, {})[rest] = coefficient
    total = ring.constant(0)
    for times, terms in layers.items():
        weight = _times(_power(value, times)[0], _power(value, most - times)[1])
        total += _times(ring.from_dict(terms), weight)
    return total
