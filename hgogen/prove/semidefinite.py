"""Weights P > 0 and S >= 0 with which quadratic forms are negative, by a cone program in floats, which proves nothing.

    margin                maximise m:   F(P, S) <= -m I for every form F,   P >= least I,   trace P <= n
    smallest_extent       minimise t:   F(P, S) <= -m I,   [t, c; c', P] >= 0 for every c,   limits on P and S
    smallest_multipliers  minimise t:   F(P, S) <= -m I for every form F,   the last of S <= t

F is linear in P and S (`quadratic`), c P^-1 c' <= t. Multiplied columns of one form with the same direction are merged
(`merge_parallel_columns`): columns p_j that enter as r_j u, and nowhere else, reduce sum_j S_j p_j^2 to its minimum for
a u = sum_j r_j p_j, which is T u^2 with the largest T that

    diag(S) - T r r' >= 0

admits. The form of (e, u), with T, is negative where that of (e, p) is. Slopes of one row of b, which all act in one
direction, become one column: a solver's work grows with the fourth power of the size or faster.

The programs are written in Clarabel's standard form, A x + s = b with s in cones: a modelling language would take
longer than the solver. Programs for gains are written as matrices that are affine in x (`solve_semidefinite_program`).

For one matrix N'P + P N = -I is solved in rationals; its solution is the smallest P with N'P + P N <= -I. It is rounded
to short rationals, with P <= peak I, and then verified in exact arithmetic. Source: Boyd, El Ghaoui, Feron,
Balakrishnan, "Linear Matrix Inequalities in System and Control Theory", SIAM (1994), 5.1.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from hgogen.errors import HgogenError
from hgogen.prove.quadratic import Array, Quadratic, ScaledForms, inverse_root
from hgogen.rigor.definite import Matrix, exact, fraction, number, one_thread, positive, unit
from hgogen.sentence import NONE, Reason, because

STATES = 12  # above, the exact Lyapunov equation has too many unknowns for a fast check

# Relative increase of P, so that rounding preserves the inequality: the smallest sufficient one.
_SLACKS = (Fraction(1, 2**24), Fraction(1, 2**16), Fraction(1, 2**8))


@dataclass(eq=False)
class NoSolver(HgogenError):
    """The error that a linear matrix inequality needs a solver which is not installed; `what`: the purpose of the
    inequality."""

    what: str

    @property
    def reason(self) -> Reason:
        """The sentence that `what` needs Clarabel, and how to install it."""
        return because("{what} needs clarabel; install it: pip install 'hgogen[lmi]'", what=self.what)

    def __str__(self) -> str:
        return str(self.reason)


def no_solver(what: str) -> Reason:
    """Return the reason that the solver Clarabel, which the purpose `what` needs, is not installed; `NONE` if it is
    installed."""
    try:
        solver_modules(what)
    except NoSolver as missing:
        return missing.reason
    return NONE


@dataclass(frozen=True)
class Lyapunov:
    """A proof of the Lyapunov inequality N'P + P N <= -I for a matrix `N` (n, n): `P` (n, n), symmetric and rational,
    and an upper bound `peak` of its largest eigenvalue."""

    P: Matrix
    peak: Fraction
    N: Matrix


def verified(candidate: Lyapunov) -> bool:
    """Return whether a `candidate` satisfies P > 0, peak I - P > 0 and -I - N'P - P N > 0, decided in exact
    arithmetic."""
    P, N, one = exact(candidate.P), exact(candidate.N), unit(len(candidate.P))
    gaps = (P, one * number(candidate.peak) - P, -one - (N.transpose() * P + P * N))
    return bool(P.transpose() == P) and all(map(positive, gaps))


def lyapunov(N: Matrix) -> Lyapunov | None:
    """Return a proved P with N'P + P N <= -I, close to the smallest one, for a rational N (n, n); None where N is not
    Hurwitz. N'P + P N = -I is a system of n (n + 1)/2 linear equations, solved in rationals."""
    n = len(N)
    places = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(n) for j in range(i, n))}
    rows = [[fmpq(0)] * len(places) for _ in places]
    for (i, j), row in places.items():
        for k in range(n):
            rows[row][places[min(k, j), max(k, j)]] += number(N[k][i])
            rows[row][places[min(i, k), max(i, k)]] += number(N[k][j])
    try:
        solution = fmpq_mat(rows).solve(fmpq_mat([[fmpq(-(i == j))] for i, j in places]))
    except ZeroDivisionError:  # two eigenvalues with the sum 0
        return None
    P = [[fraction(solution[places[min(i, j), max(i, j)], 0]) for j in range(n)] for i in range(n)]
    steepest = max([Fraction(1), *(abs(x) for row in N for x in row)])
    for slack in _SLACKS:  # round to a power of two, small enough to preserve half of the margin
        step = Fraction(1, 2 ** (int(4 * n * n * steepest / slack).bit_length()))
        grid = tuple(tuple(round((1 + slack) * value / step) * step for value in row) for row in P)
        peak = float(np.linalg.eigvalsh(np.array(grid, dtype=float)).max())
        quantum = slack * Fraction(2) ** int(np.ceil(np.log2(max(peak, 1e-300))))
        above = -(-Fraction(peak) * (1 + slack) // quantum) * quantum  # larger by one to a few slacks
        if verified(candidate := Lyapunov(grid, above, N)):
            return candidate
    return None


def gains(corners: Iterable[tuple[Matrix, Sequence[Fraction]]], largest: float) -> tuple[Fraction, ...] | None:
    """Return a gain K (n), |K| <= `largest`, with one Lyapunov matrix P for all A - K C and a small largest eigenvalue
    of P; None where the solver finds none. `corners`: A (n, n) and C (n) at the ends of their ranges.

    With Y = P K the inequality A'P + P A - Y C - C'Y' <= -I is linear; K'P K <= largest^2 p and P >= p I bound the
    gain. The result is in floats: `convergence` proves it. Raises: `NoSolver`.
    """
    pairs = [(np.array(A, dtype=float), np.array([list(map(float, C))])) for A, C in corners]
    n, p = len(pairs[0][0]), len(basis(len(pairs[0][0])))
    one = np.eye(n)

    def blocks(x: Array) -> list[Array]:
        P, Y, (least, peak) = symmetric(x[:p], n), x[p:-2, None], x[-2:]
        bounded = np.block([[P, Y], [Y.T, np.full((1, 1), largest**2 * least)]])
        falling = (-one - A.T @ P - P @ A + Y @ C + C.T @ Y.T for A, C in pairs)
        return [peak * one - P, P - least * one, bounded, *falling]

    x = solve_semidefinite_program(np.append(np.zeros(p + n + 1), 1.0), blocks, "a gain for a range of a_i")
    if x is None or np.linalg.eigvalsh(symmetric(x[:p], n)).min() <= 0:
        return None
    K = np.linalg.solve(symmetric(x[:p], n), x[p:-2])
    return tuple(Fraction(float(f"{k:.6g}")) for k in K)


def solver_modules(what: str) -> tuple[Any, Any]:
    """Return the modules `clarabel` and `scipy.sparse`. Raises: `NoSolver` with the purpose `what` where they are not
    installed."""
    try:
        import clarabel  # a slow import, seldom needed
        from scipy import sparse
    except ImportError:
        raise NoSolver(what) from None
    return clarabel, sparse


_LEAST = 1e-4  # least eigenvalue of P over the mean of all: no proof in rationals with a nearly singular P
_CLOSE = 1e-6  # accuracy of a margin
CLOSER = 1e-8
_SOLVES = 6  # the most solutions of a program in coordinates of its last one
_GAIN, _ROUND = 0.01, 4  # stop below this gain, and below this condition number of P
_ALIKE = 1e-9  # tolerance of unit directions
_USABLE = ("Solved", "AlmostSolved")  # status of a usable solution

Limits = tuple[Array, Array]  # A and b of A (P, S) <= b, P as in `upper_triangles`
Span = tuple[Array, Array]  # matrices (q, n, n), and rows (r, q) that are >= 0 on their coefficients
Rows = tuple[Array, Array, bool]  # A and b of one cone, and whether it holds matrices, or signs


@dataclass(frozen=True)
class Group:
    """A group of multipliers S_j whose columns in a form are parallel, r_j u: their indices `places`, the ratios r_j as
    `weights`, the largest 1, and the index `column` of u in the form with merged columns."""

    places: tuple[int, ...]
    weights: tuple[float, ...]
    column: int


@dataclass(frozen=True, eq=False)
class Margin:
    """The result of a margin program: the largest `margin` m with F(P, S) <= -m I for all forms F, m <= 0 where no
    weights make them negative; `P` (n, n) and `S` (k) in floats; `prices` (N, N) for each form: a small change D of the
    form reduces m by <price, D>."""

    P: Array
    S: Array
    margin: float
    prices: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a program in coordinates x, e = W x: the weights `P` (n, n) and `S` (k) in the coordinates e; the
    minimised `value`, infinite where these weights do not make the forms negative; `near`: P in the coordinates x,
    which shows the scaling of the program."""

    P: Array
    S: Array
    value: float
    near: Array


def best_solution(solve: Callable[[Array], Solution | None], W: Array) -> tuple[Array, Array] | None:
    """Return P and S with the smallest value among several solutions of one program in improving coordinates; None
    where it has no solution.

    `solve(W)` solves the program in coordinates e = W x: first in the initial `W`, then in those in which its last P is
    the unit matrix, until P is close to it or the value decreases by less than a hundredth. A solver neglects what is
    small in its coordinates: far from those of the solution its result may be several times the smallest value.
    """
    best: Solution | None = None
    for _ in range(_SOLVES):
        solution = solve(W)
        if solution is None:
            break
        before = math.inf if best is None else best.value
        best = solution if best is None or solution.value < before else best
        sizes = np.linalg.eigvalsh(solution.near)
        close = sizes[0] > 0 and sizes[-1] < _ROUND * sizes[0]
        if sizes[0] <= 0 or (solution.value < math.inf and (close or solution.value >= (1 - _GAIN) * before)):
            break
        W = W @ inverse_root(solution.near)
    return None if best is None else (best.P, best.S)


def feasible_weights(forms: Sequence[Quadratic], what: str, W: Array | None = None) -> tuple[Array, Array] | None:
    """Return P and S, in floats, for which a solver makes all `forms` negative; None where there are none. `W` (n, n):
    coordinates e = W x in which P is expected close to the unit matrix; `what`: the purpose. Raises: `NoSolver`."""
    best = largest_margin(forms, what, W)
    return (best.P, best.S) if best is not None and best.margin > 0 else None


def largest_margin(
    forms: Sequence[Quadratic], what: str, W: Array | None = None, priced: bool = False
) -> Margin | None:
    """Return the P and S with the largest margin m, F <= -m I for all `forms` F, also where m <= 0, in coordinates e =
    `W` x; None where the solver fails. `priced`: with the prices of the forms; `what`: the purpose. Raises:
    `NoSolver`."""
    if W is None:
        return margin([form.floats for form in forms], what, priced)
    view, fast = ScaledForms.paced([form.floats for form in forms], W)
    best = margin(view.forms, what, priced)
    if best is None:
        return None
    P, S = view.back(best.P, best.S)
    return replace(best, P=P, S=S * fast, margin=best.margin * fast)


@np.errstate(over="ignore", invalid="ignore")
def margin(forms: Sequence[Quadratic], what: str, priced: bool = False, span: Span | None = None) -> Margin | None:
    """Return the largest margin m, F <= -m I for all `forms` F (floats), with its P and S; None where the solver fails.
    `span`: matrices B_i and rows r with P = sum_i y_i B_i, r y >= 0, None for any P; `priced`: with the prices of the
    forms; `what`: the purpose. Parallel columns of a single form are merged. Raises: `NoSolver`."""
    n, whole = len(forms[0].pairs[0][0]), forms
    forms, groups = merge_parallel_columns(forms[0]) if len(forms) == 1 and not (priced or span) else (forms, ())
    of_forms, others = _at_most(forms, groups, 1.0, 0.0), len(whole[0].Q) + len(groups) + 1
    one = np.hstack([upper_triangles(np.eye(n)[None]).T, np.zeros((1, others))])
    trace: Rows = (one, np.array([float(n)]), False)
    rows = [*of_forms, _positive(n, others, _LEAST), trace]
    solution = _solved(whole[0], groups, rows, -1.0, CLOSER if span else _CLOSE, what, span)
    if solution is None:
        return None
    (P, S, largest), prices = solution
    ends = pairwise(np.cumsum([0, *(len(A) for A, _, _ in of_forms[: len(whole)])]))
    each = zip(ends, whole if priced else (), strict=False)
    return Margin(P, S, largest, tuple(symmetric(prices[i:j] / _weights(one.size), one.size) for (i, j), one in each))


@np.errstate(over="ignore", invalid="ignore")
def smallest_extent(
    view: ScaledForms, reads: Array, limits: Limits, by: float, unit: float, what: str
) -> Solution | None:
    """Return P and S with a small largest c P^-1 c' over the rows c of `reads` (r, n), for which the forms of the
    `view` are at most -`by` I and x/`unit` satisfies the `limits`, all in the scaled coordinates x; None where the
    solver fails. `what`: the purpose. Raises: `NoSolver`."""
    whole, (A, b) = view.forms, limits
    forms, groups = merge_parallel_columns(whole[0]) if len(whole) == 1 else (whole, ())
    of_rows = [extent_cone(c, A.shape[1] + len(groups)) for c in reads / np.linalg.norm(reads, axis=1).max()]
    others: Rows = (np.hstack([A, np.zeros((len(A), len(groups) + 1))]), b, False)
    rows = [*_at_most(forms, groups, 0.0, by), *of_rows, others]
    solution = _solved(whole[0], groups, rows, 1.0, CLOSER, what)
    if solution is None:
        return None
    P, S, _ = solution[0]
    holds = all(np.linalg.eigvalsh(M).min() > 0 for M in (P, *(-form.value(P, S) for form in whole)))
    value = np.einsum("ij,ji->i", reads, np.linalg.solve(P, reads.T)).max() / unit**2 if holds else math.inf
    known = view.back(P, S)
    return Solution(known[0] * unit**2, known[1] * unit**2, float(value), P)


@np.errstate(over="ignore", invalid="ignore")
def smallest_multipliers(forms: Sequence[Quadratic], q: int, by: float, what: str) -> tuple[Array, Array] | None:
    """Return P and S for which all `forms` (floats) are at most -`by` I, with the last `q` entries of S at most t and a
    small t; None where the solver fails. `what`: the purpose. Raises: `NoSolver`."""
    n, k = len(forms[0].pairs[0][0]), len(forms[0].Q)
    last = np.hstack([np.zeros((q, n * (n + 1) // 2 + k - q)), np.eye(q), -np.ones((q, 1))])
    rows = [*_at_most(forms, (), 0.0, by), _positive(n, k + 1, by), (last, np.zeros(q), False)]
    solution = _solved(forms[0], (), rows, 1.0, CLOSER, what)
    return solution and solution[0][:2]


def _at_most(forms: Sequence[Quadratic], groups: Sequence[Group], share: float, by: float) -> list[Rows]:
    """Return the cones F <= -(`share` t + `by`) I of all `forms` F, t the last
    variable, and diag(S) - T r r' >= (..) I of the merged `groups`."""
    rows = []
    for form in forms:
        one = np.eye(form.size)
        more = 0.0 if form.constant is None else form.constant
        rows.append(definite_cone(coefficient_matrices(form, groups), share * one[None], -more - by * one))
    for place, group in enumerate(groups):
        (n, k), count = (len(forms[0].pairs[0][0]), len(forms[0].Q)), len(group.places)
        p, one = n * (n + 1) // 2, np.eye(count)
        split = np.zeros((p + k + len(groups), count, count))
        for i, at in enumerate(group.places):
            split[p + at, i, i] = -1.0
        split[p + k + place] = np.outer(group.weights, group.weights)
        rows.append(definite_cone(split, share * one[None], -by * one))
    return rows


def _positive(n: int, others: int, least: float) -> Rows:
    """Return the cone P >= `least` I, for variables P and `others` further ones."""
    A = np.hstack([-_packed(basis(n)), np.zeros((n * (n + 1) // 2, others))])
    return A, -least * _packed(np.eye(n)[None])[:, 0], True


def _solved(
    form: Quadratic,
    groups: Sequence[Group],
    rows: Sequence[Rows],
    cost: float,
    close: float,
    what: str,
    span: Span | None = None,
) -> tuple[tuple[Array, Array, float], Array] | None:
    n, k, t = len(form.pairs[0][0]), len(form.Q), len(groups)
    p = q = n * (n + 1) // 2
    if span:
        each, signs = upper_triangles(span[0]), span[1]
        q = each.shape[1]
        rows = [(np.hstack([A[:, :p] @ each, A[:, p:]]), b, kind) for A, b, kind in rows]
        rows.append((np.hstack([-signs, np.zeros((len(signs), k + t + 1))]), np.zeros(len(signs)), False))
    signed = np.hstack([np.zeros((k, q)), -np.eye(k), np.zeros((k, t + 1))]), np.zeros(k), False
    solution = solve_cone_program(np.append(np.zeros(q + k + t), cost), [*rows, signed], close, what)
    if solution is None:
        return None
    x, prices = solution
    of_P = each @ x[:q] if span else x[:p]
    return (symmetric(of_P, n), np.maximum(x[q : q + k], 0.0), float(x[-1])), prices


def sum_limit(form: Quadratic, q: int, most: float) -> Limits:
    """Return A and b of the linear constraint A (P, S) <= b by which the last `q` entries of S sum up to at most
    `most`."""
    n, k = len(form.pairs[0][0]), len(form.Q)
    return np.append(np.zeros(n * (n + 1) // 2 + k - q), np.ones(q))[None], np.array([most])


def norm_limits(form: Quadratic, points: Array) -> Limits:
    """Return A and b of the linear constraints A (P, S) <= b by which x'P x <= 1 at each of the `points` x (r, n)."""
    n, k = points.shape[1], len(form.Q)
    i, j = _places(n)
    squares = points[:, i] * points[:, j] * np.where(i == j, 1.0, 2.0)
    return np.hstack([squares, np.zeros((len(points), k))]), np.ones(len(points))


def extent_cone(c: Array, count: int) -> Rows:
    """Return the cone [t, c; c', P] >= 0, which means c P^-1 c' <= t, in `count` variables that begin with P, followed
    by t."""
    n, end = len(c), np.zeros((len(c) + 1, len(c) + 1))
    end[0, 1:] = end[1:, 0] = c
    wide, corner = np.zeros((count, n + 1, n + 1)), np.zeros((1, n + 1, n + 1))
    wide[: n * (n + 1) // 2, 1:, 1:], corner[0, 0, 0] = -basis(n), -1.0
    return definite_cone(wide, corner, end)


def definite_cone(brings: Array, last: Array, end: Array) -> Rows:
    """Return the cone of symmetric matrices `end` - sum_i x_i `brings`_i - t `last` >= 0, in the variables x and t."""
    return _packed(np.concatenate([brings, last])), _packed(end[None])[:, 0], True


def solve_semidefinite_program(goal: Array, blocks: Callable[[Array], Sequence[Array]], what: str) -> Array | None:
    """Return the solution x of a semidefinite program: the smallest <goal, x> for which all `blocks`(x), matrices
    affine in x, are positive semidefinite; None where the solver finds none. `what`: the purpose. Raises:
    `NoSolver`."""
    known = solve_cone_program(goal, definite_cones(blocks, len(goal)), CLOSER, what)
    return None if known is None else known[0]


def definite_cones(blocks: Callable[[Array], Sequence[Array]], count: int) -> list[Rows]:
    """Return the cones in which the matrices `blocks`(x), affine in the `count` variables x, are positive
    semidefinite."""
    first, *others = (blocks(x) for x in np.vstack([np.zeros(count), np.eye(count)]))
    each = zip(first, zip(*others, strict=True), strict=True)
    return [(_packed(end - np.array(ones)), _packed(end[None])[:, 0], True) for end, ones in each]


def solve_cone_program(goal: Array, rows: Sequence[Rows], close: float, what: str) -> tuple[Array, Array] | None:
    """Return the solution x of a cone program and its dual variables: the smallest <goal, x> under the cones `rows`, A
    x + s = b; None where the solver, of accuracy `close`, fails. `what`: the purpose. Raises: `NoSolver`."""
    solver_modules(what)
    matrix = np.vstack([A for A, _, _ in rows], dtype=float)
    ends = np.concatenate([b for _, b, _ in rows], dtype=float)
    kinds = tuple((len(A), of_matrices) for A, _, of_matrices in rows if len(A))
    return _solution(goal.astype(float).tobytes(), matrix.tobytes(), ends.tobytes(), kinds, close)


@lru_cache(maxsize=1 << 12)  # design, display and verification repeat the same programs
def _solution(
    costs: bytes, matrix: bytes, ends: bytes, kinds: tuple[tuple[int, bool], ...], close: float
) -> tuple[Array, Array] | None:
    solver, sparse = solver_modules("a cone program")
    goal, b = np.frombuffer(costs), np.frombuffer(ends)
    A = sparse.csc_matrix(np.frombuffer(matrix).reshape(len(b), len(goal)))
    of_each = [
        solver.PSDTriangleConeT(int(np.sqrt(2 * size))) if of_matrices else solver.NonnegativeConeT(size)
        for size, of_matrices in kinds
    ]
    settings = solver.DefaultSettings()
    settings.verbose, settings.tol_gap_abs, settings.tol_gap_rel, settings.tol_feas = False, close, close, close
    settings.equilibrate_enable = False  # with equilibration it accepts solutions far from the optimum
    with one_thread():
        solution = solver.DefaultSolver(sparse.csc_matrix((len(goal),) * 2), goal, A, b, of_each, settings).solve()
    x, prices = np.array(solution.x), np.array(solution.z)
    usable = str(solution.status) in _USABLE and np.isfinite(x).all() and np.isfinite(prices).all()
    return (x, prices) if usable else None


def coefficient_matrices(form: Quadratic, groups: Sequence[Group] = ()) -> Array:
    """Return the coefficient matrices (p + k + t, N, N) of a quadratic form, which is linear in the entries of P on and
    above the diagonal, in S, and in a T of each of the `groups`. Where its X have more than n rows, P is part of [P,
    Y], and the entries of Y follow those of P."""
    halves: Any = sum(np.einsum("ia,jb->ijab", X, Y) for X, Y in form.pairs)
    whole, n = halves + halves.transpose(0, 1, 3, 2), len(halves)
    i, j = _places(n)
    both = whole[i, j] + whole[j, i]
    of_P = both / np.where(i == j, 2.0, 1.0)[:, None, None]
    of_Y = whole[:, n:].reshape(-1, *whole.shape[2:])
    of_S = np.einsum("ka,kb->kab", form.Q, form.Q) - np.einsum("ka,kb->kab", form.Z, form.Z)
    of_T = np.zeros((len(groups), form.size, form.size))
    for place, group in enumerate(groups):
        of_T[place, group.column, group.column] = -1.0
    return np.concatenate([of_P, of_Y, of_S, of_T])


@cache
def basis(n: int) -> Array:
    """Return the basis (p, n, n) of the symmetric matrices, each with one 1 on or above the diagonal, p = n (n +
    1)/2."""
    return np.array([symmetric(row, n) for row in np.eye(n * (n + 1) // 2)])


def upper_triangles(matrices: Array) -> Array:
    """Return the entries on and above the diagonal, column by column, of symmetric matrices (q, N, N), as columns (..,
    q)."""
    i, j = _places(matrices.shape[-1])
    return np.asarray(matrices[:, i, j].T)


def _packed(matrices: Array) -> Array:
    """Return the upper triangles of matrices, scaled so that
    columns have the scalar product of the matrices."""
    return np.asarray(upper_triangles(matrices) * _weights(matrices.shape[-1])[:, None])


@cache
def _weights(size: int) -> Array:
    i, j = _places(size)
    return np.where(i == j, 1.0, np.sqrt(2.0))


@cache
def _places(size: int) -> tuple[Array, Array]:
    j, i = np.tril_indices(size)
    return i, j


def symmetric(entries: Array, size: int) -> Array:
    """Return the symmetric matrix with these `entries` on and above its diagonal, column by column."""
    i, j = _places(size)
    matrix = np.zeros((size, size))
    matrix[i, j] = matrix[j, i] = entries
    return matrix


def merge_parallel_columns(form: Quadratic) -> tuple[tuple[Quadratic], tuple[Group, ...]]:
    """Return a form (floats) with fewer columns, in which parallel multiplied columns are one column u, and the groups
    of multipliers that belong to each u."""
    n, each = len(form.pairs[0][0]), tuple(_directions(form))
    T, Z = np.zeros((form.size, n + len(each))), np.zeros((len(form.Z), n + len(each)))
    T[:n, :n] = np.eye(n)
    for at, places in enumerate(each, n):
        T[n + places[0], at] = 1.0  # the largest is the unit of the others
        if len(places) == 1:
            Z[places[0], at] = 1.0
    pairs = tuple((X @ T, Y @ T) for X, Y in form.pairs)
    columns, groups = _columns(form), list[Group]()
    for at, places in enumerate(each, n):
        if len(places) > 1:
            first = columns[:, places[0]]
            weights = tuple(float(columns[:, k] @ first / (first @ first)) for k in places)
            groups.append(Group(tuple(places), weights, at))
    constant = None if form.constant is None else T.T @ form.constant @ T
    return (Quadratic(pairs, form.Q @ T, Z, constant),), tuple(groups)


def _columns(form: Quadratic) -> Array:
    n = len(form.pairs[0][0])
    return np.vstack([part for pair in form.pairs for part in pair] + [form.Q])[:, n:]


def _directions(form: Quadratic) -> Iterator[list[int]]:
    columns, remaining = _columns(form), list(range(len(form.Q)))
    lengths = np.linalg.norm(columns, axis=0)
    while remaining:
        first = max(remaining, key=lengths.__getitem__)
        places = [k for k in remaining if k == first or _parallel(columns, lengths, first, k)]
        places.sort(key=lambda k: -lengths[k])
        yield places
        remaining = [k for k in remaining if k not in places]


def _parallel(columns: Array, lengths: Array, first: int, other: int) -> bool:
    if not lengths[other]:
        return False
    cosine = columns[:, first] @ columns[:, other] / lengths[first] / lengths[other]
    unit = columns[:, other] / lengths[other] * np.sign(cosine)
    return bool(np.abs(columns[:, first] / lengths[first] - unit).max() < _ALIKE)
