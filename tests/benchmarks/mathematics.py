"""One sample of a filter as mathematics alone, on numbers of any kind: floats, CasADi's graphs, SymPy's and SymForce's
expressions.

    continuous_discrete   z by RK4,  P <- Phi P Phi' + h Q,  Phi = I + h F + (h F)^2/2,  F at the third stage
                          alpha = R_j/h + c P c',  K = P c'/alpha,  z <- z + K (y_j - h_j),  P <- P - K c P
    rk4_covariance        z' = f + P H' R^-1 (y - h),  P' = F P + P F' + Q - P H' R^-1 H P   by RK4

Inputs, and the samples of the second, go on the line from one row to the next. P is symmetric, and only its lower half
is computed and stored: w = (z, P_11, P_21, P_22, P_31, ..).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp
from cases import Case

Rows = list[Any]
Step = Callable[[Rows, Rows, Rows], Rows]


@dataclass(frozen=True)
class Model:
    """f (n), F (n, n), h (p), H (p, n) as functions of z and u; an entry that is 0 everywhere is None."""

    flow: Callable[[Rows, Rows], Rows]
    jacobian: Callable[[Rows, Rows], list[Rows]]
    output: Callable[[Rows, Rows], Rows]
    slope: Callable[[Rows, Rows], list[Rows]]


def model(case: Case, functions: Any) -> Model:
    """The model of a case, its sines and the like from a module or a table of functions."""
    x, u = case.states, case.inputs

    def column(rows: sp.Matrix) -> Callable[[Rows, Rows], Rows]:
        return sp.lambdify([x, u], list(rows), modules=[functions])

    def sparse(rows: sp.Matrix) -> Callable[[Rows, Rows], list[Rows]]:
        entries = sp.lambdify([x, u], rows.tolist(), modules=[functions])
        empty = [[e == 0 for e in row] for row in rows.tolist()]
        return lambda z, u: [
            [None if zero else e for e, zero in zip(*pair, strict=True)]
            for pair in zip(entries(z, u), empty, strict=True)
        ]

    return Model(column(case.flow), sparse(case.flow.jacobian(x)), column(case.output), sparse(case.output.jacobian(x)))


def packed(P: list[Rows]) -> Rows:
    """The lower half, row by row."""
    return [P[i][j] for i in range(len(P)) for j in range(i + 1)]


def symmetric(half: Sequence[Any], n: int) -> list[Rows]:
    """The whole of a lower half."""
    at = {(i, j): half[i * (i + 1) // 2 + j] for i in range(n) for j in range(i + 1)}
    return [[at[max(i, j), min(i, j)] for j in range(n)] for i in range(n)]


def total(terms: Sequence[Any]) -> Any:
    """The sum of those that are not None, None of none."""
    there = [term for term in terms if term is not None]
    whole = there[0] if there else None
    for term in there[1:]:
        whole = whole + term
    return whole


def times(a: Any, b: Any) -> Any:
    """A product of which None is 0."""
    return None if a is None or b is None else a * b


def product(A: list[Rows], B: list[Rows]) -> list[Rows]:
    """A B, without what is 0 everywhere."""
    columns = list(zip(*B, strict=True))
    return [[total([times(a, b) for a, b in zip(row, column, strict=True)]) for column in columns] for row in A]


def halves(A: list[Rows], B: list[Rows]) -> list[Rows]:
    """The lower half of A B', as rows of growing length."""
    return [
        [total([times(a, b) for a, b in zip(A[i], B[j], strict=True)]) for j in range(i + 1)] for i in range(len(A))
    ]


def runge_kutta(rate: Callable[[Rows, float], Rows], v: Rows, h: float) -> tuple[Rows, Rows]:
    """v a step on, and the argument of the third stage."""
    moved = lambda k, c: [a if b is None else a + c * h * b for a, b in zip(v, k, strict=True)]  # noqa: E731
    k1 = rate(v, 0.0)
    k2 = rate(moved(k1, 0.5), 0.5)
    third = moved(k2, 0.5)
    k3 = rate(third, 0.5)
    k4 = rate(moved(k3, 1.0), 1.0)
    end = [a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(v, k1, k2, k3, k4, strict=True)]
    return end, third


