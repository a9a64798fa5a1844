"""Elementary functions as straight-line graphs of + - * /, comparison, selection, floor and two primitives: one result
anywhere.

    sin x  = (-1)^k sin r,     r = x - k pi     exp x  = 2^k e^r,       r = x - k ln 2
    log x  = k ln 2 + log m,   x = 2^k m        atan x = j pi/4 + atan z,  z = x, (x - 1)/(x + 1) or -1/x
    sqrt x = 2^k sqrt m,  y <- (y + m/y)/2      asin x = pi/2 - 2 asin sqrt((1 - x)/2)  for x > 1/2

Range reduction with split constants: W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980; sqrt
by Heron's iteration; the polynomials are our own minimax fits. The compiler must round every operation to the working
precision and contract nothing (-ffp-contract=off).

NaN in gives NaN out (but x^0 = 1), and so do inf - inf and inf / inf where they arise (atan2, hypot, 1^inf). The sign
of a zero is not kept. A result below the smallest normal number may be 0; sqrt, log and pow take an argument below it
for 0.

CasADi rewrites (a + b) - a to b and x - x to 0 while it builds a graph. No formula here has such a pattern: what must
be exact is so because constants are split, never by a two-sum.

Each reader of a graph recognises the primitives by their names and implements them itself, with the same bits:

    nearest(v)        the whole number nearest to v, of two the even one
    power_of_two(k)   2^k for whole k, where that is a normal number

A sum of v and 3/2 2^(n-1), n the bits of the significand, is rounded to a whole number, whose last bits are those of
nearest(v). If it includes the bias of the exponent, a shift by n - 1 moves them to the exponent bits of 2^k.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, reduce
from types import MappingProxyType
from typing import Any

import casadi as ca

from hgogen.emit.syntax import DTYPE, Real
from hgogen.graph import Graph

PI = Fraction("3.14159265358979323846264338327950288419716939937510582")
LN2 = Fraction("0.69314718055994530941723212145817656807550013436025525")
SQRT2 = Fraction("1.41421356237309504880168872420969807856967187537694807")

SMALL, BOUNDED = 4.7, 100.0  # angles of `small_sin`, below 3 pi/2, and of `bounded_sin`; of cosines as well

UNARY = (
    *("sqrt", "exp", "log", "expm1", "log1p", "sin", "cos", "bounded_sin", "bounded_cos", "small_sin", "small_cos"),
    *("tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
BINARY = ("pow", "atan2", "hypot")  # pow(base, exponent), atan2(y, x), hypot(x, y)

NEAREST, POWER_OF_TWO = "nearest", "power_of_two"

SHIFT: Mapping[Real, int] = {"float": 23, "double": 52}  # bits of the significand that are stored
BIAS: Mapping[Real, int] = {"float": 127, "double": 1023}  # of the exponent
ALL_WHOLE: Mapping[Real, float] = {"float": 2.0**23, "double": 2.0**52}  # numbers from here on are whole
ROUNDS: Mapping[Real, float] = {real: 1.5 * whole for real, whole in ALL_WHOLE.items()}
BIASED: Mapping[Real, float] = {real: rounds + BIAS[real] for real, rounds in ROUNDS.items()}


@cache
def elementary(real: Real) -> Mapping[str, Any]:
    """Return the functions sin, exp, log .. by name, each a `casadi.Function` of one scalar (`BINARY`: of two) that
    computes in the precision `real` with + - * / alone.

    Errors in ulp of the result (measured on every 13th number in float, on 2 million in double): at most 2 for sqrt,
    exp, log, asin, acos, atan, atan2, cosh; 2.5 for expm1, log1p, sinh, hypot; 3.5 for tanh, asinh, acosh, atanh; 1.5 +
    2 |y log x| for x^y; 2 for sin and cos, 4 for tan up to |x| = 200 (float) or 1e4 (double), 2.5 and 4.5 up to 8192 or
    1e6; 2 for sin and cos of |x| <= `SMALL` or `BOUNDED`. A larger angle is that of some number within 2 ulp of x, and
    from 2^17 or 2^46 on it is replaced by 0. For atan2 and hypot, |x| + |y| must not overflow (nor, where subnormal
    numbers are flushed to 0, |x| - |y| underflow).

    Every constant is a number of `real`, inf and nan among them. The argument of floor is finite and below 2^31 (float)
    or 2^53 (double).
    """
    arithmetic = ARITHMETIC[real]
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    inputs = {name: [x] for name in UNARY} | {name: [x, y] for name in BINARY}
    return MappingProxyType(
        {name: ca.Function(name, args, [getattr(arithmetic, name)(*args)]) for name, args in inputs.items()}
    )


def _polar(x: Graph) -> tuple[Graph, Graph]:
    sign = 1 - when(x < 0, 2.0)
    return sign, sign * x


def when(condition: Graph, value: Graph | float) -> Graph:
    """Return `value` where `condition` holds, else 0. It is a selection, not a product, so an inf or NaN that is not
    selected does not spread."""
    return ca.if_else(condition, value, 0.0)


@dataclass(frozen=True)
class _Precision:
    """The elementary functions in one working precision (float or double), with the
    coefficients of their minimax polynomials (`.._tail`) and bit widths (`.._widths`)."""

    real: Real
    bits: int  # of the significand
    octaves: int  # numbers are below 2^(2^octaves)
    pi_widths: tuple[int, ...]  # bits of the pieces of pi: times k, each but the last is exact
    ln2_widths: tuple[int, ...]
    angle_limit: float  # a larger angle is replaced by 0
    heron: int  # iterations from a relative error of 1/9
    sin_tail: tuple[float, ...]
    exp_tail: tuple[float, ...]
    log_tail: tuple[float, ...]
    atan_tail: tuple[float, ...]
    asin_tail: tuple[float, ...]

    @cached_property
    def nearest(self) -> ca.Function:
        """The CasADi function v -> the integer nearest to v, computed as v + C - C,
        where C and its neighbours are integers. CasADi would simplify that to v; so
        the sum is a call. The result goes through floor, whose derivative is 0."""
        v, C = ca.SX.sym("v"), ROUNDS[self.real]
        add = ca.Function("add", [v], [v + C], {"never_inline": True})
        return ca.Function(NEAREST, [v], [ca.floor(add(v) - C + 0.25)], {"never_inline": True})

    def near(self, value: Fraction | float) -> float:
        return float(DTYPE[self.real](float(value)))

    def pieces(self, value: Fraction, widths: Sequence[int]) -> list[float]:
        """Return numbers with the sum `value`, the largest first; number i has `widths[i]` significant bits, so that
        its product with a short integer is exact."""
        rounded = []
        for width in widths:
            unit = Fraction(2) ** (math.frexp(float(value))[1] - width)
            rounded.append(round(value / unit) * unit)
            value -= rounded[-1]
        return [float(piece) for piece in rounded]

    @property
    def largest(self) -> float:
        return float((2 - 2.0 ** (1 - self.bits)) * 2.0 ** (2**self.octaves - 1))

    @property
    def smallest(self) -> float:
        return float(2.0 ** (2 - 2**self.octaves))

    def polynomial(self, x: Graph, coefficients: Sequence[float]) -> Graph:
        """Return c_0 + c_1 x + c_2 x^2 + .. by Horner's rule; `coefficients`: c_0, c_1, .."""
        rounded = [self.near(c) for c in reversed(coefficients)]
        return reduce(lambda value, c: value * x + c, rounded[1:], rounded[0])

    def lift_if(self, condition: Graph, n: int) -> Graph:
        """Return 2^n where the condition holds, else 1; exact, because 2^n - 1 is exact or rounds to 2^n."""
        return 1 + when(condition, self.near(2.0**n - 1))

    def lower_unless(self, condition: Graph, n: int) -> Graph:
        """Return 1 where the condition holds, else 2^-n; exact, because 2^-n - 1 is exact or rounds to -1."""
        return 2.0**-n + when(condition, self.near(1 - 2.0**-n))

    @cached_property
    def power_of_two(self) -> ca.Function:
        """The CasADi function k -> 2^k for integers k, if 2^k is a normal number.
        This is the portable definition; emitted code sets the bits."""
        k = ca.SX.sym("k")
        half, power = self.lower_unless(k >= 0, 2 ** (self.octaves - 1)), 1.0
        exponent = k + when(k < 0, 2.0**self.octaves)
        for i in reversed(range(self.octaves)):
            bit = exponent >= 2**i
            power = power * self.lift_if(bit, 2**i)
            exponent = exponent - when(bit, 2.0**i)
        return ca.Function(POWER_OF_TWO, [k], [half * power * half], {"never_inline": True})

    def scaling(self, k: Graph) -> Callable[[Graph], Graph]:
        """Return the function v -> 2^k v for an integer k, |k| < 2
        (2^octaves - 2); its result may overflow or underflow."""
        half = self.nearest(k * 0.5)
        first, second = self.power_of_two(half), self.power_of_two(k - half)
        return lambda v: v * first * second

    # --- sqrt

    def root(self, m: Graph, octaves: int) -> Graph:
        """Return sqrt m for 1 <= m < 2^(2^octaves), octaves >= 2."""
        shrink: Graph = 1.0
        for i in reversed(range(2, octaves)):
            small = m < 2.0**2**i
            m = m * self.lower_unless(small, 2**i)
            shrink = shrink * self.lower_unless(small, 2 ** (i - 1))
        y = m * self.near(Fraction(2, 9)) + self.near(Fraction(8, 9))  # within 1/9 of sqrt m for 1 <= m <= 16
        for _ in range(self.heron):
            y = (y + m / y) * 0.5
        return y / shrink

    def sqrt(self, x: Graph) -> Graph:
        lift = 2**self.octaves - 2
        y = self.root(x * self.lift_if(x < 1, lift), self.octaves) * self.lower_unless(x >= 1, lift // 2)
        y = ca.if_else(x > self.largest, x, y)
        return ca.if_else(x < self.smallest, when(x < 0, math.nan), y)

    def hypot(self, x: Graph, y: Graph) -> Graph:
        (_, a), (_, b) = _polar(x), _polar(y)
        high, low = ca.if_else(a < b, b, a), ca.if_else(a < b, a, b)
        slope = low / ca.if_else(high > 0, high, 1.0)
        return high * self.root(1 + slope * slope, 2)

    # --- exp and its kin: e^x = 2^k (1 + p)

    def split(self, x: Graph) -> tuple[Graph, Graph]:
        """Return k and p = e^r - 1, where x = k ln 2 + r, |r| <= ln 2 / 2, for |x| < 2^octaves (otherwise k = 0)."""
        inside = x * x < 4.0**self.octaves
        k = self.nearest(when(inside, x * self.near(1 / LN2)))
        r = x
        for piece in self.pieces(LN2, self.ln2_widths):
            r = r - k * piece
        return k, r + r * r * (0.5 + r * self.polynomial(r, self.exp_tail))

    def saturated(self, x: Graph, y: Graph, doublings: int) -> Graph:
        """Return y, or inf where x is so large that y overflows; `y`: an approximation of e^x / 2^doublings."""
        return ca.if_else(x > self.near((2**self.octaves + doublings + Fraction(1, 4)) * LN2), math.inf, y)

    def exp(self, x: Graph) -> Graph:
        k, p = self.split(x)
        y = ca.if_else(x < self.near((2 - 2**self.octaves) * LN2), 0.0, self.scaling(k)(1 + p))
        return self.saturated(x, y, 0)

    def expm1(self, x: Graph) -> Graph:
        k, p = self.split(x)
        times = self.scaling(k)
        y = ca.if_else(x < -self.bits, -1.0, times((1 - 1 / times(1.0)) + p))
        return self.saturated(x, y, 0)

    def halves(self, x: Graph) -> tuple[Callable[[Graph], Graph], Graph, Graph]:
        """Return the function v -> 2^(k-1) v, and p = e^r - 1 and 4^-k, where x = k ln 2 + r >= 0, for sinh and
        cosh."""
        k, p = self.split(x)
        one = when(k >= 1, 1.0)
        times = self.scaling(k - one)
        inverse = (1 - 0.5 * one) / times(1.0)
        return lambda v: times(v * (0.5 + 0.5 * one)), p, inverse * inverse

    def sinh(self, x: Graph) -> Graph:
        sign, a = _polar(x)
        times, p, decay = self.halves(a)
        return sign * self.saturated(a, times((1 - decay) + (p + decay * (p / (1 + p)))), 1)

    def cosh(self, x: Graph) -> Graph:
        _, a = _polar(x)
        times, p, decay = self.halves(a)
        return self.saturated(a, times((1 + p) + decay / (1 + p)), 1)

    def tanh(self, x: Graph) -> Graph:
        sign, a = _polar(x)
        last = self.bits + 3  # tanh rounds to 1 from (bits + 2) ln 2 / 2 on
        k, p = self.split(ca.if_else(a * 2 > self.near(last * LN2), self.near(last * LN2), a * 2))
        power = self.power_of_two(k)
        e = power * p + (power - 1)
        return sign * (e / (e + 2))

    # --- log and its kin

    def normal(self, x: Graph) -> tuple[Graph, Graph]:
        """Return m and k with x = 2^k m, sqrt(1/2) < m <= sqrt 2, for a normal number x > 0."""
        low, lift = x < 1, 2**self.octaves - 2
        m = x * self.lift_if(low, lift)
        k = 2.0**self.octaves - 1 - when(low, lift)
        for i in reversed(range(self.octaves)):
            small = m < 2.0**2**i
            m = m * self.lower_unless(small, 2**i)
            k = k - when(small, 2.0**i)
        upper = m > self.near(SQRT2)
        return m * (1 - when(upper, 0.5)), k + when(upper, 1.0)

    def logarithm(self, x: Graph, f: Graph, k: Graph) -> Graph:
        """Return log x for x = 2^k (1 + f), from f and k; x itself decides only 0, negative numbers, inf and NaN."""
        high, low = self.pieces(LN2, self.ln2_widths)
        s, h = f / (2 + f), f * f * 0.5
        z = s * s
        y = k * high - ((h - (s * (h + z * self.polynomial(z, self.log_tail)) + k * low)) - f)
        y = ca.if_else(x > self.largest, x, y)
        return ca.if_else(x < self.smallest, when(x < 0, math.nan) - math.inf, y)

    def log(self, x: Graph) -> Graph:
        m, k = self.normal(x)
        return self.logarithm(x, m - 1, k)

    def log1p(self, x: Graph) -> Graph:
        y = 1 + x
        m, k = self.normal(y)
        return self.logarithm(y, ca.if_else(k == 0, x, m - 1), k)

    def asinh(self, x: Graph) -> Graph:
        (sign, a), huge = _polar(x), 2.0 ** (self.bits + 1)  # above it the root is a
        square = when(a < huge, a * a)
        root = self.root(1 + square, (2 * self.bits + 3).bit_length())
        return sign * (self.log1p(a + square / (1 + root)) + when(a >= huge, self.near(LN2)))

    def acosh(self, x: Graph) -> Graph:
        huge = 2.0 ** (self.bits + 1)
        root = self.sqrt(when(x < huge, (x - 1) * (x + 1)))
        y = self.log1p((x - 1) + root) + when(x >= huge, self.near(LN2))
        return ca.if_else(x < 1, math.nan, y)

    def atanh(self, x: Graph) -> Graph:
        sign, a = _polar(x)
        return sign * 0.5 * self.log1p(a * 2 / (1 - a))

    def pow(self, x: Graph, y: Graph) -> Graph:
        (_, a), (_, b) = _polar(x), _polar(y)
        magnitude = self.exp(ca.if_else(y == 0, 0.0, y * self.log(a)))
        whole = when(b < 2.0**self.bits, y)  # larger numbers are even
        half = whole * 0.5
        negative = ca.if_else(ca.floor(whole) < whole, math.nan, 1 - (half - ca.floor(half)) * 4)
        return magnitude * ca.if_else(x < 0, negative, 1.0)

    # --- angles

    def folded(self, x: Graph) -> tuple[Graph, Graph]:
        """Return the angle x and x / pi; both are 0 beyond the largest supported angle (for x = inf or NaN: NaN and
        0)."""
        inside = ca.fabs(x) <= self.angle_limit
        return x - ca.if_else(inside, 0.0, x), when(inside, x * self.near(1 / PI))

    def arch(self, r: Graph) -> Graph:
        """Return sin r for |r| <= pi / 2."""
        z = r * r
        return r + z * (r * self.polynomial(z, self.sin_tail))

    def wave(self, a: Graph, k: Graph, widths: Sequence[int] = ()) -> Graph:
        """Return sin(a - k pi) for |a - k pi| <= pi / 2. `widths`: the bits of the pieces of pi, each multiplied by k
        and subtracted from a; all products but the last are exact."""
        r = a
        for piece in self.pieces(PI, widths or self.pi_widths):
            r = r - k * piece
        return self.arch(r)

    def odd(self, k: Graph) -> Graph:
        """Return 1/4 for an odd integer k, 0 for an even one."""
        half = k * 0.5
        fraction = half - self.nearest(half)
        return fraction * fraction

    def sine(self, a: Graph, turns: Graph, widths: Sequence[int] = ()) -> Graph:
        k = self.nearest(turns)
        return self.wave(a, k, widths) * (1 - self.odd(k) * 8)

    def cosine(self, a: Graph, turns: Graph, widths: Sequence[int] = ()) -> Graph:
        k = self.nearest(turns - 0.5)
        return self.wave(a, k + 0.5, widths) * (self.odd(k) * 8 - 1)

    def sin(self, x: Graph) -> Graph:
        return self.sine(*self.folded(x))

    def cos(self, x: Graph) -> Graph:
        return self.cosine(*self.folded(ca.fabs(x)))

    def bounded_sin(self, x: Graph) -> Graph:
        return self.sine(x, x * self.near(1 / PI), self.bounded_widths)

    def bounded_cos(self, x: Graph) -> Graph:
        a = ca.fabs(x)
        return self.cosine(a, a * self.near(1 / PI), self.bounded_widths)

    @property
    def bounded_widths(self) -> tuple[int, ...]:
        """The bits of pieces of pi whose products with k or k + 1/2,
        |k| <= `BOUNDED`/pi, are exact except for the last."""
        wide = self.bits - 7
        return (wide, wide, self.bits)

    def beyond(self, constant: Fraction, a: Graph) -> Graph:
        """Return the difference constant - a, correct to the last bit where the two numbers are close to each other."""
        high, low = self.pieces(constant, (self.bits, self.bits))
        return (high - a) + low

    def small_sin(self, x: Graph) -> Graph:
        turned = ca.if_else(x > 0, self.beyond(PI, x), self.beyond(-PI, x))
        return self.arch(ca.if_else(ca.fabs(x) <= self.near(PI / 2), x, turned))

    def small_cos(self, x: Graph) -> Graph:
        a = ca.fabs(x)
        return self.arch(ca.if_else(a <= self.near(PI), self.beyond(PI / 2, a), -self.beyond(3 * PI / 2, a)))

    def tan(self, x: Graph) -> Graph:
        sign, a = _polar(x)  # the cosine of a negative angle is not rounded as that of a
        a, turns = self.folded(a)
        return sign * self.sine(a, turns) / self.cosine(a, turns)

    # --- inverse angles

    def slope_angle(self, b: Graph, a: Graph) -> Graph:
        """Return atan(b / a) for a, b >= 0, not both 0."""
        steep, upright = b > self.near(SQRT2 - 1) * a, b > self.near(SQRT2 + 1) * a
        z = ca.if_else(upright, -a, ca.if_else(steep, b - a, b)) / ca.if_else(upright, b, ca.if_else(steep, b + a, a))
        octants = when(steep, 1.0) + when(upright, 1.0)
        high, low = self.pieces(PI / 4, (self.bits, self.bits))
        w = z * z
        return octants * high + (z + (z * (w * self.polynomial(w, self.atan_tail)) + octants * low))

    def atan(self, x: Graph) -> Graph:
        sign, a = _polar(x)
        return sign * self.slope_angle(a, ca.SX(1))

    def atan2(self, y: Graph, x: Graph) -> Graph:
        (_, a), (sign, b) = _polar(x), _polar(y)
        angle = self.slope_angle(b, a + when(a + b == 0, 1.0))
        high, low = self.pieces(PI, (self.bits, self.bits))
        return sign * ca.if_else(x < 0, high - (angle - low), angle)

    def arc(self, x: Graph) -> tuple[Graph, Graph, Graph, Graph]:
        """Return the terms of asin x: its sign; wide = |x| > 1/2;
        s = sqrt((1 - |x|)/2) if wide, else |x|; and c = asin s - s."""
        (sign, a), octaves = _polar(x), self.bits.bit_length()
        wide = a > 0.5
        z = ca.if_else(wide, (1 - a) * 0.5, a * a)
        root = self.root(z * 2.0**2**octaves, octaves) * 2.0 ** -(2 ** (octaves - 1))
        s = ca.if_else(wide, when(a < 1, root) + when(a > 1, math.nan), a)
        return sign, wide, s, s * (z * self.polynomial(z, self.asin_tail))

    def asin(self, x: Graph) -> Graph:
        sign, wide, s, c = self.arc(x)
        high, low = self.pieces(PI / 2, (self.bits, self.bits))
        return sign * ca.if_else(wide, (high - s * 2) - (c * 2 - low), s + c)

    def acos(self, x: Graph) -> Graph:
        sign, wide, s, c = self.arc(x)
        high, low = self.pieces(PI / 2, (self.bits, self.bits))
        outer = ca.if_else(x < 0, (high * 2 - s * 2) - (c * 2 - low * 2), (s + c) * 2)
        return ca.if_else(wide, outer, high - (sign * (s + c) - low))


# Minimax fits, rounded; in brackets the largest error relative to the function named first.
# fmt: off
_FLOAT = _Precision(
    real="float", bits=24, octaves=7, pi_widths=(11, 11, 11, 24), ln2_widths=(16, 24), angle_limit=2.0**17, heron=3,
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
_DOUBLE = _Precision(
    real="double", bits=53, octaves=10, pi_widths=(33, 33, 53), ln2_widths=(42, 53), angle_limit=2.0**46, heron=4,
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
ARITHMETIC: Mapping[Real, _Precision] = {"float": _FLOAT, "double": _DOUBLE}
