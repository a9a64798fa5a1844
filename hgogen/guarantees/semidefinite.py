"""Weights P > 0 and S >= 0 with which quadratic forms are negative, by a cone program in floats: no proof of it.

    margin    maximise m:   F(P, S) <= -m I for every form F,   P >= least I,   trace P <= n
    shortest  minimise t:   F(P, S) <= -m I,   [t, c; c', P] >= 0 for every c,   limits on P and S
    cheapest  minimise t:   F(P, S) + R <= -m I for every form F and its R,   the last of S <= t

F is linear in P and S (`quadratic`), c P^-1 c' <= t. The programs are written down for Clarabel as it takes them, A x +
s = b with s in cones, without a language for models, which would take longer than the solver.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from hgogen.algebra.threads import one_thread
from hgogen.guarantees.lmi import cones
from hgogen.guarantees.merged import Group, merged
from hgogen.guarantees.quadratic import Array, Quadratic, Seen, even, inverse_root, pace

_LEAST = 1e-4  # eigenvalue of P over the mean of all: a P close to singular is none that rationals prove
_CLOSE = 1e-6  # how well a margin is found
CLOSER = 1e-8
_SOLVES = 6  # of a program in coordinates of its own solution, at most
_GAIN, _ROUND = 0.01, 4  # what ends them: a gain, and a condition number of P, that are smaller
_USABLE = ("Solved", "AlmostSolved")  # what the solver says of its solution

Limits = tuple[Array, Array]  # A and b of A (P, S) <= b, P by its entries as `_short` has them
Rows = tuple[Array, Array, bool]  # A and b of one cone, and whether it is that of definite matrices, or of signs


@dataclass(frozen=True, eq=False)
class Margin:
    """The `margin` of weights `P` (n, n) and `S` (k), all in floats, below 0 where no weights make the forms negative;
    `prices`, for each form (N, N): <price, D> is what a small change D of that form takes from the margin."""

    P: Array
    S: Array
    margin: float
    prices: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a program finds in coordinates x of e = W x: the weights `P` (n, n) and `S` (k) of e, the `value` that it
    makes small, infinite where the forms are not negative by these weights, and the P of x, `near` the unit matrix."""

    P: Array
    S: Array
    value: float
    near: Array


