"""The context of a rule: the exact algebra of a certificate, its form in chains, and the rules' data type.

Every rule first verifies that the form is the plant:

    dX/dz (A z + b) = f(X(z), u),   h(X(z), u) = output,   Z(X(z)) = z,   X(Z(x)) = x

as rational functions, X = from_form, Z = to_form, where every expression has a value on its whole box.

For claims about observers a form in chains has its structure, its a_i, chains of integrators, and slopes:

    z' = A(u) z + b(z, u),   y_i = a_1 z_1 + c of its chain:   A has a superdiagonal within each chain only
    w_i = a_1 .. a_i z_i:   w_i' = w_(i+1) + c_i(w, u),   c_i = a_1 .. a_i b_i,   y = w_1 + o(u)

A rule verifies one kind of claim in one time model against the certificate's own plant, form and observer. It derives
the statement to prove from the plant and the form, never from the claim: the claim adds bounds, a bisection or a
witness.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from decimal import Context as Digits
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeVar

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Undefined, Unproved, along, total
from .box import Box, Norm, continuous, covered, cut, narrowed, ranged, spectral, steep
from .file import (
    Certificate,
    Claim,
    FormFile,
    NoCertificate,
    Observer,
    column,
    ends,
    entries,
    fields,
    part,
    scalar,
    signless,
)
from .matrix import Matrix
from .text import Expression, Unreadable, expression, number
from .turns import Turn, demand_periodic


@dataclass(frozen=True)
class Finding:
    """The result of a verified claim: a sentence for the report, and the number of boxes of its proof."""

    sentence: str
    boxes: int = 0


REFUSALS = (
    Unproved,
    Undefined,
    TooLarge,
    RecursionError,
    NoCertificate,
    Unreadable,
)  # errors of a failed verification


def reason_of(error: Exception) -> str:
    """Return the reason why a verification failed, in words."""
    match error:
        case Undefined():
            return f"an expression has no value: {error}"
        case TooLarge() | RecursionError():
            return "its identity is too large to verify"
        case NoCertificate():
            return error.reason
        case Unreadable():
            return error.fault
        case _:
            return str(error)


class Context:
    """A certificate (`file`) with its `form`, `plant`, the form's states `z`, and the exact `algebra` of quotients in
    the form's names; `value` reads an expression in it."""

    def __init__(self, certificate: Certificate) -> None:
        self.file = certificate
        self.form, self.plant = certificate.form, certificate.plant
        self.z = self.form.states
        self.algebra = algebra_of(self.form.box)
        self.value = self.algebra.read  # of an expression of the form's names

    @property
    def equations(self) -> Finding:
        """The finding, by exact algebra, that the form z' = A z + b, y = output is the plant. Raises: `Unproved`."""
        if self.fault:
            raise Unproved(self.fault)
        return Finding("the form's equations are the plant's")

    @cached_property
    def fault(self) -> str:
        """The reason why the form is not proved to be the plant, or ""."""
        try:
            self._finite()
            self._flow()
        except REFUSALS as error:
            return reason_of(error)
        return ""

    def _finite(self) -> None:
        """Demand that every expression is finite on its whole box:
        an identity proves nothing where a side is undefined."""
        form, plant = self.form, self.plant
        if len(self.z) != len(plant.states):
            raise Unproved("the form has not as many states as the plant")
        rows = [*form.from_form, *form.b, *form.output, *(entry for row in form.A for entry in row)]
        for where, box, texts in (
            ("the plant", plant.box, (*plant.flow, *plant.output, *form.to_form)),
            ("the form", form.box, rows),
        ):
            for text in texts:
                try:
                    finite(text, box)
                except Unproved as error:
                    raise Unproved(f"{cut(text.text)} of {where} is not shown to be a finite number: {error}") from None

    def _flow(self) -> None:
        """Prove dX/dz (A z + b) = f(X(z), u), h(X(z), u) = output, Z(X(z)) = z and X(Z(x)) = x."""
        algebra, form, plant, z = self.algebra, self.form, self.plant, self.algebra.names
        for change in (*form.to_form, *form.from_form):
            only(change.names & set(self.file.inputs), (), "the change of coordinates")
        rates = {
            name: total(
                (
                    self.value(nonlinear),
                    *(self.value(entry) * z[other] for entry, other in zip(row, self.z, strict=True)),
                )
            )
            for name, nonlinear, row in zip(self.z, form.b, form.A, strict=True)
        }
        images = [along(inverse, z, rates, algebra.arithmetic) for inverse in form.from_form]
        x = {**z, **{name: image for name, (image, _) in zip(plant.states, images, strict=True)}}
        for name, flow, (_, speed) in zip(plant.states, plant.flow, images, strict=True):
            self._same(algebra.read(flow, x), speed, f"{name}' of the form is not the plant's")
        for measured, output in zip(plant.output, form.output, strict=True):
            self._same(algebra.read(measured, x), self.value(output), "the form's output is not the plant's")
        for name, forward in zip(form.states, form.to_form, strict=True):
            self._same(algebra.read(forward, x), z[name], f"{name} is not undone by the inverse")
        algebra = algebra_of(plant.box)  # z tells all of x on the plant's ranges
        z = {**algebra.names, **{name: algebra.read(row) for name, row in zip(form.states, form.to_form, strict=True)}}
        for name, row in zip(plant.states, form.from_form, strict=True):
            if not algebra.is_zero(algebra.read(row, z) - algebra.names[name]):
                raise Unproved(f"{name} is not undone by the change of coordinates")

    @cached_property
    def turns(self) -> tuple[Turn | None, ...]:
        """The periods of the outputs (p), None of one without. The plant and the form are verified to be periodic in
        their angles, so that both obey their equations on the whole line. Raises: `Unproved`."""
        plant, form = self.plant, self.form
        forward = ((row, form.turns.get(name)) for name, row in zip(self.z, form.to_form, strict=True))
        outputs = zip(plant.output, plant.periods, strict=True)
        demand_periodic((*((row, None) for row in plant.flow), *outputs, *forward), plant.turns, plant.box)
        back = ((row, plant.turns.get(name)) for name, row in zip(plant.states, form.from_form, strict=True))
        rows = ((row, None) for row in (*form.b, *(entry for line in form.A for entry in line)))
        outputs = zip(form.output, plant.periods, strict=True)
        demand_periodic((*rows, *outputs, *back), form.turns, form.box)
        return plant.periods

    @property
    def modulo(self) -> str:
        """The condition under which an observer's error obeys its equation, in words; "" without periodic outputs."""
        return ", while the errors of periodic outputs are below half a turn" if any(self.plant.periods) else ""

    @cached_property
    def rates(self) -> tuple[Expression, ...]:
        """The rows F (n) of z' = F = A z + b, as expressions."""
        return self._rows(lambda entry: entry.text != "0")

    @cached_property
    def nonlinear(self) -> tuple[Expression, ...]:
        """The rows (n) of b plus the terms A_ij z_j whose A_ij reads a state."""
        return self._rows(lambda entry: not entry.names.isdisjoint(self.z))

    def _rows(self, selects: Callable[[Expression], bool]) -> tuple[Expression, ...]:
        terms = (
            [f"({entry.text})*{name}" for entry, name in zip(row, self.z, strict=True) if selects(entry)]
            for row in self.form.A
        )
        pairs = zip(self.form.b, terms, strict=True)
        return tuple(expression(" + ".join((f"({nonlinear.text})", *row)), self.form.box) for nonlinear, row in pairs)

    def _same(self, a: Quotient, b: Quotient, complaint: str) -> None:
        if not self.algebra.is_zero(a - b):
            raise Unproved(complaint)

    def same(self, text: Expression, wanted: Quotient, complaint: str) -> None:
        """Demand that an expression of the file equals the `wanted` quotient; `complaint` is the error's text."""
        self._same(self.value(text), wanted, complaint)

    def first_gain(self, chain: int) -> Quotient:
        """Return a_1 = dy/dz of the output of a `chain`, from 0, in the state z that it measures. No a_1 reads z, since
        y(z) - y(0) = z dy/dz is proved for every z. Raises: `Unproved`."""
        first, output = self.observed[chain], self.form.output[chain]
        slope, letters = self.slope(output, first), self.algebra.names
        nonlinear = self.value(output, {**letters, first: self.algebra.zero})
        self._same(self.value(output) - nonlinear, slope * letters[first], f"the output is not linear in {first}")
        return slope

    def output_slope(self, output: int) -> Fraction:
        """Return dy/dz of an output in the state z that it measures, a number other than 0. Raises: `Unproved`."""
        slope = self.first_gain(output).number
        if not slope:
            raise Unproved("the slope of an output is no number")
        return slope

    @property
    def heads(self) -> tuple[str, ...]:
        """The name of the first state z_1 of each chain of integrators (p), "" for a chain without states."""
        blocks = self.form.blocks
        return tuple(self.z[sum(blocks[:i])] if size else "" for i, size in enumerate(blocks))

    @cached_property
    def observed(self) -> tuple[str, ...]:
        """The name of the state that each output (p) measures: the first of its own chain, or of another chain if the
        slopes of both outputs are numbers; "" if neither is proved."""
        return tuple(of_chain or self._shared(j) for j, of_chain in enumerate(self.heads))

    def _shared(self, output: int) -> str:
        text = self.form.output[output]
        for of_chain, z in zip(self.form.output, self.heads, strict=True):
            if z and text.names & set(self.z) == {z} and self.slope(text, z).number and self.slope(of_chain, z).number:
                return z
        return ""

    def demand_observed(self, output: int) -> None:
        """Demand that the output of an index measures the first state of a chain. Raises: `Unproved`."""
        if not self.observed[output]:
            raise Unproved(f"output {output + 1} is not shown to show the first state of a chain")

    def slope(self, text: Expression, name: str) -> Quotient:
        """Return the partial derivative of an expression with respect to a name, in closed form."""
        return self.algebra.speed(text, {name: self.algebra.one})

    def at_kinks(self, slope: Expression, row: Expression) -> Expression:
        """Return the slope of a `row` with each sign(e) in it read as the slope of |e|, which at e = 0 is a set and not
        0. A sign in the row itself stays: x sign(u) has the slope sign(u), which is 0 at u = 0, also at an edge."""
        jumps = [self.value(replace(row, result=args[0])) for op, args, _ in row.instructions if op == "sign"]

        def is_sign_of_row(place: int) -> bool:
            argument = self.value(replace(slope, result=place))
            return any(self.algebra.is_zero(argument - jump) for jump in jumps)

        steps = (
            step._replace(op="side") if step.op == "sign" and not is_sign_of_row(step.args[0]) else step
            for step in slope.instructions
        )
        return replace(slope, instructions=tuple(steps))


