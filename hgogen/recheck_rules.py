"""What each claim of a certificate needs: the rules by which it is verified against the certificate's own model.

A rule takes what has to be shown from the plant and the form, never from the claim: the claim adds bounds, a bisection
or a witness. Source of the hypotheses: Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3).
"""

import re
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction

from hgogen.recheck_algebra import Quotient
from hgogen.recheck_box import Box, NotShown, covered, ranged, regular, steep, witnessed
from hgogen.recheck_context import (
    Context,
    Shown,
    algebra_of,
    declared_box,
    enclosed,
    letters_of,
    narrowed,
    on,
    only,
    short,
    value_of,
)
from hgogen.recheck_file import Certificate, Claim, part
from hgogen.recheck_text import Expression, expression, number


def _structure(context: Context, claim: Claim, index: int) -> Shown:
    """A has a superdiagonal only, of no state but z_1; b_i reads z_1..z_i, y = a_1 z_1 + c, a_1 and c of no state."""
    form, z = context.form, context.z
    reads = {name for row in form.A for entry in row for name in entry.names}
    _ = context.equations
    for i, row in enumerate(form.A):
        for j, entry in enumerate(row):
            if j == i + 1:
                only(entry.names & set(z), z[:1], f"A[{i + 1},{j + 1}]")
            elif not context.algebra.is_zero(context.value(entry)):
                raise NotShown(f"A[{i + 1},{j + 1}] is not zero")
        only(form.b[i].names & set(z), z[: i + 1], f"b_{i + 1}")
    if len(form.output) != 1:
        raise NotShown("the triangular form has one output")
    only(form.output[0].names & set(z), z[:1], "the output")
    _ = context.first_gain
    _ranges(context)
    varies = f", gains vary with the measured {z[0]}" if z[0] in reads else ""
    return Shown(f"{' -> '.join(('y', *z))}{varies}, and the form's equations are the plant's")


def _ranges(context: Context) -> int:
    """The form's states keep to their ranges while the plant's do."""
    boxes = 0
    if any(claim.id == "recast.range" for claim in context.file.claims):
        return boxes
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = narrowed(context.plant.box, row.names)
        boxes += covered(box, ".", ranged(row, *context.form.box[name]))
    return boxes


def _gain(context: Context, claim: Claim, index: int) -> Shown:
    """0 < a_m <= a_i <= a_M on the box."""
    wanted, source = _wanted_gain(context, index)
    low, _, shown = enclosed(context, claim, wanted, source)
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
    only(text.names & set(context.z), (), "the offset")
    return enclosed(context, claim, rest, text)[2]


def _lipschitz(context: Context, claim: Claim, index: int) -> Shown:
    """|db/dz| <= bound in the spectral norm, on the box."""
    return _steep(context, claim, context.form.b, "db/dz")


def _steep(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Shown:
    _ = context.equations
    names = {read for row in rows for read in row.names}
    box = declared_box(claim.evidence, context.form.box, names)
    bound = number(claim.evidence.get("bound"))
    if bound < 0:
        raise NotShown("its bound is negative")
    boxes = covered(box, part(claim.evidence, "tree", str), steep(rows, context.z, bound))
    return Shown(f"|{name}| <= {short(bound)}{on(box)}", boxes)


def _uniform_structure(context: Context, claim: Claim, index: int) -> Shown:
    """F_i reads z_1..z_(i+1), y reads z_1."""
    _ = context.equations
    z = context.z
    for i, row in enumerate(context.rates):
        only(row.names & set(z), z[: i + 2], f"F_{i + 1}")
    if len(context.form.output) != 1:
        raise NotShown("the uniform form has one output")
    only(context.form.output[0].names & set(z), z[:1], "the output")
    _ranges(context)
    return Shown(f"{' -> '.join(('y', *z))}, and the form's equations are the plant's")


def _uniform_slope(context: Context, claim: Claim, index: int) -> Shown:
    """dh/dz_1, or dF_(i-1)/dz_i, is bounded and bounded away from zero on the box."""
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    row = context.form.output[0] if index == 1 else context.rates[index - 2]
    low, high, shown = enclosed(context, claim, context.slope(row, context.z[index - 1]), row)
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
    algebra = algebra_of(plant.box)
    x = letters_of(algebra, plant.box)
    z = {**x, **{name: value_of(row, x, algebra) for name, row in zip(form.states, form.to_form, strict=True)}}
    for name, row in zip(plant.states, form.from_form, strict=True):
        if not algebra.is_zero(value_of(row, z, algebra) - x[name]):
            raise NotShown(f"{name} is not undone by the change of coordinates")
    boxes = _regular(form.to_form, plant.states, plant.box) + _regular(form.from_form, form.states, form.box)
    return Shown("the change of coordinates and its inverse are smooth and undo each other", boxes)


def _regular(rows: Sequence[Expression], names: Sequence[str], box: Box) -> int:
    read = {name for row in rows for name in row.names}
    return covered(narrowed(box, read), ".", regular(rows, [name for name in names if name in read]))


def _range_of_recast(context: Context, claim: Claim, index: int) -> Shown:
    """Each z_i keeps to its range while the plant's states do."""
    boxes = 0
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = narrowed(context.plant.box, row.names)
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
