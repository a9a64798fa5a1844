"""Which sines and cosines of a graph are of small angles: what it clamps, and sums and products of that, is bounded.

    |x| <= 4.7 < 3 pi/2:  sin x and cos x need no more than one turn by pi, and no test of whether x can be turned

A bound is an interval of what an operation may give where it gives a number. Rounding may pass it by 2^-24 of its size
for each operation, for which 3 pi/2 leaves room.
"""

from collections.abc import Callable, Mapping
from math import inf, isnan

import casadi as ca

from hgogen.emit.elementary import SMALL

SMALL_SIN, SMALL_COS = -8, -9  # operations beside those of CasADi
_OF_SMALL = {ca.OP_SIN: SMALL_SIN, ca.OP_COS: SMALL_COS}
Bound = tuple[float, float]
_ANY = (-inf, inf)


def operations(function: ca.Function) -> list[int]:
    """The operation of each instruction of an SX function, with sines and cosines of small angles told apart."""
    bounds: dict[int, Bound] = {}
    codes = []
    for k in range(function.n_instructions()):
        op, read, wrote = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        codes.append(op)
        if op == ca.OP_OUTPUT:
            continue
        if op == ca.OP_CONST:
            value = function.instruction_constant(k)
            bounds[wrote[0]] = (value, value)
            continue
        of = [bounds.get(place, _ANY) for place in read] if op not in (ca.OP_INPUT, ca.OP_CALL) else []
        if op in _OF_SMALL and max(map(abs, of[0])) <= SMALL:
            codes[-1] = _OF_SMALL[op]
        bounds |= dict.fromkeys(wrote, _bound(op, of))
    return codes


def _bound(op: int, of: list[Bound]) -> Bound:
    """Of an operation on what is bounded."""
    low, high = _BOUNDS[op](*of) if op in _BOUNDS else _ANY
    return _ANY if isnan(low) or isnan(high) else (low, high)


def _product(a: Bound, b: Bound) -> Bound:
    ends = [x * y for x in a for y in b]
    return _ANY if any(map(isnan, ends)) else (min(ends), max(ends))


_BOUNDS: Mapping[int, Callable[..., Bound]] = {
    ca.OP_ADD: lambda a, b: (a[0] + b[0], a[1] + b[1]),
    ca.OP_SUB: lambda a, b: (a[0] - b[1], a[1] - b[0]),
    ca.OP_MUL: _product,
    ca.OP_NEG: lambda a: (-a[1], -a[0]),
    ca.OP_TWICE: lambda a: (2 * a[0], 2 * a[1]),
    ca.OP_SQ: lambda a: _product(a, a),
    ca.OP_FMIN: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    ca.OP_FMAX: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    ca.OP_SIN: lambda _: (-1.0, 1.0),
    ca.OP_COS: lambda _: (-1.0, 1.0),
}