def settled(solve: Callable[[Array], Solution | None], W: Array) -> tuple[Array, Array] | None:
    """The weights P and S of the least value that a program finds in coordinates e = W x, then in those in which the P
    that it found is the unit matrix, until it finds one near that, or gains less than a hundredth; None where it finds
    none.

    A solver takes for nothing what is small in its coordinates. Where these are far from those of the solution it ends
    anywhere up to several times the least value, as it happens to round; in those of its own solution at the least.
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


def sought(forms: Sequence[Quadratic], what: str, W: Array | None = None) -> tuple[Array, Array] | None:
    """Weights in floats with which a solver takes all forms to be negative; None where it finds none. `W` (n, n): what
    decays is W times coordinates in which P is expected to be near the unit matrix.

    Raises: `NoSolver` of `what` needs it.
    """
    best = widest(forms, what, W)
    return (best.P, best.S) if best is not None and best.margin > 0 else None


def widest(forms: Sequence[Quadratic], what: str, W: Array | None = None, priced: bool = False) -> Margin | None:
    """The same weights, also where the forms are not negative: by the largest margin in those coordinates; `priced`:
    whether prices are asked.

    Raises: `NoSolver`.
    """
    if W is None:
        return margin([form.floats for form in forms], what, priced)
    fast = pace(forms[0].floats, W)
    slow = [form.floats.over(fast) for form in forms]
    g = even(slow[0], W)
    view = Seen(slow, W, g)
    best = margin(view.forms, what, priced)
    if best is None:
        return None
    P, S = view.back(best.P, best.S)
    return replace(best, P=P, S=S * fast, margin=best.margin * fast)


@np.errstate(over="ignore", invalid="ignore")
def margin(forms: Sequence[Quadratic], what: str, priced: bool = False) -> Margin | None:
    """The margin of forms of floats, with the same P and S; None where the solver leaves no numbers. Of one form whose
    prices are not asked, columns are merged.

    Raises: `NoSolver` of `what` needs it.
    """
    n, k = len(forms[0].pairs[0][0]), len(forms[0].Q)
    (first, groups), rest = _few(forms[0]) if len(forms) == 1 and not priced else (forms[0], ()), forms[1:]
    one, sizes = np.eye(n), (n * (n + 1) // 2, k, len(groups))
    none = np.zeros((sizes[0], 1 + k + len(groups)))
    of_forms = [
        definite(_entries(form, groups), np.eye(form.size)[None], 0 * np.eye(form.size)) for form in (first, *rest)
    ]
    of_groups = [_split(group, place, sizes, np.eye(len(group.places)), 0.0) for place, group in enumerate(groups)]
    positive: Rows = (np.hstack([-_packed(_basis(n)), none]), -_LEAST * _packed(one[None])[:, 0], True)
    trace: Rows = (np.hstack([_short(one[None]).T, none[:1]]), np.array([float(n)]), False)
    all_rows = [*of_forms, *of_groups, positive, trace, _signs(sizes)]
    solution = solved(np.append(np.zeros(sum(sizes)), -1.0), all_rows, _CLOSE, what)
    if solution is None:
        return None
    (P, S, largest), prices = _parts(solution[0], n, k), solution[1]
    if not priced:
        return Margin(P, S, largest, ())
    of_each = zip(pairwise(np.cumsum([0, *(len(A) for A, _, _ in of_forms)])), forms, strict=True)
    return Margin(
        P, S, largest, tuple(_matrix(prices[i:j] / _weights(form.size), form.size) for (i, j), form in of_each)
    )


@np.errstate(over="ignore", invalid="ignore")
def shortest(view: Seen, reads: Array, limits: Limits, by: float, unit: float, what: str) -> Solution | None:
    """P and S of forms of x that are negative `by` that, within `limits` of x / `unit`, with a small largest
    c P^-1 c' of what rows read of x, `reads` (r, n); None where the solver leaves no numbers.

    Raises: `NoSolver` of `what` needs it.
    """
    forms, rows = view.forms, reads / np.linalg.norm(reads, axis=1).max()
    n, k = rows.shape[1], len(forms[0].Q)
    (first, groups), rest = _few(forms[0]) if len(forms) == 1 else (forms[0], ()), forms[1:]
    sizes, small = (n * (n + 1) // 2, k, len(groups)), -by * np.eye(first.size)
    wide, corner, (A, b) = np.zeros((sum(sizes), n + 1, n + 1)), np.zeros((1, n + 1, n + 1)), limits
    wide[: sizes[0], 1:, 1:], corner[0, 0, 0] = -_basis(n), -1.0
    of_rows = []
    for c in rows:
        beside = np.zeros((n + 1, n + 1))
        beside[0, 1:] = beside[1:, 0] = c
        of_rows.append(definite(wide, corner, beside))
    of_groups = [_split(group, j, sizes, np.zeros((len(group.places),) * 2), by) for j, group in enumerate(groups)]
    others: Rows = (np.hstack([A, np.zeros((len(A), len(groups) + 1))]), b, False)
    of_forms = [definite(_entries(form, groups), 0 * small[None], small) for form in (first, *rest)]
    all_rows = [*of_forms, *of_groups, *of_rows, others, _signs(sizes)]
    solution = solved(np.append(np.zeros(sum(sizes)), 1.0), all_rows, CLOSER, what)
    if solution is None:
        return None
    P, S, _ = _parts(solution[0], n, k)
    holds = all(np.linalg.eigvalsh(M).min() > 0 for M in (P, *(-form.value(P, S) for form in forms)))
    value = np.einsum("ij,ji->i", reads, np.linalg.solve(P, reads.T)).max() / unit**2 if holds else math.inf
    known = view.back(P, S)
    return Solution(known[0] * unit**2, known[1] * unit**2, float(value), P)


def _few(form: Quadratic) -> tuple[Quadratic, tuple[Group, ...]]:
    less = merged(form)
    return less.form, less.groups


def _split(group: Group, place: int, sizes: tuple[int, int, int], last: Array, by: float) -> Rows:
    """That diag(S) - T r r' of a group, the T of that place, is at least the last variable times `last`, and `by`."""
    count, (p, k, _) = len(group.places), sizes
    entries = np.zeros((sum(sizes), count, count))
    for i, at in enumerate(group.places):
        entries[p + at, i, i] = -1.0
    entries[p + k + place] = np.outer(group.weights, group.weights)
    return definite(entries, last[None], -by * np.eye(count))


