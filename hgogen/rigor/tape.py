"""Expressions as a tape, a straight-line program for every arithmetic of the proofs, and kinks as norms.

Kinks are |e|, max, min and sqrt(e_1^2 + .. + e_k^2). Written as norms they have slopes that are sets at the kink:

    d|e|/dx = s e' with s = -1 where e < 0, s = 1 where e > 0,   d|(e_1, .., e_k)|/dx = sum_i s_i e_i',  s_i = e_i/|e|

At e = 0 the slope is the set of all s in the unit ball, the hull of its limits there (F. H. Clarke, "Optimization and
nonsmooth analysis", 1983, theorem 2.5.1). SymPy's sign(0) = 0 would be one of these numbers.

Kinks at the same place are on the same side together:

    2 max(v, 0) - (v where v > 0, else -v) = v

Equal norms cancel: the slope of this row is 1. A program computes the slope of each kink separately: at v = 0 half of
2, less 1, which is 0, and for max(v + 1000, 0 + 1000) a result of rounding. So where kinks share a norm the program
computes the expression in norms, as the proofs do (`shared`).

Outward-rounded intervals, balls and power series modulo a prime evaluate the same tape; an expression that occurs twice
is one instruction. Numbers are exact: a float is the rational of its shortest decimal.

Functions that SymPy introduces by itself are rewritten by functions that every arithmetic knows: SymPy turns tan(x +
pi/2) into -cot(x), and a choice between conditions (a piecewise expression compared in another's condition) into an
ITE, "if c then a else b". The derivative of e sign(e), as of a drag v^2 sign(v), has a DiracDelta, that of |e| not.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from itertools import combinations
from typing import Any, NamedTuple

import sympy as sp
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import Boolean

from hgogen.errors import HgogenError
from hgogen.rigor.box import exact, substituted
from hgogen.rigor.functions import MEANING, refusal
from hgogen.rigor.lookup import Table
from hgogen.sentence import Reason, because

_LARGE = 400  # most operations of a root's argument, or of a piecewise expression, that is rewritten


class _Printed(sp.Function):  # type: ignore[misc]
    """A SymPy function that prints as an expression of SymPy's own functions."""

    def _sympystr(self, printer: Any) -> str:
        return str(printer.doprint(self.plain()))

    def _latex(self, printer: Any, exp: str | None = None) -> str:
        text = str(printer.doprint(self.plain()))
        return text if exp is None else rf"\left({text}\right)^{{{exp}}}"

    def plain(self) -> sp.Expr:
        raise NotImplementedError


class Norm(_Printed):
    """The SymPy function |e| = sqrt(e_1^2 + .. + e_k^2) of the arguments e_i; the absolute value of one argument."""

    is_real = True
    is_nonnegative = True

    @classmethod
    def eval(cls, *args: sp.Expr) -> sp.Expr | None:
        """Return the norm of numbers, |c| |e| for |c e| with a number c, |e| for |-e|; None where nothing
        simplifies."""
        if all(e.is_number for e in args):
            return sp.sqrt(sp.Add(*(e**2 for e in args)))
        if len(args) == 1:
            factor, others = args[0].as_coeff_Mul(rational=True)
            if others.could_extract_minus_sign():
                others = -others
            return None if others == args[0] else abs(factor) * cls(others)
        return None

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        return sp.Add(*(Direction(sp.Integer(i), *self.args) * e.diff(s) for i, e in enumerate(self.args) if e.has(s)))

    def plain(self) -> sp.Expr:
        """Return Abs(e) or sqrt(e_1^2 + .. + e_k^2) in SymPy's own functions."""
        return _size(*self.args)


