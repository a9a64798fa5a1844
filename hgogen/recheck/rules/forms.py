"""Properties of a form: its structure, its rows, its Lipschitz constants, and its coordinates.

    chains    z' = A(u) z + b(z, u),             y_i = a_1 z_1 + c of its chain,   0 < a_m <= a_i <= a_M
    affine    z' = A(s, u) z + b(s, u),          y = C(u) z + d(u),   s the states that an output measures alone
    uniform   z_i' = F_i(z_1, .., z_(i+1), u),   y = h(z_1, u),   dh/dz_1, dF_(i-1)/dz_i never 0

Source of the first: N. Boizot, E. Busvelle, J.-P. Gauthier, Automatica 46 (2010), form (3).

The map to phase coordinates is Phi = (y, y', .., y^(n-1)); its rank and that it is one to one are verified as well.

Phi_1 = h, Phi_(k+1) = dPhi_k/dx f + sum_u dPhi_k/du u', as rational functions, with the derivatives of inputs as names.
Phi is one to one on the box, which is a product of intervals, if at every point all principal minors of L dPhi/dx are
above 0, L constant and invertible, and Phi is differentiable (Gale, Nikaido, Math. Annalen 159 (1965), theorem 4).
Source: Gauthier, Hammouri, Othman, IEEE TAC 37 (1992).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise
from typing import Any

from ..algebra import Algebra, Quotient
from ..arithmetic import Unproved, determinant
from ..box import Box, covered, demand_continuous, demand_differentiable, narrowed, ranged, regular, witnessed
from ..context import (
    POINT,
    RANGE,
    STEEP,
    Context,
    Finding,
    Needed,
    Rule,
    algebra_of,
    applied,
    claimed,
    declared_box,
    demand_finite,
    demand_only,
    enclosed,
    jacobian_bound,
    place_of,
    printed,
    ranges_kept,
    structure,
    wanted_gain,
    witness,
)
from ..file import Claim, fields, matrix, part, scalar
from ..inequality import index_under
from ..matrix import inverse
from ..tables import jumps
from ..text import KINKS, Expression, expression

# --- chains


def _gain(context: Context, claim: Claim) -> Finding:
    """Prove 0 < a_m <= a_i <= a_M on the box, for the gain a_i of a chain y = a_1 z_1 + c, z_(i-1)' = a_i z_i + .."""
    low, _, finding = enclosed(context, claim.evidence, *wanted_gain(context, claim.at))
    if low <= 0:
        raise Unproved("its lower bound is not above zero")
    return Finding(f"{claim.what}: {finding.sentence}", finding.boxes)


def _no_gain(context: Context, claim: Claim) -> Finding:
    """Refute that the gain a_i of a chain of integrators is positive, by a point of the box where a_i <= 0."""
    wanted, source = wanted_gain(context, claim.at)
    text = claimed(context, claim.evidence, wanted)
    at = witness(claim, context.form.box, text.names | source.names)
    what = witnessed(text, at)
    if what not in ("zero", "negative"):
        raise Unproved(f"{text.text} is not shown to be zero or negative at its witness")
    return Finding(f"{text.text} is {what} at {', '.join(f'{name} = {value}' for name, value in at.items())}")


def _offset(context: Context, claim: Claim) -> Finding:
    """Prove that c = y - a_1 z_1 of a chain of integrators is finite on the box."""
    _ = context.equations
    chain = claim.at[0] if claim.at else 1
    head = context.z[place_of(context, chain, 1)]
    offset_ = (
        context.value(context.form.output[chain - 1]) - context.first_gain(chain - 1) * context.algebra.names[head]
    )
    text = expression(part(claim.evidence, "expression", str), context.form.box)
    demand_only(text.names & set(context.z), (), "the offset")
    return enclosed(context, claim.evidence, offset_, text)[2]


# --- affine in the states


