"""What each claim of a certificate needs: the rules by which it is verified against the certificate's own model.

A rule takes what has to be shown from the plant and the form, never from the claim: the claim adds bounds, a bisection
or a witness. Source of the hypotheses: Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3).
"""

import re
from collections.abc import Iterable, Sequence
from fractions import Fraction

from hgogen.recheck.algebra import Quotient
from hgogen.recheck.box import Box, NotShown, covered, ranged, witnessed
from hgogen.recheck.chain import place_of, wanted_gain
from hgogen.recheck.context import (
    RANGE,
    Context,
    Shown,
    declared_box,
    enclosed,
    finite,
    narrowed,
    on,
    only,
    short,
    value_of,
)
from hgogen.recheck.dissipation import inequality, is_positive, level
from hgogen.recheck.file import OBSERVERS, Certificate, Claim, FormFile, part
from hgogen.recheck.observers import OF_CHAINS, OF_NUMBERS, STEEP, Keys, Row, Rule
from hgogen.recheck.observers import rests as of_observer
from hgogen.recheck.persistence import persistent
from hgogen.recheck.phase import phases, rank
from hgogen.recheck.slope import at_kinks, differentiable, regular, steep
from hgogen.recheck.text import Expression, expression, number


def _structure(context: Context, claim: Claim, place: Row) -> Shown:
    """A has a superdiagonal within each chain only, of no state (but z_1 where there is one chain); b reads what the
    alignment lets it; y_i = a_1 z_1 + c of its chain, a_1 and c of no state."""
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
    for chain, output in enumerate(form.output):
        only(output.names & set(z), (context.heads[chain],), f"output {chain + 1}")
        _ = context.first_gain(chain)
    _ranges(context)
    reads = {name for entries in form.A for entry in entries for name in entry.names}
    varies = f", gains vary with the measured {z[0]}" if z[0] in reads else ""
    told = "; ".join(
        " -> ".join((f"y_{k + 1}" if several else "y", *(s for s, (at, _) in zip(z, places, strict=True) if at == k)))
        for k in range(len(form.blocks))
    )
    return Shown(f"{told}{varies}{f' ({form.alignment})' if several else ''}, and the form's equations are the plant's")


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


def _ranges(context: Context) -> int:
    """The form's states keep to their ranges while the plant's do; where they are other than the plant's states, this
    may be a claim of its own."""
    boxes = 0
    apart = any(claim.id == "recast.range" for claim in context.file.claims)
    for name, row in zip(context.z, context.form.to_form, strict=True):
        if apart and row.text.lstrip("-") not in context.plant.states:
            continue
        boxes += covered(narrowed(context.plant.box, row.names), ".", ranged(row, *context.form.box[name]))
    return boxes


def _gain(context: Context, claim: Claim, place: Row) -> Shown:
    """0 < a_m <= a_i <= a_M on the box."""
    wanted, source = wanted_gain(context, place)
    low, _, shown = enclosed(context, claim, wanted, source)
    if low <= 0:
        raise NotShown("its lower bound is not above zero")
    return Shown(f"{claim.id.partition('.')[2]}: {shown.sentence}", shown.boxes)


def _offset(context: Context, claim: Claim, place: Row) -> Shown:
    """c = y - a_1 z_1 is finite on the box."""
    _ = context.equations
    chain = place[0] if place else 1
    head = context.z[place_of(context, chain, 1)]
    rest = context.value(context.form.output[chain - 1]) - context.first_gain(chain - 1) * context.letters[head]
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    only(text.names & set(context.z), (), "the offset")
    return enclosed(context, claim, rest, text)[2]


def _lipschitz(context: Context, claim: Claim, place: Row) -> Shown:
    """|db/dz| <= bound in the spectral norm, on the box; b with the terms of A z whose factor reads a state."""
    return _steep(context, claim, context.nonlinear, "db/dz")


