"""Certified lower bound on theta of a constant-gain observer on a triangular form.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)   converges exponentially for every
    theta > max(1, 2 lambda_max(P) L_b),   (A - K C)'P + P (A - K C) <= -I,   L_b >= |db/dz| on the box

Proof. With e = Delta (z - x), Delta = diag(1, 1/theta, .., 1/theta^(n-1)): e' = theta (A - K C) e + Delta (b(sat z) -
b(x)). The box is convex and b Lipschitz on it, so b(sat z) - b(x) = J (sat z - x) with J in the closed convex hull of
the values of db/dz: lower triangular and |J| <= L_b. sat clamps each component to an interval that holds x_i, so
|(sat z - x)_i| <= |z_i - x_i|, and |Delta (sat z - x)| <= |e|. J_ij turns into theta^(j - i) J_ij, j <= i, by Delta
J Delta^-1; for a triangular J it is analytic in 1/theta, with the norm |J| on the unit circle, so that its norm is at
most |J| for theta >= 1 (maximum modulus). Then V = e'P e has V' <= -(theta - 2 lambda_max(P) L_b) |e|^2.

The same holds in scaled coordinates S z, S diagonal, positive, constant in time: sat stays a clamp of each component,
J turns into S J S^-1. With gains K_i = p_i/(a_1..a_i), S_i = a_2..a_i makes the core the companion matrix of p whatever
the parameters; with a constant K the a_i of a range are the vertices of one inequality. So a constant gain serves an
input-driven A as well, against remark 1 of Boizot, Busvelle, Gauthier, Automatica 46 (2010). Several outputs, with the
Delta of their chains' alignment (`scaling`) and diag(theta, .., theta^(n_i)) K_i on each: Delta turns A - K C, block
diagonal, into theta times itself, and J, whose rows read states of no higher power of theta, again into powers of
1/theta, so that the proof is the same. Source of the observer:
Gauthier, Hammouri, Othman, IEEE TAC 37 (1992).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.algebra.definite import Matrix, root
from hgogen.algebra.points import exact, points
from hgogen.algebra.sampled_rows import on_arrays
from hgogen.check import Verdict
from hgogen.evidence.enclosing import enclosure, steep
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.lmi import STATES, Lyapunov, common
from hgogen.intervals import outward
from hgogen.intervals.bounds import Range
from hgogen.intervals.digits import Up
from hgogen.intervals.proof import Proof
from hgogen.reading.door import Misfit
from hgogen.sentence import NONE, Reason, because
from hgogen.structure.polytope import Corner, chains, corners, extents, fixed, signals, span
from hgogen.structure.saturation import cut
from hgogen.structure.scaling import ALIGNED, exponents

GROWTHS = (Fraction(1), Fraction(1, 2), Fraction(1, 4), Fraction(1, 8))  # of scales from state to state
# L_b need not be the least: more boxes would cost more than they bring.
_BOXES = 500
_STEPS = (Fraction(2), Fraction(5, 4))
_TRIALS = 400


@dataclass(frozen=True)
class ThetaBound:
    """A proof that every theta > `theta` = max(1, 2 `lyapunov.peak` `lipschitz`) converges.

    `scale` (n) is S and `gains` (n) is K, both of parameters; `slope` proves that `lipschitz` >= |S db/dz S^-1|.
    `ranges` are those of the a_i, chain after chain, where the vertices are at their ends.
    """

    theta: Fraction
    lyapunov: Lyapunov
    lipschitz: Fraction
    scale: tuple[sp.Expr, ...]
    slope: Proof
    gains: tuple[sp.Expr, ...]
    ranges: tuple[Range, ...] = ()

    @property
    def numbers(self) -> Mapping[str, Any]:
        """What the observer is built with."""
        return {"gains": self.gains}

    def rate(self, theta: float) -> float:
        """r (1/s) with |error(t)| <= c exp(-r t) |error(0)| at a theta above the bound; it is rounded down."""
        peak = self.lyapunov.peak
        return outward.number((Fraction(theta) - 2 * peak * self.lipschitz) / (2 * peak))[0]

    def evidence(self, form: Form) -> Evidence | None:
        """The matrix P for A - K C in scaled coordinates, and the bound of db/dz in them."""
        slope, core = steep(form, (*form.b, *self.scale), self.slope), self.lyapunov.vertices
        if slope is None:
            return None
        known: Evidence = {"core": core[0]}
        if len(core) > 1:
            gains = (a for chain in chains(form) for a in chain)
            known = {"ranges": [enclosure(form, a, within) for a, within in zip(gains, self.ranges, strict=True)]}
        return {"scale": self.scale, **known, "P": self.lyapunov.P, "peak": self.lyapunov.peak, **slope}

    @property
    def reason(self) -> Reason:
        """How the bound comes about."""
        pattern = "{theta} = max(1, 2 lambda_max(P) L_b), lambda_max(P) <= {peak}, L_b <= {L_b} in scaled states"
        return because(pattern, theta=Up(self.theta), peak=Up(self.lyapunov.peak), L_b=Up(self.lipschitz))

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class _Core:
    """A - K C in the coordinates `scale` z, at every vertex, with K = `gains` in the coordinates z."""

    scale: tuple[sp.Expr, ...]
    vertices: tuple[Matrix, ...]
    gains: tuple[sp.Expr, ...]

    def scaled(self, d: Sequence[Fraction]) -> "_Core":
        """The core in the coordinates diag(d) scale z."""
        n = range(len(d))
        vertices = tuple(tuple(tuple(d[i] * N[i][j] / d[j] for j in n) for i in n) for N in self.vertices)
        rationals = (sp.Rational(value) for value in d)
        return _Core(tuple(value * s for value, s in zip(rationals, self.scale, strict=True)), vertices, self.gains)


def of_poles(form: Form, p: Iterable[float]) -> ThetaBound | Nothing:
    """The bound for K_i = p_i/(a_1..a_i), a_i of parameters only; p (n) the coefficients of s^n + p_1 s^(n-1) + ..

    The scale is searched: first as z is at the nominal parameters, then whatever makes lambda_max(P) L_b smaller.

    Raises: `Misfit` for another number of coefficients.
    """
    reason = obstacle(form)
    if reason:
        return Nothing(reason)
    each = chains(form)
    every = [
        (name, a)
        for names, chain in zip(form.gain_names, each, strict=True)
        for name, a in zip(names, chain, strict=True)
    ]
    for name, a in every:
        if a.free_symbols - {*form.system.parameters}:
            pattern = "{name} = {a} varies with the input, so that gains from poles are not constant"
            return Nothing(because(pattern, name=name, a=a))
    for name, a in every:
        if not _positive(a, form):
            return Nothing(because("{name} = {a} is not shown to be positive", name=name, a=a))
    exactly = _exactly("of_poles, p=", p, form)
    products = [sp.Mul(*chain[: j + 1]) for chain in each for j in range(len(chain))]
    gains = tuple(sp.Rational(x) / a for x, a in zip(exactly, products, strict=True))
    scale = tuple(sp.Mul(*chain[1 : j + 1]) for chain in each for j in range(len(chain)))
    core = _Core(scale, (companions(exactly, form.blocks),), gains)
    slopes = jacobian(form)
    rounded = [Fraction(f"{float(1 / s.subs(form.system.nominal)):.6g}") for s in core.scale]
    plain = _certified(form, slopes, core.scaled(rounded))
    if isinstance(plain, Nothing):
        return plain
    better = _certified(form, slopes, core.scaled(_search(form, slopes, core)))
    return better if isinstance(better, ThetaBound) and better.theta < plain.theta else plain


def of_gains(form: Form, K: Iterable[float]) -> ThetaBound | Nothing:
    """The bound for a constant K (n), a_i of inputs and parameters: one P for the vertices of their ranges.

    Raises: `lmi.NoSolver` where the a_i have ranges and no solver is installed; `Misfit` for another number of gains.
    """
    reason = obstacle(form)
    if reason:
        return Nothing(reason)
    gain = _exactly("of_gains, K=", K, form)
    ends_by_chain = _corners(form)
    if isinstance(ends_by_chain, Reason):
        return Nothing(ends_by_chain)
    vertices = tuple(_closed(each, gain) for each in product(*ends_by_chain))
    gains = tuple(map(sp.Rational, gain))
    bound = _certified(form, jacobian(form), _Core((sp.S.One,) * form.n, vertices, gains))
    return replace(bound, ranges=_extents(form)) if isinstance(bound, ThetaBound) else bound


def _exactly(what: str, values: Iterable[float], form: Form) -> list[Fraction]:
    try:
        fractions = [Fraction(value) for value in values]
    except (TypeError, ValueError, OverflowError):
        fractions = []
    if len(fractions) != form.n:
        raise Misfit(what, values, f"{form.n} finite numbers, one for each state")
    return fractions


def slope(form: Form, scale: Sequence[sp.Expr]) -> Proof | Nothing:
    """|S db/dz S^-1| on the box from above, S the diagonal `scale` (n) of numbers and parameters, b_i of z_1, .., z_i;
    or why there is no bound, or no such form."""
    steepness = obstacle(form) or _steepness(form, jacobian(form), scale)
    return Nothing(steepness) if isinstance(steepness, Reason) else steepness


def obstacle(form: Form) -> Reason:
    """Why the theorem does not apply as it stands, or `NONE`."""
    if len(form.output) > 1 and (form.alignment not in ALIGNED or len(form.blocks) != len(form.output)):
        return because("the bound of several outputs is for chains aligned at the top or at the end")
    if limited := cut(form):
        return limited
    if form.jacobian is not None:
        return because("the bound is for an observer in the coordinates of the form, this one stays in the plant's")
    if form.behind is not None:
        return because("the bound is for a gain that acts on z itself, with b a function of z")
    if form.n > STATES:
        return because("the bound is computed for up to {most} states", most=STATES)
    open_ = [check.id for check in form.checks if check.verdict is not Verdict.PROVED]
    if open_:
        return because("the bound rests on {check}, which is not proved", check=open_[0])
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


def _positive(a: sp.Expr, form: Form) -> bool:
    enclosure = span(a, form)
    return bool(enclosure and enclosure.defined and enclosure.low > 0)


def jacobian(form: Form) -> sp.Matrix:
    """The Jacobian db/dz, with constants at their values."""
    b = sp.Matrix([exact(sp.sympify(row).xreplace(fixed(form))) for row in form.b])
    return b.jacobian(sp.Matrix(form.states))


def companions(p: Sequence[Fraction], blocks: Sequence[int]) -> Matrix:
    """The companion matrices of the blocks' polynomials along the diagonal."""
    n, heads = range(len(p)), [sum(blocks[:i]) for i, size in enumerate(blocks) for _ in range(size)]
    inner = [[Fraction(int(j == i + 1 and heads[i] == heads[j])) for j in n] for i in n]
    return tuple(tuple(inner[i][j] - (p[i] if j == heads[i] else 0) for j in n) for i in n)


