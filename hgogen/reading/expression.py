"""Parser from text to SymPy with its own grammar: a user's text is never run as Python.

    value      sums, products, quotients, powers (**, right to left), signs, parentheses; binding as in Python
    call       a name of a fixed table and values; Piecewise((value, condition), ..., (value, True)); of a model's own
               table its name and a value for each of its axes
    condition  True, False, relations < <= > >=, joined by & and | in parentheses; inside Piecewise only
    name       a declared symbol; pi and E unless declared; decimals are exact rationals

The parser descends by binding power (V. R. Pratt, Top down operator precedence, 1973): `_Parser.value` reads one
operand and then every operator that binds more tightly than the one on its left.

SymPy simplifies a text as it reads it: exp(log(x)) is x, x/x is 1 and sqrt(x)**2 is x, also where the text as written
has no value. `read` reports such folding by the conditions that an operation demands of its arguments,

    log a, a**s     a >= 0, a != 0           a**(p/q), q > 1, p > 0    a >= 0      1/a       a != 0
    tan a           cos a != 0               asin a, acos a            1 - a**2 >= 0
    acosh a         a - 1 >= 0               atanh a                   1 - a**2 >= 0, != 0
    atan2(a, b)     a**2 + b**2 != 0

A demand of the text is lost if no operation of the resulting expression makes it. Demands inside a Piecewise are
ignored in both, because a branch that does not apply demands nothing."""

import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from types import MappingProxyType
from typing import Any, NamedTuple

import sympy as sp

from hgogen.errors import HgogenError
from hgogen.reading.files import cut
from hgogen.rigor import bounds
from hgogen.rigor.box import Box
from hgogen.rigor.functions import ARGUMENTS, NAMES, WRITTEN, refusal
from hgogen.rigor.lookup import Cells, applied
from hgogen.rigor.singular import parts
from hgogen.sentence import NONE, Reason, because

# --- what SymPy folds away ------------------------------------------------------------------------------


class Demand(NamedTuple):
    """A condition for an expression to have a real value: `expression` is not zero (`relation` "="), or not negative
    ("<")."""

    relation: str
    expression: sp.Expr


_DEMANDS: dict[type, Callable[..., tuple[Demand, ...]]] = {
    sp.log: lambda a: (Demand("<", a), Demand("=", a)),
    sp.tan: lambda a: (Demand("=", sp.cos(a)),),
    sp.asin: lambda a: (Demand("<", 1 - a**2),),
    sp.acos: lambda a: (Demand("<", 1 - a**2),),
    sp.acosh: lambda a: (Demand("<", a - 1),),
    sp.atanh: lambda a: (Demand("<", 1 - a**2), Demand("=", 1 - a**2)),
    sp.atan2: lambda a, b: (Demand("=", a**2 + b**2),),
}


def call_demands(function: object, *arguments: sp.Expr) -> Iterator[Demand]:
    """Yield the conditions under which function(arguments) has a real value, such as x >= 0 for sqrt(x)."""
    if function is sp.sqrt:
        yield from power_demands(arguments[0], sp.S.Half)
    elif isinstance(function, type) and function in _DEMANDS:
        for demand in _DEMANDS[function](*arguments):
            yield from _plain(demand)


def power_demands(base: sp.Expr, exponent: sp.Expr) -> Iterator[Demand]:
    """Yield the conditions under which base**exponent has a real value; a**0 is 1, also where a = 0."""
    if exponent == 0:
        return
    if not exponent.is_integer:
        yield from _plain(Demand("<", base))
    if exponent.is_positive is not True:
        yield from _plain(Demand("=", base))


def lost(written: Iterable[Demand], reading: sp.Expr) -> tuple[Demand, ...]:
    """Return, without repetitions, the conditions for a real value that the text as `written` has, but its `reading` by
    SymPy does not have, such as x != 0 of x/x."""
    written = dict.fromkeys(written)
    demanded: set[Demand] = set()
    for node in parts(reading) if written else ():
        if isinstance(node, sp.Pow):
            demanded.update(power_demands(node.base, node.exp))
        else:
            demanded.update(call_demands(node.func, *node.args))
    return tuple(demand for demand in written if demand not in demanded)


