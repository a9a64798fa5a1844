"""The error dynamics of high-gain observers as linear differential inclusions: the ranges of the partial derivatives of
b in scaled coordinates.

1. A Lipschitz constant of b in scaled coordinates of a form in chains, and the hypotheses of a proof there:

    |S db/dz S^-1| <= L_b on the box,   S diagonal, positive, of numbers and parameters: constant in time

The box is convex and b Lipschitz on it, so that b(sat z) - b(x) = J (sat z - x) with J in the closed convex hull of the
values of db/dz, lower triangular; sat clamps each component to an interval that holds x_i. J_ij turns into theta^(j-i)
J_ij, j <= i, by Delta J Delta^-1, Delta = diag(1, 1/theta, .., 1/theta^(n-1)). For a triangular J this is analytic in
1/theta, with the norm |J| on the unit circle, so that its norm is at most |J| for theta >= 1 (maximum modulus). For
several outputs Delta is that of their chains' alignment (`scaling`), and rows read states of no higher power of theta.

2. The error of a high gain on the uniform form against the plant, and one quadratic Lyapunov function for it.

    z' = F(z, u) + diag(g_1, .., g_n) (y - h(z, u)),   F_k = s_k z_(k+1) + b_k(sat z, u),   y = a z_1 + c
    g_i = theta^i K_i/(a F_1' .. F_(i-1)') at (sat z, u),   F_k' = dF_k/dz_(k+1)

s_k is a number between the ends of the range of F_k'. So F_k continues beyond the ranges, and its mean slope from the
plant's state to any estimate is in the same range. With e = z - x, exactly, in e_i s_1 .. s_(i-1)/theta^(i-1),

    e' = (theta (N - diag(K_1, K_2 q_1, K_3 q_1 q_2, ..) 1 C) + slopes) e,   q_k in the range of s_k/F_k'

N the shift. The slopes are those of b: of F_k in z_(k+1), which do not depend on theta, and in z_j, j <= k, which
shrink as theta grows and whose ranges hold 0. So one P > 0 that is valid for all of them at some theta is valid for
every larger one, with a rate that grows with theta. The matrix is affine in each slope and in each q_k, so it is in the
hull of the matrices at all combinations of their ends. Few combinations are all checked; for many, each slope has a
multiplier, and each K_i q_1 .. q_(i-1) is a slope of its own (`convergence`). The difference of two estimates obeys no
such equation, as it holds (g(z) - g(z~)) (y - h(z~)).
"""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import Evidence, enclosure, outward
from hgogen.analysis.ranges import chains, cut_reason, fixed_parameters, span
from hgogen.analysis.scaling import ALIGNED, error_shares, exponents, heads, output_weights, sharing
from hgogen.analysis.undefined import part_without_value
from hgogen.check import Verdict
from hgogen.estimators.gains import as_matrix
from hgogen.estimators.integrators import Integrators
from hgogen.form import Form
from hgogen.prove.inclusion import Inclusion, Layout, Nothing, Slope, field_row
from hgogen.prove.inequality import few_corners
from hgogen.prove.quadratic import (
    Array,
    fractions,
    rational,
)
from hgogen.prove.semidefinite import STATES
from hgogen.rigor import tape
from hgogen.rigor.bounds import Proof, Range
from hgogen.rigor.box import exact, largest_exponent
from hgogen.rigor.definite import Matrix, root
from hgogen.rigor.slope import JUMPS
from hgogen.rigor.tape import with_norms
from hgogen.sentence import NONE, Reason, because

GROWTHS = (Fraction(1), Fraction(1, 2), Fraction(1, 4), Fraction(1, 8))  # ratios of the scales of consecutive states
_BOXES = 500  # enough for L_b, which need not be tight


