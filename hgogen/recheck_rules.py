"""What each claim of a certificate needs: the rules by which it is verified against the certificate's own model.

A rule takes what has to be shown from the plant and the form, never from the claim: the claim adds bounds, a bisection
or a witness. Every rule first shows that the form is the plant:

    dX/dz (A z + b) = f(X(z), u),   h(X(z), u) = output,   Z(X(z)) = z       as rational functions, X = from_form

Source of the hypotheses: Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3).
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from hgogen.recheck_algebra import Algebra, Quotient
from hgogen.recheck_arithmetic import Dual, dual, evaluate
from hgogen.recheck_box import Box, NotShown, covered, ranged, regular, steep, witnessed
from hgogen.recheck_file import Certificate, Claim, ends, part
from hgogen.recheck_text import Expression, expression, number


@dataclass(frozen=True)
class Shown:
    """What a rule showed, as a sentence, and with how many boxes."""

    sentence: str
    boxes: int = 0


class Context:
    """A certificate with its exact algebra, and what has been shown of it."""

    def __init__(self, certificate: Certificate) -> None:
        self.file = certificate
        self.form, self.plant = certificate.form, certificate.plant
        self.z = self.form.states
        self.algebra = _algebra(self.form.box)

    @cached_property
    def letters(self) -> dict[str, Quotient]:
        """The form's names as letters, fixed parameters as their numbers."""
        return _letters(self.algebra, self.form.box)

    def value(self, text: Expression) -> Quotient:
        """An expression of the form's names."""
        return _value(text, self.letters, self.algebra)

    @cached_property
    def equations(self) -> Shown:
        """The form is the plant, by exact algebra. Raises: `NotShown`."""
        algebra, form, plant = self.algebra, self.form, self.plant
        z = self.letters
        for change in (*form.to_form, *form.from_form):
            _only(change.names & set(self.file.inputs), (), "the change of coordinates")
        rates = [self.value(row) for row in form.b]
        for i, row in enumerate(form.A):
            for j, entry in enumerate(row):
                rates[i] = rates[i] + self.value(entry) * z[form.states[j]]
        moving = {name: Dual(z[name], {0: rates[form.states.index(name)]} if name in form.states else {}) for name in z}
        images = [evaluate(inverse, moving, dual(algebra.arithmetic)) for inverse in form.from_form]
        x = {**z, **{name: image.value for name, image in zip(plant.states, images, strict=True)}}
        for name, flow, image in zip(plant.states, plant.flow, images, strict=True):
            speed = image.slopes.get(0, algebra.number(Fraction(0)))
            self._same(_value(flow, x, algebra), speed, f"{name}' of the form is not the plant's")
        for given, output in zip(plant.output, form.output, strict=True):
            self._same(_value(given, x, algebra), self.value(output), "the form's output is not the plant's")
        for name, forward in zip(form.states, form.to_form, strict=True):
            self._same(_value(forward, x, algebra), z[name], f"{name} is not undone by the inverse")
        return Shown("the form's equations are the plant's")

    @cached_property
    def rates(self) -> tuple[Expression, ...]:
        """A z + b, row by row."""
        form = self.form
        terms = (
            [f"({entry.text})*{name}" for entry, name in zip(row, form.states, strict=True) if entry.text != "0"]
            for row in form.A
        )
        return tuple(
            expression(" + ".join((f"({rest.text})", *row)), form.box) for rest, row in zip(form.b, terms, strict=True)
        )

    def _same(self, a: Quotient, b: Quotient, complaint: str) -> None:
        if not self.algebra.is_zero(a - b):
            raise NotShown(complaint)

    def same(self, text: Expression, wanted: Quotient, complaint: str) -> None:
        """That an expression of the file is what has to be shown."""
        self._same(self.value(text), wanted, complaint)

    @cached_property
    def first_gain(self) -> Quotient:
        """a_1 = dy/dz_1. That y(z_1) - y(0) = z_1 dy/dz_1 for every z_1 makes it the same for every z_1.

        Raises: `NotShown`.
        """
        first, output = self.z[0], self.form.output[0]
        slope = self.slope(output, first)
        rest = _value(output, {**self.letters, first: self.algebra.number(Fraction(0))}, self.algebra)
        self._same(self.value(output) - rest, slope * self.letters[first], f"the output is not linear in {first}")
        return slope

    def slope(self, text: Expression, name: str) -> Quotient:
        """A partial derivative, in closed form."""
        one, zero = self.algebra.number(Fraction(1)), self.algebra.number(Fraction(0))
        values = {other: Dual(letter, {0: one} if other == name else {}) for other, letter in self.letters.items()}
        found: Quotient = evaluate(text, values, dual(self.algebra.arithmetic)).slopes.get(0, zero)
        return found


