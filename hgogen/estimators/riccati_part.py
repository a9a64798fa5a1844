"""The structure of a Riccati observer as a part of an observer, its declaration, and its covariance in three views.

    z' = f(z, u) + P C' R_theta^-1 (y - h),   P' = F P + P F' + Q_theta - P C' R_theta^-1 C P

    information  S' = -F'S - S F - rho (S - S_0) + C' R_theta^-1 C - S Q_theta S       (the papers print this one)
    covariance   P' =  F P + P F' + rho (P - P S_0 P) + Q_theta - P C' R_theta^-1 C P  (P = S^-1)
    factored     P  =  L D L', L unit lower triangular, D > 0         (positive definite by construction)

F = A(u) + b*(z, u), rho = 0; for a Kalman-like observer F = A(u, y), Q_theta = Q_0. Each method chooses a view. Source:
Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4); with forgetting and measured coefficients, Hammouri, de Leon
Morales, CDC 1990; with S_0 and Q_0, Salgado, Goodwin, Middleton, International Journal of Control 47 (1988); Thornton
1976 for the time update, Bierman 1977 for the measurement update of the factors.

With forgetting, the samples determine the estimate more than the prior S_0 does where s = lambda_max(S_0 P) is small:

    s = lambda_max(S_0 P) <= sum_i P_ii S_0ii,      s < 1/2  if and only if  S - 2 S_0 is positive definite

The status bit is set where the sum is above 1/2 (of S, where a pivot of S - 2 S_0 is not positive): where it is not
set, s is at most 1/2 up to rounding, far from 1. A limit of 1 would be sensitive to rounding and to Q_0, because s
tends to 1 for an unobservable constant state.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, Literal

import casadi as ca
import numpy as np
import sympy as sp
from flint import fmpq_mat

from hgogen.analysis.dynamics import HUGE, Dynamics
from hgogen.analysis.linearised import disturbances_on_box, jacobians_on_box
from hgogen.analysis.scaling import Scaling, scaling
from hgogen.analysis.undefined import gaps
from hgogen.discretisation.stability import FrozenMap, FrozenRiccati
from hgogen.estimators.gate import GatedGroup, Gates, gated_groups
from hgogen.estimators.theta import Theta, constant
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.observer import gain, state_field
from hgogen.part import Clock, Ode, Part, Pieces
from hgogen.program import Bit, Block, Field, Place, column, sym
from hgogen.reading.given import (
    FACTORED,
    BadGain,
    Matrix,
    Values,
    by_coordinate,
    in_order,
    matrix_line,
    names_of,
    quadratic,
    reals,
)
from hgogen.rigor import definite
from hgogen.rigor.definite import symmetric, unsymmetric
from hgogen.rigor.tape import slope
from hgogen.sentence import tidy
from hgogen.signal import LOST, Signal, spread

POINTS = 12  # corners, and as many points inside, at which the model is linearised


def cap(
    dynamics: Dynamics,
    z: Field,
    noise: np.ndarray,
    variances: Sequence[float],
    start: np.ndarray,
    peak: float,
    scaling: Scaling | None = None,
) -> np.ndarray:
    """Return the cap of each variance P_ii (n): the largest of the square of the outer box's half-width, 100 times the
    steady variance at theta = `peak` over those points of the box that have one, and 4 P(0). For a state without a
    range, 1e12 P(0) replaces the first. `noise`: Q (n, n); `variances`: R (p); `start`: P(0) (n, n)."""
    half = np.array([(high - low) / 2 for low, high in z.box])
    cap = np.where(np.isfinite(half), half**2, 1e12 * np.diag(start))
    F, C = jacobians_on_box(dynamics, POINTS)
    frozen = frozen_riccati(dynamics)
    steady = frozen.of(F, C, noise, np.array(variances), scaling).steady(peak).diagonal(axis1=1, axis2=2)
    largest = np.where(np.isfinite(steady), steady, 0.0).max(axis=0)
    return np.asarray(np.minimum(np.maximum.reduce([cap, 100 * largest, 4 * np.diag(start)]), LOST))


def frozen_riccati(dynamics: Dynamics) -> type[FrozenRiccati]:
    """Return the class that solves a Riccati equation with the coefficients of one point: `FrozenMap` for a discrete
    plant, else `FrozenRiccati`."""
    return FrozenMap if dynamics.form.system.discrete else FrozenRiccati


def spd(name: str, value: Any, n: int) -> np.ndarray:
    """Return `value`, a diagonal (n) or a matrix (n, n), as a symmetric positive definite matrix, without rounding
    errors. Raises: `BadGain`."""
    matrix = _symmetric(name, value, n)
    if not is_definite(matrix):
        raise BadGain(name, "must be positive definite")
    return matrix


def semidefinite(name: str, value: Any, n: int) -> np.ndarray:
    """Return `value`, a diagonal (n) or a matrix (n, n), as a symmetric matrix without negative eigenvalues, up to
    rounding (1e-12 of its numbers). Raises: `BadGain`."""
    matrix = _symmetric(name, value, n)
    try:
        factor(matrix)
    except np.linalg.LinAlgError:
        raise BadGain(name, "must be positive semidefinite: symmetric, without a negative eigenvalue") from None
    return matrix


def _symmetric(name: str, value: Any, n: int) -> np.ndarray:
    matrix = reals(name, value)
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.shape != (n, n):
        raise BadGain(f"{name} of shape {np.shape(value)}", f"must be a diagonal of {n} numbers or a {n} x {n} matrix")
    if not (np.abs(matrix) <= LOST).all():
        raise BadGain(name, f"must be finite, none of its numbers beyond {LOST:g}")
    even = symmetric(definite.rationals(matrix))
    if even is None:
        raise BadGain(name, unsymmetric(name))
    return np.array(even, dtype=float)


def _controllability(columns: definite.Matrix, F: np.ndarray) -> list[list[Any]]:
    """Return the rows of (W, F W, .., F^(n-1) W)', W = `columns` (n, k), a column for each state."""
    term, slopes = definite.exact(columns), definite.exact(definite.rationals(F))
    rows: list[list[Any]] = term.transpose().tolist()
    for _ in columns[1:]:
        term = slopes * term
        rows += term.transpose().tolist()
    return rows