def slope(form: Form, scale: Sequence[sp.Expr]) -> Proof | Nothing:
    """Return a proved upper bound of |S db/dz S^-1| on the box, db/dz the Jacobian of the form's nonlinear part and S
    the diagonal matrix of `scale` (n), numbers or expressions of parameters; or the reason why there is none, such as a
    form that is not triangular."""
    reason = obstacle(form)
    if reason:
        return Nothing(reason)
    slopes = jacobian(form)  # the Frobenius norm of S J S^-1 is at least the spectral one
    square = sp.Add(*((scale[i] * slopes[i, j] / scale[j]) ** 2 for i in range(form.n) for j in range(form.n)))
    enclosure = span(square, form, _BOXES)
    if not (enclosure and enclosure.defined and enclosure.finite):
        return Nothing(because("no bound L_b on the slope of b was found on the box"))
    return Proof(form.b, None, root(Fraction(max(enclosure.high, 0.0))), enclosure.variables, enclosure.tree)


@lru_cache(maxsize=32)  # a search calls it for each gain
def obstacle(form: Form, endless: bool = False) -> Reason:
    """Return the reason why a high-gain observer on this form can have no proof of convergence, such as a check of the
    form that is not proved; `NONE` where it may have one. `endless`: whether partial derivatives of b may be unbounded
    on one side."""
    if len(form.output) > 1 and (form.alignment not in ALIGNED or len(form.blocks) != len(form.output)):
        return because("the bound of several outputs is for chains aligned at the top or at the end")
    if limited := cut_reason(form):
        return limited
    if form.jacobian is not None:
        return because("the bound is for an observer in the coordinates of the form, this one stays in the plant's")
    if form.behind is not None:
        return because("the bound is for a gain that acts on z itself, with b a function of z")
    if form.n > STATES:
        return because("the bound is computed for up to {most} states", most=STATES)
    others = (check for check in form.checks if not (endless and check.id.fact == "lipschitz"))
    open_ = [check.id for check in others if check.verdict is not Verdict.PROVED]
    if open_:
        return because("the bound rests on {check}, which is not proved", check=open_[0])
    part = (
        part_without_value(form.system) if endless else None
    )  # b may jump at a pole of it, without effect on its slope
    if part is not None:
        return because("{part} of the plant is not shown to have a value on the box", part=part)
    return _no_triangle(form)


def _no_triangle(form: Form) -> Reason:
    """Return why z' = A z + b, y is not triangular, z_i' = a_(i+1)
    z_(i+1) + b_i(z_1, .., z_i, u), y = a_1 z_1 + c(u); `NONE` if it is."""
    known, power, heads = {*form.system.inputs, *form.system.parameters}, exponents(form), form.heads
    for i in range(form.n):
        for j in range(form.n):
            if form.A[i, j] != 0 and (j != i + 1 or j in heads or form.A[i, j].free_symbols - known):
                pattern = "A[{i}, {j}] = {entry} has no place in the triangular form"
                return because(pattern, i=i + 1, j=j + 1, entry=form.A[i, j])
        if not form.b[i].free_symbols <= {z for z, k in zip(form.states, power, strict=True) if k <= power[i]} | known:
            return because("b_{i} = {row} reads more than z_1..z_{i}", i=i + 1, row=form.b[i])
    for k, first in ((k, chain[0]) for k, chain in enumerate(chains(form)) if chain):
        output, head = form.output[k], heads[k]
        offset = output - sp.diff(output, form.states[head]) * form.states[head]
        if (sp.expand(offset).free_symbols | first.free_symbols) & {*form.states}:
            return because("the output {output} is not a_1 z_1 + c(u)", output=output)
    return NONE


def jacobian(form: Form) -> sp.Matrix:
    """Return the Jacobian db/dz (n, n) of the form's nonlinear part as expressions; parameters without a range have
    their values."""
    b = sp.Matrix([exact(sp.sympify(row).xreplace(fixed_parameters(form))) for row in form.b])
    return b.jacobian(sp.Matrix(form.states))


def companions(p: Sequence[Fraction], blocks: Sequence[int]) -> Matrix:
    """Return the block diagonal matrix (n, n) of the companion matrices of several polynomials: `p` (n) are their
    coefficients after the leading 1, `blocks` the degrees of the polynomials."""
    n, heads = range(len(p)), [sum(blocks[:i]) for i, size in enumerate(blocks) for _ in range(size)]
    inner = [[Fraction(int(j == i + 1 and heads[i] == heads[j])) for j in n] for i in n]
    return tuple(tuple(inner[i][j] - (p[i] if j == heads[i] else 0) for j in n) for i in n)


