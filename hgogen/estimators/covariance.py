"""The covariance of a Riccati observer in three views.

    information  S' = -F'S - S F - rho (S - S_0) + C' R_theta^-1 C - S Q_theta S       (the papers print this one)
    covariance   P' =  F P + P F' + rho (P - P S_0 P) + Q_theta - P C' R_theta^-1 C P  (P = S^-1)
    factored     P  =  L D L', L unit lower triangular, D > 0         (positive definite by construction)

F = A(u) + b*(z, u), rho = 0; of a Kalman-like observer F = A(u, y), Q_theta = Q_0. Source: Boizot, Busvelle, Gauthier
2010, (4); Thornton 1976 for the time update, Bierman 1977 for the measurement update of the factors.

Of a covariance that forgets, the samples show more than the prior S_0 does where s = lambda_max(S_0 P) is small:

    s = lambda_max(S_0 P) <= sum_i P_ii S_0ii,      s < 1/2  if and only if  S - 2 S_0 is positive definite

The status bit is set where the sum is above 1/2 (of S, where a pivot of S - 2 S_0 is not positive): where it is not
set, s is at most 1/2 but for rounding, which is far from the other half. A limit of 1 would be at the mercy of rounding
and of Q_0, for s tends to 1 where nothing is seen of a state that stays.
"""

from collections.abc import Mapping
from functools import reduce
from typing import Literal

import casadi as ca
import numpy as np

from hgogen.estimators.riccati_part import Riccati
from hgogen.graph import Graph
from hgogen.part import Ode
from hgogen.program import Block, Field, Place, column, sym


def lower(n: int, first: int = 0) -> list[tuple[int, int]]:
    """The places of a lower triangle (n, n), column by column, from its diagonal on or the `first` below that."""
    return [(i, j) for j in range(n) for i in range(j + first, n)]


def pack(matrix: Graph, first: int = 0) -> Graph:
    """The lower triangle of an SX matrix, column by column, as `lower` has its places."""
    return column(matrix[i, j] for i, j in lower(matrix.shape[0], first))


def unpack(packed: Graph, n: int) -> Graph:
    """The symmetric SX matrix (n, n) of its packed lower triangle."""
    matrix = unpack_lower(packed, n)
    return ca.tril(matrix) + ca.tril(matrix, False).T


def unpack_lower(packed: Graph, n: int, first: int = 0) -> Graph:
    """The lower triangular SX matrix (n, n) of its packed triangle; of a strict one the diagonal is 1."""
    matrix = ca.SX.eye(n) if first else ca.SX(n, n)
    for k, (i, j) in enumerate(lower(n, first)):
        matrix[i, j] = packed[k]
    return matrix


Ends = tuple[float, ...]


def packed_triangle(
    name: str, matrix: np.ndarray, meaning: str, first: int = 0, low: Ends = (), high: Ends = ()
) -> Field:
    """The field of a packed lower triangle, which begins with that of the matrix; `low`, `high`: its box."""
    pairs = lower(len(matrix), first)
    start, entries = tuple(float(matrix[i, j]) for i, j in pairs), tuple((i + 1, j + 1) for i, j in pairs)
    return Field(name, start, entries=entries, meaning=f"{meaning} by columns", low=low, high=high)