def _steep(context: Context, claim: Claim, rows: Sequence[Expression], name: str) -> Shown:
    _ = context.equations
    names = {read for row in rows for read in row.names}
    box = declared_box(claim.evidence, context.form.box, names)
    bound = number(claim.evidence.get("bound"))
    if bound < 0:
        raise NotShown("its bound is negative")
    boxes = covered(box, part(claim.evidence, "tree", str), steep(rows, context.z, bound))
    return Shown(f"|{name}| <= {short(bound, 1)}{on(box)}", boxes)


def _clamped(context: Context, claim: Claim, place: Row) -> Shown:
    """|db/dz| <= bound on the whole box of z, to which an observer clamps the argument of b."""
    return _steep(context, claim, context.form.b, "db/dz")


def _in_chain(rule: Rule) -> Rule:
    """A rule about the file's observer on a form that has no claim of its structure: it is shown with it."""

    def shown(context: Context, claim: Claim, place: Row) -> Shown:
        observer = context.file.observer
        if observer is None or observer.name != claim.id.partition(".")[0]:
            raise NotShown("the file's observer is another")
        _structure(context, claim, place)
        return rule(context, claim, place)

    return shown


def _uniform_structure(context: Context, claim: Claim, place: Row) -> Shown:
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


def _uniform_slope(context: Context, claim: Claim, place: Row) -> Shown:
    """dh/dz_1, or dF_(i-1)/dz_i, is bounded and bounded away from zero on the box."""
    wanted, rate = _wanted_slope(context, *place)
    low, high, shown = enclosed(context, claim, wanted, rate, lambda text: at_kinks(text, rate, context))
    if low <= 0 <= high:
        raise NotShown("its bounds do not keep clear of zero")
    return Shown(f"{claim.id.partition('.')[2]}: {shown.sentence}", shown.boxes)


def _wanted_slope(context: Context, index: int) -> tuple[Quotient, Expression]:
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise NotShown("the form has no such row")
    rate = context.form.output[0] if index == 1 else context.rates[index - 2]
    return context.slope(rate, context.z[index - 1]), rate


def _no_slope(context: Context, claim: Claim, place: Row) -> Shown:
    """A slope is zero at a point of the box that is at no kink; or it has opposite signs at two, and what it is of is
    continuous."""
    wanted, rate = _wanted_slope(context, *place)
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    keys = [key for key in ("witness", "other") if key in claim.evidence]
    read = at_kinks(text, rate, context)
    signs = [witnessed(read, _witness(claim, context.form.box, text.names, key)) for key in keys]
    if signs == ["zero"]:
        differentiable((rate, text), _witness(claim, context.form.box, text.names | rate.names))
        return Shown(f"{text.text} is zero at its witness")
    if sorted(signs) != ["negative", "positive"]:
        raise NotShown(f"{text.text} is not shown to be zero, or to change its sign")
    if any(step.op == "sign" for step in rate.instructions):
        raise NotShown(f"{rate.text} is not shown to be continuous")
    boxes = finite(text, context.form.box) + finite(rate, context.form.box)
    return Shown(f"{text.text} changes its sign", boxes)


def _uniform_lipschitz(context: Context, claim: Claim, place: Row) -> Shown:
    """|d(F, h)/dz| <= bound in the spectral norm, on the box."""
    return _steep(context, claim, (*context.rates, *context.form.output), "d(F, h)/dz")


def _affine_structure(context: Context, claim: Claim, place: Row) -> Shown:
    """y = d + sum c_k z_k with d = y(0), c_k = y(z_k = 1) - y(0) for every z, so that both are of no state; A, b read
    states that an output shows alone, with a number for c_k."""
    _ = context.equations
    z, measured = context.z, list[str]()
    zero, one = context.algebra.number(Fraction(0)), context.algebra.number(Fraction(1))
    rest = {**context.letters, **dict.fromkeys(z, zero)}
    for j, output in enumerate(context.form.output, 1):
        d = value_of(output, rest, context.algebra)
        slopes = {name: value_of(output, {**rest, name: one}, context.algebra) - d for name in z}
        line = sum((slopes[name] * context.letters[name] for name in z), start=d)
        if not context.algebra.is_zero(context.value(output) - line):
            raise NotShown(f"output {j} is not affine in the states")
        seen = [name for name in z if not context.algebra.is_zero(slopes[name])]
        measured += seen if len(seen) == 1 and slopes[seen[0]].number is not None else []
    for i, (entries, rest_) in enumerate(zip(context.form.A, context.form.b, strict=True), 1):
        for row in (*entries, rest_):
            only(row.names & set(z), measured, f"row {i} of A or b")
    _ranges(context)
    return Shown(f"A and b read {', '.join(measured) or 'no state'}, and the form's equations are the plant's")