def noise_rank(part: "Riccati", names: Sequence[str]) -> str:
    """Return a sentence that names the states without process noise, or says that a singular Q still excites every
    state; "" for a positive definite Q. `names`: those of the coordinates."""
    if is_definite(part.nominal[0]):
        return ""
    if part.reached and part.disturbed:
        return "noise of inputs reaches every state of the model as it is linearised at a point"
    if part.reached:
        return "Q has an eigenvalue 0; its noise reaches every state of the model as it is linearised at a point"
    columns = [zip(*rows, strict=True) for rows in part.reach]
    still = [all(not any(column) for column in each) for each in zip(*columns, strict=True)]
    which = " and ".join(name for name, alone in zip(names, still, strict=True) if alone) or "a combination of states"
    return f"no noise reaches {which}: the variance may tend to 0, and samples then no longer correct an error there"


def is_diagonal(matrix: np.ndarray) -> bool:
    """Return whether all entries off the diagonal are 0."""
    return not np.count_nonzero(matrix - np.diag(np.diag(matrix)))


def is_definite(matrix: np.ndarray) -> bool:
    """Return whether a matrix is exactly positive definite: a float eigenvalue near 0 may have the wrong sign."""
    if is_diagonal(matrix):
        return bool((np.diag(matrix) > 0).all())
    return definite.positive(definite.exact(definite.rationals(matrix)))


def positive_numbers(name: str, value: Any, outputs: int) -> tuple[float, ...]:
    """Return positive numbers, one for each output, from one number for all outputs or a number for each. Raises:
    `BadGain`."""
    array = reals(name, value)
    if array.shape not in ((), (outputs,)):
        raise BadGain(f"{name} of shape {array.shape}", f"must have one number for each of {outputs} outputs")
    numbers = tuple(np.broadcast_to(array, outputs).tolist())
    if any(not HUGE**-2 <= number <= LOST for number in numbers):
        raise BadGain(f"{name} = {value}", f"must be positive, from {HUGE**-2:g} to {LOST:g}")
    return numbers


def positive_gain(
    name: str, values: Sequence[float] | np.ndarray, meaning: str, unit: str, labels: tuple[str, ...] = ()
) -> Field:
    """Return the field of a tunable gain of positive numbers, whose range is six decades below and above these;
    `labels` name the numbers."""
    numbers = tuple(map(float, values))
    low, high = (float(f"{end:.6g}") for end in (min(numbers) / 1e6, 1e6 * max(numbers)))  # 0 where one is 0
    field = gain(name, numbers, low, high, meaning, unit)
    return replace(field, labels=labels)


