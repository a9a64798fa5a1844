"""Generic observability: ranks of the gradients of an output's derivatives, and branches of expressions on a box.

On a branch the expressions are analytic: |x| is x where x > 0, and a table is one of its polynomials. So a result at
one point of a branch holds almost everywhere around it. A branch is found by its points: random points, points of a
search along the sides towards a change of sign of a kink's argument, and midpoints between points of two branches, by
repeated bisection, which find thin branches between them. There may be more branches than are found.

The observability rank is that of the gradients of an output's derivatives at a random point.

    O_k = d(y, y', .., y^(k)) / d(x, p),   rank O_k = rank O_(k+1)  =>  no later derivative adds to it

With all derivatives of the inputs free, the span of the rows over the field of functions of x, p, u, u', .. is closed
under d/dt once it is stationary, so the test is final. A rational model is evaluated modulo a prime of 61 bits: the
rank there is at most the generic rank for certain, and smaller with a probability of the order of 1e-15. With exp, sin,
roots or real powers the numbers are balls. A pivot is an entry whose ball excludes zero, so the rank is at least the
number of pivots, for certain at this point. A residual counts as zero when its ball contains zero and is tiny, at 1024
bits; a ball that contains zero and is not tiny raises `TooImprecise`, since more bits may decide. Source: A.
Sedoglavic, J. Symbolic Computation 33 (2002).
"""

import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, reduce
from itertools import combinations, product
from math import inf
from typing import Annotated, Any, TypeVar

import flint
import sympy as sp
from flint import arb
from sympy.core.relational import Relational
from sympy.logic.boolalg import Boolean

from hgogen.errors import HgogenError
from hgogen.rigor.box import substituted
from hgogen.rigor.definite import number
from hgogen.rigor.lookup import Table, polynomial_value
from hgogen.rigor.series import (
    BRANCHING,
    OPERATIONS,
    Arithmetic,
    BallSeries,
    ModularSeries,
    Plant,
    Point,
    Undecided,
    ends,
    evaluate,
    gradients,
    random_point,
    values,
)
from hgogen.rigor.tape import Tape, tape
from hgogen.rigor.zero_point import Values, zero_near
from hgogen.signal import Time

Place = Mapping[sp.Symbol, Fraction]
Sides = Mapping[sp.Symbol, tuple[Any, Any]]
Project = Callable[[Place], Place | None]

BRANCHES = 32  # most branches of a result
_RANDOM, _PLACES = 256, 24  # random points at first; most stored points of a branch
_WORK = 1_000_000  # instructions of a tape at all points together, about a second
_FEWEST, _MOST = 64, 4000  # bounds of the number of points
_HALVINGS, _PAIRS = 48, 2  # bisections between two points; such lines between two branches
_BITS, _FINER = 60, 30  # bits of a random share of a side; further bits next to an end
_PROJECTED = 1e-9  # of a side: how far a projected point is from the set, at most
_DECADES = 2  # decades below and above 1, for symbols without a range
_KINDS = (sp.Abs, sp.Min, sp.Max, sp.sign, sp.Piecewise, sp.floor, sp.ceiling, sp.Heaviside, Table)
_STEPPED = (Table, sp.floor, sp.ceiling)  # the branch is the cell, or the whole number
_ONE = (sp.Abs, sp.sign, sp.Heaviside)  # the branch is the sign of one argument


@dataclass(frozen=True)
class Branch:
    """A branch of piecewise expressions: `rows`, the expressions without kinks and jumps, valid where all conditions
    `where` hold; `places`: sample points where they hold."""

    rows: tuple[sp.Expr, ...]
    where: tuple[Boolean, ...]
    places: tuple[Place, ...]


@dataclass(frozen=True)
class SampledBranches:
    """The `branches` of piecewise expressions that a number of sample `points` of a box reach; `more`: how many further
    branches they reach. There are none if no sample point gives all expressions a value."""

    branches: tuple[Branch, ...]
    points: int
    more: int

    @property
    def branching(self) -> bool:
        """Return whether there is more than one branch."""
        return len(self.branches) + self.more > 1


