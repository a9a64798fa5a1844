"""Tables at the door: `hg.table`, a function by points, in a model, of one argument or of two."""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from numbers import Rational
from typing import Any

import sympy as sp

from hgogen.errors import BadArgument
from hgogen.reading.expression import FUNCTIONS
from hgogen.reading.given import among
from hgogen.rigor.lookup import KINDS, SEVERAL, Axis, Cells, applied
from hgogen.signal import check_name

Numbers = tuple[Fraction, ...]
_WHAT = ("xs", "ys")  # of the axes
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

    Of two expressions it is a map, hg.table((x, y), (xs, ys), zs): bilinear between the lines of the grid and held at
    its ends, Lipschitz with kinks at those lines. `zs` (len(xs), len(ys)) has a row for each of xs, as of SciPy's
    RegularGridInterpolator.

    Raises: `BadTable` for fewer than two points, lists of different lengths, what is no finite number, `xs` that do not
    increase, an `x` that is no real expression, a map that is not linear, more than two expressions; `BadName`.
    """
    arguments: list[Any] = [x]
    axes: list[Any] = [xs]
    if isinstance(x, tuple | list) and len(x) > 1:
        if len(x) > 2:
            fix = "write it as a sum or product of such, or as a formula"
            raise BadTable(name, f"is taken at {len(x)} expressions, and a table is a function of one or two; {fix}")
        if not isinstance(xs, tuple | list) or len(xs) != 2 or not all(isinstance(each, Iterable) for each in xs):
            taken = f"is taken at 2 expressions and its axes are {xs!r:.60}"
            raise BadTable(name, f"{taken}; give two lists of numbers, (xs, ys)")
        arguments, axes = list(x), list(xs)
    cells = cells_of(axes, ys, kind, name)
    return applied(cells, [_argument(name, each) for each in arguments])


def _argument(name: str, x: Any) -> sp.Expr:
    try:
        argument = sp.sympify(x, strict=True)
    except (sp.SympifyError, TypeError):
        raise BadTable(name, f"is taken at {x!r}; give an expression of the model's signals, such as a state") from None
    if not isinstance(argument, sp.Expr) or argument.is_Matrix or argument.is_real is False:
        raise BadTable(name, f"is taken at {argument}, no real expression; give one of the model's signals")
    return argument


def cells_of(axes: Sequence[Any], values: Any, kind: str, name: str) -> Cells:
    """The table of the numbers of its one or two axes, and of its values. Raises: as `table`."""
    check_name(name)
    if name in FUNCTIONS:
        raise BadTable(name, "has the name of a function; choose another")
    if not among(kind, KINDS):
        raise BadTable(name, f'kind = {kind!r} is none of its kinds; write "linear" or "monotone"')
    if len(axes) > 1 and kind not in SEVERAL:
        raise BadTable(name, f'is of two expressions and kind = {kind!r}; a map is linear in each: write "linear"')
    x = [_numbers(name, what, each) for what, each in zip(_WHAT, axes, strict=False)]
    numbers = _curve(name, x[0], values) if len(x) == 1 else _map(name, x, values)
    for what, each in zip(_WHAT, x, strict=False):
        if len(x) > 1 and len(set(each)) < 2:
            constant = ", ".join(f"{float(number):g}" for number in each[:3]) or "empty"
            fix = "give 2 numbers or more, or leave this axis out: a table of the other expression alone"
            raise BadTable(name, f"{what} is a constant, {constant}; {fix}")
        for k, (a, b) in enumerate(pairwise(each), 1):
            if not a < b:
                pair = f"{what} {k} and {k + 1}, {float(a):g} and {float(b):g}"
                raise BadTable(name, f"{pair}, do not increase; sort them")
    cells = Cells(name, kind, tuple(map(Axis, x)), numbers)
    if not _fits(cells):
        raise BadTable(name, "is too steep, or too large, for double precision; choose other units")
    return cells


def _curve(name: str, x: Numbers, values: Any) -> Numbers:
    y = _numbers(name, "ys", values)
    if len(x) != len(y):
        raise BadTable(name, f"has {len(x)} xs and {len(y)} ys; give a y for each x")
    if not 2 <= len(x) <= MOST:
        raise BadTable(name, f"has {len(x)} point{'s' * (len(x) != 1)}; give 2 to {MOST}")
    return y


def _map(name: str, axes: Sequence[Numbers], values: Any) -> tuple[Numbers, ...]:
    _demand_list(name, "zs", values, "a row of numbers for each of xs")
    rows = tuple(_numbers(name, f"row {k} of zs", row, ", number") for k, row in enumerate(values, 1))
    count, width = map(len, axes)
    if len(rows) != count or any(len(row) != width for row in rows):
        turned = len(rows) == width and all(len(row) == count for row in rows)
        fix = "transpose zs" if turned else f"give {count} rows, one for each of xs, of {width} numbers"
        lengths = " or ".join(map(str, sorted({len(row) for row in rows}))) or "no"
        shape = f"{len(rows)} row{'s' * (len(rows) != 1)} of {lengths} numbers"
        raise BadTable(name, f"has {count} xs, {width} ys, and in zs {shape}; {fix}")
    if count * width > MOST:
        raise BadTable(name, f"has {count} x {width} points; give {MOST} at most")
    return rows


def _fits(cells: Cells) -> bool:
    """Whether its breakpoints differ, and its numbers are finite, in double precision."""
    try:
        finite = all(math.isfinite(float(c)) for order in cells.orders for c in cells.of_order(order).flat)
        return finite and all(float(a) < float(b) for axis in cells.axes for a, b in pairwise(axis.x))
    except OverflowError:
        return False


def _numbers(name: str, what: str, values: Any, each: str = "") -> Numbers:
    _demand_list(name, what, values, "a list of numbers")
    return tuple(_number(name, f"{what}{each} {k}", value) for k, value in enumerate(values, 1))


def _demand_list(name: str, what: str, values: Any, fix: str) -> None:
    if isinstance(values, str | Mapping | set | sp.Basic) or not isinstance(values, Iterable):
        raise BadTable(name, f"{what} is {values!r:.60}; give {fix}")


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