@np.errstate(over="ignore", invalid="ignore")
def cheapest(
    forms: Sequence[Quadratic], rewards: Sequence[Array], q: int, by: float, what: str, others: Sequence[Quadratic] = ()
) -> tuple[Array, Array] | None:
    """P and S with a small largest of the last `q` of S, of forms of floats that are negative `by` that with what is
    added to each, its reward (N, N), and of `others` without; None where the solver leaves no numbers.

    Raises: `NoSolver` of `what` needs it.
    """
    n, k = len(forms[0].pairs[0][0]), len(forms[0].Q)
    p, one = n * (n + 1) // 2, np.eye(n)
    added = [*rewards, *(np.zeros((form.size, form.size)) for form in others)]
    of_forms = [
        definite(_entries(form, ()), 0 * more[None], -more - by * np.eye(form.size))
        for form, more in zip((*forms, *others), added, strict=True)
    ]
    positive: Rows = (np.hstack([-_packed(_basis(n)), np.zeros((p, k + 1))]), -by * _packed(one[None])[:, 0], True)
    last = np.hstack([np.zeros((q, p + k - q)), np.eye(q), -np.ones((q, 1))])
    rows = [*of_forms, positive, (last, np.zeros(q), False), _signs((p, k, 0))]
    solution = solved(np.append(np.zeros(p + k), 1.0), rows, CLOSER, what)
    return solution and _parts(solution[0], n, k)[:2]


