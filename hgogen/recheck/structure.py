"""The structure of a form in chains.

z' = A(u) z + b(z, u),   y_i = a_1 z_1 + c of its chain:   A has a superdiagonal within each chain only
"""

from collections.abc import Sequence

from .box import NotShown, covered, ranged
from .context import Context, Shown, narrowed, only
from .file import Claim, FormFile

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
    for i, entries in enumerate(form.A):
        for j, entry in enumerate(entries):
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
    reads = {name for entries in form.A for entry in entries for name in entry.names}
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


def ranges_kept(context: Context) -> int:
    """Shows that the form's states stay in their ranges while the plant's do, and returns the number of boxes. Where a
    state is none of the plant's, this may be a claim of its own."""
    boxes = 0
    range_claimed = any(claim.id == "recast.range" for claim in context.file.claims)
    for name, row in zip(context.z, context.form.to_form, strict=True):
        if range_claimed and row.text.lstrip("-") not in context.plant.states:
            continue
        boxes += covered(narrowed(context.plant.box, row.names), ".", ranged(row, *context.form.box[name]))
    return boxes