@dataclass(frozen=True)
class InputNoise:
    """Noise of the plant's `inputs`, by index, with the spectral `densities` (u^2 s)."""

    inputs: tuple[int, ...] = ()
    densities: tuple[float, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.inputs)

    @property
    def weights(self) -> Graph:
        """The densities as the gain U (k), SX."""
        return sym("gain", "U", len(self.inputs))


@dataclass(frozen=True)
class Variances:
    """The noise R of outputs (p), of which some have a variance that is an expression of the form's signals: the
    variance is the expression in `expressions` (1 for a constant variance) times the density in `densities`; `least`:
    lower bounds of the expressions on the declared ranges."""

    densities: tuple[float, ...]
    expressions: tuple[sp.Expr, ...]
    least: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Riccati(Part):
    """A Riccati observer, independent of the method, which stores S = P^-1, P or the factors of P = L D L'.

    z' = f(z, u, y) + P C' R_theta^-1 (y - h), P' = F P + P F' + Q_theta + rho (P - P S_0 P) - P C' R_theta^-1 C P,
    Q_theta = theta^(1+g) Delta^-1 G diag(weights) G' Delta^-1, R_theta = theta^(g-1) delta R delta by `scaling`, where
    `weights` (k) and `R` (p) are SX, `factor` G (n, k), unit lower triangular where k = n; k = 0 is no noise. `z`: the
    field of the state (its box is the outer one); `covariance`: P(0); `cap`: the largest P_ii, with forgetting the
    diagonal of S_0^-1; `limited`: the status bit of this limit; `nominal`: (Q, R) as numbers. `forgetting`: the gain
    rho. `measured_state`: the function of (z, u, y, valid) that returns z with measurements instead of estimates, at
    which A(u, z) and b(z, u) are evaluated, with F = A; without it F is the Jacobian. `period`: the declared period of
    the inputs; `gates`: of the innovations; `disturbed`: noise of inputs, which adds f_u U f_u' to Q, f_u = d(A z +
    b)/du; `joint`: whether all samples of a call correct together; `correlated`: the factor L of R = L diag(`R`) L';
    `varying`: expressions by which `R` is multiplied.
    """

    dynamics: Dynamics
    z: Field
    theta: Theta
    weights: Graph
    factor: np.ndarray
    R: Graph
    covariance: np.ndarray
    cap: np.ndarray
    limited: Bit
    nominal: tuple[np.ndarray, np.ndarray]
    forgetting: Field | None = None
    measured_state: Callable[[Graph, Graph, Graph, Graph], Graph] | None = None
    period: float | None = None
    gates: tuple[GatedGroup, ...] = ()
    disturbed: InputNoise = InputNoise()
    joint: bool = False
    correlated: np.ndarray | None = None
    varying: Variances | None = None

    @cached_property
    def scaling(self) -> Scaling:
        """The powers of theta that scale Q_theta and R_theta."""
        return scaling(self.dynamics.form, self.theta.scaled)

    def flow(self, z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        """Return the rate f (n) of the prediction z' = f(z, u), SX."""
        if self.measured_state is None:
            return self.dynamics.flow(z, u)
        A, b = self.dynamics.affine(self.measured_state(z, u, y, valid), u)
        return A @ z + b

    def jacobian(self, z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        """Return the matrix F (n, n) of the Riccati equation P' = F P + P F' + .., SX."""
        if self.measured_state is None:
            return self.dynamics.jacobian(z, u)
        return self.dynamics.affine(self.measured_state(z, u, y, valid), u)[0]

    def slopes(self, samples: int, edge: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return F (k, n, n) and dh/dz (k, p, n) at points of the box; corners are shifted inwards by the fraction
        `edge` of each range."""
        return jacobians_on_box(self.dynamics, samples, affine=self.measured_state is not None, edge=edge)

    def linearised(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Return F + rho/2 (k, n, n), rho the forgetting rate, and dh/dz (k, p, n) at points of the box."""
        F, C = self.slopes(samples)
        return (F if self.forgetting is None else F + self.forgetting.initial[0] / 2 * np.eye(len(self.covariance))), C

    @property
    def rho(self) -> Graph:
        """The forgetting rate, SX scalar; 0 without forgetting."""
        return sym("gain", self.forgetting.name) if self.forgetting else ca.SX(0)

    def density(self, output: int, z: Graph, u: Graph) -> Graph:
        """Return R_jj of the output j = `output` at z and u, SX scalar."""
        R = self.output_noise[output, output]
        if self.varying is None or self.varying.expressions[output].is_number:
            return R
        form = self.dynamics.form
        back = dict(zip(form.system.states, form.from_form, strict=True))
        expression = self.varying.expressions[output].xreplace(back)
        (value,) = self.dynamics.values([expression], self.dynamics.saturated(z), u)
        return R * (value if form.clamped else ca.fmax(value, self.varying.least[output]))

    @property
    def output_noise(self) -> Graph:
        """R (p, p), SX."""
        if self.correlated is None:
            return ca.diag(self.R)
        factor = ca.sparsify(ca.SX(ca.DM(self.correlated)))
        return factor @ ca.diag(self.R) @ factor.T

    @cached_property
    def noise_covariance(self) -> definite.Matrix:
        """Q (n, n) at theta = 1 in rationals: L diag(d) L' of its factors where it is singular and not diagonal, and
        was read up to rounding."""
        noise = self.nominal[0]
        if is_diagonal(noise) or is_definite(noise):
            return definite.rationals(noise)
        L, D = (definite.exact(definite.rationals(each)) for each in (self.factor, np.diag(factor(noise)[1])))
        product = (L * D * L.transpose()).tolist()
        return tuple(tuple(map(definite.fraction, row)) for row in product)

    @cached_property
    def reach(self) -> list[list[list[Any]]]:
        """The rows of (W, F W, .., F^(n-1) W)' at points of the ranges, W the columns of the process noise, exactly."""
        if not self.disturbed:
            noise = self.noise_covariance
            return [_controllability(noise, F) for F in jacobians_on_box(self.dynamics, 1)[0]]
        F, B = disturbances_on_box(self.dynamics, 1)
        columns = (np.hstack((self.nominal[0], each[:, self.disturbed.inputs])) for each in B)
        return [_controllability(definite.rationals(W), each) for W, each in zip(columns, F, strict=True)]

    @cached_property
    def reached(self) -> bool:
        """Whether the process noise reaches every state of the model linearised at a point of the ranges."""
        n = len(self.covariance)
        return is_definite(self.nominal[0]) or any(fmpq_mat(rows).rank() == n for rows in self.reach)

    @cached_property
    def typical(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers Q (n, n) and R (p) at theta = 1; noise of inputs, which depends on the point, is averaged over
        the ranges."""
        return self.nominal[0] + average(self.dynamics, self.disturbed), self.nominal[1]

    def noise(self, z: Graph, u: Graph) -> Graph:
        """Return the process noise Q_theta (n, n) of the Riccati equation at z and u, SX."""
        factor = self.scaled_factor(z, u)
        return factor @ ca.diag(self.scaling.process(self.theta.value) * self.densities) @ factor.T

    @property
    def densities(self) -> Graph:
        """The densities (k) of independent noises, the w of Q_theta = theta^(1+g) W diag(w) W', SX."""
        return ca.vertcat(self.weights, self.disturbed.weights) if self.disturbed else self.weights

    def scaled_factor(self, z: Graph, u: Graph) -> Graph:
        """Return the factor W = Delta^-1 (G, f_u) (n, k) of Q_theta = theta^(1+g) W diag(w) W' at z and u, SX."""
        columns = ca.sparsify(ca.SX(ca.DM(self.factor)))
        if self.disturbed:
            columns = ca.horzcat(columns, self.dynamics.input_jacobian(z, u)[:, self.disturbed.inputs])
        return ca.diag(self.spread()) @ columns

    def spread(self) -> Graph:
        """The diagonal of Delta^-1 as an SX column."""
        return ca.vertcat(*self.scaling.spread(self.theta.value))


@dataclass(frozen=True, eq=False)
class RiccatiVariant(Part):
    """A Riccati observer `plain` that is advanced by update equations of its own, not by a method's."""

    plain: Riccati


@dataclass(frozen=True, eq=False)
class SampledFilter(RiccatiVariant):
    """A Kalman filter `name`, with the model and the noise of `plain`, that predicts and corrects at samples; `build`
    returns its memory and statements, which do not depend on the method."""

    name: str
    build: Callable[[Clock], Pieces]


def lower(n: int, first: int = 0) -> list[tuple[int, int]]:
    """Return the index pairs (i, j) of the lower triangle of an n x n matrix, column by column, from `first` rows
    below the diagonal."""
    return [(i, j) for j in range(n) for i in range(j + first, n)]


def pack(matrix: Graph, first: int = 0) -> Graph:
    """Return the lower triangle of `matrix` as an SX column, by columns, in the order of `lower`."""
    return column(matrix[i, j] for i, j in lower(matrix.shape[0], first))


def unpack(packed: Graph, n: int) -> Graph:
    """Return the symmetric SX matrix (n, n) whose lower triangle, by columns, is `packed`."""
    matrix = unpack_lower(packed, n)
    return ca.tril(matrix) + ca.tril(matrix, False).T


def unpack_lower(packed: Graph, n: int, first: int = 0) -> Graph:
    """Return the lower triangular SX matrix (n, n) of `packed`, by columns; for `first` = 1 its diagonal is 1."""
    matrix = ca.SX.eye(n) if first else ca.SX(n, n)
    for k, (i, j) in enumerate(lower(n, first)):
        matrix[i, j] = packed[k]
    return matrix


Ends = tuple[float, ...]


def packed_triangle(
    name: str, matrix: np.ndarray, meaning: str, first: int = 0, low: Ends = (), high: Ends = ()
) -> Field:
    """Return the memory field of a lower triangle, stored by columns; its initial values are those of `matrix`, its
    limits `low` and `high`."""
    pairs = lower(len(matrix), first)
    start, entries = tuple(float(matrix[i, j]) for i, j in pairs), tuple((i + 1, j + 1) for i, j in pairs)
    return Field(name, start, entries=entries, meaning=f"{meaning} by columns", low=low, high=high)


def factor(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (L, d) of a symmetric matrix L diag(d) L' without negative eigenvalues, d >= 0. For a diagonal matrix d is
    exactly its diagonal. Raises: `numpy.linalg.LinAlgError` for another matrix."""
    entries = np.diag(matrix).astype(float)
    if not np.count_nonzero(matrix - np.diag(entries)) and (entries >= 0).all():
        return np.eye(len(entries)), entries
    with np.errstate(all="ignore"):
        L, d = pivots(np.asarray(matrix, dtype=float))
    return (L, np.array(d)) if all(value > 0 for value in d) else _singular_factor(matrix)


def _singular_factor(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (L, d) of a singular symmetric matrix L diag(d) L'; a column of L below a pivot that is 0 up to rounding
    is 0."""
    n, remaining, scale = len(matrix), matrix.astype(float), np.sqrt(np.maximum(np.diag(matrix), 0))
    L, d = np.eye(n), np.zeros(n)
    for j in range(n):
        below = remaining[j:, j]
        if (np.abs(below) <= _ROUNDING * scale[j:] * scale[j]).all():
            continue
        if not remaining[j, j] > 0:
            raise np.linalg.LinAlgError("the matrix has a negative eigenvalue")
        d[j], L[j:, j] = remaining[j, j], below / remaining[j, j]
        remaining[j:, j:] = remaining[j:, j:] - d[j] * np.outer(L[j:, j], L[j:, j])
    if not np.abs(L @ np.diag(d) @ L.T - matrix).max(initial=0.0) <= _ROUNDING * n * np.abs(matrix).max(initial=0.0):
        raise np.linalg.LinAlgError("the matrix has a negative eigenvalue")
    return L, d


_ROUNDING = 1e-12  # of a number of a singular matrix, as a share of the root of the product of its diagonal entries
View = Literal["information", "covariance"]
_UNBOUNDED = (
    "leaves a direction without noise, in which S = P^-1 grows without bound; take the method continuous_discrete, "
    "cholesky or rk4_covariance, or a small positive number for it"
)
SYMMETRIC: Mapping[View, str] = {"information": "S", "covariance": "P"}  # the field of a method that integrates it


def riccati_ode(part: Riccati, view: View) -> Ode:
    """Return z' and S', or z' and P', of the Riccati observer; an invalid output has the weight 0."""
    name, prior = SYMMETRIC[view], ca.diag(ca.SX(ca.DM(1 / part.cap)))

    def rate(values: Mapping[str, Graph], u: Graph, y: Graph, valid: Graph) -> dict[str, Graph]:
        z, X = values[part.z.name], unpack(values[name], part.dynamics.n)
        F, C, theta = part.jacobian(z, u, y, valid), part.dynamics.output_jacobian(z, u), part.theta.value
        weights = (part.scaling.weight(part.density(j, z, u), theta, j) for j in range(part.dynamics.outputs))
        weight = ca.diag(valid * ca.vertcat(*weights))
        error = part.dynamics.error(y, part.dynamics.output(z, u))
        if view == "information":
            correction = solve(X, C.T @ weight @ error)
            slope = C.T @ weight @ C - F.T @ X - X @ F - X @ part.noise(z, u) @ X
            slope -= part.rho * (X - prior)
        else:
            gain, drift = X @ C.T @ weight, F @ X
            correction = gain @ error
            slope = drift + drift.T + part.noise(z, u) - gain @ C @ X
            slope += part.rho * (X - X @ prior @ X)
        return {part.z.name: part.flow(z, u, y, valid) + correction, name: pack(slope)}

    if view == "information":
        if not part.reached:
            raise BadGain("Q", _UNBOUNDED)
        start = packed_triangle("S", np.linalg.inv(part.covariance), "inverse covariance, lower triangle")
    else:
        start = packed_triangle("P", part.covariance, "covariance, lower triangle")
    return Ode((part.z, start), rate)


def pivots(S: Graph) -> tuple[Graph, list[Graph]]:
    """Return L, unit lower triangular, and d (n) of a symmetric S = L diag(d) L' (n, n), SX or numbers."""
    n = S.shape[0]
    L, d = np.eye(n) if isinstance(S, np.ndarray) else ca.SX.eye(n), list[Graph]()
    for j in range(n):
        d.append(S[j, j] - sum(L[j, k] ** 2 * d[k] for k in range(j)))
        for i in range(j + 1, n):
            L[i, j] = (S[i, j] - sum(L[i, k] * L[j, k] * d[k] for k in range(j))) / d[j]
    return L, d


def solve(S: Graph, right: Graph) -> Graph:
    """Return S^-1 right for a symmetric positive definite SX matrix (n, n), by its factors L D L'."""
    n, (L, d) = S.shape[0], pivots(S)
    x = [right[i] for i in range(n)]
    for i in range(n):
        x[i] = x[i] - sum(L[i, k] * x[k] for k in range(i))
    x = [x[i] / d[i] for i in range(n)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum(L[k, i] * x[k] for k in range(i + 1, n))
    return ca.vertcat(*x)


def time_update(
    L: Graph, d: Graph, transition: Graph, shaped: Graph, weights: Graph, least: Graph | None = None
) -> tuple[Graph, Graph, dict[str, Graph]]:
    """Return L, d of Phi L diag(d) L' Phi' + W diag(w) W' by weighted Gram-Schmidt (Thornton), and the intermediate
    values that get a name.

    Args: SX `L` (n, n), `d` (n), `transition` Phi (n, n), `shaped` W (n, k), `weights` w (k); `least` (n): a d below
    it counts as 0, where Phi is singular and there is no noise.
    """
    n = d.shape[0]
    stacked, weight = ca.horzcat(transition @ L, shaped), ca.vertcat(d, weights)
    rows = [stacked[i, :].T for i in range(n)]
    factor, diagonal, names = ca.SX.eye(n), [], dict[str, Graph]()
    for j in range(n):
        weighted = rows[j] * weight
        diagonal.append(ca.dot(rows[j], weighted))
        inverse = 1 / (diagonal[j] if least is None else ca.fmax(diagonal[j], least[j]))
        names |= {f"w{j + 1}_{k + 1}": rows[j][k] for k in range(rows[j].shape[0])}
        names |= {f"d{j + 1}": diagonal[j]} | ({f"d{j + 1}_inverse": inverse} if j < n - 1 else {})
        for i in range(j + 1, n):
            factor[i, j] = ca.dot(rows[i], weighted) * inverse
            names[f"l{i + 1}{j + 1}"] = factor[i, j]
            rows[i] = rows[i] - factor[i, j] * rows[j]
    return factor, ca.vertcat(*diagonal), names


def measurement_update(L: Graph, d: Graph, c: Graph, r: Graph) -> tuple[Graph, Graph, Graph]:
    """Return L, d of P = L diag(d) L' after one scalar measurement with row c (1, n) and variance r (Bierman), and the
    gain K (n).

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
    share = v[j] * inverse  # one division: CasADi would make another of each product with an inverse
    if f[j].is_one():
        diagonal[j] = share * r
    return factor, diagonal, L[:, j] * share


SHARE = 0.5


def prior_status(part: Riccati, variance: list[Graph]) -> Block:
    """Return the block that sets the status bit COVARIANCE_LIMITED if sum_i P_ii S_0ii exceeds `SHARE`, P_ii =
    `variance`."""
    return _limit_status(ca.dot(column(variance), ca.SX(ca.DM(1 / part.cap))) > SHARE)


def symmetric_covariance(part: Riccati, view: View) -> tuple[Graph, Block]:
    """Return P (n, n) in terms of the stored S = P^-1 or P, by `view`, SX, and the block of `prior_status`."""
    n = part.dynamics.n
    matrix = unpack(sym("state", SYMMETRIC[view], n * (n + 1) // 2), n)
    if view == "covariance":
        return matrix, prior_status(part, [matrix[i, i] for i in range(n)])
    P = ca.horzcat(*(solve(matrix, column) for column in ca.horzsplit(ca.SX.eye(n))))
    _, d = pivots(matrix - ca.SX(ca.DM(np.diag(1 / (SHARE * part.cap)))))
    return P, _limit_status(ca.logic_not(reduce(ca.logic_and, (pivot > 0 for pivot in d))))


def _limit_status(limited: Graph) -> Block:
    return Block("is the covariance near S_0^-1?", {Place("status", "COVARIANCE_LIMITED"): limited})


LIMITED = Bit(
    "COVARIANCE_LIMITED",
    "the covariance reached its cap: a long loss of measurements, or Q and R much too large for the declared ranges",
    "wait for measurements; if it stays while they come, scale Q and R down together",
)


@dataclass(frozen=True, eq=False)
class Extended:
    """A Riccati observer with what its caller publishes: the `part`, the `gains` Q and R, and `equations`, lines of the
    banner about a Q that is not diagonal, and about gates."""

    part: Riccati
    gains: tuple[Field, ...]
    equations: tuple[str, ...]


def extended(
    form: Form,
    Q: Matrix,
    R: float | Values | Variances,
    covariance: Matrix | None,
    initial: Values | None,
    theta: Theta | None = None,
    tangent: bool = True,
    gate: Gates | None = None,
    U: Mapping[str, float] | None = None,
    update: str = "sequential",
) -> Extended:
    """Return the Riccati observer of the arguments of `observers.riccati`, `covariance` = P(0); theta is 1 by default.
    `tangent`: whether outputs are extended by their tangents outside of the box, consistently with their Jacobians.

    Raises: `BadGain`, `BadNames`.
    """
    n, outputs, theta = form.n, len(form.output), theta or constant(1.0)
    dynamics = Dynamics(form, tangent)

    noise = semidefinite("Q", by_coordinate("Q", Q, form), n)
    start = spd("covariance", np.ones(n) if covariance is None else by_coordinate("covariance", covariance, form), n)
    varying, R = (R, R.densities) if isinstance(R, Variances) else (None, R)
    measured = output_noise("R", R, form)
    variances = tuple(np.diag(measured).tolist())
    ordinary = at_middle(form, varying) * np.array(variances)
    shape, weights = factor(noise)
    _demand_update(form, update, measured, theta)
    correlated = None if is_diagonal(measured) else factor(measured)
    z, disturbed = state_field(form, initial, theta.peak), input_noise(form, U)
    most = noise + average(dynamics, disturbed)
    part = Riccati(
        dynamics=dynamics,
        z=z,
        theta=theta,
        weights=sym("gain", "Q", n),
        factor=shape,
        R=sym("gain", "R", outputs),
        covariance=start,
        cap=cap(dynamics, z, most, ordinary.tolist(), start, theta.peak, scaling(form, theta.scaled)),
        limited=LIMITED,
        nominal=(noise, ordinary),
        gates=gated_groups(gate, form.system.outputs),
        disturbed=disturbed,
        joint=update == "joint",
        correlated=correlated and correlated[0],
        varying=varying,
    )
    units = ("z^2", "y^2", "u^2") if form.system.discrete else ("z^2/s", "y^2 s", "u^2 s")
    kind, unit = ("output noise, diagonal factor", FACTORED) if correlated else ("output noise", units[1])
    gains: tuple[Field, ...] = (
        positive_gain("Q", weights, "process noise, diagonal factor", units[0], form.names),
        positive_gain("R", correlated[1] if correlated else variances, kind, unit, names_of(form.system.outputs)),
    )
    if disturbed:
        names = tuple(form.system.inputs[i].name for i in disturbed.inputs)
        gains += (positive_gain("U", disturbed.densities, "input noise", units[2], names),)
    return Extended(part, gains, (*matrix_line("Q", noise, form), *_equations(part, form, measured)))


def _equations(part: Riccati, form: Form, measured: np.ndarray) -> Iterator[str]:
    """Yield the banner lines of gates, varying variances, a joint update and noise of inputs; `measured`: R (p, p)."""
    yield from (group.equation for group in part.gates)
    if part.varying is not None:
        pairs = zip(names_of(form.system.outputs), part.varying.expressions, strict=True)
        yield from (f"variance of a sample of {y} = {e}, times R dt" for y, e in pairs if not e.is_number)
    if part.joint:
        matrix = ", ".join(f"[{', '.join(map(tidy, row))}]" for row in measured.tolist())
        rows = "diagonal" if is_diagonal(measured) else matrix
        yield f"all samples of a call correct together, outputs at the prediction; R: {rows}"
    if part.disturbed:
        names = ", ".join(form.system.inputs[i].name for i in part.disturbed.inputs)
        at = "" if form.system.discrete else " at mid-step"
        yield f"Q + f_u U f_u' for Q, f_u = df/du{at}, u = ({names})"


def output_noise(name: str, value: Any, form: Form) -> np.ndarray:
    """Return R (p, p) from a number, a number for each output, or a symmetric matrix, in order or by the outputs'
    names. Raises: `BadGain`, `BadNames`."""
    names = names_of(form.system.outputs)
    rows = quadratic(name, value, names) if isinstance(value, Mapping) else value
    if np.ndim(reals(name, rows)) < 2:
        return np.diag(positive_numbers(name, rows, len(names)))
    return spd(name, rows, len(names))


def at_middle(form: Form, varying: Variances | None) -> np.ndarray:
    """Return the numerical values (p) of the outputs' variance expressions in the middle of the ranges; ones without
    expressions."""
    if varying is None:
        return np.ones(len(form.output))
    system = form.system
    values = {s: sum(spread(s)) / 2 for s in (*system.states, *system.inputs)} | dict(system.nominal)
    return np.array([float(e.subs(values)) for e in varying.expressions])


UPDATES = ("sequential", "joint")


def _demand_update(form: Form, update: str, R: np.ndarray, theta: Theta) -> None:
    if not isinstance(update, str) or update not in UPDATES:
        raise BadGain(f"update = {update!r:.60}", 'must be "sequential", one output after the other, or "joint"')
    if is_diagonal(R):
        return
    if update != "joint":
        raise BadGain("R", 'correlates outputs, which a sequential update takes one by one; give update = "joint"')
    if theta.peak != 1:
        raise BadGain("R", "correlates outputs, which theta does not scale; take theta = 1, or a diagonal R")


def average(dynamics: Dynamics, noise: InputNoise) -> np.ndarray:
    """Return the process noise f_u U f_u' (n, n) due to inputs, as its mean over points of the ranges; f_u: the columns
    of df/du of the inputs with `noise`."""
    if not noise:
        return np.zeros((dynamics.n, dynamics.n))
    columns = disturbances_on_box(dynamics, POINTS)[1][:, :, noise.inputs]
    return np.asarray((columns * np.array(noise.densities) @ columns.swapaxes(1, 2)).mean(axis=0))


def input_noise(form: Form, densities: Mapping[str, float] | None) -> InputNoise:
    """Return the noise of inputs from its `densities` (u^2 s) by their names. Raises: `BadGain`, `BadNames`."""
    if densities is None:
        return InputNoise()
    plant = form.system
    names = names_of(plant.supplied)
    if not isinstance(densities, Mapping) or not densities:
        example = f", such as {{{names[0]!r}: 1e-4}}" if names else "; the plant has no inputs, leave U out"
        raise BadGain(f"U = {densities!r:.60}", f"must give densities of the noise of inputs by name{example}")
    read = in_order("U", densities, names, default=dict.fromkeys(names))
    noisy = tuple(i for i, value in enumerate(read) if value is not None)
    for i in noisy:
        _demand_disturbing(form, plant.inputs[i])
    numbers = positive_numbers("U", [read[i] for i in noisy], len(noisy))
    return InputNoise(noisy, numbers)


def _demand_disturbing(form: Form, u: Signal) -> None:
    """Raise `BadGain` for an input that is not in the flow only, or there without finite derivatives."""
    plant, what = form.system, f"noise of the input {u.name}"
    for y, row in zip(plant.outputs, plant.output, strict=True):
        if u in row.free_symbols:
            reason = f"enters the output {y.name} as well, which would correlate the noises of state and sample"
            raise BadGain(what, f"{reason}; leave it out, and raise Q and R instead")
    slopes = [slope(row, u) for row in plant.flow]
    if not any(slopes):
        raise BadGain(what, "moves no state, for it is not in the flow; leave it out")
    if failures := gaps(slopes, plant):
        why = "; ".join(str(gap.condition.failure) for gap in failures)
        raise BadGain(what, f"is scaled by derivatives of the flow that may have no value {why}; narrow the ranges")
    if any(u in row.free_symbols for row in form.to_form):
        raise BadGain(what, f"enters coordinates of the form {form.kind}; take hg.forms.original")