def sampled_branches(rows: Sequence[sp.Expr], sides: Sides, project: Project | None = None) -> SampledBranches:
    """Return the branches of piecewise expressions that sample points of the box reach. `sides`: the range of each
    symbol; an unbounded side is sampled at sizes from 1/100 to 100. `project`: a function from a point to a nearby
    point of a set (or None), if only points of that set count. Raises: `NoTape` for a function without a rule."""
    search = _Search(tuple(rows), sides, project)
    search.run()
    branches: dict[tuple[Any, ...], Branch] = {}
    keys = sorted(search.places, key=lambda key: -search.counts[key])
    for key in keys[: 4 * BRANCHES]:
        walk = _Walk(dict(zip(search.tests, key, strict=True)))
        try:
            there = tuple(map(walk.branch, rows))
        except Undecided:
            continue
        name = (there, frozenset(walk.where))
        before = branches[name].places if name in branches else ()
        conditions = tuple(sorted(walk.where, key=sp.default_sort_key))
        branches[name] = Branch(there, conditions, (*before, *search.places[key])[:_PLACES])
    # the first branch for each set of symbols that its rows read, then the others
    first: dict[tuple[Any, ...], Branch] = {}
    for branch in branches.values():
        first.setdefault(tuple(frozenset(row.free_symbols) for row in branch.rows), branch)
    kinds = {id(branch) for branch in first.values()}
    various = sorted(branches.values(), key=lambda branch: id(branch) not in kinds)
    more = len(keys[4 * BRANCHES :]) + len(various[BRANCHES:])
    return SampledBranches(tuple(various[:BRANCHES]), search.counts.total(), more)


# --- points


@dataclass(frozen=True)
class _Search:
    """A random search for points on every branch of the piecewise expressions `rows`. `places`: sample points by
    branch, the tuple of the sign, table cell or rounded integer of each test. `counts`: the number of points by branch;
    under None the points where a row has no value."""

    rows: tuple[sp.Expr, ...]
    sides: Sides
    project: Project | None = None
    places: dict[tuple[Any, ...], list[Place]] = field(default_factory=dict)
    counts: Counter[tuple[Any, ...] | None] = field(default_factory=Counter)
    draws: random.Random = field(default_factory=lambda: random.Random(1))

    @cached_property
    def tests(self) -> tuple[sp.Basic, ...]:
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
            self.decide(self.anywhere())
        signed = [k for k, test in enumerate(self.tests) if not isinstance(test, _STEPPED)]
        for k, sign in product(signed, (-1, 1)):
            self.climb({k: sign})
        for (i, k), first, last in product(combinations(signed, 2), (-1, 1), (-1, 1)):
            self.climb({i: first, k: last})
        self.between()

    def anywhere(self) -> Place:
        return {s: self.on(*side) for s, side in self.sides.items()}

    def on(self, low: Any, high: Any) -> Fraction:
        share = Fraction(self.draws.randrange(1, 1 << _BITS), 1 << _BITS)
        if low > -inf and high < inf:
            ends = Fraction(low), Fraction(high)
            return ends[0] + (ends[1] - ends[0]) * share
        size: Fraction = Fraction(10 ** self.draws.uniform(-_DECADES, _DECADES)) + share / 2**_BITS
        if low > -inf or high < inf:
            return Fraction(low) + size if low > -inf else Fraction(high) - size
        return size if self.draws.random() < 0.5 else -size

    def decide(self, place: Place) -> tuple[tuple[Any, ...], list[Any]] | None:
        if self.ended:
            return None
        projected = self.project(place) if self.project else place
        if projected is None:
            self.counts[None] += 1
            return None
        place = projected
        point = [self.around(s, value) if self.project else value for s, value in place.items()]
        balls = values(self.tape, point)
        if not all(ball.is_finite() for ball in balls[len(balls) - len(self.rows) :]):
            self.counts[None] += 1
            return None
        remaining = iter(balls)
        parts = [[next(remaining) for _ in _read(test)] for test in self.tests]
        key = tuple(_decision(test, part) for test, part in zip(self.tests, parts, strict=True))
        self.counts[key] += 1
        here = self.places.setdefault(key, [])
        if len(here) < _PLACES:
            here.append(place)
        return key, [part[0] for part in parts]

    def around(self, symbol: sp.Symbol, value: Fraction) -> Any:
        """Return a ball around a coordinate of a projected point that contains the coordinate of the exact point of the
        set."""
        low, high = self.sides[symbol]
        size = high - low if -inf < low < high < inf else max(abs(value), Fraction(1))
        return arb(number(value), _PROJECTED * float(size))

    def climb(self, wanted: Mapping[int, int]) -> None:
        *others, last = wanted
        if any(all(key[k] == sign for k, sign in wanted.items()) for key in self.places):
            return
        starts = [places[0] for key, places in self.places.items() if all(key[k] == wanted[k] for k in others)]
        here, best = (starts or [self.anywhere()])[0], arb("nan")
        ways = [(s, end) for s, side in self.sides.items() for end in side]
        for s, end in (ways[0], *ways, *ways):
            trial = {**here, s: self.near(end, self.sides[s])}
            decided, tests = self.decide(trial) or (None, ())
            if decided is None or any(decided[k] != wanted[k] for k in others):
                continue
            if decided[last] == wanted[last]:
                return
            if not best.is_finite() or (tests[last] - best) * wanted[last] > 0:
                here, best = trial, tests[last]

    def near(self, end: Any, side: tuple[Any, Any]) -> Fraction:
        low, high = side
        if low == -inf or high == inf:
            return self.on(low, high)
        share = Fraction(self.draws.randrange(1, 1 << _BITS), 1 << (_BITS + _FINER))
        width: Fraction = Fraction(high) - Fraction(low)
        return Fraction(end) + width * (share if end == low else -share)

    def between(self) -> None:
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
                decided, _ = self.decide(middle) or (None, ())
                if decided not in (a, b):
                    break
                p, q = (middle, q) if decided == a else (p, middle)


