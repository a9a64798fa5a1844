"""The filters of a discrete plant z+ = f(z, u): their equations, and the theorem of the extended Kalman filter.

    z <- f(z, u),  P <- F P F' + Q,  F = df/dz at the estimate before, which a sample has corrected
    at a sample of y_j:  K = P c'/(R_j + c P c'),  z <- z + K (y_j - h_j),  P <- P - K c P

Q is the covariance that a step adds, R the variance of a sample; neither is scaled by the sampling period. Source of
the theorem: K. Reif, S. Guenther, E. Yaz, R. Unbehauen, "Stochastic stability of the discrete-time extended Kalman
filter", IEEE TAC 44 (1999).

Luenberger's observer has constant gains in place of K. Several outputs correct one after the other:

    z <- f(z, u),     at a sample of y_j:  z <- z + K_j (y_j - h_j(z, u))

D. Luenberger, "An introduction to observers", IEEE TAC 16 (1971).
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.linearised import evaluated, jacobians_on_box
from hgogen.check import Check, ClaimId, Claims, Verdict
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain, state_field
from hgogen.part import Clock, Jump, Pieces
from hgogen.program import Block, Place, sym
from hgogen.reading.given import BadGain, by_coordinate, by_output, names_of, reals
from hgogen.sentence import Reason, because
from hgogen.theorem import OPERATION, Hypothesis, Theorem

REFERENCE = (
    "Reif, Guenther, Yaz, Unbehauen, Stochastic stability of the discrete-time extended Kalman filter, IEEE TAC 44 "
    "(1999), theorem 3.1"
)
PREDICTION = "z <- f(z, u), P <- F P F' + Q, F = df/dz at the corrected z"
CORRECTION = "at a sample of y_j: K = P c'/(R_j + c P c'), z <- z + K (y_j - h_j), P <- P - K c P, c = dh_j/dz"
# hypotheses of continuous time
_CONTINUOUS = ("y and the input are known at all times", "y is measured without noise")
THEOREM = Theorem(
    "the mean square of the error stays bounded",
    (
        Hypothesis(
            "the first error, the noises and the terms of second order of f and h are small enough",
            verdict=Verdict.UNKNOWN,
            reason="the theorem's constants are existential: no number is known to be small enough",
            reference="theorem 3.1",
        ),
        Hypothesis(
            "the covariance stays between two positive bounds",
            verdict=Verdict.UNKNOWN,
            reason="nothing here bounds the covariance along a trajectory",
            reference="theorem 3.1",
        ),
        Hypothesis(
            "df/dz is not singular",
            verdict=Verdict.UNKNOWN,
            reason="it is not examined on the ranges",
            reference="theorem 3.1",
        ),
        *(each for each in OPERATION if each.claim not in _CONTINUOUS),
    ),
    REFERENCE,
)


def no_proof(form: Form, observer: str, theorem: Theorem = THEOREM) -> Check:
    """Return the check `OBSERVER.convergence`, that the conclusion of its `theorem` holds, with the verdict unknown:
    for a discrete plant, or for a filter of which hgogen proves nothing."""
    subject = "discrete plants" if form.system.discrete else f"{observer} in {form.kind} form"
    reason = because("hgogen has no proof for {subject}", subject=subject)
    claim = theorem.conclusion
    return Check(ClaimId(observer, "convergence"), claim, Verdict.UNKNOWN, reason, fix="Validate by trials.")


def demand_plain_gain(form: Form, theta: float) -> None:
    """Raise `BadGain` for a discrete plant with a theta above 1: theta speeds up differential equations only."""
    if form.system.discrete and theta != 1:
        reason = "speeds up the correction of differential equations, and the plant is discrete in time; leave it at 1"
        raise BadGain(f"theta = {theta:g}", reason)


POINTS = 12  # corners of the ranges, and as many points inside, at which the error is linearised
CONSTANT = 1e-12  # share by which the entries of a constant matrix differ
WIDER = 10.0  # share of the largest gain up to which each can be tuned
LUENBERGER = "Luenberger, An introduction to observers, IEEE TAC 16 (1971)"
_DECAY = "the linearised error decays along the plant's motion"
DECAYS = Theorem(
    "the estimate converges from nearby",
    (
        Hypothesis(_DECAY, (Claims("luenberger", "decay"),)),
        *(each for each in OPERATION if each.claim != _CONTINUOUS[0]),
    ),
    LUENBERGER,
)


def luenberger(
    form: Form,
    *,
    gains: Sequence[Any] | Mapping[str, Any] | np.ndarray | None = None,
    initial: Mapping[str, float] | Sequence[float] | None = None,
    accept: Iterable[str] = (),
) -> Observer:
    """Luenberger's observer of a discrete plant: z <- f(z, u), at a sample of y_j z <- z + K_j (y_j - h_j).

    Args: `gains` K (n), by the names of states or in their order; of several outputs a K_j (n) for each, by name or in
    order; `initial` the plant's state; `accept` ids of refuted checks to ignore.

    Raises: `Refuted`; `BadGain` for gains of another length, and those with which the linearised error cannot decay.
    """
    accept = demand_form("luenberger", form, accept, discrete=True)
    K, names = _gain_rows(form, gains), names_of(form.system.outputs)
    dynamics, z = Dynamics(form), state_field(form, initial, 1.0)
    decay = Check(
        ClaimId("luenberger", "decay"), _DECAY, Verdict.UNKNOWN, _frozen(dynamics, K), fix="Validate by trials."
    )
    unproved = no_proof(form, "luenberger", DECAYS)
    largest = WIDER * max(float(np.abs(K).max()), 1e-300)
    fields = [
        gain(f"K_{y}", row, -largest, largest, f"error of {y} onto the states") for y, row in zip(names, K, strict=True)
    ]
    place, estimate = Place("state", "z"), sym("state", "z", form.n)

    def build(clock: Clock) -> Pieces:
        corrected = (estimate + sym("gain", field.name, form.n) * sym("work", "e") for field in fields)
        return Pieces(
            fields=(z,),
            predict=(Block("z by the map z+ = f(z, u)", {place: dynamics.flow(estimate, clock.u(0.0))}),),
            update=tuple((Block("correct by a constant gain", {place: after}),) for after in corrected),
            rule="discrete, constant gains",
        )

    return Observer(
        form=form,
        name="luenberger",
        parts=(Jump(build),),
        gains=tuple(fields),
        z=estimate,
        dynamics=dynamics,
        claims=lambda: (*form.checks, *(evaluated(form) if accept else ()), decay, unproved),
        accepted=accept,
        theorem=DECAYS,
        equations=("z <- f(z, u)", "at a sample of y_j: z <- z + K_j (y_j - h_j)"),
        reference=LUENBERGER,
    )


def _gain_rows(form: Form, gains: Any) -> np.ndarray:
    """Return the gains K_j (p, n) of each output. Raises: `BadGain`, `BadNames`."""
    p = len(form.output)
    if gains is None:
        raise BadGain("luenberger of a discrete plant", "takes gains, K (n) for each output; give gains=")
    each = [gains] if p == 1 else by_output("gains", gains, form)
    try:
        rows = np.array([reals("gains", by_coordinate("gains", row, form)) for row in each])
    except (TypeError, ValueError):
        rows = np.zeros(0)
    if rows.shape != (p, form.n) or not np.isfinite(rows).all():
        raise BadGain("gains", f"must be {form.n} finite numbers for each of {p} outputs")
    return rows


def _frozen(dynamics: Dynamics, K: np.ndarray) -> Reason:
    """Return the reason that says at how many points of the ranges the error decays that is linearised there, e <- F (1
    - K_p C_p) .. (1 - K_1 C_1) e with a constant matrix.

    A product of different such matrices can decay where none of them does, or grow where each decays. Raises: `BadGain`
    where the error cannot decay: the matrix is constant and has an eigenvalue of modulus 1 or more, or every
    determinant is 1 or more.
    """
    one, loops = np.eye(dynamics.n), []
    for F, C in zip(*jacobians_on_box(dynamics, POINTS), strict=True):
        loops.append(F @ reduce(lambda whole, pair: (one - np.outer(*pair)) @ whole, zip(K, C, strict=True), one))
    sizes = np.abs(np.linalg.eigvals(loops)).max(axis=1)
    constant = np.ptp(loops, axis=0).max() <= CONSTANT * np.abs(loops).max()
    if np.abs(np.linalg.det(loops)).min() >= 1 or (constant and sizes.min() >= 1):
        reason = (
            f"let the error grow at every point of the ranges that was tried, by {sizes.min():.3g} a sample or more"
        )
        raise BadGain("gains", f"{reason}; take others, or riccati")
    pattern = "frozen at points of the ranges it decays at {count} of {points}, which decides nothing of its motion"
    return because(pattern, count=int((sizes < 1).sum()), points=len(sizes))