def _affine_lipschitz(context: Context, claim: Claim, place: Row) -> Shown:
    """|d(A z + b)/dz| <= bound in the spectral norm, on the box."""
    return _steep(context, claim, context.rates, "d(A z + b)/dz")


def _inverse(context: Context, claim: Claim, place: Row) -> Shown:
    """z = Z(x) and x = X(z) undo each other and have finite derivatives on their boxes."""
    _ = context.equations
    form, plant = context.form, context.plant
    boxes = _regular(form.to_form, plant.states, plant.box) + _regular(form.from_form, form.states, form.box)
    return Shown("the change of coordinates and its inverse are smooth and undo each other", boxes)


def _regular(rows: Sequence[Expression], names: Sequence[str], box: Box) -> int:
    read = {name for row in rows for name in row.names}
    return covered(narrowed(box, read), ".", regular(rows, [name for name in names if name in read]))


def _range_of_recast(context: Context, claim: Claim, place: Row) -> Shown:
    """Each z_i keeps to its range while the plant's states do."""
    boxes = 0
    for name, row in zip(context.z, context.form.to_form, strict=True):
        box = narrowed(context.plant.box, row.names)
        boxes += covered(box, ".", ranged(row, *context.form.box[name]))
    return Shown("the form's states keep to their ranges while the plant's do", boxes)


def _no_gain(context: Context, claim: Claim, place: Row) -> Shown:
    """At a point of the box a_i is zero or negative."""
    wanted, source = wanted_gain(context, place)
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    context.same(text, wanted, f"its expression {text.text} is not what the form has")
    at = _witness(claim, context.form.box, text.names | source.names)
    what = witnessed(text, at)
    if what not in ("zero", "negative"):
        raise NotShown(f"{text.text} is not shown to be zero or negative at its witness")
    return Shown(f"{text.text} is {what} at {', '.join(f'{name} = {value}' for name, value in at.items())}")


def _witness(claim: Claim, box: Box, names: Iterable[str], key: str = "witness") -> dict[str, Fraction]:
    given = part(claim.evidence, key, dict)
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