class Direction(_Printed):
    """The SymPy function Direction(i, e_0, .., e_(k-1)) = e_i/|e|, at e = 0 the set [-1, 1]; the sign of a single
    argument e."""

    is_real = True

    @classmethod
    def eval(cls, index: sp.Integer, *args: sp.Expr) -> sp.Expr | None:
        """Return the sign of a single argument if it is known, or the direction without numerical factors; None where
        nothing simplifies."""
        if len(args) > 1:
            return None
        if args[0].is_positive or args[0].is_negative:
            return sp.S.One if args[0].is_positive else sp.S.NegativeOne
        factor, others = args[0].as_coeff_Mul(rational=True)
        if others.could_extract_minus_sign():
            factor, others = -factor, -others
        return None if factor == 1 or not others.free_symbols else sp.sign(factor) * cls(index, others)

    def _eval_derivative(self, s: sp.Symbol) -> sp.Expr:
        """Return d(e_i/|e|)/ds; for one argument the derivative 2 DiracDelta(e) e' of a sign."""
        e, *more = self.args[1:]
        if not more:
            return 2 * sp.DiracDelta(e) * e.diff(s)
        top, size = self.args[1 + int(self.args[0])], Norm(*self.args[1:])
        return top.diff(s) / size - top * size.diff(s) / size**2

    def plain(self) -> sp.Expr:
        """Return sign(e) or e_i/|e| in SymPy's own functions, for printing only: the set at e = 0 is lost."""
        e, *more = self.args[1:]
        if not more:
            return sp.sign(e, evaluate=False)
        size = _size(e, *more)
        divided = sp.Pow(size, -1, evaluate=size != 0)  # the size of numbers may be 0, which stays visible
        return sp.Mul(self.args[1 + int(self.args[0])], divided, evaluate=False)


def _size(*args: sp.Expr) -> sp.Expr:
    return sp.Abs(args[0]) if len(args) == 1 else sp.sqrt(sp.Add(*(e**2 for e in args)))


