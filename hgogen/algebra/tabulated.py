"""Tables in expressions: ocv(x) is a function of SymPy whose class holds the table, and ocv(x, 1) its derivative.

Where a derivative jumps, it is the set of what lies between its limits (`algebra.kinks` says why), and an exact number
put there stays unevaluated. `Kinked` are those that are continuous with a derivative that jumps somewhere, `Stepped`
those that jump themselves.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any, ClassVar

import numpy as np
import sympy as sp
from sympy.core.function import FunctionClass

from hgogen.algebra.cells import Cells


class Table(sp.Function):  # type: ignore[misc]
    """A derivative of a table, of the order `order`, 0 for the table itself."""

    cells: ClassVar[Cells]
    order: ClassVar[int]
    nargs = 1
    is_real = True

    @classmethod
    def eval(cls, argument: sp.Expr) -> sp.Expr | None:
        """The exact value at a rational number, where there is one."""
        if isinstance(argument, sp.Float):
            place = Fraction(repr(float(argument)))
        elif isinstance(argument, sp.Rational):
            place = Fraction(int(argument.p), int(argument.q))
        else:
            return None
        value = cls.cells.at(place, cls.order)
        return None if value is None else _number(value)

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """The derivative of the next order."""
        return applied(self.cells, self.args[0], self.order + 1)

    def _eval_evalf(self, prec: int) -> sp.Expr | None:
        place = self.args[0].evalf(n=int(prec / 3.32) + 5)
        if isinstance(self, Stepped) or not isinstance(place, sp.Float):
            return None
        exactly = sp.Rational(place)
        value = self.cells.at(Fraction(int(exactly.p), int(exactly.q)), self.order)
        return None if value is None else _number(value).evalf(n=int(prec / 3.32) + 1)

    def _sympystr(self, printer: Any) -> str:
        if hasattr(printer, "table"):
            return str(printer.table(self))
        inner = printer.doprint(self.args[0])
        return f"{self.cells.name}({inner}, {self.order})" if self.order else f"{self.cells.name}({inner})"

    def _latex(self, printer: Any, exp: str | None = None) -> str:
        inner, name = printer.doprint(self.args[0]), rf"\mathrm{{{self.cells.name}}}".replace("_", r"\_")
        text = rf"{name}{chr(39) * self.order}\left({inner}\right)"
        return text if exp is None else rf"\left({text}\right)^{{{exp}}}"

    def __reduce_ex__(self, protocol: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return applied, (self.cells, self.args[0], self.order)


class Kinked(Table):
    """One that is continuous and has a derivative that jumps."""


class Stepped(Table):
    """One that jumps."""


def applied(cells: Cells, argument: sp.Expr, order: int = 0) -> sp.Expr:
    """A derivative of a table, at an expression."""
    return function(cells, order)(argument)


@cache
def function(cells: Cells, order: int) -> FunctionClass:
    """The function of SymPy that a derivative is; the same one for the same table."""
    left = cells.smoothness - order
    kind = Stepped if left < 0 else Kinked if left == 0 else Table
    held = {"cells": cells, "order": order, "_imp_": staticmethod(_floats(cells, order)), "__module__": __name__}
    name = f"{cells.name}{'' if cells.held else '_within'}{f'_{order}' if order else ''}"  # of its own for lambdify
    return FunctionClass(name, (kind,), held)


def _floats(cells: Cells, order: int) -> Callable[[Any], Any]:
    """The function of numpy's arrays."""
    breaks, starts = (np.array(list(map(float, numbers))) for numbers in (cells.x, cells.starts))
    pieces = cells.of_order(order)
    degree = max(map(len, pieces))
    columns = np.array([[float(c) for c in (*piece, *[0] * (degree - len(piece)))] for piece in pieces]).T

    def function(t: Any) -> Any:
        k = np.searchsorted(breaks, t, side="right")
        d, total = t - starts[k], columns[-1][k]
        for column in columns[-2::-1]:
            total = total * d + column[k]
        return total

    return function


def _number(value: Fraction) -> sp.Rational:
    return sp.Rational(value.numerator, value.denominator)