_SLOPE_BOXES = 2_000  # for the range of one slope
_STEEPEST = sys.float_info.max / 4  # the largest end of a range, which is widened later
_LOOSE = 1e-9  # relative widening of a range that holds 0, so that a weaker arithmetic proves it


@lru_cache(maxsize=32)  # a search calls it for each gain
def _slopes_of(form: Form, layout: Layout, scale: tuple[sp.Expr, ...], endless: bool) -> tuple[Slope, ...] | Reason:
    """Return the uncertain slopes of an observer's error: each partial derivative db_i/dz_j, in units of e, with its
    proved range, widened to contain 0; or the reason why one has no range. `layout`, `scale` (n): as of `Inclusion`;
    `endless`: whether a range may be unbounded on one side."""
    slopes, powers, J = [], exponents(form), jacobian(form)
    nodes = (node for row in map(with_norms, form.b) for node in row.atoms(*JUMPS))
    jumps = sorted(str(node) for node in nodes if node.has(*form.states))
    if endless and jumps:
        return because("{part} may jump", part=jumps[0])
    for i, (j, z) in product(range(form.n), enumerate(form.states)):
        slope = scale[i] / scale[j] * J[i, j]
        if slope == 0:
            continue
        known = span(slope, form, _SLOPE_BOXES)
        if not (known and known.defined and (known.finite or endless)) or known.low == -math.inf == -known.high:
            return because("db_{i}/d{z} = {slope} has no finite range on the box", i=i + 1, z=z, slope=slope)
        if any(_STEEPEST < abs(end) < math.inf for end in (known.low, known.high)):
            return because(
                "db_{i}/d{z} = {slope} is beyond the range of a double on the box", i=i + 1, z=z, slope=slope
            )
        onto = tuple(Fraction(int(fed and index == i)) for fed, index in zip(layout.fed, layout.index, strict=True))
        # the ends of the range, which holds 0, and the sign of an infinite end (`Slope.endless`)
        sides = [end for end in (known.low, known.high) if math.isfinite(end)]
        loose = _LOOSE * (max(*sides, 0.0) - min(*sides, 0.0))
        low, high = min(outward(sides[0] - loose, -1), Fraction(0)), max(outward(sides[-1] + loose, 1), Fraction(0))
        way = (known.high == math.inf) - (known.low == -math.inf)
        low, high = high if way < 0 else low, low if way > 0 else high
        reads, degree = field_row(layout.picks[j], len(onto)), powers[i] - powers[j]
        slopes.append(Slope(reads, onto, low, high, degree, endless=way, entry=(i, j), range=known))
    return tuple(slopes)


def inclusion(
    form: Form,
    layout: Layout,
    core: Array | Matrix,
    measured: Array,
    scale: Sequence[sp.Expr],
    units: Sequence[Fraction],
    numbers: Mapping[str, Any],
    others: Iterable[Slope] = (),
    endless: bool = False,
) -> Inclusion | Nothing:
    """Return the error dynamics (`Inclusion`) of an observer on a form in chains, e = diag(`scale`) times the errors of
    z.

    `core` (N, N): the matrix of the linear part at theta = 1, in coordinates scale/units times z; `measured` (N, p):
    the matrix of the samples' errors there; `scale` (n): expressions of parameters; `units` (n): the numbers s_i of e;
    `numbers`: the observer's arguments; `others`: uncertain slopes of the linear part; `endless`: whether slopes of b
    may be unbounded on one side.
    """
    slopes = _slopes_of(form, layout, tuple(scale), endless)
    if isinstance(slopes, Reason):
        return Nothing(slopes)
    t, nothing = [units[i] for i in layout.index], (Fraction(0),) * measured.shape[1]
    scaled = rational(core) * np.outer(rational(t), 1 / rational(t))
    for slope in others:
        read = t[slope.reads.index(Fraction(1))]  # the unit of the field that the slope reads
        slopes = (*slopes, replace(slope, onto=tuple(x * unit_ / read for x, unit_ in zip(slope.onto, t, strict=True))))
    injected = rational(measured) * rational(t)[:, None]
    powers, heads_by_output, evidence = exponents(form), heads(form), {"units": tuple(units)}
    late = tuple(powers[heads_by_output[j]] if j in heads_by_output else 0 for j in range(measured.shape[1]))
    each = tuple(replace(slope, takes=nothing) for slope in slopes)
    return Inclusion(scaled, injected, each, layout, tuple(units), tuple(scale), numbers, evidence, late)


