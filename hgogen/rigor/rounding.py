"""Bounds of the rounding errors of a program's values: a running error analysis on ranges.

Each value v of exact arithmetic has a range, and a bound e on |v~ - v|, v~ the computed value. Rounding to nearest adds
at most u |v~|, u = 2^-24 or 2^-53, and `tiny` where a result underflows:

    v = a + b   e = e_a + e_b + u |v~|      v = a b   e = |a| e_b + |b| e_a + e_a e_b + u |v~|
    v = a / b   e = (e_a + |v| e_b)/(|b| - e_b) + u |v~|     v = f(a)   e = sup|f'| e_a + k ulp

min, max and |.| do not enlarge errors. Where rounding may change the result of a comparison, the value may be that of
either branch. The ulps of elementary functions are measured, not proved: twice the largest errors documented in
`emit.elementary`. Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 3.3.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any, Literal

import casadi as ca
from flint import arb

from hgogen.rigor.series import rising

Real = Literal["float", "double"]
REALS: tuple[Real, ...] = ("float", "double")
_NOTHING, _ONE = arb(0), arb(1)
_ULPS = 2  # factor on the measured errors
FOLDED = 8  # roundings of a double in the computation of a constant that is not whole, before it is printed
_UNSURE = 2  # further roundings between a certificate's constant and its value by the plant and the gains
_WHOLE = 2**24  # whole numbers up to it are exact in every precision


class NoRoundingBound(ArithmeticError):
    """The error that no bound of a value's rounding error is known; `args[0]` is the reason."""


@dataclass(frozen=True, eq=False)
class Computed:
    """A number v of exact arithmetic, enclosed by the Arb ball `value`, with a bound `error` of |v~ - v|, v~ the number
    that the program computes.

    A truth value has a range within [0, 1], and the error 1 where the program may decide otherwise. For the value "x if
    c, else 0", `test` is c and `chosen` is x; `negates`: the truth value of which this one is the negation.
    """

    value: Any
    error: Any = _NOTHING
    test: "Computed | None" = None
    chosen: "Computed | None" = None
    negates: "Computed | None" = None

    @property
    def size(self) -> Any:
        """Return an upper bound of |v| and |v~|, the exact and the computed number."""
        return (abs(self.value) + self.error).upper()

    @property
    def around(self) -> Any:
        """Return a ball that contains the exact v and the computed v~."""
        return self.value + arb(0, self.error.upper())

    @property
    def known(self) -> bool | None:
        """Return the truth value if exact arithmetic and the program decide alike, else None."""
        if not self.error.is_zero():
            return None
        return True if self.value == 1 else False if self.value == 0 else None


def error_free(value: Any) -> Computed:
    """Return a number or a ball as a `Computed` with the error 0."""
    return Computed(arb(value))


