"""What elementary functions are made of beside + - * /, comparison and selection: functions that each reader of a graph
knows by their names and carries out in its own way, with the same bits.

    nearest(v)        the whole number nearest to v, of two the even one
    power_of_two(k)   2^k for whole k, where that is a normal number

A sum of v and 3/2 2^(n-1), n the bits of the significand, is rounded to a whole number, whose last bits are those of
the whole number nearest to v. With the bias of the exponent added, a shift by n - 1 leaves them where 2^k has its own.
"""

from collections.abc import Mapping
from functools import cache
from typing import Literal

import casadi as ca

Real = Literal["float", "double"]

NEAREST, POWER_OF_TWO = "nearest", "power_of_two"

SHIFT: Mapping[Real, int] = {"float": 23, "double": 52}  # bits of the significand that are stored
BIAS: Mapping[Real, int] = {"float": 127, "double": 1023}  # of the exponent
ALL_WHOLE: Mapping[Real, float] = {"float": 2.0**23, "double": 2.0**52}  # numbers from here on are whole
ROUNDS: Mapping[Real, float] = {real: 1.5 * whole for real, whole in ALL_WHOLE.items()}
BIASED: Mapping[Real, float] = {real: rounds + BIAS[real] for real, rounds in ROUNDS.items()}


@cache
def nearest(real: Real) -> ca.Function:
    """The first of them as CasADi computes it: v + C - C, where C and its neighbours are whole numbers.

    CasADi would make v of it; so the sum is a call, and the result goes through floor, whose slope is 0.
    """
    v, C = ca.SX.sym("v"), ROUNDS[real]
    add = ca.Function("add", [v], [v + C], {"never_inline": True})
    return ca.Function(NEAREST, [v], [ca.floor(add(v) - C + 0.25)], {"never_inline": True})
