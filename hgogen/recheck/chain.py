"""The plant as chains, for the claims about observers: the a_i of a form, chains of integrators, and slopes.

w_i = a_1 .. a_i z_i:   w_i' = w_(i+1) + c_i(w, u),   c_i = a_1 .. a_i b_i,   y = w_1 + o(u)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from .algebra import Quotient
from .box import NotShown, covered
from .context import Context, Shown, declared_box, finite, on, only, short
from .file import Claim, Observer, part
from .matrix import Matrix, column, entries, scalar
from .rule import STEEP, STRUCTURE, Keys, Rule, of_observer
from .slope import Norm, continuous, spectral, steep
from .structure import CARRIED
from .text import Expression, expression

Value = TypeVar("Value")


def wanted_gain(context: Context, place: tuple[int, ...]) -> tuple[Quotient, Expression]:
    """a_i of the one chain, or a_(k,i) of chain k, and the expression that it stands in. Raises: `NotShown`."""
    _ = context.equations
    chain, index = place if len(place) == 2 else (1, *place)
    at = place_of(context, chain, index)
    if index == 1:
        return context.first_gain(chain - 1), context.form.output[chain - 1]
    entry = context.form.A[at - 1][at]
    return context.value(entry), entry


def place_of(context: Context, chain: int, index: int) -> int:
    """The row of a chain's state, from 0. Raises: `NotShown`."""
    blocks = context.form.blocks
    if not (1 <= chain <= min(len(blocks), len(context.form.output)) and 1 <= index <= blocks[chain - 1]):
        raise NotShown("the form has no such row")
    return sum(blocks[: chain - 1]) + index - 1


def built(context: Context, claim: Claim) -> Observer:
    """The file's observer with its numbers, which the claim's id names. Raises: `NotShown`."""
    observer, name = context.file.observer, claim.maker
    if observer is None or observer.name != name or not observer.numbers:
        raise NotShown(f"the file has no {name} observer with its numbers")
    return observer


@dataclass(frozen=True)
class Scale:
    """Coordinates S w of integrators, S = diag(`units`): `expressions` of parameters, from z to them; with how many
    boxes they were shown to be finite and not zero."""

    units: list[Fraction]
    expressions: list[Expression]
    boxes: int


def integrators(context: Context, evidence: Mapping[str, Any]) -> Scale:
    """The one chain in coordinates S w: the claim's `scale` is units_i a_1 .. a_i, constant in time.

    Raises: `NotShown`.
    """
    _ = context.equations
    n, algebra, product = len(context.z), context.algebra, context.algebra.number(Fraction(1))
    if len(context.form.blocks) != 1:
        raise NotShown("the form is not one chain")
    units, scale = column(evidence, "units", n), constants(context, entries(evidence, "scale", n))
    for i, (unit, text) in enumerate(zip(units, scale, strict=True), 1):
        product = product * wanted_gain(context, (i,))[0]
        context.same(text, algebra.number(unit) * product, f"its scale {text.text} is not that of w_{i}")
        if unit <= 0:
            raise NotShown("its units are not positive")
    return Scale(units, scale, invertible(context, scale))


def constants(context: Context, texts: Sequence[Any]) -> list[Expression]:
    """The texts as expressions, which read parameters alone. Raises: `NotShown`."""
    expressions = [expression(text, context.form.box) for text in texts]
    for text in expressions:
        only(text.names, context.file.parameters, f"the constant {text.text}")
    return expressions


def invertible(context: Context, scale: Sequence[Expression]) -> int:
    """That each is finite and not zero on its box; with how many boxes. Raises: `NotShown`."""
    box = context.form.box
    return sum(finite(expression(f"1/({s.text})", box), box) for s in scale)


def steady(context: Context, gains: Sequence[Expression]) -> int:
    """That A reads no state, and that the gains of an observer read parameters alone and are finite whatever these are;
    with how many boxes. Raises: `NotShown`."""
    for entry in (entry for row in context.form.A for entry in row):
        only(entry.names & set(context.z), (), "A")
    return sum(finite(k, context.form.box) for k in constants(context, [k.text for k in gains]))


def gain_of(blocks: Sequence[int], entries: Sequence[Value], none: Value) -> list[list[Value]]:
    """The gain (n, p) of its entries: one for each state, which acts on the output of the state's own chain, or one for
    each state and chain, state by state; `none` elsewhere."""
    chain = [k for k, size in enumerate(blocks) for _ in range(size)]
    onto = [[k] for k in chain] if len(entries) == len(chain) else [[k for k, size in enumerate(blocks) if size]]
    columns, rest = onto * (len(chain) // len(onto)), iter(entries)
    return [[next(rest) if k in each else none for k in range(len(blocks))] for each in columns]


def core_of(context: Context, scale: Sequence[Expression], gains: Sequence[Expression], N: Matrix) -> Matrix:
    """N, with S (A - K C) = N S whatever the parameters. Raises: `NotShown`."""
    algebra, form = context.algebra, context.form
    S, entries = ([context.value(text) for text in texts] for texts in (scale, gains))
    column, K = {z: k for k, z in enumerate(context.heads)}, gain_of(form.blocks, entries, algebra.number(Fraction(0)))
    for i, row in enumerate(form.A):
        for j, text in enumerate(row):
            entry, at = context.value(text), column.get(context.z[j])
            if at is not None:
                entry = entry - K[i][at] * context.first_gain(at)
            if not algebra.is_zero(S[i] * entry - algebra.number(N[i][j]) * S[j]):
                raise NotShown(f"its core[{i + 1},{j + 1}] is not that of S (A - K C) S^-1")
    return N


def slope(
    context: Context, evidence: Mapping[str, Any], scale: Sequence[Expression], norm: Norm = spectral
) -> tuple[Fraction, int]:
    """The claim's bound of |S db/dz S^-1| on the box, S the diagonal `scale`, and with how many boxes it is shown.

    Raises: `NotShown`.
    """
    rows = context.form.b
    where = declared_box(evidence, context.form.box, {name for read in (*rows, *scale) for name in read.names})
    bound = scalar(evidence, "bound")
    if bound < 0:
        raise NotShown("its bound is negative")
    continuous(rows, context.z, where)
    return bound, covered(where, part(evidence, "tree", str), steep(rows, context.z, bound, scale, norm))


def jacobian_bound(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Shown:
    """|d rows/dz| <= the claim's bound in the spectral norm, on the form's box. Raises: `NotShown`."""
    _ = context.equations
    names = {read for row in rows for read in row.names}
    box = declared_box(claim.evidence, context.form.box, names)
    bound = scalar(claim.evidence, "bound")
    if bound < 0:
        raise NotShown("its bound is negative")
    continuous(rows, context.z, box)
    boxes = covered(box, part(claim.evidence, "tree", str), steep(rows, context.z, bound))
    return Shown(f"|{name}| <= {short(bound, 1)}{on(box)}", boxes)


def clamped(makers: Keys) -> Rule:
    """The rule of |db/dz| <= bound on the whole box of z of a form in other coordinates, to which observers clamp the
    argument of b."""
    return of_observer(makers, ("lipschitz",), _steep, STEEP, STRUCTURE, kinds=CARRIED)


def _steep(context: Context, claim: Claim) -> Shown:
    return jacobian_bound(context, claim, context.form.b, "db/dz")
