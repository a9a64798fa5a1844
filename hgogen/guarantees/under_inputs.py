"""How far inputs of a step move an estimate, by any course of them, for ever.

    |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k v_k^2,   sum_k lambda_k <= alpha

The v_k, such as the errors of an output's samples at the two ends of a call, are at most 1, else independent of each
other. Then |e|_P <= 1 stays so, and from elsewhere |e|_P^2 - 1 falls to 1 - alpha h of itself at each call: |c e| comes
to no more than sqrt(c P^-1 c'), and stays there. P is sought for the least of that, at an alpha that is searched.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from hgogen.algebra.definite import root
from hgogen.guarantees.contracting import Steps
from hgogen.guarantees.inequality import Inputs
from hgogen.guarantees.quadratic import (
    MARGINS,
    Array,
    Quadratic,
    Seen,
    Weights,
    confirmed,
    even,
    extent,
    floats,
    inverse_root,
)
from hgogen.guarantees.semidefinite import Solution, settled, shortest, together

_WHAT = "a bound of what inputs do"
_SHARES = tuple(Fraction(k, 100) for k in (5, 10, 20, 30, 40, 50, 60, 70, 80, 87, 93))  # of the rate, for alpha
_FIRST = 6  # of them, that is tried first: about half of the rate where one mode decays, more where they are many
_LARGE = 1e30  # in the place of a bound, where none is proved
_MARGIN = 1e-6
_SHARE = Fraction(999_999, 1_000_000)  # of alpha for the lambda, so that they are below it when they are rounded

Bounded = Callable[[Fraction], Sequence[Quadratic]]  # by alpha, the forms of which the last multipliers are the lambda


@dataclass(frozen=True)
class InputBound:
    """A proof that |c e| <= `bound` where each input is at most 1: by the `weights`, of which the last of S are the
    lambda, at `alpha`."""

    alpha: Fraction
    weights: Weights
    bound: Fraction

    @property
    def written(self) -> dict[str, Any]:
        """As a certificate has it."""
        return {"alpha": self.alpha, **self.weights.written, "bound": self.bound}


def input_bound(bounded: Bounded, W: Array | None, q: int, c: Array, most: Fraction) -> InputBound | None:
    """A small bound of |c e|, c (N) of FLINT's rationals, of the forms that are negative at an alpha, with `q` inputs
    among what multiplies them; alpha is searched in floats up to `most`, and the least bound that is proved counts.
    None where none is proved. `W`: coordinates x, e = W x, near which P is expected.

    Raises: `NoSolver`.
    """
    if W is None:
        return None
    tried, coordinates = dict[Fraction, float](), W

    def bound(share: Fraction) -> float:
        """A bound by the weights that `bound_at` tries first, in floats; a large number where there is none."""
        alpha = share * most
        forms, row = [form.floats for form in bounded(alpha)], floats(c[None])
        weights = weights_in_floats(forms, row, float(alpha), coordinates, q, MARGINS[0])
        square = 0.0 if weights is None else float(row[0] @ np.linalg.solve(weights[0], row[0]))
        tried[alpha] = float(root(Fraction(square))) if 0 < square < _LARGE else _LARGE
        return tried[alpha]

    _walk(bound)
    proofs = (bound_at(bounded, coordinates, q, c, alpha) for alpha in sorted(tried, key=tried.__getitem__))
    return next(filter(None, proofs), None)


def of_step(steps: Steps, h: Fraction, inputs: Inputs, c: Array, most: Fraction) -> InputBound | None:
    """That of a step which is proved with the rate `most`. Raises: `NoSolver`."""
    step, q = steps.at(h), inputs.D.shape[1]
    return input_bound(lambda alpha: (step.driven(alpha, inputs),), steps.coordinates, q, c, most)


def _walk(bound: Callable[[Fraction], float]) -> None:
    """Tries shares of the rate upwards, as long as a bound becomes less, else downwards."""
    least = bound(_SHARES[_FIRST])
    for way in (_SHARES[_FIRST + 1 :], _SHARES[:_FIRST][::-1]):
        before = least
        for share in way:
            value = bound(share)
            if value >= least:
                break
            least = value
        if least < before:
            return


def bound_at(bounded: Bounded, W: Array, q: int, c: Array, alpha: Fraction) -> InputBound | None:
    """A bound of |c e| at this alpha, proved; None where none is. Arguments as of `input_bound`. Raises: `NoSolver`."""
    forms = bounded(alpha)
    asked = [form.floats for form in forms], floats(c[None]), float(alpha), W, q
    exactly = confirmed(forms, lambda margin: weights_in_floats(*asked, margin), q, alpha)
    if exactly is None:
        return None
    return InputBound(alpha, Weights.of(*exactly), root(extent(exactly[0], c)))


def bound_in_floats(bounded: Bounded, W: Array, q: int, c: Array, alpha: Fraction) -> tuple[float, Array] | None:
    """The same bound in floats, which prove nothing, and coordinates (N, N) in which its P is the unit matrix."""
    forms, row = [form.floats for form in bounded(alpha)], floats(c[None])
    weights = weights_in_floats(forms, row, float(alpha), W, q, _MARGIN)
    if weights is None or any(np.linalg.eigvalsh(form.value(*weights)).max() >= 0 for form in forms):
        return None
    return float(np.sqrt(row[0] @ np.linalg.solve(weights[0], row[0]))), inverse_root(weights[0])


def weights_in_floats(
    forms: Sequence[Quadratic], rows: Array, alpha: float, W: Array, q: int, margin: float
) -> tuple[Array, Array] | None:
    """P and S in floats with a small largest c P^-1 c' of the `rows` c (r, n), sought from coordinates x of e = W x on.

    Raises: `NoSolver`.
    """

    def sought_in(W: Array) -> Solution | None:
        """In these coordinates, with the inputs in a unit in which x is near 1."""
        unit = alpha / float(np.linalg.norm((np.linalg.inv(W) @ forms[0].pairs[0][1])[:, -q:]))
        view = Seen(forms, W, np.append(even(forms[0], W)[:-q], [unit] * q))
        return shortest(view, rows @ W, together(forms[0], q, float(_SHARE) * alpha), margin, unit, _WHAT)

    return settled(sought_in, W)