def _affine(context: Context, claim: Claim) -> Finding:
    """Prove y = d + sum c_k z_k for every z, with d = y(0) and c_k = y(z_k = 1) - y(0), which then depend on no state.
    A and b may depend on states that one output measures alone, with a constant c_k."""
    _ = context.equations
    z, measured, algebra = context.z, list[str](), context.algebra
    offset_ = {**algebra.names, **dict.fromkeys(z, algebra.zero)}
    for j, output in enumerate(context.form.output, 1):
        d = algebra.read(output, offset_)
        slopes = {name: algebra.read(output, {**offset_, name: algebra.one}) - d for name in z}
        line = sum((slopes[name] * algebra.names[name] for name in z), start=d)
        if not algebra.is_zero(context.value(output) - line):
            raise Unproved(f"output {j} is not affine in the states")
        read_states = [name for name in z if not algebra.is_zero(slopes[name])]
        measured += read_states if len(read_states) == 1 and slopes[read_states[0]].number is not None else []
    for i, (entries, nonlinear) in enumerate(zip(context.form.A, context.form.b, strict=True), 1):
        for row in (*entries, nonlinear):
            demand_only(row.names & set(z), measured, f"row {i} of A or b")
    ranges_kept(context)
    return Finding(f"A and b read {', '.join(measured) or 'no state'}, and the form's equations are the plant's")


# --- uniform


def _uniform(context: Context, claim: Claim) -> Finding:
    """Prove that z_i' = F_i depends on z_1, .., z_(i+1) only, and y on z_1 only."""
    _ = context.equations
    z = context.z
    for i, row in enumerate(context.rates):
        demand_only(row.names & set(z), z[: i + 2], f"F_{i + 1}")
    if len(context.form.output) != 1:
        raise Unproved("the uniform form has one output")
    demand_only(context.form.output[0].names & set(z), z[:1], "the output")
    ranges_kept(context)
    return Finding(f"{' -> '.join(('y', *z))}, and the form's equations are the plant's")


def _slope(context: Context, claim: Claim) -> Finding:
    """Prove that dh/dz_1 or dF_(i-1)/dz_i, for y = h, z' = F, is bounded and bounded away from zero on the box."""
    wanted, rate = _wanted_slope(context, *claim.at)
    low, high, finding = enclosed(context, claim.evidence, wanted, rate, lambda text: context.at_kinks(text, rate))
    if low <= 0 <= high:
        raise Unproved("its bounds do not keep clear of zero")
    demand_continuous((rate,), (context.z[claim.at[0] - 1],), context.form.box)
    return Finding(f"{claim.what}: {finding.sentence}", finding.boxes)


def _no_slope(context: Context, claim: Claim) -> Finding:
    """Refute that dh/dz_1 or dF_(i-1)/dz_i, for y = h, z' = F, has one sign and no zero: by a point of the box without
    a kink where it is zero, or by two points where it has opposite signs while h or F_(i-1) is continuous."""
    wanted, rate = _wanted_slope(context, *claim.at)
    text = claimed(context, claim.evidence, wanted)
    read = context.at_kinks(text, rate)
    keys = [key for key in ("witness", "other") if key in claim.evidence]
    signs = [witnessed(read, witness(claim, context.form.box, text.names, key)) for key in keys]
    if signs == ["zero"]:
        demand_differentiable((rate, text), witness(claim, context.form.box, text.names | rate.names))
        return Finding(f"{text.text} is zero at its witness")
    if sorted(signs) != ["negative", "positive"]:
        raise Unproved(f"{text.text} is not shown to be zero, or to change its sign")
    if any(step.op == "sign" or jumps(step.op) for step in rate.instructions):
        raise Unproved(f"{rate.text} is not shown to be continuous")
    boxes = demand_finite(text, context.form.box) + demand_finite(rate, context.form.box)
    return Finding(f"{text.text} changes its sign", boxes)


def _wanted_slope(context: Context, index: int) -> tuple[Quotient, Expression]:
    _ = context.equations
    if not 1 <= index <= len(context.z):
        raise Unproved("the form has no such row")
    rate = context.form.output[0] if index == 1 else context.rates[index - 2]
    return context.slope(rate, context.z[index - 1]), rate


