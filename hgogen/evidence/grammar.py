"""Exact values in the grammar of a certificate: numbers and expressions as texts, a bisection in prefix order."""

import math
from collections.abc import Iterable, Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from hgogen.algebra.interpolation import Table
from hgogen.algebra.points import exact
from hgogen.algebra.tape import plain
from hgogen.form import Form
from hgogen.intervals.bounds import Proof, Range
from hgogen.intervals.digits import up

_DIGITS = 12


def text(form: Form, expression: sp.Expr) -> str:
    """An expression of a form, or of its plant."""
    names = {s.name for s in (*form.system.signals, *form.states)}
    if form.system.origin is not None:
        names |= {s.name for s in form.system.origin.plant.signals}
    return spelled(expression, names)


def spelled(expression: sp.Expr, names: set[str]) -> str:
    """An expression of these names."""
    return str(_Printer(names).doprint(exact(plain(sp.sympify(expression)))))


def exactly(form: Form, value: Any) -> Any:
    """A number or an expression as an exact text, or a list or a mapping of them; a text, or None, as it is."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return {key: exactly(form, each) for key, each in value.items()}
    if isinstance(value, Iterable):
        return [exactly(form, each) for each in value]
    return text(form, value) if isinstance(value, sp.Basic) else str(Fraction(value))


def end(value: Fraction | float) -> str | None:
    """An end of a range, None for an infinite one."""
    return None if abs(value) == math.inf else str(Fraction(value))


def outward(value: float | Fraction, way: int) -> Fraction:
    """A number of 12 significant digits at or above the value (`way` 1), or at or below it (-1)."""
    if not value:
        return Fraction(0)
    step: Fraction = Fraction(10) ** (Decimal(up(abs(Fraction(value)))).adjusted() + 1 - _DIGITS)
    steps = Fraction(value) / step
    return step * (math.ceil(steps) if way > 0 else math.floor(steps))


def tree(bisection: Range | Proof, form: Form | None = None) -> str:
    """The text of a bisection, in the form's coordinates, or in the plant's without a form."""
    images = _mirrored(form) if form else {}
    names = [images.get(s, (s.name, False)) for s in bisection.variables]
    tokens: list[str] = []
    left: list[Any] = [bisection.tree]
    while left:
        node = left.pop()
        if isinstance(node, str):
            tokens.append(".")
            continue
        _, index, first, second = node
        name, mirrored = names[int(index)]
        tokens.append(name)
        left += [first, second] if mirrored else [second, first]
    return " ".join(tokens)


def _mirrored(form: Form) -> dict[sp.Symbol, tuple[str, bool]]:
    """Each state of the plant as the name of the form's state that it is, and whether its sign is changed."""
    names = {}
    for x, image in zip(form.system.states, form.from_form, strict=True):
        if image in form.states or -image in form.states:
            names[x] = (str(abs(image.as_coeff_Mul()[0]) * image.as_coeff_Mul()[1]), image not in form.states)
    return names


def _short(number: Fraction) -> str:
    """An exact number, as a decimal where a float's shortest one is it."""
    decimal = repr(float(number))
    return str(number) if number.denominator == 1 or Fraction(decimal) != number else decimal


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's text with rationals for floats, exp(1) for e."""

    def __init__(self, names: set[str]) -> None:
        super().__init__()
        self.names = names

    def _print_Exp1(self, expression: sp.Expr) -> str:
        return "exp(1)"

    def table(self, node: Table) -> str:
        """A derivative of a table, with all its points."""
        cells = node.cells
        if len(node.args) == 1:
            points = zip(cells.axes[0].x, cells.values, strict=True)
            name, numbers = cells.kind.capitalize(), [number for point in points for number in point]
        else:  # how many breakpoints the first argument has, those of both, and the values row by row
            x, y = (axis.x for axis in cells.axes)
            name, numbers = f"Bi{cells.kind}", [Fraction(len(x)), *x, *y, *(z for row in cells.values for z in row)]
        parts = (*map(self.doprint, node.args), *node.order, *map(_short, numbers))
        return f"{name}({', '.join(map(str, parts))})"

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "4*atan(1)" if "pi" in self.names else "pi"
