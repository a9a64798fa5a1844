"""One look at a box without bisection: an interval that holds an expression's values, outward-rounded."""

import math
from fractions import Fraction
from typing import TypeAlias

import sympy as sp

from hgogen.algebra.points import STRANGE, exact
from hgogen.algebra.tape import NoTape, tape
from hgogen.intervals.box import EVERYTHING, Box, End, sides
from hgogen.intervals.enclosure import enclose as enclosures
from hgogen.intervals.rounding import rounded

Interval: TypeAlias = tuple[End, End]


def enclose(expression: sp.Expr, box: Box) -> Interval:
    """An interval that holds the values of the expression on the box, where it and its parts are real; it is exact for
    a rational number and for a symbol. A function without a rule may have any value."""
    fixed, around = sides(exact(expression), box)
    if fixed.is_Rational:
        value = Fraction(fixed)
        return value, value
    if fixed in around.symbols:
        return around.ends[around.symbols.index(fixed)]
    if fixed.has(*STRANGE):
        return EVERYTHING
    try:
        program = tape([rounded(fixed, around)], around.symbols)
    except NoTape:
        return EVERYTHING
    low, high = around.outer
    (enclosure,) = enclosures(program, low[:, None], high[:, None])
    return float(enclosure.value[0][0]), float(enclosure.value[1][0])


def contains_zero(interval: Interval) -> bool:
    """Whether zero lies in the closed interval."""
    return interval[0] <= 0 <= interval[1]


def finite(interval: Interval) -> bool:
    """Whether both ends are finite."""
    return abs(interval[0]) != math.inf and abs(interval[1]) != math.inf