def algebra_of(box: Box) -> Algebra:
    """Return the algebra of a box's names; a name with one value is a number."""
    free = [name for name, (low, high) in box.items() if low < high]
    fixed = {name: Fraction(low) for name, (low, high) in box.items() if low == high}
    return Algebra(free, [name for name in free if box[name][0] >= 0], fixed)


def numbers(rows: Iterable[Sequence[Quotient]]) -> list[list[Fraction]] | None:
    """Return rows of quotients as rows of fractions; None if an entry is not written as a number."""
    values = [[entry.number for entry in row] for row in rows]
    known = [[value for value in row if value is not None] for row in values]
    return known if known == values else None


def applied(algebra: Algebra, M: Iterable[Sequence[Fraction]], x: Sequence[Quotient]) -> list[Quotient]:
    """Return M x for a matrix M of numbers and quotients x."""
    return [inner(algebra, [algebra.number(a) for a in row], x) for row in M]


def inner(algebra: Algebra, a: Sequence[Quotient], x: Sequence[Quotient]) -> Quotient:
    """Return sum_k a_k x_k."""
    products = (share * each for share, each in zip(a, x, strict=True) if share)
    return sum(products, start=algebra.zero)


# --- pieces of rules


def inside(low: Any, high: Any, share: Fraction) -> Fraction:
    """Return the point at a share (0 to 1) of a range; in an unbounded one, at that distance from its end or 0."""
    if low > -math.inf:
        return Fraction(low) + (share if high == math.inf else share * (Fraction(high) - Fraction(low)))
    return (Fraction(0) if high == math.inf else Fraction(high)) - share


