"""Expressions as a tape: one straight-line program that every arithmetic of the proofs reads.

Outward-rounded intervals, power series modulo a prime and balls each walk the same instructions; an expression that
occurs twice is one instruction. Numbers are exact: a float is the rational of its shortest decimal.

Functions that SymPy brings in unasked are written by those that every reader knows: tan(x + pi/2) becomes -cot(x), and
a choice between conditions (a piecewise expression compared in another's condition) an ITE, "if c then a else b". The
derivative of e sign(e), as of a drag v^2 sign(v), has a DiracDelta that |e| has not.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any, NamedTuple

import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.interpolation import Table
from hgogen.rigor.kinks import Direction, Norm, signed, unbent
from hgogen.sentence import Reason, because

_MEANING: dict[type, Callable[..., sp.Basic]] = {
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.sinc: lambda x: sp.sin(x) / x,
    sp.Mod: lambda x, y: x - y * sp.floor(x / y),
    sp.frac: lambda x: x - sp.floor(x),
    sp.ITE: lambda c, a, b: (c & a) | (~c & b),
    sp.Xor: lambda *args: reduce(lambda a, b: (a & ~b) | (~a & b), args),
    sp.Implies: lambda a, b: ~a | b,
    sp.Equivalent: lambda *args: sp.And(*args) | sp.And(*map(sp.Not, args)),
}
_VALUES = "give its values on the declared range as a table"
NEAREST = {  # what to write in the place of functions that no reader knows, by their names
    "erf": f"{_VALUES}, or take tanh(2*x/sqrt(pi)), which is within 0.04 of it",
    "erfc": f"{_VALUES}, or take 1 - tanh(2*x/sqrt(pi)), which is within 0.04 of it",
    "gamma": _VALUES,
    "Mod": "write x - p*floor(x/p); of an angle sin and cos need no Mod",
}


def plain(expression: sp.Expr) -> sp.Expr:
    """The function written without cot, sec, csc, coth, sech, csch, sinc, Mod, frac, its conditions with And, Or and
    Not alone, and with |e| in the place of e sign(e) where e is real."""
    if expression.has(*_MEANING):
        expression = expression.replace(lambda e: type(e) in _MEANING, lambda e: _MEANING[type(e)](*e.args))
    return expression.replace(_is_size, lambda e: unbent(signed(e))) if expression.has(sp.sign) else expression


def _is_size(e: sp.Basic) -> bool:
    """Whether it may be e sign(e): of log(x) it has no value at x < 0, where SymPy's |log(x)| has one."""
    return e.is_Mul and all(part.args[0].is_real for part in e.args if isinstance(part, sp.sign))


# --- tapes

