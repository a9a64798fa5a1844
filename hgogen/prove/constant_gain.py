"""Constant gains of high-gain observers on chains, from poles or as given, with an injection into the argument of b.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)

Poles make K_j = p_j/(a_1..a_j), p the coefficients of their polynomial: the linear error core has theta times them,
whatever the parameters. A gain K as given also allows an A(u) and C(u): A - K C is Hurwitz at the ends of the ranges of
all a_j, by exact test; `convergence` proves one quadratic Lyapunov function for every u. A gain for several chains is
one sequence for each, which acts on the output of its own chain, or a matrix, whose rows act on all outputs.

With an output error in the argument of b:

    z' = A z + b(sat(z + N_theta (y - C z)), u) + ..,   N_theta = theta^(p(j) - p(k)) N_jk

p(j) is the power of theta that scales z_j, p(k) that of the first state of chain k. b then reads in place of z_j

    e_j - N_jk (a_(k,1) e_k - v_k),   e_k the error of the first state of chain k, v_k that of the sample

with the same slopes. With N_jk = 1/a_(k,1) in the row of that state, b reads the sample in its place. Source: Arcak,
Kokotovic, "Nonlinear observers: a circle criterion design and robustness analysis", Automatica 37 (2001).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sp

from hgogen.analysis.ranges import chains, fixed_parameters, several_corners
from hgogen.analysis.scaling import error_shares, output_weights
from hgogen.estimators.gains import ScaledGain, as_matrix, coefficients, columns
from hgogen.estimators.integrators import Integrators, companion, demand_divisor, demand_linear_rows, no_chain
from hgogen.form import Form
from hgogen.prove.error_models import on_companion, with_gains
from hgogen.prove.inclusion import Inclusion, Nothing, Slope, field_row
from hgogen.reading.given import BadGain, reals
from hgogen.rigor.box import exact
from hgogen.rigor.definite import demand_hurwitz
from hgogen.sentence import NONE, Reason, because


def argument_obstacle(form: Form) -> Reason:
    """Return the reason why an observer on this form cannot evaluate the nonlinear part b at z + N (y - C z) instead of
    z; `NONE` where it can."""
    if form.jacobian is not None:
        return because("it works in chains, and this form keeps the plant's coordinates")
    if any(a.free_symbols & {*form.system.inputs} for chain in form.gains for a in chain):
        return because("it is for a_i that do not move with an input")
    return NONE


def sample_in_place(form: Form) -> tuple[sp.Expr, ...]:
    """Return the gain N (n) with which b(z + N (y - C z)) uses the measured value of each chain's first state in place
    of its estimate: 1/a_1 at this state, y = a_1 z_1, else 0. The entries are expressions of parameters."""
    return tuple(1 / a if i == 0 else sp.S.Zero for chain in chains(form) for i, a in enumerate(chain))


def numbers_in_place(form: Form) -> list[float]:
    """Return the gain N (n) of `sample_in_place` in floats, at the nominal parameters."""
    return [float(sp.sympify(entry).subs(form.system.nominal)) for entry in sample_in_place(form)]


def injected(error: Inclusion | Nothing, form: Form, entries: Sequence[sp.Expr]) -> Inclusion | Nothing:
    """Return the error dynamics of an observer in which the argument of b is z + N (y - C z) instead of z, from the
    `error` dynamics with the argument z. `entries`: those of N (n, or n q in the order of `columns`), numbers or
    expressions of parameters."""
    if isinstance(error, Nothing):
        return error
    read = _by_field(form, error, as_matrix(form, entries))
    if isinstance(read, Reason):
        return Nothing(read)
    placed = zip(columns(form, len(entries)), entries, strict=True)
    scaled = [_number(error.scale[at.row] * entry, form) for at, entry in placed]
    known = [value for value in scaled if value is not None]
    if len(known) < len(scaled) or not error.B.size:
        error, samples = error.without_samples, np.zeros((form.n, 0))
    else:
        samples = as_matrix(form, known) @ error_shares(form, output_weights(form, None))
    slopes = list[Slope]()
    for slope in error.slopes:  # slopes of b read the argument of b, and so the samples
        at = None if slope.entry is None else slope.reads.index(1)
        slopes.append(slope if at is None else replace(slope, reads=tuple(read[at]), takes=tuple(samples[at])))
    return replace(error, slopes=tuple(slopes), numbers={**error.numbers, "argument": tuple(entries)})


def bounded(error: Inclusion | Nothing, form: Form) -> Inclusion | Nothing:
    """Return the `error` dynamics unchanged, or `Nothing` if a partial derivative of b is unbounded: then no discrete
    step can be proved to contract."""
    if isinstance(error, Nothing) or not error.endless:
        return error
    i, j = error.endless[0].entry or (0, 0)
    pattern = "db_{i}/d{z} has no bound on the ranges, for which a proof is in continuous time alone"
    return Nothing(because(pattern, i=i + 1, z=form.states[j]))


def _by_field(form: Form, error: Inclusion, N: np.ndarray) -> list[list[Fraction]] | Reason:
    """Return, for each state z_j, the row (n) of e_j - sum_k N_jk a_(k,1) e_k, e_k the error
    of the first state of chain k: the argument error of b for a gain N in its argument."""
    rows = [list(field_row(i, form.n)) for i in range(form.n)]
    for k, chain in ((k, chains(form)[k]) for k in form.leads):
        head = form.heads[k]
        for j, row in enumerate(rows):
            share = N[j, form.leads.index(k)] * chain[0] * error.scale[j] / error.scale[head]
            known = _number(share, form)
            if known is None:
                return because("what is injected into the argument of b is {share} of an error, no number", share=share)
            row[head] -= known
    return rows


def _number(value: Any, form: Form) -> Fraction | None:
    known = sp.cancel(exact(sp.sympify(value).xreplace(fixed_parameters(form))))
    return Fraction(known.p, known.q) if known.is_Rational else None


Chain = tuple[sp.Expr, ...]


@dataclass(frozen=True, eq=False)
class ConstantGain:
    """A gain `K` of the observer z' = A z + b + K (y - C z), with the `error` dynamics of this observer. `driven`:
    whether A or C depends on an input; `vertices` (k, n, n): in this case the matrices A - K C at the ends of the
    ranges of the chain's gains a_i."""

    K: ScaledGain
    driven: bool
    vertices: np.ndarray
    error: Inclusion | Nothing


