"""The branches of expressions that points of a box reach: |x| is x where x > 0, and a table one of its polynomials.

On a branch the expressions are analytic, so that what is found at one of its points holds almost everywhere around. A
branch is found by its points: random ones, those that a search along the sides takes to where a kink's argument
changes its sign, and those halfway between two branches, again and again, which find a thin one between them. So there
may be more branches than are found; that none is missing is not proved.
"""

import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import combinations, product
from math import inf
from typing import Any

import sympy as sp
from flint import arb
from sympy.core.relational import Relational
from sympy.logic.boolalg import Boolean

from hgogen.rigor.balls import Undecided, ends, values
from hgogen.rigor.interpolation import Table, polynomial_value
from hgogen.rigor.tape import Tape, tape

Place = Mapping[sp.Symbol, Fraction]
Sides = Mapping[sp.Symbol, tuple[Any, Any]]

BRANCHES = 32  # that are kept
_RANDOM, _PLACES = 256, 24  # points at first; points that are kept of a branch
_WORK = 1_000_000  # instructions of a tape at all points together, which take about a second
_FEWEST, _MOST = 64, 4000  # points in all, whatever their work
_HALVINGS, _PAIRS = 48, 2  # of the way between two points; ways between two branches
_BITS, _FINER = 60, 30  # of a share of a side; of how near to an end
_DECADES = 2  # below and above 1, of what has no range
_KINDS = (sp.Abs, sp.Min, sp.Max, sp.sign, sp.Piecewise, sp.floor, sp.ceiling, sp.Heaviside, Table)
_STEPPED = (Table, sp.floor, sp.ceiling)  # of which the cell, or the whole number, tells the branch
_ONE = (sp.Abs, sp.sign, sp.Heaviside)  # that tell the sign of one argument


@dataclass(frozen=True)
class Branch:
    """The `rows` without kinks and jumps, as they are where all conditions of `where` hold; `places`: points there."""

    rows: tuple[sp.Expr, ...]
    where: tuple[Boolean, ...]
    places: tuple[Place, ...]


@dataclass(frozen=True)
class Reached:
    """The `branches` that `points` of the box reach; `more` were found and left out. There is none where no point was
    found at which all rows have a value."""

    branches: tuple[Branch, ...]
    points: int
    more: int

    @property
    def bent(self) -> bool:
        """Whether there is more than one branch."""
        return len(self.branches) + self.more > 1


def reached(rows: Sequence[sp.Expr], sides: Sides) -> Reached:
    """The branches of some rows in the box of their symbols; a symbol of an infinite side takes numbers of the sizes
    1/100 to 100.

    Raises: `NoTape` for a function without a rule.
    """
    search = _Search(tuple(rows), sides)
    search.run()
    branches: dict[tuple[Any, ...], Branch] = {}
    keys = sorted(search.places, key=lambda key: -search.counts[key])
    for key in keys[: 4 * BRANCHES]:
        walk = _Walk(dict(zip(search.tests, key, strict=True)))
        try:
            taken = tuple(map(walk.taken, rows))
        except Undecided:
            continue
        name = (taken, frozenset(walk.where))
        before = branches[name].places if name in branches else ()
        conditions = tuple(sorted(walk.where, key=sp.default_sort_key))
        branches[name] = Branch(taken, conditions, (*before, *search.places[key])[:_PLACES])
    various = _various(list(branches.values()))
    more = len(keys[4 * BRANCHES :]) + len(various[BRANCHES:])
    return Reached(tuple(various[:BRANCHES]), search.counts.total(), more)


def _various(branches: list[Branch]) -> list[Branch]:
    """The first of each kind, by what its rows read, then the others."""
    first: dict[tuple[Any, ...], Branch] = {}
    for branch in branches:
        first.setdefault(tuple(frozenset(row.free_symbols) for row in branch.rows), branch)
    kinds = {id(branch) for branch in first.values()}
    return sorted(branches, key=lambda branch: id(branch) not in kinds)


# --- points


