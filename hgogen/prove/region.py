"""The region of initial errors from which the errors of periodic outputs stay below half a turn.

    y_j has the period Q_j:   the observer injects y_j - h_j(z), taken to the nearest turn

Let x be the plant's state and z the estimate, with their angles counted on instead of brought back to a turn, and e = z
- x. The flow is the same a turn later and the outputs go on by whole periods, so both obey their equations on the whole
line, where b has the slopes that it has on one turn (`rigor.periodic`). As long as every |C_j e| < Q_j/2, C_j the slope
of h_j, the nearest turn is the right one: what is injected is C_j e, and e obeys the differential inclusion of
`inclusion`. Then V = e'P e does not grow. With

    V(e(0)) <= level,   level C_j P^-1 C_j' < (Q_j/2)^2 for every j

it stays so: before |C_j e| reached Q_j/2, V would have had to exceed the level. So a proof that e converges holds from
these initial errors, and a box of them is within the level where its corners are. Of several P the one with the largest
multiple of a box is taken: half of each state's range, no more than half a turn of an output.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from hgogen.analysis.evidence import Grounds, outward
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.prove.convergence import Flow, OneSided, convergence_checks, unknown_checks
from hgogen.prove.inclusion import NO_SCALES, Facts, Inclusion, Nothing, state_row
from hgogen.prove.inequality import ROWS, Steps, flow
from hgogen.prove.plant_step import heads_of
from hgogen.prove.quadratic import Array, Weights, extent, rational
from hgogen.prove.questions import confinement
from hgogen.prove.semidefinite import NoSolver
from hgogen.rigor.definite import fraction, root
from hgogen.rigor.periodic import half_turn
from hgogen.sentence import NONE, Reason, Sentence, because, down

STATES = 8  # the most states whose corners of initial errors are checked
_CHAINS = ("triangular", "block_triangular")


@dataclass(frozen=True)
class Region:
    """A proof that initial errors with V(e(0)) <= `level` keep the errors of periodic outputs below half a turn, where
    V = e'P e, with the `weights` P and S, does not grow. `first` (n): initial errors of the states that together have V
    <= level."""

    weights: Weights
    level: Fraction
    first: tuple[Fraction, ...]


@dataclass(frozen=True)
class _Question:
    """The `rows` c, for which |c e| < 1 where an output's error is below half a turn, and the `corners` (k, N), one of
    each opposite pair, of the box of initial errors `sides` (n)."""

    rows: dict[int, Array]
    corners: Array
    sides: Sequence[Fraction]


def theta_checks(maker: str, form: Form, theta: float, error: Inclusion | Nothing) -> tuple[Check, ...]:
    """Return the checks of an observer's convergence: `MAKER.convergence`, that errors converge for every theta above
    some bound, and `MAKER.theta`, that `theta` is above this bound, with the rate. For periodic outputs these hold for
    small initial errors, whose size is the check `MAKER.region`. `maker`: the observer's name; `error`: its error
    dynamics."""
    if isinstance(error, Nothing):
        return unknown_checks(maker, theta, error.reason)
    search = (OneSided if error.endless else Flow)(error, Fraction(theta))
    known = convergence_checks(maker, form, search, {"theta": theta, **error.numbers})
    turning = [y.name for y in form.system.outputs if y.period is not None]
    return tuple(_within(maker, form, search, known, turning)) if turning else known


def _within(maker: str, form: Form, search: Flow, known: Sequence[Check], turning: Sequence[str]) -> Iterator[Check]:
    """Yield the `known` checks for initial errors in a region, and the check of the region."""
    id, answer = ClaimId(maker, "region"), region(form, search)
    below = f"the error of {' and '.join(turning)} stays below half a turn"
    claim = f"in continuous time, without noise, from small initial errors {below}"
    if isinstance(answer, Reason):
        why = because("it is not proved that {below}: {why}", below=below, why=answer)
        for check in known:
            yield replace(check, verdict=Verdict.UNKNOWN, reason=why, proofs=()) if check.proofs else check
        yield Check(id, claim, Verdict.UNKNOWN, answer, fix="Begin close to the plant, and watch the innovations.")
        return
    sizes = [Sentence.of("{x} {size}", x=x, size=float(size)) for x, size in zip(form.names, answer.first, strict=True)]
    start = because("from initial errors of at most {sizes}", sizes=sizes)
    pattern = "{why}; while {below}, as it does with theta = {theta} {start}"
    for check in known:
        reason = because(pattern, why=check.reason, below=below, theta=float(search.theta), start=start)
        yield replace(check, reason=reason) if check.verdict is Verdict.PROVED else check
    numbers = {"theta": float(search.theta), **search.error.numbers}
    facts = Facts(search.error, {"region": answer})
    reason = because("{start}, by a quadratic V that does not grow; in exact arithmetic", start=start)
    yield Check(id, claim, Verdict.PROVED, reason, proofs=(Grounds(numbers, facts),))


def region(form: Form, search: Flow) -> Region | Reason:
    """Return a region of initial errors from which the errors of periodic outputs stay below half a turn, for an
    observer whose convergence is proved by `search`; or the reason why none is proved."""
    known = _question(form, search)
    if isinstance(known, Reason):
        return known
    best = max(_tried(search, known), key=lambda one: one[0], default=None)
    if best is None:
        return because("no quadratic function falls for all slopes in their ranges at the declared theta")
    multiple, weights = best
    level = outward(1 / max(extent(rational(weights.P), c) for c in known.rows.values()), -1)
    return Region(weights, level, tuple(Fraction(down(multiple * side, 3)) for side in known.sides))


def _tried(search: Flow, known: _Question) -> Iterator[tuple[Fraction, Weights]]:
    """Yield pairs of a multiple of the box of initial errors and the weights by which it is proved."""
    every = [falls.weights for falls in (search.fastest, search.least) if falls and falls.theta <= search.theta]
    steps = Steps(search.error, lambda h, e: flow(e), search.theta)
    if every and not search.error.endless and steps.at(Fraction(0)).rows <= ROWS:
        try:
            form, W = steps.at(Fraction(0)).falls(Fraction(0)), steps.coordinates
            widest = None if W is None else confinement(form, W, known.corners, known.rows)
        except NoSolver:
            widest = None
        every += [widest.weights] if widest else []
    for weights in every:
        P = rational(weights.P)
        largest = fraction(max(corner @ P @ corner for corner in known.corners))
        level = outward(1 / max(extent(P, c) for c in known.rows.values()), -1)
        yield 1 / root(largest / level), weights


def _question(form: Form, search: Flow) -> _Question | Reason:
    error, slopes = search.error, heads_of(form)
    scales = error.scales(search.theta)
    if form.kind not in _CHAINS:
        return because("that is proved in chains of the plant's own states only")
    if scales is None or slopes is None:
        return NO_SCALES
    if endless := no_corners(form):
        return endless
    sides = [(Fraction(high) - Fraction(low)) / 2 for low, high in (state.interval for state in form.states)]
    rows = dict[int, Array]()
    for j, (head, slope) in slopes.items():
        period = form.system.outputs[j].period
        if period is not None:
            half = half_turn(period) / abs(slope)
            rows[j] = state_row(scales, error.layout.picks[head]) / rational(half)
            sides[head] = min(sides[head], half)
    if not rows:
        return because("no periodic output has a part in the correction")
    return _Question(rows, error.corners(scales, sides), sides)


def no_corners(form: Form) -> Reason:
    """Return the reason why the corners of the box of initial errors cannot be listed: a state without a range, or more
    than 8 states; `NONE` where they can."""
    endless = [name for name, state in zip(form.names, form.states, strict=True) if not state.bounded]
    if endless:
        return because("initial errors are those of states in ranges, and {names: and } has none", names=endless)
    if form.n > STATES:
        return because("the corners of initial errors are computed for up to {most} states", most=STATES)
    return NONE