def _scaled_gain(form: Form, entries: Iterable[sp.Expr]) -> ScaledGain:
    values = tuple(entries)
    return ScaledGain("K", values, columns(form, len(values)), "observer gain")


def constant_gain(
    observer: str, form: Form, poles: Any, gains: Any, weights: Sequence[float], endless: bool = False
) -> ConstantGain:
    """Return the gain K of the observer z' = A z + b + K (y - C z) on a form in chains.

    It is computed from the `poles` of A - K C, or has the entries `gains`; exactly one of the two is not None. Either
    is a sequence (n), for several outputs one for each; `gains` may be a matrix (n, q), with a column for the output of
    each of q chains. `weights` (p): those of outputs in the mean of the outputs that measure the same state; `endless`:
    whether partial derivatives of b may be unbounded on one side. Raises: `BadGain`, `BadPoles`, `NotHurwitz`.
    """
    if (poles is None) == (gains is None):
        raise BadGain(observer, "takes either the poles of A - K C or the gains K; give one of the two")
    make, numbers = (_from_poles, poles) if gains is None else (_from_gains, gains)
    return make(form, constant_chains(observer, form), numbers, weights, endless)


def _from_poles(
    form: Form, each: tuple[tuple[sp.Expr, ...], ...], poles: Any, weights: Sequence[float], endless: bool
) -> ConstantGain:
    for names, chain in zip(form.gain_names, each, strict=True):
        for name, a in zip(names, chain, strict=True):
            if a.free_symbols & {*form.system.inputs}:
                raise BadGain(
                    f"{name} = {a}", "depends on the input, poles want it constant; give gains, or use riccati"
                )
            demand_divisor(name, a, form)
    sizes = tuple(len(chain) for chain in each if chain)
    p = list[float]()
    for chain_poles, n in zip(_split("poles", poles, sizes), sizes, strict=True):
        rounded = coefficients(chain_poles, n)
        # rounding may move poles across the edge, so the rounded ones are proved to decay
        demand_hurwitz("poles, rounded to doubles", companion(rounded), "take them further to the left")
        p.extend(rounded)
    products = [sp.prod(chain[: j + 1]) for chain in each for j in range(len(chain))]
    K = (sp.Float(x) / a for x, a in zip(p, products, strict=True))
    error = on_companion(Integrators(form, form.gains), tuple(p), weights, endless)
    return ConstantGain(_scaled_gain(form, K), False, np.empty((0, form.n, form.n)), error)


