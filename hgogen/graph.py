"""The conversion between SymPy, the language of the plant and of proofs, and CasADi, the language of programs."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from typing import Any, TypeAlias

import casadi as ca
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.functions import NAMES, refusal
from hgogen.rigor.lookup import Lookup, Table, folded
from hgogen.rigor.singular import resolved, with_limits
from hgogen.rigor.tape import plain

Graph: TypeAlias = Any  # an SX, MX or DM of any shape: one code takes all three, and CasADi has no type for that


@dataclass(eq=False)
class NoGraph(HgogenError):
    """The error for an expression that has no CasADi graph: it contains an unknown function, or an undeclared
    symbol."""

    term: str
    expression: str

    def __str__(self) -> str:
        write = f"write it with the functions {', '.join(NAMES)} and declared symbols"
        return f"{self.term} in {self.expression} cannot become a graph; {write}"


# options of every integration by CVODES: many steps, and no printing
CVODES = {"max_num_steps": 100_000, "show_eval_warnings": False, "disable_internal_warnings": True}

_FUNCTIONS: dict[type, Callable[..., Graph]] = {
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
_CONDITIONS: dict[type, Callable[..., Graph]] = {
    sp.StrictLessThan: lambda a, b: a < b,
    sp.LessThan: lambda a, b: a <= b,
    sp.StrictGreaterThan: lambda a, b: a > b,
    sp.GreaterThan: lambda a, b: a >= b,
    sp.Equality: lambda a, b: a == b,
    sp.Unequality: lambda a, b: a != b,
    sp.And: lambda *args: reduce(ca.logic_and, args),
    sp.Or: lambda *args: reduce(ca.logic_or, args),
    sp.Not: ca.logic_not,
}
_OPERATIONS = {**_FUNCTIONS, **_CONDITIONS}  # of all arguments at once


def sx(value: Graph) -> Graph:
    """Return a number, a matrix or an SX as an SX. An SX itself is returned without a copy, which would cost as much as
    a sum; the caller must not change it."""
    return value if isinstance(value, ca.SX) else ca.SX(value)


def dense(value: Graph) -> Graph:
    """Return the value as an SX whose every element is stored. The caller must not change it."""
    value = sx(value)
    return value if value.is_dense() else ca.densify(value)


def binary(operation: int, a: Graph, b: Graph) -> Graph:
    """Return the result of a CasADi operation, such as ca.OP_ADD, on an SX and another SX or a number. CasADi's
    operators give the same result, and take ten times as long to determine the type of each operand."""
    return ca.SX.binary(operation, a, b)


def is_outside(value: Graph, low: float, high: float) -> Graph:
    """Return an SX that is 1 if the value is below `low` or above `high`, else 0."""
    return binary(ca.OP_OR, binary(ca.OP_LT, value, low), binary(ca.OP_LT, high, value))


def wrapped(difference: Graph, period: float | None) -> Graph:
    """Return the difference d of two angles of `period` P the short way round, in [-P/2, P/2); d itself without a
    period; SX.

            d - k P,   k = floor(d/P + 1/2),   subtracted in two parts of P: k times the first, of 12 bits, is exact

    So up to 2^10 turns cost no digits that the difference has, in float as in double; 0 turns change nothing.
    """
    if period is None:
        return difference
    mantissa, power = math.frexp(period)
    first = math.ldexp(math.floor(math.ldexp(mantissa, 12)), power - 12)
    turns = ca.floor(difference * (1 / period) + 0.5)
    return difference - turns * first - turns * (period - first)


def turned(angle: Graph, low: float, period: float) -> Graph:
    """Return the angle plus the whole number of periods that brings it into [low, low + period), SX."""
    middle = low + period / 2
    return wrapped(angle, period) if middle == 0 else middle + wrapped(angle - middle, period)


def to_casadi(expressions: Iterable[sp.Expr], symbols: Mapping[sp.Symbol, Graph]) -> list[Graph]:
    """Return the expressions as SX graphs, one scalar each, without removable singularities; a subexpression is built
    once.

    Args: `symbols` maps every free symbol to an SX scalar (or a float, which is folded).

    Raises: `NoGraph`.
    """
    memo: dict[sp.Basic, Graph] = {}
    rows = (with_limits(resolved(plain(each))) for each in expressions)
    return [sx(_convert(each, each, symbols, memo)) for each in rows]


def _convert(node: sp.Basic, whole: sp.Basic, symbols: Mapping[sp.Symbol, Graph], memo: dict[sp.Basic, Graph]) -> Graph:
    if node in memo:
        return memo[node]

    def inner(child: sp.Basic) -> Graph:
        return _convert(child, whole, symbols, memo)

    value: Graph
    if isinstance(node, sp.Symbol):
        if node not in symbols:
            raise NoGraph(f"the symbol {node}", str(whole))
        value = sx(symbols[node])  # a float, too: Python's own 1 / 0.0 would raise
    elif isinstance(node, sp.Number | sp.NumberSymbol):
        value = ca.SX(float(node))
    elif isinstance(node, sp.Add) and node.is_real and not node.free_symbols:
        value = ca.SX(float(node.evalf(17)))  # by SymPy's digits: exp(pi sqrt 163) - 262537412640768744 is -7.5e-13
    elif rule := next((rule for kind, rule in _RULES.items() if isinstance(node, kind)), None):
        value = rule(node, inner)
    elif type(node) in _OPERATIONS:
        value = _OPERATIONS[type(node)](*map(inner, node.args))
    else:
        raise NoGraph(f"{type(node).__name__}({', '.join(map(str, node.args))})", str(whole))
    memo[node] = value
    return value


def _step(argument: sp.Expr, at_zero: sp.Expr) -> sp.Expr:
    one = (sp.S.One, argument >= 0 if at_zero == 1 else argument > 0)
    middle = () if at_zero in (0, 1) else ((at_zero, sp.Eq(argument, 0)),)
    return sp.Piecewise(one, *middle, (sp.S.Zero, True))


def _sum(node: sp.Add, inner: Callable[[sp.Basic], Graph]) -> Graph:
    """Return the sum as a graph, with a - b as a subtraction, so that the C reads as the formula does."""
    total: Graph = None
    for term, negative in _signed(node):
        value = inner(term)
        if total is None:
            total = -value if negative else value
        else:
            total = binary(ca.OP_SUB if negative else ca.OP_ADD, total, value)
    return total


@lru_cache(maxsize=1024)  # the same sums occur at each stage of a step
def _signed(node: sp.Add) -> tuple[tuple[sp.Expr, bool], ...]:
    signs = [(term, term.could_extract_minus_sign()) for term in _terms(node)]
    return tuple((-term if negative else term, negative) for term, negative in signs)


def _terms(node: sp.Add) -> list[sp.Expr]:
    if not any(re.search(r"\d\d", s.name) for s in node.free_symbols):
        return list(node.as_ordered_terms())
    counted = {s: re.sub(r"\d+", lambda digits: digits[0].zfill(6), s.name) for s in node.free_symbols}
    names = {s: sp.Symbol(name, **s.assumptions0) for s, name in counted.items()}
    terms = {term.xreplace(names): term for term in node.args}
    ordered = sp.Add(*terms).as_ordered_terms()
    return [terms[term] for term in ordered] if terms.keys() == {*ordered} else list(node.as_ordered_terms())


def _product(node: sp.Mul, inner: Callable[[sp.Basic], Graph]) -> Graph:
    """Return a product as the graph number * numerator/denominator, without division by constants."""
    number, quotient = node.as_coeff_Mul()
    numerator, denominator = sp.fraction(quotient, exact=True)
    value = reduce(partial(binary, ca.OP_MUL), map(inner, sp.Mul.make_args(numerator)))
    if denominator != 1:
        value = binary(ca.OP_DIV, value, inner(denominator))
    if number == -1:
        return -value
    return value if number == 1 else binary(ca.OP_MUL, ca.SX(float(number)), value)


def _power(node: sp.Pow, inner: Callable[[sp.Basic], Graph]) -> Graph:
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


def _piecewise(node: sp.Piecewise, inner: Callable[[sp.Basic], Graph]) -> Graph:
    """Return a Piecewise as a graph of nested choices, the
    first branch whose condition holds; NaN if none does."""
    value = ca.SX.nan()
    for branch, condition in reversed(node.args):
        value = inner(branch) if condition == sp.true else ca.if_else(inner(condition), inner(branch), value)
    return value


_RULES: dict[type, Callable[[Any, Callable[[sp.Basic], Graph]], Graph]] = {
    sp.Add: _sum,
    sp.Mul: _product,
    sp.Pow: _power,
    sp.Piecewise: _piecewise,
    sp.ceiling: lambda node, inner: -ca.floor(-inner(node.args[0])),
    sp.Heaviside: lambda node, inner: inner(_step(*node.args)),
    Table: lambda node, inner: Lookup(node.cells, node.order)(*map(inner, node.args)),
}


def _repeated(base: Graph, times: int) -> Graph:
    """Return base ** times by squaring: the emitted C has no real powers."""
    if times == 0:
        return ca.SX(1)
    half = _repeated(base, times // 2)
    square = binary(ca.OP_MUL, half, half) if times > 1 else ca.SX(1)
    return binary(ca.OP_MUL, square, base) if times % 2 else square


# --- from CasADi --------------------------------------------------------------------------------------------


@dataclass(eq=False)
class NoSymbols(HgogenError):
    """The error for a CasADi operation, or a constant, that has no SymPy expression here."""

    operation: str

    def __str__(self) -> str:
        return f"CasADi's {self.operation} has no expression in SymPy that hgogen can read: {refusal(self.operation)}"


def _value(term: sp.Basic) -> sp.Expr:
    return term if isinstance(term, sp.Expr) else sp.Piecewise((1, term), (0, True), evaluate=False)


def _condition(term: sp.Basic) -> sp.Basic:
    return sp.Ne(term, 0) if isinstance(term, sp.Expr) else term


def _chosen(condition: sp.Basic, value: sp.Expr) -> sp.Expr:
    condition = _condition(condition)
    if condition in (sp.true, sp.false):
        return value if condition == sp.true else sp.S.Zero
    return sp.Piecewise((value, condition), (0, True), evaluate=False)


def _added(a: sp.Expr, b: sp.Expr) -> sp.Expr:
    """Return a + b. CasADi splits if_else(c, x, y) into two terms; such a pair becomes one Piecewise."""
    halves = [t.args for t in (a, b) if isinstance(t, sp.Piecewise) and len(t.args) == 2 and t.args[1].expr == 0]
    if len(halves) == 2 and halves[1][0].cond == sp.Not(halves[0][0].cond):
        return sp.Piecewise(halves[0][0].args, (halves[1][0].expr, True), evaluate=False)
    return a + b


_ARITHMETIC: dict[int, Callable[..., sp.Basic]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_LIFT: lambda a, b: a,
    ca.OP_ADD: _added,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a: -a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_SQ: lambda a: a**2,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_SQRT: sp.sqrt,
    ca.OP_POW: lambda a, b: a**b,
    ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_EXPM1: lambda a: sp.exp(a) - 1,
    ca.OP_LOG1P: lambda a: sp.log(1 + a),
    ca.OP_HYPOT: lambda a, b: sp.sqrt(a**2 + b**2),
    ca.OP_FABS: sp.Abs,
    ca.OP_FMIN: sp.Min,
    ca.OP_FMAX: sp.Max,
    **{getattr(ca, f"OP_{kind.__name__.upper()}"): kind for kind in _FUNCTIONS if kind not in (sp.Abs, sp.Min, sp.Max)},
    ca.OP_CEIL: sp.ceiling,
    ca.OP_LT: sp.Lt,
    ca.OP_LE: sp.Le,
    ca.OP_EQ: sp.Eq,
    ca.OP_NE: sp.Ne,
}
_LOGIC: dict[int, Callable[..., sp.Basic]] = {ca.OP_NOT: sp.Not, ca.OP_AND: sp.And, ca.OP_OR: sp.Or}


def to_sympy(function: ca.Function, symbols: Sequence[Sequence[sp.Symbol]]) -> list[list[sp.Expr]]:
    """Return the outputs of an SX function, an expression for each nonzero of each output.

    Args: `symbols`: for each input its symbols, in CasADi's order (columns). A float becomes the rational of its
    shortest decimal, so 0.1 is 1/10 and pi a rational near it.

    Raises: `NoSymbols` for an operation without an expression, and for a constant that is not finite.
    """

    def constant(number: float) -> sp.Expr:
        if not math.isfinite(number):
            raise NoSymbols(f"constant {number}")
        return sp.Rational(Fraction(repr(number)))

    def apply(op: int, values: list[sp.Basic]) -> sp.Basic:
        if op == ca.OP_IF_ELSE_ZERO:
            return _chosen(values[0], _value(values[1]))
        if op in _LOGIC:
            return _LOGIC[op](*map(_condition, values))
        if op in _ARITHMETIC:
            return _ARITHMETIC[op](*map(_value, values))
        names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == op]
        raise NoSymbols((names or [f"OP_{op}"])[0].removeprefix("OP_").lower())

    def call(_: Graph, values: list[sp.Basic]) -> list[sp.Basic]:
        return [apply(ca.OP_CALL, values)]

    outputs = folded(function, lambda k, i: symbols[k][i], constant, apply, call)
    return [list(map(_value, column)) for column in outputs]
