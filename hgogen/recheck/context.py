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
from .box import Box, Norm, covered, demand_continuous, narrowed, norm_at_most, ranged, shortened, spectral
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
    """The result of a verified claim: the `sentence` for the report, and the number of `boxes` of the proof."""

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
    """A certificate `file` under verification, with its `form` z' = A z + b of the `plant`, the names `z` of the form's
    states, and the exact `algebra` of quotients in the form's names; `value` reads an expression as a quotient."""

    def __init__(self, certificate: Certificate) -> None:
        self.file = certificate
        self.form, self.plant = certificate.form, certificate.plant
        self.z = self.form.states
        self.algebra = algebra_of(self.form.box)
        self.value = self.algebra.read  # of an expression of the form's names

    @property
    def equations(self) -> Finding:
        """The finding that the form z' = A z + b, y = output is the plant in other coordinates, by exact algebra.
        Raises: `Unproved`."""
        if self.fault:
            raise Unproved(self.fault)
        return Finding("the form's equations are the plant's")

    @cached_property
    def fault(self) -> str:
        """The reason why the form is not proved to be the plant in other coordinates; "" if it is."""
        try:
            self._finite()
            self._flow()
        except REFUSALS as error:
            return reason_of(error)
        return ""

    def _finite(self) -> None:
        """Demand that every expression is finite on its whole box: an identity proves nothing where one side is
        undefined."""
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
                    demand_finite(text, box)
                except Unproved as error:
                    raise Unproved(
                        f"{shortened(text.text)} of {where} is not shown to be a finite number: {error}"
                    ) from None

    def _flow(self) -> None:
        """Prove dX/dz (A z + b) = f(X(z), u), h(X(z), u) = output, Z(X(z)) = z and X(Z(x)) = x."""
        algebra, form, plant, z = self.algebra, self.form, self.plant, self.algebra.names
        for change in (*form.to_form, *form.from_form):
            demand_only(change.names & set(self.file.inputs), (), "the change of coordinates")
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
        """The periods (p) of the outputs, None for an output without one. It is verified that the plant and the form
        are periodic in their angles, so that their equations hold on the whole line. Raises: `Unproved`."""
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
        """The condition, in words, under which an observer's error obeys its equation: periodic outputs must be off by
        less than half a turn. "" for a plant without periodic outputs."""
        return ", while the errors of periodic outputs are below half a turn" if any(self.plant.periods) else ""

    @cached_property
    def rates(self) -> tuple[Expression, ...]:
        """The right-hand sides (n) of z' = A z + b, as expressions."""
        return self._rows(lambda entry: entry.text != "0")

    @cached_property
    def nonlinear(self) -> tuple[Expression, ...]:
        """The rows (n) of the form's nonlinear part: b plus the terms A_ij z_j whose A_ij depends on a state."""
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
        """Demand that an expression of the file equals the quotient `wanted`; `complaint`: the text of the error.
        Raises: `Unproved`."""
        self._same(self.value(text), wanted, complaint)

    def first_gain(self, chain: int) -> Quotient:
        """Return a_1 = dy/dz for the output of a `chain`, counted from 0, and the state z that it measures. a_1 does
        not depend on z, since y(z) - y(0) = z dy/dz is proved for every z. Raises: `Unproved`."""
        first, output = self.observed[chain], self.form.output[chain]
        slope, letters = self.slope(output, first), self.algebra.names
        nonlinear = self.value(output, {**letters, first: self.algebra.zero})
        self._same(self.value(output) - nonlinear, slope * letters[first], f"the output is not linear in {first}")
        return slope

    def output_slope(self, output: int) -> Fraction:
        """Return dy/dz for an output and the state z that it measures, a number other than 0. Raises: `Unproved`."""
        slope = self.first_gain(output).number
        if not slope:
            raise Unproved("the slope of an output is no number")
        return slope

    @property
    def heads(self) -> tuple[str, ...]:
        """The names (p) of the first states z_1 of the chains of integrators, "" for a chain without states."""
        blocks = self.form.blocks
        return tuple(self.z[sum(blocks[:i])] if size else "" for i, size in enumerate(blocks))

    @cached_property
    def observed(self) -> tuple[str, ...]:
        """The names (p) of the states that the outputs measure: the first state of the output's own chain, or of
        another chain if both chains' outputs have constant slopes in it; "" where neither is proved."""
        return tuple(of_chain or self._shared(j) for j, of_chain in enumerate(self.heads))

    def _shared(self, output: int) -> str:
        text = self.form.output[output]
        for of_chain, z in zip(self.form.output, self.heads, strict=True):
            if z and text.names & set(self.z) == {z} and self.slope(text, z).number and self.slope(of_chain, z).number:
                return z
        return ""

    def demand_observed(self, output: int) -> None:
        """Demand that an output, by its index, measures the first state of a chain. Raises: `Unproved`."""
        if not self.observed[output]:
            raise Unproved(f"output {output + 1} is not shown to show the first state of a chain")

    def slope(self, text: Expression, name: str) -> Quotient:
        """Return the partial derivative of an expression by a name, in closed form."""
        return self.algebra.speed(text, {name: self.algebra.one})

    def at_kinks(self, slope: Expression, row: Expression) -> Expression:
        """Return the partial derivative `slope` of a `row` with each sign(e) in it read as the derivative of |e|, whose
        value at e = 0 is a set. A sign that is in the row itself stays a number: x sign(u) has the slope sign(u), which
        is 0 at u = 0."""
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
    """Return the algebra of the names of a box; a name whose range is one point is a number."""
    free = [name for name, (low, high) in box.items() if low < high]
    fixed = {name: Fraction(low) for name, (low, high) in box.items() if low == high}
    return Algebra(free, [name for name in free if box[name][0] >= 0], fixed)