def _from_gains(
    form: Form, each: tuple[tuple[sp.Expr, ...], ...], gains: Any, weights: Sequence[float], endless: bool
) -> ConstantGain:
    if isinstance(gains, Nothing):
        raise BadGain("gains", f"were not found: {gains.reason}")
    K, ends = list[float](), []
    for group, k in _groups("gains", gains, [chain for chain in each if chain]):
        vertices = several_corners(group, form)
        if isinstance(vertices, Reason):
            raise BadGain(f"gains = {gains!r}", f"cannot be judged: {vertices}; declare ranges, or use riccati")
        gain = np.array([[Fraction(x) for x in row] for row in k.tolist()], dtype=object)
        closed = [A - gain @ C for A, C in vertices]
        fix = "take others for the ranges of the a_i, such as hg.design.constant_gain(form)"
        for matrix in closed:
            demand_hurwitz("gains", matrix, fix)
        K.extend(k.ravel().tolist())
        ends.append(np.array(closed, dtype=float))
    driven = any(a.free_symbols & {*form.system.inputs} for chain in each for a in chain)
    error = with_gains(form, [*map(Fraction, K)], weights, endless)
    return ConstantGain(_scaled_gain(form, map(sp.Float, K)), driven, _stacked(ends), error)


def entries_of(what: str, values: Any, form: Form) -> tuple[float, ...]:
    """Return the entries of a gain as one flat tuple (n, or n q in the order of `columns`), from a sequence for each
    chain, or from a matrix (n, q). `what`: the argument's name in an error. Raises: `BadGain`."""
    groups = _groups(what, values, [chain for chain in chains(form) if chain])
    return tuple(x for _, k in groups for x in k.ravel().tolist())


def _groups(what: str, gains: Any, each: Sequence[Chain]) -> Iterator[tuple[Sequence[Chain], np.ndarray]]:
    sizes = tuple(map(len, each))
    n, q = sum(sizes), len(sizes)
    whole = _shape(gains) == (n, q)
    parts = (gains,) if whole else _split(what, gains, sizes, f", or a matrix of {n} x {q}")
    groups = [each] if whole else [[chain] for chain in each]
    for group, values in zip(groups, parts, strict=True):
        k, rows = reals(what, values), sum(map(len, group))
        if k.shape not in ((rows, len(group)), (rows,) * (len(group) == 1)) or not np.isfinite(k).all():
            shape = f"{n} x {q}" if whole and q > 1 else " and ".join(map(str, sizes))
            raise BadGain(f"{what} = {gains!r}", f"must be {shape} finite numbers")
        yield group, k.reshape(rows, len(group))


def _shape(values: Any) -> tuple[int, ...]:
    try:
        return np.shape(values)
    except ValueError:
        return ()


def _stacked(ends: list[np.ndarray]) -> np.ndarray:
    """Return matrices (k, n, n) with the groups' matrices (k_i, n_i, n_i) along the diagonal;
    they have all eigenvalues of the groups, but not all combinations of groups."""
    n, most = sum(each.shape[1] for each in ends), max(map(len, ends))
    stacked = np.zeros((most, n, n))
    for each, (head, end) in zip(ends, pairwise(np.cumsum([0, *(each.shape[1] for each in ends)])), strict=True):
        stacked[:, head:end, head:end] = each[np.arange(most) % len(each)]
    return stacked


def _split(what: str, values: Any, sizes: tuple[int, ...], instead: str = "") -> Sequence[Any]:
    if len(sizes) == 1:
        return (values,)
    count = len(values) if isinstance(values, Sequence | np.ndarray) and not isinstance(values, str) else 0
    if count != len(sizes) or any(len(_shape(each)) != 1 for each in values):
        known = f"must be {len(sizes)} sequences, one for each output with a chain{instead}"
        raise BadGain(f"{what} = {values!r}", known)
    return tuple(values)


def constant_chains(observer: str, form: Form) -> tuple[tuple[sp.Expr, ...], ...]:
    """Return, for each output, the gains a_1, a_2, .. of its chain y = a_1 z_1, z_i' = a_(i+1) z_(i+1) + b_i; ones for
    phase coordinates. Raises: `BadGain` where a gain depends on a state, or an output has no chain."""
    if len(form.output) != len(form.blocks):
        reason = f"takes a chain for each output, {form.system.name} has {len(form.output)} outputs and no chains"
        raise BadGain(observer, reason, fix="use the form block_triangular if the plant is in it, else riccati")
    demand_linear_rows(observer, form)
    if form.jacobian is not None:
        return ((sp.S.One,) * form.n,)
    each = chains(form)
    off = [
        (i, j) for i in range(form.n) for j in range(form.n) if form.A[i, j] != 0 and (j != i + 1 or j in form.heads)
    ]
    if off or any(a == 0 for chain in each for a in chain):
        raise no_chain(observer, form)
    for names, chain in zip(form.gain_names, each, strict=True):
        for name, a in zip(names, chain, strict=True):
            if a.free_symbols & {*form.states}:
                raise BadGain(f"{name} = {a}", "depends on the state, a constant gain wants it constant; use riccati")
    return each