@dataclass(frozen=True)
class Rounding:
    """The arithmetic of values with rounding error bounds in a program's precision `real`, "float" or "double";
    operations are named by CasADi's codes."""

    real: Real

    @property
    def unit(self) -> Any:
        """Return the unit roundoff u, 2^-24 or 2^-53."""
        return arb(2) ** (-24 if self.real == "float" else -53)

    @property
    def tiny(self) -> Any:
        """Return the smallest normal number: a bound of the error of an underflow, also if it is flushed to 0."""
        return arb(2) ** (-126 if self.real == "float" else -1022)

    @property
    def largest(self) -> Any:
        """Return a power of two below the largest number of the precision."""
        return arb(2) ** (127 if self.real == "float" else 1023)

    def parameter(self, number: float) -> Computed:
        """Return a gain or parameter of the program, with a bound of its rounding error."""
        return self.constant(number)

    def call(self, function: Any, columns: Any, body: Callable[[Any], Any]) -> Any:
        """Return the values `body(columns)` of a function that the program calls; the call itself rounds nothing."""
        return body(columns)

    def constant(self, number: float) -> Computed:
        """Return a constant of a CasADi graph, with a bound of its rounding error."""
        value = arb(number)
        if not math.isfinite(number) or (abs(number) <= _WHOLE and number.is_integer()):
            return Computed(value)
        folded = (FOLDED + _UNSURE) * abs(value) * arb(2) ** -53
        return Computed(value + arb(0, folded.upper()), (abs(value) * self.unit + folded + self.tiny).upper())

    def apply(self, op: int, values: list[Computed]) -> Computed:
        """Return the result of the operation with CasADi's code `op`, with a bound of its rounding error. Raises:
        `NoRoundingBound`."""
        if op in _EXACT:
            return _EXACT[op](*values)
        same = _unchanged(op, values)
        if same:
            return same
        if op in _ROUNDED:
            return self._rounded(*_ROUNDED[op](*values))
        if op in _SMOOTH:
            ulps, function, slope = _SMOOTH[op]
            (x,) = values
            return self._rounded(function(x.value), abs(slope(x.around)) * x.error, 2 * _ULPS * arb(ulps))
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return self._power(*values)
        raise NoRoundingBound("an operation whose rounding is not known")

    def _power(self, x: Computed, y: Computed) -> Computed:
        value = x.value**y.value
        by_base = abs(y.around * x.around ** (y.around - 1)) * x.error
        slope = abs(abs(x.around).log() * y.around)
        by_exponent = abs(x.around**y.around * abs(x.around).log()) * y.error if not y.error.is_zero() else _NOTHING
        return self._rounded(value, by_base + by_exponent, 2 * _ULPS * (arb("1.5") + 2 * slope))

    def _rounded(self, value: Any, inherited: Any, units: Any = _ONE) -> Computed:
        """Return the result `value` of an operation with the `inherited` error of its operands plus its own rounding
        error, `units` times the unit roundoff u."""
        unit, inherited = self.unit * units, inherited.abs_upper()
        error = (inherited + unit * (abs(value) + inherited) * (1 + 2 * unit) + self.tiny * units).abs_upper()
        if not (value.is_finite() and error.is_finite() and abs(value) + error < self.largest):
            raise NoRoundingBound(
                "a division by what may be 0, a value that may overflow, or an argument without a value"
            )
        return Computed(value, error)


# --- operations that round nothing


def _extreme(pick: Callable[[Any, Any], Any], a: Computed, b: Computed) -> Computed:
    low, high = pick(a.value.lower(), b.value.lower()), pick(a.value.upper(), b.value.upper())
    return Computed(low.union(high), _larger(a.error, b.error))


def _larger(a: Any, b: Any) -> Any:
    return a.max(b).upper()


def _below(equal: bool, a: Computed, b: Computed) -> Computed:
    gap, error = b.value - a.value, a.error + b.error
    alike = bool(error.is_zero())
    holds = bool(gap > error or (equal and alike and gap >= 0))
    if holds or gap < -error:
        return error_free(int(holds))
    return Computed(_NOTHING.union(_ONE), _NOTHING if alike else _ONE)


def _all(least: int, a: Computed, b: Computed) -> Computed:
    if bool(least) in (a.known, b.known):
        return error_free(least)
    return _extreme(arb.max if least else arb.min, a, b)


def _chosen(test: Computed, value: Computed) -> Computed:
    """Return "`value` if `test`, else 0"; its error bound covers a program that decides the test otherwise."""
    if test.known is False:
        return error_free(0)
    if test.known is True:
        return Computed(value.value, value.error, test, value)
    error = value.error if test.error.is_zero() else value.size
    return Computed(value.value.union(_NOTHING), error, test, value)


def _unchanged(op: int, values: list[Computed]) -> Computed | None:
    if op not in (ca.OP_ADD, ca.OP_MUL):
        return None
    a, b = values
    either = _either(a, b) if op == ca.OP_ADD else None
    if either:
        return either
    neutral = 0 if op == ca.OP_ADD else 1
    for one, other in ((a, b), (b, a)):
        if one.error.is_zero() and one.value == neutral:
            return other
        if op == ca.OP_MUL and one.error.is_zero() and one.value == 0:
            return one
    return None


def _either(a: Computed, b: Computed) -> Computed | None:
    yes, no = a.chosen, b.chosen
    if not (a.test and b.test and yes and no) or (a.test.negates is not b.test and b.test.negates is not a.test):
        return None
    between = _NOTHING if a.test.error.is_zero() else abs(yes.value - no.value)
    return Computed(yes.value.union(no.value), (_larger(yes.error, no.error) + between).upper())