def _corners(form: Form) -> list[list[Corner]] | Reason:
    """The corners of each chain; or why there are none."""
    by_chain = []
    for chain in chains(form):
        each = corners(chain, form)
        if isinstance(each, Reason):
            return each
        by_chain.append(each)
    return by_chain


def _extents(form: Form) -> tuple[Range, ...]:
    """The ranges of which `_corners` are the ends."""
    each = (extents(chain, form) for chain in chains(form))
    return tuple(known for ranges in each if not isinstance(ranges, Reason) for known in ranges)


def _closed(parts: Sequence[Corner], gain: Sequence[Fraction]) -> Matrix:
    """A - K C of the chains along the diagonal."""
    rows, head, total = [], 0, len(gain)
    for A, C in parts:
        n = range(len(C))
        for i in n:
            row = [A[i][j] - gain[head + i] * C[j] for j in n]
            rows.append((*[Fraction(0)] * head, *row, *[Fraction(0)] * (total - head - len(row))))
        head += len(C)
    return tuple(rows)


def _certified(form: Form, slopes: sp.Matrix, core: _Core) -> ThetaBound | Nothing:
    """The bound in the coordinates core.scale z."""
    steep = _steepness(form, slopes, core.scale)
    if isinstance(steep, Reason):
        return Nothing(steep)
    lyapunov = common(core.vertices)
    if lyapunov is None:
        return Nothing(because("no P with (A - K C)'P + P (A - K C) <= -I was found for the range of the a_i"))
    assert steep.high is not None
    return ThetaBound(
        max(Fraction(1), 2 * lyapunov.peak * steep.high), lyapunov, steep.high, core.scale, steep, core.gains
    )


