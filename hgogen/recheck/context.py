"""What a rule of a certificate works with: its exact algebra, and what has been shown of its form.

Every rule first shows that the form is the plant:

    dX/dz (A z + b) = f(X(z), u),   h(X(z), u) = output,   Z(X(z)) = z,   X(Z(x)) = x

as rational functions, X = from_form, Z = to_form, where every expression has a value on its whole box.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from decimal import Context as Digits
from fractions import Fraction
from functools import cached_property
from typing import Any

from .algebra import Algebra, Quotient, TooLarge
from .arithmetic import Undefined, along, total
from .box import Box, NotShown, covered, ranged
from .file import Certificate, Claim, NoCertificate, ends, fields, part, scalar
from .text import Expression, Unreadable, expression, number


@dataclass(frozen=True)
class Shown:
    """What a rule showed, as a sentence, and with how many boxes."""

    sentence: str
    boxes: int = 0


UNSHOWN = NotShown, Undefined, TooLarge, RecursionError, NoCertificate, Unreadable  # what a verification may end with


def reason_of(error: Exception) -> str:
    """The words for why a verification ended."""
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
    """A certificate with its exact algebra, and what has been shown of it."""

    def __init__(self, certificate: Certificate) -> None:
        self.file = certificate
        self.form, self.plant = certificate.form, certificate.plant
        self.z = self.form.states
        self.algebra = algebra_of(self.form.box)
        self.value = self.algebra.read  # of an expression of the form's names

    @property
    def equations(self) -> Shown:
        """The form is the plant, by exact algebra. Raises: `NotShown`."""
        if self.fault:
            raise NotShown(self.fault)
        return Shown("the form's equations are the plant's")

    @cached_property
    def fault(self) -> str:
        """Why the form is not shown to be the plant, or ""."""
        try:
            self._finite()
            self._flow()
        except UNSHOWN as error:
            return reason_of(error)
        return ""

    def _finite(self) -> None:
        """Every expression is a finite number on its whole box: an identity says nothing where a side has no value."""
        form, plant = self.form, self.plant
        if len(self.z) != len(plant.states):
            raise NotShown("the form has not as many states as the plant")
        rows = [*form.from_form, *form.b, *form.output, *(entry for row in form.A for entry in row)]
        for where, box, texts in (
            ("the plant", plant.box, (*plant.flow, *plant.output, *form.to_form)),
            ("the form", form.box, rows),
        ):
            for text in texts:
                try:
                    finite(text, box)
                except NotShown as error:
                    raise NotShown(f"{cut(text.text)} of {where} is not shown to be a finite number: {error}") from None

    def _flow(self) -> None:
        """Shows dX/dz (A z + b) = f(X(z), u), h(X(z), u) = output, Z(X(z)) = z and X(Z(x)) = x. Raises: `NotShown`."""
        algebra, form, plant, z = self.algebra, self.form, self.plant, self.algebra.names
        for change in (*form.to_form, *form.from_form):
            only(change.names & set(self.file.inputs), (), "the change of coordinates")
        rates = {
            name: total(
                (self.value(rest), *(self.value(entry) * z[other] for entry, other in zip(row, self.z, strict=True)))
            )
            for name, rest, row in zip(self.z, form.b, form.A, strict=True)
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
                raise NotShown(f"{name} is not undone by the change of coordinates")

    @cached_property
    def rates(self) -> tuple[Expression, ...]:
        """A z + b, row by row."""
        return self._rows(lambda entry: entry.text != "0")

    @cached_property
    def nonlinear(self) -> tuple[Expression, ...]:
        """b, with the terms of A z whose factor reads a state, row by row."""
        return self._rows(lambda entry: not entry.names.isdisjoint(self.z))

    def _rows(self, selects: Callable[[Expression], bool]) -> tuple[Expression, ...]:
        """b with those terms of A z whose entry of A `selects` takes, row by row."""
        terms = (
            [f"({entry.text})*{name}" for entry, name in zip(row, self.z, strict=True) if selects(entry)]
            for row in self.form.A
        )
        pairs = zip(self.form.b, terms, strict=True)
        return tuple(expression(" + ".join((f"({rest.text})", *row)), self.form.box) for rest, row in pairs)

    def _same(self, a: Quotient, b: Quotient, complaint: str) -> None:
        if not self.algebra.is_zero(a - b):
            raise NotShown(complaint)

    def same(self, text: Expression, wanted: Quotient, complaint: str) -> None:
        """That an expression of the file is what has to be shown."""
        self._same(self.value(text), wanted, complaint)

    def first_gain(self, chain: int) -> Quotient:
        """a_1 = dy/dz of an output, 0, 1, .., and the state z that it shows. That y(z) - y(0) = z dy/dz for every z
        makes it the same for every z. Raises: `NotShown`."""
        first, output = self.seen[chain], self.form.output[chain]
        slope, letters = self.slope(output, first), self.algebra.names
        rest = self.value(output, {**letters, first: self.algebra.zero})
        self._same(self.value(output) - rest, slope * letters[first], f"the output is not linear in {first}")
        return slope

    def output_slope(self, output: int) -> Fraction:
        """dy/dz of an output in the state z that it shows, a number other than 0. Raises: `NotShown`."""
        slope = self.first_gain(output).number
        if not slope:
            raise NotShown("the slope of an output is no number")
        return slope

    @property
    def heads(self) -> tuple[str, ...]:
        """The first state of each chain, "" of one without states."""
        blocks = self.form.blocks
        return tuple(self.z[sum(blocks[:i])] if size else "" for i, size in enumerate(blocks))

    @cached_property
    def seen(self) -> tuple[str, ...]:
        """The state that each output shows: the first of its chain, or that of another chain, by a slope that is a
        number as that chain's own is; "" of one of which neither is shown."""
        return tuple(own or self._shared(j) for j, own in enumerate(self.heads))

    def _shared(self, output: int) -> str:
        text = self.form.output[output]
        for own, z in zip(self.form.output, self.heads, strict=True):
            if z and text.names & set(self.z) == {z} and self.slope(text, z).number and self.slope(own, z).number:
                return z
        return ""

    def demand_seen(self, output: int) -> None:
        """That it is known how an error of an output enters. Raises: `NotShown`."""
        if not self.seen[output]:
            raise NotShown(f"output {output + 1} is not shown to show the first state of a chain")

    def slope(self, text: Expression, name: str) -> Quotient:
        """The partial derivative of an expression in a name, in closed form."""
        return self.algebra.speed(text, {name: self.algebra.one})