@dataclass(frozen=True)
class _Search:
    """Points by what they decide: the sign of each test, or the cell or whole number that it is in, None where the
    numbers do not tell. `counts` has how many there are, of None those at which a row has no value."""

    rows: tuple[sp.Expr, ...]
    sides: Sides
    places: dict[tuple[Any, ...], list[Place]] = field(default_factory=dict)
    counts: Counter[tuple[Any, ...] | None] = field(default_factory=Counter)
    draws: random.Random = field(default_factory=lambda: random.Random(1))

    @cached_property
    def tests(self) -> tuple[sp.Basic, ...]:
        """What tells the branch of the rows: the argument of |e|, differences of those of a maximum, both sides of a
        relation, and tables and roundings themselves."""
        tests: dict[sp.Basic, None] = {}
        for node in (node for row in self.rows for node in sp.preorder_traversal(row)):
            if isinstance(node, _ONE):
                tests[node.args[0]] = None
            elif isinstance(node, (sp.Min, sp.Max)):
                tests |= dict.fromkeys(a - b for a, b in combinations(_ordered(node), 2))
            elif isinstance(node, Relational):
                tests[node.lhs - node.rhs] = None
            elif isinstance(node, _STEPPED):
                tests[node] = None
        return tuple(sorted(tests, key=sp.default_sort_key))

    @cached_property
    def tape(self) -> Tape:
        arguments = [part for test in self.tests for part in _read(test)]
        return tape((*arguments, *self.rows), tuple(self.sides))

    @property
    def limit(self) -> int:
        return max(_FEWEST, min(_MOST, _WORK // max(len(self.tape.instructions), 1)))

    @property
    def ended(self) -> bool:
        return self.counts.total() >= self.limit

    def run(self) -> None:
        count = _RANDOM if self.tests else 2 * _PLACES
        for _ in range(min(count, self.limit)):
            self.ask(self.anywhere())
        signed = [k for k, test in enumerate(self.tests) if not isinstance(test, _STEPPED)]
        for k, sign in product(signed, (-1, 1)):
            self.climb({k: sign})
        for (i, k), first, last in product(combinations(signed, 2), (-1, 1), (-1, 1)):
            self.climb({i: first, k: last})
        self.between()

    def anywhere(self) -> Place:
        return {s: self.on(*side) for s, side in self.sides.items()}

    def on(self, low: Any, high: Any) -> Fraction:
        """A random number of a side, not at its ends."""
        share = Fraction(self.draws.randrange(1, 1 << _BITS), 1 << _BITS)
        if low > -inf and high < inf:
            ends = Fraction(low), Fraction(high)
            return ends[0] + (ends[1] - ends[0]) * share
        size: Fraction = Fraction(10 ** self.draws.uniform(-_DECADES, _DECADES)) + share / 2**_BITS
        if low > -inf or high < inf:
            return Fraction(low) + size if low > -inf else Fraction(high) - size
        return size if self.draws.random() < 0.5 else -size

    def ask(self, place: Place) -> tuple[tuple[Any, ...], list[Any]] | None:
        """What is decided at a point, and the tests' values; None where a row has no value, or at the limit."""
        if self.ended:
            return None
        balls = values(self.tape, list(place.values()))
        if not all(ball.is_finite() for ball in balls[len(balls) - len(self.rows) :]):
            self.counts[None] += 1
            return None
        rest = iter(balls)
        parts = [[next(rest) for _ in _read(test)] for test in self.tests]
        key = tuple(_decision(test, part) for test, part in zip(self.tests, parts, strict=True))
        self.counts[key] += 1
        here = self.places.setdefault(key, [])
        if len(here) < _PLACES:
            here.append(place)
        return key, [part[0] for part in parts]

    def climb(self, wanted: Mapping[int, int]) -> None:
        """Where no point has these signs of tests, walk along the sides from one that has all but the last of them."""
        *others, last = wanted
        if any(all(key[k] == sign for k, sign in wanted.items()) for key in self.places):
            return
        starts = [places[0] for key, places in self.places.items() if all(key[k] == wanted[k] for k in others)]
        here, best = (starts or [self.anywhere()])[0], arb("nan")
        ways = [(s, end) for s, side in self.sides.items() for end in side]
        for s, end in (ways[0], *ways, *ways):
            moved = {**here, s: self.near(end, self.sides[s])}
            asked = self.ask(moved)
            if asked is None or any(asked[0][k] != wanted[k] for k in others):
                continue
            if asked[0][last] == wanted[last]:
                return
            if not best.is_finite() or (asked[1][last] - best) * wanted[last] > 0:
                here, best = moved, asked[1][last]

    def near(self, end: Any, side: tuple[Any, Any]) -> Fraction:
        """A number of a side, next to one of its ends."""
        low, high = side
        if low == -inf or high == inf:
            return self.on(low, high)
        share = Fraction(self.draws.randrange(1, 1 << _BITS), 1 << (_BITS + _FINER))
        width: Fraction = Fraction(high) - Fraction(low)
        return Fraction(end) + width * (share if end == low else -share)

    def between(self) -> None:
        """Halve the way between points of each two branches to where one ends, which finds what lies between."""
        ways = Counter[tuple[Any, Any]]()
        while not self.ended:
            pairs = combinations(list(self.places), 2)
            a, b = next((pair for pair in pairs if ways[pair] < _PAIRS), (None, None))
            if a is None or b is None:
                return
            ways[a, b] += 1
            p, q = (self.draws.choice(self.places[key]) for key in (a, b))
            for _ in range(_HALVINGS):
                middle = {s: (p[s] + q[s]) / 2 for s in p}
                asked = self.ask(middle)
                if asked is None or asked[0] not in (a, b):
                    break
                p, q = (middle, q) if asked[0] == a else (p, middle)


def _ordered(node: sp.Expr) -> list[sp.Expr]:
    """The arguments of a minimum or maximum in an order that is the same in every run."""
    return sorted(node.args, key=sp.default_sort_key)


def _read(test: sp.Basic) -> tuple[sp.Expr, ...]:
    return tuple(test.args) if isinstance(test, _STEPPED) else (test,)


def _decision(test: sp.Basic, balls: Sequence[Any]) -> Any:
    if not all(ball.is_finite() for ball in balls):
        return None
    if isinstance(test, Table):
        return test.cells.cell([ends(ball) for ball in balls])
    (ball,) = balls
    if isinstance(test, (sp.floor, sp.ceiling)):
        whole = None if ball.contains_integer() else ball.floor().unique_fmpz()
        return None if whole is None else int(whole)  # its ends are rounded, so that it may be none next to one
    return 1 if ball > 0 else -1 if ball < 0 else 0 if ball.is_zero() else None


# --- the expressions there


@dataclass(frozen=True)
class _Walk:
    """Expressions where the tests are decided; `where` gathers the conditions that were needed."""

    decided: Mapping[sp.Basic, Any]
    where: dict[Boolean, None] = field(default_factory=dict)

    def taken(self, node: sp.Expr) -> sp.Expr:
        if not node.args or not node.has(*_KINDS):
            return node
        if isinstance(node, sp.Piecewise):
            return self.taken(next(self.pieces(node)))
        if isinstance(node, (sp.Min, sp.Max)):
            return self.extreme(node)
        args = [self.taken(part) for part in node.args]
        if isinstance(node, _ONE):
            way = self.way(node.args[0], args[0])
            if isinstance(node, sp.Heaviside):
                return (1 + way) / 2
            return way * args[0] if isinstance(node, sp.Abs) else way
        if isinstance(node, (sp.floor, sp.ceiling)):
            return self.level(node, args[0])
        return self.polynomial(node, args) if isinstance(node, Table) else node.func(*args)

    def needs(self, condition: sp.Basic) -> None:
        if condition not in (sp.true, sp.false):
            self.where[condition.canonical] = None

    def sign(self, test: sp.Expr) -> int:
        """The sign of a test, 0 where it is 0 around the point."""
        sign = self.decided.get(test)
        if sign is None:
            raise Undecided
        return int(sign)

    def way(self, before: sp.Expr, argument: sp.Expr) -> sp.Integer:
        """The sign of an argument that is not 0."""
        if argument.is_number and argument.is_zero is not None:
            return sp.sign(argument)
        way = self.sign(before)
        if way == 0:
            raise Undecided
        self.needs(argument > 0 if way > 0 else argument < 0)
        return sp.Integer(way)

    def extreme(self, node: sp.Expr) -> sp.Expr:
        way, read = 1 if isinstance(node, sp.Max) else -1, _ordered(node)
        args, best = [self.taken(part) for part in read], 0
        for k in range(1, len(args)):
            if args[k] != args[best] and way * self.sign(read[best] - read[k]) < 0:
                best = k
        for k, other in enumerate(args):
            if other != args[best]:
                if self.sign(read[min(k, best)] - read[max(k, best)]) == 0:
                    raise Undecided
                self.needs(args[best] > other if way > 0 else args[best] < other)
        return args[best]

    def level(self, node: sp.Expr, argument: sp.Expr) -> sp.Expr:
        """The whole number that an argument is rounded to."""
        if argument.is_number:
            return node.func(argument)
        low = self.decided[node]
        if low is None:
            raise Undecided
        self.needs(argument > low)
        self.needs(argument < low + 1)
        return sp.Integer(low + isinstance(node, sp.ceiling))

    def polynomial(self, node: Table, args: Sequence[sp.Expr]) -> sp.Expr:
        cell = self.decided[node]
        if cell is None:
            raise Undecided
        for argument, axis, k in zip(args, node.cells.axes, cell, strict=True):
            if k > 0 and (axis.held or k > 1):
                self.needs(argument > sp.sympify(axis.x[k - 1]))
            if k < len(axis.x) and (axis.held or k < len(axis.x) - 1):
                self.needs(argument < sp.sympify(axis.x[k]))
        d = [a - sp.sympify(start) for a, start in zip(args, node.cells.starts(cell), strict=True)]
        return sp.sympify(polynomial_value(node.cells.of_order(node.order)[cell], d, sp.sympify))

    def pieces(self, node: sp.Piecewise) -> Iterator[sp.Expr]:
        """The value whose condition is the first that holds."""
        for piece, condition in node.args:
            if self.holds(condition):
                yield piece
        raise Undecided  # it has no value here

    def holds(self, condition: sp.Basic) -> bool:
        if isinstance(condition, (sp.And, sp.Or)):
            each = [self.holds(part) for part in condition.args]
            return all(each) if isinstance(condition, sp.And) else any(each)
        if isinstance(condition, sp.Not):
            return not self.holds(condition.args[0])
        if not isinstance(condition, Relational):
            return bool(condition)
        sign = self.sign(condition.lhs - condition.rhs)
        truth = bool(condition.func(sp.Integer(sign), 0))
        if not isinstance(condition, (sp.Eq, sp.Ne)):
            sides = map(self.taken, condition.args)
            self.needs((condition if truth else condition.negated).func(*sides))
        return truth
