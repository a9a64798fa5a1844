"""The share of rounding in an error bound, from the operations of one call of the step.

1. A call of the step's program is evaluated in any arithmetic, statement by statement, in the order of every language.
Guards are left out: no sample is missing, neither in this call nor in the last one.

2. A certificate lists the program: one operation a statement, of names, numbers and earlier statements.

    x1, ..   the elements of the fields      y1_last, y1, ..   samples, of the last call and of this one
    v1, ..   the statements                  u1_last, u1, ..   inputs of the two calls

A constant is written as the exact number that it rounds: a gain of the observer, the end of a range in the unit of a
field, a number of the plant, else the simplest quotient, else its printed digits. Operations that change nothing, such
as a product with 1 or a sum with 0, are no statements.

3. The rounding errors rho depend on the size of the numbers, these on the error, and the error on rounding. With R the
bound of the rounding errors without this feedback,

    rho(plant's ranges + start + the other shares + r R) <= r rho(plant's ranges + start + the other shares)

shows by induction that the error from rounding is at most r R. After the start has decayed it is less: |e|_P^2 - 1
loses alpha h of itself at each call, in the norm for the later rounding errors.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import islice, pairwise, product
from numbers import Rational
from typing import Any, Protocol

import casadi as ca
import sympy as sp

from hgogen.analysis.evidence import Evidence, certificate_text
from hgogen.certificates.start_set import ContractingStep, Start
from hgogen.discretisation.runge_kutta import RATE
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.method import Method
from hgogen.part import Clock, Ode
from hgogen.program import Block, Place, Program, Repeat, Statement
from hgogen.prove.inclusion import Inclusion, state_row
from hgogen.prove.plant_step import SUMMED, Share, Sizes, Unbounded
from hgogen.prove.quadratic import extent, rational
from hgogen.prove.questions import InputBound
from hgogen.rigor.bounds import bound
from hgogen.rigor.box import box, exact
from hgogen.rigor.definite import root
from hgogen.rigor.lookup import Lookup, folded
from hgogen.rigor.rounding import FOLDED, NoRoundingBound, Real, Rounding, error_free
from hgogen.rigor.series import between, magnitude
from hgogen.sentence import because
from hgogen.step import Step

Columns = list[list[Any]]
_SAMPLES, _INPUTS = ("y_last", "y"), ("state", "work")  # at the last call, and at this one


class Arithmetic(Protocol):
    """An arithmetic in which `after_call` evaluates the program of a step: its operations, on values of any kind, such
    as balls or texts."""

    def parameter(self, number: float) -> Any:
        """Return the value that represents a gain or a parameter of the program."""

    def constant(self, number: float) -> Any:
        """Return the value that represents a constant of the program."""

    def apply(self, op: int, values: list[Any]) -> Any:
        """Return the result of the operation with CasADi's number `op` on these values. Raises: `NoRoundingBound`."""

    def call(self, function: Graph, columns: Columns, body: Callable[[Columns], Columns]) -> Columns:
        """Return the result columns of a `function` of the program for the argument `columns`; `body`: the function
        that computes them operation by operation. Raises: `NoRoundingBound` where one has no result."""


