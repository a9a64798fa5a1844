"""Power series modulo a prime (or a prime's square), for tapes of + - * / and whole powers.

A random point modulo a prime of 61 bits tells a polynomial that is not zero from zero but for a chance of its degree
over 2^61. A nonzero value is certain: what is not zero modulo a prime is not zero.
"""

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint

OPERATIONS = frozenset({"symbol", "number", "constant", "add", "mul", "power"})


@dataclass(frozen=True)
class Modular:
    """Series with coefficients modulo `modulus`, of which `prime` is the one prime factor.

    A division by what is zero modulo the prime raises `ZeroDivisionError`: another point may do. A constant, pi or e,
    is a random number: it is transcendental, and an expression over the rationals vanishes at it only identically.
    """

    modulus: int
    prime: int
    seed: int

    def draws(self, name: str) -> random.Random:
        """The random numbers of one purpose; the same for the same seed and name, at every call."""
        return random.Random(f"{self.seed} {name}")

    def draw(self, source: random.Random) -> int:
        """A random number, not zero modulo the prime."""
        return source.randrange(1, self.prime)

    def series(self, coefficients: Sequence[int], order: int) -> Any:
        """c_0 + c_1 t + ... , known below t^order."""
        return flint.nmod_poly(list(coefficients[:order]), self.modulus)

    def number(self, value: Fraction, order: int) -> Any:
        """A rational as a series."""
        if value.denominator % self.prime == 0:
            raise ZeroDivisionError
        return self.series([value.numerator * pow(value.denominator, -1, self.modulus) % self.modulus], order)

    def constant(self, name: str, order: int) -> Any:
        """A transcendental constant as a series."""
        return self.series([self.draw(self.draws(f"constant {name}"))], order)

    def mul(self, a: Any, b: Any, order: int) -> Any:
        """a b below t^order."""
        return a.mul_low(b, order)

    def cut(self, a: Any, order: int) -> Any:
        """a below t^order."""
        return a.truncate(order)

    def nothing(self, a: Any) -> bool:
        """Whether the series is known to be zero."""
        return bool(a.is_zero())

    def unary(self, op: str, a: Any, value: Any, order: int) -> tuple[Any, Any]:
        """(f(a), f'(a)) below t^order, for f the whole power `value`."""
        assert op == "power"
        if value < 0:
            if a[0] == 0 or int(a[0]) % self.prime == 0:
                raise ZeroDivisionError
            inverse = a.inverse_series_trunc(order)
            result = inverse.pow_trunc(-value, order)
            return result, value * result.mul_low(inverse, order)
        less = a.pow_trunc(value - 1, order) if value > 1 else self.series([1], order)
        return less.mul_low(a, order), value * less

    def coefficients(self, a: Any, order: int) -> list[int]:
        """The first `order` coefficients of a series, padded with zeros."""
        coefficients = [int(c) for c in a.coeffs()[:order]]
        return coefficients + [0] * (order - len(coefficients))

    def matrix(self, rows: int, columns: int, entries: Iterable[int]) -> Any:
        """A matrix from its entries, row by row."""
        return flint.nmod_mat(rows, columns, list(entries), self.modulus)

    def over(self, k: int) -> int:
        """1/k."""
        return pow(k, -1, self.modulus)

    @property
    def nudge(self) -> int:
        """A step d whose square is zero modulo prime^2, so that F(x + d v) - F(x) = d F'(x) v exactly."""
        return self.prime

    def slope(self, moved: Any, base: Any) -> int:
        """F'(x) v modulo the prime, from F(x + d v) and F(x) modulo prime^2."""
        return (int(moved) - int(base)) % self.modulus // self.prime

    def reduced(self, a: Any) -> int:
        """The number modulo the prime."""
        return int(a) % self.prime