# --- how steep


def _lipschitz(context: Context, claim: Claim) -> Finding:
    name, rows = _STEEP[context.form.kind]
    return jacobian_bound(context, claim, rows(context), name)


_STEEP: Mapping[str, tuple[str, Callable[[Context], Sequence[Expression]]]] = {
    **dict.fromkeys(("triangular", "block_triangular"), ("db/dz", lambda context: context.nonlinear)),
    "state_affine": ("d(A z + b)/dz", lambda context: context.rates),
    **dict.fromkeys(("uniform", "original"), ("d(F, h)/dz", lambda context: (*context.rates, *context.form.output))),
}

# --- coordinates


def _range_kept(context: Context, claim: Claim) -> Finding:
    return Finding("the form's states keep to their ranges while the plant's do", ranges_kept(context, every=True))


def _numbered(begin: str, count: int) -> Iterator[str]:
    return (f"{begin}{i}" for i in range(1, count + 1))


def _inverse(context: Context, claim: Claim) -> Finding:
    """Prove that z = Z(x) and x = X(z) are inverse to each other and have finite derivatives on their boxes."""
    _ = context.equations
    form, plant = context.form, context.plant
    boxes = _regular(form.to_form, plant.states, plant.box) + _regular(form.from_form, form.states, form.box)
    return Finding("the change of coordinates and its inverse are smooth and undo each other", boxes)


def _regular(rows: Sequence[Expression], names: Sequence[str], box: Box) -> int:
    read = {name for row in rows for name in row.names}
    return covered(narrowed(box, read), ".", regular(rows, [name for name in names if name in read]))


MOST = 6  # states, beyond which the determinant's expansion is too long


def phases(context: Context, claim: Claim) -> Finding:
    """Prove that Phi is (y, y', .., y^(n-1)) along the plant's motion, and smooth on the box. Its last entry need not
    be differentiable in the inputs: it has no derivative where an input passes a kink."""
    plant, states = context.plant, context.plant.states
    box, rates, Phi = _read_phases(context, claim)
    if len(plant.output) != 1 or len(Phi) != len(states):
        raise Unproved("it is not one output with n - 1 derivatives")
    for row in (*plant.flow, *plant.output):
        demand_finite(row, plant.box)
    algebra = algebra_of(box)
    speeds = {name: algebra.read(row) for name, row in zip(states, plant.flow, strict=True)}
    speeds |= {name: algebra.names[rate] for name, rate in rates.items()}
    if not algebra.is_zero(algebra.read(Phi[0]) - algebra.read(plant.output[0])):
        raise Unproved("it does not begin with the output")
    if context.form.kind in ("phase", "phase.recovered"):
        for row, image in zip(context.form.to_form, Phi, strict=True):
            if not algebra.is_zero(algebra.read(row) - algebra.read(image)):
                raise Unproved("the form's states are not Phi")
    known = set(states) | set(rates) | set(context.file.parameters)
    _smooth_enough(Phi[:-1], 1)
    for k, (before, after) in enumerate(pairwise(Phi), 1):
        if before.names - known:
            raise Unproved(f"it does not say the derivative of {sorted(before.names - known)[0]}")
        if not algebra.is_zero(algebra.read(after) - algebra.speed(before, speeds)):
            raise Unproved(f"its entry {k + 1} is not the derivative of entry {k}")
    boxes = sum(_regular_row(row, states, box) for row in Phi)
    return Finding("Phi = (y, y', ..) along the plant's flow", boxes)


def rank(context: Context, claim: Claim) -> Finding:
    """Prove that det dPhi/dx is bounded away from zero on the box; that Phi is (y, y', ..) is another claim."""
    slopes = _phase_slopes(context, claim)
    low, high, boxes = _bounded_determinant(slopes, slopes.rows, claim.evidence)
    if low <= 0 <= high:
        raise Unproved("its bounds do not keep clear of zero")
    return Finding(f"{printed(low, -1)} <= det dPhi/dx <= {printed(high, 1)}", boxes)