def algebra_of(box: Box) -> Algebra:
    """The algebra of a box's names; a name of one value is no letter."""
    free = [name for name, (low, high) in box.items() if low < high]
    fixed = {name: Fraction(low) for name, (low, high) in box.items() if low == high}
    return Algebra(free, [name for name in free if box[name][0] >= 0], fixed)


def numbers(rows: Iterable[Sequence[Quotient]]) -> list[list[Fraction]] | None:
    """The rows as numbers; None where an entry is written otherwise."""
    values = [[entry.number for entry in row] for row in rows]
    known = [[value for value in row if value is not None] for row in values]
    return known if known == values else None


def applied(algebra: Algebra, M: Iterable[Sequence[Fraction]], x: Sequence[Quotient]) -> list[Quotient]:
    """M x of numbers M."""
    return [inner(algebra, [algebra.number(a) for a in row], x) for row in M]


def inner(algebra: Algebra, a: Sequence[Quotient], x: Sequence[Quotient]) -> Quotient:
    """The sum of products."""
    products = (share * each for share, each in zip(a, x, strict=True) if share)
    return sum(products, start=algebra.zero)


# --- pieces of rules


def inside(low: Any, high: Any, share: Fraction) -> Fraction:
    """The point at a share of a range; of an unbounded one as far from its end, or from 0."""
    if low > -math.inf:
        return Fraction(low) + (share if high == math.inf else share * (Fraction(high) - Fraction(low)))
    return (Fraction(0) if high == math.inf else Fraction(high)) - share


_MOST = 40  # digits of a number in a sentence
RANGE = ("expression", "box", "low", "high", "tree")  # what the evidence of an enclosure has


def only(names: Iterable[str], allowed: Iterable[str], complaint: str) -> None:
    """That only allowed names are read. Raises: `NotShown`."""
    strange = sorted(set(names) - set(allowed))
    if strange:
        raise NotShown(f"{complaint} reads {', '.join(strange)}")