def on_integrators(
    chain: Integrators,
    layout: Layout,
    core: np.ndarray | Matrix,
    measured: np.ndarray,
    numbers: Mapping[str, Any],
    gates: Iterable[tuple[int, np.ndarray]] = (),
    endless: bool = False,
) -> Inclusion | Nothing:
    """Return the error dynamics of an observer on a chain of integrators w, in errors of w in `nominal_units`; or the
    reason why there are none.

    `layout`: the states to which the N components of the error belong; `core` (N, N), `measured` (N, p): the matrices
    of the error and of the samples' errors at theta = 1; `numbers`: the observer's arguments; `gates`: the indices of
    errors that pass a saturation, whose uncertain factor is in [0, 1], each with its column of `core`; `endless`:
    whether partial derivatives of b may be unbounded on one side.
    """
    reason = obstacle(chain.form, endless)
    if reason:
        return Nothing(reason)
    units = nominal_units(chain)
    if isinstance(units, Nothing):
        return units
    scale = from_form(chain.form, units)
    zero, one = Fraction(0), Fraction(1)
    shares = (
        Slope(field_row(gated, len(column)), tuple(map(Fraction, column.tolist())), zero, one, -1, realised=one)
        for gated, column in gates
    )
    error = inclusion(chain.form, layout, core, measured, scale, units, numbers, shares, endless)
    return error if isinstance(error, Nothing) else replace(error, chained=True)


def nominal_units(chain: Integrators) -> list[Fraction] | Nothing:
    """Return numbers s_i (n) close to 1/(a_1 .. a_i) at the nominal parameters, with which s_i w_i is close to z_i, w
    the coordinates of integrators; or the reason why there are none."""
    units = [Fraction(f"{float(1 / product):.6g}") for product in chain.nominal]
    if any(unit_ <= 0 for unit_ in units):
        return Nothing(because("the bound is for a_i shown to be positive"))
    return units


def from_form(form: Form, units: Sequence[Fraction]) -> tuple[sp.Expr, ...]:
    """Return the factors s_i a_1 .. a_i (n) that scale z_i to s_i w_i, where w are the coordinates of integrators, w_i'
    = w_(i+1) + .., a_i the gains of each chain, and s the `units` (n)."""
    products = (sp.Mul(*each[: i + 1]) for each in chains(form) for i in range(len(each)))
    return tuple(sp.Rational(s) * product for s, product in zip(units, products, strict=True))


def on_companion(
    chain: Integrators, p: Sequence[float], weights: Sequence[float] | None = None, endless: bool = False
) -> Inclusion | Nothing:
    """Return the error dynamics of an observer whose gains are p_i/(a_1 .. a_i), a_i the gains of its chains; or the
    reason why there are none. `p` (n): the coefficients of the chains' characteristic polynomials; `weights` (p): those
    of outputs in the mean of the outputs that measure the same state, by default equal ones; `endless`: whether partial
    derivatives of b may be unbounded on one side."""
    form, exactly = chain.form, [Fraction(x) for x in p]
    weights = weights or output_weights(form, None)
    products = from_form(form, [Fraction(1)] * form.n)
    numbers = {"gains": tuple(sp.Rational(x) / a for x, a in zip(exactly, products, strict=True))}
    numbers |= _weights(form, weights)
    measured = as_matrix(form, exactly) @ error_shares(form, weights)
    error = on_integrators(chain, plain(form), companions(exactly, form.blocks), measured, numbers, endless=endless)
    return (
        error
        if isinstance(error, Nothing)
        else replace(error, core_evidence={"core": fractions(error.N)}, chained=False)
    )