def one_to_one(context: Context, claim: Claim) -> Finding:
    """Prove that all principal minors of L dPhi/dx are positive on the box, L a constant matrix; that Phi is (y, y',
    ..) is another claim."""
    slopes, n, boxes = _phase_slopes(context, claim), len(context.plant.states), 0
    _smooth_enough(slopes.Phi, 0)
    L, algebra = matrix(claim.evidence, "weights", n, n), slopes.algebra
    _ = inverse(L)
    weighed = [*zip(*(applied(algebra, L, column) for column in zip(*slopes.rows, strict=True)), strict=True)]
    missing = {places for size in range(1, n + 1) for places in combinations(range(n), size)}
    for minor in part(claim.evidence, "minors", list):
        fields(minor, "a minor", ("places", *RANGE))
        places = tuple(index_under({"places": k}, "places", n) for k in part(minor, "places", list))
        if places not in missing:
            raise Unproved(f"{[k + 1 for k in places]} are no places of a minor, or stand twice")
        missing.remove(places)
        low, _, more = _bounded_determinant(slopes, [[weighed[i][j] for j in places] for i in places], minor)
        if low <= 0:
            raise Unproved("a minor is not shown to be above zero")
        boxes += more
    if missing:
        raise Unproved(f"{len(missing)} principal minors are missing")
    return Finding("Phi is one to one on the box: all principal minors of L dPhi/dx are above 0", boxes)


@dataclass(frozen=True)
class _Slopes:
    """The Jacobian dPhi/dx, `rows` (n, n), of Phi = (y, y', ..) as quotients in an algebra, with Phi and its box."""

    rows: list[list[Quotient]]
    Phi: list[Expression]
    box: Box
    algebra: Algebra


def _phase_slopes(context: Context, claim: Claim) -> _Slopes:
    box, _, Phi = _read_phases(context, context.file.claim("phase.chain") or claim)
    states = context.plant.states
    if len(states) > MOST:
        raise Unproved(f"the determinant of more than {MOST} states is not computed")
    algebra = algebra_of(box)
    return _Slopes([[algebra.speed(row, {name: algebra.one}) for name in states] for row in Phi], Phi, box, algebra)


def _bounded_determinant(
    slopes: _Slopes, rows: list[list[Quotient]], evidence: Mapping[str, Any]
) -> tuple[Fraction, Fraction, int]:
    text, algebra = expression(part(evidence, "expression", str), slopes.box), slopes.algebra
    if not algebra.is_zero(algebra.read(text) - (determinant(rows) if rows else algebra.one)):
        raise Unproved(f"its expression {text.text} is not the determinant")
    low, high = scalar(evidence, "low"), scalar(evidence, "high")
    where = declared_box(evidence, slopes.box, text.names)
    return low, high, covered(where, part(evidence, "tree", str), ranged(text, low, high))


def _read_phases(context: Context, claim: Claim) -> tuple[Box, Mapping[str, str], list[Expression]]:
    box, rates = box_of_rates(context)
    return box, rates, [expression(text, box) for text in part(claim.evidence, "chain", list)]


def box_of_rates(context: Context) -> tuple[Box, Mapping[str, str]]:
    """Return the plant's box with the derivatives u', u'', .. of inputs, unbounded without a range, those of a time 1,
    0, .., and the name of each derivative by the name of what it is the derivative of. Raises: `Unproved`."""
    count, inputs = len(context.plant.states), context.file.inputs
    endings = [*(f"_{'d' * k}ot" for k in range(1, min(count, 3) + 1)), *(f"_d{k}" for k in range(4, count + 1))]
    lines = [[name, *(f"{name.rstrip('_')}{suffix}" for suffix in endings)] for name in inputs]
    derived = {other for line in lines for other in line[1:]}
    rates = {one: after for line in lines if line[0] not in derived for one, after in pairwise(line)}
    box: dict[str, tuple[Any, Any]] = {**dict.fromkeys(rates.values(), (-math.inf, math.inf)), **context.plant.box}
    for first, *others in (derivatives for name, *derivatives in lines if name in context.file.times):
        box |= {first: (Fraction(1), Fraction(1)), **dict.fromkeys(others, (Fraction(0), Fraction(0)))}
    if derived & {*context.plant.states, *context.file.parameters}:
        raise Unproved("a name that a derivative of an input would have is taken")
    return box, rates