def _algebra(box: Box) -> Algebra:
    free = [name for name, (low, high) in box.items() if low < high]
    return Algebra(free, [name for name in free if box[name][0] >= 0])


def _letters(algebra: Algebra, box: Box) -> dict[str, Quotient]:
    return {
        name: algebra.letter(name) if low < high else algebra.number(Fraction(low)) for name, (low, high) in box.items()
    }


def _value(text: Expression, values: Mapping[str, Quotient], algebra: Algebra) -> Quotient:
    found: Quotient = evaluate(text, values, algebra.arithmetic)
    return found


# --- pieces of rules


def _only(names: Iterable[str], allowed: Iterable[str], complaint: str) -> None:
    strange = sorted(set(names) - set(allowed))
    if strange:
        raise NotShown(f"{complaint} reads {', '.join(strange)}")


def _narrowed(box: Box, names: Iterable[str]) -> Box:
    return {name: box[name] for name in sorted(names)}


def _declared_box(evidence: Mapping[str, Any], box: Box, names: Iterable[str]) -> Box:
    """The model's box of these names; the claim's own must be the same."""
    wanted = _narrowed(box, names)
    given = part(evidence, "box", dict)
    found = {name: ends(*_pair(pair), name) for name, pair in sorted(given.items())}
    if found != wanted:
        raise NotShown("its box is not the model's ranges of the names it reads")
    return wanted


def _pair(value: object) -> tuple[object, object]:
    if not isinstance(value, list) or len(value) != 2:
        raise NotShown("a range of its box has not two ends")
    return value[0], value[1]