def numbers(rows: Iterable[Sequence[Quotient]]) -> list[list[Fraction]] | None:
    """Return a matrix of quotients as a matrix of fractions; None if an entry is not written as a number."""
    values = [[entry.number for entry in row] for row in rows]
    known = [[value for value in row if value is not None] for row in values]
    return known if known == values else None


def applied(algebra: Algebra, M: Iterable[Sequence[Fraction]], x: Sequence[Quotient]) -> list[Quotient]:
    """Return the product M x of a matrix of numbers and a vector of quotients."""
    return [inner(algebra, [algebra.number(a) for a in row], x) for row in M]


def inner(algebra: Algebra, a: Sequence[Quotient], x: Sequence[Quotient]) -> Quotient:
    """Return the inner product sum_k a_k x_k."""
    products = (share * each for share, each in zip(a, x, strict=True) if share)
    return sum(products, start=algebra.zero)


# --- pieces of rules


def inside(low: Any, high: Any, share: Fraction) -> Fraction:
    """Return the point that divides a range by a share from 0 to 1; in an unbounded range the point at this distance
    from its end, or from 0."""
    if low > -math.inf:
        return Fraction(low) + (share if high == math.inf else share * (Fraction(high) - Fraction(low)))
    return (Fraction(0) if high == math.inf else Fraction(high)) - share


_MOST = 40  # digits of a number in a sentence
RANGE = ("expression", "box", "low", "high", "tree")  # keys of the evidence of an enclosure


def demand_only(names: Iterable[str], allowed: Iterable[str], complaint: str) -> None:
    """Demand that all `names` are `allowed`; `complaint`: the beginning of the error's text. Raises: `Unproved`."""
    strange = sorted(set(names) - set(allowed))
    if strange:
        raise Unproved(f"{complaint} reads {', '.join(strange)}")


def demand_finite(text: Expression, box: Box) -> int:
    """Demand that an expression is finite on its whole box; return the number of boxes. Raises: `Unproved`."""
    return covered(narrowed(box, text.names), ".", ranged(text, -math.inf, math.inf))


def declared_box(evidence: Mapping[str, Any], box: Box, names: Iterable[str]) -> Box:
    """Return the model's ranges of these names; the `box` in the evidence must state the same. Raises: `Unproved`."""
    wanted = narrowed(box, names)
    pairs = part(evidence, "box", dict)
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs.values()):
        raise Unproved("a range of its box has not two ends")
    if {name: ends(low, high, name) for name, (low, high) in sorted(pairs.items())} != wanted:
        raise Unproved("its box is not the model's ranges of the names it reads")
    return wanted


