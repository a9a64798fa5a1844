"""A tape's values at a rational point, as Arb balls: each holds the exact value, or is not finite.

What is undefined there, or not decided at this precision, is NaN; a finite ball proves that the value is defined.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import reduce
from typing import Any

from flint import arb, ctx, fmpq

from hgogen.algebra.balls import ends
from hgogen.algebra.definite import number
from hgogen.algebra.interpolation import Cells, Index, over, polynomial_value
from hgogen.algebra.tape import Instruction, Tape

Ball = Any
_NAN = arb("nan")


def values(tape: Tape, point: Sequence[Fraction], bits: int = 64) -> list[Ball]:
    """The tape's outputs at `point`, one number for each of its symbols, in a working precision of `bits`."""
    before = ctx.prec
    ctx.prec = bits
    try:
        registers: list[Any] = []
        for instruction in tape.instructions:
            value = _value(instruction, [registers[i] for i in instruction.args], point)
            registers.append(_NAN if isinstance(value, arb) and not value.is_finite() else value)
        return [registers[i] if isinstance(registers[i], arb) else _NAN for i in tape.outputs]
    finally:
        ctx.prec = before


def _value(instruction: Instruction, args: list[Any], point: Sequence[Fraction]) -> Any:
    op, value = instruction.op, instruction.value
    if op == "symbol":
        return _rational(point[int(value or 0)])
    if op == "number":
        return _rational(Fraction(value or 0))
    if op == "constant":
        return arb.pi() if value == "pi" else arb(1).exp()
    if op == "power":
        return _whole(args[0], int(value or 0))
    if op == "root":
        exponent = Fraction(value or 0)
        root = args[0].root(exponent.denominator) if args[0] >= 0 else _NAN
        return _whole(root, exponent.numerator)
    if op == "direction":
        return _direction(args, int(value or 0))
    if op == "table":
        return _table(args, *value)
    rule = _RULES.get(op)
    return rule(*args) if rule else _NAN


def _rational(value: Fraction) -> Ball:
    return arb(number(value))


def _whole(base: Ball, exponent: int) -> Ball:
    return base**exponent if exponent >= 0 or not base.contains(0) else _NAN


def _sign(a: Ball) -> Ball:
    return arb(1) if a > 0 else arb(-1) if a < 0 else arb(0) if a.is_zero() else _NAN


def _norm(*parts: Ball) -> Ball:
    return sum((a**2 for a in parts), start=arb(0)).sqrt() if all(a.is_finite() for a in parts) else _NAN


def _direction(parts: Sequence[Ball], index: int) -> Ball:
    """Undefined at 0."""
    if len(parts) == 1:
        return _NAN if parts[0].contains(0) else _sign(parts[0])
    size = _norm(*parts)
    return parts[index] / size if size > 0 else _NAN


def _step(a: Ball, at_zero: Ball = None) -> Ball:
    """Heaviside; SymPy's value at 0 is 1/2 unless it is given."""
    middle = arb(fmpq(1, 2)) if at_zero is None else at_zero
    return arb(1) if a > 0 else arb(0) if a < 0 else middle if a.is_zero() else _NAN


def _table(place: Sequence[Ball], cells: Cells, order: Index) -> Ball:
    """A derivative of a table by the cells that the balls meet; undefined where it may jump among them."""
    if not all(a.is_finite() for a in place):
        return _NAN
    spans = cells.met(list(map(ends, place)))
    if not all(cells.continuous(spans, order)):
        return _NAN
    values, pieces = [], cells.of_order(order)
    for cell in over(spans):
        d = [a - _rational(start) for a, start in zip(place, cells.starts(cell), strict=True)]
        values.append(polynomial_value(pieces[cell], d, _rational))
    return reduce(arb.union, values)


def _rounded(a: Ball, value: Ball) -> Ball:
    return value if a.is_finite() and value.is_exact() else _NAN


def _equal(a: Ball, b: Ball) -> bool | None:
    return False if a < b or a > b else True if a.is_exact() and b.is_exact() and a == b else None


def _not(a: bool | None) -> bool | None:
    return None if a is None else not a


def _both(a: bool | None, b: bool | None) -> bool | None:
    return False if a is False or b is False else None if a is None or b is None else True


def _piecewise(*parts: Any) -> Ball:
    """The first value whose condition holds; conditions before it must be known not to."""
    for value, condition in zip(parts[::2], parts[1::2], strict=True):
        if condition is None:
            return _NAN
        if condition:
            return value
    return _NAN


_RULES: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "mul": lambda a, b: a * b,
    "min": lambda a, b: a.min(b) if a.is_finite() and b.is_finite() else _NAN,
    "max": lambda a, b: a.max(b) if a.is_finite() and b.is_finite() else _NAN,
    "raise": lambda base, exponent: (exponent * base.log()).exp() if base > 0 else _NAN,
    "exp": arb.exp,
    "log": lambda a: a.log() if a > 0 else _NAN,
    "abs": abs,
    "norm": _norm,
    "sign": _sign,
    "heaviside": _step,
    "atan2": lambda y, x: arb.atan2(y, x) if x > 0 or y > 0 or y < 0 else _NAN,
    "floor": lambda a: _rounded(a, a.floor()),
    "ceiling": lambda a: _rounded(a, a.ceil()),
    "less": lambda a, b: True if a < b else False if a >= b else None,
    "less_equal": lambda a, b: True if a <= b else False if a > b else None,
    "equal": _equal,
    "unequal": lambda a, b: _not(_equal(a, b)),
    "not": _not,
    "and": _both,
    "or": lambda a, b: _not(_both(_not(a), _not(b))),
    "true": lambda: True,
    "false": lambda: False,
    "piecewise": _piecewise,
    **{name: getattr(arb, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")},
    **{name: getattr(arb, name) for name in ("asinh", "acosh", "atanh")},
}