def _steepness(form: Form, slopes: sp.Matrix, scale: Sequence[sp.Expr]) -> Proof | Reason:
    """L_b in the coordinates scale z, from above: sup of the Frobenius norm of S J S^-1 on the box; or why there is
    none."""
    square = sp.Add(*((scale[i] * slopes[i, j] / scale[j]) ** 2 for i in range(form.n) for j in range(form.n)))
    enclosure = span(square, form, _BOXES)
    if not (enclosure and enclosure.defined and enclosure.finite):
        return because("no bound L_b on the slope of b was found on the box")
    return Proof(form.b, None, root(Fraction(max(enclosure.high, 0.0))), enclosure.variables, enclosure.tree)


def _search(form: Form, slopes: sp.Matrix, core: _Core) -> tuple[Fraction, ...]:
    """A scale d (n) with a small lambda_max(P) L_b, by descent in floats at sample points: `_certified` proves it.

    A move makes the tail d_k..d_n, or d_k alone, larger or smaller by a factor.
    """
    n, free = form.n, signals(form)
    if any(not s.bounded and s not in fixed(form) for s in free):
        return (Fraction(1),) * n
    samples = _samples(slopes, core.scale, free, form)
    if samples is None:
        return (Fraction(1),) * n
    best: tuple[Fraction, ...] = (Fraction(1),) * n
    value, left = _merit(best, samples, core), _TRIALS
    for step in _STEPS:
        moved = True
        while moved and left > 0:
            moved = False
            for d in _moves(best, step):
                left -= 1
                merit = _merit(d, samples, core)
                if merit < value * (1 - 1e-6):
                    best, value, moved = d, merit, True
    return best