_MOST = 40  # digits of a number in a sentence
RANGE = ("expression", "box", "low", "high", "tree")  # keys of the evidence of an enclosure


def only(names: Iterable[str], allowed: Iterable[str], complaint: str) -> None:
    """Demand that all names are allowed; the error begins with `complaint`. Raises: `Unproved`."""
    strange = sorted(set(names) - set(allowed))
    if strange:
        raise Unproved(f"{complaint} reads {', '.join(strange)}")


def finite(text: Expression, box: Box) -> int:
    """Demand that an expression is finite on its whole box; return the number of boxes. Raises: `Unproved`."""
    return covered(narrowed(box, text.names), ".", ranged(text, -math.inf, math.inf))


def declared_box(evidence: Mapping[str, Any], box: Box, names: Iterable[str]) -> Box:
    """Return the model's ranges of these names, which must equal the evidence's `box`. Raises: `Unproved`."""
    wanted = narrowed(box, names)
    pairs = part(evidence, "box", dict)
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs.values()):
        raise Unproved("a range of its box has not two ends")
    if {name: ends(low, high, name) for name, (low, high) in sorted(pairs.items())} != wanted:
        raise Unproved("its box is not the model's ranges of the names it reads")
    return wanted


def claimed(context: Context, evidence: Mapping[str, Any], wanted: Quotient) -> Expression:
    """Return the evidence's `expression`, which must equal the quotient `wanted`. Raises: `Unproved`."""
    text = expression(part(evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    return text


def enclosed(
    context: Context,
    evidence: Any,
    wanted: Quotient,
    source: Expression,
    read: Callable[[Expression], Expression] = lambda text: text,
) -> tuple[Fraction, Fraction, Finding]:
    """Return the evidence's bounds low <= e <= high, once proved on the model's box, and the finding: e is the quotient
    `wanted`, a part of the form's expression `source`; `read` transforms the evidence's expression of e before the
    evaluation. Raises: `Unproved`."""
    text = claimed(context, fields(evidence, "a range", RANGE), wanted)
    low, high = scalar(evidence, "low"), scalar(evidence, "high")
    box = declared_box(evidence, context.form.box, text.names)
    boxes = covered(box, part(evidence, "tree", str), ranged(read(text), low, high))
    if text.text != source.text:  # the form's own expression is defined there, too
        boxes += finite(source, context.form.box)
    return low, high, Finding(f"{printed(low, -1)} <= {cut(text.text)} <= {printed(high, 1)}{on(box)}", boxes)


def printed(value: Fraction, way: int = 0, digits: int = 6) -> str:
    """Return a number for a sentence: a long one is rounded to so many digits, up for `way` 1, down for -1."""
    text = str(value)
    if len(text) <= 12:
        return text
    rounding = {1: ROUND_CEILING, 0: ROUND_HALF_EVEN, -1: ROUND_FLOOR}[way]
    rounded = Digits(prec=digits, rounding=rounding).divide(Decimal(value.numerator), Decimal(value.denominator))
    return f"{rounded:f}" if -4 <= rounded.adjusted() < digits else f"{rounded:e}"


def is_above(value: Fraction, bound: Fraction) -> str:
    """Return the words that `value` is above `bound`, with enough digits to distinguish them. Raises: `Unproved` if
    that takes too many digits."""
    for digits in range(6, _MOST):
        high, low = printed(value, -1, digits), printed(bound, 1, digits)
        if Fraction(high) > Fraction(low):
            return f"{high} is above {low}"
    raise Unproved(f"{printed(value)} is above {printed(bound)} by less than {_MOST} digits tell")


def on(box: Box) -> str:
    """Return text such as " on x in [0, 1], u in [-2, 2]", without the sides of a box that are points."""
    named = [f"{name} in [{low}, {high}]" for name, (low, high) in box.items() if low < high]
    return f" on {', '.join(named)}" if named else ""


def witness(claim: Claim, box: Box, names: Iterable[str], key: str = "witness") -> dict[str, Fraction]:
    """Return the claim's point in the box, with a value for each of `names`. Raises: `Unproved`."""
    coordinates = part(claim.evidence, key, dict)
    at = {name: number(value) for name, value in sorted(coordinates.items())}
    for name, value in at.items():
        if name not in box or not box[name][0] <= value <= box[name][1]:
            raise Unproved(f"its witness has {name} = {value}, outside the model's range")
    for name in names:
        low, high = box[name]
        if name not in at and low == high:
            at[name] = Fraction(low)
        if name not in at:
            raise Unproved(f"its witness does not say {name}")
    return at


CHAINS = ("triangular", "block_triangular")
CARRIED = ("phase", "uniform_chain")  # of one output, whose states are maps of the plant's
ON_CHAINS = (*CHAINS, *CARRIED)


def structure(context: Context, claim: Claim) -> Finding:
    """Demand the structure of chains: A has a superdiagonal within each chain only, which reads no state (but z_1 if
    there is one chain), b reads the states that the alignment permits, and y_i = a_1 z_1 + c of its chain, where a_1
    and c read no state.

    An output whose chain has no states is unconstrained: an observer uses it as a measurement of the first state of
    another chain if it is a constant multiple of that chain's output, else no gain acts on it."""
    form, z = context.form, context.z
    several = form.kind == "block_triangular"
    if len(form.blocks) != len(form.output) or not (several or len(form.blocks) == 1):
        raise Unproved("it has not one chain for each output")
    if form.alignment not in (("top", "end", "cascade") if several else ("",)):
        raise Unproved(f"{form.alignment!r} is no alignment of its chains")
    _ = context.equations
    places = tuple((k, level) for k, size in enumerate(form.blocks) for level in range(1, size + 1))
    _superdiagonal(context, places)
    for i, nonlinear in enumerate(form.b):
        allowed = [z[j] for j in range(len(z)) if _readable(form, places[i], places[j])]
        only(nonlinear.names & set(z), allowed, f"b_{i + 1}")
    _in_order(context, places)
    for chain, output in ((k, output) for k, output in enumerate(form.output) if form.blocks[k]):
        only(output.names & set(z), (context.heads[chain],), f"output {chain + 1}")
        _ = context.first_gain(chain)
    ranges_kept(context)
    reads = {name for row in form.A for entry in row for name in entry.names}
    varies = f", gains vary with the measured {z[0]}" if z[0] in reads else ""
    chains = "; ".join(
        " -> ".join((f"y_{k + 1}" if several else "y", *(s for s, (at, _) in zip(z, places, strict=True) if at == k)))
        for k in range(len(form.blocks))
        if form.blocks[k]
    )
    return Finding(
        f"{chains}{varies}{f' ({form.alignment})' if several else ''}, and the form's equations are the plant's"
    )


def _superdiagonal(context: Context, places: Sequence[tuple[int, int]]) -> None:
    """Demand that A has entries from one place of a chain to the next alone, which read no state but z_1 of one
    chain."""
    form, z = context.form, context.z
    for i, row in enumerate(form.A):
        for j, entry in enumerate(row):
            if j == i + 1 and places[j][0] == places[i][0]:
                only(entry.names & set(z), () if form.kind == "block_triangular" else z[:1], f"A[{i + 1},{j + 1}]")
            elif not context.algebra.is_zero(context.value(entry)):
                raise Unproved(f"A[{i + 1},{j + 1}] is not zero")


def _readable(form: FormFile, reader: tuple[int, int], read: tuple[int, int]) -> bool:
    (i, level), (k, at) = reader, read
    if i == k:
        return at <= level
    if form.alignment == "top":
        return at <= level
    if form.alignment == "end":
        return at <= level + form.blocks[k] - form.blocks[i]
    return form.alignment == "cascade"


def _in_order(context: Context, places: Sequence[tuple[int, int]]) -> None:
    form = context.form
    if form.alignment != "cascade":
        return
    chain = {name: k for name, (k, _) in zip(context.z, places, strict=True)}
    reads: dict[int, set[int]] = {k: {k} for k in range(len(form.blocks))}
    for nonlinear, (k, _) in zip(form.b, places, strict=True):
        reads[k] |= {chain[name] for name in nonlinear.names if name in chain}
    done: set[int] = set()
    while len(done) < len(reads):
        ready = {k for k, others in reads.items() if k not in done and others <= done | {k}}
        if not ready:
            raise Unproved("its chains read each other in a circle")
        done |= ready


def ranges_kept(context: Context, every: bool = False) -> int:
    """Demand that the form's states stay in their ranges while the plant's do, and return the number of boxes. A state
    that is none of the plant's may be left to a claim `recast.range`, unless `every` state is requested."""
    boxes = 0
    range_claimed = not every and context.file.claim("recast.range") is not None
    for name, row in zip(context.z, context.form.to_form, strict=True):
        if range_claimed and row.text.lstrip("-") not in context.plant.states:
            continue
        boxes += covered(narrowed(context.plant.box, row.names), ".", ranged(row, *context.form.box[name]))
    return boxes


Value = TypeVar("Value")


def wanted_gain(context: Context, place: tuple[int, ...]) -> tuple[Quotient, Expression]:
    """Return a_i, y = a_1 z_1 + c, z_(i-1)' = a_i z_i + .., as a quotient, and the expression that contains it;
    `place`: (i) in the only chain, or (k, i) in chain k. Raises: `Unproved`."""
    _ = context.equations
    chain, index = place if len(place) == 2 else (1, *place)
    at = place_of(context, chain, index)
    if index == 1:
        return context.first_gain(chain - 1), context.form.output[chain - 1]
    entry = context.form.A[at - 1][at]
    return context.value(entry), entry


def place_of(context: Context, chain: int, index: int) -> int:
    """Return the index among all states, from 0, of the state `index` of a chain, both from 1. Raises: `Unproved`."""
    blocks = context.form.blocks
    if not (1 <= chain <= min(len(blocks), len(context.form.output)) and 1 <= index <= blocks[chain - 1]):
        raise Unproved("the form has no such row")
    return sum(blocks[: chain - 1]) + index - 1


def observer_of(context: Context, claim: Claim) -> Observer:
    """Return the file's observer with its numbers; the claim's id must begin with its name. Raises: `Unproved`."""
    observer, name = context.file.observer, claim.maker
    if observer is None or observer.name != name or not observer.numbers:
        raise Unproved(f"the file has no {name} observer with its numbers")
    return observer


@dataclass(frozen=True)
class Scale:
    """Coordinates S w of a chain of integrators w, S = diag(`units`) (n): S_i w_i is z_i times entry i of
    `expressions`, which read parameters only and are proved finite and nonzero with `boxes` boxes."""

    units: list[Fraction]
    expressions: list[Expression]
    boxes: int


def integrators(context: Context, evidence: Mapping[str, Any]) -> Scale:
    """Return the `Scale` of the form's only chain: its `scale` must be units_i a_1 .. a_i. Raises: `Unproved`."""
    _ = context.equations
    n, algebra, product = len(context.z), context.algebra, context.algebra.one
    if len(context.form.blocks) != 1:
        raise Unproved("the form is not one chain")
    units, scale = column(evidence, "units", n), constants(context, entries(evidence, "scale", n))
    for i, (unit, text) in enumerate(zip(units, scale, strict=True), 1):
        product = product * wanted_gain(context, (i,))[0]
        context.same(text, algebra.number(unit) * product, f"its scale {text.text} is not that of w_{i}")
        if unit <= 0:
            raise Unproved("its units are not positive")
    return Scale(units, scale, invertible(context, scale))


def constants(context: Context, texts: Sequence[Any]) -> list[Expression]:
    """Return the texts as expressions, which read parameters only. Raises: `Unproved`."""
    expressions = [expression(text, context.form.box) for text in texts]
    for text in expressions:
        only(text.names, context.file.parameters, f"the constant {text.text}")
    return expressions


def invertible(context: Context, scale: Sequence[Expression]) -> int:
    """Demand that each entry of `scale` is finite and not zero; return the number of boxes. Raises: `Unproved`."""
    box = context.form.box
    return sum(finite(expression(f"1/({s.text})", box), box) for s in scale)


def steady(context: Context, gains: Sequence[Expression]) -> int:
    """Demand that A reads no state, and that an observer's gains read parameters only and are finite for all of them;
    return the number of boxes. Raises: `Unproved`."""
    for entry in (entry for row in context.form.A for entry in row):
        only(entry.names & set(context.z), (), "A")
    return sum(finite(k, context.form.box) for k in constants(context, [k.text for k in gains]))


def gain_of(blocks: Sequence[int], entries: Sequence[Value], none: Value) -> list[list[Value]]:
    """Return the gain matrix (n, p) from the list of its entries: one for each state, which acts on the output of the
    state's own chain, or one for each state and chain, state by state; `none` elsewhere."""
    chain = [k for k, size in enumerate(blocks) for _ in range(size)]
    onto = [[k] for k in chain] if len(entries) == len(chain) else [[k for k, size in enumerate(blocks) if size]]
    columns, nonlinear = onto * (len(chain) // len(onto)), iter(entries)
    return [[next(nonlinear) if k in each else none for k in range(len(blocks))] for each in columns]


def core_of(context: Context, scale: Sequence[Expression], gains: Sequence[Expression], N: Matrix) -> Matrix:
    """Return N, once S (A - K C) = N S, S = diag(`scale`), K the `gains`, is proved. Raises: `Unproved`."""
    algebra, form = context.algebra, context.form
    S, entries = ([context.value(text) for text in texts] for texts in (scale, gains))
    column, K = {z: k for k, z in enumerate(context.heads)}, gain_of(form.blocks, entries, algebra.zero)
    for i, row in enumerate(form.A):
        for j, text in enumerate(row):
            entry, at = context.value(text), column.get(context.z[j])
            if at is not None:
                entry = entry - K[i][at] * context.first_gain(at)
            if not algebra.is_zero(S[i] * entry - algebra.number(N[i][j]) * S[j]):
                raise Unproved(f"its core[{i + 1},{j + 1}] is not that of S (A - K C) S^-1")
    return N


def slope(
    context: Context, evidence: Mapping[str, Any], scale: Sequence[Expression], norm: Norm = spectral
) -> tuple[Fraction, int]:
    """Return the proved bound of |S db/dz S^-1|, S = diag(`scale`), and the number of boxes. Raises: `Unproved`."""
    bound, _, boxes = _steepness(context, evidence, context.form.b, scale, norm)
    return bound, boxes


def jacobian_bound(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Finding:
    """Return the finding |d rows/dz| <= the claim's bound (spectral); `name` is printed. Raises: `Unproved`."""
    _ = context.equations
    bound, box, boxes = _steepness(context, claim.evidence, rows)
    return Finding(f"|{name}| <= {printed(bound, 1)}{on(box)}", boxes)


def _steepness(
    context: Context,
    evidence: Mapping[str, Any],
    rows: Sequence[Expression],
    scale: Sequence[Expression] = (),
    norm: Norm = spectral,
) -> tuple[Fraction, Box, int]:
    box = declared_box(evidence, context.form.box, {name for read in (*rows, *scale) for name in read.names})
    bound = signless(evidence, "bound")
    continuous(rows, context.z, box)
    return bound, box, covered(box, part(evidence, "tree", str), steep(rows, context.z, bound, scale, norm))


Verify = Callable[[Context, Claim], Finding]
Keys = tuple[str, ...]
STEEP: Keys = ("box", "bound", "tree")  # evidence of the bound of a slope
POINT: Keys = ("expression", "witness")
STRUCTURE = "{kind}.structure"  # the claim that a form is in chains


@dataclass(frozen=True)
class Rule:
    """A rule: the claims that it verifies, and the function `verify` that does. `makers`: the part of a claim's id
    before the dot, none for the form's kind; `facts`: the part after it, without its row numbers; `rows`: the number of
    row numbers by the kind of form, none for other kinds; `kinds`: the kinds of form on which the rule holds, none for
    any; `keys`: the permitted parts of the evidence; `assumes`: the ids of the claims that it assumes; `about`: the
    subject of its sentence, both with {maker} and the form's {kind} filled in; `turning`: the ids of the claims that it
    assumes as well of a plant with periodic outputs, None for a rule that does not hold there."""

    makers: Keys
    facts: Keys
    verify: Verify
    keys: Keys = ()
    kinds: Keys = ()
    rows: Mapping[str, int] = field(default_factory=dict, hash=False)
    verdict: str = "proved"
    assumes: Keys = ()
    about: str = "the {kind} form"
    turning: Keys | None = ()

    def accepts(self, kind: str, claim: Claim) -> bool:
        """Return whether the rule verifies a claim on a form of the given kind."""
        rows = self.rows.get(kind, 0)
        fact, count = (claim.fact, len(claim.at)) if rows else (claim.what, 0)
        known = claim.maker in (self.makers or (kind,)) and fact in self.facts and count == rows
        return known and claim.verdict == self.verdict and (not self.kinds or kind in self.kinds)

    def needs(self, kind: str, claim: Claim, periodic: bool) -> Keys:
        """Return the ids of the claims that a claim on a form of the given kind assumes, for a plant with `periodic`
        outputs or none. On a form carried to other coordinates the structure is no claim: it is verified with each
        claim that assumes it."""
        assumed = (*self.assumes, *((self.turning or ()) if periodic else ()))
        return tuple(self.named(id, kind, claim) for id in assumed if id != STRUCTURE or kind not in CARRIED)

    def named(self, text: str, kind: str, claim: Claim) -> str:
        """Return a text of the rule with the claim's maker and the form's kind filled in."""
        return text.format(maker=claim.maker, kind=kind)

    def find(self, context: Context, claim: Claim) -> Finding:
        """Return the finding on a claim that the rule accepts. Raises: `Unproved`."""
        if self.turning is None and any(context.plant.periods):
            raise Unproved("an output is periodic, for which its rule is not")
        if STRUCTURE in self.assumes and context.form.kind in CARRIED:
            observer = context.file.observer
            if observer is None or observer.name != claim.maker:
                raise Unproved("the file's observer is another")
            structure(context, claim)
        return self.verify(context, claim)


@dataclass(frozen=True)
class Needed:
    """The claims that a certificate of a form requires, whatever their verdicts: the claim of its `structure`, and the
    `others` if that is proved."""

    structure: str
    others: Callable[[FormFile], tuple[str, ...]] = lambda form: ()


def observer_rule(
    makers: Keys,
    facts: Keys,
    verify: Verify,
    keys: Keys = (),
    *assumes: str,
    kinds: Keys = (),
    turning: Keys | None = None,
) -> Rule:
    """Return the rule of claims about observers' numbers only, on forms of these `kinds` or any; see `Rule`."""
    return Rule(makers, facts, verify, keys, kinds, assumes=assumes, about="the {maker} observer", turning=turning)


def chains_rule(
    makers: Keys, facts: Keys, verify: Verify, keys: Keys = (), *assumes: str, turning: Keys | None = None
) -> Rule:
    """Return the rule of claims about observers on chains of integrators, whose structure it assumes; see `Rule`."""
    return observer_rule(makers, facts, verify, keys, STRUCTURE, *assumes, kinds=ON_CHAINS, turning=turning)
