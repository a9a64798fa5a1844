"""Oracle: generic observability by divided differences modulo the square of a prime; nothing of hgogen.

A number modulo p^2 is a dual number: F(x + p v) - F(x) = p F'(x) v. So the Taylor coefficients of the outputs, by
the plain recurrences of + * / in integers modulo p^2, from the point and from the point moved by p in each unknown,
give the gradient of every derivative of the outputs without a variational equation.

Exponentials, logarithms and real powers become generators whose value at the point is a random number: a log for each
irreducible factor, an exp for each term of an exponent, f^(1/q) as the q-th root modulo p. By Ax's theorem the logs
of distinct irreducible factors, and the exps of terms that are independent over the rationals modulo constants, are
algebraically independent; terms that are not are refused (`Dependent`).
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import mul

import sympy as sp

from tests.oracle.text import read

PRIME = 576460752303422159  # 7 mod 8; 2, 3, 5, 7, 11, 13 are squares; 3, 5, 7 do not divide PRIME - 1
SQUARE = PRIME**2
HALF = (PRIME - 1) // 2


class Dependent(Exception):
    """Exponents that are not independent: their exponentials are no independent generators."""


@dataclass
class Tower:
    """Generators over the rational functions, in the order in which they rest on each other: kind, argument, q."""

    found: dict[sp.Symbol, tuple[str, sp.Expr, int]] = field(default_factory=dict)
    logs: dict[sp.Symbol, sp.Expr] = field(default_factory=dict)

    def rational(self, e: sp.Expr) -> sp.Expr:
        """The expression as a rational function of symbols and generators."""
        if not e.args or not any(_special(part) for part in sp.preorder_traversal(e)):
            return e
        if isinstance(e, sp.log):
            return self.log(self.rational(e.args[0]))
        if isinstance(e, sp.exp):
            return self.exp(self.rational(e.args[0]))
        args = [self.rational(part) for part in e.args]
        return self.exp(args[1] * self.log(args[0])) if _special(e) else e.func(*args)

    def generator(self, kind: str, argument: sp.Expr, q: int = 1) -> sp.Symbol:
        for symbol, entry in self.found.items():
            if entry == (kind, argument, q):
                return symbol
        symbol = sp.Symbol(f"{kind}_{len(self.found)}'")
        self.found[symbol] = (kind, argument, q)
        return symbol

    def log(self, e: sp.Expr) -> sp.Expr:
        total = sp.S.Zero
        for part, sign in zip(sp.fraction(sp.together(e)), (1, -1), strict=True):
            constant, factors = sp.factor_list(part) if part.free_symbols else (part, [])
            factors = [list(pair) for pair in factors]
            if constant < 0:
                odd = next(pair for pair in factors if pair[1] % 2)
                odd[0], constant = sp.expand(-odd[0]), -constant
            factors += [[sp.Integer(base), power] for base, power in sp.factorrat(sp.Rational(constant)).items()]
            for base, power in factors:
                assert sp.expand(-base) not in self.logs.values()
                symbol = self.generator("log", base)
                self.logs[symbol] = base
                total += sign * power * symbol
        return total

    def exp(self, e: sp.Expr) -> sp.Expr:
        result = sp.S.One
        for term in sp.Add.make_args(sp.expand(e)):
            factor, rest = term.as_coeff_Mul(rational=True)
            top, bottom = int(factor.p), int(factor.q)
            if rest in self.logs:
                base = self.logs[rest]
                result *= base**top if bottom == 1 else self.generator("root", base, bottom) ** top
            elif term != 0:
                result *= self.generator("exp", rest / bottom) ** top
        return result


def _special(e: sp.Basic) -> bool:
    return isinstance(e, sp.exp | sp.log) or (isinstance(e, sp.Pow) and not e.exp.is_Integer)


class Program:
    """Taylor coefficients, order by order, of all runs: run 0 at the point, run j with unknown j moved by PRIME."""

    def __init__(self, tower: Tower, expressions: list[sp.Expr], unknowns: list[sp.Symbol], n: int, seed: int) -> None:
        self.draw = random.Random(seed)
        self.n, self.unknowns, self.runs = n, unknowns, len(unknowns) + 1
        self.kinds: list[tuple[str, tuple[int, ...], object]] = []
        self.at: dict[object, int] = {}
        self.values: list[list[list[int]]] = []  # by node, by run
        self.moving = {s: j for j, s in enumerate(unknowns)}
        self.inputs: set[sp.Symbol] = set()
        self.generators = tower.found
        self.expressions = expressions

    def build(self, inputs: set[sp.Symbol]) -> None:
        self.inputs = inputs
        for symbol, (kind, argument, q) in self.generators.items():
            self.at[symbol] = self._put(kind, (self._place(argument),), q)
        self.outputs = [self._place(e) for e in self.expressions]
        for symbol in self.unknowns:
            self._place(symbol)
        self.values = [[[] for _ in range(self.runs)] for _ in self.kinds]

    def _put(self, kind: str, args: tuple[int, ...], value: object = None) -> int:
        key = (kind, args, value)
        if key not in self.at:
            self.at[key] = len(self.kinds)
            self.kinds.append(key)
        return self.at[key]

    def _place(self, e: sp.Expr) -> int:
        if e not in self.at:
            self.at[e] = self._write(e)
        return self.at[e]

    def _write(self, e: sp.Expr) -> int:
        if e.is_Rational:
            return self._put("number", (), int(e.p) * pow(int(e.q), -1, SQUARE) % SQUARE)
        if e.is_Float:
            return self._write(sp.Rational(str(e)))
        if e.is_Symbol:
            return self._put("symbol", (), e)
        if e.is_Pow and e.exp < 0:
            return self._put("over", (self._put("number", (), 1), self._place(e.base ** (-e.exp))))
        if e.is_Pow:
            half = self._place(e.base ** (e.exp // 2))
            square = self._put("mul", (half, half))
            return square if e.exp % 2 == 0 else self._put("mul", (square, self._place(e.base)))
        if e.is_Add:
            return self._put("add", tuple(self._place(part) for part in e.args))
        assert e.is_Mul, e
        numerator, denominator = e.as_numer_denom() if any(a.is_Pow and a.exp < 0 for a in e.args) else (e, sp.S.One)
        if denominator != 1:
            return self._put("over", (self._place(numerator), self._place(denominator)))
        place = self._place(e.args[0])
        for part in e.args[1:]:
            place = self._put("mul", (place, self._place(part)))
        return place

    def residue(self, polynomial: sp.Expr) -> int:
        """A polynomial's value at the point modulo PRIME."""
        at = {s: self.values[self.at[s]][0][0] for s in polynomial.free_symbols}
        top, bottom = sp.fraction(sp.together(polynomial.xreplace(at)))
        return int(top) * pow(int(bottom), -1, PRIME) % PRIME

    def step(self, k: int) -> None:
        """The coefficient k of every node, then that of k + 1 of the states."""
        for node, (kind, args, value) in enumerate(self.kinds):
            if kind == "symbol":
                self._symbol(node, value, k)
                continue
            new = self.values[node]
            for run in range(self.runs):
                parts = [self.values[a][run] for a in args]
                new[run].append(_RULES[kind](new[run], parts, value, k) if k or kind not in _STARTS else 0)
            if k == 0 and kind in _STARTS:
                self._start(node, kind, args[0], value)

    def _symbol(self, node: int, symbol: sp.Symbol, k: int) -> None:
        lists = self.values[node]
        j = self.moving.get(symbol)
        if k == 0 or symbol in self.inputs:
            value = pow(self.draw.randrange(2, PRIME), 2, PRIME)
            for run in range(self.runs):
                lists[run].append(value + PRIME if k == 0 and j is not None and run == j + 1 else value)
        elif j is not None and j < self.n:
            for run in range(self.runs):
                lists[run].append(self.values[self.outputs[j]][run][k - 1] * pow(k, -1, SQUARE) % SQUARE)
        else:
            for run in range(self.runs):
                lists[run].append(0)

    def _start(self, node: int, kind: str, argument: int, q: int) -> None:
        """A generator at the point, a random number or a root, and how it moves with its argument."""
        a = self.values[argument][0][0]
        if kind == "root":
            if pow(a, HALF, PRIME) != 1:
                raise ZeroDivisionError
            z = pow(a, pow(q, -1, HALF), PRIME)
        else:
            z = pow(self.draw.randrange(2, PRIME), 2, PRIME)
        slope = {"exp": z, "log": pow(a, -1, SQUARE), "root": z * pow(q * a, -1, SQUARE) if kind == "root" else 0}[kind]
        for run in range(self.runs):
            moved = self.values[argument][run][0] - a
            self.values[node][run][0] = (z + slope * moved) % SQUARE