def _plain(demand: Demand) -> Iterator[Demand]:
    if not demand.expression.free_symbols:  # the parser has checked the numbers
        return
    yield from (_signs if demand.relation == "<" else _zeros)(demand.expression)


def _signs(value: sp.Expr) -> Iterator[Demand]:
    pairs = [(factor.primitive()[1], factor.as_base_exp()[1]) for factor in sp.Mul.make_args(value)]
    factors = [factor for factor, exponent in pairs if exponent.is_integer and not factor.is_nonnegative]
    if factors:
        yield Demand("<", sp.Mul(*factors))


def _zeros(value: sp.Expr) -> Iterator[Demand]:
    for factor in sp.Mul.make_args(value.primitive()[1]):
        base, exponent = factor.as_base_exp()
        if factor.is_number or factor.is_zero is False or exponent.is_negative:
            continue
        if base != value and isinstance(base, sp.Mul | sp.Pow | sp.Add):
            yield from _zeros(base)
        elif isinstance(base, sp.Abs):
            yield from _zeros(base.args[0])
        else:
            yield Demand("=", -base if base.could_extract_minus_sign() else base)


@dataclass(frozen=True)
class Fold:
    """The result of reading a text: the expression `reading` that SymPy makes of it, and the conditions for a real
    value that SymPy `lost`, such as x != 0 of x/x."""

    text: str
    reading: sp.Expr
    lost: tuple[Demand, ...]

    def on(self, box: Box) -> Reason:
        """Return a reason that names the places in a closed box where the expression has a value but the text has none;
        `NONE` without any."""
        places: dict[sp.Expr, str] = {}
        for relation, a in self.lost:
            if not _met(relation, a, box):
                places[a] = "<=" if places.get(a, relation) != relation else relation
        if not places:
            return NONE
        pattern = "SymPy reads {text} as {reading}, also where {places: or }; {reading} is what is meant here"
        where = [because("{a} {relation} 0", a=cut(str(a)), relation=relation) for a, relation in places.items()]
        return because(pattern, text=cut(self.text), reading=cut(str(self.reading)), places=where)


def _met(relation: str, a: sp.Expr, box: Box) -> bool:
    try:
        return bounds.nonzero(a, box).sign != 0 if relation == "=" else bounds.bound(a, box).low >= 0
    except HgogenError:
        return False


# --- the grammar ------------------------------------------------------------------------------------------

CHARACTERS, TOKENS, DEPTH = 100_000, 20_000, 100  # of one expression
DIGITS, DECADES = 400, 400  # of one number as written: double precision ends at 308
BITS, TOTAL_BITS = 4096, 100_000  # of one number computed, of all the coefficients of one sum
EXPONENT = 10**6  # of a power
LARGEST_EXP = 700  # beyond it exp of a number is no double
_BINDING = {"<": 1, "<=": 1, ">": 1, ">=": 1, "|": 2, "&": 3, "+": 4, "-": 4, "*": 5, "/": 5, "**": 7}
_SIGN, _POWER = 6, 6  # a sign binds more tightly than *, less than **; the exponent may carry a sign
_COMPLEX = "is not a real number; keep roots, logarithms and asin, acos in their domain"
_RELATIONS = {"<": sp.Lt, "<=": sp.Le, ">": sp.Gt, ">=": sp.Ge}
_FEW = 12  # names that a message lists
_CONSTANTS = {"pi": sp.pi, "E": sp.E}
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo)
NO_TABLES: Mapping[str, Cells] = MappingProxyType({})


