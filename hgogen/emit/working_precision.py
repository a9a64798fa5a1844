"""What the elementary functions are made of in each working precision: numbers, minimax polynomials, how constants
split, and graphs of powers of two."""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from typing import Literal

import casadi as ca

from hgogen.emit.primitives import POWER_OF_TWO, Real, nearest
from hgogen.graph import Graph


def when(condition: Graph, value: Graph | float) -> Graph:
    """value, or 0; a selection and no product, so that an unused inf or NaN vanishes."""
    return ca.if_else(condition, value, 0.0)


@dataclass(frozen=True)
class Precision:
    """The numbers of one working precision."""

    letter: Literal["f", "d"]  # of struct
    bits: int  # of the significand
    octaves: int  # numbers are below 2^(2^octaves)
    pi_widths: tuple[int, ...]  # bits of the pieces of pi: times k, each but the last is exact
    ln2_widths: tuple[int, ...]
    angle_limit: float  # a larger angle is taken as 0
    heron: int  # iterations from a relative error of 1/9
    sin_tail: tuple[float, ...]
    exp_tail: tuple[float, ...]
    log_tail: tuple[float, ...]
    atan_tail: tuple[float, ...]
    asin_tail: tuple[float, ...]

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


# Minimax fits, rounded; in brackets the largest error relative to the function named first.
# fmt: off
FLOAT = Precision(
    letter="f", bits=24, octaves=7, pi_widths=(11, 11, 11, 24), ln2_widths=(16, 24), angle_limit=2.0**17, heron=3,
    # sin r = r + z r s(z), z = r^2, |r| <= pi/2, degree 3 [2^-27.2]
    sin_tail=(-0.166666597, 0.00833306927, -0.000198097681, 2.60605498e-06),
    # e^r - 1 = r + r^2 (1/2 + r e(r)), |r| <= ln 2 / 2, degree 3 [2^-25.8]
    exp_tail=(0.16666545, 0.0416664034, 0.00836643483, 0.00139406463),
    # 2 atanh s = 2 s + z s l(z), z = s^2, |s| <= (sqrt 2 - 1)^2, degree 2 [2^-30.1]
    log_tail=(0.666667759, 0.399775594, 0.298718989),
    # atan t = t + w t a(w), w = t^2, |t| <= sqrt 2 - 1, degree 4 [2^-30.3]
    atan_tail=(-0.333333164, 0.199985251, -0.142442971, 0.105982684, -0.060873501),
    # asin s = s + z s b(z), z = s^2, |s| <= 1/2, degree 4 [2^-27.6]
    asin_tail=(0.166667521, 0.0749530941, 0.0454691537, 0.024184756, 0.0421583615),
)
DOUBLE = Precision(
    letter="d", bits=53, octaves=10, pi_widths=(33, 33, 53), ln2_widths=(42, 53), angle_limit=2.0**46, heron=4,
    # the same: degree 7 [2^-60.5]
    sin_tail=(-0.16666666666666666, 0.008333333333333207, -0.00019841269841212476, 2.755731921156885e-06,
        -2.5052106904318463e-08, 1.605894099418856e-10, -7.643019073175594e-13, 2.7214153708237633e-15),
    # degree 8 [2^-54.8]
    exp_tail=(0.16666666666666677, 0.04166666666662006, 0.008333333333319133, 0.001388888892057158,
        0.00019841269894133504, 2.4801516161509485e-05, 2.755723517363855e-06, 2.762234018767848e-07,
        2.5112386170006326e-08),
    # degree 6 [2^-59.4]
    log_tail=(0.6666666666666735, 0.3999999999940915, 0.28571428743768607, 0.22222198416940242,
        0.1818357316098145, 0.15313807067218427, 0.1479855341727912),
    # degree 10 [2^-59.2]
    atan_tail=(-0.3333333333333319, 0.19999999999952187, -0.14285714280054532, 0.11111110776327872,
        -0.09090897551899073, 0.0769205654090084, -0.06663062132668172, 0.05847583085744142,
        -0.05037919034280918, 0.038029199329731964, -0.017868310533625382),
    # degree 11 [2^-55.8]
    asin_tail=(0.16666666666665408, 0.07500000000337136, 0.044642856828224275, 0.030381959141436713,
        0.022371757939212672, 0.01735970649535909, 0.013885217879333986, 0.012169329931608453,
        0.006527452390421315, 0.019529725392007008, -0.016226588131093463, 0.03191389964234026),
)
# fmt: on