def _over(own, parts, _, k):
    a, b = parts
    return (a[k] - sum(map(mul, own, b[k:0:-1]))) * _inverse(b[0]) % SQUARE


def _exp(own, parts, _, k):
    (a,) = parts
    return sum(j * a[j] * own[k - j] for j in range(1, k + 1)) * pow(k, -1, SQUARE) % SQUARE


def _log(own, parts, _, k):
    (a,) = parts
    rest = sum(j * own[j] * a[k - j] for j in range(1, k)) * pow(k, -1, SQUARE)
    return (a[k] - rest) * _inverse(a[0]) % SQUARE


def _root(own, parts, q, k):
    (a,) = parts
    total = sum((j - q * (k - j)) * a[j] * own[k - j] for j in range(1, k + 1))
    return total * _inverse(q * k * a[0]) % SQUARE


def _inverse(a: int) -> int:
    if a % PRIME == 0:
        raise ZeroDivisionError
    return pow(a, -1, SQUARE)


_STARTS = ("exp", "log", "root")
_RULES = {
    "number": lambda own, parts, value, k: value if k == 0 else 0,
    "add": lambda own, parts, _, k: sum(part[k] for part in parts) % SQUARE,
    "mul": lambda own, parts, _, k: sum(map(mul, parts[0], reversed(parts[1]))) % SQUARE,
    "over": _over,
    "exp": _exp,
    "log": _log,
    "root": _root,
}