def _ordered(node: sp.Expr) -> list[sp.Expr]:
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
        return None if whole is None else int(whole)  # None next to a whole number, since the ball's ends are rounded
    return 1 if ball > 0 else -1 if ball < 0 else 0 if ball.is_zero() else None


# --- the expressions there


@dataclass(frozen=True)
class _Walk:
    """A translation of piecewise expressions to one branch. `decided`: the sign, table cell or integer of each test on
    the branch; `where`: the conditions under which the translation is valid, collected on the way."""

    decided: Mapping[sp.Basic, Any]
    where: dict[Boolean, None] = field(default_factory=dict)

    def branch(self, node: sp.Expr) -> sp.Expr:
        if not node.args or not node.has(*_KINDS):
            return node
        if isinstance(node, sp.Piecewise):
            return self.branch(next(self.pieces(node)))
        if isinstance(node, (sp.Min, sp.Max)):
            return self.extreme(node)
        args = [self.branch(part) for part in node.args]
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
        sign = self.decided.get(test)
        if sign is None:
            raise Undecided
        return int(sign)

    def way(self, before: sp.Expr, argument: sp.Expr) -> sp.Integer:
        if argument.is_number and argument.is_zero is not None:
            return sp.sign(argument)
        way = self.sign(before)
        if way == 0:
            raise Undecided
        self.needs(argument > 0 if way > 0 else argument < 0)
        return sp.Integer(way)

    def extreme(self, node: sp.Expr) -> sp.Expr:
        way, read = 1 if isinstance(node, sp.Max) else -1, _ordered(node)
        args, best = [self.branch(part) for part in read], 0
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
            if k > 0 and (axis.clamped or k > 1):
                self.needs(argument > sp.sympify(axis.x[k - 1]))
            if k < len(axis.x) and (axis.clamped or k < len(axis.x) - 1):
                self.needs(argument < sp.sympify(axis.x[k]))
        d = [a - sp.sympify(start) for a, start in zip(args, node.cells.starts(cell), strict=True)]
        return sp.sympify(polynomial_value(node.cells.of_order(node.order)[cell], d, sp.sympify))

    def pieces(self, node: sp.Piecewise) -> Iterator[sp.Expr]:
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
            sides = map(self.branch, condition.args)
            self.needs((condition if truth else condition.negated).func(*sides))
        return truth


# --- new rows and kernels