_FUNCTIONS = {  # of their arguments alone, in order
    getattr(sp, name): name.lower()
    for name in (
        *("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
        *("Abs", "sign", "atan2", "Heaviside", "floor", "ceiling", "Piecewise", "Not"),
    )
} | {type(sp.true): "true", type(sp.false): "false"}
_CONSTANTS = {sp.pi: "pi", sp.E: "e"}
_FOLDED = {sp.Add: "add", sp.Mul: "mul", sp.Min: "min", sp.Max: "max", sp.And: "and", sp.Or: "or"}
_RELATIONS = {
    sp.StrictLessThan: ("less", False),
    sp.LessThan: ("less_equal", False),
    sp.StrictGreaterThan: ("less", True),
    sp.GreaterThan: ("less_equal", True),
    sp.Equality: ("equal", False),
    sp.Unequality: ("unequal", False),
}


@dataclass(eq=False)
class NoTape(HgogenError):
    """A function, or a symbol, that no arithmetic of the proofs knows."""

    what: str
    expression: str

    @property
    def reason(self) -> Reason:
        """Why no arithmetic takes it."""
        pattern = (
            "no rule for {what} in {expression}; write it with + - * / ** sqrt exp log, trigonometric and hyperbolic "
            "functions, Abs, sign, floor, Heaviside, Min, Max or Piecewise, of declared symbols, or as a table"
        )
        return because(pattern, what=self.what, expression=self.expression)

    def __str__(self) -> str:
        return str(self.reason)


class Instruction(NamedTuple):
    """One value of a tape.

    `op`: "symbol" (`value`: its index), "number" (a Fraction), "constant" ("pi" or "e"), "add", "mul", "min", "max",
    "and", "or" (two `args`), "power" (`value`: the whole exponent), "root" (`value`: a rational exponent that is not
    whole), "raise" (base, exponent), "norm", "direction" (`value`: which of the `args`),
    the relations "less", "less_equal", "equal", "unequal" and "not", "true", "false",
    "piecewise" (value, condition, value, condition, ...), "table" (`value`: its cells and the order of the derivative),
    or a function's name. `args` are indices of instructions before it.
    """

    op: str
    args: tuple[int, ...] = ()
    value: Any = None


@dataclass(frozen=True)
class Tape:
    """The `instructions` in order, which read `symbols` by index; `outputs` says where each expression stands."""

    symbols: tuple[sp.Symbol, ...]
    instructions: tuple[Instruction, ...]
    outputs: tuple[int, ...]


def tape(expressions: Iterable[sp.Expr], symbols: Iterable[sp.Symbol]) -> Tape:
    """The tape of some expressions in the given symbols.

    Raises: `NoTape` for a function without a rule, an undeclared symbol, an infinite or complex number.
    """
    symbols = tuple(symbols)
    writer = _Writer(symbols)
    outputs = tuple(writer.place(plain(expression)) for expression in expressions)
    return Tape(symbols, tuple(writer.places), outputs)


class _Writer:
    def __init__(self, symbols: tuple[sp.Symbol, ...]) -> None:
        self.index = {symbol: k for k, symbol in enumerate(symbols)}
        self.places: dict[Instruction, int] = {}
        self.known: dict[sp.Basic, int] = {}

    def place(self, node: sp.Basic) -> int:
        """The index of the value of `node`. Its parts come first, and without recursion: expressions may be deep."""
        stack = [node]
        while stack:
            top = stack[-1]
            if top in self.known:
                stack.pop()
                continue
            parts = _parts(top)
            missing = [part for part in parts if part not in self.known]
            if missing:
                stack += missing
                continue
            self.known[stack.pop()] = self._write(top, [self.known[part] for part in parts], node)
        return self.known[node]

    def _put(self, op: str, args: tuple[int, ...] = (), value: Any = None) -> int:
        return self.places.setdefault(Instruction(op, args, value), len(self.places))

    def _write(self, node: sp.Basic, args: list[int], whole: sp.Basic) -> int:
        kind = type(node)
        if node in self.index:
            return self._put("symbol", value=self.index[node])
        if node in _CONSTANTS:
            return self._put("constant", value=_CONSTANTS[node])
        if isinstance(node, sp.Rational):
            return self._put("number", value=Fraction(node))
        if isinstance(node, sp.Float):
            return self._put("number", value=Fraction(repr(float(node))))
        if kind in _FOLDED:
            return reduce(lambda a, b: self._put(_FOLDED[kind], (a, b)), args)
        if kind is sp.Pow:
            return self._power(node, args)
        if kind in _RELATIONS:
            op, swapped = _RELATIONS[kind]
            return self._put(op, tuple(reversed(args) if swapped else args))
        if kind in _FUNCTIONS:
            return self._put(_FUNCTIONS[kind], tuple(args))
        if kind is Norm:
            return self._put("norm" if len(args) > 1 else "abs", tuple(args))
        if kind is Direction:
            return self._put("direction", tuple(args), int(node.args[0]))
        if isinstance(node, Table):
            return self._put("table", tuple(args), (node.cells, node.order))
        raise NoTape(str(node), str(whole))

    def _power(self, node: sp.Pow, args: list[int]) -> int:
        if node.base == sp.E:
            return self._put("exp", (args[-1],))
        if node.exp.is_Integer:
            return self._put("power", (args[0],), int(node.exp))
        if node.exp.is_Rational:
            return self._put("root", (args[0],), Fraction(node.exp))
        return self._put("raise", tuple(args))


def _parts(node: sp.Basic) -> tuple[sp.Basic, ...]:
    if isinstance(node, sp.Pow) and node.exp.is_Rational:
        return (node.base,)
    if isinstance(node, sp.Piecewise):
        return tuple(part for pair in node.args for part in pair.args)
    return tuple(node.args[1:] if isinstance(node, Direction) else node.args)