_NONE: Keys = ()  # the file's model shows it
_CHAINS = ("triangular", "block_triangular")
_INPUT: Keys = ("inputs", "period", "at")
_SECOND: Keys = ("system", "share", "basis", "slabs")
_POINT: Keys = ("expression", "witness")
# By kind of the form, "*" for any: the claim's id (with the row it counts), its verdict, and what its evidence has.
RULES: tuple[tuple[str, str, str, Rule, Keys], ...] = (
    ("triangular", r"triangular\.structure", "proved", _structure, _NONE),
    ("triangular", r"triangular\.a_(\d{1,4})", "proved", _gain, RANGE),
    ("triangular", r"triangular\.a_(\d{1,4})", "refuted", _no_gain, _POINT),
    ("triangular", r"triangular\.offset", "proved", _offset, RANGE),
    ("triangular", r"triangular\.lipschitz", "proved", _lipschitz, STEEP),
    ("block_triangular", r"block_triangular\.structure", "proved", _structure, _NONE),
    ("block_triangular", r"block_triangular\.a_(\d{1,4})_(\d{1,4})", "proved", _gain, RANGE),
    ("block_triangular", r"block_triangular\.a_(\d{1,4})_(\d{1,4})", "refuted", _no_gain, _POINT),
    ("block_triangular", r"block_triangular\.offset_(\d{1,4})", "proved", _offset, RANGE),
    ("block_triangular", r"block_triangular\.lipschitz", "proved", _lipschitz, STEEP),
    ("uniform", r"uniform\.structure", "proved", _uniform_structure, _NONE),
    ("uniform", r"uniform\.slope_(\d{1,4})", "proved", _uniform_slope, RANGE),
    ("uniform", r"uniform\.slope_(\d{1,4})", "refuted", _no_slope, (*_POINT, "other")),
    ("uniform", r"uniform\.lipschitz", "proved", _uniform_lipschitz, STEEP),
    ("original", r"original\.lipschitz", "proved", _uniform_lipschitz, STEEP),
    ("state_affine", r"state_affine\.structure", "proved", _affine_structure, _NONE),
    ("state_affine", r"state_affine\.lipschitz", "proved", _affine_lipschitz, STEEP),
    *((kind, id, "proved", found, keys) for kind in _CHAINS for id, found, keys in OF_CHAINS),
    *(("phase", id, "proved", _in_chain(found), keys) for id, found, keys in OF_CHAINS),
    ("phase", rf"(?:{'|'.join(OBSERVERS)})\.lipschitz", "proved", _in_chain(_clamped), STEEP),
    *(("*", id, "proved", found, keys) for id, found, keys in OF_NUMBERS),
    ("*", r"phase\.chain", "proved", phases, ("chain",)),
    ("*", r"phase\.rank", "proved", rank, RANGE),
    *((kind, r"kalman_like\.persistence", "proved", persistent, _INPUT) for kind in ("state_affine", *_CHAINS)),
    ("*", r"dissipation\.positive", "proved", is_positive, _SECOND),
    ("*", r"dissipation\.inequality", "proved", inequality, (*_SECOND, "left")),
    ("*", r"dissipation\.level", "proved", level, ("system", "floor")),
    ("*", r"recast\.inverse", "proved", _inverse, _NONE),
    ("*", r"recast\.range", "proved", _range_of_recast, _NONE),
)


def rule(kind: str, claim: Claim) -> tuple[Rule, Row, Keys] | None:
    """The rule of a claim, the row that its id counts (empty without one), and what its evidence may have."""
    for of, pattern, verdict, found, keys in RULES:
        match = re.fullmatch(pattern, claim.id, re.ASCII)
        if match and verdict == claim.verdict and of in ("*", kind):
            return found, tuple(map(int, match.groups())), keys
    return None


def subject(id: str, kind: str) -> str:
    """What a verified claim is about, for its sentence."""
    what = id.partition(".")[0]
    if what in OBSERVERS:
        return f"the {what} observer"
    return {
        "phase": "the plant",
        "dissipation": "the plant",
        "recast": "the form's coordinates",
        "kalman_like": f"the plant in {kind} form",
    }.get(what, f"the {kind} form")


def rests(certificate: Certificate, id: str) -> tuple[str, ...]:
    """The ids of the claims that this one rests on; any claim of a form rests on those of its coordinates."""
    kind = certificate.form.kind
    own = {"phase.rank": ("phase.chain",), "kalman_like.persistence": (f"{kind}.structure",)}.get(id) or of_observer(
        id, kind
    )
    coordinates = (claim.id for claim in certificate.claims if claim.id.startswith("recast."))
    return (*own, *(() if id.startswith("recast.") else coordinates))


def required(certificate: Certificate) -> tuple[str, ...]:
    """The ids of the claims that a certificate of this form cannot leave out, whatever their verdicts: its structure,
    and what a form of proved structure needs beside."""
    form = certificate.form
    kind, blocks = form.kind, form.blocks
    if kind.startswith("phase"):
        return ("phase.chain",)
    if kind not in ("triangular", "uniform", "block_triangular", "state_affine"):
        return ()
    structure = f"{kind}.structure"
    if not any(claim.id == structure and claim.verdict == "proved" for claim in certificate.claims):
        return (structure,)
    if kind == "state_affine":
        rows = []
    elif kind == "block_triangular":
        rows = [f"a_{k}_{i}" for k, size in enumerate(blocks, 1) for i in range(1, size + 1)]
    else:
        rows = [f"{'a' if kind == 'triangular' else 'slope'}_{i}" for i in range(1, len(form.states) + 1)]
    return (structure, *(f"{kind}.{row}" for row in rows), f"{kind}.lipschitz")