Row = Sequence[Any]

ZERO_BITS = 1024  # precision at which a tiny number, below 2^-341, counts as zero


class TooImprecise(ArithmeticError):
    """The error that the precision of a ball does not decide whether an entry of a matrix is zero."""


def demand_precise_zeros(modulus: int) -> None:
    """Raise `TooImprecise` for balls (`modulus` 0) at a precision too low to take an entry that is nearly zero for
    zero."""
    if not modulus and flint.ctx.prec < ZERO_BITS:
        raise TooImprecise


def independent_rows(rows: Sequence[Row], modulus: int) -> list[int]:
    """Return the indices of the rows that are linearly independent of the rows before them; `modulus`: a prime, or 0
    for balls."""
    if not rows or not rows[0]:
        return []
    if not modulus:
        return [i for i, _, _ in _eliminated(rows)]
    entries = [e for row in rows for e in row]
    reduced, rank = flint.nmod_mat(len(rows), len(rows[0]), entries, modulus).transpose().rref()
    return [next(j for j in range(len(rows)) if reduced[i, j] != 0) for i in range(rank)]  # the pivots


def nullspace_basis(rows: Sequence[Row], width: int, modulus: int) -> list[list[Any]]:
    """Return a basis v_1, v_2, .. of the vectors v (width) with row . v = 0 for all rows; entries taken for zero are 0.
    `modulus`: a prime, or 0 for balls. Raises: `TooImprecise`."""
    if not rows:
        return [[int(i == j) for i in range(width)] for j in range(width)]
    if modulus:
        matrix = flint.nmod_mat(len(rows), width, [e for row in rows for e in row], modulus)
        nullspace, nullity = matrix.nullspace()
        return [[int(nullspace[i, j]) for i in range(width)] for j in range(nullity)]
    reduced = _eliminated(rows)
    columns = [column for _, column, _ in reduced]
    free = [j for j in range(width) if j not in columns]
    basis = []
    for j in free:  # by back substitution
        vector = [flint.arb(int(i == j)) for i in range(width)]
        for _, column, pivot in reversed(reduced):  # a row's pivot column is zero in the rows after it
            vector[column] = -sum((pivot[k] * vector[k] for k in range(width) if k != column), flint.arb(0))
        basis.append([flint.arb(0) if _counts_as_zero(entry) else entry for entry in vector])
    return basis


def _eliminated(rows: Sequence[Row]) -> list[tuple[int, int, list[Any]]]:
    reduced: list[tuple[int, int, list[Any]]] = []
    for i, row in enumerate(rows):
        residual = list(row)
        largest = max((entry.abs_lower() for entry in row), default=flint.arb(0))
        if not largest.is_zero():  # scaled by a power of two, so that the largest entry is about 1
            mantissa, exponent = largest.mid().man_exp()
            scale = flint.arb(2) ** -(int(exponent) + int(mantissa).bit_length())
            residual = [entry * scale for entry in row]
        for _, column, pivot in reduced:
            factor = residual[column]
            if not factor.is_zero():
                residual = [a - factor * b for a, b in zip(residual, pivot, strict=True)]
                residual[column] = flint.arb(0)
        nonzero = [j for j, entry in enumerate(residual) if not _counts_as_zero(entry)]
        if nonzero:
            best = max(nonzero, key=lambda j: abs(float(residual[j].mid())))
            reduced.append((i, best, [entry / residual[best] for entry in residual]))
    return reduced