def factor(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L, d) of a symmetric positive definite matrix = L diag(d) L'; of a diagonal one d is its diagonal, to the bit,
    which may have zeros.

    Raises: `numpy.linalg.LinAlgError` where it is not positive definite.
    """
    entries = np.diag(matrix).astype(float)
    if not np.count_nonzero(matrix - np.diag(entries)) and (entries >= 0).all():
        return np.eye(len(entries)), entries
    with np.errstate(all="ignore"):
        L, d = pivots(np.asarray(matrix, dtype=float))
    if not all(value > 0 for value in d):
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return L, np.array(d)


def information_ode(part: Riccati) -> Ode:
    """z and S as one differential equation."""

    def rate(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        n = part.dynamics.n
        z, S = values[part.z.name], unpack(values["S"], n)
        F, C, weight, error = _along(part, z, u, y, valid)
        correction = solve(S, C.T @ ca.diag(weight) @ error)
        slope = C.T @ ca.diag(weight) @ C - F.T @ S - S @ F - S @ part.noise() @ S
        slope -= part.rho * (S - ca.diag(ca.SX(ca.DM(1 / part.cap))))
        return {part.z.name: part.flow(z, u, y, valid) + correction, "S": pack(slope)}

    start = np.linalg.inv(part.covariance)
    return Ode((part.z, packed_triangle("S", start, "inverse covariance, lower triangle")), rate)


def covariance_ode(part: Riccati) -> Ode:
    """z and P as one differential equation."""

    def rate(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        z, P = values[part.z.name], unpack(values["P"], part.dynamics.n)
        F, C, weight, error = _along(part, z, u, y, valid)
        gain = P @ C.T @ ca.diag(weight)
        drift = F @ P
        slope = drift + drift.T + part.noise() - gain @ C @ P
        slope += part.rho * (P - P @ ca.diag(ca.SX(ca.DM(1 / part.cap))) @ P)
        return {part.z.name: part.flow(z, u, y, valid) + gain @ error, "P": pack(slope)}

    return Ode((part.z, packed_triangle("P", part.covariance, "covariance, lower triangle")), rate)


def covariance_of_view(part: Riccati, view: str) -> Graph:
    """P (n, n) as an SX of the field that a view of it keeps."""
    n = part.dynamics.n
    name = "S" if view == "information" else "P"
    matrix = unpack(sym("state", name, n * (n + 1) // 2), n)
    return matrix if name == "P" else ca.horzcat(*(solve(matrix, column) for column in ca.horzsplit(ca.SX.eye(n))))


def _along(part: Riccati, z: Graph, u: Graph, y: Graph, valid: Graph) -> tuple[Graph, Graph, Graph, Graph]:
    """F, C, the weights 1/R_theta of the valid outputs, and y - h(z, u), of which an invalid one counts as 0."""
    F, C = part.jacobian(z, u, y, valid), part.dynamics.output_jacobian(z, u)
    theta, outputs = part.theta.value, part.dynamics.outputs
    weights = ca.vertcat(*(part.scaling.weight(part.R[j], theta, j) for j in range(outputs)))
    return F, C, valid * weights, y - part.dynamics.output(z, u)


def pivots(S: Graph) -> tuple[Graph, list[Graph]]:
    """L, unit lower triangular, and the diagonal of D of a symmetric matrix (n, n) = L D L', SX or numbers."""
    n = S.shape[0]
    L, d = np.eye(n) if isinstance(S, np.ndarray) else ca.SX.eye(n), list[Graph]()
    for j in range(n):
        d.append(S[j, j] - sum(L[j, k] ** 2 * d[k] for k in range(j)))
        for i in range(j + 1, n):
            L[i, j] = (S[i, j] - sum(L[i, k] * L[j, k] * d[k] for k in range(j))) / d[j]
    return L, d


