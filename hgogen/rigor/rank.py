"""Generic observability: the rank of the gradients of an output's derivatives at a random point.

    O_k = d(y, y', .., y^(k)) / d(x, p),   rank O_k = rank O_(k+1)  =>  no later derivative adds to it

With all derivatives of the inputs free, the span of the rows over the field of functions of x, p, u, u', .. is closed
under d/dt once it is stationary, so the test is final. A rational model is taken modulo a prime of 61 bits: the rank
there is at most the generic rank for certain, and equal to it but for a chance of the order of 1e-15. With exp, sin,
roots or real powers the numbers are balls. A pivot is an entry whose ball excludes zero: so the rank is at least the
number of pivots, for certain at this point. What is left counts as zero when its ball contains zero and is tiny, at
1024 bits; a ball that contains zero and is not tiny raises `Blurred`: more bits may decide.
A. Sedoglavic, J. Symbolic Computation 33 (2002).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from math import inf
from typing import Annotated, Any, TypeVar

import flint
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.balls import BRANCHES, Balls, Undecided
from hgogen.rigor.points import put
from hgogen.rigor.reached import Sides, reached
from hgogen.rigor.series import OPERATIONS, Arithmetic, Modular, Plant, Point, gradients, random_point
from hgogen.rigor.tape import tape

# --- new rows and kernels

Row = Sequence[Any]

SURE_BITS = 1024  # at which a zero is believed: then it is smaller than 2^-341


class Blurred(ArithmeticError):
    """The precision does not tell whether an entry is zero."""


def believe_zeros(modulus: int) -> None:
    """Raise `Blurred` for balls of few bits: a deficiency rests on what counts as zero, so it is asked again."""
    if not modulus and flint.ctx.prec < SURE_BITS:
        raise Blurred


def new_rows(rows: Sequence[Row], modulus: int) -> list[int]:
    """Indices of the rows that are no combination of the rows before; `modulus` 0 for balls."""
    if not rows or not rows[0]:
        return []
    if not modulus:
        return [i for i, _, _ in _eliminated(rows)]
    entries = [e for row in rows for e in row]
    reduced, rank = flint.nmod_mat(len(rows), len(rows[0]), entries, modulus).transpose().rref()
    return [next(j for j in range(len(rows)) if reduced[i, j] != 0) for i in range(rank)]  # the pivots


def kernel(rows: Sequence[Row], width: int, modulus: int) -> list[list[Any]]:
    """A basis v_1, v_2, .. of the vectors v with rows v = 0; an entry that counts as zero is 0. Raises: `Blurred`."""
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
    """For each new row its index, the column of its pivot, and the reduced row with 1 there; a pivot is the largest
    entry of its row."""
    reduced: list[tuple[int, int, list[Any]]] = []
    for i, row in enumerate(rows):
        left = _normal(row)
        for _, column, pivot in reduced:
            factor = left[column]
            if not factor.is_zero():
                left = [a - factor * b for a, b in zip(left, pivot, strict=True)]
                left[column] = flint.arb(0)
        sure = [j for j, entry in enumerate(left) if not _counts_as_zero(entry)]
        if sure:
            best = max(sure, key=lambda j: abs(float(left[j].mid())))
            reduced.append((i, best, [entry / left[best] for entry in left]))
    return reduced


def _normal(row: Row) -> list[Any]:
    """The row times a power of two, so that its largest entry that is not zero is about 1."""
    largest = max((entry.abs_lower() for entry in row), default=flint.arb(0))
    if largest.is_zero():
        return list(row)
    shift = largest.mid().man_exp()
    exponent = int(shift[1]) + int(shift[0]).bit_length()
    scale = flint.arb(2) ** -exponent
    return [entry * scale for entry in row]


def _counts_as_zero(entry: Any) -> bool:
    """Whether it counts as zero: False only for a ball that excludes zero."""
    if not entry.contains(0):
        return False
    if entry.abs_upper() > flint.arb(2) ** -(flint.ctx.prec // 3):
        raise Blurred
    return True


# --- the rank

PRIMES = (2**61 - 1, 2**62 - 57, 2**62 - 87)
SMALL_PRIMES = (2**31 - 1, 2**31 - 19, 2**31 - 61)  # whose squares fit a word
TRIES = 48
FEW_BITS, MANY_BITS = 256, 8192
BITS_EACH = 4  # more bits for each unknown
_CAP = 4096  # terms of a series with balls

_Answer = TypeVar("_Answer")
Places = Sequence[Mapping[sp.Symbol, Fraction]]


@dataclass(eq=False)
class NothingMeasured(HgogenError):
    """Observability of a plant without outputs or without states."""

    what: str

    def __str__(self) -> str:
        return f"the plant has no {self.what}, so there is nothing to observe; give it at least one"


@dataclass(eq=False)
class NowhereDefined(HgogenError):
    """No point was found at which the plant is defined."""

    tries: int

    def __str__(self) -> str:
        return (
            f"at none of {self.tries} random points is the plant defined, real, and told apart from zero; look for a "
            "division by zero, or the root or logarithm of what is never positive"
        )


def at_values(rows: Iterable[sp.Expr], values: Mapping[sp.Symbol, sp.Rational]) -> tuple[sp.Expr, ...]:
    """The rows with these values. Raises: `NowhereDefined` where a comparison in them then has no real value."""
    put_in = tuple(put(sp.sympify(row), values) for row in rows)
    defined = tuple(row for row in put_in if row is not None)
    if len(defined) < len(put_in):
        raise NowhereDefined(1)
    return defined


@dataclass(frozen=True)
class Rank:
    """One answer of a question of observability. `observable`: those whose unit vector is in the row space; `final`:
    whether the rank was stationary; if not, rank and `observable` hold and more derivatives may add to them.
    """

    dimension: Annotated[int, "number of unknowns"]
    rank: Annotated[int, "generic rank: how many unknowns are seen together"]
    order: Annotated[int, "order of the outputs' derivatives that attains it"]
    observable: Annotated[tuple[sp.Symbol, ...], "the unknowns that are observable by themselves"]
    unobservable: Annotated[tuple[sp.Symbol, ...], "the other unknowns"]
    final: bool


@dataclass(frozen=True)
class Ranks:
    """The ranks of a plant: `known` with known parameters, `joint` of states and unknown parameters together; `method`
    says how they were computed.

    `local` names the functions with branches, for which the answer is the least of several points' and holds on an
    open set only; it is "" where the answer holds at almost every point.
    """

    known: Rank
    joint: Rank
    method: str
    local: str


def observability(
    flow: Iterable[sp.Expr],
    output: Iterable[sp.Expr],
    states: Iterable[sp.Symbol],
    inputs: Iterable[sp.Symbol] = (),
    parameters_unknown: Iterable[sp.Symbol] = (),
    *,
    limit: int | None = None,
    places: Places = (),
    sides: Sides | None = None,
) -> Ranks:
    """Ranks with known parameters and jointly, at a random point; every other symbol is a random constant. With kinks,
    jumps or tables the least of those on the branches that points reach.

    `limit`: the most derivatives to take (None: until the rank is stationary); `places`: values of all symbols, near
    which a real point is taken; without them it is in the ranges `sides`, of symbols that have one.

    Raises: `NothingMeasured`, `NowhereDefined`; `NoTape` for a function without a rule.
    """
    flow, output, states = (tuple(map(sp.sympify, part)) for part in (flow, output, states))
    inputs, parameters = tuple(inputs), tuple(parameters_unknown)
    plant, symbols = plant_of(flow, output, states, inputs, parameters, places)
    if exact_numbers(plant) or places or not (sides or branches(plant)):
        return somewhere(plant, lambda numbers, point: _ranks(plant, symbols, numbers, point, limit))
    around = {s: (sides or {}).get(s, (-inf, inf)) for s in plant.tape.symbols}
    of_box = reached((*flow, *output), around)
    n, each = len(flow), dict[tuple[sp.Expr, ...], Ranks]()
    for branch in of_box.branches:
        rows = branch.rows[:n], branch.rows[n:], states, inputs, parameters
        if branch.rows not in each:
            with suppress(NowhereDefined):
                each[branch.rows] = observability(*rows, limit=limit, places=branch.places)
    if not each:
        raise NowhereDefined(of_box.points)
    answers = list(each.values())
    known = reduce(_least, (ranks.known for ranks in answers))
    joint = reduce(_least, (ranks.joint for ranks in answers))
    return Ranks(known, joint, answers[0].method, branches(plant))


def branches(plant: Plant) -> str:
    """The functions with branches in a plant, "" without: an answer at a point holds on its branch only."""
    return ", ".join(sorted({i.op for i in plant.tape.instructions} & BRANCHES))


def _least(a: Rank, b: Rank) -> Rank:
    """The lower of two ranks, with what is unobservable in either of them."""
    low = min(a, b, key=lambda rank: rank.rank)
    hidden = {*a.unobservable, *b.unobservable}
    lost = tuple(s for s in (*low.observable, *low.unobservable) if s in hidden)
    observable = tuple(s for s in low.observable if s not in hidden)
    return Rank(low.dimension, low.rank, low.order, observable, lost, a.final and b.final)


def plant_of(
    flow: Iterable[sp.Expr],
    output: Iterable[sp.Expr],
    states: Iterable[sp.Symbol],
    inputs: Iterable[sp.Symbol],
    parameters: Iterable[sp.Symbol] = (),
    places: Places = (),
) -> tuple[Plant, tuple[sp.Symbol, ...]]:
    """The plant as a tape, with the `places` near which real points are taken, and its unknowns: states, then unknown
    parameters."""
    flow, output, states = (tuple(map(sp.sympify, part)) for part in (flow, output, states))
    inputs, parameters = tuple(inputs), tuple(parameters)
    for what, part in (("states", states), ("outputs", output)):
        if not part:
            raise NothingMeasured(what)
    declared = {*states, *inputs, *parameters}
    free = set().union(*(e.free_symbols for e in (*flow, *output))) - declared
    rest = sorted(free, key=lambda symbol: symbol.name)
    symbols = (*states, *inputs, *parameters, *rest)
    points = tuple(tuple(place[s] for s in symbols) for place in places)
    program = tape((*flow, *output), symbols)
    return Plant(program, len(states), len(parameters), len(inputs), points), (*states, *parameters)


def exact_numbers(plant: Plant) -> bool:
    """Whether the plant can be taken modulo a prime: + - * / only, and not both of pi and e."""
    constants = {i.value for i in plant.tape.instructions if i.op == "constant"}
    return len(constants) < 2 and all(i.op in OPERATIONS for i in plant.tape.instructions)


def somewhere(
    plant: Plant, answer: Callable[[Arithmetic, Point], _Answer], *, first: int = 0, power: int = 1, balls: bool = False
) -> _Answer:
    """`answer` at the first random point at which the plant is defined, with balls at a precision that decides.

    `first`: which of the random points to begin with; `power`: of the prime that numbers are taken modulo; `balls`:
    a real point even for a rational plant.

    Raises: `NowhereDefined`.
    """
    for seed in range(first * TRIES, (first + 1) * TRIES):
        try:
            if exact_numbers(plant) and not balls:
                primes = PRIMES if power == 1 else SMALL_PRIMES
                prime = primes[seed % len(primes)]
                numbers = Modular(prime**power, prime, seed)
                return answer(numbers, random_point(plant, numbers))
            return _with_balls(plant, Balls(seed), answer)
        except (ZeroDivisionError, Undecided):
            continue
    raise NowhereDefined(TRIES)


def modulus(numbers: Arithmetic) -> int:
    """The prime, or 0 for balls."""
    return numbers.prime if isinstance(numbers, Modular) else 0


def _with_balls(plant: Plant, numbers: Balls, answer: Callable[[Arithmetic, Point], _Answer]) -> _Answer:
    cap, bits = flint.ctx.cap, flint.ctx.prec
    flint.ctx.cap, flint.ctx.prec = _CAP, FEW_BITS + BITS_EACH * plant.wide
    try:
        while True:
            try:
                return answer(numbers, random_point(plant, numbers))
            except Blurred:
                if flint.ctx.prec >= MANY_BITS:
                    raise Undecided from None
                flint.ctx.prec *= 2
    finally:
        flint.ctx.cap, flint.ctx.prec = cap, bits


def _ranks(plant: Plant, symbols: Sequence[sp.Symbol], numbers: Arithmetic, point: Point, limit: int | None) -> Ranks:
    prime = modulus(numbers)
    rows: list[list[Any]] = []
    widths = {plant.n, plant.wide}
    done: dict[int, Rank] = {}
    for matrices in gradients(plant, numbers, point):
        rows += [row for matrix in matrices for row in matrix_rows(matrix)]
        for width in widths - done.keys():
            rank = _rank(rows, width, symbols[:width], plant.outputs, prime, limit)
            if rank:
                done[width] = rank
        if widths == done.keys():
            break
    if any(rank.unobservable for rank in done.values()):
        believe_zeros(prime)
    method = f"modulo the prime {prime}" if prime else f"balls of {flint.ctx.prec} bits"
    return Ranks(done[plant.n], done[plant.wide], method, branches(plant))


def matrix_rows(matrix: Any) -> list[list[Any]]:
    """The rows of a matrix of either arithmetic as lists."""
    width, entries = matrix.ncols(), matrix.entries()
    return [entries[i : i + width] for i in range(0, len(entries), width)]


def _rank(
    rows: Sequence[Sequence[Any]], width: int, symbols: Sequence[sp.Symbol], p: int, prime: int, limit: int | None
) -> Rank | None:
    """The rank once it is full, stationary over one more derivative of every output, or at its limit; None before."""
    reached = limit is not None and len(rows) // p > limit
    orders = limit + 1 if limit is not None and reached else len(rows) // p
    cut = [row[:width] for row in rows[: orders * p]]
    levels = [i // p for i in new_rows(cut, prime)]  # the order of derivative of each new row
    gap = next((k for k in range(orders) if k not in levels), None)
    final = len(levels) == width or gap is not None
    if not final and not reached:
        return None
    below_gap = [k for k in levels if gap is None or k < gap]
    order = max(below_gap, default=0)
    basis = kernel(cut[: (order + 1) * p], width, prime)
    hidden = [any(vector[i] != 0 for vector in basis) for i in range(width)]
    observable = tuple(s for s, h in zip(symbols, hidden, strict=True) if not h)
    unobservable = tuple(s for s, h in zip(symbols, hidden, strict=True) if h)
    return Rank(width, len(below_gap), order, observable, unobservable, final)