def slope(row: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """Return the partial derivative of a real function by the symbol; at a kink its value is a set, expressed by
    `Direction`."""
    return over_reals(lambda e, x: _as_norms(e).diff(x), row, symbol)


def with_norms(row: sp.Expr) -> sp.Expr:
    """Return the real function with its kinks (|e|, max, min, roots of sums of squares, Piecewise, sign) expressed by
    `Norm`."""
    return over_reals(lambda e, _: _as_norms(e), row)


def without_norms(e: sp.Expr) -> sp.Expr:
    """Return the expression with each `Norm` written in SymPy's own functions, as programs compute it."""
    return e.replace(lambda node: isinstance(node, Norm), lambda node: node.plain())


def off_zero(e: sp.Expr, least: sp.Rational, unit: Callable[[sp.Expr], sp.Rational]) -> sp.Expr:
    """Return the expression with each sum of squares s = e_1^2 + .. + e_k^2 under a root replaced by max(s, `least`
    unit(s)).

    The derivative that programs compute, e_i e_i' over the root, is then 0 where all e_i are 0, and not 0/0. Roots in
    conditions and roots that are also divisors do not change, as in sin |e|/|e| where |e| > 0, else 1.
    """
    divisors = {node.base for node in e.atoms(sp.Pow) if node.exp.is_negative}

    def visited(node: sp.Basic) -> sp.Basic:
        if not node.args or isinstance(node, Boolean):
            return node
        args = tuple(map(visited, node.args))
        built = node if args == node.args else node.func(*args)
        # a root of a sum of squares may be 0
        may_vanish = isinstance(built, sp.Pow) and rooted(built) and squares(built.base) is not None
        if not may_vanish or node.base in divisors:
            return built
        square = unit(built.base)
        return square**built.exp * sp.Max(built.base / square, least) ** built.exp

    return visited(e)


def at_kinks(derivative: sp.Expr) -> sp.Expr:
    """Return SymPy's derivative of a continuous expression with sign and Heaviside replaced by `Direction`, whose value
    at 0 is a set."""
    steps = derivative.replace(sp.Heaviside, lambda e, *_: (1 + Direction(sp.S.Zero, e)) / 2)
    return steps.replace(sp.sign, lambda e: Direction(sp.S.Zero, e))


def over_reals(
    function: Callable[[sp.Expr, sp.Symbol], sp.Expr], row: sp.Expr, symbol: sp.Symbol | None = None
) -> sp.Expr:
    """Return function(row, symbol), computed with real symbols in place of complex ones: SymPy's |x| of a complex x has
    another slope."""
    plain = {s: sp.Dummy(s.name, real=True) for s in sorted(row.free_symbols, key=str) if not s.is_real}
    value = function(row.xreplace(plain), plain.get(symbol, symbol))
    return value.xreplace({dummy: s for s, dummy in plain.items()})


def _as_norms(e: sp.Expr) -> sp.Expr:
    if not e.has(sp.Abs, sp.Min, sp.Max, sp.Piecewise, sp.sign) and not any(rooted(p) for p in e.atoms(sp.Pow)):
        return e
    if e.args and not isinstance(e, sp.Piecewise):
        e = e.func(*map(_as_norms, e.args))
    if isinstance(e, sp.Abs):
        return Norm(e.args[0])
    if isinstance(e, (sp.Min, sp.Max)):
        sign = 1 if isinstance(e, sp.Max) else -1
        return reduce(lambda a, b: (a + b + sign * Norm(a - b)) / 2, e.args)
    if isinstance(e, sp.Piecewise):
        return _joined(e)
    if isinstance(e, sp.Pow) and rooted(e):
        parts = squares(e.base)
        return e if parts is None else Norm(*parts) ** e.exp.p
    return signed(e) if isinstance(e, sp.Mul) else e


def rooted(node: sp.Pow) -> bool:
    """Return whether a power is the square root of an expression with symbols, or an odd power of such a root."""
    return bool(node.exp.is_Rational and node.exp.q == 2 and node.base.free_symbols)


def signed(e: sp.Mul) -> sp.Expr:
    """Return the product with |e| in place of e sign(e), and -|e| in place of -e sign(e)."""
    for node in sorted((a for a in e.args if isinstance(a, sp.sign)), key=str):
        (base,), others = node.args, e / node
        powers = (factor.as_base_exp() for factor in sp.Mul.make_args(others))
        matching = next((b for b, k in powers if b in (base, -base) and k.is_Integer and k > 0), None)
        if matching is not None:
            as_norm = (1 if matching == base else -1) * others / matching * Norm(base)
            return signed(as_norm) if isinstance(as_norm, sp.Mul) else as_norm
    return e


def unsigned(e: sp.Mul) -> sp.Expr:
    """Return the product with e in place of |e| sign(e), and -e in place of |e| sign(-e)."""
    for node in e.args:
        for size in (node.args[0], -node.args[0]) if isinstance(node, sp.sign) else ():
            if sp.Abs(size) in e.args:
                return e / node / sp.Abs(size) * node.args[0]
    return e


def squares(e: sp.Expr) -> list[sp.Expr] | None:
    """Return the list e_1 .. e_k for an expression e = e_1^2 + .. + e_k^2 (numbers in the sum must not be negative);
    None for another expression."""
    if e.count_ops() > _LARGE:
        return None
    roots = []
    for term in sp.Add.make_args(e):
        root = _square(term)
        if root is None:  # the sum may be a square itself
            whole = _square(sp.factor(e)) if e.is_polynomial(*e.free_symbols) else None
            return None if whole is None else [whole]
        roots.append(root)
    return roots


def _square(term: sp.Expr) -> sp.Expr | None:
    """Return r with term = r^2, r a product of powers; None if there is none."""
    number, others = term.as_coeff_Mul(rational=True)
    if number < 0:
        return None
    factors = sp.Mul.make_args(others) if others != 1 else ()
    roots = []
    for factor in factors:
        base, exponent = factor.as_base_exp() if factor.is_Pow and factor.exp.is_Integer else (factor, sp.S.One)
        if not (exponent.is_Integer and exponent > 0 and exponent % 2 == 0):
            return None
        roots.append(base ** (exponent / 2))
    return sp.Mul(sp.sqrt(number), *roots)


# --- Piecewise


def _joined(e: sp.Piecewise) -> sp.Expr:
    """Return the sum b + sum_i g_i (c_i + |c_i|)/2 for a Piecewise (b + g_i c_i where c_i > 0, .., else b) in which at
    most one c_i is above 0 at once; another Piecewise, or one whose branches may lack values, is returned unchanged."""
    *branches, (default, last) = [tuple(pair.args) for pair in exact(e).args]
    kinds = (sp.StrictLessThan, sp.LessThan, sp.StrictGreaterThan, sp.GreaterThan)
    if last != sp.true or e.count_ops() > _LARGE or not all(isinstance(where, kinds) for _, where in branches):
        return e
    default = _as_norms(default)
    conditions = [sp.expand(where.gts - where.lts) for _, where in branches]
    for a, b in combinations(conditions, 2):  # not positive at once where a positive multiple of b is a number below -a
        symbols = sorted(a.free_symbols & b.free_symbols, key=str)
        ratio = -a.coeff(symbols[0]) / b.coeff(symbols[0]) if symbols and b.coeff(symbols[0]) != 0 else sp.S.Zero
        if not (ratio.is_positive and sp.expand(a + ratio * b).is_nonpositive):
            return e
    total = default
    for (value, _), c in zip(branches, conditions, strict=True):
        rise = sp.expand(_as_norms(value) - default)
        if not all(map(_polynomial, (rise, default, c))):
            return e
        quotient, remainder = _divided(rise, c)
        if remainder != 0:
            return e
        total += quotient * (c + Norm(c)) / 2
    return total


def _polynomial(e: sp.Expr) -> bool:
    if isinstance(e, sp.Pow):
        return bool(e.exp.is_Integer and e.exp > 0) and _polynomial(e.base)
    if isinstance(e, (sp.Add, sp.Mul, Norm)):
        return all(map(_polynomial, e.args))
    return bool(e.is_Symbol or e.is_Rational)


def _divided(top: sp.Expr, bottom: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    dummies = {node: sp.Dummy() for node in top.atoms(Norm) | bottom.atoms(Norm)}
    back = {dummy: node for node, dummy in dummies.items()}
    top, bottom = top.xreplace(dummies), bottom.xreplace(dummies)
    letters = sorted(top.free_symbols | bottom.free_symbols, key=str)
    if not bottom.free_symbols:
        return sp.S.Zero, sp.S.One
    quotient, remainder = sp.div(top, bottom, *letters)
    return quotient.xreplace(back), remainder.xreplace(back)


def jump(expression: sp.Expr, point: Mapping[sp.Symbol, sp.Rational]) -> tuple[sp.Expr, sp.Expr] | None:
    """Return the two values of an expression at a point on both sides of a kink |e|, if it is the only kink there and
    the values have opposite signs; else None."""
    there = substituted(expression, point)
    kinks = set() if there is None else {node for node in there.atoms(Direction) if len(node.args) == 2}
    if there is None or len(kinks) != 1 or there.free_symbols:
        return None
    (kink,) = kinks
    low, high = (there.xreplace({kink: side}) for side in (sp.S.NegativeOne, sp.S.One))
    opposite = (low.is_negative and high.is_positive) or (low.is_positive and high.is_negative)
    return (low, high) if opposite else None


# --- kinks at the same place

_KINDS = (sp.Abs, sp.Min, sp.Max, sp.Piecewise)


def shared(expression: sp.Expr) -> sp.Expr:
    """Return the expression as programs compute it: kinks are written as norms where two of them have a norm in
    common."""
    # the parts that may have kinks of their own: |e|, max, min and choices, and products with a sign
    signs = (node for node in expression.atoms(sp.Mul) if any(isinstance(part, sp.sign) for part in node.args))
    norms = [_introduced(node) for node in {*expression.atoms(*_KINDS), *signs}]
    if all(a.isdisjoint(b) for a, b in combinations(norms, 2)):
        return expression
    return without_norms(with_norms(expression))


def _introduced(node: sp.Expr) -> set[sp.Expr]:
    every = _norms([node])
    if not isinstance(node, sp.Piecewise):
        return every - _norms(node.args)
    # expressions whose sign changes where a choice changes its branch
    decides = (Norm(where.gts - where.lts) for _, where in node.args if hasattr(where, "gts"))
    return every - _norms(branch for branch, _ in node.args) | every & _norms(decides)


def _norms(expressions: Iterable[sp.Expr]) -> set[sp.Expr]:
    return {norm for e in expressions for norm in with_norms(e).atoms(Norm)}


def plain(expression: sp.Expr) -> sp.Expr:
    """Return the expression in functions that have a rule in every arithmetic: the functions in `MEANING` are
    rewritten.

    |e| stands for e sign(e) where e is real, and sign(e) |e|^p for e |e|^(p - 1), which has no value at e = 0 for p <
    1.
    """
    if expression.has(*MEANING):
        expression = expression.replace(lambda e: type(e) in MEANING, lambda e: MEANING[type(e)](*e.args))
    if expression.has(sp.Abs):
        expression = expression.replace(lambda e: isinstance(e, sp.Mul), _of_size)
    if not expression.has(sp.sign):
        return expression

    def is_size(e: sp.Basic) -> bool:  # e sign(e) of log(x) has no value at x < 0, where SymPy's |log(x)| has one
        return e.is_Mul and all(part.args[0].is_real for part in e.args if isinstance(part, sp.sign))

    return expression.replace(is_size, lambda e: without_norms(signed(e)))


def _of_size(e: sp.Mul) -> sp.Expr:
    """Return the product with sign(a)^k |a|^(k + p) in place of its factors a^k |a|^p, for k > 0 whole and k + p
    positive, p < 0 or not whole."""
    for size in e.args:
        if not (size.as_base_exp()[1].is_number and isinstance(size.as_base_exp()[0], sp.Abs)):
            continue
        (a,), p = size.as_base_exp()[0].args, size.as_base_exp()[1]
        for part in e.args:
            base, k = part.as_base_exp()
            if base in (a, -a) and k.is_Integer and k > 0 and k + p > 0 and (p < 0 or not exact(p).is_integer):
                return e / part / size * (sp.sign(base) if k % 2 else 1) * sp.Abs(a) ** (k + p)
    return e


# --- tapes

_FUNCTIONS = {  # instructions that read the node's arguments in order, and no further value
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
    """The error that a function or symbol, `what`, in an `expression` has no rule in the arithmetic of the proofs;
    `refusal`: the sentence on what to write instead."""

    what: str
    expression: str
    refusal: str

    @property
    def reason(self) -> Reason:
        """Return the reason in words, with what to write instead."""
        return because("{expression}: {refusal}", expression=self.expression, refusal=self.refusal)

    def __str__(self) -> str:
        return str(self.reason)


class Instruction(NamedTuple):
    """An instruction of a tape, which computes one value.

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
    """A straight-line program: `instructions`, which read `symbols` by index; `outputs`: the index of the instruction
    of each result."""

    symbols: tuple[sp.Symbol, ...]
    instructions: tuple[Instruction, ...]
    outputs: tuple[int, ...]


def tape(expressions: Iterable[sp.Expr], symbols: Iterable[sp.Symbol]) -> Tape:
    """Return the expressions as a straight-line program in these symbols, with an output for each.

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
        """Return the index of the instruction that computes `node`, after writing the instructions of its arguments;
        without recursion, for deep expressions."""
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
        raise NoTape(str(node), str(whole), _refusal(whole, self.index))

    def _power(self, node: sp.Pow, args: list[int]) -> int:
        if node.base == sp.E:
            return self._put("exp", (args[-1],))
        if node.exp.is_Integer:
            return self._put("power", (args[0],), int(node.exp))
        if node.exp.is_Rational:
            return self._put("root", (args[0],), Fraction(node.exp))
        return self._put("raise", tuple(args))


_WITH_RULE = (*_FUNCTIONS, *_FOLDED, *_RELATIONS, sp.Pow, Norm, Direction)
_HOLDERS = (sp.Number, sp.Tuple, ExprCondPair, Table)  # that need no instruction, or have one whatever their type


def _refusal(whole: sp.Basic, symbols: Mapping[sp.Symbol, int]) -> str:
    for node in sp.preorder_traversal(whole):
        if isinstance(node, sp.Symbol) and node not in symbols:
            return f"the symbol {node} is not declared; declare it as a Signal"
        if not (node in symbols or node in _CONSTANTS or type(node) in _WITH_RULE or isinstance(node, _HOLDERS)):
            return refusal(type(node).__name__)
    return "it has a number that is not finite and real; correct it"


def _parts(node: sp.Basic) -> tuple[sp.Basic, ...]:
    if isinstance(node, sp.Pow) and node.exp.is_Rational:
        return (node.base,)
    if isinstance(node, sp.Piecewise):
        return tuple(part for pair in node.args for part in pair.args)
    return tuple(node.args[1:] if isinstance(node, Direction) else node.args)