def solve(S: Graph, right: Graph) -> Graph:
    """S^-1 right for a symmetric positive definite SX matrix (n, n), by its factors L D L'."""
    n, (L, d) = S.shape[0], pivots(S)
    x = [right[i] for i in range(n)]
    for i in range(n):
        x[i] = x[i] - sum(L[i, k] * x[k] for k in range(i))
    x = [x[i] / d[i] for i in range(n)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum(L[k, i] * x[k] for k in range(i + 1, n))
    return ca.vertcat(*x)


def time_update(
    L: Graph, d: Graph, transition: Graph, shaped: Graph, weights: Graph
) -> tuple[Graph, Graph, dict[str, Graph]]:
    """Factors of Phi L D L' Phi' + W diag(w) W' by weighted Gram-Schmidt (Thornton), and the values worth a name.

    Args: SX `L` (n, n), `d` (n), `transition` Phi (n, n), `shaped` W (n, k), `weights` w (k).
    """
    n = d.shape[0]
    stacked, weight = ca.horzcat(transition @ L, shaped), ca.vertcat(d, weights)
    rows = [stacked[i, :].T for i in range(n)]
    factor, diagonal, names = ca.SX.eye(n), [], dict[str, Graph]()
    for j in range(n):
        weighted = rows[j] * weight
        diagonal.append(ca.dot(rows[j], weighted))
        inverse = 1 / diagonal[j]
        names |= {f"w{j + 1}_{k + 1}": rows[j][k] for k in range(rows[j].shape[0])}
        names |= {f"d{j + 1}": diagonal[j]} | ({f"d{j + 1}_inverse": inverse} if j < n - 1 else {})
        for i in range(j + 1, n):
            factor[i, j] = ca.dot(rows[i], weighted) * inverse
            names[f"l{i + 1}{j + 1}"] = factor[i, j]
            rows[i] = rows[i] - factor[i, j] * rows[j]
    return factor, ca.vertcat(*diagonal), names


def measurement_update(L: Graph, d: Graph, c: Graph, r: Graph) -> tuple[Graph, Graph, Graph]:
    """Factors after one scalar measurement with row c (1, n) and variance r (Bierman), and the gain K (n).

    The recursion runs from the last state to the first because L is lower triangular; where c = (c_1, 0, ..., 0) it
    reduces to alpha = r + c_1^2 d_1, K = c_1 d_1 L[:,1]/alpha, d_1 <- d_1 r/alpha, L unchanged.
    """
    n = d.shape[0]
    f = L.T @ c.T
    v = d * f
    alpha, inverse, gain = r, 1 / r, ca.SX(n, 1)
    factor, diagonal = ca.SX(L), ca.SX(d)
    read = [j for j in range(n) if not f[j].is_zero()]
    for j in reversed(read):
        before, last = alpha, inverse
        alpha = alpha + v[j] * f[j]
        inverse = 1 / alpha
        diagonal[j] = d[j] * before * inverse
        for i in range(j + 1, n):
            factor[i, j] = L[i, j] - f[j] * gain[i] * last
            gain[i] = gain[i] + L[i, j] * v[j]
        gain[j] = v[j]
    if len(read) != 1:
        return factor, diagonal, gain * inverse
    (j,) = read
    share = v[j] * inverse  # the one quotient: CasADi makes another of each product with an inverse
    if f[j].is_one():
        diagonal[j] = share * r
    return factor, diagonal, L[:, j] * share


SHARE = 0.5


def prior_status(part: Riccati, variance: list[Graph]) -> Block:
    """The block that sets the status where the P_ii (`variance`), as shares of those of S_0^-1, add up to more than
    `SHARE`."""
    return _limit_status(ca.dot(column(variance), ca.SX(ca.DM(1 / part.cap))) > SHARE)


def prior_status_of_view(part: Riccati, view: Literal["information", "covariance"]) -> Block:
    """The block of `prior_status` for a method whose state is the symmetric matrix S or P itself."""
    n = part.dynamics.n
    matrix = unpack(sym("state", "S" if view == "information" else "P", n * (n + 1) // 2), n)
    if view == "covariance":
        return prior_status(part, [matrix[i, i] for i in range(n)])
    _, left = pivots(matrix - ca.SX(ca.DM(np.diag(1 / (SHARE * part.cap)))))
    return _limit_status(ca.logic_not(reduce(ca.logic_and, (d > 0 for d in left))))


def _limit_status(limited: Graph) -> Block:
    """The block that writes the condition `limited` to the status."""
    return Block("is the covariance near S_0^-1?", {Place("status", "COVARIANCE_LIMITED"): limited})