def after_call(
    arithmetic: Arithmetic,
    step: Step,
    fields: Sequence[Any],
    samples: Sequence[Sequence[Any]],
    inputs: Sequence[Sequence[Any]],
) -> list[Any]:
    """Return the numbers (N) in an observer's memory after one call of its step, evaluated in any `arithmetic`.

    Args: `fields` (N): the numbers before the call; `samples` (2, p), `inputs` (2, m): those of the last call and of
    this one. Raises: `NoRoundingBound` for a program that the arithmetic cannot evaluate.
    """
    (part,) = step.observer.parts
    p = len(samples[0])
    if not isinstance(part, Ode) or step.clock.periods != (step.dt,) * p or step.observer.delays:
        raise NoRoundingBound(
            "an observer that is more than one differential equation, or samples that are not of every call"
        )
    clock = replace(step.clock, every=())
    elements = iter(fields)
    memory: dict[Place, list[Any]] = {Place("state", x.name): list(islice(elements, x.size)) for x in part.fields}
    memory |= {Place("work", name): list(y) for name, y in zip(_SAMPLES, samples, strict=True)}
    memory |= {Place(struct, "u"): list(u) for struct, u in zip(_INPUTS, inputs, strict=True)}
    memory[Place("work", "valid")] = [arithmetic.constant(1.0)] * p
    for struct, numbers in (("plant", step.layout.plant), ("gain", step.layout.gains)):
        memory |= {Place(struct, each.name): list(map(arithmetic.parameter, each.initial)) for each in numbers}
    for statement in _statements(step.method, part, clock):
        if not isinstance(statement, Block):
            raise NoRoundingBound("a loop or a matrix operation")
        arguments = [memory[place] for place, _ in statement.reads]
        memory |= zip(statement.writes, _outputs(arithmetic, statement.graph, arguments), strict=False)
    return [each for field in part.fields for each in memory[Place("state", field.name)]]


def rounding_errors(step: Step, real: Real, fields: Sequence[Any], y: Sequence[Any], u: Sequence[Any]) -> list[Any]:
    """Return the rounding errors (N) that one call makes in the observer's memory in the precision `real`, as balls,
    for memory in the balls `fields` (N), and samples in the balls `y` (p) and inputs in `u` (m), now and at the last
    call. Memory, samples and inputs are exact numbers of this precision; gains, parameters, constants and the results
    of `tune` are rounded. Raises: `NoRoundingBound`."""
    elements, samples, inputs = (list(map(error_free, each)) for each in (fields, y, u))
    return [each.error for each in after_call(Rounding(real), step, elements, [samples] * 2, [inputs] * 2)]


@lru_cache(maxsize=16)  # a program is walked on many pieces of the plant's ranges
def _statements(method: Method, part: Ode, clock: Clock) -> tuple[Statement, ...]:
    pieces = method.ode(part, clock)
    return tuple(_plain((*pieces.tune, *pieces.predict)))


def _plain(program: Program | Iterable[Statement]) -> Iterable[Statement]:
    for statement in program:
        yield from _plain(statement.unrolled) if isinstance(statement, Repeat) else (statement,)


def _outputs(arithmetic: Arithmetic, graph: Graph, arguments: Sequence[Sequence[Any]]) -> Columns:
    def call(function: Graph, values: Sequence[Any]) -> list[Any]:
        if isinstance(function, Lookup):
            raise NoRoundingBound("a table")
        elements = iter(values)
        columns = [list(islice(elements, function.nnz_in(k))) for k in range(function.n_in())]
        results = arithmetic.call(function, columns, lambda columns: _outputs(arithmetic, function, columns))
        return [value for column in results for value in column]

    return folded(graph, lambda k, i: arguments[k][i], arithmetic.constant, arithmetic.apply, call)


_SIMPLE = 10**6  # the largest denominator of a simple quotient, far from those of doubles
_DIGITS = 40  # digits of a number that is no quotient


@dataclass(frozen=True)
class Operand:
    """An operand in the listed program: its `text`, such as "x1", "v3" or "1/2", and its `number` if it is constant."""

    text: str
    number: Fraction | None = None


@dataclass(frozen=True)
class Listing:
    """The program of one call as texts for a certificate. `statements`: v1, v2, .., such as "add x1 v3"; `stages`: for
    each stage of the method the names of the memory (N) at which the observer's equation is evaluated; `rates`: the
    names of its results; `after`: the names of the memory after the call."""

    statements: tuple[str, ...]
    stages: tuple[tuple[str, ...], ...]
    rates: tuple[tuple[str, ...], ...]
    after: tuple[str, ...]