def _range(context: Context, claim: Claim, wanted: Quotient, source: Expression) -> tuple[Fraction, Fraction, Shown]:
    """The claim's enclosure low <= e <= high of what has to be shown, on the model's box."""
    evidence = claim.evidence
    text = expression(part(evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    low, high = number(evidence.get("low")), number(evidence.get("high"))
    box = _declared_box(evidence, context.form.box, text.names)
    boxes = covered(box, part(evidence, "tree", str), ranged(text, low, high))
    if text.text != source.text:  # the form's own expression is defined there, too
        boxes += covered(_narrowed(context.form.box, source.names), ".", ranged(source, -math.inf, math.inf))
    return low, high, Shown(f"{_short(low)} <= {_cut(text.text)} <= {_short(high)}{_on(box)}", boxes)


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def _short(value: Fraction) -> str:
    text = str(value)
    return text if len(text) <= 12 else f"{float(value):.6g}"


def _on(box: Box) -> str:
    named = [f"{name} in [{low}, {high}]" for name, (low, high) in box.items() if low < high]
    return f" on {', '.join(named)}" if named else ""


# --- rules


def _structure(context: Context, claim: Claim, index: int) -> Shown:
    """A has a superdiagonal free of the states only, b_i reads z_1..z_i, y = a_1 z_1 + c."""
    form, z = context.form, context.z
    _ = context.equations
    for i, row in enumerate(form.A):
        for j, entry in enumerate(row):
            if j == i + 1:
                _only(entry.names & set(z), (), f"A[{i + 1},{j + 1}]")
            elif not context.algebra.is_zero(context.value(entry)):
                raise NotShown(f"A[{i + 1},{j + 1}] is not zero")
        _only(form.b[i].names & set(z), z[: i + 1], f"b_{i + 1}")
    if len(form.output) != 1:
        raise NotShown("the triangular form has one output")
    _only(form.output[0].names & set(z), z[:1], "the output")
    _ = context.first_gain
    _ranges(context)
    return Shown(f"{' -> '.join(('y', *z))}, and the form's equations are the plant's")


def _ranges(context: Context) -> int:
    """The form's states keep to their ranges while the plant's do."""
    boxes = 0
    if any(claim.id == "recast.range" for claim in context.file.claims):
        return boxes
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = _narrowed(context.plant.box, row.names)
        boxes += covered(box, ".", ranged(row, *context.form.box[name]))
    return boxes


def _gain(context: Context, claim: Claim, index: int) -> Shown:
    """0 < a_m <= a_i <= a_M on the box."""
    wanted, source = _wanted_gain(context, index)
    low, _, shown = _range(context, claim, wanted, source)
    if low <= 0:
        raise NotShown("its lower bound is not above zero")
    return Shown(f"a_{index}: {shown.sentence}", shown.boxes)


def _wanted_gain(context: Context, index: int) -> tuple[Quotient, Expression]:
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    if index == 1:
        return context.first_gain, context.form.output[0]
    entry = context.form.A[index - 2][index - 1]
    return context.value(entry), entry


def _offset(context: Context, claim: Claim, index: int) -> Shown:
    """c = y - a_1 z_1 is finite on the box."""
    _ = context.equations
    rest = context.value(context.form.output[0]) - context.first_gain * context.letters[context.z[0]]
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    _only(text.names & set(context.z), (), "the offset")
    return _range(context, claim, rest, text)[2]


def _lipschitz(context: Context, claim: Claim, index: int) -> Shown:
    """|db/dz| <= bound in the spectral norm, on the box."""
    return _steep(context, claim, context.form.b, "db/dz")


def _steep(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Shown:
    _ = context.equations
    names = {read for row in rows for read in row.names}
    box = _declared_box(claim.evidence, context.form.box, names)
    bound = number(claim.evidence.get("bound"))
    if bound < 0:
        raise NotShown("its bound is negative")
    boxes = covered(box, part(claim.evidence, "tree", str), steep(rows, context.z, bound))
    return Shown(f"|{name}| <= {_short(bound)}{_on(box)}", boxes)


def _uniform_structure(context: Context, claim: Claim, index: int) -> Shown:
    """F_i reads z_1..z_(i+1), y reads z_1."""
    _ = context.equations
    z = context.z
    for i, row in enumerate(context.rates):
        _only(row.names & set(z), z[: i + 2], f"F_{i + 1}")
    if len(context.form.output) != 1:
        raise NotShown("the uniform form has one output")
    _only(context.form.output[0].names & set(z), z[:1], "the output")
    _ranges(context)
    return Shown(f"{' -> '.join(('y', *z))}, and the form's equations are the plant's")


def _uniform_slope(context: Context, claim: Claim, index: int) -> Shown:
    """dh/dz_1, or dF_(i-1)/dz_i, is bounded and bounded away from zero on the box."""
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    row = context.form.output[0] if index == 1 else context.rates[index - 2]
    low, high, shown = _range(context, claim, context.slope(row, context.z[index - 1]), row)
    if low <= 0 <= high:
        raise NotShown("its bounds do not keep clear of zero")
    return Shown(f"slope {index}: {shown.sentence}", shown.boxes)


def _uniform_lipschitz(context: Context, claim: Claim, index: int) -> Shown:
    """|d(F, h)/dz| <= bound in the spectral norm, on the box."""
    return _steep(context, claim, (*context.rates, *context.form.output), "d(F, h)/dz")


def _inverse(context: Context, claim: Claim, index: int) -> Shown:
    """z = Z(x) and x = X(z) undo each other and have finite derivatives on their boxes."""
    _ = context.equations
    form, plant = context.form, context.plant
    algebra = _algebra(plant.box)
    x = _letters(algebra, plant.box)
    z = {**x, **{name: _value(row, x, algebra) for name, row in zip(form.states, form.to_form, strict=True)}}
    for name, row in zip(plant.states, form.from_form, strict=True):
        if not algebra.is_zero(_value(row, z, algebra) - x[name]):
            raise NotShown(f"{name} is not undone by the change of coordinates")
    boxes = _regular(form.to_form, plant.states, plant.box) + _regular(form.from_form, form.states, form.box)
    return Shown("the change of coordinates and its inverse are smooth and undo each other", boxes)


def _regular(rows: Sequence[Expression], names: Sequence[str], box: Box) -> int:
    read = {name for row in rows for name in row.names}
    return covered(_narrowed(box, read), ".", regular(rows, [name for name in names if name in read]))


def _range_of_recast(context: Context, claim: Claim, index: int) -> Shown:
    """Each z_i keeps to its range while the plant's states do."""
    boxes = 0
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = _narrowed(context.plant.box, row.names)
        boxes += covered(box, ".", ranged(row, *context.form.box[name]))
    return Shown("the form's states keep to their ranges while the plant's do", boxes)


def _no_gain(context: Context, claim: Claim, index: int) -> Shown:
    """At a point of the box a_i is zero, negative or undefined."""
    wanted, source = _wanted_gain(context, index)
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    at = _witness(claim, context.form.box, text.names | source.names)
    what = witnessed(text, at)
    if what not in ("zero", "negative", "undefined"):
        raise NotShown(f"{text.text} is not shown to be zero, negative or undefined at its witness")
    return Shown(f"{text.text} is {what} at {', '.join(f'{name} = {value}' for name, value in at.items())}")


def _witness(claim: Claim, box: Box, names: Iterable[str]) -> dict[str, Fraction]:
    given = part(claim.evidence, "witness", dict)
    at = {name: number(value) for name, value in sorted(given.items())}
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


Rule = Callable[[Context, Claim, int], Shown]
# By kind of the form, "*" for any: the claim's id (with the row it counts) and verdict.
RULES: tuple[tuple[str, str, str, Rule], ...] = (
    ("triangular", r"triangular\.structure", "proved", _structure),
    ("triangular", r"triangular\.a_(\d{1,4})", "proved", _gain),
    ("triangular", r"triangular\.a_(\d{1,4})", "refuted", _no_gain),
    ("triangular", r"triangular\.offset", "proved", _offset),
    ("triangular", r"triangular\.lipschitz", "proved", _lipschitz),
    ("uniform", r"uniform\.structure", "proved", _uniform_structure),
    ("uniform", r"uniform\.slope_(\d{1,4})", "proved", _uniform_slope),
    ("uniform", r"uniform\.lipschitz", "proved", _uniform_lipschitz),
    ("*", r"recast\.inverse", "proved", _inverse),
    ("*", r"recast\.range", "proved", _range_of_recast),
)


def rule(kind: str, claim: Claim) -> tuple[Rule, int] | None:
    """The rule of a claim, and the row that its id counts (0 without one)."""
    for of, pattern, verdict, found in RULES:
        match = re.fullmatch(pattern, claim.id, re.ASCII)
        if match and verdict == claim.verdict and of in ("*", kind):
            return found, int(match.group(1)) if match.groups() else 0
    return None


def required(certificate: Certificate) -> tuple[str, ...]:
    """The ids of the claims that a certificate of this form cannot leave out, whatever their verdicts: its structure,
    and what a form of proved structure needs beside."""
    kind, count = certificate.form.kind, len(certificate.form.states)
    row = {"triangular": "a", "uniform": "slope"}.get(kind)
    if row is None:
        return ()
    structure = f"{kind}.structure"
    if not any(claim.id == structure and claim.verdict == "proved" for claim in certificate.claims):
        return (structure,)
    return (structure, *(f"{kind}.{row}_{i}" for i in range(1, count + 1)), f"{kind}.lipschitz")
