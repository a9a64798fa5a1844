"""A form in chains, for the claims about observers: its structure, its a_i, chains of integrators, and slopes.

z' = A(u) z + b(z, u),   y_i = a_1 z_1 + c of its chain:   A has a superdiagonal within each chain only
w_i = a_1 .. a_i z_i:   w_i' = w_(i+1) + c_i(w, u),   c_i = a_1 .. a_i b_i,   y = w_1 + o(u)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from .algebra import Quotient
from .box import Box, NotShown, covered, ranged
from .context import Context, Shown, declared_box, finite, narrowed, on, only, short
from .file import Claim, FormFile, Observer, column, entries, part, signless
from .matrix import Matrix
from .slope import Norm, continuous, spectral, steep
from .text import Expression, expression

CHAINS = ("triangular", "block_triangular")
CARRIED = ("phase", "uniform_chain")  # of one output, whose states are maps of the plant's
ON_CHAINS = (*CHAINS, *CARRIED)


def structure(context: Context, claim: Claim) -> Shown:
    """Shows that A has a superdiagonal within each chain only, which reads no state (but z_1 where there is one chain),
    that b reads what the alignment lets it, and that y_i = a_1 z_1 + c of its chain, where a_1 and c read no state.

    Of an output whose chain has no states nothing is asked: an observer takes it for a measurement of the first state
    of a chain where it is a constant multiple of that one's output, and a gain acts on no other."""
    form, z = context.form, context.z
    several = form.kind == "block_triangular"
    if len(form.blocks) != len(form.output) or not (several or len(form.blocks) == 1):
        raise NotShown("it has not one chain for each output")
    if form.alignment not in (("top", "end", "cascade") if several else ("",)):
        raise NotShown(f"{form.alignment!r} is no alignment of its chains")
    _ = context.equations
    places = tuple((k, level) for k, size in enumerate(form.blocks) for level in range(1, size + 1))
    for i, row in enumerate(form.A):
        for j, entry in enumerate(row):
            if j == i + 1 and places[j][0] == places[i][0]:
                only(entry.names & set(z), () if several else z[:1], f"A[{i + 1},{j + 1}]")
            elif not context.algebra.is_zero(context.value(entry)):
                raise NotShown(f"A[{i + 1},{j + 1}] is not zero")
    for i, rest in enumerate(form.b):
        allowed = [z[j] for j in range(len(z)) if _readable(form, places[i], places[j])]
        only(rest.names & set(z), allowed, f"b_{i + 1}")
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
    return Shown(
        f"{chains}{varies}{f' ({form.alignment})' if several else ''}, and the form's equations are the plant's"
    )


def _readable(form: FormFile, reader: tuple[int, int], read: tuple[int, int]) -> bool:
    """Whether the row at (chain, level) may read the state at (chain, level)."""
    (i, level), (k, at) = reader, read
    if i == k:
        return at <= level
    if form.alignment == "top":
        return at <= level
    if form.alignment == "end":
        return at <= level + form.blocks[k] - form.blocks[i]
    return form.alignment == "cascade"


def _in_order(context: Context, places: Sequence[tuple[int, int]]) -> None:
    """A cascade: the chains have an order in which each reads only those before."""
    form = context.form
    if form.alignment != "cascade":
        return
    chain = {name: k for name, (k, _) in zip(context.z, places, strict=True)}
    reads: dict[int, set[int]] = {k: {k} for k in range(len(form.blocks))}
    for rest, (k, _) in zip(form.b, places, strict=True):
        reads[k] |= {chain[name] for name in rest.names if name in chain}
    done: set[int] = set()
    while len(done) < len(reads):
        ready = {k for k, others in reads.items() if k not in done and others <= done | {k}}
        if not ready:
            raise NotShown("its chains read each other in a circle")
        done |= ready


def ranges_kept(context: Context, every: bool = False) -> int:
    """Shows that the form's states stay in their ranges while the plant's do, and returns the number of boxes. Where a
    state is none of the plant's, this may be a claim of its own, unless `every` one is asked for."""
    boxes = 0
    range_claimed = not every and context.file.claim("recast.range") is not None
    for name, row in zip(context.z, context.form.to_form, strict=True):
        if range_claimed and row.text.lstrip("-") not in context.plant.states:
            continue
        boxes += covered(narrowed(context.plant.box, row.names), ".", ranged(row, *context.form.box[name]))
    return boxes


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
    """The one chain in coordinates S w: the claim's `scale` is units_i a_1 .. a_i, constant in time. Raises:
    `NotShown`."""
    _ = context.equations
    n, algebra, product = len(context.z), context.algebra, context.algebra.one
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
    column, K = {z: k for k, z in enumerate(context.heads)}, gain_of(form.blocks, entries, algebra.zero)
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
    Raises: `NotShown`."""
    bound, _, boxes = _steepness(context, evidence, context.form.b, scale, norm)
    return bound, boxes


def jacobian_bound(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Shown:
    """|d rows/dz| <= the claim's bound in the spectral norm, on the form's box. Raises: `NotShown`."""
    _ = context.equations
    bound, box, boxes = _steepness(context, claim.evidence, rows)
    return Shown(f"|{name}| <= {short(bound, 1)}{on(box)}", boxes)


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
