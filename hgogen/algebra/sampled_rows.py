"""Expressions as a function of arrays, in floats: for what is found by samples, and proved of none."""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
import sympy as sp

# for SymPy's own, of which version 1.13 makes an array of all arguments, which a number beside arrays does not let it
_EXTREMES = {sp.Min: sp.Function("least_of"), sp.Max: sp.Function("most_of")}
_FUNCTIONS = {
    "least_of": lambda *arguments: reduce(np.minimum, arguments),
    "most_of": lambda *arguments: reduce(np.maximum, arguments),
}


def on_arrays(symbols: Sequence[sp.Symbol], rows: Sequence[sp.Expr]) -> Callable[..., list[Any]]:
    """The values of rows where the symbols are arrays; of a row that reads none a number. A symbol may have the name of
    a function."""
    replaced = [sp.sympify(row).replace(lambda e: type(e) in _EXTREMES, _named) for row in rows]
    function: Callable[..., list[Any]] = sp.lambdify(symbols, replaced, [_FUNCTIONS, "numpy"], dummify=True)
    return function


def _named(extreme: sp.Expr) -> sp.Expr:
    return _EXTREMES[type(extreme)](*extreme.args)