def narrowed(box: Box, names: Iterable[str]) -> Box:
    """The sides of a box that have these names, sorted."""
    return {name: box[name] for name in sorted(names)}


def finite(text: Expression, box: Box) -> int:
    """That an expression is a finite number on its whole box; with how many boxes. Raises: `NotShown`."""
    return covered(narrowed(box, text.names), ".", ranged(text, -math.inf, math.inf))


def declared_box(evidence: Mapping[str, Any], box: Box, names: Iterable[str]) -> Box:
    """The model's box of these names. The claim's own must be the same. Raises: `NotShown`."""
    wanted = narrowed(box, names)
    pairs = part(evidence, "box", dict)
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs.values()):
        raise NotShown("a range of its box has not two ends")
    if {name: ends(low, high, name) for name, (low, high) in sorted(pairs.items())} != wanted:
        raise NotShown("its box is not the model's ranges of the names it reads")
    return wanted


def claimed(context: Context, evidence: Mapping[str, Any], wanted: Quotient) -> Expression:
    """The evidence's expression, which is what has to be shown. Raises: `NotShown`."""
    text = expression(part(evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    return text


def enclosed(
    context: Context,
    evidence: Any,
    wanted: Quotient,
    source: Expression,
    read: Callable[[Expression], Expression] = lambda text: text,
) -> tuple[Fraction, Fraction, Shown]:
    """An enclosure low <= e <= high of what has to be shown, on the model's box; `read`: how its text is. Raises:
    `NotShown`."""
    text = claimed(context, fields(evidence, "a range", RANGE), wanted)
    low, high = scalar(evidence, "low"), scalar(evidence, "high")
    box = declared_box(evidence, context.form.box, text.names)
    boxes = covered(box, part(evidence, "tree", str), ranged(read(text), low, high))
    if text.text != source.text:  # the form's own expression is defined there, too
        boxes += finite(source, context.form.box)
    return low, high, Shown(f"{short(low, -1)} <= {cut(text.text)} <= {short(high, 1)}{on(box)}", boxes)


def cut(text: str) -> str:
    """The beginning of a long text, for a sentence."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def short(value: Fraction, way: int = 0, digits: int = 6) -> str:
    """A number as a sentence prints it: rounded to so many digits where it is long, up for `way` 1, down for -1."""
    text = str(value)
    if len(text) <= 12:
        return text
    rounding = {1: ROUND_CEILING, 0: ROUND_HALF_EVEN, -1: ROUND_FLOOR}[way]
    rounded = Digits(prec=digits, rounding=rounding).divide(Decimal(value.numerator), Decimal(value.denominator))
    return f"{rounded:f}" if -4 <= rounded.adjusted() < digits else f"{rounded:e}"


def is_above(value: Fraction, bound: Fraction) -> str:
    """The words that a number is above a smaller one, in as many digits as it takes to tell them apart. Raises:
    `NotShown` where so many would be too many to read."""
    for digits in range(6, _MOST):
        high, low = short(value, -1, digits), short(bound, 1, digits)
        if Fraction(high) > Fraction(low):
            return f"{high} is above {low}"
    raise NotShown(f"{short(value)} is above {short(bound)} by less than {_MOST} digits tell")


def on(box: Box) -> str:
    """The sides of a box that are no points, for a sentence."""
    named = [f"{name} in [{low}, {high}]" for name, (low, high) in box.items() if low < high]
    return f" on {', '.join(named)}" if named else ""


def witness(claim: Claim, box: Box, names: Iterable[str], key: str = "witness") -> dict[str, Fraction]:
    """The claim's point in the box, with a value for each of `names`. Raises: `NotShown`."""
    coordinates = part(claim.evidence, key, dict)
    at = {name: number(value) for name, value in sorted(coordinates.items())}
    for name, value in at.items():
        if name not in box or not box[name][0] <= value <= box[name][1]:
            raise NotShown(f"its witness has {name} = {value}, outside the model's range")
    for name in names:
        low, high = box[name]
        if name not in at and low == high:
            at[name] = Fraction(low)
        if name not in at:
            raise NotShown(f"its witness does not say {name}")
    return at