def program_listing(step: Step, error: Inclusion) -> Listing | None:
    """Return the program of a step as texts, for an observer with this `error` dynamics; None where a certificate
    cannot list it: with tables, loops over matrices, or tests of variables."""
    form, numbers = step.observer.form, _flat(error.numbers.values())
    gains = (Fraction(x) for x in numbers if isinstance(x, float | Rational))
    scales, units = error.scales(Fraction(1)), error.remembered(Fraction(1))
    ends = list[Fraction]()  # ends of the ranges of states, in the units of their fields
    for i, scale, unit in zip(error.layout.index, scales or (), units or (), strict=False):
        declared = box((form.states[i],))[form.states[i]]
        ends += [end * scale / unit for end in declared if isinstance(end, Fraction)]
    writer = _Writer((*map(_number, (*gains, *ends)), *_constants(form)))
    fields = [Operand(f"x{k + 1}") for k in range(len(error.N))]
    samples = [_named("y", end, len(form.output)) for end in ("_last", "")]
    inputs = [_named("u", end, len(step.inputs)) for end in ("_last", "")]
    try:
        after = after_call(writer, step, fields, samples, inputs)
    except NoRoundingBound:
        return None
    return _pruned(writer, after)


def _pruned(writer: "_Writer", after: Sequence[Operand]) -> Listing:
    wanted = {each.text for row in (*writer.stages, *writer.rates, after) for each in row}
    statements = {operand.text: statement for statement, operand in writer.statements.items()}
    for name in reversed(statements):
        wanted |= {*statements[name].split()} if name in wanted else set()
    names = {name: f"v{i}" for i, name in enumerate((name for name in statements if name in wanted), 1)}

    def renamed(operands: Iterable[str]) -> tuple[str, ...]:
        return tuple(names.get(operand, operand) for operand in operands)

    listed = (" ".join(renamed(statements[name].split())) for name in names)
    stages, rates = (
        tuple(renamed(each.text for each in row) for row in rows) for rows in (writer.stages, writer.rates)
    )
    return Listing(tuple(listed), stages, rates, renamed(each.text for each in after))


def _named(name: str, end: str, count: int) -> list[Operand]:
    return [Operand(f"{name}{j + 1}{end}") for j in range(count)]


def _constants(form: Form) -> list[Operand]:
    """Return the numbers in the plant's equations, with the numeric
    factor of each sum and product: 2 pi in sin(2 pi f t)."""
    nodes = {node for row in (*form.A, *form.b, *form.output) for node in sp.preorder_traversal(exact(row))}
    parts = {node.as_independent(*node.free_symbols)[0] for node in nodes if node.is_Add or node.is_Mul}
    numbers = {x for x in nodes | parts if x.is_number and x.is_real and x.is_finite}
    constants = []
    for x in sorted(numbers, key=sp.default_sort_key):
        value = Fraction(str(x)) if x.is_Rational else Fraction(str(x.evalf(_DIGITS)))
        constants.append(Operand(certificate_text(form, x).replace(" ", ""), value))
    return constants


def _flat(values: Iterable[Any]) -> Iterable[Any]:
    for value in values:
        yield from _flat(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)


@dataclass(frozen=True)
class _Writer:
    known: Sequence[Operand]
    statements: dict[str, Operand] = field(default_factory=dict)
    stages: list[list[Operand]] = field(default_factory=list)
    rates: list[list[Operand]] = field(default_factory=list)

    def parameter(self, number: float) -> Operand:
        return _number(Fraction(repr(number)))

    def constant(self, number: float) -> Operand:
        if not math.isfinite(number):
            raise NoRoundingBound("a constant that is no number")
        value = Fraction(number)
        candidates = [_number(value.limit_denominator(_SIMPLE)), _number(Fraction(repr(number)))]
        nearest = min(self.known, key=lambda known: _distance(known, value), default=candidates[0])
        most = abs(value) * Fraction(FOLDED, 2**53)
        return next(known for known in (nearest, *candidates) if _distance(known, value) <= most)

    def call(self, function: Graph, columns: Columns, body: Callable[[Columns], Columns]) -> Columns:
        results = body(columns)
        if function.name() == RATE:
            rates = [each for column in results for each in column]
            self.stages.append([each for column in columns for each in column][: len(rates)])
            self.rates.append(rates)
        return results

    def apply(self, op: int, values: list[Operand]) -> Operand:
        same = _unchanged(op, values)
        if same:
            return same
        if op not in _WORDS or (op in _POWERS and values[1].number is None):
            raise NoRoundingBound("an operation that is not listed")
        word, order = _WORDS[op]
        statement = " ".join((word, *(each.text for each in order(values))))
        return self.statements.setdefault(statement, Operand(f"v{len(self.statements) + 1}"))