_EXACT: Mapping[int, Callable[..., Computed]] = {
    ca.OP_NEG: lambda a: Computed(-a.value, a.error),
    ca.OP_FABS: lambda a: Computed(a.value.abs_lower().union(a.value.abs_upper()), a.error),
    ca.OP_FMIN: partial(_extreme, arb.min),
    ca.OP_FMAX: partial(_extreme, arb.max),
    ca.OP_TWICE: lambda a: Computed(2 * a.value, 2 * a.error),
    ca.OP_LT: partial(_below, False),
    ca.OP_LE: partial(_below, True),
    ca.OP_NOT: lambda a: Computed(1 - a.value, a.error, negates=a),
    ca.OP_AND: partial(_all, 0),
    ca.OP_OR: partial(_all, 1),
    ca.OP_IF_ELSE_ZERO: _chosen,
}


# --- operations that round once: the exact result and the inherited error


def _product(a: Computed, b: Computed) -> tuple[Any, Any]:
    x, y = a.value, b.value
    product = x * y
    if product.contains(0) and not (x.contains(0) or y.contains(0)):  # Arb's product of wide balls: use their ends
        product = reduce(arb.union, (s * t for s in (x.lower(), x.upper()) for t in (y.lower(), y.upper())))
    return product, abs(x) * b.error + abs(y) * a.error + a.error * b.error


def _quotient(a: Computed, b: Computed) -> tuple[Any, Any]:
    value = a.value / b.value
    return value, (a.error + abs(value) * b.error) / abs(b.around)


def _squared(x: Any) -> Any:
    """Return the square of a ball. Arb's own square of a wide ball contains negative numbers, and fails for a midpoint
    0."""
    low, high = x.abs_lower(), x.abs_upper()
    return (low * low).union(high * high)


_ROUNDED: Mapping[int, Callable[..., tuple[Any, Any]]] = {
    ca.OP_ADD: lambda a, b: (a.value + b.value, a.error + b.error),
    ca.OP_SUB: lambda a, b: (a.value - b.value, a.error + b.error),
    ca.OP_MUL: _product,
    ca.OP_SQ: lambda a: (_squared(a.value), (2 * abs(a.value) + a.error) * a.error),
    ca.OP_DIV: _quotient,
    ca.OP_INV: lambda a: _quotient(error_free(1), a),
}


# --- elementary functions: documented ulps, function, derivative


def _angle(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return `function` restricted to angles up to 200 rad, where the ulps were measured; NaN beyond."""
    return lambda x: function(x) if abs(x) <= _ANGLE else arb("nan")


_ANGLE = 200
_TANH, _ASINH, _ACOSH, _ATANH = (partial(rising, each) for each in (arb.tanh, arb.asinh, arb.acosh, arb.atanh))
_SMOOTH: Mapping[int, tuple[float, Callable[[Any], Any], Callable[[Any], Any]]] = {
    ca.OP_SQRT: (2, lambda x: x.sqrt(), lambda x: x.rsqrt() / 2),
    ca.OP_EXP: (2, lambda x: x.exp(), lambda x: x.exp()),
    ca.OP_LOG: (2, lambda x: x.log(), lambda x: 1 / x),
    ca.OP_SIN: (2, _angle(lambda x: x.sin()), lambda x: x.cos()),
    ca.OP_COS: (2, _angle(lambda x: x.cos()), lambda x: x.sin()),
    ca.OP_TAN: (4, _angle(lambda x: x.tan()), lambda x: 1 + _squared(x.tan())),
    ca.OP_ASIN: (2, lambda x: x.asin(), lambda x: (1 - _squared(x)).rsqrt()),
    ca.OP_ACOS: (2, lambda x: x.acos(), lambda x: (1 - _squared(x)).rsqrt()),
    ca.OP_ATAN: (2, lambda x: x.atan(), lambda x: 1 / (1 + _squared(x))),
    ca.OP_SINH: (2.5, lambda x: x.sinh(), lambda x: x.cosh()),
    ca.OP_COSH: (2, lambda x: x.cosh(), lambda x: x.sinh()),
    ca.OP_TANH: (3.5, _TANH, lambda x: 1 - _squared(_TANH(x))),
    ca.OP_ASINH: (3.5, _ASINH, lambda x: (1 + _squared(x)).rsqrt()),
    ca.OP_ACOSH: (3.5, _ACOSH, lambda x: (_squared(x) - 1).rsqrt()),
    ca.OP_ATANH: (3.5, _ATANH, lambda x: 1 / (1 - _squared(x))),
    ca.OP_EXPM1: (2.5, lambda x: x.expm1(), lambda x: x.exp()),
    ca.OP_LOG1P: (2.5, lambda x: x.log1p(), lambda x: 1 / (1 + x)),
}
