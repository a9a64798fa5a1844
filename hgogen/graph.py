"""The one door from SymPy, the language of the plant and of proof, to CasADi, that of all that follows."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import casadi as ca
import sympy as sp

from hgogen.errors import HgogenError


@dataclass(eq=False)
class NoGraph(HgogenError):
    """An expression that has no CasADi graph: a function hgogen does not know, or an undeclared symbol."""

    term: str
    expression: str

    def __str__(self) -> str:
        return (
            f"{self.term} in {self.expression} cannot become a graph; write it with the functions "
            f"{', '.join(sorted(kind.__name__ for kind in _FUNCTIONS))} and declared symbols"
        )


_FUNCTIONS: dict[type, Callable[..., Any]] = {
    sp.sin: ca.sin,
    sp.cos: ca.cos,
    sp.tan: ca.tan,
    sp.asin: ca.asin,
    sp.acos: ca.acos,
    sp.atan: ca.atan,
    sp.atan2: ca.atan2,
    sp.sinh: ca.sinh,
    sp.cosh: ca.cosh,
    sp.tanh: ca.tanh,
    sp.asinh: ca.asinh,
    sp.acosh: ca.acosh,
    sp.atanh: ca.atanh,
    sp.exp: ca.exp,
    sp.log: ca.log,
    sp.Abs: ca.fabs,
    sp.sign: ca.sign,
    sp.floor: ca.floor,
    sp.Min: lambda *args: reduce(ca.fmin, args),
    sp.Max: lambda *args: reduce(ca.fmax, args),
}
_RELATIONS: dict[type, Callable[[Any, Any], Any]] = {
    sp.StrictLessThan: lambda a, b: a < b,
    sp.LessThan: lambda a, b: a <= b,
    sp.StrictGreaterThan: lambda a, b: a > b,
    sp.GreaterThan: lambda a, b: a >= b,
    sp.Equality: lambda a, b: a == b,
    sp.Unequality: lambda a, b: a != b,
}


def to_casadi(expressions: Iterable[sp.Expr], symbols: Mapping[sp.Symbol, Any]) -> list[Any]:
    """The expressions as SX graphs, one scalar each; a subexpression is built once.

    Args: `symbols` maps every free symbol to an SX scalar (or a float, which is folded).

    Raises: `NoGraph`.
    """
    memo: dict[sp.Basic, Any] = {}
    return [ca.SX(_convert(expression, expression, symbols, memo)) for expression in expressions]


def _convert(node: sp.Basic, whole: sp.Basic, symbols: Mapping[sp.Symbol, Any], memo: dict[sp.Basic, Any]) -> Any:
    if node in memo:
        return memo[node]

    def inner(child: sp.Basic) -> Any:
        return _convert(child, whole, symbols, memo)

    if isinstance(node, sp.Symbol):
        if node not in symbols:
            raise NoGraph(f"the symbol {node}", str(whole))
        value = ca.SX(symbols[node])  # a float, too: Python's own 1 / 0.0 would raise
    elif isinstance(node, sp.Number | sp.NumberSymbol):
        value = ca.SX(float(node))
    elif isinstance(node, sp.Add):
        value = _sum([(term, inner) for term in node.as_ordered_terms()])
    elif isinstance(node, sp.Mul):
        value = _product(node, inner)
    elif isinstance(node, sp.Pow):
        value = _power(node, inner)
    elif isinstance(node, sp.Piecewise):
        value = ca.SX.nan()
        for branch, condition in reversed(node.args):
            value = inner(branch) if condition == sp.true else ca.if_else(inner(condition), inner(branch), value)
    elif type(node) in _RELATIONS:
        value = _RELATIONS[type(node)](inner(node.args[0]), inner(node.args[1]))
    elif isinstance(node, sp.And):
        value = reduce(ca.logic_and, map(inner, node.args))
    elif isinstance(node, sp.Or):
        value = reduce(ca.logic_or, map(inner, node.args))
    elif isinstance(node, sp.Not):
        value = ca.logic_not(inner(node.args[0]))
    elif type(node) in _FUNCTIONS:
        value = _FUNCTIONS[type(node)](*map(inner, node.args))
    else:
        raise NoGraph(f"{type(node).__name__}({', '.join(map(str, node.args))})", str(whole))
    memo[node] = value
    return value


def _sum(terms: list[tuple[sp.Expr, Callable[[sp.Basic], Any]]]) -> Any:
    """a - b stays a subtraction, so that the C reads as the formula does."""
    total: Any = None
    for term, inner in terms:
        negative = term.could_extract_minus_sign()
        value = inner(-term if negative else term)
        if total is None:
            total = -value if negative else value
        else:
            total = total - value if negative else total + value
    return total


def _product(node: sp.Mul, inner: Callable[[sp.Basic], Any]) -> Any:
    """Number times numerator over denominator: one multiplication by the number, no division by constants."""
    number, rest = node.as_coeff_Mul()
    numerator, denominator = sp.fraction(rest, exact=True)
    value = reduce(lambda a, b: a * b, map(inner, sp.Mul.make_args(numerator)))
    if denominator != 1:
        value = value / inner(denominator)
    if number == -1:
        return -value
    return value if number == 1 else ca.SX(float(number)) * value


def _power(node: sp.Pow, inner: Callable[[sp.Basic], Any]) -> Any:
    base, exponent = node.as_base_exp() if node.exp.is_number else (node.base, node.exp)
    if base == sp.E:
        return ca.exp(inner(exponent))
    if exponent == sp.S.Half:
        return ca.sqrt(inner(base))
    if exponent.is_Integer:
        if exponent < 0:
            return 1 / inner(base ** (-exponent)) if exponent != -1 else 1 / inner(base)
        return _repeated(inner(base), int(exponent))
    if exponent.is_Rational and exponent.q == 2:
        root = ca.sqrt(inner(base))
        whole = _repeated(inner(base), abs(int(exponent.p)) // 2) * root
        return whole if exponent.p > 0 else 1 / whole
    return ca.power(inner(base), inner(exponent))


def _repeated(base: Any, times: int) -> Any:
    """base ** times by squaring: real powers are no C of ours."""
    if times == 0:
        return ca.SX(1)
    half = _repeated(base, times // 2)
    square = half * half if times > 1 else ca.SX(1)
    return square * base if times % 2 else square
