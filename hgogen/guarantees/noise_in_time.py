"""How far noise of the outputs moves the estimate of a constant injection, in continuous time, by any course of it.

    V' <= -alpha V + sum_j lambda_j v_j^2,   sum_j lambda_j <= alpha,   |v_j| <= 1,   V = |e|_P^2

Then V <= 1 stays so, and from elsewhere what V is above 1 falls at least like exp(-alpha t): |c e| comes to no more
than sqrt(c P^-1 c'). P is sought for the least of that at an alpha that is searched, for each state by itself.
"""

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from hgogen.algebra.definite import number
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import Falls, Flow
from hgogen.guarantees.inclusion import NO_SCALES, Inclusion, Uncertain, of_state
from hgogen.guarantees.inequality import driven
from hgogen.guarantees.quadratic import Array, Quadratic, floats, inverse_root, rational
from hgogen.guarantees.questions import input_bound, weights_in_floats
from hgogen.intervals.outward import number as outward
from hgogen.observer import Observer, asks_an_observer
from hgogen.reading.named import names_of
from hgogen.sentence import Reason, because

_TRIED = (0.5, 0.7, 1.0, 1.4)  # times an alpha, at which all states are bounded at once
_MARGIN = 1e-6

Bounds = Mapping[tuple[str, str], float]  # by the name of a state of the form, and of an output


@asks_an_observer
def noise_bounds(observer: Observer) -> Bounds | Nothing:
    """By the name of a state of the form and of an output, how far the estimate of the one goes at most for noise of at
    most 1 of the other, in continuous time, at the declared gains of an observer of a constant injection; or why that
    is not known.

    Raises: `lmi.NoSolver`.
    """
    error: Inclusion | Nothing | None = observer.error
    if error is None:
        return Nothing(because("the proof is for a constant injection: high_gain, filtered and the like, on chains"))
    if isinstance(error, Nothing):
        return error
    (theta,) = (each.initial[0] for each in observer.gains if each.name == "theta")
    flow = Flow(error, Fraction(theta))
    if flow.fastest is None:
        return Nothing(flow.obstacle(observer.form.states))
    known = bounds(flow, flow.fastest)
    return Nothing(known) if isinstance(known, Reason) else named(observer.form, known)


def named(form: Form, known: Mapping[tuple[int, int], float]) -> Bounds:
    """Bounds by state of the form and output, by their names."""
    outputs = names_of(form.system.outputs)
    return {(form.names[i], outputs[j]): bound for (i, j), bound in known.items()}


def bounds(flow: Flow, falls: Falls) -> Mapping[tuple[int, int], float] | Reason:
    """By state of the form and by output, the proved bound of what noise of at most 1 does, in their units, of an error
    that `falls`; or why there is none.

    Raises: `NoSolver`.
    """
    error, scales = flow.error, flow.error.scales(flow.theta)
    if scales is None:
        return NO_SCALES
    e, W = error.at(flow.theta), inverse_root(floats(rational(falls.weights.P)))
    e, picks, every = _over(e, number(falls.alpha)), list(enumerate(error.layout.picks)), range(e.B.shape[1])
    known = {(i, j): 0.0 for i, _ in picks for j in every}  # of an output that enters nowhere
    for j in np.flatnonzero(np.vstack([e.B, e.E]).any(axis=0)).tolist():
        alone = e.driven_by(np.eye(len(every), dtype=int)[:, [j]])

        def forms(alpha: Fraction, of: Uncertain = alone) -> tuple[Quadratic, ...]:
            return driven(of, alpha, error.hull)

        for i, field in picks:
            one = input_bound(forms, W, 1, of_state(scales, field), Fraction(1))
            if one is None:
                return because("no bound is found of what noise does")
            known[i, j] = outward(one.bound)[1]
    return known


def together_in_floats(
    error: Inclusion, sizes: Array, rows: Array, falls: Falls, alpha: float, fastest: float
) -> float:
    """The largest |c z|, c (r, n) of the `rows`, that one norm bounds under noise of all outputs, of these sizes (p) at
    most, with an alpha near this one, in floats, z the errors of the form's states; infinite where none is found. What
    noise alone moves faster than `fastest` (1/time), in that norm, counts for as many times more.

    Raises: `NoSolver`.
    """
    scales = error.scales(falls.theta)
    assert scales is not None
    e, W = error.at(falls.theta).floats, inverse_root(floats(rational(falls.weights.P)))
    e, least = _over(e.driven_by(np.diag(sizes)), alpha), float("inf")
    rows = rows @ np.array([floats(of_state(scales, k)[None])[0] for k in error.layout.picks])
    for share in _TRIED:
        candidate = weights_in_floats(driven(e, share, error.hull), rows, share, W, len(sizes), _MARGIN)
        if candidate is not None and np.linalg.eigvalsh(candidate[0]).min() > 0:
            squares = np.einsum("ij,ij->i", rows, np.linalg.solve(candidate[0], rows.T).T)
            speed = alpha * float(np.sqrt(np.linalg.eigvalsh(e.B.T @ candidate[0] @ e.B).max()))
            least = min(least, float(np.sqrt(squares.max())) * max(1.0, speed / fastest))
    return least


def _over(e: Uncertain, pace: Any) -> Uncertain:
    """The same in a time that runs `pace` times as fast, so that rates are near 1; in the arithmetic of both."""
    return replace(e, M=e.M / pace, G=e.G / pace, B=e.B / pace, core=e.core / pace, injected=e.injected / pace)