def rows(program: Program) -> Iterator[list[list[int]]]:
    """The gradients of all outputs' k-th Taylor coefficients modulo PRIME, k = 0, 1, .."""
    k = 0
    while True:
        program.step(k)
        gradients = []
        for node in program.outputs[program.n :]:
            base, *moved = (program.values[node][run][k] for run in range(program.runs))
            gradients.append([(value - base) % SQUARE // PRIME for value in moved])
        yield gradients
        k += 1


class Echelon:
    """Reduced rows modulo PRIME, each with 1 at its pivot and 0 at the others'."""

    def __init__(self) -> None:
        self.pivots: dict[int, list[int]] = {}

    def add(self, row: list[int]) -> bool:
        """Whether the row is new."""
        row = list(row)
        for column, pivot in self.pivots.items():
            if row[column]:
                factor = row[column]
                row = [(a - factor * b) % PRIME for a, b in zip(row, pivot, strict=True)]
        column = next((j for j, entry in enumerate(row) if entry), None)
        if column is None:
            return False
        inverse = pow(row[column], -1, PRIME)
        row = [entry * inverse % PRIME for entry in row]
        for j, pivot in self.pivots.items():
            if pivot[column]:
                factor = pivot[column]
                self.pivots[j] = [(a - factor * b) % PRIME for a, b in zip(pivot, row, strict=True)]
        self.pivots[column] = row
        return True

    def seen(self) -> list[int]:
        """The unknowns whose unit vector lies in the row space."""
        return sorted(j for j, row in self.pivots.items() if sum(map(bool, row)) == 1)


def independent(tower: Tower, seed: int) -> None:
    """Raise `Dependent` unless the exponents are independent over the rationals modulo constants."""
    exponents = [argument for kind, argument, _ in tower.found.values() if kind == "exp"]
    symbols = sorted(set().union(*(e.free_symbols for e in exponents), set()), key=str)
    draw = random.Random(seed)
    table = []
    for _ in range(len(exponents) + 3):
        point = {s: sp.Integer(draw.randrange(2, 10**6)) for s in symbols}
        values = (sp.Rational(e.xreplace(point)) for e in exponents)
        table.append([int(v.p) * pow(int(v.q), -1, PRIME) % PRIME for v in values])
    first, *others = table
    echelon = Echelon()
    count = sum(echelon.add([(a - b) % PRIME for a, b in zip(row, first, strict=True)]) for row in others)
    if count < len(exponents):
        raise Dependent(exponents)


def observability(flow, output, states, inputs=(), parameters=(), seed=1):
    """(known, joint), each (rank, order, names of the individually observable)."""
    tower = Tower()
    expressions = [tower.rational(sp.sympify(e)) for e in (*flow, *output)]
    independent(tower, seed)
    unknowns = [*states, *parameters]
    for attempt in range(400):
        program = Program(tower, expressions, unknowns, len(states), seed + 1000 * attempt)
        program.build(set(inputs))
        try:
            return _answer(program, [s.name for s in unknowns])
        except ZeroDivisionError:
            continue
    raise ArithmeticError("undefined at every point that was tried")


def _answer(program: Program, names: list[str]):
    widths = [program.n, len(names)]
    echelons, done = [Echelon() for _ in widths], [None, None]
    for k, new in enumerate(rows(program)):
        for i, width in enumerate(widths):
            if done[i] is None:
                grown = sum(echelons[i].add(row[:width]) for row in new)
                full = len(echelons[i].pivots) == width
                if full or not grown:
                    seen = [names[j] for j in echelons[i].seen()]
                    done[i] = (len(echelons[i].pivots), max(k if grown else k - 1, 0), seen)
        if None not in done:
            return tuple(done)
    raise AssertionError


def parse(model: dict) -> tuple[list[sp.Expr], list[sp.Expr], list[sp.Symbol], list[sp.Symbol], list[sp.Symbol]]:
    """Flow, output, states, inputs and unknown parameters of a model of the shared file."""
    names = [*model["states"], *model["unknown_params"], *model["known_params"], *model["inputs"]]
    symbols = {name: sp.Symbol(name) for name in names}
    flow, output = ([read(text, symbols) for text in model[key]] for key in ("f", "h"))
    joint = model["unknown_params"] or model["known_params"]
    return flow, output, *([symbols[name] for name in part] for part in (model["states"], model["inputs"], joint))