def with_gains(
    form: Form, K: Sequence[Fraction], weights: Sequence[float] | None = None, endless: bool = False
) -> Inclusion | Nothing:
    """Return the error dynamics of an observer with a constant gain `K` (n, or n q in the order of `columns`) in the
    coordinates z, where the gains a_i of the chains may vary with inputs; or the reason why there are none. `weights`
    (p): those of outputs in the mean of the outputs that measure the same state, by default equal ones; `endless`:
    whether partial derivatives of b may be unbounded on one side."""
    reason = obstacle(form, endless)
    if reason:
        return Nothing(reason)
    n, each, gain = form.n, [a for chain in chains(form) for a in chain], as_matrix(form, K)
    heads = [form.heads[k] for k in form.leads]
    onto = [-gain[:, heads.index(at)] if at in heads else np.arange(n) == at - 1 for at in range(n)]
    core, slopes, ranges = np.zeros((n, n), dtype=object), list[Slope](), list[Evidence | None]()
    varying = not all(a.is_Rational for a in each)
    for at, a in enumerate(each):
        known = span(a, form)
        if not (known and known.defined and known.finite):
            return Nothing(because("a = {a} has no finite range on the box", a=a))
        if not varying:
            core[:, at] = [Fraction(a.p, a.q) * Fraction(x) for x in onto[at].tolist()]
            continue
        ranges.append(enclosure(form, a, known))
        ends = (Fraction(a.p, a.q),) * 2 if a.is_Rational else (outward(known.low, -1), outward(known.high, 1))
        slopes.append(Slope(field_row(at, n), tuple(map(Fraction, onto[at].tolist())), *ends, -1, realised=None))
    weights = weights or output_weights(form, None)
    numbers = {"gains": tuple(map(sp.Rational, K)), **_weights(form, weights)}
    one, ones = [Fraction(1)] * n, [sp.S.One] * n
    error = inclusion(form, plain(form), core, gain @ error_shares(form, weights), ones, one, numbers, slopes, endless)
    if isinstance(error, Nothing):
        return error
    return replace(error, core_evidence={"ranges": ranges} if varying else {"core": fractions(error.N)})


def _weights(form: Form, weights: Sequence[float]) -> dict[str, tuple[Fraction, ...]]:
    return {"weights": tuple(map(Fraction, weights))} if sharing(form) else {}


def plain(form: Form) -> Layout:
    """Return the `Layout` of an observer without filters: component k of the error e belongs to state k of the form."""
    return Layout(tuple(range(form.n)), exponents(form), (True,) * form.n, tuple(range(form.n)))


UNIFORM_STATES = 6  # above, the search for P is too slow for a check
_OPERATIONS, _EXPONENT = 100, 100  # limits of a slope that is factored
Shares = list[tuple[Fraction, Fraction]]  # the range of each q_k


def slopes_on(form: Form) -> tuple[sp.Expr, ...]:
    """Return the partial derivatives dF_k/dz_(k+1), k = 1, .., n - 1, of a form z' = F(z, u); parameters without a
    range have their values."""
    known, slopes = dict(fixed_parameters(form)), []
    for row, z in zip(form.flow, form.states[1:], strict=False):
        each = exact(tape.slope(sp.sympify(row), z).xreplace(known))
        # factors repeat variables less often, for narrower ranges; large expressions are not factored
        brief = sp.count_ops(each) <= _OPERATIONS and largest_exponent(each) <= _EXPONENT
        slopes.append(sp.factor(each) if brief else each)
    return tuple(slopes)


def middles(form: Form) -> tuple[sp.Rational, ...] | Reason:
    """Return constants s_k with few digits in the ranges of dF_k/dz_(k+1), k = 1, .., n - 1, of a form z' = F(z, u); or
    the reason why there are none, such as a range that contains 0."""
    numbers = []
    for k, each in enumerate(slopes_on(form), 1):
        known = _range(each, form)
        if known is None or known.low <= 0 <= known.high:
            return because("F_{k}' = {slope} has no finite range that keeps off zero on the box", k=k, slope=each)
        middle = math.copysign(math.sqrt(known.low * known.high), known.low)
        rounded = sp.Rational(f"{middle:.3g}")
        numbers.append(rounded if known.low <= rounded <= known.high else sp.Rational(Fraction(middle)))
    return tuple(numbers)