def together(form: Quadratic, q: int, most: float) -> Limits:
    """That the last q of S are together at most `most`."""
    n, k = len(form.pairs[0][0]), len(form.Q)
    return np.append(np.zeros(n * (n + 1) // 2 + k - q), np.ones(q))[None], np.array([most])


def holding(form: Quadratic, points: Array) -> Limits:
    """That |x|_P <= 1 at the `points` x (r, n)."""
    n, k = points.shape[1], len(form.Q)
    i, j = _places(n)
    squares = points[:, i] * points[:, j] * np.where(i == j, 1.0, 2.0)
    return np.hstack([squares, np.zeros((len(points), k))]), np.ones(len(points))


def definite(entries: Array, last: Array, end: Array) -> Rows:
    """That `end` less what the variables bring, the last one of them `last`, is a definite matrix."""
    return _packed(np.concatenate([entries, last])), _packed(end[None])[:, 0], True


def _signs(sizes: tuple[int, int, int]) -> Rows:
    """S >= 0, of as many entries of P, S and T."""
    p, k, t = sizes
    return np.hstack([np.zeros((k, p)), -np.eye(k), np.zeros((k, t + 1))]), np.zeros(k), False


def solved(goal: Array, rows: Sequence[Rows], close: float, what: str) -> tuple[Array, Array] | None:
    """The variables with the least <goal, x>, and the prices of the rows; None where the solver finds none.

    Raises: `NoSolver`."""
    cones(what)
    matrix = np.vstack([A for A, _, _ in rows], dtype=float)
    ends = np.concatenate([b for _, b, _ in rows], dtype=float)
    kinds = tuple((len(A), of_matrices) for A, _, of_matrices in rows if len(A))
    return _solution(goal.astype(float).tobytes(), matrix.tobytes(), ends.tobytes(), kinds, close)


@lru_cache(maxsize=1 << 12)  # searches meet at a point, and who designs, shows and verifies begins alike
def _solution(
    costs: bytes, matrix: bytes, ends: bytes, kinds: tuple[tuple[int, bool], ...], close: float
) -> tuple[Array, Array] | None:
    """The same, of numbers as they lie in memory, and of the cones by their sizes."""
    solver, sparse = cones("a cone program")
    goal, b = np.frombuffer(costs), np.frombuffer(ends)
    A = sparse.csc_matrix(np.frombuffer(matrix).reshape(len(b), len(goal)))
    of_each = [
        solver.PSDTriangleConeT(int(np.sqrt(2 * size))) if of_matrices else solver.NonnegativeConeT(size)
        for size, of_matrices in kinds
    ]
    settings = solver.DefaultSettings()
    settings.verbose, settings.tol_gap_abs, settings.tol_gap_rel, settings.tol_feas = False, close, close, close
    settings.equilibrate_enable = False  # by which it takes for solved what is far from the least
    with one_thread():
        solution = solver.DefaultSolver(sparse.csc_matrix((len(goal),) * 2), goal, A, b, of_each, settings).solve()
    x, prices = np.array(solution.x), np.array(solution.z)
    usable = str(solution.status) in _USABLE and np.isfinite(x).all() and np.isfinite(prices).all()
    return (x, prices) if usable else None


def _parts(x: Array, n: int, k: int) -> tuple[Array, Array, float]:
    """P, S and the last variable."""
    p = n * (n + 1) // 2
    return _matrix(x[:p], n), np.maximum(x[p : p + k], 0.0), float(x[-1])


def _entries(form: Quadratic, groups: Sequence[Group]) -> Array:
    """What each entry of P on and above the diagonal, each of S, and each T brings into the form: (p + k + t, N, N)."""
    halves: Any = sum(np.einsum("ia,jb->ijab", X, Y) for X, Y in form.pairs)
    whole = halves + halves.transpose(0, 1, 3, 2)
    i, j = _places(len(whole))
    both = whole[i, j] + whole[j, i]
    of_P = both / np.where(i == j, 2.0, 1.0)[:, None, None]
    of_S = np.einsum("ka,kb->kab", form.Q, form.Q) - np.einsum("ka,kb->kab", form.Z, form.Z)
    of_T = np.zeros((len(groups), form.size, form.size))
    for place, group in enumerate(groups):
        of_T[place, group.column, group.column] = -1.0
    return np.concatenate([of_P, of_S, of_T])


@cache
def _basis(n: int) -> Array:
    """The symmetric matrix of each entry on and above the diagonal: (p, n, n)."""
    return np.array([_matrix(row, n) for row in np.eye(n * (n + 1) // 2)])


def _short(matrices: Array) -> Array:
    """Symmetric matrices (q, N, N) as the columns of their entries on and above the diagonal, column by column."""
    i, j = _places(matrices.shape[-1])
    return np.asarray(matrices[:, i, j].T)


def _packed(matrices: Array) -> Array:
    """The same as the solver takes them, so that a scalar product is that of the matrices."""
    return np.asarray(_short(matrices) * _weights(matrices.shape[-1])[:, None])


@cache
def _weights(size: int) -> Array:
    i, j = _places(size)
    return np.where(i == j, 1.0, np.sqrt(2.0))


@cache
def _places(size: int) -> tuple[Array, Array]:
    """The rows and the columns of the entries on and above the diagonal, column by column."""
    j, i = np.tril_indices(size)
    return i, j


def _matrix(entries: Array, size: int) -> Array:
    i, j = _places(size)
    matrix = np.zeros((size, size))
    matrix[i, j] = matrix[j, i] = entries
    return matrix
