"""What observers with a covariance have in common: matrices that must be positive definite, and when a variance is
absurd."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from flint import fmpq_mat

from hgogen.analysis.dynamics import HUGE, Dynamics
from hgogen.analysis.linearised import jacobians_on_box
from hgogen.analysis.scaling import Scaling
from hgogen.discretisation.stability import steady_covariance
from hgogen.observer import gain
from hgogen.program import Field
from hgogen.reading.given import BadGain, reals
from hgogen.rigor import definite
from hgogen.rigor.definite import symmetric, unsymmetric
from hgogen.signal import LOST

_WANTED = (
    "must be positive definite, or a diagonal whose zeros the noise of other states reaches through the model, (A, Q) "
    "controllable; a state that no noise reaches, such as one believed constant, takes a small positive number"
)


def cap(
    dynamics: Dynamics,
    z: Field,
    noise: np.ndarray,
    variances: Sequence[float],
    start: np.ndarray,
    peak: float,
    scaling: Scaling | None = None,
) -> np.ndarray:
    """The largest P_ii (n) that is not absurd: the square of the outer box's half-width, a hundred times the steady
    variance at the largest theta wherever in the box there is one, and four times P(0); without a range, 1e12 P(0).
    """
    half = np.array([(high - low) / 2 for low, high in z.box])
    cap = np.where(np.isfinite(half), half**2, 1e12 * np.diag(start))
    F, C = jacobians_on_box(dynamics, 12)
    steady = np.diagonal(steady_covariance(F, C, noise, np.array(variances), peak, scaling), axis1=1, axis2=2)
    largest = np.where(np.isfinite(steady), steady, 0.0).max(axis=0)
    return np.asarray(np.minimum(np.maximum.reduce([cap, 100 * largest, 4 * np.diag(start)]), LOST))


def spd(name: str, value: Any, n: int, reaches: Callable[[np.ndarray], bool] | None = None) -> np.ndarray:
    """A diagonal (n) or a matrix (n, n) as symmetric positive definite matrix; rounding is taken off (`symmetric`).
    A diagonal may have zeros where it `reaches` every state.

    Raises: `BadGain`.
    """
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
    matrix = np.array(even, dtype=float)
    semidefinite = is_diagonal(matrix) and bool((np.diag(matrix) >= 0).all())
    if not is_definite(matrix) and not (reaches and semidefinite and reaches(matrix)):
        raise BadGain(name, _WANTED if reaches else "must be positive definite")
    return matrix


def reached_by(matrix: np.ndarray, jacobians: np.ndarray) -> bool:
    """Whether noise of this covariance reaches every state: (F, Q) is controllable at one of the F (k, n, n), by the
    exact rank of Q, F Q, .., F^(n-1) Q."""
    noise, n = definite.exact(definite.rationals(matrix)), len(matrix)
    for F in jacobians:
        rows, term, slopes = noise.transpose().tolist(), noise, definite.exact(definite.rationals(F))
        for _ in range(n - 1):
            term = slopes * term
            rows += term.transpose().tolist()
        if fmpq_mat(rows).rank() == n:
            return True
    return False


def is_diagonal(matrix: np.ndarray) -> bool:
    """Whether a matrix has no entry beside its diagonal."""
    return not np.count_nonzero(matrix - np.diag(np.diag(matrix)))


def is_definite(matrix: np.ndarray) -> bool:
    """Whether a matrix is positive definite, by exact arithmetic: a float eigenvalue near 0 may have the wrong sign."""
    if is_diagonal(matrix):
        return bool((np.diag(matrix) > 0).all())
    return definite.positive(definite.exact(definite.rationals(matrix)))


def positive(name: str, value: Any, outputs: int) -> tuple[float, ...]:
    """Positive numbers, one for each output, from one number for all of them or a number for each.

    Raises: `BadGain`.
    """
    array = reals(name, value)
    if array.shape not in ((), (outputs,)):
        raise BadGain(f"{name} of shape {array.shape}", f"must have one number for each of {outputs} outputs")
    numbers = tuple(np.broadcast_to(array, outputs).tolist())
    if any(not HUGE**-2 <= number <= LOST for number in numbers):
        raise BadGain(f"{name} = {value}", f"must be positive, from {HUGE**-2:g} to {LOST:g}")
    return numbers


def wide(
    name: str, values: Sequence[float] | np.ndarray, meaning: str, unit: str, labels: tuple[str, ...] = ()
) -> Field:
    """A gain of positive numbers that may be tuned by six decades either way; `labels`: what each number belongs to."""
    numbers = tuple(map(float, values))
    field = gain(name, numbers, 1e-6 * min(numbers), 1e6 * max(numbers), meaning, unit)  # 0 where one is 0
    return replace(field, labels=labels)