def _smooth_enough(rows: Sequence[Expression], order: int) -> None:
    for row in rows:
        if any(step.op in KINKS or jumps(step.op, order) for step in row.instructions):
            raise Unproved(f"{row.text[:60]} is not shown to be differentiable")


def _regular_row(row: Expression, states: Sequence[str], box: Box) -> int:
    """Demand that a row has finite derivatives in the states on its box, and is a polynomial if the box is unbounded;
    return the number of boxes. Raises: `Unproved`."""
    if all(math.isfinite(end) for name in row.names for end in box[name]):
        return covered(narrowed(box, row.names), ".", regular([row], [name for name in states if name in row.names]))
    for op, _, value in row.instructions:
        whole = op == "power" and isinstance(value, int) and value >= 0
        if not whole and op not in ("number", "symbol", "add", "sub", "mul", "neg"):
            raise Unproved(f"{row.text[:60]} is not shown to be smooth on an unbounded box")
    return 0


_CHAINS, _UNIFORM = ("triangular", "block_triangular"), ("uniform",)
_OF_A, _OF_OFFSET, _OF_SLOPE = {"triangular": 1, "block_triangular": 2}, {"block_triangular": 1}, {"uniform": 1}
_COORDINATES = "the form's coordinates"
NEEDED = {
    **dict.fromkeys(("phase", "phase.recovered", "phase, original coordinates"), Needed("phase.chain")),
    "triangular": Needed(
        "triangular.structure",
        lambda form: (*_numbered("triangular.a_", len(form.states)), "triangular.lipschitz"),
    ),
    "block_triangular": Needed(
        "block_triangular.structure",
        lambda form: (
            *(id for k, size in enumerate(form.blocks, 1) for id in _numbered(f"block_triangular.a_{k}_", size)),
            "block_triangular.lipschitz",
        ),
    ),
    "state_affine": Needed("state_affine.structure", lambda form: ("state_affine.lipschitz",)),
    "uniform": Needed(
        "uniform.structure", lambda form: (*_numbered("uniform.slope_", len(form.states)), "uniform.lipschitz")
    ),
}
RULES = (
    Rule((), ("structure",), structure, kinds=_CHAINS),
    Rule((), ("a",), _gain, RANGE, _CHAINS, _OF_A),
    Rule((), ("a",), _no_gain, POINT, _CHAINS, _OF_A, verdict="refuted"),
    Rule((), ("offset",), _offset, RANGE, _CHAINS, _OF_OFFSET),
    Rule((), ("structure",), _affine, kinds=("state_affine",)),
    Rule((), ("structure",), _uniform, kinds=_UNIFORM),
    Rule((), ("slope",), _slope, RANGE, _UNIFORM, _OF_SLOPE),
    Rule((), ("slope",), _no_slope, (*POINT, "other"), _UNIFORM, _OF_SLOPE, verdict="refuted"),
    Rule((), ("lipschitz",), _lipschitz, STEEP, (*_STEEP,)),
    Rule(("recast",), ("inverse",), _inverse, about=_COORDINATES),
    Rule(("recast",), ("range",), _range_kept, about=_COORDINATES),
    Rule(("phase",), ("chain",), phases, ("chain",), about="the plant"),
    Rule(("phase",), ("rank",), rank, RANGE, assumes=("phase.chain",), about="the plant"),
    Rule(("phase",), ("inverse",), one_to_one, ("weights", "minors"), assumes=("phase.chain",), about="the plant"),
)