def claimed(context: Context, evidence: Mapping[str, Any], wanted: Quotient) -> Expression:
    """Return the `expression` in the evidence, which must equal the quotient `wanted`. Raises: `Unproved`."""
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
    """Return the bounds low and high of the evidence, with the finding that low <= e <= high on the model's box; e is
    the quotient `wanted`, which occurs in the form's expression `source`. Raises: `Unproved`.

    `read`: a transformation of the evidence's expression of e before it is bounded, as at kinks.
    """
    text = claimed(context, fields(evidence, "a range", RANGE), wanted)
    low, high = scalar(evidence, "low"), scalar(evidence, "high")
    box = declared_box(evidence, context.form.box, text.names)
    boxes = covered(box, part(evidence, "tree", str), ranged(read(text), low, high))
    if text.text != source.text:  # the form's own expression is defined there, too
        boxes += demand_finite(source, context.form.box)
    return (
        low,
        high,
        Finding(f"{printed(low, -1)} <= {shortened(text.text)} <= {printed(high, 1)}{on_ranges(box)}", boxes),
    )


def printed(value: Fraction, way: int = 0, digits: int = 6) -> str:
    """Return a number for a sentence. A long one is rounded to so many significant `digits`, up if `way` is 1, down if
    it is -1."""
    text = str(value)
    if len(text) <= 12:
        return text
    rounding = {1: ROUND_CEILING, 0: ROUND_HALF_EVEN, -1: ROUND_FLOOR}[way]
    rounded = Digits(prec=digits, rounding=rounding).divide(Decimal(value.numerator), Decimal(value.denominator))
    return f"{rounded:f}" if -4 <= rounded.adjusted() < digits else f"{rounded:e}"


def is_above(value: Fraction, bound: Fraction) -> str:
    """Return a text such as "2.1 is above 2", with enough digits to distinguish `value` from `bound`. Raises:
    `Unproved` if 40 digits do not."""
    for digits in range(6, _MOST):
        high, low = printed(value, -1, digits), printed(bound, 1, digits)
        if Fraction(high) > Fraction(low):
            return f"{high} is above {low}"
    raise Unproved(f"{printed(value)} is above {printed(bound)} by less than {_MOST} digits tell")


def on_ranges(box: Box) -> str:
    """Return the ranges of a box as text, such as " on x in [0, 1], u in [-2, 2]"; sides that are points are
    omitted."""
    named = [f"{name} in [{low}, {high}]" for name, (low, high) in box.items() if low < high]
    return f" on {', '.join(named)}" if named else ""


def witness(claim: Claim, box: Box, names: Iterable[str], key: str = "witness") -> dict[str, Fraction]:
    """Return the point of the box that a claim states under `key`, with a value for each of `names`. Raises:
    `Unproved`."""
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
    """Demand that the form consists of chains of integrators: A couples each state of a chain to the next one only, and
    its entries read no state (but z_1 in a single chain); b reads the states that the alignment permits; y_i = a_1 z_1
    + c for each chain, a_1 and c without states.

    An output whose chain has no states is unconstrained: an observer uses it as a measurement of the first state of
    another chain if it is a constant multiple of that chain's output, else no gain acts on it.
    """
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
        demand_only(nonlinear.names & set(z), allowed, f"b_{i + 1}")
    _in_order(context, places)
    for chain, output in ((k, output) for k, output in enumerate(form.output) if form.blocks[k]):
        demand_only(output.names & set(z), (context.heads[chain],), f"output {chain + 1}")
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
    """Demand that only entries of A that couple a state of a chain to the next one are not 0, and that they read no
    state, but z_1 in a single chain."""
    form, z = context.form, context.z
    for i, row in enumerate(form.A):
        for j, entry in enumerate(row):
            if j == i + 1 and places[j][0] == places[i][0]:
                demand_only(
                    entry.names & set(z), () if form.kind == "block_triangular" else z[:1], f"A[{i + 1},{j + 1}]"
                )
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
    """Demand that the form's states stay in their ranges while the plant's states do; return the number of boxes.
    Raises: `Unproved`.

    A state that is not a state of the plant may be covered by the claim `recast.range` instead, unless `every` is set.
    """
    boxes = 0
    range_claimed = not every and context.file.claim("recast.range") is not None
    for name, row in zip(context.z, context.form.to_form, strict=True):
        if range_claimed and row.text.lstrip("-") not in context.plant.states:
            continue
        boxes += covered(narrowed(context.plant.box, row.names), ".", ranged(row, *context.form.box[name]))
    return boxes


