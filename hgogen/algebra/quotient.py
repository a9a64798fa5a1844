"""Quotients of polynomials over the rationals (FLINT), by a tape; sizes are limited by counts of terms."""

from collections.abc import Iterable, Sequence
from math import comb
from typing import Any

import sympy as sp
from flint import Ordering, fmpq, fmpq_mpoly_ctx

from hgogen.algebra.rewrite import TooLarge
from hgogen.algebra.tape import Instruction, NoTape, tape

# Products of more terms than this are not formed.
_TERMS = 200_000
# Nor powers whose coefficients may have more digits than this together.
_DIGITS = 4_000_000
# Numerator and denominator, without a common factor.
Quotient = tuple[Any, Any]


def ring_of(generators: Sequence[sp.Symbol]) -> Any:
    """The ring of polynomials in the generators, in their order."""
    return fmpq_mpoly_ctx.get([f"g{i}" for i in range(len(generators))] or ["g"], Ordering.degrevlex)


def quotients(expressions: Iterable[sp.Expr], generators: Sequence[sp.Symbol], ring: Any) -> list[Quotient]:
    """Rational functions of the generators.

    Raises: `TooLarge`; `ZeroDivisionError` for a denominator that is zero; `NoTape` for what is no such function.
    """
    program = tape(expressions, generators)
    values: list[Quotient] = []
    for instruction in program.instructions:
        values.append(_apply(instruction, [values[i] for i in instruction.args], ring))
    return [values[i] for i in program.outputs]


def _apply(instruction: Instruction, args: list[Quotient], ring: Any) -> Quotient:
    op, value, one = instruction.op, instruction.value, ring.constant(1)
    if op == "symbol":
        return ring.gens()[value], one
    if op == "number":
        return ring.constant(fmpq(value.numerator, value.denominator)), one
    if op == "add":
        return add(*args)
    if op == "mul":
        return multiply(*args)
    if op == "power":
        (top, bottom), exponent = args[0], int(value or 0)
        if exponent < 0:
            if top.is_zero():
                raise ZeroDivisionError
            top, bottom = bottom, top
        return power(top, abs(exponent)), power(bottom, abs(exponent))
    raise NoTape(op, "a rational function")


def add(one: Quotient, other: Quotient) -> Quotient:
    """a/b + c/d.

    Raises: `TooLarge`.
    """
    (a, b), (c, d) = one, other
    if b == d:
        return _cancelled(a + c, b)
    shared = b.gcd(d)
    left, right = d / shared, b / shared
    return _cancelled(times(a, left) + times(c, right), times(b, left))


def multiply(one: Quotient, other: Quotient) -> Quotient:
    """a/b c/d.

    Raises: `TooLarge`.
    """
    (a, b), (c, d) = one, other
    (a, d), (c, b) = _cancelled(a, d), _cancelled(c, b)
    return times(a, c), times(b, d)


def partial(value: Quotient, generator: int) -> Quotient:
    """The derivative by one generator, the others held.

    Raises: `TooLarge`.
    """
    top, bottom = value
    if bottom.is_constant():
        return top.derivative(generator) / bottom, bottom.context().constant(1)
    up = times(top.derivative(generator), bottom) - times(top, bottom.derivative(generator))
    return _cancelled(up, times(bottom, bottom))


def times(a: Any, b: Any) -> Any:
    """The product of two polynomials.

    Raises: `TooLarge`.
    """
    if len(a) * len(b) > _TERMS:
        raise TooLarge("a product")
    return a * b


def power(base: Any, exponent: int) -> Any:
    """A whole power of a polynomial.

    Raises: `TooLarge`.
    """
    if len(base) > 1:  # of two terms or more; first a bound that costs nothing
        terms = comb(len(base) + exponent - 1, exponent) if exponent < _TERMS else _TERMS + 1
        if terms > _TERMS or terms * exponent > _DIGITS:
            raise TooLarge("a power")
    return base**exponent


def _cancelled(top: Any, bottom: Any) -> Quotient:
    if bottom.is_constant():
        return top, bottom
    shared = top.gcd(bottom)
    return top / shared, bottom / shared
