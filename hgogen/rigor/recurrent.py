"""Periods of known functions of time, found exactly by the terms of an expression.

Over a time T that is a multiple of its periods an expression changes by its drift times T:

    t                     drift 1
    a e + b f             the sum of the drifts
    floor(e)              the drift a of e, period 1/|a|
    sin(e), cos(e)        drift 0; period 2 pi/|a|, a the drift of e
    every other function  drift 0, if its arguments have drift 0

An expression without drift is periodic: t may be replaced by the time modulo each period. Mod(e, m) is e - m
floor(e/m).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import sympy as sp

from hgogen.rigor.functions import MEANING

_CLOSE = 1e-15  # relative distance within which a float is taken for a multiple of pi
_PARTS = 10**6  # largest denominator of such a multiple, and of a float that is none
_TOGETHER = 1000  # a common period is at most so many times the shortest one
_WAVES = (sp.sin, sp.cos, sp.tan)


class Aperiodic(Exception):
    """The error that an expression is not a periodic function of time; its text is the reason."""


Values = Mapping[sp.Symbol, sp.Expr]
Choose = Callable[[sp.Expr], sp.Symbol]


@dataclass(frozen=True)
class _Part:
    """A subexpression: its drift per unit of time, the periods of its floors (`turns`), and `build`, which returns it
    with another symbol for t."""

    drift: sp.Expr
    turns: tuple[sp.Expr, ...]
    build: Callable[[sp.Symbol], sp.Basic]


def common(first: sp.Expr, *others: sp.Expr) -> sp.Expr | None:
    """Return the least common multiple of periods; None if the ratio of two of them is irrational."""
    for turn in others:
        ratio = sp.simplify(turn / first)
        if not ratio.is_Rational:
            return None
        first *= ratio.p
    return sp.simplify(first)


def grouped(turns: Iterable[sp.Expr]) -> tuple[sp.Expr, ...]:
    """Return common multiples of the periods `turns`, the longest first, such that each period divides one of them. A
    period without a short common multiple with another one is its own group."""
    groups: list[sp.Expr] = []
    for turn in sorted(set(turns), key=float, reverse=True):
        for k, group in enumerate(groups):
            both = common(group, turn)
            if both is not None and both <= _TOGETHER * turn:
                groups[k] = both
                break
        else:
            groups.append(turn)
    return tuple(sorted(groups, key=float, reverse=True))


def divides(turn: sp.Expr, group: sp.Expr) -> bool:
    """Return whether `group` is a whole multiple of the period `turn`."""
    return bool(sp.simplify(group / turn).is_Integer)


def rewritten(expression: sp.Expr, t: sp.Symbol, values: Values, choose: Choose) -> sp.Expr:
    """Return the expression with t replaced, in each periodic part, by the symbol that `choose` returns for the period
    of the part; `values`: the numbers of constant symbols. Raises: `Aperiodic`."""
    part = _part(expression, t, values, choose)
    if part.drift != 0:
        raise Aperiodic(f"{expression} is not periodic in {t}")
    return part.build(t)


def _part(node: sp.Basic, t: sp.Symbol, values: Values, choose: Choose) -> _Part:
    if not node.has(t):
        return _Part(sp.S.Zero, (), lambda _: node)
    if node == t:
        return _Part(sp.S.One, (), lambda symbol: symbol)
    if isinstance(node, sp.Mod | sp.frac):
        return _part(MEANING[type(node)](*node.args), t, values, choose)
    return _function(node, [_part(each, t, values, choose) for each in node.args], t, values, choose)


def _function(node: sp.Basic, parts: Sequence[_Part], t: sp.Symbol, values: Values, choose: Choose) -> _Part:
    """Return the drift, periods and builder of a function `node` from the parts of its arguments. Raises:
    `Aperiodic`."""
    moving = [part for part in parts if part.drift != 0]
    floors = tuple(turn for part in moving for turn in part.turns)

    def build(symbol: sp.Symbol) -> sp.Basic:
        return node.func(*(part.build(symbol) for part in parts))

    def periodic(*turns: sp.Expr) -> _Part:
        whole = common(*floors, *turns)
        if whole is None:
            raise Aperiodic(f"{node} has periods without a common multiple in {t}")
        symbol = choose(whole)
        return _Part(sp.S.Zero, (), lambda _: build(symbol))

    if not moving:
        return _Part(sp.S.Zero, (), build)
    if isinstance(node, sp.Add):
        drift = _number(sp.Add(*(part.drift for part in moving)), node, t, values)
        return _Part(drift, floors, build) if drift != 0 else periodic()
    factors = [each for each in node.args if not each.has(t)]
    if isinstance(node, sp.Mul) and len(factors) == len(parts) - 1:
        return _Part(sp.Mul(*factors, moving[0].drift), floors, build)
    if isinstance(node, sp.floor | sp.ceiling):
        drift = _number(moving[0].drift, node, t, values)
        return _Part(drift, (*floors, sp.simplify(1 / sp.Abs(drift))), build)
    if isinstance(node, _WAVES):
        drift = _number(moving[0].drift, node, t, values)
        return periodic(sp.simplify(2 * sp.pi / sp.Abs(drift)))
    raise Aperiodic(f"{node} is not periodic in {t}")


def _number(drift: sp.Expr, node: sp.Basic, t: sp.Symbol, values: Values) -> sp.Expr:
    exact = sp.simplify(drift.xreplace(dict(values)).replace(lambda e: e.is_Float, _exact))
    if exact.free_symbols or not exact.is_real:
        names = " and ".join(sorted(map(str, exact.free_symbols)))
        raise Aperiodic(f"the period of {node} in {t} varies with {names}")
    return exact


def _exact(number: sp.Float) -> sp.Expr:
    """Return a float as an exact number: 2*math.pi*50 as 100*pi, others as their shortest decimals."""
    value, short = float(number), Fraction(repr(float(number)))
    share = Fraction(value / float(sp.pi)).limit_denominator(_PARTS)
    is_multiple = abs(float(share) * float(sp.pi) - value) <= _CLOSE * abs(value)
    return sp.Rational(share) * sp.pi if is_multiple and short.denominator > _PARTS else sp.Rational(short)