def uniform_error(form: Form, K: Sequence[float]) -> Inclusion | Nothing:
    """Return the error dynamics of the observer with the gains theta^i K_i/(F_1' .. F_(i-1)'), F_k' = dF_k/dz_(k+1), on
    a form in uniform coordinates; or the reason why it has no proof. `K` (n); the form's A has the constants s_k of
    `middles` above its diagonal."""
    if form.n > UNIFORM_STATES:
        return Nothing(because("the bound is computed for up to {most} states", most=UNIFORM_STATES))
    open_ = [check.id for check in form.checks if check.verdict is not Verdict.PROVED]
    if open_:
        return Nothing(because("the bound rests on {check}, which is not proved", check=open_[0]))
    gains, known = tuple(map(Fraction, K)), _shares(form)
    if isinstance(known, Nothing):
        return known
    shares, ranges = known
    n, units = form.n, [Fraction(1)]
    A = np.array([[Fraction(str(form.A[i, j])) for j in range(n)] for i in range(n)], dtype=object)
    for k in range(n - 1):
        units.append(units[-1] * A[k, k + 1])
    scale = tuple(map(sp.Rational, units))
    error = inclusion(form, plain(form), A, np.zeros((n, 0)), scale, units, {"gains": gains})
    if isinstance(error, Nothing):
        return error
    # each K_i q_1 .. q_(i-1) is a slope of its own
    every = [_injected(gains, q) for q in product(*shares)]
    ends = [(min(each), max(each)) for each in zip(*every, strict=True)]
    first = field_row(0, n)
    pushes = tuple(Slope(first, tuple(Fraction(-int(k == i)) for k in range(n)), *ends[i], -1) for i in range(n))
    hull = _together(len(error.varying), pushes, gains, shares)
    return replace(error, slopes=(*error.slopes, *pushes), core_evidence={"shares": ranges}, hull=hull)


def _shares(form: Form) -> tuple[Shares, list[Evidence | None]] | Nothing:
    """Return the range of each q_k = s_k/F_k', F_k' = dF_k/dz_(k+1),
    and the evidence for that of 1/F_k'; or why one has none."""
    shares, ranges = Shares(), list[Evidence | None]()
    for k, dF in enumerate(slopes_on(form)):
        inverse, s = exact(sp.sympify(1 / dF)), Fraction(str(form.A[k, k + 1]))
        known = _range(inverse, form)
        if known is None:
            return Nothing(because("1/({slope}) has no finite range on the box", slope=dF))
        ranges.append(enclosure(form, inverse, known))
        number = Fraction(str(inverse)) if inverse.is_Rational else None
        ends = [outward(known.low, -1), outward(known.high, 1)] if number is None else [number] * 2
        low, high = sorted(s * end for end in ends)
        shares.append((low, high))
    return shares, ranges


def _together(
    of_b: int, pushes: Sequence[Slope], gains: Sequence[Fraction], shares: Shares
) -> tuple[tuple[Fraction, ...], ...]:
    """Return the points of [-1, 1]^m at all combinations of the ends of `of_b`
    partial derivatives of b and of the q_k in `shares`, in each range of
    the gains `pushes`, K_i q_1 .. q_(i-1); () if they are too many."""
    ends = [sorted(set(pair)) for pair in shares]
    if not few_corners(len(gains), of_b + sum(len(pair) > 1 for pair in ends)):
        return ()
    places = [
        tuple(
            (2 * x - push.low - push.high) / (push.high - push.low)
            for x, push in zip(_injected(gains, q), pushes, strict=True)
            if push.low < push.high
        )
        for q in product(*ends)
    ]
    signs = product((Fraction(-1), Fraction(1)), repeat=of_b)
    return tuple((*d, *place) for d in signs for place in places)


def _injected(gains: Sequence[Fraction], q: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Return K_1, K_2 q_1, K_3 q_1 q_2, .., K the `gains`."""
    return tuple(k * math.prod(q[:i]) for i, k in enumerate(gains))


def _range(expression: sp.Expr, form: Form) -> Range | None:
    known = span(expression, form)
    return known if known and known.defined and known.finite else None
