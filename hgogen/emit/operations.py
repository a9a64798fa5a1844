"""What CasADi's operations are in emitted code: signs, and how tightly they bind, or functions by their names.

Sines and cosines of bounded angles are told apart: what a graph clamps, and sums and products of that, is bounded.

    |x| <= 100:           no test of whether x can be turned, and three pieces of pi are enough
    |x| <= 4.7 < 3 pi/2:  one turn by pi at the most, which a comparison finds

A bound is an interval of what an operation gives where that is a number, and whether it always is one: min(a, b) is
`a < b ? a : b` in emitted code, which is b where a is no number. Rounding may pass a bound by 2^-24 of its size for
each operation, for which 3 pi/2 leaves room.
"""

from collections.abc import Callable, Mapping
from math import inf
from typing import NamedTuple

import casadi as ca

from hgogen.emit.elementary import BOUNDED, SMALL
from hgogen.emit.syntax import AND, EQUAL, OR, ORDER, PRODUCT, SUM

SMALL_SIN, SMALL_COS, BOUNDED_SIN, BOUNDED_COS = -8, -9, -10, -11  # operations beside those of CasADi
_ANGLES = {
    ca.OP_SIN: ((SMALL, SMALL_SIN), (BOUNDED, BOUNDED_SIN)),
    ca.OP_COS: ((SMALL, SMALL_COS), (BOUNDED, BOUNDED_COS)),
}
_LARGE = 1e30  # what is larger may be infinite in single precision


class Bound(NamedTuple):
    """Between `low` and `high` where it is a number; `number`: it always is one, an infinite one perhaps."""

    low: float
    high: float
    number: bool

    @property
    def size(self) -> float:
        """The largest absolute value."""
        return max(abs(self.low), abs(self.high))


_ANY = Bound(-inf, inf, False)
_WAVE = Bound(-1.0, 1.0, False)


def operations(function: ca.Function) -> list[int]:
    """The operation of each instruction of an SX function, with sines and cosines of bounded angles told apart."""
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    if _ANGLES.keys().isdisjoint(codes):
        return codes
    bounds, result = dict[int, Bound](), list[int]()
    for k, op in enumerate(codes):
        known = op in _BOUNDS or op in _ANGLES
        of = [bounds[place] for place in function.instruction_input(k)] if known else []
        result.append(next((code for limit, code in _ANGLES.get(op, ()) if of[0].size <= limit), op))
        value = function.instruction_constant(k) if op == ca.OP_CONST else inf
        if abs(value) < inf:
            bound = Bound(value, value, True)
        elif op in _BOUNDS:
            bound = _BOUNDS[op](*of)
        else:
            bound = _WAVE if op in _ANGLES else _ANY
        if op != ca.OP_OUTPUT:  # which names an output where others name a place of work
            bounds |= dict.fromkeys(function.instruction_output(k), bound)
    return result


def _number(a: Bound, b: Bound) -> bool:
    """Whether a sum, a difference or a product is one for certain: no operand may be infinite."""
    return a.number and b.number and max(a.size, b.size) < _LARGE


def _product(a: Bound, b: Bound) -> Bound:
    if max(a.size, b.size) == inf:
        return _ANY
    ends = [x * y for x in a[:2] for y in b[:2]]
    return Bound(min(ends), max(ends), _number(a, b))


def _smaller(a: Bound, b: Bound) -> Bound:
    return Bound(min(a.low, b.low), min(a.high, b.high) if a.number else b.high, b.number)


def _larger(a: Bound, b: Bound) -> Bound:
    return Bound(max(a.low, b.low) if a.number else b.low, max(a.high, b.high), b.number)


_BOUNDS: Mapping[int, Callable[..., Bound]] = {
    ca.OP_ADD: lambda a, b: Bound(a.low + b.low, a.high + b.high, _number(a, b)),
    ca.OP_SUB: lambda a, b: Bound(a.low - b.high, a.high - b.low, _number(a, b)),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda a, b: _ANY if b.low <= 0 <= b.high else _product(a, Bound(1 / b.high, 1 / b.low, b.number)),
    ca.OP_NEG: lambda a: Bound(-a.high, -a.low, a.number),
    ca.OP_TWICE: lambda a: Bound(2 * a.low, 2 * a.high, a.number),
    ca.OP_SQ: lambda a: _product(a, a),
    ca.OP_FMIN: _smaller,
    ca.OP_FMAX: _larger,
}


INFIX: dict[int, tuple[str, float]] = {
    ca.OP_ADD: (" + ", SUM),
    ca.OP_SUB: (" - ", SUM),
    ca.OP_MUL: ("*", PRODUCT),
    ca.OP_DIV: ("/", PRODUCT),
    ca.OP_LT: (" < ", ORDER),
    ca.OP_LE: (" <= ", ORDER),
    ca.OP_EQ: (" == ", EQUAL),
    ca.OP_NE: (" != ", EQUAL),
}
LOGIC: dict[int, float] = {ca.OP_AND: AND, ca.OP_OR: OR}  # whose signs are a language's own
CALLS: dict[int, str] = {
    ca.OP_FABS: "abs",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_FLOOR: "floor",
    ca.OP_SIGN: "sign",
    ca.OP_SQRT: "sqrt",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    BOUNDED_SIN: "bounded_sin",
    BOUNDED_COS: "bounded_cos",
    SMALL_SIN: "small_sin",
    SMALL_COS: "small_cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG1P: "log1p",
    ca.OP_HYPOT: "hypot",
}