def _counts_as_zero(entry: Any) -> bool:
    """Return False for a ball that excludes zero, True for a tiny ball around zero. Raises: `TooImprecise` for a larger
    one."""
    if not entry.contains(0):
        return False
    if entry.abs_upper() > flint.arb(2) ** -(flint.ctx.prec // 3):
        raise TooImprecise
    return True


# --- the rank

PRIMES = (2**61 - 1, 2**62 - 57, 2**62 - 87)
SMALL_PRIMES = (2**31 - 1, 2**31 - 19, 2**31 - 61)  # with squares that fit a word
TRIES = 48
FEW_BITS, MANY_BITS = 256, 8192
BITS_EACH = 4  # more bits for each unknown
_CAP = 4096  # terms of a series with balls

_Answer = TypeVar("_Answer")
Places = Sequence[Mapping[sp.Symbol, Fraction]]


@dataclass(eq=False)
class NothingMeasured(HgogenError):
    """The error of a plant without outputs or without states, for which observability is meaningless."""

    text = "the plant has no {what}, so there is nothing to observe; give it at least one"
    what: str


@dataclass(eq=False)
class NowhereDefined(HgogenError):
    """The error that a plant is defined at none of the random sample points."""

    text = (
        "at none of {tries} random points is the plant defined, real, and told apart from zero; look for a division by "
        "zero, or the root or logarithm of what is never positive"
    )
    tries: int


def at_values(rows: Iterable[sp.Expr], values: Mapping[sp.Symbol, sp.Rational]) -> tuple[sp.Expr, ...]:
    """Return the rows with numbers in place of symbols. Raises: `NowhereDefined` where a comparison has no real
    operands."""
    put_in = tuple(substituted(sp.sympify(row), values) for row in rows)
    defined = tuple(row for row in put_in if row is not None)
    if len(defined) < len(put_in):
        raise NowhereDefined(1)
    return defined


@dataclass(frozen=True)
class Model:
    """A plant x' = flow, y = output, or x+ = flow if `discrete`, with unknown `parameters`; every other symbol is a
    random constant.

    `places`: points, a value for each symbol, near which sample points are drawn; `constraints`: expressions of the
    states that are 0 along every motion and at all sample points. Raises: `NothingMeasured`.
    """

    flow: Sequence[sp.Expr]
    output: Sequence[sp.Expr]
    states: Sequence[sp.Symbol]
    inputs: Sequence[sp.Symbol] = ()
    parameters: Sequence[sp.Symbol] = ()
    places: Places = ()
    discrete: bool = False
    constraints: Sequence[sp.Expr] = ()

    def __post_init__(self) -> None:
        for name in ("flow", "output", "states", "inputs", "parameters", "constraints"):
            object.__setattr__(self, name, tuple(map(sp.sympify, getattr(self, name))))
        for what, part in (("states", self.states), ("outputs", self.output)):
            if not part:
                raise NothingMeasured(what)

    @property
    def unknowns(self) -> tuple[sp.Symbol, ...]:
        """Return the states, then the unknown parameters."""
        return (*self.states, *self.parameters)

    @cached_property
    def plant(self) -> Plant:
        """Return the plant as a tape; its last outputs are the constraints. Raises: `NoTape`."""
        rows = (*self.flow, *self.output, *self.constraints)
        declared = (*self.states, *self.inputs, *self.parameters)
        free = set().union(*(e.free_symbols for e in rows)) - {*declared}
        symbols = (*declared, *sorted(free, key=lambda symbol: symbol.name))
        points = tuple(tuple(place[s] for s in symbols) for place in self.places)
        zero = tape(self.constraints, symbols) if self.constraints else None
        counted = tuple(j for j, u in enumerate(self.inputs) if isinstance(u, Time))
        sizes = len(self.states), len(self.parameters), len(self.inputs)
        return Plant(tape(rows, symbols), *sizes, points, self.discrete, zero, counted)


@dataclass(frozen=True)
class Rank:
    """The observability rank: that of the gradients d(y, y', .., y^(k))/d(unknowns). `observable`: the unknowns whose
    unit vector is in the row space; `final`: whether the rank no longer grows with k, else more derivatives may raise
    it and add to `observable`."""

    dimension: Annotated[int, "number of unknowns"]
    rank: Annotated[int, "generic rank: how many unknowns are seen together"]
    order: Annotated[int, "order of the outputs' derivatives that attains it"]
    observable: Annotated[tuple[sp.Symbol, ...], "the unknowns that are observable by themselves"]
    unobservable: Annotated[tuple[sp.Symbol, ...], "the other unknowns"]
    final: bool


@dataclass(frozen=True)
class Ranks:
    """The observability ranks of a plant: `known` of the states with known parameters, `joint` of states and unknown
    parameters together; `method`: how they were computed.

    `local`: the names of piecewise functions in the plant; the ranks are then the least over the sampled branches, and
    hold on an open set only. It is "" where the ranks hold at almost every point.
    """

    known: Rank
    joint: Rank
    method: str
    local: str


def observability(model: Model, *, limit: int | None = None, sides: Sides | None = None) -> Ranks:
    """Return the observability ranks of a model at a random point, with known parameters and jointly with unknown ones;
    with kinks, jumps or tables the least ranks over the sampled branches. For a discrete model samples of y, up to as
    many as there are unknowns, stand in place of its derivatives.

    `limit`: the highest order of derivatives, None for no limit; `sides`: the ranges of symbols, from which points are
    drawn if the model has no `places`. With constraints the ranks are those on the constraint set.

    Raises: `NowhereDefined`; `NoTape` for a function without a rule.
    """
    plant = model.plant
    if exact_numbers(plant) or model.places or not (sides or branches(plant)):
        return at_random_point(plant, lambda numbers, point: _ranks(plant, model.unknowns, numbers, point, limit))
    around = {s: (sides or {}).get(s, (-inf, inf)) for s in plant.tape.symbols}
    on_box = sampled_branches((*model.flow, *model.output), around)
    n, each = len(model.flow), dict[tuple[sp.Expr, ...], Ranks]()
    for branch in on_box.branches:
        flow, output = branch.rows[:n], branch.rows[n:]
        if branch.rows not in each:
            with suppress(NowhereDefined):
                there = replace(model, flow=flow, output=output, places=branch.places, constraints=())
                each[branch.rows] = observability(there, limit=limit)
    if not each:
        raise NowhereDefined(on_box.points)
    answers = list(each.values())
    known = reduce(_least, (ranks.known for ranks in answers))
    joint = reduce(_least, (ranks.joint for ranks in answers))
    return Ranks(known, joint, answers[0].method, branches(plant))


def branches(plant: Plant) -> str:
    """Return the names of the piecewise functions in a plant, such as abs, joined by commas; "" for none. With such
    functions a result at a point holds on the branch of this point only."""
    return ", ".join(sorted({i.op for i in plant.tape.instructions} & BRANCHING))


def _least(a: Rank, b: Rank) -> Rank:
    low = min(a, b, key=lambda rank: rank.rank)
    hidden = {*a.unobservable, *b.unobservable}
    lost = tuple(s for s in (*low.observable, *low.unobservable) if s in hidden)
    observable = tuple(s for s in low.observable if s not in hidden)
    return Rank(low.dimension, low.rank, low.order, observable, lost, a.final and b.final)


def exact_numbers(plant: Plant) -> bool:
    """Return whether the plant can be evaluated modulo a prime: it has + - * / only, not both pi and e, and no
    constraints, whose points need Newton's iteration."""
    constants = {i.value for i in plant.tape.instructions if i.op == "constant"}
    rational = all(i.op in OPERATIONS for i in plant.tape.instructions)
    return len(constants) < 2 and rational and plant.constraints is None


def at_random_point(
    plant: Plant, answer: Callable[[Arithmetic, Point], _Answer], *, first: int = 0, power: int = 1, balls: bool = False
) -> _Answer:
    """Return `answer(arithmetic, point)` at the first random point at which the plant is defined; the precision of
    balls is raised until it suffices.

    `first`: the number of the group of random points; `power`: the power of a prime modulo which numbers are computed;
    `balls`: whether to use real points (balls) for all plants.

    Raises: `NowhereDefined`.
    """
    for seed in range(first * TRIES, (first + 1) * TRIES):
        try:
            if exact_numbers(plant) and not balls:
                primes = PRIMES if power == 1 else SMALL_PRIMES
                prime = primes[seed % len(primes)]
                numbers = ModularSeries(prime**power, prime, seed)
                return answer(numbers, random_point(plant, numbers))
            return _with_balls(plant, BallSeries(seed), answer)
        except (ZeroDivisionError, Undecided):
            continue
    raise NowhereDefined(TRIES)


def modulus(numbers: Arithmetic) -> int:
    """Return the prime of a modular arithmetic; 0 for balls."""
    return numbers.prime if isinstance(numbers, ModularSeries) else 0


def _with_balls(plant: Plant, numbers: BallSeries, answer: Callable[[Arithmetic, Point], _Answer]) -> _Answer:
    cap, bits = flint.ctx.cap, flint.ctx.prec
    flint.ctx.cap, flint.ctx.prec = _CAP, FEW_BITS + BITS_EACH * plant.wide
    try:
        while True:
            try:
                return answer(numbers, on_constraints(plant, numbers, random_point(plant, numbers)))
            except TooImprecise:
                if flint.ctx.prec >= MANY_BITS:
                    raise Undecided from None
                flint.ctx.prec *= 2
    finally:
        flint.ctx.cap, flint.ctx.prec = cap, bits


def on_constraints(plant: Plant, numbers: BallSeries, point: Point) -> Point:
    """Return the nearby point at which the plant's constraints are 0; only its states differ."""
    if plant.constraints is None:
        return point
    others = [*(u for j in range(plant.m) for u in point.inputs(j, 1)), *point.constants]
    constrained = replace(plant, tape=plant.constraints)

    def values_at(states: Sequence[Any]) -> Values:
        at = [numbers.series([value], 1) for value in (*states, *others)]
        rows = evaluate(constrained, numbers, at, 1, 1)
        slopes = [[numbers.coefficients(by[j], 1)[0] if j in by else arb(0) for j in range(plant.n)] for _, by in rows]
        return [numbers.coefficients(row, 1)[0] for row, _ in rows], slopes

    return replace(point, states=tuple(zero_near(values_at, point.states)))


def _ranks(plant: Plant, symbols: Sequence[sp.Symbol], numbers: Arithmetic, point: Point, limit: int | None) -> Ranks:
    prime = modulus(numbers)
    rows: list[list[Any]] = []
    widths = {plant.n, plant.wide}
    done: dict[int, Rank] = {}
    for matrices in gradients(plant, numbers, point):
        rows += [row for matrix in matrices for row in matrix_rows(matrix)]
        for width in widths - done.keys():
            rank = _rank(rows, width, symbols[:width], plant, prime, limit)
            if rank:
                done[width] = rank
        if widths == done.keys():
            break
    if any(rank.unobservable for rank in done.values()):
        demand_precise_zeros(prime)
    method = f"modulo the prime {prime}" if prime else f"balls of {flint.ctx.prec} bits"
    return Ranks(done[plant.n], done[plant.wide], method, branches(plant))


def matrix_rows(matrix: Any) -> list[list[Any]]:
    """Return the rows of a FLINT matrix, of balls or modulo a prime, as lists."""
    width, entries = matrix.ncols(), matrix.entries()
    return [entries[i : i + width] for i in range(0, len(entries), width)]


def _rank(
    rows: Sequence[Sequence[Any]], width: int, symbols: Sequence[sp.Symbol], plant: Plant, prime: int, limit: int | None
) -> Rank | None:
    """Return the observability rank once it is final or the `limit` of orders is reached, else None. It is final if it
    is full, or constant under one more derivative of each of the p outputs; not so for samples, since a map may have no
    inverse.

    `rows`: gradients of the outputs' derivatives, of which the first `width` columns count.
    """
    p = plant.outputs
    reached = limit is not None and len(rows) // p > limit
    orders = limit + 1 if limit is not None and reached else len(rows) // p
    cut = [row[:width] for row in rows[: orders * p]]
    levels = [i // p for i in independent_rows(cut, prime)]  # the order of derivative of each new row
    constant = next((k for k in range(orders) if k not in levels), None)
    gap = constant if not plant.discrete else width if orders > width else None
    final = len(levels) == width or gap is not None
    if not final and not reached:
        return None
    below_gap = [k for k in levels if gap is None or k < gap]
    order = max(below_gap, default=0)
    basis = nullspace_basis(cut[: (order + 1) * p], width, prime)
    hidden = [any(vector[i] != 0 for vector in basis) for i in range(width)]
    observable = tuple(s for s, h in zip(symbols, hidden, strict=True) if not h)
    unobservable = tuple(s for s, h in zip(symbols, hidden, strict=True) if h)
    return Rank(width, len(below_gap), order, observable, unobservable, final)
