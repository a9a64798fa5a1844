"""The map to phase coordinates, verified again: Phi = (y, y', .., y^(n-1)), its rank, and that it is one to one.

Phi_1 = h, Phi_(k+1) = dPhi_k/dx f + sum_u dPhi_k/du u', as rational functions, with the derivatives of inputs as names.
Phi is one to one on the box, which is a product of intervals, if at every point all principal minors of L dPhi/dx are
above 0, L constant and invertible, and Phi is differentiable (Gale, Nikaido, Math. Annalen 159 (1965), theorem 4).
Source: Gauthier, Hammouri, Othman, IEEE TAC 37 (1992).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise
from typing import Any

from ..algebra import Algebra, Quotient
from ..arithmetic import determinant
from ..box import Box, NotShown, covered, ranged
from ..context import RANGE, Context, Shown, algebra_of, applied, declared_box, finite, narrowed, short
from ..file import Claim, fields, matrix, part, scalar
from ..inequality import place
from ..matrix import inverse
from ..rule import Needed, Rule
from ..slope import regular
from ..tables import jumps
from ..text import KINKS, Expression, expression

MOST = 6  # states, beyond which the determinant's expansion is too long


def phases(context: Context, claim: Claim) -> Shown:
    """Phi is the output with its derivatives along the plant's flow, and smooth on the box, but for its last entry also
    in what inputs do: where an input passes a kink, the entry has no derivative."""
    plant, states = context.plant, context.plant.states
    box, rates, Phi = _read(context, claim)
    if len(plant.output) != 1 or len(Phi) != len(states):
        raise NotShown("it is not one output with n - 1 derivatives")
    for row in (*plant.flow, *plant.output):
        finite(row, plant.box)
    algebra = algebra_of(box)
    speeds = {name: algebra.read(row) for name, row in zip(states, plant.flow, strict=True)}
    speeds |= {name: algebra.names[rate] for name, rate in rates.items()}
    if not algebra.is_zero(algebra.read(Phi[0]) - algebra.read(plant.output[0])):
        raise NotShown("it does not begin with the output")
    if context.form.kind in ("phase", "phase.recovered"):
        for row, image in zip(context.form.to_form, Phi, strict=True):
            if not algebra.is_zero(algebra.read(row) - algebra.read(image)):
                raise NotShown("the form's states are not Phi")
    known = set(states) | set(rates) | set(context.file.parameters)
    _smooth_enough(Phi[:-1], 1)
    for k, (before, after) in enumerate(pairwise(Phi), 1):
        if before.names - known:
            raise NotShown(f"it does not say the derivative of {sorted(before.names - known)[0]}")
        if not algebra.is_zero(algebra.read(after) - algebra.speed(before, speeds)):
            raise NotShown(f"its entry {k + 1} is not the derivative of entry {k}")
    boxes = sum(_regular(row, states, box) for row in Phi)
    return Shown("Phi = (y, y', ..) along the plant's flow", boxes)


def rank(context: Context, claim: Claim) -> Shown:
    """det dPhi/dx keeps clear of zero; Phi is another claim."""
    slopes = _slopes(context, claim)
    low, high, boxes = _bounded_determinant(slopes, slopes.rows, claim.evidence)
    if low <= 0 <= high:
        raise NotShown("its bounds do not keep clear of zero")
    return Shown(f"{short(low, -1)} <= det dPhi/dx <= {short(high, 1)}", boxes)


def one_to_one(context: Context, claim: Claim) -> Shown:
    """All principal minors of L dPhi/dx are above zero; Phi is another claim."""
    slopes, n, boxes = _slopes(context, claim), len(context.plant.states), 0
    _smooth_enough(slopes.Phi, 0)
    L, algebra = matrix(claim.evidence, "weights", n, n), slopes.algebra
    _ = inverse(L)
    weighed = [*zip(*(applied(algebra, L, column) for column in zip(*slopes.rows, strict=True)), strict=True)]
    left = {places for size in range(1, n + 1) for places in combinations(range(n), size)}
    for minor in part(claim.evidence, "minors", list):
        fields(minor, "a minor", ("places", *RANGE))
        places = tuple(place({"places": k}, "places", n) for k in part(minor, "places", list))
        if places not in left:
            raise NotShown(f"{[k + 1 for k in places]} are no places of a minor, or stand twice")
        left.remove(places)
        low, _, more = _bounded_determinant(slopes, [[weighed[i][j] for j in places] for i in places], minor)
        if low <= 0:
            raise NotShown("a minor is not shown to be above zero")
        boxes += more
    if left:
        raise NotShown(f"{len(left)} principal minors are missing")
    return Shown("Phi is one to one on the box: all principal minors of L dPhi/dx are above 0", boxes)


@dataclass(frozen=True)
class _Slopes:
    """dPhi/dx as quotients, the `rows` (n, n), with what they are made of."""

    rows: list[list[Quotient]]
    Phi: list[Expression]
    box: Box
    algebra: Algebra


def _slopes(context: Context, claim: Claim) -> _Slopes:
    box, _, Phi = _read(context, context.file.claim("phase.chain") or claim)
    states = context.plant.states
    if len(states) > MOST:
        raise NotShown(f"the determinant of more than {MOST} states is not computed")
    algebra = algebra_of(box)
    return _Slopes([[algebra.speed(row, {name: algebra.one}) for name in states] for row in Phi], Phi, box, algebra)


def _bounded_determinant(
    slopes: _Slopes, rows: list[list[Quotient]], evidence: Mapping[str, Any]
) -> tuple[Fraction, Fraction, int]:
    """The bounds that evidence tells of the determinant of rows, once they are shown, with how many boxes."""
    text, algebra = expression(part(evidence, "expression", str), slopes.box), slopes.algebra
    if not algebra.is_zero(algebra.read(text) - (determinant(rows) if rows else algebra.one)):
        raise NotShown(f"its expression {text.text} is not the determinant")
    low, high = scalar(evidence, "low"), scalar(evidence, "high")
    where = declared_box(evidence, slopes.box, text.names)
    return low, high, covered(where, part(evidence, "tree", str), ranged(text, low, high))


def _read(context: Context, claim: Claim) -> tuple[Box, Mapping[str, str], list[Expression]]:
    """The box and the names of `box_of_rates`, and Phi."""
    box, rates = box_of_rates(context)
    return box, rates, [expression(text, box) for text in part(claim.evidence, "chain", list)]


def box_of_rates(context: Context) -> tuple[Box, Mapping[str, str]]:
    """The plant's box with the derivatives of inputs, unbounded where they have no range; which name is the derivative
    of which, by the names. Raises: `NotShown`."""
    count, inputs = len(context.plant.states), context.file.inputs
    endings = [*(f"_{'d' * k}ot" for k in range(1, min(count, 3) + 1)), *(f"_d{k}" for k in range(4, count + 1))]
    lines = [[name, *(f"{name.rstrip('_')}{suffix}" for suffix in endings)] for name in inputs]
    derived = {other for line in lines for other in line[1:]}
    rates = {one: after for line in lines if line[0] not in derived for one, after in pairwise(line)}
    box = {**dict.fromkeys(rates.values(), (-math.inf, math.inf)), **context.plant.box}
    if derived & {*context.plant.states, *context.file.parameters}:
        raise NotShown("a name that a derivative of an input would have is taken")
    return box, rates


def _smooth_enough(rows: Sequence[Expression], order: int) -> None:
    """That they have no modulus and the like, and no table whose derivative of that order jumps. Raises: `NotShown`."""
    for row in rows:
        if any(step.op in KINKS or jumps(step.op, order) for step in row.instructions):
            raise NotShown(f"{row.text[:60]} is not shown to be differentiable")


def _regular(row: Expression, states: Sequence[str], box: Box) -> int:
    """With how many boxes a row is shown to have finite derivatives; where a side is unbounded it is a polynomial.
    Raises: `NotShown`."""
    if all(math.isfinite(end) for name in row.names for end in box[name]):
        return covered(narrowed(box, row.names), ".", regular([row], [name for name in states if name in row.names]))
    for op, _, value in row.instructions:
        whole = op == "power" and isinstance(value, int) and value >= 0
        if not whole and op not in ("number", "symbol", "add", "sub", "mul", "neg"):
            raise NotShown(f"{row.text[:60]} is not shown to be smooth on an unbounded box")
    return 0


_ABOUT = "the plant"
NEEDED = dict.fromkeys(("phase", "phase.recovered", "phase, original coordinates"), Needed("phase.chain"))
RULES = (
    Rule(("phase",), ("chain",), phases, ("chain",), about=_ABOUT),
    Rule(("phase",), ("rank",), rank, RANGE, rests=("phase.chain",), about=_ABOUT),
    Rule(("phase",), ("inverse",), one_to_one, ("weights", "minors"), rests=("phase.chain",), about=_ABOUT),
)