def _distance(known: Operand, value: Fraction) -> Fraction:
    assert known.number is not None
    return abs(known.number - value)


def _number(value: Fraction) -> Operand:
    return Operand(str(value), value)


def _unchanged(op: int, values: list[Operand]) -> Operand | None:
    """Return the operand to which an operation reduces without
    rounding, as a + 0, 1 a or a test of numbers, or None."""
    known = [each.number for each in values]
    if op in _TESTS and None not in known:
        return _number(Fraction(_TESTS[op](*known)))
    if op == ca.OP_IF_ELSE_ZERO and known[0] is not None:
        return values[1] if known[0] else values[0]
    for one, other in ((0, -1), (-1, 0)):
        if op == ca.OP_ADD and known[one] == 0:
            return values[other]
        if op == ca.OP_MUL and known[one] in (0, 1):
            return values[other] if known[one] else values[one]
    return None


_TESTS: Mapping[int, Callable[..., Any]] = {
    ca.OP_NEG: lambda a: -a,
    ca.OP_LT: lambda a, b: a < b,
    ca.OP_LE: lambda a, b: a <= b,
    ca.OP_NOT: lambda a: not a,
    ca.OP_AND: lambda a, b: a and b,
    ca.OP_OR: lambda a, b: a or b,
}
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)
Order = Callable[[list[Operand]], list[Operand]]


def _as_is(values: list[Operand]) -> list[Operand]:
    return values


def _numbers_last(values: list[Operand]) -> list[Operand]:
    return sorted(values, key=lambda each: each.number is not None)


def _number_first(number: int) -> Order:
    return lambda values: [_number(Fraction(number)), *values]