def parse(text: str, symbols: Mapping[str, sp.Symbol], tables: Mapping[str, Cells] = NO_TABLES) -> sp.Expr:
    """Return a text as a SymPy expression.

    Args: `symbols`: every declared name with its symbol; a declared name has precedence over pi, E and, unless an
    opening parenthesis follows, over a function; `tables`: the tables by name; no table has the name of a function.

    Raises: `BadExpression` for a text outside the grammar, too long, too deep, or with numbers too large; for a
    division by zero and for a value that is not real.
    """
    return read(text, symbols, tables).reading


def read(text: str, symbols: Mapping[str, sp.Symbol], tables: Mapping[str, Cells] = NO_TABLES) -> Fold:
    """Return a text as a SymPy expression, together with the conditions for a real value that SymPy lost; arguments and
    errors as of `parse`."""
    if not isinstance(text, str):
        raise BadExpression(str(text), 1, f"is of type {type(text).__name__}; write the expression as text")
    if len(text) > CHARACTERS:
        raise BadExpression(text, CHARACTERS, f"is longer than {CHARACTERS} characters; name parts of it")
    try:
        parser = _Parser(text, symbols, tables)
        reading = parser.whole()
        return Fold(text, reading, lost(parser.demanded, reading))
    except RecursionError:  # in SymPy, if the caller has used most of the stack
        raise BadExpression(text, 1, "is nested too deep for the stack; flatten it") from None


_TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[A-Za-z_][A-Za-z0-9_]*)
    |(?P<sign>\*\*|<=|>=|[-+*/(),<>&|])
    |(?P<end>\Z)
    |(?P<other>.))""",
    re.VERBOSE | re.ASCII | re.DOTALL,
)
_FIXES = {
    "^": "write ** for a power",
    ".": "a dot belongs in a number only; write * for a product",
    "=": "an expression has no =; inside Piecewise compare with < <= > >=",
    **dict.fromkeys("!~", "conditions know < <= > >= & | only"),
    **dict.fromkeys("[]{}", "write parentheses ( )"),
    **dict.fromkeys("'\"", "text is no value; write numbers and declared names"),
    "\x00": "remove the NUL character",
}


@dataclass(eq=False)
class BadExpression(HgogenError):
    """The error that a text is outside the grammar, or has no finite real value; `column` counts from 1."""

    source: str
    column: int
    reason: str

    def __str__(self) -> str:
        start = max(0, min(self.column - 1, len(self.source)) - 30)
        excerpt = repr(self.source[start : start + 60])
        head, tail = "..." if start else "", "..." if start + 60 < len(self.source) else ""
        return f"expression {head}{excerpt}{tail}, column {self.column}: {self.reason}"


class Token(NamedTuple):
    """A token of the grammar. `kind`: number, name, sign, or end; `column` counts from 1."""

    kind: str
    text: str
    column: int


def tokens(text: str) -> Iterator[Token]:
    """Yield the tokens of a text, the last of the kind "end". Raises: `BadExpression` for a character outside the
    grammar."""
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        token = Token(kind, match[kind], match.start(kind) + 1)
        if kind == "other":
            reason = f"{token.text!r} is not in the grammar; {_FIXES.get(token.text, 'remove it')}"
            if not token.text.isascii():
                name = unicodedata.name(token.text, "without a name")
                reason = f"{token.text!a} ({name}) is not in the grammar; write ASCII letters, digits and signs"
            raise BadExpression(text, token.column, reason)
        yield token
        if kind == "end":
            return


class _Parser:
    """A parser of one text, with its position in the text."""

    def __init__(self, text: str, symbols: Mapping[str, sp.Symbol], tables: Mapping[str, Cells]) -> None:
        self.text, self.symbols, self.tables = text, symbols, tables
        self.tokens: list[Token] = []
        for token in tokens(text):
            if len(self.tokens) == TOKENS:
                raise self.error(token, f"has more than {TOKENS} numbers, names and signs; name parts of it")
            self.tokens.append(token)
        self.position = self.depth = 0
        self.demanded: list[Demand] = []  # by the text as written, before SymPy folds it

    def error(self, token: Token, reason: str) -> BadExpression:
        return BadExpression(self.text, token.column, reason)

    def whole(self) -> sp.Expr:
        value, token = self.number_like(self.value(0), self.tokens[0]), self.next
        if token.text in (")", ","):
            raise self.error(token, f"{token.text!r} has no opening parenthesis or call before it; remove it")
        if token.kind != "end":
            raise self.error(
                token, f"{self.text_of(token)} follows a value; write an operator, such as *, between them"
            )
        return value

    @property
    def next(self) -> Token:
        return self.tokens[self.position]

    def advance(self) -> Token:
        token = self.next
        self.position += token.kind != "end"
        return token

    def accept(self, sign: str) -> bool:
        return self.next.text == sign and bool(self.advance())

    def expect(self, sign: str, where: str) -> None:
        if not self.accept(sign):
            raise self.error(self.next, f"{where} needs {sign!r} here, not {self.text_of(self.next)}")

    def text_of(self, token: Token) -> str:
        return "the end" if token.kind == "end" else repr(token.text[:40])

    def number_like(self, value: sp.Basic, token: Token) -> sp.Expr:
        if not isinstance(value, sp.Expr):
            raise self.error(token, "a condition stands where a value belongs; conditions belong in Piecewise")
        return value

    def argument(self) -> sp.Expr:
        first = self.next
        return self.number_like(self.value(0), first)

    def condition_like(self, value: sp.Basic, token: Token, fix: str) -> sp.Basic:
        if isinstance(value, sp.Expr):
            raise self.error(token, f"{value if value.is_Atom else 'a value'} stands where a condition belongs; {fix}")
        return value

    def value(self, binding: int) -> sp.Basic:
        self.depth += 1
        first = self.next
        if self.depth > DEPTH:
            raise self.error(first, f"is nested more than {DEPTH} deep; flatten it")
        left = self.operand()
        while _BINDING.get(self.next.text, 0) > binding:
            left = _RULES[self.next.text](self, left, first)
        self.depth -= 1
        return left

    def operand(self) -> sp.Basic:
        token = self.advance()
        if token.text in ("+", "-"):
            negative = token.text == "-"
            while self.next.text in ("+", "-"):
                negative ^= self.advance().text == "-"
            value = self.number_like(self.value(_SIGN), token)
            return -value if negative else value
        if token.text == "(":
            value = self.value(0)
            self.expect(")", f"the parenthesis of column {token.column}")
            return value
        if token.kind == "number":
            return self.literal(token)
        if token.kind == "name":
            apply = self.table_value if token.text in self.tables else self.call
            return apply(token) if self.next.text == "(" else self.named(token)
        wanted = "a number, a name or a parenthesis"
        raise self.error(token, f"{self.text_of(token)} stands where {wanted} belongs; complete it")

    def literal(self, token: Token) -> sp.Rational:
        mantissa, _, exponent = token.text.lower().partition("e")
        if len(mantissa) > DIGITS or len(exponent) > 5 or abs(int(exponent or 0)) > DECADES:
            long = f"the number has more than {DIGITS} digits or a power of ten beyond {DECADES}"
            raise self.error(token, f"{long}; write a shorter one")
        if mantissa.isdigit() and not exponent:
            return sp.Integer(int(mantissa))
        return sp.Rational(Fraction(token.text))

    def named(self, token: Token) -> sp.Basic:
        name = token.text
        if name in self.symbols:
            return self.symbols[name]
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        if name in ("True", "False"):
            return sp.true if name == "True" else sp.false
        if name in NAMES or name in self.tables:
            what = "function" if name in NAMES else "table"
            raise self.error(token, f"the {what} {name} needs its argument; write {name}(...)")
        close = get_close_matches(name[:60], [*self.symbols, *_CONSTANTS], n=1, cutoff=0.5)
        few = 0 < len(self.symbols) <= _FEW
        known = f"what can be read here: {', '.join(self.symbols)}" if few else "declare it"
        fix = f"did you mean {close[0]}?" if close else known
        raise self.error(token, f"the name {name[:60]!r} is not declared; {fix}")

    def call(self, token: Token) -> sp.Expr:
        name = token.text
        if name not in NAMES:
            if name in self.symbols or name in _CONSTANTS:
                raise self.error(token, f"{name[:60]!r} is no function; write * before the parenthesis")
            raise self.error(token, refusal(name, self.tables))
        self.advance()
        if name == "Piecewise":
            return self.piecewise(token)
        function, least, most = WRITTEN[name]
        values: list[sp.Expr] = []
        while not values or self.accept(","):
            first = self.next
            values.append(self.argument())
            if len(values) > most:
                raise self.error(first, f"{name} takes {most} argument{'s' * (most > 1)} at most; remove this one")
        self.expect(")", f"{name} of column {token.column}")
        if len(values) < least:
            raise self.error(token, f"{name} needs {least} arguments; it has {len(values)}")
        if name in ("exp", "sinh", "cosh", "sech", "csch", "coth"):
            self.not_huge(values[0], token)
        self.demanded += call_demands(function, *values)
        return self.real(function(*values), token)

    def table_value(self, token: Token) -> sp.Expr:
        self.advance()
        cells, arguments = self.tables[token.text], []
        for k in range(len(cells.axes)):
            if k:
                self.expect(",", f"the table {token.text} of column {token.column}, of {len(cells.axes)} arguments,")
            arguments.append(self.argument())
        self.expect(")", f"the table {token.text} of column {token.column}")
        return applied(cells, arguments)

    def not_huge(self, value: sp.Expr, token: Token) -> None:
        """Refuse exp of a large number, and exp(k log c), which SymPy would write out as the number c**k."""
        if value.is_number and not abs(value.evalf(10)) <= LARGEST_EXP:
            raise self.error(token, f"exp of a number beyond {LARGEST_EXP} is out of range; write a smaller one")
        if value.has(sp.log):
            for term in sp.Add.make_args(value):
                if abs(term.as_coeff_Mul()[0]) > LARGEST_EXP:
                    raise self.error(token, f"exp of more than {LARGEST_EXP} logarithms; write a power")

    def piecewise(self, token: Token) -> sp.Expr:
        """Return a Piecewise of the (value, condition) pairs up to the
        first that is always true; conditions are not solved."""
        pairs: list[tuple[sp.Expr, sp.Basic]] = []
        closed, count, before = False, 0, len(self.demanded)
        while not count or (self.accept(",") and self.next.text != ")"):
            count += 1
            if count > ARGUMENTS:
                raise self.error(self.next, f"Piecewise takes {ARGUMENTS} pairs at most; nest it")
            self.expect("(", "Piecewise((value, condition), ...)")
            value = self.argument()
            self.expect(",", "the pair (value, condition)")
            first = self.next
            condition = self.condition_like(self.value(0), first, "compare with < <= > >= or write True")
            self.expect(")", "the pair (value, condition)")
            if condition != sp.false and not closed:
                pairs.append((value, condition))
            closed |= condition == sp.true
        self.expect(")", f"Piecewise of column {token.column}")
        del self.demanded[before:]  # the branch that applies is unknown here
        if not closed:
            raise self.error(token, "Piecewise has no value where every condition fails; end it with (value, True)")
        if len(pairs) == 1:
            return pairs[0][0]
        try:
            return sp.Piecewise(*pairs, evaluate=False)
        except TypeError:  # a Piecewise in a condition has a branch that is not real
            raise self.error(token, _COMPLEX) from None

    def real(self, value: sp.Expr, token: Token) -> sp.Expr:
        if value in _INFINITE:
            raise self.error(token, "is infinite or undefined here; remove the division by zero or the pole")
        if value.has(sp.I, *_INFINITE) or (value.is_number and value.is_real is False):
            raise self.error(token, _COMPLEX)
        return self.bounded(value, token)

    def bounded(self, value: sp.Expr, token: Token) -> sp.Expr:
        if _bits(value.as_coeff_Mul()[0]) > BITS:
            raise self.error(token, f"makes a number of more than {BITS} bits; write smaller numbers")
        return value

    def sum(self, left: sp.Basic, first: Token) -> sp.Expr:
        """Return `left` plus all following terms, read at once:
        SymPy would sort a growing sum anew with every term."""
        terms, operator = [self.number_like(left, first)], self.next
        while self.next.text in ("+", "-"):
            negative, first = self.advance().text == "-", self.next
            term = self.number_like(self.value(4), first)
            terms.append(-term if negative else term)
        if sum(_bits(term.as_coeff_Mul()[0]) for term in terms) > TOTAL_BITS:
            raise self.error(operator, f"the numbers of the sum have more than {TOTAL_BITS} bits; write shorter ones")
        return self.bounded(sp.Add(*terms), operator)

    def product(self, left: sp.Basic, first: Token) -> sp.Expr:
        operator = self.advance()
        value, start = self.number_like(left, first), self.next
        factor = self.number_like(self.value(5), start)
        if operator.text == "/" and factor == 0:
            raise self.error(operator, "divides by zero; remove the division")
        if operator.text == "*":
            return self.bounded(value * factor, operator)
        self.demanded += power_demands(factor, sp.S.NegativeOne)
        return self.real(value / factor, operator)

    def power(self, left: sp.Basic, first: Token) -> sp.Expr:
        """Return `left` ** the exponent that follows, without expanding a power of numbers to a huge number."""
        operator = self.advance()
        base, start = self.number_like(left, first), self.next
        exponent = self.number_like(self.value(_POWER), start)
        if base == sp.E:
            self.not_huge(exponent, operator)
        if exponent.is_number:
            if base == 0 and exponent.is_negative is not False:
                raise self.error(operator, "divides by zero: a negative power of 0; remove it")
            if not abs(exponent.evalf(10)) <= EXPONENT:
                raise self.error(operator, f"the exponent is beyond {EXPONENT}; write a smaller one")
            if _number_bits(base) * abs(exponent.evalf(10)) > BITS:
                raise self.error(operator, f"makes a number of more than {BITS} bits; write smaller numbers")
        self.demanded += power_demands(base, exponent)
        return self.real(base**exponent, operator)

    def relation(self, left: sp.Basic, first: Token) -> sp.Basic:
        operator = self.advance()
        lhs, start = self.number_like(left, first), self.next
        rhs = self.number_like(self.value(1), start)
        if _BINDING.get(self.next.text) == 1:
            raise self.error(self.next, "compares a comparison; write (a < b) & (b < c)")
        return _RELATIONS[operator.text](lhs, rhs)

    def join(self, left: sp.Basic, first: Token) -> sp.Basic:
        operator = self.advance()
        fix = f"put parentheses around the comparisons on both sides of {operator.text}"
        lhs, start = self.condition_like(left, first, fix), self.next
        rhs = self.condition_like(self.value(_BINDING[operator.text]), start, fix)
        return (sp.And if operator.text == "&" else sp.Or)(lhs, rhs)


_RULES: dict[str, Callable[[_Parser, sp.Basic, Token], sp.Basic]] = {
    **dict.fromkeys(_RELATIONS, _Parser.relation),
    **dict.fromkeys("&|", _Parser.join),
    **dict.fromkeys("+-", _Parser.sum),
    **dict.fromkeys("*/", _Parser.product),
    "**": _Parser.power,
}


def _bits(number: Any) -> int:
    return int(number.p).bit_length() + int(number.q).bit_length() if number.is_Rational and number != 1 else 0


def _number_bits(base: sp.Expr) -> int:
    numbers = [factor for factor in sp.Mul.make_args(base) if factor.is_number and factor not in (0, 1, -1)]
    return max((_bits(atom) for factor in numbers for atom in factor.atoms(sp.Rational)), default=0)