def _moves(d: tuple[Fraction, ...], step: Fraction) -> Iterator[tuple[Fraction, ...]]:
    for k in range(1, len(d)):
        for factor in (step, 1 / step):
            yield (*d[:k], *(factor * x for x in d[k:]))
            if k + 1 < len(d):
                yield (*d[:k], factor * d[k], *d[k + 1 :])


def _samples(
    slopes: sp.Matrix, scale: Sequence[sp.Expr], symbols: Sequence[sp.Symbol], form: Form
) -> np.ndarray | None:
    """S J S^-1 at sample points of the box, (k, n, n); None where they are not all finite."""
    n = range(form.n)
    matrix = [scale[i] * slopes[i, j] / scale[j] for i in n for j in n]
    free = [s for s in symbols if s not in fixed(form)]
    graph = on_arrays(free, matrix)
    columns = np.array([[float(point[s]) for s in free] for point in points(free)]).T.reshape(len(free), -1)
    with np.errstate(all="ignore"):
        rows = np.broadcast_arrays(*graph(*columns), np.zeros(columns.shape[1] or 1))[:-1]
    values = np.array(rows, dtype=float).T.reshape(-1, form.n, form.n)
    return values if np.isfinite(values).all() else None


def _merit(d: Sequence[Fraction], samples: np.ndarray, core: _Core) -> float:
    """lambda_max(P) L_b in floats, in the coordinates diag(d) scale z."""
    scale = np.array([float(x) for x in d])
    N = scale[:, None] * np.array([[float(x) for x in row] for row in core.vertices[0]]) / scale
    n, one = len(d), np.eye(len(d))
    try:
        P = np.linalg.solve(np.kron(N.T, one) + np.kron(one, N.T), -one.ravel()).reshape(n, n)
    except np.linalg.LinAlgError:
        return np.inf
    steep = np.linalg.norm(scale[:, None] * samples / scale, ord=2, axis=(1, 2)).max()
    return float(np.linalg.eigvalsh((P + P.T) / 2).max() * steep)
