"""Tables at the door: `hg.table`, a function by points, in a model."""

import math
from collections.abc import Iterable, Mapping
from fractions import Fraction
from itertools import pairwise
from numbers import Rational
from typing import Any

import sympy as sp

from hgogen.algebra.cells import Cells
from hgogen.algebra.tabulated import applied
from hgogen.errors import BadArgument
from hgogen.reading.expression import FUNCTIONS
from hgogen.signal import check_name

KINDS = ("linear", "monotone")
MOST = 2000  # points, so that a certificate holds their text, 100 000 characters, with all digits of double precision


class BadTable(BadArgument):
    """A table that is none; the sentence names it and the fix."""

    text = "table {what!r}: {reason}"


def table(x: Any, xs: Iterable[Any], ys: Iterable[Any], *, kind: str = "linear", name: str = "table") -> sp.Expr:
    """The value at `x`, an expression of a model, of the function through the points (xs, ys).

    Below the first point and above the last it is constant: it is held at its ends. `kind`: "linear" between two
    points, Lipschitz with kinks at the points; or "monotone", cubics that rise and fall with the points and turn
    nowhere else (Fritsch and Carlson's conditions, Fritsch and Butland's slopes, as in PCHIP), which have one
    continuous derivative between the ends. `name`: what it is called in reports and in the emitted code.

    Raises: `BadTable` for fewer than two points, lists of different lengths, what is no finite number, `xs` that do not
    increase, an `x` that is no real expression; `BadName`.
    """
    if isinstance(x, tuple | list) and len(x) > 1:
        fix = "write it as a sum or product of tables of one, or as a formula"
        raise BadTable(name, f"is taken at {len(x)} expressions, and a table is a function of one; {fix}")
    cells = cells_of(xs, ys, kind, name)
    try:
        argument = sp.sympify(x, strict=True)
    except (sp.SympifyError, TypeError):
        raise BadTable(name, f"is taken at {x!r}; give an expression of the model's signals, such as a state") from None
    if not isinstance(argument, sp.Expr) or argument.is_Matrix or argument.is_real is False:
        raise BadTable(name, f"is taken at {argument}, no real expression; give one of the model's signals")
    return applied(cells, argument)


def cells_of(xs: Iterable[Any], ys: Iterable[Any], kind: str, name: str) -> Cells:
    """The table of these points. Raises: as `table`."""
    check_name(name)
    if name in FUNCTIONS:
        raise BadTable(name, "has the name of a function; choose another")
    if kind not in KINDS:
        raise BadTable(name, f'kind = {kind!r} is none of its kinds; write "linear" or "monotone"')
    x, y = _numbers(name, "xs", xs), _numbers(name, "ys", ys)
    if len(x) != len(y):
        raise BadTable(name, f"has {len(x)} xs and {len(y)} ys; give a y for each x")
    if not 2 <= len(x) <= MOST:
        raise BadTable(name, f"has {len(x)} point{'s' * (len(x) != 1)}; give 2 to {MOST}")
    for k, (a, b) in enumerate(pairwise(x)):
        if not a < b:
            raise BadTable(name, f"xs {k + 1} and {k + 2}, {float(a):g} and {float(b):g}, do not increase; sort them")
    cells = Cells(name, kind, x, y)
    if not _fits(cells):
        raise BadTable(name, "is too steep, or too large, for double precision; choose other units")
    return cells


def _fits(cells: Cells) -> bool:
    """Whether its breakpoints differ, and its numbers are finite, in double precision."""
    try:
        finite = all(math.isfinite(float(c)) for pieces in cells.derivatives for piece in pieces for c in piece)
        return finite and all(float(a) < float(b) for a, b in pairwise(cells.x))
    except OverflowError:
        return False


def _numbers(name: str, what: str, values: Any) -> tuple[Fraction, ...]:
    if isinstance(values, str | Mapping | set | sp.Basic) or not isinstance(values, Iterable):
        raise BadTable(name, f"{what} is {values!r:.60}; give a list of numbers")
    return tuple(_number(name, f"{what} {k}", value) for k, value in enumerate(values, 1))


def _number(name: str, what: str, value: Any) -> Fraction:
    """The exact number, of a float the one of its shortest decimal."""
    if isinstance(value, sp.Rational):
        return Fraction(int(value.p), int(value.q))
    if isinstance(value, Rational) and not isinstance(value, bool):
        return Fraction(value)
    try:
        number = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadTable(name, f"{what} is {value!r:.60}, no finite number; give one")
    return Fraction(repr(number))