def line(before: Rows, now: Rows, part: float) -> Rows:
    """Between two rows."""
    if part in (0.0, 1.0):
        return list(now if part else before)
    return [a + part * (b - a) for a, b in zip(before, now, strict=True)]


def corrected(case: Case, model: Model, w: Rows, row: Rows) -> Rows:
    """w after the samples of a row, one output after the other."""
    n, m, h = case.n, len(case.inputs), case.step.dt
    u, y = row[:m], row[m:]
    z, P = list(w[:n]), symmetric(w[n:], n)
    for j, r in enumerate(case.R):
        c, predicted = model.slope(z, u)[j], model.output(z, u)[j]
        Pc = [total([times(a, b) for a, b in zip(row_, c, strict=True)]) for row_ in P]
        alpha = r / h + total([times(a, b) for a, b in zip(c, Pc, strict=True)])
        K = [a / alpha for a in Pc]
        e = y[j] - predicted
        z = [a + k * e for a, k in zip(z, K, strict=True)]
        half = [[P[i][k] - K[i] * Pc[k] for k in range(i + 1)] for i in range(n)]
        P = symmetric(packed(half), n)
    return [*z, *packed([P[i][: i + 1] for i in range(n)])]


def predicted(case: Case, model: Model, w: Rows, before: Rows, row: Rows) -> Rows:
    """w a sample on, of a filter that corrects at samples."""
    n, m, h = case.n, len(case.inputs), case.step.dt
    at = [line(before[:m], row[:m], part) for part in (0.0, 0.5, 1.0)]
    z, third = runge_kutta(lambda v, c: model.flow(v, at[round(2 * c)]), list(w[:n]), h)
    F = model.jacobian(third, at[1])
    G = [[times(h, a) for a in row_] for row_ in F]
    square = product(G, G)
    Phi = [[total([1.0 if i == j else None, G[i][j], times(0.5, square[i][j])]) for j in range(n)] for i in range(n)]
    half = halves(product(Phi, symmetric(w[n:], n)), Phi)
    P = [[total([half[i][j], h * case.Q[i] if i == j else None]) for j in range(i + 1)] for i in range(n)]
    return [*z, *packed(P)]


def rate(case: Case, model: Model) -> Callable[[Rows, Rows], Rows]:
    """(w, a row) -> w', of a filter that integrates with the measurement."""
    n, m = case.n, len(case.inputs)

    def of(w: Rows, row: Rows) -> Rows:
        z, P, u = w[:n], symmetric(w[n:], n), row[:m]
        F, H, h = model.jacobian(z, u), model.slope(z, u), model.output(z, u)
        PH = product(P, list(zip(*H, strict=True)))  # (n, p)
        K = [[a / r for a, r in zip(line_, case.R, strict=True)] for line_ in PH]
        error = [y - each for y, each in zip(row[m:], h, strict=True)]
        f = model.flow(z, u)
        moved = [total([f[i], *(times(k, e) for k, e in zip(K[i], error, strict=True))]) for i in range(n)]
        FP, KPH = product(F, P), halves(K, PH)
        dP = [
            [total([FP[i][j], FP[j][i], case.Q[i] if i == j else None, times(-1.0, KPH[i][j])]) for j in range(i + 1)]
            for i in range(n)
        ]
        return [*moved, *packed(dP)]

    return of


def sample(case: Case, model: Model) -> Step:
    """(w, the row before, a row) -> w after the row."""
    if case.method == "rk4_covariance":
        moved, h = rate(case, model), case.step.dt
        return lambda w, before, row: runge_kutta(lambda v, c: moved(v, line(before, row, c)), list(w), h)[0]
    return lambda w, before, row: corrected(case, model, predicted(case, model, w, before, row), row)


def first(case: Case, model: Model, row: Rows) -> Rows:
    """w after the first row: z = 0, P the unit matrix, and the samples where the filter corrects at them."""
    n = case.n
    w = [0.0] * n + packed([[1.0 if i == j else 0.0 for j in range(i + 1)] for i in range(n)])
    return w if case.method == "rk4_covariance" else corrected(case, model, w, row)
