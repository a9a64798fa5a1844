"""The numbers of one working precision, and graphs of powers of two in it."""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce

import casadi as ca

from hgogen.emit.minimax import Precision
from hgogen.emit.primitives import POWER_OF_TWO, Real, nearest
from hgogen.graph import Graph


def when(condition: Graph, value: Graph | float) -> Graph:
    """value, or 0; a selection and no product, so that an unused inf or NaN vanishes."""
    return ca.if_else(condition, value, 0.0)


@dataclass(frozen=True)
class Numbers(Precision):
    """What the functions in one working precision are built of."""

    @property
    def real(self) -> Real:
        """What it is called."""
        return "float" if self.letter == "f" else "double"

    @property
    def nearest(self) -> ca.Function:
        """The whole number nearest to a number."""
        return nearest(self.real)

    def near(self, value: Fraction | float) -> float:
        """The nearest number of this precision."""
        return float(struct.unpack(self.letter, struct.pack(self.letter, float(value)))[0])

    def pieces(self, value: Fraction, widths: Sequence[int]) -> list[float]:
        """Numbers of the given widths in bits that sum up to value, the largest first."""
        rounded = []
        for width in widths:
            unit = Fraction(2) ** (math.frexp(float(value))[1] - width)
            rounded.append(round(value / unit) * unit)
            value -= rounded[-1]
        return [float(piece) for piece in rounded]

    @property
    def largest(self) -> float:
        """The largest number."""
        return float((2 - 2.0 ** (1 - self.bits)) * 2.0 ** (2**self.octaves - 1))

    @property
    def smallest(self) -> float:
        """The smallest normal number."""
        return float(2.0 ** (2 - 2**self.octaves))

    def polynomial(self, x: Graph, coefficients: Sequence[float]) -> Graph:
        """By Horner's rule, the constant first."""
        rounded = [self.near(c) for c in reversed(coefficients)]
        return reduce(lambda value, c: value * x + c, rounded[1:], rounded[0])

    def lift_if(self, condition: Graph, n: int) -> Graph:
        """2^n or 1, exactly, because 2^n - 1 is exact or rounds to 2^n."""
        return 1 + when(condition, self.near(2.0**n - 1))

    def lower_unless(self, condition: Graph, n: int) -> Graph:
        """2^-n, or 1 where the condition holds, exactly for the same reason."""
        return 2.0**-n + when(condition, self.near(1 - 2.0**-n))

    @cached_property
    def power_of_two(self) -> ca.Function:
        """2^k for whole k, where that is a normal number; of its bits where a reader knows how a number is stored."""
        k = ca.SX.sym("k")
        half, power = self.lower_unless(k >= 0, 2 ** (self.octaves - 1)), 1.0
        rest = k + when(k < 0, 2.0**self.octaves)
        for i in reversed(range(self.octaves)):
            bit = rest >= 2**i
            power = power * self.lift_if(bit, 2**i)
            rest = rest - when(bit, 2.0**i)
        return ca.Function(POWER_OF_TWO, [k], [half * power * half], {"never_inline": True})

    def scaling(self, k: Graph) -> Callable[[Graph], Graph]:
        """v -> 2^k v for whole k, |k| < 2 (2^octaves - 2); only the result may overflow or underflow."""
        half = self.nearest(k * 0.5)
        first, second = self.power_of_two(half), self.power_of_two(k - half)
        return lambda v: v * first * second