_FUNCTIONS = (
    *("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
_WORDS: Mapping[int, tuple[str, Order]] = {
    ca.OP_ADD: ("add", _as_is),
    ca.OP_SUB: ("sub", _as_is),
    ca.OP_MUL: ("mul", _as_is),
    ca.OP_DIV: ("div", _as_is),
    ca.OP_NEG: ("neg", _as_is),
    ca.OP_SQ: ("square", _as_is),
    ca.OP_TWICE: ("mul", _number_first(2)),
    ca.OP_INV: ("div", _number_first(1)),
    ca.OP_FABS: ("Abs", _as_is),
    ca.OP_FMIN: ("Min", _numbers_last),
    ca.OP_FMAX: ("Max", _numbers_last),
    ca.OP_SQRT: ("sqrt", _as_is),
    **dict.fromkeys(_POWERS, ("pow", _as_is)),
    **{getattr(ca, f"OP_{name.upper()}"): (name, _as_is) for name in _FUNCTIONS},
}


CLOSE = Fraction(1, 20)  # of a bound: the errors from the start and from early rounding after they have settled
_ROOM = Fraction(11, 10)  # of the other shares, with the error from the start
_ROUNDS = 40
_GROWTH = Fraction(11, 10)  # of r, from round to round
_PIECES = 32  # of the ranges of the first states
_UP = 1 + 1e-9  # of a count of calls, for rounding errors
Side = tuple[Fraction, Fraction]
Sized = Mapping[int, Fraction]  # by field, in the unit of its state of the form


@dataclass(frozen=True)
class RoundingShare:
    """The effect of rounding errors on the estimate. `share`: their part of the ultimate error bound; `early`: the
    largest error from them until then, by component of e; `calls`: the number of calls after which their effect is
    within 1 + `CLOSE` times the share, once the error from the start is at most `start_residual`."""

    share: Share
    early: Sized
    start_residual: Sized
    calls: int


def rounding_share(
    running: ContractingStep,
    real: Real,
    shares: Sequence[Share],
    start: Start,
    multiple: Fraction,
    samples: Sequence[Fraction],
) -> RoundingShare:
    """Return the share of rounding errors in the precision `real` in an error bound whose other causes have the
    `shares`, for initial errors of `multiple` times those that the ranges allow, and sample errors of at most `samples`
    (p). Raises: `Unbounded`, `NoSolver`."""
    every, plant = range(len(start.scales)), running.plant
    parts = [_field_bounds(share.unit, share.proofs, start.scales) for share in shares]
    others = {k: sum((part[k] for part in parts), Fraction(0)) for k in every}
    begins = running.begins(start, every)
    scale, speeds = min(multiple, Fraction(1)), plant.stated_speeds
    deviations = [share.sizes.deviation for share in shares if share.sizes.deviation]
    rates = [speed + sum((each[i] for each in deviations), Fraction(0)) for i, speed in enumerate(speeds)]
    displacements = [plant.h * rate for rate in rates]  # motion of a plant in a call, by row of its form
    sizes = _Sizing(running, real, samples, displacements, speeds)

    wide = {k: others[k] + scale * begins[k] for k in every}
    first = sizes.sizes(wide)
    _, bounds = _bounded(running, first)
    most = _fixed_point(lambda r: _ratio(sizes.sizes({k: wide[k] + r * bounds[k] for k in every}), first))
    early = {k: most * bounds[k] for k in every}
    within = {k: _ROOM * others[k] + (1 + CLOSE) * early[k] for k in every}
    later = sizes.sizes(within)
    proofs, bounds = _bounded(running, later)
    residual = {k: CLOSE * (others[k] + min(bounds[k], early[k])) for k in every}
    falls = min(one.alpha for one in proofs.values()) * running.proof.h
    calls = _calls(float(most * _ratio(first, later)), float(falls))
    share = Share("rounding", later, later.largest, proofs, sizes.follows([within[k] for k in every]))
    return RoundingShare(share, early, residual, calls)


def _bounded(running: ContractingStep, sizes: Sizes) -> tuple[dict[int, InputBound], dict[int, Fraction]]:
    known = running.bounds(sizes)
    if known is None:
        raise Unbounded(because("no bound is found of what rounding does"))
    return known, _field_bounds(sizes.largest, known, running.scales)


def _ratio(more: Sizes, less: Sizes) -> Fraction:
    if not all(less.fields):
        raise Unbounded(because("a field is not rounded"))
    return max(x / y for x, y in zip(more.fields, less.fields, strict=True))


def _fixed_point(times: Callable[[Fraction], Fraction]) -> Fraction:
    """Return an r >= 1 with `times`(r) <= r, found by iteration. Raises: `Unbounded`."""
    r = Fraction(1)
    for _ in range(_ROUNDS):
        needed = times(r)
        if needed <= r:
            return r
        r = needed * _GROWTH
    raise Unbounded(because("what rounding does has no bound: the more it moves the estimate, the more is rounded"))


def _calls(ratio: float, falls: float) -> int:
    """Return the number of calls after which e'P e is at most (1 + `CLOSE`)^2, from
    `ratio`^2 on, if each call multiplies e'P e - 1 by at most 1 - `falls`."""
    target = float((1 + CLOSE) ** 2 - 1)
    return max(0, math.ceil(math.log(max(1.0, (ratio**2 - 1) / target)) / -math.log1p(-falls) * _UP))


def _field_bounds(unit: Fraction, proofs: Mapping[int, InputBound], scales: Sequence[Fraction]) -> dict[int, Fraction]:
    P = [rational(one.weights.P) for one in proofs.values()]
    rows = {k: state_row(scales, k) for k in range(len(scales)) if k not in proofs}
    extents = {k: min(root(extent(each, c)) for each in P) for k, c in rows.items()}
    return {k: unit * (proofs[k].bound if k in proofs else extents[k]) for k in range(len(scales))}


@dataclass(frozen=True)
class _Sizing:
    """The bound of the rounding errors of one call while the plant is in its ranges, with sample
    errors `samples` (p), `displacements` and `speeds` (n) of the plant in a call. The ranges of
    measured states are cut into pieces, on each of which sample and estimate are near each other."""

    running: ContractingStep
    real: Real
    samples: Sequence[Fraction]
    displacements: Sequence[Fraction]
    speeds: Sequence[Fraction]

    def sizes(self, errors: Sized) -> Sizes:
        rounded = [self._on_piece(ranges, errors) for ranges in self._pieces]
        each = zip(zip(*rounded, strict=True), self._remembered, strict=True)
        return Sizes(fields=tuple(max(rhos) * e * SUMMED / Fraction(self.running.step.dt) for rhos, e in each))

    def follows(self, within: Sequence[Fraction]) -> Evidence:
        listing = program_listing(self.running.step, self.running.error)
        if listing is None:
            return {}
        return {
            "between": self.running.step.clock.between,
            "parameters": list(self.running.step.observer.form.system.nominal.values()),
            "precision": self.real,
            "speeds": self.speeds,
            "within": within,
            "program": listing.statements,
            "stages": listing.stages,
            "rates": listing.rates,
            "after": listing.after,
        }

    def _on_piece(self, ranges: Sequence[Side], errors: Sized) -> list[Fraction]:
        layout, balls = self.running.error.layout, []
        for k, (i, fed, e) in enumerate(zip(layout.index, layout.fed, self._remembered, strict=True)):
            low, high = ranges[i] if fed else (Fraction(0), Fraction(0))
            unit = self.running.scales[k] / e
            balls.append(between(unit * (low - errors[k]), unit * (high + errors[k])))
        try:
            rounded = rounding_errors(self.running.step, self.real, balls, self._samples(ranges), self._inputs)
        except NoRoundingBound as error:
            raise Unbounded(because("how far rounding goes is not known: {what}", what=error.args[0])) from error
        return list(map(magnitude, rounded))

    @cached_property
    def _pieces(self) -> list[tuple[Side, ...]]:
        heads = {head for head, _ in self.running.heads.values()}
        count, sides = round(_PIECES ** (1 / len(heads))), list[list[Side]]()
        for i, state in enumerate(self.running.step.observer.form.states):
            low, high = map(Fraction, state.interval)
            parts = count if i in heads else 1
            cuts = [low + (high - low) * Fraction(part, parts) for part in range(parts + 1)]
            sides.append(list(pairwise(cuts)))
        return list(product(*sides))

    @cached_property
    def _remembered(self) -> Sequence[Fraction]:
        known = self.running.error.remembered(self.running.proof.steps.theta)
        assert known is not None  # `start.scales` is not None either
        return known

    def _samples(self, ranges: Sequence[Side]) -> list[Any]:
        """Return balls (p) that enclose each output's samples at both
        ends of a call, for a plant in `ranges` at its beginning."""
        y = []
        for j, (low, high) in enumerate(self._offsets):
            i, slope = self.running.heads[j]
            ends = [slope * (end + way * self.displacements[i]) for end, way in zip(ranges[i], (-1, 1), strict=True)]
            y.append(between(min(ends) + low - self.samples[j], max(ends) + high + self.samples[j]))
        return y

    @cached_property
    def _offsets(self) -> list[Side]:
        """The range of y - (dy/dz_i) z_i of each output y, z_i the first state of its chain of integrators."""
        form, offsets = self.running.step.observer.form, list[Side]()
        where = form.box
        slopes = {output: form.states[i] * sp.Rational(slope) for output, (i, slope) in self.running.heads.items()}
        for j, row in enumerate(form.output):
            known = bound(sp.expand(row - slopes.get(j, 0)), where)
            if not (known.defined and known.finite) or j not in slopes:
                raise Unbounded(because("{expression} has no finite range on the box", expression=row))
            offsets.append((Fraction(known.low), Fraction(known.high)))
        return offsets

    @cached_property
    def _inputs(self) -> list[Any]:
        for signal in self.running.step.inputs:
            if not signal.bounded:
                raise Unbounded(because("{signal} has no range", signal=signal))
        return [between(*map(Fraction, signal.interval)) for signal in self.running.step.inputs]