Value = TypeVar("Value")


def wanted_gain(context: Context, place: tuple[int, ...]) -> tuple[Quotient, Expression]:
    """Return the gain a_i of a chain, y = a_1 z_1 + c, z_(i-1)' = a_i z_i + .., as a quotient, and the form's
    expression in which it occurs; `place`: (i) in a single chain, or (k, i) in chain k. Raises: `Unproved`."""
    _ = context.equations
    chain, index = place if len(place) == 2 else (1, *place)
    at = place_of(context, chain, index)
    if index == 1:
        return context.first_gain(chain - 1), context.form.output[chain - 1]
    entry = context.form.A[at - 1][at]
    return context.value(entry), entry


def place_of(context: Context, chain: int, index: int) -> int:
    """Return the index, from 0, of a chain's state among all states; `chain` and its `index` in the chain count from 1.
    Raises: `Unproved`."""
    blocks = context.form.blocks
    if not (1 <= chain <= min(len(blocks), len(context.form.output)) and 1 <= index <= blocks[chain - 1]):
        raise Unproved("the form has no such row")
    return sum(blocks[: chain - 1]) + index - 1


def observer_of(context: Context, claim: Claim) -> Observer:
    """Return the observer of the file with its numbers; it must be the one that the claim's id names. Raises:
    `Unproved`."""
    observer, name = context.file.observer, claim.maker
    if observer is None or observer.name != name or not observer.numbers:
        raise Unproved(f"the file has no {name} observer with its numbers")
    return observer


@dataclass(frozen=True)
class Scale:
    """Coordinates S w of a chain of integrators w, S = diag(`units`) (n), with S_i w_i = `expressions`_i z_i. The
    expressions read parameters only; that they are finite and not zero is proved with `boxes` boxes."""

    units: list[Fraction]
    expressions: list[Expression]
    boxes: int


def integrators(context: Context, evidence: Mapping[str, Any]) -> Scale:
    """Return the coordinates (`Scale`) of the form's single chain in the evidence: its `scale` must be units_i a_1 ..
    a_i. Raises: `Unproved`."""
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
    """Return the texts as expressions, which must read parameters only. Raises: `Unproved`."""
    expressions = [expression(text, context.form.box) for text in texts]
    for text in expressions:
        demand_only(text.names, context.file.parameters, f"the constant {text.text}")
    return expressions


def invertible(context: Context, scale: Sequence[Expression]) -> int:
    """Demand that each entry of `scale` is finite and not zero on the form's box; return the number of boxes. Raises:
    `Unproved`."""
    box = context.form.box
    return sum(demand_finite(expression(f"1/({s.text})", box), box) for s in scale)


def steady(context: Context, gains: Sequence[Expression]) -> int:
    """Demand that A depends on no state, and that the observer's `gains` depend on parameters only and are finite;
    return the number of boxes. Raises: `Unproved`."""
    for entry in (entry for row in context.form.A for entry in row):
        demand_only(entry.names & set(context.z), (), "A")
    return sum(demand_finite(k, context.form.box) for k in constants(context, [k.text for k in gains]))


