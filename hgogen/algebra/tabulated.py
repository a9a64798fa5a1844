"""Tables in expressions: ocv(x) is a function of SymPy whose class holds the table, and ocv(x, 1) its derivative.

Of two arguments they are friction(v, T), and friction(v, T, 1, 0) and friction(v, T, 0, 1).

Where a derivative jumps, it is the set of what lies between its limits (`algebra.kinks` says why), and an exact number
put there stays unevaluated. `Kinked` are those that are continuous with a derivative that jumps somewhere, `Stepped`
those that jump themselves.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from hashlib import sha256
from typing import Any, ClassVar

import numpy as np
import sympy as sp
from sympy.core.function import FunctionClass

from hgogen.algebra.cells import Cells, Index
from hgogen.algebra.piece import columns, value


class Table(sp.Function):  # type: ignore[misc]
    """A derivative of a table, of the `order` in each argument."""

    cells: ClassVar[Cells]
    order: ClassVar[Index]
    is_real = True

    @classmethod
    def eval(cls, *arguments: sp.Expr) -> sp.Expr | None:
        """The exact value at rational numbers, where there is one."""
        place = [_exactly(argument) for argument in arguments]
        numbers = [number for number in place if number is not None]
        exact = cls.cells.at(numbers, cls.order) if len(numbers) == len(place) else None
        return None if exact is None else _number(exact)

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """The derivative by an argument."""
        return applied(self.cells, self.args, next_order(self.order, argindex - 1))

    def _eval_evalf(self, prec: int) -> sp.Expr | None:
        digits = int(prec / 3.32)
        place = [argument.evalf(n=digits + 5) for argument in self.args]
        if isinstance(self, Stepped) or not all(isinstance(each, sp.Float) for each in place):
            return None
        exactly = map(sp.Rational, place)
        exact = self.cells.at([Fraction(int(each.p), int(each.q)) for each in exactly], self.order)
        return None if exact is None else _number(exact).evalf(n=digits + 1)

    def _sympystr(self, printer: Any) -> str:
        if hasattr(printer, "table"):
            return str(printer.table(self))
        order = self.order if any(self.order) else ()
        return f"{self.cells.name}({', '.join([*map(printer.doprint, self.args), *map(str, order)])})"

    def _latex(self, printer: Any, exp: str | None = None) -> str:
        inner, name = ", ".join(map(printer.doprint, self.args)), rf"\mathrm{{{self.cells.name}}}".replace("_", r"\_")
        several = rf"^{{\left({','.join(map(str, self.order))}\right)}}" if any(self.order) else ""
        primes = chr(39) * self.order[0] if len(self.order) == 1 else several
        text = rf"{name}{primes}\left({inner}\right)"
        return text if exp is None else rf"\left({text}\right)^{{{exp}}}"

    def __reduce_ex__(self, protocol: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return applied, (self.cells, self.args, self.order)


class Kinked(Table):
    """One that is continuous and has a derivative that jumps."""


class Stepped(Table):
    """One that jumps."""


def applied(cells: Cells, arguments: Sequence[sp.Expr], order: Index = ()) -> sp.Expr:
    """A derivative of a table, of the table itself by default, at expressions."""
    return function(cells, order or cells.plain)(*arguments)


def replaced(expression: sp.Expr, cells: Callable[[Table], Cells]) -> sp.Expr:
    """The expression with every table replaced by the one that stands for it, at the same arguments."""
    if not expression.has(Table):
        return expression
    return expression.replace(
        lambda node: isinstance(node, Table), lambda node: applied(cells(node), node.args, node.order)
    )


def held(expression: sp.Expr) -> sp.Expr:
    """The expression with every table held at its ends, as programs compute it: where arguments may leave its points,
    what stands for it between them is another function."""
    return replaced(expression, lambda node: node.cells.holding())


def next_order(order: Index, k: int) -> Index:
    """The order of the derivative by argument k, from 0."""
    return (*order[:k], order[k] + 1, *order[k + 1 :])


@cache
def function(cells: Cells, order: Index) -> FunctionClass:
    """The function of SymPy that a derivative is; the same one for the same table."""
    left = min(smooth - k for smooth, k in zip(cells.smoothness, order, strict=True))
    kind = Stepped if left < 0 else Kinked if left == 0 else Table
    held = {"cells": cells, "order": order, "nargs": len(order), "__module__": __name__}
    held["_imp_"] = staticmethod(_floats(cells, order))
    within = (f"within_{k}" for k, axis in enumerate(cells.axes) if not axis.held)
    roundings = (f"near_{sha256(repr(axis.rounded).encode()).hexdigest()[:16]}" for axis in cells.axes if axis.rounded)
    parts = (cells.name, *within, *roundings, *(map(str, order) if any(order) else ()))
    return FunctionClass("__".join(parts), (kind,), held)  # for lambdify, a name that no other table has


def _floats(cells: Cells, order: Index) -> Callable[..., Any]:
    """The function of numpy's arrays."""
    breaks = [np.array(list(map(float, axis.x))) for axis in cells.axes]
    starts = [np.array(list(map(float, axis.starts))) for axis in cells.axes]
    shape = [len(each) for each in starts]
    coefficients = _arrays(columns(list(cells.of_order(order).values())), shape)

    def function(*place: Any) -> Any:
        cell = tuple(np.searchsorted(each, t, side="right") for each, t in zip(breaks, place, strict=True))
        d = [t - each[k] for each, k, t in zip(starts, cell, place, strict=True)]
        return value(coefficients, d, lambda column: column[cell])

    return function


def _arrays(coefficients: Any, shape: list[int]) -> Any:
    if isinstance(coefficients, tuple):
        return tuple(_arrays(c, shape) for c in coefficients)
    return np.array(list(map(float, coefficients))).reshape(shape)


def _exactly(argument: sp.Expr) -> Fraction | None:
    """The number that an argument is."""
    if isinstance(argument, sp.Float):
        return Fraction(repr(float(argument)))
    return Fraction(int(argument.p), int(argument.q)) if isinstance(argument, sp.Rational) else None


def _number(exact: Fraction) -> sp.Rational:
    return sp.Rational(exact.numerator, exact.denominator)