def gain_of(blocks: Sequence[int], entries: Sequence[Value], none: Value) -> list[list[Value]]:
    """Return the gain matrix (n, p) from the list of its entries: one for each state, which multiplies the output of
    the state's own chain, or one for each state and chain, state by state. `blocks`: the sizes of the chains; `none`:
    the entry elsewhere."""
    chain = [k for k, size in enumerate(blocks) for _ in range(size)]
    onto = [[k] for k in chain] if len(entries) == len(chain) else [[k for k, size in enumerate(blocks) if size]]
    columns, nonlinear = onto * (len(chain) // len(onto)), iter(entries)
    return [[next(nonlinear) if k in each else none for k in range(len(blocks))] for each in columns]


def core_of(context: Context, scale: Sequence[Expression], gains: Sequence[Expression], N: Matrix) -> Matrix:
    """Return N (n, n), for which S (A - K C) = N S is proved, S = diag(`scale`), K the `gains`. Raises: `Unproved`."""
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
    """Return the bound of |S db/dz S^-1|, S = diag(`scale`), that the evidence states and that is proved here, and the
    number of boxes; `norm`: the test of the bound. Raises: `Unproved`."""
    bound, _, boxes = _steepness(context, evidence, context.form.b, scale, norm)
    return bound, boxes


def jacobian_bound(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Finding:
    """Return the finding that the spectral norm |d rows/dz| is at most the claim's bound; `name`: the Jacobian in
    words. Raises: `Unproved`."""
    _ = context.equations
    bound, box, boxes = _steepness(context, claim.evidence, rows)
    return Finding(f"|{name}| <= {printed(bound, 1)}{on_ranges(box)}", boxes)


def _steepness(
    context: Context,
    evidence: Mapping[str, Any],
    rows: Sequence[Expression],
    scale: Sequence[Expression] = (),
    norm: Norm = spectral,
) -> tuple[Fraction, Box, int]:
    box = declared_box(evidence, context.form.box, {name for read in (*rows, *scale) for name in read.names})
    bound = signless(evidence, "bound")
    demand_continuous(rows, context.z, box)
    return bound, box, covered(box, part(evidence, "tree", str), norm_at_most(rows, context.z, bound, scale, norm))


Verify = Callable[[Context, Claim], Finding]
Keys = tuple[str, ...]
STEEP: Keys = ("box", "bound", "tree")  # evidence of the bound of a slope
POINT: Keys = ("expression", "witness")
STRUCTURE = "{kind}.structure"  # the claim that a form is in chains


@dataclass(frozen=True)
class Rule:
    """A rule of the verification: which claims it accepts, and the function `verify`(context, claim) that returns the
    finding.

    `makers`, `facts`: the permitted parts of a claim's id before and after the dot (no maker: the form's kind); `rows`:
    the number of row numbers in the id by the kind of form, 0 for other kinds; `verdict`: of the claim; `kinds`: the
    kinds of form on which the rule holds, none for any; `keys`: the permitted parts of the evidence.

    `assumes`: the ids of the claims that the claim assumes; `turning`: further ones for a plant with periodic outputs,
    None if the rule does not hold there; `about`: the subject of the sentence. In these {maker} and {kind} are filled
    in.
    """

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
        """Return the ids of the claims that a claim on this kind of form assumes; `periodic`: whether the plant has
        periodic outputs. For a form carried to other coordinates the structure is no claim of its own, but is verified
        with each claim that assumes it."""
        assumed = (*self.assumes, *((self.turning or ()) if periodic else ()))
        return tuple(self.named(id, kind, claim) for id in assumed if id != STRUCTURE or kind not in CARRIED)

    def named(self, text: str, kind: str, claim: Claim) -> str:
        """Return a text of the rule with {maker} and {kind} filled in, the claim's maker and the form's kind."""
        return text.format(maker=claim.maker, kind=kind)

    def find(self, context: Context, claim: Claim) -> Finding:
        """Return the finding that verifies a claim, which the rule must accept. Raises: `Unproved`."""
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
    """The claims that a certificate of a form must contain, whatever their verdicts: the `structure`, and, if the
    structure is proved, the `others`."""

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
    """Return a rule for claims about the numbers of observers, named in `makers`, on forms of these `kinds`, or any;
    arguments as in `Rule`."""
    return Rule(makers, facts, verify, keys, kinds, assumes=assumes, about="the {maker} observer", turning=turning)


def chains_rule(
    makers: Keys, facts: Keys, verify: Verify, keys: Keys = (), *assumes: str, turning: Keys | None = None
) -> Rule:
    """Return a rule for claims about observers on chains of integrators, which assume the form's structure; arguments
    as in `Rule`."""
    return observer_rule(makers, facts, verify, keys, STRUCTURE, *assumes, kinds=ON_CHAINS, turning=turning)
